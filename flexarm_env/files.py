"""Files that users give and get: TOML, JSON, CSV, archives of arrays (NPZ); read whole and refused in a sentence.

Nothing in a file is run. Whatever is wrong with one is a ValueError that names it; one that the system does not give is
an OSError with its name.
"""

import csv
import gzip
import io
import json
import os
import re
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.validation import Array

DEEPEST = 64
"""Tables and lists in each other, of TOML and JSON."""


# ------------------------------------------------------------------ TOML and JSON
def read_toml(source: str | os.PathLike[str]) -> tuple[dict[str, Any], Path | None]:
    """The table of a TOML file, or of a text, and the file's path (None for a text).

    A string with a line break is a text, and so is one with an equals sign that does not end in ``.toml``.
    Raises OSError for a file that cannot be read and ValueError for what is no TOML.
    """
    path = None
    try:
        if isinstance(source, str) and ("\n" in source or ("=" in source and not source.endswith(".toml"))):
            content = source
        else:
            path = Path(source)
            content = path.read_text(encoding="utf-8")
        table = tomllib.loads(content.removeprefix("\ufeff"))  # some editors put a byte order mark before a text
        return _shallow(table), path
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path or 'text'}: not a TOML file: {_why(error)}") from None


def from_json(text: str, path: str) -> Any:
    """What a JSON text holds. ValueError with a sentence that begins with `path` for what is none."""
    try:
        return _shallow(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise check.InvalidValue(path, text, f"damaged, not JSON ({_why(error)})") from None


def read_json(path: str | os.PathLike[str]) -> Any:
    """What a JSON file holds. Raises ValueError that names the file where it cannot be read, or is none."""
    try:
        return _shallow(json.loads(Path(path).read_text("utf-8")))
    except OSError as error:
        raise ValueError(f"{os.fspath(path)}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{os.fspath(path)}: damaged, not JSON ({_why(error)})") from None


def _shallow(value: Any) -> Any:
    """The value; ValueError where it is nested deeper than what reads it may go."""
    level = [value]
    for _ in range(DEEPEST):
        level = [inner for one in level for inner in _inside(one)]
        if not level:
            return value
    raise ValueError(f"nested more than {DEEPEST} deep")


def _inside(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _why(error: BaseException) -> str:
    return f"nested more than {DEEPEST} deep" if isinstance(error, RecursionError) else str(error)


# ------------------------------------------------------------------ CSV
def csv_lines(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], list[list[str]]]:
    """Names in the first line of a CSV file, and the cells of the others; empty lines are left out.

    Files that end in .gz are unpacked. Raises OSError where the file cannot be read, ValueError that names it where it
    is no text.
    """
    try:
        opened = gzip.open if os.fspath(path).endswith(".gz") else open
        with opened(path, "rt", newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line]
    except (UnicodeDecodeError, csv.Error, gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{os.fspath(path)}: not a CSV file: {error}") from None
    return (tuple(name.strip() for name in lines[0]), lines[1:]) if lines else ((), [])


def listed(header: tuple[str, ...]) -> str:
    """The names of columns in a sentence, as many as fit."""
    text = ", ".join(header) or "none"
    return text if len(text) <= 300 else text[:297] + "..."


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


# ------------------------------------------------------------------ NPZ
_HEADER = re.compile(
    r"\{'descr': '(?P<type>[<>|=]?(?:f[248]|[iu][1248]|b1|U\d{1,9}))', 'fortran_order': (?P<columns>True|False), "
    r"'shape': \((?P<shape>(?:\d{1,18}, ?)*(?:\d{1,18})?)\), \} *\n"
)
"""What NumPy writes before numbers, bools and texts; matched, not evaluated: a header may hold any expression."""


def npz_names(path: str | os.PathLike[str], what: str) -> tuple[str, ...]:
    """Names of the arrays in an .npz file. what, errors: as of :func:`read_npz`."""
    with _archive(path, what) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def read_npz(path: str | os.PathLike[str], what: str, most: int | None = None) -> dict[str, Any]:
    """The arrays of an .npz file by name: numbers, bools or texts, each as long as its header says.

    what: the file is to be, in a sentence: "trajectory". most: bytes that it may unpack to. Raises OSError where the
    file cannot be read, ValueError that names it for all else.
    """
    with _archive(path, what) as archive:
        size = sum(info.file_size for info in archive.infolist())
        if most is not None and size > most:
            raise ValueError(f"unpacks to {size} bytes, and no {what} has more than {most}")
        return {info.filename.removesuffix(".npy"): _array(archive, info) for info in archive.infolist()}


@contextmanager
def _archive(path: str | os.PathLike[str], what: str) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except Exception as error:  # damage shows itself in as many kinds as zipfile and zlib have
        if isinstance(error, OSError) and error.filename is not None:
            raise
        why = str(error) or type(error).__name__
        raise ValueError(f"{os.fspath(path)}: damaged, or no {what} of this package ({why})") from None


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    """An array of an archive. Its header is held against the room that it takes there before any is made for it."""
    with archive.open(info) as file:
        start = file.read(8)
        size = {b"\x93NUMPY\x01": 2, b"\x93NUMPY\x02": 4, b"\x93NUMPY\x03": 4}.get(start[:7], 0)
        header = file.read(int.from_bytes(file.read(size), "little")) if size else b""
        found = _HEADER.fullmatch(header.decode("latin-1"))
        if found is None:
            raise ValueError(f"{info.filename} is no array of numbers or text")
        shape = tuple(int(n) for n in found["shape"].split(",") if n.strip())
        dtype, count = np.dtype(found["type"]), 1
        for length in shape:
            count *= length
        left = info.file_size - len(start) - size - len(header)
        if count * dtype.itemsize != left:
            what = f"{shape} of {dtype}, {count * dtype.itemsize} bytes, and has {left}"
            raise ValueError(f"{info.filename} says it is {what}")
        data = file.read()
    if dtype.kind == "b":
        data = np.frombuffer(data, np.uint8).astype(np.bool_).tobytes()  # a bool is 0 or 1
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if found["columns"] == "True" else "C")
    if dtype.kind == "U":
        "".join(values.ravel().tolist()).encode()  # texts that can be written again
    return values.astype(dtype.newbyteorder("="))


# ------------------------------------------------------------------ writing
def to_file(flag: str, path: str | os.PathLike[str], endings: tuple[str, ...] = ()) -> Path:
    """The path of an output, its folder made: what cannot be written is told before a long run."""
    file = Path(path)
    if endings and file.suffix.lower() not in endings:
        raise check.InvalidValue(flag, os.fspath(path), f"must end in {' or '.join(endings)}")
    if file.is_dir():
        raise check.InvalidValue(flag, os.fspath(path), "must be a file, and this is a folder")
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def to_folder(flag: str, path: str | os.PathLike[str]) -> Path:
    """The same of a folder, which is made."""
    folder = Path(path)
    if folder.is_file():
        raise check.InvalidValue(flag, os.fspath(path), "must be a folder, and this is a file")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_whole(path: Path, content: bytes | Callable[[Path], Any]) -> None:
    """Write `content`, or what it makes of a file of the same suffix, to `path`, completely or not at all.

    The folder is made. A device or a pipe is written to as it is. OSError with the path where that cannot be done.
    """
    apart = path.is_dir() or path.is_file() or not path.exists()
    part = path.with_name(f".part-{os.getpid()}-{path.name}") if apart else path  # of this process alone
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write = content if callable(content) else lambda part: part.write_bytes(content)
        write(part)
        if apart:
            part.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), os.fspath(path)) from error
    finally:
        with suppress(OSError):
            if apart:
                part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """The same of a text."""
    write_whole(path, text.encode())


def write_json(path: Path, content: Any) -> None:
    """The same of JSON."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def table(columns: str, rows: Iterable[Iterable[object]] = (), numbers: bool = False) -> list[str]:
    """Lines of a Markdown table; columns: their heads between bars; numbers: all but the first to the right."""
    rule = "|---|" + ("---:|" if numbers else "---|") * columns.count(" | ")
    return [f"| {columns} |", rule, *("| " + " | ".join(map(str, row)) + " |" for row in rows)]


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as an .npz file, whole or not at all. Raises OSError."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_whole(path, buffer.getvalue())
