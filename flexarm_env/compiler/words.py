"""Built-in functions ("words") of the kernel language: each Python function with the emitter of its LLVM instructions.

In uncompiled mode Python calls the functions themselves. The compiler uses the emitters in `WORDS`. The first argument
e of an emitter is the writer of the function being compiled, and e.b is the IR builder. The other arguments of an
emitter are the items (`kinds`) of the call's arguments.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from . import arithmetic, lanes, symbols
from .arithmetic import known, number, whole
from .kinds import WORD, Array, Integer, Record, Refused, Stored, Truth, is_tag, is_tuple, told
from .symbols import DOUBLE, Value, vector


def shape_of(lane: Any) -> tuple[int, int]:
    """Return (number of lanes, number of tangents) of a lane tag. Raises a compile error (`Refused`) if the item is no
    lane tag."""
    if not is_tuple(lane) or not is_tag(lane):
        raise Refused(f"{told(lane)} where a lane tag is wanted")
    return lanes.shape(len(lane))


def _floats(array: Any) -> Any:
    """Return the data pointer of an array of float64. Raises a compile error (`Refused`) for any other item."""
    if not isinstance(array, Array) or array.letter != "f":
        raise Refused(f"{told(array)} where an array of float64 is wanted")
    return array.data


def _writable(array: Any) -> None:
    """Refuse a read-only array."""
    if isinstance(array, Array):
        array.written()


def _places(e: Any, array: Any, k: Any, count: int, tangents: int) -> list[Any]:
    """Return the addresses of element k in all `count` lanes: of the value, then of each tangent.

    An element takes count (1 + tangents) numbers: the values of all lanes, then each tangent in all lanes.
    """
    b, stride = e.b, count * (1 + tangents)
    at = whole(b, k)
    # values of all lanes, then tangent after tangent, count numbers each
    first = b.gep(_floats(array), [b.mul(at, ir.Constant(WORD, stride)) if stride > 1 else at], inbounds=True)
    rest = [b.gep(first, [ir.Constant(WORD, count * (1 + i))], inbounds=True) for i in range(tangents)]
    # one load or store then moves the numbers of all lanes (`count` doubles)
    return [place if count == 1 else b.bitcast(place, vector(count).as_pointer()) for place in (first, *rest)]


def load(e: Any, lane: Any, array: Any, k: Any) -> Value:
    """Emit the load of element k of every lane, with its tangents, as one `Value`."""
    count, tangents = shape_of(lane)
    places = _places(e, array, k, count, tangents)
    return Value.of(e.b, [e.b.load(place, align=8) for place in places], count)


def store(e: Any, array: Any, k: Any, value: Any) -> None:
    """Emit the store of a number, with its tangents, in element k of every lane.

    For a lane array (`lane_arrays`) a value with fewer lanes or tangents is broadcast first. In any other array only
    the value's own lanes and tangents are stored.
    """
    x = number(e.b, value)
    if isinstance(array, Array) and array.lane is not None:
        count, tangents = shape_of(array.lane)
        if x.count <= count and len(x.tangents) <= tangents:
            x = x.full(count, tangents)
    tangents = len(x.tangents)
    _writable(array)
    for place, part in zip(_places(e, array, k, x.count, tangents), x.parts(x.count, tangents), strict=True):
        e.b.store(part, place, align=8)


def put(e: Any, lane: Any, array: Any, k: Any, value: Any) -> None:
    """Emit array[k] = value for an array of lanes; a value with fewer lanes or tangents is broadcast.

    Raises a compile error (`Refused`) if the value has more lanes or tangents than the array.
    """
    count, tangents = shape_of(lane)
    x = number(e.b, value)
    if x.count > count or len(x.tangents) > tangents:
        raise Refused(f"{told(x)} into an array of {count} lanes with {tangents} tangents")
    store(e, array, k, x.full(count, tangents))


def _own_places(e: Any, lane: Any, array: Any, k: Any, i: Any) -> list[Any]:
    """Return the addresses of element k of arm i: of the value, then of each tangent, one double each."""
    count, tangents = shape_of(lane)
    # arm i within element k; its tangents follow at a distance of count numbers
    first = e.b.add(e.b.mul(whole(e.b, k), ir.Constant(WORD, count * (1 + tangents))), whole(e.b, i))
    steps = [e.b.add(first, ir.Constant(WORD, count * j)) for j in range(1 + tangents)]
    return [e.b.gep(_floats(array), [step], inbounds=True) for step in steps]


def pick(e: Any, lane: Any, array: Any, k: Any, i: Any) -> Value:
    """Emit the load of element k in the lane of arm i, with its tangents (`load_lane` in kernels)."""
    return Value.of(e.b, [e.b.load(place) for place in _own_places(e, lane, array, k, i)], 1)


def place(e: Any, lane: Any, array: Any, k: Any, i: Any, value: Any) -> None:
    """Emit the store of a number, with its tangents, in element k in the lane of arm i (`store_lane` in kernels)."""
    places = _own_places(e, lane, array, k, i)
    _writable(array)
    for where, part in zip(places, number(e.b, value).parts(1, len(places) - 1), strict=True):
        e.b.store(part, where)


def stack(e: Any, lane: Any, sizes: Any) -> Array:
    """Allocate len(sizes) uninitialized elements per lane and tangent on the stack, aligned to 64 bytes."""
    if not is_tuple(sizes):
        raise Refused(f"{told(sizes)}: room on the stack has a size that is known, a tuple of zeros")
    count = len(lane) * len(sizes)
    # indices count elements of the kernel's lanes, and numbers under any other tag
    tag = lane if lane == e.lane else None
    # 64 bytes: one vector of eight lanes, one cache line
    room = e.room(ir.ArrayType(DOUBLE, count), 64)
    return Array(e.b.bitcast(room, DOUBLE.as_pointer()), (ir.Constant(WORD, count),), "f", False, tag)


def _on_symbols(operation: Any) -> Any:
    """Return the emitter of a function on `Value`s; results get the widest operand's lanes and tangents."""

    def word(e: Any, *items: Any) -> Any:
        """Apply the operation to the arguments, converted to `Value`."""
        values = [number(e.b, item) for item in items]
        found = operation(*values)
        # these results have no tangents
        if operation in (symbols.alone, symbols.largest):
            return found
        # sine and cosine, for example, come as a tuple
        count, tangents = max(x.count for x in values), max(len(x.tangents) for x in values)
        if isinstance(found, tuple):
            return tuple(x.full(count, tangents) for x in found)
        return found.full(count, tangents)

    return word


def _external(name: str) -> Any:
    """Return the emitter of a C math function of scalars without tangents; known numbers are evaluated."""
    function = getattr(math, name)

    def word(e: Any, *items: Any) -> Any:
        """Call math.`name` at compile time on known numbers, otherwise write a call of the C function."""
        if all(map(known, items)):
            return function(*items)
        values = [number(e.b, item) for item in items]
        if any(x.count > 1 or x.tangents for x in values):
            raise Refused(f"math.{name} of {told(next(x for x in values if x.count > 1 or x.tangents))}")
        return Value(e.b, e.b.call(arithmetic.external(e.b, name, len(items)), [x.value for x in values]), 1)

    return word


def _intrinsic(name: str, reckoned: Any, to_whole: bool, flat: bool = True) -> Any:
    """Return the emitter of the LLVM intrinsic `name` (sqrt, floor, ceil).

    reckoned: Python's function for numbers known at compile time. to_whole: True if the result is converted to an
        integer. flat: True if the derivative is 0; otherwise numbers with tangents are refused.
    """

    def word(e: Any, item: Any) -> Any:
        """Evaluate a known number, return an integer unchanged if the result is an integer, otherwise emit the call."""
        if known(item):
            return reckoned(item)
        # floor and ceil of an integer: the integer itself
        if to_whole and arithmetic.whole_kind(item):
            return arithmetic.truncated(e.b, item)
        value = number(e.b, item)
        if value.tangents and not flat:
            raise Refused(f"math.{name} of {told(value)}: `square_root` has a derivative")
        found = value.call(name)
        return arithmetic.truncated(e.b, found) if to_whole else found

    return word


def _single(e: Any, item: Any) -> Value:
    """Return a number without its tangents. Raises a compile error (`Refused`) for several lanes, which have no single
    truth value."""
    value = number(e.b, item).alone
    if value.count > 1:
        raise Refused("lanes are asked for one truth: `select_lt` chooses lane by lane, `max_over_lanes` is a number")
    return value


def _finite(e: Any, item: Any) -> Any:
    """Emit math.isfinite: |x| < inf as an ordered comparison, false for NaN."""
    if known(item):
        return math.isfinite(item)
    # one comparison covers both infinities and NaN
    size = _single(e, item).call("fabs")
    return Truth(e.b.fcmp_ordered("<", size.value, ir.Constant(DOUBLE, math.inf)))


def _not_a_number(e: Any, item: Any) -> Any:
    """Emit math.isnan: true if x is unordered with itself."""
    if known(item):
        return math.isnan(item)
    value = _single(e, item).value
    return Truth(e.b.fcmp_unordered("uno", value, value))


def _extreme(sign: str) -> Any:
    """Return the emitter of min (sign "<") or max (">") of two or more arguments, from the left as in Python."""

    def word(e: Any, *items: Any) -> Any:
        """Combine the arguments pairwise, from the left, with `arithmetic.least`."""
        if len(items) < 2:
            raise Refused("min and max take two arguments or more")
        found = items[0]
        for item in items[1:]:
            found = arithmetic.least(e.b, sign, found, item)
        return found

    return word


def _float(e: Any, item: Any) -> Any:
    """Emit float(x)."""
    return float(item) if known(item) else number(e.b, item)


def _length(e: Any, item: Any) -> Any:
    """Return len(x): the first dimension of an array, the number of fields of a named tuple, or a known length."""
    if isinstance(item, Array):
        return Integer(e.lengths(item)[0])
    if isinstance(item, Record | Stored):
        return len(item.instance_class._fields)
    if isinstance(item, tuple | str | range):
        return len(item)
    raise Refused(f"the length of {told(item)}")


def _unsigned(e: Any, item: Any) -> Any:
    """Emit np.uint64(x): an integer keeps its 64 bits with unsigned meaning; a float is truncated first."""
    if isinstance(item, np.uint64) or (isinstance(item, Integer) and item.unsigned):
        return item
    found = arithmetic.truncated(e.b, item)
    if known(found):
        return np.uint64(found)
    return Integer(
        whole(e.b, found) if arithmetic.whole_kind(item) else arithmetic.truncated_unsigned(e.b, item, found), True
    )


def _bool(e: Any, item: Any) -> Any:
    """Emit bool(x)."""
    found = arithmetic.truth(e.b, item)
    return found if isinstance(found, bool) else Truth(found)


SYMBOLIC: dict[Any, Callable[..., Any]] = {
    # also used by traced code (`trace`)
    lanes.select_lt: symbols.select_lt,
    lanes.absolute: symbols.absolute,
    lanes.square_root: symbols.square_root,
    lanes.round_even: symbols.round_even,
    lanes.turn: symbols.turned,
    lanes.with_slope: symbols.with_slope,
    lanes.tangents_only: symbols.change,
    lanes.without_tangents: symbols.alone,
    lanes.max_over_lanes: symbols.largest,
}
"""Built-in functions of `Value`s: dict from the function that Python runs to the function that emits instructions."""

WORDS: dict[Any, Callable[..., Any]] = {
    **{word: _on_symbols(function) for word, function in SYMBOLIC.items()},
    lanes.load: load,
    lanes.store: store,
    lanes.splat: lambda e, lane, x: number(e.b, x).full(*shape_of(lane)),
    lanes.load_lane: pick,
    lanes.store_lane: place,
    lanes.stack: stack,
    lanes.lane_count: lambda e, lane: shape_of(lane)[0],
    lanes.size: lambda e, n: len(n) if is_tuple(n) else n,
    lanes.dereference: lambda e, x: x,
    len: _length,
    float: _float,
    int: lambda e, x: arithmetic.truncated(e.b, x),
    bool: _bool,
    abs: lambda e, x: arithmetic.absolute(e.b, x),
    min: _extreme("<"),
    max: _extreme(">"),
    math.sqrt: _intrinsic("sqrt", math.sqrt, False, flat=False),
    math.floor: _intrinsic("floor", math.floor, True),
    math.ceil: _intrinsic("ceil", math.ceil, True),
    math.isfinite: _finite,
    math.isnan: _not_a_number,
    np.floor: _intrinsic("floor", lambda x: float(math.floor(x)), False),
    np.uint8: lambda e, x: arithmetic.narrow(e.b, arithmetic.truncated(e.b, x), "b"),
    np.uint64: _unsigned,
    np.float32: lambda e, x: arithmetic.narrow(e.b, x, "g"),
    **{getattr(math, name): _external(name) for name in ("sin", "cos", "acos", "log", "exp", "tanh", "atan2", "hypot")},
}
