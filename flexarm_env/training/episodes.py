"""Fixed episodes of an environment under a policy, and performance measures.

All episodes run together in one native vector environment. Episode i has seed `first + i` for every policy, so that
policies are compared on the same starts, targets and arms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.control import Setup
from flexarm_env.envs.ids import make_registered
from flexarm_env.suite.judge import Policy
from flexarm_env.validation import Array

FROZEN = "flexarm/"
"""Prefix of the suite's task ids, after the package's name."""

TEST, VALIDATION, TUNING = 10_000, 20_000, 30_000
"""First seeds of the episodes for three purposes: evaluation, model selection in training, tuning of controllers."""

RANDOMIZED: dict[str, list[float]] = {"payload": [0.5, 2.0], "EI": [0.7, 1.3]}
"""Ranges of the factors on payload and bending stiffness in randomized episodes."""

LENGTHS = "lengths"
"""Keyword of training environments for arms of several lengths (`envs.lengths`)."""

TRAINING_ONLY = ("duration", "reward", "reward_terms")
"""Environment keywords that hyper-parameter files set for training only. Evaluation uses the environment's own values,
or those of the user."""

SLEW_BAND, SLEW_BAND_LEAST, REACH_BAND = 0.02, float(np.radians(0.5)), 0.02
"""Bands of a settled tip: share of the slew angle; minimum of this band, rad; share of the arm's length (reach)."""


def judged_in(kwargs: Mapping[str, Any], asked: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the environment keywords for evaluation or display, given those of training.

    asked: the user's own keywords, see `user_keywords`; None: no such keywords.
    """
    return {k: v for k, v in kwargs.items() if k not in (*TRAINING_ONLY, "randomization", LENGTHS)} | dict(asked or {})


def user_keywords(env_id: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the user's own keywords among `TRAINING_ONLY`; evaluation uses them too.

    The result is None for tasks of the suite, whose evaluation never changes.
    """
    if FROZEN in env_id:
        return {}
    return {k: v for k, v in given.items() if k in TRAINING_ONLY}


def validation(env_id: str, kwargs: Mapping[str, Any], asked: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the environment keywords of the validation episodes, given those of training.

    The reward is the user's (`user_keywords`), otherwise the environment's own, with the price `cost` of the training
    if it has one. The arm has its own link lengths, even if training draws them (`LENGTHS`).
    """
    left_out = (*TRAINING_ONLY, LENGTHS)
    judged, reward = {k: v for k, v in kwargs.items() if k not in left_out}, kwargs.get("reward")
    judged |= dict(asked or {})
    if "reward" in judged:
        return judged
    if isinstance(reward, Mapping) and "cost" in reward:
        own = make_registered(gym.spec, env_id.rpartition(":")[2]).kwargs.get("reward", {})
        judged["reward"] = own | {"cost": reward["cost"]}
    return judged


@dataclass(frozen=True)
class Episodes:
    """Results of n episodes, one entry or column each; errors in rad (slew) or m (reach).

    Attributes:
        task, dt: task and control period, s, of the environment. success (n,), settled (n,), terminated (n,): whether
            an episode succeeded, settled, and ended early. settling (n,): settling time, s; the full duration if the
            tip never settled. vibration (n,): m. overshoot (n,): share of the initial error. effort (n,): s. returns
            (n,): returns. errors (steps + 1, n): tip errors over time. way (n,): initial error.
    """

    task: str
    dt: float
    success: NDArray[np.bool_]
    settling: Array
    settled: NDArray[np.bool_]
    vibration: Array
    overshoot: Array
    effort: Array
    returns: Array
    terminated: NDArray[np.bool_]
    errors: Array
    way: Array


def make_episodes(env_id: str, n: int, /, **arguments: Any) -> Any:
    """Create the vector environment with n arms in which `run` runs its episodes.

    Default randomization ranges that the arm does not support are dropped.
    """
    for key in ("id", "num_envs", "vectorization_mode"):
        if key in arguments:
            raise check.InvalidValue(f"env_kwargs.{key}", arguments[key], "must be left out: it is the program's own")
    try:
        return make_registered(gym.make_vec, env_id, num_envs=n, vectorization_mode="vector_entry_point", **arguments)
    except check.InvalidValue as error:
        name = error.path.removeprefix("randomization.")
        if arguments.get("randomization") != RANDOMIZED or name not in RANDOMIZED:
            raise
        arguments["randomization"] = {key: pair for key, pair in RANDOMIZED.items() if key != name}  # it has none
    return make_episodes(env_id, n, **arguments)


def run(env: Any, policy: Policy, first: int = TEST) -> Episodes:
    """Run one episode in each environment of a native vector environment; the seeds are first, first + 1, ...."""
    plain = env.unwrapped
    setup, limit, n = Setup.of(env), int(plain.plan.limit), int(env.num_envs)
    lengths = np.array([link.span for link in setup.arm.links])
    limits = np.array(setup.torque_limits)
    observation, info = env.reset(seed=first)
    policy.reset(observation)
    alive, success = np.ones(n, bool), np.zeros(n, bool)
    returns, effort = np.zeros(n), np.zeros(n)
    miss = _miss(setup, info, np.zeros((n, 2)))
    # tip errors and deflections over time, nan after an early end
    misses = np.full((limit + 1, *miss.shape), np.nan)
    bends = np.full((limit + 1, n, setup.n_joints), np.nan)
    last = np.full(n, limit)
    misses[0], bends[0] = miss, _bend(setup, info, n) * lengths
    for k in range(1, limit + 1):
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        miss = _miss(setup, info, miss)
        misses[k, alive] = miss[alive]
        bends[k, alive] = (_bend(setup, info, n) * lengths)[alive]
        # only episodes that are still running count
        returns += np.where(alive, reward, 0.0)
        # effort: integral of the squared torques over their limits
        load = np.sum((info["joint_torque"].reshape(n, -1) / limits) ** 2, axis=1) * setup.control_dt
        effort += np.where(alive, load, 0.0)
        ended = alive & (terminated | truncated)
        # a terminated episode is no success
        success[ended] = info["is_success"][ended] & ~terminated[ended]
        last[ended] = np.where(terminated[ended], k, last[ended])
        alive &= ~ended
        if not alive.any():
            break
    # measures of whole episodes
    early = last < limit
    errors = np.linalg.norm(misses, axis=2)
    settling, settled = _settling(setup, errors, early)
    return Episodes(
        task=setup.task, dt=setup.control_dt, success=success, settling=settling, settled=settled,
        vibration=_vibration(bends, last, round(1.0 / setup.control_dt)), overshoot=_overshoot(misses),
        effort=effort, returns=returns, terminated=early, errors=errors, way=errors[0],
    )  # fmt: skip


def _miss(setup: Setup, info: Mapping[str, Any], before: Array) -> Array:
    """Return target minus tip: (n, 1), rad, or (n, 2), m in inertial axes.

    Angles are unwrapped relative to the previous result `before`.
    """
    if setup.task == "slew":
        tip = np.arctan2(info["tip_position"][:, 1], info["tip_position"][:, 0])
        # choose the turn nearest to the previous value
        turns = (info["target"] - tip - before[:, 0]) / (2.0 * np.pi)
        miss: Array = (before[:, 0] + 2.0 * np.pi * (turns - np.round(turns)))[:, None]
        return miss
    miss = info["target"] - info["tip_position"]
    return miss


def _bend(setup: Setup, info: Mapping[str, Any], n: int) -> Array:
    """Return tip deflections divided by length, (n, N); in space their magnitudes."""
    bend: Array = np.asarray(info["tip_deflection"]).reshape(n, -1, setup.n_joints)
    return bend[:, 0] if bend.shape[1] == 1 else np.asarray(np.linalg.norm(bend, axis=1))


def reach_band(setup: Setup) -> float:
    """Return the largest distance of a settled tip from its target, m."""
    return REACH_BAND * setup.arm.total_length


def _settling(setup: Setup, errors: Array, early: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return settling times (n,), s, and whether each episode settled (n,).

    A settled error stays in its band to the end. errors (steps + 1, n): tip errors. early (n,): terminated early.
    Unsettled episodes have the full duration.
    """
    steps = len(errors) - 1
    band = np.maximum(SLEW_BAND * errors[0], SLEW_BAND_LEAST) if setup.task == "slew" else reach_band(setup)
    # NaN after an early end counts as outside
    outside = ~(errors <= band)
    # index after the last sample outside the band
    since = np.where(outside.any(axis=0), len(errors) - np.argmax(outside[::-1], axis=0), 0)
    settled = (since <= steps) & ~early
    return np.where(settled, since, steps) * setup.control_dt, settled


def _vibration(bends: Array, last: NDArray[np.int64], window: int) -> Array:
    """Return half the peak-to-peak tip deflection, m, over the last `window` periods (1 s).

    Of several links the largest value counts. bends (steps + 1, n, N): m. last (n,): final step of each episode.
    """
    out = np.empty(len(last))
    for i, end in enumerate(last):
        tail = bends[max(0, end - window) : end + 1, i]
        out[i] = 0.5 * np.max(tail.max(axis=0) - tail.min(axis=0))
    return out


def _overshoot(misses: Array) -> Array:
    """Return the largest excursion beyond the target along the initial direction, (n,), over the initial error.

    misses (steps + 1, n, 1 or 2): target minus tip.
    """
    way = np.linalg.norm(misses[0], axis=1)
    # component of the miss against the initial direction
    beyond = -np.nansum(misses * (misses[0] / np.maximum(way, 1e-12)[:, None]), axis=2)
    share: Array = np.maximum(beyond.max(axis=0), 0.0) / np.maximum(way, 1e-12)
    return share
