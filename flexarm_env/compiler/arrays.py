"""Arrays without reference counts, for the inside of a compiled function, and room for them on the stack.

Numba counts references to every array that is taken out of a tuple, with an atomic increment and decrement that the
optimiser cannot always pair off: hundreds of calls in a step. `bare(x)` makes of an array, or of each array in a
named tuple, a pointer and a length (one-dimensional arrays only). The caller's arrays live as long as its call, so
nothing is lost. A bare array has `a[i]`, `a[i] = x`, `a[start:stop]`, `a.shape`, and works with `load` and `store` of
`lanes.py`; an index is not negative and not checked.

`stack(lane, sizes)` gives a bare array of `len(sizes)` lanes, not initialised, that lives as long as the call. Where
the compiler can follow every index into it, it becomes registers.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    lower_builtin,
    make_attribute_wrapper,
    models,
    register_model,
    type_callable,
)

_INDEX = ir.IntType(64)


class BareType(types.Type):  # type: ignore[misc]
    """Numba type of a bare array of one kind of number."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(name=f"Bare({dtype})")


@register_model(BareType)
class _BareModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: BareType) -> None:
        members = [("data", types.CPointer(fe_type.dtype)), ("shape", types.UniTuple(types.intp, 1))]
        super().__init__(manager, fe_type, members)


make_attribute_wrapper(BareType, "shape", "shape")


def bare_type(kind: Any) -> Any:
    """The type that `bare` makes of a type."""
    if isinstance(kind, types.Array) and kind.ndim == 1 and kind.layout == "C":
        return BareType(kind.dtype)
    if isinstance(kind, types.BaseNamedTuple):
        return types.BaseTuple.from_types([bare_type(k) for k in kind], kind.instance_class)
    return kind


def struct(context: Any, builder: Any, kind: BareType, value: Any = None) -> Any:
    """A bare array's members `data` and `shape`; without a value, those of a new one."""
    return cgutils.create_struct_proxy(kind)(context, builder, value)


def _made(context: Any, builder: Any, kind: BareType, data: Any, size: Any) -> Any:
    """A bare array of `size` numbers at `data`."""
    array = struct(context, builder, kind)
    array.data, array.shape = data, context.make_tuple(builder, types.UniTuple(types.intp, 1), [size])
    return array._getvalue()


def pointer(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """The address of the first number of an array or a bare array."""
    if isinstance(kind, BareType):
        return struct(context, builder, kind, array).data
    return context.make_array(kind)(context, builder, array).data


def _convert(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    target = bare_type(kind)
    if isinstance(target, BareType) and target != kind:
        array = context.make_array(kind)(context, builder, value)
        return _made(context, builder, target, array.data, array.nitems)
    if isinstance(kind, types.BaseNamedTuple):
        parts = [_convert(context, builder, k, builder.extract_value(value, i)) for i, k in enumerate(kind)]
        return context.make_tuple(builder, target, parts)
    context.nrt.incref(builder, kind, value)
    return value


@intrinsic
def _bare(typingctx: Any, x: Any) -> Any:
    """x with its one-dimensional arrays bare."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _convert(context, builder, signature.args[0], args[0])

    return bare_type(x)(x), codegen


def _as_it_is(x: Any) -> Any:
    return x


bare = _as_it_is if config.DISABLE_JIT else _bare


@type_callable(operator.getitem)
def _type_get(context: Any) -> Any:
    def typer(array: Any, i: Any) -> Any:
        if isinstance(array, BareType) and isinstance(i, types.Integer):
            return array.dtype(array, types.intp)
        if isinstance(array, BareType) and isinstance(i, types.SliceType) and not i.has_step:
            return array(array, i)
        return None

    return typer


@type_callable(operator.setitem)
def _type_set(context: Any) -> Any:
    def typer(array: Any, i: Any, value: Any) -> Any:
        if isinstance(array, BareType) and isinstance(i, types.Integer):
            return types.void(array, types.intp, array.dtype)
        return None

    return typer


@type_callable(len)
def _type_length(context: Any) -> Any:
    def typer(array: Any) -> Any:
        return types.intp if isinstance(array, BareType) else None

    return typer


@lower_builtin(operator.getitem, BareType, types.Integer)
def _get(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return builder.load(builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True))


@lower_builtin(operator.setitem, BareType, types.Integer, types.Any)
def _set(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
    builder.store(args[2], place)
    return context.get_dummy_value()


@lower_builtin(operator.getitem, BareType, types.SliceType)
def _part(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    part = context.make_helper(builder, signature.args[1], args[1])
    whole, size = struct(context, builder, signature.args[0], args[0]), _size(context, builder, signature, args)
    stop = builder.select(builder.icmp_signed("<", part.stop, size), part.stop, size)
    first = builder.gep(whole.data, [part.start], inbounds=True)
    return _made(context, builder, signature.return_type, first, builder.sub(stop, part.start))


@lower_builtin(len, BareType)
def _size(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return builder.extract_value(struct(context, builder, signature.args[0], args[0]).shape, 0)


@intrinsic
def _stack(typingctx: Any, lane: Any, sizes: Any) -> Any:
    """A bare float64 array for `len(sizes)` values per lane of the tag `lane`; both are tuples of zeros."""
    length = len(lane) * len(sizes)
    kind = BareType(types.float64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            room = builder.alloca(ir.ArrayType(ir.DoubleType(), length))
            room.align = 64
        data = builder.bitcast(room, ir.DoubleType().as_pointer())
        return _made(context, builder, kind, data, ir.Constant(_INDEX, length))

    return kind(lane, sizes), codegen


def _py_stack(lane: tuple[int, ...], sizes: tuple[int, ...]) -> np.ndarray:
    return np.full(len(lane) * len(sizes), np.nan)


stack = _py_stack if config.DISABLE_JIT else _stack
