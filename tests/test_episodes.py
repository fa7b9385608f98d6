"""Playing, recording and measuring episodes."""

import math
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Link, Section
from flexarm_env.control import Setup
from flexarm_env.episodes import Actions, History, Instant, Timed, measures, periods, play
from flexarm_env.recording import EpisodeRecorder

ENV = "FlexibleArm-v0"


def setup_of(task: str, joints: int = 1, **more: Any) -> Setup:
    """Facts of an arm with links of 2 m and torque limits of 4 N m."""
    arm = Arm("made up", (Link(2.0, Section(EI=1.0, EA=1e4, C=1e4, m=0.2)),) * joints)
    facts = {"control_dt": 0.1, "torque_limits": (4.0,) * joints, "names": (), "scales": ()}
    return Setup(task=task, arm=arm, **facts | more)


def played(rows: dict[str, Any], rewards: Any = None, terminated: int | None = None, limit: int = 0) -> History:
    """History of one episode with rows of `info`, T + 1 for each name; `terminated`: the period of an early end."""
    history = History(*rows, limit=limit)
    infos = [dict(zip(rows, values, strict=True)) for values in zip(*rows.values(), strict=True)]
    history(Instant([5], 0, None, None, 0.0, False, False, infos[0], True))
    for k, info in enumerate(infos[1:], 1):
        reward = 0.0 if rewards is None else rewards[k - 1]
        history(Instant([5], k, None, None, reward, k == terminated, k == len(infos) - 1, info, True))
    return history


def slewed(angles: Any, target: float, **more: Any) -> History:
    """History of a tip at these angles, rad, 2 m from the hub."""
    tips = [2.0 * np.array([math.cos(a), math.sin(a)]) for a in angles]
    return played({"tip_position": tips, "target": [np.float64(target)] * len(tips)}, **more)


# ------------------------------------------------------------------ measures
def test_the_settling_time_counts_from_the_last_exit_of_the_band() -> None:
    """2 % of a slew of 1 rad; an error at the band's edge in the last period counts as settled then."""
    setup, far, near = setup_of("slew"), 0.5, 0.985
    for inside, time in (([4, 5, 6, 7, 8, 9, 10], 0.4), ([4, 5, 6, 8, 9, 10], 0.8), ([10], 1.0), ([], None)):
        angles = [0.0] + [near if k in inside else far for k in range(1, 11)]
        (found,), (settled,) = measures.settling_time(slewed(angles, 1.0), setup)
        assert (found, settled) == (pytest.approx(1.0 if time is None else time), time is not None)
    # an episode that ends early has not settled, and counts with the full duration
    early = slewed([0.0, near, near], 1.0, terminated=2, limit=10)
    (found,), (settled,) = measures.settling_time(early, setup)
    assert (found, settled) == (pytest.approx(1.0), False)


def test_the_band_of_small_slews_and_of_reaches() -> None:
    assert float(measures.settling_band(setup_of("slew"), 0.1)) == pytest.approx(math.radians(0.5))
    assert float(measures.settling_band(setup_of("slew"), 2.0)) == pytest.approx(0.04)
    assert float(measures.settling_band(setup_of("reach", 2), 2.0)) == pytest.approx(0.02 * 4.0)


def test_errors_of_slews_continue_over_full_turns() -> None:
    """A tip that passes pi is not a full turn away."""
    errors = measures.tip_errors(slewed(np.linspace(3.0, 3.4, 5), 3.2), setup_of("slew"))
    assert errors[:, 0, 0] == pytest.approx(np.linspace(0.2, -0.2, 5))


def test_overshoot_is_measured_along_the_initial_direction() -> None:
    """0.05 beyond a target at 0.5; in the plane, motion across the direction does not count."""
    assert measures.overshoot(slewed([0.0, 0.4, 0.55, 0.5], 0.5), setup_of("slew")) == pytest.approx([0.1])
    tips = [np.array(p) for p in ((0.0, 0.0), (1.1, 0.5), (1.0, 0.0))]
    history = played({"tip_position": tips, "target": [np.array((1.0, 0.0))] * 3})
    assert measures.overshoot(history, setup_of("reach", 2)) == pytest.approx([0.1])


def test_residual_vibration_is_that_of_the_last_second() -> None:
    """Half the distance of the extremes, in m, of links of 2 m; in space of the deflection's magnitude."""
    setup = setup_of("slew", control_dt=0.25)
    bends = [9.0, 9.0, 0.01, -0.02, 0.03, 0.0, 0.0]
    assert measures.residual_vibration(played({"tip_deflection": bends}), setup) == pytest.approx([0.5 * 2.0 * 0.05])
    rows = [np.array([[3.0 * b, 0.0], [4.0 * b, 0.0]]) for b in (0.0, 0.0, 0.0, 0.01, 0.0)]
    history = played({"tip_deflection": rows})
    assert measures.residual_vibration(history, setup_of("reach", 2, control_dt=0.25)) == pytest.approx([0.05])


def test_effort_cost_and_return_are_sums() -> None:
    """Torques of half the limit of 4 N m on two joints for 0.3 s: 2 (1/2)^2 0.3 s."""
    history = played({"joint_torque": [np.full(2, np.nan), *[np.full(2, 2.0)] * 3], "cost": [0.0, 1.0, 2.0, 4.0]},
                     rewards=[1.0, 2.0, 3.0])  # fmt: skip
    assert measures.effort(history, setup_of("reach", 2)) == pytest.approx([0.15])
    assert (measures.cost(history).tolist(), measures.returns(history).tolist()) == ([7.0], [6.0])
    assert measures.cost(played({"is_success": [False, True]})).tolist() == [0.0]
    with pytest.raises(ValueError, match="history = 'target': was not recorded; recorded: joint_torque, cost, rewards"):
        history.info("target")


def test_success_counts_from_the_period_after_the_last_failure() -> None:
    for good, period in (([0, 0, 1, 1], 3), ([1, 1, 0, 1], 4), ([1, 1, 1, 1], 1), ([1, 1, 1, 0], 0)):
        history = played({"is_success": [False, *map(bool, good)]})
        assert measures.success_period(history).tolist() == [period]
        assert measures.success(history).tolist() == [period > 0]
    early = played({"is_success": [False, True, True]}, terminated=2)
    assert (measures.success_period(early).tolist(), measures.success(early).tolist()) == ([0], [False])


# ------------------------------------------------------------------ playing
class Falling:
    """Vector environment whose episode of seed s ends after s periods, by failure if s is odd; rewards are seeds."""

    num_envs = 2

    def reset(self, seed: Any) -> Any:
        self.seeds = np.array([seed, seed + 1] if isinstance(seed, int) else seed)
        self.k = 0
        return np.zeros((2, 1), np.float32), {"time": np.zeros(2)}

    def step(self, action: Any) -> Any:
        self.k += 1
        over = self.seeds == self.k
        ends = over & (self.seeds % 2 == 1), over & (self.seeds % 2 == 0)
        return np.zeros((2, 1), np.float32), self.seeds.astype(float), *ends, {"time": np.full(2, float(self.k))}


STILL = SimpleNamespace(reset=lambda seen: None, act=lambda seen: np.zeros((2, 1), np.float32))


def test_episodes_count_to_their_ends_in_turns_of_a_vector_environment() -> None:
    history = History("time")
    play(Falling(), STILL, [1, 2, 5, 3], [history])
    assert (history.seeds, history.lengths.tolist()) == ((1, 2, 5, 3), [1, 2, 5, 3])
    assert history.terminated.tolist() == [True, False, True, True]
    assert measures.returns(history).tolist() == [1.0, 4.0, 25.0, 9.0]
    assert np.nanmax(history.info("time"), axis=0).tolist() == [1.0, 2.0, 5.0, 3.0]
    with pytest.raises(ValueError, match="seeds = '3 seeds': must be a multiple of the 2 arms of env"):
        play(Falling(), STILL, [1, 2, 3])


def test_other_autoreset_modes_are_rejected() -> None:
    """Their `info` in the last period is that of the next episode."""
    env = gym.make_vec(ENV, num_envs=2, autoreset_mode="SameStep")
    with pytest.raises(ValueError, match=r"env.autoreset_mode = 'SameStep': must be NextStep to play episodes"):
        play(env, STILL, [1, 2])


def test_one_arm_and_many_have_the_same_measures() -> None:
    """Seeds 3 and 4 in a vector environment, in a single one, and from recorded episodes, to the bit."""
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (25, 1, 1)).astype(np.float32)
    many, one = gym.make_vec(ENV, num_envs=2, duration=0.5), EpisodeRecorder(gym.make(ENV, duration=0.5))
    together, alone = History(*measures.EVERY), History(*measures.EVERY)
    play(many, Actions(np.repeat(actions, 2, axis=1)), range(3, 5), [together])
    clocked = Timed(Actions(actions[:, 0]), lambda: 1.0)
    play(one, clocked, range(3, 5), [alone])
    assert clocked.seconds == [0.0] * 50
    setup, saved = Setup.of(one), History.of(*one.episodes)
    for history in (alone, saved):
        assert history.seeds == (3, 4)
        for measure in (measures.returns, measures.success, measures.success_period, measures.cost):
            assert np.array_equal(measure(history), measure(together))
        assert np.array_equal(measures.overshoot(history, setup), measures.overshoot(together, setup))
        for of_arm in (measures.effort, measures.residual_vibration, measures.tip_errors):
            assert np.array_equal(of_arm(history, setup), of_arm(together, setup)) and of_arm(together, setup).all()


def test_a_consumer_of_periods_may_stop() -> None:
    """Films and windows read a part of an episode."""
    env = gym.make(ENV)
    instants = periods(env, Actions(np.zeros((1, 1), np.float32)), [7])
    first, second = next(instants), next(instants)
    assert (first.period, first.action, second.period, second.running, second.seeds) == (0, None, 1, True, [7])
