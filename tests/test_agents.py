"""Training, resuming, exporting and judging: small runs from the command line and from Python."""

import csv
import dataclasses
import json
import pickle
import shutil
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexarm_env import Payload, arms, control
from flexarm_env.training import config, episodes, export_policy, policies, progress, tune
from flexarm_env.training import evaluate as judging
from flexarm_env.training import train as train_ppo
from flexarm_env.training.runs import checkpoints, load_model, read_run
from tests.agents_tools import ENV, RUN_FILES, SMALL, file_of, told
from tests.processes import python
from tests.refusals import refuses


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
@pytest.mark.slow
def test_a_run_folder_holds_all_that_is_needed(run: Path):
    # policy.npz is written where its actions are the model's, and else refused
    assert {p.name for p in run.iterdir()} == RUN_FILES
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
    from flexarm_env.training import watch as training

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
    assert len(checkpoints(folder)) == 1, "from which it can be extended"


def test_a_resumed_run_keeps_what_its_observations_were_normalised_by(tmp_path: Path):
    """VecNormalize's own file leaves out the returns it discounts: no run that has it could be gone on with."""
    given = {"config": file_of(tmp_path, SMALL | {"normalize": True}), "evaluate_every": 512}
    interrupted(arguments(tmp_path, **given), 1024)
    folder, copy = tmp_path / "run", tmp_path / "copy"
    shutil.copytree(folder, copy)
    train_ppo.train(train_ppo.Arguments(out=folder, resume=True, progress=False))
    train_ppo.train(arguments(tmp_path, **given, out=tmp_path / "whole"))
    assert curve(folder) == curve(tmp_path / "whole")
    for damage in (b"torn", pickle.dumps({})):
        for path in copy.glob("checkpoints/*/vecnormalize.pkl"):
            path.write_bytes(damage)
        refuses("damaged, or of other", lambda: train_ppo.train(train_ppo.Arguments(out=copy, resume=True)))
    text = (copy / "run.json").read_text()
    for wrong, sentence in (("evaluate_every", "--evaluate-every = 0"), ("arguments", "arguments = 0: must be a")):
        record = json.loads(text)
        (record if wrong in record else record["arguments"])[wrong] = 0
        (copy / "run.json").write_text(json.dumps(record))
        refuses(sentence, lambda: train_ppo.train(train_ppo.Arguments(out=copy, resume=True)))


def test_a_run_that_diverges_says_so(tmp_path: Path):
    path = file_of(tmp_path, SMALL | {"learning_rate": 1e10})
    refuses("training diverged after 512 steps", lambda: train_ppo.train(arguments(tmp_path, config=path)))


def test_a_run_broken_off_before_its_first_checkpoint_begins_anew(tmp_path: Path, run: Path):
    interrupted(arguments(tmp_path, checkpoint_every=4096), 512)
    train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert curve(tmp_path / "run") == curve(run)


def test_a_run_is_extended_and_never_trained_otherwise_than_it_was(tmp_path: Path, run: Path, capsys):
    """`--resume --n-timesteps N` ran to the old number of steps without a message, and passed over other flags."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    again = partial(train_ppo.Arguments, out=folder, resume=True, progress=False)
    refuses("finished; there is nothing to resume, but --n-timesteps N", lambda: train_ppo.train(again()))
    refuses("--n-timesteps 1024: must be more than the 2048", lambda: train_ppo.train(again(n_timesteps=1024)))
    refuses("--seed = 3: must be 0 with --resume", lambda: train_ppo.train(again(n_timesteps=3072, seed=3)))
    refuses("--set: must be left out", lambda: train_ppo.train(again(n_timesteps=3072, set=("gamma=0.9",))))
    capsys.readouterr()
    train_ppo.train(again(n_timesteps=3072))
    assert "resuming at 2048 of 3072 steps" in capsys.readouterr().err
    assert [row["steps"] for row in curve(folder)] == ["0", "1024", "2048", "3072"]
    assert curve(folder)[:3] == curve(run)
    assert config.load(folder / "config.yml", "ppo", ENV).n_timesteps == 3072 and read_run(folder)["steps"] == 3072


def test_an_extended_run_is_validated_on_the_duration_that_was_chosen_for_the_arm(tmp_path: Path, capsys):
    """The first 512 steps were validated on the arm's 8.5 s, those of the extension on the environment's 4 s."""
    strip = arms.named("strip")
    slow = dataclasses.replace(strip, name="slow", payload=Payload(5.0))
    (tmp_path / "slow.toml").write_text(arms.to_toml(slow))
    words = ["--env", ENV, "--env-kwargs", json.dumps({"arm": str(tmp_path / "slow.toml")}), "--eval-episodes", "2"]
    words += ["--set", "n_envs=4", "--set", "n_steps=64", "--n-timesteps", "512", "--no-tensorboard"]
    more = ["--out", str(tmp_path / "run"), "--no-progress"]
    assert train_ppo.main("flexarm train", [*words, *more]) == 0
    first = read_run(tmp_path / "run")
    assert first["validation"]["duration"] == first["env_kwargs"]["duration"] > 4.0
    assert train_ppo.main("flexarm train", ["--resume", "--n-timesteps", "1024", *more]) == 0
    extended = read_run(tmp_path / "run")
    for key in ("asked", "validation", "env_kwargs"):
        assert extended[key] == first[key]
    assert "an episode has 4 s" not in capsys.readouterr().err


def test_all_that_is_missing_is_named(tmp_path: Path, monkeypatch, capsys):
    """It named pyyaml alone where nothing of the extra was installed."""
    monkeypatch.setattr(train_ppo, "find_spec", lambda module: None)
    assert train_ppo.main("flexarm train", ["--out", str(tmp_path / "none")]) == 2
    told = capsys.readouterr().err
    assert "pip install torch stable-baselines3 pyyaml tqdm" in told and 'extra "train"' in told and "CPU build" in told


def test_hyper_parameters_are_set_without_a_file(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--env", ENV, "--set", "learning_rate=lin_5e-4", "--set", "n_envs=4", "--set", "n_steps=64"]
    words += ["--set", "policy_kwargs=dict(net_arch=[8])", "--n-timesteps", "256", "--eval-episodes", "2"]
    words += ["--out", "own", "--no-progress"]
    assert train_ppo.main("flexarm train", [*words, "--no-tensorboard"]) == 0
    kept = config.load(Path("own/config.yml"), "ppo", ENV)
    usual = config.load(None, "ppo", ENV)
    given = {"learning_rate": "lin_5e-4", "n_envs": 4, "n_steps": 64, "policy_kwargs": "dict(net_arch=[8])"}
    assert kept.text == {**usual.text, **given, "n_timesteps": 256}
    assert control.load_policy("own").weights[0][0].shape == (6, 8)
    assert "next: flexarm evaluate --policy own,pd,lqr" in capsys.readouterr().out
    for word, sentence in (
        ("learning_rat=1", "--set: FlexibleArm-v0.learning_rat: unknown key of ppo (did you mean learning_rate?)"),
        ("gamma", "--set = 'gamma': must be KEY=VALUE"), ("gamma=2", "gamma = 2: must be"),
    ):  # fmt: skip
        assert train_ppo.main("flexarm train", ["--set", word, "--out", "other"]) == 2
        assert sentence in capsys.readouterr().err


def test_arms_of_several_lengths_are_trained_on(tmp_path: Path):
    """Validation episodes have the nominal arm; a training by gradients, whose arms are alike, refuses lengths."""
    config_file = file_of(tmp_path, SMALL | {"n_timesteps": 512})
    lengths = {"lengths": [0.9, 1.1], "duration": 2.0}
    train_ppo.train(arguments(tmp_path, config=config_file, env_kwargs=lengths, evaluate_every=512))
    record = read_run(tmp_path / "run")
    assert record["finished"] and record["env_kwargs"]["lengths"] == [0.9, 1.1]
    assert "lengths" not in record["validation"]
    wrong = arguments(tmp_path, config=None, algo="gradient", env_kwargs=lengths, out=tmp_path / "other")
    refuses("env_kwargs.lengths .* must be left out with --algo gradient", lambda: train_ppo.train(wrong))


def test_a_damaged_checkpoint_is_passed_over(tmp_path: Path):
    interrupted(arguments(tmp_path), 1024)
    found = checkpoints(tmp_path / "run")
    assert [p.name for p in found] == ["000000000512", "000000001024"]
    (found[-1] / "model.zip").write_bytes(b"torn")
    progress = train_ppo.train(train_ppo.Arguments(out=tmp_path / "run", resume=True, progress=False))
    assert progress.curve[-1]["steps"] == 2048


def test_a_run_is_never_overwritten(run: Path, tmp_path: Path):
    before = (run / "model.zip").read_bytes()
    refuses("contains a run already", lambda: train_ppo.train(arguments(tmp_path, out=run)))
    refuses("finished", lambda: train_ppo.train(train_ppo.Arguments(out=run, resume=True)))
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


@pytest.mark.slow
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


def test_pickles_of_older_run_folders_find_their_classes():
    """They say `agents.` where the package has the module now."""
    assert pickle.loads(b"cagents.progress\nProgress\n.") is progress.Progress
    assert pickle.loads(b"cagents.config\nLinear\n.") is config.Linear


def test_a_memory_begins_with_the_episodes_of_one_arm_as_of_many():
    """A single arm's entries were taken for arms, and its film ended in an error."""
    begun: list[list[bool]] = []
    model = SimpleNamespace(predict=lambda seen, memory, first, **more: (begun.append(first.tolist()) or seen, memory))
    for seen in (np.zeros(6, np.float32), np.zeros((2, 6), np.float32)):
        policy = policies.TorchPolicy(model, None)
        policy.reset(seen)
        policy.act(policy.act(seen))
    assert begun == [[True], [False], [True, True], [False, False]]


# ------------------------------------------------------------------ export and judging
@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("program", "words", "sentence"),
    [
        (judging, "--policy nothing-there", "must be a run folder"),
        (judging, "--policy pd,,lqr", "--policy: must name at least one"),
        (judging, "--policy pd --video", "--video: needs --out"),
        (judging, "--policy pd --episodes 0", "must be at least 1"),
        (judging, "--policy pd --env-kwargs {", "not JSON"),
        (judging, "--policy pd --env Arm-v0", "Arm-v0: unknown environment; allowed: FlexibleArm-v0"),
        (tune, "--env Arm-v0", "Arm-v0: unknown environment; allowed: FlexibleArm-v0"),
        (tune, "--env CartPole-v1", "must be an environment of flexarm_env"),
        (tune, "--env FlexibleArm-v0 --samples 0", "--samples = 0: must be a whole number, at least 1"),
        (tune, "--env FlexibleArm-v0 --margin nan", "--margin = nan: must be a number, zero or positive"),
        (tune, "--env SpatialFlexArm-v0", "--env = 'SpatialFlexArm-v0': must be an environment of the plane"),
        (judging, '--policy pd --env-kwargs {"num_envs":3}', "env_kwargs.num_envs = 3: must be left out"),
        (judging, '--policy pd --env-kwargs {"n":3}', "n: unknown argument"),
        (train_ppo, "--algo a2c", "algo = 'a2c': must be one of \"ppo\", \"sac\","),
        (train_ppo, "--n-timesteps inf", "--n-timesteps: invalid"),
        (train_ppo, "--n-timesteps 0", "--n-timesteps = 0: must be a whole number, at least 1"),
        (train_ppo, "--evaluate-every -1", "--evaluate-every = -1: must be a whole number, at least 1"),
    ],
)
def test_mistakes_are_told_in_a_sentence(program, words, sentence, monkeypatch, capsys):
    assert sentence in told(program.main, words.split(), monkeypatch, capsys)


def test_files_that_cannot_be_used_are_named(run: Path, tmp_path: Path):
    refuses("must hold a policy.npz or a model.zip", lambda: policies.choose(str(tmp_path), ENV))
    with pytest.raises(ValueError, match="trained on FlexibleArm-v0, not on TwoLinkFlexArm-v0"):
        policies.choose(str(run), "TwoLinkFlexArm-v0")
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    (copy / "policy.npz").unlink()
    sound, model = (copy / "model.zip").read_bytes(), load_model(copy, "ppo")[0]
    for size, sentence in ((6, "no statistics of VecNormalize"), (14, r"shape of mean = \(14,\): must be \(6,\)")):
        moments = SimpleNamespace(mean=np.zeros(size), var=np.ones(size))
        statistics = SimpleNamespace(norm_obs=True, obs_rms=moments, clip_obs=10.0, epsilon=1e-8)
        (copy / "vecnormalize.pkl").write_bytes(pickle.dumps(statistics if size > 6 else {}))
        refuses(sentence, lambda: policies.choose(str(copy), ENV))
    (copy / "vecnormalize.pkl").unlink()
    model.policy.log_std.data.fill_(np.nan)
    model.save(copy / "model.zip")
    refuses(r"model\.zip: log_std holds numbers that are not finite", lambda: export_policy.export(copy))
    (copy / "model.zip").write_bytes(sound)
    (copy / "model.zip").write_bytes(b"torn")
    refuses(r"model\.zip: no model of Stable-Baselines3 that can be read", lambda: policies.choose(str(copy), ENV))
    (copy / "model.zip").write_bytes(sound)
    (copy / "run.json").write_text("{")
    refuses("damaged, not JSON", lambda: policies.choose(str(copy), ENV))
    (copy / "model.zip").unlink()
    refuses("must hold a policy.npz or a model.zip", lambda: policies.choose(str(copy), ENV))


def test_tuning_says_how_far_it_is(capsys, monkeypatch):
    """It said nothing for half a minute and more."""
    monkeypatch.setattr(tune.SearchProgress, "EVERY", (0.0, 0.0))
    words = ["--env", ENV, "--controllers", "pd", "--samples", "2", "--refinements", "2", "--episodes", "2", "--dry"]
    assert tune.main("flexarm tune", words) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "tuning pd: 5 gains at most"
    assert lines[1].startswith("pd: 1 of 5, ") and lines[1].endswith(" s")


def test_controllers_take_gains_from_a_file(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text("[pd]\nbandwidth = [0.1]\nratio = [1.0]\n")
    chosen = policies.choose(f"pd@{file}", ENV)
    assert chosen.name == "pd@mine"
    controller = chosen.make(episodes.make_episodes(ENV, 1))
    assert controller.kp < control.make("pd", controller.setup).kp
    refuses(r"no table \[zv\]; it has pd", lambda: policies.choose(f"zv@{file}", ENV))
    refuses("No such file", lambda: policies.choose(f"pd@{tmp_path / 'none.toml'}", ENV))
    file.write_text("[pd]\nbandwith = [0.1]\n")
    refuses(r"pd\.bandwith", lambda: policies.choose(f"pd@{file}", ENV))
    for text, sentence in (("", r"pd\.ratio: missing"), ("ratio = 'x'", r"pd\.ratio = 'x'")):
        file.write_text(f"[pd]\nbandwidth = [0.1]\n{text}\n")
        refuses(sentence, lambda: policies.choose(f"pd@{file}", ENV))
    file.write_text("[pd")
    refuses("not a TOML file", lambda: policies.choose(f"pd@{file}", ENV))


def test_tuning_does_not_write_over_what_it_does_not_know(tmp_path: Path):
    file = tmp_path / "mine.toml"
    for text, sentence in (("[mine]\n", "mine: unknown controller"), ("zv = 5\n", "zv = 5"), ("[pd", "not a TOML")):
        file.write_text(text)
        refuses(sentence, lambda: tune.search_all(tune.Arguments(env=ENV, controllers="pd", out=str(file))))
        assert file.read_text() == text
