"""Fit a measured two-link robot and predict its held-out motions: docs/hardware.md.

python -m benchmarks.hardware [--page] [--out FOLDER] [--figures FOLDER]     an interrupted run can be continued
"""

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import DOCS, table, write_text
from flexarm_env import arms
from flexarm_env.identification import identify, read_config, read_run, vaf
from flexarm_env.identification.fit import Problem, Solver
from flexarm_env.identification.model import Experiment
from flexarm_env.identification.report import direction, draw
from flexarm_env.plotting import styled_figure

ROOT = DOCS.parent
CONFIG = ROOT / "configs/identify/quanser_2dsfl.toml"
TRAIN, HELD = (DOCS / "hardware" / f"{name}.csv.gz" for name in ("ladder_lqr_may", "ladder_hinf_jun"))
DESIGN = "quanser_2dsfl@design"
HALF = 24.0
"""Time, s, at which the training run is split: variants are fitted to the part before and evaluated on the rest."""

SIX = ("EI_1", "EI_2", "elbow_inertia", "tau_d", "clamp_1", "clamp_2")
PULL = ("pull_x", "pull_y")
DRIVE = """
"joints[0].stiffness" = { name = "drive", low = 50.0, high = 1e4, start = 400.0 }
"joints[0].damping" = { name = "drive_damping", low = 0.0, high = 20.0, start = 0.5 }
"""
FRICTION = '"joints[0].friction_coulomb" = { name = "friction", low = 0.0, high = 2.0, start = 0.2 }\n'
VARIANTS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("six parameters (stiffnesses, elbow's inertia, tau_d, clamps)", SIX, ""),
    ("the six and a steady pull at the elbow", (*SIX, *PULL), ""),
    ("the six and a tilt of the base", (*SIX, "tilt_x", "tilt_y"), """
"gravity[0]" = { name = "tilt_x", low = -2.0, high = 2.0, start = 0.0, size = 0.1 }
"gravity[1]" = { name = "tilt_y", low = -2.0, high = 2.0, start = 0.0, size = 0.1 }
"""),
    ("six, pull, tau_d of each link", (*SIX[:3], *SIX[4:], "tau_1", "tau_2", *PULL), """
"links[0].tau_d" = { name = "tau_1", low = 1e-4, high = 0.02 }
"links[1].tau_d" = { name = "tau_2", low = 1e-4, high = 0.02 }
"""),
    ("six, pull, masses of elbow and payload", (*SIX, *PULL, "elbow", "payload"), """
"elbows[0].mass" = { name = "elbow", low = 0.5, high = 3.0 }
"payload.mass" = { name = "payload", low = 0.05, high = 0.5 }
"""),
    ("six, pull, an elastic hub drive", (*SIX, *PULL, "drive", "drive_damping"), DRIVE),
    ("six, pull, an elastic hub drive with dry friction", (*SIX, *PULL, "drive", "drive_damping", "friction"),
     DRIVE + FRICTION),
    ("six, pull, angles not filtered", (*SIX, *PULL), "unfiltered"),
)  # fmt: skip
"""Fitted variants: description, names of the fitted parameters, and lines added to the config."""


def variant(label: str, names: tuple[str, ...], more: str) -> dict[str, Any]:
    """Fit a variant to the first part of the training run.

    Return the variances accounted for (VAF), %, in this part, in the rest of the run, and in the other run.
    """
    text = CONFIG.read_text()
    text = text.replace(", low_pass = 20.0", "") if more == "unfiltered" else text + more
    arm = arms.named(DESIGN)
    if "friction" in names:
        rough = dataclasses.replace(arm.joint(0), friction_side="link")
        arm = dataclasses.replace(arm, joints=(rough, arm.joint(1)))
    config = read_config(text, arm)
    whole, other = read_run(TRAIN, config), read_run(HELD, config)
    first = dataclasses.replace(whole, kept=whole.kept & (whole.t < HALF))
    experiment = Experiment(arm, config, config.chosen(names))
    problem = Problem(experiment, [first])
    clock = time.process_time()
    found = Solver(problem).run()
    spent, values = time.process_time() - clock, problem.values(found.z)

    def explained(run: Any, kept: Any) -> list[float]:
        readings = experiment.predict(experiment.elsewhere(values) if run is other else values, run)
        return [vaf(run.outputs[c.name][kept], readings[c.name][kept]) for c in config.outputs]

    return {
        "label": label, "values": dict(zip(names, values.tolist(), strict=True)), "cpu_seconds": spent,
        "evaluations": found.evaluations, "runs": found.runs, "first": explained(whole, first.kept),
        "rest": explained(whole, whole.kept & (whole.t >= HALF)), "other": explained(other, other.kept),
    }  # fmt: skip


def measure(options: argparse.Namespace) -> pages.Found:
    """Fit all variants and the final arm; plot its predictions."""
    variants = pages.begun(options.out, "hardware").get("variants", [])
    done = {v["label"] for v in variants}
    for label, names, more in VARIANTS[: options.variants]:
        if label not in done:
            variants.append(variant(label, names, more))
            write_text(options.out / "hardware.json", json.dumps({"variants": variants}))
            print(label, {k: np.round(variants[-1][k], 2).tolist() for k in ("first", "rest", "other")}, flush=True)
    found = identify(DESIGN, CONFIG, [TRAIN], hold_out=[HELD], out=options.fit)
    runs, n, worth = (*found.train, *found.held_out), len(found.train), found.uncertainty
    for row in runs:
        with styled_figure(options.figures / f"hardware_{row.run.stem}.png", 9.0, 5.6) as figure:
            draw(row, figure.subplots(4, 1, sharex=True, height_ratios=[2, 1, 2, 1]))
    fitted = zip(found.parameters, found.start, found.values, worth.half, strict=True)
    seen = [r for rings in found.seen.values() for r in rings if r.error < 0.3]
    quick, damped = [r.frequency for r in seen], float(np.median([r.damping for r in seen]))
    return {
        "variants": variants, "lines": found.lines(), "condition": worth.condition,
        "parameters": [
            (p.path, float(a), float(x), float(h), p.name not in worth.unidentifiable) for p, a, x, h in fitted
        ],
        "blind": [direction(blind) for blind in worth.directions],
        "runs": [
            (row.run.stem, "training" if i < n else "held out",
             *([*of.vaf.values()] for of in (row, found.unfitted[i], found.baseline[i])), [*row.nrmse.values()])
            for i, row in enumerate(runs)
        ],
        "frequencies": [*zip(found.frequencies[:2], found.damping, strict=False)], "seen": {
            "frequency": float(np.median(quick)), "damping": damped, "count": len(seen), "least": min(quick),
            "most": max(quick),
        },
        "oscillators": [*found.oscillators.values()],
    }  # fmt: skip


def two(values: Any) -> str:
    """Format percentages with one decimal, as in "95.1 / 93.7"."""
    return " / ".join(f"{value:.1f}" for value in values)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows = [
        (f"`{path}`", f"{a:.4g}", f"{x:.4g}", f"± {half:.2g}", "yes" if told_of else "no")
        for path, a, x, half, told_of in found["parameters"]
    ]
    head = "Combinations that hardly affect the outputs, relative to each parameter's size"
    blind = [f"{head}: {one}." for one in found["blind"]]
    judged = [(f"`{stem}`", kind, *map(two, values)) for stem, kind, *values in found["runs"]]
    variants = [(v["label"], *(two(v[key]) for key in ("first", "rest", "other"))) for v in found["variants"]]
    seen = found["seen"]
    at_rest = f"median of {seen['count']} intervals, {seen['least']:.2f} to {seen['most']:.2f}"
    modes = [
        *(("fitted arm, both motors held", *pair) for pair in found["frequencies"]),
        (f"robot with its joints at rest ({at_rest})", seen["frequency"], seen["damping"]),
        *((f"oscillator {k} of the baseline", *pair) for k, pair in enumerate(found["oscillators"], 1)),
    ]
    vibrations = [(label, f"{frequency:.2f}", f"{ratio:.3f}") for label, frequency, ratio in modes]
    return {
        "fit": table("parameter | initial | fitted | 95 % interval | determined by the log", rows),
        "condition": [
            f"The Jacobian of the residuals by the parameters has the condition number {found['condition']:.3g}.",
            *blind,
        ],
        "prediction": table("run | use | fitted | vendor | baseline | NRMSE", judged),
        "variants": table("fitted parameters | first 24 s | rest | `ladder_hinf_jun`", variants),
        "frequencies": table("vibration | frequency, Hz | damping ratio", vibrations),
    }  # fmt: skip


if __name__ == "__main__":
    flags = {"fit": {"type": Path, "default": ROOT / "runs/hardware", "help": "folder of the fit and its arm.toml"}}
    sys.exit(pages.run("hardware", __doc__, measure, blocks, page="hardware", packages=("scipy",), more=flags,
                       variants=len(VARIANTS)))  # fmt: skip
