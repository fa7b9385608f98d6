"""A control period of an arm that follows prescribed motions, in plain or dual lanes, for its derivatives.

The computation is that of `envs.motion.Guide.advance` and uses the same kernel, `sampling.sample_rows`. The period is
divided at the kinks of the motions, with a consistent start after each kink.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import Lanes, kernel, load, size, splat, stack, store, without_tangents
from ..physics.integrator.drive import set_motions
from ..physics.integrator.work import Work, copy_rows, unpack
from ..physics.model import OK
from ..tasks.program import GUIDED, MODE, PERIODS
from .sampling import AT_KINK, NEAR, STRETCH, sample_rows, start_consistently

_AT = STRETCH.places
_ONE, _STRETCH = (0,), (0,) * _AT.end
_ALL = 2**62


class Guided(NamedTuple):
    """Data of an arm that follows prescribed motions: drive, kinks and scratch memory, without the model."""

    drive: Any  # loads and motions as functions of time
    motions: int  # number of prescribed coordinates
    kinks: np.ndarray  # (K,) s, ascending: instants where motions or loads may jump
    duration: float  # s, end of the motions, after which the arm stays as it is
    longest: float  # s, longest step
    chunk: int  # steps between sums of the gross work
    free: np.ndarray  # (A,): 1 where neither motion nor load acts on a joint, so that its action counts
    takes: float  # 1 where actions are torques on those joints, otherwise 0
    room: np.ndarray  # memory of a `Work`, large enough for dual lanes


@kernel
def follow_motions(lane, guide, p, model, par, record: Lanes, action, w: Work, anew):
    """Advance an arm that follows prescribed motions by one control period, under torques on its free joints.

    A change of a torque between periods is a kink, at which velocities and accelerations are made consistent. anew:
    True to make velocities and accelerations consistent even if no torque changes, as derivatives with respect to the
    action require.
    # guide     `Guided`: drive, kinks, longest step;  p: `Program`
    # in        record.periods, which gives the time; par, the arm's own parameters
    # in, out   action (joints, lanes), entries of joints with a prescribed motion become 0;  w: q, v, a, b, u and flag
    # out       record.mode becomes GUIDED, so that targets do not move
    """
    drive, periods = guide.drive, without_tangents(record[PERIODS])
    x: Work = unpack(lane, model, guide.room, guide.motions)
    stretch, end = stack(_ONE, _STRETCH), stack(_ONE, _ONE)
    # a work array of its own, because the arm's own one has no rows for prescribed motions (psi, reactions)
    _copy_state(lane, model, w, x)
    copy_rows(lane, size(model.n_inputs), x.u, x.u0)
    _drop_known_tangents(lane, drive, x)
    x.flag[0] = float(OK)
    # t = periods times period, not a sum; within round-off of a kink it is the kink
    t, kinked = _landed(guide.kinks, min(periods * p.period, guide.duration))
    side = 1e-6 * guide.longest
    # psi as it is before t, so that a jump of motions at t is seen as one; at the start after t
    set_motions(lane, drive, x.psi, t, t - side if periods > 0.5 else t + side)
    for k in range(_AT.end):
        stretch[k] = 0.0
    # one interval from t to the end of the period, or of the motions if that comes first
    stretch[_AT.time], stretch[_AT.longest], end[0] = t, guide.longest, min((periods + 1.0) * p.period, guide.duration)
    # a kink at t: v, a jump with loads and motions first, then a with the torques
    if kinked and periods > 0.5:
        stretch[_AT.starts] = AT_KINK
        start_consistently(lane, model, drive, par, x, stretch)
    if _set_torques(lane, guide, p.task, action, x, anew):
        stretch[_AT.starts] = AT_KINK
    sample_rows(
        lane, model, drive, par, guide.room, guide.motions, size(p.task.links), stretch, end, guide.kinks, guide.chunk,
        _ALL, p.scheme, (0,), None, None,
    )  # fmt: skip
    _copy_state(lane, model, x, w)
    w.flag[0] = x.flag[0]
    record[MODE] = float(GUIDED)  # targets of guided arms do not move


@kernel
def _copy_state(lane, model, w, x):
    """Copy coordinates, their rates, accelerations and inputs of work array w into work array x.

    q: (n, lanes) m and rad; v: rates; a, b: accelerations and the integrator's auxiliary ones; u: (inputs, lanes) N m,
    N.
    """
    n = size(model.n)
    copy_rows(lane, n, w.q, x.q)
    copy_rows(lane, n, w.v, x.v)
    copy_rows(lane, n, w.a, x.a)
    copy_rows(lane, n, w.b, x.b)
    copy_rows(lane, size(model.n_inputs), w.u, x.u)


@kernel
def _drop_known_tangents(lane, drive, x):
    """Remove the tangents of prescribed coordinates, whose values follow from motions and not from the given state.

    drive.known: row of each prescribed coordinate; negative where a Lagrange multiplier prescribes it (skipped).
    # in, out   x.q, x.v, x.a, x.b
    """
    for i in range(drive.known.shape[0]):
        k = drive.known[i]
        if k >= 0:
            for rows in (x.q, x.v, x.a, x.b):
                store(rows, k, splat(lane, without_tangents(load(lane, rows, k))))


@kernel
def _set_torques(lane, guide, task, action: Lanes, x, anew):
    """Set x.u to the joint torques (N m) that the action commands, where guide.takes is 1; return whether one changed.

    Torque = action (joints, lanes), in [-1, 1], times task.torque_limits. Entries of joints that are not free
    (guide.free is 0) are set to 0. anew: count every torque as changed.
    """
    changed = False
    for k in range(size(task.links)):
        if guide.free[k] < 0.5:
            action[k] = 0.0
        if guide.takes > 0.5:
            torque = action[k] * task.torque_limits[k]
            if anew or without_tangents(torque) != without_tangents(load(lane, x.u, k)):
                changed = True
            store(x.u, k, torque)
    return changed


@kernel
def _landed(kinks, t):
    """Return (the kink at time t (s), True), or (t, False) if there is no kink within round-off.

    kinks (K,): s, instants where motions or loads may jump. Round-off: NEAR (1e-12) times t, or times 1 s for smaller
    t.
    """
    for k in range(kinks.shape[0]):
        if abs(kinks[k] - t) <= NEAR * max(1.0, t):
            return kinks[k], True
    return t, False
