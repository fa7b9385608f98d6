"""Exact derivatives of control periods, of many arms at once."""

from __future__ import annotations

from .period import Arms, Jacobians

__all__ = ["Arms", "Jacobians"]
