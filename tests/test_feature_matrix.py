"""Every feature under every formulation, on a bent arm (`feature_matrix.py`): tip, torque, losses, energy, damping."""

from __future__ import annotations

import pytest

from tests import feature_matrix as matrix
from tests.feature_matrix import CORE, PAIRS, POSTURES, SINGLE, TIP

HELD = tuple(TIP)


def check(features: tuple[str, ...], method: str) -> None:
    row = matrix.measure(features, method)
    assert (row["bent"] <= 0.1) if method == "modes" else (row["bent"] >= 0.2), "the arm is bent as the cell asks for"
    assert row["tip"] <= TIP[method]
    assert row["torque"] <= matrix.TORQUE
    fronts = not set(matrix.FRONTS).isdisjoint(features)
    if not fronts or ("heavy damping" in features and method != "modes"):
        assert row["dissipated"] <= matrix.DISSIPATED
    assert row["balance"] <= matrix.BALANCE


def name(features: tuple[str, ...]) -> str:
    return " + ".join(features)


@pytest.mark.parametrize("method", HELD)
@pytest.mark.parametrize("features", CORE, ids=name)
def test_core(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.slow
@pytest.mark.parametrize("method", HELD)
@pytest.mark.parametrize("features", [cell for cell in SINGLE + PAIRS if cell not in CORE], ids=name)
def test_all(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.parametrize("method", ["elastica", "segments", "modes in segments"])
@pytest.mark.parametrize("posture", POSTURES)
def test_damping_ratio_about_a_bent_posture(posture: str, method: str) -> None:
    """Light damping: that of bending, zeta = tau_d omega / 2 and a little, and not that of stretch."""
    wanted = matrix.ratio(posture, 1e-3, "exact, fine")
    assert wanted > 1e-4
    assert matrix.ratio(posture, 1e-3, method) == pytest.approx(wanted, rel=matrix.RATIO)
