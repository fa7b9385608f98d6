"""Ranges from which fresh starts of episodes are drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..layout import Field, Layout

Array = NDArray[np.float64]

FACTORS = Layout(
    "Factors", "",
    Field("payload", (), "", "on the payload's mass and inertia"),
    Field("EI", (), "", "on EI; in space on EI_y too"), Field("damping", (), "", "on tau_d"),
    Field("torque_constant", (), "", "on the motors' torque constants"),
    Field("payload_inertia", (), "", "on the payload's inertia, besides `payload`"),
    Field("friction", (), "", "on the joints' friction"), Field("backlash", (), "", "on the gears' backlash"),
    Field("motor_inertia", (), "", "on the rotors' inertia"), Field("hub_inertia", (), "", "on the hub's inertia"),
    Field("EI_y", (), "", "on EI_y, in space, besides `EI`"), Field("GJ", (), "", "on GJ, in space"),
)  # fmt: skip
"""Factors on an arm's nominal values, which are drawn in each episode. Those from `payload_inertia` on are drawn only
if requested."""

FACTOR, FACTOR_NAMES = FACTORS.places, tuple(one.name for one in FACTORS.fields)
ALWAYS = FACTOR.payload_inertia
"""Number of factors that every episode draws."""
NOT_DRAWN = dict.fromkeys(FACTOR_NAMES[:ALWAYS], (1.0, 1.0))


class Ranges(NamedTuple):
    """Ranges (low, high) from which a fresh start is drawn uniformly; tables by rows; N links, n rows of the state."""

    pose: np.ndarray | None  # (n, 1 + 3 N): q = pose times a `BASIS`; None: `set_joint_configuration`, in space
    shake: np.ndarray | None  # (n, 1 + 3 N): v likewise, for a vibration of 1; in space `envs.vibration.swing`, or None
    nominal: np.ndarray  # nominal values of par
    start: np.ndarray  # (N, 2) rad, joint angles
    target: np.ndarray  # (2, 2): rad (slew, from the start), or m and rad (reach, polar); in space (N, 2): joint angles
    straight: np.ndarray  # (1,) fraction of starts with all joints at 0
    vibration: float  # largest initial vibration, as a tip deflection over L
    factors: np.ndarray  # (`ALWAYS`, 2): the first of `FACTORS`
    more: np.ndarray | None = None  # (n, 2): the next n of `FACTORS`; None: not drawn
    laws: tuple[int, ...] | None = None  # a tag where the joints' laws are each arm's own, for factors on them
    hub: float = 0.0  # kg m^2, nominal hub inertia; a drawn deviation is added to the first joint's rotor
    attainable: Any = None  # an `attainable.Attainable`, conditions on drawn targets; None: no conditions
    free: tuple[int, ...] | None = None  # a tag: starts that touch an obstacle of `contacts` are drawn again
    free_targets: tuple[int, ...] | None = None  # a tag: the same of targets, by the posture that reaches them


@dataclass(frozen=True)
class Starts:
    """Ranges from which fresh starts are drawn, uniformly; `Ranges` describes the fields that are not described here.

    target: two ranges (the second is unused with one link); in space one range for each joint. drawn: range of each
    drawn factor by name, in the order of `FACTOR_NAMES`. laws: whether factors on joint laws are drawn.
    """

    start: Sequence[tuple[float, float]]
    target: Sequence[tuple[float, float]]
    straight: float = 0.0
    vibration: float = 0.0
    drawn: Mapping[str, tuple[float, float]] = field(default_factory=NOT_DRAWN.copy)
    shake: Array | None = None
    laws: bool = False
    hub: float = 0.0
    attainable: Any = None
    free: tuple[int, ...] | None = None
    free_targets: tuple[int, ...] | None = None

    def ranges(self, pose: Array | None, nominal: Array) -> Ranges:
        """Return the `Ranges` for compiled code.

        pose: rows of the state of straight links in terms of `program.BASIS`; None in space. nominal: an arm's own
        parameters.
        """
        # no table of vibrations: links start at rest, q' = 0
        still = None if pose is None else np.zeros(pose.size)
        tables = self.start, self.target, [*self.drawn.values()]
        start, target, drawn = (np.array(rows, np.float64).ravel() for rows in tables)
        # the first ALWAYS factors are drawn in every episode, so that the stream does not depend on the settings
        always, asked = drawn[: 2 * ALWAYS], drawn[2 * ALWAYS :]
        return Ranges(
            start=start, target=target, factors=always, more=asked if asked.size else None,
            pose=None if pose is None else pose.ravel(), nominal=nominal.copy(),
            shake=still if self.shake is None else self.shake.ravel(), straight=np.array([float(self.straight)]),
            vibration=float(self.vibration), laws=(0,) if self.laws else None, hub=float(self.hub),
            attainable=self.attainable, free=self.free, free_targets=self.free_targets,
        )  # fmt: skip
