"""Front end of the compiler: from the AST of kernels to one LLVM module for each program.

A kernel is compiled once for each combination of argument types (`kinds.kind`) with which it is called. Items known at
compile time (None, sizes, tags, functions) are evaluated by the compiler, so that only one branch of `if x is not None`
is compiled. Names that are assigned more than once live in stack slots, which LLVM promotes to registers. The page "The
compiler" of the docs describes the language of kernels.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from .kinds import WORD, Refused, Stored, kind, leaves
from .merging import Names, Widen
from .statements import Writer
from .symbols import DOUBLE

MOST_ROOM = 2**19
"""Largest number of float64 (4 MB) that a kernel and all its callees may use on a thread's stack of 8 MB."""

DEEPEST = 20
"""Largest depth of nested specializations of one kernel. A greater depth counts as recursion, which is refused."""

LARGE, LARGE_HOT = 160, 350
"""Largest number of instructions of a function without lanes that LLVM may inline. LARGE_HOT is the limit in programs
of an `entry_point`, LARGE in all others. Results are bitwise the same as without limit. Runs take up to 9 % longer
(entry points 1 %), and compiling takes 0.83 to 0.9 of the time (entry points 0.85). At a limit of 80, floating frames
in space ran 35 % longer.
"""

SPARED = "noimplicitfloat"
"""LLVM attribute of functions that LLVM's superword (SLP) vectorizer skips."""


class Module:
    """LLVM module of one program, with one function for each kernel and combination of argument types.

    call: the function `calls.call`, which emits calls.
    often: True if the program's kernel is an `entry_point`, whose loops LLVM may unroll.
    made: dict from (function, argument kinds) to (LLVM function, template of its result).
    used: set of the global names that each Python function reads, for the cache key.
    invariant: LLVM metadata that marks loads from memory that nobody writes to.
    """

    def __init__(self, name: str, call: Any, often: bool) -> None:
        """Make an empty LLVM module with this name."""
        self.call, self.often = call, often
        self.code = ir.Module(name)
        # functions that LLVM calls on its own (memcpy) are called like declared ones (`symbols.declared_function`)
        self.code.add_named_metadata("llvm.module.flags", [ir.IntType(32)(7), "RtLibUseGOT", ir.IntType(32)(1)])
        self.made: dict[Any, tuple[Any, Any]] = {}
        self.used: dict[Any, set[str]] = {}
        self.invariant = self.code.add_metadata([])
        self._open: list[Any] = []
        self._tables: dict[Any, Any] = {}
        self._loops = 0
        self._superword: list[Any] = []
        self._rooms: dict[Any, list[int]] = {}

    def function(self, kernel: Any, items: Sequence[Any]) -> tuple[Any, Any]:
        """Return the LLVM function of a kernel for arguments of the kinds of `items`, and a template of its result."""
        key = (kernel.function, tuple(map(kind, items)))
        if key not in self.made:
            if key in self._open or sum(one[0] is kernel.function for one in self._open) > DEEPEST:
                raise Refused(f"{kernel.function.__name__} calls itself")
            self._open.append(key)
            self.made[key] = self._written(kernel, items)
            self._open.pop()
        return self.made[key]

    def _written(self, kernel: Any, items: Sequence[Any]) -> tuple[Any, Any]:
        """Write a kernel's function with the fast calling convention; return it and its result template.

        If a stack slot is too narrow for a value that is assigned to its name, the function is written again with wider
        slots.
        """
        wide: Names = {}
        types = [leaf.type for item in items for leaf in leaves(item)]
        while True:
            # the prefix keeps kernels apart from functions of the C library
            name = self.code.get_unique_name(f"kernel.{kernel.function.__name__}")
            code = ir.Function(self.code, ir.FunctionType(ir.VoidType(), types), name)
            # no other module calls it: LLVM may inline it and choose the calling convention
            code.linkage, code.calling_convention = "internal", "fastcc"
            promise(code.args, items)
            try:
                writer = Writer(self, code, kernel.function, wide)
                result = writer.write(items)
                break
            except Widen as needed:
                # discard the attempt and widen the slot
                wide[needed.name] = needed.template
                del self.code.globals[name]
                self._rooms.pop(name, None)
        for word in kernel.attributes:
            code.attributes.add(word)
        # large scalar functions are called, not inlined: shorter compile time
        if not kernel.attributes and _is_large(code, LARGE_HOT if self.often else LARGE):
            code.attributes.add("noinline")
            # large kernels marked `superword` are the ones that SLP vectorization is for
            if kernel.superword:
                self._superword.append(code)
        return code, result

    def take_room(self, code: Any, count: int) -> None:
        """Add `count` float64 numbers to the stack use of the LLVM function `code`.

        Raises a compile error (`Refused`) if the function and its callees need more than MOST_ROOM.
        """
        room = self._rooms.setdefault(code.name, [0, 0])
        self._check_room(room, room[0] + count, room[1])

    def room_of(self, code: Any) -> tuple[int, ...]:
        """Return the stack use of the LLVM function `code`, and the largest stack use of its callees so far."""
        return tuple(self._rooms.get(code.name, (0, 0)))

    def reset_room(self, code: Any, room: tuple[int, ...]) -> None:
        """Reset the stack use of the LLVM function `code` to an earlier result of `room_of`."""
        self._rooms[code.name] = list(room)

    def _check_room(self, room: list[int], own: int, below: int) -> None:
        """Store a function's own stack use and the largest of its callees; refuse a sum above MOST_ROOM."""
        room[:] = own, below
        if own + below > MOST_ROOM:
            raise Refused(
                f"{own + below} numbers on the stack, in this kernel and those that it calls: at most {MOST_ROOM}; "
                "more lie in an array that is given"
            )

    def calls(self, code: Any, called: Any) -> None:
        """Record a call: the caller's stack use includes that of the callee and of the callee's own callees."""
        room = self._rooms.setdefault(code.name, [0, 0])
        self._check_room(room, room[0], max(room[1], sum(self._rooms.get(called.name, ()))))

    def spare(self) -> None:
        """Exclude functions that are never inlined from SLP vectorization, except large `superword` kernels.

        If the module has no large `superword` kernel, no function is excluded.
        """
        for code in self.code.functions if self._superword else ():
            if "noinline" in code.attributes and code not in self._superword:
                code.attributes.add(SPARED)

    def text(self) -> str:
        """Return the module as LLVM assembly and remove the instructions of all functions.

        Instructions and blocks are Python objects that refer to each other in cycles. If the instructions are removed,
        Python frees these objects at once, faster than its garbage collector would.
        """
        found = str(self.code)
        for code in self.code.functions:
            for block in code.blocks:
                block.instructions.clear()
                block.terminator = None
        return found

    def mark_loop(self, back: Any) -> None:
        """Add metadata to a loop's back edge that stops LLVM from unrolling it by a run-time trip count.

        Programs of an `entry_point` get no such metadata, because their loops may be unrolled.
        """
        if not self.often:
            self._loops += 1
            # metadata node that LLVM reads at the loop's back edge
            once = self.code.add_metadata(["llvm.loop.unroll.runtime.disable"])
            mark = self.code.add_metadata([once, WORD(self._loops)])
            # LLVM identifies a loop by metadata whose first operand is itself
            mark.operands = (mark, once)
            back.set_metadata("llvm.loop", mark)

    def table(self, values: Any) -> Any:
        """Return a global LLVM array of known numbers: float64 if any number is a float, otherwise int64.

        Equal tables share one global array.
        """
        # by repr: 0.0 and -0.0 are equal, but not the same constant
        key = tuple(map(repr, values))
        if key not in self._tables:
            # mixed numbers become float64
            element = DOUBLE if any(isinstance(x, float | np.floating) for x in values) else WORD
            kind_of = ir.ArrayType(element, len(values))
            made = ir.GlobalVariable(self.code, kind_of, f"table{len(self._tables)}")
            made.initializer = ir.Constant(kind_of, [element((float if element is DOUBLE else int)(x)) for x in values])
            made.global_constant, made.linkage = True, "internal"
            self._tables[key] = made
        return self._tables[key]


def _is_large(code: Any, most: int) -> bool:
    """Return whether a function has more than `most` instructions and no vectors.

    Functions with lanes are left to LLVM's inliner, because a call would spill their vector registers.
    """
    types = [one.type for block in code.blocks for one in block.instructions]
    return len(types) > most and not any(isinstance(one, ir.VectorType) for one in types)


def promise(arguments: Sequence[Any], items: Sequence[Any]) -> None:
    """Set LLVM attributes of pointer arguments to named tuples: dereferenceable, aligned, noalias, nonnull.

    The attribute noalias is correct because no kernel writes to a named tuple in memory.

    arguments: arguments of the LLVM function. items: the kernel's arguments.
    """
    at = 0
    for item in items:
        # the address argument of a named tuple in memory
        if isinstance(item, Stored) and item.layout.words:
            attributes = arguments[at].attributes
            attributes.dereferenceable, attributes.align = 8 * item.layout.words, 8
            for word in ("noalias", "nonnull"):
                attributes.add(word)
        at += len(leaves(item))
