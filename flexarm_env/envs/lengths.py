"""Vector environments whose arms have links of different lengths.

All arms of a native vector environment share mesh and mass matrix, which depend on the links' lengths. Lengths can
therefore not be randomized in each episode as other parameters can. For arms of different lengths, `LengthsVectorEnv`
combines several native vector environments, one for each length, into one vector environment.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .. import arms
from .. import validation as check
from ..batch import OneAtATime, one_at_a_time
from ..bodies import RigidLink
from ..parameters import Arm
from ..sections import Link, Section, Taper
from ..validation import Array32
from .motion import is_table
from .single import checked_action
from .spec import CHANGEABLE, same
from .states import check_state
from .vector import VectorArmEnv, checked_mask, checked_seeds, chosen_of

Factor = float | Sequence[float]


def scaled(arm: Arm, factor: Factor) -> Arm:
    """Return the arm with its links' lengths multiplied by one factor for all links, or by a factor for each link.

    Positions along the link, at which sections or the curvature are defined, are scaled too. Sections, rigid ends, and
    mass and inertia of rigid links do not change.
    """
    given = factor if check.several(factor) else [factor] * arm.n_links
    factors = check.numbers("lengths", given, f"a number, or {arm.n_links} of them", arm.n_links, "", above=0.0)
    return dataclasses.replace(arm, links=tuple(map(_scaled_link, arm.links, factors)))


def _scaled_link(link: Link, factor: float) -> Link:
    """Return a link with its length and the positions of its sections and curvatures multiplied by a factor.

    The center of mass of a rigid link moves in proportion; its mass and inertia do not change.
    """
    if factor == 1.0:
        return link
    if isinstance(link, RigidLink):
        x, y, z = link.centre
        return dataclasses.replace(link, length=factor * link.length, centre=(factor * x, factor * y, factor * z))
    changes: dict[str, Any] = {}
    if not isinstance(link.section, Section | Taper):
        changes["section"] = tuple((factor * s, section) for s, section in link.section)
    if isinstance(link.curvature, tuple):
        changes["curvature"] = tuple((factor * s, value) for s, value in link.curvature)
    return dataclasses.replace(link, length=factor * link.length, **changes)


class LengthsVectorEnv(VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment of arms whose links have different lengths.

    Args:
        env_id: id of a registered environment. num_envs: number of arms, at least one for each length.
        lengths: list of factors on the links' lengths; each entry is a factor for all links, or a factor for each link.
            The first entry applies to the first arms, the next entry to the following arms, and so on; the numbers of
            arms per entry differ by at most one.
        keywords: keywords of the environment and of the vector environment (`autoreset_mode`, `threads`).
    Attributes:
        parts: the native vector environments, one for each entry of `lengths`. lengths: the argument `lengths`. plan:
            the attribute `plan` of the first vector environment.
    Raises:
        ValueError: there are fewer arms than lengths, a length is not positive, or the environment rejects a keyword.
    """

    def __init__(self, env_id: str, num_envs: int, lengths: Sequence[Factor], **keywords: Any) -> None:
        """Check the arguments (see the class) and make a native vector environment for each length."""
        self._door = OneAtATime()
        self.lengths = tuple(check.sequence("lengths", lengths, "at least one factor on lengths"))
        if not self.lengths:
            raise check.InvalidValue("lengths", lengths, "must hold at least one factor on lengths")
        n, count = check.integer("num_envs", num_envs, minimum=1), len(self.lengths)
        if n < count:
            raise check.InvalidValue("num_envs", n, f"must be at least {count}, one for each of `lengths`")
        spec = gym.spec(env_id)
        entry = spec.vector_entry_point
        creator: Any = load_env_creator(entry) if isinstance(entry, str) else None
        if not (isinstance(creator, type) and issubclass(creator, VectorArmEnv)):
            raise check.InvalidValue("env_id", env_id, "must be an environment of this package whose arm simulates")
        named = keywords.pop("arm", None) or spec.kwargs.get("arm") or creator.kind.arm
        arm, kind = arms.resolve(named), "vector_entry_point"
        self.parts: list[VectorArmEnv] = []
        for k, factor in enumerate(self.lengths):
            own, some = scaled(arm, factor), n // count + (k < n % count)
            made: Any = gym.make_vec(env_id, num_envs=some, vectorization_mode=kind, arm=own, **keywords)
            self.parts.append(made.unwrapped)
        first = self.parts[0]
        self.plan, self.metadata, self.render_mode = first.plan, first.metadata, first.render_mode
        self.num_envs, self.closed, self.spec = n, False, first.spec
        self.single_observation_space, self.single_action_space = (
            first.single_observation_space, first.single_action_space,
        )  # fmt: skip
        self.observation_space = batch_space(self.single_observation_space, n)
        self.action_space = batch_space(self.single_action_space, n)
        ends = np.cumsum([part.num_envs for part in self.parts]).tolist()
        self._slices = [(part, slice(end - part.num_envs, end)) for part, end in zip(self.parts, ends, strict=True)]

    @one_at_a_time
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start episodes of all arms, or of the arms in options["reset_mask"]; arm i has the seed seed + i or seed[i].

        Raises:
            ValueError: an argument is invalid; in this case no episode starts.
        """
        seeds = checked_seeds(seed, self.num_envs)
        chosen, rest = checked_mask(options, self.num_envs)
        mask = np.zeros(self.num_envs, np.bool_)
        mask[chosen] = True
        own_options = [self._options_of(own, rest) for _, own in self._slices]
        # reject options before any part starts
        for (part, own), more in zip(self._slices, own_options, strict=True):
            part.check_options(np.flatnonzero(mask[own]).tolist(), more)
        seen: list[Array32] = []
        infos: list[dict[str, Any]] = []
        for (part, own), more in zip(self._slices, own_options, strict=True):
            if not mask[own].any():
                seen.append(part.batch.observation.copy())
                infos.append({})
                continue
            if options is not None and "reset_mask" in options:
                more = {**(more or {}), "reset_mask": mask[own]}
            observation, info = part.reset(seed=seeds[own], options=more)
            seen.append(observation)
            infos.append(info)
        return np.concatenate(seen), self._joined(infos)

    def _options_of(self, own: slice, options: dict[str, Any] | None) -> dict[str, Any] | None:
        """Return the reset options of one part; of a list of `num_envs` motions, the part gets its arms' motions."""
        motion = (options or {}).get("motion")
        if not (isinstance(motion, list) and not is_table(motion) and len(motion) == self.num_envs > 1):
            return options
        some = motion[own]
        return {**(options or {}), "motion": some[0] if len(some) == 1 else some}

    @one_at_a_time
    def step(
        self, actions: Array32
    ) -> tuple[Array32, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance all arms by one control period."""
        checked = checked_action(actions, (self.num_envs, self.plan.arm.n_links))
        if any(part.autoreset_mode is AutoresetMode.DISABLED for part in self.parts):
            # a part that waits for its reset must stop the others, too
            ended = [own.start + i for part, own in self._slices for i in part.ended]
            if ended:
                raise ResetNeeded(f"Arms {ended} have ended: reset them with options['reset_mask']")
        out = [part.step(checked[own]) for part, own in self._slices]
        seen, reward, terminated, truncated = (np.concatenate([one[k] for one in out]) for k in range(4))
        return seen, reward, terminated, truncated, self._joined([one[4] for one in out])

    def _joined(self, infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Concatenate the infos of the parts to one info of all arms.

        If a part lacks a key, its values are zeros, or None, and its mask is False.
        """
        joined: dict[str, Any] = {}
        masks: dict[tuple[int, ...], tuple[list[Any], NDArray[Any]]] = {}  # most keys share one mask
        for key in dict.fromkeys(key for info in infos for key in info):
            known = next(info[key] for info in infos if key in info)
            if isinstance(known, Mapping):
                joined[key] = self._joined([info.get(key, {}) for info in infos])
                continue
            rows = [
                info[key] if key in info else np.full((part.num_envs, *known.shape[1:]), _blank(known), known.dtype)
                for info, part in zip(infos, self.parts, strict=True)
            ]
            if not key.startswith("_"):
                joined[key] = np.concatenate(rows)
                continue
            which = tuple(map(id, rows))
            if which not in masks:
                masks[which] = rows, np.concatenate(rows)
            joined[key] = masks[which][1]
        return joined

    def call(self, name: str, *args: Any, indices: Sequence[int] | None = None, **kwargs: Any) -> tuple[Any, ...]:
        """Return the results of a method, or the values of an attribute, for each arm or for the arms in `indices`."""
        chosen = chosen_of(indices, self.num_envs)
        if name == "get_state":
            return tuple(self.get_state(chosen))
        if name == "set_state":
            (states,) = (*args, *kwargs.values())
            self.set_state([states] * len(chosen) if isinstance(states, dict) else states, chosen)
            return (None,) * len(chosen)
        found = [value for part in self.parts for value in part.call(name, *args, **kwargs)]
        return tuple(found[i] for i in chosen)

    @one_at_a_time
    def get_state(self, indices: Sequence[int] | None = None) -> list[dict[str, Any]]:
        """Return a copy of the complete state of each arm, or of the arms in `indices`."""
        places = [self._place(i) for i in chosen_of(indices, self.num_envs)]
        return [part.get_state([i])[0] for part, i in places]

    @one_at_a_time
    def set_state(self, states: Sequence[dict[str, Any]], indices: Sequence[int] | None = None) -> None:
        """Set complete states that `get_state` of this or an equal environment returned."""
        chosen = chosen_of(indices, self.num_envs)
        if not check.several(states) or len(states) != len(chosen):
            given = f"{len(states)} states" if check.several(states) else states
            raise check.InvalidValue("states", given, f"must be {len(chosen)}, one for each arm")
        places = [self._place(i) for i in chosen]
        # reject a state before any arm changes
        for (part, _), state in zip(places, states, strict=True):
            check_state(part.batch, state)
        for part in self.parts:
            some = [(state, i) for (owner, i), state in zip(places, states, strict=True) if owner is part]
            if some:
                part.set_state([state for state, _ in some], [i for _, i in some])

    def _place(self, i: int) -> tuple[VectorArmEnv, int]:
        """Return the part that contains arm i, and the arm's number in this part."""
        part, own = next((part, own) for part, own in self._slices if i < own.stop)
        return part, i - own.start

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of all arms; only the attribute `starts` can be set.

        values: one value, or a list with one value per arm; arms with links of equal length must have the same value.
        """
        check.choice("name", name, CHANGEABLE)
        each = list(values) if check.several(values) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise check.InvalidValue(name, values, f"must be one value, or {self.num_envs}, one for each arm")
        for _, own in self._slices:
            first, *others = each[own]
            if not all(one is first or same(one, first) for one in others):
                raise check.InvalidValue(name, values, "must be one value for all arms of a length")
        for part, own in self._slices:
            setattr(part, name, each[own.start])

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture (height, width, 3) uint8 of each arm in "rgb_array" mode."""
        frames = [part.render() for part in self.parts]
        return None if any(frame is None for frame in frames) else tuple(one for some in frames for one in some or ())

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments of all lengths."""
        for part in self.parts:
            part.close()


def _blank(known: NDArray[Any]) -> Any:
    """Return the array entry that represents an arm without a value."""
    return None if known.dtype == object else 0
