"""Training runs on Ray: the run folder, resuming, workers and whole runs that are killed."""

import csv
import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from agents import train_rllib
from agents.rllib import setup
from flexarm_env.control import load_policy
from flexarm_env.training.evaluate import Arguments as Judged
from flexarm_env.training.evaluate import evaluate
from flexarm_env.training.runs import checkpoints, read_run
from tests.processes import ROOT

ENV = "FlexibleArm-v0"
SMALL = {
    "n_envs": 8, "n_timesteps": 2048, "policy_kwargs": "dict(net_arch=[16], log_std_init=-0.5)", "n_steps": 32,
    "batch_size": 128, "n_epochs": 1, "gamma": 0.98, "learning_rate": "lin_1e-3",
}  # fmt: skip
FEW = {"evaluate_every": 1024, "eval_episodes": 4, "checkpoint_every": 512, "progress": False}


def arguments(folder: Path, env_id: str = ENV, **changes: Any) -> train_rllib.Arguments:
    path = folder / "small.yml"
    path.write_text(yaml.safe_dump({env_id: SMALL, "env_kwargs": {env_id: {"duration": 1.0}}}))
    return dataclasses.replace(train_rllib.Arguments(env=env_id, config=path, out=folder / "run", **FEW), **changes)


def killed(program: str, words: list[str], cluster: Any, when: Callable[[], object]) -> None:
    """Run a program on a Ray that there is, and kill it once something has happened."""
    words = ["-m", program, *words, "--address", cluster.get_runtime_context().gcs_address]
    environment = {k: v for k, v in os.environ.items() if k != "RAY_ADDRESS"}
    process = subprocess.Popen([sys.executable, *words], cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 600.0
    while not when() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "it was killed, and has not ended before"


def also(patch: pytest.MonkeyPatch, name: str, more: Callable[[train_rllib.Run], None]) -> None:
    """Have a method of runs do something more at its end."""
    usual = getattr(train_rllib.Run, name)

    def method(self: train_rllib.Run, *items: Any) -> None:
        usual(self, *items)
        more(self)

    patch.setattr(train_rllib.Run, name, method)


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "learning_curve.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def run(cluster: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    train_rllib.train(arguments(folder))
    return folder / "run"


def test_a_run_folder_holds_all_that_is_needed(run: Path) -> None:
    names = {"module.pt", "policy.npz", "config.yml", "run.json", "learning_curve.csv", "learning_curve.png",
             "tensorboard"}  # fmt: skip
    assert names == {p.name for p in run.iterdir()}
    record = read_run(run)
    assert record["finished"]
    assert record["steps"] >= 2048
    assert {"ray", "numpy", "torch", "flexarm_env", "gymnasium"} <= set(record["versions"])
    assert next(float(row["steps"]) for row in curve(run)) == 0.0
    assert list((run / "tensorboard").iterdir())


def test_the_policy_is_judged_as_any_other(run: Path) -> None:
    rows, _, _ = evaluate(Judged(policy=f"{run},pd", env=ENV, episodes=4))
    assert set(rows) == {"run", "pd"}
    policy = load_policy(run)
    assert policy.meta["algorithm"] == "rllib_ppo"
    assert policy.act(np.zeros(6, np.float32)).shape == (1,)
    with pytest.raises(ValueError, match=r"trained on FlexibleArm-v0, not on TwoLinkFlexArm-v0"):
        evaluate(Judged(policy=str(run), env="TwoLinkFlexArm-v0"))


def test_a_run_is_never_overwritten_nor_resumed_when_it_has_finished(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="contains a run already"):
        train_rllib.train(arguments(tmp_path, out=run))
    with pytest.raises(ValueError, match="finished"):
        train_rllib.train(train_rllib.Arguments(out=run, resume=True))


@pytest.mark.parametrize("changes", [{"sampler": "rllib", "runners": 1}, {"runners": 0}, {"learners": 1}])
def test_every_arrangement_of_processes_trains(cluster: Any, tmp_path: Path, changes: dict[str, Any]) -> None:
    progress = train_rllib.train(arguments(tmp_path, n_timesteps=512, tensorboard=False, **changes))
    assert progress.curve[-1]["steps"] >= 512


def test_two_links_train_as_well(cluster: Any, tmp_path: Path) -> None:
    progress = train_rllib.train(arguments(tmp_path, "TwoLinkFlexArm-v0", n_timesteps=512, tensorboard=False))
    assert progress.curve[-1]["steps"] >= 512
    assert load_policy(tmp_path / "run").act(np.zeros(14, np.float32)).shape == (2,)


def test_wrong_arguments_are_told_in_a_sentence(tmp_path: Path) -> None:
    for changes, sentence in (
        ({"runners": -1}, "runners = -1: must be a whole number, at least 0"),
        ({"envs_per_runner": 0}, "envs_per_runner = 0: must be a whole number, at least 1"),
        ({"best_by": "speed"}, "--best-by = 'speed': must be"),
        ({"sampler": "fast"}, "sampler = 'fast': must be one of \"native\", \"rllib\""),
        ({"env_kwargs": {"autoreset_mode": "SameStep"}}, "env_kwargs.autoreset_mode = 'SameStep': must be 'NextStep'"),
    ):
        with pytest.raises(ValueError, match=sentence):
            train_rllib.train(arguments(tmp_path, **changes))


def test_hyper_parameters_that_rllib_cannot_have_are_named(tmp_path: Path) -> None:
    """GELU was tanh, in silence."""
    path = tmp_path / "config.yml"
    for changes, sentence in (
        ({"clip_range": "lin_0.2"}, "clip_range = 'lin_0.2': must be a finite number"),
        ({"ent_coef": "auto"}, "ent_coef = 'auto': must be a finite number"),
        ({"policy_kwargs": "dict(net_arch=5)"}, "net_arch = 5: must be a list"),
        ({"policy_kwargs": "dict(log_std_init='x')"}, "log_std_init = 'x'"),
        ({"policy_kwargs": "dict(activation_fn=nn.GELU)"}, "activation_fn = GELU: must be nn.Tanh or nn.ReLU"),
    ):
        path.write_text(yaml.safe_dump({ENV: SMALL | changes}))
        with pytest.raises(ValueError, match=sentence):
            setup.load(path, ENV)
    path.write_text(yaml.safe_dump({ENV: SMALL | {"n_envs": "8"}}))
    assert setup.split(setup.load(path, ENV), 2, 0, None)[0] == 4


# ------------------------------------------------------------------ what is killed
@pytest.mark.parametrize("runners", [1, 2])
def test_a_runner_that_is_killed_is_started_anew_and_nothing_is_lost(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runners: int
) -> None:
    gone: list[int] = []
    pids: list[set[int]] = []

    def note(run: train_rllib.Run) -> None:
        there = run.algorithm.env_runner_group.foreach_env_runner(lambda _: os.getpid(), local_env_runner=False)
        pids.append(set(there))
        if run.steps >= 1024 and not gone:
            gone.append(there[0])
            os.kill(there[0], signal.SIGKILL)
        if gone and 0 < len(there) < runners:
            time.sleep(1.0)  # the other one is not to finish the run before it is back

    also(monkeypatch, "_note", note)
    kept: list[set[str]] = []
    also(monkeypatch, "save", lambda run: kept.append({p.name for p in checkpoints(run.folder)}))
    progress = train_rllib.train(arguments(tmp_path, n_timesteps=8192, tensorboard=False, runners=runners))
    assert gone
    assert progress.curve[-1]["steps"] >= 8192
    assert len(set().union(*pids)) == runners + 1, "the runners, and the one that took a place"
    assert len(pids[-1]) == runners
    assert all(len(names) == min(k + 1, 2) for k, names in enumerate(kept))
    steps = [int(max(names)) for names in kept]
    assert steps == sorted(set(steps))


def test_a_run_that_is_killed_goes_on_from_its_last_checkpoint(ray_folder: str, cluster: Any, tmp_path: Path) -> None:
    given = arguments(tmp_path, n_timesteps=200_000)
    words = ["--config", str(given.config), "--out", str(given.out), "--n-timesteps", "200000", "--no-progress"]
    words += ["--checkpoint-every", "512", "--evaluate-every", "1024", "--eval-episodes", "4", "--runners", "1"]
    folder = tmp_path / "run"
    killed("agents.train_rllib", words, cluster, lambda: len(checkpoints(folder)) >= 2)
    found = checkpoints(folder)
    assert found
    last = int(found[-1].name)
    before = [float(row["steps"]) for row in curve(folder)]
    counts: list[int] = []

    def note(run: train_rllib.Run) -> None:
        counts.append(run.steps)
        if len(counts) == 9:
            run.config = dataclasses.replace(run.config, text={**run.config.text, "n_timesteps": run.steps})

    with pytest.MonkeyPatch.context() as patch:
        also(patch, "_restore", lambda run: counts.append(run.steps))
        also(patch, "_note", note)
        progress = train_rllib.train(train_rllib.Arguments(out=folder, resume=True, runners=1, progress=False))
    assert counts[0] == last
    assert counts[1] - counts[0] < 2 * 8 * 32, "the count goes on where it stopped"
    after = [row["steps"] for row in progress.curve]
    assert after == sorted(set(after))
    assert [s for s in before if s <= last] == [s for s in after if s <= last]
    assert read_run(folder)["finished"]


def test_a_damaged_checkpoint_is_passed_over(cluster: Any, tmp_path: Path) -> None:
    class Stop(Exception):
        """As if the process were killed."""

    def stop(run: train_rllib.Run) -> None:
        if len(checkpoints(run.folder)) == 2:
            raise Stop

    with pytest.MonkeyPatch.context() as patch:
        also(patch, "save", stop)
        with pytest.raises(Stop):
            train_rllib.train(arguments(tmp_path, runners=0))
    older, newer = checkpoints(tmp_path / "run")
    (newer / "state.pkl").write_bytes(b"torn")
    restored: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        also(patch, "_restore", lambda run: restored.append(run.steps))
        again = train_rllib.Arguments(out=tmp_path / "run", resume=True, runners=0, progress=False)
        assert train_rllib.train(again).curve[-1]["steps"] >= 2048
    assert restored == [int(older.name)]
