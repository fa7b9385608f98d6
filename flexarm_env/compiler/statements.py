"""Statements of kernels: assignments, branches and loops, from AST nodes to basic blocks."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from .arithmetic import known, passed, whole
from .expressions import Expressions
from .kinds import (
    WORD,
    Array,
    Integer,
    Record,
    Refused,
    Stored,
    declared,
    is_static,
    kind,
    leaves,
    rebuilt,
    told,
)
from .lane_arrays import is_lanes, lane_parameters
from .loops import Loop, limits_of
from .merging import APART, Names, Widen, fitted, joined
from .source import source_of

_DECLARED = Array | Record | Stored
"""Items that an annotated assignment declares."""


class Slot:
    """Stack slots for the values of a name that is assigned more than once.

    template: item with the common type of the name's values. places: addresses of the slots, one for each LLVM value.
    """

    def __init__(self, template: Any, places: list[Any]) -> None:
        self.template, self.places = template, places


class Writer(Expressions):
    """Writes one specialization of a kernel into an LLVM function.

    module: the program's `front.Module`.
    code: the LLVM function.
    wide: types of names whose slots were too narrow in an earlier attempt.
    names: dict from each name to its present item.
    result: item of the returned type.
    """

    def __init__(self, module: Any, code: Any, function: Any, wide: Names) -> None:
        """Begin the LLVM function `code` for a Python function."""
        super().__init__(module, code)
        self.function, self.wide, self.source = function, wide, source_of(function)
        self.reads = module.used.setdefault(function, set())
        self.slots: dict[str, Slot] = {}
        self.loops: list[Loop] = []
        # `Widen` stands for: no return statement yet
        self.result: Any = Widen
        self.line = self.source.tree.lineno

    # --- function ----------------------------------------------------------------------------------
    def write(self, items: Sequence[Any]) -> Any:
        """Emit the function's code for arguments of the kinds of `items`; return an item with the type of the result.

        Every exception during the writing is raised as Refused with file and line of the current statement.
        """
        # LLVM arguments are the leaves of all items
        it = iter(self.code.args)
        try:
            self.take([rebuilt(item, it, self.b) for item in items])
            self.block(self.source.tree.body)
            if not self.b.block.is_terminated:
                self.give(None)
        except Refused as error:
            raise self.source.placed(error, self.line) from error.__cause__
        except Widen:
            raise
        except Exception as error:
            raise self.source.placed(Refused(f"{type(error).__name__}: {error}"), self.line) from error
        self.closed()
        return self.result

    def take(self, items: Sequence[Any]) -> None:
        """Bind the kernel's parameters to the arguments `items`, as the annotations declare (`lane_arrays`)."""
        names = [argument.arg for argument in self.source.tree.args.args]
        said = lane_parameters(self.function)
        # the tag of the kernel's lanes: a tuple of zeros
        tag = dict(zip(names, items, strict=True)).get("lane")
        self.lane = tag if isinstance(tag, tuple) and tag and is_static(tag) else None
        for name, item in zip(names, items, strict=True):
            if said.get(name) and self.lane is None:
                raise Refused(f"{name}: Lanes, but the kernel has no argument `lane`, which says how many there are")
            try:
                self.bind(name, declared(item, said.get(name), self.lane))
            except Refused as error:
                raise Refused(f"argument {name!r}: {error}") from None

    def give(self, item: Any) -> None:
        """Emit a return of an item: a struct of the item's LLVM values, or void for an item known at compile time.

        The first return sets the type of the result. A later return that needs a wider type raises `Widen`.
        """
        item = self.dynamic(item)
        if self.result is Widen:
            self.result = self.wide.get("return", item)
            parts = leaves(self.result)
            if parts:
                # the LLVM result type is set now, before any caller is written
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
        """Convert an item to the type of `template`; raise Widen if a wider type is needed, Refused if no type fits."""
        wider = joined(template, item)
        if wider is APART:
            what = "it returns" if name == "return" else f"{name!r} is"
            raise Refused(f"{what} {told(template)} in one place and {told(item)} in another")
        if kind(wider) != kind(template):
            raise Widen(name, wider)
        return fitted(self, item, template)

    # --- names -------------------------------------------------------------------------------------
    def bind(self, name: str, item: Any) -> None:
        """Assign an item to a name: directly where the name is assigned once, otherwise through its stack slots."""
        # SSA: a name assigned once needs no slot
        if name not in self.source.often:
            self.names[name] = item
        else:
            self.put_in_slot(name, item)

    def put_in_slot(self, name: str, item: Any) -> None:
        """Store an item in the stack slots of a name, allocated on first use, unless it is known at compile time."""
        item = self.dynamic(item)
        parts = leaves(item)
        if not parts:
            self.names[name] = item
            return
        slot = self.slots.get(name)
        if slot is None:
            template = self.wide.get(name, item)
            # one stack slot per leaf; LLVM's mem2reg makes SSA phis of them
            slot = self.slots[name] = Slot(template, [self.room(leaf.type) for leaf in leaves(template)])
        for leaf, place in zip(leaves(self.fit(name, item, slot.template)), slot.places, strict=True):
            self.b.store(leaf, place)
        self.names[name] = slot

    def read(self, name: str) -> Any:
        """Return the item of a name, searched first among local names, then globals and closure, then built-in names.

        Raises a compile error (`Refused`) if the name may be unassigned. Global names are recorded for the cache key;
        global arrays become constants of the program.
        """
        item = self.names.get(name, self)
        if item is self:
            # a local name that is not assigned on all paths to here
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
        """Continue at the basic block `block`, with the names that denote the same item at the end of all paths to it.

        ends: for each path, the names with their items at its end. A block without paths is marked as unreachable.
        """
        self.b.position_at_end(block)
        if not ends:
            self.b.unreachable()
            return
        # keep a name if all paths agree; otherwise it is undefined from here on
        first, *others = ends

        def everywhere(name: str, item: Any) -> bool:
            return all(name in other and _same(other[name], item) for other in others)

        self.names = {name: item for name, item in first.items() if everywhere(name, item)}

    # --- statements --------------------------------------------------------------------------------
    def block(self, statements: Sequence[ast.stmt]) -> None:
        """Emit a block's statements in order, up to the first return, break or continue."""
        for statement in statements:
            if self.b.block.is_terminated:
                return
            self.line = statement.lineno
            write = getattr(self, "on_" + type(statement).__name__, None)
            if write is None:
                raise Refused(f"{type(statement).__name__.lower()} is no statement of kernels")
            write(statement)

    def on_Expr(self, node: ast.Expr) -> None:
        """Emit an expression statement; a docstring is skipped."""
        if not isinstance(node.value, ast.Constant):
            self.value(node.value)

    def on_Pass(self, node: ast.Pass) -> None:
        pass

    def on_Return(self, node: ast.Return) -> None:
        """Emit a return statement."""
        self.give(None if node.value is None else self.value(node.value))

    def on_Assign(self, node: ast.Assign) -> None:
        """Emit an assignment target = ... = value."""
        item = self.value(node.value)
        for target in node.targets:
            self.assign(target, item)

    def on_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Emit an annotated assignment. `Lanes`, or a named tuple class with fields of lanes, declares arrays of
        lanes."""
        holds = is_lanes(ast.unparse(node.annotation))
        if holds and self.lane is None:
            raise Refused("Lanes, but the kernel has no argument `lane`, which says how many there are")
        if node.value is not None:
            item = self.value(node.value)
            self.assign(node.target, declared(item, holds, self.lane) if holds or isinstance(item, _DECLARED) else item)

    def on_AugAssign(self, node: ast.AugAssign) -> None:
        """Emit target op= value for a name or an array element; subscripts are evaluated once."""
        op = type(node.op).__name__
        if isinstance(node.target, ast.Subscript):
            array, at = self.value(node.target.value), self.value(node.target.slice)
            self.put(array, at, self.arithmetic(op, self.get(array, at), self.value(node.value)))
        else:
            self.assign(node.target, self.arithmetic(op, self.value(node.target), self.value(node.value)))

    def assign(self, target: ast.expr, item: Any) -> None:
        """Assign an item to a target: a name, a tuple of targets, or an array element."""
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
        """Emit an if statement: only the branch taken if the condition is static, otherwise two basic blocks.

        After the statement a name has a value if it denotes the same item or the same stack slots in all branches that
        reach the end of the statement.
        """
        # a static condition: the other branch is not compiled, and may contain anything
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
                # this branch has returned or left the loop
                if self.b.block.is_terminated:
                    continue
                self.b.branch(after)
            ends.append(self.names)
        self.meet(after, ends)

    def on_For(self, node: ast.For) -> None:
        """Emit a loop over range(...), or unroll a loop over a tuple, whose items may differ in kind."""
        if node.orelse:
            raise Refused("a loop has no else in a kernel")
        over = node.iter
        if isinstance(over, ast.Call) and isinstance(over.func, ast.Name) and self.read(over.func.id) is range:
            self._count(node, [self.value(argument) for argument in over.args], bool(over.keywords))
            return
        items = self.parts(self.value(over))
        end = self.code.append_basic_block("end")
        ends: list[Names] = []
        for item in items:
            loop = Loop(self.code.append_basic_block("next"), end)
            # one copy of the body per item; `continue` goes to the next one, `break` to the end
            self.assign(node.target, item)
            self._round(node.body, loop, {})
            ends += loop.ends
            # the next copy begins with the names at the end of this one
            self.meet(loop.nxt, loop.nexts)
            # every path has left the loop
            if not loop.nexts:
                break
        if not self.b.block.is_terminated:
            self.b.branch(end)
            ends.append(self.names)
        self.meet(end, ends)

    def _count(self, node: ast.For, limits: list[Any], keywords: bool) -> None:
        """Write `for ... in range(...)` with a counter in a stack slot: blocks head, loop, next, end.

        A known step of 1 or -1 is added to the counter; one known only at run time is added with saturation.
        """
        name, start, stop, step = limits_of(node, limits, keywords)
        if known(step) and abs(step) > 1:
            self._count_turns(node, name, whole(self.b, start), whole(self.b, stop), step)
            return
        last, by = whole(self.b, stop), whole(self.b, step)
        # the counter is not the loop variable: assignments to the latter do not matter
        counter = self.room(WORD)
        self.b.store(whole(self.b, start), counter)
        head, body, nxt, end = (self.code.append_basic_block(word) for word in ("head", "loop", "next", "end"))
        before = self.names
        self.b.branch(head)
        self.b.position_at_end(head)
        k = self.b.load(counter)
        if known(step):
            # continue while k < stop, or k > stop for a negative step
            go = self.b.icmp_signed("<" if step > 0 else ">", k, last)
        else:
            # direction by the sign of the step; step 0 runs no iteration
            up, down = (self.b.icmp_signed(sign, by, ir.Constant(WORD, 0)) for sign in "><")
            below, above = (self.b.icmp_signed(sign, k, last) for sign in "<>")
            go = self.b.select(up, below, self.b.and_(down, above))
        self.b.cbranch(go, body, end)
        self.b.position_at_end(body)
        self.names = dict(before)
        self.bind(name, Integer(k))
        # body, then the increment in `next`, which `continue` jumps to
        loop = Loop(nxt, end)
        self._round(node.body, loop, before)
        self.b.position_at_end(nxt)
        at = self.b.load(counter)
        self.b.store(self.b.add(at, by, flags=("nsw",)) if known(step) else passed(self.b, at, by), counter)
        self.module.mark_loop(self.b.branch(head))
        self.meet(end, [before, *loop.ends])

    def _count_turns(self, node: ast.For, name: str, start: Any, stop: Any, step: int) -> None:
        """Write a range loop with a known step |step| > 1 as a loop over the iteration number.

        The number of iterations is computed beforehand, so that no counter passes 2^63.
        """
        b, one, zero = self.b, ir.Constant(WORD, 1), ir.Constant(WORD, 0)
        some = b.icmp_signed("<" if step > 0 else ">", start, stop)
        # ceil(span / |step|) iterations, unsigned and at most 2^63; 0 where start is not before stop
        span = b.sub(stop, start) if step > 0 else b.sub(start, stop)
        most = b.add(b.udiv(b.sub(span, one), ir.Constant(WORD, abs(step))), one)
        turns, counter = b.select(some, most, zero), self.room(WORD)
        b.store(zero, counter)
        head, body, nxt, end = (self.code.append_basic_block(word) for word in ("head", "loop", "next", "end"))
        before = self.names
        b.branch(head)
        b.position_at_end(head)
        turn = b.load(counter)
        b.cbranch(b.icmp_signed("<", turn, turns), body, end)
        b.position_at_end(body)
        self.names = dict(before)
        self.bind(name, Integer(b.add(start, b.mul(turn, ir.Constant(WORD, step)))))
        loop = Loop(nxt, end)
        self._round(node.body, loop, before)
        b.position_at_end(nxt)
        b.store(b.add(b.load(counter), one, flags=("nsw",)), counter)
        self.module.mark_loop(b.branch(head))
        self.meet(end, [before, *loop.ends])

    def _round(self, body: Sequence[ast.stmt], loop: Loop, before: Names) -> None:
        """Emit a loop's body once. Raises a compile error (`Refused`) if a name's static item changes in the body."""
        self.loops.append(loop)
        self.block(body)
        self.loops.pop()
        if not self.b.block.is_terminated:
            self.b.branch(loop.nxt)
            loop.nexts.append(self.names)
        # the body is written once, so what is static in it must hold in each iteration
        for end in loop.nexts:
            for name, item in before.items():
                if name not in end or not _same(end[name], item):
                    raise Refused(f"{name!r} changes in the loop, and what it stands for must be known beforehand")

    def on_While(self, node: ast.While) -> None:
        """Emit a while loop. Raises a compile error (`Refused`) for a condition that is known to be false."""
        if node.orelse:
            raise Refused("a loop has no else in a kernel")
        before = self.names
        head, body, end = (self.code.append_basic_block(word) for word in ("head", "loop", "end"))
        self.b.branch(head)
        self.b.position_at_end(head)
        test = self.condition(node.test)
        if test is False:
            raise Refused("a loop whose condition is known to be false")
        # `continue` jumps to the condition
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
        """Emit a break: jump to the block after the innermost loop, and record the present names for it."""
        self.b.branch(self.loops[-1].end)
        self.loops[-1].ends.append(self.names)

    def on_Continue(self, node: ast.Continue) -> None:
        """Emit a continue: jump to the next iteration of the innermost loop, and record the present names for it."""
        self.b.branch(self.loops[-1].nxt)
        self.loops[-1].nexts.append(self.names)


def _same(one: Any, other: Any) -> bool:
    """Return whether a name stands for the same item on two paths: identical, or equal static items of one type."""
    if one is other:
        return True
    known_both = is_static(one) and is_static(other) and not isinstance(one, Slot)
    return known_both and type(one) is type(other) and bool(np.all(one == other))
