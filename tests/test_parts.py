"""A kernel is optimised once, as a whole; what it calls is a part of it until Python calls that too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numba import config
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher

from flexarm_env.compiler.decorator import kernel
from flexarm_env.compiler.private import MODE
from flexarm_env.compiler.whole import KernelDispatcher, PartMarker
from tests.processes import python

pytestmark = pytest.mark.skipif(
    bool(config.DISABLE_JIT) or MODE == "plain", reason="nothing is compiled, or nothing in parts"
)


def _square(x):
    return x * x + 1.0


def _sum(x):
    total = 0.0
    for k in range(x.shape[0]):
        total += _inner(x[k])
    return total


def _both(x):
    return _middle(x) + np.sum(x)


_inner, _middle, _outer = kernel(_square), kernel(_sum), kernel(_both)


def _whole(function: object) -> list[bool]:
    """For each compiled form, whether it can be run (and was optimised)."""
    forms = function.overloads.values()
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
    told = [python("-c", lines, NUMBA_CACHE_DIR=str(tmp_path)).stdout.split() for _ in range(2)]
    assert told == [["11.0", "8.0", "5.0", "0"], ["11.0", "8.0", "5.0", "1"]]


FOREIGN = """
import sys
import numba
from flexarm_env.compiler.decorator import kernel

@numba.njit
def plain(x, y):
    return x / y + 1.0

@kernel
def same(x):
    return x

@kernel
def half(x):
    return 0.5 * same(x)

@numba.njit(cache=True)
def kept(x, y):
    return plain(x, y) * half(4.0)

@numba.njit(inline="always")
def inlined(x, y):
    return x / y + 3.0

@kernel
def caller(x, y):
    return plain(x, y) + kept(x, y) + inlined(x, y)

@numba.njit
def around(x, y):
    return caller(x, y) + 1.0

def ask_helpers():
    return [f(6.0, 2.0) for f in (plain, kept, inlined)]

def ask_kernel():
    return [caller(6.0, 2.0), around(6.0, 2.0)]

steps = (ask_kernel, ask_helpers) if sys.argv[1] == "kernel" else (ask_helpers, ask_kernel)
print(*[x for step in (*steps, *steps) for x in step()])
for f in (plain, kept, inlined):
    try:
        f(1.0, 0.0)
    except ZeroDivisionError:
        print("raised")
"""
"""Somebody's own compiled functions, called from a kernel and from Python."""


@pytest.mark.parametrize("first", ["kernel", "helpers"])
def test_foreign_functions_stay_what_they_are(first: str, tmp_path: Path) -> None:
    """Whoever is called first, and whether it comes from the disk: a foreign function gives what it always did."""
    script, kernel_says, helpers_say = tmp_path / "foreign.py", ["18.0", "19.0"], ["4.0", "8.0", "6.0"]
    script.write_text(FOREIGN, encoding="utf-8")
    said = kernel_says + helpers_say if first == "kernel" else helpers_say + kernel_says
    for _ in range(2):
        told = python(script, first, NUMBA_CACHE_DIR=str(tmp_path)).stdout.split()
        assert told == said + said + ["raised"] * 3


def test_every_allowed_numba_takes_the_dispatcher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba before 0.62 compiles with the locals that it is given, and None is none."""
    given = []
    monkeypatch.setattr(CPUDispatcher, "__init__", lambda self, function, *options, **_: given.extend(options))
    KernelDispatcher(_square)
    assert given == [{}, {}]
