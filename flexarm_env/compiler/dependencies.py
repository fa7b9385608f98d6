"""Dependencies of a compiled program outside the package's sources, described by text that processes can compare.

A program on disk is loaded only if the description of its dependencies is the same as when it was compiled. The
description includes the kernel itself, the global names that it reads, and the objects of these names (functions,
classes, values) with their own dependencies. A module is not described by its name alone, because two folders may each
contain a module of the same name.

A function is described by its bytecode, defaults and closure values; a named tuple by its fields, defaults and
constants; numbers, strings, arrays and collections by their contents. A program that depends on any other kind of
object is not stored (`Indescribable`).
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import inspect
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from .decorator import Kernel
from .dispatch import FOREIGN, OfPart
from .kinds import Layout, is_tuple
from .lane_arrays import lane_fields, lane_parameters
from .operators import methods
from .trace import Straight, global_names

PACKAGE = Path(__file__).parents[1]

Reads = Mapping[Any, Collection[str]]
"""For each function of a program, the global names that it reads, including attributes (`constants.PI`)."""


class Indescribable(ValueError):
    """Raised for a value without a description that another process could compare."""


class Description:
    """Text that describes the dependencies of a program.

    Attributes:
        words: the description as strings: for the kernel, for the classes of its arguments, and for each function that
            the program uses.
        guide: data with which `now` repeats the description: whether each function was compiled, and the global names
            that the function reads. classes: named tuple classes that the program uses, by module and qualified name.
    """

    def __init__(self, reads: Reads | None, guide: Sequence[Any]) -> None:
        """Make an empty description. reads: global names that each function reads; None to take them from the `guide`
        of an earlier description."""
        self._reads, self._old = reads, iter(guide)
        self.words: list[str] = []
        self.guide: list[Any] = []
        self.classes: dict[str, Any] = {}
        # functions with the labels given to them; functions not described yet
        self._met: dict[Any, str] = {}
        self._left: list[Any] = []

    @classmethod
    def made(cls, root: Any, shapes: Sequence[Any], used: Reads) -> Description:
        """Describe a program that has just been compiled.

        root: the program's kernel.
        shapes: the kernel's argument types (`kinds.described_as`).
        used: functions of the program with the global names that they read. Raises Indescribable for a value that
        processes cannot compare, or for a function that no other function refers to by a global name.
        """
        found = cls(used, ())
        picked = [_plain(function) for _, function in choices() if _plain(function) in used]
        found._all([root, *_foreign_classes(shapes), *picked])
        for function in used:
            if not _is_own(function) and function not in found._met:
                raise Indescribable(f"{function.__qualname__} is called, but not by a global name")
        return found

    @classmethod
    def now(cls, root: Any, shapes: Sequence[Any], chosen: Sequence[str], guide: Sequence[Any]) -> Description:
        """Describe the same program from the objects of this process, for comparison with the stored words.

        root: the program's kernel.
        shapes: the kernel's argument types.
        chosen: names of the functions in the program that `Family` chose by class.
        guide: `Description.guide` of the stored description. Raises LookupError or AttributeError if a function or name
        no longer exists.
        """
        places = dict(choices())
        found = cls(None, guide)
        found._all([root, *_foreign_classes(shapes), *(_plain(places[choice]) for choice in chosen)])
        return found

    def _all(self, roots: Sequence[Any]) -> None:
        """Describe the given objects, then, breadth first, all functions outside the package to which they refer."""
        for root in roots:
            self.words.append(self.describe(root))
        while self._left:
            self.words.append(self._function(self._left.pop(0)))

    # --- functions ---------------------------------------------------------------------------------
    def _function(self, function: Any) -> str:
        """Describe a function outside the package: code digest, defaults, and each global and closure name it reads."""
        code = function.__code__
        if self._reads is None:
            # follow the guide, whose names are those at compile time
            compiled, names = next(self._old)
        else:
            # compiled functions read the recorded names, others any name of their bytecode
            compiled = function in self._reads
            names = sorted(self._reads[function] if compiled else global_names(function))
        self.guide.append([compiled, names])
        parts = [f"{self._met[function]}: {code_digest(code)}"]
        parts += [f"{name}: lanes {holds}" for name, holds in lane_parameters(function).items()]
        parts += [self.describe(x) for x in function.__defaults__ or ()]
        parts += [f"{k}={self.describe(x)}" for k, x in sorted((function.__kwdefaults__ or {}).items())]
        around = dict(zip(code.co_freevars, function.__closure__ or (), strict=True))
        for name in dict.fromkeys([*code.co_freevars, *names]):
            parts.append(f"{name}: {self._value(function, name, around, compiled)}")
        return "; ".join(parts)

    def _value(self, function: Any, name: str, around: dict[str, Any], compiled: bool) -> str:
        """Describe the object to which a name in a function refers.

        For functions that only Python runs, at compile time, an indescribable object is described by its type.
        """
        item: Any = None
        try:
            item = _found(function.__globals__, around, name)
            return self.describe(item)
        except (LookupError, AttributeError):
            raise Indescribable(f"{function.__qualname__} reads {name!r}, which is no global name") from None
        except Indescribable as error:
            if compiled:
                raise Indescribable(f"{function.__qualname__} reads {name!r}, {error}") from None
            return type(item).__qualname__

    def _named(self, function: FunctionType) -> str:
        """Describe a function: one of this package by its name, one of a library by its file's digest, any other by a
        new label.

        Functions with a label are described later, by `_function`.
        """
        if _is_own(function) and not function.__code__.co_filename.startswith("<"):
            return f"{function.__module__}.{function.__qualname__}"
        if self._reads is None:
            # library functions that are not compiled: by file digest
            whole = not next(self._old)
        else:
            whole = _of_library(function) and function not in self._reads
        self.guide.append(not whole)
        if whole:
            return f"{function.__qualname__} {_file_digest(function.__code__.co_filename)}"
        if function not in self._met:
            self._met[function] = f"function {len(self._met)}"
            self._left.append(function)
        return self._met[function]

    # --- values ------------------------------------------------------------------------------------
    def describe(self, item: Any) -> str:
        """Return the description of a value. Raises Indescribable for a value that processes cannot compare."""
        cls = type(item)
        if item is None or cls in (bool, int, float, complex, str, bytes, range):
            return repr(item)
        if isinstance(item, np.ndarray) and item.dtype.kind in "biufcSU":
            return f"{item.dtype.str}{item.shape}{hashlib.sha256(item.tobytes()).hexdigest()}"
        if isinstance(item, np.generic) and item.dtype.kind in "biufcSU":
            return f"{item.dtype.str} {item.tobytes().hex()}"
        if isinstance(item, tuple | list):
            kind = "" if cls is tuple else f"{self._class(cls)} "
            return f"{kind}({', '.join(map(self.describe, item))})"
        if isinstance(item, dict):
            return f"{{{', '.join(f'{self.describe(k)}: {self.describe(x)}' for k, x in item.items())}}}"
        if isinstance(item, set | frozenset):
            return f"{{{', '.join(sorted(map(self.describe, item)))}}}"
        if isinstance(item, enum.Enum):
            return f"{self._class(cls)}.{item.name} {self.describe(item.value)}"
        if isinstance(item, ModuleType):
            return item.__name__
        if isinstance(item, CellType):
            return self.describe(item.cell_contents) if item != CellType() else "no value"
        if isinstance(item, type):
            return self._class(item)
        if dataclasses.is_dataclass(item):
            parts = [f"{one.name}={self.describe(getattr(item, one.name))}" for one in dataclasses.fields(item)]
            return f"{self._class(cls)}({', '.join(parts)})"
        return self._callable(item)

    def _callable(self, item: Any) -> str:
        """Describe a kernel, straight-line code, a family's function, a Python function or another callable."""
        if isinstance(item, Kernel):
            return f"kernel {item.attributes} {item.often} {item.superword} {self.describe(item.function)}"
        if isinstance(item, Straight):
            return f"{type(item).__name__} {item.traits} {self.describe(item.function)}"
        if isinstance(item, OfPart):
            return f"part {item.part} {self.describe(item.function)}"
        # a function of a family: its registered functions are described where they are used (`choices`)
        if hasattr(item, "choice"):
            return f"choice {item.__module__}.{item.__name__} {item.place}"
        if isinstance(item, FunctionType):
            return self._named(item)
        name = getattr(item, "__qualname__", getattr(item, "__name__", None))
        if not callable(item) or name is None:
            raise Indescribable(f"which is of {type(item).__module__}.{type(item).__qualname__}")
        return f"{getattr(item, '__module__', '')}.{name}"

    def _class(self, cls: Any) -> str:
        """Describe a class by its name, a named tuple class by fields, defaults and constants too."""
        name = f"{cls.__module__}.{cls.__qualname__}"
        if not issubclass(cls, tuple) or not hasattr(cls, "_fields") or _is_own_class(cls):
            return name
        if self.classes.setdefault(f"{cls.__module__}:{cls.__qualname__}", cls) is not cls:
            raise Indescribable(f"which is one of two classes {name}")
        # fields, defaults, operators, then public class attributes up to tuple
        parts = [str(cls._fields), self.describe(cls._field_defaults), *sorted(lane_fields(cls))]
        parts += [f"{word}={self.describe(item)}" for word, item in methods(cls)]
        for base in cls.__mro__[: cls.__mro__.index(tuple)]:
            for word, item in sorted(vars(base).items()):
                if not word.startswith("_") and word not in cls._fields and not callable(item):
                    # descriptors (methods, properties) by type only
                    with_value = not hasattr(type(item), "__get__")
                    parts.append(f"{word}={self.describe(item) if with_value else type(item).__name__}")
        return f"{name}<{'; '.join(parts)}>"


def choices() -> Iterator[tuple[str, Any]]:
    """Yield (name, function) of all functions from outside the package that are registered in families."""
    for choice, made in sorted(FOREIGN.items()):
        for k, (_, function) in enumerate(made):
            yield f"{choice} {k}", function


def chosen(used: Reads) -> list[str]:
    """Return the names of the functions in a program that are registered in families (`choices`).

    used: functions of the program with the global names that they read.
    """
    return [choice for choice, function in choices() if _plain(function) in used]


def _plain(function: Any) -> Any:
    """Return the Python function behind kernels and other wrappers."""
    while hasattr(function, "function"):
        function = function.function
    return function


def key_words(function: Any, shapes: Sequence[Any]) -> list[Any]:
    """Return the part of the cache key for functions and classes from outside the package, [] if there are none.

    function: the Python function of a kernel. shapes: the kernel's argument types (`kinds.described_as`).
    """
    words: list[Any] = []
    if FOREIGN:
        words.append([(choice, one.__module__, _file(one), getattr(one, "part", "")) for choice, one in choices()])
    # a kernel from outside: its file, bytecode and closure values
    if not _is_own(function):
        words.append((_file(function), code_digest(function.__code__), sorted(lane_parameters(function).items())))
        words += [_described(cell)[0] for cell in function.__closure__ or ()]
    for cls in _foreign_classes(shapes):
        words += _described(cls)
    # bytecode is that of one Python version
    if words:
        words.append(sys.implementation.cache_tag)
    return words


def _described(item: Any) -> list[str]:
    """Return the description of an object and its references, or the reason why it has no description."""
    found = Description({}, ())
    try:
        found._all([item])
    except Indescribable as error:
        found.words.append(str(error))
    return found.words


def classes_of(shape: Any) -> Iterator[Any]:
    """Yield the named tuple classes in argument types (`kinds.described_as`), including nested classes."""
    if isinstance(shape, Layout):
        yield shape.instance_class
        for part, _ in shape.parts.values():
            yield from classes_of(part)
    elif isinstance(shape, list) or is_tuple(shape):
        for part in shape:
            yield from classes_of(part)


def _foreign_classes(shapes: Sequence[Any]) -> list[Any]:
    """Return the named tuple classes in argument types that are defined outside the package; they may contain
    kernels."""
    return [cls for cls in classes_of(shapes) if not _is_own_class(cls)]


def is_foreign(used: Reads) -> bool:
    """Return whether a program contains functions from outside the package.

    used: functions of the program with the global names that they read.
    """
    return not all(map(_is_own, used))


def _is_own(function: Any) -> bool:
    """Return whether a function is the package's and has no closure, so that the source hash covers it."""
    return str(function.__module__).split(".")[0] == PACKAGE.name and not function.__closure__


def _is_own_class(cls: Any) -> bool:
    """Return whether a class is defined in one of the package's modules under its qualified name."""
    if cls.__module__.split(".")[0] != PACKAGE.name:
        return False
    found = sys.modules.get(cls.__module__)
    for part in cls.__qualname__.split("."):
        found = getattr(found, part, None)
    return found is cls


def _file(function: Any) -> str:
    """Return the absolute path of the file that defines a function; "" if there is no file, as in a notebook."""
    file = _plain(function).__code__.co_filename if hasattr(_plain(function), "__code__") else ""
    return str(Path(file).absolute()) if file and Path(file).is_file() else ""


def _of_library(function: Any) -> bool:
    """Return whether a function belongs to Python's standard library or to an installed package."""
    file = function.__code__.co_filename
    return any(file.startswith(folder) for folder in _libraries())


@functools.cache
def _libraries() -> tuple[str, ...]:
    """Return the folders of the standard library and of installed packages."""
    import sysconfig

    paths = sysconfig.get_paths()
    return tuple({paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib") if name in paths})


@functools.cache
def _file_digest(file: str) -> str:
    """Return the SHA-256 (hex) of a file. Raises Indescribable if the file cannot be read."""
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError:
        raise Indescribable(f"which is of {file}, a file that cannot be read") from None


@functools.cache
def code_digest(code: CodeType) -> str:
    """Return the SHA-256 (hex) of a code object's bytecode, names and constants."""
    return hashlib.sha256(repr(_meaning(code)).encode()).hexdigest()


def _meaning(item: Any) -> Any:
    """Convert a code object or a constant to a structure whose `repr` is unique and is the same in all processes."""
    if isinstance(item, CodeType):
        # file name and line numbers are left out: moving a function changes nothing
        constants = [_meaning(x) for x in item.co_consts]
        flags = item.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS | inspect.CO_GENERATOR)
        named = item.co_names, item.co_varnames, item.co_freevars, item.co_cellvars
        return ["code", item.co_name, item.co_code, item.co_argcount, item.co_kwonlyargcount, flags, named, constants]
    if isinstance(item, tuple):
        return ("tuple", *map(_meaning, item))
    if isinstance(item, frozenset):
        # the order of a set differs between processes
        return ["set", *sorted(repr(_meaning(x)) for x in item)]
    return (type(item).__name__, repr(item))


def _found(scope: Mapping[str, Any], around: Mapping[str, Any], name: str) -> Any:
    """Return the object of a closure or global name, or of an attribute of such an object (`constants.PI`)."""
    first, *rest = name.split(".")
    item = around[first] if first in around else scope[first]
    # closure cells may be empty
    if isinstance(item, CellType):
        item = None if item == CellType() else item.cell_contents
    for part in rest:
        item = getattr(item, part)
    return item
