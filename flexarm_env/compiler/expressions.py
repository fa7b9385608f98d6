"""Expressions of kernels: what each stands for, and the instructions that it takes."""

import ast
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from llvmlite import ir

from . import arithmetic
from .arithmetic import binary, known, number, truth, whole
from .kinds import (
    LETTERS,
    NUMBERS,
    WORD,
    Array,
    Integer,
    Layout,
    Narrow,
    Record,
    Refused,
    Stored,
    Truth,
    is_static,
    is_tuple,
    kind,
    leaves,
    rebuilt,
    told,
    width,
)
from .merging import APART, Names, fitted, joined
from .symbols import DOUBLE, Value


class Expressions:
    """Writes expressions into a function: `b` is where, `module` the program's; what names stand for says `read`."""

    def __init__(self, module: Any, code: Any) -> None:
        self.module, self.code = module, code
        self.top, self._first = code.append_basic_block("entry"), code.append_basic_block("body")
        self.b = ir.IRBuilder(self._first)
        self.names: Names = {}
        self.reads: set[str] = set()

    def closed(self) -> None:
        """The function is written: from the room on the stack to its body."""
        ir.IRBuilder(self.top).branch(self._first)

    def read(self, name: str) -> Any:
        """What a name stands for."""
        return self.names[name]

    def room(self, kind_of: Any, align: int | None = None) -> Any:
        """Room on the stack for the length of the call."""
        place = ir.IRBuilder(self.top).alloca(kind_of)
        if align:
            place.align = align
        return place

    def dynamic(self, item: Any) -> Any:
        """Numbers that are known as numbers of run time; tags stay tags."""
        if isinstance(item, bool | np.bool_):
            return Truth(arithmetic.bit(bool(item)))
        if isinstance(item, int | np.integer):
            return Integer(whole(self.b, item), isinstance(item, np.uint64))
        if isinstance(item, float | np.floating):
            return number(self.b, item)
        if isinstance(item, tuple) and hasattr(item, "_fields"):
            return Record(type(item), [self.dynamic(x) for x in item])
        if isinstance(item, Record):
            return Record(item.instance_class, [self.dynamic(x) for x in item.values])
        if is_tuple(item) and any(not isinstance(x, int) for x in item):
            return tuple(self.dynamic(x) for x in item)
        return item

    def parts(self, item: Any) -> Sequence[Any]:
        """The items of a tuple."""
        if isinstance(item, Record):
            return item.values
        if isinstance(item, Stored):
            return [self.field(item, name) for name in item.layout.parts]
        if isinstance(item, tuple | range):
            return tuple(item)
        raise Refused(f"{told(item)} where a tuple is wanted")

    def _constant(self, array: np.ndarray[Any, Any]) -> Array:
        """A global array, as it is now: a part of the program."""
        if array.dtype.name not in ("float64", "int64") or array.size == 0:
            raise Refused(f"a global array of {array.dtype}, shape {array.shape}: float64 and int64 become constants")
        table = self.module.table(array.ravel().tolist())
        zero = ir.Constant(WORD, 0)
        shape = tuple(ir.Constant(WORD, n) for n in array.shape)
        return Array(self.b.gep(table, [zero, zero], inbounds=True), shape, LETTERS[array.dtype.name], True)

    def value(self, node: ast.expr) -> Any:
        """What an expression stands for."""
        write: Callable[[Any], Any] | None = getattr(self, "of_" + type(node).__name__, None)
        if write is None:
            raise Refused(f"{ast.unparse(node)}: {type(node).__name__} is no expression of kernels")
        return write(node)

    def condition(self, node: ast.expr) -> Any:
        """A bool where it is known, otherwise an LLVM bit."""
        if isinstance(node, ast.BoolOp):
            return self._all(isinstance(node.op, ast.And), self.condition, node.values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            test = self.condition(node.operand)
            return not test if isinstance(test, bool) else self.b.not_(test)
        return truth(self.b, self.value(node))

    def of_Constant(self, node: ast.Constant) -> Any:
        if not isinstance(node.value, bool | int | float | str | None):
            raise Refused(f"{node.value!r} is no constant of kernels")
        return node.value

    def of_Name(self, node: ast.Name) -> Any:
        return self.read(node.id)

    def of_Tuple(self, node: ast.Tuple) -> Any:
        return tuple(self.values(node.elts))

    def values(self, nodes: Sequence[ast.expr]) -> list[Any]:
        """What expressions in a row stand for: one item each, or, with a star, those of a tuple."""
        found: list[Any] = []
        for node in nodes:
            found += self.parts(self.value(node.value)) if isinstance(node, ast.Starred) else [self.value(node)]
        return found

    def of_Attribute(self, node: ast.Attribute) -> Any:
        item = self.value(node.value)
        if isinstance(item, Record | Stored):
            return self.field(item, node.attr)
        if isinstance(item, Array) and node.attr == "shape":
            return tuple(Integer(x) for x in item.shape)
        if isinstance(item, Array) and node.attr == "size":
            count = item.shape[0]
            for more in item.shape[1:]:
                count = self.b.mul(count, more)
            return Integer(count)
        if not is_static(item) or not hasattr(item, node.attr):
            raise Refused(f"{told(item)} has no {node.attr!r} in a kernel")
        if isinstance(item, ModuleType | type):
            self.reads.add(ast.unparse(node))
        return getattr(item, node.attr)

    def field(self, item: Record | Stored, name: str) -> Any:
        """A field of a named tuple."""
        if isinstance(item, Record):
            fields: tuple[str, ...] = item.instance_class._fields
            if name not in fields:
                return self._beside(item, name)
            return item.values[fields.index(name)]
        if name not in item.layout.parts:
            return self._beside(item, name)
        return self.loaded(item.address, *item.layout.parts[name])

    def _beside(self, item: Record | Stored, name: str) -> Any:
        if not hasattr(item.instance_class, name) or callable(getattr(item.instance_class, name)):
            raise Refused(f"{item.instance_class.__name__} has no field {name!r}")
        return getattr(item.instance_class, name)

    def loaded(self, address: Any, shape: Any, at: int) -> Any:
        """What lies `at` words behind an address; it stays what it is for the length of the call."""

        def word(k: int) -> Any:
            place = self.b.gep(address, [ir.Constant(WORD, k)], inbounds=True) if k else address
            found = self.b.load(place, align=8)
            found.set_metadata("invariant.load", self.module.invariant)
            return found

        if isinstance(shape, Layout):
            return Stored(self.b.gep(address, [ir.Constant(WORD, at)], inbounds=True) if at else address, shape)
        if shape == "none":
            return None
        if shape in ("integer", "unsigned"):
            return Integer(word(at), shape == "unsigned")
        if shape == "number":
            return Value(self.b, self.b.bitcast(word(at), DOUBLE), 1)
        if shape == "truth":
            return Truth(self.b.icmp_signed("!=", word(at), ir.Constant(WORD, 0)))
        if shape[0] == "tag":
            return (0,) * shape[1]
        if shape[0] == "tuple":
            found = []
            for part in shape[1]:
                found.append(self.loaded(address, part, at))
                at += width(part)
            return tuple(found)
        data = self.b.inttoptr(word(at), NUMBERS[shape[0]].as_pointer())
        return Array(data, tuple(word(at + 1 + k) for k in range(shape[1])), shape[0], len(shape) > 2)

    def of_Subscript(self, node: ast.Subscript) -> Any:
        item = self.value(node.value)
        if isinstance(node.slice, ast.Slice):
            return self._slice(item, node.slice)
        return self.get(item, self.value(node.slice))

    def _slice(self, item: Any, node: ast.Slice) -> Any:
        lower, upper = (None if x is None else self.value(x) for x in (node.lower, node.upper))
        if node.step is not None:
            raise Refused("a slice has no step in a kernel")
        if isinstance(item, tuple) and all(x is None or known(x) for x in (lower, upper)):
            return item[lower:upper]
        if not isinstance(item, Array) or len(item.shape) != 1:
            raise Refused(f"{told(item)}: slices are of arrays of one dimension, and of tuples at known places")
        b, (size,) = self.b, item.shape
        if any(x is not None and known(x) and x < 0 for x in (lower, upper)):
            raise Refused("a negative bound of a slice: count from the beginning")
        first, last = whole(b, 0 if lower is None else lower), size
        if upper is not None:
            end = whole(b, upper)
            last = b.select(b.icmp_signed("<", end, size), end, size)
        length = b.sub(last, first)
        length = b.select(b.icmp_signed("<", length, ir.Constant(WORD, 0)), ir.Constant(WORD, 0), length)
        data = b.gep(item.data, [first], inbounds=True)
        return Array(data, (length,), item.letter, item.fixed)

    def place(self, array: Array, at: Any) -> Any:
        """The address of an element."""
        steps = at if is_tuple(at) else (at,)
        if len(steps) != len(array.shape):
            raise Refused(f"{len(steps)} indices of an array of {len(array.shape)} dimensions")
        if any(isinstance(x, Truth | bool) for x in steps):
            raise Refused("a truth value as an index: int(x) makes a number of it")
        if any(known(x) and x < 0 for x in steps):
            raise Refused("a negative index: count from the beginning")
        k = whole(self.b, steps[0])
        for size, step in zip(array.shape[1:], steps[1:], strict=True):
            k = self.b.add(self.b.mul(k, size), whole(self.b, step))
        return self.b.gep(array.data, [k], inbounds=True)

    def get(self, item: Any, at: Any) -> Any:
        """item[at]"""
        if isinstance(item, Array):
            steps = at if is_tuple(at) else (at,)
            if len(steps) < len(item.shape):  # a row, or rows of rows
                data = self.place(item, (*steps, *[0 for _ in item.shape[len(steps) :]]))
                return Array(data, item.shape[len(steps) :], item.letter, item.fixed)
            found = self.b.load(self.place(item, at))
            if item.letter == "f":
                return Value(self.b, found, 1)
            return Integer(found, item.letter == "u") if item.letter in "iu" else Narrow(found, item.letter)
        if isinstance(item, Record | Stored):
            item = tuple(self.parts(item))
        if isinstance(item, tuple | str) and known(at):
            if not -len(item) <= at < len(item):
                raise Refused(f"index {at} of {told(item)}")
            return item[at]
        if isinstance(item, tuple) and not known(at) and len(item) and all(known(x) for x in item):
            table = self.module.table(item)
            found = self.b.load(self.b.gep(table, [ir.Constant(WORD, 0), whole(self.b, at)], inbounds=True))
            return Value(self.b, found, 1) if found.type == DOUBLE else Integer(found)
        if is_tuple(item) and len(item) and len({kind(x) for x in map(self.dynamic, item)}) == 1:
            return self._chosen([self.dynamic(x) for x in item], whole(self.b, at))
        raise Refused(f"{told(item)}[{told(at)}]: elements of arrays; of tuples at known places, or of one kind")

    def _chosen(self, items: list[Any], at: Any) -> Any:
        """One of several items of a kind; the last where there is none of that number."""
        found = leaves(items[-1])
        for k, item in enumerate(items[:-1]):
            here = self.b.icmp_signed("==", at, ir.Constant(WORD, k))
            found = [self.b.select(here, one, other) for one, other in zip(leaves(item), found, strict=True)]
        return rebuilt(items[-1], iter(found), self.b)

    def put(self, item: Any, at: Any, value: Any) -> None:
        """item[at] = value"""
        if not isinstance(item, Array):
            raise Refused(f"{told(item)}: only elements of arrays get values")
        item.written()
        b, place = self.b, self.place(item, at)
        if item.letter == "f":
            x = number(b, value)
            if x.count > 1:
                raise Refused("lanes into one element: `store` writes all of them")
            if x.tangents:
                raise Refused("a number with tangents into one element: `store` writes them too, `alone` leaves them")
            made = x.value
        elif item.letter in "iu":
            made = whole(b, value)
        else:
            made = arithmetic.narrow(b, value, item.letter).value
        b.store(made, place)

    def of_UnaryOp(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            test = self.condition(node)
            return test if isinstance(test, bool) else Truth(test)
        item = self.value(node.operand)
        if isinstance(node.op, ast.USub):
            return arithmetic.negative(self.b, item)
        if isinstance(node.op, ast.UAdd) and (known(item) or isinstance(item, Integer | Value)):
            return item
        if isinstance(node.op, ast.Invert) and type(item) is int:
            return ~item
        if isinstance(node.op, ast.Invert) and isinstance(item, Integer):
            return Integer(self.b.not_(item.value), item.unsigned)
        raise Refused(f"{ast.unparse(node)}: no operation of kernels on {told(item)}")

    def of_BinOp(self, node: ast.BinOp) -> Any:
        return binary(self.b, type(node.op).__name__, self.value(node.left), self.value(node.right))

    def of_Compare(self, node: ast.Compare) -> Any:
        left = self.value(node.left)

        def tested(following: tuple[ast.cmpop, ast.expr]) -> Any:
            nonlocal left
            op, right = following[0], self.value(following[1])
            result = self._compared(op, left, right)
            left = right
            return truth(self.b, result)

        # a < b < c: b is looked at once, c where a < b
        result = self._all(True, tested, list(zip(node.ops, node.comparators, strict=True)))
        return result if isinstance(result, bool) else Truth(result)

    def _compared(self, op: ast.cmpop, x: Any, y: Any) -> Any:
        if isinstance(op, ast.Is | ast.IsNot):
            if x is not None and y is not None and not (is_static(x) and is_static(y)):
                raise Refused("`is` asks for None in a kernel")
            return (x is y) == isinstance(op, ast.Is)
        if type(op).__name__ not in arithmetic.COMPARED:
            raise Refused("`in` is no comparison of kernels")
        return arithmetic.compare(self.b, type(op).__name__, x, y)

    def of_BoolOp(self, node: ast.BoolOp) -> Any:
        def tested(part: ast.expr) -> Any:
            item = self.value(part)
            if not isinstance(item, Truth | bool):
                raise Refused("`and` and `or` give one of their operands: compare with something, or ask in an `if`")
            return truth(self.b, item)

        found = self._all(isinstance(node.op, ast.And), tested, node.values)
        return found if isinstance(found, bool) else Truth(found)

    def _all(self, every: bool, tested: Callable[[Any], Any], parts: Sequence[Any]) -> Any:
        """`and` (every) or `or`, which look at what follows only where it matters."""
        incoming: list[tuple[Any, Any]] = []
        end, names = None, self.names
        result: Any = every
        for k, part in enumerate(parts):
            result = tested(part)
            if isinstance(result, bool):
                if result != every:
                    break
                continue
            if k == len(parts) - 1:
                break
            if end is None:
                end = self.code.append_basic_block("decided")
            incoming.append((arithmetic.bit(not every), self.b.block))
            go = self.code.append_basic_block("further")
            self.b.cbranch(result, *((go, end) if every else (end, go)))
            self.b.position_at_end(go)
            result = every
        self.names = names
        if end is None:
            return result
        incoming.append((arithmetic.bit(result) if isinstance(result, bool) else result, self.b.block))
        self.b.branch(end)
        self.b.position_at_end(end)
        chosen = self.b.phi(ir.IntType(1))
        for value, block in incoming:
            chosen.add_incoming(value, block)
        return chosen

    def of_IfExp(self, node: ast.IfExp) -> Any:
        test = self.condition(node.test)
        if isinstance(test, bool):
            return self.value(node.body if test else node.orelse)
        ways = []
        blocks = [self.code.append_basic_block(word) for word in ("this", "that", "both")]
        self.b.cbranch(test, *blocks[:2])
        for block, part in zip(blocks, (node.body, node.orelse), strict=False):
            self.b.position_at_end(block)
            ways.append((self.dynamic(self.value(part)), self.b.block))
        (one, _), (other, _) = ways
        template = joined(one, other)
        if template is APART:
            raise Refused(f"{told(one)} or {told(other)}: both must be of one kind")
        incoming = []
        for item, block in ways:
            self.b.position_at_end(block)
            incoming.append((leaves(fitted(self, item, template)), block))
            self.b.branch(blocks[2])
        self.b.position_at_end(blocks[2])
        phis = []
        for k, leaf in enumerate(incoming[0][0]):
            phi = self.b.phi(leaf.type)
            for parts, block in incoming:
                phi.add_incoming(parts[k], block)
            phis.append(phi)
        return rebuilt(template, iter(phis), self.b)

    def of_Call(self, node: ast.Call) -> Any:
        function, items = self.value(node.func), self.values(node.args)
        named = {}
        for keyword in node.keywords:
            if keyword.arg is None:
                raise Refused("** in a call")
            named[keyword.arg] = self.value(keyword.value)
        return self.module.call(self, function, items, named)
