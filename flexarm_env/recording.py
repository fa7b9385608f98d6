"""Record episodes, save them to a file, replay them with bitwise equal results, and export them to Minari.

    from flexarm_env.recording import EpisodeRecorder, load_episodes, replay, save_episodes, to_minari
    env = EpisodeRecorder(gymnasium.make("FlexibleArm-v0"))
    ...                                             # reset and step as usual
    save_episodes("episodes.npz", env.episodes)
    again = replay(load_episodes("episodes.npz")[0])

A file contains `meta` (JSON: format, version, and each episode's environment and reset arguments) and arrays, in which
n episodes of T steps follow one after the other: `lengths` (n,), `observations` (sum(T + 1), O), `actions` (sum(T), N),
`rewards`, `terminations`, `truncations` (sum(T),), and `info_<name>` (sum(T + 1), ...).
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray

from flexarm_env import arms, sensors
from flexarm_env import validation as check
from flexarm_env.batch import curvature_rows, gauge_table
from flexarm_env.envs.ids import permitted
from flexarm_env.envs.single import checked_action
from flexarm_env.episodes import Actions, periods
from flexarm_env.files import from_json, read_npz, write_npz
from flexarm_env.parameters import Arm
from flexarm_env.scene import Scene
from flexarm_env.sensors import Sensors
from flexarm_env.shapes import Shape
from flexarm_env.validation import Array32
from flexarm_env.view import Clip, Player, SpaceClip
from flexarm_env.view.sources import of_episode

FORMAT = 1
STEPS = ("actions", "rewards", "terminations", "truncations")
TRANSPARENT = (PassiveEnvChecker, OrderEnforcing, TimeLimit)
"""Wrappers that do not change observations and actions."""


@dataclass(frozen=True, repr=False)
class Episode:
    """Episode of T steps, with all data for a replay.

    Attributes:
        env_id, env_kwargs, max_episode_steps: arguments of `gymnasium.make`; max_episode_steps may be None.
        seed: seed of the reset. If `seed` is None, `generator` is the random generator's state before the reset.
        options: options that were passed to `reset`, or None. observations (T + 1, O), actions (T, N): float32. rewards
            (T,): float64. terminations, truncations (T,): bool.
        infos: for each entry of `info`, by name, an array with T + 1 rows.
    """

    env_id: str
    env_kwargs: Mapping[str, Any]
    max_episode_steps: int | None
    seed: int | None
    generator: Mapping[str, Any] | None
    options: Mapping[str, Any] | None
    observations: Array32
    actions: Array32
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.rewards)

    def __repr__(self) -> str:
        return f"<Episode of {self.env_id}: {len(self)} steps, return {self.rewards.sum():.6g}>"

    @property
    def complete(self) -> bool:
        """True if the episode was terminated or truncated, False if it was interrupted."""
        return len(self) > 0 and bool(self.terminations[-1] or self.truncations[-1])

    def equals(self, other: Episode) -> bool:
        """Return whether observations, actions, rewards and flags of two episodes are bitwise equal."""
        names = ("observations", *STEPS)
        return all(np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True) for name in names)

    def clip(self, label: str | None = None, env_id: str | None = None) -> Clip | SpaceClip:
        """Replay the episode and return it as a clip for the player. label: name of the clip; the default is the
        environment's id. env_id: as in `replay`.
        """
        with closing(_make_env(self, env_id, info_level="full")) as env:
            played = [(observation, info, env.unwrapped.snapshot()) for observation, info in _played(env, self)]
            plan, guide = env.unwrapped.plan, env.unwrapped.guide
        seen, infos, views = zip(*played, strict=True)
        # curves of the player: reward terms, energies and work (J), and the last instant of each observed entry
        rows = {
            name: np.array([math.nan] + [float(info[name]) for info in infos[1:]])
            for name in infos[0] if name.startswith(("reward_", "energy_")) or name == "work"
        }  # fmt: skip
        last = np.array(seen)[:, -len(plan.names) :]
        rows |= {f"seen_{name}": values.astype(float) for name, values in zip(plan.names, last.T, strict=True)}
        rate: Any = partial(gauge_table, plan.arm, plan.settings, plan.gravity)
        if guide is not None:  # an arm that follows a motion has a state of its own form
            rate = partial(curvature_rows, guide.scene, guide.settings, guide.simulation.system)
        return of_episode(plan, views, rows, self.rewards, self.env_id if label is None else label, rate)

    def view(self, *others: Episode, labels: Sequence[str] | None = None, env_id: str | None = None) -> Player:
        """Return a `Player` that shows this episode and `others`; save the player by `.save("episode.html")` or display
        it in a notebook. labels: labels of all episodes; the default is the environments' ids. env_id: as in `replay`.
        """
        return Player.of((self, *others), labels, env_id)

    def _repr_html_(self) -> str:
        return self.view()._repr_html_()


class EpisodeRecorder(gym.Wrapper[Array32, Array32, Array32, Array32]):
    """Wrapper of a single environment that stores its episodes in the list `episodes`, oldest first.

    An episode is stored when it ends. If `reset` or `close` interrupts an episode, the steps until then are stored.
    Wrappers that change observations or actions must be applied outside `EpisodeRecorder`.

    Raises:
        ValueError: env is of another package, was not created by `gymnasium.make`, or has keywords unfit for a file.
    """

    def __init__(self, env: gym.Env[Array32, Array32]) -> None:
        """Check that env is a single environment of this package, and store its keywords."""
        super().__init__(env)
        if env.spec is None or not hasattr(env.unwrapped, "plan"):
            raise ValueError(f"env = {env}: must be a single environment of flexarm_env that gymnasium.make has made")
        inner = env
        while isinstance(inner, gym.Wrapper):
            if not isinstance(inner, TRANSPARENT):
                raise ValueError(f"env = {env}: record below {type(inner).__name__}, not around it")
            inner = inner.env
        kwargs = {k: v for k, v in env.spec.kwargs.items() if k != "render_mode"}
        if kwargs.get("arm") is not None and kwargs["arm"] not in arms.names():
            # store the arm itself: its file may be missing later
            kwargs["arm"] = env.unwrapped.plan.arm
        self.episodes: list[Episode] = []
        self._env_kwargs: dict[str, Any] = _plain("env", kwargs)
        self._start: dict[str, Any] = {}
        self._rows: dict[str, list[Any]] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode with a seed and options; raise ValueError if a file cannot contain the options."""
        self._keep()
        kept = None if options is None else _plain("options", options)
        # without a seed the generator's state determines the start
        generator = None if seed is not None else _plain("generator", self.np_random.bit_generator.state)
        observation, info = self.env.reset(seed=seed, options=options)
        self._start = {"seed": _plain("seed", seed), "generator": generator, "options": kept}
        self._rows = {name: [] for name in STEPS} | {"observations": [observation], "infos": [info]}
        return observation, info

    def step(self, action: Array32) -> tuple[Array32, Any, bool, bool, dict[str, Any]]:
        """Step the environment by one control period and store the result."""
        if not self._rows:
            raise ResetNeeded("The episode has ended (or none has begun): call reset() first")
        # store the float32 action that the environment uses
        if getattr(action, "dtype", None) != np.float32:
            action = checked_action(action, self.env.unwrapped.action_space.shape or ())
        outcome = self.env.step(action)
        observation, reward, terminated, truncated, info = outcome
        row = (action.copy(), float(reward), terminated, truncated)
        for name, value in zip(STEPS, row, strict=True):
            self._rows[name].append(value)
        self._rows["observations"].append(observation)
        self._rows["infos"].append(info)
        if terminated or truncated:
            self._keep()
        return outcome

    def close(self) -> None:
        """Store the current episode and close the environment."""
        self._keep()
        super().close()

    def _keep(self) -> None:
        """Append the current episode to `episodes`, unless it has no step."""
        rows, self._rows = self._rows, {}
        if not rows or not rows["rewards"]:
            return
        assert self.env.spec is not None
        infos = rows["infos"]
        self.episodes.append(
            Episode(
                env_id=self.env.spec.id, env_kwargs=self._env_kwargs,
                max_episode_steps=getattr(self.env.spec, "given", None), **self._start,
                observations=np.array(rows["observations"]), actions=np.array(rows["actions"]),
                rewards=np.array(rows["rewards"]), terminations=np.array(rows["terminations"], np.bool_),
                truncations=np.array(rows["truncations"], np.bool_),
                infos={name: np.array([info[name] for info in infos]) for name in infos[0]},
            )
        )  # fmt: skip


# --------------------------------------------------------------------- again
def replay(episode: Episode, env_id: str | None = None) -> Episode:
    """Replay an episode in a new environment, with the same reset and actions, and return the new episode.

    On the processor and with the package version of the recording, `replay(e).equals(e)` is true.

    Args:
        env_id: must equal the episode's `env_id`; required if the episode's `env_id` names another package. Importing a
            package executes code, and an episode file must not choose which code is executed.
    Raises:
        ValueError: env_id is missing, the episode has no steps, or the replayed episode ends before the last action.
    """
    _alike([episode])
    env = EpisodeRecorder(_make_env(episode, env_id))
    for _ in _played(env, episode):
        pass
    env.close()
    return env.episodes[0]


def frames(episode: Episode, env_id: str | None = None) -> Iterator[NDArray[np.uint8]]:
    """Yield the T + 1 pictures (height, width, 3) of an episode, for `envs.video.write_film`. env_id: see `replay`."""
    with closing(_make_env(episode, env_id, render_mode="rgb_array")) as env:
        for _ in _played(env, episode):
            yield np.asarray(env.render())


def _make_env(episode: Episode, named: str | None, **more: Any) -> Any:
    """Create the environment of an episode, with the additional keywords `more`."""
    env_id, keywords = permitted("episode", episode.env_id, episode.env_kwargs, named)
    return gym.make(env_id, **{"max_episode_steps": episode.max_episode_steps, **_restored(keywords), **more})


def _played(env: Any, episode: Episode) -> Iterator[tuple[Array32, dict[str, Any]]]:
    """Replay an episode; yield (observation, info) at the start and after each step."""
    options = _restored(episode.options)
    if episode.generator is not None:
        env.unwrapped.np_random.bit_generator.state = dict(episode.generator)
    k, policy = 0, Actions(episode.actions)
    for now in islice(periods(env, policy, [episode.seed], options), len(episode) + 1):
        k = now.period
        yield now.observation, dict(now.info)
    if k < len(episode):
        raise check.InvalidValue("actions", f"{len(episode)} of them", f"must be {k}: played again, it ends there")


# --------------------------------------------------------------------- files
def save_episodes(path: str | os.PathLike[str], episodes: Sequence[Episode]) -> Path:
    """Write episodes of one environment to an .npz file atomically, and return the path.

    Args:
        path: path of the file; its folder is created. episodes: at least one episode; observations and infos must have
            the same shapes in all episodes.
    Raises:
        ValueError: there is no episode, arrays differ in shape, or `load_episodes` would reject an episode.
    """
    episodes = _alike(episodes)
    meta: dict[str, Any] = {
        "format": FORMAT,
        "flexarm_env": check.installed("flexarm_env") or "unknown",  # a checkout without installation
        "episodes": [_plain(f"episodes[{k}]", {key: getattr(e, key) for key in ABOUT}) for k, e in enumerate(episodes)],
    }
    arrays: dict[str, Any] = {"meta": json.dumps(meta), "lengths": np.array([len(e) for e in episodes])}
    for name in ("observations", *STEPS):
        arrays[name] = np.concatenate([getattr(e, name) for e in episodes])
    for name in episodes[0].infos:
        arrays[f"info_{name}"] = np.concatenate([e.infos[name] for e in episodes])
    # validate by the reader before writing
    list(_cut(arrays, meta["episodes"]))
    write_npz(Path(path), arrays)
    return Path(path)


def _alike(episodes: object) -> tuple[Episode, ...]:
    """Validate the episodes of one file: at least one, each with a step, and entries and infos of the same shapes."""
    found = check.sequence("episodes", episodes, "Episodes")
    if not found:
        raise ValueError("episodes = []: must hold at least one")
    for k, episode in enumerate(found):
        if not len(check.instance(f"episodes[{k}]", episode, Episode)):
            raise check.InvalidValue(f"episodes[{k}]", episode, "must have at least one step")
        # shapes without the axis of time must be those of the first episode
        shapes, first = (
            {n: v.shape[1:] for n, v in {"observations": e.observations, "actions": e.actions, **e.infos}.items()}
            for e in (episode, found[0])
        )
        if other := sorted(n for n in {*shapes, *first} if shapes.get(n) != first.get(n)):
            what = f"must be as in episodes[0], {first.get(other[0], 'where there is none')}"
            raise check.InvalidValue(f"shape of episodes[{k}].{other[0]}", shapes.get(other[0]), what)
    return found


def load_episodes(path: str | os.PathLike[str]) -> list[Episode]:
    """Read the episodes from a file of `save_episodes`; raise ValueError for a damaged file or another kind of file."""
    arrays = read_npz(path, "episodes")
    with check.in_file(path):
        for name in ("meta", "lengths", "observations", *STEPS):
            check.needed("", arrays, name, "these are no episodes of this package")
        text = str(check.arrays(arrays, {"meta": ("text", ())}, {})["meta"])
        meta = check.table_of("meta", from_json(text, "meta"))
        if meta.get("format") != FORMAT:
            raise check.InvalidValue("meta.format", meta.get("format"), f"must be {FORMAT}, which this version reads")
        given = check.sequence("meta.episodes", meta.get("episodes"), "tables")
        about = [_about(f"meta.episodes[{k}]", entry) for k, entry in enumerate(given)]
        return list(_cut(arrays, about))


def _about(path: str, entry: object) -> dict[str, Any]:
    """Validate the metadata of an episode; its environment's keywords are validated when the environment is made."""
    table = check.table_of(path, entry)
    check.known_keys(path, table, ABOUT)
    for name, read in ABOUT.items():
        value = check.needed(path, table, name, "every episode says it")
        if value is not None or name in ("env_id", "env_kwargs"):
            read(f"{path}.{name}", value)
    return table


def _state(path: str, value: object) -> None:
    """Raise InvalidValue unless the value is a state of a PCG64 generator."""
    generator: Any = np.random.PCG64()
    try:
        generator.state = check.table_of(path, value)
    except (ValueError, KeyError, TypeError, OverflowError):
        raise check.InvalidValue(path, value, "must be the state of a generator, PCG64") from None


ABOUT: Mapping[str, Callable[[str, Any], Any]] = {
    "env_id": check.text, "env_kwargs": check.table_of, "max_episode_steps": partial(check.integer, minimum=1),
    "seed": partial(check.integer, minimum=0), "generator": _state, "options": check.table_of,
}  # fmt: skip
"""Metadata of an episode in a file, by name, each with the function that validates it."""


def _cut(arrays: Mapping[str, Any], about: Sequence[Mapping[str, Any]]) -> Iterator[Episode]:
    """Validate the arrays of a file and yield its episodes."""
    sizes = {"episodes": len(about)}
    lengths = check.arrays(arrays, {"lengths": ("whole", ("episodes",))}, sizes)["lengths"].tolist()
    for k, length in enumerate(lengths):
        check.integer(f"lengths[{k}]", length, minimum=1)
    # T rows of actions and rewards per episode, T + 1 of observations and infos
    sizes |= {"sum of lengths": sum(lengths), "instants": sum(lengths) + len(lengths)}
    infos = {name: ("any", ("instants", "...")) for name in arrays if name.startswith("info_")}
    known = check.arrays(arrays, {**SERIES, **infos}, sizes)
    steps, instants = 0, 0
    for length, made in zip(lengths, about, strict=True):
        inner, outer = slice(steps, steps + length), slice(instants, instants + length + 1)
        yield Episode(
            **made, observations=known["observations"][outer], **{name: known[name][inner] for name in STEPS},
            infos={name.removeprefix("info_"): known[name][outer] for name in infos},
        )  # fmt: skip
        steps, instants = steps + length, instants + length + 1


SERIES: Mapping[str, tuple[str, check.Shape]] = {
    "observations": ("finite", ("instants", "entries")),
    "actions": ("number", ("sum of lengths", "joints")),  # nan is permitted: it ends an episode
    "rewards": ("finite", ("sum of lengths",)),
    **dict.fromkeys(("terminations", "truncations"), ("flag", ("sum of lengths",))),
}


def to_minari(episodes: Sequence[Episode], dataset_id: str, env_id: str | None = None, **about: Any) -> Any:
    """Create a Minari data set from episodes, in Minari's folder (environment variable MINARI_DATASETS_PATH).

    The function requires the extra `data`. Minari's own `DataCollector` would also require JAX.

    Args:
        episodes: episodes of one environment. dataset_id: for example "flexarm/slew/pd-v0". env_id: as in `replay`.
        about: keywords of `minari.create_dataset_from_buffers`, for example algorithm_name and author.
    Returns:
        The `minari.MinariDataset`, in which interrupted episodes are marked as truncated.
    Raises:
        ValueError: no episode, several environments, or an invalid id. ImportError: Minari is not installed.
    """
    with check.needs("a Minari data set", "minari h5py", "data"):
        import minari
        from minari.data_collector import EpisodeBuffer
    # the pattern also excludes paths
    if not re.fullmatch(r"([-\w]+/)*[-\w]+-v\d+", check.text("dataset_id", dataset_id)):
        raise check.InvalidValue("dataset_id", dataset_id, 'must be like "name-v0" or "space/name-v0"')
    first, *_ = episodes = _alike(episodes)
    made = [(e.env_id, e.env_kwargs, e.max_episode_steps) for e in episodes]
    for k, episode in enumerate(episodes):
        if made[k] != made[0]:
            raise ValueError(f"episodes[{k}]: of {episode.env_id} with other keywords than episodes[0]")
    buffers = []
    for k, episode in enumerate(episodes):
        truncations = episode.truncations.copy()
        truncations[-1] |= not episode.complete
        buffers.append(
            EpisodeBuffer(
                id=k, seed=episode.seed, options=None if episode.options is None else dict(episode.options),
                observations=episode.observations, actions=episode.actions, rewards=list(episode.rewards),
                terminations=list(episode.terminations), truncations=list(truncations),
                infos={name: value for name, value in episode.infos.items() if value.dtype.kind in "fiub"},
            )
        )  # fmt: skip
    with closing(_make_env(first, env_id)) as env:
        return minari.create_dataset_from_buffers(dataset_id, buffers, env=env, **about)


# ------------------------------------------------------ what JSON can hold
def _plain(path: str, value: Any) -> Any:
    """Return a value in JSON types; an arm or a scene becomes the text of its TOML file."""
    if isinstance(value, Arm):
        return {"arm.toml": arms.to_toml(value)}
    if isinstance(value, Scene):
        return {"scene.toml": value.to_toml()}
    if isinstance(value, Sensors):
        return _plain(path, sensors.to_table(value))
    if isinstance(value, Shape):
        return _plain(path, value.to_dict())
    if isinstance(value, Mapping):
        return {str(k): _plain(check.joined(path, str(k)), v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(f"{path}[{k}]", v) for k, v in enumerate(value)]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise check.InvalidValue(path, value, "must be numbers, texts, tables, an Arm or a Scene to be recorded")


def _restored(value: Any) -> Any:
    """Return the original value of a value that `_plain` converted to JSON types."""
    if isinstance(value, Mapping):
        if set(value) == {"arm.toml"}:
            text = check.text("arm.toml", value["arm.toml"]) + "\n"  # a text, not a file's name
            with check.under("arm.toml"):
                return arms.from_toml(text)
        if set(value) == {"scene.toml"}:
            text = check.text("scene.toml", value["scene.toml"]) + "\n"
            with check.under("scene.toml"):
                return Scene.from_toml(text)
        return {k: _restored(v) for k, v in value.items()}
    return [_restored(v) for v in value] if isinstance(value, list) else value
