"""A chain of geometrically exact beams by finite differences on a staggered grid, in plain NumPy, of second order.

Nothing here uses the package's mechanics. Positions live at the ends of the cells, angles at their middles and at the
two ends of each link; strains are differences there, masses are lumped, and SciPy integrates in time. Hinged links
share a position, not an angle.
"""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from flexarm_env.scene import JointTorque, PointLoad, Scene
from flexarm_env.time_functions import Side
from flexarm_env.validation import Array


class StaggeredChain:
    """State of `cells` cells a link: positions (N cells + 1, 2), then angles (N, cells + 2): root, middles, tip."""

    def __init__(self, scene: Scene, cells: int) -> None:
        self.scene, self.arm, self.cells = scene, scene.arm, cells
        arm, n = scene.arm, scene.arm.n_links
        self.mass = np.zeros(n * cells + 1)
        self.inertia = np.zeros((n, cells + 2))
        for k, link in enumerate(arm.links):
            h, section = link.length / cells, link.section
            ends = np.full(cells + 1, h)
            ends[[0, -1]] = h / 2
            self.mass[k * cells : (k + 1) * cells + 1] += section.m * ends
            self.inertia[k, 1:-1] = section.J * h
            self.inertia[k, [1, -2]] = 0.75 * section.J * h
            self.inertia[k, [0, -1]] = 0.25 * section.J * h
        self.inertia[0, 0] += arm.hub_inertia
        self.mass[-1] += arm.payload.mass
        self.inertia[-1, -1] += arm.payload.inertia
        for k in range(1, n):
            elbow = arm.elbow(k)
            self.mass[k * cells] += elbow.mass
            self.inertia[k - 1, -1] += elbow.inertia_left
            self.inertia[k, 0] += elbow.inertia_right

    def straight(self) -> tuple[Array, Array]:
        """Positions and angles of straight links."""
        r = np.array([self.scene.position], dtype=np.float64)
        for link, angle in zip(self.arm.links, self.scene.angles, strict=True):
            steps = np.outer(np.arange(1, self.cells + 1) * link.length / self.cells, [np.cos(angle), np.sin(angle)])
            r = np.vstack([r, r[-1] + steps])
        return r, np.repeat(np.array(self.scene.angles)[:, None], self.cells + 2, axis=1)

    def forces(self, r: Array, psi: Array) -> tuple[Array, Array, float]:
        """Elastic forces on positions and angles, and the energy."""
        force, moment, energy = np.zeros_like(r), np.zeros_like(psi), 0.0
        for k, link in enumerate(self.arm.links):
            h, s = link.length / self.cells, link.section
            nodes = slice(k * self.cells, (k + 1) * self.cells + 1)
            slope = np.diff(r[nodes], axis=0) / h
            c, n = np.cos(psi[k, 1:-1]), np.sin(psi[k, 1:-1])
            stretch, shear = c * slope[:, 0] + n * slope[:, 1] - 1.0, c * slope[:, 1] - n * slope[:, 0]
            axial, across = s.EA * stretch, s.C * shear
            pull = np.column_stack([c * axial - n * across, n * axial + c * across])
            force[nodes][:-1] += pull
            force[nodes][1:] -= pull
            moment[k, 1:-1] -= h * (axial * shear - across * (1.0 + stretch))
            spacing = np.full(self.cells + 1, h)
            spacing[[0, -1]] = h / 2
            bend = s.EI * np.diff(psi[k]) / spacing
            moment[k, :-1] += bend
            moment[k, 1:] -= bend
            energy += 0.5 * h * float((s.EA * stretch**2 + s.C * shear**2).sum())
            energy += 0.5 * float((bend * np.diff(psi[k])).sum())
        return force, moment, energy

    def run(self, times: Array) -> Array:
        """Tip positions (len(times), 2) from rest, under loads and a motion of the hub."""
        scene, (r0, psi0) = self.scene, self.straight()
        shape, split, hub = psi0.shape, r0.size, scene.motion_of("joint0")
        loads = [load for load in scene.loads if isinstance(load, PointLoad)]
        torques = [load for load in scene.loads if isinstance(load, JointTorque)]
        stops = [k for k in scene.kinks if k < times[-1]]

        def rates(t: float, y: Array, side: Side) -> Array:
            half = y.size // 2
            q, v = y[:half].copy(), y[half:].copy()
            if hub is not None:
                q[split], v[split] = hub(t, 0, side), hub(t, 1, side)
            force, moment, _ = self.forces(q[:split].reshape(-1, 2), q[split:].reshape(shape))
            for one in torques:
                torque, k = one.function(t, 0, side), one.joint
                moment[k, 0] += torque
                if k > 0:
                    moment[k - 1, -1] -= torque
            for load in loads:
                node, end = (load.link, 0) if load.end == "root" else (load.link + 1, -1)
                for i, f in enumerate((load.force_x, load.force_y)):
                    force[node * self.cells, i] += 0.0 if f is None else f(t, 0, side)
                moment[load.link, end] += 0.0 if load.torque is None else load.torque(t, 0, side)
            acceleration = force / self.mass[:, None]
            if scene.root != "free":
                acceleration[0] = 0.0
            turn = moment / self.inertia
            if hub is not None:
                turn[0, 0] = hub(t, 2, side)
            return np.concatenate([v, acceleration.ravel(), turn.ravel()])

        y = np.concatenate([r0.ravel(), psi0.ravel(), np.zeros(r0.size + psi0.size)])
        found = []
        for start, end in itertools.pairwise([0.0, *stops, float(times[-1])]):
            here = times[(times > start) & (times <= end)]
            asked = np.union1d(here, [end])

            def piece(t: float, y: Array, start: float = start, end: float = end) -> Array:
                return rates(t, y, "left" if t > 0.5 * (start + end) else "right")

            solution = solve_ivp(piece, (start, end), y, "DOP853", asked, rtol=1e-8, atol=1e-9)
            assert solution.success, solution.message
            y = solution.y[:, -1]
            found.append(solution.y[split - 2 : split, : here.size].T)
        return np.vstack(found)


def tips(scene: Scene, cells: int, times: Array) -> tuple[Array, float]:
    """Tip positions extrapolated from `cells` and 2 `cells` cells a link (Richardson), and their estimated error; times
    (n,) s, ascending from above 0."""
    coarse, fine = (StaggeredChain(scene, n).run(times) for n in (cells, 2 * cells))
    return fine + (fine - coarse) / 3.0, float(np.hypot(*(fine - coarse).T).max() / 3.0)
