"""Options of `reset`, checked before anything changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from .options import Plan

KEYS = ("start", "target", "vibration", "motion", "interpolation")


@dataclass(frozen=True)
class Wishes:
    """What a reset asks for. numbers (N + 3,): start angles, target (2), vibration; NaN where it is to be drawn."""

    numbers: NDArray[np.float64]
    motion: Any = None


def wishes(plan: Plan, options: Any, extra: tuple[str, ...] = ()) -> Wishes:
    """Checked options of one reset. ValueError names the key, the value and what is allowed."""
    n = plan.kind.n_links
    numbers = np.full(n + 3, np.nan)
    if options is None:
        return Wishes(numbers)
    table = check.table_of("options", options)
    check.known_keys("options", table, (*KEYS, *extra), "option")
    if table.get("start") is not None:
        numbers[:n] = _start(plan, table["start"])
    if table.get("target") is not None:
        numbers[n : n + 2] = _target(plan, table["target"])
    if table.get("vibration") is not None:
        bound = {"minimum": -0.5, "maximum": 0.5}
        numbers[n + 2] = check.number("options.vibration", table["vibration"], "tip deflection over L", **bound)
    return Wishes(numbers, table.get("motion"))


def _start(plan: Plan, value: Any) -> list[float]:
    n = plan.kind.n_links
    if n == 1 and np.ndim(value) == 0:
        value = [value]
    entries = check.sequence("options.start", value, f"{n} angles (rad)", n)
    angles = [check.number(f"options.start[{k}]", v, "rad") for k, v in enumerate(entries)]
    for k, limits in enumerate(plan.arm.joint_limits or ()):
        if limits is not None and not limits[0] <= angles[k] <= limits[1]:
            what = f"must be within the joint's limits, {limits[0]:g} to {limits[1]:g} rad"
            raise check.InvalidValue(f"options.start[{k}]", angles[k], what)
    return angles


def _target(plan: Plan, value: Any) -> tuple[float, float]:
    if plan.kind.targets == 1:
        if np.ndim(value) == 1 and len(value) == 1:
            value = value[0]
        return check.number("options.target", value, "rad"), 0.0
    x, y = check.sequence("options.target", value, "two numbers (m), (x, y)", 2)
    x, y = check.number("options.target[0]", x, "m"), check.number("options.target[1]", y, "m")
    far = plan.arm.total_length
    lengths = [link.length for link in plan.arm.links]
    near = max(0.0, 2.0 * max(lengths) - sum(lengths))
    if not near <= math.hypot(x, y) <= far:
        what = f"must be within reach, {near:g} to {far:g} m from the root"
        raise check.InvalidValue("options.target", (x, y), what)
    return x, y
