"""Views of float32, uint8 and bool arrays for kernels that Python runs: elements have the types of compiled kernels.

NumPy computes with uint8 in 8 bits and with float32 in 32 bits, and its truth values are not numbers. In a kernel an
element is a float64, a 64-bit integer or a truth value.
"""

from typing import Any

import numpy as np

READ = {"f": np.float64, "B": np.int64, "?": bool}
"""Type of an element that is read, by the NumPy dtype character of the array."""


class Widened(np.ndarray[Any, Any]):
    """View of an array of float32, uint8 or bool whose elements are read as float64, int64 or bool."""

    def __getitem__(self, at: Any) -> Any:
        """Return an element as float64, int64 or bool; slices remain views."""
        found = super().__getitem__(at)
        return found if isinstance(found, np.ndarray) else READ[self.dtype.char](found)

    def __setitem__(self, at: Any, value: Any) -> None:
        """Store an element as compiled code does; of an integer, a uint8 array stores the low 8 bits."""
        whole = self.dtype.char == "B" and isinstance(value, int | np.integer)
        super().__setitem__(at, int(value) & 255 if whole else value)


def widened(item: Any) -> Any:
    """Return a kernel argument with each array of float32, uint8 or bool, also within tuples, as a `Widened` view."""
    if type(item) is np.ndarray:
        return item.view(Widened) if item.dtype.char in READ and item.dtype.isnative and item.ndim > 0 else item
    if not isinstance(item, tuple):
        return item
    parts = [widened(part) for part in item]
    if all(one is other for one, other in zip(parts, item, strict=True)):
        return item
    return type(item)._make(parts) if hasattr(item, "_make") else tuple(parts)
