"""A chain of floating frames without multipliers: residual, Newton matrix and its factors (theory, section 3).

Model: `physics.model.FloatingChain`. A body's frame begins at the end of the preceding body. The frame's origin and
angle are therefore functions of the elastic coordinates of the preceding bodies, and rigid joints between segments need
no rows. Rows of q: x, y, angle of the root; elastic coordinates of all bodies from root to tip; angles of the elbows.

One sweep from root to tip computes the motion of every frame, one sweep from tip to root the forces. The matrix is
never formed; its blocks are eliminated body by body from the tip. The elimination is the articulated-body method,
applied to the whole tangent. The cost is linear in the number of bodies.

S contains `ROOT`, a `JOINT` per elbow, `FACTORS` per body, and `LEVER_FACTORS` of rigid ends and payload lever.
"""

from ...compiler import Lanes, kernel, load_lane, size, stack
from ..arithmetic import gravity_along, load_pair, load_vector, store_pair, store_vector
from ..layout import OF_LOAD
from ..model import PAYLOAD_INERTIA, PAYLOAD_MASS, FloatingChain
from ..protocol import State, register
from .body import forces, propagate_to_tip
from .chain_inputs import input_displacements
from .chain_output import centerline, damping_power, energy, link_poses, out_of_range
from .layout import (
    ANGLE,
    INNER,
    JOINT,
    KNOWN,
    LOADED,
    PASSED,
    ROOT,
    acts_at,
    cell,
    elastic_row,
    elbow_row,
    factors_at,
)
from .matrix import condense, reduce, restore, tangent
from .rigid import (
    ACROSS,
    ROOT_END,
    SWEPT,
    TIP_END,
    condense_to_near_point,
    end_of,
    far_point_change,
    propagate_outward,
    to_payload,
    transmit_inward,
    with_moment,
)

THREE, FIVE, NINE = (0,) * 3, (0,) * 5, (0,) * 9
NUMBERS = (0,) * KNOWN.end


@kernel
def _stride(model):
    """Return the number of entries of S for each body."""
    return factors_at(0, size(model.mesh.n)).end


@kernel
def _bodies_at(model):
    """Return the index in S of the first body's `FACTORS`."""
    return ROOT.end + JOINT.end * (model.links - 1)


@kernel
def _levers_at(model):
    """Return the index in S of the first `LEVER_FACTORS`."""
    return _bodies_at(model) + _stride(model) * model.links * model.segments


@kernel
def _joint_at(k):
    """Return the index in S of the `JOINT` of elbow k >= 1."""
    return ROOT.end + JOINT.end * (k - 1)


@kernel
def frame_at(lane, model, state: State, i, pose):
    """Write the motion of the frame in rows i, i + 1, i + ANGLE of state into pose (5,), the `PASSED` of its origin.

    The three rows of `state` (q, v, a of the arm) are x, y (inertial axes) and angle.
    pose: angle (rad), its rate and acceleration, then the acceleration of the origin minus gravity (m/s^2, inertial
    axes).
    """
    q, v, a = state
    store_vector(lane, pose, PASSED.angle, (q[i + ANGLE], v[i + ANGLE], a[i + ANGLE]))
    ax, ay = load_pair(lane, a, i)
    store_pair(lane, pose, PASSED.ax, (ax - gravity_along(model.gravity, 0), ay - gravity_along(model.gravity, 1)))


@kernel
def subtract_loads(lane, model, link, end, u: Lanes, force: Lanes):
    """Subtract the point loads at an end (a `LOADED.side`) of a link from the force and moment in `force` (3,).

    force: components along inertial axes (N), then the moment (N m).
    u: inputs, i.e. joint torques of all links, then x, y and torque of each load (`LOAD`).
    """
    if model.loads is not None:
        for f in range(model.loads.shape[0] // LOADED.end):
            if acts_at(model.loads, f, link, end):
                for i in range(3):
                    force[i] -= u[model.links + OF_LOAD.end * f + i]


@kernel
def payload_force(lane, par: Lanes, pose: Lanes, force, carried):
    """Compute the payload's inertia force m_p (r'' - g) and moment J_p alpha at a pose (`PASSED`), inertial axes.

    # out      force (3,): N, N, N m; carried (2,): m_p (kg), J_p (kg m^2), which mass-proportional damping needs
    """
    mass, inertia = par[PAYLOAD_MASS], par[PAYLOAD_INERTIA]
    ax, ay = load_pair(lane, pose, PASSED.ax)
    store_vector(lane, force, 0, (ax * mass, ay * mass, pose[PASSED.second] * inertia))
    store_pair(lane, carried, 0, (mass, inertia))


@kernel
def assemble(lane, model, par: Lanes, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Compute the residual r of equation [64] and, with weights.with_matrix, the blocks of the Newton matrix.

    Rows of r are force (N, inertial axes) and moment (N m) at the root minus the hub's torque, then each body's elastic
    coordinates (theory, 3.2), then at each elbow the moment minus the elbow's torque, N m.
    u: joint torques (N m), then point loads.
    weights: `Weights` of dr/da, dr/dv, dr/dq. S receives the bodies' `FACTORS.matrix` and lever arms, which `factor`
    eliminates. See `protocol.assemble`.
    """
    q, v, a = state
    cm, cc, ck, with_matrix = weights.mass, weights.damping, weights.stiffness, weights.with_matrix
    mesh = model.mesh
    pose, force, carried = stack(lane, FIVE), stack(lane, THREE), stack(lane, THREE)
    known, vectors, strains = stack(lane, NUMBERS), stack(lane, mesh.scratch), stack(lane, mesh.strains)
    stride, first, levers = _stride(model), _bodies_at(model), _levers_at(model)
    # from root to tip (3.1): theta, w, alpha and R'' - g (inertial axes) of every section
    frame_at(lane, model, state, 0, pose)
    for k in range(model.links):
        # (3.1): theta, w, alpha behind the elbow increase by beta, beta', beta''
        if k > 0:
            elbow = elbow_row(model, k)
            pose[PASSED.angle] += q[elbow]
            pose[PASSED.rate] += v[elbow]
            pose[PASSED.second] += a[elbow]
        propagate_outward(lane, end_of(model, k, ROOT_END), pose, S, levers)
        for b in range(k * model.segments, (k + 1) * model.segments):
            e = elastic_row(model, b)
            propagate_to_tip(
                lane, mesh, model.data[model.block * b :], q[e:], v[e:], a[e:], pose, S[first + stride * b :]
            )
        propagate_outward(lane, end_of(model, k, TIP_END), pose, S, levers)
    propagate_outward(lane, to_payload(model), pose, S, levers)
    # from tip to root (3.2): G (inertial axes) and M required by all bodies beyond
    payload_force(lane, par, pose, force, carried)
    transmit_inward(lane, to_payload(model), force, weights, S, levers)
    for k in range(model.links - 1, -1, -1):
        subtract_loads(lane, model, k, 1, u, force)
        transmit_inward(lane, end_of(model, k, TIP_END), force, weights, S, levers)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            if model.inside is not None:
                subtract_loads(lane, model, k, INNER + b - k * model.segments, u, force)
            e, D, own = elastic_row(model, b), model.data[model.block * b :], S[first + stride * b :]
            forces(lane, mesh, D, par, carried, q[e:], v[e:], a[e:], force, known, vectors, strains, own, r[e:])
            # d(f_R, f_theta, r_q) of the body alone, at constant G and M; `condense` adds the bodies beyond
            if with_matrix:
                tangent(lane, mesh, D, par, carried, cm, cc, ck, v[e:], a[e:], known, vectors, strains, own)
            # G and M hold the payload from here on: only the last body adds it in its own tip
            store_pair(lane, carried, 0, (0.0, 0.0))
        transmit_inward(lane, end_of(model, k, ROOT_END), force, weights, S, levers)
        subtract_loads(lane, model, k, 0, u, force)
        # r_beta = M - u, eq. (3.2)
        if k > 0:
            r[elbow_row(model, k)] = force[2] - u[k]
    # r of R and theta at the root: G (inertial axes) and M - tau_0
    fx, fy, moment = load_vector(lane, force, 0)
    store_vector(lane, r, 0, (fx, fy, moment - u[0]))
    # nothing is pinned until `add_stiffness`; cm and the payload's inertia are kept for `factor` and `solve`
    if with_matrix:
        for k in range(3):
            S[ROOT.pinned + k] = 0.0
        for k in range(1, model.links):
            S[_joint_at(k) + JOINT.pinned] = 0.0
            S[_joint_at(k) + JOINT.own] = 0.0
        S[ROOT.own] = 0.0
        store_pair(lane, S, ROOT.scale, (cm, 1.0 / cm))
        store_pair(lane, S, ROOT.tail, (par[PAYLOAD_INERTIA] * cm, par[PAYLOAD_MASS]))


@kernel
def add_stiffness(lane, model, S: Lanes, k, x):
    """Add x (N m/rad) to the stiffness for row k, the angle of hub or elbow, which `factor` adds to the diagonal.

    If x is None, row k of the root (0 to 2) or of an elbow is fixed: `factor` and `solve` then use the row of the
    identity matrix instead.
    """
    elbow = _joint_at(k - elbow_row(model, 0))
    if x is None:
        S[elbow + JOINT.pinned if k > 2 else ROOT.pinned + k] = 1.0
    else:
        S[elbow + JOINT.own if k > 2 else ROOT.own] += x


@kernel
def _with_own(lane, model, S: Lanes, at, x, y):
    """Return x + S[at] y in a jointed arm (`model.jointed`), otherwise x. at: index of `own` of a joint or the root."""
    if model.jointed is None:
        return x
    return x + S[at] * y


@kernel
def diagonal(lane, tail, zero, mass, inertia):
    """Write the matrix diag(mass, mass, inertia) of a rigid body (rows: force, moment) by rows into tail (9,).

    inertia: inertia times cm, the weight of accelerations in the Newton matrix. zero: 0.0 in every lane.
    """
    store_vector(lane, tail, cell(0, 0), (mass, zero, zero))
    store_vector(lane, tail, cell(1, 0), (zero, mass, zero))
    store_vector(lane, tail, cell(2, 0), (zero, zero, inertia))


@kernel
def factor(lane, model, S: Lanes):
    """Factor S in place: eliminate the bodies and elbows from tip to root, then factor the root's 3 x 3 matrix.

    `tail` (9,) is a 3 x 3 matrix by rows, in inertial axes, which represents all bodies beyond a section. `tail` maps
    the section's weighted acceleration (x, y) and angle to the change of force and moment at the section. Pivots are
    stored inverted. At a free elbow the angle of the section beyond the elbow is eliminated. The moment at this elbow
    is the joint's torque, so the elbow transmits no change of moment. A fixed elbow transmits the whole change. See
    docs/theory.md, (3.3).
    """
    stride, first = _stride(model), _bodies_at(model)
    tail, (inertia, mass) = stack(lane, NINE), load_pair(lane, S, ROOT.tail)
    zero, one = 0.0, 1.0
    # d(G, M) by (R'', theta) of the payload, diag(m_p, m_p, J_p c_m), carried through its lever to the tip
    diagonal(lane, tail, zero, mass, inertia)
    levers = _levers_at(model)
    condense_to_near_point(lane, to_payload(model), S, levers, tail)
    for k in range(model.links - 1, -1, -1):
        condense_to_near_point(lane, end_of(model, k, TIP_END), S, levers, tail)
        # d(G, M) by (R'', theta) at the tip of link k becomes that at its root, body by body, then by its lever
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            condense(lane, model.mesh, model.data[model.block * b :], S[first + stride * b :], tail)
        condense_to_near_point(lane, end_of(model, k, ROOT_END), S, levers, tail)
        if k > 0:
            # free elbow: pivot = moment by angle beyond, plus joint stiffness
            o = _joint_at(k)
            if load_lane(lane, S, o + JOINT.pinned, 0) == 0.0:
                inverse = one / _with_own(lane, model, S, o + JOINT.own, tail[cell(2, 2)], 1.0)
                S[o + JOINT.inverse] = inverse
                # column S_xb / pivot and row S_bx of the elbow's angle beta
                for i in range(2):
                    S[o + JOINT.column + i] = tail[cell(i, 2)] * inverse
                    S[o + JOINT.row + i] = tail[cell(2, i)] * inverse
                # Schur complement of the pivot in x, y: d(G) - column row^T
                for i in range(2):
                    for j in range(2):
                        part = S[o + JOINT.column + i] * tail[cell(2, j)]
                        tail[cell(i, j)] -= part
                if model.jointed is None:  # nothing of the angle behind is left for that before
                    for i in range(3):
                        tail[cell(i, 2)] = zero
                        tail[cell(2, i)] = zero
                else:
                    # s couples theta before and behind: S_(x, before) = (s / pivot) S_(x, behind)
                    share = S[o + JOINT.own] * inverse
                    S[o + JOINT.own] = share
                    for i in range(2):
                        tail[cell(i, 2)] *= share
                        tail[cell(2, i)] *= share
                    tail[cell(2, 2)] *= share
    # hub: S_theta += s; fixed rows and columns become those of the identity
    tail[cell(2, 2)] = _with_own(lane, model, S, ROOT.own, tail[cell(2, 2)], 1.0)
    for i in range(3):
        for j in range(3):
            entry = tail[cell(i, j)]
            if load_lane(lane, S, ROOT.pinned + i, 0) != 0.0 or load_lane(lane, S, ROOT.pinned + j, 0) != 0.0:
                entry = one if i == j else zero
            S[ROOT.factors + cell(i, j)] = entry
    # LU of the root's matrix without pivoting
    F = ROOT.factors
    for k in range(3):
        if load_lane(lane, S, ROOT.pinned + k, 0) == 0.0:  # a row of the identity is its own factor
            inverse = one / S[F + cell(k, k)]
            S[F + cell(k, k)] = inverse
            for i in range(k + 1, 3):
                f = S[F + cell(i, k)] * inverse
                S[F + cell(i, k)] = f
                for j in range(k + 1, 3):
                    S[F + cell(i, j)] -= f * S[F + cell(k, j)]


@kernel
def solve(lane, model, S: Lanes, x: Lanes):
    """Replace the right sides x by the increments S^-1 x in all rows of the arm; S contains the factors from `factor`.

    The order is from tip to root, then the root's 3 x 3 system, then back from root to tip. flow (3,) is in inertial
    axes. On the way to the root, flow is the force and moment at a section that result from the reduced right sides of
    the bodies beyond. On the way back, flow is the weighted acceleration and angle of the section. See docs/theory.md,
    (3.3).
    """
    mesh, stride, first = model.mesh, _stride(model), _bodies_at(model)
    flow, levers, zero = stack(lane, THREE), _levers_at(model), 0.0
    store_vector(lane, flow, 0, (zero, zero, zero))
    # reduced right sides from tip to root: (G, M) that eliminated rows still require of the body before
    for k in range(model.links - 1, -1, -1):
        with_moment(lane, end_of(model, k, TIP_END), S, levers, ACROSS, flow)
        for b in range((k + 1) * model.segments - 1, k * model.segments - 1, -1):
            D, own = model.data[model.block * b :], S[first + stride * b :]
            reduce(lane, mesh, D, own, x[elastic_row(model, b) :], flow)
        with_moment(lane, end_of(model, k, ROOT_END), S, levers, ACROSS, flow)
        if k > 0:
            o = _joint_at(k)
            if load_lane(lane, S, o + JOINT.pinned, 0) == 0.0:
                # free elbow: the row's right side less the moment that arrives; the right side itself passes on (less
                # joint stiffness)
                wanted = x[elbow_row(model, k)]
                left = wanted - flow[2]
                for i in range(2):
                    flow[i] += S[o + JOINT.column + i] * left
                x[elbow_row(model, k)] = left
                flow[2] = _with_own(lane, model, S, o + JOINT.own, wanted, -left)
    # right side of the root's rows; a fixed row keeps its own (x, y as accelerations: times cm)
    for i in range(3):
        right = x[i]
        if load_lane(lane, S, ROOT.pinned + i, 0) == 0.0:
            right = right - flow[i]
        elif i < 2:
            right = right * S[ROOT.scale]
        flow[i] = right
    # (R, theta) of the root: L y = b, U x = y with the 3 x 3 factors
    F = ROOT.factors
    for i in range(1, 3):
        if load_lane(lane, S, ROOT.pinned + i, 0) == 0.0:
            for j in range(i):
                flow[i] -= S[F + cell(i, j)] * flow[j]
    for i in range(2, -1, -1):
        if load_lane(lane, S, ROOT.pinned + i, 0) == 0.0:
            total = flow[i]
            for j in range(i + 1, 3):
                total = total - S[F + cell(i, j)] * flow[j]
            flow[i] = total * S[F + cell(i, i)]
    # the unknown of x, y is R'', c_m times their increment: divided here
    (dx, dy, turn), inverse = load_vector(lane, flow, 0), S[ROOT.scale + 1]
    store_vector(lane, x, 0, (dx * inverse, dy * inverse, turn))
    # back substitution from root to tip: each body's q from the motion (dR'', dtheta) of its root
    for k in range(model.links):
        if k > 0:
            # elbow: angle of the section beyond, from its pivot row; the elbow's increment is the difference of both
            # angles
            o, before = _joint_at(k), flow[2]
            turn = before
            if load_lane(lane, S, o + JOINT.pinned, 0) == 0.0:
                turn = x[elbow_row(model, k)] * S[o + JOINT.inverse]
                for i in range(2):
                    turn = turn - S[o + JOINT.row + i] * flow[i]
                turn = _with_own(lane, model, S, o + JOINT.own, turn, before)
            x[elbow_row(model, k)] = turn - before
            flow[2] = turn
        far_point_change(lane, end_of(model, k, ROOT_END), S, levers, SWEPT, flow)
        for b in range(k * model.segments, (k + 1) * model.segments):
            D, own = model.data[model.block * b :], S[first + stride * b :]
            restore(lane, mesh, D, own, x[elastic_row(model, b) :], flow)
        far_point_change(lane, end_of(model, k, TIP_END), S, levers, SWEPT, flow)


register(
    FloatingChain, assemble, add_stiffness, factor, solve, input_displacements, damping_power, energy,
    link_poses, out_of_range, centerline,
)  # fmt: skip
