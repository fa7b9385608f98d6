"""What environments in space take; their task as data."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from .. import validation as check
from ..batch import SpaceReach, Starts, Task
from ..control.space import angles_at, beyond_reach, tip_at
from ..parameters import Arm
from ..rigid import rate_scale
from ..time_functions import TimeFunction
from ..validation import Array
from .targets import POINT, Pair, Target, coordinates
from .task import REACH, Kind, at_zero, within


def check_arm(arm: Arm, kind: Kind) -> None:
    """ValueError for an arm of the plane."""
    if not arm.spatial:
        what = f"must leave the x-y plane for {kind.id}; FlexibleArm-v0 and MultiLinkFlexArm-v0 have arms of the plane"
        raise check.InvalidValue("arm", arm.name, what)


class Place(Target):
    """A place of the tip in space, (x, y, z) in m. Asked for by joint angles of the rigid arm there."""

    numbers = 3
    paths: ClassVar = {name: (*entries, ("elevation", "rad")) for name, entries in POINT.paths.items()}

    def read(self, arm: Arm, value: Any) -> Any:
        point = check.numbers("options.target", value, "three numbers (m), (x, y, z)", 3, "m")
        angles = angles_at(arm, np.array(point))
        if angles is None:
            raise check.InvalidValue("options.target", point, "must be a point that the rigid arm's tip reaches")
        return angles

    def reached(self, arm: Arm, angles: Sequence[float]) -> Any:
        return tuple(tip_at(arm, np.array(angles)).tolist())

    def place(self, arm: Arm, target: Array) -> Array:
        return target

    def entries(self, arm: Arm) -> list[tuple[str, float]]:
        return POINT.entries(arm, "xyz")

    def ranges(self, arm: Arm, path: str) -> list[Pair]:
        _, *others, bearing = POINT.ranges(arm, path)
        far = arm.total_length
        if path == "circle":
            others[-1] = (0.05 * far, 0.15 * far)
        return [(0.45 * far, 0.65 * far), *others, bearing, (math.pi / 6, math.pi / 3)]

    def check_ranges(self, ranges: list[Pair], arm: Arm, path: str) -> None:
        """Circles keep within reach, and so does the point of a line that is nearest to the root; looked at are points
        all around the middles and ends of the ranges."""
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
            what = f"must keep the path, or a line's nearest point, within reach: {_said(places[wrong])} is not"
            raise check.InvalidValue("reference.distance", distance, what)

    def path(self, given: Any, arm: Arm, t: Array) -> list[TimeFunction]:
        all_three = coordinates(given, "three functions of time, x, y and z (m), or a table (n, 4): t, x, y, z", 3)
        places = np.stack([f(t) for f in all_three], axis=1)
        wrong = beyond_reach(arm, places)
        if wrong is not None:
            raise ValueError(f"reference = {_said(places[wrong])} at {t[wrong]:g} s: must be a point within reach")
        return all_three


def _said(place: Array) -> str:
    return "({:g}, {:g}, {:g}) m".format(*place)


def _entries(arm: Arm) -> list[tuple[str, float]]:
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


def _starts(arm: Arm) -> Starts:
    rest = 3.6 / arm.n_links
    return Starts(
        start=within(arm, [(-1.0, 1.0)] + [(-rest, rest)] * (arm.n_links - 1)),
        target=within(arm, [(-2.0 * math.pi / 3, 2.0 * math.pi / 3)] + [(-rest, rest)] * (arm.n_links - 1)),
        straight=at_zero(arm),
    )


SPACE = dataclasses.replace(
    REACH, id="SpatialFlexArm-v0", links=(1, None), arm="three_dof", duration=5.0, target=Place(), entries=_entries,
    record=_record, starts=_starts, replays="robot_arm_motion_smooth", space=True, period=0.01,
    gravity=(0.0, 0.0, -9.81), settings={"elements": 2, "dt": 0.0025, "tolerance": 1e-5},
)  # fmt: skip
