"""What every formulation owes the integrator, on plain Python numbers: damping forces that come from a potential, and
coordinates that move as they say; `test_uncompiled.py` runs this file with FLEXARM_COMPILER=python."""

import math
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import SINGLE, UNCOMPILED, load, store
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.assembly import assemble
from flexarm_env.physics.model import TAU_D, ExactBeam
from flexarm_env.physics.protocol import FORMULATIONS, NewtonPolicy, damping_power
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation
from tests.uncompiled_tools import Equations

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")

SECTION = Section(EI=3.0, EA=4e3, C=2e3, m=0.5, J=0.02)
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "exact": ("geometrically_exact", {"elements": 2}),
    "exact, cubic": ("geometrically_exact", {"elements": 1, "order": 3}),
    "elastica": ("elastica", {"nodes": 4}),
    "one frame a link": ("floating_frame", {"segments": 1, "elements": 3, "frame": "root"}),
    "segments": ("floating_frame", {"segments": 2, "frame": "root"}),
    "chord": ("floating_frame", {"segments": 2, "frame": "chord"}),
    "modes": ("floating_frame", {"modes": 2, "frame": "root"}),
    "linear": ("floating_frame", {"segments": 2, "coupling": "linear"}),
    "multipliers": ("floating_frame", {"segments": 2, "multipliers": True}),
    "paper": ("floating_frame", {"segments": 1, "elements": 2, "coupling": "paper", "multipliers": True}),
}


def scene(mass_damping: float = 0.0) -> Scene:
    """Two unlike links, bent at the elbow, damped."""
    links = (Link(0.7, SECTION), Link(0.4, SECTION))
    arm = Arm(
        "two", links, hub_inertia=0.05, elbows=(Elbow(0.1, 0.01, 0.02),), payload=Payload(0.2, 0.03), tau_d=0.02,
        mass_damping=mass_damping,
    )  # fmt: skip
    return Scene("s", arm, duration=1.0, dt=0.01, angles=(0.3, 1.1))


@pytest.mark.parametrize(
    ("method", "drag"), [(method, 0.0) for method in METHODS] + [("one frame a link", 0.3), ("modes", 0.3)]
)
def test_damping_forces_are_the_slopes_of_rayleighs_function(method: str, drag: float) -> None:
    """R(q, v) is half the power that is lost at rates v; x'C(q) v, at any rates x, is x . dR/dv, and what the equations
    of motion lose when damping is taken away. Bent and stretched, where the strains' rates are not linear in q."""
    formulation, options = METHODS[method]
    settings = Settings.make(formulation, dt=0.01, **options)
    damped, without = (Equations(assemble(scene(own), settings)) for own in (drag, 0.0))
    without.par[TAU_D] = 0.0
    rng, moving = np.random.default_rng(1), np.ones(damped.n, bool)
    moving[[*damped.model.fixed, *damped.constrained]] = False
    q = damped.system.q0 + 0.05 * moving * rng.standard_normal(damped.n)
    v, x = moving * rng.standard_normal((2, damped.n))

    def rayleigh(rates: np.ndarray) -> float:
        return 0.5 * float(damping_power(SINGLE, damped.model, damped.par, q, rates, rates))

    assert rayleigh(v) > 0.0
    slope = 0.5 * (rayleigh(v + x) - rayleigh(v - x))  # exact of a quadratic function
    work = float(damping_power(SINGLE, damped.model, damped.par, q, v, x))
    assert abs(work) > 1e-3 * math.sqrt(rayleigh(v) * rayleigh(x))
    assert work == pytest.approx(slope, rel=1e-9)
    state = q, v, np.zeros(damped.n), np.zeros(damped.n_inputs)
    lost = damped.residual(*state) - without.residual(*state)
    assert work == pytest.approx(float(x @ lost), rel=1e-8)


class Wrapped(ExactBeam):
    """Two links of one linear element: the second one's angles are told within half a turn of the elbow, as rotations
    in space would be."""

    __slots__ = ()


TIP_ANGLE, ELBOW = 8, 9
"""Rows of the second link's angles."""

updates: list[int] = []


def wrapped_update(lane: Any, model: Any, q: Any, share: float, d: Any, more: Any) -> None:
    """Their sum, with whole turns of the elbow taken out."""
    updates.append(1)
    for k in range(model.n):
        store(q, k, load(lane, q, k) + share * load(lane, d, k) + (0.0 if more is None else load(lane, more, k)))
    turns = math.floor(q[ELBOW] / (2.0 * math.pi) + 0.5)
    q[TIP_ANGLE] -= 2.0 * math.pi * turns
    q[ELBOW] -= 2.0 * math.pi * turns


def test_coordinates_move_as_their_formulation_says() -> None:
    """An elbow that spins: predictor and Newton's iteration take its turns out, and the arm moves as it always does."""
    FORMULATIONS.register(Wrapped, **{**FORMULATIONS.members[ExactBeam], "retract": wrapped_update})
    runs = []
    for kind in (ExactBeam, Wrapped):
        run = Simulation(scene(), Settings.make("geometrically_exact", elements=1, order=1, dt=0.01))
        assert run.system.coordinates["joint1"] == ELBOW and len(run.work.q) == ELBOW + 1
        # no prediction of its own, which knows nothing of turns
        run.model = kind(*run.model._replace(newton=NewtonPolicy(acceleration_share=1.0)))
        run.set_torques(np.array([0.0, 4.0]))
        found = []
        for k in range(40):
            assert run.advance_to(0.01 * (k + 1), account=False), run.message
            found.append(run.work.q.copy())
        runs.append(np.array(found))
    turns = (runs[0] - runs[1]) / (2.0 * math.pi)
    assert np.abs(runs[1][:, ELBOW]).max() <= math.pi and np.round(turns[-1, ELBOW]) >= 1.0
    assert np.abs(turns - np.round(turns)).max() < 1e-9
    assert not np.round(turns)[:, :TIP_ANGLE].any()
    iterations, _, _, steps = run.work.counts
    assert len(updates) == iterations + steps  # one for a prediction
