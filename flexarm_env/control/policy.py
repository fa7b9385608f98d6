"""Trained policies run with NumPy alone: a small network from a `policy.npz` file.

The file holds `meta` (JSON: format, env_id, env_kwargs, layout, activation, squash, versions, and what else the run
says of itself), weights `w0`, `b0`, `w1`, ... (float32; layer k maps x to x w + b), and, where observations were
normalised, `mean`, `variance` (float64), `clip` and `epsilon`.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import Setup

Array32 = NDArray[np.float32]

FORMAT = 1
ACTIVATIONS = ("tanh", "relu")


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

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Nothing to remember."""

    def act(self, observation: NDArray[np.floating]) -> Array32:
        """Actions in [-1, 1], (n, N), or (N,) for a single observation."""
        x = np.asarray(observation)
        if self.normaliser is not None:
            n = self.normaliser
            x = np.clip((x - n["mean"]) / np.sqrt(n["variance"] + n["epsilon"]), -n["clip"], n["clip"])
        x = x.astype(np.float32)
        for w, b in self.weights[:-1]:
            x = x @ w + b
            x = np.tanh(x) if self.meta["activation"] == "tanh" else np.maximum(x, np.float32(0.0))
        w, b = self.weights[-1]
        x = x @ w + b
        action: Array32 = np.tanh(x) if self.meta["squash"] else np.clip(x, np.float32(-1.0), np.float32(1.0))
        return action

    def check(self, setup: Setup) -> None:
        """ValueError unless the environment's observation is laid out as the one that the policy was trained on."""
        if setup.layout != self.meta["layout"]:
            raise ValueError(
                f"the policy was trained on {self.meta['env_id']} with observation layout {self.meta['layout']}; "
                f"this environment's is {setup.layout} ({len(setup.names)} entries, other names or scales)"
            )


def load_policy(source: str | os.PathLike[str]) -> NumpyPolicy:
    """A policy from a policy.npz, a folder that holds one, or the name of one that comes with the package.

    Raises:
        ValueError: there is no such file, or it is damaged or of another format.
    """
    path = Path(source)
    if path.is_dir():
        path = path / "policy.npz"
    elif not path.exists() and str(source) in names():
        path = Path(str(_home() / str(source) / "policy.npz"))
    if not path.is_file():
        known = ", ".join(names())
        raise ValueError(
            f"{source}: no policy.npz there" + (f"; policies that come with the package: {known}" if known else "")
        )
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {key: data[key] for key in data.files}
        meta = json.loads(str(arrays["meta"]))
        layers = int(meta["layers"])
        weights = [(arrays[f"w{k}"], arrays[f"b{k}"]) for k in range(layers)]
        normaliser = {k: arrays[k] for k in ("mean", "variance", "clip", "epsilon")} if "mean" in arrays else None
        good = meta["format"] == FORMAT and meta["activation"] in ACTIVATIONS and bool(weights)
        good = good and all(np.isfinite(w).all() and np.isfinite(b).all() for w, b in weights)
        needed = [meta[key] for key in ("env_id", "env_kwargs", "layout", "squash")]
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: damaged, or no policy of this package ({type(error).__name__})") from error
    if not good or not needed:
        raise ValueError(
            f"{path}: its format is {meta.get('format')!r}, or its weights are not finite; expected {FORMAT}"
        )
    return NumpyPolicy(meta, weights, normaliser)


def names() -> tuple[str, ...]:
    """Names of the policies that come with the package."""
    home = _home()
    if not home.is_dir():
        return ()
    return tuple(sorted(entry.name for entry in home.iterdir() if (entry / "policy.npz").is_file()))


def _home() -> Any:
    return resources.files("flexarm_env") / "data" / "policies"
