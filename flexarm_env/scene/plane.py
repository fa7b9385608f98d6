"""Find the plane in which the motion of a spatial scene stays, and express the scene in that plane."""

import dataclasses
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from flexarm_env.bodies import tensor
from flexarm_env.parameters import Arm, Elbow, Payload
from flexarm_env.scene.definition import Scene
from flexarm_env.scene.drives import ROOT, JointTorque, Load, Motion, PointLoad
from flexarm_env.sections import ACROSS, Link, Section, Taper
from flexarm_env.time_functions import C0, OMEGA, PHASE, T0, TimeFunction
from flexarm_env.validation import Array

EXACT = 1e-12
"""Relative deviation of a direction from the plane that counts as round-off."""


class InPlane(NamedTuple):
    """Planar scene that is equivalent to a spatial scene whose arm stays in one plane.

    scene: the planar scene. axes (3, 3): columns are the plane's x axis, y axis and normal, in inertial axes of the
    spatial scene. height: position of the plane along its normal, m. frames (N, 3, 3): for each link of the planar
    scene, rows are its x axis, y axis and normal in the axes of the spatial link. signs, offsets (N,): a joint angle of
    the planar scene is offset (rad) + sign times the joint angle of the spatial scene.
    """

    scene: Scene
    axes: Array
    height: float
    frames: Array
    signs: Array
    offsets: Array


class _Leaves(Exception):
    """Raised if a part of the scene leaves the plane."""


@lru_cache(maxsize=64)
def in_plane(scene: Scene) -> InPlane | None:
    """Return the equivalent planar scene of a spatial scene; None if there is no equivalent scene.

    The following conditions must hold to the accuracy `EXACT`. All joint axes must be parallel. The direction of the
    joint axes must be a principal axis of every section and every inertia tensor. Gravity, forces, the root's motion
    and velocity, and the payload's offset must be perpendicular to the joint axes. Moments must act about the joint
    axes. The result is also None if a link is rigid, or if the scene has contacts or `space` = True.
    """
    # rigid links are computed in space only
    rigid = any(link.rigid for link in scene.arm.links)
    if scene.space or not scene.spatial or rigid or scene.contacts or not all(map(_across, scene.arm.links)):
        return None
    try:
        return _planar_scene(scene)
    except _Leaves:
        return None


def computed(scene: Scene) -> Scene:
    """Return the scene that `simulate` computes: the equivalent planar scene, or the scene itself if there is none."""
    flat = in_plane(scene)
    return flat.scene if flat else scene


def _planar_scene(scene: Scene) -> InPlane:
    """Build the planar scene (axes, arm, initial state, motions, loads); raise `_Leaves` if it leaves the plane."""
    arm, n = scene.arm, scene.arm.n_links
    # frames: each link's axes in the plane; axes (3, 3): the plane itself, in inertial axes
    elbows = [arm.elbow(k) for k in range(1, n)]
    # the root: its frame, and the angle of its mount in the plane
    first = _matrix(arm.hub_mount)
    frames, signs, offsets = [_frame(np.array(arm.hub_axis))], [1.0], [0.0]
    axes = _axes(scene, first @ frames[0][2], first[:, 0])
    offsets = [_angle(axes.T @ first[:, 0])]
    # each mount turns the normal into the next link's axes; the joint axis must be plus or minus the normal
    for elbow in elbows:
        mount = _matrix(elbow.mount)
        offsets.append(_angle(frames[-1] @ mount[:, 0]))
        frames.append(_frame(mount.T @ frames[-1][2]))
        signs.append(math.copysign(1.0, float(frames[-1][2] @ elbow.axis)))
        _require(np.array(elbow.axis) - signs[-1] * frames[-1][2], 1.0)
    # arm in the plane: sections and inertias about the normal
    planar = Arm(
        arm.name,
        tuple(map(_link, arm.links, frames)),
        hub_inertia=_inertia(arm.hub_inertia, frames[0]),
        elbows=tuple(map(_elbow, elbows, frames, frames[1:])),
        payload=_payload(arm.payload, frames[-1]),
        **{name: getattr(arm, name) for name in ("tau_d", "mass_damping", "joints", "source")},
    )
    # absolute angles and rates: sums of the relative ones along the chain
    angles, rates = [], []
    # end: angle of the tip section before; spin: its rate (rad/s)
    end = spin = 0.0
    for k, link in enumerate(planar.links):
        end += offsets[k] + signs[k] * scene.initial_value(f"joint{k}")
        spin += signs[k] * arm.relative(scene.rates, k)
        angles.append(end)
        rates.append(spin)
        end += link.turn
    # position of the root along the plane's axes; the third component is the height
    place = axes.T @ scene.position
    flat = dataclasses.replace(
        scene, arm=planar, angles=tuple(angles), rates=tuple(rates), position=tuple(_clean(place)[:2]),
        velocity=_vector(scene.velocity, axes), gravity=None if scene.gravity is None else _vector(scene.gravity, axes),
        motions=tuple(_motion(motion, axes, signs, offsets) for motion in scene.motions),
        loads=tuple(there for load in scene.loads for there in _load(load, axes, signs)),
    )  # fmt: skip
    return InPlane(flat, axes, float(place[2]), np.array(frames), np.array(signs), np.array(offsets))


# ------------------------------------------------------------------------------------------ directions
def _require(off: Any, size: float) -> None:
    """Raise `_Leaves` if an entry of `off` exceeds `EXACT` times `size`."""
    if np.abs(off).max() > EXACT * size:
        raise _Leaves


def _clean(v: Any) -> Array:
    """Return a vector in which components at the round-off level of the largest component are 0."""
    v = np.asarray(v, np.float64)
    return np.where(np.abs(v) <= EXACT * np.abs(v).max(), 0.0, v)


def _vector(v: Sequence[float], axes: Array) -> tuple[float, float]:
    """Return the plane components (x, y) of a vector in inertial axes; raise `_Leaves` if it has a normal component."""
    x, y, off = (axes.T @ v).tolist()
    _require(off, float(np.linalg.norm(v)))
    x, y, _ = _clean([x, y, 0.0]).tolist()
    return x, y


def _matrix(mount: Any) -> Array:
    """Return a mount as a rotation matrix; None gives the identity matrix."""
    return np.eye(3) if mount is None else np.array(mount)


def _angle(along: Array) -> float:
    """Return the angle of a direction from the x axis, rad."""
    return math.atan2(along[1], along[0])


def _frame(normal: Array) -> Array:
    """Return the rows x, y and normal (3, 3) of a link in the plane; rows and `normal` are in the link's axes.

    The link's x axis lies in the plane: the normal is (0, a, b) and the y axis (0, b, -a).
    """
    _require(normal[0], 1.0)
    _, a, b = _clean([0.0, *normal[1:]]) / np.hypot(*normal[1:])
    return np.array([[1.0, 0.0, 0.0], [0.0, b, -a], [0.0, a, b]]) + 0.0


def _axes(scene: Scene, normal: Array, along: Array) -> Array:
    """Return the plane's axes as columns, in inertial axes.

    The x axis is the first inertial axis in the plane; prescribed coordinates of the root come first. If no inertial
    axis is in the plane, x is the first link's direction `along`.
    """
    normal = _clean(normal)
    prescribed = [i for i, name in enumerate(ROOT) if scene.motion_of(name)]
    # a prescribed root coordinate must lie in the plane
    _require([0.0, *normal[prescribed]], 1.0)
    inertial = [np.eye(3)[i] for i in (*prescribed, 0, 1, 2) if normal[i] == 0.0]
    x = [*inertial, along][0]
    return np.column_stack([_clean(part) for part in (x, np.cross(normal, x), normal)]) + 0.0


# ------------------------------------------------------------------------------------------ the arm
def _across(link: Link) -> bool:
    """Return whether a link's sections have all properties in space; the solver in space reports missing ones."""
    points = link.section if isinstance(link.section, tuple) else ((0.0, link.section),)
    return all(getattr(own, name, 0.0) is not None for _, own in points for name in ACROSS)


def _link(link: Link, frame: Array) -> Link:
    """Return a link in the plane: its section about the normal (0, a, b), its curvature with the normal's sign."""
    a, b = frame[2, 1:].tolist()
    curve = link.curvature
    # a curved link bends in its own x-y plane: the normal is plus or minus z
    if link.curved:
        _require(a, 1.0)
        curve = curve * b if isinstance(curve, float) else tuple((s, kappa * b) for s, kappa in curve)
    own = link.section
    return dataclasses.replace(
        link, curvature=curve, section=tuple((s, _section(at, a, b)) for s, at in own)
        if isinstance(own, tuple) else _section(own, a, b),
    )  # fmt: skip


def _section(section: Any, a: float, b: float) -> Any:
    """Return a section that bends in the plane of motion, whose normal (0, a, b) is a principal axis of the section.

    If b = 0, the principal axes y and z are exchanged. If neither a nor b is 0, the section must be the same about all
    axes.
    """
    if a == 0.0:
        return section
    turned: Section | Taper
    # normal y: width and thickness exchange roles
    if isinstance(section, Taper):
        _require(b, 1.0)
        turned = dataclasses.replace(section, widths=section.thicknesses, thicknesses=section.widths)
    else:
        pairs = {name: getattr(section, f"{name}_y") for name in ("EI", "C", "J")}
        if b != 0.0:  # any axis, of a round one
            for name, across in pairs.items():
                _require(getattr(section, name) - across, across)
        pairs |= {f"{name}_y": getattr(section, name) for name in ("EI", "C", "J")}
        turned = dataclasses.replace(section, **pairs)
    return turned


def _inertia(value: Any, frame: Array) -> float:
    """Return the moment of inertia about the normal, kg m^2; the normal must be a principal axis of the tensor."""
    if not isinstance(value, tuple):
        return float(value)
    turned = frame @ tensor(value) @ frame.T
    _require(turned[2, :2], float(np.abs(turned).max()))
    return float(turned[2, 2])


def _elbow(elbow: Elbow, before: Array, after: Array) -> Elbow:
    """Return an elbow in the plane, with its left and right inertia about the normal.

    before, after: frames (3, 3) in the plane of the links before and after the elbow.
    """
    inertias = _inertia(elbow.inertia_left, before), _inertia(elbow.inertia_right, after)
    return Elbow(elbow.mass, *inertias, radius=elbow.radius)


def _payload(payload: Payload, frame: Array) -> Payload:
    """Return the payload in the plane: inertia about the normal; offset (m) along and across the tip's tangent."""
    offset = _vector((*payload.offset, 0.0)[:3], frame.T)
    return Payload(payload.mass, _inertia(payload.inertia, frame), offset, payload.radius)


# ------------------------------------------------------------------------------------------ what drives it
def _scaled(function: TimeFunction, factor: float) -> TimeFunction:
    """Return a function of time multiplied by a factor."""
    if factor == 1.0:
        return function
    pieces = function.pieces.copy()
    pieces[:, C0:OMEGA] *= factor
    return TimeFunction(pieces)


def _motion(motion: Motion, axes: Array, signs: Sequence[float], offsets: Sequence[float]) -> Motion:
    """Return a motion in the plane: the root's along the matching axis, a joint's with its sign and offset."""
    if motion.joint is None:
        # the root moves along one axis of the plane, with a sign
        row = axes[ROOT.index(motion.coordinate), :2]
        along = int(np.abs(row).argmax())
        return Motion(ROOT[along], _scaled(motion.function, float(row[along])))
    function = _scaled(motion.function, signs[motion.joint])
    return Motion(motion.coordinate, function.plus(offsets[motion.joint]) if offsets[motion.joint] else function)


def _load(load: Load, axes: Array, signs: Sequence[float]) -> list[Load]:
    """Return a load's projection onto the plane as a list, which is empty if the projection vanishes."""
    if isinstance(load, JointTorque):
        return [JointTorque(load.joint, _scaled(load.function, signs[load.joint]))]
    # force in the plane; moment about its normal
    force_x, force_y, out = _turned((load.force_x, load.force_y, load.force_z), axes)
    *aside, torque = _turned((load.torque_x, load.torque_y, load.torque), axes)
    if (out, *aside) != (None, None, None):
        raise _Leaves
    some = force_x is not None or force_y is not None or torque is not None
    return [PointLoad(load.link, load.end, force_x, force_y, torque)] if some else []


def _turned(functions: Sequence[TimeFunction | None], axes: Array) -> list[TimeFunction | None]:
    """Express three functions along inertial axes as functions along the plane's axes; None for a zero function.

    A sum of several functions requires equal pieces and sine frequencies; otherwise `_Leaves` is raised.
    """
    # functions that are not zero, each with its row of direction cosines
    given = [(f, row) for f, row in zip(functions, axes, strict=True) if f is not None and f.pieces[:, C0:OMEGA].any()]
    found: list[TimeFunction | None] = []
    for weights in np.array([row for _, row in given]).reshape(-1, 3).T:
        parts = [(f, float(w)) for (f, _), w in zip(given, weights, strict=True) if w != 0.0]
        if len(parts) < 2:
            found.append(_scaled(*parts[0]) if parts else None)
            continue
        pieces, grid = parts[0][0].pieces.copy(), [T0, OMEGA, PHASE]
        if any(f.pieces.shape != pieces.shape or np.any(f.pieces[:, grid] != pieces[:, grid]) for f, _ in parts):
            raise _Leaves  # no one function of time, and nobody says that they are in the plane
        # sum of the weighted coefficients; round-off is set to 0
        every = np.array([w * f.pieces[:, C0:OMEGA] for f, w in parts])
        total = every.sum(axis=0)
        pieces[:, C0:OMEGA] = np.where(np.abs(total) <= EXACT * np.abs(every).max(), 0.0, total)
        found.append(TimeFunction(pieces) if pieces[:, C0:OMEGA].any() else None)
    return found
