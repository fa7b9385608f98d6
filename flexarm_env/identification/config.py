"""Configuration of a fit: descriptions of the log's columns and of the parameters, read from a TOML file."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexarm_env import validation as check
from flexarm_env.bodies import PLANE, SPACE, Axes
from flexarm_env.files import read_toml
from flexarm_env.parameters import Arm
from flexarm_env.sensors import Sensors, from_table

INPUTS = ("joint", "motor", "torque", "current", "voltage")
UNITS = {
    "rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3, "s": 1.0, "ms": 1e-3, "us": 1e-6, "N m": 1.0, "mN m": 1e-3,
    "A": 1.0, "mA": 1e-3, "V": 1.0, "mV": 1e-3, "m": 1.0, "mm": 1e-3, "1/m": 1.0, "strain": 1.0, "microstrain": 1e-6,
    "rad/s": 1.0, "deg/s": math.pi / 180.0, "m/s^2": 1.0,
}  # fmt: skip
"""Factors from a column's unit to SI."""

_ANGLES = "rad", "deg", "mrad"
_UNITS_OF: dict[str, tuple[str, ...]] = {
    "t": ("s", "ms", "us"), "joint": _ANGLES, "motor": _ANGLES, "angle": _ANGLES, "torque": ("N m", "mN m"),
    "current": ("A", "mA"), "voltage": ("V", "mV"),
}  # fmt: skip
"""Accepted units for each kind of channel; other kinds accept any unit."""

_CHANNEL = ("column", "unit", "gain", "offset", "shift", "low_pass")


@dataclass(frozen=True)
class Channel:
    """Column of the log that is an input or an output of the model: SI value = factor * (column - offset).

    Args:
        name: name of the input ("joint0", "motor0", "torque0", "current0", "voltage0") or of the reading
            ("strain_gauge_1", "hub_angle", ...; see `Trajectory.measured`).
        column: name of the column in the log file. factor: SI value per unit of the column. offset: value of the column
            at which the SI value is 0. None (outputs only): the fit determines one offset for each run. shift: delay of
            the column, s, positive or negative; a row at time t contains the value measured at t - shift.
        low_pass: cut-off frequency, Hz, of a zero-phase second-order Butterworth filter; None for no filter.
    """

    name: str
    column: str
    factor: float = 1.0
    offset: float | None = 0.0
    shift: float = 0.0
    low_pass: float | None = None

    @property
    def kind(self) -> str:
        """Kind of the input, one of `INPUTS`: the name without the joint's index."""
        return self.name.rstrip("0123456789")

    @property
    def joint(self) -> int:
        """Index of the joint on which the input acts."""
        return int(self.name[len(self.kind) :])

    @property
    def moves(self) -> bool:
        """True if the input prescribes an angle, False if it is a torque, current or voltage."""
        return self.kind in ("joint", "motor")


@dataclass(frozen=True)
class Parameter:
    """Parameter that a fit determines.

    Args:
        path: key path in the arm ("links[0].section.EI"), in its sensors ("sensors.strain_gauge_1.gain"), or in
            the experiment ("loads[0].force_x", "gravity[0]", "inputs.joint0.gain", "outputs.hub_angle.shift").
        name: short name for reports. low, high: bounds of the value. start: initial value of the fit; None for the
            arm's value.
        prior: mean and standard deviation of the value from prior knowledge, or None. size: typical change of the
            value, by which the fit scales the parameter; None for the magnitude of the initial value. nuisance: True if
            the fitted value applies only to the fitted logs. In predictions of held-out logs a nuisance parameter has
            its initial value.
    """

    path: str
    name: str
    low: float
    high: float
    start: float | None = None
    prior: tuple[float, float] | None = None
    size: float | None = None
    nuisance: bool = False


@dataclass(frozen=True)
class Config:
    """Contents of the configuration file of a fit.

    time: name of the column with the time. start: initial state of a run, as in a `Scene`. skip: duration, s, of an
        initial part of each run; the fit ignores the readings in this part.
    """

    time: Channel
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    parameters: tuple[Parameter, ...]
    fit: tuple[str, ...]
    start: str = "unloaded"
    skip: float = 0.0
    sensors: Sensors | None = None
    experiment: Mapping[str, Any] = field(default_factory=dict)  # tables of gravity and loads
    axes: Axes = PLANE  # axes along which the arm is simulated
    solver: Mapping[str, Any] = field(default_factory=dict)
    starts: int = 4
    evaluations: int = 60
    good: float = 70.0
    seed: int = 0

    def chosen(self, names: tuple[str, ...] | None = None) -> tuple[Parameter, ...]:
        """Return the parameters to be fitted.

        names: names or key paths of the parameters; None for the parameters that the config selects.
        """
        wanted = self.fit if names is None else names
        known = {key: p for p in self.parameters for key in (p.name, p.path)}
        for name in wanted:
            if name not in known:
                raise check.UnknownKey(name, [p.name for p in self.parameters], "parameter to fit")
        if not wanted:
            raise check.InvalidValue("fit", wanted, "must name at least one parameter")
        return tuple(dict.fromkeys(known[name] for name in wanted))


_KEYS = (
    "time", "start", "skip", "inputs", "outputs", "sensors", "gravity", "loads", "solver", "parameters", "fit",
    "starts", "evaluations", "good", "seed",
)  # fmt: skip


def read_config(source: str | os.PathLike[str] | Config, arm: Arm) -> Config:
    """Read a `Config` from a TOML file or text and validate it for an arm.

    Raises ValueError for an invalid value; the message names file, key path and value.
    """
    if isinstance(source, Config):
        return source
    table, path = read_toml(source)
    with check.in_file(path):
        return _config(table, arm)


def _config(table: dict[str, Any], arm: Arm) -> Config:
    """Build the Config from the file's table; raise ValueError that names the key path and the value."""
    check.known_keys("", table, _KEYS)
    n = arm.n_links
    inputs = _channels("inputs", table, False)
    for channel in inputs:
        if channel.name not in {f"{kind}{k}" for kind in INPUTS for k in range(n)}:
            what = f"must be {', '.join(f'{kind}K' for kind in INPUTS)}, with joint K from 0 to {n - 1}"
            raise check.InvalidValue("inputs", channel.name, what)
    joints = [channel.joint for channel in inputs]
    if len(set(joints)) < len(joints):
        raise check.InvalidValue("inputs", [c.name for c in inputs], "must have one entry for each joint")
    sensors = table.get("sensors")
    own = arm.sensors or Sensors.ideal(arm.links)
    carried = own if sensors is None else from_table(check.table_of("sensors", sensors))
    experiment: dict[str, Any] = {key: table[key] for key in ("gravity", "loads") if key in table}
    # the experiment decides whether the arm is computed in space
    axes = SPACE if _leaves_the_plane(experiment) else arm.axes
    with check.under("sensors"):
        carried.check_for(arm.links, axes)
    parameters = tuple(_parameter(p, v) for p, v in check.table_of("parameters", table.get("parameters", {})).items())
    names = [p.name for p in parameters]
    for p in parameters:
        if names.count(p.name) > 1:
            raise check.InvalidValue(f'parameters."{p.path}".name', p.name, "must be the name of one parameter alone")
    solver = {"formulation": axes.quick_formulation, **check.table_of("solver", table.get("solver", {}))}
    good = check.number("good", table.get("good", 70.0), "%", maximum=100.0)
    fit = check.sequence("fit", table.get("fit", names), "names of parameters")
    config = Config(
        time=_channel("time", "t", table.get("time", "t"), False, _CHANNEL[:3]),
        inputs=inputs, outputs=_channels("outputs", table, True), parameters=parameters,
        fit=tuple(check.text(f"fit[{k}]", name) for k, name in enumerate(fit)),
        start=check.choice("start", table.get("start", "unloaded"), ("unloaded", "held")),
        skip=check.number("skip", table.get("skip", 0.0), "s", minimum=0.0),
        sensors=carried, experiment=experiment, axes=axes, solver=solver,
        starts=check.integer("starts", table.get("starts", 4), minimum=1, maximum=1000),
        evaluations=check.integer("evaluations", table.get("evaluations", 60), minimum=1), good=good,
        seed=check.integer("seed", table.get("seed", 0), minimum=0),
    )  # fmt: skip
    known = carried.readings(arm, axes)
    for channel in config.outputs:
        if channel.name not in known:
            raise check.UnknownKey(f"outputs.{channel.name}", known, "sensor")
    return config


def _leaves_the_plane(experiment: Mapping[str, Any]) -> bool:
    """Return whether the experiment needs an arm in space: gravity with three components, or a load with force_z."""
    loads = check.sequence("loads", experiment.get("loads", ()), "tables")
    return np.size(experiment.get("gravity", ())) == 3 or any(
        "force_z" in check.table_of(f"loads[{i}]", load) for i, load in enumerate(loads)
    )


def _channels(what: str, table: Mapping[str, Any], offsets: bool) -> tuple[Channel, ...]:
    """Read a table of channels, "inputs" or "outputs". offsets: True if offsets may be fitted."""
    entries = check.table_of(what, check.needed("", table, what, "must be a table of channels and their columns"))
    if not entries:
        raise check.InvalidValue(what, entries, "must name at least one channel")
    return tuple(_channel(f"{what}.{name}", name, entry, offsets) for name, entry in entries.items())


def _channel(path: str, name: str, entry: Any, offsets: bool, keys: tuple[str, ...] = _CHANNEL) -> Channel:
    """Read one channel, which is given as the name of a column or as a table.

    offsets: True if offset = "fit" is allowed, which is then the default. keys: names of the accepted keys.
    """
    table = {"column": entry} if isinstance(entry, str) else check.table_of(path, entry)
    check.known_keys(path, table, keys)
    column = check.text(f"{path}.column", check.needed(path, table, "column", "must be a column of the log"))
    kind = "angle" if name.endswith("_angle") else name.rstrip("0123456789")
    known = _UNITS_OF.get(kind, tuple(UNITS))
    unit = UNITS[check.choice(f"{path}.unit", table["unit"], known)] if "unit" in table else 1.0
    gain = check.number(f"{path}.gain", table.get("gain", 1.0), "SI over the unit")
    if gain == 0.0:
        raise check.InvalidValue(f"{path}.gain", gain, "must not be 0, or nothing is left of the column")
    # offset = "fit" (stored as None): a constant of each run
    offset, low_pass = table.get("offset", "fit" if offsets else 0.0), table.get("low_pass")
    fitted = offsets and offset == "fit"
    return Channel(
        name=name, column=column,
        factor=unit * gain,
        offset=None if fitted else check.number(f"{path}.offset", offset, "of the column"),
        shift=check.number(f"{path}.shift", table.get("shift", 0.0), "s"),
        low_pass=None if low_pass is None else check.number(f"{path}.low_pass", low_pass, "Hz", above=0.0),
    )  # fmt: skip


def _parameter(path: str, entry: Any) -> Parameter:
    """Read one entry of the table of parameters and validate its bounds, start and prior."""
    where = f'parameters."{path}"'
    table = check.table_of(where, entry)
    check.known_keys(where, table, ("name", "low", "high", "start", "prior", "size", "nuisance"))
    low, high = (
        check.number(f"{where}.{end}", check.needed(where, table, end, "must be a number: bounds keep a fit in sight"))
        for end in ("low", "high")
    )
    if not low < high:
        raise check.InvalidValue(where, (low, high), "must have low < high")
    # optional start, prior (mean, standard deviation) and size
    start, prior, size = table.get("start"), table.get("prior"), table.get("size")
    if prior is not None:
        mean, spread = check.sequence(f"{where}.prior", prior, "mean and standard deviation", 2)
        prior = check.number(f"{where}.prior[0]", mean), check.number(f"{where}.prior[1]", spread, above=0.0)
    return Parameter(
        path=path, name=check.text(f"{where}.name", table.get("name", path), empty=False), low=low, high=high,
        start=None if start is None else check.number(f"{where}.start", start, minimum=low, maximum=high),
        prior=prior, size=None if size is None else check.number(f"{where}.size", size, above=0.0),
        nuisance=check.flag(f"{where}.nuisance", table.get("nuisance", False)),
    )  # fmt: skip
