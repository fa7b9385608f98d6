"""Functions for the energy, the dissipation and the readings of contacts."""

from __future__ import annotations

from ...compiler import Lanes, kernel, maximum, select_lt, size, square_root, stack
from .. import protocol
from ..arithmetic import store_vector
from ..space.rotations import Vector, dot
from .clearance import forget_clearance, may_touch
from .kinematics import (
    gap_at,
    here_of,
    less_obstacle,
    meeting,
    motion_of,
    motions,
    obstacle_count,
    place_of,
    touches,
    wrench,
)
from .law import meet
from .layout import READ
from .moving import account_for_obstacles


@kernel
def energy(lane, part, model, par, q, v, sums):
    """Return the energies `sums` (kinetic, strain, gravitational; J) plus k d^(n + 1) / (n + 1) of each contact."""
    kinetic, strain, gravity = sums
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, q, y)
    zero = Vector(0.0, 0.0, 0.0)
    for p in range(len(part.points)):
        if touches(gap_at(lane, part, q, y, p)):
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    place = less_obstacle(lane, part, o, q, place_of(lane, part, y, p))
                    strain = strain + meet(part, p, o, place, zero, zero).stored
    return kinetic, strain, gravity


@kernel
def damping_power(lane, part, model, par, q, v, x, total):
    """Return total (W) plus the power, at virtual rates x, of damping and friction forces of contacts at rates v."""
    y = stack(lane, model.points)
    protocol.input_displacements(lane, model.arm, par, q, y)
    least = 1e300
    for p in range(len(part.points)):
        gap = gap_at(lane, part, q, y, p)
        least = select_lt(gap, least, gap, least)
    if touches(least):
        rates, others = stack(lane, part.poses), stack(lane, part.poses)
        motions(lane, part, model, par, q, v, rates)
        motions(lane, part, model, par, q, x, others)
        for p in range(len(part.points)):
            velocity, spin = motion_of(lane, part, rates, p)
            other, turn = motion_of(lane, part, others, p)
            for o in range(obstacle_count(part)):
                if part.meets[p * obstacle_count(part) + o] > 0.5:
                    met = meeting(lane, part, p, o, q, v, place_of(lane, part, y, p), velocity, spin)
                    force, moment = wrench(part, p, met)
                    # all forces but the elastic one
                    away = less_obstacle(lane, part, o, x, other)
                    power = dot(force, away) + dot(moment, turn) - dot(met.normal, away) * met.elastic
                    total = total - power
    return total


# --- readings ------------------------------------------------------------------------------------------
@kernel
def after_step(lane, part, model, par, q, v, S: Lanes, h):
    """Store the `READING` of each point in S, and add the contact forces times h (s) to the point's impulses.

    The forces at the end of a step count for the whole step. If a force begins and ends at 0, the sum over the steps
    equals the trapezoidal rule.
    """
    if h == 0.0 or may_touch(lane, part, model, S):
        y, poses = stack(lane, model.points), stack(lane, part.poses)
        protocol.input_displacements(lane, model.arm, par, q, y)
        motions(lane, part, model, par, q, v, poses)
        for p in range(len(part.points)):
            _store_reading(lane, part, p, q, v, y, poses, h, S)
        if h == 0.0:
            forget_clearance(lane, part, S)
    else:
        for p in range(len(part.points)):
            at = here_of(part, p)
            for k in range(READ.impulse):
                S[at.reading + k] = 0.0
            S[at.reading + READ.penetration] = -S[at.gap]
    account_for_obstacles(lane, part, model, par, q, v, S, h)


@kernel
def _store_reading(lane, part, p, q, v, y: Lanes, poses: Lanes, h, S: Lanes):
    """Store the `READING` of point p from input displacements y and task poses; add forces * h (s) to its impulses."""
    velocity, spin = motion_of(lane, part, poses, p)
    least, normal, sliding = 1e300, 0.0, 0.0
    total, friction = Vector(0.0, 0.0, 0.0), Vector(0.0, 0.0, 0.0)
    for o in range(obstacle_count(part)):
        if part.meets[p * obstacle_count(part) + o] > 0.5:
            met = meeting(lane, part, p, o, q, v, place_of(lane, part, y, p), velocity, spin)
            force, _ = wrench(part, p, met)
            total, friction = total + force, friction - met.slip * met.grip
            normal = normal + met.force
            sliding = select_lt(met.gap, least, met.sliding, sliding)
            least = select_lt(met.gap, least, met.gap, least)
    at, tangential = here_of(part, p).reading, square_root(dot(friction, friction))
    S[at + READ.normal] = normal
    S[at + READ.tangential] = tangential
    S[at + READ.penetration] = -least
    S[at + READ.sliding] = sliding
    store_vector(lane, S, at + READ.force, total)
    S[at + READ.impulse] += normal * h
    S[at + READ.friction] += tangential * h
    S[at + READ.peak] = maximum(S[at + READ.peak], normal)


# --- assembly ------------------------------------------------------------------------------------------
@kernel
def respond(lane, model, par, state, u: Lanes, weights, part, r: Lanes, S, out):
    """Write to out, for each point and axis, the generalized force b of 1 N on the point and the solution S^-1 b.

    The function is not compiled. S: Newton matrix of the arm alone with fixed coordinates; out (points, axes, 2, n).
    """
    n, arm = size(model.arm.n), model.arm
    still = r.copy()
    protocol.assemble(lane, arm, par, state, u, weights, r, S)
    for k in arm.fixed:
        protocol.add_stiffness(lane, arm, S, k, None)
    protocol.factor(lane, arm, S)
    protocol.residual(lane, arm, par, state, u, still, S)
    for p in range(len(part.points)):
        for i in range(len(part.space)):
            k = part.input + p * len(part.entries) + i
            u[k] = 1.0
            protocol.residual(lane, arm, par, state, u, r, S)
            u[k] = 0.0
            r[:] = still - r
            r[arm.fixed] = 0.0
            out[p, i, 0, :n] = r
            protocol.solve(lane, arm, S, r)
            out[p, i, 1, :n] = r
