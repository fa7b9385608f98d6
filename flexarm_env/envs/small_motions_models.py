"""Small motions of an arm in the plane and in space, by one interface, with the constants of the rule for each.

The constants belong to the rules in `judge`, `resolution` and `trials`, and were fitted to runs of drawn arms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..parameters import Arm
from ..physics.elastica.chain import Chain, chain
from ..settings import Settings
from ..validation import Array
from .small_motions import Motion, cut, fine, frequency_unless_damped, poses
from .small_motions_space import of_space, poses_in_space

REFERENCE = 8  # elements of a link of the reference in space
TURNED = 2.0  # largest angle of an element in space at rest, rad; from pi on a moving one has no rotation vector
UNEQUAL = 100.0
"""Largest ratio of two joints' inertias for which the usual tolerance in space is used."""


class SmallMotions:
    """Small motions of an arm in the plane, by the common interface.

    Attributes:
        bend: reference angle, rad, in the factor G = 1 + (theta / bend)^3 (`Judge.gain`). kept: error that usual
            settings may have, a fraction of the arm's length. ladder: bends, rad, above which meshes begin one and two
            sizes finer. trials, lanes: largest number of settings tried in trial episodes, and number of nominal
            episodes.
    """

    bend, kept, ladder, trials, lanes = 0.55, 5e-3, (1.6, 3.0), 6, 16

    def postures(self, n: int) -> Sequence[Array]:
        """Return the postures (N,), rad, about which motions are small: absolute link angles; in space joint angles."""
        return poses(n)

    def reference(self, arm: Arm, pose: Array, stiffness: float) -> Motion:
        """Return the small motions of the reference mesh. stiffness: factor on the bending stiffness."""
        return Motion.of(arm, _scaled(fine(arm), stiffness), pose)

    def on_mesh(self, arm: Arm, settings: Settings, pose: Array, h: float, stiffness: float) -> Motion:
        """Return the small motions on the settings' mesh in steps of h (s); stiffness: factor on EI."""
        parts = fine(arm) if settings.modes else cut(arm, (settings.segments or 1) * (settings.elements or 1))
        if settings.nodes is not None:
            parts = chain(arm, settings.nodes)
        return Motion.of(arm, _scaled(parts, stiffness), pose, settings, h)

    def unsteady(self, motion: Motion, n: int, index: int, damped: float) -> float:
        """Return the frequency, rad/s, of a chain's vibration that steps must resolve; 0 if there is none."""
        return 0.0 if n == 1 else frequency_unless_damped(motion, index, damped)

    def link_angles(self, joints: Array) -> Array:
        """Return the links' absolute angles, whose rates count as spin, from joint angles (periods, N, runs)."""
        return np.cumsum(joints, axis=1)

    def spin(self, error: float) -> float:
        """Return the error of a fast turn, given the error by the links' absolute angles; 0 in space."""
        return error

    def tolerance(self, inertia: Array) -> float:
        """Return the factor on the Newton tolerance for joint inertias (N,), kg m^2."""
        return 1.0

    def elements(self, arm: Arm, stiffness: float) -> int:
        """Return the number of elements per link that resolves the bends at full torque."""
        return 1


class SmallMotionsInSpace(SmallMotions):
    """Small motions of an arm in space, by the common interface.

    Links turn out of each other's planes, and gravity limits the swing of the whole arm.
    """

    bend, kept, ladder, trials, lanes = 1.1, 6e-3, (3.2, 6.0), 4, 8

    def postures(self, n: int) -> Sequence[Array]:
        return poses_in_space(n)

    def reference(self, arm: Arm, pose: Array, stiffness: float) -> Motion:
        return of_space(arm, REFERENCE, pose, stiffness=stiffness)

    def on_mesh(self, arm: Arm, settings: Settings, pose: Array, h: float, stiffness: float) -> Motion:
        elements = REFERENCE if settings.modes else (settings.segments or 1) * (settings.elements or 1)
        return of_space(arm, elements, pose, settings, h, stiffness)

    def unsteady(self, motion: Motion, n: int, index: int, damped: float) -> float:
        return 0.0

    def link_angles(self, joints: Array) -> Array:
        return joints

    def spin(self, error: float) -> float:
        return 0.0

    def tolerance(self, inertia: Array) -> float:
        return min(1.0, UNEQUAL * float(inertia.min() / inertia.max()))

    def elements(self, arm: Arm, stiffness: float) -> int:
        """Return the number of elements, each of which a joint's full torque bends by at most `TURNED` at rest.

        stiffness: smallest factor on the arm's stiffness.
        """
        most = 1
        for k, link in enumerate(arm.links):
            if not link.rigid:
                s = np.linspace(0.0, link.length, 9)
                soft = min(float(link.along(s).EI.min()), float(link.across(s)["EI_y"].min())) * stiffness
                most = max(most, math.ceil((arm.torque_limits or ())[k] * link.length / (TURNED * soft)))
        return most


def _scaled(parts: Chain, stiffness: float) -> Chain:
    """Return a chain with its bending stiffness multiplied by a factor."""
    return parts if stiffness == 1.0 else replace(parts, K=stiffness * parts.K)


SMALL_MOTIONS = {"xy": SmallMotions(), "xyz": SmallMotionsInSpace()}
"""Small motions by the axes along which an arm moves."""


def small_motions(arm: Arm) -> SmallMotions:
    """Return the small motions of an arm, in the plane or in space."""
    return SMALL_MOTIONS[arm.axes]
