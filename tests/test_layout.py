"""One declaration of a layout: what NumPy packs is what kernels find."""

from __future__ import annotations

import numpy as np
import pytest

from flexarm_env.compiler.decorator import kernel
from flexarm_env.layout import Field, Layout

PAIR = Layout("Pair", "", Field("k", (), "N/m", "stiffness"), Field("g", (2, 2), "1/m", "coupling"))
BLOCK = Layout(
    "Block", "n, pairs",
    Field("length", (), "m", "of it"),
    Field("G", ("n", "n"), "kg", "matrix"),
    Field("pairs", ("pairs", PAIR.length), "", "a `PAIR` each"),
    Field("c", ("2 * n",), "kg m", "vector"),
)  # fmt: skip
block_at = kernel(BLOCK.offsets)
block_views = kernel(BLOCK.views)
AT = PAIR.places


@kernel
def _read(flat, first, n, pairs, i, j):
    at = block_at(first, n, pairs)
    return flat[at.G + i * n + j], flat[at.pairs + (pairs - 1) * AT.end + AT.g + 3], flat[at.c], at.end


@kernel
def _sum(flat, first, n, pairs):
    w = block_views(flat, first, n, pairs)
    return w.c.shape[0] + w.G[n]


def test_kernels_find_what_was_packed() -> None:
    sizes = {"n": 3, "pairs": 2}
    G, c = np.arange(9.0).reshape(3, 3), np.arange(6.0) + 20.0
    pairs = [PAIR.pack({}, k=1.0, g=np.full((2, 2), value)) for value in (5.0, 7.0)]
    block = np.concatenate([[99.0], BLOCK.pack(sizes, length=0.5, G=G, pairs=pairs, c=c)])
    assert block.size == 1 + 1 + 9 + 10 + 6
    assert _read(block, 1, 3, 2, 2, 1) == (G[2, 1], 7.0, 20.0, block.size)
    assert _sum(block, 1, 3, 2) == 6 + G[1, 0]
    found = BLOCK.unpack(block, 1, **sizes)
    np.testing.assert_array_equal(found["G"], G)
    np.testing.assert_array_equal(PAIR.unpack(found["pairs"][1])["g"], np.full((2, 2), 7.0))
    found["c"][0] = -1.0
    assert block[-6] == -1.0  # a view


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="'g' is missing"):
        PAIR.pack({}, k=1.0)
    with pytest.raises(ValueError, match="'x' is not a field"):
        PAIR.pack({}, k=1.0, g=np.zeros((2, 2)), x=1.0)
    with pytest.raises(ValueError, match=r"g has shape \(4,\), must have \(2, 2\)|g has shape \(3,\)"):
        PAIR.pack({}, k=1.0, g=np.zeros(3))
    with pytest.raises(ValueError, match="twice"):
        Layout("Twice", "", Field("a", (), "", ""), Field("a", (), "", ""))


def test_it_says_what_is_in_it() -> None:
    assert "stiffness" in str(PAIR)
    assert str(BLOCK).splitlines()[1].split() == ["G", "(n,", "n)", "kg", "matrix"]
