"""Arms in PyTorch, differentiated exactly: gradients of rewards, observations and states by actions and states.

    from flexarm_env.torch import DifferentiableArms
    arms = DifferentiableArms("FlexibleArm-v0", 64)
    state = arms.reset(seed=0)
    state, observation, reward = arms.step(state, policy(arms.observe(state)))
    reward.sum().backward()

A period's derivative is computed on the way back, from the state that it began in: memory is that of the states.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import validation as check
from .derivatives import Arms

with check.needs("flexarm_env.torch", "torch", "train"):
    import torch
    from torch.autograd.function import once_differentiable

Tensor = torch.Tensor


class DifferentiableArms:
    """n arms of an environment, one row of a state each; `step` and `observe` can be differentiated, once.

    Tensors are float64 on the CPU and share their memory with NumPy; states and actions of another type are converted,
    and have gradients of their own type. Nothing ends and nothing is drawn within an episode, and no derivative passes
    a `reset`: which arms begin anew, and when, is the caller's to say, who puts rows of fresh states in place of old
    ones (`torch.where`). Actions are clipped to +-1, beyond which nothing depends on them.

    Args:
        id: of an environment of this package. n: how many arms. keywords: of the environment and its solver; threads,
        parameters: see `flexarm_env.derivatives.Arms`.
    Attributes:
        arms: the same in NumPy (names and sizes of states). n. observation_space, action_space: of one arm.
        failed, past (n,) bool: after `step`, whose solver failed (its numbers are NaN), and who was beyond a joint's
        limits, where the environment's episodes end.
    Raises:
        ValueError: what cannot be differentiated; tensors of wrong shapes, or not on the CPU.
    """

    def __init__(self, id: str, n: int, **keywords: Any) -> None:
        self.arms = Arms(id, n, **keywords)
        self.n = self.arms.n
        self._store_flags()
        self.observation_space, self.action_space = self.arms.observation_space, self.arms.action_space

    def _store_flags(self) -> None:
        """Note what became of the arms: going back through steps says so of others."""
        self.failed, self.past = torch.tensor(self.arms.failed), torch.tensor(self.arms.past)

    def reset(self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> Tensor:
        """Fresh starts, those of the vector environment with this seed and these options: states (n, S)."""
        return torch.from_numpy(self.arms.reset(seed, options))

    def observe(self, state: Tensor) -> Tensor:
        """What is to be seen (n, O) of states (n, S)."""
        seen: Tensor = _Observe.apply(self.arms, state)
        return seen

    def step(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (n, S), observation (n, O) and reward (n,) a control period later, under an action (n, A)."""
        after, seen, paid = _Step.apply(self.arms, state, action)
        self._store_flags()
        return after, seen, paid

    def close(self) -> None:
        """Let the threads go."""
        self.arms.close()


def _numbers(name: str, value: Tensor) -> NDArray[np.float64]:
    """Return a tensor's numbers as float64, without a copy if they are."""
    if not isinstance(value, Tensor) or value.is_complex():
        raise check.InvalidValue(name, value, "must be a tensor of real numbers")
    if value.device.type != "cpu":
        raise check.InvalidValue(f"{name}.device", str(value.device), "must be cpu, where the arms are")
    numbers: NDArray[np.float64] = value.detach().to(torch.float64).numpy()
    return numbers


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, arms: Arms, state: Tensor, action: Tensor) -> tuple[Tensor, ...]:
        outcome = arms.step(_numbers("state", state), _numbers("action", action))
        ctx.arms = arms
        ctx.save_for_backward(state, action)
        return tuple(torch.from_numpy(x) for x in outcome)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_state: Tensor, by_seen: Tensor, by_paid: Tensor) -> tuple[None, Tensor, Tensor]:
        state, action = ctx.saved_tensors
        began = _numbers("state", state), _numbers("action", action)
        back, by_action = ctx.arms.vjp(*began, by_state.numpy(), by_seen.numpy(), by_paid.numpy())
        return None, torch.from_numpy(back).to(state.dtype), torch.from_numpy(by_action).to(action.dtype)


class _Observe(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, arms: Arms, state: Tensor) -> Tensor:
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
