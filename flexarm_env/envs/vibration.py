"""The initial vibration of an episode: a rate of change of the arm's shape in its first mode, joints free; in space in
the first ones of bending along y, of bending along z and of torsion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..batch import standing_scene
from ..parameters import Arm
from ..physics.layout import ROOT, ROOT_RATES, TIP, TIP_RATES
from ..physics.space.layout import AXES, E
from ..physics.space.reading import Frame, LinkMotion, links
from ..rotations import back
from ..settings import Settings
from ..simulation import Simulation
from ..trajectory import link_deflection

Array = NDArray[np.float64]


def shake(arm: Arm, settings: Settings, gravity: tuple[float, ...] | None) -> Array:
    """Rates that set an arm vibrating in its first mode, at any hub angle alpha_0: the (n, 3) matrix S of
    v = S (1, cos alpha_0, sin alpha_0) for the straight arm.

    They are scaled so that the tip of the first link will deflect, undamped and to first order, by its length.
    """
    east = _rates(arm, settings, gravity, 0.0)
    north = _rates(arm, settings, gravity, math.pi / 2)
    # rows that turn with the arm (positions) change sign with half a turn; the others (angles) stay as they are
    west = _rates(arm, settings, gravity, math.pi)
    turning = np.abs(east + west) <= 1e-9 * np.abs(east).max()
    zero = np.zeros_like(east)
    turned, still = np.column_stack([zero, east, north]), np.column_stack([east, zero, zero])
    return np.ascontiguousarray(np.where(turning[:, None], turned, still))


def _rates(arm: Arm, settings: Settings, gravity: tuple[float, ...] | None, angle: float) -> Array:
    """The mode's rates with the straight arm at an angle; the first link deflects to the left first."""
    from scipy.linalg import eigh

    from ..linear.equations import Equations
    from ..linear.period import point_of

    assert settings.dt is not None
    simulation = Simulation(standing_scene(arm, settings.dt, gravity, (angle,) * arm.n_links), settings)
    equations = Equations(simulation)
    reduced = equations.reduced(point_of(simulation.work))
    squares, vectors = eigh(0.5 * (reduced.K + reduced.K.T), 0.5 * (reduced.M + reduced.M.T))
    first = arm.n_links  # after the rigid turns of the joints
    rates = np.zeros(equations.n)
    rates[equations.free] = reduced.lift @ vectors[:, first]
    simulation.work.v[:] = rates
    poses, _ = simulation.observe()
    moved = poses.copy()
    step = 1e-6
    for where, rates_of in ((ROOT, ROOT_RATES), (TIP, TIP_RATES)):
        moved[:, where] = poses[:, where] + step * poses[:, rates_of]
    deflection = (link_deflection(moved)[0] - link_deflection(poses)[0]) / step
    return np.asarray(rates / deflection * arm.links[0].span * math.sqrt(squares[first]))


def swing(arm: Arm, settings: Settings) -> Array:
    """Modes of an arm in space, (n + 2, 3): rates of each as `protocol.stand` takes them; the energy, J, that each has
    for an amplitude of 1; (c, 0, 0), c in s^2 long beside the square of one over any frequency.

    They are modes about straight links at joint angles 0, without weight: the lowest one in which most of what strains
    the links is bending along y, that of bending along z, that of torsion; 0 where there is none. All have the same
    energy: that with which in the softer bending, to first order, a tip will deflect by its link's length.
    """
    from ..linear.space import SmallMotions
    from ..linear.stability import undamped

    assert settings.dt is not None
    simulation = Simulation(standing_scene(arm, settings.dt, None), settings)
    motions = SmallMotions(simulation)
    M, K = (motions.slopes(simulation.work.q, which, motions.free) for which in (2, 0))
    squares, vectors = undamped(0.5 * (M + M.T), 0.5 * (K + K.T))
    sections = motions.chain.sections.reshape(-1, E.end)
    stiffness = sections[:, E.bend : E.bend + 3] / sections[:, E.length, None]
    modes, energies = np.zeros((motions.n + 2, 3)), [math.inf] * 3
    for k in np.flatnonzero(squares > 0.0):
        v = np.zeros(motions.n)
        v[motions.free] = vectors[:, k]  # of the energy 1/2 J
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
    modes[-1, 0] = 100.0 / squares[squares > 0.0].min()
    return modes


def _slip(root: Frame, section: Frame) -> Array:
    """Rates (6,) of a section's place and rotation against another, in that one's axes."""
    slip = section.v - root.v - np.cross(root.w, section.r - root.r)
    return np.concatenate([back(root.A, slip)[0], back(root.A, section.w - root.w)[0]])


def _within(moving: list[LinkMotion], v: Array) -> tuple[Array, Array]:
    """Rates v (n,) with those of vertices as `_slip` against their link's root; by how much each element's ends turn
    against each other (elements, 3)."""
    own, strained, i = v.copy(), [], AXES
    for motion in moving:
        root, turned, i = motion.sections[0], np.zeros(3), i + 1
        for section in motion.sections[1:] or [root]:
            own[i : i + AXES] = _slip(root, section)
            if section is not root:
                strained.append(own[i + 3 : i + AXES] - turned)
            turned, i = own[i + 3 : i + AXES], i + AXES
    return own, np.array(strained)
