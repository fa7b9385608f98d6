"""The front end: from the syntax tree of a kernel to LLVM's intermediate code.

A kernel is written out once for each kind of arguments that it is called with (`kinds.kind`). What is known beforehand,
None, sizes, tags, functions, is settled while it is written: of `if x is not None` one branch alone remains. Names that
get several values live in slots on the stack, which LLVM makes registers of. The language: docs, "the compiler".
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from .kinds import WORD, Refused, Stored, kind, leaves
from .merging import Names, Widen
from .statements import Writer
from .symbols import DOUBLE

DEEPEST = 20
"""How often a kernel is open at once, for different kinds of arguments."""

LARGE, LARGE_HOT = 160, 350
"""A function of one arm (no lanes in it) with more instructions than this is called, not written into those that call
it; the second number holds in a `hot` program. The bits stay. A run takes up to 9 % longer (a hot program 1 %), and the
program is made in 0.83 to 0.9 of the time (0.85). At 80, floating frames in space took 35 % longer."""

SPARED = "noimplicitfloat"
"""LLVM's attribute of functions that its superword vectoriser leaves out."""


class Module:
    """A program's intermediate code: functions by what they are given. call: see `calls`. often: see `hot`."""

    def __init__(self, name: str, call: Any, often: bool) -> None:
        self.call, self.often = call, often
        self.code = ir.Module(name)
        self.made: dict[Any, tuple[Any, Any]] = {}
        self.used: dict[Any, set[str]] = {}
        self.invariant = self.code.add_metadata([])
        self._open: list[Any] = []
        self._tables: dict[Any, Any] = {}
        self._loops = 0
        self._superword: list[Any] = []

    def function(self, kernel: Any, items: Sequence[Any]) -> tuple[Any, Any]:
        """The function of a kernel for such arguments, and what it returns."""
        key = (kernel.function, tuple(map(kind, items)))
        if key not in self.made:
            if key in self._open or sum(one[0] is kernel.function for one in self._open) > DEEPEST:
                raise Refused(f"{kernel.function.__name__} calls itself")
            self._open.append(key)
            self.made[key] = self._written(kernel, items)
            self._open.pop()
        return self.made[key]

    def _written(self, kernel: Any, items: Sequence[Any]) -> tuple[Any, Any]:
        wide: Names = {}
        types = [leaf.type for item in items for leaf in leaves(item)]
        while True:  # until every name's room is wide enough for all that it is given
            name = self.code.get_unique_name(kernel.function.__name__)
            code = ir.Function(self.code, ir.FunctionType(ir.VoidType(), types), name)
            code.linkage, code.calling_convention = "internal", "fastcc"
            promise(code.args, items)
            try:
                writer = Writer(self, code, kernel.function, wide)
                result = writer.write(items)
                break
            except Widen as needed:
                wide[needed.name] = needed.template
                del self.code.globals[name]
        for word in kernel.attributes:
            code.attributes.add(word)
        if not kernel.attributes and _is_large(code, LARGE_HOT if self.often else LARGE):
            code.attributes.add("noinline")
            if kernel.superword:
                self._superword.append(code)
        return code, result

    def spare(self) -> None:
        """Where there are large `superword` kernels, mark the other functions that are called as `SPARED`."""
        for code in self.code.functions if self._superword else ():
            if "noinline" in code.attributes and code not in self._superword:
                code.attributes.add(SPARED)

    def mark_loop(self, back: Any) -> None:
        """Say that a loop, by the branch to its head, is written out once, where its length is found as it runs."""
        if not self.often:
            self._loops += 1
            once = self.code.add_metadata(["llvm.loop.unroll.runtime.disable"])
            mark = self.code.add_metadata([once, WORD(self._loops)])
            mark.operands = (mark, once)  # LLVM knows a loop by a mark that names itself
            back.set_metadata("llvm.loop", mark)

    def table(self, values: Any) -> Any:
        """A row of constant numbers."""
        key = tuple(map(repr, values))  # 0.0 and -0.0 are equal, and not the same
        if key not in self._tables:
            element = DOUBLE if any(isinstance(x, float | np.floating) for x in values) else WORD
            kind_of = ir.ArrayType(element, len(values))
            made = ir.GlobalVariable(self.code, kind_of, f"table{len(self._tables)}")
            made.initializer = ir.Constant(kind_of, [element((float if element is DOUBLE else int)(x)) for x in values])
            made.global_constant, made.linkage = True, "internal"
            self._tables[key] = made
        return self._tables[key]


def _is_large(code: Any, most: int) -> bool:
    """Whether a function has many instructions, none of them on lanes, which would leave their registers for a call."""
    types = [one.type for block in code.blocks for one in block.instructions]
    return len(types) > most and not any(isinstance(one, ir.VectorType) for one in types)


def promise(arguments: Sequence[Any], items: Sequence[Any]) -> None:
    """What LLVM may rely on of named tuples in memory: that they are there, and that nobody writes to them."""
    at = 0
    for item in items:
        if isinstance(item, Stored) and item.layout.words:
            attributes = arguments[at].attributes
            attributes.dereferenceable, attributes.align = 8 * item.layout.words, 8
            for word in ("noalias", "nonnull"):
                attributes.add(word)
        at += len(leaves(item))
