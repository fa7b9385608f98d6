"""Validate values from users; every error message has the same form.

The form is ``key.path = value: rule``, for example
``links[0].section.EI = -1.0: must be a positive number (N m^2)``.
"""

import contextlib
import dataclasses
import difflib
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Array = NDArray[np.float64]
"""Array: float64 array of any shape. Array32: float32 array, the type of observations and actions."""
Array32 = NDArray[np.float32]


class BadKey(ValueError):
    """Error with a key path, in the attribute ``path``. :func:`under` adds the keys of outer tables to the path."""

    def __init__(self, path: str, *more: object) -> None:
        super().__init__(path, *more)
        self.path = path


class InvalidValue(BadKey):
    """Error for an invalid value. path: its key path. value: the value. allowed: rule, such as "must be positive"."""

    def __init__(self, path: str, value: object, allowed: str) -> None:
        super().__init__(path, value, allowed)
        self.value, self.allowed = value, allowed

    def __str__(self) -> str:
        return f"{self.path} = {shown(self.value)}: {self.allowed}"


class UnknownKey(BadKey):
    """Error for an unknown key. path: its key path. allowed: valid keys. what: noun for a key. hint: further text."""

    def __init__(self, path: str, allowed: Iterable[str], what: str = "key", hint: str = "") -> None:
        self.allowed, self.what, self.hint = tuple(allowed), what, hint
        super().__init__(path, self.allowed, what, hint)

    def __str__(self) -> str:
        """Return the message: the path, the closest permitted key, and all permitted keys."""
        last = self.path.rsplit(": ", 1)[-1].rsplit(".", 1)[-1]
        # suggest the closest key, and shorten long paths
        near = difflib.get_close_matches(last, self.allowed, n=1, cutoff=0.7)
        hint = self.hint or (f"did you mean {near[0]}?" if near else "")
        hint = hint and f" ({hint})"
        path = self.path if len(self.path) <= 200 else f"{self.path[:197]}..."
        return f"{path}: unknown {self.what}{hint}; allowed: {', '.join(self.allowed) or 'none'}"


class UnknownArgument(UnknownKey, TypeError):
    """Error for an unknown keyword argument: also a TypeError, with the message of Python's own error. `gymnasium.make`
    raises a copy with the message as the only argument; ``path`` of the copy is the whole message.
    """

    def __init__(self, path: str, allowed: Iterable[str] = (), what: str = "argument", hint: str = "") -> None:
        super().__init__(path, allowed, what, hint)

    def __str__(self) -> str:
        return f"{super().__str__()}; got an unexpected keyword argument {self.path!r}" if self.allowed else self.path


class MissingKey(BadKey):
    """Error for a missing key. path: key path of the missing key. allowed: description of the required value."""

    def __init__(self, path: str, allowed: str) -> None:
        super().__init__(path, allowed)
        self.allowed = allowed

    def __str__(self) -> str:
        return f"{self.path}: missing; {self.allowed}"


class Unreadable(BadKey):
    """Error for a text that cannot be parsed. path: key path of the text, or "". why: the reason."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(path, why)
        self.why = why

    def __str__(self) -> str:
        return f"{self.path.removesuffix(': ') or 'text'}: {self.why}"


def lacking(what: str, package: str, extra: str) -> str:
    """Return a sentence that names a missing package and two commands that install the package: by the package's own
    name, and by an extra of flexarm_env.
    """
    return f'{what} needs {package}: pip install {package} (or install flexarm_env with the extra "{extra}")'


@contextlib.contextmanager
def needs(what: str, package: str, extra: str, error: type[Exception] = ImportError) -> Iterator[None]:
    """Import an optional package in a `with` block; raise `error` with an install command if the package is missing."""
    try:
        yield
    except ImportError as missing:
        raise error(lacking(what, package, extra)) from missing


def installed(package: str) -> str | None:
    """Return the version of an installed package, or None."""
    from importlib import metadata  # 0.01 s of a start, which does not need it
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def shown(value: object) -> str:
    """Return a short text for a value in messages, at most 100 characters."""
    # NumPy scalars and arrays as Python's
    if isinstance(value, np.generic):
        value = value.item()
    # an array without axes keeps its repr, since it is no number
    if isinstance(value, np.ndarray) and value.ndim:
        value = value.tolist()
    try:
        text = repr(value)
    except ValueError:
        # Python refuses to print integers of several thousand digits
        text = f"a {type(value).__name__} of too many digits"
    return text if len(text) <= 100 else text[:97] + "..."


def joined(path: str, key: str) -> str:
    """Join path and key with a dot, without the dot before an index [3], after a colon, or if either part is empty."""
    if not path or not key:
        return path or key
    return path + key if key.startswith("[") or path.endswith(": ") else f"{path}.{key}"


@contextlib.contextmanager
def under(prefix: str) -> Iterator[None]:
    """Context manager that adds ``prefix`` to the key path of an error raised inside the ``with`` block."""
    try:
        yield
    except BadKey as error:
        # same error type, with a longer path
        raise type(error)(joined(prefix, error.path), *error.args[1:]) from None


def in_file(path: str | os.PathLike[str] | None) -> contextlib.AbstractContextManager[None]:
    """Context manager that adds the file's path to errors raised inside the ``with`` block; None adds nothing."""
    return under("" if path is None else f"{os.fspath(path)}: ")


@contextlib.contextmanager
def solvable(arm: str) -> Iterator[None]:
    """Context manager that converts the error of a singular matrix into an InvalidValue about the arm's parameters."""
    try:
        yield
    except np.linalg.LinAlgError:
        what = "masses, inertias, lengths and stiffnesses must differ by fewer orders of magnitude in double precision"
        raise InvalidValue("arm", arm, what) from None


def store(item: object, **values: object) -> None:
    """Set fields of a frozen dataclass from its ``__post_init__``."""
    for name, value in values.items():
        object.__setattr__(item, name, value)


def number(
    path: str,
    value: object,
    unit: str = "",
    *,
    minimum: float | None = None,
    above: float | None = None,
    maximum: float | None = None,
) -> float:
    """Validate a finite number and return it as a float; a bool, a string, NaN or infinity is rejected.

    ``minimum`` and ``maximum`` are inclusive, ``above`` is exclusive. A number with a unit is also limited by `SIZES`.
    """
    if maximum is None and above == 0.0:
        allowed = "must be a positive number"
    elif maximum is None and minimum == 0.0:
        allowed = "must be a number, zero or positive"
    else:
        bounds = [
            f"above {above:g}" if above is not None else "",
            f"at least {minimum:g}" if minimum is not None else "",
            f"at most {maximum:g}" if maximum is not None else "",
        ]
        limits = " and ".join(b for b in bounds if b)
        allowed = "must be a finite number" + (f", {limits}" if limits else "")
    if unit:
        allowed += f" ({unit})"
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InvalidValue(path, value, allowed)
    try:
        result = float(value)
    except OverflowError:
        # an int may exceed every float
        result = math.inf
    if (
        not math.isfinite(result)
        or (minimum is not None and result < minimum)
        or (above is not None and result <= above)
        or (maximum is not None and result > maximum)
    ):
        raise InvalidValue(path, value, allowed)
    # magnitude: powers of quantities with a unit must not overflow
    small, large = SIZES.get(unit, (1.0 / LARGEST, LARGEST))
    if unit and (abs(result) > large or (above == 0.0 and result < small)):
        least = f"at least {small:g} and " if above == 0.0 < small else ""
        raise InvalidValue(path, value, f"must be {least}at most {large:g} in size ({unit}), or powers of it overflow")
    return result


LARGEST = 1e30
"""Largest magnitude of numbers with a unit and of numbers in files. Numbers that must be positive are at least 1 /
LARGEST. Products of a few larger numbers overflow, and the numbers themselves overflow as float32.
"""
SIZES = {"m": (1e-9, 1e9), "s": (0.0, LARGEST)}
"""Smallest and largest magnitude of a number by its unit; the default is (1 / LARGEST, LARGEST). Formulas contain high
powers of lengths. Times may be short, because the number of steps is limited."""


def limits(path: str, value: object, unit: str = "", **bounds: float) -> tuple[float, float]:
    """Validate two numbers (low, high) with low <= high. bounds: bounds of both numbers as in :func:`number`."""
    what = f"two numbers{f' ({unit})' if unit else ''}, (low, high)"
    low, high = numbers(path, value, what, 2, unit, **bounds)
    if low > high:
        raise InvalidValue(path, (low, high), "must be (low, high) with low at most high")
    return low, high


def integer(path: str, value: object, *, minimum: int, maximum: int | None = None) -> int:
    """Validate a whole number within inclusive limits and return it as an int; a bool, float or string is rejected."""
    limits = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
    allowed = f"must be a whole number, {limits}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, Integral):
        raise InvalidValue(path, value, allowed)
    result = int(value)
    if result < minimum or (maximum is not None and result > maximum):
        raise InvalidValue(path, value, allowed)
    return result


def flag(path: str, value: object) -> bool:
    """Validate a bool and return it."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidValue(path, value, "must be True or False")
    return bool(value)


def text(path: str, value: object, *, empty: bool = True) -> str:
    """Validate a string; if ``empty`` is False, the string must contain more than white space."""
    if not isinstance(value, str) or (not empty and not value.strip()):
        raise InvalidValue(path, value, "must be a text" if empty else "must be a text that is not empty")
    return value


def choice(path: str, value: object, allowed: Sequence[str]) -> str:
    """Validate a value that must be one of the words in ``allowed``."""
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(path, value, "must be one of " + ", ".join(f'"{a}"' for a in allowed))
    return value


def sequence(path: str, value: object, what: str, length: int | None = None) -> tuple[Any, ...]:
    """Validate a list, tuple or 1-D array; return a tuple. what: noun for the elements in messages."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    # texts and iterators are rejected
    if not isinstance(value, list | tuple) or (length is not None and len(value) != length):
        raise InvalidValue(path, value, f"must be a sequence of {what}")
    return tuple(value)


def numbers(
    path: str, value: object, what: str, length: int | None = None, unit: str = "", **bounds: float
) -> tuple[float, ...]:
    """Validate a sequence of numbers and return a tuple; arguments as in :func:`sequence` and :func:`number`."""
    given = sequence(path, value, what, length)
    return tuple(number(f"{path}[{i}]", one, unit, **bounds) for i, one in enumerate(given))


def several(value: object) -> bool:
    """Return whether a value is a sequence or array; texts and bytes count as single values."""
    row = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return row or (isinstance(value, np.ndarray) and value.ndim > 0)


def instance(path: str, value: object, kind: type[T]) -> T:
    """Validate that a value is an object of the class ``kind``."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise InvalidValue(path, value, f"must be {article} {kind.__name__}")
    return value


def instances(path: str, value: object, kind: type[T], what: str = "") -> tuple[T, ...]:
    """Validate a sequence of objects of the class ``kind``; return a tuple. what: noun for messages."""
    parts = sequence(path, value, what or kind.__name__)
    return tuple(instance(f"{path}[{i}]", part, kind) for i, part in enumerate(parts))


def column(path: str, values: object, unit: str = "") -> np.ndarray[Any, np.dtype[np.float64]]:
    """Validate a column of a table and return it as a float64 array (n,); a message names the first invalid row."""
    if isinstance(values, np.ndarray):
        if values.ndim != 1:
            raise InvalidValue(path, values, f"must be one-dimensional, not of shape {values.shape}")
        values = values.tolist()
    if not isinstance(values, list | tuple) or not values:
        raise InvalidValue(path, values, "must be a list of numbers that is not empty")
    # row by row, so that the message names the row
    for i, value in enumerate(values):
        try:
            number(f"{path}[{i}]", value, unit)
        except InvalidValue as error:
            raise InvalidValue(error.path, value, f"{error.allowed}, in row {i} of the table") from None
    return np.array(values, dtype=np.float64)


Shape = tuple[int | str, ...]
"""Lengths of an array's axes. A word stands for any length of at least 1, the same wherever the word occurs."""


def floats(path: str, values: Any, what: str = "numbers") -> Array:
    """Return values of any shape as float64, finite or not; raise InvalidValue unless all are real numbers."""
    try:
        # NumPy would drop imaginary parts with a warning only
        if np.iscomplexobj(values):
            raise TypeError
        return np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InvalidValue(path, values, f"must be {what}") from None


def array(path: str, values: object, shape: Shape, what: str = "") -> np.ndarray[Any, np.dtype[np.float64]]:
    """Validate an array of finite numbers; return it as float64. A word in ``shape`` permits any positive length."""
    result = floats(path, values, f"numbers of shape {_words(shape, {})}{what and ', '}{what}")
    _fits(path, result, "finite", shape, {}, what)
    return result


KINDS = {"finite": "fiu", "number": "fiu", "whole": "iu", "flag": "b", "text": "U", "any": "fiubU"}
"""Kinds of array content, each with the permitted values of NumPy's ``dtype.kind``."""


def arrays(
    given: Mapping[str, np.ndarray[Any, Any]], table: Mapping[str, tuple[str, Shape]], sizes: dict[str, int]
) -> dict[str, Any]:
    """Validate types and shapes of several arrays, and return the arrays by name.

    Args:
        given: arrays by name. table: for each name, a pair of a key of :data:`KINDS` and a shape. Equal words in shapes
            require equal lengths. A shape that ends in "..." permits further axes. sizes: known lengths by word, to
            which the function adds the lengths that it finds.
    Raises:
        ValueError: an array is missing or has a wrong type or shape; the message names the first invalid array.
    """
    for name, (kind, shape) in table.items():
        _fits(name, needed("", given, name, f"must be an array of shape {_words(shape, sizes)}"), kind, shape, sizes)
    return {name: given[name] for name in table}


def _words(shape: Shape, sizes: Mapping[str, int]) -> str:
    """Return a shape as text, with the known lengths in place of words."""
    return f"({', '.join(str(sizes.get(str(k), k)) for k in shape)}{',' * (len(shape) == 1)})"


def _fits(
    path: str, values: np.ndarray[Any, Any], kind: str, shape: Shape, sizes: dict[str, int],
    what: str = "to fit the other arrays",
) -> None:  # fmt: skip
    """Raise InvalidValue if an array has another kind or shape, or an entry that is not finite; add new lengths to
    ``sizes``.
    """
    if values.dtype.kind not in KINDS[kind]:
        raise InvalidValue(f"dtype of {path}", str(values.dtype), f"must be that of {_HELD.get(kind, 'numbers')}")
    # axes behind "..." take the array's own lengths; unknown words accept any length from 1 on
    wanted = (*shape[:-1], *values.shape[len(shape) - 1 :]) if shape[-1:] == ("...",) else shape
    bound = tuple(sizes.get(k, 0) if isinstance(k, str) else k for k in wanted)
    known = tuple(not isinstance(k, str) or k in sizes for k in wanted)
    # each axis: equal to a known length, or not empty
    if values.ndim != len(bound) or not all(
        one == length if fixed else one > 0 for one, length, fixed in zip(values.shape, bound, known, strict=True)
    ):
        raise InvalidValue(f"shape of {path}", values.shape, f"must be {_words(shape, sizes)}{what and ', '}{what}")
    sizes.update((k, n) for k, n in zip(wanted, values.shape, strict=True) if isinstance(k, str))
    # nan and infinities fail this comparison too
    if kind == "finite" and not (fine := np.abs(np.asarray(values, np.float64)) <= LARGEST).all():
        at = tuple(int(k) for k in np.argwhere(~fine)[0])
        size = f", at most {LARGEST:g} in size" if np.isfinite(values[at]) else ""
        raise InvalidValue(f"{path}{list(at) if at else ''}", float(values[at]), f"must be a finite number{size}")


_HELD = {"whole": "whole numbers", "flag": "bools", "text": "texts", "any": "numbers, bools or texts"}


def table_of(path: str, value: object) -> dict[str, Any]:
    """Validate a table (mapping) and return it as a new dict."""
    if not isinstance(value, Mapping):
        raise InvalidValue(path, value, "must be a table")
    return dict(value)


def known_keys(path: str, table: Mapping[str, Any], allowed: Iterable[str], what: str = "key") -> None:
    """Raise UnknownKey for the first key in ``table`` that is not in ``allowed``."""
    allowed = tuple(allowed)
    for key in table:
        if key not in allowed:
            raise UnknownKey(joined(path, str(key)), allowed, what)


def needed(path: str, table: Mapping[str, Any], key: str, allowed: str) -> Any:
    """Return ``table[key]``; raise MissingKey if it is missing. allowed: description of the value for the message."""
    if key not in table:
        raise MissingKey(joined(path, key), allowed)
    return table[key]


def made(path: str, kind: type[T], value: object, *, prefix: str | None = None, **must: str) -> T:
    """Create an instance of the dataclass ``kind`` from a table of its fields. prefix: key path that is added to errors
    of the class; default ``path``. must: descriptions of the values of required fields, by name, for messages.
    """
    table = table_of(path, value)
    known_keys(path, table, names_of(kind))
    for key, allowed in must.items():
        needed(path, table, key, allowed)
    with under(path if prefix is None else prefix):
        return kind(**table)


def names_of(kind: Any) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass."""
    return tuple(field.name for field in dataclasses.fields(kind))


def changed(item: Any) -> dict[str, Any]:
    """Return a dict of those fields of the dataclass instance `item` whose values differ from the defaults."""
    own = {field.name: (getattr(item, field.name), field.default) for field in dataclasses.fields(item)}
    return {name: value for name, (value, default) in own.items() if value != default}
