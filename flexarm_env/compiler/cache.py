"""Compiled code on disk: one file for each compiled form, that nothing but the same sources find again.

Numba stamps what it keeps with the date of the one file that holds a function, so that an edit in a *called* file goes
unseen; it numbers the files, so that two processes that compile at once write different code to one; and a file that
is damaged, a full disk or a folder that cannot be written to ends the program. Here the file's name follows from the
sources, the types and the processor; the file says itself whether it is whole; and what cannot be read is compiled
anew, what cannot be written is not kept. Should a later Numba lack what this uses of it, nothing is kept either.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import pickle
import sys
import uuid
import warnings
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
from numba.core import caching
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

COMPILED = (
    "compiler/**/*.py", "physics/**/*.py", "runtime/**/*.py", "tasks/**/*.py", "layout.py", "time_functions.py",
)  # fmt: skip
"""Sources that compiled code is made of."""

_DIGEST = hashlib.sha256().digest_size

_said = False
"""Whether this process has heard that nothing is kept."""


@cache
def source_hash() -> str:
    """SHA-256 (hex) over the sources that compiled code is made of, and Numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    package = Path(__file__).parents[1]
    for path in sorted(path for pattern in COMPILED for path in package.glob(pattern)):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _stamp(file: str) -> str:
    """`source_hash` with the source of a kernel that may lie elsewhere."""
    return hashlib.sha256(source_hash().encode() + Path(file).read_bytes()).hexdigest()


def _complain(error: Exception, folder: str | None) -> None:
    """Say once in a process that compiled code is not kept, where and why."""
    global _said
    if _said:
        return
    _said = True
    if isinstance(error, OSError):
        reason = f"({folder}: {error.strerror or error}); set NUMBA_CACHE_DIR to a writable folder that has room"
    else:
        reason = f"by Numba {numba.__version__} ({type(error).__name__}: {error}); NUMBA_CACHE_DIR does not help"
    text = f"flexarm_env: compiled code cannot be kept, every process compiles anew {reason}"
    warnings.warn(text, RuntimeWarning, stacklevel=2)


class Shelf:
    """The forms of one function, found by key. base: what their files' names begin with; stamp: of the sources.

    They are written to the first of the folders and looked for in all, so that what an administrator has compiled
    beside an installed package serves those who may not write there.
    """

    def __init__(self, folders: list[Path], base: str, stamp: str) -> None:
        self.folders, self._base, self._stamp = folders, base, stamp[:16]

    def _name(self, key: str) -> str:
        return f"{self._base}.{self._stamp}.{hashlib.sha256(key.encode()).hexdigest()[:24]}.nbc"

    def load(self, key: str, rebuild: Callable[[Any], Any]) -> Any:
        """What `rebuild` makes of the data kept under a key, or None; a file that is damaged is dropped."""
        for folder in self.folders:
            path = folder / self._name(key)
            try:
                content = path.read_bytes()
            except OSError:
                continue
            try:
                if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
                    raise ValueError("damaged")
                kept, data = pickle.loads(content[_DIGEST:])
                if kept == key:
                    return rebuild(data)
            except Exception:  # whatever a file that is not what was written may raise
                with contextlib.suppress(OSError):
                    path.unlink()
        return None

    def save(self, key: str, data: Any) -> None:
        """Keep data under a key, in one piece or not at all; files of other sources are cleared away."""
        path = self.folders[0] / self._name(key)
        content = dumps((key, data))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:16]}")
        try:
            part.write_bytes(hashlib.sha256(content).digest() + content)
            part.replace(path)
        except BaseException as error:
            with contextlib.suppress(OSError):
                part.unlink()
            if isinstance(error, PermissionError) and path.exists():  # on Windows: another process has it open
                return
            raise
        for other in self._files():
            if not other.name.startswith(f"{self._base}.{self._stamp}."):
                other.unlink(missing_ok=True)

    def _files(self) -> Iterator[Path]:
        begin = f"{self._base}."
        found = list(self.folders[0].iterdir())
        return (path for path in found if path.name.startswith(begin) and path.suffix in (".nbc", ".nbi"))

    def flush(self) -> None:
        """Forget all forms."""
        for path in self._files():
            path.unlink(missing_ok=True)


class KernelCache(caching.NullCache):  # type: ignore[misc]
    """What Numba asks for compiled forms. If it asks for more than is here, it finds nothing and keeps nothing."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _shelf(self) -> Shelf:
        file = inspect.getfile(self._function)
        code = self._function.__code__
        name = "".join(c for c in self._function.__qualname__ if c not in "<>")
        python = f"{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"
        base = f"{Path(file).stem}.{name}-{code.co_firstlineno}.{python}"
        beside = Path(file).resolve().parent / "__pycache__"
        try:
            chosen = Path(caching.CompileResultCacheImpl(self._function).locator.get_cache_path())
        except RuntimeError:  # none that can be written to: read what there is, and say so when something is to be kept
            chosen = beside
        return Shelf(list(dict.fromkeys((chosen, beside))), base, _stamp(file))

    @property
    def cache_path(self) -> str | None:
        """The folder that forms are written to; None where the function has no source file."""
        try:
            return str(self._shelf.folders[0])
        except Exception:
            return None

    def _key(self, signature: Any, codegen: Any) -> str:
        """All that code depends on beside the sources: types, processor, what a function within a function has seen."""
        cells = [cell.cell_contents for cell in self._function.__closure__ or ()]
        return repr((str(signature), codegen.magic_tuple(), hashlib.sha256(dumps(cells)).hexdigest()))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled form for argument types, or None."""

        def rebuild(data: Any) -> Any:
            form = CompileResult._rebuild(target_context, *data)
            return form if tuple(form.signature.args) == tuple(normalize_signature(sig)[0]) else None

        try:
            target_context.refresh()
            return self._shelf.load(self._key(sig, target_context.codegen()), rebuild)
        except Exception:  # `save_overload` will say why
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled form; where that fails, one warning a process."""
        try:
            if data.library.has_dynamic_globals:
                raise ValueError(f"{self._function.__qualname__} holds addresses of this process")
            self._shelf.save(self._key(sig, data.codegen), data._reduce())
        except Exception as error:
            _complain(error, self.cache_path)

    def flush(self) -> None:
        """Forget all forms."""
        with contextlib.suppress(Exception):
            self._shelf.flush()
