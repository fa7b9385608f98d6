"""The contract of a formulation: the functions of a Model that integrator, runtime and derivatives call.

A formulation consists of a NamedTuple class, the Model, and of kernels registered for this class (`register`). The
compiler selects the kernels by the type of the Model. A Model contains arrays and numbers that do not change after
assembly.

Fields of every Model
    n           rows of the system: an int, or a tuple of n zeros where n is a compile-time constant
    n_factor    float64 entries per arm that the Newton matrix and its factors need (int or tuple of zeros)
    n_inputs    entries of u: joint torques, then one `layout.LOAD` per point load (int or tuple of zeros)
    fixed       int64 (n_fixed,): coordinates that never move, such as those of a pinned root; may be empty
    algebraic   int64 (n_multipliers,) or None: rows of q that hold Lagrange multipliers
    weight      float64 (n,): reciprocal of each coordinate's characteristic size (1/L for lengths, 1 for angles)
    newton      `NewtonPolicy`: the rules by which the integrator solves a step, and the data that they need

Recurring arguments
    lane        lane tag (see `compiler.lanes`); every array below holds lanes unless it says otherwise
    model       the Model. par: the arm's own parameters
    state       `State`: q, v, a; u: inputs
    S           n_factor entries: the Newton matrix or its factors
    w           `integrator.work.Work`, the integrator's work array
    k           index of a joint, from 0 at the root, unless a function says otherwise

Residual and Newton matrix
    residual(lane, model, par, state, u, r, S)
        Compute the residual r <- M(q) a + h(q, v) + Phi_q^T lambda - B u, equation [64]. S is scratch memory.

    assemble(lane, model, par, state, u, weights, r, S)
        Compute the same residual r, and the Newton matrix S <- weights.mass dr/da + weights.damping dr/dv +
        weights.stiffness dr/dq, equations [72]-[78]. Columns of multipliers are scaled by weights.mass. Rows of
        multipliers of r are written by `constraint_residual`. If weights.with_matrix is False, only r is computed, and
        `solve` can still use the factors in S.

    inertia_forces(lane, model, par, turn, a, r)
        With turn = (start, q, share), first rotate the vectors in a by `share` times the rotation of their section from
        start to q. Unless r is None, then compute r <- M a. The function is needed only with
        `NewtonPolicy.period_correction`, for which M is constant.

    constraint_residual(lane, model, psi, state, level, scale, r)
        Write scale * Phi (level 0), or its first (level 1) or second (level 2) time derivative, equation [65], to the
        rows of multipliers of r. psi contains values and rates of prescribed motions.

    factor(lane, model, S), solve(lane, model, S, x)
        Factor the matrix S in place. Replace the right side x by the solution S^-1 x.

    add_stiffness(lane, model, S, k, x)
        Before `factor`, add x (N m/rad) to the diagonal entry of row k, a joint's angle, in addition to values added
        earlier. If x is None, replace row and column k, of the root or of a joint, by those of the identity matrix.

Newton iteration
    correct_positions(lane, model, par, w, active, slopes, predicted)
        Correct w.q, v, a and b by at most the order of |increment|^2, in the lanes `active`. If predicted is None, the
        call follows the Newton increment w.r. If it is a tag, the call follows the prediction from w.q0, which is the
        case only with `NewtonPolicy.predicts`.

Coordinates
    retract(lane, model, q, share, d, more)
        Apply an increment to the coordinates: q <- q (+) (share d + more), where more may be None. The operation (+) is
        a sum, except for rotations, which are composed with increments in body axes. Rows of multipliers of d are zero.

    local_difference(lane, model, start, q, d)
        Compute the increment d from start to q: start (+) d = q.

    tangent_map(lane, model, d, inverse, x)
        Multiply the rotation rows of x by T^T, or by T^-T if inverse is True. The tangent map T satisfies exp(d + e) =
        exp(d) exp(T e) to first order in e.

    set_joint_configuration(lane, model, live, angles, rates, q, v)
        In space, in lanes with `live` > 1/2, set q to straight links at the joint angles `angles` (links,), rad. Unless
        rates (n,) is None, set v to the motion with these rates: rates of joints, and rates of vertices relative to
        their rotating link, in link axes.

Work, energy and momentum
    input_displacements(lane, model, par, q, y, since=None, v=None)
        Write to y[i] the displacement (rad or m) on which input i does work. With since = (start, y0), rotations are
        integrated from their values y0 at the coordinates `start`, because rotations do not add up. With rates v, write
        the velocities (rad/s or m/s) instead; only arms with contact points along links need them.

    energy(lane, model, par, q, v)
        Return the kinetic, strain and gravitational energy, J.

    damping_power(lane, model, par, q, v, x, since=None)
        Return x^T C(q) v, W. The power v^T C v is dissipated. With since = (start, v0, h, S), return two powers (W) of
        a step of h from `start`, v0 to q, v with mean rates x: the mean dissipated power, and the excess of the mean
        power of the damping forces over it, or None. since is given only if q contains rotations or if the arm may
        touch obstacles. S is the matrix array of the step, or None.

    conserve_momentum(lane, model, par, before, h, q, v, u, r, S)
        Return the pair (momentum, force that changes it), or None if a support holds the arm. If `before` is the pair
        at the start of the step, first change v so that the momentum changes by the impulse of the mean force.

Output
    link_poses(lane, model, par, q, v, out, tasks=None)
        Write one `layout.POSES` per link to out. In space, write `layout.SPACE_POSES` instead, and only for tasks (if
        tasks is a tag).

    strain_gauge(lane, model, q, row)
        Return the reading of a strain gauge, 1/m. `gauges.curvature_rows` makes the argument row.

    out_of_range(lane, model, par, q)
        Return 0.0 if the model is valid at q, otherwise a status code.

    centerline(lane, model, q, points)
        Write positions along the chain (m) to points (n_points, lanes of 2 or 3 numbers) and return their number.

Reverse derivatives, which `compiler.vjp_of` derives from the functions above unless a formulation has a faster way
    solve_transposed(lane, model, S, x)
        Replace the right side x by the solution S^-T x.

    vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)
        Add the cotangents from r_bar to par_bar, bar (a `State`) and u_bar, then set r_bar to 0. S is scratch memory.

    multiply(lane, model, S, x, y)
        Add S x to y, with the matrix S as `assemble` leaves it. Models with light joints need this function.

    vjp_product(lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar)
        Do the same as `vjp_residual` for the product y = S x with a constant x.

    vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar)
        Do the same as `vjp_residual` for the poses of `task_poses`.

    note_inverse(lane, model, d, share), noted_inverse(lane, model, d, share, x)
        Store the coefficients of T^-T of d in `share`. Multiply x by T^-T, with the coefficients in `share`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..compiler import Family, Lanes, inlined, kernel, returns_none, size, vjp_of


class State(NamedTuple):
    """State of an arm: coordinates q, rates v and accelerations a, each an array of n lanes."""

    q: Lanes  # coordinates (m, rad); rows of multipliers: constraint forces (N, N m)
    v: Lanes  # velocities (m/s, rad/s)
    a: Lanes  # accelerations (m/s^2, rad/s^2)


class NewtonPolicy(NamedTuple):
    """Rules by which the integrator solves the time steps of a Model. The defaults suit any Model.

    A tag is (0,) or None. If a field is None, the code that the field controls is not compiled.
    """

    # s of the predicted acceleration a+ = s a. 1: motion is smooth over a step; 0: also where coordinates vibrate
    # faster than steps resolve, whose last acceleration says nothing about the next
    acceleration_share: float = 0.0
    # kappa: the first increment d leaves an error of at most kappa |d|^2 (weighted); None: no such bound is known
    first_error: float | None = None
    # tag: a step resolves all motion of the coordinates, so that accelerations follow from forces when inputs jump,
    # and the energy balance of a step tells a wrong root (`integrator.balance`)
    resolved: tuple[int, ...] | None = None
    # tag: `correct_positions` improves the prediction, because straight paths of stiff elements' ends stretch them
    predicts: tuple[int, ...] | None = None
    # 2 kappa, where the integrator lengthens a period by kappa (omega h)^2: corrected, eq. (6.2), with a constant M
    period_correction: float | None = None
    # largest weighted increment (rad, lengths over the arm's length); larger ones leave the range of the tangent
    max_increment: float | None = None
    # error of the matrix in the first and in later iterations as a fraction of the increment d, which leaves an error
    # of at most max(10 |d|^2, that fraction |d|); None: the matrix is the derivative of r
    tangent_error: tuple[float, float] | None = None
    # sizes (tuples of zeros) i and j: iterations i to j, from 0, use the factors of the one before, because a matrix
    # costs several residuals; None: each iteration has its own matrix
    reuse: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    # tag: q contains rotations, whose increments within a step add up in body axes
    rotations: tuple[int, ...] | None = None
    # tag: joints may have almost no inertia of their own; jumps of torques then cause accelerations that steps do not
    # resolve (`integrator.switching`)
    light_joints: tuple[int, ...] | None = None
    # tag: joints have Coulomb friction (`joints.friction`)
    friction: tuple[int, ...] | None = None
    # `contact.layout.Watch`: points may touch obstacles, where the residual is not smooth; None: no contact
    contact: Any = None


@kernel
def reuses_matrix(policy, iteration):
    """Return whether Newton iteration number `iteration` (from 0) uses the factors of the iteration before.

    policy: `NewtonPolicy`. If its field `reuse` is None, each iteration has its own matrix. Otherwise `reuse` is a pair
    of tuples, whose lengths are the numbers of the first and of the last iteration that reuse factors.
    """
    if policy.reuse is None:
        return False
    return size(policy.reuse[0]) <= iteration and iteration <= size(policy.reuse[1])


class Weights(NamedTuple):
    """Factors of the residual's derivatives in a matrix: mass dr/da + damping dr/dv + stiffness dr/dq.

    A Newton matrix may omit terms or contain approximate terms, because the iteration corrects the errors of its
    matrix. The matrix for a jump of accelerations or velocities must be exact, because a single solution defines the
    jump.
    """

    mass: float
    damping: float
    stiffness: float
    with_matrix: bool = True  # False: only the residual is computed; S does not change
    newton_share: float = 0.0  # factor of terms that only a Newton matrix has: 1 in an iteration, 0 in a jump
    friction_apart: bool = False  # True: friction of contacts is solved separately from the matrix (`contact.friction`)
    instant: tuple[int, ...] | None = None  # kind of the state, for `contributions.acts`: None, ITERATE or STEP_END


ITERATE, STEP_START, STEP_END, STEPS_START = (0,), (0, 0), (0, 0, 0), (0, 0, 0, 0)
"""Tags of a state, which differ in their lengths: iterate, start of the step or end of the step whose Newton iteration
S belongs to, and start of the first of several steps."""

RESIDUAL_ALONE = Weights(0.0, 0.0, 0.0, with_matrix=False)
ITERATE_ALONE = Weights(0.0, 0.0, 0.0, with_matrix=False, instant=ITERATE)
STEP_END_ALONE = Weights(0.0, 0.0, 0.0, with_matrix=False, instant=STEP_END)
MASS_ALONE = Weights(1.0, 0.0, 0.0)


@kernel
def added(lane, q: Lanes, share, d: Lanes, more: Lanes | None, k):
    """Return row k of q + share d + more, a coordinate (m or rad) after an increment; row k is not part of a rotation.

    q, d, more: arrays of n rows; more = None means zero. share: factor on d.
    """
    x = q[k] + d[k] * share
    if more is None:
        return x
    return x + more[k]


@inlined
def _add(lane, model, q: Lanes, share, d, more):
    """Default of `retract`: move coordinates without rotations by an increment, q <- q + share d + more (m, rad).

    q, d, more: arrays of n rows; more = None means zero. share: factor on d.
    """
    for k in range(size(model.n)):
        q[k] = added(lane, q, share, d, more, k)


@inlined
def _subtract(lane, model, start: Lanes, q: Lanes, d: Lanes):
    """Default of `local_difference`: compute the increment d <- q - start of coordinates without rotations.

    start, q, d: n rows (m, rad).
    """
    for k in range(size(model.n)):
        d[k] = q[k] - start[k]


@inlined
def mean_damping_power(lane, model, par, start, v0, end, v, x, h, S):
    """Return (mean dissipated power, excess or None), W, of a step of h (s); excess: see the last sentence.

    The step leads from coordinates `start` with rates v0 to `end` with rates v. x: mean rates. If q contains rotations,
    the formulation's `damping_power` integrates over the step. Without rotations strains are nearly linear in q. The
    dissipated power is then the mean of x^T C v at both ends, and the excess is None. S: matrix array of the step, in
    which contacts store whether points touch, or None. The excess is the mean power of the damping forces minus the
    dissipated power.
    """
    if model.newton.rotations is not None or model.newton.contact is not None:
        return damping_power(lane, model, par, end, v, x, (start, v0, h, S))
    before, after = damping_power(lane, model, par, start, v0, x), damping_power(lane, model, par, end, v, x)
    return (before + after) * 0.5, None


@inlined
def _linear_gauge(lane, model, q: Lanes, row):
    """Default of `strain_gauge`: return the reading of a strain gauge in the plane, the curvature row . q (1/m).

    row: weight of each coordinate in the curvature (from `gauges.curvature_rows`). q: coordinates (m, rad).
    """
    total = 0.0
    for k in range(row.shape[0]):
        total = total + q[k] * row[k]
    return total


@kernel
def _everywhere(lane, model, par, q):
    """Default of `out_of_range`: return 0.0, the status of a valid state, for formulations valid at any deflection."""
    return 0.0


@kernel
def _by_assembling(lane, model, par, state, u, r, S):
    """Default of `residual`: compute the residual r, equation [64], by `assemble` without a matrix.

    r <- M a + h(q, v) + Phi_q^T lambda - B u, n rows (N, N m). state: coordinates q, velocities v, accelerations a. u:
    inputs, i.e. joint torques (N m), then point loads. S: scratch memory.
    """
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


@kernel
def _transposed(lane, model, S, x):
    """Default of `solve_transposed`: solve S^T y = x in place, x <- y (n rows), with the factors in S.

    The compiler derives this function from `solve`: the reverse derivative of a linear map is its transpose.
    """
    _solve_backwards(lane, model, S, x, x)


@kernel
def vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """Add the cotangents from r_bar to par_bar, bar and u_bar, by the compiler's derivative of `residual`; r_bar <- 0.

    A cotangent is the derivative of a scalar by a quantity. r_bar (n rows) is the derivative by the residual, par_bar
    by the arm's parameters par, bar (a `State`) by q, v and a, u_bar by the inputs u. S: scratch memory.
    """
    _residual_backwards(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)


@kernel
def _vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """Add the cotangents from poses_bar to par_bar, q_bar, v_bar by the compiler's derivative of `task_poses`.

    A cotangent is the derivative of a scalar by a quantity: poses_bar by the poses, par_bar by the arm's parameters
    par, q_bar and v_bar by coordinates and rates. poses: array of the poses' size. On return poses_bar is 0.
    """
    _poses_backwards(lane, model, par, q, v, poses, par_bar, q_bar, v_bar, poses_bar)


@kernel
def _vjp_product(lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar):
    """Add the cotangents from y_bar to par_bar, bar and u_bar, where y = S x with a constant x; y_bar <- 0.

    The compiler derives this function from `_product`. A cotangent is the derivative of a scalar by a quantity.

    # in        par, state, u: where S is assembled, with `weights` (`Weights`);  x (n,)
    # in, out   y_bar (n,): by y;  par_bar: by par;  bar (a `State`): by q, v, a;  u_bar: by u
    # scratch   S
    """
    _product_backwards(lane, model, par, state, u, weights, x, y_bar, S, par_bar, bar, u_bar, y_bar)


@kernel
def _product(lane, model, par, state, u, weights, x, y: Lanes, S):
    """Assemble the matrix S at `state` and compute y <- S x (n rows).

    S <- weights.mass dr/da + weights.damping dr/dv + weights.stiffness dr/dq, with the residual r of equation [64]. u:
    inputs, i.e. joint torques (N m), then point loads.
    """
    assemble(lane, model, par, state, u, weights, y, S)
    for k in range(size(model.n)):
        y[k] = 0.0
    multiply(lane, model, S, x, y)


FORMULATIONS = Family("model")
"""The registered kernels of all formulations, by the class of the formulation's Model."""

register = FORMULATIONS.register

assemble = FORMULATIONS.function("assemble", "lane, model, par, state, u, weights, r, S")
residual = FORMULATIONS.function("residual", "lane, model, par, state, u, r, S")
inertia_forces = FORMULATIONS.function("inertia_forces", "lane, model, par, turn, a, r")
correct_positions = FORMULATIONS.function("correct_positions", "lane, model, par, w, active, slopes, predicted")
constraint_residual = FORMULATIONS.function("constraint_residual", "lane, model, psi, state, level, scale, r")
add_stiffness = FORMULATIONS.function("add_stiffness", "lane, model, S, k, x")
factor = FORMULATIONS.function("factor", "lane, model, S")
solve = FORMULATIONS.function("solve", "lane, model, S, x")
solve_transposed = FORMULATIONS.function("solve_transposed", "lane, model, S, x")
vjp_residual = FORMULATIONS.function("vjp_residual", "lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar")
multiply = FORMULATIONS.function("multiply", "lane, model, S, x, y")
vjp_product = FORMULATIONS.function(
    "vjp_product", "lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar"
)
vjp_poses = FORMULATIONS.function("vjp_poses", "lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar")
input_displacements = FORMULATIONS.function("input_displacements", "lane, model, par, q, y, since, v")
local_difference = FORMULATIONS.function("local_difference", "lane, model, start, q, d")
retract = FORMULATIONS.function("retract", "lane, model, q, share, d, more")
tangent_map = FORMULATIONS.function("tangent_map", "lane, model, d, inverse, x")
note_inverse = FORMULATIONS.function("note_inverse", "lane, model, d, share")
noted_inverse = FORMULATIONS.function("noted_inverse", "lane, model, d, share, x")
conserve_momentum = FORMULATIONS.function("conserve_momentum", "lane, model, par, before, h, q, v, u, r, S")
damping_power = FORMULATIONS.function("damping_power", "lane, model, par, q, v, x, since")
energy = FORMULATIONS.function("energy", "lane, model, par, q, v")
link_poses = FORMULATIONS.function("link_poses", "lane, model, par, q, v, out, tasks")
strain_gauge = FORMULATIONS.function("strain_gauge", "lane, model, q, row")
set_joint_configuration = FORMULATIONS.function("set_joint_configuration", "lane, model, live, angles, rates, q, v")
out_of_range = FORMULATIONS.function("out_of_range", "lane, model, par, q")
centerline = FORMULATIONS.function("centerline", "lane, model, q, points")

FORMULATIONS.defaults.update(
    correct_positions=returns_none, retract=_add, local_difference=_subtract,
    residual=_by_assembling, constraint_residual=returns_none,
    conserve_momentum=returns_none,
    strain_gauge=_linear_gauge, out_of_range=_everywhere, solve_transposed=_transposed,
    vjp_residual=vjp_source, vjp_poses=_vjp_poses, vjp_product=_vjp_product,
)  # fmt: skip
"""Default functions, for a formulation without rotations in q and without optional parts."""


@kernel
def task_poses(lane, model, par, q, v, out):
    """Write the poses that tasks read to out: one `layout.POSES` per link (in space `layout.SPACE_POSES`).

    Poses of contributions follow, such as the `layout.BASE_POSE` of a floating base. q: coordinates (m, rad). v: rates
    of the coordinates.
    """
    link_poses(lane, model, par, q, v, out, (0,))


_solve_backwards = vjp_of(solve, ("x",))
_residual_backwards = vjp_of(residual, ("par", "state", "u", "r"), scratch=("S",))
_poses_backwards = vjp_of(task_poses, ("par", "q", "v", "out"))
_product_backwards = vjp_of(_product, ("par", "state", "u", "y"), scratch=("S",))
