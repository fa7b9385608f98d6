"""Machine code on disk: one file a program, that nothing but the same sources find again.

Its name follows from the sources, from what the program is called with, from llvmlite and the processor. It says itself
whether it is whole; what cannot be read is compiled anew, what cannot be written is not kept. A file is an object file
behind a line of JSON: reading one runs nothing. Nothing is read that others than the user and root could have written.

Kernels of other files than the package's name themselves in the line: file, digest, and the values of what they read.
"""

import contextlib
import errno
import hashlib
import inspect
import json
import os
import stat
import sys
import time
import uuid
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import llvmlite
import numpy as np

from .dispatch import FOREIGN

VARIABLE, FORMER = "FLEXARM_CACHE_DIR", "NUMBA_CACHE_DIR"

COMPILED = (
    "compiler/**/*.py", "physics/**/*.py", "runtime/**/*.py", "tasks/**/*.py", "layout.py", "time_functions.py",
)  # fmt: skip
"""Sources that compiled code is made of."""

PACKAGE = Path(__file__).parents[1]
SUFFIX = ".o"
_DIGEST = hashlib.sha256().digest_size

_said = False
"""Whether this process has heard that nothing is kept."""


class Key(NamedTuple):
    """base: what a program's files are called. stamp: of the sources. text: all else that it depends on."""

    base: str
    stamp: str
    text: str

    @property
    def name(self) -> str:
        """The file's name."""
        return f"{self.base}.{self.stamp[:16]}.{hashlib.sha256(self.text.encode()).hexdigest()[:24]}{SUFFIX}"


@cache
def source_hash() -> str:
    """SHA-256 (hex) over the sources that compiled code is made of, and llvmlite's version."""
    digest = hashlib.sha256(llvmlite.__version__.encode())
    for path in sorted(path for pattern in COMPILED for path in PACKAGE.glob(pattern)):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def key_of(function: Any, shapes: Sequence[Any], direct: bool, *target: str) -> Key:
    """The key of a function's program."""
    name = "".join(c for c in function.__qualname__ if c not in "<>")
    base = f"{function.__module__.rpartition('.')[2]}.{name}-{function.__code__.co_firstlineno}"
    known = function.__module__, function.__qualname__, list(shapes), direct, target, sorted(FOREIGN.items())
    return Key(base, source_hash(), repr(known))


@cache
def _former() -> str | None:
    """Numba's variable, which named the folder in earlier releases."""
    folder = os.environ.get(FORMER)
    if folder and not os.environ.get(VARIABLE):
        warnings.warn(f"{FORMER}: is {VARIABLE} now; it is still heeded in this release", FutureWarning, stacklevel=2)
    return folder


def folders() -> list[Path]:
    """Where programs are written (the first), and all folders where they are looked for.

    What an administrator has compiled beside an installed package serves those who may not write there.
    """
    beside = PACKAGE / "__pycache__" / "objects"
    chosen = os.environ.get(VARIABLE) or _former()
    if chosen:
        return list(dict.fromkeys((Path(chosen).absolute(), beside)))
    if os.access(PACKAGE, os.W_OK):
        return [beside]
    home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return [Path(home) / "flexarm_env", beside]


def _safe(path: Path) -> bool:
    """Whether nobody but the user and root can have written a file or folder."""
    if os.name != "posix":
        return True
    found = path.stat()
    return found.st_uid in (0, os.geteuid()) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def prepare(folder: Path) -> None:
    """Make a folder for programs. OSError: it cannot be made, or others can write there."""
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    if not _safe(folder):
        raise PermissionError(errno.EPERM, "others than you can write there")


def load(key: Key) -> tuple[bytes, Any] | None:
    """A program's machine code and what its result is, or None; a file that is damaged is dropped."""
    for folder in folders():
        path = folder / key.name
        try:
            if not _safe(folder) or not _safe(path):
                continue
            content = path.read_bytes()
        except OSError:
            continue
        try:
            if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
                raise ValueError("damaged")
            head, _, code = content[_DIGEST:].partition(b"\n")
            facts = json.loads(head)
            if facts["key"] != key.text:
                raise ValueError("another's")
        except (ValueError, KeyError, TypeError, RecursionError):
            with contextlib.suppress(OSError):
                path.unlink()
            continue
        if all(_holds(fact) for fact in facts["foreign"]):
            return code, facts["result"]
    return None


def save(key: Key, code: bytes, result: Any, used: dict[Any, set[str]]) -> None:
    """Keep a program, in one piece or not at all; where that fails, one warning a process.

    used: the functions it was made of, and the global names that each reads.
    """
    try:
        foreign = [_fact(one, names) for one, names in used.items() if not _own(one)]
        head = json.dumps({"key": key.text, "result": result, "foreign": foreign})
    except (TypeError, ValueError, OSError):  # from no file, or its result is of a class of its own: not kept
        return
    folder = folders()[0]
    try:
        prepare(folder)
        content = head.encode() + b"\n" + code
        path = folder / key.name
        part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:16]}")
        try:
            part.touch(0o644)
            part.write_bytes(hashlib.sha256(content).digest() + content)
            part.chmod(0o644)
            part.replace(path)
        except BaseException as error:
            with contextlib.suppress(OSError):
                part.unlink()
            if isinstance(error, PermissionError) and path.exists():  # on Windows: another process has it open
                return
            raise
        for other in list(folder.iterdir()):
            if other.name.startswith(f"{key.base}.") and _over(other, key):
                other.unlink(missing_ok=True)
    except OSError as error:
        _complain(error, folder)


def _over(path: Path, key: Key) -> bool:
    """Whether a file is of other sources, or what a process that was killed, an hour ago or more, has half written."""
    if path.suffix == SUFFIX:
        return not path.name.startswith(f"{key.base}.{key.stamp[:16]}.")
    with contextlib.suppress(FileNotFoundError):
        return path.stat().st_mtime < time.time() - 3600.0
    return False


def _complain(error: OSError, folder: Path) -> None:
    """Say once in a process that compiled code is not kept, where and why."""
    global _said
    if not _said:
        _said = True
        text = (
            f"flexarm_env: compiled code cannot be kept, every process compiles anew ({folder}: "
            f"{error.strerror or error}); set {VARIABLE} to a folder of your own that has room"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)


# --- kernels of other files ------------------------------------------------------------------------


def _own(function: Any) -> bool:
    """Whether a function's source is the package's, and all that there is to it."""
    return str(function.__module__).split(".")[0] == PACKAGE.name and not function.__closure__


@cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _fact(function: Any, names: set[str]) -> dict[str, Any]:
    """What a foreign function was when it was compiled. ValueError: it cannot be told again."""
    if function.__closure__ or sys.modules.get(function.__module__) is None:
        raise ValueError(function)
    file = inspect.getfile(function)
    reads = {name: _told(_found(function.__globals__, name)) for name in sorted(names)}
    reads |= {f"{k} of {function.__qualname__}": _told(x) for k, x in enumerate(function.__defaults__ or ())}
    return {"module": function.__module__, "file": file, "digest": _digest(file), "reads": reads}


def _found(scope: dict[str, Any], name: str) -> Any:
    """What a name stands for, `constants.PI` too, or a default of a function: `0 of f`."""
    if " of " in name:
        place, _, function = name.partition(" of ")
        return getattr(scope[function], "function", scope[function]).__defaults__[int(place)]
    first, *rest = name.split(".")
    item = scope[first]
    for part in rest:
        item = getattr(item, part)
    return item


def _told(item: Any) -> str:
    """A global value that a kernel has seen. ValueError: it has no words."""
    if item is None or isinstance(item, bool | int | float | str):
        return repr(item)
    if isinstance(item, tuple | list):
        return f"({', '.join(map(_told, item))})"
    if isinstance(item, np.ndarray):
        return f"{item.dtype.str}{item.shape}{hashlib.sha256(item.tobytes()).hexdigest()}"
    if isinstance(item, FunctionType) and not _own(item):  # Python that runs while a kernel is compiled
        return f"{item.__module__}.{item.__qualname__} {_digest(inspect.getfile(item))}"
    if hasattr(item, "__qualname__"):
        return f"{item.__module__}.{item.__qualname__}"
    if hasattr(item, "__name__"):
        return str(item.__name__)
    raise ValueError(item)


def _holds(fact: Any) -> bool:
    """Whether a foreign function still is what it was."""
    try:
        scope = vars(sys.modules[fact["module"]])
        now = {name: _told(_found(scope, name)) for name in fact["reads"]}
        return now == fact["reads"] and _digest(fact["file"]) == fact["digest"]
    except (KeyError, ValueError, OSError, AttributeError, IndexError, TypeError):
        return False
