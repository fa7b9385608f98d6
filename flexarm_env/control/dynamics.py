"""Control periods of an arm as a function of its state and torques, many at once, with derivatives.

The arm is the elastica with ideal joints, as the environments compute it: torques are held over a period, accelerations
are solved afresh where they change, so that angles and rates of the nodes are the whole state.
"""

import dataclasses
import math
import os
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import arms
from .. import validation as check
from ..batch import MODE, RUNNING, Batch, Chain, Reach, Slew, SpaceReach, Starts, Task
from ..derivatives import Periods
from ..parameters import Arm
from ..physics.elastica.chain import chain
from ..physics.space.reading import links, read, shapes
from ..rigid import rigid_inertia
from ..settings import Settings
from ..validation import Array
from .arm_model import arm_model
from .lqr import StateWeights, riccati
from .space import held_model, holding

Vector = tuple[float, ...]

POINTS = 4
"""Of a link that are kept out of shapes, its tip among them."""

AT_ONCE = 1024
"""Most arms that one compiled call moves: their memory stays in the processor's cache."""


class Dynamics:
    """One control period of an arm: (x, u) -> x'.

    x (m, S): coordinates q, then their rates; q of a link are its tangent angles at its nodes, the first relative to
    the tip before it: the joint's. u (m, N): torques over their limits, within -1 and 1.

    Args:
        arm: the arm, or its name or TOML file; its joints are taken to be ideal, and their limits left out. period: s.
        nodes: of a link.
    """

    gravity: Vector | None = None
    step = 0.02 / 3.0
    """Longest of the solver, s: the environments' in the plane."""

    def __init__(self, arm: Arm | str | os.PathLike[str], period: float, nodes: int = 4) -> None:
        arm = arms.resolve(arm)
        arm.check_planar()
        self._begin(arm, period, nodes, np.arange(arm.n_links) * nodes, np.arange(arm.n_links * nodes))
        parts = chain(self.arm, nodes)
        self._angles = np.eye(self.half)
        for k in self.joints[1:]:
            self._angles[k, k - 1] = 1.0
        self._tip = parts.w
        self._shapes = np.zeros((arm.n_links, self.half))
        for k, line in enumerate(parts.lines):
            self._shapes[k, k * nodes : (k + 1) * nodes] = line.tip_weights / arm.links[k].span
        self._bent = np.zeros((arm.n_links, nodes))
        """The nodes' angles about the root's for a force at the tip."""
        for k in range(arm.n_links):
            own = self._shapes[k, k * nodes + 1 : (k + 1) * nodes]
            self._bent[k, 1:] = np.linalg.solve(parts.K[k][1:, 1:], own)
        ends = [np.linspace(0.0, link.length, POINTS + 1)[1:] for link in arm.links]
        self._arms = np.vstack([parts.arms_to(k, s) for k, s in enumerate(ends)])

    def _begin(self, arm: Arm, period: float, nodes: int, joints: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
        """What all arms have: where joints stand in x, and the rows of a state that x holds."""
        if arm.torque_limits is None:
            raise check.MissingKey("arm.torque_limits", f"torques are over theirs: {arm.n_links} limit(s) (N m)")
        self.arm = dataclasses.replace(arm, joints=(), joint_limits=None)
        self.period, self.nodes = check.number("period", period, "s", above=0.0), nodes
        dt = period / max(1, math.ceil(period / self.step - 1e-9))
        self.settings = Settings.make("elastica", nodes=nodes, dt=dt, tolerance=1e-7)
        self.limits = np.array(arm.torque_limits)
        self.n_inputs, self.half, self.size = arm.n_links, len(rows), 2 * len(rows)
        self.joints, self._rows = joints, rows
        """Where the joints' angles stand in x; their rates `half` further on."""
        self._batches: dict[int, Batch] = {}
        self._differentiated: dict[int, tuple[Periods, Array]] = {}

    def advance(self, x: Array, u: Array) -> Array:
        """States (m, S) after a period; not finite where the solver fails."""
        out = np.empty((len(x), self.size))
        for first in range(0, len(x), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            self._move(x[part], u[part], out[part])
        return out

    def jacobians(self, x: Array, u: Array) -> tuple[Array, Array]:
        """A (m, S, S) and B (m, S, N): derivatives of `advance` by x and u, exact; NaN where a step was halved."""
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
        """`advance`, as `ilqr.System` has it: all stages are alike."""
        return self.advance(x, u)

    def linear(self, x: Array, u: Array) -> tuple[Array, Array]:
        """`jacobians` of all stages: x (T, n, S), u (T, n, N)."""
        A, B = self.jacobians(x.reshape(-1, self.size), u.reshape(-1, self.n_inputs))
        return A.reshape(*x.shape, -1), B.reshape(*x.shape, -1)

    def rest(self, angles: ArrayLike) -> Array:
        """States (m, S) of the arm at rest at joint angles (m, N); in space bent by its weight."""
        return self.still(angles)[0]

    def _turned(self, angles: ArrayLike) -> tuple[Array, Array]:
        """Joint angles (m, N), checked, and states (m, S) of zeros."""
        angles = check.floats("joint angles", angles)
        if angles.ndim != 2 or angles.shape[1] != self.n_inputs:
            what = f"must be (m, {self.n_inputs}), a row an arm"
            raise check.InvalidValue("shape of joint angles", angles.shape, what)
        return angles, np.zeros((len(angles), self.size))

    def unbent(self, angles: ArrayLike) -> Array:
        """States (m, S) of the straight arm without motion, at joint angles (m, N)."""
        angles, x = self._turned(angles)
        for k in range(self.n_inputs):
            self._turn(x, 0, k, np.repeat(angles[:, k : k + 1], self.nodes, axis=1))
        return x

    def still(self, angles: ArrayLike) -> tuple[Array, Array]:
        """States of the arm at rest at joint angles (m, N), and torques (m, N) over their limits that hold it."""
        x = self.unbent(angles)
        return x, np.zeros((len(x), self.n_inputs))

    def begun(self, start: Array, goal: Array, periods: int) -> Array:
        """Controls (T, n, N) that plans from states to others (n, S) begin with."""
        return np.zeros((periods, len(start), self.n_inputs))

    def inertia(self, angles: Array) -> Array:
        """(m, N, N), kg m^2: of the rigid arm about its joints at angles (m, N)."""
        return rigid_inertia(self.arm, angles[:, 1:])

    @property
    def first(self) -> float:
        """Lowest frequency of bending of the straight arm, its joints free, rad/s."""
        return float(arm_model(self.arm, (0.0,) * (self.n_inputs - 1)).frequencies[0])

    def points(self, x: Array) -> tuple[Array, Array]:
        """`POINTS` of each link, as far apart as its root from the first, (..., P, 2), m; their derivative by x."""
        return self._ahead(x, self._arms)

    def places(self, x: Array) -> Array:
        """`points` without the derivative."""
        return self.points(x)[0]

    def tip(self, x: Array) -> tuple[Array, Array]:
        """Tip (..., 2), m, about the root, and its derivative (..., 2, S)."""
        place, slope = self._ahead(x, self._tip[None])
        return place[..., 0, :], slope[..., 0, :, :]

    def _ahead(self, x: Array, levers: Array) -> tuple[Array, Array]:
        """Points (..., P, 2) so far along the nodes' tangents, levers (P, half), and their derivative by x."""
        phi = x[..., : self.half] @ self._angles.T
        cosine, sine = np.cos(phi)[..., None, :] * levers, np.sin(phi)[..., None, :] * levers
        slope = np.zeros((*cosine.shape[:-1], 2, self.size))
        slope[..., 0, : self.half], slope[..., 1, : self.half] = -sine @ self._angles, cosine @ self._angles
        return np.stack([cosine.sum(-1), sine.sum(-1)], axis=-1), slope

    def bends(self, x: Array) -> tuple[Array, Array]:
        """Tip deflections over length (..., N) and their derivative (..., N, S)."""
        phi = x[..., : self.half] @ self._angles.T
        roots = np.repeat(phi[..., self.joints], self.nodes, axis=-1)
        own = np.cos(phi - roots)[..., None, :] * self._shapes
        own[..., np.arange(self.n_inputs), self.joints] -= own.sum(-1)
        slope = np.zeros((*x.shape[:-1], self.n_inputs, self.size))
        slope[..., : self.half] = own @ self._angles
        return np.sin(phi - roots) @ self._shapes.T, slope

    def outputs(self, x: Array) -> tuple[Array, Array]:
        """Joint angles, their rates, deflections (in space twists too) and their rates, (m, O), and their derivative
        by x (m, O, S), but for what rates of deflections change by with deflections."""
        half, joints, (bends, slope) = self.half, self.joints, self.bends(x)
        n, many, own = len(joints), bends.shape[1], slope[..., :half]
        C = np.zeros((len(x), 2 * (n + many), self.size))
        C[:, np.arange(n), joints] = C[:, n + np.arange(n), half + joints] = 1.0
        C[:, 2 * n : 2 * n + many, :half] = C[:, 2 * n + many :, half:] = own
        rates = np.einsum("mns,ms->mn", own, x[:, half:])
        return np.concatenate([x[:, joints], x[:, half + joints], bends, rates], axis=1), C

    def stage_weight(self, weights: StateWeights) -> Array:
        """(S, S): cost of a state's distance from rest."""
        return weights.stage(self.outputs(np.zeros((1, self.size)))[1][0], self.first, self.n_inputs)

    def corrected(self, x: Array, outputs: Array) -> Array:
        """The states (m, S) that have these outputs (m, 4 N): joint angles, their rates, tip deflections over length,
        their rates. Made from x: links are turned at their joints, and bent as forces at their tips would bend them."""
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
        """Turn link k's nodes by angles (m, nodes), and the links beyond it with its tip."""
        x[:, part + k * self.nodes : part + (k + 1) * self.nodes] += by
        for later in range(k + 1, self.n_inputs):
            at = part + later * self.nodes
            x[:, at + 1 : at + self.nodes] += by[:, -1:]

    def _move(self, x: Array, u: Array, out: Array) -> None:
        batch = self._batch(len(x))
        lanes, m, block = len(batch.lane), len(x), batch.block
        groups, rows = -(-m // lanes), len(batch.system.q0)
        own, many = np.concatenate([self._rows, rows + self._rows]), 2 * rows
        state = np.zeros((groups * lanes, many))
        state[:m, own] = x
        block[:groups, : many * lanes] = state.reshape(groups, lanes, many).transpose(0, 2, 1).reshape(groups, -1)
        mode = batch.layout.record + MODE * lanes
        block[:groups, mode : mode + lanes] = RUNNING
        batch.action[:m] = u
        batch.action[m:] = 0.0
        batch.compiled_step(batch.address, 0, groups)
        moved = block[:groups, : many * lanes].reshape(groups, many, lanes)
        out[...] = moved.transpose(0, 2, 1).reshape(-1, many)[:m, own]
        out[batch.table[batch.info_at.reason, :m] != 0.0] = np.nan

    def _periods(self, m: int) -> tuple[Periods, Array]:
        """Of at least m arms, and states of theirs, of which the first numbers are to be filled in."""
        batch = self._batch(m)
        if batch.n not in self._differentiated:
            periods = Periods(batch, alone="none")  # plans that go on through halved steps do not come to rest
            assert periods.moving == self.size
            self._differentiated[batch.n] = periods, periods.states()
        return self._differentiated[batch.n]

    def _batch(self, m: int) -> Batch:
        size = 8
        while size < m:
            size *= 2
        if size not in self._batches:
            arm, reach, none = self.arm, self.arm.total_length, [(0.0, 0.0)] * self.n_inputs
            standing = Starts(start=none, target=none if arm.spatial else [(reach, reach), (0.0, 0.0)])
            made = Batch(arm, self.settings, size, _task(arm), standing, period=self.period, gravity=self.gravity)
            made.start(range(size), [0] * size, limit=10**9)
            self._batches[size] = made
        return self._batches[size]


STEP = 1e-5
"""Of differences: rad, and of strains."""

GENTLE = StateWeights(1.0, 0.5, 1.0, 0.5)
"""Of regulators that bring the arm home from afar."""

NEWTON = 8
"""Steps to where the arm rests."""


class SpatialDynamics(Dynamics):
    """`Dynamics` of an arm on a base that is held, under gravity.

    q of a link are its joint's angle, then its strains: `nodes` - 1 polynomials of torsion, bending about y and z.
    Deflections are those of its flexible links along y, then z, over their lengths, then their twists, rad.
    """

    step = 0.005

    def __init__(self, arm: Arm, period: float, nodes: int, gravity: Vector) -> None:
        strains = 3 * (nodes - 1)
        counts = [1 if link.rigid else 1 + strains for link in arm.links]
        rows = 6 + np.arange(sum(counts))  # behind those of the base
        self.gravity = gravity
        self._begin(arm, period, nodes, np.cumsum([0, *counts[:-1]]), rows)
        self._bending = [k for k, link in enumerate(arm.links) if not link.rigid]
        self._strains = np.setdiff1d(np.arange(self.half), self.joints)

    def still(self, angles: ArrayLike) -> tuple[Array, Array]:
        """See `Dynamics.still`: what a period does not move, by Newton's method."""
        x, n = self.unbent(angles), self.n_inputs
        u, half = np.zeros((len(x), n)), self.half
        u[:] = holding(self.arm, np.array(self.gravity), x[:, self.joints])[0] / self.limits
        weight = np.repeat([1.0 / self.period, 1.0], half)
        for _ in range(NEWTON):
            A, B = self.jacobians(x, u)
            off = (self.advance(x, u) - x) * weight
            slope = np.concatenate([(A - np.eye(self.size))[:, :, self._strains], B], axis=2) * weight[:, None]
            step = -np.linalg.pinv(slope) @ off[:, :, None]
            x[:, self._strains] += step[:, :-n, 0]
            u += step[:, -n:, 0]
        return x, u

    def unbent(self, angles: ArrayLike) -> Array:
        """See `Dynamics.unbent`."""
        angles, x = self._turned(angles)
        x[:, self.joints] = angles
        return x

    def homing(self, x: Array, u: Array) -> Array:
        """Gains (m, N, S) of gentle regulators, u - K dx, about rest at states (m, S) that torques u (m, N) hold."""
        stage, R = self.stage_weight(GENTLE), np.eye(self.n_inputs)
        return np.stack([riccati(A, B, stage, R)[0] for A, B in zip(*self.jacobians(x, u), strict=True)])

    def begun(self, start: Array, goal: Array, periods: int) -> Array:
        """What gentle regulators do: torques that are held would let an arm fall."""
        home, held = self.still(goal[:, self.joints])
        K, x, controls = self.homing(home, held), start, np.zeros((periods, *held.shape))
        for k in range(periods):
            controls[k] = np.clip(held - (K @ (x - home)[:, :, None])[:, :, 0], -1.0, 1.0)
            x = self.advance(x, controls[k])
        return controls

    def inertia(self, angles: Array) -> Array:
        """(m, N, N), kg m^2: of the rigid arm about its joints at angles (m, N)."""
        return holding(self.arm, np.array(self.gravity), angles)[1]

    @cached_property
    def first(self) -> float:
        """Lowest frequency of bending of the arm at joint angles 0, its joints free, rad/s."""
        n = self.n_inputs
        A = held_model(self.arm, np.array(self.gravity), np.zeros(n))[2]
        return float(np.sqrt(np.sort(-np.linalg.eigvals(A[len(A) // 2 :, : len(A) // 2]).real)[n]))

    def tip(self, x: Array) -> tuple[Array, Array]:
        """Tip (..., 3), m, about the root, and its derivative (..., 3, S)."""
        place, slope = self.points(x)
        return place[..., -1, :], slope[..., -1, :, :]

    def points(self, x: Array) -> tuple[Array, Array]:
        """Sections of all links and their tips, (..., P, 3), m about the root, and their derivative by x."""
        return self._seen(x, "shapes")

    def places(self, x: Array) -> Array:
        """`points` without the derivative."""
        found = self._read(x[..., : self.half].reshape(-1, self.half), "shapes")
        return found.reshape(*x.shape[:-1], *found.shape[1:])

    def bends(self, x: Array) -> tuple[Array, Array]:
        """Deflections over length and twists (..., 3 F), and their derivative (..., 3 F, S)."""
        return self._seen(x, "bends")

    def _seen(self, x: Array, what: str) -> tuple[Array, Array]:
        """Values (..., *) and derivative (..., *, S), by differences."""
        q = x[..., : self.half].reshape(-1, self.half)
        ways = STEP * np.concatenate([np.zeros((1, self.half)), np.eye(self.half), -np.eye(self.half)])
        found = self._read((q + ways[:, None]).reshape(-1, self.half), what)
        found = found.reshape(len(ways), *x.shape[:-1], *found.shape[1:])
        slope = np.zeros((*found.shape[1:], self.size))
        ends = found[1 : 1 + self.half] - found[1 + self.half :]
        slope[..., : self.half] = np.moveaxis(ends, 0, -1) / (2.0 * STEP)
        return found[0], slope

    def _read(self, q: Array, what: str) -> Array:
        """(m, P, 3): points; (m, 3 F): deflections and twists."""
        rows = np.zeros((len(q), 6 + self.half))
        rows[:, 6:] = q
        if what == "shapes":
            return shapes(list(links(self.arm, self.settings, rows, np.zeros_like(rows))))[:, 1:]
        found = read(self.arm, self.settings, rows, np.zeros_like(rows))
        bent, twist = found["tip_deflection"][:, self._bending], found["twist"][:, self._bending]
        return np.concatenate([bent[..., 0], bent[..., 1], twist], axis=1)


class Grid:
    """Stages of one length after a first one that may be shorter.

    first, later: of the same arm and nodes.
    """

    def __init__(self, first: Dynamics, later: Dynamics) -> None:
        self.first, self.later = first, later
        self.size, self.n_inputs = later.size, later.n_inputs

    def stage(self, k: int, x: Array, u: Array) -> Array:
        """See `ilqr.System`."""
        return (self.later if k else self.first).advance(x, u)

    def linear(self, x: Array, u: Array) -> tuple[Array, Array]:
        """See `ilqr.System`."""
        A, B = self.later.linear(x, u)
        if self.first is not self.later:
            A[:1], B[:1] = self.first.linear(x[:1], u[:1])
        return A, B


def dynamics(
    arm: Arm | str | os.PathLike[str], period: float, nodes: int | None = None, gravity: Vector | None = None
) -> Dynamics:
    """`Dynamics`, one for all that ask for the same.

    nodes: None: 4; in space 3. gravity: (x, y, z), m/s^2, of an arm in space; in the plane there is none.
    """
    arm = arms.resolve(arm)
    period = check.number("period", period, "s", above=0.0)
    usual = 3 if arm.spatial else 4
    nodes = usual if nodes is None else check.integer("nodes", nodes, minimum=3, maximum=12)
    return _one_for_all(arm, period, nodes, gravity if arm.spatial else None)


@lru_cache(maxsize=16)
def _one_for_all(arm: Arm, period: float, nodes: int, gravity: Vector | None) -> Dynamics:
    if arm.spatial:
        return SpatialDynamics(arm, period, nodes, gravity or (0.0, 0.0, 0.0))
    return Dynamics(arm, period, nodes)


def _task(arm: Arm) -> Task:
    """A task that asks for nothing; of the environments' kind, so that their compiled functions serve."""
    n, space = arm.n_links, arm.spatial
    kind = SpaceReach if space else Slew if n == 1 else Reach if n == 2 else Chain
    entries = 3 * n + 6 * sum(not link.rigid for link in arm.links) + 6 if space else 6 if n == 1 else 5 * n + 4
    assert arm.torque_limits is not None
    return kind(
        links=(0,) * n, targets=(0,) * (3 if space else 1 if n == 1 else 2), terms=(0,) * 6, entries=(0,) * entries,
        length=arm.total_length, lengths=np.array([0.0 if link.rigid else link.span for link in arm.links]),
        scales=np.ones(entries),
        rates=np.ones(n), weights=np.zeros(6), torque_limits=np.array(arm.torque_limits),
        joint_limits=np.array([(-np.inf, np.inf)] * n).ravel(), hold=1.0, bands=np.full(3, np.inf),
    )  # fmt: skip
