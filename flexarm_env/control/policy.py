"""Trained policies that need only NumPy: a small network from a `policy.npz` file.

A policy.npz file contains three groups of entries. `meta` is JSON: format, env_id, env_kwargs, layout, activation,
squash, versions, and data of the training run. If `meta` contains `torque_limits` and the `scales` of the observation's
entries, the policy can also control other arms. `w0`, `b0`, `w1`, ... are the weights and biases of the layers
(float32; layer k maps x to x w + b). `mean`, `variance` (float64), `clip` and `epsilon` exist if observations are
normalized. The file contains only numbers and text, so that loading it executes no code. Loading a pickle (a model.zip,
a checkpoint) can execute code.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import from_json, read_npz
from ..validation import Array32
from .around import Inside
from .base import RESIDUAL_SHARE, Controller, Setup
from .catalogue import Following

FORMAT, FORMAT_AROUND = 1, 2
"""Formats of files: network alone, and network with a controller inside."""
ACTIVATIONS = ("tanh", "relu")
MOST_LAYERS, MOST_BYTES = 100, 2**28
HOME = resources.files("flexarm_env") / "data" / "policies"


class NumpyPolicy:
    """Deterministic policy network that maps observations to actions.

    Args:
        meta: entry `meta` of the file, as described for the module. weights: list of pairs (w, b), one per layer,
            float32. normaliser: dict with mean, variance, clip and epsilon, or None.
    """

    def __init__(
        self,
        meta: Mapping[str, Any],
        weights: list[tuple[Array32, Array32]],
        normaliser: Mapping[str, Any] | None = None,
    ) -> None:
        """Store metadata, weights and statistics; layers are evaluated in float64."""
        self.meta, self.weights, self.normaliser = dict(meta), weights, normaliser
        self.ratio: NDArray[np.float64] | None = None  # the environment's scales over the policy's own
        self._layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in weights]

    @property
    def size(self) -> int:
        """Number of entries of an observation."""
        return int(self.weights[0][0].shape[0])

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Do nothing, because the policy has no memory."""

    def act(self, observation: NDArray[np.floating]) -> Array32:
        """Compute actions in [-1, 1], (n, N), or (N,) for a single observation.

        The network is evaluated in float64, so that an action does not depend on the batch size. Raises ValueError for
        an observation of another size.
        """
        return self._decided(self._seen(observation))

    def _seen(self, observation: NDArray[np.floating]) -> NDArray[np.float64]:
        """Convert an observation to the policy's own scales and normalize it."""
        x = check.floats("observation", observation)
        if x.shape[-1:] != (self.size,):
            raise check.InvalidValue("shape of observation", x.shape, f"must be (n, {self.size})")
        # from the environment's scales to the policy's
        if self.ratio is not None:
            x = x * self.ratio
        # (x - mean) / sqrt(variance + epsilon), clipped
        if self.normaliser is not None:
            n = self.normaliser
            x = np.clip((x - n["mean"]) / np.sqrt(n["variance"] + n["epsilon"]), -n["clip"], n["clip"])
        return x

    def _decided(self, x: NDArray[np.float64]) -> Array32:
        """Evaluate the layers; return actions (..., N) for the normalized observation."""
        for w, b in self._layers[:-1]:
            x = x @ w + b
            x = np.tanh(x) if self.meta["activation"] == "tanh" else np.maximum(x, 0.0)
        w, b = self._layers[-1]
        x = x @ w + b
        action = np.tanh(x) if self.meta["squash"] else np.clip(x, -1.0, 1.0)
        return action.astype(np.float32)

    def bound(self, env: Any) -> NumpyPolicy:
        """Return the policy for an environment or vector environment; raise ValueError if it does not fit (`check`)."""
        return self.check(Setup.of(env))

    def check(self, setup: Setup) -> NumpyPolicy:
        """Return the policy; raise ValueError if observations or actions have a different meaning than in training.

        The observation of another arm can have the same entries with other scales than in training. If the scales
        differ, the policy converts observations to the scales of training.
        """
        self.ratio = fitted(self.meta, setup, self.size, self.weights[-1][0].shape[1])
        return self


class AroundPolicy(NumpyPolicy):
    """Policy with a network and a controller: action = clip(controller's action + share * network's action).

    `bound` creates the controller for an environment.
    """

    def __init__(
        self,
        meta: Mapping[str, Any],
        weights: list[tuple[Array32, Array32]],
        normaliser: Mapping[str, Any] | None = None,
    ) -> None:
        """Store the network and the controller's record; see `NumpyPolicy`.

        Raises ValueError for invalid `meta["around"]`.
        """
        super().__init__(meta, weights, normaliser)
        self.inside = Inside.read(meta["around"])
        self.controller: Controller | Following | None = None

    def bound(self, env: Any) -> NumpyPolicy:
        """Return the policy with a controller for the environment; raise ValueError if one of them does not fit."""
        found = AroundPolicy(self.meta, self.weights, self.normaliser)
        found.check(Setup.of(env))
        found.controller = self.inside.made(env)
        return found

    def network(self, observation: NDArray[np.floating]) -> Array32:
        """Compute the network's actions without the controller's actions."""
        return super().act(observation)

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Reset the controller with the first observations of episodes."""
        self._own().reset(observation)

    def act(self, observation: NDArray[np.floating]) -> Array32:
        """Compute actions in [-1, 1], (n, N), or (N,) for a single observation; call once per control period."""
        return self.inside.actions(self._own(), observation, self.network(observation))

    def _own(self) -> Controller | Following:
        """Return the controller inside the policy; raise RuntimeError before `bound`."""
        if self.controller is None:
            what = f"the policy has the controller {self.inside.controller} inside, which needs its environment"
            raise RuntimeError(f"{what}: load_policy(name, env)")
        return self.controller


def of_network(
    meta: Mapping[str, Any], weights: list[tuple[Array32, Array32]], normaliser: Mapping[str, Any] | None = None
) -> NumpyPolicy:
    """Create a `NumpyPolicy`, or an `AroundPolicy` if `meta` has the entry `around`."""
    kind = AroundPolicy if "around" in meta else NumpyPolicy
    return kind(meta, weights, normaliser)


def format_of(meta: Mapping[str, Any]) -> int:
    """Return the format number of the file of a policy with this `meta`."""
    return FORMAT_AROUND if "around" in meta else FORMAT


def fitted(meta: Mapping[str, Any], setup: Setup, size: int, joints: int) -> NDArray[np.float64] | None:
    """Verify by a file's `meta` that a policy for `size` observation entries and `joints` actions fits an environment.

    Returns:
        The environment's scales divided by the scales in `meta`; None if the scales are equal.
    Raises:
        ValueError: actions or entries have another meaning than in training.
    """
    _check_action(meta, setup)
    ratio = _ratio(meta, setup)
    if meta.get("layout", setup.layout) != setup.layout and ratio is None:
        raise ValueError(
            f"the policy was trained on {meta['env_id']} with observation layout {meta['layout']}; "
            f"this environment's is {setup.layout} ({setup.size} entries, other names or scales)"
        )
    if (size, joints) != (setup.size, setup.n_joints):
        raise ValueError(
            f"the policy makes {joints} actions of {size} entries of an observation; this environment's are "
            f"{setup.n_joints} and {setup.size}"
        )
    return ratio


def _check_action(meta: Mapping[str, Any], setup: Setup) -> None:
    """Raise ValueError unless an action means the same in the environment as in training."""
    if "env_kwargs" not in meta:  # of a bare model, of which nothing is known
        return
    kwargs = {"action_mode": "torque", **meta["env_kwargs"]}
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


def _ratio(meta: Mapping[str, Any], setup: Setup) -> NDArray[np.float64] | None:
    """Return the environment's scales divided by the training arm's.

    The result is None if the scales are equal, or if the entries' names or the torque limits differ.
    """
    own = meta.get("scales", {})
    alike = tuple(own) == setup.names and meta.get("torque_limits") == list(setup.torque_limits)
    if setup.layout == meta.get("layout") or not alike:
        return None
    return np.tile(np.divide(setup.scales, [own[name] for name in setup.names]), setup.history)


def load_npz(path: Path) -> NumpyPolicy:
    """Load the policy in a policy.npz file. Raises ValueError for a damaged file or another format."""
    arrays = read_npz(path, "policy", MOST_BYTES)
    with check.in_file(path):
        check.needed("", arrays, "meta", "this is no policy of this package")
        text = str(check.arrays(arrays, {"meta": ("text", ())}, {})["meta"])
        return policy_from(check.table_of("meta", from_json(text, "meta")), arrays)


def policy_from(meta: dict[str, Any], arrays: Mapping[str, NDArray[Any]], bound: bool = True) -> NumpyPolicy:
    """Create the policy from a file's content. bound: True if the file must name its training environment.

    Raises ValueError for invalid content; the message names the entry, its value and the rule.
    """
    of_training = ("env_id", "env_kwargs", "layout") if bound else ()
    for key in ("format", *of_training, "layers", "activation", "squash"):
        check.needed("meta", meta, key, "every policy says it")
    check.choice("meta.activation", meta["activation"], ACTIVATIONS)
    if meta["format"] != format_of(meta):
        what = f"must be {FORMAT}, or {FORMAT_AROUND} with an entry around, which this version reads"
        raise check.InvalidValue("meta.format", meta["format"], what)
    for key in ("env_id", "layout") if bound else ():
        check.text(f"meta.{key}", meta[key], empty=False)
    check.table_of("meta.env_kwargs", meta["env_kwargs"] if bound else {})
    check.table_of("meta.asked", meta.get("asked", {}))
    check.flag("meta.squash", meta["squash"])
    if "around" in meta:
        with check.under("meta"):
            Inside.read(meta["around"])
    for name, scale in check.table_of("meta.scales", meta.get("scales", {})).items():
        check.number(f"meta.scales.{name}", scale, above=0.0)
    # units of actions, N m
    limits = check.sequence("meta.torque_limits", meta.get("torque_limits", ()), "numbers (N m)")
    for k, limit in enumerate(limits):
        check.number(f"meta.torque_limits[{k}]", limit, "N m", above=0.0)
    # shapes of all arrays; widths have to match from layer to layer
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
        return of_network(meta, weights)
    normaliser = {name: known[name] for name in ("mean", "variance", "clip", "epsilon")}
    for name in ("variance", "clip", "epsilon"):
        if not (normaliser[name] >= 0.0).all():
            raise check.InvalidValue(name, normaliser[name], "must not be negative")
    if not (normaliser["variance"] + normaliser["epsilon"] > 0.0).all():
        raise check.InvalidValue("variance", normaliser["variance"], "must be positive where epsilon is 0")
    return of_network(meta, weights, normaliser)


def names() -> tuple[str, ...]:
    """Return the names of the trained policies in the package."""
    entries = HOME.iterdir() if HOME.is_dir() else ()
    return tuple(sorted(entry.name for entry in entries if (entry / "policy.npz").is_file()))
