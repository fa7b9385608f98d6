"""Sweeps: what a choice stands for, and that a sweep which is killed goes on."""

import csv
import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from agents import sweep
from flexarm_env.training.runs import read_run
from tests.ray.test_train_rllib import ENV, SMALL, killed


def test_choices_are_all_combinations() -> None:
    found = sweep.choices({"payload": [0.5, 2.0], "reward.effort": [0.1]}, 2)
    assert [tuple(c.values()) for c in found] == [(0.5, 0.1, 0), (0.5, 0.1, 1), (2.0, 0.1, 0), (2.0, 0.1, 1)]
    assert sweep.name_of(found[0]) == "payload=0.5,effort=0.1,seed=0"
    common = {"duration": 2.0, "reward": {"settle": 2.0}}
    assert sweep.keywords(found[0], common) == {
        "duration": 2.0, "reward": {"settle": 2.0, "effort": 0.1}, "randomization": {"payload": [0.5, 0.5]},
    }  # fmt: skip
    assert common == {"duration": 2.0, "reward": {"settle": 2.0}}


@pytest.mark.parametrize(
    ("space", "sentence"),
    [
        ({}, "--space: must name something to vary"),
        ({"payload": 2.0}, "--space payload = 2.0: must be a list of values"),
        ({"reward.speed": [1.0]}, r"reward\.speed"),
        ({"weight": [1.0]}, "weight"),
        ({"payload": [-1.0]}, r"randomization\.payload"),
    ],
)
def test_what_is_wrong_is_told_before_anything_runs(space: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=sentence):
        sweep.sweep(sweep.Arguments(space=space, out=tmp_path / "sweep"))
    assert not (tmp_path / "sweep").exists()


def test_a_sweep_that_is_killed_goes_on(ray_folder: str, cluster: Any, tmp_path: Path) -> None:
    config = tmp_path / "small.yml"
    config.write_text(yaml.safe_dump({ENV: SMALL, "env_kwargs": {ENV: {"duration": 1.0}}}))
    out = tmp_path / "sweep"
    words = ["--space", '{"reward.vibration": [0.02, 0.2, 2.0]}', "--config", str(config), "--out", str(out)]
    words += ["--eval-episodes", "4", "--at-once", "1"]
    killed("agents.sweep", words, cluster, lambda: list(out.glob("trials/*/judged.json")))
    judged = list(out.glob("trials/*/judged.json"))
    assert judged
    before = {path: os.stat(path).st_mtime_ns for path in judged}
    with pytest.raises(ValueError, match="holds a sweep already"):
        sweep.sweep(sweep.Arguments(space={"payload": [1.0]}, out=out))
    rows = sweep.sweep(sweep.Arguments(out=out, resume=True))
    assert [row["reward.vibration"] for row in rows] == [0.02, 0.2, 2.0]
    assert all(os.stat(path).st_mtime_ns == date for path, date in before.items()), "what has finished is kept"
    assert all(read_run(folder)["finished"] for folder in (out / "trials").iterdir())
    with (out / "results.csv").open() as file:
        assert [row["seed"] for row in csv.DictReader(file)] == ["0", "0", "0"]
    assert "| 2.0 | 0 |" in (out / "results.md").read_text("utf-8")
    assert (out / "results.png").stat().st_size > 10_000
