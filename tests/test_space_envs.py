"""Arms in space in batches and environments."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.batch import Batch, SpaceReach, Starts
from flexarm_env.physics.space.reading import links
from flexarm_env.rigid import rate_scale
from flexarm_env.rotations import matrices, vectors
from flexarm_env.settings import Settings

ARM = arms.named("three_dof")
SETTINGS = Settings.make("geometrically_exact", elements=1, dt=0.005, tolerance=1e-6)


def batch(n: int) -> Batch:
    """n arms in space with a task, coarse."""
    N, entries = ARM.n_links, 3 * ARM.n_links + 6 * 2 + 6
    task = SpaceReach(
        links=(0,) * N, targets=(0,) * 3, terms=(0,) * 6, entries=(0,) * entries, length=ARM.total_length,
        lengths=np.array([0.0 if link.rigid else link.span for link in ARM.links]), scales=np.ones(entries),
        rates=np.array([rate_scale(ARM, k) for k in range(N)]), weights=np.ones(6),
        torque_limits=np.array(ARM.torque_limits), joint_limits=np.array([-math.inf, math.inf] * N), hold=51.0,
        bands=np.array([0.01, 0.05]),
    )  # fmt: skip
    starts = Starts(start=[(-1.0, 1.0)] * N, target=[(-1.0, 1.0), (-1.5, 1.5), (-2.0, 2.0)])
    return Batch(ARM, SETTINGS, n, task, starts, period=0.01, gravity=(0.0, 0.0, -9.81))


def test_lanes_give_the_bits_of_single_arms_and_states_carry_over() -> None:
    many, ones = batch(11), [batch(1) for _ in range(11)]
    many.start(range(11), range(5, 16), limit=100)
    for i, one in enumerate(ones):
        one.start((0,), (5 + i,), limit=100)
    rng = np.random.default_rng(0)
    for step in range(6):
        if step == 3:  # arm 4 goes on in a batch of another size
            many.set_state(4, ones[4].get_state(0))
        many.action[:] = rng.uniform(-1.0, 1.0, many.action.shape)
        many.step()
        for one, action in zip(ones, many.action, strict=True):
            one.action[0] = action
            one.step()
        for i, one in enumerate(ones):
            assert np.array_equal(one.table[:, 0], many.table[:, i])
            assert np.array_equal(one.observation[0], many.observation[i])
            assert all(np.array_equal(a[0], b[i]) for a, b in zip(one.motions(), many.motions(), strict=True))


def test_poses_are_those_of_recorded_coordinates() -> None:
    """Kernel beside what trajectories are read with; rates beside differences."""
    many = batch(3)
    many.start(range(3), (3, 4, 5), limit=100)
    many.action[:] = (0.05, -0.1, 0.2)
    for _ in range(5):
        many.step()
    q, v = many.motions()[:2]
    eps = 1e-6
    for i in range(3):
        view, motions = many.view(i), list(links(ARM, SETTINGS, q[i : i + 1], v[i : i + 1]))
        for pose, motion in zip(view.poses, motions, strict=True):
            root, tip = motion.root, motion.tip
            inner = root.A[0].T @ (tip.r - root.r)[0]
            slip = root.A[0].T @ ((tip.v - root.v)[0] - np.cross(root.w[0], (tip.r - root.r)[0]))
            assert pose[2:4] == pytest.approx(inner[1:], abs=1e-12)
            assert pose[4:6] == pytest.approx(slip[1:], abs=1e-10)
            assert pose[8:11] == pytest.approx(tip.r[0], abs=1e-12)
            assert pose[11:14] == pytest.approx(tip.v[0], abs=1e-10)
            assert pose[14:].reshape(3, 3) == pytest.approx(root.A[0], abs=1e-12)
            twists = [
                vectors((matrices(t * root.w[0]) @ root.A[0]).T @ matrices(t * tip.w[0]) @ tip.A[0])[0]
                for t in (-eps, 0.0, eps)
            ]
            assert pose[6] == pytest.approx(twists[1], abs=1e-12)
            assert pose[7] == pytest.approx((twists[2] - twists[0]) / (2.0 * eps), abs=1e-8)
        assert view.points[-1] == pytest.approx(motions[-1].tip.r[0])
