"""Rewards under rules 2: to end an episode early never pays, and returns do not depend on the control period."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Base, Elbow, Link, Payload, Section, arms
from flexarm_env.envs.options import Plan, plan
from flexarm_env.envs.space import SPACE
from flexarm_env.envs.task import CHAIN, REACH, SLEW, Kind
from tests.refusals import refuses

KINDS = (SLEW, REACH, CHAIN, SPACE)
JOINTS = {SLEW.id: 1, REACH.id: 2, CHAIN.id: 0}


def random_arm(rng: np.random.Generator, n: int) -> Arm:
    """n links of 0.1 to 5 m whose torques turn them by a quarter in 0.2 to 5 s."""
    links = tuple(
        Link(float(length), Section(EI=float(rng.uniform(0.1, 100.0)), EA=1e6, C=1e6, m=float(rng.uniform(0.05, 2.0))))
        for length in 10.0 ** rng.uniform(-1.0, 0.7, n)
    )
    elbows = tuple(Elbow(0.1, 0.01, 0.01) for _ in range(n - 1))
    arm = Arm("random", links, hub_inertia=0.05, elbows=elbows, payload=Payload(float(rng.uniform(0.0, 5.0))))
    return dataclasses.replace(arm, torque_limits=tuple(10.0 ** rng.uniform(-1.0, 2.0, n)))


def worst(made: Plan) -> float:
    """The least that a period pays in an episode that goes on, from the bounds of the terms in the docstring."""
    weight = dict(zip(made.kind.rewards, made.record.weights.tolist(), strict=True))
    joints = made.arm.n_links * (weight["effort"] + 4.0 * weight.get("change", 0.0))
    return -(joints + weight["vibration"] + weight.get("cost", 0.0))


@pytest.mark.parametrize("kind", KINDS, ids=[kind.id for kind in KINDS])
def test_no_end_pays_more_than_the_worst_that_can_follow(kind: Kind, rng: np.random.Generator) -> None:
    """At any instant a failure costs at least what all periods that are left can take: whatever is paid until then,
    going on is no worse. For random arms, periods, durations and prices."""
    for _ in range(12):
        arm: Any = "three_dof" if kind.axes == "xyz" else random_arm(rng, JOINTS[kind.id] or int(rng.integers(2, 5)))
        period = float(rng.choice([0.005, 0.01, 0.02, 0.05]))
        more: dict[str, Any] = {"reward": {"change": float(rng.uniform(0.0, 0.5))}} if rng.random() < 0.5 else {}
        if more and kind.axes == "xy":
            more = {"reward": {**more["reward"], "cost": 0.3}, "cost": {"deflection": 0.1}}
        if kind.id != CHAIN.id and kind.axes == "xy" and rng.random() < 0.3:
            more["base"] = Base(10.0, 1.0)
        made = plan(kind, arm=arm, control_dt=period, duration=float(rng.uniform(1.0, 20.0)), **more)
        failure = made.record.weights[-1]
        assert -failure <= made.limit * worst(made) * (1.0 - 1e-12)


@pytest.mark.parametrize("env_id", ["TwoLinkFlexArm-v0", pytest.param("MultiLinkFlexArm-v0", marks=pytest.mark.slow)])
def test_crashing_does_not_pay(env_id: str) -> None:
    """Mean return of 30 episodes: rules 1 pay -19.7 and -19.6 for full torques into the joint limit, -140.9 and -184.9
    for standing still. Under rules 2 no episode that ends so has more than one that stands still."""

    def returns(rules: int, action: list[float]) -> tuple[np.ndarray, np.ndarray]:
        env: Any = gym.make_vec(env_id, num_envs=30, vectorization_mode="vector_entry_point", rules=rules)
        env.reset(seed=0)
        total, alive, failed = np.zeros(30), np.ones(30, bool), np.zeros(30, bool)
        actions = np.tile(np.array(action, np.float32), (30, 1))
        for _ in range(env.unwrapped.plan.limit):
            _, reward, terminated, truncated, _ = env.step(actions)
            total += alive * reward
            failed |= alive & terminated
            alive &= ~(terminated | truncated)
        return total, failed

    n = 2 if env_id.startswith("Two") else 3
    crash = [1.0, *[-1.0] * (n - 1)]
    for rules in (1, 2):
        still, _ = returns(rules, [0.0] * n)
        ended, failed = returns(rules, crash)
        assert failed.all()
        assert (still.mean() < ended.mean() - 100.0) if rules == 1 else (still >= ended).all()


def test_returns_do_not_depend_on_the_control_period() -> None:
    """The same torques over time, in periods of 20, 10 and 5 ms; under rules 1 a half doubles the return."""

    def total(period: float, rules: int) -> float:
        env = gym.make("FlexibleArm-v0", control_dt=period, dt=0.005, rules=rules)
        env.reset(seed=1, options={"start": 0.2, "target": 0.6})
        paid, t = 0.0, 0.0
        for _ in range(round(4.0 / period)):
            pull = 0.3 * math.sin(math.floor(t / 0.1 + 1e-9))
            paid, t = paid + float(env.step(np.array([pull], np.float32))[1]), t + period
        return paid

    usual = total(0.02, 2)
    assert total(0.01, 2) == pytest.approx(usual, rel=0.01) and total(0.005, 2) == pytest.approx(usual, rel=0.015)
    assert total(0.01, 1) == pytest.approx(2.0 * total(0.02, 1), rel=0.02)


def test_weights_by_both_rules() -> None:
    """Rules 2 are those of the kind at its own period, failure follows from an episode's length, or as it is given."""
    strip = arms.named("strip")
    old, new = (plan(SLEW, arm=strip, control_dt=0.01, rules=rules).record for rules in (1, 2))
    assert old.weights.tolist() == [0.5, 1.0, 0.5, 0.01, 0.02, 5.0] and old.nearness is None
    assert new.weights == pytest.approx([0.25, 0.5, 0.25, 0.005, 0.01, 400 * 0.015 + 50.0]) and new.nearness == (0,)
    given = plan(SLEW, control_dt=0.01, reward={"failure": 7.0, "effort": 0.1}).record.weights
    assert given[3] == pytest.approx(0.05) and given[-1] == 7.0
    assert plan(SLEW, max_episode_steps=50).record.weights[-1] == pytest.approx(50 * 0.03 + 50.0)
    refuses("rules = 3: must be a whole number, from 1 to 2", lambda: plan(SLEW, rules=3))
