"""Output arrays of compiled code, returned as NumPy views that are created once for each array.

A caller of `step` gets views of an array. When no caller refers to any of the array's views, the next step reuses the
array with the same views.
"""

from collections.abc import Iterable, Mapping
from sys import getrefcount
from typing import Any

import numpy as np


class Sheet:
    """An output array with its views.

    Attributes:
        array: the array, which owns its memory. address: address of the array's first number. told: dict of results for
            the caller by name, including views of the array. others: further views of the array.
    """

    __slots__ = ("_alone", "_views", "address", "array", "others", "told")

    def __init__(self, array: Any) -> None:
        self.array, self.address = array, int(array.__array_interface__["data"][0])
        self.show({}, ())

    def show(self, told: Mapping[str, Any], others: Iterable[Any]) -> None:
        """Set the results, with views of the array, that a caller gets.

        told: dict of results by name. others: further views of the array.
        """
        self.told, self.others = dict(told), tuple(others)
        # views of this array only: other objects have owners elsewhere
        self._views = [one for one in (*self.told.values(), *self.others) if getattr(one, "base", None) is self.array]
        self._alone = _BARE + _EACH * len(self._views)

    def is_free(self) -> bool:
        """Return whether, by the reference counts, no other object refers to the array or to one of its views."""
        return self.count() == self._alone

    def count(self) -> int:
        """Return the sum of the reference counts of the array and of its views. The sum also counts slices of the
        views."""
        return getrefcount(self.array) + sum(map(getrefcount, self._views))


# placeholders while `_measure` makes its first sheets
_BARE, _EACH = 0, 0


def _measure() -> tuple[int, int]:
    """Return (reference count of an array that nobody else holds, increment per view) in this version of Python."""
    counts = []
    for n in (0, 1, 2):
        sheet = Sheet(np.zeros((3, 2)))
        sheet.show({str(k): sheet.array[k] for k in range(n)}, ())
        counts.append(sheet.count())
    bare, one, two = counts
    assert one - bare == two - one, "references are counted in another way than assumed"
    return bare, one - bare


_BARE, _EACH = _measure()
