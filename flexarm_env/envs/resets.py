"""Options of `reset`, checked before anything changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..batch import ACTION_NOT_FINITE, GUIDED, Batch
from .features import reach
from .motion import ANGLE, Guide, Prescribed, guide, prescribed
from .options import Plan

KEYS = ("start", "target", "vibration", "motion", "interpolation")


@dataclass(frozen=True)
class Wishes:
    """What a reset asks for. numbers (N + 3,): start angles, target (2), vibration; NaN where it is to be drawn."""

    numbers: NDArray[np.float64]
    motion: Prescribed | None = None


def wishes(plan: Plan, options: Any, extra: tuple[str, ...] = ()) -> Wishes:
    """Checked options of one reset. ValueError names the key, the value and what is allowed."""
    n = plan.kind.n_links
    numbers = np.full(n + 3, np.nan)
    if options is None:
        return Wishes(numbers, plan.motion)
    table = check.table_of("options", options)
    check.known_keys("options", table, (*KEYS, *extra), "option")
    if table.get("start") is not None:
        numbers[:n] = _start(plan, table["start"])
    if table.get("target") is not None:
        numbers[n : n + 2] = _target(plan, table["target"])
    if table.get("vibration") is not None:
        bound = {"minimum": -0.5, "maximum": 0.5}
        numbers[n + 2] = check.number("options.vibration", table["vibration"], "tip deflection over L", **bound)
    interpolation = table.get("interpolation")
    if interpolation is not None and table.get("motion") is None:
        raise check.InvalidValue("options.interpolation", interpolation, "must be given with options.motion")
    motion = plan.motion
    if table.get("motion") is not None:
        motion = prescribed(table["motion"], n, interpolation)
    if motion is not None and table.get("vibration") is not None:
        raise check.InvalidValue("options.vibration", table["vibration"], "must not be given together with a motion")
    if plan.task == "track" and table.get("target") is not None:
        what = 'must not be given with task="track", where the reference says where the target is'
        raise check.InvalidValue("options.target", table["target"], what)
    return Wishes(numbers, motion)


def _start(plan: Plan, value: Any) -> list[float]:
    n = plan.kind.n_links
    if n == 1 and np.ndim(value) == 0:
        value = [value]
    entries = check.sequence("options.start", value, f"{n} angles (rad)", n)
    angles = [check.number(f"options.start[{k}]", v, "rad", **ANGLE) for k, v in enumerate(entries)]
    for k, limits in enumerate(plan.arm.joint_limits or ()):
        if limits is not None and not limits[0] <= angles[k] <= limits[1]:
            what = f"must be within the joint's limits, {limits[0]:g} to {limits[1]:g} rad"
            raise check.InvalidValue(f"options.start[{k}]", angles[k], what)
    return angles


def _target(plan: Plan, value: Any) -> tuple[float, float]:
    if plan.kind.targets == 1:
        if np.ndim(value) == 1 and len(value) == 1:
            value = value[0]
        return check.number("options.target", value, "rad", **ANGLE), 0.0
    x, y = check.sequence("options.target", value, "two numbers (m), (x, y)", 2)
    x, y = check.number("options.target[0]", x, "m"), check.number("options.target[1]", y, "m")
    near, far = reach(plan.arm)
    if not near <= math.hypot(x, y) <= far:
        what = f"must be within reach, {near:g} to {far:g} m from the root"
        raise check.InvalidValue("options.target", (x, y), what)
    return x, y


def guide_of(plan: Plan, asked: Wishes) -> Guide | None:
    """The arm of an episode with prescribed motion; None for an ordinary episode."""
    if asked.motion is None:
        return None
    n = plan.kind.n_links
    own = guide(plan, asked.motion, asked.numbers[:n])
    poses, _, _ = own.report()
    starts = [float(poses[0, 2]), *(float(poses[k, 2] - poses[k - 1, 8]) for k in range(1, n))]
    for k, angle in enumerate(asked.numbers[:n].tolist()):
        if not math.isnan(angle) and abs(angle - starts[k]) > 1e-9:
            what = f"must be where the motion begins, {starts[k]:g} rad, or be left out"
            raise check.InvalidValue(f"options.start[{k}]", angle, what)
    asked.numbers[:n] = starts
    if math.isnan(asked.numbers[n]):
        asked.numbers[n : n + 2] = _end_of(plan, own)
    return own


def _end_of(plan: Plan, own: Guide) -> tuple[float, float]:
    """Where the motion leads the rigid arm: the polar angle of its tip (one link), or its tip."""
    angle, x, y = 0.0, 0.0, 0.0
    for k, link in enumerate(plan.arm.links):
        motion = own.scene.motion_of(f"joint{k}")
        angle += own.scene.initial_value(f"joint{k}") if motion is None else motion(own.scene.duration)
        x, y = x + link.length * math.cos(angle), y + link.length * math.sin(angle)
    return (angle, 0.0) if plan.kind.targets == 1 else (x, y)


def begin(batch: Batch, i: int, key: int, plan: Plan, asked: Wishes, own: Guide | None, mode: int) -> None:
    """Start arm i, in the batch or under its guide."""
    batch.wish[:] = asked.numbers
    if own is None:
        batch.begin((i,), (key,), limit=plan.limit, mode=mode)
        return
    limit = own.limit if plan.max_steps is None else min(own.limit, plan.max_steps)
    batch.begin((i,), (key,), limit=limit, mode=GUIDED)
    own.set_parameters(batch.parameters(i))
    poses, torques, energies = own.report()
    batch.witness(i, poses, torques, np.zeros(len(torques)), energies, -1, own.strains())


def follow(batch: Batch, i: int, own: Guide) -> None:
    """One control period of arm i under its guide, with the action that stands in the batch."""
    action = own.ignores(batch.action[i].astype(np.float64))
    if not np.isfinite(action).all():
        poses, torques, energies = own.report()
        batch.witness(i, poses, torques, action, energies, ACTION_NOT_FINITE, own.strains())
        return
    action = np.clip(action, -1.0, 1.0)
    status = own.advance(action * own.limits)
    poses, torques, energies = own.report()
    batch.witness(i, poses, torques, action, energies, status, own.strains())
