"""Checks of values that come from users, and the one shape of their error messages.

Every message reads ``key.path = value: what is allowed``, e.g.
``links[0].section.EI = -1.0: must be a positive number (N m^2)``.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import numbers
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


class InvalidValue(ValueError):
    """A value that is not allowed: ``path`` (key path), ``value``, ``allowed`` (a sentence).

    It is a ``ValueError``; an outer reader may put its own key in front with :func:`under`.
    """

    def __init__(self, path: str, value: object, allowed: str) -> None:
        super().__init__(path, value, allowed)
        self.path = path
        self.value = value
        self.allowed = allowed

    def __str__(self) -> str:
        return f"{self.path} = {shown(self.value)}: {self.allowed}"


class UnknownKey(ValueError):
    """A key that does not exist: ``path`` (its key path) and ``allowed`` (the keys that do)."""

    def __init__(self, path: str, allowed: Iterable[str], what: str = "key", hint: str = "") -> None:
        allowed = tuple(allowed)
        super().__init__(path, allowed, what, hint)
        self.path = path
        self.allowed = allowed
        self.what = what
        self.hint = hint

    def __str__(self) -> str:
        last = self.path.rsplit(": ", 1)[-1].rsplit(".", 1)[-1]
        near = difflib.get_close_matches(last, self.allowed, n=1, cutoff=0.7)
        hint = self.hint or (f"did you mean {near[0]}?" if near else "")
        hint = hint and f" ({hint})"
        return f"{self.path}: unknown {self.what}{hint}; allowed: {', '.join(self.allowed) or 'none'}"


class UnknownArgument(UnknownKey, TypeError):
    """A keyword argument that does not exist; a TypeError too, in the words that Python itself has for it.

    `gymnasium.make` raises it again with a text alone.
    """

    def __init__(self, path: str, allowed: Iterable[str] = (), what: str = "argument", hint: str = "") -> None:
        super().__init__(path, allowed, what, hint)

    def __str__(self) -> str:
        return f"{super().__str__()}; got an unexpected keyword argument {self.path!r}" if self.allowed else self.path


class MissingKey(ValueError):
    """A key that must be given: ``path`` (its key path) and ``allowed`` (what belongs there)."""

    def __init__(self, path: str, allowed: str) -> None:
        super().__init__(path, allowed)
        self.path = path
        self.allowed = allowed

    def __str__(self) -> str:
        return f"{self.path}: missing; {self.allowed}"


def lacking(what: str, package: str, extra: str) -> str:
    """What to install where a package is missing; its own name, since not everybody has this one from an index."""
    return f'{what} needs {package}: pip install {package} (the extra "{extra}" of flexarm_env brings all of its kind)'


def shown(value: object) -> str:
    """A short text of a value for a message."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    text = repr(value)
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
    except InvalidValue as error:
        raise InvalidValue(joined(prefix, error.path), error.value, error.allowed) from None
    except UnknownKey as error:
        raise UnknownKey(joined(prefix, error.path), error.allowed, error.what, error.hint) from None
    except MissingKey as error:
        raise MissingKey(joined(prefix, error.path), error.allowed) from None


def in_file(path: str | os.PathLike[str] | None) -> contextlib.AbstractContextManager[None]:
    """Say which file it is about, as ``file: key.path``, in an error raised inside the block; None: no file."""
    return under("" if path is None else f"{os.fspath(path)}: ")


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
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise InvalidValue(path, value, allowed)
    result = float(value)
    if (
        not math.isfinite(result)
        or (minimum is not None and result < minimum)
        or (above is not None and result <= above)
        or (maximum is not None and result > maximum)
    ):
        raise InvalidValue(path, value, allowed)
    return result


def limits(path: str, value: object, unit: str = "", **bounds: float) -> tuple[float, float]:
    """``value`` as two numbers (low, high), low at most high; bounds as in :func:`number`."""
    low, high = sequence(path, value, f"two numbers{f' ({unit})' if unit else ''}, (low, high)", 2)
    low, high = number(f"{path}[0]", low, unit, **bounds), number(f"{path}[1]", high, unit, **bounds)
    if low > high:
        raise InvalidValue(path, (low, high), "must be (low, high) with low at most high")
    return low, high


def integer(path: str, value: object, *, minimum: int, maximum: int | None = None) -> int:
    """``value`` as an int within inclusive limits. A bool, a float or a string is none."""
    limits = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
    allowed = f"must be a whole number, {limits}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
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


def instance(path: str, value: object, kind: type[T]) -> T:
    """``value`` as an object of the class ``kind``."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise InvalidValue(path, value, f"must be {article} {kind.__name__}")
    return value


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


def array(
    path: str, values: object, shape: tuple[int | str, ...], what: str = ""
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """``values`` as a float64 array of finite numbers; a word in ``shape``: any length from 1 on."""
    words = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)}){what and ', '}{what}"
    try:
        result = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(path, values, f"must be numbers of shape {words}") from None
    given = result.shape
    if len(given) != len(shape) or any(
        one != wanted if isinstance(wanted, int) else one < 1 for one, wanted in zip(given, shape, strict=True)
    ):
        raise InvalidValue(f"shape of {path}", given, f"must be {words}")
    if not np.isfinite(result).all():
        at = tuple(int(k) for k in np.argwhere(~np.isfinite(result))[0])
        raise InvalidValue(f"{path}{list(at)}", float(result[at]), "must be a finite number")
    return result


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
