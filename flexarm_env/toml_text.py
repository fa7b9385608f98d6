"""TOML files: read with errors that say which file, and written (the standard library only reads them)."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

INLINE_WIDTH = 110
BYTE_ORDER_MARK = "\ufeff"
"""What some editors put before a text."""


def read(source: str | os.PathLike[str]) -> tuple[dict[str, Any], Path | None]:
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
        return tomllib.loads(content.removeprefix(BYTE_ORDER_MARK)), path
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path or 'text'}: not a TOML file: {error}") from None


def write(table: Mapping[str, Any]) -> str:
    """TOML text of a table of texts, numbers, sequences and tables; a list of tables becomes ``[[...]]``."""
    lines: list[str] = []
    _write(lines, table, ())
    return "\n".join(lines).strip("\n") + "\n"


def _write(lines: list[str], table: Mapping[str, Any], path: tuple[str, ...]) -> None:
    nested = {key: value for key, value in table.items() if _is_nested(value)}
    for key, value in table.items():
        if key not in nested:
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in nested.items():
        name = ".".join(_key(part) for part in (*path, key))
        for entry in [value] if isinstance(value, Mapping) else value:
            lines += ["", f"[{name}]" if isinstance(value, Mapping) else f"[[{name}]]"]
            _write(lines, entry, (*path, key))


def _is_nested(value: Any) -> bool:
    """A table too long for one line, or a sequence of tables."""
    if isinstance(value, Mapping):
        deep = any(isinstance(entry, Mapping) for entry in value.values())
        return deep or ("kind" not in value and len(_value(value)) > 60)
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(entry, Mapping) for entry in value)


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        entries = [_value(entry) for entry in value]
        line = "[" + ", ".join(entries) + "]"
        return line if len(line) <= INLINE_WIDTH else "[\n    " + ",\n    ".join(entries) + ",\n]"
    raise TypeError(f"{value!r} has no place in a TOML file")
