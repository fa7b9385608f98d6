"""Gymnasium wrappers that add a classical controller's torques to the agent's actions.

    env = AroundController(gymnasium.make("FlexibleArm-v0"), "pd", share=0.7)
    envs = AroundControllerVector(gymnasium.make_vec("FlexibleArm-v0", num_envs=64), "pd", share=0.7)

The torques are the controller's torques plus `share` times the torque limits times the agent's action. Any learning
library can train in a wrapped environment. `flexarm train --around` uses `AroundControllerVector`, and saves controller
and network as one policy.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from .control.around import Inside, restarting

Memory = dict[str, Any]


class AroundController(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wrapper of a single environment that adds a controller's torques to the actions.

    The sum of the controller's and the action's torques is saturated at the torque limits. The controller reads only
    the environment's observations.

    Args:
        env: an environment of this package whose actions are torques.
        controller: "pd" or another name of :func:`flexarm_env.control.make`; "pd@FILE" reads the gains from a file.
        share: fraction of the torque limits that an action of 1 adds; None means 0.7.
    Raises:
        ValueError: the controller is unknown, the share is not positive, or the environment is not supported.
    """

    def __init__(self, env: gym.Env[Any, Any], controller: str = "pd", share: float | None = None) -> None:
        """Make the controller for the wrapped environment."""
        RecordConstructorArgs.__init__(self, controller=controller, share=share)
        gym.Wrapper.__init__(self, env)
        self.inside = Inside.of(controller, env, share)
        self.controller = self.inside.made(env)
        self._seen: NDArray[np.float32] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the controller."""
        self._seen, info = self.env.reset(seed=seed, options=options)
        self.controller.reset(self._seen)
        return self._seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment with the controller's torques plus `share` times the clipped action (N,) in [-1, 1].

        Raises RuntimeError if `reset` has not been called.
        """
        if self._seen is None:
            raise RuntimeError("No episode has begun: call reset first")
        self._seen, *found = self.env.step(self.inside.actions(self.controller, self._seen, action))
        return (self._seen, *found)  # type: ignore[return-value]


class AroundControllerVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """Wrapper of a vector environment that adds a controller's torques to the actions, in every autoreset mode.

    Args:
        env: a vector environment of this package. controller, share: as for :class:`AroundController`. inside:
            controller with gains and share (`control.around.Inside`), in place of `controller` and `share`; or None.
    Raises:
        ValueError: the controller is unknown, the share is not positive, the environment is not supported, or the
            controller cannot be reset in single environments.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], controller: str = "pd", share: float | None = None,
        inside: Inside | None = None,
    ) -> None:  # fmt: skip
        """Make the controller for all environments of the vector environment."""
        super().__init__(env)
        self.inside = Inside.of(controller, env, share) if inside is None else inside
        self.controller = restarting(self.inside, env)
        self.mode = env.metadata.get("autoreset_mode")
        self._seen: NDArray[np.float32] | None = None
        self._ended = np.zeros(env.num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset all environments, or those that options["reset_mask"] selects, together with their controllers."""
        seen, info = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        if mask is None or self._seen is None:
            self.controller.reset(seen)
            self._ended[:] = False
        else:
            self.controller.restart(seen, np.asarray(mask, np.bool_))
            self._ended[np.asarray(mask, np.bool_)] = False
        self._seen = seen
        return seen, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all environments with the controller's torques plus `share` times the actions (n, N) in [-1, 1]."""
        if self._seen is None:
            raise RuntimeError("No episode has begun: call reset first")
        total = self.inside.actions(self.controller, self._seen, actions)
        seen, rewards, terminated, truncated, info = self.env.step(total)
        ended = np.logical_or(terminated, truncated)
        # the observation begins an episode: in the step that ends one, or in the next
        if self.mode == AutoresetMode.SAME_STEP:
            self.controller.restart(seen, ended)
        elif self.mode == AutoresetMode.NEXT_STEP:
            self.controller.restart(seen, self._ended)
        self._seen, self._ended = seen, ended
        return seen, rewards, terminated, truncated, info

    def memory(self) -> Memory:
        """Return a copy of the wrapper's state: last observations, ended episodes and the controller's memory."""
        arrays = {k: v.copy() for k, v in vars(self.controller).items() if isinstance(v, np.ndarray)}
        return {"seen": None if self._seen is None else self._seen.copy(), "ended": self._ended.copy(), "own": arrays}

    def remember(self, memory: Memory) -> None:
        """Restore a state that the method `memory` returned; call this method after `reset`."""
        self._seen, self._ended = memory["seen"], memory["ended"].copy()
        for name, value in memory["own"].items():
            setattr(self.controller, name, value.copy())


__all__ = ["AroundController", "AroundControllerVector", "Inside"]
