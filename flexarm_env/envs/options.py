"""Validate the arguments of `gymnasium.make`, and create the environment's `Batch` from them."""

import dataclasses
import inspect
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .. import arms
from .. import validation as check
from ..batch import ALWAYS, CLIP, FACTOR_NAMES, FURTHER, Batch, Extras, Starts, Task
from ..compiler import compiling
from ..parameters import Arm, Base
from ..physics import precision
from ..physics.gauges import Spot
from ..physics.model import STIFFNESSES
from ..physics.reading import reading_of
from ..scene import Contact, touching_points
from ..sensors import Law, Sensors
from ..settings import PRESETS, Settings, expand_preset, merged
from ..shapes import Shape
from . import contacts as touch
from . import events, resolution
from .features import (
    ACTION_MODES,
    Frame,
    amplified,
    controller,
    gauge_scales,
    gravity_of,
    table_of,
    with_friction,
    with_hub,
)  # fmt: skip
from .features import actuator as make_actuator
from .features import reference as make_reference
from .features import sensors as make_sensors
from .floating import check_afloat, with_base
from .keywords import SOLVER_OPTIONS
from .motion import Prescribed, prescribed
from .observation import ACTED, checked_observation, sensors_of, sight
from .pressing import pressing
from .resolution_warnings import warn, warn_of_times
from .small_motions import Drive
from .task import COST, LAND, PRESS, RULES, Entry, Kind, afloat, info_entries, priced, reward_weights, with_own_terms
from .trials import Trial, amplification, is_known, trials_of

INFO_LEVELS = ("standard", "full", "numbers")
RENDER_MODES = ("human", "rgb_array")

DEFAULT_FORMULATION = "elastica"
DEFAULT_OPTIONS: dict[str, dict[str, Any]] = {
    "elastica": {"nodes": 4, "dt": 0.02 / 3.0, "tolerance": 1e-5},
    "geometrically_exact": {"elements": 3, "dt": 0.0025, "tolerance": 1e-6},
    "floating_frame": {"segments": 2, "dt": 0.0025, "tolerance": 1e-6},
    "paper": {"segments": 5, "dt": 0.0025, "tolerance": 1e-6},
}
OF_MODES: dict[str, Any] = {"dt": 0.005, "tolerance": 1e-6}
"""DEFAULT_OPTIONS: default solver options of the environments, by formulation. OF_MODES: default solver options for
links reduced to modes.

The values follow from `benchmarks/choose_default.py`.
"""

MOST_PERIODS, MOST_STEPS = 10**9, 10**4
"""Largest number of control periods in an episode, and of solver steps in a period.

Ctrl-C waits for one period, so the second limit bounds this wait to a fraction of a second.
"""


class Given:
    """Type of the default value of arguments for which None is a meaningful value."""

    def __repr__(self) -> str:
        return "<the arm's>"


OF_THE_ARM = Given()


@dataclass(frozen=True)
class Plan:
    """Validated arguments of an environment, from which its `Batch` is created.

    names, scales: names and scales of the entries of one observation. history: number of observations that are stacked,
    oldest first. record: constants of the task (`tasks.task.Task`). gauges: link and position of each strain gauge.
    gauge_scales: scale of each gauge, 1/m. limit: number of control periods in an episode. max_steps: value of the
    keyword `max_episode_steps`. motion: motion of task="replay". entries: the numeric entries of info; full: True if
    info has energies; words: True if info has texts. action_mode: keyword that determines the quantity that an action
    commands. keep_out: shapes that the arm must avoid. contacts: obstacles that the arm can touch. estimate: estimated
    error of the tip due to mesh and step, divided by the arm's length. coarse: warning about this error, or "".
    """

    kind: Kind
    task: str
    arm: Arm
    settings: Settings
    period: float
    duration: float
    limit: int
    max_steps: int | None
    gravity: tuple[float, ...] | None
    full: bool
    words: bool
    render_mode: str | None
    starts: Starts
    record: Task
    extras: Extras
    names: tuple[str, ...]
    scales: tuple[float, ...]
    history: int
    sensors: Sensors
    gauges: tuple[Spot, ...]
    gauge_scales: tuple[float, ...]
    motion: Prescribed | None
    entries: tuple[Entry, ...]
    action_mode: str
    keep_out: tuple[Shape, ...]
    contacts: tuple[Contact, ...]
    estimate: float
    coarse: str

    def batch(self, n: int, threads: int | None = 1) -> Batch:
        """Create a `Batch` of n arms of this environment."""
        with compiling(self.kind.id, 2):
            made = Batch(
                self.arm, self.settings, n, self.record, self.starts,
                period=self.period, gravity=self.gravity, account=self.full, threads=threads, extras=self.extras,
                left=self.estimate, contacts=self.contacts,
            )  # fmt: skip
        warn(self.coarse)  # what is refused by name is not warned of before
        return made

    @cached_property
    def farthest(self) -> float:
        """Largest magnitude of an initial joint angle, rad (see `physics.precision`)."""
        return precision.farthest(self.arm, self.settings, precision.largest(self.starts.drawn))

    @property
    def deflection_bound(self) -> float:
        """Largest valid tip deflection divided by link length; it is finite only for modal links in the plane."""
        return reading_of(self.arm).deflection_bound(self.settings)

    @property
    def observation_bounds(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Largest value of each entry of the observation: CLIP, or 1 for sines and cosines without noise."""
        noisy = self.extras.sensors is not None and self.extras.sensors.noise.any()
        exact = [(name.endswith(("_sin", "_cos")) and not noisy) or name.startswith(ACTED) for name in self.names]
        return np.array([1.0 if one else CLIP for one in exact] * self.history, np.float32)


def plan(
    kind: Kind,
    *,
    arm: Arm | str | os.PathLike[str] | None = None,
    base: Base | Mapping[str, float] | None = None,
    formulation: str | None = None,
    control_dt: float | None = None,
    action_mode: str = "torque",
    residual_share: float | None = None,
    duration: float | None = None,
    task: str | None = None,
    reference: Any = None,
    motion: Any = None,
    reward: Mapping[str, float] | None = None,
    reward_terms: Mapping[str, Any] | None = None,
    rules: int = RULES[-1],
    randomization: Mapping[str, Sequence[float]] | None = None,
    observation: str | Sequence[str] = "full",
    history: int = 1,
    sensors: Mapping[str, Any] | Sensors | None = None,
    actuator: Mapping[str, Any] | None = None,
    cost: Mapping[str, Any] | None = None,
    pushes: Mapping[str, Any] | None = None,
    payload_change: Mapping[str, Any] | None = None,
    keep_out: Any = None,
    contacts: Any = None,
    success: Mapping[str, Any] | None = None,
    turns: str = "exact",
    starts: Mapping[str, Any] | None = None,
    initial_vibration: float = 0.0,
    joint_limits: Any = OF_THE_ARM,
    gravity: Sequence[float] | None = None,
    info_level: str = "standard",
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **options: Any,
) -> Plan:
    """Check the arguments of an environment (see its class); a ValueError names the key, the value and the rule."""
    own = with_friction(with_base(_arm(kind, arm, joint_limits), base), actuator)
    kind, contacts, sensors, reference = pressing(kind, own, task, duration, contacts, sensors, reference)
    # trials run without the user's reward terms, which move nothing and would be kept with the arm
    of_trials = afloat(kind, own)
    kind = priced(with_own_terms(of_trials, reward_terms), reward)
    factors = _factors(randomization, own)
    own, hub = with_hub(own, (randomization or {}).get("hub_inertia"))
    own, amplifier = amplified(own, check.choice("action_mode", action_mode, ACTION_MODES))
    period = check.number("control_dt", kind.period if control_dt is None else control_dt, "s", above=0.0)
    drive = Drive.of(own, action_mode, residual_share, amplifier)
    down = gravity_of(kind, gravity)
    # one link is tried under a PD loop alone, which may chatter
    tried = own.n_links > 1 or drive.residual is not None
    named = arms.resolve(kind.arm if arm is None else arm)
    packaged, trial = (named if is_known(named, factors) else None), None
    if tried and packaged is None:
        trial = trials_of(of_trials, own, period, down, action_mode, residual_share, amplifier, factors)
    settings, estimate, coarse = _settings(kind, formulation, period, options, own, drive, factors, trial, packaged)
    length = check.number("duration", kind.duration if duration is None else duration, "s", minimum=period)
    if not length / period <= MOST_PERIODS:
        raise check.InvalidValue("duration", length, f"must be at most {MOST_PERIODS:g} control periods of {period} s")
    limit = max(1, math.floor(length / period * (1.0 + 1e-9)))
    if duration is None and max_episode_steps is None and not _packaged(arm):
        warn_of_times(own, length)
    if max_episode_steps is not None:
        max_episode_steps = check.integer("max_episode_steps", max_episode_steps, minimum=1)
        limit = min(limit, max_episode_steps)
    if render_mode is not None:
        check.choice("render_mode", render_mode, RENDER_MODES)
    version = check.integer("rules", rules, minimum=RULES[0], maximum=RULES[-1])
    level = check.choice("info_level", info_level, INFO_LEVELS)
    full, words = level == "full", level != "numbers"
    word = check.choice("task", kind.task if task is None else task, (kind.task, "track", "replay"))
    moves = word in ("track", PRESS, LAND)
    events.only_with("reference", reference, "track" if moves else word, "track")
    events.only_with("motion", motion, word, "replay")
    frame = Frame(kind, own, settings, period, down)
    heavy = events.payload_change(frame, payload_change)
    frame = touch.framed(frame, contacts, word, limit * period, options, factors, heavy)
    settings, touched = frame.settings, frame.contacts
    wanted, frames = checked_observation(observation, history)
    check_afloat(
        frame, word, action_mode, wanted, pushes=pushes, payload_change=payload_change, gravity=gravity,
        initial_vibration=initial_vibration,
    )  # fmt: skip
    carried = sensors_of(kind, own, wanted, sensors)
    seen = sight(frame, wanted, carried, kind.target.entries(own) if moves else [])
    gauges = carried.strain_gauges
    extras = Extras(
        controller=controller(frame, action_mode, residual_share),
        amplifier=amplifier,
        actuator=make_actuator(frame, actuator),
        sensors=make_sensors(frame, sensors, gauges, seen.names[: seen.read], seen.scales[: seen.read]),
        reference=make_reference(frame, reference, limit) if moves else None,
        instruments=seen.instruments,
        selection=seen.selection(frames),
        cost=events.cost(frame, cost),
        pushes=events.pushes(frame, pushes),
        payload_change=heavy,
        keep_out=events.keep_out(frame, keep_out),
    )
    if word == "replay":
        events.unguided(extras, "task", word)
    weights = reward_weights(kind, reward, own.n_links, period, limit, version)
    if COST in kind.rewards and extras.cost is None and extras.keep_out is None:
        what = "must be given with `cost` or `keep_out`, which say what costs"
        raise check.InvalidValue("reward.cost", dict(reward or {})[COST], what)
    begun, absolute = events.starts(kind, own, starts, RULES[0] if touched else version)
    laws, modes = any(factors.get(name, (1.0, 1.0)) != (1.0, 1.0) for name in OF_JOINTS), None
    vibration = check.number("initial_vibration", initial_vibration, minimum=0.0, maximum=0.5)
    if vibration > 0.0:
        modes = kind.vibrate(own, settings, frame.gravity)
        modes = touch.with_rows(modes, touched, kind.amplitudes - 1)
    begun = dataclasses.replace(begun, drawn=factors, laws=laws, hub=hub, vibration=vibration, shake=modes)
    drawn = {name: k for k, name in enumerate(FACTOR_NAMES) if name in (randomization or {})}
    drawn |= _drawn_offsets(extras, carried.readings(own, own.axes))
    aims = events.aims(frame, extras, success, turns, absolute, max(drawn.values(), default=-1))
    record = kind.build(own, weights, period, aims, version)
    if version > 1 and word == kind.task and not moves:
        begun = dataclasses.replace(begun, attainable=kind.conditions.of_targets(own, down, record, begun, extras))
    if version > 1 and touched and word != "replay":
        begun = touch.free_starts(frame, record, begun, word == kind.task and not moves)
    if version > 1 and moves:
        moving = kind.conditions.of_paths(own, down, record, begun, extras, period, limit)
        extras = dataclasses.replace(extras, reference=moving)
    return Plan(
        kind=kind, task=word, arm=own, settings=settings, period=period, duration=length, limit=limit,
        max_steps=max_episode_steps, gravity=frame.gravity, full=full, words=words, render_mode=render_mode,
        starts=begun, record=record, extras=extras, names=seen.of(seen.names), scales=seen.of(seen.scales),
        history=frames, sensors=carried, gauges=tuple(gauge.spot for gauge in gauges),
        gauge_scales=tuple(gauge_scales(frame, gauges)), estimate=estimate, coarse=coarse,
        motion=_replayed(kind, own.n_links, motion) if word == "replay" else None,
        entries=info_entries(
            kind, record, full, full and own.jointed and word != "replay", extras, settings.step_tolerance is not None,
            drawn, len(touching_points(touched, own)),
        ),
        action_mode=action_mode, keep_out=events.shapes_of(kind, keep_out), contacts=touched,
    )  # fmt: skip


def with_starts(plan: Plan, ranges: Mapping[str, Any] | None) -> Plan:
    """Return the plan with other ranges of initial states and targets (keyword `starts`)."""
    rules = RULES[0] if plan.record.nearness is None or plan.contacts else RULES[-1]
    begun, absolute = events.starts(plan.kind, plan.arm, ranges, rules)
    if plan.kind.target.numbers == 1 and absolute != (plan.record.relative == 0.0):
        raise check.InvalidValue("starts.absolute", absolute, "must stay as in gymnasium.make")
    begun = dataclasses.replace(plan.starts, start=begun.start, target=begun.target, straight=begun.straight)
    if plan.record.nearness is not None and plan.task == plan.kind.task:
        needs = plan.kind.conditions.of_targets(plan.arm, plan.gravity, plan.record, begun, plan.extras)
        begun = dataclasses.replace(begun, attainable=needs)
    if begun.free is not None:
        frame = Frame(plan.kind, plan.arm, plan.settings, plan.period, plan.gravity, plan.contacts)
        begun = touch.free_starts(frame, plan.record, begun, begun.free_targets is not None)
    return dataclasses.replace(plan, starts=begun)


def _drawn_offsets(extras: Extras, readings: Mapping[str, tuple[str, Law]]) -> dict[str, int]:
    """Return the offsets, by name, of drawn delays, lags and gains, counted from the end of the drawn factors in info.

    readings: table of the sensors' readings, with their names as keys.
    """
    first, found, late = FURTHER.told - FURTHER.drawn, {}, extras.sensors
    if extras.actuator is not None and extras.actuator.jitter is not None:
        found["command_delay"] = first
    if extras.actuator is not None and extras.actuator.lag is not None:
        found["command_lag"] = first + 2
    if late is not None and late.drawn is not None:
        found["observation_delay"] = first + 1
    channels = [(name, law) for name, (place, law) in readings.items() if "encoders" not in place or "_angle" in name]
    gains = {f"{name}_gain": k for k, (name, law) in enumerate(channels, first + 3) if law.gains[0] < law.gains[1]}
    return found | gains


def _replayed(kind: Kind, n_links: int, motion: Any) -> Prescribed:
    """Return the motion that every episode of task="replay" follows."""
    if motion is not None:
        return prescribed(motion, n_links, path="motion")
    usual = prescribed(kind.replays, n_links, path="motion")
    last, function = usual.functions[-1]
    return dataclasses.replace(usual, functions=(*usual.functions, *((k, function) for k in range(last + 1, n_links))))


def _packaged(arm: Any) -> bool:
    """Return whether an arm is one of the package's arms or the environment's default arm."""
    return arm is None or (isinstance(arm, str) and arm in arms.names())


def _arm(kind: Kind, value: Any, joint_limits: Any) -> Arm:
    """Return the arm of an environment with the given joint limits, after checking the arm against the task."""
    arm = arms.resolve(kind.arm if value is None else value)
    kind.check_axes(arm)
    least, most = kind.links
    if arm.n_links < least or (most is not None and arm.n_links > most):
        wanted = f"{least}" if most == least else f"at least {least}"
        raise check.InvalidValue("arm", arm.name, f"must have {wanted} link(s) for {kind.id}, not {arm.n_links}")
    for k, link in enumerate(arm.links):
        if link.curved:
            what = "must be 0 in the environments, whose targets and deflections are those of straight links"
            raise check.InvalidValue(f"arm.links[{k}].curvature", link.curvature, what)
    if arm.torque_limits is None:
        what = f"an environment needs {arm.n_links} torque limit(s) (N m)"
        file = value if isinstance(value, str | os.PathLike) else None
        with check.in_file(file):
            raise check.MissingKey("arm.torque_limits" if file is None else "torque_limits", what)
    if not isinstance(joint_limits, Given):
        arm = dataclasses.replace(arm, joint_limits=joint_limits)
    return arm


def _settings(
    kind: Kind, formulation: str | None, period: float, options: dict[str, Any], arm: Arm, drive: Drive,
    drawn: Mapping[str, tuple[float, float]], trial: Trial | None, packaged: Arm | None,
) -> tuple[Settings, float, str]:  # fmt: skip
    """Return the settings completed by `resolution`, their error divided by the arm's length, and a warning (or "").

    packaged: the unchanged arm of the package; None for a user's arm.
    """
    default = DEFAULT_FORMULATION if kind.settings is None else "geometrically_exact"
    chosen = default if formulation is None else formulation
    if isinstance(chosen, str) and chosen in ("elastica", *PRESETS) and chosen not in kind.formulations:
        possible = " or ".join(repr(name) for name in kind.formulations)
        raise check.InvalidValue("formulation", chosen, f"must be {possible} in space")
    expand_preset(chosen, {name: value for name, value in options.items() if name in ARGUMENTS})
    for name in options:
        if name not in ARGUMENTS:
            raise check.UnknownArgument(name, ARGUMENTS)
    usual = DEFAULT_OPTIONS | ({} if kind.settings is None else {"geometrically_exact": dict(kind.settings)})
    base = dict(usual[chosen]) if options.get("modes") is None else OF_MODES
    chosen, options = expand_preset(chosen, options)
    settings = Settings.make(chosen, **merged(base, options))
    assert settings.dt is not None
    steps = period / settings.dt
    if options.get("dt") is None:
        if not steps <= MOST_STEPS:
            raise check.InvalidValue("control_dt", period, f"must be at most {MOST_STEPS} steps of {settings.dt:g} s")
    elif not steps <= MOST_STEPS:
        what = f"must be at least {period / MOST_STEPS:g} s, {MOST_STEPS} steps in a control period of {period!r} s"
        raise check.InvalidValue("dt", options["dt"], what)
    elif round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        what = f"must divide control_dt = {period!r} s into a whole number of steps"
        raise check.InvalidValue("dt", options["dt"], what)
    gain = 0.0 if packaged is None else amplification(packaged, chosen)
    found = resolution.resolve(arm, drive, period, chosen, base, options, drawn, trial, gain)
    # the rule does not know the foreshortening that the couplings "paper" and "linear" leave out
    known = found.settings.coupling in (None, "von_karman")
    return found.settings, found.estimate if known else math.inf, found.warning


OF_JOINTS = ("friction", "backlash", "motor_inertia", "hub_inertia")
"""Factors on properties of joints."""
LATER = FACTOR_NAMES[FACTOR_NAMES.index("hub_inertia") :]
"""Factors that are drawn only if at least one of these factors is given."""


def _factors(value: Any, arm: Arm) -> dict[str, events.Pair]:
    """Return the ranges of the factors of `randomization`, in order.

    Every arm draws the first `ALWAYS` of these factors. If the user gives a factor between `ALWAYS` and `LATER`, the
    arm draws all factors before `LATER`. For a factor of `LATER` the arm draws all factors that it supports.
    """
    names = [name for name in FACTOR_NAMES if name not in STIFFNESSES or name in reading_of(arm).stiffnesses]
    if isinstance(value, Mapping) and "length" in value:
        what = "is no factor, since the arms of a batch share their mesh: flexarm_env.envs.lengths and"
        raise check.InvalidValue("randomization.length", value["length"], f"{what} make_sb3_vec(..., lengths=...)")
    table, found = table_of("randomization", value, names), {}
    joints = [arm.joint(k) for k in range(arm.n_links)]
    there = {
        "friction": any(joint.friction_viscous > 0.0 or joint.friction_coulomb > 0.0 for joint in joints),
        "backlash": any(joint.backlash > 0.0 for joint in joints),
        "motor_inertia": any(joint.rotor > 0.0 for joint in joints),
        "payload": arm.payload.mass > 0.0, "payload_inertia": bool(np.any(arm.payload.inertia)),
        "damping": arm.damping[0] > 0.0,
    }  # fmt: skip
    for name in names:
        path = f"randomization.{name}"
        low, high = check.limits(path, table.get(name, (1.0, 1.0)), minimum=0.0)
        if low == 0.0 and name in ("EI", "EI_y", "GJ", "torque_constant"):
            raise check.InvalidValue(f"{path}[0]", low, "must be a positive number: an arm without it cannot be moved")
        if name == "motor_inertia" and low == 0.0:
            raise check.InvalidValue(f"{path}[0]", low, "must be positive: the link after a gear must have inertia")
        if name in table and not there.get(name, True):
            raise check.InvalidValue(path, table[name], f"must not be given: {arm.name} has none")
        found[name] = low, high
    count = ALWAYS
    if any(name in table for name in names[ALWAYS:]):
        count = len(names) if any(name in table for name in LATER) else names.index(LATER[0])
    return {name: found[name] for name in names[:count]}


ARGUMENTS = (*list(inspect.signature(plan).parameters)[1:-1], *SOLVER_OPTIONS)
