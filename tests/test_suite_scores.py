"""Scores on the suite: interquartile means, their intervals, references."""

import json

import numpy as np
import pytest
from scipy import stats

from flexarm_env import suite
from flexarm_env.suite import overview, page, results, score
from flexarm_env.suite.lines import lines_of
from flexarm_env.training import config

FIRST_TASK = suite.tasks()[0]


def test_the_interquartile_mean_is_the_mean_of_the_middle_half(rng: np.random.Generator):
    for shape in ((5, 12), (3, 1), (2, 7)):
        scores = rng.normal(size=shape)
        by_task = {f"{k}": list(column) for k, column in enumerate(scores.T)}
        assert score.interquartile_mean(by_task) == pytest.approx(stats.trim_mean(scores, 0.25, axis=None))
    assert score.interquartile_mean({"a": [0.0, 0.0, 100.0, 1.0, 3.0, 2.0, 50.0, -9.0]}) == pytest.approx(1.5)


def test_intervals_draw_runs_in_each_task_for_itself(rng: np.random.Generator):
    assert score.interval({"a": [1.0], "b": [2.0]}) is None
    # tasks that differ, but runs that do not: nothing is uncertain
    assert score.interval({"a": [0.0, 0.0, 0.0], "b": [5.0, 5.0, 5.0]}) == (2.5, 2.5)
    # by a loop of one's own
    table = {"a": list(rng.normal(0.2, 0.3, 5)), "b": list(rng.normal(0.8, 0.1, 3)), "c": [0.4]}
    own = [
        stats.trim_mean(np.concatenate([rng.choice(runs, len(runs)) for runs in table.values()]), 0.25)
        for _ in range(2000)
    ]
    low, high = score.interval(table)
    assert (low, high) == pytest.approx(tuple(np.quantile(own, [0.025, 0.975])), abs=0.02)
    assert low < score.interquartile_mean(table) < high


def test_intervals_cover_the_truth(rng: np.random.Generator):
    """Of many draws of 8 runs in 6 tasks about 95 %: the percentile bootstrap of few runs is somewhat short."""
    inside = 0
    for k in range(200):
        drawn = {f"{task}": list(rng.normal(task, 0.3, 8)) for task in range(6)}
        low, high = score.interval(drawn, resamples=400, seed=k)
        inside += low <= 2.5 <= high
    assert 0.85 <= inside / 200 <= 0.99


def test_scores_are_zero_for_pd_and_one_for_the_best(monkeypatch: pytest.MonkeyPatch):
    text = json.dumps({FIRST_TASK.id: {"digest": FIRST_TASK.digest, "pd": 100.0, "best": 300.0, "by": "somebody"}})
    known = score.read_references(text, "file")
    monkeypatch.setattr(score, "references", lambda: known)
    assert [score.score(FIRST_TASK, value) for value in (100.0, 200.0, 340.0)] == [0.0, 0.5, 1.2]
    changed = json.dumps({FIRST_TASK.id: {"digest": "another", "pd": 100.0, "best": 300.0, "by": "somebody"}})
    monkeypatch.setattr(score, "references", lambda: score.read_references(changed, "file"))
    assert score.score(FIRST_TASK, 200.0) is None
    with pytest.raises(ValueError, match=r"file: a\.best = 1.0: must be a finite number, above 2"):
        score.read_references('{"a": {"digest": "x", "pd": 2.0, "best": 1.0, "by": ""}}', "file")


def test_references_belong_to_the_tasks_as_they_are():
    assert {name: one.digest for name, one in score.references().items()}.items() <= {
        (task.id, task.digest) for task in suite.tasks(earlier=True)
    }


def line(method: str, rows: list[list[float]], kind: str = "policy", steps: float = 0.0) -> page.Line:
    """Runs of a method: of each its values, those of the public hundred and further ones."""
    entries = [
        {
            "episodes": 100, "returns": row[:100], "costs": [0.0] * 100, "further": row[100:] or None,
            "policy": {"kind": kind}, "training": {"steps": steps} if steps else None,
        }
        for row in rows
    ]  # fmt: skip
    return page.Line(method, [], entries)


def test_differences_are_paired_over_the_episodes_of_both(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch):
    reference = score.Reference(FIRST_TASK.digest, 50.0, 70.0, "somebody")
    monkeypatch.setattr(score, "references", lambda: {FIRST_TASK.id: reference})
    hard = rng.normal(0.0, 50.0, 300)
    ahead, runs = hard + 10.0, hard[:250] + rng.normal(0.0, 4.0, (3, 250))
    one, other = line("one", [list(ahead)]), line("other", [list(row) for row in runs])
    less, half, count = page.gap(FIRST_TASK, other, one)
    own = (ahead[:250] - runs.mean(axis=0)) / 20.0
    limits = stats.norm.interval(0.95, own.mean(), stats.sem(own))
    assert count == 250 and (less - half, less + half) == pytest.approx(limits, rel=1e-3)
    assert half < 0.02 < 1.96 * stats.sem(ahead / 20.0)  # what makes episodes hard is in both
    apart = [line("found", [list(rng.normal(0.0, 50.0, 100))], "actions")]
    apart += [line("little", [list(rng.normal(0.0, 50.0, 100))], steps=0.98 * FIRST_TASK.budget)]
    assert page.widest(FIRST_TASK, [one, other, *apart]) == half
    trained = line("trained", [list(rng.normal(0.0, 50.0, 100))], steps=FIRST_TASK.budget)
    assert page.widest(FIRST_TASK, [one, other, trained]) > 20 * half


@pytest.mark.parametrize("task", suite.tasks(), ids=[task.id for task in suite.tasks()])
def test_all_methods_are_told_apart(task: suite.Task, published: list[results.Results]):
    """No difference of two methods, published, is less certain than to a twentieth of the scale."""
    lines = page.lines_of(task, published)
    least = 3 if task.id == "wipe-v1" else 4  # pd, hybrid_force and impedance alone so far
    assert len(lines) >= least and page.widest(task, lines) <= page.WIDTH


def test_policies_that_contain_pd_are_marked(published: list[results.Results]) -> None:
    yaml = pytest.importorskip("yaml")
    text = yaml.safe_load((config.HOME / "ppo" / "suite.yml").read_text("utf-8"))
    assert {f"flexarm/{name}" for name in overview.AROUND} == {*text["around"]}
    rows = {task.id: lines_of(task, published) for task in suite.tasks()}
    marked = [row.split("`")[1] for row in overview.scores(suite.tasks(), rows) if overview.MARK in row]
    assert marked == [task.id for task in suite.tasks() if task.id in overview.AROUND]
