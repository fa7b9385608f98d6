"""Recorded simulations in space: a `Trajectory` with positions of three components, and with rotations."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import rotations
from ..physics.gauges import Spot, curvatures
from ..physics.space.reading import read, tips
from ..scene import Scene, in_plane
from ..sensors import MEASURES, Sensors
from ..settings import Settings
from ..validation import Array
from .recorded import ARRAYS, Trajectory

_QUATERNION = "wxyz"


@dataclass(repr=False)
class SpatialTrajectory(Trajectory):
    """Recorded simulation in space of an arm with N links at n instants, in SI units.

    Only the attributes that differ from those of :class:`Trajectory` are listed.

    Attributes:
        start, tip (n, 3): positions of the root of link 0 and of the tip of the last link, m.
        tip_rotation (n, 4): quaternion (w, x, y, z), w >= 0, of the tip's axes, whose x axis points along the link.
        tip_velocity (n, 6): velocity, m/s, and angular velocity, rad/s, of the tip, in inertial axes.
        hinges (n, N-1, 3): positions of joints 1 to N-1, m. joint_angles, joint_rates (n, N): angles, rad, and rates,
            rad/s, about the joints' axes.
        tip_deflection (n, N, 2): displacement of each link's tip along the y and z axes at the link's root, divided by
            the link's length; 0 for rigid links.
        twist (n, N): rotation of each link's tip about the x axis of the link's root, relative to the root, rad.
        link_rotations (n, N, 2, 4): quaternions (w, x, y, z) of the axes at each link's root and tip.
        shapes (n, points, 3): points along the arm's center line from root to tip, m.
        unresolved_damping (n,): energy dissipated by the damping forces since the start minus `dissipated`, J. This
            difference is due to strain rates within steps, which differ from the rates at the ends of steps by a term
            of second order in the step. `balance` includes the difference, which is large only in stiff links with
            damping.
        q, v (n, rows): the solver's coordinates (positions, rotation vectors and joint angles) and their time
            derivatives. For a rotation, v contains the angular velocity in the section's own axes, rad/s. If the motion
            was computed in a plane (`scene.plane.in_plane`), q and v are the coordinates and rates of the planar run.
    """

    tip_rotation: Array = field(default_factory=lambda: np.zeros((0, 4)))
    twist: Array = field(default_factory=lambda: np.zeros((0, 0)))
    link_rotations: Array = field(default_factory=lambda: np.zeros((0, 0, 2, 4)))
    unresolved_damping: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Set the attribute `unresolved_damping` to zero at all instants if it was not given."""
        if not np.size(self.unresolved_damping):
            self.unresolved_damping = np.zeros(np.size(self.t))

    @property
    def balance(self) -> Array:
        """Energy error (n,), J: change of `energy` + `dissipated` + `unresolved_damping` - `work`."""
        return np.asarray(super().balance + self.unresolved_damping - self.unresolved_damping[0])

    @classmethod
    def read(cls, simulation: Any, fields: Mapping[str, Array], shapes: Array) -> dict[str, Any]:
        """Compute the attributes that differ between plane and space from the arrays of `Simulation.record`."""
        found = read(simulation.scene.arm, simulation.settings, fields["q"], fields["v"])
        return {"deflection_bound": math.inf, "unresolved_damping": fields["beyond"], **found}

    @classmethod
    def read_tips(cls, scene: Scene, settings: Settings, fields: Mapping[str, Array]) -> Array:
        """Return the tip's positions and axes (n, 4, 3), from which errors are estimated. fields: as in `read`."""
        return tips(scene.arm, settings, fields["q"])

    @property
    def compared_tips(self) -> Array:
        """The tip's positions and axes as `read_tips` returns them."""
        return tips(self.scene.arm, self.settings, self.q)

    def columns(self) -> dict[str, Array]:
        """Return the columns that `to_csv` writes, as arrays (n,) by name.

        The columns are time, energy, positions, the tip's quaternion, joint angles, deflections and twist.
        """
        table = {"t": self.t, "energy": self.energy}
        places = {"start": self.start, "tip": self.tip}
        places |= {f"hinge{k + 1}": self.hinges[:, k] for k in range(self.hinges.shape[1])}
        for name, values in places.items():
            table |= {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
        table |= {f"tip_q{axis}": self.tip_rotation[:, i] for i, axis in enumerate(_QUATERNION)}
        for k in range(self.scene.arm.n_links):
            table |= {f"joint{k}": self.joint_angles[:, k], f"twist{k}": self.twist[:, k]}
            table |= {f"deflection{k}_{axis}": self.tip_deflection[:, k, i] for i, axis in enumerate("yz")}
        return table

    def _curvature(self, places: Sequence[Spot]) -> Array:
        """Return curvatures (samples, places), 1/m; for an arm that moves in a plane, those of its planar scene."""
        flat = in_plane(self.scene)
        if flat is None:
            return super()._curvature(places)
        found = curvatures(flat.scene, self.settings, self.names, [spot[:2] for spot in places], self.q)
        shares = [(*flat.frames[spot[0]][1, 1:], 0.0)[MEASURES.index((*spot, "xy")[2])] for spot in places]
        return np.asarray(found * np.array(shares))

    def _tip_inputs(self, sensors: Sensors) -> list[Array]:
        """Return the tip's position, rotation and rates, which accelerometer, gyroscope and camera read."""
        turn = rotations.of_quaternions(self.tip_rotation)
        A = rotations.matrices(turn)
        spin, inputs = rotations.back(A, self.tip_velocity[:, 3:]), []
        if sensors.accelerometer is not None:
            inputs += [self.tip, turn, self.tip_velocity[:, :3], spin]
        inputs += [spin] if sensors.gyroscope is not None else []
        return inputs + ([self.tip, np.arcsin(np.clip(A[:, 1:, 0], -1.0, 1.0))] if sensors.camera is not None else [])


Trajectory.kinds["xyz"] = SpatialTrajectory
SpatialTrajectory.arrays = {
    **{name: shape for name, shape in ARRAYS.items() if name != "link_angles"},
    "tip_velocity": ("n", 6), "hinges": ("n", "joints - 1", 3), "tip_deflection": ("n", "links", 2),
    "shapes": ("n", "points", 3), "tip_rotation": ("n", 4), "twist": ("n", "links"),
    "link_rotations": ("n", "links", 2, 4), "unresolved_damping": ("n",),
}  # fmt: skip


def placed(run: Trajectory, scene: Scene) -> Trajectory:
    """Convert a planar run of a spatial scene to a `SpatialTrajectory`; return any other run unchanged.

    Scenes whose motion stays in a plane are computed in this plane (`scene.computed`). scene: the spatial scene.
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
    return SpatialTrajectory(**known)
