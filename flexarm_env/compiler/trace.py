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

import functools
import inspect
import types as python
from collections.abc import Callable, Hashable, Iterator
from typing import Any

from llvmlite import ir

from . import lanes
from .decorator import UNCOMPILED, Kernel
from .kinds import Array, Record, Refused, Stored, is_static, is_tuple
from .symbols import DOUBLE, Value, vector
from .words import SYMBOLIC


class Slots:
    """An array at run time: `slots[k]` is its k-th number, k known at compile time."""

    def __init__(self, builder: Any, array: Array) -> None:
        self.builder, self.array, self.data = builder, array, array.data

    def address(self, k: int, count: int) -> Any:
        """Where the k-th `count` numbers lie."""
        place = self.builder.gep(self.data, [ir.Constant(ir.IntType(64), k * count)], inbounds=True)
        return place if count == 1 else self.builder.bitcast(place, vector(count).as_pointer())

    def __getitem__(self, k: int) -> Value:
        return self.get(k, 1, 0)

    def get(self, k: int, count: int, tangents: int) -> Value:
        """Element k of `count` lanes, with its tangents."""
        places = [self.address(k * (1 + tangents) + part, count) for part in range(1 + tangents)]
        return Value.of(self.builder, [self.builder.load(place, align=8) for place in places], count)

    def put(self, k: int, value: Value, count: int, tangents: int) -> None:
        """Write element k."""
        self.array.written()
        for part, x in enumerate(value.parts(count, tangents)):
            self.builder.store(x, self.address(k * (1 + tangents) + part, count), align=8)


class Tracer:
    """What the functions of lanes.py are on symbols, for lanes of one type."""

    def __init__(self, writer: Any, lane: tuple[int, ...]) -> None:
        self.writer, self.builder = writer, writer.b
        self.count, self.tangents = lanes.shape(len(lane))
        self.words: dict[Any, Any] = {
            lanes.load: self.load,
            lanes.store: self.store,
            lanes.splat: lambda lane, x: self.value(x),
            lanes.stack: lambda lane, sizes: [None] * len(sizes),
            lanes.size: lambda n: len(n) if isinstance(n, tuple) else n,
            **{word: self._on_values(function) for word, function in SYMBOLIC.items()},
        }

    def _on_values(self, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *items: function(*map(self.value, items))

    def value(self, x: Any) -> Value:
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    def slots(self, array: Array) -> Slots:
        """An array of numbers."""
        return Slots(self.builder, array)

    def close(self) -> None:
        """All is written."""

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
        source = _plain(function)
        self.writer.module.used.setdefault(source, set()).update(_reads(source))
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
        return own or item in self.words or isinstance(item, Straight | Kernel) or hasattr(item, "choice")

    def symbol(self, item: Any) -> Any:
        """What stands for an item of the calling kernel's; None: a whole number, or an array of others than float64."""
        if isinstance(item, Array):
            return self.slots(item) if item.letter == "f" else None
        if isinstance(item, Record | Stored):
            values = map(self.symbol, self.writer.parts(item))
            names = item.instance_class._fields
            return python.SimpleNamespace(**dict(zip(names, values, strict=True)), instance_class=item.instance_class)
        if is_tuple(item):
            return tuple(map(self.symbol, item))
        return item if isinstance(item, Value) or is_static(item) else None


def _names(code: Any) -> Iterator[str]:
    """Global names that a function's code, and what is defined within it, may look up."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, python.CodeType):
            yield from _names(inner)


def _reads(function: Any) -> Iterator[str]:
    """Global names that a function may read, `constants.PI` too."""
    names, scope = set(_names(function.__code__)), function.__globals__
    for name in names & scope.keys():
        yield name
        if isinstance(scope[name], python.ModuleType | type):
            yield from (f"{name}.{part}" for part in names if hasattr(scope[name], part))


def _plain(function: Any) -> Any:
    """The Python function behind a kernel, or behind straight-line code."""
    while isinstance(function, Straight | Kernel):
        function = function.function
    return function


class Straight:
    """A function that is written out where kernels call it.

    when: for arguments, whether it is; otherwise `function`, a kernel, is called.
    """

    def __init__(self, function: Any, when: Callable[[dict[str, Any], Any], bool] | None = None) -> None:
        self.function, self._when = function, when
        self.names = list(inspect.signature(_plain(function)).parameters)
        self.__name__ = _plain(function).__name__
        self.__module__, self.__doc__ = function.__module__, function.__doc__

    def __call__(self, *items: Any) -> Any:
        return self.function(*items)

    def written(self, writer: Any, items: list[Any]) -> Any:
        """The function's code in the calling kernel; what it returns."""
        given = dict(zip(self.names, items, strict=True))
        if self._when is not None and not self._when(given, writer):
            return writer.module.call(writer, self.function, items, {})
        tracer = getattr(writer, "tracer", functools.partial(Tracer, writer))(given["lane"])
        found = tracer.on_symbols(self)(*map(tracer.symbol, items))
        tracer.close()
        if found is None:
            return None
        return tuple(tracer.value(x).full(tracer.count, tracer.tangents) for x in found)


def traced(function: Any) -> Any:
    """Straight-line code throughout."""
    return function if UNCOMPILED else Straight(function)


def unrolled(function: Any) -> Any:
    """Straight-line code of a kernel of `lane`, `model`, ... that returns a tuple or nothing, sizes permitting."""
    if UNCOMPILED:
        return function

    def sized(given: dict[str, Any], writer: Any) -> bool:
        model = given["model"]
        if not isinstance(model, Record | Stored):
            raise Refused(f"{function.__name__}() wants a Model")
        return is_tuple(writer.field(model, "n"))

    return Straight(function, sized)
