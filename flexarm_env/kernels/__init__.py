"""How an arm moves: compiled functions, no allocation in the step, no Python objects."""

from . import elastica, exact_beam, floating_frame

__all__ = ["elastica", "exact_beam", "floating_frame"]
