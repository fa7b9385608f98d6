"""Measure and plot exact beam, elastica and reduction to modes: docs/results/physics.md, docs/figures/.

python -m benchmarks.formulations [--page] [--out FOLDER] [--figures FOLDER]

For the exact beam the script measures orders of convergence, the center of mass, and long-run energy. For the elastica
the script measures errors on slender arms and the effects that the elastica omits. For the reduction the script
measures the error against deflection and time. The exit code is 1 if a result is outside of its bounds.
"""

import argparse
import sys
from typing import Any

import numpy as np

from benchmarks import formulation_runs as runs
from benchmarks import pages
from benchmarks.machine import table
from flexarm_env.scenes import named


def row_at(rows: list[dict[str, Any]], dt: float) -> dict[str, Any]:
    """Return the row of the run with a given step."""
    return next(row for row in rows if row["dt"] == dt)


def energy_order(rows: list[dict[str, Any]]) -> float:
    """Return the order at which the energy's wobble decreases with the step."""
    return runs.slope([row["dt"] for row in rows], [row["wobble"] for row in rows])


def verdicts(found: dict[str, Any]) -> dict[str, bool]:
    """Return the required properties, and whether each one holds."""
    orders, strips, reduction = found["exact_orders"], found["strips"], found["reduction"]
    rod, released = found["rod_energy"], found["elastica_energy"]
    own, usual = row_at(rod, named("flying_rod").dt), row_at(released, 2.5e-3)
    growth = max(max(row["wobble_of_tenths"]) / row["wobble_of_tenths"][0] for row in rod)
    told = {
        "exact beam: order of quadratic elements >= 3.5": orders["mesh"]["2"]["order"] >= 3.5,
        "exact beam: order 2 +- 0.1 in time": abs(orders["time_order"] - 2.0) <= 0.1,
        "flying_rod: center of mass on its path to 1e-9 m": found["center_of_mass"] <= 1e-9,
        "flying_rod: energy wobbles by <= 1e-4 at the scene's step": own["wobble"] <= 1e-4,
        "flying_rod: energy drifts by <= 1e-6 at the scene's step": own["drift"] <= 1e-6,
        "flying_rod: energy wobble of second order (+- 0.3)": abs(energy_order(rod[:3]) - 2.0) <= 0.3,
        "flying_rod: energy wobble does not grow": growth < 2.0,
        "elastica: energy wobbles by <= 1e-4 at 2.5 ms": usual["wobble"] <= 1e-4,
        "elastica: energy drifts by <= 1e-6 at 2.5 ms": usual["drift"] <= 1e-6,
        "elastica: energy wobble of second order (+- 0.3)": abs(energy_order(released) - 2.0) <= 0.3,
    }
    for name, share in (("strip", 1.0), ("two strips", 2.0)):
        for kind, bound in (("random", 5e-3), ("bang-bang", 5e-3), ("slow", 1e-3)):
            worst = max(strips[f"{name}, {kind}"]["whole"])
            told[f"elastica, 6 nodes at 2.5 ms, {name}, {kind}: <= {100 * share * bound:g} % of L"] = (
                worst <= share * bound
            )
            mesh = np.median(strips[f"{name}, {kind}"]["mesh"], axis=0)
            told[f"elastica, {name}, {kind}: mesh error falls 100-fold from 3 to 8 nodes"] = bool(
                mesh[5] < mesh[0] / 100
            )
    told["modes: <= 0.2 % of L at a deflection of 10 %, one link"] = (
        reduction["soft link"]["error_at_10_percent"] <= 2e-3
    )
    told["modes: <= 0.5 % of L at a deflection of 10 %, two links"] = (
        reduction["two strips"]["error_at_10_percent"] <= 5e-3
    )
    return told


def energy_table(rows: list[dict[str, Any]]) -> list[str]:
    """Format a table of wobble and drift with one row per step."""
    lines = []
    for row in rows:
        growth = max(row["wobble_of_tenths"]) / row["wobble_of_tenths"][0]
        settings = f"{row['dt']:g}", f"{row['tolerance']:g}"
        lines.append((*settings, f"{row['wobble']:.2e}", f"{row['drift']:.1e}", f"{growth:.2f}"))
    heads = "step, s | tolerance | wobble | drift | largest wobble of a tenth / wobble of the first tenth"
    return table(heads, [*lines, ("order", "–", f"{energy_order(rows):.2f}", "–", "–")])


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    orders, strips = found["exact_orders"], []
    for key, row in found["strips"].items():
        if isinstance(row, dict):
            step = 100 * np.max(row["step"], axis=0)
            whole = f"{100 * max(row['deflection']):.0f}", f"{100 * max(row['whole']):.3f}"
            strips.append((key, *whole, f"{step[1]:.3f}", f"{step[3]:.3f}"))
    mesh = [(p, f"{row['order']:.2f}") for p, row in orders["mesh"].items()]
    mesh.append(("in time", f"{orders['time_order']:.3f}"))
    left_out = [
        (name, f"{100 * row['estimate']:.2g}", f"{100 * row['measured']:.2g}")
        for name, row in found["left_out"].items()
    ]
    modes = [
        (name, f"{row['order']:.1f}", f"{100 * row['error_at_10_percent']:.2g}", f"{row['kept_up_to_percent']:.1f}")
        for name, row in found["reduction"].items()
    ]
    heads = (
        "arm, torque | largest deflection, % of a link's length | 6 nodes, 2.5 ms | 10 nodes, 5 ms | 10 nodes, 1.25 ms"
    )
    return {
        "orders": table("elements of order | measured order in the tip's position", mesh),
        "mass": [f"The center of mass is at most {found['center_of_mass']:.1e} m off its known path."],
        "rod": energy_table(found["rod_energy"]), "strips": table(heads, strips),
        "released": energy_table(found["elastica_energy"]), "left out": table("scene | estimated error, % of L | "
            "measured error, % of L", left_out),
        "modes": table("arm | order of the error | error at 10 % deflection, % of L | largest deflection within the "
            "limit, %", modes),
    }  # fmt: skip


def measure(options: argparse.Namespace) -> pages.Found:
    """Run all measurements and write their figures."""
    found: pages.Found = {
        "exact_orders": runs.exact_orders(options.figures),
        "center_of_mass": runs.center_of_mass(),
        "rod_energy": runs.rod_energy(options.figures),
        "strips": runs.strips(options.figures),
        "elastica_energy": runs.elastica_energy(options.figures),
        "left_out": runs.left_out(),
        "reduction": runs.reduction(options.figures),
    }
    return {**found, "verdicts": verdicts(found)}


if __name__ == "__main__":
    sys.exit(pages.run("formulations", __doc__, measure, blocks, page="results/physics"))
