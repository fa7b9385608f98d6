"""Moving obstacles: forces that move them, and their displacements and work in environments.

A scene prescribes the displacements of obstacles as motions (`integrator.drive`). In an environment each arm of a batch
has its own time. `Paths` then gives the displacements, which are set at the end of each step. Steps do not end where
the velocity of an obstacle jumps. If the velocity jumps at the start of a control period, the accelerations of the arm
jump with it.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, lane_count, size, stack
from .. import protocol
from ..integrator.drive import evaluate
from .clearance import may_touch
from .kinematics import meeting, motion_of, motions, obstacle_count, place_of, wrench
from .layout import ACCOUNT

_account = kernel(ACCOUNT.offsets)


@kernel
def account_of(paths):
    """Return the offsets in S of the fields of `ACCOUNT`."""
    return _account(paths.at, len(paths.axes))


@kernel
def add_reactions(lane, part, model, par, q, v, r: Lanes):
    """Add the forces (N) of moving obstacles on the arm at q, v to the rows of the obstacles' displacements in r."""
    y, poses = stack(lane, model.points), stack(lane, part.poses)
    protocol.input_displacements(lane, model.arm, par, q, y)
    motions(lane, part, model, par, q, v, poses)
    for p in range(len(part.points)):
        velocity, spin = motion_of(lane, part, poses, p)
        for o in range(obstacle_count(part)):
            if part.meets[p * obstacle_count(part) + o] > 0.5:
                force, _ = wrench(part, p, meeting(lane, part, p, o, q, v, place_of(lane, part, y, p), velocity, spin))
                for i in range(3):
                    if part.moving[3 * o + i] >= 0:
                        r[part.moving[3 * o + i]] += force[0] if i == 0 else (force[1] if i == 1 else force[2])


@kernel
def _displace(lane, paths, w, i, t, side):
    """Set displacement (m), velocity and acceleration of each obstacle in lane i of w.q, w.v, w.a and w.b.

    t: time, s. side: time by which the piece of the function is selected, as in `drive.evaluate`.
    """
    for f in range(paths.rows.shape[0]):
        value, rate, second = evaluate(paths, f, t, side)
        k = paths.rows[f] * len(lane) + i
        w.q[k] = value
        w.v[k] = rate
        w.a[k] = second
        w.b[k] = second


@kernel
def _drop_tangents(lane, paths, w):
    """Remove the tangents of displacements, which do not depend on the state."""
    for f in range(paths.rows.shape[0]):
        for j in range(lane_count(lane), len(lane)):
            k = paths.rows[f] * len(lane) + j
            w.q[k], w.v[k], w.a[k], w.b[k] = 0.0, 0.0, 0.0, 0.0


@kernel
def start_obstacles(lane, model, w, i):
    """Place moving obstacles where they are at the start of an episode, in lane i of w.q, w.v, w.a and w.b."""
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            _displace(lane, model.newton.contact.paths, w, i, 0.0, 0.0)


@kernel
def open_obstacles(lane, model, w, record, row, period):
    """Set each arm's time at the start of a control period of `period` s, and place moving obstacles.

    record[row]: number of periods since the start of the episode.
    # out       w.S, the time;  w.q, w.v, w.a, w.b, rows of displacements, without tangents
    """
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            paths = model.newton.contact.paths
            at = account_of(paths).time * len(lane)
            _drop_tangents(lane, paths, w)
            for j in range(lane_count(lane), len(lane)):
                w.S[at + j] = 0.0
            for i in range(lane_count(lane)):
                t = record[row * len(lane) + i] * period
                w.S[at + i] = t
                _displace(lane, paths, w, i, t, t - 1e-6 * period)


@kernel
def move_obstacles(lane, model, w, h):
    """Place moving obstacles where they are at the end of a step of h (s), in w.q, w.v, w.a and w.b."""
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            paths = model.newton.contact.paths
            at = account_of(paths).time * len(lane)
            _drop_tangents(lane, paths, w)
            for i in range(lane_count(lane)):
                t = w.S[at + i] + h
                # a velocity that jumps at t: its value before
                _displace(lane, paths, w, i, t, t - 1e-6 * h)


@kernel
def jump_obstacles(lane, model, w, h):
    """Set the obstacles' velocities to the values just after the present time, at which they may jump. h: a step, s."""
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            paths = model.newton.contact.paths
            at = account_of(paths).time * len(lane)
            for i in range(lane_count(lane)):
                _displace(lane, paths, w, i, w.S[at + i], w.S[at + i] + 1e-6 * h)


@kernel
def account_for_obstacles(lane, part, model, par, q: Lanes, v, S: Lanes, h):
    """Add h (s) to the arm's time in S, and the work of moving obstacles in the step to their work.

    The work is the mean of the forces at both ends of the step times the displacement. With h = 0 the force at q, v
    is stored for the next step.
    """
    if model.newton.contact.paths is not None:
        paths = model.newton.contact.paths
        at, force = account_of(paths), stack(lane, part.room)
        for k in range(size(part.room)):
            force[k] = 0.0
        if h == 0.0 or may_touch(lane, part, model, S):
            add_reactions(lane, part, model, par, q, v, force)
        for f in range(len(paths.axes)):
            k = paths.rows[f]
            mean = (S[at.force + f] + force[k]) * 0.5
            if h > 0.0:
                S[at.work] += mean * (q[k] - S[at.place + f])
            S[at.force + f] = force[k]
            S[at.place + f] = q[k]
        S[at.time] += h


@kernel
def obstacle_work(lane, model, S: Lanes):
    """Return the work (J) of moving obstacles on each arm since `reset_impulses`; 0 if no obstacle moves."""
    work = 0.0
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            work = S[account_of(model.newton.contact.paths).work]
    return work
