"""Training with a controller inside the policy."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexarm_env import control
from flexarm_env.control.policy import AroundPolicy
from flexarm_env.sb3 import make_sb3_vec
from flexarm_env.training import config
from flexarm_env.training import train as train_ppo
from flexarm_env.training.runs import load_model, read_run
from tests.agents_tools import SMALL, file_of, told
from tests.refusals import refuses
from tests.test_agents import arguments, curve, interrupted

ENV = "TwoLinkFlexArm-v0"
SHORT = SMALL | {"n_timesteps": 1024, "policy_kwargs": "dict(net_arch=[16, 16], log_std_init=-1.0)"}
OFF_POLICY = {
    "n_envs": 4, "n_timesteps": 512, "policy": "MlpPolicy", "learning_starts": 100, "buffer_size": 1000,
    "batch_size": 32, "train_freq": 4, "gradient_steps": 1,
}  # fmt: skip


def given(folder: Path, text: dict[str, Any] = SHORT, **changes: Any) -> train_ppo.Arguments:
    """Arguments of a short run; without measured entries PD remembers its goal."""
    more = {"env": ENV, "env_kwargs": {"duration": 0.5}, "around": "pd", "share": 0.4, "evaluate_every": 512}
    return arguments(folder, config=file_of(folder, text, ENV), **more | changes)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("around")
    train_ppo.train(given(folder))
    return folder / "run"


def test_a_run_tells_the_controller_inside(run: Path) -> None:
    table = {"controller": "pd", "share": 0.4, "gains": read_run(run)["around"]["gains"]}
    assert read_run(run)["around"] == table and set(table["gains"]) == {"bandwidth", "ratio"}
    assert config.load(run / "config.yml", "ppo", ENV).around == table


def test_what_is_judged_is_what_was_trained(run: Path) -> None:
    """The file in the plain environment moves as the torch model in the environment with PD inside."""
    env = gym.make_vec(ENV, num_envs=3, vectorization_mode="vector_entry_point", duration=0.5)
    policy = control.load_policy(run, env)
    assert isinstance(policy, AroundPolicy)
    trained = make_sb3_vec(ENV, 3, seed=4, duration=0.5, around=policy.inside)
    model, _ = load_model(run, "ppo")
    observation, _ = env.reset(seed=4)
    policy.reset(observation)
    other = trained.reset()
    for _ in range(20):
        observation, *_ = env.step(policy.act(observation))
        other, *_ = trained.step(model.predict(other, deterministic=True)[0])
        assert np.allclose(observation, other, atol=1e-5)
    # the model.zip of the folder is the same policy
    (run / "policy.npz").rename(run / "set_aside.npz")
    try:
        observation, _ = env.reset(seed=4)
        zipped = control.load_policy(run, env)
        zipped.reset(observation)
        policy.reset(observation)
        assert np.allclose(zipped.act(observation), policy.act(observation), atol=1e-6)
    finally:
        (run / "set_aside.npz").rename(run / "policy.npz")
    env.close()
    trained.close()


def test_a_resumed_run_ends_as_one_that_was_never_stopped(tmp_path: Path, run: Path) -> None:
    interrupted(given(tmp_path), 512)
    train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert curve(tmp_path / "run") == curve(run)


@pytest.mark.parametrize("algo", ["sac", "tqc", "gradient"])
def test_other_algorithms_learn_around_it(algo: str, tmp_path: Path) -> None:
    text = SHORT if algo == "gradient" else OFF_POLICY
    if algo == "tqc":
        pytest.importorskip("sb3_contrib")
    kwargs = {"duration": 0.5, "observation": "measured"}
    train_ppo.train(given(tmp_path, text, algo=algo, env_kwargs=kwargs))
    env = gym.make(ENV, **kwargs)
    policy = control.load_policy(tmp_path / "run", env)
    observation, _ = env.reset(seed=0)
    policy.reset(observation)
    assert policy.act(observation).shape == (2,)
    env.close()


def test_a_file_of_hyper_parameters_names_it(tmp_path: Path) -> None:
    table = {"controller": "pd", "share": 0.2}
    path = file_of(tmp_path, SHORT, ENV, around={ENV: table})
    assert config.load(path, "ppo", ENV).around == table
    path = file_of(tmp_path, SHORT, ENV, around={ENV: {"control": "pd"}})
    refuses(f"around.{ENV}.control: unknown key", lambda: config.load(path, "ppo", ENV))
    packaged = config.load(Path("suite"), "ppo", "flexarm/reach-measured-v1")
    assert packaged.around["controller"] == "pd" and "duration" not in packaged.env_kwargs


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--share 0.5", "--share = 0.5: requires --around CONTROLLER"),
        ("--around pid", "around = 'pid': must be one of"),
        ("--around lqr", "around = 'lqr': must be pd or a controller of the contact force"),
        ("--around pd --share 0", "share = 0.0: must be a positive number"),
        ("--around pd@nothing.toml", "nothing.toml: No such file or directory"),
        ("--around pd --algo gradient", "must be pd of an arm in the plane with observation=\"measured\""),
    ],
)  # fmt: skip
def test_mistakes_are_told_in_a_sentence(
    words: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    more = f"--env {ENV} --out {tmp_path / 'run'} --config {file_of(tmp_path, SHORT, ENV)} --eval-episodes 2"
    assert sentence in told(train_ppo.main, [*more.split(), *words.split()], monkeypatch, capsys)


def test_the_press_task_has_hyperparameters_of_its_own() -> None:
    loaded = config.load(None, "ppo", "flexarm/press-v1")
    assert loaded.around is not None and loaded.n_timesteps == 1_500_000
