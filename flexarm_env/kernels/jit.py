"""The one decorator of every compiled function, and the guard against a stale cache.

Numba keeps compiled code on disk beside the source and looks only at the file that holds the entry
point: an edit in a *called* file would go unseen. The guard hashes all kernel sources and, where the
hash differs from the one stored with the cache, removes that cache before anything is loaded from it.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

_STAMP = "flexarm_kernels.sha256"


@cache
def source_hash() -> str:
    """SHA-256 (hex) over the kernel sources and Numba's version; changes whenever any of them does."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _drop_stale(folder: Path) -> None:
    stamp = folder / _STAMP
    with contextlib.suppress(OSError):  # a read-only install simply keeps no cache
        if stamp.exists() and stamp.read_text() == source_hash():
            return
        folder.mkdir(parents=True, exist_ok=True)
        for pattern in ("*.nbi", "*.nbc"):
            for stale in folder.glob(pattern):
                stale.unlink(missing_ok=True)
        stamp.write_text(source_hash())


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """The folder that holds the compiled form of `function`, or None where compilation is disabled."""
    found = getattr(getattr(function, "_cache", None), "cache_path", None)
    return None if found is None else Path(found)


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` without Python objects, releasing the GIL, cached on disk, IEEE semantics kept.

    No fastmath: a lane of a batch and a single arm must agree to the last bit. Division by zero gives an
    infinity, never an exception, so that a failing arm is a value to be tested and not a crash.
    """
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    folder = cache_folder(compiled)
    if folder is not None:
        _drop_stale(folder)
    return compiled
