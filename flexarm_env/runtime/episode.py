"""One control period of a batch of arms: from actions to observations, rewards and info.

A `tasks.program.Program` contains all data of the batch; compiled code receives its address (`compiler.entry`).
Arms are advanced in groups of L = len(lane) lanes. Row g of `block` is the memory of arms g L ... g L + L - 1;
`program.Block` names its sections. In an array of lanes, number k of the arm in lane i has the index k L + i. Actions,
observations, rewards, flags and streams of random numbers are stored arm by arm, without lanes.

Arguments that recur in this package
    p         the `Program`;  g: number of the group;  w: the integrator's `Work`, views of the group's block
    par       (PARAMETERS + ..., lanes) each arm's own parameters (`physics.model.OWN`)
    poses     (links, POSES, lanes) m, rad and rates, inertial axes
    record    (RECORD, lanes) memory of the episode besides the state
    action    (joints, lanes) actions clipped to [-1, 1]
    seen      (entries, lanes) observation, divided by the scales
    info      (INFO, lanes);  live: 1 in lanes whose info is written
    saved     (SAVED, lanes) state at the start of the period

An arm whose Newton iteration fails is restored to the start of the period and reported to the caller. The caller
repeats the period of that arm alone, because a single arm can halve its steps. Arms in all other lanes keep their
results.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiler import (
    Lanes,
    absolute,
    dereference,
    entry_point,
    kernel,
    noinline,
    select_lt,
    size,
    stack,
)
from ..physics.integrator.work import Work, unpack
from ..physics.layout import BEYOND, DISSIPATED, WORK_DONE
from ..physics.model import NEWTON_FAILED, NOT_FINITE, OK, OUT_OF_RANGE
from ..physics.protocol import energy, input_displacements, out_of_range, task_poses
from ..tasks.own_terms import judge_with_terms
from ..tasks.program import (
    ACTION_NOT_FINITE,
    FRESH,
    GUIDED,
    JOINT_LIMIT,
    MODE,
    OVER,
    PERIODS,
    PERIODS_ALLOWED,
    RETRY,
    RUNNING,
    SUCCESS,
    energies_at,
    record_at,
    sections,
)
from ..tasks.task import info_of, observe, put_info
from ..tasks.track import look_ahead, move_targets
from .energy_balance import close_account, open_account
from .events import draw_pushes, record_events
from .fitted import record_step_error
from .guided import motions_of, move, moved_mode, record_motion_torques
from .keep_out import record_clearance
from .keeping import restore_lane, save_lanes
from .motors import draw_lateness, record_delay
from .sensors import read_gauges, record_motor_angles, write_observation
from .touch import open_contacts, put_contacts, record_contact_forces

OUTCOME = (0, 0)
"""Size of the array `outcome`, which has two rows of lanes: the reward, and 1 where a joint is beyond its limits
(otherwise 0).
"""


@entry_point
def step(address, first, last):
    """Advance groups first ... last - 1 by one control period; return the number of arms that the caller must handle.

    address: address of a `tasks.program.Program`. A group consists of the arms in the lanes of one memory block. The
    caller must handle an arm if its episode has ended, if it follows prescribed motions (mode GUIDED), or if its Newton
    iteration failed in a group of several lanes and the period must be repeated for this arm alone.
    """
    p = dereference(address)
    count = 0
    for g in range(first, last):
        block = p.block[g * p.layout.row : (g + 1) * p.layout.row]
        count += advance_group(p.lane, p, g, block, unpack(p.lane, p.model, block, motions_of(p.guide)))
    return count


@noinline
def advance_group(lane, p, g, block, w):
    """Advance group g by one control period, from its actions to observation, reward and info.

    # p, g      `Program`, number of the group
    # block     memory of the group, all sections of `program.Block`: in and out
    # w         integrator state of the group, views of `block`: in and out
    # out       p.observation, p.reward, p.terminated, p.truncated and p.table, rows of the group's arms
    Returns the number of arms that have ended, follow prescribed motions, or must be repeated alone.
    """
    par, poses, record, action, seen, info, saved, scratch = sections(p.layout, block)
    outcome = stack(lane, OUTCOME)
    # draws and payload changes come before the save, so that a repeated period does not draw again
    read_actions(lane, p, g, action, record, w.flag)
    open_account(lane, p, par, record, w)
    draw_pushes(lane, p, g, record, w)
    open_contacts(lane, p.model, par, w)
    save_lanes(w, record, saved)
    # q, v, a a period later; then E - E_0 - W against its bound
    move(lane, p, p.models, p.model, 1, par, poses, record, action, saved, scratch, block, w)
    close_account(lane, p, par, record, saved, w)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    # targets move before the observation, which shows the target that the next action is for
    move_targets(lane, p.reference, p.task, p.period, record)
    observe_state(lane, p, False, poses, record, seen)
    observe_material(lane, p, par, record, w, seen)
    live = find_sound(lane, p.entries, w.flag, seen)
    put_contacts(lane, p, w, live, info)
    reward(lane, p, live, poses, action, record, info, outcome)
    # info comes last, because clearance and energies are those of the final state
    record_clearance(lane, p, g, w.q, live, info)
    record_period(lane, p, par, record, scratch, w, live, info, outcome)
    return finish(lane, p, g, w, poses, record, seen, info, saved, outcome)


@kernel
def read_actions(lane, p, g, action, record, flag):
    """Copy the actions of group g into lanes, clip them to [-1, 1], and set each arm's status flag.

    # in        p.action (arms x joints,) float32, arm by arm;  p.n, number of arms;  record.mode
    # out       action (joints, lanes);  flag (lanes,) status
    flag: OK if the arm will be advanced; RETRY in a lane without an arm or with an arm of another mode;
    ACTION_NOT_FINITE where an entry of the action is not finite. An entry that is not finite is replaced by 0.
    """
    lanes, n_joints, moved = len(lane), size(p.task.links), moved_mode(p.guide)
    for i in range(lanes):
        arm = g * lanes + i
        code = float(RETRY)
        if arm < p.n:
            if record[MODE * lanes + i] == moved:
                code = float(OK)
            for k in range(n_joints):
                a = float(p.action[arm * n_joints + k])
                # joints with a prescribed motion have no action
                if p.guide is not None:
                    a = a if p.guide.free[k] > 0.5 else 0.0
                if not math.isfinite(a):
                    a = 0.0
                    if code == OK:
                        code = float(ACTION_NOT_FINITE)
                action[k * lanes + i] = min(1.0, max(-1.0, a))
        flag[i] = code


@kernel
def observe_state(lane, p, first, poses, record, seen):
    """Write the true observation without strain gauges into `seen`: entries divided by their scales, clipped to +-10.

    first: True when the episode begins, False after a period that record.periods does not count yet.
    # in        poses of the links (inertial axes);  record: target, path, periods done
    # out       seen (entries, lanes): entries of the task, then entries for a moving target
    """
    observe(lane, p.task, poses, record, seen)
    look_ahead(lane, p.reference, p.task, p.period, first, poses, record, seen)


@kernel
def observe_material(lane, p, par, record, w, seen):
    """Write the scaled curvatures at strain gauges into `seen`, and the true values of all other sensors into `record`.

    # in        w.q, coordinates (m, rad)
    # out       seen, last entries (curvature divided by its scale);  record, motor angles (rad) and contact forces in
    #           the channels of encoders, force sensor and contact switch
    """
    read_gauges(lane, p.sensors, p.entries, p.model, w.q, seen)
    record_motor_angles(lane, p.instruments, p.model, par, record, w)
    record_contact_forces(lane, p.instruments, p.model, record, w)


@kernel
def find_sound(lane, entries, flag: Lanes, seen: Lanes):
    """Return 1.0 in lanes of arms that were advanced and have finite observations, otherwise 0.0.

    flag (lanes,): status code of each arm, 0 (OK) after a period without error. NOT_FINITE is written if an entry of
    seen is not finite; a code other than OK is kept. entries: number of rows of `seen` that are checked.
    """
    code = flag[0]
    for k in range(entries):
        finite = select_lt(absolute(seen[k]), np.inf, 0.0, float(NOT_FINITE))
        code = select_lt(code, 0.5, finite, code)
    flag[0] = code
    return select_lt(code, 0.5, 1.0, 0.0)


@kernel
def reward(lane, p, live, poses, action, record, info, outcome: Lanes):
    """Compute the period's reward; write reward terms, success and tip into `info` for running arms (live > 1/2).

    # in        poses of the links (inertial axes, m, rad and rates);  action (joints, lanes), clipped to [-1, 1]
    # in, out   record: number of consecutive instants within the bounds of success, last action
    # out       info: success, tip, deflections, terms;  outcome (2, lanes): the reward, and 1 where a joint is beyond
    #           its limits, otherwise 0
    """
    total, past = judge_with_terms(lane, p.task, poses, action, record, live, info)
    outcome[0] = total
    outcome[1] = past


@kernel
def record_period(lane, p, par, record, scratch, w, live, info, outcome):
    """Write the period's info of running arms (live > 1/2), except success and reward terms, which `reward` writes.

    The info contains events, step error, torques (N m), delay (s), estimated error of the formulation (divided by the
    arm's length), reason 0 (the episode continues), in_range (1 if the model is valid at this deflection, otherwise 0)
    and energies (J).
    # in        scratch, each arm's step error (if steps are fitted);  par, w: the arms' own parameters and state
    # in, out   record, the cost so far;  outcome row 0, the reward, reduced by the price times the period's cost
    """
    at = info_of(p.task)
    record_events(lane, p, par, record, w, live, info, outcome)
    record_step_error(lane, p, scratch, live, info)
    record_torques(lane, p, par, record, w, live, info)
    record_delay(lane, p, record, live, info)
    put_info(lane, live, info, at.error, p.estimate)
    put_info(lane, live, info, at.reason, 0.0)
    inside = select_lt(out_of_range(lane, p.model, par, w.q), 0.5, 1.0, 0.0)
    put_info(lane, live, info, at.in_range, inside)
    record_energies(lane, p, par, w, live, info)


@kernel
def record_torques(lane, p, par, record: Lanes, w: Work, live, info):
    """Write the joint torques (N m) of the period into info.torque, for running arms (live > 1/2).

    With ideal motors the torque is the input w.u. With lagging motors (p.actuator) the torque is that at the end of the
    period. With motors driven by voltage, the back-emf torque is subtracted from w.u: emf (N m s/rad) times the joint's
    rate. The model treats back-emf as viscous friction. w.y is scratch memory. Torques under prescribed motions are
    written by `guided.record_motion_torques`.
    """
    n, at = size(p.task.links), info_of(p.task).torque
    if p.guide is not None:
        record_motion_torques(lane, p, w, live, info, at)
        return
    emf = None
    if p.amplifier is not None:
        emf = p.amplifier.emf
    # w.y <- B^T v, the joint rates (rad/s), because displacements are linear in q
    if emf is not None:
        input_displacements(lane, p.model, par, w.v, w.y)
    for k in range(n):
        torque = w.u[k]
        if p.actuator is not None:
            torque = record[record_at(0, n, size(p.task.acted), 1, 0, 0, 0, 0).torque + k]
        if emf is not None:
            torque = torque - w.y[k] * emf[k]
        put_info(lane, live, info, at + k, torque)


@kernel
def record_energies(lane, p, par, w: Work, live, info):
    """Write energies (J), motor angles (rad) and rates (rad/s), both divided by the gear ratio, into `info`.

    Energies, angles and rates are written for running arms (live > 1/2), if the batch records energies (p.books is not
    None).
    # in        w.q (m, rad), w.v;  w.books, energy account, J;  par, the arms' own parameters
    # scratch   w.y
    # out       info.energies: kinetic, strain, gravity, dissipated, work;  info.motors (2, joints): angles, then rates
    """
    if p.books is not None:
        kinetic, strain, gravity = energy(lane, p.model, par, w.q, w.v)
        at = energies_at(info_of(p.task).energies)
        put_info(lane, live, info, at.kinetic, kinetic)
        put_info(lane, live, info, at.strain, strain)
        put_info(lane, live, info, at.gravity, gravity)
        # with the work of damping forces by strain rates that steps do not resolve, so that the five energies balance
        put_info(lane, live, info, at.dissipated, w.books[DISSIPATED] + w.books[BEYOND])
        put_info(lane, live, info, at.work, w.books[WORK_DONE])
        n, motors = size(p.task.links), info_of(p.task).motors
        # B^T q: angles (rad) on which the joint torques do work, with elastic gears those of the motors; B^T v: rates
        for rates in range(2):
            input_displacements(lane, p.model, par, w.v if rates else w.q, w.y)
            for k in range(n):
                put_info(lane, live, info, motors + rates * n + k, w.y[k])


@kernel
def copy_info(lane, p, g, info: Lanes):
    """Copy the info of group g from lanes into p.table (INFO, groups, lanes), which the caller reads entry by entry."""
    # entry k of group g is k `groups` rows of lanes after entry 0: the table has arms as columns
    column: Lanes = p.table[g * len(lane) :]
    groups = p.block.shape[0] // p.layout.row
    for k in range(info.shape[0]):
        column[k * groups] = info[k]


@kernel
def finish(lane, p, g, w, poses, record, seen, info, saved, outcome):
    """Write the results of group g that the caller reads; return the number of arms that the caller must handle.

    The caller must handle an arm if its episode has ended, if another program moves it (GUIDED), or if its period must
    be repeated. A period is repeated if the arm's Newton iteration failed in a group of several lanes, where steps
    cannot be halved. Arms that must be repeated and arms that were not moved are restored from `saved`, the state at
    the start of the period. The mode of an arm that was just reset changes from FRESH to RUNNING. outcome (2, lanes):
    in row 0 the reward, in row 1 the number 1 if a joint is beyond its limits. seen (entries, lanes): true observation.
    """
    lanes, reason_at, count, moved = len(lane), info_of(p.task).reason * len(lane), 0, moved_mode(p.guide)
    for i in range(lanes):
        arm = g * lanes + i
        if arm >= p.n:
            continue
        mode, reason = record[MODE * lanes + i], w.flag[i]
        # this arm moved and its result counts; in lanes a Newton failure is repeated alone, where steps can be halved
        if mode == moved and not (reason == NEWTON_FAILED and lanes > 1):
            if reason == ACTION_NOT_FINITE:
                # not moved, or to be repeated: back to q, v, a at the period's start
                restore_lane(lanes, i, w, saved, record)
            count += finish_arm(lane, p, arm, outcome, reason, poses, record, seen, info)
            continue
        restore_lane(lanes, i, w, saved, record)
        if mode == moved:
            info[reason_at + i] = float(RETRY)
            count += 1
        # the step after an episode's end only resets, as Gymnasium's next-step autoreset prescribes
        elif mode == FRESH:
            record[MODE * lanes + i] = float(RUNNING)
        elif mode == GUIDED:
            count += 1
    copy_info(lane, p, g, info)
    return count


@kernel
def finish_arm(lane, p, arm, outcome, reason, poses, record, seen, info):
    """Write one arm's reward, flags, info and observation of a period; return 1 if its episode has ended, else 0.

    reason: status code of the period, or ACTION_NOT_FINITE. outcome (2, lanes): in row 0 the reward, in row 1 the
    number 1 if a joint is beyond its limits. The last reward term of an episode that fails is the failure weight. The
    other terms are 0, unless a joint limit ended the episode.
    # in        arm, number in the batch;  poses;  seen, the true observation
    # in, out   record: periods done, mode, memory of sensors and motors
    # out       p.reward, p.terminated, p.truncated, p.observation of the arm;  info in its lane
    """
    task, lanes, i = p.task, len(lane), arm % len(lane)
    total = outcome[i]
    if reason == OK and outcome[lanes + i] > 0.5:
        reason = float(JOINT_LIMIT)
    n_terms, at = size(task.terms), info_of(task)
    # the sensors read only an arm that moved; otherwise the last observation stays and the reward is 0
    if reason == OK or reason == JOINT_LIMIT:
        write_observation(lane, p, arm, poses, record, seen, False)
        draw_lateness(p.actuator, p.stream, arm, record, lanes)
    else:
        info[SUCCESS * lanes + i] = 0.0
        for k in range(at.terms, at.terms + n_terms):
            info[k * lanes + i] = 0.0
        total = 0.0
    if reason == OUT_OF_RANGE:
        info[at.in_range * lanes + i] = 0.0
    # last term: minus the failure's weight in the period in which the arm fails, otherwise 0
    lost = 0.0
    if reason != OK:
        lost = -task.weights[n_terms - 1]
    info[(at.terms + n_terms - 1) * lanes + i] = lost
    info[at.reason * lanes + i] = reason
    # truncated once periods >= periods_allowed; an arm that fails in that period is terminated as well
    steps = record[PERIODS * lanes + i] + 1.0
    record[PERIODS * lanes + i] = steps
    over = steps > record[PERIODS_ALLOWED * lanes + i] - 0.5
    info[at.reward * lanes + i] = total + lost
    info[at.truncated * lanes + i] = 1.0 if over else 0.0
    p.reward[arm] = total + lost
    p.terminated[arm] = np.uint8(reason != OK)
    p.truncated[arm] = np.uint8(over)
    if over or reason != OK:
        record[MODE * lanes + i] = float(OVER)
        return 1
    return 0
