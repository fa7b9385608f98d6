"""Exact beam, elastica and reduction to modes, measured and drawn: docs/results/formulations.{md,json}, docs/figures/.

python -m benchmarks.formulations [--out FOLDER] [--figures FOLDER]

Orders of convergence, centre of mass and long-run energy of the exact beam; errors of the elastica on slender arms and
what it leaves out; the reduction's error against deflection and time. The exit code is 1 where a figure is not what it
should be.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from benchmarks import formulation_runs as runs
from benchmarks.machine import command, judged, table, told
from flexarm_env.scenes import named


def row_at(rows: list[dict[str, Any]], dt: float) -> dict[str, Any]:
    """The run of a step."""
    return next(row for row in rows if row["dt"] == dt)


def energy_order(rows: list[dict[str, Any]]) -> float:
    """Order at which the wobble falls with the step."""
    return runs.slope([row["dt"] for row in rows], [row["wobble"] for row in rows])


def verdicts(found: dict[str, Any]) -> dict[str, bool]:
    """What has to hold, and whether it does."""
    orders, strips, reduction = found["exact_orders"], found["strips"], found["reduction"]
    rod, released = found["rod_energy"], found["elastica_energy"]
    own, usual = row_at(rod, named("flying_rod").dt), row_at(released, 2.5e-3)
    growth = max(max(row["wobble_of_tenths"]) / row["wobble_of_tenths"][0] for row in rod)
    told = {
        "exact beam: quadratic elements of order >= 3.5": orders["mesh"][2]["order"] >= 3.5,
        "exact beam: order 2 +- 0.1 in time": abs(orders["time_order"] - 2.0) <= 0.1,
        "flying_rod: centre of mass on its path to 1e-9 m": found["center_of_mass"] <= 1e-9,
        "flying_rod: energy wobbles by <= 1e-4 at the scene's step": own["wobble"] <= 1e-4,
        "flying_rod: energy drifts by <= 1e-6 at the scene's step": own["drift"] <= 1e-6,
        "flying_rod: wobble of second order (+- 0.3)": abs(energy_order(rod[:3]) - 2.0) <= 0.3,
        "flying_rod: no growth of the wobble": growth < 2.0,
        "elastica: energy wobbles by <= 1e-4 at 2.5 ms": usual["wobble"] <= 1e-4,
        "elastica: energy drifts by <= 1e-6 at 2.5 ms": usual["drift"] <= 1e-6,
        "elastica: wobble of second order (+- 0.3)": abs(energy_order(released) - 2.0) <= 0.3,
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
    """Wobble and drift, a row a step."""
    lines = table("step, s | tolerance | wobble | drift | largest wobble of a tenth of the run over the first's")
    for row in rows:
        growth = max(row["wobble_of_tenths"]) / row["wobble_of_tenths"][0]
        lines.append(
            f"| {row['dt']:g} | {row['tolerance']:g} | {row['wobble']:.2e} | {row['drift']:.1e} | {growth:.2f} |"
        )
    return [*lines, f"| order | – | {energy_order(rows):.2f} | – | – |", ""]


def page(found: dict[str, Any], machine: dict[str, str]) -> str:
    """Markdown of what was found."""
    orders, strips, reduction = found["exact_orders"], found["strips"], found["reduction"]
    lines = [
        "# Exact beam, elastica, modes", "",
        "Do elements, polynomials and modes converge at the orders that theory gives them? "
        "Written by `python -m benchmarks.formulations`.", "",
        told(machine), "",
        *table("what | holds", [(k, "yes" if holds else "**no**") for k, holds in found["verdicts"].items()]), "",
        "## Exact beam: order", "",
        *table("elements of order | measured order in the tip's position",
               [(p, f"{row['order']:.2f}") for p, row in orders["mesh"].items()]), "",
        f"In time: {orders['time_order']:.3f}.", "", "![orders](../figures/exact_orders.png)", "",
        "## Exact beam: free flight", "",
        f"`flying_rod`, 5 quadratic elements, step 0.005 s: the centre of mass is at most "
        f"{found['center_of_mass']:.1e} m off its known path.", "",
        "Energy after the loads have ended, 1e5 steps at rho_inf = 1, relative; wobble: max - min, drift: mean of the "
        f"last tenth less that of the first. The scene's own step is {named('flying_rod').dt:g} s. What is left of the "
        "drift is the wobble's slow part: it changes its sign from tenth to tenth and does not depend on Newton's "
        "tolerance.", "",
        *energy_table(found["rod_energy"]), "![energy](../figures/exact_energy.png)", "",
        "## Elastica on strips", "",
        "Strips of 1 m (EI 7, EA 7.2e6, C 2.3e6 N, m 0.277 kg/m), hub 0.05 kg m^2, payload 0.2 kg, undamped, 4 s: "
        "largest tip error in % of L against 6 cubic exact elements at 0.125 ms; worst of the seeds.", "",
        *table("arm, torque | largest deflection, % of a link | 6 nodes, 2.5 ms | 10 nodes, 5 ms | 10 nodes, 1.25 ms"),
    ]  # fmt: skip
    for key, row in strips.items():
        if isinstance(row, dict):
            step = 100 * np.max(row["step"], axis=0)
            lines.append(
                f"| {key} | {100 * max(row['deflection']):.0f} | {100 * max(row['whole']):.3f} | {step[1]:.3f} "
                f"| {step[3]:.3f} |"
            )
    lines += [
        "", "![strips](../figures/elastica_strip.png)", "",
        "Released from a tip deflection of 20 % of L, undamped and unforced, 1e5 steps:", "",
        *energy_table(found["elastica_energy"]), "![energy](../figures/elastica_energy.png)", "",
        "## What the elastica leaves out", "",
        "Stretch and shear: the estimate that each run reports (`Trajectory.notes`), and the error of 10 nodes in "
        "small steps against the converged exact solution, % of L.", "",
        "| scene | estimated | measured |", "|---|---|---|",
        *(f"| {name} | {100 * row['estimate']:.2g} | {100 * row['measured']:.2g} |"
          for name, row in found["left_out"].items()), "",
        "## Reduction to modes", "",
        "Three modes a link, undamped, torques to and fro for 0.8 s, 5 s in all. The error's order in the deflection; "
        "the error where the largest deflection is 10 % of a link's length; the deflection up to which it stays within "
        "0.2 % of L (two links: 0.5 %). Both interpolated.", "",
        "| arm | order | error at 10 %, % of L | kept up to a deflection of, % |", "|---|---|---|---|",
        *(f"| {name} | {row['order']:.1f} | {100 * row['error_at_10_percent']:.2g} | {row['kept_up_to_percent']:.1f} |"
          for name, row in reduction.items()), "",
        "The soft link comes nearly to rest with its torques. A link that goes on vibrating drifts in phase, since its "
        "true period depends on the amplitude and the reduced one's hardly does: on the strip the error after 5 s is "
        "ten times that after 1 s, and 0.2 % is kept up to a smaller deflection.", "",
        "![reduction](../figures/modal_error.png)", "",
    ]  # fmt: skip
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, draw, write; 1 where something does not hold."""
    options = command(__doc__).parse_args(arguments)
    found: dict[str, Any] = {
        "exact_orders": runs.exact_orders(options.figures),
        "center_of_mass": runs.center_of_mass(),
        "rod_energy": runs.rod_energy(options.figures),
        "strips": runs.strips(options.figures),
        "elastica_energy": runs.elastica_energy(options.figures),
        "left_out": runs.left_out(),
        "reduction": runs.reduction(options.figures),
    }
    found["verdicts"] = verdicts(found)
    return judged("formulations", options.out, found, page)


if __name__ == "__main__":
    sys.exit(main())
