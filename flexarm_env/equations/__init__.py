"""Equations of motion of a simulated arm with exact derivatives: mass, damping and stiffness matrices at a point."""

from .motion import Equations, at_rest_of
from .reduced import Point, Reduced, point_of, undamped

__all__ = ["Equations", "Point", "Reduced", "at_rest_of", "point_of", "undamped"]
