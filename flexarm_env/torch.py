"""Differentiable arms in PyTorch: exact gradients of rewards, observations and states by actions and initial states.

    from flexarm_env.torch import DifferentiableArms
    arms = DifferentiableArms("FlexibleArm-v0", 64)
    state = arms.reset(seed=0)
    state, observation, reward = arms.step(state, policy(arms.observe(state)))
    reward.sum().backward()

The forward pass stores the state at the start of each control period. The backward pass simulates each period again
from the stored state to compute the period's derivatives.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import validation as check
from .derivatives import Arms, Differentiable

with check.needs("flexarm_env.torch", "torch", "train"):
    import torch
    from torch.autograd.function import once_differentiable

Tensor = torch.Tensor


class DifferentiableArms:
    """n arms of an environment, with methods `step` and `observe` that PyTorch can differentiate once.

    States are float64 tensors (n, S) on the CPU, which share memory with NumPy arrays. States and actions of another
    type are converted to float64; their gradients have the original type. Episodes do not end. Nothing is random after
    `reset`, and `reset` has no derivatives. To restart some of the arms, replace their states by new ones, for example
    by `torch.where`. Actions are clipped to +-1; derivatives by clipped actions are zero.

    Args:
        id: id of an environment of this package. n: number of arms. keywords: keywords of the environment and its
            solver. threads, parameters: as in `flexarm_env.derivatives.Arms`.
    Attributes:
        arms: the underlying `Arms` object, with names and sizes of states. n: number of arms. observation_space,
            action_space: Gymnasium spaces of one arm.
        failed (n,) bool: True for arms whose solver failed in the last `step`; the results of these arms are NaN.
        past (n,) bool: True for arms with a joint beyond its limits; the environment would end the episodes of these
            arms.
    Raises:
        ValueError: a feature of the environment has no derivatives (see `Arms`), or a tensor has a wrong shape or is
            not on the CPU.
    """

    def __init__(self, id: str, n: int, **keywords: Any) -> None:
        self.arms = Arms(id, n, **keywords)
        self.n = self.arms.n
        self._store_flags()
        self.observation_space, self.action_space = self.arms.observation_space, self.arms.action_space

    def _store_flags(self) -> None:
        """Copy the flags `failed` and `past` of the last step, because a backward pass changes those of `arms`."""
        self.failed, self.past = torch.tensor(self.arms.failed), torch.tensor(self.arms.past)

    def reset(self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> Tensor:
        """Start an episode of each arm; return the states (n, S). seed, options: as in a vector environment."""
        return torch.from_numpy(self.arms.reset(seed, options))

    def observe(self, state: Tensor) -> Tensor:
        """Return the observations (n, O) of states (n, S)."""
        seen: Tensor = _Observe.apply(self.arms, state)
        return seen

    def step(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Advance one control period from a state (n, S) with an action (n, A).

        Returns the new state (n, S), the observation (n, O) and the reward (n,).
        """
        after, seen, paid = _Step.apply(self.arms, state, action)
        self._store_flags()
        return after, seen, paid

    def close(self) -> None:
        """Stop the threads that step the arms."""
        self.arms.close()


def _numbers(name: str, value: Tensor) -> NDArray[np.float64]:
    """Return a tensor's numbers as a float64 array, without a copy if they already are float64."""
    if not isinstance(value, Tensor) or value.is_complex():
        raise check.InvalidValue(name, value, "must be a tensor of real numbers")
    if value.device.type != "cpu":
        raise check.InvalidValue(f"{name}.device", str(value.device), "must be cpu, where the arms are")
    numbers: NDArray[np.float64] = value.detach().to(torch.float64).numpy()
    return numbers


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, arms: Differentiable, state: Tensor, action: Tensor) -> tuple[Tensor, ...]:
        outcome = arms.step(_numbers("state", state), _numbers("action", action))
        ctx.arms, ctx.step_ends = arms, getattr(arms, "step_ends", None)
        ctx.save_for_backward(state, action)
        return tuple(torch.from_numpy(x) for x in outcome)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_state: Tensor, by_seen: Tensor, by_paid: Tensor) -> tuple[None, Tensor, Tensor]:
        state, action = ctx.saved_tensors
        began = _numbers("state", state), _numbers("action", action)
        more: dict[str, Any] = {} if ctx.step_ends is None else {"step_ends": ctx.step_ends}
        back, by_action = ctx.arms.vjp(*began, by_state.numpy(), by_seen.numpy(), by_paid.numpy(), **more)
        return None, torch.from_numpy(back).to(state.dtype), torch.from_numpy(by_action).to(action.dtype)


class _Observe(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, arms: Differentiable, state: Tensor) -> Tensor:
        seen = arms.observe(_numbers("state", state))
        ctx.arms = arms
        ctx.save_for_backward(state)
        return torch.from_numpy(seen)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_seen: Tensor) -> tuple[None, Tensor]:
        (state,) = ctx.saved_tensors
        slopes = ctx.arms.observe_jacobian(_numbers("state", state))[1]
        back = (by_seen.numpy()[:, None, :] @ slopes)[:, 0]
        return None, torch.from_numpy(back).to(state.dtype)


__all__ = ["DifferentiableArms"]
