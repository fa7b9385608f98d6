"""What befalls an arm in space in an episode: payloads gripped and let go, drawn, and pushes; against balances."""

import dataclasses
import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.rotations import matrices
from flexarm_env.settings import Settings
from flexarm_env.tasks.program import PUSHED
from tests.env_tools import assert_goes_back, assert_pair_same, episode, pair
from tests.refusals import refuses

pytestmark = pytest.mark.slow

SPACE = "SpatialFlexArm-v0"
TENSOR = ((4e-3, 0.0, 0.0), (0.0, 9e-3, 1e-3), (0.0, 1e-3, 6e-3))
LADEN = dataclasses.replace(arms.named("three_dof"), payload=fx.Payload(0.1, TENSOR, (0.02, 0.01, -0.03)))
EVENTS: dict[str, Any] = {
    "arm": LADEN, "elements": 1, "dt": 0.005, "duration": 0.2, "info_level": "full", "starts": {"straight": 0.0},
    "pushes": {"wait": (0.02, 0.04), "force": (0.5, 1.0), "lasting": 0.03},
    "payload_change": {"time": (0.1, 0.1), "factor": (2.0, 2.5)},
    "randomization": {"payload": (0.5, 2.0), "payload_inertia": (0.5, 2.0)},
}  # fmt: skip
"""One compiled form for many tests."""

X, Y, Z = np.eye(3)


@pytest.mark.parametrize(("factor", "gripped"), [(3.0, "resting"), (3.0, "moving"), (0.25, "resting")])
def test_a_rigid_arm_keeps_the_momenta_of_its_joints(factor: float, gripped: str) -> None:
    """Yaw and pitch of a rod, no gravity, no torque in the impact. Kinetic energy is x'.M x'/2 of the joints' rates x'
    with M the sum of m J'J + R'IR over bodies, their velocities being J x' and R x'. What is gripped at rest leaves the
    momenta M x'; what moves along, or is let go, leaves the rates; energy stays after it."""
    rod = fx.RigidLink(0.6, 0.8, (0.3, 0.0, 0.0), 0.02)
    arm = dataclasses.replace(LADEN, links=(LADEN.links[0], rod), elbows=LADEN.elbows[:1], torque_limits=(20.0, 10.0))
    change = {"time": (0.05, 0.05), "factor": (factor, factor), "gripped": gripped}
    options = {"gravity": (0.0, 0.0, 0.0), "info_level": "full", "dt": 2.5e-4}
    env: Any = gym.make(SPACE, arm=arm, payload_change=change, **options)
    env.reset(seed=0, options={"start": (0.4, 0.9)})
    rows = list(env.unwrapped.batch.system.coordinates.values())[-2:]
    infos = [env.step(np.array([0.5, -0.2], np.float32) * (k < 4))[-1] for k in range(5)]
    x, rates = (one[rows] for one in env.unwrapped.batch.motion(0)[:2])
    infos.append(env.step(np.zeros(2, np.float32))[-1])

    pillar = matrices(-0.5 * np.pi * Y) @ matrices(x[0] * X)
    A = pillar @ matrices(-0.5 * np.pi * X) @ matrices(x[1] * Z)
    R = np.column_stack([pillar @ X, A @ Z])

    def mass_matrix(share: float) -> np.ndarray:
        bodies = (0.8, 0.02 * np.eye(3), (0.3, 0.0, 0.0)), (0.1 * share, share * np.array(TENSOR), (0.62, 0.01, -0.03))
        M = np.diag([0.01125, 0.0])
        for mass, I, centre in bodies:
            J = np.cross(R.T, A @ np.array(centre)).T
            M += mass * J.T @ J + R.T @ A @ I @ A.T @ R
        return np.asarray(M)

    before, after = mass_matrix(1.0), mass_matrix(factor)
    struck = gripped == "resting" and factor > 1.0
    new = np.linalg.solve(after, before @ rates) if struck else rates
    energies = 0.5 * rates @ before @ rates, 0.5 * new @ after @ new
    assert [info["energy_kinetic"] for info in infos[-2:]] == pytest.approx(energies, rel=1e-5)
    lost = infos[-1]["energy_dissipated"] - infos[-2]["energy_dissipated"]
    work = infos[-1]["work"] - infos[-2]["work"]
    assert lost == pytest.approx(energies[0] - energies[1] if struck else 0.0, abs=1e-8)
    assert work == pytest.approx(0.0 if struck else energies[1] - energies[0], abs=1e-8)
    assert infos[-1]["payload_mass"] == pytest.approx(0.1 * factor)


@pytest.mark.parametrize("formulation", ["geometrically_exact", "floating_frame"])
def test_books_close_and_pushes_work_along_the_tips_way(formulation: str) -> None:
    """An arm that bends, under gravity; what the balance lacks goes with the step. The environment takes the exact beam
    alone, a batch of it both."""
    lacking = []
    for dt in (0.0025, 0.0025 / 8):
        env: Any = gym.make(SPACE, **EVENTS | {"dt": dt}).unwrapped
        size = {"elements": 1} if formulation == "geometrically_exact" else {"segments": 1}
        settings = Settings.make(formulation, dt=dt, tolerance=1e-8, **size)
        batch = dataclasses.replace(env.plan, settings=settings).batch(1)
        batch.start((0,), (7,), limit=100)
        at, infos = batch.info_at, [batch.table[:, 0].copy()]
        for _ in range(16):
            batch.step()
            infos.append(batch.table[:, 0].copy())
        told = {entry.name: entry for entry in env.plan.entries}
        energy = [one[at.energies : at.energies + 5] for one in infos]
        away = [sum(e[:4]) - e[4] - (sum(energy[0][:4]) - energy[0][4]) for e in energy]
        lacking.append(max(abs(x) for x in away))
        push = [one[told["push"].first : told["push"].first + 3] for one in infos]
        tips = [one[at.tip : at.tip + 3] for one in infos]
        pushed = 0
        for k, (before, now) in enumerate(itertools.pairwise(range(17))):
            if k != 10:  # where the payload comes
                work = float(push[now] @ (tips[now] - tips[before]))
                assert energy[now][4] - energy[before][4] == pytest.approx(work, abs=1e-10)
            pushed += bool(push[now].any())
        assert 5 < pushed < 15
        assert energy[11][3] - energy[10][3] > 1e-3
    assert lacking[0] < 5e-4 and lacking[1] < 0.1 * lacking[0]


def test_single_and_vector_agree_to_the_bit_and_states_go_back() -> None:
    assert assert_pair_same(pair(SPACE, 5, **EVENTS), 30) >= 5
    env: Any = gym.make(SPACE, **EVENTS).unwrapped
    episode(env, 0, 5)
    assert_goes_back(env, scale=0.2)
    _, info = env.reset(seed=4)
    mass, share = info["drawn_payload"], info["drawn_payload_inertia"]
    assert env.batch.parameters(0)[:2] == pytest.approx([0.1 * mass, mass * share]) and mass != 1.0 != share
    motion = {"joint0": np.array([[0.0, 0.0], [1.0, 0.1]])}
    refuses(r"must not be given in an environment with pushes", lambda: env.reset(options={"motion": motion}))


def test_pushes_come_from_all_around() -> None:
    """Uniform on a sphere: each component's mean is 0 and its mean square a third of the square of the force."""
    env: Any = gym.make_vec(SPACE, num_envs=256, **EVENTS).unwrapped
    env.reset(seed=0)
    forces = np.array([env.batch.record(i)[PUSHED + 2 : PUSHED + 5] for i in range(256)])
    size = np.linalg.norm(forces, axis=1)
    assert 0.5 <= size.min() < 0.52 and 0.98 < size.max() <= 1.0
    unit = forces / size[:, None]
    assert np.abs(unit.mean(axis=0)).max() < 4.0 * np.sqrt(1.0 / 3.0 / 256)
    assert np.abs((unit**2).mean(axis=0) - 1.0 / 3.0).max() < 4.0 * np.sqrt(4.0 / 45.0 / 256)
