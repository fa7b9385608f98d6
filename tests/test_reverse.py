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
from flexarm_env.compiler import kernel, load, select_lt, sincos, size, splat, square_root, stack, store, vjp_of
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
    """A kernel of nested loops and branches; whatever it stores in s it reads from there later."""

    def __init__(self, seed: int) -> None:
        self.random, self.loops, self.lines = Random(seed), list[str](), list[str]()

    def text(self) -> str:
        self.lines = ["    p, q = load(lane, x, 0), splat(lane, 0.5)", "    t = stack(lane, (0, 0, 0))"]
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


@pytest.mark.parametrize("count", [12, pytest.param(60, marks=pytest.mark.slow)])
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
