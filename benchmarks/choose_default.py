"""Which formulation and step the environments use where nothing is said: docs/results/default_formulation.{md,json}.

python -m benchmarks.choose_default [--env ID] [--episodes 200] [--out FOLDER]

Every candidate runs the same episodes as the converged exact beam: `episodes` under a random policy (a new torque in
each control period) and as many under random bang-bang torque (full torque of either sign, switched after 0.1 to 0.6 s
at random); two links over the first 2 s only, since longer runs of theirs are chaotic. The error of an episode is the
largest distance of the tip from the exact one's, over L. A candidate is good enough where that stays within 0.5 % for
99 % of the episodes of either kind; the default is the cheapest that is. The exit code is 1 where the package's
defaults are not good enough.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import flexarm_env
from benchmarks.machine import describe_machine, write_text

Array = NDArray[np.float64]

RESULTS = Path(__file__).parents[1] / "docs" / "results"
IDS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")
HORIZON = {"FlexibleArm-v0": 4.0, "TwoLinkFlexArm-v0": 2.0}
LIMIT, AIM, SHARE = 0.5, 0.1, 99.0
"""Errors in % of L, and the percentile of the episodes that they are asked of."""

EXACT: dict[str, Any] = {
    "formulation": "geometrically_exact", "elements": 6, "order": 3, "dt": 2.5e-4, "tolerance": 1e-10,
}  # fmt: skip
COARSER = EXACT | {"elements": 4, "dt": 5e-4}
"""Checks that EXACT is converged."""


@dataclass
class Candidate:
    """Settings and what was measured of them; errors in % of L."""

    options: dict[str, Any]
    random: Array = field(default_factory=lambda: np.zeros(0))
    bang_bang: Array = field(default_factory=lambda: np.zeros(0))
    microseconds: float = float("nan")  # CPU time of one arm and control period, in a batch on one thread
    failed: int = 0

    @property
    def worst(self) -> float:
        """The larger of both kinds' percentiles."""
        return float(max(np.percentile(self.random, SHARE), np.percentile(self.bang_bang, SHARE)))

    @property
    def label(self) -> str:
        """The options in a line."""
        parts = [str(self.options.get("formulation", "default"))]
        parts += [f"{name} {value:g}" if name != "formulation" else "" for name, value in self.options.items()
                  if name != "formulation"]  # fmt: skip
        return ", ".join(part for part in parts if part)


def candidates() -> list[dict[str, Any]]:
    """Settings to be tried, besides the package's own defaults."""
    rows: list[dict[str, Any]] = [{}]
    for nodes in (4, 5, 6):
        for steps in (4, 5, 6, 8, 10):
            rows.append({"formulation": "elastica", "nodes": nodes, "dt": 0.02 / steps})
    for tolerance in (1e-3, 1e-4, 1e-5):
        rows.append({"formulation": "elastica", "nodes": 5, "dt": 0.0025, "tolerance": tolerance})
    for elements in (2, 3, 4):
        for steps in (4, 8):
            rows.append({"formulation": "geometrically_exact", "elements": elements, "dt": 0.02 / steps})
    for modes in (2, 3):
        rows.append({"formulation": "floating_frame", "modes": modes, "dt": 0.0025})
    rows.append({"formulation": "floating_frame", "segments": 4, "dt": 0.0025})
    return rows


def actions_of(env_id: str, episodes: int, joints: int) -> Array:
    """(periods, 2 episodes, joints): random torques, then random bang-bang."""
    rng = np.random.default_rng(20240611)
    periods = round(HORIZON[env_id] / 0.02)
    random = rng.uniform(-1.0, 1.0, (periods, episodes, joints))
    bang = np.zeros((periods, episodes, joints))
    for e in range(episodes):
        for j in range(joints):
            at, sign = 0, rng.choice([-1.0, 1.0])
            while at < periods:
                dwell = int(rng.integers(5, 31))
                bang[at : at + dwell, e, j] = sign
                at, sign = at + dwell, -sign
    return np.concatenate([random, bang], axis=1)


def tips(env_id: str, actions: Array, options: dict[str, Any]) -> tuple[Array, int]:
    """Tip positions (periods, episodes, 2), NaN from where an episode failed; and how many did."""
    periods, count, _ = actions.shape
    env = gym.make_vec(
        env_id, num_envs=count, autoreset_mode="NextStep", joint_limits=None, duration=100.0, **options
    )
    env.reset(seed=0)
    places = np.full((periods, count, 2), np.nan)
    alive = np.ones(count, bool)
    for k in range(periods):
        _, _, terminated, _, infos = env.step(actions[k].astype(np.float32))
        alive &= ~terminated
        places[k, alive] = infos["tip_position"][alive]
    env.close()
    return places, int((~alive).sum())


def cost(env_id: str, options: dict[str, Any], count: int = 512) -> float:
    """CPU microseconds of one arm and control period, on one thread, least of several tries."""
    env = gym.make_vec(env_id, num_envs=count, threads=1, joint_limits=None, duration=1000.0, **options)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (40, *env.action_space.shape)).astype(np.float32)
    best = float("inf")
    for _ in range(5):
        start = time.process_time()
        for action in actions:
            env.step(action)
        best = min(best, time.process_time() - start)
    env.close()
    return best / len(actions) / count * 1e6


def measure(env_id: str, episodes: int) -> tuple[list[Candidate], float]:
    """All candidates of an environment, and how far the reference is from a coarser one, in % of L."""
    joints = 1 if env_id == IDS[0] else 2
    length = gym.make(env_id).unwrapped.plan.arm.total_length  # type: ignore[attr-defined]
    actions = actions_of(env_id, episodes, joints)
    exact, _ = tips(env_id, actions, EXACT)

    def errors(places: Array) -> Array:
        distance = np.hypot(*np.moveaxis(places - exact, 2, 0)) / length * 100.0
        return np.asarray(np.where(np.isnan(distance).any(axis=0), np.inf, np.nanmax(distance, axis=0)))

    spread = float(np.percentile(errors(tips(env_id, actions, COARSER)[0]), SHARE))
    print(f"{env_id}: the reference differs from a coarser one by {spread:.4f} % of L", flush=True)
    found = []
    for options in candidates():
        places, failed = tips(env_id, actions, options)
        error = errors(places)
        row = Candidate(options, error[:episodes], error[episodes:], cost(env_id, options), failed)
        found.append(row)
        print(f"  {row.label:60s} {row.worst:9.3f} %  {row.microseconds:7.3f} us", flush=True)
    return found, spread


def table_of(env_id: str, rows: list[Candidate], spread: float, episodes: int) -> str:
    """One environment's Markdown table, cheapest first."""
    lines = [
        f"## {env_id}",
        "",
        f"{episodes} episodes of {HORIZON[env_id]:g} s of each kind. Reference: {Candidate(EXACT).label}; it differs "
        f"from {Candidate(COARSER).label} by {spread:.4f} % of L ({SHARE:g} % of the episodes).",
        "",
        f"| settings | random ({SHARE:g} %) | bang-bang ({SHARE:g} %) | failed | us an arm and period | good enough |",
        "|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda r: r.microseconds):
        parts = [f"{np.percentile(e, SHARE):.3f} %" for e in (row.random, row.bang_bang)]
        mark = "yes" if row.worst <= LIMIT else "no"
        name = f"**{row.label}** (the package's default)" if not row.options else row.label
        lines.append(f"| {name} | {parts[0]} | {parts[1]} | {row.failed} | {row.microseconds:.3f} | {mark} |")
    good = [row for row in rows if row.worst <= LIMIT and row.options]
    if good:
        lines += ["", f"The cheapest that is good enough: {min(good, key=lambda r: r.microseconds).label}."]
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the table, return 0 where the defaults are good enough."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--env", choices=IDS, action="append", help="only this environment")
    parser.add_argument("--episodes", type=int, default=200, help="of each kind (200)")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    args = parser.parse_args(arguments)
    text = [
        "# Default formulation and step",
        "",
        "Made by `python -m benchmarks.choose_default`; see its docstring for the rule. Errors are the largest tip "
        "distance from the converged exact beam in an episode, in % of L.",
        "",
    ]
    data: dict[str, Any] = {"machine": describe_machine(), "version": flexarm_env.__version__, "environments": {}}
    well = True
    for env_id in args.env or IDS:
        rows, spread = measure(env_id, args.episodes)
        text.append(table_of(env_id, rows, spread, args.episodes))
        well &= rows[0].worst <= LIMIT
        data["environments"][env_id] = {
            "reference_spread": spread,
            "candidates": [
                {
                    "options": row.options, "microseconds": row.microseconds, "failed": row.failed,
                    "random": float(np.percentile(row.random, SHARE)),
                    "bang_bang": float(np.percentile(row.bang_bang, SHARE)),
                }
                for row in rows
            ],
        }  # fmt: skip
    write_text(args.out / "default_formulation.md", "\n".join(text))
    write_text(args.out / "default_formulation.json", json.dumps(data, indent=1) + "\n")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
