"""Every feature in space on bent and twisted arms (`feature_matrix_space.py`): tip, its axes, torque, losses."""

import numpy as np
import pytest

from flexarm_env.simulation import simulate
from tests import feature_matrix_space as matrix
from tests.feature_matrix_space import JOINTED, METHODS, PAIRS, PERIODS, SINGLE, TIP, name_of
from tests.oracle_space import GAUGE

CORE = [
    ("torques and tip load",),
    ("elbow",),
    ("elbow", "free flight"),
    ("elbow", "shaken base"),
    ("prescribed elbow", "gravity"),
]
"""Of every run of the tests, by the exact beam: of one compiled form, or of one more. By frames the second alone."""
_ELBOWS = [cell for cell in PAIRS if "elbow" in cell]
_BESIDE = {"modes": JOINTED, "elastica": matrix.SHEARED}
CELLS = [
    *((cell, "exact") for cell in SINGLE + PAIRS if cell not in CORE),
    *((cell, "floating") for cell in SINGLE + PAIRS if cell != CORE[1] and (cell in SINGLE or not JOINTED & {*cell})),
    *((cell, "modes") for cell in SINGLE + _ELBOWS if not JOINTED & {*cell}),
    *((cell, method) for cell in PERIODS for method in METHODS if not _BESIDE.get(method, set()) & {*cell}),
    *((cell, "elastica") for cell in SINGLE + PAIRS if cell != CORE[1] and not matrix.SHEARED & {*cell}),
]


def check(features: tuple[str, ...], method: str) -> None:
    row = matrix.measure(features, method)
    assert row["bent"] >= 0.2 and row["twist"] >= 10.0
    assert matrix.reference(features)["numbers"][3] < matrix.OWN
    assert row["tip"] <= TIP[method]
    assert row["turn"] <= matrix.TURN[method]
    assert row["torque"] <= matrix.TORQUE
    assert row["dissipated"] <= matrix.DISSIPATED
    assert row["balance"] <= matrix.BALANCE


@pytest.mark.slow
@pytest.mark.parametrize("features", CORE, ids=name_of)
def test_core(features: tuple[str, ...]) -> None:
    check(features, "exact")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["floating", "elastica"])
def test_core_of_the_others(method: str) -> None:
    check(CORE[1], method)


@pytest.mark.slow
@pytest.mark.parametrize(("features", "method"), CELLS, ids=lambda x: x if isinstance(x, str) else name_of(x))
def test_all(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("features", "method"),
    [(cell, method) for cell, method in CELLS if cell in PERIODS[-2:]],
    ids=lambda x: x if isinstance(x, str) else name_of(x),
)
def test_lanes_are_arms_alone_and_steps_are_short_enough(features: tuple[str, ...], method: str) -> None:
    found = matrix.beside(features, method)
    assert found["differ"] == 0.0 and found["halved"] < 1e-4


@pytest.mark.slow
def test_what_sensors_read_is_what_the_oracle_moves_by() -> None:
    """Gauges of both bendings and torsion, an accelerometer (the mean of a period: in its middle), a gyroscope."""
    period, features = 0.004, ("gravity", "payload")
    scene = matrix.scene_of(features)
    gauges = [{"place": GAUGE, "measures": what} for what in ("torsion", "xz", "xy")]
    at = np.arange(10, 200, 10)
    wanted = matrix.computed(features, 4, np.sort(np.concatenate([at - 0.5, at])) * period)
    groups = [
        (wanted["felt"][::2], [f"tip_acceleration_{axis}" for axis in "xyz"], 0.003),
        (wanted["spin"][1::2], [f"gyroscope_{axis}" for axis in "xyz"], 0.005),
        (wanted["strains"][1::2, 0] * [1.0, -1.0, 1.0], [f"strain_gauge_{k}" for k in (1, 2, 3)], 0.006),
    ]
    for method in ("exact", "floating", "elastica"):
        formulation, options = matrix.METHODS[method]
        run = simulate(scene, formulation, estimate_error=False, sample=period, **options)
        seen = run.measured({"strain_gauges": gauges, "accelerometer": {}, "gyroscope": {}})
        for other, names, most in groups:
            found = np.stack([seen[name][at] for name in names], axis=1)
            assert np.abs(found - other).max() < most * np.abs(other).max(), (method, names)


@pytest.mark.slow
def test_what_is_kept_of_the_oracle_is_what_it_computes() -> None:
    """One cell anew, with a polynomial less."""
    features = ("prescribed hub",)
    kept, again = matrix.reference(features), matrix.computed(features, 5)
    assert np.abs(kept["tip"] - again["tip"]).max() < matrix.OWN
    assert np.abs(kept["torque"][:, :1] - again["torque"]).max() < 1e-3 * np.abs(kept["torque"]).max()
