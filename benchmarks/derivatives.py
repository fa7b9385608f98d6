"""What derivatives cost: vector-Jacobian products over a rollout, Jacobians and linear models, an arm and period.

    python -m benchmarks.derivatives [--threads 1] [--arms 64 1024] [--id FlexibleArm-v0 TwoLinkFlexArm-v0]

CPU times, the least of many, in microseconds an arm and control period; ratios are to the rollout alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

import flexarm_env  # noqa: F401  (registers the environments)
from flexarm_env.derivatives import Arms

PERIODS = 20


def least(call: Callable[[], Any], count: int) -> float:
    """The least CPU time of `count` calls, s."""
    call()
    found = []
    for _ in range(count):
        begin = time.process_time()
        call()
        found.append(time.process_time() - begin)
    return min(found)


def measure(env_id: str, n: int, threads: int, count: int) -> dict[str, float]:
    """Microseconds an arm and period, by what was done."""
    arms, rng = Arms(env_id, n, threads=threads), np.random.default_rng(0)
    state = arms.reset(seed=0)
    actions = rng.uniform(-0.9, 0.9, (PERIODS, n, arms.action_size))
    rewards, unit = np.ones((PERIODS, n)), 1e6 / n
    run = arms.rollout(state, actions)
    found = {
        "rollout": least(lambda: arms.rollout(state, actions), count) * unit / PERIODS,
        "vjp": least(lambda: arms.rollout(state, actions).vjp(rewards=rewards), count) * unit / PERIODS,
        "jacobians": least(lambda: arms.jacobians(run.states[3], actions[3]), 5 * count) * unit,
    }
    arms.close()
    env: Any = gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point").unwrapped
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    found["linearize"] = least(lambda: env.linearize(discrete=0.02), 5 * count) * unit
    env.close()
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--arms", type=int, nargs="+", default=[64, 1024])
    parser.add_argument("--id", nargs="+", default=["FlexibleArm-v0", "TwoLinkFlexArm-v0"])
    parser.add_argument("--count", type=int, default=20)
    given = parser.parse_args()
    print(f"{'':20} {'arms':>5} {'rollout':>8} {'with vjp':>9} {'ratio':>6} {'jacobians':>10} {'linearize':>10}  us")
    for env_id in given.id:
        for n in given.arms:
            t = measure(env_id, n, given.threads, given.count)
            print(
                f"{env_id:20} {n:5d} {t['rollout']:8.3f} {t['vjp']:9.3f} {t['vjp'] / t['rollout']:6.2f} "
                f"{t['jacobians']:10.3f} {t['linearize']:10.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
