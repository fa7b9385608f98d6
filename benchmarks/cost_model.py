"""Compare the lowest possible cost of a time step with its measured cost: docs/results/cost_model.{md,json}.

    python -m benchmarks.cost_model [--page] [--out FOLDER]

`benchmarks.operations` counts the operations of a step. The machine's peak rate is measured with independent chains of
additions and multiplications. Then steps of 5 ms are timed, for one arm and for eight arms in the lanes of a vector
unit.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from benchmarks.operations import CASES, STEP, thrown
from flexarm_env.compiler.decorator import kernel
from flexarm_env.compiler.lanes import EIGHT, SINGLE, load, store
from flexarm_env.physics.integrator.step import advance
from flexarm_env.simulation import Simulation

CHAINS = 12
"""Number of independent chains, enough for two arithmetic units with a latency of four cycles each."""


@kernel
def _chains(lane, x, count):
    """Multiply each of 12 numbers per lane, then add to it, `count` times: 24 operations per repetition."""
    a0, a1, a2 = load(lane, x, 0), load(lane, x, 1), load(lane, x, 2)
    a3, a4, a5 = load(lane, x, 3), load(lane, x, 4), load(lane, x, 5)
    a6, a7, a8 = load(lane, x, 6), load(lane, x, 7), load(lane, x, 8)
    a9, b0, b1 = load(lane, x, 9), load(lane, x, 10), load(lane, x, 11)
    for _ in range(count):
        a0, a1, a2 = a0 * 0.999 + 1e-3, a1 * 0.999 + 1e-3, a2 * 0.999 + 1e-3
        a3, a4, a5 = a3 * 0.999 + 1e-3, a4 * 0.999 + 1e-3, a5 * 0.999 + 1e-3
        a6, a7, a8 = a6 * 0.999 + 1e-3, a7 * 0.999 + 1e-3, a8 * 0.999 + 1e-3
        a9, b0, b1 = a9 * 0.999 + 1e-3, b0 * 0.999 + 1e-3, b1 * 0.999 + 1e-3
    store(x, 0, a0 + a1 + a2 + a3 + a4 + a5 + a6 + a7 + a8 + a9 + b0 + b1)


def _best(function: Callable[[], Any], repeat: int = 15) -> float:
    """Return the shortest time of several calls, s; the first call, which may compile, is not timed."""
    function()
    times = []
    for _ in range(repeat):
        clock = time.perf_counter()
        function()
        times.append(time.perf_counter() - clock)
    return min(times)


def arithmetic_numbers() -> np.ndarray:
    """Return the array of numbers that `chain` works on."""
    return np.ones(CHAINS * len(EIGHT))


def chain(numbers: np.ndarray, count: int, lane: tuple[int, ...] = EIGHT) -> None:
    """Execute 24 multiplications and additions per lane, `count` times, without loads or stores between them."""
    numbers[:] = 1.0
    _chains(lane, numbers, count)


def ceiling(lane: tuple[int, ...]) -> float:
    """Measure the peak rate of one core: operations per second of all lanes together."""
    x, count = np.ones(CHAINS * len(lane)), 200_000
    return 2 * CHAINS * len(lane) * count / _best(lambda: chain(x, count, lane))


def step_time(arm_name: str, formulation: str, options: dict[str, Any], lane: tuple[int, ...]) -> float:
    """Measure the CPU time of a 5 ms step, s per arm: of a single arm, or of eight arms in lanes.

    The steps start from the same states as those whose operations `benchmarks.operations` counts.
    """
    simulation = thrown(arm_name, formulation, options)
    state, counters = simulation._flat[:-4], simulation._flat[-4:]
    start = np.concatenate([np.repeat(state, len(lane)), counters])
    par, flat, steps = np.repeat(simulation.par, len(lane)), start.copy(), 8

    def run(count: int) -> None:
        for _ in range(100):
            flat[:] = start
            advance(lane, simulation.model, None, par, flat, 0, 0.0, STEP, count, simulation.scheme, None)

    return (_best(lambda: run(steps)) - _best(lambda: run(0))) / (100 * steps * len(lane))


def in_lanes(runs: list[Simulation], steps: int = 50) -> list[float]:
    """Measure the CPU time, s, of `steps` steps of eight arms from the middle of each scene (minimum of 15 rounds)."""
    least = [np.inf] * len(runs)
    for run in runs:
        assert run.advance_to(0.5 * run.scene.duration)
    for _ in range(15):
        for i, run in enumerate(runs):
            flat = np.concatenate([np.repeat(run._flat[:-4], len(EIGHT)), run._flat[-4:]])
            par, moved = np.repeat(run.par, len(EIGHT)), run.n_motions
            clock = time.process_time()
            advance(EIGHT, run.model, run.drive, par, flat, moved, run.t, run.dt, steps, run.scheme, None)
            least[i] = min(least[i], time.process_time() - clock)
            assert np.isfinite(flat).all()
    return least


def counted() -> dict[str, dict[str, float]]:
    """Count the operations of all cases in a process without compilation."""
    environment = os.environ | {"FLEXARM_COMPILER": "python"}
    command = [sys.executable, "-m", "benchmarks.operations"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    one, eight = found["ceiling"]["1"] / 1e9, found["ceiling"]["8"] / 1e9
    rows = []
    for r in found["rows"]:
        scalar, lanes, wide = r["operations"] / one / 1e3, r["operations"] / eight / 1e3, ["–"] * 3
        if r["lane_us"] is not None:
            wide = [f"{lanes:.3f}", f"{r['lane_us']:.3f}", f"{r['lane_us'] / lanes:.1f}"]
        counts = f"{r['operations']:.0f} ({r['divide']:.0f})"
        single = f"{scalar:.2f}", f"{r['single_us']:.2f}", f"{r['single_us'] / scalar:.1f}"
        rows.append([r["case"], f"{r['iterations']:.1f}", counts, *single, *wide, f"{r['state_bytes']:.0f}"])
    heads = "case | iterations | operations (of them divisions) | ceiling, µs | one arm, µs | ratio | "
    ceilings = (
        f"The ceiling (highest measured rate) is {one:.2f} billion operations per second for one arm and "
        f"{eight:.1f} billion for eight arms in vector lanes."
    )
    return {
        "steps": [
            ceilings,
            "",
            *table(heads + "ceiling in lanes, µs | an arm in lanes, µs | ratio | bytes of state", rows),
        ]
    }


def measure(options: argparse.Namespace) -> pages.Found:
    """Count the operations and measure the times of all cases."""
    counts, rows = counted(), []
    for name, case in CASES.items():
        laneless = case[1] == "floating_frame"
        row = {"case": name, **counts[name], "single_us": 1e6 * step_time(*case, SINGLE)}
        rows.append(row | {"lane_us": None if laneless else 1e6 * step_time(*case, EIGHT)})
        print(json.dumps(rows[-1]), flush=True)
    return {"ceiling": {"1": ceiling(SINGLE), "8": ceiling(EIGHT)}, "rows": rows}


if __name__ == "__main__":
    sys.exit(pages.run("cost_model", __doc__, measure, blocks))
