"""Read a robot's URDF or MJCF file, with MuJoCo's parser, as an arm with rigid links."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from flexarm_env import bodies
from flexarm_env import validation as check
from flexarm_env.parameters import Arm, Elbow, Joint, Link, RigidLink, Section
from flexarm_env.validation import Array

from .bare import bare
from .serial import Part, serial

ROUND = 1e-12
"""Entries of rotations and axes below this magnitude are round-off of the file's numbers."""
GEAR_RATIO = 100.0
"""Gear ratio that is assumed because a file states only the rotor's inertia at the joint (armature)."""
LONGEST = 1e9  # m, of a link
LEAST_RATIO = 1e-9
"""Smallest gear ratio: the motor inertia is divided by its square."""


@dataclass(frozen=True)
class Imported:
    """An arm that was read from a file.

    Attributes:
        arm: the arm, whose links are rigid, except the links requested as flexible.
        links: names of each link's bodies in the file, joined by "+".
        joints: names of the file's joints, in the arm's order.
        root (3,): position of the first joint in the file, m; the arm's root is at the origin.
        tip: name of the body or site at the arm's tip; "" if the tip is the last link's center of mass.
        gravity (3,): gravity in the file, m/s^2.
        left_out: features of the file that the arm lacks.
        flexible: for each link that was made flexible, the resulting changes (see `made_flexible`).
    """

    arm: Arm
    links: tuple[str, ...]
    joints: tuple[str, ...]
    root: tuple[float, float, float]
    tip: str
    gravity: tuple[float, float, float]
    left_out: tuple[str, ...] = ()
    flexible: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def import_arm(
    path: str | os.PathLike[str],
    *,
    root: str | None = None,
    tip: str | None = None,
    flexible: Mapping[str, Section] | None = None,
    tau_d: float = 0.0,
    gear_ratio: float = GEAR_RATIO,
) -> Imported:
    """Read a serial chain of hinges from a URDF (.urdf) or MJCF (.xml, .mjcf) file.

    Link k's x axis points from joint k to joint k+1 or the tip. The link's z axis is perpendicular to x and as near as
    possible to the joint's axis. Bodies that are fixed to each other become one link. All angles are 0 in the initial
    posture of the file's model.

    Args:
        root: body in which the chain begins, if the file has several mechanisms.
        tip: body or site at the arm's tip. None: the last link's body or site with the largest distance from the last
            link's joint, or the last link's center of mass if all its bodies and sites are at the joint.
        flexible: sections by the name of a body of the link. A flexible link keeps its mass, distributed evenly along
            the line from joint to joint: the section's m and J are scaled accordingly.
        tau_d: damping time of the flexible links, s.
        gear_ratio: gear ratio assumed for joints with armature; the motor inertia is then armature / gear_ratio^2.
    Raises:
        ValueError: an arm cannot represent an element of the file; the message names the element.
        OSError: the file does not exist. ImportError: MuJoCo is not installed.
    """
    gear_ratio = check.number("gear_ratio", gear_ratio, minimum=LEAST_RATIO, maximum=1e9)
    with check.in_file(path), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        with _quiet():
            model, left_out = _model(Path(path))
            found = serial(model, root, tip)
        frames = _frames(found.parts, found.tip)
        arm = _arm(Path(path).stem, found.parts, frames, found.tip, gear_ratio)
        changes: dict[str, Mapping[str, float]] = {}
        for name, section in (flexible or {}).items():
            k = _link_of(found.parts, name)
            arm, changes[name] = made_flexible(arm, k, section, tau_d)
        return Imported(
            arm, tuple("+".join(part.names) for part in found.parts), tuple(part.joint for part in found.parts),
            _three(found.parts[0].anchor), found.tip_name, _three(found.gravity), (*left_out, *found.left_out), changes,
        )  # fmt: skip


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress MuJoCo's warnings and its file MUJOCO_LOG.TXT, because this package validates the same conditions."""
    with check.needs("reading of URDF and MJCF files", "mujoco", "mujoco"):
        import mujoco
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _model(path: Path) -> tuple[Any, list[str]]:
    """Return the compiled model of a file, and the features removed from its text."""
    import mujoco

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        top = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, ElementTree.ParseError) as error:
        raise check.Unreadable("", f"is no XML: {error}") from None
    if top.tag not in ("robot", "mujoco"):
        raise check.InvalidValue("<root element>", top.tag, 'must be "robot" (URDF) or "mujoco" (MJCF)')
    text, left_out = ("", []) if top.tag == "mujoco" else bare(top)
    try:
        if top.tag == "mujoco":
            return mujoco.MjModel.from_xml_path(str(path)), left_out
        return mujoco.MjModel.from_xml_string(text), left_out
    except ValueError as error:
        raise check.Unreadable("", f"MuJoCo cannot read it: {' '.join(str(error).split())}") from None


def _frames(parts: tuple[Part, ...], tip: Array) -> list[Array]:
    """Return each link's axes (3, 3) in the ground's axes: x to the next joint, z as near the joint's axis as
    possible.
    """
    anchors = [part.anchor for part in parts] + [tip]
    found: list[Array] = []
    for k, part in enumerate(parts):
        span = anchors[k + 1] - anchors[k]
        # far numbers overflow in the lines below
        length = check.number(
            f"link {'+'.join(part.names)}.length", float(np.linalg.norm(span)), "m", minimum=0.0, maximum=LONGEST
        )
        before = found[-1] if found else np.eye(3)
        # candidates for the third axis: the joint's, then those of the link before
        for z in (part.axis, *before.T[::-1]):
            x = span / length if length > 0.0 else before[:, int(np.argmin(np.abs(before.T @ z)))]
            z = z - (x @ z) * x
            if np.linalg.norm(z) > 1e-6:
                z /= np.linalg.norm(z)
                x = x - (x @ z) * z
                x /= np.linalg.norm(x)
                found.append(np.column_stack([x, np.cross(z, x), z]))
                break
    return found


def _clean(values: Array) -> Array:
    """Round entries of directions that differ from 0, 1 or -1 by round-off alone."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < ROUND, nearest, values)


def _arm(name: str, parts: tuple[Part, ...], frames: list[Array], tip: Array, gear_ratio: float) -> Arm:
    anchors = [part.anchor for part in parts] + [tip]
    links, elbows, joints = [], [], []
    mounts = [_clean(a.T @ b) for a, b in zip([np.eye(3), *frames[:-1]], frames, strict=True)]
    axes = [_clean(frame.T @ part.axis) for frame, part in zip(frames, parts, strict=True)]
    for k, part in enumerate(parts):
        R = frames[k]
        mass, centre, inertia = part.mass, R.T @ (part.centre - part.anchor), R.T @ part.inertia @ R
        # components that are round-off of the link's size
        size = max(float(np.abs(centre).max()), 1e-3)
        centre = np.where(np.abs(centre) < ROUND * size, 0.0, centre)
        inertia = np.where(np.abs(inertia) < ROUND * np.abs(inertia).max(), 0.0, 0.5 * (inertia + inertia.T))
        length = float(np.linalg.norm(anchors[k + 1] - anchors[k]))
        with check.under(f"link {'+'.join(part.names)}"):
            links.append(RigidLink(length, mass, _three(centre), inertia))
        if k:
            elbows.append(Elbow(axis=_three(axes[k]), mount=mounts[k]))
        rotor, ratio = (part.armature / gear_ratio**2, gear_ratio) if part.armature else (0.0, 1.0)
        with check.under(f"joint {part.joint}"):
            joints.append(Joint(
                motor_inertia=rotor, gear_ratio=ratio, friction_viscous=part.damping, friction_coulomb=part.friction,
            ))  # fmt: skip
    torques, ranges = [part.torque for part in parts], [part.limits for part in parts]
    named = ", ".join("+".join(part.names) for part in parts)
    return Arm(
        name, tuple(links), source=f"Imported from a robot's description; links: {named}.",
        hub_axis=_three(axes[0]), hub_mount=mounts[0], elbows=tuple(elbows),
        joints=tuple(joints) if any(joint != Joint() for joint in joints) else (),
        torque_limits=None if any(torque is None for torque in torques) else tuple(torques),  # type: ignore[arg-type]
        joint_limits=tuple(ranges) if any(ranges) else None,
    )  # fmt: skip


def _link_of(parts: tuple[Part, ...], name: str) -> int:
    for k, part in enumerate(parts):
        if name in part.names:
            return k
    raise check.UnknownKey(name, [own for part in parts for own in part.names], "link")


def made_flexible(arm: Arm, k: int, section: Section, tau_d: float = 0.0) -> tuple[Arm, dict[str, float]]:
    """Replace rigid link k by a beam along its x axis with the same mass, distributed evenly.

    Args:
        section: section of the beam; its m, J and J_y are scaled to the link's mass. tau_d: damping time, s.
    Returns:
        The changed arm, and a dict with two changes: centre_shift, the shift of the center of mass, m, and
            inertia_ratio, the ratio (beam to rigid link) of the largest principal moments of inertia about the joint.
    Raises:
        ValueError: the link is already flexible, or has no length or mass.
    """
    rigid = arm.links[k]
    if not isinstance(rigid, RigidLink):
        raise check.InvalidValue(f"links[{k}]", "flexible", "must be a rigid link")
    for name in ("length", "mass"):
        if not getattr(rigid, name) > 0.0:
            what = "must be positive for a link that bends"
            raise check.InvalidValue(f"links[{k}].{name}", getattr(rigid, name), what)
    scale = rigid.mass / rigid.length / section.m
    across = None if section.J_y is None else section.J_y * scale
    section = replace(section, m=section.m * scale, J=section.J * scale, J_y=across)
    beam = Link(rigid.length, section, tau_d=tau_d or None)
    own = bodies.about(bodies.tensor(rigid.inertia), rigid.mass, np.array(rigid.centre))
    new = beam.moment(2) + beam.rotary
    shift = float(np.linalg.norm(np.array(rigid.centre) - [0.5 * rigid.length, 0.0, 0.0]))
    links = tuple(beam if i == k else link for i, link in enumerate(arm.links))
    change = {"centre_shift_m": shift, "inertia_ratio": float(new / np.linalg.eigvalsh(own)[-1])}
    return replace(arm, links=links), change
