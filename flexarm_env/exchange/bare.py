"""Validate a URDF file, and remove its visual and collision shapes for MuJoCo's reader."""

from __future__ import annotations

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from flexarm_env import validation as check

NUMBERS = {
    "origin": ("xyz", "rpy"), "axis": ("xyz",), "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "limit": ("lower", "upper", "effort"),
    "dynamics": ("damping", "friction"),
}  # fmt: skip
"""Attributes that contain numbers, by the name of their element."""
KINDS = ("revolute", "continuous", "fixed")
MOST_LEVELS = 100
"""Largest depth of nested elements in a file; URDF itself needs four levels."""


def bare(robot: Element) -> tuple[str, list[str]]:
    """Return the URDF text without visual and collision shapes, and a list of the removed features.

    The mesh files that the URDF names need not exist. A link with a fixed joint remains a separate body.

    Raises:
        ValueError: the URDF has a joint that an arm cannot have, or an invalid limit or number. The message names the
            joint, limit or number.
    """
    _check_depth(robot)
    left_out: list[str] = []
    names: set[str] = set()
    for joint in robot.findall("joint"):
        name = joint.get("name", "")
        if name in names:
            raise check.InvalidValue(f"joint {name}", "two joints", "must have names of their own")
        names.add(name)
        _check_joint(joint, name)
        left_out += _limits(joint, name)
    for link in robot.findall("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(part)
        _check_numbers(link, f"link {link.get('name', '')}")
        # links without mass are frames; an inertial of zeros is one as well
        inertial = link.find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is not None and mass is not None and float(mass.get("value", "0")) == 0.0:
            link.remove(inertial)
    own = robot.find("mujoco")
    if own is not None:
        robot.remove(own)
    ElementTree.SubElement(
        ElementTree.SubElement(robot, "mujoco"), "compiler", fusestatic="false", balanceinertia="false"
    )
    return ElementTree.tostring(robot, encoding="unicode"), left_out


def _check_depth(top: Element) -> None:
    """Raise ValueError for elements nested so deeply that the text cannot be written again."""
    level = [top]
    for _ in range(MOST_LEVELS):
        level = [child for element in level for child in element]
        if not level:
            return
    raise check.Unreadable("", f"elements are nested more than {MOST_LEVELS} deep")


def _check_joint(joint: Element, name: str) -> None:
    """Raise ValueError for a kind of joint that an arm does not have, or for an invalid number."""
    kind = joint.get("type")
    if kind is not None and kind not in KINDS:
        raise check.InvalidValue(f"joint {name}", kind, 'must be "revolute", "continuous" or "fixed"')
    if joint.find("mimic") is not None:
        what = "must not follow another joint (mimic): each joint of an arm turns by itself"
        raise check.InvalidValue(f"joint {name}", "mimic", what)
    _check_numbers(joint, f"joint {name}")


def _check_numbers(parent: Element, path: str) -> None:
    """Raise ValueError for an attribute that does not consist of finite numbers."""
    for part in parent.iter():
        for word in NUMBERS.get(part.tag, ()):
            text = part.get(word)
            if text is None:
                continue
            try:
                values = [float(one) for one in text.split()]
            except ValueError:
                values = []
            count = 3 if word in ("xyz", "rpy") else 1
            if len(values) != count or not all(map(math.isfinite, values)):
                what = "a finite number" if count == 1 else f"{count} finite numbers"
                raise check.InvalidValue(f"{path}.{part.tag}.{word}", text, f"must be {what}")


def _limits(joint: Element, name: str) -> list[str]:
    """Validate a joint's limits; return sentences on limits that are ignored.

    Limits with equal ends are removed: exporters write them for joints without limits.
    """
    limit = joint.find("limit")
    if limit is None or joint.get("type") != "revolute":
        return []
    low, high, effort = (float(limit.get(word, "0")) for word in ("lower", "upper", "effort"))
    if low > high:
        raise check.InvalidValue(f"joint {name}.limit", (low, high), "must be lower < upper (rad)")
    if effort < 0.0:
        raise check.InvalidValue(f"joint {name}.limit.effort", effort, "must be a number, zero or positive (N m)")
    found = []
    if low == high and ("lower" in limit.attrib or "upper" in limit.attrib):
        limit.attrib.pop("lower", None)
        limit.attrib.pop("upper", None)
        found.append(f"limits of {name}, whose ends are both {low:g} rad")
    if effort == 0.0 and "effort" in limit.attrib:
        found.append(f"torque limit of {name}, which is 0")
    return found
