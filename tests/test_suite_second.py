"""The second hundred of episodes: seeds that follow from the policy, and what tells one that has learnt by heart."""

import dataclasses
import hashlib
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from agents import foresight
from flexarm_env import suite
from flexarm_env.control import NumpyPolicy
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.suite import policies, results, score, second
from flexarm_env.suite.page import pages

TASK = suite.task("slew-limited-v2")


def network(seed: int = 0, **meta: object) -> NumpyPolicy:
    rng = np.random.default_rng(seed)
    weights = [(rng.normal(size=(6, 1)).astype(np.float32), np.zeros(1, np.float32))]
    normaliser = {"mean": np.zeros(6), "variance": np.ones(6), "clip": np.array(10.0), "epsilon": np.array(1e-8)}
    return NumpyPolicy({"activation": "tanh", **meta}, weights, normaliser)


def test_seeds_follow_from_task_and_arrays_and_from_nothing_else():
    own = second.of_arrays(network())
    shapes = b"(6, 1)" + network().weights[0][0].astype(float).tobytes() + b"(1,)" + bytes(8)
    ends = b"(6,)" + bytes(48) + b"(6,)" + np.ones(6).tobytes() + b"(1,)" + np.array(10.0).tobytes()
    assert own == shapes + ends + b"(1,)" + np.array(1e-8).tobytes()
    digits = hashlib.sha256(TASK.digest.encode() + own).hexdigest()[:8]
    assert second.first_seed(TASK, own) == 2**32 + int(digits, 16)
    assert second.of_arrays(network(note="retouched", seed_of_training=7)) == own
    assert second.first_seed(suite.task("slew-measured-v2"), own) != second.first_seed(TASK, own)
    moved = network()
    moved.normaliser["mean"] = moved.normaliser["mean"] + 1e-9
    assert len({own, second.of_arrays(network(1)), second.of_arrays(moved)}) == 3


def test_of_a_controller_name_and_gains_count(monkeypatch: pytest.MonkeyPatch):
    own = second.of_controller("pd", TASK)
    assert own != second.of_controller("zv", TASK) and b'"bandwidth": [0.1889]' in own
    gains = dataclasses.replace(tuned_gains("pd", "slew"), bandwidth=(0.19,))
    monkeypatch.setattr(second, "tuned_gains", lambda *words: gains)
    assert second.of_controller("pd", TASK) != own


def test_chance_is_that_of_all_deals(rng: np.random.Generator):
    values = rng.normal(size=9)
    one, other = values[:4], values[4:]
    seen = abs(one.mean() - other.mean())
    deals = [
        abs(values[list(part)].mean() - np.delete(values, part).mean()) >= seen * (1.0 - 1e-12)
        for part in combinations(range(9), 4)
    ]
    assert second.chance(one, other) == pytest.approx(np.mean(deals), abs=0.03)
    assert second.chance(rng.normal(size=100), 3.0 + rng.normal(size=100)) == 1.0 / (1 + second.MANY)
    # of hundreds that do not differ, p lies anywhere
    found = [second.chance(rng.normal(size=20), rng.normal(size=20), k) for k in range(200)]
    assert 0.01 <= np.mean(np.array(found) < 0.05) <= 0.1


def test_of_many_tests_holm():
    assert second.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert second.holm([0.02, 0.9, 0.9]) == pytest.approx([0.06, 1.0, 1.0])
    assert second.holm([]) == []


class ByHeart:
    """The actions that a controller had on the public hundred, of the episode whose beginning is nearest."""

    def __init__(self, env, name: str) -> None:
        self.first, _ = env.reset(seed=score.FIRST)
        self.actions, _ = foresight.played(env, policies.controller(name, env))

    def reset(self, observation):
        far = np.abs(observation[:, None] - self.first[None]).sum(axis=2)
        self.which, self.k = far.argmin(axis=1), 0

    def act(self, observation):
        self.k += 1
        return self.actions[self.k - 1][self.which]


@pytest.mark.slow
def test_what_was_learnt_by_heart_is_marked_and_what_was_not_is_not(tmp_path: Path):
    env = suite.make_vec(TASK.id, score.EPISODES)
    learnt = ByHeart(env, "time_optimal")
    env.close()
    stored = learnt.actions.tobytes()

    def chosen(word: str, task: suite.Task) -> policies.Chosen:
        if word != "by-heart":
            return policies.choose(word, task)
        return policies.Chosen("policy", word, "x", lambda env: learnt, canonical=lambda: stored)

    for word in ("by-heart", "zv", "tests.test_suite_second:nothing"):
        results.judged(word, [TASK], tmp_path, name=word.rpartition(":")[2], choose=chosen)
    names = ("by-heart", "zv", "nothing")
    own, zv, alone = (results.read(tmp_path / f"{name}-0.json").tasks[TASK.id] for name in names)
    assert own["second"]["first_seed"] == second.first_seed(TASK, stored)
    assert np.mean(own["successes"]) == 1.0 and np.mean(own["second"]["successes"]) < 0.2
    assert zv["pd"] != zv["second"]["pd"] and alone["second"] is alone["pd"] is None
    table = pages(results.folder_of(tmp_path))["suite-tasks.md"].partition(f"(`{TASK.id}`)")[2].splitlines()
    rows = {name: line for line in table for name in names if line.startswith(f"| {name} ")}
    assert [name for name, line in rows.items() if "†" in line] == ["by-heart"]
    assert [name for name, line in rows.items() if "public only" in line] == ["nothing"]


def nothing(seen):
    """Of Python: any such may know the public hundred."""
    return np.zeros((len(seen), 1))


@pytest.mark.parametrize("task", suite.tasks(), ids=[task.id for task in suite.tasks()])
def test_later_fields_of_gains_leave_the_seeds_of_pd(task: suite.Task, published: list[results.Results]) -> None:
    entry = next(one.tasks[task.id] for one in published if one.name == "pd" and task.id in one.tasks)
    assert entry["second"]["first_seed"] == second.first_seed(task, second.of_controller("pd", task))
