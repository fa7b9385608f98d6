"""Evaluation of a policy in a task's episodes: returns, successes, costs, and computing time."""

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from .score import FIRST


class Policy(Protocol):
    """Policy for n episodes that begin together.

    `reset` receives the first observations; `act` then receives every observation in turn, the first included.
    """

    def reset(self, observation: NDArray[np.float32]) -> Any:
        """Begin episodes; by default there is no memory."""
        return

    def act(self, observation: NDArray[np.float32]) -> Any:
        """Return actions (n, joints) for observations (n, entries)."""


@dataclass(frozen=True)
class Judged:
    """Results of n episodes, one entry each.

    Attributes:
        returns: sums of rewards. successes: "is_success" at the end of an episode that was not terminated early.
            costs: sums of info["cost"] (0 on tasks without it). lengths: control periods. settled: number of the first
            control period, counted from 1, at whose end and after which the bounds of success hold; 0 without success.
            wall_s, cpu_s: total time, without compilation. decision_us: wall time per decision and episode,
            microseconds.
    """

    returns: list[float]
    successes: list[bool]
    costs: list[float]
    lengths: list[int]
    settled: list[int]
    wall_s: float
    cpu_s: float
    decision_us: float


def judge(env: Any, policy: Policy, first: int = FIRST) -> Judged:
    """Run one episode in each environment of a native vector environment; the seeds are first, first + 1, ....

    Raises:
        ValueError: actions of the wrong shape, or not finite.
    """
    n, shape = int(env.num_envs), env.action_space.shape
    # compile before the clock starts
    env.reset(seed=first)
    env.step(np.zeros(shape, np.float32))
    wall, cpu, deciding = time.perf_counter(), time.process_time(), 0.0
    observation, info = env.reset(seed=first)
    policy.reset(observation)
    alive = np.ones(n, bool)
    returns, costs, lengths, settled = np.zeros(n), np.zeros(n), np.zeros(n, int), np.ones(n, int)
    successes = np.zeros(n, bool)
    while alive.any():
        before = time.perf_counter()
        actions = checked(policy.act(observation), shape)
        deciding += time.perf_counter() - before
        observation, reward, terminated, truncated, info = env.step(actions)
        # finished episodes do not count any more
        returns += np.where(alive, reward, 0.0)
        costs += np.where(alive, info.get("cost", 0.0), 0.0)
        lengths += alive
        # the success at the end began one period after the last period without success
        settled = np.where(alive & ~info["is_success"], lengths + 1, settled)
        ended = alive & (terminated | truncated)
        successes[ended] = info["is_success"][ended] & ~terminated[ended]
        alive &= ~ended
    return Judged(
        returns=returns.tolist(), successes=successes.tolist(), costs=costs.tolist(), lengths=lengths.tolist(),
        settled=np.where(successes, settled, 0).tolist(),
        wall_s=time.perf_counter() - wall, cpu_s=time.process_time() - cpu,
        decision_us=1e6 * deciding / (n * int(lengths.max())),
    )  # fmt: skip


def checked(action: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Validate actions and clip them to [-1, 1]. ValueError for a wrong type or shape, or non-finite numbers."""
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
