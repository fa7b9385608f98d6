"""Derivatives backwards of a chain of exact beams without rigid ends and point loads: residual and poses.

From tip to root, an element at a time, each written out backwards from its own source (`compiler.vjp_of`); what comes
back to a vertex goes to its row, but for the force on it, which the element before has handed on.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, stack, store, vjp_of
from ..arithmetic import add
from ..layout import POSE
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, ExactBeam
from ..protocol import State, register
from .element import ACCELERATION, FORCE, RATE, VERTEX, directions, forces
from .equations import solve
from .layout import AXES, PAIR, T, Vertex, elbow_of, next_section, rows_of, section_of

LEFT, PASSED_ON = (0,) * VERTEX, (0,) * AXES


def _element(lane, order, gravity, section, q, v, a, left, right, r):
    """Rows of an element's left vertex and its interior, and the force on its right one; left: a `Vertex`, flat."""
    at = [load(lane, left, k) for k in range(VERTEX)]
    circle = stack(lane, (0,) * (PAIR * len(order)))
    vertex = Vertex(at[:RATE], at[RATE:ACCELERATION], at[ACCELERATION:FORCE], at[FORCE:])
    directions(lane, order, q, at[T], circle)
    out = forces(lane, order, gravity, State(q, v, a), vertex, section, r, circle)
    for k in range(AXES):
        store(right, k, out[FORCE + k])


_vjp_element = vjp_of(_element, ("q", "v", "a", "left", "right", "r"))


@kernel
def _falling(gravity, k):
    if gravity is None:
        return 0.0
    return gravity[k] if k < T else 0.0


@kernel
def _reach(lane, model, state, i, hinge, left):
    """left <- place, rate and acceleration of the vertex at row i, behind the hinge at that row where it is not -1; no
    force: what it does is linear."""
    for k in range(AXES):
        q, v, a = load(lane, state.q, i + k), load(lane, state.v, i + k), load(lane, state.a, i + k)
        if k == T and hinge >= 0:
            q, v, a = q + load(lane, state.q, hinge), v + load(lane, state.v, hinge), a + load(lane, state.a, hinge)
        store(left, k, q)
        store(left, RATE + k, v)
        store(left, ACCELERATION + k, a - _falling(model.gravity, k))
        store(left, FORCE + k, splat(lane, 0.0))


@kernel
def _vjp_hinge(lane, bar, i, hinge, left):
    """Cotangents of a vertex, given on to its own rows and to those of the hinge before it."""
    for k in range(AXES):
        add(lane, bar.q, i + k, load(lane, left, k))
        add(lane, bar.v, i + k, load(lane, left, RATE + k))
        add(lane, bar.a, i + k, load(lane, left, ACCELERATION + k))
    if hinge >= 0:
        add(lane, bar.q, hinge, load(lane, left, T))
        add(lane, bar.v, hinge, load(lane, left, RATE + T))
        add(lane, bar.a, hinge, load(lane, left, ACCELERATION + T))


@kernel
def vjp_residual(lane, model, par, par_bar, state, u, S, bar, u_bar, r_bar):
    """See `protocol`; nothing comes to the parameters here."""
    rows, span, zero = rows_of(model), AXES * len(model.order), splat(lane, 0.0)
    left, left_bar = stack(lane, LEFT), stack(lane, LEFT)
    right, right_bar = stack(lane, PASSED_ON), stack(lane, PASSED_ON)
    i, L = rows.tip, len(lane)
    for k in range(AXES):
        force, carried = load(lane, r_bar, i + k), PAYLOAD_INERTIA if k == T else PAYLOAD_MASS
        add(lane, bar.a, i + k, force * load(lane, par, carried))
        store(right_bar, k, force)
        store(r_bar, i + k, zero)
    for k in range(model.links - 1, -1, -1):
        first, hinge = rows.elements + span * model.elements * k, rows.hinges + k - 1 if k > 0 else -1
        moment = load(lane, r_bar, first + T)
        if k > 0:
            turned = load(lane, r_bar, hinge)
            add(lane, u_bar, k, -turned)
            store(r_bar, hinge, zero)
            store(r_bar, first + T, moment + turned)
        for e in range(model.elements - 1, -1, -1):
            i -= span
            section = section_of(lane, model, par, k)
            for _ in range(e):
                section = next_section(model, section)
            at = hinge if e == 0 else -1
            _reach(lane, model, state, i, at, left)
            for j in range(VERTEX):
                store(left_bar, j, zero)
            _vjp_element(
                lane, model.order, model.gravity, section, state.q[i * L :], state.v[i * L :], state.a[i * L :], left,
                right, S, bar.q[i * L :], bar.v[i * L :], bar.a[i * L :], left_bar, right_bar, r_bar[i * L :],
            )  # fmt: skip
            for j in range(AXES):
                store(right_bar, j, load(lane, left_bar, FORCE + j))
            if e == 0:
                _turn(lane, model, k, first, moment, left_bar, right_bar, bar, u_bar)
            _vjp_hinge(lane, bar, i, at, left_bar)


@kernel
def _turn(lane, model, k, i, moment, left_bar, right_bar, bar, u_bar):
    """What the masses at the joint before link k hand on; right_bar: the force on the vertex before it. Cotangents of
    accelerations behind it are in left_bar."""
    turned = load(lane, left_bar, FORCE + T)
    if k > 0:
        elbow = elbow_of(model, k)
        for j in range(2):
            add(lane, left_bar, ACCELERATION + j, load(lane, left_bar, FORCE + j) * elbow.mass)
        add(lane, left_bar, ACCELERATION + T, turned * elbow.right)
        add(lane, bar.a, i + T, moment * elbow.left)
        store(right_bar, T, moment)
    else:
        add(lane, left_bar, ACCELERATION + T, turned * model.hub_inertia)
        add(lane, u_bar, 0, -turned)


@kernel
def vjp_poses(lane, model, par, par_bar, q, v, poses, q_bar, v_bar, poses_bar):
    """See `protocol`."""
    rows, span, zero = rows_of(model), AXES * len(model.order) * model.elements, splat(lane, 0.0)
    for k in range(model.links):
        for end in range(2):
            at = POSE.end * k + (POSE.tip_x - POSE.x) * end
            for j in range(AXES):
                i = rows.elements + span * (k + end) + j
                place, rate = load(lane, poses_bar, at + POSE.x + j), load(lane, poses_bar, at + POSE.vx + j)
                add(lane, q_bar, i, place)
                add(lane, v_bar, i, rate)
                if k > 0 and end == 0 and j == T:
                    add(lane, q_bar, rows.hinges + k - 1, place)
                    add(lane, v_bar, rows.hinges + k - 1, rate)
                store(poses_bar, at + POSE.x + j, zero)
                store(poses_bar, at + POSE.vx + j, zero)


register(ExactBeam, vjp_residual, vjp_poses, solve_transposed=solve)
