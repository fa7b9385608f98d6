"""What derivatives cost, and how soon policies are learned by them, PPO beside: docs/results/gradients.md.

python -m benchmarks.gradients [--seeds 5] [--ppo 5] [--arms 512] [--kept] [--out FOLDER] [--runs FOLDER]

Cost: of one control period of so many arms on one thread, the least of twenty rounds. Learning: `agents.train_ppo` with
--algo gradient and ppo and the default configs, one process, one thread; processor time without imports, compilation,
evaluation and checkpoints, up to the evaluation that finds the task solved (95 % of the validation episodes). The run's
best policy is judged on the test episodes, which neither training nor the choice has seen. Finished runs are kept: a
benchmark that was stopped goes on, and with --kept they alone are told of.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import command, judged, table, told

ENVS: dict[str, dict[str, Any]] = {
    "FlexibleArm-v0": {"most": 6.0, "every": 32_768}, "TwoLinkFlexArm-v0": {"most": 40.0, "every": 65_536},
}  # fmt: skip
"""most: s of processor time within which gradients are to solve it. every: steps from one evaluation to the next."""

TEST_EPISODES = 100

JUDGED = (
    ("success at least PPO's", "success", 1.0), ("median settling at most PPO's", "settling", -1.0),
    ("mean settling at most PPO's", "settling_mean", -1.0),
)  # fmt: skip
"""Of the policies in the test episodes: what, its key, which sign is better."""

PERIODS = (1, 10, 200)
"""Of the rollouts whose gradients are compared at two tolerances."""


def costs(env_id: str, n: int) -> dict[str, Any]:
    """Processor time of a period and of its gradient, alone and in a rollout, µs an arm; bytes that a rollout keeps."""
    from flexarm_env.derivatives import Arms

    arms = Arms(env_id, n, threads=1)
    rng = np.random.default_rng(0)
    state, actions = arms.reset(seed=0), rng.uniform(-0.5, 0.5, (20, n, arms.action_size))
    for action in actions:
        state = arms.step(state, action)[0]
    weights = rng.standard_normal(state.shape), rng.standard_normal((n, arms.observation_size)), np.ones(n)
    run = arms.rollout(state, actions)
    ways = {
        "step": lambda: arms.step(state, actions[0]), "pull": lambda: arms.pull(state, actions[0], *weights),
        "rollout": lambda: arms.rollout(state, actions), "vjp": lambda: run.vjp(rewards=np.ones_like(run.rewards)),
    }  # fmt: skip
    found: dict[str, Any] = {}
    for name, do in ways.items():
        do()
        least = np.inf
        for _ in range(20):
            began = time.process_time()
            do()
            least = min(least, time.process_time() - began)
        found[name] = 1e6 * least / n / (len(actions) if name in ("rollout", "vjp") else 1)
    kept = run.states[1:], run.actions, run.observations, run.rewards, run.failed, run.past
    found["bytes"] = sum(part.nbytes for part in kept) / len(actions) / n
    arms.close()
    return {"env": env_id, **found}


def gaps(env_id: str, n: int) -> dict[str, Any]:
    """What the solver's tolerance leaves of a gradient: over so many periods, from the same starts under the same
    actions, the norm of the difference from the gradient at 1e-12, over that gradient's; the largest of n arms."""
    from flexarm_env.derivatives import Arms

    usual, sharp = (Arms(env_id, n, threads=1, **more) for more in ({}, {"tolerance": 1e-12}))
    rng = np.random.default_rng(1)
    start, found = usual.reset(seed=1), {}
    for periods in PERIODS:
        actions = 0.4 * rng.uniform(-1.0, 1.0, (periods, n, usual.action_size))
        wanted = np.zeros((periods + 1, *start.shape))
        wanted[-1, :, : usual.moving] = rng.standard_normal((n, usual.moving))
        one, other = (arms.rollout(start, actions).vjp(states=wanted).actions for arms in (usual, sharp))
        size = np.linalg.norm(other, axis=(0, 2))
        found[str(periods)] = float((np.linalg.norm(one - other, axis=(0, 2)) / size).max())
    for arms in (usual, sharp):
        arms.close()
    return {"env": env_id, "tolerance": usual.environment.plan.settings.tolerance, "gaps": found}


def learned(env_id: str, algorithm: str, seed: int, home: Path, kept: bool = False) -> dict[str, Any] | None:
    """A run, from its folder where it has finished: when it was solved, and what its policy is worth. kept: None where
    it has not finished."""
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
        words = ["--env", env_id, "--policy", str(folder), "--episodes", str(TEST_EPISODES), "--json"]
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


def verdicts(cost: list[dict[str, Any]], runs: list[dict[str, Any]]) -> dict[str, bool]:
    """What the results were to show."""
    found = {}
    for row in cost:
        found[f"{row['env']}: the gradient of a rollout costs at most 4 rollouts"] = row["vjp"] <= 4.0 * row["rollout"]
        found[f"{row['env']}: a rollout keeps at most 4 kB an arm and period"] = row["bytes"] <= 4096.0
    for env_id, wanted in ENVS.items():
        own, ppo = (_of(runs, env_id, algorithm) for algorithm in ("gradient", "ppo"))
        what = f"{env_id}: solved within {wanted['most']:g} s of processor time by every seed of {len(own)}"
        found[what] = all(row["solved_cpu_s"] is not None and row["solved_cpu_s"] <= wanted["most"] for row in own)
        for what, key, sign in JUDGED if ppo else ():
            better = [sign * (of(own, key) - of(ppo, key)) >= 0.0 for of in (_median, _mean)]
            found[f"{env_id}: {what} (medians and means of the seeds)"] = all(better)
    return found


def _of(runs: list[dict[str, Any]], env_id: str, algorithm: str) -> list[dict[str, Any]]:
    return [row for row in runs if row["env"] == env_id and row["algorithm"] == algorithm]


def _median(rows: list[dict[str, Any]], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _mean(rows: list[dict[str, Any]], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def page(found: dict[str, Any], machine: dict[str, str]) -> str:
    """The page of the results."""
    lines = [
        "# Learning by gradients", "",
        "Whether `flexarm train --algo gradient` pays beside PPO, and what derivatives cost. "
        "Written by `python -m benchmarks.gradients`, whose docstring says how; what is differentiated: "
        "[](../derivatives.md).", "", told(machine), "", "## What derivatives cost", "",
        "µs an arm and control period, in lanes on one thread; `vjp` is the gradient of a rollout of 20 periods, and "
        "comes on top of the rollout.", "",
        *table("environment | step | pull | rollout | vjp | vjp / rollout | bytes kept"),
    ]  # fmt: skip
    for row in found["cost"]:
        lines.append(f"| `{row['env']}` | " + " | ".join(f"{row[k]:.2g}" for k in
                     ("step", "pull", "rollout", "vjp"))
                     + f" | {row['vjp'] / row['rollout']:.1f} | {row['bytes']:.0f} |")  # fmt: skip
    lines += ["", "## What the solver's tolerance leaves", "",
              "Gradients over so many periods by the actions, of a random sum of the last state, at their own "
              "tolerance and at 1e-12: the norm of the difference over the gradient's, the largest of the arms.", "",
              *table("environment | tolerance | " + " | ".join(f"over {k}" for k in PERIODS))]  # fmt: skip
    for row in found["gaps"]:
        lines.append(f"| `{row['env']}` | {row['tolerance']:.0e} | " + " | ".join(f"{row['gaps'][str(k)]:.1e}"
                     for k in PERIODS) + " |")  # fmt: skip
    lines += ["", "## Learning", "",
              "Solved: 95 % of the validation episodes succeed; time is the processor's, s. Success and settling: of "
              "the best policy in the test episodes, those of [](control.md), where PPO's published policies stand "
              "(`two_link_torque` is the one without joint controllers).", ""]  # fmt: skip
    for env_id in ENVS:
        lines += [f"### {env_id}", "",
                  *table("algorithm | seed | solved after, steps | s | whole run, steps | s | success "
                         "| settling, median, s | mean, s")]  # fmt: skip
        for algorithm in ("gradient", "ppo"):
            rows = _of(found["runs"], env_id, algorithm)
            for row in rows:
                solved = ("–", "–")
                if row["solved_steps"] is not None:
                    solved = f"{row['solved_steps']:.0f}", f"{row['solved_cpu_s']:.1f}"
                lines.append(f"| {algorithm} | {row['seed']} | {solved[0]} | {solved[1]} | {row['steps']:.0f} | "
                             f"{row['cpu_s']:.1f} | {row['success']:.0%} | {row['settling']:.2f} | "
                             f"{row['settling_mean']:.2f} |")  # fmt: skip
        lines.append("")
    lines += ["## What was to be shown", "", *table("what | holds")]
    lines += [f"| {what} | {'yes' if holds else 'no'} |" for what, holds in found["verdicts"].items()]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure, train, judge, write; 1 where something that was to be shown does not hold."""
    parser = command(__doc__, seeds=5, ppo=5, arms=512)
    parser.add_argument("--runs", type=Path, default=Path("runs/gradients"), help="folder of the runs")
    parser.add_argument("--kept", action="store_true", help="tell of runs that have finished, start none")
    options = parser.parse_args(arguments)
    cost, gap = [costs(env_id, options.arms) for env_id in ENVS], [gaps(env_id, options.arms) for env_id in ENVS]
    runs = []
    for algorithm, seeds in (("gradient", options.seeds), ("ppo", options.ppo)):
        for env_id in ENVS:
            for seed in range(seeds):
                row = learned(env_id, algorithm, seed, options.runs, options.kept)
                runs += [] if row is None else [row]
                print(json.dumps(row), flush=True)
    found = {"cost": cost, "gaps": gap, "runs": runs, "verdicts": verdicts(cost, runs)}
    return judged("gradients", options.out, found, page)


if __name__ == "__main__":
    sys.exit(main())
