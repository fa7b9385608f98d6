"""Straight-line code: Python that runs once, when the kernel that calls it is compiled.

A function is given symbols in place of the numbers and arrays of run time; each operation on a symbol writes one
instruction into the calling kernel. Loops, tables, lists and dicts are gone by then, indices are constants, rooms on
the stack are registers, and nothing but the operations is left to compile. Such a function reads and writes arrays by
`load` and `store` (lanes.py) at indices known beforehand, and branches on no symbol; kernels and functions of its own
module that it calls are traced with it. Tuples of zeros (lane tags, sizes) and None stand for themselves.

`@unrolled` is for a kernel with loops over the Model's size `n`: where that is a tag, a tuple of zeros, it is traced;
where it is a number, the same source is compiled as it stands. `@traced` is for functions that are Python at compile
time throughout. Same operations in the same order, hence the same bits; where compilation is disabled both run on
plain numbers.
"""

from __future__ import annotations

import inspect
import sys
import types as python
from collections.abc import Callable, Hashable, Iterator
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic, is_jitted

from . import lanes, symbols
from .arrays import BareType, pointer, stack
from .dispatch import call_chosen, size, take_name
from .symbols import DOUBLE, Value, vector

_SOURCES: dict[Any, Any] = {}
"""What stands for a traced function in kernels, and the function."""


class Slots:
    """An array at run time: `slots[k]` is its k-th number, k known at compile time."""

    def __init__(self, builder: Any, data: Any) -> None:
        self.builder, self.data = builder, data

    def address(self, k: int, count: int) -> Any:
        """Where the k-th `count` numbers lie."""
        place = self.builder.gep(self.data, [ir.Constant(ir.IntType(64), k * count)], inbounds=True)
        return place if count == 1 else self.builder.bitcast(place, vector(count).as_pointer())

    def __getitem__(self, k: int) -> Value:
        return self.get(k, 1, 0)

    def get(self, k: int, count: int, tangents: int) -> Value:
        """Element k of `count` lanes, with its tangents."""
        places = [self.address(k * (1 + tangents) + part, count) for part in range(1 + tangents)]
        first, *rest = [Value(self.builder, self.builder.load(place, align=8), count) for place in places]
        return first.having(rest)

    def put(self, k: int, value: Value, count: int, tangents: int) -> None:
        """Write element k."""
        for part, x in enumerate(value.parts(count, tangents)):
            self.builder.store(x, self.address(k * (1 + tangents) + part, count), align=8)


class Tracer:
    """What the functions of lanes.py are on symbols, for lanes of one type."""

    def __init__(self, builder: Any, lane: Any) -> None:
        self.builder, (self.count, self.tangents) = builder, lanes.shape(lane)
        self.words: dict[Any, Any] = {
            lanes.load: self.load,
            lanes.store: self.store,
            lanes.splat: lambda lane, x: self.value(x),
            lanes.select_lt: lambda *items: symbols.select_lt(*(self.value(x) for x in items)),
            lanes.absolute: symbols.absolute,
            lanes.square_root: symbols.square_root,
            lanes.turn: symbols.turned,
            lanes.round_even: symbols.round_even,
            lanes.alone: lambda x: x.alone,
            lanes.change: symbols.change,
            lanes.with_slope: symbols.with_slope,
            stack: lambda lane, sizes: [None] * len(sizes),
            size: lambda n: len(n) if isinstance(n, tuple) else n,
            aligned_frame: lambda lane: None,
        }

    def value(self, x: Any) -> Value:
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    def load(self, lane: Any, array: Any, k: int) -> Value:
        return array[k] if isinstance(array, list) else array.get(k, self.count, self.tangents)

    def store(self, array: Any, k: int, value: Any) -> None:
        if isinstance(array, list):
            array[k] = self.value(value)
        else:
            array.put(k, self.value(value), self.count, self.tangents)

    def on_symbols(self, function: Any) -> Any:
        """The function, and all that is traced with it, with the functions of lanes.py replaced."""
        if function in self.words:
            return self.words[function]
        if hasattr(function, "choice"):
            return lambda *args: self.on_symbols(function.choice(*args))(*args)
        source = _SOURCES.get(function, function)
        source = getattr(source, "py_func", source)
        scope = dict(source.__globals__)
        copy = python.FunctionType(source.__code__, scope, source.__name__, source.__defaults__, source.__closure__)
        self.words[function] = copy
        for name in _names(source.__code__):
            if self._goes_with(scope.get(name), source.__module__):
                scope[name] = self.on_symbols(scope[name])
        return copy

    def _goes_with(self, item: Any, module: str) -> bool:
        if not callable(item) or not isinstance(item, Hashable):
            return False
        own = isinstance(item, python.FunctionType) and item.__module__ == module
        return own or item in self.words or item in _SOURCES or is_jitted(item) or hasattr(item, "choice")

    def symbol(self, context: Any, kind: Any, value: Any) -> Any:
        """What stands for an argument of a Numba type."""
        if isinstance(kind, types.BaseTuple):
            if all(isinstance(k, types.Integer) for k in kind):
                return (0,) * len(kind)
            parts = [self.symbol(context, k, self.builder.extract_value(value, i)) for i, k in enumerate(kind)]
            if not isinstance(kind, types.BaseNamedTuple):
                return tuple(parts)
            fields = dict(zip(kind.fields, parts, strict=True))
            return python.SimpleNamespace(**fields, instance_class=kind.instance_class)
        if isinstance(kind, BareType | types.Array):
            known = kind.dtype == types.float64
            return Slots(self.builder, pointer(context, self.builder, kind, value)) if known else None
        if isinstance(kind, types.Float | lanes.LanesType):
            return lanes.symbol(context, self.builder, kind, value)
        if isinstance(kind, types.Optional):
            raise TypeError(f"{kind}: whether it is None must be known when the kernel is written out")
        return None


def _names(code: Any) -> Iterator[str]:
    """Global names that a function's code, and what is defined within it, may look up."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, python.CodeType):
            yield from _names(inner)


def _straight(function: Any, lane: int, result: Callable[[Any, int], Any]) -> Any:
    """The intrinsic that traces a function. lane: place of that argument; result: its type from kinds and lanes."""

    def typed(typingctx: Any, *kinds: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            held = lanes.lane_type(len(signature.args[lane]))
            tracer = Tracer(builder, held)
            symbols = [tracer.symbol(context, k, x) for k, x in zip(signature.args, args, strict=True)]
            values = tracer.on_symbols(function)(*symbols)
            if signature.return_type == types.void:
                return context.get_dummy_value()
            return context.make_tuple(builder, signature.return_type, [lanes.number(held, x) for x in values])

        return result(kinds, len(kinds[lane]))(*kinds), codegen

    source = getattr(function, "py_func", function)
    typed.__name__ = typed.__qualname__ = source.__name__
    typed.__module__, typed.__doc__ = source.__module__, source.__doc__
    first = inspect.Parameter("typingctx", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = (first, *inspect.signature(source).parameters.values())
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # which Numba goes by
    made = intrinsic(typed)
    _SOURCES[made] = function
    return made


def traced(results: Callable[[int], int]) -> Callable[[Any], Any]:
    """`results(p)`: how many lanes a function with an argument `order` of p zeros returns, in a tuple; 0: nothing."""

    def decorate(function: Any) -> Any:
        if config.DISABLE_JIT:
            return function
        names = list(inspect.signature(function).parameters)
        order = names.index("order")

        def result(kinds: Any, count: int) -> Any:
            n = results(len(kinds[order]))
            return types.UniTuple(lanes.lane_type(count), n) if n else types.void

        return _straight(function, names.index("lane"), result)

    return decorate


def unrolled(function: Any) -> Any:
    """Straight-line code of a kernel that returns nothing and has arguments `lane` and `model`, sizes permitting."""
    if config.DISABLE_JIT:
        return function
    names = list(inspect.signature(function.py_func).parameters)
    model = names.index("model")
    straight = _straight(function, names.index("lane"), lambda kinds, count: types.void)

    def chosen(kinds: Any) -> Any:
        n = kinds[model][kinds[model].fields.index("n")]
        return straight if isinstance(n, types.BaseTuple) else function

    def stand_in(*args: Any) -> None:
        function(*args)

    name = f"{function.py_func.__name__}_unrolled"
    take_name(stand_in, name, vars(sys.modules[function.py_func.__module__]))
    call_chosen(stand_in, chosen)
    _SOURCES[stand_in] = function
    return stand_in


@intrinsic
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
aligned_frame = _no_frame if config.DISABLE_JIT else _aligned_frame
