"""One source, one arm or several: a vector of float64 that compiles to one machine register.

A kernel takes a *lane tag*, a tuple of zeros whose length L is the number of arms advanced together
(`SINGLE` or `EIGHT`). In an array that holds lanes, element k of all L arms lies at `[k*L : (k+1)*L]`.
`load(lane, array, k)` returns a float64 where L = 1 and an LLVM `<L x double>` otherwise; arithmetic
and the functions below accept both, so the same source is the kernel of a single arm and of a batch.
No operation is contracted or reordered, hence both give the same bits, on any x86 or Arm vector unit.

A longer tag, `dual(lane, D)`, makes of the same source the kernel of its derivative: each element is followed by D
tangents, L numbers each that say how it changes along a direction, and every operation carries them on by the rules in
`symbols`. `arms(lane)` is the number of arms of either.

Only what kernels need is defined: + - * / and negation, mixed with float64; `load store splat pick place select_lt
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

from . import symbols
from .arrays import pointer
from .decorator import kernel
from .symbols import INDEX, Value, bundle, vector

SINGLE: tuple[int, ...] = (0,)
EIGHT: tuple[int, ...] = (0,) * 8
WIDEST = SINGLE if config.DISABLE_JIT else EIGHT
"""What many arms stand in. Where compilation is disabled there are no vectors: every arm is advanced by itself."""


def dual(lane: tuple[int, ...], tangents: int = 1) -> tuple[int, ...]:
    """The tag of as many arms with so many tangents each (of one arm: at most 6)."""
    return lane * (1 + tangents)


class LanesType(types.Type):  # type: ignore[misc]
    """Numba type of a vector of `count` float64, with so many tangents."""

    def __init__(self, count: int, tangents: int = 0) -> None:
        self.count, self.tangents = count, tangents
        super().__init__(name=f"Lanes({count}, {tangents})" if tangents else f"Lanes({count})")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: LanesType) -> None:
        super().__init__(manager, fe_type, bundle(fe_type.count, fe_type.tangents))


def lane_type(length: int) -> Any:
    """The type of what lanes under a tag of this length hold."""
    count = 1 if length % len(EIGHT) else len(EIGHT)
    return types.float64 if length == 1 else LanesType(count, length // count - 1)


def _widest(*kinds: Any) -> Any:
    """The type of what comes of numbers of these types."""
    wide = [kind for kind in kinds if isinstance(kind, LanesType)]
    return max(wide, key=lambda kind: kind.tangents) if wide else types.float64


def shape(kind: Any) -> tuple[int, int]:
    """How many lanes and tangents a type has."""
    return (kind.count, kind.tangents) if isinstance(kind, LanesType) else (1, 0)


def symbol(context: Any, builder: Any, kind: Any, value: Any) -> Value:
    """What stands for a number of a Numba type."""
    if not isinstance(kind, LanesType):
        return Value(builder, context.cast(builder, value, kind, types.float64), 1)
    if kind.tangents == 0:
        return Value(builder, value, kind.count)
    first, *rest = [Value(builder, builder.extract_value(value, k), kind.count) for k in range(1 + kind.tangents)]
    return first.having(rest)


def number(kind: Any, x: Value) -> Any:
    """The number of a Numba type that a symbol stands for."""
    count, tangents = shape(kind)
    if tangents == 0:
        return x.wide(count)
    result = ir.Constant(bundle(count, tangents), ir.Undefined)
    for k, part in enumerate(x.parts(count, tangents)):
        result = x.builder.insert_value(result, part, k)
    return result


def _lowered(operation: Any) -> Any:
    """Code generation of an operation on symbols."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        items = [symbol(context, builder, k, x) for k, x in zip(signature.args, args, strict=True)]
        return number(signature.return_type, operation(*items))

    return codegen


# --- arithmetic ------------------------------------------------------------------------------------


def _register_arithmetic(function: Any, operation: Any) -> None:
    @type_callable(function)
    def _type(context: Any) -> Any:
        def typer(a: Any, b: Any) -> Any:
            scalars = (types.Float, types.Integer, LanesType)
            if not (isinstance(a, scalars) and isinstance(b, scalars)):
                return None
            if isinstance(a, LanesType) and isinstance(b, LanesType) and a != b:
                return None
            return _widest(a, b) if isinstance(_widest(a, b), LanesType) else None

        return typer

    for left, right in ((LanesType, LanesType), (LanesType, types.Number), (types.Number, LanesType)):
        lower_builtin(function, left, right)(_lowered(operation))


for _function, _in_place in (
    (operator.add, operator.iadd),
    (operator.sub, operator.isub),
    (operator.mul, operator.imul),
    (operator.truediv, operator.itruediv),
):
    for _symbol in (_function, _in_place):
        _register_arithmetic(_symbol, _function)


@type_callable(operator.neg)
def _type_negative(context: Any) -> Any:
    def typer(a: Any) -> Any:
        return a if isinstance(a, LanesType) else None

    return typer


lower_builtin(operator.neg, LanesType)(_lowered(operator.neg))


# --- memory ----------------------------------------------------------------------------------------


def _places(context: Any, builder: Any, array_type: Any, array: Any, k: Any, kind: Any) -> list[Any]:
    """Where element k and its tangents lie."""
    data, (count, tangents) = pointer(context, builder, array_type, array), shape(kind)
    first = builder.gep(data, [builder.mul(k, ir.Constant(INDEX, count * (1 + tangents)))], inbounds=True)
    rest = [builder.gep(first, [ir.Constant(INDEX, count * (1 + i))], inbounds=True) for i in range(tangents)]
    return [builder.bitcast(place, vector(count).as_pointer()) for place in (first, *rest)]


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
    kind = lane_type(len(lane))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places = _places(context, builder, signature.args[1], args[1], args[2], kind)
        first, *rest = [Value(builder, builder.load(place, align=8), shape(kind)[0]) for place in places]
        return number(kind, first.having(rest))

    return kind(lane, array, types.intp), codegen


@intrinsic
def _store(typingctx: Any, array: Any, k: Any, value: Any) -> Any:
    kind = _widest(value)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x = symbol(context, builder, kind, args[2])
        places = _places(context, builder, signature.args[0], args[0], args[1], kind)
        for place, part in zip(places, x.parts(*shape(kind)), strict=True):
            builder.store(part, place, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, kind), codegen


@intrinsic
def _splat(typingctx: Any, lane: Any, x: Any) -> Any:
    kind = lane_type(len(lane))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return number(kind, Value(builder, args[1], 1))

    return kind(lane, types.float64), codegen


def _py_pick(lane: tuple[int, ...], array: np.ndarray, k: int, i: int) -> float:
    """Element k of arm i, as one number with its tangents."""
    _one(lane)
    return array[k]


def _py_place(lane: tuple[int, ...], array: np.ndarray, k: int, i: int, value: float) -> None:
    """Write element k of arm i."""
    array[k] = value


def _own_places(context: Any, builder: Any, kinds: Any, args: Any) -> tuple[list[Any], Any]:
    """Where element k of arm i and its tangents lie, from (lane, array, k, i, ...); the type of one such number."""
    count, tangents = shape(lane_type(len(kinds[0])))
    data, rows = pointer(context, builder, kinds[1], args[1]), 1 + tangents
    first = builder.add(builder.mul(args[2], ir.Constant(INDEX, count * rows)), args[3])
    steps = [builder.add(first, ir.Constant(INDEX, count * j)) for j in range(rows)]
    return [builder.gep(data, [step], inbounds=True) for step in steps], _own(tangents)


def _own(tangents: int) -> Any:
    return LanesType(1, tangents) if tangents else types.float64


@intrinsic
def _pick(typingctx: Any, lane: Any, array: Any, k: Any, i: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places, kind = _own_places(context, builder, signature.args, args)
        first, *rest = [Value(builder, builder.load(place), 1) for place in places]
        return number(kind, first.having(rest))

    return _own(shape(lane_type(len(lane)))[1])(lane, array, types.intp, types.intp), codegen


@intrinsic
def _place(typingctx: Any, lane: Any, array: Any, k: Any, i: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        places, kind = _own_places(context, builder, signature.args, args)
        x = symbol(context, builder, signature.args[4], args[4])
        for where, part in zip(places, x.parts(*shape(kind)), strict=True):
            builder.store(part, where)
        return context.get_dummy_value()

    return types.void(lane, array, types.intp, types.intp, _widest(value)), codegen


load, store, splat = _either(_py_load, _load), _either(_py_store, _store), _either(_py_splat, _splat)
pick, place = _either(_py_pick, _pick), _either(_py_place, _place)


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


def _py_arms(lane: tuple[int, ...]) -> int:
    """How many arms stand under a tag."""
    _one(lane)
    return 1


def _py_alone(x: float) -> float:
    """x without tangents."""
    return x


def _py_with_slope(y: float, x: float, slope: float) -> float:
    """y as a function of x, without tangents; its derivative is `slope`."""
    return y


def _py_change(x: float) -> float:
    """-0 with the tangents of x, which added to a number changes its tangents alone."""
    return -0.0


def _operation(operation: Any, *places: int, result: Any = None) -> Any:
    """The intrinsic of an operation on symbols; result: its type from the widest of the arguments (which, or all)."""

    def typed(kinds: tuple[Any, ...]) -> Any:
        widest = _widest(*(kinds[k] for k in places) if places else kinds)
        arguments = [kind if isinstance(kind, LanesType) else types.float64 for kind in kinds]
        return (widest if result is None else result(widest))(*arguments), _lowered(operation)

    return {
        1: intrinsic(lambda typingctx, a: typed((a,))),
        3: intrinsic(lambda typingctx, a, b, c: typed((a, b, c))),
        4: intrinsic(lambda typingctx, a, b, c, d: typed((a, b, c, d))),
    }[operation.__code__.co_argcount]


def _plain(kind: Any) -> Any:
    """A type without tangents."""
    count, _ = shape(kind)
    return types.float64 if count == 1 else LanesType(count)


@intrinsic
def _arms(typingctx: Any, lane: Any) -> Any:
    count, _ = shape(lane_type(len(lane)))
    return types.intp(lane), lambda context, builder, signature, args: ir.Constant(INDEX, count)


arms = _either(_py_arms, _arms)
select_lt = _either(_py_select_lt, _operation(symbols.select_lt))
largest = _either(_py_largest, _operation(symbols.largest, result=lambda kind: types.float64))
absolute = _either(_py_absolute, _operation(symbols.absolute))
square_root = _either(_py_square_root, _operation(symbols.square_root))
round_even = _either(_py_round_even, _operation(symbols.round_even))
alone = _either(_py_alone, _operation(lambda x: x.alone, result=_plain))
change = _either(_py_change, _operation(symbols.change))
with_slope = _either(_py_with_slope, _operation(symbols.with_slope, 1))


@kernel
def maximum(x, y):
    """The larger of x and y; y where x is NaN."""
    return select_lt(y, x, x, y)


_WHOLE = 6755399441055744.0
"""1.5 * 2^52: a number of moderate size added to it is rounded to a whole one, which stands in its lowest bits."""


@intrinsic
def _turn(typingctx: Any, t: Any, s: Any, c: Any) -> Any:
    kind = _widest(t, s, c)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pairs = zip(signature.args, args, strict=True)
        both = symbols.turned(*(symbol(context, builder, k, x) for k, x in pairs))
        return context.make_tuple(builder, signature.return_type, [x.value for x in both])

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
    angle = alone(x)
    t = angle * (2.0 / math.pi) + _WHOLE
    k = t - _WHOLE
    r = ((angle - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
    z = r * r
    y = z * z
    s = ((z * _S[5] + _S[4]) * y + (z * _S[3] + _S[2])) * y + (z * _S[1] + _S[0])
    s = r + r * (z * s)
    c = ((z * _C[5] + _C[4]) * y + (z * _C[3] + _C[2])) * y + (z * _C[1] + _C[0])
    c = (1.0 - z * 0.5) + y * c
    s, c = turn(t, s, c)
    return with_slope(s, x, c), with_slope(c, x, -s)
