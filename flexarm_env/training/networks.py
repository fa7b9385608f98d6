"""Forward and backward passes of small networks in NumPy, with parameters in the memory of a PyTorch module.

For small networks PyTorch's overhead per operation exceeds the time of the arithmetic. The PyTorch module contains the
learned parameters and is saved, loaded and evaluated as usual.
"""

from typing import Any

import numpy as np

from flexarm_env.validation import Array32

DECAY, SQUARES, FLOOR = 0.9, 0.999, 1e-5
"""Adam's beta_1, beta_2 and epsilon (Kingma & Ba 2015)."""


class Parameters:
    """PyTorch parameters, moved into one contiguous array with which they share memory.

    Attributes:
        values (n,): all parameters. gradient (n,): gradient, written by the caller. memory (2 n + 1,): Adam's moments
            and step count.
    """

    def __init__(self, tensors: list[Any]) -> None:
        """Copy the tensors into one array and make them views of it."""
        import torch

        sizes = [tensor.numel() for tensor in tensors]
        self.values = np.concatenate([tensor.detach().numpy().ravel() for tensor in tensors])
        self.gradient = np.zeros_like(self.values)
        self.memory = np.zeros(2 * len(self.values) + 1)
        ends = np.cumsum(sizes)
        self._slices = [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
        for tensor, own in zip(tensors, self._slices, strict=True):
            tensor.data = torch.from_numpy(self.values[own]).view(tensor.shape)
        self._shapes = [tuple(tensor.shape) for tensor in tensors]

    def views(self, of: Array32) -> list[Array32]:
        """Return views of the array `of`: one view for each parameter, with the parameter's shape.

        The array has the layout of `values`.
        """
        return [of[own].reshape(shape) for own, shape in zip(self._slices, self._shapes, strict=True)]

    def descend(self, rate: float, most: float | None = None) -> float:
        """Take one Adam step with the gradient clipped to norm `most`; return the norm before clipping.

        No step is taken if the gradient is not finite. rate: learning rate.
        """
        size = len(self.values)
        mean, square = self.memory[:size], self.memory[size:-1]
        g = self.gradient
        length = float(np.sqrt(np.dot(g, g)))
        if not np.isfinite(length):
            return length
        if most is not None and length > most:
            g = g * np.float32(most / length)
        # Adam with bias correction
        self.memory[-1] += 1.0
        count = self.memory[-1]
        mean += (1.0 - DECAY) * (g - mean)
        square += (1.0 - SQUARES) * (g * g - square)
        self.values -= rate * (mean / (1.0 - DECAY**count)) / (np.sqrt(square / (1.0 - SQUARES**count)) + FLOOR)
        return length


class Network:
    """Chain of linear layers with tanh or ReLU between them.

    Args:
        layers: torch.nn.Linear, from the observation to the output. relu: True for ReLU, False for tanh. more:
            further parameters that are learned together with the layers.
    """

    def __init__(self, layers: list[Any], relu: bool, more: tuple[Any, ...] = ()) -> None:
        """Collect the parameters, and views of weights, biases and their gradients."""
        self.parameters = Parameters([t for layer in layers for t in (layer.weight, layer.bias)] + list(more))
        self.relu, count = relu, 2 * len(layers)
        values, slopes = (self.parameters.views(x) for x in (self.parameters.values, self.parameters.gradient))
        self.weights, self.biases = values[0:count:2], values[1:count:2]
        self.more, self.more_slopes = values[count:], slopes[count:]
        self._slopes = list(zip(slopes[0:count:2], slopes[1:count:2], strict=True))

    def forward(self, x: Array32) -> tuple[Array32, list[Array32]]:
        """Return the output (n, out) for inputs x (n, in), and the input of each layer."""
        inputs = [x]
        for w, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = x @ w.T
            x += b
            np.maximum(x, 0.0, out=x) if self.relu else np.tanh(x, out=x)
            inputs.append(x)
        return x @ self.weights[-1].T + self.biases[-1], inputs

    def backward(self, slope: Array32, inputs: list[Array32]) -> tuple[Array32, list[Array32]]:
        """Return the objective's derivatives by the network's input (n, in) and by the output of each layer.

    slope (n, out): derivatives of the objective by the network's output. inputs: each layer's inputs, from `forward`.
        """
        slopes = [slope]
        for k in range(len(self.weights) - 1, 0, -1):
            slope = slope @ self.weights[k]
            # derivative of the activation, from its output
            slope *= (inputs[k] > 0.0) if self.relu else 1.0 - inputs[k] * inputs[k]
            slopes.append(slope)
        return slope @ self.weights[0], slopes[::-1]

    def note(self, inputs: list[Array32], slopes: list[Array32]) -> None:
        """Write the objective's gradient by weights and biases, summed over the n rows, into `parameters.gradient`.

    inputs: each layer's inputs, from `forward`. slopes: derivatives by each layer's outputs, from `backward`.
        """
        for (w, b), x, slope in zip(self._slopes, inputs, slopes, strict=True):
            np.matmul(slope.T, x, out=w)
            slope.sum(axis=0, out=b)


def of_policy(policy: Any) -> tuple[Network, Network]:
    """Return the actor, with its log standard deviation, and the critic of a Stable-Baselines3 actor-critic policy.

    Raises ValueError for networks with activations other than Tanh or ReLU.
    """
    from torch import nn

    parts = policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net
    found = []
    for part, head, more in zip(parts, (policy.action_net, policy.value_net), ((policy.log_std,), ()), strict=True):
        kinds = {type(layer) for layer in part if not isinstance(layer, nn.Linear)}
        if kinds - {nn.Tanh, nn.ReLU} or len(kinds) > 1:
            raise ValueError(f"policy_kwargs.activation_fn: must be Tanh or ReLU, not {kinds}")
        layers = [layer for layer in (*part, head) if isinstance(layer, nn.Linear)]
        found.append(Network(layers, nn.ReLU in kinds, more))
    return found[0], found[1]
