"""Reverse-mode differentiation of kernels.

`vjp_of(function, names)` generates a kernel that contains the function, with all functions that it calls inlined,
followed by a reverse sweep. The sweep computes the derivatives of a scalar by all inputs from those by the outputs
("cotangents"), at a few times the cost of the function. `Tape` records the instructions; this module adds branches and
loops. Forward values that cannot be recomputed are saved: in stack slots, or in one frame of memory per iteration.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from .arithmetic import known, whole
from .decorator import UNCOMPILED, Kernel
from .kinds import WORD, Array, Integer, Record, Refused, is_tuple, leaves, rebuilt
from .loops import Loop, limits_of
from .merging import Names, Widen
from .nodes import Region
from .source import source_of
from .statements import Writer
from .symbols import Value
from .tape import Tape
from .trace import Slots, Straight, Tracer

FEW = 6
"""Loops with at most this number of iterations, if the number is known at compile time, are unrolled."""


class Backward(Writer):
    """Writes a function on a `Tape` for reverse mode, with all called kernels inlined."""

    def __init__(self, outer: Any, tape: Tape, function: Any) -> None:
        """Write into the outer writer's LLVM function. function: None for a root that only emits calls."""
        self.module, self.code, self.top, self.b = outer.module, outer.code, outer.top, tape
        self.names: Names = {}
        self.lane: Any = None
        self.slots, self.loops, self.result, self.done = {}, [], None, False
        if function is not None:
            self.function, self.source = function, source_of(function)
            self.wide = tape.wide.setdefault(function, {})
            self.reads = self.module.used.setdefault(function, set())
            self.line = self.source.tree.lineno

    def inlined(self, kernel: Any, items: Sequence[Any]) -> Any:
        """Write a called kernel in place and return its result."""
        return Backward(self, self.b, kernel.function).write(items)

    def tracer(self, lane: tuple[int, ...]) -> Tracer:
        """Return the tracer that writes straight-line code."""
        return _Held(self, lane)

    def room(self, kind_of: Any, align: int | None = None) -> Any:
        """Allocate stack memory and, for float64, equal memory for the cotangents; return the address of the first."""
        place = super().room(kind_of, align)
        # integers and pointers have no cotangents
        if isinstance(kind_of, ir.DoubleType | ir.VectorType | ir.ArrayType):
            self.b.paired(place, super().room(kind_of, align), own=True)
        return place

    def write(self, items: Sequence[Any]) -> Any:
        """Emit the function's code at the current position; return the result item.

        If a stack slot is too narrow (`Widen`), the wider type is recorded for this function, and the exception is
        raised again so that the root function is emitted again.
        """
        try:
            self.take(items)
            self.block(self.source.tree.body)
        except Widen as needed:
            if needed.name:
                self.wide[needed.name], needed.name = needed.template, ""
            raise
        except Refused as error:
            raise self.source.placed(error, self.line) from error.__cause__
        return self.result

    def give(self, item: Any) -> None:
        """Set the function's result; within a branch, store it in stack slots. Raises `Refused` within a loop."""
        if self.loops:
            raise Refused("a return within a loop has no derivative backwards")
        # the result differs between sides: stack slots carry it
        if self._branched:
            self.put_in_slot("return", item)
        self.result, self.done = item, True

    _branched = 0

    def bind(self, name: str, item: Any) -> None:
        """Assign an item to a name. The address of an array's cotangents is known, so it gets no stack slot."""
        if any(isinstance(x, Array) and self.b.has_bar(x.data) for x in _parts(item)):
            self.names[name] = item
        else:
            super().bind(name, item)

    def block(self, statements: Sequence[ast.stmt]) -> None:
        """Emit a block's statements in order, up to a return.

        After an `if` that ends with a return, the following statements become its else branch.
        """
        for k, statement in enumerate(statements):
            if self.done:
                return
            # move the rest into the else branch, so that each path has one return
            if isinstance(statement, ast.If) and isinstance(statement.body[-1], ast.Return):
                self.line = statement.lineno
                self.on_If(ast.If(statement.test, statement.body, [*statement.orelse, *statements[k + 1 :]]))
                return
            super().block([statement])

    def on_While(self, node: ast.While) -> None:
        """Emit a while loop. Raises `Refused` if the loop computes differentiated values, whose number is unknown."""
        items = len(self.b.region.items)
        super().on_While(node)
        if self.b.active_since(items):
            raise Refused("a while loop of numbers has no derivative backwards: count by range")

    def on_Break(self, node: ast.Break) -> None:
        """Emit a break. Raises a compile error (`Refused`) in a range loop, whose reverse code runs all iterations."""
        if self.loops[-1].ends is None:
            raise Refused("break has no derivative backwards")
        super().on_Break(node)

    def on_Continue(self, node: ast.Continue) -> None:
        """Emit a continue. Raises `Refused` in a range loop, whose reverse code runs all iterations."""
        if self.loops[-1].ends is None:
            raise Refused("continue has no derivative backwards")
        super().on_Continue(node)

    def of_IfExp(self, node: ast.IfExp) -> Any:
        """Evaluate x if t else y. Raises `Refused` if an operand is active, since an SSA phi has no reverse rule."""
        found = super().of_IfExp(node)
        for leaf in leaves(found):
            if isinstance(leaf, ir.PhiInstr) and any(self.b.depends(x) for x, _ in leaf.incomings):
                raise Refused("x if t else y of numbers has no derivative backwards: select_lt chooses, or an `if`")
        return found

    def on_If(self, node: ast.If) -> None:
        """Emit an if statement: both sides as regions of the tape, and the reverse code as an item of the outer region.

        Raises a compile error (`Refused`) for a return on one side only.
        """
        test = self.condition(node.test)
        if isinstance(test, bool):
            self.block(node.body if test else node.orelse)
            return
        before, ends, ways, outer, returned = self.names, list[Names](), list[_Way](), self.b.region, list[bool]()
        first = [self.code.append_basic_block(word) for word in ("then", "else")]
        after = self.code.append_basic_block("after")
        self.b.cbranch(test, *first)
        for block, body in zip(first, (node.body, node.orelse), strict=True):
            self.names, self._branched = dict(before), self._branched + 1
            self.b.position_at_end(block)
            ways.append(_Way(self.b, self.code, block, after))
            self.block(body)
            ways[-1].close()
            self.b.branch(after)
            ends.append(self.names)
            returned.append(self.done)
            self._branched, self.done = self._branched - 1, False
        self.meet(after, ends)
        # the reverse is written later, by `Tape.sweep`
        if any(way.items for way in ways):
            outer.items.append(lambda: self._either(test, ways))
        # all sides have returned; the result is in the slots of "return"
        if any(returned):
            if not all(returned):
                raise Refused("a return on one way alone has no derivative backwards")
            self.done = True
            if not self._branched:
                self.result = self.read("return")

    def _either(self, test: Any, ways: Sequence[_Way]) -> None:
        """Emit the reverse of a branch: by the forward condition, the reverse code of one of two sides."""
        tape = self.b
        first = [self.code.append_basic_block("back") for _ in ways]
        test, after = tape.back(test), self.code.append_basic_block("before")
        tape.cbranch(test, *first)
        for block, way in zip(first, ways, strict=True):
            tape.position_at_end(block)
            tape.sweep(way)
            tape.branch(after)
        tape.position_at_end(after)

    def _count(self, node: ast.For, limits: list[Any], keywords: bool) -> None:
        """Write a range loop with a known step: unrolled if short, otherwise as a region `_Turns`."""
        name, start, stop, step = limits_of(node, limits, keywords)
        if not known(step):
            raise Refused("a loop by a step that is not known has no derivative backwards")
        if known(start) and known(stop) and len(range(start, stop, step)) <= FEW:
            # unrolled: one copy of the body per iteration, since the number of iterations is known and small
            for k in range(start, stop, step):
                self.assign(node.target, k)
                self.block(node.body)
            return
        b, before, outer = self.b, self.names, self.b.region
        # number of iterations max(0, ceil((stop - start) / step))
        first, span = whole(b, start), b.sub(whole(b, stop), whole(b, start))
        # rounded up by adding step - 1 (step + 1 if negative) before the division
        if abs(step) != 1:
            one = ir.Constant(WORD, step - 1 if step > 0 else step + 1)
            span = b.sdiv(b.add(span, one), ir.Constant(WORD, step))
        elif step < 0:
            span = b.neg(span)
        turns = b.select(b.icmp_signed(">", span, ir.Constant(WORD, 0)), span, ir.Constant(WORD, 0))
        loop = _Turns(self, turns)
        k = b.add(first, b.mul(loop.turn, ir.Constant(WORD, step)))
        self.names = dict(before)
        self.bind(name, Integer(k))
        way = Loop(loop.latch, loop.end)
        # marks a loop in which break and continue are refused
        way.ends = None  # type: ignore[assignment]
        self._round(node.body, way, before)
        loop.close()
        self.meet(loop.end, [before])
        if loop.items:
            outer.items.append(loop.go_back)


def _parts(item: Any) -> list[Any]:
    """Return the parts of an item, with tuples and named tuples flattened."""
    if isinstance(item, Record):
        return [x for part in item.values for x in _parts(part)]
    return [x for part in item for x in _parts(part)] if is_tuple(item) else [item]


class _Way(Region):
    """Region of one side of a branch; forward values that its reverse code needs are saved in stack slots."""

    is_branch = True

    def __init__(self, tape: Tape, code: Any, block: Any, after: Any) -> None:
        super().__init__(tape, code, block)
        self._after = after

    def close(self) -> None:
        """End the region at the current block."""
        super().close()
        self._last = self.tape.block

    def brought(self, value: Any) -> Any:
        """Save a value at the end of this side of the branch, load it after the branch, and return the loaded value."""
        tape, slot = self.tape, self.tape.slot(value.type)
        # at the end of the side: the value dominates this point
        with tape.at(self._last):
            tape.store(value, slot)
        with tape.at(self._after, start=True):
            kept = tape.load(slot)
        return tape.back(kept)


class _Turns(Region):
    """Region of a range loop; needed forward values are saved in a frame of words, one frame per iteration.

    turns: number of iterations of the loop (LLVM i64). The size of a frame is a constant that `go_back` sets.
    """

    def __init__(self, writer: Backward, turns: Any) -> None:
        """Allocate one frame per iteration (`turns`), open the loop with its counter, continue in its body."""
        tape, code = writer.b, writer.code
        self._writer, self._turns, self._size = writer, turns, ir.Constant(WORD, 0)
        self._saved: list[tuple[Any, int]] = []
        # the frame size is 0 until `go_back` patches it
        self._frames = tape.taken(tape.mul(turns, self._size))
        counter = self._counter = tape.slot(WORD)
        tape.store(ir.Constant(WORD, 0), counter)
        self._head, self.end = (code.append_basic_block(word) for word in ("head", "end"))
        tape.branch(self._head)
        tape.position_at_end(self._head)
        self.turn = tape.load(counter)
        super().__init__(tape, code, self._head)
        body = code.append_basic_block("loop")
        tape.cbranch(tape.icmp_signed("<", self.turn, turns), body, self.end)
        self.latch = code.append_basic_block("next")
        tape.position_at_end(body)

    def close(self) -> None:
        """Close the loop: increment the counter and branch back to its head."""
        tape = self.tape
        tape.position_at_end(self.latch)
        tape.store(tape.add(self.turn, ir.Constant(WORD, 1)), self._counter)
        self._writer.module.mark_loop(tape.branch(self._head))
        super().close()

    def go_back(self) -> None:
        """Emit the reverse of the loop, from the last iteration to the first.

        When the frame size is known, the code that saves values is inserted at the end of each forward iteration.
        """
        tape, code, one = self.tape, self._writer.code, ir.Constant(WORD, 1)
        turns, frames = tape.back(self._turns), tape.back(self._frames)
        tape.store(turns, self._counter)
        head, body, end = (code.append_basic_block(word) for word in ("head", "back", "end"))
        tape.branch(head)
        tape.position_at_end(head)
        left = tape.load(self._counter)
        tape.cbranch(tape.icmp_signed(">", left, ir.Constant(WORD, 0)), body, end)
        tape.position_at_end(body)
        turn = tape.sub(left, one)
        tape.store(turn, self._counter)
        # frame of this iteration; the forward counter is the reverse counter here
        self._frame = tape.gep(frames, [tape.mul(turn, self._size)], inbounds=True)
        self.kept[id(self.turn)] = turn
        tape.sweep(self)
        self._writer.module.mark_loop(tape.branch(head))
        # patch the frame size, which earlier instructions refer to
        self._size.constant = self._saved[-1][1] if self._saved else 0
        # save values at the end of each forward iteration
        with tape.at(self.latch):
            frame = tape.gep(self._frames, [tape.mul(self.turn, self._size)], inbounds=True)
            at = 0
            for value, after in self._saved:
                tape.store(value, tape.word(frame, at, value.type), align=8)
                at = after
        tape.position_at_end(end)
        tape.given_back(frames)

    def brought(self, value: Any) -> Any:
        """Reserve words of the frame for a forward value; return the value that the reverse iteration loads."""
        at = self._saved[-1][1] if self._saved else 0
        self._saved.append((value, at + (value.type.count if isinstance(value.type, ir.VectorType) else 1)))
        with self.tape.at(self.entry):
            return self.tape.load(self.tape.word(self._frame, at, value.type), align=8)


class _Taken(Slots):
    """Array in straight-line code; each element is loaded once, kept in a register and stored at the end."""

    def __init__(self, builder: Any, array: Array) -> None:
        super().__init__(builder, array)
        self.held: dict[tuple[int, int], Value] = {}
        self.changed: dict[tuple[int, int], None] = {}

    def get(self, k: int, count: int, tangents: int) -> Value:
        """Return element k of `count` lanes, loaded on first use."""
        if (k, count) not in self.held:
            self.held[k, count] = super().get(k, count, tangents)
        return self.held[k, count]

    def put(self, k: int, value: Value, count: int, tangents: int) -> None:
        """Set element k of `count` lanes in its register; `close` stores it in the array."""
        self.held[k, count], self.changed[k, count] = value, None

    def close(self) -> None:
        """Store the changed elements in the array."""
        for k, count in self.changed:
            super().put(k, self.held[k, count], count, 0)


class _Held(Tracer):
    """Tracer of straight-line code that keeps array elements in registers (`_Taken`), for fewer loads and stores."""

    def __init__(self, writer: Any, lane: tuple[int, ...]) -> None:
        super().__init__(writer, lane)
        self.arrays: list[_Taken] = []
        self._begin = len(self.builder.region.items)

    def slots(self, array: Array) -> Slots:
        """Return an array as `_Taken`."""
        self.arrays.append(_Taken(self.builder, array))
        return self.arrays[-1]

    def close(self) -> None:
        """Store changed elements, and move the loads to the beginning of the recorded code.

        Because the loads come first, their cotangents are added to memory at the end of the reverse code.
        """
        items = self.builder.region.items
        # loads first (their pull has no parent), all other nodes in their order
        items[self._begin :] = sorted(
            items[self._begin :], key=lambda item: not item.pulls or item.pulls[0].parent is not None
        )
        for array in self.arrays:
            array.close()


class Pulled(Straight):
    """The vector-Jacobian product (reverse mode) of a kernel or of straight-line code, callable in kernels."""

    def __init__(self, function: Any, names: tuple[str, ...], scratch: tuple[str, ...]) -> None:
        """names: names of arguments with cotangents. scratch: names of arguments that are working memory."""
        super().__init__(function)
        self._bars, self._scratch = names, scratch
        self.traits = (*names, "scratch", *scratch)
        self.__name__ += "_pulled"

    def written(self, writer: Any, items: list[Any]) -> None:
        """Emit the forward pass and reverse sweep in the calling kernel; nothing is returned.

        items: the function's arguments, then the cotangents of each differentiated argument (None if it is constant).
        """
        count = len(self.names)
        if len(items) != count + len(self._bars):
            raise Refused(f"{self.__name__}() takes {count} arguments and cotangents of {', '.join(self._bars)}")
        bars, wide = dict(zip(self._bars, items[count:], strict=True)), dict[Any, Names]()
        block, blocks, length = writer.b.block, len(writer.code.blocks), len(writer.b.block.instructions)
        room = writer.module.room_of(writer.code)
        # repeat with wider stack slots until all fit, removing the instructions of the attempt
        while True:
            try:
                self._write(writer, Tape(writer, wide), items[:count], bars)
                return
            except Widen:
                del writer.code.blocks[blocks:], block.instructions[length:]
                block.terminator = None
                writer.b.position_at_end(block)
                # stack memory of the attempt does not count
                writer.module.reset_room(writer.code, room)

    def _write(self, writer: Any, tape: Tape, items: list[Any], bars: dict[str, Any]) -> None:
        """Emit the function by a tape, with cotangents beside its arguments, then the reverse sweep."""
        given = []
        for name, item in zip(self.names, items, strict=True):
            item = rebuilt(item, iter(leaves(item)), tape)
            if bars.get(name) is not None or name in self._scratch:
                item = _paired(tape, item, bars.get(name))
            given.append(item)
        tape.begin()
        root, function = Backward(writer, tape, None), self.function
        if isinstance(function, Kernel) or hasattr(function, "choice"):
            writer.module.call(root, function, given, {})
        else:
            Straight(function).written(root, given)
        tape.finish()
        writer.b.position_at_end(tape.block)


def _paired(tape: Tape, item: Any, bar: Any) -> Any:
    """Return an array, or a named tuple of arrays, with its cotangents in `bar`; None for scratch memory."""
    if isinstance(item, Array):
        return Array(tape.argument(item, bar), item.shape, item.letter, item.fixed)
    if isinstance(item, Record):
        pairs = zip(item.values, bar.values, strict=True)
        return Record(item.instance_class, [_paired(tape, x, y) for x, y in pairs])
    raise Refused("cotangents are of arrays and of named tuples of arrays")


def vjp_of(function: Any, names: tuple[str, ...], scratch: tuple[str, ...] = ()) -> Any:
    """Return the vector-Jacobian product of a kernel, with the kernel's arguments, then cotangents for each of `names`.

    names: differentiated arguments: arrays, or named tuples of arrays. The call overwrites the cotangents of elements
    that the function writes. After the call the cotangents are 0 or, if the old content was read too, the cotangent of
    the old content. For elements that are only read, contributions are added to their cotangents. The arrays of `names`
    stay unchanged. None in place of cotangents: the argument is constant. scratch: names of arguments that are working
    memory, whose content matters neither before nor after. If compilation is disabled, the function is returned.
    """
    return function if UNCOMPILED else Pulled(function, names, scratch)
