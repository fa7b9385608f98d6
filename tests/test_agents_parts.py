"""What training is made of: configuration, arguments, measures, files, films; what programs say when broken off."""

import dataclasses
import errno
import importlib
import os
import sys
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator

pytest.importorskip("stable_baselines3")

from agents import best_known
from flexarm_env.envs.options import plan
from flexarm_env.training import config, episodes
from flexarm_env.training import train as train_ppo
from flexarm_env.training.arguments import parse
from flexarm_env.training.progress import Progress
from flexarm_env.training.runs import read_json, write_text, write_whole
from tests.agents_tools import ENV, SMALL, file_of, told
from tests.processes import ROOT
from tests.refusals import refuses


# ------------------------------------------------------------------ configuration
def test_config_errors_name_the_key(tmp_path: Path):
    cases = [
        (SMALL | {"n_stepz": 3}, r"FlexibleArm-v0\.n_stepz: unknown key of ppo"),
        ({k: v for k, v in SMALL.items() if k != "n_timesteps"}, r"n_timesteps: missing"),
        (SMALL | {"n_timesteps": "many"}, r"n_timesteps = 'many': must be a whole number, at least 1"),
        (SMALL | {"n_envs": 0}, r"n_envs = 0: must be a whole number, at least 1"),
        (SMALL | {"learning_rate": "fast"}, r"learning_rate = 'fast'"),
        (SMALL | {"policy_kwargs": "__import__('os').getcwd()"}, r"policy_kwargs = .*must be made of"),
        (SMALL | {"policy_kwargs": "{[1]: 2}"}, r"policy_kwargs = .*must be made of"),
        (SMALL | {"policy_kwargs": 5}, r"FlexibleArm-v0\.policy_kwargs = 5: must be a table"),
        (SMALL | {"n_epochs": 0}, r"n_epochs = 0: must be a whole number, at least 1"),
        (SMALL | {"n_steps": "x"}, r"n_steps = 'x': must be a whole number"),
        (SMALL | {"gamma": 2.0}, r"gamma = 2.0: must be a finite number, at least 0 and at most 1"),
        (SMALL | {"learning_rate": None}, r"learning_rate = None: must be a finite number"),
        (SMALL | {"ent_coef": "x"}, r"ent_coef = 'x': must be"),
        (SMALL | {"normalize": 5}, r"FlexibleArm-v0\.normalize = 5: must be a table"),
        (SMALL | {"normalize": "dict(foo=1)"}, r"normalize\.foo: unknown key"),
        (SMALL | {"normalize": {"gamma": "x"}}, r"normalize\.gamma = 'x'"),
    ]
    for text, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            config.load(file_of(tmp_path, text), "ppo", ENV)
    with pytest.raises(ValueError, match=r"Other-v0: unknown entry; allowed: FlexibleArm-v0; .* --config FILE"):
        config.load(file_of(tmp_path, SMALL), "ppo", "Other-v0")
    refuses("--env FlexibleArm-v0: tqc has hyper-parameters only for tasks", lambda: config.load(None, "tqc", ENV))
    assert config.load(None, "tqc", "flexarm/slew-geared-v2").text["n_envs"] == 16
    for given in ([1], {ENV: 5}):
        path = file_of(tmp_path, SMALL, env_kwargs=given)
        refuses("env_kwargs.*must be a table", partial(config.load, path, "ppo", ENV))
    with pytest.raises(ValueError, match="hyper-parameters of ppo: batch"), config.fitting("ppo"):
        raise AssertionError("batch")
    refuses("No such file", lambda: config.load(tmp_path / "none.yml", "ppo", ENV))
    refuses('must be one of "ppo", "sac"', lambda: config.algorithm_class("dqn"))


def test_configs_that_come_with_the_package_go_by_name(tmp_path: Path, monkeypatch):
    """As a checkout spells them, from any folder, or by their stem; a file that is there goes first."""
    monkeypatch.chdir(tmp_path)
    known = config.load(ROOT / "configs" / "ppo" / "robust.yml", "ppo", ENV)
    assert config.load(Path("robust"), "ppo", ENV) == config.load(Path("configs/ppo/robust.yml"), "ppo", ENV) == known
    assert config.load(file_of(tmp_path, SMALL).rename(tmp_path / "robust"), "ppo", ENV).n_timesteps == 2048
    refuses("No such file", lambda: config.load(Path("rubust"), "ppo", ENV))


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


def test_returns_decide_which_policy_is_kept_where_none_succeeds():
    """The first one was kept, untrained."""

    def judged(success: float, value: float):
        none = np.full(3, success, bool), np.full(3, 1.0 if success else 4.0), np.full(3, value)
        return SimpleNamespace(success=none[0], settling=none[1], returns=none[2], errors=np.zeros(201), dt=0.02)

    progress = Progress()
    rows = (0, -90.0), (0, -40.0), (0, -60.0), (1, -70.0)
    better = [progress.add(judged(*row), k, 1.0) for k, row in enumerate(rows)]
    assert better == [True, True, False, True] and progress.best_steps == 3 and progress.best == 1.0


def test_the_best_known_begins_with_the_quickest_policy_and_the_elbow_it_has():
    """Of two ways to bend the elbow that to which the policy led, turned as often as it has turned."""
    ends = np.array([[0.42, -0.9, 0.0, 0.0], [6.8, 0.51, 0.0, 0.0]])
    known = best_known.Judged({"a": [1.0, 3.0], "b": [2.0, 0.5]}, {}, np.zeros((4, 2, 2)), ends)
    lot = best_known.Lot(SimpleNamespace(joints=[0, 1], period=0.02), None, None, None)
    ways = [np.array([[0.9, 0.9], [0.5, 0.5]]), np.array([[0.4, -0.9], [0.7, -0.5]])]
    guess = best_known.followed(lot, known, ways)
    assert guess.goal == pytest.approx(np.array([[0.4, -0.9], [0.5 + 2.0 * np.pi, 0.5]]))
    assert guess.periods.tolist() == [50, 25]


def test_the_best_known_of_a_lot_is_no_slower_than_any_policy():
    kept = read_json(ROOT / "docs" / "results" / "optimal.json")["lots"]
    for lots in kept.values():
        for lot in lots.values():
            assert (np.min(list(lot["policies"].values()), axis=0) >= np.array(lot["settling"]) - 1e-9).all()


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path):
    path = tmp_path / "kept.txt"
    path.write_text("old")

    def torn(part: Path) -> None:
        part.write_text("half")
        raise OSError("disk full")

    refuses("disk full", lambda: write_whole(path, torn), OSError)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["kept.txt"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_device_is_written_to_and_stays_one(tmp_path: Path):
    """/dev/null, written to by root, became a file."""
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reading = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reading.start()
    write_text(pipe, "all of it")
    reading.join(10.0)
    assert read == ["all of it"] and pipe.is_fifo()


# -------------------------------------------------------------------- films
def test_policies_side_by_side(tmp_path: Path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("pygame")
    from flexarm_env.training import films

    wanted = films.Arguments("pd,lqr", tmp_path / "two.gif", seconds=0.2, size=160, labels="one,other", speed=0.5)
    with image.open(films.make(wanted)) as film:
        assert film.size == (320, 174)
        assert film.n_frames == 11
        assert film.info["duration"] == 40
    for changes, words in (
        ({"labels": "one"}, "must be 2, one for each policy"),
        ({"out": tmp_path / "a.txt"}, "must end with one of"),
        ({"fps": 0.0}, "--fps = 0.0: must be a positive number"),
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
    assert train_ppo.main("python -m agents.train_ppo") == 130
    assert capsys.readouterr().err == f"interrupted; nothing is in {tmp_path / 'run'} yet: start it again\n"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    assert train_ppo.main("python -m agents.train_ppo") == 130
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
    from flexarm_env.training import watch as training

    def full(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    monkeypatch.setattr(train_ppo, "train", lambda arguments: training.save_model(arguments.folder, Full()))
    error = told(train_ppo.main, ["--out", str(tmp_path / "run")], monkeypatch, capsys)
    file = tmp_path / "run" / "model.zip"
    assert error.startswith(f"{file}: No space left on device; what was written before is whole")
    refuses("No space left", lambda: training.save_checkpoint(tmp_path / "run", Full(), training.Progress()), OSError)
    assert not list((tmp_path / "run" / "checkpoints").iterdir())  # half a checkpoint fills the disk no further


def test_a_policy_is_chosen_by_its_own_tasks_reward_less_the_cost_that_it_learns_from():
    wall = "flexarm_env:flexarm/space-wall-v1"
    given = {"duration": 1.0, "reward": {"accuracy": 9.0, "cost": 3.0}, "history": 2}
    own = {"accuracy": 0.2, "distance": 0.2, "change": 0.2}
    assert episodes.validation(wall, given) == {"history": 2, "reward": own | {"cost": 3.0}}
    assert episodes.validation(ENV, {"reward": {"accuracy": 9.0}}) == {}


# ------------------------------------------------------------------ the committed configuration
@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*/*.yml")), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_committed_configs_can_be_read(path: Path):
    import yaml

    ids = [key for key in yaml.safe_load(path.read_text()) if "-v" in key]  # others are shared by several
    assert ids
    for env_id in ids:
        chosen = config.load(path, path.parent.name, env_id)
        assert chosen.n_timesteps > 0
        spec = gym.spec(env_id)
        plan(load_env_creator(spec.entry_point).kind, **spec.kwargs | chosen.env_kwargs)  # compiles nothing
