"""Receding-horizon control (MPC): in every period plan torques for the next periods, and apply the first torque.

`ilqr` plans on the elastica model, within the torque limits, from the estimated state. The cost contains the effort
and, from a planned arrival time on, the distance from rest at the goal. Before the planned arrival the distance from
the goal has no cost, since saturated torques would otherwise cause overshoot. The terminal cost is the cost-to-go of a
linear regulator (LQR) at the goal. In each period the previous plan is simulated with its feedback gains from the
present state, and is improved by one iteration. If a plan does not reach the goal at its arrival time, the arrival is
postponed. At the start of an episode the arrival is postponed until a plan succeeds. Later in the episode the arrival
is postponed at most by the time that an arm with other parameters could need. The regulator replaces the plan as soon
as its torques alone satisfy the limits.

Joint angles, tip deflections and their rates are measured. The model predicts all other state variables. The predicted
higher modes are the nominal arm's modes and can be wrong for the real arm. The predicted shape of a link is therefore
blended with the shape of a link under a static tip force (`MPCGains.memory`).

The cost also penalizes the violation of joint limits and points inside shapes to be avoided.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.plane import rigid_times
from ..parameters import Arm
from ..rigid import rigid_inertia
from ..validation import Array
from . import ilqr
from .arm_model import GRID
from .base import Controller, Setup, Signals
from .bounds import Bounds, within
from .dynamics import Dynamics, SpatialDynamics, dynamics
from .lqr import SENSOR, StateWeights, riccati
from .mpc_estimate import memory_for
from .space import AboutRest

LATEST = 2.0
"""Latest arrival divided by the first planned one. An arm with a quarter of the stiffness, or four times the mass,
takes twice as long. The cost of a plan does not count vibration before the arrival. If the arrival were postponed
without limit, this vibration could therefore grow in an arm with little damping."""

STIFF = 100.0
"""Factor on the initial penalties of `optimal`'s plans, since receding-horizon control updates no multipliers."""

MOST = 60
"""Largest number of attempts at an episode's first plan."""


class Grid:
    """Stages of a plan: the first stage can be shorter, all other stages have equal length."""

    def __init__(self, first: Dynamics, later: Dynamics) -> None:
        self.first, self.later = first, later
        self.size, self.n_inputs = later.size, later.n_inputs

    def stage(self, k: int, x: Array, u: Array) -> Array:
        """Advance the states by stage k (see `ilqr.System`)."""
        return (self.later if k else self.first).advance(x, u)

    def linear(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return the derivatives A and B of all stages (see `ilqr.System`)."""
        A, B = self.later.linear(x, u)
        if self.first is not self.later:
            A[:1], B[:1] = self.first.linear(x[:1], u[:1])
        return A, B


@dataclass(frozen=True)
class MPCGains(StateWeights):
    """`StateWeights` of the stage cost, and parameters of planning and estimation.

    Args:
        memory: weight, 0 to 1, of the model's prediction for the part of the state that is not measured. The shape of a
            link under a static force at its tip has the weight 1 - memory. The weight is reduced for arms and control
            periods for which the estimate would decay too slowly (`mpc_estimate`).
        allowed: a plan has reached the goal if the cost of the distance from the goal is below this value.
        block: number of control periods with the same planned torque, for the default control period of the
            environment; if the control period is shorter, a block has more periods, so that its duration stays the
            same. horizon: number of blocks in a plan.
        iterations: number of iLQR iterations per period. first: number of iterations for an episode's first plan.
        margin: distance that plans keep from shapes, divided by the arm's length, and from joint limits, rad.
    """

    memory: float = 1.0
    allowed: float = 10.0
    block: int = 2
    horizon: int = 50
    iterations: int = 1
    first: int = 10
    margin: float = 0.02


class Regulator(NamedTuple):
    """LQR about rest, u = -K dx, with the cost-to-go 1/2 dx' P dx.

    The torques are within their limits if dx' P dx <= reach.
    """

    K: Array
    P: Array
    reach: float


@lru_cache(maxsize=512)
def regulator(arm: Arm, period: float, gains: MPCGains, posture: tuple[float, ...]) -> Regulator:
    """Compute the regulator about rest at a posture (elbow angles, rad). period: length of a stage, s."""
    plant = dynamics(arm, period)
    rest = plant.still(np.array([(0.0, *posture)]))
    return regulators(plant, *rest, plant.stage_weight(gains))[0]


def regulators(plant: Dynamics, x: Array, u: Array, stage: Array) -> list[Regulator]:
    """Compute the regulators about rest states x (n, S) with holding torques u (n, N) divided by their limits.

    stage (S, S): stage cost matrix.
    """
    found = []
    for A, B, held in zip(*plant.jacobians(x, u), u, strict=True):
        K, P = riccati(A, B, stage, np.eye(plant.n_inputs))
        # reach = min_i (1 - |u_i|)^2 / (K P^-1 K')_ii: largest P-ellipsoid in which no torque saturates
        left = (1.0 - np.minimum(np.abs(held), 1.0)) ** 2
        found.append(Regulator(K, P, float(np.min(left / np.einsum("is,is->i", K, np.linalg.solve(P, K.T).T)))))
    return found


class MPC(Controller):
    """Receding-horizon controller that plans on the nonlinear elastica model of the arm.

    Attributes:
        x (n, S): estimated states (see `dynamics.Dynamics`).
        plan: torques (H, n, N), divided by their limits, and feedback gains. left: number of further periods in which
            the first block of torques applies.
        arrival, latest (n,): planned and latest arrival at the goal, in control periods from the start of the episode.
    """

    needs_bends = True
    wild, ahead, put_off = np.inf, 1.0, 0.03
    """Three numbers: the miss cost above which a plan is discarded; the first arrival time tried, divided by the rigid
    arm's minimum time; the share of that time by which an arrival is postponed during an episode's first plan."""
    tuned_for = 0.02
    """Control period, s, for which `MPCGains.block` is tuned."""

    def __init__(self, setup: Setup, gains: MPCGains) -> None:
        """Prepare the dynamics, cost and bounds; they do not depend on the episode."""
        super().__init__(setup)
        self.gains = gains
        arm, dt = setup.arm, setup.control_dt
        # plans last as long as with the period for which the gains are tuned
        self.block = max(gains.block, round(gains.block * self.tuned_for / dt))
        # blocks of 1 ... `block` periods; a plan's first stage is what remains of the current block
        held = [dynamics(arm, k * dt, gravity=setup.gravity) for k in range(1, self.block + 1)]
        self.plant, self.grids = held[0], [Grid(first, held[-1]) for first in held]
        self.stage = self.plant.stage_weight(gains)
        # joint limits narrowed by the margin, at most a tenth of their range on either side
        ends = [(-np.inf, np.inf) if one is None else one for one in arm.joint_limits or ()]
        joints = [(low + near, high - near) for low, high in ends for near in [min(gains.margin, 0.1 * (high - low))]]
        self.bounds = Bounds(joints=joints, keep_out=setup.keep_out, margin=gains.margin * arm.total_length)
        self.effort = np.full(setup.n_joints, float(self.block))
        self.memory = self._memory()

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Compute the states at rest, regulators and first plans of new episodes."""
        n, gains, setup = len(to_go), self.gains, self.setup
        self.home, self.still = self.plant.still(self.goal)
        owned = self._regulators()
        self.K, self.P = np.stack([r.K for r in owned]), np.stack([r.P for r in owned])
        self.reach = np.array([r.reach for r in owned])
        self.x = self._standing(signals, to_go)
        shape, self.left = (gains.horizon, n, setup.n_joints), self.block
        states = np.zeros((gains.horizon + 1, *self.x.shape))
        controls = np.broadcast_to(self.still, shape).copy()
        self.plan = ilqr.Solution(controls, states, np.zeros(n), np.zeros((*shape, self.plant.size)))
        self._begin(to_go)
        self.latest = LATEST * self.arrival

    def _begin(self, to_go: Array) -> None:
        """Make the episodes' first plans: start at the rigid arm's minimum time, postpone until a plan arrives."""
        n, gains = len(to_go), self.gains
        quickest = rigid_times(self._inertia(), to_go, self.limits)
        self.arrival = np.ceil(self.ahead * quickest / self.setup.control_dt)
        late, iterations, missed = np.ones(n, np.bool_), gains.first, np.zeros(n)
        for _ in range(MOST):
            missed[late] = self._improve(late, iterations)
            late = (missed > gains.allowed) & (self.arrival < self._ends[-2])
            if not late.any():
                break
            # postpone by a share of the arrival, at least one period
            self.arrival[late] += np.maximum(1.0, np.round(self.put_off * self.arrival[late]))
            iterations = 3

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Improve the plans, or use the regulator near the goal; return torques (n, N), N m."""
        self.plan.states[0] = self.x
        self.x = self._estimate(signals, to_go)
        off = self.x - self.home
        shares = self.still - (self.K @ off[:, :, None])[:, :, 0]
        # outside dx' P dx <= reach the regulator would saturate: plan there
        far = np.einsum("ni,nij,nj->n", off, self.P, off) > self.reach
        if far.any():
            missed = self._improve(far, self.gains.iterations)
            wild = far.copy()
            wild[far] = missed > self.wild
            self._give_up(wild)
            shares[far] = self.plan.controls[0][far]
            # postpone missed arrivals by one period, up to `latest`
            self.arrival[far] += (missed > self.gains.allowed) & (self.arrival[far] < self.latest[far])
        return np.asarray(shares * self.limits)

    def predict(self, torques: Array) -> None:
        """Advance the estimate by one period under the applied torques; shift the plans at the end of a block."""
        self.x = self.plant.advance(self.x, torques / self.limits)
        # restart at the goal where the model failed
        lost = ~np.isfinite(self.x).all(axis=1)
        self.x[lost] = self.home[lost]
        self.left -= 1
        # shift the plans by one block; the last block holds the arm
        if not self.left:
            plan, self.left = self.plan, self.block
            for values in (plan.controls, plan.gains, plan.states):
                values[:-1] = values[1:]
            plan.controls[-1], plan.gains[-1] = self.still, 0.0

    @property
    def _ends(self) -> Array:
        """Return the instants (H + 1,) at the ends of the plan's stages, in periods from the episode's start."""
        stages = np.arange(self.gains.horizon)
        return self.step + np.concatenate([[0.0], self.left + self.block * stages])

    def _improve(self, chosen: NDArray[np.bool_], iterations: int) -> Array:
        """Improve the plans of the chosen arms from their present states; return each arm's miss at arrival, dx' P dx.

        chosen (n,): mask of the arms whose plans are improved. iterations: number of iLQR iterations. The result has
        one number for each chosen arm, inf if planning failed.
        """
        # stage cost from the arrival on, terminal cost P of the regulator
        there = self._ends[:, None] >= self.arrival[chosen]
        weight = (self.block * there)[:, :, None, None] * self.stage
        weight[-1] = self.P[chosen]
        cost = ilqr.Quadratic(self.home[chosen], weight)
        limits = within(self.plant, self.bounds, weight.shape[1], len(weight) - 1, STIFF)
        grid, plan = self.grids[self.left - 1], self.plan
        own = ilqr.Solution(plan.controls[:, chosen], plan.states[:, chosen], plan.cost, plan.gains[:, chosen])
        try:
            found = ilqr.solve(
                grid, self.x[chosen], own, [cost, *limits], self.effort, iterations=iterations,
                still=self.still[chosen],
            )  # fmt: skip
        except ilqr.Astray as error:  # the model does not move from where these arms are taken to be
            missed, lost = np.full(len(error.arms), np.inf), chosen.copy()
            lost[chosen] = error.arms
            self._give_up(lost)
            if not error.arms.all():
                missed[~error.arms] = self._improve(chosen & ~lost, iterations)
            return missed
        plan.controls[:, chosen], plan.states[:, chosen] = found.controls, found.states
        plan.gains[:, chosen] = found.gains
        # miss: cost-to-go of the first planned state at or after the arrival
        at = np.where(there.any(axis=0), np.argmax(there, axis=0), len(there) - 1)
        off = found.states[at, np.arange(len(at))] - self.home[chosen]
        return np.asarray(np.einsum("ni,nij,nj->n", off, self.P[chosen], off))

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        """Return states (n, S) with the measured outputs, in which forces at the tips bend the links."""
        return self.plant.corrected(self.plant.unbent(self.goal - to_go), signals.outputs(self.goal - to_go))

    def _inertia(self) -> Array:
        """Return the inertia (n, N, N), kg m^2, of the rigid arm at its goal."""
        return rigid_inertia(self.setup.arm, self.goal)

    def _give_up(self, chosen: NDArray[np.bool_]) -> None:
        """Discard the plans of the chosen arms (mask): set torques and gains to zero."""
        self.plan.controls[:, chosen], self.plan.gains[:, chosen] = 0.0, 0.0

    def _estimate(self, signals: Signals, to_go: Array) -> Array:
        """Estimate states (n, S): blend prediction and measured shape, then match the measured outputs."""
        kept = self.memory
        guess = kept * self.x + (1.0 - kept) * self._standing(signals, to_go)
        return self.plant.corrected(guess, signals.outputs(self.goal - to_go))

    def _memory(self) -> float:
        """Return the weight of the prediction in the estimate, for which deviations from a straight arm decay."""
        own = self.setup.arm, self.setup.control_dt, self.gains
        straight = regulator(*own, (0.0,) * (self.setup.n_joints - 1))
        return memory_for(self.setup.arm, self.plant, straight.K, self.gains.memory)

    def _regulators(self) -> list[Regulator]:
        """Return each arm's regulator at its goal's posture, rounded to the design grid."""
        own = self.setup.arm, self.setup.control_dt, self.gains
        postures = np.round(self.goal[:, 1:] / GRID) * GRID
        return [regulator(*own, tuple((0.0 + row).tolist())) for row in postures]


SOONER, SPARE = 0.9, 1.2
"""Factor from a successful arrival time to the next attempt; final arrival time divided by the soonest one found."""

NOISE, UNSEEN = 0.02, 3e-4
"""Process noise of the filter per period: torques, divided by their limits; angles and strains, rad, and their rates
divided by the first frequency."""

RATES, UNKNOWN = 10.0, 9.0
"""Standard deviation of measured rates divided by `SENSOR`; initial state variances divided by those of `UNSEEN`."""


class SpatialMPC(MPC, AboutRest):
    """MPC in space about the static equilibrium at the target under gravity, with an extended Kalman filter.

    Attributes:
        spread (n, S, S): covariance of the error of the estimated states.
    """

    wild, ahead, put_off, tuned_for = 1e3, 2.0, 0.1, 0.01

    def _memory(self) -> float:
        """Return 1: the filter corrects the prediction."""
        return 1.0

    def initialise(self, signals: Signals, to_go: Array) -> None:
        """Set the filter's covariances, and compute rest states, regulators and first plans."""
        plant, n = self.plant, self.setup.n_joints
        many = signals.bends.shape[1]
        # measurement variances of angles, rates, deflections and their rates; process noise of the state
        self.seen = np.square(np.repeat([SENSOR, RATES * SENSOR * plant.first] * 2, [n, n, many, many]))
        self.unseen = np.diag(np.square(np.repeat([UNSEEN, UNSEEN * plant.first], plant.half)))
        self.spread = np.broadcast_to(UNKNOWN * self.unseen, (len(to_go), *self.unseen.shape))
        super().initialise(signals, to_go)

    def _estimate(self, signals: Signals, to_go: Array) -> Array:
        """Correct the predicted states (n, S) with the measured outputs (extended Kalman filter) and the covariance."""
        values, C = self.plant.outputs(self.x)
        # L = P C' (C P C' + V)^-1;  P <- P - L C P
        S = self.spread @ C.swapaxes(1, 2)
        L = np.linalg.solve(C @ S + np.diag(self.seen), S.swapaxes(1, 2)).swapaxes(1, 2)
        self.spread = self.spread - L @ S.swapaxes(1, 2)
        return np.asarray(self.x + (L @ (signals.outputs(self.goal - to_go) - values)[:, :, None])[:, :, 0])

    def _inertia(self) -> Array:
        return self.plant.inertia(self.goal)

    def _give_up(self, chosen: NDArray[np.bool_]) -> None:
        """Replace the plans of the chosen arms by gentle regulators, with the arrival at the horizon's end."""
        plan = self.plan
        plan.gains[:, chosen], plan.states[:, chosen] = -self.gentle[chosen], self.home[chosen]
        plan.controls[:, chosen] = self.still[chosen]
        # the present block: feedback from the present state, saturated
        off = self.x[chosen] - self.home[chosen]
        now = self.still[chosen] - (self.gentle[chosen] @ off[:, :, None])[:, :, 0]
        plan.controls[0, chosen], plan.states[0, chosen] = np.clip(now, -1.0, 1.0), self.x[chosen]
        self.arrival[chosen] = self._ends[-2]

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        return self.plant.unbent(self.goal - to_go)

    def predict(self, torques: Array) -> None:
        """Advance estimate and covariance, P+ = A P A' + B N B' + W, by one period under the applied torques."""
        A, B = self.plant.jacobians(self.x, torques / self.limits)
        moved = A @ self.spread @ A.swapaxes(1, 2) + NOISE**2 * B @ B.swapaxes(1, 2) + self.unseen
        # restart the covariance where the model failed
        lost = ~np.isfinite(moved).all(axis=(1, 2), keepdims=True)
        self.spread = np.where(lost, UNKNOWN * self.unseen, 0.5 * (moved + moved.swapaxes(1, 2)))
        super().predict(torques)

    def _regulators(self) -> list[Regulator]:
        return regulators(self.plant, self.home, self.still, self.stage)

    def _begin(self, to_go: Array) -> None:
        """Make the episodes' first plans: find the soonest arrival of a successful plan, then allow some more time."""
        gains, plan, held, everyone = self.gains, self.plan, self.grids[-1].first, np.ones(len(to_go), np.bool_)
        assert isinstance(held, SpatialDynamics)
        self.gentle = held.homing(self.home, self.still)
        # start from gentle regulators with the latest arrival
        self.arrival = np.zeros(len(to_go))
        self._give_up(everyone)
        super()._begin(to_go)
        # shorten successful arrivals until a plan fails, and restore the last success
        on = self._improve(everyone, 1) <= gains.allowed
        while on.any():
            kept, before = (plan.controls.copy(), plan.gains.copy(), plan.states.copy()), self.arrival.copy()
            self.arrival[on] = np.floor(SOONER * self.arrival[on])
            lost = on.copy()
            lost[on] = self._improve(on, 3) > gains.allowed
            for now, old in zip((plan.controls, plan.gains, plan.states), kept, strict=True):
                now[:, lost] = old[:, lost]
            self.arrival[lost] = before[lost]
            on &= ~lost
        self.arrival = np.minimum(np.ceil(SPARE * self.arrival), self._ends[-2])
        self._improve(everyone, gains.first)
