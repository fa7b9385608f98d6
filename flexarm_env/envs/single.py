"""One arm as a `gymnasium.Env`: a batch of one."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from .. import validation as check
from ..batch import MODE, OVER, REASONS, RUNNING, STATUS_WORDS, SUCCESS, View
from ..validation import Array32
from .motion import Guide
from .resets import follow, guide_of, request_of, start_episode
from .spec import Specified
from .states import LinearModel, check_state, linear_model, put_state, state_of

F32 = np.dtype(np.float32)


class SingleArmEnv(Specified, gym.Env[Array32, Array32]):
    """What the single environments have in common.

    They name gymnasium.Env (and their vector forms VectorEnv) as a base once more: there are libraries, skrl one of
    them, that tell an environment by its class's own bases.
    """

    def __init__(self, **arguments: Any) -> None:
        self.action_space, self.observation_space = self._prepare(arguments)
        self.batch = self.plan.batch(1)
        self._renderer: Any = None
        self.guide: Guide | None = None
        self._over = True
        self._bind()

    def _bind(self) -> None:
        """Names that a step reads, short to reach."""
        batch = self.batch
        self._step, self._address = batch.compiled_step, batch.address
        self._action, self._shape = batch.action[0], batch.action[0].shape
        self._seen, self._numbers, self._at = batch.observation[0], batch.table[:, 0], batch.info_at
        self._bound, self._words = self.plan.deflection_bound, self.plan.words
        self._floats = tuple((e.name, e.first) for e in self.plan.entries if e.count is None)
        self._arrays = tuple((e.name, e.first, e.first + e.count) for e in self.plan.entries if e.count is not None)

    # --- gymnasium ---------------------------------------------------------------------------------
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: of the environment's generator; None goes on with it.
            options: see the class. An unknown key or a wrong value is a ValueError, before anything changes.
        """
        asked = request_of(self.plan, options)
        own = guide_of(self.plan, asked)
        super().reset(seed=None if seed is None else check.integer("seed", seed, minimum=0))
        self.guide = own
        key = int(self.np_random.bit_generator.random_raw())
        start_episode(self.batch, 0, key, self.plan, asked, own, RUNNING)
        if self.render_mode == "human":
            self.render()
        self._over = False
        return self._seen.copy(), self._outcome()[0]

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """One control period. A wrong shape or kind of action is a ValueError, and nothing has moved."""
        if type(action) is not np.ndarray or action.dtype is not F32 or action.shape != self._shape:
            action = checked_action(action, self._shape)
        if self._over:
            raise ResetNeeded("The episode has ended (or none has begun): call reset() first")
        self._action[:] = action
        if self.guide is None:
            self._step(self._address, 0, 1)
        else:
            follow(self.batch, 0, self.guide)
        if self.render_mode == "human":
            self.render()
        info, reward, terminated, truncated = self._outcome()
        self._over = terminated or truncated
        return self._seen.copy(), reward, terminated, truncated, info

    def _outcome(self) -> tuple[dict[str, Any], float, bool, bool]:
        """info, reward, terminated, truncated, from one copy of the numbers."""
        numbers = self._numbers.copy()
        values = numbers.tolist()
        at = self._at
        reason = values[at.reason]
        info: dict[str, Any] = {
            "is_success": values[SUCCESS] > 0.5,
            "in_range": values[at.in_range] > 0.5,
            "deflection_bound": self._bound,
        }
        if self._words:
            info["solver_status"], info["termination_reason"] = STATUS_WORDS[reason], REASONS[reason]
        for name, first in self._floats:
            info[name] = values[first]
        for name, first, last in self._arrays:
            info[name] = numbers[first:last]
        return info, values[at.reward], reason != 0.0, values[at.truncated] != 0.0

    def render(self) -> Any:
        """A picture (height, width, 3) uint8 in "rgb_array" mode; None otherwise."""
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array" or "human"')
            return None
        from .pictures import draw, renderer

        self._renderer = self._renderer or renderer(self.plan, self.render_mode)
        return draw(self._renderer, self.plan, self.snapshot())

    @property
    def renderer(self) -> Any:
        """What draws (`rendering.Renderer`: `visible`, `closed`); None before the first picture."""
        return self._renderer

    def snapshot(self) -> View:
        """Where the arm is: points, poses, target, torques, coordinates (`flexarm_env.batch.View`)."""
        view = self.batch.view(0)
        return view if self.guide is None else self.guide.view(view.target)

    def close(self) -> None:
        """Close the window and let go of what was held."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    # --- states --------------------------------------------------------------------------------------
    def get_state(self) -> dict[str, Any]:
        """Everything that the future depends on, a copy: the arm with its integrator's history, sensors, motors and
        target, the generator, the motion it follows. It can be pickled."""
        return state_of(self.batch, 0, self.np_random, self.np_random_seed, self.guide)

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state that `get_state` gave, in this or a like environment, bit for bit."""
        check_state(self.batch, state)
        self.np_random, self._np_random_seed, self.guide = put_state(self.batch, 0, state)
        self._over = bool(self.batch.record(0)[MODE] == OVER)

    def linearize(self, discrete: float | None = None) -> LinearModel:
        """The linear model of the arm at its present state and torques (see `flexarm_env.linear.linearize`).

        discrete: period, s, over which torques are held; None for the continuous model.
        """
        return linear_model(self.plan, self.batch, 0, self.guide, discrete)

    @property
    def dt(self) -> float:
        """Control period, s."""
        return self.plan.period

    def __getstate__(self) -> dict[str, Any]:
        bound = ("_step", "_address", "_action", "_shape", "_seen", "_numbers", "_at")
        return {k: v for k, v in vars(self).items() if k not in bound} | {"_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()


def checked_action(action: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The action as float32 of this shape, far beyond +-1 clipped, or a ValueError."""
    try:
        values = np.asarray(action)
    except (TypeError, ValueError):
        values = np.array(None)
    if values.dtype.kind not in "fiu" or values.shape != shape:
        raise check.InvalidValue("action", action, f"must be an array of numbers of shape {shape}")
    return np.where(np.isfinite(values), np.clip(values, -2.0, 2.0), values).astype(np.float32)
