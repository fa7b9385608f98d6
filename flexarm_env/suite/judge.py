"""Evaluate a policy in a task's episodes: returns, successes, costs, and computing time."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..episodes import History, Policy, Timed, measures, play
from .score import FIRST


@dataclass(frozen=True)
class Judged:
    """Results of n episodes, one entry each.

    Attributes:
        returns, successes, costs, settled: results of the functions `returns`, `success`, `cost` and `success_period`
            in `flexarm_env.episodes.measures`. lengths: number of control periods of each episode. wall_s, cpu_s: total
            time of all episodes, s, without compilation. decision_us: wall time that the policy takes to compute one
            action of one episode, microseconds.
    """

    returns: list[float]
    successes: list[bool]
    costs: list[float]
    lengths: list[int]
    settled: list[int]
    wall_s: float
    cpu_s: float
    decision_us: float


class Checked(Policy):
    """Policy that validates and clips another policy's actions by the function `checked`."""

    def __init__(self, policy: Policy, shape: tuple[int, ...]) -> None:
        self.policy, self.shape = policy, shape

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Reset the policy at the start of episodes."""
        self.policy.reset(observation)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the policy's actions (n, joints), validated and clipped."""
        return checked(self.policy.act(observation), self.shape)


def judge(env: Any, policy: Policy, first: int = FIRST) -> Judged:
    """Run one episode in each of n native environments, with the seeds first to first + n - 1.

    Raises:
        ValueError: actions of the wrong shape, or not finite.
    """
    n, shape = int(env.num_envs), env.action_space.shape
    # compile before the clock starts
    env.reset(seed=first)
    env.step(np.zeros(shape, np.float32))
    timed, history = Timed(Checked(policy, shape), time.perf_counter), History("is_success", "cost")
    wall, cpu = time.perf_counter(), time.process_time()
    play(env, timed, range(first, first + n), [history])
    lengths = history.lengths
    return Judged(
        returns=measures.returns(history).tolist(), successes=measures.success(history).tolist(),
        costs=measures.cost(history).tolist(), lengths=lengths.tolist(),
        settled=measures.success_period(history).tolist(),
        wall_s=time.perf_counter() - wall, cpu_s=time.process_time() - cpu,
        decision_us=1e6 * sum(timed.seconds) / (n * int(lengths.max())),
    )  # fmt: skip


def checked(action: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Validate actions and clip them to [-1, 1]. Raises ValueError for a wrong type or shape, or non-finite numbers."""
    try:
        values = np.asarray(action)
    except (TypeError, ValueError, RuntimeError) as error:  # the last: PyTorch's, of what it still differentiates
        raise check.InvalidValue("action", action, f"must be numbers of shape {shape} ({error})") from None
    if values.dtype.kind not in "fiub":
        raise check.InvalidValue("action", action, f"must be numbers of shape {shape}")
    if values.shape != shape:
        raise check.InvalidValue("action's shape", values.shape, f"must be {shape}: one row per observation")
    if not np.isfinite(values).all():
        raise check.InvalidValue("action", values[~np.isfinite(values).all(axis=1)][0], "must be finite numbers")
    return np.asarray(np.clip(values, -1.0, 1.0), np.float32)
