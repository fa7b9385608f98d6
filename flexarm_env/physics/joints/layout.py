"""Layouts of a `Jointed` model's arrays and of the records that its joints add to the matrix array S; joint laws."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...compiler import Lanes, kernel, size
from ...layout import Field, Layout

PLACE = Layout(
    "Place", "",
    Field("joint", (), "", "number k of the joint, also of its torque in the inputs u"),
    Field("row", (), "", "row of the joint's angle q (rad)"),
    Field("motor", (), "", "row of the motor's angle psi behind an elastic gear; -1: the gear is rigid"),
    Field("friction", (), "", "row of the angle on which friction acts: `row` or `motor`"),
    Field("known", (), "", "1: a motion prescribes the angle in row `friction`; 0: the angle is unknown"),
).places  # fmt: skip
# entries per joint of `Jointed.table`, which is flat
PLACES = PLACE.end

LAW = Layout(
    "Law", "",
    Field("stiffness", (), "N m/rad", "k of the gear, 0 if it is rigid"),
    Field("damping", (), "N m s/rad", "d of the gear"),
    Field("rotor", (), "kg m^2", "rotor's inertia after the ratio, J r^2"),
    Field("viscous", (), "N m s/rad", "coefficient of viscous friction"),
    Field("coulomb", (), "N m", "Coulomb friction torque T_C"),
    Field("play", (), "rad", "half of the gear's backlash"),
    Field("hub", (), "kg m^2", "additional inertia at the joint, where each arm of a batch has its own"),
)  # fmt: skip
LAWS = LAW.places

GEAR = Layout(
    "Gear", "",
    Field("pinned", (), "", "1: the motor's angle is fixed or prescribed"),
    Field("held", (), "", "1: the joint's angle is fixed or prescribed"),
    Field("pivot", (), "", "diagonal entry of the motor's row; after `factor` its inverse, 0 if fixed"),
    Field("slope", (), "", "derivative of the gear's torque, k c_k + d c_v; c_k, c_v: weights of dr/dq, dr/dv"),
    Field("own", (), "", "entry of rotor and friction at the joint, added to its diagonal"),
    Field("sway", (), "N m s", "in space: J r c_v, factor of `ROTOR.column` in the column of q or psi"),
    Field("gap", (), "", "increment that brings the joint to rest, minus the frictionless increment; see `friction`"),
    Field("bound", (), "N m", "Coulomb friction torque if the joint slides"),
    Field("sticks", (), "", "1: friction holds the joint at rest"),
    Field("torque", (), "N m", "Coulomb friction torque T in the present solve"),
    Field("before", (), "N m", "Coulomb friction torque at the step's start, or before inputs jump"),
    Field("slides", (), "", "1: the joint slides at the time of `before`; for derivatives its direction, +1 or -1"),
    Field("free", (), "", "1: the joint did not slide then, and `before` balances the other forces"),
).places  # fmt: skip
"""`GEAR`: one record per joint, stored in S after the arm's own entries. In models with friction, two arrays follow: a
column of S^-1 (n numbers) for each joint, and a row of the linear system for the torques (`count` + 1 numbers) for each
joint."""


class Law(NamedTuple):
    """Constants of one joint's law (`LAW`): numbers common to all arms, or lanes with each arm's numbers."""

    stiffness: Any  # N m/rad: stiffness of the gear
    damping: Any  # N m s/rad: damping of the gear
    rotor: Any  # kg m^2: rotor inertia times the square of the gear ratio
    viscous: Any  # N m s/rad: coefficient of viscous friction
    coulomb: Any  # N m: Coulomb friction torque T_C
    play: Any  # rad: half of the backlash


@kernel
def _number(lane, model, par: Lanes, k):
    """Return number k of the joint laws: model.data[k], or the arm's own number in `par` if `model.own` is not None."""
    if model.own is None:
        return model.data[k]
    return par[size(model.own) + k]


@kernel
def joint_law(lane, model, par, i):
    """Return the `Law` of joint i of the table, in SI units (see `LAW`)."""
    o = LAWS.end * i
    return Law(
        _number(lane, model, par, o + LAWS.stiffness),
        _number(lane, model, par, o + LAWS.damping),
        _number(lane, model, par, o + LAWS.rotor),
        _number(lane, model, par, o + LAWS.viscous),
        _number(lane, model, par, o + LAWS.coulomb),
        _number(lane, model, par, o + LAWS.play),
    )


@kernel
def hub_of(lane, model, par):
    """Return the additional inertia at joint 0, kg m^2, of a model with `hub`. par: the arm's own parameters."""
    return _number(lane, model, par, LAWS.hub)
