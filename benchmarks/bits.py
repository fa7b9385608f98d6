"""Hashes of what the solver computes: kept before a change that should change nothing, and compared after it.

python -m benchmarks.bits FILE            writes the hashes of every case to FILE (JSON)
python -m benchmarks.bits FILE --compare  computes them again; the exit code is 1 where one differs

Cases: named scenes and scenes with every kind of load and motion under every formulation and its options; episodes of
every environment, single and vector, with randomisation, sensors, motors, fitted steps, corrected steps, moving targets
and autoreset. A case's numbers are kept beside FILE (FILE.npz), so that a difference has a size.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import flexarm_env  # noqa: F401  (registers the environments)
from flexarm_env import arms
from flexarm_env.linear import linearize, modes
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.scenes import named
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import cycloid, pulse, ramp, sine, steps

Numbers = NDArray[np.float64]

FORMULATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "segments": ("floating_frame", {"segments": 3}),
    "elements": ("floating_frame", {"segments": 1, "elements": 3}),
    "paper": ("floating_frame", {"segments": 2, "elements": 2, "coupling": "paper"}),
    "modes": ("floating_frame", {"modes": 2}),
    "modes in segments": ("floating_frame", {"modes": 2, "segments": 2}),
    "exact": ("geometrically_exact", {"elements": 4}),
    "exact, order 3": ("geometrically_exact", {"elements": 2, "order": 3}),
    "exact, corrected": ("geometrically_exact", {"elements": 4, "period_correction": True}),
    "exact, modified Newton": ("geometrically_exact", {"elements": 4, "newton": "modified"}),
    "elastica": ("elastica", {"nodes": 5}),
    "elastica, fitted": ("elastica", {"nodes": 4, "step_tolerance": 1e-4}),
    "elastica, damped steps": ("elastica", {"nodes": 4, "rho_inf": 0.6}),
}
SCENES = ("robot_arm_motion", "robot_arm_torque", "two_link_motion", "two_link_free_flight", "flying_rod")
RANDOM = {"payload": (0.5, 2.0), "EI": (0.7, 1.3), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1)}
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "default": {},
    "exact": {"formulation": "geometrically_exact"},
    "exact, corrected": {"formulation": "geometrically_exact", "period_correction": True, "randomization": RANDOM},
    "floating": {"formulation": "floating_frame"},
    "floating, modes": {"formulation": "floating_frame", "modes": 2, "segments": 3, "dt": 0.002},
    "random": {"randomization": RANDOM, "initial_vibration": 0.02, "info_level": "full", "gravity": (0.0, -9.81)},
    "motors": {"actuator": {"lag": 0.01, "delay": 0.02, "viscous": 0.01, "coulomb": 0.02}},
    "sensors": {"sensors": {"noise": 0.01, "delay": 0.02}, "action_mode": "residual_pd"},
    "fitted": {"step_tolerance": 1e-4, "dt": 0.02},
    "track": {"task": "track", "info_level": "full"},
    "short": {"duration": 0.3, "max_episode_steps": 12},
}


def driven() -> list[Scene]:
    """Scenes of one and two links with every kind of load and motion, jumps included."""
    section = Section(2.0, 2e5, 7e4, 0.3, 1e-6)
    one = Arm("one", (Link(1.0, section),), hub_inertia=0.02, payload=Payload(0.1, 1e-4), tau_d=2e-3)
    two = Arm(
        "two", (Link(0.6, section), Link(0.4, section)), hub_inertia=0.02, elbows=(Elbow(0.1, 1e-3, 2e-3),),
        payload=Payload(0.1, 1e-4), tau_d=2e-3,
    )  # fmt: skip
    wave = sine(0.5, 6.0)
    shake = Motion("root_y", sine(0.03, 15.0)), Motion("root_x", cycloid(0.1, 0.3))
    tip, thrown = PointLoad(0, "tip", wave, wave, wave), PointLoad(0, "root", wave, pulse(5.0, 0.1), wave)
    drives: dict[str, dict[str, Any]] = {
        "torque": {"loads": (JointTorque(0, steps([0.0, 0.2], [1.0, -1.0])),), "gravity": (0.0, -9.81)},
        "shaken": {"motions": shake},
        "held": {"motions": (Motion("joint0", ramp(0.5, 0.21)),), "loads": (tip,)},
        "elbow": {"motions": (Motion("joint1", cycloid(1.0, 0.3)),), "loads": (JointTorque(0, pulse(1.0, 0.13)),)},
        "rigid": {"angles": (0.0, 0.6), "rigid_joints": (1,), "loads": (JointTorque(0, wave),)},
        "thrown": {"root": "free", "loads": (thrown,)},
    }
    arms_of = {"torque": one, "shaken": one, "held": one}
    return [
        Scene(name, arms_of.get(name, two), duration=0.5, dt=0.004, sample=0.02, **own) for name, own in drives.items()
    ]


def _run(scene: Scene, method: str, **more: Any) -> Numbers:
    formulation, options = FORMULATIONS[method]
    run = simulate(scene, formulation, estimate_error=False, **options, **more)
    rows = (run.t, run.q, run.v, run.tip, run.energy, run.work, run.dissipated, run.joint_torque, run.shapes)
    return np.concatenate([np.ravel(part) for part in rows])


def _episode(env_id: str, keywords: dict[str, Any], n: int, threads: int) -> Numbers:
    """A vector of n arms (1: a single environment) through resets; observations, rewards and what info tells."""
    rng = np.random.default_rng(7)
    found: list[Any] = []
    env: Any = gym.make(env_id, **keywords) if n == 1 else gym.make_vec(env_id, num_envs=n, threads=threads, **keywords)
    env.reset(seed=3)
    for _ in range(40):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(action)
        found += [seen, reward, terminated, truncated, info["tip_position"], info["joint_torque"]]
        if n == 1:
            found.append(info["tip_deflection"])
            if terminated or truncated:
                env.reset()
    return np.concatenate([np.asarray(part, np.float64).ravel() for part in found])


def cases() -> dict[str, Callable[[], Numbers]]:
    """Name and computation of every case."""
    found: dict[str, Callable[[], Numbers]] = {}
    for name in SCENES:
        for method in ("segments", "exact", "elastica"):
            found[f"scene {name}, {method}"] = lambda name=name, method=method: _run(
                named(name), method, dt=0.05, duration=min(2.0, named(name).duration), sample=0.1
            )
    for scene in driven():
        for method in FORMULATIONS:
            found[f"scene {scene.name}, {method}"] = lambda scene=scene, method=method: _run(scene, method)
    rest = Scene("rest", arms.named("strip"), duration=1.0, dt=0.0025, gravity=(0.0, -9.81))
    for method in ("segments", "exact", "elastica"):
        formulation, options = FORMULATIONS[method]
        found[f"linear, {method}"] = lambda f=formulation, o=options: np.concatenate(
            [np.ravel(matrix) for matrix in linearize(rest, f, discrete=0.02, **o)]
        )
        found[f"modes, {method}"] = lambda f=formulation, o=options: modes(rest, 3, f, clamped=True, **o).frequencies
    for env_id in ("FlexibleArm-v0", "TwoLinkFlexArm-v0"):
        for word, keywords in ENVIRONMENTS.items():
            for n, threads in ((1, 1), (11, 1), (33, 2)):
                if "floating" in word and n == 33:
                    continue
                found[f"{env_id}, {word}, {n}"] = lambda e=env_id, k=keywords, n=n, t=threads: _episode(e, k, n, t)
    return found


def main(arguments: list[str] | None = None) -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--only", default="", help="cases whose name holds this text")
    options = parser.parse_args(arguments)
    numbers, hashes = {}, {}
    for name, compute in cases().items():
        if options.only in name:
            try:
                numbers[name] = compute()
            except Exception as error:  # that a case is refused is told apart from a number, too
                numbers[name], hashes[name] = np.zeros(0), f"{type(error).__name__}: {error}"[:200]
                print(name, hashes[name], flush=True)
                continue
            hashes[name] = hashlib.sha256(np.ascontiguousarray(numbers[name])).hexdigest()
    beside = options.file.with_suffix(".npz")
    if not options.compare:
        options.file.write_text(json.dumps(hashes, indent=1) + "\n")
        np.savez_compressed(beside, **numbers)
        print(f"{len(hashes)} cases kept")
        return 0
    known, kept = json.loads(options.file.read_text()), np.load(beside)
    different = [name for name in hashes if known.get(name) != hashes[name]]
    for name in different:
        if name in kept and kept[name].shape == numbers[name].shape:
            off = np.nanmax(np.abs(kept[name] - numbers[name])) / max(np.nanmax(np.abs(kept[name])), 1e-300)
            print(f"{name}: off by {off:.2g} of the largest number")
        else:
            print(f"{name}: {'not known before' if name not in known else 'of another shape'}")
    print(f"{len(hashes) - len(different)} of {len(hashes)} cases are equal to the last bit")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
