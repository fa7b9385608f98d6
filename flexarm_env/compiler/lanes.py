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
from numba import config, types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from .arrays import pointer
from .decorator import kernel

SINGLE: tuple[int, ...] = (0,)
EIGHT: tuple[int, ...] = (0,) * 8
WIDEST = SINGLE if config.DISABLE_JIT else EIGHT
"""What many arms stand in. Where compilation is disabled there are no vectors: every arm is advanced by itself."""

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


def lane_type(count: int) -> Any:
    """The type of what `count` lanes hold."""
    return types.float64 if count == 1 else LanesType(count)


def broadcast(builder: Any, value: Any, count: int) -> Any:
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
    return broadcast(builder, context.cast(builder, value, from_type, types.float64), count)


# --- arithmetic ------------------------------------------------------------------------------------


def _register_arithmetic(symbol: Any, instruction: str) -> None:
    @type_callable(symbol)
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


@type_callable(operator.neg)
def _type_negative(context: Any) -> Any:
    def typer(a: Any) -> Any:
        return a if isinstance(a, LanesType) else None

    return typer


@lower_builtin(operator.neg, LanesType)
def _lower_negative(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    return builder.fneg(args[0])


# --- memory ----------------------------------------------------------------------------------------


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, k: Any, count: int) -> Any:
    data = pointer(context, builder, array_type, array)
    first = builder.gep(data, [builder.mul(k, ir.Constant(_INDEX, count))], inbounds=True)
    return builder.bitcast(first, _vector(count).as_pointer())


def _either(python: Any, compiled: Any) -> Any:
    """What kernels call: the intrinsic, or its Python twin where compilation is disabled.

    Intrinsics themselves, not overloads that call them: an overload is a library of its own to compile, and Numba's
    dead-code pass drops a plain `array[k] = value` behind one where it takes the array for its own.
    """
    compiled.__doc__ = python.__doc__
    return python if config.DISABLE_JIT else compiled


def _one(lane: tuple[int, ...]) -> None:
    """Numbers of Python stand for one lane: RuntimeError for more."""
    if len(lane) != 1:
        raise RuntimeError(f"{len(lane)} lanes: there is only one where compilation is disabled (NUMBA_DISABLE_JIT)")


def _py_load(lane: tuple[int, ...], array: np.ndarray, k: int) -> float:
    """Element k of every lane of a contiguous array."""
    _one(lane)
    return array[k]


def _py_store(array: np.ndarray, k: int, value: float) -> None:
    """Write element k of every lane."""
    array[k] = value


def _py_splat(lane: tuple[int, ...], x: float) -> float:
    """The scalar x in every lane."""
    _one(lane)
    return x


@intrinsic
def _load(typingctx: Any, lane: Any, array: Any, k: Any) -> Any:
    count = len(lane)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, signature.args[1], args[1], args[2], count), align=8)

    return lane_type(count)(lane, array, types.intp), codegen


@intrinsic
def _store(typingctx: Any, array: Any, k: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _pointer(context, builder, signature.args[0], args[0], args[1], _width(value))
        builder.store(args[2], target, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value if isinstance(value, LanesType) else types.float64), codegen


@intrinsic
def _splat(typingctx: Any, lane: Any, x: Any) -> Any:
    count = len(lane)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return broadcast(builder, args[1], count)

    return lane_type(count)(lane, types.float64), codegen


load, store, splat = _either(_py_load, _load), _either(_py_store, _store), _either(_py_splat, _splat)


# --- functions -------------------------------------------------------------------------------------


def _py_select_lt(a: float, b: float, x: float, y: float) -> float:
    """x where a < b, otherwise y (also where a or b is NaN)."""
    return x if a < b else y


def _py_absolute(x: float) -> float:
    """|x|"""
    return abs(x)


def _py_square_root(x: float) -> float:
    """The square root of x."""
    return math.sqrt(x)


def _py_round_even(x: float) -> float:
    """The nearest whole number, ties to even."""
    return float(np.rint(x))


def _py_largest(x: float) -> float:
    """The largest entry of all lanes, as a float64 (NaN entries are passed over)."""
    return x


@intrinsic
def _select_lt(typingctx: Any, a: Any, b: Any, x: Any, y: Any) -> Any:
    count = max(_width(kind) for kind in (a, b, x, y))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a_, b_, x_, y_ = (_widen(context, builder, v, t, count) for v, t in zip(args, signature.args, strict=True))
        return builder.select(builder.fcmp_ordered("<", a_, b_), x_, y_)

    arguments = [kind if isinstance(kind, LanesType) else types.float64 for kind in (a, b, x, y)]
    return lane_type(count)(*arguments), codegen


@intrinsic
def _largest(typingctx: Any, x: Any) -> Any:
    count = _width(x)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if count == 1:
            return args[0]
        result = builder.extract_element(args[0], ir.Constant(_SLOT, 0))
        for i in range(1, count):
            entry = builder.extract_element(args[0], ir.Constant(_SLOT, i))
            result = builder.select(builder.fcmp_ordered("<", result, entry), entry, result)
        return result

    return types.float64(lane_type(count)), codegen


def _unary(name: str) -> Any:
    @intrinsic
    def function(typingctx: Any, x: Any) -> Any:
        count = _width(x)
        suffix = "f64" if count == 1 else f"v{count}f64"

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.FunctionType(_vector(count), [_vector(count)])
            return builder.call(builder.module.declare_intrinsic(f"{name}.{suffix}", (), kind), args)

        return lane_type(count)(lane_type(count)), codegen

    return function


select_lt, largest = _either(_py_select_lt, _select_lt), _either(_py_largest, _largest)
absolute = _either(_py_absolute, _unary("llvm.fabs"))
square_root = _either(_py_square_root, _unary("llvm.sqrt"))
round_even = _either(_py_round_even, _unary("llvm.rint"))


@kernel
def maximum(x, y):
    """The larger of x and y; y where x is NaN."""
    return select_lt(y, x, x, y)


_WHOLE = 6755399441055744.0
"""1.5 * 2^52: a number of moderate size added to it is rounded to a whole one, which stands in its lowest bits."""


def turned(builder: Any, t: Any, s: Any, c: Any, count: int) -> tuple[Any, Any]:
    """Instructions of `turn`."""
    kind = _INDEX if count == 1 else ir.VectorType(_INDEX, count)

    def constant(x: int) -> Any:
        return ir.Constant(kind, x if count == 1 else [x] * count)

    def signed(x: Any, bit: Any) -> Any:
        sign = builder.and_(builder.shl(bit, constant(62)), constant(-(2**63)))
        return builder.bitcast(builder.xor(builder.bitcast(x, kind), sign), _vector(count))

    k = builder.bitcast(t, kind)
    odd = builder.icmp_unsigned("!=", builder.and_(k, constant(1)), constant(0))
    sine, cosine = builder.select(odd, c, s), builder.select(odd, s, c)
    return signed(sine, k), signed(cosine, builder.add(k, constant(1)))


@intrinsic
def _turn(typingctx: Any, t: Any, s: Any, c: Any) -> Any:
    kind = lane_type(max(_width(x) for x in (t, s, c)))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        t, s, c = args
        return context.make_tuple(builder, signature.return_type, turned(builder, t, s, c, _width(kind)))

    return types.UniTuple(kind, 2)(kind, kind, kind), codegen


def _py_turn(t: float, s: float, c: float) -> tuple[float, float]:
    """(sine, cosine) of an angle whose remainder from k right angles has sine s and cosine c; t = _WHOLE + k."""
    return ((s, c), (c, -s), (-s, -c), (-c, s))[int(t - _WHOLE) % 4 if math.isfinite(t) else 0]


turn = _either(_py_turn, _turn)

# pi/2 in three parts of 33 bits: k * part is exact for |k| < 2^20, so the reduction keeps full precision.
_HALF_PI_1 = 1.57079632673412561417e00
_HALF_PI_2 = 6.07710050630396597660e-11
_HALF_PI_3 = 2.02226624879595063154e-21
# Best polynomials on |r| <= pi/4 (S. Moshier's Cephes): sin r = r + r z S(z), cos r = 1 - z / 2 + z^2 C(z), z = r^2.
_S = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
_C = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)


@kernel
def sincos(x):
    """(sin x, cos x) within 2e-16 for |x| < 1e6, the same bits in any lane."""
    t = x * (2.0 / math.pi) + _WHOLE
    k = t - _WHOLE
    r = ((x - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
    z = r * r
    y = z * z
    s = ((z * _S[5] + _S[4]) * y + (z * _S[3] + _S[2])) * y + (z * _S[1] + _S[0])
    s = r + r * (z * s)
    c = ((z * _C[5] + _C[4]) * y + (z * _C[3] + _C[2])) * y + (z * _C[1] + _C[0])
    c = (1.0 - z * 0.5) + y * c
    return turn(t, s, c)
