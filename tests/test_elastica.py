"""The elastica: known answers, energy, orders of convergence, the slender strip against the exact beam, lanes."""

from typing import Any

import numpy as np
import pytest

from benchmarks.formulation_runs import ARMS, driven, known_path, long_run, release
from flexarm_env import simulate
from flexarm_env.compiler.decorator import kernel
from flexarm_env.compiler.lanes import EIGHT, SINGLE, load, sincos, store
from flexarm_env.linear import static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.elastica.build import phase_correction
from flexarm_env.physics.elastica.chain import chain, nodes
from flexarm_env.physics.elastica.slenderness import stretch_and_shear
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.scenes import named, reference
from flexarm_env.settings import Settings
from flexarm_env.time_functions import TimeFunction, constant, pulse, sine
from flexarm_env.trajectory import Trajectory
from tests.linear_tools import at_rest, one_link
from tests.processes import ROOT, uncompiled_tests
from tests.scene_tools import everything, tips_apart

from .oracle_elastica import Oracle, oracle_nodes

ONE, TWO = ARMS["strip"], ARMS["two strips"]


@pytest.mark.slow
def test_uncompiled() -> None:
    """Residual, tangent, energies and output against the oracle, for chains and features (`uncompiled_elastica.py`)."""
    uncompiled_tests("uncompiled_elastica.py")


# ----------------------------------------------------------------------------- tables and known answers
@pytest.mark.parametrize("n", [3, 5, 8, 12])
@pytest.mark.parametrize("tip", [False, True])
def test_nodes(n: int, tip: bool) -> None:
    found = nodes(n, tip)
    assert found[0] == -1.0
    assert not tip or found[-1] == 1.0
    assert found == pytest.approx(oracle_nodes(n, tip), abs=1e-13)


def test_large_deflection_of_a_cantilever() -> None:
    """Tip force P L^2 / EI = 10: Bisshopp & Drucker 1945, by elliptic integrals; spectral convergence."""
    scene = at_rest(one_link(), loads=(PointLoad(0, "tip", force_y=constant(10.0)),))
    tips = [static_equilibrium(scene, "elastica", nodes=n).observe()[0][0, 6:8] for n in (4, 6, 8, 12)]
    assert tips[-1] == pytest.approx([1.0 - 0.5550, 0.8106], abs=1e-4)
    errors = [float(np.hypot(*(tip - tips[-1]))) for tip in tips]
    assert errors[0] < 3e-3
    assert errors[1] < errors[0] / 8
    assert errors[2] < errors[1] / 8


def frequencies(M: Any, K: Any) -> Any:
    return np.sort(np.sqrt(np.maximum(np.linalg.eigvals(np.linalg.solve(M, K)).real, 0.0)))


def test_frequencies_of_a_cantilever() -> None:
    """beta L = 1.87510, 4.69409, 7.85476, approached spectrally."""
    bare = Arm("beam", (Link(1.0, Section(EI=1.0, EA=1.0, C=1.0, m=1.0, J=0.0)),))
    exact = np.array([1.875104068712, 4.694091132974, 7.854757438238]) ** 2
    errors = []
    for n in (5, 7, 9):
        parts = chain(bare, n)
        errors.append(np.abs(frequencies(parts.P[1:, 1:], parts.K_EI[0][1:, 1:])[:3] / exact - 1.0))
    assert (errors[2] < [1e-9, 1e-6, 1e-4]).all()
    assert (errors[1] < errors[0] / 10)[:2].all() and (errors[2] < errors[1] / 10).all()


def test_correction_keeps_periods() -> None:
    """Trapezoidal steps lengthen a period by (omega h)^2 / 12; with the corrected inertia not, where h resolves it."""
    h, options = 0.01, Settings.make("elastica", nodes=8)
    assert options.period_error == pytest.approx(1 / 12)
    assert Settings.make("elastica", newmark=(1 / 6, 0.5)).period_error == pytest.approx(1 / 24)
    parts = chain(ONE, 8)
    C = phase_correction(parts, 0.2, parts.w[None], None, h, options)[0]
    assert np.abs(C.sum(axis=0)).max() < 1e-14 * np.abs(C).max() * 8
    M, K = parts.P + 0.2 * np.outer(parts.w, parts.w) + parts.R[0], parts.K_EI[0]
    assert np.linalg.eigvalsh(M - C).min() > 0.0

    def stepped(inertia: Any) -> Any:
        return 2.0 / h * np.arctan(0.5 * h * frequencies(inertia[1:, 1:], K[1:, 1:]))

    true, plain, kept = frequencies(M[1:, 1:], K[1:, 1:]), stepped(M), stepped(M - C)
    assert (true[:2] * h).tolist() == pytest.approx([0.0889, 0.8304], rel=2e-3)
    assert 1 - (plain / true)[:2] == pytest.approx((true[:2] * h) ** 2 / 12, rel=0.2)
    assert np.abs(kept / true - 1)[0] < 2e-5 and np.abs(kept / true - 1)[1] < 1.2e-2
    # Modes that the step does not resolve are heavier: none is faster than about sqrt(10) / h, however stiff.
    assert true.max() * h > 50.0
    assert frequencies((M - C)[1:, 1:], K[1:, 1:]).max() * h < 1.1 * np.sqrt(10.0)


# ----------------------------------------------------------------------------- motion
@pytest.mark.slow
def test_energy_over_many_steps() -> None:
    """The strip let go from a static tip deflection of 20 % of L, held by its hub's own inertia alone."""
    coarse, fine = long_run(release(5e-3), 20_000), long_run(release(2.5e-3))
    assert fine["status"] == 0 and fine["wobble"] <= 1e-4 and fine["drift"] <= 1e-6
    assert np.log2(coarse["wobble"] / fine["wobble"]) == pytest.approx(2.0, abs=0.3)


def test_against_scipy_and_order_two() -> None:
    """Steps approach what SciPy makes of the oracle's equations, at second order."""
    link = Link(1.0, Section(EI=0.4, EA=1e6, C=1e6, m=0.5, J=1e-3))
    arm = Arm("soft", (link,), hub_inertia=0.05, payload=Payload(0.1, 1e-3), tau_d=2e-3)
    scene, times = Scene("s", arm, duration=0.3, dt=0.01, loads=(JointTorque(0, sine(1.2, 9.0)),)), np.array([0.0, 0.3])
    oracle, errors = Oracle(scene, 3), []
    truth = oracle.run(np.zeros(3), np.zeros(3), lambda t: np.array([1.2 * np.sin(9.0 * t)]), times)[-1]
    tip = oracle.walk(truth[:3], truth[3:])[-1][0]["tip"]
    assert np.abs(truth[:3]).max() > 0.3
    for dt in (0.01, 0.005, 0.0025):
        run = simulate(scene, "elastica", nodes=3, dt=dt, sample=0.3)
        assert run.status == "ok"
        errors.append(float(np.hypot(*(run.tip[-1, :2] - tip))))
    assert errors[2] < 1e-4
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.35)


def test_smooth_motion_of_the_stubby_arm() -> None:
    """1.8 % of L from the exact beam, at any n: what stretch and shear make there; the estimate says so beforehand."""
    scene = named("robot_arm_motion_smooth")
    columns = reference("robot_arm_motion_smooth").columns
    for n in (6, 8):
        run = simulate(scene, "elastica", nodes=n, dt=0.01, sample=0.05)
        assert run.status == "ok" and run.t == pytest.approx(columns["t"], abs=1e-9)
        error = np.hypot(run.tip[:, 0] - columns["tip_x"], run.tip[:, 1] - columns["tip_y"]).max() / 10.0
        assert error == pytest.approx(0.0177, abs=5e-4)
        assert np.abs(run.balance).max() < 1e-3 * run.energy.max()
        assert 0.4 * error < run.notes["stretch_and_shear"] < 2.5 * error


@pytest.mark.parametrize(
    ("name", "low", "high"), [("robot_arm_torque", 0.004, 0.03), ("two_link_motion", 0.02, 0.1), ("spin_up", 0.0, 1e-3)]
)
def test_estimate_of_stretch_and_shear(name: str, low: float, high: float) -> None:
    """Measured against converged exact beams: 0.9 %, 5.9 % and 0.005 % of L."""
    scene = named(name)
    assert low < stretch_and_shear(scene, 6) < high


def stubby(ratio: float, links: int = 1, tau_d: float = 0.0, payload: float = 0.1) -> Arm:
    """An arm of 1 m with EI / CL^2 = ratio, EA = 5 C."""
    section = Section(EI=2.0, EA=10.0 / ratio, C=2.0 / ratio, m=0.5, J=0.1 * ratio)
    elbows = (Elbow(0.1, 0.002, 0.002),) * (links - 1)
    parts = (Link(1.0 / links, section),) * links
    return Arm("stubby", parts, hub_inertia=0.05, elbows=elbows, payload=Payload(payload, 1e-3), tau_d=tau_d)


HELD = Motion("joint0", constant(0.0))


@pytest.mark.parametrize("ratio", [0.025, 1e-3])
@pytest.mark.parametrize(
    ("arm", "changes", "factor"),
    [
        ({}, {"loads": (JointTorque(0, sine(0.5, 4.0)),)}, 3.0),
        ({}, {"loads": (JointTorque(0, sine(2.0, 8.0)),)}, 3.0),
        ({"tau_d": 5e-3}, {"loads": (JointTorque(0, sine(0.5, 8.0)),), "duration": 4.0}, 3.0),
        ({"payload": 0.5}, {"loads": (JointTorque(0, pulse(1.0, 0.3)),), "duration": 2.0}, 3.0),
        ({}, {"motions": (Motion("joint0", sine(0.3, 6.0)),)}, 3.0),
        ({}, {"motions": (HELD, Motion("root_y", sine(0.02, 10.0)))}, 3.0),
        ({}, {"motions": (HELD,), "loads": (PointLoad(0, "tip", force_y=constant(1.0)),)}, 3.0),
        ({}, {"gravity": (0.0, -9.81)}, 3.0),
        pytest.param(
            {"links": 2}, {"loads": (JointTorque(0, sine(0.5, 6.0)), JointTorque(1, sine(-0.2, 6.0)))}, 4.0,
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_note_on_stretch_and_shear(ratio: float, arm: dict[str, Any], changes: dict[str, Any], factor: float) -> None:
    """Against exact beams, at any deflection: within the stated factor, however the loads go."""
    scene = everything(Scene("s", stubby(ratio, **arm), **{"duration": 1.0, "dt": 5e-4, "sample": 0.01, **changes}))
    exact = simulate(scene, "geometrically_exact", elements=10, rho_inf=0.9, estimate_error=False)
    run = simulate(scene, "elastica", nodes=8, estimate_error=False)
    assert exact.finished and run.finished
    error = tips_apart(run, exact)
    assert error / factor < run.notes["stretch_and_shear"] < error * factor


@pytest.mark.slow
@pytest.mark.parametrize("duration", [0.5, 1.0, 2.0])
def test_the_estimate_follows_a_whip(duration: float) -> None:
    """Links that whip round, against exact beams: the linear note says 0.18 of 1.2 (at most 1 is told)."""
    section = Section(EI=20.0, EA=2e4, C=8e3, m=1.2, J=1e-3)
    links, elbow, payload = (Link(0.5, section),) * 2, Elbow(0.1, 1e-3, 1e-3), Payload(0.2, 5e-3)
    arm = Arm("whip", links, hub_inertia=0.02, elbows=(elbow,), payload=payload, tau_d=1e-3)
    scene = Scene(
        "whip", arm, duration=duration, dt=5e-4, sample=0.01, angles=(0.0, 0.5), gravity=(0.0, -9.81),
        loads=(JointTorque(0, pulse(25.0, 0.2)), JointTorque(1, pulse(-5.0, 0.3))),
    )  # fmt: skip
    exact = simulate(scene, "geometrically_exact", elements=8, rho_inf=0.9, estimate_error=False)
    run = simulate(scene, "elastica", nodes=8)
    error = min(1.0, tips_apart(run, exact))
    assert error / 2.0 < run.error_parts["stretch_and_shear"] < 5.0 * error
    assert error < 0.05 or run.status == "inaccurate"


def test_chain_on_a_shaken_root() -> None:
    """Links without elbows' inertia whose root starts to move at once: 2 m/s, then 4 g; undamped, 2 s.

    With the links' own inertia alone (none added to modes that the step leaves unresolved) all of these diverged.
    """
    section = Section(EI=3.0, EA=2.0e6, C=7.0e5, m=0.2, J=1e-6)
    angles = (-np.pi / 2, -0.5, 1.07)
    for count, omega, bound in ((1, 3.0, 2e-3), (2, 3.0, 2e-3), (3, 3.0, 4e-3), (3, 20.0, None)):
        arm = Arm("rods", tuple(Link(length, section) for length in (0.4, 0.3, 0.2)[:count]))
        scene = Scene(
            "shaken", arm, duration=2.0, dt=0.005, sample=0.1, angles=angles[:count], gravity=(0.0, -9.81),
            motions=(Motion("root_x", sine(0.1, omega)),),
        )  # fmt: skip
        run = simulate(scene, "elastica", estimate_error=False)
        assert run.finished, run.message
        assert np.abs(run.tip_deflection).max() < 0.2
        if bound is None:
            continue  # soon chaotic
        assert np.abs(run.balance).max() < 0.05 * np.ptp(run.kinetic)
        exact = simulate(everything(scene), "geometrically_exact", dt=0.0005, rho_inf=0.9, estimate_error=False)
        first = run.t <= 1.0 + 1e-9
        assert np.abs(run.tip - exact.tip)[first, :2].max() < bound


def three_link_swing() -> Scene:
    return everything(Scene.from_toml(ROOT / "configs" / "scenes" / "three_link_swing.toml"))


@pytest.mark.slow
def test_three_links_swing_alike_under_every_formulation() -> None:
    """Let go bent, under gravity: a fast whip of small links. Each runs to its end; they agree until it is chaotic."""
    scene = three_link_swing()
    runs = [simulate(scene, f, estimate_error=False) for f in ("elastica", "geometrically_exact", "floating_frame")]
    for run in runs:
        assert run.finished, run.message
        assert run.t[-1] == pytest.approx(2.0)
        assert np.abs(run.tip - runs[0].tip)[run.t <= 1.0 + 1e-9, :2].max() < 2e-3


@pytest.mark.slow
def test_three_links_whip_too_far_for_modes() -> None:
    reduced = simulate(three_link_swing(), "floating_frame", modes=3, frame="root")
    assert reduced.status == "out_of_range" and "25%" in reduced.message


def test_free_flight() -> None:
    """The centre of mass follows the impulse alone: x = 3.5 at 0.5 s, then 2 m/s; momentum and energy stay."""
    scene = named("two_link_free_flight")
    run = simulate(scene, "elastica", nodes=5, sample=0.5)
    assert run.status == "ok"
    parts = chain(scene.arm, 5)
    assert run.q[:, 10:] == pytest.approx(known_path("two_link_free_flight", run.t), abs=1e-9)
    phi = run.q[-1, :10].copy()
    phi[5] += phi[4]
    root = run.q[-1, 10:] - np.array([parts.b @ np.cos(phi), parts.b @ np.sin(phi)]) / parts.mass
    assert run.tip[-1, :2] == pytest.approx(root + [parts.w @ np.cos(phi), parts.w @ np.sin(phi)], abs=1e-9)
    after = run.energy[run.t >= 0.5]
    assert np.ptp(after) < 5e-3 * after[0]


def test_general_and_own_kernel_agree() -> None:
    """One kernel for all sizes, and one written out for this arm."""
    zero = TimeFunction(np.zeros((1, 8)))
    driven = Scene("s", ONE, duration=0.2, dt=2.5e-3, loads=(JointTorque(0, zero),), gravity=(0.0, -3.0))
    free = Scene("s", ONE, duration=0.2, dt=2.5e-3, gravity=(0.0, -3.0))
    general, own = (simulate(scene, "elastica", nodes=4, estimate_error=False) for scene in (driven, free))
    assert own.q.shape[1] == 4 and general.q.shape[1] == 6
    assert own.tip == pytest.approx(general.tip, abs=1e-9)
    assert np.ptp(own.tip[:, 1]) > 0.02


# ----------------------------------------------------------------------------- the slender strip
@pytest.mark.slow
@pytest.mark.parametrize(("arm", "share"), [(ONE, 1.0), (TWO, 2.0)], ids=["one", "two"])
def test_strip_against_the_exact_beam(arm: Arm, share: float) -> None:
    """Three errors apart: of the whole, of the mesh (same step, finer mesh), of leaving out stretch and shear.

    The exact beam's own steps of 0.125 ms leave 3e-5 of L, its mesh 1e-5. What two links thrown about differ by is
    smaller: there steps, mesh and Newton's iteration are made finer until they leave a tenth of it.
    """

    def apart(a: Trajectory, b: Trajectory) -> float:
        assert a.status == b.status == "ok"
        return tips_apart(a, b)

    for kind, bound in (("random", 5e-3), ("bang-bang", 5e-3), ("slow", 1e-3)):
        scene = driven(arm, kind, 3)
        exact = simulate(scene, "geometrically_exact", elements=6, order=3, dt=1.25e-4, rho_inf=0.9)
        assert np.abs(exact.tip_deflection).max() > 0.1
        meshes = {n: simulate(scene, "elastica", nodes=n) for n in (4, 6, 8, 10)}
        assert apart(meshes[6], exact) <= 0.2 * share * bound  # five times better than asked for
        assert apart(simulate(scene, "elastica", nodes=6, dt=5e-3), exact) <= share * bound
        # The mesh's error, all else equal, falls faster than to a half with each node: 16-fold from 4 to 8.
        errors = [apart(meshes[n], meshes[10]) for n in (4, 6, 8)]
        assert errors[2] < errors[0] / 16
        assert kind == "slow" or errors[2] < errors[1] / 4
        # What is left is stretch and shear, within the factor that their estimate promises.
        sharp = {"tolerance": 1e-12, "estimate_error": False}
        fine = simulate(scene, "elastica", nodes=10, dt=1.25e-4, **sharp)
        exact = simulate(scene, "geometrically_exact", elements=9, order=3, dt=3.125e-5, rho_inf=0.9, **sharp)
        assert apart(fine, exact) < 3e-4 * share
        assert apart(fine, exact) < (2.0 + share) * fine.notes["stretch_and_shear"]


# ----------------------------------------------------------------------------- lanes
@kernel
def both_of(lane, x, s, c):
    for i in range(x.shape[0] // len(lane)):
        sine, cosine = sincos(load(lane, x, i))
        store(s, i, sine)
        store(c, i, cosine)


def test_sine_and_cosine(rng: np.random.Generator) -> None:
    for size in (1.0, 10.0, 1e3, 1e6):
        x = rng.uniform(-size, size, 8000)
        x[:8] = np.array([0.0, 1.0, -1.0, 2.0, 4.0, -4.0, 6.0, 8.0]) * (np.pi / 4)
        s, c, s8, c8 = np.full((4, x.size), np.nan)
        both_of(SINGLE, x, s, c)
        both_of(EIGHT, x, s8, c8)
        assert (s == s8).all() and (c == c8).all()
        assert np.abs(s - np.sin(x)).max() < 3e-16 and np.abs(c - np.cos(x)).max() < 3e-16
    x = np.array([np.nan, np.inf, -np.inf])
    s, c = np.zeros((2, 3))
    both_of(SINGLE, x, s, c)
    assert np.isnan(s).all() and np.isnan(c).all()
