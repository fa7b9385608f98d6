"""Gain and delay margins of controllers, and warnings if an environment's delay exceeds the delay margin."""

import math
import warnings
from dataclasses import dataclass
from typing import Any

from .arm_model import arm_model, linear_model
from .base import Setup
from .loop import Law, delay_margin, gain_margin, observer_law, pd_law, plant, radius
from .lqr import LQRGains, design, spread_of
from .pd import PDGains, postures_of

SAFE = 0.6
"""A loop vibrates too long to settle if its delay exceeds `SAFE` times the delay margin."""


DOUBLES = 60.0
"""Time, s, in which a vibration that grows must double to be reported. Slower growth does not matter to episodes."""

MARGINS_OF = ("pd", "zvd", "lqr", "time_optimal")
"""Controllers of planar arms whose margins are computed here."""


@dataclass(frozen=True)
class Margins:
    """Smallest margins of a controller over all postures.

    gain: gain margin, a factor on the torques. delay: delay margin, s.
    """

    gain: float
    delay: float


def margins(setup: Setup, gains: Any) -> Margins | None:
    """Compute the margins of PD control or an LQR on the setup's arm, with motor lag but without delay.

    Returns the smallest margins over all postures. For gains of any other controller, and for arms in space, the result
    is None.
    """
    found, dt = [], setup.control_dt
    if not isinstance(gains, PDGains | LQRGains):
        return None
    for posture in postures_of(setup.arm):
        model, law = arm_model(setup.arm, posture), _law(setup, gains, posture)
        if isinstance(gains, LQRGains):
            model = arm_model(setup.arm, posture, gains.flexible)
        gain = gain_margin(plant(model, dt, 0.0, setup.lag), law)
        found.append(Margins(gain, delay_margin(model, dt, law, setup.lag)))
    return Margins(min(one.gain for one in found), min(one.delay for one in found))


def _law(setup: Setup, gains: PDGains | LQRGains, posture: tuple[float, ...]) -> Law:
    """Return the controller (P, Q, K, D), see `loop.Law`, of PD or LQR gains at a posture (elbow angles, rad)."""
    if isinstance(gains, PDGains):
        return pd_law(*gains.of(setup.arm))
    made = design(setup.arm, setup.torque_limits, setup.control_dt, gains, posture, spread_of(setup))
    return observer_law(made.A, made.B, made.C, made.K, made.L)


def warn_of_delay(name: str, setup: Setup, gains: Any) -> None:
    """Warn if the setup's delay exceeds `SAFE` times the delay margin, or if the motor lag destabilizes the loop.

    name: name of the controller. The function does not warn of an unstable PD loop, since `PDGains.on` already warns.
    """
    if not (setup.delay or setup.lag):
        return
    # controllers that follow plans are judged by a comparable LQR
    if not isinstance(gains, PDGains | LQRGains):
        gains = stand_in(setup)
    found = margins(setup, gains)
    if found is None or (isinstance(gains, PDGains) and not gains.stable(setup)):
        return
    if setup.delay > SAFE * found.delay or found.gain <= 1.0:
        what = f"{name} ignores delays: on arm {setup.arm.name!r} its delay margin is {found.delay:.3g} s"
        now = f"torques and readings are {setup.delay:.3g} s late"
        now += f" and motors lag by {setup.lag:.3g} s" if setup.lag else ""
        warnings.warn(f"{what}, and {now}; tune its gains (flexarm tune), or lower them", UserWarning, stacklevel=4)


def warn_of_growth(name: str, setup: Setup, gains: Any) -> None:
    """Warn if a controller excites higher modes of an arm without damping.

    The controller's model does not contain the higher modes, whose frequencies are high compared with the control rate.
    The check uses all modes of the linear model. name: name of the controller.
    """
    arm, dt = setup.arm, setup.control_dt
    if any((arm.tau_d if link.tau_d is None else link.tau_d) for link in arm.links):
        return
    if not isinstance(gains, LQRGains):
        if name not in ("mpc", "time_optimal"):
            return
        gains = stand_in(setup)
    worst = 0.0
    for posture in postures_of(arm):
        every = len(linear_model(arm, posture).A) // 2 - arm.n_links
        system = plant(arm_model(arm, posture, every), dt, setup.delay, setup.lag)
        worst = max(worst, radius(system, _law(setup, gains, posture)))
    # e-folds per second of the fastest growing vibration
    rate = math.log(max(worst, 1.0)) / dt
    if rate * DOUBLES > math.log(2.0):
        warnings.warn(
            f"{name}: arm {arm.name!r} has no damping (tau_d = 0), and with a control period of {dt:g} s a vibration "
            f"grows twofold in {math.log(2.0) / rate:.2g} s; give the arm a tau_d, or a shorter control_dt",
            UserWarning,
            stacklevel=4,
        )


def stand_in(setup: Setup) -> LQRGains:
    """Return the gains of the LQR with which the margins of time_optimal and MPC are estimated.

    The function returns the tuned gains of the LQR with which time_optimal follows its plan. MPC reacts about as fast
    as an LQR with these gains.
    """
    return LQRGains(angle=10.0, rate=10.0, bend=10.0, bend_rate=10.0)
