"""One declaration of a layout: what NumPy packs is what kernels find."""

import ast

import numpy as np
import pytest

from flexarm_env.compiler.decorator import kernel
from flexarm_env.layout import Field, Layout
from flexarm_env.physics.exact.layout import CHAIN, ELEMENT_FACTORS, FACTORS
from flexarm_env.physics.integrator.work import WORK
from flexarm_env.physics.layout import BOOKS, COUNTS, LOAD, MOTION, POSES
from tests.processes import ROOT
from tests.refusals import refuses

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
    refuses("'g' is missing", lambda: PAIR.pack({}, k=1.0))
    refuses("'x' is not a field", lambda: PAIR.pack({}, k=1.0, g=np.zeros((2, 2)), x=1.0))
    refuses(r"g has shape \(4,\), must have \(2, 2\)|g has shape \(3,\)", lambda: PAIR.pack({}, k=1.0, g=np.zeros(3)))
    refuses("twice", lambda: Layout("Twice", "", Field("a", (), "", ""), Field("a", (), "", "")))


def test_it_says_what_is_in_it() -> None:
    assert "stiffness" in str(PAIR)
    assert str(BLOCK).splitlines()[1].split() == ["G", "(n,", "n)", "kg", "matrix"]


@pytest.mark.parametrize("room", ["exact", "elastica", "floating", "integrator", "joints"])
def test_no_kernel_holds_a_place_as_a_number(room: str) -> None:
    """In what is loaded, stored or indexed, no sum or product with a number above 1."""
    found = []
    for file in (ROOT / "flexarm_env" / "physics" / room).glob("*.py"):
        if room == "floating" and file.name in ("build.py", "constants.py", "reduction.py"):  # NumPy: nodes' matrices
            continue
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("load", "store"):
                index = node.args[2 if node.func.id == "load" else 1]
            elif isinstance(node, ast.Subscript) and file.name != "element.py":  # there of lists and tables
                index = node.slice
            else:
                continue
            sums = [part for part in ast.walk(index) if isinstance(part, ast.BinOp)]
            numbers = [x.value for part in sums for x in (part.left, part.right) if isinstance(x, ast.Constant)]
            found += [
                f"{file.name}:{node.lineno}: {ast.unparse(index)}" for x in numbers if isinstance(x, int) and x > 1
            ]
    assert not found, "\n".join(found)


def test_layouts_of_the_physics_have_the_sizes_that_follow_from_counting() -> None:
    """An arm of 3 links of 2 cubic elements, under 2 motions, in 8 lanes."""
    chain, factors = CHAIN.offsets(0, 3, 2, 3), FACTORS.offsets(0, 3, 2, 3)
    assert chain.end == 3 * (3 * 3 * 2 + 1) + 2  # x, y, psi of all nodes, and two hinges
    inner = 6
    element = sum(1 + (inner - 1 - m) + 6 for m in range(inner)) + (6 + 9 + 6) + 2 * 3
    assert ELEMENT_FACTORS.offsets(0, 3).end == element
    assert factors.end == (3 + 6) + 2 * (1 + 3 + 1) + 6 * element
    ends = (POSES.places.end, LOAD.places.end, MOTION.places.end, BOOKS.places.end, COUNTS.places.end)
    assert ends == (12, 3, 3, 3, 4)
    rows = 8 * chain.end
    assert WORK.offsets(0, 8, chain.end, 0, factors.end, 3, 2).end == (
        9 * rows + 8 * (factors.end + 4 * 3 + 2 * 2 * 3 + 2 * 2 + 1 + 3) + 4
    )
