"""Functions that are chosen when a kernel is compiled, by the class of an argument."""

import sys
from collections.abc import Callable, Sequence
from inspect import Parameter, Signature
from typing import Any

POSITIONAL = Parameter.POSITIONAL_ONLY

FOREIGN: dict[str, str] = {}
"""Choices that others than the package have registered: a program may be made of them."""


def nothing(*_: Any) -> None:
    """What a class has of its family where there is nothing to be done, or known: None."""


class _OfPart:
    """A family's function for a class whose part has it."""

    def __init__(self, function: Any, part: str) -> None:
        self.function, self.part = function, part

    def __call__(self, *args: Any) -> Any:
        return self.function(*self._inner(args, getattr))

    def written(self, writer: Any, items: list[Any]) -> Any:
        """The call in a kernel."""
        return writer.module.call(writer, self.function, self._inner(items, writer.field), {})

    def _inner(self, args: Sequence[Any], field: Callable[[Any, str], Any]) -> list[Any]:
        return [field(x, self.part) if k == self.function.place else x for k, x in enumerate(args)]


class Family:
    """Kernels of the same names for several classes of named tuples, told apart by the class of one argument.

    Compiled, the choice is made where the call is written out.

    `family.register(Class, kernel, ..., name=kernel)` binds a class's kernels, by their own names or others;
    `family.delegate(Class, part, function, ...)` gives it those of the class that a part of it has;
    `family.function(name, arguments)` is what other kernels (and Python) call.
    """

    def __init__(self, argument: str, **defaults: Callable[..., Any]) -> None:
        self.argument, self.defaults = argument, defaults
        self.members: dict[type, dict[str, Callable[..., Any]]] = {}

    def register(self, kind: type, *named: Callable[..., Any], **functions: Callable[..., Any]) -> None:
        """Bind the kernels of a class, or more of them."""
        functions = {function.__name__: function for function in named} | functions
        self.members[kind] = {**self.defaults, **self.members.get(kind, {}), **functions}
        for name, function in functions.items():
            if {kind.__module__.split(".")[0], function.__module__.split(".")[0]} != {__name__.split(".")[0]}:
                choice = f"{kind.__module__}.{kind.__qualname__}.{name}"
                FOREIGN[choice] = f"{function.__module__}.{getattr(function, '__qualname__', function.__name__)}"

    def delegate(self, kind: type, part: str, *functions: Any) -> None:
        """Of a class these functions of the family are those of a part of it, a field that holds a member's class."""
        self.register(kind)
        self.members[kind].update({function.__name__: _OfPart(function, part) for function in functions})

    def function(self, name: str, arguments: str) -> Callable[..., Any]:
        """A function that calls the one registered under `name` for the class of the telling argument."""
        names = [word.strip() for word in arguments.split(",")]
        place = names.index(self.argument)

        def choice(*args: Any) -> Any:
            return self.members[getattr(args[place], "instance_class", type(args[place]))][name]

        def function(*args: Any) -> Any:
            return choice(*args)(*args)

        function.choice, function.place = choice, place  # type: ignore[attr-defined]
        function.__name__ = function.__qualname__ = name
        function.__signature__ = Signature([Parameter(word, POSITIONAL) for word in names])  # type: ignore[attr-defined]
        function.__module__ = sys._getframe(1).f_globals["__name__"]
        return function
