"""Where things are in a `Jointed` model's arrays and in its part of S."""

from __future__ import annotations

from ...layout import Field, Layout

PLACE = Layout(
    "Place", "",
    Field("joint", (), "", "its number, and that of its torque among the inputs"),
    Field("row", (), "", "of the joint's angle"),
    Field("motor", (), "", "row of the motor's angle; -1: the gear does not give"),
    Field("friction", (), "", "row of the angle that friction acts on: one of these two"),
    Field("known", (), "", "1: that angle is prescribed"),
).places  # fmt: skip
PLACES = PLACE.end

LAW = Layout(
    "Law", "",
    Field("stiffness", (), "N m/rad", "of the gear"),
    Field("damping", (), "N m s/rad", "of the gear"),
    Field("rotor", (), "kg m^2", "the rotor's inertia after the ratio"),
    Field("viscous", (), "N m s/rad", "friction"),
    Field("coulomb", (), "N m", "friction"),
    Field("play", (), "rad", "half of the gear's backlash"),
    Field("hub", (), "kg m^2", "behind the gear beside what the arm has, where that is each arm's own"),
)  # fmt: skip
LAWS = LAW.places

GEAR = Layout(
    "Gear", "",
    Field("pinned", (), "", "1: the motor's angle does not move"),
    Field("held", (), "", "1: nor does the joint's"),
    Field("pivot", (), "", "of the motor's row; factored: its inverse, 0 where it is pinned"),
    Field("slope", (), "", "of the gear's torque"),
    Field("own", (), "", "what is added to the joint's row in its own column"),
    Field("sway", (), "N m s", "share of `protocol.sway` in the column of what turns the rotor, in space"),
    Field("gap", (), "", "of the unknown that is solved for, what would leave the joint at rest without friction"),
    Field("bound", (), "N m", "Coulomb friction where it slides"),
    Field("sticks", (), "", "1: friction holds the joint"),
    Field("torque", (), "N m", "Coulomb friction"),
    Field("before", (), "N m", "Coulomb friction at the step's start, or before inputs jump"),
    Field("slides", (), "", "1: it slides there; at a step's end, for derivatives, 1 or -1: and which way"),
    Field("free", (), "", "1: `before` is what the other forces there leave over"),
).places  # fmt: skip
"""One a joint, behind the arm's own part of S; with friction, a column of S^-1 and `count` + 1 places each follow."""
