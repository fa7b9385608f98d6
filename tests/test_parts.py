"""A kernel is optimised once, as a whole; what it calls is a part of it until Python calls that too."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import config
from numba.core.caching import NullCache

from flexarm_env.kernels.jit import kernel
from flexarm_env.kernels.parts import PartMarker

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


def _square(x):  # type: ignore[no-untyped-def]
    return x * x + 1.0


def _sum(x):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(x.shape[0]):
        total += _inner(x[k])
    return total


def _both(x):  # type: ignore[no-untyped-def]
    return _middle(x) + np.sum(x)


_inner, _middle, _outer = kernel(_square), kernel(_sum), kernel(_both)


def _whole(function: object) -> list[bool]:
    """For each compiled form, whether it can be run (and was optimised)."""
    forms = function.overloads.values()  # type: ignore[attr-defined]
    return [not isinstance(form.entry_point, PartMarker) for form in forms]


def test_whole_and_parts() -> None:
    for function in (_inner, _middle, _outer):
        function._cache = NullCache()  # whatever the disk holds
    x = np.array([1.0, 2.0, 3.0])
    assert _outer(x) == 17.0 + 6.0
    assert _whole(_outer) == [True] and _whole(_middle) == [False] and _whole(_inner) == [False]
    assert _middle(x) == 17.0  # compiled once more, now whole
    assert _whole(_middle) == [True] and _whole(_inner) == [False]
    assert _inner(2.0) == 5.0
    assert _outer(x) == 23.0


def test_from_the_disk(tmp_path: Path) -> None:
    """A second process runs what the first has compiled, and compiles nothing."""
    lines = "import numpy as np; from tests import test_parts as t; x = np.arange(3.0)"
    lines += "; print(t._outer(x), t._middle(x), t._inner(2.0), sum(t._outer._cache_hits.values()))"
    root = Path(__file__).parents[1]
    told = [
        subprocess.run(
            [sys.executable, "-c", lines], cwd=root, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True, text=True, check=True,
        ).stdout.split()
        for _ in range(2)
    ]  # fmt: skip
    assert told == [["11.0", "8.0", "5.0", "0"], ["11.0", "8.0", "5.0", "1"]]
