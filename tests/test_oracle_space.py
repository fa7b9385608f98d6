"""The oracle in space: d'Alembert's principle against Lagrange's equations of its energies, and what free arms keep."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from flexarm_env.parameters import Joint
from tests import feature_matrix_space as matrix
from tests.oracle_lagrange import Lagrange
from tests.oracle_space import Array, SpatialOracle

ROTOR = Joint(motor_inertia=2e-3, gear_ratio=5.0)
TURN = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()


def whole(x: Array) -> Array:
    """With places for the base's rotation."""
    return np.concatenate([x[:3], np.zeros(3), x[3:]])


class Energies(Lagrange):
    """Of the oracle, its base turned by `TURN` for good: coordinates are its place, joints and strains."""

    def __init__(self, oracle: SpatialOracle) -> None:
        self.oracle, self.n = oracle, oracle.n - 3
        self.of = np.vectorize(self._of, signature="(n),(n)->(),()")

    def _of(self, q: Array, v: Array) -> Any:
        return self.oracle.energies(q[:3], TURN, *map(whole, (q, v)))

    def kinetic(self, q: Array, v: Array) -> Array:
        return np.asarray(self.of(q, v)[0])

    def potential(self, q: Array) -> Array:
        return np.asarray(self.of(q, 0.0 * q)[1])

    def dissipation(self, q: Array, v: Array) -> Array:
        return np.asarray(0.5 * ((v[..., 3:] @ self.oracle.D[6:, 6:]) * v[..., 3:]).sum(-1))

    def ports(self, q: Array) -> Array:
        return q[..., :0]


@pytest.mark.parametrize(
    "features", [("elbow", "pillar", "rigid ends", "gravity", "payload", "oblique hub"), ("curved", "soft")]
)
def test_virtual_work_is_lagranges_equations_of_the_energies(features: tuple[str, ...]) -> None:
    scene = dataclasses.replace(matrix.scene_of(features), loads=())
    if "elbow" in features:  # rotors on axes that turn, behind gears that give and others
        joints = (ROTOR, dataclasses.replace(ROTOR, stiffness=12.0), ROTOR)
        scene = dataclasses.replace(scene, arm=dataclasses.replace(scene.arm, joints=joints))
    rng, apart = np.random.default_rng(4), []
    for points in (5, 10):
        oracle = SpatialOracle(scene, 2, points, soft="soft" in features, carried=True)
        if not apart:
            q, v, a = (scale * rng.normal(size=oracle.n - 3) for scale in (0.5, 1.0, 10.0))
        wanted = Energies(oracle).residual(q, v, a, np.zeros(0))
        M, h = oracle.equations(q[:3], TURN, whole(q), whole(v), 0.0, "right")
        found = np.delete(M @ whole(a) + h, [3, 4, 5])
        apart.append(np.abs(found - wanted).max() / np.abs(wanted).max())
    assert apart[1] < 1e-7
    assert apart[0] > 10.0 * apart[1]  # places are integrals of rotations that are of fourth order


@pytest.mark.slow
def test_a_free_arm_of_the_oracle_keeps_its_momentum_and_energy() -> None:
    scene = dataclasses.replace(matrix.scene_of(("elbow", "free flight", "payload")), rates=(2.0, 0.0))
    arm = dataclasses.replace(scene.arm, tau_d=0.0)
    oracle = SpatialOracle(dataclasses.replace(scene, arm=arm, loads=(), gravity=None), 3, points=14)
    y, m = oracle.start(), oracle.n - 6
    y[7 + arm.n_links : 7 + m : 3] = 0.3  # bent
    found = solve_ivp(oracle.rate, (0.0, 0.05), y, "DOP853", rtol=1e-8, atol=1e-8)
    kept = []
    for state in (y, found.y[:, -1]):
        r, A, q, v = oracle.parts(state, 0.0, "right")
        momenta = oracle.equations(r, A, q, v, 0.0, "right")[0][:6] @ v
        momenta[3:] += np.cross(r, momenta[:3])
        kept.append([*momenta, sum(oracle.energies(r, A, q, v))])
    apart = np.abs(np.diff(kept, axis=0))
    assert apart.max() < 3e-8 * np.abs(kept).max()
    assert np.abs(found.y[7 : 7 + m, -1] - y[7 : 7 + m]).max() > 0.05


def test_a_payload_that_is_gripped_leaves_the_momenta_of_the_energies() -> None:
    """dT/dv of all that is free, by differences; what is lost is dissipated. What is let go leaves the rates."""
    scene = matrix.scene_of(("control periods", "gripped"))
    oracle, rng = SpatialOracle(scene, 2), np.random.default_rng(3)
    y, m = oracle.start(), oracle.n - 6
    y[7 : 7 + m] += 0.3 * rng.normal(size=m)
    y[13 + m : -1] = rng.normal(size=m)  # of a base that rests

    def momenta(y: Array) -> tuple[Array, float]:
        r, A, q, v = oracle.parts(y, 0.0, "right")
        steps = np.eye(oracle.n)[oracle.free]
        ends = [[oracle.energies(r, A, q, v + sign * d)[0] for sign in (1.0, -1.0)] for d in steps]
        return 0.5 * np.subtract(*np.transpose(ends)), float(oracle.energies(r, A, q, v)[0])

    before, energy = momenta(y)
    struck = oracle.with_payload(y, 0.0, 2.5)
    after, left = momenta(struck)
    assert oracle.arm.payload.mass == 2.5 * scene.arm.payload.mass
    assert after == pytest.approx(before, abs=1e-9 * np.abs(before).max())
    assert np.abs(struck - y)[7 + m : -1].max() > 0.1 and struck[-1] - y[-1] == pytest.approx(energy - left) != 0.0
    assert energy - left > 0.0
    assert np.array_equal(oracle.with_payload(struck, 0.0, 0.4), struck)
