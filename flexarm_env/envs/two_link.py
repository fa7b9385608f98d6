"""TwoLinkFlexArm-v0: two flexible links bring their tip to a point and settle there."""

from __future__ import annotations

from .single import SingleArmEnv
from .task import REACH
from .vector import VectorArmEnv


class TwoLinkFlexArmEnv(SingleArmEnv):
    """Reach and settle."""

    kind = REACH


class TwoLinkFlexArmVectorEnv(VectorArmEnv):
    """Many TwoLinkFlexArm-v0 at once."""

    kind = REACH
