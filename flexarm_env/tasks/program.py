"""Data of the compiled environment: layouts of an arm's memory, and `Program`, the tuple that holds everything."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..compiler import inlined, kernel
from ..layout import Field, Layout
from ..physics import model
from ..physics.layout import BOOKS
from ..physics.model import OWN, STATUS
from ..physics.obstacles import KeepOut
from .starts import FACTORS, Ranges

PARAMETERS = len(OWN)
"""Number of an arm's own parameters `par` in the plane, see `physics.model.PAYLOAD_MASS`."""

PATH = Layout(
    "Path", "",
    Field("x", (), "m or rad", "center of a circle, x, or first end of a swing, at t = 0"),
    Field("y", (), "m", "center of a circle, y"),
    Field("size", (), "m or rad", "radius of the circle, or width of the swing; 0 on a line"),
    Field("rate", (), "rad/s", "rate of the angle on the circle, or of the swing's phase"),
    Field("phase", (), "rad", "that angle at t = 0"),
    Field("vx", (), "m/s or rad/s", "constant velocity of the center, x, or of the swing"), Field("vy", (), "m/s", "y"),
    Field("z", (), "m", "in space, center of a circle, z"), Field("vz", (), "m/s", "in space, its velocity, z"),
    Field("bearing", (), "rad", "in space, bearing of the circle's axis"), Field("tilt", (), "rad", "its angle from z"),
)  # fmt: skip
"""Parameters of a moving target's drawn path, inertial axes. Some have another meaning at a wall (`tasks.press`)."""

LAW = Layout(
    "Law", "",
    Field("gain", (2,), "", "low and high of the drawn gain"),
    Field("bias", (2,), "", "low and high of the drawn bias, in scales of the entry, as noise and quantum"),
    Field("noise", (), "", "standard deviation of a reading's noise"),
    Field("quantum", (), "", "resolution: readings are multiples of it; 0: not rounded"),
    Field("own", (4,), "", "filter over a period: (output, slope) after it by (output, slope) before it, 2 x 2"),
    Field("before", (2,), "", "filter: (output, slope) after a period by the input before it"),
    Field("after", (2,), "", "filter: (output, slope) after a period by the input after it"),
    Field("late", (), "", "whole periods of delay"),
    Field("share", (), "", "rest of the delay, as a fraction of a period"),
    Field("bow", (4,), "", "filter: output `share` of a period ago less the straight line between outputs at instants;"
          " by output, slope and input before, and input after"),
    Field("every", (), "", "periods from one reading to the next"),
    Field("rate", (), "1/s", "encoder: weight of the difference of two readings in the filtered rate"),
    Field("kept", (), "", "encoder: weight of the rate of the period before"),
)  # fmt: skip
"""How a sensor reads a quantity: coefficients of `sensors.Law` for one period between instants."""

CHANNEL = Layout(
    "Channel", "room",
    Field("gain", (), "", "drawn gain of the episode"),
    Field("bias", (), "", "drawn bias, in scales of the entry"),
    Field("input", (), "", "filter's input at the last instant"), Field("output", (), "", "filter's output"),
    Field("slope", (), "", "rate of the output over w, its frequency"),
    Field("reading", (), "", "last reading"),
    Field("since", (), "", "periods since the last reading"),
    Field("rate", (), "1/s", "rate by an encoder; in space angular velocity for an accelerometer, an axis per channel"),
    Field("motor", (), "rad", "angle of the joint's motor, over the ratio; what a force sensor or switch reads"),
    Field("place", (), "m", "tip at the instant before, for an accelerometer's channels x, y, z"),
    Field("speed", (), "m/s", "its rate"), Field("turn", (), "rad, rad/s", "tip angle, rate; in space rotation vector"),
    Field("past", ("room",), "", "outputs `share` of a period before each earlier instant, the newest first"),
)  # fmt: skip
"""Memory of a sensor for one quantity that it reads."""

PUSH = Layout(
    "Push", "",
    Field("first", (), "", "first control period with the push"), Field("over", (), "", "first period after it"),
    Field("force", (3,), "N", "force on the tip, inertial axes; in the plane the last is 0"),
)  # fmt: skip
"""Memory of a push: a force on the tip."""

RECORD = Layout(
    "Record", "joints, acted, motors, commands, delays, memory, readings",
    Field("periods", (), "", "control periods done"),
    Field("periods_allowed", (), "", "control periods until the episode is cut off"),
    Field("mode", (), "", "RUNNING, OVER, FRESH or GUIDED"),
    Field("hold", (), "", "consecutive instants within the success bands"),
    Field("target", (3,), "m or rad", "target: a point (inertial axes) or an angle; entries beyond its numbers unused"),
    Field("target_rate", (3,), "m/s or rad/s", "time derivative of the target"),
    Field("torque_factor", (), "", "drawn factor on the torque constant"),
    Field("level", (), "", "halvings of the step that the last period took, where steps are fitted"),
    Field("late", (), "", "additional delay of this period's commands in steps, where that is drawn"),
    Field("cost", (), "", "cost of the episode so far"),
    Field("accounted", (), "J", "energy at the start of the episode plus the work since then"),
    Field("exchanged", (), "J", "absolute value of that energy plus that of the work of each period"),
    Field("change", (2,), "", "period at whose start the payload changes, and its new factor on the nominal payload"),
    Field("push", (PUSH.length,), "", "a `PUSH`: the present one, or the next"),
    Field("path", (PATH.length,), "", "a `PATH`"),
    Field("goal", ("joints",), "rad", "joint angles that reach the target"),
    Field("acted", ("acted",), "", "the last action, where its change is priced"),
    Field("torque", ("motors", "joints"), "N m", "torques of motors that are not ideal (1 row, or none)"),
    Field("commands", ("commands", "joints"), "N m", "torque commands to these motors, the newest first"),
    Field("delays", ("delays",), "", "drawn: steps of commands; share and mean of a lag; periods of observations"),
    Field("seen", ("memory",), "", "past observations, the newest first, where observations are delayed"),
    Field("readings", ("readings",), "", "a `CHANNEL` for each quantity that sensors read by a law"),
)  # fmt: skip
"""An arm's record: the episode's memory besides the state of the arm."""

ENERGIES = Layout(
    "Energies", "",
    Field("kinetic", (), "J", "kinetic energy"), Field("strain", (), "J", "strain energy"),
    Field("gravity", (), "J", "gravitational energy"),
    Field("dissipated", (), "J", "energy dissipated by damping and friction so far"),
    Field("work", (), "J", "work of the motors so far"),
)  # fmt: skip
"""Energies of an arm, if they are recorded."""

BASIS = Layout(
    "Basis", "joints",
    Field("one", (), "", "1"),
    Field("angles", ("joints",), "rad", "inertial angles of the links"),
    Field("cosines", ("joints",), "", "cosines of these angles"), Field("sines", ("joints",), "", "their sines"),
)  # fmt: skip
"""Coordinates and rates of straight links are linear in these functions, the columns of `Ranges.pose` and `shake`."""

MOVING = Layout(
    "Moving", "",
    Field("x", (), "m or rad", "target point, x, inertial axes, or target angle"),
    Field("y", (), "m", "target point, y"), Field("z", (), "m", "target point, z, in space"),
    Field("vx", (), "m/s or rad/s", "rate of x"), Field("vy", (), "m/s", "of y"), Field("vz", (), "m/s", "of z"),
)  # fmt: skip
"""Position and velocity of a moving target at an instant."""

START = Layout(
    "Start", "joints",
    Field("vibration", (3,), "", "initial tip deflection over L; in space of each mode, in the plane the first alone"),
    Field("target", (2,), "m or rad", "as in the record"),
    Field("factors", (FACTORS.length,), "", "a `FACTORS`"),
    Field("parameters", (PARAMETERS,), "", "payload mass, payload inertia, EI factor, tau_d"),
    Field("angles", ("joints",), "rad", "joint angles"),
)  # fmt: skip
"""Numbers drawn or requested for a fresh start."""

REQUEST = Layout(
    "Request", "joints, goals",
    Field("angles", ("joints",), "rad", "joint angles at the start"),
    Field("target", (2,), "m or rad", "as in the record"),
    Field("vibration", (3,), "", "as in a `START`"),
    Field("goals", ("goals",), "rad", "in space: joint angles at the target, which determine it"),
)  # fmt: skip
"""Values that a reset requests; NaN: the value is drawn."""

INFO = Layout(
    "Info", "links, targets, terms, further",
    Field("success", (), "", "1 or 0"),
    Field("tip", ("2 + targets // 3",), "m", "tip position, inertial axes; three numbers in space"),
    Field("deflection", ("1 + targets // 3", "links"), "", "tip deflection of each link / length; in space y, then z"),
    Field("twist", ("targets // 3", "links"), "rad", "in space: twist of each link"),
    Field("target", ("targets",), "m or rad", "target point or angle"),
    Field("torque", ("links",), "N m", "applied torque of each joint; with a motor lag, at the period's end"),
    Field("terms", ("terms",), "", "weighted terms of the reward; the last: of failure"),
    Field("in_range", (), "", "1 where the formulation holds, or 0"),
    Field("error", (), "", "estimate of the formulation's own error, over L"),
    Field("reason", (), "", "code of the reason for the episode's end; 0: it goes on"),
    Field("energies", (ENERGIES.length,), "J", "an `ENERGIES`"),
    Field("reward", (), "", "sum of the terms"), Field("truncated", (), "", "1 or 0"),
    Field("motors", (2, "links"), "rad, rad/s", "motor angles and rates, over the gear ratio, where energies are kept"),
    Field("further", ("further",), "", "a `FURTHER`, or nothing"),
)  # fmt: skip
"""Entries of info, which the caller reads after a control period."""

_FURTHER = Layout(
    "Further", "told",
    Field("cost", (), "", "cost of the period"), Field("episode_cost", (), "", "cost of the episode so far"),
    Field("payload", (), "kg", "mass of the payload"),
    Field("push", (3,), "N", "force on the tip in the period, inertial axes"),
    Field("step_error", (), "", "estimated error of the period's fitted steps, over L"),
    Field("drawn", (FACTORS.length,), "", "a `FACTORS`"),
    Field("clearance", (), "m", "distance from the forbidden shapes; negative inside one"),
    Field("penetration", (), "m", "depth in a forbidden shape, or 0"),
    Field("base", (3,), "rad, m", "attitude of a floating base, then x, y of its hub"),
    Field("told", ("told",), "s, s, s, 1", "drawn: delays of commands and observations, lag, gains of channels"),
)  # fmt: skip
"""Further entries of info: costs, a changing payload, pushes, fitted steps, drawn factors, a floating base."""

FURTHER = _FURTHER.offsets(0, 0)
"""Index of each field of the further entries of info; FURTHER.end: number of entries without drawn delays and gains."""

(
    PERIODS, PERIODS_ALLOWED, MODE, HOLD, TARGET, TARGET_RATE, TORQUE_FACTOR, LEVEL, LATE, COST, ACCOUNTED,
    EXCHANGED, CHANGE, PUSHED, PATH_AT, GOAL, *_,
) = RECORD.offsets(0, 0, 0, 0, 0, 0, 0, 0)  # fmt: skip
"""Index in a record of the fields whose places do not depend on sizes."""

SUCCESS, TIP, DEFLECTION, *_ = INFO.offsets(0, 0, 0, 0, 0)
"""Index in info of the fields whose places do not depend on sizes; the last index holds in the plane only."""

SAVED = Layout(
    "Saved", "rows, inputs, motions, record",
    Field("q", ("rows",), "", "coordinates at the period's or stretch's start"), Field("v", ("rows",), "", "rates"),
    Field("a", ("rows",), "", "accelerations"), Field("b", ("rows",), "", "auxiliary accelerations of the integrator"),
    Field("books", (BOOKS.length,), "J", "a `BOOKS`"),
    Field("inputs", ("inputs",), "N m", "torques and loads"),
    Field("psi", ("motions", 3), "", "prescribed coordinates, their rates and accelerations"),
    Field("reaction", ("motions",), "N m or N", "forces that enforce the prescribed motions"),
    Field("record", ("record",), "", "a `RECORD`, where a period may change it; otherwise none of it"),
)  # fmt: skip
"""Saved state of an arm, from which a period, or a part of it, is repeated."""

SCRATCH = Layout(
    "Scratch", "links, saved",
    Field("flag", (), "", "status code of the period"),
    Field("fine", (), "", "requested step size, as halvings of h; -1: done"),
    Field("taken", (), "", "halvings of the run that was kept"), Field("apart", (), "m", "its estimated error"),
    Field("tips", ("links", 4), "m, m/s", "x and y of each link's tip in the coarser run, and their rates"),
    Field("result", ("saved",), "", "a `SAVED`, of the end of the period"),
)  # fmt: skip
"""Memory of an arm for steps fitted to a tolerance."""

saved_at = kernel(SAVED.offsets)
scratch_at = kernel(SCRATCH.offsets)
record_at = kernel(RECORD.offsets)
start_at = kernel(START.offsets)
basis_at = kernel(BASIS.offsets)
energies_at = kernel(ENERGIES.offsets)
channel_at = kernel(CHANNEL.offsets)
request_at = kernel(REQUEST.offsets)
info_at = kernel(INFO.offsets)

RUNNING, OVER, FRESH, GUIDED = range(4)
"""Modes: stepped; ended, waits for a reset; just reset, skipped by the next step; guided by prescribed motions."""

ACTION_NOT_FINITE, JOINT_LIMIT, RETRY = 100, 101, 102
"""Reasons for an episode's end besides the status codes of `model`; RETRY: the arm's period must be repeated alone."""

REASONS: dict[float, str] = {
    **{float(code): word if code else "" for code, word in enumerate(STATUS)},
    float(ACTION_NOT_FINITE): "action_not_finite",
    float(JOINT_LIMIT): "joint_limit",
}
"""Word for the reason of an episode's end, by the reason's code in `info`."""

STATUS_WORDS: dict[float, str] = {code: STATUS[int(code)] if code < len(STATUS) else STATUS[0] for code in REASONS}
"""The solver's status word for each code of `REASONS`, as in `info`."""

CLIP = 10.0
"""Largest magnitude of an observed entry after division by its scale; larger magnitudes are clipped."""


class Block(NamedTuple):
    """Start (in float64 numbers) of each section of a block, the memory of a group of arms, one arm per lane."""

    par: int  # see `physics.model.OWN`
    poses: int  # a `POSES` a link, in space a `SPACE_POSES`
    record: int  # a `RECORD`
    action: int  # one entry per joint, clipped
    seen: int  # the scaled observation
    info: int  # an `INFO`
    saved: int  # a `SAVED`
    end: int  # end of an arm's memory; then a `SCRATCH`, where steps are fitted
    row: int  # length of a block, in whole cache lines


@inlined
def sections(layout, block):
    """Return views of a block's sections: par, poses, record, action, seen, info, saved, and the scratch after them."""
    return (
        block[layout.par : layout.poses], block[layout.poses : layout.record], block[layout.record : layout.action],
        block[layout.action : layout.seen], block[layout.seen : layout.info], block[layout.info : layout.saved],
        block[layout.saved : layout.end], block[layout.end : layout.row],
    )  # fmt: skip


class Controller(NamedTuple):
    """Joint controllers: torque = stiffness (goal - angle) - damping * rate + share * torque limit * action."""

    stiffness: np.ndarray  # (N,) N m/rad
    damping: np.ndarray  # (N,) N m s/rad
    share: float  # fraction of the torque limit (N m) for a full action
    motors: tuple[int, ...] | None  # a tag where they read motors that have angles of their own


class Amplifier(NamedTuple):
    """Conversion of an action into torques: by currents, or by voltages minus the motors' back EMF."""

    gain: np.ndarray  # (N,) N m: torque of the largest current, or of the largest voltage at rest
    emf: np.ndarray | None  # (N,) N m s/rad: torque lost per joint rate (back EMF); None with currents
    limits: np.ndarray  # (N,) N m, largest torques


class Actuator(NamedTuple):
    """Motors that are not ideal: first-order lag, delays, saturation."""

    share: float  # 1 - exp(-h / lag): fraction of the way to the command that a motor covers in a step; 1: no lag
    mean: float  # mean of that fraction over the step
    age: int  # delay of commands in whole control periods
    late: int  # rest of the delay in whole steps
    limits: np.ndarray  # (N,) N m, saturation
    rows: int  # remembered commands per joint, this period's among them
    jitter: tuple[float, float, int] | None = None  # most additional steps; steps a period; largest age, in periods
    drawn: tuple[float, float] | None = None  # least and most steps of a drawn delay; age and late are then 0
    within: tuple[int] | None = None  # a tag where torques change within a period, not only at its start
    lag: tuple[float, float] | None = None  # range of a drawn lag over h; share and mean are then those of the largest


class Sensors(NamedTuple):
    """Noise and delay of the observation, and strain gauges."""

    noise: np.ndarray  # (S,) standard deviation of each entry, in its scale
    age: int  # control periods by which observations come late
    gauges: np.ndarray  # (G, n): rows of `physics.gauges.curvature_rows`, over the scale
    drawn: tuple[float, float] | None = None  # least and most age, where it is drawn for each episode


class Instruments(NamedTuple):
    """Sensors that read by a law (`sensors.Law`); None: no sensor of this kind. Channels follow the fields' order.

    Sensor entries follow those of task and target: goals, accelerometer, gyroscope, camera, force, switch, gauges.
    """

    period: float  # s
    laws: np.ndarray  # a `LAW` per channel
    entries: int  # number of entries that these add, without gauges
    room: int  # length of `past` in a `CHANNEL`
    goals: tuple[int, ...] | None  # a tag: joint angles at the goal less encoder angles, and a target that is a point
    encoders: np.ndarray | None  # (3 N,) int64: entries of each joint's sine, cosine and rate
    motors: np.ndarray | None  # (N,) int64: 1 where the encoder sits on a motor that has an angle of its own
    accelerometer: np.ndarray | None  # (3,), in space (4,): gravity, m/s^2; scale, m/s^2
    camera: float | None  # scale, m
    gauges: tuple[int, ...] | None  # a zero per gauge
    gyroscope: float | None = None  # scale, rad/s; in space
    force: float | None = None  # scale, N
    switch: float | None = None  # threshold, N
    tip: int = -1  # the tip's number among the points that may touch; -1: it may not


class Selection(NamedTuple):
    """Observed entries, and the number of observations stacked into one, the oldest first."""

    chosen: np.ndarray  # (C,) int64: indices of the observed entries
    frames: int  # observations in one


class Reference(NamedTuple):
    """A moving target: given by a table, or drawn anew for each episode."""

    line: tuple[int, ...] | None  # a tag where straight lines are drawn
    table: np.ndarray  # (m, 2 D) target and rate at each control instant, D numbers each; empty: drawn
    ranges: np.ndarray  # (n, 2): low and high of each drawn number of a path
    ahead: np.ndarray  # (2,) int64: control periods by which the observation looks ahead
    scales: np.ndarray  # (3 D,): scales of the rate and of the two displacements ahead
    axis: np.ndarray | None = None  # (3,) in space: axis of joint 0, in the axes of its link's root
    needs: Any = None  # an `attainable.Attainable` that drawn paths must satisfy, or None
    lasting: float = 0.0  # s: duration of an episode


class Cost(NamedTuple):
    """Limits of deflection and strain whose violation gives a period a cost; None: no limit."""

    deflection: np.ndarray | None  # (N,): largest tip deflection of each link, over its length
    strain: np.ndarray | None  # (G, n): rows for `protocol.strain_gauge`, strain at a station / limit; in space 2 each


class Pushes(NamedTuple):
    """Forces on the tip in random directions; times in control periods."""

    wait: np.ndarray  # (2,): low and high of the drawn time from one push to the next
    force: np.ndarray  # (2,) N: low and high of the drawn force
    lasting: float  # duration of a push
    until: float  # latest start of a push


class PayloadChange(NamedTuple):
    """A payload that changes once in an episode, such as by gripping or dropping."""

    time: np.ndarray  # (2,) control periods: low and high of the drawn time
    factor: np.ndarray  # (2,): low and high of the drawn factor on the nominal payload
    resting: tuple[int, ...] | None  # a tag where a gripped body rests before; otherwise it moves with the tip


@dataclass(frozen=True)
class Extras:
    """Optional parts of an environment; None: absent, and not compiled."""

    controller: Controller | None = None
    amplifier: Amplifier | None = None
    actuator: Actuator | None = None
    sensors: Sensors | None = None
    reference: Reference | None = None
    instruments: Instruments | None = None
    selection: Selection | None = None
    cost: Cost | None = None
    pushes: Pushes | None = None
    payload_change: PayloadChange | None = None
    keep_out: KeepOut | None = None


class Models(NamedTuple):
    """The models for steps of h, h/2, ... h/32."""

    whole: Any
    half: Any
    quarter: Any
    eighth: Any
    sixteenth: Any
    least: Any


class Program(NamedTuple):
    """A batch of n arms with its task; A joints, S entries that can be observed, O numbers in an observation, L lanes.

    A part of the program whose field is None is absent, and no code is compiled for the part.
    """

    lane: tuple[int, ...]
    model: Any
    models: Any  # `Models` where steps are fitted to a tolerance (`model`: that of the least step); None: steps of h
    allowed: float  # that tolerance, m
    scheme: Any
    task: Any
    ranges: Ranges
    controller: Controller | None
    amplifier: Amplifier | None
    actuator: Actuator | None
    sensors: Sensors | None
    reference: Reference | None
    instruments: Instruments | None
    selection: Selection | None
    cost: Cost | None
    pushes: Pushes | None
    payload_change: PayloadChange | None
    keep_out: KeepOut | None
    guide: Any  # `runtime.guided.Guided` of a single arm that follows prescribed motions, or None
    layout: Block
    entries: int  # S
    books: tuple[int, ...] | None  # a tag where energies are recorded
    watched: float | None  # `energy_balance.inertia_per_rate`, for the check of energies; None with derivatives
    estimate: float  # of the formulation's own error, as a fraction of L
    period: float  # s
    h: float  # s, time step
    n_steps: int  # steps of h in a period
    n: int  # arms
    block: np.ndarray  # (groups row,)
    action: np.ndarray  # (n A,) float32
    observation: np.ndarray  # (n O,) float32
    table: np.ndarray  # (I groups L,): info once more, entry by entry, for the caller to read
    reward: np.ndarray  # (n,)
    terminated: np.ndarray  # (n,) uint8
    truncated: np.ndarray  # (n,) uint8
    stream: np.ndarray  # (n,) uint64: state of each arm's random numbers
    queue: np.ndarray  # (n,) int64: arms to be started
    request: np.ndarray  # a `REQUEST`


def complete(program: Program) -> Program:
    """Return the program with models that contain the terms of all parameters of an arm (`physics.model.complete`)."""
    models = program.models and Models(*map(model.complete, program.models))
    return program._replace(model=model.complete(program.model), models=models)
