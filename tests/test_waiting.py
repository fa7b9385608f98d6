"""Who waits for the compiler is told: once a wait, and only where something is compiled."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import pytest
from numba import config

from flexarm_env.compiler import decorator as jit
from flexarm_env.compiler import waiting

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


def _half(x):
    return 0.5 * x


def _third(x):
    return x / 3.0


@pytest.fixture
def lines(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> pytest.LogCaptureFixture:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(waiting, "AFTER", 0.0)
    monkeypatch.setattr(waiting, "_ended", float("-inf"))
    return caplog


def test_once_a_wait(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert jit.kernel(_half)(1.0) == 0.5 and jit.kernel(_third)(3.0) == 1.0
    assert len(lines.records) == 1 and lines.records[0].name == "flexarm_env"
    assert "compiling" in lines.records[0].getMessage() and "flexarm compile" in lines.records[0].getMessage()
    monkeypatch.setattr(waiting, "_ended", time.monotonic() - 10.0)
    jit.kernel(_third)(3)  # of other types, later
    assert len(lines.records) == 2


def test_not_where_it_is_loaded(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    jit.kernel(_half)(1.0)
    monkeypatch.setattr(waiting, "_ended", float("-inf"))
    again = jit.kernel(_half)
    assert again(1.0) == 0.5 and sum(again._cache_hits.values()) == 1
    assert len(lines.records) == 1


def test_not_for_short_ones(lines: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "AFTER", 60.0)
    jit.kernel(_half)(1.0)
    assert not lines.records


def test_silenced(lines: pytest.LogCaptureFixture) -> None:
    with lines.at_level(logging.ERROR, logger="flexarm_env"):
        jit.kernel(_half)(1.0)
    assert not lines.records
