"""One control period of an arm that follows prescribed motions, in plain lanes or dual ones: what `envs.motion.Guide`
has a `Simulation` do, which lands on every kink of its motions and starts there anew."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..compiler import alone, bare, kernel, load, size, splat, store
from ..physics.integrator.drive import set_motions
from ..physics.integrator.start import restart_bare
from ..physics.integrator.step import advance_bare
from ..physics.integrator.work import copy_rows, unpack
from ..physics.model import NOT_FINITE, OK
from ..tasks.program import GUIDED, MODE, PERIODS
from .sampling import NEAR


class Guided(NamedTuple):
    """What such an arm has beside its model."""

    drive: Any
    motions: int  # how many
    kinks: np.ndarray  # (K,) s, in order
    duration: float  # s, where the motions end, and the arm stays as it is
    longest: float  # s, of a step
    chunk: int  # steps taken at once
    free: np.ndarray  # (A,): 1 where neither motion nor load acts on a joint, and an action counts
    takes: float  # 1 where torques act on those joints
    room: np.ndarray  # a work array, of dual lanes too


@kernel
def lead(lane, guide, p, model, par, record, action, w, anew):
    """The steps of a period under an action, of which what does not count is made 0.

    anew: with a start anew also where the torques are what they were; where they are not, there is one.
    """
    arm, drive, own = bare(model), bare(guide.drive), bare(par)
    x, periods = unpack(lane, model, bare(guide.room), guide.motions), record[PERIODS * len(lane)]
    _take_over(lane, arm, w, x)
    copy_rows(lane, size(arm.n_inputs), x.u, x.u0)
    _know(lane, drive, x)
    store(x.flag, 0, splat(lane, float(OK)))
    t = _landed(guide.kinks, min(periods * p.period, guide.duration))
    side = 1e-6 * guide.longest
    set_motions(lane, drive, x.psi, t, t - side if periods > 0.5 else t + side)
    if periods > 0.5:
        if _kinked(guide.kinks, t):
            restart_bare(lane, arm, drive, own, x, t, guide.longest, False)
    if _turn(lane, guide, p.task, arm, action, x, anew):
        restart_bare(lane, arm, drive, own, x, t, guide.longest, False)
    stop = min((periods + 1.0) * p.period, guide.duration)
    while t < stop - NEAR * max(1.0, stop):
        before, t = t, _next_stop(guide.kinks, t, stop)
        _run(lane, arm, drive, own, x, before, t, guide.longest, guide.chunk, p.scheme)
        if x.flag[0] != OK:
            t = stop
        elif t < stop - NEAR * max(1.0, stop):
            restart_bare(lane, arm, drive, own, x, t, guide.longest, False)
    _take_over(lane, arm, x, w)
    store(w.flag, 0, load(lane, x.flag, 0))
    store(record, MODE, splat(lane, float(GUIDED)))  # whose targets stay where they are


@kernel
def _take_over(lane, model, w, x):
    """The state and the inputs of w into x."""
    n = size(model.n)
    copy_rows(lane, n, w.q, x.q)
    copy_rows(lane, n, w.v, x.v)
    copy_rows(lane, n, w.a, x.a)
    copy_rows(lane, n, w.b, x.b)
    copy_rows(lane, size(model.n_inputs), w.u, x.u)


@kernel
def _know(lane, drive, x):
    """Nothing is differentiated by where a prescribed coordinate is: its motion says so."""
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            store(x.q, k, splat(lane, alone(load(lane, x.q, k))))
            store(x.v, k, splat(lane, alone(load(lane, x.v, k))))
            store(x.a, k, splat(lane, alone(load(lane, x.a, k))))
            store(x.b, k, splat(lane, alone(load(lane, x.b, k))))


@kernel
def _turn(lane, guide, task, model, action, x, anew):
    """x.u <- the torques that an action asks for, where they act; returns whether that is a kink."""
    changed = False
    for k in range(size(task.links)):
        if guide.free[k] < 0.5:
            store(action, k, splat(lane, 0.0))
        if guide.takes > 0.5:
            torque = load(lane, action, k) * task.torque_limits[k]
            if anew or alone(torque) != alone(load(lane, x.u, k)):
                changed = True
            store(x.u, k, torque)
    return changed


@kernel
def _landed(kinks, t):
    """The kink that is met at t, or t."""
    for k in range(kinks.shape[0]):
        if abs(kinks[k] - t) <= NEAR * max(1.0, t):
            return kinks[k]
    return t


@kernel
def _kinked(kinks, t):
    """Whether there is a kink at t."""
    for k in range(kinks.shape[0]):
        if abs(kinks[k] - t) <= NEAR * max(1.0, kinks[k]):
            return True
    return False


@kernel
def _next_stop(kinks, t, stop):
    """The next kink on the way from t, or `stop`."""
    for k in range(kinks.shape[0]):
        if kinks[k] > t + NEAR * max(1.0, kinks[k]):
            if kinks[k] <= stop + NEAR * max(1.0, stop):
                return kinks[k]
            return stop
    return stop


@kernel
def _run(lane, model, drive, par, x, start, stop, longest, chunk, scheme):
    """Equal steps of at most `longest` within a smooth stretch."""
    if start < stop - NEAR * max(1.0, stop):
        n_steps, done = max(1, math.ceil((stop - start) / longest * (1.0 - 1e-9))), 0
        h = (stop - start) / n_steps
        while done < n_steps:
            steps = min(chunk, n_steps - done)
            advance_bare(lane, model, drive, par, x, start + done * h, h, steps, scheme, (0,))
            for k in range(size(model.n)):
                if not math.isfinite(x.q[k * len(lane)]):
                    x.flag[0] = float(NOT_FINITE)
            done += steps
            if x.flag[0] != OK:
                done = n_steps
