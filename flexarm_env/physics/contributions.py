"""The contract of a contribution: terms that are added to those of the links, in formulations without multipliers.

A contribution is a NamedTuple class with registered kernels (`register`). Each kernel adds the contribution's terms to
the result of the arm's formulation. `joints.equations` composes arm and contributions into one Model, `model.Jointed`.
Each function of `physics.protocol` calls the arm's function first, then the same function of each contribution in
order. A contribution registers only the functions that it needs; the default functions do nothing.

Recurring arguments (for other arguments see `protocol`)
    part        record of the contribution
    model       the `Jointed` Model; `model.arm` is the Model of the arm alone, whose rows come first
    S           the arm's matrix array, then the entries of contributions, whose offsets `joints.build` assigns

Residual
    prepare(lane, part, model, par, state, weights, S)
        Before the arm's residual is computed, store in S values for later use.

    point_forces(lane, part, model, par, state, S, inputs)
        Add forces on points of the arm (N, N m) to the arm's inputs. Forces depend on q and v, not on accelerations.

    assemble(lane, part, model, par, state, u, weights, r, S)
        Add the contribution's terms to r. With weights.with_matrix, also write the contribution's entries of S.

Linear system: functions that are called before and after the arm's own `factor` and `solve`
    fix_coordinate(lane, part, model, S, k)
        Mark row k as fixed or prescribed.

    before_factor(lane, part, model, S)
        Condense the contribution's rows onto the arm's rows.

    after_factor(lane, part, model, S)
        Compute quantities that need `protocol.solve` of the Model, which can now be used.

    before_solve(lane, part, model, S, x, transposed)
        Eliminate the contribution's rows from the right side x. transposed: True for the system with the matrix S^T.

    after_solve(lane, part, model, S, x, transposed)
        Complete or correct the solution x.

    correct_increment(lane, part, model, S, x, fresh)
        In a Newton iteration, correct x = S^-1 r by laws that the matrix does not contain. fresh: True if S has new
        factors.

Work and energy
    energy(lane, part, model, par, q, v, sums)
        Return `sums` (kinetic, strain, gravitational; J) plus the contribution's energies.

    damping_power(lane, part, model, par, q, v, x, total)
        Return total + x^T C v, W.

    input_displacements(lane, part, model, q, y)
        Change the displacements on which inputs do work.

    inertia_forces(lane, part, model, par, a, r)
        Add the inertia forces M a to r, for the period correction.

    acts(lane, part, model, par, q, S, instant)
        Return False if the contribution adds no forces to the arm at q. The caller then does not call `point_forces` or
        `damping_power`. instant: None (any state and S), or ITERATE, STEP_START, STEP_END or STEPS_START of `protocol`.
        The call with STEPS_START prepares S for the call with STEP_START.

    measure_near(lane, part, model, par, q, S, increment)
        In a Newton iteration, store in S the distances at the iterate q if a weighted increment of this size may change
        the sign of a distance.

    nearest(lane, part, model, par, q, distance)
        Return the smaller of `distance` and the least distance of a point from an obstacle at q, m.

    conserve_momentum(lane, part, model, par, before, h, q, v, u, r, S)
        Conserve momentum as `protocol.conserve_momentum` does, or return None.

    after_step(lane, part, model, par, q, v, S, h)
        Record in S the state at the end of a step of h (s).

Configuration and output
    set_joint_configuration(lane, part, model, live, rates, q, v)
        Set the contribution's rows after the arm's joints are set.

    poses(lane, part, model, q, v, out)
        Write the poses for tasks at the end of out.

Reverse derivatives, if `Jointed.derived` does not leave them to the compiler
    vjp_residual(lane, part, model, par, state, bar, u_bar, r_bar)
        Apply the reverse derivative of `assemble`, and set the contribution's rows of r_bar to 0.

    multiply(lane, part, model, S, x, y)
        Before `factor`, add the contribution's part of S x to y.

Coulomb friction is not a function of the state. The integrator solves for Coulomb friction with functions of its own
(`joints.friction`).
"""

from __future__ import annotations

from ..compiler import Family, kernel, returns_none

CONTRIBUTIONS = Family("part")
"""The registered kernels of all contributions, by the class of the contribution's record."""

register = CONTRIBUTIONS.register

_TERMS = "lane, part, model, par, state"
prepare = CONTRIBUTIONS.function("prepare", f"{_TERMS}, weights, S")
point_forces = CONTRIBUTIONS.function("point_forces", f"{_TERMS}, S, inputs")
assemble = CONTRIBUTIONS.function("assemble", f"{_TERMS}, u, weights, r, S")
fix_coordinate = CONTRIBUTIONS.function("fix_coordinate", "lane, part, model, S, k")
before_factor = CONTRIBUTIONS.function("before_factor", "lane, part, model, S")
after_factor = CONTRIBUTIONS.function("after_factor", "lane, part, model, S")
before_solve = CONTRIBUTIONS.function("before_solve", "lane, part, model, S, x, transposed")
after_solve = CONTRIBUTIONS.function("after_solve", "lane, part, model, S, x, transposed")
correct_increment = CONTRIBUTIONS.function("correct_increment", "lane, part, model, S, x, fresh")
energy = CONTRIBUTIONS.function("energy", "lane, part, model, par, q, v, sums")
damping_power = CONTRIBUTIONS.function("damping_power", "lane, part, model, par, q, v, x, total")
input_displacements = CONTRIBUTIONS.function("input_displacements", "lane, part, model, q, y")
inertia_forces = CONTRIBUTIONS.function("inertia_forces", "lane, part, model, par, a, r")
conserve_momentum = CONTRIBUTIONS.function("conserve_momentum", "lane, part, model, par, before, h, q, v, u, r, S")
acts = CONTRIBUTIONS.function("acts", "lane, part, model, par, q, S, instant")
measure_near = CONTRIBUTIONS.function("measure_near", "lane, part, model, par, q, S, increment")
after_step = CONTRIBUTIONS.function("after_step", "lane, part, model, par, q, v, S, h")
nearest = CONTRIBUTIONS.function("nearest", "lane, part, model, par, q, distance")
set_joint_configuration = CONTRIBUTIONS.function("set_joint_configuration", "lane, part, model, live, rates, q, v")
poses = CONTRIBUTIONS.function("poses", "lane, part, model, q, v, out")
vjp_residual = CONTRIBUTIONS.function("vjp_residual", "lane, part, model, par, state, bar, u_bar, r_bar")
multiply = CONTRIBUTIONS.function("multiply", "lane, part, model, S, x, y")


@kernel
def _no_energy(lane, part, model, par, q, v, sums):
    """Return the energies `sums` (kinetic, strain, gravitational; J) unchanged: default `energy` of a contribution."""
    return sums


@kernel
def _no_power(lane, part, model, par, q, v, x, total):
    """Return the damping power `total` (W) unchanged: default `damping_power` of a contribution."""
    return total


@kernel
def _no_obstacle(lane, part, model, par, q, distance):
    """Return `distance` (m) unchanged: default `nearest` of a contribution."""
    return distance


@kernel
def _always_acts(lane, part, model, par, q, S, instant):
    """Return True: default `acts` of a contribution."""
    return True


CONTRIBUTIONS.defaults.update(
    dict.fromkeys(CONTRIBUTIONS.names, returns_none), energy=_no_energy, damping_power=_no_power, acts=_always_acts,
    nearest=_no_obstacle,
)
"""Kernels of a contribution that adds no terms: defaults for the functions that a contribution does not register."""
