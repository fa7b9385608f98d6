"""Compare adaptive steps (fitted to a tolerance) with fixed steps: the error of a control period, and the cost.

    python -m benchmarks.fitted_steps [--periods 400] [--page] [--out FOLDER]

`FlexibleArm-v0` moves in four ways. The error of a period is the distance of its final tip position from the tip
position with 256 times shorter steps, from the same state and on the same mesh. The number of steps includes the steps
taken for comparison. The CPU time is that of the compiled control period of one arm, the smallest of five rounds.
"""

import argparse
import dataclasses
import itertools
import json
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from flexarm_env import arms
from flexarm_env.batch import Batch, standing_scene
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.simulation import Simulation
from flexarm_env.validation import Array

PERIOD = 0.02
FINE = 256
MOTIONS = ("calm", "random", "bang-bang, 3 times the limit", "light payload", "calm, then bang-bang")
"""Names of the motions, which the page describes."""
WAYS: dict[str, tuple[dict[str, Any], ...]] = {
    "elastica": (
        {"dt": 0.02}, {}, {"dt": 0.0025}, {"dt": 0.000625},
        *({"dt": 0.02, "step_tolerance": tolerance} for tolerance in (1e-3, 3e-4, 1e-4)),
    ),
    "geometrically_exact": (
        {"dt": 0.01}, {}, {"dt": 0.00125}, {"dt": 0.000625},
        *({"dt": 0.01, "step_tolerance": tolerance} for tolerance in (1e-3, 3e-4, 1e-4)),
    ),
}  # fmt: skip


def actions_of(motion: str, count: int) -> Array:
    """Return the torque of each period, divided by its limit."""
    rng = np.random.default_rng(5)
    signs = np.cumprod(np.where(rng.random(count) < 0.2, -1.0, 1.0))
    calm = 0.02 * rng.uniform(-1.0, 1.0, count)
    if motion == "calm":
        return calm
    if motion.startswith("bang-bang"):
        return signs
    if motion.startswith("calm,"):
        return np.where(np.arange(count) < count // 2, calm / 3.0, signs)
    return rng.uniform(-1.0, 1.0, count)


def environment(motion: str, formulation: str, **options: Any) -> Any:
    """Make and reset the environment of a motion."""
    arm = arms.resolve("strip")
    if "bang-bang" in motion:
        assert arm.torque_limits is not None
        arm = dataclasses.replace(arm, torque_limits=(3.0 * arm.torque_limits[0],))
    if motion == "light payload":
        arm = dataclasses.replace(arm, payload=dataclasses.replace(arm.payload, mass=0.05 * arm.payload.mass))
    given = {"arm": arm, "formulation": formulation, "joint_limits": None, "duration": 1e4, **options}
    env = gym.make("FlexibleArm-v0", disable_env_checker=True, **given).unwrapped
    env.reset(seed=0, options={"start": 0.0, "target": 0.5})
    return env


def run(motion: str, formulation: str, options: dict[str, Any], periods: int, rounds: int = 5) -> dict[str, Any]:
    """Run a motion; return the errors that each period adds (over L), and steps and CPU time per period."""
    env = environment(motion, formulation, **options)
    batch: Batch = env.batch
    actions, state = actions_of(motion, periods), env.get_state()
    fine_settings = batch.settings.replace(dt=PERIOD / FINE, tolerance=1e-12)
    fine_settings = dataclasses.replace(fine_settings, step_tolerance=None)
    assert fine_settings.dt is not None
    fine = Simulation(standing_scene(batch.arm, fine_settings.dt, None), fine_settings)
    fine.par[:] = batch.parameters(0)
    errors = []
    for action in actions:
        q, v, _ = batch.motion(0)
        tip = env.step(np.array([action], np.float32))[4]["tip_position"]
        fine.work.q[:], fine.work.v[:] = q, v
        fine.t = 0.0
        fine.set_torques(batch.motion(0)[2])
        fine.advance_to(PERIOD, account=False)
        known = fine.observe()[0][-1, 6:8]
        errors.append(float(np.hypot(*(tip - known))) / batch.arm.total_length)
    least, steps = np.inf, 0.0
    for _ in range(rounds):
        env.set_state(state)
        before = batch.counts[0, 3]
        clock = time.process_time()
        for action in actions:
            batch.action[0, 0] = action
            batch.compiled_step(batch.address, 0, 1)
        least = min(least, time.process_time() - clock)
        steps = float(batch.counts[0, 3] - before)
    return {
        "motion": motion, "formulation": formulation, "options": options, "largest": max(errors),
        "rms": float(np.sqrt(np.mean(np.square(errors)))), "steps": steps / periods, "cpu": least / periods,
    }  # fmt: skip


def saved(rows: list[dict[str, Any]], tolerance: float = 1e-4) -> list[str]:
    """Compare the CPU time at a tolerance with that of the longest fixed step that meets it in all motions."""
    cells = []
    for formulation in WAYS:
        mine = [row for row in rows if row["formulation"] == formulation]
        fixed = [row for row in mine if "step_tolerance" not in row["options"]]
        worst: dict[float, float] = {}
        for row in fixed:
            dt = row["options"].get("dt", DEFAULT_OPTIONS[formulation]["dt"])
            worst[dt] = max(worst.get(dt, 0.0), row["largest"])
        enough = [dt for dt, error in worst.items() if error <= tolerance]
        if not enough:
            continue
        cpu = {
            (row["motion"], "step_tolerance" in row["options"]): 1e6 * row["cpu"]
            for row in mine
            if row["options"].get("step_tolerance") == tolerance
            or ("step_tolerance" not in row["options"] and row["options"].get("dt") == max(enough))
        }
        pairs = [f"{cpu[motion, True]:.2g} / {cpu[motion, False]:.2g}" for motion in MOTIONS]
        cells.append((formulation, f"{1e3 * max(enough):.3g}", *pairs))
    heads = f"CPU per control period, µs: adaptive / fixed steps, error {100 * tolerance:g} % | fixed step, ms | "
    return table(heads + " | ".join(MOTIONS), cells)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page, one per motion."""
    lines = {"summary": saved(found["rows"])}
    for motion in MOTIONS:
        rows = []
        for row in (row for row in found["rows"] if row["motion"] == motion):
            options = row["options"]
            dt = 1e3 * options.get("dt", DEFAULT_OPTIONS[row["formulation"]]["dt"])
            tolerance = options.get("step_tolerance")
            kind = f"at most {dt:.3g}" if tolerance else f"{dt:.3g}" + ("" if "dt" in options else " (default)")
            bound = f"{100 * tolerance:g}" if tolerance else "–"
            errors = f"{100 * row['largest']:.2g}", f"{100 * row['rms']:.2g}"
            rows.append((row["formulation"], kind, bound, *errors, f"{row['steps']:.1f}", f"{1e6 * row['cpu']:.2g}"))
        heads = "formulation | step, ms | tolerance | largest error | rms error | steps per period | CPU, µs per period"
        lines[motion] = table(heads, rows)
    return lines


def measure(options: argparse.Namespace) -> pages.Found:
    """Run all motions under all settings."""
    rows = []
    for motion, (formulation, ways) in itertools.product(MOTIONS, WAYS.items()):
        for way in ways:
            rows.append(run(motion, formulation, way, options.periods))
            print(json.dumps(rows[-1]), flush=True)
    within = all(row["largest"] <= row["options"].get("step_tolerance", np.inf) for row in rows)
    return {"rows": rows, "verdicts": {"no period with adaptive steps adds more error than its tolerance": within}}


if __name__ == "__main__":
    sys.exit(pages.run("fitted_steps", __doc__, measure, blocks, page="results/default_settings", periods=400))
