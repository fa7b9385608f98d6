"""Scenes: an arm with its initial state, motions, loads and contacts, and the TOML files of scenes."""

from flexarm_env.scene.contacts import Contact, contacts_of, touching_points
from flexarm_env.scene.definition import Scene, standing_scene
from flexarm_env.scene.drives import InnerLoad, JointTorque, Load, Motion, PointLoad
from flexarm_env.scene.mesh import default_mesh, divided, halved_mesh
from flexarm_env.scene.plane import InPlane, computed, in_plane
from flexarm_env.scene.points import at_points
from flexarm_env.scene.resolution import resolving_step

__all__ = [
    "Scene", "Motion", "JointTorque", "PointLoad", "Load", "InPlane", "computed", "in_plane", "standing_scene",
    "default_mesh", "divided", "halved_mesh", "resolving_step", "Contact", "contacts_of",
    "at_points", "touching_points", "InnerLoad",
]  # fmt: skip
