"""Arithmetic of kernels with Python's meaning; operations on operands known at compile time are folded.

Integers have 64 bits and wrap around. Floor division rounds down, and a remainder has the sign of the divisor. Division
by zero gives 0 for integers (Python raises an error) and NaN for floats. A shift by 64 or more gives 0. Operations on
numbers known at compile time are evaluated by Python.

In all functions b is the LLVM IR builder. The operands x and y are *items* (`kinds`): either Python numbers that are
known at compile time, or LLVM values that are known at run time.
"""

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir

from . import symbols
from .kinds import BIT, BYTE, NUMBERS, WORD, Integer, Narrow, Refused, Truth, is_static, is_tuple, told
from .symbols import DOUBLE, Value, declared_function

# Python's operator for each AST operator class, for constant folding
KNOWN = {
    "Add": operator.add, "Sub": operator.sub, "Mult": operator.mul, "Div": operator.truediv,
    "FloorDiv": operator.floordiv, "Mod": operator.mod, "Pow": operator.pow, "LShift": operator.lshift,
    "RShift": operator.rshift, "BitAnd": operator.and_, "BitOr": operator.or_, "BitXor": operator.xor,
}  # fmt: skip
# LLVM's predicate and Python's operator for each AST comparison class
COMPARED = {
    "Lt": ("<", operator.lt), "Gt": (">", operator.gt), "LtE": ("<=", operator.le), "GtE": (">=", operator.ge),
    "Eq": ("==", operator.eq), "NotEq": ("!=", operator.ne),
}  # fmt: skip
# integer operations that wrap around: one LLVM instruction, signed or unsigned
_PLAIN = {"Add": "add", "Sub": "sub", "Mult": "mul", "BitAnd": "and_", "BitOr": "or_", "BitXor": "xor"}


_NUMBERS = (int, float, np.int64, np.uint64, np.bool_)


def known(x: Any) -> bool:
    """Return whether x is a number known at compile time."""
    return isinstance(x, _NUMBERS)


def whole_kind(x: Any) -> bool:
    """Return whether x is an integer or a truth value, known at compile time or computed at run time."""
    if isinstance(x, Narrow):
        return x.letter == "b"
    return isinstance(x, Integer | Truth) or (known(x) and not isinstance(x, float | np.floating))


def number(b: Any, x: Any) -> Value:
    """Convert x to a `Value` (float64 or lanes). Raises a compile error (`Refused`) if x is not a number."""
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
    """Convert an integer or truth value to an LLVM i64.

    unsigned: if True, integers known at compile time are accepted up to 2^64 - 1, otherwise up to 2^63 - 1. Raises a
        compile error (`Refused`) for larger integers, and for items that are neither integer nor truth value.
    """
    if isinstance(x, Integer):
        return x.value
    if isinstance(x, Truth) or (isinstance(x, Narrow) and x.letter == "b"):
        return b.zext(x.value, WORD)
    if known(x) and whole_kind(x):
        # literals and folded constants must fit; arithmetic at run time wraps around
        if not -(2**63) <= int(x) < 2 ** (64 if unsigned or isinstance(x, np.uint64) else 63):
            raise Refused(f"{x}: a whole number has 64 bits")
        return ir.Constant(WORD, int(x))
    raise Refused(f"{told(x)} where a whole number is wanted (int(x) makes one)")


def truth(b: Any, x: Any) -> Any:
    """Convert x to a truth value: a bool if x is known at compile time, otherwise an LLVM i1. Raises a compile error
    (`Refused`) for lanes and arrays."""
    if isinstance(x, Truth):
        return x.value
    if isinstance(x, Integer | Narrow) and whole_kind(x):
        return b.icmp_signed("!=", x.value, ir.Constant(x.value.type, 0))
    if isinstance(x, Value):
        if x.count > 1:
            raise Refused("lanes where a truth value is wanted: `select_lt` chooses lane by lane")
        # NaN is true, as in Python
        return b.fcmp_unordered("!=", x.value, ir.Constant(DOUBLE, 0.0))
    if x is None or known(x) or isinstance(x, str) or is_tuple(x):
        return bool(x)
    raise Refused(f"{told(x)} where a truth value is wanted")


def element(b: Any, found: Any, letter: str) -> Any:
    """Convert a loaded array element to an item: float32 becomes float64, uint8 becomes i64, bool becomes i1.

    letter: letter of the array's element type, a key of `kinds.NUMBERS`.
    """
    if letter in "iu":
        return Integer(found, letter == "u")
    if letter == "b":
        return Integer(b.zext(found, WORD))
    if letter == "t":
        return Truth(b.icmp_signed("!=", found, ir.Constant(BYTE, 0)))
    return Value(b, found if letter == "f" else b.fpext(found, DOUBLE), 1)


def _reckonable(*items: Any) -> None:
    """Refuse np.float32 and np.uint8 operands, which NumPy would compute in 32 or 8 bits."""
    for item in items:
        if isinstance(item, Narrow):
            word = "float" if item.letter == "g" else "int"
            raise Refused(f"{told(item)}: nothing is reckoned with it, {word}(x) makes a number of it")


def far_from_exact(x: Any, y: Any) -> bool:
    """Return whether x / y of signed integers may differ from the quotient of x and y converted to float64.

    If the two may differ, `wholes.ratio` computes the quotient, rounded once as in Python. Unsigned integers are
    converted to float64 first, as in NumPy.
    """
    both = (x, y)
    if any(isinstance(item, np.uint64) or (isinstance(item, Integer) and item.unsigned) for item in both):
        return False
    if not all(isinstance(item, Integer | Truth) or (known(item) and whole_kind(item)) for item in both):
        return False
    return any(isinstance(item, Integer) for item in both)


def binary(b: Any, op: str, x: Any, y: Any) -> Any:
    """Emit the code of x op y, where op names an AST operator class (`Add`, `FloorDiv`). Python evaluates the operation
    if both operands are known at compile time."""
    _reckonable(x, y)
    if known(x) and known(y):
        # Python would raise at run time; here it is a compile error
        if op in ("FloorDiv", "Mod", "Div") and y == 0:
            raise Refused("a division by zero that is known beforehand")
        try:
            with np.errstate(all="ignore"):
                return KNOWN[op](x, y)
        except (ArithmeticError, TypeError, ValueError) as error:
            raise Refused(f"{x} and {y}: {error}") from None
    if is_tuple(x) or is_tuple(y):
        return _of_tuples(op, x, y)
    if whole_kind(x) and whole_kind(y) and op not in ("Div", "Pow"):
        return _wholes(b, op, x, y)
    if op == "Pow":
        return _power(b, x, y)
    # at least one float64 or lane operand
    p, q = number(b, x), number(b, y)
    if op in ("Add", "Sub", "Mult", "Div"):
        return KNOWN[op](p, q)
    if op in ("FloorDiv", "Mod"):
        if p.count > 1 or q.count > 1 or p.tangents or q.tangents:
            raise Refused(f"{told(p)} and {told(q)}: floor division and remainder take plain numbers")
        return _floored(b, op, p, q)
    raise Refused(f"{told(x)} and {told(y)}: bit operations need integers")


def _of_tuples(op: str, x: Any, y: Any) -> Any:
    """Concatenate two tuples, or repeat a tuple a number of times known at compile time. Raises a compile error
    (`Refused`) for other operations.

    The sum of two tuples that both contain run-time numbers is also a compile error: Python would join the tuples, but
    a sum of vectors is probably meant.
    """
    if op == "Add" and is_tuple(x) and is_tuple(y):
        if all(any(isinstance(item, Value) for item in one) for one in (x, y)):
            what = "+ concatenates tuples, it does not add vectors; write (*a, *b), or a record"
            raise Refused(f"{told(x)} and {told(y)}: {what}")
        return x + y
    if op == "Mult" and isinstance(x if is_tuple(y) else y, int):
        return KNOWN[op](x, y)
    raise Refused(f"{told(x)} and {told(y)}: tuples are added, or multiplied by a number that is known")


def _unsigned(x: Any, y: Any) -> bool:
    """Return whether integer operands are unsigned. Raises a compile error (`Refused`) for one signed and one unsigned
    operand."""
    # known Python integers adapt to the other operand
    kinds = {item.unsigned for item in (x, y) if isinstance(item, Integer)}
    kinds |= {True for item in (x, y) if isinstance(item, np.uint64)}
    if len(kinds) == 2 or (True in kinds and any(known(item) and item < 0 for item in (x, y))):
        raise Refused("a signed and an unsigned whole number: np.uint64(x) makes both unsigned")
    return True in kinds


def _wholes(b: Any, op: str, x: Any, y: Any) -> Any:
    """Emit an integer operation and return an `Integer`; of two truth values only &, | and ^ return a `Truth`."""
    unsigned = _unsigned(x, y)
    p, q = whole(b, x, unsigned), whole(b, y, unsigned)
    if isinstance(x, Truth) and isinstance(y, Truth):
        # NumPy's truth values are no numbers, Python's are: arithmetic would be ambiguous
        if not op.startswith("Bit"):
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
    """Emit p << q or p >> q (arithmetic for signed p); q >= 64 gives 0, or -1 for negative p shifted right.

    The count is clamped, because LLVM's shifts are undefined from 64 places on. LLVM evaluates constants itself.
    """
    # unsigned comparison: a negative count is large, too
    few, zero = b.icmp_unsigned("<", q, ir.Constant(WORD, 64)), ir.Constant(WORD, 0)
    if op == "RShift" and not unsigned:
        return b.ashr(p, b.select(few, q, ir.Constant(WORD, 63)))
    return b.select(few, (b.shl if op == "LShift" else b.lshr)(p, b.select(few, q, zero)), zero)


def _divided(b: Any, op: str, p: Any, q: Any, unsigned: bool) -> Any:
    """Emit integer p // q or p % q, rounded toward minus infinity; the result for q = 0 is 0.

    LLVM's division is undefined for q = 0 and for -2^63 / -1. If q = 0 or q = -1, the code divides by 1 instead.
    """
    zero, one = ir.Constant(WORD, 0), ir.Constant(WORD, 1)
    none, minus = b.icmp_signed("==", q, zero), b.icmp_signed("==", q, ir.Constant(WORD, -1))
    if unsigned:
        return b.select(none, zero, (b.udiv if op == "FloorDiv" else b.urem)(p, b.select(none, one, q)))
    by = b.select(b.or_(none, minus), one, q)
    # truncated division; one less where the remainder and the divisor differ in sign
    rest = b.srem(p, by)
    under = b.and_(b.icmp_signed("!=", rest, zero), b.icmp_signed("<", b.xor(rest, by), zero))
    if op == "FloorDiv":
        result = b.select(minus, b.neg(p), b.sub(b.sdiv(p, by), b.zext(under, WORD)))
    else:
        result = b.select(minus, zero, b.add(rest, b.select(under, by, zero)))
    return b.select(none, zero, result)


def _floored(b: Any, op: str, p: Value, q: Value) -> Value:
    """Emit Python's `//` or `%` of float64, in the order of operations of CPython's float_divmod; q = 0 gives NaN."""
    zero = ir.Constant(DOUBLE, 0.0)
    # C's fmod: exact, with the sign of p
    rest = b.frem(p.value, q.value)
    some = b.fcmp_unordered("!=", rest, zero)
    # remainder with the sign of the divisor; a zero remainder gets it too
    apart = b.and_(some, b.xor(b.fcmp_ordered("<", q.value, zero), b.fcmp_ordered("<", rest, zero)))
    moved = b.select(apart, b.fadd(rest, q.value), rest)
    if op == "Mod":
        return p.like(b.select(some, moved, _signed(b, zero, q.value)), 1)
    # quotient (p - rest) / q, then to the nearest integer against rounding errors
    ratio = b.fdiv(b.fsub(p.value, rest), q.value)
    ratio = b.select(apart, b.fsub(ratio, ir.Constant(DOUBLE, 1.0)), ratio)
    down = p.like(ratio, 1).call("floor").value
    up = b.fcmp_ordered(">", b.fsub(ratio, down), ir.Constant(DOUBLE, 0.5))
    down = b.select(up, b.fadd(down, ir.Constant(DOUBLE, 1.0)), down)
    # a zero quotient has the sign of p / q
    nothing = b.fcmp_ordered("==", ratio, zero)
    found = b.select(nothing, _signed(b, zero, b.fdiv(p.value, q.value)), down)
    return p.like(b.select(b.fcmp_ordered("==", q.value, zero), ir.Constant(DOUBLE, math.nan), found), 1)


def _signed(b: Any, x: Any, sign: Any) -> Any:
    """Emit copysign(x, sign)."""
    function = b.module.declare_intrinsic("llvm.copysign", [DOUBLE], ir.FunctionType(DOUBLE, [DOUBLE, DOUBLE]))
    return b.call(function, [x, sign])


def _power(b: Any, x: Any, y: Any) -> Any:
    """Emit the code of x ** y: 2 ** n as a shift, float64 by C's pow.

    Raises a compile error (`Refused`) for lanes, tangents and other integer powers.
    """
    if whole_kind(x) and whole_kind(y):
        if known(x) and x == 2:
            return _wholes(b, "LShift", 1, y)
        raise Refused("a power of a whole number: of 2, or of a float")
    p, q = number(b, x), number(b, y)
    if p.count > 1 or q.count > 1 or p.tangents or q.tangents:
        raise Refused(f"{told(p)}: powers are of plain numbers")
    return Value(b, b.call(external(b, "pow", 2), [p.value, q.value]), 1)


def external(b: Any, name: str, count: int) -> Any:
    """Return the module's declaration of C's math function `name` with `count` double arguments, added if missing."""
    found = b.module.globals.get(name)
    if found is None:
        found = declared_function(b.module, name, ir.FunctionType(DOUBLE, [DOUBLE] * count))
        # LLVM would turn pow into x * x, 1 / x or exp2(y), whose last bit may differ
        if name == "pow":
            found.attributes.add("nobuiltin")
    return found


def negative(b: Any, x: Any) -> Any:
    """Emit the code of -x."""
    _reckonable(x)
    if known(x) or isinstance(x, Value):
        return -x
    if isinstance(x, Truth):
        raise Refused("minus a truth value: int(x) makes a number of it")
    if whole_kind(x):
        return Integer(b.neg(whole(b, x)), isinstance(x, Integer) and x.unsigned)
    return -number(b, x)


def compare(b: Any, op: str, x: Any, y: Any) -> Any:
    """Emit the code of x op y and return a `Truth`, or a bool if x and y are known; op names an AST comparison.

    Raises a compile error (`Refused`) for lanes.
    """
    sign, reckoned = COMPARED[op]
    _reckonable(x, y)
    if (known(x) and known(y)) or (is_static(x) and is_static(y) and type(x) is type(y) and isinstance(x, str | tuple)):
        try:
            return bool(reckoned(x, y))
        except TypeError as error:
            raise Refused(f"{told(x)} and {told(y)}: {error}") from None
    said = "lanes are not compared: `select_lt` chooses lane by lane, `max_over_lanes` is a number"
    return Truth(_test(b, sign, x, y, said)[0])


def _test(b: Any, sign: str, x: Any, y: Any, said: str) -> tuple[Any, Any, Any]:
    """Emit the comparison x sign y; return an LLVM i1 and both operands converted to a common type.

    Two integers are compared as integers; otherwise both become float64, and NaN is unequal to everything. If an
    operand has several lanes, the compile error has the message `said`.
    """
    if whole_kind(x) and whole_kind(y):
        unsigned = _unsigned(x, y)
        m, n = (Integer(whole(b, item, unsigned), unsigned) for item in (x, y))
        return (b.icmp_unsigned if unsigned else b.icmp_signed)(sign, m.value, n.value), m, n
    p, q = number(b, x), number(b, y)
    if p.count > 1 or q.count > 1:
        raise Refused(said)
    # != is true for NaN (unordered), all others are false (ordered)
    return (b.fcmp_unordered if sign == "!=" else b.fcmp_ordered)(sign, p.value, q.value), p, q


def least(b: Any, sign: str, x: Any, y: Any) -> Any:
    """Emit the code of min(x, y) (sign "<") or max(x, y) (">").

    The result is y if y is less (greater) than x, otherwise x. If x or y is NaN, the result is x. Raises a compile
    error (`Refused`) for lanes.
    """
    _reckonable(x, y)
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
    """Emit int(x), rounded toward zero. Results beyond 64 bits saturate; NaN gives 0 (Python raises an error)."""
    if known(x):
        return int(x)
    if isinstance(x, Integer) and x.unsigned:
        # unsigned to signed, saturated
        most = ir.Constant(WORD, 2**63 - 1)
        return Integer(b.select(b.icmp_signed("<", x.value, ir.Constant(WORD, 0)), most, x.value))
    if whole_kind(x):
        return x if isinstance(x, Integer) else Integer(whole(b, x))
    value = number(b, x)
    if value.count > 1:
        raise Refused("int of lanes")
    kind = ir.FunctionType(WORD, [DOUBLE])
    # saturating conversion: defined for all numbers, 0 for NaN
    function = b.module.declare_intrinsic("llvm.fptosi.sat.i64.f64", (), kind)
    return Integer(b.call(function, [value.value]))


def truncated_unsigned(b: Any, x: Any, signed: Any) -> Any:
    """Convert a float x to an unsigned integer: truncated and saturated from 2^63 on; `signed` if x is below 2^63."""
    value, kind = number(b, x).value, ir.FunctionType(WORD, [DOUBLE])
    above = b.call(b.module.declare_intrinsic("llvm.fptoui.sat.i64.f64", (), kind), [value])
    return b.select(b.fcmp_ordered(">=", value, ir.Constant(DOUBLE, 2.0**63)), above, signed.value)


def absolute(b: Any, x: Any) -> Any:
    """Emit the code of abs(x) of an integer or of float64 lanes."""
    _reckonable(x)
    if known(x) or (isinstance(x, Integer) and x.unsigned):
        return abs(x) if known(x) else x
    if whole_kind(x):
        p = whole(b, x)
        return Integer(b.select(b.icmp_signed("<", p, ir.Constant(WORD, 0)), b.neg(p), p))
    return symbols.absolute(number(b, x))


def passed(b: Any, k: Any, step: Any) -> Any:
    """Emit the next loop counter k + step (signed integers), saturated at the 64-bit limits so that it cannot wrap."""
    kind = ir.FunctionType(WORD, [WORD, WORD])
    return b.call(b.module.declare_intrinsic("llvm.sadd.sat.i64", (), kind), [k, step])


def narrow(b: Any, x: Any, letter: str) -> Narrow:
    """Convert x for an array: to float32 if `letter` is "g", to an integer's low 8 bits if `letter` is "b"."""
    if isinstance(x, Narrow) and x.letter == letter:
        return x
    made = b.trunc(whole(b, x), NUMBERS["b"]) if letter == "b" else b.fptrunc(number(b, x).value, NUMBERS["g"])
    return Narrow(made, letter)


def bit(x: bool) -> Any:
    """Return a known truth value as an LLVM i1 constant."""
    return ir.Constant(BIT, int(x))
