"""The player's page, without a browser (that is tests/browser): what is in it, its size, what `flexarm view` takes."""

import base64
import dataclasses
import hashlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import Arm, Link, Scene, Section, Trajectory, named, simulate
from flexarm_env.cli import main
from flexarm_env.geometry.ribbons import cuts_of, thinned
from flexarm_env.physics.reading import link_deflection
from flexarm_env.recording import EpisodeRecorder, load_episodes
from flexarm_env.suite import best, task
from flexarm_env.view import Chart, Clip, Player, magnified
from tests.cli_tools import answer, refused
from tests.processes import ROOT
from tests.refusals import refuses


@cache
def run() -> Trajectory:
    return simulate(named("two_link_motion"), duration=1.0, estimate_error=False)


def numbers(packed: dict[str, Any]) -> np.ndarray[Any, Any]:
    values = np.frombuffer(base64.b64decode(packed["data"]), "<" + packed["kind"]).reshape(packed["shape"])
    if packed["kind"] != "i2":
        return values.astype(float)
    return np.where(values == -32768, np.nan, packed["low"] + (values + 32767.0) * packed["step"])


def data(text: str) -> Any:
    """What a page holds."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found.group(1))


def allows_its_own_script_alone(text: str) -> bool:
    """What a page's policy says."""
    script = re.search(r"<script>(.*?)</script>", text, re.S)
    assert script is not None
    digest = base64.b64encode(hashlib.sha256(script.group(1).encode()).digest()).decode()
    head = text.partition("<style>")[0]
    return f"default-src 'none'; script-src 'sha256-{digest}'" in head and "unsafe" not in head


def long_clip(n: int, label: str) -> Clip:
    """n instants of two links with everything that can be shown."""
    rng = np.random.default_rng(1)
    values = {f"a{k}": rng.normal(size=n) for k in range(30)}
    return dataclasses.replace(
        run().clip(label), t=np.linspace(0.0, 60.0, n), points=rng.normal(size=(n, 41, 2)), cuts=(0, 20, 40),
        angles=rng.normal(size=(n, 2, 2)), rigid=rng.normal(size=(n, 2)), rest=rng.normal(size=(41, 2)),
        curvature=rng.normal(size=(n, 41)), pulls=(), charts=[Chart("all", values)],
    )  # fmt: skip


def test_a_factor_of_one_gives_the_points_and_more_only_the_deflection() -> None:
    own = run()
    clip = own.clip()
    for i in (3, 11, 20):
        given = clip.points[i], clip.cuts, clip.angles[i], clip.rigid[i], clip.rest
        assert np.abs(magnified(*given, 1.0) - clip.points[i]).max() < 1e-13
        five = magnified(*given, 5.0)
        first = five[: clip.cuts[1] + 1] - five[0]
        c, s = np.cos(clip.angles[i, 0, 0]), np.sin(clip.angles[i, 0, 0])
        grown = (c * first[-1, 1] - s * first[-1, 0]) / own.scene.arm.links[0].span
        assert abs(grown - 5.0 * own.tip_deflection[i, 0]) < 1e-9
    still = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    assert np.array_equal(magnified(still, (0, 2), [[0.0, 0.0]], [0.0], still, 20.0), still)
    refuses("factor = 0", lambda: magnified(still, (0, 2), [[0.0, 0.0]], [0.0], still, 0))


@pytest.mark.slow
def test_links_that_are_curved_without_stress_have_no_deflection_to_magnify() -> None:
    hook = Link(1.0, Section(2.0, 2e6, 7e5, 0.3), curvature=[(0.0, 0.0), (0.5, 0.0), (0.5, 2.0), (1.0, 2.0)])
    scene = Scene("hooks", Arm("hooks", (hook, hook)), duration=0.02, dt=0.01, angles=(0.3, 1.6))
    clip = simulate(scene, "elastica", nodes=8, estimate_error=False).clip()
    same = magnified(clip.points[0], clip.cuts, clip.angles[0], clip.rigid[0], clip.rest, 20.0)
    assert np.abs(same - clip.points[0]).max() < 2e-3  # places along the arc are those along its chords
    assert np.abs(clip.curvature).max() < 1e-9


def test_cuts_and_thinning_keep_root_joints_and_tip() -> None:
    own = run()
    cuts = cuts_of(own.shapes, own.hinges)
    assert np.abs(own.shapes[:, cuts[1]] - own.hinges[:, 0]).max() < 1e-12
    kept, places = thinned(cuts, 7)
    assert [kept[k] for k in places] == list(cuts) and len(kept) == 13


def test_the_page_holds_the_run_and_allows_nothing_else() -> None:
    own = run()
    text = own.view().html
    assert allows_its_own_script_alone(text)
    clip = data(text)["clips"][0]
    points = numbers(clip["points"]) + numbers(clip["root"])[:, None]
    assert np.abs(points[:, -1] - own.tip[:, :2]).max() < 1e-6 * own.scene.arm.total_length
    assert np.abs(numbers(clip["t"]) - own.t).max() == 0.0
    energy = next(chart for chart in clip["charts"] if chart["title"].startswith("energy"))["series"]["kinetic"]
    assert np.abs(numbers(energy) - own.kinetic).max() <= 1e-5 * np.ptp(own.kinetic)
    values = np.array([-0.3, 0.0, 1.0, np.nan, 2.0])
    charts = json.loads(Player([dataclasses.replace(run().clip(), charts=[Chart("a", {"b": values})])]).data)
    back = numbers(charts["clips"][0]["charts"][0]["series"]["b"])
    assert abs(back[1]) < 1e-12 and np.isnan(back[3]) and np.nanmax(np.abs(back - values)) < 4e-5


def test_the_sites_players_are_of_this_form() -> None:
    """`python docs/players/make.py` makes them anew."""
    now = set(json.loads(run().view().data)["clips"][0])
    space = simulate(named("three_dof_slew"), duration=0.01, elements=1, estimate_error=False)
    forms = now, now | {"base"}, set(json.loads(space.view().data)["clips"][0])
    files = sorted((ROOT / "docs" / "players").glob("*.json"))
    pages = "".join(path.read_text("utf-8") for path in (ROOT / "docs").rglob("*.md"))
    assert files and not [f.stem for f in files if f"{{player}} {f.stem}\n" not in pages]
    assert all(set(clip) in forms for f in files for clip in json.loads(f.read_text("utf-8"))["clips"])


def test_a_name_cannot_break_out_of_the_page() -> None:
    text = Player([run().clip("</script><script>alert(1)</script> %data% %style%")]).html
    assert "<script>alert" not in text and text.count("</script>") == 2


def test_curvature_is_what_gauges_read() -> None:
    own = run()
    clip = own.clip()
    strain = own.strain(0, 0.5, distance=1.0)
    middle = clip.curvature[:, clip.cuts[1] // 2]
    assert np.abs(middle - strain).max() < 0.05 * np.abs(strain).max()


def test_an_hour_of_numbers_still_fits() -> None:
    """60 s of two arms of two links at 50 Hz with 30 curves: below 3 MB, evenly thinned, the ends kept."""
    player = Player([long_clip(3001, "a"), long_clip(3001, "b")])
    assert len(player.html) < 3_000_000
    for clip in json.loads(player.data)["clips"]:
        t = numbers(clip["t"])
        assert t[0] == 0.0 and t[-1] == 60.0 and len(t) >= 1000
        assert "one instant of" in clip["note"] or len(t) == 3001
    refuses("most_bytes = 1000", lambda: Player([long_clip(10, "a")], most_bytes=1000))
    refuses("clips", lambda: Player([]))


def test_labels_are_told_apart_and_tips_compared() -> None:
    own = run()
    other = simulate(named("two_link_motion"), dt=0.01, duration=1.0, estimate_error=False)
    clips = json.loads(own.view(other).data)["clips"]
    assert [clip["label"] for clip in clips] == ["two_link_motion", "two_link_motion (2)"]
    chart = clips[1]["charts"][0]
    assert chart["title"] == "distance of the tip from that of two_link_motion (m)"
    apart = np.hypot(*(other.tip[:, :2] - own.tip[:, :2]).T)
    assert np.abs(numbers(chart["series"]["tip"]) - apart).max() < 1e-4 * apart.max() + 1e-12
    refuses("labels", lambda: own.view(other, labels=["one"]))


def test_notebooks_get_a_frame_that_reaches_nothing() -> None:
    text = run()._repr_html_()
    assert text.startswith('<iframe srcdoc="&lt;!doctype html&gt;') and 'sandbox="allow-scripts"' in text


def test_a_trajectory_comes_back_from_its_file(tmp_path: Path) -> None:
    own = run()
    own.to_npz(tmp_path / "run.npz")
    again = Trajectory.from_npz(tmp_path / "run.npz")
    for one in dataclasses.fields(own):
        a, b = getattr(own, one.name), getattr(again, one.name)
        assert np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray | float) else a == b, one.name
    assert again.view().data == own.view().data
    (tmp_path / "none.npz").write_bytes(b"PK\3\4 no archive")
    refuses(r"none\.npz: damaged", lambda: Trajectory.from_npz(tmp_path / "none.npz"))


def test_link_angles_are_the_tangents() -> None:
    own = run()
    assert np.array_equal(own.link_angles[:, 0, 0], own.joint_angles[:, 0])
    assert np.allclose(own.link_angles[:, 1, 0] - own.link_angles[:, 0, 1], own.joint_angles[:, 1])
    assert np.array_equal(own.link_angles[:, -1, 1], own.tip[:, 2])
    poses = np.zeros((len(own.t), 1, 12))
    poses[:, 0, [0, 1]], poses[:, 0, 2] = own.hinges[:, 0], own.link_angles[:, 1, 0]
    poses[:, 0, [6, 7]] = own.tip[:, :2]
    assert np.allclose(link_deflection(poses)[:, 0] / own.scene.arm.links[1].span, own.tip_deflection[:, 1])


# ------------------------------------------------------------- command line
def test_view_takes_scenes_and_trajectories(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run().to_npz("kept.npz")
    values = answer(capsys, "view", "two_link_motion", "kept.npz", "--duration", "0.5")
    assert values["view"] == "two_link_motion.html" and values["runs"] == ["two_link_motion", "kept"]
    assert values["instants"][0] >= 100 and values["bytes"] == Path("two_link_motion.html").stat().st_size


@pytest.mark.slow
def test_view_plays_a_policy_against_pd_and_their_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "new" / "page.html"
    values = answer(capsys, "view", "two_link", "pd", "--seed", "3", "--out", str(page))
    assert values["runs"] == ["two_link", "pd"] and page.is_file()
    first, second = data(page.read_text("utf-8"))["clips"]
    assert np.array_equal(numbers(first["target"]), numbers(second["target"]))
    assert np.array_equal(numbers(first["points"])[0], numbers(second["points"])[0])
    titles = [chart["title"] for chart in first["charts"]]
    assert [title.split(" ")[0] for title in titles] == ["tip", "tip", "joint", "energy", "reward", "observation,"]

    kept = tmp_path / "episodes.npz"
    assert main(["play", "--policy", "pd", "--headless", "--episodes", "2", "--record", str(kept)]) == 0
    assert answer(capsys, "view", str(kept), "--episode", "1", "--out", str(page))["runs"] == ["episodes, episode 1"]
    clip = load_episodes(kept)[1].clip()
    assert np.allclose(clip.points[:, -1], load_episodes(kept)[1].infos["tip_position"], atol=1e-12)


@pytest.mark.slow
def test_a_task_of_the_suite_shows_the_best_that_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    found = answer(capsys, "view", "slew-measured-v2", "pd", "--seed", "10007", "--out", str(page))
    (kept, beside), record = found["runs"], best.record(task("slew-measured-v2"))
    assert kept == f"best known ({record.by[7]})" and beside == "pd"
    clips = data(page.read_text("utf-8"))["clips"]
    assert np.array_equal(numbers(clips[0]["target"]), numbers(clips[1]["target"]))
    rewards = next(chart for chart in clips[0]["charts"] if chart["title"].startswith("reward"))
    total = float(np.nansum(numbers(rewards["series"]["sum"])))
    assert abs(total - record.values[7]) < 0.01, (total, record.values[7])


@pytest.mark.slow
def test_an_episode_that_follows_a_motion_is_shown_too() -> None:
    """Its arm has a state of another form than those of a batch."""
    env = EpisodeRecorder(gym.make("FlexibleArm-v0", task="replay", max_episode_steps=30))
    env.reset(seed=1)
    for _ in range(30):
        env.step(np.zeros(1, np.float32))
    env.close()
    clip = env.episodes[0].clip("replay")
    assert np.allclose(clip.points[:, -1], env.episodes[0].infos["tip_position"], atol=1e-12)
    bend = env.episodes[0].infos["tip_deflection"]
    assert np.corrcoef(clip.curvature[:, 0], bend)[0, 1] > 0.9, "curved at the root as the tip is deflected"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nothing"], "flexarm view: nothing: unknown scene, controller, policy, task with a record"),
        (["pd", "--out", "a.txt"], "--out = 'a.txt': must end in .html"),
        (["slew-limited-v2", "--seed", "3"], "--seed = 3: must be a whole number, from 10000 to 10099"),
        (["two_link", "--env", "FlexibleArm-v0"], "RUN = 'two_link'"),
        (["robot_arm_motion", "--duration", "1e9"], "--duration = 1000000000.0: must be a finite number, above 0 and"),
        (["pd", "--episode", "5"], "--episode = 5: requires a run that is a file of recorded episodes"),
        (["spin_up", "--seed", "3"], "--seed = 3: requires a run that is a controller, a policy or a task"),
        (["pd", "two_link", "--sample", "0.1"], "--sample = 0.1: requires a run that is a scene"),
    ],
)
def test_view_says_what_is_wrong(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert sentence in refused(capsys, "view", *words)
