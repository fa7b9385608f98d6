"""Estimate an arm's tip error from small motions: the quantities e_1, e_2 and e_3 that `resolution` defines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..parameters import Arm
from ..rigid import inertia_beyond
from ..settings import Settings
from ..validation import Array
from .small_motions import HELD, PERIODS, Drive, Motion, actions
from .small_motions_models import small_motions

OF_ELBOWS = 0.1  # weight of the spin of elbows, which links that hardly bend follow to higher order
MARGIN, MARGIN_OF_FRICTION = 3.0, 10.0
"""Factors on G e_1 and on e_2 in the estimated error, which 99 % of the episodes do not exceed."""

MESHES: Mapping[str, tuple[str, tuple[int, ...]]] = {
    "elastica": ("nodes", (4, 6, 8, 12)),
    "geometrically_exact": ("elements", (3, 5, 8, 12)),
    "floating_frame": ("segments", (2, 4, 6, 10)),
}
"""Mesh option of each formulation and its sizes, from the usual size to finer sizes."""

POWER = 3  # exponent in G = 1 + (theta / bend)^POWER

CONTACT = 0.3  # largest omega_c h
THIRD, DAMPED, STEADY = 2, 0.1, 0.45
"""Index (from 0) of the vibration of a chain of elasticas that steps must resolve if its damping ratio is below
`DAMPED`.

`STEADY` is the largest omega h of this vibration.
"""

SELDOM = 0.25  # weight of the arms that are drawn farthest from the nominal one
TRAVEL = 1.0  # time for which a rate stays wrong after a reversal, s
SLENDER = 0.1  # largest radius of gyration of a section over its link's length: small motions have no shear
STIFFEST = 1e8
"""Largest w^2 T, 1/s, of vibrations with frequency w in a control period T. Stiffer vibrations are softened, because
the matrix exponential has a round-off error of 1e-16 w^2 T."""

SETTLED, CHATTER = 20, 0.3
"""A PD loop chatters if its torques change by `CHATTER` of the limits in its last `SETTLED` periods without action."""


class Judge:
    """Estimates of the tip's error for one arm with one actuation and control period (s); see `resolution`.

    stiffness: factor on EI, in space also on EI_y and GJ. theta: largest angle between the ends of a link, rad.
    """

    def __init__(self, arm: Arm, drive: Drive, period: float, stiffness: float = 1.0) -> None:
        self.arm, self.drive, self.period, self.stiffness = arm, drive, period, stiffness
        limits = arm.torque_limits
        assert limits is not None
        n = arm.n_links
        self.inertia: Array = np.array([inertia_beyond(arm, k) for k in range(n)])
        self.friction = sum(arm.joint(k).friction_coulomb / float(self.inertia[k]) for k in range(n))
        # largest frequency (rad/s) of a rotor on its elastic gear; contact: of gears with backlash alone
        self.swing = max(self._swing(k) for k in range(n))
        self.contact = max(self._swing(k) if arm.joint(k).backlash else 0.0 for k in range(n))
        self.motions = small_motions(arm)
        self.poses, self.places = self.motions.postures(n), len(arm.axes)  # coordinates of the tip
        self.asked: list[Array] = []  # torques of the first run
        # responses of the reference (PERIODS, tip, joint angles, bends; runs), one for each posture
        self.fine = [self._response(self._fine(pose)) for pose in self.poses]
        self.spun, self.bent = (max(self._spun(one, inner) for one in self.fine) for inner in (False, True))
        # third vibration frequency of a chain, rad/s, 0 where it is well damped
        self.unsteady = self.motions.unsteady(self._fine(self.poses[0]), n, THIRD, DAMPED)
        # the last run counts for its spin alone
        self.theta = max(float(np.abs(one[:, self.places + n :, :-1]).max(initial=0.0)) for one in self.fine)
        self._known: dict[tuple[Any, ...], float] = {}

    @property
    def slender(self) -> bool:
        """True if the links are so slender that a computation of small motions may neglect shear."""
        radii = [math.sqrt(link.rotary / link.mass) / link.length for link in self.arm.links if link.mass > 0.0]
        return max(radii, default=0.0) <= SLENDER

    @cached_property
    def chatters(self) -> tuple[bool, bool]:
        """Return whether the PD loop sustains a vibration in at least one posture, and whether in every posture."""
        if self.drive.residual is None:
            return False, False
        limits = CHATTER * np.array(self.drive.limits)
        found = [bool((np.abs(np.diff(u[-SETTLED:], axis=0)).mean(axis=0) > limits).any()) for u in self.asked]
        return any(found), all(found)

    def _swing(self, k: int) -> float:
        """Return the frequency omega_c of joint k's rotor on its gear, rad/s; 0 for a rigid gear or without rotor."""
        joint = self.arm.joint(k)
        if not joint.elastic or not joint.rotor:
            return 0.0
        return math.sqrt(joint.stiffness * (1.0 / joint.rotor + 1.0 / (self.inertia[k] - joint.rotor)))

    def _response(self, motion: Motion) -> Array:
        """Return the reference mesh's response to all runs (`Motion.respond`); store the first run's torques."""
        asked = []

        def torques(k: int, angles: Array, rates: Array) -> Array:
            u = self._torques(k, angles, rates)
            asked.append(u[:, 0])
            return u

        found = motion.respond(motion.exact(self.period), torques, PERIODS, len(HELD))
        self.asked.append(np.array(asked))
        return found

    def _spun(self, response: Array, inner: bool) -> float:
        """Return the time integral of Omega^3, rad^3/s^2, of the fastest link; if `inner`, of the fastest elbow.

        response: result of `Motion.respond`, with joint angles (rad) of each control period and run. Omega: rate of the
        link's absolute angle (in space of its joint angle), or of the elbow angle, rad/s. Elbows with joint limits are
        excluded.
        """
        count, limits = self.arm.n_links, self.arm.joint_limits or (None,) * self.arm.n_links
        angles = response[:, self.places : self.places + count]
        if inner:
            angles = angles[:, [k for k in range(1, count) if limits[k] is None]]
        else:
            angles = self.motions.link_angles(angles)
        turns = np.abs(np.diff(angles, axis=0)) / self.period
        return float((turns**3).sum(axis=0).max(initial=0.0) * self.period)

    def _torques(self, k: int, angles: Array, rates: Array) -> Array:
        """Return the torques of period k (N, runs), N m, from joint angles (rad) and rates (rad/s) at its start."""
        drive, action = self.drive, actions(self.arm.n_links)[k]
        full = np.array(drive.torques)[:, None]
        limits = np.array(drive.limits)[:, None]
        # PD loop of critical damping about goals of +-1 and 0.5 rad; the first run has no action
        if drive.residual is not None:
            stiffness = limits / (0.25 * math.pi)
            damping = 2.0 * np.sqrt(stiffness * self.inertia[:, None])
            # one column per run of `HELD`
            goal = np.array([1.0, 1.0, -1.0, 0.5])
            share = drive.residual * np.array([0.0, 1.0, 1.0, 1.0])
            asked = share * full * action + stiffness * (goal - angles) - damping * rates
            return np.asarray(np.clip(asked, -limits, limits))
        # voltage: back-emf acts as friction in the period, limits apply to torque less back-emf
        if drive.emf is not None:
            held = np.array(drive.emf)[:, None] * rates
            return np.asarray(np.clip(full * action - held, -limits, limits) + held)
        return np.asarray(np.clip(full * action, -limits, limits))

    def _fine(self, pose: Array) -> Motion:
        """Return the small motions of the fine reference mesh about a posture, with limited frequencies (`_softened`).

        pose (N,), rad: absolute link angles in the plane, joint angles in space.
        """
        return self._softened(self.motions.reference(self.arm, pose, self.stiffness))

    def _softened(self, motion: Motion) -> Motion:
        """Return the motion with frequencies limited to what double precision resolves in a period."""
        return motion.softened(math.sqrt(STIFFEST / self.period))

    def _motion(self, settings: Settings, pose: Array, h: float) -> Motion:
        """Return the small motions about a posture on the settings' mesh, with the integrator's inertia and damping.

        h: step of the integrator, s. Linear elements (order 1) with one Gauss point keep the curvature of an element at
        its mean. With E linear elements per link, the bending stiffness is therefore too large by the fraction 1 / (4
        E^2).
        """
        elements = (settings.segments or 1) * (settings.elements or 1)
        stiffness = self.stiffness
        if settings.order == 1:
            stiffness *= 1.0 + 0.25 / elements**2
        motion = self.motions.on_mesh(self.arm, settings, pose, h, stiffness)
        excess = settings.newmark[1] - 0.5 if settings.newmark is not None else 0.0
        if excess > 0.0:
            # Newmark's scheme damps a frequency w by the ratio (gamma - 1/2) w h / 2
            motion = replace(motion, C=motion.C + excess * h * motion.K)
        return self._softened(motion)

    def small(self, settings: Settings, h: float) -> float:
        """Return e_1, the tip's largest error in small motions, divided by the arm's length."""
        name, _ = MESHES[settings.formulation]
        size = getattr(settings, name)
        key = (
            settings.formulation, size, settings.elements, settings.modes, settings.order, settings.period_error,
            settings.newmark, h,
        )  # fmt: skip
        if key not in self._known:
            self._known[key] = self._small(settings, h)
        return self._known[key]

    def halved(self, settings: Settings, h: float) -> float:
        """Return the largest distance between the tips of small motions in steps of h (s) and of h/2, divided by L."""
        worst = 0.0
        for pose in self.poses:
            one, two = (self._stepped(settings, pose, k) for k in (h, 0.5 * h))
            worst = max(worst, self._apart(one, two))
        return worst

    def _stepped(self, settings: Settings, pose: Array, h: float) -> Array:
        """Return the response of small motions about `pose` (rad) on the settings' mesh, in steps of h (s).

        The response contains the tip, joint angles and bends of each control period and run (`Motion.respond`).
        """
        motion = self._motion(settings, pose, h)
        return motion.respond(motion.stepped(h, round(self.period / h)), self._torques, PERIODS, len(HELD))

    def _apart(self, one: Array, two: Array) -> float:
        """Return the largest distance / arm's length between the tips of two responses (`Motion.respond`).

        The last run of the responses is omitted. If a response is not finite, the result is inf.
        """
        apart = np.linalg.norm((one - two)[:, : self.places, :-1], axis=1).max() / self.arm.total_length
        return float(apart) if math.isfinite(apart) else math.inf

    def _small(self, settings: Settings, h: float) -> float:
        """Return e_1 of steps of h (s) on the settings' mesh, over all postures and runs; inf if unstable."""
        runs = zip(self.poses, self.fine, strict=True)
        return max(self._apart(self._stepped(settings, pose, h), fine_one) for pose, fine_one in runs)

    @property
    def gain(self) -> float:
        """Factor G by which large bends of the links amplify e_1, the error of small motions."""
        return 1.0 + (self.theta / self.motions.bend) ** POWER

    def spin(self, settings: Settings, h: float) -> float:
        """Return e_3: the tip's error in a fast turn in steps of h (s), divided by the arm's length."""
        turned = self.spun if settings.formulation == "geometrically_exact" else OF_ELBOWS * self.bent
        return self.motions.spin(settings.period_error * h * h * turned)

    def bound(self, settings: Settings, h: float) -> float:
        """Return the error bound e = G e_1 + e_2, divided by L; inf if steps of h (s) are too long for the arm."""
        steady = settings.formulation != "elastica" or self.unsteady * h <= STEADY
        if not steady or self.contact * h > CONTACT * (1.0 + 1e-9):
            return math.inf
        return self.gain * self.small(settings, h) + self.friction * h * TRAVEL

    def estimate(self, settings: Settings, h: float) -> float:
        """Return the estimated tip error MARGIN G e_1 + MARGIN_OF_FRICTION e_2 + e_3, divided by the arm's length."""
        more = (MARGIN_OF_FRICTION - MARGIN) * self.friction * h * TRAVEL
        return min(1.0, MARGIN * self.bound(settings, h) + self.spin(settings, h) + more)


class Worst:
    """Largest of the error estimates for the nominal arm and, multiplied by SELDOM, for the extreme randomized arms."""

    def __init__(self, rules: Sequence[Judge]) -> None:
        self.rules, self.arm, self.period = rules, rules[0].arm, rules[0].period
        # drawn extremes count by a smaller weight
        self.theta = max(rules[0].theta, *(SELDOM * rule.theta for rule in rules))
        self.slender, self.chatters, self.inertia = rules[0].slender, rules[0].chatters, rules[0].inertia
        self.swing, self.motions = rules[0].swing, rules[0].motions

    @property
    def elements(self) -> int:
        """Number of elements per link that resolves the bending at full torque (`SmallMotions.elements`)."""
        return self.motions.elements(self.arm, min(rule.stiffness for rule in self.rules))

    def bound(self, settings: Settings, h: float) -> float:
        """Return the largest error bound e (`Judge.bound`) of all arms, divided by the arm's length."""
        return max(self.rules[0].bound(settings, h), *(SELDOM * rule.bound(settings, h) for rule in self.rules))

    def spin(self, settings: Settings, h: float) -> float:
        """Return the largest error e_3 of a fast turn (`Judge.spin`) of all arms, divided by the arm's length."""
        return max(self.rules[0].spin(settings, h), *(SELDOM * rule.spin(settings, h) for rule in self.rules))

    def estimate(self, settings: Settings, h: float) -> float:
        """Return the largest estimated tip error of all arms for a mesh and steps of h (s), divided by L."""
        return max(self.rules[0].estimate(settings, h), *(SELDOM * rule.estimate(settings, h) for rule in self.rules))


@lru_cache(32)
def judge(arm: Arm, drive: Drive, period: float, stiffness: float = 1.0) -> Judge:
    """Return the error estimates (`Judge`) of an arm; results are cached."""
    return Judge(arm, drive, period, stiffness)


def worst(arm: Arm, drive: Drive, period: float, drawn: Mapping[str, tuple[float, float]]) -> Worst:
    """Return error estimates of an arm, and of the softest and the stiffest (least payload) randomized arm.

    period: control period, s. drawn: ranges (low, high) of randomized factors by name; only the factors on EI, payload
    and torque_constant are used.
    """
    (soft, stiff), (light, _), (_, strong) = (
        drawn.get(name, (1.0, 1.0)) for name in ("EI", "payload", "torque_constant")
    )
    rules = [judge(arm, drive, period)]
    # largest bends: softest links under the strongest torques
    if soft < 1.0 or strong > 1.0:
        harder = replace(drive, torques=tuple(strong * torque for torque in drive.torques))
        rules.append(judge(arm, replace(harder, limits=tuple(strong * one for one in drive.limits)), period, soft))
    # largest frequencies: stiffest links with the lightest payload
    if stiff > 1.0 or light < 1.0:
        payload = replace(arm.payload, mass=light * arm.payload.mass)
        rules.append(judge(replace(arm, payload=payload), drive, period, stiff))
    return Worst(rules)
