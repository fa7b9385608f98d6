"""Sensors of an arm as they are described: encoders, strain gauges, an accelerometer and a camera; frozen, validated.

Every sensor reads one or two quantities u(t) by the same law (`runtime.laws.read` is its one definition):

    reading = round_to_quantum(gain F u(t - delay) + bias + noise)

F is a low-pass of order 1 or 2 with gain 1 at rest; gain and bias are constant or drawn anew for each episode; noise is
a normal number of its own for each reading. Between the instants at which a sensor is read (control instants, or the
samples of a trajectory) u is taken to run straight, for which filter and delay are exact. At the start of an episode
the quantity is taken to have been what it is for ever.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from flexarm_env import validation as check

Range = tuple[float, float]
UNITS = ("curvature", "strain")
MEASURES = ("xy", "xz", "torsion")
SIDES = ("link", "motor")
RATE_FREQUENCY = 20.0
"""Hz, of the first-order low-pass on an encoder's differences, where nothing is said."""
LARGEST, FINEST = 1e15, 1e-12
"""Of gains, biases, noise, quanta and a filter's damping: angles and multiples beyond are lost to rounding."""


@dataclass(frozen=True)
class LowPass:
    """A filter w^2 / (s^2 + 2 damping w s + w^2), or of order 1 w / (s + w), with w = 2 pi frequency.

    Args:
        frequency: Hz, positive. order: 1 or 2. damping: ratio, positive; of order 2 alone.
    """

    frequency: float
    order: int = 1
    damping: float = math.sqrt(0.5)

    def __post_init__(self) -> None:
        check.store(
            self,
            frequency=check.number("low_pass.frequency", self.frequency, "Hz", above=0.0),
            order=check.integer("low_pass.order", self.order, minimum=1, maximum=2),
            damping=check.number("low_pass.damping", self.damping, above=0.0, maximum=LARGEST),
        )


@dataclass(frozen=True, kw_only=True)
class Law:
    """What every sensor may have, in the unit of its reading.

    Args:
        gain: a number, or (low, high): drawn uniformly for each episode.
        bias: a number b: drawn uniformly from -b to b for each episode; or drawn from (low, high), which may be equal.
        noise: standard deviation of each reading.
        low_pass: a filter before the sensor is read, or None.
        quantum: readings are whole multiples of it; 0: none.
        delay: s; any number, not only of whole periods.
    """

    gain: float | Range = 1.0
    bias: float | Range = 0.0
    noise: float = 0.0
    low_pass: LowPass | None = None
    quantum: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        check.store(
            self,
            **{name: _constant_or_range(name, getattr(self, name)) for name in ("gain", "bias")},
            noise=check.number("noise", self.noise, minimum=0.0, maximum=LARGEST),
            quantum=check.number("quantum", self.quantum, minimum=0.0, maximum=LARGEST),
            delay=check.number("delay", self.delay, "s", minimum=0.0),
        )
        if 0.0 < self.quantum < FINEST:
            raise check.InvalidValue("quantum", self.quantum, f"must be 0, or at least {FINEST:g}")
        if self.low_pass is not None:
            check.instance("low_pass", self.low_pass, LowPass)

    @property
    def gains(self) -> Range:
        """What the gain is drawn from."""
        return self.gain if isinstance(self.gain, tuple) else (self.gain, self.gain)

    @property
    def biases(self) -> Range:
        """What the bias is drawn from."""
        return self.bias if isinstance(self.bias, tuple) else (-abs(self.bias), abs(self.bias))

    @property
    def is_ideal(self) -> bool:
        """Whether the reading is the quantity itself."""
        return all(getattr(self, f.name) == f.default for f in fields(Law))

    @property
    def step(self) -> float:
        """What readings are whole multiples of; 0: anything."""
        return self.quantum

    @property
    def interval(self) -> float:
        """Time from one reading to the next, s; 0: at every instant."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class Encoder(Law):
    """The angle of a joint, rad, and its rate.

    The rate is the difference of two readings over the time between them, through a low-pass of order 1:
    rate_k = a rate_(k-1) + (1 - a) (reading_k - reading_(k-1)) / T with a = exp(-2 pi rate_frequency T).

    Args:
        counts: of a turn of what it sits on; readings are multiples of 2 pi / counts, on the motor of that over the
            gear's ratio. None: as fine as you like, or as `quantum` says.
        side: "link": the angle of the link's root from the tip before it. "motor": the motor's angle over the ratio,
            which is the same where the gear does not give (`Joint`).
        rate_frequency: Hz.
    """

    counts: int | None = None
    side: str = "link"
    rate_frequency: float = RATE_FREQUENCY

    def __post_init__(self) -> None:
        super().__post_init__()
        check.choice("side", self.side, SIDES)
        check.store(self, rate_frequency=check.number("rate_frequency", self.rate_frequency, "Hz", above=0.0))
        if self.counts is not None:
            check.store(self, counts=check.integer("counts", self.counts, minimum=1, maximum=10**9))
            if self.quantum > 0.0:
                raise check.InvalidValue("quantum", self.quantum, "must not be given together with counts")

    def behind(self, ratio: float) -> Encoder:
        """As it reads after a gear of this ratio."""
        if self.side == "link" or self.counts is None:
            return self
        return replace(self, counts=None, quantum=self.step / ratio)

    @property
    def step(self) -> float:
        """rad"""
        return self.quantum if self.counts is None else 2.0 * math.pi / self.counts


@dataclass(frozen=True, kw_only=True)
class StrainGauge(Law):
    """Bending of a link at a place; in space also that out of the x-y plane, and torsion.

    Args:
        link: 0 is the first. place: along it, from 0 (root) to 1 (tip).
        unit: "curvature", 1/m, or "strain": curvature times the distance.
        distance: m, of the gauge from the neutral axis. None: half the thickness of the rectangle that has the
            section's m and J, sqrt(3 J / m), or J_y for bending in x-z; of torsion it must be given for a strain.
        measures: "xy": curvature in the x-y plane, positive where the link bends towards y; "xz": in the x-z plane,
            towards z; "torsion": twist over length, positive about x. In the plane there is "xy" alone.
    """

    link: int = 0
    place: float = 0.0
    unit: str = "curvature"
    distance: float | None = None
    measures: str = "xy"

    def __post_init__(self) -> None:
        super().__post_init__()
        check.store(
            self,
            link=check.integer("link", self.link, minimum=0),
            place=check.number("place", self.place, minimum=0.0, maximum=1.0),
        )
        check.choice("unit", self.unit, UNITS)
        check.choice("measures", self.measures, MEASURES)
        if self.distance is not None:
            check.store(self, distance=check.number("distance", self.distance, "m", above=0.0))
        elif self.unit == "strain" and self.measures == "torsion":
            raise check.InvalidValue("distance", None, "must be given (m) for the shear strain that torsion makes")

    @property
    def spot(self) -> tuple[int, float, str]:
        """Where it is and what it measures."""
        return self.link, self.place, self.measures

    def per_curvature(self, m: float, J: float) -> float:
        """The quantity over the curvature, for a link of mass m (kg/m) and rotary inertia J (kg m) per length there."""
        if self.unit == "curvature":
            return 1.0
        return surface(m, J) if self.distance is None else self.distance

    def per_curvature_of(self, link: Any) -> float:
        """The same for a `Link`."""
        s = self.place * link.length
        there, across = link.along(s), self.measures == "xz"
        return self.per_curvature(float(there.m), float(link.across(np.array(s))["J_y"] if across else there.J))


def surface(m: float, J: float) -> float:
    """Distance of the surface from the neutral axis, m, of a rectangle with these m (kg/m) and J (kg m)."""
    if J <= 0.0:
        raise check.InvalidValue("distance", None, "must be given (m) where the section's J = 0 tells no thickness")
    return math.sqrt(3.0 * J / m)


@dataclass(frozen=True, kw_only=True)
class Accelerometer(Law):
    """Specific force of the arm's tip, m/s^2: its acceleration less gravity along its tangent (x) and across it (y); in
    space along the three axes of the tip.

    u is the mean over the time since the last instant of what it is in the tip's own axes at each of these times. In a
    steady spin it is -w^2 r along the tangent and 0 across, in free fall 0, however long that time. The first has no
    time before it: it is that of a tip whose velocity in its own axes stays as it is, at rest -g.
    """


@dataclass(frozen=True, kw_only=True)
class Gyroscope(Law):
    """Angular velocity of the arm's tip about its own axes x, y, z, rad/s; of arms in space."""


@dataclass(frozen=True, kw_only=True)
class Camera(Law):
    """Position of the tip, m, along fixed axes; in space also two angles of the tip's x axis, rad: by which it rises
    out of the x-z plane, towards y, and out of the x-y plane, towards z, -pi/2 to pi/2 each.

    Args:
        period: s from one picture to the next, a whole number of control periods (or samples); None: at each. The
            picture that arrives at t, the first at 0, shows the tip at t - delay, and stands until the next.
    """

    period: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.period is not None:
            check.store(self, period=check.number("period", self.period, "s", above=0.0))

    @property
    def interval(self) -> float:
        """s"""
        return self.period or 0.0


SINGLES: dict[str, type[Law]] = {"accelerometer": Accelerometer, "camera": Camera, "gyroscope": Gyroscope}
"""Those that an arm has one of, by their keys."""

OF_THE_TIP: dict[bool, dict[str, tuple[str, ...]]] = {
    False: {
        "accelerometer": ("tip_acceleration_x", "tip_acceleration_y"),
        "camera": ("camera_x", "camera_y"),
    },
    True: {
        "accelerometer": ("tip_acceleration_x", "tip_acceleration_y", "tip_acceleration_z"),
        "gyroscope": ("gyroscope_x", "gyroscope_y", "gyroscope_z"),
        "camera": ("camera_x", "camera_y", "camera_z", "camera_rise_y", "camera_rise_z"),
    },
}
"""What they read, in the plane and in space, in the order in which it stands."""


@dataclass(frozen=True)
class Sensors:
    """The sensors of an arm.

    Args:
        encoders: one for each joint; one: for all alike; (): none.
        strain_gauges: named strain_gauge_1, strain_gauge_2, ... in this order.
        accelerometer, camera, gyroscope: or None.
    """

    encoders: tuple[Encoder, ...] = ()
    strain_gauges: tuple[StrainGauge, ...] = ()
    accelerometer: Accelerometer | None = None
    camera: Camera | None = None
    gyroscope: Gyroscope | None = None

    def __post_init__(self) -> None:
        for name, kind in (("encoders", Encoder), ("strain_gauges", StrainGauge)):
            check.store(self, **{name: check.instances(name, getattr(self, name), kind)})
        for name, single in SINGLES.items():
            if getattr(self, name) is not None:
                check.instance(name, getattr(self, name), single)

    def encoder(self, joint: int) -> Encoder:
        """The encoder of a joint."""
        return self.encoders[joint if len(self.encoders) > 1 else 0]

    def readings(self, arm: Any, space: bool = False) -> dict[str, tuple[str, Law]]:
        """What they read on an arm, in order, as `Trajectory.measured` names it: of each reading the key path of its
        sensor below "sensors", and the sensor, an encoder as it reads behind the joint's gear. space: in space."""
        found: dict[str, tuple[str, Law]] = {}
        for k, joint in enumerate(arm.joint_names if self.encoders else ()):
            own = self.encoder(k).behind(arm.joint(k).gear_ratio)
            found |= {f"{joint}_{of}": (f"encoders[{k}]", own) for of in ("angle", "rate")}
        for place, names in OF_THE_TIP[space].items():
            if (law := getattr(self, place)) is not None:
                found |= dict.fromkeys(names, (place, law))
        gauges = enumerate(self.strain_gauges)
        return found | {f"strain_gauge_{i + 1}": (f"strain_gauges[{i}]", gauge) for i, gauge in gauges}

    def check_for(self, links: Sequence[Any], space: bool = True) -> None:
        """ValueError unless an arm of these links can carry them; space: whether it is one in space."""
        if not space and self.gyroscope is not None:
            what = "must be left out: there are gyroscopes in space alone"
            raise check.InvalidValue("gyroscope", self.gyroscope, what)
        if len(self.encoders) not in (0, 1, len(links)):
            raise check.InvalidValue("encoders", f"{len(self.encoders)} encoders", f"must be one, or {len(links)}")
        for i, gauge in enumerate(self.strain_gauges):
            check.integer(f"strain_gauges[{i}].link", gauge.link, minimum=0, maximum=len(links) - 1)
            if links[gauge.link].rigid:
                what = "must be a link that bends: this one is rigid"
                raise check.InvalidValue(f"strain_gauges[{i}].link", gauge.link, what)
            if not space and gauge.measures != "xy":
                raise check.InvalidValue(f"strain_gauges[{i}].measures", gauge.measures, 'must be "xy" in the plane')

    @classmethod
    def ideal(cls, links: Sequence[Any]) -> Sensors:
        """Those of an arm that names none: encoders without counts and a gauge at the root of each link that bends."""
        return cls((Encoder(),), tuple(StrainGauge(link=k) for k, link in enumerate(links) if not link.rigid))


def from_table(table: Mapping[str, Any]) -> Sensors:
    """Sensors from a table: a TOML file's, or what an environment is given. ValueError names the key path.

    encoders: a table for all joints, or a list of one each; {} are ideal ones. strain_gauges: a list of places (of link
    0), of pairs link and place, and of tables. accelerometer, camera, gyroscope: a table each. Keys are the classes'
    arguments.
    """
    check.known_keys("sensors", table, KEYS)
    values: dict[str, Any] = {}
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
    """The table that `from_table` reads back; what is at its default is left out."""
    table: dict[str, Any] = {}
    for name, own in vars(sensors).items():
        if isinstance(own, tuple) and own:
            table[name] = [_changed(part) for part in own]
        elif isinstance(own, Law):
            table[name] = _changed(own)
    return table


KEYS = check.names_of(Sensors)
"""Keys of a table of sensors."""

S = TypeVar("S", bound=Law)


def _constant_or_range(path: str, value: Any) -> float | Range:
    if not isinstance(value, list | tuple):
        return check.number(path, value, minimum=-LARGEST, maximum=LARGEST)
    both = check.sequence(path, value, "a number, or two: (low, high)", 2)
    return check.limits(path, both, minimum=-LARGEST, maximum=LARGEST)


def _gauge(path: str, entry: Any) -> StrainGauge:
    if isinstance(entry, Mapping | StrainGauge):
        return _read(path, StrainGauge, entry)
    link, place = check.sequence(path, entry, "a link and a place", 2) if check.several(entry) else (0, entry)
    link = check.integer(f"{path}[0]", link, minimum=0)
    return StrainGauge(link=link, place=check.number(path, place, minimum=0.0, maximum=1.0))


def _read(path: str, kind: type[S], entry: Any) -> S:
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
    """A sensor's fields that are not at their defaults, as a file has them."""
    return {name: asdict(value) if name == "low_pass" else value for name, value in check.changed(part).items()}
