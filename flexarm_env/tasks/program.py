"""All that the compiled environment works on: what is where in an arm's memory, and the tuple that holds everything."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

STEP, LIMIT, MODE, HOLD, TARGET, TARGET_RATE, TORQUE_FACTOR, FRICTION, PATH, GOAL = 0, 1, 2, 3, 4, 6, 8, 9, 10, 16
"""An arm's record: control periods done, allowed; mode; instants in the band; target (2) and its rate (2); factor of
the torque constant; energy lost in joint friction, J; numbers of the reference's path (6); joint angles that reach the
target (N). After them, where there are such: motor torques (N), commands (N an age), past observations (O an age)."""

RUNNING, OVER, FRESH, GUIDED = range(4)
"""Modes: stepped; over, waits for a reset; just reset, next step passes it over; motion prescribed, moved elsewhere."""

SUCCESS, TIP, DEFLECTION = 0, 1, 3
"""First entries of info: success, tip x y; then come tip deflections, target, torques, reward terms, the tail."""
IN_RANGE, ERROR, REASON, ENERGIES, REWARD, TRUNCATED = 0, 1, 2, 3, 8, 9
"""Entries of the tail of info: in range, error estimate, reason, kinetic, strain, gravity, dissipated, work, reward,
truncated (1 or 0)."""
TAIL = 10

ACTION_NOT_FINITE, JOINT_LIMIT, RETRY = 100, 101, 102
"""Reasons for an end beside the status codes of `model`; RETRY: to be repeated alone."""

CLIP = 10.0
"""Observations are clipped to this many scales."""


class Layout(NamedTuple):
    """Where the sections of a block begin (in float64), lanes inside."""

    par: int  # 4: payload mass, payload inertia, EI factor, tau_d
    poses: int  # 12 a link
    record: int  # see above
    action: int  # 1 a joint, clipped
    seen: int  # the scaled observation
    info: int  # see above
    saved: int  # q, v, a, b at the period's start, then books (3), inputs, and the record where a period may change it
    end: int  # of what an arm is; behind it the scratch of fitted steps (`adaptive.py`), where there are such
    row: int  # length of a block, in whole cache lines


class Ranges(NamedTuple):
    """What a fresh start is drawn from, uniformly; tables by rows, ranges (low, high). N links, n rows of the state."""

    pose: np.ndarray  # (n, 1 + 3 N): q = pose (1, alpha_k, cos alpha_k, sin alpha_k), alpha the links' absolute angles
    shake: np.ndarray  # (n, 3): velocities of a unit of initial vibration: constant, cos and sin of alpha_0
    nominal: np.ndarray  # (4,) of par
    start: np.ndarray  # (N, 2) rad, joint angles
    target: np.ndarray  # (2, 2): rad (slew, from the start), or m and rad (reach, polar)
    straight: float  # share of starts with all joints at 0
    vibration: float  # largest initial vibration, as a tip deflection over L
    factors: np.ndarray  # (4, 2): payload, EI, damping, torque constant


class Controller(NamedTuple):
    """Joint controllers under the action: torque = stiffness (goal - angle) - damping rate + share limit action."""

    stiffness: np.ndarray  # (N,) N m/rad
    damping: np.ndarray  # (N,) N m s/rad
    share: float


class Actuator(NamedTuple):
    """Motors that are not ideal, and friction in the joints."""

    share: float  # 1 - exp(-h / lag): of the way to the command that a motor makes in a step; 1: no lag
    age: int  # whole control periods by which commands come late
    late: int  # and whole steps
    limits: np.ndarray  # (N,) N m, saturation
    viscous: np.ndarray  # (N,) N m s/rad
    coulomb: np.ndarray  # (N,) N m
    creep: float  # rad/s: Coulomb friction is coulomb w / sqrt(w^2 + creep^2)


class Sensors(NamedTuple):
    """Noise, delay and strain gauges."""

    noise: np.ndarray  # (O,) standard deviation of each entry, in its scale
    age: int  # control periods by which observations come late
    gauges: np.ndarray  # (G, n): curvature at the stations from the state, over the scale


class Reference(NamedTuple):
    """A moving target: given by a table, or drawn anew for each episode."""

    table: np.ndarray  # (m, 2 D) target and rate at each control instant, D numbers each; empty: drawn
    ranges: np.ndarray  # (4, 2): what the numbers of a drawn path lie within
    ahead: np.ndarray  # (2,) int64: control periods by which the observation looks ahead
    scales: np.ndarray  # (3 D,): of rate and of what comes ahead


class Models(NamedTuple):
    """The model made for steps of h, h/2, ... h/32."""

    whole: Any
    half: Any
    quarter: Any
    eighth: Any
    sixteenth: Any
    least: Any


class Program(NamedTuple):
    """A batch of n arms with its task; A joints, O entries of the observation. None: absent, compiled out."""

    lane: tuple[int, ...]
    model: Any
    models: Any  # `Models` where steps are fitted to a tolerance, which `model` is the least of; None: steps of h
    allowed: float  # that tolerance, m
    scheme: Any
    task: Any
    ranges: Ranges
    controller: Controller | None
    actuator: Actuator | None
    sensors: Sensors | None
    reference: Reference | None
    layout: Layout
    entries: int  # O
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
    wish: np.ndarray  # (A + 3,): start angles, target, vibration wished for; NaN: drawn
    outside: np.ndarray  # (12 A + 2 A + 6,): poses, torques, actions, energies and range of a guided arm
