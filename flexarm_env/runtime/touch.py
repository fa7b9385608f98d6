"""Contact in a control period: info of all points that may touch, and the forces that sensors at the tip read."""

from __future__ import annotations

from ..compiler import Lanes, kernel, maximum, select_lt, size
from ..layout import Field, Layout
from ..physics.contact.integration import reading_at, record_contacts, reset_impulses
from ..physics.contact.layout import READ
from ..physics.integrator.work import Work
from ..tasks.task import info_of, put_info

CONTACT = Layout(
    "ContactInfo", "",
    Field("force", (), "N", "sum of the normal forces on all points, at the period's end"),
    Field("friction", (), "N", "sum of the magnitudes of their friction forces"),
    Field("penetration", (), "m", "largest penetration of a point, or 0"),
    Field("sliding", (), "m/s", "sliding speed of the point that is pushed most; 0 without contact"),
    Field("impulse", (), "N s", "sum of the time integrals of the normal forces over the period"),
).places  # fmt: skip
"""Last numbers of info where an arm may touch obstacles."""


@kernel
def open_contacts(lane, model, w: Work):
    """Set the impulses of all points to 0 at the start of a control period; no-op without contact."""
    reset_impulses(lane, model, w.S)


@kernel
def start_contacts(lane, p, par, live, info, w: Work):
    """Store the readings of all points at the start of an episode, and write them into info where live > 1/2.

    # in        w.q, w.v;  par, the arms' own parameters
    # out       w.S, readings;  info.further, its last numbers (`CONTACT`). No-op without contact.
    """
    if p.model.newton.contact is not None:
        reset_impulses(lane, p.model, w.S)
        record_contacts(lane, p.model, par, w.q, w.v, w.S, 0.0)
        put_contacts(lane, p, w, live, info)


@kernel
def put_contacts(lane, p, w: Work, live, info):
    """Write force, friction (N), penetration (m), sliding speed (m/s) and impulse (N s) into info where live > 1/2.

    # in        w.S, readings of the points at the end of the last step
    # out       info.further, its last numbers (`CONTACT`). No-op without contact.
    """
    if p.model.newton.contact is not None:
        S: Lanes = w.S
        force, friction, depth, sliding, impulse, most = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(len(p.model.newton.contact.points)):
            at = reading_at(p.model, k)
            normal = S[at + READ.normal]
            force, friction = force + normal, friction + S[at + READ.tangential]
            depth = maximum(S[at + READ.penetration], depth)
            # readings of points that do not touch depend on other lanes: they are left out
            sliding = select_lt(most, normal, S[at + READ.sliding], sliding)
            most = maximum(normal, most)
            impulse = impulse + S[at + READ.impulse]
        first = info_of(p.task).further + size(p.task.further) - CONTACT.end
        put_info(lane, live, info, first + CONTACT.force, force)
        put_info(lane, live, info, first + CONTACT.friction, friction)
        put_info(lane, live, info, first + CONTACT.penetration, depth)
        put_info(lane, live, info, first + CONTACT.sliding, sliding)
        put_info(lane, live, info, first + CONTACT.impulse, impulse)
