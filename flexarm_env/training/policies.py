"""Find the policy that a command-line argument names; evaluate a Stable-Baselines3 model during training."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.control import NamedPolicy, NumpyPolicy, find_policy
from flexarm_env.training.episodes import judged_in
from flexarm_env.training.export_policy import numpy_policy


class TorchPolicy:
    """`Policy` that evaluates a Stable-Baselines3 model with its VecNormalize statistics.

    A policy of RecurrentPPO has a memory, which `reset` clears.
    """

    def __init__(self, model: Any, normaliser: Any) -> None:
        """Store the model and its normalizer, with an empty memory."""
        self.model, self.normaliser = model, normaliser
        self.memory: Any = None
        self.first: Any = None

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Clear the memory of the policy."""
        self.memory, self.first = None, np.ones(observation.shape[:-1] or 1, bool)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute deterministic actions (n, N) or (N,) in [-1, 1]."""
        seen = observation if self.normaliser is None else self.normaliser.normalize_obs(observation)
        action, self.memory = self.model.predict(seen, self.memory, self.first, deterministic=True)
        self.first = np.zeros(observation.shape[:-1] or 1, bool)
        return np.asarray(action, np.float32)


def acting(model: Any, meta: Mapping[str, Any], normaliser: Any) -> NumpyPolicy | TorchPolicy:
    """Convert a model to a `NumpyPolicy`, or wrap it as a `TorchPolicy` if the conversion is not possible."""
    if hasattr(model.policy, "lstm_actor"):
        return TorchPolicy(model, normaliser)
    return numpy_policy(model, meta, normaliser)


def choose(word: str, env_id: str) -> NamedPolicy:
    """Find the policy that a name denotes, for an environment.

    Raises ValueError if the policy was trained on another environment.
    """
    if not word.strip():
        raise ValueError("--policy: must name at least one, or several with commas between them")
    found = find_policy(word)
    if found.env_id and found.env_id != env_id:
        raise ValueError(f"--policy {word}: trained on {found.env_id}, not on {env_id}")
    return dataclasses.replace(found, env_kwargs=judged_in(found.env_kwargs, found.asked))
