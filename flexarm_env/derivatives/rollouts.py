"""Rollouts of several control periods, with derivatives in forward (`jvp`) and reverse (`vjp`) mode."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..validation import Array
from .period import Differentiable
from .places import checked


class Outcome(NamedTuple):
    """Tangents of the results of a rollout, which `Rollout.jvp` returns.

    states (T + 1, n, S), the initial states first; observations (T, n, O); rewards (T, n).
    """

    states: Array
    observations: Array
    rewards: Array


class Gradient(NamedTuple):
    """Gradient of a scalar by the initial states (n, S) and the actions (T, n, A)."""

    state: Array
    actions: Array


@dataclass(frozen=True)
class Rollout:
    """T control periods of n arms under given actions.

    Only states and results are stored; `jvp` and `vjp` compute the derivatives of each period from the stored states.
    Episodes do not end; `failed` and `past` are True for periods at which the environment would end the episode. After
    a failure of the solver an arm's results are NaN.

    Attributes:
        arms: the arms, an object with the methods of `Differentiable`.
        states: array (T + 1, n, S), the initial states, then the states after each period.
        actions: array (T, n, A), the actions of all periods.
        observations, rewards: arrays (T, n, O) and (T, n), results of each period.
        failed: array (T, n), True if the solver failed in this period.
        past: array (T, n), True if a joint was beyond its limits at the end of this period.
        step_ends: attribute `step_ends` of the arms after each period, or () if the arms have none.
    """

    arms: Differentiable
    states: Array
    actions: Array
    observations: Array
    rewards: Array
    failed: NDArray[np.bool_]
    past: NDArray[np.bool_]
    step_ends: tuple[Any, ...] = ()

    def jvp(self, state: Any = None, actions: Any = None) -> Outcome:
        """Return the tangents of the rollout's results for tangents of initial states and actions.

        state (n, S), actions (T, n, A): tangents of the initial states and of the actions; None means zero.
        """
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
        """Return the gradient of a scalar function of the results by initial states and actions.

        Args:
            states: gradient of the scalar by the states, (T + 1, n, S); None means zero.
            observations: gradient of the scalar by the observations, (T, n, O); None means zero.
            rewards: gradient of the scalar by the rewards, (T, n); None means zero. If the scalar is a weighted sum of
                rewards, `rewards` is the array of weights.
        """
        by_states = _given("states", states, self.states.shape)
        by_seen = _given("observations", observations, self.observations.shape)
        by_paid = _given("rewards", rewards, self.rewards.shape)
        by_actions, by_state = np.zeros_like(self.actions), by_states[-1]
        for k in reversed(range(len(self.actions))):
            more: dict[str, Any] = {"step_ends": self.step_ends[k]} if self.step_ends else {}
            back, by_actions[k] = self.arms.vjp(
                self.states[k], self.actions[k], by_state, by_seen[k], by_paid[k], **more
            )
            by_state = back + by_states[k]
        return Gradient(by_state, by_actions)


def rollout(arms: Differentiable, state: Any, actions: Any) -> Rollout:
    """Advance states (n, S) by T periods with actions (T, n, A), clipped to +-1; return the `Rollout`."""
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
    step_ends: list[Any] = []
    for k in range(count):
        states[k + 1], seen[k], paid[k] = arms.step(states[k], given[k])
        failed[k], past[k] = arms.failed, arms.past
        if (ends := getattr(arms, "step_ends", None)) is not None:
            step_ends.append(ends)
    return Rollout(arms, states, given.copy(), seen, paid, failed, past, tuple(step_ends))


def _given(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    return np.zeros(shape) if value is None else checked(name, value, shape)
