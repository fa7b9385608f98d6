"""Training, resuming, exporting and judging: small runs from the command line and from Python."""

from __future__ import annotations

import csv
import dataclasses
import errno
import importlib
import json
import os
import shutil
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator

pytest.importorskip("stable_baselines3")

from agents import config, episodes, export_policy, policies, train_ppo
from agents import evaluate as judging
from agents.arguments import parse
from agents.runs import read_run, write_whole
from flexarm_env import control
from flexarm_env.envs.options import plan
from tests.processes import ROOT, python

ENV = "FlexibleArm-v0"
SMALL = {
    "n_envs": 8, "n_timesteps": 2048, "policy": "MlpPolicy", "n_steps": 64, "batch_size": 256, "n_epochs": 2,
    "gamma": 0.98, "learning_rate": "lin_1e-3", "policy_kwargs": "dict(net_arch=[16, 16], activation_fn=nn.ReLU)",
}  # fmt: skip


def file_of(folder: Path, text: dict, env: str = ENV, **more) -> Path:
    import yaml

    path = folder / "config.yml"
    path.write_text(yaml.safe_dump({env: text, **more}))
    return path


def arguments(folder: Path, **changes) -> train_ppo.Arguments:
    config_file = changes.get("config") or file_of(folder, SMALL)
    given = {
        "env": ENV, "config": config_file, "out": folder / "run", "evaluate_every": 1024, "eval_episodes": 4,
        "checkpoint_every": 512, "tensorboard": False, "progress": False,
    }  # fmt: skip
    return train_ppo.Arguments(**given | changes)


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "learning_curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if k not in ("wall_s", "cpu_s")} for row in rows]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    train_ppo.train(arguments(folder))
    return folder / "run"


# ------------------------------------------------------------------ training
def test_a_run_folder_holds_all_that_is_needed(run: Path):
    # policy.npz is written where its actions are the model's, and else refused
    names = {"model.zip", "policy.npz", "config.yml", "run.json", "learning_curve.csv", "learning_curve.png"}
    assert names == {p.name for p in run.iterdir()}
    record = read_run(run)
    assert record["finished"]
    assert record["steps"] == 2048
    assert {"numpy", "torch", "stable_baselines3", "flexarm_env", "python"} <= set(record["versions"])
    assert [row["steps"] for row in curve(run)] == ["0", "1024", "2048"]
    assert config.load(run / "config.yml", "ppo", ENV).text == SMALL


def test_the_same_seed_gives_the_same_curve_and_another_seed_another(tmp_path: Path, run: Path):
    train_ppo.train(arguments(tmp_path, out=tmp_path / "again"))
    train_ppo.train(arguments(tmp_path, out=tmp_path / "other", seed=1))
    assert curve(tmp_path / "again") == curve(run)
    assert curve(tmp_path / "other") != curve(run)


class Stop(Exception):
    """As if the process were killed."""


def interrupted(arguments_: train_ppo.Arguments, at: int) -> None:
    """Train, and break off at the start of the rollout that follows `at` steps."""
    from agents import training

    usual = training.Watch._on_rollout_start

    def watch(self):
        usual(self)
        if self.num_timesteps >= at:
            raise Stop

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training.Watch, "_on_rollout_start", watch)
        with pytest.raises(Stop):
            train_ppo.train(arguments_)


def test_a_resumed_run_ends_as_one_that_was_never_stopped(tmp_path: Path, run: Path):
    folder = tmp_path / "run"
    interrupted(arguments(tmp_path), 1024)
    assert (folder / "checkpoints").is_dir()
    assert not read_run(folder)["finished"]
    (folder / "checkpoints" / ".part-1").mkdir()
    train_ppo.train(train_ppo.Arguments(out=folder, resume=True, progress=False))
    assert [row["steps"] for row in curve(folder)] == ["0", "1024", "2048"]
    assert curve(folder) == curve(run)
    assert not (folder / "checkpoints").exists()


def test_a_run_broken_off_before_its_first_checkpoint_begins_anew(tmp_path: Path, run: Path):
    interrupted(arguments(tmp_path, checkpoint_every=4096), 512)
    train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert curve(tmp_path / "run") == curve(run)


def test_a_damaged_checkpoint_is_passed_over(tmp_path: Path):
    from agents import training

    interrupted(arguments(tmp_path), 1024)
    found = training.checkpoints(tmp_path / "run")
    assert [p.name for p in found] == ["000000000512", "000000001024"]
    (found[-1] / "model.zip").write_bytes(b"torn")
    progress = train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert progress.curve[-1]["steps"] == 2048


def test_a_run_is_never_overwritten(run: Path, tmp_path: Path):
    before = (run / "model.zip").read_bytes()
    with pytest.raises(ValueError, match="holds a run already"):
        train_ppo.train(arguments(tmp_path, out=run))
    with pytest.raises(ValueError, match="finished"):
        train_ppo.train(train_ppo.Arguments(out=run, resume=True))
    assert (run / "model.zip").read_bytes() == before


def test_solved_ends_the_run(tmp_path: Path):
    progress = train_ppo.train(arguments(tmp_path, solved_at=0.0, stop_when_solved=True))
    assert progress.solved["steps"] == 0
    assert len(progress.curve) == 1


def test_normalised_observations_travel_with_the_policy(tmp_path: Path):
    path = file_of(tmp_path, SMALL | {"normalize": "dict(norm_obs=True, norm_reward=False)"})
    train_ppo.train(arguments(tmp_path, config=path, env_kwargs={"duration": 2.0}))
    folder = tmp_path / "run"
    assert (folder / "vecnormalize.pkl").is_file()
    env = episodes.make_episodes(ENV, 4)
    numpy_policy = policies.choose(str(folder), ENV).make(env)
    (folder / "policy.npz").unlink()
    torch_policy = policies.choose(str(folder), ENV).make(env)
    observation, _ = env.reset(seed=0)
    assert numpy_policy.act(observation) == pytest.approx(torch_policy.act(observation), abs=1e-5)
    assert numpy_policy.normaliser is not None


def test_a_policy_of_measured_entries_is_trained_judged_and_played(tmp_path: Path, capsys):
    """With several observations in one; what is judged is the true tip."""
    from flexarm_env.cli import main

    measured = {"observation": "measured", "history": 2}
    train_ppo.train(arguments(tmp_path, config=file_of(tmp_path, SMALL | {"n_timesteps": 512}), env_kwargs=measured))
    folder = tmp_path / "run"
    assert control.load_policy(folder).weights[0][0].shape[0] == 10
    words = judging.Arguments(env=ENV, policy=str(folder), episodes=3)
    (row,), (result,), _ = (list(found.values()) for found in judging.evaluate(words))
    assert row["episodes"] == 3
    assert result.way == pytest.approx(np.abs(way(3)), abs=1e-5)
    capsys.readouterr()
    assert main(["play", "--policy", str(folder / "policy.npz"), "--headless", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["env"] == ENV


def way(n: int) -> np.ndarray:
    """Target less start angle of the test episodes."""
    observation, info = episodes.make_episodes(ENV, n).reset(seed=episodes.TEST)
    turned = info["target"] - np.arctan2(observation[:, 0], observation[:, 1])
    return (turned + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.slow
def test_sac_trains_by_the_same_script(tmp_path: Path):
    text = {"n_envs": 4, "n_timesteps": 400, "buffer_size": 1000, "learning_starts": 100, "batch_size": 64}
    args = arguments(tmp_path, algo="sac", config=file_of(tmp_path, text), evaluate_every=200, checkpoint_every=200)
    interrupted(args, 250)
    train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert curve(tmp_path / "run")[-1]["steps"] == "400"
    assert export_policy.export(tmp_path / "run") < 1e-5


# ------------------------------------------------------------------ the committed configuration
@pytest.mark.parametrize(
    "path", sorted((ROOT / "configs").glob("ppo/*.yml")) + sorted((ROOT / "configs").glob("sac/*.yml"))
)
def test_committed_configs_can_be_read(path: Path):
    import yaml

    ids = [key for key in yaml.safe_load(path.read_text()) if key != "env_kwargs"]
    assert ids
    for env_id in ids:
        chosen = config.load(path, path.parent.name, env_id)
        assert chosen.n_timesteps > 0
        plan(load_env_creator(gym.spec(env_id).entry_point).kind, **chosen.env_kwargs)  # compiles nothing


# ------------------------------------------------------------------ export and judging
def test_evaluate_prints_json(run: Path, tmp_path: Path):
    done = python("-m", "agents.evaluate", "--env", ENV, "--policy", "pd", "--episodes", "5", "--json",
                  "--out", tmp_path / "out")  # fmt: skip
    content = json.loads(done.stdout)
    for key in ("success_rate", "settling_time_median", "residual_vibration_median", "return_mean"):
        low, high = content[f"{key}_interval"]
        assert low <= content[key] <= high
    assert content["success_rate"] == 1.0
    assert set(content["bounds"]) == {"rigid time-optimal slew", "flexible time-optimal plan"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"table.json", "table.md", "tip_error.png"}


def told(main, words, monkeypatch, capsys) -> str:
    """The line on standard error of a program that must end with code 2."""
    monkeypatch.setattr("sys.argv", ["program", *words])
    try:
        code = main()
    except SystemExit as stop:
        code = stop.code
    lines = capsys.readouterr().err.splitlines()
    assert code == 2 and len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--policy", "nothing-there"], "no such run folder or file"),
        (["--policy", "pd", "--episodes", "0"], "must be at least 1"),
        (["--policy", "pd", "--env-kwargs", "{"], "not JSON"),
    ],
)
def test_mistakes_are_told_in_a_sentence(words, sentence, monkeypatch, capsys):
    assert sentence in told(judging.main, words, monkeypatch, capsys)


def test_files_that_cannot_be_used_are_named(run: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="not a run folder"):
        policies.choose(str(tmp_path), ENV)
    with pytest.raises(ValueError, match="trained on FlexibleArm-v0, not on TwoLinkFlexArm-v0"):
        policies.choose(str(run), "TwoLinkFlexArm-v0")
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    (copy / "policy.npz").unlink()
    (copy / "model.zip").write_bytes(b"torn")
    with pytest.raises(ValueError, match=r"model\.zip: damaged"):
        policies.choose(str(copy), ENV)
    (copy / "model.zip").unlink()
    with pytest.raises(ValueError, match="no such file"):
        policies.choose(str(copy), ENV)
    (copy / "run.json").write_text("{")
    with pytest.raises(ValueError, match="damaged, not JSON"):
        policies.choose(str(copy), ENV)


def test_controllers_take_gains_from_a_file(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text("[pd]\nbandwidth = [0.1]\nratio = [1.0]\n")
    chosen = policies.choose(f"pd@{file}", ENV)
    assert chosen.name == "pd@mine"
    controller = chosen.make(episodes.make_episodes(ENV, 1))
    assert controller.kp < control.make("pd", controller.setup).kp
    with pytest.raises(ValueError, match=r"no table \[zv\]; it has pd"):
        policies.choose(f"zv@{file}", ENV)
    with pytest.raises(ValueError, match="No such file"):
        policies.choose(f"pd@{tmp_path / 'none.toml'}", ENV)
    file.write_text("[pd]\nbandwith = [0.1]\n")
    with pytest.raises(ValueError, match=r"pd\.bandwith"):
        policies.choose(f"pd@{file}", ENV)
    file.write_text("[pd")
    with pytest.raises(ValueError, match="not TOML"):
        policies.choose(f"pd@{file}", ENV)


def test_another_arm_has_another_layout(run: Path, tmp_path: Path):
    from flexarm_env import arms

    strip = arms.named("strip")
    arm = tmp_path / "arm.toml"
    arm.write_text(arms.to_toml(dataclasses.replace(strip, torque_limits=(3.0,))))
    with pytest.raises(ValueError, match="observation layout"):
        judging.evaluate(judging.Arguments(policy=str(run), episodes=2, env_kwargs={"arm": str(arm)}))


# ------------------------------------------------------------------ configuration
def test_config_errors_name_the_key(tmp_path: Path):
    cases = [
        (SMALL | {"n_stepz": 3}, r"FlexibleArm-v0\.n_stepz: unknown key"),
        ({k: v for k, v in SMALL.items() if k != "n_timesteps"}, r"n_timesteps: missing"),
        (SMALL | {"learning_rate": "fast"}, r"learning_rate = 'fast'"),
        (SMALL | {"policy_kwargs": "__import__('os').getcwd()"}, r"policy_kwargs = .*must be made of"),
    ]
    for text, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            config.load(file_of(tmp_path, text), "ppo", ENV)
    with pytest.raises(ValueError, match="no entry for Other-v0; it has FlexibleArm-v0"):
        config.load(file_of(tmp_path, SMALL), "ppo", "Other-v0")
    with pytest.raises(ValueError, match="No such file"):
        config.load(tmp_path / "none.yml", "ppo", ENV)
    with pytest.raises(ValueError, match="must be one of ppo, sac"):
        config.algorithm_class("dqn")


def test_config_values_become_what_the_algorithm_takes(tmp_path: Path):
    from torch import nn

    chosen = config.load(file_of(tmp_path, SMALL, env_kwargs={ENV: {"duration": 2.0}}), "ppo", ENV)
    values = chosen.arguments()
    assert values["policy_kwargs"] == {"net_arch": [16, 16], "activation_fn": nn.ReLU}
    assert values["learning_rate"](0.5) == pytest.approx(5e-4)
    assert values["learning_rate"](-0.1) == 0.0
    assert (chosen.n_envs, chosen.n_timesteps, chosen.env_kwargs) == (8, 2048, {"duration": 2.0})
    assert "n_envs" not in values


def test_arguments_from_words():
    words = ["--env", "X-v0", "--n-timesteps", "1e6", "--no-progress", "--env-kwargs", '{"a": 1}', "--stop-when-solved"]
    found = parse(train_ppo.Arguments, "train", None, words)
    assert (found.env, found.n_timesteps, found.progress, found.env_kwargs) == ("X-v0", 1_000_000, False, {"a": 1})
    assert found.stop_when_solved
    assert found.folder == Path("runs/ppo-X-v0-0")
    with pytest.raises(SystemExit):
        parse(train_ppo.Arguments, "train", None, ["--n-timesteps", "some"])


# ------------------------------------------------------------------ measuring
def test_settling_time_is_counted_from_the_last_exit():
    setup = type("S", (), {"task": "slew", "control_dt": 0.1})
    errors = np.full((11, 4), 1.0)
    errors[4:, 0] = 0.01
    errors[4:, 1] = 0.01
    errors[7, 1] = 0.5
    errors[10, 2] = 0.001
    settling, settled = episodes._settling(setup, errors, np.zeros(4, bool))
    assert settling == pytest.approx([0.4, 0.8, 1.0, 1.0])
    assert settled.tolist() == [True, True, True, False]
    early = np.array([True, False, False, False])
    assert episodes._settling(setup, errors, early)[0][0] == pytest.approx(1.0)


def test_vibration_and_overshoot():
    bends = np.zeros((101, 2, 1))
    bends[-20:, 0, 0] = 0.003 * np.sin(np.arange(20))
    bends[:10, 1, 0] = 0.5
    vibration = episodes._vibration(bends, np.array([100, 100]), 50)
    half = 0.5 * 0.003 * np.ptp(np.sin(np.arange(20)))  # half of the distance between the extremes
    assert vibration == pytest.approx([half, 0.0], abs=1e-9)
    misses = np.array([[[0.5]], [[0.1]], [[-0.05]], [[0.0]]])
    assert episodes._overshoot(misses) == pytest.approx([0.1])


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path):
    path = tmp_path / "kept.txt"
    path.write_text("old")

    def torn(part: Path) -> None:
        part.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_whole(path, torn)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["kept.txt"]


# -------------------------------------------------------------------- films
def test_policies_side_by_side(tmp_path: Path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("pygame")
    from agents import films

    wanted = films.Arguments("pd,lqr", tmp_path / "two.gif", seconds=0.2, size=160, labels="one,other", speed=0.5)
    with image.open(films.make(wanted)) as film:
        assert film.size == (320, 174)
        assert film.n_frames == 11
        assert film.info["duration"] == 40
    for changes, words in (
        ({"labels": "one"}, "must be 2, one for each policy"),
        ({"out": tmp_path / "a.txt"}, "must end with one of"),
        ({"fps": 0.0}, "--fps 0.0: must be positive"),
    ):
        with pytest.raises(ValueError, match=words):
            films.make(dataclasses.replace(wanted, **changes))


# ------------------------------------------------------------------ without Ray
@pytest.mark.parametrize("program", ["train_rllib", "ray_demo", "sweep"])
def test_without_ray_a_sentence_says_what_to_install(program: str, tmp_path: Path, monkeypatch, capsys):
    words = ["--out", str(tmp_path / "run")]
    words += ["--space", '{"payload": [1.0]}'] if program == "sweep" else []
    monkeypatch.setitem(sys.modules, "ray", None)
    line = told(importlib.import_module(f"agents.{program}").main, words, monkeypatch, capsys)
    assert line.startswith("Ray cannot be imported here") and "make setup-ray" in line
    assert not (tmp_path / "run" / "run.json").exists()


# ------------------------------------------------------------------ broken off
def test_an_interruption_says_what_is_there(tmp_path: Path, monkeypatch, capsys):
    """Before there is a run folder there is nothing to resume."""

    def stopped(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(train_ppo, "train", stopped)
    monkeypatch.setattr("sys.argv", ["train_ppo", "--out", str(tmp_path / "run")])
    assert train_ppo.main() == 130
    assert capsys.readouterr().err == f"interrupted; nothing is in {tmp_path / 'run'} yet: start it again\n"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    assert train_ppo.main() == 130
    assert "go on with: python -m agents.train_ppo --out" in capsys.readouterr().err


class Full:
    """A model whose parts a full disk does not take."""

    num_timesteps = 7
    env = None

    def save(self, file):
        """Bytes."""
        file.write(b"x" * 100)

    def get_vec_normalize_env(self):
        """None."""


def test_a_full_disk_is_a_sentence(tmp_path: Path, monkeypatch, capsys):
    from agents import training

    def full(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    monkeypatch.setattr(train_ppo, "train", lambda arguments: training.save_model(arguments.folder, Full()))
    error = told(train_ppo.main, ["--out", str(tmp_path / "run")], monkeypatch, capsys)
    file = tmp_path / "run" / "model.zip"
    assert error.startswith(f"{file}: No space left on device; what was written before is whole")
    with pytest.raises(OSError, match="No space left"):
        training.save_checkpoint(tmp_path / "run", Full(), training.Progress())
    assert not list((tmp_path / "run" / "checkpoints").iterdir())  # half a checkpoint fills the disk no further
