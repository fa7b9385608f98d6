"""Nodes and regions of a `Tape`: differentiable instructions with their pullbacks, and the code that contains them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple


class Pull(NamedTuple):
    """Edge from a node to one operand: how the node's cotangent contributes to the operand's cotangent.

    parent: the operand's `Node`. It is None if the operand is in memory; `apply` itself then increments the cotangents
        of this memory. apply:
    function that writes the instructions of the pullback: it maps the node's cotangent (LLVM value) to its contribution
    to the operand's cotangent.
    first: True or False if the node is a select and the operand its first or second choice; otherwise None.
    gathers: True if the pullback mixes lanes (sum of all lanes, insertion or extraction of one lane).
    """

    parent: Any
    apply: Callable[[Any], Any]
    first: bool | None = None
    gathers: bool = False


class Node:
    """A float64 LLVM value that depends on a differentiated input, with its edges to the operands.

    value: the LLVM value.
    pulls: edges to the operands that depend on a differentiated input.
    region: the `Region` of the instruction.
    test: condition (LLVM i1) of a select.
    risky: whether the pullback may turn a cotangent of 0 into NaN (0 * inf).
    steep: whether the slope may be infinite at finite operands (quotient, square root).
    base: id of the array that a load reads.
    stored: ids of the arrays in which the value is stored.
    cotangent: LLVM value of the cotangent, the sum of the contributions so far in the reverse sweep.
    """

    def __init__(
        self, value: Any, pulls: list[Pull], region: Any, test: Any = None, risky: bool = False, steep: bool = False
    ) -> None:
        """Record the value with its edges; the reverse sweep sets the cotangent later."""
        self.value, self.pulls, self.region = value, pulls, region
        self.test, self.risky, self.steep = test, risky, steep
        self.base: int | None = None
        self.stored: list[int] = []
        self.cotangent: Any = None
        # stack slot in which cotangents from other regions are summed
        self.total: Any = None


class Region:
    """A part of the code that is reversed as a unit: a function, a loop body or one side of a branch.

    items: nodes, and functions that write reverse code, in program order; the reverse sweep processes them backwards.
    kept: dict from the id of a forward value to the LLVM value that replaces the forward value in the reverse sweep.
    entry: basic block where the reverse code of the region begins, and where forward values are recomputed or reloaded.
    """

    entry: Any
    is_branch = False

    def __init__(self, tape: Any, code: Any, first: Any) -> None:
        """Open a region that begins with the basic block `first`, inside the tape's current region."""
        self.tape, self._code, self._begin = tape, code, len(code.blocks)
        self.items: list[Any] = []
        self.kept: dict[int, Any] = {}
        # the region opens now: instructions recorded from here on are its items
        self._outer, tape.region = tape.region, self
        tape.home[id(first)] = self

    def close(self) -> None:
        """Assign the basic blocks written since the region opened to the region, except blocks of inner regions."""
        for block in self._code.blocks[self._begin :]:
            self.tape.home.setdefault(id(block), self)
        self.tape.region = self._outer

    def is_within_branch(self, outer: Region | None = None) -> bool:
        """Return whether the region, or a region that contains it within `outer`, is one side of a branch.

        outer: a region that contains this region; None means the whole function.
        """
        here: Any = self
        while here is not None and here is not outer:
            if here.is_branch:
                return True
            here = here._outer
        return False

    def again(self, value: Any) -> Any:
        """Return a forward value of this region in the reverse sweep; it is recomputed if cheap, otherwise reloaded."""
        if id(value) not in self.kept:
            found = self.tape.copied(value, self.entry) if self.tape.found_again(value) else self.brought(value)
            # one copy per region: later uses in the same reverse code share it
            self.kept[id(value)] = found
        return self.kept[id(value)]

    def brought(self, value: Any) -> Any:
        """Save a forward value during the forward pass and return the value loaded again in the reverse sweep."""
        raise NotImplementedError
