"""Symbolic float64 numbers: operators of `Value` write LLVM instructions, with forward-mode differentiation.

A `Value` is a float64 or a vector of lanes, alone or *dual*: with tangents, its derivatives along some directions. This
module defines the rules of differentiation for kernels' operations on lanes (`lanes`) and for straight-line code
(`trace`). The bits of a value are the same with and without tangents. At a kink the derivative is that of the branch
taken: for select_lt of the chosen operand, for |x| at 0 the derivative from above. The derivative of a square root at 0
is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

DOUBLE = ir.DoubleType()
SLOT, INDEX = ir.IntType(32), ir.IntType(64)


def vector(count: int) -> ir.Type:
    """Return the LLVM type of `count` lanes: double for 1, otherwise <count x double>."""
    return DOUBLE if count == 1 else ir.VectorType(DOUBLE, count)


def broadcast(builder: Any, value: Any, count: int) -> Any:
    """Emit instructions that repeat a scalar in all `count` lanes; return the vector."""
    if count == 1:
        return value
    # LLVM idiom of a splat: insert into lane 0, then shuffle lane 0 to all
    first = builder.insert_element(ir.Constant(vector(count), ir.Undefined), value, ir.Constant(SLOT, 0))
    return builder.shuffle_vector(
        first, ir.Constant(vector(count), ir.Undefined), ir.Constant(ir.VectorType(SLOT, count), [0] * count)
    )


class Value:
    """A float64 (count = 1) or a vector of `count` lanes at run time.

    builder: LLVM IR builder that the operations use.
    value: the LLVM value.
    tangents: one Value for each direction of differentiation; empty for a constant.
    """

    def __init__(self, builder: Any, value: Any, count: int, tangents: Sequence[Value] = ()) -> None:
        self.builder, self.value, self.count, self.tangents = builder, value, count, tuple(tangents)

    @classmethod
    def of(cls, builder: Any, parts: Sequence[Any], count: int) -> Value:
        """Make a Value from LLVM values of `count` lanes.

        parts: LLVM values of the number and of its tangents.
        """
        first, *rest = parts
        return cls(builder, first, count, [cls(builder, part, count) for part in rest])

    def wide(self, count: int) -> Any:
        """Return the LLVM value in `count` lanes (a scalar is broadcast), without tangents."""
        return self.value if self.count == count else broadcast(self.builder, self.value, count)

    def parts(self, count: int, tangents: int) -> list[Any]:
        """Return LLVM values of `count` lanes: the value, then `tangents` tangents. Tangents that the value does not
        have are 0."""
        if not tangents and not self.tangents:
            return [self.wide(count)]
        # a constant has tangents 0
        slopes = self.tangents or (self.other(0.0),) * tangents
        return [x.wide(count) for x in (self, *slopes)]

    def full(self, count: int, tangents: int) -> Value:
        """Return the Value broadcast to `count` lanes, with `tangents` tangents. Tangents that the value does not have
        are 0."""
        return Value.of(self.builder, self.parts(count, tangents), count)

    def like(self, value: Any, count: int) -> Value:
        """Return a Value of `count` lanes made from another LLVM value, without tangents, with the same builder."""
        return Value(self.builder, value, count)

    def other(self, x: Any) -> Value:
        """Return x as a Value; Python's numbers become constants."""
        return x if isinstance(x, Value) else Value(self.builder, ir.Constant(DOUBLE, float(x)), 1)

    @property
    def alone(self) -> Value:
        """Return the value without its tangents."""
        return self.like(self.value, self.count)

    def _binary(self, instruction: str, a: Any, b: Any) -> Value:
        """Write a binary instruction on the values of a and b, broadcast to a common lane count; no tangents."""
        count = max(a.count, b.count)
        return self.like(getattr(self.builder, instruction)(a.wide(count), b.wide(count)), count)

    def having(self, tangents: Sequence[Value]) -> Value:
        """Return a Value with the same number and with the given tangents."""
        return Value(self.builder, self.value, self.count, tangents)

    def __add__(self, x: Any) -> Value:
        """Emit self + x; tangents: self' + x'."""
        x = self.other(x)
        return self._binary("fadd", self, x).having(_sum(self.tangents, x.tangents))

    def __radd__(self, x: Any) -> Value:
        return self.other(x) + self

    def __sub__(self, x: Any) -> Value:
        """Emit self - x; tangents: self' - x'."""
        x = self.other(x)
        return self._binary("fsub", self, x).having(_difference(self.tangents, x.tangents))

    def __rsub__(self, x: Any) -> Value:
        return self.other(x) - self

    def __mul__(self, x: Any) -> Value:
        """Emit self x; tangents by the product rule, self' x + x' self."""
        x = self.other(x)
        return self._binary("fmul", self, x).having(_sum(_times(self.tangents, x), _times(x.tangents, self)))

    def __rmul__(self, x: Any) -> Value:
        return self.other(x) * self

    def __truediv__(self, x: Any) -> Value:
        """Emit self / x; tangents by the quotient rule, (self' - x' (self / x)) (1 / x)."""
        x = self.other(x)
        # the value is one division, rounded once, whatever the tangents
        ratio = self._binary("fdiv", self, x)
        if not self.tangents and not x.tangents:
            return ratio
        # one reciprocal serves all tangents
        inverse = self._binary("fdiv", self.other(1.0), x)
        return ratio.having(_times(_difference(self.tangents, _times(x.tangents, ratio)), inverse))

    def __rtruediv__(self, x: Any) -> Value:
        return self.other(x) / self

    def __neg__(self) -> Value:
        """Emit -self; tangents: -self'."""
        return self.like(self.builder.fneg(self.value), self.count).having([-x for x in self.tangents])

    def __bool__(self) -> bool:
        # Python asks for a truth value in `if`, `and`, `while`: such branches cannot be traced
        raise TypeError("a value is not known when the kernel is written out: no branch may depend on it")

    def call(self, name: str) -> Value:
        """Emit a call of the LLVM intrinsic `name` with the value as its argument; the result has no tangents."""
        kind = vector(self.count)
        # intrinsics are named by type: llvm.sqrt.f64, llvm.sqrt.v8f64
        suffix = "f64" if self.count == 1 else f"v{self.count}f64"
        function = self.builder.module.declare_intrinsic(f"llvm.{name}.{suffix}", (), ir.FunctionType(kind, [kind]))
        return self.like(self.builder.call(function, [self.value]), self.count)


Tangents = Sequence[Value]


def _times(a: Tangents, b: Value) -> Tangents:
    """Return the tangents a_i times the value of b, without b's tangents; empty if a is constant."""
    return [x * b.alone for x in a]


def _sum(a: Tangents, b: Tangents) -> Tangents:
    """Return the tangents a_i + b_i; an empty sequence stands for zeros."""
    return [x + y for x, y in zip(a, b, strict=True)] if a and b else a or b


def _difference(a: Tangents, b: Tangents) -> Tangents:
    """Return the tangents a_i - b_i; an empty sequence stands for zeros."""
    if not a or not b:
        return a or [-y for y in b]
    return [x - y for x, y in zip(a, b, strict=True)]


def select_lt(a: Value, b: Value, x: Value, y: Value) -> Value:
    """Return x where a < b, otherwise y, lane by lane and without a branch (also y where a or b is NaN).

    The tangents of the result are those of the chosen operand.
    """
    count = max(item.count for item in (a, b, x, y))
    # ordered comparison: false for NaN
    less = a.builder.fcmp_ordered("<", a.wide(count), b.wide(count))
    found = len(x.tangents or y.tangents)
    pairs = zip(x.parts(count, found), y.parts(count, found), strict=True)
    return Value.of(a.builder, [a.builder.select(less, one, other) for one, other in pairs], count)


def absolute(x: Value) -> Value:
    """Return |x|. With the tangents x' of x the result's tangents are -x' where x < 0, otherwise x' (also at 0)."""
    return x.call("fabs").having([select_lt(x.alone, x.other(0.0), -slope, slope) for slope in x.tangents])


def square_root(x: Value) -> Value:
    """Return sqrt(x). With the tangents x' of x the result's tangents are x' / (2 sqrt(x)), or 0 where sqrt(x) = 0."""
    result = x.call("sqrt")
    if not x.tangents:
        return result
    zero = x.other(0.0)
    # 0 instead of infinity at x = 0
    slope = select_lt(zero, result, x.other(0.5) / result, zero)
    return result.having(_times(x.tangents, slope))


def round_even(x: Value) -> Value:
    """Return the nearest integer as a float64, ties to even, without tangents (the derivative is 0)."""
    return x.call("rint")


def largest(x: Value) -> Value:
    """Return the largest number of all lanes of x, without tangents. NaN is ignored unless all lanes are NaN."""
    x = alone(x)
    if x.count == 1:
        return x
    builder = x.builder
    first, least = builder.extract_element(x.value, ir.Constant(SLOT, 0)), ir.Constant(DOUBLE, -math.inf)
    # -inf in place of a NaN in the first lane
    result = builder.select(builder.fcmp_ordered("ord", first, first), first, least)
    for i in range(1, x.count):
        entry = builder.extract_element(x.value, ir.Constant(SLOT, i))
        result = builder.select(builder.fcmp_ordered("<", result, entry), entry, result)
    # the result stayed -inf: every lane is NaN or -inf, and the first one is returned
    none = builder.fcmp_ordered("==", result, least)
    return x.like(builder.select(none, first, result), 1)


def declared_function(module: Any, name: str, kind: Any) -> Any:
    """Declare a function of another library in a module; calls of it read its 64-bit address from memory."""
    code = ir.Function(module, kind, name)
    # the library may be more than 2 GB away from the code
    code.attributes.add("nonlazybind")
    return code


def with_slope(y: Value, x: Value, slope: Value) -> Value:
    """Return y with the tangents of x times `slope`: y is a function of x alone. The earlier tangents of y are
    ignored."""
    # a `Tape` records the slope for the reverse sweep
    if hasattr(y.builder, "sloped"):
        return y.builder.sloped(y, x, slope)
    return y.alone.having(_times(x.tangents, slope))


def alone(x: Value) -> Value:
    """Return x as a constant: without tangents in forward mode, and without cotangent in reverse mode (`Tape`)."""
    return x.builder.constant(x) if hasattr(x.builder, "constant") else x.alone


def change(x: Value) -> Value:
    """Return -0 with the tangents of x: added to a number it changes only the tangents."""
    return x.other(-0.0).having(x.tangents)


def turned(t: Value, s: Value, c: Value) -> tuple[Value, Value]:
    """Return (sine, cosine) of the angle k pi/2 + r.

    t: 1.5 * 2^52 + k, whose lowest bits hold the integer k. s: sin r. c: cos r.

    Bit 0 of k swaps sine and cosine and changes the sign of the cosine. Bit 1 of k changes both signs.
    """
    builder, count = t.builder, t.count
    kind = INDEX if count == 1 else ir.VectorType(INDEX, count)

    def constant(x: int) -> Any:
        """Return the 64-bit integer x in every lane."""
        return ir.Constant(kind, x if count == 1 else [x] * count)

    def signed(x: Any, sign: Any) -> Value:
        """Return x with its sign flipped where the sign bit of `sign`, bit 63, is set; its other bits are 0."""
        return t.like(builder.bitcast(builder.xor(builder.bitcast(x, kind), sign), vector(count)), count)

    # bits 0 and 1 of k, shifted to the sign bit
    k = builder.bitcast(t.value, kind)
    first = builder.shl(k, constant(63))
    second = builder.and_(builder.shl(k, constant(62)), constant(-(2**63)))
    # odd k: sine and cosine change places; a comparison with 0 reads the sign bit only, as blending does
    odd = builder.icmp_signed("<", first, constant(0))
    sine, cosine = builder.select(odd, c.value, s.value), builder.select(odd, s.value, c.value)
    return signed(sine, second), signed(cosine, builder.xor(first, second))
