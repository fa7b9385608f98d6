"""Steps fitted to a tolerance: each arm's motion determines the number of steps in its control period.

A period is computed in steps of h and of h/2 from the same start. The error of the finer run is estimated by the
distance between the tips of both runs, at the end of the period and extrapolated by another period (theory, eq. 6.4).
The finer run is kept if its error is allowed. If the error is too large, h/4 is compared with h/2, and so on up to
h/32. The run with h/32 is kept even if its error is too large, and its error is reported. The next period begins with
the same pair of step sizes, or with the next coarser pair if the error was below an eighth of the allowed error. If one
arm of a group needs a step size, that step size is computed for all arms of the group. Each arm keeps its own result,
which other arms do not influence.

An environment fits the steps of each control period (`fit_period`). Under prescribed motions it fits the steps of each
stretch between two kinks (`guided`). A scene fits the steps of its stretches between samples and kinks
(`simulation.Simulation`). Environments and scenes call `open_fit`, then `start_run` and `end_run` for each step size,
and finally `close_fit`. A run of k halvings has steps of h / 2^k. Each number k of halvings has its own model, because
inertia corrections depend on the step.
"""

from __future__ import annotations

import math

from ..compiler import Lanes, kernel, size
from ..physics.arithmetic import store_where
from ..physics.integrator.work import Work
from ..physics.layout import POSE
from ..physics.model import NEWTON_FAILED, OK
from ..physics.protocol import link_poses
from ..tasks.program import FURTHER, LEVEL, RETRY, SCRATCH, scratch_at
from ..tasks.task import info_of
from .keeping import restore_lane, save_lane, save_lanes
from .motors import take_steps

FITS = 6
"""Number of step sizes, h ... h/32, and of models in `program.Models`."""

LOWER = 0.125
"""Fraction of the allowed error below which the next period begins with longer steps."""

_FIRST = SCRATCH.offsets(0, 0, 0)
_FLAG, _FINE, TAKEN, APART, _TIPS = _FIRST.flag, _FIRST.fine, _FIRST.taken, _FIRST.apart, _FIRST.tips


@kernel
def fit_period(lane, p, models, par, poses, record: Lanes, action, saved, scratch, block, w):
    """Advance the arms by a period in fitted steps: runs with steps of h / 2^k until all arms have a result.

    A run of k halvings has steps of h / 2^k. An arm's result is the first run whose tips are within p.allowed (m) of
    the previous run's tips (theory, eq. 6.4), or the last possible run. Runs with a step size that no arm needs are
    omitted.

    # model     models: of k = 0, 1, ... halvings;  par, the arms' own parameters
    # in        action (joints, lanes), in [-1, 1];  saved, a `SAVED` of the start of the period, in lanes
    # in, out   w, the state;  record.level, halvings with which each arm's fit begins, for the next period the new one
    # scratch   poses, block;  scratch, a `SCRATCH` in lanes
    """
    links, level = size(p.task.links), record[LEVEL : LEVEL + 1]
    open_fit(lane, links, level, record, saved, scratch, w)
    # the run of k halvings is skipped if no lane needs it
    for k in range(FITS):
        if start_run(lane, k, saved, scratch, record, w):
            take_steps(lane, p, models[k], 2**k, par, poses, record, action, saved, block, w)
            link_poses(lane, models[k], par, w.q, w.v, poses)
            if not end_run(lane, k, links, p.allowed, p.period, poses, record, saved, scratch, level, w):
                break
    close_fit(lane, links, record, saved, scratch, w)


@kernel
def record_step_error(lane, p, scratch: Lanes, live, info: Lanes):
    """Write the error of a period in fitted steps, divided by the arm's length, into info of running arms.

    The error is scratch.apart (m): distance of the tips between the kept run and the run with steps twice as long. The
    error exceeds the tolerance if steps of h/32 were still too long. With steps of fixed length the kernel does
    nothing.
    """
    if p.models is not None:
        at = info_of(p.task).further + FURTHER.step_error
        store_where(lane, live, info, at, scratch[APART] / p.task.length, info[at])


@kernel
def _result(lane, links, saved, scratch):
    """Return the view of `scratch`, a `SCRATCH` in lanes, that contains a `SAVED`: the arms' results.

    links: number of links. saved: a `SAVED` record in lanes; only its length is used.
    """
    first = scratch_at(0, links, 0).result * len(lane)
    return scratch[first : first + saved.shape[0]]


@kernel
def open_fit(lane, links, level, record, saved, scratch, w):
    """Begin the fit of a period: save the status flags, and start each arm with its last number of halvings.

    # in        saved, the state at the start;  level (lanes,): number of halvings of each arm's last period;  w.flag
    #           links, number of links
    # out       scratch.flag, status;  scratch.fine, number of halvings of the finer run of the first pair, at least 1
    #           (-1: the arm is not moved);  scratch.result, the present state
    """
    for i in range(len(lane)):
        scratch[_FLAG * len(lane) + i] = w.flag[i]
        # k_0 >= 1: e_k (6.4) compares two runs
        scratch[_FINE * len(lane) + i] = max(1.0, level[i]) if w.flag[i] == OK else -1.0
    # lanes that take no part keep their state: their result is saved here
    save_lanes(w, record, _result(lane, links, saved, scratch))


@kernel
def start_run(lane, k, saved, scratch, record, w):
    """Return whether an arm needs a run of k halvings; if so, restore all lanes to the start of the period.

    Runs are compared in pairs: a coarser run with fine - 1 halvings and a finer run with `fine` halvings of h. In a run
    of k halvings each step is h / 2^k. An arm needs this run as the coarser run (scratch.fine = k + 1) or as the finer
    run (scratch.fine = k) of its pair. w.flag becomes OK in the arm's lane and RETRY (not moved) in other lanes.
    """
    lanes, asked = len(lane), False
    for i in range(lanes):
        fine = scratch[_FINE * lanes + i]
        w.flag[i] = float(RETRY)
        if fine == k or fine == k + 1:
            w.flag[i] = float(OK)
            asked = True
    if asked:
        for i in range(lanes):
            restore_lane(lanes, i, w, saved, record)
    return asked


@kernel
def end_run(lane, k, links, allowed, period, poses, record, saved, scratch, level, w):
    """Compare the runs of k and k - 1 halvings, arm by arm; return whether an arm needs a further run.

    # in        links, number of links;  allowed, largest error (m);  period (s);  poses, tips after this run (m, m/s)
    # in, out   scratch: tips of the coarser run, replaced by the tips of this run where this run is not kept
    #           scratch.fine, number of halvings of the arm's next finer run, -1 if the arm has a result
    # out       level, number of halvings with which the arm's next period begins;  scratch.result, the state where the
    #           run is kept
    """
    result, asked = _result(lane, links, saved, scratch), False
    for i in range(len(lane)):
        _compare(len(lane), i, k, links, allowed, period, poses, record, scratch, result, level, w)
        if scratch[_FINE * len(lane) + i] >= 0.0:
            asked = True
    return asked


@kernel
def close_fit(lane, links, record, saved, scratch: Lanes, w: Work):
    """After all runs, set every arm to the state and the status flag of its kept run.

    # in        scratch.result, a `SAVED` in lanes;  scratch.flag, status codes
    # out       w: q, v, a, b, books, u and flag;  record, the part that was saved
    """
    for i in range(len(lane)):
        restore_lane(len(lane), i, w, _result(lane, links, saved, scratch), record)
    w.flag[0] = scratch[_FLAG]


@kernel
def _compare(lanes, i, k, links, allowed, period, poses, record, scratch, result, level, w):
    """Compare arm i's run of k halvings with its coarser run; keep the run as the result, or store its tip positions.

    The finer run of a pair (scratch.fine = k) is kept if the distance of the tips is at most allowed (m), or if there
    are no shorter steps. A run that failed in a group of several lanes is kept as well. After any other run,
    scratch.fine becomes k + 1.
    # in        poses, tips of this run (m, m/s, inertial axes);  w.flag, status;  scratch.fine
    # out       scratch.flag, taken (k), apart (error, m), result, where kept;  scratch.tips, where not
    #           level, where kept without failure: halvings of the next period
    """
    fine, flag = scratch[_FINE * lanes + i], w.flag[i]
    if fine != k and fine != k + 1:
        return
    # a Newton failure in lanes ends the fit, because the arm is repeated alone, where steps can be halved
    lost = flag == NEWTON_FAILED and lanes > 1
    # e_k L (m) of the finer run (6.4); infinite for a coarse or failed run
    error = math.inf
    if fine == k and flag == OK:
        error = _apart(lanes, i, links, period, poses, scratch)
    # kept: e_k <= epsilon, or k = FITS - 1, the shortest steps
    if lost or (fine == k and (error <= allowed or k == FITS - 1)):
        scratch[_FLAG * lanes + i], scratch[_FINE * lanes + i], scratch[TAKEN * lanes + i] = flag, -1.0, float(k)
        scratch[APART * lanes + i] = error
        if flag == OK:
            level[i] = k - 1.0 if error < LOWER * allowed else float(k)
        save_lane(lanes, i, w, record, result)
        return
    # r and r' of the tips become those of k - 1 for the next pair; nan after a failure, so that its e_k is infinite
    for j in range(links):
        for c in range(2):
            at = (_TIPS + 4 * j + c) * lanes + i
            scratch[at] = poses[(POSE.end * j + POSE.tip_x + c) * lanes + i] if flag == OK else math.nan
            scratch[at + 2 * lanes] = poses[(POSE.end * j + POSE.tip_vx + c) * lanes + i]
    scratch[_FINE * lanes + i] = k + 1.0


@kernel
def _apart(lanes, i, links, period, poses, scratch):
    """Return the distance (m) of arm i's tips in two runs, now and extrapolated by a period (theory, eq. 6.4).

        max over links and axes of |r - r'| + period |v - v'|

    # in        poses, r and v: tips of the finer run (m, m/s, inertial axes)
    #           scratch.tips, r' and v': tips of the coarser run (nan after a failure: the distance is infinite)
    """
    most = 0.0
    for j in range(links):
        for c in range(2):
            at = (_TIPS + 4 * j + c) * lanes + i
            way = abs(poses[(POSE.end * j + POSE.tip_x + c) * lanes + i] - scratch[at])
            way += period * abs(poses[(POSE.end * j + POSE.tip_vx + c) * lanes + i] - scratch[at + 2 * lanes])
            # `not <=`: nan counts as infinite
            if not way <= most:
                most = way if math.isfinite(way) else math.inf
    return most
