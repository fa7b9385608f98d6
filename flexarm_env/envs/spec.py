"""Gymnasium specs of environments, with the length of episodes."""

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
"""Namespace of the ids of frozen tasks."""
FREE = (
    "duration", "max_episode_steps", "reward", "reward_terms", "info_level", "render_mode", "threads", "autoreset_mode",
    "num_envs", "vectorization_mode", "vector_kwargs", "wrappers",
)  # fmt: skip
"""Keywords of a frozen task that may change without a warning: options of training, of creation and of display."""

CHANGEABLE = ("starts",)
"""Keywords that are also attributes of the environment, which the user may set between episodes."""


class ArmSpec(EnvSpec):
    """EnvSpec whose `max_episode_steps` is the number of control periods in the environment's `duration`.

    Wrappers read the length of an episode from `max_episode_steps`. The environment truncates its episodes itself. If
    Gymnasium creates an environment from this spec, the spec passes the user's limit, or None if the user gave no
    limit. With None, no TimeLimit wrapper can end episodes too early if the new environment has a longer `duration`.
    """

    given: int | None = None
    own: int | None = None

    @classmethod
    def of(cls, spec: EnvSpec | None, limit: int) -> ArmSpec | None:
        """Return the spec of `gymnasium.make` with episodes of at most `limit` control periods."""
        if spec is None:
            return None
        made = cls(**{field.name: getattr(spec, field.name) for field in dataclasses.fields(spec) if field.init})
        made.given, made.own = spec.given if isinstance(spec, cls) else spec.max_episode_steps, limit
        return made

    @property
    def max_episode_steps(self) -> int | None:
        """Number of control periods after which an episode is truncated."""
        if sys._getframe(1).f_code in MAKERS:
            return self.given
        return self.own if self.given is None or self.own is None else min(self.given, self.own)

    @max_episode_steps.setter
    def max_episode_steps(self, value: int | None) -> None:
        self.given = value


def changed(spec: EnvSpec) -> list[str]:
    """Return the names of the keywords that differ from those of the suite task with the same id."""
    if spec.namespace != FROZEN or spec.id not in registry:
        return []
    own = registry[spec.id].kwargs
    return sorted(name for name in spec.kwargs if name not in FREE and not same(spec.kwargs[name], own.get(name)))


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal; False if they contain arrays."""
    try:
        return bool(one == other)
    except ValueError:
        return False


warned: set[tuple[str, ...]] = set()


class Specified:
    """Base class of single and vector environments, with plan, spaces of one arm and spec."""

    kind: ClassVar[Kind]
    plan: Plan
    batch: Batch
    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012
    _spec: ArmSpec | None = None

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Give the class a signature that contains every keyword, for `help` and completion."""
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
        """Ranges of initial states and targets, in the form of the keyword `starts`; {} for the default ranges.

        You can set the attribute at any time, for example in a curriculum; new ranges apply from the next reset on.
        """
        return self._starts or {}

    @starts.setter
    def starts(self, ranges: Any) -> None:
        """Set the ranges of initial states and targets, from the next reset on."""
        self.plan = with_starts(self.plan, ranges)
        self._starts = ranges
        self.batch.set_starts(self.plan.starts)
        if self._spec is not None:
            self._spec.kwargs = {**self._spec.kwargs, "starts": ranges}
        self._rebind()

    def _rebind(self) -> None:
        """Renew the references to the batch's arrays after the arrays were replaced."""

    @property
    def spec(self) -> Any:
        """Spec that `gymnasium.make` has set, with the length of episodes; None without `make`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Store a registered spec; warn once if the keywords of a suite task differ from those of the frozen task."""
        if spec is not None and (own := changed(spec)) and (spec.id, *own) not in warned:
            warned.add((spec.id, *own))
            text = f"{spec.id} with {', '.join(own)} changes the task: its scores do not count in the suite"
            warnings.warn(text, UserWarning, stacklevel=3)
        self._spec = ArmSpec.of(spec, self.plan.limit)
