"""Elements of arrays and tuples in kernels: indices, slices and assignments to elements."""

import ast
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from . import arithmetic, words
from .arithmetic import known, number, truth, whole
from .kinds import (
    NUMBERS,
    WORD,
    Array,
    Integer,
    Record,
    Refused,
    Stored,
    Truth,
    is_tuple,
    kind,
    leaves,
    rebuilt,
    told,
)
from .symbols import DOUBLE, Value


class Elements:
    """The part of `expressions.Expressions` that reads and writes elements."""

    b: Any
    module: Any
    lane: Any
    parts: Callable[[Any], Sequence[Any]]
    dynamic: Callable[[Any], Any]
    value: Callable[[ast.expr], Any]

    def lengths(self, array: Array) -> Sequence[Any]:
        """Return the shape of an array as LLVM i64 values; for an array of lanes the number of elements per lane."""
        stride = 1 if array.lane is None else len(array.lane)
        return array.shape if stride == 1 else [self.b.sdiv(array.shape[0], ir.Constant(WORD, stride))]

    def slice(self, item: Any, node: ast.Slice) -> Any:
        """Evaluate x[lower:upper] of a tuple or of a one-dimensional array, as a view clamped at the array's end."""
        lower, upper = (None if x is None else self.value(x) for x in (node.lower, node.upper))
        if node.step is not None:
            raise Refused("a slice has no step in a kernel")
        if isinstance(item, tuple) and all(x is None or known(x) for x in (lower, upper)):
            return item[lower:upper]
        if not isinstance(item, Array) or len(item.shape) != 1:
            raise Refused(f"{told(item)}: slices are of arrays of one dimension, and of tuples at known places")
        b, (size,), stride = self.b, item.shape, ir.Constant(WORD, 1 if item.lane is None else len(item.lane))
        if any(x is not None and known(x) and x < 0 for x in (lower, upper)):
            raise Refused("a negative bound of a slice: count from the beginning")
        # bounds in numbers: an element of an array of lanes takes as many as its tag has entries
        first, last = whole(b, 0 if lower is None else lower), size
        if item.lane is not None:
            first = b.mul(first, stride)
        if upper is not None:
            end = whole(b, upper) if item.lane is None else b.mul(whole(b, upper), stride)
            last = b.select(b.icmp_signed("<", end, size), end, size)
        # length max(0, min(upper, size) - lower)
        length = b.sub(last, first)
        length = b.select(b.icmp_signed("<", length, ir.Constant(WORD, 0)), ir.Constant(WORD, 0), length)
        data = b.gep(item.data, [first], inbounds=True)
        return Array(data, (length,), item.letter, item.fixed, item.lane)

    def place(self, array: Array, at: Any) -> Any:
        """Return the address of an array element, in row-major order.

        Raises a compile error (`Refused`) for negative or non-integer indices.
        """
        steps = at if is_tuple(at) else (at,)
        self._check_index(array, steps)
        # row-major: k = (i n_1 + j) n_2 + ...
        k = whole(self.b, steps[0])
        for size, step in zip(array.shape[1:], steps[1:], strict=True):
            k = self.b.add(self.b.mul(k, size), whole(self.b, step))
        return self.b.gep(array.data, [k], inbounds=True)

    def _check_index(self, array: Array, steps: Sequence[Any]) -> None:
        """Refuse truth values, negative indices, and more or fewer indices than the array has dimensions."""
        if len(steps) != len(array.shape):
            raise Refused(f"{len(steps)} indices of an array of {len(array.shape)} dimensions")
        if any(isinstance(x, Truth | bool) for x in steps):
            raise Refused("a truth value as an index: int(x) makes a number of it")
        if any(known(x) and x < 0 for x in steps):
            raise Refused("a negative index: count from the beginning")

    def get(self, item: Any, at: Any) -> Any:
        """Evaluate item[at]: an element or a row (a view) of an array, or an item of a tuple."""
        if isinstance(item, Array):
            steps = at if is_tuple(at) else (at,)
            if item.lane is not None:
                self._check_index(item, steps)
                return words.load(self, item.lane, item, steps[0])
            # fewer indices than dimensions: a row, or rows of rows
            if len(steps) < len(item.shape):
                data = self.place(item, (*steps, *[0 for _ in item.shape[len(steps) :]]))
                return Array(data, item.shape[len(steps) :], item.letter, item.fixed)
            found = self.b.load(self.place(item, at))
            return arithmetic.element(self.b, found, item.letter)
        if isinstance(item, Record | Stored):
            item = tuple(self.parts(item))
        if isinstance(item, tuple | str) and known(at):
            if not -len(item) <= at < len(item):
                raise Refused(f"index {at} of {told(item)}")
            return item[at]
        # known numbers at a run-time index: a constant table
        if isinstance(item, tuple) and not known(at) and len(item) and all(known(x) for x in item):
            table = self.module.table(item)
            found = self.b.load(self.b.gep(table, [ir.Constant(WORD, 0), whole(self.b, at)], inbounds=True))
            if found.type == DOUBLE:
                return Value(self.b, found, 1)
            if all(isinstance(x, bool | np.bool_) for x in item):
                return Truth(self.b.icmp_signed("!=", found, ir.Constant(WORD, 0)))
            return Integer(found, all(isinstance(x, np.uint64) for x in item))
        if is_tuple(item) and len(item) and len({kind(x) for x in map(self.dynamic, item)}) == 1:
            return self._chosen([self.dynamic(x) for x in item], whole(self.b, at))
        raise Refused(f"{told(item)}[{told(at)}]: elements of arrays; of tuples at known places, or of one kind")

    def _chosen(self, items: list[Any], at: Any) -> Any:
        """Select one of several items of the same kind by an index known at run time; an index too large selects the
        last."""
        found = leaves(items[-1])
        for k, item in enumerate(items[:-1]):
            here = self.b.icmp_signed("==", at, ir.Constant(WORD, k))
            found = [self.b.select(here, one, other) for one, other in zip(leaves(item), found, strict=True)]
        return rebuilt(items[-1], iter(found), self.b)

    def put(self, item: Any, at: Any, value: Any) -> None:
        """Emit item[at] = value; the value is converted to the array's element type.

        Raises a compile error (`Refused`) for lanes, tangents and read-only arrays.
        """
        if not isinstance(item, Array):
            raise Refused(f"{told(item)}: only elements of arrays get values")
        item.written()
        if item.lane is not None:
            steps = at if is_tuple(at) else (at,)
            self._check_index(item, steps)
            words.put(self, item.lane, item, steps[0], value)
            return
        b, place = self.b, self.place(item, at)
        if item.letter == "f":
            x = number(b, value)
            if x.count > 1:
                raise Refused("lanes into one element: `store` writes all of them")
            if x.tangents:
                raise Refused("tangents into one element: `store` writes them too, `without_tangents` drops them")
            made = x.value
        elif item.letter in "iu":
            made = whole(b, value)
        elif item.letter == "t":
            found = truth(b, value)
            made = b.zext(arithmetic.bit(found) if isinstance(found, bool) else found, NUMBERS["t"])
        else:
            made = arithmetic.narrow(b, value, item.letter).value
        b.store(made, place)
