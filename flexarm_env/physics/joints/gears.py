"""Rotors, elastic gears and viscous friction in an arm's joints, a contribution (theory, (6.5)):

    J psi'' + k (psi - q) + d (psi' - q') + friction = u,    the arm's row of q:  ... - k (psi - q) - d (psi' - q') = 0

The motor angle psi has a row of its own, which is coupled only with the joint angle q. The row of psi is eliminated
before the arm's matrix is factored. With a rigid gear J acts on q. With backlash b the spring torque is k (x - clip(x,
b/2)), x = psi - q. Damping also acts in the gap. If damping began with contact, the torque would jump at the beginning
of a contact and pull at its end.
"""

from __future__ import annotations

from ...compiler import Lanes, absolute, inlined, kernel, load_lane, select_lt
from .. import protocol
from ..arithmetic import add_to, clip, load_vector, store_where
from ..contributions import register
from ..layout import ROTOR
from ..model import Gears
from ..protocol import State
from .friction import count, direction, gear_at
from .layout import GEAR, PLACE, PLACES, hub_of, joint_law


@kernel
def _friction_row(lane, model, i, own, state: State, total):
    """Return `total` (N m) plus joint i's friction torque: viscous d v and, if the angle is prescribed, T_C sign(v).

    own: constants (`Law`) of the joint.
    v: rate of the row on which friction acts. If the angle is not prescribed, the module `friction` solves for the
    Coulomb torque.
    """
    rate = state.v[model.table[PLACES * i + PLACE.friction]]
    total = total + rate * own.viscous
    if model.table[PLACES * i + PLACE.known] != 0:
        total = total + own.coulomb * direction(lane, rate)
    return total


@kernel
def gear_torque(lane, play, stiffness, half, wound):
    """Return the torque (N m) of a gear spring that is wound by `wound` (rad), and its derivative (N m/rad).

    stiffness: N m/rad. half: half of the backlash, rad; within it the torque is 0. play: None without backlash.
    """
    if play is None:
        return wound * stiffness, stiffness
    beyond = wound - clip(wound, half)
    return beyond * stiffness, select_lt(0.0, absolute(beyond), stiffness, 0.0)


@kernel
def _through_gear(lane, part, model, i, one, state: State, u: Lanes, weights, r: Lanes, S: Lanes):
    """Write the motor's row of r (N m) and S; in the joint's row replace the input's torque by the gear's, (6.5).

    i: index in the table of a joint with an elastic gear.
    one: constants (`Law`) of the joint. The gear torque is k (psi - q) + d (psi' - q') with the motor angle psi and the
    joint angle q. With weights.with_matrix S receives the `GEAR` fields pivot and slope.
    """
    at, g = PLACES * i, gear_at(model, i)
    row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
    damping, rotor, none = one.damping, one.rotor, 0.0
    rate, second = state.v[motor], state.a[motor]
    # gear torque k (psi - q) + d (psi' - q'), N m; the joint's row has it in place of the input
    wound = state.q[motor] - state.q[row]
    torque, steep = gear_torque(lane, part.play, one.stiffness, one.play, wound)
    torque = torque + (rate - state.v[row]) * damping
    asked = u[model.table[at + PLACE.joint]]
    r[row] = r[row] + asked - torque
    # slope = k c_k + d c_v; pivot of the motor's row: J c_m + slope, plus viscous friction
    slope = steep * weights.stiffness + damping * weights.damping
    pivot = rotor * weights.mass + slope
    own = second * rotor + torque - asked
    if model.table[at + PLACE.friction] == motor:
        pivot = pivot + one.viscous * weights.damping
        own = _friction_row(lane, model, i, one, state, own)
    r[motor] = own
    if weights.with_matrix:
        S[g + GEAR.pivot] = none + pivot
        S[g + GEAR.slope] = none + slope


@kernel
def _at_joint(lane, model, i, one, state: State, weights, r: Lanes, S: Lanes):
    """Add the rotor inertia of a rigid gear, and friction on the link's side, to the joint's row of r (N m) and of S.

    i: index of the joint in the table.
    one: constants (`Law`) of the joint. With weights.with_matrix S receives the `GEAR` field own.
    """
    at, g = PLACES * i, gear_at(model, i)
    row = model.table[at + PLACE.row]
    total, own = r[row], 0.0
    if model.table[at + PLACE.motor] < 0:
        total, own = total + state.a[row] * one.rotor, own + one.rotor * weights.mass
    if model.table[at + PLACE.friction] == row:
        total, own = _friction_row(lane, model, i, one, state, total), own + one.viscous * weights.damping
    r[row] = total
    if weights.with_matrix:
        S[g + GEAR.own] = own


@kernel
def prepare(lane, part, model, par, state: State, weights, S: Lanes):
    """Store the rotors' angular momenta (N m s, along the joint axes) of an arm in space in S, for the arm's assembly.

    The momentum is J r psi', with rotor inertia J and gear ratio r; the motor angle is r psi. With weights.with_matrix
    the function also stores `GEAR.sway`, weights.damping times the derivative of the momentum by the rate psi'. If
    part.spin is None, do nothing.
    """
    if part.spin is None:
        return
    for i in range(count(model)):
        at, share = PLACES * i, joint_law(lane, model, par, i).rotor * part.spin[i]
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        # h = J r psi', along the joint's axis; a rigid gear turns the rotor with q'
        rate = state.v[motor if motor >= 0 else row]
        S[part.rotors[i] + ROTOR.momentum] = rate * share
        if weights.with_matrix:
            S[gear_at(model, i) + GEAR.sway] = 0.0 + share * weights.damping


@kernel
def assemble(lane, part, model, par, state: State, u, weights, r: Lanes, S: Lanes):
    """Add gears, rotors, viscous friction and hub inertia to r (N m); with weights.with_matrix also add entries to S.

    state: coordinates q, velocities v, accelerations a.
    u: inputs, which begin with the joint torques. S receives one `GEAR` per joint. See docs/theory.md, (6.5).
    """
    for i in range(count(model)):
        one = joint_law(lane, model, par, i)
        if model.table[PLACES * i + PLACE.motor] >= 0:
            _through_gear(lane, part, model, i, one, state, u, weights, r, S)
        _at_joint(lane, model, i, one, state, weights, r, S)
        if weights.with_matrix:
            S[gear_at(model, i) + GEAR.pinned] = 0.0
            S[gear_at(model, i) + GEAR.held] = 0.0
    # additional hub inertia: J q'' at the first joint
    if model.hub is not None:
        row, hub = model.table[PLACE.row], hub_of(lane, model, par)
        r[row] += state.a[row] * hub
        if weights.with_matrix:
            S[gear_at(model, 0) + GEAR.own] += hub * weights.mass


@kernel
def fix_coordinate(lane, part, model, S: Lanes, k):
    """Mark row k as fixed or prescribed in S: by `GEAR.pinned` for a motor's row, by `GEAR.held` for a joint's row."""
    for i in range(count(model)):
        g = gear_at(model, i)
        if model.table[PLACES * i + PLACE.motor] == k:
            S[g + GEAR.pinned] = 1.0
        if model.table[PLACES * i + PLACE.row] == k:
            S[g + GEAR.held] = 1.0


@kernel
def before_factor(lane, part, model, S: Lanes):
    """Eliminate the motors' rows: add their Schur complement slope - slope^2 / pivot to the joints' diagonal in S.

    pivot: diagonal entry of the motor's row. -slope: entry that couples motor and joint. Both are in `GEAR`. See
    docs/theory.md, (6.5).
    """
    for i in range(count(model)):
        g, row = gear_at(model, i), model.table[PLACES * i + PLACE.row]
        # own: added to the joint's diagonal; through: d psi / d q of the eliminated motor
        own, through = S[g + GEAR.own], 1.0
        if model.table[PLACES * i + PLACE.motor] >= 0:
            inverse, slope = 0.0, S[g + GEAR.slope]
            if load_lane(lane, S, g + GEAR.pinned, 0) == 0.0:
                inverse = 1.0 / S[g + GEAR.pivot]
            S[g + GEAR.pivot] = inverse
            own, through = own + (slope - slope * (slope * inverse)), slope * inverse
        if part.spin is not None:
            # in space: the moment h w x e, h = J r psi', as a column of q
            share = S[g + GEAR.sway] * through
            S[part.rotors[i] + ROTOR.factor] = share
        if load_lane(lane, S, g + GEAR.held, 0) == 0.0:
            protocol.add_stiffness(lane, model.arm, S, row, own)


@kernel
def _gyroscopic_column(lane, part, model, S: Lanes, i):
    """Return the column of the gyroscopic moment h w x e (N m) of joint i's rotor, for the three rows before it."""
    a, b, c = load_vector(lane, S, part.rotors[i] + ROTOR.column)
    share = S[gear_at(model, i) + GEAR.sway]
    return a * share, b * share, c * share


@kernel
def before_solve(lane, part, model, S: Lanes, x: Lanes, transposed):
    """Eliminate the motors' rows from x: joint row += slope / pivot * motor row (`GEAR`), in space also rotor terms.

    transposed: False for S x = b. True for S^T x = b, in which the gyroscopic columns are rows (see `after_solve`).
    """
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0 and load_lane(lane, S, g + GEAR.held, 0) == 0.0:
            share = S[g + GEAR.slope] * S[g + GEAR.pivot]
            x[row] += share * x[motor]
        if part.spin is not None and not transposed:
            if motor >= 0:  # column of psi times x_m / pivot, from the three moment rows before the joint's
                column, turned = (_gyroscopic_column(lane, part, model, S, i),
                                  x[motor] * S[g + GEAR.pivot])  # fmt: skip
                for j in range(len(column)):
                    x[row - len(column) + j] -= column[j] * turned


@kernel
def after_solve(lane, part, model, S: Lanes, x: Lanes, transposed):
    """Compute motor rows of x from joint rows: (x_motor + slope x_joint) / pivot. Pinned motors' rows do not change.

    slope, pivot: fields of `GEAR` in S.
    transposed: True for S^T x = b, in which gyroscopic columns (in space) are rows.
    """
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0 and load_lane(lane, S, g + GEAR.pinned, 0) == 0.0:
            turned = x[motor] + S[g + GEAR.slope] * x[row]
            if part.spin is not None and transposed:
                column = _gyroscopic_column(lane, part, model, S, i)
                for j in range(len(column)):
                    turned = turned - column[j] * x[row - len(column) + j]
            x[motor] = turned * S[g + GEAR.pivot]


@kernel
def inertia_forces(lane, part, model, par, a: Lanes, r: Lanes):
    """Add the inertia torques (N m) of rotors and hub at accelerations a to r; motors' rows of r are overwritten."""
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        rotor = joint_law(lane, model, par, i).rotor
        if motor >= 0:
            r[motor] = a[motor] * rotor
        else:
            r[row] += a[row] * rotor
    if model.hub is not None:
        r[model.table[PLACE.row]] += a[model.table[PLACE.row]] * hub_of(lane, model, par)


@kernel
def input_displacements(lane, part, model, q: Lanes, y: Lanes):
    """Replace the joint angles (rad) of elastic gears in y by the motor angles, on which the joint torques do work."""
    for i in range(count(model)):
        motor = model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            y[model.table[PLACES * i + PLACE.joint]] = q[motor]


@inlined
def damping_power(lane, part, model, par, q, v: Lanes, x: Lanes, total):
    """Return total plus x^T C v (W): power at virtual rates x of the gear damping and viscous friction at rates v."""
    for i in range(count(model)):
        at, one = PLACES * i, joint_law(lane, model, par, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        if motor >= 0:
            over = x[motor] - x[row]
            total = total + (v[motor] - v[row]) * over * one.damping
        own = model.table[at + PLACE.friction]
        total = total + v[own] * x[own] * one.viscous
    return total


@kernel
def _gear_deflection(play, half, wound):
    """Return the deflection (rad) of a gear spring that is wound by `wound` (rad).

    half: half of the backlash, rad. Within it the spring is not deflected. play: None without backlash.
    """
    if play is None:
        return wound
    return wound - clip(wound, half)


@kernel
def energy(lane, part, model, par, q: Lanes, v: Lanes, sums):
    """Return the energies `sums` (kinetic, strain, gravitational; J) plus those of rotors, gear springs, hub inertia.

    See docs/theory.md, (6.5).
    """
    kinetic, strain, gravity = sums
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        turns, one = row, joint_law(lane, model, par, i)
        if motor >= 0:
            turns, wound = motor, q[motor] - q[row]
            wound = _gear_deflection(part.play, one.play, wound)
            strain = strain + wound * wound * (one.stiffness * 0.5)
        rate = v[turns]
        kinetic = kinetic + rate * rate * (one.rotor * 0.5)
    if model.hub is not None:
        rate = v[model.table[PLACE.row]]
        kinetic = kinetic + rate * rate * (hub_of(lane, model, par) * 0.5)
    return kinetic, strain, gravity


@kernel
def set_joint_configuration(lane, part, model, live, rates: Lanes | None, q: Lanes, v: Lanes):
    """Set the motor angles in q to the joint angles, in lanes with live > 1/2. Gears then transmit no torque.

    rates: rates of all rows. The motors' rates are copied to v; if `rates` is None, v does not change.
    """
    for i in range(count(model)):
        row, motor = model.table[PLACES * i + PLACE.row], model.table[PLACES * i + PLACE.motor]
        if motor >= 0:
            store_where(lane, live, q, motor, q[row], q[motor])
            if rates is not None:
                store_where(lane, live, v, motor, rates[motor], v[motor])


@kernel
def vjp_residual(lane, part, model, par, state: State, bar, u_bar: Lanes, r_bar: Lanes):
    """Add the cotangents from the joints' rows of r_bar to bar and u_bar; then set the motor rows of r_bar to 0.

    r_bar: derivative of a scalar by the residual of equation (6.5).
    bar (a `State`): derivatives of the scalar by q, v, a.
    u_bar: derivative of the scalar by the inputs.
    """
    if model.hub is not None:
        row = model.table[PLACE.row]
        add_to(lane, bar.a, row, r_bar[row] * hub_of(lane, model, par))
    for i in range(count(model)):
        at, one = PLACES * i, joint_law(lane, model, par, i)
        row, motor, own = model.table[at + PLACE.row], model.table[at + PLACE.motor], model.table[at + PLACE.friction]
        turned = motor if motor >= 0 else row
        add_to(lane, bar.a, turned, r_bar[turned] * one.rotor)
        add_to(lane, bar.v, own, r_bar[own] * one.viscous)
        if motor >= 0:
            # cotangent of the gear's torque: +1 in the motor's row, -1 in the joint's
            torque = r_bar[motor] - r_bar[row]
            wound = state.q[motor] - state.q[row]
            _, steep = gear_torque(lane, part.play, one.stiffness, one.play, wound)
            u_bar[model.table[at + PLACE.joint]] -= torque
            add_to(lane, bar.q, motor, torque * steep)
            add_to(lane, bar.q, row, -(torque * steep))
            add_to(lane, bar.v, motor, torque * one.damping)
            add_to(lane, bar.v, row, -(torque * one.damping))
            r_bar[motor] = 0.0


@kernel
def multiply(lane, part, model, S: Lanes, x: Lanes, y: Lanes):
    """Add the part of S x from motors, gears and rotors to y (n rows); S is not factored yet (theory, 6.5)."""
    for i in range(count(model)):
        at, g = PLACES * i, gear_at(model, i)
        row, motor = model.table[at + PLACE.row], model.table[at + PLACE.motor]
        # (q, psi) couple by [[own + slope, -slope], [-slope, pivot]]
        turned = x[row]
        y[row] += S[g + GEAR.own] * turned
        if motor >= 0:
            slope, wound = S[g + GEAR.slope], x[motor]
            y[row] += slope * (turned - wound)
            y[motor] += S[g + GEAR.pivot] * wound - slope * turned
            turned = wound
        if part.spin is not None:
            column = _gyroscopic_column(lane, part, model, S, i)
            for j in range(len(column)):
                y[row - len(column) + j] += column[j] * turned


register(
    Gears, prepare, assemble, fix_coordinate, before_factor, before_solve, after_solve, inertia_forces,
    input_displacements, damping_power, energy, set_joint_configuration, vjp_residual, multiply,
)  # fmt: skip
