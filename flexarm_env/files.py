"""Read and write users' files: TOML, JSON, CSV, and NPZ archives of arrays.

A file is read as a whole, and nothing in it is executed. Invalid content raises a ValueError that names the file. If
the operating system cannot open a file, an OSError names the file.
"""

import csv
import gzip
import importlib
import io
import json
import os
import re
import sys
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

MOST_CODE = 0x10FFFF
"""Largest code point of Unicode."""
DEEPEST = 64
"""Largest nesting depth of tables and lists in TOML and JSON."""


# ------------------------------------------------------------------ TOML and JSON
def read_toml(source: str | os.PathLike[str]) -> tuple[dict[str, Any], Path | None]:
    """Return the content of a TOML file or text as a dict, and the path of the file (None for a text).

    A string is a TOML text if it contains a line break, or if it contains an equals sign and does not end in ``.toml``.
    Any other string is a path.

    Raises:
        OSError: the file cannot be read. ValueError: the content is not TOML.
    """
    path = None
    try:
        if isinstance(source, str) and ("\n" in source or ("=" in source and not source.endswith(".toml"))):
            content = source
        else:
            path = Path(source)
            content = path.read_text(encoding="utf-8")
        # some editors write a byte order mark
        table = tomllib.loads(content.removeprefix("\ufeff"))
        return _shallow(table), path
    except (ValueError, RecursionError) as error:
        why = f"not a TOML file: {_why(error)}"
        raise (check.Unreadable("", why) if path is None else ValueError(f"{path}: {why}")) from None


def from_json(text: str, path: str) -> Any:
    """Parse a JSON text; if it is invalid, raise ValueError with a message that begins with `path`."""
    try:
        return _shallow(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise check.InvalidValue(path, text, f"damaged, not JSON ({_why(error)})") from None


def read_json(path: str | os.PathLike[str]) -> Any:
    """Parse a JSON file; if it is unreadable or invalid, raise ValueError with a message that names the file."""
    try:
        return _shallow(json.loads(Path(path).read_text("utf-8")))
    except OSError as error:
        raise ValueError(f"{os.fspath(path)}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{os.fspath(path)}: damaged, not JSON ({_why(error)})") from None


def _shallow(value: Any) -> Any:
    """Return the value; raise ValueError if the value is nested deeper than `DEEPEST`."""
    level = [value]
    for _ in range(DEEPEST):
        level = [inner for one in level for inner in _inside(one)]
        if not level:
            return value
    raise ValueError(f"nested more than {DEEPEST} deep")


def _inside(value: Any) -> Iterable[Any]:
    """Return the values in a dict or list; () for any other value."""
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _why(error: BaseException) -> str:
    """Return the reason for a parser's error as a phrase."""
    return f"nested more than {DEEPEST} deep" if isinstance(error, RecursionError) else str(error)


# ------------------------------------------------------------------ CSV
def csv_lines(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], list[list[str]]]:
    """Read a CSV file: return the column names from the first line, and the cells of the other lines.

    Empty lines are skipped. A file whose name ends in .gz is decompressed.

    Raises:
        OSError: the file cannot be read. ValueError: the file is not a CSV text; the message names the file.
    """
    try:
        opened = gzip.open if os.fspath(path).endswith(".gz") else open
        with opened(path, "rt", newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line]
    except (UnicodeDecodeError, csv.Error, gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{os.fspath(path)}: not a CSV file: {error}") from None
    return (tuple(name.strip() for name in lines[0]), lines[1:]) if lines else ((), [])


def unit_of(column: str) -> str:
    """Return the unit of a column of a trajectory's CSV file, such as "m" for tip_x; "" for dimensionless columns."""
    name = column.rstrip("0123456789")
    if name in ("t", "energy"):
        return {"t": "s", "energy": "J"}[name]
    if name.endswith("_rate"):
        return "rad/s"
    if name in ("joint", "motor", "twist") or name.endswith("_angle"):
        return "rad"
    return "m" if name.endswith(("_x", "_y", "_z")) and not name.startswith("deflection") else ""


def without_units(header: tuple[str, ...]) -> tuple[str, ...]:
    """Return column names without units in brackets: "tip_x" for "tip_x (m)"."""
    return tuple(re.sub(r" \([^()]*\)$", "", name) for name in header)


def listed(header: tuple[str, ...]) -> str:
    """Join column names to a text of at most 300 characters; "none" for an empty list."""
    text = ", ".join(header) or "none"
    return text if len(text) <= 300 else text[:297] + "..."


def numbers(k: int, name: str, lines: list[list[str]], columns: int) -> Array:
    """Convert column k of a table to an array (n,); a ValueError names row and column of an invalid number."""
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
"""Pattern of NumPy's header for numbers, bools and texts.

The header is matched and not evaluated, because it may contain any expression.
"""


def npz_names(path: str | os.PathLike[str], what: str) -> tuple[str, ...]:
    """Return the names of the arrays in an .npz file. Raises the errors of :func:`read_npz`.

    what: noun for error messages, for example "trajectory".
    """
    with _archive(path, what) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def read_npz(path: str | os.PathLike[str], what: str, most: int | None = None) -> dict[str, Any]:
    """Read the arrays of an .npz file by name; they contain numbers, bools or texts.

    The size of each array is checked before memory is allocated.

    Args:
        what: noun for error messages, for example "trajectory". most: largest unpacked size in bytes, or None for no
            limit.
    Raises:
        OSError: the file cannot be read. ValueError: invalid content; the message names the file.
    """
    with _archive(path, what) as archive:
        size = sum(info.file_size for info in archive.infolist())
        if most is not None and size > most:
            raise ValueError(f"unpacks to {size} bytes, and no {what} has more than {most}")
        return {info.filename.removesuffix(".npy"): _array(archive, info) for info in archive.infolist()}


@contextmanager
def _archive(path: str | os.PathLike[str], what: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive for a `with` block; if its content is damaged, raise ValueError that names the file."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except Exception as error:
        # zipfile and zlib raise many kinds of errors for damage
        if isinstance(error, OSError) and error.filename is not None:
            raise
        why = (str(error) or type(error).__name__)[:200]  # zipfile quotes the directory that it cannot read
        raise ValueError(f"{os.fspath(path)}: damaged, or no {what} of this package ({why})") from None


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    """Read one array of an archive.

    Memory is allocated only after the check that the array's declared size equals the number of bytes present.
    """
    with archive.open(info) as file:
        # header: magic, version (2 or 4 bytes of length), dictionary
        start = file.read(8)
        size = {b"\x93NUMPY\x01": 2, b"\x93NUMPY\x02": 4, b"\x93NUMPY\x03": 4}.get(start[:7], 0)
        header = file.read(int.from_bytes(file.read(size), "little")) if size else b""
        found = _HEADER.fullmatch(header.decode("latin-1"))
        if found is None:
            raise ValueError(f"{info.filename} is no array of numbers or text")
        # the product of shape and item size must be exactly the bytes left
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
    # reject code points above Unicode's range, and surrogates, which cannot be encoded
    if dtype.kind == "U":
        if (np.frombuffer(data, f"{dtype.byteorder}u4") > MOST_CODE).any():
            raise ValueError(f"{info.filename} contains an invalid character")  # Python would make a broken text of it
        # raises for surrogates
        "".join(values.ravel().tolist()).encode()
    return values.astype(dtype.newbyteorder("="))


# ------------------------------------------------------------------ writing
def to_file(flag: str, path: str | os.PathLike[str], endings: tuple[str, ...] = ()) -> Path:
    """Return the path of an output file and create its folder, so that an invalid path fails before a long run.

    Args:
        flag: name of the argument for the error message. endings: permitted suffixes; () permits any suffix.
    Raises:
        ValueError: the suffix is not permitted, or the path is a folder.
    """
    file = Path(path)
    if endings and file.suffix.lower() not in endings:
        raise check.InvalidValue(flag, os.fspath(path), f"must end in {' or '.join(endings)}")
    if file.is_dir():
        raise check.InvalidValue(flag, os.fspath(path), "must be a file, and this is a folder")
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def to_folder(flag: str, path: str | os.PathLike[str]) -> Path:
    """Create an output folder and return its path; if the path is a file, raise ValueError with a message on `flag`."""
    folder = Path(path)
    if folder.is_file():
        raise check.InvalidValue(flag, os.fspath(path), "must be a folder, and this is a file")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_whole(path: Path, content: bytes | Callable[[Path], Any]) -> None:
    """Write `content` to `path` atomically: first to a temporary file in the same folder, which is then renamed.

    content: bytes, or a function that writes a file with the same suffix to a given path. The folder of `path` is
    created. Devices and pipes are written directly.

    Raises:
        OSError: writing failed; the error contains the path.
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
    """Write a text in UTF-8 to `path` atomically."""
    write_whole(path, text.encode())


def write_json(path: Path, content: Any) -> None:
    """Write JSON with an indent of 2 spaces to `path` atomically."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def table(columns: str, rows: Iterable[Iterable[object]] = (), numbers: bool = False) -> list[str]:
    """Return the lines of a Markdown table.

    Args:
        columns: heads of the columns, separated by " | ". rows: cells of each row. numbers: True to align all columns
            except the first to the right.
    """
    rule = "|---|" + ("---:|" if numbers else "---|") * columns.count(" | ")
    return [f"| {columns} |", rule, *("| " + " | ".join(map(str, row)) + " |" for row in rows)]


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as a compressed .npz file atomically. Raises OSError if writing fails."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_whole(path, buffer.getvalue())


def imported(path: str, word: str) -> Any:
    """Import the object that `word` names as "module:name"; the module may be in the current folder.

    Raises ValueError if the object cannot be imported; the message begins with the key path `path`.
    """
    module, _, name = word.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path} {word}: cannot be imported ({in_words(error)})") from None
    return found


def in_words(error: BaseException) -> str:
    """Return an error as one line of text, with at most 200 characters of its message."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}".removesuffix(": ")
