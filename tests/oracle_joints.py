"""What turns the joints of `oracle_space`: gears that give, rotors, friction.

A rotor is a body that spins about the joint's axis e at the motor's rate times the ratio r, and with what the section
before has along e. Its virtual rotation is r dpsi + e . dtheta, so that its momentum's change does the virtual work

    (r dpsi + e . dtheta) J p.  +  dtheta . J p (w x e),    p = r psi. + e . w.

The package leaves e . w and e . dtheta out, 1/r of what the rotor is worth; `carried` says whether they are there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
CREEP = 2e-4
"""rad/s: rate at which Coulomb friction is three quarters of what it comes to."""
PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


class Joints:
    """Of an arm; turned: each joint's column of what its motor turns; n: columns in all."""

    def __init__(self, arm: Any, turned: list[int], n: int, carried: bool) -> None:
        self.arm, self.turned, self.n, self.carried = arm, turned, n, float(carried)

    def _beyond(self, k: int, q: Array) -> Any:
        """By how much a gear's spring is wound up, rad."""
        x, half = q[self.turned[k]] - q[6 + k], 0.5 * self.arm.joint(k).backlash
        return x - np.clip(x, -half, half) if half else x

    def wound(self, q: Array) -> Any:
        """Energy in the gears, J."""
        elastic = [k for k in range(self.arm.n_links) if self.arm.joint(k).elastic]
        return sum(0.5 * self.arm.joint(k).stiffness * self._beyond(k, q) ** 2 for k in elastic)

    def gears(self, q: Array, v: Array) -> tuple[Array, Array, Array, float]:
        """Of gears and friction: generalised forces, their slopes by coordinates and by rates, power that is lost."""
        force, lost = np.zeros(self.n), 0.0
        K, D = np.zeros((2, self.n, self.n))
        for k, turned in enumerate(self.turned):
            joint = self.arm.joint(k)
            if joint.elastic:
                pair, x, rate = [turned, 6 + k], self._beyond(k, q), v[turned] - v[6 + k]
                force[pair] += np.array([1.0, -1.0]) * (joint.stiffness * x + joint.damping * rate)
                K[np.ix_(pair, pair)] += joint.stiffness * (x != 0.0) * PAIR
                D[np.ix_(pair, pair)] += joint.damping * PAIR
                lost += joint.damping * rate * rate
            at = turned if joint.friction_side == "motor" else 6 + k
            slides = np.tanh(v[at] / CREEP)
            torque = joint.friction_viscous * v[at] + joint.friction_coulomb * slides
            force[at] += torque
            D[at, at] += joint.friction_viscous + joint.friction_coulomb / CREEP * (1.0 - slides * slides)
            lost += torque * v[at]
        return force, K, D, lost

    def rotors(self, walk: Any, v: Array) -> list[tuple[float, Any, Any, Any, Any]]:
        """Of each: inertia, momentum over it, virtual rotation by the coordinates, what carries it, its axis."""
        found = []
        for k, (root, _, _) in enumerate(walk):
            joint = self.arm.joint(k)
            if joint.motor_inertia:
                e = root.A @ np.array(self.arm.hub_axis if k == 0 else self.arm.elbow(k).axis)
                at = walk[k - 1][2] if k else root._replace(w=v[3:6], alpha=np.zeros(3), dt=np.eye(self.n, 3, -3))
                axial = self.carried * (at.dt @ e)
                axial[self.turned[k]] += joint.gear_ratio
                p = joint.gear_ratio * v[self.turned[k]] + self.carried * (at.w @ e)
                found.append((joint.motor_inertia, p, axial, at, e))
        return found
