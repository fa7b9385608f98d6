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


class Integer:
    """A whole number of 64 bits; unsigned: np.uint64."""

    __slots__ = ("unsigned", "value")

    def __init__(self, value: Any, unsigned: bool = False) -> None:
        self.value, self.unsigned = value, unsigned


class Truth:
    """True or False, of run time."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value


class Narrow:
    """A float32 (letter g) or an uint8 (b) on its way from or to an array."""

    __slots__ = ("letter", "value")

    def __init__(self, value: Any, letter: str) -> None:
        self.value, self.letter = value, letter


class Array:
    """A C-contiguous array: the address of its first number, its shape, the letter of its numbers.

    fixed: nobody may write to it, as it is global or NumPy says so.
    """

    __slots__ = ("data", "fixed", "letter", "shape")

    def __init__(self, data: Any, shape: tuple[Any, ...], letter: str, fixed: bool) -> None:
        self.data, self.shape, self.letter, self.fixed = data, shape, letter, fixed

    def written(self) -> None:
        """Refused: it is fixed."""
        if self.fixed:
            raise Refused("an array that is global or read-only is written to: give the kernel one of its own")


class Record:
    """A named tuple that a kernel has made."""

    __slots__ = ("instance_class", "values")

    def __init__(self, instance_class: type, values: list[Any]) -> None:
        self.instance_class, self.values = instance_class, values


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

    def __init__(self, instance_class: type, parts: dict[str, tuple[Any, int]], words: int, text: str) -> None:
        self.instance_class, self.parts, self.words, self.text = instance_class, parts, words, text

    @classmethod
    def of(cls, value: Any) -> Layout:
        """Of a named tuple of arrays, numbers, None, tuples and named tuples. TypeError: it holds something else."""
        names, described, at = [], [], 0
        for name, part in zip(value._fields, value, strict=True):
            shape, words = described_as(part, name)
            names.append(name)
            described.append((shape, at))
            at += words
        key = (type(value), tuple(described))
        if key not in cls._known:
            parts = dict(zip(names, described, strict=True))
            shapes = [(name, shape.text if isinstance(shape, Layout) else shape) for name, (shape, _) in parts.items()]
            text = f"{type(value).__module__}.{type(value).__qualname__}{shapes}"
            cls._known[key] = cls(type(value), parts, at, text)
        return cls._known[key]


def described_as(part: Any, name: str) -> tuple[Any, int]:
    """What a part of a named tuple is, and how many words it takes; named tuples lie within the one that holds them."""
    if part is None:
        return "none", 0
    if isinstance(part, bool | np.bool_):
        return "truth", 1
    if isinstance(part, int | np.integer):
        return ("unsigned" if isinstance(part, np.uint64) else "integer"), 1
    if isinstance(part, float | np.floating):
        return "number", 1
    if isinstance(part, np.ndarray):
        letter, flags = LETTERS.get(part.dtype.name), part.flags
        if letter is None or not flags.c_contiguous or not flags.aligned or not part.dtype.isnative or part.ndim == 0:
            raise TypeError(
                f"{name}: an array of {part.dtype.str}, shape {part.shape}, strides {part.strides}: kernels take "
                f"C-contiguous arrays of one dimension or more, of {', '.join(LETTERS)} in the machine's order of bytes"
            )
        if not isinstance(part, np.memmap) and type(part) is not np.ndarray:
            raise TypeError(f"{name}: {type(part).__name__}: a kernel takes plain arrays (np.asarray makes one)")
        return (letter, part.ndim) if flags.writeable else (letter, part.ndim, "fixed"), 1 + part.ndim
    if isinstance(part, tuple):
        if hasattr(part, "_fields"):
            layout = Layout.of(part)
            return layout, layout.words
        if is_tag(part):
            return ("tag", len(part)), 0
        inner = [described_as(x, name) for x in part]
        return ("tuple", tuple(shape for shape, _ in inner)), sum(words for _, words in inner)
    raise TypeError(f"{name}: {type(part).__name__}: a kernel is given arrays, numbers, None and tuples of these")


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
    if isinstance(item, Value | Integer | Truth | Narrow | Array | Record | Stored):
        return False
    return not (type(item) is tuple and not all(map(is_static, item)))


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
    if type(item) is tuple and not is_static(item):
        return [leaf for x in item for leaf in leaves(x)]
    return []


def rebuilt(item: Any, it: Iterator[Any], builder: Any) -> Any:
    """The same item of other LLVM values."""
    if isinstance(item, Value):
        first = Value(builder, next(it), item.count)
        return first.having([Value(builder, next(it), item.count) for _ in item.tangents])
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
    if type(item) is tuple and not is_static(item):
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
    if type(item) is tuple and not is_tag(item):  # item by item: (1, True) equals (1, 1), and is not the same
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
    if type(item) is tuple:
        return f"a tuple of {len(item)}"
    return repr(item)


def width(shape: Any) -> int:
    """How many words a part of a named tuple takes."""
    if isinstance(shape, Layout):
        return shape.words
    if isinstance(shape, str):
        return 0 if shape == "none" else 1
    if shape[0] == "tag":
        return 0
    return sum(map(width, shape[1])) if shape[0] == "tuple" else 1 + int(shape[1])
