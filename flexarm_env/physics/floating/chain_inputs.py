"""Displacements and rates on which the inputs of floating frames do work: joint angles and positions of point loads."""

from ...compiler import Lanes, kernel, stack
from ..arithmetic import load_vector, store_vector
from ..layout import OF_LOAD, POSE
from .chain_output import SIX, elastic_of, enter, place, visit
from .layout import ANGLE, INNER, LOADED, acts_at, elbow_row
from .rigid import ROOT_END, TIP_END, end_of, far_point_pose


@kernel
def _to_loads(lane, model, link, end, pose, y):
    """Write x, y (m), angle (rad) of a pose to the rows of y for point loads at this end; an argument of `visit`."""
    for f in range(model.loads.shape[0] // LOADED.end):
        if acts_at(model.loads, f, link, end):
            store_vector(lane, y, model.links + OF_LOAD.end * f, load_vector(lane, pose, POSE.x))


@kernel
def load_displacements(lane, model, q, y):
    """Write the position (m, inertial axes) and section angle (rad) at each point load to y, after the joint angles."""
    if model.loads is not None:
        visit(lane, model, q, q, _to_loads, y)


@kernel
def _input_rates(lane, model, par, q: Lanes, v: Lanes, y: Lanes):
    """Write the rates of `input_displacements` to y: joint rates (rad/s), then velocity (m/s), rate of each load point.

    q: coordinates of the arm. v: their rates. Velocities are along inertial axes."""
    # joint rates beta_k'
    y[0] = v[ANGLE]
    for k in range(1, model.links):
        y[k] = v[elbow_row(model, k)]
    # loads at the ends of links, then loads between the segments of a link
    visit(lane, model, q, v, _rates_to_loads, y)
    _visit_bodies(lane, model, q, v, _rates_to_loads, y)


@kernel
def input_displacements(lane, model, par, q: Lanes, y: Lanes, since=None, v=None):
    """Write the displacements on which inputs do work to y: joint angles, then x, y, angle at each point load.

    Joint angles (rad) are the root's angle and the elbows' relative angles. Positions (m) are in inertial axes, section
    angles in rad. since is not read, because angles in the plane add up."""
    if v is not None:
        _input_rates(lane, model, par, q, v, y)
        return
    # joint angles beta_k
    y[0] = q[ANGLE]
    for k in range(1, model.links):
        y[k] = q[elbow_row(model, k)]
    load_displacements(lane, model, q, y)
    if model.inside is not None:
        _visit_bodies(lane, model, q, q, _to_loads, y)


@kernel
def _visit_bodies(lane, model, q: Lanes, v: Lanes, tell, out):
    """Call tell(lane, model, k, INNER + b, pose, out) at the tip of each body b of link k, except the link's last body.

    For the other arguments see `visit`.
    """
    pose, frame = stack(lane, SIX), stack(lane, SIX)
    for k in range(model.links):
        for b in range(k * model.segments, (k + 1) * model.segments):
            enter(lane, model, q, v, k, b, pose)
            # the first segment begins where the rigid end at the link's root ends
            if b == k * model.segments:
                far_point_pose(lane, end_of(model, k, ROOT_END), pose)
            # from the segment's root to its tip
            e = elastic_of(model, b)
            place(lane, model.mesh, model.data[model.block * b :], q[e:], v[e:], pose, frame)
            if b + 1 < (k + 1) * model.segments:
                tell(lane, model, k, INNER + b - k * model.segments, pose, out)
        far_point_pose(lane, end_of(model, k, TIP_END), pose)


@kernel
def _rates_to_loads(lane, model, link, end, pose, y):
    """Write velocity (m/s) and rate (rad/s) of a pose to the rows of y for point loads at this end; see `_to_loads`."""
    for f in range(model.loads.shape[0] // LOADED.end):
        if acts_at(model.loads, f, link, end):
            store_vector(lane, y, model.links + OF_LOAD.end * f, load_vector(lane, pose, POSE.vx))
