"""How an arm moves: compiled functions, no allocation in the step, no Python objects."""

from . import floating_frame

__all__ = ["floating_frame"]
