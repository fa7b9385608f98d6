"""Every feature in space on bent and twisted arms (`feature_matrix_space.py`): tip, its axes, torque, losses."""

from __future__ import annotations

import numpy as np
import pytest

from tests import feature_matrix_space as matrix
from tests.feature_matrix_space import PAIRS, SINGLE, TIP, name_of

CORE = [
    ("torques and tip load",),
    ("elbow",),
    ("elbow", "free flight"),
    ("elbow", "shaken base"),
    ("prescribed elbow", "gravity"),
]
"""Of every run of the tests, by the exact beam: of one compiled form, or of one more. By frames the second alone."""
_ELBOWS = [cell for cell in PAIRS if "elbow" in cell]
CELLS = [
    *((cell, "exact") for cell in SINGLE + PAIRS if cell not in CORE),
    *((cell, "floating") for cell in SINGLE + PAIRS if cell != CORE[1]),
    *((cell, "modes") for cell in SINGLE + _ELBOWS),
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


@pytest.mark.parametrize("features", CORE, ids=name_of)
def test_core(features: tuple[str, ...]) -> None:
    check(features, "exact")


def test_core_of_frames() -> None:
    check(CORE[1], "floating")


@pytest.mark.slow
@pytest.mark.parametrize(("features", "method"), CELLS, ids=lambda x: x if isinstance(x, str) else name_of(x))
def test_all(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.slow
def test_what_is_kept_of_the_oracle_is_what_it_computes() -> None:
    """One cell anew, with a polynomial less."""
    features = ("prescribed hub",)
    kept, again = matrix.reference(features), matrix.computed(features, 5)
    assert np.abs(kept["tip"] - again["tip"]).max() < matrix.OWN
    assert np.abs(kept["torque"][:, :1] - again["torque"]).max() < 1e-3 * np.abs(kept["torque"]).max()
