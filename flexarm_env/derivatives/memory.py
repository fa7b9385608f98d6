"""Observations that depend on the past: delayed or stacked observations, and readings of sensors with memory.

If observations depend on the past, a state contains the latest `frames` observations of E entries each, the oldest
first. A delayed observation is the oldest stored observation. A control period removes the oldest stored observation
and appends a new observation. All other stored observations only change their places in the state, so their derivatives
in the Jacobian are ones.
"""

from typing import Any

import numpy as np

from .. import validation as check
from ..runtime.layout import record_sizes
from ..tasks.program import RECORD
from ..validation import Array


class Memory:
    """Stored previous observations of the arms of a batch, which are part of the arms' states.

    Args:
        batch: the `Batch` of arms.
        moving: number X of a state's entries that change with time, without stored observations.
    Attributes:
        chosen: array (E,), indices of the observed entries.
        size: length O of an observation.
        moving: X plus the number of stored entries of previous observations.
        frames: number of observations stored in a state; 0 if no observation needs to be stored.
    """

    def __init__(self, batch: Any, moving: int) -> None:
        extras, selection = batch.extras, batch.extras.selection
        self.chosen = np.arange(batch.entries) if selection is None else selection.chosen
        self.entries, shown = len(self.chosen), 1 if selection is None else selection.frames
        if extras.sensors is not None and extras.sensors.drawn is not None:
            what = "must be one number if derivatives are computed: all arms must have the same delay"
            raise check.InvalidValue("sensors.delay", tuple(batch.period * k for k in extras.sensors.drawn), what)
        self._age = 0 if extras.sensors is None else extras.sensors.age
        remembered = extras.instruments is not None or self._age > 0 or shown > 1
        self.frames, self.size = self._age + shown if remembered else 0, shown * self.entries
        self._batch, self._first, self.moving = batch, moving, moving + self.frames * self.entries

    def names(self, own: tuple[str, ...]) -> tuple[str, ...]:
        """Insert the names of the stored observations into the names `own` of a state's other entries."""
        seen = tuple(f"seen[{k}]" for k in range(self.frames * self.entries))
        return own[: self._first] + seen + own[self._first :]

    # --- states ----------------------------------------------------------------------------------
    def parts(self, state: Array) -> tuple[Array, Array]:
        """Split states (n, S) into two arrays: all entries except stored observations, and the stored observations."""
        x, y = self._first, self.moving
        if self.frames == 0:
            return state, state[:, x:y]
        return np.concatenate([state[:, :x], state[:, y:]], axis=1), state[:, x:y]

    def joined(self, own: Array, past: Array) -> Array:
        """Combine entries `own` and stored observations `past` to states (n, S); the inverse of `parts`."""
        if self.frames == 0:
            return own
        return np.concatenate([own[:, : self._first], past, own[:, self._first :]], axis=1)

    def with_past(self, own: Array, first: int = 0) -> Array:
        """Combine entries `own` and the batch's stored observations to states. first: index of the first arm."""
        if self.frames == 0:
            return own
        batch, late = self._batch, np.zeros((len(own), self._age, self.entries))
        at = RECORD.offsets(0, *record_sizes(batch.task, batch.entries, batch.extras)).seen
        for i in range(len(own) if self._age else 0):
            memory = batch.record(first + i)[at : at + self._age * batch.entries].reshape(self._age, -1)
            late[i] = memory[::-1, self.chosen]
        told = batch.observation[first : first + len(own)]
        return self.joined(own, np.concatenate([told, late.reshape(len(own), -1)], axis=1))

    def shown(self, past: Array) -> Array:
        """Return the observation (n, O) that the stored observations `past` determine."""
        return past[:, : self.size].copy()

    def after(self, past: Array, seen: Array) -> tuple[Array, Array]:
        """Append new entries `seen` (n, E) to the stored observations `past`; return new `past` and observation."""
        if self.frames == 0:
            return past, seen
        past = np.concatenate([past[:, self.entries :], seen], axis=1)
        return past, self.shown(past)

    # --- derivatives -----------------------------------------------------------------------------
    def whole(self, moved: Array) -> Array:
        """Add rows and columns for the stored observations to the Jacobian of a control period.

        The result has the shape (n, X + O + 1, X + A), where X includes the stored entries.
        """
        if self.frames == 0:
            return moved
        x, y, entries = self._first, self.moving, self.entries
        actions = moved.shape[2] - x
        full = np.zeros((len(moved), y + self.size + 1, y + actions))

        def put(rows: slice, own: Array) -> None:
            full[:, rows, :x], full[:, rows, y:] = own[:, :, :x], own[:, :, x:]

        put(slice(0, x), moved[:, :x])
        older = np.arange(x, y - entries)
        full[:, older, older + entries] = 1.0
        put(slice(y - entries, y), moved[:, x : x + entries])
        full[:, y : y + self.size] = full[:, x : x + self.size]
        put(slice(y + self.size, y + self.size + 1), moved[:, -1:])
        return full

    def vjp(self, state: Array, seen: Array) -> tuple[Array, Array, Array]:
        """Split the derivatives of a scalar by states (n, S) and observations (n, O) after a control period.

        Returns three arrays: derivatives by the state's entries without stored observations, by the observations stored
        before the period, and by the entries of the new observation.
        """
        own, past = self.parts(state)
        if self.frames == 0:
            return own, past, seen
        past = past.copy()
        past[:, : self.size] += seen
        before = np.concatenate([np.zeros((len(past), self.entries)), past[:, : -self.entries]], axis=1)
        return own, before, past[:, -self.entries :]
