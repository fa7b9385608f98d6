"""Read measured runs: the columns of a CSV file that a `Config` names, converted to SI units."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexarm_env.files import csv_lines, listed
from flexarm_env.validation import LARGEST, shown

from ..validation import Array
from .config import Channel, Config

UNEVEN = 0.02
"""Accepted deviation of instants from even spacing, divided by the sampling interval."""

SATURATED = 4
"""Number of consecutive samples at a column's extreme value that indicates a saturated sensor."""


@dataclass(frozen=True)
class Run:
    """Log of one measured run, in SI units.

    stem: file name without extension. t (n,): instants, s, evenly spaced, beginning at 0.
    inputs, outputs: values (n,) of each channel by name.
    kept (n,): True for the samples that are compared with predictions.
    """

    stem: str
    t: Array
    inputs: dict[str, Array]
    outputs: dict[str, Array]
    kept: NDArray[np.bool_]

    def until(self, share: float) -> Run:
        """Return the shortest initial part of the run that contains the fraction `share` of the readings' variance."""
        # cumulative squared deviation of all readings
        power = np.zeros(len(self.t))
        for y in self.outputs.values():
            own = np.where(self.kept, y - y[self.kept].mean(), 0.0) ** 2
            power += own / own.sum()
        # at least 20 samples after the first change of each reading: an encoder may count nothing for a while
        moved = [int(np.argmax(self.kept & (y != y[self.kept][0]))) for y in self.outputs.values()]
        n = max(int(np.searchsorted(np.cumsum(power), share * power.sum())), max(moved) + 20) + 1
        inputs, outputs = ({name: x[:n] for name, x in of.items()} for of in (self.inputs, self.outputs))
        return Run(self.stem, self.t[:n], inputs, outputs, self.kept[:n])

    @property
    def period(self) -> float:
        """Sampling interval, s."""
        return float(self.t[-1] / (len(self.t) - 1))


class BadLog(ValueError):
    """Raised for an unusable log; the message names the file, the column and the row."""


def read_run(path: str | os.PathLike[str], config: Config) -> Run:
    """Read and validate the run in a CSV file.

    Messages count rows as in the file: row 1 contains the names of the columns. Raises BadLog for an unusable log, and
    OSError if the file cannot be read.
    """
    header, lines = csv_lines(path)
    where = os.fspath(path)
    channels = (config.time, *config.inputs, *config.outputs)
    for channel in channels:
        if header.count(channel.column) != 1:
            have = listed(header)
            raise BadLog(f"{where}: column {channel.column!r} ({channel.name}) must exist once; columns: {have}")
    if len(lines) < 20:
        raise BadLog(f"{where}: {len(lines)} rows of numbers are too few (at least 20)")
    for i, line in enumerate(lines):
        if any(cell.strip() for cell in line[len(header) :]):
            what = f"row {i + 2} has {len(line)} cells, and the header {len(header)}: are there commas in numbers?"
            raise BadLog(f"{where}: {what}")
    # numbers, an exactly even time axis, and channels in SI
    columns = {c.name: _numbers(where, header.index(c.column), c, lines) for c in channels}
    t = columns[config.time.name] * config.time.factor
    period = _even(where, config.time.column, t)
    t = np.asarray(np.arange(len(t)) * period, np.float64)
    inputs = {c.name: _prepared(where, c, columns[c.name], t) for c in config.inputs}
    outputs = {c.name: _prepared(where, c, columns[c.name], t) for c in config.outputs}
    # the initial `skip` seconds are not compared
    kept = t >= config.skip
    if kept.sum() < 20:
        raise BadLog(f"{where}: {t[-1]:.3g} s long, of which the first {config.skip:g} s are skipped: nothing is left")
    for channel in config.outputs:
        _moves(where, channel, columns[channel.name], kept)
    return Run(Path(path).name.removesuffix(".gz").removesuffix(".csv"), t, inputs, outputs, kept)


def _numbers(where: str, k: int, channel: Channel, lines: list[list[str]]) -> Array:
    """Return the numbers (n,) of column k; raise BadLog for a cell that is not a finite number."""
    values = np.empty(len(lines))
    for i, line in enumerate(lines):
        cell = line[k].strip() if k < len(line) else ""
        try:
            values[i] = float(cell)
        except ValueError:
            values[i] = np.nan
        if not abs(values[i]) <= LARGEST:
            what = f"is no finite number of at most {LARGEST:g}"
            raise BadLog(f"{where}: column {channel.column!r}, row {i + 2}: {shown(cell)} {what}")
    return values


def _even(where: str, column: str, t: Array) -> float:
    """Return the sampling interval, s, of the instants t (n,), s; raise BadLog unless they are evenly spaced."""
    steps = np.diff(t)
    bad = np.flatnonzero(steps <= 0.0)
    if len(bad):
        i = int(bad[0])
        what = "repeats" if steps[i] == 0.0 else "lies before"
        raise BadLog(f"{where}: column {column!r}, row {i + 3}: the time {t[i + 1]:g} s {what} that of the row before")
    period = float(np.median(steps))
    if period < 1.0 / LARGEST:
        what = f"samples are {period:g} s apart, which must be at least {1.0 / LARGEST:g} s"
        raise BadLog(f"{where}: column {column!r}: {what}")
    bad = np.flatnonzero(steps > 1.5 * period)
    if len(bad):
        i = int(bad[0])
        gap = f"a gap of {steps[i]:.4g} s where samples are {period:.4g} s apart"
        raise BadLog(f"{where}: column {column!r}, row {i + 3}: {gap}; cut the log there")
    off = np.abs(t - t[0] - np.arange(len(t)) * (t[-1] - t[0]) / (len(t) - 1))
    if off.max() > max(UNEVEN, 1e-6) * len(t) ** 0.5 * period:
        i = int(off.argmax())
        raise BadLog(f"{where}: column {column!r}, row {i + 2}: samples are not evenly spaced; resample the log")
    return float((t[-1] - t[0]) / (len(t) - 1))


def _prepared(where: str, channel: Channel, values: Array, t: Array) -> Array:
    """Convert a channel's values to SI, filter them, and shift them in time.

    values (n,): values of the column. t (n,): instants, s.
    """
    values = channel.factor * (values - (channel.offset or 0.0))
    period = t[1]
    if abs(channel.shift) >= t[-1]:
        what = f"shift = {channel.shift:g} s must be shorter than the log, {t[-1]:.4g} s"
        raise BadLog(f"{where}: column {channel.column!r}: {what}")
    if channel.low_pass is not None:
        from scipy.signal import butter, sosfiltfilt

        if not 1.0 / t[-1] < channel.low_pass < 0.5 / period:
            ends = f"{1.0 / t[-1]:.4g} Hz, one period in the log, and {0.5 / period:.4g} Hz, half the rate of samples"
            what = f"low_pass = {channel.low_pass:g} Hz must be between {ends}"
            raise BadLog(f"{where}: column {channel.column!r}: {what}")
        # zero-phase low-pass
        values = sosfiltfilt(butter(2, channel.low_pass, fs=1.0 / period, output="sos"), values)
    return np.asarray(np.interp(t + channel.shift, t, values) if channel.shift else values)


def _moves(where: str, channel: Channel, values: Array, kept: NDArray[np.bool_]) -> None:
    """Reject a column that never changes, or that stays at an extreme value because the sensor is saturated."""
    if np.ptp(values[kept]) == 0.0:
        since = "" if kept.all() else " where it is compared"
        raise BadLog(f"{where}: column {channel.column!r} never changes from {values[-1]:g}{since}")
    # saturation: a plateau at the extreme value reached at high speed
    change = np.abs(np.diff(values))
    least, most = change[change > 0.0].min(), change.max()
    for end in (values.max(), values.min()):
        at = np.flatnonzero(values == end)
        for i in at[: len(at) - SATURATED + 1]:
            j = i + SATURATED - 1
            if values[j] != end or not (values[i : j + 1] == end).all() or (i > 0 and values[i - 1] == end):
                continue
            steep = change[i - 2] if i >= 2 else 0.0
            # a true peak would have slowed down before
            if steep > 20.0 * least and steep > 0.1 * most:
                what = (
                    f"the value {end:g} stands for {SATURATED} samples and more: the sensor is at the end of its range"
                )
                raise BadLog(f"{where}: column {channel.column!r}, row {i + 2}: {what}")
