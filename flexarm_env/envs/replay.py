"""Simulate a scene through the `step` of an environment; the results equal those of `simulate`."""

import dataclasses
import time
from typing import Any

import numpy as np

from .. import validation as check
from ..scene import JointTorque, Scene
from ..settings import Settings
from ..simulation import judge
from ..trajectory import Trajectory, check_work, recorded
from .flexible_arm import FlexibleArmEnv
from .multi_link import MultiLinkFlexArmEnv
from .two_link import TwoLinkFlexArmEnv

_ENVIRONMENTS: dict[int, Any] = {1: FlexibleArmEnv, 2: TwoLinkFlexArmEnv}
"""Environment for each number of links; arms with more links use MultiLinkFlexArmEnv."""


def through_env(scene: Scene, settings: Settings, sample: float | None = None, error_limit: float = 0.05) -> Trajectory:
    """Simulate a scene through an environment, one control period per sample, and return the Trajectory.

    Args:
        scene: a pinned scene, driven by joint motions or joint torques.
        settings: formulation and options, with dt. sample: control period, s; None uses the scene's sampling interval.
        error_limit: estimated error, divided by the arm's length, above which the run is "inaccurate"; see `simulate`.
    Returns:
        The trajectory, equal to that of `simulate` with these settings except for cpu_seconds.
    Raises:
        ValueError: an environment cannot represent the scene.
    """
    _check(scene)
    period = scene.sample if sample is None else check.number("sample", sample, "s", above=0.0)
    limit = check.number("error_limit", error_limit, "a fraction of the arm's length", above=0.0)
    assert period is not None and settings.dt is not None
    check_work(scene.duration, period, settings.dt)
    arm = scene.arm
    if arm.torque_limits is None:
        arm = dataclasses.replace(arm, torque_limits=(1.0,) * arm.n_links)
    options = settings.dividing(period).options()
    env = _ENVIRONMENTS.get(arm.n_links, MultiLinkFlexArmEnv)(
        arm=arm, formulation=settings.formulation, control_dt=period, duration=max(scene.duration, period),
        joint_limits=None, gravity=scene.gravity, info_level="full", **options,
    )  # fmt: skip
    env.plan = dataclasses.replace(env.plan, settings=settings)
    env.reset(options={"motion": scene})
    simulation = env.guide.simulation
    samples = [simulation.sample()]
    rest = np.zeros(arm.n_links, np.float32)
    clock = time.thread_time()
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(rest)
        over = terminated or truncated
        if env.guide.moved:
            samples.append(simulation.sample())
    cpu_seconds = time.thread_time() - clock
    fields = {name: np.concatenate([row[name] for row, _ in samples]) for name in samples[0][0]}
    trajectory = recorded(simulation, fields, np.concatenate([points for _, points in samples]), cpu_seconds)
    env.close()
    return judge(trajectory, period, limit)


def _check(scene: Scene) -> None:
    """Raise ValueError for a scene that no environment can represent."""
    why = ""
    if scene.root == "free":
        why = "its arm is a free body"
    elif any(motion.joint is None for motion in scene.motions):
        why = "the root of its arm is moved"
    elif scene.position != (0.0, 0.0):
        why = "its arm is not pinned at the origin"
    elif scene.rigid_joints:
        why = "its arm has rigid joints"
    elif any(not isinstance(load, JointTorque) for load in scene.loads):
        why = "point loads act on its arm"
    if why:
        what = "cannot go through an environment (pinned arms, driven at their joints)"
        raise ValueError(f"scene = {scene.name!r}: {what}: {why}")
