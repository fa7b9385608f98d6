"""Geometry of arms: inverse kinematics, deflections from poses, and shapes to draw."""
