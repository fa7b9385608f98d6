"""Kernels of contact: distances and normals, slope of the forces, lanes, and records with their errors."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from benchmarks.contact_cases import hard
from flexarm_env import Arm, Contact, Link, Payload, Scene, Section, Simulation, arms, simulate
from flexarm_env.compiler import EIGHT, SINGLE, kernel, size, uncompiled
from flexarm_env.physics import assembly, protocol
from flexarm_env.physics.contact.build import STEPS, duration, largest_stiffness
from flexarm_env.physics.contact.kinematics import gap_at
from flexarm_env.physics.integrator.step import advance
from flexarm_env.physics.integrator.work import unpack, work_size
from flexarm_env.physics.obstacles import distance_and_normal, packed
from flexarm_env.physics.protocol import RESIDUAL_ALONE, State, Weights
from flexarm_env.shapes import Box, Cylinder, HalfSpace, Shape, Sphere
from flexarm_env.time_functions import sine

PLANE = (HalfSpace((0.1, 0.2), (1.0, 2.0)), Sphere((0.3, -0.1), 0.4), Box((0.1, 0.2), (0.5, 0.8), 0.3))
SPACE = (
    HalfSpace((0.1, 0.2, 0.3), (1.0, 2.0, -1.0)), Sphere((0.3, -0.1, 0.2), 0.4),
    Box((0.1, 0.2, 0.1), (0.5, 0.8, 0.6), ((0.0, 0.6, 0.8), 0.7)), Cylinder((0.1, 0.0, -0.2), (0.4, 0.3, 0.5), 0.3),
)  # fmt: skip
TWO = Arm(
    "two", (Link(0.5, Section(EI=5.0, EA=1e5, C=1e5, m=0.3)),) * 2, payload=Payload(mass=0.1, radius=0.02), tau_d=1e-3
)
FLOOR = HalfSpace((0.0, -0.3), (0.0, 1.0))


# --- geometry -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", [*PLANE, *SPACE], ids=lambda shape: f"{shape.name}{shape.dimension}")
def test_normals_are_the_gradients_of_the_distances(shape: Shape) -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (200, shape.dimension))
    table, look = packed([shape]), uncompiled(distance_and_normal)
    distances, gradients = shape.look(points)
    for point, distance, gradient in zip(points, distances, gradients, strict=True):
        found = look(table, 0, *point, *(0.0,) * (3 - shape.dimension))
        assert found[0] == pytest.approx(distance, abs=1e-14)
        assert found[1 : 1 + shape.dimension] == pytest.approx(gradient, abs=1e-12)


# --- slope ----------------------------------------------------------------------------------------------
@kernel
def _step(lane, model, par, state, u, weights, r, S, d):  # type: ignore[no-untyped-def]
    """Assemble and factor the matrix at `state`, and solve for the right-hand side d in place."""
    protocol.assemble(lane, model, par, state, u, weights, r, S)
    for k in model.fixed:
        protocol.add_stiffness(lane, model, S, k, None)
    protocol.factor(lane, model, S)
    protocol.solve(lane, model, S, d)


@kernel
def _residual(lane, model, par, state, u, r, S):  # type: ignore[no-untyped-def]
    """Compute the residual."""
    protocol.assemble(lane, model, par, state, u, RESIDUAL_ALONE, r, S)


@pytest.mark.parametrize("formulation", ["elastica", "floating_frame"])
def test_the_matrix_contains_the_slope_of_the_forces(formulation: str) -> None:
    """Of a sphere that presses into two obstacles and slides: normal, damping and friction forces, and their lever."""
    contacts = (
        Contact(FLOOR, 1e4, damping=0.3, friction=0.4, creep=0.05),
        Contact(HalfSpace((0.95, 0.0), (-1.0, 0.3)), 3e3, exponent=2.0),
    )
    scene = Scene("pressed", TWO, duration=1.0, dt=1e-3, angles=(-0.2, -0.47), contacts=contacts)
    system = assembly.assemble(scene, scene.settings(formulation))
    model, n, rng = system.model, size(system.model.n), np.random.default_rng(2)
    u, r, S = np.zeros(size(model.n_inputs)), np.zeros(n), np.zeros(size(model.n_factor))
    move = rng.normal(size=n)
    move[model.fixed] = 0.0
    weights = Weights(1e2, 1e3, 1.0)
    # slow: the matrix leaves out how the velocity of a point changes with the coordinates
    v, a = 1e-3 * rng.normal(size=n), np.zeros(n)
    v[model.fixed] = 0.0

    def residual(share: float) -> Any:
        d = share * move
        out = np.zeros(n)
        state = State(system.q0 + d, v + weights.damping * d, a + weights.mass * d)
        uncompiled(_residual)(SINGLE, model, system.par, state, u, out, S.copy())
        return out

    slope = (residual(1e-8) - residual(-1e-8)) / 2e-8
    slope[model.fixed] = 0.0
    uncompiled(_step)(SINGLE, model, system.par, State(system.q0.copy(), v, a), u, weights, r, S, slope)
    assert slope == pytest.approx(move, rel=1e-3, abs=1e-3)


# --- lanes ----------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_lanes_have_the_bits_of_single_arms() -> None:
    """Of eight arms that fall from different heights; some touch, some do not."""
    scene = Scene(
        "falls", TWO, duration=1.0, dt=1e-3, gravity=(0.0, -9.81),
        contacts=(Contact(FLOOR, 1e4, damping=0.5, friction=0.3), Contact(Sphere((0.3, -0.3), 0.1), 1e4)),
    )  # fmt: skip
    settings = scene.settings("elastica")
    simulation = Simulation(scene, settings)
    model, par, scheme = simulation.model, simulation.par, simulation.scheme
    n, count = len(simulation.work.q), work_size
    wide = np.zeros(int(uncompiled(count)(8, model, 0)))
    lanes = uncompiled(unpack)(EIGHT, model, wide, 0)
    touched = 0
    tilted = [dataclasses.replace(scene, angles=(0.08 * i - 0.2, 0.08 * i - 0.2)) for i in range(8)]
    starts = [assembly.assemble(one, settings).q0 for one in tilted]
    for i, q in enumerate(starts):
        lanes.q[i::8] = q
    advance(EIGHT, model, None, np.repeat(par, 8), wide, 0, 0.0, scene.dt, 300, scheme, (0,))
    for i, q in enumerate(starts):
        flat = np.zeros(int(uncompiled(count)(1, model, 0)))
        one = uncompiled(unpack)(SINGLE, model, flat, 0)
        one.q[:] = q
        advance(SINGLE, model, None, par, flat, 0, 0.0, scene.dt, 300, scheme, (0,))
        if lanes.flag[i] == 0.0:
            for name in ("q", "v", "a", "books"):
                assert np.array_equal(getattr(one, name), getattr(lanes, name)[i::8]), (i, name)
            touched += float(one.S[model.newton.contact.at + 7]) > 0.0
    assert (lanes.flag == 0.0).sum() >= 6 and 2 <= touched <= 7 and n == 14 - 2


# --- without contact, and records -----------------------------------------------------------------------
def test_an_arm_without_contacts_has_no_contribution() -> None:
    arm = arms.named("strip_geared")
    scene = Scene("plain", arm, duration=1.0, dt=1e-3)
    model = assembly.assemble(scene, scene.settings("elastica")).model
    assert model.newton.contact is None and model.points is None and len(model.contributions) == 1
    scene = Scene("plain", arms.named("strip"), duration=1.0, dt=1e-3)
    assert not hasattr(assembly.assemble(scene, scene.settings("elastica")).model, "contributions")


def test_a_step_that_does_not_resolve_an_impact_is_refused_with_the_limit() -> None:
    scene = Scene("stiff", arms.named("strip"), duration=0.1, dt=1e-3, contacts=(Contact(FLOOR, 1e7),))
    with pytest.raises(ValueError, match=r"contacts\[0\]\.stiffness = 1e7|10000000\.0: must be at most .* N/m\^1\.5"):
        simulate(scene, "elastica")
    # the limit itself is taken, and an impact on it lasts as many steps as it says
    limit = largest_stiffness(scene.contacts[0], 0.2154, 1e-3)
    assert duration(dataclasses.replace(scene.contacts[0], stiffness=limit), 0.2154) == pytest.approx(STEPS * 1e-3)
    soft = dataclasses.replace(scene, contacts=(Contact(FLOOR, 0.99 * limit),))
    assert simulate(soft, "elastica", estimate_error=False).finished


def test_the_duration_of_an_impact_is_that_of_the_equation_of_motion() -> None:
    assert duration(Contact(FLOOR, 200.0, exponent=1.0), 0.5) == pytest.approx(math.pi * math.sqrt(0.5 / 200.0))
    # Hertz: 2.9432 times depth over speed
    depth = (1.25 * 0.5 * 4.0 / 1e5) ** 0.4
    assert duration(Contact(FLOOR, 1e5, speed=2.0), 0.5) == pytest.approx(2.94328 * depth / 2.0, rel=1e-5)


def test_scenes_with_contacts_are_read_back_from_text() -> None:
    contacts = (Contact(FLOOR, 1e4, damping=0.5, friction=0.3, bodies=("tip", "joint1")), Contact(PLANE[2], 2e3, 1.0))
    scene = Scene("text", TWO, duration=1.0, dt=1e-3, contacts=contacts)
    assert Scene.from_toml(scene.to_toml()) == scene
    three = Scene("text", arms.named("three_dof"), duration=1.0, dt=1e-3, contacts=(Contact(SPACE[3], 1e4),))
    assert Scene.from_toml(three.to_toml()) == three
    # an obstacle in space makes a scene spatial
    assert Scene("space", TWO, duration=1.0, dt=1e-3, contacts=(Contact(SPACE[1], 1e4),)).spatial


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stiffness": -1.0}, "stiffness = -1.0: must be a positive number"),
        ({"stiffness": 1e3, "exponent": 1.2}, "exponent = 1.2: must be 1, 1.5, 2, 2.5 or 3"),
        ({"stiffness": 1e3, "friction": -0.1}, "friction = -0.1: must be"),
        ({"stiffness": 1e3, "creep": 0.0}, "creep = 0.0: must be a positive number"),
        ({"stiffness": 1e3, "bodies": ("hand",)}, r"bodies\[0\] = 'hand': must be \"tip\", \"joint1\""),
        ({"stiffness": 1e3, "bodies": ()}, r"bodies = \(\): must name at least one point"),
    ],
)
def test_wrong_contacts_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Contact(FLOOR, **given)


def test_contacts_that_do_not_fit_the_scene_are_refused() -> None:
    base: dict[str, Any] = {"duration": 1.0, "dt": 1e-3}
    with pytest.raises(ValueError, match=r"contacts\[0\]\.bodies\[0\] = 'joint2': must be one of \"tip\", \"joint1\""):
        Scene("joint", TWO, contacts=(Contact(FLOOR, 1e3, bodies=("joint2",)),), **base)
    with pytest.raises(ValueError, match=r"contacts\[0\]\.obstacle = .*must be in space"):
        Scene("space", arms.named("three_dof"), contacts=(Contact(FLOOR, 1e3),), **base)
    with pytest.raises(ValueError, match="multipliers = True"):
        scene = Scene("frames", TWO, contacts=(Contact(FLOOR, 1e3),), **base)
        Simulation(scene, scene.settings("floating_frame", multipliers=True))


def test_steps_resolve_the_release_of_an_arm_that_begins_inside_an_obstacle() -> None:
    """From a penetration d a mass m leaves at v with m v^2 / 2 = k d^2.5 / 2.5; far inside it is refused."""
    arm = Arm("bar", (Link(1.0, Section(EI=1e6, EA=1e9, C=1e9, m=1e-6)),), payload=Payload(mass=0.5))

    def scene(depth: float, dt: float, **law: Any) -> Scene:
        floor = HalfSpace((0.0, depth), (0.0, 1.0))
        return Scene("inside", arm, duration=0.1, dt=dt, contacts=(Contact(floor, 1e5, **law),))

    # at 1 m/s the contact lasts 24.4 ms, at the 3.2 m/s of the release from 21 mm 19.3 ms
    leaves = math.sqrt(0.8 * 1e5 * 0.021**2.5 / 0.5)
    lasts = duration(Contact(FLOOR, 1e5, speed=leaves), 0.5)
    assert simulate(scene(0.021, 0.99 * lasts / STEPS), "elastica", estimate_error=False).finished
    with pytest.raises(ValueError, match=r"the arm begins 0\.021 m inside the obstacle; an impact at .* m/s on"):
        simulate(scene(0.021, 1.2 * lasts / STEPS), "elastica")
    run = simulate(scene(0.021, 0.25 * lasts / STEPS), "elastica", estimate_error=False, rho_inf=1.0)
    assert run.v[-1, 0] == pytest.approx(leaves, rel=2e-3)
    with pytest.raises(ValueError, match=r"contacts\[0\]\.obstacle = .*: must not contain tip of the arm at the start"):
        simulate(scene(0.15, 1e-5), "elastica")
    assert simulate(scene(0.15, 1e-4, speed=10.0), "elastica", estimate_error=False).finished


def test_a_point_moves_by_at_most_its_levers(rng: np.random.Generator) -> None:
    """Small and large changes of coordinates; an eccentric payload, two links, a free root, a moving obstacle."""
    offset = dataclasses.replace(TWO, payload=Payload(mass=0.1, offset=(0.05, 0.02)))
    for arm, root in ((arms.named("strip"), "pinned"), (offset, "pinned"), (offset, "free")):
        contact = Contact(HalfSpace((0.0, -1.5), (0.3, 1.0)), 1e3, displacement_y=sine(0.1, 3.0))
        scene = Scene("far", arm, duration=1.0, dt=1e-3, root=root, contacts=(contact,))
        system = assembly.assemble(scene, scene.settings("elastica"))
        part, model = system.model.contributions[-1], system.model
        y, n = np.zeros(size(model.n_inputs)), size(model.n)

        def gap(q: np.ndarray, part: Any = part, model: Any = model, y: np.ndarray = y) -> float:
            uncompiled(protocol.input_displacements)(SINGLE, model.arm, None, q, y)
            return float(uncompiled(gap_at)(SINGLE, part, q, y, 0))

        for _ in range(200):
            q = rng.uniform(-1.0, 1.0, n)
            change = rng.normal(size=n) * 10.0 ** rng.uniform(-6.0, 0.0) * (rng.random(n) < rng.random())
            assert abs(gap(q + change) - gap(q)) <= abs(change) @ part.levers + 1e-14
    assert part.levers.max() <= 2.0 * arm.total_length + 1.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["drop", "grazing", "crushed"])
def test_the_test_of_clearance_changes_no_bit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arms that approach, touch and leave obstacles, with and without the bound from which distances are skipped."""
    found = []
    for _ in range(2):
        run = simulate(hard(kind, 1e4, 1e-3), "elastica", estimate_error=False)
        found.append((run.tip, run.work, run.dissipated, run.balance))
        monkeypatch.setattr("flexarm_env.physics.contact.build._levers", lambda *_: None)
    assert all(np.array_equal(*pair) for pair in zip(*found, strict=True))


@pytest.mark.parametrize(
    ("space", "formulation", "options"),
    [
        (False, "elastica", {"nodes": 4}),
        (False, "geometrically_exact", {"elements": 2}),
        (False, "floating_frame", {"segments": 2}),
        (True, "geometrically_exact", {"elements": 2}),
        (True, "floating_frame", {"segments": 2}),
    ],
)
def test_points_along_links(space: bool, formulation: str, options: dict[str, Any], rng: np.random.Generator) -> None:
    """Rates are the differences of positions, and forces times rates are the power of the forces; rigid ends too."""
    ends = dataclasses.replace(TWO.links[0], root_offset=0.05, tip_offset=0.02)
    arm = arms.named("three_dof") if space else dataclasses.replace(TWO, links=(ends, TWO.links[1]))
    bodies = ("link1@0.5", *(("joint2", "link2@0.5") if space else ("joint1", "link0@0.5")), "tip")
    contact = Contact(Sphere((0.0,) * (2 + space), 0.1), 1e4, bodies=bodies, radius=0.02)
    scene = Scene("points", arm, duration=1.0, dt=1e-3, contacts=(contact,), space=space)
    system = assembly.assemble(scene, scene.settings(formulation, **options))
    model, par = system.model, system.par
    inner, part, n = model.arm, model.contributions[-1], size(model.arm.n)
    q, v, h = system.q0[:n].copy(), rng.normal(size=n), 1e-6
    v[inner.fixed] = 0.0
    uncompiled(protocol.retract)(SINGLE, inner, q, 1.0, 0.05 * rng.normal(size=n), None)
    places = []
    for step in (h, -h):
        moved, y = q.copy(), np.zeros(size(model.n_inputs))
        uncompiled(protocol.retract)(SINGLE, inner, moved, step, v, None)
        uncompiled(protocol.input_displacements)(SINGLE, inner, par, moved, y)
        places.append(y)
    slope, rates = (places[0] - places[1]) / (2.0 * h), np.zeros(size(model.n_inputs))
    uncompiled(protocol.input_displacements)(SINGLE, inner, par, q, rates, None, v)
    compared = list(range(arm.n_links))
    compared += [part.input + p * len(part.entries) + i for p in range(4) for i in range(len(part.space))]
    assert rates[compared] == pytest.approx(slope[compared], abs=1e-7 * abs(slope).max())
    # r(0) - r(u) = B u, and B^T v are the rates
    state, S = State(q, v, np.zeros(n)), np.zeros(size(model.n_factor))
    u, r, loaded = np.zeros(size(model.n_inputs)), np.zeros(n), np.zeros(n)
    uncompiled(protocol.residual)(SINGLE, inner, par, state, u, r, S)
    u[part.input :] = rng.normal(size=len(u) - part.input)
    uncompiled(protocol.residual)(SINGLE, inner, par, state, u, loaded, S)
    assert (r - loaded) @ v == pytest.approx(u @ rates, rel=1e-8)
