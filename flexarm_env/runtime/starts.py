"""Starts of episodes: an arm drawn from its stream, put in its place and observed; and arms moved elsewhere."""

from __future__ import annotations

import math

import numpy as np

from ..compiler import apart, follow, kernel, load, size, splat, stack, store
from ..physics.integrator.work import copy_rows, solve_known, unpack
from ..physics.joints.layout import LAWS
from ..physics.layout import SPACE_POSE
from ..physics.model import EI_Y_FACTOR, GJ_FACTOR, OK, PAYLOAD_INERTIA, PAYLOAD_MASS, STIFFNESS_FACTOR, TAU_D
from ..physics.protocol import RESIDUAL_ALONE, State, Weights, assemble, energy, stand, task_poses
from ..tasks.program import (
    FURTHER,
    GOAL,
    HOLD,
    MODE,
    PARAMETERS,
    PERIODS_ALLOWED,
    START,
    TARGET,
    TORQUE_FACTOR,
    basis_at,
    request_at,
    sections,
    start_at,
)
from ..tasks.starts import ALWAYS, FACTOR
from ..tasks.stream import draw, uniform
from ..tasks.task import aim, info_of, judge, target_from
from ..tasks.track import start_path
from .episode import OUTCOME, copy_info, finish_arm, observe_material, observe_state, record_energies, reward
from .events import draw_events
from .keep_out import record_clearance
from .motors import draw_delay, draw_lateness, record_delay
from .sensors import draw_age, record_drawn, write_observation

_MODES = 3
"""Of an initial vibration in space: bending along y, along z, torsion."""
_ONE, _RECORD, _START = (0,), (0,) * GOAL, (0,) * START.offsets(0, 0).end


@kernel
def start_episodes(address, mode, count):
    """Fresh starts of the arms p.queue[:count], drawn from their streams, in a mode."""
    p = follow(address)
    for k in range(count):
        arm = p.queue[k]
        g = arm // len(p.lane)
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        _start(p.lane, p, arm, mode, block, unpack(p.lane, p.model, block, 0))


@apart
def _start(lane, p, arm, mode, block, w):
    task, lanes, i, n_joints = p.task, len(lane), arm % len(lane), size(p.task.links)
    par, poses, record, action, seen, info, _, _ = sections(p.layout, block)
    own, at = stack(_ONE, task.links + _START), start_at(0, n_joints)
    _draw(task, p.ranges, p.stream, p.request, arm, own)
    limit = record[PERIODS_ALLOWED * lanes + i]
    for k in range(record.shape[0] // lanes):
        record[k * lanes + i] = 0.0
    record[PERIODS_ALLOWED * lanes + i], record[MODE * lanes + i] = limit, float(mode)
    record[TORQUE_FACTOR * lanes + i] = own[at.factors + FACTOR.torque_constant]
    record[TARGET * lanes + i], record[(TARGET + 1) * lanes + i] = own[at.target], own[at.target + 1]
    for k in range(PARAMETERS):
        par[k * lanes + i] = own[at.parameters + k]
    for k in range(w.u.shape[0] // lanes):
        w.u[k * lanes + i] = 0.0
    if p.ranges.pose is not None:
        _place(lanes, i, p.ranges.pose, p.ranges.shake, n_joints, own, size(p.model.n), w.q, w.v, w.a, w.b)
    else:
        par[EI_Y_FACTOR * lanes + i] = p.ranges.nominal[EI_Y_FACTOR] * own[at.factors + FACTOR.EI]
        par[GJ_FACTOR * lanes + i] = p.ranges.nominal[GJ_FACTOR]
        _place_in_space(lane, p, arm, own, par, poses, record, action, w)
    if p.ranges.more is not None:
        _draw_more(p, lanes, i, arm, own[at.factors : at.parameters], par)
    if p.ranges.pose is None and p.ranges.shake is not None:
        _swing(lane, p, i, _only(lane, i), own, par, action, w)
    for k in range(n_joints):
        action[k * lanes + i] = 0.0
        if p.ranges.pose is not None:
            record[(GOAL + k) * lanes + i] = own[at.angles + k]
    for k in range(w.books.shape[0] // lanes):
        w.books[k * lanes + i] = 0.0
    if p.reference is not None:
        start_path(p.reference, task, p.stream, arm, record, lanes)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    observe_material(lane, p, par, record, w, seen)
    live = _only(lane, i)
    for k in range(info_of(task).further * lanes + i, info.shape[0], lanes):
        info[k] = 0.0
    _start_info(lanes, p, arm, record, info)
    draw_delay(p.actuator, task, p.stream, arm, record, lanes)
    draw_age(p, arm, record, lanes)
    record_delay(lane, p, record, live, info)
    draw_events(lanes, p, arm, par, record, info)
    record_clearance(lane, p, arm // lanes, w.q, live, info)
    if size(task.further) > 0:
        for k in range(FACTOR.end):
            info[(info_of(task).further + FURTHER.drawn + k) * lanes + i] = own[at.factors + k]
    record_energies(lane, p, par, w, live, info)
    _first_observation(lane, p, arm, live, record, action, poses, seen, info)
    copy_info(lane, p, arm // lanes, info)


@kernel
def _only(lane, i):
    """1 in lane i, 0 elsewhere."""
    mask = stack(lane, _ONE)
    store(mask, 0, splat(lane, 0.0))
    mask[i] = 1.0
    return load(lane, mask, 0)


@kernel
def _draw(task, ranges, stream, request, arm, own):
    """own <- a `START`: as requested, or drawn. As many draws for any request."""
    n = size(task.links)
    at, asked = start_at(0, n), request_at(0, n, 0)
    straight = uniform(stream, arm) < ranges.straight
    for k in range(n):
        angle = draw(stream, arm, ranges.start, k)
        own[at.angles + k] = _given(request[asked.angles + k], 0.0 if straight else angle)
    first, second = draw(stream, arm, ranges.target, 0), draw(stream, arm, ranges.target, 1)
    first, second = target_from(task, own[at.angles : at.end], first, second)
    own[at.target] = _given(request[asked.target], first)
    own[at.target + 1] = _given(request[asked.target + 1], second)
    for k in range(1 if ranges.pose is not None or ranges.shake is None else _MODES):
        vibration = (2.0 * uniform(stream, arm) - 1.0) * ranges.vibration
        own[at.vibration + k] = _given(request[asked.vibration + k], vibration)
    for k in range(ALWAYS):
        own[at.factors + k] = draw(stream, arm, ranges.factors, k)
    for k in range(ALWAYS, FACTOR.end):
        own[at.factors + k] = 1.0
    own[at.parameters + PAYLOAD_MASS] = ranges.nominal[PAYLOAD_MASS] * own[at.factors + FACTOR.payload]
    own[at.parameters + PAYLOAD_INERTIA] = ranges.nominal[PAYLOAD_INERTIA] * own[at.factors + FACTOR.payload]
    own[at.parameters + STIFFNESS_FACTOR] = ranges.nominal[STIFFNESS_FACTOR] * own[at.factors + FACTOR.EI]
    own[at.parameters + TAU_D] = ranges.nominal[TAU_D] * own[at.factors + FACTOR.damping]


@kernel
def _draw_more(p, lanes, i, arm, factors, par):
    """What of an arm's own parameters is drawn only where it is asked for, by the later ones of its `FACTORS`."""
    for k in range(p.ranges.more.shape[0] // 2):
        factors[ALWAYS + k] = draw(p.stream, arm, p.ranges.more, k)
    par[PAYLOAD_INERTIA * lanes + i] = par[PAYLOAD_INERTIA * lanes + i] * factors[FACTOR.payload_inertia]
    friction, play, rotor = factors[FACTOR.friction], factors[FACTOR.backlash], factors[FACTOR.motor_inertia]
    if p.ranges.pose is None:
        par[EI_Y_FACTOR * lanes + i] = par[EI_Y_FACTOR * lanes + i] * factors[FACTOR.EI_y]
        par[GJ_FACTOR * lanes + i] = par[GJ_FACTOR * lanes + i] * factors[FACTOR.GJ]
    if p.ranges.laws is not None:
        laws = par[size(p.model.own) * lanes :]
        for k in range(0, p.model.data.shape[0], LAWS.end):
            for j in range(LAWS.end):
                laws[(k + j) * lanes + i] = p.model.data[k + j]
            laws[(k + LAWS.viscous) * lanes + i] = p.model.data[k + LAWS.viscous] * friction
            laws[(k + LAWS.coulomb) * lanes + i] = p.model.data[k + LAWS.coulomb] * friction
            laws[(k + LAWS.play) * lanes + i] = p.model.data[k + LAWS.play] * play
            laws[(k + LAWS.rotor) * lanes + i] = p.model.data[k + LAWS.rotor] * rotor
        at = LAWS.rotor * lanes + i
        if p.model.hub is not None:
            at = LAWS.hub * lanes + i
        laws[at] = laws[at] + p.ranges.hub * (factors[FACTOR.hub_inertia] - 1.0)


@kernel
def _given(requested, drawn):
    """What was requested, or else what was drawn."""
    if math.isnan(requested):
        return drawn
    return requested


@kernel
def _place(lanes, i, pose, shake, n_joints, own, rows, q, v, a, b):
    """Arm in lane i: straight links at their joint angles, at rest but for the initial vibration."""
    at = start_at(0, n_joints)
    vibration = own[at.vibration]
    length = basis_at(0, n_joints).end
    for row in range(rows):
        by = basis_at(row * length, n_joints)
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
def _place_in_space(lane, p, arm, own, par, poses, record, action, w):
    """Arm in its lane at rest: first at the goal's angles, drawn, which say where its target is, then at its own."""
    lanes, i, n = len(lane), arm % len(lane), size(p.task.links)
    live, at, asked = _only(lane, i), start_at(0, n), request_at(0, n, n)
    for k in range(0, size(p.model.n) * lanes, lanes):
        w.q[k + i], w.v[k + i], w.a[k + i], w.b[k + i] = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        angle = draw(p.stream, arm, p.ranges.target, k)
        record[(GOAL + k) * lanes + i] = _given(p.request[asked.goals + k], angle)
        action[k * lanes + i] = own[at.angles + k]
    stand(lane, p.model, live, record[GOAL * lanes : (GOAL + n) * lanes], None, w.q, w.v)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    for d in range(size(p.task.targets)):
        record[(TARGET + d) * lanes + i] = poses[(SPACE_POSE.end * (n - 1) + SPACE_POSE.tip + d) * lanes + i]
    stand(lane, p.model, live, action, None, w.q, w.v)


@kernel
def _swing(lane, p, i, live, own, par, angles, w):
    """The arm in lane i at these joint angles, moving as in the modes of its amplitudes and with their energy. These
    are modes at other angles, so that joints would swing: v less (M + c K)^-1 M v has no momentum of a joint, for to
    turn one does not strain the arm, and of a vibration as much as c is long beside the square of its period."""
    n, lanes, at, shake, asked = size(p.model.n), len(lane), start_at(0, size(p.task.links)), p.ranges.shake, 0.0
    for k in range(n):
        rate = 0.0
        for mode in range(_MODES):
            rate += shake[_MODES * k + mode] * own[at.vibration + mode]
        w.b[k * lanes + i] = rate
    stand(lane, p.model, live, angles, w.b, w.q, w.v)
    for k in range(n):
        store(w.v0, k, splat(lane, 0.0))
        store(w.a0, k, load(lane, w.v, k) * live)
    assemble(lane, p.model, par, State(w.q, w.v0, w.a0), w.u, Weights(1.0, 0.0, shake[_MODES * (n + 1)]), w.r, w.S)
    copy_rows(lane, n, w.r, w.b0)
    assemble(lane, p.model, par, State(w.q, w.v0, w.v0), w.u, RESIDUAL_ALONE, w.r, w.S)
    for k in range(n):
        store(w.r, k, load(lane, w.b0, k) - load(lane, w.r, k))
    solve_known(lane, p.model, None, w, True)
    for k in range(i, n * lanes, lanes):
        w.v[k], w.b[k] = w.v[k] - w.r[k], 0.0
    for mode in range(_MODES):
        asked += shake[_MODES * n + mode] * own[at.vibration + mode] ** 2
    store(w.r, 0, energy(lane, p.model, par, w.q, w.v)[0])
    scale = math.sqrt(asked / max(w.r[i], 1e-300))
    for k in range(i, n * lanes, lanes):
        w.v[k] = w.v[k] * scale


@kernel
def _start_info(lanes, p, arm, record, info):
    """The info of an arm before anything has happened: zeros, but for what is drawn; the joint angles that reach its
    target."""
    task, i, at = p.task, arm % lanes, info_of(p.task)
    for k in range(i, at.further * lanes, lanes):
        info[k] = 0.0
    info[at.in_range * lanes + i], info[at.error * lanes + i] = 1.0, p.estimate
    mine = stack(_ONE, task.links + _RECORD)
    for k in range(GOAL + size(task.links)):
        mine[k] = record[k * lanes + i]
    aim(task, mine)
    for k in range(GOAL, GOAL + size(task.links)):
        record[k * lanes + i] = mine[k]
    record[HOLD * lanes + i] = 0.0


@kernel
def _first_observation(lane, p, arm, live, record, action, poses, seen, info):
    """The first observation of an episode; no reward yet."""
    lanes, i, at = len(lane), arm % len(lane), info_of(p.task)
    observe_state(lane, p, True, poses, record, seen)
    judge(lane, p.task, poses, action, record, live, info)
    for k in range(GOAL + size(p.task.links), GOAL + size(p.task.links) + size(p.task.acted)):
        record[k * lanes + i] = 0.0
    for k in range(at.terms, at.terms + size(p.task.terms)):
        info[k * lanes + i] = 0.0
    write_observation(lane, p, arm, poses, record, seen, True)
    draw_lateness(p.actuator, p.stream, arm, record, lanes)
    record_drawn(lanes, p, i, record, info)
    p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)


@kernel
def finish_guided(address, arm, code):
    """The outcome of a period of an arm that is moved elsewhere, whose poses, action and gauges stand in its block.

    code: status of the period, or -1 for an episode's start.
    """
    p = follow(address)
    lane, g = p.lane, arm // len(p.lane)
    block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
    _, poses, record, action, seen, info, _, _ = sections(p.layout, block)
    live, outcome = _only(lane, arm % len(lane)), stack(lane, OUTCOME)
    store(outcome, 0, splat(lane, 0.0))
    store(outcome, 1, splat(lane, 0.0))
    if code < OK:
        _start_info(len(lane), p, arm, record, info)
        _first_observation(lane, p, arm, live, record, action, poses, seen, info)
        return
    if code == OK:
        observe_state(lane, p, False, poses, record, seen)
        reward(lane, p, live, poses, action, record, info, outcome)
    finish_arm(lane, p, arm, outcome, float(code), poses, record, seen, info)
