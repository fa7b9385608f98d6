"""Chains of links in space whose coordinates are their strains: the residual, its matrix, how that is solved.

Rows: the base's place and its rotation vector; of each link the joint's angle, then its strains, three numbers a
polynomial (torsion, bending about y and about z). Newton's matrix goes along the chain: what is on a link's last
section is taken to its root and its strains, these are eliminated, then the joint.
"""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from ..arithmetic import add
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS
from ..protocol import RESIDUAL_ALONE, State, register
from .chain import SpatialElastica, body, clear, hinged, loaded, rotor_moment, three_of, vertex_at
from .elastica_output import (
    damping_work,
    difference,
    energy,
    shape,
    stand,
    update,
)
from .equations import _add, _both, _handed, _note
from .inner import factors, solution
from .layout import AXES, B, F, H, J, L, P, before, count_of, factor_at, hinge_at, joint_row
from .matrix import (
    _block,
    _eliminate_joint,
    block_times,
    factor_base,
    gyrate,
    lean,
    matrix_in,
    pin,
    solve_base,
    stiffen,
    sway,
)
from .output import link_poses, ports, ports_after, task_poses
from .rotations import add_vector, back, dot, minus, plus, put_vector, times, turned, vector
from .strained import elastic, pull, strain_row, walk
from .strained_layout import noted_at
from .strained_tangent import strained_tangent


@kernel
def _onto(lane, model, r, S, k, of):
    """(force, moment) to what is on the section before joint k."""
    if k == 0:
        _add(lane, r, 0, of)
    else:
        _add(lane, S, noted_at(model, k - 1).on, of)


@kernel
def assemble(lane, model, par, state, u, weights, r, S):
    """See `protocol`."""
    zero = splat(lane, 0.0)
    for i in range(model.n):
        store(r, i, zero)
    matrix_too = weights.mass != 0.0
    if matrix_too:
        clear(lane, S, 0, B.end)
    tip = vertex_at(lane, model, state, 0)
    for k in range(model.links):
        at, h, first, o = J.end * k, hinge_at(k), factor_at(model, k, 0), before(model, k)
        clear(lane, S, noted_at(model, k).on, 6)
        if matrix_too:
            clear(lane, S, first, F.end)
        if k > 0:
            mass = splat(lane, model.joints[at + J.near + P.mass])
            _onto(lane, model, r, S, k, body(lane, model.joints, at + J.near, mass, None, tip, weights, S, o))
            _onto(lane, model, r, S, k, loaded(lane, model, u, k - 1, True, tip, weights, S, o))
        if model.rotors is not None:
            if model.rotors[k] != 0:
                _onto(lane, model, r, S, k, rotor_moment(lane, model, S, k, tip, weights, o))
        hinge = hinged(lane, model, state, k, tip)
        mass = splat(lane, model.joints[at + J.far + P.mass])
        on_root = body(lane, model.joints, at + J.far, mass, None, hinge.root, weights, S, first + F.LL)
        on_root = _both(on_root, loaded(lane, model, u, k, False, hinge.root, weights, S, first + F.LL))
        _note(lane, model, S, h, hinge, tip, on_root)
        tip = hinge.root
        if count_of(model, k) > 0:
            tip = walk(lane, model, k, state, tip, S)
    o = before(model, model.links)
    mass, share = load(lane, par, PAYLOAD_MASS), load(lane, par, PAYLOAD_INERTIA)
    end = body(lane, model.end, 0, splat(lane, model.end[P.mass]), None, tip, weights, S, o)
    end = _both(end, body(lane, model.payload, 0, mass, share, tip, weights, S, o))
    _onto(lane, model, r, S, model.links, end)
    _onto(lane, model, r, S, model.links, loaded(lane, model, u, model.links - 1, True, tip, weights, S, o))
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        h, on = hinge_at(k), noted_at(model, k).on
        force, moment = vector(lane, S, h + H.now_force), vector(lane, S, h + H.now_moment)
        if count_of(model, k) > 0:
            on_root = pull(lane, model, k, r, S)
            elastic(lane, model, par, k, state, r)
            if matrix_too:
                strained_tangent(lane, model, par, k, weights, S, factor_at(model, k, 0))
        else:
            on_root = vector(lane, S, on), vector(lane, S, on + 3)
        force, moment = plus(force, on_root[0]), plus(moment, on_root[1])
        _onto(lane, model, r, S, k, _handed(lane, model, u, weights, r, S, k, force, moment))


@kernel
def conserve(lane, model, par, before, h, q, v, u, zero, r, S):
    """See `protocol`, and `equations.conserve`: but for the base's place all that moves is relative."""
    if model.free is None:
        return None
    clear(lane, zero, 0, model.n)
    assemble(lane, model, par, State(q, zero, v), u, RESIDUAL_ALONE, r, S)
    mass, nothing = load(lane, par, PAYLOAD_MASS) + model.free, splat(lane, 0.0)
    momentum, push = vector(lane, r, 0), (nothing, nothing, nothing)
    if model.gravity is not None:
        push = times(three_of(lane, model.gravity, 0), mass)
    if model.loads is not None:
        for f in range(model.loads.shape[0] // L.end):
            push = plus(push, vector(lane, u, model.links + AXES * f))
    momentum = plus(momentum, push)
    if before is None:
        return momentum, push
    wanted = plus(before[0], times(plus(before[1], push), 0.5 * h))
    add_vector(lane, v, 0, times(minus(wanted, momentum), 1.0 / mass))
    return wanted, push


@kernel
def renewed(model, iteration):
    """See `protocol`: the matrix costs four residuals and more; what does not converge with one has all of its own."""
    return iteration == 0 or iteration > 2


# ------------------------------------------------------------------ the matrix
@kernel
def _rows(model):
    """Rows of a link's strains."""
    return 3 * len(model.polynomials)


@kernel
def _to_last(lane, S, to, a, b):
    """What a link's last section moves by where its root moves by (a, b)."""
    return plus(a, turned(matrix_in(lane, S, to.shift), b)), back(matrix_in(lane, S, to.last_turn), b)


@kernel
def _to_root(lane, S, to, a, b):
    """What (a, b) on the last section is on the root."""
    return a, plus(turned(matrix_in(lane, S, to.last_turn), b), back(matrix_in(lane, S, to.shift), a))


@kernel
def _times_transposed(lane, S, o, a, b):
    """The transpose of the 6 x 6 matrix at o times (a, b)."""
    upper = plus(back(_block(lane, S, o, 0, 0), a), back(_block(lane, S, o, 1, 0), b))
    return upper, plus(back(_block(lane, S, o, 0, 1), a), back(_block(lane, S, o, 1, 1), b))


@kernel
def _condense(lane, model, S, k):
    """What is on the last section of link k to its root, without the strains."""
    n, to, f = _rows(model), noted_at(model, k), factor_at(model, k, 0)
    zero = splat(lane, 0.0)
    one = zero + 1.0
    for c in range(n):
        i = to.last + 6 * c
        on = block_times(lane, S, f + F.RR, vector(lane, S, i), vector(lane, S, i + 3))
        for row in range(n):
            o = to.last + 6 * row
            add(lane, S, to.matrix + n * row + c, dot(vector(lane, S, o), on[0]) + dot(vector(lane, S, o + 3), on[1]))
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.on_root + 6 * c, on[0])
        add_vector(lane, S, to.on_root + 6 * c + 3, on[1])
        on = _times_transposed(lane, S, f + F.RR, vector(lane, S, i), vector(lane, S, i + 3))
        on = _to_root(lane, S, to, on[0], on[1])
        add_vector(lane, S, to.by_root + 6 * c, on[0])
        add_vector(lane, S, to.by_root + 6 * c + 3, on[1])
    c = 0
    for axis in ((one, zero, zero), (zero, one, zero), (zero, zero, one)):
        for place, turn in ((axis, (zero, zero, zero)), ((zero, zero, zero), axis)):
            moved = _to_last(lane, S, to, place, turn)
            on = block_times(lane, S, f + F.RR, moved[0], moved[1])
            on = _to_root(lane, S, to, on[0], on[1])
            for i in range(3):
                add(lane, S, f + F.LL + 6 * i + c, on[0][i])
                add(lane, S, f + F.LL + 6 * i + 18 + c, on[1][i])
            c += 3
        c -= 5
    factors(lane, n, S, to.matrix)
    for i in range(6 * n):
        store(S, to.over + i, load(lane, S, to.by_root + i))
    for c in range(6):
        solution(lane, n, S, to.matrix, S, to.over + c, 6)
    for i in range(6):
        for j in range(6):
            total = load(lane, S, f + F.LL + 6 * i + j)
            for c in range(n):
                total = total - load(lane, S, to.on_root + 6 * c + i) * load(lane, S, to.over + 6 * c + j)
            store(S, f + F.LL + 6 * i + j, total)


@kernel
def factor(lane, model, S):
    """See `protocol`."""
    for back_k in range(model.links):
        k = model.links - 1 - back_k
        if count_of(model, k) > 0:
            _condense(lane, model, S, k)
        _eliminate_joint(lane, model, S, k)
    factor_base(lane, S)


@kernel
def _down(lane, model, S, k, x):
    """Forward elimination of link k: what is left on the section before it, and on its joint."""
    h, row, to, n = hinge_at(k), joint_row(model, k), noted_at(model, k), _rows(model)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    a, b = vector(lane, S, to.x), vector(lane, S, to.x + 3)
    if count_of(model, k) > 0:
        i = strain_row(model, k)
        for c in range(n):
            last = to.last + 6 * c
            add(lane, x, i + c, dot(vector(lane, S, last), a) + dot(vector(lane, S, last + 3), b))
        a, b = _to_root(lane, S, to, a, b)
        solution(lane, n, S, to.matrix, x, i, 1)
        for c in range(n):
            own, on = load(lane, x, i + c), to.on_root + 6 * c
            a, b = minus(a, times(vector(lane, S, on), own)), minus(b, times(vector(lane, S, on + 3), own))
    on_section, on_joint = turned(turn, b), dot(axis, b)
    if model.levers is not None:
        on_section = plus(on_section, back(matrix_in(lane, S, h + H.shift), a))
        on_joint = on_joint + dot(vector(lane, S, h + H.swing), a)
    if S[(h + H.pinned) * len(lane)] == 0.0:
        own = (load(lane, x, row) + on_joint) * load(lane, S, h + H.pivot)
        a = minus(a, times(vector(lane, S, h + H.column), own))
        on_section = minus(on_section, times(vector(lane, S, h + H.column + 3), own))
        store(x, row, own)
    if k == 0:
        add_vector(lane, x, 0, a)
        add_vector(lane, x, 3, on_section)
    else:
        before = noted_at(model, k - 1).x
        put_vector(S, before, a)
        put_vector(S, before + 3, on_section)


@kernel
def _up(lane, model, S, k, x):
    """Back substitution of link k."""
    h, row, to, n = hinge_at(k), joint_row(model, k), noted_at(model, k), _rows(model)
    axis, turn = three_of(lane, model.joints, J.end * k + J.axis), matrix_in(lane, S, h + H.turn)
    if k == 0:
        a, turned_by = vector(lane, x, 0), vector(lane, x, 3)
    else:
        before = noted_at(model, k - 1).x
        a, turned_by = vector(lane, S, before), vector(lane, S, before + 3)
    own = load(lane, x, row)
    own = own - dot(vector(lane, S, h + H.row), a) - dot(vector(lane, S, h + H.row + 3), turned_by)
    store(x, row, own)
    b = plus(back(turn, turned_by), times(axis, own))
    if model.levers is not None:
        shift = turned(matrix_in(lane, S, h + H.shift), turned_by)
        a = plus(a, plus(shift, times(vector(lane, S, h + H.swing), own)))
    if count_of(model, k) > 0:
        i = strain_row(model, k)
        last = _to_last(lane, S, to, a, b)
        for c in range(n):
            over, o = to.over + 6 * c, to.last + 6 * c
            found = load(lane, x, i + c) - dot(vector(lane, S, over), a) - dot(vector(lane, S, over + 3), b)
            store(x, i + c, found)
            last = plus(last[0], times(vector(lane, S, o), found)), plus(last[1], times(vector(lane, S, o + 3), found))
        a, b = last
    put_vector(S, to.x, a)
    put_vector(S, to.x + 3, b)


@kernel
def solve(lane, model, S, x):
    """See `protocol`."""
    clear(lane, S, noted_at(model, model.links - 1).x, 6)
    for back_k in range(model.links):
        _down(lane, model, S, model.links - 1 - back_k, x)
    solve_base(lane, S, x, False)
    for k in range(model.links):
        _up(lane, model, S, k, x)


register(
    SpatialElastica, assemble=assemble, pin=pin, stiffen=stiffen, factor=factor, solve=solve, update=update,
    difference=difference, energy=energy, ports=ports, ports_after=ports_after, damping_work=damping_work,
    link_poses=link_poses, shape=shape, task_poses=task_poses, stand=stand, conserve=conserve, gyrate=gyrate,
    lean=lean, sway=sway, renewed=renewed,
)  # fmt: skip
