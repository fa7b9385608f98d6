"""Entries of info for an arm with contacts, which follow all other entries."""

from ..layout import Field, Layout

CONTACT = Layout(
    "ContactInfo", "",
    Field("force", (), "N", "sum of the normal forces on all points, at the period's end"),
    Field("friction", (), "N", "sum of the magnitudes of their friction forces"),
    Field("penetration", (), "m", "largest penetration of a point, or 0"),
    Field("sliding", (), "m/s", "sliding speed of the point that is pushed most; 0 without contact"),
    Field("impulse", (), "N s", "sum of the time integrals of the normal forces over the period"),
    Field("target", (), "N", "commanded normal force of the task `Press`, otherwise 0"),
).places  # fmt: skip
"""Last entries of info if an arm may touch obstacles."""
