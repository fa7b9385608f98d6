"""The plane that an arm of a scene in space stays in, where there is one, and the scene of the plane that this is."""

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
"""How far a direction may be off the plane, of its length: round-off."""


class InPlane(NamedTuple):
    """A scene that stays in a plane.

    scene: the same of the x-y plane. axes (3, 3): that plane's x, y and normal as columns. height: m, of the plane
    along its normal. frames (N, 3, 3): rows are the x, y and normal of each link in the plane, in the link's own axes.
    signs, offsets (N,): an angle of a joint there is offset (rad) + sign times that of the scene.
    """

    scene: Scene
    axes: Array
    height: float
    frames: Array
    signs: Array
    offsets: Array


class _Leaves(Exception):
    """Something leaves the plane."""


@lru_cache(maxsize=64)
def in_plane(scene: Scene) -> InPlane | None:
    """The plane of a scene in space; None where it leaves it, has a rigid link, or `space` or a planar scene is given.

    All joints turn about one direction, and that is a principal axis of every section, of every tensor and square to
    gravity, forces, the root's motion and velocity, the payload's offset; moments act about it; to `EXACT`.
    """
    rigid = any(link.rigid for link in scene.arm.links)
    if scene.space or not scene.spatial or rigid or not all(map(_across, scene.arm.links)):
        return None
    try:
        return _found(scene)
    except _Leaves:
        return None


def computed(scene: Scene) -> Scene:
    """The scene that `simulate` runs: that of its plane, or itself."""
    flat = in_plane(scene)
    return flat.scene if flat else scene


def _found(scene: Scene) -> InPlane:
    arm, n = scene.arm, scene.arm.n_links
    elbows = [arm.elbow(k) for k in range(1, n)]
    first = _matrix(arm.hub_mount)
    frames, signs, offsets = [_frame(np.array(arm.hub_axis))], [1.0], [0.0]
    axes = _axes(scene, first @ frames[0][2], first[:, 0])
    offsets = [_angle(axes.T @ first[:, 0])]
    for elbow in elbows:
        mount = _matrix(elbow.mount)
        offsets.append(_angle(frames[-1] @ mount[:, 0]))
        frames.append(_frame(mount.T @ frames[-1][2]))
        signs.append(math.copysign(1.0, float(frames[-1][2] @ elbow.axis)))
        _require(np.array(elbow.axis) - signs[-1] * frames[-1][2], 1.0)
    planar = Arm(
        arm.name,
        tuple(map(_link, arm.links, frames)),
        hub_inertia=_inertia(arm.hub_inertia, frames[0]),
        elbows=tuple(map(_elbow, elbows, frames, frames[1:])),
        payload=_payload(arm.payload, frames[-1]),
        **{name: getattr(arm, name) for name in ("tau_d", "mass_damping", "joints", "source")},
    )
    angles, rates = [], []
    end = spin = before = 0.0
    for k, link in enumerate(planar.links):
        end += offsets[k] + signs[k] * scene.initial_value(f"joint{k}")
        spin += signs[k] * (scene.rates[k] if arm.spatial else scene.rates[k] - before)
        before = scene.rates[k]
        angles.append(end)
        rates.append(spin)
        end += link.turn
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
    if np.abs(off).max() > EXACT * size:
        raise _Leaves


def _clean(v: Any) -> Array:
    """Without what is round-off beside its largest number."""
    v = np.asarray(v, np.float64)
    return np.where(np.abs(v) <= EXACT * np.abs(v).max(), 0.0, v)


def _vector(v: Sequence[float], axes: Array) -> tuple[float, float]:
    """What it is in the plane."""
    x, y, off = (axes.T @ v).tolist()
    _require(off, float(np.linalg.norm(v)))
    x, y, _ = _clean([x, y, 0.0]).tolist()
    return x, y


def _matrix(mount: Any) -> Array:
    return np.eye(3) if mount is None else np.array(mount)


def _angle(along: Array) -> float:
    return math.atan2(along[1], along[0])


def _frame(normal: Array) -> Array:
    """Rows x, y and normal of a link in the plane, in its own axes."""
    _require(normal[0], 1.0)
    _, a, b = _clean([0.0, *normal[1:]]) / np.hypot(*normal[1:])
    return np.array([[1.0, 0.0, 0.0], [0.0, b, -a], [0.0, a, b]]) + 0.0


def _axes(scene: Scene, normal: Array, along: Array) -> Array:
    """The plane's axes: x is one of the inertial ones that lies in it, the first that is prescribed if any is."""
    normal = _clean(normal)
    prescribed = [i for i, name in enumerate(ROOT) if scene.motion_of(name)]
    _require([0.0, *normal[prescribed]], 1.0)
    inertial = [np.eye(3)[i] for i in (*prescribed, 0, 1, 2) if normal[i] == 0.0]
    x = [*inertial, along][0]
    return np.column_stack([_clean(part) for part in (x, np.cross(normal, x), normal)]) + 0.0


# ------------------------------------------------------------------------------------------ the arm
def _across(link: Link) -> bool:
    """Whether its sections say what they are in space: else that is refused there."""
    points = link.section if isinstance(link.section, tuple) else ((0.0, link.section),)
    return all(getattr(own, name, 0.0) is not None for _, own in points for name in ACROSS)


def _link(link: Link, frame: Array) -> Link:
    a, b = frame[2, 1:].tolist()
    curve = link.curvature
    if link.curved:
        _require(a, 1.0)
        curve = curve * b if isinstance(curve, float) else tuple((s, kappa * b) for s, kappa in curve)
    own = link.section
    return dataclasses.replace(
        link, curvature=curve, section=tuple((s, _section(at, a, b)) for s, at in own)
        if isinstance(own, tuple) else _section(own, a, b),
    )  # fmt: skip


def _section(section: Any, a: float, b: float) -> Any:
    """As it bends about (0, a, b): one of its principal axes."""
    if a == 0.0:
        return section
    turned: Section | Taper
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
    """About the normal, which is one of its principal axes."""
    if not isinstance(value, tuple):
        return float(value)
    turned = frame @ tensor(value) @ frame.T
    _require(turned[2, :2], float(np.abs(turned).max()))
    return float(turned[2, 2])


def _elbow(elbow: Elbow, before: Array, after: Array) -> Elbow:
    return Elbow(elbow.mass, _inertia(elbow.inertia_left, before), _inertia(elbow.inertia_right, after))


def _payload(payload: Payload, frame: Array) -> Payload:
    offset = _vector((*payload.offset, 0.0)[:3], frame.T)
    return Payload(payload.mass, _inertia(payload.inertia, frame), offset)


# ------------------------------------------------------------------------------------------ what drives it
def _scaled(function: TimeFunction, factor: float) -> TimeFunction:
    if factor == 1.0:
        return function
    pieces = function.pieces.copy()
    pieces[:, C0:OMEGA] *= factor
    return TimeFunction(pieces)


def _motion(motion: Motion, axes: Array, signs: Sequence[float], offsets: Sequence[float]) -> Motion:
    if motion.joint is None:
        row = axes[ROOT.index(motion.coordinate), :2]
        along = int(np.abs(row).argmax())
        return Motion(ROOT[along], _scaled(motion.function, float(row[along])))
    function = _scaled(motion.function, signs[motion.joint])
    return Motion(motion.coordinate, function.plus(offsets[motion.joint]) if offsets[motion.joint] else function)


def _load(load: Load, axes: Array, signs: Sequence[float]) -> list[Load]:
    """The load in the plane, or nothing where that is nothing."""
    if isinstance(load, JointTorque):
        return [JointTorque(load.joint, _scaled(load.function, signs[load.joint]))]
    force_x, force_y, out = _turned((load.force_x, load.force_y, load.force_z), axes)
    *aside, torque = _turned((load.torque_x, load.torque_y, load.torque), axes)
    if (out, *aside) != (None, None, None):
        raise _Leaves
    some = force_x is not None or force_y is not None or torque is not None
    return [PointLoad(load.link, load.end, force_x, force_y, torque)] if some else []


def _turned(functions: Sequence[TimeFunction | None], axes: Array) -> list[TimeFunction | None]:
    """Three functions along inertial axes along those of the plane; None for what is 0 throughout."""
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
        every = np.array([w * f.pieces[:, C0:OMEGA] for f, w in parts])
        total = every.sum(axis=0)
        pieces[:, C0:OMEGA] = np.where(np.abs(total) <= EXACT * np.abs(every).max(), 0.0, total)
        found.append(TimeFunction(pieces) if pieces[:, C0:OMEGA].any() else None)
    return found
