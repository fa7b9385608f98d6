"""The one decorator of every compiled function."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from types import FunctionType
from typing import Any, ClassVar

from .kinds import Refused


def _mode() -> str:
    """Whether kernels are compiled, or run by Python ("python"), slowly, for a debugger."""
    chosen = os.environ.get("FLEXARM_COMPILER", "")
    if chosen not in ("", "llvm", "python"):
        raise ValueError(f"FLEXARM_COMPILER = {chosen!r}: must be 'llvm' or 'python', or not set (llvm)")
    if not chosen and os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        warnings.warn("NUMBA_DISABLE_JIT: is FLEXARM_COMPILER=python now", FutureWarning, stacklevel=2)
        return "python"
    return chosen or "llvm"


MODE = _mode()
UNCOMPILED = MODE == "python"


class Kernel:
    """A compiled function: of Python's numbers, of NumPy's arrays, of named tuples of these; see the compiler's page.

    function: the Python function. attributes: of the function in LLVM. often: see `hot`. superword: likewise.
    """

    run: ClassVar[Callable[[Kernel, Sequence[Any]], Any]]  # `entry.call`
    __name__: str
    __qualname__: str

    def __init__(
        self, function: Callable[..., Any], attributes: Sequence[str] = (), often: bool = False, superword: bool = False
    ) -> None:
        if not isinstance(function, FunctionType):
            raise Refused(f"@kernel above {function!r}: a kernel is made of a function of Python's (def)")
        functools.update_wrapper(self, function)
        self.function, self.attributes, self.often = function, tuple(attributes), often
        self.superword = superword
        self.forms: dict[Any, Any] = {}

    def __call__(self, *items: Any, **named: Any) -> Any:
        if _by_python.get():
            return self.function(*items, **named)
        return Kernel.run(self, self.complete(items, named) if named else items)

    def complete(self, items: Sequence[Any], named: dict[str, Any]) -> list[Any]:
        """All arguments in their order; see `completed`."""
        code = self.function.__code__
        names = code.co_varnames[: code.co_argcount]
        defaults = dict(zip(reversed(names), reversed(self.function.__defaults__ or ()), strict=False))
        return completed(self.function.__name__, names, defaults, items, named)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        return self  # no method: a kernel in a class is the same kernel

    def __reduce__(self) -> str:
        return self.__qualname__


def completed(
    word: str, names: Sequence[str], defaults: Mapping[str, Any], items: Sequence[Any], named: Mapping[str, Any]
) -> list[Any]:
    """What is given for each name, in their order. Refused: one is missing, not known, or given twice."""
    given = list(items)
    for name in names[len(given) :]:
        if name not in named and name not in defaults:
            raise Refused(f"{word}() wants {name!r}")
        given.append(named[name] if name in named else defaults[name])
    wrong = [name for name in named if name not in names[len(items) :]]
    if wrong or len(given) > len(names):
        more = f", not {wrong[0]!r}" if wrong else ""
        raise Refused(f"{word}() takes ({', '.join(names)}){more}")
    return given


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function` for what it is called with, from Python (the interpreter's lock released) and from kernels.

    IEEE numbers and no contraction: a lane of a batch and a single arm must agree to the last bit. Division by zero
    gives an infinity, never an exception, so that a failing arm is a value to be tested and not a crash.
    """
    return function if UNCOMPILED else Kernel(function)


_by_python = ContextVar("_by_python", default=False)
"""Whether kernels that Python calls are run by Python at this moment, in this thread."""


def uncompiled(function: Any) -> Any:
    """A kernel, and all that it calls, run by Python: for what is called once, and for what returns arrays."""
    if not isinstance(function, Kernel):
        return function

    def run(*items: Any) -> Any:
        before = _by_python.set(True)
        try:
            return function.function(*items)
        finally:
            _by_python.reset(before)

    return run


def inlined(function: Callable[..., Any]) -> Any:
    """A kernel that is always written into the kernels that call it: a phase with so many arrays at hand that passing
    them would cost more than what is saved by having its code once."""
    return function if UNCOMPILED else Kernel(function, ["alwaysinline"])


def hot(function: Callable[..., Any]) -> Any:
    """A kernel that Python calls again and again: its loops are unrolled, which takes longer to compile. Loops whose
    length is found as they run are written out once in other programs, and eight times in one of these."""
    return function if UNCOMPILED else Kernel(function, often=True)


def superword(function: Callable[..., Any]) -> Any:
    """A kernel that does the same to many numbers of one arm, as elimination does to a row: where it is large, LLVM
    looks for them and treats several at once (superword-level parallelism). The bits stay. It looks through no other
    large function of the program: that takes long, and gains nothing where there are no such rows."""
    return function if UNCOMPILED else Kernel(function, superword=True)


def apart(function: Callable[..., Any]) -> Any:
    """A kernel that is never written into the one that calls it: one that is large and seldom called. Machine code of
    one very large function takes longer to make than that of several."""
    return function if UNCOMPILED else Kernel(function, ["noinline"])
