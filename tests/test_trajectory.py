"""Trajectories: what they record, what is written to files and read back, and how they compare with references."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexarm_env.accuracy import common_instants
from flexarm_env.comparison import tip_error
from flexarm_env.files import unit_of
from flexarm_env.parameters import Arm, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.scenes import named, read_reference, read_trajectory
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant, pulse, ramp, spline_table
from flexarm_env.trajectory import COLUMNS, Trajectory
from tests.scene_tools import every, everything


@pytest.fixture(scope="module")
def run() -> Trajectory:
    """The first named scene with its defaults."""
    return simulate(named("robot_arm_motion"))


@pytest.fixture(scope="module")
def two_links() -> Trajectory:
    """A short run with a hinge."""
    return simulate(named("two_link_motion"), segments=1, duration=0.7)


def test_csv_holds_every_bit(run: Trajectory, two_links: Trajectory, tmp_path: Path) -> None:
    for number, trajectory in enumerate((run, two_links)):
        path = tmp_path / "folder" / f"run{number}.csv"
        trajectory.to_csv(path)
        table = read_trajectory(path)
        assert tuple(table)[: len(COLUMNS)] == COLUMNS
        assert tuple(table)[len(COLUMNS) :] == (() if number == 0 else ("hinge_x", "hinge_y"))
        for name, column in trajectory.columns().items():
            np.testing.assert_array_equal(table[name], column)
        assert sorted(p.name for p in path.parent.iterdir())[: number + 1] == [f"run{i}.csv" for i in range(number + 1)]


def test_units_stand_in_the_header_where_they_are_asked_for(two_links: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    two_links.to_csv(path, units=True)
    header = path.read_text().splitlines()[0]
    assert header == (
        "t (s),energy (J),start_x (m),start_y (m),start_angle (rad),tip_x (m),tip_y (m),tip_angle (rad),"
        "hinge_x (m),hinge_y (m)"
    )
    table, same = read_trajectory(path), read_reference(path)
    assert tuple(table) == tuple(same) == tuple(two_links.columns())
    assert [unit_of(name) for name in ("deflection0_y", "twist1", "joint0", "motor2_rate", "tip_qw", "hinge1_z")] == [
        "", "rad", "rad", "rad/s", "", "m",
    ]  # fmt: skip


def test_it_names_itself_in_a_line(run: Trajectory) -> None:
    """Where it is the last of a cell, or in an interpreter: its arrays would be pages."""
    own = repr(run)
    assert own.startswith(f"<Trajectory of {run.scene.name}: ok, {len(run.t)} instants to ") and len(own) < 120


@pytest.mark.slow
def test_hinges_of_longer_chains_are_numbered() -> None:
    section = Section(5.0, 1e3, 1e3, 0.4, 0.01)
    arm = Arm("three", (Link(0.4, section),) * 3)
    scene = Scene("three", arm, duration=0.02, dt=0.01, loads=(JointTorque(0, constant(0.1)),))
    columns = simulate(scene, segments=1).columns()
    assert list(columns)[8:] == ["hinge1_x", "hinge1_y", "hinge2_x", "hinge2_y"]
    np.testing.assert_allclose(columns["hinge2_x"][0], 0.8)


def test_shapes_and_fields_agree(run: Trajectory, two_links: Trajectory) -> None:
    for trajectory in (run, two_links):
        n, links = trajectory.t.size, trajectory.scene.arm.n_links
        assert trajectory.start.shape == trajectory.tip.shape == trajectory.tip_velocity.shape == (n, 3)
        assert trajectory.hinges.shape == (n, links - 1, 2)
        assert trajectory.joint_angles.shape == trajectory.joint_torque.shape == (n, links)
        assert trajectory.q.shape == trajectory.v.shape == (n, len(trajectory.names))
        np.testing.assert_allclose(trajectory.shapes[:, 0], trajectory.start[:, :2], atol=1e-12)
        np.testing.assert_allclose(trajectory.shapes[:, -1], trajectory.tip[:, :2], atol=1e-9)
        parts = trajectory.kinetic + trajectory.strain_energy + trajectory.gravity
        np.testing.assert_array_equal(trajectory.energy, parts)


def test_samples_land_on_their_instants(run: Trajectory) -> None:
    np.testing.assert_allclose(run.t, np.arange(181) * 0.05, atol=1e-12)
    uneven = simulate(named("robot_arm_motion"), duration=1.0, sample=0.3)
    np.testing.assert_allclose(uneven.t, [0.0, 0.3, 0.6, 0.9, 1.0], atol=1e-12)


def test_prescribed_angle_is_followed(run: Trajectory) -> None:
    np.testing.assert_allclose(run.joint_angles[:, 0], 1.5 * np.minimum(run.t / 5.0, 1.0), atol=1e-12)
    assert np.abs(run.joint_torque[1:]).max() > 1.0  # what enforces it
    rates = np.where(run.t <= 5.0 + 1e-9, 0.3, 0.0)  # at a kink the value just before it
    np.testing.assert_allclose(run.joint_rates[1:, 0], rates[1:], atol=1e-9)


@every([("floating_frame", {"segments": 2}), ("geometrically_exact", {"elements": 5}), ("elastica", {"nodes": 6})])
def test_torque_that_enforces_a_motion_is_that_which_causes_it(formulation: str, options: dict[str, Any]) -> None:
    """A smooth motion's enforcing torque, applied as a load, gives the motion back; the books balance."""
    scene = replace(named("robot_arm_motion_smooth"), duration=4.0)
    options = options | {"dt": 0.005, "sample": 0.005, "rho_inf": 1.0, "estimate_error": False}
    fine = simulate(everything(scene), formulation, **options)
    assert np.abs(fine.balance).max() < 1e-4 * fine.energy.max()
    torque = JointTorque(0, spline_table(fine.t, fine.joint_torque[:, 0]))
    driven = simulate(everything(replace(scene, motions=(), loads=(torque,))), formulation, **options)
    assert np.abs(driven.tip - fine.tip).max() < 1e-4


def test_kinks_after_the_scenes_own_end_count() -> None:
    arm = Arm("rod", (Link(1.0, Section(5.0, 1e3, 1e3, 0.4, 0.01)),), hub_inertia=0.1)
    long = Scene("rod", arm, duration=1.0, dt=0.05, loads=(JointTorque(0, pulse(0.1, 0.62)),))
    short = replace(long, duration=0.5)
    np.testing.assert_array_equal(simulate(short, segments=1, duration=1.0).tip, simulate(long, segments=1).tip)
    assert short.kinks == ()
    assert long.kinks == (0.62,)


def test_energy_balance_closes(two_links: Trajectory) -> None:
    """Work, stored and dissipated energy: the residual falls with the square of the step."""
    worst = []
    for dt in (0.02, 0.01, 0.005):
        arm = Arm("rod", (Link(1.0, Section(5.0, 1e3, 1e3, 0.4, 0.01)),), payload=Payload(0.1, 0.001), tau_d=0.01)
        turn = (Motion("joint0", ramp(0.5, 0.4)),)
        scene = Scene("rod", arm, duration=1.0, dt=dt, sample=0.1, motions=turn, gravity=(0.0, -9.81))
        balance = simulate(everything(scene), segments=2, rho_inf=1.0).balance
        worst.append(float(np.abs(balance).max()))
    assert worst[2] < 1e-3
    assert worst[0] / worst[2] > 8.0
    assert np.abs(two_links.balance).max() < 0.05 * two_links.energy.max()


def test_a_run_that_fails_leaves_what_was_good(tmp_path: Path) -> None:
    failed = simulate(named("robot_arm_motion"), modes=3)
    assert failed.status == "out_of_range"
    assert f"t = {failed.t[-1]:.2g}"[:5] in failed.message
    assert "take more segments" in failed.message
    assert np.isfinite(failed.q).all()
    failed.to_csv(tmp_path / "failed.csv")
    assert read_trajectory(tmp_path / "failed.csv")["t"][-1] == failed.t[-1]


def test_fine_meshes_are_drawn_to_the_tip() -> None:
    scene = named("robot_arm_motion")
    run = simulate(scene, "geometrically_exact", elements=300, duration=scene.dt, estimate_error=False)
    assert run.shapes.shape[1] == 601
    np.testing.assert_allclose(run.shapes[-1, -1], run.tip[-1, :2], atol=1e-12)


def test_arguments_are_numbers_of_any_kind_or_refused() -> None:
    scene = named("robot_arm_motion")
    run = simulate(scene, segments=1, duration=np.float32(0.25), sample=np.int64(1), estimate_error=False)
    assert run.t[-1] == 0.25
    for name in ("duration", "sample", "error_limit", "time_limit"):
        with pytest.raises(ValueError, match=rf"^{name} = -1: must be a positive number"):
            simulate(scene, **{name: -1})
    with pytest.raises(ValueError, match=r"^scene = 'robot_arm_motion': must be a Scene, such as"):
        simulate("robot_arm_motion")


# ------------------------------------------------------ against a reference
def test_tip_error_counts_common_instants_alone() -> None:
    table = {name: np.zeros(5) for name in COLUMNS} | {"t": np.arange(5) * 0.5}
    tip = np.zeros((4, 3))
    tip[2] = 3.0, 4.0, -0.2
    error = tip_error([0.0, 0.3, 0.5 + 1e-12, 1.0], tip, table)
    assert (error.max_tip_error, error.instants, error.time_of_max) == (5.0, 3, 0.5 + 1e-12)
    assert error.rms_tip_error == pytest.approx(5.0 / np.sqrt(3.0))
    assert error.max_tip_angle_error == pytest.approx(0.2)


def test_tip_error_needs_instants_in_common() -> None:
    table = {name: np.zeros(5) for name in COLUMNS} | {"t": np.arange(5) * 0.5}
    with pytest.raises(ValueError, match=r"sample = 0.3: must share instants with the reference.* 0.5 s"):
        tip_error([0.0, 0.3, 0.7], np.zeros((3, 3)), table)


def test_common_instants_pair_up() -> None:
    mine, theirs = common_instants([0.0, 0.1, 0.25, 0.3], [0.05, 0.1, 0.3, 0.35])
    assert mine.tolist() == [1, 3]
    assert theirs.tolist() == [1, 2]
