"""Controllers for other machines: one C file each, in double precision, with the numbers of the Python class.

What a design asks of SciPy, Riccati equations, modes, a linear programme, is solved here; the file holds what comes of
it, and does in a control period what `Controller.act` does. Arms of one link; PD of any number, where the observation
has the joints' errors (observation="measured").
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from .base import Controller
from .kinematics import rigid_inertia
from .lqg import LEARNING, LQG, SHARP
from .lqg import design as lqg_design
from .lqr import LQR
from .lqr import design as lqr_design
from .pd import PD
from .shaping import ShapedPD, closed_loop_shaper
from .time_optimal import TimeOptimal, plan, rigid_time

Array = NDArray[np.float64]


def controller_source(controller: Controller, name: str, slew: float | None = None) -> str:
    """A controller as one C99 file without `main`: double, arrays of fixed size, no allocation.

    Args:
        controller: of `control.make`. name: in front of what the file defines: NAME_reset, NAME_act (values in SI units
            to actions, once a control period), NAME_decide (the same from the environment's observation), ...
        slew: rad, of TimeOptimal: the slew, to either side, whose plan the file holds.
    Raises:
        ValueError: MPC, which solves a programme in each period; an arm of more links than can be; no slew.
    """
    kind = type(controller)
    if kind not in _BODIES:
        raise check.InvalidValue("controller", kind.__name__, "must be PD, ShapedPD, LQR, LQG or TimeOptimal")
    setup, n = controller.setup, controller.setup.n_joints
    if n > 1 and not (kind is PD and controller.read.aimed):
        what = 'must have one link, or be moved by PD with observation="measured"'
        raise check.InvalidValue("arm", setup.arm.name, what)
    arrays, sizes = _numbers(controller, slew)
    read = controller.read
    places = {"RATES": read._rates, "ERRORS": read._goals if read.aimed else read._error, "GAUGES": read._gauges}
    places |= {"BENDS": read._bends, "BEND_RATES": read._bend_rates}
    declared = {"JOINTS": n, "ENTRIES": len(setup.names), "HISTORY": setup.history, **sizes}
    body = "\n".join([_MEMORY.replace("FIELDS", _FIELDS[kind]), _TO_GO[read.aimed], *_BODIES[kind], _ACT])
    body = body.replace("GAUGED", _GAUGED if read._gauges else "")
    numbers = [_array(word, values) for word, values in arrays.items() if re.search(rf"NAME_{word}\b", body)]
    numbers += [_places(word, values) for word, values in places.items() if f"NAME_{word.lower()}[" in body]
    text = "\n".join([
        _head(controller, slew), "#include <math.h>", "",
        *(f"#define UPPER_{word} {value}" for word, value in declared.items()),
        f"#define UPPER_PERIOD {setup.control_dt!r} /* s, of control */", "", *numbers, body,
    ])  # fmt: skip
    return re.sub("NAME|UPPER", lambda word: name if word[0] == "NAME" else name.upper(), text)


def _numbers(own: Controller, slew: float | None) -> tuple[dict[str, Array], dict[str, int]]:
    """What the file holds, and the sizes of it."""
    setup = own.setup
    found: dict[str, Array] = {"limit": own.limits, "scale": np.array(setup.scales)}
    sizes: dict[str, int] = {}
    if isinstance(own, PD | ShapedPD):
        found |= {"kp": own.kp, "kd": own.kd}
    if isinstance(own, ShapedPD):
        shaper = closed_loop_shaper(setup.arm, own.gains, own.kind, ())
        found |= {"amplitude": np.array(shaper.amplitudes), "delay": np.array(shaper.delays)}
        found |= {"inertia": rigid_inertia(setup.arm, np.zeros((1, 0)))[0], "effort": own.gains.effort * own.limits}
        sizes["IMPULSES"] = len(shaper.delays)
    if isinstance(own, LQR):
        d = lqr_design(setup.arm, setup.torque_limits, setup.control_dt, own.gains)
        found |= {"A": d.A, "B": d.B, "C": d.C, "K": d.K, "L": d.L, "start": d.model.state_of(np.eye(4)).T}
        sizes |= {"STATES": len(d.A), "OUTPUTS": len(d.C)}
        if isinstance(own, TimeOptimal):
            way = check.number("slew", slew, "rad, of the plan", above=0.0, maximum=2.0 * np.pi)
            least = int(rigid_time(float(d.model.inertia[0, 0]), way, float(own.limits[0])) / setup.control_dt)
            start = d.model.state_of(np.array([-way, 0.0, 0.0, 0.0]))
            known = plan(d.A, d.B, start, own.effort * own.limits, max(1, least))
            found |= {"plan": known.torques, "way": known.states[:-1]}
            sizes["PERIODS"] = known.periods
    if isinstance(own, LQG):
        e = lqg_design(setup, own.gains, ())
        found |= {
            "A": e.A, "B": e.B, "C": e.C, "K": e.K, "L": e.L, "rigid": e.rigid, "centre": own.centres,
            "friction": own.friction, "by_state": e.stopping @ e.A, "by_torque": e.stopping @ e.B,
        }  # fmt: skip
        sizes |= {"STATES": len(e.A), "OUTPUTS": len(e.C), "LEARNING": LEARNING}
    return found, sizes


def _head(own: Controller, slew: float | None) -> str:
    setup = own.setup
    limits = ", ".join(f"{limit:g}" for limit in own.limits)
    kind = f"{type(own).__name__}, {own.kind}" if isinstance(own, ShapedPD) else type(own).__name__
    planned = f" by a plan for slews of {slew:g} rad to either side" if isinstance(own, TimeOptimal) else ""
    lines = [
        f"NAME: {kind}{planned}, for the arm {setup.arm.name}",
        "written by flexarm_env. C99, double, no allocation, no state but what the caller holds.",
        "",
        "  void NAME_reset(NAME_memory *memory)",
        "      before an episode",
        "  void NAME_act(NAME_memory *memory, const double measured[UPPER_ENTRIES], float action[UPPER_JOINTS])",
        "      what is measured now, in SI units, to actions; once a control period",
        "  void NAME_decide(NAME_memory *memory, const float observation[UPPER_HISTORY * UPPER_ENTRIES],",
        "                   float action[UPPER_JOINTS])",
        "      the same from the environment's observation, the newest instant last",
        "",
        f"Actions lie in [-1, 1]: the joints' torques over {limits} N m. A control period is {setup.control_dt:g} s.",
        "Entries of an instant, value / scale:",
        *(f"    {k}: {one} / {x:.9g}" for k, (one, x) in enumerate(zip(setup.names, setup.scales, strict=True))),
    ]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"])


def _array(name: str, values: Array) -> str:
    words = [f"{value:.17g}" for value in np.ravel(values).tolist()]
    rows = [", ".join(words[i : i + 5]) for i in range(0, len(words), 5)]
    return f"static const double NAME_{name}[{max(1, len(words))}] = {{\n    " + (",\n    ".join(rows) or "0") + "\n};"


def _places(name: str, values: list[int]) -> str:
    return f"static const int NAME_{name.lower()}[{len(values)}] = {{{', '.join(map(str, values))}}};"


_FIELDS: Mapping[type[Controller], str] = {
    PD: "", ShapedPD: "    double move, period;\n", LQR: "    double x[UPPER_STATES];\n",
    TimeOptimal: "    double x[UPPER_STATES], sign;\n", LQG: "    double x[UPPER_STATES];\n",
}  # fmt: skip

_MEMORY = """
typedef struct {
FIELDS    long step;
    int begun;
} NAME_memory;
"""

_TIMES = """
/* y = m x, (rows, columns) times (columns) */
static void NAME_times(const double *m, int rows, int columns, const double *x, double *y)
{
    for (int i = 0; i < rows; i++) {
        y[i] = 0.0;
        for (int j = 0; j < columns; j++) y[i] += m[i * columns + j] * x[j];
    }
}
"""

_TO_GO = {
    True: """
static double NAME_to_go(const double *v, int joint)
{
    return v[NAME_errors[joint]];
}
""",
    False: """
/* the straight arm's tip is where its hub points: a cantilever bent by its tip */
static double NAME_to_go(const double *v, int joint)
{
    const double b = v[NAME_bends[joint]], bend = b < -0.9 ? -0.9 : b > 0.9 ? 0.9 : b;
    return v[NAME_errors[joint]] + atan2(bend, 1.0 - 0.6 * bend * bend);
}
""",
}

_NOTHING = """
static void NAME_predict(NAME_memory *m, const double *torque) { (void)m; (void)torque; }
"""

_PD = """
static void NAME_begin(NAME_memory *m, const double *v) { (void)m; (void)v; }

static void NAME_torques(NAME_memory *m, const double *v, double *torque)
{
    (void)m;
    for (int i = 0; i < UPPER_JOINTS; i++)
        torque[i] = NAME_kp[i] * NAME_to_go(v, i) - NAME_kd[i] * v[NAME_rates[i]];
}
"""

_SHAPED = """
static void NAME_begin(NAME_memory *m, const double *v)
{
    m->move = NAME_to_go(v, 0);
    m->period = 2.0 * sqrt(fabs(NAME_inertia[0] * m->move) / NAME_effort[0]);
    if (m->period < 2.0 * UPPER_PERIOD) m->period = 2.0 * UPPER_PERIOD;
}

/* share of the move that is done at t, and its rate */
static void NAME_reference(const NAME_memory *m, double t, double *done, double *rate)
{
    *done = *rate = 0.0;
    for (int i = 0; i < UPPER_IMPULSES; i++) {
        const double y = (t - NAME_delay[i]) / m->period, x = y < 0.0 ? 0.0 : y > 1.0 ? 1.0 : y, left = 1.0 - x;
        *done += NAME_amplitude[i] * (x < 0.5 ? 2.0 * x * x : 1.0 - 2.0 * left * left);
        *rate += NAME_amplitude[i] * (x < 0.5 ? 4.0 * x : 4.0 * left) / m->period;
    }
}

static void NAME_torques(NAME_memory *m, const double *v, double *torque)
{
    double done, rate, later, unused;
    NAME_reference(m, m->step * UPPER_PERIOD, &done, &rate);
    NAME_reference(m, (m->step + 1) * UPPER_PERIOD, &unused, &later);
    torque[0] = NAME_inertia[0] * m->move * ((later - rate) / UPPER_PERIOD) +
                NAME_kp[0] * (NAME_to_go(v, 0) - m->move * (1.0 - done)) +
                NAME_kd[0] * (m->move * rate - v[NAME_rates[0]]);
}
"""

_OUTPUTS = """
static void NAME_outputs(const double *v, double *y)
{
    y[0] = -NAME_to_go(v, 0);
    y[1] = v[NAME_rates[0]];
    y[2] = v[NAME_bends[0]];
    y[3] = v[NAME_bend_rates[0]];
}
"""

_OBSERVER = """
/* take in what is measured: x += gain (y - C x) */
static void NAME_update(NAME_memory *m, const double *gain, double *y)
{
    double seen[UPPER_OUTPUTS], change[UPPER_STATES];
    NAME_times(NAME_C, UPPER_OUTPUTS, UPPER_STATES, m->x, seen);
    for (int i = 0; i < UPPER_OUTPUTS; i++) y[i] -= seen[i];
    NAME_times(gain, UPPER_STATES, UPPER_OUTPUTS, y, change);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] += change[i];
}

/* x = A x + B torque */
static void NAME_predict(NAME_memory *m, const double *torque)
{
    const double acts = ACTS;
    double next[UPPER_STATES];
    NAME_times(NAME_A, UPPER_STATES, UPPER_STATES, m->x, next);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] = next[i] + NAME_B[i] * acts;
}
"""

_LQR = """
static void NAME_begin(NAME_memory *m, const double *v)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, y);
    NAME_times(NAME_start, UPPER_STATES, UPPER_OUTPUTS, y, m->x);
}

static void NAME_torques(NAME_memory *m, const double *v, double *torque)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, y);
    NAME_update(m, NAME_L, y);
    NAME_times(NAME_K, 1, UPPER_STATES, m->x, torque);
    torque[0] = -torque[0];
}
"""

_PLANNED = """
static void NAME_begin(NAME_memory *m, const double *v)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, y);
    NAME_times(NAME_start, UPPER_STATES, UPPER_OUTPUTS, y, m->x);
    m->sign = y[0] > 0.0 ? -1.0 : 1.0;
}

static void NAME_torques(NAME_memory *m, const double *v, double *torque)
{
    double y[UPPER_OUTPUTS], off[UPPER_STATES];
    const int along = m->step < UPPER_PERIODS;
    NAME_outputs(v, y);
    NAME_update(m, NAME_L, y);
    for (int i = 0; i < UPPER_STATES; i++)
        off[i] = m->x[i] - (along ? m->sign * NAME_way[m->step * UPPER_STATES + i] : 0.0);
    NAME_times(NAME_K, 1, UPPER_STATES, off, torque);
    torque[0] = (along ? m->sign * NAME_plan[m->step] : 0.0) - torque[0];
}
"""

_FRICTION = """
/* Coulomb friction over the next period: what stops the motor by its end, if it can */
static double NAME_taken(const NAME_memory *m, double torque, double sharp)
{
    double rate;
    NAME_times(NAME_by_state, 1, UPPER_STATES, m->x, &rate);
    const double stops = sharp * (rate + torque * NAME_by_torque[0]) / NAME_by_torque[0], most = NAME_friction[0];
    return stops < -most ? -most : stops > most ? most : stops;
}
"""

_LQG = """
static void NAME_begin(NAME_memory *m, const double *v)
{
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] = -NAME_to_go(v, 0) * NAME_rigid[i];
}

static void NAME_torques(NAME_memory *m, const double *v, double *torque)
{
    const long k = m->step < UPPER_LEARNING ? m->step : UPPER_LEARNING - 1;
    double y[UPPER_OUTPUTS];
    y[0] = -NAME_to_go(v, 0);
    GAUGED
    NAME_update(m, NAME_L + k * UPPER_STATES * UPPER_OUTPUTS, y);
    NAME_times(NAME_K, 1, UPPER_STATES, m->x, torque);
    torque[0] = -torque[0];
    torque[0] += NAME_taken(m, torque[0], SHARP);
}
"""

_ACT = """
void NAME_reset(NAME_memory *memory)
{
    memory->begun = 0;
}

void NAME_act(NAME_memory *memory, const double measured[UPPER_ENTRIES], float action[UPPER_JOINTS])
{
    double torque[UPPER_JOINTS];
    if (!memory->begun) {
        memory->begun = 1;
        memory->step = 0;
        NAME_begin(memory, measured);
    }
    NAME_torques(memory, measured, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        if (torque[i] > NAME_limit[i]) torque[i] = NAME_limit[i];
        if (torque[i] < -NAME_limit[i]) torque[i] = -NAME_limit[i];
        action[i] = (float)(torque[i] / NAME_limit[i]);
    }
    NAME_predict(memory, torque);
    memory->step++;
}

void NAME_decide(NAME_memory *memory, const float observation[UPPER_HISTORY * UPPER_ENTRIES],
                 float action[UPPER_JOINTS])
{
    double measured[UPPER_ENTRIES];
    for (int i = 0; i < UPPER_ENTRIES; i++)
        measured[i] = (double)observation[(UPPER_HISTORY - 1) * UPPER_ENTRIES + i] * NAME_scale[i];
    NAME_act(memory, measured, action);
}
"""


_TORQUE = _OBSERVER.replace("ACTS", "torque[0]")
_LEFT = _OBSERVER.replace("ACTS", "torque[0] - NAME_taken(m, torque[0], 1.0)")
_GAUGED = "for (int i = 1; i < UPPER_OUTPUTS; i++) y[i] = v[NAME_gauges[i - 1]] - NAME_centre[i - 1];"

_BODIES: Mapping[type[Controller], tuple[str, ...]] = {
    PD: (_PD, _NOTHING), ShapedPD: (_SHAPED, _NOTHING), LQR: (_TIMES, _OUTPUTS, _TORQUE, _LQR),
    TimeOptimal: (_TIMES, _OUTPUTS, _TORQUE, _PLANNED),
    LQG: (_TIMES, _FRICTION, _LEFT, _LQG.replace("SHARP", repr(SHARP))),
}  # fmt: skip
"""Of each class: what it does at the start of an episode, in a period, and with the torque that was applied."""


__all__ = ["controller_source"]
