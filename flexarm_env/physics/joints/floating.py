"""A floating base that carries the arm: a contribution, with the conservation of momentum (theory, section 6).

The base's center of mass is at the hub. The base's mass therefore acts at the arm's root, and only the hub's torque
rotates the base: J psi'' = -u. The row of psi is not coupled with other rows. The torque u does work on the angle
between base and arm.
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, size, stack
from .. import contributions, protocol
from ..arithmetic import add_to
from ..contributions import register
from ..layout import BASE_POSE
from ..model import PAYLOAD_MASS, Floating
from ..protocol import RESIDUAL_ALONE, State

_X, _Y, _TURN, _MOTIONS = range(4)
"""Indices of the rigid motions of base and arm: 1 m/s along inertial x, 1 m/s along inertial y, 1 rad/s about the
origin."""

_REST, _MOVING, _TURNED, _PUSHED, _CASES = range(5)
"""Cases of residuals that are projected on the rigid motions.

_REST: v = a = 0. _MOVING: a = v. _TURNED: a = rates of a rotation at 1 rad/s. _PUSHED: v = a = 0 with the contact
forces of the moving arm (in models with contacts).
"""

# t^T r of each case for each rigid motion (x, y, psi)
_SUMS = (0,) * (_CASES * _MOTIONS)


@kernel
def assemble(lane, part, model, par, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Write J psi'' + u_0 (N m) into the base's row of r; with weights.with_matrix also its diagonal entry of S.

    J: inertia of the base (kg m^2).
    psi: attitude of the base.
    u_0: torque of the hub on the arm. The diagonal entry is weights.mass J.
    """
    r[part.row] = state.a[part.row] * part.inertia + u[0]
    if weights.with_matrix:
        S[size(model.n_factor) - 1] = part.inertia * weights.mass


@kernel
def after_solve(lane, part, model, S: Lanes, x: Lanes, transposed):
    """Divide the base's row of x by its diagonal entry of S, because this row is not coupled with other rows.

    transposed: True for S^T x = b, which has the same result.
    """
    x[part.row] /= S[size(model.n_factor) - 1]


@kernel
def inertia_forces(lane, part, model, par, a: Lanes, r: Lanes):
    """Write J psi'' (N m), the base's inertia (kg m^2) times its angular acceleration, into the base's row of r."""
    r[part.row] = a[part.row] * part.inertia


@kernel
def input_displacements(lane, part, model, q: Lanes, y: Lanes):
    """Subtract the base's attitude (rad) from y_0, because the hub's torque works on the angle between base and arm."""
    y[0] -= q[part.row]


@kernel
def energy(lane, part, model, par, q, v: Lanes, sums):
    """Return the energies `sums` (kinetic, strain, gravitational; J) plus the kinetic energy of the base's rotation."""
    kinetic, strain, gravity = sums
    rate = v[part.row]
    return kinetic + rate * rate * (part.inertia * 0.5), strain, gravity


@kernel
def poses(lane, part, model, q: Lanes, v: Lanes, out: Lanes):
    """Write the base's attitude (rad) and rate (rad/s) to the last entries of out (BASE_POSE)."""
    at = out.shape[0] - BASE_POSE.end
    out[at + BASE_POSE.angle] = q[part.row]
    out[at + BASE_POSE.rate] = v[part.row]


@kernel
def vjp_residual(lane, part, model, par, state, bar, u_bar: Lanes, r_bar: Lanes):
    """Add to bar.a and u_bar the cotangents that the base's row of r_bar causes; set this row of r_bar to 0.

    r_bar: derivative of a scalar by the residual, whose base row is J psi'' + u_0.
    bar: cotangents of q, v, a.
    u_bar: cotangents of the inputs.
    """
    add_to(lane, bar.a, part.row, r_bar[part.row] * part.inertia)
    u_bar[0] += r_bar[part.row]
    r_bar[part.row] = 0.0


@kernel
def multiply(lane, part, model, S: Lanes, x: Lanes, y: Lanes):
    """Add the base's row of S x to y: its diagonal entry of S times the base's row of x."""
    y[part.row] += S[size(model.n_factor) - 1] * x[part.row]


@kernel
def conserve_momentum(lane, part, model, par: Lanes, before, h, q, v: Lanes, u, r, S):
    """Return (momentum, force), each with x, y and moment about the origin; if `before` is given, first correct v.

    momentum: t^T M v (N s, N m s), with the rates t of the rigid motions.
    force: external force and moment (N, N m), inertial axes.
    before: the pair that the function returned at the start of the step of h (s), or None. With trapezoidal steps the
    angular momentum has a ripple of second order in h, which would rotate a base at rest. Therefore a rigid motion of
    base and arm, which causes no strain, is added to v. With it, the momentum changes by h times the mean force.

    # state     q; v: in and out, (n,) lanes.   # scratch   r, S

    See docs/theory.md, section 6, "A floating base".
    """
    n, base, sums = size(model.n), part, stack(lane, _SUMS)
    a, still = stack(lane, base.room), stack(lane, base.room)
    for k in range(_MOTIONS):
        sums[k] = 0.0
    # residuals with a = 0, a = v, a = rates of a turn; M times these is their difference from that at rest
    for k in range(_first(model), _TURNED if before is None else _PUSHED):
        for j in range(n):
            still[j] = 0.0
            a[j] = 0.0 if k != _MOVING else v[j]
        if k == _TURNED:
            _turn(lane, base, q, 1.0, a)
        protocol.assemble(lane, model, par, State(q, still, a), u, RESIDUAL_ALONE, r, S)
        _take_part(lane, base, q, r, sums[_MOTIONS * k :])
    # a residual at rest is minus the external force
    x, y, turn = _sums(lane, sums, _REST)
    moving = _sums(lane, sums, _MOVING)
    now, push = (moving[0] - x, moving[1] - y, moving[2] - turn), (-x, -y, -turn)
    if model.newton.contact is not None:
        _project_contact_forces(lane, base, model, par, State(q, v, v), u, still, r, S, sums)
        px, py, about = _sums(lane, sums, _PUSHED)
        push = -px, -py, -about
    if before is None:
        return now, push
    was, pushed = before
    # momentum that the step must end with: before + h/2 (F_0 + F_1)
    wanted = (
        was[0] + (pushed[0] + push[0]) * (0.5 * h), was[1] + (pushed[1] + push[1]) * (0.5 * h),
        was[2] + (pushed[2] + push[2]) * (0.5 * h),
    )  # fmt: skip
    # momentum of a turn at 1 rad/s: first moments (mx, my) of mass about the origin, and the inertia about it
    turned = _sums(lane, sums, _TURNED)
    mx, my, inertia = turned[1] - y, x - turned[0], turned[2] - turn
    mass = par[PAYLOAD_MASS] + base.mass
    dx, dy = wanted[0] - now[0], wanted[1] - now[1]
    # (P, L) wanted - now = [m, m, I] (dx, dy, rate): the translation eliminated from 3 x 3
    rate = (wanted[2] - now[2] - (mx * dy - my * dx) / mass) / (inertia - (mx * mx + my * my) / mass)
    _turn(lane, base, q, rate, v)
    dx, dy = (dx + my * rate) / mass, (dy - mx * rate) / mass
    for j in range(0, base.places.shape[0], 2):
        v[base.places[j]] += dx
        v[base.places[j + 1]] += dy
    return wanted, push


@kernel
def _project_contact_forces(lane, base, model, par, state: State, u: Lanes, still: Lanes, r: Lanes, S, sums: Lanes):
    """Project the residual at rest with the contact forces at q, v on the rigid motions: case `_PUSHED` of sums.

    Damping and friction of contacts are external forces that depend on v. The inertia forces of the arm's own motion
    are not external. Therefore only the contact forces are those of the moving arm.
    still: scratch, n rows.
    u: inputs, i.e. joint torques (N m), then point loads.
    r, S: scratch.
    """
    inputs = stack(lane, model.points)
    for k in range(size(model.n_inputs)):
        inputs[k] = u[k]
    for part in model.contributions:
        contributions.point_forces(lane, part, model, par, state, S, inputs)
    for j in range(size(model.n)):
        still[j] = 0.0
        r[j] = 0.0
    protocol.assemble(lane, model.arm, par, State(state.q, still, still), inputs, RESIDUAL_ALONE, r, S)
    # the hub's torque acts on the base, too; torques in gears have no resultant
    r[base.row] = 0.0 + u[0]
    _take_part(lane, base, state.q, r, sums[_MOTIONS * _PUSHED :])


@kernel
def _first(model):
    """Return the first case that is projected: _REST or _MOVING.

    Without loads and gravity the projection of the residual at rest is 0; the case _REST is then omitted.
    """
    if model.arm.loads is not None:
        return _REST
    if model.arm.gravity is not None:
        return _REST
    return _MOVING


@kernel
def _sums(lane, sums: Lanes, case):
    """Return the projections (x, y, moment) of a residual on the translations and the rotation about the origin.

    case: _REST, _MOVING or _TURNED, for the residual with v = a = 0, with a = v, with a = rates of a rotation at 1
    rad/s.
    """
    at = _MOTIONS * case
    return sums[at + _X], sums[at + _Y], sums[at + _TURN]


@kernel
def _turn(lane, base, q: Lanes, rate, v: Lanes):
    """Add a rigid rotation of base and arm about the origin at `rate` (rad/s) to v.

    Rows of angles change by rate, rows of vectors (x, y; m, inertial axes) by rate (-y, x).
    base: the record `Floating` of the base.
    """
    for j in range(base.angles.shape[0]):
        v[base.angles[j]] += rate
    for j in range(0, base.vectors.shape[0], 2):
        x, y = base.vectors[j], base.vectors[j + 1]
        v[x] -= q[y] * rate
        v[y] += q[x] * rate


@kernel
def _take_part(lane, base, q: Lanes, r: Lanes, sums: Lanes):
    """Project generalized forces r (n,) on the rigid motions: sums <- force (N) along x, y, moment (N m) about origin.

    base: the record `Floating` of the base. Positions take part in the translations. Angles take part in the rotation;
    vectors (x, y) take part in it by x r_y - y r_x.
    """
    x, y, turn = 0.0, 0.0, 0.0
    for j in range(0, base.places.shape[0], 2):
        x, y = x + r[base.places[j]], y + r[base.places[j + 1]]
    for j in range(base.angles.shape[0]):
        turn = turn + r[base.angles[j]]
    for j in range(0, base.vectors.shape[0], 2):
        at_x, at_y = base.vectors[j], base.vectors[j + 1]
        turn = turn + (q[at_x] * r[at_y] - q[at_y] * r[at_x])
    sums[_X] = x
    sums[_Y] = y
    sums[_TURN] = turn


register(
    Floating, assemble, after_solve, inertia_forces, input_displacements, energy, poses, vjp_residual, multiply,
    conserve_momentum,
)  # fmt: skip
