"""Geometry of arms: inverse kinematics in the plane and in space, rigid statics in space, and shapes to draw."""
