"""Who waits for the compiler is told: once a wait, and only where something is compiled."""

import logging
import time
from pathlib import Path

import pytest

from flexarm_env.compiler import UNCOMPILED, kernel, objects, waiting

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


def test_once_a_wait(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert kernel(_half)(1.0) == 0.5 and kernel(_third)(3.0) == 1.0
    assert len(lines.records) == 1 and lines.records[0].name == "flexarm_env"
    assert "compiling" in lines.records[0].getMessage() and "flexarm compile" in lines.records[0].getMessage()
    monkeypatch.setattr(waiting, "_ended", time.monotonic() - 10.0)
    kernel(_third)(3)  # of other types, later
    assert len(lines.records) == 2


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
