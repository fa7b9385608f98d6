"""Time-optimal slews of one flexible link to rest: a bang-bang plan, which an LQR follows.

The plan uses the linear model of `arm_model` with torques that are constant over a control period. Bisection and linear
programs (HiGHS, through SciPy) find the smallest number of periods in which limited torques bring rigid motion and
bending modes to rest at the goal.
"""

from dataclasses import dataclass, field

import numpy as np

from .. import validation as check
from ..validation import Array
from .arm_model import arm_model
from .base import Setup, Signals
from .lqr import LQR, LQRGains, times


@dataclass(frozen=True)
class Plan:
    """Torques of n control periods that bring the arm to rest at the goal.

    torques (n, N): torques, N m, one row per control period. states (n + 1, m): states relative to the goal; the last
    state is zero.
    """

    torques: Array
    states: Array

    @property
    def periods(self) -> int:
        """Number of control periods in the plan."""
        return len(self.torques)


def rigid_time(inertia: float, angle: float, limit: float) -> float:
    """Return the duration, s, of the rigid arm's time-optimal slew, 2 sqrt(inertia angle / limit).

    inertia: inertia about the hub, kg m^2. angle: angle of the slew, rad. limit: torque limit of the motor, N m.
    """
    return 2.0 * float(np.sqrt(inertia * abs(angle) / limit))


def plan(A: Array, B: Array, start: Array, limits: Array, least: int = 1, most: int | None = None) -> Plan:
    """Find the plan with the fewest periods from a state to the zero state.

    Args:
        A (m, m), B (m, N): matrices of the discrete model. start (m,): initial state. limits (N,): torque limits, N m.
        least, most: bounds of the number of periods; most=None means 1000, or four times `least` if this is larger.
    Raises:
        ValueError: there is no plan of at most `most` periods.
    """
    A, start = check.array("A", A, ("m", "m")), check.array("start", start, (len(A),))
    B = check.array("B", B, (len(A), "N"))
    limits = check.array("limits", limits, (B.shape[1],))
    if not (limits > 0.0).all():
        raise check.InvalidValue("limits", limits, "must be positive (N m)")
    least = check.integer("least", least, minimum=1)
    high, most = least, check.integer("most", max(1000, 4 * least) if most is None else most, minimum=least)
    found = _feasible(A, B, start, limits, high)
    low = high if found is None else least - 1
    while found is None:
        if high >= most:
            raise ValueError(f"most = {most}: no plan of so few periods brings the arm to rest at its goal")
        low, high = high, min(most, int(1.3 * high) + 1)
        found = _feasible(A, B, start, limits, high)
    shortest = found
    # bisect: low infeasible, high feasible
    while high - low > 1:
        middle = (low + high) // 2
        tried = _feasible(A, B, start, limits, middle)
        low, high = (middle, high) if tried is None else (low, middle)
        shortest = shortest if tried is None else tried
    states = [start]
    for torque in shortest:
        states.append(A @ states[-1] + B @ torque)
    return Plan(shortest, np.array(states))


def _feasible(A: Array, B: Array, start: Array, limits: Array, periods: int) -> Array | None:
    """Find torques (periods, N), N m, that lead from `start` to zero, by a linear program; None if no torques do."""
    from scipy.optimize import linprog

    n_inputs = B.shape[1]
    # columns of [A^(n-1) B ... B] times the limits; rows scaled to a largest entry of 1
    columns, block = np.empty((len(A), periods * n_inputs)), B * limits
    for k in reversed(range(periods)):
        columns[:, k * n_inputs : (k + 1) * n_inputs] = block
        block = A @ block
    end = np.linalg.matrix_power(A, periods) @ start
    scale = 1.0 / np.maximum(np.abs(columns).max(axis=1), 1e-12)
    answer = linprog(
        np.zeros(columns.shape[1]), A_eq=columns * scale[:, None], b_eq=-end * scale, bounds=(-1.0, 1.0), method="highs"
    )
    return answer.x.reshape(periods, n_inputs) * limits if answer.status == 0 else None


def slew_plan(setup: Setup, angle: float, effort: float = 1.0, flexible: int | None = None) -> Plan:
    """Find the plan with the fewest periods for one link from rest to rest.

    setup: arm, control period and torque limit. angle: angle of the slew, rad. effort: largest torque of the plan
    divided by the torque limit. flexible: number of flexible modes, see `LQRGains`. Raises ValueError if `plan` finds
    no plan.
    """
    model, limits = arm_model(setup.arm, (), flexible), np.asarray(setup.torque_limits)
    least = int(rigid_time(float(model.inertia[0, 0]), angle, float(limits[0])) / setup.control_dt)
    # rigid slew by -angle from the goal, without deflection
    start = model.state_of(np.array([-angle, 0.0, 0.0, 0.0]))
    return plan(*model.discrete(setup.control_dt), start, effort * limits, max(1, least))


@dataclass(frozen=True)
class TimeOptimalGains(LQRGains):
    """Gains of the LQR that follows the plan. effort: largest torque of plans divided by the torque limit."""

    effort: float = field(kw_only=True)


class TimeOptimal(LQR):
    """Time-optimal controller of one link: the plan's torques plus LQR feedback.

    The feedback acts on the deviation from the plan's states and, after the end of the plan, from the goal.
    """

    def __init__(self, setup: Setup, gains: TimeOptimalGains) -> None:
        """Check that the arm has one link, and store the effort."""
        if setup.n_joints != 1:
            raise ValueError(f"time_optimal plans for one link; this arm has {setup.n_joints}")
        super().__init__(setup, gains)
        self.effort = gains.effort

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Compute each arm's plan from its estimated state, and extend all plans with zeros to the same length."""
        super().initialise(signals, to_go)
        # a plan cannot be shorter than the rigid arm's minimum time at full torque
        limits, observer = self.effort * self.limits, self.observer
        inertia = float(self.designs()[0].model.inertia[0, 0])
        rigid = [rigid_time(inertia, float(angle), float(self.limits[0])) for angle in to_go[:, 0]]
        least = [max(1, int(seconds / self.setup.control_dt)) for seconds in rigid]
        plans = [plan(observer.A[i], observer.B[i], x, limits, least[i]) for i, x in enumerate(observer.x)]
        self.periods = np.array([p.periods for p in plans])
        longest = int(self.periods.max())
        self.plan_torques = np.zeros((longest + 1, len(plans), self.setup.n_joints))
        self.plan_states = np.zeros((longest + 1, *observer.x.shape))
        for i, p in enumerate(plans):
            self.plan_torques[: p.periods, i] = p.torques
            self.plan_states[: p.periods, i] = p.states[:-1]

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Return torques (n, N), N m: the plan's torques plus LQR feedback on the deviation from the plan's states."""
        self.observer.update(signals.outputs(-to_go))
        # after its end the plan is zero: LQR about the goal
        k = min(self.step, len(self.plan_torques) - 1)
        torques: Array = self.plan_torques[k] - times(self.observer.K, self.observer.x - self.plan_states[k])
        return torques
