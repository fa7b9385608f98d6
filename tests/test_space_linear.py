"""Linear models of arms in space: against what the solver does, the plane, modes; held and free roots."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.compiler import SINGLE, uncompiled
from flexarm_env.linear import campbell, linearize, modes, static_equilibrium
from flexarm_env.physics.protocol import local_difference, retract
from flexarm_env.plotting import plot_campbell
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import cycloid
from tests import space_answers as answers
from tests.refusals import refuses, says
from tests.scene_tools import everything

Array = np.ndarray


def bent(**changes: Any) -> fx.Scene:
    """`three_dof` with a bent elbow, under gravity."""
    return everything(fx.Scene(
        "bent", arms.named("three_dof"), duration=1.0, dt=5e-4, gravity=(0.0, 0.0, -9.81), angles=(0.3, 0.6, 0.9),
        **changes,
    ))  # fmt: skip


@pytest.mark.slow
def test_a_model_about_a_bent_rest_has_its_modes_and_is_controllable() -> None:
    """Eigenvalues are those of `modes`; each of the six slowest motions is moved by the torques (Hautus)."""
    rest = static_equilibrium(bent(), elements=2)
    model = linearize(rest, gauges=[(1, 0.0), (2, 0.5, "torsion")])
    assert np.abs(model.rate).max() < 1e-6 * np.abs(model.A).max()
    known = modes(rest, 8, clamped=()).eigenvalues
    own = model.eigenvalues
    for value in known[np.abs(known) > 1.0]:
        assert np.abs(own - value).min() < 1e-5 * abs(value)
    slow = own[np.argsort(np.abs(own))][:18]
    size = np.abs(model.A).max()
    for value in slow:
        pencil = np.hstack([(value * np.eye(len(model.A)) - model.A) / size, model.B / np.abs(model.B).max()])
        scale = np.linalg.norm(pencil, axis=1, keepdims=True)
        assert np.linalg.svd(pencil / scale, compute_uv=False)[-1] > 1e-12
    assert model.inputs == ("torque0", "torque1", "torque2")
    assert {"joint2_rate", "deflection1_z", "twist2", "tip_z", "curvature1@0", "torsion2@0.5"} < set(model.outputs)


def after(simulation: Simulation, model: Any, changes: Array, torques: Array, end: float, about: Array | None) -> Any:
    """Where the solver comes to from the state moved by changes: coordinates; increments and rates about `about`."""
    other = Simulation(simulation.scene, simulation.settings)
    n, whole = len(changes) // 2, np.zeros(len(simulation.work.q))
    rows = [simulation.system.names.index(name) for name in model.states[:n]]
    other.work.q[:], other.work.v[:], other.t = simulation.work.q, simulation.work.v, simulation.t
    whole[rows] = changes[:n]
    uncompiled(retract)(SINGLE, other.model, other.work.q, 1.0, whole, None)
    other.work.v[rows] += changes[n:]
    u = simulation.work.u[: simulation.scene.arm.n_links].copy()
    u[: len(torques)] += torques
    other.set_torques(u)
    assert other.advance_to(simulation.t + end)
    if about is not None:
        uncompiled(local_difference)(SINGLE, other.model, about, other.work.q, whole)
    return other.work.q.copy(), np.concatenate([whole[rows], other.work.v[rows]])


@pytest.mark.slow
@pytest.mark.parametrize("root", ["pinned", "free", "swinging"])
def test_the_discrete_model_is_the_solver_s(root: str) -> None:
    """About a bent rest, held under gravity, of a free arm that tumbles, and of one that swings under a force that
    changes: columns of A and B by differences of the solver."""
    if root == "free":
        arm = arms.named("satellite_arm")
        scene = fx.Scene(
            "f", arm, duration=1.0, dt=1e-3, root="free", angles=(0.0, 0.5, -1.0), rates=(3.0, -2.0, 4.0),
        )  # fmt: skip
        simulation = Simulation(scene, scene.settings(elements=1, tolerance=1e-13))
    elif root == "swinging":
        load = fx.PointLoad(2, "tip", force_y=cycloid(5.0, 0.1))
        scene = dataclasses.replace(bent(), rates=(4.0, -3.0, 5.0), loads=(load,))
        simulation = Simulation(scene, scene.settings(elements=1, tolerance=1e-13))
    else:
        simulation = static_equilibrium(bent(), elements=1, tolerance=1e-13)
        scene = simulation.scene
    period = 3.0 * scene.dt
    model = linearize(simulation, discrete=period)
    n, m = len(model.x) // 2, len(model.inputs)
    first = scene.arm.n_links - m
    end, _ = after(simulation, model, np.zeros(2 * n), np.zeros(0), period, None)
    rng = np.random.default_rng(0)
    for j in range(5):
        change, torque = np.zeros(2 * n), np.zeros(scene.arm.n_links)
        joints = [i for i, name in enumerate(model.states) if name.startswith("joint")]
        change[joints] = rng.normal(size=len(joints)) * (j < 4)
        torque[first:] = rng.normal(size=m)
        size = 1e-5
        sides = [after(simulation, model, s * size * change, s * size * torque, period, end)[1] for s in (1.0, -1.0)]
        found = (sides[0] - sides[1]) / (2.0 * size)
        wanted = model.A @ change + model.B @ torque[first:]
        assert np.abs(found - wanted).max() < 2e-6 * np.abs(wanted).max(), j


@pytest.mark.slow
def test_a_planar_arm_in_space_has_the_planar_model_s_answer() -> None:
    """From torque to joint and tip, at a frequency between the first modes; the exact beam of the plane beside it."""
    section = fx.Section(EI=5.0, EA=1e6, C=1e6, m=0.4, J=1e-5, EI_y=20.0, C_y=1e6, J_y=1e-5, GJ=5.0)
    arm = fx.Arm("strip", (fx.Link(0.8, section),), hub_inertia=0.05, tau_d=2e-3, payload=fx.Payload(0.1, 1e-4))
    scene = fx.Scene("s", arm, duration=1.0, dt=1e-3, angles=(0.3,))
    plane = linearize(scene, "geometrically_exact", elements=8, order=3, gauges=[(0, 0.25)])
    space = linearize(dataclasses.replace(scene, space=True), elements=16, gauges=[(0, 0.25)])

    def answer(model: Any, names: tuple[str, ...], w: float) -> Array:
        s = 1j * w * np.eye(len(model.A)) - model.A
        rows = [model.outputs.index(name) for name in names]
        return (model.C[rows] @ np.linalg.solve(s, model.B))[:, 0]

    for w in (3.0, 20.0, 60.0):
        known = answer(plane, ("joint0", "deflection0", "tip_x", "tip_y", "curvature0@0.25"), w)
        found = answer(space, ("joint0", "deflection0_y", "tip_x", "tip_y", "curvature0@0.25"), w)
        np.testing.assert_allclose(found[:4], known[:4], rtol=2e-3)
        assert abs(found[4] / known[4] - 1.0) < 8e-3  # of second order in the mesh where inertia loads the elements


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"elements": 1}, {"formulation": "floating_frame", "segments": 1}])
def test_whirl_of_an_overhung_disc(options: dict[str, Any], tmp_path: Path) -> None:
    """Seen from rest. Damping within the shaft makes the forward whirl grow from the spin on that it whirls at (Kimball
    1924)."""
    spins = 0.0, 15.0, 16.0, 40.0, -16.0
    found = campbell(answers.rotor(), spins, 5, **options)
    for spin, seen, turning in zip(spins, found.at_rest, found.frequencies, strict=True):
        known = answers.whirl_of_the_rotor(spin)
        np.testing.assert_allclose(np.sort(seen), known if spin else np.abs(known)[[1, 2, 0, 3, 4]], rtol=2e-6)
        assert (np.isclose(np.abs(seen - spin), turning, 1e-12) | (seen == turning)).all()
    forward = [seen[(seen > 0.0)].min() for seen in found.at_rest[1:4]]
    assert forward[0] > 15.0 and forward[1] < 16.0 and found.growing.tolist() == [0, 0, 1, 1, 1]
    assert plot_campbell(found, tmp_path / "disc.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_blade_has_flap_in_both_frames_and_lag_in_its_own(tmp_path: Path) -> None:
    """Seen from rest lag has two frequencies, spin +- its own; in the plane it is that of the planar beam."""
    blade = fx.Section(EI=1.0, EA=1e6, C=1e6, m=1.0, J=1e-4, EI_y=3.0, C_y=1e6, J_y=3e-4, GJ=1e3)
    scene = fx.Scene("blade", fx.Arm("blade", (fx.Link(1.0, blade),)), duration=1.0, dt=1e-3)
    plane = campbell(scene, (0.0, 2.0), 1, "geometrically_exact", elements=4, order=3)
    space = campbell(dataclasses.replace(scene, space=True), (0.0, 2.0), 2, elements=8)
    np.testing.assert_allclose(space.frequencies[:, 0], plane.frequencies[:, 0], rtol=2e-4)
    assert np.isnan(space.at_rest[1, 0]) and np.isnan(plane.at_rest[1, 0])
    np.testing.assert_array_equal(space.at_rest[:, 1], space.frequencies[:, 1])
    plot_campbell(space, tmp_path / "blade.png")
    for spins, words in (((), "spins = ()"), ((1.0, math.nan), r"spins\[1\] = nan")):
        with pytest.raises(ValueError, match=words):
            campbell(scene, spins)
    refuses(r"spin = 1\.0: needs a pinned root and no gravity", lambda: campbell(bent(), (1.0,)))


@pytest.mark.slow
def test_what_a_spatial_linear_model_refuses() -> None:
    scene = bent()
    for make, words in (
        (lambda: linearize(scene, elements=1, gauges=[(1, 0.0, "yz")]), "gauges[0][2] = 'yz'"),
        (lambda: linearize(scene, elements=1, gauges=[(0, 0.0)]), "gauges[0][0] = 0: must be a flexible link"),
    ):
        says(words, make)
    assert math.isclose(linearize(scene, elements=1, discrete=0.01, method="zoh").dt or 0.0, 0.01)
