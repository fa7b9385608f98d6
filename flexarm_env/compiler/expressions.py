"""Expressions of kernels: from an AST node to its item and the LLVM instructions that compute it."""

import ast
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from . import arithmetic, operators
from .arithmetic import binary, known, number, truth, whole
from .elements import Elements
from .kinds import (
    LETTERS,
    NUMBERS,
    RECORDS,
    WORD,
    Array,
    Integer,
    Layout,
    Record,
    Refused,
    Stored,
    Truth,
    declared,
    is_static,
    is_tuple,
    leaves,
    rebuilt,
    told,
    width,
)
from .lane_arrays import lane_fields
from .merging import APART, Names, fitted, joined
from .symbols import DOUBLE, Value
from .wholes import ratio


class Expressions(Elements):
    """Writes expressions into an LLVM function. `b` is the IR builder, and `module` is the program's `front.Module`."""

    def __init__(self, module: Any, code: Any) -> None:
        """Begin an LLVM function: an entry block for stack slots, then the body, where `b` writes."""
        self.module, self.code = module, code
        self.top, self._first = code.append_basic_block("entry"), code.append_basic_block("body")
        self.b = ir.IRBuilder(self._first)
        self.names: Names = {}
        self.reads: set[str] = set()
        # the kernel's lane tag, from its argument `lane`
        self.lane: Any = None

    def closed(self) -> None:
        """Finish the function: branch from the entry block, which holds the stack slots, to the body."""
        ir.IRBuilder(self.top).branch(self._first)

    def read(self, name: str) -> Any:
        """Return the item (value during compilation) that a name of the kernel denotes."""
        return self.names[name]

    def room(self, kind_of: Any, align: int | None = None) -> Any:
        """Allocate stack memory for an LLVM type, in the entry block for the whole call; return the address."""
        if isinstance(kind_of, ir.ArrayType):
            self.module.take_room(self.code, kind_of.count)
        place = ir.IRBuilder(self.top).alloca(kind_of)
        if align:
            place.align = align
        return place

    def dynamic(self, item: Any) -> Any:
        """Convert numbers known at compile time to LLVM constants, also within tuples; lane tags stay unchanged."""
        if isinstance(item, (Value, Integer, Array, Stored)):
            return item
        if isinstance(item, bool | np.bool_):
            return Truth(arithmetic.bit(bool(item)))
        if isinstance(item, int | np.integer):
            return Integer(whole(self.b, item), isinstance(item, np.uint64))
        if isinstance(item, float | np.floating):
            return number(self.b, item)
        if isinstance(item, tuple) and hasattr(item, "_fields"):
            return Record(type(item), [self.dynamic(x) for x in item])
        if isinstance(item, Record):
            return Record(item.instance_class, [self.dynamic(x) for x in item.values], item.lane)
        if is_tuple(item) and any(not isinstance(x, int) for x in item):
            return tuple(self.dynamic(x) for x in item)
        return item

    def parts(self, item: Any) -> Sequence[Any]:
        """Return the items of a tuple, a range or a named tuple. Raises a compile error (`Refused`) for any other
        item."""
        if isinstance(item, Record | Stored):
            return [self.field(item, name) for name in item.instance_class._fields]
        if isinstance(item, tuple | range):
            return tuple(item)
        raise Refused(f"{told(item)} where a tuple is wanted")

    def _constant(self, array: np.ndarray[Any, Any]) -> Array:
        """Embed a global array in the program with its present content, as a read-only `Array`."""
        if array.dtype.name not in ("float64", "int64", "uint64") or array.size == 0:
            raise Refused(f"a global array of {array.dtype}, shape {array.shape}: float64, int64, uint64 are constants")
        # row-major constants in the program's data segment
        table = self.module.table(array.ravel().tolist())
        zero = ir.Constant(WORD, 0)
        shape = tuple(ir.Constant(WORD, n) for n in array.shape)
        return Array(self.b.gep(table, [zero, zero], inbounds=True), shape, LETTERS[array.dtype.name], True)

    def value(self, node: ast.expr) -> Any:
        """Evaluate an expression by the method `of_<AST node class>`; return the expression's item."""
        write: Callable[[Any], Any] | None = getattr(self, "of_" + type(node).__name__, None)
        if write is None:
            raise Refused(f"{ast.unparse(node)}: {type(node).__name__} is no expression of kernels")
        return write(node)

    def condition(self, node: ast.expr) -> Any:
        """Evaluate a condition: to a bool if the condition is known at compile time, otherwise to an LLVM i1."""
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
        """Evaluate a list of expressions; a starred expression contributes the items of its tuple."""
        found: list[Any] = []
        for node in nodes:
            found += self.parts(self.value(node.value)) if isinstance(node, ast.Starred) else [self.value(node)]
        return found

    def of_Attribute(self, node: ast.Attribute) -> Any:
        """Evaluate x.name: field of a named tuple, shape or size of an array, attribute of a static object."""
        item = self.value(node.value)
        if isinstance(item, RECORDS):
            return self.field(item, node.attr)
        if isinstance(item, Array) and node.attr == "shape":
            return tuple(Integer(x) for x in self.lengths(item))
        if isinstance(item, Array) and node.attr == "size":
            count, *rest = self.lengths(item)
            for more in rest:
                count = self.b.mul(count, more)
            return Integer(count)
        if not is_static(item) or not hasattr(item, node.attr):
            raise Refused(f"{told(item)} has no {node.attr!r} in a kernel")
        if not known(item) and not isinstance(item, str | tuple):
            # for the cache key: attributes of global objects that the program depends on
            self.reads.add(ast.unparse(node) if self.is_global(node.value) else f"{ast.unparse(node)} of a local name")
        return getattr(item, node.attr)

    def is_global(self, node: ast.expr) -> bool:
        """Return whether an expression a.b.c begins with a global or closure name, not a local one."""
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and node.id not in self.names

    def field(self, item: Record | Stored, name: str) -> Any:
        """Return a field of a named tuple, or a constant of its class; a field in memory is loaded."""
        if isinstance(item, Record):
            fields: tuple[str, ...] = item.instance_class._fields
            if name not in fields:
                return self._beside(item, name)
            found = item.values[fields.index(name)]
        elif name in item.layout.parts:
            found = self.loaded(item.address, *item.layout.parts[name])
        else:
            return self._beside(item, name)
        holds = None if item.lane is None else name in lane_fields(item.instance_class)
        return declared(found, holds, item.lane)

    def _beside(self, item: Record | Stored, name: str) -> Any:
        """Return a class constant or property of a named tuple.

        Raises a compile error (`Refused`) if the class has no such attribute or the attribute is a method.
        """
        found = getattr(item.instance_class, name, None)
        if isinstance(found, property):
            return self.module.call(self, operators.method(found.fget), [item], {})
        if not hasattr(item.instance_class, name) or callable(getattr(item.instance_class, name)):
            raise Refused(f"{item.instance_class.__name__} has no field {name!r}")
        return getattr(item.instance_class, name)

    def loaded(self, address: Any, shape: Any, at: int) -> Any:
        """Load an item from memory, `at` 8-byte words after an address. shape: type of the item (`kinds.described_as`).

        The loads are marked as invariant for LLVM, because arguments do not change during a call.
        """

        def word(k: int) -> Any:
            """Load the 64-bit word k."""
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
        """Evaluate a subscript x[i] or x[i:j]."""
        item = self.value(node.value)
        if isinstance(node.slice, ast.Slice):
            return self.slice(item, node.slice)
        return self.get(item, self.value(node.slice))

    def of_UnaryOp(self, node: ast.UnaryOp) -> Any:
        """Evaluate not x, -x, +x or ~x (of integers)."""
        if isinstance(node.op, ast.Not):
            test = self.condition(node)
            return test if isinstance(test, bool) else Truth(test)
        item = self.value(node.operand)
        if isinstance(node.op, ast.USub):
            if isinstance(item, Record | Stored):
                return operators.negative(self, item)
            return arithmetic.negative(self.b, item)
        if isinstance(node.op, ast.UAdd) and (known(item) or isinstance(item, Integer | Value)):
            return item
        if isinstance(node.op, ast.Invert) and type(item) is int:
            return ~item
        if isinstance(node.op, ast.Invert) and isinstance(item, Integer):
            return Integer(self.b.not_(item.value), item.unsigned)
        raise Refused(f"{ast.unparse(node)}: no operation of kernels on {told(item)}")

    def of_BinOp(self, node: ast.BinOp) -> Any:
        return self.arithmetic(type(node.op).__name__, self.value(node.left), self.value(node.right))

    def arithmetic(self, op: str, x: Any, y: Any) -> Any:
        """Emit the code of x op y. The ratio of large signed integers calls `wholes.ratio`, which rounds only once."""
        if isinstance(x, RECORDS) or isinstance(y, RECORDS):
            return operators.binary(self, op, x, y)
        if op == "Div" and arithmetic.far_from_exact(x, y):
            code, found = self.module.function(ratio, [self.dynamic(x), self.dynamic(y)])
            call = self.b.call(code, [whole(self.b, x), whole(self.b, y)], cconv="fastcc")
            return rebuilt(found, iter([self.b.extract_value(call, 0)]), self.b)
        return binary(self.b, op, x, y)

    def of_Compare(self, node: ast.Compare) -> Any:
        """Evaluate a comparison; a < b < c evaluates b once, and c only if a < b holds."""
        left = self.value(node.left)

        def tested(following: tuple[ast.cmpop, ast.expr]) -> Any:
            """Compare the left operand with the next operand, which becomes the new left operand."""
            nonlocal left
            op, right = following[0], self.value(following[1])
            result = self._compared(op, left, right)
            left = right
            return truth(self.b, result)

        result = self._all(True, tested, list(zip(node.ops, node.comparators, strict=True)))
        return result if isinstance(result, bool) else Truth(result)

    def _compared(self, op: ast.cmpop, x: Any, y: Any) -> Any:
        """Compare x with y; `is` is decided at compile time: it compares with None, or compares static items."""
        if isinstance(op, ast.Is | ast.IsNot):
            if x is not None and y is not None and not (is_static(x) and is_static(y)):
                raise Refused("`is` asks for None in a kernel")
            return (x is y) == isinstance(op, ast.Is)
        if type(op).__name__ not in arithmetic.COMPARED:
            raise Refused("`in` is no comparison of kernels")
        return arithmetic.compare(self.b, type(op).__name__, x, y)

    def of_BoolOp(self, node: ast.BoolOp) -> Any:
        """Evaluate `and` or `or` of truth values, with short circuit."""

        def tested(part: ast.expr) -> Any:
            item = self.value(part)
            if not isinstance(item, Truth | bool):
                raise Refused("`and` and `or` give one of their operands: compare with something, or ask in an `if`")
            return truth(self.b, item)

        found = self._all(isinstance(node.op, ast.And), tested, node.values)
        return found if isinstance(found, bool) else Truth(found)

    def _all(self, every: bool, tested: Callable[[Any], Any], parts: Sequence[Any]) -> Any:
        """Evaluate `and` (every is True) or `or` of several parts, with short circuit; return a bool if known, else an
        i1."""
        incoming: list[tuple[Any, Any]] = []
        end, names = None, self.names
        result: Any = every
        for k, part in enumerate(parts):
            result = tested(part)
            if isinstance(result, bool):
                # a known part decides the result, or has no influence on it
                if result != every:
                    break
                continue
            if k == len(parts) - 1:
                break
            if end is None:
                end = self.code.append_basic_block("decided")
            # early exit: phi value False for `and`, True for `or`
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
        """Evaluate x if t else y: only one operand if t is known, otherwise two blocks and phi instructions."""
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
        # convert both to the common type at the end of their blocks
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
        """Evaluate a call: callee, positional and keyword arguments, then `calls.call`."""
        function, items = self.value(node.func), self.values(node.args)
        named = {}
        for keyword in node.keywords:
            if keyword.arg is None:
                raise Refused("** in a call")
            named[keyword.arg] = self.value(keyword.value)
        return self.module.call(self, function, items, named)
