"""The tasks `Press` and `PressChain`: the tip slides along a wall and presses on it with a commanded normal force."""

from ..compiler import Lanes, absolute, kernel, maximum, select_lt, sincos, size, square_root
from ..physics.arithmetic import decay, minimum, store_where
from ..physics.layout import POSE
from .contact_info import CONTACT
from .program import PATH, PATH_AT, PERIODS, PERIODS_ALLOWED, SUCCESS, TARGET
from .reach import Chain, Reach, reach_draw_line, reach_observe
from .task import (
    TASKS,
    effort,
    info_of,
    left_of,
    past_limits,
    put_info,
    record_deflections,
    record_tip,
    reward_change,
    reward_term,
    settled,
    show_scaled,
)

_PATH = PATH.places
FORCE, BEARING = PATH_AT + _PATH.z, PATH_AT + _PATH.bearing
"""Indices in an arm's record of the commanded normal force (N) and of the bearing (rad) of the wall's point nearest to
the root."""
SQUARES, FARTHEST = PATH_AT + _PATH.vz, PATH_AT + _PATH.tilt
"""Indices in an arm's record of the sum of squares of the relative force errors, and of the largest distance (m) from
the target, in the evaluated periods."""

WIDE_PATH, WIDE_FORCE = 0.01, 0.25
"""Widths of the reward terms `accuracy` (m) and `force` (divided by the commanded force)."""


class Press(Reach):
    """Record of task "press" for two links; the options page of the environments describes observation and reward."""

    __slots__ = ()


class PressChain(Chain):
    """Record of task "press" for any number of links."""

    __slots__ = ()


@kernel
def press_observe(lane, task, poses: Lanes, record: Lanes, out):
    """Write the scaled observation of `Reach`, then the commanded normal force divided by its scale."""
    reach_observe(lane, task, poses, record, out)
    show_scaled(lane, task, out, size(task.entries) - 1, record[FORCE])


@kernel
def press_judge(lane, task, poses: Lanes, action, record: Lanes, live, info: Lanes):
    """Write success, info and the reward terms of a tip that slides along a wall under a commanded normal force.

    e: distance (m) of tip and target along the wall; f = (F_n - F_c) / F_c with the normal force F_n at the period's
    end and the commanded one F_c; d: distance of tip and target divided by the arm's length; a, b (task.bands): success
    bands of f and e (m).

        accuracy exp(-(e / 10 mm)^2), settle 1 / (1 + ((e / b)^2 + (f / a)^2)^2), distance by min(d, 1) (`left_of`),
        effort -sum action^2, vibration -min(sum of squares of deflection rates, 1), force exp(-(f / 0.25)^2)

    Success: in all periods of the last two thirds of the episode up to now, the root mean square of f is at most a and
    e is at most b. No period of the first third counts as a success. poses: poses of the links, inertial axes; info is
    written in lanes with live > 1/2. Returns (reward, 1.0 where a joint is beyond its limits).
    """
    shaking = record_deflections(lane, task, poses, live, info)
    e, d = target_distances(lane, task, poses, record)
    # relative error of the normal force
    commanded, force = maximum(record[FORCE], 1e-300), record[FORCE] * 0.0
    if size(task.further) > 0:
        at = info_of(task).further + size(task.further) - CONTACT.end
        force = info[at + CONTACT.force]
        put_info(lane, live, info, at + CONTACT.target, record[FORCE])
    f = (force - commanded) / commanded
    record_tip(lane, task, poses, record, live, info)
    _record_press(lane, task, e, f, record, live, info)
    wide, off = e / WIDE_PATH, f / WIDE_FORCE
    near, close = e / task.bands[1], f / task.bands[0]
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settled(lane, near * near + close * close))
    total = total + reward_term(lane, task, live, info, 2, left_of(task, minimum(d, 1.0)))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -minimum(shaking, 1.0))
    total = total + reward_term(lane, task, live, info, 5, decay(off * off))
    return reward_change(lane, task, action, record, live, info, total), past_limits(lane, task, poses)


@kernel
def target_distances(lane, task, poses: Lanes, record: Lanes):
    """Return (e, d): distance of tip and target along the wall, m, and in the plane, divided by the arm's length."""
    o = POSE.end * (size(task.links) - 1)
    # target less tip, m, inertial axes
    dx = record[TARGET] - poses[o + POSE.tip_x]
    dy = record[TARGET + 1] - poses[o + POSE.tip_y]
    # BEARING: angle of the wall's normal
    sine, cosine = sincos(record[BEARING])
    return absolute(cosine * dy - sine * dx), square_root(dx * dx + dy * dy) / task.length


@kernel
def _record_press(lane, task, e, f, record: Lanes, live, info):
    """Add the errors e (m) and f of a period to the record, and write success (1 or 0) into info, where live > 1/2."""
    # periods done at the end of this one, and those of the first third, which do not count
    done, idle = record[PERIODS] + 1.0, record[PERIODS_ALLOWED] / 3.0
    counts = select_lt(idle, done, 1.0, 0.0)
    squares = record[SQUARES] + counts * minimum(f * f, 1e6)
    farthest = maximum(record[FARTHEST], counts * e)
    store_where(lane, live, record, SQUARES, squares, record[SQUARES])
    store_where(lane, live, record, FARTHEST, farthest, record[FARTHEST])
    a = task.bands[0]
    good = select_lt(squares, (done - idle) * (a * a), counts, 0.0)
    good = select_lt(farthest, task.bands[1], good, 0.0)
    put_info(lane, live, info, SUCCESS, good)


@kernel
def press_draw_line(task, stream, arm, start, drawn, path):
    """Write a straight path along the wall, a `PATH`, with the commanded normal force and the wall's bearing.

    drawn (5,): distance of the wall from the root, m; time at which the target reaches the wall's nearest point, s;
    speed, m/s; bearing of the nearest point, rad; normal force, N.
    """
    reach_draw_line(task, stream, arm, start, drawn, path)
    path[_PATH.z], path[_PATH.bearing] = drawn[4], drawn[3]


_PRESSED = {"observe": press_observe, "judge": press_judge, "draw_line": press_draw_line}
TASKS.register(Press, **{**TASKS.members[Reach], **_PRESSED})
TASKS.register(PressChain, **{**TASKS.members[Chain], **_PRESSED})
