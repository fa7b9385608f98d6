"""Lagrange's equations of energies alone: derivatives are complex steps (exact to round-off) and differences of
quadratic forms (exact likewise).

Arrays of coordinates may have any leading axes: the derivatives for all coordinates are taken at once.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[Any]
STEP = 1e-30


class Lagrange:
    """What has kinetic energy T(q, v), quadratic in v, potential energy U(q), Rayleigh's function R(q, v), quadratic in
    v, and displacements y(q) that inputs work on."""

    n: int

    def kinetic(self, q: Array, v: Array) -> Array:
        raise NotImplementedError

    def potential(self, q: Array) -> Array:
        raise NotImplementedError

    def dissipation(self, q: Array, v: Array) -> Array:
        raise NotImplementedError

    def ports(self, q: Array) -> Array:
        raise NotImplementedError

    def mass_matrix(self, q: Array) -> Array:
        """Hessian of the kinetic energy."""
        unit = np.eye(self.n)
        return 0.5 * (self.kinetic(q, unit[:, None] + unit) - self.kinetic(q, unit[:, None] - unit))

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """d/dt dT/dv - dT/dq + dU/dq + dR/dv - y_q' u."""
        unit = np.eye(self.n)
        r = 0.5 * (self.kinetic(q, a + unit) - self.kinetic(q, a - unit))  # M a
        along = q + 1j * STEP * v
        r = r + 0.5 * (self.kinetic(along, v + unit) - self.kinetic(along, v - unit)).imag / STEP
        moved = q + 1j * STEP * unit
        r = r + (self.potential(moved) - self.kinetic(moved, v + 0j * unit)).imag / STEP
        r = r + 0.5 * (self.dissipation(q, v + unit) - self.dissipation(q, v - unit))
        return r - (self.ports(moved).imag / STEP) @ u

    def run(self, q: Array, v: Array, inputs: Any, times: Array, held: tuple[int, ...] = ()) -> Array:
        """States (len(times), 2 n) by SciPy's DOP853 at 1e-9; `inputs` of t; `held` coordinates stay."""
        free = [i for i in range(self.n) if i not in held]

        def rate(t: float, state: Array) -> Array:
            q, v = state[: self.n], state[self.n :]
            a = np.zeros(self.n)
            M, f = self.mass_matrix(q), self.residual(q, v, a, inputs(t))
            a[free] = np.linalg.solve(M[np.ix_(free, free)], -f[free])
            return np.concatenate([v, a])

        result = solve_ivp(rate, (times[0], times[-1]), np.concatenate([q, v]), "DOP853", times, rtol=1e-9, atol=1e-9)
        assert result.success, result.message
        return np.asarray(result.y.T)
