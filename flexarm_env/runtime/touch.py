"""Contact in a control period: forces of all contact points in `info`, and forces for sensors at the tip."""

from __future__ import annotations

from ..compiler import Lanes, kernel, maximum, select_lt, size, store
from ..physics import contributions
from ..physics.contact.integration import reading_at, record_contacts, reset_impulses
from ..physics.contact.layout import READ
from ..physics.contact.moving import start_obstacles
from ..physics.integrator.work import Work
from ..tasks.contact_info import CONTACT, CONTACT_POINT
from ..tasks.program import channel_at
from ..tasks.task import info_of, put_info
from .laws import LAW_SIZE, channel_of

_points = kernel(CONTACT_POINT.offsets)


@kernel
def open_contacts(lane, model, par, w: Work):
    """Set the impulses of all contact points to 0 at the start of a period; no-op without possible contacts.

    Of moving obstacles the forces at the start of the period are stored, from which their work is computed.
    """
    if model.newton.contact is not None:
        if model.newton.contact.paths is not None:
            record_contacts(lane, model, par, w.q, w.v, w.S, 0.0)
    reset_impulses(lane, model, w.S)


@kernel
def is_free(lane, p, par, w, i):
    """Return whether no contact point of the arm in lane i is inside an obstacle at w.q (m, rad), at t = 0.

    # in        par, the arms' own parameters.   # out   w.q, rows of moving obstacles.   # scratch   w.r
    """
    far = 1e300
    start_obstacles(lane, p.model, w, i)
    for part in p.model.contributions:
        far = contributions.nearest(lane, part, p.model, par, w.q, far)
    store(w.r, 0, far)
    return w.r[i] >= 0.0


@kernel
def start_contacts(lane, p, par, w: Work):
    """Store the forces of all contact points in w.S at the start of an episode; no-op without possible contacts.

    # in        w.q, w.v;  par, the arms' own parameters
    """
    if p.model.newton.contact is not None:
        reset_impulses(lane, p.model, w.S)
        record_contacts(lane, p.model, par, w.q, w.v, w.S, 0.0)


@kernel
def put_contacts(lane, p, w: Work, live, info):
    """Write contact force, friction (N), penetration (m), sliding speed (m/s), impulse (N s) into info of running arms.

    # in        w.S, forces of the contact points at the end of the last step
    # out       info.further, the last numbers (`CONTACT`), if the arm may touch obstacles
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
        if len(p.model.newton.contact.points) > 1:
            _put_points(lane, p, S, live, info, first)
        put_info(lane, live, info, first + CONTACT.force, force)
        put_info(lane, live, info, first + CONTACT.friction, friction)
        put_info(lane, live, info, first + CONTACT.penetration, depth)
        put_info(lane, live, info, first + CONTACT.sliding, sliding)
        put_info(lane, live, info, first + CONTACT.impulse, impulse)


@kernel
def _put_points(lane, p, S: Lanes, live, info, end):
    """Write the readings of each contact point into the entries of info that end before `end` (`CONTACT_POINT`)."""
    count = len(p.model.newton.contact.points)
    at = _points(end - _points(0, count).end, count)
    for k in range(count):
        here = reading_at(p.model, k)
        normal = S[here + READ.normal]
        put_info(lane, live, info, at.force + k, normal)
        put_info(lane, live, info, at.friction + k, S[here + READ.tangential])
        put_info(lane, live, info, at.penetration + k, maximum(S[here + READ.penetration], 0.0))
        # readings of points that do not touch depend on other lanes
        put_info(lane, live, info, at.sliding + k, select_lt(0.0, normal, S[here + READ.sliding], 0.0))
        put_info(lane, live, info, at.impulse + k, S[here + READ.impulse])


@kernel
def contact_entries(contact):
    """Return the number of entries of info for contacts. contact: `Watch` of the model."""
    count = len(contact.points)
    if count > 1:
        return CONTACT.end + _points(0, count).end
    return CONTACT.end


@kernel
def contact_channels(instruments):
    """Return the number of channels of the contact sensors: 2 for a force sensor plus 1 for a contact switch."""
    count = 0
    if instruments.force is not None:
        count = count + 2
    if instruments.switch is not None:
        count = count + 1
    return count


@kernel
def record_contact_forces(lane, instruments, model, record: Lanes, w: Work):
    """Store the true force (N, divided by its scale) and the contact switch's state (1 or 0) in the record's channels.

    The force sensor measures the normal force and the magnitude of the friction force on the tip at the end of the last
    step, which w.S contains. The values are 0 if the tip cannot touch an obstacle.
    """
    if model.newton.contact is not None:
        if instruments is not None:
            S: Lanes = w.S
            count = instruments.laws.shape[0] // LAW_SIZE
            base = record.shape[0] - count * channel_at(0, instruments.room).end
            at, touches = reading_at(model, max(instruments.tip, 0)), float(instruments.tip)
            normal = select_lt(touches, 0.0, 0.0, S[at + READ.normal])
            tangential = select_lt(touches, 0.0, 0.0, S[at + READ.tangential])
            # the last channels but those of gauges
            c = count - contact_channels(instruments)
            if instruments.gauges is not None:
                c = c - size(instruments.gauges)
            if instruments.force is not None:
                record[channel_of(base, instruments.room, c).motor] = normal / instruments.force
                record[channel_of(base, instruments.room, c + 1).motor] = tangential / instruments.force
                c = c + 2
            if instruments.switch is not None:
                record[channel_of(base, instruments.room, c).motor] = select_lt(instruments.switch, normal, 1.0, 0.0)
