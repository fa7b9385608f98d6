"""Contact points along links: divide the links of a scene at the contact points."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

from flexarm_env import validation as check
from flexarm_env.parameters import Arm, Elbow, Joint
from flexarm_env.scene.contacts import Contact, place_on_link
from flexarm_env.scene.definition import Scene
from flexarm_env.scene.drives import JointTorque, Load, Motion
from flexarm_env.sections import ENDS, Link, Section


def at_points(scene: Scene) -> Scene:
    """Return the scene with links divided at their contact points, such as "link0@0.5".

    The pieces of a link are separate links with rigid joints between them, because all formulations compute contact at
    the ends of links. Joints, links and bodies keep their order but get new numbers. A scene without contact points
    along links is returned unchanged.

    Raises:
        ValueError: a divided link is curved or has a varying section, or the arm has sensors on links.
    """
    places = {place: contact for contact in scene.contacts for place in map(place_on_link, contact.bodies) if place}
    if not places:
        return scene
    arm = scene.arm
    if arm.sensors is not None:
        raise check.InvalidValue("arm.sensors", arm.sensors, "must be None with contact points along links")
    cuts = {k: sorted({s for link, s in places if link == k}) for k in range(arm.n_links)}
    # first[k]: new number of the first piece of link k; joint[(k, s)]: number of the joint at a point
    first: list[int] = []
    joint: dict[tuple[int, float], int] = {}
    links: list[Any] = []
    for k, link in enumerate(arm.links):
        first.append(len(links))
        joint |= {(k, s): len(links) + 1 + i for i, s in enumerate(cuts[k])}
        links += _pieces(k, link, cuts[k])
    first.append(len(links))
    new = {n: place for place, n in joint.items()}
    radii = {
        joint[place]: next(c.radius for c in scene.contacts if place in map(place_on_link, c.bodies)) for place in joint
    }
    old = {first[k]: k for k in range(arm.n_links)}
    elbows = tuple(Elbow(radius=radii[n]) if n in new else arm.elbow(old[n]) for n in range(1, len(links)))
    divided = dataclasses.replace(
        arm, links=tuple(links), elbows=elbows, torque_limits=None, joint_limits=None,
        joints=tuple(Joint() if n in new else arm.joint(old[n]) for n in range(len(links))) if arm.joints else (),
    )  # fmt: skip

    # absolute angles in the plane; joint angles in space, 0 at rigid joints
    def of_links(values: tuple[float, ...]) -> tuple[float, ...]:
        own = [values[max(k for k in range(arm.n_links) if first[k] <= n)] for n in range(len(links))]
        return tuple(arm.axes.behind_rigid_joint(value) if n in new else value for n, value in enumerate(own))

    return dataclasses.replace(
        scene, arm=divided, angles=of_links(scene.angles), rates=of_links(scene.rates),
        rigid_joints=(*(first[k] for k in scene.rigid_joints), *new),
        motions=tuple(_motion(motion, first) for motion in scene.motions),
        loads=tuple(_load(load, first) for load in scene.loads),
        contacts=tuple(_contact(contact, first, joint, arm) for contact in scene.contacts),
    )  # fmt: skip


def _pieces(k: int, link: Any, cuts: list[float]) -> list[Link]:
    """Return link k in pieces that end at the fractions `cuts` of its length."""
    if not cuts:
        return [link]
    if not isinstance(link, Link) or not isinstance(link.section, Section) or link.curved:
        what = "must be straight with one Section along its length for contact points along it"
        raise check.InvalidValue(f"arm.links[{k}]", link, what)
    ends = [0.0, *cuts, 1.0]
    pieces = []
    for i, (a, b) in enumerate(itertools.pairwise(ends)):
        # rigid ends stay at the link's ends
        gone: dict[str, Any] = {
            name: 0.0 for name in ENDS
            if (name.startswith("root") and i > 0) or (name.startswith("tip") and i + 2 < len(ends))
        }  # fmt: skip
        pieces.append(dataclasses.replace(link, length=(b - a) * link.length, **gone))
    return pieces


def _motion(motion: Motion, first: list[int]) -> Motion:
    """Return the motion with the new number of its joint."""
    if motion.joint is None:
        return motion
    return dataclasses.replace(motion, coordinate=f"{motion.coordinate[:5]}{first[motion.joint]}")


def _load(load: Load, first: list[int]) -> Load:
    """Return the load with the new number of its joint or link."""
    if isinstance(load, JointTorque):
        return dataclasses.replace(load, joint=first[load.joint])
    return dataclasses.replace(load, link=first[load.link] if load.end == "root" else first[load.link + 1] - 1)


def _contact(contact: Contact, first: list[int], joint: dict[tuple[int, float], int], arm: Arm) -> Contact:
    """Return the contact with the new numbers of its points, which are all joints or the tip."""
    bodies = []
    for name, k in zip(contact.bodies, contact.links(arm), strict=True):
        place = place_on_link(name)
        bodies.append(name if name == "tip" else f"joint{joint[place] if place else first[k + 1]}")
    return dataclasses.replace(contact, bodies=tuple(bodies))
