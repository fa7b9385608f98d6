"""Hyper-parameters from files in RL Zoo's format: one entry an environment id.

Beside the entries a file may hold a table `env_kwargs`, keyed by id as well: keywords of the environment that these
hyper-parameters are for. RL Zoo passes it over; there, the same goes after `--env-kwargs`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flexarm_env import validation as check
from flexarm_env.validation import LARGEST

sys.modules.setdefault("agents.config", sys.modules[__name__])  # as pickles of older run folders name it

_PLACES = [Path(__file__).resolve().parents[k] / name for k, name in ((1, "data/configs"), (2, "configs"))]
HOME = next((place for place in _PLACES if place.is_dir()), _PLACES[0])
"""The files that come with the package, which a checkout has at its top."""

ZOO = ("n_envs", "n_timesteps", "normalize", "policy")
"""Keys that are no argument of the algorithm's class."""

NORMALIZED = ("norm_obs", "norm_reward", "clip_obs", "clip_reward", "gamma", "epsilon")
"""Keywords of VecNormalize."""
WHOLE = ("n_steps", "batch_size", "n_epochs")
REAL = {"gamma": 1.0, "gae_lambda": 1.0} | dict.fromkeys(
    ("learning_rate", "clip_range", "ent_coef", "vf_coef", "max_grad_norm"), LARGEST
)
"""Keys that are whole numbers from 1, and numbers from 0 to these or texts that `schedule` or the algorithm reads."""
SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf")
CLASSES = {
    "ppo": "stable_baselines3:PPO", "sac": "stable_baselines3:SAC", "tqc": "sb3_contrib:TQC",
    "recurrent_ppo": "sb3_contrib:RecurrentPPO", "gradient": "flexarm_env.training.gradient:Gradient",
}  # fmt: skip
OURS = ("env", "seed", "tensorboard_log", "verbose", "device", "policy_kwargs", "self", "_init_setup_model")


@dataclass(frozen=True)
class Config:
    """Hyper-parameters of a run, as they stand in the file (`text`) and as the algorithm takes them.

    Args:
        algorithm: a key of CLASSES. text: key -> value of the file. env_kwargs: keywords of the environment.
    """

    algorithm: str
    text: Mapping[str, Any]
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)

    def lasting(self, n_timesteps: int | None) -> Config:
        """The same over so many environment steps, where they are given."""
        return self if n_timesteps is None else replace(self, text={**self.text, "n_timesteps": n_timesteps})

    @property
    def n_envs(self) -> int:
        """Environments stepped together."""
        return int(float(self.text.get("n_envs", 1)))

    @property
    def n_timesteps(self) -> int:
        """Environment steps in all."""
        return int(float(self.text["n_timesteps"]))

    @property
    def normalize(self) -> dict[str, Any] | None:
        """Keywords of VecNormalize, or None for none."""
        value = self.text.get("normalize", False)
        if not value:
            return None
        value = _value("normalize", value) if isinstance(value, str) else {} if value is True else value
        keywords = check.table_of("normalize", value)
        return {"gamma": self.text["gamma"]} | keywords if "gamma" in self.text else keywords

    def arguments(self) -> dict[str, Any]:
        """Keywords of the algorithm's class, policy and policy_kwargs among them."""
        chosen = {k: v for k, v in self.text.items() if k not in ZOO}
        for key in SCHEDULED:
            if isinstance(chosen.get(key), str):
                chosen[key] = schedule(key, chosen[key])
        if isinstance(chosen.get("policy_kwargs"), str):
            chosen["policy_kwargs"] = _value("policy_kwargs", chosen["policy_kwargs"])
        if isinstance(chosen.get("train_freq"), list):
            chosen["train_freq"] = tuple(chosen["train_freq"])
        usual = "MlpLstmPolicy" if self.algorithm == "recurrent_ppo" else "MlpPolicy"
        return {"policy": self.text.get("policy", usual), **chosen}


def default_path(algorithm: str, env_id: str = "") -> Path:
    """The file of an algorithm that is taken where none is named: of tasks of the suite another."""
    return HOME / algorithm / ("suite.yml" if env_id.startswith("flexarm/") else "default.yml")


def load(path: Path | None, algorithm: str, env_id: str, allowed: Collection[str] | None = None) -> Config:
    """Read the entry of an environment. ValueError names the file, the key and what is allowed.

    path: a file; where there is none, one that comes with the package, named as in a checkout (configs/ppo/robust.yml)
    or, among the algorithm's own, without folder and suffix (robust). Default: `default_path`.
    allowed: keys that the entry may have; default those that Stable-Baselines3's class takes.
    """
    yaml = _yaml()
    check.choice("algo", algorithm, tuple(CLASSES))
    env_id = env_id.removeprefix("flexarm_env:")
    if path is None:
        path = default_path(algorithm, env_id)
        if not path.is_file():
            what = "comes with settings for tasks of the suite alone (flexarm/...); give others by --config FILE"
            raise ValueError(f"--env {env_id}: {algorithm} {what}")
    packaged = HOME.parent / path if path.suffix else HOME / algorithm / f"{path}.yml"
    if not path.is_file() and packaged.is_file():
        path = packaged
    try:
        content = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or not isinstance(content.get(env_id), dict):
        ids = [str(key) for key in content if key != "env_kwargs"] if isinstance(content, dict) else []
        ids = [key for key in ids if "-v" in key] or ids  # without the names that entries share
        unknown = check.UnknownKey(f"{path}: {env_id}", ids, "entry")
        raise ValueError(f"{unknown}; an environment of another id wants settings of your own, --config FILE")
    with check.in_file(path):
        given = check.table_of("env_kwargs", content.get("env_kwargs") or {}).get(env_id) or {}
        given = check.table_of(f"env_kwargs.{env_id}", given)
    config = Config(algorithm, content[env_id], {str(key): value for key, value in given.items()})
    return checked(config, str(path), env_id, taken_by(algorithm) if allowed is None else allowed)


def taken_by(algorithm: str) -> set[str]:
    """Keys that may stand in the file, from the signature of the algorithm's class."""
    taken = {*inspect.signature(algorithm_class(algorithm).__init__).parameters} - {*OURS}
    zoo = {*ZOO} - {"normalize"} if algorithm == "gradient" else {*ZOO}
    return {*taken, *zoo, "policy_kwargs"}


def checked(config: Config, path: str, env_id: str, allowed: Collection[str]) -> Config:
    """The config, or a ValueError for a key or value that there is not."""
    with check.under(f"{path}: {env_id}"):
        check.known_keys("", config.text, sorted(allowed), f"key of {config.algorithm}")
        check.needed("", config.text, "n_timesteps", "a positive number of environment steps")
        for key in ("n_envs", "n_timesteps"):
            value = config.text.get(key, 1)
            try:
                good = float(value) >= 1.0 and float(value).is_integer()
            except (TypeError, ValueError):
                good = False
            if not good:
                raise check.InvalidValue(key, value, "must be a whole number, at least 1")
        for key, value in config.text.items():
            if key in WHOLE:
                check.integer(key, value, minimum=1)
            elif key in REAL and not (isinstance(value, str) and (key in SCHEDULED or value.startswith("auto"))):
                check.number(key, value, minimum=0.0, maximum=REAL[key])
        if config.normalize is not None:
            check.known_keys("normalize", config.normalize, NORMALIZED)
            for key, value in config.normalize.items():
                (check.flag if key.startswith("norm_") else check.number)(f"normalize.{key}", value)
        check.table_of("policy_kwargs", config.arguments().get("policy_kwargs", {}))
    return config


@contextmanager
def fitting(algorithm: str) -> Iterator[None]:
    """Around what an algorithm makes of hyper-parameters: what it cannot make anything of is a ValueError too."""
    try:
        yield
    except (AssertionError, TypeError, RuntimeError) as error:
        if isinstance(error, ValueError):
            raise
        raise ValueError(f"hyper-parameters of {algorithm}: {' '.join(str(error).split())}") from error


def text_of(config: Config, env_id: str) -> str:
    """The config as a file that `load` reads."""
    content: dict[str, Any] = {env_id: dict(config.text)}
    if config.env_kwargs:
        content["env_kwargs"] = {env_id: dict(config.env_kwargs)}
    return str(_yaml().safe_dump(content, sort_keys=False))


def _yaml() -> Any:
    with check.needs("a file of hyper-parameters", "pyyaml", "train", ValueError):
        return importlib.import_module("yaml")


def algorithm_class(name: str) -> Any:
    """The class in Stable-Baselines3, or in its contrib. ValueError for one there is not."""
    module, _, kind = CLASSES[check.choice("algo", name, tuple(CLASSES))].partition(":")
    try:
        return getattr(importlib.import_module(module), kind)
    except ImportError as error:
        raise ValueError(f"algo = {name!r}: {check.lacking('it', module, 'train')}") from error


class Linear:
    """From a first value to zero over the whole run (RL Zoo's "lin_VALUE"); it can be pickled, a closure can't."""

    def __init__(self, first: float) -> None:
        self.first = first

    def __call__(self, remaining: float) -> float:
        return self.first * max(remaining, 0.0)


def schedule(key: str, text: str) -> Linear:
    """The schedule "lin_VALUE"."""
    kind, _, number = text.partition("_")
    try:
        if kind == "lin":
            return Linear(float(number))
    except ValueError:
        pass
    raise ValueError(f"{key} = {text!r}: must be a number, or lin_NUMBER for one that falls to zero")


def _value(key: str, text: str) -> Any:
    """The value of an expression made of dict(...), literals and nn.NAME; nothing else is run."""
    try:
        return _node(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError(f"{key} = {check.shown(text)}: must be made of dict(...), literals and nn.NAME") from error


def _node(node: ast.expr) -> Any:
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict" and not node.args:
        return {k.arg: _node(k.value) for k in node.keywords if k.arg}
    if isinstance(node, ast.Dict):
        return {ast.literal_eval(k): _node(v) for k, v in zip(node.keys, node.values, strict=True) if k}
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "nn":
        from torch import nn

        if isinstance(getattr(nn, node.attr, None), type):
            return getattr(nn, node.attr)
        raise ValueError(f"nn.{node.attr}")
    return ast.literal_eval(node)
