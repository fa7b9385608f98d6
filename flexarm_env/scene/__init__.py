"""Scenes: what an arm goes through (``definition``, ``drives``), and their TOML files (``toml``)."""

from flexarm_env.scene.definition import Scene, standing_scene
from flexarm_env.scene.drives import JointTorque, Load, Motion, PointLoad

__all__ = ["Scene", "Motion", "JointTorque", "PointLoad", "Load", "standing_scene"]
