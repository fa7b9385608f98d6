"""An elastica of another derivation: energies by quadrature of the fields r(s), forces from them by complex step.

Nothing here uses the package's mechanics: Lagrange polynomials are products, the mass matrix is the Hessian of the
kinetic energy, and Lagrange's equations are formed by differentiating the energies (step 1e-30, exact to round-off).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import eval_jacobi

from flexarm_env.parameters import Arm

Array = NDArray[Any]
STEP = 1e-30


def oracle_nodes(n: int, tip: bool) -> Array:
    """Radau's (first at -1) or Lobatto's nodes as zeros of Jacobi polynomials."""
    degree, beta = (n - 2, 1) if tip else (n - 1, 1)
    alpha = 1 if tip else 0
    fine = np.cos(np.linspace(np.pi, 0.0, 4001))
    values = eval_jacobi(degree, alpha, beta, fine)
    zeros = [
        brentq(lambda x: eval_jacobi(degree, alpha, beta, x), a, b, xtol=1e-15)
        for a, b, u, v in zip(fine[:-1], fine[1:], values[:-1], values[1:], strict=True)
        if u * v < 0
    ]
    return np.array([-1.0, *zeros, *([1.0] if tip else [])])


class Oracle:
    """Chain of an arm with n nodes a link; coordinates as in the package: joint and node angles, x, y if free.

    x and y are those of the root, or of the centre of mass (`centred`).
    """

    def __init__(
        self,
        arm: Arm,
        n: int,
        *,
        free: bool = False,
        centred: bool = False,
        gravity: tuple[float, float] | None = None,
        loads: tuple[tuple[int, str], ...] = (),
        points: int = 40,
    ) -> None:
        self.arm, self.n, self.free, self.gravity, self.loads = arm, n, free, gravity, loads
        self.centred = centred
        x, self.weights = np.polynomial.legendre.leggauss(points)
        self.values, self.slopes, self.integrals, self.tips, self.ends, self.ds = [], [], [], [], [], []
        for k, link in enumerate(arm.links):
            at = oracle_nodes(n, k < arm.n_links - 1)
            half = 0.5 * link.length

            def lagrange(s: Array, at: Array = at) -> Array:
                s = np.asarray(s, dtype=complex)
                rows = [np.prod([(s - at[j]) / (at[l] - at[j]) for j in range(n) if j != l], axis=0) for l in range(n)]
                return np.array(rows).T

            self.values.append(lagrange(x).real)
            self.slopes.append((lagrange(x + 1j * STEP).imag / STEP) / half)

            def integral(end: float, lagrange: Any = lagrange, half: float = half) -> Array:
                span = 0.5 * (end + 1.0)
                gauss, w = np.polynomial.legendre.leggauss(n + 2)
                return np.asarray(half * span * (w @ lagrange(-1.0 + span * (gauss + 1.0)).real))

            self.integrals.append(np.array([integral(s) for s in x]))
            self.ends.append(integral(1.0))
            self.tips.append(lagrange(np.array([1.0]))[0].real)
            self.ds.append(half * self.weights)
        self.size = n * arm.n_links + (2 if free else 0)

    def angles(self, q: Array) -> list[Array]:
        """Nodes' angles of each link."""
        out: list[Array] = []
        for k in range(self.arm.n_links):
            phi = np.array(q[k * self.n : (k + 1) * self.n])
            if k:
                phi[0] = phi[0] + self.tips[k - 1] @ out[-1]
            out.append(phi)
        return out

    def walk(self, q: Array) -> list[dict[str, Array]]:
        """Fields of each link at the quadrature points, and its ends, from the coordinates."""
        root: Array = np.zeros(2)
        links = []
        for k, phi in enumerate(self.angles(q)):
            e = np.array([np.cos(phi), np.sin(phi)])
            tip = root + e @ self.ends[k]
            links.append(
                {
                    "r": root[:, None] + e @ self.integrals[k].T,
                    "phi": self.values[k] @ phi,
                    "nodal": phi,
                    "kappa": self.slopes[k] @ phi,
                    "root": root,
                    "root_angle": phi[0],
                    "tip": tip,
                    "tip_angle": self.tips[k] @ phi,
                }
            )
            root = tip
        if self.free:
            move = np.array(q[-2:]) - (self.centre(links) if self.centred else 0.0)
            for link in links:
                link["r"] = link["r"] + move[:, None]
                link["root"], link["tip"] = link["root"] + move, link["tip"] + move
        return links

    def centre(self, links: list[dict[str, Array]]) -> Array:
        """Centre of mass."""
        arm, first, mass = self.arm, np.zeros(2), 0.0
        for k, link in enumerate(links):
            weights = arm.links[k].section.m * self.ds[k]
            end = arm.payload.mass if k == arm.n_links - 1 else arm.elbow(k + 1).mass
            first = first + link["r"] @ weights + end * link["tip"]
            mass += float(weights.sum()) + end
        return np.asarray(first / mass)

    def rates(self, q: Array, v: Array) -> list[dict[str, Array]]:
        """Rates of all that `walk` gives, along the velocity v."""
        return [{name: np.imag(value) / STEP for name, value in link.items()} for link in self.walk(q + 1j * STEP * v)]

    def masses(self, link: dict[str, Array], k: int) -> list[tuple[Any, Any]]:
        """Pairs (mass or inertia, rate) of link k at its points and ends."""
        arm, section = self.arm, self.arm.links[k].section
        last = k == arm.n_links - 1
        pairs: list[tuple[Any, Any]] = [
            (section.m * self.ds[k], link["r"][0]),
            (section.m * self.ds[k], link["r"][1]),
            # Lobatto's nodes (links with another behind) carry rotary inertia by their own quadrature
            (section.J * self.ds[k], link["phi"]) if last else (section.J * self.ends[k], link["nodal"]),
            (arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right, link["root_angle"]),
            (arm.payload.inertia if last else arm.elbow(k + 1).inertia_left, link["tip_angle"]),
        ]
        mass = arm.payload.mass if last else arm.elbow(k + 1).mass
        return [*pairs, (mass, link["tip"][0]), (mass, link["tip"][1])]

    def mass_matrix(self, q: Array) -> Array:
        """Hessian of the kinetic energy: the form is quadratic, so its values on unit velocities suffice."""
        M = np.zeros((self.size, self.size), dtype=q.dtype)
        for k, link in enumerate(self.jacobians(q)):
            for weight, J in self.masses(link, k):
                J = np.atleast_2d(J)
                M = M + (J.T * np.atleast_1d(weight)) @ J
        return M

    def jacobians(self, q: Array) -> list[dict[str, Array]]:
        """Derivatives of all that `walk` gives by the coordinates; by hand, so that q may be complex."""
        n, cols = self.n, self.size
        root, turned = np.zeros((2, cols), dtype=q.dtype), np.zeros(cols, dtype=q.dtype)
        links = []
        for j, phi in enumerate(self.angles(q)):
            angle = np.zeros((n, cols), dtype=q.dtype)
            for i in range(n):
                angle[i, j * n + i] = 1.0
            angle[0] = angle[0] + turned
            c, s = np.cos(phi), np.sin(phi)
            e = np.array([-s[:, None] * angle, c[:, None] * angle])
            tip = root + np.einsum("l,xlc->xc", self.ends[j], e)
            turned = self.tips[j] @ angle
            links.append(
                {
                    "r": root[:, None] + np.einsum("pl,xlc->xpc", self.integrals[j], e),
                    "phi": self.values[j] @ angle,
                    "nodal": angle,
                    "root_angle": angle[0],
                    "tip": tip,
                    "tip_angle": turned,
                }
            )
            root = tip
        if self.free:
            move = np.zeros((2, cols), dtype=q.dtype)
            move[0, -2] = move[1, -1] = 1.0
            if self.centred:
                turning = [{"r": np.moveaxis(link["r"], 1, 2), "tip": link["tip"]} for link in links]
                move = move - np.array([self.centre(self._column(turning, i)) for i in range(cols)]).T
            for link in links:
                link["r"], link["tip"] = link["r"] + move[:, None], link["tip"] + move
        return links

    @staticmethod
    def _column(links: list[dict[str, Array]], i: int) -> list[dict[str, Array]]:
        return [{"r": link["r"][:, i], "tip": link["tip"][:, i]} for link in links]

    def kinetic(self, q: Array, v: Array) -> float:
        """Kinetic energy from the rates of the fields."""
        total = 0.0
        for k, link in enumerate(self.rates(q, v)):
            total += sum(0.5 * float(np.sum(weight * np.asarray(rate) ** 2)) for weight, rate in self.masses(link, k))
        return total

    def potential(self, q: Array) -> Any:
        """Strain and gravity energy."""
        total: Any = 0.0
        for k, link in enumerate(self.walk(q)):
            section = self.arm.links[k].section
            total = total + 0.5 * section.EI * np.sum(self.ds[k] * link["kappa"] ** 2)
            if self.gravity is not None:
                g = np.array(self.gravity)
                total = total - section.m * np.sum(self.ds[k] * (g @ link["r"]))
                last = k == self.arm.n_links - 1
                mass = self.arm.payload.mass if last else self.arm.elbow(k + 1).mass
                total = total - mass * (g @ link["tip"])
        return total

    def ports(self, q: Array) -> Array:
        """What each input works on: joint angles, then position and angle of each load's point."""
        links = self.walk(q)
        out = [q[k * self.n] for k in range(self.arm.n_links)]
        for k, end in self.loads:
            out += [*links[k][end], links[k][f"{end}_angle"]]
        return np.array(out)

    def gradient(self, function: Any, q: Array) -> Array:
        """Derivatives of a function of q, last axis, by complex step."""
        steps = [function(q + 1j * STEP * e) for e in np.eye(self.size)]
        return np.array([np.imag(value) / STEP for value in steps]).T

    def force(self, q: Array, v: Array, u: Array) -> Array:
        """All of the residual but M a: gyroscopic, elastic, damping and gravity forces less those of the inputs."""
        dM = np.array([np.imag(self.mass_matrix(q + 1j * STEP * e)) / STEP for e in np.eye(self.size)])
        gyroscopic = np.einsum("kij,k,j->i", dM, v, v) - 0.5 * np.einsum("kij,i,j->k", dM, v, v)
        damping = self.gradient(self.strain, v) * self.arm.tau_d
        return gyroscopic + self.gradient(self.potential, q) + damping - self.gradient(self.ports, q).T @ u

    def strain(self, q: Array) -> Any:
        """Strain energy."""
        return sum(
            0.5 * self.arm.links[k].section.EI * np.sum(self.ds[k] * link["kappa"] ** 2)
            for k, link in enumerate(self.walk(q))
        )

    def residual(self, q: Array, v: Array, a: Array, u: Array) -> Array:
        """M a + forces."""
        return self.mass_matrix(q) @ a + self.force(q, v, u)

    def run(self, q: Array, v: Array, inputs: Any, times: Array, held: tuple[int, ...] = ()) -> Array:
        """States (len(times), 2 size) by SciPy's DOP853 at 1e-11; `inputs` of t; `held` coordinates stay."""
        free = [i for i in range(self.size) if i not in held]

        def rate(t: float, state: Array) -> Array:
            q, v = state[: self.size], state[self.size :]
            a = np.zeros(self.size)
            M, f = self.mass_matrix(q), self.force(q, v, inputs(t))
            a[free] = np.linalg.solve(M[np.ix_(free, free)], -f[free])
            return np.concatenate([v, a])

        result = solve_ivp(rate, (times[0], times[-1]), np.concatenate([q, v]), "DOP853", times, rtol=1e-11, atol=1e-11)
        assert result.success, result.message
        return np.asarray(result.y.T)
