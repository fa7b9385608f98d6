"""Control of a tip in space that slides along a wall under a commanded normal force (task "press").

The controllers use a force sensor and the vector from tip to target if the observation contains them; if not, the
controllers use encoders and strain gauges. For an arm at rest, the gauge readings determine the force on the tip, and
this force determines the arm's shape.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..geometry.plane import wrapped
from ..rigid import frames, link_bodies, weight_and_inertia
from ..validation import Array
from .base import Setup, Signals
from .force import Approach, WallController
from .pd import SpatialPDGains
from .space_statics import Rest, SpatialChain

AXES = "xyz"
DAMPED = 1e-4
"""Damping of the least squares for joint angles and forces, divided by the trace."""


@dataclass(frozen=True, kw_only=True)
class SpatialForceGains(Approach):
    """Gains of the controller `SpatialHybridForce`.

    Args:
        rate, ratio, lag: natural frequency of the joints, rad/s, their damping ratio, and time constant of the rate
            filter, s; see `pd.SpatialPDGains`.
        path, force: integral gains, 1/s, on the distance from the path and on the error of the normal force.
        filter: time constant, s, of the low-pass filter on the estimated force.
    """

    approach: float = 1.6
    press: float = 0.6
    rate: float = 7.0
    ratio: float = 1.0
    lag: float = 0.06
    path: float = 1.5
    force: float = 0.5
    filter: float = 0.05


class SpatialHybridForce(WallController):
    """Hybrid force/position control in space: PD control about the rest posture on the wall, with integral terms.

    In each period the controller computes joint angles and torques of the arm at rest (`SpatialChain`). In the rest
    posture the tip is at the reference position, and gravity and the reference force act on the arm. The reference
    position moves from the tip's initial position to the target; then the reference force rises. The integrated
    position error along the wall shifts the reference position; the integrated force error changes the reference force
    (Raibert & Craig 1981).
    """

    aims = follows_goal = omits_modes = False

    def __init__(self, setup: Setup, gains: SpatialForceGains | None = None) -> None:
        """Look up the positions of the observation's entries that the controller reads.

        Raises:
            ValueError: the observation has neither the force nor strain gauges, or neither the target's position nor
                the way to the target.
        """
        self.timing = self.gains = gains = SpatialForceGains() if gains is None else check.instance(
            "gains", gains, SpatialForceGains
        )  # fmt: skip
        super().__init__(setup)
        known = setup.names
        self._sees_force, self._sees_way = "tip_force_normal" in known, "to_target_x" in known
        self._at, self._scales = self.entries([
            *(f"{'to_target' if self._sees_way else 'target'}_{axis}" for axis in AXES),
            *(f"target_velocity_{axis}" for axis in AXES), "target_force",
            *(["tip_force_normal"] if self._sees_force else []),
        ])  # fmt: skip
        gauges = [] if setup.sensors is None or self._sees_force else list(setup.sensors.strain_gauges)
        if not self._sees_force:
            names = [f"strain_gauge_{k + 1}" for k in range(len(gauges))]
            if len(gauges) < 3:
                what = "must have tip_force_normal or at least three strain gauges, which reveal the force"
                raise check.InvalidValue("observation", known, what)
            _, scales = self.entries(names)
            ratios = [g.per_curvature_of(setup.arm.links[g.link]) * float(np.mean(g.gains)) for g in gauges]
            self._centers, self._ratios = np.array([np.mean(g.biases) for g in gauges]), np.array(ratios)
            # readings count by their largest errors, at least a thousandth of the scale
            errors = np.array([g.noise + 0.5 * np.ptp(g.biases) for g in gauges])
            self._weights = self._ratios / np.maximum(errors, 1e-3 * scales)
        self.gravity = np.array(setup.gravity or (0.0, 0.0, 0.0))
        self.chain, self.bodies = SpatialChain(setup.arm, self.gravity, gauges), link_bodies(setup.arm)
        assert setup.wall is not None
        # unit vector from the root to the wall's nearest point
        bearing, elevation = setup.wall, setup.wall_elevation
        flat = np.cos(elevation)
        self._normal = np.array([flat * np.cos(bearing), flat * np.sin(bearing), np.sin(elevation)])
        self._passed = float(1.0 - np.exp(-setup.control_dt / gains.lag))
        self._new = float(1.0 - np.exp(-setup.control_dt / gains.filter)) if gains.filter > 0.0 else 1.0

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Begin episodes with their first observation, (n, entries) or (entries,)."""
        signals = self.read(observation)
        n = len(signals.angles)
        self.goal = signals.angles.copy()
        self._periods, self._way = np.zeros(n), np.zeros((n, 3))
        self._rates = np.zeros_like(self.goal)
        # shape of the reference, estimated shape and force
        self._bent, self._shape = np.zeros((n, self.chain.cells, 3)), np.zeros((n, self.chain.cells, 3))
        self._force = np.zeros((n, 3))
        self._tip = frames(self.setup.arm, signals.angles)[3]
        self._target = self._tip.copy()
        self.forget()

    def forget(self) -> None:
        self._shift, self._excess = np.zeros((len(self.goal), 3)), np.zeros(len(self.goal))

    def pressed(self, signals: Signals, seen: Array) -> Array:
        """Return joint torques (n, N), N m; see `WallController.pressed`."""
        setup, gains, dt, n = self.setup, self.gains, self.setup.control_dt, self._normal
        values = seen[:, self._at] * self._scales
        hub = frames(setup.arm, signals.angles)[2][:, 0]
        velocity, commanded = (hub @ values[:, 3:6, None])[..., 0], values[:, 6]
        # the path is straight and its speed constant: mean up to now, along the wall
        self._way += velocity - (velocity @ n)[:, None] * n
        velocity = self._way / (self._periods + 1.0)[:, None]
        speed = np.linalg.norm(velocity, axis=1)[:, None]
        along = velocity / np.maximum(speed, 1e-9)
        now, force = self.estimated(signals, along, values[:, 7] if self._sees_force else None)
        if self._sees_way:
            error = (hub @ values[:, :3, None])[..., 0]
            first = self._periods[:, None] == 0.0
            self._target = np.where(first, self._tip + error, self._target + velocity * dt)
        else:
            error, self._target = values[:, :3] - now.tip, values[:, :3]
        near, share, touching = self.progress()
        error -= (error @ n)[:, None] * n
        self._shift += (touching * gains.path * dt)[:, None] * error
        self._excess += touching * gains.force * dt * (commanded - force)
        size = ((commanded + self._excess) * share)[:, None]
        end = self._target + velocity * dt + self._shift
        reaction = -(n + self.friction * along) * size
        before = self.goal
        self._follow(self._tip + near[:, None] * (end - self._tip), reaction)
        # torques that hold the arm at its present angles: weight and reaction then have no destabilizing stiffness
        held = now.torques - (np.swapaxes(now.jacobian, 1, 2) @ (reaction - now.force)[..., None])[..., 0]
        # PD about the reference, scaled by the joints' inertia; filtered rates
        rates = (self.goal - before) / dt * np.minimum(self._periods, 1.0)[:, None]
        self._rates += self._passed * (signals.rates - rates - self._rates)
        inertia = np.diagonal(weight_and_inertia(setup.arm, self.gravity, self.goal, self.bodies)[1], axis1=1, axis2=2)
        off = np.clip(wrapped(self.goal - signals.angles), -1.0, 1.0)
        pull = gains.rate**2 * off - 2.0 * gains.ratio * gains.rate * self._rates
        return np.asarray(held + inertia * pull)

    def estimated(self, signals: Signals, along: Array, force: Array | None) -> tuple[Rest, Array]:
        """Estimate shape and normal force (n,), N, of the arms in a static approximation.

        along (n, 3): direction of the path. force (n,): measured normal force, N; None to estimate it from gauges.
        """
        if force is not None:
            self._force = -(self._normal + self.friction * along) * force[:, None]
        rest = self.chain.at(signals.angles, self._force, self._shape)
        self._shape = rest.curvatures
        if force is None:
            rows = rest.rows * self._weights[:, None]
            left = (signals.gauges - self._centers) / self._ratios - rest.offsets
            square = np.swapaxes(rows, 1, 2) @ rows
            square += DAMPED * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            found = np.linalg.solve(square, np.swapaxes(rows, 1, 2) @ (left * self._weights)[..., None])[..., 0]
            self._force = self._force + self._new * (found - self._force)
            force = -(self._force @ self._normal)
        return rest, force

    def _follow(self, reference: Array, reaction: Array) -> None:
        """Move `goal` towards the joint angles whose resting tip is at the reference (n, 3), m.

        reaction (n, 3): force on the tip, N. Two steps per control period follow the moving reference.
        """
        for _ in range(2):
            rest = self.chain.at(self.goal, reaction, self._bent)
            self._bent = rest.curvatures
            across = np.swapaxes(rest.jacobian, 1, 2)
            square = rest.jacobian @ across
            square += 1e-6 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            off = np.clip(reference - rest.tip, -0.05, 0.05)
            self.goal = self.goal + (across @ np.linalg.solve(square, off[..., None]))[..., 0]


class SpatialImpedance(SpatialHybridForce):
    """Impedance control in space: `SpatialHybridForce` without integral terms, so that no force needs to be measured.

    The joints behave like springs and dampers about the rest posture on the wall. The controller needs accurate models
    of friction, wall and arm.
    """

    def __init__(self, setup: Setup, gains: SpatialForceGains | None = None) -> None:
        """Set the integral gains to 0; see `SpatialHybridForce`."""
        own = SpatialForceGains() if gains is None else check.instance("gains", gains, SpatialForceGains)
        super().__init__(setup, replace(own, path=0.0, force=0.0))


class SpatialPathPD(SpatialImpedance):
    """PD control along the path on the wall without a contact force, about the arm at rest at the target."""

    def __init__(self, setup: Setup, gains: SpatialPDGains) -> None:
        """Use the gains of PD control in space; see `SpatialHybridForce`."""
        super().__init__(setup, SpatialForceGains(rate=gains.rate, ratio=gains.ratio, lag=gains.lag))

    def progress(self) -> tuple[Array, Array, Array]:
        """Return the progress of the approach, and zeros for the force; see `WallController.progress`."""
        near, share, touching = super().progress()
        return near, 0.0 * share, 0.0 * touching
