"""Arms in space identified: derivatives against differences of runs, planted parameters, a log, what is refused."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification import BOOM, SPACE, case_in_space, drawn
from flexarm_env import Motor, arms
from flexarm_env.identification import identify, read_config
from flexarm_env.identification.log import Run as Log
from flexarm_env.identification.model import Experiment
from tests.identify_tools import compare
from tests.refusals import says as refuses

T = np.arange(41) / 100
LIMIT = 2e-6
WAVE = np.minimum(T, 0.3) ** 2
SENSORS = """
encoders = {}
gyroscope = {}
accelerometer = { low_pass = { frequency = 20.0 } }
strain_gauges ="""
READ = """strain_gauge_3 = "twist"
elbow_angle = "elbow"
gyroscope_y = "turn"
tip_acceleration_z = "a"
"""


def experiment(paths: tuple[str, ...], change: dict[str, str], arm: arms.Arm = BOOM, solver: str = "") -> Experiment:
    """Of the boom's gauges and all its other sensors, at a tolerance of 1e-15."""
    text = SPACE.partition("[parameters]")[0].replace("dt = 0.005", f"dt = 0.00125\ntolerance = 1e-15\n{solver}")
    for old, new in {'strain_gauge_3 = "twist"\n': READ, "\nstrain_gauges =": SENSORS, **change}.items():
        assert old in text
        text = text.replace(old, new)
    ends = {"payload.inertia[0][1]": (-1e-4, 1e-4), **dict.fromkeys(("gravity[2]", "payload.offset[2]"), (-99.0, 99.0))}
    ends["loads[0].force_z"] = (-2.0, 2.0)
    rows = ['"{}" = {{ low = {}, high = {} }}\n'.format(p, *ends.get(p, (1e-9, 1e5))) for p in paths]
    config = read_config(text + "[parameters]\n" + "".join(rows), arm)
    return Experiment(arm, config, config.chosen())


def log(drives: tuple[str, str], size: float, made: Experiment) -> Log:
    angles = dict(zip(drives, (size * WAVE * np.sin(9.0 * T + 1.0), size * WAVE * np.sin(7.0 * T + 2.0)), strict=True))
    return Log("log", T, angles, {channel.name: np.sin(T) for channel in made.config.outputs}, T >= 0.0)


@pytest.mark.slow
def test_derivatives_of_prescribed_joints() -> None:
    """Steps of 1.25 ms: of 5 ms the error is 16 times as large, for a step's end depends on Newton's way, rotations not
    adding up, which no derivative knows of."""
    tensor = ((2e-4, 0.0, 0.0), (0.0, 3e-4, 0.0), (0.0, 0.0, 4e-4))
    arm = dataclasses.replace(BOOM, payload=dataclasses.replace(BOOM.payload, inertia=tensor), joints=())
    section = ("EI", "EI_y", "GJ", "m")
    paths = (
        *(f"links[1].section.{word}" for word in section), "payload.mass", "payload.inertia[0][1]", "payload.offset[2]",
        "tau_d", "gravity[2]", "loads[0].force_z",
    )  # fmt: skip
    made = experiment(paths, {"motor1 =": "joint1 =", "[solver]": "[[loads]]\nlink = 1\n[solver]"}, arm)
    compare(made, log(("joint0", "joint1"), 8.0, made), LIMIT, 2e-3, 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["", 'formulation = "floating_frame"\nsegments = 2'])
def test_derivatives_of_driven_joints(solver: str) -> None:
    """Currents into geared motors with friction, under gravity; what the links before are made of counts."""
    motor = Motor(torque_constant=0.05)
    more = {"gear_ratio": 50.0, "motor_inertia": 2e-5, "friction_viscous": 0.3, "friction_coulomb": 0.1, "motor": motor}
    joints = tuple(dataclasses.replace(BOOM.joints[1], **more) for _ in range(2))
    arm = dataclasses.replace(BOOM, joints=joints)
    paths = (
        "links[1].section.EI", "joints[0].stiffness", "joints[1].friction_viscous", "joints[0].friction_coulomb",
        "joints[1].motor_inertia", "links[0].inertia", "gravity[2]", "joints[0].motor.torque_constant",
    )  # fmt: skip
    change = {"joint0 =": "current0 =", "motor1 =": "current1 ="}
    change |= {"elements = 2\n": ""} if solver else {}
    made = experiment(paths, change, arm, solver)
    compare(made, log(("current0", "current1"), 30.0, made), LIMIT, 1e-4, 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_planted_parameters_are_recovered(seed: int) -> None:
    """Two of the hundred of the benchmark: gauges in both planes and of torsion, six numbers by key path."""
    found = case_in_space(seed)
    assert all(found["holds"].values()) and not found["untold"]
    assert max(map(abs, found["error"].values())) < 0.03 < 0.08


@pytest.mark.slow
def test_a_log_is_identified(tmp_path: Path) -> None:
    """From a file to an arm's file, judged on a run of other motions."""
    chosen = ("EI", "EI_y", "payload")
    names, files = ("up", "across", "twist"), []
    for seed in (5, 6):
        problem, _ = drawn(seed, BOOM, SPACE, chosen, ["joint0", "motor1"], 1.5, np.linspace(3, 40, 9))
        (run,), made = problem.runs, problem.experiment
        truth = made.start * np.array([1.1, 0.9, 1.2])
        columns = [run.t, *run.inputs.values(), *made.predict(truth, run).values()]
        files.append(tmp_path / f"run{seed}.csv")
        head = ",".join(("t", "yaw", "shoulder", *names))
        np.savetxt(files[-1], np.array(columns).T, delimiter=",", header=head, comments="")
    config = SPACE.replace("starts = 2", "starts = 1")
    found = identify(BOOM, config, files[:1], fit=chosen, hold_out=files[1:], out=tmp_path / "fit")
    assert found.good and np.abs(found.values / truth - 1.0).max() < 1e-3
    assert min(found.held_out[0].vaf.values()) > 99.9 > 98.0 > min(found.unfitted[1].vaf.values())
    arm = arms.resolve(tmp_path / "fit" / "arm.toml")
    assert arm.payload.mass == pytest.approx(1.2 * BOOM.payload.mass, rel=1e-3) and len(found.frequencies) == 4
    assert set(found.ranges) == {"EI", "payload"}


def test_a_wrong_config_is_a_sentence() -> None:
    for old, new, says in (
        ("-9.81]", "-9.81, 1.0]", "gravity = (0.0, 0.0, -9.81, 1.0): must be two numbers (m/s^2), or three"),
        ("strain_gauge_3 =", "strain_gauge_4 =", "outputs.strain_gauge_4: unknown sensor"),
        ('"tau_d" =', '"links[0].section.EI" =', "unknown key 'section' of links[0]; allowed: centre, inertia, length"),
        ('"tau_d" =', '"payload.inertia[0][0]" =', "'payload.inertia[0][0]': must be a key path"),
        ("link = 1, place = 0.3", "link = 0, place = 0.3", "strain_gauges[2].link = 0: must be a flexible link"),
    ):
        text = SPACE.replace(old, new)
        assert text != SPACE
        refuses(says, lambda text=text: Experiment(BOOM, (c := read_config(text, BOOM)), c.chosen()))


def test_gravity_of_three_numbers_carries_an_arm_of_the_plane_into_space() -> None:
    """Without it the gauges of the other plane are refused."""
    strip, text = arms.named("strip"), SPACE.replace("link = 1", "link = 0").replace('motor1 = "shoulder"\n', "")
    assert read_config(text, strip).solver["formulation"] == "geometrically_exact"
    flat = text.replace("0.0, 0.0, -9.81", "0.0, -9.81")
    refuses("strain_gauges[1].measures = 'xz': must be \"xy\" in the plane", lambda: read_config(flat, strip))
