"""A compiled function's whole world behind one whole number: no argument of a call from Python costs more than that.

`Placed` writes a named tuple of arrays and numbers into a row of words once; a kernel that begins with
`p = follow(address)` reads what it needs from there. The Python side keeps words and arrays alive and calls the
compiled function through `entry`, which is a function of C's that Python calls directly, or by its address (`native`).

Kernels can be called with arguments of all kinds as well (`call`): these are placed for the length of the call.
"""

import ctypes
import struct
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .decorator import UNCOMPILED, Kernel
from .kinds import Layout, described_as, words_of
from .program import Program, program_of

FAILED = -1
"""What no compiled step returns."""


class Placed:
    """A named tuple of arrays and numbers that compiled code reaches by `address`.

    Its arrays may be written to; to put another in the place of one, there is `replace`.
    """

    def __init__(self, value: Any) -> None:
        self.value = value  # keeps the arrays alive
        self.address: Any = value
        if UNCOMPILED:
            return
        self.layout = Layout.of(value)
        self._words = np.array(words_of(value), np.int64)
        self.address = int(self._words.ctypes.data)
        self._held: dict[str, Any] = {}

    def replace(self, name: str, array: Any) -> None:
        """Put a contiguous array of the same type and shape in the place of the value's array `name`."""
        if UNCOMPILED:
            self.address = self.value = self.value._replace(**{name: array.reshape(-1)})
            return
        self._held[name] = array
        self._words[self.layout.parts[name][1]] = array.__array_interface__["data"][0]  # where an array's words begin


def entry(function: Any, placed: Placed, *arguments: int) -> Callable[..., Any]:
    """The compiled form of `function(address, *arguments)`, at most two whole numbers; it returns one."""
    return function if UNCOMPILED else _direct(function, placed, arguments).call


def native(function: Any, placed: Placed, *arguments: int) -> int:
    """Where the machine code of the same function begins; 0 where nothing is compiled."""
    return 0 if UNCOMPILED else _direct(function, placed, arguments).address


def _direct(kernel: Kernel, placed: Placed, arguments: tuple[int, ...]) -> Program:
    key = ("direct", placed.layout, len(arguments))
    if key not in kernel.forms:
        shapes = [("placed", placed.layout), *["integer" for _ in arguments]]
        kernel.forms[key] = program_of(kernel, shapes, direct=True)
    found: Program = kernel.forms[key]
    return found


class _Kept(OrderedDict[int, tuple[Any, Placed]]):
    """Named tuples that have been placed, the last ones; by identity, which lasts as long as they are kept."""

    LIMIT = 256

    def place(self, value: Any) -> Placed:
        found = self.get(id(value))
        if found is None:
            found = self[id(value)] = value, Placed(value)
            while len(self) > self.LIMIT:
                try:
                    self.popitem(last=False)
                except KeyError:  # another thread was quicker
                    break
        return found[1]


_kept = _Kept()


def call(kernel: Kernel, items: Sequence[Any]) -> Any:
    """A kernel's result for arguments of any kind that kernels take. TypeError: another kind."""
    shapes: list[Any] = []
    letters, values, held = "", [], []
    for k, item in enumerate(items):
        cls = type(item)
        if cls is float:
            shapes.append("number")
            letters += "d"
            values.append(item)
        elif cls is int:
            shapes.append("integer")
            letters += "q"
            values.append(item)
        elif isinstance(item, tuple) and hasattr(item, "_fields"):
            placed = _kept.place(item)
            held.append(placed)
            shapes.append(("placed", placed.layout))
            letters += "q"
            values.append(placed.address)
        else:
            shapes.append(described_as(item, f"argument {k + 1} of {kernel.__name__}()"))
            more = words_of(item)
            letters += "q" * len(more)
            values += more
    key = tuple(shapes)
    form = kernel.forms.get(key)
    if form is None:
        form = kernel.forms[key] = program_of(kernel, shapes, direct=False)
    room = ctypes.create_string_buffer(8 * (len(values) + form.words))
    try:
        struct.pack_into(letters, room, 0, *values)
    except struct.error:
        big = next(x for x in values if isinstance(x, int) and not -(2**63) <= x < 2**63)
        raise OverflowError(f"{kernel.__name__}({big}): a whole number has 64 bits") from None
    address = ctypes.addressof(room)
    form.call(address, address + 8 * len(values), 0)
    return form.result(room, 8 * len(values))


Kernel.run = call
