"""Compare learning by gradients with PPO, and measure the effect of the tolerance: docs/results/derivatives.md.

python -m benchmarks.gradients [--seeds 5] [--ppo 5] [--arms 512] [--kept] [--only ENV ...] [--page] [--out FOLDER]
    [--runs FOLDER]

`agents.train_ppo` trains with --algo gradient and --algo ppo and the default configs, in one process with one thread.
The processor time excludes imports, compilation, evaluation and checkpoints, and ends at the evaluation in which the
task counts as solved (95 % of the validation episodes). The run's best policy is evaluated on the test episodes, which
neither training nor the selection uses. Finished runs are kept, so that an interrupted benchmark can be continued; with
--kept the page shows only these runs.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import table

ENVS: dict[str, dict[str, Any]] = {
    "FlexibleArm-v0": {"most": 6.0, "every": 32_768}, "TwoLinkFlexArm-v0": {"most": 40.0, "every": 65_536},
    "SpatialFlexArm-v0": {"most": 90.0, "ppo": 600.0, "every": 65_536},
}  # fmt: skip
"""Limits and intervals of each environment.

most: processor time, s, within which learning by gradients must solve the task. ppo: processor time, s, within which
PPO must solve it; without this key, learning by gradients must be at least as good as PPO. every: steps between
evaluations.
"""

TEST_EPISODES = 100

JUDGED = (
    ("success at least PPO's", "success", 1.0), ("median settling at most PPO's", "settling", -1.0),
    ("mean settling at most PPO's", "settling_mean", -1.0),
)  # fmt: skip
"""Compared results in the test episodes: description, key, and sign (1: larger is better, -1: smaller is better)."""

MORE: tuple[dict[str, Any], ...] = ({}, {"tolerance": 1e-12})
PERIODS = (1, 10, 200)
"""Numbers of periods of the rollouts whose gradients are compared at two solver tolerances."""


def kept_bytes(env_id: str, n: int, periods: int = 20) -> float:
    """Return the memory of a rollout, bytes per arm and period."""
    from flexarm_env.derivatives import Arms

    arms = Arms(env_id, n, threads=1)
    run = arms.rollout(arms.reset(seed=0), np.zeros((periods, n, arms.action_size)))
    parts = run.states[1:], run.actions, run.observations, run.rewards, run.failed, run.past, *run.step_ends
    arms.close()
    return sum(part.nbytes for part in parts) / periods / n


def gaps(env_id: str, n: int) -> dict[str, Any]:
    """Measure the error of a gradient that the solver's tolerance causes.

    The error is the norm of the difference from the gradient at tolerance 1e-12, over the norm of that gradient. The
    result is the largest error of n arms, for rollouts of 1, 10 and 200 periods. The gradients are those of a random
    linear function of the final states, without accelerations.
    """
    from flexarm_env.derivatives import Arms

    usual, sharp = (Arms(env_id, n, threads=1, **more) for more in MORE)
    rng = np.random.default_rng(1)
    start, found = usual.reset(seed=1), {}
    for periods in PERIODS:
        actions = 0.4 * rng.uniform(-1.0, 1.0, (periods, n, usual.action_size))
        wanted = np.zeros((periods + 1, *start.shape))
        wanted[-1, :, : usual.moving] = rng.standard_normal((n, usual.moving))
        wanted[-1, :, [name[:2] in ("a[", "b[") for name in usual.names]] = 0.0
        one, other = (arms.rollout(start, actions).vjp(states=wanted).actions for arms in (usual, sharp))
        size = np.linalg.norm(other, axis=(0, 2))
        found[str(periods)] = float(np.nanmax(np.linalg.norm(one - other, axis=(0, 2)) / size))
    for arms in (usual, sharp):
        arms.close()
    return {"env": env_id, "tolerance": usual.environment.plan.settings.tolerance, "gaps": found}


def learned(env_id: str, algorithm: str, seed: int, home: Path, kept: bool = False) -> dict[str, Any] | None:
    """Train a policy, or load a finished run; return when the task was solved, and the policy's test results.

    kept: return None if the run has not finished.
    """
    folder = home / f"{algorithm}-{env_id}-{seed}"
    record = folder / "run.json"
    there = record.exists()
    if not (there and json.loads(record.read_text())["finished"]):
        if kept:
            return None
        words = ["--algo", algorithm, "--env", env_id, "--seed", str(seed), "--out", str(folder), "--no-progress",
                 "--no-tensorboard", "--evaluate-every", str(ENVS[env_id]["every"]),
                 *(["--resume"] if there else [])]  # fmt: skip
        one = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        subprocess.run([sys.executable, "-m", "agents.train_ppo", *words], check=True, env=one)
    told_of = json.loads(record.read_text())
    judgement = folder / "judged.json"
    if not judgement.exists():
        words = ["--env", env_id, "--policy", str(folder), "--episodes", str(TEST_EPISODES), "--json",
                 "--env-kwargs", '{"rules": 1}']  # fmt: skip
        out = subprocess.run([sys.executable, "-m", "agents.evaluate", *words], check=True, stdout=subprocess.PIPE)
        judgement.write_bytes(out.stdout)
    worth = json.loads(judgement.read_text())
    solved = told_of["solved"]
    return {
        "env": env_id, "algorithm": algorithm, "seed": seed, "steps": told_of["steps"], "cpu_s": told_of["cpu_s"],
        "solved_steps": solved and solved["steps"], "solved_cpu_s": solved and solved["cpu_s"],
        "success": worth["success_rate"], "settling": worth["settling_time_median"],
        "settling_mean": worth["settling_time_mean"],
    }  # fmt: skip


def verdicts(sizes: dict[str, float], runs: list[dict[str, Any]]) -> dict[str, bool]:
    """Return the required results, and whether each one holds."""
    found = {
        f"{env_id}: a rollout stores at most 4 kB per arm and control period": size <= 4096.0
        for env_id, size in sizes.items()
    }
    for env_id, wanted in ENVS.items():
        own, ppo = (_of(runs, env_id, algorithm) for algorithm in ("gradient", "ppo"))
        limits = [("", wanted["most"], own)] + ([(" by PPO", wanted["ppo"], ppo)] if ppo and "ppo" in wanted else [])
        for by, most, rows in limits:
            what = f"{env_id}: solved{by} within {most:g} s of processor time by every seed of {len(rows)}"
            found[what] = all(row["solved_cpu_s"] is not None and row["solved_cpu_s"] <= most for row in rows)
        for what, key, sign in JUDGED if ppo and "ppo" not in wanted else ():
            mine, others = ([row[key] for row in rows] for rows in (own, ppo))
            better = [sign * (of(mine) - of(others)) >= 0.0 for of in (np.median, np.mean)]
            found[f"{env_id}: {what} (medians and means of the seeds)"] = all(better)
    return found


def _of(runs: list[dict[str, Any]], env_id: str, algorithm: str) -> list[dict[str, Any]]:
    return [row for row in runs if row["env"] == env_id and row["algorithm"] == algorithm]


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    gaps_of = [
        (f"`{row['env']}`", f"{row['tolerance']:.0e}", *(f"{row['gaps'][str(k)]:.1e}" for k in PERIODS))
        for row in found["gaps"]
    ]
    sizes = ", ".join(f"{size:.0f} bytes (`{env_id}`)" for env_id, size in found["bytes"].items())
    lines = {"bytes": [f"Per arm and control period a rollout stores {sizes}."]}
    lines["gaps"] = table(
        "environment | tolerance | " + " | ".join(f"{k} period{'s' * (k > 1)}" for k in PERIODS), gaps_of
    )
    heads = (
        "algorithm | seed | steps until solved | CPU time until solved, s | steps of the whole run | "
        "CPU time of the whole run, s | success | median settling time, s | mean settling time, s"
    )
    for env_id in ENVS:
        rows = []
        for row in (*_of(found["runs"], env_id, "gradient"), *_of(found["runs"], env_id, "ppo")):
            solved = "–", "–"
            if row["solved_steps"] is not None:
                solved = f"{row['solved_steps']:.0f}", f"{row['solved_cpu_s']:.1f}"
            worth = f"{row['success']:.0%}", f"{row['settling']:.2f}", f"{row['settling_mean']:.2f}"
            whole = f"{row['steps']:.0f}", f"{row['cpu_s']:.1f}"
            rows.append((row["algorithm"], row["seed"], *solved, *whole, *worth))
        lines[env_id] = table(heads, rows)
    return lines


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure memory and errors of gradients, train the policies, and evaluate them."""
    chosen, sizes, runs, gap = options.only or list(ENVS), dict[str, float](), list[dict[str, Any]](), list[Any]()
    looked_at = chosen if options.seeds else []
    if options.only:
        kept = pages.kept(options.out, "gradients")
        sizes = {env_id: size for env_id, size in kept["bytes"].items() if env_id not in looked_at}
        gap = [row for row in kept["gaps"] if row["env"] not in looked_at]
        anew = {"gradient": options.seeds, "ppo": options.ppo}
        runs = [row for row in kept["runs"] if row["env"] not in chosen or not anew[row["algorithm"]]]
    sizes |= {env_id: kept_bytes(env_id, options.arms) for env_id in looked_at}
    for algorithm, seeds in (("gradient", options.seeds), ("ppo", options.ppo)):
        for env_id, seed in itertools.product(chosen, range(seeds)):
            row = learned(env_id, algorithm, seed, options.runs, options.kept)
            runs += [] if row is None else [row]
            print(json.dumps(row), flush=True)
    gap += [gaps(env_id, options.arms) for env_id in looked_at]
    return {"bytes": sizes, "gaps": gap, "runs": runs, "verdicts": verdicts(sizes, runs)}


if __name__ == "__main__":
    what = "train in these environments only; the other results stay, as do those of an algorithm without seeds"
    flags: dict[str, dict[str, Any]] = {
        "runs": {"type": Path, "default": Path("runs/gradients"), "help": "folder of the runs"},
        "only": {"nargs": "+", "choices": ENVS, "help": what},
        "kept": {"action": "store_true", "help": "evaluate finished runs only, start no run"},
    }
    sys.exit(pages.run("gradients", __doc__, measure, blocks, page="results/derivatives", more=flags, seeds=5, ppo=5,
                       arms=512))  # fmt: skip
