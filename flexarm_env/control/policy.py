"""Trained policies run with NumPy alone: a small network from a `policy.npz` file.

The file holds `meta` (JSON: format, env_id, env_kwargs, layout, activation, squash, versions, and what else the run
says of itself; with `scales`, of the observation's entries by name, and `torque_limits` it acts on other arms too),
weights `w0`, `b0`, `w1`, ... (float32; layer k maps x to x w + b), and, where observations were normalised, `mean`,
`variance` (float64), `clip` and `epsilon`. It holds numbers and text alone; reading it runs nothing, where reading a
pickle (a model.zip, a checkpoint) may.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import from_json, read_npz
from ..validation import Array32
from .base import RESIDUAL_SHARE, Setup

FORMAT = 1
ACTIVATIONS = ("tanh", "relu")
MOST_LAYERS, MOST_BYTES = 100, 2**28
HOME = resources.files("flexarm_env") / "data" / "policies"


class NumpyPolicy:
    """A deterministic policy: observations in, actions out.

    Args:
        meta: see the module. weights: [(w, b), ...] float32. normaliser: None, or mean, variance, clip, epsilon.
    """

    def __init__(
        self,
        meta: Mapping[str, Any],
        weights: list[tuple[Array32, Array32]],
        normaliser: Mapping[str, Any] | None = None,
    ) -> None:
        self.meta, self.weights, self.normaliser = dict(meta), weights, normaliser
        self.ratio: NDArray[np.float64] | None = None  # the environment's scales over the policy's own
        self._layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in weights]

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Nothing to remember."""

    def act(self, observation: NDArray[np.floating]) -> Array32:
        """Actions in [-1, 1], (n, N), or (N,) for a single observation.

        Worked out in float64, so that an action does not depend on how many are asked for together. ValueError for
        observations of another size.
        """
        x = check.floats("observation", observation)
        taken = len(self._layers[0][0])
        if x.shape[-1:] != (taken,):
            raise check.InvalidValue("shape of observation", x.shape, f"must be (n, {taken})")
        if self.ratio is not None:
            x = x * self.ratio
        if self.normaliser is not None:
            n = self.normaliser
            x = np.clip((x - n["mean"]) / np.sqrt(n["variance"] + n["epsilon"]), -n["clip"], n["clip"])
        for w, b in self._layers[:-1]:
            x = x @ w + b
            x = np.tanh(x) if self.meta["activation"] == "tanh" else np.maximum(x, 0.0)
        w, b = self._layers[-1]
        x = x @ w + b
        action = np.tanh(x) if self.meta["squash"] else np.clip(x, -1.0, 1.0)
        return action.astype(np.float32)

    def check(self, setup: Setup) -> NumpyPolicy:
        """The policy; ValueError unless the environment's observation and action are those that it was trained on.

        Entries of the same names in other scales, those of another arm, are brought to the policy's own from here on.
        """
        self._check_action(setup)
        self.ratio = self._ratio(setup)
        if setup.layout != self.meta["layout"] and self.ratio is None:
            raise ValueError(
                f"the policy was trained on {self.meta['env_id']} with observation layout {self.meta['layout']}; "
                f"this environment's is {setup.layout} ({setup.size} entries, other names or scales)"
            )
        taken, given = self.weights[0][0].shape[0], self.weights[-1][0].shape[1]
        if (taken, given) != (setup.size, setup.n_joints):
            raise ValueError(
                f"the policy makes {given} actions of {taken} entries of an observation; this environment's are "
                f"{setup.n_joints} and {setup.size}"
            )
        return self

    def _check_action(self, setup: Setup) -> None:
        """An action stands for what it stood for in training."""
        kwargs = {"action_mode": "torque", **self.meta.get("env_kwargs", {})}
        own: dict[str, Any] = {"action_mode": kwargs["action_mode"]}
        if own["action_mode"] == "residual_pd":
            share = kwargs.get("residual_share")
            own["residual_share"] = RESIDUAL_SHARE if share is None else share
        for name, value in own.items():
            given = getattr(setup, name)
            if setup.action_mode and value != given:
                raise ValueError(
                    f"the policy was trained with {name} = {value!r}; this environment's is {given!r}, in which its "
                    f"actions are other torques: make the environment with {name}={value!r}"
                )

    def _ratio(self, setup: Setup) -> NDArray[np.float64] | None:
        """The environment's scales over those of the arm that the policy was trained on; None where they are alike, and
        where the entries or the torques that actions stand for are not."""
        own = self.meta.get("scales", {})
        alike = tuple(own) == setup.names and self.meta.get("torque_limits") == list(setup.torque_limits)
        if setup.layout == self.meta["layout"] or not alike:
            return None
        return np.tile(np.divide(setup.scales, [own[name] for name in setup.names]), setup.history)


def load_policy(source: str | os.PathLike[str]) -> NumpyPolicy:
    """A policy from a policy.npz, a folder that holds one, or the name of one that comes with the package.

    Raises:
        ValueError: there is no such file, or it is damaged or of another format.
    """
    path = Path(source)
    if path.is_dir():
        path = path / "policy.npz"
    elif not path.exists() and str(source) in names():
        path = Path(str(HOME / str(source) / "policy.npz"))
    if not path.is_file():
        known = ", ".join(names())
        raise ValueError(
            f"{source}: no policy.npz there" + (f"; policies that come with the package: {known}" if known else "")
        )
    if path.suffix == ".zip":
        what = "a model of Stable-Baselines3 is a pickle, which is not read"
        raise ValueError(f"{path}: {what}; give its run folder or the policy.npz there, which flexarm train writes")
    arrays = read_npz(path, "policy", MOST_BYTES)
    with check.in_file(path):
        check.needed("", arrays, "meta", "this is no policy of this package")
        text = str(check.arrays(arrays, {"meta": ("text", ())}, {})["meta"])
        return _policy(check.table_of("meta", from_json(text, "meta")), arrays)


def _policy(meta: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> NumpyPolicy:
    """The policy in a file's content. ValueError names the entry, its value and what would be right."""
    for key in ("format", "env_id", "env_kwargs", "layout", "layers", "activation", "squash"):
        check.needed("meta", meta, key, "every policy says it")
    check.choice("meta.activation", meta["activation"], ACTIVATIONS)
    if meta["format"] != FORMAT:
        raise check.InvalidValue("meta.format", meta["format"], f"must be {FORMAT}, which this version reads")
    for key in ("env_id", "layout"):
        check.text(f"meta.{key}", meta[key], empty=False)
    check.table_of("meta.env_kwargs", meta["env_kwargs"])
    check.flag("meta.squash", meta["squash"])
    for name, scale in check.table_of("meta.scales", meta.get("scales", {})).items():
        check.number(f"meta.scales.{name}", scale, above=0.0)
    limits = check.sequence("meta.torque_limits", meta.get("torque_limits", ()), "numbers (N m)")
    for k, limit in enumerate(limits):
        check.number(f"meta.torque_limits[{k}]", limit, "N m", above=0.0)
    layers = check.integer("meta.layers", meta["layers"], minimum=1, maximum=MOST_LAYERS)
    table: dict[str, tuple[str, check.Shape]] = {}
    widths = ["entries", *(f"units {k}" for k in range(layers - 1)), "actions"]
    for k in range(layers):
        table |= {f"w{k}": ("finite", (widths[k], widths[k + 1])), f"b{k}": ("finite", (widths[k + 1],))}
    if "mean" in arrays:
        table |= {"mean": ("finite", ("entries",)), "variance": ("finite", ("entries",))}
        table |= {"clip": ("finite", ()), "epsilon": ("finite", ())}
    known = check.arrays(arrays, table, {})
    weights = [(known[f"w{k}"], known[f"b{k}"]) for k in range(layers)]
    if "mean" not in arrays:
        return NumpyPolicy(meta, weights)
    normaliser = {name: known[name] for name in ("mean", "variance", "clip", "epsilon")}
    for name in ("variance", "clip", "epsilon"):
        if not (normaliser[name] >= 0.0).all():
            raise check.InvalidValue(name, normaliser[name], "must not be negative")
    if not (normaliser["variance"] + normaliser["epsilon"] > 0.0).all():
        raise check.InvalidValue("variance", normaliser["variance"], "must be positive where epsilon is 0")
    return NumpyPolicy(meta, weights, normaliser)


def names() -> tuple[str, ...]:
    """Names of the policies that come with the package."""
    entries = HOME.iterdir() if HOME.is_dir() else ()
    return tuple(sorted(entry.name for entry in entries if (entry / "policy.npz").is_file()))
