"""Straight-line code backwards: from a kernel, the one that pulls cotangents from what it writes to what it reads.

`vjp_of(function, names)` traces a kernel (see `trace`), remembering of each operation what it was made of, and writes
the sweep back behind it: derivatives by all inputs at once, for a few times what the function itself costs. The
result takes the function's arguments, then for each array in `names` one of cotangents. Of elements that the function
writes these are taken, and then 0, or what they come to where the old content was read as well; to those that it only
reads is added. The arrays themselves stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir

from . import lanes, symbols
from .decorator import UNCOMPILED
from .symbols import DOUBLE, Value
from .trace import Slots, Straight, Tracer

Pull = tuple[Any, Callable[[Value], Value]]


def _plain(x: Any) -> Any:
    return x.of if isinstance(x, Taped) else x


class Tape:
    """What was made of what, in order, and the cotangents on the way back."""

    def __init__(self) -> None:
        self.nodes: list[Taped] = []

    def made(self, value: Value, *pulls: Pull) -> Value:
        """A value with what pulls its cotangent back to each of those that it depends on."""
        kept = [(x, pull) for x, pull in pulls if isinstance(x, Taped)]
        if not kept:
            return value
        self.nodes.append(Taped(self, value, kept))
        return self.nodes[-1]

    def leaf(self, value: Value) -> Taped:
        """A value that derivatives are taken by."""
        self.nodes.append(Taped(self, value, []))
        return self.nodes[-1]

    def sweep(self) -> None:
        """Cotangents of all that the outputs depend on."""
        for node in reversed(self.nodes):
            if node.cotangent is not None:
                for parent, pull in node.pulls:
                    parent.take(pull(node.cotangent))

    # --- functions of lanes -----------------------------------------------------------------------
    def select_lt(self, a: Any, b: Any, x: Any, y: Any) -> Value:
        a, b, x, y = (_plain(a), _plain(b), x, y)
        return self.made(
            symbols.select_lt(a, b, _plain(x), _plain(y)),
            (x, lambda g: symbols.select_lt(a, b, g, g.other(0.0))),
            (y, lambda g: symbols.select_lt(a, b, g.other(0.0), g)),
        )

    def absolute(self, x: Any) -> Value:
        own = _plain(x)
        return self.made(symbols.absolute(own), (x, lambda g: symbols.select_lt(own, own.other(0.0), -g, g)))

    def square_root(self, x: Any) -> Value:
        root = symbols.square_root(_plain(x))
        zero = root.other(0.0)
        return self.made(root, (x, lambda g: symbols.select_lt(zero, root, g * 0.5 / root, zero)))

    def with_slope(self, y: Any, x: Any, slope: Any) -> Value:
        own = _plain(slope)
        return self.made(_plain(y), (x, lambda g: g * own))


class Taped(Value):
    """A value that remembers what it was made of."""

    def __init__(self, tape: Tape, of: Value, pulls: list[Pull]) -> None:
        super().__init__(of.builder, of.value, of.count)
        self.tape, self.of, self.pulls = tape, of, pulls
        self.cotangent: Value | None = None

    def take(self, cotangent: Value) -> None:
        """Add to the cotangent."""
        self.cotangent = cotangent if self.cotangent is None else self.cotangent + cotangent

    @property
    def alone(self) -> Value:
        return self.of

    def __add__(self, x: Any) -> Value:
        return self.tape.made(self.of + _plain(x), (self, _same), (x, _same))

    __radd__ = __add__

    def __sub__(self, x: Any) -> Value:
        return self.tape.made(self.of - _plain(x), (self, _same), (x, _opposite))

    def __rsub__(self, x: Any) -> Value:
        return self.tape.made(_plain(x) - self.of, (self, _opposite), (x, _same))

    def __mul__(self, x: Any) -> Value:
        other = _plain(x)
        return self.tape.made(self.of * other, (self, lambda g: g * other), (x, lambda g: g * self.of))

    __rmul__ = __mul__

    def __truediv__(self, x: Any) -> Value:
        other = _plain(x)
        ratio = self.of / other
        return self.tape.made(ratio, (self, lambda g: g / other), (x, lambda g: -(g * ratio / other)))

    def __rtruediv__(self, x: Any) -> Value:
        ratio = _plain(x) / self.of
        return self.tape.made(ratio, (self, lambda g: -(g * ratio / self.of)), (x, lambda g: g / self.of))

    def __neg__(self) -> Value:
        return self.tape.made(-self.of, (self, _opposite))


def _same(g: Value) -> Value:
    return g


def _opposite(g: Value) -> Value:
    return -g


class _Kept:
    """An array of the function's: what it writes is remembered, the array stays. bar: its cotangents, or None."""

    def __init__(self, tape: Tape, slots: Slots, bar: Slots | None) -> None:
        self.tape, self.slots, self.bar = tape, slots, bar
        self.held: dict[int, Any] = {}
        self.leaves: dict[int, Taped] = {}
        self.written: dict[int, int] = {}

    def __getitem__(self, k: int) -> Any:
        assert self.bar is None and not self.held, "a number of an array of lanes"
        return self.slots[k]

    def get(self, k: int, count: int, tangents: int) -> Any:
        """Element k."""
        if k not in self.held:
            value = self.slots.get(k, count, tangents)
            if self.bar is not None:
                value = self.leaves[k] = self.tape.leaf(value)
            self.held[k] = value
        return self.held[k]

    def put(self, k: int, value: Any, count: int, tangents: int) -> None:
        """Write element k."""
        self.held[k], self.written[k] = value, count

    def give(self) -> None:
        """Cotangents of what was written."""
        if self.bar is not None:
            for k, count in self.written.items():
                if isinstance(self.held[k], Taped):
                    self.held[k].take(self.bar.get(k, count, 0))

    def collect(self) -> None:
        """Those of what was read, into the array of cotangents."""
        if self.bar is not None:
            for k, count in self.written.items():
                leaf = self.leaves.pop(k, None)
                found = None if leaf is None else leaf.cotangent
                zero = Value(self.slots.builder, ir.Constant(DOUBLE, 0.0), 1)
                self.bar.put(k, zero if found is None else found, count, 0)
            for k, leaf in self.leaves.items():
                if leaf.cotangent is not None:
                    self.bar.put(k, self.bar.get(k, leaf.count, 0) + leaf.cotangent, leaf.count, 0)


class _Backward(Tracer):
    """Functions of lanes that are taped."""

    def __init__(self, writer: Any, lane: tuple[int, ...]) -> None:
        super().__init__(writer, lane)
        self.tape = tape = Tape()
        self.words[lanes.select_lt] = lambda *items: tape.select_lt(*(self.value(x) for x in items))
        self.words[lanes.absolute] = tape.absolute
        self.words[lanes.square_root] = tape.square_root
        self.words[lanes.with_slope] = tape.with_slope
        self.words[lanes.round_even] = lambda x: symbols.round_even(x.alone)


def _wrapped(tape: Tape, item: Any, bar: Slots | None, all_kept: list[_Kept]) -> Any:
    """An argument with its arrays kept."""
    if isinstance(item, Slots):
        all_kept.append(_Kept(tape, item, bar))
        return all_kept[-1]
    return item


class Pulled(Straight):
    """A kernel backwards."""

    def __init__(self, function: Any, names: tuple[str, ...]) -> None:
        super().__init__(function)
        self._bars = names
        self.__name__ += "_pulled"

    def written(self, writer: Any, items: list[Any]) -> None:
        count = len(self.names)
        tracer = _Backward(writer, items[self.names.index("lane")])
        symbols_of = [tracer.symbol(item) for item in items]
        bars, kept = dict(zip(self._bars, symbols_of[count:], strict=True)), list[_Kept]()
        pairs = zip(self.names, symbols_of[:count], strict=True)
        given = [_wrapped(tracer.tape, item, bars.get(name), kept) for name, item in pairs]
        tracer.on_symbols(self.function)(*given)
        for array in kept:
            array.give()
        tracer.tape.sweep()
        for array in kept:
            array.collect()


def vjp_of(function: Any, names: tuple[str, ...]) -> Any:
    """See above. names: arrays among the function's own arguments."""
    return function if UNCOMPILED else Pulled(function, names)
