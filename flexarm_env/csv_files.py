"""CSV files whose first line names the columns; those that end in .gz are unpacked."""

from __future__ import annotations

import csv
import gzip
import os

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check

Array = NDArray[np.float64]


def csv_lines(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], list[list[str]]]:
    """Names in the first line of a CSV file, and the cells of the others; empty lines are left out.

    Raises OSError where the file cannot be read, ValueError that names it where it is no text.
    """
    try:
        opened = gzip.open if os.fspath(path).endswith(".gz") else open
        with opened(path, "rt", newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line]
    except (UnicodeDecodeError, csv.Error, gzip.BadGzipFile, EOFError) as error:
        raise ValueError(f"{os.fspath(path)}: not a CSV file: {error}") from None
    return (tuple(name.strip() for name in lines[0]), lines[1:]) if lines else ((), [])


def numbers(k: int, name: str, lines: list[list[str]], columns: int) -> Array:
    """The numbers of column k, (n,). Raises ValueError that names row and column."""
    values = []
    for i, line in enumerate(lines):
        if len(line) != columns:
            raise check.InvalidValue(f"[{i}]", line, f"must hold {columns} numbers, in row {i}")
        try:
            values.append(float(line[k]))
        except ValueError:
            raise check.InvalidValue(f"[{i}]", line[k], f"must be a number, in row {i} of column {name!r}") from None
    return np.array(values)
