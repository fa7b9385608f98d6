"""What a formulation provides to the integrator, chosen by the type of its Model when a kernel is compiled.

A formulation's Model is a NamedTuple of arrays and numbers, never written after assembly. Every Model has

    n          int, or a tuple of n zeros where n is to be a compile-time constant: rows of the system
    n_factor   likewise: float64 entries per arm that the iteration matrix and its factors need
    n_inputs   likewise: entries of u (joint torques first, then a `layout.LOAD` for each point load)
    fixed      int64 (n_fixed,), may be empty: coordinates that never move (a ground pin)
    algebraic  int64 (n_multipliers,) or None: rows of q that hold Lagrange multipliers
    weight     float64 (n,): one over the size that matters of each coordinate (1/L for lengths, 1 for angles)
    predictor  float: 1 starts Newton from the last acceleration, 0 from none; (that, kappa): the first increment is
               trusted to leave an error of kappa times its square; None: from none, then `predict`
    correction float: twice the share kappa of (omega h)^2 by which the integrator makes a period longer, which steps
               are then corrected for (`period`); None: they are not

and registers these functions (kernels; `lane` is a lane tag, arrays hold lanes, `par` the arm's own parameters):

    predict(lane, model, start, q)   only where predictor is None: a better q than the given one to start Newton from;
        its first increment is then trusted to leave an error of 10 times its square
    settle(lane, model, par, start, w, active, slopes)  after an increment w.r of Newton's (start None), and after
        `predict` (start a tag): where `active`, w.q, v, a and b are moved on, by no more than the increment's square
    stride(model)                    None, or the largest weighted increment, to which others are scaled down
    lack(model)                      None, or what a step's matrix lacks of the derivative at most, in the first
        iteration and in others: an increment by one made anew leaves at most 10 times its square, or that share of it
    assemble(lane, model, par, state, u, weights, r, S)
        r = M(q) a + h(q, v) + Phi_q^T lambda - B u  and, with `Weights` c, S = c.mass dr/da + c.damping dr/dv +
        c.stiffness dr/dq, eqs. [64]-[78]; rows of multipliers belong to `constrain`, except that columns of multipliers
        are scaled by c.mass; c.mass = 0 asks for the residual alone and must leave what `solve` reads of S as it is
    residual(lane, model, par, state, u, r, S)  r alone; S is free
    inertia(lane, model, par, a, r)  only where correction is not None: r = M a, M being constant
    rotate(lane, model, start, q, share, x)  likewise: rotate each vector in x by a share of the angle that the body
        there turns by from start to q
    constrain(lane, model, psi, state, level, scale, r)
        the constraint rows of r: scale * Phi (level 0), its velocity (1) or acceleration (2) form, eq. [65]
    pin(lane, model, S, k)           replace row and column k of S by those of the identity; k: of the root or a joint
    stiffen(lane, model, S, k, x)    add x to row k of S, that of a joint's angle, in column k; before `factor`
    gyrate(lane, model, S, k, momentum)  in space, before `assemble`: the rotor of joint k has this angular momentum
        (N m s) along the joint's axis e, against the section before, which turns by w: a moment of momentum times w x e
    sway(lane, model, S, k)          that w x e, in the section's axes, of S; its rows are the three before the joint's
    lean(lane, model, S, k, x)       before `factor`: column k of S has x times it in these rows
    factor(lane, model, S)           factor S in place
    solve(lane, model, S, x)         x <- S^-1 x in place
    solve_transposed(lane, model, S, x)  for derivatives backwards: x <- S^-T x; this and the following are made of the
        sources (`compiler.vjp_of`) unless a formulation has shorter ways
    vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar)  likewise, the residual's derivatives: to
        par_bar, bar (a State) and u_bar is added what r_bar comes to there, and r_bar becomes 0; S is free
    multiply(lane, model, S, x, y)   only of models that are light: y <- y + S x, S being as `assemble` leaves it
    vjp_product(lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar)  likewise, for derivatives
        backwards: `vjp_residual` of S x, for a constant x
    vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar)  likewise those of `link_poses`
    ports(lane, model, par, q, y)    y[i]: the displacement that input i works on (angle or position)
    ports_after(lane, model, par, start, y0, q, y)  `ports`, y0 being those of `start`, where rotations do not add up
    difference(lane, model, start, q, d)  d: the increment by which `update` moves start to q
    update(lane, model, q, share, d, more)  q <- q moved by the increment share * d and then by `more`, or None: their
        sum, unless a formulation's coordinates add up otherwise, as rotations do; rows of multipliers are zero
    rotates(model)  None, or a tag where q holds rotations, which `update` moves by increments in body axes
    tangent_map(lane, model, d, inverse, x)  likewise, in rows of rotations: x <- T^T x, or T^-T x, with T(d) that of
        exp(d + e) = exp(d) exp(T e): of cotangents of increments in body axes those of d, or back
    note_inverse(lane, model, d, share), noted_inverse(lane, model, d, share, x)  the latter, asked for again and again
        of the same d: what all x have in common, to rows of `share`, and x <- T^-T x by it
    friction(model)  None, or a tag where joints have Coulomb friction, which is in no residual (`joints.friction`)
    light(model)  None, or a tag where joints may have next to no inertia of their own: a torque that jumps makes an
        acceleration there that steps do not resolve, which is not to be solved for with M alone
    keeps(model, iteration)  whether Newton's iteration of this number goes on with the matrix of the one before
    conserve(lane, model, par, before, h, q, v, u, r, S)  None where something holds the arm; otherwise (momentum, force
        that changes it), and with `before`, that of the start of a step of h that ends here, v is first moved so that
        the momentum has changed by the mean of the forces; r is free, S only assembled into with a mass of 0
    damping_work(lane, model, par, q, v, x)  x'C(q) v: power of the damping forces at rates v over rates x, W; what is
        lost is that over v itself
    damping_over(lane, model, par, q, v, start, end, x, h)  likewise, over what strains change by in a step of h from
        start to end, at mean rates x
    energy(lane, model, par, q, v)   (kinetic, strain, gravity), J
    link_poses(lane, model, par, q, v, out)   a `layout.POSES` a link
    task_poses(lane, model, par, q, v, out)  what tasks look at: `link_poses`, in space a `layout.SPACE_POSES` a link
    gauge(lane, model, q, row)       what a strain gauge reads, 1/m, of q by its row of `gauges.curvature_rows`
    stand(lane, model, live, angles, rates, q, v)  in space: where `live` > 1/2, q of straight links at these joint
        angles; and v by `rates`, unless these are None: of places and rotations against their link's root, in its
        axes, of joints and what else there is as they are
    out_of_range(lane, model, par, q)  0 where the model holds, otherwise the status code (as float64 lanes)
    shape(model, q, points)          SINGLE only: node positions along the chain, (n_points, 2)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiler import Family, inlined, kernel, load, nothing, size, splat, store, vjp_of


class State(NamedTuple):
    """Where an arm is, a row of the system each."""

    q: np.ndarray  # coordinates (m, rad); in rows of multipliers forces (N, N m)
    v: np.ndarray  # their first rates
    a: np.ndarray  # their second rates


class Weights(NamedTuple):
    """Shares of the residual's derivatives in a matrix to be solved with."""

    mass: float  # of that by a
    damping: float  # of that by v
    stiffness: float  # of that by q


@kernel
def of_step(weights):
    """1.0 of a step's matrix, by which its equations are solved again and again, 0.0 of others: what accelerations jump
    by is by their definition what one solution makes of them."""
    return 1.0 if weights.stiffness == 1.0 else 0.0


RESIDUAL_ALONE = Weights(0.0, 0.0, 0.0)
MASS_ALONE = Weights(1.0, 0.0, 0.0)


@kernel
def added(lane, q, share, d, more, k):
    """Row k of `update` of coordinates that add up."""
    x = load(lane, q, k) + load(lane, d, k) * share
    if more is None:
        return x
    return x + load(lane, more, k)


@inlined
def _add(lane, model, q, share, d, more):
    """`update` of coordinates that add up."""
    for k in range(size(model.n)):
        store(q, k, added(lane, q, share, d, more, k))


@inlined
def _subtract(lane, model, start, q, d):
    """`difference` of coordinates that add up."""
    for k in range(size(model.n)):
        store(d, k, load(lane, q, k) - load(lane, start, k))


@inlined
def _at_mean_rates(lane, model, par, q, v, start, end, x, h):
    """`damping_over` of strains that are nearly linear in the coordinates."""
    return damping_work(lane, model, par, q, v, x)


@kernel
def _at_once(lane, model, par, start, y0, q, y):
    """`ports_after` of ports that add up."""
    ports(lane, model, par, q, y)


@inlined
def _linear_gauge(lane, model, q, row):
    """`gauge` in the plane: a sum of coordinates, each times its weight."""
    total = splat(lane, 0.0)
    for k in range(row.shape[0]):
        total = total + load(lane, q, k) * row[k]
    return total


@kernel
def _everywhere(lane, model, par, q):
    """`out_of_range` of a formulation that holds at any deflection."""
    return splat(lane, 0.0)


@kernel
def _by_assembling(lane, model, par, state, u, r, S):
    """`residual` of a formulation that has no shorter way."""
    assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


@kernel
def _transposed(lane, model, S, x):
    """`solve_transposed` from the source: cotangents of what is linear go by its transposed."""
    _solve_backwards(lane, model, S, x, x)


@kernel
def vjp_source(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """`vjp_residual` from the source of `residual`."""
    _residual_backwards(lane, model, par, state, u, r_bar, S, par_bar, bar, u_bar, r_bar)


@kernel
def _vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """`vjp_poses` from the source."""
    _poses_backwards(lane, model, par, q, v, poses, par_bar, q_bar, v_bar, poses_bar)


@kernel
def _vjp_product(lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar):
    """`vjp_product` from the source of `multiply`."""
    _product_backwards(lane, model, par, state, u, weights, x, y_bar, S, par_bar, bar, u_bar, y_bar)


@kernel
def _product(lane, model, par, state, u, weights, x, y, S):
    """y <- S x of a matrix that is made anew."""
    assemble(lane, model, par, state, u, weights, y, S)
    for k in range(size(model.n)):
        store(y, k, splat(lane, 0.0))
    multiply(lane, model, S, x, y)


FORMULATIONS = Family("model")
"""Each formulation's functions, by the class of its Model."""

register = FORMULATIONS.register

assemble = FORMULATIONS.function("assemble", "lane, model, par, state, u, weights, r, S")
residual = FORMULATIONS.function("residual", "lane, model, par, state, u, r, S")
inertia = FORMULATIONS.function("inertia", "lane, model, par, a, r")
rotate = FORMULATIONS.function("rotate", "lane, model, start, q, share, x")
predict = FORMULATIONS.function("predict", "lane, model, start, q")
settle = FORMULATIONS.function("settle", "lane, model, par, start, w, active, slopes")
stride = FORMULATIONS.function("stride", "model")
lack = FORMULATIONS.function("lack", "model")
constrain = FORMULATIONS.function("constrain", "lane, model, psi, state, level, scale, r")
pin = FORMULATIONS.function("pin", "lane, model, S, k")
stiffen = FORMULATIONS.function("stiffen", "lane, model, S, k, x")
gyrate = FORMULATIONS.function("gyrate", "lane, model, S, k, momentum")
sway = FORMULATIONS.function("sway", "lane, model, S, k")
lean = FORMULATIONS.function("lean", "lane, model, S, k, x")
factor = FORMULATIONS.function("factor", "lane, model, S")
solve = FORMULATIONS.function("solve", "lane, model, S, x")
solve_transposed = FORMULATIONS.function("solve_transposed", "lane, model, S, x")
vjp_residual = FORMULATIONS.function("vjp_residual", "lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar")
multiply = FORMULATIONS.function("multiply", "lane, model, S, x, y")
vjp_product = FORMULATIONS.function(
    "vjp_product", "lane, model, par, par_bar, state, u, weights, x, S, bar, u_bar, y_bar"
)
vjp_poses = FORMULATIONS.function("vjp_poses", "lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar")
ports = FORMULATIONS.function("ports", "lane, model, par, q, y")
ports_after = FORMULATIONS.function("ports_after", "lane, model, par, start, y0, q, y")
difference = FORMULATIONS.function("difference", "lane, model, start, q, d")
update = FORMULATIONS.function("update", "lane, model, q, share, d, more")
rotates = FORMULATIONS.function("rotates", "model")
tangent_map = FORMULATIONS.function("tangent_map", "lane, model, d, inverse, x")
note_inverse = FORMULATIONS.function("note_inverse", "lane, model, d, share")
noted_inverse = FORMULATIONS.function("noted_inverse", "lane, model, d, share, x")
friction = FORMULATIONS.function("friction", "model")
conserve = FORMULATIONS.function("conserve", "lane, model, par, before, h, q, v, u, r, S")
light = FORMULATIONS.function("light", "model")
keeps = FORMULATIONS.function("keeps", "model, iteration")
damping_work = FORMULATIONS.function("damping_work", "lane, model, par, q, v, x")
damping_over = FORMULATIONS.function("damping_over", "lane, model, par, q, v, start, end, x, h")
energy = FORMULATIONS.function("energy", "lane, model, par, q, v")
link_poses = FORMULATIONS.function("link_poses", "lane, model, par, q, v, out")
task_poses = FORMULATIONS.function("task_poses", "lane, model, par, q, v, out")
gauge = FORMULATIONS.function("gauge", "lane, model, q, row")
stand = FORMULATIONS.function("stand", "lane, model, live, angles, rates, q, v")
out_of_range = FORMULATIONS.function("out_of_range", "lane, model, par, q")
shape = FORMULATIONS.function("shape", "model, q, points")

FORMULATIONS.defaults.update(
    predict=nothing, settle=nothing, stride=nothing, lack=nothing, update=_add, difference=_subtract, rotates=nothing,
    residual=_by_assembling, constrain=nothing, stiffen=nothing, friction=nothing, light=nothing, conserve=nothing,
    keeps=nothing, ports_after=_at_once, damping_over=_at_mean_rates, task_poses=link_poses, gauge=_linear_gauge,
    out_of_range=_everywhere, solve_transposed=_transposed, vjp_residual=vjp_source, vjp_poses=_vjp_poses,
    vjp_product=_vjp_product,
)  # fmt: skip
"""What formulations have unless they say otherwise: coordinates that add up, and joints that are coordinates."""

_solve_backwards = vjp_of(solve, ("x",))
_residual_backwards = vjp_of(residual, ("par", "state", "u", "r"), scratch=("S",))
_poses_backwards = vjp_of(task_poses, ("par", "q", "v", "out"))
_product_backwards = vjp_of(_product, ("par", "state", "u", "y"), scratch=("S",))
