"""Equations of an arm with contributions (`physics.model.Jointed`).

Each function calls the function of the arm's formulation, then the function of each contribution in order.

Contributions add terms to residual, energy and damping. Contributions also act before and after the factorization and
the solution with the arm's matrix (`physics.contributions`). Contributions are gears, rotors and hub (`gears`), a
floating base (`floating`), and forces on points of the arm (`points`).
"""

from __future__ import annotations

from ...compiler import Lanes, kernel, size, stack
from .. import contributions, protocol
from ..contact import equations  # noqa: F401  (it registers its kernels)
from ..model import Jointed
from ..protocol import FORMULATIONS, STEP_END, STEP_START, State, register
from . import floating, gears  # noqa: F401  (they register their kernels)
from .friction import store_columns

_LAST_FIRST = (7, 6, 5, 4, 3, 2, 1, 0)
"""Indices of up to eight contributions, from last to first; in this order they are eliminated before a solution."""


@kernel
def _add_point_forces(lane, model, par, state, u: Lanes, S, inputs: Lanes, instant):
    """Write the arm's inputs: u (N m, N) plus the forces that contributions exert on points of the arm.

    state: coordinates q, velocities v, accelerations a.
    S: the contributions' entries.
    inputs: array of the arm's inputs, as long as `model.points`.
    instant: kind of the state, as in `contributions.acts`.
    """
    for k in range(size(model.n_inputs)):
        inputs[k] = u[k]
    for part in model.contributions:
        if contributions.acts(lane, part, model, par, state.q, S, instant):
            contributions.point_forces(lane, part, model, par, state, S, inputs)


@kernel
def assemble(lane, model, par, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Assemble the residual r (N, N m) and, with weights.with_matrix, the matrix S of the arm and its contributions.

    r = M a + h(q, v) - B u, equation [64]; S = weights.mass dr/da + weights.damping dr/dv + weights.stiffness dr/dq.
    If contributions such as contacts act on points of the arm (`model.points`), their forces on these points are added
    to u. par: the arm's own parameters. state: coordinates q, velocities v, accelerations a. u: inputs, i.e. joint
    torques (N m), then point loads.
    """
    for part in model.contributions:
        contributions.prepare(lane, part, model, par, state, weights, S)
    if model.points is None:
        protocol.assemble(lane, model.arm, par, state, u, weights, r, S)
    else:
        inputs = stack(lane, model.points)
        _add_point_forces(lane, model, par, state, u, S, inputs, weights.instant)
        protocol.assemble(lane, model.arm, par, state, inputs, weights, r, S)
    # a second loop variable, because a name of a kernel has one type and this loop has other records
    for adding in model.contributions:
        contributions.assemble(lane, adding, model, par, state, u, weights, r, S)


@kernel
def add_stiffness(lane, model, S, k, x):
    """Add x (N m/rad) to the diagonal entry of row k of S before `factor`. If x is None, fix row k.

    If x is a number, row k must be a joint's angle, a row of the arm. If x is None, row and column k become those of
    the identity matrix, in the arm's matrix or in a contribution's entries.
    """
    # rows behind the arm's belong to contributions alone
    if k < size(model.arm.n):
        protocol.add_stiffness(lane, model.arm, S, k, x)
    if x is None:
        for part in model.contributions:
            contributions.fix_coordinate(lane, part, model, S, k)


@kernel
def factor(lane, model, S: Lanes):
    """Condense the contributions' rows of S onto the arm's rows and factor the arm's matrix, in place.

    With Coulomb friction S also receives the columns of S^-1 for the rows on which friction acts.
    """
    for part in model.contributions:
        contributions.before_factor(lane, part, model, S)
    protocol.factor(lane, model.arm, S)
    for following in model.contributions:
        contributions.after_factor(lane, following, model, S)
    # columns S^-1 e_i of (6.6) last, because they need the factors of all contributions
    store_columns(lane, model, S)


@kernel
def solve(lane, model, S, x):
    """Replace the right side x (n rows) by the solution S^-1 x; S contains the factors of arm and contributions."""
    for k in _LAST_FIRST:
        if k < len(model.contributions):
            # eliminated last, so first: own rows of x are condensed onto the rows before them
            contributions.before_solve(lane, model.contributions[k], model, S, x, False)
    protocol.solve(lane, model.arm, S, x)
    for part in model.contributions:
        contributions.after_solve(lane, part, model, S, x, False)


@kernel
def solve_transposed(lane, model, S, x):
    """Replace the right side x (n rows) by the solution S^-T x; S contains the factors of arm and contributions."""
    for k in _LAST_FIRST:
        if k < len(model.contributions):
            contributions.before_solve(lane, model.contributions[k], model, S, x, True)
    protocol.solve_transposed(lane, model.arm, S, x)
    for part in model.contributions:
        contributions.after_solve(lane, part, model, S, x, True)


@kernel
def multiply(lane, model, S: Lanes, x: Lanes, y: Lanes):
    """Add S x to y (n rows), where S is the assembled matrix of arm and contributions before `factor`."""
    protocol.multiply(lane, model.arm, S, x, y)
    for part in model.contributions:
        contributions.multiply(lane, part, model, S, x, y)


@kernel
def retract(lane, model, q: Lanes, share, d, more):
    """Move the coordinates by an increment: q <- q (+) (share d + more).

    The arm's formulation moves the arm's rows. In rows of contributions the increment is added.
    share: factor on d.
    d, more: increments (n rows; m, rad); more = None means zero.
    """
    protocol.retract(lane, model.arm, q, share, d, more)
    for k in range(size(model.arm.n), size(model.n)):
        q[k] = protocol.added(lane, q, share, d, more, k)


@kernel
def local_difference(lane, model, start: Lanes, q: Lanes, d: Lanes):
    """Compute the increment d from start to q: the arm's rows by its formulation, other rows by subtraction."""
    protocol.local_difference(lane, model.arm, start, q, d)
    for k in range(size(model.arm.n), size(model.n)):
        d[k] = q[k] - start[k]


@kernel
def inertia_forces(lane, model, par, turn, a: Lanes, r: Lanes):
    """Rotate the vectors in a by `turn`, then compute r <- M a (N, N m) of arm and contributions, unless r is None.

    turn: None, or (start, q, share). Each vector is then rotated by `share` times the rotation of its section from
    coordinates start to q.
    """
    protocol.inertia_forces(lane, model.arm, par, turn, a, r)
    if r is not None:
        for part in model.contributions:
            contributions.inertia_forces(lane, part, model, par, a, r)


@kernel
def input_displacements(lane, model, par, q, y, since=None):
    """Write to y the displacement (rad or m) on which each input does work, including the effect of contributions.

    since: None, or (start, y0). Rotations are then integrated from their values y0 at the coordinates `start`.
    """
    protocol.input_displacements(lane, model.arm, par, q, y, since)
    for part in model.contributions:
        contributions.input_displacements(lane, part, model, q, y)


@kernel
def _with_contributions(lane, model, par, q, v, x, total, S, instant):
    """Return `total` plus x^T C v (W) of the contributions: the power at rates x of their damping forces at rates v.

    S, instant: matrix array and kind of the state, as in `contributions.acts`.
    """
    for part in model.contributions:
        if contributions.acts(lane, part, model, par, q, S, instant):
            total = contributions.damping_power(lane, part, model, par, q, v, x, total)
    return total


@kernel
def damping_power(lane, model, par, q, v, x, since=None):
    """Return x^T C v (W): the power, at virtual rates x, of the damping forces C v of arm and contributions.

    since: None, or (start, v0, h, S) for a step of h (s) from coordinates `start` and rates v0 to q and v, with mean
    rates x. The function then returns two powers (W): the mean dissipated power, and the excess of the damping forces'
    mean power over it, or None. Contributions dissipate the mean of x^T C v at both ends of the step, because their
    coordinates add up.
    S: matrix array of the step; if it is None, all contributions act.
    """
    if since is None:
        power = protocol.damping_power(lane, model.arm, par, q, v, x)
        return _with_contributions(lane, model, par, q, v, x, power, None, None)
    start, v0, _, S = since
    first, last = None if S is None else STEP_START, None if S is None else STEP_END
    if model.newton.rotations is None:
        before = protocol.damping_power(lane, model.arm, par, start, v0, x)
        before = _with_contributions(lane, model, par, start, v0, x, before, S, first)
        after = protocol.damping_power(lane, model.arm, par, q, v, x)
        after = _with_contributions(lane, model, par, q, v, x, after, S, last)
        return (before + after) * 0.5, None
    nothing = 0.0
    own = _with_contributions(lane, model, par, start, v0, x, nothing, S, first)
    own = own + _with_contributions(lane, model, par, q, v, x, nothing, S, last)
    power, beyond = protocol.damping_power(lane, model.arm, par, q, v, x, since)
    return power + own * 0.5, beyond


@kernel
def energy(lane, model, par, q: Lanes, v: Lanes):
    """Return (kinetic, strain, gravitational) energy, J.

    The result is the sum of the energies of the arm and of its contributions (gears, floating base, ...)."""
    kinetic, strain, gravity = protocol.energy(lane, model.arm, par, q, v)
    sums = kinetic, strain, gravity
    for part in model.contributions:
        sums = contributions.energy(lane, part, model, par, q, v, sums)
    return sums


@kernel
def set_joint_configuration(lane, model, live, angles, rates: Lanes | None, q: Lanes, v: Lanes):
    """Set q to straight links at the joint angles `angles` (rad), in lanes with live > 1/2.

    Each contribution then sets its rows, such as motor angles, to match the joint angles.
    rates: rates of all rows, relative to the rotating links, from which v is computed; if it is None, v does not
    change.
    q, v: n rows.
    """
    protocol.set_joint_configuration(lane, model.arm, live, angles, rates, q, v)
    for part in model.contributions:
        contributions.set_joint_configuration(lane, part, model, live, rates, q, v)


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """Add the cotangents from r_bar to par_bar, bar and u_bar (reverse derivative of `residual`); then set r_bar to 0.

    A cotangent is the derivative of a scalar: r_bar by the residual, par_bar by the arm's parameters par, bar (a
    `State`) by q, v, a, u_bar by the inputs u.
    S: scratch memory. model.derived is a tag if the compiler derives this function, None if contributions register
    their own derivatives.
    """
    if model.derived is not None:
        protocol.vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)
    else:
        for k in _LAST_FIRST:
            if k < len(model.contributions):
                contributions.vjp_residual(lane, model.contributions[k], model, par, state, bar, u_bar, r_bar)
        protocol.vjp_residual(lane, model.arm, par, par_bar, state, u, S, bar, u_bar, r_bar)


@kernel
def link_poses(lane, model, par, q, v, out, tasks=None):
    """Write the arm's poses to out. If tasks is a tag, also write the contributions' poses, at the end of out.

    out: one `layout.POSES` for each link, in space one `layout.SPACE_POSES`.
    q: coordinates of the arm.
    v: rates of the coordinates.
    """
    protocol.link_poses(lane, model.arm, par, q, v, out, tasks)
    if tasks is not None:
        for part in model.contributions:
            contributions.poses(lane, part, model, q, v, out)


@kernel
def conserve_momentum(lane, model, par, before, h, q, v, u, r, S):
    """Correct v to conserve momentum; return (momentum, force that changes it), by a floating base or by the arm.

    before: None, or the pair that the function returned at the start of the step of h (s). Given the pair, v is first
    changed so that the momentum changes by the impulse of the mean force. The function returns None if a support holds
    the arm.
    u: inputs, i.e. joint torques (N m), then point loads.
    Scratch memory: r, S.
    """
    for part in model.contributions:
        found = contributions.conserve_momentum(lane, part, model, par, before, h, q, v, u, r, S)
        if found is not None:
            return found
    if model.points is None:
        return protocol.conserve_momentum(lane, model.arm, par, before, h, q, v, u, r, S)
    # a held root: forces on points need not be computed
    if model.newton.contact is not None:
        if model.newton.contact.free is None:
            return protocol.conserve_momentum(lane, model.arm, par, before, h, q, v, u, r, S)
    # F of the arm includes the forces on its points; they do not depend on accelerations, which are not known here
    inputs = stack(lane, model.points)
    _add_point_forces(lane, model, par, State(q, v, v), u, S, inputs, None)
    return protocol.conserve_momentum(lane, model.arm, par, before, h, q, v, inputs, r, S)


register(
    Jointed, assemble, add_stiffness, factor, solve, solve_transposed, multiply, retract, local_difference,
    inertia_forces, input_displacements, damping_power, energy, set_joint_configuration,
    vjp_residual, link_poses, conserve_momentum,
)  # fmt: skip
FORMULATIONS.delegate(
    Jointed, "arm", protocol.correct_positions, protocol.tangent_map, protocol.note_inverse, protocol.noted_inverse,
    protocol.strain_gauge, protocol.out_of_range, protocol.centerline,
)  # fmt: skip
