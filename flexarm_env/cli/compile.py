"""`flexarm compile`: compile programs in advance and store them for all processes on a machine."""

import argparse
import contextlib
import dataclasses
import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.progress import show

ENVIRONMENTS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")

Use = tuple[str, Callable[[], object]]
"""Description of a feature, and a function that uses the feature once."""


def run(args: argparse.Namespace) -> int:
    """Compile the programs by using each feature once; return exit code 1 if they cannot be stored."""
    from flexarm_env.settings import FORMULATIONS

    if args.clean:
        return clean(args.json)
    values: dict[str, Any] = {}
    logging.getLogger("flexarm_env").setLevel(logging.ERROR)  # who asks for it need not be told
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        uses: list[Use] = []
        for formulation in (None, *FORMULATIONS) if args.all else (None,):
            word = "" if formulation is None else f" ({formulation})"
            uses += [(f"{name}{word}", use) for name, use in (*environments(formulation), *_scenes(formulation))]
        began = time.perf_counter()
        for k, (name, use) in enumerate((*uses, *_commands())):
            start = time.perf_counter()
            sys.stderr.write(f"{k + 1} of {len(uses) + len(_commands())}: {name} ({start - began:.0f} s elapsed) ...\n")
            use()
            values[name] = f"{time.perf_counter() - start:.1f} s"
    values |= cache_report([str(warning.message) for warning in said])
    show(values, args.json)
    return DONE if values["cache_writable"] else FAILED


def clean(as_json: bool) -> int:
    """Delete the compiled programs of all versions; return exit code 1 if a file cannot be deleted."""
    from flexarm_env.compiler import objects

    folder = objects.folders()[0]
    count, size = objects.clean(folder)
    left = len(objects.programs(folder))
    values = {"cache_folder": str(folder), "files_deleted": count, "MB_deleted": round(size / 2**20, 1)}
    show(values | ({"files_left": left} if left else {}), as_json)
    return FAILED if left else DONE


def environments(formulation: str | None) -> Iterator[Use]:
    """Compile the programs of each environment, single and vector.

    formulation: beam formulation; None for the default.
    """
    import gymnasium as gym

    options: dict[str, Any] = {} if formulation is None else {"formulation": formulation}

    def one(name: str) -> None:
        """Compile the programs of a single environment: reset, step and picture."""
        env = gym.make(name, **options)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.unwrapped.batch.view(0)  # type: ignore[attr-defined]  # what a picture is drawn from
        env.close()

    def many(name: str) -> None:
        """Compile the programs of a vector environment, for one and for two threads."""
        for count, threads in ((8, 1), (16, 2)):
            envs = gym.make_vec(name, num_envs=count, threads=threads, **options)
            envs.reset(seed=0)
            envs.step(envs.action_space.sample())
            envs.close()

    for name in ENVIRONMENTS:
        yield name, partial(one, name)
        yield f"{name}, vector", partial(many, name)


def _scenes(formulation: str | None) -> Iterator[Use]:
    """Compile the programs of scenes: simulation, replay through an environment, and linear models."""
    from flexarm_env import linear, scenes
    from flexarm_env.envs.replay import through_env
    from flexarm_env.simulation import simulate

    def simulated() -> None:
        """Compile `simulate` for every named scene by running one step of each."""
        for name in scenes.names():
            scene = scenes.named(name)
            simulate(scene, formulation, duration=scene.dt)

    def through() -> None:
        scene = scenes.named("robot_arm_torque")
        short = dataclasses.replace(scene, duration=scene.dt, sample=scene.dt)
        through_env(short, scene.settings(formulation), scene.dt)

    def made_linear() -> None:
        """Compile linearization, modes and static equilibrium of a two-link scene."""
        scene = scenes.named("robot_arm_torque")
        linear.linearize(scene, formulation)
        linear.linearize(scene, formulation, discrete=scene.dt)
        linear.modes(scene, 3, formulation)
        linear.static_equilibrium(scene, formulation)

    yield "simulate, replay", simulated
    yield "replay --through-env", through
    yield "linearize, modes, static_equilibrium", made_linear


def _commands() -> list[Use]:
    """Return functions that use features beyond environments and scenes: policies, controllers, gradients."""
    import gymnasium as gym
    import numpy as np

    from flexarm_env import control, scenes, simulate
    from flexarm_env.cli.play import play
    from flexarm_env.cli.view import OF_THE_POLICY
    from flexarm_env.derivatives import Arms
    from flexarm_env.recording import EpisodeRecorder
    from flexarm_env.training.episodes import judged_in

    def plays(word: str, env_id: str, **options: Any) -> None:
        """Compile the programs that `flexarm play`, `view` and `evaluate` need for a policy in an environment."""
        recorder = EpisodeRecorder(gym.make(env_id, **{**options, "duration": 0.04}))
        for _ in play(recorder, control.find_policy(word), range(1), []):
            pass
        recorder.episodes[0].clip(word)
        recorder.close()
        envs = gym.make_vec(env_id, num_envs=4, **options)
        policy = control.load_policy(word, envs)
        observation, _ = envs.reset(seed=0)
        policy.reset(observation)
        envs.step(policy.act(observation))
        envs.close()

    def packaged() -> None:
        """Compile the programs of the packaged policies, and of PD in their environments."""
        for name in control.policy_names():
            found = control.find_policy(name)
            plays(name, found.env_id, **judged_in(found.env_kwargs, found.asked))
            options = {k: v for k, v in judged_in(found.env_kwargs, found.asked).items() if k not in OF_THE_POLICY}
            plays("pd", found.env_id, **options)

    def controllers(env_id: str) -> None:
        for name in control.NAMES:
            if name in control.FORCE_NAMES or (name == "time_optimal" and env_id != ENVIRONMENTS[0]):
                continue
            plays(name, env_id, **({"observation": "measured"} if name == "lqg" else {}))

    def gradient(env_id: str) -> None:
        arms = Arms(env_id, 64)
        state, still = arms.reset(seed=0), np.zeros((64, arms.action_size))
        arms.step(state, still)
        arms.vjp(state, still, state, arms.observe(state), np.zeros(64))

    def exact() -> None:
        scene = scenes.named("two_link_motion")
        simulate(scene, "geometrically_exact", duration=scene.dt)

    uses: list[Use] = [("play, view, evaluate: policies of the package", packaged)]
    uses += [(f"play, view, evaluate: controllers on {name}", partial(controllers, name)) for name in ENVIRONMENTS]
    uses += [(f"train --algo gradient on {name}", partial(gradient, name)) for name in ENVIRONMENTS]
    uses += [("simulate --formulation geometrically_exact", exact)]
    return uses


def cache_report(said: list[str]) -> dict[str, Any]:
    """Return a dict with the folder of compiled programs, whether it is writable, and a sentence if it is not.

    said: texts of the warnings during compilation.
    """
    from flexarm_env.compiler import UNCOMPILED, objects

    if UNCOMPILED:
        return {"cache_folder": "none (compilation is switched off)", "cache_writable": False}
    folder = objects.folders()[0]
    trouble = next((text for text in said if "compiled code cannot be kept" in text), "") or _trouble(folder)
    taken = sum(size for _, size, _ in objects.programs(folder)) / 2**20
    values: dict[str, Any] = {"cache_folder": str(folder), "cache_writable": not trouble}
    values["cache_size"] = f"{taken:.1f} MB of at most {objects.limit() / 2**20:.0f} MB"
    return values | ({"cache": trouble.removeprefix("flexarm_env: ")} if trouble else {})


def _trouble(folder: Path) -> str:
    """Return the reason why a folder cannot store files, or ""."""
    from flexarm_env.compiler import objects

    probe = folder / f".flexarm-{time.time_ns()}"
    try:
        objects.prepare(folder)
        probe.write_bytes(bytes(2**16))
        probe.unlink()
    except OSError as error:
        with contextlib.suppress(OSError):
            probe.unlink()
        return (
            f"compiled code cannot be stored ({folder}: {error.strerror or error}); set {objects.VARIABLE} to a "
            "writable folder with free space"
        )
    return ""
