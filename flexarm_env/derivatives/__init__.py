"""Exact derivatives of control periods, for many arms at once."""

from .arms import Arms
from .period import Differentiable, Jacobians, Periods
from .rollouts import Gradient, Outcome, Rollout, rollout

__all__ = ["Arms", "Differentiable", "Gradient", "Jacobians", "Outcome", "Periods", "Rollout", "rollout"]
