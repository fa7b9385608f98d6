"""All validation scenes under every formulation, against the converged solutions: docs/results/agreement.{md,json}.

python -m benchmarks.agreement [--out FOLDER]
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import exudyn_peer
from benchmarks.converged import FOLDER as CONVERGED
from benchmarks.machine import describe_machine, write_text
from flexarm_env.scenes import named, names, read_trajectory
from flexarm_env.simulation import simulate

RESULTS = Path(__file__).parents[1] / "docs" / "results"
CASES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("floating frame, 5 segments x 1", "floating_frame", {"segments": 5, "elements": 1}),
    ("floating frame, 16 segments x 1", "floating_frame", {"segments": 16, "elements": 1}),
    ("floating frame, 3 modes", "floating_frame", {"modes": 3}),
    ("geometrically exact, 5 quadratic elements", "geometrically_exact", {"elements": 5, "order": 2}),
    ("geometrically exact, 16 quadratic elements", "geometrically_exact", {"elements": 16, "order": 2}),
    ("elastica, 8 nodes", "elastica", {"nodes": 8}),
)
STEP = 0.005
"""Step of every run, s (0.001 where two stiff links swing, 0.01 in the spin-up)."""
STEPS = {"two_link_motion": 0.001, "two_link_free_flight": 0.001, "spin_up": 0.01}


def measure(scene_name: str, label: str, formulation: str, options: dict[str, Any]) -> dict[str, Any]:
    """One run: error of the tip (max, in m and % of the arm's length), CPU time, energy that appeared or went."""
    scene = named(scene_name)
    trajectory = simulate(scene, formulation, dt=STEPS.get(scene_name, STEP), estimate_error=False, **options)
    reference = read_trajectory(CONVERGED / f"{scene_name}.csv")
    n = trajectory.t.size
    tip = np.column_stack([reference["tip_x"], reference["tip_y"]])[:n]
    error = float(np.hypot(*(trajectory.tip[:, :2] - tip).T).max())
    length = scene.arm.total_length
    gross = float(np.abs(np.diff(trajectory.work, prepend=0.0)).sum())
    return {
        "scene": scene_name,
        "case": label,
        "formulation": formulation,
        "options": options,
        "dt": STEPS.get(scene_name, STEP),
        "status": "ok" if trajectory.finished else trajectory.status,
        "reached": float(trajectory.t[-1]),
        "duration": scene.duration,
        "max_tip_error": error,
        "max_tip_error_percent": 100.0 * error / length,
        "cpu_seconds": trajectory.cpu_seconds,
        "steps": trajectory.steps,
        "iterations": trajectory.iterations,
        "energy_drift": float(np.abs(trajectory.balance).max()) / max(gross, 1e-12),
        "largest_deflection": float(np.abs(trajectory.tip_deflection).max()),
        "notes": dict(trajectory.notes),
    }


def peer(scene_name: str, elements: int = 20) -> dict[str, Any]:
    """The same scene by Exudyn (another program, another element), as a row of the table."""
    scene = named(scene_name)
    result = exudyn_peer.run(scene_name, elements, STEP)
    error = exudyn_peer.error(scene_name, result)
    return {
        "scene": scene_name,
        "case": f"Exudyn, {elements} quadratic elements",
        "formulation": "exudyn",
        "options": {"elements": elements, "order": 2},
        "dt": STEP,
        "status": "ok" if result["finished"] else "failed",
        "reached": float(result["t"][-1]),
        "duration": scene.duration,
        "max_tip_error": error,
        "max_tip_error_percent": 100.0 * error / scene.arm.total_length,
        "cpu_seconds": result["cpu_seconds"],
        "energy_drift": None,
    }


def table(rows: list[dict[str, Any]], machine: dict[str, str]) -> str:
    """Markdown of all rows, scene by scene."""
    index = json.loads((CONVERGED / "converged.json").read_text())
    lines = [
        "# All scenes, all formulations",
        "",
        "Largest distance of the tip from the converged solution over the whole run, in % of the arm's length; CPU",
        "time of the run (compiled, one core); energy that appeared or went, over the drives' gross work. Written by",
        "`python -m benchmarks.agreement`; the converged solutions by `python -m benchmarks.converged`, whose own",
        "study gives the uncertainty in the last column.",
        "",
        " · ".join(f"{k}: {v}" for k, v in machine.items()),
        "",
        "| scene | formulation | step, s | tip error, % of L | CPU, ms | energy | reference known to, % of L |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        known = 100.0 * index[row["scene"]]["tip_error_estimate"] / index[row["scene"]]["length"]
        if row["status"] == "ok":
            drift = "–" if row["energy_drift"] is None else f"{row['energy_drift']:.1e}"
            figures = f"{row['max_tip_error_percent']:.3g} | {1e3 * row['cpu_seconds']:.1f} | {drift}"
        else:
            figures = f"{row['status']} at {row['reached']:.3g} s | – | –"
        lines.append(f"| {row['scene']} | {row['case']} | {row['dt']:g} | {figures} | {known:.2g} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    options = parser.parse_args(arguments)
    rows = []
    for name in names():
        for label, formulation, settings in CASES:
            rows.append(measure(name, label, formulation, settings))
            print(
                f"{name:26s} {label:44s} {rows[-1]['status']:14s} {rows[-1]['max_tip_error_percent']:.4g} %", flush=True
            )
        if name in exudyn_peer.SCENES and find_spec("exudyn"):
            rows.append(peer(name))
            print(
                f"{name:26s} {rows[-1]['case']:44s} {rows[-1]['status']:14s} {rows[-1]['max_tip_error_percent']:.4g} %"
            )
    machine = describe_machine("exudyn")
    write_text(options.out / "agreement.json", json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n")
    write_text(options.out / "agreement.md", table(rows, machine))


if __name__ == "__main__":
    main(sys.argv[1:])
