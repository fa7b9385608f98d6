"""Generate the C files of a library from the templates in `data/library` and the memory layouts of the programs."""

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
from ..control.export import c_named, harmless
from ..layout import Layout
from ..physics import precision
from ..physics.joints.layout import LAW, PLACES
from ..physics.model import STIFFNESSES, Jointed
from ..rigid import reach
from ..tasks.program import ENERGIES, INFO, REQUEST, TORQUE_FACTOR

VERSION = metadata.version("flexarm_env")

MEANINGS = {"further": "costs, payload, push, drawn factors, ...: flexarm_env.tasks.program.FURTHER says where each is"}
"""Comments for the C header on `info` entries whose description in the layout `INFO` refers to another layout."""

LEAST = 1e-30
"""Lower bound of all parameters that must be positive, in the parameter's unit."""

LEAST_DAMPED = 1e-3
"""Damping time tau_d (s) assumed for an undamped arm. The largest tau_d that a user can set is ten times the arm's
tau_d.
"""
MEANT = {
    1: "an angle, rad", 2: "x and y, m, from {near:.9g} to {far:.9g} m from the root",
    3: "joint angles that bring the rigid arm's tip there, rad",
}  # fmt: skip
"""Meaning of the numbers by which a start's target is given, by the number of the target's coordinates."""

SENTENCES = {
    "ok": "ok",
    "newton_failed": "Newton's iteration did not converge, although the step was halved",
    "diverged": "the solution diverged: a tip deflects by more than its length, or energy appeared from nowhere",
    "out_of_range": "a deflection is beyond the valid range of the reduction to modes",
    "not_finite": "a value that is not finite appeared",
    "timed_out": "the time allowed was used up",
    "action_not_finite": "the action is not finite",
    "joint_limit": "a joint is beyond its limits",
}
"""Sentence for each status word of `REASONS`."""


def fill(file: str, name: str, known: Mapping[str, Any]) -> str:
    """Return the text of a template file with each placeholder @WORD@ replaced by `known[WORD]`.

    name: name of the library, which replaces the word NAME. In capital letters, the name replaces the word UPPER.
    """
    # marks first, then NAME and UPPER, which the inserted texts contain too
    text = (resources.files("flexarm_env") / "data" / "library" / file).read_text()
    text = re.sub("@([A-Z_]+)@", lambda word: str(known[word[1]]), text)
    return c_named(text, name)


class Parameter(NamedTuple):
    """Parameter of the arm that the compiled programs read at run time.

    start: value of the parameter in the environment. least, most: permitted range of values. law: index of a joint's
    parameter in the array of joint parameters; None for all other parameters, which the environment can randomize at
    reset. at: if `law` is None, index of the parameter in the memory block of the arm.
    """

    name: str
    unit: str
    meaning: str
    start: float
    least: float
    most: float
    law: int | None
    at: int


class Source:
    """Generator of the C files of a library.

    Args:
        env: environment. name: prefix of all C names. worlds: initial memory contents of the compiled program that
            steps the arm, and of the program for derivatives, if any. periods: object that computes derivatives
            (`Periods`), or None. absent: reason why derivatives are missing. symbols: C names of the programs. cpu:
            name of the processor for the comment in the header.
    """

    def __init__(
        self, env: Any, name: str, worlds: Sequence[Image], periods: Any, absent: str, symbols: Sequence[str], cpu: str
    ) -> None:
        """Store the arguments, which the class describes, and the memory layout of a link's pose."""
        self.env, self.name, self.worlds, self.periods = env, name, worlds, periods
        self.absent, self.symbols, self.cpu = absent, symbols, cpu
        self.batch, self.plan, self.setup = env.unwrapped.batch, env.unwrapped.plan, Setup.of(env)
        self.joints = self.plan.arm.n_links
        self.poses = self.batch.reading.poses

    def files(self) -> dict[str, str]:
        """Return the text of each file of the library by its name."""
        return {
            f"{self.name}.h": self.filled("arm.h", DERIVATIVES=self._declared, TORQUES=self._torques("arm.h")),
            f"{self.name}.c": self.filled("arm.c", DERIVATIVES=self._derived, TORQUES=self._torques("arm.c")),
            "example.c": self.filled("example.c"),
            "CMakeLists.txt": self.filled("CMakeLists.txt"),
            f"{self.name}.pc": self.filled("arm.pc"),
        }

    def filled(self, file: str, **more: str) -> str:
        """Fill the template `file` with this library's values and the values in `more`; return the text."""
        return fill(file, self.name, self._known | more)

    # --- the numbers ------------------------------------------------------------------------------
    @cached_property
    def _known(self) -> dict[str, Any]:
        """Return the values of the template marks: sizes, byte offsets in the memory image, units and comments."""
        batch, plan, world = self.batch, self.plan, self.worlds[0]
        # byte offsets of the program's arrays in world 0, and entries of a request
        at, request = {key: place[0] for key, place in world.places.items()}, REQUEST.offsets(0, self.joints, 0)
        targets = self.joints if self.aims_at_joints else len(batch.task.targets)
        near, far = self.reach
        meant = MEANT[plan.kind.target.numbers].format(near=near, far=far)
        known = {
            "HEAD": self._head(), "VERSION": VERSION, "JOINTS": self.joints, "OBSERVATION": batch.observation.size,
            "PERIOD": repr(plan.period), "STATE": world.changing, "CLIP": f"{CLIP:g}", "GIVEN": targets,
            "TARGET": meant, "ACTION": self._action(),
            "FROM": "" if self.aims_at_joints else "; angles from the world's x axis",
            "ENTRIES": _listed(_entries(self.setup)), "STATUSES": self._statuses(), "SENTENCES": self._sentences(),
            "INFO": _members(INFO, self.sizes, {"energies": ENERGIES}), "POSE": _members(self.poses, {}, {}),
            "DECLARED": "\n".join(f"extern int64_t {symbol}(int64_t, int64_t, int64_t);" for symbol in self.symbols),
            "TABLES": "\n".join(self._tables()), "WORLDS": len(self.worlds), "REQUEST": at["request"],
            "RECORD": at["block"] + 8 * batch.layout.record, "ANGLES": request.angles,
            "TARGET_AT": getattr(request, batch.task.given), "VIBRATION": request.vibration,
            "STREAM": at["stream"], "QUEUE": at["queue"], "ALLOWED": PERIODS_ALLOWED,
            "MODE": MODE, "PERIODS": PERIODS, "TABLE": at["table"], "POSES": at["block"] + 8 * batch.layout.poses,
            "SEEN": at["observation"], "BLOCK": at["block"],
            "ACTION_AT": at["action"],
            **dict(zip(("FARTHEST", "FAR_TARGET", "FAR_VIBRATION"), map(number, self.farthest), strict=True)),
            "POINT": int(self.point), "NEAR": number(near), "FAR": number(far),
            "CPU": self.cpu, "PARAMETERS": len(self.parameters), **self._settable(at["block"]),
            "OBJECTS": " ".join(f"{symbol}.o" for symbol in self.symbols),
        }  # fmt: skip
        return known

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers that determine the memory layout `INFO`: links, target coordinates, reward terms and others."""
        task = self.batch.task
        counts = {"links": task.links, "targets": task.targets, "terms": task.terms, "further": task.further}
        return {key: len(value) for key, value in counts.items()}

    @property
    def point(self) -> bool:
        """True if the target is a point in the plane (m), False if it is an angle (rad)."""
        return not self.aims_at_joints and len(self.batch.task.targets) > 1

    @property
    def aims_at_joints(self) -> bool:
        """True if a reset defines the target by joint angles."""
        return bool(self.batch.task.given == "goals")

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest distance (m) of a target from the root; zeros if the target is not a point."""
        near, far = reach(self.plan.arm) if self.point else (0.0, 0.0)
        return float(near), float(far)

    @property
    def farthest(self) -> tuple[float, float, float]:
        """Largest joint angle (rad), target coordinate (m or rad) and `initial_vibration` that a reset accepts."""
        plan = self.plan
        angle = min(plan.farthest, 1e6)
        return angle, plan.arm.total_length if self.point else angle, 0.0 if plan.starts.shake is None else 0.5

    def _most(self) -> tuple[float, ...]:
        """Return the largest values of an arm's own parameters that double precision can resolve (`physics.precision`).

        The result has one value for each entry of `model.OWN_IN_SPACE`: payload mass (kg), inertia, factor on EI,
        tau_d (s), factors on EI_y and GJ.
        """
        batch = self.batch
        largest = 10.0 * (batch.arm.damping[0] or LEAST_DAMPED) * batch.starts.drawn["damping"][1]

        # whether double precision resolves the arm with this stiffness factor and tau_d
        def carried(factor: float, damping: float) -> bool:
            """Return whether double precision resolves the arm with a factor on its stiffness and a tau_d, s."""
            factors = dict.fromkeys(STIFFNESSES, factor)
            try:
                precision.check_parameters(batch.arm, batch.settings, factors, damping, 0.0, "")
            except check.InvalidValue:
                return False
            return True

        # largest damping first, then bisection for the exponent of the largest stiffness factor 2^x
        damping = next((x for x in (largest, 0.2 * largest) if carried(2.0, x)), 0.1 * largest)
        # bisection: 50 halvings of the exponent's interval [0, 60]
        low, high = 0.0, 60.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if carried(2.0**middle, damping) else (low, middle)
        return check.LARGEST, check.LARGEST, 2.0**low, damping, 2.0**low, 2.0**low

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Parameters that a user of the library may set between control periods."""
        batch, system = self.batch, self.batch.system
        # the arm's own numbers, in the order of its `par`
        found = []
        for k, (name, most) in enumerate(zip(batch.reading.own, self._most(), strict=False)):
            unit, meaning = batch.reading.meanings[name]
            least = LEAST if name.endswith("_factor") else 0.0
            found.append(Parameter(name, unit, meaning, float(system.par[k]), least, most, None, batch.layout.par + k))
        # factor on the motors' torques, in the arm's record
        factor = batch.layout.record + TORQUE_FACTOR
        found.append(Parameter("torque_factor", "", "on the motors' torques", 1.0, 0.0, check.LARGEST, None, factor))
        # parameters of the joints: gear stiffness, damping, rotor inertia, friction; entries that are 0 are absent
        if not isinstance(system.model, Jointed):
            return found
        stiffest, drawn = precision.MOST * min(self.plan.arm.torque_limits), system.model.own is not None
        for k, value in enumerate(system.model.data.tolist()):
            # data is a table: a row of `LAW` per joint with a drive
            i, number = divmod(k, len(LAW.fields))
            field, joint = LAW.fields[number], int(system.model.table[i * PLACES])
            if value == 0.0:  # what the arm has not
                continue
            least = LEAST if field.name in ("stiffness", "rotor") else 0.0
            most = stiffest if field.name == "stiffness" else check.LARGEST
            # drawn per episode: entry of the arm's block; otherwise entry k of the model's data
            at = batch.layout.par + len(system.model.own or ()) + k
            about = f"{field.name}[{joint}]", field.unit.replace("^", ""), f"of joint {joint}: {field.meaning}", value
            found.append(Parameter(*about, least, most, None if drawn else k, at if drawn else 0))
        return found

    def _laws(self, world: int, first: str) -> list[int]:
        """Return the byte offsets of the joints' parameters in each model of a memory image (world). first: pattern of
        the names' prefix.
        """
        known = self.worlds[world].places.items()
        return [place[0] for key, place in known if re.fullmatch(rf"{first}(model|models\.\w+)\.data", key)]

    # --- the texts --------------------------------------------------------------------------------
    def _settable(self, block: int) -> dict[str, Any]:
        """Return the template values of the parameters: offsets, limits, list for the header, and copies to keep equal.

        A joint's parameter has a copy in every model of the program; there is one model for each step size.
        """
        copies = [(k, at + 8 * p.law) for k, p in enumerate(self.parameters) if p.law is not None
                  for at in self._laws(0, "")]  # fmt: skip
        # the first copy is the parameter's place; a user's change is copied to the others
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
        """Return the header's first comment: environment, version, formulation, dt (s) and processor."""
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
        """Return a sentence with the meaning of the action's entries."""
        mode, limits = self.plan.action_mode, ", ".join(f"{x:g}" for x in self.plan.arm.torque_limits)
        means = f"torques over {limits} N m" if mode == "torque" else f'what action_mode="{mode}" takes'
        return f"{means}."

    def _statuses(self) -> str:
        """Return the #define lines of the status codes."""
        words = {int(code): word or "ok" for code, word in REASONS.items()}
        return "\n".join(f"#define UPPER_{word.upper()} {code}" for code, word in words.items())

    def _sentences(self) -> str:
        """Return the C case lines that map a status code to its sentence."""
        rows = (f"    case UPPER_{word.upper()}: return {json.dumps(text)};" for word, text in SENTENCES.items())
        return "\n".join(rows)

    def _torques(self, file: str) -> str:
        """Return the text of the C function `NAME_step_torques`, with inputs in N m, or "" if actions are not
        torques.
        """
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
            "    for (int k = 0; k < UPPER_JOINTS; k++) /* clipped: a large torque over its limit overflows */\n"
            "        action[k] = isfinite(torque[k]) && fabs(torque[k]) > limits[k] ? copysign(1.0, torque[k])"
            " : torque[k] / limits[k];\n"
            "    return NAME_step(arm, action);\n}\n"
        )

    @property
    def _declared(self) -> str:
        """Return the declarations of the derivatives for the header; "" without derivatives."""
        if self.periods is None:
            return ""
        names = [f" *   {k}: {name}" for k, name in enumerate(self.periods.names)]
        return self.filled("derivatives.h", STATES="\n".join(names), S=str(self.periods.state_size))

    @property
    def _derived(self) -> str:
        """Return the definitions of the derivatives for the C file; "" without derivatives."""
        if self.periods is None:
            return ""
        p, world = self.periods, self.worlds[1]
        at = {f"D_{key.upper()}": str(place[0]) for key, place in world.places.items() if "." not in key}
        # byte pairs (to, from): the derivatives' world copies the joints' parameters from world 0
        laws = [p.law for p in self.parameters if p.law is not None]
        shared = [(8 * k + to, 8 * k + self._laws(0, "")[0]) for k in laws for to in self._laws(1, r"program\.")]
        return self.filled(
            "derivatives.c", MOVING=str(p.moving), COLUMNS=str(p.moving + p.action_size),
            D_CHANGING=str(world.changing), PLACES=", ".join(map(str, p._own.tolist())),
            BACKWARDS=str(int(p.backwards)), SHARING=str(len(shared)),
            SHARED=", ".join(f"{{{to}, {of}}}" for to, of in shared) or "{0, 0}", **at,
        )  # fmt: skip

    def _tables(self) -> Iterator[str]:
        """Yield the C text of each memory image (words, pointers to relocate, and data), then of a table of the
        images.
        """
        rows = []
        for k, world in enumerate(self.worlds):
            # pointers: word `word` is to hold the address of byte `byte` of the data
            data = np.frombuffer(world.data, np.uint64).tolist()
            words = [word % 2**64 for word in world.words]
            pairs = [f"{{{word}, {byte}}}" for word, byte in world.pointers]
            yield f"static const uint64_t words{k}[] = {{\n{_rows(f'{word:#x}u' for word in words)}\n}};"
            yield f"static const uint32_t pointers{k}[][2] = {{\n{_rows(pairs)}\n}};"
            yield f"static const uint64_t data{k}[] = {{\n{_rows(f'{word:#x}u' for word in data)}\n}};"
            rows.append(f"    {{words{k}, {len(words)}, pointers{k}, {len(pairs)}, data{k}, {len(world.data)}}},")
        yield "static const world worlds[] = {\n" + "\n".join(rows) + "\n};"


def _members(layout: Layout, sizes: dict[str, int], inner: dict[str, Layout]) -> str:
    """Return the members of a C struct, all double, for a layout; `inner` gives the layouts of nested structs."""
    lines = []
    for field, shape in zip(layout.fields, layout.shapes(**sizes), strict=True):
        if field.name in inner:
            lines += [f"    struct {{\n{_members(inner[field.name], {}, {})}\n    }} {field.name};"]
        elif all(shape):
            shape = flat(shape)
            meaning = MEANINGS.get(field.name, field.meaning)
            told = ", ".join(part for part in (field.unit, meaning) if part)
            name = field.name + "".join(f"[{length}]" for length in shape)
            lines.append(f"    double {name};" + (f" /* {told} */" if told else ""))
    return "\n".join(lines)


def flat(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of an entry of `info`; a first axis of length 1 is omitted."""
    return shape[1:] if len(shape) == 2 and shape[0] == 1 else shape


def _entries(setup: Setup) -> list[str]:
    """Return one line for each number observed at an instant: index, name and scale."""
    # stacked instants repeat the list of entries
    past = "" if setup.history == 1 else f", {setup.history} instants, the oldest first"
    return [f"{k}: {n} / {s:.9g}{past}" for k, (n, s) in enumerate(zip(setup.names, setup.scales, strict=True))]


def _listed(lines: Iterable[str], start: str = " *   ") -> str:
    """Format lines as a C comment, each after `start`."""
    return "\n".join(f"{start}{harmless(line)}" for line in lines)


def _rows(words: Iterable[str]) -> str:
    """Format words as C initializers, six per line."""
    found = list(words)
    return ",\n".join("    " + ", ".join(found[k : k + 6]) for k in range(0, len(found), 6))


def number(value: float) -> str:
    """Format a double as a C literal of exactly this value."""
    return repr(float(value))
