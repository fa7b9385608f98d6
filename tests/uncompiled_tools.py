"""A system's equations, called alone on one arm; for files that run on plain Python numbers."""

from typing import Any

import numpy as np

from flexarm_env.compiler import SINGLE, size
from flexarm_env.physics.model import System
from flexarm_env.physics.protocol import FORMULATIONS, RESIDUAL_ALONE, State, Weights
from flexarm_env.validation import Array

States = tuple[Array, Array, Array, Array]
"""q, v, a, u."""


def close(mine: Any, other: Any, tolerance: float) -> bool:
    """Largest difference relative to the largest value."""
    mine, other = np.asarray(mine), np.asarray(other)
    return bool(np.abs(mine - other).max() <= tolerance * max(1.0, np.abs(other).max()))


class Equations:
    """What a formulation's functions say of a system. Arrays that they are to write start as NaN."""

    def __init__(self, system: System) -> None:
        self.system, self.model, self.par = system, system.model, system.par.copy()
        self.functions = FORMULATIONS.members[type(self.model)]
        self.n, self.n_factor = size(self.model.n), size(self.model.n_factor)
        self.n_inputs = size(self.model.n_inputs)
        self.constrained = [] if self.model.algebraic is None else list(self.model.algebraic)

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """The residual alone."""
        return self.with_room(q, v, a, u, np.full(self.n_factor, np.nan))

    def with_room(self, q: Array, v: Array, a: Array, u: Array, S: Array) -> Array:
        """The same, with S; rows of multipliers are left at zero."""
        r = np.full(self.n, np.nan)
        self.functions["assemble"](SINGLE, self.model, self.par, State(q, v, a), u, RESIDUAL_ALONE, r, S)
        r[self.constrained] = 0.0
        return r

    def assembled(self, state: States, weights: tuple[float, ...]) -> Array:
        """S as it is before it is factored; the residual that comes with it is that alone."""
        r, S = np.full(self.n, np.nan), np.full(self.n_factor, np.nan)
        self.functions["assemble"](SINGLE, self.model, self.par, State(*state[:3]), state[3], Weights(*weights), r, S)
        r[self.constrained] = 0.0
        assert close(r, self.residual(*state), 1e-13)
        return S

    def factored(self, state: States, weights: tuple[float, ...], pinned: tuple[int, ...] = ()) -> Array:
        """The iteration matrix's factors."""
        S = self.assembled(state, weights)
        for k in pinned:
            self.functions["add_stiffness"](SINGLE, self.model, S, k, None)
        self.functions["factor"](SINGLE, self.model, S)
        return S

    def solved(self, S: Array, b: Array) -> Array:
        """S^-1 b."""
        x = b.copy()
        self.functions["solve"](SINGLE, self.model, S, x)
        return x

    def tangent(self, state: States, weights: tuple[float, ...]) -> Array:
        """cm dr/da + cc dr/dv + ck dr/dq by central differences of the residual, which is linear in a and of second
        order in v; those of q are extrapolated (sixth order)."""
        q, v, a, u = state

        def along(d: Array, h: float) -> Array:
            return (self.residual(q + h * d, v, a, u) - self.residual(q - h * d, v, a, u)) / (2.0 * h)

        columns, h = [], 4e-3
        for d in np.eye(self.n):
            column = weights[0] * 0.5 * (self.residual(q, v, a + d, u) - self.residual(q, v, a - d, u))
            column += weights[1] * 0.5 * (self.residual(q, v + d, a, u) - self.residual(q, v - d, a, u))
            if weights[2]:
                slopes = 1.5 * along(d, h) - 0.6 * along(d, 2.0 * h) + 0.1 * along(d, 3.0 * h)
                column += weights[2] * slopes
            columns.append(column)
        return np.array(columns).T

    def check_solutions(
        self, state: States, weights: tuple[float, ...], pins: list[tuple[int, ...]], other: States
    ) -> Array:
        """Factored and solved, S is `tangent`, which is returned, with rows and columns of the identity for what is
        pinned; the residual alone, of another state, leaves the factors as they are."""
        wanted, rng = self.tangent(state, weights), np.random.default_rng(5)
        for pinned in pins:
            full, held = wanted.copy(), list(pinned)
            full[held] = 0.0
            full[:, held] = 0.0
            full[held, held] = 1.0
            S = self.factored(state, weights, pinned)
            for _ in range(2):
                b = rng.normal(size=self.n)
                b[held] = 0.0
                x = self.solved(S, b)
                left = np.abs(full @ x - b).max() / (np.abs(full) @ np.abs(x)).max()  # backward error
                assert left < 1e-9, (weights, pinned)
            self.with_room(*other, S)
            assert np.array_equal(x, self.solved(S, b))
        return wanted

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy."""
        return float(self.functions["energy"](SINGLE, self.model, self.par, q, v)[0])
