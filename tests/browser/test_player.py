"""The player in a real browser: what it draws, against the run itself; its keys, its charts, its look."""

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Trajectory, arms, named, simulate
from flexarm_env.recording import Episode, EpisodeRecorder
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.time_functions import pulse
from flexarm_env.view import Player, magnified
from tests.browser.chrome import Page

BLINK = {"phone": (360, 740, 2.0, False), "desk": (1280, 800, 1.0, False), "hall": (1920, 1080, 1.0, True)}


@cache
def run(name: str) -> Trajectory:
    """One, two and three links; a reduction to modes; a body that flies."""
    if name == "one link":
        return simulate(named("robot_arm_motion_smooth"), duration=4.0, sample=0.02, estimate_error=False)
    if name == "two links":
        return simulate(named("two_link_motion"), sample=0.01, estimate_error=False)
    if name == "three links":
        arm = arms.named("three_strips")
        loads = tuple(JointTorque(k, pulse(0.2 / (k + 1), 0.5)) for k in range(3))
        scene = Scene("three_strips", arm, duration=2.0, dt=0.005, sample=0.02, loads=loads, angles=(0.2, 0.9, 0.4))
        return simulate(scene, "elastica", estimate_error=False)
    if name == "modes":
        return simulate(named("robot_arm_motion_smooth"), "floating_frame", modes=3, duration=2.0, estimate_error=False)
    return simulate(named("flying_rod"), duration=2.0, estimate_error=False)


@cache
def episode(env_id: str, push: float) -> Episode:
    """Steps under one action."""
    env = EpisodeRecorder(gym.make(env_id, max_episode_steps=60))
    env.reset(seed=4)
    for _ in range(60):
        env.step(np.full(env.action_space.shape, push, np.float32))
    env.close()
    return env.episodes[0]


def pose(page: Page, k: int = 0) -> np.ndarray[Any, Any]:
    return np.array(page.run(f"flexarm.pose({k})")).reshape(-1, 2)


def apart(points: np.ndarray[Any, Any], line: np.ndarray[Any, Any]) -> float:
    """The farthest of points from the nearest point of a run's own."""
    gaps = np.linalg.norm(points[:, None] - line[None], axis=2)
    return float(gaps.min(axis=1).max())


@pytest.mark.parametrize("name", ["one link", "two links", "three links", "modes", "flying"])
def test_the_slider_moves_the_arm_to_the_runs_own_poses(page: Page, tmp_path: Path, name: str) -> None:
    own = run(name)
    length = own.scene.arm.total_length
    page.open(own.view().save(tmp_path / "run.html"))
    assert page.run("flexarm.instants") == len(own.t)
    for i in np.linspace(0, len(own.t) - 1, 20).round().astype(int):
        page.set("#time", int(i))
        now = page.run("flexarm.now()")
        points = pose(page)
        assert abs(now["time"] - own.t[i]) < 1e-12 and now["magnify"] == 1
        assert np.abs(points[[0, -1]] - [own.start[i, :2], own.tip[i, :2]]).max() < 1e-6 * length
        assert apart(points, own.shapes[i]) < 1e-6 * length
        for hinge in own.hinges[i]:
            assert np.linalg.norm(points - hinge, axis=1).min() < 1e-6 * length
        assert f"{own.t[i]:.2f} s" in page.run("document.querySelector('#time').getAttribute('aria-valuetext')")


def test_magnified_deflection_is_the_packages_own_and_the_ghost_is_rigid(page: Page, tmp_path: Path) -> None:
    own = run("two links")
    clip = own.clip()
    page.open(Player([clip]).save(tmp_path / "run.html"))
    i = len(own.t) // 2
    page.set("#time", i)
    for _ in range(4):
        page.press("ArrowUp")
    assert page.run("flexarm.now().magnify") == 5
    expected = magnified(clip.points[i], clip.cuts, clip.angles[i], clip.rigid[i], clip.rest, 5.0)
    assert np.abs(pose(page) - expected).max() < 1e-5
    ghost = np.array(page.run("flexarm.ghost()")).reshape(-1, 2)[list(clip.cuts)]
    assert np.allclose(np.hypot(*np.diff(ghost, axis=0).T), [link.span for link in own.scene.arm.links], atol=1e-6)
    turns = np.diff([0.0, *(np.arctan2(*(b - a)[::-1]) for a, b in pairwise(ghost))])
    assert np.allclose(np.exp(1j * turns), np.exp(1j * own.joint_angles[i]), atol=1e-5)


def test_keys_step_play_and_slow_down(page: Page, tmp_path: Path) -> None:
    own = run("two links")
    page.open(own.view().save(tmp_path / "run.html"))
    at = lambda: round(page.run("flexarm.now().time") / 0.01)  # noqa: E731
    page.press("ArrowRight")
    page.press("ArrowRight")
    assert at() == 2
    page.press("ArrowRight", shift=True)
    page.press("ArrowLeft")
    assert at() == 11
    page.press("End")
    assert at() == len(own.t) - 1
    page.press("Home")
    assert at() == 0
    page.press("-", "Minus")
    page.press("-", "Minus")
    assert page.run("flexarm.now().speed") == 0.25
    page.press(" ", "Space")
    assert page.run("flexarm.now().playing") and page.run("document.querySelector('#play').ariaLabel") == "Pause"
    page.until("flexarm.now().time > 0.05")
    page.press(" ", "Space")
    time = page.run("flexarm.now().time")
    assert not page.run("flexarm.now().playing") and np.abs(own.t - time).min() < 1e-9
    page.press("t", "KeyT")
    assert page.run("document.documentElement.dataset.theme") == "light"


def test_a_slider_that_has_the_focus_takes_its_own_keys(page: Page, tmp_path: Path) -> None:
    page.open(run("two links").view().save(tmp_path / "run.html"))
    for element, expected in (("time", (1, 1)), ("magnify", (1, 2)), ("play", (1, 3))):
        page.run(f"document.querySelector('#{element}').focus()")
        page.press("ArrowUp")
        now = page.run("flexarm.now()")
        assert (round(now["time"] / 0.01), now["magnify"]) == expected
    page.press("Tab")
    page.press("Tab")
    page.press("ArrowRight")
    assert round(page.run("flexarm.now().time") / 0.01) == 2


def test_runs_that_are_equal_are_both_seen(page: Page, tmp_path: Path) -> None:
    """What lies below is wider: each run's colour is there, on the stage and in a chart."""
    own = run("two links")
    page.open(own.view(own, labels=["below", "above"]).save(tmp_path / "run.html"))
    page.set("#time", 150)
    assert page.run("document.querySelector('.chart h2').textContent").startswith("distance of the tip")
    for selector in ("#stage", ".chart:nth-child(2) canvas"):
        seen = page.run(f"""(() => {{
          const c = document.querySelector('{selector}'), k = c.width * c.height * 4;
          const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
          return [COLORS.run0, COLORS.run1].map((text) => {{
            const [r, g, b] = [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16));
            let n = 0;
            for (let i = 0; i < k; i += 4) n += d[i] === r && d[i + 1] === g && d[i + 2] === b;
            return n;
          }});
        }})()""")
        assert min(seen) > 100, (selector, seen)


def test_playing_ends_at_the_end(page: Page, tmp_path: Path) -> None:
    page.open(run("two links").view().save(tmp_path / "run.html"))
    page.set("#speed", 4, "change")
    page.click("#play")
    page.until("!flexarm.now().playing")
    assert abs(page.run("flexarm.now().time") - run("two links").t[-1]) < 1e-9


@pytest.mark.parametrize("touch", [False, True])
def test_a_drag_on_a_chart_moves_the_cursor_of_all(page: Page, tmp_path: Path, touch: bool) -> None:
    own = run("two links")
    page.open(own.view().save(tmp_path / "run.html"), 360, 740, 2.0)
    page.drag(".chart canvas", (0.3, 0.5), (0.99, 0.5), touch)
    assert page.run("flexarm.now().time") > 0.9 * own.t[-1]
    said = page.run("Array.from(document.querySelectorAll('.chart canvas'), c => c.getAttribute('aria-label'))")
    assert len(said) >= 4 and all(f"at {page.run('flexarm.now().time'):.2f} s" in text for text in said)


def test_charts_say_what_the_run_says(page: Page, tmp_path: Path) -> None:
    own = run("two links")
    page.open(own.view().save(tmp_path / "run.html"))
    i = 123
    page.set("#time", i)
    script = """Object.fromEntries(Array.from(document.querySelectorAll('.chart'), c => [
      c.querySelector('h2').textContent,
      Array.from(c.querySelectorAll('output'), o => o.textContent.replace('\u2212', '-'))]))"""
    told = page.run(script)
    energies = (own.kinetic, own.strain_energy, own.gravity, own.dissipated, own.work)
    for title, rows in (
        ("tip deflection / length", own.tip_deflection.T), ("joint torque (N m)", own.joint_torque.T),
        ("energy (J)", energies),
    ):  # fmt: skip
        for text, row in zip(told[title], [row for row in rows if row.any()], strict=True):
            assert abs(float(text) - row[i]) < 1e-4 * np.ptp(row) + 1e-3 * abs(row[i])


def test_several_runs_over_each_other_and_beside(page: Page, tmp_path: Path) -> None:
    runs = [episode("FlexibleArm-v0", push) for push in (0.5, -0.4)]
    page.open(runs[0].view(runs[1], labels=["left", "right <b>"]).save(tmp_path / "two.html"))
    page.set("#time", 50)
    assert np.linalg.norm(pose(page, 0)[-1] - pose(page, 1)[-1]) > 0.1
    assert page.run("document.querySelector('#title').textContent") == "left and right <b>"
    tips = [one.infos["tip_position"][50] for one in runs]
    assert np.abs(np.array([pose(page, k)[-1] for k in (0, 1)]) - tips).max() < 1e-6
    page.press("s", "KeyS")
    assert page.run("flexarm.now().beside") and page.run("document.querySelector('#layout').value") == "beside"
    titles = page.run("Array.from(document.querySelectorAll('h2'), h => h.textContent)")
    for word in ("tip error", "tip deflection", "joint torque", "energy", "reward", "observation"):
        assert any(title.startswith(word) for title in titles)
    page.click("#legend li:nth-child(2) button")
    assert page.run("document.querySelectorAll('#legend button')[1].ariaPressed") == "false"


def test_nothing_but_its_own_script_runs(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "run.html"
    text = run("two links").view().html
    assert "http://" not in text and "https://" not in text.replace("https://www.w3.org", "")
    spoilt = text.replace("</body>", "<script>window.stranger = 1</script><img src='https://example.org/x.png'></body>")
    file.write_text(spoilt, encoding="utf-8")
    page.open(file)
    assert page.run("window.stranger") is None and page.run("flexarm.instants") > 0
    assert any("Content Security Policy" in fault for fault in page.faults)
    page.faults.clear()
    page.settle()
    assert not [url for url in page.requests.values() if url.startswith("http")]


def _contrast(one: list[float], other: list[float]) -> float:
    def light(color: list[float]) -> float:
        linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in (x / 255.0 for x in color)]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    a, b = sorted((light(one), light(other)))
    return (b + 0.05) / (a + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_contrast_is_enough_in_both_themes(page: Page, tmp_path: Path, dark: bool) -> None:
    """Text 4.5 to 1; what is drawn 3 to 1 (Web Content Accessibility Guidelines 2.2, 1.4.3 and 1.4.11)."""
    page.open(run("two links").view().save(tmp_path / "run.html"), dark=dark)
    colors = page.run("COLORS")
    rgb = {name: [int(text[k : k + 2], 16) for k in (1, 3, 5)] for name, text in colors.items()}
    for ground in ("paper", "panel"):
        for name in ("ink", "soft", *(f"run{k}" for k in range(6))):
            assert _contrast(rgb[name], rgb[ground]) >= 4.5, (name, ground)
        for name in ("accent", "target", "torque", "force", "payload", "bend-low", "bend-high", "ghost"):
            assert _contrast(rgb[name], rgb[ground]) >= 3.0, (name, ground)


def test_every_control_has_a_name_and_a_place_in_the_order(page: Page, tmp_path: Path) -> None:
    page.open(run("two links").view().save(tmp_path / "run.html"))
    tree = page.send("Accessibility.getFullAXTree")["nodes"]
    roles = ("button", "slider", "combobox", "image", "graphics-document")
    shown = [n for n in tree if n.get("role", {}).get("value") in roles and not n["ignored"]]
    assert len(shown) > 15 and [n["role"]["value"] for n in shown if not n.get("name", {}).get("value")] == []
    reached = []
    for _ in range(9):
        page.press("Tab")
        reached.append(page.run("document.activeElement.id || document.activeElement.textContent"))
    assert reached[:7] == ["theme", "back", "play", "forward", "time", "speed", "magnify"]


@pytest.mark.parametrize("size", list(BLINK))
def test_it_fits_and_shows_the_arm(page: Page, tmp_path: Path, pictures: Path, size: str) -> None:
    """No sideways scrolling; ink where the arm is; controls of a finger's size. The pictures are to be looked at."""
    width, height, scale, dark = BLINK[size]
    own = run("three links")
    page.open(own.view().save(tmp_path / "run.html"), width, height, scale, dark)
    page.set("#time", 40)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.run("document.querySelector('#stage').getBoundingClientRect().height") >= 250
    drawn = page.run("""(() => {
      const c = document.querySelector('#stage'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      return d.filter((x, i) => i % 4 === 3 && x > 0).length / (c.width * c.height); })()""")
    assert drawn > 0.01
    buttons = "document.querySelectorAll('#transport button')"
    assert min(page.run(f"Array.from({buttons}, b => b.getBoundingClientRect().height)")) >= 38
    page.picture(pictures / f"three_links_{size}.png")
