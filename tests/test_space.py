"""Arms in space against known answers, the energy they are derived from, and the planar kernels."""

import dataclasses
import math
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env import arms, scenes
from flexarm_env.compiler import SINGLE, kernel, uncompiled
from flexarm_env.equations import at_rest_of
from flexarm_env.linear import modes, static_equilibrium
from flexarm_env.linear.stability import at_rest
from flexarm_env.physics import assembly, protocol
from flexarm_env.physics.gauges import curvatures
from flexarm_env.physics.model import STIFFNESSES
from flexarm_env.physics.protocol import State, Weights
from flexarm_env.physics.space.segments import FRAME, points_for
from flexarm_env.sections import torsion_constant
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant, cycloid, pulse, sine
from flexarm_env.validation import Array
from tests import space_answers as answers
from tests.refusals import says
from tests.scene_tools import everything

EXACT, FLOATING, STRAINS = "geometrically_exact", "floating_frame", "elastica"
MODES = "floating_frame in modes"
MESH: dict[str, dict[str, int]] = {
    EXACT: {"elements": 3}, FLOATING: {"segments": 3}, MODES: {"segments": 4, "modes": 4}, STRAINS: {"nodes": 4},
}  # fmt: skip
_REDUCED = pytest.param(True, MODES, marks=pytest.mark.slow)
CHAINS = pytest.mark.parametrize(
    ("levers", "how"),
    [(False, EXACT), (True, EXACT), (True, FLOATING), (False, STRAINS), (True, STRAINS), _REDUCED],
)
FORMULATIONS = pytest.mark.parametrize("how", [EXACT, FLOATING])


# ------------------------------------------------------------------ principles
@kernel
def _lost(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    return protocol.damping_power(lane, model, par, q, v, v)


class Drawn:
    """A chain with oblique hinges, tensors, offsets, in a drawn state; with `levers` rigid ends and a rigid link; with
    `damped` time constants that differ from link to link, else next to none: one compiled form. stiffer: factors on
    fields of its sections."""

    def __init__(
        self, levers: bool, bent: float, moving: float, damped: bool = False, how: str = EXACT,
        joints: tuple[fx.Joint, ...] = (), stiffer: dict[str, float] | None = None,
    ) -> None:  # fmt: skip
        s = fx.Section(EI=10.0, EA=1e4, C=4e3, m=0.5, J=1e-3, EI_y=20.0, C_y=4e3, J_y=2e-3, GJ=5.0)
        thin = dataclasses.replace(s, EI=3.0, EI_y=12.0, m=0.3)
        s, thin = (
            dataclasses.replace(x, **{name: f * getattr(x, name) for name, f in (stiffer or {}).items()})
            for x in (s, thin)
        )
        tapered = fx.Link(1.0, ((0.0, s), (1.0, thin)), curvature=((0.0, 0.8), (1.0, -0.3)))
        links: tuple[fx.Link, ...] = (tapered, fx.Link(0.6, s), fx.Link(0.7, s, curvature=0.5))
        if levers:
            ends = {"root_offset": 0.05, "tip_offset": 0.08, "tip_mass": 0.1, "tip_inertia": 1e-3, "root_mass": 0.2}
            rigid = fx.RigidLink(0.2, 1.0, (0.1, 0.02, 0.01), np.diag([0.01, 0.02, 0.025]))
            links = (fx.Link(1.0, s, **ends), rigid, links[2])
        tensor = np.diag([1e-3, 2e-3, 2.5e-3])
        elbows = (
            fx.Elbow(0.2, 1e-3, tensor, axis=(0, 1, 1), mount=((0.3, 0.2, 0.5), 0.6)),
            fx.Elbow(axis=(1, 0, 1)),
        )
        payload = fx.Payload(0.3, tensor, (0.05, 0.02, 0.1))
        if damped:
            links = (dataclasses.replace(links[0], tau_d=4e-3), links[1], dataclasses.replace(links[2], tau_d=1e-3))
        arm = fx.Arm("drawn", links, elbows=elbows, payload=payload, joints=joints, tau_d=1e-300)
        scene = fx.Scene("drawn", arm, duration=1.0, dt=1e-3, gravity=(0, -3, -9), angles=(0.3, 0.4, 0.5))
        system = assembly.assemble(scene, scene.settings(how.split()[0], **MESH[how]))
        self.model, self.par, self.n = assembly.physical(system.model), system.par, int(system.model.n)
        rng = np.random.default_rng(5)
        self.q = self.moved(system.q0, rng.normal(size=self.n) * bent)
        self.v, self.a = rng.normal(size=self.n) * moving, rng.normal(size=self.n) * 10.0 * moving
        self.rows = np.flatnonzero(self.model.weight > 0.0)
        self.room = np.zeros(int(self.model.n_factor))
        self.u = np.zeros(int(self.model.n_inputs))

    def moved(self, q: Array, d: Array) -> Array:
        q = q.copy()
        uncompiled(protocol.retract)(SINGLE, self.model, q, 1.0, d, None)
        return q

    def residual(self, q: Array, v: Array, a: Array) -> Array:
        r = np.zeros(self.n)
        answers.residual(SINGLE, self.model, self.par, State(q, v, a), self.u, r, self.room.copy())
        return r

    def energy(self, q: Array, v: Array) -> Array:
        return np.array(answers.energy(SINGLE, self.model, self.par, q, v))


@CHAINS
def test_forces_at_rest_are_the_slope_of_the_energy(levers: bool, how: str) -> None:
    """Virtual work: r = dV/dq by increments of places and rotations, in a state that is bent and twisted by far."""
    arm = Drawn(levers, 0.1, 0.0, how=how)
    still = np.zeros(arm.n)
    r, slope = arm.residual(arm.q, still, still), np.zeros(arm.n)
    for k in arm.rows:
        d = np.zeros(arm.n)
        d[k] = 1e-5
        sides = [arm.energy(arm.moved(arm.q, sign * d), still)[1:].sum() for sign in (1.0, -1.0)]
        slope[k] = (sides[0] - sides[1]) / 2e-5
    assert np.abs(slope - r)[arm.rows].max() < 1e-9 * np.abs(slope).max()


@CHAINS
def test_power_of_all_forces_is_the_rate_of_the_energy(levers: bool, how: str) -> None:
    """r . v = d(T + V)/dt in a drawn motion: inertia, gyroscopic moments and centrifugal forces of all bodies."""
    power, rate = _powers(Drawn(levers, 0.1, 1.0, how=how))
    assert rate == pytest.approx(power, rel=1e-6)


def _powers(arm: Drawn) -> tuple[float, float]:
    """That of all forces, and the rate of the energy, W."""
    h = 1e-5
    ways = [(arm.moved(arm.q, t * arm.v + 0.5 * t * t * arm.a), arm.v + t * arm.a) for t in (h, -h)]
    after, before = (float(arm.energy(*way).sum()) for way in ways)
    return float((arm.residual(arm.q, arm.v, arm.a) * arm.v)[arm.rows].sum()), (after - before) / (2.0 * h)


GEARED = (
    fx.Joint(motor_inertia=2e-3, gear_ratio=20.0, friction_viscous=0.1),
    fx.Joint(stiffness=30.0, damping=0.05, motor_inertia=1e-3, gear_ratio=30.0),
    fx.Joint(stiffness=20.0, motor_inertia=2e-3, gear_ratio=25.0, friction_viscous=0.2, friction_side="link"),
)
"""Rotors on hinges that turn, whose momentum is that of the links."""


GEARED_CHAINS = pytest.mark.parametrize(
    ("levers", "how"), [(True, EXACT), (True, STRAINS), pytest.param(True, FLOATING, marks=pytest.mark.slow)]
)


def _taken(arm: Drawn) -> tuple[float, float, float]:
    """What damping and friction take, W: by the power of all forces less the rate of the energy, by the books; and that
    power."""
    power, rate = _powers(arm)
    return power - rate, float(_lost(SINGLE, arm.model, arm.par, arm.q, arm.v)), power


@pytest.mark.slow
@GEARED_CHAINS
def test_power_of_geared_joints_is_the_rate_of_the_energy(levers: bool, how: str) -> None:
    """The same with rotors, gears and friction: gyroscopic moments of rotors do no work; what is lost is counted."""
    taken, lost, power = _taken(Drawn(levers, 0.1, 1.0, how=how, joints=GEARED))
    assert lost > 0.0 and taken == pytest.approx(lost, rel=1e-5, abs=1e-7 * abs(power))


@CHAINS
def test_damping_takes_what_the_power_lacks(levers: bool, how: str) -> None:
    """r . v - d(T + V)/dt = v'C v, which the books count, with a time constant of each link's own: positive."""
    taken, lost, _ = _taken(Drawn(levers, 0.02, 1.0, damped=True, how=how))
    assert lost > 0.0 and taken == pytest.approx(lost, rel=1e-5)


@CHAINS
@pytest.mark.parametrize(("name", "shear"), [("EI", "C"), ("EI_y", "C_y"), ("GJ", "")])
def test_a_factor_is_that_on_the_sections(levers: bool, how: str, name: str, shear: str) -> None:
    """Forces, energy, damping and Newton's matrix, to round-off. A segment's bending and shear are one stiffness, and
    what it is shorter for its bending is left as it is."""
    frames = how in (FLOATING, MODES)
    fields = {name: 1.3} | ({shear: 1.3} if shear and frames else {})
    own, other = Drawn(levers, 0.05, 1.0, True, how), Drawn(levers, 0.05, 1.0, True, how, stiffer=fields)
    own.par[STIFFNESSES[name]] = 1.3
    if frames:
        sizes = {"inner": 2 * (how == MODES)}
        sizes["points"] = points_for(sizes["inner"])
        for field in ("coupling", "inner_coupling"):
            here, there = (FRAME.unpack(x.model.frames.reshape(-1, FRAME.offsets(0, **sizes).end), **sizes)[field]
                           for x in (own, other))  # fmt: skip
            there[:] = here
    found = []
    for arm in (own, other):
        S, x, state = arm.room.copy(), np.sin(np.arange(arm.n)), State(own.q, own.v, own.a)
        weights = Weights(1e4, 1e2, 1.0, newton_share=1.0)
        answers.factored(SINGLE, arm.model, arm.par, state, arm.u, weights, x.copy(), S)
        answers.solved(SINGLE, arm.model, S, x)
        lost = float(_lost(SINGLE, arm.model, arm.par, own.q, own.v))
        found.append((arm.residual(own.q, own.v, own.a), arm.energy(own.q, own.v), lost, x))
    for one, two in zip(*found, strict=True):
        assert np.abs(one - two).max() < 1e-11 * np.abs(two).max()
    apart = np.abs(Drawn(levers, 0.05, 1.0, True, how).residual(own.q, own.v, own.a) - found[0][0])
    assert apart.max() > 1e-3


NEAR = pytest.mark.parametrize(("bent", "moving", "most"), [(0.0, 0.0, 1e-6), (1e-3, 0.1, 1e-3), (0.01, 0.3, 0.05)])


@pytest.mark.slow
@GEARED_CHAINS
@NEAR
def test_the_iteration_matrix_of_geared_joints(levers: bool, bent: float, moving: float, most: float, how: str) -> None:
    """With motors eliminated, and the columns of rotors whose axes turn."""
    test_the_iteration_matrix_is_the_derivative(levers, bent, moving, most, how, GEARED)


@CHAINS
@NEAR
def test_the_iteration_matrix_is_the_derivative(
    levers: bool, bent: float, moving: float, most: float, how: str, joints: tuple[fx.Joint, ...] = ()
) -> None:
    """Newton's contraction |S^-1 dr - 1|: nothing in the state without stress, little near it. A frame's leaves out how
    a link that is bent without stress stands off its chord, to second order; that of strains what coordinates that are
    relative turn at the rates of those before them, to first order."""
    most = most if how == EXACT else max(most, 2e-3 if how != STRAINS or moving == 0.0 else 5e-3)
    arm, weights = Drawn(levers, bent, moving, how=how, joints=joints), Weights(1e4, 1e2, 1.0, newton_share=1.0)
    rows = np.array([k for k in arm.rows if k not in arm.model.fixed])
    S, columns = arm.room.copy(), np.zeros((arm.n, arm.n))
    answers.factored(SINGLE, arm.model, arm.par, State(arm.q, arm.v, arm.a), arm.u, weights, np.zeros(arm.n), S)
    for k in rows:
        d, total = np.zeros(arm.n), np.zeros(arm.n)
        d[k] = 1e-6
        for sign in (1.0, -1.0):
            at = arm.q, arm.v, arm.a
            parts = (
                (weights.stiffness, (arm.moved(arm.q, sign * d), *at[1:])),
                (weights.damping, (at[0], arm.v + sign * d, at[2])), (weights.mass, (*at[:2], arm.a + sign * d)),
            )  # fmt: skip
            total += sum((sign * weight * arm.residual(*state) for weight, state in parts), np.zeros(arm.n)) / 2e-6
        total[[i for i in range(arm.n) if i not in rows]] = 0.0
        answers.solved(SINGLE, arm.model, S, total)
        columns[:, k] = total
    apart = columns[np.ix_(rows, rows)] - np.eye(len(rows))
    assert np.abs(np.linalg.eigvals(apart)).max() < most


@FORMULATIONS
def test_energy_does_not_see_a_rigid_rotation(how: str) -> None:
    arm, turn = Drawn(False, 0.1, 0.0, how=how), Rotation.from_rotvec([0.7, -1.1, 1.5])
    q = arm.q.copy()
    names = [i for i in range(arm.n) if i in {0} or ((i - 6) % 19 in (1, 7, 13) and i >= 6)]
    for i in names:
        q[i : i + 3] = turn.apply(q[i : i + 3])
        q[i + 3 : i + 6] = (turn * Rotation.from_rotvec(q[i + 3 : i + 6])).as_rotvec()
    still = np.zeros(arm.n)
    assert arm.energy(q, still)[1] == pytest.approx(arm.energy(arm.q, still)[1], rel=1e-12)


# ------------------------------------------------------------------ sections
def test_torsion_constants_of_rectangles() -> None:
    """Timoshenko & Goodier, table in section 109: k1 of G theta a b^3."""
    for ratio, k1 in ((1.0, 0.140577), (2.0, 0.228682), (10.0, 0.312325)):
        assert torsion_constant(ratio, 1.0) == pytest.approx(k1 * ratio, rel=3e-6)
        assert torsion_constant(1.0, ratio) == torsion_constant(ratio, 1.0)
    strip = fx.Section.rectangle(0.05, 0.002, 190e9, 7870.0, 74e9)
    assert (strip.EI, strip.EI_y, strip.GJ) == pytest.approx((6.3333, 3958.3, 9.617), rel=1e-4)


def test_circles_and_tubes() -> None:
    bar, tube = (
        fx.Section.circle(0.02, 210e9, 7850.0, 81e9),
        fx.Section.tube(0.02, 0.002, 210e9, 7850.0, 81e9),
    )
    assert pytest.approx(81e9 * math.pi * 0.02**4 / 32.0) == bar.GJ
    assert tube.EI == tube.EI_y == pytest.approx(210e9 * math.pi * (0.02**4 - 0.016**4) / 64.0)
    assert tube.m == pytest.approx(7850.0 * math.pi * (0.02**2 - 0.016**2) / 4.0)


# ------------------------------------------------------------------ statics
@pytest.mark.slow
@pytest.mark.parametrize("GJ", answers.BENT_45)
def test_bend_of_45_degrees(GJ: float) -> None:
    coarse, fine = (answers.bend_of_45_degrees(GJ, elements=n) for n in (16, 32))
    assert np.abs(fine - answers.BENT_45[GJ]).max() < 2e-3
    assert np.abs((4.0 * fine - coarse) / 3.0 - answers.BENT_45[GJ]).max() < 1e-4


@pytest.mark.slow
def test_bend_of_45_degrees_in_second_order_by_segments() -> None:
    GJ, known = next(iter(answers.BENT_45.items()))
    errors = [np.abs(answers.bend_of_45_degrees(GJ, FLOATING, segments=n) - known).max() for n in (8, 16, 32, 64)]
    assert errors[0] < 0.01
    assert all(a / b > 3.7 for a, b in pairwise(errors[1:]))


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 0.7, math.pi / 2])
def test_a_moment_bends_a_rod_to_a_circle_in_any_plane(turn: float) -> None:
    assert answers.off_a_circle(turn, elements=6) < 1e-12 and answers.off_a_circle(turn, STRAINS, nodes=8) < 1e-6


def test_a_moment_bends_a_round_rod_to_a_helix() -> None:
    """In fourth order."""
    errors = [answers.off_a_helix(1e9, elements=n) for n in (4, 8, 16)]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] > 14.0 and errors[1] / errors[2] > 14.0


@pytest.mark.slow
@pytest.mark.parametrize(("nodes", "most"), [(3, 2e-5), (5, 3e-9)])
def test_a_moment_bends_a_round_rod_to_a_helix_by_strains(nodes: int, most: float) -> None:
    """Errors fall with the points by which the tip is found, not by an order."""
    assert answers.off_a_helix(1e6, STRAINS, nodes=nodes) < most


@pytest.mark.slow
def test_a_link_of_uneven_curvature_stands_on_its_curve() -> None:
    link = fx.Link(1.0, answers.section(2.0, 1.0), curvature=((0.0, 3.0), (0.4, -1.0), (1.0, 2.0)))
    found, known = answers.rest(fx.Arm("bent", (link,)), elements=5), complex(link.place(1.0))
    assert found == pytest.approx([known.real, known.imag, 0.0], abs=1e-10)


@pytest.mark.slow
def test_lateral_torsional_buckling() -> None:
    for stiff, how in ((1e9, {"elements": 16}), (1e6, {"formulation": STRAINS, "nodes": 8})):
        assert answers.buckling(3.9, 4.1, stiff, **how) == pytest.approx(answers.BUCKLES, rel=2e-3)


@pytest.mark.slow
def test_lateral_torsional_buckling_in_second_order_by_segments() -> None:
    """Of segments, whose rotations couple bending with torsion; not of one frame."""
    assert answers.stability(4.2, formulation=FLOATING, segments=1) > 0.0
    coarse, fine = (answers.buckling(3.9, 4.2, formulation=FLOATING, segments=n) for n in (4, 8))
    assert fine == pytest.approx(answers.BUCKLES, rel=0.02)
    assert (4.0 * fine - coarse) / 3.0 == pytest.approx(answers.BUCKLES, rel=3e-3)


# ------------------------------------------------------------------ modes
@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "mesh", "shares"),
    [
        (EXACT, {"elements": 12}, (1e-4, 1e-4, 1e-3, 1e-3, 2e-4)),
        (FLOATING, {"segments": 12}, (2e-5, 2e-5, 2e-4, 1e-3, 2e-4)),
        (STRAINS, {"nodes": 8}, (1e-4, 2e-4, 1e-3, 1e-4)),
    ],
)
def test_frequencies_of_a_strip(how: str, mesh: dict[str, int], shares: tuple[float, ...]) -> None:
    found = modes(everything(answers.STRIP), 8, how, clamped=True, **mesh).frequencies / (2.0 * math.pi)
    for known, share in zip(answers.STRIP_HZ.values(), shares, strict=False):
        assert np.abs(found / known - 1.0).min() < share


def _often(spin: float, how: str, n: int) -> Any:
    mesh, slow = {EXACT: "elements", FLOATING: "segments", STRAINS: "nodes"}[how], how == FLOATING or n == 16
    return pytest.param(spin, how, {mesh: n}, marks=[pytest.mark.slow] if slow else [], id=f"{spin:g}, {how}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spin", "how", "mesh"),
    [
        *(_often(spin, EXACT, 9) for spin in (0.0, 1.0, 6.0)), _often(12.0, EXACT, 16),
        *(_often(spin, FLOATING, 12) for spin in (2.0, 6.0)), *(_often(spin, STRAINS, 8) for spin in (1.0, 6.0, 12.0)),
    ],
)  # fmt: skip
def test_flap_and_lag_of_a_rotating_cantilever(spin: float, how: str, mesh: dict[str, int]) -> None:
    scene = answers.blade(1e6 if how == STRAINS else 1e8)
    found = modes(scene, 2, how, clamped=True, spin=spin, **mesh).frequencies
    assert found == pytest.approx(answers.lag_and_flap(spin), rel=2e-4)


@pytest.mark.slow
def test_whirl_of_a_shaft_splits_by_its_polar_inertia() -> None:
    """Spun about its own axis, seen from rest."""
    spin = 0.2
    found = np.sort(modes(answers.SHAFT, 2, elements=12, clamped=True, spin=spin).frequencies)
    apart = abs(found[1] - found[0] - 2.0 * spin)  # the observer turns
    assert apart == pytest.approx(answers.split_of_whirls(spin), rel=0.02)


@pytest.mark.slow
def test_three_dof_has_a_torsion_mode_between_those_of_pitch() -> None:
    """Elbow at 90 degrees: pitch 2.12 and 5.76 Hz, and between them the second strip on the first one's torsion."""
    scene = fx.Scene("t", arms.named("three_dof"), duration=1.0, dt=1e-3, angles=(0.0, math.pi / 2, -math.pi / 2))
    found = modes(everything(scene), 3, elements=8, clamped=(0, 1, 2)).frequencies / (2.0 * math.pi)
    assert found == pytest.approx([2.12, 3.84, 5.76], abs=0.01)


# ------------------------------------------------------------------ motion
@pytest.mark.slow
def test_a_rigid_body_turns_as_euler_has_it() -> None:
    """In second order; the flip is in the time shown."""
    errors = []
    for dt in (1e-3, 5e-4):
        scene, exact = answers.tumbling(dt)
        errors.append(np.abs(fx.simulate(scene, estimate_error=False, rho_inf=1.0).v[:, 3:6] - exact).max())
    assert exact[:, 1].min() < -4.0
    assert errors[0] < 5e-3 and errors[0] / errors[1] > 3.5


@pytest.mark.parametrize("seed", range(10))
def test_a_planar_scene_in_a_drawn_plane_is_the_same_turned(seed: int) -> None:
    turn, s = Rotation.random(random_state=seed), answers.section(5.0, 2.0, EI_y=9.0)
    flat, tilted = (answers.falling(t, s, s, {"duration": 0.4, "dt": 2e-3, "sample": 0.05}) for t in (None, turn))
    plane = dataclasses.replace(flat, space=True)
    one, other = (fx.simulate(everything(s), estimate_error=False, tolerance=1e-12) for s in (plane, tilted))
    assert np.abs(turn.apply(one.tip) - other.tip).max() < 1e-9 * 1.1
    assert np.abs(one.joint_angles - other.joint_angles).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(("what", "ratio"), [("motion", 12.0), ("flight", 4.0)])
def test_space_comes_to_the_plane_with_the_mesh(what: str, ratio: float) -> None:
    """Spatial kernels forced on a planar scene, against the planar exact beam on a fine mesh: fourth order in gross
    bending; second order at a small size is left in flight."""
    arm = fx.Arm("arm", (fx.Link(1.0, answers.section(10.0, 5.0, stiff=1e7, m=0.5, J=0.0)),), payload=fx.Payload(0.2))
    common: dict[str, Any] = {"duration": 1.0, "dt": 1e-3, "sample": 0.05}
    if what == "motion":
        scene = fx.Scene("turn", arm, motions=(fx.Motion("joint0", cycloid(3.0, 0.5)),), **common)
    else:
        push = fx.PointLoad(0, "root", force_y=pulse(4.0, 0.3))
        scene = fx.Scene("flight", arm, root="free", loads=(push,), gravity=(0.0, -1.0), **common)
    options: dict[str, Any] = {"estimate_error": False, "rho_inf": 0.9}
    known = fx.simulate(scene, "geometrically_exact", elements=16, order=3, **options).tip[:, :2]
    forced = everything(dataclasses.replace(scene, space=True))
    errors = [np.abs(fx.simulate(forced, elements=n, **options).tip[:, :2] - known).max() for n in (6, 12)]
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] > ratio


_STRIP = fx.Section.rectangle(0.05, 0.01, 70e9, 2700.0, 26e9)
_TUBE = fx.Section.tube(0.02, 0.002, 70e9, 2700.0, 26e9)


@pytest.mark.slow
def test_a_jump_of_the_section_is_the_same_in_space() -> None:
    """Frequencies in the plane, joint free and held, by the planar kernels: among those of the spatial ones."""
    arm = fx.Arm("a", (fx.Link(0.8, ((0.0, _STRIP), (0.3, _STRIP), (0.3, _TUBE), (0.8, _TUBE))),))
    scene = fx.Scene("s", arm, duration=1.0, dt=1e-3, angles=(0.2,))
    for held in ((), (0,)):
        plane = modes(scene, 4, "geometrically_exact", elements=10, order=3, clamped=held).frequencies
        forced = everything(dataclasses.replace(scene, space=True))
        found = modes(forced, 14, elements=17, clamped=held).frequencies
        for omega in plane[plane > 1.0][:3]:
            assert float(np.abs(found / omega - 1.0).min()) < 1e-3, (held, omega)


@pytest.mark.slow
@FORMULATIONS
def test_a_free_arm_keeps_its_momentum(how: str) -> None:
    """Bounded without drift, and of second order in the step; energy likewise, without damping."""
    ripple = []
    for h in (4e-3, 2e-3):
        linear, angular, energy = answers.drift(h, 2.0, 10, how, **MESH[how]).T
        assert linear.max() < 1e-11 and energy.max() < 0.02
        ripple.append((angular[:5].max(), angular[5:].max()))
    assert max(ripple[0]) < 2e-3
    assert ripple[0][1] < 2.0 * ripple[0][0]  # no drift
    assert ripple[0][0] / ripple[1][0] > 3.5


@pytest.mark.slow
def test_a_free_arm_over_100_000_steps() -> None:
    """rho_inf = 1, no damping, 200 s: linear momentum to round-off; angular momentum and energy without drift."""
    linear, angular, energy = answers.drift(2e-3, 200.0, 20, elements=2).T
    assert linear.max() < 1e-11
    assert angular.max() < 3e-5 and energy.max() < 3e-3
    assert energy[10:].max() < 3.0 * energy[:10].max()


@pytest.mark.slow
def test_gravity_and_loads_are_all_that_changes_linear_momentum() -> None:
    """M g t with a smooth load's impulse by the steps' own mean."""
    arm, g = arms.named("satellite_arm"), (0.0, 0.3, -1.0)
    load, h = fx.PointLoad(0, "tip", force_x=sine(3.0, 5.0)), 2e-3
    scene = fx.Scene("f", arm, duration=0.5, dt=h, root="free", angles=(0.0, 0.5, -1.0), loads=(load,), gravity=g)
    simulation = Simulation(everything(scene), scene.settings(elements=3))
    before = answers.momenta(arm, simulation)[:3]
    assert simulation.advance_to(0.4)
    mass = sum(link.moment(0) for link in arm.links) + sum(elbow.mass for elbow in arm.elbows) + arm.payload.mass
    impulse = np.array(g) * mass * 0.4
    impulse[0] += np.trapezoid(3.0 * np.sin(5.0 * np.linspace(0.0, 0.4, 201)), dx=h)
    assert answers.momenta(arm, simulation)[:3] - before == pytest.approx(impulse, rel=1e-10, abs=1e-10)


@pytest.mark.slow
def test_books_balance_as_the_step_shrinks() -> None:
    """Work = energy + dissipated with damping, torques, gravity, a rigid link and moments out of the plane."""
    arm = arms.named("three_dof")
    moment = fx.PointLoad(2, "tip", torque_x=constant(0.3), force_z=constant(0.2))
    torque = fx.JointTorque(0, cycloid(3.0, 0.2))
    balances = []
    for h in (1e-3, 5e-4):
        scene = fx.Scene(
            "b", arm, duration=0.3, dt=h, sample=0.02, gravity=(0, 0, -9.81), angles=(0.0, 1.2, -0.8),
            loads=(moment, torque), start="held",
        )  # fmt: skip
        run = fx.simulate(scene, estimate_error=False, rho_inf=1.0)
        balances.append(float(np.abs(run.balance).max() / run.turned_over))
    assert balances[0] < 1e-3
    assert balances[0] / balances[1] > 2.0


@pytest.mark.slow
def test_slew_of_three_dof_leaves_the_plane_by_torsion() -> None:
    """20 N m for 0.1 s each way: the tip leaves the arm's plane by 0.38 m, while a model of pitch alone says 0."""
    run = fx.simulate(everything(scenes.named("three_dof_slew")), estimate_error=False)
    yaw = run.joint_angles[:, 0]
    out = np.abs(np.cos(yaw) * run.tip[:, 1] - np.sin(yaw) * run.tip[:, 0])
    assert yaw.max() == pytest.approx(1.496, abs=3e-3)
    assert out.max() == pytest.approx(0.379, abs=3e-3)
    assert run.t[out.argmax()] == pytest.approx(0.18, abs=0.011)
    assert np.abs(run.twist[:, 1]).max() > 0.8


def test_right_angle_frame() -> None:
    """Simo & Vu-Quoc 1988: displacements of the tip, and of the corner along z, of a strain-parametrised rod."""
    known = {
        2: (0.1063, -0.6922, 0.0693, 4.1151),
        4: (0.4419, -0.7062, 3.5088, 4.6417),
        8: (0.0232, -2.6446, 7.9604, 1.6333),
    }
    run = fx.simulate(everything(scenes.named("right_angle_frame")), estimate_error=False, duration=8.0)
    for t, values in known.items():
        i = int(np.abs(run.t - t).argmin())
        found = [*(run.tip[i] - [10.0, 10.0, 0.0]), run.hinges[i, 0, 2]]
        assert np.abs(np.array(found) - values).max() < 0.03


def test_holding_torques_carry_the_weight() -> None:
    s = fx.Section.rectangle(0.05, 0.02, 190e9, 7870.0, 74e9)
    arm = fx.Arm("beam", (fx.Link(1.0, s),), hub_mount=((1, 0, 0), -math.pi / 2), payload=fx.Payload(0.5))
    found = static_equilibrium(everything(fx.Scene("s", arm, duration=1.0, dt=1e-3, gravity=(0, 0, -9.81))))
    assert found.joint_torques()[0] == pytest.approx(-9.81 * (0.5 * s.m + 0.5), rel=1e-4)
    assert found.stability.stable
    assert at_rest(*at_rest_of(found), [0]).smallest == pytest.approx(found.stability.smallest)
    weight, n, points = 9.81 * s.m, found.settings.elements, found.shape_points()
    assert n is not None and points.shape[1] == 3 and np.abs(points[0]).max() == 0.0
    assert points[-1, 2] == pytest.approx(-(weight / 8.0 + 9.81 * 0.5 / 3.0) / s.EI, rel=0.01)  # of a cantilever
    (read,) = curvatures(found.scene, found.settings, found.system.names, [(0, 0.0)], found.work.q[None])[0]
    # docs/tutorials/sensors.md: its own weight is read 2/(3 n^2) too little at the root, the payload's as it is
    assert read == pytest.approx((0.5 * weight * (1.0 - 2.0 / (3.0 * n * n)) + 9.81 * 0.5) / s.EI, rel=1e-3)


# ------------------------------------------------------------------ files and refusals
@pytest.mark.slow
@pytest.mark.parametrize("name", scenes.SPATIAL)
def test_scenes_in_space_run_and_are_written(name: str, tmp_path: Any) -> None:
    scene = scenes.named(name)
    assert fx.Scene.from_toml(scene.to_toml()) == scene
    run = fx.simulate(everything(scene), estimate_error=False, duration=min(0.1, scene.duration))
    assert run.tip_rotation.shape == (len(run.t), 4) and run.finished
    run.to_npz(tmp_path / "run.npz")
    again = fx.Trajectory.from_npz(tmp_path / "run.npz")
    assert again.tip_rotation.shape == (len(again.t), 4)
    assert all(np.array_equal(getattr(run, key), getattr(again, key)) for key in run.arrays)
    run.to_csv(tmp_path / "run.csv")
    head = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert head.startswith("t,energy,start_x,start_y,start_z,tip_x,tip_y,tip_z")


@pytest.mark.slow
def test_all_figures_of_a_run_in_space(tmp_path: Any) -> None:
    from flexarm_env.envs.video import pictures, write_film
    from flexarm_env.plotting import plot_all

    run = fx.simulate(everything(scenes.named("three_dof_slew")), estimate_error=False, duration=0.3)
    assert all(path.stat().st_size > 10_000 for path in plot_all(run, tmp_path))
    film = write_film(tmp_path / "slew.gif", pictures(run, 20.0), 20.0)
    assert film.read_bytes()[:4] == b"GIF8"


def test_an_arm_without_axes_is_planar_and_keeps_its_kernels() -> None:
    assert not any(arms.named(name).spatial for name in arms.names() if name not in SPATIAL_ARMS)
    assert all(arms.named(name).spatial for name in SPATIAL_ARMS)
    plane = scenes.named("two_link_motion")
    assert type(fx.simulate(plane, estimate_error=False, duration=0.1)) is fx.Trajectory


SPATIAL_ARMS = ("three_dof", "three_dof_loaded", "satellite_arm", "turret_boom")


def _arm(**changes: Any) -> fx.Arm:
    s = fx.Section.rectangle(0.05, 0.002, 190e9, 7870.0, 74e9)
    return dataclasses.replace(fx.Arm("a", (fx.Link(0.5, s), fx.Link(0.5, s)), hub_axis=(0, 1, 0)), **changes)


def _run(arm: fx.Arm) -> Any:
    return fx.simulate(fx.Scene("s", arm, duration=0.01, dt=1e-3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: _run(fx.Arm("a", (fx.RigidLink(1.0),))), "links[0].mass = 0.0"),
        (lambda: _run(fx.Arm("a", (fx.RigidLink(0.0, 1.0),))), "links[0].length = 0.0"),
        (lambda: fx.Elbow(axis=(1e300, 0, 0)), "must be a direction"),
        (lambda: fx.Elbow(axis=(0, 0, 0)), "axis = (0, 0, 0): must be a direction"),
        (lambda: fx.Elbow(axis=(0, float("nan"), 1)), "axis[1]"),
        (lambda: fx.Elbow(mount=((1, 0, 0), (0, 1, 0), (0, 0, -1))), "mount = "),
        (lambda: fx.Elbow(mount=3.0), "mount = 3.0"),
        (lambda: fx.Payload(1.0, ((1, 0, 0), (0, 1, 0), (0, 0, 3))), "principal values"),
        (lambda: fx.Payload(1.0, ((1, 1, 0), (0, 1, 0), (0, 0, 1))), "must be symmetric"),
        (lambda: fx.RigidLink(-1.0), "length = -1.0"),
        (lambda: fx.RigidLink(1.0, centre=(0, 0)), "centre"),
        (lambda: gym.make("TwoLinkFlexArm-v0", arm=_arm(torque_limits=(1.0, 1.0))), "space"),
        (lambda: gym.make("MultiLinkFlexArm-v0", arm="three_dof"), "arm = 'three_dof': must move in the x-y plane"),
        (lambda: gym.make_vec("MultiLinkFlexArm-v0", 2, arm="three_dof", formulation="geometrically_exact"), "plane"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_refused_by_name(make: Any, words: str) -> None:
    says(words, make)
