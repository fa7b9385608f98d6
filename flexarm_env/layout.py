"""Layouts of flat arrays: a declaration defines how NumPy packs fields, and at which offsets kernels find them.

    ELEMENT = Layout("Element", "", Field("EA", (), "N/m", "EA / l"), Field("G", (4, 4), "1/m", "of eq. [45]"))
    BODY = Layout(
        "Body", "n, elements", Field("length", (), "m", "of the body"), Field("c", ("n",), "kg m", "..."), Field("G",
        ("n", "n"), "kg", "..."), Field("elements", ("elements", ELEMENT.length), "", "an `ELEMENT` each"),
    )
    block = BODY.pack({"n": 3, "elements": 1}, length=1.0, c=c, G=G, elements=...)
    BODY.unpack(block, n=3, elements=1)["G"]                              views of `block`, in their shapes

In kernels, `body_at = kernel(BODY.offsets)` is a function (first, n, elements) of integer arithmetic. The function
returns a named tuple with the start of each field: `at = body_at(p, n, e)`, then `data[at.G + i * n + j]`; `at.end` is
the end of the layout. The function `kernel(BODY.views)` has the arguments (flat, first, n, elements) and returns a
named tuple of slices of `flat`. A layout without sizes has `places`, a named tuple of numbers: after `AT =
ELEMENT.places` in the kernel's module, `AT.G` in the kernel is a compiled constant.
"""

from __future__ import annotations

import linecache
import math
from collections import namedtuple
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Field(NamedTuple):
    """A field of a layout. shape: lengths of the axes, as numbers or expressions in the sizes; () for one number."""

    name: str
    shape: tuple[int | str, ...]
    unit: str
    meaning: str

    @property
    def amount(self) -> str:
        """Number of entries of the field, as an expression in the layout's sizes."""
        return " * ".join(f"({part})" for part in self.shape) or "1"


class Layout:
    """A sequence of fields in a flat array.

    Args:
        name: class name of the named tuples of offsets and views. sizes: names of the sizes, for example "n, elements";
            "" for none.
        fields: the fields in order; an array is stored by rows.
    Attributes:
        length: number of entries of the layout, as an expression in the sizes.
        offsets: function of (first, *sizes) that returns a named tuple with the start of each field and the end of the
            layout.
        views: function of (flat, first, *sizes) that returns a named tuple of one-dimensional slices.
        shapes: function of (**sizes) that returns the fields' shapes as numbers.
        places: `offsets(0)` if the layout has no sizes; otherwise None.
    Raises:
        ValueError: two fields have one name, or a field is named `end`.
    """

    def __init__(self, name: str, sizes: str, *fields: Field) -> None:
        """Generate the functions that compute offsets, views and shapes for given sizes.

        name: name of the layout. sizes: names of the layout's sizes, for example "rows, lanes". Raises ValueError if a
        field occurs twice.
        """
        self.name, self.fields = name, fields
        self.sizes = tuple(word.strip() for word in sizes.split(",") if word.strip())
        names = [field.name for field in fields]
        twice = [word for k, word in enumerate(names) if word in (*names[:k], "end")]
        if twice:
            raise ValueError(f"layout {name}: field {twice[0]!r} is there twice, or is a name that is taken")
        self.length = "(" + (" + ".join(field.amount for field in fields) or "0") + ")"
        lines = ["_0 = _first"]
        lines += [f"_{k + 1} = _{k} + {field.amount}" for k, field in enumerate(fields)]
        ends = range(len(fields))
        begins = ", ".join(f"_{k}" for k in range(len(fields) + 1))
        slices = ", ".join(f"_flat[_{k} : _{k + 1}]" for k in ends) + ","
        parts = ", ".join(f"{field.name!r}: {_part(k, field)}" for k, field in enumerate(fields))
        arguments = ["_first", *self.sizes]
        scope: dict[str, Any] = {
            "Offsets": namedtuple(name, [*names, "end"]),
            "Views": namedtuple(name, names),
        }
        # kernels see the fields of lanes as lane arrays
        lanes = {field.name: "Lanes" for field in fields if field.shape and field.shape[-1] == "lanes"}
        scope["Views"].__annotations__ = {name: lanes.get(name, "np.ndarray") for name in names}
        self.offsets = _function(f"{name}_offsets", arguments, lines, f"Offsets({begins})", scope)
        self.views = _function(f"{name}_views", ["_flat", *arguments], lines, f"Views({slices})", scope)
        self._unpacking = f"{name}_fields", ["_flat", *arguments], lines, f"{{{parts}}}"
        self.places: Any = None if self.sizes else self.offsets(0)
        shapes = [f"({''.join(f'int({part}), ' for part in field.shape)})" for field in fields]
        self.shapes = _function(f"{name}_shapes", [*self.sizes], [], f"[{', '.join(shapes)}]", scope)

    def pack(self, sizes: Mapping[str, int], /, **values: Any) -> NDArray[np.float64]:
        """Pack the values of all fields into a flat array.

        Raises:
            ValueError: a field is missing or unknown, or a value has a wrong number of entries.
        """
        known = {field.name for field in self.fields}
        if known != set(values):
            wrong = sorted(known ^ set(values))
            raise ValueError(f"layout {self.name}: {wrong[0]!r} is {'missing' if wrong[0] in known else 'not a field'}")
        parts = [np.zeros(0)]
        for field, shape in zip(self.fields, self.shapes(**sizes), strict=True):
            value = np.asarray(values[field.name], dtype=np.float64)
            if value.size != math.prod(shape) or (value.ndim == len(shape) and value.shape != shape):
                raise ValueError(f"layout {self.name}: {field.name} has shape {value.shape}, must have {shape}")
            parts.append(value.ravel())
        return np.concatenate(parts)

    @cached_property
    def _fields(self) -> Any:
        """Function that `unpack` calls; it is generated at the first call."""
        return _function(*self._unpacking, {})

    def unpack(self, flat: NDArray[np.float64], first: int = 0, /, **sizes: int) -> dict[str, NDArray[np.float64]]:
        """Return views of the fields in their shapes, by name; the layout begins at flat[..., first]."""
        found: dict[str, NDArray[np.float64]] = self._fields(flat, first, *[sizes[word] for word in self.sizes])
        return found

    def __str__(self) -> str:
        """Describe each field in one line: name, shape, unit, meaning."""
        rows = [(f.name, f"({', '.join(map(str, f.shape))})", f.unit, f.meaning) for f in self.fields]
        widths = [max(len(row[k]) for row in rows) for k in range(3)]
        return "\n".join("  ".join([*(row[k].ljust(widths[k]) for k in range(3)), row[3]]) for row in rows)


def _part(k: int, field: Field) -> str:
    """Return the source text of an expression that gives a view of field k in its shape."""
    if len(field.shape) < 2:
        return f"_flat[..., _{k} : _{k + 1}]" if field.shape else f"_flat[..., _{k}]"
    shape = ", ".join(f"int({part})" for part in field.shape)
    return f"_flat[..., _{k} : _{k + 1}].reshape((*_flat.shape[:-1], {shape}))"


def _function(name: str, arguments: list[str], lines: list[str], result: str, scope: dict[str, Any]) -> Any:
    """Make a function from its source lines, so that the compiler can make a kernel of it."""
    body = "".join(f"    {line}\n" for line in [*lines, f"return {result}"])
    text, file = f"def {name}({', '.join(arguments)}):\n{body}", f"<layout {name} {len(linecache.cache)}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file  # where a kernel's text is looked for
    scope = {**scope, "__name__": __name__, "__file__": __file__}
    exec(compile(text, file, "exec"), scope)
    return scope[name]
