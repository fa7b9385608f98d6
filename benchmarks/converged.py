"""Compute converged solutions of the validation scenes with the package's exact formulation.

    python -m benchmarks.converged [--scene NAME ...] [--check | --cross-check]

Each scene is run on two meshes and with two steps. The finest solution is stored as CSV in
`flexarm_env/data/references/converged/` (columns of `Trajectory.to_csv`). `converged.json` there records how much the
tip still changed with mesh and step, and its distance from two other solutions. The first of these solutions uses
finite differences on a staggered grid in plain NumPy, without code of the package (`tests/oracle_exact.py`); the second
uses Exudyn, if it is installed. `--check` only prints; `--cross-check` computes only the two other solutions.
"""

import argparse
import json
import sys
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import exudyn_peer
from benchmarks.machine import write_text
from flexarm_env import comparison
from flexarm_env.scenes import named, names, read_trajectory
from flexarm_env.simulation import simulate
from flexarm_env.trajectory import Trajectory

FOLDER = Path(__file__).parents[1] / "flexarm_env" / "data" / "references" / "converged"
ORDER = 3
PLANS: dict[str, tuple[int, float]] = {  # elements per link on the finest mesh, finest step (s)
    "robot_arm_motion": (64, 1 / 3200),
    "robot_arm_motion_smooth": (16, 1 / 800),
    "robot_arm_torque": (64, 1 / 3200),
    "flying_rod": (64, 1 / 3200),
    "flying_rod_soft": (64, 1 / 3200),
    "two_link_motion": (24, 1 / 16000),
    "two_link_free_flight": (24, 1 / 8000),
    "spin_up": (8, 1 / 1600),
}


CELLS = dict.fromkeys(PLANS, 40) | {"two_link_motion": 20, "two_link_free_flight": 20}
"""Finite-difference cells per link; a second solution has twice as many cells, and both are extrapolated.

The scene `spin_up` is omitted: with its rotary inertia of 6e-4 the explicit scheme needs too many steps. A test
compares this scene with its known answers.
"""
EXUDYN = (40, 1 / 800)
"""Number of quadratic elements, and step (s), of the runs by Exudyn."""


def run(name: str, elements: int, dt: float) -> Trajectory:
    """Simulate a scene with the exact beam, without numerical damping."""
    options = {"order": ORDER, "elements": elements, "dt": dt, "rho_inf": 1.0, "tolerance": 1e-10}
    trajectory = simulate(named(name), "geometrically_exact", estimate_error=False, **options)
    if not trajectory.finished:
        raise SystemExit(f"{name}, {elements} elements, step {dt:g} s: {trajectory.message}")
    return trajectory


def distance(a: Trajectory, b: Trajectory) -> float:
    """Return the largest distance of two trajectories' tips, m."""
    return float(np.hypot(*(a.tip[:, :2] - b.tip[:, :2]).T).max())


def tip_error(name: str, t: Any, tip: Any) -> float:
    """Return the largest distance, m, of a tip path from the stored solution of a scene.

    t (n,): instants, s. tip (n, 2 or more): positions, m.
    """
    reference = read_trajectory(FOLDER / f"{name}.csv")
    known = {column: reference[column] for column in ("t", "tip_x", "tip_y")}
    return comparison.tip_error(t, tip, known).max_tip_error


def study(name: str) -> tuple[Trajectory, dict[str, Any]]:
    """Return the finest run, and the changes of its tip position for half as many elements and for twice the step."""
    elements, dt = PLANS[name]
    finest = run(name, elements, dt)
    mesh = distance(run(name, elements // 2, dt), finest)
    step = distance(run(name, elements, 2 * dt), finest)
    scene = named(name)
    return finest, {
        "elements": elements,
        "order": ORDER,
        "dt": dt,
        "tip_change_by_mesh": mesh,
        "tip_change_by_step": step,
        "tip_error_estimate": mesh + step / 3.0,  # the step's error falls fourfold with each halving
        "length": scene.arm.total_length,
        "balance": float(np.abs(finest.balance).max()),
        "cpu_seconds": finest.cpu_seconds,
        "date": date.today().isoformat(),
    }


def cross_check(name: str) -> dict[str, Any]:
    """Compare the stored solution with finite differences and with Exudyn: largest distance of the tip, m.

    The result also contains the uncertainty of the finite-difference solution, m.
    """
    from tests.oracle_exact import tips

    found: dict[str, Any] = {}
    if name != "spin_up":
        t = read_trajectory(FOLDER / f"{name}.csv")["t"][1:]
        tip, doubt = tips(named(name), CELLS[name], t)
        found |= {"differences": tip_error(name, t, tip), "differences_doubt": doubt}
    if name in exudyn_peer.SCENES and find_spec("exudyn"):
        result = exudyn_peer.run(name, *EXUDYN)
        if result["finished"]:
            found["exudyn"] = tip_error(name, result["t"], result["tip"])
    return found


def main(arguments: list[str] | None = None) -> None:
    """Compute the requested scenes, print the results and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="*", choices=names(), help="scenes to run (default: all)")
    parser.add_argument("--check", action="store_true", help="print the study, write nothing")
    parser.add_argument("--cross-check", action="store_true", help="only compare the stored with two other solutions")
    options = parser.parse_args(arguments)
    index_path = FOLDER / "converged.json"
    index = json.loads(index_path.read_text()) if index_path.exists() else {}
    for name in options.scene or names():
        if options.cross_check:
            figures = {**index[name], "cross_check": cross_check(name)}
        else:
            finest, figures = study(name)
            if not options.check:
                finest.to_csv(FOLDER / f"{name}.csv")
                figures["cross_check"] = cross_check(name)
        print(name, json.dumps(figures), flush=True)
        if options.check:
            continue
        index[name] = figures
        write_text(index_path, json.dumps(dict(sorted(index.items())), indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
