"""Calls in kernels: words of the language, named tuples, kernels, choices among kernels, straight-line code."""

import inspect
from collections.abc import Hashable
from typing import Any

from .decorator import Kernel, completed
from .dispatch import nothing
from .kinds import Record, Refused, Stored, is_static, leaves, rebuilt, told
from .words import WORDS


def call(writer: Any, function: Any, items: list[Any], named: dict[str, Any]) -> Any:
    """What a call in a kernel comes to."""
    try:
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
                inspect.signature(word).bind(writer, *items)
            except TypeError:
                raise Refused(f"{function.__name__} takes not {len(items)} arguments") from None
            raise
    if isinstance(function, type) and issubclass(function, tuple) and hasattr(function, "_fields"):
        return _record(function, items, named)
    if isinstance(function, Kernel):
        items = function.complete(items, named)
        return writer.inlined(function, items) if hasattr(writer, "inlined") else _kernel(writer, function, items)
    if hasattr(function, "written"):
        return function.written(writer, items)
    if function is nothing:
        return None
    if hasattr(function, "choice"):
        return call(writer, function.choice(*items), items, named)
    if function is isinstance and items[1:] == [tuple]:
        return isinstance(items[0], tuple | Record | Stored)
    if is_static(function) and all(map(is_static, items)) and function in (range, tuple, isinstance, hasattr):
        return function(*items)
    name = getattr(function, "__name__", told(function))
    if hasattr(function, "py_func") or hasattr(function, "targetoptions"):
        raise Refused(f"{name} is compiled by another compiler: a kernel calls kernels, so write @kernel above it")
    if callable(function):
        raise Refused(f"{name} is no kernel and no word of the language: write @kernel above it, or call it beforehand")
    raise Refused(f"{told(function)} is called")


def _record(function: Any, items: list[Any], named: dict[str, Any]) -> Record:
    return Record(function, completed(function.__name__, function._fields, function._field_defaults, items, named))


def _kernel(writer: Any, kernel: Kernel, items: list[Any]) -> Any:
    items = [writer.dynamic(item) for item in items]
    for item in items:
        if is_static(item) and not isinstance(item, Hashable):
            raise Refused(f"{told(item)} for {kernel.function.__name__}(): numbers, arrays, None and tuples are given")
    code, result = writer.module.function(kernel, items)
    b = writer.b
    found = b.call(code, [leaf for item in items for leaf in leaves(item)], cconv="fastcc")
    parts = leaves(result)
    return rebuilt(result, iter([b.extract_value(found, k) for k in range(len(parts))]), b) if parts else result
