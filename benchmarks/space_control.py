"""Measure how soon controllers settle `SpatialFlexArm-v0`, on 100 reaches: docs/environments/spatial_results.md."""

import argparse
import sys
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import DOCS, table
from flexarm_env import control, suite
from flexarm_env.episodes import Actions, History, play
from flexarm_env.suite import best

GAUGES = [{"link": k, "measures": what} for k in (1, 2) for what in ("xy", "xz", "torsion")]
MEASURED: dict[str, Any] = {
    "observation": "measured", "sensors": {"encoders": {"counts": 2**16}, "strain_gauges": GAUGES},
}  # fmt: skip
FIRST = 50
"""Number of reaches for `mpc`, whose reaches take hundreds of times as long as those of other controllers."""

BEST = "best known"
"""Name of the recorded best torques of `space-reach-v1`, which has the same episodes; they are played without
feedback."""

HOLD = 50
"""Number of control periods that the tip must rest at the target."""


def settled(name: str, episodes: int, seed: int, **keywords: Any) -> list[float | None]:
    """Return the times, s, from which the tips rest at their targets for 0.5 s; None for an episode without success."""
    env = gym.make_vec("SpatialFlexArm-v0", num_envs=episodes, **keywords)
    known = best.record(suite.task("space-reach-v1")).actions[:, :episodes]
    controller: Any = Actions(known) if name == BEST else control.make(name, env)
    history = History("is_success")
    play(env, controller, range(seed, seed + episodes), [history])
    good = history.info("is_success")
    return [0.01 * (int(one.argmax()) - HOLD) if one.any() else None for one in good.T]


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure the settling times of each controller on the same reaches."""
    cases: dict[str, dict[str, Any]] = {"pd": {}, "zv": {}, "zvd": {}, "lqr": {}, "lqg": MEASURED, "mpc": {}, BEST: {}}
    counts = {name: min(options.episodes, FIRST) if name == "mpc" else options.episodes for name in cases}
    return {"times": {name: settled(name, counts[name], 10_000, **more) for name, more in cases.items()}}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows = []
    for name, times in found["times"].items():
        known = [t for t in times if t is not None]
        late = np.sort([np.inf if t is None else t for t in times])[[len(times) // 2, int(0.95 * len(times))]]
        rows.append((name, f"{len(known)} of {len(times)}", *(f"{t:.2f} s" for t in late)))
    learned = pages.kept(DOCS / "results", "gradients")["runs"]
    runs = [
        (row["algorithm"], row["seed"], f"{row['steps'] / 1e6:.1f} million", f"{row['solved_cpu_s']:.0f} s",
         f"{row['success']:.0%}", f"{row['settling']:.2f} s")
        for row in learned if row["env"] == "SpatialFlexArm-v0"
    ]  # fmt: skip
    settled = "controller | settled episodes | median settling time | 95th percentile"
    learning = "algorithm | seed | steps | CPU time until 95 % of validation episodes settle | success | "
    return {"settled": table(settled, rows), "learned": table(learning + "median settling time", runs)}


if __name__ == "__main__":
    sys.exit(pages.run("space_control", __doc__, measure, blocks, page="environments/spatial_results", episodes=100))
