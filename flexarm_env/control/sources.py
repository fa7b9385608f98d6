"""Find policies by name: a controller, a file, a run folder, a policy of the package, or your own function.

Every command and :func:`load_policy` accept the same names:

| word | policy |
|---|---|
| `pd`, `zv`, `zvd`, `lqr`, `lqg`, `mpc`, `time_optimal` | a controller, designed for the environment |
| `lqr@gains.toml` | a controller with gains from a file of `flexarm tune` |
| `flexible_arm`, `two_link`, ... | a trained policy in the package |
| `runs/my-run` | a run folder: its `policy.npz`, or its `model.zip` if there is no `policy.npz` |
| `policy.npz`, `model.zip`, `policy.onnx` | a file of this package, of Stable-Baselines3, or an ONNX model |
| `module:name` | a function of observations, an object with `reset` and `act`, or its class |
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import from_json, imported, in_words, read_json, read_toml
from ..validation import Array32
from .base import IN_SPACE, Setup
from .catalogue import NAMES, controller, gains_from
from .models import load_model
from .policy import HOME, AroundPolicy, NumpyPolicy, fitted, load_npz, names

KINDS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Supported input types of ONNX models, with their NumPy types."""


@dataclass(frozen=True)
class NamedPolicy:
    """Policy that a name denotes, before it is created for an environment.

    Attributes:
        name: name of the policy for display.
        env_id, env_kwargs: training environment and its keywords; "" and {} if the policy fits any environment.
        make: function of an environment that returns a policy with `reset` and `act`, and raises ValueError if the
            policy does not fit.
        kind: "controller", "policy" (a network run by NumPy), "onnx" or "function".
        policy: the policy, not yet verified for an environment; None for a controller.
        path: path of the policy's file; None without a file.
        asked: environment keywords that the user gave for training; evaluation uses the same keywords.
    """

    name: str
    env_id: str
    env_kwargs: Mapping[str, Any]
    make: Callable[[Any], Any]
    kind: str = "controller"
    policy: Any = None
    path: Path | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)


def load_policy(source: str | os.PathLike[str], env: Any = None) -> Any:
    """Load a policy by its name or path; :mod:`flexarm_env.control.sources` lists all forms.

    Args:
        source: name of a controller, name of a policy of the package, file, run folder, or module:name.
        env: environment or vector environment in which the policy acts, or None. A controller, alone or inside a
            policy, requires the environment. For any other policy the environment is optional: if it is given, the
            function verifies that the policy fits the environment.
    Returns:
        An object with `reset(observation)` and `act(observation)` for observations (entries,) or (n, entries).
    Raises:
        ValueError: an unknown name, a damaged file, or a policy that does not fit the environment.
    """
    found = find_policy(os.fspath(source), "policy")
    if env is not None:
        return found.make(env)
    if found.kind == "controller":
        what = "is a controller, which needs its environment: load_policy(name, env)"
        raise check.InvalidValue("policy", found.name, what)
    if isinstance(found.policy, AroundPolicy):
        own = found.policy.inside.controller
        what = f"has the controller {own} inside, which needs the environment: load_policy(name, env)"
        raise check.InvalidValue("policy", found.name, what)
    return found.policy


def find_policy(word: str, flag: str = "--policy") -> NamedPolicy:
    """Find the policy that a name denotes; no environment is needed.

    flag: name of the option in messages. Raises ValueError for an unknown name or a damaged file.
    """
    word = word.strip()
    if word in NAMES:
        return NamedPolicy(word, "", {}, lambda env: controller(word, env))
    path, (name, _, file) = Path(word), word.partition("@")
    if file and name in NAMES:
        path, gains = Path(file), _gains(name, Path(file))
        return NamedPolicy(f"{name}@{path.stem}", "", {}, lambda env: controller(name, env, gains), path=path)
    if path.suffix.lower() == ".onnx" and path.is_file():
        onnx = OnnxPolicy(path)
        env_id, kwargs = str(onnx.meta.get("env_id", "")), onnx.meta.get("env_kwargs", {})
        return NamedPolicy(path.stem, env_id, kwargs, onnx.fitted, "onnx", onnx, path)
    if ":" in word and not path.exists():
        function = FunctionPolicy(word, function_named(word, flag), flag)
        return NamedPolicy(word, "", {}, function.fitted, "function", function)
    if not path.exists() and word in names():
        return _of_network(word, load_npz(Path(str(HOME / word / "policy.npz"))), path)
    if not path.exists():
        known = ", ".join((*NAMES, *names()))
        what = f"must be a run folder, a file (.npz, .zip, .onnx) that exists, module:name, or one of {known}"
        raise check.InvalidValue(flag, word, what)
    if path.is_dir():
        inside = [path / one for one in ("policy.npz", "model.zip") if (path / one).is_file()]
        if not inside:
            raise check.InvalidValue(flag, word, "must hold a policy.npz or a model.zip, and has no policy.npz there")
        path = inside[0]
    shown = Path(word).stem if Path(word).is_file() else Path(word).resolve().name
    if path.suffix.lower() == ".zip":
        return _of_network(shown, load_model(path, _trained(path)), path)
    return _of_network(shown, load_npz(path), path)


def _of_network(name: str, policy: NumpyPolicy, path: Path) -> NamedPolicy:
    """Wrap a network as `NamedPolicy`, with the record of its training from the file."""
    env_id, kwargs = str(policy.meta.get("env_id", "")), policy.meta.get("env_kwargs", {})
    asked = policy.meta.get("asked", {})

    def bound(env: Any) -> Any:
        """Check the policy against the environment; a message begins with the policy's name."""
        try:
            return policy.bound(env)
        except ValueError as error:
            raise ValueError(f"policy {name}: {error}") from error

    return NamedPolicy(name, env_id, kwargs, bound, "policy", policy, path, asked)


def _trained(path: Path) -> dict[str, Any]:
    """Read the training record from the run.json beside a model; {} without one."""
    beside = path.with_name("run.json")
    if not beside.is_file():
        return {}
    record = check.table_of(str(beside), read_json(beside))
    known = ("env_id", "env_kwargs", "asked", "layout", "scales", "torque_limits", "seed", "algorithm", "around")
    return {key: record[key] for key in known if key in record}


def _gains(name: str, path: Path) -> Any:
    """Read a controller's gains from a file of `flexarm tune`; raise ValueError if missing or invalid."""
    try:
        tables, _ = read_toml(path)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    if not isinstance(tables.get(name), dict):
        raise ValueError(f"{path}: no table [{name}]; it has {', '.join(tables) or 'none'}")
    try:
        gains_from(name, tables[name])
    except ValueError:
        if name == "time_optimal" or not _gains_in_space(name, tables[name]):
            raise
    return tables[name]


def _gains_in_space(name: str, table: Mapping[str, Any]) -> bool:
    """Return whether a table contains valid gains for an arm in space."""
    try:
        gains_from(name, table, IN_SPACE)
    except ValueError:
        return False
    return True


# ------------------------------------------------------------------ ONNX
class OnnxPolicy:
    """Policy that ONNX Runtime evaluates, from observations (first input) to actions (first output).

    `meta`: training record written by `flexarm export`; {} for models from other programs.
    """

    def __init__(self, path: Path) -> None:
        """Load the model with one CPU thread and validate its input."""
        with check.needs("an ONNX policy", "onnxruntime", "export"):
            import onnxruntime
        options = onnxruntime.SessionOptions()
        options.log_severity_level, options.intra_op_num_threads = 4, 1
        try:
            self.session = onnxruntime.InferenceSession(
                os.fspath(path), sess_options=options, providers=["CPUExecutionProvider"]
            )
            own = self.session.get_modelmeta().custom_metadata_map.get("flexarm_env")
        except Exception as error:  # of the runtime's own many kinds
            raise ValueError(f"{path}: no ONNX model that can be run ({type(error).__name__})") from None
        with check.in_file(path):
            self.meta = {} if own is None else check.table_of("flexarm_env", from_json(own, "flexarm_env"))
            check.table_of("env_kwargs", self.meta.get("env_kwargs", {}))
        # exactly one input (n, entries) of a supported type
        given = self.session.get_inputs()
        if len(given) != 1:
            raise ValueError(f"{path}: takes {len(given)} inputs; a policy takes one, observations (n, entries)")
        self.path, self.name, self.shape = path, given[0].name, given[0].shape
        if len(self.shape) != 2:
            raise ValueError(f"{path}: takes observations of shape {self.shape}; a policy's is (n, entries)")
        self.one_by_one = self.shape[0] == 1
        if given[0].type not in KINDS:
            raise ValueError(f"{path}: takes {given[0].type}; a policy takes {' or '.join(KINDS)}")
        self.kind = KINDS[given[0].type]
        self.ratio: NDArray[np.float64] | None = None

    def fitted(self, env: Any) -> OnnxPolicy:
        """Return the policy; raise ValueError unless it fits the environment's observations and actions."""
        one = getattr(env, "single_observation_space", None)
        size = (env.observation_space if one is None else one).shape[-1]
        if isinstance(self.shape[1], int) and self.shape[1] != size:
            raise ValueError(f"{self.path}: takes observations of shape {self.shape}; the task's is (n, {size})")
        if self.meta:
            setup = Setup.of(env)
            try:
                self.ratio = fitted(self.meta, setup, setup.size, setup.n_joints)
            except ValueError as error:
                raise ValueError(f"{self.path}: {error}") from error
        return self

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Do nothing, because an ONNX policy has no memory."""

    def act(self, observation: NDArray[np.floating]) -> Any:
        """Return actions for observations (n, entries) or (entries,); a model with batch size 1 is run row by row."""
        rows = np.atleast_2d(observation)
        rows = (rows if self.ratio is None else rows * self.ratio).astype(self.kind)
        try:
            if self.one_by_one:
                found = np.concatenate([self.session.run(None, {self.name: row[None]})[0] for row in rows])
            else:
                found = self.session.run(None, {self.name: rows})[0]
        except Exception as error:
            raise ValueError(f"{self.path}: the model failed ({' '.join(str(error).split())[:200]})") from None
        return found[0] if np.ndim(observation) == 1 else found


# ------------------------------------------------------------------ functions
class FunctionPolicy:
    """Policy that calls a Python function of observations, or the methods `reset` and `act` of an object.

    The function is called with all rows (n, entries) if it accepts them, and otherwise row by row. If the first call
    with all rows fails, the object's `reset` is called again, because the failed call may have changed the object's
    memory.
    """

    def __init__(self, word: str, function: Any, flag: str = "--policy") -> None:
        """Store the function and its `reset`; messages contain `word`, the policy's name, and `flag`, the option."""
        self.word, self.flag, self.begin = word, flag, getattr(function, "reset", None)
        self.function: Callable[[Any], Any] = function.act if _is_policy(function) else function
        self.joints: int | None = None
        self.at_once: bool | None = None
        self.tried = ""

    def fitted(self, env: Any) -> FunctionPolicy:
        """Return the policy; the environment's actions must have one number per joint."""
        bound = FunctionPolicy(self.word, self.function, self.flag)
        bound.begin, bound.joints = self.begin, int(env.action_space.shape[-1])
        return bound

    def reset(self, observation: Array32) -> None:
        """Begin episodes with their first observations, and reset the user's object."""
        if self.begin is not None:
            self._call(self.begin, observation)

    def act(self, observation: Array32) -> Any:
        """Return the function's actions for observations (n, entries) or (entries,)."""
        # the first call finds out which form the function takes
        if self.at_once is None:
            actions = self._tried(observation)
            self.at_once = actions is not None
            if self.at_once:
                return actions
            self.reset(observation)
        if self.at_once:
            actions = self._call(self.function, observation)
            return self._fitting(actions) if observation.ndim == 1 else actions
        if observation.ndim == 1:  # it takes rows alone
            return self._fitting(self._call(self.function, observation[None]))
        return np.stack([self._fitting(self._call(self.function, row)) for row in observation])

    def _tried(self, observation: Array32) -> Any:
        """Call the function with all observations; return its actions, or None and a note in `tried` if it fails."""
        try:
            actions = self.function(observation.copy())
            # accept a flat action of one observation, or one row per observation
            shape = np.shape(actions)
            if observation.ndim == 1 and self.joints in (None, np.size(actions)):
                return np.reshape(actions, -1)
            if observation.ndim == 2 and shape == (len(observation), self.joints or shape[-1]):
                return actions
            came = f"gave shape {shape}"
        except (Exception, SystemExit) as error:  # it may take the other form
            came = f"raised {in_words(error)}"
        what = "all observations {0} at once" if observation.ndim == 2 else "one observation {0}"
        self.tried = f"of {what.format(observation.shape)} it {came}; of one {'row ' * (observation.ndim == 1)}alone "
        return None

    def _fitting(self, given: Any) -> NDArray[Any]:
        """Flatten one observation's actions (N,); raise ValueError for a wrong number."""
        found = np.asarray(given)
        if self.joints is not None and found.size != self.joints:
            what = f"must give (n, {self.joints}) for n observations, or ({self.joints},) for one"
            raise check.InvalidValue(f"{self.flag} {self.word}: {self.tried}shape of its actions", found.shape, what)
        return found.reshape(-1)

    def _call(self, function: Callable[[Any], Any], given: Array32) -> Any:
        """Call the user's function with a copy of the observation; convert any exception into a ValueError."""
        try:
            return function(given.copy())
        except (Exception, SystemExit) as error:
            raise ValueError(f"{self.flag} {self.word}: {self.tried}it raised {in_words(error)}") from error


def _is_policy(found: Any) -> bool:
    """Return whether an object has both `reset` and `act`; a plain function may have an attribute `reset` too."""
    return all(callable(getattr(found, name, None)) for name in ("reset", "act"))


def function_named(word: str, flag: str = "--policy") -> Any:
    """Import the function or policy that `word` names as module:name; a class is instantiated.

    The module may be in the current folder. flag: name of the option in the message of a ValueError.
    """
    found = imported(flag, word)
    if inspect.isclass(found):
        try:
            found = found()
        except (Exception, SystemExit) as error:
            raise ValueError(f"{flag} {word}: cannot be made without arguments ({in_words(error)})") from None
    if not callable(found) and not _is_policy(found):
        raise check.InvalidValue(flag, word, "must name a function of observations, or a policy: reset and act")
    return found
