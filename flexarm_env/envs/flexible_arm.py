"""FlexibleArm-v0: one flexible link slews its tip to an angle and settles there."""

from __future__ import annotations

from .single import SingleArmEnv
from .task import SLEW
from .vector import VectorArmEnv


class FlexibleArmEnv(SingleArmEnv):
    """Slew and settle."""

    kind = SLEW


class FlexibleArmVectorEnv(VectorArmEnv):
    """Many FlexibleArm-v0 at once."""

    kind = SLEW
