"""Control periods in a row, and derivatives through all of them: forwards (`jvp`) and backwards (`vjp`)."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..validation import Array
from .period import Periods, checked


class Outcome(NamedTuple):
    """Of n arms over T control periods, or how much it changes: states (T + 1, n, S), the first of them the start's;
    observations (T, n, O) and rewards (T, n), after each period."""

    states: Array
    observations: Array
    rewards: Array


class Gradient(NamedTuple):
    """By the states at the start (n, S) and by the actions (T, n, A)."""

    state: Array
    actions: Array


@dataclass(frozen=True)
class Rollout:
    """T control periods of n arms under given actions.

    States alone are kept, from which each period's derivative is computed anew when it is asked for. Nothing ends here:
    `failed` and `past` say where an environment would have ended an episode; an arm whose solver failed has NaN from
    there on. A rollout lies within one episode: no derivative passes a reset.

    Attributes:
        arms: what moves. states (T + 1, n, S), the first those of the start; actions (T, n, A); observations (T, n, O)
        and rewards (T, n) after each period; failed, past (T, n): the solver failed, a joint was beyond its limits.
    """

    arms: Periods
    states: Array
    actions: Array
    observations: Array
    rewards: Array
    failed: NDArray[np.bool_]
    past: NDArray[np.bool_]

    def jvp(self, state: Any = None, actions: Any = None) -> Outcome:
        """What changes of the start's states (n, S) and of the actions (T, n, A) come to, to first order."""
        count = len(self.actions)
        moved = np.zeros_like(self.states)
        moved[0] = _given("state", state, self.states[0].shape)
        turned = _given("actions", actions, self.actions.shape)
        seen, paid = np.zeros_like(self.observations), np.zeros_like(self.rewards)
        for k in range(count):
            period = self.arms.jacobians(self.states[k], self.actions[k])
            moved[k + 1], seen[k], paid[k] = period.jvp(moved[k], turned[k])
        return Outcome(moved, seen, paid)

    def vjp(self, states: Any = None, observations: Any = None, rewards: Any = None) -> Gradient:
        """The gradient of a number whose gradient by all that came of it is given; None: it does not depend on that.

        Args:
            states (T + 1, n, S), observations (T, n, O), rewards (T, n). For the sum of rewards, discounted or not, the
                weight of each: `vjp(rewards=weights)`.
        """
        by_states = _given("states", states, self.states.shape)
        by_seen = _given("observations", observations, self.observations.shape)
        by_paid = _given("rewards", rewards, self.rewards.shape)
        by_actions, by_state = np.zeros_like(self.actions), by_states[-1]
        for k in reversed(range(len(self.actions))):
            back, by_actions[k] = self.arms.vjp(self.states[k], self.actions[k], by_state, by_seen[k], by_paid[k])
            by_state = back + by_states[k]
        return Gradient(by_state, by_actions)


def rollout(arms: Periods, state: Any, actions: Any) -> Rollout:
    """Where arms go from states (n, S) under actions (T, n, A), clipped to +-1; see `Rollout`."""
    start = _given("state", state, (arms.n, arms.state_size))
    given = check.floats("actions", actions)
    if given.ndim != 3 or given.shape[1:] != (arms.n, arms.action_size):
        raise check.InvalidValue("actions.shape", given.shape, f"must be (T, {arms.n}, {arms.action_size})")
    wrong = np.argwhere(~np.isfinite(given))
    if len(wrong):
        at = ", ".join(map(str, wrong[0]))
        raise check.InvalidValue(f"actions[{at}]", given[tuple(wrong[0])], "must be finite")
    count = len(given)
    states = np.zeros((count + 1, *start.shape))
    seen, paid = np.zeros((count, arms.n, arms.observation_size)), np.zeros((count, arms.n))
    failed, past = np.zeros((count, arms.n), np.bool_), np.zeros((count, arms.n), np.bool_)
    states[0] = start
    for k in range(count):
        states[k + 1], seen[k], paid[k] = arms.step(states[k], given[k])
        failed[k], past[k] = arms.failed, arms.past
    return Rollout(arms, states, given.copy(), seen, paid, failed, past)


def _given(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    return np.zeros(shape) if value is None else checked(name, value, shape)
