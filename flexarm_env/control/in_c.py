"""Export a controller as one C file, in double precision.

Python designs the controller (Riccati equations, modes, a linear program). The C file contains the resulting numbers
and computes the actions of `Controller.act` in each control period. The C file is composed of the C fragments in
`data/control/c`. Gains that depend on an arm's posture are tabulated for all requested postures, in steps of
`arm_model.GRID`.
"""

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .. import validation as check
from ..bodies import vector
from ..rigid import axis_of, link_inertia, mount_of
from ..validation import Array
from .arm_model import GRID, postures
from .base import Controller
from .export import c_array, c_comment, c_named, c_part
from .force import PressController
from .lqg import FARTHEST, LEARNING, LQG, SHARP, Design, SpatialLQG, SpatialLQR, plant_in_space
from .lqg import design as lqg_design
from .lqr import LQR
from .lqr import design as lqr_design
from .pd import PD, SpatialPD
from .shaping import Shaped, ShapedPD, Shaper, SpatialShapedPD, closed_loop_shaper, shaper_in_space
from .space import NEAR, AboutRest
from .time_optimal import TimeOptimal, slew_plan

Pairs = Sequence[tuple[float, float]]
Points = Sequence[Sequence[float]]

Held = list[tuple[float, ...]]
_Tables = tuple[Held, dict[str, Any], list[str]]
"""Postures with tabulated gains; values by name (arrays become C tables, single numbers sizes); source fragments."""

MOST = 1000
"""Largest number of postures in a file, mirror images not counted."""


def controller_source(
    controller: Controller, name: str, slew: float | None = None, elbows: Pairs | None = None,
    targets: Points | None = None, inside: bool = False,
) -> str:  # fmt: skip
    """Generate a controller as one C99 file without `main`, in double precision, without memory allocation.

    Args:
        controller: result of `control.make`. name: prefix of the file's definitions. NAME_act maps values in SI units
            to actions, once per control period. NAME_decide maps the environment's observation to actions. NAME_reset
            begins an episode.
        slew: for TimeOptimal only: angle, rad, of a slew; the file contains the plans for this slew to either side.
        elbows: range (low, high), rad, of each elbow's angle at the goal (for LQG also during the motion) for which
            gains are tabulated. For a posture that is not tabulated the controller uses the gains of the nearest
            tabulated posture. None: the full range of a two-link arm.
        targets: for an arm in space: targets (x, y, z), m. The file contains the static equilibrium at each of the
            targets; the search for an equilibrium starts from joint angles 0. The controller replaces any other target
            by the nearest target in the file.
        inside: True if the file is part of another policy: NAME_act and NAME_decide then have the additional argument
            `const double *beside` before the actions. The argument `beside` contains the other policy's actions, one
            per joint, which the controller adds to its own actions before the saturation.
    Raises:
        ValueError: the controller is MPC, which optimizes in each period, or a controller of a contact force; slew is
            missing; elbows are missing for three links or more; targets are missing for an arm in space, or the arm has
            no equilibrium at a target.
    """
    kind = type(controller)
    if isinstance(controller, PressController):
        what = "must be a controller without contact: those of a contact force solve for the arm at rest in each period"
        raise check.InvalidValue("controller", kind.__name__, what)
    if kind not in _BODIES:
        what = "must be pd, zv, zvd, lqr, lqg or time_optimal: others optimize in each period"
        raise check.InvalidValue("controller", kind.__name__, what)
    setup, read = controller.setup, controller.read
    aimed = read.aimed
    held, known, parts = _TABLES[kind](controller, slew, elbows, targets)
    sizes = {word: value for word, value in known.items() if isinstance(value, int | float)}
    places = {"SINES": read._sin, "COSINES": read._cos, "RATES": read._rates, "GAUGES": read._gauges}
    places |= {"BENDS": read._bends, "BEND_RATES": read._bend_rates, "ERRORS": read._goals if aimed else read._error}
    declared = {"JOINTS": setup.n_joints, "ENTRIES": len(setup.names), "HISTORY": setup.history, **sizes}
    texts = [c_part("memory").replace("FIELDS", _FIELDS[kind]), *map(c_part, (*parts, *_BODIES[kind], "act"))]
    body = "\n".join(texts).replace("GAUGED", _GAUGED if read._gauges else "").replace("SHARP", repr(SHARP))
    for word, text in _BESIDE.items():
        body = body.replace(word, text if inside else "")
    body = body if held else body.replace(_NEAREST, "")
    body = body.replace("TOLD", c_part("told_joints" if aimed else "told_way").strip())
    body = body.replace("SEEN", _BENDS if kind is SpatialLQR else _CURVATURES if read._gauges else "")
    body = body.replace("GOAL", c_part("goal_two" if setup.n_joints == 2 else "goal_many"))
    # declare only the arrays that the code uses
    numbers = [_array(word, values) for word, values in known.items() if re.search(rf"(NAME_|OF\(){word}\b", body)]
    numbers += [_places(word, values) for word, values in places.items() if f"NAME_{word.lower()}[" in body]
    text = "\n".join([
        _head(controller, slew, held), "#include <math.h>", "",
        *(f"#define UPPER_{word} {value}" for word, value in declared.items()),
        f"#define UPPER_PERIOD {setup.control_dt!r} /* s, of control */", "", *numbers, "", body,
    ])  # fmt: skip
    return c_named(text, name)


def _postures(own: Controller, elbows: Pairs | None) -> Held:
    """List the postures (elbow angles, rad) with tabulated gains, mirror images merged.

    elbows: (low, high), rad, per elbow; None: the joint limits, or a full turn, of a two-link arm.
    """
    arm, count = own.setup.arm, own.setup.n_joints - 1
    if elbows is None and count > 1:
        what = f"must be {count} pairs (low, high), rad, an elbow each: gains are held for postures {GRID:g} rad apart"
        raise check.InvalidValue("elbows", elbows, what)
    if elbows is None:
        elbows = [(-math.pi, math.pi) if one is None else one for one in (arm.joint_limits or (None, None))[1:]][:count]
    ranges = []
    for k, pair in enumerate(check.sequence("elbows", elbows, f"{count} pairs (low, high), rad", count)):
        ends = check.sequence(f"elbows[{k}]", pair, "two numbers (rad), (low, high)", 2)
        low, high = (check.number(f"elbows[{k}]", end, "rad", minimum=-7.0, maximum=7.0) for end in ends)
        if low > high:
            raise check.InvalidValue(f"elbows[{k}]", (low, high), "must be (low, high) with low at most high")
        ranges.append(GRID * np.arange(round(low / GRID), round(high / GRID) + 1))
    asked = math.prod(map(len, ranges))
    if asked > 2 * MOST:
        raise check.InvalidValue(
            "elbows", f"{asked} postures", f"must be narrower: {2 * MOST} at most, {GRID:g} rad apart"
        )
    return list(dict.fromkeys(postures(np.array([(0.0, *row) for row in itertools.product(*ranges)]))))


def _in_space(own: Controller, slew: float | None, elbows: Pairs | None, targets: Points | None) -> _Tables:
    """Collect the tables and sizes of a controller in space: rigid bodies and axes, gains, rests at the targets."""
    if elbows is not None:
        raise check.InvalidValue("elbows", elbows, "must be left out: gains in space are those at the targets")
    assert isinstance(own, AboutRest)
    arm, N = own.setup.arm, own.setup.n_joints
    points = check.sequence("targets", () if targets is None else targets, "points (x, y, z), m, of the tip")
    if not points:
        raise check.InvalidValue("targets", targets, "must be the controller's targets, points (x, y, z) in m")
    rests = []
    for i, point in enumerate(points):
        target = np.array(vector(f"targets[{i}]", point, "m"))
        off, *rest = own.rest_at(target, np.zeros(N))
        if off > NEAR * arm.total_length:
            raise check.InvalidValue(f"targets[{i}]", point, f"must be where the tip can rest: {off:.3g} m away")
        rests.append((target, *rest))
    where, angles, torques = map(np.array, zip(*rests, strict=True))
    parts = own.bodies
    found = {
        "limit": own.limits, "scale": np.array(own.setup.scales), "length": [link.span for link in arm.links],
        "hinge": [axis_of(arm, k) for k in range(N)], "mount": [mount_of(arm, k) for k in range(N)],
        "rotor": [arm.joint(k).rotor for k in range(N)],
        "carrier": [float(k) for k in range(N)], "mass": [part.mass for part in parts],
        "centre_of": [part.centre for part in parts], "tensor": [part.inertia for part in parts],
        "gravity": own.gravity, "target": where, "rest": angles, "rest_torque": torques,
        "TARGETS": len(points), "BODIES": len(parts),
    }  # fmt: skip
    for table in _IN_SPACE[type(own)]:
        found |= table(own, angles)
    return [], found, []


def _rate_filter(own: Any, angles: Array) -> dict[str, Any]:
    """Collect the PD gains and the rate filter. angles (targets, N): joint angles at rest, rad."""
    gains = own.gains
    return {"filter": [own.passed, gains.rate**2, 2.0 * gains.ratio * gains.rate]}


def _shapers(own: Any, angles: Array) -> dict[str, Any]:
    """Collect the impulses of the shaper at each rest."""
    shapers = [shaper_in_space(own.setup.arm, own.gravity, own.shaped, own.kind, angle) for angle in angles]
    return _impulses(shapers, own.shaped.effort * own.limits)


def _designs(own: Any, angles: Array) -> dict[str, Any]:
    """Collect the regulator and filter designs at each rest."""
    plants, N = [plant_in_space(own.setup, own.gravity, angle) for angle in angles], own.setup.n_joints
    designs = [own.design(one) for one, _ in plants]
    still = np.array([own.resting(y) for _, y in plants])
    if type(own) is SpatialLQG:
        still[:, N:] += own.centres
    found = _filters(own, designs) | {"still": still, "pull": np.stack([d.K @ d.rigid for d in designs])}
    return found | {"FARTHEST": FARTHEST, "BENT": len(own.read._bends)}


def _filters(own: LQG, filters: Sequence[Design]) -> dict[str, Any]:
    """Collect the tables of all regulator and filter designs, and their sizes."""
    found: dict[str, Any] = {word: np.stack([getattr(e, word) for e in filters]) for word in (*"ABCKL", "rigid")}
    found |= {"by_state": np.stack([e.stopping @ e.A for e in filters]), "coulomb": own.friction}
    found |= {"by_torque": np.stack([e.stopping @ e.B for e in filters])}
    return found | {"STATES": len(filters[0].A), "OUTPUTS": len(filters[0].C), "LEARNING": LEARNING}


def _impulses(shapers: Sequence[Shaper], effort: Array) -> dict[str, Any]:
    """Collect the tables of the shapers, padded with zeros.

    effort (N,): torques, N m, that references may use.
    """
    most = max(len(one.delays) for one in shapers)
    found: dict[str, Any] = {"effort": effort, "IMPULSES": most}
    for word, rows in (("amplitude", [s.amplitudes for s in shapers]), ("delay", [s.delays for s in shapers])):
        found[word] = [row + (0.0,) * (most - len(row)) for row in rows]
    return found


def _in_plane(own: Controller, slew: float | None, elbows: Pairs | None, targets: Points | None) -> _Tables:
    """Collect the tables, sizes and source fragments of a planar controller. slew: slew of TimeOptimal, rad."""
    if targets is not None:
        raise check.InvalidValue("targets", targets, "requires an arm in space")
    setup, aimed, same = own.setup, own.read.aimed, isinstance(own, PD)
    if same and elbows is not None:
        raise check.InvalidValue("elbows", elbows, "must be left out: gains of PD are the same in all postures")
    held = [] if same else _postures(own, elbows)
    parts = [] if same else ["times"]
    if isinstance(own, ShapedPD) or (setup.n_joints == 2 and not aimed):
        parts.append("rigid")
    parts.append("aim_joints" if aimed else "aim_point" if setup.n_joints > 1 else "aim_tip")
    parts += ["posture"] if held else []
    arm, inertia = setup.arm, link_inertia(setup.arm)
    ranges = [(-np.inf, np.inf) if one is None else one for one in arm.joint_limits or (None,) * arm.n_links]
    found: dict[str, Any] = {
        "limit": own.limits, "scale": np.array(setup.scales), "along": inertia.real, "across": inertia.imag,
        "length": [link.span for link in arm.links], "rotor": [arm.joint(k).rotor for k in range(arm.n_links)],
        "turned": [link.turn for link in arm.links[:-1]], "range": np.clip(ranges, -1e300, 1e300),
        "posture": np.rint(np.array(held) / GRID),
    }  # fmt: skip
    found |= {"POSTURES": len(held), "GRID": GRID} if held else {}
    # tables have one row per posture
    if isinstance(own, PD | ShapedPD):
        found |= {"kp": own.kp, "kd": own.kd}
    if isinstance(own, ShapedPD):
        shapers = [closed_loop_shaper(arm, own.gains, own.kind, posture) for posture in held]
        found |= _impulses(shapers, own.gains.effort * own.limits)
    if isinstance(own, LQR):
        designs = [lqr_design(arm, setup.torque_limits, setup.control_dt, own.gains, posture) for posture in held]
        found |= {word: np.stack([getattr(d, word) for d in designs]) for word in "ABCKL"}
        found["start"] = np.stack([d.model.state_of(np.eye(len(d.C))).T for d in designs])
        found |= {"STATES": len(designs[0].A), "OUTPUTS": len(designs[0].C)}
    if isinstance(own, TimeOptimal):
        if slew is None:
            raise check.MissingKey("slew", "the angle, rad, of the slews that the plan of time_optimal covers")
        way = check.number("slew", slew, "rad, of the plan", above=0.0, maximum=2.0 * np.pi)
        known = slew_plan(setup, way, own.effort, own.gains.flexible)
        found |= {"plan": known.torques, "way": known.states[:-1], "PERIODS": known.periods}
    if isinstance(own, LQG):
        filters = [lqg_design(setup, own.gains, posture) for posture in held]
        found |= _filters(own, filters) | {"centre": own.centres}
    return held, found, parts


def _head(own: Controller, slew: float | None, held: Held) -> str:
    """Generate the comment at the top of a controller's C file."""
    setup = own.setup
    limits = ", ".join(f"{limit:g}" for limit in own.limits)
    kind = f"{type(own).__name__}, {own.kind}" if isinstance(own, Shaped) else type(own).__name__
    planned = f" by a plan for slews of {slew:g} rad to either side" if isinstance(own, TimeOptimal) else ""
    ends = zip(np.min(held, axis=0), np.max(held, axis=0), strict=True) if held else ()
    told = " and ".join(f"from {low:g} to {high:g} rad" for low, high in ends)
    lines = [
        f"NAME: {kind}{planned}, for the arm {setup.arm.name}",
        "written by flexarm_env. C99, double, no allocation, no state but what the caller holds.",
        "",
        "  void NAME_reset(NAME_memory *memory)",
        "      before an episode",
        "  void NAME_act(NAME_memory *memory, const double measured[UPPER_ENTRIES], float action[UPPER_JOINTS])",
        "      what is measured now, in SI units, to actions; once a control period (0 where a number is not finite)",
        "  void NAME_decide(NAME_memory *memory, const float observation[UPPER_HISTORY * UPPER_ENTRIES],",
        "                   float action[UPPER_JOINTS])",
        "      the same from the environment's observation, the newest instant last",
        "",
        *(
            [f"Gains are held for {len(held)} postures, the elbows {told}; others take those of the nearest."]
            if told
            else []
        ),
        *(
            ["It holds static rests at the points NAME_target (m); another target is taken for the nearest of them."]
            if isinstance(own, AboutRest)
            else []
        ),
        f"Actions lie in [-1, 1]: the joints' torques over {limits} N m. A control period is {setup.control_dt:g} s.",
        "Entries of an instant, value / scale:",
        *(f"    {k}: {one} / {x:.9g}" for k, (one, x) in enumerate(zip(setup.names, setup.scales, strict=True))),
    ]
    return c_comment(lines)


def _array(name: str, values: Array) -> str:
    """Format a double array's declaration, five numbers per line, to full precision."""
    return c_array("double", name, [f"{value:.17g}" for value in np.ravel(values).tolist()], 5)


def _places(name: str, values: list[int]) -> str:
    """Format the declaration of an array with the positions of observation entries."""
    return f"static const int NAME_{name.lower()}[{len(values)}] = {{{', '.join(map(str, values))}}};"


_GAUGED = (
    "for (int i = UPPER_JOINTS; i < UPPER_OUTPUTS; i++)\n        "
    "y[i] = v[NAME_gauges[i - UPPER_JOINTS]] - NAME_centre[i - UPPER_JOINTS];"
)

_BESIDE = {
    "BESIDE_ARGUMENT": "const double *beside, ", "BESIDE_VALUE": "beside, ",
    "BESIDE_ADDED": "        torque[i] += beside[i] * NAME_limit[i];\n",
}  # fmt: skip
_NEAREST = "        memory->posture = NAME_nearest(memory->goal);\n"
_CURVATURES = "for (int i = UPPER_JOINTS; i < UPPER_OUTPUTS; i++) y[i] = v[NAME_gauges[i - UPPER_JOINTS]];"
_BENDS = """for (int i = 0; i < UPPER_JOINTS; i++) y[UPPER_JOINTS + i] = v[NAME_rates[i]];
    for (int i = 0; i < UPPER_BENT; i++) {
        y[2 * UPPER_JOINTS + i] = v[NAME_bends[i]];
        y[2 * UPPER_JOINTS + UPPER_BENT + i] = v[NAME_bend_rates[i]];
    }"""
_KEPT = "    double x[UPPER_STATES], torque[UPPER_JOINTS], held[UPPER_JOINTS];\n"
_MOVE = "    double move[UPPER_JOINTS], period;\n"
_PULLED = "    double rate[UPPER_JOINTS], torque[UPPER_JOINTS], inertia[UPPER_JOINTS];\n"

_FIELDS: Mapping[type[Controller], str] = {
    PD: "", ShapedPD: _MOVE, LQR: "    double x[UPPER_STATES];\n", LQG: "    double x[UPPER_STATES];\n",
    TimeOptimal: "    double x[UPPER_STATES], sign;\n",
    SpatialPD: _PULLED, SpatialShapedPD: _PULLED + _MOVE, SpatialLQR: _KEPT, SpatialLQG: _KEPT,
}  # fmt: skip

_BODIES: Mapping[type[Controller], tuple[str, ...]] = {
    PD: ("unshaped", "pd"), ShapedPD: ("coriolis", "reference", "pd"), LQR: ("observer", "outputs", "lqr"),
    LQG: ("observer", "friction", "lqg"), TimeOptimal: ("observer", "outputs", "planned"),
    SpatialPD: ("space", "unshaped", "space_pd"),
    SpatialShapedPD: ("times", "space", "space_rigid", "reference", "space_pd"),
    **dict.fromkeys((SpatialLQR, SpatialLQG), ("times", "space", "observer", "friction", "space_lqg")),
}  # fmt: skip
"""Source fragments of each class for three purposes: start of an episode, control period, and update with the applied
torque."""

_IN_SPACE: Mapping[type[Controller], tuple[Callable[..., dict[str, Any]], ...]] = {
    SpatialPD: (_rate_filter,), SpatialShapedPD: (_rate_filter, _shapers),
    SpatialLQR: (_designs,), SpatialLQG: (_designs,),
}  # fmt: skip
"""Functions that collect a controller's gains at the rests of an arm in space."""

_TABLES: Mapping[type[Controller], Callable[..., _Tables]] = {
    **dict.fromkeys((PD, ShapedPD, LQR, LQG, TimeOptimal), _in_plane),
    **dict.fromkeys((SpatialPD, SpatialShapedPD, SpatialLQR, SpatialLQG), _in_space),
}
"""Functions that collect a controller's tables."""
