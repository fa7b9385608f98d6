"""Estimated errors of runs in space: where meshes or steps are wrong alike, and what damping dissipates."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env.accuracy_space import mesh_factor, step_factor, witness
from flexarm_env.settings import Settings
from flexarm_env.time_functions import sine
from tests.scene_tools import everything

FORMULATIONS: dict[str, dict[str, Any]] = {
    "floating_frame": {"segments": 5}, "geometrically_exact": {"elements": 6}, "elastica": {"nodes": 6},
}  # fmt: skip


def chain(q: float, EI: float = 2.0, links: int = 2, payload: float = 0.3, tau_d: float = 0.0) -> fx.Arm:
    """Links of 0.5 m with q = EI / (C L^2) on a hub that turns about the vertical."""
    C = EI / (q * 0.25)
    section = fx.Section(
        EI=EI, EI_y=1.5 * EI, GJ=0.8 * EI, EA=3.0 * C, C=C, C_y=C, m=0.6, J=1e-4, J_y=1.5e-4
    )  # fmt: skip
    return fx.Arm(
        "chain", (fx.Link(0.5, section),) * links, hub_inertia=0.02, hub_axis=(0.0, 0.0, 1.0),
        elbows=(fx.Elbow(0.1, 1e-3, 1e-3, (0.0, 1.0, 0.0)),) * (links - 1),
        payload=fx.Payload(payload, 1e-3, (0.0, 0.03, 0.02)), tau_d=tau_d,
    )  # fmt: skip


def swing(arm: fx.Arm, torque: float, dt: float, duration: float = 0.4, gravity: float = 9.81) -> fx.Scene:
    """Sinusoidal torques of all joints under gravity."""
    n = arm.n_links
    loads = tuple(fx.JointTorque(k, sine(torque / 2**k, 9.0 + 3.0 * k)) for k in range(n))
    return everything(fx.Scene(
        "swing", arm, duration=duration, dt=dt, sample=0.02, gravity=(0.0, 0.0, -gravity), space=True,
        angles=(0.0, *[0.4] * (n - 1)), loads=loads,
    ))  # fmt: skip


def error(run: Any, elements: int, dt: float) -> float:
    """Distance of a run's tip from the exact beam's on a fine mesh, over the length; that beam is checked, too."""
    options: dict[str, Any] = {"rho_inf": 0.9, "estimate_error": False}
    fine, coarse = (
        fx.simulate(run.scene, "geometrically_exact", elements=elements // k, dt=dt * k, **options) for k in (1, 2)
    )

    def apart(a: Any, b: Any) -> float:
        return float(np.linalg.norm(a.tip - b.tip, axis=1).max() / run.scene.arm.total_length)

    found = apart(run, fine)
    assert apart(fine, coarse) < 0.5 * found  # a third of that is the fine one's own error
    return found


# ------------------------------------------------------------------ what damping dissipates
@pytest.mark.slow
@pytest.mark.parametrize("options", [{"segments": 5}, {"modes": 3}, {}], ids=["segments", "modes", "exact"])
def test_damping_of_stiff_links_dissipates(options: dict[str, Any]) -> None:
    """Stiff links (EI = 2e4 N m^2, tau_d = 2 ms) in steps of 1 ms: no step gains energy from damping, the sum is that
    of the elastica, whose strain rates are its coordinates' own, and the balance closes."""
    scene = swing(chain(1e-4, EI=2e4, links=3, tau_d=2e-3), 3.0, 1e-3)
    run = fx.simulate(scene, "floating_frame" if options else "geometrically_exact", **options)
    known = fx.simulate(scene, "elastica", dt=2.5e-4, estimate_error=False).dissipated[-1]
    assert run.status == "ok" and np.diff(run.dissipated).min() >= 0.0
    assert run.dissipated[-1] == pytest.approx(known, rel=0.03)
    assert np.abs(run.balance).max() < 2e-5 * run.turned_over


def test_a_stiff_damped_arm_is_not_rejected() -> None:
    """Stiffness of 2e6 N m^2: rates of strain are off by second order of the step, which the balance takes in."""
    scene = swing(chain(1e-4, EI=2e6, links=3, tau_d=2e-3), 3.0, 1e-3, duration=0.3)
    run: Any = fx.simulate(scene, "floating_frame", estimate_error=False, segments=2)
    assert np.diff(run.dissipated).min() >= 0.0
    assert run.error_parts["energy"] < 5e-5
    assert np.abs(run.unresolved_damping).max() > 1e-5  # there is something to take in
    change = run.energy - run.energy[0] + run.dissipated + run.unresolved_damping - run.work
    assert np.allclose(run.balance, change, rtol=0.0, atol=1e-12)


# ------------------------------------------------------------------ where meshes are wrong alike
@pytest.mark.slow
@pytest.mark.parametrize("options", [{"segments": 16}, {"modes": 3, "segments": 4}], ids=["segments", "modes"])
def test_frames_along_chords_know_what_they_miss_of_shear(options: dict[str, Any]) -> None:
    """q = 0.3: chords are off by the order of the squared shear angle on any mesh."""
    run = fx.simulate(swing(chain(0.3), 3.0, 1e-3), "floating_frame", error_limit=1.0, **options)
    off = error(run, 32, 2.5e-4)
    assert off > 2e-3
    assert off / 1.5 < run.error_estimate < 4.0 * off


@pytest.mark.slow
@pytest.mark.parametrize("q", [9e-5, 0.01])
def test_the_elastica_knows_what_it_misses_of_stretch_and_shear(q: float) -> None:
    """Its estimate goes with the load, whatever q: by the exact beam, or by softer links where these are slender."""
    parts = []
    for torque in (3.0, 0.03):
        scene = swing(chain(q), torque, 2e-3, gravity=0.0)
        run = fx.simulate(scene, "elastica", error_limit=1.0)
        off = error(fx.simulate(scene, "elastica", dt=2.5e-4, estimate_error=False), 32, 1.25e-4)
        parts.append(run.error_parts["stretch_and_shear"])
        assert off / 1.5 < run.error_estimate
        assert parts[-1] < 12.0 * off + 1e-4
    assert parts[1] < 0.05 * parts[0]


@pytest.mark.slow
def test_elements_longer_than_what_a_heavy_payload_bends_are_told() -> None:
    """1000 kg on a link of 2 N m^2: it bends within sqrt(EI/N), 1.4 cm, where 2 and 4 elements are wrong alike."""
    scene = swing(chain(1e-4, links=1, payload=1e3), 3.0, 5e-3)
    run = fx.simulate(scene, "geometrically_exact", elements=4, error_limit=1.0)
    off = error(run, 160, 1.25e-3)
    assert off > 0.5
    assert off / 1.5 < run.error_estimate


STILL = np.zeros((5, 4, 3))
T = np.linspace(0.0, 0.4, 5)


def test_what_runs_are_compared_with() -> None:
    """An exact beam for stubby frames and elasticas, of elements within sqrt(EI/N) for pulled links; else nothing."""
    slender, stubby = (swing(chain(q), 3.0, 1e-3) for q in (1e-6, 0.02))
    for name, options in FORMULATIONS.items():
        own = Settings.make(name, dt=1e-3, **options)
        assert witness(slender, own, T, STILL) == (None, True)
        found, fine = witness(stubby, own, T, STILL)
        assert fine and (found is None) == (name == "geometrically_exact")
        if found is not None:
            assert found.formulation == "geometrically_exact" and found.rho_inf == own.rho_inf
    heavy = swing(chain(1e-6, payload=1e3), 3.0, 1e-3)
    found, fine = witness(heavy, Settings.make("geometrically_exact", elements=4, dt=1e-3), T, STILL)
    reach = math.sqrt(0.8 * 2.0 / (1000.7 * 9.81))  # the softest is torsion, 0.8 EI
    assert fine and found is not None and found.elements == math.ceil(0.5 / reach)
    thin = swing(chain(1e-6, EI=1e-3, payload=1e3), 3.0, 1e-3)
    assert not witness(thin, Settings.make("geometrically_exact", elements=4, dt=1e-3), T, STILL)[1]


@pytest.mark.parametrize("n", range(2, 12))
def test_a_mesh_that_is_not_halved_has_its_own_factor(n: int) -> None:
    """Errors that go with the square of the elements' length: the estimate is half as much again as the error."""
    m = -(-n // 2)
    assert mesh_factor(n) * (1.0 / m**2 - 1.0 / n**2) == pytest.approx(1.5 / n**2)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_step_s_part_follows_the_order_that_is_seen(order: int) -> None:
    """Errors h^p: the estimate is half as much again as the error, of orders above the second that of the second."""
    growth = (4.0**order - 2.0**order) / (2.0**order - 1.0)
    assert step_factor(growth) * (2.0**order - 1.0) >= 1.5 * (1.0 - 1e-12)
    assert step_factor(1.0) == step_factor(0.5) == 1.5  # nothing is resolved: as far off as runs are apart


@pytest.mark.slow
def test_vibrations_that_no_step_resolves_count_whole() -> None:
    """A motion whose velocity jumps shakes links whose first vibration takes a tenth of a step."""
    scene = swing(chain(1e-3, EI=24.0), 0.5, 0.02)
    scene = dataclasses.replace(scene, motions=(fx.Motion("joint0", sine(0.3, 6.0)),), loads=scene.loads[1:])
    run = fx.simulate(scene, "geometrically_exact", elements=3)
    off = error(run, 24, 2.5e-4)
    assert off / 1.5 < run.error_estimate
