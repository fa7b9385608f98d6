"""Properties that hold for any arm: what Hypothesis draws is a chain, its section, its load and how it is computed.

Few draws by default; the same properties over many draws are marked slow.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson

from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import pulse
from flexarm_env.trajectory import Trajectory
from tests.scene_tools import everything

EXACT = "geometrically_exact"
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "floating_frame": ("floating_frame", {"segments": 4}),
    EXACT: (EXACT, {"elements": 4}),
    "elastica": ("elastica", {"nodes": 6}),
}


def number(low: float, high: float) -> st.SearchStrategy[float]:
    """Evenly over the logarithm."""
    return st.floats(np.log(low), np.log(high), allow_nan=False).map(lambda x: float(np.exp(x)))


@st.composite
def arms(draw: st.DrawFn, links: int = 2) -> Arm:
    """One or more equal links, stubby to slender, light to heavy payloads."""
    n = draw(st.integers(1, links))
    EI, length, m = draw(number(0.1, 1e3)), draw(number(0.3, 3.0)), draw(number(0.05, 5.0))
    EA = EI / length**2 * draw(number(3e3, 3e5))
    section = Section(EI=EI, EA=EA, C=EA / 3.0, m=m, J=m * EI / EA)
    mass = m * length
    elbows = tuple(Elbow(0.2 * mass, 0.01 * mass * length**2, 0.01 * mass * length**2) for _ in range(n - 1))
    payload = draw(number(0.01, 2.0)) * mass
    return Arm(
        "drawn", (Link(length, section),) * n, hub_inertia=draw(number(0.05, 2.0)) * mass * length**2, elbows=elbows,
        payload=Payload(payload, 0.01 * payload * length**2),
    )  # fmt: skip


def first_period(arm: Arm) -> float:
    """About that of the clamped arm with its payload, s."""
    link = arm.links[0]
    total = sum(one.mass for one in arm.links) + sum(elbow.mass for elbow in arm.elbows)
    return float(2 * np.pi * np.sqrt(arm.total_length**3 * (arm.payload.mass + 0.25 * total) / (3 * link.section.EI)))


def swung(arm: Arm, share: float, steps: int, **more: Any) -> Scene:
    """A pulse of hub torque (share of EI / L) for a fifth of a period, then free to the end of half of one."""
    T = first_period(arm)
    torque = share * arm.links[0].section.EI / arm.total_length
    h = T / steps
    loads = (JointTorque(0, pulse(torque, 0.2 * T)),)
    return everything(Scene("drawn", arm, duration=0.5 * T, dt=h, sample=0.05 * T, loads=loads, **more))


def run(scene: Scene, method: str, **options: Any) -> Trajectory:
    formulation, own = METHODS[method]
    return simulate(scene, formulation, estimate_error=False, **{**own, **options})


shares = st.floats(-0.6, 0.6).filter(lambda x: abs(x) > 0.05)
angles = st.floats(-3.0, 3.0)
methods = st.sampled_from(sorted(METHODS))


# ------------------------------------------------------------- the properties
def energy_balances(arm: Arm, share: float, method: str) -> None:
    """What the drives give is there or was dissipated; damped or not."""
    arm = dataclasses.replace(arm, tau_d=0.002 * first_period(arm))
    found = run(swung(arm, share, 400), method, rho_inf=0.9)
    assert found.finished, found.message
    assert np.abs(found.balance).max() < 0.02 * found.turned_over
    assert (np.diff(found.dissipated) >= 0.0).all()


def momentum_balances(arm: Arm, share: float, angle: float, method: str) -> None:
    """The centre of mass of a free chain goes where the force sends it."""
    arm = dataclasses.replace(arm, payload=Payload(), elbows=())
    T, mass = first_period(arm), sum(link.mass for link in arm.links)
    force = share * arm.links[0].section.EI / arm.total_length**2
    load = PointLoad(0, "root", pulse(force, 0.2 * T), None, pulse(-0.3 * force * arm.total_length, 0.2 * T))
    steps = 6400 if method == "floating_frame" else 400  # constraints between segments keep momentum to O(h^2) only
    scene = Scene("thrown", dataclasses.replace(arm, hub_inertia=0.0), duration=0.5 * T, dt=T / steps, sample=0.1 * T,
                  root="free", angles=(angle,) * arm.n_links, loads=(load,))  # fmt: skip
    found = run(everything(scene), method, rho_inf=0.9)
    assert found.finished, found.message
    t, pushed = found.t, np.minimum(found.t, 0.2 * T)
    path = force / mass * (0.5 * pushed**2 + pushed * (t - pushed))
    centre = centre_of_mass(found)
    moved = max(float(np.abs(path).max()), 1e-6)
    np.testing.assert_allclose(centre[:, 0] - centre[0, 0], path, atol=4e-3 * moved)
    np.testing.assert_allclose(centre[:, 1] - centre[0, 1], 0.0, atol=4e-3 * moved)


def centre_of_mass(found: Trajectory) -> np.ndarray[Any, Any]:
    """Of uniform links, (n, 2), over the points drawn."""
    return np.asarray(simpson(found.shapes, dx=1.0 / (found.shapes.shape[1] - 1), axis=1))


def time_runs_back(arm: Arm, share: float, method: str) -> None:
    """Undamped and with rho_inf = 1, reversed velocities lead back."""
    scene = swung(arm, share, 200)
    formulation, own = METHODS[method]
    simulation = Simulation(scene, scene.settings(formulation, **{**own, "rho_inf": 1.0, "tolerance": 1e-12}))
    T = first_period(arm)
    assert simulation.advance_to(0.2 * T)
    simulation.set_torques(np.zeros(arm.n_links))  # a fresh start: what the integrator has filtered is forgotten
    at, v = simulation.work.q.copy(), simulation.work.v.copy()
    assert simulation.advance_to(0.3 * T)
    simulation.work.v[:] *= -1.0
    simulation.set_torques(np.zeros(arm.n_links))
    assert simulation.advance_to(0.4 * T)
    size = max(1.0, float(np.abs(at).max()))
    np.testing.assert_allclose(simulation.work.q, at, atol=1e-6 * size)
    np.testing.assert_allclose(simulation.work.v, -v, atol=1e-4 * max(1e-3, float(np.abs(v).max())))


def place_does_not_matter(arm: Arm, share: float, angle: float, x: float, method: str) -> None:
    """Turned and moved, with gravity, a scene gives the same motion turned and moved."""
    g = share * 3.0 * arm.links[0].section.EI / (arm.total_length**3 * arm.links[0].section.m)
    here = swung(arm, share, 100, gravity=(0.0, -g))
    c, s = np.cos(angle), np.sin(angle)
    there = swung(arm, share, 100, gravity=(g * s, -g * c), position=(x, -x), angles=(angle,) * arm.n_links)
    one, other = run(here, method, tolerance=1e-12), run(there, method, tolerance=1e-12)
    assert one.status == other.status
    turned = one.tip[:, :2] @ np.array([[c, s], [-s, c]]) + np.array([x, -x])
    np.testing.assert_allclose(other.tip[: len(turned), :2], turned, atol=1e-5 * arm.total_length)


def small_deflections_agree(arm: Arm, share: float) -> None:
    """Where deflections are small all formulations are one beam."""
    section = dataclasses.replace(arm.links[0].section, J=0.0)
    stiff = 1e5 * section.EI / arm.links[0].length ** 2
    slender = dataclasses.replace(section, EA=stiff, C=stiff)
    arm = dataclasses.replace(arm, links=tuple(dataclasses.replace(link, section=slender) for link in arm.links[:1]),
                              elbows=())  # fmt: skip
    scene = swung(arm, 0.1 * share, 400)
    runs = [run(scene, method, rho_inf=0.9) for method in METHODS]
    runs.append(simulate(scene, "floating_frame", modes=3, rho_inf=0.9, estimate_error=False))
    deflection = max(float(np.abs(one.tip_deflection).max()) for one in runs) * arm.total_length
    for other in runs[1:]:
        assert other.finished, other.message
        np.testing.assert_allclose(other.tip[:, :2], runs[0].tip[:, :2], atol=0.05 * deflection)


def units_do_not_matter(arm: Arm, share: float, method: str) -> None:
    """Metre, kilogram, second or millimetre, tonne, second: the same motion."""
    si = run(swung(arm, share, 100), method, tolerance=1e-11)
    s = arm.links[0].section
    section = Section(EI=s.EI * 1e6, EA=s.EA, C=s.C, m=s.m * 1e-6, J=s.J)
    inertia = 1e3  # t mm^2 from kg m^2
    scaled = dataclasses.replace(
        arm, links=tuple(Link(link.length * 1e3, section) for link in arm.links), hub_inertia=arm.hub_inertia * inertia,
        payload=Payload(arm.payload.mass * 1e-3, arm.payload.inertia * inertia),
        elbows=tuple(Elbow(e.mass * 1e-3, e.inertia_left * inertia, e.inertia_right * inertia) for e in arm.elbows),
    )  # fmt: skip
    mm = run(swung(scaled, share, 100), method, tolerance=1e-11)
    np.testing.assert_allclose(mm.t, si.t, rtol=1e-9)
    np.testing.assert_allclose(mm.tip[:, :2] * 1e-3, si.tip[:, :2], atol=1e-5 * arm.total_length)
    np.testing.assert_allclose(mm.energy * 1e-3, si.energy, rtol=1e-4, atol=1e-6 * float(si.energy.max()))


PROPERTIES: dict[str, tuple[Callable[..., None], dict[str, st.SearchStrategy[Any]]]] = {
    "energy": (energy_balances, {"arm": arms(), "share": shares, "method": methods}),
    "momentum": (momentum_balances, {"arm": arms(), "share": shares, "angle": angles, "method": methods}),
    "reversal": (time_runs_back, {"arm": arms(1), "share": shares, "method": st.sampled_from(["elastica", EXACT])}),
    "place": (
        place_does_not_matter,
        {"arm": arms(), "share": shares, "angle": angles, "x": angles, "method": methods},
    ),
    "agreement": (small_deflections_agree, {"arm": arms(1), "share": shares}),
    "units": (units_do_not_matter, {"arm": arms(), "share": shares, "method": methods}),
}  # fmt: skip


@pytest.mark.parametrize("name", PROPERTIES)
@pytest.mark.parametrize("draws", [6, pytest.param(150, marks=pytest.mark.slow)])
def test_property(name: str, draws: int) -> None:
    check, drawn = PROPERTIES[name]
    settings(max_examples=draws)(given(**drawn)(check))()
