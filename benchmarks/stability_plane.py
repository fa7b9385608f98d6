"""Random scenes in the plane: does the estimate of a run with status "ok" cover its error?

    python -m benchmarks.stability_plane [--cases N] [--workers N] [--fresh] [--page] [--out FOLDER]

The arms have one to three links: stepped, kinked, tapered and uniform strips of metal and plastic, 0.2 to 1 m long.
Payloads are up to three times the arm's mass. Gears are elastic, with friction and backlash. Torques, forces and
motions are smooth, jump, or change faster than the step. Steps are between a 500th and a tenth of the first period, at
most 20 ms. All formulations run with default and random meshes. The reference is another formulation on a mesh three
times as fine with a sixteenth of the step. A second reference, with two thirds of the first reference's mesh and twice
the step, estimates the error of the first. A case is not evaluated if the references differ by more than a fifth of the
limit, or if the run's error exceeds the limit by less than this difference. A run is wrong if its status is "ok" and
its error exceeds max(1.5 times its estimate, 1e-5 of the length).
"""

import argparse
import json
import math
import sys
import time
import traceback
from collections import Counter
from typing import Any

import numpy as np

from benchmarks import pages, replayed_plans
from benchmarks.machine import table
from benchmarks.running import STORE, cores, run_all
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section, Taper
from flexarm_env.scene import JointTorque, Load, Motion, PointLoad, Scene, default_mesh, resolving_step
from flexarm_env.settings import default_options
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import TimeFunction, constant, cycloid, from_array, pulse, sine
from flexarm_env.time_functions import steps as stairs
from flexarm_env.trajectory import Trajectory

Case = dict[str, Any]

COVERED, LEAST, SPREAD = 1.5, 1e-5, 0.2
"""Limits of the evaluation.

The error limit is COVERED times the estimate, but at least LEAST times the arm's length. The two references may differ
by SPREAD times this limit.
"""
TIME_LIMIT = 300.0
MATERIALS = {"aluminium": (70e9, 2700.0, 26e9), "steel": (205e9, 7850.0, 80e9), "plastic": (2.2e9, 1150.0, 0.8e9)}
METHODS = ("elastica", "geometrically_exact", "floating_frame")
LINKS = ("uniform", "stepped", "kinked", "tapered")
JOINTS = ("ideal", "ideal", "friction", "gear", "backlash")
DRIVES = ("sine", "pulse", "stairs", "fast", "table", "motion", "tip", "weight")


def _strip(rng: np.random.Generator, material: str, width: float, thickness: float) -> Section:
    E, rho, G = MATERIALS[material]
    return Section.rectangle(width, thickness, E, rho, G)


def link_of(rng: np.random.Generator, kind: str) -> Link:
    """Return a random strip of 0.2 to 1 m; its thickness is uniform, tapered, stepped, or kinked at one to three
    places."""
    material, length = str(rng.choice(list(MATERIALS))), float(rng.uniform(0.2, 1.0))
    width, thickest = float(rng.uniform(0.015, 0.05)), length * float(10 ** rng.uniform(-2.7, -1.9))

    def thickness() -> float:
        return thickest * float(rng.uniform(0.25, 1.0))

    if kind == "uniform":
        return Link(length, _strip(rng, material, width, thickest))
    if kind == "tapered":
        E, rho, G = MATERIALS[material]
        sides = (width, width * float(rng.uniform(0.4, 1.0))), (thickest, thickness())
        return Link(length, Taper(*sides, E, rho, G))
    places = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(1, 4)))) * length
    while np.diff(places, prepend=0.0, append=length).min() < 0.03 * length:
        places = np.sort(rng.uniform(0.05, 0.95, len(places))) * length
    own = [_strip(rng, material, width, thickness()) for _ in range(len(places) + 1 + (kind == "kinked"))]
    if kind == "kinked":
        return Link(length, tuple(zip((0.0, *places.tolist(), length), own, strict=True)))
    ends = (0.0, *places.tolist(), length)
    points = [(s, section) for a, b, section in zip(ends, ends[1:], own, strict=False) for s in (a, b)]
    return Link(length, tuple(points))


def joint_of(rng: np.random.Generator, kind: str, inertia: float, torque: float) -> Joint:
    """Return a random joint.

    The rotor has 0.03 to 3 times the arm's inertia; Coulomb friction is at most half of `torque`, N m; the gear has 1
    to 30 Hz, and its backlash is at most 0.05 rad.
    """
    if kind == "ideal":
        return Joint()
    rotor = inertia * float(10 ** rng.uniform(-1.5, 0.5))
    friction = {"friction_coulomb": torque * float(10 ** rng.uniform(-2.0, -0.3)), "motor_inertia": rotor,
                "friction_viscous": 1e-3 * torque}  # fmt: skip
    if kind == "friction":
        return Joint(**friction)
    stiffness = inertia * rotor / (inertia + rotor) * (2.0 * math.pi * float(10 ** rng.uniform(0.0, 1.5))) ** 2
    damping = 0.05 * math.sqrt(stiffness * inertia)
    if kind == "gear":
        return Joint(stiffness=stiffness, damping=damping, **friction)
    return Joint(stiffness=stiffness, damping=damping, backlash=float(10 ** rng.uniform(-3.0, -1.3)), **friction)


def drive_of(rng: np.random.Generator, kind: str, size: float, dt: float, end: float) -> TimeFunction:
    """Return a random torque (N m) or force (N) over time with amplitude `size`.

    kind "fast": a sine with a period of dt / 4 to 8 dt.
    """
    if kind in ("sine", "tip"):
        return sine(size, 2.0 * math.pi * float(10 ** rng.uniform(-0.3, 1.0)), float(rng.uniform(0.0, 6.0)))
    if kind == "pulse":
        return pulse(size, end * float(rng.uniform(0.1, 0.8)))
    if kind == "stairs":
        t = np.sort(rng.uniform(0.0, end, int(rng.integers(2, 12))))
        t[0] = 0.0
        return stairs(t, size * rng.uniform(-1.0, 1.0, len(t)))
    if kind == "fast":
        return sine(size, 2.0 * math.pi / (dt * float(2 ** rng.uniform(-2.0, 3.0))), float(rng.uniform(0.0, 6.0)))
    spacing = dt * float(2 ** rng.uniform(-3.0, 3.0))
    t = np.arange(0.0, end + spacing, spacing)
    wave = np.sin(2.0 * math.pi * t / end * 1.5) + 0.3 * rng.normal(size=len(t)) * float(rng.uniform(0.0, 1.0))
    return from_array(np.column_stack([t, size * wave]))


def scene_of(case: Case) -> tuple[Scene, str, dict[str, Any]]:
    """Return the scene, formulation and options of a case, all drawn from its seed."""
    rng = np.random.default_rng([20261129, case["seed"]])
    count, links = int(rng.choice([1, 1, 2, 3])), []
    kinds = [str(rng.choice(LINKS)) for _ in range(count)]
    links = [link_of(rng, kind) for kind in kinds]
    mass, length = sum(link.mass for link in links), sum(link.length for link in links)
    payload = mass * float(rng.choice([0.0, 0.1, 0.5, 3.0]))
    hub = 0.05 * mass * length**2
    elbows = tuple(Elbow(0.1 * mass, 1e-3 * hub, 1e-3 * hub) for _ in links[1:])
    softest = min(link.along(np.linspace(0.0, link.length, 65)).EI.min() for link in links)
    bent = float(10 ** rng.uniform(-1.7, 0.0))  # slope of a clamped link of the softest section
    torque = softest / length * bent
    joint, drive = str(rng.choice(JOINTS)), str(rng.choice(DRIVES))
    inertia = hub + (mass / 3.0 + payload) * length**2
    joints = () if joint == "ideal" else (joint_of(rng, joint, inertia, torque), *(Joint(),) * (count - 1))
    tau = float(rng.choice([1e-9, 1e-3, 5e-3]))
    arm = Arm("drawn", tuple(links), hub, elbows, Payload(payload, 1e-3 * payload * length**2), tau, joints=joints)
    stiffness = 3.0 * softest / ((payload + 0.25 * mass) * length**3)
    period = 2.0 * math.pi / math.sqrt(stiffness)
    dt = min(0.02, period * float(10 ** rng.uniform(-2.7, -1.0)))
    end = min(max(2.0 * period, 20.0 * dt), 1000.0 * dt, 2.0)
    motions: tuple[Motion, ...] = ()
    loads: tuple[Load, ...] = (JointTorque(0, constant(0.0)),)
    gravity = (0.0, 0.0)
    if drive == "motion" and joint == "ideal":
        motions, loads = (Motion("joint0", cycloid(bent, 0.7 * end)),), ()
    elif drive == "tip":
        loads = (PointLoad(count - 1, "tip", force_y=drive_of(rng, drive, torque / length, dt, end)),)
    elif drive == "weight":
        gravity = (0.0, -torque / (inertia / length))
    else:
        function = drive_of(rng, "sine" if drive == "motion" else drive, torque, dt, end)
        loads = (JointTorque(0, function),)
        if count > 1:
            loads = (*loads, JointTorque(1, pulse(0.2 * torque, 0.5 * end)))
    loads = (*loads, PointLoad(0, "tip", force_y=constant(1e-300)))
    scene = Scene("drawn", arm, duration=end, dt=dt, sample=end / 40.0, motions=motions, loads=loads, gravity=gravity)
    formulation = METHODS[case["seed"] % 3]
    options: dict[str, Any] = {}
    jumps = max(len(link.jumps) for link in links)
    if rng.random() < 0.5:
        least = jumps + (2 if formulation == "elastica" else 1)
        name = {"elastica": "nodes", "geometrically_exact": "elements", "floating_frame": "segments"}[formulation]
        options = {name: int(rng.integers(max(least, 3), max(least, 3) + 6))}
        if formulation == "elastica":  # of one smooth piece there are at most 12
            options[name] = min(options[name], 12)
    about = {"links": "+".join(kinds), "joint": joint, "drive": drive, "method": formulation, **options}
    return scene, formulation, {"options": options, "about": about}


def references(scene: Scene, formulation: str) -> tuple[Trajectory, Trajectory]:
    """Run the two references with another formulation than the case's; return the finer one first."""
    other = "floating_frame" if formulation == "geometrically_exact" else "geometrically_exact"
    name = "segments" if other == "floating_frame" else "elements"
    usual = default_mesh(scene.arm, other).get(name, int(default_options(other)[name]))
    slow = max(1, math.ceil(resolving_step(scene, scene.dt, scene.duration) / scene.dt))
    dt = resolving_step(scene, scene.dt, scene.duration) / 16.0 * slow
    runs = [
        simulate(scene, other, estimate_error=False, time_limit=TIME_LIMIT, dt=h, **{name: n})
        for n, h in ((3 * usual, dt), (2 * usual, 2.0 * dt))
    ]
    return runs[0], runs[1]


def apart(one: Trajectory, other: Trajectory) -> float:
    """Return the largest tip distance of two runs over the arm's length; infinity if a run ended early."""
    if one.tip.shape != other.tip.shape:
        return math.inf
    return float(np.hypot(*(one.tip - other.tip)[:, :2].T).max()) / one.scene.arm.total_length


def measure(case: Case) -> dict[str, Any]:
    """Run a case; return its status, error estimate and error, and the difference between its references."""
    clock = time.process_time()
    try:
        scene, formulation, drawn = scene_of(case)
        run = simulate(scene, formulation, time_limit=TIME_LIMIT, **drawn["options"])
        row: dict[str, Any] = {**drawn["about"], "status": run.status, "estimate": run.error_estimate}
        row |= {"parts": {k: float(f"{v:.3g}") for k, v in run.error_parts.items()}, "dt": run.settings.dt}
        if run.status in ("ok", "inaccurate"):
            fine, check = references(scene, formulation)
            row |= {"error": apart(run, fine), "spread": apart(fine, check)}
    except Exception:  # a crash is a result here
        row = {"status": "crashed", "trace": traceback.format_exc(limit=-3)}
    return {**row, "outcome": outcome(row), "cpu": round(time.process_time() - clock, 3)}


def outcome(row: dict[str, Any]) -> str:
    """Classify a case: return one of OUTCOMES."""
    if "error" not in row:
        return "failed" if row["status"] != "crashed" else "crashed"
    limit = max(COVERED * row["estimate"], LEAST)
    if not math.isfinite(row["spread"]) or row["spread"] > max(
        SPREAD * limit, 0.3 * row["error"] if row["error"] > limit else 0.0
    ):
        return "not judged"
    if row["status"] == "inaccurate":
        return "inaccurate"
    if limit < row["error"] <= limit + row["spread"]:
        return "not judged"
    return "wrong" if row["error"] > limit else "covered"


def report(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count the outcomes by formulation, section, joint and drive; return them with percentiles of error over
    estimate."""
    tally: dict[str, Counter[str]] = {}
    for row in rows:
        keys = ["all"]
        if "method" in row:
            keys += [f"method: {row['method']}", f"joint: {row['joint']}", f"drive: {row['drive']}"]
            keys += [f"link: {kind}" for kind in sorted(set(row["links"].split("+")))]
        for key in keys:
            tally.setdefault(key, Counter())[row["outcome"]] += 1
    ratios = [
        row["error"] / row["estimate"] for row in rows if row["outcome"] in ("covered", "wrong") and row["estimate"]
    ]
    shares = {f"{p} %": round(float(np.percentile(ratios, p)), 3) for p in (1, 10, 50, 90, 99, 100)} if ratios else {}
    return {"cases": len(rows), "counts": {k: dict(v) for k, v in sorted(tally.items())}, "error over estimate": shares,
            "cpu": sum(row["cpu"] for row in rows)}  # fmt: skip


OUTCOMES = ("covered", "wrong", "inaccurate", "not judged", "failed", "crashed")


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    counted = [[key, *(counts.get(name, 0) for name in OUTCOMES)] for key, counts in found["counts"].items()]
    ratios = ", ".join(f"{k}: {v:g}" for k, v in found["error over estimate"].items())
    return {
        "plane": [
            f"The {found['cases']} scenes took {found['cpu']:.0f} s. In judged runs with status `ok`, the error "
            "divided by "
            f"the estimate has these percentiles: {ratios}.", "", *table(" | ".join(["", *OUTCOMES]), counted),
        ],
        "plans": found["plans"],
    }  # fmt: skip


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """Run the random scenes, and read the plans that `benchmarks.replayed_plans` has stored."""
    cases = [{"seed": seed} for seed in range(options.cases)]
    rows = run_all("plane", cases, measure, STORE / "stability_plane.jsonl", options.workers, options.fresh)
    for row in rows:
        if row["outcome"] in ("wrong", "crashed"):
            print(json.dumps(row))
    found = report(rows)
    counts = found["counts"]["all"]
    plans = replayed_plans.kept()
    found["plans"] = replayed_plans.summary(plans)
    found["verdicts"] = {
        "no run in the plane with status ok is further off than 1.5 times its estimate": not counts.get("wrong", 0),
        "no run in the plane crashes": not counts.get("crashed", 0),
        "no plan that is found breaks its limits on the exact beam": not any(map(replayed_plans.wrong, plans)),
    }
    return found


FLAGS: dict[str, dict[str, Any]] = {"fresh": {"action": "store_true", "help": "delete results of an earlier run"}}


if __name__ == "__main__":
    sys.exit(pages.run("stability_plane", __doc__, measured, blocks, page="results/stability", more=FLAGS,
                       cases=400, workers=cores()))  # fmt: skip
