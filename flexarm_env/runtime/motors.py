"""From actions to joint torques: controllers under the action, and motors with lag, delay, saturation and friction."""

from __future__ import annotations

from typing import Any

from ..compiler import TUPLE, by_kind, kernel, load, size, square_root, stack, store
from ..physics.arithmetic import clip
from ..physics.integrator.start import restart
from ..physics.integrator.step import advance
from ..physics.integrator.switching import switch
from ..physics.layout import POSE
from ..physics.protocol import link_poses
from ..tasks.program import FRICTION, GOAL, PERIODS, TORQUE_FACTOR, record_at, saved_at

_ANGLE, _RATE = 0, POSE.rate - POSE.angle


@kernel
def _joint(lane, poses, k, rates):
    """Angle (_ANGLE) or rate (_RATE) of joint k."""
    here = load(lane, poses, POSE.end * k + POSE.angle + rates)
    if k == 0:
        return here
    return here - load(lane, poses, POSE.end * (k - 1) + POSE.tip_angle + rates)


@kernel
def command(lane, task, controller, action, poses, record, u):
    """u <- torques asked for, N m: the action's share of the limits, or what the controllers make of it."""
    factor = load(lane, record, TORQUE_FACTOR)
    for k in range(size(task.links)):
        limit = task.torque_limits[k]
        torque = load(lane, action, k) * limit
        if controller is not None:
            error = load(lane, record, GOAL + k) - _joint(lane, poses, k, _ANGLE)
            torque = torque * controller.share + error * controller.stiffness[k]
            torque = clip(torque - _joint(lane, poses, k, _RATE) * controller.damping[k], limit)
        store(u, k, torque * factor)


@kernel
def take_steps(lane, p, model, parts, controller, actuator, par, poses, record, action, saved, block, w):
    """The steps of one period under an action, each in so many parts."""
    _see_joints(lane, controller, actuator, model, par, w.q, w.v, poses)
    for k in range(size(p.task.links)):
        store(w.u0, k, load(lane, w.u, k))
    command(lane, p.task, controller, action, poses, record, w.u)
    if actuator is None:
        _jump(lane, model.predictor, p, model, par, record, saved, block, w)
        advance(lane, model, None, par, block, 0, 0.0, p.h / parts, p.n_steps * parts, p.scheme, p.books)
    else:
        _run_motors(lane, p, model, parts, actuator, par, poses, record, saved, block, w)


@kernel
def _see_joints(lane, controller, actuator, model, par, q, v, poses):
    if controller is not None:
        link_poses(lane, model, par, q, v, poses)
    elif actuator is not None:
        link_poses(lane, model, par, q, v, poses)


@kernel
def _jump_afresh(lane, predictor, p, model, par, record, saved, block, w):
    restart(lane, model, None, par, block, 0, 0.0, p.h, True)


@kernel
def _jump_stiff(lane, predictor, p, model, par, record, saved, block, w):
    lanes, n, any_first = len(lane), size(model.n), False
    for i in range(lanes):
        if record[PERIODS * lanes + i] < 0.5:
            any_first = True
    if any_first:
        restart(lane, model, None, par, block, 0, 0.0, p.h, True)
        for i in range(lanes):
            if record[PERIODS * lanes + i] < 0.5:
                for k in range(size(p.task.links)):
                    w.u0[k * lanes + i] = w.u[k * lanes + i]
            else:
                at = saved_at(0, n, 0, 0, 0)
                for k in range(n):
                    w.a[k * lanes + i] = saved[(at.a + k) * lanes + i]
                    w.b[k * lanes + i] = saved[(at.b + k) * lanes + i]
    switch(lane, model, par, block, 0)


@by_kind("predictor", "lane, predictor, p, model, par, record, saved, block, w")
def _jump(kind: str) -> Any:
    """Accelerations jump with the torques, from w.u0 to w.u.

    They are solved afresh where nothing is stiff, the elastica (a pair as predictor); elsewhere in an episode's first
    period only (`switching.switch` says why).
    """
    return _jump_afresh if kind == TUPLE else _jump_stiff


@kernel
def _run_motors(lane, p, model, parts, actuator, par, poses, record, saved, block, w):
    """The motors' torques followed through each step.

    Friction acts with the rate that the last step's change leads to expect at the end of the step.
    """
    n = size(p.task.links)
    at = record_at(0, n, 1, actuator.age + 2, 0, 0)
    before, now = stack(lane, p.task.links), stack(lane, p.task.links)
    for k in range(n):
        _remember(lane, record, at.commands + k, n, actuator.age + 1, load(lane, w.u, k))
        store(before, k, _joint(lane, poses, k, _RATE))
        store(now, k, _joint(lane, poses, k, _RATE))
    for s in range(p.n_steps):
        age = actuator.age + 1 if s < actuator.late else actuator.age
        for k in range(n):
            asked = load(lane, record, at.commands + age * n + k)
            torque = load(lane, record, at.torque + k)
            torque = clip(torque + (asked - torque) * actuator.share, actuator.limits[k])
            store(record, at.torque + k, torque)
            rate = load(lane, now, k) * 2.0 - load(lane, before, k)
            store(w.u, k, torque - _friction(actuator, k, rate))
            store(before, k, load(lane, now, k))
        if s == 0:
            _jump(lane, model.predictor, p, model, par, record, saved, block, w)
        _book(lane, p.books, p.task, poses, record, w.u, 1.0)
        advance(lane, model, None, par, block, 0, 0.0, p.h / parts, parts, p.scheme, p.books)
        link_poses(lane, model, par, w.q, w.v, poses)
        for k in range(n):
            store(now, k, _joint(lane, poses, k, _RATE))
        _book(lane, p.books, p.task, poses, record, w.u, -1.0)


@kernel
def _friction(actuator, k, rate):
    """Torque that friction takes at a rate, N m."""
    creep = actuator.creep
    return rate * (actuator.viscous[k] + actuator.coulomb[k] / square_root(rate * rate + creep * creep))


@kernel
def _book(lane, books, task, poses, record, u, sign):
    """Friction's loss over a step: its torque times the way turned, in two halves."""
    if books is not None:
        n = size(task.links)
        torque = record_at(0, n, 1, 0, 0, 0).torque
        lost = load(lane, record, FRICTION)
        for k in range(n):
            friction = load(lane, record, torque + k) - load(lane, u, k)
            lost = lost - friction * _joint(lane, poses, k, _ANGLE) * sign
        store(record, FRICTION, lost)


@kernel
def _remember(lane, record, first, stride, count, value):
    """Push a value into a memory of count + 1 entries, the newest first."""
    for k in range(count, 0, -1):
        store(record, first + k * stride, load(lane, record, first + (k - 1) * stride))
    store(record, first, value)
