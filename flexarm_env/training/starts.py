"""Staggered starts of training environments, at times spread over an episode."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def staggered(native: Any, seed: int) -> NDArray[np.float32] | None:
    """Advance reset environments to times spread over an episode; return the observations there, (n, O).

    Episodes of equal length that start together would show each rollout a single phase of the task: all arms moving,
    then all at rest. The arms run without action and are reset at different times. The result is None if episodes
    consist of a single step.

    Args:
        native: a native vector environment. seed: seed of the random assignment of the times to the arms.
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
