"""Kernels backwards: loops, branches, arrays written in place; cotangents against tangents of the same kernels."""

from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import EIGHT, SINGLE, UNCOMPILED, dual, kernel, load, store, vjp_of
from flexarm_env.compiler.kinds import Refused
from tests.test_language import module

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")

ROWS = 7
"""Elements of the arrays x (read) and y (read and written); s passes numbers on, m holds whole numbers."""

HEAD = """
from flexarm_env.compiler import absolute, kernel, load, select_lt, sincos, size, splat, square_root, stack, store
from flexarm_env.compiler import vjp_of
"""

TAIL = """

@kernel
def drawn(lane, x, y, s, m, n):
{body}


pulled = vjp_of(drawn, ("x", "y"), scratch=("s",))


@kernel
def back(lane, x, y, s, m, n, x_bar, y_bar):
    pulled(lane, x, y, s, m, n, x_bar, y_bar)
"""


class Draw:
    """A kernel of nested loops and branches; whatever it stores in s it reads from there later. r and what choices do
    not take need not be finite."""

    def __init__(self, seed: int) -> None:
        self.random, self.loops, self.lines = Random(seed), list[str](), list[str]()

    def text(self) -> str:
        self.lines = ["    p, q = load(lane, x, 0), splat(lane, 0.5)", "    t = stack(lane, (0, 0, 0))"]
        self.lines += ["    r = p / (q - q)"]
        self.lines += [f"    store(t, {k}, load(lane, x, {k}))" for k in range(3)]
        self.lines += ["    for h in range(8):", "        store(s, h, load(lane, x, h % 7) * 0.5)"]
        self.block(1, 4)
        self.lines += ["    store(y, 0, p * q)", "    store(y, 1, load(lane, y, 1) + load(lane, t, 1))"]
        return HEAD + TAIL.format(body="\n".join(self.lines))

    def index(self) -> str:
        """A place in x or y."""
        return self.random.choice(["0", "3", "m[0]", *(f"({i} * 2 + m[1]) % 7" for i in self.loops), *self.loops])

    def number(self, deep: int = 2) -> str:
        pick = self.random.choice
        if deep == 0 or self.random.random() < 0.25:
            kept = [f"load(lane, s, {pick(['2', *self.loops])})", f"load(lane, t, {pick('012')})"]
            read = [f"load(lane, x, {self.index()})", f"load(lane, y, {self.index()})"]
            return pick(["p", "q", "splat(lane, 0.7)", *read, *kept])
        a, b = self.number(deep - 1), self.number(deep - 1)
        return pick([
            f"({a} + {b})", f"({a} - {b})", f"({a} * {b})", f"(-{a})", f"({a} / ({b} * {b} + 1.5))", f"sincos({a})[0]",
            f"sincos({a})[1]", f"select_lt({a}, {b}, {a} * 0.5, {b})", f"square_root({a} * {a} + 0.3)",
            f"select_lt({a}, 0.0, {a} * 0.3, {a} * square_root({a}))", f"select_lt({a} * 0.0, 1.0, {b}, r * {a})",
            f"select_lt(absolute({a}), 9.0, {b}, {a} / ({b} - {b}) * {b})",
        ])  # fmt: skip

    def block(self, deep: int, most: int) -> None:
        pad, pick = "    " * deep, self.random.choice
        for _ in range(self.random.randint(2, most)):
            kind = self.random.random()
            if kind < 0.3 and deep < 4:
                name = "ijk"[len(self.loops)] if len(self.loops) < 3 else ""
                if name:
                    over = pick(["7", "n", "1, n", "6, -1, -1", "n - 1, -1, -2", "0, 7, 3", "2", "0"])
                    self.lines.append(f"{pad}for {name} in range({over}):")
                    self.loops.append(name)
                    self.block(deep + 1, 3)
                    self.loops.pop()
                    continue
            if kind < 0.45 and deep < 4:
                index = pick([*self.loops, "n"])
                self.lines.append(f"{pad}if {index} % 2 == {pick('01')}:")
                self.block(deep + 1, 2)
                if self.random.random() < 0.5:
                    self.lines.append(f"{pad}else:")
                    self.block(deep + 1, 2)
                continue
            if kind < 0.5:
                self.lines += [f"{pad}r = {pick(['r * ', ''])}{self.number(1)} / (q - q)", f"{pad}if n < 0:"]
                self.lines += [f"{pad}    q = q + r * {self.number(1)}"]
                continue
            if kind < 0.55:  # overwritten, at once or where something holds
                self.lines += [f"{pad}store(t, 2, {self.number(1)} / (q - q))", f"{pad}store(t, 2, {self.number(1)})"]
                continue
            value = self.number()
            to = pick([f"y, {self.index()}", f"s, {pick(['1', *self.loops])}", f"t, {pick('012')}"])
            ways = [f"p = sincos({value})[0]", f"q = q * 0.5 + sincos({value})[1]", f"store({to}, sincos({value})[0])"]
            self.lines.append(pad + pick([*ways, f"store(y, m[0], load(lane, y, m[0]) * 0.5 + sincos({value})[0])"]))


def agree(made: Any, lane: tuple[int, ...], rng: Any, text: str) -> None:
    """y'(J dx) is (J'y)'dx, for inputs x and the old y; the arrays stay, cotangents of what is written are taken."""
    L, wide = len(lane), dual(lane, 1)
    x, y, dx, dy, x_bar, y_bar = rng.uniform(-1.0, 1.0, (6, ROWS, L))
    m, n = np.array([4, 3]), int(rng.integers(2, 8))
    both = [np.ascontiguousarray(np.stack([one, other], 1)) for one, other in ((x, dx), (y, dy))]
    made.drawn(wide, *(one.ravel() for one in both), np.zeros(8 * 2 * L), m, n)
    after = both[1].reshape(ROWS, 2, L)[:, 1]
    found = x_bar.copy(), y_bar.copy()
    kept = x.copy(), y.copy()
    made.back(lane, x.reshape(-1), y.reshape(-1), np.zeros(8 * L), m, n, found[0].reshape(-1), found[1].reshape(-1))
    assert np.array_equal(x, kept[0]) and np.array_equal(y, kept[1])
    one = (y_bar * after).sum() + (x_bar * dx).sum()
    other = (found[0] * dx).sum() + (found[1] * dy).sum()
    size = np.linalg.norm(y_bar) * np.linalg.norm(after) + np.linalg.norm(found) * np.linalg.norm([dx, dy])
    assert abs(one - other) < 1e-12 * size, text


CHOICES = """

@kernel
def ratio(lane, x, y):
    v = load(lane, x, 0)
    store(y, 0, select_lt(absolute(v), 1e-8, 1.0 - v * v / 6.0, sincos(v)[0] / v))


@kernel
def root(lane, x, y):
    v = load(lane, x, 0)
    store(y, 0, select_lt(v, 0.0, v * v, v * square_root(v)))


@kernel
def memory(lane, x, y):
    v, w = load(lane, x, 0), stack(lane, (0, 0))
    store(w, 0, sincos(v)[0])
    store(w, 1, load(lane, w, 0) / v)
    q = load(lane, w, 1)
    a = select_lt(absolute(v), 1e-8, 1.0 - v * v / 6.0, q)
    store(y, 0, a + select_lt(absolute(v), 1e-8, v * 2.0, q * q * 3.0))


@kernel
def shared(lane, x, y):
    v = load(lane, x, 0)
    r = 1.0 / v
    a = select_lt(absolute(v), 1e-8, v * 2.0, r * v * v)
    store(y, 0, a + select_lt(1e-8, absolute(v), r * sincos(v)[1], v * 3.0))


@kernel
def nested(lane, x, y):
    v = load(lane, x, 0)
    inner = select_lt(v, 1.0, 1.0 / (v - 1.0), square_root(v - 1.0) * v)
    store(y, 0, select_lt(absolute(v - 1.0), 1e-9, v * v, inner * v))


@kernel
def branch(lane, x, y):
    v = load(lane, x, 0)
    r = 1.0 / v
    r = r * sincos(v)[0]
    if absolute(x[0]) < 1e-8:
        store(y, 0, 1.0 - v * v / 6.0)
    else:
        store(y, 0, r)


@kernel
def mended(lane, x, y):
    v, w = load(lane, x, 0), stack(lane, (0,))
    store(w, 0, sincos(v)[0] / v)
    if absolute(x[0]) < 1e-8:
        store(w, 0, 1.0 - v * v / 6.0)
    r = 1.0 / v
    if absolute(x[0]) < 1e-8:
        r = v * 3.0
    store(y, 0, load(lane, w, 0) + r)


@kernel
def wide(lane, x, y):
    v, k = load(lane, x, 0), 1.0 / x[0]
    store(y, 0, select_lt(absolute(v), 1e-8, v * 2.0, v * k))
"""

PULLED = """

{name}_pulled = vjp_of({name}, ("x", "y"))


@kernel
def {name}_back(lane, x, y, x_bar, y_bar):
    {name}_pulled(lane, x, y, x_bar, y_bar)
"""


def test_a_branch_that_is_not_taken_leaves_no_trace(tmp_path: Path) -> None:
    """However its slope is: zero times infinity is no part of a derivative. Closed forms; forwards and back."""
    names = ("ratio", "root", "memory", "shared", "nested", "branch", "mended", "wide")
    text = HEAD + CHOICES + "".join(PULLED.format(name=name) for name in names)
    made, half = module(tmp_path, text, "choices"), 0.5
    by_half = (half * np.cos(half) - np.sin(half)) / half**2
    sine = np.sin(half) / half
    for name, x, slope in [
        ("ratio", 0.0, 0.0), ("ratio", half, by_half), ("root", -1.0, -2.0), ("root", 2.0, 1.5 * 2.0**0.5),
        ("memory", 0.0, 2.0), ("memory", half, by_half * (1.0 + 6.0 * sine)), ("shared", 0.0, 5.0),
        ("shared", half, 1.0 - (half * np.sin(half) + np.cos(half)) / half**2), ("nested", 1.0, 2.0),
        ("nested", half, -1.0 / (half - 1.0) ** 2), ("branch", 0.0, 0.0), ("branch", half, by_half), ("wide", 0.0, 2.0),
        ("mended", 0.0, 3.0), ("mended", half, by_half - 4.0),
    ]:  # fmt: skip
        for lane in (SINGLE, EIGHT):
            L = len(lane)
            x_bar, y, after = np.zeros(L), np.zeros(L), np.zeros(2 * L)
            getattr(made, f"{name}_back")(lane, np.full(L, x), y, x_bar, np.ones(L))
            assert abs(x_bar - slope).max() < 1e-14, (name, x, L, x_bar)
            getattr(made, name)(dual(lane), np.repeat([x, 1.0], L), after)
            assert abs(after[L:] - slope).max() < 1e-14, (name, x, L, after)


@pytest.mark.parametrize("count", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_drawn_kernels_backwards(count: int, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Of loops within loops over ranges of either direction, of branches, of what is overwritten and read again."""
    seed = request.config.option.hypothesis_seed or 0
    for k in range(seed, seed + count):
        text, rng = Draw(k).text(), np.random.default_rng(k)
        made = module(tmp_path, text, f"reversed_{k}")
        for lane in (SINGLE, EIGHT) if k % 4 == 0 else (EIGHT,):
            agree(made, lane, rng, text)


def _while(lane, x, y, n):
    a = load(lane, x, 0)
    while y[0] > 0.0:
        a = a * 0.5
        y[0] -= 1.0
    store(y, 1, a)


def _breaks(lane, x, y, n):
    for k in range(n):
        if y[k] > 0.0:
            break
        store(y, k, load(lane, x, k) * 2.0)


def _within(lane, x, y, n):
    for k in range(n):
        store(y, k, load(lane, x, k) * 2.0)
        if n > 2:
            return


def _chosen(lane, x, y, n):
    store(y, 0, load(lane, x, 0) * 2.0 if n > 0 else load(lane, x, 1))


def _lost(lane, x, y, z):
    store(z, 0, load(lane, x, 0))


@pytest.mark.parametrize(
    ("function", "last", "words"),
    [
        (_while, 3, "a while loop of numbers has no derivative backwards"),
        (_breaks, 3, "break has no derivative backwards"),
        (_within, 3, "a return within a loop"),
        (_chosen, 3, "x if t else y of numbers has no derivative backwards"),
        (_lost, np.zeros(3), "an array without cotangents"),
    ],
)
def test_what_has_no_derivative_backwards_is_refused_with_its_line(function: Any, last: Any, words: str) -> None:
    pulled = vjp_of(kernel(function), ("x", "y"))

    @kernel
    def back(lane, x, y, n, x_bar, y_bar):
        pulled(lane, x, y, n, x_bar, y_bar)

    x, y, x_bar, y_bar = np.zeros((4, 3))
    with pytest.raises(Refused, match=words) as caught:
        back(SINGLE, x, y, last, x_bar, y_bar)
    assert "test_reverse.py" in str(caught.value)


def _scaled(lane, x, y, c):
    store(y, 0, load(lane, x, 0) * load(lane, c, 0))


def test_an_argument_without_cotangents_is_constant() -> None:
    """y = c x: x_bar = c y_bar and, unless None is given for it, c_bar = x y_bar."""
    pulled = vjp_of(kernel(_scaled), ("x", "y", "c"))

    @kernel
    def back(lane, x, y, c, x_bar, y_bar, c_bar):
        pulled(lane, x, y, c, x_bar, y_bar, c_bar)

    for c_bar in (None, np.zeros(1)):
        x_bar = np.zeros(1)
        back(SINGLE, np.array([3.0]), np.zeros(1), np.array([5.0]), x_bar, np.array([2.0]), c_bar)
        assert x_bar[0] == 10.0 and (c_bar is None or c_bar[0] == 6.0)


def test_names_that_widen_take_no_stack_memory_of_discarded_attempts(tmp_path: Path) -> None:
    # each name begins as a number and becomes lanes, so that the kernel is written once more for each; 20 attempts of
    # 32,768 numbers each would exceed the 524,288 that a kernel may have on its stack
    names = [f"a{i}" for i in range(20)]
    lines = [f"{name} = 1.0" for name in names] + ["for k in range(2):"]
    lines += [f"    {name} = {name} * load(lane, x, k)" for name in names]
    lines += [f"store(y, 0, {' + '.join(names)})"]
    made = module(tmp_path, HEAD + TAIL.format(body="\n".join(f"    {line}" for line in lines)))
    x, y, s, x_bar, y_bar = (np.repeat(a, 8) for a in ([2.0, 3.0], [0.0], np.zeros(8), [0.0, 0.0], [1.0]))
    made.back(EIGHT, x, y, s, np.zeros(2, np.int64), 1, x_bar, y_bar)
    np.testing.assert_array_equal(x_bar, np.repeat([20.0 * 3.0, 20.0 * 2.0], 8))
