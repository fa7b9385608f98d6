"""Default step, mesh and tolerance of environments: those of shipped arms stay, an arm of one's own gets its own."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Joint, Link, Payload, Section, arms
from flexarm_env.envs import resolution
from flexarm_env.envs.judge import Judge
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.envs.resolution import resolve
from flexarm_env.envs.resolution_warnings import ResolutionWarning
from flexarm_env.envs.small_motions import Drive, Motion, chain, exponential, fine, vibrations
from flexarm_env.envs.small_motions_space import of_space
from flexarm_env.envs.space import SPACE
from flexarm_env.linear import static_equilibrium
from flexarm_env.scene import PointLoad
from flexarm_env.settings import Settings
from flexarm_env.time_functions import constant
from tests.linear_tools import at_rest, one_link

STRIP = arms.named("strip")
KEPT = [name for name in arms.names() if not arms.named(name).spatial]
CHANGED = {("two_link_upright", "geometrically_exact")}
"""Its hub turns without limits, at rates at which the exact beam's usual step leaves 0.29 of the length."""


def settings_of(arm: Arm, formulation: str = "elastica", mode: str = "torque", **given: Any) -> Settings:
    usual = DEFAULT_OPTIONS[formulation]
    return resolve(arm, Drive.of(arm, mode, None, None), 0.02, formulation, usual, given).settings


@pytest.mark.parametrize("formulation", resolution.MESHES)
@pytest.mark.parametrize("name", KEPT)
def test_shipped_arms_keep_the_usual_settings(name: str, formulation: str) -> None:
    if (name, formulation) not in CHANGED:
        usual = Settings.make(formulation, **DEFAULT_OPTIONS[formulation])
        assert settings_of(arms.named(name), formulation) == usual


@pytest.mark.parametrize("name", ["three_dof", "three_dof_loaded", "turret_boom", "satellite_arm"])
def test_shipped_arms_in_space_keep_the_usual_settings(name: str) -> None:
    arm = arms.named(name)
    usual = dict(SPACE.settings or {})
    found = resolve(arm, Drive.of(arm, "torque", None, None), SPACE.period, "geometrically_exact", usual, {})
    assert found.settings == Settings.make("geometrically_exact", **usual)


def test_small_motions_have_the_frequencies_of_a_strip() -> None:
    """A cantilever with nothing at its tip: 1.8751^2 sqrt(EI / m L^4) and 4.6941^2 (Euler and Bernoulli)."""
    section = Section(EI=2.0, EA=1e7, C=1e7, m=0.3, J=1e-9)
    arm = Arm("bare", (Link(0.7, section),), hub_inertia=1e9, torque_limits=(1.0,))
    motion = Motion.of(arm, fine(arm), np.zeros(1))
    own = np.sqrt(2.0 / 0.3) / 0.7**2
    expected = np.array([1.87510407, 4.69409113]) ** 2 * own
    assert np.allclose(np.sqrt(vibrations(motion.M, motion.K)[0][1:3]), expected, rtol=1e-6)


def test_the_reference_of_a_stepped_link_is_finer_than_its_meshes() -> None:
    """Three frequencies of a link with a thin tail are those on 21 nodes within 2e-4; on 7 nodes they are not."""
    arm = Arm("stepped", (Link(0.38, ((0.0, THICK), (0.3, THICK), (0.3, THIN), (0.38, THIN))),), hub_inertia=0.01,
              payload=Payload(0.15), torque_limits=(1.0,))  # fmt: skip
    found = [Motion.of(arm, parts, np.zeros(1)) for parts in (fine(arm), chain(arm, 21), chain(arm, 7))]
    own, known, coarse = (np.sqrt(vibrations(one.M, one.K)[0][1:4]) for one in found)
    assert np.abs(own / known - 1.0).max() < 2e-4 < np.abs(coarse / known - 1.0).max()


def test_small_motions_in_space_bend_in_both_planes_and_twist() -> None:
    """Frequencies of a clamped strip about both axes, and of its torsion, sqrt(GJ / J) pi / 2 L."""
    link = arms.named("three_dof").links[1]
    arm = Arm("bare", (link,), hub_inertia=((1e9, 0, 0), (0, 1e9, 0), (0, 0, 1e9)), torque_limits=(1.0,))
    found = np.sqrt(np.diag(of_space(arm, 8, np.zeros(1)).K))
    s = np.zeros(1)
    EI, m, J = (float(getattr(link.along(s), name)[0]) for name in ("EI", "m", "J"))
    across = {name: float(values[0]) for name, values in link.across(s).items()}
    bending = [1.87510407**2 * np.sqrt(stiff / m) / link.length**2 for stiff in (EI, across["EI_y"])]
    torsion = np.sqrt(across["GJ"] / (J + across["J_y"])) * 0.5 * np.pi / link.length
    for frequency in (*bending, torsion):
        assert abs(found / frequency - 1.0).min() < 2e-3


def test_the_exponential_is_that_of_an_oscillator() -> None:
    w, t = 300.0, 0.02
    found = exponential(np.array([[0.0, 1.0], [-(w**2), 0.0]]) * t)
    expected = np.array([[np.cos(w * t), np.sin(w * t) / w], [-w * np.sin(w * t), np.cos(w * t)]])
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_steps_of_small_motions_are_those_of_the_elastica() -> None:
    """One period of the solver from rest is what the model's steps say, to second order in the torque."""
    env = gym.make("FlexibleArm-v0", duration=1.0, info_level="full")
    env.reset(seed=0, options={"start": 0.0, "target": 1.0})
    _, _, _, _, info = env.step(np.array([0.05], np.float32))
    settings = Settings.make("elastica", **DEFAULT_OPTIONS["elastica"])
    assert settings.dt is not None
    motion = Motion.of(STRIP, chain(STRIP, 4), np.zeros(1), settings, settings.dt)
    state = motion.stepped(settings.dt, 3)[:, -1] * 0.1
    assert abs(motion.tip[1] @ state[:4] - info["tip_position"][1]) < 1e-3 * abs(info["tip_position"][1])


@pytest.mark.parametrize("elements", [2, 5])
def test_linear_elements_are_as_stiff_as_the_rule_says(elements: int) -> None:
    """A cantilever under an end load, P L^3 / 3 EI + P L / C, of linear elements with one Gauss point: its bending is
    smaller by 1 / (4 E^2), the rule's factor to second order in that."""
    section = Section(EI=2.0, EA=1e5, C=600.0, m=1.0, J=1e-4)
    scene = at_rest(one_link(section), loads=(PointLoad(0, "tip", force_y=constant(-1e-4)),))
    tip = static_equilibrium(scene, "geometrically_exact", elements=elements, order=1).observe()[0][0, 7]
    bending = -tip / 1e-4 - 1.0 / 600.0
    assert bending * 6.0 == pytest.approx(1.0 / (1.0 + 0.25 / elements**2), abs=0.1 / elements**4)
    rule = Judge(STRIP, Drive.of(STRIP, "torque", None, None), 0.02)
    usual = Settings.make("geometrically_exact", elements=elements, dt=0.0025)
    one, two = (rule._motion(usual.replace(order=order), np.zeros(1), 1e-6).K for order in (1, 2))
    assert np.allclose(one, two * (1.0 + 0.25 / elements**2), rtol=1e-9)


def test_steps_of_small_motions_have_the_damping_of_newmarks_scheme() -> None:
    """Decay of the first vibration in a step: the eigenvalues of the scheme's own step for x'' + w^2 x = 0."""
    arm, h, beta, gamma = replace(STRIP, tau_d=0.0), 0.004, 0.3025, 0.6
    settings = Settings.make("geometrically_exact", newmark=(beta, gamma), dt=h)
    motion = Judge(arm, Drive.of(arm, "torque", None, None), 0.02)._motion(settings, np.zeros(1), h)
    w = float(np.sqrt(vibrations(motion.M, motion.K)[0][1]))
    # x, h v, h^2 a at the end of a step, from those at its beginning
    after = np.array([[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [(w * h) ** 2, 0.0, 1.0]])
    before = np.array([[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [0.0, 0.0, 0.0]])
    decay = np.log(np.abs(np.linalg.eigvals(np.linalg.solve(after, before))).max())
    own = np.linalg.eigvals(motion.stepped(h, 1)[:, : 2 * len(motion.M)])
    slow = own[np.argmin(np.abs(np.abs(np.angle(own)) - w * h))]
    assert 0.0 > np.log(abs(slow)) == pytest.approx(decay, rel=0.02)


def test_options_that_change_the_error_are_told_apart() -> None:
    """One rule serves all environments of an arm: their meshes, orders and schemes are no others'."""
    rule, h = Judge(STRIP, Drive.of(STRIP, "torque", None, None), 0.02), 0.0025
    usual = Settings.make("geometrically_exact", elements=5, dt=h)
    others = [{"order": 1}, {"newmark": (0.3025, 0.6)}, {"newmark": (0.25, 0.5)}, {"rho_inf": 0.0}, {"elements": 3}]
    found = [rule.small(usual.replace(**other), h) for other in ({}, *others)]
    assert len(set(found)) == len(found) and min(found[1:3]) > 5.0 * found[0]


def geared(**joint: Any) -> Arm:
    return replace(STRIP, joints=(Joint(**joint),))


THICK, THIN = (Section.rectangle(0.03, t, 70e9, 2700.0, 26e9, 0.85) for t in (0.00342, 0.0015))
OWN = {
    "stepped": (replace(STRIP, links=(Link(1.0, ((0.0, THICK), (0.5, THICK), (0.5, THIN), (1.0, THIN))),)), "torque"),
    "light rotor in a loop": (geared(stiffness=30.0, motor_inertia=1e-4, damping=0.1), "residual_pd"),
    "play": (geared(stiffness=1e4, motor_inertia=0.027, backlash=0.1), "torque"),
    "friction": (geared(friction_coulomb=1.9), "torque"),
}
GEARED = arms.named("strip_geared")
HALF = replace(GEARED, joints=(replace(GEARED.joint(0), motor_inertia=0.5 * GEARED.joint(0).motor_inertia),))
"""Under action_mode="residual_pd" its rotor swings on the gear without end."""
DAMPED = geared(stiffness=30.0, motor_inertia=1e-4, damping=0.3)
"""Under action_mode="residual_pd" it does in small motions; limits of the torque let it settle."""


@pytest.mark.parametrize(
    ("case", "formulation"),
    [(case, name) for case in OWN for name in resolution.MESHES if name == "elastica" or OWN[case][1] == "torque"],
)
def test_an_arm_of_ones_own_gets_a_finer_step(case: str, formulation: str) -> None:
    """In the loop the step of the other formulations is short enough as it is."""
    arm, mode = OWN[case]
    found, usual = settings_of(arm, formulation, mode), DEFAULT_OPTIONS[formulation]
    assert found.dt is not None and found.dt <= 0.51 * usual["dt"]
    assert found.tolerance <= 0.26 * usual["tolerance"]
    assert abs(0.02 / found.dt - round(0.02 / found.dt)) < 1e-6
    assert settings_of(arm, formulation, mode, dt=usual["dt"]).dt == usual["dt"], "what is given is not changed"


def largest_error(case: str, **options: Any) -> float:
    """Of the tip, over L, from an exact beam in fine steps, in 60 periods."""
    arm, mode = OWN.get(case, (DAMPED, "residual_pd"))
    tips = []
    for own in (options, {"formulation": "geometrically_exact", "elements": 6, "dt": 0.02 / 256, "tolerance": 1e-9}):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResolutionWarning)
            env = gym.make_vec("FlexibleArm-v0", num_envs=1, arm=arm, action_mode=mode, threads=1, **own)
        env.reset(seed=0, options={"start": 0.0, "target": 1.0})
        draw, found = np.random.default_rng(0), []
        for k in range(60):
            if k % 8 == 0:
                action = np.sign(draw.uniform(-1.0, 1.0, (1, 1))).astype(np.float32) * (mode == "torque")
            found.append(env.step(action)[4]["tip_position"][0])
        tips.append(np.array(found))
    return float(np.linalg.norm(tips[0] - tips[1], axis=1).max())


@pytest.mark.slow
@pytest.mark.parametrize("case", ["stepped", "light rotor in a loop", "friction", "a loop that chatters"])
def test_default_settings_are_as_good_as_they_say(case: str) -> None:
    usual = dict(DEFAULT_OPTIONS["elastica"])
    assert largest_error(case) < 0.005 < 0.015 < largest_error(case, **usual)


def test_a_step_that_is_too_long_is_told_with_one_that_would_do() -> None:
    with pytest.warns(ResolutionWarning, match=r"with dt=0.00667 s: take dt=0.00\d+ s, or a step_tolerance"):
        gym.make("FlexibleArm-v0", arm=OWN["friction"][0], dt=0.02 / 3.0)


def test_a_loop_that_does_not_settle_is_told_with_the_control_period() -> None:
    with pytest.warns(ResolutionWarning, match=r"take control_dt less than 0.02 s"):
        gym.make("FlexibleArm-v0", arm="strip_upright", action_mode="residual_pd")


def test_a_loop_that_does_not_settle_gets_a_step_that_resolves_its_rotor() -> None:
    """Trials tell its error, where small motions know none."""
    with pytest.warns(ResolutionWarning, match=r"does not settle.*: take control_dt less than 0.02 s"):
        plan = gym.make("FlexibleArm-v0", arm=HALF, action_mode="residual_pd").unwrapped.plan  # type: ignore[attr-defined]
    assert plan.settings.dt <= 0.02 / 24.0 and plan.settings.nodes > 4 and plan.estimate <= 1.0


def test_the_estimate_of_an_environment_has_mesh_and_step_in_it() -> None:
    """It falls with the step, and is infinite where small motions are not those of the arm."""
    found = []
    for dt in (0.0025, 0.00125):
        env = gym.make("FlexibleArm-v0", dt=dt, formulation="geometrically_exact")
        found.append(env.reset(seed=0)[1]["error_estimate"])
    assert 0.02 > found[0] > 3.0 * found[1] > 0.0
    assert gym.make("FlexibleArm-v0", arm="paper").reset(seed=0)[1]["error_estimate"] == np.inf


def test_in_space_an_arm_of_ones_own_gets_a_finer_step() -> None:
    """0.3 m, of two aluminium strips with second modes at 1080 rad/s, which 2.5 ms do not resolve."""
    base = arms.named("three_dof")

    def flat(thickness: float, width: float) -> Link:
        return Link(0.12, Section.rectangle(width, thickness, 70e9, 2700.0, 26e9, 0.85))

    pillar = replace(base.links[0], length=0.06, mass=0.2, centre=(0.03, 0.0, 0.0), inertia=1e-4)
    links = (pillar, flat(0.0012, 0.015), flat(0.001, 0.012))
    arm = replace(base, links=links, payload=Payload(0.02), torque_limits=(0.2, 0.1, 0.05), tau_d=2e-4)
    usual = dict(SPACE.settings or {})
    found = resolve(arm, Drive.of(arm, "torque", None, None), 0.01, "geometrically_exact", usual, {})
    assert found.settings.dt is not None and found.settings.dt < 1e-3 and found.estimate < 0.01


def test_light_wrists_in_space_have_a_finer_tolerance() -> None:
    arm = arms.named("three_dof")
    rule = resolution.worst(arm, Drive.of(arm, "torque", None, None), 0.01, {})
    usual = Settings.make("geometrically_exact", **dict(SPACE.settings or {}))
    assert resolution._tolerance(rule, usual, 0.0025) == usual.tolerance
    light = replace(arm, links=(*arm.links[:2], Link(0.05, arm.links[2].section)))
    rule = resolution.worst(light, Drive.of(light, "torque", None, None), 0.01, {})
    assert resolution._tolerance(rule, usual, 0.0025) < 0.5 * usual.tolerance


def test_what_is_drawn_farthest_counts() -> None:
    """Stiffnesses down to a thirtieth ask for more than the nominal arm; those of a suite task for nothing."""
    drive, usual = Drive.of(STRIP, "torque", None, None), DEFAULT_OPTIONS["elastica"]
    kept = resolve(STRIP, drive, 0.02, "elastica", usual, {}, {"EI": (0.5, 1.5), "payload": (0.25, 4.0)})
    assert kept.settings == Settings.make("elastica", **usual)
    soft = resolve(STRIP, drive, 0.02, "elastica", usual, {}, {"EI": (0.03, 1.0)})
    assert soft.settings.dt is not None and soft.settings.dt < usual["dt"] and soft.settings.nodes > usual["nodes"]
