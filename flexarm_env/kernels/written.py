"""Functions whose straight-line source is written by a program: loops unrolled, recurring sums taken once.

A `Writer` collects the lines, `function` makes them a Python function, and `written_out` lets a kernel call one that is
chosen by the types of its arguments when the kernel is compiled (by the values where compilation is disabled).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from numba import types
from numba.extending import overload

from .lanes import load, sincos, splat, store

Term = tuple[float, str]
"""Factor and name."""


@dataclass
class Writer:
    """Lines of source, and the sums written so far (`sums`: terms scaled to a leading 1 -> name)."""

    lines: list[str] = field(default_factory=list)
    sums: dict[tuple[tuple[float, str], ...], str] = field(default_factory=dict)

    def let(self, name: str, expression: str) -> str:
        """name = expression"""
        self.lines.append(f"{name} = {expression}")
        return name

    def sum(self, terms: Sequence[tuple[float, str]]) -> tuple[float, str]:
        """(factor, name) with factor * name = sum of coefficient * name; ("0" for no term)."""
        kept = [(float(c), n) for c, n in terms if c != 0.0]
        if not kept:
            return 0.0, "0"
        first = kept[0][0]
        if len(kept) == 1:
            return first, kept[0][1]
        scaled = tuple((1.0 if c == first else -1.0 if c == -first else c / first, n) for c, n in kept)
        if scaled not in self.sums:
            text = scaled[0][1]
            for c, n in scaled[1:]:
                text += f" + {n}" if c == 1.0 else f" - {n}" if c == -1.0 else f" {'-+'[c > 0]} {n} * {abs(c)!r}"
            self.sums[scaled] = self.let(f"sum{len(self.sums)}", text)
        return first, self.sums[scaled]


def times(factor: float, name: str) -> str:
    """Source of factor * name."""
    if factor == 0.0:
        return ""
    return name if factor == 1.0 else f"-{name}" if factor == -1.0 else f"{name} * {factor!r}"


def scaled(name: str, weight: float) -> str:
    """Source of name times the weight of a Gauss point."""
    return name if weight == 1.0 else f"({name} * {float(weight)!r})"


def plus(*parts: str) -> str:
    """Source of the sum of sources; empty ones left out."""
    kept = [part for part in parts if part]
    return " + ".join(kept).replace("+ -", "- ") if kept else "zero"


def function(name: str, arguments: str, lines: Sequence[str], result: str) -> Callable[..., Any]:
    """The function made of the lines."""
    body = "\n".join(f"    {line}" for line in lines)
    scope: dict[str, Any] = {"load": load, "store": store, "splat": splat, "sincos": sincos}
    exec(f"def {name}({arguments}):\n{body}\n    return {result}\n", scope)  # straight-line source, made above
    made: Callable[..., Any] = scope[name]
    return made


def is_given(kind: Any) -> bool:
    """Whether an argument (its Numba type, or itself) is something else than None."""
    return not isinstance(kind, types.NoneType) and kind is not None


def written_out(name: str, arguments: str, choose: Any) -> Any:
    """A function of those arguments that `choose`s its source by their types (compiled) or values (not compiled)."""
    scope: dict[str, Any] = {"choose": choose}
    listed = arguments.split(", ")
    exec(
        f"def {name}({arguments}):\n    return choose(dict(zip({listed!r}, ({arguments}))))({arguments})\n"
        f"def _overload({arguments}):\n    return choose(dict(zip({listed!r}, ({arguments}))))\n",
        scope,
    )
    overload(scope[name], jit_options={"forceinline": True})(scope["_overload"])
    return scope[name]
