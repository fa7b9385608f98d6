"""Arrays of lanes: if an annotation declares that x holds lanes, `x[k]` in a kernel is element k of every lane.

    @kernel
    def axpy(lane, n, x: Lanes, y: Lanes, scale):
        for k in range(n):
            y[k] += scale * x[k]

`Lanes` annotates parameters, assignments and fields of named tuples. Annotations of a named tuple's fields apply if a
parameter or an assignment is annotated with the tuple's class (`w: Work`), or if the kernel makes the tuple. Other
names of a lane array, its slices `x[i:]`, tuples with it and results of `stack` hold lanes, too. If a kernel is called,
the annotations of the called kernel apply to its arguments. The kernel's argument `lane` sets the number of lanes. In
uncompiled mode there is one lane, for which NumPy's indexing gives the same result.
"""

from __future__ import annotations

import types
import typing
from functools import cache
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Lanes: TypeAlias = Annotated[NDArray[np.float64], "lanes"]
"""Contiguous float64 array whose element k is the vector of entry k of all lanes."""


def is_lanes(annotation: Any) -> bool:
    """Return whether an annotation (an object or a string) is `Lanes` or a union that contains `Lanes`."""
    if isinstance(annotation, str):
        return any(part.strip().rpartition(".")[2] == "Lanes" for part in annotation.split("|"))
    if isinstance(annotation, typing.ForwardRef):
        return is_lanes(annotation.__forward_arg__)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return any(map(is_lanes, typing.get_args(annotation)))
    return annotation == Lanes


@cache
def lane_parameters(function: Any) -> dict[str, bool]:
    """Return a dict of the annotated parameters of a Python function: True for `Lanes`, False for other types."""
    return {name: is_lanes(one) for name, one in function.__annotations__.items() if name != "return"}


@cache
def lane_fields(cls: Any) -> frozenset[str]:
    """Return the names of the fields of a named tuple class, base classes included, that are annotated with `Lanes`."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        found.update(vars(base).get("__annotations__", {}))
    return frozenset(name for name, one in found.items() if name in cls._fields and is_lanes(one))
