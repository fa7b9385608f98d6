"""From a batch to a picture: where the points are that `rendering.Renderer` draws."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..batch import View
from .options import Plan
from .rendering import Renderer


def renderer(plan: Plan, mode: str) -> Renderer:
    """A Renderer that fits an environment."""
    return Renderer(mode, plan.arm.total_length, fps=1.0 / plan.period, payload=plan.arm.payload.mass > 0.0)


def draw(pen: Renderer, plan: Plan, view: View) -> Any:
    """A picture of an arm as it is now."""
    target = view.target
    if len(target) == 1:
        length = plan.arm.total_length
        target = np.array([length * math.cos(target[0]), length * math.sin(target[0])])
    limits = np.array(plan.arm.torque_limits)
    shapes = chain(view.points, view.poses)
    return pen.frame(shapes, view.poses, target, view.time, view.torques / limits, view.deflection)


def chain(points: NDArray[np.float64], poses: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Points from root to tip of the whole arm divided into its links, at the points nearest to the hinges."""
    cuts = [0]
    for pose in poses[1:]:
        distance = np.hypot(*(points[cuts[-1] + 1 : -1] - pose[:2]).T)
        cuts.append(cuts[-1] + 1 + int(distance.argmin()))
    cuts.append(len(points) - 1)
    return [points[a : b + 1] for a, b in pairwise(cuts)]
