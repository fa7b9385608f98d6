"""Steps fitted to a tolerance: each arm's control period in as many steps as its motion asks for.

A period is made in steps of h and of h/2, from the same start; how far the tips come out apart, and would be after
another period, is the error of the finer run. It is kept where that is allowed; otherwise h/4 is compared with h/2, and
so on up to h/32, which is kept as it comes, its error told. The next period begins with the pair that did, or with the
one before where the error was an eighth of what is allowed. In lanes all arms of a group go through each step size that
one of them asks for, and keep what is theirs: an arm depends on nothing but itself. (Theory, section 6.)

An environment does so with its control periods (`move`) and a scene with its stretches between samples and kinks
(`simulation.Simulation`), by the same functions: `open_fit`, `start_run` and `end_run` for each step size, `close_fit`.
"""

from __future__ import annotations

import math

from ..compiler import kernel, load, size, store
from ..physics.arithmetic import put
from ..physics.layout import POSE
from ..physics.model import NEWTON_FAILED, OK
from ..physics.protocol import link_poses
from ..tasks.program import FURTHER, LEVEL, RETRY, SCRATCH, scratch_at
from ..tasks.task import info_of
from .keeping import keep, keep_lane, put_back
from .motors import take_steps

FITS = 6
"""Step sizes there are: of `program.Models`."""

LOWER = 0.125
"""Share of what is allowed below which the next period begins with longer steps."""

_FIRST = SCRATCH.offsets(0, 0, 0)
_FLAG, _FINE, TAKEN, APART, _TIPS = _FIRST.flag, _FIRST.fine, _FIRST.taken, _FIRST.apart, _FIRST.tips


@kernel
def move(lane, p, models, model, parts, par, poses, record, action, saved, scratch, block, w):
    """The steps of one period: those that are set, each in so many parts, or fitted."""
    if models is None:
        take_steps(lane, p, model, parts, par, poses, record, action, saved, block, w)
    else:
        _fit(lane, p, models, par, poses, record, action, saved, scratch, block, w)


@kernel
def _fit(lane, p, models, par, poses, record, action, saved, scratch, block, w):
    links, level = size(p.task.links), record[LEVEL * len(lane) : (LEVEL + 1) * len(lane)]
    open_fit(lane, links, level, record, saved, scratch, w)
    for k in range(FITS):
        if start_run(lane, k, saved, scratch, record, w):
            take_steps(lane, p, models[k], 2**k, par, poses, record, action, saved, block, w)
            link_poses(lane, models[k], par, w.q, w.v, poses)
            if not end_run(lane, k, links, p.allowed, p.period, poses, record, saved, scratch, level, w):
                break
    close_fit(lane, links, record, saved, scratch, w)


@kernel
def record_step_error(lane, p, scratch, live, info):
    """The error of a period in fitted steps, over L, into info: above the tolerance where h/32 was not enough."""
    if p.models is not None:
        at = info_of(p.task).further + FURTHER.step_error
        put(live, info, at, load(lane, scratch, APART) / p.task.length, load(lane, info, at))


@kernel
def _result(lane, links, saved, scratch):
    """The part of `scratch` that is a `SAVED`."""
    first = scratch_at(0, links, 0).result * len(lane)
    return scratch[first : first + saved.shape[0]]


@kernel
def open_fit(lane, links, level, record, saved, scratch, w):
    """Where a period or stretch begins, whose start is in `saved`; level: halvings that each arm's last one took."""
    for i in range(len(lane)):
        scratch[_FLAG * len(lane) + i] = w.flag[i]
        scratch[_FINE * len(lane) + i] = max(1.0, level[i]) if w.flag[i] == OK else -1.0
    keep(w, record, _result(lane, links, saved, scratch))  # of those that do not take part


@kernel
def start_run(lane, k, saved, scratch, record, w):
    """Whether an arm asks for k halvings; if so, all are at the start, and only those that ask will move."""
    lanes, asked = len(lane), False
    for i in range(lanes):
        fine = scratch[_FINE * lanes + i]
        w.flag[i] = float(RETRY)
        if fine == k or fine == k + 1:
            w.flag[i] = float(OK)
            asked = True
    if asked:
        for i in range(lanes):
            put_back(lanes, i, w, saved, record)
    return asked


@kernel
def end_run(lane, k, links, allowed, period, poses, record, saved, scratch, level, w):
    """What k halvings gave each arm: its result, or to be compared with the run that follows.

    Returns whether an arm is still to be moved.
    """
    result, asked = _result(lane, links, saved, scratch), False
    for i in range(len(lane)):
        _compare(len(lane), i, k, links, allowed, period, poses, record, scratch, result, level, w)
        if scratch[_FINE * len(lane) + i] >= 0.0:
            asked = True
    return asked


@kernel
def close_fit(lane, links, record, saved, scratch, w):
    """Every arm at its result."""
    for i in range(len(lane)):
        put_back(len(lane), i, w, _result(lane, links, saved, scratch), record)
    store(w.flag, 0, load(lane, scratch, _FLAG))


@kernel
def _compare(lanes, i, k, links, allowed, period, poses, record, scratch, result, level, w):
    """`end_run` of arm i."""
    fine, flag = scratch[_FINE * lanes + i], w.flag[i]
    if fine != k and fine != k + 1:
        return
    lost = flag == NEWTON_FAILED and lanes > 1  # it will be repeated alone
    error = math.inf
    if fine == k and flag == OK:
        error = _apart(lanes, i, links, period, poses, scratch)
    if lost or (fine == k and (error <= allowed or k == FITS - 1)):
        scratch[_FLAG * lanes + i], scratch[_FINE * lanes + i], scratch[TAKEN * lanes + i] = flag, -1.0, float(k)
        scratch[APART * lanes + i] = error
        if flag == OK:
            level[i] = k - 1.0 if error < LOWER * allowed else float(k)
        keep_lane(lanes, i, w, record, result)
        return
    for j in range(links):
        for c in range(2):
            at = (_TIPS + 4 * j + c) * lanes + i
            scratch[at] = poses[(POSE.end * j + POSE.tip_x + c) * lanes + i] if flag == OK else math.nan
            scratch[at + 2 * lanes] = poses[(POSE.end * j + POSE.tip_vx + c) * lanes + i]
    scratch[_FINE * lanes + i] = k + 1.0


@kernel
def _apart(lanes, i, links, period, poses, scratch):
    """How far the tips of two runs are apart, and would be after another period, m; infinite where one has failed."""
    most = 0.0
    for j in range(links):
        for c in range(2):
            at = (_TIPS + 4 * j + c) * lanes + i
            way = abs(poses[(POSE.end * j + POSE.tip_x + c) * lanes + i] - scratch[at])
            way += period * abs(poses[(POSE.end * j + POSE.tip_vx + c) * lanes + i] - scratch[at + 2 * lanes])
            if not way <= most:
                most = way if math.isfinite(way) else math.inf
    return most
