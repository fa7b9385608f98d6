"""Merging of items at joins of control paths and reassignments of names: the common type to which both convert."""

from typing import Any

from . import arithmetic
from .kinds import Integer, Narrow, Record, Stored, Truth, is_static, is_tuple, kind, lane_tags
from .symbols import Value

Names = dict[str, Any]

APART = object()
"""Result of `joined` for two items without a common type."""


class Widen(Exception):
    """Raised if the stack slots of the variable `name` are too narrow for a value that is assigned to it.

    The compiler then writes the function again, with slots of the type of `template`.
    """

    def __init__(self, name: str, template: Any) -> None:
        self.name, self.template = name, template


def joined(one: Any, other: Any) -> Any:
    """Return an item (template) of the type to which both items can be converted; APART if no such type exists.

    Neither item may be a number known at compile time.

    An integer or truth value widens to float64, a truth value to an integer, a scalar to lanes, and a number without
    tangents to a number with tangents. Named tuples and tuples are merged part by part.
    """
    if kind(one) == kind(other):
        # an array of lanes and one of numbers are indexed differently
        return one if lane_tags(one) == lane_tags(other) else APART
    plain = Integer | Truth | Narrow
    if isinstance(one, Value) or isinstance(other, Value):
        # a number and an array, tuple or the like
        if not isinstance(one, Value | plain) or not isinstance(other, Value | plain):
            return APART
        if not isinstance(one, Value) or not isinstance(other, Value):
            return one if isinstance(one, Value) else other
        count, tangents = max(one.count, other.count), max(len(one.tangents), len(other.tangents))
        # the template is the item that has both the larger lane count and the larger tangent count
        fits = [x for x in (one, other) if (x.count, len(x.tangents)) == (count, tangents)]
        return fits[0] if fits else APART
    if isinstance(one, Integer) and isinstance(other, Truth):
        return one
    if isinstance(one, Truth) and isinstance(other, Integer):
        return other
    # named tuples of one class; two in memory at different layouts have no common type
    if isinstance(one, Record | Stored) and isinstance(other, Record | Stored):
        if one.instance_class is not other.instance_class or (isinstance(one, Stored) and isinstance(other, Stored)):
            return APART
        if isinstance(one, Record) and isinstance(other, Record):
            parts = [joined(x, y) for x, y in zip(one.values, other.values, strict=True)]
            return APART if any(x is APART for x in parts) else Record(one.instance_class, parts, one.lane)
        return one if isinstance(one, Record) else other
    if is_tuple(one) and is_tuple(other) and len(one) == len(other) and not (is_static(one) and is_static(other)):
        parts = [joined(x, y) for x, y in zip(one, other, strict=True)]
        return APART if any(x is APART for x in parts) else tuple(parts)
    return APART


def fitted(writer: Any, item: Any, template: Any) -> Any:
    """Convert each part of an item to the type of a template from `joined`: widen numbers and load named tuples."""
    b = writer.b
    if isinstance(template, Value):
        return arithmetic.number(b, item).full(template.count, len(template.tangents))
    if isinstance(template, Integer) and not isinstance(item, Integer):
        return Integer(arithmetic.whole(b, item))
    if isinstance(template, Record):
        values = [fitted(writer, x, t) for x, t in zip(writer.parts(item), template.values, strict=True)]
        return Record(template.instance_class, values, template.lane)
    if is_tuple(template) and not is_static(template):
        return tuple(fitted(writer, x, t) for x, t in zip(item, template, strict=True))
    return item
