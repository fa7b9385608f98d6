"""Prescribed motions in a control period: steps that end at every kink, with a consistent start after each kink.

A program with `Program.guide` moves one arm under prescribed motions, in lanes with or without tangents. Without a
guide this part of the period is not compiled. `simulate` uses the same kernels (`sampling`), so both give the same
numbers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import Lanes, kernel, lane_count, load, noinline, size, splat, stack, store, without_tangents
from ..physics.integrator.drive import set_motions
from ..physics.integrator.work import copy_rows
from ..physics.layout import WORK_DONE
from ..physics.model import OK
from ..physics.protocol import link_poses
from ..tasks.program import GUIDED, LEVEL, MODE, PERIODS, RUNNING
from ..tasks.task import put_info
from .energy_balance import add_work
from .fitted import APART, FITS, TAKEN, close_fit, end_run, fit_period, open_fit, start_run
from .keeping import save_lanes
from .motors import take_steps
from .sampling import AT_KINK, GOES_ON, NEAR, STRETCH, advance_evenly, next_stop, sample_rows, start_consistently

_AT = STRETCH.places
_ONE = (0,)
_ALL = 2**62


class Guided(NamedTuple):
    """Prescribed motions of the single arm of a program."""

    drive: Any  # prescribed motions and loads as functions of time
    motions: int  # number of prescribed coordinates
    joints: np.ndarray  # (motions,) int64: joint of each prescribed coordinate
    kinks: np.ndarray  # (K,) instants at which motions or loads may jump, s, ascending
    duration: float  # end of the prescribed motions, s; later the arm keeps its state
    longest: float  # length of the longest step, s
    chunk: int  # number of steps after which gross work is summed
    free: np.ndarray  # (A,): 1 for a joint without prescribed motion or load; its action is applied
    takes: float  # 1 if actions are torques on the free joints, otherwise 0
    stretch: np.ndarray  # a `STRETCH` record: instant reached, gross work
    levels: np.ndarray  # with fitted steps: number of stretches so far, then each stretch's number of halvings of h
    books: tuple[int, ...] | None = (0,)  # not None if work and dissipation are integrated


def unaccounted(guide: Guided) -> Guided:
    """Return a copy of the motions for derivatives: with its own scratch memory and without energy account."""
    return guide._replace(stretch=guide.stretch.copy(), levels=guide.levels.copy(), books=None)


@kernel
def motions_of(guide):
    """Return the number of prescribed coordinates in the work array of a program; guide: a `Guided`, or None."""
    return 0 if guide is None else guide.motions


@kernel
def moved_mode(guide):
    """Return the mode of the arms that a program advances: GUIDED with a guide, otherwise RUNNING."""
    return RUNNING if guide is None else GUIDED


@kernel
def move(lane, p, models, model, parts, par, poses, record, action, saved, scratch, block, w):
    """Advance the arms of a group by one control period: under motions, in steps of fixed length, or in fitted steps.

    models: `program.Models`, one for each number of halvings, or None for fixed steps. model: the model for fixed
    steps. parts: number of equal parts into which each fixed step is divided.
    # in        action (joints, lanes) in [-1, 1];  saved, the state at the start of the period;  par, own parameters
    # in, out   w: state, inputs and energy account (views of the group's memory `block`);  record
    # scratch   poses, scratch (a `SCRATCH` in lanes, with models)
    """
    if p.guide is not None:
        _follow_motions(lane, p, p.guide, models, model, par, poses, record, action, saved, scratch, block, w)
    elif models is None:
        take_steps(lane, p, model, parts, par, poses, record, action, saved, block, w)
    else:
        fit_period(lane, p, models, par, poses, record, action, saved, scratch, block, w)


@kernel
def start_motions(lane, p, par, w):
    """Make velocities and accelerations consistent with the motions and loads at t = 0.

    # in, out   w.q, w.v before the start; v, a, b, u and reactions after it;  p.guide.stretch, p.guide.levels
    """
    stretch, levels = p.guide.stretch, p.guide.levels
    for k in range(_AT.end):
        stretch[k] = 0.0
    for k in range(min(1, levels.shape[0])):
        levels[k] = 0.0
    stretch[_AT.longest], stretch[_AT.starts] = p.guide.longest, AT_KINK
    start_consistently(lane, p.model, p.guide.drive, par, w, stretch)


@noinline
def _follow_motions(lane, p, guide, models, model, par, poses, record: Lanes, action, saved, scratch, block, w):
    """Advance an arm under prescribed motions by one control period; actions are torques on its free joints.

    A change of a torque between periods is a kink, at which velocities and accelerations are made consistent.
    # in        record.periods, which gives the time; the other inputs as in `move`
    # in, out   action (joints, lanes), entries of joints with a prescribed motion or load become 0;  w;  guide.stretch
    # out       record.accounted, record.exchanged: start energy plus work, and sum of their absolute values, J
    """
    drive, stretch, periods = guide.drive, guide.stretch, without_tangents(record[PERIODS])
    # an arm whose action is not finite does not move
    if w.flag[0] != OK:
        return
    record[MODE] = float(GUIDED)  # targets do not move
    end, before, gross = stack(_ONE, _ONE), w.books[WORK_DONE * len(lane)], stretch[_AT.gross]
    copy_rows(lane, size(model.n_inputs), w.u, w.u0)
    _drop_known_tangents(lane, drive, w)
    # t = periods times period, not a sum; within round-off of a kink it is the kink
    t, kinked = _landed(guide.kinks, min(periods * p.period, guide.duration))
    # a state of `derivatives` lacks psi: before t, so that a jump of motions at t is seen as one; at the start after t
    if guide.books is None:
        side = 1e-6 * guide.longest
        set_motions(lane, drive, w.psi, t, t - side if periods > 0.5 else t + side)
    # one interval from t to the end of the period, or of the motions if that comes first
    stretch[_AT.time], stretch[_AT.longest], stretch[_AT.done], stretch[_AT.starts] = t, guide.longest, 0.0, GOES_ON
    end[0] = min((periods + 1.0) * p.period, guide.duration)
    # a kink at t: v, a jump with loads and motions first, then a with the torques
    if kinked and periods > 0.5:
        stretch[_AT.starts] = AT_KINK
        start_consistently(lane, model, drive, par, w, stretch)
    if _set_torques(lane, guide, p.task, action, w):
        stretch[_AT.starts] = AT_KINK
    if models is None:
        sample_rows(
            lane, model, drive, par, block, guide.motions, size(p.task.links), stretch, end, guide.kinks, guide.chunk,
            _ALL, p.scheme, guide.books, None, None,
        )  # fmt: skip
    else:
        _fit_stretches(lane, p, guide, models, model, par, poses, record, saved, scratch, end[0], w)
    if p.watched is not None:
        add_work(lane, record, 1.0, w.books[WORK_DONE * len(lane)] - before, stretch[_AT.gross] - gross)


@noinline
def _fit_stretches(lane, p, guide, models, model, par, poses, record: Lanes, saved, scratch, end, w):
    """Advance an arm under prescribed motions to the instant `end` (s) in fitted steps, each stretch between kinks.

    The length of the steps is fitted for each stretch as for a control period (`fitted.fit_period`).
    # in, out   w;  guide.stretch;  record.level, halvings with which the next fit begins
    # out       guide.levels;  scratch.apart, the largest error of the stretches, m;  saved, the last stretch's start
    """
    stretch, levels, links, level = guide.stretch, guide.levels, size(p.task.links), record[LEVEL : LEVEL + 1]
    k, worst, kinked = 0, 0.0, True
    while kinked and w.flag[0] == OK:
        stretch[_AT.longest] = guide.longest
        start_consistently(lane, model, guide.drive, par, w, stretch)
        begin, gross = stretch[_AT.time], stretch[_AT.gross]
        stop, k, kinked = next_stop(guide.kinks, k, begin, end)
        if not begin < end - NEAR * max(1.0, end):
            break
        save_lanes(w, record, saved)
        open_fit(lane, links, level, record, saved, scratch, w)
        # a run of j halvings has steps of at most longest / 2^j
        for j in range(FITS):
            if start_run(lane, j, saved, scratch, record, w):
                stretch[_AT.time], stretch[_AT.longest], stretch[_AT.gross] = begin, guide.longest / 2**j, gross
                advance_evenly(
                    lane, models[j], guide.drive, par, w, stretch, stop, guide.chunk, _ALL, p.scheme, guide.books
                )
                link_poses(lane, models[j], par, w.q, w.v, poses)
                if not end_run(lane, j, links, p.allowed, stop - begin, poses, record, saved, scratch, level, w):
                    break
        close_fit(lane, links, record, saved, scratch, w)
        worst = max(worst, scratch[APART])
        levels[0] += 1.0
        levels[int(levels[0])] = scratch[TAKEN]
        # a kink at the end of the period waits for the next one
        kinked = kinked and stop < end - NEAR * max(1.0, end)
        stretch[_AT.starts] = AT_KINK if kinked else GOES_ON
    scratch[APART] = worst


@kernel
def _drop_known_tangents(lane, drive, w):
    """Remove the tangents of prescribed coordinates, whose values follow from motions and not from the given state.

    drive.known: row of each prescribed coordinate; negative where a Lagrange multiplier prescribes it (skipped).
    # in, out   w.q, w.v, w.a, w.b
    """
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            for rows in (w.q, w.v, w.a, w.b):
                store(rows, k, splat(lane, without_tangents(load(lane, rows, k))))


@kernel
def _set_torques(lane, guide, task, action, w):
    """Set w.u to the commanded joint torques (N m) if guide.takes is 1; return whether a torque has changed.

    Torque = action (joints, lanes), in [-1, 1], times task.torque_limits. Entries of joints with a prescribed motion or
    load (guide.free is 0) are set to 0. A torque whose action has tangents counts as changed, because any change of the
    action makes the start of the period a kink.
    """
    changed = False
    for k in range(size(task.links)):
        if guide.free[k] < 0.5:
            store(action, k, splat(lane, 0.0))
        if guide.takes > 0.5:
            torque = load(lane, action, k) * task.torque_limits[k]
            if without_tangents(torque) != without_tangents(load(lane, w.u, k)):
                changed = True
            for j in range(lane_count(lane), len(lane)):
                if action[k * len(lane) + j] != 0.0:
                    changed = True
            store(w.u, k, torque)
    return changed


@kernel
def _landed(kinks, t):
    """Return (kink, True) for a kink within round-off of time t (s), otherwise (t, False).

    kinks (K,): instants at which motions or loads may jump, s. Round-off: NEAR (1e-12) times t, or times 1 s for
    smaller t.
    """
    for k in range(kinks.shape[0]):
        if abs(kinks[k] - t) <= NEAR * max(1.0, t):
            return kinks[k], True
    return t, False


@kernel
def record_motion_torques(lane, p, w, live, info, first):
    """Write the torques (N m) of an arm under motions into info from entry `first` on, for running arms (live > 1/2).

    The torque of a prescribed joint is the reaction that enforces its motion. For free joints the applied torque w.u is
    written.
    """
    for k in range(size(p.task.links)):
        put_info(lane, live, info, first + k, load(lane, w.u, k))
    for i in range(p.guide.joints.shape[0]):
        put_info(lane, live, info, first + p.guide.joints[i], load(lane, w.reaction, i))
