"""How exact `SpatialFlexArm-v0` is under random torques, and how fast: docs/environments/spatial.md.

python -m benchmarks.space_envs [--episodes 32]

Prints the table of the page: the distance of the tip from that of a refined run, over the reach, that 98 % of the
episodes do not exceed; then steps a CPU second beside `Pendulum-v1`, of one arm and of 1024 on one thread.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import flexarm_env  # noqa: F401  (registers the environments)

REFERENCE: dict[str, Any] = {"elements": 6, "dt": 1.25e-4, "tolerance": 1e-9}
CANDIDATES: tuple[dict[str, Any], ...] = (
    {"elements": 2, "dt": 2.5e-3}, {"elements": 3, "dt": 2.5e-3}, {"elements": 4, "dt": 1e-3, "tolerance": 1e-8},
    {"elements": 6, "dt": 2.5e-4, "tolerance": 1e-9},
)  # fmt: skip
TIMES = (10, 20, 30, 50)
"""Control periods."""


def tips(share: float, episodes: int, **settings: Any) -> NDArray[np.float64]:
    """Places of the tips (periods, episodes, 3) under torques drawn anew in each control period."""
    env = gym.make_vec("SpatialFlexArm-v0", num_envs=episodes, **settings)
    env.reset(seed=1)
    rng, found = np.random.default_rng(5), []
    for _ in range(TIMES[-1]):
        action = share * rng.uniform(-1.0, 1.0, env.action_space.shape)
        found.append(env.step(action.astype(np.float32))[-1]["tip_position"].copy())
    return np.array(found)


def rate(env: Any, steps: int, n: int = 1) -> float:
    """Steps a CPU second of an environment under random actions."""
    env.reset(seed=0)
    space = env.action_space
    space.seed(0)
    actions = [space.sample() for _ in range(16)]
    begun = time.process_time()
    for k in range(steps):
        outcome = env.step(actions[k % 16])
        if n == 1 and (outcome[2] or outcome[3]):
            env.reset()
    return n * steps / (time.process_time() - begun)


def main() -> None:
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--rates", action="store_true", help="these alone")
    given = parser.parse_args()
    episodes = given.episodes
    for share in () if given.rates else (1.0, 0.25):
        exact = tips(share, episodes, **REFERENCE)
        for settings in CANDIDATES:
            off = np.linalg.norm(tips(share, episodes, **settings) - exact, axis=2) / 1.15
            errors = ", ".join(f"{100.0 * np.quantile(off[:k].max(0), 0.98):.2f} %" for k in TIMES)
            print(f"{share:g} of the torques, {settings}: {errors}", flush=True)
    one, many = gym.make("SpatialFlexArm-v0"), gym.make_vec("SpatialFlexArm-v0", num_envs=1024, threads=1)
    pendulum = gym.make("Pendulum-v1")
    for env, n in ((one, 1), (many, 1024)):
        rate(env, 20, n)  # what is compiled when first needed
    base, single, vector = [], [], []
    for _ in range(5):
        base.append(rate(pendulum, 4000))
        single.append(rate(one, 1000))
        vector.append(rate(many, 100, 1024))
    found = (np.median(base), np.median(single), np.median(vector))
    ratios = f"one arm {found[1] / found[0]:.3f}, 1024 arms {found[2] / found[0]:.2f} of it on one thread"
    print(f"Pendulum-v1 {found[0]:.0f}/s, {ratios}")


if __name__ == "__main__":
    main()
