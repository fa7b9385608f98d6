"""Initial vibration of an episode: rates of the coordinates in vibration modes of the arm.

In the plane the arm vibrates in its first mode with free joints. In space it vibrates in the first modes of bending
along y, of bending along z and of torsion. Modes of arms with backlash are computed without the backlash.
"""

import math

import numpy as np

from ..batch import standing_scene
from ..equations import Equations, at_rest_of, point_of, undamped
from ..parameters import Arm
from ..physics import assembly
from ..physics.layout import ROOT, ROOT_RATES, TIP, TIP_RATES
from ..physics.linalg import product, solve
from ..physics.model import Jointed
from ..physics.reading import link_deflection
from ..physics.space.layout import AXES, E
from ..physics.space.reading import Frame, LinkMotion, links
from ..rotations import back
from ..settings import Settings
from ..simulation import Simulation
from ..validation import Array


def shake(arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> Array:
    """Return the matrix S (n, 1 + 3 N) of initial rates v = S (1, alpha_k, cos alpha_k, sin alpha_k) in the first mode.

    The links are straight at absolute angles alpha_k. The amplitude is such that, without damping and to first order,
    the first link's tip would deflect by the link's length. For all angles alpha_k, each link has the rates of the
    straight arm's mode, in axes that turn with the link. S is computed from rates of angles, and from velocities of
    tips and of points within a link, each relative to the link's root.
    """
    assert settings.dt is not None
    arm, count = arm.taut, arm.n_links
    simulation = Simulation(standing_scene(arm, settings.dt, gravity, (0.0,) * count), settings)
    rates, poses = _rates(simulation)
    names, pose = simulation.system.names, assembly.pose_table(arm, settings, gravity)
    own = np.zeros_like(pose)
    own[:, 0] = rates
    slips = (poses[:, TIP_RATES] - poses[:, ROOT_RATES])[:, :2]  # of each link's tip, against its root
    for i, name in enumerate(names):
        if ".x" not in name:
            continue
        j = names.index(name.replace(".x", ".y"))
        reaches = np.flatnonzero(pose[i, 1 + count : 1 + 2 * count])  # links whose roots it is beyond
        last = reaches[-1] if reaches.size else int(name[4 : name.index(".")])  # none: off the line between nodes
        parts = [(k, slips[k]) for k in reaches[:-1]]
        within = rates[[i, j]] - sum((slip for _, slip in parts), np.zeros(2))
        own[[i, j]] = 0.0
        for k, (x, y) in (*parts, (last, within)):
            turning = [1 + count + k, 1 + 2 * count + k]
            own[i, turning], own[j, turning] = (x, -y), (y, x)
    return own


def _rates(simulation: Simulation) -> tuple[Array, Array]:
    """Return the rates (n,) of the straight arm's first mode, and the poses of its links.

    With the chosen sign the first link deflects to the left.
    """
    from scipy.linalg import eigh

    arm, equations = simulation.scene.arm, Equations(simulation)
    reduced = equations.reduced(point_of(simulation.work))
    K, M = 0.5 * (reduced.K + reduced.K.T), 0.5 * (reduced.M + reduced.M.T)
    squares, vectors = eigh(K, M)
    first = arm.n_links  # after the rigid turns of the joints
    square, mode = float(f"{squares[first]:.9g}"), vectors[:, first].round(7)
    for _ in range(3):  # inverse iteration from where all processors' libraries agree
        mode = solve(K - square * M, product(M, mode))
        mode /= math.sqrt(product(mode, product(M, mode)))
    square = float(product(mode, product(K, mode)))
    rates = np.zeros(equations.n)
    rates[equations.free] = product(reduced.lift, mode)
    simulation.work.v[:] = rates
    poses, _ = simulation.observe()
    moved = poses.copy()
    step = 1e-6
    for where, rates_of in ((ROOT, ROOT_RATES), (TIP, TIP_RATES)):
        moved[:, where] = poses[:, where] + step * poses[:, rates_of]
    deflection = (link_deflection(moved)[0] - link_deflection(poses)[0]) / step
    simulation.work.v[:] = rates / deflection * arm.links[0].span * math.sqrt(square)
    return simulation.work.v.copy(), simulation.observe()[0]


def swing(arm: Arm, settings: Settings, gravity: tuple[float, ...] | None = None) -> Array:
    """Return initial rates (n + 2, 3) of an arm in space in its lowest modes of y bending, z bending and torsion.

    The first n rows are rates for `protocol.set_joint_configuration`. The next row is the energy, J, for an amplitude
    of 1. The last row is (c, 0, 0), where c (s^2) is much larger than 1 / w^2 for every natural frequency w (rad/s).
    The modes are computed about straight links at joint angles 0, without gravity. A mode belongs to the deformation (y
    bending, z bending or torsion) that has the largest part of the mode's strain energy. If no mode belongs to a
    deformation, the rates in the deformation's column are 0. The three columns have equal energies. To first order,
    this energy would deflect a tip by its link's length in the softer bending direction.
    """
    assert settings.dt is not None
    arm = arm.taut
    simulation = Simulation(standing_scene(arm, settings.dt, None), settings, False)
    equations, point = at_rest_of(simulation)
    reduced = equations.reduced(point)
    squares, vectors = undamped(0.5 * (reduced.M + reduced.M.T), 0.5 * (reduced.K + reduced.K.T))
    model = equations.model
    sections = (model.arm if isinstance(model, Jointed) else model).sections.reshape(-1, E.end)
    stiffness = sections[:, E.EI : E.EI + 3] / sections[:, E.length, None]
    modes, energies = np.zeros((equations.n + 2, 3)), [math.inf] * 3
    for k in range(arm.n_links, len(squares)):  # after the rigid turns of the joints
        v = np.zeros(equations.n)
        v[equations.free] = vectors[:, k]  # of the energy 1/2 J
        moving = list(links(arm, settings, simulation.work.q[None], v[None]))
        own, strained = _within(moving, v)
        kind = int((stiffness * strained**2).sum(axis=0)[::-1].argmax())  # of z, y and x: bending along y, z, torsion
        if not modes[:, kind].any():
            tips = np.array([_slip(motion.root, motion.tip) for motion in moving])
            tips[:, :3] /= [[1.0 if link.rigid else link.span] for link in arm.links]
            named = tips[:, (1, 2, 3)[kind]]
            modes[:-2, kind] = own * np.sign(named[np.abs(named).argmax()])  # which way the tip goes
            energies[kind] = 0.5 * squares[k] / float((tips[:, 1:3] ** 2).sum(axis=1).max())
    modes[-2, modes.any(axis=0)] = min(energies[:2])
    modes[-1, 0] = 100.0 / squares[arm.n_links]
    return modes


def _slip(root: Frame, section: Frame) -> Array:
    """Return the rates (6,) of a section's position and rotation relative to another section, in that one's axes."""
    slip = section.v - root.v - np.cross(root.w, section.r - root.r)
    return np.concatenate([back(root.A, slip)[0], back(root.A, section.w - root.w)[0]])


def _within(moving: list[LinkMotion], v: Array) -> tuple[Array, Array]:
    """Return rates v (n,) in which the rates of vertices are relative to the root of their link (`_slip`).

    The second result is the rotation of each element's far end relative to its near end, (elements, 3).
    """
    own, strained, i = v.copy(), [], AXES
    for motion in moving:
        root, turned, i = motion.sections[0], np.zeros(3), i + 1
        for section in motion.sections[1:] or [root]:
            own[i : i + AXES] = _slip(root, section)
            if section is not root:
                strained.append(own[i + 3 : i + AXES] - turned)
            turned, i = own[i + 3 : i + AXES], i + AXES
    return own, np.array(strained)
