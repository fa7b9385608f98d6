"""Work without bound is refused with a sentence, and what takes long hears Ctrl-C."""

import dataclasses
import signal
import subprocess
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import JointTorque, Settings, named, simulate, simulation
from flexarm_env.time_functions import steps
from tests.env_tools import IDS
from tests.refusals import refuses


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dt": 1e-320}, r"dt = .*: must be at least 9e-09 s: a run of 9 s may take 1e\+09 steps"),
        ({"dt": 1e-12}, r"dt = 1e-12: must be at least"),
        ({"sample": 1e-9}, r"sample = 1e-09: must be at least 9e-06 s: a run of 9 s may have 1e\+06 samples"),
        ({"sample": 1e-320}, "sample = "),
        ({"duration": 1e29}, "dt = "),
        ({"duration": 1e308}, r"duration = 1e\+308: must be at most 1e\+30 in size \(s\)"),
    ],
)
def test_a_run_has_limits(options: dict[str, Any], words: str) -> None:
    refuses(words, lambda: simulate(named("robot_arm_motion"), **options))


def test_a_mesh_has_limits() -> None:
    for name, formulation in (("elements", "geometrically_exact"), ("segments", "floating_frame")):
        with pytest.raises(ValueError, match=f"{name} = 1000000: must be a whole number, from 1 to 1000"):
            Settings.make(formulation, **{name: 10**6})
    refuses("must be at most 1000 elements a link", lambda: Settings.make("floating_frame", segments=100, elements=20))
    refuses("elements = 33: must be at most 32 a segment", lambda: Settings.make("floating_frame", elements=33))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": 1e-320}, "dt = .*: must be at least 2e-06 s, 10000 steps in a control period of 0.02 s"),
        ({"dt": 1e-12}, "dt = 1e-12: must be at least"),
        ({"control_dt": 1e-320}, "duration = .*: must be at most"),
        ({"control_dt": 1e6, "duration": 1e6}, "control_dt = .*: must be at most 10000 steps"),
        ({"duration": 1e29}, "duration = 1e\\+29: must be at most 1e\\+09 control periods of 0.02 s"),
        ({"sensors": {"delay": 1e29}}, "sensors.delay = 1e\\+29: must be at most 1000"),
        ({"actuator": {"delay": 1e29}}, "actuator.delay = 1e\\+29: must be at most 1000"),
    ],
)
def test_an_environment_has_limits(arguments: dict[str, Any], words: str) -> None:
    for make in (gym.make, gym.make_vec):
        with pytest.raises(ValueError, match=words):
            make("FlexibleArm-v0", **arguments)


@pytest.mark.parametrize("env_id", IDS)
def test_a_start_is_where_angles_can_be_told_apart(env_id: str) -> None:
    env = gym.make(env_id, joint_limits=None)
    joints = env.action_space.shape[0]
    for wrong in (1e18, -1e18, float("nan"), float("inf")):
        for options in [{"start": [wrong] * joints}] + ([{"target": wrong}] if joints == 1 else []):
            with pytest.raises(ValueError, match=r"options\.\w+.* = .*: must be a finite number, at least -1e\+06"):
                env.reset(seed=0, options=options)
    for angle in (1e6, -1e6):
        observation, _ = env.reset(seed=0, options={"start": [angle] * joints})
        assert env.observation_space.contains(observation)
        assert observation[0] ** 2 + observation[1] ** 2 == pytest.approx(1.0, abs=1e-6)
        assert observation[0] == pytest.approx(np.sin(angle), abs=1e-6)
    if joints == 1:
        with pytest.raises(ValueError, match=r"options\.motion: joint0 at t = 0 = 1e"):
            env.reset(options={"motion": {"t": [0.0, 1.0], "psi": [1e18, 1e18]}})


def test_returns_from_compiled_code_change_no_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stretch between two samples is gone through in the same steps, however often it is left and entered."""
    scene, options = named("robot_arm_motion"), {"dt": 2e-4, "duration": 1.0, "sample": 0.7, "estimate_error": False}
    runs = []
    for chunks in (1, 3, 10**6):
        monkeypatch.setattr(simulation, "CHUNKS", chunks)
        runs.append(simulate(scene, "elastica", **options))
    for run in runs[1:]:
        for name in ("t", "q", "v", "kinetic", "work", "dissipated", "shapes"):
            np.testing.assert_array_equal(getattr(run, name), getattr(runs[0], name))
        assert (run.steps, run.gross_work) == (runs[0].steps, runs[0].gross_work)
    assert runs[0].steps >= 5000


def test_samples_near_each_other_cost_few_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many samples of few steps are made by a handful of calls: the budget of a call counts steps."""
    calls: list[int] = []
    sample_rows = simulation.sample_rows
    monkeypatch.setattr(simulation, "sample_rows", lambda *arguments: calls.append(1) or sample_rows(*arguments))
    run = simulate(named("robot_arm_motion"), "elastica", dt=0.05, sample=0.05, estimate_error=False)
    assert len(run.t) == 181
    assert len(calls) <= 8


def test_kinks_are_gone_through_without_a_return(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run through kinks, on samples and between them, is what stopping at each of them by hand gives."""
    load = JointTorque(0, steps([0.5, 0.65, 0.8, 1.0, 1.31], [0.2, -0.2, 0.1, 0.0, 0.2]))
    scene = dataclasses.replace(named("robot_arm_torque"), loads=(load,))
    calls: list[int] = []
    sample_rows = simulation.sample_rows
    monkeypatch.setattr(simulation, "sample_rows", lambda *arguments: calls.append(1) or sample_rows(*arguments))
    run = simulate(scene, "elastica", dt=0.05, duration=1.5, sample=0.1, estimate_error=False)
    assert run.finished and len(scene.kinks) == 5
    assert len(calls) <= 4
    by_hand = simulation.Simulation(scene, scene.settings("elastica", dt=0.05))
    states = [by_hand.work.q.copy()]
    for stop in sorted({*run.t[1:].tolist(), 0.65, 1.31}):
        by_hand.restart_at_kink()
        assert by_hand.advance_to(stop)
        if stop in run.t:
            states.append(by_hand.work.q.copy())
    np.testing.assert_array_equal(run.q, states)
    assert run.gross_work == by_hand.gross


LONG = """
import signal
from flexarm_env import named, simulate
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has those in the background ignore it
scene = named("robot_arm_motion")
simulate(scene, "elastica", duration=1e-3, estimate_error=False)
print("go", flush=True)
simulate(scene, "elastica", dt=5e-8, sample=20.0, estimate_error=False)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_long_run_hears_an_interruption() -> None:
    """Minutes of compiled steps between two samples."""
    with subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        try:
            assert child.stdout is not None and child.stdout.readline() == "go\n"
            time.sleep(1.5)
            child.send_signal(signal.SIGINT)
            _, errors = child.communicate(timeout=60)  # the whole run would take several minutes
            assert "KeyboardInterrupt" in errors
        finally:
            child.kill()
