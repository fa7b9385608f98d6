"""Write an arm with rigid links as URDF, for ROS and other programs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from flexarm_env import validation as check
from flexarm_env.validation import Array

from .chain import LEAST, Body, Chain
from .mjcf import comment_of, legal, text_of

RATE = 100.0
"""Velocity limit of each joint in the file, rad/s. URDF requires a limit, which arms of this package do not have."""


def urdf(chain: Chain, comments: Iterable[str] = ()) -> str:
    """Return a chain without springs as the text of a URDF file.

    Links and joints have the same names as in the chain. The link `base` is the ground and the link `tip` the arm's
    tip. The joints have the arm's torque limits (attribute "effort"), angle limits, viscous friction and Coulomb
    friction.

    Raises:
        ValueError: the chain has springs or elastic gears, which URDF cannot describe. (`chain_of` with segments=0
            returns a chain without springs.)
    """
    for hinge in chain.hinges:
        if hinge.stiffness:
            what = "must not be there: URDF has no springs; links must be rigid (segments = 0) and gears as well"
            raise check.InvalidValue(hinge.name, hinge.stiffness, what)
    arm = chain.arm
    root = ElementTree.Element("robot", name=legal(arm.name))
    for line in comments:
        root.append(ElementTree.Comment(comment_of(line)))
    ElementTree.SubElement(root, "link", name="base")
    before = "base"
    for body in chain.bodies:
        _link(root, body, chain)
        _joint(root, body, before, arm.torque_limits)
        before = body.name
    ElementTree.SubElement(root, "link", name="tip")
    fixed = ElementTree.SubElement(root, "joint", name="tip_fixed", type="fixed")
    _frame(fixed, chain.tip, chain.tip_rotation)
    ElementTree.SubElement(fixed, "parent", link=before)
    ElementTree.SubElement(fixed, "child", link="tip")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def rpy(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw, rad, of a rotation matrix R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) < 1e-12:
        # pitch of a right angle: roll and yaw turn about one axis; yaw is set to 0
        return math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _frame(parent: ElementTree.Element, place: Array, R: Array) -> None:
    ElementTree.SubElement(parent, "origin", xyz=text_of(place), rpy=text_of(rpy(R)))


def _link(root: ElementTree.Element, body: Body, chain: Chain) -> None:
    link = ElementTree.SubElement(root, "link", name=body.name)
    inertial = ElementTree.SubElement(link, "inertial")
    _frame(inertial, body.centre, np.eye(3))
    ElementTree.SubElement(inertial, "mass", value=text_of([max(body.mass, LEAST)]))
    I = body.inertia + LEAST * np.eye(3) * (np.abs(body.inertia).max() < LEAST)
    entries = {"ixx": I[0, 0], "ixy": I[0, 1], "ixz": I[0, 2], "iyy": I[1, 1], "iyz": I[1, 2], "izz": I[2, 2]}
    ElementTree.SubElement(inertial, "inertia", {name: text_of([value]) for name, value in entries.items()})
    length = float(np.linalg.norm(body.end))
    if length > 0.0:
        visual = ElementTree.SubElement(link, "visual")
        # a cylinder lies along its z axis: turn z to the link's direction
        x, y, z = body.end / length
        turn = rpy(_onto(np.array([x, y, z])))
        ElementTree.SubElement(visual, "origin", xyz=text_of(0.5 * body.end), rpy=text_of(turn))
        shape = ElementTree.SubElement(visual, "geometry")
        size = text_of([0.01 * chain.arm.total_length])
        ElementTree.SubElement(shape, "cylinder", length=text_of([length]), radius=size)


def _onto(direction: Array) -> Array:
    """Return a rotation matrix whose third column is the direction (3,)."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(direction, first), direction])


def _joint(root: ElementTree.Element, body: Body, before: str, limits: tuple[float, ...] | None) -> None:
    (hinge,) = body.hinges
    kind = "continuous" if hinge.limits is None else "revolute"
    joint = ElementTree.SubElement(root, "joint", name=hinge.name, type=kind)
    _frame(joint, body.position, body.rotation)
    ElementTree.SubElement(joint, "parent", link=before)
    ElementTree.SubElement(joint, "child", link=body.name)
    ElementTree.SubElement(joint, "axis", xyz=text_of(hinge.axis))
    if limits is not None or hinge.limits is not None:
        # without a torque limit the effort is a bound far above any of them
        words = {"effort": text_of([limits[hinge.joint] if limits is not None else 1e9]), "velocity": text_of([RATE])}
        if hinge.limits is not None:
            words |= {"lower": text_of(hinge.limits[:1]), "upper": text_of(hinge.limits[1:])}
        ElementTree.SubElement(joint, "limit", words)
    if hinge.damping or hinge.friction:
        friction = {"damping": text_of([hinge.damping]), "friction": text_of([hinge.friction])}
        ElementTree.SubElement(joint, "dynamics", friction)
