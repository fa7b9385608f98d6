"""The one decorator of every compiled function, and the guard against a stale cache.

Numba keeps compiled code on disk beside the source, stamped with the date of the one file that holds the
function: an edit in a *called* file would go unseen. Here the stamp is a hash over all kernel sources.
"""

from __future__ import annotations

import glob
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


_PARTS = ("_source_stamp", "_load_index", "_save_index", "_save_data", "_dump", "_data_name_pattern", "_cache_path")
"""What Numba's index of compiled forms consists of, as far as it is touched here."""


def _tolerant(load_index: Callable[[], Any]) -> Callable[[], Any]:
    """An index that older sources left may name types that are no more: it then counts as empty."""

    def load() -> Any:
        try:
            return load_index()
        except Exception:
            return {}

    return load


def _told_apart(index: Any) -> Callable[[Any, Any], None]:
    """`save` of a cache in which each compiled form has a file of its own, written before the index names it.

    Numba numbers the files. Two processes that compile at once, or one that started before the sources were edited,
    then write different code to one file, and the index leads to the wrong one: a crash, or wrong numbers.
    """

    def save(key: Any, data: Any) -> None:
        told = repr(index._source_stamp).encode() + index._dump(key)
        name = index._data_name_pattern.replace("{number:d}", hashlib.sha256(told).hexdigest()[:24])
        index._save_data(name, data)
        forms = index._load_index()
        if not forms:  # none yet, or those of other sources
            base = index._data_name_pattern.replace("{number:d}.nbc", "")
            for path in Path(index._cache_path).glob(glob.escape(base) + "*.nbc"):
                if path.name != name:
                    path.unlink(missing_ok=True)
        forms[key] = name
        index._save_index(forms)

    return save


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
    if all(hasattr(index, name) for name in _PARTS):
        index._source_stamp = source_hash()
        index._load_index = _tolerant(index._load_index)
        index.save = _told_apart(index)
    return compiled
