"""Contact points along links in environments: against divided links of scenes, energy, vectors, derivatives, views."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Contact, JointTorque, Link, Scene, Section, arms, simulate
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.shapes import HalfSpace, Sphere
from flexarm_env.time_functions import constant, sine
from tests.env_tools import RANDOM, assert_goes_back, assert_pair_same, pair
from tests.refusals import refusal

POST = Contact(
    Sphere((0.5, 0.3), 0.1), 1e4, damping=0.3, friction=0.3, bodies=("link0@0.5", "tip"), radius=0.02
)  # fmt: skip
BALL = Contact(
    Sphere((0.3, 0.0, 0.75), 0.25), 1e4, damping=0.3, friction=0.3, radius=0.02,
    bodies=("link1@0.5", "link2@0.5", "tip"),
)  # fmt: skip
MESHES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "elastica": ({"nodes": 10}, {"nodes": 8}),
    "geometrically_exact": ({"elements": 4}, {"elements": 2}),
    "floating_frame": ({"segments": 4}, {"segments": 2}),
}
"""Solver options of an environment, and of a scene whose links are divided in the middle."""


def total(info: dict[str, Any]) -> float:
    """Energies less work, J."""
    energies = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")
    return float(sum(info[name] for name in energies) - info["work"])


def swung(env: Any, action: list[float], periods: int, **options: Any) -> tuple[list[dict[str, Any]], float]:
    """The infos of an episode under a constant action, and the largest change of energies less work."""
    *_, first = env.reset(seed=0, options=options)
    found = []
    for _ in range(periods):
        *_, terminated, _, info = env.step(np.array(action, np.float32))
        assert not terminated, info["termination_reason"]
        found.append(info)
    return found, max(abs(total(info) - total(first)) for info in found)


def compare_with_scene(
    env_id: str, contact: Contact, formulation: str, action: list[float], start: Any, agreement: float, **more: Any
) -> list[dict[str, Any]]:
    """An environment's episode beside the simulation of a scene, which divides the links at the contact points."""
    own, other = MESHES[formulation]
    env: Any = gym.make(
        env_id, contacts=contact, formulation=formulation, dt=1e-3, info_level="full", tolerance=1e-9, **own, **more
    )
    infos, _ = swung(env, action, 30, start=start)
    plan = env.unwrapped.plan
    loads = tuple(
        JointTorque(k, constant(float(share * limit)))
        for k, (share, limit) in enumerate(zip(np.array(action, np.float32), plan.arm.torque_limits, strict=True))
    )
    angles = np.cumsum(start) if len(plan.arm.axes) == 2 else start
    scene = Scene(
        "beside", plan.arm, duration=30 * plan.period, dt=1e-3, sample=plan.period, contacts=(contact,), loads=loads,
        angles=tuple(np.atleast_1d(angles).tolist()), gravity=plan.gravity, space=len(plan.arm.axes) == 3,
    )  # fmt: skip
    run = simulate(scene, formulation, estimate_error=False, rho_inf=plan.settings.rho_inf, tolerance=1e-9, **other)
    assert run.status == "ok"
    tips = np.array([info["tip_position"] for info in infos])
    assert abs(run.tip[1:, : tips.shape[1]] - tips).max() < agreement
    assert max(info["contact_force"] for info in infos) > 1.0
    return infos


@pytest.mark.parametrize(
    ("formulation", "agreement"),
    [
        ("elastica", 1e-3),
        pytest.param("geometrically_exact", 1e-6, marks=pytest.mark.slow),
        pytest.param("floating_frame", 1e-6, marks=pytest.mark.slow),
    ],
)
def test_a_strip_hits_a_post_as_the_divided_strip_of_a_scene_does(formulation: str, agreement: float) -> None:
    """Elements of the halves are those of the whole; the elastica's polynomials differ."""
    infos = compare_with_scene("FlexibleArm-v0", POST, formulation, [0.5], 0.1, agreement)
    forces = np.array([info["contact_force_at_points"] for info in infos])
    assert forces[:, 0].max() > 1.0 and not forces[:, 1].any()


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["geometrically_exact", "floating_frame"])
def test_an_arm_in_space_hits_a_ball_as_the_divided_arm_of_a_scene_does(formulation: str) -> None:
    """To 20 micrometers, of which the first period, before any contact, causes 13."""
    compare_with_scene("SpatialFlexArm-v0", BALL, formulation, [0.0, 0.4, 0.2], (0.1, 0.2, -0.4), 2e-5)


@pytest.mark.parametrize(
    "formulation",
    [
        "elastica",
        pytest.param("geometrically_exact", marks=pytest.mark.slow),
        pytest.param("floating_frame", marks=pytest.mark.slow),
    ],
)
def test_a_strip_that_leans_on_a_wall_with_its_middle(formulation: str) -> None:
    """Moments about the hub: torque = x F_n without friction; F_n = k d^1.5 at d = y + r - 0.2; the end is straight."""
    wall = {
        "obstacle": HalfSpace((0.0, 0.2), (0.0, -1.0)).to_dict(), "stiffness": 1e4, "damping": 3.0, "radius": 0.03,
        "bodies": ["link0@0.5"],
    }  # fmt: skip
    env: Any = gym.make(
        "FlexibleArm-v0", contacts=wall, formulation=formulation, duration=30.0, reward_terms={}, info_level="full",
        sensors={"force": {}},
    )  # fmt: skip
    infos, left = swung(env, [0.5], 1400, start=0.2)
    x, y = env.unwrapped.snapshot().touches[0, :2]
    info, torque = infos[-1], 0.5 * env.unwrapped.plan.arm.torque_limits[0]
    assert info["contact_force"] == pytest.approx(torque / x, rel=1e-3)
    assert info["contact_penetration"] == pytest.approx(y + 0.03 - 0.2, rel=1e-6)
    assert info["contact_force"] == pytest.approx(1e4 * (y + 0.03 - 0.2) ** 1.5, rel=1e-3)
    assert info["contact_impulse"] == pytest.approx(env.unwrapped.plan.period * info["contact_force"], rel=1e-3)
    # the strip's outer half carries no moment
    shape = env.unwrapped.snapshot().points
    outer = shape[np.linalg.norm(shape, axis=1) > 0.55]
    assert abs(np.diff(np.arctan2(*np.diff(outer, axis=0).T[::-1]))).max() < 1e-3
    assert left < 0.02 * info["work"]
    # a force sensor at a tip that cannot touch
    assert env.unwrapped.step(np.array([0.5], np.float32))[0][-2:].tolist() == [0.0, 0.0]


def test_the_energy_of_impacts_on_a_moving_post_is_accounted_for() -> None:
    """The remainder falls with the square of the step; each point has its five values."""
    moving = dataclasses.replace(POST, displacement_y=sine(0.05, 12.0))
    rest = []
    for dt in (4e-3, 2e-3):
        env = gym.make("FlexibleArm-v0", contacts=moving, info_level="full", dt=dt)
        infos, left = swung(env, [0.6], 80, start=0.1)
        rest.append(left / max(info["work"] for info in infos))
        for name in ("force", "friction", "impulse"):
            parts = np.array([info[f"contact_{name}_at_points"] for info in infos])
            assert np.allclose(parts.sum(axis=1), [info[f"contact_{name}"] for info in infos])
    assert max(info["contact_friction"] for info in infos) > 0.1
    assert rest[0] < 0.02 and rest[1] < 0.4 * rest[0]


PAIRS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": ("FlexibleArm-v0", {"contacts": POST}),
    "exact": (
        "TwoLinkFlexArm-v0", {
            "contacts": {**POST.to_table(), "bodies": ["link0@0.5", "joint1", "link1@0.5", "tip"]},
            "formulation": "geometrically_exact", "elements": 2,
        },
    ),
    "floating": ("FlexibleArm-v0", {"contacts": POST, "formulation": "floating_frame", "segments": 2}),
    "space": ("SpatialFlexArm-v0", {"contacts": BALL, "elements": 2}),
}  # fmt: skip


@pytest.mark.parametrize(
    "kind", [
        "elastica",
        pytest.param("exact", marks=pytest.mark.slow),
        pytest.param("floating", marks=pytest.mark.slow),
        pytest.param("space", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_vector_is_single_arms_whose_links_touch(kind: str) -> None:
    """To the last bit, with drawn parameters and over restarts; states are gone back to."""
    env_id, keywords = PAIRS[kind]
    drawn = {name: RANDOM[name] for name in ("EI", "damping")}
    both = pair(env_id, 9, duration=0.6, info_level="full", randomization=drawn, **keywords)
    assert assert_pair_same(both, 70, scale=1.6) > 0
    env = gym.make(env_id, **keywords)
    env.reset(seed=0)
    assert_goes_back(env)


@pytest.mark.skipif(UNCOMPILED, reason="derivatives are compiled")
@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["elastica", "geometrically_exact"])
def test_derivatives_while_a_link_touches(formulation: str) -> None:
    """Of a period in which the link's middle is pressed on a wall and slides: differences of periods."""
    from flexarm_env.derivatives import Arms

    wall = {
        "obstacle": HalfSpace((0.0, 0.2), (0.0, -1.0)).to_dict(), "stiffness": 1e4, "damping": 0.3, "friction": 0.3,
        "creep": 0.05, "bodies": ["link0@0.5"],
    }  # fmt: skip
    env = Arms("FlexibleArm-v0", 1, contacts=wall, formulation=formulation, tolerance=1e-9)
    state, action, h = env.reset(seed=0, options={"start": np.arcsin(0.4)}), np.array([[0.6]]), 1e-5
    for _ in range(5):
        state = env.step(state, action)[0]
    forward = env.jacobians(state, action)
    slope = (env.step(state, action + h)[0] - env.step(state, action - h)[0]) / (2.0 * h)
    assert abs(forward.B[..., 0] - slope).max() < 2e-6 * abs(slope).max()


def test_meshes_end_at_the_points() -> None:
    """The least number of elements from the usual one on of which one ends at each point; given numbers are kept."""
    third = "link0@0.3333333333"
    for given, elements, segments in (
        (("link0@0.5",), 4, 2), (("link0@0.3",), 10, 10), (("link0@0.25",), 4, 4), (("link0@0.5", third), 6, 6),
        ((third, "link0@0.5"), 6, 6), (("link0@0.25", "tip", third), 12, 12),
    ):  # fmt: skip
        contact = dataclasses.replace(POST, bodies=given)
        places = sorted(float(name.partition("@")[2]) for name in given if "@" in name)
        for formulation, wanted in (("geometrically_exact", elements), ("floating_frame", segments)):
            env: Any = gym.make("FlexibleArm-v0", contacts=contact, formulation=formulation).unwrapped
            assert (env.plan.settings.elements, env.plan.settings.segments)[formulation == "floating_frame"] == wanted
            # a straight arm shows where the points are
            env.reset(seed=0, options={"start": 0.0})
            assert env.snapshot().touches[: len(places), 0] == pytest.approx(places, abs=1e-9)


SECTIONS = tuple((s, Section(EI=EI, EA=1e6, C=1e6, m=0.3)) for s, EI in ((0.0, 7.0), (1.0, 3.5)))
SOFTER = dataclasses.replace(arms.named("strip"), links=(Link(1.0, SECTIONS),))
"""The strip with a section that changes along the link."""


@pytest.mark.parametrize(
    ("env_id", "keywords", "words"),
    [
        ("FlexibleArm-v0", {"formulation": "geometrically_exact", "elements": 3}, ("must be a multiple of 2, not 3",)),
        ("FlexibleArm-v0", {"formulation": "floating_frame", "segments": 3}, ("must be a multiple of 2, not 3",)),
        ("FlexibleArm-v0", {"bodies": ["link1@0.5"]}, ("must be on a link of arm",)),
        ("FlexibleArm-v0", {"bodies": ["link0@0.123"], "formulation": "floating_frame"}, ("denominator", "0.25")),
        (
            "FlexibleArm-v0", {"bodies": ["link0@0.0625", "link0@0.2"], "formulation": "geometrically_exact"},
            ("common denominator of at most 60", "not 80"),
        ),
        ("FlexibleArm-v0", {"arm": SOFTER}, ("straight and flexible with one Section",)),
        ("SpatialFlexArm-v0", {"elements": 3}, ("elements must be a multiple of 2, not 3",)),
    ],
)  # fmt: skip
def test_what_is_refused(env_id: str, keywords: dict[str, Any], words: tuple[str, ...]) -> None:
    contact = BALL if env_id == "SpatialFlexArm-v0" else POST
    if "bodies" in keywords:
        contact = dataclasses.replace(contact, bodies=tuple(keywords["bodies"]))
    others = {name: value for name, value in keywords.items() if name != "bodies"}
    told = refusal(lambda: gym.make(env_id, contacts=contact, **others))
    assert told.startswith(f"contacts[0].bodies[{int('not 80' in words)}] = "), told
    assert all(word in told for word in words), told


def test_players_draw_the_force_at_the_point() -> None:
    from flexarm_env.view.contact import contact_pulls

    env: Any = gym.make("FlexibleArm-v0", contacts=POST).unwrapped
    env.reset(seed=0, options={"start": 0.1})
    views = []
    for _ in range(40):
        env.step(np.array([0.5], np.float32))
        views.append(env.snapshot())
    (pull,) = contact_pulls(env.plan, views, [len(views[0].points) - 1], views[0].points)
    assert pull.name == "contact force, link 0 at 0.5"
    # shape points of a strip that is nearly straight
    assert np.linalg.norm(views[0].points[pull.point]) == pytest.approx(0.5, abs=0.05)
