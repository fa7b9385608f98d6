"""Straight-line code from a kernel with loops, where the sizes are compiled in.

`@unrolled` on a kernel (free function of load, store and arithmetic; no branches on values) runs its Python source
once at compile time, on symbols in place of numbers, and keeps the operations: loops are gone, indices are constants,
and rooms on the stack become registers. That happens where the Model's `n` is a tag, a tuple of zeros; where it is a
number the same source is compiled as it stands. Same operations in the same order, hence the same bits.
"""

from __future__ import annotations

import inspect
import sys
import types as python
from collections.abc import Hashable
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.core.dispatcher import Dispatcher
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin

from . import lanes
from .arrays import BareType, pointer
from .dispatch import size
from .stack import stack

_DOUBLE = ir.DoubleType()
_SLOT = ir.IntType(32)


class Value:
    """A float64 (count 1) or a vector of lanes that exists at run time."""

    def __init__(self, builder: Any, value: Any, count: int) -> None:
        self.builder, self.value, self.count = builder, value, count

    def wide(self, count: int) -> Any:
        """The same in `count` lanes."""
        return self.value if self.count == count else lanes.broadcast(self.builder, self.value, count)

    def like(self, value: Any, count: int) -> Value:
        """A new value."""
        return Value(self.builder, value, count)

    def other(self, x: Any) -> Value:
        """x as a Value."""
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(_DOUBLE, float(x)), 1)

    def _binary(self, instruction: str, a: Any, b: Any) -> Value:
        a, b = self.other(a), self.other(b)
        count = max(a.count, b.count)
        return self.like(getattr(self.builder, instruction)(a.wide(count), b.wide(count)), count)

    def __add__(self, x: Any) -> Value:
        return self._binary("fadd", self, x)

    def __radd__(self, x: Any) -> Value:
        return self._binary("fadd", x, self)

    def __sub__(self, x: Any) -> Value:
        return self._binary("fsub", self, x)

    def __rsub__(self, x: Any) -> Value:
        return self._binary("fsub", x, self)

    def __mul__(self, x: Any) -> Value:
        return self._binary("fmul", self, x)

    def __rmul__(self, x: Any) -> Value:
        return self._binary("fmul", x, self)

    def __truediv__(self, x: Any) -> Value:
        return self._binary("fdiv", self, x)

    def __rtruediv__(self, x: Any) -> Value:
        return self._binary("fdiv", x, self)

    def __neg__(self) -> Value:
        return self.like(self.builder.fneg(self.value), self.count)

    def __bool__(self) -> bool:
        raise TypeError("a value is not known when the kernel is written out: no branch may depend on it")

    def call(self, name: str) -> Value:
        """An LLVM intrinsic of one argument."""
        kind = _DOUBLE if self.count == 1 else ir.VectorType(_DOUBLE, self.count)
        suffix = "f64" if self.count == 1 else f"v{self.count}f64"
        function = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.{suffix}"
        )
        return self.like(self.builder.call(function, [self.value]), self.count)


class Slots:
    """An array at run time: `slots[k]` is its k-th number, k known at compile time."""

    def __init__(self, builder: Any, data: Any) -> None:
        self.builder, self.data = builder, data

    def address(self, k: int, count: int) -> Any:
        """Where element k of `count` lanes lies."""
        first = self.builder.gep(self.data, [ir.Constant(ir.IntType(64), k * count)], inbounds=True)
        return first if count == 1 else self.builder.bitcast(first, ir.VectorType(_DOUBLE, count).as_pointer())

    def __getitem__(self, k: int) -> Value:
        return self.get(k, 1)

    def get(self, k: int, count: int) -> Value:
        """Element k of `count` lanes."""
        return Value(self.builder, self.builder.load(self.address(k, count), align=8), count)

    def put(self, k: int, value: Value, count: int) -> None:
        """Write element k."""
        self.builder.store(value.wide(count), self.address(k, count), align=8)


class _Writer:
    """What the functions of lanes.py are on symbols, for one count of lanes."""

    def __init__(self, builder: Any, count: int) -> None:
        self.builder, self.count = builder, count
        self.traced: dict[Any, Any] = {
            lanes.load: self.load,
            lanes.store: self.store,
            lanes.splat: lambda lane, x: self.value(x),
            lanes.select_lt: self.select_lt,
            lanes.absolute: lambda x: x.call("fabs"),
            lanes.square_root: lambda x: x.call("sqrt"),
            lanes.turn: self.turn,
            lanes.round_even: lambda x: x.call("rint"),
            stack: lambda lane, sizes: [None] * len(sizes),
            size: size,
        }

    def value(self, x: Any) -> Value:
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(_DOUBLE, float(x)), 1)

    def load(self, lane: Any, array: Any, k: int) -> Value:
        return array.get(k, self.count) if isinstance(array, Slots) else array[k]

    def store(self, array: Any, k: int, value: Any) -> None:
        if isinstance(array, Slots):
            array.put(k, self.value(value), self.count)
        else:
            array[k] = self.value(value)

    def turn(self, t: Value, s: Value, c: Value) -> tuple[Value, ...]:
        pair = lanes.turned(self.builder, t.value, s.value, c.value, t.count)
        return tuple(Value(self.builder, x, t.count) for x in pair)

    def select_lt(self, a: Any, b: Any, x: Any, y: Any) -> Value:
        a, b, x, y = (self.value(item) for item in (a, b, x, y))
        count = max(item.count for item in (a, b, x, y))
        less = self.builder.fcmp_ordered("<", a.wide(count), b.wide(count))
        return Value(self.builder, self.builder.select(less, x.wide(count), y.wide(count)), count)

    def on_symbols(self, function: Any) -> Any:
        """The function (and all kernels that it calls) with the functions of lanes.py replaced."""
        if function in self.traced:
            return self.traced[function]
        source = function.py_func if isinstance(function, Dispatcher) else function
        scope = dict(source.__globals__)
        copy = python.FunctionType(source.__code__, scope, source.__name__, source.__defaults__, source.__closure__)
        self.traced[function] = copy
        for name in source.__code__.co_names:
            item = scope.get(name)
            if isinstance(item, Dispatcher | Hashable) and (isinstance(item, Dispatcher) or item in self.traced):
                scope[name] = self.on_symbols(item)
        return copy

    def symbol(self, context: Any, kind: Any, value: Any) -> Any:
        """What stands for an argument of a Numba type."""
        if isinstance(kind, types.BaseNamedTuple):
            fields = zip(kind.fields, kind, range(len(kind)), strict=True)
            parts = {name: self.symbol(context, k, self.builder.extract_value(value, i)) for name, k, i in fields}
            return python.SimpleNamespace(**parts)
        if isinstance(kind, types.BaseTuple):
            return (0,) * len(kind)
        if isinstance(kind, BareType | types.Array):
            known = kind.dtype == types.float64
            return Slots(self.builder, pointer(context, self.builder, kind, value)) if known else None
        if isinstance(kind, types.Float):
            return Value(self.builder, value, 1)
        if isinstance(kind, lanes.LanesType):
            return Value(self.builder, value, kind.count)
        return None


def _has_tags(model: Any) -> bool:
    return isinstance(model[model.fields.index("n")], types.BaseTuple)


def unrolled(function: Any) -> Any:
    """Straight-line code of a kernel that returns nothing and has arguments `lane` and `model`, sizes permitting."""
    if config.DISABLE_JIT:
        return function
    names = list(inspect.signature(function.py_func).parameters)
    lane, model = names.index("lane"), names.index("model")

    def stand_in(*args: Any) -> None:
        function(*args)

    stand_in.__name__ = stand_in.__qualname__ = f"{function.py_func.__name__}_unrolled"
    setattr(sys.modules[function.py_func.__module__], stand_in.__name__, stand_in)  # Numba wants to find it there
    stand_in.__module__ = function.py_func.__module__

    @infer_global(stand_in)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            if _has_tags(args[model]):
                return signature(types.void, *args)
            return types.Dispatcher(function).get_call_type(self.context, args, kws)

    @lower_builtin(stand_in, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
    def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if _has_tags(signature.args[model]):
            writer = _Writer(builder, len(signature.args[lane]))
            symbols = [writer.symbol(context, kind, x) for kind, x in zip(signature.args, args, strict=True)]
            writer.on_symbols(function)(*symbols)
            return context.get_dummy_value()
        call = context.get_function(types.Dispatcher(function), signature)
        context.add_linking_libs(getattr(call, "libs", ()))
        return call(builder, args)

    return stand_in
