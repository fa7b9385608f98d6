"""Forward model of a fit: simulate the arm with given parameters under the inputs in a log."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence
from copy import copy, deepcopy
from typing import Any

import numpy as np

from flexarm_env import arms
from flexarm_env import sensors as sensing
from flexarm_env import validation as check
from flexarm_env.accuracy import finer_mesh, in_steps
from flexarm_env.bodies import SPACE
from flexarm_env.derivatives.runs import NotDifferentiable
from flexarm_env.derivatives.runs import Run as Played
from flexarm_env.parameters import Arm, Joint
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.sensors import Encoder
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import TimeFunction, constant, linear_table, spline_table
from flexarm_env.trajectory import Trajectory

from ..validation import Array
from .config import Channel, Config, Parameter
from .log import Run

OFFSET = 1e-5
"""Step of a parameter, divided by its size, for derivatives of a model's equations: see `runtime.sensitivity`."""
STEP = 1e-4
"""Step of a parameter, divided by its size, for finite differences of whole runs, the fallback."""
BEGUN: dict[str, Any] = {"low": -0.2, "high": 0.2, "start": 0.0, "size": 0.05, "nuisance": True}
"""Defaults of the parameter for a joint's initial angle, rad, relative to the joint's first reading."""
LOST = 1e3
"""Readings, divided by their scale, that are assumed for an arm whose simulation fails; they are far from any log."""
_LOAD = {"link": 0, "end": "tip", "force_x": 0.0, "force_y": 0.0, "force_z": 0.0}


class Experiment:
    """An arm with sensors, the loads of the experiment, and the parameters to be fitted.

    The loads act in addition to the inputs in the log. A joint whose angle is not prescribed starts at the first
    reading of its encoder. If the encoder's offset is known (offset = 0.0), the fit also determines the initial angle
    in each fitted log, because the first reading has a measurement error. logs: names of the fitted logs.

    Attributes:
        parameters (p,): the requested parameters, then the initial angles. start (p,): initial parameters.
        runs: number of simulations. refinements: number of times that the config's time step was halved ("step") and
            that the mesh was refined ("mesh"). by_differences: for each parameter whose derivative is a finite
            difference between simulations, the reason.
    """

    def __init__(self, arm: Arm, config: Config, parameters: Sequence[Parameter], logs: Sequence[str] = ()) -> None:
        """Build the experiment's table, locate every parameter in it, and validate start values and bounds."""
        assert config.sensors is not None
        self.arm, self.config = arm, config
        begun = [(log, k) for log in logs for k, offset in self._read_at_start().items() if offset is not None]
        names = [f"{arm.joint_names[k]}_angle at the start of {log}" for log, k in begun]
        self.parameters = (*parameters, *(Parameter(name, name, **BEGUN) for name in names))
        loads = check.sequence("loads", config.experiment.get("loads", ()), "tables")
        for i, load in enumerate(loads):
            check.known_keys(f"loads[{i}]", check.table_of(f"loads[{i}]", load), _LOAD)
        gravity = check.sequence("gravity", config.experiment.get("gravity", (0.0, 0.0)), "numbers (m/s^2)")
        if len(gravity) not in (2, 3):
            raise check.InvalidValue("gravity", gravity, "must be two numbers (m/s^2), or three for an arm in space")
        usual = {key: _LOAD[key] for key in ("link", "end", *(f"force_{axis}" for axis in config.axes))}
        self._table: dict[str, Any] = {
            **_lists(arms.to_table(arm)), "sensors": sensing.to_table(config.sensors),
            "gravity": [*gravity, 0.0][: len(config.axes)], "loads": [{**usual, **load} for load in loads],
            "inputs": {c.name: {"gain": 1.0, "offset": 0.0, "shift": 0.0} for c in config.inputs},
            "outputs": {c.name: {"gain": 1.0, "shift": 0.0} for c in config.outputs},
            "starts": {log: [0.0] * arm.n_links for log in logs},
        }  # fmt: skip
        self._places = [_place(parameter.path, self._sensor_names(), arm) for parameter in parameters]
        self._places += [("starts", log, k) for log, k in begun]
        whole = {**self._table, **_whole(arm, config)}
        for parameter, place in self._pairs():
            if not isinstance(_got(self._table, place), int | float):
                _check_place(parameter.path, place, whole)
        for word, count in (("elbows", arm.n_links - 1), ("joints", arm.n_links)):
            if any(place[0] == word for place in self._places):
                self._table.setdefault(word, [{} for _ in range(count)])
        self.runs, self.by_differences = 0, dict[str, str]()
        self.refinements = {"step": 0, "mesh": 0}
        self._kept: dict[tuple[str, int], tuple[bytes, Played | None]] = {}
        self._places_needed = any(not c.name.startswith("strain_gauge") for c in config.outputs)
        self._motions: dict[tuple[str, int], dict[str, TimeFunction]] = {}
        begins = [self._usual(p, place) if p.start is None else p.start for p, place in self._pairs()]
        for p, value in zip(self.parameters, begins, strict=True):
            with check.under(f'parameters."{p.path}"'):
                check.number("start", value, minimum=p.low, maximum=p.high)
        self.start = np.array(begins)
        self.arm_of(self.start)
        for k, p in enumerate(self.parameters):
            for end in ("low", "high"):
                self._check_bound(k, f'parameters."{p.path}".{end}', getattr(p, end))

    def _check_bound(self, k: int, path: str, bound: float) -> None:
        """Raise ValueError if the arm's description is invalid with parameter k at this bound."""
        values = self.start.copy()
        values[k] = bound
        try:
            self.arm_of(values)
        except ValueError as error:
            raise check.InvalidValue(path, bound, f"must be a value that the arm can have ({error})") from None

    def _pairs(self) -> Any:
        return zip(self.parameters, self._places, strict=True)

    def _sensor_names(self) -> dict[str, tuple[Any, ...]]:
        """Return a dict from the names of readings to their places in the table of sensors."""
        found = self.config.sensors
        assert found is not None
        names: dict[str, tuple[Any, ...]] = {
            f"strain_gauge_{i + 1}": ("strain_gauges", i) for i in range(len(found.strain_gauges))
        }
        if found.encoders:
            one = len(found.encoders) == 1
            names |= {f"{j}_angle": ("encoders", 0 if one else k) for k, j in enumerate(self.arm.joint_names)}
        return names

    def _usual(self, parameter: Parameter, place: tuple[Any, ...]) -> float:
        """Return the value that the arm, its sensors or the experiment has at a parameter's place."""
        value = _got(self._table, place)
        if value is None:
            value = _got(_whole(self.arm, self.config), place)
        if value is None:
            raise check.MissingKey(f'parameters."{parameter.path}".start', "the arm has no value of its own there")
        return float(value)

    def table(self, values: Array) -> dict[str, Any]:
        """Return the description of arm and experiment as a dict, with the parameters set to `values` (p,)."""
        table = deepcopy(self._table)
        for place, value in zip(self._places, values, strict=True):
            _put(table, place, float(value))
        return table

    def arm_of(self, values: Array) -> Arm:
        """Return the arm with its sensors for parameter values (p,). Raises ValueError for invalid values."""
        own = ("inputs", "outputs", "gravity", "loads", "starts")
        return arms.from_table({key: value for key, value in self.table(values).items() if key not in own})

    def elsewhere(self, values: Array) -> Array:
        """Return the parameter values (p,) for held-out logs: nuisance parameters keep their initial values."""
        return np.where([p.nuisance for p in self.parameters], self.start, values)

    def predict(self, values: Array, run: Run) -> dict[str, Array]:
        """Predict the readings (n,) of each output at the run's instants; all are `LOST` if the simulation fails."""
        return self._read(self._played(values, run), values, run)

    def _read(self, played: Played | None, values: Array, run: Run) -> dict[str, Array]:
        """Return the readings (n,) of each output of a simulation; `LOST` for a failed simulation (None)."""
        if played is None:
            far = LOST * np.sign(run.t - run.t.mean())
            return {name: far * y.std() for name, y in run.outputs.items()}
        return self._readings(played.trajectory, self.table(values), run)

    def slopes(self, values: Array, run: Run, sizes: Array, careful: bool = False) -> dict[str, Array]:
        """Return the derivatives (n, p) of each output of `predict` by the scaled parameters: values / `sizes` (p,).

        The derivatives are exact (`derivatives.runs`) where possible, and otherwise finite differences between
        simulations. careful: True for differences of fourth order. If the simulation fails, the derivatives are 0.
        """
        found = {name: np.zeros((len(run.t), len(values))) for name in run.outputs}
        played = self._played(values, run)
        if played is None:
            return found
        here = self._readings(played.trajectory, self.table(values), run)
        for k, p in enumerate(self.parameters):
            if self._places[k][0] == "starts" and self._places[k][1] != run.stem:
                continue
            try:
                change = self._tangent(played, here, values, run, k, OFFSET * sizes[k])
                change = {name: y * sizes[k] for name, y in change.items()}
            except NotDifferentiable as why:
                self.by_differences[p.name] = str(why)
                change = self._difference(here, values, run, k, sizes, careful)
            for name, column in change.items():
                found[name][:, k] = column
        return found

    def _tangent(self, played: Played, here: Any, values: Array, run: Run, k: int, step: float) -> dict[str, Array]:
        """Return the derivative (n,) of each output's readings by parameter k, from the tangent motion of a run."""
        around = self._around(values, k, step)
        others = [self._simulation(self._at(values, k, offset), run) for offset, _ in around]
        # sensor parameters do not change the motion
        own, change = self._places[k][0] in ("sensors", "outputs"), np.zeros(())
        if not own:
            change = played.slopes([(other, *pair) for other, pair in zip(others, around, strict=True)])
        centre = -sum(weight for _, weight in around)
        total = {name: centre * y for name, y in here.items()}
        for other, (offset, weight) in zip(others, around, strict=True):
            # readings of the linearly displaced motion, weighted
            trajectory = dataclasses.replace(played.trajectory, scene=other.scene)
            if not own:
                trajectory = played.moved(other, offset * change, self._places_needed)
            for name, y in self._readings(trajectory, self.table(self._at(values, k, offset)), run).items():
                total[name] = total[name] + weight * y
        return total

    def _around(self, values: Array, k: int, step: float) -> list[tuple[float, float]]:
        """Return offsets of parameter k and weights of a difference formula: central, or one-sided next to a bound."""
        p = self.parameters[k]
        up, down = values[k] + step <= p.high, values[k] - step >= p.low
        if up and down:
            return [(step, 0.5 / step), (-step, -0.5 / step)]
        ahead = step if up else -step
        return [(ahead, 2.0 / ahead), (2.0 * ahead, -0.5 / ahead)]

    @staticmethod
    def _at(values: Array, k: int, step: float) -> Array:
        moved = values.copy()
        moved[k] += step
        return moved

    def _difference(
        self, here: Mapping[str, Array], values: Array, run: Run, k: int, sizes: Array, careful: bool
    ) -> dict[str, Array]:
        """Return the derivative (n,) of each output's readings by parameter k / size, as a difference of whole runs."""
        p, step = self.parameters[k], STEP * sizes[k]

        def at(times: float) -> dict[str, Array]:
            moved = self._at(values, k, times * step)
            return self._read(self._play(moved, run), moved, run)

        # fourth-order central difference
        if careful and p.low <= values[k] - 2.0 * step and values[k] + 2.0 * step <= p.high:
            a, b, c, d = at(1.0), at(-1.0), at(2.0), at(-2.0)
            return {n: (8.0 * (a[n] - b[n]) - (c[n] - d[n])) / (12.0 * STEP) for n in here}
        ahead = 1.0 if values[k] + step <= p.high else -1.0
        return {name: (y - here[name]) / (ahead * STEP) for name, y in at(ahead).items()}

    def _readings(self, trajectory: Trajectory, table: Mapping[str, Any], run: Run) -> dict[str, Array]:
        """Return the readings (n,) of each output for a trajectory, with the channels' gains and delays."""
        sensors = trajectory.scene.arm.sensors
        assert sensors is not None
        read = trajectory.measured(_quiet(sensors, run.outputs))
        found = {}
        for name in run.outputs:
            own = table["outputs"][name]
            late = own["shift"]
            found[name] = own["gain"] * (np.interp(run.t - late, run.t, read[name]) if late else read[name])
        return found

    def anew(self, kind: str | None = None) -> Experiment:
        """Return a copy without stored simulations. kind: "step" for half the time step, "mesh" for a finer mesh."""
        other = copy(self)
        other._kept, other._motions = {}, {}
        if kind is not None:
            other.refinements = {**self.refinements, kind: self.refinements[kind] + 1}
        return other

    def settings(self, scene: Scene) -> Settings:
        """Return the config's solver settings with the refinements applied."""
        settings = scene.settings(**self.config.solver)
        assert settings.dt is not None
        for _ in range(self.refinements["mesh"]):
            settings = finer_mesh(settings)
        return settings.replace(dt=settings.dt / 2 ** self.refinements["step"])

    def _simulation(self, values: Array, run: Run) -> Simulation:
        scene = self._scene(self.arm_of(values), self.table(values), run)
        return Simulation(scene, in_steps(scene, self.settings(scene), scene.duration, run.period))

    def _played(self, values: Array, run: Run) -> Played | None:
        """Return the simulation of a run; the last simulation of each log is cached."""
        key, at = (run.stem, len(run.t)), values.tobytes()
        if self._kept.get(key, (None, None))[0] != at:
            self._kept[key] = at, self._play(values, run)
        return self._kept[key][1]

    def _play(self, values: Array, run: Run) -> Played | None:
        """Simulate a run once, without `simulate`'s error estimate; None if it fails."""
        self.runs += 1
        played = Played.of(self._simulation(values, run), run.period)
        good = played.trajectory.status == "ok" and len(played.trajectory.t) == len(run.t)
        return played if good else None

    def _scene(self, arm: Arm, table: Mapping[str, Any], run: Run) -> Scene:
        """Build the run's scene: motions and torques from the log's inputs, loads, gravity, initial angles (rad)."""
        motions, angles = [], [0.0] * arm.n_links
        loads: list[JointTorque | PointLoad] = []
        for channel in self.config.inputs:
            kind, k, own = channel.kind, channel.joint, table["inputs"][channel.name]
            if channel.moves:
                function = self._function(run, channel, own, kind)
                angles[k] = function.start
                elastic = kind == "motor" and arm.joint(k).elastic
                motions.append(Motion(f"{'motor' if elastic else 'joint'}{k}", function))
            else:
                factor, arm = _drive(arm, k, kind)
                loads.append(JointTorque(k, self._function(run, channel, {**own, "gain": own["gain"] * factor}, kind)))
        for load in table["loads"]:
            forces = {name: constant(load[name]) for name in load if name.startswith("force")}
            loads.append(PointLoad(load["link"], load["end"], **forces))
        begun = table["starts"].get(run.stem, [0.0] * arm.n_links)
        # joints without prescribed angle start at their first reading plus their parameter
        for k in self._read_at_start():
            angles[k] = float(run.outputs[f"{arm.joint_names[k]}_angle"][0]) + begun[k]
        gravity = tuple(table["gravity"]) if any(table["gravity"]) else None
        return Scene(
            run.stem, arm, duration=float(run.t[-1]), dt=run.period, angles=arm.stated(angles), motions=tuple(motions),
            loads=tuple(loads), gravity=gravity, space=self.config.axes == SPACE, start=self.config.start,
        )  # fmt: skip

    def _read_at_start(self) -> dict[int, float | None]:
        """Return joints that start at their first reading, with the channel's offset (None: fitted in each run)."""
        inputs, read = self.config.inputs, {c.name: c.offset for c in self.config.outputs}
        known = {} if all(c.moves for c in inputs) else dict(enumerate(self.arm.joint_names))
        driven = [c.joint for c in inputs if c.moves]
        return {k: read[of] for k, name in known.items() if (of := f"{name}_angle") in read and k not in driven}

    def _function(self, run: Run, channel: Channel, own: Mapping[str, float], kind: str) -> TimeFunction:
        """Interpolate an input over time: splines for angles, straight lines for torques; cached for equal numbers."""
        kept, numbers = self._motions.setdefault((run.stem, len(run.t)), {}), (own["gain"], own["offset"], own["shift"])
        key = f"{channel.name} {numbers}"
        if key not in kept:
            for old in [old for old in kept if old.startswith(f"{channel.name} ")][8:]:
                del kept[old]
            values = own["gain"] * (run.inputs[channel.name] - own["offset"])
            values = np.interp(run.t - own["shift"], run.t, values) if own["shift"] else values
            kept[key] = (spline_table if channel.moves else linear_table)(run.t, values)
        return kept[key]


def _drive(arm: Arm, k: int, kind: str) -> tuple[float, Arm]:
    """Return the joint torque per unit of an input, and the arm, in which back-emf is modeled as motor friction."""
    joint = arm.joint(k)
    if kind == "torque":
        return 1.0, arm
    if joint.motor is None:
        raise check.MissingKey(f"joints[{k}].motor", f"a {kind} does not determine the torque without it")
    factor = joint.motor.torque_constant * joint.gear_ratio
    if kind == "current":
        return factor, arm
    if joint.motor.resistance is None:
        raise check.MissingKey(f"joints[{k}].motor.resistance", "a voltage does not determine the current without it")
    if joint.elastic and joint.friction_side == "link" and (joint.friction_viscous or joint.friction_coulomb):
        what = 'must be "motor" where a voltage drives an elastic gear: its back-emf brakes the motor\'s side'
        raise check.InvalidValue(f"joints[{k}].friction_side", joint.friction_side, what)
    # torque = k n (U - k_e n rate) / R with gear ratio n
    emf = joint.motor.torque_constant if joint.motor.back_emf is None else joint.motor.back_emf
    brake = factor * emf * joint.gear_ratio / joint.motor.resistance
    own = dataclasses.replace(
        joint, friction_viscous=joint.friction_viscous + brake, friction_side="motor", motor=joint.motor
    )
    joints = [own if i == k else arm.joint(i) for i in range(arm.n_links)]
    return factor / joint.motor.resistance, dataclasses.replace(arm, joints=tuple(joints))


def _quiet(given: sensing.Sensors, names: Iterable[str]) -> sensing.Sensors:
    """Return the sensors that give these readings, without noise and quantization, so that readings are smooth."""

    def still(law: Any) -> Any:
        gain, bias = 0.5 * sum(law.gains), 0.5 * sum(law.biases)
        plain = dataclasses.replace(law, noise=0.0, quantum=0.0, gain=gain, bias=(bias, bias))
        return dataclasses.replace(plain, counts=None) if isinstance(law, Encoder) else plain

    def wanted(*words: str) -> bool:
        return any(name.startswith(words) for name in names)

    others = ("strain_gauge", "tip_acceleration", "camera", "gyroscope")
    turned = any(not name.startswith(others) for name in names)
    return sensing.Sensors(
        tuple(still(e) for e in given.encoders if turned),
        tuple(still(g) for g in given.strain_gauges if wanted(others[0])),
        still(given.accelerometer) if given.accelerometer and wanted(others[1]) else None,
        still(given.camera) if given.camera and wanted(others[2]) else None,
        still(given.gyroscope) if given.gyroscope and wanted(others[3]) else None,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------- key paths
def _place(path: str, sensors: Mapping[str, tuple[Any, ...]], arm: Arm) -> tuple[Any, ...]:
    """Parse a key path, "links[0].section.EI" -> ("links", 0, "section", "EI"); ValueError if no arm can have it."""
    if not re.fullmatch(r"\w+(\[\d+\])*(\.\w+(\[\d+\])*)*", path):
        raise check.InvalidValue("parameters", path, "must be a key path such as links[0].section.EI")
    words: list[Any] = [int(w) if w.isdigit() else w for w in re.findall(r"\w+", path)]
    known = (*arms.to_table(arm), "elbows", "joints", "payload", "hub_inertia", "tau_d", "sensors", "inputs", "outputs",
             "loads", "gravity")  # fmt: skip
    if words[0] not in known:
        raise check.UnknownKey(path, sorted({*known} - {"name", "source"}), "parameter")
    if words[0] == "sensors" and len(words) > 1 and words[1] in sensors:
        words[1:2] = sensors[words[1]]
    return tuple(words)


def _check_place(path: str, place: Sequence[Any], table: Any) -> None:
    """Raise ValueError unless the table has an entry at this place, or the entry is optional and absent."""
    where = ""
    for word in place:
        if table is None:
            return
        if isinstance(word, int) and isinstance(table, list | tuple):
            if word >= len(table):
                most = f"must be {where}[0] to {where}[{len(table) - 1}]" if table else f"there are no {where}"
                raise check.InvalidValue("parameters", path, f"{most}: the arm with its experiment has so many")
            where = f"{where}[{word}]"
        elif isinstance(word, str) and isinstance(table, Mapping):
            if word not in table:
                raise check.UnknownKey(f'parameters."{path}"', sorted(table), f"key {word!r} of {where}")
            where = f"{where}.{word}" if where else word
        else:
            raise check.InvalidValue("parameters", path, f"must be a key path: there is no [{word}] in {where}")
        table = table[word]
    if table is not None and (isinstance(table, bool) or not isinstance(table, int | float)):
        raise check.InvalidValue("parameters", path, f"must be the key path of a number, which {where} is not")


def _got(table: Any, place: Sequence[Any]) -> Any:
    """Return the entry of a nested table at a place; None if it is absent."""
    for word in place:
        try:
            table = table[word]
        except (KeyError, IndexError, TypeError):
            return None
    return table


def _put(table: Any, place: Sequence[Any], value: float) -> None:
    """Set the number at a place of a nested table; in a symmetric tensor, set both entries."""
    *before, last = place
    for word in before:
        above, table = table, table.setdefault(word, {}) if isinstance(table, dict) else table[word]
    table[last] = value
    if isinstance(last, int) and isinstance(before[-1], int):
        above[last][before[-1]] = value


def _lists(table: Any) -> Any:
    """Copy a table with lists in place of tuples, so that entries can be set."""
    if isinstance(table, Mapping):
        return {key: _lists(value) for key, value in table.items()}
    return [_lists(value) for value in table] if isinstance(table, list | tuple) else table


def _whole(arm: Arm, config: Config) -> dict[str, Any]:
    """Return a dict from key paths to all numbers of an arm and its sensors, including default values."""
    table: dict[str, Any] = _lists(dataclasses.asdict(dataclasses.replace(arm, sensors=config.sensors)))
    joints = [dataclasses.asdict(arm.joint(k) if arm.joints else Joint()) for k in range(arm.n_links)]
    for i, link in enumerate(arm.links):
        table["links"][i]["tau_d"] = arm.tau_d if link.tau_d is None else link.tau_d
        if link.rigid:
            table["links"][i] = arms.to_table(arm)["links"][i]
    elbows = [dataclasses.asdict(arm.elbow(k)) for k in range(1, arm.n_links)]
    return {**table, "joints": joints, "elbows": elbows}
