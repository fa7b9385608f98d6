"""What names of a kernel stand for while it is compiled.

Numbers and arrays of run time are `symbols.Value` (float64 or lanes) and the classes below; whatever else a kernel
meets, None, sizes, tags, functions, strings, Python's own numbers, is known at compile time and stands for itself.

    leaves(item)       the LLVM values that an item is made of
    rebuilt(item, it)  the same item of other LLVM values
    kind(item)         what compiled code depends on: the same for items that the same code serves
    Layout             where the parts of a named tuple lie in a row of words of eight bytes (see `entry`)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from .symbols import DOUBLE, Value

WORD, BIT, BYTE, SINGLE_PRECISION = ir.IntType(64), ir.IntType(1), ir.IntType(8), ir.FloatType()
NUMBERS = {"f": DOUBLE, "i": WORD, "u": WORD, "b": BYTE, "g": SINGLE_PRECISION}
"""LLVM types of what arrays hold: float64, int64, uint64, uint8 (also bool), float32."""
LETTERS = {"float64": "f", "int64": "i", "uint64": "u", "uint8": "b", "bool": "b", "float32": "g"}


class Refused(TypeError):
    """What the language of kernels does not have; the message says where it stands."""

    placed = False


@dataclass(slots=True, eq=False)
class Integer:
    """A whole number of 64 bits; unsigned: np.uint64."""

    value: Any
    unsigned: bool = False


@dataclass(slots=True, eq=False)
class Truth:
    """True or False, of run time."""

    value: Any


@dataclass(slots=True, eq=False)
class Narrow:
    """A float32 (letter g) or an uint8 (b) on its way from or to an array."""

    value: Any
    letter: str


@dataclass(slots=True, eq=False)
class Array:
    """A C-contiguous array: the address of its first number, its shape, the letter of its numbers.

    fixed: nobody may write to it, as it is global or NumPy says so.
    """

    data: Any
    shape: tuple[Any, ...]
    letter: str
    fixed: bool

    def written(self) -> None:
        """Refused: it is fixed."""
        if self.fixed:
            raise Refused("an array that is global or read-only is written to: give the kernel one of its own")


@dataclass(slots=True, eq=False)
class Record:
    """A named tuple that a kernel has made."""

    instance_class: Any
    values: list[Any]


class Stored:
    """A named tuple that lies at an address; its parts are read where they are used."""

    __slots__ = ("address", "instance_class", "layout")

    def __init__(self, address: Any, layout: Layout) -> None:
        self.address, self.layout, self.instance_class = address, layout, layout.instance_class


class Layout:
    """Where the parts of a named tuple lie. parts: name -> (what it is, its first word); words: how many there are.

    There is one for each kind of named tuple: compared by identity.
    """

    _known: dict[Any, Layout] = {}  # noqa: RUF012

    def __init__(self, instance_class: Any, parts: dict[str, tuple[Any, int]], words: int, text: str) -> None:
        self.instance_class, self.parts, self.words, self._text = instance_class, parts, words, text

    def __repr__(self) -> str:
        return self._text  # the same in every process: programs on disk are told apart by it

    @classmethod
    def of(cls, value: Any) -> Layout:
        """Of a named tuple of arrays, numbers, None, tuples and named tuples. TypeError: it holds something else."""
        parts, at = {}, 0
        for name, part in zip(value._fields, value, strict=True):
            shape = described_as(part, name)
            parts[name] = shape, at
            at += width(shape)
        key = (type(value), tuple(parts.values()))
        if key not in cls._known:
            shapes = [(name, shape) for name, (shape, _) in parts.items()]
            text = f"{type(value).__module__}.{type(value).__qualname__}{shapes}"
            cls._known[key] = cls(type(value), parts, at, text)
        return cls._known[key]


def described_as(part: Any, name: str) -> Any:
    """What a part of a named tuple is; named tuples lie within the one that holds them."""
    if part is None:
        return "none"
    if isinstance(part, bool | np.bool_):
        return "truth"
    if isinstance(part, int | np.integer):
        return "unsigned" if isinstance(part, np.uint64) else "integer"
    if isinstance(part, float | np.floating):
        return "number"
    if isinstance(part, np.ndarray):
        letter, flags = LETTERS.get(part.dtype.name), part.flags
        if letter is None or not flags.c_contiguous or not flags.aligned or not part.dtype.isnative or part.ndim == 0:
            raise TypeError(
                f"{name}: an array of {part.dtype.str}, shape {part.shape}, strides {part.strides}: kernels take "
                f"C-contiguous arrays of one dimension or more, of {', '.join(LETTERS)} in the machine's order of bytes"
            )
        if not isinstance(part, np.memmap) and type(part) is not np.ndarray:
            raise TypeError(f"{name}: {type(part).__name__}: a kernel takes plain arrays (np.asarray makes one)")
        return (letter, part.ndim) if flags.writeable else (letter, part.ndim, "fixed")
    if isinstance(part, tuple):
        if hasattr(part, "_fields"):
            return Layout.of(part)
        if is_tag(part):
            return ("tag", len(part))
        return ("tuple", tuple(described_as(x, name) for x in part))
    raise TypeError(f"{name}: {type(part).__name__}: a kernel is given arrays, numbers, None and tuples of these")


def width(shape: Any) -> int:
    """How many words a part of a named tuple takes."""
    if isinstance(shape, Layout):
        return shape.words
    if isinstance(shape, str):
        return 0 if shape == "none" else 1
    if shape[0] == "tag":
        return 0
    return sum(map(width, shape[1])) if shape[0] == "tuple" else 1 + int(shape[1])


def words_of(value: Any) -> list[int]:
    """A named tuple, or a part of one, as it lies in memory."""
    if isinstance(value, tuple):
        return [] if is_tag(value) and not hasattr(value, "_fields") else [w for part in value for w in words_of(part)]
    if isinstance(value, np.ndarray):
        return [value.__array_interface__["data"][0], *value.shape]
    if value is None:
        return []
    if isinstance(value, float | np.floating):
        return [int(np.float64(value).view(np.int64))]
    return [int(np.int64(np.uint64(value))) if isinstance(value, np.uint64) else int(value)]


def is_tag(item: Any) -> bool:
    """Whether a tuple stands for its length: a lane tag or a size, all of zeros."""
    return all(type(x) is int and x == 0 for x in item)


def is_static(item: Any) -> bool:
    """Whether an item is known when the kernel is compiled."""
    if is_tuple(item):
        return all(map(is_static, item))
    return not isinstance(item, Value | Integer | Truth | Narrow | Array | Record | Stored)


def is_tuple(item: Any) -> bool:
    """Whether an item is a plain tuple."""
    return type(item) is tuple


def leaves(item: Any) -> list[Any]:
    """LLVM values that an item is made of."""
    if isinstance(item, Value):
        return item.parts(item.count, len(item.tangents))
    if isinstance(item, Integer | Truth | Narrow):
        return [item.value]
    if isinstance(item, Array):
        return [item.data, *item.shape]
    if isinstance(item, Record):
        return [leaf for x in item.values for leaf in leaves(x)]
    if isinstance(item, Stored):
        return [item.address]
    if is_tuple(item):
        return [leaf for x in item for leaf in leaves(x)]
    return []


def rebuilt(item: Any, it: Iterator[Any], builder: Any) -> Any:
    """The same item of other LLVM values."""
    if isinstance(item, Value):
        return Value.of(builder, [next(it) for _ in (item, *item.tangents)], item.count)
    if isinstance(item, Integer):
        return Integer(next(it), item.unsigned)
    if isinstance(item, Truth):
        return Truth(next(it))
    if isinstance(item, Narrow):
        return Narrow(next(it), item.letter)
    if isinstance(item, Array):
        return Array(next(it), tuple(next(it) for _ in item.shape), item.letter, item.fixed)
    if isinstance(item, Record):
        return Record(item.instance_class, [rebuilt(x, it, builder) for x in item.values])
    if isinstance(item, Stored):
        return Stored(next(it), item.layout)
    if is_tuple(item):
        return tuple(rebuilt(x, it, builder) for x in item)
    return item


def kind(item: Any) -> Any:
    """What compiled code depends on, hashable; of what is known at compile time, itself."""
    if isinstance(item, Value):
        return ("value", item.count, len(item.tangents))
    if isinstance(item, Integer):
        return ("integer", item.unsigned)
    if isinstance(item, Truth):
        return ("truth",)
    if isinstance(item, Narrow):
        return ("narrow", item.letter)
    if isinstance(item, Array):
        return ("array", item.letter, len(item.shape), item.fixed)
    if isinstance(item, Record):
        return ("record", item.instance_class, tuple(map(kind, item.values)))
    if isinstance(item, Stored):
        return ("stored", item.layout)
    if is_tuple(item) and not is_tag(item):  # item by item: (1, True) equals (1, 1), and is not the same
        return ("tuple", tuple(map(kind, item)))
    return ("static", type(item), item)


def told(item: Any) -> str:
    """An item in a sentence."""
    if isinstance(item, Value):
        lanes = "a number" if item.count == 1 else f"{item.count} lanes"
        return f"{lanes} with {len(item.tangents)} tangents" if item.tangents else lanes
    names = {Integer: "a whole number", Truth: "a truth value", Array: "an array"}
    for cls, name in names.items():
        if isinstance(item, cls):
            return name
    if isinstance(item, Narrow):
        return "a float32" if item.letter == "g" else "an uint8"
    if isinstance(item, Record | Stored):
        return f"a {item.instance_class.__name__}"
    if is_tuple(item):
        return f"a tuple of {len(item)}"
    return repr(item)
