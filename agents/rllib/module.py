"""The network that RLlib trains, and its conversion to a policy that needs only NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.columns import Columns
from torch import nn

from flexarm_env.control import NumpyPolicy
from flexarm_env.control.policy import FORMAT
from flexarm_env.training.export_policy import TOLERANCE, weights_of


class FreeDeviationModule(DefaultPPOTorchRLModule):
    """RLlib's network for PPO, whose standard deviation of the actions is a parameter with a given initial value.

    model_config: RLlib's own keys and "log_std_init", the logarithm of the initial standard deviation.
    """

    def setup(self) -> None:
        """Build the networks; initialize orthogonal weights, small in the action layer, and zero biases."""
        super().setup()
        with torch.no_grad():
            for part, last in ((self.encoder, 2**0.5), (self.pi, 0.01), (self.vf, 1.0)):
                for layer in part.modules():
                    if isinstance(layer, nn.Linear):
                        nn.init.orthogonal_(layer.weight, last)
                        layer.bias.zero_()
            self.pi.log_std.fill_(float(self.model_config["log_std_init"]))


def deviation(module: Any) -> float:
    """Return the standard deviation of the actions, averaged over their entries."""
    return float(torch.exp(module.pi.log_std.detach()).mean())


def numpy_policy(module: Any, meta: Mapping[str, Any]) -> NumpyPolicy:
    """Convert a module's deterministic policy to a `NumpyPolicy`. ValueError if both policies give different actions.

    meta: entries of the policy file besides the network, such as the environment.
    """
    weights = weights_of([*module.encoder.actor_encoder.modules(), *module.pi.modules()])
    activation = module.model_config["fcnet_activation"]
    own = {"format": FORMAT, "layers": len(weights), "activation": activation, "squash": False}
    policy = NumpyPolicy({**meta, **own}, weights)
    off = difference(policy, module)
    if off > TOLERANCE:
        raise ValueError(f"the exported policy differs by {off:.1e} from the module, more than {TOLERANCE:.0e}")
    return policy


def difference(policy: NumpyPolicy, module: Any, n: int = 1024, seed: int = 0) -> float:
    """Return the largest difference between a NumPy policy's and a module's actions, on n random observations."""
    bounds = np.minimum(module.observation_space.high, 3.0)
    observations = np.random.default_rng(seed).uniform(-bounds, bounds, (n, len(bounds))).astype(np.float32)
    with torch.no_grad():
        inputs = module.forward_inference({Columns.OBS: torch.from_numpy(observations)})[Columns.ACTION_DIST_INPUTS]
    mean = inputs.numpy()[:, : inputs.shape[1] // 2]
    return float(np.abs(policy.act(observations) - np.clip(mean, -1.0, 1.0)).max())
