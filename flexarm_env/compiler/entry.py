"""A compiled function's whole world behind one whole number: no argument of a call from Python costs more than that.

Handing a NamedTuple of twenty arrays to a compiled function takes microseconds, more than a control period of a small
arm. `Placed` writes the unpacked tuple, its arrays bare, into a buffer once; `follow` reads it back inside compiled
code. The Python side keeps buffer and arrays alive and calls the compiled function through `entry`: whole, that skips
the dispatcher's look at the types; plain, the address brings its type along, and threads call a C function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
from llvmlite import ir
from numba import cfunc, config, typeof, types
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

from .arrays import bare_type
from .private import MODE

FAILED = -1
"""What the machine code at an address is taken to have returned where it has raised an error."""


class Address(types.Type):  # type: ignore[misc]
    """Numba type of the address of a placed value of type `target`, which takes so many words of eight bytes."""

    def __init__(self, target: Any, words: int) -> None:
        self.target, self.words = target, words
        super().__init__(name=f"Address({target})")


@register_model(Address)
class _AddressModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: Address) -> None:
        super().__init__(manager, fe_type, ir.IntType(64))


@unbox(Address)
def _unbox_address(typ: Any, obj: Any, c: Any) -> Any:
    return NativeValue(c.pyapi.long_as_longlong(obj))


class PlainAddress:
    """An address for Numba's dispatcher, which has to be told its type."""

    def __init__(self, word: int, kind: Address) -> None:
        self._word, self.kind = word, kind

    def __index__(self) -> int:
        return self._word


@typeof_impl.register(PlainAddress)
def _typeof_address(address: PlainAddress, c: Any) -> Address:
    return address.kind


def _words(value: Any) -> list[int]:
    """A value as machine code holds it, in words of eight bytes: what is made of an array is bare where `bare` makes it
    so, and has no owner whose references are counted."""
    if isinstance(value, tuple):
        return [word for part in value for word in _words(part)]
    if isinstance(value, np.ndarray):
        begin = int(value.__array_interface__["data"][0])
        if value.ndim == 1 and value.flags.c_contiguous:
            return [begin, value.size]
        return [0, 0, value.size, value.itemsize, begin, *value.shape, *value.strides]
    if value is None:
        return [0]
    if isinstance(value, int | np.int64) and not isinstance(value, bool):
        return [int(value)]
    if isinstance(value, float):
        return [int(np.float64(value).view(np.int64))]
    raise TypeError(f"{type(value).__name__}: a placed value holds arrays, None, int and float")


@intrinsic
def follow(typingctx: Any, address: Any) -> Any:
    """The value placed at an address, its arrays bare."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = context.get_value_type(address.target)
        assert context.get_abi_sizeof(kind) == 8 * address.words, address.target
        return builder.load(builder.inttoptr(args[0], kind.as_pointer()), align=8)

    return address.target(address), codegen


if config.DISABLE_JIT:
    follow = lambda address: address  # noqa: E731 - the value is its own address


class Placed:
    """A named tuple of one-dimensional arrays and numbers that compiled code reaches by `address`.

    Its arrays may be written to; to put another in the place of one, there is `replace`.
    """

    def __init__(self, value: Any) -> None:
        self.value = value  # keeps the arrays alive
        self.address: Any = value
        if config.DISABLE_JIT:
            return
        parts = [_words(part) for part in value]
        self._buffer = np.array([word for part in parts for word in part], np.int64)
        self._places = dict(zip(value._fields, accumulate(map(len, parts), initial=0), strict=False))
        self.kind = Address(bare_type(typeof(value)), len(self._buffer))
        word = int(self._buffer.ctypes.data)
        self.address = word if MODE == "whole" else PlainAddress(word, self.kind)
        self._held: dict[str, Any] = {}

    def replace(self, name: str, array: Any) -> None:
        """Put a contiguous array of the same type and shape in the place of the value's array `name`."""
        if config.DISABLE_JIT:
            self.address = self.value = self.value._replace(**{name: array.reshape(-1)})
            return
        self._held[name] = array
        self._buffer[self._places[name]] = array.__array_interface__["data"][0]  # a bare array begins with its address


def entry(function: Any, placed: Placed, *arguments: Any) -> Callable[..., Any]:
    """The compiled form of `function(address, *arguments)`; later calls must bring the same types (nothing checks)."""
    if config.DISABLE_JIT or MODE == "plain":
        return function
    return _form(function, placed, arguments)[0]


def native(function: Any, placed: Placed, *arguments: Any) -> int:
    """Where the machine code of the same function of whole numbers begins; 0 where nothing is compiled."""
    if config.DISABLE_JIT:
        return 0
    if MODE == "plain":
        return _c_function(function, placed.kind, len(arguments))
    return _form(function, placed, arguments)[1]


def _form(function: Any, placed: Placed, arguments: tuple[Any, ...]) -> tuple[Callable[..., Any], int]:
    from .whole import form

    return form(function, (placed.kind, *(typeof(argument) for argument in arguments)))


@cache
def _c_function(function: Any, kind: Address, count: int) -> int:
    """The address of a C function of whole numbers that calls function(address, first, last)."""
    assert count == 2

    @intrinsic
    def address(typingctx: Any, word: Any) -> Any:
        return kind(types.int64), lambda context, builder, signature, args: args[0]

    def guarded(word, first, last):
        try:
            return function(address(word), first, last)
        except Exception:
            return FAILED

    made = cfunc(types.int64(types.int64, types.int64, types.int64), error_model="numpy")(guarded)
    _kept.append(made)
    return int(made.address)


_kept: list[Any] = []
"""C functions live as long as the process."""
