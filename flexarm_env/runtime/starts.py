"""Starts of episodes: draw an arm from its random stream, set its initial state and observe it."""

from __future__ import annotations

import math

import numpy as np

from ..compiler import dereference, kernel, load, noinline, size, splat, stack, store, store_lane
from ..physics.contact.moving import start_obstacles
from ..physics.integrator.work import copy_rows, solve_unknown_rows, unpack
from ..physics.layout import SPACE_POSE
from ..physics.model import EI_Y_FACTOR, GJ_FACTOR
from ..physics.protocol import RESIDUAL_ALONE, State, Weights, assemble, energy, set_joint_configuration, task_poses
from ..tasks.attainable import MOST_DRAWS
from ..tasks.own_terms import judge_with_terms
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
    request_at,
    sections,
    start_at,
)
from ..tasks.starts import FACTOR
from ..tasks.stream import draw, uniform
from ..tasks.task import aim, info_of
from ..tasks.track import start_path
from .draws import MODES, draw_free, draw_free_goal, draw_held, draw_more, draw_start, given, place
from .episode import advance_group, copy_info, observe_material, observe_state, record_energies, record_torques
from .events import draw_events
from .guided import motions_of, start_motions
from .keep_out import record_clearance
from .motors import draw_delay, draw_lag, draw_lateness, record_delay
from .sensors import draw_age, record_drawn, write_observation
from .touch import is_free, put_contacts, start_contacts

_ONE, _RECORD, _START = (0,), (0,) * GOAL, (0,) * START.offsets(0, 0).end


@kernel
def start_episodes(address, mode, count):
    """Start new episodes of the arms p.queue[0 ... count - 1], each drawn from the arm's own random stream.

    address: address of a `Program`. mode: new mode of the arms: RUNNING (the next step moves the arm), FRESH
    (the next step skips the arm) or GUIDED (the arm follows prescribed motions). count: number of arms in the queue.
    """
    p = dereference(address)
    for k in range(count):
        arm = p.queue[k]
        g = arm // len(p.lane)
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        _start(p.lane, p, arm, mode, block, unpack(p.lane, p.model, block, 0))


@noinline
def _start(lane, p, arm, mode, block, w):
    """Start a new episode of one arm: draw it, set its state and record, write its first observation.

    arm: index in the batch. mode: RUNNING, FRESH or GUIDED, for record.mode. All other lanes of the group keep their
    numbers.
    # block     memory of the arm's group; parameters, poses, record, action, seen and info are written
    # w         q (m, rad), v, a, b, u and books of the lane are written; w.r, w.S, w.v0, w.a0, w.b0 are scratch
    """
    task, lanes, i, n_joints = p.task, len(lane), arm % len(lane), size(p.task.links)
    par, poses, record, action, seen, info, _, _ = sections(p.layout, block)
    own, at = stack(_ONE, task.links + _START), start_at(0, n_joints)
    # own: a `START` of this arm without lanes, because draws branch arm by arm
    draw_start(task, p.ranges, p.stream, p.request, arm, own)
    if p.ranges.free is not None and p.ranges.pose is not None:
        draw_free(lane, p, arm, own, par, w)
    # record: all zero but for the numbers drawn and the periods allowed, which a reset sets
    limit = record[PERIODS_ALLOWED * lanes + i]
    for k in range(record.shape[0] // lanes):
        record[k * lanes + i] = 0.0
    record[PERIODS_ALLOWED * lanes + i], record[MODE * lanes + i] = limit, float(mode)
    record[TORQUE_FACTOR * lanes + i] = own[at.factors + FACTOR.torque_constant]
    record[TARGET * lanes + i], record[(TARGET + 1) * lanes + i] = own[at.target], own[at.target + 1]
    # par of this arm, from the drawn factors; u = 0
    for k in range(PARAMETERS):
        par[k * lanes + i] = own[at.parameters + k]
    for k in range(w.u.shape[0] // lanes):
        w.u[k * lanes + i] = 0.0
    # q: straight links at the drawn joint angles, in the plane by a table of each row (`assembly`)
    if p.ranges.pose is not None:
        place(lanes, i, p.ranges.pose, p.ranges.shake, n_joints, own, size(p.model.n), w.q, w.v, w.a, w.b)
    else:
        par[EI_Y_FACTOR * lanes + i] = p.ranges.nominal[EI_Y_FACTOR] * own[at.factors + FACTOR.EI]
        par[GJ_FACTOR * lanes + i] = p.ranges.nominal[GJ_FACTOR]
        _place_in_space(lane, p, arm, own, par, poses, record, action, w)
    if p.ranges.more is not None:
        draw_more(p, lanes, i, arm, own[at.factors : at.parameters], par)
    if p.ranges.pose is None and p.ranges.shake is not None:
        _swing(lane, p, i, _only(lane, i), own, par, action, w)
    start_obstacles(lane, p.model, w, i)
    # goal <- initial joint angles: `aim` finds the posture nearest to them that reaches the target
    for k in range(n_joints):
        action[k * lanes + i] = 0.0
        if p.ranges.pose is not None:
            record[(GOAL + k) * lanes + i] = own[at.angles + k]
    for k in range(w.books.shape[0] // lanes):
        w.books[k * lanes + i] = 0.0
    # target, poses, info: the sequence of draws from the stream is a part of the specification
    if p.reference is not None:
        start_path(p.reference, task, p.stream, arm, record, lanes)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    start_contacts(lane, p, par, w)
    observe_material(lane, p, par, record, w, seen)
    live = _only(lane, i)
    for k in range(info_of(task).further * lanes + i, info.shape[0], lanes):
        info[k] = 0.0
    _start_info(lanes, p, arm, record, info)
    draw_delay(p.actuator, task, p.stream, arm, record, lanes)
    draw_lag(p, arm, record, info, lanes)
    draw_age(p, arm, record, lanes)
    record_delay(lane, p, record, live, info)
    draw_events(lanes, p, arm, par, record, info)
    record_clearance(lane, p, arm // lanes, w.q, live, info)
    put_contacts(lane, p, w, live, info)
    # drawn factors, so that info tells which arm an episode has
    if size(task.further) > 0:
        for k in range(FACTOR.end):
            info[(info_of(task).further + FURTHER.drawn + k) * lanes + i] = own[at.factors + k]
    record_energies(lane, p, par, w, live, info)
    _first_observation(lane, p, arm, live, record, action, poses, seen, info)
    copy_info(lane, p, arm // lanes, info)


@kernel
def _only(lane, i):
    """Return a mask over lanes: 1.0 in lane i, 0.0 elsewhere."""
    mask = stack(lane, _ONE)
    mask[0] = 0.0
    store_lane(lane, mask, 0, i, 1.0)
    return mask[0]


@kernel
def _place_in_space(lane, p, arm, own, par, poses, record, action, w):
    """Set the state of an arm in space at rest, and its target, the tip's position at drawn joint angles.

    The arm is placed twice: at the goal's joint angles, which give the target, then at its own initial angles.
    # in        own, a `START`; p.request, goals; p.ranges.target, joint angles (rad); par, the arms' own parameters
    # scratch   poses
    # out       w.q, w.v, w.a, w.b; record.goal (rad), record.target (m, inertial axes); all in the arm's lane
    #           action, the initial joint angles, rad
    """
    lanes, i, n = len(lane), arm % len(lane), size(p.task.links)
    live, at, asked = _only(lane, i), start_at(0, n), request_at(0, n, n)
    for k in range(0, size(p.model.n) * lanes, lanes):
        w.q[k + i], w.v[k + i], w.a[k + i], w.b[k + i] = 0.0, 0.0, 0.0, 0.0
    # theta of the goal, drawn; a requested one replaces it below, so that a request leaves the later draws the same
    for k in range(n):
        record[(GOAL + k) * lanes + i] = draw(p.stream, arm, p.ranges.target, k)
        action[k * lanes + i] = own[at.angles + k]
    if p.ranges.attainable is not None:
        draw_held(p, arm, lanes, record)
    for k in range(n):
        record[(GOAL + k) * lanes + i] = given(p.request[asked.goals + k], record[(GOAL + k) * lanes + i])
    # target r (inertial axes): the tip of straight links at the goal angles
    set_joint_configuration(lane, p.model, live, record[GOAL * lanes : (GOAL + n) * lanes], None, w.q, w.v)
    if p.ranges.free_targets is not None:
        if math.isnan(p.request[asked.goals]):
            draw_free_goal(lane, p, arm, live, record, par, w)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    for d in range(size(p.task.targets)):
        record[(TARGET + d) * lanes + i] = poses[(SPACE_POSE.end * (n - 1) + SPACE_POSE.tip + d) * lanes + i]
    # q <- straight links at the initial angles, which `action` holds meanwhile because u = 0 here
    set_joint_configuration(lane, p.model, live, action, None, w.q, w.v)
    if p.ranges.free is not None:
        if math.isnan(p.request[asked.angles]):
            for _ in range(MOST_DRAWS):
                if is_free(lane, p, par, w, i):
                    break
                straight = uniform(p.stream, arm) < p.ranges.straight[0]
                for k in range(n):
                    angle = draw(p.stream, arm, p.ranges.start, k)
                    own[at.angles + k] = 0.0 if straight else angle
                    action[k * lanes + i] = own[at.angles + k]
                set_joint_configuration(lane, p.model, live, action, None, w.q, w.v)


@kernel
def _swing(lane, p, i, live, own, par, angles, w):
    """Set the velocities of an arm in space to a vibration in its modes, with the energy of the drawn amplitudes.

    p.ranges.shake (`envs.vibration.swing`) contains modes about joint angles 0. At other angles their rates would swing
    the joints as well. Therefore

        v <- v - (M + c K)^-1 M v,      c large compared with (T / (2 pi))^2 for every period T,

    which removes the momentum of the joints, because turning a joint does not strain the arm, and almost nothing of a
    vibration. v is then scaled to the kinetic energy sum_m E_m amplitude_m^2. M, K: mass and stiffness matrix. i, live:
    lane of the arm and its mask. own: a `START` with amplitudes (tip deflection / arm's length L). angles: joint
    angles, rad.
    # in        w.q;  shake: rates (n, 3), energies E (3,) J, c (s^2)
    # scratch   w.a0, w.v0, w.b0, w.r, w.S
    # out       w.v, and w.b = 0, in lane i
    """
    n, lanes, at, shake, asked = size(p.model.n), len(lane), start_at(0, size(p.task.links)), p.ranges.shake, 0.0
    # w.b <- joint rates and strain rates of the modes' sum; v follows for straight links at `angles`
    for k in range(n):
        rate = 0.0
        for mode in range(MODES):
            rate += shake[MODES * k + mode] * own[at.vibration + mode]
        w.b[k * lanes + i] = rate
    set_joint_configuration(lane, p.model, live, angles, w.b, w.q, w.v)
    # w.b0 <- residual of accelerations v, w.S <- M + c K; less the residual at rest, M v is left
    for k in range(n):
        store(w.v0, k, splat(lane, 0.0))
        store(w.a0, k, load(lane, w.v, k) * live)
    assemble(lane, p.model, par, State(w.q, w.v0, w.a0), w.u, Weights(1.0, 0.0, shake[MODES * (n + 1)]), w.r, w.S)
    copy_rows(lane, n, w.r, w.b0)
    assemble(lane, p.model, par, State(w.q, w.v0, w.v0), w.u, RESIDUAL_ALONE, w.r, w.S)
    for k in range(n):
        store(w.r, k, load(lane, w.b0, k) - load(lane, w.r, k))
    # w.r <- (M + c K)^-1 M v
    solve_unknown_rows(lane, p.model, None, w, True)
    for k in range(i, n * lanes, lanes):
        w.v[k], w.b[k] = w.v[k] - w.r[k], 0.0
    # scale v to the energy asked for, J; 1e-300 avoids 0 / 0 without a vibration
    for mode in range(MODES):
        amplitude = own[at.vibration + mode]
        asked += shake[MODES * n + mode] * (amplitude * amplitude)
    store(w.r, 0, energy(lane, p.model, par, w.q, w.v)[0])
    scale = math.sqrt(asked / max(w.r[i], 1e-300))
    for k in range(i, n * lanes, lanes):
        w.v[k] = w.v[k] * scale


@kernel
def _start_info(lanes, p, arm, record, info):
    """Write the info of an arm before its first period (zeros, in_range 1, error estimate), and its goal angles.

    arm: index in the batch; lanes: number of arms in a group. info: all fields before `further`. error: the field
    `estimate` of the program, the beam formulation's own error divided by the arm's length. record.target is read.
    Written are record.goal, the joint angles (rad) that reach the target, and record.hold = 0, the number of instants
    within the success bands.
    """
    task, i, at = p.task, arm % lanes, info_of(p.task)
    for k in range(i, at.further * lanes, lanes):
        info[k] = 0.0
    info[at.in_range * lanes + i], info[at.error * lanes + i] = 1.0, p.estimate
    # `aim` is compiled for one arm: its record without lanes
    mine = stack(_ONE, task.links + _RECORD)
    for k in range(GOAL + size(task.links)):
        mine[k] = record[k * lanes + i]
    aim(task, mine)
    for k in range(GOAL, GOAL + size(task.links)):
        record[k * lanes + i] = mine[k]
    record[HOLD * lanes + i] = 0.0


@kernel
def _first_observation(lane, p, arm, live, record, action, poses, seen, info):
    """Write the first observation of an arm's episode; reward 0, neither terminated nor truncated.

    The kernel also draws the delay of the first commands, and writes the drawn sensor delay and gains into info. live:
    1 in the lane of this arm, otherwise 0. The reward is computed for the info of this lane; reward terms and the last
    action are then set to 0.
    """
    lanes, i, at = len(lane), arm % len(lane), info_of(p.task)
    observe_state(lane, p, True, poses, record, seen)
    judge_with_terms(lane, p.task, poses, action, record, live, info)
    for k in range(GOAL + size(p.task.links), GOAL + size(p.task.links) + size(p.task.acted)):
        record[k * lanes + i] = 0.0
    for k in range(at.terms, at.terms + size(p.task.terms)):
        info[k * lanes + i] = 0.0
    write_observation(lane, p, arm, poses, record, seen, True)
    draw_lateness(p.actuator, p.stream, arm, record, lanes)
    record_drawn(lanes, p, i, record, info)
    p.reward[arm], p.terminated[arm], p.truncated[arm] = 0.0, np.uint8(0), np.uint8(0)


@kernel
def guided_period(address, begins):
    """Start the episode of an arm under prescribed motions (begins is 1), or advance it by a period (0).

    address: address of the arm's own `Program`. One program does both, because both need a consistent start.
    """
    p = dereference(address)
    block = p.block[: p.layout.row]
    w = unpack(p.lane, p.model, block, motions_of(p.guide))
    if begins > 0:
        _start_guided(p.lane, p, block, w)
        return 0
    return advance_group(p.lane, p, 0, block, w)


@kernel
def _start_guided(lane, p, block, w):
    """Start an arm under prescribed motions, which the batch has drawn (`start_episodes`), and observe the arm.

    # in        w.q, w.v before the start;  par;  record and action of the start
    # out       w: consistent v, a, b, u and reactions;  poses, seen, info;  p.reward, flags and p.observation
    """
    par, poses, record, action, seen, info, _, _ = sections(p.layout, block)
    start_motions(lane, p, par, w)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    observe_material(lane, p, par, record, w, seen)
    live = _only(lane, 0)
    _start_info(len(lane), p, 0, record, info)
    record_torques(lane, p, par, record, w, live, info)
    record_energies(lane, p, par, w, live, info)
    _first_observation(lane, p, 0, live, record, action, poses, seen, info)
