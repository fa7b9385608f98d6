"""How many segments a link needs: the floating frame against references, docs/results/segments.{md,json}.

python -m benchmarks.segments_table [--out FOLDER]

The rows of robot_arm_motion with an expected error are held to it, within 15 % or 0.003 m, whichever is larger; the
exit code is 1 where one is not.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import describe_machine, write_text
from flexarm_env.comparison import tip_error
from flexarm_env.scenes import named, reference
from flexarm_env.simulation import simulate

RESULTS = Path(__file__).parents[1] / "docs" / "results"
COUPLINGS = ("paper", "von_karman")
RHO_INF = 0.9

EXPECTED = {
    (1, 5): (1.71, 1.22),
    (2, 2): (0.42, 0.33),
    (4, 1): (0.100, 0.052),
    (5, 1): (0.071, 0.030),
    (8, 1): (0.032, 0.013),
}
"""Segments and elements: largest tip error (m) on robot_arm_motion with coupling paper and von_karman; from an
independent prototype of the same equations, rho_inf 0.8 to 1."""

OTHERS: dict[str, tuple[tuple[int, int], ...]] = {
    "robot_arm_motion_smooth": ((1, 5), (2, 2), (4, 1), (5, 1), (8, 1), (16, 1)),
    "flying_rod": ((1, 5), (4, 1), (8, 1), (16, 1)),
}


def step(segments: int) -> float:
    """Step that suits a number of segments, s."""
    return 0.05 if segments < 8 else 0.025 if segments < 16 else 0.0125


def measure(scene: str, segments: int, elements: int, coupling: str) -> dict[str, Any]:
    """One run against the scene's reference."""
    options = {"segments": segments, "elements": elements, "coupling": coupling}
    run = simulate(named(scene), dt=step(segments), rho_inf=RHO_INF, estimate_error=False, **options)
    error = tip_error(run.t, run.tip, reference(scene).columns)
    row: dict[str, Any] = {"scene": scene, **options, "dt": step(segments), "rho_inf": RHO_INF}
    row["status"] = "ok" if run.finished else run.status
    row |= {"max_tip_error": error.max_tip_error, "rms_tip_error": error.rms_tip_error}
    row |= {"reached": float(run.t[-1]), "cpu_seconds": run.cpu_seconds}
    if scene == "robot_arm_motion":
        expected = EXPECTED[segments, elements][COUPLINGS.index(coupling)]
        allowed = max(0.15 * expected, 0.003)
        row |= {"expected": expected, "allowed": allowed}
        row["agrees"] = run.finished and abs(error.max_tip_error - expected) <= allowed
    return row


def rows_of_all() -> list[dict[str, Any]]:
    """Every run of the table, told as it goes."""
    cases = [("robot_arm_motion", mesh) for mesh in EXPECTED]
    cases += [(scene, mesh) for scene, meshes in OTHERS.items() for mesh in meshes]
    rows = []
    for scene, (segments, elements) in cases:
        for coupling in COUPLINGS:
            row = measure(scene, segments, elements, coupling)
            rows.append(row)
            verdict = {True: "agrees", False: "DISAGREES", None: ""}[row.get("agrees")]
            print(f"{scene:24s} {segments:2d} x {elements}  {coupling:10s} {figure(row):22s} {verdict}", flush=True)
    return rows


def figure(row: dict[str, Any]) -> str:
    """The error of a row, or how its run ended."""
    return f"{row['max_tip_error']:.4f}" if row["status"] == "ok" else f"{row['status']} at {row['reached']:.3g} s"


def table(rows: list[dict[str, Any]], machine: dict[str, str]) -> str:
    """Markdown of all rows, a table a scene."""
    lines = [
        "# Segments",
        "",
        "Largest distance of the tip from the reference, m (arms of 10 m), over the reference's instants;",
        f"generalized-alpha, rho_inf = {RHO_INF}. One floating frame carries a modest deflection; what counts is the",
        "deflection of a segment.",
        "In brackets: an independent prototype of the same equations, held to within 15 % or 0.003 m.",
        "Written by `python -m benchmarks.segments_table`.",
        "",
        " · ".join(f"{k}: {v}" for k, v in machine.items()),
    ]
    for scene in dict.fromkeys(row["scene"] for row in rows):
        known = reference(scene)
        lines += ["", f"## {scene}", "", f"Reference: {known.method}; tip good to {known.tip_tolerance:g} m.", ""]
        lines += ["| segments × elements | step, s | `paper` | `von_karman` | CPU, ms |", "|---|---|---|---|---|"]
        meshes = dict.fromkeys((row["segments"], row["elements"]) for row in rows if row["scene"] == scene)
        for mesh in meshes:
            pair = [r for r in rows if r["scene"] == scene and (r["segments"], r["elements"]) == mesh]
            cells = [figure(r) + (f" ({r['expected']:g})" if "expected" in r else "") for r in pair]
            cpu = f"{1e3 * pair[-1]['cpu_seconds']:.1f}"
            lines.append(f"| {mesh[0]} × {mesh[1]} | {pair[0]['dt']:g} | {cells[0]} | {cells[1]} | {cpu} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run everything and write the table; 1 where a held value does not agree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    options = parser.parse_args(arguments)
    rows, machine = rows_of_all(), describe_machine()
    write_text(options.out / "segments.json", json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n")
    write_text(options.out / "segments.md", table(rows, machine))
    return 0 if all(row.get("agrees", True) for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
