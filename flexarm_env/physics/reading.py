"""Compute poses, points and joint angles from an arm's state; the same interface for arms in the plane and in space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from .. import rotations
from ..compiler import SINGLE
from ..layout import Layout
from ..parameters import Arm
from ..scene import Scene
from ..settings import Settings
from ..validation import Array
from . import assembly
from .equations import WITH_SLOPES, point_slopes
from .gauges import over
from .layout import POSE, POSES, ROOT, ROOT_RATES, SPACE_POSE, SPACE_POSES, TIP, TIP_RATES
from .model import OWN, OWN_IN_SPACE, STIFFNESSES, System
from .protocol import centerline
from .space.reading import links, read, tips, velocities


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


SHOWN = {
    "": "angle", "_rate": "rate", "deflection_y": "deflection", "deflection_z": "deflection",
    "deflection_y_rate": "deflection_rate", "deflection_z_rate": "deflection_rate", "twist": "twist",
    "twist_rate": "twist_rate",
}  # fmt: skip
"""Names of a link's outputs in space that follow "joint0" and "joint0_rate", and the fields of `SPACE_POSES` from which
they are computed."""


def rate_name(name: str) -> str:
    """Return the name of the rate of a deflection or twist (`Reading.bent`): "tip_deflection_rate_y"."""
    return name.replace("deflection", "deflection_rate") if "deflection" in name else f"{name}_rate"


class Reading:
    """Quantities of an arm in the plane.

    Attributes:
        poses: layout of a link's pose, as tasks read it. own: names of the parameters in which arms may differ
        (`model.OWN`). stiffnesses: names of the stiffnesses that have factors of their own. planes: planes of a link's
        axes in which the link bends. bent: names of a link's deflections and twist in observations. tip: entries of a
        pose with the tip's position. place: components of `Trajectory.start` and `tip`. passes: number of iterations
        for the derivatives of a step (`derivatives.runs`) if the step's matrix is approximate in all formulations,
        otherwise None. output_names: names of the arrays in `outputs`, without link numbers.
    """

    poses: Layout = POSES
    own: tuple[str, ...] = OWN
    stiffnesses: tuple[str, ...] = ("EI",)
    planes: tuple[str, ...] = ("xy",)
    output_names: tuple[str, ...] = ("", "_rate", "deflection", "deflection_rate")
    bent: tuple[str, ...] = ("tip_deflection",)
    place: tuple[str, ...] = ("x", "y", "angle")
    tip = slice(POSE.tip_x, POSE.tip_x + 2)
    passes: int | None = None
    meanings: ClassVar[dict[str, tuple[str, str]]] = {
        "payload_mass": ("kg", "of the arm"), "payload_inertia": ("kg m2", "of the arm"),
        "EI_factor": ("", "on all stiffness to bending"), "tau_d": ("s", "of the damping"),
    }  # fmt: skip
    """Unit and meaning of each parameter in `own`."""

    def pose_entries(self) -> Iterator[tuple[str, str, str]]:
        """Yield name, unit and meaning of each number of a link's pose, for users outside of Python."""
        for field in self.poses.fields:
            where, word = "tip" if field.name.startswith("tip_") else "root", field.name.removeprefix("tip_")
            yield f"{where}_{word}", field.unit, f"of its {where}"

    def scale_rows(self, rows: Array, sizes: Array) -> Array:
        """Return gauge rows (`gauges.curvature_rows`) divided by sizes (G,), 1/m; readings are relative to these."""
        return over(rows, sizes, False)

    def strain_rows(self, rows: Array, distances: Array, limit: float) -> Array:
        """Return gauge rows for surface strains over `limit`. distances (G,): of the surface from the axis, m."""
        return np.asarray(rows * distances[:, None] / limit)

    def resting(self, settings: Settings) -> dict[str, Any]:
        """Return the settings that the search for a rest (`rest.relax`) changes."""
        return {}

    def buckling(self, settings: Settings) -> str:
        """Return a further reason for which no rest may be found, or ""."""
        return ""

    def restarts_sampling(self, kinks: bool, moves: bool) -> bool:
        """Return whether `runtime.sampling.sample_rows` restarts by itself.

        kinks: whether the scene has kinks. moves: whether it has motions.
        """
        return kinks

    def deflection_bound(self, settings: Settings) -> float:
        """Return the largest valid tip deflection divided by link length; inf without a bound."""
        return settings.deflection_bound

    def pose_table(self, arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> Array | None:
        """Return the table for starts with straight links (`assembly.pose_table`); None if starts need no table."""
        return assembly.pose_table(arm, settings, gravity)

    def joints(self, poses: Array) -> tuple[Array, Array]:
        """Return joint angles (..., N), rad, and their rates, rad/s, from poses (..., N, size)."""
        return joint_angles(poses)

    def outputs(self, poses: Any, base: tuple[Any, Any]) -> list[Any]:
        """Return joint angles, deflections and so on (`output_names`) of all links, from poses (N, size).

        base: attitude (rad) of the arm's base and its rate, rad/s. Poses may be complex, for derivatives.
        """
        angles, rates = joint_angles(poses)
        angles[0], rates[0] = angles[0] - base[0], rates[0] - base[1]
        cos, sin, spin = np.cos(poses[:, POSE.angle]), np.sin(poses[:, POSE.angle]), poses[:, POSE.rate]
        dx, dy, _ = (poses[:, TIP] - poses[:, ROOT]).T
        vx, vy, _ = (poses[:, TIP_RATES] - poses[:, ROOT_RATES]).T
        turning = cos * vy - sin * vx - spin * (cos * dx + sin * dy)
        return [angles, rates, link_deflection(poses), turning]

    def points(self, arm: Arm, settings: Settings, model: Any, q: Array) -> Array:
        """Return positions (P, 2), in space (P, 3), of points along the chain from root to tip, m."""
        points = np.full((assembly.room_for_points(settings, arm.n_links), 2), np.nan)
        return points[: int(centerline(SINGLE, model, q, points))].copy()

    def point_slopes(self, arm: Arm, settings: Settings, model: Any, q: Array, ways: Array) -> Array:
        """Return the derivatives (m, P, 2), in space (m, P, 3), of `points` along directions ways (m, n).

        Changes of rotations are increments in body axes.
        """
        room, n, m = assembly.room_for_points(settings, arm.n_links), len(q), len(ways)
        own, line = np.zeros(n * len(WITH_SLOPES)), np.zeros((room, 2 * len(WITH_SLOPES)))
        points, slopes = np.zeros((room, 2)), np.zeros((m, room, 2))
        count = int(point_slopes(WITH_SLOPES, model, q, ways, own, line, points, slopes))
        return slopes[:, :count].copy()

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

    def record(
        self, arm: Arm, settings: Settings, system: System, fields: Mapping[str, Array], shapes: Array
    ) -> dict[str, Any]:
        """Return all fields of a `Trajectory` that follow from the arrays of `Simulation.record`."""
        poses = fields["poses"]
        lengths = np.array([link.span for link in arm.links])
        bows = np.array([link.far.imag for link in arm.links])
        return {
            "deflection_bound": settings.deflection_bound, "start": poses[:, 0, ROOT],
            "hinges": poses[:, 1:, POSE.x : POSE.angle], "tip_deflection": (link_deflection(poses) - bows) / lengths,
            "shapes": shapes, **placed(system.coordinates, poses, fields["q"], fields["v"]),
            "link_angles": poses[..., [POSE.angle, POSE.tip_angle]],
        }  # fmt: skip

    def compared_tips(self, arm: Arm, settings: Settings, q: Array, tip: Callable[[], Array]) -> Array:
        """Return the tip's positions (n, 2), m, from which errors are estimated; in space positions and axes (n, 4, 3).

        q (n, rows): states. tip: function that returns `Trajectory.tip`.
        """
        return tip()[:, :2]

    def tip_inputs(self, tip: Array, velocity: Array, rotation: Array) -> dict[str, list[Array]]:
        """Return the quantities at the tip that each sensor reads, from arrays of a `Trajectory`, by sensor."""
        return {"accelerometer": [tip, velocity], "camera": [tip[:, :2]]}


class SpaceReading(Reading):
    """Quantities of an arm in space."""

    poses, own, stiffnesses = SPACE_POSES, OWN_IN_SPACE, tuple(STIFFNESSES)
    output_names = tuple(SHOWN)
    planes, bent = ("xy", "xz"), ("tip_deflection_y", "tip_deflection_z", "twist")
    tip, place, passes = slice(SPACE_POSE.tip, SPACE_POSE.tip + 3), ("x", "y", "z"), 10
    meanings = Reading.meanings | {
        "payload_inertia": ("", "a factor on the payload's tensor"), "EI_factor": ("", "on EI"),
        "EI_y_factor": ("", "on EI_y"), "GJ_factor": ("", "on GJ"),
    }  # fmt: skip

    def pose_entries(self) -> Iterator[tuple[str, str, str]]:
        for field, shape in zip(self.poses.fields, self.poses.shapes(), strict=True):
            for place in np.ndindex(shape):
                yield f"{field.name}{list(place) if place else ''}".replace(" ", ""), field.unit, field.meaning

    def scale_rows(self, rows: Array, sizes: Array) -> Array:
        return over(rows, sizes, True)

    def strain_rows(self, rows: Array, distances: Array, limit: float) -> Array:
        return over(rows, limit / distances, True)

    def resting(self, settings: Settings) -> dict[str, Any]:
        """Assemble an elastica for steps of 1 s: its added inertia is then proportional to the stiffness.

        All strains then come to rest at the same rate.
        """
        return {"dt": 1.0} if settings.formulation == "elastica" else {}

    def buckling(self, settings: Settings) -> str:
        if settings.formulation != "floating_frame":
            return ""
        return ", or be just below what it buckles under, where floating frames find none (geometrically_exact does)"

    def restarts_sampling(self, kinks: bool, moves: bool) -> bool:
        """Return True with motions, too: restarts within `sample_rows` save a second compilation."""
        return kinks or moves

    def deflection_bound(self, settings: Settings) -> float:
        return math.inf

    def pose_table(self, arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> None:
        return None

    def joints(self, poses: Array) -> tuple[Array, Array]:
        return poses[..., SPACE_POSE.angle], poses[..., SPACE_POSE.rate]

    def outputs(self, poses: Any, base: tuple[Any, Any]) -> list[Any]:
        values, found = SPACE_POSES.unpack(poses), []
        for name, field in SHOWN.items():
            of = values[field]
            found.append(of[:, "yz".index(name[11])] if of.ndim > 1 else of)
        return found

    def points(self, arm: Arm, settings: Settings, model: Any, q: Array) -> Array:
        return np.asarray(read(arm, settings, q[None], np.zeros((1, len(q))))["shapes"][0])

    def point_slopes(self, arm: Arm, settings: Settings, model: Any, q: Array, ways: Array) -> Array:
        # the velocity at the rates `ways` is the derivative along `ways`
        return velocities(list(links(arm, settings, np.broadcast_to(q, ways.shape), ways)))

    def start_angles(self, scene: Scene, poses: Array) -> Array:
        return np.array(scene.angles)

    def bends(self, arm: Arm, settings: Settings, poses: Array, q: Array) -> Array:
        found: Array = read(arm, settings, q[None], np.zeros((1, len(q))))["tip_deflection"][0].T.ravel()
        return found

    def motion(
        self, arm: Arm, settings: Settings, system: System, q: Array, v: Array, poses: Callable[[], Array]
    ) -> dict[str, Any]:
        return read(arm, settings, q, v)

    def record(
        self, arm: Arm, settings: Settings, system: System, fields: Mapping[str, Array], shapes: Array
    ) -> dict[str, Any]:
        found = read(arm, settings, fields["q"], fields["v"])
        return {"deflection_bound": math.inf, "unresolved_damping": fields["beyond"], **found}

    def compared_tips(self, arm: Arm, settings: Settings, q: Array, tip: Callable[[], Array]) -> Array:
        return tips(arm, settings, q)

    def tip_inputs(self, tip: Array, velocity: Array, rotation: Array) -> dict[str, list[Array]]:
        turn = rotations.of_quaternions(rotation)
        A = rotations.matrices(turn)
        spin = rotations.back(A, velocity[:, 3:])
        return {
            "accelerometer": [tip, turn, velocity[:, :3], spin], "gyroscope": [spin],
            "camera": [tip, np.arcsin(np.clip(A[:, 1:, 0], -1.0, 1.0))],
        }  # fmt: skip


READINGS: dict[str, Reading] = {"xy": Reading(), "xyz": SpaceReading()}
"""`Reading` objects by the axes along which an arm moves."""


def reading_of(item: Arm | Scene) -> Reading:
    """Return the `Reading` for an arm or for a scene's arm."""
    return READINGS[item.axes]
