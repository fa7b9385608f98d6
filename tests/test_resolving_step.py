"""Motions and loads that are faster than the step: the step that resolves them, and runs that take it."""

import math

import numpy as np
import pytest

from flexarm_env.parameters import Arm, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, Scene, resolving_step
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import TimeFunction, constant, cycloid, from_array, linear_table, pulse, sine, steps
from tests.scene_tools import everything, tips_apart

DT = 0.01
SECTION = Section.rectangle(0.03, 0.004, 7e10, 2700.0, 2.6e10)
ARM = Arm("a", (Link(0.5, SECTION), Link(0.5, SECTION)), hub_inertia=0.01, payload=Payload(0.1, 1e-5))


def driven(torque: TimeFunction, duration: float = 1.0) -> Scene:
    loads = (JointTorque(0, torque),)
    return everything(Scene("s", ARM, duration=duration, dt=DT, sample=0.05, loads=loads))


@pytest.mark.parametrize("formulation", ["elastica", "floating_frame", "geometrically_exact"])
def test_a_load_with_the_period_of_the_step_is_no_constant(formulation: str) -> None:
    """2 N m cos(2 pi t / dt) moves the tip by 1e-5 of the length; as a constant it moves it by 2 lengths."""
    scene = driven(sine(2.0, 2.0 * math.pi / DT, 0.5 * math.pi))
    run = simulate(scene, formulation)
    other = "elastica" if formulation == "geometrically_exact" else "geometrically_exact"
    fine = simulate(scene, other, dt=DT / 64, estimate_error=False)
    assert run.settings.dt == pytest.approx(DT / 16)
    assert tips_apart(run, fine) < max(1.5 * run.error_estimate, 1e-4)
    assert tips_apart(run, fine) < 1e-3


def test_the_step_follows_a_table_between_whose_rows_it_would_step() -> None:
    """Splines have no kinks for steps to end at: 1 kHz rows of a 100 Hz wave."""
    t = np.arange(0.0, 1.0005, 0.001)
    spline = from_array(np.column_stack([t, 2.0 * np.cos(2.0 * math.pi * t / DT)]))
    assert resolving_step(driven(spline), DT, 1.0) <= DT / 4
    slow = from_array(np.column_stack([t, 2.0 * np.cos(2.0 * math.pi * t)]))
    assert resolving_step(driven(slow), DT, 1.0) == DT
    noise = from_array(np.column_stack([t, np.cos(2.0 * math.pi * t) + 0.01 * np.cos(2.0 * math.pi * t / DT)]))
    assert resolving_step(driven(noise), DT, 1.0) == DT


@pytest.mark.parametrize(
    ("torque", "limit"),
    [
        (constant(1.0), DT),
        (sine(1.0, 2.0 * math.pi / (16.0 * DT)), DT),
        (sine(1.0, 2.0 * math.pi / (8.0 * DT)), DT / 2),
        (sine(1e-12, 1e6, offset=1.0), DT),
        (pulse(1.0, 0.001), DT),  # steps end at its kinks
        (steps([0.0, 0.001, 0.0015], [1.0, -1.0, 0.0]), DT),
        (linear_table([0.0, 0.001, 0.002], [0.0, 1.0, 0.0]), DT),
        (
            TimeFunction([[0.0, 0, 0, 0, 0, 1.0, 100.0, 0.0], [0.005, 0, 0, 0, 0, 0, 0, 0]]),
            DT,
        ),  # half a radian of a sine
    ],
)
def test_steps_are_as_short_as_a_function_asks_for(torque: TimeFunction, limit: float) -> None:
    assert resolving_step(driven(torque), DT, 1.0) == pytest.approx(limit, rel=1e-12)


def test_what_begins_after_the_end_asks_for_nothing() -> None:
    late = TimeFunction([[0.0, 0, 0, 0, 0, 0, 0, 0], [0.5, 0, 0, 0, 0, 1.0, 1e4, 0.0]])
    assert resolving_step(driven(late), DT, 0.4) == DT
    assert resolving_step(driven(late), DT, 1.0) < DT / 10


def test_motions_are_resolved_as_well() -> None:
    scene = Scene("s", ARM, duration=1.0, dt=DT, motions=(Motion("joint0", cycloid(1.0, 0.08)),))
    assert resolving_step(scene, DT, 1.0) == pytest.approx(0.005)


def test_a_load_that_no_run_can_resolve_is_refused() -> None:
    message = r"^loads\[0\] = 'too fast for dt = 0.01 s': must be slower: the function needs steps of at most 3.9e-10 s"
    with pytest.raises(ValueError, match=message):
        simulate(driven(sine(1.0, 1e9)), "elastica")
