"""An elastica of another derivation: energies by quadrature of the fields r(s), then Lagrange (`oracle_lagrange.py`).

Nothing here uses the package's mechanics: Lagrange polynomials are products, slopes complex steps.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import eval_jacobi

from flexarm_env.scene import PointLoad, Scene
from tests.oracle_lagrange import STEP, Lagrange

Array = NDArray[Any]


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


class Oracle(Lagrange):
    """A scene's chain with n nodes a link; coordinates as in the package: joint and node angles, x, y if `free`.

    x and y are those of the root, or in free flight of the centre of mass.
    """

    def __init__(self, scene: Scene, n: int, free: bool = False) -> None:
        self.scene, self.nodes, self.free, arm = scene, n, free, scene.arm
        self.arm = arm
        x, self.weights = np.polynomial.legendre.leggauss(40)
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
        self.n = n * arm.n_links + (2 if free else 0)

    def angles(self, q: Array) -> list[Array]:
        """Nodes' angles of each link (..., nodes): linear, and so their rates are those of v."""
        out: list[Array] = []
        for k in range(self.arm.n_links):
            phi = np.array(q[..., k * self.nodes : (k + 1) * self.nodes])
            if k:
                phi[..., 0] = phi[..., 0] + out[-1] @ self.tips[k - 1]
            out.append(phi)
        return out

    def walk(self, q: Array, v: Array) -> list[tuple[dict[str, Array], dict[str, Array]]]:
        """Fields of each link at the quadrature points, and its ends; and the rates of all these."""
        roots: tuple[Array, Array] = np.zeros(2), np.zeros(2)
        links = []
        for k, (phi, rate) in enumerate(zip(self.angles(q), self.angles(v), strict=True)):
            c, s = np.cos(phi), np.sin(phi)
            turns = np.stack([c, s], axis=-2), np.stack([-s * rate, c * rate], axis=-2)
            pair = tuple(
                {
                    "r": root[..., None] + e @ self.integrals[k].T, "phi": nodal @ self.values[k].T, "nodal": nodal,
                    "kappa": nodal @ self.slopes[k].T, "root": root, "root_angle": nodal[..., 0],
                    "tip": root + e @ self.ends[k], "tip_angle": nodal @ self.tips[k],
                }
                for root, e, nodal in zip(roots, turns, (phi, rate), strict=True)
            )  # fmt: skip
            links.append((pair[0], pair[1]))
            roots = pair[0]["tip"], pair[1]["tip"]
        for which, x in enumerate((q, v) if self.free else ()):
            fields = [pair[which] for pair in links]
            move = np.array(x[..., -2:]) - (self.centre(fields) if self.scene.root == "free" else 0.0)
            for link in fields:
                link["r"] = link["r"] + move[..., None]
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

    def kinetic(self, q: Array, v: Array) -> Array:
        """Kinetic energy."""
        arm, total = self.arm, 0.0
        for k, (_, rate) in enumerate(self.walk(q, v)):
            section, last = arm.links[k].section, k == arm.n_links - 1
            mass = arm.payload.mass if last else arm.elbow(k + 1).mass
            total = total + section.m * (rate["r"] ** 2).sum(-2) @ self.ds[k] + mass * (rate["tip"] ** 2).sum(-1)
            # Lobatto's nodes (links with another behind) carry rotary inertia by their own quadrature
            turning, weights = (rate["phi"], self.ds[k]) if last else (rate["nodal"], self.ends[k])
            total = total + section.J * turning**2 @ weights
            total = total + (arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right) * rate["root_angle"] ** 2
            end = arm.payload.inertia if last else arm.elbow(k + 1).inertia_left
            total = total + end * rate["tip_angle"] ** 2
        return np.asarray(0.5 * total)

    def strain(self, q: Array) -> Array:
        """Strain energy."""
        links = enumerate(self.walk(q, q))
        return np.asarray(
            sum(0.5 * self.arm.links[k].section.EI * link["kappa"] ** 2 @ self.ds[k] for k, (link, _) in links)
        )

    def potential(self, q: Array) -> Array:
        """Strain and gravity energy."""
        total, g = self.strain(q), np.array(self.scene.gravity or (0.0, 0.0))
        for k, (link, _) in enumerate(self.walk(q, q)):
            mass = self.arm.payload.mass if k == self.arm.n_links - 1 else self.arm.elbow(k + 1).mass
            weight = self.arm.links[k].section.m * (g @ link["r"]) @ self.ds[k] + mass * (link["tip"] @ g)
            total = total - weight
        return total

    def dissipation(self, q: Array, v: Array) -> Array:
        """Rayleigh's function of Kelvin-Voigt damping."""
        return self.arm.tau_d * self.strain(v)

    def ports(self, q: Array) -> Array:
        """What each input works on: joint angles, then position and angle of each load's point."""
        links = [link for link, _ in self.walk(q, q)]
        out = [q[..., k * self.nodes, None] for k in range(self.arm.n_links)]
        for load in (item for item in self.scene.loads if isinstance(item, PointLoad)):
            out += [links[load.link][load.end], links[load.link][f"{load.end}_angle"][..., None]]
        return np.concatenate(out, axis=-1)
