"""Options of `reset`, which are validated before the environment changes."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..batch import GUIDED, Batch
from .contacts import refuse_motion
from .events import unguided
from .motion import ANGLE, Guide, Prescribed, guide, prescribed
from .options import Plan
from .task import PRESS

KEYS = ("start", "target", "vibration", "motion", "interpolation", "force")

_FORCE = slice(8, 10)
"""Place of the commanded force's range, N, in the ranges of drawn paths of the task "press" (`pressing.OnWall`)."""


@dataclass(frozen=True)
class Request:
    """Options of one reset. A number that is NaN is replaced by a random number.

    angles (N,): initial joint angles, rad. target (2,): target angle (rad) and 0, or target point (m); in space (N,)
    joint angles at which the rigid arm reaches the target. vibration (1,): amplitude of the initial vibration, a tip
    deflection divided by the arm's length; in space (3,), one amplitude for each mode. motion: prescribed motion, or
    None. force: commanded normal force of the task "press", N.
    """

    angles: NDArray[np.float64]
    target: NDArray[np.float64]
    vibration: NDArray[np.float64]
    motion: Prescribed | None = None
    force: float = math.nan

    def copy(self) -> "Request":
        """Return the request with copies of its arrays."""
        return Request(self.angles.copy(), self.target.copy(), self.vibration.copy(), self.motion, self.force)

    @contextmanager
    def commanded(self, batch: Batch) -> Iterator[None]:
        """Context manager: new episodes of `batch` have the requested normal force in place of a random force.

        The request does not change any other random number.
        """
        if math.isnan(self.force):
            yield
            return
        reference = batch.extras.reference
        assert reference is not None
        # a range of one number, in memory that the compiled start reads
        usual = reference.ranges[_FORCE].copy()
        reference.ranges[_FORCE] = self.force
        try:
            yield
        finally:
            reference.ranges[_FORCE] = usual


def request_of(plan: Plan, options: Any) -> Request:
    """Validate the options of one reset; a ValueError names the key, the value and the rule."""
    n = plan.arm.n_links
    numbers, modes = plan.kind.target.request_size(plan.arm), plan.kind.amplitudes
    request = Request(np.full(n, np.nan), np.full(numbers, np.nan), np.full(modes, np.nan), plan.motion)
    if options is None:
        return request
    table = check.table_of("options", options)
    check.known_keys("options", table, KEYS, "option")
    given = {key: value for key, value in table.items() if value is not None}
    if "start" in given:
        request.angles[:] = _start(plan, given["start"])
    if "target" in given:
        request.target[:] = plan.kind.target.read(plan.arm, given["target"], plan.gravity)
        plan.kind.conditions.check_target(plan.arm, plan.record, request.angles, request.target)
    if "vibration" in given:
        request.vibration[:] = _vibration(given["vibration"], modes)
    if "force" in given:
        if plan.task != PRESS:
            raise check.InvalidValue("options.force", given["force"], f'must be given with task="{PRESS}" only')
        request = dataclasses.replace(request, force=check.number("options.force", given["force"], "N", above=0.0))
    if "motion" in given:
        request = dataclasses.replace(request, motion=prescribed(given["motion"], n, given.get("interpolation")))
    elif "interpolation" in given:
        raise check.InvalidValue("options.interpolation", given["interpolation"], "must be given with options.motion")
    if request.motion is not None:
        unguided(plan.extras, "options.motion", given.get("motion"))
        refuse_motion(plan.contacts, "options.motion", given.get("motion"))
    if "vibration" in given and request.motion is not None:
        raise check.InvalidValue("options.vibration", given["vibration"], "must not be given together with a motion")
    if "vibration" in given and request.vibration.any() and plan.starts.shake is None:
        what = "must be 0 in an environment without initial_vibration"
        raise check.InvalidValue("options.vibration", given["vibration"], what)
    if "target" in given and plan.task == "track":
        what = 'must not be given with task="track", where the reference says where the target is'
        raise check.InvalidValue("options.target", given["target"], what)
    return request


def _vibration(value: Any, modes: int) -> Any:
    """Read options['vibration']: each mode's amplitude, a tip deflection / arm's length, from -0.5 to 0.5."""
    unit, bound = "tip deflection over L", {"minimum": -0.5, "maximum": 0.5}
    if modes == 1:
        return check.number("options.vibration", value, unit, **bound)
    what = f"three numbers ({unit}) of the modes of bending along y, along z, of torsion"
    each = check.sequence("options.vibration", value, what, modes)
    return [check.number(f"options.vibration[{k}]", x, unit, **bound) for k, x in enumerate(each)]


def _start(plan: Plan, value: Any) -> list[float]:
    """Read options['start']: joint angles, rad, within the joint limits and the range that the solver can resolve."""
    n = plan.arm.n_links
    if n == 1 and not check.several(value):
        value = [value]
    entries = check.sequence("options.start", value, f"{n} angles (rad)", n)
    angles = [check.number(f"options.start[{k}]", v, "rad", **ANGLE) for k, v in enumerate(entries)]
    for k, angle in enumerate(angles):
        if not abs(angle) <= plan.farthest:
            what = f"must be within +-{plan.farthest:.3g} rad: the limit of double precision for so stiff an arm"
            raise check.InvalidValue(f"options.start[{k}]", angle, what)
    for k, limits in enumerate(plan.arm.joint_limits or ()):
        if limits is not None and not limits[0] <= angles[k] <= limits[1]:
            what = f"must be within the joint's limits, {limits[0]:g} to {limits[1]:g} rad"
            raise check.InvalidValue(f"options.start[{k}]", angles[k], what)
    return angles


def guide_of(plan: Plan, request: Request) -> Guide | None:
    """Create the `Guide` of an episode with prescribed motion; return None if no motion is prescribed."""
    if request.motion is None:
        return None
    if plan.arm.base is not None:
        raise check.InvalidValue("options.motion", "a motion", "must not be given on a base that floats")
    if plan.starts.laws:
        what = "must not be given in an environment that draws friction, backlash, motor_inertia or hub_inertia"
        raise check.InvalidValue("options.motion", "a motion", what)
    own = guide(plan, request.motion, request.angles)
    starts = own.starts().tolist()
    for k, angle in enumerate(request.angles.tolist()):
        if not math.isnan(angle) and abs(angle - starts[k]) > 1e-9:
            what = f"must be where the motion begins, {starts[k]:g} rad, or be left out"
            raise check.InvalidValue(f"options.start[{k}]", angle, what)
    request.angles[:] = starts
    if np.isnan(request.target[0]):
        request.target[:] = _end_of(plan, own)
    return own


def _end_of(plan: Plan, guided: Guide) -> Sequence[float]:
    """Return the target that the rigid arm reaches at the end of the motion; in space, the joint angles there, rad."""
    angles = []
    for name in (f"joint{k}" for k in range(plan.arm.n_links)):
        motion = guided.scene.motion_of(name)
        angles.append(guided.scene.initial_value(name) if motion is None else motion(guided.scene.duration))
    return plan.kind.target.requested(plan.arm, angles)


def start_episode(
    batch: Batch, i: int, key: int, plan: Plan, request: Request, guided: Guide | None, mode: int
) -> None:
    """Start an episode of arm i. guided: the `Guide` that simulates the arm under a prescribed motion, or None."""
    batch.ask(request.angles, request.target, request.vibration)
    if guided is None:
        with request.commanded(batch):
            batch.start((i,), (key,), limit=plan.limit, mode=mode)
        return
    limit = guided.limit if plan.max_steps is None else min(guided.limit, plan.max_steps)
    with request.commanded(batch):
        batch.start((i,), (key,), limit=limit, mode=GUIDED)
    guided.start(batch, i)
