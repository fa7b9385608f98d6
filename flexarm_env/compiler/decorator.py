"""The one decorator of every compiled function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from .whole import KernelDispatcher

OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "forceinline": False}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` without Python objects, releasing the GIL, kept on disk, IEEE semantics kept.

    No fastmath: a lane of a batch and a single arm must agree to the last bit. Division by zero gives an
    infinity, never an exception, so that a failing arm is a value to be tested and not a crash.
    """
    if numba.config.DISABLE_JIT:
        return function
    compiled: Any = KernelDispatcher(function, targetoptions=OPTIONS)
    compiled.enable_caching()
    return compiled  # type: ignore[no-any-return]


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that is always written into the kernels that call it: a phase with so many arrays at hand that passing
    them would cost more than what is saved by having its code once."""
    if numba.config.DISABLE_JIT:
        return function
    compiled: Any = KernelDispatcher(function, targetoptions={**OPTIONS, "forceinline": True})
    return compiled  # type: ignore[no-any-return]
