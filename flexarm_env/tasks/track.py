"""Moving targets: where they are, how fast they move, and what the observation sees of what comes."""

from ..compiler import arms, kernel, load, size, splat, stack, store
from ..physics.arithmetic import clip
from .program import CLIP, GOAL, MODE, MOVING, PATH_AT, PERIODS, RUNNING, TARGET, TARGET_RATE
from .stream import draw
from .task import draw_line, draw_path, path_at, pursue, turn_in

_MOVING = MOVING.places
_ONE, _PLACE, _DRAWN, _PATH = (0,), (0,) * _MOVING.end, (0,) * 5, (0,) * (GOAL - PATH_AT)
_RECORD = (0,) * GOAL


@kernel
def _on_path(reference, task, record, lanes, i, t, k, out):
    """out <- a `MOVING`, for arm i's path at t (s), which is control instant k."""
    targets = size(task.targets)
    if reference.table.shape[0] > 0:
        rows = reference.table.shape[0] // (2 * targets)
        row = min(k, rows - 1) * 2 * targets
        for d in range(targets):
            out[_MOVING.x + d], out[_MOVING.vx + d] = reference.table[row + d], reference.table[row + targets + d]
        return
    path = stack(_ONE, _PATH)
    for j in range(GOAL - PATH_AT):
        path[j] = record[(PATH_AT + j) * lanes + i]
    path_at(task, path, t, out)


@kernel
def _set_target(reference, task, record, lanes, i, t, k, out):
    """`_on_path`, into the record too."""
    _on_path(reference, task, record, lanes, i, t, k, out)
    for d in range(size(task.targets)):
        record[(TARGET + d) * lanes + i] = out[_MOVING.x + d]
        record[(TARGET_RATE + d) * lanes + i] = out[_MOVING.vx + d]


@kernel
def move_targets(lane, reference, task, period, record):
    """Targets of running arms at the end of the period, and the joint angles that reach them."""
    if reference is not None:
        for i in range(arms(lane)):
            if record[MODE * len(lane) + i] == RUNNING:
                _move_target(len(lane), reference, task, period, record, i)


@kernel
def _move_target(lanes, reference, task, period, record, i):
    out, mine = stack(_ONE, _PLACE), stack(_ONE, task.links + _RECORD)
    k = record[PERIODS * lanes + i] + 1.0
    _set_target(reference, task, record, lanes, i, k * period, int(k), out)
    for j in range(GOAL, GOAL + size(task.links)):
        mine[j] = record[j * lanes + i]
    for d in range(max(2, size(task.targets))):
        mine[TARGET + d] = out[_MOVING.x + d]
    pursue(task, mine)
    for j in range(GOAL, GOAL + size(task.links)):
        record[j * lanes + i] = mine[j]


@kernel
def look_ahead(lane, reference, task, period, first, poses, record, seen):
    """Entries after the task's own: the target's rate, then the ways it will have gone at each time ahead.

    Points and their rates are given in the frame that turns with the hub. first: at the start of an episode.
    """
    if reference is not None:
        at = size(task.entries)
        for k in range(reference.scales.shape[0]):
            store(seen, at + k, splat(lane, 0.0))
        for i in range(arms(lane)):
            _look_ahead(len(lane), reference, task, period, first, record, seen, i)
        turn_in(lane, task, poses, seen, at, at + reference.scales.shape[0])
        for k in range(reference.scales.shape[0]):
            store(seen, at + k, clip(load(lane, seen, at + k) / reference.scales[k], CLIP))


@kernel
def _look_ahead(lanes, reference, task, period, first, record, seen, i):
    """Arm i's, in fixed axes and not scaled."""
    targets, at = size(task.targets), size(task.entries)
    out, rows = stack(_ONE, _PLACE), reference.ahead.shape[0]
    k = record[PERIODS * lanes + i] + (0.0 if first else 1.0)
    for row in range(rows + 1):
        step = k if row == 0 else k + reference.ahead[row - 1]
        _on_path(reference, task, record, lanes, i, step * period, int(step), out)
        for d in range(targets):
            way = out[_MOVING.x + d] - record[(TARGET + d) * lanes + i]
            seen[(at + row * targets + d) * lanes + i] = out[_MOVING.vx + d] if row == 0 else way


@kernel
def start_path(reference, task, stream, arm, record, lanes):
    """Draw an arm's path (as many draws in either case) and put its target at the start of it."""
    i = arm % lanes
    drawn, path, out = stack(_ONE, _DRAWN), stack(_ONE, _PATH), stack(_ONE, _PLACE)
    for k in range(reference.ranges.shape[0] // 2):
        drawn[k] = draw(stream, arm, reference.ranges, k)
    for k in range(len(_PATH)):
        path[k] = 0.0
    if reference.line is not None:
        draw_line(task, stream, arm, record[GOAL * lanes + i], drawn, path)
    else:
        draw_path(task, stream, arm, record[GOAL * lanes + i], drawn, path)
    for k in range(len(_PATH)):
        record[(PATH_AT + k) * lanes + i] = path[k]
    _set_target(reference, task, record, lanes, i, 0.0, 0, out)
