"""The decorators of compiled functions: `kernel` and its variants."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from types import FunctionType
from typing import Any, ClassVar

from .kinds import Refused
from .lane_arrays import lane_parameters
from .widening import widened


def _mode() -> str:
    """Return "llvm" where kernels are compiled or "python" where Python runs them (slowly, for a debugger).

    The mode is read from FLEXARM_COMPILER; ValueError for another word. If the variable NUMBA_DISABLE_JIT is set, the
    mode is "python", and a warning appears.
    """
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
    """Compiled function of numbers, NumPy arrays, and named tuples of numbers and arrays (docs/compiler.md).

    function: the Python function. attributes: LLVM attributes of the function. often: True if the kernel is an
    `entry_point`. superword: True if the kernel has the decorator `superword`. forms: compiled versions of the kernel,
    by the types of the arguments.
    """

    run: ClassVar[Callable[[Kernel, Sequence[Any]], Any]]  # the function `entry.call`
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
        """Call from Python: run the compiled form, or the Python function inside `uncompiled`."""
        if _by_python.get():
            return self.function(*items, **named)
        return Kernel.run(self, self.complete(items, named) if named else items)

    def complete(self, items: Sequence[Any], named: dict[str, Any]) -> list[Any]:
        """Return all arguments in the order of the signature, defaults included.

        items: positional arguments. named: keyword arguments.
        """
        code = self.function.__code__
        names = code.co_varnames[: code.co_argcount]
        # defaults belong to the last parameters
        defaults = dict(zip(reversed(names), reversed(self.function.__defaults__ or ()), strict=False))
        return completed(self.function.__name__, names, defaults, items, named)

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        return self  # no method: a kernel in a class is the same kernel

    def __reduce__(self) -> str:
        return self.__qualname__


def completed(
    word: str, names: Sequence[str], defaults: Mapping[str, Any], items: Sequence[Any], named: Mapping[str, Any]
) -> list[Any]:
    """Return a value for each parameter name in order, from positional and named arguments and defaults.

    word: name of the function for error messages. names: parameter names. defaults: default values by parameter name.
    items: positional arguments. named: keyword arguments. Raises a compile error (`Refused`) for a missing, unknown or
        duplicate argument.
    """
    given = list(items)
    for name in names[len(given) :]:
        if name not in named and name not in defaults:
            raise Refused(f"{word}() wants {name!r}")
        given.append(named[name] if name in named else defaults[name])
    # names that are unknown or already given by position
    wrong = [name for name in named if name not in names[len(items) :]]
    if wrong or len(given) > len(names):
        more = f", not {wrong[0]!r}" if wrong else ""
        raise Refused(f"{word}() takes ({', '.join(names)}){more}")
    return given


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator that makes a function a kernel: its first call with given argument types compiles it for these types.

    Python and other kernels can call a kernel. A call from Python releases the interpreter's lock.

    Arithmetic is IEEE without contraction, so that the results for a single arm and for an arm in a batch are bitwise
    equal. Division by zero gives an infinity and no exception, so that a failing arm can be detected afterwards.
    """
    return _by_python_alone(function) if UNCOMPILED else Kernel(function)


_by_python = ContextVar("_by_python", default=False)
"""True while Python, instead of compiled code, runs the kernels that this thread calls."""


def uncompiled(function: Any) -> Any:
    """Return a function that runs a kernel, and all kernels that it calls, in Python without compilation.

    Use it for kernels that are rarely called, or that return arrays.
    """
    if not isinstance(function, Kernel):
        return function

    def run(*items: Any) -> Any:
        return _run_by_python(function.function, items, {})

    return run


def _run_by_python(function: Callable[..., Any], items: Sequence[Any], named: Mapping[str, Any]) -> Any:
    """Run a kernel and all that it calls in Python, with arguments widened as machine code would (`widening`)."""
    _check_lanes(function, items, named)
    before = _by_python.set(True)
    try:
        return function(*map(widened, items), **{name: widened(item) for name, item in named.items()})
    finally:
        _by_python.reset(before)


def _check_lanes(function: Callable[..., Any], items: Sequence[Any], named: Mapping[str, Any]) -> None:
    """Raise RuntimeError for a kernel with lane arrays (`lane_arrays`) under a tag of more than one lane.

    In Python such a kernel would index single numbers instead of elements of lanes. Kernels without annotations raise
    the same error when they load an element (`lanes.load`).
    """
    if not lane_parameters(function):
        return
    code = function.__code__
    given = dict(zip(code.co_varnames[: code.co_argcount], items, strict=False)) | dict(named)
    tag = given.get("lane")
    if isinstance(tag, tuple) and len(tag) > 1:
        raise RuntimeError(f"{len(tag)} lanes: there is only one where compilation is disabled (FLEXARM_COMPILER)")


def _by_python_alone(function: Callable[..., Any]) -> Any:
    """Return the Python function of a kernel, for FLEXARM_COMPILER=python."""

    @functools.wraps(function)
    def run(*items: Any, **named: Any) -> Any:
        # called from another kernel: arguments are widened already
        if _by_python.get():
            return function(*items, **named)
        return _run_by_python(function, items, named)

    return run


def inlined(function: Callable[..., Any]) -> Any:
    """Decorator of kernels that are always inlined into their callers.

    Use it for small kernels with many array arguments, for which passing the arguments costs more than the additional
    code in each caller.
    """
    return _by_python_alone(function) if UNCOMPILED else Kernel(function, ["alwaysinline"])


def entry_point(function: Callable[..., Any]) -> Any:
    """Decorator of kernels that Python calls repeatedly: LLVM unrolls their loops, which takes longer to compile.

    Loops whose length is known only at run time are unrolled eight times; in other kernels they are not unrolled.
    """
    return _by_python_alone(function) if UNCOMPILED else Kernel(function, often=True)


def superword(function: Callable[..., Any]) -> Any:
    """Decorator of kernels that apply one operation to many numbers of one arm, as Gaussian elimination does to a row.

    LLVM then combines these operations to vector instructions (superword-level parallelism), with bitwise the same
    results. In other large kernels LLVM does not search for such operations, because the search takes long and is
    rarely successful.
    """
    return _by_python_alone(function) if UNCOMPILED else Kernel(function, superword=True)


def noinline(function: Callable[..., Any]) -> Any:
    """Decorator of large and rarely called kernels that must not be inlined.

    Several functions take less time to compile than one very large function.
    """
    return _by_python_alone(function) if UNCOMPILED else Kernel(function, ["noinline"])
