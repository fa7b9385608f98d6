"""Measure environment steps per second and memory: docs/results/throughput.{md,json}, docs/figures/throughput.png.

    python -m benchmarks.throughput [--rounds 5] [--seconds 0.5] [--quick] [--page] [--out FOLDER]

Every case is measured once in each round, so that ratios are of one run on one machine. The best round counts, because
other programs may use the machine too. `Pendulum-v1` is measured for comparison. Single environments are those of
`gymnasium.make`, wrappers included. Vector environments are native, and autoreset steps are not counted. info_level is
"standard" throughout. `benchmarks.suite_speed` writes the part on the suite's tasks.
"""

import argparse
import itertools
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks import pages, rates
from benchmarks.machine import DOCS, table
from flexarm_env.plotting import COLORS, FAINT, styled_figure

SIZES = (1, 16, 256, 1024, 4096)
FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")

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
"""Program that prints the resident memory of its process, MB, and the bytes of state per environment."""


def memory(env_id: str) -> dict[str, float]:
    """Return the memory, MB, of a process with 64 and with 4096 environments, and the bytes of state per
    environment."""

    def resident(n: int) -> list[float]:
        done = subprocess.run(
            [sys.executable, "-c", MEMORY, env_id, str(n)], capture_output=True, text=True, check=True
        )
        return [float(word) for word in done.stdout.split()]

    resident(4096)  # compiles
    few, many = resident(64), resident(4096)
    return {"resident_64_mb": few[0], "resident_4096_mb": many[0], "state_bytes": many[1]}


def error(env_id: str, formulation: str, settings: dict[str, Any]) -> str:
    """Return the tip errors of the timed settings from the results of `benchmarks.choose_default`."""
    found = pages.kept(DOCS / "results", "default_settings")
    wanted = {"order": 2} | settings if formulation == "geometrically_exact" else settings
    wanted = {"formulation": formulation.split(",")[0], **wanted}
    row = next((r for r in found["environments"][env_id]["candidates"] if r["options"] == wanted), None)
    if row is None:
        return "not known"
    shares = [None if row[kind]["99"] is None else f"{row[kind]['99']:.3f} %" for kind in ("random", "bang_bang")]
    return ", ".join(share or f"stopped in {row['failed']} of 200" for share in shares)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows = found["rates"]
    pendulum = next(r["steps_per_second"] for r in rows if r["case"] == "Pendulum-v1")
    rated = [
        (f"{r['case'] if 'formulation' not in r else r['id']} ({r['api']})", r.get("formulation", "–"), r["n_envs"],
         r["threads"], f"{r['steps_per_second']:,.0f}", f"{r['steps_per_second'] / pendulum:.2f}")
        for r in rows
    ]  # fmt: skip
    settings = {r["formulation"]: r["settings"] for r in rows if "formulation" in r}
    chosen = [
        (name, ", ".join(f"{k} {v:.4g}" for k, v in own.items()), *(error(env_id, name, own) for env_id in rates.IDS))
        for name, own in settings.items()
    ]
    sizes = [
        (env_id, f"{m['resident_64_mb']:.0f}", f"{m['resident_4096_mb']:.0f}", f"{m['state_bytes']:.0f}")
        for env_id, m in found["memory"].items()
    ]
    gains = [(name, f"{best:.2f}", f"{usual:.2f}") for name, (best, usual) in speedups(found).items()]
    return {
        "rates": table("case | formulation | environments | threads | steps/s | relative to Pendulum-v1", rated),
        "errors": table(f"formulation | settings | error, {rates.IDS[0]} | {rates.IDS[1]}", chosen),
        "memory": table(
            "environment | resident memory with 64 arms, MB | with 4096 arms, MB | state per arm, bytes", sizes
        ),
        "threads": table("case | speedup by a second thread, best rounds | median of all rounds", gains),
    }


def speedups(results: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the speedup of two threads for 1024 environments and for register arithmetic: best and median rounds."""
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
    """Plot steps per second over the number of environments."""
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


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure the rates of all cases alternately, and the memory."""
    sizes, formulations = ((16, 1024), FORMULATIONS[:1]) if options.quick else (SIZES, FORMULATIONS)
    cases = [rates.single("Pendulum-v1", "Pendulum-v1")]
    cases += [case for case in (rates.envpool_reacher(), rates.exudyn_arm()) if case is not None]
    cases += rates.own_cases(sizes, (1, 2), formulations) + rates.reduced_cases(2, 1024)
    bounds = [rates.arithmetic(threads) for threads in (1, 2)]
    rates.measure([*cases, *bounds], options.rounds, options.seconds, lambda line: print(line, flush=True))
    found: pages.Found = {
        "rates": [case.row() for case in cases], "arithmetic": [case.row() for case in bounds],
        "memory": {} if options.quick else {env_id: memory(env_id) for env_id in rates.IDS},
    }  # fmt: skip
    figure(found, options.figures / "throughput.png")
    return found


if __name__ == "__main__":
    flags: dict[str, dict[str, Any]] = {
        "seconds": {"type": float, "default": 0.5, "help": "duration of a case in a round, s"},
        "quick": {"action": "store_true", "help": "two sizes, one formulation, no memory"},
    }
    sys.exit(pages.run("throughput", __doc__, measure, blocks, packages=("envpool", "exudyn"), more=flags, rounds=5))
