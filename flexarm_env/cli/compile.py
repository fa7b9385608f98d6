"""`flexarm compile`: everything compiled beforehand, for a machine and all the processes that will work on it."""

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
"""What is used, in words, and the first use of it."""


def run(args: argparse.Namespace) -> int:
    """Use everything once; 1 where what is compiled cannot be kept."""
    from flexarm_env.settings import FORMULATIONS

    values: dict[str, Any] = {}
    logging.getLogger("flexarm_env").setLevel(logging.ERROR)  # who asks for it need not be told
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        uses: list[Use] = []
        for formulation in (None, *FORMULATIONS) if args.all else (None,):
            word = "" if formulation is None else f" ({formulation})"
            uses += [(f"{name}{word}", use) for name, use in (*environments(formulation), *_scenes(formulation))]
        for k, (name, use) in enumerate(uses):
            start = time.perf_counter()
            sys.stderr.write(f"{k + 1} of {len(uses)}: {name} ...\n")
            use()
            values[name] = f"{time.perf_counter() - start:.1f} s"
    values |= cache_report([str(warning.message) for warning in said])
    show(values, args.json)
    return DONE if values["cache_writable"] else FAILED


def environments(formulation: str | None) -> Iterator[Use]:
    """A step of each environment, one and many; formulation None: the default."""
    import gymnasium as gym

    options: dict[str, Any] = {} if formulation is None else {"formulation": formulation}

    def one(name: str) -> None:
        env = gym.make(name, **options)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.unwrapped.batch.view(0)  # type: ignore[attr-defined]  # what a picture is drawn from
        env.close()

    def many(name: str) -> None:
        for count, threads in ((8, 1), (16, 2)):
            envs = gym.make_vec(name, num_envs=count, threads=threads, **options)
            envs.reset(seed=0)
            envs.step(envs.action_space.sample())
            envs.close()

    for name in ENVIRONMENTS:
        yield name, partial(one, name)
        yield f"{name}, vector", partial(many, name)


def _scenes(formulation: str | None) -> Iterator[Use]:
    """What is done with a scene: simulated, replayed through an environment's step, made linear."""
    from flexarm_env import linear, scenes
    from flexarm_env.envs.replay import through_env
    from flexarm_env.simulation import simulate

    def simulated() -> None:
        for name in scenes.names():
            scene = scenes.named(name)
            simulate(scene, formulation, duration=scene.dt)

    def through() -> None:
        scene = scenes.named("robot_arm_torque")
        short = dataclasses.replace(scene, duration=scene.dt, sample=scene.dt)
        through_env(short, scene.settings(formulation), scene.dt)

    def made_linear() -> None:
        scene = scenes.named("robot_arm_torque")
        linear.linearize(scene, formulation)
        linear.linearize(scene, formulation, discrete=scene.dt)
        linear.modes(scene, 3, formulation)
        linear.static_equilibrium(scene, formulation)

    yield "simulate, replay", simulated
    yield "replay --through-env", through
    yield "linearize, modes, static_equilibrium", made_linear


def cache_report(said: list[str]) -> dict[str, Any]:
    """The folder of compiled code, whether it can be written to, and a sentence where it cannot; said: warnings."""
    from flexarm_env.compiler import UNCOMPILED, objects

    if UNCOMPILED:
        return {"cache_folder": "none (compilation is switched off)", "cache_writable": False}
    folder = objects.folders()[0]
    trouble = next((text for text in said if "compiled code cannot be kept" in text), "") or _trouble(folder)
    values: dict[str, Any] = {"cache_folder": str(folder), "cache_writable": not trouble}
    return values | ({"cache": trouble.removeprefix("flexarm_env: ")} if trouble else {})


def _trouble(folder: Path) -> str:
    """Why nothing can be kept in a folder; "" where it can."""
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
            f"nothing new can be kept ({folder}: {error.strerror or error}); set {objects.VARIABLE} to a folder of "
            "your own that has room"
        )
    return ""
