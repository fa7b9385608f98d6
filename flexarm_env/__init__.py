"""Flexible robot arms: planar beam mechanics, scene replay and Gymnasium environments."""

__version__ = "0.1.0"
