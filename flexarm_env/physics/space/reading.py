"""Compute positions, orientations and rates of an arm in space from recorded coordinates, for all instants at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...parameters import Arm, Link
from ...rigid import axis_of, frames, mount_of
from ...rotations import back, matrices, quaternions, slope, turned, vectors
from ...settings import Settings
from .build import count_elements, count_rows, levers, names_of, polynomials, tip_lever
from .elastica_build import _link, grid
from .layout import AXES
from .strained_layout import STRAINED

Array = NDArray[np.float64]

TURN = 0.2
"""Weight of an error in the tip's orientation: m/rad, divided by the arm's length. If bending displaces a tip by a
fraction of the length, the axes of the tip rotate by two to five times that fraction, in rad."""


class Frame(NamedTuple):
    """Position, axes and rates of a section at n instants, in inertial axes."""

    r: Array  # m (n, 3): position
    A: Array  # (n, 3, 3): rotation matrix, section axes to inertial axes
    v: Array  # m/s (n, 3): velocity
    w: Array  # rad/s (n, 3): angular velocity

    def beyond(self, arm: Array) -> Frame:
        """Return the `Frame` of a point fixed to the section at the lever `arm` (m, section axes)."""
        lever = turned(self.A, arm)
        return Frame(self.r + lever, self.A, self.v + np.cross(self.w, lever), self.w)


class LinkMotion(NamedTuple):
    """Motion of a link at n instants: its root (at the joint), the sections of its flexible part, its tip."""

    root: Frame
    sections: list[Frame]
    tip: Frame


def _vertex(q: Array, v: Array, i: int) -> Frame:
    """Return the `Frame` of a section; its six rows begin at row i of q and v (n, rows)."""
    A = matrices(q[:, i + 3 : i + AXES])
    return Frame(q[:, i : i + 3], A, v[:, i : i + 3], turned(A, v[:, i + 3 : i + AXES]))


def _strained(root: Frame, link: Link, n: int, c: Array, rate: Array) -> list[Frame]:
    """Return the `Frame`s of a link's Gauss points and last section, from its first section (root) and its strains.

    n: number of polynomials per strain. c, rate: coefficients of the strains and their rates, (instants, 3 n).
    """
    own, packed = grid(n), STRAINED.unpack(_link(link, n, 1.0), polynomials=n, points=n + 2)
    natural = np.zeros((n + 3, 2, 3))
    natural[..., 2] = packed["natural"]
    tables, c, rate = (own.sums, own.slants), c.reshape(-1, n, 3), rate.reshape(-1, n, 3)
    # psi = s + s x d of each interval, its rate, and the angular velocity that it adds
    s, d = (np.einsum("ij,mja->mia", table, c) + natural[:, k] for k, table in enumerate(tables))
    sv, dv = (np.einsum("ij,mja->mia", table, rate) for table in tables)
    psi, turn = s + np.cross(s, d), sv + np.cross(sv, d) + np.cross(s, dv)
    steps, rel = matrices(psi), turned(slope(psi), turn)
    # A, w outward from the root; r = L sum ways t, v = L sum ways (w x t), inertial axes
    A, w = [root.A], [root.w]
    for i in range(n + 3):
        A.append(A[-1] @ steps[:, i])
        w.append(w[-1] + turned(A[-1], rel[:, i]))
    t, spin = np.stack(A[1:-1], axis=1)[..., 0], np.stack(w[1:-1], axis=1)
    r, v = (np.einsum("ij,mja->mia", link.length * own.ways, x) for x in (t, np.cross(spin, t)))
    return [Frame(root.r + r[:, i], A[i + 1], root.v + v[:, i], w[i + 1]) for i in range(n + 3)]


def links(arm: Arm, settings: Settings, q: Array, v: Array) -> Iterator[LinkMotion]:
    """Yield the `LinkMotion` of each link, from root to tip, at the instants of the states q, v (instants, rows)."""
    at, i = _vertex(q, v, 0), AXES
    for k, link in enumerate(arm.links):
        before, beyond = levers(arm, k)
        # (9.1): t before the joint, E = mount exp(axis theta), w + axis theta'
        joint = at.beyond(before)
        axis = axis_of(arm, k)
        A = joint.A @ mount_of(arm, k) @ matrices(q[:, i, None] * axis)
        root = Frame(joint.r, A, joint.v, joint.w + turned(A, axis) * v[:, i, None])
        i += 1
        rows = count_rows(link, settings)
        # r, A of the link's sections: vertices, or (9.5) from the strains
        sections = [root.beyond(beyond)]
        if settings.formulation != "elastica":
            sections += [_vertex(q, v, i + AXES * e) for e in range(count_elements(link, settings))]
        elif rows:
            own = q[:, i : i + rows], v[:, i : i + rows]
            sections += _strained(sections[0], link, polynomials(settings), *own)
        i += rows
        at = sections[-1]
        yield LinkMotion(root, sections, at.beyond(tip_lever(link)))


def shapes(found: Sequence[LinkMotion]) -> Array:
    """Return (n, P, 3): positions (m, inertial axes) of the root, then of each link's sections and tip."""
    behind = [frame.r for motion in found for frame in (*motion.sections, motion.tip)]
    return np.stack([found[0].root.r, *behind], axis=1)


def velocities(found: Sequence[LinkMotion]) -> Array:
    """Return (n, P, 3): velocities (m/s, inertial axes) of the points of `shapes`."""
    behind = [frame.v for motion in found for frame in (*motion.sections, motion.tip)]
    return np.stack([found[0].root.v, *behind], axis=1)


def read(arm: Arm, settings: Settings, q: Array, v: Array) -> dict[str, Any]:
    """Return the fields of a `Trajectory` in space from states q, v (n, rows), as keyword arguments."""
    found = list(links(arm, settings, q, v))
    n, N = len(q), arm.n_links
    deflection, twist = np.zeros((n, N, 2)), np.zeros((n, N))
    for k, (link, motion) in enumerate(zip(arm.links, found, strict=True)):
        # tip in root axes less its stress-free position, over the span, along y and z; twist about x (rad)
        inner = back(motion.root.A, motion.tip.r - motion.root.r)
        if link.span > 0.0 and not link.rigid:
            deflection[:, k] = (inner[:, 1:] - [link.far.imag, 0.0]) / link.span
        twist[:, k] = vectors(np.swapaxes(motion.root.A, 1, 2) @ motion.tip.A)[:, 0]
    tip, (rows, motors) = found[-1].tip, _angle_rows(arm, settings)
    return {
        "start": found[0].root.r, "tip": tip.r, "tip_rotation": quaternions(tip.A),
        "tip_velocity": np.hstack([tip.v, tip.w]),
        "hinges": np.stack([m.root.r for m in found[1:]], axis=1) if N > 1 else np.zeros((n, 0, 3)),
        "joint_angles": q[:, rows], "joint_rates": v[:, rows], "motor_angles": q[:, motors],
        "motor_rates": v[:, motors],
        "tip_deflection": deflection, "twist": twist, "shapes": shapes(found),
        "link_rotations": np.stack(
            [np.stack([quaternions(m.root.A), quaternions(m.tip.A)], axis=1) for m in found], axis=1
        ),
    }  # fmt: skip


def tips(arm: Arm, settings: Settings, q: Array) -> Array:
    """Return (n, 4, 3), m: the tip's position, then its three unit axes, each times `TURN` times the arm's length."""
    *_, last = links(arm, settings, q, np.zeros_like(q))
    axes = TURN * arm.total_length * np.swapaxes(last.tip.A, 1, 2)
    return np.concatenate([last.tip.r[:, None], axes], axis=1)


def _angle_rows(arm: Arm, settings: Settings) -> tuple[list[int], list[int]]:
    """Return the rows of the joint angles and of the motor angles; motors on elastic gears follow all other rows."""
    names = names_of(arm, settings)
    joints = [names.index(f"joint{k}") for k in range(arm.n_links)]
    elastic = [k for k in range(arm.n_links) if arm.joint(k).elastic]
    behind = dict(zip(elastic, range(len(names), len(names) + len(elastic)), strict=True))
    return joints, [behind.get(k, row) for k, row in enumerate(joints)]


def straight(arm: Arm, angles: Array) -> Array:
    """Return positions (..., N + 1, 3), m, of joints and tip of the rigid arm at joint angles (..., N), rad."""
    places, _, _, tip = frames(arm, angles)
    return np.concatenate([places, tip[..., None, :]], axis=-2)
