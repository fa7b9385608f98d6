"""Stability under stress: thousands of runs, classified as ok, inaccurate, failed with a report, or silently wrong.

    python -m benchmarks.stability [--full] [--limit N] [--workers N] [--fresh] [--page] [--out FOLDER]

The default size takes a quarter to half an hour of two cores; `--full` takes more than twice as long. Intermediate
results are stored in runs/benchmarks, so that an interrupted run can be continued. The time of every case is limited.

A run is silently wrong if its status is "ok" and one of two conditions holds:
  (i)  energy was created: dE + D - W exceeds 1e-2 of gross work and initial energy, or the scheme dissipated more than
       a tenth of them;
  (ii) its tip is further from the converged solution than 1 % of L and than five times its `error_estimate`.
Condition (i) is tested in every case that ended. Condition (ii) is tested in all cases about damping, and in every
fourth of the others. Condition (ii) requires a converged solution: two meshes and steps agree within 0.3 % of L, and
there is no drag, which the exact beam lacks. In all other cases the tip's error is unknown, and the page states the
number of these cases. The exit code is 1 if a run was silently wrong, returned a NaN, raised an exception or took too
long.
"""

import argparse
import itertools
import json
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import exudyn_peer, pages, stiff_arms
from benchmarks.converged import tip_error
from benchmarks.long_runs import LONG, long_run, table_of_long_runs
from benchmarks.machine import table
from benchmarks.running import STORE, cores, run_all
from benchmarks.stability_cases import MAIN, Case, cases, reference_of, scene_of
from benchmarks.stability_figures import maps
from flexarm_env.scenes import named
from flexarm_env.simulation import Trajectory, simulate

TIME_LIMIT = 20.0
"""Largest CPU time, s, of a run and of each companion run."""
GAIN, LOSS, TIP, TRUST = 1e-2, 0.1, 0.01, 5.0
"""Limits of a run with status "ok".

GAIN, LOSS: created and lost energy over gross work and initial energy. TIP: tip error over L. TRUST: tip error over its
estimate.
"""
TURN = 0.2
"""Weight of an error of the tip's axes in space: 1 rad counts as this share of L."""
REFERENCE_SPREAD = 0.003
LONG_STEP_TIP = 0.05
"""Largest tip error, over L, that a run at long steps may have without a message."""
EVERY = 4
ALWAYS = ("damping", "damped and bent")
"""Families whose tip errors are all checked, because wrong damping does not show in the energy balance."""
OUTCOMES = ("ok", "inaccurate", "failed", "silently wrong", "broken")


def measure(
    case: Case, scene_of: Callable[..., Any] = scene_of, reference_of: Callable[..., Any] = reference_of
) -> dict[str, Any]:
    """Run a case; return its status, its energy error and, if the case is marked, its tip error.

    scene_of, reference_of: functions that make the case's scene and its reference.
    """
    case = dict(case)
    check = case.pop("check", False)
    clock = time.process_time()
    try:
        row = _measure(case, scene_of, reference_of if check else None)
    except Exception:  # a crash is a result here
        row = {"status": "crashed", "trace": traceback.format_exc(limit=-3)}
    return {**row, "cpu": round(time.process_time() - clock, 3)}


def _measure(case: Case, scene_of: Callable[..., Any], reference_of: Callable[..., Any] | None) -> dict[str, Any]:
    scene, formulation, options = scene_of(case)
    try:
        run = simulate(scene, formulation, time_limit=TIME_LIMIT, **options)
    except ValueError as error:  # an arm that double precision does not carry
        return {"status": "refused", "finite": True, "message": str(error)}
    row: dict[str, Any] = {"status": run.status, "reached": float(run.t[-1] / scene.duration), "steps": run.steps}
    arrays = (run.q, run.v, run.tip, run.energy, run.work, run.dissipated, run.shapes, run.joint_torque)
    row["finite"] = bool(all(np.isfinite(values).all() for values in arrays))
    row["estimate"] = _number(run.error_estimate)
    row["parts"] = {name: _number(value) for name, value in run.error_parts.items()}
    row["gain"], row["loss"] = _energy(run)
    if reference_of is not None and run.status in ("ok", "inaccurate") and not case.get("mass_damping"):
        row |= _tip_error(case, run, reference_of)
    return row


def _number(x: float) -> float | None:
    return round(float(x), 9) if np.isfinite(x) else None


def _energy(run: Trajectory) -> tuple[float, float]:
    """Return the created and the lost energy over gross work and initial energy (for gravity: over the exchanged
    energy)."""
    have = run.turned_over
    if have <= 0.0:
        return 0.0, 0.0
    return round(float(run.balance.max()) / have, 9), round(-float(run.balance.min()) / have, 9)


def _tip_error(case: Case, run: Trajectory, reference_of: Callable[..., Any]) -> dict[str, Any]:
    found = []
    for fine in (True, False):
        scene, options = reference_of(case, fine)
        one = simulate(scene, "geometrically_exact", estimate_error=False, time_limit=TIME_LIMIT, **options)
        if not one.finished or one.tip.shape != run.tip.shape:
            return {"reference": "failed"}
        found.append(one)
    spread, spread_of_turn = apart(*found)
    if spread > REFERENCE_SPREAD or TURN * spread_of_turn > REFERENCE_SPREAD:
        return {"reference": "not converged", "spread": spread}
    error, turn = apart(run, found[0])
    return {"reference": "good", "tip_error": error, "turn_error": turn, "spread": spread}


def apart(one: Trajectory, two: Trajectory) -> tuple[float, float]:
    """Return the largest distance of two runs' tips, m, and the largest angle between their axes, rad (0 in the
    plane)."""
    if not one.scene.spatial:
        return float(np.hypot(*(one.tip - two.tip)[:, :2].T).max()), 0.0
    axes: list[Any] = [run.tip_rotation for run in (one, two)]  # type: ignore[attr-defined]
    cosines = np.abs((axes[0] * axes[1]).sum(axis=1)).min()
    return float(np.linalg.norm(one.tip - two.tip, axis=1).max()), 2.0 * float(np.arccos(min(1.0, cosines)))


def outcome(row: dict[str, Any]) -> str:
    """Classify a case: return one of OUTCOMES."""
    if row["status"] == "crashed" or not row.get("finite", False) or row["cpu"] > 8.0 * TIME_LIMIT:
        return "broken"
    if row["status"] == "inaccurate":
        return "inaccurate"
    if row["status"] != "ok":
        return "failed"
    if row["gain"] > GAIN or row["loss"] > LOSS:
        return "silently wrong"
    off = max(row.get("tip_error", 0.0), TURN * row.get("turn_error", 0.0))
    return "silently wrong" if off > max(TIP, TRUST * (row["estimate"] or 0.0)) else "ok"


# ------------------------------------------------------------------- a peer
def hard_cases() -> list[dict[str, Any]]:
    """Return the paper's first scenes at long steps under every formulation, and with Exudyn if it is installed."""
    programs = [("flexarm_env", method) for method in HARD]
    programs += [("Exudyn", f"rho_inf {rho:g}") for rho in (1.0, 0.7)] if find_spec("exudyn") else []
    runs = itertools.product(("robot_arm_motion", "robot_arm_torque", "flying_rod"), (0.1, 0.05, 0.02), (5, 20))
    return [
        {"scene": name, "dt": dt, "elements": elements, "program": program, "method": method}
        for name, dt, elements in runs
        for program, method in programs
    ]


def hard_step(case: dict[str, Any]) -> dict[str, Any]:
    """Run one of `hard_cases`; return its status, tip error and error estimate, over L."""
    name, dt, elements = case["scene"], case["dt"], case["elements"]
    if case["program"] == "Exudyn":
        found = exudyn_peer.run(name, elements, dt, rho_inf=float(case["method"].split()[1]))
        if not found["finished"]:
            return {"status": "failed", "estimate": None, "error": None}
        return {"status": "ok", "estimate": None, "error": _against_converged(name, found["t"], found["tip"])}
    formulation, options = HARD[case["method"]]
    given = {key: elements if value is None else value for key, value in options.items()}
    run = simulate(named(name), formulation, dt=dt, sample=0.1, time_limit=TIME_LIMIT, **given)
    error = _against_converged(name, run.t, run.tip)
    return {"status": run.status, "estimate": _number(run.error_estimate), "error": error}


HARD: dict[str, tuple[str, dict[str, Any]]] = {
    "floating frame": ("floating_frame", {"segments": None, "elements": 1}),
    "one frame": ("floating_frame", {"segments": 1, "elements": None}),
    "modes": ("floating_frame", {"modes": 2, "segments": None}),
    "modes of the whole link": ("floating_frame", {"modes": 3}),
    "exact": ("geometrically_exact", {"elements": None}),
    "elastica": ("elastica", {"nodes": 6}),
}


def _against_converged(name: str, t: Any, tip: Any) -> float | None:
    """Return the largest tip distance from the stored solution, over L."""
    return _number(tip_error(name, t, tip) / named(name).arm.total_length)


# -------------------------------------------------------------------- report
def report(rows: Sequence[dict[str, Any]], hard: list[dict[str, Any]], long: list[dict[str, Any]]) -> dict[str, Any]:
    """Count the outcomes of all cases, and by family and formulation."""
    tally: dict[str, Counter[str]] = {}
    for row in rows:
        for key in ("all", row["case"]["family"], f"method: {row['case']['method']}"):
            tally.setdefault(key, Counter())[row["outcome"]] += 1
    checked = [row for row in rows if row.get("reference")]
    good = [row for row in checked if row["reference"] == "good"]
    failed = [row for row in hard if row["status"] not in ("ok", "inaccurate")]
    return {
        "cases": len(rows),
        "outcomes": {key: dict(value) for key, value in tally.items()},
        "statuses": dict(Counter(row["status"] for row in rows)),
        "energy_checked": sum(row["status"] == "ok" for row in rows),
        "tip_checked": sum(row["status"] == "ok" for row in good),
        "tip_not_asked": _not_asked(rows),
        "tip_checked_inaccurate": sum(row["status"] == "inaccurate" for row in good),
        "references": dict(Counter(row["reference"] for row in checked)),
        "estimate_over_error": _ratios(good),
        "needlessly_inaccurate": sum(row["status"] == "inaccurate" and row["tip_error"] < 0.01 for row in good),
        "longest_case": max(row["cpu"] for row in rows),
        "case_seconds": sum(row["cpu"] for row in rows),
        "hard_steps": {
            program: {
                "runs": sum(row["program"] == program for row in hard),
                "failed": sum(row["program"] == program for row in failed),
                "wrong by more than 5 % of L without a word": sum(
                    row["program"] == program and row["status"] == "ok" and (row["error"] or 0.0) > LONG_STEP_TIP
                    for row in hard
                ),
            }
            for program in sorted({row["program"] for row in hard})
        },
        "long_runs": long,
    }


def _not_asked(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Count the runs with status "ok" whose tip was not compared with a converged solution, by reason."""
    reasons: Counter[str] = Counter()
    for row in rows:
        if row["status"] == "ok" and row.get("reference") != "good":
            drag = "drag, which the exact beam has not" if row["case"].get("mass_damping") else "not among those asked"
            reasons[f"converged solution: {row['reference']}" if row.get("reference") else drag] += 1
    return dict(reasons)


def _ratios(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return percentiles of estimate over error, for errors above 0.1 % of L."""
    known = [row for row in rows if row["tip_error"] > 1e-3 and row["estimate"] is not None]
    ratio = [row["estimate"] / row["tip_error"] for row in known]
    if not ratio:
        return {}
    return {f"{p} %": round(float(np.percentile(ratio, p)), 3) for p in (0, 1, 10, 50, 90, 99)}


def write_rows(path: Path, rows: Sequence[dict[str, Any]], errors: Sequence[str], names: Sequence[str]) -> None:
    """Write a CSV line for each case: entries `names`, outcome, estimate and errors; print the wrong cases.

    errors: names of the tip errors.
    """
    ends = ["estimate", *errors, "gain", "loss", "steps"]
    pages.write_csv(path, [*names, "options", "outcome", "status", *ends], (
        (*(row["case"][name] for name in names), pages.options_of(row["case"]), row["outcome"], row["status"],
         *(row.get(name) for name in ends)) for row in rows
    ))  # fmt: skip
    for row in [row for row in rows if row["outcome"] in ("silently wrong", "broken")][:40]:
        print(json.dumps(row))


REASONS = {
    "not among those asked": "the case was not selected for the check",
    "converged solution: failed": "the run of the converged solution failed",
    "converged solution: not converged": "the converged solution is too uncertain",
    "drag, which the exact beam has not": "the exact beam has no drag",
}
"""Reasons for unchecked tips in a record, in the words of the page."""


def table_of_cases(found: pages.Found) -> list[str]:
    """Format the table of cases: how many were checked, and their outcomes."""
    reasons = "; ".join(f"{REASONS.get(k, k)} ({v})" for k, v in found["tip_not_asked"].items())
    ratios = ", ".join(f"{k}: {v:g}" for k, v in found["estimate_over_error"].items())
    counted = [[key, *(counts.get(name, 0) for name in OUTCOMES)] for key, counts in found["outcomes"].items()]
    return [
        f"The {found['cases']} cases took {found['case_seconds']:.0f} s, the longest {found['longest_case']:.1f} s. "
        f"The energy (criterion i) was checked for all {found['energy_checked']} cases with status `ok`, and the tip "
        f"(criterion ii) for {found['tip_checked']} of these cases. In the other cases the tip was not "
        f"checked, for these reasons (numbers of cases in brackets): {reasons}.",
        "", *table(" | ".join(["", *OUTCOMES]), counted), "",
        "In cases with an error above 0.1 % of L, the estimate divided by the true error has these percentiles: "
        f"{ratios}. In {found['needlessly_inaccurate']} runs the status was `inaccurate`, but the tip was within 1 % "
        "of L.",
        "", "The runs ended with the statuses "
            f"{', '.join(f'{k} ({v})' for k, v in sorted(found['statuses'].items()))}.",
    ]  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    hard = [
        (row["program"], row["method"], row["status"],
         *("–" if row[key] is None else f"{100 * row[key]:.2g}" for key in ("error", "estimate")))
        for row in found["hard_step_rows"]
        if (row["scene"], row["dt"], row["elements"]) == ("robot_arm_motion", 0.1, 5)
    ]  # fmt: skip
    lines = {
        "cases": table_of_cases(found),
        "long steps": table("program | runs | failed | error above 5 % of L without a message",
                            [[program, *counts.values()] for program, counts in found["hard_steps"].items()]),
        "hardest": table("program | method | status | error, % of L | estimate, % of L", hard),
    }  # fmt: skip
    if found["long_runs"]:
        lines["a million steps"] = table_of_long_runs(found["long_runs"])
    return lines | {"stiff arms": stiff_arms.table_of(found["stiff_arms"])}


def chosen(full: bool, limit: int | None) -> list[Case]:
    """Return the cases; mark those whose tip is compared with a converged solution (condition ii).

    All cases of the families ALWAYS are marked, and every fourth case of the others by formulation. full: all cases are
    marked.
    """
    count: Counter[tuple[str, str]] = Counter()
    found = []
    for case in cases(full):
        key = (case["family"], case["method"])
        found.append({**case, "check": full or case["family"] in ALWAYS or count[key] % EVERY == 0})
        count[key] += 1
    return found if limit is None else found[:: max(1, len(found) // limit)]


def warm_up() -> None:
    """Compile every kernel once in this process, so that forked workers inherit the code."""
    seen = set()
    for case in cases():
        scene, formulation, options = scene_of(case)
        exact = formulation == "geometrically_exact"
        thrown, damped, heavy = case["drive"] == "thrown", case["zeta"] > 0.0, case["gravity"] > 0.0
        key = (formulation, options.get("order"), options.get("period_correction"), exact and (thrown, damped, heavy))
        if key not in seen:
            seen.add(key)
            simulate(scene, formulation, duration=scene.dt, sample=scene.dt, estimate_error=False, **options)
            if exact:
                again, fine = reference_of(case, True)
                simulate(again, formulation, duration=fine["dt"], sample=fine["dt"], estimate_error=False, **fine)


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all cases, count their outcomes, and draw the maps."""
    warm_up()
    store, workers, fresh = STORE / "stability.jsonl", options.workers, options.fresh
    rows = run_all("stability", chosen(options.full, options.limit), measure, store, workers, fresh)
    for row in rows:
        row["outcome"] = outcome(row)
    hard = run_all("long steps", hard_cases(), hard_step, STORE / "long_steps.jsonl", 1, fresh)
    hard = [{**row.pop("case"), **row} for row in hard]
    long = (
        [] if options.no_long_runs else run_all("long runs", LONG, long_run, STORE / "long_runs.jsonl", workers, fresh)
    )
    stiff = run_all("stiff arms", stiff_arms.cases(), stiff_arms.measure, STORE / "stiff_arms.jsonl", workers, fresh)
    write_rows(options.out / "stability.csv", rows, ("tip_error",), (
        "family", "method", "drive", "amplitude", "slender", "payload", "zeta", "links", "h", "rho", "seed",
    ))  # fmt: skip
    maps(rows, options.figures / "stability.png", MAIN)
    counts = Counter(row["outcome"] for row in (*rows, *stiff))
    verdicts = {f"no run is {word}": counts[word] == 0 for word in ("silently wrong", "broken")}
    found = {**report(rows, hard, long), "hard_step_rows": hard, "stiff_arms": stiff_arms.tallied(stiff)}
    return found | {"verdicts": verdicts}


FLAGS: dict[str, dict[str, Any]] = {
    "limit": {"type": int, "help": "only about this many cases"},
    "fresh": {"action": "store_true", "help": "delete the intermediate results of an earlier run"},
}
FULL: dict[str, dict[str, Any]] = {
    "full": {"action": "store_true", "help": "more than twice as many cases, all tested for condition (ii)"},
    "no-long-runs": {"action": "store_true", "help": "skip the runs of a million steps"},
}


if __name__ == "__main__":
    sys.exit(pages.run("stability", __doc__, measured, blocks, packages=("exudyn",), more=FLAGS | FULL,
                       workers=cores()))  # fmt: skip
