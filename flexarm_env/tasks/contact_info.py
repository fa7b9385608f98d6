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

CONTACT_POINT = Layout(
    "ContactPointInfo", "points",
    Field("force", ("points",), "N", "normal force on each contact point at the end of the control period"),
    Field("friction", ("points",), "N", "magnitude of the friction force on each point"),
    Field("penetration", ("points",), "m", "depth of each point in an obstacle, or 0"),
    Field("sliding", ("points",), "m/s", "sliding speed of each point; 0 without contact"),
    Field("impulse", ("points",), "N s", "time integral of each point's normal force over the control period"),
)  # fmt: skip
"""Entries of info before `CONTACT` if more than one point may touch. points: their number, from root to tip."""


def contact_length(points: int) -> int:
    """Return the number of entries of info for `points` contact points; 0 without contact points."""
    own = int(CONTACT_POINT.offsets(0, points).end) if points > 1 else 0
    return own + CONTACT.end if points else 0
