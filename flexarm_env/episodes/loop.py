"""Run a policy in episodes of a single or a vector environment."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import validation as check


class Policy(Protocol):
    """Interface of a policy for one episode, or for n episodes that begin together.

    `reset` is called with the first observations. After `reset`, `act` is called with the observations of each period,
    including the first observations.
    """

    def reset(self, observation: NDArray[np.float32]) -> Any:
        """Begin episodes with the given first observations; this default, for policies without memory, does nothing."""
        return

    def act(self, observation: NDArray[np.float32]) -> Any:
        """Return actions (n, joints) for observations (n, entries); in one episode, (joints,) for (entries,)."""


@dataclass(frozen=True, slots=True)
class Instant:
    """Data at the start of episodes, or at the end of a control period.

    In a vector environment the attributes are arrays with one row per episode.

    Attributes:
        seeds: seeds of the episodes. period: number of the control period, from 1; 0 at the start. action: action of
            the period; None at the start. observation, reward, terminated, truncated, info: results of the
            environment's `reset` or `step`; at the start the reward is 0 and the flags are False. running: True if the
            period belongs to the episode, False after the episode's end.
    """

    seeds: Sequence[int | None]
    period: int
    action: Any
    observation: Any
    reward: Any
    terminated: Any
    truncated: Any
    info: Mapping[str, Any]
    running: Any


Recorder = Callable[[Instant], Any]
"""Function that is called with every instant of the played episodes."""


def periods(
    env: Any, policy: Policy, seeds: Sequence[int | None], options: Mapping[str, Any] | None = None
) -> Iterator[Instant]:
    """Run one episode for each seed; yield an `Instant` at the start of each episode and after each control period.

    A single environment runs one episode after the other. A vector environment of n arms runs n episodes together until
    all of them have ended; `Instant.running` is False for episodes that have already ended.

    Args:
        env: the environment, with or without wrappers. A vector environment must have the autoreset mode "NextStep",
            its default. policy: the policy, which is reset at the start of each episode, or of each group of n
            episodes. seeds: one seed per episode, a multiple of n; None to continue with the environment's random
            generator. options: options of every `reset`.
    Raises:
        ValueError: the number of seeds is not a multiple of n, or the autoreset mode is not "NextStep".
    """
    n = getattr(env, "num_envs", None)
    if n is not None:
        if len(seeds) % n:
            raise check.InvalidValue("seeds", f"{len(seeds)} seeds", f"must be a multiple of the {n} arms of env")
        mode = getattr(env, "metadata", {}).get("autoreset_mode")
        if mode is not None and mode.name != "NEXT_STEP":
            raise check.InvalidValue("env.autoreset_mode", mode.value, "must be NextStep to play episodes")
    for at in range(0, len(seeds), n or 1):
        own = seeds[at : at + (n or 1)]
        yield from _together(env, policy, own, n, options)


def _together(
    env: Any, policy: Policy, seeds: Sequence[Any], n: int | None, options: Mapping[str, Any] | None
) -> Iterator[Instant]:
    """Play the episode of a single environment, or one episode of each arm of a vector environment."""
    # a vector environment counts on from one seed by itself
    seed: Any = seeds[0] if n is None or list(seeds) == list(range(seeds[0], seeds[0] + n)) else list(seeds)
    observation, info = env.reset(seed=seed) if options is None else env.reset(seed=seed, options=options)
    policy.reset(observation)
    none: Any = False if n is None else np.zeros(n, bool)
    running: Any = True if n is None else np.ones(n, bool)
    yield Instant(seeds, 0, None, observation, 0.0, none, none, info, running)
    period = 0
    while np.any(running):
        action = policy.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        period += 1
        yield Instant(seeds, period, action, observation, reward, terminated, truncated, info, running)
        over = terminated | truncated
        running = not over if n is None else running & ~over


def play(
    env: Any,
    policy: Policy,
    seeds: Sequence[int | None],
    recorders: Sequence[Recorder] = (),
    options: Mapping[str, Any] | None = None,
) -> None:
    """Run one episode for each seed, and call every recorder with every `Instant`; for the arguments see `periods`."""
    for instant in periods(env, policy, seeds, options):
        for recorder in recorders:
            recorder(instant)


class Actions(Policy):
    """Open-loop policy that returns given actions: (T, N) for one episode or (T, n, N) for n episodes."""

    def __init__(self, actions: NDArray[Any]) -> None:
        self.actions = actions

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Return to the first of the given actions."""
        self.k = 0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next actions; after the end of the sequence, return the last actions again."""
        self.k += 1
        now: NDArray[np.float32] = self.actions[min(self.k, len(self.actions)) - 1].astype(np.float32)
        return now


class Timed(Policy):
    """Wrapper of a policy that measures the duration of each call of `act`.

    Attributes:
        seconds: list of the durations, s, measured by `clock`.
    """

    def __init__(self, policy: Policy, clock: Callable[[], float]) -> None:
        self.policy, self.clock = policy, clock
        self.seconds: list[float] = []

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Reset the policy, without measuring the duration."""
        self.policy.reset(observation)

    def act(self, observation: NDArray[np.float32]) -> Any:
        """Return the policy's actions, and append the duration of the call to `seconds`."""
        began = self.clock()
        action = self.policy.act(observation)
        self.seconds.append(self.clock() - began)
        return action
