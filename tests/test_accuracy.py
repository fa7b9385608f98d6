"""The estimated error of a run: its parts, the status it leads to, and how it compares with converged solutions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.converged import tip_error
from flexarm_env import arms
from flexarm_env.accuracy import (
    Probe,
    count_steps,
    distance,
    energy_part,
    estimate,
    finer_mesh,
    gear_rate,
    other_mesh,
    rubs,
)
from flexarm_env.parameters import Arm, Joint, Link, Payload, Section
from flexarm_env.rigid import inertia_beyond
from flexarm_env.scene import JointTorque, Motion, Scene
from flexarm_env.scenes import named
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import cycloid, linear_table, ramp
from flexarm_env.time_functions import steps as stairs
from flexarm_env.trajectory import Trajectory
from tests.scene_tools import everything, tips_apart


def true_error(run: Trajectory) -> float:
    """Largest distance of the tip from the converged solution, over L."""
    return tip_error(run.scene.name, run.t, run.tip) / run.scene.arm.total_length


@pytest.mark.parametrize(
    ("scene", "formulation", "options", "status"),
    [
        ("robot_arm_motion", "floating_frame", {}, "ok"),
        pytest.param(
            "robot_arm_motion", "floating_frame", {"segments": 1, "elements": 5, "frame": "root"}, "inaccurate",
            marks=pytest.mark.slow,
        ),
        ("robot_arm_motion", "floating_frame", {"dt": 0.1}, "ok"),
        ("flying_rod", "geometrically_exact", {}, "ok"),
        ("flying_rod_soft", "geometrically_exact", {"elements": 2}, "inaccurate"),
        ("two_link_motion", "elastica", {"nodes": 4}, "inaccurate"),
    ],
)  # fmt: skip
def test_estimate_is_near_the_error(scene: str, formulation: str, options: dict[str, Any], status: str) -> None:
    sample = 0.1 if options.get("dt") == 0.1 else 0.05
    asked = named(scene)
    run = simulate(everything(asked) if asked.loads else asked, formulation, sample=sample, **options)
    if sample == 0.05:
        assert 0.5 < run.error_estimate / true_error(run) < 20.0
    assert run.status == status, run.message
    assert run.error_estimate >= sum(value for name, value in run.error_parts.items() if name != "energy") - 1e-15
    assert set(run.error_parts) >= {"energy", "time_step", "mesh"}


def test_error_limit_is_the_users() -> None:
    run = simulate(named("robot_arm_motion"), duration=1.0, error_limit=1e-6)
    assert run.status == "inaccurate"
    assert "error_limit = 1e-06" in run.message
    assert "dt" in run.message or "segments" in run.message
    assert run.t[-1] == 1.0
    with pytest.raises(ValueError, match="error_limit = -1"):
        simulate(named("robot_arm_motion"), error_limit=-1)


def test_companions_can_be_left_out() -> None:
    scene = named("robot_arm_motion")
    plain = simulate(scene, duration=1.0, estimate_error=False)
    judged = simulate(scene, duration=1.0)
    np.testing.assert_array_equal(plain.q, judged.q)
    assert set(plain.error_parts) == {"energy"}
    assert np.isnan(plain.error_estimate), "what is not known must not read as exact"
    assert plain.steps == judged.steps


@pytest.mark.slow
def test_failed_runs_have_no_estimate() -> None:
    run = simulate(named("spin_up"), segments=1, elements=5, coupling="linear", frame="root", dt=0.02)
    assert run.status == "diverged"
    assert np.isnan(run.error_estimate)


def test_a_time_out_is_a_failure() -> None:
    run = simulate(named("robot_arm_motion"), dt=1e-5, time_limit=0.05)
    assert run.status == "timed_out"
    assert 0.0 <= run.t[-1] < 9.0
    assert np.isfinite(run.q).all()


def test_kinks_in_every_step_are_no_way_round() -> None:
    """Where twice the step cannot be taken, half of it is."""
    arm = Arm("rod", (Link(1.0, Section(5.0, 1e3, 1e3, 0.4, 0.01)),), hub_inertia=0.05)
    signs = np.resize([1.0, -1.0, -1.0, 1.0, 1.0], 20)
    torque = JointTorque(0, stairs(np.arange(20) * 0.05, signs))
    scene = everything(Scene("bang", arm, duration=1.0, dt=0.05, loads=(torque,)))
    coarse = simulate(scene)
    fine = simulate(scene, dt=0.05 / 16, sample=0.05)
    error = tips_apart(coarse, fine)
    assert coarse.error_parts["time_step"] > 0.2 * error > 0.0


@pytest.mark.parametrize(
    ("formulation", "options", "other", "finer"),
    [
        ("floating_frame", {"segments": 5, "coupling": "paper"}, {"segments": 3, "coupling": "von_karman"},
         {"segments": 10}),
        ("floating_frame", {"segments": 1, "elements": 5}, {"segments": 2, "elements": 3}, {"segments": 2}),
        ("floating_frame", {"modes": 2}, {"segments": 5, "modes": None}, {"segments": 8, "modes": None}),
        ("geometrically_exact", {"elements": 5}, {"elements": 3}, {"elements": 10}),
        ("geometrically_exact", {"elements": 1}, {"elements": 2}, {"elements": 2}),
        ("elastica", {"nodes": 6}, {"nodes": 4}, {"nodes": 8}),
        ("elastica", {"nodes": 3}, {"nodes": 5}, {"nodes": 5}),
        ("elastica", {"nodes": 12}, {"nodes": 10}, {"nodes": 11}),
    ],
)  # fmt: skip
def test_other_meshes(formulation: str, options: dict[str, Any], other: dict[str, Any], finer: dict[str, Any]) -> None:
    settings = Settings.make(formulation, dt=0.01, **options)
    companion, factor = other_mesh(settings)
    assert {name: getattr(companion, name) for name in other} == other
    assert {name: getattr(finer_mesh(settings), name) for name in finer} == finer
    assert factor in (0.5, 1.0)
    assert companion.dt == 0.01


def test_steps_are_counted_as_they_are_taken() -> None:
    for name, dt, sample in (("robot_arm_motion", 0.03, 0.05), ("flying_rod", 0.05, 0.3)):
        scene = everything(replace(named(name), duration=3.0))
        run = simulate(scene, "geometrically_exact", dt=dt, sample=sample, estimate_error=False)
        assert run.steps == count_steps(scene, run.settings.replace(dt=dt), 3.0, sample)


@pytest.mark.parametrize("asked", [0.05, 0.019])
def test_steps_that_samples_or_kinks_cut_short_are_right(asked: float) -> None:
    """Elasticas' inertia is that of the steps which are taken, not of a longer one that was asked for (theory, 5.3)."""
    arm = arms.named("strip")
    t = np.arange(0.0, 0.6025, 0.0025)
    drive = cycloid(rise=1.2, duration=0.6)
    smooth = Scene("smooth", arm, duration=2.0, dt=0.0025, motions=(Motion("joint0", drive),))
    rough = replace(smooth, motions=(Motion("joint0", linear_table(t, [drive(x) for x in t])),))
    right = simulate(smooth, "elastica", dt=0.000625, sample=0.1, estimate_error=False)
    for scene, sample, near in ((smooth, 0.0025, 1e-4), (rough, 0.02, 1e-3)):
        run = simulate(scene, "elastica", dt=asked, sample=sample)
        assert run.status == "ok"
        assert run.settings.dt == pytest.approx(0.0025, rel=1e-6)
        off = np.hypot(*(run.tip[:: round(0.1 / sample)] - right.tip)[:, :2].T).max()
        assert off <= near * arm.total_length
        assert off <= run.error_estimate * arm.total_length


def test_distance_over_common_instants() -> None:
    fine = Probe(np.arange(5) * 0.1, np.zeros((5, 2)), True)
    coarse = Probe(np.array([0.0, 0.2, 0.4]), np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]]), True)
    assert distance(fine, coarse) == distance(coarse, fine) == 5.0
    assert distance(fine, replace(coarse, good=False)) == float("inf")


def test_energy_that_appears_counts_more() -> None:
    assert energy_part(np.array([0.0, 0.1]), 10.0) == pytest.approx(0.05)
    assert energy_part(np.array([0.0, -0.1]), 10.0) == pytest.approx(0.005)
    assert energy_part(np.array([0.0]), 0.0) == 0.0


@pytest.mark.parametrize(("formulation", "zeta"), [("elastica", 5.0), ("geometrically_exact", 1.0)])
def test_steps_that_resolve_nothing_do_not_pass_for_exact(formulation: str, zeta: float) -> None:
    """An overdamped link whose hub is turned at once: runs of h and of 2 h are wrong alike."""
    slow = (2.0 * np.pi) / np.sqrt(3.0 / (0.5 + 33.0 / 140.0))  # period of the first vibration, EI = m = L = 1
    payload, section = Payload(0.5, 0.005), Section(1.0, 1e6, 4e5, 1.0, 1e-6)
    arm = Arm("slow", (Link(1.0, section),), payload=payload, tau_d=zeta * slow / np.pi)
    motions = (Motion("joint0", ramp(1.5, 0.5 * slow)),)
    scene = everything(Scene("turned", arm, duration=3.0 * slow, dt=0.3 * slow, motions=motions))
    run = simulate(scene, formulation)
    fine = simulate(scene, "elastica", dt=0.003 * slow, estimate_error=False)
    error = tips_apart(run, fine)
    assert error > 0.03
    assert error / 3.0 < run.error_estimate < 3.0 * error


GEARED = Arm(
    "geared", (Link(0.8, Section.rectangle(0.03, 0.003, 7e10, 2700.0, 2.6e10)),), hub_inertia=0.02,
    payload=Payload(0.1, 1e-4), tau_d=1e-3, joints=(Joint(stiffness=40.0, damping=0.05, motor_inertia=0.03),),
)  # fmt: skip


def test_a_gear_that_the_step_does_not_resolve_is_seen() -> None:
    """A rotor that swings at 10 Hz in steps of 15 ms is out of phase in runs of one step and of twice that alike."""
    rate = np.sqrt(40.0 * (1.0 / 0.03 + 1.0 / inertia_beyond(GEARED, 0)))
    assert gear_rate(Scene("s", GEARED, duration=1.0, dt=0.01)) == pytest.approx(rate)
    torque = JointTorque(0, stairs([0.0, 0.07, 0.19, 0.31, 0.52], [2.0, -1.5, 2.0, -2.0, 1.0]))
    scene = everything(Scene("s", GEARED, duration=0.8, dt=0.015, sample=0.02, loads=(torque,)))
    fine = simulate(scene, "geometrically_exact", dt=5e-4, elements=8, estimate_error=False)
    for formulation in ("floating_frame", "elastica"):
        run = simulate(scene, formulation)
        assert tips_apart(run, fine) < 1.5 * run.error_estimate


def test_steps_count_whole_where_joints_stick_or_play() -> None:
    """The error is of first order there: the distance from a run of twice the step is all of it."""
    ideal = Scene("s", ARM_OF_LINK, duration=1.0, dt=0.01, loads=(JointTorque(0, cycloid(1.0, 1.0)),))
    rubbing = replace(ideal, arm=replace(ARM_OF_LINK, joints=(Joint(friction_coulomb=0.1),)))
    assert rubs(rubbing) and not rubs(ideal)

    def run(scene: Scene, settings: Settings, *_: Any) -> Probe:
        off = np.zeros((3, 2))
        off[:, 0] = settings.dt
        return Probe(np.arange(3.0), off, True)

    settings = Settings.make("geometrically_exact", dt=0.01)
    parts = [
        estimate(scene, settings, run(scene, settings), 1.0, 1.0, run)[0]["time_step"] for scene in (ideal, rubbing)
    ]
    assert parts == pytest.approx([0.005, 0.01])


ARM_OF_LINK = Arm("a", (Link(1.0, Section(5.0, 1e3, 1e3, 0.4, 0.01)),))
