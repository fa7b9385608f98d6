"""Contents of a player in space: links as ribbons, forces and torques, charts, and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from .. import validation as check
from ..geometry.outlines import faces_of
from ..geometry.ribbons import Ribbons, ribbons, ribbons_of, sides
from ..parameters import Arm
from ..physics.space.reading import links, straight
from ..rigid import axis_of
from ..rotations import matrices, of_quaternions, turned
from ..scene import PointLoad, Scene
from ..validation import Array
from .clip import Chart, Pull, packed, short, thinner
from .contact import contact_pulls, obstacles_of


@dataclass(frozen=True)
class SpaceClip:
    """Data of a simulated run in space for the player, at n instants, for N links and P points of the arm, in SI units.

    Attributes:
        label, note, t, pulls, charts, pinned, payload: as in the class `Clip`; forces have the shape (n, 3).
        points, across (n, P, 3), cuts (N + 1,): as in `geometry.ribbons.Ribbons`. sides (N, 2): width and thickness of
            each link, m. length: length of the arm, m. ground: height of the ground, m. rigid (n, N + 1, 3): joints and
            tip of the rigid arm, m, or None.
        target (n, 3): target point, m, or None. walls: faces of the obstacles, each with its corners (corners, 3), m.
    """

    label: str
    note: str
    t: Array
    points: Array
    across: Array
    cuts: tuple[int, ...]
    sides: Array
    length: float
    ground: float = 0.0
    rigid: Array | None = None
    target: Array | None = None
    pulls: Sequence[Pull] = ()
    charts: Sequence[Chart] = ()
    walls: Sequence[Array] = ()
    pinned: bool = True
    payload: bool = False
    skipped: int = field(default=1)

    def every(self, step: int) -> SpaceClip:
        """Return the clip with every `step`-th instant and the last instant."""
        names = [name for name in ("t", "points", "across", "rigid", "target") if getattr(self, name) is not None]
        thin: SpaceClip = thinner(self, names, step)
        return thin

    def own_entries(self) -> dict[str, Any]:
        """Return the entries of the page's data that only spatial clips have; walls are split into triangles."""
        faces = [[face[0], *pair] for face in self.walls for pair in pairwise(face[1:])]
        return {
            "across": short(self.across),
            "sides": self.sides.tolist(),
            "length": self.length,
            "ground": self.ground,
            "walls": packed("f4", np.array(faces)) if faces else None,
        }


def _clip(
    arm: Arm, found: Ribbons, A: Array, torque: Array, joints: Array | None, loads: Sequence[PointLoad] = (),
    further: Sequence[Pull] = (), **more: Any,
) -> SpaceClip:  # fmt: skip
    """Return a clip with point loads and further forces as arrows (`Pull`).

    A (n, N, 3, 3): axes of the links' roots. joints (n, N): joint angles, rad, of a rigid arm that is drawn for
        comparison, or None.
    """
    limits = arm.torque_limits or (None,) * arm.n_links
    pulls = []
    for k in range(arm.n_links):
        if np.any(torque[:, k] != 0.0):
            axis = turned(A[:, k], axis_of(arm, k))
            name = f"{arm.joint_names[k].replace('_', ' ')} torque"
            pulls.append(Pull(name, found.cuts[k], torque[:, k], limits[k], axis))
    pulls += [*_loads(loads, found.cuts, more["t"]), *further]
    rigid = None if joints is None else straight(arm, joints) + found.points[:, :1]
    return SpaceClip(
        points=found.points, across=found.across, cuts=found.cuts, sides=sides(arm), length=arm.total_length,
        rigid=rigid, pulls=pulls, payload=arm.payload.mass > 0.0, **more,
    )  # fmt: skip


def _bending(arm: Arm, deflection: Array, twist: Array) -> list[Chart]:
    """Return charts of deflections (n, N, 2) and twists (n, N), rad, of the flexible links."""
    soft = [k for k, link in enumerate(arm.links) if not link.rigid]
    bend = {f"link {k + 1}, {axis}": deflection[:, k, i] for k in soft for i, axis in enumerate("yz")}
    turn = {f"link {k + 1}": np.degrees(twist[:, k]) for k in soft}
    return [Chart("tip deflection / length, along y and z", bend), Chart("twist (degrees)", turn)]


def of_run(run: Any, label: str | None, note: str, charts: Sequence[Chart]) -> SpaceClip:
    """Return the clip of a run in space.

    charts: charts of torques and energies, which follow the charts of deflection and twist. label: name of the clip;
    None for the scene's name.
    """
    scene: Scene = run.scene
    far = 0.7 * scene.arm.total_length
    held, A = scene.root == "pinned", matrices(of_quaternions(run.link_rotations[:, :, 0]))
    return _clip(
        scene.arm, ribbons_of(run, 4), A, run.joint_torque, run.joint_angles if held else None,
        label=scene.name if label is None else label, note=note, t=run.t, pinned=scene.root == "pinned",
        loads=[load for load in scene.loads if isinstance(load, PointLoad)],
        charts=[*_bending(scene.arm, run.tip_deflection, run.twist), *charts],
        walls=[face for x in scene.contacts for face in faces_of(x.obstacle, np.zeros(3), far)],
        ground=0.0 if held else min(float(run.shapes[..., 2].min()), 0.0),
    )  # fmt: skip


def _loads(loads: Sequence[PointLoad], cuts: Sequence[int], t: Array) -> list[Pull]:
    """Return the point loads on roots and tips as arrows (`Pull`), in global axes."""
    pulls = []
    for load in loads:
        point = cuts[load.link] if load.end == "root" else cuts[load.link + 1] - 1
        where = f"at the {load.end} of link {load.link + 1}"
        force, torque = (
            np.column_stack([np.zeros(len(t)) if f is None else np.asarray(f(t)) for f in parts])
            for parts in ((load.force_x, load.force_y, load.force_z), (load.torque_x, load.torque_y, load.torque))
        )
        if force.any():
            pulls.append(Pull(f"force {where}", point, force))
        if torque.any():
            size = np.linalg.norm(torque, axis=1)
            axis = torque / np.where(size > 0.0, size, 1.0)[:, None]
            pulls.append(Pull(f"torque {where}", point, size, None, axis))
    return pulls


def of_episode(plan: Any, views: Sequence[Any], label: str, note: str, charts: Sequence[Chart]) -> SpaceClip:
    """Return the clip of an episode.

    views: `batch.View` of each instant. charts: charts that follow the charts of deflection and twist.
    """
    arm, q = plan.arm, np.array([view.q for view in views])
    target = np.array([view.target for view in views])
    poses = np.array([view.poses for view in views])
    bend = np.array([view.deflection for view in views]).reshape(len(views), 2, -1).swapaxes(1, 2)
    found = ribbons(arm, plan.settings, q, 4)
    A = np.stack([motion.root.A for motion in links(arm, plan.settings, q, np.zeros_like(q))], axis=1)
    apart = np.linalg.norm(found.points[:, -1] - target, axis=1)
    miss = Chart("tip error: distance from the target (m)", {"tip": apart})
    walls = [face for shape in obstacles_of(plan) for face in faces_of(shape, np.zeros(3), 0.7 * arm.total_length)]
    return _clip(
        arm, found, A, np.array([view.torques for view in views]), poses[..., 0], label=label, note=note,
        t=np.array([view.time for view in views]), target=target, walls=walls,
        further=contact_pulls(plan, views, [cut - 1 for cut in found.cuts[1:]], found.points[0]),
        charts=[miss, *_bending(arm, bend, poses[..., 6]), *charts],
    )  # fmt: skip


def check_alike(clips: Sequence[Any]) -> None:
    """Raise ValueError if some clips are planar and some in space."""
    if len({type(clip) for clip in clips}) > 1:
        labels = [clip.label for clip in clips]
        raise check.InvalidValue("clips", labels, "must all be of the plane, or all of space")
