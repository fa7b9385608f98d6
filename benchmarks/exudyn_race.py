"""CPU time at equal error, ours against Exudyn's (extra: bench): docs/results/exudyn.{md,json}.

    python -m benchmarks.exudyn_race [--rounds 3] [--out FOLDER]

Both run the same scenes over meshes and steps; for every run of Exudyn on its own front (no other run of its is both
cheaper and better) our cheapest run that is at least as accurate is looked up. Exudyn's settings are in
`benchmarks.exudyn_peer`: dense solver for small systems, modified Newton, no output, quadratic elements.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks import exudyn_peer
from benchmarks.machine import describe_machine, write_text
from flexarm_env.scenes import named
from flexarm_env.simulation import simulate

RESULTS = Path(__file__).parents[1] / "docs" / "results"
SCENES = ("robot_arm_motion_smooth", "flying_rod")
RHO = 0.9
ELEMENTS, STEPS = (3, 4, 5, 6, 8, 12, 16, 20), (0.05, 0.025, 0.01, 0.005, 0.0025)
"""Steps that meet the instants of the reference."""
NEWTON: tuple[tuple[str, dict[str, Any]], ...] = (
    ("", {"tolerance": 1e-8}),
    (", tolerance 1e-5", {"tolerance": 1e-5}),
    (", modified Newton", {"tolerance": 1e-5, "newton": "modified"}),
)
"""Our iteration: the looser ones are enough where the error is large."""
WAYS = [
    (f"{' cubic' if order == 3 else ''}", f"{newton}{', corrected' if correction else ''}",
     {"order": order, "period_correction": correction, **given})
    for order in (2, 3) for newton, given in NEWTON for correction in (False, True)
]  # fmt: skip


def ours(scene_name: str, elements: int, dt: float, rounds: int, way: int) -> dict[str, Any]:
    """Our exact beam: error of the tip (% of L), CPU seconds (the least of some rounds)."""
    scene = named(scene_name)
    options = {"elements": elements, "dt": dt, **WAYS[way][2]}
    fixed: dict[str, Any] = {"rho_inf": RHO, "estimate_error": False}
    runs = [simulate(scene, "geometrically_exact", **fixed, **options) for _ in range(rounds)]
    record = {"t": runs[0].t, "tip": runs[0].tip[:, :2]}
    percent = 100.0 * exudyn_peer.error(scene_name, record) / scene.arm.total_length
    error = percent if runs[0].status == "ok" else None
    label = f"{elements}{WAYS[way][0]}, {dt:g} s{WAYS[way][1]}"
    return {"label": label, **options, "error": error, "cpu": min(r.cpu_seconds for r in runs)}


def theirs(scene_name: str, elements: int, dt: float, rounds: int) -> dict[str, Any]:
    """The same by Exudyn."""
    length = named(scene_name).arm.total_length
    runs = [exudyn_peer.run(scene_name, elements, dt, rho_inf=RHO) for _ in range(rounds)]
    error = 100.0 * exudyn_peer.error(scene_name, runs[0]) / length if runs[0]["finished"] else None
    return {"elements": elements, "dt": dt, "error": error, "cpu": min(r["cpu_seconds"] for r in runs)}


def front(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Runs that no other beats in both error and time, cheapest first."""
    good = sorted((r for r in rows if r["error"] is not None), key=lambda r: r["cpu"])
    best: list[dict[str, Any]] = []
    for row in good:
        if not best or row["error"] < best[-1]["error"]:
            best.append(row)
    return best


def compare(mine: list[dict[str, Any]], other: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each run on the other's front, our cheapest run at least as accurate, and the ratio of times."""
    rows = []
    for row in front(other):
        able = [r for r in mine if r["error"] is not None and r["error"] <= row["error"]]
        if able:
            best = min(able, key=lambda r: r["cpu"])
            rows.append({"exudyn": row, "ours": best, "ratio": row["cpu"] / best["cpu"]})
    return rows


def table(results: dict[str, Any]) -> str:
    """The results as Markdown."""
    lines = [
        "# CPU time at equal error, against Exudyn",
        "",
        "Every run on Exudyn's own front of error against time, and our cheapest `geometrically_exact` run that is at",
        "least as accurate. Error: largest distance of the tip from the converged solution, % of L. One core, compiled",
        "code, the least of several rounds. Where a hub angle is prescribed, Exudyn calls a Python function for it in",
        "every step; that is in its time. `corrected`: with `period_correction`;",
        "`modified Newton`: with a tolerance of 1e-5 too.",
        "Written by `python -m benchmarks.exudyn_race`.",
        "",
        " · ".join(f"{k}: {v}" for k, v in results["machine"].items()),
        "",
        "| scene | Exudyn: elements, step | error, % | CPU, ms | ours: elements, step | error, % | CPU, ms | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, rows in results["races"].items():
        for row in rows:
            cells = [
                f"{r.get('label') or '{elements}, {dt:g} s'.format(**r)} | {r['error']:.3g} | {1e3 * r['cpu']:.2f}"
                for r in (row["exudyn"], row["ours"])
            ]
            lines.append(f"| {name} | {cells[0]} | {cells[1]} | {row['ratio']:.1f} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Run both over all meshes and steps and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    options = parser.parse_args(arguments)
    try:
        import exudyn  # noqa: F401
    except ImportError:
        raise SystemExit("Exudyn is not installed: make setup-bench") from None
    races: dict[str, Any] = {}
    for name in SCENES:
        grid = list(itertools.product(ELEMENTS, STEPS))
        mine = [ours(name, *point, options.rounds, way) for point in grid for way in range(len(WAYS))]
        other = [theirs(name, *point, options.rounds) for point in grid]
        races[name] = compare(mine, other)
        for row in races[name]:
            print(name, json.dumps(row), flush=True)
    results = {"machine": describe_machine("exudyn"), "races": races}
    write_text(options.out / "exudyn.json", json.dumps(results, indent=1) + "\n")
    write_text(options.out / "exudyn.md", table(results))


if __name__ == "__main__":
    main(sys.argv[1:])
