"""Kernels as their users meet them: called from Python and from kernels, from disk, beside others' functions."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED, Family, kernel, uncompiled
from tests.processes import python
from tests.refusals import refuses

compiled_only = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")


@kernel
def inner(x):
    return x * x + 1.0


@kernel
def middle(x):
    total = 0.0
    for k in range(x.shape[0]):
        total += inner(x[k])
    return total


@kernel
def outer(x):
    return middle(x) + x[0]


class Pair(NamedTuple):
    first: Any
    second: Any


@kernel
def swapped(pair, factor=2.0):
    return Pair(pair.second * factor, pair.first)


def test_called_from_python_and_from_kernels() -> None:
    x = np.array([1.0, 2.0, 3.0])
    assert outer(x) == 18.0 and middle(x) == 17.0 and inner(2.0) == 5.0 and outer(x) == 18.0
    assert swapped(Pair(1.0, 3.0)) == Pair(6.0, 1.0) and type(swapped(Pair(1.0, 3.0))) is Pair
    assert swapped(Pair(1.0, 3), factor=1.5) == Pair(4.5, 1.0)
    assert uncompiled(outer)(x) == 18.0


@compiled_only
def test_one_program_for_each_kind_of_arguments() -> None:
    before = dict(middle.forms)
    for x in (np.ones(2), np.ones(5), np.ones(5)):
        middle(x)
    assert len(middle.forms) <= len(before) + 1
    refuses("C-contiguous", lambda: middle(np.ones(6)[::2]), TypeError)
    refuses("argument 1 of middle", lambda: middle(object()), TypeError)


@compiled_only
def test_from_the_disk(tmp_path: Path) -> None:
    """A second process runs what the first has compiled, and compiles nothing."""
    (tmp_path / "kept.py").write_text(
        "from flexarm_env.compiler import kernel\n\n\n@kernel\ndef twice(x):\n    return 2.0 * x[1]\n"
    )
    lines = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import numpy as np; from kept import twice"
    lines += "; print(twice(np.arange(3.0)), *(form.made for form in twice.forms.values()))"
    told = [python("-c", lines, FLEXARM_CACHE_DIR=str(tmp_path / "objects")).stdout.split() for _ in range(2)]
    assert told == [["2.0", made] for made in ("True", "False")]


# ------------------------------------------------------------------------------ others' functions
class Elsewhere:
    """What other compilers make of a function: callable, with Python's own behind it."""

    def __init__(self, function: Any) -> None:
        self.py_func, self.__name__ = function, function.__name__

    def __call__(self, *items: Any) -> Any:
        return self.py_func(*items)


@Elsewhere
def foreign(x):
    return x / 3.0


def bare(x):
    return x / 3.0


@kernel
def calls_foreign(x):
    return foreign(x) + 1.0


@kernel
def calls_bare(x):
    return bare(x) + 1.0


@compiled_only
@pytest.mark.parametrize(
    ("caller", "sentence"),
    [
        (calls_foreign, "foreign is compiled by another compiler: a kernel calls kernels, so write @kernel above it"),
        (calls_bare, "bare is no kernel and no word of the language: write @kernel above it"),
    ],
)
def test_functions_that_are_no_kernels_are_refused(caller: Any, sentence: str) -> None:
    """With file, line and what to write; called from Python they stay what they are."""
    line = caller.function.__code__.co_firstlineno + 2
    with pytest.raises(TypeError, match="is") as told:
        caller(1.0)
    text = str(told.value)
    assert sentence in text and f"test_parts.py:{line}, in {caller.__name__}" in text
    assert text.splitlines()[-1].strip() == f"return {caller.__name__.replace('calls_', '')}(x) + 1.0"
    assert foreign(6.0) == bare(6.0) == 2.0


# -------------------------------------------------------------------------------------- two modes
WORDS = """
from typing import NamedTuple
import numpy as np
from flexarm_env.compiler import *

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

@kernel
def one(x):
    if isinstance(x, tuple):
        return x[0]
    return x

@unrolled
@kernel
def squares(lane, model, out):
    w = stack(lane, (0, 0))
    for k in range(size(model.n)):
        store(w, 0, load(lane, model.x, k) * 1.1)
        s, c = sincos(load(lane, w, 0))
        store(out, k, load(lane, out, k) + select_lt(s, c, s / 3.0, square_root(absolute(c))) * size(model.n))

@traced
def both(lane, order, x):
    return [helped(load(lane, x, k)) for k in (0, len(order))]

def helped(x):
    return -x * 0.3 + round_even(x)

@kernel
def everything(lane, model, out):
    squares(lane, model, out)
    first, second = both(lane, (0,), out)
    store(out, 0, first * factor(lane, model) - maximum(second, first))
    out[out.shape[0] - 1] = max_over_lanes(first) + one(2.5) + one((1.5, 0)) + len(out[1:3])

for lane, kind, n in ((SINGLE, Left, 2), (SINGLE, Right, (0, 0)), (WIDEST, Right, (0, 0))):
    x, out = np.random.default_rng(1).normal(size=24), np.ones(24)
    if lane != SINGLE:
        wide, flat = np.repeat(x, 8), np.ones(24 * 8)
        everything(lane, kind(n, wide), flat)
        out[:-1] = flat[:-8:8]  # the last number was one of all lanes
        out[-1] = flat[-1]
    else:
        everything(lane, kind(n, x), out)
    print(out.tobytes().hex())

@kernel
def step(address, first, last):
    p = dereference(address)
    for i in range(first, last):
        p.x[i] += p.number * p.z[i]
    return last - first

same = np.arange(100.0)
placed = Placed(World(np.zeros(100), same, 2.0, same))
other = np.arange(100.0) + 1.0
placed.replace("z", other, other.ctypes.data)
compiled = entry(step, placed, 0, 0)
print(compiled(placed.address, 0, 10), placed.value.x[:11])
print(compiled(placed.address, 10, 100), placed.value.x)
"""
"""Every word of the compiler; two fields of `Placed` share an array, of which one is then replaced."""


def test_every_word_gives_the_same_bits_uncompiled(tmp_path: Path) -> None:
    script = tmp_path / "words.py"
    script.write_text(WORDS, encoding="utf-8")
    own = {"FLEXARM_CACHE_DIR": str(tmp_path)}
    told = [python(script, FLEXARM_COMPILER=mode, **own).stdout for mode in ("llvm", "python")]
    assert told[0] == told[1] and "[ 2.  4.  6." in told[0], "the array that was put in the place of z is read"


@pytest.mark.slow
def test_nothing_loads_another_compiler(tmp_path: Path) -> None:
    """Numba least of all, by which earlier releases were compiled; `tests.versions` tries where it is not installed."""
    lines = "import sys, gymnasium as gym, flexarm_env; from flexarm_env import linear, named, simulate"
    lines += "; env = gym.make('FlexibleArm-v0'); env.reset(seed=0); env.step(env.action_space.sample())"
    lines += "; simulate(named('robot_arm_motion'), duration=0.01)"
    lines += "; print('llvmlite' in sys.modules, [m for m in sys.modules if m.split('.')[0] in ('numba', 'cffi')])"
    assert python("-c", lines).stdout.strip() == "True []"


def test_a_kernel_under_no_functions_name_is_refused() -> None:
    """It would never be called."""
    family = Family("model")
    family.function("value", "lane, model")
    with pytest.raises(TypeError, match=r"'worth' is no function of the family: these are value"):
        family.register(tuple, worth=lambda lane, model: 1.0)
