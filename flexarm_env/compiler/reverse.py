"""Kernels backwards: from a kernel, what pulls cotangents from all that it writes to all that it reads.

`vjp_of(function, names)` writes the function out once more, with all that it calls, where it is called, and then back:
its derivatives by all inputs at once, for a few times what it costs. What is remembered of it is told by the builder of
its instructions (`tape`); here is what loops and branches come to. The way back goes through each turn of a loop in
turn backwards; what it needs of a turn is kept in a frame of numbers as the loop goes forth, of a branch in slots.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from .arithmetic import known, whole
from .decorator import UNCOMPILED, Kernel
from .kinds import WORD, Array, Integer, Record, Refused, is_tuple, leaves, rebuilt
from .merging import Names, Widen
from .source import source_of
from .statements import Loop, Writer, limits_of
from .symbols import Value
from .tape import Region, Tape
from .trace import Slots, Straight, Tracer

FEW = 6
"""A loop of so many turns, known beforehand, is written out."""


class Backward(Writer):
    """Writes a function, and the kernels that it calls, where it is called, by a `Tape`."""

    def __init__(self, outer: Any, tape: Tape, function: Any) -> None:
        self.module, self.code, self.top, self.b = outer.module, outer.code, outer.top, tape
        self.names: Names = {}
        self.slots, self.loops, self.result, self.done = {}, [], None, False
        if function is not None:
            self.function, self.source = function, source_of(function)
            self.wide = tape.wide.setdefault(function, {})
            self.reads = self.module.used.setdefault(function, set())
            self.line = self.source.tree.lineno

    def inlined(self, kernel: Any, items: Sequence[Any]) -> Any:
        """What a call of a kernel comes to."""
        return Backward(self, self.b, kernel.function).write(items)

    def tracer(self, lane: tuple[int, ...]) -> Tracer:
        """What straight-line code is written with."""
        return _Held(self, lane)

    def room(self, kind_of: Any, align: int | None = None) -> Any:
        """Room on the stack, and for cotangents of what is there."""
        place = super().room(kind_of, align)
        if isinstance(kind_of, ir.DoubleType | ir.VectorType | ir.ArrayType):
            self.b.paired(place, super().room(kind_of, align), own=True)
        return place

    def write(self, items: Sequence[Any]) -> Any:
        """The function's code for arguments, where the builder is; what it returns."""
        try:
            for name, item in zip([a.arg for a in self.source.tree.args.args], items, strict=True):
                self.bind(name, item)
            self.block(self.source.tree.body)
        except Widen as needed:
            if needed.name:
                self.wide[needed.name], needed.name = needed.template, ""
            raise
        except Refused as error:
            raise self.source.placed(error, self.line) from error.__cause__
        return self.result

    def give(self, item: Any) -> None:
        if self.loops:
            raise Refused("a return within a loop has no derivative backwards")
        if self._branched:
            self.put_in_slot("return", item)
        self.result, self.done = item, True

    _branched = 0

    def bind(self, name: str, item: Any) -> None:
        if any(isinstance(x, Array) and self.b.has_bar(x.data) for x in _parts(item)):
            self.names[name] = item  # where its cotangents are is known beforehand, or the name has no value
        else:
            super().bind(name, item)

    def block(self, statements: Sequence[ast.stmt]) -> None:
        for k, statement in enumerate(statements):
            if self.done:
                return
            if isinstance(statement, ast.If) and isinstance(statement.body[-1], ast.Return):
                self.line = statement.lineno
                self.on_If(ast.If(statement.test, statement.body, [*statement.orelse, *statements[k + 1 :]]))
                return
            super().block([statement])

    def on_While(self, node: ast.While) -> None:
        items = len(self.b.region.items)
        super().on_While(node)
        if self.b.active_since(items):
            raise Refused("a while loop of numbers has no derivative backwards: count by range")

    def on_Break(self, node: ast.Break) -> None:
        if self.loops[-1].ends is None:
            raise Refused("break has no derivative backwards")
        super().on_Break(node)

    def on_Continue(self, node: ast.Continue) -> None:
        if self.loops[-1].ends is None:
            raise Refused("continue has no derivative backwards")
        super().on_Continue(node)

    def of_IfExp(self, node: ast.IfExp) -> Any:
        found = super().of_IfExp(node)
        for leaf in leaves(found):
            if isinstance(leaf, ir.PhiInstr) and any(self.b.depends(x) for x, _ in leaf.incomings):
                raise Refused("x if t else y of numbers has no derivative backwards: select_lt chooses, or an `if`")
        return found

    def on_If(self, node: ast.If) -> None:
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
        if any(way.items for way in ways):
            outer.items.append(lambda: self._either(test, ways))
        if any(returned):
            if not all(returned):
                raise Refused("a return on one way alone has no derivative backwards")
            self.done = True
            if not self._branched:
                self.result = self.read("return")

    def _either(self, test: Any, ways: Sequence[_Way]) -> None:
        """A branch backwards."""
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
        name, start, stop, step = limits_of(node, limits, keywords)
        if not known(step):
            raise Refused("a loop by a step that is not known has no derivative backwards")
        if known(start) and known(stop) and len(range(start, stop, step)) <= FEW:
            for k in range(start, stop, step):
                self.assign(node.target, k)
                self.block(node.body)
            return
        b, before, outer = self.b, self.names, self.b.region
        first, span = whole(b, start), b.sub(whole(b, stop), whole(b, start))
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
        way.ends = None  # type: ignore[assignment]
        self._round(node.body, way, before)
        loop.close()
        self.meet(loop.end, [before])
        if loop.items:
            outer.items.append(loop.go_back)


def _parts(item: Any) -> list[Any]:
    """What an item is made of, tuples taken apart."""
    if isinstance(item, Record):
        return [x for part in item.values for x in _parts(part)]
    return [x for part in item for x in _parts(part)] if is_tuple(item) else [item]


class _Way(Region):
    """One side of a branch. Of its values those that are needed are kept in slots."""

    def __init__(self, tape: Tape, code: Any, block: Any, after: Any) -> None:
        super().__init__(tape, code, block)
        self._after = after

    def close(self) -> None:
        """The side is written, to where the builder is."""
        super().close()
        self._last = self.tape.block

    def brought(self, value: Any) -> Any:
        tape, slot = self.tape, self.tape.slot(value.type)
        with tape.at(self._last):
            tape.store(value, slot)
        with tape.at(self._after, start=True):
            kept = tape.load(slot)
        return tape.back(kept)


class _Turns(Region):
    """A loop. Of its values those that are needed are kept in a frame of words, one a turn."""

    def __init__(self, writer: Backward, turns: Any) -> None:
        tape, code = writer.b, writer.code
        self._writer, self._turns, self._size = writer, turns, ir.Constant(WORD, 0)
        self._saved: list[tuple[Any, int]] = []
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
        """The body is written."""
        tape = self.tape
        tape.position_at_end(self.latch)
        tape.store(tape.add(self.turn, ir.Constant(WORD, 1)), self._counter)
        self._writer.module.mark_loop(tape.branch(self._head))
        super().close()

    def go_back(self) -> None:
        """The loop backwards."""
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
        self._frame = tape.gep(frames, [tape.mul(turn, self._size)], inbounds=True)
        self.kept[id(self.turn)] = turn
        tape.sweep(self)
        self._writer.module.mark_loop(tape.branch(head))
        self._size.constant = self._saved[-1][1] if self._saved else 0
        with tape.at(self.latch):
            frame = tape.gep(self._frames, [tape.mul(self.turn, self._size)], inbounds=True)
            at = 0
            for value, after in self._saved:
                tape.store(value, tape.word(frame, at, value.type), align=8)
                at = after
        tape.position_at_end(end)
        tape.given_back(frames)

    def brought(self, value: Any) -> Any:
        at = self._saved[-1][1] if self._saved else 0
        self._saved.append((value, at + (value.type.count if isinstance(value.type, ir.VectorType) else 1)))
        with self.tape.at(self.entry):
            return self.tape.load(self.tape.word(self._frame, at, value.type), align=8)


class _Taken(Slots):
    """An array in straight-line code: each element is read once, and written at the end."""

    def __init__(self, builder: Any, array: Array) -> None:
        super().__init__(builder, array)
        self.held: dict[tuple[int, int], Value] = {}
        self.changed: dict[tuple[int, int], None] = {}

    def get(self, k: int, count: int, tangents: int) -> Value:
        if (k, count) not in self.held:
            self.held[k, count] = super().get(k, count, tangents)
        return self.held[k, count]

    def put(self, k: int, value: Value, count: int, tangents: int) -> None:
        self.held[k, count], self.changed[k, count] = value, None

    def close(self) -> None:
        """Write what has changed."""
        for k, count in self.changed:
            super().put(k, self.held[k, count], count, 0)


class _Held(Tracer):
    """Straight-line code whose arrays are `_Taken`."""

    def __init__(self, writer: Any, lane: tuple[int, ...]) -> None:
        super().__init__(writer, lane)
        self.arrays: list[_Taken] = []
        self._begin = len(self.builder.region.items)

    def slots(self, array: Array) -> Slots:
        self.arrays.append(_Taken(self.builder, array))
        return self.arrays[-1]

    def close(self) -> None:
        """Elements are read where the code begins, so that their cotangents are added to where it ends backwards."""
        items = self.builder.region.items
        items[self._begin :] = sorted(
            items[self._begin :], key=lambda item: not item.pulls or item.pulls[0][0] is not None
        )
        for array in self.arrays:
            array.close()


class Pulled(Straight):
    """A kernel, or straight-line code, backwards."""

    def __init__(self, function: Any, names: tuple[str, ...], scratch: tuple[str, ...]) -> None:
        super().__init__(function)
        self._bars, self._scratch = names, scratch
        self.__name__ += "_pulled"

    def written(self, writer: Any, items: list[Any]) -> None:
        count = len(self.names)
        if len(items) != count + len(self._bars):
            raise Refused(f"{self.__name__}() takes {count} arguments and cotangents of {', '.join(self._bars)}")
        bars, wide = dict(zip(self._bars, items[count:], strict=True)), dict[Any, Names]()
        block, blocks, length = writer.b.block, len(writer.code.blocks), len(writer.b.block.instructions)
        while True:  # until every name's room is wide enough
            try:
                self._write(writer, Tape(writer, wide), items[:count], bars)
                return
            except Widen:
                del writer.code.blocks[blocks:], block.instructions[length:]
                block.terminator = None
                writer.b.position_at_end(block)

    def _write(self, writer: Any, tape: Tape, items: list[Any], bars: dict[str, Any]) -> None:
        """There and back."""
        given = []
        for name, item in zip(self.names, items, strict=True):
            item = rebuilt(item, iter(leaves(item)), tape)
            if name in bars or name in self._scratch:
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
    """An argument with its cotangents; bar None: it has none of its own, nor a content that matters."""
    if isinstance(item, Array):
        return Array(tape.argument(item, bar), item.shape, item.letter, item.fixed)
    if isinstance(item, Record):
        pairs = zip(item.values, bar.values, strict=True)
        return Record(item.instance_class, [_paired(tape, x, y) for x, y in pairs])
    raise Refused("cotangents are of arrays and of named tuples of arrays")


def vjp_of(function: Any, names: tuple[str, ...], scratch: tuple[str, ...] = ()) -> Any:
    """A kernel that takes the function's arguments and then, for each of `names` among them, cotangents.

    names: arrays, or named tuples of arrays. Of elements that the function writes cotangents are taken, which are then
    0, or what they come to where the old content was read as well; to those that it only reads is added. The arrays
    stay as they are. scratch: arrays whose content matters neither before nor after, in which numbers are passed on.
    """
    return function if UNCOMPILED else Pulled(function, names, scratch)
