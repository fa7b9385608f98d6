"""Control of the tip's contact force on a wall: sliding under a normal force (task "press"), or landing ("land").

`HybridForce` and `Impedance` have the same reference: the arm at rest (`StaticChain`) with the tip at the target and
with the commanded force between tip and wall. `lqr_force.LQRForce` has the same reference motion.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..geometry.plane import tip_in_hub_frame, wrapped
from ..parameters import Arm
from ..rigid import largest_force, rigid_inertia
from ..validation import Array
from .arm_model import postures
from .base import Controller, Gains, Setup, Signals
from .lqr import LQRGains, design, times

ENTRIES = ("to_target_x", "to_target_y", "target_velocity_x", "target_velocity_y", "target_force", "tip_force_normal")
"""Entries of the observation that the controllers read in addition to those of joints and links. Task "land" has no
`target_force`."""

TASKS = ("press", "land")


@dataclass(frozen=True, kw_only=True)
class Approach(Gains):
    """Parameters of the reference motion: times, friction coefficient and force.

    Args:
        approach: duration of the motion to the wall, s. press: duration of the force's rise after this motion, s.
        friction: assumed coefficient of friction.
        touch: commanded force in the task "land", divided by the largest tip force that the motors can hold.
    """

    approach: float = 3.0
    press: float = 1.0
    friction: float = 0.3
    touch: float = 0.1


@dataclass(frozen=True, kw_only=True)
class ForceGains(Approach):
    """Gains of the controller `HybridForce`.

    Args:
        angle, rate, bend, bend_rate: weights of the state feedback about the reference; see `lqr.StateWeights`.
        path, force: integral gains, 1/s, on the distance from the path and on the error of the normal force.
        lead: proportional gain on the distance from the path, divided by the integral gain `path`, s.
    """

    angle: float = 2.919
    rate: float = 12.65
    bend: float = 0.1562
    bend_rate: float = 0.3423
    path: float = 0.9
    lead: float = 0.4
    force: float = 0.3


@dataclass(frozen=True, kw_only=True)
class ImpedanceGains(Approach):
    """Gains of the controller `Impedance`; they are dimensionless, so that they apply to arms of any size.

    Args:
        along, across: stiffness of the tip along the wall and along the wall's normal, multiplied by the arm's length
            and divided by the largest tip force that the motors can hold. damping: damping ratio of both directions.
    """

    along: float = 30.0
    across: float = 2.0
    damping: float = 1.0


class View(NamedTuple):
    """Quantities of one control period for force controllers: n arms, vectors in inertial axes.

    Attributes:
        signals: joint angles, deflections and their rates.
        to_target (n, 2): vectors from tip to target, m.
        velocity (n, 2): velocities of the target, m/s.
        target (n, 2): positions of the target, m from the root.
        along, normal (n, 2): unit vectors along the path, and along the wall's normal that points away from the root.
        commanded, force (n,): commanded and measured normal force, N.
        near, share (n,): progress of the approach, and progress of the force's rise, each from 0 to 1.
        touching (n,): 1 if the commanded force has its full value (`share` 1), otherwise 0.
    """

    signals: Signals
    to_target: Array
    velocity: Array
    target: Array
    along: Array
    normal: Array
    commanded: Array
    force: Array
    near: Array
    share: Array
    touching: Array


class WallController(Controller):
    """Base class of the controllers of a contact force, in the plane and in space.

    In the task "press" the tip slides along the wall under the force that the environment commands. In the task "land"
    the target is at rest, and `Approach.touch` defines the force.
    """

    restarts = True
    timing: Approach

    def __init__(self, setup: Setup) -> None:
        """Check that the task and its wall fit the controller.

        Raises:
            ValueError: the environment has another task.
        """
        if setup.task not in TASKS:
            raise check.InvalidValue("task", setup.task, f"must be one of {TASKS} for a controller of the force")
        super().__init__(setup)
        self.slides, self.most = setup.task == "press", largest_force(setup.arm)
        if setup.wall is None:
            raise check.InvalidValue("wall", None, "must be given: the bearing (rad) of the wall")
        # one row per episode, so that episodes may begin at different times (`restart`)
        self._periods = np.zeros(0)

    def entries(self, names: Sequence[str]) -> tuple[NDArray[np.int64], Array]:
        """Return indices, counted from the end of the observation, and scales of the named entries.

        Raises:
            ValueError: the observation lacks an entry.
        """
        for name in names:
            if name not in self.setup.names:
                raise check.InvalidValue("observation", self.setup.names, f"must have the entry {name}")
        at = np.array([self.setup.names.index(name) for name in names], np.int64)
        return at - len(self.setup.names), np.array(self.setup.scales)[at]

    @property
    def friction(self) -> float:
        """Coefficient of the friction along the path; 0 in tasks in which the tip does not slide."""
        return self.timing.friction if self.slides else 0.0

    def forget(self) -> None:
        """Reset the controller's memory (arrays with one row per episode) to its values at the start of an episode."""

    def act(self, observation: NDArray[np.floating], beside: NDArray[np.floating] | None = None) -> NDArray[np.float32]:
        """Compute actions in [-1, 1]: saturated torques divided by their limits. For `beside` see `Controller.act`."""
        if not len(self.goal):
            raise RuntimeError("No episode has begun: call the controller's reset(observation) first")
        signals = self.read(observation)
        if len(signals.angles) != len(self.goal):
            what = f"must be {len(self.goal)}, as reset had"
            raise check.InvalidValue("rows of observation", len(signals.angles), what)
        torques = self.pressed(signals, np.atleast_2d(np.asarray(observation, np.float64)))
        self._periods += 1.0
        actions = torques / self.limits
        if beside is not None:
            actions = actions + np.reshape(beside, actions.shape)
        applied: NDArray[np.float32] = np.clip(actions, -1.0, 1.0).astype(np.float32)
        return applied if np.ndim(observation) == 2 else applied.reshape(-1)

    def torques(self, signals: Signals, to_go: Array) -> Array:
        """Raise an error: the method `act` of this class calls `pressed`, never `torques`."""
        raise NotImplementedError

    @abstractmethod
    def pressed(self, signals: Signals, seen: Array) -> Array:
        """Return joint torques (n, N), N m. seen (n, entries): observation, with the environment's scales."""

    def progress(self) -> tuple[Array, Array, Array]:
        """Return three arrays (n,): progress of the approach, progress of the force's rise, end of the rise.

        Both progresses are between 0 and 1; the progress of the approach is a polynomial of fifth degree in time. The
        third array is 0 until the force has its full value, and 1 afterwards.
        """
        time, timing = self._periods * self.setup.control_dt, self.timing
        x, y = np.clip(time / timing.approach, 0.0, 1.0), np.clip((time - timing.approach) / timing.press, 0.0, 1.0)
        near, share = x**3 * (10.0 - 15.0 * x + 6.0 * x * x), y * y * (3.0 - 2.0 * y)
        return near, share, np.where(y >= 1.0, 1.0, 0.0)


class PressController(WallController):
    """Base class of the controllers of a contact force in the plane."""

    needs_bends = True

    def __init__(self, setup: Setup) -> None:
        """Look up the entries of the observation; see `WallController`."""
        super().__init__(setup)
        self._at, self._scales = self.entries([name for name in ENTRIES if self.slides or name != "target_force"])
        assert setup.wall is not None
        self._normal = np.array([np.cos(setup.wall), np.sin(setup.wall)])
        self.chain = StaticChain(setup.arm)

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Begin episodes with their first observation, (n, entries) or (entries,)."""
        signals = self.read(observation)
        self.goal = signals.angles.copy()
        self._periods, self._way = np.zeros(len(self.goal)), np.zeros(len(self.goal))
        self._tip = rotated(signals, tip_in_hub_frame(self.setup.arm, signals.angles[:, 1:], signals.bends))
        self._bends = np.zeros_like(self.goal)
        self.forget()

    def pressed(self, signals: Signals, seen: Array) -> Array:
        """Return joint torques (n, N), N m; see `WallController.pressed`."""
        return self.pressing(self._view(signals, seen[:, self._at] * self._scales))

    @abstractmethod
    def pressing(self, view: View) -> Array:
        """Return joint torques (n, N), N m, for one control period."""

    def _view(self, signals: Signals, seen: Array) -> View:
        """Return the quantities of a period. seen (n, entries): values of the entries `ENTRIES`, SI units."""
        to_target, velocity = rotated(signals, seen[:, :2]), rotated(signals, seen[:, 2:4])
        target = rotated(signals, tip_in_hub_frame(self.setup.arm, signals.angles[:, 1:], signals.bends)) + to_target
        commanded = seen[:, 4] if self.slides else np.full(len(seen), self.timing.touch * self.most)
        # the path is straight and its speed constant: their mean up to now, whose sense of direction noise cannot flip
        normal = np.tile(self._normal, (len(seen), 1))
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        self._way += (velocity * tangent).sum(axis=1)
        velocity = tangent * (self._way / (self._periods + 1.0))[:, None]
        along = tangent * np.where(self._way < 0.0, -1.0, 1.0)[:, None]
        near, share, touching = self.progress()
        return View(signals, to_target, velocity, target, along, normal, commanded, seen[:, -1], near, share, touching)

    def _rest(self, view: View, shift: Array | float, excess: Array | float) -> tuple[Array, Array]:
        """Return outputs (n, 4 N) minus their values at rest at the reference, and holding torques (n, N), N m.

        shift (n, 2): shift of the target, m. excess (n,): addition to the commanded force, N. The reference is stored
        in `goal` (joint angles) and `_bends`.
        """
        dt, signals = self.setup.control_dt, view.signals
        size = ((view.commanded + excess) * view.share)[:, None]
        pressing = (view.normal + self.friction * view.along) * size
        end = view.target + view.velocity * dt + shift
        reference = self._tip + view.near[:, None] * (end - self._tip)
        before, bent = self.goal, self._bends
        self.goal, self._bends, holding = self.chain.solve(before, -pressing, reference, 3)
        rates = (self.goal - before) / dt
        bend_rates = (self._bends - bent) / dt * np.minimum(self._periods, 1.0)[:, None]
        off = [
            wrapped(signals.angles - self.goal), signals.rates - rates, signals.bends - self._bends,
            signals.bend_rates - bend_rates,
        ]  # fmt: skip
        return np.concatenate(off, axis=1), holding


class HybridForce(PressController):
    """Hybrid force/position control: state feedback and integral action about the equilibrium with the tip on the wall.

    In each period the controller computes joint angles and torques of a static equilibrium (`StaticChain`), in which
    the tip is at the reference position and the reference force acts on the tip. The reference position moves from the
    tip's initial position to the target; then the reference force rises. The position error along the wall and the
    force error normal to the wall are integrated separately (Raibert & Craig 1981); both integrals shift the reference.
    """

    def __init__(self, setup: Setup, gains: ForceGains | None = None) -> None:
        """Store the gains; see `PressController`."""
        self.timing = self.gains = ForceGains() if gains is None else check.instance("gains", gains, ForceGains)
        super().__init__(setup)
        self._weights = LQRGains(self.gains.angle, self.gains.rate, self.gains.bend, self.gains.bend_rate)

    def forget(self) -> None:
        n = len(self.goal)
        self._shift, self._excess, self._error = np.zeros((n, 2)), np.zeros(n), np.full(n, np.nan)

    def pressing(self, view: View) -> Array:
        gains, dt, touching = self.gains, self.setup.control_dt, view.touching
        error = (view.to_target * view.along).sum(axis=1)
        change = np.where(np.isnan(self._error), 0.0, error - self._error)
        self._shift += view.along * (touching * gains.path * (dt * error + gains.lead * change))[:, None]
        self._error = np.where(touching > 0.0, error, self._error)
        self._excess += touching * gains.force * dt * (view.commanded - view.force)
        off, holding = self._rest(view, self._shift, self._excess)
        return holding - feedback(self.setup, self._weights, self.goal, off)


class Impedance(PressController):
    """Impedance control: the motors hold the tip at the reference like a spring and a damper.

    torques = holding torques + J' [K (x_d - x) + D (x_d' - x')], with the Jacobian J of the arm at rest at the
    reference (Hogan 1985, eq. 9, quasi-static). K and D are diagonal in the axes along and normal to the wall. x - x_d
    is J times the deviation of the joint angles. Deviations of the deflections are ignored. The feedback therefore uses
    only sensors at the joints, where the motors act (collocated control), so that the loop dissipates energy for any
    gains. The controller has no integral terms; friction, wall and arm must therefore be known.
    """

    def __init__(self, setup: Setup, gains: ImpedanceGains | None = None) -> None:
        """Store the gains; see `PressController`."""
        self.timing = self.gains = ImpedanceGains() if gains is None else check.instance("gains", gains, ImpedanceGains)
        super().__init__(setup)
        # N/m per unit of a stiffness: the largest tip force divided by the arm's length
        self._unit = self.most / setup.arm.total_length

    def pressing(self, view: View) -> Array:
        gains, n = self.gains, self.setup.n_joints
        off, holding = self._rest(view, 0.0, 0.0)
        jacobian = self.chain.jacobian(self.goal, self._bends)
        inverse = np.linalg.inv(rigid_inertia(self.setup.arm, self.goal))
        found = holding
        for direction, stiffness in ((view.along, gains.along), (view.normal, gains.across)):
            lever = (jacobian * direction[:, :, None]).sum(axis=1)
            K = stiffness * self._unit
            # effective mass 1 / (j M^-1 j'), kg; D = 2 zeta sqrt(K m)
            mass = 1.0 / np.einsum("ni,nij,nj->n", lever, inverse, lever)
            D = 2.0 * gains.damping * np.sqrt(K * mass)
            pull = K * (lever * off[:, :n]).sum(axis=1) + D * (lever * off[:, n : 2 * n]).sum(axis=1)
            found = found - lever * pull[:, None]
        return found


def feedback(setup: Setup, weights: LQRGains, goals: Array, off: Array) -> Array:
    """Return the LQR's feedback K x (n, N), N m, for a deviation x from the goal.

    goals (n, N): joint angles at the goals, rad; the posture of each goal determines the gains K. off (n, 4 N): outputs
    (`Signals.outputs`) minus their values at the goal; x is computed from these differences.
    """
    # a mirrored posture has the same gains
    rows = [posture_gains(setup.arm, setup.torque_limits, setup.control_dt, weights, one) for one in postures(goals)]
    return times(np.stack(rows), off)


@lru_cache(maxsize=1024)
def posture_gains(
    arm: Arm, limits: tuple[float, ...], dt: float, weights: LQRGains, posture: tuple[float, ...]
) -> Array:
    """Return LQR gains (N, 4 N) on outputs in a posture (elbow angles, rad).

    The result is the product of two matrices: the gains of `lqr.design` on states, and the matrix of
    `ArmModel.state_of`, which computes states from outputs.
    """
    own = design(arm, limits, dt, weights, posture)
    return np.asarray(own.K @ own.model.state_of(np.eye(len(own.C))).T)


def rotated(signals: Signals, vectors: Array) -> Array:
    """Rotate vectors (n, 2) from the hub's frame into inertial axes."""
    cosine, sine = np.cos(signals.angles[:, 0]), np.sin(signals.angles[:, 0])
    x, y = vectors.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


class StaticChain:
    """Static model of an arm with flexible links and a force on its tip, for small deflections of each link."""

    def __init__(self, arm: Arm) -> None:
        """Store lengths (m) and bending stiffnesses at mid-length (N m^2; inf for rigid links)."""
        self.lengths = np.array([link.span for link in arm.links])
        stiff = [np.inf if link.rigid else float(link.along(0.5 * link.length).EI) for link in arm.links]
        self.stiffness = np.array(stiff)

    def bend(self, angles: Array, force: Array) -> tuple[Array, Array, Array]:
        """Return tip (n, 2), m, deflections divided by length (n, N), and holding torques (n, N), N m, of arms at rest.

        angles (n, N): joint angles, rad. force (n, 2): force on the tip, N, inertial axes.
        """
        n, links = angles.shape
        bends, slopes, torques = np.zeros((n, links)), np.zeros((n, links)), np.zeros((n, links))
        for _ in range(4):
            # places of the joints and the tip, with the links' deflections of the pass before
            angle, places, tangents = np.zeros(n), [np.zeros((n, 2))], []
            for k, length in enumerate(self.lengths):
                angle = angle + angles[:, k]
                tangents.append(angle)
                cosine, sine = np.cos(angle), np.sin(angle)
                x, y = length * (1.0 - 0.6 * bends[:, k] ** 2), length * bends[:, k]
                places.append(places[-1] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))
                angle = angle + slopes[:, k]
            for k, length in enumerate(self.lengths):
                # transverse force and moment at the link's tip
                across = np.cos(tangents[k]) * force[:, 1] - np.sin(tangents[k]) * force[:, 0]
                moment, EI = _moment(places[-1] - places[k + 1], force), self.stiffness[k]
                bends[:, k] = across * length**2 / (3.0 * EI) + moment * length / (2.0 * EI)
                slopes[:, k] = across * length**2 / (2.0 * EI) + moment * length / EI
                torques[:, k] = -_moment(places[-1] - places[k], force)
        return places[-1], bends, torques

    def jacobian(self, angles: Array, bends: Array) -> Array:
        """Return the derivatives (n, 2, N), m/rad, of the tip by the joint angles at fixed deflections."""
        slopes, found = 1.5 * bends, np.zeros((len(angles), 2, len(self.lengths)))
        angle = np.zeros(len(angles))
        for k, length in enumerate(self.lengths):
            angle = angle + angles[:, k]
            cosine, sine = np.cos(angle), np.sin(angle)
            x, y = length * (1.0 - 0.6 * bends[:, k] ** 2), length * bends[:, k]
            step = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
            # joint k turns this link and all later ones: z x (tip - joint)
            found[:, 0, : k + 1] -= step[:, 1:2]
            found[:, 1, : k + 1] += step[:, 0:1]
            angle = angle + slopes[:, k]
        return found

    def solve(self, angles: Array, force: Array, tip: Array, iterations: int = 6) -> tuple[Array, Array, Array]:
        """Compute the arm at rest with its tip at `tip` (n, 2), m, and `force` (n, 2), N, on the tip.

        Returns joint angles (n, N), rad, deflections divided by length (n, N), and holding torques (n, N), N m. angles:
        initial guess of Newton's iteration. iterations: number of iterations; each moves the tip by at most 0.05 m
        along x and y. With more than two joints there are many solutions; the iteration finds one near the initial
        guess.
        """
        step, angles = 1e-5, angles.copy()
        for _ in range(iterations):
            at = self.bend(angles, force)[0]
            columns = [(self.bend(angles + step * unit, force)[0] - at) / step for unit in np.eye(angles.shape[1])]
            inverse = np.linalg.pinv(np.stack(columns, axis=2))
            angles += times(inverse, np.clip(tip - at, -0.05, 0.05))
        _, bends, torques = self.bend(angles, force)
        return angles, bends, torques


def _moment(lever: Array, force: Array) -> Array:
    """Return the moment (n,), N m, of forces (n, 2) at levers (n, 2)."""
    return np.asarray(lever[:, 0] * force[:, 1] - lever[:, 1] * force[:, 0])
