"""Operators of named tuples: `a + b`, `R @ a`, `-a`, `R.T` call the methods and properties of their classes.

A method is a kernel without a decorator: a Python function of the class body. The compiler reads the method for an
operator or a property in a kernel. Python calls the same function in uncompiled mode and in traced code.
"""

from __future__ import annotations

from functools import cache
from types import FunctionType
from typing import Any

from .decorator import Kernel
from .kinds import Record, Refused, Stored, told

NAMES = {
    "Add": "add", "Sub": "sub", "Mult": "mul", "Div": "truediv", "FloorDiv": "floordiv", "Mod": "mod", "Pow": "pow",
    "MatMult": "matmul", "LShift": "lshift", "RShift": "rshift", "BitAnd": "and", "BitOr": "or", "BitXor": "xor",
}  # fmt: skip
"""Method name without prefix and underscores for each AST operator class: "add" for `__add__` and `__radd__`."""


@cache
def method(function: Any) -> Kernel:
    """Return the `Kernel` that is compiled from a method's Python function."""
    return Kernel(function)


def methods(cls: Any) -> list[tuple[str, Any]]:
    """Return a dict of the operators and properties that a named tuple class defines: name and Python function."""
    words = [f"__{side}{name}__" for name in NAMES.values() for side in ("", "r")]
    found = [(word, getattr(cls, word, None)) for word in (*words, "__neg__")]
    properties = [(word, item.fget) for word in dir(cls) if isinstance(item := getattr(cls, word), property)]
    return [(word, item) for word, item in (*found, *properties) if isinstance(item, FunctionType)]


def has_operators(cls: Any) -> bool:
    """Return whether a named tuple class defines an operator or a property of its own."""
    return bool(methods(cls))


def _of_class(item: Any, word: str) -> Any:
    """Return the Python function of a method of an item's named tuple class; None if the class does not define it."""
    found = getattr(item.instance_class, word, None) if isinstance(item, Record | Stored) else None
    return found if isinstance(found, FunctionType) else None


def binary(writer: Any, op: str, x: Any, y: Any) -> Any:
    """Emit x op y for a named tuple x or y: a call of x's method or, if x has none, of y's reflected method.

    Raises a compile error (`Refused`) if neither method exists.
    """
    own = _of_class(x, f"__{NAMES[op]}__")
    if own is not None:
        return writer.module.call(writer, method(own), [x, y], {})
    reflected = _of_class(y, f"__r{NAMES[op]}__")
    if reflected is None:
        item = x if isinstance(x, Record | Stored) else y
        raise Refused(f"{told(x)} and {told(y)}: {item.instance_class.__name__} has no operator for both")
    return writer.module.call(writer, method(reflected), [y, x], {})


def negative(writer: Any, x: Any) -> Any:
    """Emit -x of a named tuple. Raises a compile error (`Refused`) if the class has no `__neg__`."""
    found = _of_class(x, "__neg__")
    if found is None:
        raise Refused(f"{told(x)} has no minus")
    return writer.module.call(writer, method(found), [x], {})
