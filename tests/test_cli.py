"""The command line: what it prints, writes and refuses, and that its help loads nothing heavy."""

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from flexarm_env.cli import main
from flexarm_env.cli.compile import cache_report
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.scenes import named, names, read_trajectory
from flexarm_env.simulation import simulate
from tests.cli_tools import answer, refused
from tests.processes import ROOT, python

COMMANDS = ("scenes", "replay", "simulate", "play", "train", "evaluate", "tune", "bench", "compile", "doctor")
SHORT = ["replay", "robot_arm_motion", "--segments", "2", "--duration", "0.5"]


def values_of(text: str) -> dict[str, str]:
    """The `name: value` lines."""
    return dict(line.split(": ", 1) for line in text.splitlines())


# ------------------------------------------------------------------- help
@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    text, errors = capsys.readouterr()
    assert ended.value.code == 0 and errors == ""
    assert f"  flexarm {command}" in text or command == "doctor"
    if command in ("replay", "simulate"):
        flags = "formulation segments elements coupling modes frame multipliers order nodes dt rho-inf tolerance"
        flags += " step-tolerance duration sample out plot plots video speed"
        assert all(f"--{flag}" in text for flag in flags.split())
        assert ("--reference" in text) == (command == "replay")
    if command == "run":
        assert "4 the run ended before --seconds" in text


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom flexarm_env.cli.parser import build_parser\nbuild_parser()\n"
        "print([m for m in ('llvmlite', 'scipy', 'matplotlib', 'torch', 'pygame') if m in sys.modules])"
    )
    assert python("-c", code).stdout.strip() == "[]"


def test_no_command_shows_the_overview(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "flexarm replay robot_arm_motion" in capsys.readouterr().out


# ------------------------------------------------------------------ scenes
def test_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    text = capsys.readouterr().out
    assert [line.split()[0] for line in text.splitlines()[1:]] == list(names(parameter_sets=True, space=True))
    entries = {entry["name"]: entry for entry in answer(capsys, "scenes")["scenes"]}
    assert entries["flying_rod"]["reference"] is True
    assert entries["flying_rod"]["root"] == "free"
    assert "J = 10" in entries["flying_rod@as_printed"]["note"]


@pytest.mark.slow
def test_a_scenes_toml_can_be_run_again(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["scenes", "robot_arm_motion"]) == 0
    path = tmp_path / "mine.toml"
    path.write_text(capsys.readouterr().out)
    mine = answer(capsys, "simulate", str(path), "--duration", "0.5", "--segments", "2")
    theirs = answer(capsys, *SHORT)
    assert "max_tip_error" not in mine
    assert mine["max_energy_balance_residual_J"] == theirs["max_energy_balance_residual_J"]


# ------------------------------------------------------------------ help
def test_no_help_tells_how_long_something_takes(capsys: pytest.CaptureFixture[str]) -> None:
    """A busy machine makes it untrue."""
    for command in (*COMMANDS, "view", "identify", "export"):
        with contextlib.suppress(SystemExit):
            main([command, "--help"])
        text = capsys.readouterr().out
        assert text and not re.search(r"minutes?\b|\d+ to \d+ s\b|takes? seconds", text), command


# ------------------------------------------------------------------ replay
def test_strict_makes_an_exit_code_of_an_inaccurate_run(capsys: pytest.CaptureFixture[str]) -> None:
    limit = ["--error-limit", "1e-9"]
    for options, code in ((limit, 0), ([*limit, "--strict"], 3), (["--strict"], 0)):
        assert main([*SHORT, *options]) == code
        assert (values_of(capsys.readouterr().out)["status"] == "inaccurate") == (len(options) > 1)
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    assert "3 with --strict" in capsys.readouterr().out


def test_replay_reports(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "robot_arm_motion"]) == 0
    values = values_of(capsys.readouterr().out)
    assert values["status"] == "ok"
    assert values["steps"] == "180"
    assert int(values["newton_iterations"]) > 180
    assert float(values["cpu_seconds_per_simulated_second"]) > 0.0
    assert 0.0 < float(values["energy_balance_residual_share"]) < 1e-3
    assert float(values["max_tip_error"]) == pytest.approx(0.0154, abs=0.002)
    assert 0.0 < float(values["rms_tip_error"]) < float(values["max_tip_error"])
    assert values["instants"] == "181"
    assert "0.002 m" in values["reference"]


def test_a_step_that_does_not_divide_the_samples_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["replay", "robot_arm_motion", "--duration", "0.2", "--sample", "0.05"]
    assert main([*words, "--dt", "0.03"]) == 0
    note = values_of(capsys.readouterr().out)["dt_note"]
    assert note.startswith("dt = 0.025 s instead of 0.03 s: steps end at every sample (0.05 s)")
    assert main([*words, "--dt", "0.025"]) == 0
    assert "dt_note" not in values_of(capsys.readouterr().out)


def test_replay_is_simulate(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table, arrays = tmp_path / "a" / "run.csv", tmp_path / "run.npz"
    options = ["--coupling", "paper", "--dt", "0.025", "--rho-inf", "0.8", "--tolerance", "1e-9", "--sample", "0.1"]
    assert main([*SHORT, *options, "--out", str(table)]) == 0
    assert main([*SHORT, *options, "--out", str(arrays)]) == 0
    run = simulate(
        named("robot_arm_motion"), segments=2, coupling="paper", dt=0.025, rho_inf=0.8, tolerance=1e-9, sample=0.1,
        duration=0.5,
    )  # fmt: skip
    for name, column in read_trajectory(table).items():
        np.testing.assert_array_equal(column, run.columns()[name])
    with np.load(arrays) as data:
        np.testing.assert_array_equal(data["q"], run.q)
    assert values_of(capsys.readouterr().out)["out"] == str(arrays)


@pytest.mark.parametrize(
    ("kept", "found"),
    [
        ("tip_y,t,tip_x", {"max_tip_error", "rms_tip_error"}),
        ("t,tip_angle", {"max_tip_angle_error"}),
        ("t,start_angle,current", {"max_start_angle_error"}),
    ],
)
def test_replay_against_what_was_measured(
    kept: str, found: set[str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Nobody measures an energy: a tip or an angle alone is compared, in columns of any order."""
    path = tmp_path / "own.csv"
    assert main([*SHORT, "--out", str(path)]) == 0
    columns = read_trajectory(path) | {"current": np.ones(11)}
    table = np.column_stack([columns[name] for name in kept.split(",")])
    np.savetxt(path, table, delimiter=",", header=kept, comments="", fmt="%.17g")
    values = answer(capsys, *SHORT, "--reference", str(path), "--plot", str(tmp_path / "a.png"))
    assert {name for name in values if name.endswith("_error")} == found
    assert {values[name] for name in found} == {0.0}
    assert values["instants"] == 11 and values["reference"] == str(path)


@pytest.mark.parametrize("header", ["t,tip_x", "tip_x,tip_y", "t,energy", "t,t,tip_angle"])
def test_a_reference_that_says_nothing_is_refused(
    header: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "own.csv"
    path.write_text(f"{header}\n")
    sentence = refused(capsys, *SHORT, "--reference", str(path))
    assert f"{path}: columns = " in sentence
    assert "must be names, each once: t, and tip_x and tip_y or tip_angle or start_angle" in sentence


@pytest.mark.slow
def test_replay_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.png"
    assert main([*SHORT, "--plot", str(path), "--plots", str(tmp_path / "all")]) == 0
    assert {file.name for file in (tmp_path / "all").iterdir()} >= {"shapes.png", "energies.png"}
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert values_of(capsys.readouterr().out)["plot"] == str(path)


@pytest.mark.parametrize(("ending", "start"), [("gif", b"GIF89a"), ("mp4", b"\0\0\0")])
def test_replay_films(ending: str, start: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "new" / f"arm.{ending}"
    assert main([*SHORT, "--video", str(path), "--speed", "0.5"]) == 0
    assert path.read_bytes().startswith(start)
    assert values_of(capsys.readouterr().out)["video"] == str(path)


def test_a_missing_extra_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexarm_env.cli import replay

    monkeypatch.setattr(replay, "find_spec", lambda name: None)
    plot = refused(capsys, *SHORT, "--plot", str(tmp_path / "a.png"))
    film = refused(capsys, *SHORT, "--video", str(tmp_path / "a.gif"))
    assert 'pip install matplotlib (or install flexarm_env with the extra "plot")' in plot
    assert 'pip install pygame-ce (or install flexarm_env with the extra "render")' in film


def test_what_to_install_needs_no_index_of_ours(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Who has a wheel and no more cannot install flexarm_env[plot] from anywhere."""
    from flexarm_env import validation
    from flexarm_env.envs import video

    sentence = validation.lacking("--plot", "matplotlib", "plot")
    assert sentence.startswith("--plot needs matplotlib: pip install matplotlib (")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(DependencyNotInstalled, match="pip install imageio-ffmpeg"):
        video.write_film(tmp_path / "a.mp4", [np.zeros((2, 2, 3), np.uint8)])


@pytest.mark.slow
def test_a_parameter_set_has_no_reference(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "robot_arm_motion@as_printed", "--duration", "0.2", "--segments", "1"]) == 0
    assert "reference" not in values_of(capsys.readouterr().out)


@pytest.mark.slow
def test_a_run_that_fails_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    values = answer(capsys, "replay", "robot_arm_motion", "--modes", "3", code=1)
    assert values["status"] == "out_of_range"
    assert "beyond the valid range" in values["message"]


# ---------------------------------------------------------------- refusals
def test_refusals_are_sentences(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    replay = ("replay", "robot_arm_motion")
    assert "unknown scene" in refused(capsys, "replay", "robot_arm")
    assert "a .toml file that exists" in refused(capsys, "simulate", str(tmp_path / "none.toml"))
    assert "nodes: unknown option of floating_frame (it belongs to" in refused(capsys, *replay, "--nodes", "5")
    assert "segments = 0: must be" in refused(capsys, *replay, "--segments", "0")
    assert "modes" in refused(capsys, *replay, "--modes", "2", "--elements", "2")
    assert "dt = -1.0: must be a positive number (s)" in refused(capsys, *replay, "--dt", "-1")
    assert "dt = nan" in refused(capsys, *replay, "--dt", "nan")
    assert "dt = 1e-300: must be at least 9e-09 s: a run of 9 s may" in refused(capsys, *replay, "--dt", "1e-300")
    assert "invalid int value: 'x'" in refused(capsys, *replay, "--elements", "x")
    assert "unrecognized arguments: --segment" in refused(capsys, *replay, "--segment", "2")
    assert "unrecognized arguments: --reference" in refused(capsys, "simulate", "x.toml", "--reference", "y.csv")
    assert "must end in .csv or .npz" in refused(capsys, *replay, "--out", str(tmp_path / "a.txt"))
    assert "must end in .png" in refused(capsys, *replay, "--plot", str(tmp_path / "a.gif"))
    assert "must end in .mp4" in refused(capsys, *replay, "--video", str(tmp_path / "a.png"))
    assert "--speed = 0.0: must be a finite number, at least 5e-05" in refused(capsys, *replay, "--speed", "0")
    for judging in ("evaluate --policy pd", "bench suite"):
        assert "/out: Not a directory" in refused(capsys, *judging.split(), "--out", f"{__file__}/out")
    assert "No such file" in refused(capsys, *replay, "--reference", str(tmp_path / "none.csv"))
    assert "invalid choice: 'replai'" in refused(capsys, "replai")
    assert "unknown scene" in refused(capsys, "scenes", "nothing")
    assert "formulation = 'exact'" in refused(capsys, *replay, "--formulation", "exact")
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_scene_names_its_key(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    text = named("robot_arm_motion").to_toml()
    path.write_text(text.replace("EI = 1000.0", "EI = -1.0"))
    assert "arm.links[0].section.EI = -1.0: must be a positive number (N m^2)" in refused(capsys, "simulate", str(path))
    path.write_text("name = [")
    assert "bad.toml" in refused(capsys, "simulate", str(path))


def test_outputs_are_checked_before_the_run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "file" in refused(capsys, *SHORT, "--out", str(tmp_path / "file" / "run.csv"))
    (tmp_path / "folder.csv").mkdir()
    assert "this is a folder" in refused(capsys, *SHORT, "--out", str(tmp_path / "folder.csv"))
    assert "this is a file" in refused(capsys, *SHORT, "--plots", str(tmp_path / "file"))


def test_a_reader_that_leaves_is_no_error() -> None:
    command = f"{sys.executable} -m flexarm_env scenes | head -1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert done.stderr == ""


# ------------------------------------------------------------- environments
@pytest.mark.slow
def test_limits_hold_through_the_environment(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SHORT, "--through-env", "--error-limit", "1e-9"]) == 0
    assert values_of(capsys.readouterr().out)["status"] == "inaccurate"
    text = refused(capsys, *SHORT, "--through-env", "--time-limit", "1")
    assert "--time-limit = 1.0: must not be combined with --through-env" in text


# ------------------------------------------------------------------ doctor
def test_doctor(capsys: pytest.CaptureFixture[str]) -> None:
    values = answer(capsys, "doctor")
    assert values["self_test"].startswith("passed")
    assert 0.01 < values["self_test_max_tip_error"] < 0.015
    assert {"python", "llvmlite", "torch", "processors", "cache_folder"} <= values.keys()
    assert values["cache_writable"] is True


def test_doctor_says_why_compiled_code_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    warned = ["flexarm_env: compiled code cannot be kept, ... (no space); set FLEXARM_CACHE_DIR to ..."]
    found = cache_report(warned)
    assert found["cache_writable"] is False and found["cache"].startswith("compiled code cannot be kept")
    assert cache_report([]).keys() == {"cache_folder", "cache_size", "cache_writable"}
    monkeypatch.setattr(Path, "write_bytes", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    found = cache_report([])
    assert found["cache_writable"] is False and "FLEXARM_CACHE_DIR" in found["cache"] and "No space" in found["cache"]


@pytest.mark.slow  # a minute or two where nothing has been compiled yet
def test_compile_leaves_nothing_to_be_compiled(tmp_path: Path) -> None:
    copy, folder = tmp_path / "package", tmp_path / "cache"  # a copy: what lies beside this package would be read too
    shutil.copytree(ROOT / "flexarm_env", copy / "flexarm_env", ignore=shutil.ignore_patterns("__pycache__"))
    own = {"cwd": copy, "PYTHONPATH": str(copy), "FLEXARM_CACHE_DIR": str(folder)}
    done = python("-m", "flexarm_env", "compile", "--json", **own)
    assert json.loads(done.stdout)["cache_writable"] is True
    kept = {path.name for path in folder.rglob("*.o")}
    assert kept
    lines = (
        "import gymnasium as gym, flexarm_env, numpy as np; from flexarm_env import linear, named, simulate, recording",
        "env = gym.make_vec('TwoLinkFlexArm-v0', num_envs=32); env.reset(seed=5); env.step(env.action_space.sample())",
        "env = gym.make('TwoLinkFlexArm-v0'); env.reset(seed=5); env.step(env.action_space.sample())",
        "simulate(named('robot_arm_motion'), duration=0.2); linear.linearize(named('robot_arm_motion'))",
    )
    for command in (["-c", "\n".join(lines)], ["-m", "flexarm_env", "replay", "flying_rod", "--duration", "0.1"]):
        assert python(*command, **own).stderr == "", "compiled after all"
    assert {path.name for path in folder.rglob("*.o")} == kept


# ---------------------------------------------------------------- printing
class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_progress_is_for_terminals() -> None:
    quiet, terminal = io.StringIO(), Terminal()
    for stream in (quiet, terminal):
        bar = ProgressBar("run", stream, after=0.0)
        bar(0.25)
        bar(0.5)
        bar.close()
    assert quiet.getvalue() == ""
    lines = terminal.getvalue().split("\r")
    assert " 25%" in lines[1]
    assert " 50%" in lines[2]
    assert lines[-2].strip() == ""


def test_progress_waits_half_a_second() -> None:
    terminal = Terminal()
    bar = ProgressBar("run", terminal)
    bar(0.5)
    bar.close()
    assert terminal.getvalue() == ""


def test_json_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    show({"a": float("nan"), "b": {"c": (1.0, float("inf"))}, "d": "x"}, as_json=True)
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": {"c": [1.0, None]}, "d": "x"}
    show({"a": 0.1 + 0.2, "b": {"c": 1}, "d": (1, 2)}, as_json=False)
    assert capsys.readouterr().out == "a: 0.3\nb: c=1\nd: 1, 2\n"


WARNS = """
import sys, warnings
from flexarm_env.cli import main, scenes
scenes.run = lambda args: warnings.warn("mind\\nthe gap", stacklevel=1) or 0
sys.exit(main(["scenes"]))
"""


def test_a_warning_is_one_line_without_source() -> None:
    assert python("-c", WARNS).stderr == "flexarm scenes: warning: mind the gap\n"
