"""Policies by the words that a command line takes: controllers, files, ONNX models, the caller's functions."""

import hashlib
import importlib
import inspect
import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import control
from .. import validation as check
from ..files import read_json
from ..validation import Array32
from . import second
from .data import Task
from .judge import Policy

PLACE = "{task}"
"""In a word: the task's id, where each task has a policy of its own."""
KINDS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Types of observations that an ONNX model may take."""


@dataclass(frozen=True)
class Chosen:
    """A policy before it meets its environment.

    Attributes:
        kind: "controller", "policy", "onnx" or "function". source: the word, the task's id in it.
        fingerprint: changes where the policy does. make: vector environment -> Policy, or a ValueError where they do
            not fit. run: the seed it was trained with, where its file says so. training: what its run came to (steps,
            wall_s, cpu_s). canonical: what it computes with, from which its second hundred of seeds follows
            (`flexarm_env.suite.second`); None: the public hundred is all it has.
    """

    kind: str
    source: str
    fingerprint: str
    make: Callable[[Any], Policy]
    run: int = 0
    training: Mapping[str, Any] | None = None
    canonical: Callable[[], bytes] | None = None


def choose(word: str, task: Task) -> Chosen:
    """What a word names for a task. ValueError with a sentence for a word that names nothing, or a damaged file."""
    source = word.replace(PLACE, task.id)
    path = Path(source)
    if source in control.NAMES:
        version = metadata.version("flexarm_env")
        return Chosen(
            "controller", source, f"{source} {version}", lambda env: controller(source, env),
            canonical=lambda: second.of_controller(source, task),
        )  # fmt: skip
    if path.suffix.lower() == ".onnx":
        if not path.is_file():
            raise check.InvalidValue("--policy", source, "no such file")
        beside = path.with_name(f"{path.name}.data")  # where PyTorch puts the weights
        content = path.read_bytes() + (beside.read_bytes() if beside.is_file() else b"")
        return Chosen("onnx", source, fingerprint(content), lambda env: OnnxPolicy(path, env))
    if ":" in source and not path.exists():
        given = function_named(source)
        return Chosen("function", source, fingerprint(_text_of(given)), lambda env: FunctionPolicy(source, given, env))
    if not path.exists() and source not in control.policy_names():
        known = ", ".join((*control.NAMES, *control.policy_names()))
        raise check.InvalidValue("--policy", source, f"no such file or folder, no module:name, and none of {known}")
    policy = control.load_policy(source)
    content = b"".join([json.dumps(policy.meta).encode(), *(a.tobytes() for pair in policy.weights for a in pair)])
    seed = policy.meta.get("seed", 0)
    run = seed if isinstance(seed, int) and seed >= 0 else 0
    return Chosen(
        "policy", source, fingerprint(content), lambda env: policy.check(control.Setup.of(env)), run, _training(path),
        lambda: second.of_arrays(policy),
    )  # fmt: skip


def default_name(word: str) -> str:
    """What results are called after: the controller, the file, its folder, the function."""
    path = Path(word.rpartition(":")[2] if ":" in word and not Path(word).exists() else word)
    stem = path.parent.name if path.name == "policy.npz" else path.name
    return stem.removesuffix(".npz").removesuffix(".onnx").replace(PLACE, "").strip("-_.") or "policy"


# ------------------------------------------------------------------ controllers
class Following(Policy):
    """A controller that remembers nothing, told the target anew in every period: it may move, or the arm's root."""

    def __init__(self, controller: control.Controller) -> None:
        self.controller = controller

    def act(self, observation: Array32) -> Array32:
        """Actions, as if the episode began now."""
        self.controller.reset(observation)
        return self.controller.act(observation)


def controller(name: str, env: Any) -> Policy:
    """As `flexarm_env.control.make`, and PD control of a target that moves too, and on a base that floats."""
    plan = env.unwrapped.plan
    following = name == "pd" and (plan.task == "track" or plan.arm.base is not None)
    known = control.Setup.of(env) if following else env
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PD gains are unstable")  # here PD is what scores begin from, as it is
        made = control.make(name, known)
    return Following(made) if following else made


# ------------------------------------------------------------------ files
def _training(path: Path) -> dict[str, Any] | None:
    """Of the run folder that a policy lies in: algorithm, steps, seconds."""
    record = (path if path.is_dir() else path.parent) / "run.json"
    try:
        content = check.table_of("", read_json(record))
        check.text("algorithm", content.get("algorithm"))
        for key in ("steps", "wall_s", "cpu_s"):
            check.number(key, content.get(key), minimum=0.0)
        return {key: content[key] for key in ("algorithm", "steps", "wall_s", "cpu_s")}
    except ValueError:
        return None


class OnnxPolicy(Policy):
    """An ONNX model: its first input takes observations (n, entries), its first output gives actions (n, joints)."""

    def __init__(self, path: Path, env: Any) -> None:
        with check.needs("an ONNX policy", "onnxruntime", "export"):
            import onnxruntime
        options = onnxruntime.SessionOptions()
        options.log_severity_level, options.intra_op_num_threads = 4, 1
        try:
            self.session = onnxruntime.InferenceSession(
                os.fspath(path), sess_options=options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of the runtime's own many kinds
            raise ValueError(f"{path}: no ONNX model that can be run ({type(error).__name__})") from None
        given = self.session.get_inputs()
        if len(given) != 1:
            raise ValueError(f"{path}: takes {len(given)} inputs; a policy takes one, observations (n, entries)")
        self.path, self.name, shape = path, given[0].name, given[0].shape
        size = env.single_observation_space.shape[0]
        if len(shape) != 2 or (isinstance(shape[1], int) and shape[1] != size):
            raise ValueError(f"{path}: takes observations of shape {shape}; the task's is (n, {size})")
        self.one_by_one = shape[0] == 1
        if given[0].type not in KINDS:
            raise ValueError(f"{path}: takes {given[0].type}; a policy takes {' or '.join(KINDS)}")
        self.kind = KINDS[given[0].type]

    def act(self, observation: Array32) -> Any:
        """What the model gives."""
        rows = observation.astype(self.kind)
        try:
            if self.one_by_one:
                return np.concatenate([self.session.run(None, {self.name: row[None]})[0] for row in rows])
            return self.session.run(None, {self.name: rows})[0]
        except Exception as error:
            raise ValueError(f"{self.path}: the model failed ({' '.join(str(error).split())[:200]})") from None


# ------------------------------------------------------------------ functions
class FunctionPolicy:
    """A function of observations: of all rows (n, entries) at once where it takes that, else of one (entries,) a time.

    An object with `reset` and `act` is its `act`. `reset`, where there is one, is called with the first observations;
    again where the function turns out to take one observation alone, since trying it may have left something behind.
    """

    def __init__(self, word: str, function: Any, env: Any) -> None:
        self.word, self.begin = word, getattr(function, "reset", None)
        self.function: Callable[[Any], Any] = function.act if _is_policy(function) else function
        self.shape = env.action_space.shape
        self.at_once: bool | None = None
        self.tried = ""

    def reset(self, observation: Array32) -> None:
        """Begin episodes."""
        if self.begin is not None:
            self._call(self.begin, observation)

    def act(self, observation: Array32) -> Any:
        """What the function gives."""
        if self.at_once is None:
            actions = self._of_all(observation)
            self.at_once = actions is not None
            if self.at_once:
                return actions
            self.reset(observation)
        if self.at_once:
            return self._call(self.function, observation)
        return np.stack([self._one(row) for row in observation])

    def _of_all(self, observation: Array32) -> Any:
        """Its actions of all rows at once; None where it does not take them, and `tried` says what came instead."""
        try:
            actions = self.function(observation.copy())
            if np.shape(actions) == self.shape:
                return actions
            came = f"gave shape {np.shape(actions)}"
        except (Exception, SystemExit) as error:  # it may take one observation alone
            came = f"raised {_words(error)}"
        self.tried = f"of all observations {observation.shape} at once it {came}; of one alone "
        return None

    def _one(self, row: Array32) -> NDArray[Any]:
        found = np.asarray(self._call(self.function, row))
        if found.size != self.shape[1]:
            what = f"must give {self.shape} for all observations, or ({self.shape[1]},) for one"
            raise check.InvalidValue(f"--policy {self.word}: {self.tried}shape of its actions", found.shape, what)
        return found.reshape(-1)

    def _call(self, function: Callable[[Any], Any], given: Array32) -> Any:
        try:
            return function(given.copy())
        except (Exception, SystemExit) as error:
            raise ValueError(f"--policy {self.word}: {self.tried}it raised {_words(error)}") from error


def _is_policy(found: Any) -> bool:
    """Whether it is as `flexarm_env.suite.judge.Policy` says; a function may have an attribute `reset` alone."""
    return all(callable(getattr(found, name, None)) for name in ("reset", "act"))


def function_named(word: str, path: str = "--policy") -> Any:
    """module:name, looked for in the current folder too: a function, a policy, or a class of one or the other, made.

    path: what a ValueError of one that is none begins with.
    """
    module, _, name = word.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path} {word}: cannot be imported ({_words(error)})") from None
    if inspect.isclass(found):
        try:
            found = found()
        except (Exception, SystemExit) as error:
            raise ValueError(f"{path} {word}: cannot be made without arguments ({_words(error)})") from None
    if not callable(found) and not _is_policy(found):
        raise check.InvalidValue(path, word, "must name a function of observations, or a policy: reset and act")
    return found


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}".removesuffix(": ")


def _text_of(function: Any) -> bytes:
    """The source of the function's module, or its name where there is none."""
    try:
        return inspect.getsource(inspect.getmodule(function) or function).encode()
    except (OSError, TypeError):
        return repr(getattr(function, "__qualname__", type(function))).encode()


def fingerprint(content: bytes) -> str:
    """16 digits that change where the content does."""
    return hashlib.sha256(content).hexdigest()[:16]
