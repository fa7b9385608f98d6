"""Definitions of tasks for single and vector environments: arm, spaces, scales, rewards and initial states."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from .. import validation as check
from ..batch import (
    CONTACT,
    CONTACT_POINT,
    FURTHER,
    TERM_ARGUMENTS,
    Chain,
    Extras,
    Reach,
    Slew,
    Starts,
    Task,
    info_places,
    with_terms,
)
from ..bodies import PLANE, Axes
from ..files import imported
from ..parameters import Arm
from ..physics.layout import BASE_POSE
from ..rigid import centre_shift, rate_scale
from ..sensors import Sensors
from ..settings import FORMULATIONS, PRESETS, Settings
from ..validation import Array
from .attainable import IN_PLANE, Conditions
from .targets import ANGLE_OF_TIP, POINT, Pair, Target
from .vibration import shake

HOLD_TIME = 0.5
"""Time, s: an episode is a success if the arm stays within the bounds for the last HOLD_TIME of the episode."""

REWARDS = ("accuracy", "settle", "distance", "effort", "vibration", "failure")
"""Names of the reward terms of slew and reach, in order."""

FAILURE = "failure"
"""Name of the term that is paid once, in the control period that ends an episode by failure."""

CHANGE, COST = "change", "cost"
"""Names of the terms for changes of the action and for `cost`; if used, they precede the failure term."""

PRESS = "press"
"""Name of the task in which the tip slides along a wall under a commanded normal force."""

LAND = "land"
"""Name of the task in which the tip touches a wall with little impulse and stays."""

ATTITUDE = "attitude"
"""Name of the reward term for a floating base's attitude, and of the attitude's bound in a success."""


def ideal_sensors(arm: Arm) -> Sensors:
    """Return ideal encoders, and a gauge at the root of each flexible link."""
    return Sensors.ideal(arm.links)


@dataclass(frozen=True)
class Kind:
    """Definition of a task for arms whose number of links is in the range `links` (maximum None: any number).

    id: id in Gymnasium's registry. task: name of the default task. arm: name of the default arm. duration: default
    length of an episode, s. target: type of the targets, an angle or a point. rewards: names and default weights of the
    reward's terms, in the order in which the task's `judge` computes them; the last term is failure. entries: names and
    scales of an arm's observation, in the order of `observe`. record: function of an arm that returns the class of the
    compiled task; the class determines the kernels. starts: ranges of random initial states, by arm and version of the
    rules. bands: default bounds of success with their units, by name. replays: default motions of task="replay";
    additional joints use the last motion. axes: axes along which arms move (`Arm.axes`). period: control period, s.
    gravity: default gravity, m/s^2. settings: default settings of exact beams; None for the usual default formulation.
    formulations: formulations and presets that arms of these axes have in environments. conditions: conditions on drawn
    targets and paths. vibrate: function of an arm, settings and gravity that returns the modes of `initial_vibration`.
    amplitudes: number of modes that `vibrate` returns. sensors: function that returns the sensors of "measured"
    observations for an arm without sensors.
    """

    id: str
    task: str
    links: tuple[int, int | None]
    arm: str
    duration: float
    target: Target
    rewards: Mapping[str, float]
    entries: Callable[[Arm], list[tuple[str, float]]]
    record: Callable[[Arm], type[Task]]
    starts: Callable[[Arm, int], Starts]
    bands: Mapping[str, tuple[float, str]]
    replays: str
    axes: Axes = PLANE
    period: float = 0.02
    gravity: tuple[float, ...] | None = None
    settings: Mapping[str, Any] | None = None
    formulations: tuple[str, ...] = (*FORMULATIONS, *PRESETS)
    conditions: Conditions = IN_PLANE
    vibrate: Callable[[Arm, Settings, tuple[float, ...] | None], Array] = shake
    amplitudes: int = 1
    sensors: Callable[[Arm], Sensors] = ideal_sensors

    def fits(self, arm: Arm) -> bool:
        """Return whether an arm has a number of links and axes (plane or space) that the task permits."""
        least, most = self.links
        return self.has_axes_of(arm) and least <= arm.n_links and (most is None or arm.n_links <= most)

    def has_axes_of(self, arm: Arm) -> bool:
        """Return whether task and arm are both in the plane or both in space."""
        return arm.axes == self.axes

    def check_axes(self, arm: Arm) -> None:
        """Raise `InvalidValue` unless task and arm are both in the plane or both in space."""
        if not self.has_axes_of(arm):
            arm.check_planar()
            what = f"must leave the x-y plane for {self.id}"
            what += "; FlexibleArm-v0 and MultiLinkFlexArm-v0 have arms of the plane"
            raise check.InvalidValue("arm", arm.name, what)

    def build(self, arm: Arm, weights: Array, period: float, aims: Mapping[str, Any], rules: int = 2) -> Task:
        """Return the constants of the task (a `tasks.task.Task`) for an arm.

        weights: weights of the reward's terms. period: control period, s. aims: fields of the task that differ from
        their defaults.
        """
        assert arm.torque_limits is not None
        scales = [scale for _, scale in self.entries(arm)]
        limits = [(-math.inf, math.inf) if r is None else r for r in arm.joint_limits or (None,) * arm.n_links]
        usual = self.record(arm)(
            links=(0,) * arm.n_links,
            targets=(0,) * self.target.numbers,
            terms=(0,) * len(weights),
            entries=(0,) * len(scales),
            length=arm.total_length,
            lengths=np.array([0.0 if link.rigid else link.span for link in arm.links]),
            scales=np.array(scales),
            rates=np.array([rate_scale(arm, k) for k in range(arm.n_links)]),
            weights=weights,
            torque_limits=np.array(arm.torque_limits),
            joint_limits=np.array(limits, np.float64).ravel(),
            hold=float(math.ceil(HOLD_TIME / period - 1e-9) + 1),
            bands=np.array([bound for bound, _ in self.bands.values()]),
            acted=(0,) * arm.n_links if CHANGE in self.rewards else (),
            charged=(0,) if COST in self.rewards else None,
            base=(0,) * (BASE_POSE.end if arm.base else 0),
            nearness=(0,) if rules > 1 else None,
        )
        return usual._replace(**aims)


def _slew_entries(arm: Arm) -> list[tuple[str, float]]:
    """Return the name and scale of each entry of a one-link observation, in the order of `tasks.slew`."""
    rate = rate_scale(arm, 0)
    return [
        ("hub_sin", 1.0), ("hub_cos", 1.0), ("hub_rate", rate), ("tip_deflection", 0.1),
        ("tip_deflection_rate", 0.3 * rate), ("target_error", 1.0), *_base_entries(arm),
    ]  # fmt: skip


def _reach_entries(arm: Arm) -> list[tuple[str, float]]:
    """Return the name and scale of each entry of the observation, in the order of `tasks.reach`."""
    hub, length, joints = rate_scale(arm, 0), arm.total_length, arm.joint_names
    return [
        *((f"{joint}_{of}", 1.0) for joint in joints for of in ("sin", "cos")),
        *((f"{joint}_rate", rate_scale(arm, k)) for k, joint in enumerate(joints)),
        *((name, 0.1) for name in arm.by_link("tip_deflection")),
        *((name, 0.3 * hub) for name in arm.by_link("tip_deflection_rate")),
        *((f"tip_velocity_{axis}", hub * length) for axis in "xy"),
        *((f"to_target_{axis}", 0.5 * length) for axis in "xy"),
        *_base_entries(arm),
    ]


def _base_entries(arm: Arm) -> list[tuple[str, float]]:
    """Return names and scales of the observation's entries for a floating base.

    The scale of the base's rate is the rate of a quarter turn by the hub's full torque (`rate_scale`). The scale of the
    hub's velocity contains the arm's share of the total mass.
    """
    if arm.base is None:
        return []
    assert arm.torque_limits is not None
    share = arm.mass / (arm.mass + arm.base.mass)
    rate = math.sqrt(arm.torque_limits[0] * 0.5 * math.pi / arm.base.inertia)
    return [
        ("base_sin", 1.0), ("base_cos", 1.0), ("base_rate", rate),
        *((f"base_velocity_{axis}", share * rate_scale(arm, 0) * arm.total_length) for axis in "xy"),
        *((f"base_offset_{axis}", 0.5 * share * arm.total_length) for axis in "xy"),
    ]  # fmt: skip


def _slew_record(arm: Arm) -> type[Task]:
    return Slew


def _reach_record(arm: Arm) -> type[Task]:
    return Reach if arm.n_links == 2 else Chain


def within(arm: Arm, ranges: Sequence[Pair]) -> list[Pair]:
    """Intersect ranges of joint angles with the joint limits; for a joint without intersection, return the limits."""
    found = []
    for (low, high), own in zip(ranges, arm.joint_limits or (None,) * arm.n_links, strict=True):
        least, most = own or (low, high)
        both = max(low, least), min(high, most)
        found.append(both if both[0] < both[1] else (least, most))
    return found


def at_zero(arm: Arm) -> float:
    """Return the probability of episodes that start with all joint angles 0: 0.5, or 0 if the limits exclude 0."""
    return 0.5 * all(own is None or own[0] <= 0.0 <= own[1] for own in arm.joint_limits or ())


def _slew_starts(arm: Arm, rules: int) -> Starts:
    return Starts(start=within(arm, [(-math.pi, math.pi)]), target=[(-math.pi / 2, math.pi / 2), (0.0, 0.0)])


def _reach_starts(arm: Arm, rules: int) -> Starts:
    """Return the ranges of starts (joint angles, rad) and of targets (distance, m, and bearing, rad).

    Under rules 2 each joint begins within +-0.5 rad. Under rules 1 the hub begins within +-1 rad and an elbow within
    +-3.6 / N rad. With these ranges, large turns and elbows bent to the wrong side are rare; from such elbows policies
    hit the joint limits.
    """
    length, elbow = arm.total_length, 3.6 / arm.n_links
    hub, elbow = (1.0, elbow) if rules == 1 else (0.5, min(0.5, elbow))
    far = 0.95 * (length - 2.0 * centre_shift(arm))  # wherever the arm starts: the centre of mass of all stays there
    return Starts(
        start=within(arm, [(-hub, hub)] + [(-elbow, elbow)] * (arm.n_links - 1)),
        target=[(0.3 * length, far), (-2.0 * math.pi / 3, 2.0 * math.pi / 3)],
        straight=at_zero(arm),
    )


SLEW = Kind(
    id="FlexibleArm-v0",
    task="slew",
    links=(1, 1),
    arm="strip",
    duration=4.0,
    target=ANGLE_OF_TIP,
    rewards=dict(zip(REWARDS, (0.5, 1.0, 0.5, 0.01, 0.02, 5.0), strict=True)),
    entries=_slew_entries,
    record=_slew_record,
    starts=_slew_starts,
    bands={"position": (math.pi / 180.0, "rad"), "speed": (math.inf, "rad/s"), "vibration": (0.01, "1/s")},
    replays="robot_arm_motion",
)

REACH = Kind(
    id="TwoLinkFlexArm-v0",
    task="reach",
    links=(2, 2),
    arm="de_luca_siciliano",
    duration=8.0,
    target=POINT,
    rewards=dict(zip(REWARDS, (0.5, 1.0, 0.5, 0.01, 0.0, 5.0), strict=True)),
    entries=_reach_entries,
    record=_reach_record,
    starts=_reach_starts,
    bands={"position": (0.01, ""), "speed": (0.05, "1/s")},
    replays="two_link_motion",
)

CHAIN = replace(REACH, id="MultiLinkFlexArm-v0", links=(2, None), arm="three_strips", duration=10.0)


@dataclass(frozen=True)
class Entry:
    """Entry of info: name, first row in the batch's table, and number of values (None: a float, not an array)."""

    name: str
    first: int
    count: int | None


def info_entries(
    kind: Kind,
    task: Task,
    full: bool,
    motors: bool,
    extras: Extras,
    fitted: bool,
    drawn: Mapping[str, int],
    touches: int = 0,
) -> tuple[Entry, ...]:
    """Return the numeric entries of info, in order.

    Flags and texts in info (success, range, status, reason) are not included. full: True if info has energies. motors:
    True if info has motor angles and rates, for joints that are not ideal. extras: options that add entries. fitted:
    True if the solver has a step_tolerance. drawn: index of each random factor, by name. touches: number of points that
    may touch obstacles.
    """
    n, targets, at = len(task.links), len(task.targets), info_places(task)
    entries = [
        Entry("tip_position", at.tip, at.deflection - at.tip),
        Entry("tip_deflection", at.deflection, None if at.twist - at.deflection == 1 else at.twist - at.deflection),
        *([Entry("twist", at.twist, n)] if at.target > at.twist else []),
        Entry("target", at.target, None if targets == 1 else targets),
        Entry("hub_torque", at.torque, None),
        Entry("joint_torque", at.torque, n),
        *(Entry(f"reward_{name}", at.terms + k, None) for k, name in enumerate(kind.rewards)),
        Entry("error_estimate", at.error, None),
    ]
    if full:
        names = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated", "work")
        entries += [Entry(name, at.energies + k, None) for k, name in enumerate(names)]
    if motors:
        entries += [Entry("motor_angle", at.motors, n), Entry("motor_rate", at.motors + n, n)]
    first = at.further
    if extras.cost is not None or extras.keep_out is not None:
        entries += [Entry(name, first + getattr(FURTHER, name), None) for name in ("cost", "episode_cost")]
    if extras.keep_out is not None:
        entries += [Entry(name, first + getattr(FURTHER, name), None) for name in ("clearance", "penetration")]
    if extras.payload_change is not None:
        entries.append(Entry("payload_mass", first + FURTHER.payload, None))
    if extras.pushes is not None:
        entries.append(Entry("push", first + FURTHER.push, len(kind.axes)))
    if task.base:
        of_base = first + FURTHER.base
        entries += [Entry("base_attitude", of_base, None), Entry("base_position", of_base + 1, 2)]
    if fitted:
        entries.append(Entry("step_error", first + FURTHER.step_error, None))
    entries += [Entry(f"drawn_{name}", first + FURTHER.drawn + k, None) for name, k in drawn.items()]
    if touches:
        behind = first + len(task.further) - CONTACT.end
        entries += [Entry(f"contact_{name}", behind + k, None) for k, name in enumerate(CONTACT._fields[:-2])]
        entries += [Entry("target_force", behind + CONTACT.target, None)] if kind.task == PRESS else []
        if touches > 1:
            of_points = CONTACT_POINT.offsets(behind - CONTACT_POINT.offsets(0, touches).end, touches)
            rows = zip(of_points._fields, of_points, strict=True)
            entries += [Entry(f"contact_{name}_at_points", int(at), touches) for name, at in rows if name != "end"]
    return tuple(entries)


def afloat(kind: Kind, arm: Arm) -> Kind:
    """Return the task for an arm on a floating base, with a reward term and a success bound for the base's attitude."""
    if arm.base is None:
        return kind
    terms = list(kind.rewards.items())
    return replace(
        kind, rewards=dict([*terms[:-1], (ATTITUDE, 0.5), terms[-1]]),
        bands={**kind.bands, ATTITUDE: (math.inf, "rad")},
    )  # fmt: skip


def priced(kind: Kind, reward: Any) -> Kind:
    """Return the task's definition with the terms `cost` and `change` if `reward` contains weights of these terms."""
    more = [(name, 0.0) for name in (COST, CHANGE) if isinstance(reward, Mapping) and name in reward]
    terms = list(kind.rewards.items())
    return replace(kind, rewards=dict([*terms[:-1], *more, terms[-1]])) if more else kind


def with_own_terms(kind: Kind, value: Any) -> Kind:
    """Return the task's definition with the user's reward terms (keyword `reward_terms`), each of weight 1.

    value: dict from the term's name to a kernel, or to the kernel's name "module:name".
    """
    if value is None:
        return kind
    table, terms = check.table_of("reward_terms", value), list(kind.rewards.items())
    for name, term in table.items():
        path = check.joined("reward_terms", str(name))
        if isinstance(term, str):
            table[name] = term = imported(path, term)
        if not isinstance(name, str) or not name.isidentifier() or name in (*kind.rewards, COST, CHANGE, ATTITUDE):
            what = f"must be a name of its own, none of {', '.join((*kind.rewards, COST, CHANGE, ATTITUDE))}"
            raise check.InvalidValue("reward_terms", name, what)
        function = getattr(term, "__wrapped__", None)  # a kernel's, also where nothing is compiled
        if function is None or tuple(inspect.signature(function).parameters) != TERM_ARGUMENTS:
            what = f"must be a kernel (flexarm_env.compiler.kernel) of ({', '.join(TERM_ARGUMENTS)})"
            raise check.InvalidValue(path, term, what)
    record = partial(_record_with, kind.record, tuple(table.values()))
    return replace(kind, rewards=dict([*terms[:-1], *((name, 1.0) for name in table), terms[-1]]), record=record)


def _record_with(record: Callable[[Arm], type[Task]], terms: tuple[Any, ...], arm: Arm) -> type[Task]:
    return with_terms(record(arm), terms)


PAYING = ("accuracy", "settle", "distance", ATTITUDE)
"""Terms that are never negative under rules 2."""

RULES = (1, 2)
"""Versions of the rules of rewards and drawn targets (keyword `rules`), the current one last: `reward_weights`."""


def reward_weights(
    kind: Kind, chosen: Mapping[str, float] | None, joints: int, period: float, limit: int, rules: int
) -> Array:
    """Return the reward weights for one control period: the weights in `chosen`, and defaults for all other terms.

    With rules 2 the terms distance and attitude are rewards: a bound minus the loss (`tasks.task.left_of`). Default
    weights refer to the task's default control period. For another period all weights except that of failure are
    proportional to the period, so that an episode's return does not depend on it. The default weight of the term
    failure is the sum of two amounts: the largest loss by all other terms in an episode, and the largest reward in the
    time `HOLD_TIME`. The first amount ensures that an early end is never an advantage. Because of the second amount,
    policies learn to avoid the joint limits. With rules 1 the terms distance and attitude are losses of at most 1,
    weights do not depend on the period, and the weight of failure is the task's default.

    joints: number of joints. period: control period, s. limit: number of control periods in an episode.
    """
    weights: dict[str, float | None] = dict(kind.rewards) | {FAILURE: None}
    table = {} if chosen is None else check.table_of("reward", chosen)
    check.known_keys("reward", table, (*kind.rewards, COST, CHANGE), "reward term")
    for name, value in table.items():
        weights[name] = check.number(f"reward.{name}", value, minimum=0.0, maximum=check.LARGEST)
    failure, share = weights.pop(FAILURE), 1.0 if rules == 1 else period / kind.period
    each = {name: share * weight for name, weight in weights.items() if weight is not None}
    if failure is None:
        held = HOLD_TIME / period * sum(each.get(name, 0.0) for name in PAYING)
        failure = kind.rewards[FAILURE] if rules == 1 else limit * most_lost(each, joints) + held
    return np.array([(each | {FAILURE: failure})[name] for name in kind.rewards])


def most_lost(weights: Mapping[str, float], joints: int) -> float:
    """Return the largest loss in a control period by all reward terms except failure.

    Before weighting, the largest loss by a term is 1 per joint for effort, 4 per joint for change, 0 for terms that are
    never negative, and 1 for every other term.
    """
    largest = {**dict.fromkeys(PAYING, 0.0), "effort": joints, CHANGE: 4.0 * joints}
    return float(sum(largest.get(name, 1.0) * weight for name, weight in weights.items()))
