"""Start training environments at different times of their episodes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def staggered(native: Any, seed: int) -> NDArray[np.float32] | None:
    """Advance n environments by one episode, and reset each environment at a different time.

    After this call the environments are at n different times of their episodes. Episodes of equal length that all
    start together would fill each rollout with a single phase of the task: all arms moving, then all arms at rest. The
    actions are 0. The function returns the observations (n, O), or None if an episode consists of a single step.

    Args:
        native: a native vector environment after `reset`. seed: seed of the random order of the reset times.
    """
    n, limit = native.num_envs, int(native.unwrapped.plan.limit)
    ages = np.random.default_rng(seed).permutation(np.arange(n) * limit // n)
    still = np.zeros(native.action_space.shape, np.float32)
    observation = None
    for k in range(1, limit):
        observation = native.step(still)[0]
        mask = ages == k
        if mask.any():
            observation = native.reset(options={"reset_mask": mask})[0]
    return observation
