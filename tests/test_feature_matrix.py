"""Every feature under every formulation, on a bent arm (`feature_matrix.py`): tip, torque, losses, energy, damping."""

import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import steps
from tests import feature_matrix as matrix
from tests.feature_matrix import CORE, PAIRS, POSTURES, SINGLE, TIP, name_of
from tests.scene_tools import everything, tips_apart

OFTEN = [(cell, method) for cell in CORE for method in ("exact", "elastica", "segments", "modes")]
CELLS = [
    (cell, method)
    for cell in SINGLE + PAIRS
    for method in TIP
    if (cell, method) not in OFTEN
    and not (method in matrix.JOINED and matrix.NOT_JOINED & set(cell))
    and not (method in matrix.WHOLE and "curved" in cell)  # bent beyond the range of few modes without any load
]


def check(features: tuple[str, ...], method: str) -> None:
    row = matrix.measure(features, method)
    as_asked = row["bent"] <= 0.1 if method in matrix.WHOLE else row["bent"] >= 0.2
    assert as_asked, "the arm is bent as the cell asks for"
    assert row["tip"] <= TIP[method]
    assert row["torque"] <= matrix.TORQUE
    fronts = not set(matrix.FRONTS).isdisjoint(features)
    if not fronts or ("heavy damping" in features and method not in matrix.WHOLE):
        assert row["dissipated"] <= matrix.DISSIPATED
        assert row["gauge"] <= matrix.GAUGE[method]
    assert row["balance"] <= matrix.BALANCE


@pytest.mark.parametrize(
    ("features", "method"),
    [*OFTEN, pytest.param(matrix.VARYING, "exact", marks=pytest.mark.slow)],
    ids=lambda x: x if isinstance(x, str) else name_of(x),
)
def test_core(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.slow
@pytest.mark.parametrize(("features", "method"), CELLS, ids=lambda x: x if isinstance(x, str) else name_of(x))
def test_all(features: tuple[str, ...], method: str) -> None:
    check(features, method)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["elastica", "segments", "modes in segments"])
@pytest.mark.parametrize("posture", POSTURES)
def test_damping_ratio_about_a_bent_posture(posture: str, method: str) -> None:
    """Light damping: that of bending, zeta = tau_d omega / 2 and a little, and not that of stretch."""
    wanted = matrix.ratio(posture, 1e-3, "exact, fine")
    assert wanted > 1e-4
    assert matrix.ratio(posture, 1e-3, method) == pytest.approx(wanted, rel=matrix.RATIO)


def test_segments_on_the_strip_under_full_torque() -> None:
    """Damped as packaged, +-2 N m switched at random each 0.1 s: 5 segments, 2e-4 of L (they were 2 to 9 % off)."""
    rng = np.random.default_rng(3)
    torque = steps(np.arange(20) * 0.1, 2.0 * rng.choice([-1.0, 1.0], 20))
    loads = (JointTorque(0, torque),)
    scene = everything(Scene("strip", arms.named("strip"), duration=2.0, dt=0.001, sample=0.01, loads=loads))
    runs = [
        simulate(scene, formulation, estimate_error=False, **options)
        for formulation, options in (("floating_frame", {"segments": 5}), ("geometrically_exact", matrix.REFERENCE))
    ]
    assert np.abs(runs[1].tip_deflection).max() > 0.09
    assert tips_apart(runs[0], runs[1]) < 2e-4
    assert runs[0].dissipated[-1] == pytest.approx(runs[1].dissipated[-1], rel=2e-3)
