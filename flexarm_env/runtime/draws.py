"""Draws of a start from an arm's random stream: joint angles and target outside obstacles, vibration, factors."""

from __future__ import annotations

import math

from ..compiler import kernel, size, stack
from ..physics.joints.layout import LAWS
from ..physics.model import EI_Y_FACTOR, GJ_FACTOR, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D
from ..physics.protocol import set_joint_configuration
from ..tasks.attainable import MOST_DRAWS, attainable, held_in_space
from ..tasks.program import GOAL, START, TARGET, basis_at, request_at, start_at
from ..tasks.starts import ALWAYS, FACTOR
from ..tasks.stream import draw, uniform
from ..tasks.task import aim, target_from
from .touch import is_free

MODES = 3
"""Number of vibration modes in an initial vibration in space: bending along y, bending along z, torsion."""
_ONE, _RECORD, _START = (0,), (0,) * GOAL, (0,) * START.offsets(0, 0).end


@kernel
def draw_start(task, ranges, stream, request, arm, own):
    """Draw an arm's `START` record (joint angles, target, vibration, factors, parameters) unless requested.

    request: a `REQUEST`; NaN means that the number is drawn. Every request consumes the same number of random numbers,
    so that later draws do not depend on it.
    # in        task, ranges (`Ranges`), request
    # in, out   stream[arm]
    # out       own: angles, rad; target (2,), m or rad; vibration, over L; factors; parameters (kg, kg m^2, -, s)
    """
    _draw_posture(task, ranges, stream, request, arm, own)
    n = size(task.links)
    at, asked = start_at(0, n), request_at(0, n, 0)
    # amplitude of the initial vibration, in [-1, 1] ranges.vibration: of one mode in the plane, of MODES in space
    for k in range(1 if ranges.pose is not None or ranges.shake is None else MODES):
        vibration = (2.0 * uniform(stream, arm) - 1.0) * ranges.vibration
        own[at.vibration + k] = given(request[asked.vibration + k], vibration)
    # factors on nominal values; those behind ALWAYS are 1 here and drawn by `draw_more`
    for k in range(ALWAYS):
        own[at.factors + k] = draw(stream, arm, ranges.factors, k)
    for k in range(ALWAYS, FACTOR.end):
        own[at.factors + k] = 1.0
    own[at.parameters + PAYLOAD_MASS] = ranges.nominal[PAYLOAD_MASS] * own[at.factors + FACTOR.payload]
    own[at.parameters + PAYLOAD_INERTIA] = ranges.nominal[PAYLOAD_INERTIA] * own[at.factors + FACTOR.payload]
    own[at.parameters + STIFFNESS_FACTOR] = ranges.nominal[STIFFNESS_FACTOR] * own[at.factors + FACTOR.EI]
    own[at.parameters + TAU_D] = ranges.nominal[TAU_D] * own[at.factors + FACTOR.damping]


@kernel
def _draw_posture(task, ranges, stream, request, arm, own):
    """Draw joint angles and target of a `START` record unless requested; arguments as in `draw_start`."""
    n = size(task.links)
    at, asked = start_at(0, n), request_at(0, n, 0)
    # theta_k (rad), drawn or requested; a share of the starts is straight, all 0
    straight = uniform(stream, arm) < ranges.straight[0]
    for k in range(n):
        angle = draw(stream, arm, ranges.start, k)
        own[at.angles + k] = given(request[asked.angles + k], 0.0 if straight else angle)
    # target (m or rad); in the plane drawn again until tau_k of its posture are within the limits
    first, second = draw(stream, arm, ranges.target, 0), draw(stream, arm, ranges.target, 1)
    first, second = target_from(task, own[at.angles : at.end], first, second)
    if ranges.attainable is not None and ranges.pose is not None:
        for _ in range(MOST_DRAWS):
            if attainable(task, ranges.attainable, own[at.angles : at.end], first, second) > 0.5:
                break
            first, second = draw(stream, arm, ranges.target, 0), draw(stream, arm, ranges.target, 1)
            first, second = target_from(task, own[at.angles : at.end], first, second)
    own[at.target] = given(request[asked.target], first)
    own[at.target + 1] = given(request[asked.target + 1], second)


@kernel
def draw_free(lane, p, arm, own, par, w):
    """Draw joint angles and target of a planar arm until both are outside obstacles, at most MOST_DRAWS times.

    A requested start or target is not checked. own: the arm's `START` record, read and written. Scratch: w.r, and w.q,
    v, a and b of the arm's lane.
    """
    n, lanes, i = size(p.task.links), len(lane), arm % len(lane)
    asked, mine = request_at(0, n, 0), stack(_ONE, p.task.links + _START)
    for _ in range(MOST_DRAWS):
        free = True
        if math.isnan(p.request[asked.angles]):
            place(lanes, i, p.ranges.pose, p.ranges.shake, n, own, size(p.model.n), w.q, w.v, w.a, w.b)
            free = is_free(lane, p, par, w, i)
        if p.ranges.free_targets is not None:
            if free and math.isnan(p.request[asked.target]):
                _copy_goal(p.task, own, mine)
                place(lanes, i, p.ranges.pose, p.ranges.shake, n, mine, size(p.model.n), w.q, w.v, w.a, w.b)
                free = is_free(lane, p, par, w, i)
        if free:
            break
        _draw_posture(p.task, p.ranges, p.stream, p.request, arm, own)


@kernel
def _copy_goal(task, own, mine):
    """Write the joint angles (rad) that reach the target of `own` into `mine`, two `START` records."""
    n = size(task.links)
    at, goal = start_at(0, n), stack(_ONE, task.links + _RECORD)
    goal[TARGET], goal[TARGET + 1] = own[at.target], own[at.target + 1]
    for k in range(n):
        goal[GOAL + k] = own[at.angles + k]
    aim(task, goal)
    for k in range(n):
        mine[at.angles + k] = goal[GOAL + k]
    mine[at.vibration] = 0.0


@kernel
def draw_more(p, lanes, i, arm, factors, par):
    """Draw an arm's optional factors (friction, backlash, inertias, EI_y, GJ) and apply them to par in lane i.

    factors: a `FACTORS` record; its entries from ALWAYS on are written. par: the arm's own parameters in lanes,
    followed by the laws of its joints (`joints.layout.LAWS`). Each joint law becomes the model's law times the drawn
    factors.
    """
    for k in range(p.ranges.more.shape[0] // 2):
        factors[ALWAYS + k] = draw(p.stream, arm, p.ranges.more, k)
    # J_p = nominal * payload * payload_inertia: the former scales m_p and J_p, the latter J_p alone
    par[PAYLOAD_INERTIA * lanes + i] = par[PAYLOAD_INERTIA * lanes + i] * factors[FACTOR.payload_inertia]
    friction, play, rotor = factors[FACTOR.friction], factors[FACTOR.backlash], factors[FACTOR.motor_inertia]
    if p.ranges.pose is None:
        par[EI_Y_FACTOR * lanes + i] = par[EI_Y_FACTOR * lanes + i] * factors[FACTOR.EI_y]
        par[GJ_FACTOR * lanes + i] = par[GJ_FACTOR * lanes + i] * factors[FACTOR.GJ]
    # par of the joints <- the model's numbers (`LAWS`), then the drawn factors on friction, play, rotor
    if p.ranges.laws is not None:
        laws = par[size(p.model.own) * lanes :]
        for k in range(0, p.model.data.shape[0], LAWS.end):
            for j in range(LAWS.end):
                laws[(k + j) * lanes + i] = p.model.data[k + j]
            laws[(k + LAWS.viscous) * lanes + i] = p.model.data[k + LAWS.viscous] * friction
            laws[(k + LAWS.coulomb) * lanes + i] = p.model.data[k + LAWS.coulomb] * friction
            laws[(k + LAWS.play) * lanes + i] = p.model.data[k + LAWS.play] * play
            laws[(k + LAWS.rotor) * lanes + i] = p.model.data[k + LAWS.rotor] * rotor
        # change of J_hub (kg m^2): to `LAWS.hub` if the hub is behind an elastic gear, otherwise to the rotor, which
        # turns with it
        at = LAWS.rotor * lanes + i
        if p.model.hub is not None:
            at = LAWS.hub * lanes + i
        laws[at] = laws[at] + p.ranges.hub * (factors[FACTOR.hub_inertia] - 1.0)


@kernel
def given(requested, drawn):
    """Return `requested`, or `drawn` if `requested` is NaN."""
    if math.isnan(requested):
        return drawn
    return requested


@kernel
def place(lanes, i, pose, shake, n_joints, own, rows, q, v, a, b):
    """Set the state of the arm in lane i in the plane: straight links at the joint angles, with initial vibration.

    q and v are linear in the `BASIS` (1, alpha_k, cos alpha_k, sin alpha_k) of the links' absolute angles alpha (rad):
    q = pose BASIS, v = vibration * shake BASIS.
    # in        pose, shake (rows, BASIS); own, a `START`: joint angles, vibration (tip deflection / L)
    # out       q (m, rad), v (m/s, rad/s), a = b = 0 in lane i, `rows` rows
    """
    at = start_at(0, n_joints)
    vibration = own[at.vibration]
    length = basis_at(0, n_joints).end
    for row in range(rows):
        by = basis_at(row * length, n_joints)
        # alpha: absolute angle of link k, the sum of joint angles up to k
        alpha, value, rate = 0.0, pose[by.one], shake[by.one]
        for k in range(n_joints):
            alpha += own[at.angles + k]
            value += pose[by.angles + k] * alpha
            value += pose[by.cosines + k] * math.cos(alpha) + pose[by.sines + k] * math.sin(alpha)
            rate += shake[by.cosines + k] * math.cos(alpha) + shake[by.sines + k] * math.sin(alpha)
        q[row * lanes + i] = value
        v[row * lanes + i] = rate * vibration
        a[row * lanes + i], b[row * lanes + i] = 0.0, 0.0


@kernel
def draw_free_goal(lane, p, arm, live, record, par, w):
    """Draw goal angles (rad) until the arm at these angles is outside obstacles, at most MOST_DRAWS times.

    live: mask of the arm's lane.   # in, out   record.goal, w.q   # scratch   w.r, w.v
    """
    lanes, i, n = len(lane), arm % len(lane), size(p.task.links)
    for _ in range(MOST_DRAWS):
        if is_free(lane, p, par, w, i):
            break
        for k in range(n):
            record[(GOAL + k) * lanes + i] = draw(p.stream, arm, p.ranges.target, k)
        if p.ranges.attainable is not None:
            draw_held(p, arm, lanes, record)
        set_joint_configuration(lane, p.model, live, record[GOAL * lanes : (GOAL + n) * lanes], None, w.q, w.v)


@kernel
def draw_held(p, arm, lanes, record):
    """Draw goal angles (rad) until the motors can hold the rigid arm at these angles, at most MOST_DRAWS times.

    record.goal of the arm's lane is read and written. arm: index of the arm in the batch; lanes: number of arms in a
    group.
    """
    n, i = size(p.task.links), arm % lanes
    mine = stack(_ONE, p.task.links)
    for k in range(n):
        mine[k] = record[(GOAL + k) * lanes + i]
    for _ in range(MOST_DRAWS):
        if held_in_space(p.ranges.attainable, p.task.links, mine) > 0.5:
            break
        for k in range(n):
            mine[k] = draw(p.stream, arm, p.ranges.target, k)
    for k in range(n):
        record[(GOAL + k) * lanes + i] = mine[k]
