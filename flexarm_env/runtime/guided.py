"""A control period of an arm that follows prescribed motions, in plain lanes or dual ones, for its derivatives.

It is what `envs.motion.Guide.advance` has a `Simulation` do, by the same kernel, `sampling.sample_rows`: on from kink
to kink, each of them a consistent start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import alone, kernel, load, size, splat, stack, store
from ..physics.integrator.drive import set_motions
from ..physics.integrator.work import copy_rows, unpack
from ..physics.model import OK
from ..tasks.program import GUIDED, MODE, PERIODS
from .sampling import AT_KINK, NEAR, STRETCH, sample_rows, start_consistently

_AT = STRETCH.places
_ONE, _STRETCH = (0,), (0,) * _AT.end
_ALL = 2**62


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
def follow_motions(lane, guide, p, model, par, record, action, w, anew):
    """The steps of a period under an action; entries of the action that do not count are made 0.

    Torques that differ from the last ones are a kink, and the arm starts consistently there; anew: it does so whatever
    the torques are, as derivatives by the action need it.
    """
    drive, periods = guide.drive, record[PERIODS * len(lane)]
    x, stretch, end = unpack(lane, model, guide.room, guide.motions), stack(_ONE, _STRETCH), stack(_ONE, _ONE)
    _copy_state(lane, model, w, x)
    copy_rows(lane, size(model.n_inputs), x.u, x.u0)
    _drop_known_tangents(lane, drive, x)
    store(x.flag, 0, splat(lane, float(OK)))
    t, kinked = _landed(guide.kinks, min(periods * p.period, guide.duration))
    side = 1e-6 * guide.longest
    set_motions(lane, drive, x.psi, t, t - side if periods > 0.5 else t + side)
    for k in range(_AT.end):
        stretch[k] = 0.0
    stretch[_AT.time], stretch[_AT.longest], end[0] = t, guide.longest, min((periods + 1.0) * p.period, guide.duration)
    if kinked and periods > 0.5:
        stretch[_AT.starts] = AT_KINK
        start_consistently(lane, model, drive, par, x, stretch)
    if _set_torques(lane, guide, p.task, model, action, x, anew):
        stretch[_AT.starts] = AT_KINK
    sample_rows(
        lane, model, drive, par, guide.room, guide.motions, size(p.task.links), stretch, end, guide.kinks, guide.chunk,
        _ALL, p.scheme, (0,), None, None,
    )  # fmt: skip
    _copy_state(lane, model, x, w)
    store(w.flag, 0, load(lane, x.flag, 0))
    store(record, MODE, splat(lane, float(GUIDED)))  # whose targets stay where they are


@kernel
def _copy_state(lane, model, w, x):
    """The state and the inputs of w into x."""
    n = size(model.n)
    copy_rows(lane, n, w.q, x.q)
    copy_rows(lane, n, w.v, x.v)
    copy_rows(lane, n, w.a, x.a)
    copy_rows(lane, n, w.b, x.b)
    copy_rows(lane, size(model.n_inputs), w.u, x.u)


@kernel
def _drop_known_tangents(lane, drive, x):
    """Prescribed coordinates without tangents: their motions, not the state that is given, say where they are."""
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            for rows in (x.q, x.v, x.a, x.b):
                store(rows, k, splat(lane, alone(load(lane, rows, k))))


@kernel
def _set_torques(lane, guide, task, model, action, x, anew):
    """x.u <- the torques that an action asks for, where they act; returns whether they are others than before."""
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
    """The kink that is met at t, or t; whether there is one."""
    for k in range(kinks.shape[0]):
        if abs(kinks[k] - t) <= NEAR * max(1.0, t):
            return kinks[k], True
    return t, False
