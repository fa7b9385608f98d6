"""What fresh starts of episodes are drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..layout import Field, Layout

Array = NDArray[np.float64]

FACTORS = Layout(
    "Factors", "",
    Field("payload", (), "", "on the payload's mass and inertia"),
    Field("EI", (), "", "in space on EI_y too"), Field("damping", (), "", "on tau_d"),
    Field("torque_constant", (), "", "of the motors"),
    Field("payload_inertia", (), "", "on its inertia once more"),
    Field("friction", (), "", "of the joints"), Field("backlash", (), "", ""), Field("motor_inertia", (), "", ""),
    Field("hub_inertia", (), "", ""),
    Field("EI_y", (), "", "in space"), Field("GJ", (), "", "in space"),
)  # fmt: skip
"""Factors on the nominal values that an episode may draw; from `payload_inertia` on, where they are asked for."""

FACTOR, FACTOR_NAMES = FACTORS.places, tuple(one.name for one in FACTORS.fields)
ALWAYS = FACTOR.payload_inertia
"""How many of these every arm draws."""
NOT_DRAWN = dict.fromkeys(FACTOR_NAMES[:ALWAYS], (1.0, 1.0))


class Ranges(NamedTuple):
    """What a fresh start is drawn from, uniformly; tables by rows, ranges (low, high). N links, n rows of the state."""

    pose: np.ndarray | None  # (n, 1 + 3 N): q = pose times a `BASIS`; None: `protocol.stand` says, in space
    shake: np.ndarray | None  # (n, 1 + 3 N): v likewise, for a vibration of 1; in space `envs.vibration.swing`, or None
    nominal: np.ndarray  # of par
    start: np.ndarray  # (N, 2) rad, joint angles
    target: np.ndarray  # (2, 2): rad (slew, from the start), or m and rad (reach, polar); in space (N, 2): joint angles
    straight: float  # share of starts with all joints at 0
    vibration: float  # largest initial vibration, as a tip deflection over L
    factors: np.ndarray  # (`ALWAYS`, 2): the first of `FACTORS`
    more: np.ndarray | None = None  # (n, 2): the next n; None: not drawn
    laws: tuple[int, ...] | None = None  # a tag where the joints' laws are each arm's own, for factors on them
    hub: float = 0.0  # kg m^2: of which what is drawn is more or less is the first joint's rotor's


@dataclass(frozen=True)
class Starts:
    """What fresh starts are drawn from, uniformly; fields that are not told of here are those of `Ranges`.

    target: two ranges, of one link the second unused; in space one for each joint. drawn: of the first `FACTOR_NAMES`,
    in their order. laws: joints are drawn.
    """

    start: Sequence[tuple[float, float]]
    target: Sequence[tuple[float, float]]
    straight: float = 0.0
    vibration: float = 0.0
    drawn: Mapping[str, tuple[float, float]] = field(default_factory=NOT_DRAWN.copy)
    shake: Array | None = None
    laws: bool = False
    hub: float = 0.0

    def ranges(self, pose: Array | None, nominal: Array) -> Ranges:
        """For compiled code. pose: where straight links are, by a `program.BASIS`; None in space. nominal: an arm's own
        parameters."""
        still = None if pose is None else np.zeros(pose.size)
        tables = self.start, self.target, [*self.drawn.values()]
        start, target, drawn = (np.array(rows, np.float64).ravel() for rows in tables)
        always, asked = drawn[: 2 * ALWAYS], drawn[2 * ALWAYS :]
        return Ranges(
            start=start, target=target, factors=always, more=asked if asked.size else None,
            pose=None if pose is None else pose.ravel(), nominal=nominal.copy(),
            shake=still if self.shake is None else self.shake.ravel(), straight=float(self.straight),
            vibration=float(self.vibration), laws=(0,) if self.laws else None, hub=float(self.hub),
        )  # fmt: skip
