"""Contents of a player: points of the arm over time, forces and torques, charts, and enlarged deflections."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import validation as check
from ..validation import Array


@dataclass(frozen=True)
class Pull:
    """Force or torque on a point of the arm over time.

    name: name in the legend. point: index of the point of the arm on which the force or torque acts. values: torques
    (n,), N m, or forces (n, 2), in space (n, 3), N. limit: torque that is drawn at full size, N m. If limit is None or
    too small, the largest torque is drawn at full size. axis (n, 3): axis of a torque in space.
    """

    name: str
    point: int
    values: Array
    limit: float | None = None
    axis: Array | None = None


@dataclass(frozen=True)
class Chart:
    """Chart with one or more curves over time.

    title: title of the chart, with unit. series: values (n,) of each curve by its name.
    """

    title: str
    series: Mapping[str, Array]


@dataclass(frozen=True)
class Clip:
    """Data of a simulated run for the player, at n instants, for N links and P points of the arm, in SI units.

    Attributes:
        label: name of the run in the player. note: one line of text with the formulation and the status of the run.
        t (n,): instants, s. points (n, P, 2): points of the arm from root to tip, m. cuts (N + 1,): indices of the
            points at root, joints and tip.
        angles (n, N, 2): angles of the tangents at each link's root and tip, rad.
        rigid (n, N): angles of the links' roots in the rigid arm at the run's joint angles, rad (`rigid_angles`).
        rest (P, 2): points of the stress-free links, m, in axes at each link's root with x along the tangent.
            curvature (n, P): curvature at the points, 1/m. In `rest` and `curvature` a joint belongs to the link that
            ends at this joint.
        surface: distance from the neutral axis to the surface, m, from which surface strains are computed; None if the
            distance is unknown or varies.
        target (n, 2): position of the target, m, or None. polar: True if the target is an angle, so that the distance
            from tip to target is undefined.
        pulls: forces and torques on the arm. charts: charts in the order of display.
        pinned: True if the root is pinned. payload: True if the tip carries a payload. walls: outlines of obstacles.
        base (n,): attitude of the floating base, rad, or None.
    """

    label: str
    note: str
    t: Array
    points: Array
    cuts: tuple[int, ...]
    angles: Array
    rigid: Array
    rest: Array
    curvature: Array
    surface: float | None = None
    target: Array | None = None
    polar: bool = False
    pulls: Sequence[Pull] = ()
    charts: Sequence[Chart] = ()
    pinned: bool = True
    payload: bool = False
    walls: Sequence[Array] = ()
    base: Array | None = None
    skipped: int = field(default=1)  # the clip keeps one of this many instants

    def every(self, step: int) -> Clip:
        """Return the clip with every `step`-th instant and the last one."""
        optional = (name for name in ("target", "base") if getattr(self, name) is not None)
        names = ("t", "points", "angles", "rigid", "curvature", *optional)
        thin: Clip = thinner(self, names, step)
        return thin

    def own_entries(self) -> dict[str, Any]:
        """Return the entries of the player's data that exist only for planar clips."""
        return {
            **{name: packed("f4", getattr(self, name)) for name in ("angles", "rest")},
            "surface": self.surface,
            "polar": self.polar,
            "curvature": short(self.curvature),
            **({} if self.base is None else {"base": packed("f4", self.base)}),
            **({"walls": [packed("f4", wall) for wall in self.walls]} if self.walls else {}),
        }


def packed(kind: str, values: NDArray[Any]) -> dict[str, Any]:
    """Pack an array for the page. kind: NumPy's name of the type without byte order, such as "f4"."""
    data = np.ascontiguousarray(values, dtype=f"<{kind}")
    return {"kind": kind, "shape": list(data.shape), "data": base64.b64encode(data.tobytes()).decode()}


def short(values: Array) -> dict[str, Any]:
    """Pack values as 16-bit integers between their minimum and maximum.

    The value 0 is represented exactly if 0 is between the minimum and the maximum. The integer -32768 represents NaN.
    """
    good = np.isfinite(values)
    low, high = (float(np.min(values[good])), float(np.max(values[good]))) if good.any() else (0.0, 0.0)
    step = (high - low) / 65533.0 or 1.0
    low = step * np.floor(low / step) if low < 0.0 < high else low
    whole = np.round((np.where(good, values, low) - low) / step) - 32767.0
    return packed("i2", np.where(good, whole, -32768.0)) | {"low": low, "step": step}


def thinner(clip: Any, names: Sequence[str], step: int) -> Any:
    """Return a clip with every `step`-th instant and the last one; names: names of the clip's arrays over time."""
    if step <= 1:
        return clip
    i = np.unique(np.append(np.arange(0, len(clip.t), step), len(clip.t) - 1))
    fields: dict[str, Any] = {name: getattr(clip, name)[i] for name in names}
    pulls = [replace(p, values=p.values[i], axis=None if p.axis is None else p.axis[i]) for p in clip.pulls]
    charts = [Chart(c.title, {name: x[i] for name, x in c.series.items()}) for c in clip.charts]
    return replace(clip, **fields, pulls=pulls, charts=charts, skipped=step * clip.skipped)


def rigid_angles(joints: ArrayLike, turns: ArrayLike) -> Array:
    """Return the absolute angles (..., N), rad, of the tangents at the links' roots in the rigid arm.

    joints (..., N): joint angles, rad; joint 0 is measured from the x axis, joint k from the tip of link k - 1. turns
    (N,): angle, rad, between the tangents at root and tip of each stress-free link; 0 for straight links.
    """
    before = np.concatenate([[0.0], np.cumsum(turns)[:-1]])
    return np.asarray(np.cumsum(joints, axis=-1) + before)


def magnified(
    points: ArrayLike, cuts: Sequence[int], angles: ArrayLike, rigid: ArrayLike, rest: ArrayLike, factor: float
) -> Array:
    """Return the points of the arm with its deflection multiplied by a factor.

    The factor multiplies two quantities of each link: the deflection from the tangent at its root, and the bending
    angle between root and tip, by which the following links turn. The root, the joint angles, and coordinates along the
    tangents do not change.

    Args:
        points (P, 2): points of the arm from root to tip, m. cuts (N + 1,): indices of the points at root, joints and
            tip. angles (N, 2): angles of the tangents at each link's root and tip, rad. rigid (N,), rest (P, 2): as in
            `Clip`, at one instant. factor: positive factor on the deflection.
    Returns:
        The points (P, 2), m.
    """
    factor = check.number("factor", factor, above=0.0)
    given, tangents, rigid = np.asarray(points, float), np.asarray(angles, float), np.asarray(rigid, float)
    out, bow = given.copy(), np.asarray(rest, float)[:, 1]
    at = given[cuts[0]]
    for k, (a, b) in enumerate(pairwise(cuts)):
        offset, (c, s) = given[a : b + 1] - given[a], (np.cos(tangents[k, 0]), np.sin(tangents[k, 0]))
        along, across = c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]
        own = np.concatenate([[0.0], bow[a + 1 : b + 1]])
        across = own + factor * (across - own)
        turned = rigid[k] + factor * (tangents[k, 0] - rigid[k])
        c, s = np.cos(turned), np.sin(turned)
        out[a : b + 1] = at + np.column_stack([c * along - s * across, s * along + c * across])
        at = out[b]
    return out
