"""Cache of compiled programs on disk: one file per program, found by a key of all dependencies of its code.

The key covers the sources, the argument types, llvmlite's version and the processor. A file consists of a SHA-256
checksum, a line of JSON and an object file. Reading a file executes no code. A damaged file is compiled again; without
a writable folder no file is stored. A file that users other than the owner and root could have written is not read.

For kernels from outside the package the JSON lists the kernels' dependencies (`dependencies`). Loading a file renews
its time of modification. If all files together take more than `LIMIT`, the least recently loaded files are deleted.
"""

import contextlib
import errno
import hashlib
import importlib
import json
import os
import re
import stat
import time
import uuid
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite

from . import dependencies
from .dependencies import PACKAGE, Description, Indescribable
from .waiting import LOG

VARIABLE, FORMER = "FLEXARM_CACHE_DIR", "NUMBA_CACHE_DIR"

COMPILED = (
    "compiler/**/*.py", "physics/**/*.py", "runtime/**/*.py", "tasks/**/*.py", "layout.py", "time_functions.py",
)  # fmt: skip
"""Glob patterns of the source files with kernels or with the compiler, which determine the compiled code."""

SUFFIX = ".o"
_DIGEST = hashlib.sha256().digest_size

LIMIT, ROOM = 512.0, "FLEXARM_CACHE_MB"
"""Largest total size of the program files in a folder, in MB, and the environment variable that sets another size."""

SPARE = 0.9
"""If the files' total size exceeds the limit, files are deleted until the total size is this fraction of the limit."""

OFTEN, FORGOTTEN = 3600.0, 30 * 86400.0
"""Two times in seconds. OFTEN is the least time between two renewals of a file's time of modification, and the age from
which a partial file counts as abandoned. Files of other package versions are deleted if no process has loaded them for
the time FORGOTTEN.
"""

_NAME = re.compile(rf"[^/]+-\d+\.[0-9a-f]{{16}}\.[0-9a-f]{{24}}{re.escape(SUFFIX)}(\.[0-9a-f]{{16}})?")
"""Names of complete and partial program files; no other file is deleted."""

_said = False
"""True after this process has warned that nothing can be stored."""

_sentences: set[str] = set()
"""Messages that `_say_once` has logged."""


class Key(NamedTuple):
    """Key by which a compiled program is found in the cache.

    base: first part of the file name, made of module, kernel name and line number.
    stamp: hash of the package's sources.
    text: description of all other dependencies.
    function: the kernel's Python function.
    shapes: argument types (`kinds.described_as`).
    """

    base: str
    stamp: str
    text: str
    function: Any = None
    shapes: Sequence[Any] = ()

    @property
    def name(self) -> str:
        """Name of the program's file, made of `base`, a hash of the sources and a hash of `text`."""
        return f"{self.base}.{self.stamp[:16]}.{hashlib.sha256(self.text.encode()).hexdigest()[:24]}{SUFFIX}"


@cache
def source_hash() -> str:
    """Return the SHA-256 (hex) of llvmlite's version and of all source files with kernels or with the compiler."""
    digest = hashlib.sha256(llvmlite.__version__.encode())
    for path in sorted(path for pattern in COMPILED for path in PACKAGE.glob(pattern)):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def key_of(function: Any, shapes: Sequence[Any], direct: bool, *target: str) -> Key:
    """Return the cache key of a function's program.

    function: the kernel's Python function.
    shapes: argument types (`kinds.described_as`).
    direct: whether the kernel is called with one named tuple and integers (`entry`).
    target: LLVM's target triple, processor and processor features.
    """
    name = "".join(c for c in function.__qualname__ if c not in "<>")
    base = f"{function.__module__.rpartition('.')[2]}.{name}-{function.__code__.co_firstlineno}"
    known = function.__module__, function.__qualname__, list(shapes), direct, target
    words = dependencies.key_words(function, shapes)
    return Key(base, source_hash(), repr((*known, *words)), function, tuple(shapes))


@cache
def _former() -> str | None:
    """Return the folder in Numba's environment variable, which earlier releases used as the cache, with a warning."""
    folder = os.environ.get(FORMER)
    if folder and not os.environ.get(VARIABLE):
        warnings.warn(f"{FORMER}: is {VARIABLE} now; it is still heeded in this release", FutureWarning, stacklevel=2)
    return folder


def folders() -> list[Path]:
    """Return the folders in which programs are searched. New programs are written to the first folder in the list.

    The folder beside an installed package, compiled by an administrator, serves users without write access to that
    folder.
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
    """Return whether only the user and root can write to a file or folder."""
    if os.name != "posix":
        return True
    return _trusted(path.stat())


def _trusted(found: os.stat_result) -> bool:
    """Return True if a file with this POSIX status belongs to the user or root and cannot be written by other users."""
    if os.name != "posix":
        return True
    return found.st_uid in (0, os.geteuid()) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def prepare(folder: Path) -> None:
    """Make a folder for programs. Raises OSError if that fails or if other users can write to the folder."""
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    if not _safe(folder):
        raise PermissionError(errno.EPERM, "others than you can write there")


def load(key: Key) -> tuple[bytes, Any] | None:
    """Return (object file, type of the result) of a program on disk, or None. Damaged files in the cache are
    deleted."""
    for folder in folders():
        path = folder / key.name
        try:
            # skip folders and files that others could have written
            if not _safe(folder):
                continue
            content = _content(path)
        except OSError:
            continue
        try:
            # checksum, then the JSON line, then the object file
            if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
                raise ValueError("damaged")
            head, _, code = content[_DIGEST:].partition(b"\n")
            facts = json.loads(head)
            # another key with the same hash prefix
            if facts["key"] != key.text:
                raise ValueError("another's")
        except (ValueError, KeyError, TypeError, RecursionError):
            with contextlib.suppress(OSError):
                path.unlink()
            continue
        try:
            # compare dependencies outside the package; changed ones mean: compile anew
            classes = _classes(key, facts["depends"])
            result = _with_classes(facts["result"], classes)
        except _CHANGED:
            continue
        _loaded_now(path)
        return code, result
    return None


def _content(path: Path) -> bytes:
    """Return a file's bytes. Raises OSError if the file is missing, is no regular file, or could have been written by
    other users."""
    # O_NONBLOCK: opening a FIFO must not wait for a writer
    with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
        # status of the open file, not of the path, which could be exchanged
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or not _trusted(found):
            raise PermissionError(errno.EPERM, "no plain file of one's own")
        return file.read()


def _loaded_now(path: Path) -> None:
    """Set a file's time of modification to now, at most once an hour."""
    with contextlib.suppress(OSError):
        if path.stat().st_mtime < time.time() - OFTEN:
            os.utime(path)


def save(key: Key, code: bytes, result: Any, used: dict[Any, set[str]]) -> None:
    """Store a program atomically: write a partial file, then rename it. If a program cannot be stored, a warning
    appears once per process.

    code: the object file.
    result: type of the result.
    used: functions in the program with the global names that each function reads. A program with a dependency that
    cannot be described is not stored, and a log message names the reason.
    """
    try:
        head = json.dumps({"key": key.text, "result": _in_words(result), "depends": _depends(key, used)})
        # check that the result's classes can be found again when the file is loaded
        _with_classes(_in_words(result), _classes(key, json.loads(head)["depends"]))
    except (Indescribable, *_CHANGED) as error:
        _say_once(f"{key.base.rpartition('-')[0]} is compiled anew in every process: {error}")
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
            # on Windows: another process has the file open
            if isinstance(error, PermissionError) and path.exists():
                return
            raise
        _make_room(folder, key, path)
    except OSError as error:
        _complain(error, folder)


_CHANGED = (LookupError, AttributeError, ValueError, TypeError, StopIteration, RecursionError, ImportError)
"""Exceptions raised while describing a program whose dependencies have changed."""


def _depends(key: Key, used: dict[Any, set[str]]) -> Any:
    """Return the JSON description of a program's dependencies outside the package; None if it has none."""
    if not dependencies.is_foreign(used):
        return None
    found = Description.made(key.function, key.shapes, used)
    return {"words": found.words, "guide": found.guide, "chosen": dependencies.chosen(used)}


def _classes(key: Key, depends: Any) -> dict[str, Any]:
    """Return the named tuple classes that a program's result may contain, by "module:qualified name".

    depends: stored description. Raises ValueError or another error of `_CHANGED` if a dependency has changed.
    """
    classes = {f"{one.__module__}:{one.__qualname__}": one for one in dependencies.classes_of(key.shapes)}
    if depends is not None:
        found = Description.now(key.function, key.shapes, depends["chosen"], depends["guide"])
        if found.words != depends["words"] or found.guide != depends["guide"]:
            raise ValueError("changed")
        classes |= found.classes
    return classes


def _in_words(result: Any) -> Any:
    """Return a result spec (`program._given`) with class names in place of classes, for JSON."""
    if isinstance(result, str) or result[0] == "known":
        return result
    if result[0] == "record" and isinstance(result[1], type):
        result = ["record", f"{result[1].__module__}:{result[1].__qualname__}", result[2]]
    return [*result[:-1], [_in_words(one) for one in result[-1]]]


def _with_classes(result: Any, classes: dict[str, Any]) -> Any:
    """Return a result spec with classes in place of their names. Raises LookupError or a similar error if a class is
    missing."""
    if isinstance(result, str) or result[0] == "known":
        return result
    rest = [_with_classes(one, classes) for one in result[-1]]
    if result[0] != "record":
        return [*result[:-1], rest]
    found, (module, _, name) = classes.get(result[1]), result[1].partition(":")
    if found is None:
        # classes of the package are imported, others must be among the dependencies
        if module.split(".")[0] != PACKAGE.name:
            raise LookupError(f"it returns a {name}, which it does not name")
        found = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    return ["record", found, rest]


# --- disk space ------------------------------------------------------------------------------------


def limit() -> int:
    """Return the largest total size of program files in bytes: FLEXARM_CACHE_MB, or `LIMIT`."""
    chosen = os.environ.get(ROOM)
    try:
        megabytes = LIMIT if not chosen else float(chosen)
    except ValueError:
        megabytes = -1.0
    if not megabytes >= 0.0:
        raise ValueError(f"{ROOM} = {chosen!r}: must be a number of megabytes, 0 or more")
    return int(min(megabytes, 1e9) * 2**20)


def programs(folder: Path) -> list[tuple[float, int, Path]]:
    """Return (time of last use, size in bytes, path) of all program files in a folder, including partial files."""
    found = []
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if _NAME.fullmatch(entry.name):
                with contextlib.suppress(OSError):
                    about = entry.stat(follow_symlinks=False)
                    found.append((about.st_mtime, about.st_size, Path(entry.path)))
    return found


def clean(folder: Path) -> tuple[int, int]:
    """Delete all programs in a folder; return the numbers of files and of bytes deleted."""
    count, size = 0, 0
    for _, bytes_, path in programs(folder):
        with contextlib.suppress(OSError):
            path.unlink()
            count, size = count + 1, size + bytes_
    return count, size


_known_size: dict[Path, int] = {}
"""Size of each folder in bytes: the last count by this process plus the size of files written since."""


def _make_room(folder: Path, key: Key, written: Path) -> None:
    """Delete superseded, abandoned and, above the limit, least recently used programs after a file was written.

    key: cache key of the written program. written: path of its file.
    """
    # the same kernel compiled from other sources
    for other in list(folder.iterdir()):
        if other.name.startswith(f"{key.base}.") and _over(other, key):
            other.unlink(missing_ok=True)
    most = limit()
    # below the limit by this process's count: do not scan the folder
    if folder in _known_size:
        _known_size[folder] += written.stat().st_size
        if _known_size[folder] <= most:
            return
    # scan: delete abandoned partial files and old files of other versions
    now, stamp, kept, size = time.time(), f".{key.stamp[:16]}.", [], 0
    for last, bytes_, path in programs(folder):
        half_written = path.suffix != SUFFIX and last < now - OFTEN
        if path != written and (half_written or (stamp not in path.name and last < now - FORGOTTEN)):
            path.unlink(missing_ok=True)
        else:
            kept.append((last, bytes_, path))
            size += bytes_
    # least recently used first, until SPARE of the limit is left
    if size > most:
        for _, bytes_, path in sorted(kept):
            if size <= most * SPARE:
                break
            if path != written:
                path.unlink(missing_ok=True)
                size -= bytes_
    _known_size[folder] = size


def _over(path: Path, key: Key) -> bool:
    """Return True if a file of the same kernel was compiled from other sources, or is a partial file older than an
    hour."""
    if path.suffix == SUFFIX:
        return not path.name.startswith(f"{key.base}.{key.stamp[:16]}.")
    with contextlib.suppress(FileNotFoundError):
        return path.stat().st_mtime < time.time() - OFTEN
    return False


def _say_once(text: str) -> None:
    """Log the reason why a kernel is not stored, each reason once per process."""
    if text not in _sentences:
        _sentences.add(text)
        LOG.warning("flexarm_env: %s", text)


def _complain(error: OSError, folder: Path) -> None:
    """Warn once per process that compiled code cannot be stored, with folder and reason."""
    global _said
    if not _said:
        _said = True
        text = (
            f"flexarm_env: compiled code cannot be kept, every process compiles anew ({folder}: "
            f"{error.strerror or error}); set {VARIABLE} to a folder of your own that has room"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)
