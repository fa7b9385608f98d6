"""Arithmetic of kernels on what is known at compile time and what is not; its meaning is Python's.

Whole numbers have 64 bits and wrap around. Floor division and remainder take the sign of the divisor; by zero both are
0 (Python raises), and a float's is NaN. A shift by 64 or more leaves 0. Numbers that are known are reckoned by Python.
"""

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir

from . import symbols
from .kinds import BIT, NUMBERS, WORD, Integer, Narrow, Refused, Truth, is_static, is_tuple, told
from .symbols import DOUBLE, Value

KNOWN = {
    "Add": operator.add, "Sub": operator.sub, "Mult": operator.mul, "Div": operator.truediv,
    "FloorDiv": operator.floordiv, "Mod": operator.mod, "Pow": operator.pow, "LShift": operator.lshift,
    "RShift": operator.rshift, "BitAnd": operator.and_, "BitOr": operator.or_, "BitXor": operator.xor,
}  # fmt: skip
COMPARED = {
    "Lt": ("<", operator.lt), "Gt": (">", operator.gt), "LtE": ("<=", operator.le), "GtE": (">=", operator.ge),
    "Eq": ("==", operator.eq), "NotEq": ("!=", operator.ne),
}  # fmt: skip
_PLAIN = {"Add": "add", "Sub": "sub", "Mult": "mul", "BitAnd": "and_", "BitOr": "or_", "BitXor": "xor"}


def known(x: Any) -> bool:
    """Whether x is a number of Python's."""
    return isinstance(x, int | float | np.int64 | np.uint64 | np.bool_)


def whole_kind(x: Any) -> bool:
    """Whether x is a whole number or a truth value, known or not."""
    if isinstance(x, Narrow):
        return x.letter == "b"
    return isinstance(x, Integer | Truth) or (known(x) and not isinstance(x, float | np.floating))


def number(b: Any, x: Any) -> Value:
    """x as float64 or lanes."""
    if isinstance(x, Value):
        return x
    if isinstance(x, Integer):
        return Value(b, (b.uitofp if x.unsigned else b.sitofp)(x.value, DOUBLE), 1)
    if isinstance(x, Truth):
        return Value(b, b.uitofp(x.value, DOUBLE), 1)
    if isinstance(x, Narrow):
        return Value(b, b.fpext(x.value, DOUBLE) if x.letter == "g" else b.uitofp(x.value, DOUBLE), 1)
    if known(x):
        return Value(b, ir.Constant(DOUBLE, float(x)), 1)
    raise Refused(f"{told(x)} where a number is wanted")


def whole(b: Any, x: Any, unsigned: bool = False) -> Any:
    """x, a whole number, as an LLVM value of 64 bits."""
    if isinstance(x, Integer):
        return x.value
    if isinstance(x, Truth) or (isinstance(x, Narrow) and x.letter == "b"):
        return b.zext(x.value, WORD)
    if known(x) and whole_kind(x):
        if not -(2**63) <= int(x) < 2 ** (64 if unsigned or isinstance(x, np.uint64) else 63):
            raise Refused(f"{x}: a whole number has 64 bits")
        return ir.Constant(WORD, int(x))
    raise Refused(f"{told(x)} where a whole number is wanted (int(x) makes one)")


def truth(b: Any, x: Any) -> Any:
    """Whether x is true: a bool where that is known, otherwise an LLVM bit."""
    if isinstance(x, Truth):
        return x.value
    if isinstance(x, Integer | Narrow) and whole_kind(x):
        return b.icmp_signed("!=", x.value, ir.Constant(x.value.type, 0))
    if isinstance(x, Value):
        if x.count > 1:
            raise Refused("lanes where a truth value is wanted: `select_lt` chooses lane by lane")
        return b.fcmp_unordered("!=", x.value, ir.Constant(DOUBLE, 0.0))
    if x is None or known(x) or isinstance(x, str) or is_tuple(x):
        return bool(x)
    raise Refused(f"{told(x)} where a truth value is wanted")


def binary(b: Any, op: str, x: Any, y: Any) -> Any:
    """x op y."""
    if known(x) and known(y):
        if op in ("FloorDiv", "Mod", "Div") and y == 0:
            raise Refused("a division by zero that is known beforehand")
        try:
            return KNOWN[op](x, y)
        except (ArithmeticError, TypeError, ValueError) as error:
            raise Refused(f"{x} and {y}: {error}") from None
    if is_tuple(x) or is_tuple(y):
        return _of_tuples(op, x, y)
    if whole_kind(x) and whole_kind(y) and op not in ("Div", "Pow"):
        return _wholes(b, op, x, y)
    if op == "Pow":
        return _power(b, x, y)
    p, q = number(b, x), number(b, y)
    if op in ("Add", "Sub", "Mult", "Div"):
        return KNOWN[op](p, q)
    if op in ("FloorDiv", "Mod"):
        if p.count > 1 or q.count > 1 or p.tangents or q.tangents:
            raise Refused(f"{told(p)} and {told(q)}: floor division and remainder take plain numbers")
        return _floored(b, op, p, q)
    raise Refused(f"{told(x)} and {told(y)}: bits of whole numbers alone")


def _of_tuples(op: str, x: Any, y: Any) -> Any:
    if op == "Add" and is_tuple(x) and is_tuple(y):
        return x + y
    if op == "Mult" and isinstance(x if is_tuple(y) else y, int):
        return KNOWN[op](x, y)
    raise Refused(f"{told(x)} and {told(y)}: tuples are added, or multiplied by a number that is known")


def _unsigned(x: Any, y: Any) -> bool:
    kinds = {item.unsigned for item in (x, y) if isinstance(item, Integer)}
    kinds |= {True for item in (x, y) if isinstance(item, np.uint64)}
    if len(kinds) == 2 or (True in kinds and any(known(item) and item < 0 for item in (x, y))):
        raise Refused("a signed and an unsigned whole number: np.uint64(x) makes both unsigned")
    return True in kinds


def _wholes(b: Any, op: str, x: Any, y: Any) -> Any:
    unsigned = _unsigned(x, y)
    p, q = whole(b, x, unsigned), whole(b, y, unsigned)
    if isinstance(x, Truth) and isinstance(y, Truth):
        if not op.startswith("Bit"):  # NumPy's are no numbers, Python's are
            raise Refused("arithmetic of two truth values: int(x) makes a number of one")
        return Truth(getattr(b, _PLAIN[op])(x.value, y.value))
    if op in _PLAIN:
        return Integer(getattr(b, _PLAIN[op])(p, q), unsigned)
    if op in ("LShift", "RShift"):
        if known(y) and y < 0:
            raise Refused(f"a shift by {y}")
        return Integer(_shifted(b, op, p, q, unsigned), unsigned)
    if known(y) and y == 0:
        raise Refused("a division by zero that is known beforehand")
    return Integer(_divided(b, op, p, q, unsigned), unsigned)


def _shifted(b: Any, op: str, p: Any, q: Any, unsigned: bool) -> Any:
    """A shift; LLVM's are for less than 64 places. What follows from a number that is known is left to LLVM."""
    few, zero = b.icmp_unsigned("<", q, ir.Constant(WORD, 64)), ir.Constant(WORD, 0)
    if op == "RShift" and not unsigned:
        return b.ashr(p, b.select(few, q, ir.Constant(WORD, 63)))
    return b.select(few, (b.shl if op == "LShift" else b.lshr)(p, b.select(few, q, zero)), zero)


def _divided(b: Any, op: str, p: Any, q: Any, unsigned: bool) -> Any:
    """Floor division or remainder; dividing by 0, or the least number by -1, is no instruction's."""
    zero, one = ir.Constant(WORD, 0), ir.Constant(WORD, 1)
    none, minus = b.icmp_signed("==", q, zero), b.icmp_signed("==", q, ir.Constant(WORD, -1))
    if unsigned:
        return b.select(none, zero, (b.udiv if op == "FloorDiv" else b.urem)(p, b.select(none, one, q)))
    by = b.select(b.or_(none, minus), one, q)
    rest = b.srem(p, by)
    under = b.and_(b.icmp_signed("!=", rest, zero), b.icmp_signed("<", b.xor(rest, by), zero))
    if op == "FloorDiv":
        result = b.select(minus, b.neg(p), b.sub(b.sdiv(p, by), b.zext(under, WORD)))
    else:
        result = b.select(minus, zero, b.add(rest, b.select(under, by, zero)))
    return b.select(none, zero, result)


def _floored(b: Any, op: str, p: Value, q: Value) -> Value:
    """Python's `//` and `%` of floats, operation by operation."""
    zero = ir.Constant(DOUBLE, 0.0)
    rest = b.frem(p.value, q.value)
    some = b.fcmp_unordered("!=", rest, zero)
    apart = b.and_(some, b.xor(b.fcmp_ordered("<", q.value, zero), b.fcmp_ordered("<", rest, zero)))
    moved = b.select(apart, b.fadd(rest, q.value), rest)
    if op == "Mod":
        return p.like(b.select(some, moved, _signed(b, zero, q.value)), 1)
    ratio = b.fdiv(b.fsub(p.value, rest), q.value)
    ratio = b.select(apart, b.fsub(ratio, ir.Constant(DOUBLE, 1.0)), ratio)
    down = p.like(ratio, 1).call("floor").value
    up = b.fcmp_ordered(">", b.fsub(ratio, down), ir.Constant(DOUBLE, 0.5))
    down = b.select(up, b.fadd(down, ir.Constant(DOUBLE, 1.0)), down)
    nothing = b.fcmp_ordered("==", ratio, zero)
    found = b.select(nothing, _signed(b, zero, b.fdiv(p.value, q.value)), down)
    return p.like(b.select(b.fcmp_ordered("==", q.value, zero), ir.Constant(DOUBLE, math.nan), found), 1)


def _signed(b: Any, x: Any, sign: Any) -> Any:
    function = b.module.declare_intrinsic("llvm.copysign", [DOUBLE], ir.FunctionType(DOUBLE, [DOUBLE, DOUBLE]))
    return b.call(function, [x, sign])


def _power(b: Any, x: Any, y: Any) -> Any:
    if whole_kind(x) and whole_kind(y):
        if known(x) and x == 2:
            return _wholes(b, "LShift", 1, y)
        raise Refused("a power of a whole number: of 2, or of a float")
    p, q = number(b, x), number(b, y)
    if p.count > 1 or q.count > 1 or p.tangents or q.tangents:
        raise Refused(f"{told(p)}: powers are of plain numbers")
    return Value(b, b.call(external(b, "pow", 2), [p.value, q.value]), 1)


def external(b: Any, name: str, count: int) -> Any:
    """A function of C's mathematics."""
    found = b.module.globals.get(name)
    return found or ir.Function(b.module, ir.FunctionType(DOUBLE, [DOUBLE] * count), name)


def negative(b: Any, x: Any) -> Any:
    """-x"""
    if known(x) or isinstance(x, Value):
        return -x
    if isinstance(x, Truth):
        raise Refused("minus a truth value: int(x) makes a number of it")
    if whole_kind(x):
        return Integer(b.neg(whole(b, x)), isinstance(x, Integer) and x.unsigned)
    return -number(b, x)


def compare(b: Any, op: str, x: Any, y: Any) -> Any:
    """x op y, a bool where that is known."""
    sign, reckoned = COMPARED[op]
    if (known(x) and known(y)) or (is_static(x) and is_static(y) and type(x) is type(y) and isinstance(x, str | tuple)):
        try:
            return bool(reckoned(x, y))
        except TypeError as error:
            raise Refused(f"{told(x)} and {told(y)}: {error}") from None
    said = "lanes are not compared: `select_lt` chooses lane by lane, `largest` is a number"
    return Truth(_test(b, sign, x, y, said)[0])


def _test(b: Any, sign: str, x: Any, y: Any, said: str) -> tuple[Any, Any, Any]:
    """x sign y as an LLVM bit, and both as items of one kind. Refused, as `said`: lanes."""
    if whole_kind(x) and whole_kind(y):
        unsigned = _unsigned(x, y)
        m, n = (Integer(whole(b, item, unsigned), unsigned) for item in (x, y))
        return (b.icmp_unsigned if unsigned else b.icmp_signed)(sign, m.value, n.value), m, n
    p, q = number(b, x), number(b, y)
    if p.count > 1 or q.count > 1:
        raise Refused(said)
    return (b.fcmp_unordered if sign == "!=" else b.fcmp_ordered)(sign, p.value, q.value), p, q


def least(b: Any, sign: str, x: Any, y: Any) -> Any:
    """min (sign "<") or max (">") of two: y where that is less (more), otherwise x."""
    if known(x) and known(y):
        return min(x, y) if sign == "<" else max(x, y)
    said = "lanes: `maximum` and `select_lt` choose lane by lane"
    test, q, p = _test(b, sign, y, x, said)
    if isinstance(p, Integer):
        return Integer(b.select(test, q.value, p.value), p.unsigned)
    if p.tangents or q.tangents:
        raise Refused(said)
    return p.like(b.select(test, q.value, p.value), 1)


def truncated(b: Any, x: Any) -> Any:
    """int(x): towards zero; the nearest there is where 64 bits do not hold it, 0 of NaN (Python raises)."""
    if known(x):
        return int(x)
    if whole_kind(x):
        return x if isinstance(x, Integer) else Integer(whole(b, x))
    value = number(b, x)
    if value.count > 1:
        raise Refused("int of lanes")
    kind = ir.FunctionType(WORD, [DOUBLE])
    function = b.module.declare_intrinsic("llvm.fptosi.sat.i64.f64", (), kind)
    return Integer(b.call(function, [value.value]))


def absolute(b: Any, x: Any) -> Any:
    """abs(x)"""
    if known(x):
        return abs(x)
    if whole_kind(x):
        p = whole(b, x)
        return Integer(b.select(b.icmp_signed("<", p, ir.Constant(WORD, 0)), b.neg(p), p))
    return symbols.absolute(number(b, x))


def narrow(b: Any, x: Any, letter: str) -> Narrow:
    """x as a float32 (letter g) or a whole number as an uint8 (b)."""
    if isinstance(x, Narrow) and x.letter == letter:
        return x
    made = b.trunc(whole(b, x), NUMBERS["b"]) if letter == "b" else b.fptrunc(number(b, x).value, NUMBERS["g"])
    return Narrow(made, letter)


def bit(x: bool) -> Any:
    """A truth value that is known, as an LLVM bit."""
    return ir.Constant(BIT, int(x))
