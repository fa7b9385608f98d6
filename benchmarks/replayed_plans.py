"""Check `found` of plans of least time: replay them by `Motion.replay` and on the exact beam, and compare.

    python -m benchmarks.replayed_plans [--goals N] [--out FILE]

Two packaged arms and two softer arms move to random goals, with and without a bound on deflections. Each plan is run on
the exact beam with 10 elements per link and steps of 0.5 ms. The largest deflection, the joint angles and the final
rates of this run are compared with those of `Motion.replay`. A plan with `found` is wrong if on the exact beam it
exceeds its bound by more than 6 % and 6e-4 of a link's length, or misses its goal by more than 0.02 rad.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import table
from benchmarks.running import STORE
from flexarm_env import arms
from flexarm_env.control import optimal
from flexarm_env.control.dynamics import dynamics
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import steps

PERIOD = 0.02
ALUMINIUM = (7e10, 2700.0, 2.6e10)


def limp(*thicknesses: float) -> Arm:
    """Return an arm with links of 0.5 and 0.4 m and torque limits that bend them by a fifth of their length."""
    links = [Link(l, Section.rectangle(0.03, h, *ALUMINIUM)) for l, h in zip((0.5, 0.4), thicknesses, strict=False)]
    return Arm("limp", tuple(links), 0.01, (Elbow(0.1, 1e-4, 1e-4),) * (len(links) - 1), Payload(0.05, 1e-5),
               torque_limits=(1.0, 0.3)[: len(links)])  # fmt: skip


ARMS = {"strip": (0.03, 1), "de_luca_siciliano": (0.1, 2), "limp, one link": (0.03, 1), "limp, two links": (0.02, 2)}


def arm_of(name: str) -> Arm:
    """Return the arm with a name of `ARMS`."""
    return limp(*(0.003, 0.002)[: ARMS[name][1]]) if name.startswith("limp") else arms.named(name)


def plans(name: str, bound: float, goals: int) -> list[dict[str, Any]]:
    """Plan motions to random goals; return one row per plan."""
    arm, rng = arm_of(name), np.random.default_rng(7)
    plant = dynamics(arm, PERIOD)
    angles = rng.uniform(-1.2, 1.2, (goals, arm.n_links))
    start, goal = plant.rest(np.zeros_like(angles)), plant.rest(angles)
    clock = time.process_time()
    motion = optimal.least_time(plant, start, goal, optimal.Bounds(deflection=bound))
    planned = time.process_time() - clock
    assert motion.replay is not None
    rows = []
    for k in range(goals):
        run = _run(arm, motion.controls[:, k], int(motion.ends[k]))
        bends, off = np.abs(run.tip_deflection).max(axis=0), run.joint_angles[-1] - angles[k]
        mine = motion.replay
        rows.append({
            "arm": name, "bound": bound, "periods": int(motion.periods[k]), "found": bool(motion.found[k]),
            "missed": float(motion.missed[k]), "replayed": float(mine.deflection[k].max()), "exact": float(bends.max()),
            "off": float(np.abs(mine.off[k]).max()), "off_exact": float(np.abs(off).max()),
            "rate": float(np.abs(mine.rates[k]).max()), "rate_exact": float(np.abs(run.joint_rates[-1]).max()),
            "seconds": planned / goals, "status": run.status,
        })  # fmt: skip
    return rows


def _run(arm: Arm, controls: Any, ends: int) -> Any:
    t = PERIOD * np.arange(len(controls))
    loads = tuple(JointTorque(k, steps(t, controls[:, k] * (arm.torque_limits or ())[k])) for k in range(arm.n_links))
    scene = Scene("plan", arm, duration=PERIOD * ends, dt=5e-4, sample=2.5e-3, loads=loads)
    return simulate(scene, "geometrically_exact", elements=10, estimate_error=False)


def wrong(row: dict[str, Any]) -> bool:
    """Return whether a plan marked as found violates its limits on the exact beam."""
    over = row["exact"] > row["bound"] + max(0.06 * row["bound"], 6e-4)
    return row["found"] and (row["status"] != "ok" or over or row["off_exact"] > 0.02)


KEPT = STORE / "replayed_plans.jsonl"


def kept() -> list[dict[str, Any]]:
    """Return the rows of an earlier run."""
    return [json.loads(line) for line in KEPT.read_text().splitlines()] if KEPT.is_file() else []


def main(args: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=8)
    parser.add_argument("--out", type=Path, default=KEPT)
    options = parser.parse_args(args)
    rows: list[dict[str, Any]] = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for name, (bound, _) in ARMS.items():
        for own in (np.inf, bound):
            found = plans(name, own, options.goals)
            rows += found
            with options.out.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in found)
            print("\n".join(summary(found)), flush=True)
    print("\n".join(summary(rows)))
    return int(any(map(wrong, rows)))


def summary(rows: list[dict[str, Any]]) -> list[str]:
    """Format a table: numbers of found plans, and their errors on the exact beam."""
    lines = []
    for key in dict.fromkeys((row["arm"], row["bound"]) for row in rows):
        own = [row for row in rows if (row["arm"], row["bound"]) == key]
        off = max(abs(row["replayed"] - row["exact"]) for row in own)
        lines.append([
            key[0], "–" if np.isinf(key[1]) else f"{key[1]:g}", len(own),
            sum(row["missed"] <= optimal.TOLERANCE for row in own), sum(row["found"] for row in own),
            sum(map(wrong, own)), f"{max(row['exact'] for row in own):.3g}", f"{off:.1e}",
            f"{max(row['off_exact'] for row in own if row['found']):.1e}" if any(r["found"] for r in own) else "–",
        ])  # fmt: skip
    heads = (
        "arm | deflection bound | plans | planned | found | wrong | largest deflection on the exact beam | distance "
        "from the replay | largest goal error of found plans, rad"
    )
    return table(heads, lines)


if __name__ == "__main__":
    sys.exit(main())
