"""From an unknown arm behind a UDP connection to a policy in C that moves it: docs/results/circle.md.

python -m benchmarks.circle [--seeds N] [--steps N] [--targets N] [--page] [--out FOLDER] [--runs FOLDER]

docs/tutorials/circle.md explains the steps. This script runs the steps of the tutorial at full length and for several
seeds.
"""

import argparse
import contextlib
import ctypes
import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmarks import pages
from benchmarks.machine import table
from flexarm_env import Joint, arms
from flexarm_env.files import csv_lines, write_text
from flexarm_env.identification import identify
from flexarm_env.remote import Played, RemoteArmEnv, run_policy
from flexarm_env.validation import Array

RATE, PERIOD = 200, 0.02
"""Sampling rate of the log, Hz, and control period of the policies, s."""
SEEN = {"observation": "measured", "history": 4}
MARGIN = 0.05
"""Smallest half-width of the randomization of the fitted arm: a share of the fitted value."""
FIRST = 10_000
"""Seed of the first target."""
SECONDS = 3.0
BAND, LEAST = 0.02, np.radians(0.5)
"""Band of a settled tip: this share of the distance to the target, but at least LEAST rad."""

CONFIG = """
time = "t"
starts = 2
[inputs]
torque0 = "torque0"
[outputs]
hub_angle = { column = "angle0", offset = START }
strain_gauge_1 = "strain_gauge_1"
[solver]
nodes = 5
dt = 0.0025
[parameters]
"links[0].section.EI" = { name = "EI", low = 1.0, high = 30.0 }
"payload.mass" = { name = "payload", low = 0.01, high = 1.0 }
"hub_inertia" = { name = "hub", low = 0.001, high = 0.5 }
"tau_d" = { name = "tau_d", low = 1e-5, high = 0.05 }
"joints[0].friction_viscous" = { name = "viscous", low = 0.0, high = 0.2, size = 0.01 }
"joints[0].friction_coulomb" = { name = "coulomb", low = 0.0, high = 0.2, size = 0.01 }
"inputs.torque0.shift" = { name = "delay", low = -0.06, high = 0.06, start = 0.01, size = 0.01 }
"""


def strip_with(friction: tuple[float, float] | None = None, **factors: float) -> Any:
    """Return the packaged strip with factors on EI, payload, hub and damping.

    friction: viscous (N m s/rad) and Coulomb (N m) friction of the joint; None: no friction.
    """
    strip = arms.named("strip")
    link = strip.links[0]
    assert link.uniform is not None
    section = dataclasses.replace(link.uniform, EI=factors.get("EI", 1.0) * link.uniform.EI)
    return dataclasses.replace(
        strip, links=(dataclasses.replace(link, section=section),),
        hub_inertia=factors.get("hub", 1.0) * strip.hub_inertia,
        payload=dataclasses.replace(strip.payload, mass=factors.get("payload", 1.0) * strip.payload.mass),
        tau_d=factors.get("damping", 1.0) * strip.tau_d,
        joints=(Joint(friction_viscous=friction[0], friction_coulomb=friction[1]),) if friction else (),
    )  # fmt: skip


def unknown(seed: int) -> tuple[Any, float]:
    """Return a random arm that differs from the packaged strip, and the delay of its motor, s."""
    rng = np.random.default_rng(seed)
    names = ("EI", "payload", "hub", "damping")
    factors = dict(zip(names, rng.uniform([0.5, 1.2, 0.9, 1.0], [0.8, 1.9, 1.4, 1.8]).tolist(), strict=True))
    friction = tuple(rng.uniform([0.01, 0.005], [0.04, 0.03]).tolist())
    arm = strip_with((friction[0], friction[1]), **factors)
    return dataclasses.replace(arm, name=f"unknown{seed}"), float(rng.choice([0.0, PERIOD]))


def flexarm(*words: str) -> str:
    """Run a command of `flexarm` and return its output."""
    command = (sys.executable, "-m", "flexarm_env", *words)
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


@contextlib.contextmanager
def served(arm: Path, rate: float, log: Path, seed: int, **kwargs: Any) -> Iterator[RemoteArmEnv]:
    """Run `flexarm serve` in another process, and yield the environment that drives the arm.

    The log is complete when the context ends.
    """
    words = ["serve", str(arm), "--rate", f"{rate:g}", "--port", "0", "--watchdog", "50", "--seed", str(seed)]
    words += ["--log", str(log), "--env-kwargs", json.dumps(kwargs)]
    command = [sys.executable, "-m", "flexarm_env", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        host, port = server.stdout.readline().split(" at ")[1].split(",")[0].split(":")
        env = RemoteArmEnv(host, int(port))
        try:
            yield env
        finally:
            env.close()
            server.terminate()
            server.communicate()


def rows_of(log: Path) -> dict[str, Array]:
    """Read the columns of a log."""
    header, lines = csv_lines(log)
    values = np.array(lines, np.float64)
    return {name: values[:, k] for k, name in enumerate(header)}


class InC:
    """Policy that calls the compiled C file of an exported policy."""

    def __init__(self, source: Path) -> None:
        library = source.with_suffix(".so").resolve()
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
        self.decide = getattr(ctypes.CDLL(str(library)), f"{source.stem}_decide")

    def reset(self, observation: Any) -> None:
        """Do nothing: the observation contains the policy's whole memory."""

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return the action that the C function computes."""
        seen, action = np.ascontiguousarray(observation, np.float32), np.zeros(1, np.float32)
        self.decide(seen.ctypes.data_as(ctypes.c_void_p), action.ctypes.data_as(ctypes.c_void_p))
        return action


def settling(arm: Path, log: Path, seed: int, **kwargs: Any) -> tuple[float, float]:
    """Return the settling time of a logged episode, s, and half of the tip's swing in the last second, mm.

    An episode that does not settle has the time SECONDS. The log lacks the tip's position. The function therefore
    simulates the served arm again under the logged torques, and requires that the hub agrees with the log within 1e-9
    rad.
    """
    rows = rows_of(log)
    acted = rows["torque0"]
    begin = int(np.flatnonzero(acted)[0])
    acted = acted[: begin + round(SECONDS / PERIOD)]
    env: Any = gym.make("FlexibleArm-v0", arm=str(arm), control_dt=PERIOD, duration=1e6, **kwargs)
    _, info = env.reset(seed=seed)
    limits, errors, bends, told = env.unwrapped.plan.arm.torque_limits[0], [], [], []
    for torque in acted:
        _, _, _, _, info = env.step(np.array([torque / limits], np.float32))
        tip = np.arctan2(info["tip_position"][1], info["tip_position"][0])
        told.append(float(env.unwrapped.batch.view(0).poses[0, 2]))
        errors.append((float(info["target"]) - tip + np.pi) % (2.0 * np.pi) - np.pi)
        bends.append(float(np.ravel(info["tip_deflection"])[0]))
    apart = np.abs(np.array(told[:-1]) - rows["angle0"][1 : len(acted)]).max()
    assert apart < 1e-9, f"{log}: the hub is {apart} rad from where the arm's own program brings it"
    off = np.abs(np.array(errors[begin:]))
    outside = np.flatnonzero(off > max(BAND * off[0], LEAST))
    last = np.array(bends[-round(1.0 / PERIOD) :])
    at = 0.0 if not len(outside) else (outside[-1] + 1) * PERIOD
    return min(float(at), SECONDS), 1e3 * 0.5 * float(np.ptp(last)) * arms.resolve(arm).links[0].length


def fitted(folder: Path, arm: Path, delay: float, seed: int, seconds: float = 10.0) -> Any:
    """Excite the served arm, log its motion, and identify its parameters; return the fit."""
    flexarm("excite", "strip", "--rate", str(RATE), "--seconds", f"{seconds:g}", "--most-angle", "0.3", "--seed",
            str(seed), "--out", str(folder / "excite.csv"))  # fmt: skip
    actuator = {"delay": delay}
    with served(arm, RATE, folder / "log.csv", seed, observation="measured", actuator=actuator) as env:
        played = Played(folder / "excite.csv", env.wire.period, env.wire.limits)
        run_policy(played, env, played.seconds, most_angle=10.0)
    start = rows_of(folder / "log.csv")["angle0"][0]
    write_text(folder / "known.toml", arms.to_toml(strip_with((0.005, 0.005))))
    config = CONFIG.replace("START", repr(float(start)))
    return identify(folder / "known.toml", config, [folder / "log.csv"], out=folder / "fit")


def one(folder: Path, seed: int, steps: int, targets: int, seconds: float = 10.0) -> pages.Found:
    """Identify one unknown arm, train policies for the fitted and the nominal arm, and run both policies on the arm."""
    folder.mkdir(parents=True, exist_ok=True)
    arm, delay = unknown(seed)
    path = folder / "unknown.toml"
    write_text(path, arms.to_toml(arm))
    found = fitted(folder, path, delay, seed, seconds)
    truth = (arm.links[0].section.EI, arm.payload.mass, arm.hub_inertia, arm.tau_d, arm.joints[0].friction_viscous,
             arm.joints[0].friction_coulomb, delay)  # fmt: skip
    values = dict(zip((p.name for p in found.parameters), found.values.tolist(), strict=True))
    values["delay"] -= 0.5 / RATE  # a torque that is held acts by half a period later than the line through its samples
    late = max(0.0, round(values["delay"] / PERIOD) * PERIOD)
    wide = {k: (min(low, 1.0 - MARGIN), max(high, 1.0 + MARGIN)) for k, (low, high) in found.ranges.items()}
    trained = {
        "nominal": {"arm": "strip"},
        "fitted": {"arm": str(folder / "fit/arm.toml"), "randomization": wide, "actuator": {"delay": late}},
    }
    policies = {}
    for name, own in trained.items():
        given = json.dumps({"duration": 2.5, **SEEN, **own})
        flexarm("train", "--algo", "gradient", "--seed", str(seed), "--n-timesteps", str(steps), "--no-tensorboard",
                "--no-progress", "--env-kwargs", given, "--out", str(folder / name))  # fmt: skip
        flexarm("export", str(folder / name), "--to", "c", "--out", str(folder / f"{name}.c"))
        results = []
        for k in range(FIRST, FIRST + targets):
            kwargs = {**SEEN, "actuator": {"delay": delay}}
            log = folder / f"{name}-{k}.csv"
            with served(path, 1.0 / PERIOD, log, k, **kwargs) as env:
                run_policy(InC(folder / f"{name}.c"), env, SECONDS + 0.5)
            results.append(settling(path, log, k, **kwargs))
        policies[name] = results
        print(seed, name, results, flush=True)
    fit = [(key, value, true) for (key, value), true in zip(values.items(), truth, strict=True)]
    return {"seed": seed, "fit": fit, "vaf": found.lines(), "policies": policies}


def measure(options: argparse.Namespace) -> pages.Found:
    """Repeat the experiment for several unknown arms."""
    cases = [one(options.runs / str(s), s, options.steps, options.targets) for s in range(options.seeds)]
    medians = {}
    for name in ("nominal", "fitted"):
        medians[name] = np.median(np.concatenate([case["policies"][name] for case in cases]), axis=0)
    main_ones = [(value, true) for case in cases for key, value, true in case["fit"] if key in ("EI", "payload")]
    worst = max(abs(value / true - 1.0) for value, true in main_ones)
    verdicts = {
        "EI and payload are found within 5 %": bool(worst < 0.05),
        "the policy of the fitted arm settles sooner (median)": bool(medians["fitted"][0] < medians["nominal"][0]),
    }
    return {"steps": options.steps, "cases": cases, "verdicts": verdicts}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    fits, rows = [], []
    for case in found["cases"]:
        fits.append((case["seed"], *(f"{value:.4g} ({true:.4g})" for _, value, true in case["fit"])))
        for name, results in case["policies"].items():
            values = np.array(results)
            count = f"{(values[:, 0] < SECONDS).sum()} of {len(values)}"
            middle, worst = np.median(values, axis=0), values.max(axis=0)
            times, swings = (f"{a:.3g} ({b:.3g})" for a, b in zip(middle, worst, strict=True))
            rows.append((case["seed"], name, count, times, swings))
    heads = " | ".join(key for key, *_ in found["cases"][0]["fit"])
    return {
        "fit": table(f"seed | {heads}", fits),
        "policies": table("seed | training arm | settled targets | settling time, s | residual vibration, mm", rows),
    }


if __name__ == "__main__":
    flags = {"runs": {"type": Path, "default": Path("runs/circle"), "help": "folder of logs and policies"}}
    sys.exit(pages.run("circle", __doc__, measure, blocks, packages=("stable-baselines3", "torch"), more=flags, seeds=3,
                       steps=400_000, targets=6))  # fmt: skip
