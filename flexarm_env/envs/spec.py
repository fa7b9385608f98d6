"""Specs of created environments, which include the length of episodes."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, registry
from gymnasium.spaces import Box

from ..batch import Batch
from .keywords import Keywords, signature_of
from .options import Plan, plan, with_starts
from .task import Kind

MAKERS = (gym.make.__code__, gym.make_vec.__code__)
FROZEN = "flexarm"
"""Namespace of ids that name a frozen task."""
FREE = (
    "duration", "max_episode_steps", "reward", "reward_terms", "info_level", "render_mode", "threads", "autoreset_mode",
    "num_envs", "vectorization_mode", "vector_kwargs", "wrappers",
)  # fmt: skip
"""Keywords of a frozen task that need no warning: what training is free to choose, and how it is made and shown."""

CHANGEABLE = ("starts",)
"""Keywords that are attributes, too, which may be set while an environment is used."""


class ArmSpec(EnvSpec):
    """An EnvSpec whose `max_episode_steps` is the number of control periods in the environment's `duration`.

    Wrappers can read the length of an episode from it. `gymnasium.make` and `make_vec`, when they make the
    environment again, get the limit that was given, or None: the environment ends its episodes itself, and a TimeLimit
    around another one made with a longer `duration` would cut them short.
    """

    given: int | None = None
    own: int | None = None

    @classmethod
    def of(cls, spec: EnvSpec | None, limit: int) -> ArmSpec | None:
        """Return the spec of `gymnasium.make` for episodes of at most `limit` control periods."""
        if spec is None:
            return None
        made = cls(**{field.name: getattr(spec, field.name) for field in dataclasses.fields(spec) if field.init})
        made.given, made.own = spec.given if isinstance(spec, cls) else spec.max_episode_steps, limit
        return made

    @property
    def max_episode_steps(self) -> int | None:
        """Control periods of an episode."""
        if sys._getframe(1).f_code in MAKERS:
            return self.given
        return self.own if self.given is None or self.own is None else min(self.given, self.own)

    @max_episode_steps.setter
    def max_episode_steps(self, value: int | None) -> None:
        self.given = value


def changed(spec: EnvSpec) -> list[str]:
    """Return the keywords by which a made suite task differs from the frozen one."""
    if spec.namespace != FROZEN or spec.id not in registry:
        return []
    own = registry[spec.id].kwargs
    return sorted(name for name in spec.kwargs if name not in FREE and not same(spec.kwargs[name], own.get(name)))


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal; arrays inside count as different."""
    try:
        return bool(one == other)
    except ValueError:
        return False


warned: set[tuple[str, ...]] = set()


class Specified:
    """Common base of single and vector environments: plan, spaces of one arm, spec."""

    kind: ClassVar[Kind]
    plan: Plan
    batch: Batch
    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012
    _spec: ArmSpec | None = None

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Give the class a signature that names every keyword, for `help` and completion."""
        super().__init_subclass__(**arguments)
        cls.__signature__ = signature_of(cls.__init__, plan)  # type: ignore[attr-defined]

    def _prepare(self, arguments: Keywords) -> tuple[Any, Any]:
        """Check the arguments and store the plan; return the spaces of one arm's actions and observations."""
        self.plan = plan(self.kind, **arguments)
        self._starts = arguments.get("starts")
        self.render_mode = self.plan.render_mode
        self.metadata = self.metadata | {"render_fps": max(1, round(1.0 / self.plan.period))}
        bounds = self.plan.observation_bounds
        return Box(-1.0, 1.0, (self.plan.arm.n_links,), np.float32), Box(-bounds, bounds, dtype=np.float32)

    @property
    def starts(self) -> Any:
        """Ranges of fresh starts, as the keyword of the environment; {} for the usual ones.

        They may be set at any time, as in a curriculum: the next reset draws from them.
        """
        return self._starts or {}

    @starts.setter
    def starts(self, ranges: Any) -> None:
        """Draw fresh starts from other ranges, from the next reset on."""
        self.plan = with_starts(self.plan, ranges)
        self._starts = ranges
        self.batch.set_starts(self.plan.starts)
        if self._spec is not None:
            self._spec.kwargs = {**self._spec.kwargs, "starts": ranges}
        self._rebind()

    def _rebind(self) -> None:
        """Renew references to the batch's arrays after they were replaced."""

    @property
    def spec(self) -> Any:
        """The spec set by `gymnasium.make`, with the episodes' length; None without it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Store a registered spec; warn once where a suite task was made with other keywords than its own."""
        if spec is not None and (own := changed(spec)) and (spec.id, *own) not in warned:
            warned.add((spec.id, *own))
            text = f"{spec.id} with {', '.join(own)} of one's own is another task: its scores are not the suite's"
            warnings.warn(text, UserWarning, stacklevel=3)
        self._spec = ArmSpec.of(spec, self.plan.limit)
