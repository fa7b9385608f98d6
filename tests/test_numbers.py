"""Numbers of the language of kernels at their edges: powers, whole numbers of 64 bits, truth values, narrow arrays."""

import ast
import gc
import math
import re
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import flexarm_env.batch  # noqa: F401  (all kernels that environments call)
from flexarm_env.compiler import EIGHT, UNCOMPILED, kernel, load, max_over_lanes, sincos, stack, uncompiled
from flexarm_env.compiler.decorator import Kernel
from flexarm_env.compiler.kinds import Refused
from flexarm_env.compiler.source import source_of
from tests.processes import python
from tests.refusals import says

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")

FAR, FAR_ARRAY = np.uint64(2**63 + 5), np.array([2**63 + 5, 1], np.uint64)
FLAGS, FAR_TUPLE = (True, False), (np.uint64(2**63 + 5), np.uint64(1))


class Pair(NamedTuple):
    x: float
    n: int


class Held(NamedTuple):
    a: Any
    k: int


# ------------------------------------------------------------------ powers
@kernel
def powers(x, y, a):
    a[0], a[1], a[2], a[3] = x**2, x**-1, x**0.5, x**-2.0
    a[4], a[5], a[6], a[7] = 2.0**x, 0.25**x, x**3, abs(x) ** y


def test_powers_are_those_of_c(rng: np.random.Generator) -> None:
    """And of Python, in every bit: LLVM takes x * x, 1 / x or exp2 for some, whose last bit may be another."""
    compiled, python_s = np.zeros(8), np.zeros(8)
    for x in [1.613685079866832, *rng.uniform(0.0, 9.0, 4000).tolist()]:
        y = float(rng.uniform(-9.0, 9.0))
        powers(x, y, compiled)
        uncompiled(powers)(x, y, python_s)
        assert np.array_equal(compiled, python_s), (x, y)


@pytest.mark.slow
def test_kernels_of_the_package_take_no_squares_by_pow() -> None:
    """x**2 costs more than x * x, and its bits are the C library's; 2**n of a whole n is a shift."""
    found = []
    for function in sorted((one for one in gc.get_objects() if isinstance(one, Kernel)), key=lambda one: one.__name__):
        if function.__module__.startswith("flexarm_env."):
            for node in ast.walk(source_of(function.function).tree):
                if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and ast.unparse(node.left) != "2":
                    found.append(ast.unparse(node))
    assert not found


OF_C = {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "tanh", "hypot", "pow"}
"""Functions whose last bit depends on the C library."""
MARKS = {"kernel", "inlined", "noinline", "entry_point", "superword"}


def of_c(path: Path) -> set[str]:
    """Functions of the C library in the kernels of a file."""
    found = set()
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef):
            marks = {node.id for one in function.decorator_list for node in ast.walk(one) if isinstance(node, ast.Name)}
            names = {ast.unparse(node) for node in ast.walk(function) if isinstance(node, ast.Attribute)}
            if marks & MARKS:
                found |= {name[5:] for name in names if name.startswith("math.")} & OF_C
    return found


def test_the_page_lists_all_functions_of_the_c_library() -> None:
    """Their bits differ between systems: each file with one is listed, with these functions and no other."""
    root = Path(__file__).parents[1]
    section = (root / "docs" / "compiler.md").read_text(encoding="utf-8").split("## Functions of the C library")[1]
    rows = [line.split("|")[1:3] for line in section.split("\nNo kernel")[0].splitlines() if line.startswith("| `")]
    listed = {file: set(re.findall("`(.+?)`", names)) for names, files in rows for file in re.findall("`(.+?)`", files)}
    package = root / "flexarm_env"
    used = {path.relative_to(package).as_posix(): of_c(path) for path in sorted(package.rglob("*.py"))}
    assert {file: names for file, names in used.items() if names} == listed


# ------------------------------------------------------------------ whole numbers
@kernel
def unsigned(u, k):
    return abs(u), u + FAR, u < FAR, FAR_ARRAY[0] - u, FAR_TUPLE[k] - u, abs(FAR)


@kernel
def to_signed(u):
    return int(u) - 5


def test_unsigned_numbers_from_the_middle_on() -> None:
    u = np.uint64(2**63 + 3)
    assert unsigned(u, 0) == (2**63 + 3, 8, True, 2, 2, 2**63 + 5)
    assert to_signed(np.uint64(3)) == -2 and to_signed(u) == 2**63 - 6, "the nearest that there is"


@kernel
def from_float(x):
    return np.uint64(x)


def test_floats_from_the_middle_on_become_unsigned_numbers() -> None:
    """As in NumPy; the signed range ends at 2^63. Beyond 64 bits the nearest that there is; -1.0 as NumPy's."""
    for x in (0.0, 2.7, 2.0**53 + 2.0, 2.0**63 - 1024.0, 2.0**63, 2.0**63 + 4096.0, 2.0**64 - 2048.0):
        assert from_float(x) == int(x)
    assert (from_float(1e300), from_float(np.inf), from_float(np.nan)) == (2**64 - 1, 2**64 - 1, 0)
    assert from_float(-1.0) == 2**64 - 1 and from_float(-1) == 2**64 - 1


@kernel
def steps(first, last):
    n = 0
    for _ in range(first, last, 2**62):
        n += 1
    for _ in range(last, first, -(2**62)):
        n += 10
    return n


@kernel
def any_steps(first, last, step):
    n, total = 0, 0
    for k in range(first, last, step):
        n, total = n + 1, total ^ k
        if n > 100:
            break
    return n, total


@kernel
def threes(first, last):
    n, total = 0, 0
    for k in range(first, last, 3):
        if k == 7:
            continue
        n, total = n + 1, total * 31 % 1000003 + k
    for k in range(last, first, -5):
        n, total = n + 1, total * 31 % 1000003 + k
    return n, total


def test_a_loop_ends_where_the_next_number_has_more_than_64_bits(rng: np.random.Generator) -> None:
    most = 2**63 - 1
    assert steps(0, most) == 22 and steps(-most, most) == 44 and steps(most, 0) == 0
    for first, last, step in [(0, most, 2**62), (-most, most, 2**62), (most, -most, -(2**62) - 1), (0, most, most),
                              (most - 1, most, 1), (-most - 1, -most, 1), (5, 5, 7), (0, 10, 0)]:  # fmt: skip
        expected = list(range(first, last, step)) if step else []
        found = 0
        for k in expected:
            found ^= k
        assert any_steps(first, last, step) == (len(expected), found), (first, last, step)
    for first, last in rng.integers(-30, 30, (200, 2)).tolist():
        assert threes(first, last) == uncompiled(threes)(first, last)


@kernel
def divided(p, q):
    return p / q


def test_whole_numbers_are_divided_as_python_divides_them(rng: np.random.Generator) -> None:
    """Rounded once, however large they are."""
    assert divided(9007199254740993, 3) == 3002399751580331.0
    pairs = rng.integers(-(2**63), 2**63 - 1, (3000, 2)) >> rng.integers(0, 63, (3000, 2))
    odd = [(2**63 - 1, -(2**63)), (-(2**63), 2**63 - 1), (-(2**63), -1), (2**53 + 1, 1), (1, 2**63 - 1), (0, -(2**60))]
    for p, q in [*odd, *pairs.tolist()]:
        if q != 0:
            assert divided(p, q) == p / q == float(Fraction(p, q)), (p, q)
    assert divided(2**60, 0) == math.inf and divided(-3, 0) == -math.inf and math.isnan(divided(0, 0))


# ------------------------------------------------------------------ truth values, narrow arrays
@kernel
def stored(flags, x):
    flags[0] = x


@kernel
def asked(flags, k):
    return flags[0] and not flags[1], flags[0] + 2, 5 if flags[0] else 7, flags[0], FLAGS[k], flags[0] & flags[1]


@kernel
def added(a):
    return a[0] + a[1]


@kernel
def reckoned(a):
    a[2] = a[0] + a[1]
    return a[0] + a[1], a[0] * a[1] - 300, a[0] * 0.1, a[0] < 0.1, a[0] // 3


def test_arrays_of_truth_values_hold_truth_values() -> None:
    flags = np.zeros(2, np.bool_)
    for x, found in ((2, 1), (256, 1), (0, 0), (0.5, 1), (math.nan, 1), (False, 0), (True, 1)):
        for run in (stored, uncompiled(stored)):
            run(flags, x)
            assert flags.view(np.uint8).tolist() == [found, 0], x
    for run in (asked, uncompiled(asked)):
        found = run(flags, 0)
        assert found == (True, 3, 5, True, True, False) and [type(found[k]) for k in (0, 3, 4)] == [bool] * 3
    says("arithmetic of two truth values", lambda: added(flags), Refused)


def test_narrow_arrays_are_read_as_wide_numbers_in_both_modes() -> None:
    """200 + 100 of uint8 is 300, and a float32 is multiplied as the float64 that it is."""
    for array in (np.array([200, 100, 0], np.uint8), np.array([0.1, 0.3, 0.0], np.float32)):
        results = []
        for run in (reckoned, uncompiled(reckoned)):
            own = array.copy()
            results.append((tuple(float(x) for x in run(own)), own.tolist()))
        assert results[0] == results[1]
    held, found = Pair, []
    for run in (kernel(_of_pair), uncompiled(kernel(_of_pair))):
        found.append(run(held(np.array([200, 100], np.uint8), 1)))
    assert found == [300, 300]


def _of_pair(p):
    return p.x[0] + p.x[1]


@kernel
def rounded(x):
    return np.float32(x) * 2.0


def test_nothing_is_reckoned_with_a_narrow_number_by_name() -> None:
    """What np.float32(x) * 2.0 is differs between Python and float64."""
    says("float(x) makes a number of it", lambda: rounded(0.1), Refused)


@pytest.mark.slow
def test_narrow_arrays_where_nothing_is_compiled() -> None:
    lines = (
        "import numpy as np; from tests.test_numbers import added, reckoned, stored; a = np.array([200, 100], np.uint8)"
    )
    lines += "; b = np.zeros(1, bool); stored(b, 256); print(added(a), b.view(np.uint8), added(np.array([True, True])))"
    assert python("-c", lines, FLEXARM_COMPILER="python").stdout.split() == ["300", "[1]", "2"]


# ------------------------------------------------------------------ words of lanes
@kernel
def largest_of(lane, a):
    return max_over_lanes(load(lane, a, 0))


def test_largest_passes_over_nan_in_any_lane() -> None:
    for k in range(8):
        a = np.arange(1.0, 9.0) * -1.0
        a[k] = math.nan
        assert largest_of(EIGHT, a) == (-1.0 if k else -2.0), k
    assert math.isnan(largest_of(EIGHT, np.full(8, math.nan)))
    assert largest_of(EIGHT, np.array([math.nan, *[-math.inf] * 7])) != 0.0
    assert largest_of(EIGHT, np.full(8, -math.inf)) == -math.inf


@kernel
def sine(x):
    return sincos(x)


def test_sines_of_large_angles(rng: np.random.Generator) -> None:
    """Within |x| 2e-16 below 1e15, NaN beyond: no number that is not a sine."""
    for x in (10.0 ** rng.uniform(6.0, 15.0, 2000)).tolist():
        for found in (sine(x), sine(-x), uncompiled(sine)(x)):
            assert abs(abs(found[0]) - abs(math.sin(x))) < 2e-16 * x and abs(found[1] - math.cos(x)) < 2e-16 * x
            assert max(map(abs, found)) < 1.0 + 1e-15
    for x in (1e15, 1e16, 1e22, 1e300, math.inf, math.nan):
        assert all(map(math.isnan, (*sine(x), *sine(-x), *uncompiled(sine)(x)))), x


LARGE = (0,) * 1_100_000
HALF = (0,) * 300_000


@kernel
def too_large(x):
    a = stack((0,), LARGE)
    a[0] = x
    return a[0]


@kernel
def half(x):
    a = stack((0,), HALF)
    a[0] = x
    return a[0]


@kernel
def halves(x):
    a = stack((0,), HALF)
    a[0] = x
    return half(a[0])


def test_room_on_the_stack_is_bounded() -> None:
    """Refused, with its line, where it would end the process; what a kernel and those that it calls have is summed."""
    says("1100000 numbers on the stack", lambda: too_large(1.0), Refused)
    says("test_numbers.py:", lambda: too_large(1.0), Refused)
    assert half(2.0) == 2.0
    says("600000 numbers on the stack", lambda: halves(1.0), Refused)


# ------------------------------------------------------------------ names and arguments
@kernel
def hypot(x):
    return math.hypot(x, 4.0)


@kernel
def sin(x):
    return math.sin(x)


@kernel
def malloc(x):
    return x + 1.0


@kernel
def table0(k):
    return (1.0, 2.0, 4.0)[k] + malloc(sin(0.0))


def test_kernels_may_have_names_of_the_c_library() -> None:
    assert hypot(3.0) == 5.0 and sin(1.0) == math.sin(1.0) and malloc(1.0) == 2.0 and table0(2) == 5.0


@kernel
def given(p, x):
    return p, x


def test_a_named_tuple_that_is_given_is_returned() -> None:
    assert given(Pair(1.5, 2), 3.0) == (Pair(1.5, 2), 3.0) and type(given(Pair(1.5, 2), 3.0)[0]) is Pair
    says("an array as a result", lambda: given(Held(np.ones(3), 2), 3.0), Refused)
    says("test_numbers.py:", lambda: given(Held(np.ones(3), 2), 3.0), Refused)


@kernel
def write(p):
    p.a[p.k] = 5.0


@kernel
def lengths(p):
    return len(p.a), p.a.shape


def test_arrays_of_a_named_tuple_as_they_are_at_each_call() -> None:
    """One that has become read-only is not written to; one of another shape has that shape."""
    held = Held(np.zeros(6), 1)
    write(held)
    held.a.flags.writeable = False
    says("read-only", lambda: write(held), Refused)
    held.a.flags.writeable = True
    write(held)
    held.a.shape = (2, 3)
    assert lengths(held) == (2, (2, 3))


@pytest.mark.slow
def test_a_processor_that_does_not_exist(tmp_path: Path) -> None:
    """Refused with a sentence, where LLVM ends the process."""
    line = "from tests.test_numbers import sin; print(sin(0.0))"
    done = python("-c", line, FLEXARM_CPU="nonsense", FLEXARM_CACHE_DIR=str(tmp_path), code=1)
    assert "ValueError: FLEXARM_CPU = 'nonsense': must be a processor's name" in done.stderr
    assert python("-c", line, FLEXARM_CPU="x86-64-v2", FLEXARM_CACHE_DIR=str(tmp_path)).stdout == "0.0\n"


FORK = """
import os, threading, time
from flexarm_env.compiler import kernel, program
inside, go = threading.Event(), program.machine_code
def slow(*items):
    inside.set()
    time.sleep(1.0)
    return go(*items)
@kernel
def f(x):
    return x + 1.0
@kernel
def g(x):
    return x + 2.0
@kernel
def h(x):
    return x + 3.0
h(1.0)
program.machine_code = slow
thread = threading.Thread(target=f, args=(1.0,))
thread.start()
inside.wait()
program.machine_code = go
if os.fork() == 0:
    print(g(1.0), flush=True)
    os._exit(0)
os.wait()
thread.join()
print(f(1.0))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork")
def test_a_fork_beside_a_compilation(tmp_path: Path) -> None:
    """The child compiles as well: it waits for no thread that it does not have."""
    (tmp_path / "script.py").write_text(FORK, encoding="utf-8")
    done = python(tmp_path / "script.py", FLEXARM_CACHE_DIR=str(tmp_path / "cache"), timeout=60.0)
    assert done.stdout.split() == ["3.0", "2.0"]
