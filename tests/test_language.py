"""The language of kernels: what it means is what Python means, bit for bit, and what it does not have is refused."""

import importlib.util
import linecache
import math
import re
import threading
import types
from pathlib import Path
from random import Random
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np
import pytest

from flexarm_env.compiler import EIGHT, SINGLE, UNCOMPILED, dual, front, kernel, load, program, store, uncompiled
from flexarm_env.compiler.kinds import Refused
from flexarm_env.layout import Field, Layout
from tests.drawn_kernels import FLOATS, LENGTH, WHOLES, Draw
from tests.processes import ROOT
from tests.refusals import refusal, refuses, says

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")

MODULES, KERNELS = 40, 25
"""How many modules are drawn in a run, of how many kernels each."""

SPECIAL = (0.0, -0.0, 1.0, -2.5, 0.3, 7.0, 1e300, -1e-310, math.inf, -math.inf, math.nan)


class Pair(NamedTuple):
    x: float
    n: int


def module(folder: Path, text: str, name: str = "kernels") -> types.ModuleType:
    """A module of such text, imported from a file of its own."""
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def bits(x: np.ndarray) -> np.ndarray:
    """Numbers by their bits; one NaN is as good as another."""
    return np.where(np.isnan(x), np.nan, x).view(np.int64)


# ------------------------------------------------------------------ what it means
@pytest.mark.parametrize("modules", [MODULES // 10, pytest.param(MODULES, marks=pytest.mark.slow)])
def test_a_thousand_kernels_mean_what_python_means(
    modules: int, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drawn anew by each seed of Hypothesis (CI), the same ones on a developer's machine, a tenth by default. Functions
    are large from few instructions on, so that half of the kernels are looked through for what is alike."""
    monkeypatch.setattr(front, "LARGE", 40)
    seed = request.config.option.hypothesis_seed or 0
    for k in range(modules):
        text = Draw(seed + k, KERNELS).text()
        compare(module(tmp_path, text, f"drawn_{k}").main, text, Random(seed + k))
    print(f"{modules * KERNELS} kernels from seed {seed} on: the same bits as by Python")


def compare(main: Any, text: str, random: Random) -> None:
    for _ in range(6):
        x, y = (random.choice([*SPECIAL, random.uniform(-3.0, 3.0)]) for _ in range(2))
        pool = [*SPECIAL, *[random.uniform(-2.0, 2.0) for _ in range(20)]]
        i, j = random.randint(-50, 50), random.randint(-5, 5)
        a = np.array([random.choice(pool) for _ in range(LENGTH)])
        m = np.array([random.randint(-20, 20) for _ in range(LENGTH)])
        g = np.array([random.uniform(-2.0, 2.0) for _ in range(12)]).reshape(3, 4)
        found = []
        for run in (uncompiled(main), main):
            floats, wholes = np.zeros((KERNELS, FLOATS)), np.zeros((KERNELS, WHOLES), np.int64)
            with np.errstate(all="ignore"):
                run(x, y, i, j, a.copy(), a, m.copy(), m, g.copy(), g, np.zeros(1, np.int64), floats, wholes)
            found.append(np.hstack([bits(floats), wholes]))
        wrong = np.flatnonzero((found[0] != found[1]).any(axis=1))
        if len(wrong):
            first = text.index(f"def drawn{wrong[0]}(")
            source = text[first : text.index("\n\n\n", first)]
            python, compiled = (rows[wrong[0]] for rows in found)
            pytest.fail(f"{source}\nof {x, y, i, j, a, m, g}: Python {python}, compiled {compiled}")


ROWS = """
from flexarm_env.compiler import noinline, kernel, superword


@superword
def rows(a, b):
    b[0] = a[0] / a[4] + a[0] * a[1]
    b[1] = a[1] / a[5] + a[1] * a[2]
    b[2] = a[2] / a[6] + a[2] * a[3]
    b[3] = a[3] / a[7] + a[3] * a[0]


@noinline
def other(a, b):
    b[4] = a[0] + b[0]


@kernel
def main(a, b):
    rows(a, b)
    other(a, b)
"""


def test_numbers_treated_alike_are_looked_for_in_superword_kernels_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the bits are Python's."""
    texts, made = list[str](), program.machine_code
    monkeypatch.setattr(program, "machine_code", lambda text, machine: texts.append(text) or made(text, machine))
    monkeypatch.setattr(front, "LARGE", 10)
    main = module(tmp_path, ROWS, f"rows_{uuid4().hex}").main
    a, found = np.random.default_rng(4).uniform(-1.0, 1.0, 8), [np.zeros(5), np.zeros(5)]
    main(a, found[0])
    uncompiled(main)(a, found[1])
    assert np.array_equal(*found)
    spared = {name: front.SPARED in line for line in texts[0].splitlines() if line.startswith("define")
              for name in ("rows", "other") if f'@"kernel.{name}"(' in line}  # fmt: skip
    assert spared == {"rows": False, "other": True}


@kernel
def odd_wholes(p, q, w):
    w[0], w[1], w[2], w[3] = p // q, p % q, p << q, p >> q
    w[4], w[5] = p * 2, -p


@kernel
def odd_numbers(x, y, a):
    a[0], a[1], a[2], a[3] = x / y, x // y, x % y, math.sqrt(x)
    return int(x), math.floor(x), math.ceil(y)


@kernel
def rounds(first, last, step):
    n = 0
    for _k in range(first, last, step):
        n += 1
    return n


def test_where_python_raises() -> None:
    """What the compiler's page says of division by 0, of shifts and of what 64 bits do not hold."""
    w, least, most = np.zeros(6, np.int64), -(2**63), 2**63 - 1
    for p, q, expected in [
        (7, 0, (0, 0, 7, 7, 14, -7)), (least, -1, (least, 0, 0, -1, 0, least)), (-5, 64, (-1, 59, 0, -1, -10, 5)),
        (most, 1, (most, 0, -2, most // 2, -2, -most)), (-1, 200, (-1, 199, 0, -1, -2, 1)),
    ]:  # fmt: skip
        odd_wholes(p, q, w)
        assert tuple(w) == expected, (p, q)
    a = np.zeros(4)
    for x, y, whole, expected in [
        (1.0, 0.0, (1, 1, 0), (math.inf, math.nan, math.nan, 1.0)),
        (math.nan, 1.0, (0, 0, 1), (math.nan,) * 4),
        (-1e300, math.inf, (least, least, most), (-0.0, -1.0, math.inf, math.nan)),
        (math.inf, -0.5, (most, most, 0), (-math.inf, math.nan, math.nan, math.inf)),
    ]:
        assert odd_numbers(x, y, a) == whole
        assert np.array_equal(bits(a), bits(np.array(expected))), (x, y, a)
    assert rounds(0, 9, 0) == rounds(9, 0, 0) == 0 and rounds(9, 0, -4) == 3


# ------------------------------------------------------------------ what is refused
HEAD = "import math\nimport numpy as np\nfrom typing import NamedTuple\nfrom flexarm_env.compiler import *\n"
HEAD += "class Pair(NamedTuple):\n    x: float\n    n: int\n"
HEAD += "DUAL = dual(SINGLE)\n"
HEAD += "SINGLE_PRECISION, SMALL, TABLE, LIST = np.float32(0.1), np.int32(3), np.arange(3.0), [1.0, 2.0]\n"
HEAD += "ODD, TUPLE = np.arange(3, dtype=np.int32), (1.0, 2)\n"
HEAD += "def plain(x):\n    return x\n@kernel\ndef one(x, y=1.0):\n    return x * y\n"
HEAD += "@kernel\ndef shared(x, y=[]):\n    return x\n@kernel\ndef deeper(t):\n    return deeper((t, 1.0))\n"


def listed() -> list[tuple[str, str]]:
    """Rows of the table of refusals of the page: a line, and what is said of it."""
    text = (ROOT / "docs" / "compiler.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)` \| ([^|]+) \|$", text.split("## Rejected constructs")[1].split("\n## ")[0], re.M)
    return [(line, said.replace("`", "").strip()) for line, said in rows]


SEVERAL = [
    ("for k in range(n):\n        x += 1.0\n    else:\n        x = 0.0", "no else"),
    ("while x > 0.0:\n        x -= 1.0\n    else:\n        x = 0.0", "no else"),
    ("try:\n        x = 1.0\n    except ValueError:\n        pass", "try is no statement"),
    ("match n:\n        case 1:\n            x = 1.0", "match is no statement"),
    ("def inner():\n        return x", "functiondef is no statement"),
    ("class Inner:\n        pass", "classdef is no statement"),
    ("if x > 0.0:\n        y = 1.0\n    x = y", "'y' may not have a value"),
    ("for k in range(n):\n        y = x\n    x = y", "'y' may not have a value"),
    ("for k in range(n):\n        if k > 0:\n            x = y\n        y = x", "'y' may not have a value"),
    ("one = one(x)", "'one' may not have a value"),
    ("t = None\n    for k in range(n):\n        t = x", "'t' changes in the loop"),
    ("if x > 0.0:\n        return None\n    return x", "None in one place"),
    ("if x > 0.0:\n        t = (x, x)\n    else:\n        t = (x, x, x)\n    x = t[0]", "'t' is"),
    ("if x > 0.0:\n        x = a", "'x' is"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "said"), [*listed(), *SEVERAL])
def test_refused(line: str, said: str, tmp_path: Path) -> None:
    """With file, line, and the line itself."""
    text = f"{HEAD}@kernel\ndef f(x, n, a, m, g, p, lane):\n    {line}\n"
    made = module(tmp_path, text)
    items = (1.0, 2, np.ones(16), np.ones(3, np.int64), np.ones((2, 2)), Pair(1.0, 2), EIGHT)
    told = refusal(lambda: made.f(*items), Refused)
    assert said in told.replace("`", ""), told
    place = re.match(r"(.*):(\d+), in (\w+): ", told)
    assert place is not None and place[1] == made.__file__, told
    assert told.endswith("\n    " + text.splitlines()[int(place[2]) - 1].strip()), told


def test_the_page_lists_refusals() -> None:
    assert len(listed()) > 60


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("f = kernel(lambda x: x)", "a lambda"),
        ("@kernel\nasync def f(x):\n    return x", "is async"),
        ("@kernel\ndef f(x, *rest):\n    return x", "a kernel's arguments"),
        ("@kernel\ndef f(x, **rest):\n    return x", "a kernel's arguments"),
        ("@kernel\ndef f(x, /):\n    return x", "a kernel's arguments"),
        ("@kernel\ndef f(x, *, y=1.0):\n    return x", "a kernel's arguments"),
        ("import functools\ndef other(g):\n    @functools.wraps(g)\n    def run(x):\n        return g(x)\n"
         "    return run\n"
         "@kernel\n@other\ndef f(x):\n    return x", "another decorator"),
        ("@kernel\ndef f(x):\n    yield x", "Yield is no expression"),
        ("f = kernel(math.sin)", "a kernel is made of a function"),
        ("f = kernel(Pair)", "a kernel is made of a function"),
        ("def make():\n    @kernel\n    def f(x):\n        return x + late\n    return f\n    late = 1.0\nf = make()",
         "'late' of the function around it"),
    ],
)  # fmt: skip
def test_no_kernel_is_made_of_these(text: str, said: str, tmp_path: Path) -> None:
    says(said, lambda: module(tmp_path, f"{HEAD}{text}\n").f(1.0), Refused)


def test_no_text(tmp_path: Path) -> None:
    """A kernel of text that nobody keeps is refused; one of a cell of a notebook, or of a layout, is like any other."""
    text = "@kernel\ndef f(x):\n    if x > 1.0:\n        return x * 2.0\n    return [x]\n"
    scope: dict[str, Any] = {"kernel": kernel, "__name__": "nowhere"}
    exec(compile(text, "<nowhere>", "exec"), scope)
    refuses("source text cannot be had", lambda: scope["f"](2.0), Refused)
    cell = "<cell 7>"
    exec(compile(text, cell, "exec"), scope)
    linecache.cache[cell] = len(text), None, text.splitlines(keepends=True), cell
    refuses(r"<cell 7>:5, in f: .*\n    return \[x\]", lambda: scope["f"](2.0), Refused)
    text = text.replace("[x]", "x")
    exec(compile(text, cell := "<cell 8>", "exec"), scope)
    linecache.cache[cell] = len(text), None, text.splitlines(keepends=True), cell
    assert scope["f"](2.0) == 4.0
    places = kernel(Layout("Block", "n", Field("c", ("n",), "", ""), Field("d", ("n",), "", "")).offsets)
    assert tuple(places(2, 5)) == (2, 7, 12)


@pytest.mark.parametrize(
    ("new", "changed"),
    [("x * 2.0", False), ("x * 3.0", True), ("x * 2", True), ("y * 2.0", True), ("x * -2.0", True), ("(x", True)],
)
def test_a_file_that_changed(new: str, changed: bool, tmp_path: Path) -> None:
    """Its text is not what is running; a comment or what describes the kernel may change."""
    text = HEAD + '@kernel\ndef f(x, y):\n    """{}"""\n    return {}\n'
    made = module(tmp_path, text.format("One.", "x * 2.0"))
    (tmp_path / "kernels.py").write_text(text.format("Another.", new) + "# later\n", encoding="utf-8")
    linecache.checkcache()
    if changed:
        refuses("has changed", lambda: made.f(2.0, 3.0), Refused)
    else:
        assert made.f(2.0, 3.0) == 4.0


def test_kernels_of_functions_and_classes() -> None:
    """They know the numbers around them, and may have lines at the margin."""

    def made(c, d):
        @kernel
        def f(x):
            """A description
            at the margin."""
            # a remark at the margin
            return c * x + d[1]

        return f

    class Room:
        @kernel
        def f(x):  # noqa: N805
            return x + 1.0

    assert made(2.0, (0.0, 1.0))(3.0) == 7.0 and made(3.0, (0.0, 2.0))(3.0) == 11.0
    assert Room.f(1.0) == 2.0 and Room().f(1.0) == 2.0


def test_names_of_the_language_can_be_others(tmp_path: Path) -> None:
    """A name is what Python finds under it: an argument, a global, then what is built in."""
    text = HEAD + "@kernel\ndef min(x, y):\n    return x + y\n@kernel\ndef f(x, range, abs=3.0):\n    len = x\n"
    text += "    return min(x, range) + abs + len\n@kernel\ndef g(sqrt=math.sqrt, x=4.0):\n    return sqrt(x)\n"
    made = module(tmp_path, text)
    assert made.f(1.0, 2.0) == 7.0 == uncompiled(made.f)(1.0, 2.0)
    assert made.g() == 2.0


# ------------------------------------------------------------------ calls from Python
@kernel
def summed(a, x, n):
    total = 0.0
    for k in range(len(a)):
        total += a[k]
    return total + x, n


@kernel
def written(a):
    a[0] = 5.0


@kernel
def shaped(g):
    return g.shape[0], g.shape[1]


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.ones(8)[::2], "C-contiguous"), (np.ones((2, 3)).T, "C-contiguous"), (np.array(1.0), "one dimension"),
        (np.ones(3, np.int32), "<i4"), (np.ones(3, complex), "c16"), (np.ones(3, object), "O"),
        (np.ones(3).astype(">f8"), ">f8"), (np.frombuffer(bytes(25), np.uint8)[1:].view(np.float64), "strides"),
        (np.ma.masked_array(np.ones(3)), "MaskedArray"), ([1.0], "list"), ("text", "str"), (1j, "complex"),
    ],
)  # fmt: skip
def test_arrays_that_are_not_taken(array: Any, said: str) -> None:
    refuses(said, lambda: summed(array, 0.0, 1), TypeError)


def test_arguments() -> None:
    """Numbers of all names, arrays of no length, of a file, read-only."""
    a = np.arange(3.0)
    assert summed(a, 1, True) == (4.0, True) and summed(a[:0], np.float32(0.5), np.int8(-3)) == (0.5, -3)
    assert summed(a, n=np.uint64(2**64 - 1), x=0.0)[1] == 2**64 - 1
    for big in (2**63, -(2**63) - 1, 10**30):
        with pytest.raises(OverflowError, match="64 bits"):
            summed(a, 0.0, big)
    assert shaped(np.ones((0, 3))) == (0, 3)
    a.flags.writeable = False
    assert summed(a, 0.0, 1) == (3.0, 1)
    refuses("read-only", lambda: written(a), Refused)
    assert a[0] == 0.0
    for items, named in [((a,), {}), ((a, 1.0, 2, 3), {}), ((a, 1.0), {"m": 2}), ((a, 1.0, 2), {"x": 1.0})]:
        with pytest.raises(TypeError, match="summed"):
            summed(*items, **named)


@kernel
def halves(lane, a, b):
    store(b, 0, load(lane, a, 0) * 0.5)


@kernel
def second(pair):
    return pair[1]


@kernel
def seconds():
    return second((1, True)), second((1, 1)), second((0, 0.0)), second((0, -0.0))


def test_equal_is_not_the_same() -> None:
    """Tuples that Python finds equal are told apart by what is in them."""
    assert list(map(repr, seconds())) == ["True", "1", "0.0", "-0.0"]


def test_lanes_are_known() -> None:
    """The same source under each tag, and a number with tangents."""
    for lane in (SINGLE, EIGHT, dual(SINGLE, 2), dual(EIGHT)):
        a = np.arange(1.0, 1.0 + len(lane))
        b = np.zeros(len(lane))
        halves(lane, a, b)
        assert np.array_equal(b, a * 0.5)


def test_threads_compile_and_call_at_once() -> None:
    """The first calls of one kernel from several threads, for two kinds of arguments."""

    @kernel
    def f(a, x):
        for k in range(len(a)):
            a[k] += x
        return x

    found: list[Any] = []

    def work(k: int) -> None:
        for _ in range(50):
            a = np.zeros(100)
            x = f(a, float(k)) if k % 2 else f(a, k)
            found.append(x == k and bool(np.all(a == k)))

    threads = [threading.Thread(target=work, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [True] * 300


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork")
def test_a_forked_process_goes_on(tmp_path: Path) -> None:
    """It calls what was compiled before, and compiles."""
    from tests.processes import python

    text = HEAD + "@kernel\ndef f(x):\n    return x * 2\n"
    text += "import os\nprint(f(1.0), flush=True)\nif os.fork() == 0:\n"
    text += "    print(f(2.0), f(3), flush=True)\n    os._exit(0)\n"
    text += "os.wait()\n"
    (tmp_path / "script.py").write_text(text, encoding="utf-8")
    done = python(tmp_path / "script.py", FLEXARM_CACHE_DIR=str(tmp_path / "cache"))
    assert done.stdout.split() == ["2.0", "4.0", "6"]
