"""Validation, targets and task data of environments in space."""

import dataclasses
import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from .. import bodies
from .. import validation as check
from ..batch import SpacePress, SpaceReach, Starts, Task
from ..geometry.inverse import angles_at, beyond_reach, chain_of
from ..parameters import Arm
from ..rigid import largest_force, rate_scale, tip_at
from ..sensors import Sensors
from ..time_functions import TimeFunction
from ..validation import Array
from .attainable import ConditionsInSpace
from .targets import FORCES, NEAR, POINT, Pair, Target, Wall, check_force, coordinates, joint_range
from .task import CHAIN, REACH, SLEW, Kind, at_zero, within
from .vibration import swing

SHARES = (1.0, 0.75, 0.5, 0.25)
"""Shares of the default ranges' widths that are tried for paths of an arm with joint limits."""

HEIGHTS = (0.2, 0.5)
"""Range of the height of a path's middle in space, divided by the largest distance within reach along the wall."""


class Place(Target):
    """Type of targets that are positions of the tip in space, (x, y, z), m.

    The arm's `START` record stores a target as the joint angles at which the rigid arm reaches the target.
    """

    numbers = 3
    paths: ClassVar = {name: (*entries, ("elevation", "rad")) for name, entries in POINT.paths.items()}

    def read(self, arm: Arm, value: Any, gravity: Sequence[float] | None = None) -> Any:
        """Return joint angles (N,), rad, at which the rigid arm's tip is at a point.

        If gravity is given, joint angles at which the motors can hold the arm are preferred.
        """
        point = check.numbers("options.target", value, "three numbers (m), (x, y, z)", 3, "m")
        angles = angles_at(arm, np.array(point), gravity)
        if angles is None:
            raise check.InvalidValue("options.target", point, "must be a point that the rigid arm's tip reaches")
        return angles

    def reached(self, arm: Arm, angles: Sequence[float]) -> Any:
        """Return the point (x, y, z), m, of the rigid arm's tip at joint angles."""
        return tuple(tip_at(arm, np.array(angles)).tolist())

    def requested(self, arm: Arm, angles: Sequence[float]) -> Sequence[float]:
        """Return the joint angles at the target."""
        return angles

    def request_size(self, arm: Arm) -> int:
        """Return the number of joint angles."""
        return arm.n_links

    def goal(self, task: Task, angles: Array, drawn: Array) -> Array:
        """Return the random joint angles `drawn`, which define the target."""
        return drawn

    def start_ranges(self, arm: Arm, value: Any) -> list[Pair]:
        """Return a range of each joint angle, rad."""
        rows = check.sequence("starts.target", value, f"{arm.n_links} pairs of joint angles, rad", arm.n_links)
        return [joint_range(arm, k, row, "target") for k, row in enumerate(rows)]

    def chain(self, arm: Arm) -> dict[str, Array]:
        """Return the rigid chain, from which kernels compute the tip."""
        return {"chain": chain_of(arm)}

    def axis(self, arm: Arm) -> Array:
        """Return the axis of the hub, (3,)."""
        return np.array(arm.hub_axis, np.float64)

    def place(self, arm: Arm, target: Array) -> Array:
        return target

    def entries(self, arm: Arm) -> list[tuple[str, float]]:
        return POINT.entries(arm, "xyz")

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return default ranges of random paths, scaled to the arm's length and to its fastest joint rates."""
        _, *others, bearing = POINT.ranges(arm, path)
        far = arm.total_length
        if path == "circle":
            others[-1] = (0.05 * far, 0.15 * far)
        return [(0.45 * far, 0.65 * far), *others, bearing, (math.pi / 6, math.pi / 3)]

    def narrowed(self, ranges: list[Pair], options: Mapping[str, Any], arm: Arm, path: str) -> list[Pair]:
        """Narrow the default ranges about their middles if joint limits exclude some of the paths; warn if so.

        The widths of the ranges are multiplied by the largest factor in `SHARES` with which `check_ranges` accepts all
        paths. If no factor suffices, `InvalidValue` is raised. Ranges that the user gives are not changed.
        """
        names = [name for name, _ in self.paths[path]]
        free = [name in ("distance", "radius", "bearing", "elevation") and name not in options for name in names]
        for share in SHARES if arm.joint_limits else (1.0,):
            tried = [_about_middle(one, share) if own else one for one, own in zip(ranges, free, strict=True)]
            try:
                self.check_ranges(tried, arm, path)
            except check.InvalidValue:
                if share == SHARES[-1] or not arm.joint_limits:
                    raise
                continue
            if share < 1.0:
                narrow = [(n, *pair) for n, pair, own in zip(names, tried, free, strict=True) if own]
                used = ", ".join(f'"{n}": ({low:.3g}, {high:.3g})' for n, low, high in narrow)
                what = f"reference: the usual paths lead beyond the joint limits of {arm.name!r}; those within"
                warnings.warn(f"{what} {{{used}}} are drawn", UserWarning, stacklevel=8)
            return tried
        raise AssertionError

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` if a path of the ranges leaves the reach or the joint limits.

        The function evaluates paths at the middles and ends of the ranges. It samples several points of a circular
        path, but only the point of a straight path that is nearest to the root.
        """
        distance, _, (_, radius), *turns = ranges
        bearing, elevation = (np.linspace(*pair, 5) for pair in turns)
        r, b, e = (grid.ravel() for grid in np.meshgrid(np.linspace(*distance, 3), bearing, elevation))
        places = np.stack([r * np.cos(b) * np.cos(e), r * np.sin(b) * np.cos(e), r * np.sin(e)], axis=1)
        if path == "circle" and radius > 0.0:
            around = np.array([w for w in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(w)])
            around *= radius / np.linalg.norm(around, axis=1)[:, None]
            places = (places[:, None] + around).reshape(-1, 3)
        wrong = beyond_reach(arm, places)
        if wrong is not None:
            limits = " and the joint limits" * bool(arm.joint_limits)
            what = f"must keep the path, or a line's nearest point, within reach{limits}"
            raise check.InvalidValue("reference.distance", distance, f"{what}: {_as_text(places[wrong])} is not")

    def path(self, reference: Any, arm: Arm, t: Array) -> list[TimeFunction]:
        """Return x, y and z, m, of a path as functions of time; a ValueError names the first instant out of reach."""
        all_three = coordinates(reference, "three functions of time, x, y and z (m), or a table (n, 4): t, x, y, z", 3)
        places = np.stack([f(t) for f in all_three], axis=1)
        wrong = beyond_reach(arm, places)
        if wrong is not None:
            what = "must be a point within reach" + " and the joint limits" * bool(arm.joint_limits)
            raise ValueError(f"reference = {_as_text(places[wrong])} at {t[wrong]:g} s: {what}")
        return all_three


class OnWallInSpace(Place):
    """Moving target that slides along a wall in space, in a random direction."""

    paths: ClassVar = {"line": (*Place.paths["line"], ("height", "m"), ("force", "N"))}

    def __init__(self, wall: Wall, duration: float) -> None:
        """Store the wall and the length of an episode, s."""
        self.wall, self.duration = wall, duration

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        """Return ranges of distance (m), time (s), speed (m/s), bearing and elevation (rad), height (m), force (N).

        The height of a path's middle is measured from the wall's point nearest to the root, upwards along the wall.
        """
        d, b, e = self.wall
        half, most = self.wall.half_chord(arm.total_length), largest_force(arm)
        speed = min(0.05 * arm.total_length, 0.4 * half / (0.6 * self.duration))
        time = (0.4 * self.duration, 0.6 * self.duration)
        height, force = (HEIGHTS[0] * half, HEIGHTS[1] * half), (FORCES[0] * most, FORCES[1] * most)
        return [(d, d), time, (0.4 * speed, speed), (b, b), (e, e), height, force]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Raise `InvalidValue` unless the force is positive and all paths are within reach and joint limits."""
        check_force(ranges[6])
        away, around, up = self.wall.directions
        time, speed = ranges[1], ranges[2][1]
        # farthest ends of the paths from their middles, in eight directions along the wall
        far = speed * max(abs(time[1]), abs(self.duration - time[0]))
        turns = np.linspace(0.0, 2.0 * np.pi, 9)[:-1, None]
        ends = np.concatenate([np.zeros((1, 3)), far * (np.cos(turns) * around + np.sin(turns) * up)])
        middles = self.wall.distance * away + np.linspace(*ranges[5], 3)[:, None] * up
        places = (middles[:, None] + ends).reshape(-1, 3)
        wrong = beyond_reach(arm, places)
        if wrong is not None:
            limits = " and the joint limits" * bool(arm.joint_limits)
            at = ", ".join(f"{x:g}" for x in places[wrong])
            what = f"must keep the paths within reach{limits} at speeds up to {speed:g} m/s: ({at}) m is not"
            raise check.InvalidValue("reference.height", ranges[5], what)

    def first_posture(self, arm: Arm, gravity: Any) -> Array:
        """Return joint angles (N,), rad, at which the tip is in front of the wall.

        Joint angles at which the motors can hold the arm against gravity are preferred.
        """
        away, _, up = self.wall.directions
        height = 0.5 * sum(HEIGHTS) * self.wall.half_chord(arm.total_length)
        found = angles_at(arm, NEAR * (self.wall.distance * away + height * up), gravity)
        if found is None:
            what = f"must be a wall in front of which the tip of {arm.name!r} can start, within its joint limits"
            raise check.InvalidValue("contacts[0].obstacle", tuple(self.wall), what)
        return found

    def record(self, arm: Arm) -> type[Task]:
        """Return the class that contains the task's constants for an arm."""
        return SpacePress


Place.on_wall = OnWallInSpace


def _about_middle(pair: Pair, share: float) -> Pair:
    """Return a range with the same middle whose width is the given share of the range's width."""
    middle, half = 0.5 * (pair[0] + pair[1]), 0.5 * share * (pair[1] - pair[0])
    return middle - half, middle + half


def _as_text(place: Array) -> str:
    return "({:g}, {:g}, {:g}) m".format(*place)


def _entries(arm: Arm) -> list[tuple[str, float]]:
    """Return the name and scale of each entry of the observation, in the order of `tasks.space.space_observe`."""
    hub, length, joints = rate_scale(arm, 0), arm.total_length, arm.joint_names
    bending = [("tip_deflection_y", 0.1), ("tip_deflection_z", 0.1), ("tip_deflection_rate_y", 0.3 * hub)]
    bending += [("tip_deflection_rate_z", 0.3 * hub), ("twist", 0.1), ("twist_rate", 0.3 * hub)]
    named = [(arm.by_link(name), scale) for name, scale in bending]
    return [
        *((f"{joint}_{of}", 1.0) for joint in joints for of in ("sin", "cos")),
        *((f"{joint}_rate", rate_scale(arm, k)) for k, joint in enumerate(joints)),
        *((names[k], scale) for k, link in enumerate(arm.links) if not link.rigid for names, scale in named),
        *((f"tip_velocity_{axis}", hub * length) for axis in "xyz"),
        *((f"to_target_{axis}", 0.5 * length) for axis in "xyz"),
    ]


def _record(arm: Arm) -> type[Task]:
    return SpaceReach


def _starts(arm: Arm, rules: int) -> Starts:
    """Return the ranges of starts and targets: joint angles, rad, within the joint limits."""
    rest = 3.6 / arm.n_links
    return Starts(
        start=within(arm, [(-1.0, 1.0)] + [(-rest, rest)] * (arm.n_links - 1)),
        target=within(arm, [(-2.0 * math.pi / 3, 2.0 * math.pi / 3)] + [(-rest, rest)] * (arm.n_links - 1)),
        straight=at_zero(arm),
    )


SPACE = dataclasses.replace(
    REACH, id="SpatialFlexArm-v0", links=(1, None), arm="three_dof", duration=5.0, target=Place(), entries=_entries,
    record=_record, starts=_starts, replays="robot_arm_motion_smooth", axes=bodies.SPACE, period=0.01,
    sensors=lambda arm: Sensors(), gravity=(0.0, 0.0, -9.81), formulations=("geometrically_exact", "floating_frame"),
    conditions=ConditionsInSpace(), vibrate=swing, amplitudes=3,
    settings={"elements": 2, "dt": 0.0025, "tolerance": 1e-5},
)  # fmt: skip


def kind_for(arm: Arm) -> Kind:
    """Return the first definition of a task that fits an arm."""
    return next(kind for kind in (SLEW, REACH, CHAIN, SPACE) if kind.fits(arm))
