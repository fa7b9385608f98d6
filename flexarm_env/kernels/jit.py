"""The one decorator of every compiled function, and the guard against a stale cache.

Numba keeps compiled code on disk beside the source, stamped with the date of the one file that holds the
function: an edit in a *called* file would go unseen. Here the stamp is a hash over all kernel sources.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

from .parts import KernelDispatcher

OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


@cache
def source_hash() -> str:
    """SHA-256 (hex) over the sources that compiled code is made of, and Numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    folder = Path(__file__).parent
    for path in (folder.parent / "model.py", *sorted(folder.glob("*.py"))):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """The folder that holds the compiled form of `function`, or None where compilation is disabled."""
    found = getattr(getattr(function, "_cache", None), "cache_path", None)
    return None if found is None else Path(found)


def _tolerant(load_index: Callable[[], Any]) -> Callable[[], Any]:
    """An index that older sources left may name types that are no more: it then counts as empty."""

    def load() -> Any:
        try:
            return load_index()
        except Exception:
            return {}

    return load


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` without Python objects, releasing the GIL, cached on disk, IEEE semantics kept.

    No fastmath: a lane of a batch and a single arm must agree to the last bit. Division by zero gives an
    infinity, never an exception, so that a failing arm is a value to be tested and not a crash.
    """
    if numba.config.DISABLE_JIT:
        return function
    compiled: Any = KernelDispatcher(function, targetoptions=OPTIONS)
    compiled.enable_caching()
    index: Any = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if hasattr(index, "_source_stamp") and hasattr(index, "_load_index"):
        index._source_stamp = source_hash()
        index._load_index = _tolerant(index._load_index)
    return compiled
