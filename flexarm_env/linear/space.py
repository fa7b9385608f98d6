"""Modes, static equilibria and their stability, for arms in space.

Small motions about a point are increments d of the coordinates: of positions along inertial axes, of rotations in the
section's own. About a steady rotation Omega of the whole arm they are seen by an observer who turns with it,

    v = Omega x r + d',                a = Omega x (Omega x r) + 2 Omega x d' + d''                (places)
    w = A^T Omega + d',                alpha = (A^T Omega) x d' + d''                              (rotations)

and M, C, K are the residual's differences by d'', d' and d there: rotations do not add up, so the differences use
`protocol.update`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .. import rotations
from .. import validation as check
from ..compiler import SINGLE, uncompiled
from ..physics.assembly import physical
from ..physics.equations import equations as evaluate
from ..physics.model import Jointed
from ..physics.protocol import State, retract
from ..physics.space.build import axis_of, mount_of
from ..physics.space.chain import SpatialBeam
from ..physics.space.layout import AXES, PL
from ..physics.space.reading import read
from ..rest import NoEquilibrium, resting
from ..scene import Scene
from ..simulation import Simulation
from ..validation import Array
from .equations import STEP, Rows, exact_slopes, slopes
from .stability import Complex, Stability, eigenpairs, stability


class SmallMotions:
    """The arm of a simulation in space about coordinates q, in steady rotation where spin (rad/s) is not 0."""

    def __init__(self, simulation: Simulation, spin: float = 0.0) -> None:
        self.simulation, self.model = simulation, physical(simulation.model)
        model, arm = self.model, simulation.scene.arm
        self.n, self._room = int(model.n), np.zeros(int(model.n_factor))
        known = [int(k) for k in simulation.drive.known]
        still = {*known, *model.fixed.tolist(), *np.flatnonzero(model.weight == 0.0).tolist()}
        self.free = np.array([k for k in range(self.n) if k not in still], np.int64)
        rows = simulation.system.coordinates
        self.joints = [rows.get(f"motor{k}", rows[f"joint{k}"]) for k in range(arm.n_links)]  # that can be held
        self.spun = [rows[name] for name in ("joint0", "motor0") if name in rows]
        self.chain = model.arm if isinstance(model, Jointed) else model
        self.omega = spin * (mount_of(arm, 0) @ axis_of(arm, 0))
        self.spin = spin
        self.about(np.zeros(self.n), np.zeros(self.n), simulation.work.u)

    def but(self, held: list[int]) -> Rows:
        """Return the rows that can move if these joints are held."""
        return np.array([k for k in self.free if k not in [self.joints[j] for j in held]], np.int64)

    def about(self, v: Array, a: Array, u: Array) -> None:
        """Return the reference rates and accelerations (n,), to which d' and d'' are added, and torques and loads."""
        self.v, self.a, self.u = v, a, u

    def _moving(self, d: Array, d1: Array, d2: Array, q0: Array) -> State:
        """The state that increments and their rates come to."""
        q = q0.copy()
        uncompiled(retract)(SINGLE, self.model, q, 1.0, d, None)
        v, a = self.v + d1, self.a + d2
        if self.spin:
            v[self.spun] += self.spin
            for i in self._vertices():
                w = rotations.back(rotations.matrices(q[i + 3 : i + AXES]), self.omega)
                v[i : i + 3] += np.cross(self.omega, q[i : i + 3])
                a[i : i + 3] += np.cross(self.omega, v[i : i + 3] + d1[i : i + 3])
                v[i + 3 : i + AXES] += w
                a[i + 3 : i + AXES] += np.cross(w, d1[i + 3 : i + AXES])
        return State(q, v, a)

    def _vertices(self) -> list[int]:
        """First rows of the vertices that can move."""
        names = self.simulation.system.names
        return [i for i, name in enumerate(names) if name.startswith("link") and ".x" in name]

    def residual(self, changes: Array, q0: Array) -> Array:
        """r (n,) of d, d', d'' (3, n) about q0."""
        state, r, w = self._moving(changes[0], changes[1], changes[2], q0), np.zeros(self.n), self.simulation.work
        evaluate(SINGLE, self.model, self.simulation.par, state, self.u, w.psi, 0, r, self._room)
        return r

    def moved(self, q0: Array, rows: Rows, d: Array) -> Array:
        """Return the coordinates after an increment of some rows."""
        q, whole = q0.copy(), np.zeros(self.n)
        whole[rows] = d
        uncompiled(retract)(SINGLE, self.model, q, 1.0, whole, None)
        return q

    def slopes(self, q0: Array, which: int, rows: Rows) -> Array:
        """Return derivatives of `rows` of the residual by these rows of d (which = 0), d' (1) or d'' (2)."""

        def changed(x: Array) -> Array:
            change = np.zeros((3, self.n))
            change[which] = x
            return self.residual(change, q0)[rows]

        if which > 0:  # forces are linear and quadratic in rates
            return exact_slopes(changed, np.zeros(self.n), rows)
        # a chord's length is no polynomial of places: short steps beside its segment
        most = max(1, int(self.chain.places[PL.elements :: PL.end].max()))
        framed = isinstance(self.chain, SpatialBeam) and self.chain.frames is not None
        least = 0.25 / most if framed else 1.0
        return slopes(changed, np.zeros(self.n), rows, STEP * least / np.maximum(self.model.weight, 1e-300))

    def settle(self, q0: Array, rows: Rows) -> Array:
        """Return coordinates near q0 at which these rows of the residual vanish.

        Raises:
            NoEquilibrium: Newton's iteration fails.
        """
        q, nothing = q0, np.zeros((3, self.n))
        for _ in range(50):
            r = self.residual(nothing, q)[rows]
            d = np.asarray(-np.linalg.solve(self.slopes(q, 0, rows), r), np.float64)
            largest = float(np.abs(d * self.model.weight[rows]).max())
            if not largest < 1e3:
                break
            q = self.moved(q, rows, min(1.0, 0.3 / max(largest, 1e-300)) * d)
            if largest < 1e-10:
                return q
        raise NoEquilibrium("no steady rotation was found: the spin may be beyond what the arm's stiffness holds")


def rest_of(scene: Scene, settings: Any, hold_joints: bool, kind: Callable[..., Any] = Simulation) -> Any:
    """Return a simulation of a scene without motion at its static equilibrium (`rest.relax`); torques hold its joints.

    Raises:
        NoEquilibrium: there is none.
    """
    start = "held" if hold_joints else "equilibrium"
    if scene.root == "free":
        raise check.InvalidValue("scene.root", scene.root, 'must be "pinned" for a rest')
    found = kind(replace(scene, start=start), settings)
    held = resting(replace(scene, start=start))
    motions = SmallMotions(found)
    r = motions.residual(np.zeros((3, motions.n)), found.work.q)
    torques = found.work.u[: scene.arm.n_links].copy()
    for k, row in enumerate(motions.joints):
        name = f"{'motor' if scene.arm.joint(k).elastic else 'joint'}{k}"
        if held.motion_of(name) is not None and scene.motion_of(name) is None:
            torques[k] += r[row]
    found.set_torques(torques)
    return found


def stability_of(simulation: Simulation, held: list[int]) -> Stability:
    """Return the stability of an equilibrium, with the joints `held` fixed."""
    motions = SmallMotions(simulation)
    rows = motions.but(held)
    return stability(motions.slopes(simulation.work.q, 2, rows), motions.slopes(simulation.work.q, 0, rows))


Vibration = tuple[Complex, Complex, Array, Callable[[Complex], tuple[Array, float]]]
"""Eigenvalues, one of each pair, and their vectors; points of the chain; of a vector the points' displacements, and
which way they whirl about the first joint's axis (`Modes`)."""


def modes_of(simulation: Simulation, q: Array, held: list[int], spin: float) -> Vibration:
    """Return eigenvalues (rad/s), eigenvectors, points of the chain (m, inertial axes), and a function of an
    eigenvector.

    Small motions about q (n,), at rest or in steady rotation: spin (rad/s) about the first joint's axis (q then starts
    the search). held: indices of joints kept at their angles. The function returns the points' displacements at the
    phase of the largest (largest length 1) and the whirl (-1 to 1; NaN: no motion across the axis), see `Modes`.
    """
    motions = SmallMotions(simulation, spin)
    rows = motions.but(held)
    if spin:
        q = motions.settle(q, rows)
    M, C, K = (np.ascontiguousarray(motions.slopes(q, which, rows)) for which in (2, 1, 0))  # or BLAS rounds otherwise
    settings, arm = simulation.settings, simulation.scene.arm
    axis = mount_of(arm, 0) @ axis_of(arm, 0)

    def points(at: Array) -> Array:
        return np.asarray(read(arm, settings, at[None], np.zeros((1, motions.n)))["shapes"][0])

    def shape(column: Complex) -> tuple[Array, float]:
        vector = column / max(float(np.abs(column * motions.model.weight[rows]).max()), 1e-300)
        change = []
        for part in (1e-6 * vector.real, 1e-6 * vector.imag):
            change.append((points(motions.moved(q, rows, part)) - points(motions.moved(q, rows, -part))) / 2e-6)
        complex_change = change[0] + 1j * change[1]
        across = complex_change - np.outer(complex_change @ axis, axis)
        around = -float(np.cross(across.conj(), across).imag.sum(axis=0) @ axis)
        moved_by, least = float((np.abs(across) ** 2).sum()), 1e-6 * arm.total_length  # less is round-off
        largest = complex_change.ravel()[np.abs(complex_change).argmax()]
        real = (complex_change * np.conj(largest) / max(abs(largest), 1e-300)).real
        shape = real / max(float(np.linalg.norm(real, axis=1).max()), 1e-300)
        return shape, around / moved_by if moved_by > least**2 else np.nan

    return *eigenpairs(M, C, K), points(q), shape
