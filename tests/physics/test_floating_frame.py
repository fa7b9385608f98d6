"""Known answers of the floating frame: spin-up, free flight, order of the integrator, frequencies, segments."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.physics_figures import center_of_mass, known_path
from flexarm_env.comparison import tip_error
from flexarm_env.linear import modes
from flexarm_env.parameters import Arm, Link, Payload, Section
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.scenes import named, reference
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import constant, sine
from flexarm_env.trajectory import Trajectory
from flexarm_env.validation import Array
from tests.processes import uncompiled_tests
from tests.scene_tools import everything, tips_apart


def orders(errors: list[float]) -> Array:
    """Orders of convergence between steps that are halved."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.slow
def test_equations_uncompiled() -> None:
    """With multipliers: residual, tangents, constraints, energies, losses and places against an oracle."""
    uncompiled_tests("physics/uncompiled_multipliers.py")


# ----------------------------------------------------------------- spin-up
@pytest.mark.parametrize(
    ("formulation", "options", "books"),
    [
        ("geometrically_exact", {"elements": 6, "dt": 0.005}, 1e-3),
        ("floating_frame", {"segments": 3, "frame": "chord"}, 1e-5),
        ("floating_frame", {"modes": 3, "frame": "chord"}, 1e-5),
        pytest.param("floating_frame", {"segments": 1, "elements": 5}, 1e-5, marks=pytest.mark.slow),
        pytest.param(
            "floating_frame", {"segments": 1, "elements": 5, "coupling": "paper"}, 1e-3, marks=pytest.mark.slow
        ),
    ],
)
def test_spin_up(formulation: str, options: dict[str, Any], books: float) -> None:
    """Deepest lag of the tip near 6.75 s; at full speed it is gone, and the stretch is m w^2 L^3 / 3 EA."""
    run = simulate(everything(named("spin_up")), formulation, sample=0.02, estimate_error=False, **options)
    deflection = run.tip_deflection[:, 0] * 10.0
    assert run.status == "ok"
    assert deflection.min() == pytest.approx(-0.5743 if "coupling" in options else -0.5739, abs=3e-4)
    assert run.t[deflection.argmin()] == pytest.approx(6.75, abs=0.05)
    assert np.abs(deflection[run.t > 15.0]).max() < 0.02
    assert np.abs(run.balance).max() < books * run.energy.max()
    if "modes" not in options:  # which do not stretch
        stretch = np.hypot(run.tip[:, 0], run.tip[:, 1])[run.t > 16.0] - 10.0
        assert stretch.mean() == pytest.approx(1.2 * 6.0**2 * 10.0**3 / (3 * 2.8e7), rel=5e-3)


@pytest.mark.slow
def test_spin_up_without_coupling_diverges() -> None:
    run = simulate(named("spin_up"), segments=1, elements=5, coupling="linear", frame="root")
    assert run.status == "diverged"
    assert 5.0 < run.t[-1] < 12.0
    assert all(np.isfinite(getattr(run, name)).all() for name in ("t", "tip", "q", "v", "kinetic", "strain_energy"))


# ------------------------------------------------------------- free flight
@cache
def flights(name: str) -> tuple[Trajectory, ...]:
    """Undamped runs with halved steps."""
    segments, dt = (2, 0.0125) if name == "flying_rod" else (1, 6.25e-4)
    options = {"segments": segments, "rho_inf": 1.0, "sample": 0.0125}
    return tuple(simulate(everything(named(name)), dt=dt / 2**k, **options) for k in range(3))


FLIGHTS = pytest.mark.parametrize("name", ["flying_rod", "two_link_free_flight"])


@FLIGHTS
def test_center_of_mass_is_on_its_path(name: str) -> None:
    errors = []
    for run in flights(name):
        assert run.finished
        errors.append(float(np.abs(center_of_mass(run) - known_path(name, run.t)).max()))
    assert orders(errors) == pytest.approx(2.0, abs=0.3)
    assert errors[-1] < 3e-4


@FLIGHTS
def test_energy_of_free_flight_stays(name: str) -> None:
    """Bounded after the loads end, second order, without growth."""
    wobbles = []
    for run in flights(name):
        free = run.energy[run.t > max(run.scene.kinks) + 1e-9]
        half = free.size // 2
        wobbles.append(float(free.std()))
        assert np.ptp(free) < 1e-3 * free.mean()
        assert free[half:].std() < 2.0 * free[:half].std()
        assert abs(free[half:].mean() - free[:half].mean()) < 1.5 * free[:half].std()
    assert orders(wobbles) == pytest.approx(2.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("flying_rod", {"segments": 4, "dt": 0.05}),
        ("two_link_free_flight", {"segments": 2, "dt": 0.0025}),
        ("flying_rod", {"segments": 4, "dt": 0.0125}),
        ("flying_rod", {"segments": 2, "elements": 2, "dt": 0.0125}),
        ("two_link_free_flight", {"segments": 2, "elements": 2, "dt": 0.0025}),
    ],
)
def test_multipliers_do_not_ring(name: str, options: dict[str, Any]) -> None:
    """Undamped, whatever the step: bounded energy, and multipliers that do not change sign from step to step."""
    scene = everything(named(name))
    simulation = Simulation(scene, scene.settings("floating_frame", multipliers=True, rho_inf=1.0, **options))
    rows, forces, energies = simulation.model.algebraic, [], []
    for k in range(1, round(scene.duration / options["dt"]) + 1):
        assert simulation.advance_to(k * options["dt"]), simulation.message
        simulation.restart_at_kink()
        if simulation.t > max(scene.kinks) + 1e-9:
            forces.append(simulation.work.q[rows].copy())
            energies.append(float(simulation.observe()[1].sum()))
    assert np.ptp(energies) < 0.01 * np.mean(energies)
    half = len(forces) // 2
    ringing = np.abs(np.diff(forces, 2, axis=0)).mean(axis=0)
    early = np.abs(np.diff(forces[:half], 2, axis=0)).mean(axis=0)
    assert (ringing < 2.0 * early).all()


# ------------------------------------------------------------------- order
@pytest.mark.parametrize(
    "options",
    [
        {"segments": 2, "rho_inf": 1.0},
        {"segments": 2, "rho_inf": 0.9},
        pytest.param(
            {"segments": 2, "newmark": (0.25, 0.5), "coupling": "paper", "frame": "root"}, marks=pytest.mark.slow
        ),
        {"segments": 2, "newmark": (0.25, 0.5)},
        {"segments": 3, "rho_inf": 0.6},
        pytest.param({"modes": 3, "rho_inf": 0.9, "duration": 3.0}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_integrator_is_of_second_order(options: dict[str, Any]) -> None:
    """Positions, velocities and enforcing torque of a smooth motion: 2 +- 0.1, measured against a fine step."""
    scene, options = everything(named("robot_arm_motion_smooth")), {"duration": 6.0, "estimate_error": False, **options}
    steps = [0.0125, 0.00625, 0.0015625]
    runs = [simulate(scene, dt=h, sample=0.1, **options) for h in steps]
    for name in ("tip", "tip_velocity", "joint_torque"):
        coarse, fine = (float(np.abs(getattr(run, name)[1:] - getattr(runs[-1], name)[1:]).max()) for run in runs[:-1])
        share = (steps[0] ** 2 - steps[2] ** 2) / (steps[1] ** 2 - steps[2] ** 2)  # the fine run has an error too
        assert 2.0 + np.log2(coarse / fine / share) == pytest.approx(2.0, abs=0.1), name


def test_work_of_newton() -> None:
    """Steps, iterations and factorisations are counted, and are as few as they should be."""
    run = simulate(everything(named("robot_arm_motion")), segments=5, elements=1, dt=0.05)
    assert (run.steps, run.halvings) == (180, 0)
    assert run.iterations < 3.2 * run.steps
    assert run.factorizations < run.iterations + run.steps + 10


@pytest.mark.slow  # compiles its own variant of the step
def test_modified_newton() -> None:
    """One factorisation a step, more iterations, the same answer. (What a tolerance of 1e-10 leaves after a slow
    contraction is small in length, not in the force of a stiff segment: 5e-7 of L in the end.)"""
    options = {"segments": 5, "elements": 1, "frame": "root", "dt": 0.05, "tolerance": 1e-12}
    run = simulate(named("robot_arm_motion"), **options)
    modified = simulate(named("robot_arm_motion"), newton="modified", **options)
    assert modified.factorizations < run.factorizations
    assert modified.iterations > run.iterations
    assert np.abs(modified.tip - run.tip).max() < 1e-6


# ---------------------------------------------------------------- segments
@pytest.mark.parametrize(
    ("segments", "elements", "coupling", "error"),
    [
        pytest.param(1, 5, "von_karman", 1.22, marks=pytest.mark.slow),
        pytest.param(2, 2, "paper", 0.42, marks=pytest.mark.slow),
        (4, 1, "von_karman", 0.052),
        pytest.param(5, 1, "paper", 0.071, marks=pytest.mark.slow),
        (5, 1, "von_karman", 0.030),
        (8, 1, "von_karman", 0.013),
    ],
)
def test_segments_approach_the_exact_beam(segments: int, elements: int, coupling: str, error: float) -> None:
    """Largest tip error (m) on robot_arm_motion, as an independent prototype of the same equations has it."""
    options = {"segments": segments, "elements": elements, "coupling": coupling}
    scene, dt = everything(named("robot_arm_motion")), 0.025 if segments == 8 else 0.05
    run = simulate(scene, dt=dt, frame="root", estimate_error=False, **options)
    found = tip_error(run.t, run.tip, reference("robot_arm_motion").columns)
    assert found.instants == 181
    assert found.max_tip_error == pytest.approx(error, abs=max(0.15 * error, 0.003))


# ------------------------------------------------------------------- shear
STUBBY = Section(EI=2.0, EA=400.0, C=80.0, m=0.5, J=0.0025)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::flexarm_env.linear.UnstableEquilibrium")
@pytest.mark.parametrize(("options", "EA"), [({}, 400.0), ({"modes": 2}, np.inf), ({"elements": 8}, None)])
def test_buckling_where_shear_matters(options: dict[str, int], EA: float | None) -> None:
    """A cantilever of EI / CL^2 = 0.025 under a load that keeps its direction, by the frequency that vanishes.

    The exact beam's equilibrium at a small deflection, force balance C (v' - (1 - P/EA) phi) = P phi and moment balance
    EI phi'' = -P v', gives P (1 + P/C - P/EA) = EI (pi / 2L)^2 (Haringx for EA = infinity); reduced segments do not
    stretch. One frame has it to first order in P/EA, the paper's coupling Engesser's load.
    """

    def square(load: float, **own: Any) -> float:
        push = PointLoad(0, "tip", force_x=constant(-load))
        arm = Arm("column", (Link(1.0, STUBBY),))
        scene = everything(Scene("column", arm, duration=1.0, dt=0.01, loads=(push,)))
        own = {"frame": "root", **own}
        return float((modes(scene, 1, "floating_frame", clamped=True, **own).eigenvalues[0] ** 2).real)

    def critical(**own: Any) -> float:
        low, high = 4.6, 4.8
        for _ in range(2):  # secant: the square is all but linear in the load
            a, b = square(low, **own), square(high, **own)
            low, high = low - a * (high - low) / (b - a), high
        return low

    euler, C = STUBBY.EI * np.pi**2 / 4.0, STUBBY.C
    if EA is None:
        known = (np.sqrt(1.0 + 4.0 * euler * (1 / C - 1 / STUBBY.EA)) - 1.0) / 2.0 / (1 / C - 1 / STUBBY.EA)
        assert critical(segments=1, **options) == pytest.approx(known, rel=0.01)
        assert critical(segments=1, coupling="paper", **options) == pytest.approx(euler / (1.0 + euler / C), rel=3e-4)
        return
    inverse = 1 / C - 1 / EA
    known = (np.sqrt(1.0 + 4.0 * euler * inverse) - 1.0) / 2.0 / inverse
    whole = np.isfinite(EA)  # all of a segment's bending: second order; two of its modes: first
    errors = [abs(critical(segments=n, **options) / known - 1.0) for n in ((4, 8, 16) if whole else (8, 16, 32))]
    assert errors[-1] < (1e-4 if whole else 1e-3)
    assert (orders(errors) > (1.8 if whole else 0.7)).all()


@pytest.mark.parametrize("EA", [400.0, pytest.param(4e5, marks=pytest.mark.slow)])
def test_segments_converge_where_shear_matters(EA: float) -> None:
    """EI / CL^2 = 0.025, deflection 0.7 L: nearer to the exact beam in second order, estimates with it.

    Chords of finer and finer segments keep an error of third order in the shear angle, which estimates do not hide.
    """
    section = Section(2.0, EA, 80.0, 0.5, 0.0025)
    arm = Arm("stubby", (Link(1.0, section),), hub_inertia=0.05, payload=Payload(0.1, 1e-3))
    loads = (JointTorque(0, sine(2.0, 8.0)),)
    scene = everything(Scene("stubby", arm, duration=0.6, dt=5e-4, sample=0.02, loads=loads))
    exact = simulate(scene, "geometrically_exact", elements=16, rho_inf=0.9, estimate_error=False)
    assert np.abs(exact.tip_deflection).max() > 0.5
    errors, reduced = [], []
    for n in (6, 12, 24):
        run = simulate(scene, "floating_frame", segments=n, frame="root", rho_inf=0.9)
        errors.append(tips_apart(run, exact))
        assert run.status == "ok" and errors[-1] < 2.0 * run.error_estimate
        if EA > 1e3:  # modes do not stretch
            options = {"segments": n, "modes": 2, "frame": "root", "rho_inf": 0.9, "estimate_error": False}
            run = simulate(scene, "floating_frame", **options)
            reduced.append(tips_apart(run, exact))
    for n in (6, 12, 24, 48):
        run = simulate(scene, "floating_frame", segments=n, rho_inf=0.9)
        error = tips_apart(run, exact)
        assert run.status == "ok" and error < 2.5e-4 and error < 2.0 * run.error_estimate
    assert errors[-1] < 1e-4
    assert (orders(errors) > 1.7).all()
    assert not reduced or (reduced[-1] < 1e-4 and (orders(reduced) > 1.5).all())
