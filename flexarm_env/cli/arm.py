"""`flexarm arm`: print properties of an arm for control and learning, and a suitable episode duration."""

import argparse
import math
from typing import Any

import gymnasium as gym
import numpy as np

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.play import keywords
from flexarm_env.cli.progress import show
from flexarm_env.control import Setup
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.control.margins import MARGINS_OF, margins
from flexarm_env.control.time_optimal import slew_plan
from flexarm_env.envs.ids import make_registered
from flexarm_env.envs.space import kind_for
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm
from flexarm_env.rigid import timescales
from flexarm_env.scene import Scene

FREQUENCIES = 3
"""Number of flexible modes that `flexarm arm` prints."""


def run(args: argparse.Namespace) -> int:
    """Print masses, frequencies, time scales and stability margins of an arm; return the exit code."""
    arm = arms.resolve(args.arm)
    if arm.torque_limits is None:
        with check.in_file(args.arm):
            raise check.MissingKey("torque_limits", f"the time scales need {arm.n_links} torque limit(s)")
    given = keywords(args.env_kwargs)
    if "arm" in given:
        raise check.InvalidValue("--env-kwargs", "arm", "must not be given: the argument ARM sets the arm")
    env: Any = make_registered(gym.make, environment_of(arm), arm=arm, **{"duration": 100.0, **given}).unwrapped
    plan, setup = env.plan, Setup.of(env)
    times = timescales(plan.arm, plan.period if "control_dt" in given else None)
    found: dict[str, Any] = {
        "arm": arm.name,
        "environment": plan.kind.id,
        "mass_kg": arm.mass,
        "length_m": arm.total_length,
    }
    for joint, quarter in zip(arm.joint_names, times.quarter_turns, strict=True):
        found[f"quarter_turn_{joint}_s"] = quarter
    if plan.kind.task == "slew":
        found["quarter_turn_flexible_s"] = slew_plan(setup, 0.5 * math.pi).periods * setup.control_dt
    found |= frequencies(arm)
    found |= {"duration_s": times.duration, "control_dt_s": times.control_dt, "gamma": times.gamma}
    found |= {"motor_and_sensor_delay_s": setup.delay, "motor_lag_s": setup.lag}
    for name in MARGINS_OF:
        own = _margins(name, setup)
        if own is not None:
            found[f"{name}_gain_margin_db"] = 20.0 * math.log10(own.gain)
            found[f"{name}_delay_margin_s"] = own.delay
    show({key: _rounded(value) for key, value in found.items()}, args.json)
    return DONE


def environment_of(arm: Arm) -> str:
    """Return the id of the environment that fits an arm."""
    return kind_for(arm).id


def frequencies(arm: Arm) -> dict[str, float]:
    """Return natural frequencies (Hz) and damping ratios of the lowest flexible modes, by name.

    The arm is straight, without gravity, and its joints are free.
    """
    scene = Scene("modes", arm.taut, duration=1.0, dt=1e-3)
    own = modes(scene, arm.n_links + FREQUENCIES + 1, "geometrically_exact", clamped=())
    flexible = np.flatnonzero(own.frequencies > 1e-3 * own.frequencies.max())[:FREQUENCIES]
    named: dict[str, float] = {}
    for k, at in enumerate(flexible, 1):
        named[f"frequency_{k}_hz"] = float(own.frequencies[at]) / (2.0 * math.pi)
        named[f"damping_ratio_{k}"] = float(own.damping[at])
    return named


def _margins(name: str, setup: Setup) -> Any:
    """Return the stability margins of a controller with default gains, or None if the arm does not support it."""
    try:
        gains = tuned_gains(name, setup.gains, setup.n_joints)
    except check.InvalidValue:
        return None
    return margins(setup, gains)


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
