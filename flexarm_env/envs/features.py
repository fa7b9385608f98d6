"""Convert an environment's keyword arguments to its `Extras`: sensors, actuators, controllers, moving targets."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import bodies
from .. import sensors as description
from .. import validation as check
from ..batch import Actuator, Amplifier, Controller, Reference, Sensors, gauge_table
from ..parameters import Arm
from ..physics.joints.build import NOTHING
from ..physics.reading import reading_of
from ..rigid import inertia_beyond
from ..scene import Contact
from ..settings import Settings
from ..tasks import RESIDUAL_SHARE
from ..validation import Array
from .targets import AHEAD
from .task import Kind

ACTION_MODES = ("torque", "current", "voltage", "residual_pd")
LONGEST = 1000
"""Largest delay, in steps or control periods; the environment stores this many past values."""


@dataclass(frozen=True)
class Frame:
    """Properties of an environment on which the validation of its keywords depends.

    contacts: obstacles that the arm can touch.
    """

    kind: Kind
    arm: Arm
    settings: Settings
    period: float
    gravity: tuple[float, ...] | None
    contacts: tuple[Contact, ...] = ()


def table_of(path: str, value: Any, keys: Sequence[str]) -> dict[str, Any]:
    """Validate the keys of `value`, the table given for the keyword `path`; return the table, or {} for None."""
    table = {} if value is None else check.table_of(path, value)
    check.known_keys(path, table, keys)
    return table


def for_each(path: str, value: Any, n: int, unit: str = "", **bounds: float) -> Array:
    """Return an array with one number for each of n links or joints; `value` is one number for all, or n numbers."""
    many = check.several(value)
    values = check.sequence(path, value, f"{n} numbers{f' ({unit})' if unit else ''}", n) if many else (value,) * n
    names = [f"{path}[{k}]" if many else path for k in range(n)]
    return np.array([check.number(name, v, unit, **bounds) for name, v in zip(names, values, strict=True)])


def whole(path: str, value: Any, step: float, name: str, **bounds: float) -> int:
    """Convert the time `value`, s, to a number of steps of `step` s; raise InvalidValue if the number is not whole."""
    time = check.number(path, value, "s", **bounds)
    if not time / step < LONGEST + 0.5:
        raise check.InvalidValue(path, value, f"must be at most {LONGEST} {name} = {LONGEST * step:g} s")
    count = round(time / step)
    if abs(time / step - count) > 1e-6 * max(1.0, time / step):
        raise check.InvalidValue(path, value, f"must be a whole number of {name} = {step:g} s")
    return count


def _late(path: str, value: Any, step: float, name: str) -> tuple[int, int]:
    """Convert a delay, or a range of delays (s), to the smallest and largest whole number of steps."""
    if not check.several(value):
        return (whole(path, value, step, name, minimum=0.0),) * 2
    limits = enumerate(check.limits(path, value, "s", minimum=0.0))
    low, high = (whole(f"{path}[{k}]", limit, step, name) for k, limit in limits)
    return low, high


# --- controllers -------------------------------------------------------------------------------------
def controller(frame: Frame, mode: Any, share: Any) -> Controller | None:
    """Return the joint PD controllers whose set points are the actions; None if actions are torques or motor inputs.

    The proportional gain is such that an error of pi/4 rad causes the full torque. The derivative gain gives critical
    damping for the straight, rigid arm between the joint and the tip.
    """
    if check.choice("action_mode", mode, ACTION_MODES) != "residual_pd":
        if share is not None:
            raise check.InvalidValue("residual_share", share, 'must be given with action_mode="residual_pd" only')
        return None
    part = RESIDUAL_SHARE if share is None else check.number("residual_share", share, above=0.0)
    stiffness = np.array(frame.arm.torque_limits) / (math.pi / 4)
    inertia = np.array([inertia_beyond(frame.arm, k) for k in range(frame.arm.n_links)])
    return Controller(stiffness, 2.0 * np.sqrt(stiffness * inertia), part, (0,) if frame.arm.jointed else None)


def amplified(arm: Arm, mode: Any) -> tuple[Arm, Amplifier | None]:
    """Return the amplifier that converts currents or voltages to torques, and the arm with friction due to back-emf.

    Raises ValueError if a joint has no motor, or the motor has no limit or, for voltages, no resistance.
    """
    if mode not in ("current", "voltage"):
        return arm, None
    rows, joints, limits = [], [], arm.torque_limits
    assert limits is not None
    for k in range(arm.n_links):
        joint, limit = arm.joint(k), limits[k]
        motor, wanted = joint.motor, f"{mode}_limit"
        if motor is None or getattr(motor, wanted) is None:
            what = f'action_mode="{mode}" needs a motor with a {wanted} at each joint'
            raise check.MissingKey(f"arm.joints[{k}].motor" + ("" if motor is None else f".{wanted}"), what)
        constant, emf = joint.gear_ratio * motor.torque_constant, 0.0
        gain = constant * (motor.current_limit or 0.0)
        if mode == "voltage":
            assert motor.resistance is not None and motor.voltage_limit is not None  # Motor has seen to it
            own = motor.torque_constant if motor.back_emf is None else motor.back_emf
            gain, emf = constant * motor.voltage_limit / motor.resistance, constant * joint.gear_ratio * own
            emf /= motor.resistance
        if motor.current_limit is not None:
            limit = min(limit, constant * motor.current_limit)
        rows.append((gain, emf, limit))
        joints.append(replace(joint, friction_viscous=joint.friction_viscous + emf))
    gain_, emf_, limits_ = (np.array(column) for column in zip(*rows, strict=True))
    return replace(arm, joints=tuple(joints)), Amplifier(gain_, emf_ if mode == "voltage" else None, limits_)


# --- actuators ---------------------------------------------------------------------------------------
_ACTUATOR = ("lag", "delay", "jitter", "saturation", "viscous", "coulomb")


def with_friction(arm: Arm, value: Any) -> Arm:
    """Return the arm with the friction in the keyword `actuator` added to the friction of its joints."""
    table, joints = table_of("actuator", value, _ACTUATOR), [arm.joint(k) for k in range(arm.n_links)]
    for name, unit in (("viscous", "N m s/rad"), ("coulomb", "N m")):
        more = for_each(f"actuator.{name}", table.get(name, 0.0), arm.n_links, unit, minimum=0.0)
        if arm.base is not None and more[0]:
            what = "must be 0 at the hub on a base that floats, where that joint is ideal"
            raise check.InvalidValue(f"actuator.{name}", table[name], what)
        if more.any():
            field = f"friction_{name}"
            pairs = zip(joints, more, strict=True)
            joints = [replace(joint, **{field: getattr(joint, field) + own}) for joint, own in pairs]
            arm = replace(arm, joints=tuple(joints))
    return arm


def with_hub(arm: Arm, drawn: Any) -> tuple[Arm, float]:
    """Prepare an arm for random hub inertias; return the arm and the nominal inertia about the hub's axis, kg m^2.

    The random deviation from the nominal hub inertia is added to the rotor inertia of joint 0. If the base does not
    turn, the inertias of rotor and hub have the same effect. If joint 0 is ideal, the function adds a rotor with
    negligible inertia.
    """
    if drawn is None:
        return arm, 0.0
    if arm.base is not None:
        raise check.InvalidValue("randomization.hub_inertia", drawn, "must be left out on a base that floats")
    axis, joint = np.array(arm.hub_axis), arm.joint(0)
    hub = float(axis @ bodies.tensor(arm.hub_inertia) @ axis)
    if hub == 0.0:
        raise check.InvalidValue("randomization.hub_inertia", drawn, f"must not be given: {arm.name} has none")
    if joint.moves:
        return arm, hub
    joints = (replace(joint, motor_inertia=NOTHING * hub), *(arm.joint(k) for k in range(1, arm.n_links)))
    return replace(arm, joints=joints), hub


def actuator(frame: Frame, value: Any) -> Actuator | None:
    """Validate the keyword `actuator`; return the motor model, or None for ideal motors."""
    if value is None:
        return None
    table = table_of("actuator", value, _ACTUATOR)
    arm, dt = frame.arm, frame.settings.dt
    assert dt is not None and arm.torque_limits is not None
    short, lag = _lag(table.get("lag", 0.0))
    least, steps = _late("actuator.delay", table.get("delay", 0.0), dt, "dt")
    more = whole("actuator.jitter", table.get("jitter", 0.0), dt, "dt", minimum=0.0)
    per_period = round(frame.period / dt)
    share = check.number("actuator.saturation", table.get("saturation", 1.0), above=0.0, maximum=1.0)
    if lag == 0.0 and steps == 0 and more == 0 and share == 1.0:
        return None
    drawn, rows = least < steps, (steps + more) // per_period + 2
    oldest = rows - 1 if drawn else -(-(steps + more) // per_period)
    made = 1.0 if lag == 0.0 else -math.expm1(-dt / lag)
    within = lag > 0.0 or drawn or more > 0 or steps % per_period > 0
    return Actuator(
        share=made,
        mean=1.0 if lag == 0.0 else 1.0 - made * lag / dt,
        age=0 if drawn else steps // per_period,
        late=0 if drawn else steps % per_period,
        limits=share * np.array(arm.torque_limits),
        rows=rows,
        jitter=(float(more), float(per_period), oldest) if more or drawn else None,
        drawn=(float(least), float(steps)) if drawn else None,
        within=(0,) if within else None,
        lag=(short / dt, lag / dt) if short < lag else None,
    )


def _lag(value: Any) -> tuple[float, float]:
    """Return the smallest and largest time constant, s, that an episode may draw."""
    if check.several(value):
        return check.limits("actuator.lag", value, "s", minimum=0.0)
    return (check.number("actuator.lag", value, "s", minimum=0.0),) * 2


# --- sensors -----------------------------------------------------------------------------------------
_SENSORS = ("noise", "delay", *description.KEYS)


def sensors(
    frame: Frame, value: Any, gauges: Sequence[description.StrainGauge], names: Sequence[str], scales: Sequence[float]
) -> Sensors | None:
    """Convert the keyword for noise and delay, and the strain gauges, to sensors; None if all sensors are ideal.

    names, scales: names and scales of all entries of the observation; the gauges' entries are the last.
    """
    table = table_of("sensors", None if isinstance(value, description.Sensors) else value, _SENSORS)
    places = [gauge.spot for gauge in gauges]
    rows = gauge_table(frame.arm, frame.settings, frame.gravity, places, frame.contacts) if places else np.zeros((0, 0))
    noise = _noise(table.get("noise", 0.0), names, scales)
    least, age = _late("sensors.delay", table.get("delay", 0.0), frame.period, "control_dt")
    if not places and age == 0 and not noise.any():
        return None
    own = np.array(gauge_scales(frame, gauges))
    seen = reading_of(frame.arm).scale_rows(rows, own).ravel() if places else np.zeros(0)
    drawn = (float(least), float(age)) if least < age else None
    return Sensors(noise=noise, age=age, gauges=seen, drawn=drawn)


_STIFFNESS = {"xz": "EI_y", "torsion": "GJ"}


def gauge_scales(frame: Frame, gauges: Sequence[description.StrainGauge]) -> list[float]:
    """Return each gauge's scale, 1/m: the curvature or twist per length due to the full torque of the link's joint."""
    limits, links = frame.arm.torque_limits, frame.arm.links
    assert limits is not None
    sizes = []
    for gauge in gauges:
        link, s = links[gauge.link], np.array(gauge.place * links[gauge.link].length)
        stiff = link.along(s).EI if gauge.measures == "xy" else link.across(s)[_STIFFNESS[gauge.measures]]
        sizes.append(limits[gauge.link] / float(stiff))
    return sizes


def _noise(deviations: Any, names: Sequence[str], scales: Sequence[float]) -> Array:
    """Return standard deviations, divided by the entries' scales.

    deviations: one number for all entries, as a fraction of their scales, or a table of numbers by name, in the
    entries' units.
    """
    if not isinstance(deviations, Mapping):
        return np.full(len(names), check.number("sensors.noise", deviations, minimum=0.0))
    check.known_keys("sensors.noise", deviations, names, "entry of the observation")
    sizes = dict(zip(names, scales, strict=True))
    noise = {name: check.number(f"sensors.noise.{name}", value, minimum=0.0) for name, value in deviations.items()}
    return np.array([noise.get(name, 0.0) / sizes[name] for name in names])


# --- moving targets ----------------------------------------------------------------------------------
def reference(frame: Frame, value: Any, periods: int) -> Reference:
    """Validate the keyword `reference`: a path, which is sampled at control instants, or ranges of random paths."""
    target, arm = frame.kind.target, frame.arm
    drawn = value if isinstance(value, Mapping) and "t" not in value else {}
    value = None if drawn else value
    if value is None:
        shape, ranges = target.drawn(drawn, arm)
    else:  # a given path: nothing is drawn, the usual ranges need not suit the arm
        shape = next(iter(target.paths))
        ranges = target.ranges(arm, shape)
    ahead = np.array([max(1, round(time / frame.period)) for time in AHEAD], np.int64)
    table = np.zeros(0)
    if value is not None:
        t = np.arange(periods + int(ahead.max()) + 1, dtype=np.float64) * frame.period
        path = target.path(value, arm, t)
        table = np.column_stack([f(t) for f in path] + [f(t, 1) for f in path]).ravel()
    scales = np.array([scale for _, scale in target.entries(arm)])
    line = (0,) if shape == "line" else None
    return Reference(
        line=line, table=table, ranges=np.array(ranges).ravel(), ahead=ahead, scales=scales, axis=target.axis(arm)
    )


def gravity_of(kind: Kind, given: Any) -> tuple[float, ...] | None:
    """Return gravity (2,), in space (3,), m/s^2: `given`, or the task's default if `given` is None."""
    if given is None:
        return kind.gravity
    count = len(kind.axes)
    what = f"{('two', 'three')[count - 2]} numbers (m/s^2), ({', '.join(kind.axes)})"
    values = check.sequence("gravity", given, what, count)
    return tuple(check.number(f"gravity[{k}]", value, "m/s^2") for k, value in enumerate(values))
