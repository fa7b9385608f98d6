"""Scratch memory of a `Tape` for saved forward values, on the stack if it is large enough, otherwise from malloc."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

from .kinds import WORD
from .symbols import DOUBLE, declared_function

ON_STACK = 32768
"""Number of 8-byte words (256 KB) of scratch memory on the stack; larger requests go to malloc."""

_BYTE = ir.IntType(8)


class Rooms(ir.IRBuilder):  # type: ignore[misc]
    """IR builder that continues at a writer's position and allocates scratch memory for the emitted code."""

    # whether a `Tape` records the instructions that are written
    recording = False

    def __init__(self, writer: Any) -> None:
        """Allocate the stack area and its fill counter in the function's entry block and count it against the limit."""
        super().__init__(writer.b.block)
        self._code, self._top = writer.code, writer.top
        writer.module.take_room(writer.code, ON_STACK)
        self._room, self._used = self.slot(ir.ArrayType(DOUBLE, ON_STACK)), self.slot(WORD)
        self._room.align = 64
        ir.IRBuilder.store(self, ir.Constant(WORD, 0), self._used)

    def slot(self, kind: Any) -> Any:
        """Allocate a stack slot of the LLVM type `kind` in the entry block, without a cotangent; return its address."""
        return ir.IRBuilder(self._top).alloca(kind)

    @contextmanager
    def at(self, block: Any, start: bool = False) -> Iterator[None]:
        """Context manager that writes code into another basic block: at its start, or at its end before a terminator.

        Instructions written within the context are not recorded. When the context ends, the builder returns to its
        previous block.

        start: True to write at the start of the block.
        """
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
        """Return the address of 8-byte word `at` of the memory `frame`, as a pointer to the LLVM type `kind`."""
        return self.bitcast(self.gep(frame, [ir.Constant(WORD, at)], inbounds=True), kind.as_pointer())

    def _function(self, name: str, kind: Any) -> Any:
        """Return the module's declaration of the external function `name`; declare it if it is missing."""
        return self.module.globals.get(name) or declared_function(self.module, name, kind)

    def taken(self, words: Any) -> Any:
        """Emit code that allocates `words` 8-byte words of scratch memory; return the LLVM value of their address.

        The words come from the stack area while it has enough free words (in multiples of 8), otherwise from malloc.
        """
        make = self._function("malloc", ir.FunctionType(_BYTE.as_pointer(), [WORD]))
        # bump allocation: new fill level, rounded up to 64 bytes
        begin = ir.IRBuilder.load(self, self._used)
        used = self.and_(self.add(self.add(begin, words), ir.Constant(WORD, 7)), ir.Constant(WORD, -8))
        here, there, after = (self._code.append_basic_block(word) for word in ("here", "there", "taken"))
        self.cbranch(self.icmp_unsigned("<=", used, ir.Constant(WORD, ON_STACK)), here, there)
        self.position_at_end(here)
        ir.IRBuilder.store(self, used, self._used)
        own = self.gep(self._room, [ir.Constant(WORD, 0), begin], inbounds=True)
        self.branch(after)
        # the stack area is full: malloc
        self.position_at_end(there)
        found = ir.IRBuilder.call(self, make, [self.mul(words, ir.Constant(WORD, 8))])
        other = self.bitcast(found, DOUBLE.as_pointer())
        self.branch(after)
        self.position_at_end(after)
        # SSA phi of the two addresses
        found = self.phi(DOUBLE.as_pointer())
        found.add_incoming(own, here)
        found.add_incoming(other, there)
        return found

    def given_back(self, room: Any) -> None:
        """Emit code that frees memory allocated by `taken`: free() for memory from malloc, nothing for stack memory."""
        free = self._function("free", ir.FunctionType(ir.VoidType(), [_BYTE.as_pointer()]))
        # offset into the stack area; unsigned, so that addresses below it count as outside
        at = self.sub(self.ptrtoint(room, WORD), self.ptrtoint(self._room, WORD))
        there, after = (self._code.append_basic_block(word) for word in ("there", "given"))
        self.cbranch(self.icmp_unsigned("<", at, ir.Constant(WORD, 8 * ON_STACK)), after, there)
        self.position_at_end(there)
        ir.IRBuilder.call(self, free, [self.bitcast(room, _BYTE.as_pointer())])
        self.branch(after)
        self.position_at_end(after)

    def copied_room(self, source: Any, words: Any) -> Any:
        """Emit code that copies `words` 8-byte words from `source` to new scratch memory; return the new address."""
        thing = _BYTE.as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [thing, thing, WORD, ir.IntType(1)])
        copy = self.taken(words)
        items = [self.bitcast(copy, thing), self.bitcast(source, thing), self.mul(words, ir.Constant(WORD, 8))]
        code = self.module.declare_intrinsic("llvm.memcpy", [thing, thing, WORD], kind)
        ir.IRBuilder.call(self, code, [*items, ir.Constant(ir.IntType(1), 0)])
        return copy
