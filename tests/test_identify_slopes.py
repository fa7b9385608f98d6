"""Derivatives of what an arm's sensors read, against differences of whole runs at a tolerance of 1e-12."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env import Arm, Joint, Motor, Section, arms
from flexarm_env.derivatives.runs import NotDifferentiable, Run
from flexarm_env.identification.config import read_config
from flexarm_env.identification.log import Run as Log
from flexarm_env.identification.model import Experiment
from flexarm_env.sensors import Encoder, Sensors, StrainGauge
from tests.identify_tools import by_runs
from tests.identify_tools import compare as compare_slopes

T = np.arange(101) / 100
WAVE = np.minimum(T, 0.3) ** 2 * np.sin(9.0 * T + 1.0)

STRIP = """
gravity = [0.5, -3.0]
[inputs]
%s = "u"
[outputs]
hub_angle = { column = "hub", offset = 0.0 }
strain_gauge_1 = "strain"
tip_acceleration_y = "a"
[[loads]]
link = 0
[sensors]
encoders = {}
accelerometer = { low_pass = { frequency = 20.0 } }
strain_gauges = [{ place = 0.1, unit = "strain", low_pass = { frequency = 15.0, order = 2 }, delay = 0.013 }]
[solver]
dt = 0.005
tolerance = %s
%s
[parameters]
"""
LINK = (
    "links[0].length", "links[0].section.EI", "links[0].section.m", "links[0].section.J", "links[0].root_offset",
    "payload.mass", "payload.inertia", "tau_d",
)  # fmt: skip
READ = (
    "sensors.strain_gauge_1.gain", "sensors.strain_gauge_1.place",
    "sensors.strain_gauge_1.low_pass.frequency", "sensors.strain_gauge_1.low_pass.damping",
    "sensors.strain_gauge_1.delay", "sensors.accelerometer.gain", "outputs.hub_angle.gain", "outputs.hub_angle.shift",
)  # fmt: skip
AROUND = ("gravity[0]", "gravity[1]", "loads[0].force_x", "loads[0].force_y")
GEARED = Joint(
    stiffness=60.0, damping=0.05, gear_ratio=50.0, motor_inertia=2e-5, friction_viscous=0.3,
    motor=Motor(torque_constant=0.05, resistance=2.0),
)  # fmt: skip
TURNED = ("stiffness", "damping", "motor_inertia", "friction_viscous", "gear_ratio", "motor.torque_constant")


def strip(**changes: Any) -> Arm:
    """A strip of which nothing is zero."""
    arm = arms.named("strip")
    section = dataclasses.replace(arm.links[0].uniform or Section(EI=1.0, EA=1.0, C=1.0, m=1.0), J=1e-3)
    link = dataclasses.replace(arm.links[0], section=section, root_offset=0.02)
    payload = dataclasses.replace(arm.payload, inertia=1e-3)
    return dataclasses.replace(arm, links=(link,), payload=payload, hub_inertia=0.01, tau_d=0.004, **changes)


def low(path: str) -> float:
    """A bound that an arm can have, far from where anything is looked at."""
    signed = path.startswith(("gravity", "loads")) or path.endswith(("shift", "inputs.joint0.offset"))
    return -99.0 if signed else 0.0 if path.endswith(("delay", "offset", "tau_d")) else 1e-6


def high(path: str) -> float:
    """The other bound."""
    return {"place": 0.3, "delay": 0.1, "frequency": 60.0, "EA": 1e9, "C": 1e9}.get(path.rpartition(".")[2], 1e3)


def experiment(
    paths: tuple[str, ...], drive: str, arm: Arm | None = None, solver: str = "nodes = 4", tolerance: str = "1e-12",
    start: str = "unloaded",
) -> Experiment:  # fmt: skip
    arm = strip() if arm is None else arm
    entries = "".join(f'"{path}" = {{ low = {low(path)}, high = {high(path)}, size = 0.1 }}\n' for path in paths)
    config = read_config(f'start = "{start}"\n' + STRIP % (drive, tolerance, solver) + entries, arm)
    made = Experiment(arm, config, config.chosen())
    sized = tuple(dataclasses.replace(p, size=abs(x) or 0.5) for p, x in zip(made.parameters, made.start, strict=True))
    return Experiment(arm, config, sized, ["log"])


def log(drive: str, size: float) -> Log:
    shown = {name: np.sin(T) for name in ("hub_angle", "strain_gauge_1", "tip_acceleration_y")}
    return Log("log", T, {drive: size * WAVE}, shown, T >= 0.0)


def compare(made: Experiment, run: Log, limit: float = 1e-6, step: float = 2e-3) -> None:
    compare_slopes(made, run, limit, step, 1e-9)


@pytest.mark.slow
def test_of_a_prescribed_hub() -> None:
    made = experiment((*LINK, *READ, *AROUND, "inputs.joint0.gain", "inputs.joint0.offset"), "joint0")
    compare(made, log("joint0", 2.0))


@pytest.mark.slow
@pytest.mark.parametrize("start", ["unloaded", "held"])
def test_of_a_torque(start: str) -> None:
    """Slopes of the torque jump at each sample; the hub is free, and what it is made of counts."""
    paths = ("links[0].section.EI", "hub_inertia", "tau_d", "inputs.torque0.gain", *AROUND[1:3])
    made = experiment(paths, "torque0", start=start)
    compare(made, log("torque0", 3.0))


@pytest.mark.slow
def test_next_to_a_bound_they_are_of_one_side() -> None:
    made = experiment(("payload.mass",), "joint0")
    bound = dataclasses.replace(made.parameters[0], low=float(made.start[0]))
    at = Experiment(made.arm, made.config, (bound,))
    run, sizes = log("joint0", 2.0), np.array([bound.size])
    inside, beside = made.slopes(made.start, run, sizes), at.slopes(at.start, run, sizes)
    for name, column in inside.items():
        assert np.abs(beside[name] - column).max() <= 1e-6 * np.abs(column).max() + 1e-10


@pytest.mark.slow
def test_what_has_no_derivative_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made, run = experiment(("payload.mass",), "joint0"), log("joint0", 2.0)
    sizes = np.array([made.parameters[0].size])
    exact = made.slopes(made.start, run, sizes)

    def refuse(_: Run) -> None:
        raise NotDifferentiable("a reason")

    monkeypatch.setattr(Run, "check", refuse)
    for careful, limit, runs in ((False, 1e-3, 1), (True, 1e-6, 4)):
        before = made.runs
        found = made.slopes(made.start, run, sizes, careful)
        assert made.by_differences == {"payload.mass": "a reason"} and made.runs == before + runs
        for name, column in exact.items():
            assert np.abs(found[name] - column).max() <= limit * np.abs(column).max() + 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["voltage0", "current0", "motor0"])
def test_of_a_geared_motor(drive: str) -> None:
    """Gear, rotor, viscous friction, and how a current or a voltage makes a torque."""
    arm = strip(joints=(GEARED,), sensors=Sensors((Encoder(side="motor"),)))
    of_motor = ("motor.resistance",) if drive == "voltage0" else ()
    turned = TURNED if drive != "motor0" else TURNED[:2]
    paths = ("links[0].section.EI", *(f"joints[0].{word}" for word in (*turned, *of_motor)))
    compare(experiment(paths, drive, arm), log(drive, {"voltage0": 10.0, "current0": 4.0, "motor0": 2.0}[drive]))


@pytest.mark.slow
def test_of_dry_friction_and_backlash() -> None:
    """A joint that sticks and slips, whose gear has play: each step's branch is differentiated."""
    rough = dataclasses.replace(GEARED, friction_coulomb=0.05, backlash=0.002)
    arm = strip(joints=(rough,), sensors=Sensors((), (StrainGauge(),)))
    paths = (
        "links[0].section.EI",
        *(f"joints[0].{w}" for w in ("stiffness", "friction_coulomb", "friction_viscous", "backlash")),
    )
    compare(experiment(paths, "current0", arm), log("current0", 4.0), step=1e-5)


STIFF = {
    "exact beam": 'formulation = "geometrically_exact"\nelements = 2',
    "floating frame": 'formulation = "floating_frame"\nsegments = 2',
}


@pytest.mark.slow
@pytest.mark.parametrize("solver", STIFF)
def test_of_other_formulations(solver: str) -> None:
    """At a tolerance of 1e-15: what Newton leaves changes with parameters as well, for an exact beam by 2e-5 of the
    derivatives at 1e-13, 5e-6 at 1e-14, the same for every difference's step."""
    section = ("length", "section.EI", "section.EA", "section.m")
    paths = (*(f"links[0].{word}" for word in section), "payload.mass", "tau_d", "hub_inertia", *AROUND)
    compare(experiment(paths, "torque0", solver=STIFF[solver], tolerance="1e-15"), log("torque0", 3.0))


@pytest.mark.slow
@pytest.mark.parametrize("solver", STIFF)
def test_of_what_has_turned_far(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parameter that turns the arm by radians over the run: nothing stretches along its tangent."""
    monkeypatch.setitem(globals(), "T", np.arange(401) / 100)
    monkeypatch.setitem(globals(), "WAVE", np.minimum(T, 0.3) ** 2 * np.sin(9.0 * T + 1.0))
    paths = ("links[0].length", "links[0].section.EA", "gravity[1]")
    made = experiment(paths, "torque0", solver=STIFF[solver], tolerance="1e-15")
    compare(made, log("torque0", 3.0), step=1e-4)


@pytest.mark.slow
def test_of_two_links_over_some_seconds() -> None:
    """What has rung for 40 periods: an error of the tangent would have grown with the phase."""
    arm = arms.named("quanser_2dsfl")
    config = read_config(
        """
[inputs]
motor0 = "a"
motor1 = "b"
[outputs]
strain_gauge_1 = "c"
strain_gauge_2 = "d"
[solver]
nodes = 4
tolerance = 1e-12
[parameters]
"links[0].section.EI" = { low = 0.5, high = 5.0 }
"links[1].section.EI" = { low = 0.1, high = 1.0 }
"elbows[0].inertia_left" = { low = 0.001, high = 0.2 }
"elbows[0].mass" = { low = 0.1, high = 9.0 }
"links[1].root_offset" = { low = 0.0, high = 0.15 }
"tau_d" = { low = 1e-4, high = 0.02 }
""",
        arm,
    )
    t = np.arange(2001) / 100
    hub, names = 0.3 * np.minimum(t, 1.0) ** 2 * np.sin(3.0 * t), ("strain_gauge_1", "strain_gauge_2")
    run = Log("log", t, {"motor0": hub, "motor1": 0.5 * hub}, {name: np.sin(t) for name in names}, t >= 0.0)
    made = Experiment(arm, config, config.chosen())
    sizes = np.abs(made.start)
    found = made.slopes(made.start, run, sizes)
    for k, p in enumerate(made.parameters):
        for name, known in by_runs(made, run, k, sizes[k], 2e-4, 4).items():
            assert np.abs(found[name][:, k] - known).max() < 1e-6 * np.abs(known).max(), (p.path, name)


def test_runs_that_are_not_of_equal_steps_are_refused() -> None:
    made = experiment(("payload.mass",), "torque0")
    late = log("torque0", 3.0)
    simulation = made._simulation(made.start, late)
    run = Run.of(simulation, 0.007)  # kinks of the torque, each 0.01 s, are not at its samples
    with pytest.raises(NotDifferentiable, match="kink between two steps"):
        run.slopes([(simulation, 1e-5, 0.5e5), (simulation, -1e-5, -0.5e5)])
