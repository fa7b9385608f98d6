"""Relocatable image of a placed named tuple: words and arrays that an exported library can load at any address."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .kinds import Layout, is_tag, words_of

LINE = 64
"""Bytes of a cache line; every array begins on a cache line."""


@dataclass
class Image:
    """Words of a named tuple (see `entry.Placed`) with the arrays that they point to.

    Attributes:
        layout: memory layout of the named tuple.
        words: the named tuple as 64-bit words, with 0 in place of each array address.
        pointers: pairs (word, byte); the loader must set words[word] to the address of data[byte].
        data: bytes of all arrays, each of which begins on a cache line.
        changing: number of bytes at the start of data that compiled code may write to.
        places: dict from the dotted name of an array to (first byte in data, shape, NumPy dtype name).
    """

    layout: Layout
    words: list[int] = field(default_factory=list)
    pointers: list[tuple[int, int]] = field(default_factory=list)
    data: bytes = b""
    changing: int = 0
    places: dict[str, tuple[int, tuple[int, ...], str]] = field(default_factory=dict)

    @classmethod
    def of(cls, value: Any, written: Collection[str]) -> Image:
        """Make the image of a named tuple.

        value: the named tuple. written: dotted names of the arrays that compiled code writes to.

        Read-only arrays that share memory are stored once.
        """
        image, arrays = cls(Layout.of(value)), list[tuple[str, int, Any]]()
        for name, part in _parts("", value):
            if isinstance(part, np.ndarray):
                # address 0, to be relocated, then the shape
                arrays.append((name, len(image.words), part))
                image.words += [0, *part.shape]
            else:
                image.words += words_of(part)
        # writable arrays first, then read-only ones
        data, known = bytearray(), dict[tuple[int, int], int]()
        for changes in (True, False):
            for name, word, array in arrays:
                if (name in written) == changes:
                    # identity of the memory: read-only arrays may share it
                    kept = array.__array_interface__["data"][0], array.nbytes
                    if kept not in known or changes:
                        data += bytes(-len(data) % LINE)
                        known[kept] = len(data)
                        data += array.tobytes()
                    # relocation of the word that holds the array's address
                    image.pointers.append((word, known[kept]))
                    image.places[name] = known[kept], array.shape, array.dtype.name
            if changes:
                data += bytes(-len(data) % LINE)
                image.changing = len(data)
        image.data = bytes(data)
        return image


def _parts(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, part) of all arrays and numbers of a named tuple, in the order of its words."""
    if isinstance(value, tuple):
        if hasattr(value, "_fields"):
            for name, part in zip(value._fields, value, strict=True):
                yield from _parts(f"{path}.{name}" if path else name, part)
        elif not is_tag(value):
            for k, part in enumerate(value):
                yield from _parts(f"{path}[{k}]", part)
    elif value is not None:
        yield path, value
