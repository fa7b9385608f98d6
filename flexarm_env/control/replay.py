"""Replay plans: simulate their torques on a finer mesh with shorter steps, also between control instants."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..physics.elastica.chain import Line, chain, nodes
from ..validation import Array
from .dynamics import Dynamics

FINER = 4
"""Replay steps per step of a plan."""

BENT, LEAST, OTHERS = 0.05, 5e-4, 0.01
"""Tolerances of a replay. BENT: excess over the deflection bound, divided by the bound. LEAST: smallest allowed excess
over the deflection bound, divided by a link's length. OTHERS: violation of all other limits and of the goal. Angles are
in rad, rates are divided by the arm's characteristic rate, and distances by the arm's length."""

Missed = Callable[[Dynamics, Array], Array]
"""Function of a plant and states (T, n, S) that returns each arm's largest violation of limits, (n,)."""


@dataclass(frozen=True)
class Replay:
    """Result of simulating a plan's controls with a quarter of the step and, in the plane, twice as many nodes.

    Attributes:
        deflection (n, D): largest magnitude of `Dynamics.bends`, at control instants and between them.
        off (n, N): joint angles at the planned arrival minus the goal's joint angles, rad; nan without a goal.
        rates (n, N): joint rates at the planned arrival, rad/s; nan without a goal.
        missed (n,): largest violation of the bounds and the goal, in the units of `Motion.missed`.
        kept (n,): True if the tolerances `BENT`, `LEAST` and `OTHERS` are met: the deflection exceeds its bound by at
            most 5 % or 5e-4, and the violation of all other limits and of the goal is at most 0.01.
    """

    deflection: Array
    off: Array
    rates: Array
    missed: Array
    kept: NDArray[np.bool_]


@lru_cache(maxsize=16)
def finer(plant: Dynamics) -> Dynamics:
    """Return dynamics with a period of a quarter of the plan's step, and in the plane up to twice as many nodes."""
    assert plant.settings.dt is not None
    period = plant.settings.dt / FINER
    return plant.finer(period)


def _places(line: Line, tip: bool) -> Array:
    """Return arc lengths (nodes,), m, of a link's nodes from its root; tip: whether the last node is the tip."""
    found = np.zeros(line.n)
    for a, b, first, functions in line.pieces:
        k = len(functions.own)
        found[first : first + k] = a + 0.5 * (b - a) * (1.0 + nodes(k, tip or b < line.length))
    return found


def refined(plant: Dynamics, fine: Dynamics, x: Array) -> Array:
    """Interpolate states (n, S) to the nodes of the finer dynamics with the polynomials that define the node angles."""
    if plant.nodes == fine.nodes:
        return x
    known, wanted = chain(plant.arm, plant.nodes), chain(fine.arm, fine.nodes)
    out = np.zeros((len(x), fine.size))
    for part in range(2):  # angles, rates
        before = np.zeros(len(x))  # of the tip of the link before
        for k, (line, more) in enumerate(zip(known.lines, wanted.lines, strict=True)):
            own = x[:, part * plant.half + k * plant.nodes : part * plant.half + (k + 1) * plant.nodes].copy()
            joint = own[:, 0].copy()
            # from joint angle to absolute tangent angle of the first node
            own[:, 0] += before
            # evaluate the interpolating polynomial at the finer nodes
            values = own @ line.lagrange(_places(more, k < plant.n_inputs - 1)).T
            at = part * fine.half + k * fine.nodes
            out[:, at : at + fine.nodes] = values
            out[:, at] = joint
            before = own @ line.tip_angle
    return out


def replay(
    plant: Dynamics, start: Array, controls: Array, ends: NDArray[np.int64], goal: Array | None, bound: float,
    missed: Missed, rate: float,
) -> Replay:  # fmt: skip
    """Simulate controls (T, n, N) from the states `start` (n, S) with finer dynamics.

    Args:
        plant: dynamics of the plan. ends (n,): control periods after which each arm must be at rest at its goal.
        goal (n, S): states at the goal; None: no goal. bound: largest permitted deflection divided by length; inf: no
            bound. missed: function that returns the violation of all other limits.
        rate: characteristic joint rate (`optimal.rates_of`), rad/s, by which joint rates are divided.
    """
    fine = finer(plant)
    x, shares = refined(plant, fine, start), round(plant.period / fine.period)
    count, joints = len(x), fine.joints
    deflection, worst = np.abs(fine.deflections(x)), np.zeros(count)
    off, rates = np.full((2, count, plant.n_inputs), np.nan)
    for k, u in enumerate(controls):
        states = np.empty((shares, *x.shape))
        for i in range(shares):
            x = states[i] = fine.advance(x, u)
        on = k < ends  # what follows is not the plan's
        deflection[on] = np.maximum(deflection, np.abs(fine.deflections(states)).max(axis=0))[on]
        worst[on] = np.maximum(worst, missed(fine, states))[on]
        there = ends == k + 1
        if goal is not None and there.any():
            off[there] = (x[:, joints] - goal[:, plant.joints])[there]
            rates[there] = x[there][:, fine.half + joints]
    if goal is not None:
        worst = np.max([worst, np.abs(off).max(axis=1), np.abs(rates).max(axis=1) / rate], axis=0)
    bent = np.maximum(0.0, deflection.max(axis=1) / bound - 1.0)
    # a failed simulation violates everything
    failed = ~np.isfinite(deflection).all(axis=1) | np.isnan(worst)
    bent, worst = np.where(failed, np.inf, bent), np.where(failed, np.inf, worst)
    return Replay(
        deflection, off, rates, np.maximum(bent, worst), (bent <= max(BENT, LEAST / bound)) & (worst <= OTHERS)
    )
