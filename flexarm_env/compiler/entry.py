"""Fast calls of compiled functions from Python: all arguments are in memory at one address.

The class `Placed` writes a named tuple of arrays and numbers once into an array of 64-bit words. A kernel that begins
with `p = dereference(address)` reads the named tuple from these words. The Python side keeps words and arrays alive and
calls the compiled function through `entry`, a C function that Python calls directly, or by its address (`native`).

`call` calls a kernel with arguments of any kind and places the arguments in memory for the duration of the call.
"""

import ctypes
import struct
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .decorator import UNCOMPILED, Kernel
from .kinds import Layout, described_as, words_of
from .program import Program, program_of

FAILED = -1
"""A return value that no compiled step returns."""


class Placed:
    """A named tuple of arrays and numbers that compiled code reads at `address`.

    Compiled code may write to the arrays. The method `replace` exchanges an array for another array.
    """

    def __init__(self, value: Any) -> None:
        """Write the value's words to memory; if compilation is disabled, the address is the value itself."""
        self.value = value  # keeps the arrays alive
        self.address: Any = value
        if UNCOMPILED:
            return
        self.layout = Layout.of(value)
        self._words = np.array(words_of(value), np.int64)
        self.address = int(self._words.ctypes.data)
        self._held: dict[str, Any] = {}

    def replace(self, name: str, array: Any, address: int) -> None:
        """Replace the named tuple's array `name` by a contiguous array of the same type and shape, at `address`."""
        if UNCOMPILED:
            self.address = self.value = self.value._replace(**{name: array.reshape(-1)})
            return
        self._held[name] = array
        self._words[self.layout.parts[name][1]] = address


def entry(function: Any, placed: Placed, *arguments: int) -> Callable[..., Any]:
    """Return the compiled `function(address, *arguments)`, which takes at most two integers and returns an integer."""
    return function if UNCOMPILED else _direct(function, placed, arguments).call


def native(function: Any, placed: Placed, *arguments: int) -> int:
    """Return the address of the machine code of a kernel; 0 if compilation is disabled.

    placed: the named tuple at whose address the kernel is called. arguments: up to two integers. Only their number
        matters, not their values.
    """
    return 0 if UNCOMPILED else _direct(function, placed, arguments).address


def _direct(kernel: Kernel, placed: Placed, arguments: tuple[int, ...]) -> Program:
    """Return the compiled program of a kernel for a placed tuple and integers; it is compiled at the first request."""
    # the compiled form depends on the tuple's layout, not on its values
    key = ("direct", placed.layout, len(arguments))
    if key not in kernel.forms:
        shapes = [("placed", placed.layout), *["integer" for _ in arguments]]
        kernel.forms[key] = program_of(kernel, shapes, direct=True)
    found: Program = kernel.forms[key]
    return found


Arrays = list[NDArray[Any]]


class _Kept(OrderedDict[int, tuple[Any, Placed, Arrays, list[Any]]]):
    """Cache of placed named tuples by identity.

    The cache keeps each tuple alive, so that the tuple's identity stays unique. When the cache is full, the oldest
    tuples are dropped.

    If an array in a tuple has changed its shape or its writability, the tuple is written to memory again.
    """

    LIMIT = 256

    def place(self, value: Any) -> Placed:
        """Return the `Placed` of a named tuple, from the cache if its arrays have not changed."""
        found = self.get(id(value))
        if found is None or found[3] != [(x.flags.num, x.shape, x.dtype) for x in found[2]]:
            arrays = list(_arrays(value))
            about = [(x.flags.num, x.shape, x.dtype) for x in arrays]
            found = self[id(value)] = value, Placed(value), arrays, about
            while len(self) > self.LIMIT:
                try:
                    self.popitem(last=False)
                except KeyError:  # another thread was quicker
                    break
        return found[1]


def _arrays(value: Any) -> Iterator[NDArray[Any]]:
    """Yield the arrays in a tuple, nested tuples included."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _arrays(part)


_kept = _Kept()


def call(kernel: Kernel, items: Sequence[Any]) -> Any:
    """Return a kernel's result for arguments of any kind that kernels accept; raise TypeError for another kind."""
    # kinds (`shapes`), struct letters and words of all arguments
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
    # arguments, then the result, in one buffer
    room = ctypes.create_string_buffer(8 * (len(values) + form.words))
    try:
        struct.pack_into(letters, room, 0, *values)
    except struct.error:
        # only integers beyond 64 bits fail
        big = next(x for x in values if isinstance(x, int) and not -(2**63) <= x < 2**63)
        raise OverflowError(f"{kernel.__name__}({big}): a whole number has 64 bits") from None
    address = ctypes.addressof(room)
    form.call(address, address + 8 * len(values), 0)
    return form.result(room, 8 * len(values))


Kernel.run = call
