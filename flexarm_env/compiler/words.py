"""The words of the language that the front end writes code of by itself: each Python function, and what it comes to.

In Python's own run they are the functions themselves; compiled, what stands beside them here.
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
    """How many lanes and tangents stand under a tag."""
    if not is_tuple(lane) or not is_tag(lane):
        raise Refused(f"{told(lane)} where a lane tag is wanted")
    return lanes.shape(len(lane))


def _floats(array: Any) -> Any:
    if not isinstance(array, Array) or array.letter != "f":
        raise Refused(f"{told(array)} where an array of float64 is wanted")
    return array.data


def _writable(array: Any) -> None:
    if isinstance(array, Array):
        array.written()


def _places(e: Any, array: Any, k: Any, count: int, tangents: int) -> list[Any]:
    """Where element k and its tangents lie."""
    b, stride = e.b, count * (1 + tangents)
    at = whole(b, k)
    first = b.gep(_floats(array), [b.mul(at, ir.Constant(WORD, stride)) if stride > 1 else at], inbounds=True)
    rest = [b.gep(first, [ir.Constant(WORD, count * (1 + i))], inbounds=True) for i in range(tangents)]
    return [place if count == 1 else b.bitcast(place, vector(count).as_pointer()) for place in (first, *rest)]


def load(e: Any, lane: Any, array: Any, k: Any) -> Value:
    count, tangents = shape_of(lane)
    places = _places(e, array, k, count, tangents)
    return Value.of(e.b, [e.b.load(place, align=8) for place in places], count)


def store(e: Any, array: Any, k: Any, value: Any) -> None:
    x = number(e.b, value)
    tangents = len(x.tangents)
    _writable(array)
    for place, part in zip(_places(e, array, k, x.count, tangents), x.parts(x.count, tangents), strict=True):
        e.b.store(part, place, align=8)


def _own_places(e: Any, lane: Any, array: Any, k: Any, i: Any) -> list[Any]:
    """Where element k of arm i and its tangents lie."""
    count, tangents = shape_of(lane)
    first = e.b.add(e.b.mul(whole(e.b, k), ir.Constant(WORD, count * (1 + tangents))), whole(e.b, i))
    steps = [e.b.add(first, ir.Constant(WORD, count * j)) for j in range(1 + tangents)]
    return [e.b.gep(_floats(array), [step], inbounds=True) for step in steps]


def pick(e: Any, lane: Any, array: Any, k: Any, i: Any) -> Value:
    return Value.of(e.b, [e.b.load(place) for place in _own_places(e, lane, array, k, i)], 1)


def place(e: Any, lane: Any, array: Any, k: Any, i: Any, value: Any) -> None:
    places = _own_places(e, lane, array, k, i)
    _writable(array)
    for where, part in zip(places, number(e.b, value).parts(1, len(places) - 1), strict=True):
        e.b.store(part, where)


def stack(e: Any, lane: Any, sizes: Any) -> Array:
    if not is_tuple(sizes):
        raise Refused(f"{told(sizes)}: room on the stack has a size that is known, a tuple of zeros")
    count = len(lane) * len(sizes)
    room = e.room(ir.ArrayType(DOUBLE, count), 64)
    return Array(e.b.bitcast(room, DOUBLE.as_pointer()), (ir.Constant(WORD, count),), "f", False)


def _on_symbols(operation: Any) -> Any:
    """A word that `symbols` has."""

    def word(e: Any, *items: Any) -> Any:
        values = [number(e.b, item) for item in items]
        found = operation(*values)
        if operation in (symbols.alone, symbols.largest):  # without tangents
            return found
        count, tangents = max(x.count for x in values), max(len(x.tangents) for x in values)
        if isinstance(found, tuple):
            return tuple(x.full(count, tangents) for x in found)
        return found.full(count, tangents)

    return word


def _external(name: str) -> Any:
    function = getattr(math, name)

    def word(e: Any, *items: Any) -> Any:
        if all(map(known, items)):
            return function(*items)
        values = [number(e.b, item) for item in items]
        if any(x.count > 1 or x.tangents for x in values):
            raise Refused(f"math.{name} of {told(next(x for x in values if x.count > 1 or x.tangents))}")
        return Value(e.b, e.b.call(arithmetic.external(e.b, name, len(items)), [x.value for x in values]), 1)

    return word


def _intrinsic(name: str, reckoned: Any, to_whole: bool, flat: bool = True) -> Any:
    """flat: its derivative is 0."""

    def word(e: Any, item: Any) -> Any:
        if known(item):
            return reckoned(item)
        if to_whole and arithmetic.whole_kind(item):
            return arithmetic.truncated(e.b, item)
        value = number(e.b, item)
        if value.tangents and not flat:
            raise Refused(f"math.{name} of {told(value)}: `square_root` has a derivative")
        found = value.call(name)
        return arithmetic.truncated(e.b, found) if to_whole else found

    return word


def _single(e: Any, item: Any) -> Value:
    value = number(e.b, item).alone
    if value.count > 1:
        raise Refused("lanes are asked for one truth: `select_lt` chooses lane by lane, `largest` is a number")
    return value


def _finite(e: Any, item: Any) -> Any:
    if known(item):
        return math.isfinite(item)
    size = _single(e, item).call("fabs")
    return Truth(e.b.fcmp_ordered("<", size.value, ir.Constant(DOUBLE, math.inf)))


def _not_a_number(e: Any, item: Any) -> Any:
    if known(item):
        return math.isnan(item)
    value = _single(e, item).value
    return Truth(e.b.fcmp_unordered("uno", value, value))


def _extreme(sign: str) -> Any:
    def word(e: Any, *items: Any) -> Any:
        if len(items) < 2:
            raise Refused("min and max take two arguments or more")
        found = items[0]
        for item in items[1:]:
            found = arithmetic.least(e.b, sign, found, item)
        return found

    return word


def _float(e: Any, item: Any) -> Any:
    return float(item) if known(item) else number(e.b, item)


def _length(e: Any, item: Any) -> Any:
    if isinstance(item, Array):
        return Integer(item.shape[0])
    if isinstance(item, Record | Stored):
        return len(item.instance_class._fields)
    if isinstance(item, tuple | str | range):
        return len(item)
    raise Refused(f"the length of {told(item)}")


def _unsigned(e: Any, item: Any) -> Any:
    item = arithmetic.truncated(e.b, item)
    return np.uint64(item) if known(item) else Integer(whole(e.b, item), True)


def _bool(e: Any, item: Any) -> Any:
    found = arithmetic.truth(e.b, item)
    return found if isinstance(found, bool) else Truth(found)


SYMBOLIC: dict[Any, Callable[..., Any]] = {
    lanes.select_lt: symbols.select_lt,
    lanes.absolute: symbols.absolute,
    lanes.square_root: symbols.square_root,
    lanes.round_even: symbols.round_even,
    lanes.turn: symbols.turned,
    lanes.with_slope: symbols.with_slope,
    lanes.change: symbols.change,
    lanes.alone: symbols.alone,
    lanes.largest: symbols.largest,
}
"""Words that are a function of symbols."""

WORDS: dict[Any, Callable[..., Any]] = {
    **{word: _on_symbols(function) for word, function in SYMBOLIC.items()},
    lanes.load: load,
    lanes.store: store,
    lanes.splat: lambda e, lane, x: number(e.b, x).full(*shape_of(lane)),
    lanes.pick: pick,
    lanes.place: place,
    lanes.stack: stack,
    lanes.arms: lambda e, lane: shape_of(lane)[0],
    lanes.size: lambda e, n: len(n) if is_tuple(n) else n,
    lanes.follow: lambda e, x: x,
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
