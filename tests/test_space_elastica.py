"""The elastica in space: known answers, the planar elastica, momentum, order. Principles and matrices of it are in
`test_space.py`, every feature against the oracle in `test_feature_matrix_space.py`."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env import arms, scenes
from flexarm_env.compiler import SINGLE
from flexarm_env.linear import linearize, static_equilibrium
from flexarm_env.physics import assembly
from flexarm_env.physics.protocol import State
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant, pulse
from flexarm_env.validation import Array
from tests import space_answers as answers
from tests.scene_tools import everything

STRAINS = "elastica"


FREE = fx.Arm(
    "free", (fx.Link(0.6, answers.section(2.0, 1.0, J=1e-3)), fx.Link(0.5, answers.section(2.0, 1.0, J=1e-3))),
    elbows=(fx.Elbow(0.2, 1e-3, 1e-3, axis=(0.0, 1.0, 0.0)),),
)  # fmt: skip


@pytest.mark.slow
def test_it_is_the_planar_elastica_in_a_drawn_plane() -> None:
    """Two links that fall and bend by far; of converged strains and small steps, mounted in a drawn plane."""
    turn, s = Rotation.random(random_state=3), answers.section(5.0, 2.0, 9.0)
    when = {"duration": 0.3, "dt": 2.5e-4, "sample": 0.05}
    plane, scene = (answers.falling(t, s, s, when, payload=fx.Payload(0.3, 1e-3), tau_d=1e-3) for t in (None, turn))
    flat = fx.simulate(plane, STRAINS, nodes=8, estimate_error=False).tip[:, :2]
    found = fx.simulate(scene, STRAINS, nodes=8, estimate_error=False).tip[:, :3]
    assert np.abs(turn.inv().apply(found) - np.column_stack([flat, 0.0 * flat[:, 0]])).max() < 2e-6


@pytest.mark.slow
def test_its_order_in_time_is_two_and_it_agrees_with_the_exact_beam() -> None:
    scene = scenes.named("three_dof_slew")
    scene = everything(dataclasses.replace(scene, duration=0.2, sample=0.02))

    def tip(formulation: str, dt: float, **mesh: int) -> Array:
        found = fx.simulate(dataclasses.replace(scene, dt=dt), formulation, estimate_error=False, **mesh)
        return np.asarray(found.tip[:, :3])

    a, b, c = (tip(STRAINS, dt, nodes=5) for dt in (1e-3, 5e-4, 2.5e-4))
    assert 1.8 < math.log2(np.abs(a - b).max() / np.abs(b - c).max()) < 2.6
    other = tip("geometrically_exact", 2.5e-4, elements=24)
    assert np.abs((4.0 * c - b) / 3.0 - other).max() < 3e-4 * scene.arm.total_length


@pytest.mark.slow
def test_its_estimate_knows_what_weight_shears() -> None:
    """A link that hardly bends under a weight, and is sheared by it: the softest bending is another one."""
    soft = fx.Section(1.0, 200.0, 60.0, 1.0, 1e-3, EI_y=500.0, C_y=60.0, J_y=1e-3, GJ=5.0)
    arm = fx.Arm("sheared", (fx.Link(1.0, soft),), payload=fx.Payload(20.0, 0.1), tau_d=0.05)
    held = (fx.Motion("joint0", constant(0.0)),)
    scene = fx.Scene("s", arm, duration=1.0, dt=5e-3, gravity=(0.0, 0.0, -0.5), motions=held, space=True)
    run = fx.simulate(scene, STRAINS, nodes=5)
    beam = fx.simulate(scene, "geometrically_exact", elements=6, estimate_error=False)
    off = float(np.linalg.norm(run.tip - beam.tip, axis=1).max())
    assert off > 0.05 and off < run.error_estimate < 10.0 * off


@pytest.mark.slow
def test_energy_of_a_free_arm_does_not_drift() -> None:
    """Over 10^4 steps at rho_inf = 1. (Its momentum: `test_momentum_of_a_free_arm`.)"""
    load = fx.PointLoad(0, "root", force_y=pulse(3.0, 0.1), torque_x=pulse(0.2, 0.1))
    scene = fx.Scene("free", FREE, duration=10.0, dt=1e-3, sample=0.01, loads=(load,), root="free", space=True)
    run = fx.simulate(scene, STRAINS, nodes=4, rho_inf=1.0, estimate_error=False)
    assert run.finished
    late = run.t > 0.15
    energy = (run.kinetic + run.strain_energy)[late]
    half = len(energy) // 2
    assert abs(energy[:half].mean() - energy[half:].mean()) < 3e-3 * energy.mean()
    assert np.ptp(energy) < 0.01 * energy.mean()


@pytest.mark.slow
def test_momentum_of_a_free_arm() -> None:
    """Of an arm that was pushed: sum of inertial forces of its rates, M v, which `conserve` keeps, to round-off."""
    load = fx.PointLoad(0, "root", force_y=pulse(3.0, 0.1), torque_x=pulse(0.2, 0.1))
    scene = fx.Scene("free", FREE, duration=1.0, dt=2e-3, loads=(load,), root="free", space=True)
    simulation = Simulation(scene, scene.settings(STRAINS, nodes=4))
    model, found = assembly.physical(simulation.model), []
    for t in (0.2, 0.5, 1.0):
        assert simulation.advance_to(t)
        w, r, still = simulation.work, np.zeros(int(model.n)), np.zeros(int(model.n))
        room = np.zeros(int(model.n_factor))
        answers.residual(SINGLE, model, simulation.par, State(w.q, still, w.v), np.zeros_like(w.u), r, room)
        found.append(r[:3].copy())
    assert found[0] == pytest.approx([0.0, 0.3, 0.0], abs=1e-6)
    assert np.ptp(found, axis=0).max() < 1e-12


@pytest.mark.slow
def test_it_is_linearised_about_a_sagging_rest() -> None:
    """Eigenvalues of the state space under gravity, joints held by torques: two of four joints' are unstable."""
    scene = fx.Scene(
        "sag", arms.named("three_dof"), duration=1.0, dt=1e-3, gravity=(0.0, 0.0, -9.81), angles=(0.3, 0.6, -0.9)
    )
    ours, other = (
        np.sort(np.abs(np.linalg.eigvals(linearize(static_equilibrium(everything(scene), hold_joints=True, **how)).A)))
        for how in ({"formulation": STRAINS, "nodes": 5}, {"elements": 12})
    )
    assert ours[2:10] == pytest.approx(other[2:10], rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "thickness", "pull"), [(0.03, 0.004, 2.0), (0.004, 0.03, 28.0), (0.01, 0.008, 8.0)])
def test_a_loaded_strip_stays_at_rest(width: float, thickness: float, pull: float) -> None:
    """Inertia that is corrected for the step left less than none of motions in which torsion and the stiffer bending
    cancel: a stable rest was left by a tenth of the length within half a second."""
    section = fx.Section.rectangle(width, thickness, 70e9, 2700.0, 26e9)
    arm = fx.Arm("strip", (fx.Link(1.0, section),), hub_inertia=0.01, tau_d=1e-3)
    hold = fx.Motion("joint0", constant(0.3))
    load = pull * min(section.EI, section.EI_y)
    push = fx.PointLoad(0, "tip", force_y=constant(-load), force_z=constant(0.03 * load))
    for dt in (1e-3, 5e-4):
        scene = fx.Scene(
            "rest", arm, duration=1.0, dt=dt, sample=0.1, angles=(0.3,), space=True, start="held", motions=(hold,),
            loads=(push,),
        )  # fmt: skip
        run = fx.simulate(scene, STRAINS, nodes=6, estimate_error=False)
        assert run.status == "ok" and np.abs(run.tip - run.tip[0]).max() < 1e-12
