"""The geometrically exact beam: references, known answers, orders of convergence; strips thrown about."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import converged
from benchmarks.formulation_runs import center_of_mass, long_run
from flexarm_env import simulate
from flexarm_env.arms import named as named_arm
from flexarm_env.comparison import tip_error
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.scenes import named, reference, reference_names
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import pulse, sine
from tests.processes import uncompiled_tests
from tests.scene_tools import everything

from .oracle_exact import tips


def exact(scene: Scene, **options: Any) -> Any:
    run = simulate(everything(scene), "geometrically_exact", **options)
    assert run.status == "ok", run.message
    return run


@pytest.mark.slow
def test_uncompiled() -> None:
    """Tangent, mass, energy and damping, for every order (`uncompiled_exact.py`)."""
    uncompiled_tests("uncompiled_exact.py")


@pytest.mark.parametrize(
    ("name", "elements", "dt", "bound", "more"),
    [
        ("robot_arm_motion_smooth", 5, 0.005, 0.01, {}),
        ("robot_arm_motion", 5, 0.005, 0.02, {}),
        ("robot_arm_torque", 8, 0.005, 0.02, {}),
        ("flying_rod", 8, 0.005, 0.02, {}),
        ("two_link_motion", 5, 0.001, 0.02, {}),
        pytest.param("two_link_motion", 5, 0.005, 0.02, {"period_correction": True}, marks=pytest.mark.slow),
        ("two_link_free_flight", 5, 0.005, 0.02, {}),
    ],
)
def test_converged_solutions(name: str, elements: int, dt: float, bound: float, more: dict[str, Any]) -> None:
    """Quadratic elements. Loads of full size from one instant to the next send wave fronts along the beam, for which
    two scenes need 8 elements (5: 0.023 and 0.037). `two_link_motion` turns stiff links (44 rad/s, then 279) by 1.5 rad
    in 0.5 s: no mesh, a smaller step is what it needs (0.005: 0.036), or steps that keep the period (0.005: 0.017)."""
    scene = named(name)
    run = exact(scene, dt=dt, elements=elements, **more)
    assert converged.tip_error(name, run.t, run.tip) <= bound
    if name in reference_names():
        assert tip_error(run.t, run.tip, reference(name).columns).max_tip_error <= bound


@pytest.mark.slow
@pytest.mark.parametrize(
    ("corrected", "dt", "steps", "wobble"), [(False, 0.0025, 100_000, 1e-5), (True, 0.005, 10_000, 1e-4)]
)
def test_energy_of_free_flight_over_many_steps(corrected: bool, dt: float, steps: int, wobble: float) -> None:
    """Undamped, after the loads, whether periods are corrected or not; then twice the step for the order."""
    scene, rows = everything(named("flying_rod")), []
    for h in (dt, 2 * dt):
        options = {"dt": h, "rho_inf": 1.0, "period_correction": corrected}
        simulation = Simulation(scene, scene.settings("geometrically_exact", **options))
        assert simulation.advance_to(2.5, False)
        simulation.restart_at_kink()
        rows.append(long_run(simulation, steps))
        assert rows[-1]["status"] == 0 and rows[-1]["drift"] < 1e-5 and simulation.work.counts[2] == 0.0
    own, coarse = rows
    assert own["wobble"] <= wobble and own["drift"] <= 1e-6
    assert own["wobble_of_tenths"][-1] < 2.0 * own["wobble_of_tenths"][0]
    assert np.log2(coarse["wobble"] / own["wobble"]) == pytest.approx(2.0, abs=0.19 if corrected else 0.3)


def test_centre_of_mass_of_the_flying_rod() -> None:
    assert center_of_mass() < 1e-9


def test_quadratic_elements_converge_at_the_fourth_order() -> None:
    scene = named("robot_arm_motion_smooth")
    options = {"dt": 0.01, "sample": 0.5, "duration": 5.0}
    fine = exact(scene, elements=32, **options).tip[:, :2]
    errors = [np.abs(exact(scene, elements=n, **options).tip[:, :2] - fine).max() for n in (4, 8)]
    assert np.log2(errors[0] / errors[1]) >= 3.5


def test_second_order_in_time() -> None:
    scene = named("robot_arm_motion_smooth")
    runs = [exact(scene, elements=5, dt=dt, sample=0.5, duration=4.0).tip[:, :2] for dt in (0.02, 0.01, 0.005, 0.00125)]
    errors = [np.abs(run - runs[-1]).max() for run in runs[:-1]]
    # against a reference of finite step the ratio of a second-order method is (16^2 - 1) / (8^2 - 1) and so on
    assert np.log2(errors[0] / errors[1] * (63 / 255) * 4) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2] * (15 / 63) * 4) == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_two_links_against_finite_differences() -> None:
    """Hub and elbow torques, elbow mass and inertias, payload, large deflection; the other solution shares no code."""
    soft = Section(EI=400.0, EA=8e3, C=6e3, m=1.0, J=0.5)
    arm = Arm(
        "two", (Link(4.0, soft), Link(3.0, Section(EI=150.0, EA=6e3, C=5e3, m=0.8, J=0.3))),
        hub_inertia=5.0, elbows=(Elbow(0.5, 0.6, 0.4),), payload=Payload(0.7, 0.3),
    )  # fmt: skip
    drives = JointTorque(0, sine(60.0, 2.5, 0.3, None)), JointTorque(1, sine(-40.0, 3.5, 0.2, None))
    scene = Scene("two", arm, duration=2.0, dt=0.0025, sample=0.25, angles=(0.0, 0.5), loads=drives)
    run = exact(scene, elements=8, rho_inf=0.9)
    expected, doubt = tips(scene, 20, run.t[1:])
    assert np.abs(run.tip_deflection).max() > 0.1
    assert doubt < 0.02
    assert np.abs(run.tip[1:, :2] - expected).max() < max(0.003, 0.15 * doubt)


# --------------------------------------------------------------------- strips thrown about
UNDAMPED = dataclasses.replace(named_arm("strip"), tau_d=0.0)
EXACT = {"formulation": "geometrically_exact", "elements": 3}


def thrown(actions: np.ndarray, **options: Any) -> np.ndarray:
    """Tips (n, 2) of strips after actions (periods, n, 1): none is lost on the way, and none is repeated alone, in
    halved steps, because Newton failed in its lane."""
    envs = gym.make_vec("FlexibleArm-v0", num_envs=actions.shape[1], joint_limits=None, **options)
    envs.reset(seed=4)
    for action in actions:
        info = envs.step(action)[4]
        assert (info["solver_status"] == "ok").all() and (np.hypot(*info["tip_position"].T) < 1.01).all()
    assert envs.unwrapped.batch.repeats == 0
    return np.asarray(info["tip_position"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"arm": UNDAMPED, "nodes": 5},
        {"arm": UNDAMPED, **EXACT},
        *({"arm": "strip", "tolerance": tolerance, **EXACT} for tolerance in (1e-10, 1e-6, 1e-4)),
        {"arm": "strip", **EXACT, "elements": 5, "period_correction": True},
    ],
)
def test_strips_survive_random_full_torque(options: dict[str, Any], rng: np.random.Generator) -> None:
    """512 strips, 4 s, +-2 N m of random sign each 20 ms at 5 ms: none is lost, and none even needs its step halved."""
    signs = rng.choice([-1.0, 1.0], (199, 512, 1)).astype(np.float32)
    thrown(signs, dt=0.005, **options)


@pytest.mark.slow
def test_one_linear_solve_a_step_is_nearly_enough(rng: np.random.Generator) -> None:
    """From a guess that keeps the strains, one iteration meets a tolerance of 1e-4, and the tip hardly changes."""
    torques = rng.uniform(-1.0, 1.0, (199, 8, 1)).astype(np.float32)
    tips = [thrown(torques, dt=0.0025, arm=UNDAMPED, tolerance=x, **EXACT) for x in (1e-10, 1e-4)]
    assert np.hypot(*(tips[1] - tips[0]).T).max() < 1e-3


def test_a_torque_on_hardly_any_rotary_inertia_asks_for_no_halving() -> None:
    """At t = 0 on a free chain whose sections are all but without inertia: 1e5 rad/s^2, which no step resolves."""
    section = Section(EI=1.0, EA=1.6e5, C=5.4e4, m=1.0, J=6e-6)
    arm = Arm("chain", (Link(1.0, section),) * 2, hub_inertia=0.0)
    load = PointLoad(0, "root", pulse(0.1, 1.5), None, pulse(-0.06, 1.5))
    for dt in (0.036, 0.009):
        scene = Scene("thrown", arm, duration=2.0, dt=dt, sample=0.1, root="free", angles=(0.0, 0.0), loads=(load,))
        run = exact(scene, elements=4, rho_inf=0.9)
        assert run.halvings == 0 and run.iterations < 6 * run.steps


def test_torques_set_by_hand_ask_for_no_halving() -> None:
    """Accelerations solved afresh throw the prediction far: such a step begins again from where it was."""
    scene = everything(Scene("held", named_arm("strip"), duration=1.0, dt=0.0025, sample=0.02))
    simulation = Simulation(scene, scene.settings("geometrically_exact", elements=3, tolerance=1e-6))
    rng = np.random.default_rng(0)
    for k in range(50):
        simulation.set_torques(2.0 * np.sign(rng.standard_normal(1)))
        assert simulation.advance_to(0.02 * (k + 1))
    halvings, steps = simulation.work.counts[2:]
    assert halvings == 0 and steps == 400
