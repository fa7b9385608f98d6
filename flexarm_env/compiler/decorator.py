"""The one decorator of every compiled function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from .private import MODE

OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy", "forceinline": False}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` without Python objects, releasing the GIL, kept on disk, IEEE semantics kept.

    No fastmath: a lane of a batch and a single arm must agree to the last bit. Division by zero gives an
    infinity, never an exception, so that a failing arm is a value to be tested and not a crash. Where the
    compiler is plain (see `private`), nothing is kept on disk: every process compiles anew.
    """
    if numba.config.DISABLE_JIT:
        return function
    compiled = _compiled(function, OPTIONS)
    if MODE != "plain":
        compiled.enable_caching()
    return compiled


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    if MODE == "plain":
        return numba.jit(**options)(function)
    from .whole import KernelDispatcher

    return KernelDispatcher(function, targetoptions=options | {"no_cfunc_wrapper": True})


def uncompiled(function: Any) -> Any:
    """The Python function behind a kernel, for what is called once."""
    return getattr(function, "py_func", function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that is always written into the kernels that call it: a phase with so many arrays at hand that passing
    them would cost more than what is saved by having its code once."""
    if numba.config.DISABLE_JIT:
        return function
    return _compiled(function, OPTIONS | {"forceinline": True})


def apart(function: Callable[..., Any]) -> Any:
    """A kernel that is never written into the one that calls it: one that is large and seldom called. Machine code of
    one very large function takes longer to make than that of several."""
    compiled: Any = kernel(function)
    compiled.apart = True
    return compiled
