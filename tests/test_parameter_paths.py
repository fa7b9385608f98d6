"""A parameter takes few files from the TOML file to its kernel: the table in docs/architecture.md is true."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.processes import ROOT

PACKAGE = ROOT / "flexarm_env"
MOST = 5
"""Largest number of files from the TOML file to the kernel that computes with a parameter."""


class Row(NamedTuple):
    """A row of the table: parameter, its name in the kernel (LAYOUT.field, or a constant), and the files in order."""

    parameter: str
    layout: str
    name: str
    files: tuple[Path, ...]


def _rows() -> list[Row]:
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8").split("## Path of a parameter")[1].split("\n## ")[0]
    found = []
    for line in text.splitlines():
        words = re.findall(r"`([^`]+)`", line) if line.startswith("| `") else []
        if words:
            layout, _, name = words[1].rpartition(".")
            files = tuple(dict.fromkeys(PACKAGE / word for word in words if word.endswith(".py")))
            found.append(Row(words[0], layout, name, files))
    return found


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text("utf-8"))


def _carries(file: Path, word: str) -> bool:
    """Whether the code of a file, without docstrings, contains a name or a text."""
    for node in ast.walk(_tree(file)):
        if word in (getattr(node, "id", None), getattr(node, "attr", None), getattr(node, "arg", None)):
            return True
        if isinstance(node, ast.Constant) and node.value == word:
            return True
    return False


def _classes(file: Path, field: str) -> list[ast.ClassDef]:
    """Classes of a file that declare a field."""
    known = [node for node in ast.walk(_tree(file)) if isinstance(node, ast.ClassDef)]
    fields = [[getattr(one.target, "id", "") for one in node.body if isinstance(one, ast.AnnAssign)] for node in known]
    return [node for node, names in zip(known, fields, strict=True) if field in names]


def _declares(file: Path, layout: str, name: str) -> bool:
    """Whether a file assigns `layout`, a Layout with a field `name`."""
    for node in _tree(file).body:
        if isinstance(node, ast.Assign) and [getattr(one, "id", "") for one in node.targets] == [layout]:
            return f"Field('{name}'" in ast.unparse(node.value)
    return False


def _source(file: Path, word: str) -> Path | None:
    """The file of the package from which a file imports a name; None if it does not import it."""
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.ImportFrom) and word in [one.name for one in node.names]:
            own = file.relative_to(ROOT).with_suffix("").parts
            base = own[: len(own) - node.level] if node.level else ()
            return ROOT.joinpath(*base, *(node.module or "").split(".")).with_suffix(".py")
    return None


def _packers(declared: Path, layout: str) -> Iterator[Path]:
    """Files that call `pack` of the layout that one file declares."""
    for file in sorted(PACKAGE.rglob("*.py")):
        text = file.read_text("utf-8")
        if re.search(rf"\b{layout}\.pack\(", text) and (file == declared or _source(file, layout) == declared):
            yield file


def _kernels_with(file: Path, name: str) -> list[str]:
    """Kernels of a file that read a field or a constant."""
    found = []
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.FunctionDef) and {"kernel", "inlined"} & {ast.unparse(x) for x in node.decorator_list}:
            inside = [x for one in node.body for x in ast.walk(one)]
            found += [node.name for x in inside if name in (getattr(x, "attr", None), getattr(x, "id", None))]
    return found


@pytest.mark.parametrize("row", _rows(), ids=lambda row: f"{row.parameter}, {row.layout}.{row.name}")
def test_a_parameter_takes_few_files_to_its_kernel(row: Row) -> None:
    """At most five files: a record declares it, one file packs it under its name, and a kernel reads that name."""
    assert len(row.files) <= MOST and all(file.is_file() for file in row.files)
    # a record declares the parameter; the kernel's name is the same, or a property of the record that reads it
    records = _classes(row.files[1], row.parameter)
    assert records, "the second file declares the parameter"
    short, long = sorted((row.parameter.lower(), row.name.lower()), key=len)
    properties = [one for record in records for one in record.body if getattr(one, "name", "") == row.name]
    assert short in long or any(row.parameter in ast.unparse(one) for one in properties)
    # the kernel that computes with it reads it by this name
    kernel = next(file for file in reversed(row.files) if _kernels_with(file, row.name))
    assert kernel in row.files[-2:]
    if not row.layout:
        assert any(_carries(file, row.name) and _carries(file, row.parameter) for file in row.files)
        return
    # whoever declares and packs the layout is in the row, and no file lies between record and packed number
    declared = [file for file in row.files if _declares(file, row.layout, row.name)]
    assert len(declared) == 1
    packers = list(_packers(declared[0], row.layout))
    assert packers and set(packers) <= set(row.files)
    for file in packers:
        assert _carries(file, row.name)
        near = [file, *(one for one in row.files if one != file and _imports(file, one))]
        words = {row.parameter, *(one.name for one in properties)}  # type: ignore[attr-defined]
        assert any(_carries(one, word) for one in near for word in words)


def _imports(file: Path, other: Path) -> bool:
    """Whether a file imports something from another file of the package."""
    names = [one.name for node in ast.walk(_tree(file)) if isinstance(node, ast.ImportFrom) for one in node.names]
    return any(_source(file, name) == other for name in names)


def test_the_table_names_parameters_of_arms_scenes_contacts_and_sensors() -> None:
    """The rows cover every formulation and six further parameters."""
    rows = _rows()
    assert sum(row.parameter == "EI" for row in rows) == 6
    others = {"damping", "gear_ratio", "friction_coulomb", "mass", "gravity", "stiffness", "noise"}
    assert {row.parameter for row in rows} == {"EI", *others}
