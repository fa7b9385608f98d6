"""A placed named tuple as data: what a library needs to have the same world as Python, at any address."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .kinds import Layout, is_tag, words_of

LINE = 64
"""Bytes of a cache line, on which every array begins."""


@dataclass
class Image:
    """Words of a named tuple, with the arrays that they point to; see `entry.Placed`.

    Attributes:
        words: as they lie in memory; where an array begins, 0. pointers: (word, byte): word `word` is the address of
            byte `byte` of the data. data: the arrays, one after the other. changing: bytes of the data, its first, that
            compiled code may write to. places: by dotted name, (first byte, shape, NumPy's name of the numbers).
    """

    layout: Layout
    words: list[int] = field(default_factory=list)
    pointers: list[tuple[int, int]] = field(default_factory=list)
    data: bytes = b""
    changing: int = 0
    places: dict[str, tuple[int, tuple[int, ...], str]] = field(default_factory=dict)

    @classmethod
    def of(cls, value: Any, written: Collection[str]) -> Image:
        """Of a named tuple. written: dotted names of the arrays that change; all others stay as they are."""
        image, arrays = cls(Layout.of(value)), list[tuple[str, int, Any]]()
        for name, part in _parts("", value):
            if isinstance(part, np.ndarray):
                arrays.append((name, len(image.words), part))
                image.words += [0, *part.shape]
            else:
                image.words += words_of(part)
        data, known = bytearray(), dict[tuple[int, int], int]()
        for changes in (True, False):
            for name, word, array in arrays:
                if (name in written) == changes:
                    kept = array.__array_interface__["data"][0], array.nbytes
                    if kept not in known or changes:
                        data += bytes(-len(data) % LINE)
                        known[kept] = len(data)
                        data += array.tobytes()
                    image.pointers.append((word, known[kept]))
                    image.places[name] = known[kept], array.shape, array.dtype.name
            if changes:
                data += bytes(-len(data) % LINE)
                image.changing = len(data)
        image.data = bytes(data)
        return image


def _parts(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Arrays and other things that take words, in the order of words, with dotted names."""
    if isinstance(value, tuple):
        if hasattr(value, "_fields"):
            for name, part in zip(value._fields, value, strict=True):
                yield from _parts(f"{path}.{name}" if path else name, part)
        elif not is_tag(value):
            for k, part in enumerate(value):
                yield from _parts(f"{path}[{k}]", part)
    elif value is not None:
        yield path, value
