"""Write a chain as a model of MuJoCo (MJCF)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from flexarm_env import rotations
from flexarm_env import validation as check
from flexarm_env.validation import Array

from .chain import LEAST, Body, Chain
from .linear import chain_modes

Element = ElementTree.Element
LEAST_STEP = 1e-4
"""Smallest step, s, of the explicit integrator; stiffer chains need an implicit one."""


def text_of(values: Iterable[float]) -> str:
    """Format numbers, separated by spaces, with enough digits to recover the same doubles; -0 is written as 0."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def legal(text: str) -> str:
    """Replace each character that XML does not allow, such as a control character, by "?"."""
    return re.sub("[^\\t\\n\\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "?", text)


def comment_of(line: str) -> str:
    """Format a line as the text of an XML comment; double hyphens, which XML forbids there, become single hyphens."""
    return f" {legal(line).replace('--', '-').rstrip('-')} "


def diagonal(inertia: Array, floor: float = LEAST) -> tuple[Array, Array]:
    """Return principal moments of inertia (3,), each at least `floor`, and the quaternion (4,) of the principal axes.

    Moments below `floor`, such as the moment of a thin rod about its axis, are raised to `floor`. The smallest moment
    is raised until the largest moment is at most the sum of the two others, as MuJoCo requires.

    inertia (3, 3): inertia tensor, kg m^2. floor: smallest moment of inertia, kg m^2.
    """
    own, axes = np.linalg.eigh(inertia)
    own = np.maximum(own, floor)
    own[0] = max(own[0], own[2] - own[1])
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    if np.abs(inertia - np.diag(np.diag(inertia))).max() < 1e-12 * own[2]:
        # already diagonal: keep its axes
        own, axes = np.maximum(np.diag(inertia), floor), np.eye(3)
        k = int(np.argmax(own))
        rest = own.sum() - own[k]
        if own[k] > rest:
            own[(k + 1) % 3] += own[k] - rest
    return own, rotations.quaternions(axes)


def choose_integrator(chain: Chain) -> tuple[str, float]:
    """Choose MuJoCo's integrator and its time step h, s, for a chain.

    "RK4" is explicit and of fourth order. The integrator "RK4" requires h omega <= 1 and 2 zeta h omega <= 1 for the
    highest frequency omega, rad/s, with its damping ratio zeta. If a step of `LEAST_STEP` satisfies both conditions,
    the function returns "RK4" and a step of at most 2 ms. If not, the function returns "discrete", an implicit
    integrator of first order in MuJoCo 4, and a step of 0.5 ms.
    """
    frequencies, ratios = chain_modes(chain, clamped=False)
    omega = 2.0 * np.pi * frequencies
    fastest = max(float(np.max(omega * np.maximum(1.0, 2.0 * ratios), initial=0.0)), 500.0)
    if 1.0 / fastest < LEAST_STEP:
        return "discrete", 5e-4
    # two leading digits, rounded down
    digits = 10.0 ** (math.floor(math.log10(1.0 / fastest)) - 1)
    return "RK4", float(f"{math.floor(1.0 / fastest / digits + 1e-9) * digits:.2g}")


def mjcf(
    chain: Chain,
    *,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    timestep: float | None = None,
    integrator: str | None = None,
    comments: Iterable[str] = (),
) -> str:
    """Return a chain as the text of an MJCF file.

    Bodies and hinges have the same names as in the chain. Each joint has a motor, `motor0`, ..., whose control is the
    torque in N m, clipped to the arm's torque limit. The site `tip` is the arm's tip; its x axis points along the last
    link. Geoms are for display only and do not collide.

    Args:
        chain: the chain. gravity: acceleration of gravity, m/s^2. timestep: time step, s. integrator: MuJoCo's name of
            the integrator. If timestep or integrator is None, `choose_integrator` selects the value. comments: lines of
            text at the top of the file.
    """
    chosen, step = choose_integrator(chain)
    if timestep is not None:
        step = check.number("timestep", timestep, "s", above=0.0)
    arm = chain.arm
    root = ElementTree.Element("mujoco", model=legal(arm.name))
    for line in comments:
        root.append(ElementTree.Comment(comment_of(line)))
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ElementTree.SubElement(
        root, "option", gravity=text_of(gravity), timestep=f"{step:.6g}", integrator=integrator or chosen
    )
    ElementTree.SubElement(option, "flag", contact="disable")
    at = ElementTree.SubElement(root, "worldbody")
    for i, body in enumerate(chain.bodies):
        at = _body(at, body, i, chain)
    ElementTree.SubElement(
        at, "site", name="tip", pos=text_of(chain.tip), quat=text_of(rotations.quaternions(chain.tip_rotation))
    )
    _motors(root, chain)
    _sensors(root, chain)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _body(parent: Element, body: Body, i: int, chain: Chain) -> Element:
    """Append a body with hinges, inertia and a capsule."""
    found = ElementTree.SubElement(
        parent, "body", name=body.name, pos=text_of(body.position), quat=text_of(rotations.quaternions(body.rotation))
    )
    own, axes = diagonal(body.inertia)
    ElementTree.SubElement(
        found, "inertial", pos=text_of(body.centre), quat=text_of(axes), mass=text_of([max(body.mass, LEAST)]),
        diaginertia=text_of(own),
    )  # fmt: skip
    for hinge in body.hinges:
        words = {"name": hinge.name, "type": "hinge", "axis": text_of(hinge.axis)}
        for name, value in (("stiffness", hinge.stiffness), ("damping", hinge.damping), ("armature", hinge.armature),
                            ("frictionloss", hinge.friction)):  # fmt: skip
            if value:
                words[name] = text_of([value])
        if hinge.limits is not None:
            words["range"] = text_of(hinge.limits)
        ElementTree.SubElement(found, "joint", words)
    length = float(np.linalg.norm(body.end))
    if length > 0.0:
        size = text_of([0.01 * chain.arm.total_length])
        words = {"type": "capsule", "fromto": text_of([0.0, 0.0, 0.0, *body.end]), "size": size}
        color = "0.2 0.4 0.6 1" if body.link % 2 == 0 else "0.8 0.5 0.2 1"
        ElementTree.SubElement(found, "geom", {**words, "rgba": color, "contype": "0", "conaffinity": "0", "mass": "0"})
    return found


def _motors(root: Element, chain: Chain) -> None:
    motors = ElementTree.SubElement(root, "actuator")
    limits = chain.arm.torque_limits
    for hinge in chain.hinges:
        if hinge.driven:
            words = {"name": f"motor{hinge.joint}", "joint": hinge.name}
            if limits is not None:
                words["ctrlrange"] = text_of([-limits[hinge.joint], limits[hinge.joint]])
            ElementTree.SubElement(motors, "motor", words)


def _sensors(root: Element, chain: Chain) -> None:
    """Append sensors of joint angles, joint rates and tip position, and the arm's own sensors with their noise."""
    found, own = ElementTree.SubElement(root, "sensor"), chain.arm.sensors
    for hinge in (hinge for hinge in chain.hinges if hinge.joint >= 0):
        noise = own.encoder(hinge.joint).noise if own is not None and own.encoders and hinge.driven else 0.0
        words = {"joint": hinge.name} | ({"noise": text_of([noise])} if noise else {})
        ElementTree.SubElement(found, "jointpos", {"name": f"{hinge.name}_angle", **words})
        ElementTree.SubElement(found, "jointvel", {"name": f"{hinge.name}_rate", **words})
    ElementTree.SubElement(found, "framepos", name="tip_position", objtype="site", objname="tip")
    if own is None:
        return
    for name, law in (("accelerometer", own.accelerometer), ("gyro", own.gyroscope)):
        if law is not None:
            ElementTree.SubElement(found, name, name=f"tip_{name}", site="tip", noise=text_of([law.noise]))
    axes = {"xy": 2, "xz": 1, "torsion": 0}
    for i, gauge in enumerate(own.strain_gauges):
        # the angle of the spring nearest to the gauge
        place = gauge.place * chain.arm.links[gauge.link].length
        springs = [
            hinge for body in chain.bodies if body.link == gauge.link for hinge in body.hinges
            if hinge.joint < 0 and hinge.axis[axes[gauge.measures]]
        ]  # fmt: skip
        if springs:
            nearest = min(springs, key=lambda hinge: abs(hinge.place - place))
            ElementTree.SubElement(found, "jointpos", name=f"strain_gauge_{i + 1}", joint=nearest.name)
