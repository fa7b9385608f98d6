"""Pictures: what is to be seen is there, where it belongs, without a display and without being asked twice."""

import copy
import logging
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("pygame")

import pygame

from flexarm_env.envs import drawing, rendering
from flexarm_env.envs.rendering import Renderer, rigid_arm
from tests.processes import python
from tests.refusals import refuses

Picture = NDArray[np.uint8]


def arm(*angles: float, bend: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> tuple[list[Any], Any]:
    """Links of length 1 / N, root tangents at these absolute angles, each bent by `bend` rad: points, and angles (N, 2)
    at roots and tips."""
    length, points, start = 1.0 / len(angles), list[Any](), np.array(at)
    for angle in angles:
        turn = angle + bend * np.linspace(0.0, 1.0, 11)
        middle = 0.5 * (turn[1:] + turn[:-1])
        steps = 0.1 * length * np.column_stack([np.cos(middle), np.sin(middle)])
        points.append(np.vstack([start, start + np.cumsum(steps, axis=0)]))
        start = points[-1][-1]
    return points, np.array(angles)[:, None] + [0.0, bend]


def draw(renderer: Renderer, *angles: float, **more: Any) -> Picture:
    points, turned = arm(*angles, bend=more.pop("bend", 0.0), at=more.pop("at", (0.0, 0.0)))
    picture = renderer.frame(points, turned, more.pop("target", None), more.pop("time", 0.0), **more)
    assert picture is not None
    return picture


def near(picture: Picture, x: float, y: float, center: tuple[float, float] = (0.0, 0.0)) -> Picture:
    """The pixel at a point in m (reach 1)."""
    height, width, _ = picture.shape
    scale = min(width, height) / (2.0 * rendering.MARGIN)
    pixel: Picture = picture[round(height / 2 - (y - center[1]) * scale), round(width / 2 + (x - center[0]) * scale)]
    return pixel


def has(picture: Picture, color: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - color).max(axis=-1) <= 3).any())


# -------------------------------------------------------------------- pictures
@pytest.mark.parametrize("angles", [(0.4,), (0.4, 1.5), (0.1, 0.5, -0.9, 0.3)])
@pytest.mark.parametrize("size", [(640, 640), (320, 240)])
def test_a_picture(angles: tuple[float, ...], size: tuple[int, int]) -> None:
    n = len(angles)
    picture = draw(
        Renderer("rgb_array", 1.0, size), *angles, bend=0.5, target=(-0.5, 0.5), time=1.25,
        torques=np.full(n, 0.5), deflection=np.full(n, -0.1),
    )  # fmt: skip
    assert picture.shape == (size[1], size[0], 3) and picture.dtype == np.uint8
    assert picture.flags.c_contiguous and picture.flags.writeable
    for color in (rendering.PAYLOAD, rendering.TORQUE, rendering.DEFLECTION, drawing.PAPER):
        assert has(picture, color), color
    assert np.abs(near(picture, -0.5, 0.5).astype(int) - rendering.TARGET).max() < 90
    assert np.median(picture) > 230  # a light sheet, little ink


def test_the_link_is_where_it_is() -> None:
    renderer = Renderer("rgb_array", 1.0)
    points, turned = arm(0.5, bend=1.2)
    picture = renderer.frame(points, turned, None, 0.0)
    assert picture is not None
    for point in points[0][2:-1]:
        assert near(picture, *point)[2] > near(picture, *point)[0] + 40, "blue along the bent link"
    payload = drawing.blend(rendering.PAYLOAD, rendering.WHITE, 0.55)
    np.testing.assert_allclose(near(picture, *points[0][-1]), payload, atol=3)
    ghost = 0.9 * np.array([np.cos(0.5), np.sin(0.5)])
    np.testing.assert_allclose(near(picture, *ghost), rendering.GHOST, atol=3)


def test_small_and_absent_things() -> None:
    bare = Renderer("rgb_array", 1.0, hub=False, payload=False)
    picture = draw(bare, 0.0)
    for color in (rendering.PAYLOAD, rendering.TORQUE, rendering.DEFLECTION, rendering.TARGET, rendering.STEEL):
        assert not has(picture, color)
    full = draw(bare, 0.0, time=1.0, torques=[0.0], deflection=[1e-4])
    assert not has(full, rendering.DEFLECTION) and not has(full, rendering.TORQUE)
    beyond = draw(bare, 0.0, time=2.0, torques=[-7.0], deflection=[3.0])
    assert has(beyond, rendering.DEFLECTION) and has(beyond, rendering.TORQUE)
    draw(bare, 0.0, time=3.0, torques=[np.nan], deflection=[np.nan])


def test_a_broken_state_is_told_and_not_drawn() -> None:
    renderer = Renderer("rgb_array", 1.0)
    points, turned = arm(0.3)
    points[0][4, 1] = np.nan
    picture = renderer.frame(points, turned, (0.5, 0.5), 0.0, [0.1], [np.nan])
    assert picture is not None and has(picture, rendering.DEFLECTION) and not has(picture, rendering.PAYLOAD)
    huge, turned = arm(0.3, at=(1e12, -1e12))
    assert renderer.frame(huge, turned, (0.5, 0.5), 0.1) is not None


def test_the_view_follows_a_root_that_leaves() -> None:
    renderer = Renderer("rgb_array", 1.0, hub=False)
    draw(renderer, 0.0)
    assert renderer._center.tolist() == [0.0, 0.0]
    draw(renderer, 0.0, at=(4.0, 0.0), time=1.0)
    assert renderer._center[0] == pytest.approx(5.0 - 0.94 * rendering.MARGIN) and renderer._center[1] == 0.0
    draw(renderer, 0.0, time=0.0)
    assert renderer._center.tolist() == [0.0, 0.0]


def test_the_trace_belongs_to_one_episode() -> None:
    renderer = Renderer("rgb_array", 1.0)
    for k in range(100):
        draw(renderer, 0.02 * k, time=0.02 * k) if k % 20 == 0 else renderer._trace.append(np.zeros(2))
    assert len(renderer._trace) == rendering.TRACE
    before = draw(renderer, 2.0, time=3.0)
    np.testing.assert_array_equal(draw(renderer, 2.0, time=3.0), before)
    fresh = draw(renderer, 2.0, time=0.0)
    assert len(renderer._trace) == 1
    assert not np.array_equal(fresh[60:560], before[60:560])
    np.testing.assert_array_equal(fresh, draw(Renderer("rgb_array", 1.0), 2.0))


def test_copies_draw_alike() -> None:
    renderer = Renderer("rgb_array", 1.0)
    draw(renderer, 0.0, time=0.0)
    again: list[Renderer] = [copy.deepcopy(renderer), pickle.loads(pickle.dumps(renderer))]
    expected = draw(renderer, 0.4, time=0.1)
    for other in again:
        np.testing.assert_array_equal(draw(other, 0.4, time=0.1), expected)


@pytest.mark.parametrize(
    ("mode", "reach", "words"),
    [("ascii", 1.0, "render_mode = 'ascii': must be one of human, rgb_array"), ("human", 0.0, "reach = 0.0: must be")],
)
def test_wrong_arguments(mode: str, reach: float, words: str) -> None:
    refuses(words, lambda: Renderer(mode, reach))


# -------------------------------------------------------------------- geometry
def test_the_rigid_arm() -> None:
    points, turned = arm(0.3, 1.0, bend=0.4)
    first, second = rigid_arm(points, turned)
    np.testing.assert_allclose(first[1], 0.5 * np.array([np.cos(0.3), np.sin(0.3)]), atol=1e-12)
    np.testing.assert_array_equal(second[0], first[1])
    # the elbow's angle is from link 1's tip, 0.7, to link 2's root, 1.0: the rigid second link points along 0.6
    np.testing.assert_allclose(second[1] - second[0], 0.5 * np.array([np.cos(0.6), np.sin(0.6)]), atol=1e-12)


def test_the_smooth_line() -> None:
    angle = np.linspace(0.0, 1.0, 5)
    circle = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    line = drawing.smooth(circle, 0.0, 1.0)
    np.testing.assert_array_equal(line[::6], circle)
    np.testing.assert_allclose(np.hypot(line[:, 0], line[:, 1] - 1.0), 1.0, atol=2e-3)
    assert drawing.smooth(circle[:1], 0.0, 0.0).shape == (2, 2)


def test_ribbon_and_steps() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 5), np.zeros(5)])
    outline = drawing.ribbon(line, np.linspace(2.0, 1.0, 5))
    np.testing.assert_allclose(outline[:5, 1], np.linspace(1.0, 0.5, 5))
    np.testing.assert_allclose(outline[5:, 1], -np.linspace(0.5, 1.0, 5))
    assert [drawing.round_step(x) for x in (1.0, 3.3, 0.5, 0.333, 9.99)] == [1.0, 2.0, 0.5, 0.2, 5.0]


# ---------------------------------------------------------------------- window
def test_no_display_is_said_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    points, turned = arm(0.1)
    renderer = Renderer("human", 1.0)
    with caplog.at_level(logging.WARNING):
        assert renderer.frame(points, turned, None, 0.0) is None
        assert renderer.frame(points, turned, None, 0.1) is None
    assert [record.message.startswith("render_mode 'human' shows nothing") for record in caplog.records] == [True]
    assert not pygame.display.get_init()
    renderer.close()


def test_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """With SDL's dummy driver in place of a display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "a display")
    points, turned = arm(0.1)
    renderer = Renderer("human", 1.0, (200, 150), fps=1000)
    assert not pygame.display.get_init(), "no window before the first picture"
    assert renderer.frame(points, turned, None, 0.0) is None
    shown = drawing.array_of(pygame.display.get_surface())
    np.testing.assert_array_equal(shown, draw(Renderer("rgb_array", 1.0, (200, 150)), 0.1))
    assert pickle.loads(pickle.dumps(renderer))._window is None

    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert renderer.frame(points, turned, None, 0.1) is None
    assert renderer.closed and not pygame.display.get_init()
    assert renderer.frame(points, turned, None, 0.2) is None
    renderer.close()


def test_pixels_need_no_display_and_leave_sdl_alone() -> None:
    code = """
import os, sys
for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
    os.environ.pop(name, None)
import numpy as np
from flexarm_env.envs.rendering import Renderer
assert "pygame" not in sys.modules
r = Renderer("rgb_array", 1.0)
import pygame
points = np.array([[0.0, 0.0], [1.0, 0.0]])
assert r.frame([points], np.zeros((1, 2)), None, 0.0).shape == (640, 640, 3)
assert not pygame.display.get_init() and "SDL_VIDEODRIVER" not in os.environ
"""
    python("-c", code)


def test_missing_pygame_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from gymnasium.error import DependencyNotInstalled

    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match="rendering needs pygame-ce: pip install pygame-ce"):
        Renderer("rgb_array", 1.0)


# ------------------------------------------------------------------------ film
def moving(count: int = 6) -> list[Picture]:
    renderer = Renderer("rgb_array", 1.0, (160, 120))
    return [draw(renderer, 0.1 * k, time=0.1 * k, deflection=[0.1]) for k in range(count)]


@pytest.mark.parametrize("ending", [".mp4", ".webm", ".gif"])
def test_films(ending: str, tmp_path: Path) -> None:
    from flexarm_env.envs.video import write_film

    imageio = pytest.importorskip("imageio.v2")
    frames = moving()
    path = write_film(tmp_path / "new" / f"film{ending}", frames, fps=10)
    read = [np.asarray(frame)[..., :3] for frame in imageio.get_reader(path)]
    assert len(read) == len(frames)
    for mine, seen in zip(frames, read, strict=True):
        assert seen.shape == mine.shape
        assert np.abs(mine.astype(int) - seen).mean() < 6.0
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_film_is_whole_or_absent(tmp_path: Path) -> None:
    from flexarm_env.envs.video import write_film

    refuses(r"must end with one of \.mp4", lambda: write_film(tmp_path / "film.txt", moving(1)))
    refuses("fps = 0.0: must be a finite number, at least", lambda: write_film(tmp_path / "film.mp4", moving(1), 0.0))
    refuses("fps = 0.002: must be at least 0.003", lambda: write_film(tmp_path / "film.gif", moving(2), 0.002))
    refuses("must hold one picture or more", lambda: write_film(tmp_path / "film.mp4", []))
    (tmp_path / "film.gif").write_text("old")

    def broken() -> Any:
        yield from moving(2)
        raise RuntimeError("the run broke")

    refuses("the run broke", lambda: write_film(tmp_path / "film.gif", broken()), RuntimeError)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("film.gif", "old")]


def test_pictures_of_a_run() -> None:
    from flexarm_env.envs.video import pictures
    from flexarm_env.scenes import named
    from flexarm_env.simulation import simulate

    run = simulate(named("two_link_motion"), duration=0.4, sample=0.02)
    film = list(pictures(run, fps=25, speed=0.5, size=(160, 160)))
    assert len(film) == 21 and all(frame.shape == (160, 160, 3) for frame in film)
    assert len(list(pictures(run, fps=25, speed=2.0, size=(160, 160)))) == 6
    refuses("speed = 0: must be a positive number", lambda: next(pictures(run, speed=0)))


def test_bars_keep_their_scale_and_hold_what_they_say() -> None:
    """The scale used to jump within a film, and the bar of a torque beyond its limit ended at 100 %."""
    low, high = Renderer("rgb_array", 1.0, deflection=0.5, torque=2.0), Renderer("rgb_array", 1.0)
    assert low.ends == (0.5, 2.0) and high.ends == (0.2, 1.0)
    widths = []
    for value in (0.1, 0.2, 0.4):
        picture = draw(low, 0.0, time=value, deflection=[value], torques=[4.0 * value])
        widths.append([(np.abs(picture.astype(int) - color).max(axis=-1) <= 3).any(axis=0).sum()
                       for color in (rendering.DEFLECTION, rendering.TORQUE)])  # fmt: skip
    for first, second, third in zip(*widths, strict=True):
        assert abs(second - 2 * first) <= 2 and abs(third - 4 * first) <= 3
    inside = draw(high, 0.0, time=1.0, torques=[1.0])
    beyond = draw(high, 0.0, time=1.0, torques=[1.66])
    assert has(inside, rendering.TORQUE) and not np.array_equal(inside[590:, :580], beyond[590:, :580])
    assert [rendering.end_of_scale(x) for x in (0.0, 0.1, 0.11, 1.66, 80.0)] == [0.1, 0.1, 0.2, 2.0, 50.0]


def test_the_ghost_is_named() -> None:
    picture = draw(Renderer("rgb_array", 1.0), 2.5)
    assert has(picture[40:60, :45], rendering.GHOST), "a sign of it beside its name"
    assert (picture[40:60, 46:220] < 200).any(), "and the name"


def test_no_display_is_no_business_of_sdl(tmp_path: Path) -> None:
    """Its libraries used to print what they missed, before the package said that there is no display."""
    code = """
import os
for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "XDG_RUNTIME_DIR"):
    os.environ.pop(name, None)
import numpy as np
from flexarm_env.envs.rendering import Renderer
assert Renderer("human", 1.0).frame([np.array([[0.0, 0.0], [1.0, 0.0]])], np.zeros((1, 2)), None, 0.0) is None
"""
    done = python("-c", code)
    assert done.stderr.startswith("render_mode 'human' shows nothing here") and done.stderr.count("\n") == 1


CROWDED = """
import resource, sys
import numpy as np
from flexarm_env.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))  # as a disk that is full soon
sys.exit(main(["play", "--policy", "pd", "--env-kwargs", '{"duration": 0.2}', "--video", sys.argv[1]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".mp4", ".gif"])
def test_a_film_that_finds_no_room_is_a_sentence(ending: str, tmp_path: Path) -> None:
    """What ffmpeg could not write it does not say: half a film used to be left, as if it were one."""
    pytest.importorskip("resource")
    pytest.importorskip("imageio_ffmpeg")
    film = tmp_path / f"film{ending}"
    done = python("-c", CROWDED, film, code=2)
    told = [line for line in done.stderr.splitlines() if line.startswith("flexarm play")]
    said = [line for line in told if not line.startswith("flexarm play: warning: ")]  # the cache finds no room either
    assert len(said) == 1 and said[0].startswith(f"flexarm play: {film}: the film could not be written: ")
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
