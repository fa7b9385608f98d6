"""Numbers of run time as symbols of Python: each operation on one writes instructions.

A `Value` is a float64 or a vector of lanes, alone or *dual*: with tangents, its derivatives along some directions. The
rules of differentiation stand here, once: kernels' operations on lanes (`lanes`) and straight-line code (`trace`) are
both made of these. What a value is does not depend on its tangents, to the last bit. At a kink the derivative is that
of the branch taken: of a choice that which is chosen, of |x| at 0 that from above; of a square root at 0 it is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

DOUBLE = ir.DoubleType()
SLOT, INDEX = ir.IntType(32), ir.IntType(64)


def vector(count: int) -> ir.Type:
    """The type of `count` numbers."""
    return DOUBLE if count == 1 else ir.VectorType(DOUBLE, count)


def broadcast(builder: Any, value: Any, count: int) -> Any:
    """A scalar repeated in every lane."""
    if count == 1:
        return value
    first = builder.insert_element(ir.Constant(vector(count), ir.Undefined), value, ir.Constant(SLOT, 0))
    return builder.shuffle_vector(
        first, ir.Constant(vector(count), ir.Undefined), ir.Constant(ir.VectorType(SLOT, count), [0] * count)
    )


class Value:
    """A float64 (count 1) or a vector of lanes that exists at run time; tangents: likewise, none of a constant."""

    def __init__(self, builder: Any, value: Any, count: int, tangents: Sequence[Value] = ()) -> None:
        self.builder, self.value, self.count, self.tangents = builder, value, count, tuple(tangents)

    @classmethod
    def of(cls, builder: Any, parts: Sequence[Any], count: int) -> Value:
        """Of its parts, numbers in `count` lanes."""
        first, *rest = [cls(builder, part, count) for part in parts]
        return first.having(rest)

    def wide(self, count: int) -> Any:
        """The same in `count` lanes."""
        return self.value if self.count == count else broadcast(self.builder, self.value, count)

    def parts(self, count: int, tangents: int) -> list[Any]:
        """The value and its tangents in `count` lanes: numbers."""
        slopes = self.tangents or (self.other(0.0),) * tangents
        return [x.wide(count) for x in (self, *slopes)]

    def full(self, count: int, tangents: int) -> Value:
        """The same in so many lanes with so many tangents."""
        return Value.of(self.builder, self.parts(count, tangents), count)

    def like(self, value: Any, count: int) -> Value:
        """A new value."""
        return Value(self.builder, value, count)

    def other(self, x: Any) -> Value:
        """x as a Value."""
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    @property
    def alone(self) -> Value:
        """The value without its tangents."""
        return self.like(self.value, self.count)

    def _binary(self, instruction: str, a: Any, b: Any) -> Value:
        """An instruction on values, tangents left aside."""
        count = max(a.count, b.count)
        return self.like(getattr(self.builder, instruction)(a.wide(count), b.wide(count)), count)

    def having(self, tangents: Sequence[Value]) -> Value:
        """The value with these tangents."""
        return Value(self.builder, self.value, self.count, tangents)

    def __add__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fadd", self, x).having(_sum(self.tangents, x.tangents))

    def __radd__(self, x: Any) -> Value:
        return self.other(x) + self

    def __sub__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fsub", self, x).having(_difference(self.tangents, x.tangents))

    def __rsub__(self, x: Any) -> Value:
        return self.other(x) - self

    def __mul__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fmul", self, x).having(_sum(_times(self.tangents, x), _times(x.tangents, self)))

    def __rmul__(self, x: Any) -> Value:
        return self.other(x) * self

    def __truediv__(self, x: Any) -> Value:
        x = self.other(x)
        ratio = self._binary("fdiv", self, x)
        if not self.tangents and not x.tangents:
            return ratio
        inverse = self._binary("fdiv", self.other(1.0), x)
        return ratio.having(_times(_difference(self.tangents, _times(x.tangents, ratio)), inverse))

    def __rtruediv__(self, x: Any) -> Value:
        return self.other(x) / self

    def __neg__(self) -> Value:
        return self.like(self.builder.fneg(self.value), self.count).having([-x for x in self.tangents])

    def __bool__(self) -> bool:
        raise TypeError("a value is not known when the kernel is written out: no branch may depend on it")

    def call(self, name: str) -> Value:
        """An LLVM intrinsic of one argument, of the value alone."""
        kind = vector(self.count)
        suffix = "f64" if self.count == 1 else f"v{self.count}f64"
        function = self.builder.module.declare_intrinsic(f"llvm.{name}.{suffix}", (), ir.FunctionType(kind, [kind]))
        return self.like(self.builder.call(function, [self.value]), self.count)


Tangents = Sequence[Value]


def _times(a: Tangents, b: Value) -> Tangents:
    return [x * b.alone for x in a]


def _sum(a: Tangents, b: Tangents) -> Tangents:
    return [x + y for x, y in zip(a, b, strict=True)] if a and b else a or b


def _difference(a: Tangents, b: Tangents) -> Tangents:
    if not a or not b:
        return a or [-y for y in b]
    return [x - y for x, y in zip(a, b, strict=True)]


def select_lt(a: Value, b: Value, x: Value, y: Value) -> Value:
    """x where a < b, otherwise y."""
    count = max(item.count for item in (a, b, x, y))
    less = a.builder.fcmp_ordered("<", a.wide(count), b.wide(count))
    found = len(x.tangents or y.tangents)
    pairs = zip(x.parts(count, found), y.parts(count, found), strict=True)
    return Value.of(a.builder, [a.builder.select(less, one, other) for one, other in pairs], count)


def absolute(x: Value) -> Value:
    """|x|"""
    return x.call("fabs").having([select_lt(x.alone, x.other(0.0), -slope, slope) for slope in x.tangents])


def square_root(x: Value) -> Value:
    """The square root of x."""
    result = x.call("sqrt")
    if not x.tangents:
        return result
    zero = x.other(0.0)
    slope = select_lt(zero, result, x.other(0.5) / result, zero)
    return result.having(_times(x.tangents, slope))


def round_even(x: Value) -> Value:
    """The nearest whole number, ties to even."""
    return x.call("rint")


def largest(x: Value) -> Value:
    """The largest entry of all lanes (NaN entries are passed over)."""
    x = alone(x)
    if x.count == 1:
        return x
    builder = x.builder
    result = builder.extract_element(x.value, ir.Constant(SLOT, 0))
    for i in range(1, x.count):
        entry = builder.extract_element(x.value, ir.Constant(SLOT, i))
        result = builder.select(builder.fcmp_ordered("<", result, entry), entry, result)
    return x.like(result, 1)


def with_slope(y: Value, x: Value, slope: Value) -> Value:
    """y, a function of x whose derivative is `slope`."""
    if hasattr(y.builder, "sloped"):
        return y.builder.sloped(y, x, slope)
    return y.alone.having(_times(x.tangents, slope))


def alone(x: Value) -> Value:
    """x without its tangents."""
    return x.builder.constant(x) if hasattr(x.builder, "constant") else x.alone


def change(x: Value) -> Value:
    """-0 with the tangents of x: added to a number it changes the tangents alone."""
    return x.other(-0.0).having(x.tangents)


def turned(t: Value, s: Value, c: Value) -> tuple[Value, Value]:
    """(sine, cosine) of an angle whose remainder from k right angles has sine s and cosine c; t: 1.5 * 2^52 + k."""
    builder, count = t.builder, t.count
    kind = INDEX if count == 1 else ir.VectorType(INDEX, count)

    def constant(x: int) -> Any:
        return ir.Constant(kind, x if count == 1 else [x] * count)

    def signed(x: Any, bit: Any) -> Value:
        sign = builder.and_(builder.shl(bit, constant(62)), constant(-(2**63)))
        return t.like(builder.bitcast(builder.xor(builder.bitcast(x, kind), sign), vector(count)), count)

    k = builder.bitcast(t.value, kind)
    odd = builder.icmp_unsigned("!=", builder.and_(k, constant(1)), constant(0))
    sine, cosine = builder.select(odd, c.value, s.value), builder.select(odd, s.value, c.value)
    return signed(sine, k), signed(cosine, builder.add(k, constant(1)))
