"""Environment steps a second, times to start, memory: docs/results/throughput.{md,json}, docs/figures/throughput.png.

    python -m benchmarks.throughput [--rounds 5] [--seconds 0.5] [--quick] [--out FOLDER]

Every case is measured once a round and all are in every round, so that ratios are of one run on one machine; the best
round counts, for others may share the machine. `Pendulum-v1` is the yardstick. Single environments are what
`gymnasium.make` gives, wrappers included; vector ones are native, autoreset steps not counted; info_level is
"standard" throughout.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import flexarm_env
from benchmarks import rates
from benchmarks.machine import command, describe_machine, publish, table, told
from flexarm_env.plotting import COLORS, FAINT, styled_figure

SIZES = (1, 16, 256, 1024, 4096)
FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")

START = """
import time, os, sys
clock = time.perf_counter()
import gymnasium, flexarm_env
imported = time.perf_counter() - clock
env = gymnasium.make(sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
print(imported, time.perf_counter() - clock)
"""
"""Import and first step, seconds."""

MEMORY = """
import resource, sys
import gymnasium, flexarm_env
env = gymnasium.make_vec(sys.argv[1], num_envs=int(sys.argv[2]))
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
def resident():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))
print(resident() / 1024, env.unwrapped.batch.block.nbytes / int(sys.argv[2]))
"""
"""Resident memory (MB) of a process, and bytes of state an environment."""


def _told(script: str, *arguments: str, room: str | None = None) -> list[float]:
    """The numbers that a script prints in a process of its own; room: where it finds the package and keeps code."""
    environment = dict(os.environ) | ({} if room is None else {"PYTHONPATH": room, "NUMBA_CACHE_DIR": f"{room}/cache"})
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(command, env=environment, cwd=room, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def starts(env_id: str) -> dict[str, float]:
    """Seconds to import, and to the end of the first step, with an empty cache of compiled code and with a full one."""
    with tempfile.TemporaryDirectory() as room:  # a copy of the package: what is kept beside it would be read too
        source, target = Path(flexarm_env.__file__).parent, Path(room, "flexarm_env")
        shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        _, cold = _told(START, env_id, room=room)
        warm = [_told(START, env_id, room=room) for _ in range(3)]
    return {"import": min(w[0] for w in warm), "cold_first_step": cold, "warm_first_step": min(w[1] for w in warm)}


def memory(env_id: str) -> dict[str, float]:
    """Resident MB of a process with 1 and with 4096 environments (the same code loaded), and bytes of state each."""
    _told(MEMORY, env_id, "4096")  # compiles
    few, _ = _told(MEMORY, env_id, "64")
    many, state = _told(MEMORY, env_id, "4096")
    return {"resident_64_mb": few, "resident_4096_mb": many, "state_bytes": state}


def error(env_id: str, formulation: str, settings: dict[str, Any]) -> str:
    """What benchmarks.choose_default has found of these settings."""
    found = json.loads((Path(__file__).parents[1] / "docs/results/default_settings.json").read_text("utf-8"))
    wanted = {"order": 2} | settings if formulation == "geometrically_exact" else settings
    wanted = {"formulation": formulation.split(",")[0], **wanted}
    row = next((r for r in found["environments"][env_id]["candidates"] if r["options"] == wanted), None)
    if row is None:
        return "not known"
    shares = [None if row[kind]["99"] is None else f"{row[kind]['99']:.3f} %" for kind in ("random", "bang_bang")]
    return ", ".join(share or f"stopped in {row['failed']} of 200" for share in shares)


def page(results: dict[str, Any]) -> str:
    """The results as Markdown."""
    rows = results["rates"]
    pendulum = next(r["steps_per_second"] for r in rows if r["case"] == "Pendulum-v1")
    lines = [
        "# Throughput",
        "",
        'Environment steps a second, compiled, `info_level="standard"`, random actions; ratios to `Pendulum-v1` of',
        "the same run. Written by `python -m benchmarks.throughput`. The settings of each formulation are the cheapest",
        "that keep the tip within 0.5 % of L for 99 % of episodes (see `default_settings.md`).",
        "", told(results["machine"]), "",
        *table("case | formulation | environments | threads | steps/s | / Pendulum-v1"),
    ]  # fmt: skip
    for r in rows:
        name = r["case"] if "formulation" not in r else r["id"]
        lines.append(
            f"| {name} ({r['api']}) | {r.get('formulation', '–')} | {r['n_envs']} | {r['threads']} "
            f"| {r['steps_per_second']:,.0f} | {r['steps_per_second'] / pendulum:.2f} |"
        )
    settings = {r["formulation"]: r["settings"] for r in rows if "formulation" in r}
    chosen = [
        (name, ", ".join(f"{k} {v:.4g}" for k, v in own.items()), *(error(env_id, name, own) for env_id in rates.IDS))
        for name, own in settings.items()
    ]
    lines += [
        "",
        f"What they leave, under random and under bang-bang torques (links of modes: up to {rates.WEAK:g} of the",
        "limits): tip error over L in 99 % of 200 episodes, from [](default_settings.md).", "",
        *table(f"formulation | settings | error, {rates.IDS[0]} | {rates.IDS[1]}", chosen), "",
    ]  # fmt: skip
    lines += table("environment | import, s | first step, empty cache, s | first step, cached, s | resident, 64, MB "
                   "| resident, 4096, MB | state an arm, bytes")  # fmt: skip
    for env_id, facts in results["starts"].items():
        m = results["memory"][env_id]
        lines.append(
            f"| {env_id} | {facts['import']:.2f} | {facts['cold_first_step']:.1f} | {facts['warm_first_step']:.2f} "
            f"| {m['resident_64_mb']:.0f} | {m['resident_4096_mb']:.0f} | {m['state_bytes']:.0f} |"
        )
    lines += [
        "",
        "Two threads over one, 1024 environments; best rounds (and medians of the rounds, as others use the machine):",
        ", ".join(f"{k} {best:.2f} ({usual:.2f})" for k, (best, usual) in speedups(results).items()) + ".",
        "Arithmetic in registers, measured in the same rounds, says how much a second thread is worth at such moments.",
        "",
    ]
    return "\n".join(lines) + "\n![Throughput](../figures/throughput.png)\n"


def speedups(results: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Rate of 1024 environments on two threads over one, best rounds and medians; and that of arithmetic alone."""
    vectors = [r for r in results["rates"] if r["n_envs"] == 1024]
    pairs = {
        f"{two['id']} {two['formulation']}": (one, two)
        for two in vectors
        for one in vectors
        if (one["threads"], two["threads"]) == (1, 2)
        and (one["id"], one["formulation"]) == (two["id"], two["formulation"])
    }
    pairs |= {"arithmetic": tuple(results["arithmetic"])}
    keys = ("steps_per_second", "steps_per_second_median")
    return {name: (two[keys[0]] / one[keys[0]], two[keys[1]] / one[keys[1]]) for name, (one, two) in pairs.items()}


def figure(results: dict[str, Any], path: Path) -> None:
    """Steps a second over the number of environments."""
    rows = results["rates"]
    pendulum = next(r["steps_per_second"] for r in rows if r["case"] == "Pendulum-v1")
    with styled_figure(path, 10.0, 4.2) as fig:
        axes = fig.subplots(1, 2, sharey=True)
        colours = dict(zip(FORMULATIONS, COLORS, strict=False))
        for axis, env_id in zip(axes, rates.IDS, strict=True):
            for (formulation, colour), threads in itertools.product(colours.items(), (1, 2)):
                points = sorted(
                    (r["n_envs"], r["steps_per_second"])
                    for r in rows
                    if r["api"] == "vector" and r["id"] == env_id and r["formulation"] == formulation
                    and r["threads"] == (threads if r["n_envs"] >= 8 * threads else 1)
                )  # fmt: skip
                if points:
                    label = f"{formulation}, {threads} thread{'s' * (threads > 1)}"
                    style = "--" if threads == 1 else "-"
                    axis.plot(*zip(*points, strict=True), style, color=colour, marker="o", ms=4, label=label)
            axis.axhline(pendulum, color=FAINT, lw=1)
            axis.annotate("Pendulum-v1, single", (4096, pendulum), xytext=(0, -4), textcoords="offset points",
                          color=FAINT, ha="right", va="top")  # fmt: skip
            for r in rows:
                if r["id"] == env_id and r["api"] == "single":
                    axis.plot([0.8], [r["steps_per_second"]], marker=">", color=colours[r["formulation"]], ms=7)
            axis.set(xscale="log", yscale="log", title=env_id, xlabel="environments")
        axes[0].set_ylabel("environment steps per second")
        fig.legend(*axes[1].get_legend_handles_labels(), ncols=3, loc="outside lower center")


def main(arguments: list[str] | None = None) -> None:
    """Measure and write the results."""
    parser = command(__doc__, rounds=5)
    parser.add_argument("--seconds", type=float, default=0.5, help="of one case in one round")
    parser.add_argument("--quick", action="store_true", help="two sizes, one formulation, no start-up and memory")
    options = parser.parse_args(arguments)
    sizes, formulations = ((16, 1024), FORMULATIONS[:1]) if options.quick else (SIZES, FORMULATIONS)
    cases = [rates.single("Pendulum-v1", "Pendulum-v1")]
    cases += [case for case in (rates.envpool_reacher(), rates.exudyn_arm()) if case is not None]
    cases += rates.own_cases(sizes, (1, 2), formulations) + rates.reduced_cases(2, 1024)
    bounds = [rates.arithmetic(threads) for threads in (1, 2)]
    rates.measure([*cases, *bounds], options.rounds, options.seconds, lambda line: print(line, flush=True))
    results: dict[str, Any] = {
        "machine": describe_machine("envpool", "exudyn"),
        "rates": [case.row() for case in cases],
        "arithmetic": [case.row() for case in bounds],
        "starts": {} if options.quick else {env_id: starts(env_id) for env_id in rates.IDS},
        "memory": {} if options.quick else {env_id: memory(env_id) for env_id in rates.IDS},
    }
    publish("throughput", options.out, results, page(results))
    figure(results, options.figures / "throughput.png")


if __name__ == "__main__":
    main(sys.argv[1:])
