"""Base class of the environments with one arm, as a `gymnasium.Env`."""

from typing import Any, Unpack

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from .. import validation as check
from ..batch import CROWDED, MODE, OVER, REASONS, RUNNING, STATUS_WORDS, SUCCESS, View
from ..validation import Array32
from .keywords import Keywords
from .motion import Guide
from .resets import guide_of, request_of, start_episode
from .spec import Specified
from .states import LinearModel, check_state, linear_model, put_state, state_of

F32 = np.dtype(np.float32)
IN_USE = "in use"
"""Value of `_over` while a thread is inside `step` or `reset`.

One check therefore confirms that an episode runs and that no other thread is inside. Python does not switch threads
between the check and the assignment of this value.
"""


class SingleArmEnv(Specified, gym.Env[Array32, Array32]):
    """Common base class of the environments with a single arm.

    Each environment's class also has gymnasium.Env as a direct base class, because some libraries, such as skrl,
    recognize environments by their direct base classes.
    """

    def __init__(self, **arguments: Unpack[Keywords]) -> None:
        """Check the keywords (`options.plan`) and compile or load the batch of one arm."""
        self.action_space, self.observation_space = self._prepare(arguments)
        self.batch = self.plan.batch(1)
        self._renderer: Any = None
        self.guide: Guide | None = None
        self._over: bool | str = True
        self._bind()

    def _rebind(self) -> None:
        self._bind()

    def _bind(self) -> None:
        """Store as attributes the objects that `step` reads, to save look-ups."""
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
        """Start an episode of the environment's arm.

        Args:
            seed: seed of the environment's random generator; None: the generator continues.
            options: options of the reset (initial state, target, motion, ...), which the environment's page describes.
                An unknown key or an invalid value raises ValueError, and the environment does not change.
        """
        asked = request_of(self.plan, options)
        own = guide_of(self.plan, asked)
        before = self._free()
        try:
            self._over = IN_USE
            super().reset(seed=None if seed is None else check.integer("seed", seed, minimum=0))
            self.guide = own
            key = int(self.np_random.bit_generator.random_raw())
            start_episode(self.batch, 0, key, self.plan, asked, own, RUNNING)
            if self.render_mode == "human":
                self.render()
            seen, info = self._seen.copy(), self._outcome()[0]
        except BaseException:
            self._over = before
            raise
        self._over = False
        return seen, info

    def _free(self) -> bool | str:
        """Return whether the episode is over; raise RuntimeError while another thread uses the environment."""
        over = self._over
        if over is IN_USE:
            raise RuntimeError(CROWDED)
        return over

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Advance one control period with an action (N,); an action of wrong shape or type raises ValueError."""
        if type(action) is not np.ndarray or action.dtype is not F32 or action.shape != self._shape:
            action = checked_action(action, self._shape)
        if self._over:
            self._free()
            raise ResetNeeded("The episode has ended (or none has begun): call reset() first")
        self._over = IN_USE
        try:
            self._action[:] = action
            if self.guide is None:
                self._step(self._address, 0, 1)
            else:
                self.guide.step(self.batch, 0)
            if self.render_mode == "human":
                self.render()
            info, reward, terminated, truncated = self._outcome()
            seen = self._seen.copy()
        except BaseException:  # Ctrl-C, say: the episode goes on
            self._over = False
            raise
        self._over = terminated or truncated
        return seen, reward, terminated, truncated, info

    def _outcome(self) -> tuple[dict[str, Any], float, bool, bool]:
        """Return info, reward, terminated and truncated from one copy of the batch's numbers."""
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
        """Return a picture (height, width, 3) uint8 in "rgb_array" mode; None otherwise."""
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array" or "human"')
            return None
        from .pictures import draw, renderer

        self._renderer = self._renderer or renderer(self.plan, self.render_mode)
        return draw(self._renderer, self.plan, self.snapshot())

    @property
    def renderer(self) -> Any:
        """The `rendering.Renderer` (with `visible` and `closed`); None before the first picture."""
        return self._renderer

    def snapshot(self) -> View:
        """Return the arm's points, poses, target, torques and coordinates (`flexarm_env.batch.View`)."""
        view = self.batch.view(0)
        return view if self.guide is None else self.guide.view(view)

    def close(self) -> None:
        """Close the window and release the environment's resources."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    # --- states --------------------------------------------------------------------------------------
    def get_state(self) -> dict[str, Any]:
        """Return a copy of the environment's complete state.

        The state contains the arm, the integrator's history, sensors, motors, target, random generator and prescribed
        motion. It can be pickled.
        """
        self._free()
        return state_of(self.batch, 0, self.np_random, self.np_random_seed, self.guide)

    def set_state(self, state: dict[str, Any]) -> None:
        """Set a complete state that `get_state` of this or an equal environment returned.

        Steps after `set_state` give bitwise the same results as steps after `get_state`.
        """
        self._free()
        check_state(self.batch, state)
        self.np_random, self._np_random_seed, self.guide = put_state(self.batch, 0, state)
        self._over = bool(self.batch.record(0)[MODE] == OVER)

    def linearize(self, discrete: float | None = None) -> LinearModel:
        """Return the arm's linear model at its present state and torques (see `flexarm_env.linear.linearize`).

        discrete: period, s, of a discrete model with constant torques; None for the continuous model.
        """
        return linear_model(self.plan, self.batch, 0, self.guide, discrete)

    @property
    def dt(self) -> float:
        """Control period of the environment, s."""
        return self.plan.period

    def __getstate__(self) -> dict[str, Any]:
        bound = ("_step", "_address", "_action", "_shape", "_seen", "_numbers", "_at")
        return {k: v for k, v in vars(self).items() if k not in bound} | {"_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()


def checked_action(action: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Validate an action and return it as float32 of the given shape, with extreme values limited."""
    try:
        values = np.asarray(action)
    except (TypeError, ValueError):
        values = np.array(None)
    if values.dtype.kind not in "fiu" or values.shape != shape:
        raise check.InvalidValue("action", action, f"must be an array of numbers of shape {shape}")
    return np.where(np.isfinite(values), np.clip(values, -2.0, 2.0), values).astype(np.float32)
