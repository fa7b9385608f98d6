"""One control period and its derivative: rows of numbers, an arm each, in place of a batch's blocks.

A row of `Derivative.state` holds all that an arm's period depends on: first what moves, X numbers that derivatives are
taken by and of, then what is given. The period is that of `episode`, without what an environment notes of it: from the
action to the torques, the steps, the observation and the reward. Its derivative, `jacobian`, is D = X + A columns of
X + O + 1 rows: what the end's numbers that move, the observation's entries and the reward change by.

`tangents` goes through the period with dual lanes, some columns at a time: whatever a period is made of is
differentiated as it is computed, Newton's solution by the implicit function theorem (`physics.integrator.newton`).
`implicit` has the same in less time where nothing but a step's equations decides what it comes to.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import arms, follow, kernel, load, size, splat, store
from ..physics.integrator.work import unpack
from ..physics.model import OK
from ..physics.protocol import task_poses
from ..tasks.program import PERIODS, Block, Program, sections
from ..tasks.task import info_of, judge
from ..tasks.track import move_targets
from .episode import observe_material, observe_state
from .events import change_payloads
from .fitted import FITS, TAKEN, move
from .guided import follow_motions
from .keeping import keep
from .sensors import measure


class Derivative(NamedTuple):
    """A batch's program with rows to work on: S numbers in a state, X of them moving, A joints, O entries observed."""

    lane: tuple[int, ...]
    dual: tuple[int, ...]
    program: Program
    guide: Any  # `guided.Guided` of an arm that follows motions, alone; or None
    plain: Block  # sections of a block of `lane`
    both: Block  # of `dual`
    columns: int  # X + A
    moving: int  # X
    passes: int  # of the solution for a step's tangents: 1 where its matrix is exact
    places: np.ndarray  # (S,) int64: where a state's entries are in a plain block
    twice: np.ndarray  # likewise in a dual one
    chosen: np.ndarray  # (O,) int64: entries observed, of all that there are to be seen
    n: int
    state: np.ndarray  # (n S,)
    action: np.ndarray  # (n A,), within +-1
    after: np.ndarray  # (n S,): the state a period later
    observation: np.ndarray  # (n O,)
    reward: np.ndarray  # (n,)
    failed: np.ndarray  # (n,) uint8: status
    past: np.ndarray  # (n,) uint8: 1 where a joint is beyond its limits
    level: np.ndarray  # (n,): halvings of the steps that the last period took, where they are fitted
    jacobian: np.ndarray  # (n (X + O + 1) (X + A),)
    state_bar: np.ndarray  # (n S,): cotangents, in and out
    observation_bar: np.ndarray  # (n O,): in
    reward_bar: np.ndarray  # (n,): in
    action_bar: np.ndarray  # (n A,): out
    bars: np.ndarray  # (groups, plain.row)
    tape: np.ndarray  # (groups, room)
    room: int
    block: np.ndarray  # (groups, plain.row)
    scratch: np.ndarray  # (groups, both.row)


@kernel
def step(address, first, last):
    """The period of groups first ... last - 1."""
    return _values(follow(address), first, last, (0,))


@kernel
def observe(address, first, last):
    """What is to be seen of groups first ... last - 1 as they are."""
    return _values(follow(address), first, last, None)


@kernel
def tangents(address, first, last):
    """The derivative of the period of groups first ... last - 1."""
    return _columns(follow(address), first, last, (0,))


@kernel
def observation_tangents(address, first, last):
    """The derivative of what is to be seen of groups first ... last - 1."""
    return _columns(follow(address), first, last, None)


@kernel
def _values(d, first, last, moves):
    """Of a period where `moves` is a tag, otherwise of the arms as they are."""
    for g in range(first, last):
        _values_of(d, first, g, moves)
    return 0


@kernel
def _values_of(d, first, g, moves):
    """Likewise of group g, in the room of group `first`."""
    p, block = d.program, d.block[first * d.plain.row : (first + 1) * d.plain.row]
    fill(d.lane, d, d.places, d.plain, g, block)
    _go(d.lane, p, d.guide, p.models, p.model, 1, d.plain, block, unpack(d.lane, p.model, block, 0), moves, False)
    if p.models is not None:
        for i in range(len(d.lane)):
            if g * len(d.lane) + i < d.n:
                d.level[g * len(d.lane) + i] = block[d.plain.end + TAKEN * len(d.lane) + i]
    write_outcome(d.lane, d, d.places, d.plain, g, block)


@kernel
def _columns(d, first, last, moves):
    """Likewise the derivative, some columns at a time. Where steps are fitted, each arm's are as many as it took."""
    p, block = d.program, d.scratch[first * d.both.row : (first + 1) * d.both.row]
    for g in range(first, last):
        if p.models is None or moves is None:
            _all_columns(d, p.model, 1, -1, g, block, moves)
            write_outcome(d.dual, d, d.twice, d.both, g, block)
        else:
            _values_of(d, first, g, moves)
            for k in range(FITS):
                if _taken(d, k, g):
                    _all_columns(d, p.models[k], 2**k, k, g, block, moves)
    return 0


@kernel
def _taken(d, k, g):
    """Whether an arm of group g took k halvings."""
    for arm in range(g * len(d.lane), min((g + 1) * len(d.lane), d.n)):
        if d.level[arm] == k:
            return True
    return False


@kernel
def _all_columns(d, model, parts, level, g, block, moves):
    if d.guide is None:
        _some_columns(d, model, parts, level, g, 0, d.columns, block, moves, False)
    else:  # any other torque than the last is a kink: hence by the action, with a start anew
        _some_columns(d, model, parts, level, g, d.moving, d.columns, block, moves, True)
        _some_columns(d, model, parts, level, g, 0, d.moving, block, moves, False)


@kernel
def _some_columns(d, model, parts, level, g, begin, end, block, moves, anew):
    for j in range(begin, end, at_once(d)):
        last, w = min(j + at_once(d), end), unpack(d.dual, model, block, 0)
        fill(d.dual, d, d.twice, d.both, g, block)
        seed(d.dual, d, j, last, block)
        _go(d.dual, d.program, d.guide, None, model, parts, d.both, block, w, moves, anew)
        take_columns(d.dual, d, level, g, j, last, block)


@kernel
def at_once(d):
    """Columns that a dual lane carries."""
    return len(d.dual) // len(d.lane) - 1


@kernel
def _arm(lane, n, g, i):
    """Whose numbers lane i of group g has: without an arm of its own the first one's."""
    arm = g * arms(lane) + i
    return arm if arm < n else g * arms(lane)


@kernel
def fill_rows(lane, n, g, places, rows, block):
    """Rows of numbers of the arms of group g, of n in all, to their places, tangents 0."""
    count = places.shape[0]
    for k in range(count):
        store(block[places[k] :], 0, splat(lane, 0.0))
    for i in range(arms(lane)):
        arm = _arm(lane, n, g, i)
        for k in range(count):
            block[places[k] + i] = rows[arm * count + k]


@kernel
def fill(lane, d, places, layout, g, block):
    """States and actions of group g into a block, tangents 0. Lanes without an arm are like the first."""
    joints = size(d.program.task.links)
    for k in range(layout.record, layout.action):
        block[k] = 0.0
    fill_rows(lane, d.n, g, places, d.state, block)
    for k in range(joints):
        store(block[layout.action :], k, splat(lane, 0.0))
    for i in range(arms(lane)):
        arm = _arm(lane, d.n, g, i)
        for k in range(joints):
            block[layout.action + k * len(lane) + i] = d.action[arm * joints + k]
    store(unpack(lane, d.program.model, block, 0).flag, 0, splat(lane, float(OK)))


@kernel
def seed(lane, d, first, last, block):
    """Tangents of 1: of a number of the state, or of the action, for columns first ... last - 1."""
    for j in range(first, last):
        at = d.both.action + (j - d.moving) * len(lane)
        if j < d.moving:
            at = d.twice[j]
        at += (1 + j - first) * arms(lane)
        for i in range(arms(lane)):
            block[at + i] = 1.0


@kernel
def _go(lane, p, guide, models, model, parts, layout, block, w, moves, anew):
    """One control period of the arms in a block, where `moves` is a tag; and what is to be seen then. anew: see
    `guided.follow_motions`."""
    if moves is not None:
        par, poses, record, action, _, _, saved, scratch = sections(layout, block)
        if guide is None:
            change_payloads(lane, p, par, record, w)
            keep(w, record, saved)
            move(lane, p, models, model, parts, par, poses, record, action, saved, scratch, block, w)
        else:
            follow_motions(lane, guide, p, model, par, record, action, w, anew)
        close(lane, p, layout, block, w)
    else:
        see(lane, p, layout, block, w)


@kernel
def close(lane, p, layout, block, w):
    """A period's end: targets move on, and what is to be seen is read by the sensors, without noise."""
    poses, record = block[layout.poses : layout.record], block[layout.record : layout.action]
    move_targets(lane, p.reference, p.task, p.period, record)
    store(record, PERIODS, load(lane, record, PERIODS) + 1.0)
    see(lane, p, layout, block, w)
    for i in range(arms(lane)):
        measure(lane, p, None, i, poses, record, block[layout.seen : layout.info], False)


@kernel
def see(lane, p, layout, block, w):
    """Poses, the observation and the reward of the arms in a block."""
    par, poses, record, action, seen, info, _, _ = sections(layout, block)
    task_poses(lane, p.model, par, w.q, w.v, poses)
    observe_state(lane, p, True, poses, record, seen)
    observe_material(lane, p, par, record, w, seen)
    reward, past = judge(lane, p.task, poses, action, record, splat(lane, 1.0), info)
    store(info, info_of(p.task).reward, reward)
    store(info, info_of(p.task).truncated, past)


@kernel
def write_outcome(lane, d, places, layout, g, block):
    """The outcome of group g into the rows."""
    count, entries, at = places.shape[0], d.chosen.shape[0], info_of(d.program.task)
    flag = unpack(lane, d.program.model, block, 0).flag
    for i in range(arms(lane)):
        arm = g * arms(lane) + i
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
    """Tangents of group g into columns first ... last - 1 of the arms' Jacobians; level: of those that took so many
    halvings, or -1."""
    entries, at, columns = d.chosen.shape[0], info_of(d.program.task), d.columns
    for i in range(arms(lane)):
        arm = g * arms(lane) + i
        if arm < d.n and (level < 0 or d.level[arm] == level):
            row = arm * (d.moving + entries + 1) * columns + first
            for k in range(d.moving + entries + 1):
                place = d.both.info + at.reward * len(lane)
                if k < d.moving:
                    place = d.twice[k]
                elif k < d.moving + entries:
                    place = d.both.seen + d.chosen[k - d.moving] * len(lane)
                for j in range(last - first):
                    d.jacobian[row + j] = block[place + (1 + j) * arms(lane) + i]
                row += columns
