"""Assembly of contact: the record `Touching` of a scene's contacts, and whether the time step resolves them."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexarm_env.physics.contact.layout import HERE, LAW, READ, Touching, Watch
from flexarm_env.physics.layout import POSE, SPACE_POSE
from flexarm_env.physics.obstacles import packed
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.time_functions import constant


def links_of(scene: Scene) -> list[int]:
    """Return the links at whose tips points may touch, in order."""
    return sorted({k for contact in scene.contacts for k in contact.links(scene.arm)})


def loads_of(scene: Scene) -> list[PointLoad]:
    """Return a point load of no force for each point that may touch, as memory for the forces of obstacles."""
    return [PointLoad(k, "tip", constant(0.0)) for k in links_of(scene)]


def touching(scene: Scene, entry: int, at: int, rows: int) -> tuple[Touching, Watch, int]:
    """Return the contribution, what the integrator watches of it, and how many numbers it has in S.

    entry: first of the points' inputs. at: offset of its numbers in S. rows: of the Model.
    """
    arm, contacts, links = scene.arm, scene.contacts, links_of(scene)
    space = 3 if scene.spatial else 2
    radii = np.array([arm.payload.radius if k + 1 == arm.n_links else 0.0 for k in links])
    # friction on a sphere's surface has a moment about its center
    turned = bool(radii.any()) and any(contact.friction > 0.0 for contact in contacts)
    axes = space + (1 if space == 2 else 3) * turned
    laws = [
        LAW.pack(
            {}, stiffness=contact.stiffness, halves=2.0 * contact.exponent, damping=contact.damping,
            friction=contact.friction, creep=contact.creep,
        )
        for contact in contacts
    ]  # fmt: skip
    meets = [[float(k in contact.links(arm)) for contact in contacts] for k in links]
    size = int(HERE.offsets(0, axes, rows).end)
    part = Touching(
        input=entry, at=at, points=(0,) * len(links), entries=(0,) * (3 if space == 2 else 6), space=(0,) * space,
        axes=(0,) * axes, room=(0,) * rows, poses=(0,) * ((POSE.end if space == 2 else SPACE_POSE.end) * arm.n_links),
        links=np.array(links, np.int64), radii=radii, meets=np.array(meets).ravel(),
        shapes=packed([contact.obstacle for contact in contacts]), laws=np.concatenate(laws),
        sliding=np.zeros(len(links)),
    )  # fmt: skip
    # a weighted increment of 1 in every row moves a point by at most the arm's length each
    watch = Watch((0,) * len(links), at, READ.end, size, rows * arm.total_length)
    return part, watch, size * len(links)


def entries_of(part: Any) -> int:
    """Return how many inputs the points have."""
    return len(part.points) * len(part.entries)
