"""One source, one arm or several: a vector of float64 that compiles to one machine register.

A kernel takes a *lane tag*, a tuple of zeros whose length L is the number of arms advanced together
(`SINGLE` or `EIGHT`). In an array that holds lanes, element k of all L arms lies at `[k*L : (k+1)*L]`.
`load(lane, array, k)` returns a float64 where L = 1 and an LLVM `<L x double>` otherwise; arithmetic
and the functions below accept both, so the same source is the kernel of a single arm and of a batch.
No operation is contracted or reordered, hence both give the same bits, on any x86 or Arm vector unit.

Only what kernels need is defined: + - * / and negation, mixed with float64; `load store splat select_lt
absolute maximum square_root round_even largest sincos`.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, overload, register_model, type_callable

from .jit import kernel

SINGLE: tuple[int, ...] = (0,)
EIGHT: tuple[int, ...] = (0,) * 8

_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(64)
_SLOT = ir.IntType(32)


class LanesType(types.Type):  # type: ignore[misc]
    """Numba type of a vector of `count` float64."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"Lanes({count})")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: LanesType) -> None:
        super().__init__(manager, fe_type, _vector(fe_type.count))


def _vector(count: int) -> ir.Type:
    return _DOUBLE if count == 1 else ir.VectorType(_DOUBLE, count)


def _width(numba_type: Any) -> int:
    return numba_type.count if isinstance(numba_type, LanesType) else 1


def _lane_type(count: int) -> Any:
    return types.float64 if count == 1 else LanesType(count)


def _broadcast(builder: Any, value: Any, count: int) -> Any:
    """A scalar repeated in every lane."""
    if count == 1:
        return value
    first = builder.insert_element(ir.Constant(_vector(count), ir.Undefined), value, ir.Constant(_SLOT, 0))
    return builder.shuffle_vector(
        first, ir.Constant(_vector(count), ir.Undefined), ir.Constant(ir.VectorType(_SLOT, count), [0] * count)
    )


def _widen(context: Any, builder: Any, value: Any, from_type: Any, count: int) -> Any:
    if isinstance(from_type, LanesType):
        return value
    return _broadcast(builder, context.cast(builder, value, from_type, types.float64), count)


# --- arithmetic ------------------------------------------------------------------------------------


def _register_arithmetic(symbol: Any, instruction: str) -> None:
    @type_callable(symbol)  # type: ignore[untyped-decorator]
    def _type(context: Any) -> Any:
        def typer(a: Any, b: Any) -> Any:
            scalars = (types.Float, types.Integer, LanesType)
            if not (isinstance(a, scalars) and isinstance(b, scalars)):
                return None
            width = max(_width(a), _width(b))
            if width == 1 or (isinstance(a, LanesType) and isinstance(b, LanesType) and a != b):
                return None
            return LanesType(width)

        return typer

    def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        count = signature.return_type.count
        a, b = (_widen(context, builder, x, t, count) for x, t in zip(args, signature.args, strict=True))
        return getattr(builder, instruction)(a, b)

    for left, right in ((LanesType, LanesType), (LanesType, types.Number), (types.Number, LanesType)):
        lower_builtin(symbol, left, right)(_lower)


for _symbols, _instruction in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    for _symbol in _symbols:
        _register_arithmetic(_symbol, _instruction)


@type_callable(operator.neg)  # type: ignore[untyped-decorator]
def _type_negative(context: Any) -> Any:
    def typer(a: Any) -> Any:
        return a if isinstance(a, LanesType) else None

    return typer


@lower_builtin(operator.neg, LanesType)  # type: ignore[untyped-decorator]
def _lower_negative(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return builder.fneg(args[0])


# --- memory ----------------------------------------------------------------------------------------


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, k: Any, count: int) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    first = builder.gep(data, [builder.mul(k, ir.Constant(_INDEX, count))], inbounds=True)
    return builder.bitcast(first, _vector(count).as_pointer())


@intrinsic  # type: ignore[untyped-decorator]
def _load_vector(typingctx: Any, lane: Any, array: Any, k: Any) -> Any:
    count = len(lane)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, signature.args[1], args[1], args[2], count), align=8)

    return _lane_type(count)(lane, array, types.intp), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _store_vector(typingctx: Any, array: Any, k: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _pointer(context, builder, signature.args[0], args[0], args[1], _width(value))
        builder.store(args[2], target, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value if isinstance(value, LanesType) else types.float64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _splat_vector(typingctx: Any, lane: Any, x: Any) -> Any:
    count = len(lane)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _broadcast(builder, args[1], count)

    return LanesType(count)(lane, types.float64), codegen


def load(lane: tuple[int, ...], array: np.ndarray, k: int) -> float:
    """Element k of every lane of a contiguous array."""
    return array[k]


def store(array: np.ndarray, k: int, value: float) -> None:
    """Write element k of every lane."""
    array[k] = value


def splat(lane: tuple[int, ...], x: float) -> float:
    """The scalar x in every lane."""
    return x


@overload(load)  # type: ignore[untyped-decorator]
def _load(lane, array, k):  # type: ignore[no-untyped-def]
    return lambda lane, array, k: _load_vector(lane, array, k)


@overload(store)  # type: ignore[untyped-decorator]
def _store(array, k, value):  # type: ignore[no-untyped-def]
    # An intrinsic for a scalar too: Numba's dead-code pass drops `array[k] = value` where it takes the array for its own.
    return lambda array, k, value: _store_vector(array, k, value)


@overload(splat)  # type: ignore[untyped-decorator]
def _splat(lane, x):  # type: ignore[no-untyped-def]
    if len(lane) == 1:
        return lambda lane, x: float(x)
    return lambda lane, x: _splat_vector(lane, float(x))


# --- functions -------------------------------------------------------------------------------------


def _common_width(*kinds: Any) -> int:
    return max(_width(k) for k in kinds)


@intrinsic  # type: ignore[untyped-decorator]
def _select_lt(typingctx: Any, a: Any, b: Any, x: Any, y: Any) -> Any:
    count = _common_width(a, b, x, y)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a_, b_, x_, y_ = (
            _widen(context, builder, v, t, count) for v, t in zip(args, signature.args, strict=True)
        )
        return builder.select(builder.fcmp_ordered("<", a_, b_), x_, y_)

    arguments = [k if isinstance(k, LanesType) else types.float64 for k in (a, b, x, y)]
    return _lane_type(count)(*arguments), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _largest(typingctx: Any, x: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        result = builder.extract_element(args[0], ir.Constant(_SLOT, 0))
        for i in range(1, x.count):
            entry = builder.extract_element(args[0], ir.Constant(_SLOT, i))
            result = builder.select(builder.fcmp_ordered("<", result, entry), entry, result)
        return result

    return types.float64(x), codegen


def _unary(name: str) -> Any:
    @intrinsic  # type: ignore[untyped-decorator]
    def function(typingctx: Any, x: Any) -> Any:
        count = _width(x)
        suffix = "f64" if count == 1 else f"v{count}f64"

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.FunctionType(_vector(count), [_vector(count)])
            return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.{suffix}"), args)

        return _lane_type(count)(x if isinstance(x, LanesType) else types.float64), codegen

    return function


_fabs, _sqrt, _rint = _unary("llvm.fabs"), _unary("llvm.sqrt"), _unary("llvm.rint")


def select_lt(a: float, b: float, x: float, y: float) -> float:
    """x where a < b, otherwise y (also where a or b is NaN)."""
    return x if a < b else y


def absolute(x: float) -> float:
    """|x|"""
    return abs(x)


def square_root(x: float) -> float:
    """The square root of x."""
    return math.sqrt(x)


def round_even(x: float) -> float:
    """The nearest whole number, ties to even."""
    return float(np.rint(x))


def largest(x: float) -> float:
    """The largest entry of all lanes, as a float64 (NaN entries are passed over)."""
    return x


@overload(select_lt)  # type: ignore[untyped-decorator]
def _ov_select_lt(a, b, x, y):  # type: ignore[no-untyped-def]
    return lambda a, b, x, y: _select_lt(a, b, x, y)


@overload(absolute)  # type: ignore[untyped-decorator]
def _ov_absolute(x):  # type: ignore[no-untyped-def]
    return lambda x: _fabs(x)


@overload(square_root)  # type: ignore[untyped-decorator]
def _ov_square_root(x):  # type: ignore[no-untyped-def]
    return lambda x: _sqrt(x)


@overload(round_even)  # type: ignore[untyped-decorator]
def _ov_round_even(x):  # type: ignore[no-untyped-def]
    return lambda x: _rint(x)


@overload(largest)  # type: ignore[untyped-decorator]
def _ov_largest(x):  # type: ignore[no-untyped-def]
    if isinstance(x, LanesType):
        return lambda x: _largest(x)
    return lambda x: x


@kernel
def maximum(x, y):  # type: ignore[no-untyped-def]
    """The larger of x and y; y where x is NaN."""
    return select_lt(y, x, x, y)


# pi/2 in three parts of 33 bits: k * part is exact for |k| < 2^20, so the reduction keeps full precision.
_HALF_PI_1 = 1.57079632673412561417e00
_HALF_PI_2 = 6.07710050630396597660e-11
_HALF_PI_3 = 2.02226624879595063154e-21
_S = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 8))  # sin r - r, to r^15: 7e-17 relative
_C = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(1, 9))  # cos r - 1, to r^16: 2e-18


@kernel
def sincos(x):  # type: ignore[no-untyped-def]
    """(sin x, cos x) by Taylor polynomials on |r| <= pi/4: within 2e-16 for |x| < 1e6, the same bits in any lane."""
    k = round_even(x * (2.0 / math.pi))
    r = ((x - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
    z = r * r
    s = z * _S[6] + _S[5]
    s = s * z + _S[4]
    s = s * z + _S[3]
    s = s * z + _S[2]
    s = s * z + _S[1]
    s = s * z + _S[0]
    s = r + r * (z * s)
    c = z * _C[7] + _C[6]
    c = c * z + _C[5]
    c = c * z + _C[4]
    c = c * z + _C[3]
    c = c * z + _C[2]
    c = c * z + _C[1]
    c = c * z + _C[0]
    c = 1.0 + z * c
    m = k - 4.0 * round_even(k * 0.25)  # quadrant: -2, -1, 0, 1 or 2
    odd = absolute(absolute(m) - 1.0)
    sine = select_lt(odd, 0.5, c, s)
    cosine = select_lt(odd, 0.5, s, c)
    sine = select_lt(m, -0.5, -sine, select_lt(1.5, m, -sine, sine))
    cosine = select_lt(m, -1.5, -cosine, select_lt(0.5, m, -cosine, cosine))
    return sine, cosine
