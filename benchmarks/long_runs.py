"""Run a million steps of the strip under random bang-bang torque with zero net impulse, by every formulation.

Each pair of torques is the full torque of one sign, then of the other sign, for the same random time (0.1 to 0.6 s).
Some rows have a share of the full torque, since links that are reduced to modes as a whole bend too far under full
torque. Settings are the environments' defaults, except for the settings that a row names. The energy is checked each
time the torque switches.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.machine import table
from flexarm_env import arms
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import steps as stairs

TORQUE = 2.0
CONTROL = 0.02


def _row(label: str, formulation: str, share: float = 1.0, **options: Any) -> dict[str, Any]:
    return {"label": label, "formulation": formulation, "steps": 1_000_000, "share": share, "options": options}


LONG = (
    _row("elastica, rho_inf 1 (default)", "elastica"),
    _row("exact, rho_inf 0.7 (default)", "geometrically_exact"),
    _row("exact, half the step", "geometrically_exact", dt=0.00125),
    _row("exact, a quarter of the step", "geometrically_exact", dt=0.000625),
    _row("floating frame, rho_inf 0.9 (default)", "floating_frame"),
    _row("floating frame, clamped, 5 segments", "floating_frame", segments=5, frame="root"),
    _row("floating frame, joined by multipliers", "floating_frame", segments=2, frame="root", multipliers=True),
    _row("modes in 3 segments, 0.6 of the torque", "floating_frame", 0.6, modes=2, segments=3, dt=0.005),
    _row("modes in 3 clamped segments, 0.6 of it", "floating_frame", 0.6, modes=2, segments=3, frame="root", dt=0.005),
    _row("modes (default), 0.15 of the torque", "floating_frame", 0.15, modes=3, segments=1, dt=0.005),
    _row("modes, clamped, 0.15 of the torque", "floating_frame", 0.15, modes=3, segments=1, frame="root", dt=0.005),
)


def torques(end: float, seed: int = 0) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return instants (s) and values (N m) of a random bang-bang torque with zero net impulse."""
    rng = np.random.default_rng(seed)
    count = int(end / 0.2) + 2
    dwell = CONTROL * rng.integers(5, 31, count)
    sign = rng.choice([-1.0, 1.0], count)
    t = np.concatenate([[0.0], np.cumsum(np.repeat(dwell, 2))])[:-1]
    values = TORQUE * np.repeat(sign, 2) * np.tile([1.0, -1.0], count)
    keep = t < end
    return t[keep].round(9), values[keep]


def long_run(case: dict[str, Any]) -> dict[str, Any]:
    """Run one case; return its steps, status, created and lost energy over gross work, and largest deflection."""
    settings = Settings.make(case["formulation"], **DEFAULT_OPTIONS[case["formulation"]]).replace(**case["options"])
    assert settings.dt is not None
    end = case["steps"] * settings.dt
    t, values = torques(end)
    drive = JointTorque(0, stairs(t, case["share"] * values))
    arm = arms.named("strip")
    scene = Scene("long", arm, duration=end, dt=settings.dt, sample=end, loads=(drive,))
    simulation = Simulation(scene, settings)
    simulation.compile()
    clock = time.process_time()
    most = least = deflection = 0.0
    start = float(simulation.observe()[1].sum())
    for stop in [*t[1:].tolist(), end]:
        good = simulation.advance_to(stop)
        poses, energies = simulation.observe()
        found = float(energies.sum()) - start + simulation.work.books[1] - simulation.work.books[0]
        most, least = max(most, found), min(least, found)
        across = np.cos(poses[0, 2]) * poses[0, 7] - np.sin(poses[0, 2]) * poses[0, 6]
        deflection = max(deflection, abs(float(across)))
        if not good:
            break
        simulation.restart_at_kink()
    gross = simulation.gross
    return {
        "status": "ok" if simulation.status == 0 else simulation.message,
        "steps": int(simulation.work.counts[3]), "halvings": int(simulation.work.counts[2]),
        "iterations": int(simulation.work.counts[0]), "simulated": simulation.t, "dt": settings.dt,
        "gross_work": gross, "dissipated": float(simulation.work.books[1]),
        "found": float(most / gross), "taken": float(-least / gross), "at_end": float(found / gross),
        "deflection": deflection, "cpu_seconds": time.process_time() - clock,
    }  # fmt: skip


def table_of_long_runs(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Format the table of long runs."""
    lines = [
        (row["case"]["label"], f"{row['dt']:g}", row["steps"], row["halvings"], f"{row['found']:.1e}",
         f"{row['taken']:.1e}", f"{100 * row['deflection']:.0f} %", row["status"].split(";")[0],
         f"{row['cpu_seconds']:.1f}")
        for row in rows
    ]  # fmt: skip
    heads = (
        "run | step, s | steps | failed steps | energy gained | energy removed | largest deflection | status | CPU, s"
    )
    return table(heads, lines)
