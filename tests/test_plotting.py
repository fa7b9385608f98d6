"""Figures: they are written whole, in the format asked for, and show what the run holds."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from flexarm_env import plotting
from flexarm_env.scenes import named, reference
from flexarm_env.simulation import simulate
from flexarm_env.trajectory import Trajectory
from tests.refusals import refuses
from tests.scene_tools import everything

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def runs() -> dict[str, Trajectory]:
    """One run of each kind: pinned with a reference, two links, free."""
    return {
        "pinned": simulate(named("robot_arm_motion"), segments=4),
        "two links": simulate(named("two_link_motion"), segments=1),
        "free": simulate(everything(named("flying_rod")), segments=2),
    }


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were saved."""
    kept: list[Figure] = []
    save = Figure.savefig

    def keep(figure: Figure, *args: object, **options: object) -> None:
        kept.append(figure)
        save(figure, *args, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    return kept


def texts(figure: Figure) -> list[str]:
    """All that is written in a figure: title, titles, labels."""
    found = [figure.get_suptitle()]
    for axes in figure.axes:
        found += [axes.get_title(loc="left"), axes.get_xlabel(), *(text.get_text() for text in axes.texts)]
    return found


@pytest.mark.parametrize("kind", ["pinned", "two links", "free"])
def test_trajectory(kind: str, runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    path = plotting.plot_trajectory(runs[kind], tmp_path / "new" / "run.png")
    assert path.read_bytes()[:8] == PNG
    assert [p.name for p in path.parent.iterdir()] == ["run.png"]
    (figure,) = drawn
    panels = [axes.get_title(loc="left") for axes in figure.axes]
    shapes = [title for title in panels if title.startswith("shapes")]
    assert len(shapes) == (1 if kind == "free" else 2)
    assert panels[len(shapes) :] == ["tip deflection / link length", "energy (J)"]
    labels = [text for axes in figure.axes[: len(shapes)] for text in (t.get_text() for t in axes.texts)]
    assert {float(label) for label in labels} >= {0.0, float(f"{runs[kind].t[-1]:.3g}")}
    assert len(labels) >= 8


@pytest.mark.slow
def test_labels_do_not_cover_each_other(runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    for run in runs.values():
        plotting.plot_trajectory(run, tmp_path / "run.png")
    for figure in drawn:
        renderer = figure.canvas.get_renderer()
        for axes in figure.axes:
            boxes = [text.get_window_extent(renderer) for text in axes.texts]
            for i, box in enumerate(boxes):
                assert not any(box.shrunk(0.8, 0.8).overlaps(other.shrunk(0.8, 0.8)) for other in boxes[:i])


def test_reference_and_data_are_drawn(runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    table = reference("robot_arm_motion").columns
    plotting.plot_trajectory(runs["pinned"], tmp_path / "run.png", reference=table)
    dots = [line for line in drawn[0].axes[0].lines if line.get_marker() == "."]
    inside = table["t"] <= 5.0 + 1e-9
    np.testing.assert_array_equal(dots[0].get_xdata(), table["tip_x"][inside])
    deflection, energy = drawn[0].axes[-2:]
    np.testing.assert_array_equal(deflection.lines[0].get_ydata(), runs["pinned"].tip_deflection[:, 0])
    total = next(line for line in energy.lines if line.get_label() == "total")
    np.testing.assert_array_equal(total.get_ydata(), runs["pinned"].energy)


@pytest.mark.parametrize(("ending", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_formats(ending: str, start: bytes, runs: dict[str, Trajectory], tmp_path: Path) -> None:
    path = plotting.plot_energies(runs["free"], tmp_path / f"run.{ending}")
    assert path.read_bytes().startswith(start)


def test_wrong_format_leaves_nothing(runs: dict[str, Trajectory], tmp_path: Path) -> None:
    for path in (tmp_path / "run.abc", tmp_path / "run"):
        refuses(f"path = '{path}': must end in .png", lambda path=path: plotting.plot_energies(runs["free"], path))
    assert list(tmp_path.iterdir()) == []


def test_comparison(runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    finer = simulate(named("robot_arm_motion"), segments=8, dt=0.025)
    both = {"4 segments": runs["pinned"], "8 segments": finer}
    plotting.plot_comparison(both, tmp_path / "a.png", reference=reference("robot_arm_motion").columns, title="arm")
    plotting.plot_comparison(both, tmp_path / "b.png")
    assert "distance of the tip from the reference (m)" in texts(drawn[0])
    assert "distance of the tip from 4 segments (m)" in texts(drawn[1])
    assert len(drawn[0].axes[2].lines) == 2
    assert len(drawn[1].axes[2].lines) == 1  # the first run stands for the reference
    refuses("at least one run", lambda: plotting.plot_comparison({}, tmp_path / "c.png"))
    unlabelled: Any = list(both.values())
    refuses("must be runs by their labels", lambda: plotting.plot_comparison(unlabelled, tmp_path / "c.png"))


def test_runs_that_lie_on_each_other_are_all_seen(
    runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path
) -> None:
    """The last used to hide the others: three times the same run."""
    plotting.plot_comparison(dict.fromkeys("abc", runs["pinned"]), tmp_path / "c.png")
    for axes in drawn[0].axes[:2]:
        first, *others = axes.lines
        assert first.get_linestyle() == "-" and all(line.get_linestyle() == "--" for line in others)
        assert all(first.get_linewidth() > 1.5 * line.get_linewidth() for line in others)
        pixels = np.asarray(drawn[0].canvas.buffer_rgba())[..., :3].reshape(-1, 3).astype(int)
        for color in plotting.COLORS[1:3]:
            rgb = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
            assert (np.abs(pixels - rgb).max(axis=1) < 40).sum() > 300, color


def test_what_is_left_to_swing_is_drawn_larger(drawn: list[Figure], tmp_path: Path) -> None:
    """A slew's last shapes used to lie on each other. The panel says how much larger, and the figure is still true."""
    stiff = named("robot_arm_motion_smooth")
    link = stiff.arm.links[0]
    section = dataclasses.replace(link.section, EI=60.0 * link.section.EI)
    arm = dataclasses.replace(stiff.arm, links=(dataclasses.replace(link, section=section),))
    run = simulate(dataclasses.replace(stiff, arm=arm), estimate_error=False)
    plotting.plot_trajectory(run, tmp_path / "run.png")
    driven, after = drawn[0].axes[:2]
    assert driven.get_title(loc="left") == "shapes, 0 to 5 s"
    title = after.get_title(loc="left")
    assert title.startswith("shapes, 5 to 9 s, deflection × ")
    factor = float(title.split("× ")[1])
    shapes = [line.get_xydata() for line in after.lines if len(line.get_xdata()) == run.shapes.shape[1]]
    late = run.t >= 5.0
    spread = np.ptp([points[-1] for points in shapes], axis=0).max()
    assert factor >= 5.0 and spread > 0.5 * factor * np.ptp(run.tip[late, :2], axis=0).max()


def test_energies(runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    plotting.plot_energies(runs["two links"], tmp_path / "e.png", title="mine")
    assert drawn[0].get_suptitle() == "mine"
    balance = drawn[0].axes[1].lines[0]
    np.testing.assert_array_equal(balance.get_ydata(), runs["two links"].balance)


def test_spectrum_of_a_sine() -> None:
    t = np.arange(2000) * 0.01
    frequency, amplitude = plotting.spectrum(t, 3.0 + 0.7 * np.sin(2 * np.pi * 4.0 * t))
    assert frequency[amplitude.argmax()] == pytest.approx(4.0, abs=0.05)
    assert amplitude.max() == pytest.approx(0.7, rel=0.01)
    refuses("evenly spaced", lambda: plotting.spectrum(t**2, t))


def test_the_dominant_peak_is_labelled_and_round_off_is_not(drawn: list[Figure], tmp_path: Path) -> None:
    """Whichever link has it, and in whichever line; it was that of the first link alone, and one of 5e-5 of it."""
    t = np.arange(0.0, 8.0, 0.01)
    first = 1e-3 * np.sin(2 * np.pi * 6.0 * t) + 5e-8 * np.sin(2 * np.pi * 31.0 * t)
    second = 0.1 * np.sin(2 * np.pi * 2.5 * t) + 2e-3 * np.sin(2 * np.pi * 17.0 * t)
    run = SimpleNamespace(t=t, tip_deflection=np.stack([first, second], axis=1))
    plotting.plot_spectrum(run, tmp_path / "s.png", since=0.0, title="two links")
    said = [text.get_text() for text in drawn[-1].axes[0].texts]
    assert said[0] == "2.5 Hz" and set(said) <= {"2.5 Hz", "6 Hz", "17 Hz"} and "17 Hz" in said
    slow = SimpleNamespace(t=t, tip_deflection=0.1 * np.sin(2 * np.pi * 0.13 * t)[:, None])
    plotting.plot_spectrum(slow, tmp_path / "t.png", since=0.0, title="one slow line")
    assert [text.get_text() for text in drawn[-1].axes[0].texts] == ["0.125 Hz"]


def test_spectrum_finds_the_arms_frequency(runs: dict[str, Trajectory], drawn: list[Figure], tmp_path: Path) -> None:
    plotting.plot_spectrum(runs["two links"], tmp_path / "s.png")
    plotting.plot_spectrum(runs["pinned"], tmp_path / "t.png", since=1.0)
    titles = texts(drawn[0])
    assert "amplitude of the tip deflection / length, 0.5 to 2.2 s" in titles
    assert any(text.endswith(" Hz") for text in titles)
    assert "1 to 9 s" in " ".join(texts(drawn[1]))


@pytest.mark.slow
def test_all_of_a_run(runs: dict[str, Trajectory], tmp_path: Path) -> None:
    paths = plotting.plot_all(runs["pinned"], tmp_path / "new", reference("robot_arm_motion").columns, "svg")
    assert [path.name for path in paths] == ["shapes.svg", "energies.svg", "spectrum.svg"]
    assert all(path.read_bytes().startswith(b"<?xml") for path in paths)
    short = simulate(named("robot_arm_motion"), segments=4, duration=0.2)
    assert [path.name for path in plotting.plot_all(short, tmp_path)] == ["shapes.png", "energies.png"]


def test_a_run_that_failed_says_so(drawn: list[Figure], tmp_path: Path) -> None:
    failed = simulate(named("robot_arm_motion"), modes=3)
    plotting.plot_trajectory(failed, tmp_path / "run.png")
    assert f"[out_of_range after {failed.t[-1]:g} s]" in drawn[0].get_suptitle()


def test_settings_of_others_are_left_alone(runs: dict[str, Trajectory], tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    plotting.plot_energies(runs["free"], tmp_path / "run.png")
    assert dict(matplotlib.rcParams) == before
