"""Statements of kernels: names, branches, loops."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from .arithmetic import binary, known, whole
from .expressions import Expressions
from .kinds import WORD, Integer, Refused, is_static, kind, leaves, rebuilt, told
from .merging import APART, Names, Widen, fitted, joined
from .source import source_of


class Slot:
    """Where a name's numbers live that gets several: what it stands for, and room on the stack."""

    def __init__(self, template: Any, places: list[Any]) -> None:
        self.template, self.places = template, places


class Writer(Expressions):
    """Writes one function."""

    def __init__(self, module: Any, code: Any, function: Any, wide: Names) -> None:
        super().__init__(module, code)
        self.function, self.wide, self.source = function, wide, source_of(function)
        self.reads = module.used.setdefault(function, set())
        self.slots: dict[str, Slot] = {}
        self.loops: list[Loop] = []
        self.result: Any = Widen  # not known yet
        self.line = self.source.tree.lineno

    # --- the whole ---------------------------------------------------------------------------------
    def write(self, items: Sequence[Any]) -> Any:
        """The function's code for arguments; what it returns."""
        it = iter(self.code.args)
        try:
            for name, item in zip([a.arg for a in self.source.tree.args.args], items, strict=True):
                self.bind(name, rebuilt(item, it, self.b))
            self.block(self.source.tree.body)
            if not self.b.block.is_terminated:
                self.give(None)
        except Refused as error:
            raise self.source.placed(error, self.line) from error.__cause__
        except Widen:
            raise
        except Exception as error:  # what nobody foresaw is refused as well, with its place
            raise self.source.placed(Refused(f"{type(error).__name__}: {error}"), self.line) from error
        self.closed()
        return self.result

    def give(self, item: Any) -> None:
        """Return an item."""
        item = self.dynamic(item)
        if self.result is Widen:
            self.result = self.wide.get("return", item)
            parts = leaves(self.result)
            if parts:  # what a function returns is known once it is written, and its callers are written after it
                made = ir.LiteralStructType([leaf.type for leaf in parts])
                self.code.ftype = ir.FunctionType(made, self.code.ftype.args)
                self.code.type = self.code.ftype.as_pointer()
                self.code.return_value = ir.values.ReturnValue(self.code, made)
        parts = leaves(self.fit("return", item, self.result))
        if not parts:
            self.b.ret_void()
            return
        whole_result = ir.Constant(self.code.return_value.type, ir.Undefined)
        for k, leaf in enumerate(parts):
            whole_result = self.b.insert_value(whole_result, leaf, k)
        self.b.ret(whole_result)

    def fit(self, name: str, item: Any, template: Any) -> Any:
        """An item in the shape of a template; a wider one is asked for where it does not fit."""
        wider = joined(template, item)
        if wider is APART:
            what = "it returns" if name == "return" else f"{name!r} is"
            raise Refused(f"{what} {told(template)} in one place and {told(item)} in another")
        if kind(wider) != kind(template):
            raise Widen(name, wider)
        return fitted(self, item, template)

    # --- names -------------------------------------------------------------------------------------
    def bind(self, name: str, item: Any) -> None:
        """Give a name a value."""
        if name not in self.source.often:
            self.names[name] = item
        else:
            self.put_in_slot(name, item)

    def put_in_slot(self, name: str, item: Any) -> None:
        """Give a name one of several values."""
        item = self.dynamic(item)
        parts = leaves(item)
        if not parts:
            self.names[name] = item
            return
        slot = self.slots.get(name)
        if slot is None:
            template = self.wide.get(name, item)
            slot = self.slots[name] = Slot(template, [self.room(leaf.type) for leaf in leaves(template)])
        for leaf, place in zip(leaves(self.fit(name, item, slot.template)), slot.places, strict=True):
            self.b.store(leaf, place)
        self.names[name] = slot

    def read(self, name: str) -> Any:
        """What a name stands for."""
        item = self.names.get(name, self)
        if item is self:
            if name in self.function.__code__.co_varnames:
                raise Refused(f"{name!r} may not have a value here, or not one that is known: give it one before")
            if name in self.source.scope:
                self.reads.add(name)
                item = self.source.scope[name]
                return self._constant(item) if isinstance(item, np.ndarray) else item
            if hasattr(builtins, name):
                return getattr(builtins, name)
            raise Refused(f"{name!r} is not defined")
        if isinstance(item, Slot):
            return rebuilt(item.template, iter([self.b.load(place) for place in item.places]), self.b)
        return item

    def meet(self, block: Any, ends: Sequence[Names]) -> None:
        """Go on at a block, with names that have one meaning at the end of all ways to it; there may be none."""
        self.b.position_at_end(block)
        if not ends:
            self.b.unreachable()
            return
        first, *others = ends

        def everywhere(name: str, item: Any) -> bool:
            return all(name in other and _same(other[name], item) for other in others)

        self.names = {name: item for name, item in first.items() if everywhere(name, item)}

    # --- statements --------------------------------------------------------------------------------
    def block(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            if self.b.block.is_terminated:
                return
            self.line = statement.lineno
            write = getattr(self, "on_" + type(statement).__name__, None)
            if write is None:
                raise Refused(f"{type(statement).__name__.lower()} is no statement of kernels")
            write(statement)

    def on_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.value(node.value)

    def on_Pass(self, node: ast.Pass) -> None:
        pass

    def on_Return(self, node: ast.Return) -> None:
        self.give(None if node.value is None else self.value(node.value))

    def on_Assign(self, node: ast.Assign) -> None:
        item = self.value(node.value)
        for target in node.targets:
            self.assign(target, item)

    def on_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.assign(node.target, self.value(node.value))

    def on_AugAssign(self, node: ast.AugAssign) -> None:
        op = type(node.op).__name__
        if isinstance(node.target, ast.Subscript):
            array, at = self.value(node.target.value), self.value(node.target.slice)
            self.put(array, at, binary(self.b, op, self.get(array, at), self.value(node.value)))
        else:
            self.assign(node.target, binary(self.b, op, self.value(node.target), self.value(node.value)))

    def assign(self, target: ast.expr, item: Any) -> None:
        if isinstance(target, ast.Name):
            self.bind(target.id, item)
        elif isinstance(target, ast.Tuple):
            parts = self.parts(item)
            if len(parts) != len(target.elts) or any(isinstance(x, ast.Starred) for x in target.elts):
                raise Refused(f"{len(parts)} values for {len(target.elts)} names")
            for one, part in zip(target.elts, parts, strict=True):
                self.assign(one, part)
        elif isinstance(target, ast.Subscript):
            self.put(self.value(target.value), self.value(target.slice), item)
        else:
            raise Refused("only names and elements of arrays get values")

    def on_If(self, node: ast.If) -> None:
        test = self.condition(node.test)
        if isinstance(test, bool):
            self.block(node.body if test else node.orelse)
            return
        before, ends = self.names, list[Names]()
        then, after = self.code.append_basic_block("then"), self.code.append_basic_block("after")
        other = self.code.append_basic_block("else") if node.orelse else after
        self.b.cbranch(test, then, other)
        for block, body in ((then, node.body), (other, node.orelse)):
            self.names = dict(before)
            if block is not after:
                self.b.position_at_end(block)
                self.block(body)
                if self.b.block.is_terminated:
                    continue
                self.b.branch(after)
            ends.append(self.names)
        self.meet(after, ends)

    def on_For(self, node: ast.For) -> None:
        if node.orelse:
            raise Refused("a loop has no else in a kernel")
        over = node.iter
        if isinstance(over, ast.Call) and isinstance(over.func, ast.Name) and self.read(over.func.id) is range:
            self._count(node, [self.value(argument) for argument in over.args], bool(over.keywords))
            return
        items = self.parts(self.value(over))
        end = self.code.append_basic_block("end")
        ends: list[Names] = []
        for item in items:  # written out
            loop = Loop(self.code.append_basic_block("next"), end)
            self.assign(node.target, item)
            self._round(node.body, loop, {})
            ends += loop.ends
            self.meet(loop.nxt, loop.nexts)
            if not loop.nexts:
                break
        if not self.b.block.is_terminated:
            self.b.branch(end)
            ends.append(self.names)
        self.meet(end, ends)

    def _count(self, node: ast.For, limits: list[Any], keywords: bool) -> None:
        """for ... in range(...)"""
        name, start, stop, step = limits_of(node, limits, keywords)
        last, by = whole(self.b, stop), whole(self.b, step)
        counter = self.room(WORD)
        self.b.store(whole(self.b, start), counter)
        head, body, nxt, end = (self.code.append_basic_block(word) for word in ("head", "loop", "next", "end"))
        before = self.names
        self.b.branch(head)
        self.b.position_at_end(head)
        k = self.b.load(counter)
        if known(step):
            go = self.b.icmp_signed("<" if step > 0 else ">", k, last)
        else:
            up, down = (self.b.icmp_signed(sign, by, ir.Constant(WORD, 0)) for sign in "><")
            below, above = (self.b.icmp_signed(sign, k, last) for sign in "<>")
            go = self.b.select(up, below, self.b.and_(down, above))  # by 0: not once
        self.b.cbranch(go, body, end)
        self.b.position_at_end(body)
        self.names = dict(before)
        self.bind(name, Integer(k))
        loop = Loop(nxt, end)
        self._round(node.body, loop, before)
        self.b.position_at_end(nxt)
        flags = ("nsw",) if known(step) and abs(step) == 1 else ()
        self.b.store(self.b.add(self.b.load(counter), by, flags=flags), counter)
        self.module.mark_loop(self.b.branch(head))
        self.meet(end, [before, *loop.ends])

    def _round(self, body: Sequence[ast.stmt], loop: Loop, before: Names) -> None:
        """A loop's body: what is known at its beginning must be so again each time."""
        self.loops.append(loop)
        self.block(body)
        self.loops.pop()
        if not self.b.block.is_terminated:
            self.b.branch(loop.nxt)
            loop.nexts.append(self.names)
        for end in loop.nexts:
            for name, item in before.items():
                if name not in end or not _same(end[name], item):
                    raise Refused(f"{name!r} changes in the loop, and what it stands for must be known beforehand")

    def on_While(self, node: ast.While) -> None:
        if node.orelse:
            raise Refused("a loop has no else in a kernel")
        before = self.names
        head, body, end = (self.code.append_basic_block(word) for word in ("head", "loop", "end"))
        self.b.branch(head)
        self.b.position_at_end(head)
        test = self.condition(node.test)
        if test is False:
            raise Refused("a loop whose condition is known to be false")
        loop = Loop(head, end)
        if test is True:
            self.b.branch(body)
        else:
            self.b.cbranch(test, body, end)
            loop.ends.append(before)
        self.b.position_at_end(body)
        self.names = dict(before)
        self._round(node.body, loop, before)
        self.meet(end, loop.ends)

    def on_Break(self, node: ast.Break) -> None:
        self.b.branch(self.loops[-1].end)
        self.loops[-1].ends.append(self.names)

    def on_Continue(self, node: ast.Continue) -> None:
        self.b.branch(self.loops[-1].nxt)
        self.loops[-1].nexts.append(self.names)


def limits_of(node: ast.For, limits: list[Any], keywords: bool) -> tuple[str, Any, Any, Any]:
    """What a loop over a range counts by: a name, from where, to where, in which steps."""
    if not isinstance(node.target, ast.Name):
        raise Refused("a loop over a range counts by one name")
    if not 1 <= len(limits) <= 3 or keywords:
        raise Refused("range takes one to three numbers")
    start, stop, step = (0, limits[0], 1) if len(limits) == 1 else (*limits, 1) if len(limits) == 2 else limits
    if known(step) and step == 0:
        raise Refused("range() by 0")
    return node.target.id, start, stop, step


class Loop:
    """Where `continue` and `break` go, and what names stand for on these ways."""

    def __init__(self, nxt: Any, end: Any) -> None:
        self.nxt, self.end = nxt, end
        self.nexts: list[Names] = []
        self.ends: list[Names] = []


def _same(one: Any, other: Any) -> bool:
    """Whether a name stands for the same on two ways."""
    if one is other:
        return True
    known_both = is_static(one) and is_static(other) and not isinstance(one, Slot)
    return known_both and type(one) is type(other) and bool(np.all(one == other))
