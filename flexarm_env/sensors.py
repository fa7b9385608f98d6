"""Sensors of an arm: encoders, strain gauges, accelerometer, gyroscope, camera, force sensor, contact switch.

The classes are frozen, validated dataclasses. Every sensor measures one or more quantities u(t) by the same equation:

    reading = round_to_quantum(gain F u(t - delay) + bias + noise)

F is a low-pass filter of order 1 or 2 with static gain 1. Gain and bias are constant, or drawn at random for each
episode. The noise of each reading is an independent, normally distributed number. Sensors are read at control instants,
or at the samples of a trajectory. Between two readings the measured quantity u is interpolated linearly; filter and
delay are exact for the interpolated u. Before the start of an episode, u is constant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from flexarm_env import validation as check
from flexarm_env.bodies import PLANE, SPACE, Axes
from flexarm_env.records import choice, described, integer, number, validate, value

Range = tuple[float, float]
UNITS, SIDES = ("curvature", "strain"), ("link", "motor")
MEASURES = ("xy", "xz", "torsion")
RATE_FREQUENCY = 20.0
"""Default frequency (Hz) of the first-order low-pass filter with which an encoder computes the rate from readings."""
LARGEST, FINEST = 1e15, 1e-12
"""LARGEST: largest gain, bias, noise, quantum or filter damping. FINEST: smallest quantum. Values beyond these limits
would make the rounding of readings inexact.
"""


def _constant_or_range(path: str, value: Any) -> float | Range:
    """Validate a number, or a range (low, high)."""
    if not isinstance(value, list | tuple):
        return check.number(path, value, minimum=-LARGEST, maximum=LARGEST)
    both = check.sequence(path, value, "a number, or two: (low, high)", 2)
    return check.limits(path, both, minimum=-LARGEST, maximum=LARGEST)


@described
@dataclass(frozen=True)
class LowPass:
    """Low-pass filter w / (s + w) of order 1, or w^2 / (s^2 + 2 damping w s + w^2) of order 2; w = 2 pi frequency."""

    frequency: float = number("corner frequency", "Hz", above=0.0)
    order: int = integer("order of the filter", 1, minimum=1, maximum=2)
    damping: float = number("damping ratio, for order 2 only", "", math.sqrt(0.5), above=0.0, maximum=LARGEST)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self, "low_pass")


_RANGE = {"if": {"type": "array"}, "then": {"items": {"type": "number"}, "minItems": 2, "maxItems": 2},
          "else": {"type": "number"}}  # fmt: skip


@described
@dataclass(frozen=True, kw_only=True)
class Law:
    """Parameters that all sensors have: gain, bias, noise, quantum, delay and filter.

    Args:
        low_pass: filter of the measured quantity, or None.
    """

    gain: float | Range = value(
        _constant_or_range, _RANGE,
        "gain, or a range (low, high) from which the gain is drawn uniformly for each episode", "", 1.0,
    )  # fmt: skip
    bias: float | Range = value(
        _constant_or_range, _RANGE, "range (low, high) from which the bias is drawn uniformly for each episode; a "
        "number b means (-b, b)", "", 0.0,
    )  # fmt: skip
    noise: float = number("standard deviation of each reading", "", 0.0, minimum=0.0, maximum=LARGEST)
    low_pass: LowPass | None = None
    quantum: float = number(
        "resolution: readings are rounded to its whole multiples; 0: no rounding", "", 0.0, minimum=0.0, maximum=LARGEST
    )
    delay: float = number("delay, which need not be a whole number of periods", "s", 0.0, minimum=0.0)

    def __post_init__(self) -> None:
        """Validate the fields and convert them to plain numbers; an `InvalidValue` names the field."""
        validate(self)
        # a finer quantum is lost to rounding
        if 0.0 < self.quantum < FINEST:
            raise check.InvalidValue("quantum", self.quantum, f"must be 0, or at least {FINEST:g}")
        if self.low_pass is not None:
            check.instance("low_pass", self.low_pass, LowPass)

    @property
    def gains(self) -> Range:
        """Range (low, high) from which the sensor's gain is drawn."""
        return self.gain if isinstance(self.gain, tuple) else (self.gain, self.gain)

    @property
    def biases(self) -> Range:
        """Range (low, high) from which the sensor's bias is drawn."""
        return self.bias if isinstance(self.bias, tuple) else (-abs(self.bias), abs(self.bias))

    @property
    def is_ideal(self) -> bool:
        """True if every reading equals the measured quantity."""
        return all(getattr(self, f.name) == f.default for f in fields(Law))

    @property
    def step(self) -> float:
        """Quantum to which readings are rounded, in the unit of the reading; 0 for no rounding."""
        return self.quantum

    @property
    def interval(self) -> float:
        """Time from one reading to the next, s; 0 if the sensor is read at every control instant."""
        return 0.0


@described
@dataclass(frozen=True, kw_only=True)
class Encoder(Law):
    """Encoder of a joint, which measures the joint's angle, rad, and rate, rad/s.

    An encoder on the side "link" measures the angle of the link's root relative to the previous link's tip. An encoder
    on the side "motor" measures the motor's angle divided by the gear ratio; with a rigid gear this quotient equals the
    angle on the side "link". The resolution is 2 pi / counts on the side "link", and 2 pi / counts divided by the gear
    ratio on the side "motor".

    The rate is the difference of two successive angles divided by the time T between the two readings, filtered by a
    low-pass of order 1: rate_k = a rate_(k-1) + (1 - a) (angle_k - angle_(k-1)) / T with a = exp(-2 pi rate_frequency
    T).
    """

    counts: int | None = integer(
        "counts per turn of the encoder's shaft; None: no rounding, or that of `quantum`", None, minimum=1,
        maximum=10**9, optional=True,
    )  # fmt: skip
    side: str = choice(SIDES, "side of the gear whose angle is measured", "link")
    rate_frequency: float = number("corner frequency of the rate's low-pass filter", "Hz", RATE_FREQUENCY, above=0.0)

    def __post_init__(self) -> None:
        """Validate the fields; counts and quantum exclude each other."""
        super().__post_init__()
        # counts and quantum both set the resolution: only one is permitted
        if self.counts is not None and self.quantum > 0.0:
            raise check.InvalidValue("quantum", self.quantum, "must not be given together with counts")

    def behind(self, ratio: float) -> Encoder:
        """Return the encoder with its resolution converted to the output side of a gear with the ratio `ratio`."""
        # on the motor's side an angle of the joint is ratio times finer
        if self.side == "link" or self.counts is None:
            return self
        return replace(self, counts=None, quantum=self.step / ratio)

    @property
    def step(self) -> float:
        """Resolution of the angle, rad; 0 if the angle is not rounded."""
        return self.quantum if self.counts is None else 2.0 * math.pi / self.counts


@described
@dataclass(frozen=True, kw_only=True)
class StrainGauge(Law):
    """Strain gauge that measures the bending of a link at one place; in space also torsion and out-of-plane bending.

    The reading is the curvature (1/m), or the strain, which is the curvature times `distance`. With measures="xy" the
    gauge measures the curvature in the x-y plane, positive if the link bends towards y. With "xz" the gauge measures
    the curvature in the x-z plane, positive if the link bends towards z. With "torsion" the gauge measures the twist
    per length, positive about x. A gauge of an arm in the plane requires "xy". The default `distance` is sqrt(3 J / m),
    half the thickness of a rectangular section with mass per length m and rotary inertia per length J; for "xz" it is
    sqrt(3 J_y / m).
    """

    link: int = integer("number of the link, from 0", 0, minimum=0)
    place: float = number("position along the link, from 0 (root) to 1 (tip)", "", 0.0, minimum=0.0, maximum=1.0)
    unit: str = choice(UNITS, "measured quantity", "curvature")
    distance: float | None = number(
        "distance of the gauge from the neutral axis; required for the shear strain of torsion", "m", None, above=0.0,
        optional=True,
    )  # fmt: skip
    measures: str = choice(MEASURES, "measured component", "xy")

    def __post_init__(self) -> None:
        """Validate the fields; a gauge of the shear strain in torsion requires its distance from the axis."""
        super().__post_init__()
        # bending strains have a default distance, shear strains of torsion have none
        if self.distance is None and self.unit == "strain" and self.measures == "torsion":
            raise check.InvalidValue("distance", None, "must be given (m) for the shear strain of torsion")

    @property
    def spot(self) -> tuple[int, float, str]:
        """Tuple of link index, position on the link from 0 to 1, and measured component (`measures`)."""
        return self.link, self.place, self.measures

    def per_curvature(self, m: float, J: float) -> float:
        """Return the ratio reading / curvature for a section with mass m (kg/m) and rotary inertia J (kg m) per length.

        If the gauge measures curvature, the ratio is 1. If the gauge measures strain, the ratio is `distance`, m.
        """
        if self.unit == "curvature":
            return 1.0
        return surface(m, J) if self.distance is None else self.distance

    def per_curvature_of(self, link: Any) -> float:
        """Return the reading divided by the curvature (1, or a distance in m) at the gauge's position on a `Link`."""
        s = self.place * link.length
        there, across = link.along(s), self.measures == "xz"
        return self.per_curvature(float(there.m), float(link.across(np.array(s))["J_y"] if across else there.J))


def surface(m: float, J: float) -> float:
    """Return half the thickness, m, of a rectangle with mass m (kg/m) and rotary inertia J (kg m) per length."""
    if J <= 0.0:
        raise check.InvalidValue("distance", None, "must be given (m): the section's J = 0 defines no thickness")
    # J = m h^2 / 12, hence h / 2 = sqrt(3 J / m)
    return math.sqrt(3.0 * J / m)


@dataclass(frozen=True, kw_only=True)
class Accelerometer(Law):
    """Accelerometer at the arm's tip: specific force, m/s^2, along the tip's tangent (x) and normal to it (y).

    The specific force is the acceleration minus gravity. In space the specific force has three components along the
    tip's axes. The measured quantity is the specific force in the tip's axes, averaged over the time since the previous
    reading. In free fall the specific force is 0. In a steady rotation at rate w, with a tip at radius r that points
    radially outwards, the specific force is -w^2 r along x and 0 along y. The first reading assumes a constant velocity
    in the tip's axes, so for an arm at rest the first reading is minus gravity.
    """


@dataclass(frozen=True, kw_only=True)
class Gyroscope(Law):
    """Gyroscope at the tip of an arm in space: angular velocity, rad/s, about the tip's axes x, y, z."""


@described
@dataclass(frozen=True, kw_only=True)
class Camera(Law):
    """Camera: tip position, m, along inertial axes; in space also two angles, rad, of the tip's x axis.

    The first angle is the elevation of the tip's x axis from the inertial x-z plane towards y; the second angle is the
    axis's elevation from the x-y plane towards z. The two angles are between -pi/2 and pi/2. The first picture arrives
    at t = 0. A picture that arrives at the time t shows the tip at t - delay.
    """

    period: float | None = number(
        "time from one picture to the next, a whole number of control periods (or samples); None: one in each period",
        "s", None, above=0.0, optional=True,
    )  # fmt: skip

    @property
    def interval(self) -> float:
        """Time between pictures, s; 0 for a picture at every control instant."""
        return self.period or 0.0


@dataclass(frozen=True, kw_only=True)
class ForceSensor(Law):
    """Force sensor at the arm's tip: normal force and magnitude of the friction force of contacts at the tip, N."""


@described
@dataclass(frozen=True, kw_only=True)
class ContactSwitch(Law):
    """Contact switch at the arm's tip: 1 if the normal force exceeds the threshold (N), otherwise 0."""

    threshold: float = number("normal force above which the reading is 1", "N", 0.0, minimum=0.0)


SINGLES: dict[str, type[Law]] = {
    "accelerometer": Accelerometer, "camera": Camera, "gyroscope": Gyroscope,
    "force": ForceSensor, "switch": ContactSwitch,
}  # fmt: skip
"""Classes of sensors of which an arm has at most one, by key in a table of sensors."""

_OF_CONTACT = {"force": ("tip_force_normal", "tip_force_tangential"), "switch": ("contact_switch",)}


def of_the_tip(axes: Axes) -> dict[str, tuple[str, ...]]:
    """Return the names of the readings of each sensor at the tip, in the order of an observation."""
    rises = (f"camera_rise_{axis}" for axis in axes.rises)
    return {
        "accelerometer": tuple(f"tip_acceleration_{axis}" for axis in axes),
        "gyroscope": tuple(f"gyroscope_{axis}" for axis in axes.turns),
        "camera": (*(f"camera_{axis}" for axis in axes), *rises),
        **_OF_CONTACT,
    }


@dataclass(frozen=True)
class Sensors:
    """All sensors of an arm.

    Args:
        encoders: a tuple with one encoder per joint, a single encoder that all joints have, or () for no encoders.
        strain_gauges: the strain gauges, whose readings are named strain_gauge_1, strain_gauge_2, ... in this order.
        accelerometer, camera, gyroscope, force, switch: a sensor or None. The sensors force and switch require
            contacts.
    """

    encoders: tuple[Encoder, ...] = ()
    strain_gauges: tuple[StrainGauge, ...] = ()
    accelerometer: Accelerometer | None = None
    camera: Camera | None = None
    gyroscope: Gyroscope | None = None
    force: ForceSensor | None = None
    switch: ContactSwitch | None = None

    def __post_init__(self) -> None:
        """Validate the types of the sensors."""
        for name, kind in (("encoders", Encoder), ("strain_gauges", StrainGauge)):
            check.store(self, **{name: check.instances(name, getattr(self, name), kind)})
        for name, single in SINGLES.items():
            if getattr(self, name) is not None:
                check.instance(name, getattr(self, name), single)

    def encoder(self, joint: int) -> Encoder:
        """Return the encoder of a joint, or None if there are no encoders."""
        return self.encoders[joint if len(self.encoders) > 1 else 0]

    def readings(self, arm: Any, axes: Axes = PLANE) -> dict[str, tuple[str, Law]]:
        """Return a dict from the names of an arm's readings, in order, to pairs (key path, sensor).

        `Trajectory.measured` uses the same names. Key paths begin after the key "sensors". The encoders' resolution is
        converted to the output side of the gear.
        """
        found: dict[str, tuple[str, Law]] = {}
        # encoders, then sensors of the tip, then gauges
        for k, joint in enumerate(arm.joint_names if self.encoders else ()):
            # an encoder gives two readings, angle and rate
            own = self.encoder(k).behind(arm.joint(k).gear_ratio)
            found |= {f"{joint}_{of}": (f"encoders[{k}]", own) for of in ("angle", "rate")}
        for place, names in of_the_tip(axes).items():
            if (law := getattr(self, place)) is not None:
                found |= dict.fromkeys(names, (place, law))
        gauges = enumerate(self.strain_gauges)
        return found | {f"strain_gauge_{i + 1}": (f"strain_gauges[{i}]", gauge) for i, gauge in gauges}

    def check_for(self, links: Sequence[Any], axes: Axes = SPACE, touches: bool = True) -> None:
        """Raise ValueError if the arm cannot have the sensors.

        links: the arm's links. axes: "xy" for an arm in the plane, "xyz" in space. touches: True if the arm has
        contacts.
        """
        for name in () if touches else ("force", "switch"):
            if getattr(self, name) is not None:
                raise check.InvalidValue(name, getattr(self, name), "must be left out: no contact forces are recorded")
        if (own := self.gyroscope) is not None and not axes.turns:
            raise check.InvalidValue("gyroscope", own, "must be left out: only arms in space have a gyroscope")
        if len(self.encoders) not in (0, 1, len(links)):
            raise check.InvalidValue("encoders", f"{len(self.encoders)} encoders", f"must be one, or {len(links)}")
        for i, gauge in enumerate(self.strain_gauges):
            check.integer(f"strain_gauges[{i}].link", gauge.link, minimum=0, maximum=len(links) - 1)
            if links[gauge.link].rigid:
                what = "must be a flexible link: this one is rigid"
                raise check.InvalidValue(f"strain_gauges[{i}].link", gauge.link, what)
            if gauge.measures not in axes.measures:
                raise check.InvalidValue(f"strain_gauges[{i}].measures", gauge.measures, 'must be "xy" in the plane')

    @classmethod
    def ideal(cls, links: Sequence[Any]) -> Sensors:
        """Return ideal encoders, and an ideal strain gauge at the root of each flexible link."""
        return cls((Encoder(),), tuple(StrainGauge(link=k) for k, link in enumerate(links) if not link.rigid))


def from_table(table: Mapping[str, Any]) -> Sensors:
    """Create sensors from a table: in a TOML file, or a dict that is an environment's argument.

    Keys of the table are: encoders, a table for all joints or a list with one table per joint ({} is an ideal encoder);
    strain_gauges, a list of positions on link 0 (0 to 1), pairs (link, position) or tables; and accelerometer, camera,
    gyroscope, force and switch, a table each. The keys of an inner table are the arguments of the sensor's class. A
    ValueError names the key path of an invalid value.
    """
    check.known_keys("sensors", table, KEYS)
    values: dict[str, Any] = {}
    # one table stands for all joints
    encoders = table.get("encoders", ())
    if not isinstance(encoders, Mapping):
        encoders = check.sequence("sensors.encoders", encoders, "a table for each joint, or one table for all")
        values["encoders"] = tuple(_read(f"sensors.encoders[{i}]", Encoder, one) for i, one in enumerate(encoders))
    else:
        values["encoders"] = (_read("sensors.encoders", Encoder, encoders),)
    places = check.sequence("sensors.strain_gauges", table.get("strain_gauges", ()), "places")
    values["strain_gauges"] = tuple(_gauge(f"sensors.strain_gauges[{i}]", entry) for i, entry in enumerate(places))
    for name, kind in SINGLES.items():
        if table.get(name) is not None:
            values[name] = _read(f"sensors.{name}", kind, table[name])
    with check.under("sensors"):
        return Sensors(**values)


def to_table(sensors: Sensors) -> dict[str, Any]:
    """Return a table from which `from_table` creates equal sensors; entries with default values are omitted."""
    table: dict[str, Any] = {}
    for name, own in vars(sensors).items():
        if isinstance(own, tuple) and own:
            table[name] = [_changed(part) for part in own]
        elif isinstance(own, Law):
            table[name] = _changed(own)
    return table


KEYS = check.names_of(Sensors)
"""Permitted keys in a table of sensors."""

S = TypeVar("S", bound=Law)


def _gauge(path: str, entry: Any) -> StrainGauge:
    """Create a strain gauge from a place, a pair (link, place) or a table."""
    if isinstance(entry, Mapping | StrainGauge):
        return _read(path, StrainGauge, entry)
    # a single number is a place on link 0
    link, place = check.sequence(path, entry, "a link and a place", 2) if check.several(entry) else (0, entry)
    link = check.integer(f"{path}[0]", link, minimum=0)
    return StrainGauge(link=link, place=check.number(path, place, minimum=0.0, maximum=1.0))


def _read(path: str, kind: type[S], entry: Any) -> S:
    """Create a sensor of class `kind` from a table; `low_pass` may be a nested table."""
    if isinstance(entry, kind):
        return entry
    table = check.table_of(path, entry)
    if isinstance(table.get("low_pass"), Mapping):
        with check.under(path):
            check.known_keys("", table, check.names_of(kind))
            frequency = "must be a positive number (Hz)"
            table["low_pass"] = check.made("low_pass", LowPass, table["low_pass"], prefix="", frequency=frequency)
    return check.made(path, kind, table)


def _changed(part: Law) -> dict[str, Any]:
    """Return the fields of a sensor that differ from their defaults, in the form in which a file stores them."""
    return {name: asdict(value) if name == "low_pass" else value for name, value in check.changed(part).items()}
