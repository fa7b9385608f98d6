"""Entries of info for an arm that can touch obstacles; they follow all other entries of info."""

from ..layout import Field, Layout

CONTACT = Layout(
    "ContactInfo", "",
    Field("force", (), "N", "sum of the normal forces on all contact points at the end of the control period"),
    Field("friction", (), "N", "sum of the magnitudes of the friction forces on all contact points"),
    Field("penetration", (), "m", "largest depth of a contact point in an obstacle, or 0"),
    Field("sliding", (), "m/s", "sliding speed of the contact point with the largest normal force; 0 without contact"),
    Field("impulse", (), "N s", "sum of the time integrals of the normal forces over the control period"),
    Field("target", (), "N", "normal force that the task `Press` commands, otherwise 0"),
).places  # fmt: skip
"""Last entries of info if an arm may touch obstacles."""
