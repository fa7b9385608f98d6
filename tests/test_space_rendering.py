"""Pictures of arms in space: what is to be seen is where it belongs."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo
from numpy.typing import NDArray

import flexarm_env as fx
from flexarm_env import scenes
from flexarm_env.geometry.ribbons import ribbons, sides
from flexarm_env.physics.space.reading import links

pytest.importorskip("pygame")

from flexarm_env.envs import rendering
from flexarm_env.envs.drawing import SUPERSAMPLING
from flexarm_env.envs.space_rendering import Camera, SpaceRenderer
from flexarm_env.envs.video import pictures

Picture = NDArray[np.uint8]


def strip(turn: float = 0.0, lift: float = 0.5) -> list[Any]:
    """A straight link along x at a height, its width turned about it."""
    points = np.column_stack([np.linspace(0.0, 1.0, 9), np.zeros(9), np.full(9, lift)])
    return [(points, np.tile([0.0, np.cos(turn), np.sin(turn)], (9, 1)))]


def renderer(**more: Any) -> SpaceRenderer:
    return SpaceRenderer("rgb_array", 1.0, sides=np.array([[0.06, 0.01]]), links=["link 1"], **more)


def near(picture: Picture, pen: SpaceRenderer, point: tuple[float, float, float]) -> NDArray[np.int64]:
    """The pixel at a point in m."""
    x, y = Camera(pen.size, pen.reach, pen._center).see(point)[0] / SUPERSAMPLING
    return picture[round(y), round(x)].astype(int)


def test_a_link_its_shadow_and_its_target_are_where_they_are() -> None:
    pen = renderer(payload=False, hub=False)
    picture = pen.frame_of(strip(), (0.2, -0.6, 0.3), 0.0, [0.5], [0.1])
    assert picture is not None and picture.shape == (640, 640, 3)
    link, shadow = near(picture, pen, (0.5, 0.0, 0.5)), near(picture, pen, (0.5, 0.0, 0.0))
    assert link[2] > link[0] + 40, "blue"
    assert shadow.max() < 232 and np.ptp(shadow) < 16, "grey"
    assert np.abs(near(picture, pen, (0.2, -0.6, 0.3)) - rendering.TARGET).max() < 60
    assert np.median(picture) > 230


def test_twist_is_seen() -> None:
    """Broad and upright a strip hides more than edgewise; and each of its sides has its own light."""
    blue = []
    for turn in (0.0, 0.5 * np.pi):
        picture = renderer(payload=False, hub=False).frame_of(strip(turn), None, 0.0)
        assert picture is not None
        blue.append(((picture[..., 2].astype(int) - picture[..., 0]) > 40).sum())
    assert min(blue) > 500 and max(blue) > 1.3 * min(blue)


def test_what_is_below_the_ground_is_paler() -> None:
    tones = []
    for lift in (0.5, -0.5):
        pen = renderer(payload=False, hub=False)
        picture = pen.frame_of(strip(lift=lift), None, 0.0)
        assert picture is not None
        tones.append(near(picture, pen, (0.5, 0.0, lift)))
    assert tones[1].min() > tones[0].min() + 60


def test_a_broken_state_is_told_and_a_root_that_leaves_is_followed() -> None:
    pen, chain = renderer(), strip()
    chain[0][0][3, 1] = np.nan
    picture = pen.frame_of(chain, (0.5, 0.5, 0.5), 0.0, [0.1], [np.nan])
    assert picture is not None and not (np.abs(picture.astype(int) - rendering.PAYLOAD).max(axis=-1) <= 3).any()
    points, across = strip()[0]
    assert pen.frame_of([(points + [3.0, 0.0, 0.0], across)], None, 0.1) is not None
    assert pen._center[0] == pytest.approx(4.0 - 0.94 * rendering.MARGIN)


def test_ribbons_go_through_the_sections_and_join() -> None:
    """Of a run: nodes are on the line, links meet, width stays square to the line."""
    run = fx.simulate(scenes.named("three_dof_slew"), estimate_error=False, duration=0.2)
    arm = run.scene.arm
    found = ribbons(arm, run.settings, run.q)
    assert np.abs(found.points[:, -1] - run.tip).max() < 1e-12
    for k in range(1, arm.n_links):
        assert np.abs(found.points[:, found.cuts[k]] - run.hinges[:, k - 1]).max() < 1e-12
    last = list(links(arm, run.settings, run.q[-1:], run.v[-1:]))[-1]
    points, across = found.chain(-1)[-1]
    for section in last.sections:
        assert np.linalg.norm(points - section.r[0], axis=1).min() < 1e-12
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    assert np.abs((along * across).sum(axis=1)).max() < 0.02
    assert sides(arm) == pytest.approx(np.array([[0.0, 0.0], [0.05, 0.002], [0.05, 0.002]]))
    drawn = list(pictures(run, fps=20.0, size=(160, 120)))
    assert len(drawn) == 5 and drawn[0].shape == (120, 160, 3) and (drawn[0] != drawn[-1]).any()


@pytest.mark.slow
def test_films_of_an_environment_and_of_a_vector(tmp_path: Path) -> None:
    """Gymnasium's own wrapper, and pictures of all arms."""
    pytest.importorskip("moviepy")
    keywords: dict[str, Any] = {"elements": 1, "dt": 0.005, "duration": 0.05, "render_mode": "rgb_array"}
    env = RecordVideo(gym.make("SpatialFlexArm-v0", **keywords), str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros(3, np.float32))
    env.close()
    assert [path.suffix for path in tmp_path.iterdir() if path.stat().st_size > 1000] == [".mp4"]
    many = gym.make_vec("SpatialFlexArm-v0", num_envs=2, **keywords)
    many.reset(seed=0)
    first, second = many.render()
    single = gym.make("SpatialFlexArm-v0", **keywords)
    single.reset(seed=1)
    assert np.array_equal(single.render(), second) and not np.array_equal(first, second)
