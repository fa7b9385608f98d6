"""A compiled function's whole world behind one whole number: no argument of a call from Python costs more than that.

Handing a NamedTuple of twenty arrays to a compiled function takes microseconds, more than a control period of a small
arm. `Placed` writes the unpacked tuple, its arrays bare, into a buffer once; `follow` reads it back inside compiled
code. The Python side keeps buffer and arrays alive and calls the compiled function through `entry`, which skips the
dispatcher's look at the types.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, typeof, types
from numba.extending import NativeValue, intrinsic, models, register_model, unbox

from .arrays import bare, bare_type
from .decorator import kernel


class Address(types.Type):  # type: ignore[misc]
    """Numba type of the address of a placed value of type `target`."""

    def __init__(self, target: Any) -> None:
        self.target = target
        super().__init__(name=f"Address({target})")


@register_model(Address)
class _AddressModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: Address) -> None:
        super().__init__(manager, fe_type, ir.IntType(64))


@unbox(Address)  # type: ignore[untyped-decorator]
def _unbox_address(typ: Any, obj: Any, c: Any) -> Any:
    return NativeValue(c.pyapi.long_as_longlong(obj))


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


@intrinsic  # type: ignore[untyped-decorator]
def _write(typingctx: Any, buffer: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[1]
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        target = builder.bitcast(data, context.get_value_type(kind).as_pointer())
        builder.store(_unowned(context, builder, kind, args[1]), target, align=8)
        size = context.get_abi_sizeof(context.get_value_type(kind))
        return ir.Constant(ir.IntType(64), size)

    return types.int64(buffer, value), codegen


@intrinsic  # type: ignore[untyped-decorator]
def follow(typingctx: Any, address: Any) -> Any:
    """The value placed at an address, its arrays bare."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = builder.inttoptr(args[0], context.get_value_type(address.target).as_pointer())
        return builder.load(pointer, align=8)

    return address.target(address), codegen


if config.DISABLE_JIT:
    follow = lambda address: address  # type: ignore[assignment]  # noqa: E731 - the value is its own address


@kernel
def _place(buffer, value):  # type: ignore[no-untyped-def]
    return _write(buffer, bare(value))


class Placed:
    """A named tuple of one-dimensional arrays and numbers that compiled code reaches by `address`.

    Its arrays may be written to; to put another in the place of one, there is `replace`.
    """

    def __init__(self, value: Any) -> None:
        self.value = value  # keeps the arrays alive
        self.address: Any = value
        if config.DISABLE_JIT:
            return
        self._buffer = np.zeros(8192, np.uint64)
        used = _place(self._buffer, value)
        assert used <= self._buffer.nbytes
        self.address = int(self._buffer.ctypes.data)
        self.kind = Address(bare_type(typeof(value)))
        self._words: dict[str, int] = {}
        self._held: dict[str, Any] = {}

    def replace(self, name: str, array: Any) -> None:
        """Put a contiguous array of the same type and shape in the place of the value's array `name`."""
        if config.DISABLE_JIT:
            self.address = self.value = self.value._replace(**{name: array.reshape(-1)})
            return
        if name not in self._words:  # the one word of the buffer that holds the old array's address
            (word,) = np.flatnonzero(self._buffer == getattr(self.value, name).ctypes.data)
            self._words[name] = int(word)
        self._held[name] = array
        self._buffer[self._words[name]] = array.__array_interface__["data"][0]


def entry(function: Any, placed: Placed, *arguments: Any) -> Callable[..., Any]:
    """The compiled form of `function(address, *arguments)`; later calls must bring the same types (nothing checks)."""
    if config.DISABLE_JIT:
        return function  # type: ignore[no-any-return]
    compiled: Callable[..., Any] = _form(function, placed, arguments).entry_point
    return compiled


def native(function: Any, placed: Placed, *arguments: Any) -> int:
    """Where the machine code of the same function begins; 0 where nothing is compiled."""
    if config.DISABLE_JIT:
        return 0
    form = _form(function, placed, arguments)
    return int(form.library.get_pointer_to_function(form.fndesc.llvm_func_name))


def _form(function: Any, placed: Placed, arguments: tuple[Any, ...]) -> Any:
    signature = (placed.kind, *(typeof(argument) for argument in arguments))
    function.compile(signature)
    return function.overloads[signature]
