"""Checks of values that come from users, and the one shape of their error messages.

Every message reads ``key.path = value: what is allowed``, e.g.
``links[0].section.EI = -1.0: must be a positive number (N m^2)``.
"""

import contextlib
import dataclasses
import difflib
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Array = NDArray[np.float64]
"""Numbers of double precision, in any shape; Array32: of single precision, as observations and actions are."""
Array32 = NDArray[np.float32]


class BadKey(ValueError):
    """Something wrong at a key path, ``path``; an outer reader may put its own key in front with :func:`under`."""

    def __init__(self, path: str, *more: object) -> None:
        super().__init__(path, *more)
        self.path = path


class InvalidValue(BadKey):
    """A value that is not allowed: ``path`` (key path), ``value``, ``allowed`` (a sentence)."""

    def __init__(self, path: str, value: object, allowed: str) -> None:
        super().__init__(path, value, allowed)
        self.value, self.allowed = value, allowed

    def __str__(self) -> str:
        return f"{self.path} = {shown(self.value)}: {self.allowed}"


class UnknownKey(BadKey):
    """A key that does not exist: ``path`` (its key path) and ``allowed`` (the keys that do)."""

    def __init__(self, path: str, allowed: Iterable[str], what: str = "key", hint: str = "") -> None:
        self.allowed, self.what, self.hint = tuple(allowed), what, hint
        super().__init__(path, self.allowed, what, hint)

    def __str__(self) -> str:
        last = self.path.rsplit(": ", 1)[-1].rsplit(".", 1)[-1]
        near = difflib.get_close_matches(last, self.allowed, n=1, cutoff=0.7)
        hint = self.hint or (f"did you mean {near[0]}?" if near else "")
        hint = hint and f" ({hint})"
        path = self.path if len(self.path) <= 200 else f"{self.path[:197]}..."
        return f"{path}: unknown {self.what}{hint}; allowed: {', '.join(self.allowed) or 'none'}"


class UnknownArgument(UnknownKey, TypeError):
    """A keyword argument that does not exist; a TypeError too, in the words that Python itself has for it.

    `gymnasium.make` raises it again with a text alone.
    """

    def __init__(self, path: str, allowed: Iterable[str] = (), what: str = "argument", hint: str = "") -> None:
        super().__init__(path, allowed, what, hint)

    def __str__(self) -> str:
        return f"{super().__str__()}; got an unexpected keyword argument {self.path!r}" if self.allowed else self.path


class MissingKey(BadKey):
    """A key that must be given: ``path`` (its key path) and ``allowed`` (what belongs there)."""

    def __init__(self, path: str, allowed: str) -> None:
        super().__init__(path, allowed)
        self.allowed = allowed

    def __str__(self) -> str:
        return f"{self.path}: missing; {self.allowed}"


def lacking(what: str, package: str, extra: str) -> str:
    """What to install where a package is missing; its own name, since not everybody has this one from an index."""
    return f'{what} needs {package}: pip install {package} (the extra "{extra}" of flexarm_env brings all of its kind)'


@contextmanager
def needs(what: str, package: str, extra: str, error: type[Exception] = ImportError) -> Iterator[None]:
    """Around imports of a package that only some have: where it is missing, an `error` that says what to install."""
    try:
        yield
    except ImportError as missing:
        raise error(lacking(what, package, extra)) from missing


def installed(package: str) -> str | None:
    """Version of a package that is installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def shown(value: object) -> str:
    """A short text of a value for a message."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray) and value.ndim:  # one without axes is no number, and not to be taken for one
        value = value.tolist()
    try:
        text = repr(value)
    except ValueError:  # Python writes no number of more than some thousand digits
        text = f"a {type(value).__name__} of too many digits"
    return text if len(text) <= 100 else text[:97] + "..."


def joined(path: str, key: str) -> str:
    """Key path of ``key`` below ``path`` (either may be empty; no dot before ``[3]`` or after a colon)."""
    if not path or not key:
        return path or key
    return path + key if key.startswith("[") or path.endswith(": ") else f"{path}.{key}"


@contextlib.contextmanager
def under(prefix: str) -> Iterator[None]:
    """Put ``prefix`` in front of the key path of an error raised inside the block."""
    try:
        yield
    except BadKey as error:
        raise type(error)(joined(prefix, error.path), *error.args[1:]) from None


def in_file(path: str | os.PathLike[str] | None) -> contextlib.AbstractContextManager[None]:
    """Say which file it is about, as ``file: key.path``, in an error raised inside the block; None: no file."""
    return under("" if path is None else f"{os.fspath(path)}: ")


@contextmanager
def solvable(arm: str) -> Iterator[None]:
    """Around linear algebra with the matrices of an arm of this name: InvalidValue where rounding has undone them."""
    try:
        yield
    except np.linalg.LinAlgError:
        what = "masses, inertias, lengths and stiffnesses must lie nearer together for double precision"
        raise InvalidValue("arm", arm, what) from None


def store(item: object, **values: object) -> None:
    """Set fields of a frozen dataclass from within its ``__post_init__``."""
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
    """``value`` as a finite float. A bool, a string, NaN or infinity is none.

    ``minimum`` and ``maximum`` are inclusive, ``above`` is exclusive.
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
    except OverflowError:  # a whole number may be larger than any float
        result = math.inf
    if (
        not math.isfinite(result)
        or (minimum is not None and result < minimum)
        or (above is not None and result <= above)
        or (maximum is not None and result > maximum)
    ):
        raise InvalidValue(path, value, allowed)
    small, large = SIZES.get(unit, (1.0 / LARGEST, LARGEST))
    if unit and (abs(result) > large or (above == 0.0 and result < small)):
        least = f"at least {small:g} and " if above == 0.0 < small else ""
        raise InvalidValue(path, value, f"must be {least}at most {large:g} in size ({unit}), or powers of it overflow")
    return result


LARGEST = 1e30
"""Of numbers that have a unit, and of those in files, in size; one over it: the least of those that must be positive.
Beyond, products of a few of them are no floats any more, nor they float32."""
SIZES = {"m": (1e-9, 1e9), "s": (0.0, LARGEST)}
"""The same, least and largest: high powers are taken of lengths; how short a time may be is told by a run's steps."""


def limits(path: str, value: object, unit: str = "", **bounds: float) -> tuple[float, float]:
    """``value`` as two numbers (low, high), low at most high; bounds as in :func:`number`."""
    what = f"two numbers{f' ({unit})' if unit else ''}, (low, high)"
    low, high = numbers(path, value, what, 2, unit, **bounds)
    if low > high:
        raise InvalidValue(path, (low, high), "must be (low, high) with low at most high")
    return low, high


def integer(path: str, value: object, *, minimum: int, maximum: int | None = None) -> int:
    """``value`` as an int within inclusive limits. A bool, a float or a string is none."""
    limits = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
    allowed = f"must be a whole number, {limits}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, Integral):
        raise InvalidValue(path, value, allowed)
    result = int(value)
    if result < minimum or (maximum is not None and result > maximum):
        raise InvalidValue(path, value, allowed)
    return result


def flag(path: str, value: object) -> bool:
    """``value`` as a bool."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidValue(path, value, "must be True or False")
    return bool(value)


def text(path: str, value: object, *, empty: bool = True) -> str:
    """``value`` as a string."""
    if not isinstance(value, str) or (not empty and not value.strip()):
        raise InvalidValue(path, value, "must be a text" if empty else "must be a text that is not empty")
    return value


def choice(path: str, value: object, allowed: Sequence[str]) -> str:
    """``value`` as one of the given words."""
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(path, value, "must be one of " + ", ".join(f'"{a}"' for a in allowed))
    return value


def sequence(path: str, value: object, what: str, length: int | None = None) -> tuple[Any, ...]:
    """``value`` (list, tuple or one-dimensional array) as a tuple; ``what`` says what belongs in it."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    if not isinstance(value, list | tuple) or (length is not None and len(value) != length):
        raise InvalidValue(path, value, f"must be a sequence of {what}")
    return tuple(value)


def numbers(
    path: str, value: object, what: str, length: int | None = None, unit: str = "", **bounds: float
) -> tuple[float, ...]:
    """``value`` as a tuple of numbers: see :func:`sequence` and :func:`number`."""
    given = sequence(path, value, what, length)
    return tuple(number(f"{path}[{i}]", one, unit, **bounds) for i, one in enumerate(given))


def several(value: object) -> bool:
    """Whether this is a sequence, of whatever, and not one value."""
    row = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return row or (isinstance(value, np.ndarray) and value.ndim > 0)


def instance(path: str, value: object, kind: type[T]) -> T:
    """``value`` as an object of the class ``kind``."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise InvalidValue(path, value, f"must be {article} {kind.__name__}")
    return value


def instances(path: str, value: object, kind: type[T], what: str = "") -> tuple[T, ...]:
    """``value`` as a tuple of objects of the class ``kind``; ``what`` says so in other words than the class's name."""
    parts = sequence(path, value, what or kind.__name__)
    return tuple(instance(f"{path}[{i}]", part, kind) for i, part in enumerate(parts))


def column(path: str, values: object, unit: str = "") -> np.ndarray[Any, np.dtype[np.float64]]:
    """One column of a table as a float64 array (n,); the first row that is no finite number is named."""
    if isinstance(values, np.ndarray):
        if values.ndim != 1:
            raise InvalidValue(path, values, f"must be one-dimensional, not of shape {values.shape}")
        values = values.tolist()
    if not isinstance(values, list | tuple) or not values:
        raise InvalidValue(path, values, "must be a list of numbers that is not empty")
    for i, value in enumerate(values):
        try:
            number(f"{path}[{i}]", value, unit)
        except InvalidValue as error:
            raise InvalidValue(error.path, value, f"{error.allowed}, in row {i} of the table") from None
    return np.array(values, dtype=np.float64)


Shape = tuple[int | str, ...]
"""Lengths; a word: any from 1 on, the same wherever the word stands."""


def floats(path: str, values: Any, what: str = "numbers") -> Array:
    """``values`` as float64, finite or not, of any shape."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        return np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InvalidValue(path, values, f"must be {what}") from None


def array(path: str, values: object, shape: Shape, what: str = "") -> np.ndarray[Any, np.dtype[np.float64]]:
    """``values`` as a float64 array of finite numbers; a word in ``shape``: any length from 1 on."""
    result = floats(path, values, f"numbers of shape {_words(shape, {})}{what and ', '}{what}")
    _fits(path, result, "finite", shape, {}, what)
    return result


KINDS = {"finite": "fiu", "number": "fiu", "whole": "iu", "flag": "b", "text": "U", "any": "fiubU"}
"""What an array holds, by NumPy's kinds of dtype."""


def arrays(
    given: Mapping[str, np.ndarray[Any, Any]], table: Mapping[str, tuple[str, Shape]], sizes: dict[str, int]
) -> dict[str, Any]:
    """The arrays that a table declares, each held against the others: ValueError for the first that does not fit.

    Args:
        given: by name. table: of each the word of :data:`KINDS` and the shape; a shape that ends in "...": any further.
        sizes: lengths by the words in shapes, as far as they are known; those found are added.
    """
    for name, (kind, shape) in table.items():
        _fits(name, needed("", given, name, f"must be an array of shape {_words(shape, sizes)}"), kind, shape, sizes)
    return {name: given[name] for name in table}


def _words(shape: Shape, sizes: Mapping[str, int]) -> str:
    return f"({', '.join(str(sizes.get(str(k), k)) for k in shape)}{',' * (len(shape) == 1)})"


def _fits(
    path: str, values: np.ndarray[Any, Any], kind: str, shape: Shape, sizes: dict[str, int],
    what: str = "to fit the other arrays",
) -> None:  # fmt: skip
    """InvalidValue for an array of another kind or shape, or with an entry that is not finite."""
    if values.dtype.kind not in KINDS[kind]:
        raise InvalidValue(f"dtype of {path}", str(values.dtype), f"must be that of {_HELD.get(kind, 'numbers')}")
    wanted = (*shape[:-1], *values.shape[len(shape) - 1 :]) if shape[-1:] == ("...",) else shape
    bound = tuple(sizes.get(k, 0) if isinstance(k, str) else k for k in wanted)
    known = tuple(not isinstance(k, str) or k in sizes for k in wanted)
    if values.ndim != len(bound) or not all(
        one == length if fixed else one > 0 for one, length, fixed in zip(values.shape, bound, known, strict=True)
    ):
        raise InvalidValue(f"shape of {path}", values.shape, f"must be {_words(shape, sizes)}{what and ', '}{what}")
    sizes.update((k, n) for k, n in zip(wanted, values.shape, strict=True) if isinstance(k, str))
    if kind == "finite" and not (fine := np.abs(np.asarray(values, np.float64)) <= LARGEST).all():
        at = tuple(int(k) for k in np.argwhere(~fine)[0])
        size = f", at most {LARGEST:g} in size" if np.isfinite(values[at]) else ""
        raise InvalidValue(f"{path}{list(at) if at else ''}", float(values[at]), f"must be a finite number{size}")


_HELD = {"whole": "whole numbers", "flag": "bools", "text": "texts", "any": "numbers, bools or texts"}


def table_of(path: str, value: object) -> dict[str, Any]:
    """``value`` as a TOML table."""
    if not isinstance(value, Mapping):
        raise InvalidValue(path, value, "must be a table")
    return dict(value)


def known_keys(path: str, table: Mapping[str, Any], allowed: Iterable[str], what: str = "key") -> None:
    """Every key of ``table`` is allowed, or an error that names the first that is not."""
    allowed = tuple(allowed)
    for key in table:
        if key not in allowed:
            raise UnknownKey(joined(path, str(key)), allowed, what)


def needed(path: str, table: Mapping[str, Any], key: str, allowed: str) -> Any:
    """``table[key]``, or an error that says what belongs there."""
    if key not in table:
        raise MissingKey(joined(path, key), allowed)
    return table[key]


def made(path: str, kind: type[T], value: object, *, prefix: str | None = None, **must: str) -> T:
    """A dataclass of the class ``kind`` from a table of its fields.

    prefix: of what the class itself refuses, ``path`` unless given. must: what belongs in fields that must be given.
    """
    table = table_of(path, value)
    known_keys(path, table, names_of(kind))
    for key, allowed in must.items():
        needed(path, table, key, allowed)
    with under(path if prefix is None else prefix):
        return kind(**table)


def names_of(kind: Any) -> tuple[str, ...]:
    """Names of a dataclass's fields."""
    return tuple(field.name for field in dataclasses.fields(kind))


def changed(item: Any) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults, by name."""
    own = {field.name: (getattr(item, field.name), field.default) for field in dataclasses.fields(item)}
    return {name: value for name, (value, default) in own.items() if value != default}
