"""A player for the browser: runs and episodes in one self-contained HTML file.

simulate(named("robot_arm_motion")).view().save("arm.html")
Player([quick.clip("8 segments"), exact.clip("exact beam")]).save("both.html")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .clip import Chart, Clip, Pull, magnified
    from .page import Player
    from .space import SpaceClip

_HOME = {**dict.fromkeys(("Chart", "Clip", "Pull", "magnified"), "clip"), "Player": "page", "SpaceClip": "space"}
"""Module that defines each public name. A trajectory uses none before it is displayed."""

__all__ = ["Chart", "Clip", "Player", "Pull", "SpaceClip", "magnified"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = getattr(import_module(f".{_HOME[name]}", __name__), name)
    return globals()[name]
