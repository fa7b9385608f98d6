"""Linear models of many arms at once.

A linear model consists of rates (or the state a period later) and outputs, with their derivatives with respect to state
and torques.

The arms are elasticas whose joints are ideal. Joint and node coordinates are independent, so that q, v and torques
determine the accelerations. A state consists of the coordinates q, then the rates v. The joint torques are constant
over the period.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import dereference, kernel, lane_count, load, size, splat, store
from ..physics.integrator.newton import newmark_slopes
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.step_derivatives import factor_step_end, step_tangents
from ..physics.integrator.transitions import before_jump, copy_state, jump_tangents
from ..physics.integrator.work import unpack
from ..physics.layout import POSE
from ..physics.protocol import input_displacements, link_poses
from ..tasks.program import PARAMETERS
from ..tasks.task import deflection
from .derivative import fill_rows


class Linearization(NamedTuple):
    """Data of n arms with N links: z = (q, v, torques) has m numbers, the first s the state; p outputs."""

    lane: tuple[int, ...]  # one zero per lane, for plain numbers
    dual: tuple[int, ...]  # the same lanes for numbers with tangents
    model: Any
    scheme: Any  # the integrator's coefficients
    links: tuple[int, ...]  # N zeros, one per link
    h: float  # length of a step, s
    n_steps: int  # number of steps in a period; 0: compute rates (v, a) instead of the state a period later
    n: int  # number of arms
    work: int  # length of the integrator's work array per lane
    given: np.ndarray  # (n (m + PARAMETERS),): z, then the arm's own parameters
    places: np.ndarray  # (m + PARAMETERS,) int64: offsets of z and the parameters in a block without tangents
    twice: np.ndarray  # (m + PARAMETERS,) int64: offsets of z and the parameters in a block with tangents
    read: np.ndarray  # (s + p,) int64: offsets in a block with tangents: rates or next state, then outputs
    values: np.ndarray  # (n (s + p),): the rates, or the state a period later, then the outputs
    slopes: np.ndarray  # (n (s + p) m,): derivatives of `values` by z
    block: np.ndarray  # scratch blocks in lanes without tangents
    scratch: np.ndarray  # scratch blocks in lanes with tangents


@kernel
def outputs_of(n):
    """Return the number of outputs for n links: joint angles and rates, tip deflections and rates, tip x and y."""
    return 4 * n + 2


@kernel
def linearize(address, first, last):
    """Compute linear models of the arms in groups first ... last - 1. Returns 0.

    address: address of a `Linearization` d. The kernel writes d.values (rates or the state a period later, then the
    outputs) and d.slopes (derivatives of d.values with respect to q, v and torques).
    """
    d = dereference(address)
    at_once = len(d.dual) // len(d.lane) - 1
    for g in range(first, last):
        _group(d.lane, d.dual, d, g, at_once)
    return 0


@kernel
def room(work, lanes, links):
    """Return the length of the memory block of a group: work array, the arms' own parameters, poses and outputs.

    work: length of the work array. lanes: length of the tuple of lanes. links: number of an arm's links.
    """
    return work + (PARAMETERS + POSE.end * links + outputs_of(links)) * lanes


@kernel
def _par(lane, d, block):
    """Return the section of a block with the arms' own parameters."""
    return block[d.work * len(lane) : (d.work + PARAMETERS) * len(lane)]


@kernel
def _read_off(lane, d, block, w):
    """Write the outputs into a block, after the poses.

    The outputs are joint angles (rad), joint rates (rad/s), the links' tip deflections (m, normal to the root's
    tangent) and their rates (m/s), and tip x and y of the last link (m, inertial axes).
    """
    links = size(d.links)
    poses = block[(d.work + PARAMETERS) * len(lane) :]
    out = poses[POSE.end * links * len(lane) :]
    link_poses(lane, d.model, _par(lane, d, block), w.q, w.v, poses)
    for k in range(links):
        normal, _, rate, _, _, _, _, _, _ = deflection(lane, poses, k)
        store(out, 2 * links + k, normal)
        store(out, 3 * links + k, rate)
    tip = POSE.end * (links - 1) + POSE.tip_x
    store(out, 4 * links, load(lane, poses, tip))
    store(out, 4 * links + 1, load(lane, poses, tip + 1))
    # B^T q are joint angles (rad), B^T v their rates (rad/s)
    for rates in range(2):
        input_displacements(lane, d.model, _par(lane, d, block), w.v if rates else w.q, w.y)
        for k in range(links):
            store(out, rates * links + k, load(lane, w.y, k))


@kernel
def _fill(lane, d, places, g, block, w):
    """Copy states, torques and parameters of group g into a block; set tangents to 0 and status flags to OK.

    places: offsets in the block of z and of the parameters. Their values are read from d.given, arm by arm.
    """
    fill_rows(lane, d.n, g, places, d.given, block)
    store(w.flag, 0, splat(lane, 0.0))


@kernel
def _seed(lane, d, j, count, block):
    """Set the tangents of columns j ... j + count - 1: tangent c of the number j + c of z becomes 1."""
    for c in range(count):
        for i in range(lane_count(lane)):
            block[d.twice[j + c] + (1 + c) * lane_count(lane) + i] = 1.0


@kernel
def _group(lane, wide, d, g, at_once):
    """Linearize the arms of group g: values in lanes without tangents, `at_once` columns in each block with tangents.

    wide: the lanes with tangents. The outputs are computed at the start of the period.
    """
    model, n, links = d.model, size(d.model.n), size(d.links)
    block = d.block
    w, par = unpack(lane, model, block, 0), _par(lane, d, block)
    columns, length = 2 * n + links, room(d.work * len(wide), len(wide), links)
    # a of the start: states are q and v alone, so that a follows from the equations
    _fill(lane, d, d.places, g, block, w)
    _read_off(lane, d, block, w)
    restart(lane, model, None, par, block, 0, 0.0, d.h, True)
    # d(accelerations, outputs)/d(q, v, torques): columns side by side in the lanes with tangents
    for j in range(0, columns, at_once):
        both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
        x = unpack(wide, model, both, 0)
        _fill(wide, d, d.twice, g, both, x)
        _seed(wide, d, j, min(at_once, columns - j), both)
        _read_off(wide, d, both, x)
        fresh = splat(wide, 1.0)
        before_jump(lane, wide, model, _par(wide, d, both), w, x, fresh)
        jump_tangents(lane, wide, model, _par(wide, d, both), w, x, d.h, splat(lane, 1.0))
    # steps in lanes without tangents; d(q, v) from the factored S at each step's end
    slopes = newmark_slopes(d.scheme, d.h)
    for _ in range(d.n_steps):
        advance(lane, model, None, par, block, 0, 0.0, d.h, 1, d.scheme, None)
        factor_step_end(lane, model, par, w, slopes)
        for j in range(0, columns, at_once):
            both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
            x = unpack(wide, model, both, 0)
            step_tangents(lane, wide, model, _par(wide, d, both), w, x, slopes, d.scheme, 1)
    # rows of A, B or of a period's map: tangents of the columns j ... j + at_once
    for j in range(0, columns, at_once):
        both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
        x = unpack(wide, model, both, 0)
        copy_state(lane, wide, model, w, x)
        _record(wide, d, g, j, min(at_once, columns - j), columns, both, w.flag)


@kernel
def _record(lane, d, g, j, count, columns, both, flag):
    """Copy values and columns j ... j + count - 1 of group g from a block with tangents into d.values and d.slopes.

    flag: status of each lane; the first value of an arm that failed becomes nan.
    """
    rows = d.read.shape[0]
    for i in range(lane_count(lane)):
        arm = g * lane_count(lane) + i
        if arm < d.n:
            for k in range(rows):
                at = d.read[k] + i
                d.values[arm * rows + k] = both[at]
                for c in range(count):
                    d.slopes[(arm * rows + k) * columns + j + c] = both[at + (1 + c) * lane_count(lane)]
            if flag[i] != 0.0:
                d.values[arm * rows] = np.nan
