"""Gymnasium wrapper with goal dictionaries, for hindsight experience replay (HER).

    env = GoalObservation(gymnasium.make("TwoLinkFlexArm-v0"))
    model = SAC("MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer)

HER (Andrychowicz et al. 2017) stores each transition a second time with a goal that the arm reached later in the
episode, and computes the reward of the new goal with the method `compute_reward`.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from . import validation as check

Observation = dict[str, NDArray[np.float32]]

_TARGETS = ("to_target_", "target_")
_ERROR = "_error"


class GoalObservation(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wrapper of a reach task whose observation has the keys `observation`, `achieved_goal` and `desired_goal`.

    | key | shape | content |
    |---|---|---|
    | `observation` | (m,) | the environment's observation without the entries that depend on the target |
    | `achieved_goal` | (d,) | position of the tip divided by the arm's length L |
    | `desired_goal` | (d,) | position of the target divided by L |

    d is 2 in the plane and 3 in space. The reward is 1 in each control period that ends with the tip within `tolerance`
    of the target, otherwise 0. A failure ends the episode, so no further rewards follow. Goals are exact positions,
    even if the environment has sensors. `info` remains the environment's.

    Args:
        env: single environment of this package with task="reach".
        tolerance: largest distance of the tip from the target divided by L; None: the environment's bound of success.
    Raises:
        ValueError: the environment has a task other than "reach", all its observation entries depend on the target, or
            `tolerance` is not positive.
    """

    def __init__(self, env: gym.Env[Any, Any], tolerance: float | None = None) -> None:
        """Select the entries of the observation that do not depend on the target."""
        RecordConstructorArgs.__init__(self, tolerance=tolerance)
        gym.Wrapper.__init__(self, env)
        plan = getattr(env.unwrapped, "plan", None)
        if plan is None or plan.task != "reach":
            task = "of another package" if plan is None else f'with task="{plan.task}"'
            raise ValueError(f'GoalObservation needs an environment of this package with task="reach", not one {task}')
        bound = float(plan.record.bands[0]) if tolerance is None else tolerance
        self.tolerance = check.number("tolerance", bound, "of the arm's length", above=0.0)
        self.length = float(plan.arm.total_length)
        kept = [not (name.startswith(_TARGETS) or name.endswith(_ERROR)) for name in plan.names]
        space: Any = env.observation_space
        self._kept = np.tile(np.array(kept, np.bool_), space.shape[0] // len(kept))
        if not self._kept.any():
            raise ValueError(f"GoalObservation needs entries besides the target's, not only {', '.join(plan.names)}")
        self.goal = gym.spaces.Box(-np.inf, np.inf, (plan.kind.target.numbers,), np.float32)
        seen = gym.spaces.Box(space.low[self._kept], space.high[self._kept], dtype=np.float32)
        self.observation_space = gym.spaces.Dict(observation=seen, achieved_goal=self.goal, desired_goal=self.goal)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset the environment; return the goal dictionary and the environment's `info`."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._split(observation, info), info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Step the environment; return the goal dictionary and the reward of `compute_reward`."""
        observation, _, terminated, truncated, info = self.env.step(action)
        seen = self._split(observation, info)
        reward = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info))
        return seen, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return rewards (...), 1 or 0, for positions (..., d) of the tip and of the target, each divided by L.

        info: not used; part of the interface that HER needs.
        """
        apart = np.linalg.norm(np.asarray(achieved_goal) - np.asarray(desired_goal), axis=-1)
        return (apart <= self.tolerance).astype(np.float32)

    def _split(self, observation: NDArray[np.float32], info: dict[str, Any]) -> Observation:
        """Return the goal dictionary of an observation and its `info`."""
        tip, target = (np.asarray(info[name] / self.length, np.float32) for name in ("tip_position", "target"))
        return {"observation": observation[self._kept], "achieved_goal": tip, "desired_goal": target}


__all__ = ["GoalObservation"]
