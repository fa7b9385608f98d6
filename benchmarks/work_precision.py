"""Run time against error for all scenes, formulations, meshes and time steps: docs/results/work_precision.md.

    python -m benchmarks.work_precision [--full] [--scene NAME ...] [--fresh] [--page] [--out FOLDER] [--figures FOLDER]

The eight validation scenes are compared with their converged solutions. The arms of both environments, under random
bang-bang torque, are compared with the exact beam on a fine mesh, computed here. Numerical damping varies too. CPU time
is that of the run itself, without compilation, on one core; for short runs it is the smaller of two. Exudyn and
PyElastica, if installed, run the scenes that they can model. PyElastica, which steps explicitly, is limited to 4 s per
run (--full: 120 s). The default size takes about ten minutes. Intermediate results are stored in runs/benchmarks, so
that an interrupted run can be continued.
"""

import argparse
import dataclasses
import itertools
import json
import sys
import time
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks import elastica_peer, exudyn_peer, pages
from benchmarks.converged import FOLDER as CONVERGED
from benchmarks.converged import tip_error as converged_error
from benchmarks.long_runs import torques
from benchmarks.machine import table
from benchmarks.running import STORE, run_all
from benchmarks.work_precision_figures import JOINED, PEERS, scene_figure, summary_figure
from flexarm_env import arms
from flexarm_env.comparison import tip_error
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.scenes import named, names, read_trajectory
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import steps as stairs
from flexarm_env.validation import Array

Case = dict[str, Any]

ENVIRONMENTS = {"FlexibleArm-v0": ("strip", 4.0), "TwoLinkFlexArm-v0": ("de_luca_siciliano", 2.0)}
"""Arm and duration (s) of each environment's scene; longer motions of two links are chaotic."""
LONG = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
STEPS = {
    "two_link_motion": (0.01, 0.005, 0.002, 0.001, 0.0005), "two_link_free_flight": (0.01, 0.005, 0.002, 0.001, 0.0005),
    "spin_up": (0.1, 0.05, 0.02, 0.01, 0.005),
    "FlexibleArm-v0": (0.02, 0.01, 0.02 / 3, 0.005, 0.0025, 0.00125, 0.0005),
    "TwoLinkFlexArm-v0": (0.02, 0.01, 0.02 / 3, 0.005, 0.0025, 0.00125, 0.0005),
}  # fmt: skip
"""Steps, s, of the runs of some scenes; all other scenes have those of LONG."""
SAMPLE = {"spin_up": 0.1, "FlexibleArm-v0": 0.02, "TwoLinkFlexArm-v0": 0.02}
TARGETS = (5.0, 1.0, 0.3, 0.1, 0.03)
"""Error limits, % of L, for which the page lists the quickest settings."""
CHAINS = ("floating frame", "modes")
FLOATING, EXACT = "floating_frame", "geometrically_exact"
AT_ONE_STEP: dict[str, tuple[str, dict[str, Any]]] = {
    "floating frame, 5 segments": (FLOATING, {"segments": 5, "rho_inf": 0.9}),
    "floating frame, 16 segments": (FLOATING, {"segments": 16, "rho_inf": 0.9}),
    "floating frame, 5 segments, clamped": (FLOATING, {"segments": 5, "rho_inf": 0.9, "frame": "root"}),
    "floating frame, 16 segments, clamped": (FLOATING, {"segments": 16, "rho_inf": 0.9, "frame": "root"}),
    "floating frame, 3 modes": (FLOATING, {"modes": 3}),
    "floating frame, 3 clamped modes": (FLOATING, {"modes": 3, "frame": "root"}),
    **{
        f"geometrically exact, {n} quadratic elements": (EXACT, {"order": 2, "elements": n, "rho_inf": 0.7})
        for n in (5, 8, 16)
    },
    "elastica, 8 nodes": ("elastica", {"nodes": 8, "rho_inf": 1.0}),
    "Exudyn, 20 quadratic elements": ("Exudyn", {"elements": 20, "rho_inf": 1.0}),
}
"""Runs of the table of all formulations; their step is 5 ms, except for scenes in AT_STEP."""
AT_STEP = {"two_link_motion": 0.001, "spin_up": 0.01}
MIDDLE = {"order": 2, "elements": 5, "rho_inf": 0.7, "dt": 0.005}
FITTED = {"order": 2, "elements": 5, "step_tolerance": 0.002, "dt": 0.005}
MORE: dict[str, dict[str, dict[str, Any]]] = {
    "two_link_motion": {
        "a longer step": MIDDLE,
        "period corrected": {**MIDDLE, "period_correction": True},
        "adaptive steps, tolerance 0.2 %": FITTED,
    }
}
CORRECTED = {
    "robot_arm_motion_smooth": (8, 0.05), "robot_arm_torque": (8, 0.02), "flying_rod": (8, 0.05),
    "two_link_motion": (5, 0.002), "two_link_free_flight": (8, 0.005),
}  # fmt: skip
"""Numbers of elements and steps (s) of runs that compare the exact beam with and without period correction."""


# -------------------------------------------------------------------- scenes
@cache
def scene_named(name: str) -> Scene:
    """Return a validation scene, or an environment's arm under random bang-bang torques."""
    if name not in ENVIRONMENTS:
        return named(name)
    arm_name, end = ENVIRONMENTS[name]
    arm = arms.named(arm_name)
    assert arm.torque_limits is not None
    loads = []
    for joint, limit in enumerate(arm.torque_limits):
        t, values = torques(end, seed=joint)
        loads.append(JointTorque(joint, stairs(t, values / np.abs(values).max() * limit)))
    return Scene(name, arm, duration=end, dt=0.005, sample=0.02, loads=tuple(loads))


def reference_of(name: str) -> dict[str, Array]:
    """Return the columns of a scene's converged solution; an environment's solution is computed once and stored."""
    path = CONVERGED / f"{name}.csv" if name not in ENVIRONMENTS else STORE / f"{name}.csv"
    if not path.exists():
        runs = [
            simulate(scene_named(name), "geometrically_exact", elements=elements, order=3, rho_inf=0.8, dt=dt,
                     estimate_error=False)
            for elements, dt in ((4, 4e-4), (8, 2e-4))
        ]  # fmt: skip
        apart = float(np.hypot(*(runs[0].tip - runs[1].tip)[:, :2].T).max()) / runs[1].scene.arm.total_length
        print(f"{name}: converged solution, {100 * apart:.1e} % of L from a coarser one", flush=True)
        runs[1].to_csv(path)
    return read_trajectory(path)


def meshes(full: bool) -> list[tuple[str, str, dict[str, Any]]]:
    """Return label, formulation and options of all runs, without their steps."""
    found: list[tuple[str, str, dict[str, Any]]] = []
    own: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("floating frame", "modes", {}),
        ("floating frame", "modes", {"frame": "root"}),
        (JOINED, JOINED, {"frame": "root", "multipliers": True}),
    )
    for label, reduced, form in own:
        for segments, rho in itertools.product((2, 3, 5, 8, 16), (0.9, 0.6, 1.0) if full else (0.9, 1.0)):
            found.append((label, "floating_frame", {"segments": segments, "rho_inf": rho, **form}))
        for modes in (2, 3, 4):
            found.append((reduced, "floating_frame", {"modes": modes, **form}))
        for segments in (3, 5, 8):
            found.append((reduced, "floating_frame", {"modes": 2, "segments": segments, **form}))
        if form:
            for coupling in ("von_karman", "paper", "linear"):
                found.append((label, "floating_frame", {"segments": 1, "elements": 5, "coupling": coupling, **form}))
            found.append((label, "floating_frame", {"segments": 5, "coupling": "paper", **form}))
    kinds = ((1, (16, 64)), (2, (2, 3, 5, 8, 16)), (3, (2, 4, 8)))
    for (order, counts), rho in itertools.product(kinds, (0.5, 0.7, 0.9, 1.0) if full else (0.7, 1.0)):
        for elements in counts:
            mesh = {"order": order, "elements": elements, "rho_inf": rho}
            found.append(("exact", "geometrically_exact", mesh))
            if order > 1:
                found.append(("exact, period corrected", "geometrically_exact", {**mesh, "period_correction": True}))
    for nodes, rho in itertools.product((3, 4, 5, 6, 8), (1.0, 0.9, 0.6) if full else (1.0, 0.9)):
        found.append(("elastica", "elastica", {"nodes": nodes, "rho_inf": rho}))
    found += [("elastica", "elastica", {"nodes": nodes, "tolerance": 1e-5}) for nodes in (4, 6)]
    found.append(("exact", "geometrically_exact", {"elements": 3, "tolerance": 1e-5}))
    loose = {"elements": 3, "tolerance": 1e-5, "period_correction": True}
    found.append(("exact, period corrected", "geometrically_exact", loose))
    return found


def cases_of(name: str, full: bool) -> list[Case]:
    """Return all runs of a scene."""
    found: list[Case] = []
    for (label, formulation, options), dt in itertools.product(meshes(full), STEPS.get(name, LONG)):
        found.append({"scene": name, "label": label, "formulation": formulation, "options": {**options, "dt": dt}})
    if name in MORE:
        found.append({"scene": name, "label": "exact, adaptive steps", "formulation": EXACT, "options": FITTED})
    for formulation in ("floating_frame", "geometrically_exact", "elastica"):
        own = DEFAULT_OPTIONS[formulation] if name in ENVIRONMENTS else {"dt": scene_named(name).dt}
        label = {"floating_frame": "floating frame", "geometrically_exact": "exact"}.get(formulation, formulation)
        found.append({"scene": name, "label": label, "formulation": formulation, "options": own, "default": True})
    if name in exudyn_peer.SCENES and find_spec("exudyn"):
        for elements, dt, rho in itertools.product((5, 20), (0.05, 0.02, 0.01, 0.005), (1.0, 0.7)):
            options = {"elements": elements, "dt": dt, "rho_inf": rho}
            found.append({"scene": name, "label": "Exudyn", "formulation": "Exudyn", "options": options})
    if name in elastica_peer.SCENES and find_spec("elastica"):
        counts = (10, 20, 40, 80, 160) if full else (10,) if name == "spin_up" else (10, 20, 40)
        for elements, share in itertools.product(counts, (0.9, 0.3) if full or len(counts) > 1 else (0.9,)):
            options = {"elements": elements, "share": share, "time_limit": 120.0 if full else 4.0}
            found.append({"scene": name, "label": "PyElastica", "formulation": "PyElastica", "options": options})
    return found


# ------------------------------------------------------------------ measuring
def measure(case: Case) -> dict[str, Any]:
    """Run a case; return the errors of tip (% of L) and energy, CPU seconds per simulated second, and iterations per
    step."""
    scene, length = scene_named(case["scene"]), scene_named(case["scene"]).arm.total_length
    if case["label"] in PEERS:
        options = case["options"]
        if case["label"] == "Exudyn":
            found = exudyn_peer.run(case["scene"], options["elements"], options["dt"], rho_inf=options["rho_inf"])
        else:
            found = elastica_peer.run(case["scene"], **options)
        row: dict[str, Any] = {"status": "ok" if found["finished"] else found.get("status", "failed")}
        if found["finished"]:
            row["max_error"] = 100.0 * converged_error(case["scene"], found["t"], found["tip"]) / length
            row["cpu"] = found["cpu_seconds"] / scene.duration
        return row
    sample = max(SAMPLE.get(case["scene"], 0.05), case["options"]["dt"])
    if sample > case["options"]["dt"] * 1.001 and case["options"]["dt"] > 0.5 * sample:
        sample = case["options"]["dt"] * round(2.0 * sample / case["options"]["dt"])
    run = simulate(scene, case["formulation"], sample=sample, estimate_error=False, **case["options"])
    if not run.finished:
        return {"status": run.status, "reached": float(run.t[-1])}
    cpu = run.cpu_seconds
    if cpu < 0.1:
        again = simulate(scene, case["formulation"], sample=sample, estimate_error=False, **case["options"])
        cpu = min(cpu, again.cpu_seconds)
    error = tip_error(run.t, run.tip, reference_of(case["scene"]))
    return {
        "status": "ok",
        "max_error": 100.0 * error.max_tip_error / length,
        "rms_error": 100.0 * error.rms_tip_error / length,
        "energy": float(np.abs(run.balance).max()) / run.turned_over,
        "cpu": cpu / scene.duration,
        "iterations": run.iterations / max(1, run.steps),
        "deflection": float(np.abs(run.tip_deflection).max()),
    }


def describe(case: Case) -> str:
    """Return the settings of a run in words."""
    options = case["options"]
    if case["label"] == "PyElastica":
        return f"PyElastica {options['elements']} elements, {options['share']:g} of its longest step"
    h = f"h {1e3 * options['dt']:.3g} ms"
    if case.get("default"):
        return f"{case['label']}, default, {h}"
    rho = f"rho {options['rho_inf']:g}" if "rho_inf" in options else ""
    form = "".join(f", {name}" for name in ("joined" if options.get("multipliers") else options.get("frame"),) if name)
    if "modes" in options:
        pieces = f", {options['segments']} segments" if "segments" in options else ""
        mesh = f"{options['modes']} modes{pieces}{form}"
    elif "nodes" in options:
        mesh = f"elastica {options['nodes']} nodes"
    elif case["formulation"] == "floating_frame":
        mesh = f"{options['segments']} segments" if options["segments"] > 1 else "1 frame of 5"
        mesh += form + (f", {options['coupling']}" if "coupling" in options else "")
    else:
        mesh = f"{case['label']} {options['elements']} of order {options.get('order', 2)}"
    loose = f"tolerance {options['tolerance']:g}" if "tolerance" in options else ""
    return ", ".join(part for part in (mesh, rho, h, loose) if part)


# -------------------------------------------------------------------- results
def front(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the Pareto front of CPU time and error, quickest run first."""
    found: list[dict[str, Any]] = []
    for row in sorted(rows, key=lambda r: (r["cpu"], r["max_error"])):
        if not found or row["max_error"] < found[-1]["max_error"]:
            found.append(row)
    return found


def behind(row: dict[str, Any], best: Sequence[dict[str, Any]]) -> float:
    """Return a run's CPU time over that of the quickest run on the front with at most its error."""
    return float(row["cpu"] / min(other["cpu"] for other in best if other["max_error"] <= row["max_error"]))


def advice(rows: Sequence[dict[str, Any]], target: float) -> dict[str, Any] | None:
    """Return the package's quickest run with an error of at most `target`, % of L, or None."""
    good = [row for row in rows if row["case"]["label"] not in PEERS and row["max_error"] <= target]
    return min(good, key=lambda row: row["cpu"]) if good else None


def floating_frames(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format a table: CPU time of floating frames joined by multipliers over that of chains, at the same error."""
    found = []
    for name in dict.fromkeys(row["case"]["scene"] for row in rows):
        mine = [row for row in rows if row["case"]["scene"] == name and row["status"] == "ok"]
        joined, chain = (
            [row for row in mine if row["case"]["label"] in labels] for labels in ((JOINED,), CHAINS)
        )  # fmt: skip
        cells = []
        for target in TARGETS:
            old, new = advice(joined, target), advice(chain, target)
            cell = "–" if old is None else "lost"
            if old is not None and new is not None:
                cell = f"{1e3 * old['cpu']:.2g} / {1e3 * new['cpu']:.2g} ({old['cpu'] / new['cpu']:.1f})"
            cells.append(cell)
        gains = [row["cpu"] / new["cpu"] if (new := advice(chain, row["max_error"])) else 0.0 for row in front(joined)]
        found.append((name, *cells, f"{min(gains):.1f}", f"{max(gains):.1f}"))
    return table(
        " | ".join(["scene", *(f"{target:g} %" for target in TARGETS), "smallest ratio", "largest ratio"]), found
    )


def found_of(rows: Sequence[dict[str, Any]], scene: str, formulation: str, options: dict[str, Any]) -> Any:
    """Return the run with these settings, or None."""
    for row in rows:
        case = row["case"]
        if case["scene"] == scene and case["formulation"] == formulation and case["options"] == options:
            return row
    return None


def all_formulations(rows: Sequence[dict[str, Any]], known: dict[str, Any]) -> list[str]:
    """Format a table of every formulation on every scene at one step.

    known: accuracies of the converged solutions.
    """
    lines = []
    for name in (name for name in known if name in {row["case"]["scene"] for row in rows}):
        dt, mine = AT_STEP.get(name, 0.005), [row for row in rows if row["case"]["scene"] == name]
        wanted = [(label, kind, {**options, "dt": dt}) for label, (kind, options) in AT_ONE_STEP.items()]
        middle = "geometrically exact, 5 quadratic elements"
        wanted += [(f"{middle}, {what}", EXACT, options) for what, options in MORE.get(name, {}).items()]
        doubt = f"{100.0 * known[name]['tip_error_estimate'] / known[name]['length']:.2g}"
        for label, kind, options in wanted:
            row = found_of(mine, name, kind, options)
            if row is None:  # a peer that does not run it
                continue
            cells = f"{row['status']} at {row.get('reached', 0.0):.3g} s", "–", "–"
            if row["status"] == "ok":
                energy = f"{row['energy']:.1e}" if "energy" in row else "–"
                cells = f"{row['max_error']:.3g}", f"{1e3 * row['cpu'] * scene_named(name).duration:.1f}", energy
            lines.append((name, label, f"{options['dt']:g}", *cells, doubt))
    return table(
        "scene | formulation | step, s | tip error, % of L | CPU, ms | energy error | uncertainty of the reference, "
        "% of L",
        lines,
    )


def corrected(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format a table: error and CPU time with and without period correction, in runs whose error is due to the step."""
    lines = []
    for name, (elements, dt) in CORRECTED.items():
        mesh = {"order": 2, "elements": elements, "rho_inf": 0.7}
        ways = ({**mesh, "dt": dt}, {**mesh, "period_correction": True, "dt": dt})
        pair = [found_of(rows, name, EXACT, options) for options in ways]
        if None not in pair:
            errors, times = ([row[key] for row in pair] for key in ("max_error", "cpu"))
            costs = [f"{1e3 * cpu * scene_named(name).duration:.2f}" for cpu in times]
            lines.append((name, f"{elements}, {dt:g} s", *(f"{error:.3g}" for error in errors),
                          f"{errors[0] / errors[1]:.1f}", *costs))  # fmt: skip
    return table(
        "scene | elements, step | tip error, % of L: uncorrected | corrected | ratio | CPU, ms: uncorrected | "
        "corrected",
        lines,
    )


def checked(known: dict[str, Any]) -> list[str]:
    """Format a table of the checks of the converged solutions."""
    lines = []
    for name, entry in known.items():
        share, check = 100.0 / entry["length"], entry.get("cross_check", {})
        other, peer = "–", f"{share * check['exudyn']:.2g}" if "exudyn" in check else "–"
        if "differences" in check:
            other = f"{share * check['differences']:.2g} ({share * check['differences_doubt']:.2g})"
        own = f"{share * entry['tip_error_estimate']:.2g}"
        lines.append((name, entry["elements"], f"{entry['dt']:g}", own, other, peer))
    return table(
        "scene | elements | step, s | change under refinement | distance from finite differences | distance "
        "from Exudyn",
        lines,
    )


def advised(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format a table of the quickest settings for each error limit, by scene."""
    found = []
    for name in dict.fromkeys(row["case"]["scene"] for row in rows):
        good = [row for row in rows if row["case"]["scene"] == name and row["status"] == "ok"]
        best = min((row for row in good if row["case"]["label"] not in PEERS), key=lambda row: row["max_error"])
        chosen = [advice(good, target) for target in TARGETS]
        cells = ["–" if row is None else f"{describe(row['case'])}: {1e3 * row['cpu']:.2g} ms" for row in chosen]
        found.append((name, f"{100 * best['deflection']:.0f} %", *cells))
    return table(" | ".join(["scene", "largest deflection", *(f"{target:g} %" for target in TARGETS)]), found)


def defaults(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format a table of the default settings: their errors, and their CPU times over that of the front."""
    found = []
    for row in (row for row in rows if row["case"].get("default")):
        name = row["case"]["scene"]
        mark = "**" if name in ENVIRONMENTS and row["case"]["formulation"] == "elastica" else ""
        cells = row["status"], "–", "–"
        if row["status"] == "ok":
            best = front([r for r in rows if r["case"]["scene"] == name and r["status"] == "ok"])
            cells = f"{row['max_error']:.3g}", f"{1e3 * row['cpu']:.2g}", f"{behind(row, best):.1f}"
        found.append((name, f"{mark}{describe(row['case'])}{mark}", *cells))
    return table("scene | settings | error, % of L | CPU, ms per s | time / time of the front", found)


def front_of(name: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format the Pareto front of a scene, and the results of the other programs."""
    good, found = [row for row in rows if row["status"] == "ok"], []
    for row in front(good):
        rest = ("–", "–"), "–"
        if row["case"]["label"] not in PEERS:
            rest = (f"{row['rms_error']:.2g}", f"{row['energy']:.1e}"), f"{row['iterations']:.1f}"
        cells = f"{row['max_error']:.3g}", *rest[0], f"{1e3 * row['cpu']:.2g}", rest[1]
        found.append((describe(row["case"]), *cells))
    for row in (row for peer in PEERS for row in front([row for row in good if row["case"]["label"] == peer])):
        ours = [other["cpu"] for other in good if other["case"]["label"] not in PEERS
                and other["max_error"] <= row["max_error"]]  # fmt: skip
        ratio = f"{row['cpu'] / min(ours):.0f} times the front's time" if ours else "beyond our front"
        found.append((describe(row["case"]), f"{row['max_error']:.3g}", "–", "–", f"{1e3 * row['cpu']:.3g}", ratio))
    early = len(rows) - len(good)
    ended = f"{early} of the runs ended early, with a status that states the reason"
    return [
        f"The scene was run with {len(rows)} settings. {ended if early else 'None of the runs ended early'}.", "",
        *table("settings | largest error, % of L | rms error, % of L | energy error | CPU, ms per s | iterations per "
            "step", found),
    ]  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows, known = found["rows"], json.loads((CONVERGED / "converged.json").read_text())
    by_scene = {name: [row for row in rows if row["case"]["scene"] == name] for name in (*names(), *ENVIRONMENTS)}
    return {
        "runs": [f"The tables have the results of {len(rows)} runs. The last measurement took "
                 f"{found['seconds']:.0f} s of "
                 "wall time; results of earlier measurements were kept."],
        "advice": advised(rows), "defaults": defaults(rows), "joined": floating_frames(rows),
        "formulations": all_formulations(rows, {name: known[name] for name in names()}),
        "corrected": corrected(rows), "converged": checked(known),
        **{name: front_of(name, mine) for name, mine in by_scene.items() if mine},
    }  # fmt: skip


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all cases and draw the figures."""
    clock = time.monotonic()
    for name in options.scene:
        if options.fresh and name in ENVIRONMENTS:
            (STORE / f"{name}.csv").unlink(missing_ok=True)
        reference_of(name)
        for order in (1, 2, 3):
            scene = scene_named(name)
            first = dataclasses.replace(scene, duration=2.0 * scene.dt, sample=scene.dt)
            simulate(first, "geometrically_exact", order=order, estimate_error=False)
    cases = [case for name in options.scene for case in cases_of(name, options.full)]
    rows = run_all("work-precision", cases, measure, STORE / "work_precision.jsonl", 1, options.fresh)
    keys = ["status", "max_error", "rms_error", "energy", "cpu", "iterations", "deflection"]
    heads = ["scene", "label", "default", "options", *keys]
    pages.write_csv(options.out / "work_precision.csv", heads, (
        (row["case"]["scene"], row["case"]["label"], int(row["case"].get("default", False)),
         pages.options_of(row["case"]), *(row.get(key) for key in keys)) for row in rows
    ))  # fmt: skip
    for name in options.scene:
        scene_figure(name, [row for row in rows if row["case"]["scene"] == name], front, options.figures)
    summary_figure(options.scene, rows, front, options.figures / "work_precision.png")
    return {"seconds": time.monotonic() - clock, "rows": rows}


if __name__ == "__main__":
    every = (*names(), *ENVIRONMENTS)
    flags: dict[str, dict[str, Any]] = {
        "full": {"action": "store_true", "help": "more values of rho_inf"},
        "scene": {"nargs": "*", "choices": every, "default": every, "help": "scenes to run (default: all)"},
        "fresh": {"action": "store_true", "help": "delete the intermediate results of an earlier run"},
    }
    sys.exit(pages.run("work_precision", __doc__, measured, blocks, packages=("exudyn", "pyelastica"), indent=None,
                       more=flags))  # fmt: skip
