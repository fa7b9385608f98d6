"""Files written by an earlier package load: arms, scenes, trajectories, episodes, and a folder of a trained policy.

`written_before` holds small ones, written by version 0.2 before the names of the solver changed. A format that can no
longer be read must be refused with a sentence that says what to do, and its file is then replaced here.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import Scene, arms, control, simulate
from flexarm_env.recording import load_episodes, replay
from flexarm_env.training.runs import load_model, read_run
from flexarm_env.trajectory import Trajectory

MESH = {"elastica": {"nodes": 3}, "geometrically_exact": {"elements": 1}}
FILES = Path(__file__).parent / "written_before"
GEARED = arms.named("strip_geared")
LOOSE = dataclasses.replace(GEARED, joints=(dataclasses.replace(GEARED.joints[0], backlash=0.01),))


def test_arms() -> None:
    assert arms.from_toml(FILES / "arm.toml") == LOOSE
    assert arms.from_toml(FILES / "spatial_arm.toml") == arms.named("three_dof_loaded")


def test_a_scene() -> None:
    scene = Scene.from_toml(FILES / "scene.toml")
    assert scene.name == "pushed" and scene.arm == LOOSE and len(scene.loads) == 2
    assert Scene.from_toml(scene.to_toml()) == scene


@pytest.mark.parametrize("name", ["trajectory", "spatial_trajectory"])
def test_trajectories(name: str) -> None:
    run = Trajectory.from_npz(FILES / f"{name}.npz")
    assert run.finished and np.isfinite(run.tip).all() and len(run.t) == 3
    assert run.scene.arm == (LOOSE if name == "trajectory" else arms.named("three_dof"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["trajectory", "spatial_trajectory"])
def test_a_trajectorys_scene_and_settings_give_its_motion_again(name: str) -> None:
    run = Trajectory.from_npz(FILES / f"{name}.npz")
    again = simulate(run.scene, run.settings.formulation, estimate_error=False, **MESH[run.settings.formulation])
    np.testing.assert_allclose(again.tip, run.tip, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_episodes() -> None:
    (episode,) = load_episodes(FILES / "episodes.npz")
    assert len(episode) == 3 and episode.env_id == "FlexibleArm-v0"
    again = replay(episode)
    np.testing.assert_allclose(again.observations, episode.observations, rtol=0.0, atol=1e-5)


def test_a_run_folder_and_its_policy() -> None:
    record = read_run(FILES / "run")
    assert record["algorithm"] == "ppo" and record["env_id"] == "FlexibleArm-v0" and record["finished"]
    with np.load(FILES / "run" / "policy.npz") as arrays:
        assert json.loads(str(arrays["meta"]))["layout"] == record["layout"]
    policy = control.load_policy(FILES / "run" / "policy.npz")
    assert policy.act(np.zeros((2, 6), np.float32)).shape == (2, 1)


def test_the_model_of_a_run_folder_acts_as_its_policy() -> None:
    pytest.importorskip("stable_baselines3")
    model, normaliser = load_model(FILES / "run", "ppo")
    assert normaliser is None
    seen = np.linspace(-1.0, 1.0, 60, dtype=np.float32).reshape(10, 6)
    policy = control.load_policy(FILES / "run" / "policy.npz")
    np.testing.assert_allclose(policy.act(seen), model.predict(seen, deterministic=True)[0], atol=1e-5)
