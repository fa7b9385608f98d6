"""Kernels that Python calls for one arm: residual and poses with their derivatives (`linear`), and strain gauges.

All lanes of `WITH_SLOPES` contain the same arm. Each lane has the tangent of one direction of change. One pass
therefore computes as many columns of a derivative as there are lanes.
"""

from __future__ import annotations

from typing import NamedTuple

from ..compiler import (
    SINGLE,
    WIDEST,
    dual,
    kernel,
    lane_count,
    size,
    splat,
    store,
)
from ..validation import Array
from .integrator.work import unpack, work_size
from .layout import OF_MOTION
from .protocol import (
    RESIDUAL_ALONE,
    State,
    assemble,
    centerline,
    constraint_residual,
    out_of_range,
    retract,
    strain_gauge,
    task_poses,
)

WITH_SLOPES = SINGLE if WIDEST is SINGLE else dual(WIDEST)
"""Lane tag of one arm with one direction of change in each lane. Without compiler, lanes have values but no
directions."""


class Directions(NamedTuple):
    """Changes of an arm along m directions, one row per direction. Changes of rotations are increments in body axes."""

    q: Array  # (m, n): changes of coordinates
    v: Array  # (m, n): changes of velocities
    a: Array  # (m, n): changes of accelerations
    u: Array  # (m, n_inputs): changes of inputs


@kernel
def slopes_room(lane, model, n_par, n_motions):
    """Return the length of the scratch array of `residual_slopes` and `pose_slopes`. n_par: number of parameters."""
    return work_size(len(lane), model, n_motions) + n_par * len(lane)


@kernel
def residual_slopes(lane, model, par, state, u, psi, directions, level, room, r, slopes):
    """Compute the residual of equation [64] of one arm and its derivatives along directions; return a status code.

    # in        state: q, v, a (n,); u: inputs (N m, N); psi: prescribed motions, a `MOTION` each; par: parameters
    #           directions: `Directions`. level: rows of multipliers of r are the constraints Phi (0) or their first (1)
    #           or second (2) time derivatives
    # scratch   room: array of the length `slopes_room`
    # out       r (n,): M(q) a + h(q, v) + Phi_q^T lambda - B u (N, N m); slopes (m, n): dr along each direction

    lane: lane tag `WITH_SLOPES`. The returned status code (`model.STATUS`) is 0 if the model is valid at this state.
    """
    many, ways = lane_count(lane), directions.q.shape[0]
    w, own = _placed(lane, model, par, psi, room)
    for first in range(0, max(ways, 1), many):
        _set(lane, model, par, state, u, psi, w, own)
        for i in range(min(many, ways - first)):
            _add_direction(lane, model, directions, first + i, i, w)
        retract(lane, model, w.q, 1.0, w.b, None)
        assemble(lane, model, own, State(w.q, w.v, w.a), w.u, RESIDUAL_ALONE, w.r, w.S)
        constraint_residual(lane, model, w.psi, State(w.q, w.v, w.a), level, 1.0, w.r)
        for i in range(min(many, ways - first)):
            for k in range(size(model.n)):
                slopes[first + i, k] = w.r[k * len(lane) + many + i]
    # all lanes contain the same arm, so that the first one has the values
    for k in range(size(model.n)):
        r[k] = w.r[k * len(lane)]
    store(w.flag, 0, splat(lane, 0.0) + out_of_range(lane, model, own, w.q))
    return w.flag[0]


@kernel
def pose_slopes(lane, model, par, state, u, psi, directions, rows, room, poses, values, slopes):
    """Compute poses and strain gauge readings of one arm and their derivatives along directions.

    # in        state: q, v, a (n,); u: inputs (N m, N); psi: prescribed motions, a `MOTION` each; par: parameters
    #           directions: `Directions`, m changes of q, v, a and u
    #           rows (G, ...): one row per gauge, from `gauges.curvature_rows`
    # scratch   room: `slopes_room` numbers; poses: (p len(lane),)
    # out       values (p + G,): `protocol.task_poses`, then readings (1/m); slopes (m, p + G)

    lane: lane tag `WITH_SLOPES`.
    """
    many, ways = lane_count(lane), directions.q.shape[0]
    w, own = _placed(lane, model, par, psi, room)
    gauges = rows.shape[0]
    count = values.shape[0] - gauges
    for first in range(0, max(ways, 1), many):
        _set(lane, model, par, state, u, psi, w, own)
        for i in range(min(many, ways - first)):
            _add_direction(lane, model, directions, first + i, i, w)
        retract(lane, model, w.q, 1.0, w.b, None)
        task_poses(lane, model, own, w.q, w.v, poses)
        for k in range(count):
            values[k] = poses[k * len(lane)]
            for i in range(min(many, ways - first)):
                slopes[first + i, k] = poses[k * len(lane) + many + i]
        for g in range(gauges):
            store(w.r, 0, splat(lane, 0.0) + strain_gauge(lane, model, w.q, rows[g]))
            values[count + g] = w.r[0]
            for i in range(min(many, ways - first)):
                slopes[first + i, count + g] = w.r[many + i]


@kernel
def point_slopes(lane, model, q, ways, own, line, points, slopes):
    """Compute points of the center line of one arm and their derivatives along directions; return their number.

    # in        q (n,): coordinates, none of which is part of a rotation; ways (m, n): changes of q
    # scratch   own (n,), line (P, 2 or 3): lanes
    # out       points (P, 2 or 3), m, inertial axes; slopes (m, P, 2 or 3)

    lane: lane tag `WITH_SLOPES`.
    """
    many, count = lane_count(lane), 0
    for first in range(0, max(ways.shape[0], 1), many):
        # q with up to `many` directions as tangents
        for k in range(size(model.n)):
            store(own, k, splat(lane, q[k]))
            for i in range(min(many, ways.shape[0] - first)):
                own[k * len(lane) + many + i] = ways[first + i, k]
        count = centerline(lane, model, own, line)
        # values of the first lane; tangent i is the derivative along direction first + i
        for p in range(count):
            for d in range(points.shape[1]):
                points[p, d] = line[p, d * len(lane)]
                for i in range(min(many, ways.shape[0] - first)):
                    slopes[first + i, p, d] = line[p, d * len(lane) + many + i]
    return count


@kernel
def _placed(lane, model, par, psi, room):
    """Return two parts of the scratch array `room`: the work record, and memory for the arm's own parameters."""
    end = work_size(len(lane), model, psi.shape[0] // OF_MOTION.end)
    return unpack(lane, model, room, psi.shape[0] // OF_MOTION.end), room[end : end + par.shape[0] * len(lane)]


@kernel
def _set(lane, model, par, state, u, psi, w, own):
    """Set all lanes to one arm without tangents; set w.b, the increment of q, to 0."""
    for k in range(size(model.n)):
        store(w.q, k, splat(lane, state.q[k]))
        store(w.v, k, splat(lane, state.v[k]))
        store(w.a, k, splat(lane, state.a[k]))
        store(w.b, k, splat(lane, 0.0))
    for k in range(u.shape[0]):
        store(w.u, k, splat(lane, u[k]))
    for k in range(psi.shape[0]):
        store(w.psi, k, splat(lane, psi[k]))
    for k in range(par.shape[0]):
        store(own, k, splat(lane, par[k]))


@kernel
def _add_direction(lane, model, directions, j, i, w):
    """Set the tangents of lane i to direction j of `directions`."""
    many = lane_count(lane)
    for k in range(size(model.n)):
        w.b[k * len(lane) + many + i] = directions.q[j, k]
        w.v[k * len(lane) + many + i] = directions.v[j, k]
        w.a[k * len(lane) + many + i] = directions.a[j, k]
    for k in range(directions.u.shape[1]):
        w.u[k * len(lane) + many + i] = directions.u[j, k]


@kernel
def read_gauges(model, q, rows, out):
    """Compute the strain gauge readings out (m, G), 1/m, of m configurations q (m, n), in one lane.

    rows (G, ...): one row per gauge, from `gauges.curvature_rows`. q: coordinates of the arm.
    """
    for i in range(q.shape[0]):
        for g in range(rows.shape[0]):
            store(out[i], g, strain_gauge(SINGLE, model, q[i], rows[g]))


@kernel
def read_poses(model, par, q, v, out):
    """Write the poses of one arm at coordinates q and velocities v (n,) to out, as tasks read them.

    out is flat: one `layout.POSES` per link (in space `layout.SPACE_POSES`), then the poses of contributions. See
    `protocol.task_poses`.
    """
    task_poses(SINGLE, model, par, q, v, out)
