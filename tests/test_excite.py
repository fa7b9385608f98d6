"""Torques that tell what an arm is: their bounds, their spectrum, how they are played."""

import dataclasses
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import JointTorque, Scene, arms, simulate
from flexarm_env.cli import main
from flexarm_env.files import csv_lines
from flexarm_env.identification import Excitation, excite
from flexarm_env.remote import Limits, Played, Server, Session
from flexarm_env.time_functions import linear_table
from tests.cli_tools import refused
from tests.processes import served
from tests.refusals import refuses

STRIP = arms.named("strip")


@pytest.fixture(scope="module")
def found() -> Excitation:
    return excite(STRIP, seconds=8.0, rate=100.0, most_angle=0.3, drawn=3, seed=2)


def test_a_rigid_arm_comes_to_rest_where_it_began() -> None:
    """By the inertia of a rod with a hub and a mass at its end, integrated twice."""
    found = excite(STRIP, seconds=4.0, rate=1000.0, drawn=0)
    link = STRIP.links[0]
    inertia = STRIP.hub_inertia + link.mass * link.length**2 / 3.0 + STRIP.payload.mass * link.length**2
    dt = found.t[1]
    rate = np.concatenate([[0.0], np.cumsum(0.5 * (found.torques[1:, 0] + found.torques[:-1, 0]) * dt)]) / inertia
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * dt)])
    assert abs(rate[-1]) < 1e-4 * np.abs(rate).max() and abs(angle[-1]) < 1e-3 * np.abs(angle).max()
    assert found.torques[0] == pytest.approx(0.0, abs=1e-12) and found.torques[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_bounds_hold_of_another_formulation_and_of_other_arms(found: Excitation) -> None:
    """Arms at the corners of the spread, stepped by the exact beam."""
    assert np.abs(found.torques).max() <= 0.5 * STRIP.torque_limits[0] and 0.05 < found.angle <= 0.3
    loads = (JointTorque(0, linear_table(found.t, found.torques[:, 0])),)
    for payload, hub in ((1.0, 1.0), (0.55, 0.55), (1.9, 0.55)):
        own = dataclasses.replace(
            STRIP, hub_inertia=hub * STRIP.hub_inertia,
            payload=dataclasses.replace(STRIP.payload, mass=payload * STRIP.payload.mass),
        )  # fmt: skip
        run = simulate(Scene("other", own, duration=8.0, dt=0.005, loads=loads), "geometrically_exact", sample=0.01)
        assert run.finished and np.abs(run.joint_angles).max() <= 0.3 and np.abs(run.tip_deflection).max() <= 0.15


def test_the_spectrum_covers_the_first_modes(found: Excitation) -> None:
    low, high = found.band
    assert len(found.modes) == 2 and all(low < w < high for w in found.modes)
    power = np.abs(np.fft.rfft(found.torques[:, 0])) ** 2
    w = 2.0 * np.pi * np.fft.rfftfreq(len(found.t), found.t[1])
    inside = (w >= 0.8 * low) & (w <= 1.1 * high)
    assert power[inside].sum() > 0.98 * power.sum()
    for mode in found.modes:  # within a quarter of each there is something to ring it
        assert power[np.abs(w / mode - 1.0) < 0.25].max() > 0.05 * power.max()


@pytest.mark.slow
def test_joints_have_frequencies_of_their_own() -> None:
    found = excite("de_luca_siciliano", seconds=20.0, rate=50.0, drawn=1)
    assert found.deflection <= 0.15 and (np.abs(found.torques).max(axis=0) <= [0.5, 0.15]).all()
    again = excite("de_luca_siciliano", seconds=20.0, rate=50.0, drawn=1)
    assert np.array_equal(found.torques, again.torques)
    ties = np.corrcoef(found.torques.T)[0, 1]
    assert abs(ties) < 0.95 and np.linalg.matrix_rank(found.torques, tol=1e-2) == 2


def test_what_cannot_be_is_a_sentence() -> None:
    free = dataclasses.replace(STRIP, torque_limits=None)
    refuses("most_torque = None: must be given: the arm has no torque limits", lambda: excite(free))
    refuses(r"seconds = 0.1: must be above .* s", lambda: excite(STRIP, seconds=0.1))
    refuses("most_angle = 4.0", lambda: excite(STRIP, most_angle=4.0))
    refuses("spread = 0.5", lambda: excite(STRIP, spread=0.5))


def test_a_served_arm_is_excited_as_designed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the command line, over UDP; the log has the file's torques, to what float32 actions leave of them."""
    file = tmp_path / "excite.csv"
    words = ["--seconds", "2", "--rate", "100", "--modes", "1", "--drawn", "1", "--most-angle", "0.2", "--seed", "3"]
    assert main(["excite", "strip", *words, "--out", str(file)]) == 0
    assert "modes_hz: 3.5" in capsys.readouterr().out
    env = gym.make("FlexibleArm-v0", control_dt=0.01, duration=1e6, initial_vibration=0.0)
    with served(Server(Session(env, Limits(watchdog=100), seed=1), log=tmp_path / "log.csv")) as (host, port):
        assert main(["run", str(file), "--to", f"{host}:{port}", "--most-angle", "9"]) == 0
        assert "ended: time" in capsys.readouterr().out
        assert main(["run", str(file), "--to", f"{host}:{port}", "--most-angle", "0.001"]) == 4
        assert "ended: angle" in capsys.readouterr().out
        wrong = tmp_path / "wrong.csv"
        for text, says in (
            ("t,torque1\n0,0\n0.01,0\n", "must have the columns t, torque0"),
            ("t,torque0\n0,0\n0.02,0\n0.04,0\n", "must be evenly spaced by the arm's 0.01 s"),
            ("t,torque0\n0,0\n0.01,9\n", "must be finite torques within"),
            ("t,torque0\n0,0\n0.01,nan\n", "must be finite torques within"),
            ("t,torque0\n0,0\n0.01,x\n", "must be a number"),
        ):
            wrong.write_text(text)
            assert says in refused(capsys, "run", str(wrong), "--to", f"{host}:{port}")
    header, lines = csv_lines(tmp_path / "log.csv")
    acted = np.unique([float(line[header.index("torque0")]) for line in lines])
    asked = np.append(Played(file, 0.01, np.array([2.0])).torques[:, 0], 0.0)
    assert np.isin(acted, asked).all() and len(acted) > 0.1 * len(asked)  # a busy machine loses many
