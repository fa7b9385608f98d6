"""Numbers of run time as symbols of Python: each operation on one writes instructions.

A `Value` is a float64 or a vector of lanes, alone or *dual*: with its tangent, its derivative along one direction. The
rules of differentiation stand here, once: kernels' operations on lanes (`lanes`) and straight-line code (`trace`) are
both made of these. What a value is does not depend on its tangent, to the last bit. At a kink the derivative is that of
the branch taken: of a choice that which is chosen, of |x| at 0 that from above; of a square root at 0 it is 0.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

DOUBLE = ir.DoubleType()
SLOT, INDEX = ir.IntType(32), ir.IntType(64)


def vector(count: int) -> ir.Type:
    """The type of `count` numbers."""
    return DOUBLE if count == 1 else ir.VectorType(DOUBLE, count)


def pair(count: int) -> ir.Type:
    """The type of `count` numbers and their tangents."""
    return ir.LiteralStructType([vector(count), vector(count)])


def broadcast(builder: Any, value: Any, count: int) -> Any:
    """A scalar repeated in every lane."""
    if count == 1:
        return value
    first = builder.insert_element(ir.Constant(vector(count), ir.Undefined), value, ir.Constant(SLOT, 0))
    return builder.shuffle_vector(
        first, ir.Constant(vector(count), ir.Undefined), ir.Constant(ir.VectorType(SLOT, count), [0] * count)
    )


class Value:
    """A float64 (count 1) or a vector of lanes that exists at run time; tangent: likewise, or None (constant)."""

    def __init__(self, builder: Any, value: Any, count: int, tangent: Any = None) -> None:
        self.builder, self.value, self.count, self.tangent = builder, value, count, tangent

    def wide(self, count: int) -> Any:
        """The same in `count` lanes."""
        return self.value if self.count == count else broadcast(self.builder, self.value, count)

    def slope(self, count: int) -> Any:
        """The tangent in `count` lanes: numbers."""
        if self.tangent is None:
            return broadcast(self.builder, ir.Constant(DOUBLE, 0.0), count)
        return self.tangent if self.count == count else broadcast(self.builder, self.tangent, count)

    def like(self, value: Any, count: int, tangent: Any = None) -> Value:
        """A new value."""
        return Value(self.builder, value, count, tangent)

    def other(self, x: Any) -> Value:
        """x as a Value."""
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    @property
    def alone(self) -> Value:
        """The value without its tangent."""
        return self.like(self.value, self.count)

    @property
    def rate(self) -> Value | None:
        """The tangent as a value of its own."""
        return None if self.tangent is None else self.like(self.tangent, self.count)

    def _binary(self, instruction: str, a: Any, b: Any) -> Value:
        """An instruction on values, tangents left aside."""
        count = max(a.count, b.count)
        return self.like(getattr(self.builder, instruction)(a.wide(count), b.wide(count)), count)

    def _with(self, tangent: Value | None) -> Value:
        """The value with a tangent."""
        return self if tangent is None else self.like(self.value, self.count, tangent.wide(self.count))

    def __add__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fadd", self, x)._with(_sum(self.rate, x.rate))

    def __radd__(self, x: Any) -> Value:
        return self.other(x) + self

    def __sub__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fsub", self, x)._with(_difference(self.rate, x.rate))

    def __rsub__(self, x: Any) -> Value:
        return self.other(x) - self

    def __mul__(self, x: Any) -> Value:
        x = self.other(x)
        return self._binary("fmul", self, x)._with(_sum(_times(self.rate, x), _times(x.rate, self)))

    def __rmul__(self, x: Any) -> Value:
        return self.other(x) * self

    def __truediv__(self, x: Any) -> Value:
        x = self.other(x)
        ratio = self._binary("fdiv", self, x)
        change = _difference(self.rate, _times(x.rate, ratio))
        return ratio._with(None if change is None else self._binary("fdiv", change, x))

    def __rtruediv__(self, x: Any) -> Value:
        return self.other(x) / self

    def __neg__(self) -> Value:
        value = self.like(self.builder.fneg(self.value), self.count)
        return value._with(None if self.rate is None else -self.rate)

    def __bool__(self) -> bool:
        raise TypeError("a value is not known when the kernel is written out: no branch may depend on it")

    def call(self, name: str) -> Value:
        """An LLVM intrinsic of one argument, of the value alone."""
        kind = vector(self.count)
        suffix = "f64" if self.count == 1 else f"v{self.count}f64"
        function = self.builder.module.declare_intrinsic(f"llvm.{name}.{suffix}", (), ir.FunctionType(kind, [kind]))
        return self.like(self.builder.call(function, [self.value]), self.count)


def _times(a: Value | None, b: Value) -> Value | None:
    return None if a is None else a * b.alone


def _sum(a: Value | None, b: Value | None) -> Value | None:
    if a is None or b is None:
        return b if a is None else a
    return a + b


def _difference(a: Value | None, b: Value | None) -> Value | None:
    if b is None:
        return a
    return -b if a is None else a - b


def select_lt(a: Value, b: Value, x: Value, y: Value) -> Value:
    """x where a < b, otherwise y."""
    count = max(item.count for item in (a, b, x, y))
    less = a.builder.fcmp_ordered("<", a.wide(count), b.wide(count))
    chosen = a.like(a.builder.select(less, x.wide(count), y.wide(count)), count)
    if x.tangent is not None or y.tangent is not None:
        chosen.tangent = a.builder.select(less, x.slope(count), y.slope(count))
    return chosen


def absolute(x: Value) -> Value:
    """|x|"""
    result = x.call("fabs")
    if x.rate is not None:
        result.tangent = select_lt(x.alone, x.other(0.0), -x.rate, x.rate).value
    return result


def square_root(x: Value) -> Value:
    """The square root of x."""
    result = x.call("sqrt")
    if x.rate is not None:
        zero = x.other(0.0)
        result.tangent = select_lt(zero, result.alone, x.rate * 0.5 / result.alone, zero).value
    return result


def round_even(x: Value) -> Value:
    """The nearest whole number, ties to even."""
    result = x.call("rint")
    return result if x.tangent is None else result._with(x.other(0.0))


def largest(x: Value) -> Value:
    """The largest entry of all lanes (NaN entries are passed over)."""
    if x.count == 1:
        return x.alone
    builder = x.builder
    result = builder.extract_element(x.value, ir.Constant(SLOT, 0))
    for i in range(1, x.count):
        entry = builder.extract_element(x.value, ir.Constant(SLOT, i))
        result = builder.select(builder.fcmp_ordered("<", result, entry), entry, result)
    return x.like(result, 1)


def with_slope(y: Value, x: Value, slope: Value) -> Value:
    """y, a function of x whose derivative is `slope`."""
    return y.alone._with(_times(x.rate, slope))


def change(x: Value) -> Value:
    """-0 with the tangent of x: added to a number it changes the tangent alone."""
    return x.like(broadcast(x.builder, ir.Constant(DOUBLE, -0.0), x.count), x.count, x.tangent)


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
