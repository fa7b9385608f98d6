"""Compare the floating frame with known solutions, and plot both: docs/results/physics.{md,json} and docs/figures/.

python -m benchmarks.physics_figures [--page] [--out FOLDER] [--figures FOLDER]

The cases are a spin-up past the first frequency, the center of mass and energy of free flight at rho_inf = 1 against
the step, and the order of the integrator. The exit code is 1 if a result is outside of its bounds.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import NullFormatter

from benchmarks import pages
from benchmarks.formulation_runs import known_path, slope
from benchmarks.machine import table
from flexarm_env.plotting import COLORS, FAINT, plot_trajectory, styled_figure
from flexarm_env.scenes import named, names, reference, reference_names
from flexarm_env.simulation import Trajectory, simulate
from flexarm_env.validation import Array

FLIGHTS: dict[str, dict[str, Any]] = {
    "flying_rod": {"segments": 4, "steps": [0.0125 / 2**k for k in range(5)], "long": 0.003125},
    "two_link_free_flight": {"segments": 2, "steps": [0.00125 / 2**k for k in range(5)], "long": 0.000625},
}
"""Free flights: segments per link, steps (s), and the step of a run eight times as long that must show no growth."""
ORDERS = ((1.0, 2), (0.9, 2), (0.6, 3))
"""Numerical damping rho_inf and number of segments of the runs that measure the integrator's order."""


def orders(steps: list[float], errors: list[float]) -> list[float]:
    """Return the order of convergence between each step and the next."""
    return [
        float(np.log(a / b) / np.log(h / k))
        for h, k, a, b in zip(steps[:-1], steps[1:], errors[:-1], errors[1:], strict=True)
    ]


# ----------------------------------------------------------------- spin-up
def spin_up(folder: Path) -> dict[str, Any]:
    """Measure the tip's lag in the spin-up for three couplings in root frames, and for the default chord frame."""
    spun: dict[str, Any] = {"segments": 1, "elements": 5, "sample": 0.02, "estimate_error": False}
    runs = {c: simulate(named("spin_up"), coupling=c, frame="root", **spun) for c in ("von_karman", "paper", "linear")}
    runs["von_karman, frame: chord"] = simulate(named("spin_up"), frame="chord", **spun)
    found: dict[str, Any] = {}
    with styled_figure(folder / "spin_up_lag.png", 7.5, 4.0) as figure:
        axes = figure.add_subplot()
        for color, (coupling, run) in zip(COLORS, runs.items(), strict=False):
            lag = 10.0 * run.tip_deflection[:, 0]
            axes.plot(run.t, lag, color=color, label=coupling if run.finished else f"{coupling}: {run.status}")
            fast = run.t > 16.0
            stretch = float((np.hypot(run.tip[fast, 0], run.tip[fast, 1]) - 10.0).mean()) if fast.any() else None
            found[coupling] = {"status": run.status, "reached": float(run.t[-1]), "deepest_lag": float(lag.min())}
            found[coupling] |= {"at": float(run.t[lag.argmin()]), "steady_stretch": stretch}
        axes.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
        axes.set(title="spin_up: deflection of the tip (m), one frame of 5 elements", xlabel="t (s)", ylim=(-1.0, 0.15))
        axes.legend(loc="lower right")
    return found


# ------------------------------------------------------------- free flight
def center_of_mass(run: Trajectory) -> Array:
    """Return the center of mass (n, 2), m, of uniform links of equal mass, by Simpson's rule over the drawn points."""
    elements = (run.shapes.shape[1] - 1) // 8
    weights = np.zeros(run.shapes.shape[1])
    for e in range(elements):
        weights[8 * e : 8 * e + 9] += np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) / 24 / elements
    return np.asarray(np.einsum("k,tkd->td", weights, run.shapes))


def free_energy(run: Trajectory) -> tuple[Array, Array]:
    """Return the instants, s, and the energy, J, after the loads have ended."""
    free = run.t > max(run.scene.kinks) + 1e-9
    return run.t[free], run.energy[free]


def free_flight(name: str, folder: Path) -> dict[str, Any]:
    """Measure the errors of the center of mass and the wobble of the energy against the step, without damping."""
    segments, steps = FLIGHTS[name]["segments"], FLIGHTS[name]["steps"]
    options: dict[str, Any] = {"segments": segments, "rho_inf": 1.0, "sample": 0.0125, "estimate_error": False}
    runs = [simulate(named(name), dt=h, **options) for h in steps]
    errors = [float(np.abs(center_of_mass(run) - known_path(name, run.t)).max()) for run in runs]
    energies = [free_energy(run) for run in runs]
    wobble = [float(energy.std()) for _, energy in energies]
    scene = named(name)
    long = simulate(
        scene, segments=segments, dt=FLIGHTS[name]["long"], rho_inf=1.0, sample=0.0125, duration=8 * scene.duration
    )
    windows = [float(part.std()) for part in np.array_split(free_energy(long)[1], 8)]
    title = f"{name}, {segments} segments per link, rho_inf = 1"
    with styled_figure(folder / f"{name}_conservation.png", 10.5, 4.2, title) as figure:
        convergence, path, energy_axes = figure.subplots(1, 3, gridspec_kw={"width_ratios": [1.0, 1.25, 1.25]})
        for color, label, values in ((COLORS[0], "centre of mass (m)", errors), (COLORS[1], "energy (J, rms)", wobble)):
            convergence.loglog(steps, values, "o-", color=color, ms=4, label=label)
        guide = errors[-1] * (np.array(steps) / steps[-1]) ** 2
        convergence.loglog(steps, guide * 1.6, "--", color=FAINT, lw=1.0, label="second order")
        convergence.set(title="error against the step", xlabel="h (s)")
        convergence.legend(loc="upper left")
        for color, run, h in list(zip(COLORS, runs, steps, strict=False))[:3]:
            apart = np.hypot(*(center_of_mass(run) - known_path(name, run.t)).T)
            path.semilogy(run.t[1:], np.maximum(apart[1:], 1e-16), color=color, lw=1.0, label=f"h = {h:.3g} s")
            t, energy = free_energy(run)
            energy_axes.plot(t, energy - energy.mean(), color=color, lw=0.8)
        path.set(title="centre of mass: distance from its path (m)", xlabel="t (s)")
        path.set_ylim(bottom=errors[2] * 1e-4)
        path.legend(loc="lower right")
        energy_axes.set(title="energy after the loads, less its mean (J)", xlabel="t (s)")
    return {
        "segments": segments, "steps": steps, "status": [run.status for run in runs],
        "center_of_mass_error": errors, "center_of_mass_order": slope(steps, errors),
        "energy": float(energies[-1][1].mean()), "energy_wobble_rms": wobble,
        "energy_order": slope(steps, wobble),
        "long_run": {"dt": FLIGHTS[name]["long"], "duration": float(long.t[-1]), "status": long.status,
                     "energy_wobble_rms_of_eighths": windows},
    }  # fmt: skip


# ------------------------------------------------------------------- order
def order_of_integrator(folder: Path) -> dict[str, Any]:
    """Measure rms errors on robot_arm_motion_smooth for several steps, relative to a run with a four times finer step.

    The errors are corrected for the error of the run with the finer step, which is of second order.
    """
    steps = [0.05 / 2**k for k in range(1, 6)]
    found = {}
    title = "robot_arm_motion_smooth: rms error against the step"
    with styled_figure(folder / "integrator_order.png", 9.0, 3.8, title) as figure:
        panels = figure.subplots(1, 3)
        quantities = {"tip": "tip (m)", "tip_velocity": "its velocity (m/s)", "joint_torque": "enforcing torque (N m)"}
        for color, (rho_inf, segments) in zip(COLORS, ORDERS, strict=False):
            runs = [
                simulate(named("robot_arm_motion_smooth"), dt=h, sample=0.1, segments=segments, rho_inf=rho_inf)
                for h in [*steps, steps[-1] / 4]
            ]
            for axes, (quantity, label) in zip(panels, quantities.items(), strict=True):
                values = [getattr(run, quantity)[1:] for run in runs]
                fine = steps[-1] / 4
                errors = [
                    float(np.sqrt(np.mean((value - values[-1]) ** 2))) / (1.0 - (fine / h) ** 2)
                    for h, value in zip(steps, values[:-1], strict=True)
                ]
                axes.loglog(steps, errors, "o-", color=color, ms=4, label=f"rho_inf = {rho_inf:g}, {segments} segments")
                axes.set(title=label, xlabel="h (s)")
                found[f"rho_inf {rho_inf:g}, {segments} segments, {quantity}"] = {
                    "steps": steps, "errors": errors, "orders": orders(steps, errors),
                }  # fmt: skip
        for axes in panels:
            low = axes.get_ylim()[0]
            axes.loglog(steps, 0.7 * low * (np.array(steps) / steps[-1]) ** 2, "--", color=FAINT, label="second order")
            axes.set_xticks([0.002, 0.005, 0.01, 0.02], ["0.002", "0.005", "0.01", "0.02"])
            axes.xaxis.set_minor_formatter(NullFormatter())
        panels[0].legend(loc="upper left")
    return found


# ------------------------------------------------------------------- scenes
def scenes(folder: Path) -> dict[str, str]:
    """Plot every named scene with eight segments per link."""
    status = {}
    for name in names():
        run = simulate(named(name), segments=8, dt=named(name).dt / 2)
        known = reference(name).columns if name in reference_names() else None
        plot_trajectory(run, folder / f"{name}.png", reference=known)
        status[name] = run.status
    return status


def verdicts(found: dict[str, Any]) -> dict[str, bool]:
    """Return the required properties, and whether each one holds."""
    spin, flights, order = found["spin_up"], found["free_flight"].values(), found["order"]
    stretch = spin["von_karman"]["steady_stretch"] / 5.143e-4 - 1.0
    windows = [f["long_run"]["energy_wobble_rms_of_eighths"] for f in flights]
    return {
        "spin-up, von_karman: largest lag -0.5735 +- 0.001 m": abs(spin["von_karman"]["deepest_lag"] + 0.5735) < 1e-3,
        "spin-up, paper: largest lag -0.5749 +- 0.001 m": abs(spin["paper"]["deepest_lag"] + 0.5749) < 1e-3,
        "spin-up, linear: diverged": spin["linear"]["status"] == "diverged",
        "spin-up: steady stretch 5.143e-4 m within 0.5 %": abs(stretch) < 5e-3,
        "free flight: error of the center of mass of second order": all(
            abs(f["center_of_mass_order"] - 2) < 0.2 for f in flights
        ),
        "free flight: error of the energy of second order": all(abs(f["energy_order"] - 2) < 0.3 for f in flights),
        "free flight: energy without growth": all(max(w[4:]) < 2.0 * max(w[:4]) for w in windows),
        "integrator of order 2 +- 0.1": all(abs(o["orders"][-1] - 2.0) < 0.1 for o in order.values()),
        "every named scene runs to its end": set(found["scenes"].values()) == {"ok"},
    }


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    spun = []
    for coupling, row in found["spin_up"].items():
        stretch = "–" if row["steady_stretch"] is None else f"{row['steady_stretch']:.4g}"
        lag = (f"{row['deepest_lag']:.4f}", f"{row['at']:.2f}") if row["status"] == "ok" else ("–", "–")
        spun.append((f"`{coupling}`", *lag, stretch, f"{row['status']}, {row['reached']:.3g} s"))
    halved = [(k, ", ".join(f"{o:.3f}" for o in v["orders"])) for k, v in found["order"].items()]
    lines = {
        "spin-up": table("coupling | largest lag, m | time of the largest lag, s | steady stretch, m | status", spun),
        "order": table("run | orders between halved steps", halved),
    }
    for name, row in found["free_flight"].items():
        cells = zip(row["steps"], row["center_of_mass_error"], row["energy_wobble_rms"], strict=True)
        rows = [(f"{h:.4g}", f"{com:.2e}", f"{rms:.2e}") for h, com, rms in cells]
        rows.append(("order", f"{row['center_of_mass_order']:.2f}", f"{row['energy_order']:.2f}"))
        long = row["long_run"]
        eighths = ", ".join(f"{rms:.1e}" for rms in long["energy_wobble_rms_of_eighths"])
        length = f"{long['duration']:g} s, step {long['dt']:g} s"
        lines[name] = [
            f"`{name}` has {row['segments']} segments per link and the energy {row['energy']:.3f} J:", "",
            *table("step, s | center of mass: largest error, m | energy: standard deviation, J", rows), "",
            f"In a run eight times as long ({length}), the standard deviation of the energy in each eighth of the "
                "run is "
            f"{eighths} J.",
        ]  # fmt: skip
    return lines


def measure(options: argparse.Namespace) -> pages.Found:
    """Run all measurements and plot them."""
    found: pages.Found = {
        "spin_up": spin_up(options.figures),
        "free_flight": {name: free_flight(name, options.figures) for name in FLIGHTS},
        "order": order_of_integrator(options.figures),
        "scenes": scenes(options.figures),
    }
    return {**found, "verdicts": verdicts(found)}


if __name__ == "__main__":
    sys.exit(pages.run("physics", __doc__, measure, blocks))
