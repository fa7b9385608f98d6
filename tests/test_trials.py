"""Trials of step and mesh: chains whose links buckle or whip amplify errors that small motions do not know of."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Joint, Link, Payload, Section, arms
from flexarm_env.batch import Amplifier
from flexarm_env.compiler import kernel
from flexarm_env.envs import options, trials
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.envs.resolution import resolve
from flexarm_env.envs.resolution_warnings import ResolutionWarning
from flexarm_env.envs.small_motions import Drive
from flexarm_env.envs.small_motions_models import SMALL_MOTIONS
from flexarm_env.envs.task import REACH, Kind
from flexarm_env.parameters import Elbow, RigidLink
from flexarm_env.settings import Settings
from flexarm_env.validation import Array

USUAL = Settings.make("elastica", nodes=4, dt=0.02 / 3.0, tolerance=1e-5)
PUSHED = Arm(
    "pushed",
    (Link(1.2, Section.rectangle(0.06, 0.008, 70e9, 2700.0, 26e9, 0.85)),
     Link(0.4, Section.rectangle(0.01, 0.001, 70e9, 2700.0, 26e9, 0.85))),
    hub_inertia=0.3, payload=Payload(1.5), torque_limits=(3.0, 0.02), tau_d=1e-3,
)  # fmt: skip
"""A thin link that pushes a payload of 140 times its mass, under ten times its buckling load."""


class Linear:
    """Small motions of second order in the step, with a part of the mesh that falls with the nodes."""

    def __init__(self, of_mesh: float = 0.0, floor: float = 0.0) -> None:
        self.of_mesh, self.floor = of_mesh, floor

    def small(self, settings: Settings, h: float) -> float:
        assert settings.nodes is not None
        return h * h + self.of_mesh * (4.0 / settings.nodes) ** 6 + self.floor

    def halved(self, settings: Settings, h: float) -> float:
        return 0.75 * h * h


def refined(tip: Any, rule: Linear, fractions: int = 32) -> tuple[Settings, float]:
    """`trials.refined` of tips (x, y) by settings."""

    def trial(settings: Settings) -> Array:
        return np.full((trials.PERIODS, SMALL_MOTIONS["xy"].lanes, 2), tip(settings))

    meshes = [replace(USUAL, nodes=6), replace(USUAL, nodes=8)]
    assert USUAL.dt is not None
    return trials.refined(
        trial, rule, USUAL, meshes, lambda mesh, h: replace(mesh, dt=h, tolerance=1e-9), USUAL.dt / fractions, 1.0,
        SMALL_MOTIONS["xy"].trials,
    )


def test_steps_are_halved_until_a_trial_is_good_enough() -> None:
    settings, error = refined(lambda s: 100.0 * s.dt**2, Linear())
    assert settings.dt == pytest.approx(0.02 / 6.0) and settings.nodes == 4 and error <= trials.TRIED
    settings, error = refined(lambda s: 1.0 * s.dt**2, Linear())
    assert settings == USUAL and error <= trials.TRIED


def test_a_mesh_whose_error_is_amplified_is_made_finer() -> None:
    settings, error = refined(lambda s: 1000.0 * s.dt**2, Linear(1e-5))
    assert settings.nodes == 8 and error <= trials.TRIED


def test_a_mesh_whose_error_small_motions_miss_is_seen_by_the_next_one() -> None:
    """Amplified 100 times in steps of h; the tip moves by 0.01 from 4 to 6 nodes, and not from 6 to 8."""
    settings, error = refined(lambda s: 30.0 * s.dt**2 + 0.01 * (s.nodes == 4), Linear())
    assert settings.nodes == 6 and settings.dt == USUAL.dt and error <= trials.TRIED


def test_the_scatter_of_episodes_tells_of_those_that_were_not_run() -> None:
    """Logarithms of d scatter by 2: 99.9 % of the episodes are below exp(mean + 3 * 2), of which a third is told."""
    one = np.zeros((trials.PERIODS, 2, 2))
    two = one + np.exp(np.array([-10.0, -6.0]))[:, None] * np.array([1.0, 0.0])
    assert trials._apart(one, two, 1.0) == pytest.approx(np.exp(-8.0 + 3.0 * 2.0) / 3.0)
    assert trials._apart(one, one + 0.001 * np.array([1.0, 0.0]), 1.0) == pytest.approx(0.001)


def test_a_mesh_that_small_motions_find_worse_is_not_taken() -> None:
    """Nodes crowd on a short piece of a link; the step alone is made shorter."""
    settings, error = refined(lambda s: 1000.0 * s.dt**2, Linear(-3e-7, 3.1e-7))
    assert settings.nodes == 4 and settings.dt < 0.02 / 6.0 and error <= trials.TRIED


def test_a_trial_that_fails_asks_for_shorter_steps_and_leaves_no_estimate_where_none_do() -> None:
    settings, error = refined(lambda s: np.inf if s.dt > 0.002 else 0.0, Linear())  # half the longest that runs
    assert settings.dt == pytest.approx(0.02 / 24.0) and error == 0.0
    settings, error = refined(lambda s: np.inf, Linear(), fractions=4)
    assert settings.dt == pytest.approx(0.02 / 12.0) and error == np.inf


def test_of_errors_that_scatter_the_finer_setting_is_taken() -> None:
    """d = 0.5, 0.55, 0.6: motions that no step resolves do not choose the longest one."""
    tips = {3: 0.0, 6: 0.5, 12: -0.05, 24: 0.55}
    settings, error = refined(lambda s: tips[round(0.02 / s.dt)], Linear(), fractions=4)
    assert settings.dt == pytest.approx(0.02 / 12.0) and error > 0.5


def settled(tip: Any, fractions: int = 32) -> tuple[Settings, float]:
    """`trials.settled` of tips (x, y) by settings; meshes of 6 and 8 nodes."""

    def trial(settings: Settings) -> Array:
        return np.full((trials.PERIODS, SMALL_MOTIONS["xy"].lanes, 2), tip(settings))

    mesh, finer = replace(USUAL, nodes=6), replace(USUAL, nodes=8)
    assert USUAL.dt is not None
    return trials.settled(trial, mesh, finer, lambda one, h: replace(one, dt=h), USUAL.dt / fractions, 1.0)


def test_a_loop_that_chatters_gets_the_step_that_trials_ask_for() -> None:
    settings, error = settled(lambda s: 100.0 * s.dt**2)
    assert settings.nodes == 6 and settings.dt == pytest.approx(0.02 / 6.0) and error <= trials.TRIED
    settings, error = settled(lambda s: float(s.nodes))
    assert settings.dt == pytest.approx(0.02 / 96.0) and error > 1.0


def test_corners_of_drawn_factors() -> None:
    assert trials.corners({}) == [] and trials.corners({"EI": (1.0, 1.0), "damping": (1.0, 1.0)}) == []
    soft, stiff = trials.corners({"EI": (0.2, 3.0), "payload": (0.5, 2.0)})
    assert soft == {"EI": 0.2, "payload": 2.0} and stiff == {"EI": 3.0, "payload": 0.5}


def test_fine_steps_of_the_rule_are_tried_too() -> None:
    """Friction asks for an eighth of the usual step and less; a trial that does not converge is told all the same."""
    joints = Joint(friction_coulomb=2.0), Joint(friction_coulomb=0.002)
    arm = replace(PUSHED, payload=Payload(0.1), hub_inertia=0.02, joints=joints)
    draw = np.random.default_rng(0)

    def trial(settings: Settings) -> Array:
        return draw.normal(size=(trials.PERIODS, SMALL_MOTIONS["xy"].lanes, 2))

    drive, usual = Drive.of(arm, "torque", None, None), DEFAULT_OPTIONS["elastica"]
    alone = resolve(arm, drive, 0.02, "elastica", usual, {})
    assert alone.settings.dt is not None and alone.settings.dt <= usual["dt"] / 8.0 and not alone.warning
    assert "amplify errors" in resolve(arm, drive, 0.02, "elastica", usual, {}, None, trial).warning


@pytest.mark.slow
def test_the_softest_arm_that_is_drawn_is_tried() -> None:
    """Factors of 0.2 on EI and 2 on the payload: a finer step or a larger estimate than the nominal arm's."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = gym.make("TwoLinkFlexArm-v0", arm=PUSHED).unwrapped.plan  # type: ignore[attr-defined]
        env = gym.make("TwoLinkFlexArm-v0", arm=PUSHED, randomization={"EI": (0.2, 1.0), "payload": (1.0, 2.0)})
    drawn = env.unwrapped.plan  # type: ignore[attr-defined]
    assert drawn.settings.dt < plain.settings.dt or drawn.estimate > 2.0 * plain.estimate


def test_shipped_arms_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(options, "trials_of", lambda *_: pytest.fail("tried"))
    for arm in (None, "two_link_geared", arms.named("quanser_2dsfl")):
        assert gym.make("TwoLinkFlexArm-v0", arm=arm).unwrapped.plan.settings.dt == 0.02 / 3.0  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_shipped_chain_with_wide_factors_is_tried() -> None:
    """Of 24 arms with EI down to a tenth and up to three payloads one was 0.0185 L off in usual steps (0.0026 said)."""
    wide: dict[str, Any] = {"randomization": {"EI": (0.1, 1.0), "payload": (1.0, 3.0)}}
    fine = {"formulation": "geometrically_exact", "elements": 6, "dt": 0.02 / 64, "tolerance": 1e-9}
    tips, estimate = [], 0.0
    for own in ({}, fine):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResolutionWarning)
            env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=24, **wide, **own)
        estimate = estimate or env.reset(seed=5)[1]["error_estimate"][0]
        env.reset(seed=5)
        draw, found = np.random.default_rng(1), np.full((100, 24, 2), np.nan)
        live = np.ones(24, bool)
        for k in range(100):
            if k % 8 == 0:
                action = draw.choice([-1.0, 1.0], size=(24, 2)).astype(np.float32)
            *_, terminated, _, info = env.step(action)
            live &= ~terminated
            found[k, live] = info["tip_position"][live]
        tips.append(found)
    error = np.nanmax(np.linalg.norm(tips[0] - tips[1], axis=2))
    assert 0.0 < error <= min(estimate, 0.01)


CHAINS = [
    (name, form, "SpatialFlexArm-v0" if arms.named(name).spatial else "MultiLinkFlexArm-v0")
    for name in ("three_dof", "three_dof_loaded", "turret_boom", "de_luca_siciliano", "quanser_2dsfl",
                 "quanser_2dsfl@design", "three_strips", "two_link_geared", "two_link_upright")
    for form in ("elastica", "geometrically_exact", "floating_frame")
    if not (arms.named(name).spatial and form == "elastica")
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form", "env_id"), CHAINS)
def test_estimates_of_shipped_chains_cover_their_trials(
    name: str, form: str, env_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trial in steps of h and h/2 under full bang-bang torques stays below `error_estimate`, or that says 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ResolutionWarning)
        plan = gym.make(env_id, arm=name, formulation=form).unwrapped.plan  # type: ignore[attr-defined]
    apart: list[float] = []

    def first(trial: Any, rule: Any, settings: Settings, finer: Settings, length: float) -> tuple[float, float]:
        assert settings == plan.settings
        tips = trial(settings), trial(finer)
        apart.append(float(np.nan_to_num(np.linalg.norm(tips[0] - tips[1], axis=2)).max() / length))
        return 0.0, 1.0  # good enough: no further trial

    monkeypatch.setattr(trials, "error", first)
    monkeypatch.setattr(trials, "shipped", frozenset)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResolutionWarning)
        gym.make(env_id, arm=name, formulation=form)
    assert len(apart) == 1 and apart[0] > 0.0
    assert min(apart[0], 1.0) <= plan.estimate


def test_shipped_chains_that_whip_warn_of_a_step_of_the_users_alone() -> None:
    """Their estimate is 1 whatever the step; a warning names a step that small motions need."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ResolutionWarning)
        assert gym.make("SpatialFlexArm-v0").reset(seed=0)[1]["error_estimate"] == 1.0
        assert gym.make("SpatialFlexArm-v0", dt=0.00125).reset(seed=0)[1]["error_estimate"] == 1.0
    with pytest.warns(ResolutionWarning, match=r"with dt=0.01 s: take dt=0.00\d+ s"):
        gym.make("SpatialFlexArm-v0", dt=0.01)


def test_reward_terms_of_the_user_are_no_part_of_a_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial is kept for its arm: a term that does not compile would fail every later environment of that arm."""

    @kernel
    def broken(lane, task, poses, action, record):
        return nowhere  # type: ignore[name-defined]  # noqa: F821

    def tried(kind: Kind, *_: Any) -> None:
        kinds.append(kind)

    kinds: list[Kind] = []
    monkeypatch.setattr(options, "trials_of", tried)
    terms = {"reward_terms": {"broken": broken}, "reward": {"change": 0.1, "broken": 2.0}}
    own = options.plan(REACH, arm=PUSHED, **terms)
    assert options.plan(REACH, arm=PUSHED).kind == kinds[0] == kinds[1] == REACH
    assert {"broken", "change"} <= own.kind.rewards.keys()


def test_trials_are_kept_by_all_that_moves_their_arms() -> None:
    """Arm, period, gravity, action, drive and drawn extremes; no two of these share a trial, and equal ones do."""
    amplifier = Amplifier(np.ones(2), np.ones(2), np.ones(2))
    usual: dict[str, Any] = {"arm": PUSHED, "period": 0.02, "gravity": None, "mode": "torque", "share": None,
                             "amplifier": None, "drawn": None}  # fmt: skip
    changes: list[dict[str, Any]] = [
        {}, {"arm": replace(PUSHED, tau_d=2e-3)}, {"period": 0.01}, {"gravity": (0.0, -9.81)},
        {"mode": "residual_pd", "share": 0.5}, {"mode": "residual_pd", "share": 0.6}, {"amplifier": amplifier},
        {"amplifier": amplifier._replace(emf=None)}, {"amplifier": amplifier._replace(gain=np.full(2, 2.0))},
        {"drawn": {"EI": (0.5, 1.0)}}, {"drawn": {"EI": (0.4, 1.0)}}, {"drawn": {"damping": (0.5, 1.0)}},
    ]  # fmt: skip
    found = [trials.trials_of(REACH, **(usual | change)) for change in changes]
    assert len({id(one) for one in found}) == len(changes) <= trials.KEPT
    assert [trials.trials_of(REACH, **(usual | change)) for change in changes] == found


@pytest.mark.slow
def test_a_link_that_buckles_gets_a_finer_step_and_an_estimate_that_says_so() -> None:
    """Small motions of the arm bend its thin link by 0.1 rad, and are right to 1e-4 with the usual step."""
    trial = trials.trials_of(REACH, PUSHED, 0.02, None, "torque", None, None)
    assert trial is not None
    coarse, fine = (trial(replace(USUAL, dt=0.02 / k)) for k in (3, 6))
    assert trials._apart(coarse, fine, PUSHED.total_length) > 0.01
    found = resolve(PUSHED, Drive.of(PUSHED, "torque", None, None), 0.02, "elastica", DEFAULT_OPTIONS["elastica"], {})
    tried = resolve(
        PUSHED, Drive.of(PUSHED, "torque", None, None), 0.02, "elastica", DEFAULT_OPTIONS["elastica"], {}, None, trial
    )
    assert found.settings.dt is not None and tried.settings.dt is not None
    assert tried.settings.dt < found.settings.dt and tried.estimate > found.estimate


def five_joints(friction: bool) -> Arm:
    """Yaw, shoulder and elbow with two aluminium strips, then a wrist that pitches and rolls 0.08 kg; 1 m."""
    base = arms.named("three_dof")
    sizes = (0.4, 0.04, 0.005), (0.35, 0.03, 0.004)
    strips = [Link(L, Section.rectangle(w, t, 70e9, 2700.0, 26e9, 0.85)) for L, w, t in sizes]
    wrist = RigidLink(0.06, 0.06, (0.03, 0.0, 0.0), 4e-5), RigidLink(0.04, 0.02, (0.02, 0.0, 0.0), 4e-6)
    joints = tuple(Joint(friction_viscous=x) for x in (2.0, 2.0, 1.0, 0.05, 0.005)) if friction else ()
    return replace(
        base, name="five", links=(base.links[0], *strips, *wrist),
        elbows=(*base.elbows, Elbow(), Elbow(axis=(1.0, 0.0, 0.0))), payload=Payload(0.01, 1e-6),
        torque_limits=(20.0, 20.0, 8.0, 0.1, 0.01), tau_d=1e-3, joints=joints, source="",
    )  # fmt: skip


@pytest.mark.slow
def test_a_light_wrist_in_space_is_as_accurate_as_it_says() -> None:
    """Inertias about the joints differ by 1e5: step, mesh and Newton's tolerance all follow."""
    arm, tips, estimates = five_joints(True), [], []
    for own in ({}, {"dt": 0.01 / 48, "elements": 8, "tolerance": 1e-9}):
        env = gym.make("SpatialFlexArm-v0", arm=arm, disable_env_checker=True, duration=100.0, **own)
        settings = env.unwrapped.plan.settings  # type: ignore[attr-defined]
        estimates.append(env.reset(seed=0, options={"start": [0.0, 0.3, 0.5, 0.4, 0.0]})[1]["error_estimate"])
        draw, found = np.random.default_rng(0), []
        for k in range(60):
            if k % 4 == 0:
                action = draw.uniform(-0.5, 0.5, 5).astype(np.float32)
            found.append(env.step(action)[4]["tip_position"])
        tips.append(np.array(found))
        assert settings.tolerance < 1e-8 and settings.dt < 0.0025
    assert np.linalg.norm(tips[0] - tips[1], axis=1).max() < min(estimates[0], 0.01)


@pytest.mark.slow
def test_a_wrist_that_whips_is_told() -> None:
    with pytest.warns(ResolutionWarning, match="amplify errors"):
        gym.make("SpatialFlexArm-v0", arm=five_joints(False), duration=100.0)
