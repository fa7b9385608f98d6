"""Measure the cost of derivatives for every kind of arm: docs/results/derivatives.md.

    python -m benchmarks.derivatives [--arms 256] [--only WORDS ...] [--page] [--out FOLDER]

The numbers are processor times on one thread, in microseconds per arm and control period. The numbers are minima over
many rounds in which the compared computations alternate. The computations are a rollout of 10 periods, the gradient of
its rewards (in addition to the rollout), the Jacobians of a period, and linear models where these are compiled. Each
kind of arm is measured in its own process. --only: kinds whose names contain one of the words; the others keep their
rows in the folder.
"""

import argparse
import dataclasses
import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.bits_cases import geared
from benchmarks.machine import table
from flexarm_env import arms as arms_by_name
from flexarm_env.derivatives import Arms

PERIODS, SECONDS = 10, 4.0
MOST = 4.0
"""Largest allowed cost of a gradient, in costs of a rollout."""


KINDS: dict[str, Callable[[int], dict[str, Any]]] = {
    "elastica": lambda links: {},
    "elastica, randomised": lambda links: {"randomization": {"payload": (0.5, 1.5), "EI": (0.8, 1.2)}},
    "elastica, motors": lambda links: {"actuator": {"lag": 0.01, "delay": 0.02}},
    "elastica, gears": lambda links: {"arm": geared(links, friction_coulomb=0.0)},
    "elastica, gears and friction": lambda links: {"arm": geared(links)},
    "exact beam": lambda links: {"formulation": "geometrically_exact"},
    "floating frame": lambda links: {"formulation": "floating_frame"},
    "floating frame, modes": lambda links: {"formulation": "floating_frame", "modes": 2, "segments": 1},
}
"""Functions that return an environment's keywords from its number of links."""

GEAR = geared(2, friction_coulomb=0.0).joints[0]
IDS = {1: "FlexibleArm-v0", 2: "TwoLinkFlexArm-v0", 3: "SpatialFlexArm-v0"}
SPACE: dict[str, Callable[[int], dict[str, Any]]] = {
    "in space": lambda links: {},
    "in space, randomised": lambda links: {"randomization": {"EI": (0.8, 1.2), "GJ": (0.8, 1.2)}},
    "in space, motors": lambda links: {"actuator": {"lag": 0.01, "delay": 0.02}},
    "in space, gears": lambda links: {
        "arm": dataclasses.replace(arms_by_name.named("three_dof"), joints=(GEAR,) * 3), "elements": 2, "dt": 0.0025,
    },
}
CASES = [*itertools.product(KINDS, (1, 2)), *itertools.product(SPACE, (3,))]
"""Kinds of arms with the numbers of links that are measured."""


def least(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the smallest processor time of each call, s; the calls alternate."""
    found, began = dict.fromkeys(calls, np.inf), time.process_time()
    for _ in range(100):
        for name, call in calls.items():
            start = time.process_time()
            call()
            found[name] = min(found[name], time.process_time() - start)
        if time.process_time() - began > SECONDS:
            break
    return found


def measure(kind: str, links: int, n: int) -> dict[str, Any]:
    """Measure one kind of arm: µs per arm and control period of rollout, gradient, Jacobians and linear model."""
    keywords = {**KINDS, **SPACE}[kind](links)
    arms, rng = Arms(IDS[links], n, threads=1, **keywords), np.random.default_rng(0)
    state = arms.reset(seed=0)
    actions = rng.uniform(-0.5, 0.5, (PERIODS, n, arms.action_size))
    run = arms.rollout(state, actions)
    calls: dict[str, Callable[[], Any]] = {
        "rollout": lambda: arms.rollout(state, actions),
        "vjp": lambda: run.vjp(rewards=np.ones((PERIODS, n))),
        "jacobians": lambda: arms.jacobians(run.states[3], actions[3]),
    }
    if kind == "elastica":
        other: Any = gym.make_vec(IDS[links], num_envs=n, vectorization_mode="vector_entry_point", threads=1).unwrapped
        other.reset(seed=0)
        calls["linearize"] = lambda: other.linearize(discrete=0.02)
    for call in calls.values():
        call()
    times = least(calls)
    periods = {"rollout": PERIODS, "vjp": PERIODS}
    return {
        "kind": kind, "links": links, "moving": arms.moving, "backwards": arms.backwards,
        **{name: 1e6 * t / n / periods.get(name, 1) for name, t in times.items()},
    }  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    rows = [
        (row["kind"], row["links"], row["moving"], f"{row['rollout']:.2g}", f"{row['vjp']:.3g}",
         f"{row['vjp'] / row['rollout']:.1f}", "yes" if row["backwards"] else "no", f"{row['jacobians']:.3g}",
         f"{row['linearize']:.3g}" if "linearize" in row else "–")
        for row in found["rows"]
    ]  # fmt: skip
    heads = (
        "arm | links | changing state variables | rollout, µs | vjp, µs | vjp / rollout | reverse mode | "
        "Jacobians, µs | linear model, µs"
    )
    arms = f"Each row is measured with {found['arms']} arms, which are computed together in vector lanes on one thread."
    return {"costs": [arms, "", *table(heads, rows)]}


def measured(given: argparse.Namespace) -> pages.Found:
    """Measure the requested kinds, each in its own process; other kinds keep their recorded rows."""
    kept, rows = [] if given.only == [""] else pages.kept(given.out, "derivatives").get("rows", []), []
    for kind, links in CASES:
        if not any(word in kind for word in given.only):
            rows += [row for row in kept if (row["kind"], row["links"]) == (kind, links)]
        else:
            words = [sys.executable, "-m", "benchmarks.derivatives", "--arms", str(given.arms), "--one", kind]
            out = subprocess.run([*words, str(links)], check=True, stdout=subprocess.PIPE, text=True).stdout
            rows.append(json.loads(out.splitlines()[-1]))
            print(out.splitlines()[-1], file=sys.stderr, flush=True)
    verdicts = {
        f"{row['kind']}, {row['links']} link{'s' * (row['links'] > 1)}: the gradient of a rollout costs at most "
        f"{MOST:g} rollouts": row["vjp"] <= MOST * row["rollout"]
        for row in rows
    }
    return {"arms": given.arms, "rows": rows, "verdicts": verdicts}


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write the page; the exit code is 1 if a gradient costs more than `MOST` rollouts."""
    words = sys.argv[1:] if arguments is None else arguments
    if "--one" in words:  # a row, as JSON, from a process of its own
        kind, links = words[words.index("--one") + 1 :]
        print(json.dumps(measure(kind, int(links), int(words[words.index("--arms") + 1]))))
        return 0
    flags = {"only": {"nargs": "+", "default": [""], "help": "only kinds whose names contain one of the words"}}
    return pages.run("derivatives", __doc__, measured, blocks, words, more=flags, arms=256)


if __name__ == "__main__":
    sys.exit(main())
