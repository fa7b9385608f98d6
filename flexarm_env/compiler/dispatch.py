"""Functions that are chosen when a kernel is compiled: by the class of an argument, or by what kind of value it is.

They are typed and lowered as a direct call of the chosen kernel: an overload would be one more library to compile.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from numba import config, types
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import lower_builtin

from .decorator import kernel

NONE, NUMBER, TUPLE = "none", "number", "tuple"
"""Kinds of value that `by_kind` tells apart."""


class Family:
    """Kernels of the same names for several classes of named tuples, told apart by the class of one argument.

    `family.register(Class, name=kernel, ...)` binds a class's kernels; `family.function(name, arguments)` is what other
    kernels (and Python) call.
    """

    def __init__(self, argument: str, **defaults: Callable[..., Any]) -> None:
        self.argument, self.defaults = argument, defaults
        self.members: dict[type, dict[str, Callable[..., Any]]] = {}

    def register(self, kind: type, **functions: Callable[..., Any]) -> None:
        """Bind the kernels of a class."""
        self.members[kind] = {**self.defaults, **functions}

    def function(self, name: str, arguments: str) -> Callable[..., Any]:
        """A function that calls the one registered under `name` for the class of the telling argument."""
        place = _place(arguments, self.argument)

        def function(*args: Any) -> Any:
            return self.members[type(args[place])][name](*args)

        _take_name(function, name, sys._getframe(1).f_globals)
        _lower_as_call(function, lambda kinds: self.members[kinds[place].instance_class][name])
        return function


def by_kind(argument: str, arguments: str) -> Callable[[Callable[[str], Any]], Callable[..., Any]]:
    """Decorates a choice: a function from the kind of `argument` (NONE, NUMBER, TUPLE) to the kernel to be called."""
    place = _place(arguments, argument)

    def decorate(choose: Callable[[str], Any]) -> Callable[..., Any]:
        def function(*args: Any) -> Any:
            x = args[place]
            made = choose(NONE if x is None else TUPLE if isinstance(x, tuple) else NUMBER)
            return getattr(made, "py_func", made)(*args)  # as written: it may be asked while a kernel is compiled

        def chosen(kinds: Any) -> Any:
            kind = kinds[place]
            if isinstance(kind, types.NoneType):
                return choose(NONE)
            return choose(TUPLE if isinstance(kind, types.BaseTuple) else NUMBER)

        function.__doc__ = choose.__doc__
        _take_name(function, choose.__name__, sys._getframe(1).f_globals)
        _lower_as_call(function, chosen)
        return function

    return decorate


def _place(arguments: str, argument: str) -> int:
    return [word.strip() for word in arguments.split(",")].index(argument)


def _take_name(function: Any, name: str, scope: dict[str, Any]) -> None:
    """Name and module of the caller's, where Numba looks for it."""
    function.__name__ = function.__qualname__ = name
    function.__module__ = scope["__name__"]
    scope[name] = function


def _lower_as_call(function: Any, chosen: Callable[[Any], Any]) -> None:
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return

    @infer_global(function)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            return types.Dispatcher(chosen(args)).get_call_type(self.context, args, kws)

    @lower_builtin(function, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
    def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        call = context.get_function(types.Dispatcher(chosen(signature.args)), signature)
        context.add_linking_libs(getattr(call, "libs", ()))
        return call(builder, args)


@kernel
def _itself(n):  # type: ignore[no-untyped-def]
    return n


@kernel
def _length(n):  # type: ignore[no-untyped-def]
    return len(n)


@by_kind("n", "n")
def size(kind: str) -> Any:
    """The number that a size stands for: itself, or the length of a tuple of zeros, which is known to the compiler."""
    return _length if kind == TUPLE else _itself
