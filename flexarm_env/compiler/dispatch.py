"""Dispatch at compile time: the class of an argument selects the kernel that is called."""

import sys
from collections.abc import Callable, Sequence
from inspect import Parameter, Signature
from typing import Any

POSITIONAL = Parameter.POSITIONAL_ONLY

FOREIGN: dict[str, list[tuple[Any, Any]]] = {}
"""Functions registered from outside the package: lists of (family, function) pairs by class and name of the function.
"""

_PACKAGE = __name__.split(".")[0]


def returns_none(*_: Any) -> None:
    """Return None for any arguments: default of a family's function for classes without a registered kernel."""


class OfPart:
    """Function of a family for a class that delegates this function to one of its fields, `part`."""

    def __init__(self, function: Any, part: str) -> None:
        self.function, self.part, self.__module__ = function, part, function.__module__

    def __call__(self, *args: Any) -> Any:
        """Call the family's function with the field `part` in place of the named tuple that contains it."""
        return self.function(*self._inner(args, getattr))

    def written(self, writer: Any, items: list[Any]) -> Any:
        """Emit the call into the kernel that is being compiled.

        writer: writer of the kernel that is being compiled. items: arguments of the call.
        """
        return writer.module.call(writer, self.function, self._inner(items, writer.field), {})

    def _inner(self, args: Sequence[Any], field: Callable[[Any, str], Any]) -> list[Any]:
        """Return the arguments, with the dispatching argument replaced by its field `part`; field(x, name) reads a
        field.
        """
        return [field(x, self.part) if k == self.function.place else x for k, x in enumerate(args)]


class Family:
    """Functions for which each of several classes of named tuples registers a kernel.

    The class of one argument selects the kernel. In compiled code this happens at compile time and takes no time at run
    time.

    `family.register(Class, kernel, ..., name=kernel)` registers kernels of a class, under the kernel's name or under
    the keyword's name. `family.delegate(Class, part, function, ...)` registers for a class the kernels of the class of
    its field `part`. `family.function(name, arguments)` returns the function that other kernels (and Python) call.

    argument: name of the argument whose class selects the kernel.
    defaults: kernels for classes without a registered kernel.
    """

    def __init__(self, argument: str, **defaults: Callable[..., Any]) -> None:
        self.argument, self.defaults = argument, defaults
        self.members: dict[type, dict[str, Callable[..., Any]]] = {}
        self.names: set[str] = set()  # of the family's functions

    def register(self, kind: type, *named: Callable[..., Any], **functions: Callable[..., Any]) -> None:
        """Register kernels of a class; a later call adds kernels or replaces kernels of the same name.

        Raises TypeError for a name that no function of the family has, because no call would ever reach that kernel.
        """
        functions = {function.__name__: function for function in named} | functions
        unknown = sorted(functions.keys() - self.names) if self.names else []
        if unknown:
            raise TypeError(f"{unknown[0]!r} is no function of the family: these are {', '.join(sorted(self.names))}")
        self.members[kind] = {**self.defaults, **self.members.get(kind, {}), **functions}
        for name, function in functions.items():
            self._note(kind, name, function)

    def _note(self, kind: type, name: str, function: Any) -> None:
        """Record a registration in `FOREIGN` if the class or the function is defined outside the package."""
        if any(str(one.__module__).split(".")[0] != _PACKAGE for one in (kind, function)):
            # a later registration of the family replaces its earlier one
            choice = FOREIGN.setdefault(f"{kind.__module__}.{kind.__qualname__}.{name}", [])
            choice[:] = [*(one for one in choice if one[0] is not self), (self, function)]

    def delegate(self, kind: type, part: str, *functions: Any) -> None:
        """Delegate functions of a class to its field `part`: calls use the kernels registered for the class of this
        field.
        """
        self.register(kind)
        for function in functions:
            self.members[kind][function.__name__] = made = OfPart(function, part)
            self._note(kind, function.__name__, made)

    def function(self, name: str, arguments: str) -> Callable[..., Any]:
        """Return a function that calls the kernel registered under `name` for the class of the dispatching argument.

        arguments: parameter names of the returned function, separated by commas ("lane, model, w"). The returned
        function's `__module__` is the module that calls `function`.
        """
        names = [word.strip() for word in arguments.split(",")]
        place = names.index(self.argument)
        self.names.add(name)

        # instance_class: the class that a record stands for while a kernel is compiled
        def choice(*args: Any) -> Any:
            return self.members[getattr(args[place], "instance_class", type(args[place]))][name]

        def function(*args: Any) -> Any:
            return choice(*args)(*args)

        # read by the compiler, which makes the choice when it writes the call
        function.choice, function.place = choice, place  # type: ignore[attr-defined]
        function.__name__ = function.__qualname__ = name
        function.__signature__ = Signature([Parameter(word, POSITIONAL) for word in names])  # type: ignore[attr-defined]
        function.__module__ = sys._getframe(1).f_globals["__name__"]
        return function
