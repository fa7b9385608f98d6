"""Rooms of words that a `Tape` keeps numbers in: on the stack while there are few, otherwise from the system."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

from .kinds import WORD
from .symbols import DOUBLE

ON_STACK = 32768
"""Words that lie on the stack."""

_BYTE = ir.IntType(8)


class Rooms(ir.IRBuilder):  # type: ignore[misc]
    """A builder that goes on where a writer's is, with rooms for the length of what it writes."""

    recording = False  # whether instructions are remembered (`tape`)

    def __init__(self, writer: Any) -> None:
        super().__init__(writer.b.block)
        self._code, self._top = writer.code, writer.top
        self._room, self._used = self.slot(ir.ArrayType(DOUBLE, ON_STACK)), self.slot(WORD)
        self._room.align = 64
        ir.IRBuilder.store(self, ir.Constant(WORD, 0), self._used)

    def slot(self, kind: Any) -> Any:
        """Room on the stack for something of a kind, without cotangents."""
        return ir.IRBuilder(self._top).alloca(kind)

    @contextmanager
    def at(self, block: Any, start: bool = False) -> Iterator[None]:
        """For a while, write at the end of a block, before it goes on, or at its start."""
        own, recording = self.block, self.recording
        self.recording = False
        if start:
            self.position_at_start(block)
        elif block.terminator is not None:
            self.position_before(block.terminator)
        else:
            self.position_at_end(block)
        yield
        self.position_at_end(own)
        self.recording = recording

    def word(self, frame: Any, at: int, kind: Any) -> Any:
        """The address of the word `at` of a frame, of what is of a kind."""
        return self.bitcast(self.gep(frame, [ir.Constant(WORD, at)], inbounds=True), kind.as_pointer())

    def _function(self, name: str, kind: Any) -> Any:
        found = self.module.globals.get(name)
        return found or ir.Function(self.module, kind, name)

    def taken(self, words: Any) -> Any:
        """Room for so many words: of what there is on the stack, or from the system."""
        make = self._function("malloc", ir.FunctionType(_BYTE.as_pointer(), [WORD]))
        begin = ir.IRBuilder.load(self, self._used)
        used = self.and_(self.add(self.add(begin, words), ir.Constant(WORD, 7)), ir.Constant(WORD, -8))
        here, there, after = (self._code.append_basic_block(word) for word in ("here", "there", "taken"))
        self.cbranch(self.icmp_unsigned("<=", used, ir.Constant(WORD, ON_STACK)), here, there)
        self.position_at_end(here)
        ir.IRBuilder.store(self, used, self._used)
        own = self.gep(self._room, [ir.Constant(WORD, 0), begin], inbounds=True)
        self.branch(after)
        self.position_at_end(there)
        found = ir.IRBuilder.call(self, make, [self.mul(words, ir.Constant(WORD, 8))])
        other = self.bitcast(found, DOUBLE.as_pointer())
        self.branch(after)
        self.position_at_end(after)
        found = self.phi(DOUBLE.as_pointer())
        found.add_incoming(own, here)
        found.add_incoming(other, there)
        return found

    def given_back(self, room: Any) -> None:
        """Room that is no longer needed."""
        free = self._function("free", ir.FunctionType(ir.VoidType(), [_BYTE.as_pointer()]))
        at = self.sub(self.ptrtoint(room, WORD), self.ptrtoint(self._room, WORD))
        there, after = (self._code.append_basic_block(word) for word in ("there", "given"))
        self.cbranch(self.icmp_unsigned("<", at, ir.Constant(WORD, 8 * ON_STACK)), after, there)
        self.position_at_end(there)
        ir.IRBuilder.call(self, free, [self.bitcast(room, _BYTE.as_pointer())])
        self.branch(after)
        self.position_at_end(after)

    def copied_room(self, source: Any, words: Any) -> Any:
        """A copy of so many words."""
        thing = _BYTE.as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [thing, thing, WORD, ir.IntType(1)])
        copy = self.taken(words)
        items = [self.bitcast(copy, thing), self.bitcast(source, thing), self.mul(words, ir.Constant(WORD, 8))]
        code = self.module.declare_intrinsic("llvm.memcpy", [thing, thing, WORD], kind)
        ir.IRBuilder.call(self, code, [*items, ir.Constant(ir.IntType(1), 0)])
        return copy
