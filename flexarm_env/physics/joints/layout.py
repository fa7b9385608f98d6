"""Where things are in a `Jointed` model's arrays and in its part of S."""

from __future__ import annotations

from ...layout import Field, Layout

PLACE = Layout(
    "Place", "",
    Field("joint", (), "", "its number, and that of its torque among the inputs"),
    Field("row", (), "", "of the joint's angle"),
    Field("motor", (), "", "row of the motor's angle; -1: the gear does not give"),
    Field("on_motor", (), "", "1: friction acts on the motor's angle; 0: on the joint's"),
    Field("known", (), "", "1: the angle that friction acts on is prescribed"),
).places  # fmt: skip
PLACES = PLACE.end

LAW = Layout(
    "Law", "",
    Field("stiffness", (), "N m/rad", "of the gear"),
    Field("damping", (), "N m s/rad", "of the gear"),
    Field("rotor", (), "kg m^2", "the rotor's inertia after the ratio"),
    Field("viscous", (), "N m s/rad", "friction"),
    Field("coulomb", (), "N m", "friction"),
    Field("near", (), "kg m^2", "inertia that friction meets at once: at the joint, with the rotor of a stiff gear"),
    Field("least", (), "kg m^2", "an inertia that whatever friction holds has at least"),
    Field("hold", (), "", "inertia of the whole arm over that, many times: what a joint at rest is held by"),
    Field("play", (), "rad", "half of the gear's backlash"),
)  # fmt: skip
LAWS = LAW.places

GEAR = Layout(
    "Gear", "",
    Field("pinned", (), "", "1: the motor's angle does not move"),
    Field("held", (), "", "1: nor does the joint's"),
    Field("pivot", (), "", "of the motor's row; factored: its inverse, 0 where it is pinned"),
    Field("slope", (), "", "of the gear's torque"),
    Field("back", (), "", "the same in the motor's row: 0 where friction holds it"),
    Field("own", (), "", "what is added to the joint's row in its own column"),
    Field("ahead", (), "s", "how far ahead the rate is looked at that friction opposes"),
    Field("share", (), "N m s/rad", "torque that such a rate stands for in the choice between sticking and slipping"),
    Field("torque", (), "N m", "Coulomb friction of the last residual"),
    Field("before", (), "N m", "and at the step's start"),
    Field("way", (), "", "of the last residual: 0: it sticks; 1, -1: it slips forward, backward"),
    Field("wound", (), "rad", "the motor's angle less the joint's in the last residual, where there is backlash"),
    Field("flank", (), "", "then: 0: neither side touches; 1, -1: the motor's drives forward, backward"),
).places  # fmt: skip
"""One a joint, behind `GEARS`."""

GEARS = Layout(
    "Gears", "",
    Field("loose", (), "", "`LOOSE`: Coulomb friction is left out; `BEFORE`: the residual before inputs jump"),
    Field("turned", (), "", "more than 0: a joint has begun or ceased to stick or to touch since the residual before"),
).places  # fmt: skip
"""Behind the arm's own part of S."""
LOOSE, BEFORE = 1.0, 2.0
