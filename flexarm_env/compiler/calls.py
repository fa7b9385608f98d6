"""Calls in kernels of built-in functions, named tuple classes, kernels, members of families and straight-line code."""

import inspect
from collections.abc import Hashable
from typing import Any

from .decorator import Kernel, completed
from .dispatch import returns_none
from .kinds import Record, Refused, Stored, is_static, leaves, rebuilt, told
from .words import WORDS


def call(writer: Any, function: Any, items: list[Any], named: dict[str, Any]) -> Any:
    """Emit a call in a kernel and return the item of its result.

    writer: writer of the calling kernel.
    function: the called object, known at compile time.
    items: positional arguments of the call.
    named: keyword arguments of the call, by name. A built-in function emits its instructions. A named tuple class makes
    a `Record`. A kernel is called (or inlined in reverse mode). A member of a `Family` is chosen by the class of an
    argument. Straight-line code is traced into the calling kernel.
    """
    try:
        # unhashable callees are no words
        word = WORDS.get(function)
    except TypeError:
        word = None
    if word is not None:
        if named:
            raise Refused(f"{function.__name__} takes its arguments by place")
        try:
            return word(writer, *items)
        except TypeError:
            try:
                # a TypeError of the emitter itself is raised again, one of the argument count refused
                inspect.signature(word).bind(writer, *items)
            except TypeError:
                raise Refused(f"{function.__name__} takes not {len(items)} arguments") from None
            raise
    if isinstance(function, type) and issubclass(function, tuple) and hasattr(function, "_fields"):
        return _record(writer, function, items, named)
    if isinstance(function, Kernel):
        items = function.complete(items, named)
        return writer.inlined(function, items) if hasattr(writer, "inlined") else _kernel(writer, function, items)
    # straight-line code, vjp_of, parts of families: they write themselves
    if hasattr(function, "written"):
        return function.written(writer, items)
    if function is returns_none:
        return None
    if hasattr(function, "choice"):
        return call(writer, function.choice(*items), items, named)
    if function is isinstance and items[1:] == [tuple]:
        return isinstance(items[0], tuple | Record | Stored)
    # the class of a named tuple is known at compile time
    if function is isinstance and isinstance(items[0], Record | Stored) and is_static(items[1]):
        return issubclass(items[0].instance_class, items[1])
    if is_static(function) and all(map(is_static, items)) and function in (range, tuple, isinstance, hasattr):
        return function(*items)
    name = getattr(function, "__name__", told(function))
    if hasattr(function, "py_func") or hasattr(function, "targetoptions"):
        raise Refused(f"{name} is compiled by another compiler: a kernel calls kernels, so write @kernel above it")
    if callable(function):
        raise Refused(f"{name} is no kernel and no word of the language: write @kernel above it, or call it beforehand")
    raise Refused(f"{told(function)} is called")


def _record(writer: Any, function: Any, items: list[Any], named: dict[str, Any]) -> Record:
    """Make the `Record` of a named tuple class from positional arguments, keyword arguments and defaults."""
    items = completed(function.__name__, function._fields, function._field_defaults, items, named)
    return Record(function, items, writer.lane)


def _kernel(writer: Any, kernel: Kernel, items: list[Any]) -> Any:
    """Write a call of a kernel's function, specialized for the kinds of the arguments; return its result as an item."""
    items = [writer.dynamic(item) for item in items]
    for item in items:
        if is_static(item) and not isinstance(item, Hashable):
            raise Refused(f"{told(item)} for {kernel.function.__name__}(): numbers, arrays, None and tuples are given")
    code, result = writer.module.function(kernel, items)
    writer.module.calls(writer.code, code)
    b = writer.b
    # LLVM arguments are the leaves of all items; the result is a struct of leaves
    found = b.call(code, [leaf for item in items for leaf in leaves(item)], cconv="fastcc")
    parts = leaves(result)
    return rebuilt(result, iter([b.extract_value(found, k) for k in range(len(parts))]), b) if parts else result
