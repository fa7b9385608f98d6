"""Items: what the names and expressions of a kernel denote during compilation.

A symbolic item holds LLVM values known at run time: `symbols.Value` (float64 or lanes) and the classes below. A static
item is known at compile time and stands for itself: None, sizes, lane tags, functions, strings, Python's numbers.

    leaves(item)       the LLVM values that an item is made of
    rebuilt(item, it)  an item of the same kind made of other LLVM values
    kind(item)         specialization key: equal for items that the same compiled code serves
    Layout             places of a named tuple's fields in a row of 8-byte words (see `entry`)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

from .lane_arrays import lane_fields
from .symbols import DOUBLE, Value

WORD, BIT, BYTE, SINGLE_PRECISION = ir.IntType(64), ir.IntType(1), ir.IntType(8), ir.FloatType()
# one letter per element type
NUMBERS = {"f": DOUBLE, "i": WORD, "u": WORD, "b": BYTE, "t": BYTE, "g": SINGLE_PRECISION}
"""LLVM element types of arrays: float64, int64, uint64, uint8, bool, float32."""
LETTERS = {"float64": "f", "int64": "i", "uint64": "u", "uint8": "b", "bool": "t", "float32": "g"}


class Refused(TypeError):
    """Compile error: the source uses something outside the language of kernels.

    placed: True if the error message already names file and line.
    """

    placed = False


@dataclass(slots=True, eq=False)
class Integer:
    """64-bit integer at run time (LLVM i64). If `unsigned` is True, the integer has the meaning of np.uint64."""

    value: Any
    unsigned: bool = False


@dataclass(slots=True, eq=False)
class Truth:
    """Truth value at run time: an LLVM i1."""

    value: Any


@dataclass(slots=True, eq=False)
class Narrow:
    """A number np.float32(x) (letter g) or np.uint8(x) (letter b), which can be stored but not used in arithmetic."""

    value: Any
    letter: str


@dataclass(slots=True, eq=False)
class Array:
    """A C-contiguous array at run time.

    data: LLVM pointer to the first element. shape: one LLVM i64 per dimension. letter: element type, a key of NUMBERS.
    fixed: True if writing is refused, because the array is a global constant or read-only in NumPy.
    lane: the lane tag of an array of lanes, whose indices count elements of all lanes (`lane_arrays`). If lane is None,
    indices count single numbers.
    """

    data: Any
    shape: tuple[Any, ...]
    letter: str
    fixed: bool
    lane: Any = None

    def written(self) -> None:
        """Raise Refused if the array is fixed (global or read-only)."""
        if self.fixed:
            raise Refused("an array that is global or read-only is written to: give the kernel one of its own")


@dataclass(slots=True, eq=False)
class Record:
    """A named tuple that a kernel has made: its class and one item per field, as LLVM values and not in memory.

    lane: lane tag (see the module `lanes`) of the fields that the class annotates with `Lanes`. None means that all
        arrays hold single numbers.
    """

    instance_class: Any
    values: list[Any]
    lane: Any = None


class Stored:
    """A named tuple in memory at `address` with the `Layout` `layout`; fields are loaded where they are used.

    lane: lane tag of the fields that the class annotates with `Lanes`; None if all arrays hold single numbers.
    """

    __slots__ = ("address", "instance_class", "lane", "layout")

    def __init__(self, address: Any, layout: Layout, lane: Any = None) -> None:
        self.address, self.layout, self.lane, self.instance_class = address, layout, lane, layout.instance_class


SCALARS = (Integer, Truth, Narrow)
RECORDS = (Record, Stored)
RUN_TIME = (Value, *SCALARS, Array, *RECORDS)
"""Classes of symbolic items. `isinstance` is several times faster with a tuple than with a union made in each call."""


class Layout:
    """Memory layout of a named tuple in 8-byte words.

    instance_class: the named tuple's class.
    parts: dict from field name to (description by `described_as`, offset of the field's first word).
    words: length of the layout in 8-byte words. There is one Layout for each combination of class and field types, so
    that layouts are compared by identity.
    """

    _known: dict[Any, Layout] = {}  # noqa: RUF012

    def __init__(self, instance_class: Any, parts: dict[str, tuple[Any, int]], words: int, text: str) -> None:
        self.instance_class, self.parts, self.words, self._text = instance_class, parts, words, text

    def __repr__(self) -> str:
        # the same text in every process: cache keys of programs on disk contain it
        return self._text

    @classmethod
    def of(cls, value: Any) -> Layout:
        """Return the layout of a named tuple of arrays, numbers, None and tuples of arrays and numbers.

        Raises TypeError for a field of any other type.
        """
        parts, at = {}, 0
        for name, part in zip(value._fields, value, strict=True):
            shape = described_as(part, name)
            parts[name] = shape, at
            at += width(shape)
        # interned by class and field types, so that equal layouts are identical objects
        key = (type(value), tuple(parts.values()))
        if key not in cls._known:
            shapes = [(name, shape) for name, (shape, _) in parts.items()]
            text = f"{type(value).__module__}.{type(value).__qualname__}{shapes}"
            cls._known[key] = cls(type(value), parts, at, text)
        return cls._known[key]


def described_as(part: Any, name: str) -> Any:
    """Describe the type of an argument or field by a hashable value: a word, a tuple or a `Layout`.

    None, truth values and numbers are described as "none", "truth", "integer", "unsigned", "number". An array is
    described by (letter, number of dimensions), with "fixed" as a third entry if it is read-only. A lane tag or size is
    described by ("tag", length), and a tuple by ("tuple", descriptions of its parts). A named tuple is described by its
    Layout. If a tuple contains a named tuple, the words of the named tuple are a part of the tuple's words. Raises
    TypeError for any other type.
    name: field name for the error message.
    """
    if part is None:
        return "none"
    if isinstance(part, bool | np.bool_):
        return "truth"
    if isinstance(part, int | np.integer):
        return "unsigned" if isinstance(part, np.uint64) else "integer"
    if isinstance(part, float | np.floating):
        return "number"
    if isinstance(part, np.ndarray):
        # kernels compute element addresses from the shape alone, so the array must be contiguous and aligned
        letter, flags = LETTERS.get(part.dtype.name), part.flags
        if letter is None or not flags.c_contiguous or not flags.aligned or not part.dtype.isnative or part.ndim == 0:
            raise TypeError(
                f"{name}: an array of {part.dtype.str}, shape {part.shape}, strides {part.strides}: kernels take "
                f"C-contiguous arrays of one dimension or more, of {', '.join(LETTERS)} in the machine's order of bytes"
            )
        # subclasses may give indexing another meaning; memmap does not
        if not isinstance(part, np.memmap) and type(part) is not np.ndarray:
            raise TypeError(f"{name}: {type(part).__name__}: a kernel takes plain arrays (np.asarray makes one)")
        return (letter, part.ndim) if flags.writeable else (letter, part.ndim, "fixed")
    if isinstance(part, tuple):
        if hasattr(part, "_fields"):
            return Layout.of(part)
        if is_tag(part):
            # tags take no words: their length is part of the type
            return ("tag", len(part))
        return ("tuple", tuple(described_as(x, name) for x in part))
    raise TypeError(f"{name}: {type(part).__name__}: a kernel is given arrays, numbers, None and tuples of these")


def width(shape: Any) -> int:
    """Return the number of 8-byte words of a value of the type `shape`; an array takes 1 + dimensions words."""
    if isinstance(shape, Layout):
        return shape.words
    if isinstance(shape, str):
        return 0 if shape == "none" else 1
    # tags are part of the type and take no words
    if shape[0] == "tag":
        return 0
    return sum(map(width, shape[1])) if shape[0] == "tuple" else 1 + int(shape[1])


def words_of(value: Any) -> list[int]:
    """Return a value as a list of 64-bit integers in the order of its `Layout`.

    A float64 gives its bit pattern, an array its address and dimensions, a tuple the words of its parts. None and lane
    tags take no words in memory.
    """
    if isinstance(value, tuple):
        return [] if is_tag(value) and not hasattr(value, "_fields") else [w for part in value for w in words_of(part)]
    if isinstance(value, np.ndarray):
        return [value.__array_interface__["data"][0], *value.shape]
    if value is None:
        return []
    if isinstance(value, float | np.floating):
        # bit pattern of the float64
        return [int(np.float64(value).view(np.int64))]
    return [int(np.int64(np.uint64(value))) if isinstance(value, np.uint64) else int(value)]


def declared(item: Any, holds: bool | None, lane: Any) -> Any:
    """Return an argument or field as annotated: its indices count elements of all lanes, or single numbers.

    holds: True if the argument's annotation is `Lanes`, False for another type, None without annotation.
    lane: the kernel's lane tag, or None. Raises a compile error (`Refused`) if `Lanes` annotates an item other than a
    one-dimensional float64 array, None or a size.
    """
    if isinstance(item, Array):
        if holds and (item.letter != "f" or len(item.shape) != 1):
            raise Refused("`Lanes` are arrays of float64 in one dimension")
        return Array(item.data, item.shape, item.letter, item.fixed, lane if holds else None)
    if holds and (isinstance(item, int | float | str) or not is_static(item)):
        raise Refused(f"{told(item)} where `Lanes` are declared")
    if isinstance(item, Record):
        return Record(item.instance_class, item.values, None if holds is None else lane)
    if isinstance(item, Stored):
        return Stored(item.address, item.layout, None if holds is None else lane)
    if is_tuple(item) and not is_static(item):
        return tuple(declared(x, None, lane) for x in item)
    return item


def lane_tags(item: Any) -> list[Any]:
    """Return a list of the lane tags (or None) of all arrays, and named tuples with lane arrays, within an item."""
    if isinstance(item, Array):
        return [item.lane]
    # named tuples without fields of lanes are the same under every tag
    if isinstance(item, RECORDS):
        return [item.lane] if lane_fields(item.instance_class) else []
    return [tag for x in item for tag in lane_tags(x)] if is_tuple(item) else []


def is_tag(item: Any) -> bool:
    """Return whether `item` is a tuple of zeros: a lane tag or a size, each given by the length of the tuple."""
    return all(type(x) is int and x == 0 for x in item)


def is_static(item: Any) -> bool:
    """Return whether an item is known at compile time; all parts of a tuple must be known."""
    if is_tuple(item):
        return all(map(is_static, item))
    return not isinstance(item, RUN_TIME)


def is_tuple(item: Any) -> bool:
    """Return whether an item is a plain tuple, not a named tuple."""
    return type(item) is tuple


def leaves(item: Any) -> list[Any]:
    """Return a list of the LLVM values that an item consists of; the list is empty for static items."""
    if isinstance(item, Value):
        return item.parts(item.count, len(item.tangents))
    if isinstance(item, SCALARS):
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
    """Return an item of the same kind from the next LLVM values of the iterator `it`: the inverse of `leaves`."""
    if isinstance(item, Value):
        return Value.of(builder, [next(it) for _ in (item, *item.tangents)], item.count)
    if isinstance(item, Integer):
        return Integer(next(it), item.unsigned)
    if isinstance(item, Truth):
        return Truth(next(it))
    if isinstance(item, Narrow):
        return Narrow(next(it), item.letter)
    if isinstance(item, Array):
        return Array(next(it), tuple(next(it) for _ in item.shape), item.letter, item.fixed, item.lane)
    if isinstance(item, Record):
        return Record(item.instance_class, [rebuilt(x, it, builder) for x in item.values], item.lane)
    if isinstance(item, Stored):
        return Stored(next(it), item.layout, item.lane)
    if is_tuple(item):
        return tuple(rebuilt(x, it, builder) for x in item)
    return item


def kind(item: Any) -> Any:
    """Return the hashable specialization key of an item; items with equal keys share one compiled function.

    The key of a value of run time is its type (lanes, tangents, element type, class). The key of a static item is its
    type and value.
    """
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
    if is_tuple(item) and not is_tag(item):
        # part by part: (1, True) == (1, 1), but they compile to different code
        return ("tuple", tuple(map(kind, item)))
    return ("static", type(item), item)


def told(item: Any) -> str:
    """Describe an item in words for an error message."""
    if isinstance(item, Value):
        lanes = "a number" if item.count == 1 else f"{item.count} lanes"
        return f"{lanes} with {len(item.tangents)} tangents" if item.tangents else lanes
    if isinstance(item, Array) and item.lane is not None:
        return "an array of lanes"
    # wording of all error messages
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
