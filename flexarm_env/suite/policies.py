"""Find the policies that the suite evaluates by name, and compute hashes that identify the policies."""

import hashlib
import inspect
import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from .. import control
from .. import validation as check
from ..control.catalogue import controller as by_name
from ..control.catalogue import tuned_gains
from ..episodes import Policy
from ..files import read_json
from . import second
from .data import NAMESPACE, Task

PLACE = "{task}"
"""Placeholder of the task's id in a policy's name, for methods with one policy per task."""


@dataclass(frozen=True)
class Chosen:
    """Policy that a name denotes, before it is created for an environment.

    Attributes:
        kind: "controller", "policy", "onnx" or "function".
        source: name of the policy, with the task's id in place of {task}.
        fingerprint: hash of the policy.
        make: function of a vector environment that returns the `Policy`, or raises ValueError if the policy does not
            fit.
        run: training seed, if the policy's file records the seed. training: record of the training (steps, wall_s,
            cpu_s).
        canonical: function that returns the policy's numbers as bytes. The bytes determine the seeds of the policy's
            100 further episodes (`flexarm_env.suite.second`). If `canonical` is None, the policy is evaluated only on
            the 100 public episodes.
    """

    kind: str
    source: str
    fingerprint: str
    make: Callable[[Any], Policy]
    run: int = 0
    training: Mapping[str, Any] | None = None
    canonical: Callable[[], bytes] | None = None


def choose(word: str, task: Task) -> Chosen:
    """Find the policy that a name denotes for a task. Raises ValueError for an unknown name or a damaged file."""
    source = word.replace(PLACE, task.id)
    # ONNX file, with its external weights
    path = Path(source)
    if path.suffix.lower() == ".onnx" and path.is_file():
        beside = path.with_name(f"{path.name}.data")  # where PyTorch puts the weights
        content = path.read_bytes() + (beside.read_bytes() if beside.is_file() else b"")
        return Chosen("onnx", source, fingerprint(content), lambda env: control.find_policy(source).make(env))
    found = control.find_policy(source)
    if found.kind == "controller":
        mark = f"{source} {metadata.version('flexarm_env')}"
        if found.path is not None:
            mark = fingerprint(mark.encode() + found.path.read_bytes())
        own = None if found.path is not None else lambda: second.of_controller(source, task)
        return Chosen("controller", source, mark, lambda env: controller(source, env), canonical=own)
    if found.kind == "function":
        return Chosen("function", source, fingerprint(_text_of(found.policy.function)), found.make)
    policy = found.policy
    if found.path is not None and found.path.suffix.lower() == ".zip":
        mark = fingerprint(found.path.read_bytes())
        return Chosen("policy", source, mark, found.make, training=_training(found.path))
    # networks of the package: hash of metadata and weights
    content = b"".join([json.dumps(policy.meta).encode(), *(a.tobytes() for pair in policy.weights for a in pair)])
    seed = policy.meta.get("seed", 0)
    run = seed if isinstance(seed, int) and seed >= 0 else 0
    training = _training(path)
    return Chosen("policy", source, fingerprint(content), found.make, run, training, lambda: second.of_arrays(policy))


def controller(name: str, env: Any) -> Policy:
    """Create a classical controller by its name, with the gains that the package contains for the task.

    Warnings about unstable gains are suppressed: PD control defines the score 0 even with unstable gains.
    """
    frozen = getattr(env.unwrapped.spec, "namespace", None) == NAMESPACE and name in control.NAMES
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PD gains are unstable")
        if frozen:
            warnings.filterwarnings("ignore", ".*ignores delays")
        made: Policy = by_name(name, env, _gains(name, env)) if frozen else control.find_policy(name).make(env)
    return made


def _gains(name: str, env: Any) -> Any:
    """Return the tuned gains; None for an arm without tuned gains, for which `control.make` raises its own error."""
    setup = control.Setup.of(env)
    try:
        return tuned_gains(name, setup.gains, setup.n_joints)
    except check.InvalidValue:
        return None


def default_name(word: str) -> str:
    """Return the default name of a method's results: the name of the controller, file, file's folder, or function."""
    name, _, gains = word.partition("@")
    if gains and name in control.NAMES:
        return f"{name}-{Path(gains).stem}"
    path = Path(word.rpartition(":")[2] if ":" in word and not Path(word).exists() else word)
    stem = path.parent.name if path.name in ("policy.npz", "model.zip") else path.name
    for ending in (".npz", ".zip", ".onnx"):
        stem = stem.removesuffix(ending)
    return stem.replace(PLACE, "").strip("-_.") or "policy"


def _training(path: Path) -> dict[str, Any] | None:
    """Read algorithm, steps and seconds from the run folder that contains a policy; None without a valid record."""
    record = (path if path.is_dir() else path.parent) / "run.json"
    try:
        content = check.table_of("", read_json(record))
        check.text("algorithm", content.get("algorithm"))
        for key in ("steps", "wall_s", "cpu_s"):
            check.number(key, content.get(key), minimum=0.0)
        return {key: content[key] for key in ("algorithm", "steps", "wall_s", "cpu_s")}
    except ValueError:
        return None


def _text_of(function: Any) -> bytes:
    """Return the source of the function's module, or the function's name if there is no source."""
    try:
        return inspect.getsource(inspect.getmodule(function) or function).encode()
    except (OSError, TypeError):
        return repr(getattr(function, "__qualname__", type(function))).encode()


def fingerprint(content: bytes) -> str:
    """Hash bytes to a text of 16 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()[:16]
