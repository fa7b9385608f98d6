"""The texts of a library: templates of `data/library`, filled in from the declared layouts."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from importlib import metadata, resources
from typing import Any, NamedTuple

import numpy as np

from .. import validation as check
from ..batch import CLIP, MODE, PERIODS, PERIODS_ALLOWED, REASONS
from ..compiler.image import Image
from ..control.base import Setup
from ..control.export import c_named
from ..layout import Layout
from ..physics import precision
from ..physics.joints.layout import LAW, PLACES
from ..physics.layout import POSES, SPACE_POSES
from ..physics.model import STIFFNESSES, Jointed
from ..tasks.program import ENERGIES, INFO, REQUEST, TORQUE_FACTOR

VERSION = metadata.version("flexarm_env")

LEAST = 1e-30
"""Of what must be positive."""

LEAST_DAMPED = 1e-3
"""s: tau_d that an arm without damping may be given, tenfold, as one that has this."""
_OWN = (
    ("payload_mass", "kg", "of the arm", 0.0), ("payload_inertia", "kg m2", "of the arm", 0.0),
    ("EI_factor", "", "on all stiffness to bending", LEAST), ("tau_d", "s", "of the damping", 0.0),
)  # fmt: skip
"""Of an arm's own parameters the name, unit, meaning and what each is at least."""

_OWN_IN_SPACE = (
    _OWN[0], ("payload_inertia", "", "a factor on the payload's tensor", 0.0), ("EI_factor", "", "on EI", LEAST),
    _OWN[3], ("EI_y_factor", "", "on EI_y", LEAST), ("GJ_factor", "", "on GJ", LEAST),
)  # fmt: skip

SENTENCES = {
    "ok": "ok",
    "newton_failed": "Newton's iteration did not converge, although the step was halved",
    "diverged": "the solution diverged: a tip deflects by more than its length, or energy appeared from nowhere",
    "out_of_range": "a deflection is beyond the range of the reduction to modes",
    "not_finite": "a value that is not finite appeared",
    "timed_out": "the time allowed was used up",
    "action_not_finite": "the action is not finite",
    "joint_limit": "a joint is beyond its limits",
}
"""Of the words of `REASONS`; "ok" where there is none."""


def fill(file: str, name: str, known: Mapping[str, Any]) -> str:
    """A template with its marks replaced: @WORD@ by what is known, NAME, UPPER."""
    text = (resources.files("flexarm_env") / "data" / "library" / file).read_text()
    text = re.sub("@([A-Z_]+)@", lambda word: str(known[word[1]]), text)
    return c_named(text, name)


class Parameter(NamedTuple):
    """A number of the arm that programs read as they run. start: as the environment has it. least, most: what it may
    be. law: which of the joints' numbers; None: it is drawn at each reset, and `at` says where in the block it is."""

    name: str
    unit: str
    meaning: str
    start: float
    least: float
    most: float
    law: int | None
    at: int


class Source:
    """What a library's files say.

    Args:
        env: the environment. name: in front of all names. worlds: what stepping needs, and derivatives where there are
            any. periods: these; None, and why. symbols: of the programs. cpu: to be told.
    """

    def __init__(
        self, env: Any, name: str, worlds: Sequence[Image], periods: Any, absent: str, symbols: Sequence[str], cpu: str
    ) -> None:
        self.env, self.name, self.worlds, self.periods = env, name, worlds, periods
        self.absent, self.symbols, self.cpu = absent, symbols, cpu
        self.batch, self.plan, self.setup = env.unwrapped.batch, env.unwrapped.plan, Setup.of(env)
        self.joints, self.spatial = self.plan.arm.n_links, self.plan.arm.spatial
        self.poses = SPACE_POSES if self.spatial else POSES

    def files(self) -> dict[str, str]:
        """Names and contents."""
        return {
            f"{self.name}.h": self.filled("arm.h", DERIVATIVES=self._declared, TORQUES=self._torques("arm.h")),
            f"{self.name}.c": self.filled("arm.c", DERIVATIVES=self._derived, TORQUES=self._torques("arm.c")),
            "example.c": self.filled("example.c"),
            "CMakeLists.txt": self.filled("CMakeLists.txt"),
            f"{self.name}.pc": self.filled("arm.pc"),
        }

    def filled(self, file: str, **more: str) -> str:
        """See `fill`."""
        return fill(file, self.name, self._known | more)

    # --- the numbers ------------------------------------------------------------------------------
    @cached_property
    def _known(self) -> dict[str, Any]:
        batch, plan, world = self.batch, self.plan, self.worlds[0]
        at, request = {key: place[0] for key, place in world.places.items()}, REQUEST.offsets(0, self.joints, 0)
        targets = self.joints if self.spatial else len(batch.task.targets)
        meant = "joint angles that bring the rigid arm's tip there, rad" if self.spatial else "x and y, m"
        known = {
            "HEAD": self._head(), "VERSION": VERSION, "JOINTS": self.joints, "OBSERVATION": batch.observation.size,
            "PERIOD": repr(plan.period), "STATE": world.changing, "CLIP": f"{CLIP:g}", "GIVEN": targets,
            "TARGET": meant if targets > 1 or self.spatial else "an angle, rad", "ACTION": self._action(),
            "FROM": "" if self.spatial else "; angles from the world's x axis",
            "ENTRIES": _listed(_entries(self.setup)), "STATUSES": self._statuses(), "SENTENCES": self._sentences(),
            "INFO": _members(INFO, self.sizes, {"energies": ENERGIES}), "POSE": _members(self.poses, {}, {}),
            "DECLARED": "\n".join(f"extern int64_t {symbol}(int64_t, int64_t, int64_t);" for symbol in self.symbols),
            "TABLES": "\n".join(self._tables()), "WORLDS": len(self.worlds), "REQUEST": at["request"],
            "RECORD": at["block"] + 8 * batch.layout.record, "ANGLES": request.angles,
            "TARGET_AT": request.goals if self.spatial else request.target, "VIBRATION": request.vibration,
            "STREAM": at["stream"], "QUEUE": at["queue"], "ALLOWED": PERIODS_ALLOWED,
            "MODE": MODE, "PERIODS": PERIODS, "TABLE": at["table"], "POSES": at["block"] + 8 * batch.layout.poses,
            "SEEN": at["observation"], "BLOCK": at["block"],
            "ACTION_AT": at["action"],
            **dict(zip(("FARTHEST", "FAR_TARGET", "FAR_VIBRATION"), map(number, self.farthest), strict=True)),
            "CPU": self.cpu, "PARAMETERS": len(self.parameters), **self._settable(at["block"]),
            "OBJECTS": " ".join(f"{symbol}.o" for symbol in self.symbols),
        }  # fmt: skip
        return known

    @property
    def sizes(self) -> dict[str, int]:
        """Of an `INFO`."""
        task = self.batch.task
        counts = {"links": task.links, "targets": task.targets, "terms": task.terms, "further": task.further}
        return {key: len(value) for key, value in counts.items()}

    @property
    def farthest(self) -> tuple[float, float, float]:
        """How large angles, numbers of a target and a vibration at the start may be, as `options` of a reset say."""
        plan = self.plan
        angle, point = min(plan.farthest, 1e6), not self.spatial and len(self.batch.task.targets) > 1
        return angle, plan.arm.total_length if point else angle, 0.0 if plan.starts.shake is None else 0.5

    def _most(self) -> tuple[float, ...]:
        """The largest parameters that double precision carries; see `physics.precision`."""
        batch = self.batch
        largest = 10.0 * (batch.arm.damping[0] or LEAST_DAMPED) * batch.starts.drawn["damping"][1]

        def carried(factor: float, damping: float) -> bool:
            factors = dict.fromkeys(STIFFNESSES, factor)
            try:
                precision.check_parameters(batch.arm, batch.settings, factors, damping, 0.0, "")
            except check.InvalidValue:
                return False
            return True

        damping = next((x for x in (largest, 0.2 * largest) if carried(2.0, x)), 0.1 * largest)
        low, high = 0.0, 60.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if carried(2.0**middle, damping) else (low, middle)
        return check.LARGEST, check.LARGEST, 2.0**low, damping, 2.0**low, 2.0**low

    @cached_property
    def parameters(self) -> list[Parameter]:
        """What may be set between periods."""
        batch, system = self.batch, self.batch.system
        own = zip(_OWN_IN_SPACE if self.spatial else _OWN, self._most(), strict=False)
        found = [
            Parameter(name, unit, meaning, float(system.par[k]), least, most, None, batch.layout.par + k)
            for k, ((name, unit, meaning, least), most) in enumerate(own)
        ]
        factor = batch.layout.record + TORQUE_FACTOR
        found.append(Parameter("torque_factor", "", "on the motors' torques", 1.0, 0.0, check.LARGEST, None, factor))
        if not isinstance(system.model, Jointed):
            return found
        stiffest, drawn = precision.MOST * min(self.plan.arm.torque_limits), system.model.own is not None
        for k, value in enumerate(system.model.data.tolist()):
            i, number = divmod(k, len(LAW.fields))
            field, joint = LAW.fields[number], int(system.model.table[i * PLACES])
            if value == 0.0:  # what the arm has not
                continue
            least = LEAST if field.name in ("stiffness", "rotor") else 0.0
            most = stiffest if field.name == "stiffness" else check.LARGEST
            at = batch.layout.par + len(system.model.own or ()) + k
            about = f"{field.name}[{joint}]", field.unit.replace("^", ""), f"of joint {joint}: {field.meaning}", value
            found.append(Parameter(*about, least, most, None if drawn else k, at if drawn else 0))
        return found

    def _laws(self, world: int, first: str) -> list[int]:
        """Bytes at which the joints' numbers begin, in each model of a world."""
        known = self.worlds[world].places.items()
        return [place[0] for key, place in known if re.fullmatch(rf"{first}(model|models\.\w+)\.data", key)]

    # --- the texts --------------------------------------------------------------------------------
    def _settable(self, block: int) -> dict[str, Any]:
        """Where parameters are, and what is told of them."""
        copies = [(k, at + 8 * p.law) for k, p in enumerate(self.parameters) if p.law is not None
                  for at in self._laws(0, "")]  # fmt: skip
        first = dict(reversed(copies))
        places = [first.get(k, block + 8 * p.at) for k, p in enumerate(self.parameters)]
        limits = [f"{number(p.least)}, {number(p.most)}" for p in self.parameters]
        rows = [f"    {{{at}, {pair}}}," for at, pair in zip(places, limits, strict=True)]
        told = [f"{k}: {p.name}{p.unit and ', '}{p.unit}; {p.meaning}" for k, p in enumerate(self.parameters)]
        return {
            "SETTABLE": "\n".join(rows), "COPIES": len(copies), "TOLD": _listed(told),
            "COPIED": ", ".join(f"{{{k}, {at}}}" for k, at in copies) or "{0, 0}",
        }  # fmt: skip

    def _head(self) -> str:
        spec = self.env.spec
        what = f"{spec.id} {json.dumps(spec.kwargs, default=str)}" if spec is not None else type(self.env).__name__
        settings = self.plan.settings
        lines = [
            f"NAME: a flexible-link robot arm, {what}",
            f"written by flexarm_env {VERSION}: {settings.formulation}, dt = {settings.dt:.6g} s; for {self.cpu}",
        ]
        if self.periods is None:
            lines.append(f"Derivatives of a period are not in it: {self.absent}.")
        return _listed(lines, " * ")

    def _action(self) -> str:
        mode, limits = self.plan.action_mode, ", ".join(f"{x:g}" for x in self.plan.arm.torque_limits)
        means = f"torques over {limits} N m" if mode == "torque" else f'what action_mode="{mode}" takes'
        return f"{means}."

    def _statuses(self) -> str:
        words = {int(code): word or "ok" for code, word in REASONS.items()}
        return "\n".join(f"#define UPPER_{word.upper()} {code}" for code, word in words.items())

    def _sentences(self) -> str:
        rows = (f"    case UPPER_{word.upper()}: return {json.dumps(text)};" for word, text in SENTENCES.items())
        return "\n".join(rows)

    def _torques(self, file: str) -> str:
        if self.plan.action_mode != "torque":
            return ""
        declared = "int NAME_step_torques(NAME_arm *arm, const double torque[UPPER_JOINTS])"
        if file.endswith(".h"):
            return f"\n/* The same by the torques asked for, N m. */\n{declared};\n"
        limits = ", ".join(map(number, self.plan.arm.torque_limits))
        return (
            f"\n{declared}\n{{\n    static const double limits[UPPER_JOINTS] = {{{limits}}};\n"
            "    double action[UPPER_JOINTS];\n"
            "    if (torque == NULL) return UPPER_REFUSED;\n"
            "    for (int k = 0; k < UPPER_JOINTS; k++) action[k] = torque[k] / limits[k];\n"
            "    return NAME_step(arm, action);\n}\n"
        )

    @property
    def _declared(self) -> str:
        if self.periods is None:
            return ""
        names = [f" *   {k}: {name}" for k, name in enumerate(self.periods.names)]
        return self.filled("derivatives.h", STATES="\n".join(names), S=str(self.periods.state_size))

    @property
    def _derived(self) -> str:
        if self.periods is None:
            return ""
        p, world = self.periods, self.worlds[1]
        at = {f"D_{key.upper()}": str(place[0]) for key, place in world.places.items() if "." not in key}
        laws = [p.law for p in self.parameters if p.law is not None]
        shared = [(8 * k + to, 8 * k + self._laws(0, "")[0]) for k in laws for to in self._laws(1, r"program\.")]
        return self.filled(
            "derivatives.c", MOVING=str(p.moving), COLUMNS=str(p.moving + p.action_size),
            D_CHANGING=str(world.changing), PLACES=", ".join(map(str, p._own.tolist())),
            BACKWARDS=str(int(p.backwards)), SHARING=str(len(shared)),
            SHARED=", ".join(f"{{{to}, {of}}}" for to, of in shared) or "{0, 0}", **at,
        )  # fmt: skip

    def _tables(self) -> Iterator[str]:
        rows = []
        for k, world in enumerate(self.worlds):
            data = np.frombuffer(world.data, np.uint64).tolist()
            words = [word % 2**64 for word in world.words]
            pairs = [f"{{{word}, {byte}}}" for word, byte in world.pointers]
            yield f"static const uint64_t words{k}[] = {{\n{_rows(f'{word:#x}u' for word in words)}\n}};"
            yield f"static const uint32_t pointers{k}[][2] = {{\n{_rows(pairs)}\n}};"
            yield f"static const uint64_t data{k}[] = {{\n{_rows(f'{word:#x}u' for word in data)}\n}};"
            rows.append(f"    {{words{k}, {len(words)}, pointers{k}, {len(pairs)}, data{k}, {len(world.data)}}},")
        yield "static const world worlds[] = {\n" + "\n".join(rows) + "\n};"


def _members(layout: Layout, sizes: dict[str, int], inner: dict[str, Layout]) -> str:
    """A struct's members, all of them double, as a layout has them."""
    lines = []
    for field, shape in zip(layout.fields, layout.shapes(**sizes), strict=True):
        if field.name in inner:
            lines += [f"    struct {{\n{_members(inner[field.name], {}, {})}\n    }} {field.name};"]
        elif all(shape):
            shape = flat(shape)
            told = ", ".join(part for part in (field.unit, re.sub(r"`\w+`", "", field.meaning)) if part)
            name = field.name + "".join(f"[{length}]" for length in shape)
            lines.append(f"    double {name};" + (f" /* {told} */" if told else ""))
    return "\n".join(lines)


def flat(shape: tuple[int, ...]) -> tuple[int, ...]:
    """An entry's shape without the axis that is one of space alone."""
    return shape[1:] if len(shape) == 2 and shape[0] == 1 else shape


def _entries(setup: Setup) -> list[str]:
    """A line for each number that is observed at an instant."""
    past = "" if setup.history == 1 else f", {setup.history} instants, the oldest first"
    return [f"{k}: {n} / {s:.9g}{past}" for k, (n, s) in enumerate(zip(setup.names, setup.scales, strict=True))]


def _listed(lines: Iterable[str], start: str = " *   ") -> str:
    return "\n".join(f"{start}{re.sub(r'[^ -~]', '?', line).replace('*/', '* /')}" for line in lines)


def _rows(words: Iterable[str]) -> str:
    found = list(words)
    return ",\n".join("    " + ", ".join(found[k : k + 6]) for k in range(0, len(found), 6))


def number(value: float) -> str:
    """A double as C writes it, to the last bit."""
    return repr(float(value))
