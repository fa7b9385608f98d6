"""Record episodes as arrays, from which measures are computed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..validation import Array
from .loop import Instant


class History:
    """Recorder of n episodes: rewards, ends, actions and entries of `info` as arrays.

    T is the number of periods of the longest episode, or `limit` if this is larger. After the end of an episode,
    rewards are 0, flags are False, and actions and other floating-point entries are nan.

    Args:
        names: entries of `info` to record; entries that the environment does not have are omitted. limit: smallest
            number T of rows. actions: True to record the actions, too.
    """

    def __init__(self, *names: str, limit: int = 0, actions: bool = False) -> None:
        self.names, self.limit, self._with_actions = names, limit, actions
        # one block for each episode, or for each n episodes of a vector environment: rows by name
        self._blocks: list[dict[str, list[NDArray[Any]]]] = []
        self._seeds: list[int | None] = []
        self._joined: dict[str, NDArray[Any]] = {}

    def __call__(self, instant: Instant) -> None:
        """Store an instant that the generator `periods` yields."""
        running = np.atleast_1d(instant.running)
        if instant.period == 0:
            self._blocks.append({})
            self._seeds += list(instant.seeds)
        block, single = self._blocks[-1], np.ndim(instant.running) == 0
        row = {f"info.{name}": instant.info[name] for name in self.names if name in instant.info}
        if instant.period > 0:
            row |= {"rewards": instant.reward, "running": running, "terminated": instant.terminated}
            if self._with_actions:
                row["actions"] = instant.action
        for name, value in row.items():
            rows = np.array(value)[None] if single and name != "running" else np.array(value)
            if not running.all():
                rows[~running] = 0.0 if name == "rewards" else _empty(rows)
            # an entry that `reset` does not return
            if name not in block and name.startswith("info.") and instant.period > 0:
                block[name] = [np.full_like(rows, _empty(rows))]
            block.setdefault(name, []).append(rows)
        self._joined.clear()

    @classmethod
    def of(cls, *episodes: Any, limit: int = 0) -> History:
        """Create the history of recorded episodes (`flexarm_env.recording.Episode`) of one environment."""
        found = cls(*episodes[0].infos, limit=limit, actions=True)
        for episode in episodes:
            infos = [{k: v[at] for k, v in episode.infos.items()} for at in range(len(episode) + 1)]
            seeds = [episode.seed]
            found(Instant(seeds, 0, None, None, 0.0, False, False, infos[0], True))
            for k in range(len(episode)):
                ends = bool(episode.terminations[k]), bool(episode.truncations[k])
                found(Instant(seeds, k + 1, episode.actions[k], None, episode.rewards[k], *ends, infos[k + 1], True))
        return found

    def _array(self, name: str) -> NDArray[Any]:
        """Return the rows (T, n, ...) of a recorded array for all n episodes; of an entry of `info` (T + 1, n, ...)."""
        if name not in self._joined:
            longest = max([self.limit, *(len(block.get("rewards", ())) for block in self._blocks)])
            rows = longest + name.startswith("info.")
            filler = 0.0 if name == "rewards" else None
            parts = [_padded(np.array(block[name]), rows, filler) for block in self._blocks if name in block]
            if not parts:
                known = ", ".join(key.removeprefix("info.") for key in self._blocks[0]) if self._blocks else "nothing"
                raise check.InvalidValue("history", name.removeprefix("info."), f"was not recorded; recorded: {known}")
            self._joined[name] = np.concatenate(parts, axis=1)
        return self._joined[name]

    @property
    def seeds(self) -> tuple[int | None, ...]:
        """Seeds of the n episodes; None for an episode without a seed."""
        return tuple(self._seeds)

    @property
    def rewards(self) -> Array:
        """Rewards of the control periods, (T, n)."""
        return self._array("rewards")

    @property
    def actions(self) -> Array:
        """Actions of the control periods, (T, n, joints)."""
        return self._array("actions")

    @property
    def running(self) -> NDArray[np.bool_]:
        """Array (T, n) bool: True for control periods of an episode, False for periods after its end."""
        return np.asarray(self._array("running"), np.bool_)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Number of control periods of each episode, (n,)."""
        return np.asarray(self.running.sum(axis=0), np.int64)

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """Array (n,) bool: True for episodes that were terminated by a failure, such as a joint beyond its limit."""
        return np.asarray(self._array("terminated").any(axis=0), np.bool_)

    def info(self, name: str) -> NDArray[Any]:
        """Return an entry of `info`, (T + 1, n, ...), with the start in row 0. An entry that was not recorded raises
        ValueError.
        """
        return self._array(f"info.{name}")

    def has(self, name: str) -> bool:
        """Return whether an entry of `info` was recorded."""
        return any(f"info.{name}" in block for block in self._blocks)


def _padded(rows: NDArray[Any], count: int, filler: Any) -> NDArray[Any]:
    """Return `count` rows: the given rows, then rows of `filler` (None: the value of `_empty`)."""
    more = np.full((count - len(rows), *rows.shape[1:]), _empty(rows) if filler is None else filler, rows.dtype)
    return np.concatenate([rows, more])


def _empty(rows: NDArray[Any]) -> Any:
    """Return the value that marks missing entries of an array: nan, None, "", 0 or False."""
    return np.nan if rows.dtype.kind == "f" else np.zeros((), rows.dtype)[()] if rows.dtype.kind != "O" else None
