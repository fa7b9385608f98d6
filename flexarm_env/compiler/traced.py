"""Straight-line code from Python that runs once, when the kernel that calls it is compiled.

A function under `@traced` is given symbols in place of run-time numbers and arrays; each operation on a symbol writes
one instruction into the calling kernel. Loops, tables, lists and dicts of the function are gone by then, and nothing
but the operations is left to compile. Tuples of zeros (lane tags, sizes) and None stand for themselves. The function
reads and writes arrays by `load` and `store` of lanes.py at indices known beforehand, and branches on no symbol; the
functions of its module that it calls are traced with it. Where compilation is disabled it runs on plain numbers.
"""

from __future__ import annotations

import inspect
import sys
import types as python
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin

from . import lanes
from .arrays import BareType, pointer
from .unroll import Slots, Value, _Writer


def _on_symbols(function: Any, builder: Any, count: int) -> Any:
    """The function, with those of lanes.py (and its own module) replaced by what they are on symbols."""
    writer = _Writer(builder, count)
    module = vars(sys.modules[function.__module__])
    scope = dict(module)
    for name, item in module.items():
        if item is lanes.sincos:
            scope[name] = writer.on_symbols(item)
        elif isinstance(item, python.FunctionType) and item.__module__ == function.__module__:
            scope[name] = python.FunctionType(item.__code__, scope, name, item.__defaults__, item.__closure__)
        elif callable(item) and item in writer.traced:
            scope[name] = writer.traced[item]
    return scope[function.__name__]


def _symbol(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """What stands for an argument of a Numba type."""
    if isinstance(kind, types.Float):
        return Value(builder, value, 1)
    if isinstance(kind, lanes.LanesType):
        return Value(builder, value, kind.count)
    if isinstance(kind, BareType | types.Array):
        return Slots(builder, pointer(context, builder, kind, value))
    if isinstance(kind, types.BaseTuple):
        kinds = [kind[i] for i in range(len(kind))]
        if all(isinstance(k, types.Integer) for k in kinds):
            return (0,) * len(kinds)
        return tuple(_symbol(context, builder, k, builder.extract_value(value, i)) for i, k in enumerate(kinds))
    return None


def traced(results: Callable[[int], int]) -> Callable[[Any], Any]:
    """`results(p)`: how many lanes a function with an argument `order` of p zeros returns, in a tuple; 0: nothing."""

    def decorate(function: Any) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        names = list(inspect.signature(function).parameters)
        lane, order = names.index("lane"), names.index("order")
        setattr(sys.modules[function.__module__], function.__name__, function)  # Numba wants to find it there

        @infer_global(function)
        class _Template(AbstractTemplate):  # type: ignore[misc]
            def generic(self, args: Any, kws: Any) -> Any:
                n, count = results(len(args[order])), len(args[lane])
                kind = types.float64 if count == 1 else lanes.LanesType(count)
                return signature(types.UniTuple(kind, n) if n else types.void, *args)

        @lower_builtin(function, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
        def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            count = len(signature.args[lane])
            symbols = [_symbol(context, builder, k, x) for k, x in zip(signature.args, args, strict=True)]
            values = _on_symbols(function, builder, count)(*symbols)
            if signature.return_type == types.void:
                return context.get_dummy_value()
            return context.make_tuple(builder, signature.return_type, [x.wide(count) for x in values])

        return function

    return decorate


@intrinsic  # type: ignore[untyped-decorator]
def _aligned_frame(typingctx: Any, lane: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if len(lane) > 1:
            with builder.goto_entry_block():
                room = builder.alloca(ir.VectorType(ir.DoubleType(), 8))
                room.align = 64
            kind = ir.FunctionType(ir.VoidType(), [room.type])
            builder.asm(kind, "", "r", [room], side_effect=True)
        return context.get_dummy_value()

    return types.void(lane), codegen


def _no_frame(lane: tuple[int, ...]) -> None:
    """Begin the calling function's stack frame on a multiple of 64 bytes, where it keeps vectors of lanes.

    Left to itself the compiler aligns the frame to 16 bytes, and each vector that does not fit into the registers is
    written to and read from two cache lines.
    """


_aligned_frame.__doc__ = _no_frame.__doc__
aligned_frame = _no_frame if config.DISABLE_JIT else _aligned_frame  # type: ignore[attr-defined]
