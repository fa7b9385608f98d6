"""The initial vibration of an episode: a rate of change of the arm's shape in its first mode, the hub free."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..batch import standing_scene
from ..parameters import Arm
from ..physics.layout import ROOT, ROOT_RATES, TIP, TIP_RATES
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
