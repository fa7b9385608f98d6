"""One control period and its derivative by state and action, on rows of numbers instead of a batch's blocks.

A row of `Derivative.state` contains all numbers on which an arm's period depends. The first X numbers of a row are the
moving numbers: the derivatives are computed for these numbers and with respect to them. The constants of the arm follow
in the row. The period is that of `episode`, without info: it computes torques, steps, observation and reward from the
action. The period's derivative, `jacobian`, has D = X + A columns, one per moving number and action, and X + O + 1 rows
per arm: the moving numbers at the end, the observation's entries and the reward.

`tangents` runs the period in lanes with tangents, for several columns in each pass. Every operation is differentiated
when it is computed. Newton's solution is differentiated by the implicit function theorem (`physics.integrator.newton`).
The module `implicit` computes the same derivative faster, but only if a step's result depends on nothing but the step's
equations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiler import dereference, inlined, kernel, lane_count, load, size, splat, store
from ..physics.integrator.work import unpack
from ..physics.model import OK
from ..physics.protocol import task_poses
from ..tasks.own_terms import judge_with_terms
from ..tasks.program import PERIODS, Block, Program, sections
from ..tasks.task import info_of
from ..tasks.track import move_targets
from .episode import observe_material, observe_state
from .events import change_payloads
from .fitted import FITS, TAKEN
from .guided import motions_of, move
from .keeping import save_lanes
from .sensors import measure


class Derivative(NamedTuple):
    """A batch's program and rows of n arms: S numbers of a state, X of them moving, A actions, O observed entries."""

    lane: tuple[int, ...]  # one zero per lane, for plain numbers
    dual: tuple[int, ...]  # the same lanes for numbers with tangents
    program: Program
    plain: Block  # offsets of a block's sections in lanes without tangents
    both: Block  # offsets of a block's sections in lanes with tangents
    columns: int  # X + A, number of columns of the Jacobian
    moving: int  # X, number of moving numbers of a state
    parameters: tuple[int, ...] | None  # a tag if the arms' own parameters are among the moving numbers
    passes: int  # number of linear solutions for a step's tangents; 1 if the step's matrix is exact
    places: np.ndarray  # (S,) int64: offsets of the state's numbers in a block without tangents
    twice: np.ndarray  # (S,) int64: offsets of the state's numbers in a block with tangents
    chosen: np.ndarray  # (O,) int64: indices of the observed entries
    n: int  # number of arms
    state: np.ndarray  # (n S,) states at the start of the period
    action: np.ndarray  # (n A,) actions, in [-1, 1]
    after: np.ndarray  # (n S,) states at the end of the period
    observation: np.ndarray  # (n O,) observed entries, divided by their scales
    reward: np.ndarray  # (n,) reward of the period
    failed: np.ndarray  # (n,) uint8: status code of the period, 0 without failure
    past: np.ndarray  # (n,) uint8: 1 if a joint is beyond its limits
    level: np.ndarray  # (n,): with fitted steps, the last period's steps were h / 2^level
    jacobian: np.ndarray  # (n (X + O + 1) (X + A),) derivatives of results by moving numbers and actions
    state_bar: np.ndarray  # (n S,): cotangents; input: of `after`, output: of `state`
    observation_bar: np.ndarray  # (n O,): input: cotangents of the observation
    reward_bar: np.ndarray  # (n,): input: cotangents of the reward
    action_bar: np.ndarray  # (n A,): output: cotangents of the actions
    bars: np.ndarray  # (groups, plain.row): scratch blocks for cotangents
    step_ends: np.ndarray  # (n n_steps 2 rows,) or empty: q and v at the end of each step
    known: np.ndarray  # (1,): 1 if `step_ends` belong to the states and actions, so that no step is solved again
    tape: np.ndarray  # (groups, room): numbers stored on the forward pass
    room: int  # number of values on the tape of a group
    block: np.ndarray  # (groups, plain.row): scratch blocks in lanes without tangents
    scratch: np.ndarray  # (groups, both.row): scratch blocks in lanes with tangents


@kernel
def step(address, first, last):
    """Advance groups first ... last - 1 by one control period, from d.state and d.action; no derivatives. Returns 0.

    address: address of a `Derivative` d. The function writes d.after, d.observation, d.reward, d.failed, d.past (1 if a
    joint is beyond its limits, otherwise 0) and, with fitted steps, d.level.
    """
    return _values(dereference(address), first, last, (0,))


@kernel
def observe(address, first, last):
    """Observe groups first ... last - 1 in the states d.state, without a step; write d.observation and d.reward.

    address: address of a `Derivative` d. Returns 0.
    """
    return _values(dereference(address), first, last, None)


@kernel
def tangents(address, first, last):
    """Compute d.jacobian of one control period for groups first ... last - 1, in lanes with tangents.

    address: address of a `Derivative` d. Returns 0.
    """
    return _columns(dereference(address), first, last, (0,))


@kernel
def observation_tangents(address, first, last):
    """Compute d.jacobian of the observation in the states d.state, without a step, for groups first ... last - 1.

    address: address of a `Derivative` d, whose fields are read and written.
    """
    return _columns(dereference(address), first, last, None)


@inlined
def _views(lane, p, model, block):
    """Return the integrator's `Work`, views of a block in lanes with or without tangents."""
    return unpack(lane, model, block, motions_of(p.guide))


@kernel
def _values(d, first, last, moves):
    """Advance and observe groups first ... last - 1, or only observe them if moves is None; return 0.

    moves: not None for a step; None to observe only. d: a `Derivative`.
    """
    for g in range(first, last):
        _values_of(d, first, g, moves)
    return 0


@kernel
def _values_of(d, first, g, moves):
    """Advance and observe group g, or only observe it if moves is None, in the memory of group `first`.

    The rows of d.state and d.action are read; the rows of d.after, d.observation, d.reward, d.failed, d.past and
    d.level are written.
    """
    p, block = d.program, d.block[first * d.plain.row : (first + 1) * d.plain.row]
    fill(d.lane, d, d.places, d.plain, g, block)
    _go(d.lane, p, p.models, p.model, 1, d.plain, block, _views(d.lane, p, p.model, block), moves)
    if p.models is not None:
        for i in range(len(d.lane)):
            if g * len(d.lane) + i < d.n:
                d.level[g * len(d.lane) + i] = block[d.plain.end + TAKEN * len(d.lane) + i]
    write_outcome(d.lane, d, d.places, d.plain, g, block)


@kernel
def _columns(d, first, last, moves):
    """Compute Jacobians for groups first ... last - 1: of a period, or of the observation if moves is None.

    With fitted steps a run without derivatives finds each arm's number of halvings k. The model for steps of h / 2^k
    then computes the Jacobian columns of all arms with k halvings.
    """
    p, block = d.program, d.scratch[first * d.both.row : (first + 1) * d.both.row]
    for g in range(first, last):
        # fixed steps: all arms have one model
        if p.models is None or moves is None:
            _all_columns(d, p.model, 1, -1, g, block, moves)
            write_outcome(d.dual, d, d.twice, d.both, g, block)
        else:
            # values first, because each arm's k is known only then; the number of steps is not differentiated
            _values_of(d, first, g, moves)
            # the model of k halvings, because the inertia M* (5.3) depends on h
            for k in range(FITS):
                if _taken(d, k, g):
                    _all_columns(d, p.models[k], 2**k, k, g, block, moves)
    return 0


@kernel
def _taken(d, k, g):
    """Return whether the last period of an arm in group g took steps of h / 2^k."""
    for arm in range(g * len(d.lane), min((g + 1) * len(d.lane), d.n)):
        if d.level[arm] == k:
            return True
    return False


@kernel
def _all_columns(d, model, parts, level, g, block, moves):
    """Compute all columns of group g's Jacobians with one model and `parts` parts of each step.

    level: only arms that took this many halvings; -1: all arms.
    """
    if d.program.guide is None:
        _some_columns(d, model, parts, level, g, 0, d.columns, block, moves)
    else:
        # under motions any change of a torque is a kink: passes with columns of actions start anew (a jump of a)
        _some_columns(d, model, parts, level, g, d.moving, d.columns, block, moves)
        _some_columns(d, model, parts, level, g, 0, d.moving, block, moves)


@kernel
def _some_columns(d, model, parts, level, g, begin, end, block, moves):
    """Compute columns begin ... end - 1 of group g's Jacobians in one pass (at most one column per tangent).

    block: block with tangents, scratch.
    """
    for j in range(begin, end, at_once(d)):
        last, w = min(j + at_once(d), end), _views(d.dual, d.program, model, block)
        # dx/dz_j: tangent 1 in entry j, 0 in all others; after the period the tangents of its outcome
        fill(d.dual, d, d.twice, d.both, g, block)
        seed(d.dual, d, j, last, block)
        _go(d.dual, d.program, None, model, parts, d.both, block, w, moves)
        take_columns(d.dual, d, level, g, j, last, block)


@kernel
def at_once(d):
    """Return the number of Jacobian columns in one pass, which is the number of tangents of each lane."""
    return len(d.dual) // len(d.lane) - 1


@kernel
def arm_in(lane, n, g, i):
    """Return the index of the arm in lane i of group g; for a lane without an arm, that of the group's first."""
    arm = g * lane_count(lane) + i
    return arm if arm < n else g * lane_count(lane)


@kernel
def fill_rows(lane, n, g, places, rows, block):
    """Copy rows of numbers of group g's arms into a block, with tangents 0.

    rows (n count,): `count` numbers for each of n arms, where `count` is the length of `places`. places (count,):
    offsets of the numbers in the block. Lanes without an arm get the numbers of the group's first arm.
    """
    count = places.shape[0]
    for k in range(count):
        store(block[places[k] :], 0, splat(lane, 0.0))
    for i in range(lane_count(lane)):
        arm = arm_in(lane, n, g, i)
        for k in range(count):
            block[places[k] + i] = rows[arm * count + k]


@kernel
def fill(lane, d, places, layout, g, block):
    """Copy states and actions of group g into a block; set tangents to 0 and status flags to OK.

    d: the `Derivative`. places (S,): offsets of the state's numbers in the block. layout: offsets of the block's
    sections. The remaining numbers of the record are set to 0. Lanes without an arm get the numbers of the group's
    first arm.
    """
    joints = size(d.program.task.links)
    # numbers of the record that the state does not contain are 0, so that a period depends on the state alone
    for k in range(layout.record, layout.action):
        block[k] = 0.0
    fill_rows(lane, d.n, g, places, d.state, block)
    for k in range(joints):
        store(block[layout.action :], k, splat(lane, 0.0))
    for i in range(lane_count(lane)):
        arm = arm_in(lane, d.n, g, i)
        for k in range(joints):
            block[layout.action + k * len(lane) + i] = d.action[arm * joints + k]
    store(_views(lane, d.program, d.program.model, block).flag, 0, splat(lane, float(OK)))


@kernel
def seed(lane, d, first, last, block):
    """Set the tangents of Jacobian columns first ... last - 1 in a block: 1 for the column's number, otherwise 0.

    Column j < X is number j of the state, column X + k is action k.
    """
    for j in range(first, last):
        at = d.both.action + (j - d.moving) * len(lane)
        if j < d.moving:
            at = d.twice[j]
        at += (1 + j - first) * lane_count(lane)
        for i in range(lane_count(lane)):
            block[at + i] = 1.0


@kernel
def _go(lane, p, models, model, parts, layout, block, w, moves):
    """Advance the arms in a block by one control period and observe them; if moves is None, only observe them.

    models, model, parts: arguments of `guided.move`. layout: offsets of the block's sections, in lanes with or without
    tangents. w: the integrator's views of the block.
    """
    if moves is not None:
        par, poses, record, action, _, _, saved, scratch = sections(layout, block)
        # m_p changes before the save, as in `episode._period`; then the steps
        change_payloads(lane, p, par, record, w)
        save_lanes(w, record, saved)
        move(lane, p, models, model, parts, par, poses, record, action, saved, scratch, block, w)
        close(lane, p, layout, block, w)
    else:
        see(lane, p, layout, block, w)


@kernel
def close(lane, p, layout, block, w):
    """End a period: move targets, count the period, observe, and replace entries by sensor readings without noise.

    layout: offsets of the block's sections, in lanes with or without tangents. w: the integrator's views of the block.
    """
    poses, record = block[layout.poses : layout.record], block[layout.record : layout.action]
    move_targets(lane, p.reference, p.task, p.period, record)
    store(record, PERIODS, load(lane, record, PERIODS) + 1.0)
    see(lane, p, layout, block, w)
    # stream None: readings without noise, because noise has no derivative
    for i in range(lane_count(lane)):
        measure(lane, p, None, i, poses, record, block[layout.seen : layout.info], False)


@kernel
def see(lane, p, layout, block, w):
    """Compute poses, true observation, reward and joint limits of the arms in a block.

    The reward is written to info.reward. For arms with a joint beyond its limits, info.truncated becomes 1.

    layout: offsets of the block's sections, in lanes with or without tangents. w: the integrator's views of the block.
    """
    par, poses, record, action, seen, info, _, _ = sections(layout, block)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    observe_state(lane, p, True, poses, record, seen)
    observe_material(lane, p, par, record, w, seen)
    reward, past = judge_with_terms(lane, p.task, poses, action, record, splat(lane, 1.0), info)
    store(info, info_of(p.task).reward, reward)
    store(info, info_of(p.task).truncated, past)


@kernel
def write_outcome(lane, d, places, layout, g, block):
    """Copy the results of group g's period from a block into d.after, d.observation, d.reward, d.past and d.failed.

    places (S,): offsets of the state's numbers in the block. layout: offsets of the block's sections. Lanes without an
    arm are not copied.
    """
    count, entries, at = places.shape[0], d.chosen.shape[0], info_of(d.program.task)
    flag = _views(lane, d.program, d.program.model, block).flag
    for i in range(lane_count(lane)):
        arm = g * lane_count(lane) + i
        if arm < d.n:
            for k in range(count):
                d.after[arm * count + k] = block[places[k] + i]
            for k in range(entries):
                d.observation[arm * entries + k] = block[layout.seen + d.chosen[k] * len(lane) + i]
            d.reward[arm] = block[layout.info + at.reward * len(lane) + i]
            d.past[arm] = np.uint8(block[layout.info + at.truncated * len(lane) + i] > 0.5)
            d.failed[arm] = np.uint8(flag[i])


@kernel
def take_columns(lane, d, level, g, first, last, block):
    """Copy the tangents of group g from a block with tangents into columns first ... last - 1 of d.jacobian.

    level: copy only arms whose step was halved `level` times in the period, or all arms if level is -1. Rows of
    d.jacobian are the moving numbers, the observed entries and the reward.
    """
    entries, at, columns = d.chosen.shape[0], info_of(d.program.task), d.columns
    for i in range(lane_count(lane)):
        arm = g * lane_count(lane) + i
        if arm < d.n and (level < 0 or d.level[arm] == level):
            row = arm * (d.moving + entries + 1) * columns + first
            for k in range(d.moving + entries + 1):
                # offset of the row's number in the block with tangents; its tangents follow it
                place = d.both.info + at.reward * len(lane)
                if k < d.moving:
                    place = d.twice[k]
                elif k < d.moving + entries:
                    place = d.both.seen + d.chosen[k - d.moving] * len(lane)
                for j in range(last - first):
                    d.jacobian[row + j] = block[place + (1 + j) * lane_count(lane) + i]
                row += columns
