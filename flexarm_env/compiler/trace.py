"""Straight-line code: Python that runs once, at compile time, on symbolic values.

A traced function gets a `Value` for each number and a `Slots` for each array; each operation on them writes one LLVM
instruction into the calling kernel. Python executes all loops and all operations on tables, lists and dicts, so that
only arithmetic on numbers remains to be compiled. In traced code indices are constants, and memory from `stack` becomes
registers. A traced function accesses arrays of lanes (`lane_arrays`) at indices known at compile time, and does not
branch on symbolic values. Kernels and functions of the same module that a traced function calls are traced, too. Lane
tags and sizes, which are tuples of zeros, and None are passed to a traced function unchanged.

`@unrolled` is for a kernel with loops over the Model's size `n`. If n is a tag, a tuple of zeros, the kernel is traced.
If n is a number, the same source is compiled with its loops. `@traced` is for functions that are always traced. Traced
and compiled code perform the same operations in the same order and therefore give the same bits. If compilation is
disabled, traced functions run on plain numbers.
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
from .lane_arrays import lane_fields, lane_parameters
from .operators import has_operators
from .symbols import DOUBLE, Value, vector
from .words import SYMBOLIC


class Slots:
    """Array of float64 at run time in traced code: `slots[k]` is its element k, for k known at compile time."""

    def __init__(self, builder: Any, array: Array) -> None:
        self.builder, self.array, self.data = builder, array, array.data

    def address(self, k: int, count: int) -> Any:
        """Return the address of element k of `count` lanes, without tangents."""
        place = self.builder.gep(self.data, [ir.Constant(ir.IntType(64), k * count)], inbounds=True)
        return place if count == 1 else self.builder.bitcast(place, vector(count).as_pointer())

    def __getitem__(self, k: int) -> Value:
        """Return element k of an array of plain numbers: one lane, no tangents."""
        return self.get(k, 1, 0)

    def get(self, k: int, count: int, tangents: int) -> Value:
        """Load element k of `count` lanes, with its tangents, as a `Value`."""
        places = [self.address(k * (1 + tangents) + part, count) for part in range(1 + tangents)]
        return Value.of(self.builder, [self.builder.load(place, align=8) for place in places], count)

    def put(self, k: int, value: Value, count: int, tangents: int) -> None:
        """Store element k of `count` lanes, with its tangents. Raises a compile error (`Refused`) for a read-only
        array.
        """
        self.array.written()
        for part, x in enumerate(value.parts(count, tangents)):
            self.builder.store(x, self.address(k * (1 + tangents) + part, count), align=8)


class LaneSlots:
    """Array of lanes in traced code: `slots[k]` is element k of every lane, for k known at compile time."""

    def __init__(self, tracer: Any, slots: Slots) -> None:
        self.tracer, self.slots = tracer, slots

    def __getitem__(self, k: int) -> Value:
        return self.slots.get(k, self.tracer.count, self.tracer.tangents)

    def __setitem__(self, k: int, value: Any) -> None:
        self.slots.put(k, self.tracer.value(value), self.tracer.count, self.tracer.tangents)


class Registers(list[Any]):
    """Stack memory in traced code: a list of one `Value` for each element of all lanes."""

    def __init__(self, tracer: Any, count: int) -> None:
        super().__init__([None] * count)
        self.tracer = tracer

    def __setitem__(self, k: Any, value: Any) -> None:
        super().__setitem__(k, self.tracer.value(value))


class Tracer:
    """Runs a function on symbolic values in the kernel that `writer` writes, for the lanes of one tag.

    count, tangents: numbers of lanes and of tangents of an array element.
    words: dict that replaces each function of lanes.py and each traced function by a function of symbolic values.
    """

    def __init__(self, writer: Any, lane: tuple[int, ...]) -> None:
        """lane: the tag that the traced function is called with."""
        self.writer, self.builder = writer, writer.b
        self.count, self.tangents = lanes.shape(len(lane))
        self.words: dict[Any, Any] = {
            lanes.load: self.load,
            lanes.store: self.store,
            lanes.splat: lambda lane, x: self.value(x),
            # stack memory is a list of `Value`s: registers
            lanes.stack: lambda lane, sizes: Registers(self, len(sizes)),
            lanes.size: lambda n: len(n) if isinstance(n, tuple) else n,
            **{word: self._on_values(function) for word, function in SYMBOLIC.items()},
        }

    def _on_values(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that converts its arguments to `Value` before it calls the given function."""
        return lambda *items: function(*map(self.value, items))

    def value(self, x: Any) -> Value:
        """Return x as a `Value`; a Python number becomes a constant."""
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    def slots(self, array: Array) -> Slots:
        """Return the `Slots` of an array argument."""
        return Slots(self.builder, array)

    def close(self) -> None:
        """Finish the traced code. A subclass stores the values that are still in registers."""

    def load(self, lane: Any, array: Any, k: int) -> Value:
        """Return element k of every lane of stack memory (a list), or load it from an array."""
        return array.get(k, self.count, self.tangents) if isinstance(array, Slots) else array[k]

    def store(self, array: Any, k: int, value: Any) -> None:
        """Set element k of every lane of stack memory (a list) or of an array."""
        if isinstance(array, Slots):
            array.put(k, self.value(value), self.count, self.tangents)
        else:
            array[k] = self.value(value)

    def on_symbols(self, function: Any) -> Any:
        """Return a copy of a function (and of the functions that it calls) in which `self.words` replace global names.

        At each call of a family's function, the kernel is chosen by the class of an argument. Global names are recorded
        for the cache key.
        """
        if function in self.words:
            return self.words[function]
        # a member of a family: traced once its argument's class is known
        if hasattr(function, "choice"):
            return lambda *args: self.on_symbols(function.choice(*args))(*args)
        source = _plain(function)
        self.writer.module.used.setdefault(source, set()).update(global_names(source))
        scope = dict(source.__globals__)
        # same bytecode, other globals; entered in `words` first, for mutual references
        copy = python.FunctionType(source.__code__, scope, source.__name__, source.__defaults__, source.__closure__)
        self.words[function] = self._declaring(source, copy)
        # replace the global names that stand for words or traced functions
        for name in _names(source.__code__):
            if self._goes_with(scope.get(name), source.__module__):
                scope[name] = self.on_symbols(scope[name])
        return self.words[function]

    def _declaring(self, source: Any, copy: Any) -> Any:
        """Return a traced function whose array arguments hold lanes or numbers, as the annotations of `source`
        declare.
        """
        names = source.__code__.co_varnames[: source.__code__.co_argcount]
        said = lane_parameters(source)

        def run(*args: Any, **named: Any) -> Any:
            """Call the traced function, its arrays indexed by elements of lanes or by numbers."""
            given = {**dict(zip(names, args, strict=False)), **named}
            return copy(**{name: self.declared(item, said.get(name)) for name, item in given.items()})

        return run

    def declared(self, item: Any, holds: bool | None) -> Any:
        """Return an array (argument or field) as `LaneSlots` if it is annotated with `Lanes`, otherwise as `Slots`.

        holds: True for `Lanes`, False for another annotation, None without annotation. Other items are returned
        unchanged.
        """
        if isinstance(item, Slots) and holds:
            return LaneSlots(self, item)
        if holds is not None and isinstance(item, tuple) and hasattr(item, "_fields"):
            # a named tuple that traced code has made
            made: Any = type(item)
            held = lane_fields(made)
            return made(*[self.declared(x, name in held) for name, x in zip(made._fields, item, strict=True)])
        return item.slots if isinstance(item, LaneSlots) and not holds else item

    def _goes_with(self, item: Any, module: str) -> bool:
        """Return whether a global object is traced too: words, kernels, functions of the same module, families."""
        if not callable(item) or not isinstance(item, Hashable):
            return False
        # plain functions of other modules run as they are
        own = isinstance(item, python.FunctionType) and item.__module__ == module
        return own or item in self.words or isinstance(item, Straight | Kernel) or hasattr(item, "choice")

    def symbol(self, item: Any) -> Any:
        """Return an argument in the form that traced code uses; None for an integer or an array of another type than
        float64.

        Arrays become `Slots`, and named tuples become namespaces of their fields. Numbers and static items are returned
        unchanged.
        """
        if isinstance(item, Array):
            return self.slots(item) if item.letter == "f" else None
        if isinstance(item, Record | Stored):
            names, held = item.instance_class._fields, lane_fields(item.instance_class)
            parts = zip(names, map(self.symbol, self.writer.parts(item)), strict=True)
            values = [self.declared(part, name in held) for name, part in parts]
            if has_operators(item.instance_class):
                return item.instance_class(*values)
            # instance_class lets families choose by the named tuple's class
            return python.SimpleNamespace(**dict(zip(names, values, strict=True)), instance_class=item.instance_class)
        if is_tuple(item):
            return tuple(map(self.symbol, item))
        return item if isinstance(item, Value) or is_static(item) else None


def _names(code: Any) -> Iterator[str]:
    """Yield the global names that a code object, or a code object nested within it, may look up."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, python.CodeType):
            yield from _names(inner)


def global_names(function: Any) -> Iterator[str]:
    """Yield the global names that a function may read, attributes of modules and classes too (`constants.PI`)."""
    names, scope = set(_names(function.__code__)), function.__globals__
    for name in names & scope.keys():
        yield name
        if isinstance(scope[name], python.ModuleType | type):
            yield from (f"{name}.{part}" for part in names if hasattr(scope[name], part))


def _plain(function: Any) -> Any:
    """Return the Python function behind a kernel or straight-line code."""
    while isinstance(function, Straight | Kernel):
        function = function.function
    return function


class Straight:
    """A function that is traced, and therefore inlined, at each call by a kernel.

    when: function when(arguments by name, writer) that returns the condition. If the condition is False, `function` is
    a kernel and is called instead of traced.
    traits: strings that are part of the cache key.
    """

    def __init__(self, function: Any, when: Callable[[dict[str, Any], Any], bool] | None = None) -> None:
        """Store the function, its argument names and the condition for tracing it."""
        self.function, self._when = function, when
        self.traits: tuple[str, ...] = ("unrolled",) if when else ()
        self.names = list(inspect.signature(_plain(function)).parameters)
        self.__name__ = _plain(function).__name__
        self.__module__, self.__doc__ = function.__module__, function.__doc__

    def __call__(self, *items: Any) -> Any:
        return self.function(*items)

    def written(self, writer: Any, items: list[Any]) -> Any:
        """Trace the function into the calling kernel; return its results with lanes and tangents, or None."""
        given = dict(zip(self.names, items, strict=True))
        if self._when is not None and not self._when(given, writer):
            return writer.module.call(writer, self.function, items, {})
        # reverse mode has a tracer of its own
        tracer = getattr(writer, "tracer", functools.partial(Tracer, writer))(given["lane"])
        found = tracer.on_symbols(self)(*map(tracer.symbol, items))
        tracer.close()
        if found is None:
            return None
        # results of plain numbers get lanes and tangents, too
        return tuple(tracer.value(x).full(tracer.count, tracer.tangents) for x in found)


def traced(function: Any) -> Any:
    """Decorator of functions that consist of straight-line code: they are traced where kernels call them."""
    return function if UNCOMPILED else Straight(function)


def unrolled(function: Any) -> Any:
    """Decorator of kernels with the arguments `lane`, `model`, ...: traced if model.n is a tag, otherwise compiled.

    The kernel returns a tuple or nothing.
    """
    if UNCOMPILED:
        return function

    def sized(given: dict[str, Any], writer: Any) -> bool:
        """Return whether the model's field n is a tuple of zeros, a size known at compile time."""
        model = given["model"]
        if not isinstance(model, Record | Stored):
            raise Refused(f"{function.__name__}() wants a Model")
        return is_tuple(writer.field(model, "n"))

    return Straight(function, sized)
