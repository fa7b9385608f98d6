"""Data of a compiled environment: layouts of the memory of an arm, and the record `Program` with all data."""

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

PATH = Layout("Path", "",
    Field("x", (), "m or rad", "circle: x of its center at t = 0; swing of a target angle: its first end"),
    Field("y", (), "m", "circle: y of its center at t = 0"),
    Field("size", (), "m or rad", "radius of the circle, or angular width of the swing; 0 on a straight line"),
    Field("rate", (), "rad/s", "angular velocity on the circle, or frequency of the swing"),
    Field("phase", (), "rad", "angle on the circle, or phase of the swing, at t = 0"),
    Field("vx", (), "m/s or rad/s", "constant velocity of the center along x, or constant rate of the target angle"),
    Field("vy", (), "m/s", "its velocity along y"),
    Field("z", (), "m", "in space: z of the circle's center"),
    Field("vz", (), "m/s", "in space: velocity of the center along z"),
    Field("bearing", (), "rad", "in space: bearing of the circle's axis"),
    Field("tilt", (), "rad", "in space: angle between the circle's axis and z"),
)  # fmt: skip
"""Parameters of a moving target's drawn path, inertial axes. Some have another meaning at a wall (`tasks.press`)."""

LAW = Layout("Law", "",
    Field("gain", (2,), "", "lower and upper bound of the sensor's drawn gain"),
    Field("bias", (2,), "", "bounds of the drawn bias, divided by the entry's scale, as noise and quantum are"),
    Field("noise", (), "", "standard deviation of the noise on a reading"),
    Field("quantum", (), "", "resolution: readings are rounded to its multiples; 0: no rounding"),
    Field("own", (4,), "", "filter over a period: 2 x 2 matrix from (output, slope) at its start to those at its end"),
    Field("before", (2,), "", "filter: (output, slope) at a period's end per unit of input at its start"),
    Field("after", (2,), "", "filter: (output, slope) at a period's end per unit of input at its end"),
    Field("late", (), "", "delay of a reading in whole control periods"),
    Field("share", (), "", "remaining delay as a fraction of a control period"),
    Field("bow", (4,), "", "filter: output `share` of a period ago less the straight line between outputs at instants;"
          " by output, slope and input before, and input after"),
    Field("every", (), "", "control periods from one reading to the next"),
    Field("rate", (), "1/s", "encoder: weight of the difference quotient of two readings in the filtered rate"),
    Field("kept", (), "", "encoder: weight of the previous rate in the filtered rate"),
)  # fmt: skip
"""How a sensor reads a quantity: coefficients of `sensors.Law` for one period between instants."""

CHANNEL = Layout("Channel", "room",
    Field("gain", (), "", "sensor gain drawn for this episode"),
    Field("bias", (), "", "sensor bias drawn for this episode, divided by the entry's scale"),
    Field("input", (), "", "input of the sensor's filter at the last instant"),
    Field("output", (), "", "filter's output"),
    Field("slope", (), "", "rate of the filter's output divided by the filter's frequency w"),
    Field("reading", (), "", "last reading"),
    Field("since", (), "", "control periods since the last reading"),
    Field("rate", (), "1/s", "rate by an encoder; in space angular velocity for an accelerometer, an axis per channel"),
    Field("motor", (), "rad", "motor angle / gear ratio; for a force sensor or switch the quantity that it reads"),
    Field("place", (), "m", "tip at the instant before, for an accelerometer's channels x, y, z"),
    Field("speed", (), "m/s", "its rate"), Field("turn", (), "rad, rad/s", "tip angle, rate; in space rotation vector"),
    Field("past", ("room",), "", "filter outputs `share` of a period before each earlier instant, the newest first"),
)  # fmt: skip
"""Memory of a sensor for one quantity that it reads."""

PUSH = Layout("Push", "",
    Field("first", (), "", "first control period with this push"),
    Field("over", (), "", "first control period after this push"),
    Field("force", (3,), "N", "force on the tip, inertial axes; in the plane the third component is 0"),
)  # fmt: skip
"""Memory of a push: a force on the tip."""

RECORD = Layout("Record", "joints, acted, motors, commands, delays, memory, readings",
    Field("periods", (), "", "control periods completed in the episode"),
    Field("periods_allowed", (), "", "control periods after which the episode is truncated"),
    Field("mode", (), "", "state of the episode: RUNNING, OVER, FRESH or GUIDED"),
    Field("hold", (), "", "number of consecutive instants within all success bands"),
    Field("target", (3,), "m or rad", "target point (inertial axes) or target angle; superfluous entries are unused"),
    Field("target_rate", (3,), "m/s or rad/s", "time derivative of the target"),
    Field("torque_factor", (), "", "drawn factor on the motors' torque constant"),
    Field("level", (), "", "fitted steps: the last period took steps of h / 2^level"),
    Field("late", (), "", "drawn additional delay of this period's commands, in steps"),
    Field("cost", (), "", "cost of the episode so far"),
    Field("accounted", (), "J", "arm's energy at the start of the episode plus all work since then"),
    Field("exchanged", (), "J", "magnitude of the starting energy plus magnitude of each period's work"),
    Field("change", (2,), "", "control period in which the payload changes; its new factor on the nominal payload"),
    Field("push", (PUSH.length,), "", "a `PUSH` record: the present push, or the next"),
    Field("path", (PATH.length,), "", "a `PATH`"),
    Field("goal", ("joints",), "rad", "joint angles that reach the target"),
    Field("acted", ("acted",), "", "last action, if the reward prices changes of actions"),
    Field("torque", ("motors", "joints"), "N m", "torques of motors with lag, delay or saturation (1 row, or none)"),
    Field("commands", ("commands", "joints"), "N m", "torque commands to these motors, the newest first"),
    Field("delays", ("delays",), "", "drawn delay of commands (steps), motor lag (share, mean), observation delay"),
    Field("seen", ("memory",), "", "past observations, the newest first, if observations are delayed"),
    Field("readings", ("readings",), "", "a `CHANNEL` record for each quantity that sensors read"),
)  # fmt: skip
"""An arm's record: the episode's memory besides the state of the arm."""

ENERGIES = Layout("Energies", "",
    Field("kinetic", (), "J", "kinetic energy"), Field("strain", (), "J", "strain energy"),
    Field("gravity", (), "J", "gravitational energy"),
    Field("dissipated", (), "J", "energy dissipated by damping and friction since the start"),
    Field("work", (), "J", "work of the motors since the start"),
)  # fmt: skip
"""Energies of an arm, if they are recorded."""

BASIS = Layout("Basis", "joints",
    Field("one", (), "", "1"),
    Field("angles", ("joints",), "rad", "angles of the links from the inertial x axis"),
    Field("cosines", ("joints",), "", "cosines of the links' angles"), Field("sines", ("joints",), "", "their sines"),
)  # fmt: skip
"""Coordinates and rates of straight links are linear in these functions, the columns of `Ranges.pose` and `shake`."""

MOVING = Layout("Moving", "",
    Field("x", (), "m or rad", "x of the target point, inertial axes, or the target angle"),
    Field("y", (), "m", "y of the target point, inertial axes"), Field("z", (), "m", "in space: z of the target point"),
    Field("vx", (), "m/s or rad/s", "time derivative of x"), Field("vy", (), "m/s", "time derivative of y"),
    Field("vz", (), "m/s", "time derivative of z"),
)  # fmt: skip
"""Position and velocity of a moving target at an instant."""

START = Layout("Start", "joints",
    Field("vibration", (3,), "", "initial tip deflection / L; in space one per mode, in the plane only the first"),
    Field("target", (2,), "m or rad", "two drawn numbers from which the task computes the target"),
    Field("factors", (FACTORS.length,), "", "a `FACTORS`"),
    Field("parameters", (PARAMETERS,), "", "payload mass, payload inertia, factor on EI, damping time constant tau_d"),
    Field("angles", ("joints",), "rad", "joint angles"),
)  # fmt: skip
"""Numbers drawn or requested for a fresh start."""

REQUEST = Layout("Request", "joints, goals",
    Field("angles", ("joints",), "rad", "joint angles at the start"),
    Field("target", (2,), "m or rad", "target, two numbers as in a `START` record"),
    Field("vibration", (3,), "", "initial vibration, as in a `START` record"),
    Field("goals", ("goals",), "rad", "in space: joint angles at the target, which determine the target"),
)  # fmt: skip
"""Values that a reset requests; NaN: the value is drawn."""

INFO = Layout("Info", "links, targets, terms, further",
    Field("success", (), "", "1 if the task is accomplished, otherwise 0"),
    Field("tip", ("2 + targets // 3",), "m", "tip position, inertial axes; x and y, in space x, y and z"),
    Field("deflection", ("1 + targets // 3", "links"), "", "tip deflection / length of each link; in space y, then z"),
    Field("twist", ("targets // 3", "links"), "rad", "in space: twist of each link's tip"),
    Field("target", ("targets",), "m or rad", "target point, inertial axes, or target angle"),
    Field("torque", ("links",), "N m", "applied torque of each joint; with a motor lag, its value at the period's end"),
    Field("terms", ("terms",), "", "weighted reward terms; the last is the failure term"),
    Field("in_range", (), "", "1 if the beam formulation is valid for the present deflection, otherwise 0"),
    Field("error", (), "", "estimated tip error of the beam formulation, divided by the arm's length"),
    Field("reason", (), "", "code of the reason for the episode's end; 0 while the episode continues"),
    Field("energies", (ENERGIES.length,), "J", "an `ENERGIES`"),
    Field("reward", (), "", "sum of the weighted reward terms"),
    Field("truncated", (), "", "1 if the episode is truncated, otherwise 0"),
    Field("motors", (2, "links"), "rad, rad/s", "motor angles, rates / gear ratio, if energies are recorded"),
    Field("further", ("further",), "", "a `FURTHER` record, or nothing"),
)  # fmt: skip
"""Entries of info, which the caller reads after a control period."""

_FURTHER = Layout("Further", "told",
    Field("cost", (), "", "cost of this control period"), Field("episode_cost", (), "", "cost of the episode so far"),
    Field("payload", (), "kg", "mass of the payload"),
    Field("push", (3,), "N", "pushing force on the tip in this control period, inertial axes"),
    Field("step_error", (), "", "estimated tip error of the period's fitted steps, divided by the arm's length"),
    Field("drawn", (FACTORS.length,), "", "a `FACTORS`"),
    Field("clearance", (), "m", "distance from the forbidden shapes; negative inside a shape"),
    Field("penetration", (), "m", "depth inside a forbidden shape, or 0"),
    Field("base", (3,), "rad, m", "attitude of a floating base, then x and y of its hub"),
    Field("told", ("told",), "s, s, s, 1", "drawn delays of commands and observations, motor lag, sensor gains"),
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

SAVED = Layout("Saved", "rows, inputs, motions, record",
    Field("q", ("rows",), "", "coordinates at the start of the period or stretch"), Field("v", ("rows",), "", "rates"),
    Field("a", ("rows",), "", "accelerations"),
    Field("b", ("rows",), "", "auxiliary accelerations of the generalized-alpha integrator"),
    Field("books", (BOOKS.length,), "J", "a `BOOKS`"),
    Field("inputs", ("inputs",), "N m", "joint torques and loads"),
    Field("psi", ("motions", 3), "", "prescribed coordinates, their rates and their accelerations"),
    Field("reaction", ("motions",), "N m or N", "forces that enforce prescribed motions"),
    Field("record", ("record",), "", "a `RECORD`, if a period may change it; otherwise empty"),
)  # fmt: skip
"""Saved state of an arm, from which a period, or a part of it, is repeated."""

SCRATCH = Layout("Scratch", "links, saved",
    Field("flag", (), "", "solver's status code of the period"),
    Field("fine", (), "", "requested step is h / 2^fine; -1: period completed"),
    Field("taken", (), "", "number of halvings of h in the run that was kept"),
    Field("apart", (), "m", "estimated tip error of the kept run"),
    Field("tips", ("links", 4), "m, m/s", "x, y, and their rates, of each link's tip in the run with longer steps"),
    Field("result", ("saved",), "", "a `SAVED` record of the end of the period"),
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
    """Offsets, in float64 numbers, of the sections of a block: the memory of a group of arms, one arm per SIMD lane."""

    par: int  # parameters of each arm, see `physics.model.OWN`
    poses: int  # a `POSES` record per link, in space a `SPACE_POSES`
    record: int  # the episode's memory, a `RECORD`
    action: int  # one clipped action per joint
    seen: int  # the scaled observation of each arm
    info: int  # the entries of info, an `INFO` record
    saved: int  # saved state of each arm, a `SAVED` record
    end: int  # end of an arm's memory, followed by a `SCRATCH` record if steps are fitted to a tolerance
    row: int  # length of a block, rounded up to whole cache lines


@inlined
def sections(layout, block):
    """Return views of a block's sections: par, poses, record, action, seen, info, saved, scratch."""
    return (
        block[layout.par : layout.poses], block[layout.poses : layout.record], block[layout.record : layout.action],
        block[layout.action : layout.seen], block[layout.seen : layout.info], block[layout.info : layout.saved],
        block[layout.saved : layout.end], block[layout.end : layout.row],
    )  # fmt: skip


class Controller(NamedTuple):
    """Joint PD controllers: torque = stiffness (goal - angle) - damping rate + share (torque limit) action."""

    stiffness: np.ndarray  # (N,) stiffness of each joint's controller, N m/rad
    damping: np.ndarray  # (N,) damping of each joint's controller, N m s/rad
    share: float  # fraction of the torque limit (N m) for a full action
    motors: tuple[int, ...] | None  # not None if the controllers read motor angles, which differ from joint angles


class Amplifier(NamedTuple):
    """Conversion of actions to torques: actions are currents, or voltages from which the back EMF is subtracted."""

    gain: np.ndarray  # (N,) torque of each motor's largest current, or of its largest voltage at rest, N m
    emf: np.ndarray | None  # (N,) torque lost per joint rate by back EMF, N m s/rad; None with currents
    limits: np.ndarray  # (N,) largest torque of each motor, N m


class Actuator(NamedTuple):
    """Model of motors with first-order lag, delays and saturation."""

    share: float  # 1 - exp(-h / lag): fraction of the way to its command that a torque covers in a step h; 1: no lag
    mean: float  # mean of this fraction over the step
    age: int  # delay of torque commands in whole control periods
    late: int  # remaining delay in whole steps
    limits: np.ndarray  # (N,) torque at which each motor saturates, N m
    rows: int  # number of remembered commands per joint, with the present period's command
    jitter: tuple[float, float, int] | None = None  # largest additional delay, steps; steps per period; largest age
    drawn: tuple[float, float] | None = None  # least and largest drawn delay, steps; age and late are then 0
    within: tuple[int] | None = None  # not None if torques can change within a control period, not only at its start
    lag: tuple[float, float] | None = None  # bounds of a drawn motor lag / h; share and mean belong to the largest


class Sensors(NamedTuple):
    """Noise and delay of the observation, and ideal strain gauges."""

    noise: np.ndarray  # (S,) standard deviation of the noise on each entry, divided by the entry's scale
    age: int  # delay of the observation in control periods
    gauges: np.ndarray  # (G, n): rows of `physics.gauges.curvature_rows`, divided by the entries' scale
    drawn: tuple[float, float] | None = None  # least and largest delay, if a delay is drawn for each episode


class Instruments(NamedTuple):
    """Sensors with noise, filter and delay (`sensors.Law`); None: no sensor of this kind.

    The channels of the sensors are in the order of the fields.

    The sensors' entries of the observation follow the entries of task and target. The order of these entries is: goals,
    accelerometer, gyroscope, camera, force, switch, gauges.
    """

    period: float  # control period, s
    laws: np.ndarray  # one `LAW` record per channel
    entries: int  # number of observation entries from these sensors, without gauges
    room: int  # length of the field `past` of a `CHANNEL` record
    goals: tuple[int, ...] | None  # not None: observe goal angles minus encoder angles, and a target point
    encoders: np.ndarray | None  # (3 N,) int64: positions in the observation of each joint's sine, cosine and rate
    motors: np.ndarray | None  # (N,) int64: 1 if the encoder reads the motor's angle and the gear is elastic
    accelerometer: np.ndarray | None  # (3,), in space (4,): gravity components, m/s^2, then the entries' scale, m/s^2
    camera: float | None  # scale of the camera's entries, m
    gauges: tuple[int, ...] | None  # one zero per strain gauge
    gyroscope: float | None = None  # in space: scale of the gyroscope's entries, rad/s
    force: float | None = None  # scale of the contact force's entry, N
    switch: float | None = None  # contact force above which the switch closes, N
    tip: int = -1  # index of the tip among the possible contact points; -1: the tip cannot touch


class Selection(NamedTuple):
    """Selected entries of the observation, and number of stacked successive observations, the oldest first."""

    chosen: np.ndarray  # (C,) int64: indices of the observed entries
    frames: int  # number of observations stacked into one


class Reference(NamedTuple):
    """Moving target: a path given as a table, or a random path for each episode."""

    line: tuple[int, ...] | None  # not None if straight lines are drawn; None: circles or swings
    table: np.ndarray  # (m, 2 D): target (D numbers) and its rate at each control instant; empty if paths are drawn
    ranges: np.ndarray  # (n, 2): lower and upper bound of each drawn number of a path
    ahead: np.ndarray  # (2,) int64: times ahead of the two observed future targets, in control periods
    scales: np.ndarray  # (3 D,): scales of the observed target rate and of the two displacements ahead
    axis: np.ndarray | None = None  # (3,) in space: axis of joint 0, in the root axes of its link
    needs: Any = None  # an `attainable.Attainable` that drawn paths must satisfy, or None
    lasting: float = 0.0  # duration of an episode, s


class Cost(NamedTuple):
    """Limits of deflection and strain; a control period in which one is violated has a cost. None: no limit."""

    deflection: np.ndarray | None  # (N,): largest tip deflection of each link divided by the link's length
    strain: np.ndarray | None  # (G, n): rows for `protocol.strain_gauge`: strain / limit; in space 2 rows per station


class Pushes(NamedTuple):
    """Forces on the tip in random directions at random times; times in control periods."""

    wait: np.ndarray  # (2,): bounds of the drawn time from one push to the next, in control periods
    force: np.ndarray  # (2,): bounds of the drawn force, N
    lasting: float  # duration of a push, in control periods
    until: float  # latest start of a push, in control periods


class PayloadChange(NamedTuple):
    """Payload that changes once in an episode, for example when the arm grips or drops a body."""

    time: np.ndarray  # (2,): bounds of the drawn time of the change, in control periods
    factor: np.ndarray  # (2,): bounds of the drawn factor on the nominal payload
    resting: tuple[int, ...] | None  # not None if a gripped body rests before the change; None: it moves with the tip


@dataclass(frozen=True)
class Extras:
    """Optional parts of an environment. A part that is None is absent, and its code is not compiled."""

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
    """The arm's models for solver steps of h, h/2, ... h/32."""

    whole: Any
    half: Any
    quarter: Any
    eighth: Any
    sixteenth: Any
    least: Any


class Program(NamedTuple):
    """Batch of n arms with a task; A joints, S available entries, O entries of an observation, L SIMD lanes.

    No code is compiled for a field that is None.
    """

    lane: tuple[int, ...]
    model: Any
    models: Any  # `Models` if steps are fitted to a tolerance (`model` is then for the least step); None: steps of h
    allowed: float  # tolerance of fitted steps: largest tip error of a period, m
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
    entries: int  # S, number of entries that can be observed
    books: tuple[int, ...] | None  # not None if energies are recorded
    watched: float | None  # `energy_balance.inertia_per_rate`, for the check of energies; None with derivatives
    estimate: float  # the beam formulation's own error, as a fraction of the arm's length L
    period: float  # control period, s
    h: float  # solver's time step, s
    n_steps: int  # number of time steps h in a control period
    n: int  # number of arms
    block: np.ndarray  # (groups row,) memory of all groups of arms
    action: np.ndarray  # (n A,) float32: actions of all arms
    observation: np.ndarray  # (n O,) float32: observations of all arms
    table: np.ndarray  # (I groups L,): copy of info for the caller, with all arms' values of an entry together
    reward: np.ndarray  # (n,) reward of each arm in the last period
    terminated: np.ndarray  # (n,) uint8: 1 if the arm's episode has terminated
    truncated: np.ndarray  # (n,) uint8: 1 if the arm's episode was truncated
    stream: np.ndarray  # (n,) uint64: state of each arm's random numbers
    queue: np.ndarray  # (n,) int64: indices of the arms to be started
    request: np.ndarray  # values that a reset requests, a `REQUEST` record


def complete(program: Program) -> Program:
    """Return the program with models that contain all terms, so that parameters of each arm can differ."""
    models = program.models and Models(*map(model.complete, program.models))
    return program._replace(model=model.complete(program.model), models=models)
