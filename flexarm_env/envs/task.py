"""The two environments as data: arm, spaces, scales, rewards and starts; what single and vector environments share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..batch import CLIP, DEFLECTION, ENERGIES, ERROR, IN_RANGE, SUCCESS, TIP, Reach, Slew, Starts
from ..parameters import Arm

Array = NDArray[np.float64]

HOLD_TIME = 0.5
"""Success: in the band throughout the trailing so many seconds."""

REWARDS = ("accuracy", "settle", "distance", "effort", "vibration", "failure")
"""Names of the reward terms, in order."""


@dataclass(frozen=True)
class Kind:
    """One of the two environments.

    id: of the registry. task: default task's name. n_links: of its arms. arm: default arm's name. duration: s.
    targets: numbers in a target, 1 (an angle, rad) or 2 (a point, m). rewards: default weights of REWARDS.
    names: of the observation's entries. build: (arm, weights, control_dt) -> Slew or Reach. starts: arm -> Starts.
    """

    id: str
    task: str
    n_links: int
    arm: str
    duration: float
    targets: int
    rewards: Mapping[str, float]
    names: tuple[str, ...]
    build: Callable[[Arm, Array, float], Any]
    starts: Callable[[Arm], Starts]


def inertia_beyond(arm: Arm, joint: int) -> float:
    """Inertia (kg m^2) about a joint of the straight, rigid arm from that joint to the tip."""
    total = arm.hub_inertia if joint == 0 else arm.elbow(joint).inertia_right
    start = 0.0
    for k in range(joint, arm.n_links):
        link = arm.links[k]
        if k > joint:
            elbow = arm.elbow(k)
            total += elbow.mass * start**2 + elbow.inertia_left + elbow.inertia_right
        total += link.mass * (link.length**2 / 12.0 + (start + link.length / 2.0) ** 2) + link.section.J * link.length
        start += link.length
    return total + arm.payload.mass * start**2 + arm.payload.inertia


def rate_scale(arm: Arm, joint: int) -> float:
    """sqrt(tau pi/2 / I), rad/s: top rate of a rigid quarter turn, rest to rest at full torque, reached midway."""
    limits = arm.torque_limits
    assert limits is not None
    return math.sqrt(limits[joint] * (math.pi / 2) / inertia_beyond(arm, joint))


def _limits(arm: Arm) -> Array:
    ranges = arm.joint_limits or (None,) * arm.n_links
    return np.array([(-math.inf, math.inf) if r is None else r for r in ranges], np.float64).ravel()


def _common(arm: Arm, weights: Array, period: float, targets: int, scales: list[float]) -> dict[str, Any]:
    assert arm.torque_limits is not None
    return {
        "links": (0,) * arm.n_links,
        "targets": (0,) * targets,
        "terms": (0,) * len(REWARDS),
        "entries": (0,) * len(scales),
        "length": arm.total_length,
        "scales": np.array(scales),
        "weights": weights,
        "torque_limits": np.array(arm.torque_limits),
        "joint_limits": _limits(arm),
        "hold": float(math.ceil(HOLD_TIME / period - 1e-9) + 1),
    }


def controller_gains(arm: Arm) -> Array:
    """(N, 2) flattened: N m/rad and N m s/rad of each joint's controller in action_mode="residual_pd".

    Stiffness: the full torque at an error of pi/4. Damping: critical for the rigid arm beyond the joint, straight.
    """
    assert arm.torque_limits is not None
    gains = []
    for k, limit in enumerate(arm.torque_limits):
        stiffness = limit / (math.pi / 4)
        gains.append((stiffness, 2.0 * math.sqrt(stiffness * inertia_beyond(arm, k))))
    return np.array(gains).ravel()


def scales_of(kind: Kind, arm: Arm) -> list[float]:
    """Scales of an environment's observation, in its order."""
    return slew_scales(arm) if kind.targets == 1 else reach_scales(arm)


def slew_scales(arm: Arm) -> list[float]:
    """Scales of FlexibleArm-v0's observation, in its order."""
    rate = rate_scale(arm, 0)
    return [1.0, 1.0, rate, 0.1, 0.3 * rate, 1.0]


def reach_scales(arm: Arm) -> list[float]:
    """Scales of TwoLinkFlexArm-v0's observation, in its order."""
    hub, elbow = rate_scale(arm, 0), rate_scale(arm, 1)
    speed, way = hub * arm.total_length, 0.5 * arm.total_length
    return [1.0, 1.0, 1.0, 1.0, hub, elbow, 0.1, 0.1, 0.3 * hub, 0.3 * hub, speed, speed, way, way]


def _slew(arm: Arm, weights: Array, period: float) -> Slew:
    return Slew(**_common(arm, weights, period, 1, slew_scales(arm)))


def _reach(arm: Arm, weights: Array, period: float) -> Reach:
    lengths = np.array([link.length for link in arm.links])
    return Reach(**_common(arm, weights, period, 2, reach_scales(arm)), lengths=lengths)


def _slew_starts(arm: Arm) -> Starts:
    return Starts(start=[(-math.pi, math.pi)], target=[(-math.pi / 2, math.pi / 2), (0.0, 0.0)])


def _reach_starts(arm: Arm) -> Starts:
    length = arm.total_length
    return Starts(
        start=[(-1.0, 1.0), (-1.8, 1.8)],
        target=[(0.3 * length, 0.95 * length), (-2.0 * math.pi / 3, 2.0 * math.pi / 3)],
        straight=0.5,
    )


SLEW = Kind(
    id="FlexibleArm-v0",
    task="slew",
    n_links=1,
    arm="strip",
    duration=4.0,
    targets=1,
    rewards={"accuracy": 0.5, "settle": 1.0, "distance": 0.5, "effort": 0.01, "vibration": 0.02, "failure": 5.0},
    names=("hub_sin", "hub_cos", "hub_rate", "tip_deflection", "tip_deflection_rate", "target_error"),
    build=_slew,
    starts=_slew_starts,
)

REACH = Kind(
    id="TwoLinkFlexArm-v0",
    task="reach",
    n_links=2,
    arm="de_luca_siciliano",
    duration=8.0,
    targets=2,
    rewards={"accuracy": 0.5, "settle": 1.0, "distance": 0.5, "effort": 0.01, "vibration": 0.0, "failure": 5.0},
    names=(
        "hub_sin", "hub_cos", "elbow_sin", "elbow_cos", "hub_rate", "elbow_rate",
        "tip_deflection_1", "tip_deflection_2", "tip_deflection_rate_1", "tip_deflection_rate_2",
        "tip_velocity_x", "tip_velocity_y", "to_target_x", "to_target_y",
    ),
    build=_reach,
    starts=_reach_starts,
)  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One key of info: where it stands in the info section; count None: one number, a float."""

    name: str
    first: int
    count: int | None


def info_entries(kind: Kind, full: bool) -> tuple[Entry, ...]:
    """Numbers in info, in order; the words (success, range, status, reason) are made from codes beside them."""
    n, targets = kind.n_links, kind.targets
    one = None if n == 1 else n
    torque = DEFLECTION + n + targets
    terms = torque + n
    tail = terms + len(REWARDS)
    entries = [
        Entry("tip_position", TIP, 2),
        Entry("tip_deflection", DEFLECTION, one),
        Entry("target", DEFLECTION + n, None if targets == 1 else targets),
        Entry("hub_torque", torque, None),
        Entry("joint_torque", torque, n),
        *(Entry(f"reward_{name}", terms + k, None) for k, name in enumerate(REWARDS)),
        Entry("error_estimate", tail + ERROR, None),
    ]
    if full:
        names = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated", "work")
        entries += [Entry(name, tail + ENERGIES + k, None) for k, name in enumerate(names)]
    return tuple(entries)


def reward_weights(kind: Kind, given: Mapping[str, float] | None) -> Array:
    """Weights of REWARDS: the kind's, with what is given in their place."""
    weights = dict(kind.rewards)
    if given is not None:
        table = check.table_of("reward", given)
        check.known_keys("reward", table, REWARDS, "reward term")
        for name, value in table.items():
            weights[name] = check.number(f"reward.{name}", value, minimum=0.0)
    return np.array([weights[name] for name in REWARDS])


__all__ = ["CLIP", "Entry", "IN_RANGE", "Kind", "REACH", "REWARDS", "SLEW", "SUCCESS", "info_entries", "reward_weights"]
