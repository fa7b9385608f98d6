"""Layouts of a `Jointed` model's arrays and of the records that its joints add to the matrix array S."""

from __future__ import annotations

from ...layout import Field, Layout

PLACE = Layout(
    "Place", "",
    Field("joint", (), "", "number k of the joint, also of its torque in the inputs u"),
    Field("row", (), "", "row of the joint's angle q (rad)"),
    Field("motor", (), "", "row of the motor's angle psi behind an elastic gear; -1: the gear is rigid"),
    Field("friction", (), "", "row of the angle that friction acts on: `row` or `motor`"),
    Field("known", (), "", "1: a motion prescribes that angle; 0: unknown"),
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
    Field("pivot", (), "", "diagonal entry of the motor's row; after `factor` its inverse, 0 if it is fixed"),
    Field("slope", (), "", "derivative of the gear's torque, k c_k + d c_v with the matrix weights"),
    Field("own", (), "", "diagonal entry added to the joint's row, of rotor and friction at the joint"),
    Field("sway", (), "N m s", "in space: J r c_v, factor of `ROTOR.column` in the column of q or psi"),
    Field("gap", (), "", "increment that brings the joint to rest less the frictionless one; see `friction`"),
    Field("bound", (), "N m", "Coulomb friction torque if the joint slides"),
    Field("sticks", (), "", "1: friction holds the joint at rest"),
    Field("torque", (), "N m", "Coulomb friction torque T in the present solve"),
    Field("before", (), "N m", "Coulomb friction at the step's start, or before inputs jump"),
    Field("slides", (), "", "1: the joint slides at that instant; for derivatives its direction, +1 or -1"),
    Field("free", (), "", "1: `before` balances the other forces of its row at that instant (not sliding)"),
).places  # fmt: skip
"""`GEAR`: one record per joint, stored in S after the arm's own entries. With friction, a column of S^-1 per joint (n
numbers) and a row of the torques' linear system per joint (`count` + 1 numbers) follow."""
