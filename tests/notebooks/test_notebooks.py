"""Every notebook of docs/notebooks runs from start to end, as a notebook runs it, in under five minutes of a CPU."""

import json
import os
from pathlib import Path

import pytest

from tests.processes import ROOT, python

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SECONDS = 300.0

RUN = """
import ast, json, sys
cells = [c for c in json.load(open(sys.argv[1], encoding="utf-8"))["cells"] if c["cell_type"] == "code"]
names = {"__name__": "__main__"}
for k, cell in enumerate(cells):
    tree = ast.parse("".join(cell["source"]), f"cell {k}")
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, f"cell {k}", "exec"), names)
    if last is not None:  # what a notebook shows below the cell
        value = eval(compile(ast.Expression(last.value), f"cell {k}", "eval"), names)
        if hasattr(value, "_repr_html_"):
            print("SHOWN", len(value._repr_html_()))
"""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path) -> None:
    start = os.times()
    done = python("-c", RUN, path, cwd=tmp_path)
    assert os.times().children_user - start.children_user < SECONDS
    assert done.stdout.count("SHOWN") >= 1
    assert not list(tmp_path.iterdir()), "a notebook leaves no files behind"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_without_outputs(path: Path) -> None:
    book = json.loads(path.read_text("utf-8"))
    assert book["nbformat"] == 4 and book["cells"][0]["source"][0].startswith("# ")
    assert not [c for c in book["cells"] if c.get("outputs") or c.get("execution_count")]
