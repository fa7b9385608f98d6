"""Records: the best that was ever played, replayed."""

import json
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import suite
from flexarm_env.cli import main
from flexarm_env.suite import best, frozen, page, results, score
from tests.cli_tools import answer, refused
from tests.processes import python

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "suite"
QUICK = "slew-limited-v2"


@pytest.mark.parametrize("name", best.known())
def test_no_published_run_is_above_a_record(name: str, published: list[results.Results]):
    """In no episode; and a record is of the task as it is, with one action an instant."""
    task, kept = suite.task(name), best.record(suite.task(name))
    periods = frozen.possible(name).periods
    assert kept.actions.shape[:2] == (periods, score.EPISODES) and np.abs(kept.actions).max() <= 1.0
    assert kept.digest == task.digest and len(kept.by) == len(kept.values) == score.EPISODES and all(kept.by)
    for one, entry in results.of_task(task, published):
        assert (results.values(task, entry) <= kept.values + best.rounding(name)).all(), one.file
    assert kept.values.mean() >= score.references()[name].best - 1e-3


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one == QUICK else pytest.mark.slow) for one in best.known()]
)
def test_a_record_is_played_again(name: str, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "bench", "suite", "--best", name)["records"][name]
    assert found["same"] == found["episodes"] == score.EPISODES
    assert abs(found["value"] - best.record(suite.task(name)).values.mean()) < best.rounding(name)


REPLAYED = """
import json
from flexarm_env import suite
from flexarm_env.episodes import Actions
from flexarm_env.suite import best, score
values = {}
for name in best.known():
    task = suite.task(name)
    env = suite.make_vec(name, score.EPISODES)
    values[name] = best.played(task, env, Actions(best.record(task).actions))[0].tolist()
    env.close()
print(json.dumps(values))
"""


@pytest.mark.slow
def test_records_are_played_to_the_same_bits_where_linear_algebra_rounds_otherwise():
    """As OpenBLAS, where NumPy has it, does for two processors; any x86-64 in use does what these do."""
    one, two = (json.loads(python("-c", REPLAYED, OPENBLAS_CORETYPE=name).stdout) for name in ("Haswell", "Prescott"))
    assert set(one) == set(best.known())
    assert [name for name in one if one[name] != two[name]] == []


def test_actions_are_packed_to_the_bit():
    actions = np.random.default_rng(0).normal(size=(5, 4, 3)).astype(np.float32)
    found = best.unpacked(best.packed(actions))
    assert found.dtype == np.float32 and np.array_equal(found, actions)


def test_other_actions_are_no_record(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    task = suite.task(QUICK)
    kept = best.record(task)
    off = kept.actions.copy()
    off[0, 3] = -off[0, 3]
    monkeypatch.setattr(best, "record", lambda task: best.Record(off, kept.values, kept.by, kept.digest, kept.date))
    assert main(["bench", "suite", "--best", QUICK]) == 1
    assert "99 of 100 episodes reproduced" in capsys.readouterr().out


def test_a_run_that_beats_a_record_is_told_of(tmp_path: Path):
    task = suite.task(QUICK)
    kept = best.record(task)
    entry = dict(results.read(RESULTS / "pd-0.json", earlier=True).tasks[QUICK])
    entry["returns"] = [*(kept.values[:2] + 0.5).tolist(), *entry["returns"][2:]]
    entry["costs"] = [0.0, 0.0, *entry["costs"][2:]]
    results.Results("quick", 0, {QUICK: entry}).write(tmp_path)
    text = page.pages(results.folder_of(tmp_path))["suite-tasks.md"]
    assert "Better than these actions: **quick in 2 episodes**" in text


def test_a_task_without_a_record_says_so(capsys: pytest.CaptureFixture[str]):
    assert "slew-measured-v1" not in best.known()
    told = refused(capsys, "bench", "suite", "--best", "slew-measured-v1")
    assert "--best = 'slew-measured-v1': has no record" in told
