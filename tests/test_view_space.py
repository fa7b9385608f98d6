"""The player's page of arms in space, without a browser: what is in it, and what goes into it."""

from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Scene, named, simulate
from flexarm_env.geometry.ribbons import ribbons
from flexarm_env.recording import EpisodeRecorder, load_episodes, save_episodes
from flexarm_env.scene import PointLoad
from flexarm_env.shapes import Cylinder, HalfSpace
from flexarm_env.time_functions import constant
from flexarm_env.view import Player, SpaceClip
from tests.test_view import allows_its_own_script_alone, data, numbers


@cache
def run() -> Any:
    return simulate(named("three_dof_slew"), duration=0.2, estimate_error=False)


def test_the_page_holds_the_run_and_three_js_and_allows_nothing_else() -> None:
    own, text = run(), run().view().html
    assert allows_its_own_script_alone(text) and text.count("</script>") == 2
    assert "three.js r187, MIT License" in text and len(text) < 2_900_000
    clip = data(text)["clips"][0]
    points, N = numbers(clip["points"]) + numbers(clip["root"])[:, None], own.scene.arm.n_links
    assert np.abs(points[:, -1] - own.tip).max() < 1e-6 and len(clip["cuts"]) == N + 1
    assert np.abs(numbers(clip["across"]) - ribbons(own.scene.arm, own.settings, own.q, 4).across).max() < 4e-5
    rigid = numbers(clip["rigid"])
    assert np.linalg.norm(np.diff(rigid, axis=1), axis=2) == pytest.approx(np.tile([0.15, 0.5, 0.5], (len(own.t), 1)))
    hub = clip["pulls"][0]
    assert hub["name"] == "hub torque" and hub["most"] == 20.0
    assert numbers(hub["axis"]) == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(own.t), 1)), abs=1e-6)
    assert np.abs(numbers(hub["values"]) - own.joint_torque[:, 0]).max() < 1e-3
    titles = [chart["title"] for chart in clip["charts"]]
    assert titles[:2] == ["tip deflection / length, along y and z", "twist (degrees)"]


def test_pages_of_the_plane_have_none_of_it_and_do_not_mix() -> None:
    plane = simulate(named("two_link_motion"), duration=0.1, estimate_error=False)
    assert "three.js" not in plane.view().html and len(plane.view().html) < 300_000
    with pytest.raises(ValueError, match="must all be of the plane, or all of space"):
        run().view(plane)
    longer = Player([run().clip("a"), run().clip("b")], most_bytes=665_000)
    assert len(longer.html) < 665_000 and "one instant of" in data(longer.html)["clips"][0]["note"]


@pytest.mark.slow
def test_forces_torques_and_a_free_root() -> None:
    arm = named("flying_frame").arm
    loads = (PointLoad(1, "tip", constant(1.0), force_z=constant(-2.0), torque_x=constant(0.5)),)
    scene = Scene("pushed", arm, duration=0.02, dt=0.005, root="free", loads=loads)
    clip = simulate(scene, estimate_error=False).clip()
    assert isinstance(clip, SpaceClip) and clip.rigid is None and not clip.pinned and clip.payload
    force, torque = clip.pulls
    assert force.point == clip.cuts[2] - 1 and force.values[0].tolist() == [1.0, 0.0, -2.0] and force.axis is None
    assert torque.values[0] == 0.5 and torque.axis is not None and torque.axis[0].tolist() == [1.0, 0.0, 0.0]


@pytest.mark.slow
def test_an_episode_with_walls_is_recorded_and_shown(tmp_path: Path) -> None:
    walls = [HalfSpace((-0.5, 0.0, 0.0), (1.0, 0.0, 0.0)), Cylinder((0.4, 0.4, 0.0), (0.4, 0.4, 0.6), 0.08)]
    env = EpisodeRecorder(gym.make("SpatialFlexArm-v0", duration=0.05, elements=1, dt=0.005, keep_out=walls))
    env.reset(seed=2)
    for _ in range(5):
        env.step(np.array([0.2, -0.1, 0.1], np.float32))
    env.close()
    (again,) = load_episodes(save_episodes(tmp_path / "e.npz", env.episodes))
    clip = again.clip()
    assert isinstance(clip, SpaceClip) and len(clip.t) == 6 and len(clip.walls) == 27
    assert np.linalg.norm(clip.points[:, -1] - again.infos["tip_position"], axis=1).max() < 1e-12
    for face in clip.walls:
        assert min(np.abs(wall.distance(face)).max() for wall in walls) < 1e-12
    packed = numbers(data(again.view().html)["clips"][0]["walls"])
    assert packed.shape[1:] == (3, 3)
