"""The suite: tasks as data, frozen by their digests, made through Gymnasium's registry."""

import dataclasses
import re
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.machine import DOCS
from benchmarks.suite_pages import pages
from flexarm_env import suite
from flexarm_env.envs import spec
from flexarm_env.envs.options import ARGUMENTS
from flexarm_env.suite.data import read
from tests.refusals import refuses

TASKS = suite.tasks(earlier=True)
NAMES = [task.id for task in TASKS]


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_a_task_is_what_its_file_records(task: suite.Task) -> None:
    """Another arm, keyword or default under the same name is another task: it needs another version."""
    assert suite.digest(task) == task.digest


def test_digests_tell_tasks_apart_but_not_spellings() -> None:
    task = suite.task("slew-unknown-v2")
    factors = task.keywords["randomization"]
    for changed in ({"payload": [0.25, 4.1]}, {"EI": [0.5, 1.5]}):
        other = dataclasses.replace(task, keywords={**task.keywords, "randomization": changed})
        assert suite.digest(other) != task.digest
    spelt = {name: tuple(np.float64(x) for x in pair) for name, pair in factors.items()}
    alike = dataclasses.replace(task, keywords={**task.keywords, "randomization": spelt}, hard="otherwise said")
    assert suite.digest(alike) == task.digest


def test_names_numbers_and_budgets() -> None:
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)*-v[1-9]\d*", name) for name in NAMES)
    numbers = [task.number for task in suite.tasks()]
    assert numbers == sorted(set(numbers))
    assert {(task.name, task.number) for task in TASKS} == {(task.name, task.number) for task in suite.tasks()}
    assert all(set(task.keywords) <= set(ARGUMENTS) for task in TASKS)
    assert all(task.env_id == f"flexarm_env:{task.registered}" and task.registered in gym.registry for task in TASKS)


def test_pages_are_made_of_the_data() -> None:
    stale = [str(path) for path, text in pages().items() if (DOCS / path).read_text("utf-8") != text]
    assert stale == [], "run python -m benchmarks.suite_pages"


def test_tasks_by_every_name() -> None:
    task = suite.task("reach-three-v2")
    assert suite.task(task.env_id) is task is suite.task(task.registered)
    refuses(r'task = .slew.: must be one of "slew-measured-v1"', lambda: suite.task("slew"))


def test_keywords_that_make_another_task_are_known() -> None:
    def changed(env_id: str, **keywords: object) -> list[str]:
        made = gym.spec(env_id)
        return spec.changed(dataclasses.replace(made, kwargs={**made.kwargs, **keywords}))

    task = suite.task("slew-measured-v2").registered
    assert changed(task) == changed(task, duration=1.0, reward={}, info_level="numbers", threads=2, history=4) == []
    assert changed(task, starts={"target": np.zeros(2)}, history=1) == ["history", "starts"]
    assert changed(task, sensors={}) == ["sensors"] and changed("FlexibleArm-v0", history=3) == []


def test_another_task_under_a_frozen_name_is_warned_of_once() -> None:
    spec.warned.clear()
    task = suite.task("slew-measured-v2").registered
    with pytest.warns(UserWarning, match=f"{task} with history changes the task") as caught:
        gym.make(task, history=1)
    assert [Path(one.filename).name for one in caught] == ["test_suite.py"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym.make(task, history=1)


def test_of_a_task_with_a_later_version_gymnasium_warns():
    """And makes what was asked for."""
    with pytest.warns(DeprecationWarning, match="flexarm/slew-measured-v1 is out of date.*version `v2`"):
        env = gym.make("flexarm_env:flexarm/slew-measured-v1")
    assert env.unwrapped.plan.limit == 200 and suite.make("slew-measured-v2").unwrapped.plan.limit == 125
    assert [task.id for task in suite.tasks() if task.name == "slew-measured"] == ["slew-measured-v2"]


def test_single_and_vector_by_their_ids() -> None:
    task = suite.task("slew-unknown-v2")
    single, vector = gym.make(task.env_id), gym.make_vec(task.env_id, num_envs=3)
    assert single.unwrapped.plan.limit == 300 and single.spec.id == task.registered
    assert vector.unwrapped.plan.starts.drawn["payload"] == (0.25, 4.0)
    assert suite.make(task.id).observation_space == single.observation_space == vector.single_observation_space


@pytest.mark.parametrize(
    ("line", "words"),
    [("colour = 1", "slew-v1.toml: colour"), ("number = 0", "slew-v1.toml: number = 0: must be a whole number")],
)
def test_what_is_wrong_in_a_file_is_named(line: str, words: str) -> None:
    good = 'number = 1\ntitle = "t"\nenvironment = "e"\nbudget = 1\nhard = "h"\ndigest = ""\n'
    text = good.replace("number = 1\n", "") if line.startswith("number") else good
    refuses(re.escape(words), lambda: read(f"{line}\n{text}[keywords]\n", "slew-v1"))
    refuses(r"slew-v1\.toml: keywords: missing", lambda: read(good, "slew-v1"))
