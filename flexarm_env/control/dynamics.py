"""Discrete dynamics of arms: the state after one control period as a function of state and torques, with derivatives.

Links are elasticas and joints are ideal. The torques are constant over a control period. Accelerations are computed
from the equations of motion at the start of each period, so that angles and rates of the nodes are the complete state.
"""

import dataclasses
import math
import os
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import arms
from .. import validation as check
from ..batch import MODE, PERIODS, RUNNING, Batch
from ..derivatives import Periods
from ..parameters import Arm
from ..physics.elastica.chain import MOST_IN_PIECE, chain
from ..physics.space.reading import links, read, shapes
from ..rigid import rigid_inertia, weight_and_inertia
from ..settings import Settings
from ..validation import Array
from .arm_model import arm_model
from .bare import bare_in_plane, bare_in_space, bare_starts, bare_task
from .lqr import StateWeights, riccati
from .space import held_model

Vector = tuple[float, ...]

POINTS = 4
"""Points per link, the tip included, that must stay out of obstacles."""

AT_ONCE = 1024
"""Largest number of arms per compiled call; their memory then fits into the processor's cache."""


class Dynamics:
    """Discrete dynamics x' = f(x, u) of an arm over one control period.

    x (m, S): coordinates q, then their rates. The coordinates of a link are its joint angle, relative to the previous
    link's tip, and the absolute tangent angles at all other nodes, rad. u (m, N): torques divided by their limits, in
    [-1, 1].

    arm: the arm, or its name or TOML file; rotors, gears, friction and limits of its joints are ignored. period:
    control period, s. nodes: number of nodes per link. step: longest solver step, s; None: the class attribute `step`.
    """

    gravity: Vector | None = None
    bare = staticmethod(bare_in_plane)  # record of the program's task
    usual_nodes, halvings = 4, 0  # default number of nodes per link; number of times that plans may halve the step
    step = 0.02 / 3.0
    """Default of the longest solver step, s, which is that of the planar environments."""

    def __init__(
        self, arm: Arm | str | os.PathLike[str], period: float, nodes: int = 4, step: float | None = None
    ) -> None:
        """Set up a planar arm and its linear maps from node angles to points and deflections."""
        arm = arms.resolve(arm)
        arm.check_planar()
        self.step = self.step if step is None else step
        self._begin(arm, period, nodes, np.arange(arm.n_links) * nodes, np.arange(arm.n_links * nodes))
        parts = chain(self.arm, nodes)
        # absolute tangent angles phi = _angles q: a joint's row adds the tip angle of the link before
        self._angles = np.eye(self.half)
        for k in self.joints[1:]:
            self._angles[k, k - 1] = 1.0
        self._tip = parts.w
        self._shapes = np.zeros((arm.n_links, self.half))
        for k, line in enumerate(parts.lines):
            self._shapes[k, k * nodes : (k + 1) * nodes] = line.tip_weights / arm.links[k].span
        self._bent = np.zeros((arm.n_links, nodes))
        # node angles relative to the root, K^-1 times the tip weights: the shape bent by a force at the tip
        for k in range(arm.n_links):
            own = self._shapes[k, k * nodes + 1 : (k + 1) * nodes]
            self._bent[k, 1:] = np.linalg.solve(parts.K_EI[k][1:, 1:], own)
        ends = [np.linspace(0.0, link.length, POINTS + 1)[1:] for link in arm.links]
        self._arms = np.vstack([parts.arms_to(k, s) for k, s in enumerate(ends)])

    def _begin(self, arm: Arm, period: float, nodes: int, joints: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
        """Set up the plant. joints: indices of joint angles in the state x. rows: the solver's rows in x."""
        if arm.torque_limits is None:
            raise check.MissingKey("arm.torque_limits", f"torques are over theirs: {arm.n_links} limit(s) (N m)")
        self.arm = dataclasses.replace(arm, joints=(), joint_limits=None)
        self.period, self.nodes = check.number("period", period, "s", above=0.0), nodes
        dt = period / max(1, math.ceil(period / self.step - 1e-9))
        self.settings = Settings.make("elastica", nodes=nodes, dt=dt, tolerance=1e-7)
        self.limits = np.array(arm.torque_limits)
        self.n_inputs, self.half, self.size = arm.n_links, len(rows), 2 * len(rows)
        self.joints, self._rows = joints, rows
        """Positions of the joint angles in x; the position of a joint's rate is `half` larger."""
        self._batches: dict[int, Batch] = {}
        self._differentiated: dict[int, tuple[Periods, Array]] = {}

    @classmethod
    def of(cls, arm: Arm, period: float, nodes: int, gravity: Vector | None, step: float | None) -> "Dynamics":
        """Create the dynamics of an arm. gravity: acceleration of gravity, m/s^2, which is ignored in the plane."""
        return cls(arm, period, nodes, step)

    def finer(self, period: float) -> "Dynamics":
        """Return dynamics with another period, s; in the plane with one step a period and up to twice the nodes."""
        return Dynamics(self.arm, period, max(self.nodes, min(MOST_IN_PIECE, 2 * self.nodes)), period)

    def in_steps(self, step: float) -> "Dynamics":
        """Return the `Dynamics` of the same arm with solver steps of at most `step`, s; results are cached."""
        return _one_for_all(self.arm, self.period, self.nodes, self.gravity, step)

    def advance(self, x: Array, u: Array) -> Array:
        """Return the states (m, S) one period later; rows are not finite if the solver fails."""
        out = np.empty((len(x), self.size))
        for first in range(0, len(x), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            self._move(x[part], u[part], out[part])
        return out

    def jacobians(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return exact derivatives of `advance`: A (m, S, S) by x, B (m, S, N) by u; NaN if a step was halved."""
        size, n = self.size, self.n_inputs
        A, B = np.empty((len(x), size, size)), np.empty((len(x), size, n))
        for first in range(0, len(x), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            count = len(x[part])
            periods, state = self._periods(count)
            state[:count, :size], state[count:, :size] = x[part], x[first]
            action = np.zeros((len(state), n))
            action[:count] = u[part]
            moved = periods.jacobians(state, action).moved[:count, :size]
            A[part], B[part] = moved[:, :, :size], moved[:, :, size:]
        return A, B

    def stage(self, k: int, x: Array, u: Array) -> Array:
        """Advance by stage k of a plan (see `ilqr.System`); every stage is one period."""
        return self.advance(x, u)

    def linear(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return `jacobians` A (T, n, S, S) and B (T, n, S, N) of all stages at x (T, n, S) and u (T, n, N)."""
        A, B = self.jacobians(x.reshape(-1, self.size), u.reshape(-1, self.n_inputs))
        return A.reshape(*x.shape, -1), B.reshape(*x.shape, -1)

    def rest(self, angles: ArrayLike) -> Array:
        """Return the states (m, S) at rest at joint angles (m, N), rad; in space the arm is bent by its weight."""
        return self.still(angles)[0]

    def _turned(self, angles: ArrayLike) -> tuple[Array, Array]:
        """Validate joint angles (m, N), rad; return them and zero states (m, S)."""
        angles = check.floats("joint angles", angles)
        if angles.ndim != 2 or angles.shape[1] != self.n_inputs:
            what = f"must be (m, {self.n_inputs}), one row per arm"
            raise check.InvalidValue("shape of joint angles", angles.shape, what)
        return angles, np.zeros((len(angles), self.size))

    def unbent(self, angles: ArrayLike) -> Array:
        """Return the states (m, S) of the undeformed arm at rest at joint angles (m, N), rad."""
        angles, x = self._turned(angles)
        for k in range(self.n_inputs):
            self._turn(x, 0, k, np.repeat(angles[:, k : k + 1], self.nodes, axis=1))
        return x

    def still(self, angles: ArrayLike) -> tuple[Array, Array]:
        """Return states (m, S) at rest at joint angles (m, N), rad, and holding torques (m, N) divided by limits."""
        x = self.unbent(angles)
        return x, np.zeros((len(x), self.n_inputs))

    def begun(self, start: Array, goal: Array, periods: int) -> Array:
        """Return zero torques as initial guess of the controls (T, n, N) from initial to goal states (n, S)."""
        return np.zeros((periods, len(start), self.n_inputs))

    def inertia(self, angles: Array) -> Array:
        """Return the rigid arm's inertia about its joints (m, N, N), kg m^2, at joint angles (m, N), rad."""
        return rigid_inertia(self.arm, angles)

    @property
    def first(self) -> float:
        """Lowest bending frequency, rad/s, of the straight arm with free joints."""
        return float(arm_model(self.arm, (0.0,) * (self.n_inputs - 1)).frequencies[0])

    def points(self, x: Array) -> tuple[Array, Array]:
        """Return positions (..., P, 2), m, of `POINTS` equally spaced points per link, and their derivative by x."""
        return self._ahead(x, self._arms)

    def places(self, x: Array) -> Array:
        """Return the positions of `points` without their derivative."""
        return self.points(x)[0]

    def tip(self, x: Array) -> tuple[Array, Array]:
        """Return the tip position about the root (..., 2), m, and its derivative (..., 2, S)."""
        place, slope = self._ahead(x, self._tip[None])
        return place[..., 0, :], slope[..., 0, :, :]

    def _ahead(self, x: Array, levers: Array) -> tuple[Array, Array]:
        """Return positions (..., P, 2), m, and their derivative by x; levers (P, half) multiply cos and sin of phi."""
        phi = x[..., : self.half] @ self._angles.T
        cosine, sine = np.cos(phi)[..., None, :] * levers, np.sin(phi)[..., None, :] * levers
        slope = np.zeros((*cosine.shape[:-1], 2, self.size))
        slope[..., 0, : self.half], slope[..., 1, : self.half] = -sine @ self._angles, cosine @ self._angles
        return np.stack([cosine.sum(-1), sine.sum(-1)], axis=-1), slope

    def bends(self, x: Array) -> tuple[Array, Array]:
        """Return each link's tip deflection divided by its length, (..., N), and the derivative by x (..., N, S)."""
        # sum over a link's nodes of weight times sin(phi - phi_root)
        phi = x[..., : self.half] @ self._angles.T
        roots = np.repeat(phi[..., self.joints], self.nodes, axis=-1)
        own = np.cos(phi - roots)[..., None, :] * self._shapes
        own[..., np.arange(self.n_inputs), self.joints] -= own.sum(-1)
        slope = np.zeros((*x.shape[:-1], self.n_inputs, self.size))
        slope[..., : self.half] = own @ self._angles
        return np.sin(phi - roots) @ self._shapes.T, slope

    def deflections(self, x: Array) -> Array:
        """Return the deflections of `bends` without their derivative."""
        return self.bends(x)[0]

    def outputs(self, x: Array) -> tuple[Array, Array]:
        """Return outputs (m, O) and their derivative by x (m, O, S).

        Outputs: joint angles, joint rates, deflections (in space also twists) and their rates. The derivatives of
        deflection rates by deflections are omitted.
        """
        half, joints, (bends, slope) = self.half, self.joints, self.bends(x)
        n, many, own = len(joints), bends.shape[1], slope[..., :half]
        C = np.zeros((len(x), 2 * (n + many), self.size))
        C[:, np.arange(n), joints] = C[:, n + np.arange(n), half + joints] = 1.0
        C[:, 2 * n : 2 * n + many, :half] = C[:, 2 * n + many :, half:] = own
        rates = np.einsum("mns,ms->mn", own, x[:, half:])
        return np.concatenate([x[:, joints], x[:, half + joints], bends, rates], axis=1), C

    def stage_weight(self, weights: StateWeights) -> Array:
        """Return the stage cost matrix (S, S) of a deviation from rest."""
        return weights.stage(self.outputs(np.zeros((1, self.size)))[1][0], self.first, self.n_inputs)

    def corrected(self, x: Array, outputs: Array) -> Array:
        """Change states x (m, S) so that they have the measured outputs (m, 4 N), see `outputs`.
        The correction turns the links at their joints, and adds bending in the shape that a static tip force causes.
        """
        half, out = self.half, x.copy()
        angle, rate, bend, bend_rate = np.split(outputs, 4, axis=1)
        for part, wanted, bent in ((0, angle, bend), (half, rate, bend_rate)):
            for k, joint in enumerate(self.joints):
                turned = wanted[:, k] - out[:, part + joint]
                self._turn(out, part, k, np.repeat(turned[:, None], self.nodes, axis=1))
                for _ in range(1 if part else 2):  # a deflection is not linear in the angles
                    value, slope = self.bends(out)
                    if part:
                        value = np.einsum("mns,ms->mn", slope[..., :half], out[:, half:])
                    own = slope[:, k, joint : joint + self.nodes] @ self._bent[k]
                    self._turn(out, part, k, ((bent[:, k] - value[:, k]) / own)[:, None] * self._bent[k])
        return out

    def _turn(self, x: Array, part: int, k: int, by: Array) -> None:
        """Turn link k's nodes by angles (m, nodes), later links by its tip's angle. part: 0 angles, `half` rates."""
        x[:, part + k * self.nodes : part + (k + 1) * self.nodes] += by
        for later in range(k + 1, self.n_inputs):
            at = part + later * self.nodes
            x[:, at + 1 : at + self.nodes] += by[:, -1:]

    def _move(self, x: Array, u: Array, out: Array) -> None:
        """Advance states x (m, S) under torques u (m, N) in one compiled call; write `out` (m, S), NaN if failed."""
        batch = self._batch(len(x))
        lanes, m, block = len(batch.lane), len(x), batch.block
        groups, rows = -(-m // lanes), len(batch.system.q0)
        own, many = np.concatenate([self._rows, rows + self._rows]), 2 * rows
        state = np.zeros((groups * lanes, many))
        state[:m, own] = x
        # states into lane order: (groups, rows, lanes)
        block[:groups, : many * lanes] = state.reshape(groups, lanes, many).transpose(0, 2, 1).reshape(groups, -1)
        record = batch.layout.record
        block[:groups, record + MODE * lanes : record + (MODE + 1) * lanes] = RUNNING
        # each call starts from other states: as in a first period, the balance of energy begins with theirs
        block[:groups, record + PERIODS * lanes : record + (PERIODS + 1) * lanes] = 0.0
        batch.action[:m] = u
        batch.action[m:] = 0.0
        batch.compiled_step(batch.address, 0, groups)
        moved = block[:groups, : many * lanes].reshape(groups, many, lanes)
        out[...] = moved.transpose(0, 2, 1).reshape(-1, many)[:m, own]
        out[batch.table[batch.info_at.reason, :m] != 0.0] = np.nan

    def _periods(self, m: int) -> tuple[Periods, Array]:
        """Return differentiable control periods for at least m arms, and the array that receives their states."""
        batch = self._batch(m)
        if batch.n not in self._differentiated:
            periods = Periods(batch, alone="none")  # plans that go on through halved steps do not come to rest
            assert periods.moving == self.size
            self._differentiated[batch.n] = periods, periods.states()
        return self._differentiated[batch.n]

    def _batch(self, m: int) -> Batch:
        """Return a cached batch of at least m arms; its size is a power of two, at least 8."""
        size = 8
        while size < m:
            size *= 2
        if size not in self._batches:
            own = self.bare(self.arm)
            task, starts = bare_task(self.arm, own), bare_starts(self.arm, own)
            made = Batch(self.arm, self.settings, size, task, starts, period=self.period, gravity=self.gravity)
            made.start(range(size), [0] * size, limit=10**9)
            self._batches[size] = made
        return self._batches[size]


STEP = 1e-5
"""Step of central differences, for angles (rad) and strains."""

GENTLE = StateWeights(1.0, 0.5, 1.0, 0.5)
"""Weights of the soft regulators that move an arm to its goal from far away."""

NEWTON = 8
"""Number of Newton steps to the arm's static rest."""


class SpatialDynamics(Dynamics):
    """`Dynamics` of an arm in space on a fixed base, under gravity (x, y, z), m/s^2.

    The coordinates of a link are its joint angle and the polynomial coefficients of its strains: `nodes` - 1
    coefficients each for torsion, for bending about y and for bending about z. The array of deflections consists of the
    flexible links' tip deflections along y and then along z, divided by the links' lengths, followed by the links'
    twists, rad.
    """

    usual_nodes, halvings, bare = 3, 3, staticmethod(bare_in_space)
    step = 0.005

    def __init__(self, arm: Arm, period: float, nodes: int, gravity: Vector, step: float | None = None) -> None:
        """Assemble the elastica of an arm in space, with `nodes` nodes per link. Times: s; gravity (3,): m/s^2."""
        self.step = self.step if step is None else step
        strains = 3 * (nodes - 1)
        counts = [1 if link.rigid else 1 + strains for link in arm.links]
        rows = 6 + np.arange(sum(counts))  # behind those of the base
        self.gravity = gravity
        self._begin(arm, period, nodes, np.cumsum([0, *counts[:-1]]), rows)
        self._bending = [k for k, link in enumerate(arm.links) if not link.rigid]
        self._strains = np.setdiff1d(np.arange(self.half), self.joints)

    @classmethod
    def of(cls, arm: Arm, period: float, nodes: int, gravity: Vector | None, step: float | None) -> Dynamics:
        return cls(arm, period, nodes, gravity or (0.0, 0.0, 0.0), step)

    def finer(self, period: float) -> Dynamics:
        return SpatialDynamics(self.arm, period, self.nodes, self.gravity or (0.0, 0.0, 0.0))

    def still(self, angles: ArrayLike) -> tuple[Array, Array]:
        """Return states at rest and torques as `Dynamics.still` does, by Newton's method on one control period."""
        x, n = self.unbent(angles), self.n_inputs
        u, half = np.zeros((len(x), n)), self.half
        u[:] = weight_and_inertia(self.arm, np.array(self.gravity), x[:, self.joints])[0] / self.limits
        weight = np.repeat([1.0 / self.period, 1.0], half)
        for _ in range(NEWTON):
            A, B = self.jacobians(x, u)
            # unknowns: strains and torques, with the joint angles given
            off = (self.advance(x, u) - x) * weight
            slope = np.concatenate([(A - np.eye(self.size))[:, :, self._strains], B], axis=2) * weight[:, None]
            step = -np.linalg.pinv(slope) @ off[:, :, None]
            x[:, self._strains] += step[:, :-n, 0]
            u += step[:, -n:, 0]
        return x, u

    def unbent(self, angles: ArrayLike) -> Array:
        """Return the states (m, S) of the undeformed arm at rest at joint angles (m, N), rad."""
        angles, x = self._turned(angles)
        x[:, self.joints] = angles
        return x

    def homing(self, x: Array, u: Array) -> Array:
        """Return gains K (m, N, S) of low-gain regulators u - K dx about rest at x (m, S) with holding torques u."""
        stage, R = self.stage_weight(GENTLE), np.eye(self.n_inputs)
        return np.stack([riccati(A, B, stage, R)[0] for A, B in zip(*self.jacobians(x, u), strict=True)])

    def begun(self, start: Array, goal: Array, periods: int) -> Array:
        """Return torques (T, n, N) of regulators (`homing`) as initial guess; the arm falls under constant torques."""
        home, held = self.still(goal[:, self.joints])
        K, x, controls = self.homing(home, held), start, np.zeros((periods, *held.shape))
        for k in range(periods):
            controls[k] = np.clip(held - (K @ (x - home)[:, :, None])[:, :, 0], -1.0, 1.0)
            x = self.advance(x, controls[k])
        return controls

    @cached_property
    def first(self) -> float:
        """Lowest bending frequency, rad/s, of the arm at joint angles 0 with free joints."""
        n = self.n_inputs
        A = held_model(self.arm, np.array(self.gravity), np.zeros(n))[2]
        return float(np.sqrt(np.sort(-np.linalg.eigvals(A[len(A) // 2 :, : len(A) // 2]).real)[n]))

    def tip(self, x: Array) -> tuple[Array, Array]:
        """Return the tip position about the root (..., 3), m, and its derivative (..., 3, S)."""
        place, slope = self.points(x)
        return place[..., -1, :], slope[..., -1, :, :]

    def points(self, x: Array) -> tuple[Array, Array]:
        """Return positions (..., P, 3), m from the root, of all sections and tips, and their derivative by x."""
        return self._seen(x, "shapes")

    def places(self, x: Array) -> Array:
        """Return the positions of `points` without their derivative."""
        found = self._read(x[..., : self.half].reshape(-1, self.half), "shapes")
        return found.reshape(*x.shape[:-1], *found.shape[1:])

    def bends(self, x: Array) -> tuple[Array, Array]:
        """Return deflections divided by length and twists, rad, (..., 3 F) and their derivative (..., 3 F, S)."""
        return self._seen(x, "bends")

    def deflections(self, x: Array) -> Array:
        """Return the deflections and twists of `bends` without their derivative."""
        found = self._read(x[..., : self.half].reshape(-1, self.half), "bends")
        return found.reshape(*x.shape[:-1], *found.shape[1:])

    def _seen(self, x: Array, what: str) -> tuple[Array, Array]:
        """Return what `_read` computes, (..., *), and its derivative by x (..., *, S), by central differences."""
        q = x[..., : self.half].reshape(-1, self.half)
        ways = STEP * np.concatenate([np.zeros((1, self.half)), np.eye(self.half), -np.eye(self.half)])
        found = self._read((q + ways[:, None]).reshape(-1, self.half), what)
        found = found.reshape(len(ways), *x.shape[:-1], *found.shape[1:])
        slope = np.zeros((*found.shape[1:], self.size))
        ends = found[1 : 1 + self.half] - found[1 + self.half :]
        slope[..., : self.half] = np.moveaxis(ends, 0, -1) / (2.0 * STEP)
        return found[0], slope

    def _read(self, q: Array, what: str) -> Array:
        """Return points (m, P, 3), m ("shapes"), or deflections / length and twists (m, 3 F) ("bends"), at q."""
        rows = np.zeros((len(q), 6 + self.half))
        rows[:, 6:] = q
        if what == "shapes":
            return shapes(list(links(self.arm, self.settings, rows, np.zeros_like(rows))))[:, 1:]
        found = read(self.arm, self.settings, rows, np.zeros_like(rows))
        bent, twist = found["tip_deflection"][:, self._bending], found["twist"][:, self._bending]
        return np.concatenate([bent[..., 0], bent[..., 1], twist], axis=1)


def dynamics(
    arm: Arm | str | os.PathLike[str], period: float, nodes: int | None = None, gravity: Vector | None = None,
    step: float | None = None,
) -> Dynamics:  # fmt: skip
    """Return the `Dynamics` of an arm; results are cached.

    nodes: number of nodes per link; None: 4, in space 3. gravity: acceleration of gravity, m/s^2, ignored in the plane.
    step: longest solver step, s; None: 0.02/3 s, in space 0.005 s, which the functions of `optimal` halve if necessary.
    """
    arm = arms.resolve(arm)
    period = check.number("period", period, "s", above=0.0)
    kind = SpatialDynamics if arm.spatial else Dynamics
    nodes = kind.usual_nodes if nodes is None else check.integer("nodes", nodes, minimum=3, maximum=12)
    step = None if step is None else check.number("step", step, "s", above=0.0)
    return _one_for_all(kind, arm, period, nodes, gravity, step)


@lru_cache(maxsize=16)
def _one_for_all(kind: type[Dynamics], *arguments: Any) -> Dynamics:
    """Create the `Dynamics` or `SpatialDynamics` of an arm, once per set of arguments."""
    return kind.of(*arguments)
