"""Dual lanes: every rule of differentiation against complex steps or differences, and values that keep their bits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import (
    EIGHT,
    SINGLE,
    absolute,
    dual,
    kernel,
    lane_count,
    load,
    load_lane,
    max_over_lanes,
    maximum,
    round_even,
    select_lt,
    sincos,
    splat,
    square_root,
    stack,
    store,
    store_lane,
)
from flexarm_env.physics.arithmetic import arctangent, clip, decay

OUT = 32


@kernel
def _all(lane, x, out):
    """Every operation once, of load(x, 0) and load(x, 1)."""
    a, b = load(lane, x, 0), load(lane, x, 1)
    store(out, 0, a + b)
    store(out, 1, a + 2.5)
    store(out, 2, 2.5 + a)
    store(out, 3, a - b)
    store(out, 4, a - 2.5)
    store(out, 5, 2.5 - a)
    store(out, 6, a * b)
    store(out, 7, a * 3)
    store(out, 8, 3.0 * a)
    store(out, 9, a / b)
    store(out, 10, a / 2.5)
    store(out, 11, 2.5 / a)
    store(out, 12, -a)
    store(out, 13, select_lt(a, b, a * a, b))
    store(out, 14, select_lt(a, 0.3, 1.0, b))
    store(out, 15, absolute(a))
    store(out, 16, maximum(a, b))
    store(out, 17, square_root(a * a + b * b))
    store(out, 18, round_even(a))
    sine, cosine = sincos(a * 5.0)
    store(out, 19, sine)
    store(out, 20, cosine)
    store(out, 21, decay(a * a))
    store(out, 22, arctangent(a, b))
    store(out, 23, clip(a, 0.6))
    store(out, 24, splat(lane, 2.0))
    store(out, 25, splat(lane, max_over_lanes(a)))
    room = stack(lane, (0, 0))
    store(room, 0, a * b)
    store(room, 1, b)
    total = load(lane, room, 0)
    total += load(lane, room, 1)
    total *= a
    total -= 1.0
    total /= b
    store(out, 26, total)
    store(out, 27, square_root(a - a))
    store(out, 28, splat(lane, float(lane_count(lane))))


_VALUES: list[Callable[[Any, Any], Any]] = [
    lambda a, b: a + b, lambda a, b: a + 2.5, lambda a, b: 2.5 + a, lambda a, b: a - b, lambda a, b: a - 2.5,
    lambda a, b: 2.5 - a, lambda a, b: a * b, lambda a, b: a * 3, lambda a, b: 3.0 * a, lambda a, b: a / b,
    lambda a, b: a / 2.5, lambda a, b: 2.5 / a, lambda a, b: -a, lambda a, b: a * a if a.real < b.real else b,
    lambda a, b: 1.0 if a.real < 0.3 else b, lambda a, b: a if a.real > 0 else -a,
    lambda a, b: a if a.real > b.real else b, lambda a, b: np.sqrt(a * a + b * b), lambda a, b: np.rint(a.real),
    lambda a, b: np.sin(a * 5.0), lambda a, b: np.cos(a * 5.0), lambda a, b: np.exp(-a * a),
    lambda a, b: 1j * (b.real * a.imag - a.real * b.imag) / (a.real**2 + b.real**2),
    lambda a, b: a if abs(a.real) < 0.6 else 0.6, lambda a, b: 2.0, lambda a, b: 0.0,
    lambda a, b: ((a * b + b) * a - 1.0) / b, lambda a, b: 0.0,
]  # fmt: skip
"""The same by complex steps."""


@pytest.mark.parametrize(("lane", "tangents"), [(SINGLE, 1), (EIGHT, 1), (EIGHT, 3)], ids=str)
def test_every_rule_against_complex_steps(lane: tuple[int, ...], tangents: int) -> None:
    """Values keep the bits of plain lanes; tangents are those of a complex step of 1e-100."""
    rng, n = np.random.default_rng(5), len(lane)
    for _ in range(20):
        value, rates = rng.uniform(-1.5, 1.5, (2, 1, n)), rng.uniform(-1.0, 1.0, (2, tangents, n))
        plain, both = np.zeros(OUT * n), np.zeros((OUT, 1 + tangents, n))
        _all(lane, value.ravel(), plain)
        _all(dual(lane, tangents), np.concatenate([value, rates], 1).ravel(), both.reshape(-1))
        assert (both[:, 0] == plain.reshape(OUT, n)).all()
        assert (both[25, 0] == value[0].max()).all()
        assert (both[28, 0] == n).all()
        for k, value_of in enumerate(_VALUES):
            for j, i in np.ndindex(tangents, n):
                a, b = value[:, 0, i] + 1e-100j * rates[:, j, i]
                wanted = np.imag(value_of(a, b)) * 1e100
                assert abs(both[k, 1 + j, i] - wanted) <= 1e-9 * (1.0 + abs(wanted)), k


@kernel
def _by_arm(lane, x, out):
    """One number, arm by arm."""
    for i in range(lane_count(lane)):
        sine, _ = sincos(load_lane(lane, x, 0, i))
        store_lane(lane, out, 1, i, sine * load_lane(lane, x, 1, i) + 0.5)
        store_lane(lane, out, 2, i, 3.0)


@kernel
def _by_lane(lane, x, out):
    """The same of all arms at once."""
    sine, _ = sincos(load(lane, x, 0))
    store(out, 1, sine * load(lane, x, 1) + 0.5)
    store(out, 2, splat(lane, 3.0))


@pytest.mark.parametrize("lane", [SINGLE, EIGHT, dual(SINGLE, 2), dual(EIGHT, 3)], ids=len)
def test_an_arm_by_itself_has_the_numbers_that_it_has_among_others(lane: tuple[int, ...]) -> None:
    """`load_lane` and `store_lane` of each arm, values and tangents: the bits of `load` and `store`."""
    x = np.random.default_rng(6).uniform(-1.5, 1.5, 2 * len(lane))
    out = np.full((2, 3 * len(lane)), 7.0)
    for function, rows in zip((_by_arm, _by_lane), out, strict=True):
        function(lane, x, rows)
    assert np.array_equal(*out) and (out[0, : len(lane)] == 7.0).all()
