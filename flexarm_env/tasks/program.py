"""All that the compiled environment works on: what is where in an arm's memory, and the tuple that holds everything."""

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
"""Numbers of an arm's own parameters `par` in the plane, see `physics.model.PAYLOAD_MASS`."""

PATH = Layout(
    "Path", "",
    Field("x", (), "m or rad", "where a circle's centre, or a swing's first end, is"),
    Field("y", (), "m", "of the centre"),
    Field("size", (), "m or rad", "radius, or width of the swing"),
    Field("rate", (), "rad/s", "of the angle on the circle, or of the swing's phase"),
    Field("phase", (), "rad", "of that angle at t = 0"),
    Field("vx", (), "m/s or rad/s", "at which all of it moves on"), Field("vy", (), "m/s", ""),
    Field("z", (), "m", "in space, of the centre"), Field("vz", (), "m/s", ""),
    Field("bearing", (), "rad", "in space, of the circle's axis about z"), Field("tilt", (), "rad", "from z to it"),
)  # fmt: skip
"""Numbers of a moving target's path that was drawn."""

LAW = Layout(
    "Law", "",
    Field("gain", (2,), "", "low and high of what it is drawn from"),
    Field("bias", (2,), "", "likewise, in scales, as all that follows"),
    Field("noise", (), "", "standard deviation"),
    Field("quantum", (), "", "what readings are multiples of; 0: anything"),
    Field("own", (4,), "", "filter: (output, slope) after a period from those before it"),
    Field("before", (2,), "", "and from the input before it"),
    Field("after", (2,), "", "and after it"),
    Field("late", (), "", "whole periods of delay"),
    Field("share", (), "", "and the rest, of a period"),
    Field("bow", (4,), "", "filter: output that share ago, over the straight line between outputs at instants;"
          " by output, slope and input before, and input after"),
    Field("every", (), "", "periods from one reading to the next"),
    Field("rate", (), "1/s", "of a difference of readings that comes into a rate in a period"),
    Field("kept", (), "", "of the rate before it"),
)  # fmt: skip
"""How a quantity is read: the law of `sensors.Law` for a period between instants."""

CHANNEL = Layout(
    "Channel", "room",
    Field("gain", (), "", "as drawn"),
    Field("bias", (), "", ""),
    Field("input", (), "", "of the filter"),
    Field("output", (), "", ""), Field("slope", (), "", "of the output, over w"),
    Field("reading", (), "", "the last"),
    Field("since", (), "", "periods since it was taken"),
    Field("rate", (), "1/s", "of an encoder; in space an accelerometer's angular velocity, an axis in each channel"),
    Field("motor", (), "rad", "angle of the joint's motor, over the ratio"),
    Field("place", (), "m", "of the tip at the instant before, for an accelerometer's channels x, y, z"),
    Field("speed", (), "m/s", "its rate"), Field("turn", (), "rad, rad/s", "tip angle, rate; in space rotation vector"),
    Field("past", ("room",), "", "outputs a share of a period before each instant but the last, the newest first"),
)  # fmt: skip
"""What a sensor remembers of a quantity that it reads."""

PUSH = Layout(
    "Push", "",
    Field("first", (), "", "control period in which it begins"),
    Field("over", (), "", "and the first without it"),
    Field("force", (3,), "N", "on the tip; in the plane the last is 0"),
)  # fmt: skip
"""A push at the tip."""

RECORD = Layout(
    "Record", "joints, acted, motors, commands, delays, memory, readings",
    Field("periods", (), "", "control periods done"),
    Field("periods_allowed", (), "", "control periods until the episode is cut off"),
    Field("mode", (), "", "RUNNING, OVER, FRESH or GUIDED"),
    Field("hold", (), "", "instants in the band"),
    Field("target", (3,), "m or rad", "a point in space or in the plane, or an angle, and nothing"),
    Field("target_rate", (3,), "m/s or rad/s", "its rate"),
    Field("torque_factor", (), "", "on the torque constant"),
    Field("level", (), "", "halvings of the step that the last period took, where steps are fitted"),
    Field("late", (), "", "steps more by which this period's commands come late, where that is drawn"),
    Field("cost", (), "", "of the episode so far"),
    Field("change", (2,), "", "period at whose start the payload changes, and to which factor on the nominal"),
    Field("push", (PUSH.length,), "", "a `PUSH`: the present one, or the next"),
    Field("path", (PATH.length,), "", "a `PATH`"),
    Field("goal", ("joints",), "rad", "joint angles that reach the target"),
    Field("acted", ("acted",), "", "the last action, where its change is priced"),
    Field("torque", ("motors", "joints"), "N m", "of motors that are not ideal (1 row, or none)"),
    Field("commands", ("commands", "joints"), "N m", "asked of them, the newest first"),
    Field("delays", ("delays",), "", "drawn for the episode: steps of commands, then periods of observations"),
    Field("seen", ("memory",), "", "past observations, the newest first, where they come late"),
    Field("readings", ("readings",), "", "a `CHANNEL` for each quantity that sensors read by a law"),
)  # fmt: skip
"""An arm's record: all that its episode remembers beside the state of the arm."""

ENERGIES = Layout(
    "Energies", "",
    Field("kinetic", (), "J", ""),
    Field("strain", (), "J", ""),
    Field("gravity", (), "J", ""),
    Field("dissipated", (), "J", "by damping and friction"),
    Field("work", (), "J", "of the motors"),
)  # fmt: skip
"""Energies of an arm, where they are kept."""

BASIS = Layout(
    "Basis", "joints",
    Field("one", (), "", "1"),
    Field("angles", ("joints",), "rad", "absolute angles of the links"),
    Field("cosines", ("joints",), "", "of these"), Field("sines", ("joints",), "", ""),
)  # fmt: skip
"""What coordinates of straight links, and their velocities, are linear in: columns of `Ranges.pose` and `shake`."""

MOVING = Layout(
    "Moving", "",
    Field("x", (), "m or rad", "a point, or an angle and nothing"),
    Field("y", (), "m", ""), Field("z", (), "m", "in space"),
    Field("vx", (), "m/s or rad/s", "its rate"), Field("vy", (), "m/s", ""), Field("vz", (), "m/s", ""),
)  # fmt: skip
"""Where a moving target is, and how fast it goes."""

START = Layout(
    "Start", "joints",
    Field("vibration", (3,), "", "initial tip deflection over L; in space of each mode, in the plane the first alone"),
    Field("target", (2,), "m or rad", "as in the record"),
    Field("factors", (FACTORS.length,), "", "a `FACTORS`"),
    Field("parameters", (PARAMETERS,), "", "payload mass, payload inertia, EI factor, tau_d"),
    Field("angles", ("joints",), "rad", "joint angles"),
)  # fmt: skip
"""What a fresh start is made of."""

REQUEST = Layout(
    "Request", "joints, goals",
    Field("angles", ("joints",), "rad", "joint angles at the start"),
    Field("target", (2,), "m or rad", "as in the record"),
    Field("vibration", (3,), "", "as in a `START`"),
    Field("goals", ("goals",), "rad", "in space: joint angles at the target, which it follows from"),
)  # fmt: skip
"""What a reset asks for; NaN: to be drawn."""

INFO = Layout(
    "Info", "links, targets, terms, further",
    Field("success", (), "", "1 or 0"),
    Field("tip", ("2 + targets // 3",), "m", "where the tip is; three numbers where a target has so many, in space"),
    Field("deflection", ("1 + targets // 3", "links"), "", "of each tip, over its length; in space along y, then z"),
    Field("twist", ("targets // 3", "links"), "rad", "in space: of each link"),
    Field("target", ("targets",), "m or rad", ""),
    Field("torque", ("links",), "N m", "of each joint, as applied; under a lag, what the motor ends with"),
    Field("terms", ("terms",), "", "of the reward, weighted; the last: of failure"),
    Field("in_range", (), "", "1 where the formulation holds, or 0"),
    Field("error", (), "", "estimate of the formulation's own error, over L"),
    Field("reason", (), "", "why the episode has ended; 0: it has not"),
    Field("energies", (ENERGIES.length,), "J", "an `ENERGIES`"),
    Field("reward", (), "", "sum of the terms"),
    Field("truncated", (), "", "1 or 0"),
    Field("motors", (2, "links"), "rad, rad/s", "their angles and rates, after the ratio, where energies are kept"),
    Field("further", ("further",), "", "a `FURTHER`, or nothing"),
)  # fmt: skip
"""What the caller is told of an arm."""

_FURTHER = Layout(
    "Further", "told",
    Field("cost", (), "", "of the period"),
    Field("episode_cost", (), "", "of the episode so far"),
    Field("payload", (), "kg", "mass of the payload"),
    Field("push", (3,), "N", "force on the tip in the period"),
    Field("step_error", (), "", "of the period over L, as fitted steps have it"),
    Field("drawn", (FACTORS.length,), "", "a `FACTORS`"),
    Field("clearance", (), "m", "from the shapes that it keeps out of; negative within one"),
    Field("penetration", (), "m", "how deep it is in one, or 0"),
    Field("base", (3,), "rad, m", "attitude of a base that floats, and where its hub is"),
    Field("told", ("told",), "s, s, 1", "delays of commands and observations, channels' gains, where any is drawn"),
)  # fmt: skip
"""What the caller is told of costs, a payload that changes, pushes, fitted steps, drawn factors, a base that floats."""

FURTHER = _FURTHER.offsets(0, 0)
"""Where these are; FURTHER.end: how many, where nothing is told."""

(
    PERIODS, PERIODS_ALLOWED, MODE, HOLD, TARGET, TARGET_RATE, TORQUE_FACTOR, LEVEL, LATE, COST, CHANGE, PUSHED,
    PATH_AT, GOAL, *_,
) = RECORD.offsets(0, 0, 0, 0, 0, 0, 0, 0)  # fmt: skip
"""Where the fields of a record are that no size moves."""

SUCCESS, TIP, DEFLECTION, *_ = INFO.offsets(0, 0, 0, 0, 0)
"""Likewise of info, the last in the plane."""

SAVED = Layout(
    "Saved", "rows, inputs, motions, record",
    Field("q", ("rows",), "", "state, at the start of the period or stretch"),
    Field("v", ("rows",), "", ""), Field("a", ("rows",), "", ""), Field("b", ("rows",), "", ""),
    Field("books", (BOOKS.length,), "J", "a `BOOKS`"),
    Field("inputs", ("inputs",), "N m", "torques and loads"),
    Field("psi", ("motions", 3), "", "prescribed coordinates, their rates and accelerations"),
    Field("reaction", ("motions",), "N m or N", "what holds them"),
    Field("record", ("record",), "", "a `RECORD`, where a period may change it; otherwise none of it"),
)  # fmt: skip
"""What is kept of an arm, to be gone back to."""

SCRATCH = Layout(
    "Scratch", "links, saved",
    Field("flag", (), "", "how the period came out"),
    Field("fine", (), "", "step size asked for, as halvings of h; -1: done"),
    Field("taken", (), "", "halvings of the run that was kept"), Field("apart", (), "m", "its error"),
    Field("tips", ("links", 4), "m, m/s", "x and y of each link's tip in the coarser run, and their rates"),
    Field("result", ("saved",), "", "a `SAVED`, of the end of the period"),
)  # fmt: skip
"""What fitted steps need of an arm."""

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
"""Modes: stepped; over, waits for a reset; just reset, next step passes it over; motion prescribed, moved elsewhere."""

ACTION_NOT_FINITE, JOINT_LIMIT, RETRY = 100, 101, 102
"""Reasons for an end beside the status codes of `model`; RETRY: to be repeated alone."""

REASONS: dict[float, str] = {
    **{float(code): word if code else "" for code, word in enumerate(STATUS)},
    float(ACTION_NOT_FINITE): "action_not_finite",
    float(JOINT_LIMIT): "joint_limit",
}
"""Words of the codes that `info` holds."""

STATUS_WORDS: dict[float, str] = {code: STATUS[int(code)] if code < len(STATUS) else STATUS[0] for code in REASONS}
"""The solver's status for each of these codes."""

CLIP = 10.0
"""Observations are clipped to this many scales."""


class Block(NamedTuple):
    """Where the sections of a block begin (in float64), lanes inside."""

    par: int  # see `physics.model.OWN`
    poses: int  # a `POSES` a link, in space a `SPACE_POSES`
    record: int  # a `RECORD`
    action: int  # 1 a joint, clipped
    seen: int  # the scaled observation
    info: int  # an `INFO`
    saved: int  # a `SAVED`
    end: int  # of what an arm is; behind it a `SCRATCH`, where steps are fitted
    row: int  # length of a block, in whole cache lines


@inlined
def sections(layout, block):
    """Views of a block's parts: par, poses, record, action, seen, info, saved, and the room behind."""
    return (
        block[layout.par : layout.poses], block[layout.poses : layout.record], block[layout.record : layout.action],
        block[layout.action : layout.seen], block[layout.seen : layout.info], block[layout.info : layout.saved],
        block[layout.saved : layout.end], block[layout.end : layout.row],
    )  # fmt: skip


class Controller(NamedTuple):
    """Joint controllers under the action: torque = stiffness (goal - angle) - damping rate + share limit action."""

    stiffness: np.ndarray  # (N,) N m/rad
    damping: np.ndarray  # (N,) N m s/rad
    share: float
    motors: tuple[int, ...] | None  # a tag where they look at motors that have angles of their own


class Amplifier(NamedTuple):
    """What turns an action into torques: currents, or voltages less what the motors make themselves."""

    gain: np.ndarray  # (N,) N m: torque of the largest current, or of the largest voltage at rest
    emf: np.ndarray | None  # (N,) N m s/rad: what a rate takes of that; of currents None
    limits: np.ndarray  # (N,) N m


class Actuator(NamedTuple):
    """Motors that are not ideal."""

    share: float  # 1 - exp(-h / lag): of the way to the command that a motor makes in a step; 1: no lag
    mean: float  # of that way, the mean over the step
    age: int  # whole control periods by which commands come late
    late: int  # and whole steps
    limits: np.ndarray  # (N,) N m, saturation
    rows: int  # commands that are remembered, those of this period with them
    jitter: tuple[float, float, int] | None = None  # most steps more; of a period; greatest age, in periods
    drawn: tuple[float, float] | None = None  # least and most steps of a delay that is drawn; age and late are 0
    within: tuple[int] | None = None  # a tag: torques turn within a period, not only at its start


class Sensors(NamedTuple):
    """Noise, delay and strain gauges."""

    noise: np.ndarray  # (S,) standard deviation of each entry, in its scale
    age: int  # control periods by which observations come late
    gauges: np.ndarray  # (G, n): rows of `physics.gauges.curvature_rows`, over the scale
    drawn: tuple[float, float] | None = None  # least and most periods, age, where that is drawn for an episode


class Instruments(NamedTuple):
    """Sensors that read by a law; None: there are none of this kind. Channels stand in the order of the fields.

    Their entries follow the task's and the target's, gauges last: goals, accelerometer, gyroscope, camera.
    """

    period: float  # s
    laws: np.ndarray  # a `LAW` for each channel
    entries: int  # that these add, gauges not counted
    room: int  # of the past in a `CHANNEL`
    goals: tuple[int, ...] | None  # a tag: joint angles at the goal less encoder angles, and a target that is a point
    encoders: np.ndarray | None  # (3 N,) int64: entries of each joint's sine, cosine and rate
    motors: np.ndarray | None  # (N,) int64: 1 where the encoder sits on a motor that has an angle of its own
    accelerometer: np.ndarray | None  # (3,), in space (4,): gravity, m/s^2; scale, m/s^2
    camera: float | None  # scale, m
    gauges: tuple[int, ...] | None  # a tag for each
    gyroscope: float | None = None  # scale, rad/s; in space


class Selection(NamedTuple):
    """What of all entries is observed, and how many observations stand in one, the oldest first."""

    chosen: np.ndarray  # (C,) int64
    frames: int


class Reference(NamedTuple):
    """A moving target: given by a table, or drawn anew for each episode."""

    line: tuple[int, ...] | None  # a tag where straight lines are drawn
    table: np.ndarray  # (m, 2 D) target and rate at each control instant, D numbers each; empty: drawn
    ranges: np.ndarray  # (4, 2), in space (5, 2): what the numbers of a drawn path lie within
    ahead: np.ndarray  # (2,) int64: control periods by which the observation looks ahead
    scales: np.ndarray  # (3 D,): of rate and of what comes ahead
    axis: np.ndarray | None = None  # (3,) in space: what joint 0 turns about, in the axes of its link's root


class Cost(NamedTuple):
    """What it costs to go beyond limits; None: no such limit."""

    deflection: np.ndarray | None  # (N,): of each link's tip, over its length
    strain: np.ndarray | None  # (G, n): of `protocol.gauge`, strain at the stations over the limit; in space two each


class Pushes(NamedTuple):
    """Forces on the tip, in directions drawn all around; times in control periods."""

    wait: np.ndarray  # (2,): from one to the next, drawn
    force: np.ndarray  # (2,) N, drawn
    lasting: float
    until: float  # none begins later


class PayloadChange(NamedTuple):
    """A payload that changes once in an episode."""

    time: np.ndarray  # (2,) control periods, drawn
    factor: np.ndarray  # (2,): on the nominal payload, drawn
    resting: tuple[int, ...] | None  # a tag where what is gripped rests; otherwise it moves with the tip


@dataclass(frozen=True)
class Extras:
    """What an ideal environment lacks; None: absent, and not compiled."""

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
    """The model made for steps of h, h/2, ... h/32."""

    whole: Any
    half: Any
    quarter: Any
    eighth: Any
    sixteenth: Any
    least: Any


class Program(NamedTuple):
    """A batch of n arms with its task; A joints, S entries that there are to be seen, O numbers in an observation.

    None: absent, compiled out.
    """

    lane: tuple[int, ...]
    model: Any
    models: Any  # `Models` where steps are fitted to a tolerance, which `model` is the least of; None: steps of h
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
    layout: Block
    entries: int  # S
    books: tuple[int, ...] | None  # a tag where energies are kept
    estimate: float  # of the formulation's own error, as a fraction of L
    period: float  # s
    h: float
    n_steps: int
    n: int
    block: np.ndarray  # (groups row,)
    action: np.ndarray  # (n A,) float32
    observation: np.ndarray  # (n O,) float32
    table: np.ndarray  # (I groups L,): info once more, entry by entry, for the caller to read
    reward: np.ndarray  # (n,)
    terminated: np.ndarray  # (n,) uint8
    truncated: np.ndarray  # (n,) uint8
    stream: np.ndarray  # (n,) uint64
    queue: np.ndarray  # (n,) int64: arms to be started
    request: np.ndarray  # a `REQUEST`


def complete(program: Program) -> Program:
    """The program with models that have the terms of all of an arm's own parameters (`physics.model.complete`)."""
    models = program.models and Models(*map(model.complete, program.models))
    return program._replace(model=model.complete(program.model), models=models)
