"""Measures of recorded episodes: one value per episode, from a `History`.

The page docs/measures.md lists the measures. The argument `setup` contains data of the environment and is created by
`control.Setup.of(env)`. Each docstring names the entries of `info` that the history must contain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..validation import Array
from .history import History

if TYPE_CHECKING:
    from ..control import Setup

SLEW_BAND, SLEW_BAND_LEAST, REACH_BAND = 0.02, float(np.radians(0.5)), 0.02
"""Largest errors of a settled tip: share of the slew angle; smallest error band of a slew, rad; share of the arm's
length (reach)."""

LAST = 1.0
"""Duration, s, of the end of an episode in which `residual_vibration` is measured."""

TIP = ("tip_position", "target")
"""Entries of `info` that the measures of the tip's error need."""

EVERY = ("is_success", "cost", *TIP, "tip_deflection", "joint_torque")
"""Entries of `info` that all measures together need."""


# ------------------------------------------------------------------ reward, cost, success
def returns(history: History) -> Array:
    """Return the sum of the rewards of each episode, (n,)."""
    return _sum(history.rewards)


def cost(history: History) -> Array:
    """Return the sum of info["cost"] over each episode, (n,); 0 for environments without costs."""
    if not history.has("cost"):
        return np.zeros(len(history.seeds))
    return _sum(np.where(history.running, history.info("cost")[1:], 0.0))


def success(history: History) -> NDArray[np.bool_]:
    """Return (n,) bool: True if info["is_success"] is true at the end of an episode that was not terminated early."""
    good, last = history.info("is_success"), history.lengths
    return np.asarray(good[last, np.arange(len(last))], np.bool_) & ~history.terminated


def success_period(history: History) -> NDArray[np.int64]:
    """Return the first control period (n,), counted from 1, after which info["is_success"] stays true; 0: no success.

    info["is_success"] is true if the task's success bounds have been met for a time that the task defines.
    """
    failed = ~history.info("is_success")[1:].astype(bool) & history.running
    # the success at the end began one period after the last period without success
    last = np.where(failed.any(axis=0), len(failed) - np.argmax(failed[::-1], axis=0), 0)
    return np.where(success(history), last + 1, 0)


def effort(history: History, setup: Setup) -> Array:
    """Return the time integral (n,), s, of the sum of (torque / limit)^2 over the joints, from info["joint_torque"]."""
    torque, (periods, n) = history.info("joint_torque")[1:], history.rewards.shape
    share = torque.reshape(periods, n, -1) / np.array(setup.torque_limits)
    return _sum(np.where(history.running, np.sum(share**2, axis=2) * setup.control_dt, 0.0))


def _sum(rows: Array) -> Array:
    """Return the sums (n,) of rows (T, n) over time, added in order of time: the same bits for any number of
    episodes.
    """
    # + 0.0: no negative zeros
    total: Array = np.cumsum(rows, axis=0)[-1] + 0.0
    return total


# ------------------------------------------------------------------ the tip
def tip_errors(history: History, setup: Setup) -> Array:
    """Return target minus tip position at each instant: (T + 1, n, 1), rad, for slews, else (T + 1, n, 2 or 3), m.

    Positions are in inertial axes; angles are not wrapped at +-pi. The history must contain the tip's position (`TIP`).
    After the end of an episode the errors are nan.
    """
    tip, target = history.info("tip_position"), history.info("target")
    if setup.task != "slew":
        return np.asarray(target - tip)
    miss, last = np.empty((*tip.shape[:2], 1)), np.zeros(tip.shape[1])
    for k, (place, goal) in enumerate(zip(tip, target, strict=True)):
        # choose the turn nearest to the previous value
        turns = (goal - np.arctan2(place[:, 1], place[:, 0]) - last) / (2.0 * np.pi)
        last = last + 2.0 * np.pi * (turns - np.round(turns))
        miss[k, :, 0] = last
    return miss


def settling_band(setup: Setup, way: Array | float) -> Array:
    """Return the largest tip error (m; rad for slews) that counts as settled. way: slew angle of each episode, rad."""
    if setup.task == "slew":
        return np.maximum(SLEW_BAND * np.asarray(way), SLEW_BAND_LEAST)
    return np.full(np.shape(way), REACH_BAND * setup.arm.total_length)


def settling_time(history: History, setup: Setup) -> tuple[Array, NDArray[np.bool_]]:
    """Return settling times (n,), s, and flags (n,) that are True for episodes that settled.

    From the settling time to the end of the episode, the tip error does not exceed `settling_band`. If an episode does
    not settle or is terminated early, its settling time is the full duration of T periods. The history must contain the
    tip's position (`TIP`).
    """
    errors = np.linalg.norm(tip_errors(history, setup), axis=2)
    steps = len(errors) - 1
    # nan after an early end counts as outside
    outside = ~(errors <= settling_band(setup, errors[0]))
    # index after the last sample outside the band
    since = np.where(outside.any(axis=0), len(errors) - np.argmax(outside[::-1], axis=0), 0)
    settled = (since <= steps) & ~history.terminated
    return np.where(settled, since, steps) * setup.control_dt, settled


def overshoot(history: History, setup: Setup) -> Array:
    """Return the overshoot (n,): the tip's largest distance beyond the target, divided by the initial error.

    The distance beyond the target is measured along the initial error. The history must contain the tip's position
    (`TIP`).
    """
    misses = tip_errors(history, setup)
    way = np.linalg.norm(misses[0], axis=1)
    # component of the miss against the initial direction
    beyond = -np.nansum(misses * (misses[0] / np.maximum(way, 1e-12)[:, None]), axis=2)
    share: Array = np.maximum(beyond.max(axis=0), 0.0) / np.maximum(way, 1e-12)
    return share


def residual_vibration(history: History, setup: Setup) -> Array:
    """Return half the peak-to-peak tip deflection (n,), m, in the last second of each episode.

    For several links the result is the largest value of all links. In space both components of the deflection are
    combined to a magnitude. The history must contain info["tip_deflection"].
    """
    relative, joints = history.info("tip_deflection"), setup.n_joints
    bend: Any = relative.reshape(*relative.shape[:2], -1, joints)
    bend = bend[:, :, 0] if bend.shape[2] == 1 else np.linalg.norm(bend, axis=2)
    bend = bend * np.array([link.span for link in setup.arm.links])
    window, found = round(LAST / setup.control_dt), np.empty(bend.shape[1])
    for i, end in enumerate(history.lengths):
        tail = bend[max(0, end - window) : end + 1, i]
        found[i] = 0.5 * np.max(tail.max(axis=0) - tail.min(axis=0))
    return found
