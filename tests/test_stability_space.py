"""A part of the stability sweep in space: what a run in space says of itself."""

import numpy as np
import pytest

from benchmarks import stability, stability_space
from flexarm_env.accuracy import Probe, distance
from flexarm_env.physics.space.reading import TURN, tips
from flexarm_env.simulation import simulate

CASES = stability_space.cases()


def test_a_tip_whose_axes_are_off_is_off() -> None:
    """One that turns about itself, by half a turn at the second instant: no place of it moves."""
    scene, *_ = stability_space.scene_of({**CASES[0], "links": 1})
    settings = scene.settings("geometrically_exact", elements=1)
    still, turned = np.zeros((2, 2, 13))
    turned[1, 10] = np.pi  # the last vertex's rotation, about x
    found = [Probe(np.arange(2.0), tips(scene.arm, settings, q), True) for q in (still, turned)]
    assert np.array_equal(found[0].tip[:, 0], found[1].tip[:, 0])
    assert distance(*found) == pytest.approx(2.0 * TURN * scene.arm.total_length)


def test_there_are_thousands_of_them() -> None:
    assert len(CASES) >= 2000
    twists = [case for case in CASES if case["family"] == "twist"]
    assert max(case["amplitude"] for case in twists) > np.pi
    assert max(case["stiff"] for case in CASES) == 1e14


@pytest.mark.slow
def test_steps_that_do_not_resolve_a_twist_are_told() -> None:
    case = next(c for c in CASES if (c["family"], c["method"], c["amplitude"], c["h"]) == ("twist", "exact", 3.0, 0.1))
    scene, formulation, options = stability_space.scene_of(case)
    run = simulate(scene, formulation, **options)
    place, turn = stability.apart(
        run, simulate(scene, formulation, estimate_error=False, **options | {"dt": 0.1 * scene.dt})
    )
    assert turn > 0.2 and place < 0.05
    assert run.error_estimate > TURN * turn / 3.0


@pytest.mark.slow
def test_none_of_these_is_silently_wrong() -> None:
    for case in [case for case in CASES if case["family"] == "twist"][::25]:
        row = stability_space.measure(case)
        assert stability.outcome(row) in ("ok", "inaccurate", "failed"), case
