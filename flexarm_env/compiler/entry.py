"""A compiled function's whole world behind one whole number: no argument of a call from Python costs more than that.

Handing a NamedTuple of twenty arrays to a compiled function takes microseconds, more than a control period of a small
arm. `Placed` writes the unpacked tuple, its arrays bare, into a buffer once; `follow` reads it back inside compiled
code. The Python side keeps buffer and arrays alive and calls the compiled function through `entry`: whole, that skips
the dispatcher's look at the types; plain, the address brings its type along, and threads call a C function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import cfunc, config, typeof, types
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

from .arrays import bare, bare_type
from .decorator import kernel
from .private import MODE

FAILED = -1
"""What the machine code at an address is taken to have returned where it has raised an error."""


class Address(types.Type):  # type: ignore[misc]
    """Numba type of the address of a placed value of type `target`."""

    def __init__(self, target: Any) -> None:
        self.target = target
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


def _unowned(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The value, its arrays of more dimensions (which `bare` leaves) without an owner whose references are counted."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = ir.Constant(array.meminfo.type, None)
        array.parent = ir.Constant(array.parent.type, None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, part in enumerate(kind):
            inner = _unowned(context, builder, part, builder.extract_value(value, i))
            value = builder.insert_value(value, inner, i)
    return value


@intrinsic
def _write(typingctx: Any, buffer: Any, value: Any, places: Any) -> Any:
    """Write a value into a buffer and where each of its parts begins, in bytes, into places; the value's size."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind, word, slot = signature.args[1], ir.IntType(64), ir.IntType(32)
        data, found = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 2))
        target = builder.bitcast(data, context.get_value_type(kind).as_pointer())
        builder.store(_unowned(context, builder, kind, args[1]), target, align=8)
        begin = builder.ptrtoint(target, word)
        for i in range(len(kind)):
            part = builder.ptrtoint(builder.gep(target, [slot(0), slot(i)]), word)
            builder.store(builder.sub(part, begin), builder.gep(found, [word(i)]))
        return ir.Constant(word, context.get_abi_sizeof(context.get_value_type(kind)))

    return types.int64(buffer, value, places), codegen


@intrinsic
def follow(typingctx: Any, address: Any) -> Any:
    """The value placed at an address, its arrays bare."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = builder.inttoptr(args[0], context.get_value_type(address.target).as_pointer())
        return builder.load(pointer, align=8)

    return address.target(address), codegen


if config.DISABLE_JIT:
    follow = lambda address: address  # noqa: E731 - the value is its own address


@kernel
def _place(buffer, value, places):
    return _write(buffer, bare(value), places)


class Placed:
    """A named tuple of one-dimensional arrays and numbers that compiled code reaches by `address`.

    Its arrays may be written to; to put another in the place of one, there is `replace`.
    """

    def __init__(self, value: Any) -> None:
        self.value = value  # keeps the arrays alive
        self.address: Any = value
        if config.DISABLE_JIT:
            return
        self._buffer, places = np.zeros(8192, np.uint64), np.zeros(len(value), np.int64)
        used = _place(self._buffer, value, places)
        assert used <= self._buffer.nbytes
        self.kind = Address(bare_type(typeof(value)))
        word = int(self._buffer.ctypes.data)
        self.address = word if MODE == "whole" else PlainAddress(word, self.kind)
        self._words = dict(zip(value._fields, (places // self._buffer.itemsize).tolist(), strict=True))
        self._held: dict[str, Any] = {}

    def replace(self, name: str, array: Any) -> None:
        """Put a contiguous array of the same type and shape in the place of the value's array `name`."""
        if config.DISABLE_JIT:
            self.address = self.value = self.value._replace(**{name: array.reshape(-1)})
            return
        self._held[name] = array
        self._buffer[self._words[name]] = array.__array_interface__["data"][0]  # a bare array begins with its address


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
