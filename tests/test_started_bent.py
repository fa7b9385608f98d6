"""Scenes that start at rest under their loads: they stay there, or go from there when they are let go."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.parameters import Arm, Joint, Link, Payload, Section
from flexarm_env.rest import NoEquilibrium
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant, steps
from tests.scene_tools import Method, every, everything

STRIP = Section(EI=2.0, EA=2e6, C=7e5, m=0.3, J=1e-7)
METHODS: list[Method] = [
    ("elastica", {"nodes": 8}),
    ("geometrically_exact", {"elements": 8}),
    ("floating_frame", {"segments": 8}),
    ("floating_frame", {"segments": 4, "multipliers": True}),
]


def bent(**more: Any) -> Scene:
    """A strip with a payload, clamped, under its weight and a load that ends at 0.2 s; bent by more than a third."""
    release = PointLoad(0, "tip", force_y=steps([0.0, 0.2], [-3.0, 0.0]))
    arm = Arm("a", (Link(1.0, STRIP),), payload=Payload(0.1))
    usual: dict[str, Any] = {"start": "equilibrium", "gravity": (0.0, -3.0), "loads": (release,),
                             "motions": (Motion("joint0", constant(0.0)),)}  # fmt: skip
    return everything(Scene("s", arm, **{"duration": 0.6, "dt": 1e-3, "sample": 0.01, **usual, **more}))


@every(METHODS, slow=("geometrically_exact", "floating_frame"))
def test_rest_until_it_is_let_go(formulation: str, options: dict[str, Any]) -> None:
    """At rest to round-off where `static_equilibrium` finds it; let go, it keeps the energy that it then has."""
    run = simulate(bent(), formulation, rho_inf=1.0, estimate_error=False, **options)
    still = run.t < 0.205
    assert run.finished and abs(run.tip_deflection[0, 0]) > 0.3
    assert np.abs(run.tip[still] - run.tip[0]).max() < 1e-9 and run.kinetic[still].max() < 1e-14
    loaded = dataclasses.replace(bent(), start="unloaded", loads=(PointLoad(0, "tip", force_y=constant(-3.0)),))
    rest = static_equilibrium(loaded, formulation, **options)
    np.testing.assert_allclose(run.tip[0, :2], rest.shape_points()[-1], atol=1e-8)
    energy = run.energy[~still]
    assert np.abs(energy - energy[0]).max() < 2e-3 * run.strain_energy[0]
    assert run.kinetic.max() > 0.2 * run.strain_energy[0]


def test_small_release_against_the_first_mode() -> None:
    """A small load let go: the tip swings as a cosine about rest, by what it was held by, at the first frequency."""
    load = PointLoad(0, "tip", force_y=steps([0.0, 0.1], [-0.02, 0.0]))
    run = simulate(bent(loads=(load,), gravity=None), "elastica", nodes=8, dt=2e-4, estimate_error=False)
    first = modes(bent(gravity=None, loads=(), start="unloaded"), 1, "elastica", nodes=8, clamped=True).frequencies[0]
    t = run.t[run.t >= 0.1] - 0.1
    held = -0.02 * 1.0 / (3.0 * STRIP.EI)
    assert run.tip[0, 1] == pytest.approx(held, rel=1e-4)
    np.testing.assert_allclose(run.tip[run.t >= 0.1, 1], held * np.cos(first * t), atol=0.03 * abs(held))


@pytest.mark.slow
def test_held_and_free_joints() -> None:
    """ "held": joints stand at `angles`, and a torque that holds keeps them there; "equilibrium": the arm hangs."""
    arm = Arm("a", (Link(0.6, STRIP), Link(0.4, STRIP)), payload=Payload(0.1))
    scene = Scene("s", arm, duration=0.3, dt=2e-3, sample=0.02, gravity=(0.0, -3.0), angles=(0.3, 0.1), start="held")
    held = static_equilibrium(dataclasses.replace(scene, start="unloaded"), "elastica", nodes=6)
    torques = held.joint_torques()
    holding = tuple(JointTorque(k, constant(float(torque))) for k, torque in enumerate(torques))
    run = simulate(dataclasses.replace(scene, loads=holding), "elastica", nodes=6, estimate_error=False)
    np.testing.assert_allclose(run.joint_angles[0], [0.3, -0.2], atol=1e-12)
    assert np.abs(run.tip - run.tip[0]).max() < 1e-7 and abs(run.tip_deflection[0, 0]) > 0.02
    falls = simulate(scene, "elastica", nodes=6, estimate_error=False)
    assert falls.tip[-1, 1] < falls.tip[0, 1] - 0.05 and falls.kinetic[0] == 0.0
    np.testing.assert_allclose(falls.tip[0], run.tip[0], atol=1e-9)
    hangs = simulate(dataclasses.replace(scene, start="equilibrium"), "elastica", nodes=6, estimate_error=False)
    np.testing.assert_allclose(hangs.tip[:, :2], [[0.0, -1.0]] * len(hangs.t), atol=1e-9)


@pytest.mark.slow
def test_behind_a_gear() -> None:
    """The motor is held where the gear gives, so that the joint sinks; friction holds what it can."""
    gear = Joint(stiffness=20.0, motor_inertia=1e-4, gear_ratio=10.0, friction_coulomb=2.0)
    arm = Arm("a", (Link(1.0, STRIP),), payload=Payload(0.1), joints=(gear,))
    scene = Scene("s", arm, duration=0.3, dt=2e-3, sample=0.02, gravity=(0.0, -3.0), start="held")
    run = simulate(scene, "elastica", nodes=6, estimate_error=False)
    np.testing.assert_allclose(run.motor_angles, 0.0, atol=1e-12)
    assert run.joint_angles[0, 0] < -0.02 and np.abs(run.tip - run.tip[0]).max() < 1e-8


def test_files_and_refusals() -> None:
    scene = bent()
    assert Scene.from_toml(scene.to_toml()) == scene and 'start = "equilibrium"' in scene.to_toml()
    assert "start" not in dataclasses.replace(scene, start="unloaded").to_toml()
    with pytest.raises(ValueError, match=r'^start = .rest.: must be one of .*"held"'):
        bent(start="rest")
    with pytest.raises(ValueError, match=r'^rates = \(1.0,\): must be 0 where start = "equilibrium": the arm rests'):
        bent(rates=(1.0,), motions=())
    with pytest.raises(ValueError, match=r'^start = .held.: must be "unloaded" where the root is free'):
        bent(start="held", root="free", motions=())
    turned = bent(motions=(), gravity=None, loads=(JointTorque(0, constant(1.0)),))
    with pytest.raises(NoEquilibrium, match=r'no equilibrium was found for the start of .*; start="held" holds'):
        simulate(turned, "elastica", nodes=8)


def hanging(EI: float) -> Scene:
    """A strip so soft that it hangs almost straight down from its held joint."""
    link = Link(1.0, Section(EI=EI, EA=1e6, C=1e6, m=0.3, J=1e-4))
    arm = Arm("soft", (link,), hub_inertia=0.1, payload=Payload(0.2), tau_d=0.01)
    return Scene("sag", arm, duration=0.01, dt=0.002, gravity=(0.0, -9.81), start="held")


def test_no_rest_of_held_joints_is_no_reason_to_hold_them() -> None:
    """Frames at the roots of its links find no rest, those in chords do."""
    with pytest.raises(NoEquilibrium, match=r'frame="root" \(frame="chord" bears more\); start="unloaded" lets'):
        simulate(hanging(0.05), "floating_frame", frame="root", estimate_error=False)
    assert simulate(hanging(0.05), "floating_frame", frame="chord", estimate_error=False).status == "ok"


def test_a_run_whose_companions_find_no_rest_has_an_estimate_without_them() -> None:
    """The coarser mesh of the error estimate found no rest, and `simulate` raised its error."""
    run = simulate(hanging(0.1), "floating_frame", frame="root")
    assert run.t[-1] == 0.01 and run.error_estimate > 0.05 and run.status == "inaccurate"


@pytest.mark.parametrize("frame", ["root", "chord"])
def test_sagging_arms_of_modes(frame: str) -> None:
    """Within the range of the reduction rest is found, and is that of `static_equilibrium`; beyond it the sentence says
    so, of an arm in the plane without a word of space."""

    def sagging(EI: float) -> Scene:
        link = Link(1.0, Section(EI=EI, EA=1e6, C=1e6, m=0.3, J=1e-4))
        arm = Arm("soft", (link,), hub_inertia=0.1, payload=Payload(0.2), tau_d=0.01)
        return Scene("sag", arm, duration=0.01, dt=0.005, gravity=(0.0, -9.81), start="held")

    options = {"formulation": "floating_frame", "modes": 2, "segments": 2, "frame": frame}
    for EI in (20.0, 3.0, 2.6):
        found = simulate(sagging(EI), **options, estimate_error=False).tip[0]
        still = static_equilibrium(dataclasses.replace(sagging(EI), start="unloaded"), **options)
        np.testing.assert_allclose(found[:2], still.shape_points()[-1], atol=1e-9)
    for EI in (1.9, 0.5):
        with pytest.raises(NoEquilibrium, match="beyond the valid range of the reduction to modes") as no:
            simulate(sagging(EI), **options)
        assert "space" not in str(no.value)
