"""All validation scenes under every formulation, against the converged solutions: docs/results/agreement.{md,json}.

python -m benchmarks.agreement [--out FOLDER]
"""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks import exudyn_peer
from benchmarks.converged import FOLDER as CONVERGED
from benchmarks.converged import tip_error
from benchmarks.machine import command, describe_machine, publish, table, told
from flexarm_env.scenes import named, names
from flexarm_env.simulation import simulate

EXACT = "geometrically_exact"
MIDDLE = ("geometrically exact, 5 quadratic elements", EXACT, {"elements": 5, "order": 2})
CASES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("floating frame, 5 segments", "floating_frame", {"segments": 5}),
    ("floating frame, 16 segments", "floating_frame", {"segments": 16}),
    ("floating frame, 5 segments, clamped", "floating_frame", {"segments": 5, "frame": "root"}),
    ("floating frame, 16 segments, clamped", "floating_frame", {"segments": 16, "frame": "root"}),
    ("floating frame, 3 modes", "floating_frame", {"modes": 3}),
    ("floating frame, 3 clamped modes", "floating_frame", {"modes": 3, "frame": "root"}),
    MIDDLE,
    ("geometrically exact, 8 quadratic elements", EXACT, {"elements": 8, "order": 2}),
    ("geometrically exact, 16 quadratic elements", EXACT, {"elements": 16, "order": 2}),
    ("elastica, 8 nodes", "elastica", {"nodes": 8}),
)
STEP = 0.005
"""Step of every run, s (0.001 where stiff links are turned within half a second, 0.01 in the spin-up)."""
STEPS = {"two_link_motion": 0.001, "spin_up": 0.01}
MORE: dict[str, tuple[tuple[str, dict[str, Any], float], ...]] = {
    "two_link_motion": (
        ("a longer step", {}, STEP),
        ("period corrected", {"period_correction": True}, STEP),
        ("steps fitted to 0.2 %", {"step_tolerance": 0.002}, STEP),
    )
}
"""More runs of 5 quadratic elements: what is said of them, options, step."""
CORRECTED = {
    "robot_arm_motion_smooth": (8, 0.05), "robot_arm_torque": (8, 0.02), "flying_rod": (8, 0.05),
    "two_link_motion": (5, 0.0025), "two_link_free_flight": (8, 0.005),
}  # fmt: skip
"""Elements and a step that is the limit, for runs without and with the correction of the period."""


def measure(
    scene_name: str, label: str, formulation: str, options: dict[str, Any], dt: float | None = None
) -> dict[str, Any]:
    """One run: error of the tip (max, in m and % of the arm's length), CPU time, energy that appeared or went."""
    scene, dt = named(scene_name), dt or STEPS.get(scene_name, STEP)
    trajectory = simulate(scene, formulation, dt=dt, estimate_error=False, error_limit=1.0, **options)
    error = tip_error(scene_name, trajectory.t, trajectory.tip)
    gross = float(np.abs(np.diff(trajectory.work, prepend=0.0)).sum())
    return {
        "scene": scene_name, "case": label, "formulation": formulation, "options": options, "dt": dt,
        "status": "ok" if trajectory.finished else trajectory.status,
        "reached": float(trajectory.t[-1]), "duration": scene.duration,
        "max_tip_error": error, "max_tip_error_percent": 100.0 * error / scene.arm.total_length,
        "cpu_seconds": trajectory.cpu_seconds, "steps": trajectory.steps, "iterations": trajectory.iterations,
        "energy_drift": float(np.abs(trajectory.balance).max()) / max(gross, 1e-12),
        "largest_deflection": float(np.abs(trajectory.tip_deflection).max()), "notes": dict(trajectory.notes),
    }  # fmt: skip


def peer(scene_name: str, elements: int = 20) -> dict[str, Any]:
    """The same scene by Exudyn (another program, another element), as a row of the table."""
    scene = named(scene_name)
    result = exudyn_peer.run(scene_name, elements, STEP)
    error = tip_error(scene_name, result["t"], result["tip"])
    return {
        "scene": scene_name, "case": f"Exudyn, {elements} quadratic elements", "formulation": "exudyn",
        "options": {"elements": elements, "order": 2}, "dt": STEP, "status": "ok" if result["finished"] else "failed",
        "reached": float(result["t"][-1]), "duration": scene.duration,
        "max_tip_error": error, "max_tip_error_percent": 100.0 * error / scene.arm.total_length,
        "cpu_seconds": result["cpu_seconds"], "energy_drift": None,
    }  # fmt: skip


def corrections() -> list[dict[str, Any]]:
    """Runs of `CORRECTED` without and with the correction, the quickest of five each."""
    rows = []
    for name, (elements, dt) in CORRECTED.items():
        for correction in (False, True):
            settings = {"elements": elements, "order": 2, "period_correction": correction}
            runs = [measure(name, "period corrected" if correction else "plain", EXACT, settings, dt) for _ in range(5)]
            rows.append(min(runs, key=lambda row: row["cpu_seconds"]))
    return rows


def corrected(rows: list[dict[str, Any]]) -> list[str]:
    """Lines on what the correction of the period brings where the step is the limit."""
    lines = [
        "", "## The period corrected", "",
        "The exact beam, quadratic elements, rho_inf 0.7, at steps that are the limit and not the mesh, without and "
        "with `period_correction`.", "",
        *table("scene | elements, step | tip error, % of L: plain | corrected | ratio | CPU, ms: plain | corrected"),
    ]  # fmt: skip
    for plain, better in zip(rows[::2], rows[1::2], strict=True):
        errors, times = ([row[key] for row in (plain, better)] for key in ("max_tip_error_percent", "cpu_seconds"))
        lines.append(
            f"| {plain['scene']} | {plain['options']['elements']}, {plain['dt']:g} s "
            f"| {errors[0]:.3g} | {errors[1]:.3g} | {errors[0] / errors[1]:.1f} "
            f"| {1e3 * times[0]:.2f} | {1e3 * times[1]:.2f} |"
        )
    return lines


def checked(index: dict[str, Any]) -> list[str]:
    """Lines on how the converged solutions were checked."""
    lines = [
        "", "## The converged solutions", "",
        "Made by `python -m benchmarks.converged` with the exact beam, cubic elements, undamped. Its own study: how "
        "far half the mesh moves the tip, plus a third of how far twice the step does. Beside it the distance of two "
        "other solutions from it: finite differences on a staggered grid in plain NumPy, which share no code with the "
        "package (`tests/oracle_exact.py`, extrapolated from two grids; in brackets how far that went), and Exudyn "
        "with 40 quadratic elements at 1/800 s. All in % of the arm's length. Scenes whose drive jumps are known less "
        "well than smooth ones: fronts and kinks lower the order of every method.", "",
        *table("scene | elements | step, s | own study | finite differences | Exudyn"),
    ]  # fmt: skip
    for name, entry in index.items():
        share, check = 100.0 / entry["length"], entry.get("cross_check", {})
        other, peer = "–", "–"
        if "differences" in check:
            other = f"{share * check['differences']:.2g} ({share * check['differences_doubt']:.2g})"
        if "exudyn" in check:
            peer = f"{share * check['exudyn']:.2g}"
        own = f"{share * entry['tip_error_estimate']:.2g}"
        lines.append(f"| {name} | {entry['elements']} | {entry['dt']:g} | {own} | {other} | {peer} |")
    return [*lines, "", "`spin_up` has known answers instead: its lag and stretch ([physics](physics.md))."]


def page(rows: list[dict[str, Any]], pairs: list[dict[str, Any]], machine: dict[str, str]) -> str:
    """Markdown of all rows, scene by scene."""
    index = json.loads((CONVERGED / "converged.json").read_text())
    lines = [
        "# All scenes, all formulations",
        "",
        "How far is each formulation from the converged solution, scene by scene?",
        "Largest distance of the tip from the converged solution over the whole run, in % of the arm's length; CPU",
        "time of the run (compiled, one core); energy that appeared or went, over the drives' gross work. Written by",
        "`python -m benchmarks.agreement`; the converged solutions by `python -m benchmarks.converged`, whose own",
        "study gives the uncertainty in the last column.", "", told(machine), "",
        *table("scene | formulation | step, s | tip error, % of L | CPU, ms | energy | reference known to, % of L"),
    ]  # fmt: skip
    for row in rows:
        known = 100.0 * index[row["scene"]]["tip_error_estimate"] / index[row["scene"]]["length"]
        if row["status"] == "ok":
            drift = "–" if row["energy_drift"] is None else f"{row['energy_drift']:.1e}"
            figures = f"{row['max_tip_error_percent']:.3g} | {1e3 * row['cpu_seconds']:.1f} | {drift}"
        else:
            figures = f"{row['status']} at {row['reached']:.3g} s | – | –"
        lines.append(f"| {row['scene']} | {row['case']} | {row['dt']:g} | {figures} | {known:.2g} |")
    return "\n".join([*lines, *corrected(pairs), *checked(index)]) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Run everything and write the table."""
    options = command(__doc__).parse_args(arguments)
    rows = []
    for name in names():
        rows += [measure(name, label, formulation, settings) for label, formulation, settings in CASES]
        for label, settings, dt in MORE.get(name, ()):
            rows.append(measure(name, f"{MIDDLE[0]}, {label}", EXACT, {**MIDDLE[2], **settings}, dt))
        if name in exudyn_peer.SCENES and find_spec("exudyn"):
            rows.append(peer(name))
        print(name, flush=True)
    machine, pairs = describe_machine("exudyn"), corrections()
    content = {"machine": machine, "rows": rows, "corrected": pairs}
    publish("agreement", options.out, content, page(rows, pairs, machine))


if __name__ == "__main__":
    main(sys.argv[1:])
