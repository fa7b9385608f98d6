"""The tasks `Press`, `PressChain` and `SpacePress`: slide along a wall with the tip under a commanded normal force."""

from ..compiler import Lanes, absolute, kernel, maximum, select_lt, sincos, size, square_root
from ..physics.arithmetic import decay, minimum, store_where
from ..physics.layout import POSE
from .contact_info import CONTACT
from .program import MOVING, PATH, PATH_AT, PERIODS, PERIODS_ALLOWED, SUCCESS, TARGET
from .reach import Chain, Reach, reach_draw_line, reach_observe
from .space import SpaceReach, directions, record_pose, space_draw_line, space_observe, to_target
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

_PATH, _MOVING = PATH.places, MOVING.places
FORCE, BEARING, ELEVATION = PATH_AT + _PATH.size, PATH_AT + _PATH.bearing, PATH_AT + _PATH.tilt
"""Indices in an arm's record of the commanded normal force (N) and of the direction from the root to the wall's nearest
point: bearing and, in space, elevation above the x-y plane (rad)."""
SQUARES, FARTHEST = PATH_AT + _PATH.rate, PATH_AT + _PATH.phase
"""Indices in an arm's record of the sum of squares of the relative force errors, and of the largest distance (m) from
the target, in the evaluated periods."""

WIDE_PATH, WIDE_FORCE = 0.01, 0.25
"""Widths of the reward terms `accuracy` (m) and `force` (divided by the commanded force)."""


class Press(Reach):
    """Constants of the task "press" for two links; the environments' options page describes the task."""

    __slots__ = ()


class PressChain(Chain):
    """Constants of the task "press" for any number of links."""

    __slots__ = ()


class SpacePress(SpaceReach):
    """Constants of the task "press" in space."""

    __slots__ = ()


@kernel
def press_observe(lane, task, poses: Lanes, record: Lanes, out):
    """Write the scaled observation of `Reach`, then the commanded normal force divided by its scale."""
    reach_observe(lane, task, poses, record, out)
    show_scaled(lane, task, out, size(task.entries) - 1, record[FORCE])


@kernel
def space_press_observe(lane, task, poses: Lanes, record: Lanes, out):
    """Write the scaled observation of `SpaceReach`, then the commanded normal force divided by its scale."""
    space_observe(lane, task, poses, record, out)
    show_scaled(lane, task, out, size(task.entries) - 1, record[FORCE])


@kernel
def press_judge(lane, task, poses: Lanes, action, record: Lanes, live, info: Lanes):
    """Write success, info and the reward terms of `reward_press` for an arm in the plane.

    poses: positions, angles and rates of the links, inertial axes. Returns the reward, and 1.0 if a joint is beyond its
    limits, otherwise 0.0.
    """
    shaking = record_deflections(lane, task, poses, live, info)
    e, d = target_distances(lane, task, poses, record)
    record_tip(lane, task, poses, record, live, info)
    return reward_press(lane, task, e, d, shaking, action, record, live, info), past_limits(lane, task, poses)


@kernel
def space_press_judge(lane, task, poses: Lanes, action, record: Lanes, live, info: Lanes):
    """Write success, info and the reward terms of `reward_press` for an arm in space; see `press_judge`."""
    shaking, past = record_pose(lane, task, poses, record, live, info)
    dx, dy, dz = to_target(lane, task, poses, record)
    # n: from the root to the wall's nearest point; components of tip to target across n
    sine, cosine = sincos(record[BEARING])
    up, flat = sincos(record[ELEVATION])
    nx, ny = cosine * flat, sine * flat
    depth = (dx * nx + dy * ny) + dz * up
    ex, ey, ez = dx - depth * nx, dy - depth * ny, dz - depth * up
    e = square_root((ex * ex + ey * ey) + ez * ez)
    d = square_root((dx * dx + dy * dy) + dz * dz) / task.length
    return reward_press(lane, task, e, d, shaking, action, record, live, info), past


@kernel
def reward_press(lane, task, e, d, shaking, action, record: Lanes, live, info: Lanes):
    """Return the reward of a tip that slides along a wall under a commanded normal force, and record success.

    e: distance (m) of tip and target along the wall; f = (F_n - F_c) / F_c with the normal force F_n at the period's
    end and the commanded normal force F_c; d: distance of tip and target divided by the arm's length; a, b
    (task.bands): success bands of f and e (m); shaking: sum of squares of deflection rates divided by the links'
    lengths, 1/s^2.

        accuracy exp(-(e / 10 mm)^2), settle 1 / (1 + ((e / b)^2 + (f / a)^2)^2), distance by min(d, 1) (`left_of`),
        effort -sum action^2, vibration -min(shaking, 1), force exp(-(f / 0.25)^2)

    Success: in all periods of the last two thirds of the episode up to now, the root mean square of f is at most a and
    e is at most b. No period of the first third counts as a success. info is written for running arms (live > 1/2).
    """
    # relative error of the normal force
    commanded, force = maximum(record[FORCE], 1e-300), record[FORCE] * 0.0
    if size(task.further) > 0:
        at = info_of(task).further + size(task.further) - CONTACT.end
        force = info[at + CONTACT.force]
        put_info(lane, live, info, at + CONTACT.target, record[FORCE])
    f = (force - commanded) / commanded
    _record_press(lane, task, e, f, record, live, info)
    wide, off = e / WIDE_PATH, f / WIDE_FORCE
    near, close = e / task.bands[1], f / task.bands[0]
    total = reward_term(lane, task, live, info, 0, decay(wide * wide))
    total = total + reward_term(lane, task, live, info, 1, settled(lane, near * near + close * close))
    total = total + reward_term(lane, task, live, info, 2, left_of(task, minimum(d, 1.0)))
    total = total + reward_term(lane, task, live, info, 3, -effort(lane, task, action))
    total = total + reward_term(lane, task, live, info, 4, -minimum(shaking, 1.0))
    total = total + reward_term(lane, task, live, info, 5, decay(off * off))
    return reward_change(lane, task, action, record, live, info, total)


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
    """Add the errors e (m) and f of a period to the record; write success (1 or 0) into info of running arms."""
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
    """Write the `PATH` of a straight path along the wall, with commanded normal force and the wall's bearing.

    drawn (5,): distance of the wall from the root, m; time at which the target reaches the wall's nearest point, s;
    speed, m/s; bearing of the nearest point, rad; normal force, N.
    """
    reach_draw_line(task, stream, arm, start, drawn, path)
    path[_PATH.size], path[_PATH.bearing] = drawn[4], drawn[3]


@kernel
def space_press_draw_line(task, stream, arm, start, drawn, path):
    """Write the `PATH` record of a straight path in a random direction along a wall in space, and the commanded force.

    drawn (7,): distance of the wall from the root, m; time at which the target reaches the path's middle, s; speed,
    m/s; bearing and elevation of the wall's nearest point, rad; distance of the middle from that point, upwards along
    the wall, m; normal force, N.
    """
    space_draw_line(task, stream, arm, start, drawn, path)
    _, _, up = directions(drawn[3], drawn[4])
    path[_PATH.x], path[_PATH.y] = path[_PATH.x] + drawn[5] * up[0], path[_PATH.y] + drawn[5] * up[1]
    path[_PATH.z] = path[_PATH.z] + drawn[5] * up[2]
    path[_PATH.size], path[_PATH.bearing], path[_PATH.tilt] = drawn[6], drawn[3], drawn[4]


@kernel
def press_path_at(task, path, t, out):
    """Write the target's position (m) and velocity (m/s), inertial axes, at time t (s), on a line along the wall.

    path: a `PATH`, of which x, y, z and their velocities are read. out: the `MOVING` record that is written.
    """
    out[_MOVING.x], out[_MOVING.y] = path[_PATH.x] + path[_PATH.vx] * t, path[_PATH.y] + path[_PATH.vy] * t
    out[_MOVING.z] = path[_PATH.z] + path[_PATH.vz] * t
    out[_MOVING.vx], out[_MOVING.vy], out[_MOVING.vz] = path[_PATH.vx], path[_PATH.vy], path[_PATH.vz]


_PRESSED = {"observe": press_observe, "judge": press_judge, "draw_line": press_draw_line, "path_at": press_path_at}
TASKS.register(Press, **{**TASKS.members[Reach], **_PRESSED})
TASKS.register(PressChain, **{**TASKS.members[Chain], **_PRESSED})
_IN_SPACE = {"observe": space_press_observe, "judge": space_press_judge, "draw_line": space_press_draw_line}
TASKS.register(SpacePress, **{**TASKS.members[SpaceReach], **_IN_SPACE, "path_at": press_path_at})
