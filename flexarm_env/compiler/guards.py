"""Guards of the reverse sweep: masks that keep a zero cotangent from becoming NaN in a branch that was not chosen.

In the reverse sweep the operand that a select did not choose gets the cotangent 0, and 0 times an infinite slope is
NaN. The guard therefore selects the cotangents that leave the part of the graph used only by that operand: they stay
unchanged if the operand was chosen, and become 0 otherwise. In forward mode guards are not needed, because the select
itself selects between tangents.

A node's *path* lists the conditions under which its cotangent matters. A condition has one of two kinds: one operand of
a select was chosen (`Side`), or the cotangent of a node is not 0 (`Live`). A `Live` guard is needed for a value that
several selects use, for a value used within a branch, and for a value in memory that a select reads.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

Path = tuple[Any, ...]

ROUNDS = 8
"""Largest number of passes over all nodes to find the arrays that are read under a guard."""

_ELSEWHERE = object()
"""First entry of the path of a use that is guarded in another region or through memory."""


class Side:
    """Guard that holds where one operand of a select was chosen.

    test: condition of the select (LLVM i1). first: True if the guard is for the select's first operand.
    """

    steep_alone = False

    def __init__(self, test: Any, first: bool) -> None:
        self.test, self.first = test, first

    def masked(self, tape: Any, value: Any, zero: Any) -> Any:
        """Write a select in the reverse sweep: `value` where this operand was chosen, otherwise `zero`."""
        test = tape.back(self.test)
        return tape.select(test, value, zero) if self.first else tape.select(test, zero, value)


class Live:
    """Guard that holds where a node's cotangent is not 0.

    test: LLVM i1 that is true if the cotangent is not 0; it is written as soon as the cotangent is known.

    steep_alone: True if only quotients and roots need the guard, but not products.
    """

    test: Any = None
    steep_alone = False

    def masked(self, tape: Any, value: Any, zero: Any) -> Any:
        """Write a select: `value` where the node's cotangent is not 0, otherwise `zero`."""
        return tape.select(self.test, value, zero)


class Guards:
    """Paths (conditions) of all nodes of a `Tape`, and the guards that the reverse sweep needs.

    paths: dict from the id of a node to the guards on its path.
    used: set of the guards on paths of nodes whose pullback may turn 0 into NaN. A guard is needed only in front of
    such a pullback.
    """

    def __init__(self, nodes: Iterable[Any], names: set[int]) -> None:
        """Compute the paths and the needed guards, from the last node to the first. nodes: all nodes in program
        order."""
        self._nodes, self._names = list(nodes)[::-1], names
        self._sides: dict[tuple[int, bool], Side] = {}
        self._lives: dict[int, Live] = {}
        # users of each node with the edge to it
        self._users: dict[int, list[tuple[Any, Any]]] = {}
        for node in self._nodes:
            for pull in node.pulls:
                if pull.parent is not None:
                    self._users.setdefault(id(pull.parent), []).append((node, pull))
        # fixed point: a load under a guard makes the stores to its array guarded uses as well
        self._read: set[int] = set()
        for _ in range(ROUNDS):
            self.paths: dict[int, Path] = {}
            for node in self._nodes:
                self.paths[id(node)] = self._path(node)
            read = {node.base for node in self._nodes if node.base is not None and self._is_guarded(node)}
            if read == self._read:
                break
            self._read = read
        # a guard is needed on the path of a risky node
        self.used = {
            guard
            for node in self._nodes
            for guard in self.paths[id(node)]
            if node.risky and (node.steep or not guard.steep_alone)
        }

    def _is_guarded(self, load: Any) -> bool:
        """Return whether a load may get the cotangent 0 because a select or a branch did not choose the loaded
        value."""
        return bool(self.paths[id(load)]) or (load.base in self._names and load.region.is_within_branch())

    def side(self, node: Any, pull: Any) -> Path:
        """Return the guard that a select node requires for its operand, as a tuple; () if `node` is no select.

        node: the node of the select. pull: edge from the node to the operand.
        """
        if pull.first is None:
            return ()
        return (self._sides.setdefault((id(node.test), pull.first), Side(node.test, pull.first)),)

    def _path(self, node: Any) -> Path:
        """Return a node's path: the guards that all of its uses share from the beginning.

        If the paths of the uses differ, a `Live` guard of the node itself is appended. The path of a node that is not
        used is ().
        """
        uses: list[Path] = []
        for user, pull in self._users.get(id(node), ()):
            path = (*self.paths[id(user)], *self.side(user, pull))
            # use in another region, across lanes or through memory: guarded by conditions not known here
            if user.region is not node.region:
                path = (_ELSEWHERE, user) if path or user.region.is_within_branch(node.region) else ()
            elif pull.gathers and path:
                path = (_ELSEWHERE, user)
            uses.append(path)
        uses += [(_ELSEWHERE, base) for base in node.stored]
        # common beginning of all paths
        shared = () if not uses or uses[0][:1] == (_ELSEWHERE,) else _common(uses)
        if not uses or any(path == shared for path in uses):
            return shared
        # paths differ: test at run time whether the cotangent is 0
        live = self._lives.setdefault(id(node), Live())
        live.steep_alone = not any(base in self._read or base in self._names for base in node.stored)
        live.steep_alone &= all(path[:1] == (_ELSEWHERE,) and isinstance(path[1], int) for path in uses)
        return (*shared, live)

    def live(self, node: Any) -> Live | None:
        """Return the `Live` guard of a node if one is needed, otherwise None."""
        found = self._lives.get(id(node))
        return found if found in self.used and found in self.paths[id(node)] else None

    def left(self, node: Any, parent: Any) -> list[Any]:
        """Return the needed guards of a node's path that are not on the path of the node's operand `parent`.

        If parent is None, all needed guards on the node's path are returned.
        """
        path: Path = self.paths[id(node)]
        if parent is not None and parent.region is node.region:
            path = path[len(_common([path, self.paths[id(parent)]])) :]
        return [guard for guard in path if guard in self.used]


def _common(paths: list[Path]) -> Path:
    """Return the longest common beginning of paths, compared by identity."""
    shared = paths[0]
    for path in paths[1:]:
        k = 0
        while k < min(len(shared), len(path)) and shared[k] is path[k]:
            k += 1
        shared = shared[:k]
    return shared
