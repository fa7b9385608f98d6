"""Who waits for the compiler is told what is compiled, how far it is, and for how long."""

import io
import logging
import pickle
import threading
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401  (registers the environments)
from flexarm_env.compiler import UNCOMPILED, Beside, compiling, kernel, objects, waiting
from flexarm_env.tasks.program import RETRY

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")


def _half(x):
    return 0.5 * x


def _third(x):
    return x / 3.0


@pytest.fixture
def lines(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> pytest.LogCaptureFixture:
    monkeypatch.setenv(objects.VARIABLE, str(tmp_path))
    monkeypatch.setattr(waiting, "AFTER", 0.0)
    monkeypatch.setattr(waiting, "_ended", float("-inf"))
    return caplog


def told(lines: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in lines.records]


def test_each_program_is_named_counted_and_timed(
    lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting, "PARTS", {"_half": "a half", "_third": "a third"})
    with compiling("FlexibleArm-v0", 2):
        for function in (_half, _third):
            with compiling("arm strip"):
                kernel(function)(3.0)
    first, second = told(lines)
    hint = " (once; 'flexarm compile' does it beforehand)"
    assert first == f"flexarm_env: compiling FlexibleArm-v0, program 1 of 2: a half{hint}"
    assert second == "flexarm_env: compiling FlexibleArm-v0, program 2 of 2: a third, 0 s so far"
    assert {record.name for record in lines.records} == {"flexarm_env"}
    monkeypatch.setattr(waiting, "_ended", time.monotonic() - 10.0)
    kernel(_third)(3)  # of other types, later
    assert told(lines)[2] == f"flexarm_env: compiling program 1: a third{hint}"


def test_a_terminal_counts_seconds(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    screen.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(waiting, "TICK", 0.01)
    monkeypatch.setattr(waiting.sys, "stderr", screen)
    with waiting.announced(_half):
        time.sleep(0.2)
    assert "\r  0 s " in screen.getvalue() and screen.getvalue().endswith("\r")


def test_not_where_it_is_loaded(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel(_half)(1.0)
    monkeypatch.setattr(waiting, "_ended", float("-inf"))
    again = kernel(_half)
    assert again(1.0) == 0.5 and [form.made for form in again.forms.values()] == [False]
    assert len(lines.records) == 1


def test_not_for_short_ones(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "AFTER", 60.0)
    kernel(_half)(1.0)
    assert not lines.records


def test_silenced(lines: pytest.LogCaptureFixture) -> None:
    with lines.at_level(logging.ERROR, logger="flexarm_env"):
        kernel(_half)(1.0)
    assert not lines.records


# ------------------------------------------------------------------ compiled beside the steps
def test_beside(lines: pytest.LogCaptureFixture) -> None:
    """Made once, in another thread, without a line; an error is raised where the result is asked for."""
    made, failed = Beside[tuple[float, str]](3), Beside[float](1)

    def third() -> tuple[float, str]:
        return kernel(_third)(6.0), threading.current_thread().name

    for _ in range(5):
        made.count(third)
    assert made.get(third) == (2.0, "flexarm-compile") and made.get(third) is made.get(third)
    assert not lines.records, "nobody waits for it"
    early = Beside[tuple[float, str]](3)
    early.count(third)
    assert early.get(third)[1] == threading.main_thread().name
    failed.count(lambda: 1.0 / 0.0)
    with pytest.raises(ZeroDivisionError):
        failed.get(lambda: 1.0 / 0.0)
    assert failed.get(lambda: 2.0) == 2.0


@pytest.mark.slow  # two programs are compiled
def test_the_program_of_an_arm_alone_is_there_when_it_is_needed() -> None:
    """The first arm whose iteration fails beside others waits for no compiler, nor does the first step."""
    envs = gym.make_vec("FlexibleArm-v0", num_envs=8, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    batch, actions = envs.unwrapped.batch, np.zeros((8, 1), np.float32)
    assert batch._alone._thread is None and batch._alone._found is None
    envs.step(actions)
    thread = batch._alone._thread
    assert thread is not None, "begins after the first step"
    thread.join()
    found, before = batch._alone._found, batch.get_state(3)["block"]
    assert found is not None and found.n == 1
    assert found._start is None, "it continues episodes, so that no start is compiled"
    batch.table[batch.info_at.reason, 3] = RETRY
    batch._repeat_alone()
    assert batch.alone() is found and not np.array_equal(batch.get_state(3)["block"], before), "moved by it"
    assert pickle.loads(pickle.dumps(batch)).step() == 0
    envs.close()
