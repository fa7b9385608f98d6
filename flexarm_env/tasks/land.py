"""The tasks `Land` and `LandChain`: touch a wall at a point with the tip, with little impulse, and stay there."""

import math

from ..compiler import Lanes, kernel, maximum, select_lt, size, square_root
from ..physics.arithmetic import decay, minimum, store_where
from ..physics.layout import POSE
from .contact_info import CONTACT
from .press import FARTHEST, WIDE_PATH, target_distances
from .program import PATH, TARGET
from .reach import Chain, Reach
from .stream import uniform
from .task import (
    TASKS,
    effort,
    info_of,
    left_of,
    past_limits,
    record_deflections,
    record_success,
    record_tip,
    reward_change,
    reward_term,
    settled,
)

_PATH = PATH.places
HARDEST = FARTHEST
"""Index in an arm's record of the largest impulse of the contact force in any control period so far, N s."""


class Land(Reach):
    """Constants of the task "land" for two links; the environments' options page describes the task."""

    __slots__ = ()


class LandChain(Chain):
    """Constants of the task "land" for any number of links."""

    __slots__ = ()


@kernel
def land_judge(lane, task, poses: Lanes, action, record: Lanes, live, info: Lanes):
    """Write success, info and the reward terms of a tip that touches a wall with little impulse and stays.

    e: distance (m) of tip and target along the wall; v: speed (m/s) of the tip; F (N) and I (N s): normal force at the
    period's end, and its time integral over the period; d: distance of tip and target divided by the arm's length; a,
    b, c (task.bands): success bands of e, v and I.

        accuracy exp(-(e / 10 mm)^2), settle 1 / (1 + ((e / a)^2 + (v / b)^2)^2) if F > 0, otherwise 0,
        distance by min(d, 1) (`left_of`), effort -sum action^2,
        vibration -min(sum of squares of deflection rates, 1), impulse -min(I / c, 1)

    Success: F > 0, e < a and v < b in the last periods (`record_success`), and I < c in all periods up to now. poses:
    positions, angles and rates of the links, inertial axes; info is written for running arms (live > 1/2). Returns the
    reward, and 1.0 if a joint is beyond its limits, otherwise 0.0.
    """
    shaking = record_deflections(lane, task, poses, live, info)
    e, d = target_distances(lane, task, poses, record)
    o = POSE.end * (size(task.links) - 1)
    vx, vy = poses[o + POSE.tip_vx], poses[o + POSE.tip_vy]
    v = square_root(vx * vx + vy * vy)
    # force: F (N); impulse: I (N s); hardest: largest I of the episode up to now
    force, impulse = record[TARGET] * 0.0, record[TARGET] * 0.0
    if size(task.further) > 0:
        at = info_of(task).further + size(task.further) - CONTACT.end
        force, impulse = info[at + CONTACT.force], info[at + CONTACT.impulse]
    hardest = maximum(record[HARDEST], impulse)
    store_where(lane, live, record, HARDEST, hardest, record[HARDEST])
    good = select_lt(e, task.bands[0], 1.0, 0.0)
    good = select_lt(v, task.bands[1], good, 0.0)
    good = select_lt(hardest, task.bands[2], good, 0.0)
    touching = select_lt(0.0, force, 1.0, 0.0)
    record_success(lane, task, good * touching, record, live, info)
    record_tip(lane, task, poses, record, live, info)
    wide, near, slow = e / WIDE_PATH, e / task.bands[0], v / task.bands[1]
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, touching * settled(lane, near * near + slow * slow))
    total = total + reward_term(lane, task, live, info, 2, left_of(task, minimum(d, 1.0)))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -minimum(shaking, 1.0))
    total = total + reward_term(lane, task, live, info, 5, -minimum(impulse / task.bands[2], 1.0))
    return reward_change(lane, task, action, record, live, info, total), past_limits(lane, task, poses)


@kernel
def land_draw_line(task, stream, arm, start, drawn, path):
    """Write the `PATH` of a target at rest on the wall, on a random side of the wall's point nearest to the root.

    drawn (4,): distance of the nearest point from the root, m; distance of the target from the nearest point, m; an
    unused number; bearing of the nearest point, rad. stream[arm]: random numbers of the arm. start: unused argument.
    """
    side = 1.0 if uniform(stream, arm) < 0.5 else -1.0
    cosine, sine = math.cos(drawn[3]), math.sin(drawn[3])
    path[_PATH.x] = drawn[0] * cosine - side * drawn[1] * sine
    path[_PATH.y] = drawn[0] * sine + side * drawn[1] * cosine
    path[_PATH.bearing] = drawn[3]


_LANDED = {"judge": land_judge, "draw_line": land_draw_line}
TASKS.register(Land, **{**TASKS.members[Reach], **_LANDED})
TASKS.register(LandChain, **{**TASKS.members[Chain], **_LANDED})
