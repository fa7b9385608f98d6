"""Receding-horizon control: in every period the torques of the next ones are planned anew, and the first is applied.

The plan is that of `ilqr` on the elastica, within the torque limits, from the state as it is read. It costs effort, and
from an instant of arrival on the distance from rest at the goal; behind the horizon stands the linear regulator at the
goal. (With a cost of the distance from the start on, torques that saturate overshoot.) It goes on from the plan of the
period before, followed by its gains from where the arm is now, by an iteration. An arrival that a plan misses is put
off: when an episode begins until none does, later as far as an arm that differs from the nominal one may need. Once the
regulator stays within the limits by itself, it takes over.

Read are joint angles, deflections of the tips and their rates. The rest of the state is the model's prediction, drawn
towards that of a link bent by a force at its tip: the prediction knows the higher modes of the nominal arm, and is
wrong on another.

Joint limits, and shapes that the arm is to stay out of, cost what plans miss them by.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm
from ..rigid import rigid_inertia
from ..validation import Array
from . import ilqr
from .arm_model import GRID
from .base import Controller, Setup, Signals
from .dynamics import Dynamics, Grid, SpatialDynamics, dynamics
from .kinematics import rigid_times
from .lqr import SENSOR, StateWeights, riccati
from .optimal import Bounds, within
from .space import AboutRest

LATEST = 2.0
"""Times the arrival first planned at which it is not put off any more: whatever an arm of a quarter of the stiffness,
or four times the mass, does takes twice as long. For ever a few periods ahead, it would leave the vibration before it,
which costs nothing, to grow where damping does not stop it."""

STIFF = 100.0
"""Times the penalties that optimal plans begin with: here nobody learns multipliers."""

MOST = 60
"""First plans that are made at most."""


@dataclass(frozen=True)
class MPCGains(StateWeights):
    """`StateWeights`, and how plans are made.

    Args:
        memory: share of the prediction that is kept in a period, of what is not read.
        allowed: cost of the distance from the goal at which a plan has arrived.
        block: control periods over which planned torques are held. horizon: such blocks that are planned.
        iterations: of a decision. first: of an episode's first plan.
        margin: by which plans stay out of shapes, over the arm's length, and within joint limits, rad.
    """

    memory: float = 1.0
    allowed: float = 10.0
    block: int = 2
    horizon: int = 50
    iterations: int = 1
    first: int = 10
    margin: float = 0.02


class Regulator(NamedTuple):
    """Of the arm about rest: u = -K dx costs 1/2 dx' P dx, and keeps its limits where dx' P dx <= reach."""

    K: Array
    P: Array
    reach: float


@lru_cache(maxsize=512)
def regulator(arm: Arm, period: float, gains: MPCGains, posture: tuple[float, ...]) -> Regulator:
    """The regulator at a posture (elbow angles, rad)."""
    plant = dynamics(arm, period)
    rest = plant.still(np.array([(0.0, *posture)]))
    return regulators(plant, *rest, plant.stage_weight(gains))[0]


def regulators(plant: Dynamics, x: Array, u: Array, stage: Array) -> list[Regulator]:
    """Those about rest at states x (n, S), held by torques u (n, N) over their limits."""
    found = []
    for A, B, held in zip(*plant.jacobians(x, u), u, strict=True):
        K, P = riccati(A, B, stage, np.eye(plant.n_inputs))
        left = (1.0 - np.minimum(np.abs(held), 1.0)) ** 2
        found.append(Regulator(K, P, float(np.min(left / np.einsum("is,is->i", K, np.linalg.solve(P, K.T).T)))))
    return found


class MPC(Controller):
    """Plans over a horizon, in every period.

    Attributes: x (n, S): states as they are taken to be (see `dynamics.Dynamics`). plan: torques (H, n, N) over their
        limits, with gains; the first are held for another `left` periods. arrival (n,): control periods from the start,
        put off until it is `latest` (n,) at most.
    """

    needs_bends = True
    wild, ahead, put_off = np.inf, 1.0, 0.03
    """What a plan misses its goal by that is taken for none; times the rigid arm's time at which an episode's first
    plan is to be there; share of its time by which an arrival is put off while it is made."""

    def __init__(self, setup: Setup, gains: MPCGains) -> None:
        super().__init__(setup)
        self.gains = gains
        arm, dt = setup.arm, setup.control_dt
        own = setup.gravity if arm.spatial else None
        held = [dynamics(arm, k * dt, gravity=own) for k in range(1, gains.block + 1)]
        self.plant, self.grids = held[0], [Grid(first, held[-1]) for first in held]
        self.stage = self.plant.stage_weight(gains)
        ends = [(-np.inf, np.inf) if one is None else one for one in arm.joint_limits or ()]
        joints = [(low + near, high - near) for low, high in ends for near in [min(gains.margin, 0.1 * (high - low))]]
        self.bounds = Bounds(joints=joints, keep_out=setup.keep_out, margin=gains.margin * arm.total_length)
        self.effort = np.full(setup.n_joints, float(gains.block))

    def initialise(self, signals: Signals, to_go: Array) -> None:
        n, gains, setup = len(to_go), self.gains, self.setup
        self.home, self.still = self.plant.still(self.goal)
        owned = self._regulators()
        self.K, self.P = np.stack([r.K for r in owned]), np.stack([r.P for r in owned])
        self.reach = np.array([r.reach for r in owned])
        self.x = self._standing(signals, to_go)
        shape, self.left = (gains.horizon, n, setup.n_joints), gains.block
        states = np.zeros((gains.horizon + 1, *self.x.shape))
        controls = np.broadcast_to(self.still, shape).copy()
        self.plan = ilqr.Solution(controls, states, np.zeros(n), np.zeros((*shape, self.plant.size)))
        self._begin(to_go)
        self.latest = LATEST * self.arrival

    def _begin(self, to_go: Array) -> None:
        """The episodes' first plans: from the rigid arm's time on the arrival is put off, until there is a plan."""
        n, gains = len(to_go), self.gains
        quickest = rigid_times(self._inertia(), to_go, self.limits)
        self.arrival = np.ceil(self.ahead * quickest / self.setup.control_dt)
        late, iterations, missed = np.ones(n, np.bool_), gains.first, np.zeros(n)
        for _ in range(MOST):
            missed[late] = self._improve(late, iterations)
            late = (missed > gains.allowed) & (self.arrival < self._ends[-2])
            if not late.any():
                break
            self.arrival[late] += np.maximum(1.0, np.round(self.put_off * self.arrival[late]))
            iterations = 3

    def torques(self, signals: Signals, to_go: Array) -> Array:
        self.plan.states[0] = self.x
        self.x = self._estimate(signals, to_go)
        off = self.x - self.home
        shares = self.still - (self.K @ off[:, :, None])[:, :, 0]
        far = np.einsum("ni,nij,nj->n", off, self.P, off) > self.reach
        if far.any():
            missed = self._improve(far, self.gains.iterations)
            wild = far.copy()
            wild[far] = missed > self.wild
            self._give_up(wild)
            shares[far] = self.plan.controls[0][far]
            self.arrival[far] += (missed > self.gains.allowed) & (self.arrival[far] < self.latest[far])
        return np.asarray(shares * self.limits)

    def predict(self, torques: Array) -> None:
        self.x = self.plant.advance(self.x, torques / self.limits)
        lost = ~np.isfinite(self.x).all(axis=1)
        self.x[lost] = self.home[lost]
        self.left -= 1
        if not self.left:
            plan, self.left = self.plan, self.gains.block
            for values in (plan.controls, plan.gains, plan.states):
                values[:-1] = values[1:]
            plan.controls[-1], plan.gains[-1] = self.still, 0.0

    @property
    def _ends(self) -> Array:
        """Instants (H + 1,) at the ends of the plan's stages, periods from the episode's start."""
        stages = np.arange(self.gains.horizon)
        return self.step + np.concatenate([[0.0], self.left + self.gains.block * stages])

    def _improve(self, chosen: NDArray[np.bool_], iterations: int) -> Array:
        """Go on with the plans of some arms, from where they are; by how much they miss the goal at their arrival."""
        there = self._ends[:, None] >= self.arrival[chosen]
        weight = (self.gains.block * there)[:, :, None, None] * self.stage
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
        at = np.where(there.any(axis=0), np.argmax(there, axis=0), len(there) - 1)
        off = found.states[at, np.arange(len(at))] - self.home[chosen]
        return np.asarray(np.einsum("ni,nij,nj->n", off, self.P[chosen], off))

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        """States (n, S) with what is read, the links bent by forces at their tips."""
        return self.plant.corrected(self.plant.unbent(self.goal - to_go), signals.outputs(self.goal - to_go))

    def _inertia(self) -> Array:
        """(n, N, N), kg m^2: of the rigid arm at its goal."""
        return rigid_inertia(self.setup.arm, self.goal[:, 1:])

    def _give_up(self, chosen: NDArray[np.bool_]) -> None:
        """What is begun with where there is no plan: no torque."""
        self.plan.controls[:, chosen], self.plan.gains[:, chosen] = 0.0, 0.0

    def _estimate(self, signals: Signals, to_go: Array) -> Array:
        """States (n, S), from what was predicted and what is read."""
        kept = self.gains.memory
        guess = kept * self.x + (1.0 - kept) * self._standing(signals, to_go)
        return self.plant.corrected(guess, signals.outputs(self.goal - to_go))

    def _regulators(self) -> list[Regulator]:
        """Of each arm."""
        own = self.setup.arm, self.setup.control_dt, self.gains
        postures = np.round(self.goal[:, 1:] / GRID) * GRID
        return [regulator(*own, tuple((0.0 + row).tolist())) for row in postures]


SOONER, SPARE = 0.9, 1.2
"""Share of an arrival that a plan has which is tried next; times the soonest found: what is asked for."""

NOISE, UNSEEN = 0.02, 3e-4
"""What the filter allows for in a period: of torques over their limits; of angles and strains, rad, and of their rates
over the first frequency."""

RATES, UNKNOWN = 10.0, 9.0
"""Times `SENSOR`: what rates are trusted to; times the variances of `UNSEEN`: those of a state at the start."""


class SpatialMPC(MPC, AboutRest):
    """`MPC` about the arm's rest at its target, and the torques that hold it there.

    Attributes: spread (n, S, S): covariance of the states' errors.
    """

    wild, ahead, put_off = 1e3, 2.0, 0.1

    def initialise(self, signals: Signals, to_go: Array) -> None:
        plant, n = self.plant, self.setup.n_joints
        many = signals.bends.shape[1]
        self.seen = np.square(np.repeat([SENSOR, RATES * SENSOR * plant.first] * 2, [n, n, many, many]))
        self.unseen = np.diag(np.square(np.repeat([UNSEEN, UNSEEN * plant.first], plant.half)))
        self.spread = np.broadcast_to(UNKNOWN * self.unseen, (len(to_go), *self.unseen.shape))
        super().initialise(signals, to_go)

    def _estimate(self, signals: Signals, to_go: Array) -> Array:
        values, C = self.plant.outputs(self.x)
        S = self.spread @ C.swapaxes(1, 2)
        L = np.linalg.solve(C @ S + np.diag(self.seen), S.swapaxes(1, 2)).swapaxes(1, 2)
        self.spread = self.spread - L @ S.swapaxes(1, 2)
        return np.asarray(self.x + (L @ (signals.outputs(self.goal - to_go) - values)[:, :, None])[:, :, 0])

    def _inertia(self) -> Array:
        return self.plant.inertia(self.goal)

    def _give_up(self, chosen: NDArray[np.bool_]) -> None:
        """What gentle regulators do, who are there at the horizon's end."""
        plan = self.plan
        plan.gains[:, chosen], plan.states[:, chosen] = -self.gentle[chosen], self.home[chosen]
        plan.controls[:, chosen] = self.still[chosen]
        off = self.x[chosen] - self.home[chosen]
        now = self.still[chosen] - (self.gentle[chosen] @ off[:, :, None])[:, :, 0]
        plan.controls[0, chosen], plan.states[0, chosen] = np.clip(now, -1.0, 1.0), self.x[chosen]
        self.arrival[chosen] = self._ends[-2]

    def _standing(self, signals: Signals, to_go: Array) -> Array:
        return self.plant.unbent(self.goal - to_go)

    def predict(self, torques: Array) -> None:
        A, B = self.plant.jacobians(self.x, torques / self.limits)
        moved = A @ self.spread @ A.swapaxes(1, 2) + NOISE**2 * B @ B.swapaxes(1, 2) + self.unseen
        lost = ~np.isfinite(moved).all(axis=(1, 2), keepdims=True)
        self.spread = np.where(lost, UNKNOWN * self.unseen, 0.5 * (moved + moved.swapaxes(1, 2)))
        super().predict(torques)

    def _regulators(self) -> list[Regulator]:
        return regulators(self.plant, self.home, self.still, self.stage)

    def _begin(self, to_go: Array) -> None:
        """As soon as there is a plan, and some more."""
        gains, plan, held, everyone = self.gains, self.plan, self.grids[-1].first, np.ones(len(to_go), np.bool_)
        assert isinstance(held, SpatialDynamics)
        self.gentle = held.homing(self.home, self.still)
        self.arrival = np.zeros(len(to_go))
        self._give_up(everyone)
        super()._begin(to_go)
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
