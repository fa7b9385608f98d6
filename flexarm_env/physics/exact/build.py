"""The geometrically exact beam (Simo & Vu-Quoc 1986) in the plane: a scene to its Model (docs: theory, "Exact beam").

Strains Gamma_1 = cos psi x' + sin psi y' - 1, Gamma_2 = -sin psi x' + cos psi y', kappa = psi' store the energy
1/2 (EA Gamma_1^2 + C Gamma_2^2 + EI kappa^2); elements of order p, p-point (reduced) Gauss quadrature for the energy,
p + 1 points for the consistent mass, which is constant. Absolute coordinates: there are no quadratic-velocity terms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexarm_env.parameters import Arm
from flexarm_env.physics.model import ExactBeam, System
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.settings import Settings

Array = NDArray[np.float64]


def factor_size(order: int) -> int:
    """Numbers of S an element takes: factors of its interior with their couplings, 21 condensed entries, 2 a point."""
    inner = 3 * (order - 1)
    return inner * (inner - 1) // 2 + 7 * inner + 21 + 2 * order


LEAST_ROTARY = 1e-8
"""Rotary inertia of a section, over m l^2 of its element of length l, that none falls below: without any the mass
matrix would be singular."""


def sections(arm: Arm, elements: int) -> Array:
    """Constants of each link's elements, see `ExactBeam.sections`."""
    rows = []
    for link in arm.links:
        h, s = 0.5 * link.length / elements, link.section
        J = max(s.J, LEAST_ROTARY * s.m * (2.0 * h) ** 2)
        rows.append([0.25 * s.EA / h, 0.25 * s.C / h, 0.25 * s.EI / h, 2.0 * h, s.m * h, J * h])
    return np.array(rows)


def straight(scene: Scene, elements: int, order: int) -> Array:
    """Coordinates of the chain with straight links at the scene's initial angles: interior coordinates vanish."""
    arm = scene.arm
    q = np.zeros(3 * order * elements * arm.n_links + 3 + arm.n_links - 1)
    x, y = scene.position
    q[:3] = x, y, scene.angles[0]
    row = 0
    for k, link in enumerate(arm.links):
        step = link.length / elements
        for e in range(elements):
            row += 3 * order
            share = (e + 1) * step
            q[row : row + 3] = x + share * np.cos(scene.angles[k]), y + share * np.sin(scene.angles[k]), scene.angles[k]
        x, y = q[row], q[row + 1]
        if k > 0:
            q[-arm.n_links + k] = scene.angles[k] - scene.angles[k - 1]
    return q


def rows(arm: Arm, elements: int, order: int) -> tuple[tuple[str, ...], dict[str, int]]:
    """Names of the rows (linkK.xE ... of vertex E, linkK.xE.J of an interior coordinate of element E), and where the
    joints' angles and the root's position are."""
    names = ["root_x", "root_y", "joint0"]
    for k in range(arm.n_links):
        for e in range(elements):
            names += [f"link{k}.{axis}{e}.{j}" for j in range(1, order) for axis in ("x", "y", "psi")]
            names += [f"link{k}.{axis}{e + 1}" for axis in ("x", "y", "psi")]
    names += [f"joint{k}" for k in range(1, arm.n_links)]
    named = ["root_x", "root_y", *[f"joint{k}" for k in range(arm.n_links)]]
    return tuple(names), {name: names.index(name) for name in named}


def load_rows(load: PointLoad, arm: Arm, elements: int, order: int) -> list[int]:
    """Rows of x, y, psi, and of the joint angle (-1: none) that make up the position and angle a load works on."""
    span = 3 * order * elements
    if load.end == "tip" or load.link == 0:
        first = span * (load.link + (load.end == "tip"))
        return [first, first + 1, first + 2, -1]
    first = span * load.link
    return [first, first + 1, first + 2, span * arm.n_links + 2 + load.link]


def build(scene: Scene, settings: Settings) -> System:
    """The scene's chain with ``settings.elements`` elements of ``settings.order`` a link."""
    assert settings.elements is not None and settings.order is not None
    arm, elements, order = scene.arm, settings.elements, settings.order
    names, coordinates = rows(arm, elements, order)
    fixed = [coordinates[f"joint{k}"] for k in scene.rigid_joints]
    if scene.root == "pinned":
        fixed += [coordinates[name] for name in ("root_x", "root_y") if scene.motion_of(name) is None]
    loads = [load_rows(load, arm, elements, order) for load in scene.loads if isinstance(load, PointLoad)]
    lengths = np.array([name.startswith("root") or ".x" in name or ".y" in name for name in names])
    elbows = [arm.elbow(k) for k in range(1, arm.n_links)]
    model = ExactBeam(
        n=len(names),
        n_factor=9 + 4 * (arm.n_links - 1) + elements * arm.n_links * factor_size(order),
        n_inputs=arm.n_links + 3 * len(loads),
        fixed=np.array(fixed, dtype=np.int64),
        algebraic=None,
        weight=np.where(lengths, 1.0 / arm.total_length, 1.0),
        predictor=None,
        correction=2.0 * settings.period_error if settings.period_correction else None,
        order=(0,) * order,
        links=arm.n_links,
        elements=elements,
        sections=sections(arm, elements).ravel(),
        elbows=np.array([[e.mass, e.inertia_left, e.inertia_right] for e in elbows]).ravel(),
        hub_inertia=arm.hub_inertia,
        damped=(0,) if arm.tau_d > 0.0 else None,
        gravity=None if scene.gravity is None else np.array(scene.gravity),
        loads=np.array(loads, dtype=np.int64).ravel() if loads else None,
    )
    par = np.array([arm.payload.mass, arm.payload.inertia, 1.0, arm.tau_d])
    q0 = straight(scene, elements, order)
    return System(model, par, q0, np.zeros(len(names)), coordinates, names, {})
