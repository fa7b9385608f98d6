"""Static model of arms in space under gravity and a force on the tip: shape, torques and gauge readings of many arms.

Links are Kirchhoff rods (without stretch and shear) with large rotations, divided into cells of constant curvature. The
curvatures are found by fixed-point iteration. A controller continues the iteration from the curvatures of the previous
period, so that one or two iterations per period suffice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..bodies import Body, tensor
from ..parameters import Arm
from ..physics.space.build import far_body, near_body, tip_end, tip_lever
from ..physics.space.gauges import AXIS
from ..rigid import axis_of, mount_of
from ..rotations import cross, matrices
from ..sensors import StrainGauge
from ..validation import Array

CELLS = 8
"""Number of cells of a flexible link."""


@dataclass(frozen=True)
class Rest:
    """n arms at rest; vectors are in inertial axes.

    Attributes:
        force (n, 3): force on the tip, N.
        tip (n, 3): position of the tip, m.
        torques (n, N): holding torques of the joints, N m.
        jacobian (n, 3, N): derivatives of the tip position by the joint angles at fixed curvatures, m/rad.
        curvatures (n, cells, 3): twist and curvatures of the cells, 1/m.
        rows (n, G, 3), offsets (n, G): the curvatures at the gauges are rows @ force + offsets, 1/m.
    """

    force: Array
    tip: Array
    torques: Array
    jacobian: Array
    curvatures: Array
    rows: Array
    offsets: Array


class SpatialChain:
    """Static model of an arm with flexible links in space.

    Args:
        arm: an arm in space. gravity (3,): acceleration of gravity, m/s^2. gauges: strain gauges whose readings are
            computed.
    """

    def __init__(self, arm: Arm, gravity: Array, gauges: Sequence[StrainGauge] = ()) -> None:
        """Store the cells' lengths (m), stiffnesses (N m^2) and masses (kg)."""
        self.arm, self.gravity, self.gauges = arm, np.asarray(gravity, np.float64), tuple(gauges)
        self.first: list[int] = []
        stiffness: list[tuple[float, float, float]] = []
        masses, lengths = [], []
        for link in arm.links:
            self.first.append(len(stiffness))
            if link.rigid:
                continue
            s = link.length * (np.arange(CELLS) + 0.5) / CELLS
            across = link.across(s)
            for i, at in enumerate(s.tolist()):
                own = link.along(at)
                stiffness.append((float(across["GJ"][i]), float(across["EI_y"][i]), float(own.EI)))
                lengths.append(link.length / CELLS)
                masses.append(float(own.m) * lengths[-1])
        self.stiffness, self.masses = np.array(stiffness).reshape(-1, 3), np.array(masses)
        self.lengths = np.array(lengths)
        # curvature per moment about an axis of the section, 1/(N m^2)
        self.per_moment = np.array([AXIS[g.measures][1] / self._stiffness_at(g) for g in self.gauges])

    @property
    def cells(self) -> int:
        """Total number of cells in all links."""
        return len(self.masses)

    def at(self, angles: Array, force: Array, curvatures: Array) -> Rest:
        """Compute one fixed-point iteration for arms at joint angles (n, N), rad, with forces (n, 3), N, on their tips.

        curvatures (n, cells, 3): curvatures of the cells, 1/m, from which the shape is computed. The result contains
        new curvatures, which are computed from the moments along the arm with the shape of `curvatures`.
        """
        arm, n = self.arm, len(angles)
        A, r = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        # masses from root to tip: places and kg; joints and cells: place, axes, number of the first mass beyond
        places: list[Array] = []
        weights: list[float] = []
        joints: list[tuple[Array, Array, int]] = []
        spots: list[tuple[Array, Array, int]] = []
        read: dict[int, tuple[Array, Array, int]] = {}

        def carry(body: Body) -> None:
            if body.mass > 0.0:
                places.append(r + A @ body.centre)
                weights.append(body.mass)

        for k, link in enumerate(arm.links):
            axis = axis_of(arm, k)
            A = A @ mount_of(arm, k) @ matrices(angles[:, k, None] * axis)
            joints.append((r, A @ axis, len(weights)))
            if not link.rigid:
                r = r + link.root_offset * A[..., 0]
            carry(far_body(arm, k))
            if not link.rigid:
                h, i = link.length / CELLS, self.first[k]
                own = curvatures[:, i : i + CELLS]
                halves, wholes = matrices(0.5 * h * own), matrices(h * own)
                for j in range(CELLS):
                    for g, gauge in enumerate(self.gauges):
                        s = gauge.place * link.length - j * h
                        if gauge.link == k and (0.0 <= s < h or (j == CELLS - 1 and s >= h)):
                            at = r + s * (A @ matrices(0.5 * s * own[:, j]))[..., 0]
                            read[g] = (at, A @ matrices(s * own[:, j]), len(weights) + int(s > 0.5 * h))
                    middle = A @ halves[:, j]
                    spots.append((r + 0.5 * h * middle[..., 0], middle, len(weights)))
                    places.append(spots[-1][0])
                    weights.append(float(self.masses[i + j]))
                    r, A = r + h * middle[..., 0], A @ wholes[:, j]
            if k + 1 < arm.n_links:
                carry(near_body(arm, k + 1))
            else:
                carry(tip_end(link))
            r = r + A @ tip_lever(link)
        held = arm.payload
        carry(Body(held.mass, np.array((*held.offset, 0.0)[:3]), tensor(held.inertia)))
        # sums of mass and mass times place over all masses from number j on
        mass = np.append(np.cumsum(np.array(weights)[::-1])[::-1], 0.0)
        moved = np.stack(places, 1) * np.array(weights)[:, None]
        first = np.concatenate([np.cumsum(moved[:, ::-1], axis=1)[:, ::-1], np.zeros((n, 1, 3))], axis=1)

        def moments(spots: list[tuple[Array, Array, int]], beyond: int) -> tuple[Array, Array]:
            """Return vectors (n, spots, 3) from spots to tip, m, and moments of the weight beyond each spot, N m."""
            at, js = np.stack([spot[0] for spot in spots], axis=1), np.array([spot[2] for spot in spots]) + beyond
            return r[:, None] - at, cross(first[:, js] - mass[js, None] * at, self.gravity)

        levers, weight = moments(joints, 0)
        axes = np.stack([axis for _, axis, _ in joints], axis=1)
        torques = -(axes * (weight + cross(levers, force[:, None]))).sum(axis=2)
        columns = np.swapaxes(cross(axes, levers), 1, 2)
        after = np.zeros_like(curvatures)
        if spots:
            levers, weight = moments(spots, 1)
            axes = np.stack([A for _, A, _ in spots], axis=1)
            # the outer half of a cell's own mass has the lever h / 4
            own = 0.125 * (self.masses * self.lengths)[:, None] * axes[..., 0]
            moment = weight + cross(levers, force[:, None]) + cross(own, self.gravity)
            after = (moment[:, :, None] @ axes)[:, :, 0] / self.stiffness
        rows, offsets = np.zeros((n, len(self.gauges), 3)), np.zeros((n, len(self.gauges)))
        if read:
            levers, weight = moments([read[g] for g in range(len(self.gauges))], 0)
            a = np.stack([read[g][1][..., AXIS[gauge.measures][0]] for g, gauge in enumerate(self.gauges)], axis=1)
            a = a * self.per_moment[:, None]
            # a . (l x F) = (a x l) . F
            rows, offsets = cross(a, levers), (a * weight).sum(axis=2)
        return Rest(force, r, torques, columns, after, rows, offsets)

    def _stiffness_at(self, gauge: StrainGauge) -> float:
        """Return the stiffness GJ, EI_y or EI, N m^2, that belongs to a gauge."""
        link = self.arm.links[gauge.link]
        s = gauge.place * link.length
        across = link.across(np.array(s))
        return float((across["GJ"], across["EI_y"], link.along(s).EI)[AXIS[gauge.measures][0]])
