"""The derivative of a control period along its steps: values in plain lanes, tangents by the implicit function theorem.

Who calls brings groups that nobody else has in hand, of which the first has the room that all of them work in. All
columns go along together: each step is made once, its matrix is factored once more at its end, and each dual block
carries some of the columns (`physics.integrator.tangents`).
"""

from __future__ import annotations

from ..compiler import follow, inlined, kernel, largest, load, select_lt, size, splat, store
from ..physics.arithmetic import put
from ..physics.integrator.newton import slopes_of
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.switching import switch
from ..physics.integrator.tangents import (
    before_switch,
    copy_state,
    light_tangents,
    prepare,
    restart_tangents,
    step_tangents,
    switch_tangents,
)
from ..physics.integrator.work import copy_rows, unpack
from ..physics.protocol import light
from ..tasks.program import sections
from .derivative import at_once, close, fill, seed, take_columns, write_outcome
from .events import change_payloads
from .keeping import keep
from .motors import ask, jumps, start_stiff, starting, turn_motors


@kernel
def implicit(address, first, last):
    """The derivative of the period of groups first ... last - 1."""
    d = follow(address)
    for g in range(first, last):
        block = d.block[first * d.plain.row : (first + 1) * d.plain.row]
        chunks = (d.columns + at_once(d) - 1) // at_once(d)
        scratch = d.scratch[first * chunks * d.both.row : (first + 1) * chunks * d.both.row]
        _period(d.lane, d, g, chunks, block, scratch, unpack(d.lane, d.program.model, block, 0))
    return 0


@inlined
def _chunk(d, c, scratch):
    """The dual block of chunk c of the columns, and the work array in it."""
    both = scratch[c * d.both.row : (c + 1) * d.both.row]
    return both, unpack(d.dual, d.program.model, both, 0)


@kernel
def _parameters(d, both):
    return both[d.both.par : d.both.poses]


@kernel
def _record(d, both):
    return both[d.both.record : d.both.action]


@kernel
def _period(lane, d, g, chunks, block, scratch, w):
    p, layout, model = d.program, d.plain, d.program.model
    par, poses, record, action, _, _, saved, _ = sections(layout, block)
    fill(lane, d, d.places, layout, g, block)
    change_payloads(lane, p, par, record, w)
    keep(w, record, saved)
    ask(lane, p, model, par, poses, record, action, w)
    for c in range(chunks):
        _open(d, g, c, scratch)
    slopes = slopes_of(p.scheme, p.h)
    for s in range(p.n_steps):
        _turn(lane, d, s, chunks, record, scratch, w)
        if jumps(p.actuator, s):
            _jump(lane, d, chunks, par, s, record, saved, block, scratch, w)
        advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
        prepare(lane, model, par, w, slopes)
        for c in range(chunks):
            both, x = _chunk(d, c, scratch)
            step_tangents(lane, d.dual, model, _parameters(d, both), w, x, slopes, p.scheme, d.passes)
    for c in range(chunks):
        _close(lane, d, g, c, scratch, w)
    close(lane, p, layout, block, w)
    write_outcome(lane, d, d.places, layout, g, block)


@kernel
def _turn(lane, d, s, chunks, record, scratch, w):
    """The motors' torques in step s, and their tangents."""
    actuator = d.program.actuator
    if actuator is not None:
        if s > 0:
            copy_rows(lane, size(d.program.model.n_inputs), w.u, w.u0)
        turn_motors(lane, d.program.task, actuator, s, record, w)
        for c in range(chunks):
            both, x = _chunk(d, c, scratch)
            if s > 0:
                copy_rows(d.dual, size(d.program.model.n_inputs), x.u, x.u0)
            turn_motors(d.dual, d.program.task, actuator, s, _record(d, both), x)


@kernel
def _open(d, g, c, scratch):
    """Columns of chunk c, as far as the commands."""
    p, lane = d.program, d.dual
    both, x = _chunk(d, c, scratch)
    poses, action = both[d.both.poses : d.both.record], both[d.both.action : d.both.seen]
    fill(lane, d, d.twice, d.both, g, both)
    seed(lane, d, c * at_once(d), min((c + 1) * at_once(d), d.columns), both)
    change_payloads(lane, p, _parameters(d, both), _record(d, both), x)
    ask(lane, p, p.model, _parameters(d, both), poses, _record(d, both), action, x)


@kernel
def _close(lane, d, g, c, scratch, w):
    """What is to be seen by the columns of chunk c, and all of them into the arms' Jacobians."""
    both, x = _chunk(d, c, scratch)
    copy_state(lane, d.dual, d.program.model, w, x)
    close(d.dual, d.program, d.both, both, x)
    take_columns(d.dual, d, -1, g, c * at_once(d), min((c + 1) * at_once(d), d.columns), both)


@kernel
def _jump(lane, d, chunks, par, s, record, saved, block, scratch, w):
    """`motors.jump` with its tangents."""
    if isinstance(d.program.model.predictor, tuple):
        _afresh(lane, d, chunks, par, block, scratch, w)
    elif light(d.program.model) is not None:
        _light(lane, d, chunks, par, s, record, block, scratch, w)
    else:
        _stiff(lane, d, chunks, par, s, record, saved, block, scratch, w)


@kernel
def _afresh(lane, d, chunks, par, block, scratch, w):
    model = d.program.model
    restart(lane, model, None, par, block, 0, 0.0, d.program.h, True)
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        restart_tangents(lane, d.dual, model, _parameters(d, both), w, x)
        copy_rows(d.dual, size(model.n), x.r, x.a)
        copy_rows(d.dual, size(model.n), x.r, x.b)


@kernel
def _light(lane, d, chunks, par, s, record, block, scratch, w):
    p, model = d.program, d.program.model
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        first, zero = starting(d.dual, s, _record(d, both)), splat(d.dual, 0.0)
        before_switch(lane, d.dual, model, _parameters(d, both), w, x)
        for k in range(size(model.n)):
            store(x.q0, k, select_lt(0.5, first, zero, load(d.dual, x.q0, k)))
    switch(lane, model, par, block, 0, p.h, starting(lane, s, record))
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        light_tangents(lane, d.dual, model, _parameters(d, both), w, x, p.h)


@kernel
def _stiff(lane, d, chunks, par, s, record, saved, block, scratch, w):
    p, model = d.program, d.program.model
    first = start_stiff(lane, p, model, par, s, record, saved, block, w)
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        if largest(first) > 0.5:
            _start_tangents(lane, d, model, p, both, w, x)
        before_switch(lane, d.dual, model, _parameters(d, both), w, x)
    switch(lane, model, par, block, 0, p.h, None)
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        switch_tangents(lane, d.dual, model, _parameters(d, both), w, x)


@kernel
def _start_tangents(lane, d, model, p, both, w, x):
    """Tangents of lanes where an episode begins."""
    wide = d.dual
    first = starting(wide, 0, _record(d, both))
    copy_rows(wide, size(model.n), x.a, x.v0)
    restart_tangents(lane, wide, model, _parameters(d, both), w, x)
    for k in range(size(model.n)):
        put(first, x.a, k, load(wide, x.r, k), load(wide, x.v0, k))
        put(first, x.b, k, load(wide, x.r, k), load(wide, x.b, k))
    for k in range(size(model.n_inputs)):
        put(first, x.u0, k, load(wide, x.u, k), load(wide, x.u0, k))
