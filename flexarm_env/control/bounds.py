"""Limits of planned motions (torques, joint angles, deflections, obstacles) as constraints of `ilqr`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .. import validation as check
from ..shapes import Shape
from ..validation import Array
from . import ilqr
from .dynamics import Dynamics

TOLERANCE = 2e-3
"""Largest accepted violation of a limit. Angles are in rad, and rates are divided by the arm's characteristic joint
rate (`rates_of`). Violations of deflections and of bands are divided by the bound."""


@dataclass(frozen=True)
class Bounds:
    """Limits of a planned motion.

    torque: largest torque divided by the torque limit, above 0 and at most 1. joints: pairs (low, high) of joint
    angles, rad, infinite for no limit; () if no joint has limits. deflection: limit of each link's tip deflection
    divided by its length; in space also the limit of the twist, rad. keep_out: shapes to which the arm's points
    (`Dynamics.points`) must keep a distance of at least `margin`, m.
    """

    torque: float = 1.0
    joints: Sequence[tuple[float, float]] | Array = ()
    deflection: float = np.inf
    keep_out: Sequence[Shape] = ()
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Validate all limits and store them as numbers and tuples."""
        torque = check.number("bounds.torque", self.torque, "share of the limits", above=0.0, maximum=1.0)
        check.store(self, torque=torque, deflection=_or_infinite("bounds.deflection", self.deflection, above=0.0))
        joints = self.joints.tolist() if isinstance(self.joints, np.ndarray) else self.joints
        pairs = []
        for k, pair in enumerate(check.sequence("bounds.joints", joints, "pairs (low, high), one per joint")):
            path = f"bounds.joints[{k}]"
            ends = check.sequence(path, pair, "two numbers (rad), (low, high)", 2)
            low, high = (_or_infinite(f"{path}[{i}]", end, "rad") for i, end in enumerate(ends))
            if low > high:
                raise check.InvalidValue(path, (low, high), "must be (low, high) with low at most high")
            pairs.append((low, high))
        shapes = check.sequence("bounds.keep_out", self.keep_out, "shapes (`flexarm_env.shapes`)")
        shapes = tuple(check.instance(f"bounds.keep_out[{k}]", one, Shape) for k, one in enumerate(shapes))
        check.store(self, joints=tuple(pairs), keep_out=shapes)
        check.store(self, margin=check.number("bounds.margin", self.margin, "m", minimum=0.0))


def _or_infinite(path: str, value: object, unit: str = "", **bounds: float) -> float:
    """Validate a number with `check.number`; infinity, which means no bound, is accepted too."""
    if isinstance(value, float) and np.isinf(value) and (value > 0.0 or not bounds):
        return float(value)
    return check.number(path, value, unit, **bounds)


def within(plant: Dynamics, bounds: Bounds, n: int, total: int, stiff: float = 1.0) -> list[ilqr.Limits]:
    """Return the constraints of `bounds` on joint angles, deflections and distances for n arms over `total` periods.

    Distances are measured from the shapes of `keep_out` and divided by the arm's length. Deflections are divided by
    their bound. stiff: factor on the initial penalty weights.
    """
    found = []
    count = plant.n_inputs
    if bounds.joints:
        check.sequence("bounds.joints", bounds.joints, f"{count} pairs (low, high), one per joint", count)
        low, high = np.array(bounds.joints, np.float64).T
        slope = np.zeros((count, plant.size))
        slope[np.arange(count), plant.joints] = 1.0

        # joint angles, rad
        def angles(x: Array) -> tuple[Array, Array]:
            return x[..., plant.joints], np.broadcast_to(slope, (*x.shape[:-1], *slope.shape))

        found.append(_throughout(angles, low, high, n, total, stiff * 100.0))
    if np.isfinite(bounds.deflection):
        # deflections over their bound
        def shares(x: Array) -> tuple[Array, Array]:
            bend, slope = plant.bends(x)
            return bend / bounds.deflection, slope / bounds.deflection

        many = np.ones(plant.bends(np.zeros(plant.size))[0].shape)
        found.append(_throughout(shares, -many, many, n, total, stiff))
    if bounds.keep_out:
        length = plant.arm.total_length

        # distances minus margin, divided by the arm's length; positive outside
        def distances(x: Array) -> Array:
            places = plant.places(x)
            far = [shape.distance(places) for shape in bounds.keep_out]
            return np.asarray(np.concatenate(far, axis=-1) - bounds.margin) / length

        def approach(x: Array) -> tuple[Array, Array]:
            points, slope = plant.points(x)
            ways = [np.einsum("...d,...ds->...s", shape.gradient(points), slope) for shape in bounds.keep_out]
            return distances(x), np.concatenate(ways, axis=-2) / length

        low = np.zeros(distances(np.zeros(plant.size)).shape)
        found.append(_throughout(approach, low, low + np.inf, n, total, stiff * 1e4, distances))
    return found


def _throughout(
    of: Callable[[Array], tuple[Array, Array]], low: Array, high: Array, n: int, total: int, penalty: float,
    alone: Callable[[Array], Array] | None = None,
) -> ilqr.Limits:  # fmt: skip
    """Limit the function `of` (see `ilqr.Limits`) to the range from low to high at all stages of n arms."""
    shape = (total + 1, n, len(low))
    return ilqr.Limits(of, np.broadcast_to(low, shape), np.broadcast_to(high, shape), np.full(n, penalty), alone)


def kept_by(plant: Dynamics, bounds: Bounds | None, **states: Array) -> Bounds:
    """Return the validated bounds (None: no bounds); raise InvalidValue if one of the states (n, S) violates them."""
    own = check.instance("bounds", Bounds() if bounds is None else bounds, Bounds)
    for what, x in states.items():
        for one in within(plant, own, len(x), 0):
            outside = np.flatnonzero(one.violation(x[None]) > TOLERANCE)
            if outside.size:
                arm = int(outside[0])
                angles, bends = x[arm, plant.joints].round(6).tolist(), plant.bends(x[arm])[0].round(6).tolist()
                path = f"joint angles and deflections of {what}[{arm}]"
                raise check.InvalidValue(path, (angles, bends), f"must be within {own}")
    return own
