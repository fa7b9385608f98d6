"""Hyper-parameters from files in RL Zoo's format: one entry per environment id.

A file may contain two further tables, `env_kwargs` and `around`; their keys are environment ids. `env_kwargs` contains
keyword arguments of the environment for which the hyper-parameters were chosen. RL Zoo ignores `env_kwargs`; users of
RL Zoo pass the same keywords by `--env-kwargs`. `around` names a classical controller (`control.around.Inside`), whose
torques are added to the network's torques, and the largest torque of the network as a fraction of the torque limits.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flexarm_env import validation as check
from flexarm_env.control.around import Inside
from flexarm_env.validation import LARGEST

sys.modules.setdefault("agents.config", sys.modules[__name__])  # as pickles of older run folders name it

_PLACES = [Path(__file__).resolve().parents[k] / name for k, name in ((1, "data/configs"), (2, "configs"))]
HOME = next((place for place in _PLACES if place.is_dir()), _PLACES[0])
"""Folder of the package's own files; in a checkout it is the top-level folder configs/."""

TABLES = ("env_kwargs", "around")
"""Tables of a file in addition to the entries of environments."""

ZOO = ("n_envs", "n_timesteps", "normalize", "policy")
"""Keys of a hyper-parameter file that are not arguments of the algorithm's class."""

NORMALIZED = ("norm_obs", "norm_reward", "clip_obs", "clip_reward", "gamma", "epsilon")
"""Keywords of VecNormalize."""
WHOLE = ("n_steps", "batch_size", "n_epochs")
REAL = {"gamma": 1.0, "gae_lambda": 1.0} | dict.fromkeys(
    ("learning_rate", "clip_range", "ent_coef", "vf_coef", "max_grad_norm"), LARGEST
)
"""Integer hyper-parameters, at least 1, and real hyper-parameters with their maxima, at least 0. A real hyper-parameter
may also be a text for `schedule`."""
SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf")
CLASSES = {
    "ppo": "stable_baselines3:PPO", "sac": "stable_baselines3:SAC", "tqc": "sb3_contrib:TQC",
    "recurrent_ppo": "sb3_contrib:RecurrentPPO", "gradient": "flexarm_env.training.gradient:Gradient",
}  # fmt: skip
OURS = ("env", "seed", "tensorboard_log", "verbose", "device", "policy_kwargs", "self", "_init_setup_model")


@dataclass(frozen=True)
class Config:
    """Hyper-parameters of a run: values of the file (`text`) and keyword arguments of the algorithm (`arguments`).

    Args:
        algorithm: name of the algorithm, a key of CLASSES. text: values of the file by key. env_kwargs: keyword
            arguments of the environment.
        around: table with the keys controller, share and gains, for a controller whose torques are added to the
            network's torques; {} for no controller.
    """

    algorithm: str
    text: Mapping[str, Any]
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    around: Mapping[str, Any] = field(default_factory=dict)

    def lasting(self, n_timesteps: int | None) -> Config:
        """Return the config with a new number of environment steps; None leaves the number unchanged."""
        return self if n_timesteps is None else replace(self, text={**self.text, "n_timesteps": n_timesteps})

    def changed(self, settings: Sequence[str], env_id: str) -> Config:
        """Return the config with the hyper-parameters in `settings` changed; each setting is a text KEY=VALUE.

        Raises ValueError for invalid keys or values.
        """
        if not settings:
            return self
        text = dict(self.text)
        for word in settings:
            key, equals, value = word.partition("=")
            if not equals or not key.strip():
                raise check.InvalidValue("--set", word, "must be KEY=VALUE, such as learning_rate=3e-4")
            text[key.strip()] = _literal(value.strip())
        return checked(replace(self, text=text), "--set", env_id, taken_by(self.algorithm))

    @property
    def n_envs(self) -> int:
        """Number of environments that run in parallel."""
        return int(float(self.text.get("n_envs", 1)))

    @property
    def n_timesteps(self) -> int:
        """Total number of environment steps of the training."""
        return int(float(self.text["n_timesteps"]))

    @property
    def normalize(self) -> dict[str, Any] | None:
        """Keywords of VecNormalize; None: no normalization."""
        value = self.text.get("normalize", False)
        if not value:
            return None
        value = _value("normalize", value) if isinstance(value, str) else {} if value is True else value
        keywords = check.table_of("normalize", value)
        return {"gamma": self.text["gamma"]} | keywords if "gamma" in self.text else keywords

    def arguments(self) -> dict[str, Any]:
        """Return the keywords of the algorithm's class, including policy and policy_kwargs."""
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


def _literal(text: str) -> Any:
    """Parse a number, True, False, None or a list; return any other text unchanged (lin_1e-3, dict(...))."""
    try:
        return ast.literal_eval({"true": "True", "false": "False", "null": "None"}.get(text, text))
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


def default_path(algorithm: str, env_id: str = "") -> Path:
    """Return the path of an algorithm's default file of hyper-parameters.

    The file is default.yml, or suite.yml for tasks of the suite. For PPO on the suite task `press` the file is
    press.yml.
    """
    if not env_id.startswith("flexarm/"):
        return HOME / algorithm / "default.yml"
    presses = algorithm == "ppo" and env_id.startswith("flexarm/press-")
    return HOME / algorithm / ("press.yml" if presses else "suite.yml")


def load(path: Path | None, algorithm: str, env_id: str, allowed: Collection[str] | None = None) -> Config:
    """Read the hyper-parameters of an environment from a file. A ValueError names the file, the key and the rule.

    path: your own file, or a file of the package. A file of the package is named by its path in a checkout
    (configs/ppo/robust.yml). A file for this algorithm may also be named by its stem (robust). None means the file that
    `default_path` returns. allowed: accepted keys of the entry; None means the arguments of the algorithm's class in
    Stable-Baselines3.
    """
    yaml = _yaml()
    check.choice("algo", algorithm, tuple(CLASSES))
    env_id = env_id.removeprefix("flexarm_env:")
    if path is None:
        path = default_path(algorithm, env_id)
        if not path.is_file():
            what = "has hyper-parameters only for tasks of the suite (flexarm/...); give a file by --config FILE"
            raise ValueError(f"--env {env_id}: {algorithm} {what}")
    # the user's file first, then the package's
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
        ids = [str(key) for key in content if key not in TABLES] if isinstance(content, dict) else []
        ids = [key for key in ids if "-v" in key] or ids  # without the names that entries share
        unknown = check.UnknownKey(f"{path}: {env_id}", ids, "entry")
        raise ValueError(f"{unknown}; another environment needs its own hyperparameters, --config FILE")
    with check.in_file(path):
        given = check.table_of("env_kwargs", content.get("env_kwargs") or {}).get(env_id) or {}
        given = check.table_of(f"env_kwargs.{env_id}", given)
        inside = check.table_of("around", content.get("around") or {}).get(env_id) or {}
        inside = check.table_of(f"around.{env_id}", inside)
        check.known_keys(f"around.{env_id}", inside, check.names_of(Inside))
    config = Config(algorithm, content[env_id], {str(key): value for key, value in given.items()}, inside)
    return checked(config, str(path), env_id, taken_by(algorithm) if allowed is None else allowed)


def taken_by(algorithm: str) -> set[str]:
    """Return the keys that a file may have for an algorithm, from the signature of the algorithm's class."""
    taken = {*inspect.signature(algorithm_class(algorithm).__init__).parameters} - {*OURS}
    zoo = {*ZOO} - {"normalize"} if algorithm == "gradient" else {*ZOO}
    return {*taken, *zoo, "policy_kwargs"}


def checked(config: Config, path: str, env_id: str, allowed: Collection[str]) -> Config:
    """Return the config; raise ValueError for an unknown key or an invalid value."""
    with check.under(f"{path}: {env_id}"):
        check.known_keys("", config.text, sorted(allowed), f"key of {config.algorithm}")
        check.needed("", config.text, "n_timesteps", "a positive number of environment steps")
        # positive integers; 1e6 is accepted
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
    """Convert errors in a `with` block, which constructs an algorithm, into a ValueError about hyper-parameters."""
    try:
        yield
    except (AssertionError, TypeError, RuntimeError) as error:
        if isinstance(error, ValueError):
            raise
        raise ValueError(f"hyper-parameters of {algorithm}: {' '.join(str(error).split())}") from error


def text_of(config: Config, env_id: str) -> str:
    """Format the config as a YAML file that `load` reads."""
    content: dict[str, Any] = {env_id: dict(config.text)}
    if config.env_kwargs:
        content["env_kwargs"] = {env_id: dict(config.env_kwargs)}
    if config.around:
        content["around"] = {env_id: dict(config.around)}
    return str(_yaml().safe_dump(content, sort_keys=False))


def _yaml() -> Any:
    """Import PyYAML; raise ValueError if it is not installed."""
    with check.needs("a file of hyper-parameters", "pyyaml", "train", ValueError):
        return importlib.import_module("yaml")


def algorithm_class(name: str) -> Any:
    """Import the algorithm's class from Stable-Baselines3 or its contrib package.

    Raises ValueError if the class is not available.
    """
    module, _, kind = CLASSES[check.choice("algo", name, tuple(CLASSES))].partition(":")
    try:
        return getattr(importlib.import_module(module), kind)
    except ImportError as error:
        raise ValueError(f"algo = {name!r}: {check.lacking('it', module, 'train')}") from error


class Linear:
    """Hyper-parameter that falls linearly from a first value to zero over the run, written "lin_VALUE" in RL Zoo.

    Instances can be pickled, unlike closures.
    """

    def __init__(self, first: float) -> None:
        self.first = first

    def __call__(self, remaining: float) -> float:
        return self.first * max(remaining, 0.0)


def schedule(key: str, text: str) -> Linear:
    """Parse a schedule of the form "lin_VALUE"."""
    kind, _, number = text.partition("_")
    try:
        if kind == "lin":
            return Linear(float(number))
    except ValueError:
        pass
    raise ValueError(f"{key} = {text!r}: must be a number, or lin_NUMBER for one that falls to zero")


def _value(key: str, text: str) -> Any:
    """Evaluate an expression of dict(...), literals and nn.NAME. The function executes nothing else in the text."""
    # no names but dict and nn.NAME are evaluated
    try:
        return _node(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError(f"{key} = {check.shown(text)}: must be made of dict(...), literals and nn.NAME") from error


def _node(node: ast.expr) -> Any:
    """Evaluate a node of the syntax tree of such an expression."""
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
