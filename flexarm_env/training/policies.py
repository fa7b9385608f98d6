"""Policies by the words that a command line takes: controllers, controllers with gains of one's own, runs, files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import control
from flexarm_env.control import NumpyPolicy, Setup, load_policy
from flexarm_env.control.catalogue import gains_from
from flexarm_env.files import read_toml
from flexarm_env.training.export_policy import numpy_policy
from flexarm_env.training.runs import load_model, read_run


@dataclass(frozen=True)
class Chosen:
    """A policy before it meets its environment.

    name: to be shown. env_id, env_kwargs: the environment it is made for, and its keywords ("" and {}: any). make:
    environment -> Policy.
    """

    name: str
    env_id: str
    env_kwargs: Mapping[str, Any]
    make: Callable[[Any], Any]


class TorchPolicy:
    """A Stable-Baselines3 model with its normaliser, as a Policy; one of RecurrentPPO remembers since the beginning."""

    def __init__(self, model: Any, normaliser: Any) -> None:
        self.model, self.normaliser = model, normaliser
        self.memory: Any = None
        self.first: Any = None

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Forget."""
        self.memory, self.first = None, np.ones(observation.shape[:-1] or 1, bool)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Deterministic actions."""
        seen = observation if self.normaliser is None else self.normaliser.normalize_obs(observation)
        action, self.memory = self.model.predict(seen, self.memory, self.first, deterministic=True)
        self.first = np.zeros(observation.shape[:-1] or 1, bool)
        return np.asarray(action, np.float32)


def acting(model: Any, meta: Mapping[str, Any], normaliser: Any) -> NumpyPolicy | TorchPolicy:
    """A model as a Policy: for NumPy alone where that can be."""
    if hasattr(model.policy, "lstm_actor"):
        return TorchPolicy(model, normaliser)
    return numpy_policy(model, meta, normaliser)


def choose(word: str, env_id: str) -> Chosen:
    """What a word names. ValueError with a sentence for a word that names nothing, or what cannot be read."""
    word = word.strip()
    if not word:
        raise ValueError("--policy: must name at least one, or several with commas between them")
    if word in control.NAMES:
        return Chosen(word, "", {}, lambda env: control.make(word, env))
    name, _, file = word.partition("@")
    if file and name in control.NAMES:
        gains = _gains(name, Path(file))
        return Chosen(f"{name}@{Path(file).stem}", "", {}, lambda env: control.make(name, env, gains))
    path = Path(word)
    if path.is_dir() and not (path / "policy.npz").is_file():
        return _from_model(path, env_id)
    if not path.exists() and word not in control.policy_names():
        known = ", ".join((*control.NAMES, *control.policy_names()))
        raise ValueError(f"--policy {word}: no such run folder or file, and not one of {known}")
    policy = load_policy(word)
    _same_env(word, policy.meta["env_id"], env_id)
    name = path.name if path.suffix != ".npz" else path.stem
    return Chosen(name, env_id, policy.meta["env_kwargs"], lambda env: policy.check(Setup.of(env)))


def _gains(name: str, path: Path) -> Any:
    try:
        tables, _ = read_toml(path)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    if not isinstance(tables.get(name), dict):
        raise ValueError(f"{path}: no table [{name}]; it has {', '.join(tables) or 'none'}")
    return gains_from(name, tables[name])


def _from_model(run: Path, env_id: str) -> Chosen:
    record = read_run(run)
    _same_env(str(run), record["env_id"], env_id)
    model, normaliser = load_model(run, record["algorithm"])

    def make(env: Any) -> TorchPolicy:
        layout = Setup.of(env).layout
        if layout != record["layout"]:
            raise ValueError(f"{run}: trained on observation layout {record['layout']}; this environment's is {layout}")
        return TorchPolicy(model, normaliser)

    return Chosen(run.name, env_id, record["env_kwargs"], make)


def _same_env(word: str, trained: str, env_id: str) -> None:
    if trained != env_id:
        raise ValueError(f"--policy {word}: trained on {trained}, not on {env_id}")
