"""Derivative of a control period step by step: values without tangents, tangents by the implicit function theorem.

The caller passes groups that no other thread uses at the same time. The scratch memory of the first group is used for
all groups. All columns of the Jacobian advance together: each step is computed once, the step's matrix is factored once
more at the end of the step, and each block with tangents contains some of the columns
(`physics.integrator.transitions`).
"""

from __future__ import annotations

from ..compiler import dereference, inlined, kernel, size
from ..physics.integrator.newton import newmark_slopes
from ..physics.integrator.step import advance
from ..physics.integrator.step_derivatives import factor_step_end, step_tangents
from ..physics.integrator.transitions import before_jump, copy_state, jump_tangents
from ..physics.integrator.work import copy_rows, unpack
from ..physics.joints.friction_derivatives import store_directions
from ..tasks.program import sections
from .derivative import at_once, close, fill, seed, take_columns, write_outcome
from .events import change_payloads
from .keeping import save_lanes
from .motors import command_motors, is_starting, jump_with_torques, may_jump_before_step, update_motor_torques


@kernel
def implicit(address, first, last):
    """Compute d.jacobian of one control period for groups first ... last - 1 by implicit differentiation of the steps.

    An arm's Jacobian has the shape (X + O + 1, X + A). The Jacobian's rows are the moving numbers of the state at the
    end of the period, the observed entries (divided by their scales) and the reward. The Jacobian's columns are the
    moving numbers at the start and the actions. Units are SI units. address: address of a `derivative.Derivative` d, in
    which the kernel also writes the results of the period. The scratch memory of group `first` is used for all groups.
    Returns 0.
    """
    d = dereference(address)
    for g in range(first, last):
        block = d.block[first * d.plain.row : (first + 1) * d.plain.row]
        chunks = (d.columns + at_once(d) - 1) // at_once(d)
        scratch = d.scratch[first * chunks * d.both.row : (first + 1) * chunks * d.both.row]
        _period(d.lane, d, g, chunks, block, scratch, unpack(d.lane, d.program.model, block, 0))
    return 0


@inlined
def _chunk(d, c, scratch):
    """Return the block of chunk c of the Jacobian's columns, and the integrator's work array in this block."""
    both = scratch[c * d.both.row : (c + 1) * d.both.row]
    return both, unpack(d.dual, d.program.model, both, 0)


@kernel
def _parameters(d, both):
    """Return the section of a block with tangents with the arms' own parameters."""
    return both[d.both.par : d.both.poses]


@kernel
def _record(d, both):
    """Return the records' section of a block with tangents."""
    return both[d.both.record : d.both.action]


@kernel
def _period(lane, d, g, chunks, block, scratch, w):
    """Compute Jacobians of group g over one period: values in `block`, tangents in `chunks` further blocks.

    # block     scratch, lanes without tangents;  w: views of it
    # scratch   `chunks` blocks with tangents, each with some columns
    # out       rows and Jacobians of d
    """
    p, layout, model = d.program, d.plain, d.program.model
    par, poses, record, action, _, _, saved, _ = sections(layout, block)
    # values in lanes without tangents, because all columns share them: state at the start, commands
    fill(lane, d, d.places, layout, g, block)
    change_payloads(lane, p, par, record, w)
    save_lanes(w, record, saved)
    command_motors(lane, p, model, par, poses, record, action, w)
    for c in range(chunks):
        _open(d, g, c, scratch)
    slopes = newmark_slopes(p.scheme, p.h)
    # motors, jump, step in lanes without tangents; then d(q, v, a, b) from the S that the step has factored at its end
    for s in range(p.n_steps):
        _turn(lane, d, s, chunks, record, scratch, w)
        if may_jump_before_step(p.actuator, s):
            _jump(lane, d, chunks, par, s, record, saved, block, scratch, w)
        advance(lane, model, None, par, block, 0, 0.0, p.h, 1, p.scheme, None)
        factor_step_end(lane, model, par, w, slopes)
        # d(q, v, a, b) of the step's end by those of its start: -S^-1 dr, column by column
        for c in range(chunks):
            both, x = _chunk(d, c, scratch)
            step_tangents(lane, d.dual, model, _parameters(d, both), w, x, slopes, p.scheme, d.passes)
    # tangents of observation and reward by those of q, v, a at the period's end
    for c in range(chunks):
        _close(lane, d, g, c, scratch, w)
    close(lane, p, layout, block, w)
    write_outcome(lane, d, d.places, layout, g, block)


@kernel
def _turn(lane, d, s, chunks, record, scratch, w):
    """Update the motors' torques (N m) in step s, in lanes without tangents and in all blocks with tangents.

    # in, out   record.torque, in `record` and in the blocks with tangents
    # out       u (joints, lanes), mean torques over the step, and u0, torques before it, of w and of each further array
    The torque of ideal motors does not change.
    """
    actuator = d.program.actuator
    if actuator is not None:
        # u_0 <- u before the step: the jump of a is by u - u_0
        if s > 0:
            copy_rows(lane, size(d.program.model.n_inputs), w.u, w.u0)
        update_motor_torques(lane, d.program.task, actuator, s, record, w)
        for c in range(chunks):
            both, x = _chunk(d, c, scratch)
            if s > 0:
                copy_rows(d.dual, size(d.program.model.n_inputs), x.u, x.u0)
            update_motor_torques(d.dual, d.program.task, actuator, s, _record(d, both), x)


@kernel
def _open(d, g, c, scratch):
    """Start chunk c of the columns: state, seeds, payload change and commands in its block with tangents.

    both: block with tangents of the chunk, filled from d.state and d.action; one tangent is 1 for each column.
    """
    p, lane = d.program, d.dual
    both, x = _chunk(d, c, scratch)
    poses, action = both[d.both.poses : d.both.record], both[d.both.action : d.both.seen]
    fill(lane, d, d.twice, d.both, g, both)
    seed(lane, d, c * at_once(d), min((c + 1) * at_once(d), d.columns), both)
    change_payloads(lane, p, _parameters(d, both), _record(d, both), x)
    command_motors(lane, p, p.model, _parameters(d, both), poses, _record(d, both), action, x)


@kernel
def _close(lane, d, g, c, scratch, w):
    """End chunk c of the columns: observe in lanes with tangents, and copy its tangents into the arms' Jacobians.

    w: state at the end of the period in lanes without tangents. The chunk's tangents are in its block with tangents.
    """
    both, x = _chunk(d, c, scratch)
    # values from the plain lanes, so that they have the bits of a step without derivatives
    copy_state(lane, d.dual, d.program.model, w, x)
    close(d.dual, d.program, d.both, both, x)
    take_columns(d.dual, d, -1, g, c * at_once(d), min((c + 1) * at_once(d), d.columns), both)


@kernel
def _jump(lane, d, chunks, par, s, record, saved, block, scratch, w):
    """Let accelerations and their tangents jump with the torques before step s (`motors.jump_with_torques`).

    # in        u0, u: inputs before and after, N m and N
    # in, out   a, b (m/s^2, rad/s^2) of w, and their tangents in the other work arrays
    """
    model, h = d.program.model, d.program.h
    # the residual before the jump belongs to the arm before it, hence two passes over the chunks
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        before_jump(lane, d.dual, model, _parameters(d, both), w, x, is_starting(d.dual, s, _record(d, both)))
    jump_with_torques(lane, d.program, model, par, s, record, saved, block, w)
    store_directions(lane, model, w.S)
    for c in range(chunks):
        both, x = _chunk(d, c, scratch)
        jump_tangents(lane, d.dual, model, _parameters(d, both), w, x, h, is_starting(lane, s, record))
