"""Write a trained Stable-Baselines3 policy as policy.npz, which runs with NumPy alone.

python -m flexarm_env.training.export_policy --run runs/ppo-FlexibleArm-v0-0
"""

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.control import NumpyPolicy
from flexarm_env.control.policy import AroundPolicy, format_of, of_network
from flexarm_env.training.runs import OF_POLICY, command, load_model, read_run, versions, write_whole
from flexarm_env.validation import Array32

TOLERANCE = 1e-5
UNEXPORTED = ("recurrent_ppo",)
"""Algorithms whose policies have a memory, which policy.npz does not support."""


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m flexarm_env.training.export_policy`.

    Args:
        run: folder of a training run.
    """

    run: Path


def weights_of(layers: Iterable[Any]) -> list[tuple[Array32, Array32]]:
    """Return weights (in, out) and biases (out,) of PyTorch's linear layers as float32 arrays."""
    from torch import nn

    return [
        (layer.weight.detach().numpy().T.astype(np.float32), layer.bias.detach().numpy().astype(np.float32))
        for layer in layers
        if isinstance(layer, nn.Linear)
    ]


def numpy_policy(model: Any, meta: Mapping[str, Any], normaliser: Any = None) -> NumpyPolicy:
    """Convert a PPO, SAC or TQC model to its deterministic NumPy policy.

    normaliser: the model's VecNormalize, or None.
    """
    from torch import nn

    policy = model.policy
    actor = getattr(policy, "actor", None)
    # the actor's layers: SAC and TQC squash the mean with tanh, PPO clips it
    if actor is not None:
        layers, squash = [*actor.latent_pi, actor.mu], True
    else:
        layers, squash = [*policy.mlp_extractor.policy_net, policy.action_net], False
    kinds = {type(layer) for layer in layers if not isinstance(layer, nn.Linear)}
    if kinds - {nn.Tanh, nn.ReLU} or len(kinds) > 1:
        raise ValueError(f"policy_kwargs.activation_fn: only Tanh or ReLU can be exported, not {kinds}")
    weights, statistics = weights_of(layers), None
    if normaliser is not None and normaliser.norm_obs:
        statistics = {
            "mean": normaliser.obs_rms.mean.copy(),
            "variance": normaliser.obs_rms.var.copy(),
            "clip": np.float64(normaliser.clip_obs),
            "epsilon": np.float64(normaliser.epsilon),
        }
    activation = "relu" if nn.ReLU in kinds else "tanh"
    own = {"format": format_of(meta), "layers": len(weights), "activation": activation, "squash": squash}
    return of_network({**meta, **own}, weights, statistics)


def save(policy: NumpyPolicy, path: Path) -> None:
    """Write the file policy.npz atomically."""
    arrays: dict[str, Any] = {"meta": np.array(json.dumps(policy.meta))}
    for k, (w, b) in enumerate(policy.weights):
        arrays[f"w{k}"], arrays[f"b{k}"] = w, b
    arrays |= policy.normaliser or {}
    write_whole(path, lambda part: np.savez(part, **arrays))


def difference(policy: NumpyPolicy, model: Any, normaliser: Any = None, n: int = 4096, seed: int = 0) -> float:
    """Return the largest difference between the actions of model and exported policy on n random observations."""
    rng = np.random.default_rng(seed)
    # random observations, normalized as in training
    bounds = np.minimum(model.observation_space.high, 3.0)
    observations = rng.uniform(-bounds, bounds, (n, len(bounds))).astype(np.float32)
    seen = observations if normaliser is None else normaliser.normalize_obs(observations)
    theirs = model.predict(seen, deterministic=True)[0]
    ours = policy.network(observations) if isinstance(policy, AroundPolicy) else policy.act(observations)
    return float(np.abs(ours - theirs).max())


def export(run: Path) -> float:
    """Export a run folder's model to policy.npz.

    Return the largest difference between the actions of the model and the actions of the exported policy.
    """
    record = read_run(run)
    model, normaliser = load_model(run, record["algorithm"])
    meta = {key: record[key] for key in OF_POLICY if key in record}  # older runs have fewer
    policy = numpy_policy(model, {**meta, "versions": versions()}, normaliser)
    off = difference(policy, model, normaliser)
    if not off <= TOLERANCE:
        raise ValueError(f"{run}: the exported policy differs by {off:.1e} from the model, more than {TOLERANCE:.0e}")
    save(policy, run / "policy.npz")
    return off


def run_export(arguments: Arguments) -> None:
    """Export the policy, and print the largest difference between the actions."""
    print(f"{arguments.run / 'policy.npz'}: largest difference from the model {export(arguments.run):.1e}")


main = partial(command, Arguments, "python -m flexarm_env.training.export_policy", __doc__, run_export)


if __name__ == "__main__":
    sys.exit(main())
