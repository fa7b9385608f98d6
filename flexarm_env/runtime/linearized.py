"""Linear models of many arms at once: accelerations, or the state a period later, and what is read off, with slopes.

Of elasticas with ideal joints, whose coordinates are independent and whose accelerations follow from them: a state is
q, then v. Torques are held.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..compiler import arms, follow, kernel, load, size, splat, store
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.tangents import copy_state, prepare, restart_tangents, step_tangents
from ..physics.integrator.work import unpack
from ..physics.layout import POSE
from ..physics.protocol import link_poses, ports
from ..tasks.program import PARAMETERS
from ..tasks.task import deflection
from .derivative import fill_rows


class Linearization(NamedTuple):
    """Rows of n arms of N links: z = (q, v, torques), m numbers of which the state has s; p outputs."""

    lane: tuple[int, ...]
    dual: tuple[int, ...]
    model: Any
    scheme: Any
    links: tuple[int, ...]
    h: float  # s
    n_steps: int  # 0: rates in place of a period
    n: int
    work: int  # numbers of a work array, per number of the tag
    given: np.ndarray  # (n (m + PARAMETERS),): z, then the arm's own parameters
    places: np.ndarray  # (m + PARAMETERS,) int64: where these are in a block
    twice: np.ndarray  # likewise in a dual one
    read: np.ndarray  # (s + p,) int64: where in a dual one rates, or the state a period later, are, then the outputs
    values: np.ndarray  # (n (s + p),) of these
    slopes: np.ndarray  # (n (s + p) m,)
    block: np.ndarray
    scratch: np.ndarray  # dual


@kernel
def outputs_of(n):
    """Numbers read off an arm of n links: joint angles, rates, deflections, rates, the tip."""
    return 4 * n + 2


@kernel
def linearize(address, first, last):
    """The models of groups first ... last - 1."""
    d = follow(address)
    at_once = len(d.dual) // len(d.lane) - 1
    for g in range(first, last):
        _group(d.lane, d.dual, d, g, at_once)
    return 0


@kernel
def room(work, lanes, links):
    """Numbers of a block: a work array, parameters, poses and outputs."""
    return work + (PARAMETERS + POSE.end * links + outputs_of(links)) * lanes


@kernel
def _par(lane, d, block):
    return block[d.work * len(lane) : (d.work + PARAMETERS) * len(lane)]


@kernel
def _read_off(lane, d, block, w):
    """Outputs, behind the poses."""
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
    for rates in range(2):
        ports(lane, d.model, _par(lane, d, block), w.v if rates else w.q, w.y)
        for k in range(links):
            store(out, rates * links + k, load(lane, w.y, k))


@kernel
def _fill(lane, d, places, g, block, w):
    """State, torques and parameters of group g."""
    fill_rows(lane, d.n, g, places, d.given, block)
    store(w.flag, 0, splat(lane, 0.0))


@kernel
def _seed(lane, d, j, count, block):
    """Tangents of 1 for `count` columns from j on."""
    for c in range(count):
        for i in range(arms(lane)):
            block[d.twice[j + c] + (1 + c) * arms(lane) + i] = 1.0


@kernel
def _group(lane, wide, d, g, at_once):
    model, n, links = d.model, size(d.model.n), size(d.links)
    block = d.block
    w, par = unpack(lane, model, block, 0), _par(lane, d, block)
    columns, length = 2 * n + links, room(d.work * len(wide), len(wide), links)
    _fill(lane, d, d.places, g, block, w)
    _read_off(lane, d, block, w)
    restart(lane, model, None, par, block, 0, 0.0, d.h, True)
    for j in range(0, columns, at_once):
        both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
        x = unpack(wide, model, both, 0)
        _fill(wide, d, d.twice, g, both, x)
        _seed(wide, d, j, min(at_once, columns - j), both)
        _read_off(wide, d, both, x)
        restart_tangents(lane, wide, model, _par(wide, d, both), w, x)
        for k in range(n):
            store(x.a, k, load(wide, x.r, k))
            store(x.b, k, load(wide, x.r, k))
    slopes = slopes_of(d.scheme, d.h)
    for _ in range(d.n_steps):
        advance(lane, model, None, par, block, 0, 0.0, d.h, 1, d.scheme, None)
        prepare(lane, model, par, w, slopes)
        for j in range(0, columns, at_once):
            both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
            x = unpack(wide, model, both, 0)
            step_tangents(lane, wide, model, _par(wide, d, both), w, x, slopes, d.scheme, 1)
    for j in range(0, columns, at_once):
        both = d.scratch[j // at_once * length : (j // at_once + 1) * length]
        x = unpack(wide, model, both, 0)
        copy_state(lane, wide, model, w, x)
        _record(wide, d, g, j, min(at_once, columns - j), columns, both, w.flag)


@kernel
def _record(lane, d, g, j, count, columns, both, flag):
    """Columns from j on, and the values."""
    rows = d.read.shape[0]
    for i in range(arms(lane)):
        arm = g * arms(lane) + i
        if arm < d.n:
            for k in range(rows):
                at = d.read[k] + i
                d.values[arm * rows + k] = both[at]
                for c in range(count):
                    d.slopes[(arm * rows + k) * columns + j + c] = both[at + (1 + c) * arms(lane)]
            if flag[i] != 0.0:
                d.values[arm * rows] = np.nan
