"""Linear models and modes against known answers and against the nonlinear solver itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms, scenes
from flexarm_env.linear import LinearModel, Modes, linearize, modes, set_state, state_of, static_equilibrium
from flexarm_env.parameters import Arm, Joint, Link, Payload, RigidLink, Section
from flexarm_env.physics.assembly import assemble
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import constant, cycloid, pulse, ramp
from tests.differences import central
from tests.linear_tools import ALL, ELASTICA, FULL, SLENDER, at_rest, one_link, two_links, unloaded
from tests.refusals import refuses
from tests.scene_tools import TWO, every, everything
from tests.scene_tools import scene as scene_of


# ------------------------------------------------------------------------------------- linearize
def moving(name: str, formulation: str, options: dict[str, Any]) -> Simulation:
    """A named scene in the middle of its motion: bent, turning and accelerating."""
    scene = scenes.named(name)
    if name == "robot_arm_torque":  # within the range of a reduction to modes
        scene = replace(scene, loads=(JointTorque(0, pulse(8.0, 2.5)),))
    simulation = Simulation(everything(scene), scene.settings(formulation, **options))
    assert simulation.advance_to(8 * simulation.dt)
    return simulation


def copied(simulation: Simulation, scene: Scene | None = None, **changes: Any) -> Simulation:
    """Another one in the same state; changes: of its settings."""
    copy = Simulation(scene or simulation.scene, simulation.settings.replace(**changes))
    copy.t = simulation.t
    copy.work.q[:], copy.work.v[:] = simulation.work.q, simulation.work.v
    return copy


def stepped(simulation: Simulation, x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
    """What the solver makes of a state in a period, with torques u on the first joints that can be driven."""
    scene = simulation.scene
    others = tuple(load for load in scene.loads if not isinstance(load, JointTorque))
    torques = tuple(JointTorque(k, constant(value)) for k, value in u)
    copy = copied(simulation, replace(scene, loads=(*others, *torques)))
    set_state(copy, x)
    assert np.abs(state_of(copy) - x).max() < 1e-9 * max(1.0, np.abs(x).max())
    assert copy.advance_to(simulation.t + dt)
    return state_of(copy)


def differences(model: LinearModel, simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Next state, and its derivatives by fourth-order differences of the nonlinear solver."""
    dt, x0 = model.dt, model.x
    assert dt is not None
    joints = [int(name.removeprefix("torque")) for name in model.inputs]
    n, columns = len(x0), []

    def after(z: np.ndarray) -> np.ndarray:
        return stepped(simulation, z[:n], list(zip(joints, z[n:], strict=True)), dt)

    z0 = np.concatenate([x0, model.u])
    for i, way in enumerate(np.eye(len(z0))):
        step = 1e-4 if i < n // 2 else 1e-3 if i < n else 1e-2 * max(1.0, abs(z0[i]))
        columns.append(central(lambda s, way=way: after(z0 + s * way), step, 4))
    both = np.array(columns).T
    return after(z0), both[:, :n], both[:, n:]


@pytest.mark.parametrize("name", ["robot_arm_torque", "two_link_motion"])
@every(
    (*ALL, ("geometrically_exact", {"elements": 3, "period_correction": True})),
    slow=("period_correction", "modes", "segments", "geometrically_exact"),
)
def test_a_period_is_the_derivative_of_the_solver(name: str, formulation: str, options: dict[str, Any]) -> None:
    simulation = moving(name, formulation, options)
    before = simulation.work.q.copy(), simulation.work.v.copy(), simulation.t
    model = linearize(simulation, discrete=3 * simulation.dt)
    assert np.array_equal(before[0], simulation.work.q) and np.array_equal(before[1], simulation.work.v)
    after, A, B = differences(model, simulation)
    n = len(model.x) // 2
    scale = np.concatenate([np.ones(n), np.full(n, model.dt)])  # rates over one period count like coordinates
    scaled = scale[:, None] * A / scale
    assert np.abs(scale[:, None] * (A - model.A) / scale).max() < 1e-6 * np.abs(scaled).max()
    assert np.abs(scale[:, None] * (B - model.B)).max() < 1e-6 * np.abs(scale[:, None] * B).max()
    assert np.abs(scale * (after - model.rate)).max() < 1e-9 * np.abs(scale * after).max()


@every(ALL, slow=("modes", "segments", "geometrically_exact"))
def test_small_steps_tend_to_the_exact_period(formulation: str, options: dict[str, Any]) -> None:
    scene = at_rest(one_link(hub_inertia=0.5, tau_d=1e-3, payload=Payload(0.1)))
    exact = linearize(scene, formulation, discrete=0.02, method="zoh", **options)

    def error(dt: float) -> float:
        model = linearize(scene, formulation, discrete=0.02, dt=dt, newmark=(0.25, 0.5), **options)
        return float(np.abs(model.C[:6] @ (model.B - exact.B)).max() / np.abs(exact.C[:6] @ exact.B).max())

    assert error(0.0005) < 2e-2
    assert error(0.001) / error(0.0005) > 3.0
    assert exact.rate == pytest.approx(exact.x, abs=1e-6)  # at rest it stays


def test_a_period_shorter_than_the_step_is_made_with_its_own() -> None:
    """The poles of a period are those of the continuous model, at a step of 0.02 s as asked for or not."""
    scene = at_rest(one_link(hub_inertia=0.5, payload=Payload(0.1)))
    exact = np.sort(np.abs(np.angle(linearize(scene, "elastica", discrete=0.004, method="zoh").eigenvalues)))
    made = np.sort(np.abs(np.angle(linearize(scene, "elastica", discrete=0.004, dt=0.05).eigenvalues)))
    slow = (exact > 1e-3) & (exact < 0.3)
    assert slow.any()
    np.testing.assert_allclose(made[slow], exact[slow], rtol=1e-4)


@pytest.mark.slow
@every(ALL)
def test_outputs_and_names(formulation: str, options: dict[str, Any]) -> None:
    simulation = moving("two_link_motion", formulation, options)
    model = linearize(simulation)
    A, B, C, D = model
    n, m, p = len(model.states), len(model.inputs), len(model.outputs)
    assert (A.shape, B.shape, C.shape, D.shape) == ((n, n), (n, m), (p, n), (p, m))
    assert model.inputs == ("torque1",)  # the hub's angle is prescribed
    assert "joint0" not in model.states and "joint1" in model.states and "joint1_rate" in model.states
    assert model.outputs[:4] == ("joint0", "joint1", "joint0_rate", "joint1_rate")
    assert model.outputs[4:] == ("deflection0", "deflection1", "deflection0_rate", "deflection1_rate", "tip_x", "tip_y")
    poses = simulation.observe()[0]
    assert model.y[[0, 8, 9]] == pytest.approx([poses[0, 2], *poses[1, 6:8]], rel=1e-9)

    def outputs(x: np.ndarray) -> np.ndarray:
        copy = copied(simulation)
        set_state(copy, x)
        return linearize(copy).y

    for i in range(0, n, max(3, n // 8)):
        way = np.eye(n)[i]
        slope = central(lambda s, way=way: outputs(model.x + s * way), 1e-4, 4)
        assert slope == pytest.approx(C[:, i], abs=1e-6 * max(1.0, np.abs(C).max()))
    # a joint's angle is output and state, and its torque does not act at once
    assert C[1] == pytest.approx(np.eye(n)[model.states.index("joint1")], abs=1e-10)
    assert not D.any()


@every(ALL)
def test_rate_is_the_acceleration(formulation: str, options: dict[str, Any]) -> None:
    simulation = moving("two_link_motion", formulation, options)
    model = linearize(simulation)
    h = 1e-6
    copy = copied(simulation, dt=h)
    copy.set_torques(np.zeros(2))
    start = state_of(copy)
    assert copy.advance_to(simulation.t + 2 * h)
    n = len(start) // 2
    mean = (state_of(copy) - start) / (2 * h)
    assert mean[:n] == pytest.approx(model.rate[:n], rel=1e-3, abs=1e-3 * np.abs(model.rate[:n]).max())
    assert mean[n:] == pytest.approx(model.rate[n:], rel=1e-2, abs=1e-2 * np.abs(model.rate[n:]).max())


def test_state_goes_there_and_back(rng: np.random.Generator) -> None:
    scene = at_rest(two_links(), root="free", angles=(0.3, 1.0))
    simulation = Simulation(scene, scene.settings("floating_frame", segments=2))
    x = state_of(simulation) + 0.01 * rng.standard_normal(len(state_of(simulation)))
    set_state(simulation, x)
    assert state_of(simulation) == pytest.approx(x, abs=1e-12)
    assert linearize(simulation).states[:3] == ("root_x", "root_y", "joint0")
    assert linearize(simulation).inputs == ("torque1",)
    for wrong in (x[:-1], "x", x + 1j):
        with pytest.raises(ValueError, match=r"^x = .*: must be 32 finite numbers"):
            set_state(simulation, wrong)
    refuses(r"^simulation = 5: must be a Simulation", lambda: state_of(5))


# ----------------------------------------------------------------------------- frequencies at rest
def test_first_shape_of_a_cantilever() -> None:
    result = modes(at_rest(one_link()), 1, "elastica", clamped=True)
    x, w = result.points[:, 0], result.shapes[0]
    k = 1.87510407
    ratio = (np.cosh(k) + np.cos(k)) / (np.sinh(k) + np.sin(k))
    shape = np.cosh(k * x) - np.cos(k * x) - ratio * (np.sinh(k * x) - np.sin(k * x))
    assert np.abs(w[:, 1] * np.sign(w[-1, 1]) - shape / shape[-1]).max() < 1e-3
    assert np.abs(w[:, 0]).max() < 1e-9


@every(ALL)
def test_strip_with_its_payload(formulation: str, options: dict[str, Any]) -> None:
    scene = at_rest(arms.named("strip"))
    clamped = modes(scene, 1, formulation, clamped=True, **options)
    assert clamped.frequencies[0] == pytest.approx(8.889, rel=1e-3)
    assert clamped.damping[0] == pytest.approx(0.01, rel=1e-3)  # tau_d omega / 2
    free = modes(scene, 2, formulation, **options)
    assert free.frequencies == pytest.approx([0.0, 22.22], rel=1e-3)
    assert free.damping[1] == pytest.approx(2.25e-3 * free.frequencies[1] / 2, rel=1e-5)


@every(ALL)
@pytest.mark.parametrize("link", [0, 1])
def test_links_of_de_luca_and_siciliano(link: int, formulation: str, options: dict[str, Any]) -> None:
    """Published: 0.48 and 1.80 Hz, 2.18 and 15.91 Hz, root clamped; link 1 with link 2 lumped at its tip."""
    arm = arms.named("de_luca_siciliano")
    l, m, load = 0.5, 0.2, arm.payload
    lumped = Payload(1.0 + m * l + load.mass, 0.1 + m * l**3 / 3 + load.mass * l**2 + load.inertia)
    single = Arm("link", (arm.links[link],), payload=lumped if link == 0 else load, tau_d=1e-9)
    result = modes(at_rest(single), 2, formulation, clamped=True, **options)
    published = [0.480, 1.797] if link == 0 else [2.178, 15.915]
    assert result.frequencies / (2 * np.pi) == pytest.approx(published, rel=2e-3)


@every(ALL)
def test_eigenvalues_agree_with_modes(formulation: str, options: dict[str, Any]) -> None:
    arm = replace(arms.named("de_luca_siciliano"), tau_d=1e-3)
    scene = at_rest(arm, angles=(0.2, 1.1))
    result = modes(scene, 5, formulation, **options)
    values = linearize(scene, formulation, **options).eigenvalues
    for value, frequency, ratio in zip(result.eigenvalues, result.frequencies, result.damping, strict=True):
        if frequency > 0.0:
            near = values[np.abs(values - value).argmin()]
            # stretch and shear bring poles of 1e10 1/s into A, and with them its round-off
            assert abs(near - value) < (1e-4 if formulation == "geometrically_exact" else 1e-7) * frequency
            assert value.real == pytest.approx(-ratio * frequency, abs=1e-9)
    assert (result.frequencies == 0.0).sum() == 2  # both joints turn freely


def test_a_pole_that_only_decays_is_no_frequency() -> None:
    """A free elbow with friction decays at a rate; it was listed as a vibration of 0.08 Hz."""
    arm = arms.named("de_luca_siciliano")
    arm = replace(arm, joints=(Joint(), Joint(friction_viscous=0.05)))
    result = modes(at_rest(arm), 4, "elastica", nodes=4, clamped=True)
    decays = (result.eigenvalues.imag == 0.0) & (result.eigenvalues.real < 0.0)
    assert decays.sum() == 1 and result.damping[decays] == pytest.approx([1.0])
    assert (result.frequencies[decays] == 0.0).all()
    moving = result.frequencies > 0.0
    assert result.frequencies[moving] == pytest.approx(abs(result.eigenvalues[moving]))


@pytest.mark.parametrize("clamped", [True, False])
@pytest.mark.parametrize("tau_d", [1e-3, 0.1])
def test_damping_of_a_slender_beam(tau_d: float, clamped: bool) -> None:
    """Kelvin-Voigt damping: lambda^2 + tau_d omega^2 lambda + omega^2 = 0 for each mode, over- or underdamped.

    EA and C are 1e8 times EI / L^2 and J is 1e-9: the fastest pole is 1e14 times the slowest.
    """
    section = Section(EI=1.0, EA=1e8, C=1e8, m=1.0, J=1e-9)
    link = Link(1.0, section)

    def found(tau: float) -> Modes:
        arm = Arm("slender", (link,), hub_inertia=0.05, tau_d=tau)
        scene = everything(Scene("slender", arm, duration=1.0, dt=0.01))
        return modes(scene, 200, "geometrically_exact", elements=8, clamped=clamped)

    undamped, damped = found(0.0).frequencies, found(tau_d)
    for omega in undamped[undamped > 0.0][:5]:
        root = np.sqrt(complex((0.5 * tau_d * omega**2) ** 2 - omega**2))
        for pole in -0.5 * tau_d * omega**2 + np.array([root, -root])[: 2 if root.imag == 0.0 else 1]:
            assert np.abs(damped.eigenvalues - pole).min() < 1e-6 * abs(pole)
    if tau_d * undamped[2] < 2.0:
        assert damped.damping[1:5] == pytest.approx(0.5 * tau_d * undamped[1:5], rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("spin", [0.0, 6.0])
def test_damping_of_a_bent_or_spinning_slender_beam(spin: float) -> None:
    """About a posture that gravity bends by 0.3 L, and in rotation: the elastica's, which has no fast poles."""
    section = Section(EI=1.0, EA=1e8, C=1e8, m=1.0, J=1e-9)
    arm = Arm("slender", (Link(1.0, section),), hub_inertia=0.05, tau_d=1e-3)
    scene = unloaded(arm) if spin else at_rest(arm, gravity=(0.0, -3.0))
    count = 3 if spin else 2  # the hub turns freely in rotation
    exact = modes(scene, count, "geometrically_exact", elements=32, clamped=not spin, spin=spin)
    elastica = modes(scene, count, "elastica", nodes=8, clamped=not spin, spin=spin)
    moving = elastica.frequencies > 1e-3
    assert exact.eigenvalues[moving] == pytest.approx(elastica.eigenvalues[moving], rel=1e-4)
    assert exact.damping[moving] == pytest.approx(elastica.damping[moving], rel=2e-3)


@every(FULL, slow=("elastica",))
def test_a_free_arm_has_four_rigid_motions(formulation: str, options: dict[str, Any]) -> None:
    result = modes(at_rest(two_links(), root="free"), 6, formulation, **options)
    assert (result.frequencies == 0.0).sum() == 4
    # halves that are pinned-free (the hinge at rest) and free-free (it moves, without a force)
    assert result.frequencies[4:] == pytest.approx([3.92660231**2, 4.73004074**2], rel=5e-3)


def test_modes_do_not_depend_on_where_the_arm_points() -> None:
    there, here = (modes(unloaded(one_link(), angles=(angle,)), 2, spin=3.0, segments=2) for angle in (2.0, 0.0))
    assert there.frequencies == pytest.approx(here.frequencies, abs=1e-6)


def test_no_rotary_inertia_needs_none() -> None:
    """A section without any has the modes of one with hardly any: the exact beam's mass matrix is not singular."""
    found, slender = (
        modes(at_rest(one_link(section)), formulation="geometrically_exact", elements=4).frequencies[:3]
        for section in (replace(SLENDER, J=0.0), SLENDER)
    )
    assert found == pytest.approx(slender, rel=1e-4)


# --------------------------------------------------------------------------------------- rotation
ROTATING = {
    0.0: (3.51602, 22.0345, 61.6972), 2.0: (3.6218, 22.5263, 62.2411), 6.0: (4.2632, 26.1290, 66.4134),
    12.0: (5.4270, 35.6370, 78.7049),
}  # fmt: skip
"""In-plane frequencies of a clamped Euler-Bernoulli beam in rotation (24-term Ritz), units of sqrt(EI / m L^4)."""
ONE_FRAME = {"segments": 1, "frame": "root", "multipliers": True}


@pytest.mark.parametrize("spin", ROTATING)
@pytest.mark.parametrize(
    ("formulation", "options", "count", "error"),
    [
        ("floating_frame", {"segments": 16}, 2, 1e-3), ("geometrically_exact", {"elements": 8}, 2, 1e-3),
        (*ELASTICA, 2, 1e-3),
        pytest.param("floating_frame", {**ONE_FRAME, "elements": 32}, 3, 5e-4, marks=pytest.mark.slow),
        pytest.param("geometrically_exact", {"elements": 8, "order": 3}, 3, 3e-4, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_rotating_cantilever(formulation: str, options: dict[str, Any], count: int, error: float, spin: float) -> None:
    section = SLENDER if count == 2 else replace(SLENDER, EA=1e7, C=1e7, J=0.0 if "order" in options else 1e-10)
    result = modes(unloaded(one_link(section)), count, formulation, spin=spin, clamped=True, **options)
    assert result.frequencies == pytest.approx(ROTATING[spin][:count], rel=error)
    assert result.damping == pytest.approx([0.0] * count, abs=1e-6)


@pytest.mark.slow
def test_elements_of_one_rotating_frame_are_of_second_order() -> None:
    """The stretch of the centrifugal force is constant in an element: first mode 5.472, 5.439, 5.430 at spin 12."""
    link = one_link(replace(SLENDER, EA=1e8, C=1e8, J=1e-10))
    first = [
        modes(unloaded(link), 1, spin=12.0, clamped=True, **ONE_FRAME, elements=n).frequencies[0] for n in (5, 10, 20)
    ]
    assert first == pytest.approx([5.472, 5.439, 5.430], abs=6e-4)
    errors = np.array(first) - 5.4270
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(2.0, abs=0.1)


def test_rotating_link_reduced_to_modes() -> None:
    """The second-order foreshortening: exact at slow spin, stiffer than it should be at four times the frequency."""
    slow = modes(unloaded(one_link()), 2, "floating_frame", modes=3, spin=2.0, clamped=True)
    assert slow.frequencies == pytest.approx(ROTATING[2.0][:2], rel=1e-3)


@every(FULL)
def test_elbow_of_a_rotating_chain_swings_as_a_pendulum(formulation: str, options: dict[str, Any]) -> None:
    """Stiff links, the hub's rate held: the second link is a rod that hangs in the centrifugal field."""
    stiff = Section(EI=1e4, EA=1e8, C=1e8, m=1.0, J=1e-6)
    scene = unloaded(two_links(stiff), position=(3.0, -1.0), angles=(0.7, 0.7))
    result = modes(scene, 1, formulation, spin=2.0, clamped=True, **options)
    assert result.frequencies[0] == pytest.approx(2.0 * np.sqrt(1.5), rel=1e-3)


def test_a_prescribed_hub_is_clamped() -> None:
    scene = at_rest(one_link(), motions=(Motion("joint0", ramp(0.5, 0.5)),))
    free = modes(scene, 2, "floating_frame", segments=4)
    assert free.frequencies == pytest.approx(modes(at_rest(one_link()), 2, segments=4, clamped=True).frequencies)
    assert not static_equilibrium(scene, "floating_frame").work.v.any()


# ------------------------------------------------------------------------------------------ errors
def test_bad_input_names_itself() -> None:
    scene = scenes.named("robot_arm_torque")
    simulation = Simulation(scene, scene.settings())
    refuses("method = 'euler': must be one of", lambda: linearize(simulation, method="euler"))
    with pytest.raises(ValueError, match=r"discrete = 3\.0: must not reach past the scene's kink at t = 2\.5 s"):
        linearize(simulation, discrete=3.0)
    refuses("discrete = -1", lambda: linearize(simulation, discrete=-1))
    refuses(r"discrete = 1000000000\.0: must be at most 100000 steps", lambda: linearize(scene, discrete=1e9))
    refuses("segments = 3: must not be given with a Simulation", lambda: linearize(simulation, segments=3))
    refuses(r"spin = 1\.0: must be given with a Scene", lambda: modes(simulation, spin=1.0))
    refuses(r"spin = 1\.0: needs a pinned root", lambda: modes(scenes.named("flying_rod"), spin=1.0))
    refuses(r"clamped\[0\] = 4", lambda: modes(scene, clamped=[4]))
    refuses("n = 0: must be", lambda: modes(scene, 0))
    refuses("hold_joints = 1: must be True or False", lambda: static_equilibrium(scene, hold_joints=1))
    refuses("require_stable = 1: must be True, False or None", lambda: static_equilibrium(scene, require_stable=1))
    refuses("order", lambda: modes(scene, formulation="elastica", order=2))


@pytest.mark.parametrize(
    ("formulation", "options", "error"),
    [
        ("elastica", {"nodes": 6}, 2e-4),
        ("geometrically_exact", {"elements": 6}, 2e-3),
        ("floating_frame", {"segments": 4}, 3e-2),
        pytest.param("floating_frame", {"segments": 3, "frame": "root"}, 3e-2, marks=pytest.mark.slow),
        pytest.param("floating_frame", {"modes": 6}, 3e-2, marks=pytest.mark.slow),
    ],
)
def test_a_prescribed_hub_is_an_input(formulation: str, options: dict[str, Any], error: float) -> None:
    """Hub acceleration to curvature at the root: the moment over EI, steadily; the poles are those of the held arm."""
    arm = replace(arms.named("strip"), tau_d=0.0)
    link, payload = arm.links[0], arm.payload
    scene = everything(Scene("driven", arm, duration=1.0, dt=1e-3, motions=(Motion("joint0", constant(0.0)),)))
    model = linearize(scene, formulation, motions=True, gauges=((0, 0.0),), **options)
    assert model.inputs == ("joint0_acceleration",) and model.outputs[-1] == "curvature0@0"
    assert model.states[0] == "joint0" and model.growing == 0
    n = len(model.states) // 2
    rest = [k for k in range(2 * n) if k not in (0, n)]
    np.testing.assert_array_equal(model.A[n], 0.0)
    assert model.B[n, 0] == 1.0 and model.B[0, 0] == 0.0
    slow = 0.01j * np.abs(model.eigenvalues[np.abs(model.eigenvalues) > 1.0]).min()
    gain = (model.C[-1] @ np.linalg.solve(slow * np.eye(2 * n) - model.A, model.B[:, 0])).real
    moment = link.mass * link.length**2 / 3 + payload.mass * link.length**2 + payload.inertia
    moment += link.section.J * link.length
    assert gain == pytest.approx(-moment / link.section.EI, rel=error)
    held = linearize(scene, formulation, **options)
    assert held.inputs == () and "joint0" not in held.states
    found, wanted = (np.sort(np.abs(x))[:4] for x in (np.linalg.eigvals(model.A[np.ix_(rest, rest)]), held.eigenvalues))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_the_linear_model_of_a_driven_arm_follows_the_solver() -> None:
    """Two links, hub prescribed, elbow free: a small hub motion against the simulation."""
    arm = replace(arms.named("de_luca_siciliano"), tau_d=1e-3)
    swing = cycloid(0.02, 0.2)
    scene = everything(Scene("driven", arm, duration=0.3, dt=5e-4, sample=5e-3, motions=(Motion("joint0", swing),)))
    run = simulate(scene, "geometrically_exact", elements=2, estimate_error=False)
    model = linearize(scene, "geometrically_exact", elements=2, motions=True, discrete=5e-4, method="zoh")
    x, tips = model.x.copy(), []
    assert model.inputs == ("torque1", "joint0_acceleration")
    for k in range(600):
        if k % 10 == 0:
            tips.append((model.y + model.C @ (x - model.x))[-1])
        a = 0.5 * (swing(5e-4 * k, 2) + swing(5e-4 * (k + 1), 2))
        x = model.rate + model.A @ (x - model.x) + model.B @ (np.array([0.0, a]) - model.u)
    assert np.abs(np.array(tips) - run.tip[:60, 1]).max() < 2e-3 * np.abs(run.tip[:, 1]).max()


def test_motions_as_inputs_are_checked() -> None:
    scene = Scene("s", arms.named("strip"), duration=1.0, dt=1e-3, motions=(Motion("joint0", constant(0.0)),))
    with pytest.raises(ValueError, match="method = 'solver': must be 'zoh' where motions are inputs"):
        linearize(scene, "elastica", motions=True, discrete=0.01)
    refuses(r"gauges\[0\]\[1\] = 1.5", lambda: linearize(scene, "elastica", gauges=((0, 1.5),)))
    joined = {"segments": 2, "frame": "root", "multipliers": True}
    elbow = (Motion("joint1", constant(0.0)),)
    pair = Scene("p", arms.named("de_luca_siciliano"), duration=1.0, dt=1e-3, motions=elbow)
    with pytest.raises(ValueError, match="motions = True: must be False where multipliers"):
        linearize(pair, "floating_frame", motions=True, **joined)


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        ("elastica", {"nodes": 4}), ("geometrically_exact", {"elements": 2, "order": 3}),
        ("floating_frame", {"segments": 2, "elements": 2}), ("floating_frame", {"modes": 2}),
        ("floating_frame", {"segments": 2, "multipliers": True}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("root", ["pinned", "free"])
def test_formulations_declare_what_turns_with_the_arm(formulation: str, options: dict[str, Any], root: str) -> None:
    """A scene that begins turned about the origin: vectors turn, absolute angles grow by as much, all else stays."""
    curved = replace(TWO, links=tuple(replace(link, curvature=0.1) for link in TWO.links))
    geared = replace(TWO, joints=(Joint(stiffness=50.0, motor_inertia=0.1),) * 2)
    turn, place = 0.7, np.array((1.3, 0.4))
    spun = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
    for arm in (TWO,) if options.get("multipliers") else (TWO, curved, geared):
        if root == "free" and arm is geared:
            continue  # gears stand on the ground
        found = []
        for angle, at in ((0.0, place), (turn, spun @ place)):
            still = scene_of(arm, angles=(0.2 + angle, -0.5 + angle), position=tuple(at), root=root)
            found.append(assemble(still, Settings.make(formulation, dt=0.01, **options)))
        before, after = found
        expected = before.q0.copy()
        for pair in map(list, before.vectors):
            expected[pair] = spun @ expected[pair]
        expected[list(before.absolute)] += turn
        assert len(before.vectors) + len(before.absolute) > 0
        assert np.abs(after.q0 - expected).max() < 1e-12, before.names


def test_a_single_rigid_link_has_rigid_motions_alone() -> None:
    link = RigidLink(length=0.5, mass=0.3, centre=(0.2, 0.0, 0.0), inertia=np.diag([1e-4, 1e-2, 1e-2]).tolist())
    scene = Scene("modes", Arm("rigid", (link,), hub_inertia=0.05), duration=1.0, dt=1e-3)
    assert modes(scene, 3, "geometrically_exact", clamped=()).frequencies.tolist() == [0.0]
