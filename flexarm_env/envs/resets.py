"""Options of `reset`, checked before anything changes."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..batch import ACTION_NOT_FINITE, FURTHER, GUIDED, Batch
from .events import unguided
from .motion import ANGLE, Guide, Prescribed, guide, prescribed
from .options import Plan

KEYS = ("start", "target", "vibration", "motion", "interpolation")


@dataclass(frozen=True)
class Request:
    """What a reset asks for; NaN where it is to be drawn.

    angles (N,): at the start, rad. target (2,): as in the record; in space (N,): joint angles that reach it.
    vibration (1,): over L; in space (3,): of each mode. motion: prescribed.
    """

    angles: NDArray[np.float64]
    target: NDArray[np.float64]
    vibration: NDArray[np.float64]
    motion: Prescribed | None = None


def request_of(plan: Plan, options: Any) -> Request:
    """Checked options of one reset. ValueError names the key, the value and what is allowed."""
    n = plan.arm.n_links
    numbers = n if plan.kind.space else 2
    modes = 3 if plan.kind.space else 1
    asked = Request(np.full(n, np.nan), np.full(numbers, np.nan), np.full(modes, np.nan), plan.motion)
    if options is None:
        return asked
    table = check.table_of("options", options)
    check.known_keys("options", table, KEYS, "option")
    given = {key: value for key, value in table.items() if value is not None}
    if "start" in given:
        asked.angles[:] = _start(plan, given["start"])
    if "target" in given:
        asked.target[:] = plan.kind.target.read(plan.arm, given["target"])
    if "vibration" in given:
        asked.vibration[:] = _vibration(given["vibration"], modes)
    if "motion" in given:
        asked = dataclasses.replace(asked, motion=prescribed(given["motion"], n, given.get("interpolation")))
    elif "interpolation" in given:
        raise check.InvalidValue("options.interpolation", given["interpolation"], "must be given with options.motion")
    if asked.motion is not None:
        unguided(plan.extras, "options.motion", given.get("motion"))
    if "vibration" in given and asked.motion is not None:
        raise check.InvalidValue("options.vibration", given["vibration"], "must not be given together with a motion")
    if "vibration" in given and asked.vibration.any() and plan.starts.shake is None:
        what = "must be 0 in an environment without initial_vibration"
        raise check.InvalidValue("options.vibration", given["vibration"], what)
    if "target" in given and plan.task == "track":
        what = 'must not be given with task="track", where the reference says where the target is'
        raise check.InvalidValue("options.target", given["target"], what)
    return asked


def _vibration(value: Any, modes: int) -> Any:
    unit, bound = "tip deflection over L", {"minimum": -0.5, "maximum": 0.5}
    if modes == 1:
        return check.number("options.vibration", value, unit, **bound)
    what = f"three numbers ({unit}) of the modes of bending along y, along z, of torsion"
    each = check.sequence("options.vibration", value, what, modes)
    return [check.number(f"options.vibration[{k}]", x, unit, **bound) for k, x in enumerate(each)]


def _start(plan: Plan, value: Any) -> list[float]:
    n = plan.arm.n_links
    if n == 1 and not check.several(value):
        value = [value]
    entries = check.sequence("options.start", value, f"{n} angles (rad)", n)
    angles = [check.number(f"options.start[{k}]", v, "rad", **ANGLE) for k, v in enumerate(entries)]
    for k, angle in enumerate(angles):
        if not abs(angle) <= plan.farthest:
            what = f"must be within +-{plan.farthest:.3g} rad: double precision carries so stiff an arm no further"
            raise check.InvalidValue(f"options.start[{k}]", angle, what)
    for k, limits in enumerate(plan.arm.joint_limits or ()):
        if limits is not None and not limits[0] <= angles[k] <= limits[1]:
            what = f"must be within the joint's limits, {limits[0]:g} to {limits[1]:g} rad"
            raise check.InvalidValue(f"options.start[{k}]", angles[k], what)
    return angles


def guide_of(plan: Plan, asked: Request) -> Guide | None:
    """The arm of an episode with prescribed motion; None for an ordinary episode."""
    if asked.motion is None:
        return None
    if plan.arm.base is not None:
        raise check.InvalidValue("options.motion", "a motion", "must not be given on a base that floats")
    if plan.starts.laws:
        what = "must not be given in an environment that draws friction, backlash, motor_inertia or hub_inertia"
        raise check.InvalidValue("options.motion", "a motion", what)
    own = guide(plan, asked.motion, asked.angles)
    starts = own.starts().tolist()
    for k, angle in enumerate(asked.angles.tolist()):
        if not math.isnan(angle) and abs(angle - starts[k]) > 1e-9:
            what = f"must be where the motion begins, {starts[k]:g} rad, or be left out"
            raise check.InvalidValue(f"options.start[{k}]", angle, what)
    asked.angles[:] = starts
    if np.isnan(asked.target[0]):
        asked.target[:] = _end_of(plan, own)
    return own


def _end_of(plan: Plan, own: Guide) -> Sequence[float]:
    """The target that the rigid arm reaches where the motion ends; in space its joint angles."""
    angles = []
    for name in (f"joint{k}" for k in range(plan.arm.n_links)):
        motion = own.scene.motion_of(name)
        angles.append(own.scene.initial_value(name) if motion is None else motion(own.scene.duration))
    return angles if plan.kind.space else plan.kind.target.reached(plan.arm, angles)


def start_episode(batch: Batch, i: int, key: int, plan: Plan, asked: Request, own: Guide | None, mode: int) -> None:
    """Start an episode of arm i, in the batch or under its guide."""
    batch.ask(asked.angles, asked.target, asked.vibration)
    if own is None:
        batch.start((i,), (key,), limit=plan.limit, mode=mode)
        return
    limit = own.limit if plan.max_steps is None else min(own.limit, plan.max_steps)
    batch.start((i,), (key,), limit=limit, mode=GUIDED)
    own.set_parameters(batch.parameters(i))
    batch.take_report(i, -1, np.zeros(len(own.free)), own.report())


def follow(batch: Batch, i: int, own: Guide) -> None:
    """One control period of arm i under its guide, with the action that stands in the batch."""
    action = np.where(own.free, batch.action[i].astype(np.float64), 0.0)
    if not np.isfinite(action).all():
        batch.take_report(i, ACTION_NOT_FINITE, action, own.report())
        return
    action = np.clip(action, -1.0, 1.0)
    own.simulation.step_error = 0.0
    status = own.advance(action * own.limits)
    batch.take_report(i, status, action, own.report())
    if batch.settings.step_tolerance is not None:
        batch.table[batch.info_at.further + FURTHER.step_error, i] = own.simulation.step_error
