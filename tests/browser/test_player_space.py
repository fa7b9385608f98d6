"""The player of arms in space in a real browser: where the arm is, how it is turned and followed, its look."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexarm_env import named, simulate
from tests.browser.chrome import Page
from tests.browser.test_player import BLINK


@cache
def run(name: str) -> Any:
    """An arm on the ground; one that flies."""
    return simulate(named(name), sample=0.01 if name == "three_dof_slew" else None, estimate_error=False)


def pose(page: Page) -> np.ndarray[Any, Any]:
    return np.array(page.run("Array.from(flexarm.pose())")).reshape(-1, 3)


def camera(page: Page) -> np.ndarray[Any, Any]:
    return np.array(page.run("flexarm.camera()"))


@pytest.mark.parametrize("name", ["three_dof_slew", "flying_frame"])
def test_the_slider_moves_the_arm_to_the_runs_own_poses(page: Page, tmp_path: Path, name: str) -> None:
    own = run(name)
    page.open(own.view().save(tmp_path / "run.html"))
    assert page.run("flexarm.instants") == len(own.t)
    for i in np.linspace(0, len(own.t) - 1, 8).round().astype(int):
        page.set("#time", int(i))
        points = pose(page)
        assert np.abs(points[[0, -1]] - [own.start[i], own.tip[i]]).max() < 1e-5
        for hinge in own.hinges[i]:
            assert np.linalg.norm(points - hinge, axis=1).min() < 1e-5
    said = page.run("document.querySelector('#stage').getAttribute('aria-label')")
    assert "tip at x" in said and ", z " in said


def test_it_is_turned_seen_from_sides_and_followed(page: Page, tmp_path: Path) -> None:
    own = run("three_dof_slew")
    page.open(own.view().save(tmp_path / "run.html"))
    corner = camera(page)
    page.drag("#stage", (0.3, 0.5), (0.7, 0.5))
    turned = camera(page)
    assert np.linalg.norm(turned - corner) > 0.3 and not page.run("flexarm.now().playing")
    page.click("#stage")
    assert page.run("flexarm.now().playing")
    page.press(" ", "Space")
    page.press("4", "Digit4")
    aim = np.array(page.run("flexarm.aim()"))
    assert np.hypot(*(camera(page) - aim)[:2]) < 0.05 * (camera(page) - aim)[2], "from above"
    page.press("1", "Digit1")
    assert camera(page) == pytest.approx(corner, abs=1e-6)
    page.press("c", "KeyC")
    page.set("#time", 10)
    before = camera(page)
    page.set("#time", 30)
    assert camera(page) - before == pytest.approx(own.tip[30] - own.tip[10], abs=1e-5)


def test_a_finger_turns_it(page: Page, tmp_path: Path) -> None:
    page.open(run("three_dof_slew").view().save(tmp_path / "run.html"), 360, 740, 2.0)
    before = camera(page)
    page.drag("#stage", (0.3, 0.5), (0.7, 0.5), touch=True)
    assert np.linalg.norm(camera(page) - before) > 0.3


@pytest.mark.parametrize("size", list(BLINK))
def test_it_fits_and_shows_the_arm(page: Page, tmp_path: Path, pictures: Path, size: str) -> None:
    """No sideways scrolling; colours on the stage that differ. The pictures are to be looked at."""
    width, height, scale, dark = BLINK[size]
    own = run("three_dof_slew")
    page.open(own.view(own, labels=["one", "again"]).save(tmp_path / "run.html"), width, height, scale, dark)
    page.set("#time", 20)
    assert page.run("document.documentElement.scrollWidth") <= width
    page.press("s", "KeyS")
    colors = page.run("""new Promise((done) => requestAnimationFrame(() => {
      drawStage();
      const copy = document.createElement('canvas'), c = document.querySelector('#stage');
      [copy.width, copy.height] = [c.width, c.height];
      const pen = copy.getContext('2d');
      pen.drawImage(c, 0, 0);
      const d = pen.getImageData(0, 0, c.width, c.height).data, seen = new Set();
      for (let i = 0; i < d.length; i += 4) seen.add((d[i] << 16) | (d[i + 1] << 8) | d[i + 2]);
      done(seen.size); }))""")
    assert colors > 200
    page.picture(pictures / f"space_{size}.png")
