"""Arrays without reference counts, for the inside of a compiled function.

Numba counts references to every array that is taken out of a tuple, with an atomic increment and decrement that the
optimiser cannot always pair off: hundreds of calls in a step. `bare(x)` makes of an array, or of each array in a
named tuple, a pointer and a length (one-dimensional arrays only). The caller's arrays live as long as its call, so
nothing is lost. A bare array has `a[i]`, `a[i] = x`, `a[start:stop]`, `a.shape`, and works with `load` and `store` of
`lanes.py`; an index is not negative and not checked.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_getattr, models, register_model

_INDEX = ir.IntType(64)


class BareType(types.Type):  # type: ignore[misc]
    """Numba type of a bare array of one kind of number."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(name=f"Bare({dtype})")


@register_model(BareType)
class _BareModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: BareType) -> None:
        super().__init__(manager, fe_type, [("data", types.CPointer(fe_type.dtype)), ("size", types.intp)])


def bare_type(kind: Any) -> Any:
    """The type that `bare` makes of a type."""
    if isinstance(kind, types.Array) and kind.ndim == 1 and kind.layout == "C":
        return BareType(kind.dtype)
    if isinstance(kind, types.BaseNamedTuple):
        return types.BaseTuple.from_types([bare_type(k) for k in kind], kind.instance_class)
    return kind


def struct(context: Any, builder: Any, kind: BareType, value: Any = None) -> Any:
    """A bare array's members `data` and `size`; without a value, those of a new one."""
    return cgutils.create_struct_proxy(kind)(context, builder, value)


def pointer(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """The address of the first number of an array or a bare array."""
    if isinstance(kind, BareType):
        return struct(context, builder, kind, array).data
    return context.make_array(kind)(context, builder, array).data


def _convert(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    target = bare_type(kind)
    if isinstance(target, BareType) and target != kind:
        array = context.make_array(kind)(context, builder, value)
        result = struct(context, builder, target)
        result.data, result.size = array.data, array.nitems
        return result._getvalue()
    if isinstance(kind, types.BaseNamedTuple):
        parts = [_convert(context, builder, k, builder.extract_value(value, i)) for i, k in enumerate(kind)]
        return context.make_tuple(builder, target, parts)
    context.nrt.incref(builder, kind, value)
    return value


@intrinsic  # type: ignore[untyped-decorator]
def _bare(typingctx: Any, x: Any) -> Any:
    """x with its one-dimensional arrays bare."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _convert(context, builder, signature.args[0], args[0])

    return bare_type(x)(x), codegen


def _as_it_is(x: Any) -> Any:
    return x


bare = _as_it_is if config.DISABLE_JIT else _bare


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        array, i = args
        if isinstance(array, BareType) and isinstance(i, types.Integer):
            return signature(array.dtype, array, types.intp)
        if isinstance(array, BareType) and isinstance(i, types.SliceType) and not i.has_step:
            return signature(array, array, i)
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        array, i, _ = args
        if isinstance(array, BareType) and isinstance(i, types.Integer):
            return signature(types.void, array, types.intp, array.dtype)
        return None


@infer_global(len)
class _Length(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.intp, *args) if isinstance(args[0], BareType) else None


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    key = BareType

    def resolve_shape(self, array: Any) -> Any:
        return types.UniTuple(types.intp, 1)


@lower_builtin(operator.getitem, BareType, types.Integer)  # type: ignore[untyped-decorator]
def _get(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return builder.load(builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True))


@lower_builtin(operator.setitem, BareType, types.Integer, types.Any)  # type: ignore[untyped-decorator]
def _set(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
    builder.store(args[2], place)
    return context.get_dummy_value()


@lower_builtin(operator.getitem, BareType, types.SliceType)  # type: ignore[untyped-decorator]
def _part(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    whole = struct(context, builder, signature.args[0], args[0])
    part = context.make_helper(builder, signature.args[1], args[1])
    stop = builder.select(builder.icmp_signed("<", part.stop, whole.size), part.stop, whole.size)
    result = struct(context, builder, signature.return_type)
    result.data = builder.gep(whole.data, [part.start], inbounds=True)
    result.size = builder.sub(stop, part.start)
    return result._getvalue()


@lower_builtin(len, BareType)  # type: ignore[untyped-decorator]
def _size(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return struct(context, builder, signature.args[0], args[0]).size


@lower_getattr(BareType, "shape")  # type: ignore[untyped-decorator]
def _shape(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_tuple(builder, types.UniTuple(types.intp, 1), [struct(context, builder, kind, value).size])
