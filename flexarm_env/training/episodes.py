"""Run a policy in episodes with fixed seeds, and measure success, settling time and vibration of each episode.

All episodes run together in one native vector environment. Episode i has seed `first + i` for every policy, so that
policies are compared on the same initial states, targets and arms.
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
from flexarm_env.episodes import History, Policy, measures, play
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


def judged_in(kwargs: Mapping[str, Any], asked: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Derive the environment keywords for evaluation or display from the keywords of training.

    Keywords that only training uses are omitted: `TRAINING_ONLY`, `randomization` and `lengths`.

    kwargs: keywords of training. asked: keywords from `user_keywords`, which are added; None means no keywords.
    """
    return {k: v for k, v in kwargs.items() if k not in (*TRAINING_ONLY, "randomization", LENGTHS)} | dict(asked or {})


def user_keywords(env_id: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Select the user's keywords `given` that are in `TRAINING_ONLY`; evaluation also uses the selected keywords.

    The result is {} for tasks of the suite, whose evaluation never changes.
    """
    if FROZEN in env_id:
        return {}
    return {k: v for k, v in given.items() if k in TRAINING_ONLY}


def validation(env_id: str, kwargs: Mapping[str, Any], asked: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Derive the environment keywords of the validation episodes from the keywords `kwargs` of training.

    Validation uses the user's reward weights if `asked` (`user_keywords`) contains them, and otherwise the
    environment's default weights. If training has a weight `cost`, this weight replaces `cost` in the default weights.
    The arm keeps its nominal link lengths, even if training draws them at random (`LENGTHS`).
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
    """Measures of n episodes (`flexarm_env.episodes.measures`), with one entry or one column per episode.

    Attributes:
        task, dt: task and control period, s, of the environment. success (n,), settled (n,), terminated (n,): whether
            an episode succeeded, settled, and ended early. settling (n,): settling time, s; the full duration if the
            tip never settled. vibration (n,): residual vibration, m. overshoot (n,): overshoot divided by the initial
            tip error. effort (n,): time integral of the sum of (torque / limit)^2 over the joints, s. returns (n,): sum
            of the rewards of each episode. errors (steps + 1, n): magnitude of the tip error at each instant, rad for
            the task slew, m for reach. way (n,): initial tip error, in the same unit.
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

    A range of `RANDOMIZED` that the arm does not support is omitted.
    """
    for key in ("id", "num_envs", "vectorization_mode"):
        if key in arguments:
            raise check.InvalidValue(f"env_kwargs.{key}", arguments[key], "must be left out: the program sets it")
    try:
        return make_registered(gym.make_vec, env_id, num_envs=n, vectorization_mode="vector_entry_point", **arguments)
    except check.InvalidValue as error:
        name = error.path.removeprefix("randomization.")
        if arguments.get("randomization") != RANDOMIZED or name not in RANDOMIZED:
            raise
        arguments["randomization"] = {key: pair for key, pair in RANDOMIZED.items() if key != name}  # it has none
    return make_episodes(env_id, n, **arguments)


def run(env: Any, policy: Policy, first: int = TEST) -> Episodes:
    """Run one episode in each of n native environments, with the seeds first to first + n - 1."""
    setup = Setup.of(env)
    history = History(*measures.EVERY, limit=int(env.unwrapped.plan.limit))
    play(env, policy, range(first, first + int(env.num_envs)), [history])
    errors = np.linalg.norm(measures.tip_errors(history, setup), axis=2)
    settling, settled = measures.settling_time(history, setup)
    return Episodes(
        task=setup.task, dt=setup.control_dt, success=measures.success(history), settling=settling, settled=settled,
        vibration=measures.residual_vibration(history, setup), overshoot=measures.overshoot(history, setup),
        effort=measures.effort(history, setup), returns=measures.returns(history), terminated=history.terminated,
        errors=errors, way=errors[0],
    )  # fmt: skip
