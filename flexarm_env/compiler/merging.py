"""Where two ways meet, or a name gets a second value: what is wide enough for both."""

from typing import Any

from . import arithmetic
from .kinds import Integer, Narrow, Record, Stored, Truth, is_static, is_tuple, kind
from .symbols import Value

Names = dict[str, Any]

APART = object()
"""What `joined` gives of two items that no one place holds."""


class Widen(Exception):
    """A name's room is too narrow: the function is to be written anew with this in its place."""

    def __init__(self, name: str, template: Any) -> None:
        self.name, self.template = name, template


def joined(one: Any, other: Any) -> Any:
    """What holds either of two items, neither of them a number that is known; APART: nothing does.

    Whole numbers become numbers beside numbers, one number becomes lanes beside lanes, without tangents with them.
    """
    if kind(one) == kind(other):
        return one
    plain = Integer | Truth | Narrow
    if isinstance(one, Value) or isinstance(other, Value):
        if not isinstance(one, Value | plain) or not isinstance(other, Value | plain):
            return APART
        if not isinstance(one, Value) or not isinstance(other, Value):
            return one if isinstance(one, Value) else other
        count, tangents = max(one.count, other.count), max(len(one.tangents), len(other.tangents))
        fits = [x for x in (one, other) if (x.count, len(x.tangents)) == (count, tangents)]
        return fits[0] if fits else APART
    if isinstance(one, Integer) and isinstance(other, Truth):
        return one
    if isinstance(one, Truth) and isinstance(other, Integer):
        return other
    if isinstance(one, Record | Stored) and isinstance(other, Record | Stored):
        if one.instance_class is not other.instance_class or (isinstance(one, Stored) and isinstance(other, Stored)):
            return APART
        if isinstance(one, Record) and isinstance(other, Record):
            parts = [joined(x, y) for x, y in zip(one.values, other.values, strict=True)]
            return APART if any(x is APART for x in parts) else Record(one.instance_class, parts)
        return one if isinstance(one, Record) else other
    if is_tuple(one) and is_tuple(other) and len(one) == len(other) and not (is_static(one) and is_static(other)):
        parts = [joined(x, y) for x, y in zip(one, other, strict=True)]
        return APART if any(x is APART for x in parts) else tuple(parts)
    return APART


def fitted(writer: Any, item: Any, template: Any) -> Any:
    """An item in the shape of a template that `joined` gave."""
    b = writer.b
    if isinstance(template, Value):
        return arithmetic.number(b, item).full(template.count, len(template.tangents))
    if isinstance(template, Integer) and not isinstance(item, Integer):
        return Integer(arithmetic.whole(b, item))
    if isinstance(template, Record):
        values = [fitted(writer, x, t) for x, t in zip(writer.parts(item), template.values, strict=True)]
        return Record(template.instance_class, values)
    if is_tuple(template) and not is_static(template):
        return tuple(fitted(writer, x, t) for x, t in zip(item, template, strict=True))
    return item
