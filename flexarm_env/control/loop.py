"""Stability of closed loops: a linear arm about rest, sampled at the control period, with delays and motor lag."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from ..linear.state_space import held
from ..validation import Array
from .arm_model import ArmModel

MOST_GAIN, MOST_DELAY = 100.0, 100
"""Upper limits of the searches for gain margins and for delay margins (control periods)."""


def plant(model: ArmModel, dt: float, delay: float = 0.0, lag: float = 0.0) -> tuple[Array, Array, Array]:
    """Discretize the arm over a control period: x+ = A x + B u, y = C x, with the commanded torques u.

    Returns the matrices (A, B, C). The states are the model's states, then the motors' torques if lag > 0, then the
    delayed commands.

    Args:
        dt: control period, s. delay: sum of the delays of commands and readings, s. lag: time constant of the motors,
            s.
    """
    A, B, C = model.A, model.B, model.C
    n, joints = B.shape
    # first-order motors: tau' = (u - tau) / lag
    if lag > 0.0:
        A = np.block([[A, B], [np.zeros((joints, n)), -np.eye(joints) / lag]])
        B, C = np.vstack([np.zeros((n, joints)), np.eye(joints) / lag]), np.hstack([C, np.zeros((len(C), joints))])
        n += joints
    # split the delay into whole periods and a fraction of one
    whole = int(np.floor(delay / dt + 1e-9))
    part = max(0.0, delay - whole * dt)
    Ad, Bd = held(A, B, dt)
    # a command delayed by part of a period acts for dt - part in its own period and for part in the next
    late = Bd - held(A, B, dt - part)[1] if part > 1e-9 * dt else np.zeros_like(Bd)
    rows = whole + (part > 1e-9 * dt)
    if not rows:
        return Ad, Bd, C
    size = n + rows * joints
    F, G = np.zeros((size, size)), np.zeros((size, joints))
    F[:n, :n] = Ad
    # input matrix of the command issued `age` periods ago
    into = [Bd - late if age == whole else late if age == whole + 1 else np.zeros_like(Bd) for age in range(rows + 1)]
    G[:n] = into[0]
    for age in range(1, rows + 1):  # commands of so many periods before
        F[:n, n + (age - 1) * joints : n + age * joints] = into[age]
        if age > 1:
            F[n + (age - 1) * joints : n + age * joints, n + (age - 2) * joints : n + (age - 1) * joints] = np.eye(
                joints
            )
    # the newest command enters the delay line
    G[n : n + joints] = np.eye(joints)
    return F, G, np.hstack([C, np.zeros((len(C), rows * joints))])


Law = tuple[Array, Array, Array, Array]
"""(P, Q, K, D) of a controller: z+ = P z + Q y, u = -(K z + D y), with controller states z (possibly none)."""


def radius(system: tuple[Array, Array, Array], law: Law, gain: float = 1.0) -> float:
    """Return the spectral radius of the closed loop with the torques multiplied by `gain`; below 1 the loop is stable.

    system: matrices (A, B, C) that `plant` returns. law: matrices (P, Q, K, D) of the controller z+ = P z + Q y, u =
    -(K z + D y), with its states z and the measured outputs y.
    """
    A, B, C = system
    P, Q, K, D = law
    # states (x, z)
    loop = np.block([[A - gain * B @ D @ C, -gain * B @ K], [Q @ C, P]])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def gain_margin(system: tuple[Array, Array, Array], law: Law) -> float:
    """Return the gain margin: the smallest factor above 1 on the torques that makes the loop unstable.

    For an unstable loop the result is 1. The search ends at the factor `MOST_GAIN`.
    """
    return _edge(lambda factor: radius(system, law, factor) < 1.0, np.geomspace(1.0, MOST_GAIN, 60))


def delay_margin(model: ArmModel, dt: float, law: Law, lag: float = 0.0) -> float:
    """Return the delay margin, s: the smallest delay that makes the loop unstable.

    For an unstable loop the result is 0. The search ends at `MOST_DELAY` periods. dt: control period, s. lag: time
    constant of the motors, s.
    """
    return _edge(lambda delay: radius(plant(model, dt, delay, lag), law) < 1.0, dt * np.arange(MOST_DELAY + 1.0))


def _edge(stable: Callable[[float], bool], grid: Sequence[float] | Array) -> float:
    """Return the end of the first stable interval: search on the grid from its first value, then 12 bisections.

    stable: whether the loop is stable at a value (gain factor or delay, s). If the loop is unstable at the grid's first
    value, the result is this value.
    """
    if not stable(float(grid[0])):
        return float(grid[0])
    for low, high in itertools.pairwise(grid):
        if not stable(float(high)):
            for _ in range(12):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if stable(float(middle)) else (low, middle)
            return float(low)
    return float(grid[-1])


def pd_law(kp: Array, kd: Array) -> Law:
    """Return the matrices of PD control u = -(kp angle + kd rate) for the outputs of an `ArmModel`.

    kp (N,): stiffness of each joint, N m/rad. kd (N,): damping of each joint, N m s/rad. Returns the matrices (P, Q, K,
    D) that `radius` defines; PD control has no controller states.
    """
    n = len(kp)
    D = np.hstack([np.diag(kp), np.diag(kd), np.zeros((n, 2 * n))])
    return np.zeros((0, 0)), np.zeros((0, 4 * n)), np.zeros((n, 0)), D


def observer_law(A: Array, B: Array, C: Array, K: Array, L: Array) -> Law:
    """Return the matrices of u = -K x^ with an observer's estimate x^.

    In each period the observer first corrects the estimate by L (y - C x^). The controller then computes u from the
    estimate, and the observer predicts the next estimate, A x^ + B u. A, B, C: discrete model. Returns the matrices (P,
    Q, K, D) that `radius` defines; the controller's states are the predicted estimate.
    """
    # corrected estimate: (I - L C) x^ + L y
    keep = np.eye(len(A)) - L @ C
    step = A - B @ K
    return step @ keep, step @ L, K @ keep, K @ L
