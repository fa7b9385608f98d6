"""Checks of contributions on plain Python numbers; `test_contributions.py` runs this file with FLEXARM_COMPILER=python.

Two springs pull at two points of two links, beside gears, in every formulation, in the plane and in space.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.compiler import SINGLE, UNCOMPILED
from flexarm_env.parameters import Arm, Base, Elbow, Joint, Link, Payload, Section
from flexarm_env.physics import protocol
from flexarm_env.physics.assembly import assemble
from flexarm_env.scene import Scene
from flexarm_env.simulation import simulate
from flexarm_env.validation import Array
from tests.springs import springs
from tests.uncompiled_tools import Equations, States, close

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")

SOFT = Section(EI=3.0, EA=50.0, C=30.0, m=0.7, J=0.2)
GEAR = Joint(stiffness=8.0, damping=0.3, motor_inertia=0.02, gear_ratio=3.0)
PLANE = Arm("two", (Link(1.3, SOFT), Link(0.8, SOFT)), hub_inertia=0.3, elbows=(Elbow(0.2, 0.1, 0.05),),
            payload=Payload(0.4, 0.06), tau_d=0.02)  # fmt: skip
SPACE = dataclasses.replace(arms.named("three_dof"), tau_d=0.002)
TWO = (((0, "tip"), 3.0, (0.9, 0.8, 0.2)), ((1, "tip"), 5.0, (0.3, -0.4, -0.5)))
MESH: dict[str, dict[str, Any]] = {
    "elastica": {"nodes": 3}, "geometrically_exact": {"elements": 1}, "floating_frame": {"segments": 1},
}  # fmt: skip
EVERY = pytest.mark.parametrize("formulation", MESH)
WHERE = pytest.mark.parametrize("arm", [PLANE, SPACE], ids=["plane", "space"])


def equations(arm: Arm, formulation: str, joints: tuple[Joint, ...] = (), source: str = "", **scene: Any) -> Equations:
    made = dataclasses.replace(arm, source=source, joints=joints or tuple(Joint() for _ in arm.links))
    mesh = MESH[formulation] if arm.spatial or formulation != "floating_frame" else {"segments": 1, "elements": 1}
    where = Scene("s", made, duration=1.0, dt=0.01, **scene)
    return Equations(assemble(where, where.settings(formulation, **mesh)))


def states(s: Equations, size: float = 0.1) -> States:
    rng = np.random.default_rng(3)
    q = s.system.q0 + size * rng.normal(size=s.n)
    q[s.model.fixed] = s.system.q0[s.model.fixed]
    v, a = size * rng.normal(size=(2, s.n))
    return q, v, a, np.zeros(s.n_inputs)


def inverse(s: Equations, S: Array) -> Array:
    return np.array([s.solved(S, e) for e in np.eye(s.n)]).T


@EVERY
@WHERE
def test_a_joints_stiffness_adds_up(arm: Arm, formulation: str) -> None:
    """Twice added to a joint's row: the inverse is that of the sum (Sherman and Morrison). One joint alone has a gear:
    the entries of the other are zeros, whatever the memory of the matrix held."""
    s = equations(arm, formulation, (GEAR, *(Joint() for _ in arm.links[1:])))
    state, weights = states(s), (300.0, 20.0, 1.0)
    pinned = tuple(int(k) for k in s.model.fixed)
    plain = inverse(s, s.factored(state, weights, pinned))
    for name in ("joint0", "joint1"):
        k, stiffness = s.system.coordinates[name], (4.0, 7.0)
        S = s.assembled(state, weights)
        for row in pinned:
            s.functions["add_stiffness"](SINGLE, s.model, S, row, None)
        for x in stiffness:
            s.functions["add_stiffness"](SINGLE, s.model, S, k, x)
        s.functions["factor"](SINGLE, s.model, S)
        column, total = plain[:, k], sum(stiffness)
        wanted = plain - np.outer(column, plain[k]) * total / (1.0 + total * plain[k, k])
        free = np.setdiff1d(np.arange(s.n), pinned)
        assert close(inverse(s, S)[:, free], wanted[:, free], 1e-9), name


@pytest.mark.parametrize("geared", [False, True])
@EVERY
def test_matrix_of_two_springs_in_the_plane(formulation: str, geared: bool) -> None:
    """S^-1 of arm, gears and both blocks times the residual's differences, in every unknown: the identity."""
    with springs(*TWO):
        undamped = dataclasses.replace(PLANE, tau_d=0.0)  # a Newton matrix leaves out how strain rates change with q
        s = equations(undamped, formulation, (GEAR, GEAR) if geared else (), "springs")
    assert len(s.model.contributions) == 2 + geared
    state, weights = states(s), (300.0, 20.0, 1.0)
    pinned = tuple(int(k) for k in s.model.fixed)
    free = np.setdiff1d(np.arange(s.n), pinned)
    S, T = s.factored(state, weights, pinned), s.tangent(state, weights)
    found = np.array([s.solved(S, T[:, k] * (np.isin(np.arange(s.n), free))) for k in free]).T[free]
    assert close(found, np.eye(len(free)), 1e-6)


@EVERY
@WHERE
def test_forces_of_springs_are_the_energys_gradient(arm: Arm, formulation: str) -> None:
    """Virtual work: along rates v the springs' part of the residual takes the power that their energy gains."""
    with springs(*TWO):
        s = equations(arm, formulation, source="springs")
    without = equations(arm, formulation, (Joint(),) * len(arm.links))
    q, v, a, u = states(s)
    rows = len(without.system.q0)
    v[s.model.fixed] = 0.0
    part = s.residual(q, v, a, u) - np.pad(without.residual(q[:rows], v[:rows], a[:rows], u[: without.n_inputs]),
                                           (0, s.n - rows))  # fmt: skip

    def strain(h: float) -> float:
        moved = q.copy()
        protocol.retract(SINGLE, s.model, moved, h, v, None)
        both = (protocol.energy(SINGLE, of.model, s.par, moved, v)[1] for of in (s, without))
        return float(next(both) - next(both))

    h = 1e-4
    gain = (8.0 * (strain(h) - strain(-h)) - (strain(2.0 * h) - strain(-2.0 * h))) / (12.0 * h)
    assert part @ v == pytest.approx(gain, rel=1e-6)


@EVERY
@pytest.mark.parametrize("arm", [dataclasses.replace(PLANE, base=Base(2.0, 0.5)), SPACE], ids=["on a base", "space"])
def test_a_spring_moves_a_free_arms_center_of_mass(arm: Arm, formulation: str) -> None:
    """No other force acts: what changes the momentum of an arm that no support holds is the force of both springs."""
    with springs(*TWO):
        s = equations(arm, formulation, source="springs", root="free")
    q, v, _, u = states(s, 0.02)
    v[s.model.fixed] = 0.0
    r, S = np.zeros(s.n), np.zeros(s.n_factor)
    _, force = protocol.conserve_momentum(SINGLE, s.model, s.par, None, 0.01, q, v, u, r, S)
    y = np.zeros(s.n_inputs)
    protocol.input_displacements(SINGLE, s.model, s.par, q, y)
    axes = 3 if arm.spatial else 2
    entries = [part.point.input for part in s.model.contributions if hasattr(part, "anchor")]
    pull = sum(k * (np.array(anchor[:axes]) - y[e : e + axes]) for (_, k, anchor), e in zip(TWO, entries, strict=True))
    found = np.array([force[i] for i in range(axes)])
    np.testing.assert_allclose(found, pull, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("joint", [Joint(), dataclasses.replace(GEAR, backlash=0.05)], ids=["ideal", "gears with play"])
@EVERY
@WHERE
def test_energy_of_an_arm_on_two_springs(arm: Arm, formulation: str, joint: Joint) -> None:
    """Released among two springs it keeps its energy, less what damping takes."""
    mesh = MESH[formulation] if arm.spatial or formulation != "floating_frame" else {"segments": 1, "elements": 1}
    made = dataclasses.replace(arm, source="springs", joints=(joint,) * len(arm.links))
    with springs(*TWO):
        scene = Scene("s", made, duration=0.02, dt=0.002)
        run = simulate(scene, formulation, rho_inf=1.0, estimate_error=False, **mesh)
    assert run.finished, run.message
    assert abs(run.balance).max() < 0.01 * run.turned_over
