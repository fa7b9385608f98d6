"""Arrays of lanes: `x[k]`, `x[k] = value` and slices mean what load and store mean, in every mode of a kernel."""

import ast
import re
import types
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from flexarm_env.compiler import (
    EIGHT,
    SINGLE,
    UNCOMPILED,
    Lanes,
    dual,
    kernel,
    program,
    stack,
    traced,
    uncompiled,
    unrolled,
    vjp_of,
)
from flexarm_env.compiler.kinds import Refused
from flexarm_env.compiler.lane_arrays import is_lanes, lane_fields, lane_parameters
from tests.refusals import refuses
from tests.test_architecture import PACKAGE as NAME
from tests.test_architecture import ROOT
from tests.test_language import module

TAGS = (SINGLE, EIGHT, dual(SINGLE, 2), dual(EIGHT))
PACKAGE = ROOT / NAME
compiled = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")


class Work(NamedTuple):
    q: Lanes
    v: Lanes
    plain: np.ndarray


class Both(NamedTuple):
    work: Work
    more: Lanes


class Model(NamedTuple):
    n: tuple[int, ...]


HEAD = """
from typing import NamedTuple
import numpy as np
from flexarm_env.compiler import *

class Work(NamedTuple):
    q: Lanes
    v: Lanes

"""
BY_INDEX = """@kernel
def main(lane, n, x: Lanes, w: Work, share):
    for k in range(n):
        y = x[k] * share
        w.q[k] = w.v[k] - y * x[k + 1]
        x[k] = w.q[k] * w.v[k] + y
        w.v[k] = w.v[k] + y
    tail = x[2:]
    tail[0] = x[0]
    s = stack(lane, (0, 0))
    s[0] = share
    x[1] = s[0]
"""
BY_WORDS = """@kernel
def main(lane, n, x, w, share):
    for k in range(n):
        y = load(lane, x, k) * share
        store(w.q, k, load(lane, w.v, k) - y * load(lane, x, k + 1))
        store(x, k, load(lane, w.q, k) * load(lane, w.v, k) + y)
        store(w.v, k, load(lane, w.v, k) + y)
    tail = x[2 * len(lane) :]
    store(tail, 0, load(lane, x, 0))
    s = stack(lane, (0, 0))
    store(s, 0, share)
    store(x, 1, load(lane, s, 0))
"""


@compiled
@pytest.mark.parametrize("lane", TAGS, ids=len)
def test_indices_are_loads_and_stores(
    lane: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """LLVM gets the same loads, stores and operations; only addresses may be computed at another place."""
    texts, made = list[str](), program.machine_code
    monkeypatch.setattr(program, "machine_code", lambda text, machine: texts.append(text) or made(text, machine))
    found = []
    for name, source in (("by_index", BY_INDEX), ("by_words", BY_WORDS)):
        kernels = module(tmp_path, HEAD + source, f"{name}_{len(lane)}")
        x, q, v = (np.arange(1.0, 1.0 + 4 * len(lane)) + k for k in range(3))
        kernels.main(lane, 3, x, kernels.Work(q, v), 0.5)
        found.append(np.hstack([x, q, v]))
    assert np.array_equal(*found)
    first, second = (
        sorted(re.findall(r"(?:= |^  )(load|store|f\w+|shuffle\w+|insert\w+|br|select)", text, re.M))
        for text in texts
        if "kernel.main" in text
    )
    assert first == second


@kernel
def parts(lane, x: Lanes, w: Work, y, out):
    """Other names, slices, tuples and named tuples of lane arrays; y and w.plain hold numbers."""
    a = x[1:]
    b, c = a[:2], w.q
    q, v, _ = w
    b[0] = a[1] + q[0]
    v[0], c[1] = b[1], 7.0
    z: Lanes = y[0:]
    z[0] = x[0]
    inner = Both(w, x).work
    inner.v[1] = 3.0
    w.plain[0], w.plain[1] = len(a), x.shape[0]
    out[0] = len(y)


@pytest.mark.parametrize("lane", TAGS[:1] if UNCOMPILED else TAGS, ids=len)
def test_parts_of_lane_arrays(lane: tuple[int, ...]) -> None:
    n = len(lane)
    x, q, v, y = (np.arange(4.0 * n) + 100 * k for k in range(4))
    plain, out = np.zeros(2), np.zeros(1)
    rows = [a.copy().reshape(4, n) for a in (x, q, v, y)]
    parts(lane, x, Work(q, v, plain), y, out)
    assert tuple(plain) == (3.0, 4.0) and out[0] == 4 * n
    rows[0][1] = rows[0][2] + rows[1][0]
    rows[2][0] = rows[0][2]
    values = n if n in (1, 8) else n // (3 if n == 3 else 2)
    for row, number in ((rows[1], 7.0), (rows[2], 3.0)):
        row[1] = np.where(np.arange(n) < values, number, 0.0)
    rows[3][0] = rows[0][0]
    for a, row in zip((x, q, v, y), rows, strict=True):
        assert np.array_equal(a, row.ravel())


@kernel
def sums(lane, n, x: Lanes, out: Lanes, up):
    """A name that begins as a number and becomes lanes, one that is a number on one way, and a constant."""
    total = 0.0
    for k in range(n):
        total = total + x[k]
    if up:
        first = 1.0
    else:
        first = x[0]
    out[0], out[1], out[2] = total, first, 2.0


@pytest.mark.parametrize("lane", TAGS[:1] if UNCOMPILED else TAGS[:2], ids=len)
def test_numbers_widen_where_they_meet_lanes(lane: tuple[int, ...]) -> None:
    n = len(lane)
    x = np.random.default_rng(3).normal(size=(5, n))
    for up in (True, False):
        out = np.zeros((3, n))
        flat = out.ravel()
        sums(lane, 5, x.ravel(), flat, up)
        expected = ((((0.0 + x[0]) + x[1]) + x[2]) + x[3]) + x[4]
        assert np.array_equal(flat.reshape(3, n), [expected, np.full(n, 1.0) if up else x[0], np.full(n, 2.0)])


@traced
def straight(lane, x: Lanes, w: Work, table):
    room = stack(lane, (0, 0))
    room[0] = 1.0
    room[1] = x[1] * table[2]
    for k in range(2):
        x[k] += room[k]
    fill_first(lane, Work(w.q, w.v, table))
    return x[0], 1.0


@kernel
def fill_first(lane, w: Work):
    w.q[0] = twice_first(lane, w.v, w.plain)


def twice_first(lane, v: Lanes, table):
    return v[0] * table[0] + v[0] * table[0]


@unrolled
@kernel
def sized(lane, model, x: Lanes):
    for k in range(len(model.n)):
        x[k] *= 2.0


@kernel
def run_straight(lane, model, x: Lanes, w: Work, table):
    a, b = straight(lane, x, w, table)
    x[2] = a + b
    sized(lane, model, x)


@pytest.mark.parametrize("lane", TAGS[:1] if UNCOMPILED else TAGS[:2], ids=len)
def test_straight_line_code(lane: tuple[int, ...]) -> None:
    n = len(lane)
    x, q, v, table = np.arange(3.0 * n), np.zeros(n), np.arange(n) + 2.0, np.array([3.0, 4.0, 5.0])
    rows = x.reshape(3, n).copy()
    run_straight(lane, Model((0, 0)), x, Work(q, v, table), table)
    rows[1] += rows[1] * 5.0
    rows[0] += 1.0
    rows[2] = rows[0] + 1.0
    rows[:2] *= 2.0
    assert np.array_equal(x, rows.ravel()) and np.array_equal(q, v * 3.0 + v * 3.0)


@kernel
def squared(lane, n, x: Lanes, y: Lanes):
    total = 0.0
    for k in range(n):
        total = total + x[k] * x[k]
    y[0] = total


pulled = vjp_of(squared, ("x", "y"))


@kernel
def pull(lane, n, x: Lanes, y: Lanes, x_bar: Lanes, y_bar: Lanes):
    pulled(lane, n, x, y, x_bar, y_bar)


@compiled
@pytest.mark.parametrize("lane", TAGS[:2], ids=len)
def test_reverse_mode(lane: tuple[int, ...]) -> None:
    """The derivative of sum x_k^2 is 2 x_k, in each lane."""
    x, y, x_bar, y_bar = np.arange(9.0 * len(lane)), np.zeros(len(lane)), np.zeros(9 * len(lane)), np.ones(len(lane))
    pull(lane, 9, x, y, x_bar, y_bar)
    assert np.array_equal(x_bar, 2.0 * x)


# ------------------------------------------------------------------ named tuples with operators
class Pair(NamedTuple):
    x: Any
    y: Any

    def __add__(self, b: Any) -> Any:
        return Pair(self.x + b[0], self.y + b[1])

    def __radd__(self, a: Any) -> Any:
        return Pair(a[0] + self.x, a[1] + self.y)

    def __sub__(self, b: Any) -> Any:
        return Pair(self.x - b[0], self.y - b[1])

    def __mul__(self, s: Any) -> Any:
        return Pair(self.x * s, self.y * s)

    def __rmul__(self, s: Any) -> Any:
        return Pair(self.x * s, self.y * s)

    def __neg__(self) -> Any:
        return Pair(-self.x, -self.y)


Pair.__array_ufunc__ = None  # type: ignore[attr-defined]


class Grid(NamedTuple):
    x: Any
    y: Any

    def __matmul__(self, b: Any) -> Any:
        if isinstance(b, Grid):
            return Grid(self.x.x * b.x + self.x.y * b.y, self.y.x * b.x + self.y.y * b.y)
        return Pair(self.x.x * b[0] + self.x.y * b[1], self.y.x * b[0] + self.y.y * b[1])

    @property
    def T(self) -> Any:
        return Grid(Pair(self.x.x, self.y.x), Pair(self.x.y, self.y.y))


@kernel
def operators(lane, x: Lanes, out: Lanes, s):
    a, R = Pair(x[0], x[1]), Grid(Pair(x[0], 2.0), Pair(-3.0, x[1]))
    b = s * a + a * 2.0 - (x[1], 1.0)
    total = Pair(0.0, 0.0)
    for _ in range(3):
        total = total + b
    total += (1.0, 2.0) + R.T @ -total
    out[0], out[1] = (R @ R.T) @ total


@traced
def traced_operators(lane, x: Lanes, both):
    return 2.0 * both + (x[0], x[1])


@kernel
def run_traced_operators(lane, x: Lanes, out: Lanes):
    out[0], out[1] = traced_operators(lane, x, Pair(x[1], 1.0))


@pytest.mark.parametrize("lane", TAGS[:1] if UNCOMPILED else TAGS[:2], ids=len)
def test_operators_of_named_tuples(lane: tuple[int, ...]) -> None:
    """The compiler calls the class's methods as Python does, with the same bits in any lane."""
    x = np.random.default_rng(5).normal(size=(2, len(lane)))
    for run, python in ((operators, uncompiled(operators)), (run_traced_operators, uncompiled(run_traced_operators))):
        more = (0.3,) if run is operators else ()
        found, expected = np.zeros((2, len(lane))), np.zeros((2, len(lane)))
        flat = found.ravel()
        run(lane, x.ravel(), flat, *more)
        for i in range(len(lane)):
            own = np.zeros(2)
            python(SINGLE, x[:, i].copy(), own, *more)
            expected[:, i] = own
        assert np.array_equal(flat.reshape(expected.shape), expected) and np.all(expected != 0.0)


NO_TAG = "argument `lane`"


@compiled
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def f(x: Lanes, lane_count_):\n    return 1.0", NO_TAG),
        ("def f(x, n):\n    y: Lanes = x\n    return 1.0", NO_TAG),
        ("def f(x, lane):\n    return g(lane, x, x[0])\n@kernel\ndef g(lane, x, y: Lanes):\n    return 1.0",
         "argument 'y': a number where `Lanes` are declared"),
        ("def f(x, lane):\n    y: Lanes = x\n    z = y if x[0] > 0.0 else x\n    return z[0]",
         "an array of lanes or an array: both must be of one kind"),
    ],
)  # fmt: skip
def test_refusals_name_the_line(text: str, said: str, tmp_path: Path) -> None:
    """File and line of the kernel, and the rule."""
    made = module(tmp_path, f"{HEAD}@kernel\n{text}\n")
    refuses(rf"kernels.py:\d+, in [fg]: .*{re.escape(said)}", lambda: made.f(np.ones(8), EIGHT), Refused)


def test_one_lane_where_python_runs_kernels() -> None:
    """Indices count numbers there: more lanes are refused, and not read as one."""
    with pytest.raises(RuntimeError, match="8 lanes"):
        uncompiled(sums)(EIGHT, 1, np.ones(8), np.ones(24), True)


def test_annotations() -> None:
    """By object and by text, in unions, and in named tuple classes."""
    assert all(map(is_lanes, (Lanes, Lanes | None, "Lanes", "Lanes | None", "None | Lanes", "compiler.Lanes")))
    assert not any(map(is_lanes, (np.ndarray, "np.ndarray", "LanesOfSomething", None, float)))
    assert lane_fields(Work) == {"q", "v"} and lane_fields(Model) == set()

    def f(lane: tuple[int, ...], x: Lanes, w: Work, n) -> Lanes:  # type: ignore[no-untyped-def]
        return x

    assert lane_parameters(f) == {"lane": False, "x": True, "w": False}
    assert isinstance(f, types.FunctionType)


LANE_ARRAYS = {
    "S", "q", "v", "a", "b", "r", "x", "y", "u", "psi", "par", "poses", "record", "seen", "info", "action", "outcome",
    "out", "flag", "bar", "r_bar", "u_bar", "q_bar", "v_bar", "par_bar", "force", "pose",
}  # fmt: skip
"""Names that physics, runtime and tasks give to arrays of lanes."""

OTHERS = {"add_vector", "specific_force", "drive_rows", "tangent_rows", "_add_residual", "pose_rows", "respond",
          "_set"}  # fmt: skip
"""Kernels whose arguments of these names are vectors of three, or numbers and tables of one arm, without lanes."""


def counts_lanes(item: ast.AST, lanes: set[str]) -> bool:
    """Whether an index counts numbers, not elements: it mentions the lanes, by `len(lane)` or a name that holds it."""
    return any(isinstance(node, ast.Name) and node.id in lanes for node in ast.walk(item))


def unmarked(function: ast.FunctionDef) -> set[str]:
    """Names of lane arrays among a kernel's arguments that are indexed by element without an annotation."""
    arguments = function.args.args
    if "lane" not in [one.arg for one in arguments] or function.name in OTHERS:
        return set()
    bare = {one.arg for one in arguments if one.annotation is None and one.arg in LANE_ARRAYS}
    # names that are computed from the lanes, such as i = k * lanes
    lanes = {"lane", "lanes"}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and counts_lanes(node.value, lanes):
            lanes |= {name.id for name in ast.walk(node.targets[0]) if isinstance(name, ast.Name)}
        if isinstance(node, ast.For) and counts_lanes(node.iter, lanes):
            lanes |= {name.id for name in ast.walk(node.target) if isinstance(name, ast.Name)}
    found = set()
    for node in ast.walk(function):
        # x[0] with a number is an entry of a tuple, such as a vector
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Constant):
            by_element = not counts_lanes(node.slice, lanes)
            if by_element and isinstance(node.value, ast.Name) and node.value.id in bare:
                found.add(node.value.id)
    return found


def test_kernels_say_of_the_arrays_that_they_index_that_these_hold_lanes() -> None:
    """Without the annotation `S[k]` is number k of all lanes: right for one arm, another arm's number for eight."""
    found = []
    for room in ("physics", "runtime", "tasks"):
        for path in sorted((PACKAGE / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef) and node.decorator_list:
                    found += [f"{path.relative_to(PACKAGE)}: {node.name}({name})" for name in sorted(unmarked(node))]
    assert not found


def test_an_array_that_is_not_said_to_hold_lanes_is_found() -> None:
    text = "@kernel\ndef f(lane, q, S: Lanes, r):\n    for k in range(3):\n        r[k] += S[k] * q[k * len(lane)]\n"
    assert unmarked(ast.parse(text).body[0]) == {"r"}  # type: ignore[arg-type]
