"""Scenes: what an arm goes through (``definition``), and their TOML files (``toml``)."""

from flexarm_env.scene.definition import JointTorque, Load, Motion, PointLoad, Scene

__all__ = ["Scene", "Motion", "JointTorque", "PointLoad", "Load"]
