"""A measured two-link robot, its fit and its held-out prediction: docs/hardware.md.

python -m benchmarks.hardware [--out FOLDER] [--figures FOLDER]     stopped, it goes on where it was
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import DOCS, command, describe_machine, publish, table, told, write_text
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
"""s: variants are fitted to the training run up to here, and judged by the rest of it."""

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
"""What is told of them, what is fitted, what is added to the config."""


def variant(label: str, names: tuple[str, ...], more: str) -> dict[str, Any]:
    """A fit to the first part of the training run: VAF there, in the rest of it, and in the other run."""
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


def main(arguments: list[str] | None = None) -> None:
    """Fit all, draw, and write the page."""
    parser = command(__doc__, variants=len(VARIANTS))
    parser.set_defaults(out=DOCS)
    parser.add_argument("--fit", type=Path, default=ROOT / "runs/hardware", help="folder of the fit and its arm.toml")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "hardware.json"
    variants = json.loads(kept.read_text())["variants"] if kept.is_file() else []
    done = {v["label"] for v in variants}
    for label, names, more in VARIANTS[: options.variants]:
        if label not in done:
            variants.append(variant(label, names, more))
            write_text(kept, json.dumps({"variants": variants}))
            print(label, {k: np.round(variants[-1][k], 2).tolist() for k in ("first", "rest", "other")}, flush=True)
    found = identify(DESIGN, CONFIG, [TRAIN], hold_out=[HELD], out=options.fit)
    for row in (*found.train, *found.held_out):
        with styled_figure(options.figures / f"hardware_{row.run.stem}.png", 9.0, 5.6) as figure:
            draw(row, figure.subplots(4, 1, sharex=True, height_ratios=[2, 1, 2, 1]))
    machine = describe_machine("scipy")
    content = {"machine": machine, "variants": variants, "lines": found.lines()}
    publish("hardware", options.out, content, page(found, variants, machine))


def two(values: Any) -> str:
    """ "95.1 / 93.7"."""
    return " / ".join(f"{value:.1f}" for value in values)


def page(found: Any, variants: list[dict[str, Any]], machine: dict[str, str]) -> str:
    """Markdown of what was found."""
    n, worth = len(found.train), found.uncertainty
    rows = [
        (f"`{p.path}`", f"{a:.4g}", f"{x:.4g}", f"± {h:.2g}", "no" if p.name in worth.untold else "yes")
        for p, a, x, h in zip(found.parameters, found.start, found.values, worth.half, strict=True)
    ]
    judged = []
    for i, row in enumerate((*found.train, *found.held_out)):
        every = (row, found.unfitted[i], found.baseline[i])
        judged.append((f"`{row.run.stem}`", "training" if i < n else "held out",
                       *(two(of.vaf.values()) for of in every), two(row.nrmse.values())))  # fmt: skip
    seen = [r for rings in found.seen.values() for r in rings if r.error < 0.3]
    lines = [
        ABOUT, "This page is written by `python -m benchmarks.hardware`.", "", told(machine), "", MEASURED,
        "## The fit", "",
        f"Parameters are fitted to `ladder_lqr_may` alone, from `{DESIGN}` (the vendor's and assumed numbers); before:",
        "where the fit begins, which for the clamps is no number of the design.", "",
        *table("parameter | before | fitted | 95 % interval | told by the log", rows), "",
        f"Condition of the derivatives {worth.condition:.3g}. Prescribed angles tell stiffness over inertia alone:",
        "masses are the vendor's, and all stiffnesses are in proportion to them.", "",
    ]  # fmt: skip
    for blind in worth.directions:
        lines += [f"Changes of {direction(blind)}, in shares of each one's size, hardly show.", ""]
    lines += [
        "## Prediction", "",
        "Variance accounted for, links 1 / 2, %; before: the design's numbers; baseline: one linear oscillator a",
        "gauge, driven by the joints' accelerations, fitted to the same run; NRMSE: of the fitted arm, %.", "",
        *table("run |  | fitted | before | baseline | NRMSE", judged), "",
        *(f"![{row.run.stem}](figures/hardware_{row.run.stem}.png)\n" for row in (*found.train, *found.held_out)),
        "## Which model", "",
        f"Each fitted to the first {HALF:g} s of `ladder_lqr_may` and judged by the rest of it. The last column was",
        "looked at; nothing was fitted to it.", "",
        *table("what is fitted | first part | rest | `ladder_hinf_jun`",
               [(v["label"], two(v["first"]), two(v["rest"]), two(v["other"])) for v in variants]), "",
        CONCLUSIONS,
        "## Frequencies and damping", "",
        "Fitted arm, both motors held: "
        + ", ".join(f"{f:.2f} Hz (ratio {z:.3f})" for f, z in zip(found.frequencies[:2], found.damping, strict=False))
        + f"; read off where the joints rest: {np.median([r.frequency for r in seen]):.2f} Hz (ratio "
        f"{np.median([r.damping for r in seen]):.3f}), medians of {len(seen)} stretches from "
        f"{min(r.frequency for r in seen):.2f} to {max(r.frequency for r in seen):.2f} Hz. One oscillator: "
        + ", ".join(f"{f:.2f} Hz ({z:.3f})" for f, z in found.oscillators.values()) + ".", "",
        MEANING,
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


ABOUT = """\
# A robot that was measured

Does a fitted arm predict runs of a real robot that no fit has seen?

Two steel strips on harmonic drives, the arm that the package has as `quanser_2dsfl`. The logs are measured by
others: GitHub repository basta/quanser-2-dof-serial-flexible-link, MIT licence, (c) 2022 aa4cc / Edu Ctrl Lab
Models; every fifth of the samples at 500 Hz, columns of time, joint angles and base strains, in
`docs/hardware/` with the licence. `ladder_lqr_may` (commit 52b582f, lqr_step_*.mat joined) and
`ladder_hinf_jun` (48ab0ce, hinf_step_*.mat joined): hub steps of up to 30 degrees, the elbow held at 0, under
two controllers, a month apart.
"""

MEASURED = """\
## What was measured

The angles of hub and elbow, by encoders on the motors' side of the drives (100:1 and 50:1), and the strain at
the root of each strip, kept as root curvature times a third of the length, through a low-pass of second order
at 2 Hz (damping 0.9), less an offset taken in the first second. Measured angles are prescribed, filtered at 20
Hz forwards and backwards and joined by a spline; the strains are predicted by an elastica of four nodes a link,
read through the same low-pass, and compared from 2 s on, a constant offset of each gauge and run taken off
(`configs/identify/quanser_2dsfl.toml`).
"""

CONCLUSIONS = """\
The strain of link 1 at rest goes with the hub's angle, that of link 2 hardly does: something pulls steadily at
the elbow, a cable perhaps. With the pull the residual of link 1 at rest is gone. A base that is not level would
do the same to link 1, and to link 2 what is not there. A cable lies differently a month later: the pull is the
fitted run's own (`nuisance = true`), and the other is predicted without it. That it was not there either was seen
in that run: with the pull 95.0 / 93.6 % of it are explained.
"""

MEANING = """\
What remains in the run held out is ringing. What rings while the joints rest is quicker and less damped than
the mode that fits the large swings: stiffness and damping that depend on amplitude (slip in clamps or drives),
which the model does not have. Phases drift apart over some seconds of ringing.

## What the data can tell, and what it means for training

One oscillator a gauge does nearly as well on these runs: the logs tell a frequency and a gain of each gauge,
and not much of how the arm is made. Stiffness, clamps and inertia trade against one another. What the arm has
beyond the oscillators is that it moves under torques and loads as well.

Train with `randomization` of EI and damping at least as wide as the ranges of `arm.toml` (`flexarm identify`
writes them), and wider in damping: it differs between large swings and small ones. Do not rely on phases of
ringing that was not measured: observe strains or deflections rather than count on them.
"""

if __name__ == "__main__":
    main(sys.argv[1:])
