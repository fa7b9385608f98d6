"""Scenes: what an arm goes through (``definition``, ``drives``), in which plane (``plane``), and files (``toml``)."""

from flexarm_env.scene.definition import Scene, standing_scene
from flexarm_env.scene.drives import JointTorque, Load, Motion, PointLoad
from flexarm_env.scene.plane import InPlane, computed, in_plane

__all__ = [
    "Scene", "Motion", "JointTorque", "PointLoad", "Load", "InPlane", "computed", "in_plane", "standing_scene",
]  # fmt: skip
