"""Convert runs that were computed in a plane to runs in space, with positions and rotations in space."""

import dataclasses

import numpy as np

from .. import rotations
from ..scene import Scene, in_plane
from ..validation import Array
from .recorded import Trajectory


def placed(run: Trajectory, scene: Scene) -> Trajectory:
    """Convert a planar run of a spatial scene to a run in space; return any other run unchanged.

    Scenes whose motion stays in a plane are computed in the plane of the motion (`scene.computed`). scene: the spatial
    scene.
    """
    flat = in_plane(scene)
    if flat is None:
        return run
    inside, normal = flat.axes[:, :2].T, flat.axes[:, 2]
    n, N = len(run.t), scene.arm.n_links

    def lifted(points: Array) -> Array:
        return np.asarray(points[..., :2] @ inside + flat.height * normal)

    turned = rotations.matrices(run.link_angles[..., None] * np.array([0.0, 0.0, 1.0]))
    links = rotations.quaternions(flat.axes @ turned @ flat.frames[:, None])
    angles = {"joint_angles": run.joint_angles, "motor_angles": run.motor_angles}
    rates = {"joint_rates": run.joint_rates, "motor_rates": run.motor_rates, "joint_torque": run.joint_torque}
    joints = {name: (values - flat.offsets) * flat.signs for name, values in angles.items()}
    joints |= {name: values * flat.signs for name, values in rates.items()}
    if scene.root == "free":  # nothing is there to turn the first joint from, and it stays
        joints["joint_angles"][:, 0] = joints["motor_angles"][:, 0] = scene.angles[0]
        joints["joint_rates"][:, 0] = joints["motor_rates"][:, 0] = 0.0
    known = {f.name: getattr(run, f.name) for f in dataclasses.fields(run) if f.name != "link_angles"}
    known |= joints | {name: lifted(getattr(run, name)) for name in ("start", "tip", "hinges", "shapes")}
    spin = run.tip_velocity[:, 2:] * normal
    known |= {
        "scene": scene, "tip_velocity": np.hstack([run.tip_velocity[:, :2] @ inside, spin]),
        "tip_deflection": run.tip_deflection[..., None] * flat.frames[:, 1, 1:], "twist": np.zeros((n, N)),
        "link_rotations": links, "tip_rotation": links[:, -1, 1].copy(), "unresolved_damping": np.zeros(n),
    }  # fmt: skip
    return Trajectory(**known)
