"""A player of simulations and episodes for web browsers, in one HTML file that needs no network.

    simulate(named("robot_arm_motion")).view().save("arm.html")
    Player([quick.clip("8 segments"), exact.clip("exact beam")]).save("both.html")
"""

from .clip import Chart, Clip, Pull, magnified
from .page import Player
from .space import SpaceClip

__all__ = ["Chart", "Clip", "Player", "Pull", "SpaceClip", "magnified"]
