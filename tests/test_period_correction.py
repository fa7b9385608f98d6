"""The exact beam's correction of the integrator's period, against known answers and the converged solutions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.stability_cases import cases, scene_of
from flexarm_env import scenes
from flexarm_env.compiler import SINGLE, uncompiled
from flexarm_env.linear import linearize, modes
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.exact.inertia import inertia_forces
from flexarm_env.physics.protocol import State, residual
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import constant, pulse
from tests.env_tools import assert_pair_same, pair
from tests.scene_tools import everything, tips_apart

EXACT = "geometrically_exact"
SECTION = Section(EI=30.0, EA=1e5, C=4e4, m=1.2, J=1e-3)
CHAIN = Arm(
    "chain", (Link(1.0, SECTION), Link(0.7, SECTION)), hub_inertia=0.3, elbows=(Elbow(0.4, 0.02, 0.03),),
    payload=Payload(0.2, 0.01),
)  # fmt: skip


def corrected(name: str, **options: Any) -> tuple[float, float]:
    """Largest tip error, as a share of the length, against a fine run without it, without and with the correction."""
    scene, sample = everything(scenes.named(name)), options["dt"]
    mesh = {"elements": 16, "rho_inf": 1.0}
    fine = simulate(scene, EXACT, dt=options["dt"] / 20, sample=sample, estimate_error=False, **mesh)
    errors = []
    for correction in (False, True):
        run = simulate(scene, EXACT, sample=sample, estimate_error=False, period_correction=correction, **options)
        assert run.finished and run.halvings == 0
        errors.append(tips_apart(run, fine))
    return errors[0], errors[1]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3])
def test_inertia_is_what_the_residual_has(order: int) -> None:
    scene = Scene("chain", CHAIN, duration=1.0, dt=0.01, loads=(PointLoad(1, "tip", force_y=constant(1.0)),))
    simulation = Simulation(everything(scene), scene.settings(EXACT, elements=2, order=order, period_correction=True))
    w, model, rng = simulation.work, simulation.model, np.random.default_rng(order)
    n, a = int(model.n), rng.normal(size=int(model.n))
    found, with_a, without, room = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(int(model.n_factor))
    inertia_forces(SINGLE, model, simulation.par, None, a, found)
    for r, x in ((with_a, a), (without, np.zeros(n))):
        uncompiled(residual)(SINGLE, model, simulation.par, State(w.q, w.v, x), w.u, r, room)
    assert np.abs(found - (with_a - without)).max() < 1e-13 * np.abs(found).max()


@pytest.mark.slow
def test_a_small_vibration_keeps_its_period() -> None:
    """A cantilever's first mode, from the eigenvalues of a step: (omega h)^3 / 12 of phase without, next to nothing
    with the correction, and of two orders more."""
    arm = Arm("beam", (Link(1.0, SECTION),))
    scene = everything(Scene("clamped", arm, duration=9.0, dt=0.01, motions=(Motion("joint0", constant(0.0)),)))
    omega = modes(scene, 1, EXACT).frequencies[0]
    errors: dict[bool, list[float]] = {False: [], True: []}
    for x in (0.4, 0.2, 0.1):
        for correction, found in errors.items():
            options = {"dt": x / omega, "rho_inf": 1.0, "period_correction": correction}
            factors = linearize(scene, EXACT, discrete=x / omega, **options).eigenvalues
            found.append(float(np.abs(factors - np.exp(1j * x)).min()))
    plain, kept = np.array(errors[False]), np.array(errors[True])
    assert plain == pytest.approx(np.array([0.4, 0.2, 0.1]) ** 3 / 12, rel=0.05)
    assert (kept < plain / [10, 40, 160]).all()
    assert (np.log2(kept[:-1] / kept[1:]) > 4.4).all()


@pytest.mark.slow
@pytest.mark.parametrize("tau_d", [0.0, 0.02])
def test_stable_at_any_step(tau_d: float) -> None:
    """No vibration about rest grows at rho_inf = 1, whether steps resolve all of them or none."""
    still = tuple(Motion(f"joint{k}", constant(0.0)) for k in range(2))
    scene = everything(Scene("clamped", replace(CHAIN, tau_d=tau_d), duration=900.0, dt=0.01, motions=still))
    for dt in (1e-5, 1e-3, 3e-2, 1.0):
        model = linearize(scene, EXACT, elements=2, discrete=dt, dt=dt, rho_inf=1.0, period_correction=True)
        assert np.abs(model.eigenvalues).max() < 1.0 + 1e-5  # differences of the solver


def test_a_free_spin_keeps_its_energy() -> None:
    """Turned by 0.1 rad a step, centrifugal force and all: no more is lost than without."""
    arm = Arm("rod", (Link(1.0, Section(EI=1e3, EA=1e6, C=1e6, m=1.0, J=1e-2)),))
    loads = (JointTorque(0, pulse((1.0 / 3.0 + 0.01) * 10.0, 0.5)),)
    scene, kept = everything(Scene("spin", arm, duration=9.0, dt=0.02, loads=loads)), []
    for correction in (False, True):
        simulation = Simulation(scene, scene.settings(EXACT, elements=4, period_correction=correction))
        assert simulation.advance_to(1.0)
        before = simulation.observe()[1].sum()
        assert simulation.advance_to(8.0)
        kept.append(simulation.observe()[1].sum() / before)
    assert kept == pytest.approx([1.0, 1.0], abs=1e-3)


@pytest.mark.parametrize("tolerance", [1e-10, 1e-4])
def test_damped_steps_are_solved(tolerance: float) -> None:
    """Material damping takes part in the iteration matrix; the turn that a pulse leaves is known from its impulse."""
    arm = Arm("damped", (Link(1.0, SECTION),), tau_d=0.1)
    scene = everything(Scene("damped", arm, duration=21.0, dt=0.01, loads=(JointTorque(0, pulse(0.01, 0.5)),)))
    options = {"elements": 4, "rho_inf": 1.0, "tolerance": tolerance, "period_correction": True}
    simulation = Simulation(scene, scene.settings(EXACT, **options))
    assert simulation.advance_to(20.0)
    turned = 0.01 * 0.5 / (1.2 / 3.0 + 1e-3) * (20.0 - 0.25)
    assert simulation.work.q[2] == pytest.approx(turned, rel=1e-4)


def averages(rho: float) -> tuple[float, float, float, float]:
    """alpha_f, alpha_m, beta and gamma of generalized-alpha."""
    af, am = rho / (1 + rho), (2 * rho - 1) / (rho + 1)
    gamma = 0.5 + af - am
    return af, am, 0.25 * (gamma + 0.5) ** 2, gamma


NEWMARK = [(0.25, 0.5), (1 / 6, 0.5), (0.36, 0.7), (0.5, 0.75), (1.0, 1.0)]


@pytest.mark.parametrize("option", [*({"newmark": pair} for pair in NEWMARK), {"rho_inf": 0.9}, {"rho_inf": 0.5}])
def test_period_error(option: dict[str, Any]) -> None:
    """From the amplification matrix of q, v, a and the averaged acceleration; Newmark's averages nothing."""
    af, am, beta, gamma = averages(option["rho_inf"]) if "rho_inf" in option else (0.0, 0.0, *option["newmark"])
    x = 0.02  # omega h
    ahead = np.array([[1, 0, 0, -x * x * beta], [0, 1, 0, -x * gamma], [1, 0, 1, 0], [0, 0, af - 1, 1 - am]])
    behind = np.array([[1, x, 0, x * x * (0.5 - beta)], [0, 1, 0, x * (1 - gamma)], [0, 0, 0, 0], [0, 0, af, -am]])
    angles = np.abs(np.angle(np.linalg.eigvals(np.linalg.solve(ahead, behind))))
    angle = angles[(angles > 0.5 * x) & (angles < 2 * x)][0]
    kappa, bound = Settings.make(EXACT, **option).period_error, 1e-3 if "newmark" in option else 2e-3
    assert (1 - angle / x) / x**2 == pytest.approx(kappa, rel=bound)


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.7, 0.4, 0.0])
def test_spectral_radius(rho: float) -> None:
    """Of the corrected step's formulas (6.2) on x'' = -w^2 x, h = 1."""
    af, am, beta, gamma = averages(rho)
    kappa = Settings.make(EXACT, rho_inf=rho).period_error
    alpha = beta * (1 - af) / (1 - am)
    for w2 in np.logspace(-4, 8, 200):
        columns = []
        for q, v, b in np.eye(3):
            a = -w2 * q
            ahead = q + v + (0.5 - beta) * b + beta * (af * a - am * b) / (1 - am)
            plain = -w2 * ahead / (1 + alpha * w2)
            shift = -2 * kappa * (plain - a) / (1 + alpha * w2)
            new_a = -w2 * (ahead + shift) / (1 + alpha * w2)
            new_b = ((1 - af) * new_a + af * a - am * b) / (1 - am)
            columns.append([-new_a / w2, v + (1 - gamma) * b + gamma * new_b, new_b])
        assert np.abs(np.linalg.eigvals(np.array(columns).T)).max() < 1.0 + 1e-7


@pytest.mark.parametrize(
    ("name", "options", "gain"),
    [
        pytest.param("robot_arm_motion_smooth", {"elements": 8, "dt": 0.05}, 15.0, marks=pytest.mark.slow),
        ("robot_arm_torque", {"elements": 16, "dt": 0.02}, 3.0),
        ("flying_rod", {"elements": 12, "dt": 0.05}, 3.0),
        ("two_link_free_flight", {"elements": 8, "dt": 0.005}, 5.0),
        ("two_link_motion", {"elements": 5, "dt": 0.005}, 2.0),
        ("two_link_motion", {"elements": 5, "dt": 0.0025}, 1.4),
    ],
)
def test_errors_of_the_step_fall(name: str, options: dict[str, Any], gain: float) -> None:
    plain, kept = corrected(name, **options)
    assert plain > gain * kept


def test_it_costs_few_iterations() -> None:
    """With a tolerance of 1e-6 Newton needs few iterations more than without."""
    for name in ("robot_arm_motion", "flying_rod", "two_link_motion"):
        scene, options = everything(scenes.named(name)), {"dt": 0.005, "tolerance": 1e-6, "estimate_error": False}
        counts = [simulate(scene, EXACT, period_correction=kept, **options).iterations for kept in (False, True)]
        assert counts[1] <= 1.35 * counts[0]


def test_what_a_jump_of_the_velocity_leaves_is_not_corrected() -> None:
    """A hub whose prescribed rate jumps by radians a second: if corrected, it gained energy and failed."""
    case = next(
        case for case in cases()
        if case["family"] == "period corrected" and case["drive"] == "jumps" and case["rho"] is None
        and case["amplitude"] == 10.0 and case["h"] == pytest.approx(1e-3)
    )  # fmt: skip
    scene, formulation, options = scene_of(case)
    run = simulate(everything(scene), formulation, estimate_error=False, **options)
    assert run.finished and run.halvings == 0
    assert run.balance.max() < 0.01 * np.abs(run.work).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "n", "more"),
    [
        ("FlexibleArm-v0", 9, {}),
        ("TwoLinkFlexArm-v0", 17, {"dt": 0.01, "tolerance": 1e-10}),
        ("FlexibleArm-v0", 5, {"step_tolerance": 2e-5, "dt": 0.02}),
        ("FlexibleArm-v0", 9, {"newton": "modified"}),
    ],
)
def test_any_number_of_arms_gives_the_same_bits(env_id: str, n: int, more: dict[str, Any]) -> None:
    unlike = {"payload": (0.1, 8.0), "EI": (0.4, 2.5)}
    exact = {"formulation": EXACT, "period_correction": True, "randomization": unlike, "duration": 0.4}
    assert assert_pair_same(pair(env_id, n, "NextStep", 2, **exact, **more), 30) >= n


def test_options() -> None:
    assert Settings.make(EXACT).period_correction is False
    assert Settings.make("elastica").period_correction is None
    with pytest.raises(ValueError, match="period_correction = 1: must be True or False"):
        Settings.make(EXACT, period_correction=1)
    for formulation in ("elastica", "floating_frame"):
        with pytest.raises(ValueError, match="period_correction: unknown option of"):
            Settings.make(formulation, period_correction=True)
