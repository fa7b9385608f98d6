"""Ranges of the random numbers with which episodes start."""

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
    Field("payload", (), "", "factor on the payload's mass and inertia"),
    Field("EI", (), "", "factor on EI; in space on EI_y too"), Field("damping", (), "", "on tau_d"),
    Field("torque_constant", (), "", "factor on the motors' torque constants"),
    Field("payload_inertia", (), "", "further factor on the payload's inertia"),
    Field("friction", (), "", "factor on the joints' friction"),
    Field("backlash", (), "", "factor on the gears' backlash"),
    Field("motor_inertia", (), "", "factor on the rotors' inertia"),
    Field("hub_inertia", (), "", "factor on the hub's inertia"),
    Field("EI_y", (), "", "in space: further factor on EI_y"), Field("GJ", (), "", "in space: factor on GJ"),
)  # fmt: skip
"""Factors on an arm's nominal values, which are drawn in each episode. Those from `payload_inertia` on are drawn only
if requested."""

FACTOR, FACTOR_NAMES = FACTORS.places, tuple(one.name for one in FACTORS.fields)
ALWAYS = FACTOR.payload_inertia
"""Number of factors that every episode draws."""
NOT_DRAWN = dict.fromkeys(FACTOR_NAMES[:ALWAYS], (1.0, 1.0))


class Ranges(NamedTuple):
    """Bounds (low, high) of the uniformly distributed numbers with which an episode starts, as arrays for kernels."""

    pose: np.ndarray | None  # (n, 1 + 3 N): coordinates q = pose times a `BASIS`; None in space
    shake: np.ndarray | None  # (n, 1 + 3 N): rates of a vibration of size 1; in space see `envs.vibration.swing`
    nominal: np.ndarray  # nominal values of the parameters that each arm has of its own
    start: np.ndarray  # (N, 2): bounds of each joint's initial angle, rad
    target: np.ndarray  # (2, 2): bounds, rad ("slew") or polar, m and rad ("reach"); in space (N, 2): joint angles
    straight: np.ndarray  # (1,): fraction of starts at which all joint angles are 0
    vibration: float  # largest initial vibration: tip deflection divided by the arm's length
    factors: np.ndarray  # (`ALWAYS`, 2): bounds of the first `ALWAYS` fields of `FACTORS`
    more: np.ndarray | None = None  # (n, 2): bounds of the next n fields of `FACTORS`; None: not drawn
    laws: tuple[int, ...] | None = None  # not None if factors on the joints' friction and gears are drawn for each arm
    hub: float = 0.0  # nominal hub inertia, kg m^2; the drawn deviation is added to the first joint's rotor inertia
    attainable: Any = None  # conditions on drawn targets, an `attainable.Attainable`; None: no conditions
    free: tuple[int, ...] | None = None  # not None: a start that touches an obstacle is drawn again
    free_targets: tuple[int, ...] | None = None  # not None: a target whose posture touches an obstacle is drawn again


@dataclass(frozen=True)
class Starts:
    """Bounds of the uniformly distributed numbers with which an episode starts; for other fields see `Ranges`.

    target: bounds of two target numbers (for one link the second is unused); in space bounds of each joint's angle.
    drawn: bounds of each random factor by name, in the order of `FACTOR_NAMES`. laws: True if parameters of gears,
    rotors or friction are random.
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
        """Return the bounds as arrays, a `Ranges` for compiled code.

        pose: rows of the state of straight links in terms of `program.BASIS`; None in space. nominal: nominal values of
        the parameters that each arm has of its own.
        """
        # no table of vibrations: links start at rest, q' = 0
        still = None if pose is None else np.zeros(pose.size)
        assert pose is None or self.shake is None or self.shake.shape == pose.shape
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
