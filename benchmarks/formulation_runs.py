"""Measurements and figures of `benchmarks.formulations`, a function each: exact beam, elastica, reduction to modes."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import flexarm_env
from benchmarks.converged import tip_error
from flexarm_env.linear import static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.plotting import COLORS, FAINT, styled_figure
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.scenes import named, names
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import TimeFunction, constant
from flexarm_env.time_functions import steps as stairs
from flexarm_env.trajectory import Trajectory
from flexarm_env.validation import Array

STRIP = Section(EI=7.0, EA=7.2e6, C=2.3e6, m=0.277, J=2.7e-7)
SOFT = Section(EI=2.0, EA=2.0e6, C=1.0e6, m=0.5, J=1e-6)
ELBOW = Elbow(0.1, 0.01, 0.02)
ARMS = {
    "strip": Arm("strip", (Link(1.0, STRIP),), hub_inertia=0.05, payload=Payload(0.2)),
    "two strips": Arm("two strips", (Link(1.0, STRIP),) * 2, hub_inertia=0.05, elbows=(ELBOW,), payload=Payload(0.2)),
    "soft link": Arm("soft link", (Link(1.0, SOFT),), hub_inertia=0.05, payload=Payload(0.1)),
}
"""Slender, undamped arms of 1 m links: an aluminium strip 5 mm thick, two such strips, and a softer, heavier link."""
EXACT: dict[str, Any] = {"elements": 6, "order": 3, "rho_inf": 0.9}
"""Mesh of the exact beam with which slender arms are compared."""


def simulate(scene: Scene, formulation: str, **options: Any) -> Trajectory:
    """Simulate a scene without the error estimate, since the benchmarks measure the error."""
    run = flexarm_env.simulate(scene, formulation, estimate_error=False, error_limit=1.0, **options)
    assert run.status in ("ok", "out_of_range"), run.message
    return run


def slope(x: list[float], errors: list[float]) -> float:
    """Return the order of convergence: the slope of log(error) over log(x) by least squares."""
    return float(np.polyfit(np.log(x), np.log(errors), 1)[0])


def apart(a: Trajectory, b: Trajectory) -> Array:
    """Return the distance (n,) of two runs' tips at their common instants, as a share of the arm's length."""
    n = min(a.t.size, b.t.size)
    return np.asarray(np.hypot(*(a.tip[:n, :2] - b.tip[:n, :2]).T) / a.scene.arm.total_length)


# ------------------------------------------------------------------- exact beam
def exact_orders(folder: Path) -> dict[str, Any]:
    """Measure the tip error on robot_arm_motion_smooth against the mesh, for three element orders, and against the
    step."""
    scene = named("robot_arm_motion_smooth")

    def tip(elements: int, order: int, dt: float) -> Array:
        run = simulate(scene, "geometrically_exact", elements=elements, order=order, dt=dt, sample=0.5, duration=5.0)
        return run.tip[:, :2]

    fine, counts = tip(32, 3, 0.01), {1: [8, 16, 32, 64], 2: [4, 8, 16], 3: [2, 4, 8]}
    steps = [0.02, 0.01, 0.005, 0.0025]
    best = tip(5, 2, steps[-1] / 4)
    found: dict[str, Any] = {"mesh": {}, "steps": steps}
    title = "geometrically_exact on robot_arm_motion_smooth"
    with styled_figure(folder / "exact_orders.png", 8.5, 3.6, title) as figure:
        mesh, time = figure.subplots(1, 2)
        for color, (order, elements) in zip(COLORS, counts.items(), strict=False):
            errors = [float(np.abs(tip(n, order, 0.01) - fine).max()) for n in elements]
            found["mesh"][str(order)] = {
                "elements": elements,
                "errors": errors,
                "order": -slope(list(elements), errors),
            }
            mesh.loglog(elements, errors, "o-", color=color, ms=4, label=f"order {order}")
        # the reference's own error of second order is taken out
        errors = [float(np.abs(tip(5, 2, h) - best).max()) / (1 - (steps[-1] / 4 / h) ** 2) for h in steps]
        found |= {"step_errors": errors, "time_order": slope(steps, errors)}
        time.loglog(steps, errors, "o-", color=COLORS[0], ms=4, label="5 quadratic elements")
        guide = 0.6 * errors[-1] * (np.array(steps) / steps[-1]) ** 2
        time.loglog(steps, guide, "--", color=FAINT, label="second order")
        mesh.set(title="tip error against elements (m)", xlabel="elements")
        time.set(title="tip error against the step (m)", xlabel="h (s)")
        for axes, ticks in ((mesh, [2, 4, 8, 16, 32, 64]), (time, steps)):
            axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
            axes.set_xticks([], minor=True)
            axes.legend()
    return found


def known_path(name: str, t: Array) -> Array:
    """Return the known path (n, 2), m, of a free arm's center of mass.

    The arm of 10 kg is pulled along x: "flying_rod" by 8 N for 2.5 s, any other by 40 N for 0.5 s.
    """
    end, force = (2.5, 8.0) if name == "flying_rod" else (0.5, 40.0)
    pulled = np.minimum(t, end)
    x = 3.0 + force / 10.0 * (0.5 * pulled**2 + end * (t - pulled))
    return np.column_stack([x, np.full_like(t, 4.0)])


def center_of_mass() -> float:
    """Return the largest distance, m, of flying_rod's center of mass from its known path: 5 quadratic elements, step 5
    ms."""
    run = simulate(named("flying_rod"), "geometrically_exact", dt=0.005)
    total = np.zeros((run.t.size, 2))
    for e in range(5):  # a vertex each end; the mean of the interior function is 1 / (2 sqrt 3)
        left, inner, right = (run.q[:, 6 * e + k : 6 * e + k + 2] for k in (0, 3, 6))
        total += (0.5 * (left + right) + inner / (2 * np.sqrt(3))) / 5
    return float(np.abs(total - known_path("flying_rod", run.t)).max())


def long_run(simulation: Simulation, steps: int = 100_000) -> dict[str, Any]:
    """Record the energy (kinetic + strain) in every tenth step of a long run; return wobble and drift over the energy.

    Wobble is the largest energy minus the smallest; drift is the mean of the run's last tenth minus that of its first.
    """
    energies, start = [float(simulation.observe()[1].sum())], simulation.t
    for k in range(steps // 10):
        if not simulation.advance_to(start + 10 * (k + 1) * simulation.dt, False):
            break
        energies.append(float(simulation.observe()[1].sum()))
    values, tenth = np.array(energies) / energies[0], len(energies) // 10
    parts = np.array_split(values, 10)
    return {
        "dt": simulation.dt, "steps": steps, "status": simulation.status, "tolerance": simulation.settings.tolerance,
        "wobble": float(np.ptp(values)), "drift": float(abs(values[-tenth:].mean() - values[:tenth].mean())),
        "wobble_of_tenths": [float(np.ptp(part)) for part in parts],
        "mean_of_tenths": [float(part.mean() - values.mean()) for part in parts],
    }  # fmt: skip


def rod_energy(folder: Path) -> list[dict[str, Any]]:
    """Run flying_rod without loads over 1e5 undamped steps of several sizes; plot and return the energy's wobble and
    drift."""
    scene, rows = named("flying_rod"), []
    for dt, tolerance in ((0.01, 1e-10), (0.005, 1e-10), (0.0025, 1e-10), (0.0025, 1e-12), (0.00125, 1e-10)):
        simulation = Simulation(scene, scene.settings("geometrically_exact", dt=dt, rho_inf=1.0, tolerance=tolerance))
        assert simulation.advance_to(2.5)
        simulation.restart_at_kink()
        rows.append(long_run(simulation))
    _draw_energy(folder / "exact_energy.png", rows, "flying_rod, 5 quadratic elements, rho_inf = 1")
    return rows


def _draw_energy(path: Path, rows: list[dict[str, Any]], title: str) -> None:
    """Plot wobble and drift against the step, and the mean energy of each tenth of a run."""
    with styled_figure(path, 8.5, 3.4, title) as figure:
        left, right = figure.subplots(1, 2)
        rows = [row for row in rows if row["tolerance"] == rows[0]["tolerance"]]
        steps = [row["dt"] for row in rows]
        left.loglog(steps, [row["wobble"] for row in rows], "o-", color=COLORS[0], ms=4, label="wobble")
        left.loglog(steps, [row["drift"] for row in rows], "s-", color=COLORS[1], ms=4, label="drift")
        guide = 1.8 * rows[-1]["wobble"] * (np.array(steps) / steps[-1]) ** 2
        left.loglog(steps, guide, "--", color=FAINT, label="second order")
        left.set(title="energy over 1e5 steps, relative", xlabel="h (s)")
        left.set_xticks(steps, [f"{h:g}" for h in steps])
        left.set_xticks([], minor=True)
        left.legend()
        for color, row in zip(COLORS, rows, strict=False):
            label = f"h = {row['dt']:g} s"
            right.plot(range(1, 11), 1e6 * np.array(row["mean_of_tenths"]), "o-", color=color, ms=3, label=label)
        right.set(title="mean of each tenth of the run, 1e-6", xlabel="tenth", xticks=range(1, 11))
        low, high = right.get_ylim()
        right.set_ylim(low, high + 0.35 * (high - low))
        right.legend(loc="upper left", ncol=2)


# --------------------------------------------------------------------- elastica
def switched(values: Array, period: float) -> TimeFunction:
    """Return a torque that takes the given values one after the other, each for one period."""
    return stairs(np.arange(len(values)) * period, values)


TORQUES = {"random": ((2.0,), (2.0, 0.6)), "bang-bang": ((2.0,), (1.0, 0.3)), "slow": ((2.0,), (1.0, 0.3))}
"""Largest torques, N m, of hub and elbow: uniform random or of random sign every 20 ms, or of alternating sign every
0.5 s."""


def driven(arm: Arm, kind: str, seed: int) -> Scene:
    """Return a scene of 4 s with torques of the given kind."""
    rng, loads = np.random.default_rng(seed), []
    for k, size in enumerate(TORQUES[kind][arm.n_links - 1]):
        if kind == "slow":
            values = size * (-1.0) ** np.arange(8)
        else:
            values = rng.uniform(-size, size, 200) if kind == "random" else size * rng.choice([-1.0, 1.0], 200)
        loads.append(JointTorque(k, switched(values, 0.5 if kind == "slow" else 0.02)))
    return Scene("driven", arm, duration=4.0, dt=2.5e-3, sample=0.02, loads=tuple(loads))


def strips(folder: Path, seeds: int = 6) -> dict[str, Any]:
    """Measure the errors of the elastica on strips: mesh error (against 12 nodes), and total error against the exact
    beam."""
    nodes, steps = [3, 4, 5, 6, 7, 8, 10], [1e-2, 5e-3, 2.5e-3, 1.25e-3]
    found: dict[str, Any] = {"nodes": nodes, "steps": steps}
    for name in ("strip", "two strips"):
        for kind in TORQUES:
            row: dict[str, Any] = {"whole": [], "mesh": [], "step": [], "deflection": []}
            for seed in range(1 if kind == "slow" else seeds):
                scene = driven(ARMS[name], kind, seed)
                exact = simulate(scene, "geometrically_exact", dt=1.25e-4, **EXACT)
                runs = {n: simulate(scene, "elastica", nodes=n) for n in (*nodes, 12)}
                row["whole"].append(float(apart(runs[6], exact).max()))
                row["mesh"].append([float(apart(runs[n], runs[12]).max()) for n in nodes])
                fine = [simulate(scene, "elastica", nodes=10, dt=h) for h in steps]
                row["step"].append([float(apart(run, exact).max()) for run in fine])
                row["deflection"].append(float(np.abs(exact.tip_deflection).max()))
            found[f"{name}, {kind}"] = row
    title = f"elastica on strips: largest tip error in 4 s, median of {seeds} torques"
    with styled_figure(folder / "elastica_strip.png", 9.5, 3.8, title) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        rows = {key: row for key, row in found.items() if isinstance(row, dict)}
        for (key, row), color in zip(rows.items(), [*COLORS[:3], *COLORS[:3]], strict=True):
            style = "o-" if key.startswith("strip") else "s--"
            panels[0].semilogy(nodes, 100 * np.median(row["mesh"], axis=0), style, color=color, ms=4, lw=1.2, label=key)
            panels[1].loglog(steps, 100 * np.median(row["step"], axis=0), style, color=color, ms=4, lw=1.2)
        panels[0].set(title="mesh: against 12 nodes, step 2.5 ms (% of L)", xlabel="nodes per link")
        panels[1].set(title="step: 10 nodes, against the exact beam (% of L)", xlabel="h (s)")
        panels[1].set_xticks(steps, [f"{h:g}" for h in steps])
        panels[1].set_xticks([], minor=True)
        panels[0].legend(fontsize=8)
    return found


def release(h: float) -> Simulation:
    """Return the strip released from a static tip deflection of 20 %; only the hub's inertia holds its root."""
    arm = ARMS["strip"]

    def bent(force: float) -> Simulation:
        loads = (PointLoad(0, "tip", force_y=constant(force)),)
        return static_equilibrium(Scene("bent", arm, duration=1.0, dt=h, loads=loads), "elastica")

    force = brentq(lambda f: bent(f).observe()[0][0, 7] - 0.2, 1.0, 10.0, xtol=1e-10)
    scene = Scene("released", arm, duration=1.0, dt=h)
    simulation = Simulation(scene, scene.settings("elastica"))
    simulation.work.q[:] = bent(float(force)).work.q[: simulation.work.q.size]
    simulation.set_torques(np.zeros(1))
    return simulation


def elastica_energy(folder: Path) -> list[dict[str, Any]]:
    """Measure the energy of the released strip over 1e5 steps of several sizes."""
    rows = [long_run(release(h)) for h in (5e-3, 2.5e-3, 1.25e-3)]
    _draw_energy(folder / "elastica_energy.png", rows, "elastica, 6 nodes, released from a tip deflection of 20 % of L")
    return rows


def left_out() -> dict[str, dict[str, float]]:
    """Compare the estimated error of omitting stretch and shear with the measured error, over L, in every named
    scene."""
    found = {}
    for name in names():
        scene = named(name)
        run = simulate(scene, "elastica", nodes=10, dt=min(scene.dt, 0.001))
        error = tip_error(name, run.t, run.tip) / scene.arm.total_length
        found[name] = {"estimate": run.notes["stretch_and_shear"], "measured": error}
    return found


# ---------------------------------------------------------------- reduction to modes
SWEEPS = {
    "soft link": (0.03, 0.06, 0.1, 0.15, 0.2, 0.26, 0.33, 0.4, 0.5, 0.6),
    "strip": (0.1, 0.2, 0.3, 0.45, 0.6, 0.67, 0.8, 1.0, 1.3, 1.6),
    "two strips": (0.1, 0.2, 0.35, 0.53, 0.7, 0.9, 1.1, 1.3),
}
"""Hub torques, N m: 0.4 s forward, 0.4 s backward, then 0; the elbow's torque is 0.3 times the hub's."""


def _kept(rows: list[dict[str, Any]], links: int) -> dict[str, Any]:
    """Summarize runs of growing deflection: order of the error, error at 10 %, and deflection with an acceptable
    error."""
    good = [row for row in rows if row["status"] == "ok"]
    x, error = np.log([[row["deflection"], row["error"]] for row in good]).T
    allowed = np.log(2e-3 * (1.0 if links == 1 else 2.5))  # 0.2 % of L, with two links 0.5 %
    return {
        "rows": rows, "order": float(np.polyfit(x, error, 1)[0]),
        "error_at_10_percent": float(np.exp(np.interp(np.log(0.1), x, error))),
        "kept_up_to_percent": float(100.0 * np.exp(np.interp(allowed, error, x))),
    }  # fmt: skip


def reduction(folder: Path) -> dict[str, Any]:
    """Measure the tip error of links reduced to three modes, against deflection and time, over 5 s without damping.

    The reference is the exact beam. The plot shows modes in chord frames; results of modes clamped to the root are only
    returned.
    """
    found: dict[str, Any] = {}
    title = "floating_frame, modes = 3, against the exact beam"
    with styled_figure(folder / "modal_error.png", 9.5, 3.8, title) as figure:
        left, right = figure.subplots(1, 2)
        for color, (name, torques) in zip(COLORS, SWEEPS.items(), strict=False):
            arm = ARMS[name]
            rows: list[dict[str, Any]] = []
            clamped: list[dict[str, Any]] = []
            for torque in torques:
                loads = tuple(
                    JointTorque(k, switched(np.array([1.0, -1.0, 0.0]) * torque * (1.0, 0.3)[k], 0.4))
                    for k in range(arm.n_links)
                )
                scene = Scene("to and fro", arm, duration=5.0, dt=5e-4, sample=0.01, loads=loads)
                exact = simulate(scene, "geometrically_exact", **EXACT)
                for frame, kept in (("root", clamped), ("chord", rows)):
                    run = simulate(scene, "floating_frame", modes=3, rho_inf=1.0, frame=frame)
                    error = np.maximum.accumulate(apart(run, exact))
                    kept.append({
                        "torque": torque, "deflection": float(np.abs(exact.tip_deflection).max()),
                        "status": run.status, "error": float(error[-1]), "error_in_1_s": float(error[: 101][-1]),
                    })  # fmt: skip
                if torque in (torques[2], torques[5]):
                    part = 100 * rows[-1]["deflection"]
                    style = "-" if torque == torques[5] else "--"
                    right.semilogy(run.t, 100 * np.maximum(error, 1e-7), style, color=color, lw=1.1,
                                   label=f"{name}, {part:.1f} %")  # fmt: skip
            good = [row for row in rows if row["status"] == "ok"]
            x = [100 * row["deflection"] for row in good]
            left.loglog(x, [100 * row["error"] for row in good], "o-", color=color, ms=4, label=f"{name}, 5 s")
            left.loglog(x, [100 * row["error_in_1_s"] for row in good], "o:", color=color, ms=3, lw=0.9, label="1 s")
            found |= {name: _kept(rows, arm.n_links), f"{name}, clamped modes": _kept(clamped, arm.n_links)}
        left.axvline(25.0, color=FAINT, lw=0.8)
        left.text(24.0, 2e-4, "out of range", rotation=90, ha="right", va="bottom", fontsize=8, color=FAINT)
        left.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        left.set_xticks([], minor=True)
        left.set(title="largest tip error, % of L", xlabel="largest deflection of a link, % of its length")
        left.legend(fontsize=8)
        right.set(title="its growth with time, % of L", xlabel="t (s)", ylim=(1e-5, None))
        right.legend(fontsize=8, loc="lower right")
    return found
