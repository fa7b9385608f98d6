"""What derivatives cost, for every kind of arm: docs/results/derivatives.md.

    python -m benchmarks.derivatives [--arms 256] [--only WORDS ...] [--out FOLDER]

Processor time on one thread, in microseconds an arm and control period, the least of many rounds in which what is
compared takes turns: a rollout of 10 periods, the gradient of its rewards (which comes on top), the Jacobians of a
period, and linear models where they are compiled. Each kind is measured in a process of its own; --only: those whose
names have one of the words, while the rows of the others stay as they are in the folder.
"""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.machine import command, judged, table, told
from flexarm_env import arms as arms_by_name
from flexarm_env.derivatives import Arms

PERIODS, SECONDS = 10, 4.0
MOST = 4.0
"""Rollouts that a gradient may cost."""


def _geared(links: int, friction: bool) -> dict[str, Any]:
    arm = arms_by_name.named("strip_geared" if links == 1 else "two_link_geared")
    if not friction:
        smooth = tuple(dataclasses.replace(joint, friction_coulomb=0.0) for joint in arm.joints)
        arm = dataclasses.replace(arm, joints=smooth)
    return {"arm": arm}


KINDS: dict[str, Callable[[int], dict[str, Any]]] = {
    "elastica": lambda links: {},
    "elastica, randomised": lambda links: {"randomization": {"payload": (0.5, 1.5), "EI": (0.8, 1.2)}},
    "elastica, motors": lambda links: {"actuator": {"lag": 0.01, "delay": 0.02}},
    "elastica, gears": lambda links: _geared(links, False),
    "elastica, gears and friction": lambda links: _geared(links, True),
    "exact beam": lambda links: {"formulation": "geometrically_exact"},
    "floating frame": lambda links: {"formulation": "floating_frame"},
    "floating frame, modes": lambda links: {"formulation": "floating_frame", "modes": 2, "segments": 1},
}
"""Keywords of the environments, by the number of links."""

IDS = {1: "FlexibleArm-v0", 2: "TwoLinkFlexArm-v0"}


def least(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """The least processor time of each call, s, in turns."""
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
    """A row of the table."""
    keywords = KINDS[kind](links)
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


def page(found: dict[str, Any], machine: dict[str, str]) -> str:
    """The page of the results."""
    lines = [
        "# What derivatives cost", "",
        "What the gradient of a rollout and the Jacobians of a period cost, for every kind of arm. Written by "
        "`python -m benchmarks.derivatives`, whose docstring says how; what is differentiated: "
        "[](../derivatives.md).", "",
        told(machine), "",
        f"µs an arm and control period, {found['arms']} arms in lanes on one thread. `vjp` is the gradient of a "
        f"rollout of {PERIODS} periods and comes on top of the rollout; backwards: with kernels of its own, elsewhere "
        "through the Jacobians, a column for each number that moves.", "",
        *table(
            "arm | links | numbers that move | rollout | vjp | vjp / rollout | backwards | Jacobians | linear model"
        ),
    ]  # fmt: skip
    for row in found["rows"]:
        linear = f"{row['linearize']:.3g}" if "linearize" in row else "–"
        lines.append(
            f"| {row['kind']} | {row['links']} | {row['moving']} | {row['rollout']:.2g} | {row['vjp']:.3g} | "
            f"{row['vjp'] / row['rollout']:.1f} | {'yes' if row['backwards'] else 'no'} | {row['jacobians']:.3g} | "
            f"{linear} |"
        )
    lines += ["", "## What was to be shown", "", *table("what | holds")]
    lines += [f"| {what} | {'yes' if holds else 'no'} |" for what, holds in found["verdicts"].items()]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; 1 where something that was to be shown does not hold."""
    parser = command(__doc__, arms=256)
    parser.add_argument("--only", nargs="+", default=[""], help="words of the kinds' names")
    parser.add_argument("--one", nargs=2, metavar=("KIND", "LINKS"), help="print one row, as JSON")
    given = parser.parse_args(arguments)
    if given.one:
        print(json.dumps(measure(given.one[0], int(given.one[1]), given.arms)))
        return 0
    known = given.out / "derivatives.json"
    kept = json.loads(known.read_text(encoding="utf-8"))["rows"] if given.only != [""] and known.exists() else []
    rows = []
    for kind in KINDS:
        for links in IDS:
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
    return judged("derivatives", given.out, {"arms": given.arms, "rows": rows, "verdicts": verdicts}, page)


if __name__ == "__main__":
    sys.exit(main())
