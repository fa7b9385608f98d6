"""Loops of kernels: limits of `range`, and targets of `break` and `continue`."""

from __future__ import annotations

import ast
from typing import Any

from .arithmetic import known
from .kinds import Refused
from .merging import Names


def limits_of(node: ast.For, limits: list[Any], keywords: bool) -> tuple[str, Any, Any, Any]:
    """Return (counter name, start, stop, step) of a range loop.

    Raises a compile error (`Refused`) for tuple targets, a wrong number of arguments, or step 0.
    """
    if not isinstance(node.target, ast.Name):
        raise Refused("a loop over a range counts by one name")
    if not 1 <= len(limits) <= 3 or keywords:
        raise Refused("range takes one to three numbers")
    start, stop, step = (0, limits[0], 1) if len(limits) == 1 else (*limits, 1) if len(limits) == 2 else limits
    if known(step) and step == 0:
        raise Refused("range() by 0")
    return node.target.id, start, stop, step


class Loop:
    """Targets of `continue` and `break` in a loop, with the kernel's names and their values at each jump to a target.

    nxt: basic block to which `continue` jumps.
    end: basic block to which `break` jumps.
    nexts: for each jump to nxt, a dict from the kernel's names to their items (values during compilation) at the jump.
    ends: for each jump to end, a dict from the kernel's names to their items at the jump.
    """

    def __init__(self, nxt: Any, end: Any) -> None:
        """Make the targets; no path leads to a target yet."""
        self.nxt, self.end = nxt, end
        self.nexts: list[Names] = []
        self.ends: list[Names] = []
