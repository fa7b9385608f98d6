"""Products and solutions of which models are built."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexarm_env.physics.linalg import product, solve
from tests.processes import python

BUILT = """
import hashlib, numpy as np
from flexarm_env import *
from flexarm_env.envs.vibration import shake
from flexarm_env.physics.assembly import assemble
from flexarm_env.scene import standing_scene

def told(item):
    if isinstance(item, np.ndarray):
        return hashlib.sha256(item.tobytes()).hexdigest()
    return [told(part) for part in item] if isinstance(item, tuple) else repr(item)

material = {"E": 70e9, "rho": 2700.0, "G": 26e9}
tapered, even = Taper((0.03, 0.03), (0.004, 0.002), **material), Section.rectangle(0.03, 0.003, **material)
links = Link(0.6, tapered), Link(0.5, even, curvature=0.3)
arm = Arm("bent", links, payload=Payload(0.1, 1e-3, offset=(0.02, 0.01)))
for name, more in {"elastica": {"nodes": 9}, "geometrically_exact": {"elements": 3, "order": 3}}.items():
    settings = Settings.make(name, dt=0.005, **more)
    system = assemble(standing_scene(arm, 0.005, (0.0, -9.81), (0.3, 0.2)), settings)
    print(name, told(tuple(system.model)), told(system.q0), told(shake(arm, settings, None)) if "nodes" in more else "")
"""


@given(st.integers(1, 6), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_they_are_those_of_numpy(n: int, columns: int, seed: int):
    rng = np.random.default_rng(seed)
    a, b, vector = rng.normal(size=(n, n)) + 3.0 * np.eye(n), rng.normal(size=(n, columns)), rng.normal(size=n)
    for left, right in ((a, b), (a, vector), (vector, a), (vector, vector)):
        assert product(left, right) == pytest.approx(left @ right, abs=1e-12)
    for right in (b, vector):
        assert a @ solve(a, right) == pytest.approx(right, abs=1e-9 * np.linalg.cond(a))
    assert solve(np.eye(n)[::-1], vector) == pytest.approx(vector[::-1])
    with pytest.raises(np.linalg.LinAlgError):
        solve(np.outer(vector, np.zeros(n)), vector)


@pytest.mark.slow
def test_models_have_the_same_bits_where_blas_rounds_otherwise():
    """As OpenBLAS, where NumPy has it, does for other processors."""
    built = {python("-c", BUILT, OPENBLAS_CORETYPE=kind).stdout for kind in ("Haswell", "Prescott", "SkylakeX")}
    assert len(built) == 1 and built.pop().count("geometrically_exact") == 1
