"""Kernels for moving targets: position, velocity, and the future targets that the observation contains."""

from ..compiler import Lanes, kernel, lane_count, size, stack
from ..physics.arithmetic import clip
from .attainable import MOST_DRAWS, draw_attainable
from .program import CLIP, GOAL, MODE, MOVING, PATH_AT, PERIODS, RUNNING, TARGET, TARGET_RATE
from .task import path_at, pursue, turn_in

_MOVING = MOVING.places
_ONE, _PLACE, _PATH = (0,), (0,) * _MOVING.end, (0,) * (GOAL - PATH_AT)
_RECORD = (0,) * GOAL


@kernel
def _on_path(reference, task, record, lanes, i, t, k, out):
    """Write position and velocity of arm i's target at time t (s), the end of period k, into the `MOVING` out.

    A target comes from reference.table (position and rate at each control instant; after the last row it rests) or from
    the path in the arm's record. lanes: number of arms in the group that contains arm i. record: records of the group's
    arms, one arm per lane.
    """
    targets = size(task.targets)
    if reference.table.shape[0] > 0:
        # table: targets x, then their rates v, a row per period; its last row lasts
        rows = reference.table.shape[0] // (2 * targets)
        row = min(k, rows - 1) * 2 * targets
        for d in range(targets):
            out[_MOVING.x + d], out[_MOVING.vx + d] = reference.table[row + d], reference.table[row + targets + d]
        return
    # drawn path: the PATH of this arm, copied from its lane because `path_at` has none
    path = stack(_ONE, _PATH)
    for j in range(GOAL - PATH_AT):
        path[j] = record[(PATH_AT + j) * lanes + i]
    path_at(task, path, t, out)


@kernel
def _set_target(reference, task, record, lanes, i, t, k, out):
    """Write position and velocity of arm i's target at t (s), the end of period k, into out and the record.

    lanes: number of arms in the group that contains arm i. out: a `MOVING` record. record.target, record.target_rate:
    target (m or rad) and its rate, inertial axes, written.
    """
    _on_path(reference, task, record, lanes, i, t, k, out)
    for d in range(size(task.targets)):
        record[(TARGET + d) * lanes + i] = out[_MOVING.x + d]
        record[(TARGET_RATE + d) * lanes + i] = out[_MOVING.vx + d]


@kernel
def move_targets(lane, reference, task, period, record):
    """Move the targets of running arms to the end of the period, and update the joint angles that reach them.

    reference: a `Reference`; None if targets rest (no-op). period: control period, s. record (fields by lanes): mode
    and number of completed periods are read; target, target_rate and goal are written.
    """
    if reference is not None:
        for i in range(lane_count(lane)):
            if record[MODE * len(lane) + i] == RUNNING:
                _move_target(len(lane), reference, task, period, record, i)


@kernel
def _move_target(lanes, reference, task, period, record, i):
    """Move arm i's target to the end of its control period (s) and update its goal angles (rad) by `pursue`.

    lanes: number of arms in the group that contains arm i. record (fields by lanes): number of completed periods is
    read; target, target_rate and goal are read and written.
    """
    out, mine = stack(_ONE, _PLACE), stack(_ONE, task.links + _RECORD)
    k = record[PERIODS * lanes + i] + 1.0
    _set_target(reference, task, record, lanes, i, k * period, int(k), out)
    # `pursue` is compiled for one arm: its record without lanes
    for j in range(GOAL, GOAL + size(task.links)):
        mine[j] = record[j * lanes + i]
    for d in range(max(2, size(task.targets))):
        mine[TARGET + d] = out[_MOVING.x + d]
    pursue(task, mine)
    for j in range(GOAL, GOAL + size(task.links)):
        record[j * lanes + i] = mine[j]


@kernel
def look_ahead(lane, reference, task, period, first, poses, record, seen):
    """Write the observation's entries for a moving target: the target's rate, then its displacement at each time ahead.

    Points and rates are in the axes of link 0's root, divided by their scales, and clipped to +-10. first: whether this
    is the observation of a reset, before any completed period. period: control period, s. poses: positions, angles and
    rates of the links, inertial axes. Do nothing if targets rest (reference is None).
    # in        record: periods done, target, path
    # out       seen (entries, lanes), entries that follow the task's
    """
    list_ahead(lane, reference, task, period, first, record, seen)
    turn_ahead(lane, reference, task, poses, seen)


@kernel
def list_ahead(lane, reference, task, period, first, record, seen: Lanes):
    """Write the entries of `look_ahead` (m or rad, and their rates) in inertial axes, without division by scales."""
    if reference is not None:
        for k in range(reference.scales.shape[0]):
            seen[size(task.entries) + k] = 0.0
        for i in range(lane_count(lane)):
            _look_ahead(len(lane), reference, task, period, first, record, seen, i)


@kernel
def turn_ahead(lane, reference, task, poses, seen: Lanes):
    """Turn entries of `list_ahead` from inertial axes into the axes of link 0's root; scale and clip the entries."""
    if reference is not None:
        at = size(task.entries)
        turn_in(lane, task, poses, seen, at, at + reference.scales.shape[0])
        for k in range(reference.scales.shape[0]):
            seen[at + k] = clip(seen[at + k] / reference.scales[k], CLIP)


@kernel
def _look_ahead(lanes, reference, task, period, first, record, seen, i):
    """Write arm i's target rate and future displacements (m or rad) into seen, in inertial axes and not scaled.

    reference.ahead: times ahead, in control periods (period: s). Displacements count from the target at the end of the
    current period, or at time 0 for a reset (first). lanes: number of arms in the group that contains arm i.
    """
    targets, at = size(task.targets), size(task.entries)
    out, rows = stack(_ONE, _PLACE), reference.ahead.shape[0]
    k = record[PERIODS * lanes + i] + (0.0 if first else 1.0)
    for row in range(rows + 1):
        # row 0: v of the target now; later rows: x at instants ahead less x now
        step = k if row == 0 else k + reference.ahead[row - 1]
        _on_path(reference, task, record, lanes, i, step * period, int(step), out)
        for d in range(targets):
            way = out[_MOVING.x + d] - record[(TARGET + d) * lanes + i]
            seen[(at + row * targets + d) * lanes + i] = out[_MOVING.vx + d] if row == 0 else way


@kernel
def start_path(reference, task, stream, arm, record, lanes):
    """Draw a path for an arm at the start of its episode and put its target at the path's start.

    The number of draws from `stream` depends on the kind of path, and paths that the arm cannot follow are drawn again.
    reference.line: not None if straight lines are drawn. arm: index in the batch; lanes: number of arms in a group.
    # in        record.goal, joint angles (rad) from which the arm's posture follows the path
    # in, out   stream[arm]
    # out       record: path, target and its rate
    """
    i = arm % lanes
    path, out, angles = stack(_ONE, _PATH), stack(_ONE, _PLACE), stack(_ONE, task.links)
    for k in range(size(task.links)):
        angles[k] = record[(GOAL + k) * lanes + i]
    draw_attainable(reference, task, stream, arm, angles, path, MOST_DRAWS)
    # the drawn numbers go to the record, because each period recomputes the target from t
    for k in range(len(_PATH)):
        record[(PATH_AT + k) * lanes + i] = path[k]
    _set_target(reference, task, record, lanes, i, 0.0, 0, out)
