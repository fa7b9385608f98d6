"""The compiler rests on private names of Numba only where they are listed and checked, and works without them."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any

import pytest
from numba import config

from flexarm_env.compiler import private
from tests.processes import ROOT, python
from tests.test_parts import FOREIGN

ROOM = ROOT / "flexarm_env" / "compiler"
WHOLE_ONLY = ("whole.py", "cache.py", "private.py")
GUIDE = "numba.core.cgutils"
"""Which Numba's own guide to extending it uses."""

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


def run(lines: str, mode: str, folder: Path, code: int = 0) -> Any:
    """Python in a process of its own, with nothing in the cache."""
    script = folder / "script.py"
    script.write_text(lines, encoding="utf-8")
    return python(script, code=code, cwd=folder, FLEXARM_COMPILER=mode, NUMBA_CACHE_DIR=str(folder))


# ------------------------------------------------------------------ the list
def numba_imports(source: str) -> set[str]:
    """Dotted names that a source imports from inside Numba."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.startswith(("numba.core", "numba._"))}


def test_private_imports_are_listed() -> None:
    """Only whole mode has them, and each is in the list; a name of the list that nothing uses is stale."""
    text = ""
    for path in sorted(ROOM.glob("*.py")):
        source = path.read_text(encoding="utf-8")
        if path.name == "private.py":
            continue
        text += source
        found = numba_imports(source) - {GUIDE}
        assert not found or path.name in WHOLE_ONLY, f"{path.name} imports {found}"
        for name in found - {"numba.core.sigutils", "numba.core.caching"}:  # modules, whose names are listed
            assert any(f"{known}.".startswith(f"{name}.") for known in private.NAMES), f"{path.name}: {name}"
    checked = inspect.getsource(private)
    for name in (*private.NAMES, *private.MEMBERS):
        word = name.rpartition(".")[2]
        assert word in text or checked.count(word) > 1, f"{name} is used nowhere"


def test_numba_has_all_that_is_listed() -> None:
    assert private.selfcheck() == []


def test_each_missing_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    for dotted in private.NAMES:
        owner, _, name = dotted.rpartition(".")
        holder = private._found(owner)
        holders = [kind for kind in getattr(holder, "__mro__", (holder,)) if name in vars(kind)]
        with monkeypatch.context() as patch:
            for kind in holders:
                patch.delattr(kind, name)
            assert any(dotted in said for said in private.selfcheck()), dotted
    monkeypatch.setattr(private, "CONVENTION", "i64 (i64, i64)")
    (said,) = private.selfcheck()
    assert "a compiled function is" in said


# ----------------------------------------------------------------- the choice
ASK = "from flexarm_env.compiler import MODE, WHY, kernel\n@kernel\ndef f(x):\n    return x / 0.0\n"
ASK += "print(MODE, f(1.0), WHY)"
BREAK = "import numba.core.compiler as c\ndel c.CompileResult._reduce\n"


def test_the_choice(tmp_path: Path) -> None:
    """By the variable; not set, by the check; a choice that cannot be had is refused."""
    assert run(ASK, "", tmp_path).stdout.startswith("whole inf")
    assert run(ASK, "plain", tmp_path).stdout.startswith("plain inf")
    broken = run(BREAK + ASK, "", tmp_path)
    assert broken.stdout.startswith("plain inf plain, because") and "CompileResult._reduce" in broken.stdout
    assert "the compiler is plain, because" in broken.stderr
    refused = run(BREAK + ASK, "whole", tmp_path, code=1)
    assert "FLEXARM_COMPILER = 'whole': Numba" in refused.stderr
    refused = run(ASK, "fast", tmp_path, code=1)
    assert "FLEXARM_COMPILER = 'fast': must be 'whole' or 'plain'" in refused.stderr


# ---------------------------------------------------------------- both modes
WORDS = """
import sys
from typing import NamedTuple
import numpy as np
from flexarm_env.compiler import *
from flexarm_env.compiler import entry as _entry

class Left(NamedTuple):
    n: object
    x: np.ndarray

class Right(NamedTuple):
    n: object
    x: np.ndarray

class World(NamedTuple):
    x: np.ndarray
    y: np.ndarray
    number: float
    z: np.ndarray

@kernel
def left(lane, model):
    return 2.0

@kernel
def right(lane, model):
    return 3.0

FAMILY = Family("model")
FAMILY.register(Left, factor=left)
FAMILY.register(Right, factor=right)
factor = FAMILY.function("factor", "lane, model")

@by_kind("x", "x")
def one(kind):
    return left_of if kind == TUPLE else itself

@kernel
def left_of(x):
    return x[0]

@kernel
def itself(x):
    return x

@unrolled
@kernel
def squares(lane, model, out):
    w = stack(lane, (0, 0))
    for k in range(size(model.n)):
        store(w, 0, load(lane, model.x, k) * 1.1)
        s, c = sincos(load(lane, w, 0))
        store(out, k, load(lane, out, k) + select_lt(s, c, s / 3.0, square_root(absolute(c))) * size(model.n))

@traced(lambda p: 2)
def both(lane, order, x):
    return [helped(load(lane, x, k)) for k in (0, len(order))]

def helped(x):
    return -x * 0.3 + round_even(x)

@kernel
def everything(lane, model, out):
    b = bare(out)
    aligned_frame(lane)
    squares(lane, model, b)
    first, second = both(lane, (0,), b)
    store(b, 0, first * factor(lane, model) - maximum(second, first))
    b[b.shape[0] - 1] = largest(first) + one(2.5) + one((1.5, 0)) + len(b[1:3])

for lane, kind, n in ((SINGLE, Left, 2), (SINGLE, Right, (0, 0)), (EIGHT, Right, (0, 0))):
    x, out = np.random.default_rng(1).normal(size=24), np.ones(24)
    everything(lane, kind(n, x), out)
    print(out.tobytes().hex())

@kernel
def step(address, first, last):
    p = follow(address)
    for i in range(first, last):
        p.x[i] += p.number * p.z[i]
    if p.y[0] > 1.0:
        raise ValueError("wrong")
    return last - first

same = np.arange(100.0)
placed = Placed(World(np.zeros(100), same, 2.0, same))
other = np.arange(100.0) + 1.0
placed.replace("z", other)
compiled = entry(step, placed, 0, 0)
print(compiled(placed.address, 0, 10), placed.value.x[:11])
crew = Crew(2)
address = native(step, placed, 0, 0)
print([crew.run(address, placed.address, 100) for _ in range(50)], placed.value.x)
same[0] = 2.0
try:
    crew.run(address, placed.address, 100)
except RuntimeError as error:
    print(error)
same[0] = 0.0
print(crew.run(address, placed.address, 100))
crew.close()
print(sorted(name for name in sys.modules if name in ("flexarm_env.compiler.whole", "flexarm_env.compiler.cache")),
      file=sys.stderr)
"""
"""Every word of the compiler; two fields of `Placed` share an array, of which one is then replaced."""


def test_every_word_gives_the_same_bits_in_both_modes(tmp_path: Path) -> None:
    told = {mode: run(WORDS, mode, tmp_path) for mode in ("whole", "plain")}
    assert told["plain"].stdout == told["whole"].stdout
    assert "A compiled step raised an error" in told["plain"].stdout
    assert "[ 2.  4.  6." in told["plain"].stdout, "the array that was put in the place of z is read"
    assert told["plain"].stderr.strip() == "[]", "plain mode loads nothing that is private"
    assert "compiler.whole" in told["whole"].stderr


MAYBE = """
from flexarm_env.compiler import kernel, load, traced

@traced(lambda p: 1)
def asked(lane, order, x, factor):
    return [load(lane, x, 0) if factor is None else load(lane, x, 0) * factor]

@kernel
def maybe(number):
    return None if number > 1.0 else number

@kernel
def ask(lane, x, number):
    return asked(lane, (0,), x, maybe(number))[0]

import numpy as np
try:
    print(ask((0,), np.full(1, 3.0), 0.5))
except Exception as error:
    print("whether it is None must be known" in str(error))
"""


@pytest.mark.parametrize("mode", ["whole", "plain"])
def test_straight_line_code_refuses_what_may_be_none(mode: str, tmp_path: Path) -> None:
    """It cannot branch on it, and must not take it for None."""
    assert run(MAYBE, mode, tmp_path).stdout.split() == ["True"]


def test_plain_keeps_nothing_that_could_be_stale(tmp_path: Path) -> None:
    """An edit in a called file, which Numba's own cache would not see."""
    lines = "from flexarm_env.compiler import kernel\nfrom other import g\n@kernel\ndef f(x):\n    return g(x)\n"
    lines += "print(f(1.0))"
    for added in ("1.0", "5.0"):
        other = f"from flexarm_env.compiler import kernel\n@kernel\ndef g(x):\n    return x + {added}\n"
        (tmp_path / "other.py").write_text(other, encoding="utf-8")
        own = f"import sys; sys.dont_write_bytecode = True; sys.path.insert(0, {str(tmp_path)!r})\n"
        assert float(run(own + lines, "plain", tmp_path).stdout) == 1.0 + float(added)
    assert not list(tmp_path.rglob("*.nb?"))


def test_plain_works_with_foreign_functions(tmp_path: Path) -> None:
    """Somebody's own compiled functions, called from a plain kernel first."""
    said = run(f"import sys; sys.argv.append('kernel')\n{FOREIGN}", "plain", tmp_path).stdout.split()
    assert said[:10] == ["18.0", "19.0", "4.0", "8.0", "6.0"] * 2


ARMS = """
import hashlib
from benchmarks.bits import cases
for name in ("scene held, exact", "FlexibleArm-v0, random, 11", "FlexibleArm-v0, exact, 33", "linear, elastica"):
    print(name, hashlib.sha256(cases()[name]().tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_arms_move_by_the_same_bits_in_both_modes(tmp_path: Path) -> None:
    told = [run(ARMS, mode, tmp_path).stdout for mode in ("whole", "plain")]
    assert told[0] == told[1] and told[0].count("\n") == 4
