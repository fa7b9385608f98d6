"""Differentiable control periods of an environment's arms."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator

from .. import validation as check
from ..validation import Array
from .period import Jacobians, Periods
from .places import checked
from .rollouts import Rollout, rollout


class Part(NamedTuple):
    """Group of arms of an environment that are advanced together.

    read, write: indices of the arms' rows in input arrays and in output arrays.
    periods: the `Periods` object that advances the arms.
    places: positions of these arms' state entries in a complete state.
    """

    read: Any
    write: Any
    periods: Periods
    places: Any = None


_STATE_OF = {"step": (0, "state"), "jacobians": (0, "state"), "vjp": (0, "state_bar"), "observe_jacobian": (1, "")}
"""For each method: index of the result whose length is that of a state, and the argument from which its missing entries
are copied."""


class Arms(Periods):
    """n arms of an environment, advanced by one control period at a time, with exact derivatives.

    A state is an array of numbers that determine the arm's future. A period gives bitwise the same results as the
    environment, except that actions are float64. Episodes do not end, and nothing is random: sensors have no noise, and
    delays have no jitter. If the environment has pushes, a state contains one push: the present push or, between
    pushes, the next push. The caller handles time limits, joint limits and resets. If the solver fails, the results are
    NaN.

    Args:
        id: id of an environment of this package.
        n: number of arms.
        threads: largest number of threads; None: the default of the vector environment.
        parameters: True to add parameters of the arm to the state, so that derivatives by parameters are available.
            The parameters are payload mass and inertia, factors on EI (in space also on EI_y and GJ), tau_d, and the
            factor on the torque constant. Joints that are not ideal have further parameters: stiffness, damping, rotor,
            friction and backlash (`stiffness[0]`, ...). In a state, parameters follow the entries that change with
            time, and precede stored observations.
        keywords: keyword arguments of the environment and of its solver.
    Attributes:
        n: number of arms.
        state_size: number S of entries of a state.
        action_size: number A of entries of an action.
        observation_size: number O of entries of an observation.
        observation_space, action_space: Gymnasium spaces of one arm.
        moving: number X of entries at the beginning of a state that change with time or have derivatives. All other
            entries, such as targets and the number of periods, are treated as constants.
        names: names of a state's entries.
        failed: array (n,), True for arms whose solver failed in the last call.
        past: array (n,), True for arms with a joint beyond its limits at the end of the last call.
    Raises:
        ValueError: the environment belongs to another package, a size is invalid, or a feature has no derivatives:
            `reward.cost`; prescribed motions together with `step_tolerance`; prescribed motions of different joints in
            different arms together with `multipliers`.
    """

    def __init__(
        self, id: str, n: int, *, threads: int | None = None, parameters: bool = False, **keywords: Any
    ) -> None:
        kind: Any = gym.spec(check.text("id", id, empty=False)).vector_entry_point
        kind = load_env_creator(kind) if isinstance(kind, str) else kind
        made_of = [base.__module__.partition(".")[0] for base in getattr(kind, "__mro__", ())]
        if kind is None or (made_of and __name__.partition(".")[0] not in made_of):
            raise check.InvalidValue("id", id, "must be of an environment of this package, such as FlexibleArm-v0")
        made: Any = gym.make_vec(
            id, num_envs=check.integer("n", n, minimum=1), threads=threads,
            vectorization_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT, **keywords,
        ).unwrapped  # fmt: skip
        self.environment = made
        if "cost" in made.plan.kind.rewards:
            raise check.InvalidValue("reward.cost", keywords["reward"]["cost"], "must be left out: costs jump")
        if any(name.startswith("previous_action") for name in made.plan.names):
            what = "must not be observed here: states do not contain actions"
            raise check.InvalidValue("observation", "previous_action", what)
        self.observation_space, self.action_space = made.single_observation_space, made.single_action_space
        self._parts: list[Part] = []
        self._led: list[Any] = []
        self.parameters = check.flag("parameters", parameters)
        if made.plan.motion is None:
            super().__init__(made.batch, self.parameters)
        else:
            self._not_fitted()
            made.reset()  # the motions' arms are models of their own
            self._arrange()

    def reset(self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> Array:
        """Start episodes as the vector environment does with this seed and these options; return the states (n, S).

        With prescribed motions, states also contain accelerations and torques. A reset can therefore change the
        attributes `names`, `moving` and `state_size`.
        """
        if (options or {}).get("motion") is not None:
            self._not_fitted()
        self.environment.reset(seed=seed, options=options)
        return self.states()

    # --- arms that follow motions ------------------------------------------------------------------
    def _not_fitted(self) -> None:
        tolerance = self.environment.plan.settings.step_tolerance
        if tolerance is not None:
            what = "must be None with prescribed motions, whose derivatives are of equal steps from kink to kink"
            raise check.InvalidValue("step_tolerance", tolerance, what)

    def _arrange(self) -> None:
        """Make one part for each arm that follows a prescribed motion, and one part for all other arms."""
        batch, guides, had = self.environment.batch, self.environment.guides, self._parts
        self._parts, self._led = [], list(guides.values())
        for part in had:
            part.periods.close()
        if not guides:
            if had:
                super().__init__(batch, self.parameters)
            return
        everyone = np.arange(self.environment.num_envs)
        parts = [
            Part(everyone[i : i + 1], everyone[i : i + 1], Periods(batch, self.parameters, True, (i, guide)))
            for i, guide in sorted(guides.items())
        ]
        others = [i for i in everyone.tolist() if i not in guides]
        if others:  # they move in the batch, where one of them stands in for those that follow motions
            shown = np.array([others[0] if i in guides else i for i in everyone.tolist()])
            parts.insert(0, Part(shown, everyone, Periods(batch, self.parameters, True)))
        first = max((part.periods for part in parts), key=lambda periods: periods.state_size)
        if any(part.periods.names[: part.periods.moving] != first.names[: first.moving] for part in parts):
            what = "must prescribe the same joints to all arms with multipliers=True, where each is a coordinate more"
            raise check.InvalidValue("options.motion", "given", what)
        self._parts = [
            part._replace(places=np.array([first.names.index(name) for name in part.periods.names])) for part in parts
        ]
        self.n, self.backwards, self.names, self.moving = len(everyone), False, first.names, first.moving
        self.state_size, self.action_size = first.state_size, first.action_size
        self.observation_size = first.observation_size
        self.failed, self.past = np.zeros(self.n, np.bool_), np.zeros(self.n, np.bool_)
        self.step_ends = None

    def _each(self, name: str, **rows: Any) -> Any:
        """Call a method of each part and combine the results; rows: arguments of the method, arrays (n, ...)."""
        widths = {"action": (self.action_size,), "observation_bar": (self.observation_size,), "reward_bar": ()}
        given = {key: checked(key, x, (self.n, *widths.get(key, (self.state_size,)))) for key, x in rows.items()}
        made: list[Array] = []
        kind: Any = None
        for read, write, part, places in self._parts:
            own = [x[read][:, places] if key in ("state", "state_bar") else x[read] for key, x in given.items()]
            found = getattr(part, name)(*own)
            kind, several = type(found), list(found) if isinstance(found, tuple) else [found]
            if name in _STATE_OF:
                k, source = _STATE_OF[name]
                whole = np.zeros((*several[k].shape[:-1], self.state_size))
                if source:
                    whole[...] = given[source][read]
                whole[..., places] = several[k]
                several[k] = whole
            made = made or [np.empty((self.n, *x.shape[1:])) for x in several]
            for into, x in zip(made, several, strict=True):
                into[write] = x
            self.failed[write], self.past[write] = part.failed, part.past
        return Jacobians(*made) if kind is Jacobians else tuple(made) if len(made) > 1 else made[0]

    def states(self) -> Array:
        """Return the present states (n, S) of the environment's arms."""
        if self._led != [*self.environment.guides.values()]:
            self._arrange()
        if not self._parts:
            return super().states()
        rows = np.zeros((self.n, self.state_size))
        for _, write, part, places in self._parts:
            rows[np.ix_(write, places)] = part.states()
        return rows

    def observe(self, state: Array) -> Array:
        """Return the observations (n, O) of states (n, S)."""
        return self._each("observe", state=state) if self._parts else super().observe(state)

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Return state (n, S), observation (n, O) and reward (n,) after one control period.

        The action (n, A) is clipped to +-1.
        """
        return self._each("step", state=state, action=action) if self._parts else super().step(state, action)

    def rollout(self, state: Array, actions: Array) -> Rollout:
        """Advance states (n, S) by T periods with actions (T, n, A); return a `Rollout` with derivatives."""
        return rollout(self, state, actions)

    def jacobians(self, state: Array, action: Array) -> Jacobians:
        """Return the results of `step` and their derivatives. Derivatives by a clipped action are zero."""
        return self._each("jacobians", state=state, action=action) if self._parts else super().jacobians(state, action)

    def vjp(
        self, state: Array, action: Array, state_bar: Array, observation_bar: Array, reward_bar: Array,
        step_ends: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return a scalar's derivatives by the state (n, S) before a control period and by the period's action (n, A).

        state_bar (n, S), observation_bar (n, O), reward_bar (n,): derivatives of the scalar by state, observation and
        reward after the control period ("cotangents"). step_ends: attribute `step_ends` after this step, or None.
        """
        if not self._parts:
            return super().vjp(state, action, state_bar, observation_bar, reward_bar, step_ends)
        bars = {"state_bar": state_bar, "observation_bar": observation_bar, "reward_bar": reward_bar}
        back: tuple[Array, Array] = self._each("vjp", state=state, action=action, **bars)
        return back

    def observe_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return the observations (n, O) of states (n, S), and their derivatives (n, O, S)."""
        return self._each("observe_jacobian", state=state) if self._parts else super().observe_jacobian(state)

    def close(self) -> None:
        """Stop the threads that advance the arms."""
        for part in self._parts:
            part.periods.close()
        if not self._parts:
            super().close()
        self.environment.close()
