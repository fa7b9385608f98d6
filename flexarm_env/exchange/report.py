"""Compare a chain with the arm that it approximates, and calibrate the chain to the arm's lowest natural frequency."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from flexarm_env import validation as check
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import steps
from flexarm_env.validation import Array

from .chain import Chain
from .linear import chain_modes, exact_compliance, tip_compliance
from .mjcf import choose_integrator, mjcf

FORMULATION = "geometrically_exact"
COUNT = 3
"""Number of frequencies that are compared."""
PUSH = 0.25
"""Torque, as a share of the limits, under which the tips are compared."""
DURATION = 1.0
"""Duration of the comparison of the tips, s."""


def arm_modes(arm: Arm, count: int = COUNT) -> tuple[Array, Array]:
    """Return the arm's lowest natural frequencies (Hz) and damping ratios with held joints, without gravity."""
    if all(link.rigid for link in arm.links) and not any(joint.elastic for joint in arm.joints):
        return np.zeros(0), np.zeros(0)
    scene = Scene("modes", arm.taut, duration=1.0, dt=1e-3)
    found = modes(scene, count, FORMULATION, clamped=tuple(range(arm.n_links)))
    return found.frequencies / (2.0 * np.pi), found.damping


def _undamped(arm: Arm) -> Arm:
    """Return the arm without damping of links and gears."""
    links = tuple(link if link.rigid else replace(link, tau_d=0.0) for link in arm.links)
    return replace(arm, links=links, tau_d=0.0, joints=tuple(replace(joint, damping=0.0) for joint in arm.joints))


def calibrated(chain: Chain) -> tuple[Chain, float]:
    """Multiply a chain's spring stiffness until the chain has the arm's lowest frequency; return chain and factor.

    The joints are held. If the arm's first mode is overdamped, its undamped frequency is used.

    Raises:
        ValueError: double precision does not resolve the first frequency.
    """
    own, target = chain_modes(chain)[0], arm_modes(chain.arm)[0]
    if not len(own) or not len(target):
        return chain, 1.0
    if target[0] == 0.0:
        target = arm_modes(_undamped(chain.arm))[0]
    factor = 1.0
    # a spring of a gear is not scaled, so that the frequency is no square root of the factor: secant steps
    for _ in range(20):
        found = chain_modes(chain.stiffened(factor))[0]
        if not (len(found) and 0.0 < target[0] < math.inf):
            what = "must have lengths, masses and stiffnesses whose first frequency double precision resolves"
            raise check.InvalidValue("arm", chain.arm.name, what)
        now = found[0]
        if abs(now / target[0] - 1.0) < 1e-12:
            break
        factor *= (target[0] / now) ** 2
    return chain.stiffened(factor), float(factor)


def differences(chain: Chain, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    """Compare a chain with its arm.

    Returns:
        A dict of deviations. `frequency_1_hz`, ... and `chain_frequency_1_hz`, ... are the lowest natural frequencies
        of the arm and of the chain with held joints. `tip_compliance_error` is the largest error of an entry of the tip
        compliance matrix, divided by the largest entry of the matrix. `tip_apart` is the largest distance between the
        arm's tip and the chain's tip in a simulation, divided by the arm's length. The simulation lasts `DURATION` s
        with torques of `PUSH` times the torque limits, which are reversed after half of the time. MuJoCo simulates the
        chain, so that `tip_apart` requires MuJoCo and an arm with torque limits. `left_out` names the features of the
        arm that the chain lacks.
    """
    found: dict[str, Any] = {}
    own, _ = chain_modes(chain)
    for k, frequency in enumerate(arm_modes(chain.arm)[0], 1):
        found[f"frequency_{k}_hz"] = float(frequency)
        if k <= len(own):
            found[f"chain_frequency_{k}_hz"] = float(own[k - 1])
    exact = exact_compliance(chain)
    if np.abs(exact).max() > 0.0:
        found["tip_compliance_error"] = float(np.abs(tip_compliance(chain) - exact).max() / np.abs(exact).max())
    if chain.arm.torque_limits is not None:
        if check.installed("mujoco") is not None:
            try:
                found["tip_apart"] = tip_apart(chain, gravity)
            except ValueError as error:
                # the solver or MuJoCo rejects the arm; the exported model remains valid
                found["tip_apart"] = f"not computed: {error}"
        else:
            found["tip_apart"] = "not computed: it needs mujoco (pip install mujoco)"
    found["left_out"] = list(chain.left_out)
    return found


def pushed(arm: Arm, gravity: tuple[float, float, float]) -> Scene:
    """Return the scene for `tip_apart`: torques of `PUSH` times the limits, reversed after half of `DURATION`."""
    assert arm.torque_limits is not None
    loads = tuple(
        JointTorque(k, steps([0.0, 0.5 * DURATION], [PUSH * limit, -PUSH * limit]))
        for k, limit in enumerate(arm.torque_limits)
    )
    weight = gravity if any(gravity) else None
    return Scene("pushed", replace(arm, sensors=None), duration=DURATION, dt=1e-3, sample=0.02, loads=loads,
                 gravity=weight)  # fmt: skip


def tip_apart(chain: Chain, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> float:
    """Return the largest distance between the chain's tip and the arm's tip, divided by the arm's length.

    MuJoCo simulates the chain in the motion that `differences` describes. Raises ImportError if MuJoCo is not
    installed.
    """
    with check.needs("the comparison of tips", "mujoco", "mujoco"):
        import mujoco
    scene = pushed(chain.arm, gravity)
    run = simulate(scene, FORMULATION, estimate_error=False)
    if not run.finished:
        return float("nan")
    model = mujoco.MjModel.from_xml_string(mjcf(chain, gravity=gravity))
    # a whole number of steps a sample; short ones for the implicit integrator, which is of first order
    longest = model.opt.timestep if choose_integrator(chain)[0] == "RK4" else 1e-4
    per_sample = int(np.ceil(0.02 / longest))
    model.opt.timestep = 0.02 / per_sample
    data, site = mujoco.MjData(model), model.site("tip").id
    limits = np.array(chain.arm.torque_limits)
    apart = 0.0
    for k, tip in enumerate(run.tip[1:]):
        data.ctrl[:] = PUSH * limits * (1.0 if run.t[k] < 0.5 * DURATION - 1e-9 else -1.0)
        for _ in range(per_sample):
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        place = np.array([*tip[: len(scene.axes)], 0.0])[:3]
        apart = max(apart, float(np.linalg.norm(data.site_xpos[site] - place)))
    return apart / chain.arm.total_length
