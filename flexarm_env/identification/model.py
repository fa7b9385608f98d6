"""From numbers to readings: an arm and an experiment with parameters put in by key path, run through a log's inputs."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import arms
from flexarm_env import sensors as sensing
from flexarm_env import validation as check
from flexarm_env.parameters import Arm, Joint
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.sensors import Encoder
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import TimeFunction, constant, linear_table, spline_table
from flexarm_env.trajectory import Recorder, Trajectory

from .config import Channel, Config, Parameter, readings_of
from .log import Run

Array = NDArray[np.float64]

LOST = 1e3
"""Readings, over their scale, of an arm whose run fails: far from any log."""

_LOAD = {"link": 0, "end": "tip", "force_x": 0.0, "force_y": 0.0}


class Experiment:
    """An arm with its sensors, what acts on it beside the log's inputs, and the parameters that are to be found."""

    def __init__(self, arm: Arm, config: Config, parameters: Sequence[Parameter]) -> None:
        assert config.sensors is not None
        self.arm, self.config, self.parameters = arm, config, tuple(parameters)
        loads = check.sequence("loads", config.experiment.get("loads", ()), "tables")
        for i, load in enumerate(loads):
            check.known_keys(f"loads[{i}]", check.table_of(f"loads[{i}]", load), _LOAD)
        gravity = check.sequence("gravity", config.experiment.get("gravity", (0.0, 0.0)), "two numbers (m/s^2)", 2)
        self._table: dict[str, Any] = {
            **arms.to_table(arm), "sensors": sensing.to_table(config.sensors), "gravity": list(gravity),
            "loads": [{**_LOAD, **load} for load in loads],
            "inputs": {c.name: {"gain": 1.0, "offset": 0.0, "shift": 0.0} for c in config.inputs},
            "outputs": {c.name: {"gain": 1.0, "shift": 0.0} for c in config.outputs},
        }  # fmt: skip
        self._places = [_place(parameter.path, self._sensor_names(), arm) for parameter in self.parameters]
        for word, count in (("elbows", arm.n_links - 1), ("joints", arm.n_links)):
            if any(place[0] == word for place in self._places):
                self._table.setdefault(word, [{} for _ in range(count)])
        self._motions: dict[tuple[str, int], dict[str, TimeFunction]] = {}
        begins = [self._usual(p, place) if p.start is None else p.start for p, place in self._pairs()]
        for p, value in zip(self.parameters, begins, strict=True):
            with check.under(f'parameters."{p.path}"'):
                check.number("start", value, minimum=p.low, maximum=p.high)
        self.start = np.array(begins)
        self.arm_of(self.start)

    def _pairs(self) -> Any:
        return zip(self.parameters, self._places, strict=True)

    def _sensor_names(self) -> dict[str, tuple[Any, ...]]:
        """Readings to places in the table of sensors."""
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
        """The value that the arm, its sensors or the experiment have."""
        value = _got(self._table, place)
        if value is None:
            value = _got(_whole(self.arm, self.config), place)
        with check.under(f'parameters."{parameter.path}"'):
            return check.number("value", value)

    def table(self, values: Array) -> dict[str, Any]:
        """The experiment's table with the parameters at these values."""
        table = deepcopy(self._table)
        for place, value in zip(self._places, values, strict=True):
            _put(table, place, float(value))
        return table

    def arm_of(self, values: Array) -> Arm:
        """The arm with its sensors. Raises ValueError where a value is none that an arm can have."""
        own = ("inputs", "outputs", "gravity", "loads")
        return arms.from_table({key: value for key, value in self.table(values).items() if key not in own})

    def elsewhere(self, values: Array) -> Array:
        """The values for logs that were not fitted: what is a nuisance has its start."""
        return np.where([p.nuisance for p in self.parameters], self.start, values)

    def predict(self, values: Array, run: Run) -> dict[str, Array]:
        """What the sensors read at the run's instants, by output, (n,); LOST where the arm's run fails."""
        table = self.table(values)
        arm = arms.from_table({k: v for k, v in table.items() if k not in ("inputs", "outputs", "gravity", "loads")})
        recorded = self._recorded(self._scene(arm, table, run), run)
        if recorded is None:
            far = LOST * np.sign(run.t - run.t.mean())
            return {name: far * y.std() for name, y in run.outputs.items()}
        assert arm.sensors is not None
        read = recorded.measured(_quiet(arm.sensors))
        found = {}
        for name in run.outputs:
            own = table["outputs"][name]
            late = own["shift"]
            found[name] = own["gain"] * (np.interp(run.t - late, run.t, read[name]) if late else read[name])
        return found

    def _recorded(self, scene: Scene, run: Run) -> Trajectory | None:
        """The scene at the run's instants; None where the arm fails. `simulate` would look for its errors as well."""
        settings = scene.settings(**self.config.solver)
        simulation, recorder = Simulation(scene, settings), Recorder(scene, settings)
        simulation.record(scene.duration, run.period, recorder.extend)
        recorded = recorder.finish(simulation, 0.0)
        return recorded if recorded.status == "ok" and len(recorded.t) == len(run.t) else None

    def _scene(self, arm: Arm, table: Mapping[str, Any], run: Run) -> Scene:
        motions, angles, before = [], [0.0] * arm.n_links, 0.0
        loads: list[JointTorque | PointLoad] = []
        for channel in self.config.inputs:
            kind, k, own = channel.name[:-1], int(channel.name[-1]), table["inputs"][channel.name]
            if kind in ("joint", "motor"):
                function = self._function(run, channel, own, kind)
                angles[k] = function.start
                elastic = kind == "motor" and arm.joint(k).elastic
                motions.append(Motion(f"{'motor' if elastic else 'joint'}{k}", function))
            else:
                factor, arm = _drive(arm, k, kind)
                loads.append(JointTorque(k, self._function(run, channel, {**own, "gain": own["gain"] * factor}, kind)))
        for load in table["loads"]:
            forces = (constant(load["force_x"]), constant(load["force_y"]))
            loads.append(PointLoad(load["link"], load["end"], *forces))
        if self._starts_at_readings():
            for k, name in enumerate(arm.joint_names):
                if f"{name}_angle" in run.outputs and not any(
                    c.name[-1] == str(k) for c in self.config.inputs if c.name[:-1] in ("joint", "motor")
                ):
                    angles[k] = float(run.outputs[f"{name}_angle"][0])
        absolute = []
        for angle in angles:
            before += angle
            absolute.append(before)
        gravity = tuple(table["gravity"]) if any(table["gravity"]) else None
        return Scene(
            run.stem, arm, duration=float(run.t[-1]), dt=run.period, angles=tuple(absolute), motions=tuple(motions),
            loads=tuple(loads), gravity=gravity,
        )  # fmt: skip

    def _starts_at_readings(self) -> bool:
        return any(c.name[:-1] not in ("joint", "motor") for c in self.config.inputs)

    def _function(self, run: Run, channel: Channel, own: Mapping[str, float], kind: str) -> TimeFunction:
        """The input over time: a spline of angles, straight lines of torques; kept while its numbers are the same."""
        kept, numbers = self._motions.setdefault((run.stem, len(run.t)), {}), (own["gain"], own["offset"], own["shift"])
        key = f"{channel.name} {numbers}"
        if key not in kept:
            for old in [old for old in kept if old.startswith(f"{channel.name} ")][8:]:
                del kept[old]
            values = own["gain"] * (run.inputs[channel.name] - own["offset"])
            values = np.interp(run.t - own["shift"], run.t, values) if own["shift"] else values
            kept[key] = (spline_table if kind in ("joint", "motor") else linear_table)(run.t, values)
        return kept[key]


def _drive(arm: Arm, k: int, kind: str) -> tuple[float, Arm]:
    """Joint torque per unit of a torque, current or voltage, and the arm that it acts on.

    A voltage makes a current less by back_emf rate / resistance, which is viscous friction on the motor's side.
    """
    joint = arm.joint(k)
    if kind == "torque":
        return 1.0, arm
    if joint.motor is None:
        raise check.MissingKey(f"joints[{k}].motor", f"a {kind} says nothing about the torque without it")
    factor = joint.motor.torque_constant * joint.gear_ratio
    if kind == "current":
        return factor, arm
    if joint.motor.resistance is None:
        raise check.MissingKey(f"joints[{k}].motor.resistance", "a voltage says nothing about the current without it")
    if joint.elastic and joint.friction_side == "link" and (joint.friction_viscous or joint.friction_coulomb):
        what = 'must be "motor" where a voltage drives an elastic gear: its back-emf brakes the motor\'s side'
        raise check.InvalidValue(f"joints[{k}].friction_side", joint.friction_side, what)
    emf = joint.motor.torque_constant if joint.motor.back_emf is None else joint.motor.back_emf
    brake = factor * emf * joint.gear_ratio / joint.motor.resistance
    own = dataclasses.replace(
        joint, friction_viscous=joint.friction_viscous + brake, friction_side="motor", motor=joint.motor
    )
    joints = [own if i == k else arm.joint(i) for i in range(arm.n_links)]
    return factor / joint.motor.resistance, dataclasses.replace(arm, joints=tuple(joints))


def _quiet(given: sensing.Sensors) -> sensing.Sensors:
    """The sensors without what is drawn and without steps, whose readings are smooth functions of the parameters."""

    def still(law: Any) -> Any:
        gain, bias = 0.5 * sum(law.gains), 0.5 * sum(law.biases)
        plain = dataclasses.replace(law, noise=0.0, quantum=0.0, gain=gain, bias=(bias, bias))
        return dataclasses.replace(plain, counts=None) if isinstance(law, Encoder) else plain

    return sensing.Sensors(
        tuple(still(e) for e in given.encoders), tuple(still(g) for g in given.strain_gauges),
        given.accelerometer and still(given.accelerometer), given.camera and still(given.camera),
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------- key paths
def _place(path: str, sensors: Mapping[str, tuple[Any, ...]], arm: Arm) -> tuple[Any, ...]:
    """ "links[0].section.EI" -> ("links", 0, "section", "EI"); ValueError where an arm has no such thing."""
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


def _got(table: Any, place: Sequence[Any]) -> Any:
    for word in place:
        try:
            table = table[word]
        except (KeyError, IndexError, TypeError):
            return None
    return table


def _put(table: Any, place: Sequence[Any], value: float) -> None:
    for word in place[:-1]:
        table = table.setdefault(word, {}) if isinstance(table, dict) else table[word]
    table[place[-1]] = value


def _whole(arm: Arm, config: Config) -> dict[str, Any]:
    """All numbers of an arm and its sensors, defaults among them, to be found by key path."""
    table = dataclasses.asdict(dataclasses.replace(arm, sensors=config.sensors))
    joints = [dataclasses.asdict(arm.joint(k) if arm.joints else Joint()) for k in range(arm.n_links)]
    for i, link in enumerate(arm.links):
        table["links"][i]["tau_d"] = arm.tau_d if link.tau_d is None else link.tau_d
    elbows = [dataclasses.asdict(arm.elbow(k)) for k in range(1, arm.n_links)]
    return {**table, "joints": joints, "elbows": elbows}


__all__ = ["Experiment", "readings_of"]
