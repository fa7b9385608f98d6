"""Functions that are chosen when a kernel is compiled: by the class of an argument, or by what kind of value it is.

Whole, they are typed and lowered as a direct call of the chosen kernel; plain, they are overloads, each of which is one
more library to compile.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from numba import config, types
from numba.extending import overload

from .decorator import OPTIONS, kernel
from .private import MODE

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
        """Bind the kernels of a class, or more of them."""
        self.members[kind] = {**self.defaults, **self.members.get(kind, {}), **functions}

    def function(self, name: str, arguments: str) -> Callable[..., Any]:
        """A function that calls the one registered under `name` for the class of the telling argument."""
        place = _place(arguments, self.argument)

        def choice(*args: Any) -> Any:
            return self.members[getattr(args[place], "instance_class", type(args[place]))][name]

        def function(*args: Any) -> Any:
            return choice(*args)(*args)

        function.choice = choice  # type: ignore[attr-defined]  # where code is written out from symbols
        take_name(function, name, sys._getframe(1).f_globals)
        call_chosen(function, lambda kinds: self.members[kinds[place].instance_class][name])
        return function


def by_kind(argument: str, arguments: str) -> Callable[[Callable[[str], Any]], Callable[..., Any]]:
    """Decorates a choice: a function from the kind of `argument` (NONE, NUMBER, TUPLE) to the kernel to be called."""
    place = _place(arguments, argument)

    def decorate(choose: Callable[[str], Any]) -> Callable[..., Any]:
        def choice(*args: Any) -> Any:
            x = args[place]
            named = hasattr(x, "instance_class")
            return choose(NONE if x is None else TUPLE if named or isinstance(x, tuple) else NUMBER)

        def function(*args: Any) -> Any:
            made = choice(*args)
            return getattr(made, "py_func", made)(*args)  # as written: it may be asked while a kernel is compiled

        function.choice = choice  # type: ignore[attr-defined]

        def chosen(kinds: Any) -> Any:
            kind = kinds[place]
            if isinstance(kind, types.NoneType):
                return choose(NONE)
            return choose(TUPLE if isinstance(kind, types.BaseTuple) else NUMBER)

        function.__doc__ = choose.__doc__
        take_name(function, choose.__name__, sys._getframe(1).f_globals)
        call_chosen(function, chosen)
        return function

    return decorate


def _place(arguments: str, argument: str) -> int:
    return [word.strip() for word in arguments.split(",")].index(argument)


def take_name(function: Any, name: str, scope: dict[str, Any]) -> None:
    """Name and module of the caller's, where Numba looks for it."""
    function.__name__ = function.__qualname__ = name
    function.__module__ = scope["__name__"]
    scope[name] = function


def call_chosen(function: Any, chosen: Callable[[Any], Any]) -> None:
    """Have compiled code that calls `function` call what `chosen` gives for the arguments' Numba types."""
    if config.DISABLE_JIT:
        return
    if MODE == "whole":
        from .whole import lower_as_call

        lower_as_call(function, chosen)
        return

    @overload(function, jit_options=OPTIONS)
    def _typed(*kinds: Any) -> Any:
        target = chosen(kinds)

        def call(*kinds: Any) -> Any:  # Numba wants the same names here and there
            return target(*kinds)

        return call


@kernel
def _itself(n):
    return n


@kernel
def _length(n):
    return len(n)


@by_kind("n", "n")
def size(kind: str) -> Any:
    """The number that a size stands for: itself, or the length of a tuple of zeros, which is known to the compiler."""
    return _length if kind == TUPLE else _itself
