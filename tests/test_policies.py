"""The trained policies that come with the package."""

import gymnasium as gym
import pytest

from flexarm_env import control
from flexarm_env.training.episodes import judged_in, make_episodes
from tests.env_tools import successes

NAMES = control.policy_names()


def test_the_package_brings_its_policies():
    assert NAMES == ("flexible_arm", "flexible_arm_robust", "two_link", "two_link_robust", "two_link_torque")


@pytest.mark.parametrize("name", NAMES)
def test_packaged_policies_reach_their_targets(name):
    policy = control.load_policy(name)
    env = make_episodes(policy.meta["env_id"], 16, **judged_in(policy.meta["env_kwargs"]))
    policy.check(control.Setup.of(env))
    assert successes(env, policy, 500) >= 0.9
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_packaged_policies_equal_their_models(name):
    pytest.importorskip("stable_baselines3")
    from agents import families
    from flexarm_env.training import export_policy
    from flexarm_env.training.runs import load_model, read_run

    family = families.named(name)
    runs = family.runs(families.TRAINED)
    assert len(runs) == family.seeds
    best = family.best(families.TRAINED)
    assert (best / "policy.npz").read_bytes() == (families.PACKAGED / name / "policy.npz").read_bytes()
    model, normaliser = load_model(best, read_run(best)["algorithm"])
    assert export_policy.difference(control.load_policy(name), model, normaliser) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "keywords", "says"),
    [
        ("two_link_robust", {"action_mode": "residual_pd"}, r"residual_share = 3\.0; .* is 0\.7"),
        ("two_link_robust", {}, "action_mode = 'residual_pd'; .* is 'torque'"),
        ("two_link_torque", {"action_mode": "residual_pd"}, "action_mode = 'torque'; .* is 'residual_pd'"),
    ],
)
def test_a_policy_whose_actions_mean_other_torques_is_refused(name, keywords, says):
    """Observations are the same in all of these."""
    policy = control.load_policy(name)
    seen = {key: policy.meta["env_kwargs"][key] for key in ("observation",) if key in policy.meta["env_kwargs"]}
    setup = control.Setup.of(gym.make("TwoLinkFlexArm-v0", **seen, **keywords))
    with pytest.raises(ValueError, match=says):
        policy.check(setup)


@pytest.mark.slow
def test_a_policy_that_names_no_share_was_trained_with_the_usual_one():
    policy = control.load_policy("two_link_robust")
    del policy.meta["env_kwargs"]["residual_share"]
    keywords = {"action_mode": "residual_pd", "observation": policy.meta["env_kwargs"]["observation"]}
    policy.check(control.Setup.of(gym.make("TwoLinkFlexArm-v0", **keywords)))
    with pytest.raises(ValueError, match=r"residual_share = 0\.7; .* is 1\.5"):
        policy.check(control.Setup.of(gym.make("TwoLinkFlexArm-v0", **keywords, residual_share=1.5)))


def test_a_policy_that_does_not_fit_is_named() -> None:
    env = gym.make("TwoLinkFlexArm-v0", observation="measured")
    with pytest.raises(ValueError, match=r"^policy two_link_torque: the policy was trained on TwoLinkFlexArm-v0"):
        control.load_policy("two_link_torque", env)
