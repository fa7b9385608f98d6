"""The one decorator of every compiled function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from .private import MODE

OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy"}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` without Python objects, releasing the GIL, kept on disk, IEEE semantics kept.

    No fastmath: a lane of a batch and a single arm must agree to the last bit. Division by zero gives an
    infinity, never an exception, so that a failing arm is a value to be tested and not a crash. Where the
    compiler is plain (see `private`), nothing is kept on disk: every process compiles anew.
    """
    if numba.config.DISABLE_JIT:
        return function
    if MODE == "plain":
        return numba.jit(**OPTIONS)(function)  # type: ignore[no-any-return]
    from .whole import KernelDispatcher

    compiled: Any = KernelDispatcher(function, targetoptions=OPTIONS | {"no_cfunc_wrapper": True})
    compiled.enable_caching()
    return compiled  # type: ignore[no-any-return]
