"""Compare error estimates of runs in space with true errors: a part of `benchmarks.stability`.

    python -m benchmarks.estimates_space [--limit N] [--workers N] [--fresh] [--page] [--out FOLDER]

The arms are random: one to three links, with or without a turret, under gravity, sinusoidal joint torques and a force
at the tip. The following are random too: the formulation and its mesh, q = EI / (C L^2) of a link up to 0.3, a payload
of 0.01 to 1000 kg, a factor of 0.01 to 1e6 on all stiffnesses, Kelvin-Voigt damping, and a step of 0.5 to 20 ms.

The true error is the distance of the tip, or of its axes (1 rad counts as a fifth of the length), from the exact beam,
over the arm's length. The exact beam has a fine mesh, short steps and rho_inf = 0.9. A second, coarser reference bounds
the reference's own error. If this bound leaves the verdict open, a third reference with twice the mesh and half the
step decides.

The error of a run with status "ok" is underestimated if it exceeds the larger of 1.5 times its estimate and 1e-5.
"""

import argparse
import math
import sys
import time
import traceback
from collections import Counter
from typing import Any

import numpy as np

from benchmarks import pages, stability
from benchmarks.machine import table
from benchmarks.running import STORE, cores, run_all
from flexarm_env.bodies import RigidLink
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import sine

Case = dict[str, Any]

COUNT = 660
TRUST, LEAST = 1.5, 1e-5
"""Bounds of an underestimated error: above TRUST times the estimate, and above LEAST times the arm's length."""
TIME_LIMIT = 20.0
METHODS: dict[str, tuple[str, tuple[dict[str, Any], ...]]] = {
    "floating frame": ("floating_frame", tuple({"segments": n} for n in (2, 3, 5, 8))),
    "modes": ("floating_frame", tuple({"modes": m, "segments": n} for m, n in ((3, 1), (3, 3), (2, 4)))),
    "exact": ("geometrically_exact", tuple({"elements": n} for n in (3, 5, 8))),
    "elastica": ("elastica", ({"nodes": 4}, {"nodes": 6})),
}  # fmt: skip


def cases() -> list[Case]:
    """Draw the random cases; every call draws the same cases."""
    rng = np.random.default_rng(20261129)
    found = []
    for k in range(COUNT):
        method = list(METHODS)[k % len(METHODS)]
        meshes = METHODS[method][1]
        found.append({
            "seed": k, "method": method, "options": dict(meshes[int(rng.integers(len(meshes)))]),
            "links": int(rng.choice([1, 2, 2, 3])), "turret": bool(rng.random() < 0.5),
            "q": float(10 ** rng.uniform(-5.0, math.log10(0.3))), "stretch": float(10 ** rng.uniform(0.0, 1.0)),
            "stiff": float(rng.choice([1.0, 10 ** rng.uniform(-2.0, 0.0), 10 ** rng.uniform(0.0, 6.0)])),
            "payload": float(10 ** rng.uniform(-2.0, 3.0)),
            "tau": float(rng.choice([1e-12, 10 ** rng.uniform(-4.0, -2.0)])),
            "flat": float(10 ** rng.uniform(0.0, 1.0)), "torsion": float(10 ** rng.uniform(-0.5, 0.5)),
            "dt": float(10 ** rng.uniform(math.log10(5e-4), math.log10(0.02))),
            "torque": float(10 ** rng.uniform(-1.5, 0.5)), "gravity": float(rng.choice([0.0, 9.81])),
            "held": bool(rng.random() < 0.25), "angle": float(rng.uniform(-1.2, 1.2)),
        })  # fmt: skip
    return found


def scene_of(case: Case) -> Scene:
    """Return the scene of a case: flexible links of 1 m and 1 kg in total, under loads proportional to `torque`."""
    n, L = case["links"], 1.0 / case["links"]
    EI = 4.0 * case["stiff"]
    C = EI / (case["q"] * L**2)
    section = Section(
        EI=EI, EI_y=EI * case["flat"], GJ=EI * case["torsion"], C=C, C_y=1.2 * C, EA=C * case["stretch"], m=1.0,
        J=1e-4, J_y=1e-4 * case["flat"],
    )  # fmt: skip
    links: tuple[Any, ...] = (Link(L, section),) * n
    elbows: tuple[Elbow, ...] = (Elbow(0.1, 1e-3, 1e-3, (0.0, 1.0, 0.0)),) * (n - 1)
    if case["turret"]:
        links = (RigidLink(0.1, 0.5, (0.05, 0.0, 0.0), 1e-3), *links)
        elbows = (Elbow(0.1, 1e-3, 1e-3, (0.0, 1.0, 0.0)), *elbows)
    mass = case["payload"]
    arm = Arm(
        "case", links, hub_inertia=0.05, hub_axis=(0.0, 0.6, 0.8), elbows=elbows,
        payload=Payload(mass, 1e-3 * mass, (0.0, 0.03, 0.02)), tau_d=case["tau"],
    )  # fmt: skip
    count = len(links)
    held = 0 if case["held"] else None
    size, rng = 4.0 * case["torque"], np.random.default_rng(case["seed"])
    loads: list[Any] = [
        JointTorque(k, sine(size / 2**k, float(rng.uniform(4.0, 20.0)))) for k in range(count) if k != held
    ]
    loads.append(PointLoad(count - 1, "tip", force_y=sine(0.5 * size, float(rng.uniform(4.0, 20.0)))))
    motions = () if held is None else (Motion("joint0", sine(0.3, 6.0)),)
    end = max(0.3, 6.0 * case["dt"])
    dt = end / math.ceil(end / case["dt"])
    return Scene(
        "case", arm, duration=end, dt=dt, sample=end / max(1, min(30, round(end / dt))), loads=tuple(loads),
        motions=motions, gravity=(0.0, 0.0, -case["gravity"]), angles=(0.0, *[case["angle"]] * (count - 1)), space=True,
    )  # fmt: skip


def measure(case: Case) -> dict[str, Any]:
    """Run a case; return its status, the error estimate and its parts, the true error and the reference's accuracy."""
    clock = time.process_time()
    try:
        row = _measure(case)
    except Exception:  # a crash is a result here
        row = {"status": "crashed", "trace": traceback.format_exc(limit=-3)}
    return {**row, "cpu": round(time.process_time() - clock, 3)}


def _measure(case: Case) -> dict[str, Any]:
    scene = scene_of(case)
    try:
        run = simulate(scene, METHODS[case["method"]][0], time_limit=TIME_LIMIT, **case["options"])
    except ValueError as error:  # an arm that double precision does not carry
        return {"status": "refused", "message": str(error)}
    row: dict[str, Any] = {"status": run.status, "dissipated": float(np.diff(run.dissipated).min(initial=0.0))}
    if not run.finished:
        return row
    row["estimate"] = float(run.error_estimate) if math.isfinite(run.error_estimate) else None
    row["parts"] = {name: float(f"{value:.3g}") for name, value in run.error_parts.items() if math.isfinite(value)}
    row["bent"] = float(f"{np.abs(run.tip_deflection).max():.3g}")
    row["gain"], row["loss"] = (
        float(f"{x / max(run.turned_over, 1e-300):.3g}") for x in (run.balance.max(), -run.balance.min())
    )
    return row | _error(case, run, max(TRUST * (row["estimate"] or math.inf), LEAST))


def _error(case: Case, run: Any, bound: float) -> dict[str, Any]:
    """Return the true error and the reference's own error; refine the reference while the verdict is uncertain."""
    elements, dt = math.ceil(24 / case["links"]), min(1e-3, run.scene.dt / 4.0)
    coarse = reference(run.scene, math.ceil(elements / 1.5), 1.5 * dt)
    error = spread = math.inf
    for _ in range(3):
        fine = reference(run.scene, elements, dt)
        if not (coarse.finished and fine.finished):
            return {"reference": "failed"}
        error, spread = apart(run, fine), apart(coarse, fine)
        if error + 2.0 * spread < bound or error - 2.0 * spread > bound:
            return {"reference": "good", "error": error, "spread": spread}
        coarse, elements, dt = fine, 2 * elements, 0.5 * dt
    return {"reference": "open", "error": error, "spread": spread}


def reference(scene: Scene, elements: int, dt: float) -> Any:
    """Simulate the scene with the exact beam."""
    sample = float(scene.sample or scene.duration)
    whole = sample / math.ceil(sample / dt)
    return simulate(
        scene, "geometrically_exact", elements=elements, dt=whole, rho_inf=0.9, estimate_error=False,
        time_limit=TIME_LIMIT,
    )  # fmt: skip


def apart(one: Any, other: Any) -> float:
    """Return the largest difference of two runs, over the arm's length.

    The difference is the distance of the tips or a fifth of the angle between their axes, whichever is larger.
    """
    place, turn = stability.apart(one, other)
    return max(place / float(one.scene.arm.total_length), stability.TURN * turn)


# -------------------------------------------------------------------- report
def outcome(row: dict[str, Any]) -> str:
    """Classify a case by its status, estimate and error."""
    if row["status"] not in ("ok", "inaccurate"):
        return "refused" if row["status"] == "refused" else "failed"
    if row["status"] == "inaccurate":
        return "inaccurate"
    if row.get("reference") != "good":
        return "not judged"
    return "understated" if row["error"] > max(TRUST * row["estimate"], LEAST) else "ok"


OUTCOMES = ("ok", "inaccurate", "failed", "refused", "not judged", "understated")


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all cases and count their outcomes."""
    chosen = cases()
    if options.limit:
        chosen = chosen[:: max(1, len(chosen) // options.limit)]
    rows = run_all("estimates", chosen, measure, STORE / "estimates_space.jsonl", options.workers, options.fresh)
    tally: dict[str, Counter[str]] = {}
    for row in rows:
        row["outcome"] = outcome(row)
        for key in ("all", row["case"]["method"]):
            tally.setdefault(key, Counter())[row["outcome"]] += 1
    judged = [row for row in rows if row["outcome"] in ("ok", "understated")]
    ratios = [row["estimate"] / row["error"] for row in judged if row["error"] > LEAST]
    return {
        "cases": len(rows), "case_seconds": sum(row["cpu"] for row in rows),
        "outcomes": {key: dict(counts) for key, counts in tally.items()},
        "estimate_over_error": {f"{p} %": float(f"{np.percentile(ratios, p):.3g}") for p in (0, 1, 10, 50, 90)},
        "negative_dissipation": sum(row.get("dissipated", 0.0) < 0.0 for row in rows),
        "needlessly_inaccurate": sum(row["status"] == "inaccurate" and row.get("error", 1.0) < 0.01 for row in rows),
        "verdicts": {"no estimate in space is understated": not any(r["outcome"] == "understated" for r in rows)},
    }  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    ratios = ", ".join(f"{k}: {v:g}" for k, v in found["estimate_over_error"].items())
    counted = [[key, *(counts.get(name, 0) for name in OUTCOMES)] for key, counts in found["outcomes"].items()]
    return {"estimates in space": [
        *table(" | ".join(["", *OUTCOMES]), counted), "",
        f"The {found['cases']} scenes took {found['case_seconds']:.0f} s. In runs with an error above 1e-5 of the "
        "length, "
        f"the estimate divided by the true error has these percentiles: {ratios}. In "
        f"{found['needlessly_inaccurate']} runs the status was `inaccurate`, but the tip was within 1 % of the length. "
        f"In {found['negative_dissipation']} runs the energy dissipated between two samples was negative.",
    ]}  # fmt: skip


if __name__ == "__main__":
    sys.exit(pages.run("estimates_space", __doc__, measured, blocks, page="results/stability", more=stability.FLAGS,
                       workers=cores()))  # fmt: skip
