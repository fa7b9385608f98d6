"""Compare with shamilmamedov/flexible_arm, whose arm is the model for `three_dof`: docs/results/relative.md.

    python -m benchmarks.relative [--relative FOLDER --python PYTHON] [--runs FOLDER]

FOLDER contains the files of shamilmamedov/flexible_arm. PYTHON is an interpreter with CasADi and Gymnasium (3.10,
because of the dataclasses in these files). Without these flags, the recorded results of that environment are kept.
Rates are of processor time; both environments alternate in one run.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from flexarm_env import arms, control
from flexarm_env.control import load_policy
from flexarm_env.plotting import COLORS, styled_figure
from flexarm_env.training.train import Arguments, train
from flexarm_env.validation import Array

ID, LIMITS, REACH = "SpatialFlexArm-v0", np.array([20.0, 10.0, 10.0]), 1.15
ELEMENTS = (1, 3, 5, 10)
OURS: tuple[dict[str, Any], ...] = ({"elements": 2}, {"elements": 4, "dt": 1e-3, "tolerance": 1e-7})
EXACT: dict[str, Any] = {"elements": 6, "dt": 1.25e-4, "tolerance": 1e-9}
PERIODS, SHOWN = 50, (10, 20, 30, 50)
SHARE = 0.25
"""Random torques are drawn from this share of the torque limits."""

PROTOCOL = 300
"""Length of the other environment's episodes, control periods."""
NEAR, KEPT = 0.01, 3
"""Distance, m, and number of control periods within it, after which the other environment ends an episode as
reached."""
ANGLES = [(-math.pi / 2, 3 * math.pi / 2), (-math.pi / 2, math.pi / 2), (-math.pi + 0.05, math.pi - 0.05)]
"""Ranges of the joint angles, rad, of the other environment's starts and goals, in this package's convention."""
POLICIES = {"pd": 100, "zv": 100, "lqr": 100, "mpc": 20}
LEARNED = "gradients (`--algo gradient`)"


def theirs(angles: Array) -> list[float]:
    """Convert joint angles, rad, to the other environment's convention, which counts from the horizontal upwards."""
    yaw, shoulder, elbow = angles.tolist()
    return [yaw, math.pi / 2 - shoulder, -elbow]


class Relative:
    """Process that runs the other environment."""

    def __init__(self, options: argparse.Namespace) -> None:
        program = "import sys; sys.path.insert(0, sys.argv[1]); from relative_driver import main; main(sys.argv[2])"
        words = [options.python, "-c", program, str(Path(__file__).parent), str(options.relative)]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, elements: int, angles: Array, actions: Array) -> dict[str, Any]:
        """Simulate straight links at rest under actions (T, 3); return tip positions (T, 3), m, and processor time,
        s."""
        torques = (actions * LIMITS * [1.0, -1.0, -1.0]).tolist()
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps({"elements": elements, "torques": torques, "state": theirs(angles)}), file=self.process.stdin,
              flush=True)  # fmt: skip
        found: dict[str, Any] = json.loads(self.process.stdout.readline())
        return found


def started(starts: Array, targets: Array | None = None, **settings: Any) -> tuple[Any, Any]:
    """Return a vector environment whose arms start at joint angles (n, 3), rad, and the first observations."""
    env = gym.make_vec(ID, num_envs=len(starts), **settings)
    observation, _ = env.reset(seed=0)
    for i, start in enumerate(starts):
        options: dict[str, Any] = {"start": start, "reset_mask": np.arange(len(starts)) == i}
        observation, _ = env.reset(options=options if targets is None else options | {"target": targets[i]})
    return env, observation


def rates(relative: Relative) -> dict[str, float]:
    """Measure steps per second of processor time of `Pendulum-v1`, of the other simulator, and of this environment."""
    rng, found = np.random.default_rng(0), dict[str, list[float]]()
    actions = SHARE * rng.uniform(-1.0, 1.0, (PROTOCOL, 3))
    environments: dict[str, tuple[Any, int]] = {"pendulum": (gym.make("Pendulum-v1"), 1), "one": (gym.make(ID), 1)}
    environments |= {"many": (gym.make_vec(ID, num_envs=1024, threads=1), 1024)}
    for _ in range(4):
        for name, (env, n) in environments.items():
            env.reset(seed=0)
            steps, begun = 4000 if name == "pendulum" else 1500 // (15 if n > 1 else 1), time.process_time()
            for k in range(steps):
                action = actions[k % 100, : env.action_space.shape[-1]].astype(np.float32)
                outcome = env.step(action if n == 1 else np.broadcast_to(action, (n, 3)))
                if n == 1 and (outcome[2] or outcome[3]):
                    env.reset()
            found.setdefault(name, []).append(n * steps / (time.process_time() - begun))
        for n in ELEMENTS:
            count = PROTOCOL // n
            rate = count / relative.run(n, np.zeros(3), actions[:count])["cpu_s"]
            found.setdefault(str(n), []).append(rate)
    return {name: float(np.median(each[1:])) for name, each in found.items()}  # the first turn compiles


def tips(relative: Relative, episodes: int) -> list[dict[str, Any]]:
    """Return 98 % quantiles of the largest tip error up to each instant, divided by the reach, of each package.

    The reference is a converged exact beam. Each row has torques on all joints or only on shoulder and elbow.
    """
    rows, rng = list[dict[str, Any]](), np.random.default_rng(3)
    starts = rng.uniform(-1.0, 1.0, (episodes, 3)) * [1.0, 1.2, 1.2]
    for turned in (0.0, 1.0):
        actions: Any = SHARE * rng.uniform(-1.0, 1.0, (PERIODS, episodes, 3)).astype(np.float32)
        actions[..., 0] *= turned

        def own(settings: dict[str, Any], actions: Any = actions) -> Array:
            env, _ = started(starts, **settings)
            return np.array([env.step(one)[-1]["tip_position"].copy() for one in actions])

        exact = own(EXACT)
        runs = {f"flexarm_env, {one['elements']} elements": own(one) for one in OURS}
        for n in ELEMENTS:
            each = [relative.run(n, starts[i], actions[:, i])["tips"] for i in range(episodes)]
            runs[f"flexible_arm, {n} element{'s' if n > 1 else ''}"] = np.array(each).swapaxes(0, 1)
        for who, found in runs.items():
            off = np.linalg.norm(found - exact, axis=2) / REACH
            errors = np.quantile(np.maximum.accumulate(off), 0.98, axis=1).tolist()
            rows.append({"yaw": bool(turned), "who": who, "errors": errors})
    return rows


def drawn(episodes: int) -> tuple[Array, Array]:
    """Draw initial joint angles, rad, and goals, m, by the other environment's rules.

    The tip is above the ground; tip and elbow are in front of the wall.
    """
    rng, arm = np.random.default_rng(7), arms.named("three_dof")
    low, high = np.array(ANGLES).T

    def one() -> tuple[Array, Array]:
        while True:
            angles = rng.uniform(low, high)
            yaw, first, second = angles[0], angles[1], angles[1] + angles[2]
            spans = [link.span for link in arm.links]
            elbow = spans[1] * math.sin(first)
            tip = elbow + spans[2] * math.sin(second)
            rise = spans[0] + spans[1] * math.cos(first) + spans[2] * math.cos(second)
            if rise > 0.0 and min(tip * math.sin(yaw), elbow * math.sin(yaw)) > -0.14:
                return angles, np.array([tip * math.cos(yaw), tip * math.sin(yaw), rise])

    return np.array([one()[0] for _ in range(episodes)]), np.array([one()[1] for _ in range(episodes)])


def reached(name: str, episodes: int, home: Path) -> dict[str, Any]:
    """Run a policy; return the instants, s, at which the tips reach their goals, and from which they stay there."""
    starts, targets = drawn(episodes)
    env, observation = started(starts, targets)
    if name == LEARNED:
        folder = home / "gradient-relative"
        if not (folder / "policy.npz").exists():
            own = {"starts": {"angles": ANGLES, "target": ANGLES}}
            train(Arguments(algo="gradient", env=ID, env_kwargs=own, out=folder, progress=False))
        policy: Any = load_policy(folder).check(control.Setup.of(env))
    else:
        policy = control.make(name, env)
    policy.reset(observation)
    off = np.empty((PROTOCOL, episodes))
    for k in range(PROTOCOL):
        observation, *_, info = env.step(policy.act(observation))
        off[k] = np.linalg.norm(info["tip_position"] - targets, axis=1)
    found: dict[str, Any] = {"name": name, "first": [], "stays": []}
    for inside in (off < NEAR).T:
        held = np.flatnonzero(np.convolve(inside, np.ones(KEPT), "valid") == KEPT)
        outside = np.flatnonzero(~inside)
        found["first"].append(0.01 * (int(held[0]) + KEPT) if held.size else None)
        found["stays"].append(0.01 * (int(outside[-1]) + 2 if outside.size else 1) if inside[-1] else None)
    return found


def drawing(rows: list[dict[str, Any]], folder: Path) -> None:
    """Plot the errors over time: the other environment's finest model, and this environment with default settings."""
    t = 0.01 * np.arange(1, PERIODS + 1)
    with styled_figure(folder / "relative.png", 6.4, 3.6) as figure:
        axes = figure.subplots()
        for yaw, line in ((False, "--"), (True, "-")):
            for who, color in (
                (f"flexible_arm, {ELEMENTS[-1]} elements", COLORS[1]),
                ("flexarm_env, 2 elements", COLORS[0]),
            ):
                row = next(row for row in rows if row["yaw"] is yaw and row["who"] == who)
                torques = "all three joints" if yaw else "shoulder and elbow"
                axes.semilogy(t, 100.0 * np.array(row["errors"]), line, color=color, label=f"{who}: {torques}")
        axes.set(xlabel="t in s", ylabel="tip from the converged beam's, % of the reach", xlim=(0.0, t[-1]))
        axes.legend(loc="lower right")


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure rates, tip errors and policies."""
    if options.relative is None:
        found = {key: pages.kept(options.out, "relative")[key] for key in ("rates", "tips")}
    else:
        relative = Relative(options)
        found = {"rates": rates(relative), "tips": tips(relative, options.episodes)}
        relative.process.terminate()
        drawing(found["tips"], options.figures)
    return found | {"reached": [reached(name, n, options.runs) for name, n in {**POLICIES, LEARNED: 100}.items()]}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    base = found["rates"]["pendulum"]
    names = {"one": "flexarm_env, one arm", "many": "flexarm_env, 1024 arms, one thread"}
    names |= {str(n): f"flexible_arm, {n} element{'s' if n > 1 else ''} per link" for n in ELEMENTS}
    pace = [(name, f"{found['rates'][key]:,.0f}", f"{found['rates'][key] / base:.2g}") for key, name in names.items()]
    errors, turned = [], {True: "all three", False: "shoulder and elbow"}
    for row in found["tips"]:
        errors.append((turned[row["yaw"]], row["who"], *(f"{100 * row['errors'][k - 1]:.2g} %" for k in SHOWN)))
    rows = []
    for row in found["reached"]:
        cells = []
        for key in ("first", "stays"):
            late = np.array([math.inf if t is None else t for t in row[key]])
            there = np.isfinite(late)
            middle = np.median(late)
            cells += [f"{there.sum()} of {len(late)}", f"{middle:.2f} s" if math.isfinite(middle) else "–"]
        rows.append((row["name"], *cells))
    return {
        "rates": [f"In the same measurement `Pendulum-v1` runs {base:,.0f} steps per second of processor time.", "",
                  *table("environment | steps per second | relative to Pendulum-v1", pace)],
        "tips": table("torques at | program | after 0.1 s | 0.2 s | 0.3 s | 0.5 s", errors),
        "reached": table("policy | within 10 mm for 3 periods | median time | within 10 mm until the end | median "
            "start of this interval", rows),
    }  # fmt: skip


if __name__ == "__main__":
    flags: dict[str, dict[str, Any]] = {
        "relative": {"type": Path, "help": "folder of shamilmamedov/flexible_arm; default: keep the recorded results"},
        "python": {"default": "python3.10", "help": "interpreter that has CasADi"},
        "runs": {"type": Path, "default": Path("runs/relative"), "help": "folder of the trained policy"},
    }
    sys.exit(pages.run("relative", __doc__, measure, blocks, more=flags, episodes=32))
