"""Moving targets: where they are, how fast they move, and what the observation sees of what comes."""

from __future__ import annotations

import math

from ..compiler.arrays import stack
from ..compiler.decorator import kernel
from ..compiler.dispatch import size
from ..physics.arithmetic import clip
from .program import CLIP, GOAL, MODE, PATH, RUNNING, STEP, TARGET, TARGET_RATE
from .stream import uniform
from .task import aim

_SIX, _MANY = (0,) * 6, (0,) * (GOAL + 8)


@kernel
def _on_path(reference, targets, record, lanes, i, t, k, out):  # type: ignore[no-untyped-def]
    """out[0:D] <- target, out[2:2+D] <- its rate, for arm i's path at t (s), which is control instant k."""
    if reference.table.shape[0] > 0:
        rows = reference.table.shape[0] // (2 * targets)
        row = min(k, rows - 1) * 2 * targets
        for d in range(targets):
            out[d], out[2 + d] = reference.table[row + d], reference.table[row + targets + d]
        return
    first, second = record[PATH * lanes + i], record[(PATH + 1) * lanes + i]
    size_of, omega, phase = (
        record[(PATH + 2) * lanes + i], record[(PATH + 3) * lanes + i], record[(PATH + 4) * lanes + i],
    )  # fmt: skip
    angle = omega * t + phase
    if targets == 1:  # to and fro, from rest
        out[0], out[2] = first + 0.5 * size_of * (1.0 - math.cos(angle)), 0.5 * size_of * omega * math.sin(angle)
    else:  # a circle
        out[0], out[1] = first + size_of * math.cos(angle), second + size_of * math.sin(angle)
        out[2], out[3] = -size_of * omega * math.sin(angle), size_of * omega * math.cos(angle)


@kernel
def move_targets(lane, reference, task, period, record):  # type: ignore[no-untyped-def]
    """Targets of running arms at the end of the period, and the joint angles that reach them."""
    if reference is not None:
        for i in range(len(lane)):
            if record[MODE * len(lane) + i] == RUNNING:
                _move_target(len(lane), reference, task, period, record, i)


@kernel
def _move_target(lanes, reference, task, period, record, i):  # type: ignore[no-untyped-def]
    targets, out, mine = size(task.targets), stack((0,), _SIX), stack((0,), _MANY)
    k = record[STEP * lanes + i] + 1.0
    _on_path(reference, targets, record, lanes, i, k * period, int(k), out)
    for d in range(targets):
        record[(TARGET + d) * lanes + i] = out[d]
        record[(TARGET_RATE + d) * lanes + i] = out[2 + d]
    for j in range(GOAL, GOAL + size(task.links)):
        mine[j] = record[j * lanes + i]
    mine[TARGET], mine[TARGET + 1] = out[0], out[1]
    aim(task, mine)
    for j in range(GOAL, GOAL + size(task.links)):
        record[j * lanes + i] = mine[j]


@kernel
def look_ahead(lanes, reference, task, period, first, poses, record, seen):  # type: ignore[no-untyped-def]
    """Entries after the task's own: the target's rate, then the ways it will have gone at each time ahead.

    Points and their rates are given in the frame that turns with the hub. first: at the start of an episode.
    """
    if reference is not None:
        for i in range(lanes):
            _look_ahead(lanes, reference, task, period, first, poses, record, seen, i)


@kernel
def _look_ahead(lanes, reference, task, period, first, poses, record, seen, i):  # type: ignore[no-untyped-def]
    targets, at = size(task.targets), size(task.entries)
    out, rows = stack((0,), _SIX), reference.ahead.shape[0]
    k = record[STEP * lanes + i] + (0.0 if first else 1.0)
    hub = poses[2 * lanes + i]
    for row in range(rows + 1):
        step = k if row == 0 else k + reference.ahead[row - 1]
        _on_path(reference, targets, record, lanes, i, step * period, int(step), out)
        if row == 0:
            x, y = out[2], out[3]
        else:
            x, y = out[0] - record[TARGET * lanes + i], out[1] - record[(TARGET + 1) * lanes + i]
        o = row * targets
        if targets == 1:
            seen[(at + o) * lanes + i] = clip(x / reference.scales[o], CLIP)
        else:
            cosine, sine = math.cos(hub), math.sin(hub)
            seen[(at + o) * lanes + i] = clip((cosine * x + sine * y) / reference.scales[o], CLIP)
            seen[(at + o + 1) * lanes + i] = clip((cosine * y - sine * x) / reference.scales[o + 1], CLIP)


@kernel
def start_path(reference, task, stream, arm, record, lanes):  # type: ignore[no-untyped-def]
    """Draw an arm's path (as many draws in either case) and put its target at the start of it."""
    if reference is not None:
        _start_path(reference, task, stream, arm, record, lanes)


@kernel
def _start_path(reference, task, stream, arm, record, lanes):  # type: ignore[no-untyped-def]
    i, targets = arm % lanes, size(task.targets)
    drawn = stack((0,), _SIX)
    for k in range(4):
        low, high = reference.ranges[2 * k], reference.ranges[2 * k + 1]
        drawn[k] = low + (high - low) * uniform(stream, arm)
    turn = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    if targets == 1:  # 0 amplitude, rad; 1 period, s; from where the arm stands
        record[PATH * lanes + i] = record[GOAL * lanes + i]
        record[(PATH + 2) * lanes + i] = drawn[0] * turn
        record[(PATH + 3) * lanes + i] = 2.0 * math.pi / drawn[1]
    else:  # 0 and 3 distance (m) and direction of the centre, 1 period, s; 2 radius, m
        record[PATH * lanes + i] = drawn[0] * math.cos(drawn[3])
        record[(PATH + 1) * lanes + i] = drawn[0] * math.sin(drawn[3])
        record[(PATH + 2) * lanes + i] = drawn[2]
        record[(PATH + 3) * lanes + i] = turn * 2.0 * math.pi / drawn[1]
        record[(PATH + 4) * lanes + i] = 2.0 * math.pi * uniform(stream, arm)
    _on_path(reference, targets, record, lanes, i, 0.0, 0, drawn)
    for d in range(targets):
        record[(TARGET + d) * lanes + i], record[(TARGET_RATE + d) * lanes + i] = drawn[d], drawn[2 + d]
