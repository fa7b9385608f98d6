"""Do the 95 % intervals of `flexarm identify` hold, is what cannot be told named: docs/results/identification.md.

python -m benchmarks.identification [--cases N] [--page] [--out FOLDER]     stopped, it goes on where it was

Each case draws a strip (EI, payload and tau_d within 8 % of the usual ones), a smooth hub motion of nine sines and 1 %
of white noise on a filtered, offset strain gauge. Three parameters are fitted from the usual strip; then the mass per
length as well, of which with the hub's angle prescribed only ratios to stiffness and payload show.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import table, write_text
from flexarm_env import arms
from flexarm_env.identification.config import read_config
from flexarm_env.identification.fit import Problem, Solver
from flexarm_env.identification.log import Run
from flexarm_env.identification.model import Experiment
from flexarm_env.identification.uncertainty import uncertainty

CASES = 100
CONFIG = """
skip = 0.3
starts = 2
[inputs]
joint0 = "hub"
[outputs]
strain_gauge_1 = "strain"
[sensors]
strain_gauges = [{ gain = 0.3, low_pass = { frequency = 20.0, order = 2 } }]
[solver]
nodes = 4
dt = 0.005
[parameters]
"links[0].section.EI" = { name = "EI", low = 1.0, high = 30.0 }
"payload.mass" = { name = "payload", low = 0.01, high = 1.0 }
"tau_d" = { name = "tau_d", low = 1e-5, high = 0.05 }
"links[0].section.m" = { name = "m", low = 0.05, high = 1.0 }
"""
TOLD, RATIOS = ("EI", "payload", "tau_d"), ("EI", "payload", "m")


def case(seed: int) -> dict[str, Any]:
    """Whether each interval holds the truth, and what is named as not told."""
    rng, t = np.random.default_rng(seed), np.arange(401) / 100
    arm = arms.named("strip")
    config = read_config(CONFIG, arm)
    waves = zip(rng.normal(0, 1, 9), np.linspace(4, 65, 9) + rng.uniform(-2, 2, 9), rng.uniform(0, 6, 9), strict=True)
    hub = np.minimum(t, 1.0) ** 3 * sum(a * np.sin(w * t + p) / w for a, w, p in waves)
    experiment = Experiment(arm, config, config.chosen(TOLD))
    truth = experiment.start * rng.uniform(0.92, 1.08, 3)
    silent = Run("case", t, {"joint0": hub}, {"strain_gauge_1": t}, t >= config.skip)
    strain = experiment.predict(truth, silent)["strain_gauge_1"]
    strain = strain + 0.01 * strain.std() * rng.normal(size=len(t)) + rng.normal()
    run = dataclasses.replace(silent, outputs={"strain_gauge_1": strain})
    problem = Problem(experiment, [run])
    found = Solver(problem).run()
    worth = uncertainty(problem, found.z)
    values = problem.values(found.z)
    wide = dataclasses.replace(config, starts=1, evaluations=8)
    usual = experiment.arm_of(values)
    both = Problem(Experiment(usual, wide, wide.chosen((*TOLD, "m"))), [run])
    named = uncertainty(both, Solver(both).run().z).unidentifiable
    return {
        "seed": seed,
        "holds": dict(zip(TOLD, (np.abs(values - truth) < worth.half).tolist(), strict=True)),
        "width": dict(zip(TOLD, (worth.half / values).tolist(), strict=True)),
        "error": dict(zip(TOLD, (values / truth - 1.0).tolist(), strict=True)),
        "untold": list(worth.unidentifiable), "named": list(named),
    }  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """How many of the cases hold, for each parameter."""
    rows, summary = found["cases"], []
    for name in TOLD:
        held = sum(row["holds"][name] for row in rows)
        width = float(np.median([row["width"][name] for row in rows]))
        error = float(np.median([abs(row["error"][name]) for row in rows]))
        summary.append((f"`{name}`", f"{held} of {len(rows)}", f"{100 * width:.2g} %", f"{100 * error:.2g} %"))
    right = sum(set(row["named"]) == set(RATIOS) for row in rows)
    rash = sum(bool(row["untold"]) for row in rows)
    heads = "parameter | truth within its 95 % interval | half width, median | error, median"
    return {
        "intervals": table(heads, summary, True),
        "untold": [f"All three in {right} of {len(rows)} cases; one of those that the log does tell in {rash}."],
    }


def measure(options: argparse.Namespace) -> pages.Found:
    """All cases that are not in the record."""
    kept = options.out / "identification.json"
    rows = json.loads(kept.read_text())["cases"] if kept.is_file() else []
    clock = time.perf_counter()
    for seed in range(len(rows), options.cases):
        rows.append(case(seed))
        write_text(kept, json.dumps({"cases": rows}, indent=1) + "\n")
        print(f"case {seed + 1} of {options.cases}, {time.perf_counter() - clock:.0f} s", flush=True)
    return {"cases": rows}


if __name__ == "__main__":
    sys.exit(pages.run("identification", __doc__, measure, blocks, packages=("scipy",), cases=CASES))
