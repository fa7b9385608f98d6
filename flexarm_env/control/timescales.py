"""Time scales of an arm: quarter-turn time, and episode length, control period and discount factor derived from it."""

import math
from dataclasses import dataclass

from ..parameters import Arm
from ..rigid import rate_scale

SETTLED = 0.5
"""Time, s, for which the tip has to stay at a target to count as a success."""
TURNS, PERIODS = 2.0, 50.0
"""Quarter turns per episode, in addition to `SETTLED`; control periods per quarter turn."""
STEPS = (1.0, 2.0, 5.0)
"""Leading digits of suggested control periods."""


@dataclass(frozen=True)
class TimeScales:
    """Time scales of an arm with torque limits.

    Attributes:
        quarter_turns (N,): minimum time of a quarter turn of each joint from rest to rest, s. The torque is full and
            reversed midway, and the arm beyond the joint is straight and rigid. slew: the longest of these times, s.
        duration: duration of an episode, s. control_dt: control period, s. gamma: discount factor per control period,
            whose horizon dt/(1 - gamma) equals a slew.
    """

    quarter_turns: tuple[float, ...]
    slew: float
    duration: float
    control_dt: float
    gamma: float


def timescales(arm: Arm, control_dt: float | None = None) -> TimeScales:
    """Compute the time scales of an arm.

    control_dt: control period, s, for the discount factor; None: a suggested one.
    """
    # minimum time of a quarter turn, 2 sqrt(I (pi/2) / tau)
    quarters = tuple(math.pi / rate_scale(arm, k) for k in range(arm.n_links))
    slew = max(quarters)
    # rounded up to half a second
    duration = math.ceil(2.0 * (TURNS * slew + SETTLED)) / 2.0
    period = _leading(slew / PERIODS) if control_dt is None else control_dt
    return TimeScales(quarters, slew, duration, period, round(max(0.5, 1.0 - period / slew), 4))


def _leading(value: float) -> float:
    """Round a value down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(f"{max(step for step in STEPS if step * power <= value * (1.0 + 1e-9)) * power:.1g}")
