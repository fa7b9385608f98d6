"""Times that fit an arm, stability margins of controllers, and what is said of those that do not fit."""

import dataclasses
import json
import math
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Link, Payload, Section, arms, control
from flexarm_env.cli.parser import main
from flexarm_env.control import Setup, loop
from flexarm_env.control.arm_model import arm_model
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.control.lqr import design
from flexarm_env.control.margins import margins
from flexarm_env.rigid import timescales

HEAVY = Arm(
    "heavy", (Link(3.0, Section(EI=2000.0, EA=1e7, C=1e7, m=1.0)),), hub_inertia=0.5, payload=Payload(5.0),
    torque_limits=(40.0,),
)  # fmt: skip
DT = 0.02


def last_of(law: loop.Law, delay: float, lag: float, gain: float = 1.0) -> float:
    """Growth of the strip's linear model from t = 4 s to 8 s under a law whose torques come late and lag behind, by
    matrix exponentials over 1 ms and a queue of commands."""
    from scipy.linalg import expm

    model, fine = arm_model(arms.named("strip")), 0.001
    n = len(model.A)
    A = np.zeros((n + 2, n + 2))  # arm, motor's torque, command
    A[:n, :n], A[:n, n] = model.A, model.B[:, 0]
    if lag:
        A[n, n], A[n, n + 1] = -1.0 / lag, 1.0 / lag
    step = expm(fine * A)
    x, z, queue = np.zeros(n + 2), np.zeros(len(law[0])), [0.0] * round(delay / fine)
    x[:n] = model.state_of(np.array([0.1, 0.0, 0.01, 0.0]))
    sizes, asked = [], 0.0
    for k in range(8000):
        if k % round(DT / fine) == 0:
            y = model.C @ x[:n]
            asked = -gain * float((law[2] @ z + law[3] @ y)[0])
            z = law[0] @ z + law[1] @ y
        queue.append(asked)
        x[n + 1] = queue.pop(0)
        if not lag:
            x[n] = x[n + 1]
        x = step @ x
        sizes.append(float(np.abs(model.C @ x[:n]).max()))
    return max(sizes[6000:]) / max(sizes[2000:4000])


@pytest.mark.parametrize("name", ["pd", "lqr"])
def test_margins_are_those_of_a_simulated_loop(name: str) -> None:
    """A little below its margins of delay and gain the loop dies down, a little above it grows."""
    strip = arms.named("strip")
    gains, model = tuned_gains(name, "slew", 1), arm_model(strip)
    law = loop.pd_law(*gains.of(strip)) if name == "pd" else loop.observer_law(*design(strip, (2.0,), DT, gains)[:5])
    for lag in (0.0, 0.01):
        delay = loop.delay_margin(model, DT, law, lag)
        low, high = (round(1e3 * share * delay) / 1e3 for share in (0.85, 1.15))
        if delay > 0.0:
            assert last_of(law, low, lag) < 1.0 < last_of(law, high, lag)
        gain = loop.gain_margin(loop.plant(model, DT, 0.0, lag), law)
        if gain > 1.0:
            assert last_of(law, 0.0, lag, 0.95 * gain) < 1.0 < last_of(law, 0.0, lag, 1.05 * gain)


def test_a_delay_that_a_loop_does_not_bear_is_told() -> None:
    """PD and time-optimal control with 20 ms of delay were made without a word, and had 0 % success."""

    def told(name: str, **actuator: Any) -> list[str]:
        env: Any = gym.make("FlexibleArm-v0", dt=0.005, actuator=actuator or None)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            control.make(name, env)
        return [str(one.message) for one in caught]

    for name in ("pd", "zvd", "lqr", "time_optimal", "mpc"):
        assert told(name) == []
    assert "PD gains are unstable" in told("pd", delay=0.02)[0] and "a delay of 0.02 s" in told("pd", delay=0.02)[0]
    for name in ("time_optimal", "mpc"):
        assert "ignores delays" in told(name, delay=0.02)[0]
    assert "its delay margin is 0.058" in told("lqr", delay=0.04)[0] and told("lqr", delay=0.01) == []
    assert "motors lag by 0.1 s" in told("lqr", lag=0.1, delay=0.06)[0]
    setup = Setup.of(gym.make("FlexibleArm-v0", dt=0.005, actuator={"lag": 0.03, "delay": (0.005, 0.015)},
                              sensors={"delay": 0.02}))  # fmt: skip
    assert setup.lag == pytest.approx(0.03) and setup.delay == pytest.approx(0.035)


def test_undamped_vibrations_that_a_loop_excites_are_told() -> None:
    """Tuned LQR on the strip without damping: its omitted modes grow; some damping suffices."""

    def told(name: str, tau_d: float) -> list[str]:
        arm = dataclasses.replace(arms.named("strip"), tau_d=tau_d)
        env: Any = gym.make("FlexibleArm-v0", arm=arm, control_dt=0.02)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            control.make(name, env)
        return [str(one.message) for one in caught if "has no damping" in str(one.message)]

    (words,) = told("mpc", 0.0)
    assert "mpc: arm 'strip' has no damping (tau_d = 0), and with a control period of 0.02 s" in words
    assert told("mpc", 1e-4) == told("lqr", 1e-4) == told("pd", 0.0) == []


def test_margins_of_a_setup_are_the_least_of_its_postures() -> None:
    setup = Setup.of(gym.make("TwoLinkFlexArm-v0"))
    found = margins(setup, tuned_gains("pd", "reach", 2))
    assert found is not None and found.gain > 2.0 and 0.0 < found.delay < 0.1
    assert margins(setup, object()) is None


def test_times_of_an_arm() -> None:
    """The quarter turn at full torque, reversed midway, takes 2 sqrt(I pi/2 / tau)."""
    inertia = 0.5 + 3.0**3 / 3.0 + 5.0 * 9.0
    own = timescales(HEAVY)
    assert own.slew == pytest.approx(2.0 * math.sqrt(inertia * math.pi / 2 / 40.0))
    assert (own.duration, own.control_dt) == (6.5, 0.05) and own.gamma == pytest.approx(1.0 - 0.05 / own.slew, abs=1e-4)
    assert timescales(HEAVY, 0.02).gamma > own.gamma
    quick = dataclasses.replace(HEAVY, torque_limits=(4000.0,))
    assert timescales(quick).slew == pytest.approx(0.1 * own.slew)


def test_an_arm_that_wants_more_time_is_told_so() -> None:
    with pytest.warns(UserWarning, match=r"'heavy' takes at least 2.93 s .* duration=6.5 fits, with control_dt=0.05"):
        gym.make("FlexibleArm-v0", arm=HEAVY)
    gym.make("FlexibleArm-v0", arm=HEAVY, duration=4.0)  # no warning: it was asked for


def test_settings_of_training_fit_an_arm_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("stable_baselines3")
    from flexarm_env.training import config as configs
    from flexarm_env.training import episodes, train

    path = tmp_path / "heavy.toml"
    path.write_text(arms.to_toml(HEAVY))
    given = {"arm": str(path)}
    usual = configs.load(None, "ppo", "FlexibleArm-v0")
    config, chosen = train.fitted(usual, train.Arguments(env_kwargs=given))
    assert chosen == {"duration": 6.5, "control_dt": 0.05} and config.text["gamma"] == 0.9829
    assert "arm heavy: a quarter turn takes at least 2.93 s; duration = 6.5" in capsys.readouterr().err
    _, some = train.fitted(usual, train.Arguments(env_kwargs={**given, "duration": 8.0}))
    assert some == {"control_dt": 0.05}
    assert train.fitted(usual, train.Arguments(env_kwargs={"arm": "strip"})) == (usual, {})
    asked = episodes.user_keywords("FlexibleArm-v0", {**given, "duration": 8.0})
    kwargs = {"duration": 8.0, "reward": {"failure": 50.0}, **given}
    assert episodes.validation("FlexibleArm-v0", kwargs, asked) == {**given, "duration": 8.0}
    assert episodes.judged_in(kwargs, asked) == {**given, "duration": 8.0}
    assert episodes.user_keywords("flexarm_env:flexarm/slew-measured-v2", {"duration": 8.0}) == {}


@pytest.mark.slow
def test_what_was_asked_for_is_validated_on_and_written_down(tmp_path: Path) -> None:
    """Duration 8 s was trained on and 4 s validated; config.yml said 1.5 s, run.json 8 s."""
    pytest.importorskip("stable_baselines3")
    from flexarm_env.training import config as configs
    from flexarm_env.training import train
    from flexarm_env.training.policies import choose

    path, out = tmp_path / "heavy.toml", tmp_path / "run"
    path.write_text(arms.to_toml(HEAVY))
    given = {"arm": str(path), "duration": 8.0, "control_dt": 0.1}
    words = ["--env-kwargs", json.dumps(given), "--out", str(out), "--n-timesteps", "8192", "--eval-episodes", "4"]
    assert train.main("flexarm train", [*words, "--no-tensorboard", "--no-progress"]) == 0
    record = json.loads((out / "run.json").read_text())
    assert record["validation"]["duration"] == 8.0 and record["asked"] == {"duration": 8.0}
    written = configs.load(out / "config.yml", "ppo", "FlexibleArm-v0")
    assert written.env_kwargs["duration"] == 8.0 and written.text["gamma"] == timescales(HEAVY, 0.1).gamma
    assert choose(str(out), "FlexibleArm-v0").env_kwargs == given


def test_the_command_prints_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "heavy.toml"
    path.write_text(arms.to_toml(HEAVY))
    assert main(["arm", str(path), "--json", "--env-kwargs", '{"control_dt": 0.02}']) == 0
    found = json.loads(capsys.readouterr().out)
    assert (
        found["duration_s"] == 6.5 and found["quarter_turn_hub_s"] == 2.926 and 0.0 < found["lqr_delay_margin_s"] < 0.1
    )
    assert found["frequency_1_hz"] == pytest.approx(6.84, rel=0.01)  # clamped: 0.7 Hz
    assert main(["arm", "strip", "--env-kwargs", '{"arm": "paper"}']) == 2
    path.write_text(arms.to_toml(dataclasses.replace(HEAVY, torque_limits=None)))
    capsys.readouterr()
    assert main(["arm", str(path)]) == 2
    assert f"{path}: torque_limits: missing; the time scales need 1 torque limit(s)" in capsys.readouterr().err


def test_blas_has_as_many_threads_as_are_asked_for() -> None:
    """Identical runs of --algo gradient took 0.6 to 11.9 s of CPU with NumPy's threads, 0.6 to 0.9 s with one."""
    from flexarm_env.training import blas

    before = blas.threads()
    if not before:
        pytest.skip("no OpenBLAS that can be told")
    try:
        blas.set_threads(2)
        assert set(blas.threads()) == {2}
        blas.set_threads(1)
        assert set(blas.threads()) == {1}
    finally:
        blas.set_threads(before[0])


def test_weights_of_lqr_fit_the_arm() -> None:
    """Weights on rates count against the slew: 0.3 m settled in 0.86 s, in 0.71 s now; 5 m in 3.5 s, in 2.9 s now."""
    from flexarm_env.control.catalogue import for_arm

    gains = tuned_gains("lqr", "slew", 1)
    assert for_arm(gains, Setup.of(gym.make("FlexibleArm-v0"))) == gains
    small = Arm(
        "small", (Link(0.3, Section(EI=0.02, EA=1e6, C=1e6, m=0.05)),), hub_inertia=0.0005, payload=Payload(0.02),
        torque_limits=(0.02,), tau_d=1e-3,
    )  # fmt: skip
    own = for_arm(gains, Setup.of(gym.make("FlexibleArm-v0", arm=small)))
    assert own.rate == pytest.approx(0.897 * gains.rate) and own.angle == gains.angle


@pytest.mark.slow
def test_lqr_reads_the_noise_that_there_is() -> None:
    """With noise of 0.3 % of the scales 24 % of episodes were successful, by torques that the noise made."""
    from flexarm_env.training import episodes

    env = episodes.make_episodes("FlexibleArm-v0", 50, sensors={"noise": 0.003}, duration=6.0)
    assert episodes.run(env, control.make("lqr", env)).success.mean() > 0.95


def test_settled_is_a_share_of_the_arms_length() -> None:
    """An absolute 2 cm was 6.7 % of a 0.3 m arm and 0.4 % of a boom of 5 m."""
    from flexarm_env.episodes import measures

    for length in (0.3, 1.0, 5.0):
        links = tuple(Link(0.5 * length, Section(EI=1.0, EA=1e4, C=1e4, m=0.2)) for _ in range(2))
        arm = dataclasses.replace(arms.named("de_luca_siciliano"), links=links)
        setup = dataclasses.replace(Setup.of(gym.make("TwoLinkFlexArm-v0")), arm=arm)
        assert float(measures.settling_band(setup, 0.0)) == pytest.approx(0.02 * length)


def test_a_controller_on_an_arm_of_ones_own_can_be_viewed(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    keywords = json.dumps({"arm": "paper", "duration": 0.5})
    assert main(["view", "lqr", "--env-kwargs", keywords, "--out", str(page)]) == 0
    assert page.stat().st_size > 10_000
    assert main(["view", "robot_arm_motion", "--env-kwargs", keywords, "--out", str(page)]) == 2
