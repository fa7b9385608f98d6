"""Linear models of small motions in the plane and in space, and their constants, behind one interface.

The constants were fitted to simulations of random arms. The modules `judge`, `resolution` and `trials` use the
constants.
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
    """Linear models of small motions of an arm in the plane.

    Attributes:
        bend: reference angle, rad, in the factor G = 1 + (theta / bend)^3 (`Judge.gain`). kept: largest error of the
            default settings, divided by the arm's length, with which the default settings are used. ladder: two bounds
            of the bending angle theta, rad. If theta exceeds the first bound, the search for a mesh begins with the
            second mesh. If theta exceeds the second bound, the search begins with the third mesh. trials: largest
            number of settings that are tested in trial episodes. lanes: number of trial episodes of the nominal arm.
    """

    bend, kept, ladder, trials, lanes = 0.55, 5e-3, (1.6, 3.0), 6, 16

    def postures(self, n: int) -> Sequence[Array]:
        """Return postures (N,), rad, for small motions: absolute link angles in the plane, joint angles in space."""
        return poses(n)

    def reference(self, arm: Arm, pose: Array, stiffness: float) -> Motion:
        """Return the linear model on the reference mesh. stiffness: factor on the bending stiffness."""
        return Motion.of(arm, _scaled(fine(arm), stiffness), pose)

    def on_mesh(self, arm: Arm, settings: Settings, pose: Array, h: float, stiffness: float) -> Motion:
        """Return the linear model for the mesh in `settings` and steps of h, s. stiffness: factor on EI."""
        parts = fine(arm) if settings.modes else cut(arm, (settings.segments or 1) * (settings.elements or 1))
        if settings.nodes is not None:
            parts = chain(arm, settings.nodes)
        return Motion.of(arm, _scaled(parts, stiffness), pose, settings, h)

    def unsteady(self, motion: Motion, n: int, index: int, damped: float) -> float:
        """Return the angular frequency, rad/s, that steps must resolve for stability, or 0 (no limit)."""
        return 0.0 if n == 1 else frequency_unless_damped(motion, index, damped)

    def link_angles(self, joints: Array) -> Array:
        """Convert joint angles (periods, N, runs) to absolute link angles; e_3 is computed from the rates of the
        result."""
        return np.cumsum(joints, axis=1)

    def spin(self, error: float) -> float:
        """Return the error e_3 of a fast turn: `error` in the plane, 0 in space."""
        return error

    def tolerance(self, inertia: Array) -> float:
        """Return the factor on the Newton tolerance for joint inertias (N,), kg m^2."""
        return 1.0

    def elements(self, arm: Arm, stiffness: float) -> int:
        """Return the number of elements per link that resolves the bending at full torque."""
        return 1


class SmallMotionsInSpace(SmallMotions):
    """Linear models of small motions of an arm in space."""

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
        """Return the number of elements per link for which the full torque bends each element by at most `TURNED`.

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
    return parts if stiffness == 1.0 else replace(parts, K_EI=stiffness * parts.K_EI)


SMALL_MOTIONS = {"xy": SmallMotions(), "xyz": SmallMotionsInSpace()}
"""Small motions by the axes along which an arm moves."""


def small_motions(arm: Arm) -> SmallMotions:
    """Return the linear models of an arm's small motions, in the plane or in space."""
    return SMALL_MOTIONS[arm.axes]
