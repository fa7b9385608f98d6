"""Compute poses, points and joint angles from an arm's state; the same interface for arms in the plane and in space."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..layout import Layout
from ..parameters import Arm
from ..scene import Scene
from ..settings import Settings
from ..validation import Array
from . import assembly
from .gauges import over
from .layout import POSE, POSES, SPACE_POSE, SPACE_POSES, TIP, TIP_RATES
from .model import OWN, OWN_IN_SPACE, STIFFNESSES, System
from .protocol import centerline
from .space.reading import read


def link_deflection(poses: Array) -> Array:
    """Return each link's tip deflection, m: the signed distance of the tip from the tangent at the root.

    poses (..., n_links, 12): poses of links with the fields of `layout.POSES`. The result has shape (..., n_links).
    """
    dx, dy = poses[..., POSE.tip_x] - poses[..., POSE.x], poses[..., POSE.tip_y] - poses[..., POSE.y]
    angle = poses[..., POSE.angle]
    return np.asarray(np.cos(angle) * dy - np.sin(angle) * dx)


def joint_angles(poses: Array) -> tuple[Array, Array]:
    """Return joint angles (rad) and rates (rad/s): joint 0 from the x axis, joint k from the tip of link k - 1.

    poses (..., n_links, 12): poses of links with the fields of `layout.POSES`. Both results have shape (..., n_links).
    """
    angles, rates = poses[..., POSE.angle].copy(), poses[..., POSE.rate].copy()
    angles[..., 1:] -= poses[..., :-1, POSE.tip_angle]
    rates[..., 1:] -= poses[..., :-1, POSE.tip_rate]
    return angles, rates


def placed(coordinates: Mapping[str, int], poses: Array, q: Array, v: Array) -> dict[str, Any]:
    """Return the fields of a `Trajectory` for tip, joints and motors, from poses (n, N, 12) and states (n, rows)."""
    angles, rates = joint_angles(poses)
    base = coordinates.get("base")
    if base is not None:
        angles[:, 0], rates[:, 0] = angles[:, 0] - q[:, base], rates[:, 0] - v[:, base]
    motors = [coordinates.get(f"motor{k}") for k in range(poses.shape[1])]
    turned = [angles[:, k] if row is None else q[:, row] for k, row in enumerate(motors)]
    spun = [rates[:, k] if row is None else v[:, row] for k, row in enumerate(motors)]
    return {
        "tip": poses[:, -1, TIP], "tip_velocity": poses[:, -1, TIP_RATES],
        "joint_angles": angles, "joint_rates": rates,
        "motor_angles": np.array(turned).T, "motor_rates": np.array(spun).T,
    }  # fmt: skip


class Reading:
    """Quantities of an arm in the plane.

    Attributes:
        poses: layout of a link's pose, as tasks read it. own: names of the parameters in which arms may differ
        (`model.OWN`). stiffnesses: names of the stiffnesses that have factors of their own.
    """

    poses: Layout = POSES
    own: tuple[str, ...] = OWN
    stiffnesses: tuple[str, ...] = ("EI",)

    def scale_rows(self, rows: Array, sizes: Array) -> Array:
        """Return gauge rows (`gauges.curvature_rows`) divided by sizes (G,), 1/m; readings are relative to these."""
        return over(rows, sizes, False)

    def pose_table(self, arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> Array | None:
        """Return the table for starts with straight links (`assembly.pose_table`); None if starts need no table."""
        return assembly.pose_table(arm, settings, gravity)

    def joints(self, poses: Array) -> tuple[Array, Array]:
        """Return joint angles (..., N), rad, and their rates, rad/s, from poses (..., N, size)."""
        return joint_angles(poses)

    def points(self, arm: Arm, settings: Settings, model: Any, q: Array) -> Array:
        """Return positions (P, 2), in space (P, 3), of points along the chain from root to tip, m."""
        points = np.full((assembly.room_for_points(settings, arm.n_links), 2), np.nan)
        return points[: int(centerline(model, q, points))].copy()

    def start_angles(self, scene: Scene, poses: Array) -> Array:
        """Return the joint angles (N,), rad, at the start of a scene. poses: `Simulation.observe` at the start."""
        return joint_angles(poses)[0]

    def bends(self, arm: Arm, settings: Settings, poses: Array, q: Array) -> Array:
        """Return the tip deflections divided by the links' lengths: (N,), in space (2 N,), along y and then along z."""
        return np.asarray(link_deflection(poses) / np.array([link.span for link in arm.links]))

    def motion(
        self, arm: Arm, settings: Settings, system: System, q: Array, v: Array, poses: Callable[[], Array]
    ) -> dict[str, Any]:
        """Return fields of a `Trajectory` from states q, v (n, rows); poses: function that returns the links' poses."""
        return placed(system.coordinates, poses(), q, v)


class SpaceReading(Reading):
    """Quantities of an arm in space."""

    poses, own, stiffnesses = SPACE_POSES, OWN_IN_SPACE, tuple(STIFFNESSES)

    def scale_rows(self, rows: Array, sizes: Array) -> Array:
        return over(rows, sizes, True)

    def pose_table(self, arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> None:
        return None

    def joints(self, poses: Array) -> tuple[Array, Array]:
        return poses[..., SPACE_POSE.angle], poses[..., SPACE_POSE.rate]

    def points(self, arm: Arm, settings: Settings, model: Any, q: Array) -> Array:
        return np.asarray(read(arm, settings, q[None], np.zeros((1, len(q))))["shapes"][0])

    def start_angles(self, scene: Scene, poses: Array) -> Array:
        return np.array(scene.angles)

    def bends(self, arm: Arm, settings: Settings, poses: Array, q: Array) -> Array:
        found: Array = read(arm, settings, q[None], np.zeros((1, len(q))))["tip_deflection"][0].T.ravel()
        return found

    def motion(
        self, arm: Arm, settings: Settings, system: System, q: Array, v: Array, poses: Callable[[], Array]
    ) -> dict[str, Any]:
        return read(arm, settings, q, v)


READINGS: dict[str, Reading] = {"xy": Reading(), "xyz": SpaceReading()}
"""`Reading` objects by the axes along which an arm moves."""


def reading_of(item: Arm | Scene) -> Reading:
    """Return the `Reading` for an arm or for a scene's arm."""
    return READINGS[item.axes]
