"""Equations of motion of an arm with exact derivatives: mass, damping and stiffness matrices about a state."""

from .motion import Equations, at_rest_of
from .reduced import Point, Reduced, point_of, undamped

__all__ = ["Equations", "Point", "Reduced", "at_rest_of", "point_of", "undamped"]
