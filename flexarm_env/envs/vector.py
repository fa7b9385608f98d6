"""Base class of the environments with many arms, as a `gymnasium.vector.VectorEnv`."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any, Unpack, overload

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .. import validation as check
from ..batch import FRESH, REASONS, RUNNING, STATUS_WORDS, SUCCESS, Batch, OneAtATime, Sheet, View, one_at_a_time
from ..validation import Array32
from .keywords import Keywords
from .motion import Guide, is_table
from .resets import Request, guide_of, request_of, start_episode
from .single import F32, checked_action
from .spec import Specified
from .states import LinearModel, LinearModels, check_state, linear_model, linear_models, put_state, state_of

Flags = NDArray[np.bool_]

HALF = np.array(0.5)
"""The number 0.5 as an array, because NumPy compares an array faster with an array than with a Python number."""

SINGLE_NAMES = {"observation_space": "single_observation_space", "action_space": "single_action_space"}
"""Attributes of the single environment, with their names in the vector environment."""


class VectorArmEnv(Specified, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Common base class of the vector environments.

    Each arm gives bitwise the same results as the single environment. Only one thread at a time may reset or step the
    environment, or get or set its states; otherwise a RuntimeError is raised.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **arguments: Unpack[Keywords],
    ) -> None:
        """Check the keywords (`options.plan`) and compile or load the batch.

        Args:
            num_envs: number of arms. autoreset_mode: when arms restart after their episodes end. threads: number of
                threads; None chooses it from measured times.
        """
        self._door = OneAtATime()
        self.closed = True  # there is nothing to close where an argument is wrong
        self.num_envs = check.integer("num_envs", num_envs, minimum=1)
        if not isinstance(autoreset_mode, AutoresetMode):
            words = [mode.value for mode in AutoresetMode]
            autoreset_mode = AutoresetMode(check.choice("autoreset_mode", autoreset_mode, words))
        self.autoreset_mode = autoreset_mode
        self.single_action_space, self.single_observation_space = self._prepare(arguments)
        wanted = None if threads is None else check.integer("threads", threads, minimum=1)
        self.batch = self.plan.batch(self.num_envs, wanted)
        self.metadata = self.metadata | {"autoreset_mode": autoreset_mode}
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds: list[int] = [-1] * self.num_envs
        self._renderers: list[Any] = []
        self._linear: dict[float | None, Any] = {}
        self._wall: Any = None
        self._started = False
        self._ended: list[int] = []
        self._guides: dict[int, Guide] = {}
        self._everywhere = _constant(True, np.bool_, self.num_envs)
        self._bound = _constant(self.plan.deflection_bound, np.float64, self.num_envs)
        usual = STATUS_WORDS[0.0], ""
        self._fine = _constant(usual[0], object, self.num_envs), _constant(usual[1], object, self.num_envs)
        self._rows = tuple((e.name, e.first, None if e.count is None else e.first + e.count) for e in self.plan.entries)
        names = ["is_success", "in_range", "deflection_bound"]
        names += ["solver_status", "termination_reason"] if self.plan.words else []
        self._masks = {f"_{name}": self._everywhere for name in (*names, *(e.name for e in self.plan.entries))}
        self.closed = False

    @property
    def guides(self) -> Mapping[int, Guide]:
        """Dict from the index of each arm with a prescribed motion to the `Guide` that simulates this arm."""
        return self._guides

    # --- gymnasium ---------------------------------------------------------------------------------
    @one_at_a_time
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start episodes of all arms, or of the arms in options["reset_mask"], an array of num_envs bools.

        Args:
            seed: arm i has the seed seed + i or seed[i]; None: its random generator continues.
            options: options of the single environment, which apply to every arm.
        """
        seeds = checked_seeds(seed, self.num_envs)
        chosen, rest = checked_mask(options, self.num_envs)
        asked, guides = self._requests(chosen, rest)
        for i in chosen:
            if seeds[i] is not None:
                self._seed(i, seeds[i])
        self.batch.renew()
        self._start(chosen, RUNNING, asked, guides)
        if self._ended:
            again = set(chosen)
            self._ended = [i for i in self._ended if i not in again]
        self._started = self._started or self.batch.started
        if self.render_mode == "human":
            self.render()
        return self.batch.observation.copy(), self._infos(self._mask(chosen))

    def step(self, actions: Array32) -> tuple[Array32, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Advance all arms by one control period; the autoreset mode determines when ended episodes restart."""
        batch = self.batch
        if type(actions) is not np.ndarray or actions.dtype is not F32 or actions.shape != batch.action.shape:
            actions = checked_action(actions, batch.action.shape)
        with self._door:
            return self._stepped(batch, actions)

    def _stepped(
        self, batch: Batch, actions: Array32
    ) -> tuple[Array32, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Advance all arms by one control period, in the only thread that is inside the environment (see `step`)."""
        if not self._started:
            raise ResetNeeded("No episodes have begun: call reset() first")
        guided: list[tuple[int, Guide]] = []
        if self._guides:
            over = set(self._ended)
            guided = [(i, own) for i, own in self._guides.items() if i not in over]
        if self._ended and self.autoreset_mode is AutoresetMode.DISABLED:
            raise ResetNeeded(f"Arms {self._ended} have ended: reset them with options['reset_mask']")
        batch.renew(keep=False)
        if self._ended:  # in the step before, or as a state that was put back
            self._start(self._ended, FRESH, *self._requests(self._ended))
        batch.action[...] = actions
        attention = batch.step()
        for i, own in guided:
            own.step(batch, i)
        self._ended = np.flatnonzero(batch.terminated | batch.truncated).tolist() if attention else []
        if self.render_mode == "human":
            self.render()
        if self._ended and self.autoreset_mode is AutoresetMode.SAME_STEP:
            return self._same_step()
        infos = self._infos()
        return (
            batch.observation.copy(), batch.reward.copy(), batch.terminated.copy(), batch.truncated.copy(), infos,
        )  # fmt: skip

    def _same_step(self) -> tuple[Array32, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Restart the arms whose episodes ended in this step; final_* contains their last observation and info."""
        batch, ended = self.batch, self._ended
        mask = self._mask(ended)
        reward, terminated, truncated = batch.reward.copy(), batch.terminated.copy(), batch.truncated.copy()
        last = np.full(self.num_envs, None, dtype=object)
        for i in ended:
            last[i] = batch.observation[i].copy()
        final = self._infos(mask)
        self._start(self._ended, RUNNING, *self._requests(self._ended))
        self._ended = []
        infos = {"final_obs": last, "_final_obs": mask.copy(), "final_info": final, "_final_info": mask} | self._infos()
        return batch.observation.copy(), reward, terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture (height, width, 3) uint8 of each arm in "rgb_array" mode.

        In "human" mode, show all arms in a window.
        """
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array" or "human"')
            return None
        from .pictures import Wall, draw, renderer

        if self.render_mode == "human":
            self._wall = self._wall or Wall(self.plan, self.num_envs)
            self._wall.draw(self._view)
            return None
        if not self._renderers:
            self._renderers = [renderer(self.plan, self.render_mode) for _ in range(self.num_envs)]
        return tuple(draw(self._renderers[i], self.plan, self._view(i)) for i in range(self.num_envs))

    def _view(self, i: int) -> View:
        view = self.batch.view(i)
        return self._guides[i].view(view) if i in self._guides else view

    def close_extras(self, **kwargs: Any) -> None:
        """Close the windows and end the worker threads."""
        for one in (*self._renderers, *([] if self._wall is None else [self._wall])):
            one.close()
        self._renderers, self._wall = [], None
        self.batch.close()

    # --- seeds and starts ----------------------------------------------------------------------------
    @property  # type: ignore[override]
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """The arms' random generators; the user may replace them by the same number of generators."""
        return tuple(self._generator(i) for i in range(self.num_envs))

    @np_random.setter
    def np_random(self, generators: Any) -> None:
        self._generators, self._seeds = list(generators), [-1] * self.num_envs

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seeds of the random generators of the arms."""
        self.np_random  # noqa: B018  (seeds those that are not)
        return tuple(self._seeds)

    def _seed(self, i: int, seed: int | None) -> None:
        self._generators[i], self._seeds[i] = seeding.np_random(seed)

    def _generator(self, i: int) -> np.random.Generator:
        """Return arm i's random generator; the operating system seeds it if no seed was given."""
        if self._generators[i] is None:
            self._seed(i, None)
        generator = self._generators[i]
        assert generator is not None
        return generator

    def _start(
        self, arms: Sequence[int], mode: int, requests: dict[int, Request] | None, guides: dict[int, Guide]
    ) -> None:
        """Start episodes of the given arms with the results of `_requests`."""
        made = self._generators
        keys = [(made[i] or self._generator(i)).bit_generator.random_raw() for i in arms]
        if self._guides:
            again = set(arms)
            self._guides = {i: own for i, own in self._guides.items() if i not in again}
        first = None if requests is None else requests[arms[0]]
        if not guides and (requests is None or all(one is first for one in requests.values())):  # one compiled call
            if first is None:
                self.batch.request[:] = np.nan
            else:
                self.batch.ask(first.angles, first.target, first.vibration)
            with nullcontext() if first is None else first.commanded(self.batch):
                self.batch.start(arms, keys, limit=self.plan.limit, mode=mode)
            return
        assert requests is not None
        for i, key in zip(arms, keys, strict=True):
            if i in guides:
                self._guides[i] = guides[i]
            start_episode(self.batch, i, key, self.plan, requests[i], guides.get(i), mode)

    def _requests(
        self, arms: Sequence[int], options: dict[str, Any] | None = None
    ) -> tuple[dict[int, Request] | None, dict[int, Guide]]:
        """Return the checked options of each arm, or None, and the guides of arms with prescribed motion.

        A list of num_envs motions (not the rows of a table) gives one motion to each arm; other options apply to all
        arms.
        """
        if options is None and self.plan.motion is None:
            return None, {}
        motion, counts = (options or {}).get("motion"), (self.num_envs, self.plan.arm.n_links)
        own: dict[int, Any] = {}
        if isinstance(motion, list) and not is_table(motion):
            if len(motion) not in counts:
                what = f"must be one motion for all arms, or a list of {self.num_envs}, one for each"
                raise check.InvalidValue("options.motion", motion, what)
            own = dict(enumerate(motion)) if len(motion) == self.num_envs > 1 else {}
        if not own:
            asked = dict.fromkeys(arms, request_of(self.plan, options))  # what they ask for is read and not written to
        else:
            asked = {i: request_of(self.plan, {**(options or {}), "motion": own[i]}) for i in arms}
        if all(one.motion is None for one in asked.values()):
            return asked, {}
        asked = {i: one.copy() for i, one in asked.items()}  # a guide sets where its arm starts
        return asked, {i: made for i in arms if (made := guide_of(self.plan, asked[i])) is not None}

    def check_options(self, arms: Sequence[int], options: dict[str, Any] | None) -> None:
        """Raise ValueError for options that a reset of the given arms would reject."""
        if arms:
            self._requests(arms, options)

    @property
    def ended(self) -> Sequence[int]:
        """Indices of the arms whose episodes have ended and have not been reset."""
        return tuple(self._ended)

    # --- states --------------------------------------------------------------------------------------
    @one_at_a_time
    def get_state(self, indices: Sequence[int] | None = None) -> list[dict[str, Any]]:
        """Return copies of the complete states of all arms, or of the arms in `indices`."""
        chosen, guides = chosen_of(indices, self.num_envs), self._guides
        return [state_of(self.batch, i, self._generator(i), self._seeds[i], guides.get(i)) for i in chosen]

    @one_at_a_time
    def set_state(self, states: Sequence[dict[str, Any]], indices: Sequence[int] | None = None) -> None:
        """Set complete states that `get_state` of this or a single environment returned.

        Arms whose episodes have ended are reset in the next step, unless autoreset is disabled.
        """
        chosen = chosen_of(indices, self.num_envs)
        if len(states) != len(chosen):
            raise check.InvalidValue("states", f"{len(states)} states", f"must be {len(chosen)}, one for each arm")
        for state in states:
            check_state(self.batch, state)
        self.batch.renew()
        for i, state in zip(chosen, states, strict=True):
            self._generators[i], self._seeds[i], own = put_state(self.batch, i, state)
            self._guides.pop(i, None)
            if own is not None:
                self._guides[i] = own
        self._ended = np.flatnonzero(self.batch.terminated | self.batch.truncated).tolist()
        self._started = self.batch.started

    @overload
    def linearize(self, index: int, discrete: float | None = None) -> LinearModel: ...
    @overload
    def linearize(self, index: None = None, discrete: float | None = None) -> LinearModels: ...
    def linearize(self, index: int | None = None, discrete: float | None = None) -> LinearModel | LinearModels:
        """Return the linear model of arm `index` at its present state, or the models of all arms if `index` is None.

        If the links are elasticas and the joints are ideal, one compiled call computes the models of all arms.
        """
        if index is None:
            return linear_models(self.plan, self.batch, self._guides, discrete, self._linear)
        index = check.integer("index", index, minimum=0, maximum=self.num_envs - 1)
        return linear_model(self.plan, self.batch, index, self._guides.get(index), discrete)

    def call(self, name: str, *args: Any, indices: Sequence[int] | None = None, **kwargs: Any) -> tuple[Any, ...]:
        """Return the results of a method, or the values of an attribute, for all arms or for the arms in `indices`.

        Supported methods are "get_state", "linearize", "render" and "set_state" (with one state for all arms or a list
        of states). An attribute has the same value for all arms.
        """
        chosen = chosen_of(indices, self.num_envs)
        if name == "get_state":
            return tuple(self.get_state(chosen, *args, **kwargs))
        if name == "set_state":
            (states,) = (*args, *kwargs.values())
            self.set_state([states] * len(chosen) if isinstance(states, dict) else states, chosen)
            return (None,) * len(chosen)
        if name == "linearize":
            return tuple(self.linearize(i, *args, **kwargs) for i in chosen)
        if name == "render":
            frames = self.render()
            return (None,) * len(chosen) if frames is None else tuple(frames[i] for i in chosen)
        value = self.plan.period if name == "dt" else getattr(self, SINGLE_NAMES.get(name, name))
        if callable(value):
            raise check.InvalidValue("name", name, "must be get_state, set_state, linearize, render or an attribute")
        if isinstance(value, tuple) and len(value) == self.num_envs and name in ("np_random", "np_random_seed"):
            return tuple(value[i] for i in chosen)
        return (value,) * len(chosen)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_renderers": [], "_wall": None, "_linear": {}}

    # --- info ------------------------------------------------------------------------------------------
    def _mask(self, arms: Sequence[int]) -> Flags:
        mask = np.zeros(self.num_envs, np.bool_)
        mask[list(arms)] = True
        return mask

    def _infos(self, only: Flags | None = None) -> dict[str, Any]:
        """Return the info of all arms, or of the arms in `only` (zeros elsewhere), with a mask for each key.

        The values are views of the batch's table, which is a new array at every step. The masks of all keys are one
        array. While no episode has ended, status and reason are the same read-only arrays at every step.
        """
        sheet = self.batch.sheet
        if not sheet.others:
            self._show(sheet)
        success, in_range, reason = sheet.others
        infos = sheet.told.copy()
        infos["is_success"], infos["in_range"] = success > HALF, in_range > HALF
        if self.plan.words and (only is not None or self._ended):  # only arms that have just ended have a reason
            infos["solver_status"], infos["termination_reason"] = self._words(reason)
        if only is None:
            return infos
        mask = only.copy()
        return {key: mask if key in self._masks else _blanked(values, only) for key, values in infos.items()}

    def _show(self, sheet: Sheet) -> None:
        """Make the views of the batch's table that `info` contains."""
        at, table = self.batch.info_at, sheet.array[:, : self.num_envs]
        rows = {k: table[first] if last is None else table[first:last].T for k, first, last in self._rows}
        words = dict(zip(("solver_status", "termination_reason"), self._fine, strict=True)) if self.plan.words else {}
        usual = {"is_success": None, "in_range": None, "deflection_bound": self._bound, **words}
        sheet.show({**usual, **rows, **self._masks}, (table[SUCCESS], table[at.in_range], table[at.reason]))

    def _words(self, codes: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return each arm's solver status and termination reason as words."""
        some = np.flatnonzero(codes).tolist()
        if not some:
            return self._fine
        status, reason = self._fine[0].copy(), self._fine[1].copy()
        for i in some:
            status[i], reason[i] = STATUS_WORDS[codes[i]], REASONS[codes[i]]
        return status, reason


def _blanked(values: NDArray[Any], only: Flags) -> NDArray[Any]:
    blank = np.full(len(values), None, dtype=object) if values.dtype == object else np.zeros_like(values)
    blank[only] = values[only]
    return blank


def _constant(value: Any, dtype: Any, n: int) -> NDArray[Any]:
    """Return a read-only array of n equal values."""
    made = np.empty(n, dtype)
    made.fill(value)
    made.flags.writeable = False
    return made


def checked_seeds(seed: Any, n: int) -> Sequence[int | None]:
    """Return a seed or None for each of n arms; if `seed` is a number, arm i has the seed seed + i."""
    if seed is None:
        return [None] * n
    if not check.several(seed):
        first = check.integer("seed", seed, minimum=0)
        return [first + i for i in range(n)]
    if len(seed) != n:
        raise check.InvalidValue("seed", seed, f"must be a number or a sequence of {n}")
    return [None if s is None else check.integer(f"seed[{i}]", s, minimum=0) for i, s in enumerate(seed)]


def checked_mask(options: dict[str, Any] | None, n: int) -> tuple[list[int], dict[str, Any] | None]:
    """Return the indices of the arms (of n) that options['reset_mask'] selects, and the other options."""
    if options is None or "reset_mask" not in check.table_of("options", options):
        return list(range(n)), options
    mask = options["reset_mask"]
    right = isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (n,)
    if not right or not mask.any():
        what = f"must be a numpy array of {n} bools, at least one of them True"
        raise check.InvalidValue("options.reset_mask", mask, what)
    rest = {k: v for k, v in options.items() if k != "reset_mask"}
    return np.flatnonzero(mask).tolist(), rest or None


def chosen_of(indices: Sequence[int] | int | None, n: int) -> list[int]:
    """Return the indices of the arms (of n) that `indices` selects: all arms for None, one, or several."""
    if indices is None:
        return list(range(n))
    if isinstance(indices, int | np.integer):
        indices = (int(indices),)
    return [check.integer(f"indices[{k}]", i, minimum=0, maximum=n - 1) for k, i in enumerate(indices)]
