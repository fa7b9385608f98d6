"""What derivatives are compared with: central differences."""

from collections.abc import Callable
from typing import Any

WEIGHTS = {2: (1.0 / 2.0,), 4: (2.0 / 3.0, -1.0 / 12.0), 6: (3.0 / 4.0, -3.0 / 20.0, 1.0 / 60.0)}


def central(f: Callable[[float], Any], e: float, order: int = 6) -> Any:
    """df/ds of f(s) at s = 0 by steps of e."""
    return sum(weight / e * (f(m * e) - f(-m * e)) for m, weight in enumerate(WEIGHTS[order], 1))
