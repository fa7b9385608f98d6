"""Reference trajectories: where they are from, how good they are, and which files are refused."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import scenes
from tests.refusals import refusal, refuses


def test_references_have_origin_tolerance_and_sound_columns() -> None:
    assert scenes.reference_names() == ("robot_arm_motion", "robot_arm_motion_smooth", "flying_rod")
    for name in scenes.reference_names():
        reference, s = scenes.reference(name), scenes.named(name)
        assert reference.scene == name
        assert reference.source
        assert reference.method
        t = reference.columns["t"]
        assert set(reference.columns) == set(scenes.COLUMNS)
        np.testing.assert_allclose(t, np.arange(len(t)) * s.sample, atol=1e-9)
        assert t[-1] == s.duration
        tip = np.array([reference.columns["tip_x"][0], reference.columns["tip_y"][0]])
        straight = np.array(s.position) + 10.0 * np.array([math.cos(s.angles[0]), math.sin(s.angles[0])])
        np.testing.assert_allclose(tip, straight, atol=1e-8)
        np.testing.assert_allclose([reference.columns[k][0] for k in ("start_x", "start_y")], s.position, atol=1e-9)
        with pytest.raises(ValueError, match="read-only"):
            reference.columns["t"][0] = 1.0
    for name in ("robot_arm_motion", "robot_arm_motion_smooth"):
        psi = scenes.named(name).motion_of("joint0")
        assert psi is not None
        columns = scenes.reference(name).columns
        np.testing.assert_allclose(columns["start_angle"], psi(columns["t"]), atol=1e-8)
    assert scenes.reference("robot_arm_motion").tip_tolerance == 2e-3
    assert scenes.reference("robot_arm_motion_smooth").tip_tolerance == 1e-4
    refuses("unknown scene with a reference", lambda: scenes.reference("spin_up"))


def test_spot_values_of_another_program_agree_with_the_reference() -> None:
    spots = scenes.spot_values("robot_arm_motion")
    columns = scenes.reference("robot_arm_motion").columns
    for t, x, y in zip(spots["t"], spots["tip_x"], spots["tip_y"], strict=True):
        row = int(np.argmin(np.abs(columns["t"] - t)))
        assert columns["tip_x"][row] == pytest.approx(x, abs=spots["tolerance"]["tip"])
        assert columns["tip_y"][row] == pytest.approx(y, abs=spots["tolerance"]["tip"])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["t,energy"], "must begin with t,energy,start_x"),
        ([",".join(scenes.COLUMNS)], "rows = 0: must be at least one"),
        ([",".join(scenes.COLUMNS), "0,0,0,0,0,0,0,x"], "must be a number, in row 0 of column 'tip_angle'"),
        ([",".join(scenes.COLUMNS), "0,0,0"], "must hold 8 numbers, in row 0"),
        ([",".join(scenes.COLUMNS), "0,0,0,0,0,0,0,0", "0.5"], "must hold 8 numbers, in row 1"),
        ([",".join(scenes.COLUMNS), "0,0,0,0,0,0,0,0", "1,0,0,0,nan,0,0,0"], "must hold finite numbers"),
        ([",".join(scenes.COLUMNS), *itertools.repeat("0,0,0,0,0,0,0,0", 2)], "in row 1"),
    ],
)
def test_a_wrong_trajectory_file_is_refused(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "trajectory.csv"
    path.write_text("\n".join(lines))
    told = refusal(lambda: scenes.read_trajectory(path))
    assert told.startswith(str(path)) and message in told


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.csv"
    path.write_bytes(b"\xff\xfe\x00")
    refuses(rf"^{path}: not a CSV file: ", lambda: scenes.read_trajectory(path))
