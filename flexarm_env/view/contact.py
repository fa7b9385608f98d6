"""Obstacles, contact forces and their charts in clips of episodes and simulations."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..scene import touching_points
from ..shapes import Shape
from ..validation import Array
from .clip import Chart, Pull


def obstacles_of(plan: Any) -> list[Shape]:
    """Return the shapes of an environment: shapes that the arm must avoid, and shapes that the arm can touch."""
    return [*plan.keep_out, *(contact.obstacle for contact in plan.contacts)]


def contact_pulls(plan: Any, views: Sequence[Any], tips: Sequence[int], shape: Array) -> list[Pull]:
    """Return the contact force on each point that can touch an obstacle, as a `Pull` on the clip's nearest point.

    views: `batch.View` of each instant. tips: for each link, the index of the clip's point at the link's tip. shape:
    positions (points, 2), in space (points, 3), of the clip's points at the first instant, m.
    """
    found, axes = [], shape.shape[1]
    for p, (k, fraction) in enumerate(touching_points(plan.contacts, plan.arm)):
        force = np.array([view.touches[p, 3 : 3 + axes] for view in views])
        if force.any():
            place, point = "tip" if k + 1 == plan.arm.n_links else f"joint {k + 1}", tips[k]
            if fraction < 1.0:
                place = f"link {k} at {fraction:g}"
                point = int(np.linalg.norm(shape - views[0].touches[p, :axes], axis=1).argmin())
            found.append(Pull(f"contact force, {place}", point, force))
    return found


def contact_charts(rows: Mapping[str, Array]) -> list[Chart]:
    """Return charts of contact forces (N) and penetration (mm) from `rows`, the entries of info by name."""
    if "contact_force" not in rows:
        return []
    forces = {"normal": rows["contact_force"], "friction": rows["contact_friction"]}
    return [
        Chart("contact: forces (N)", forces),
        Chart("contact: penetration (mm)", {"penetration": 1e3 * rows["contact_penetration"]}),
    ]
