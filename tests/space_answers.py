"""Beams in space with known answers, for the tests of all formulations and for the page of results."""

import dataclasses
import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from flexarm_env import arms
from flexarm_env.compiler import SINGLE, kernel
from flexarm_env.linear import static_equilibrium
from flexarm_env.physics import protocol
from flexarm_env.physics.layout import STEPS
from flexarm_env.physics.space.reading import tips
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant, pulse
from flexarm_env.validation import Array
from tests.scene_tools import everything


def section(EI: float, GJ: float, EI_y: float | None = None, stiff: float = 1e6, J: float = 1e-6, **more: float) -> Any:
    """A section whose stretch and shear hardly count."""
    own = {"EI_y": EI if EI_y is None else EI_y, "C_y": stiff, "J_y": J, "m": 1.0, **more}
    return fx.Section(EI=EI, EA=stiff, C=stiff, J=J, GJ=GJ, **own)


@kernel
def residual(lane, model, par, state, u, r, S):  # type: ignore[no-untyped-def]
    """Of an arm in a state."""
    protocol.assemble(lane, model, par, state, u, protocol.RESIDUAL_ALONE, r, S)


@kernel
def factored(lane, model, par, state, u, weights, r, S):  # type: ignore[no-untyped-def]
    """The same, and Newton's matrix in S."""
    protocol.assemble(lane, model, par, state, u, weights, r, S)
    for i in range(model.fixed.shape[0]):
        protocol.add_stiffness(lane, model, S, model.fixed[i], None)
    protocol.factor(lane, model, S)


@kernel
def solved(lane, model, S, x):  # type: ignore[no-untyped-def]
    """By that matrix, in place."""
    protocol.solve(lane, model, S, x)


def rest(arm: fx.Arm, *loads: fx.PointLoad, formulation: str | None = None, **mesh: int) -> Array:
    """Where the tip of a clamped arm is at rest."""
    scene = fx.Scene("rest", arm, duration=1.0, dt=1e-3, loads=loads, start="held", space=True)
    simulation = Simulation(everything(scene), scene.settings(formulation, **mesh))
    return np.asarray(tips(arm, simulation.settings, simulation.system.q0[None])[0, 0])


def finished(scene: fx.Scene, formulation: str | None = None, **options: Any) -> Any:
    """The run of a scene, without an estimate, which comes to its end."""
    run = fx.simulate(scene, formulation, estimate_error=False, **options)
    assert run.finished, run.message
    return run


def beside(env: Any, action: Any, start: Any, duration: float = 0.05) -> Any:
    """The run of an environment's arm under its weight, from the same start, an action's torques held."""
    plan = env.unwrapped.plan
    torques = np.array(plan.arm.torque_limits) * action
    loads = tuple(fx.JointTorque(k, constant(float(u))) for k, u in enumerate(torques))
    scene = fx.Scene(
        "s", plan.arm, duration=duration, dt=plan.settings.dt, gravity=(0, 0, -9.81), angles=start, loads=loads
    )
    return finished(scene, plan.settings.formulation, **plan.settings.options())


def falling(turn: Rotation | None, one: Any, other: Any, when: dict[str, float], **arm: Any) -> fx.Scene:
    """Two links that fall and are bent by far, in the plane, or in one that is turned so."""
    given = {"elbows": (fx.Elbow(0.2, 1e-3, 1e-3),), "payload": fx.Payload(0.3, 1e-3, (0.05, 0.02)), **arm}
    links, loads = (fx.Link(0.6, one), fx.Link(0.5, other)), (fx.JointTorque(1, constant(0.7)),)
    if turn is None:
        flat = fx.Arm("flat", links, **given)
        return fx.Scene("flat", flat, gravity=(0.0, -9.81), loads=loads, angles=(0.3, 0.8), **when)
    turned, g = fx.Arm("turned", links, hub_mount=turn.as_matrix(), **given), turn.apply([0.0, -9.81, 0.0])
    return fx.Scene("turned", turned, gravity=tuple(g), loads=loads, angles=(0.3, 0.5), space=True, **when)


# ------------------------------------------------------------------ statics
BENT_45 = {8.3333e5: (-23.56065, -13.60467, 53.47554), 0.14058 * 5e6: (-23.8191, -13.7316, 53.6080)}
"""Bathe & Bolourchi 1979: by GJ (published figures differ by which was taken) displacements of the tip by shooting on
the boundary-value problem."""


def bend_of_45_degrees(GJ: float, formulation: str | None = None, **mesh: int) -> Array:
    """Displacement of the tip."""
    s = fx.Section(EI=8.3333e5, EA=1e7, C=4.16667e6, m=1.0, J=1.0, EI_y=8.3333e5, C_y=4.16667e6, J_y=1.0, GJ=GJ)
    arm = fx.Arm("bend", (fx.Link(25.0 * math.pi, s, curvature=0.01),))
    start = 100.0 * np.array([math.sqrt(0.5), 1.0 - math.sqrt(0.5), 0.0])
    return rest(arm, fx.PointLoad(0, "tip", force_z=constant(600.0)), formulation=formulation, **mesh) - start


def off_a_circle(turn: float, formulation: str | None = None, **mesh: int) -> float:
    """How far the tip is from the root under the moment that bends a rod to a circle in a plane at this angle."""
    arm, whole = fx.Arm("rod", (fx.Link(1.0, section(2.0, 1.0)),)), 4.0 * math.pi
    load = fx.PointLoad(0, "tip", torque=constant(whole * math.cos(turn)), torque_y=constant(whole * math.sin(turn)))
    return float(np.abs(rest(arm, load, formulation=formulation, **mesh)).max())


def off_a_helix(stiff: float, formulation: str | None = None, **mesh: int) -> float:
    """EI = GJ: kappa = M / EI, constant in inertial axes; the tip is int exp(s kappa) e_x ds."""
    arm, M = fx.Arm("rod", (fx.Link(1.0, section(2.0, 2.0, stiff=stiff)),)), np.array([3.0, 2.0, 6.0])
    s, w = np.polynomial.legendre.leggauss(40)
    exact = 0.5 * w @ Rotation.from_rotvec(0.25 * (1.0 + s)[:, None] * M).apply([1.0, 0.0, 0.0])
    load = fx.PointLoad(0, "tip", torque_x=constant(3.0), torque_y=constant(2.0), torque=constant(6.0))
    return float(np.abs(rest(arm, load, formulation=formulation, **mesh) - exact).max())


BUCKLES = 4.0126
"""P L^2 / sqrt(EI_w GJ) of a cantilever that is stiff in the plane of its load."""


def stability(P: float, stiff: float = 1e9, formulation: str | None = None, **mesh: int) -> float:
    """The lowest squared frequency of such a cantilever, EI_w = GJ = 1, under the load."""
    arm = fx.Arm("blade", (fx.Link(1.0, section(1e5, 1.0, EI_y=1.0, stiff=stiff, J=1e-3)),))
    load = fx.PointLoad(0, "tip", force_y=constant(-P))
    scene = everything(fx.Scene("blade", arm, duration=1.0, dt=1e-3, loads=(load,), space=True))
    return static_equilibrium(scene, formulation, require_stable=False, **mesh).stability.smallest


def buckling(low: float, high: float, *stiff: float, **how: Any) -> float:
    """The load at which it vanishes, between two near it, of which one is below and one above."""
    below, above = stability(low, *stiff, **how), stability(high, *stiff, **how)
    assert below > 0.0 > above
    return low + (high - low) * below / (below - above)


# ------------------------------------------------------------------ modes
STRIP = fx.Scene(
    "strip", fx.Arm("strip", (fx.Link(0.5, fx.Section.rectangle(0.05, 0.002, 200e9, 7870.0, 200e9 / 2.6)),)),
    duration=1.0, dt=0.05, space=True,
)  # fmt: skip
"""With a long step: what steps take from the inertia is not in its modes."""
STRIP_HZ = {"flap": 6.5147, "flap 2": 40.824, "flap 3": 114.297, "torsion": 123.370, "lateral": 161.59}
"""Hz, clamped; torsion (2k - 1)/(4L) sqrt(GJ / rho I_p)."""

FLAPS = {0.0: 3.51602, 1.0: 3.68165, 2.0: 4.13732, 6.0: 7.36037, 12.0: 13.17014}
"""By its spin the flap of `blade`, clamped; lag is sqrt(flap^2 - spin^2)."""


def blade(stiff: float = 1e8) -> fx.Scene:
    """A uniform beam of unit length, mass and stiffness."""
    arm = fx.Arm("blade", (fx.Link(1.0, section(1.0, 1.0, stiff=stiff, J=1e-7)),))
    return fx.Scene("blade", arm, duration=1.0, dt=1e-3, space=True)


def lag_and_flap(spin: float) -> tuple[float, float]:
    """Of the rotating `blade`."""
    return math.sqrt(FLAPS[spin] ** 2 - spin**2), FLAPS[spin]


SHAFT = fx.Scene(
    "shaft", fx.Arm("shaft", (fx.Link(1.0, section(1.0, 1.0, J=2e-3)),), hub_axis=(1.0, 0.0, 0.0)),
    duration=1.0, dt=1e-3,
)  # fmt: skip
"""Spun about its own axis."""


def split_of_whirls(spin: float) -> float:
    """Of `SHAFT` seen from rest: w+ - w- = J_p spin int phi'^2 / int m phi^2, to first order."""
    x, (beta, sigma) = np.linspace(0.0, 1.0, 4001), (1.8751040687, 0.7340955138)
    phi = np.cosh(beta * x) - np.cos(beta * x) - sigma * (np.sinh(beta * x) - np.sin(beta * x))
    slope = beta * (np.sinh(beta * x) + np.sin(beta * x) - sigma * (np.cosh(beta * x) - np.cos(beta * x)))
    return 4e-3 * spin * float(np.trapezoid(slope**2, x) / np.trapezoid(phi**2, x))


def rotor() -> fx.Scene:
    """An overhung disc on a light shaft that is damped within."""
    shaft = fx.Section(EI=2.0, EA=1e7, C=1e9, m=1e-6, J=1e-12, EI_y=2.0, C_y=1e9, J_y=1e-12, GJ=50.0)
    disc = fx.Payload(0.5, np.diag([2e-2, 1.1e-2, 1.1e-2]).tolist())
    arm = fx.Arm("rotor", (fx.Link(0.4, shaft),), hub_axis=(1.0, 0.0, 0.0), payload=disc, tau_d=1e-5)
    return fx.Scene("rotor", arm, duration=1.0, dt=1e-3)


def whirl_of_the_rotor(spin: float) -> Array:
    """Seen from rest, rad/s, with u = y + i z of the tip and phi its slope, exp(i w t),

        (12 EI/L^3 - m w^2) u - 6 EI/L^2 phi = 0,    -6 EI/L^2 u + (4 EI/L - I_d w^2 + I_p W w) phi = 0,

    w > 0 forward; and torsion, sqrt(GJ / (L I_p))."""
    L, EI, m, polar, lateral = 0.4, 2.0, 0.5, 2e-2, 1.1e-2
    square = np.polymul([-m, 0.0, 12.0 * EI / L**3], [-lateral, spin * polar, 4.0 * EI / L])
    square[-1] -= (6.0 * EI / L**2) ** 2
    return np.sort([*np.roots(square).real, math.sqrt(50.0 / (L * polar))])


# ------------------------------------------------------------------ motion
def tumbling(dt: float) -> tuple[fx.Scene, Array]:
    """A free rigid body about its middle axis, which it turns over; its rates by Euler's equations, each 0.5 s."""
    own, axis = np.array([1.0, 2.0, 3.0]), np.array([1e-2, 1.0, 1e-2]) / np.linalg.norm([1e-2, 1.0, 1e-2])
    body = fx.RigidLink(1.0, 5.0, (0.0, 0.0, 0.0), np.diag(own).tolist())
    arm = fx.Arm("body", (body,), hub_axis=tuple(axis.tolist()))
    scene = fx.Scene("body", arm, duration=6.0, dt=dt, sample=0.5, root="free", rates=(5.0,))
    known = solve_ivp(
        lambda _, w: np.cross(own * w, w) / own, (0.0, 6.0), 5.0 * axis, t_eval=np.arange(0.0, 6.01, 0.5), rtol=1e-11,
        atol=1e-12,
    ).y.T  # fmt: skip
    return everything(scene), known


@kernel
def energy(lane, model, par, q, v):  # type: ignore[no-untyped-def]
    return protocol.energy(lane, model, par, q, v)


def momenta(arm: fx.Arm, simulation: Simulation) -> Array:
    """Linear and angular momentum about the origin, (6,): slopes of the kinetic energy by rigid motions (Noether)."""
    model, par, w = simulation.model, simulation.par, simulation.work
    names = simulation.system.names
    places = [i for i, name in enumerate(names) if name == "root_x" or (name.startswith("link") and ".x" in name)]
    found = []
    for turning in (False, True):
        for axis in np.eye(3):
            d = np.zeros(len(names))
            for i in places:
                A = Rotation.from_rotvec(w.q[i + 3 : i + 6])
                d[i : i + 3] = np.cross(axis, w.q[i : i + 3]) if turning else axis
                d[i + 3 : i + 6] = A.inv().apply(axis) if turning else 0.0
            sides = [energy(SINGLE, model, par, w.q, w.v + sign * d)[0] for sign in (1.0, -1.0)]
            found.append(0.5 * (sides[0] - sides[1]))
    return np.array(found)


def drift(h: float, until: float, samples: int, formulation: str | None = None, **options: Any) -> Array:
    """(samples, 3): of a free arm after a push, without damping, rho_inf = 1, in steps of h: linear momentum, angular
    momentum, energy, each off by so many times its size."""
    arm = dataclasses.replace(arms.named("satellite_arm"), tau_d=0.0)
    push = fx.PointLoad(1, "tip", **{n: pulse(4.0, 0.1) for n in ("force_y", "force_z")})
    scene = fx.Scene("free", arm, duration=until, dt=h, root="free", angles=(0.0, 0.5, -1.0), loads=(push,))
    simulation, found = Simulation(everything(scene), scene.settings(formulation, rho_inf=1.0, **options)), []
    simulation.advance_to(0.1 + h)
    start, had = momenta(arm, simulation), sum(simulation.observe()[1])
    sizes = np.abs(start[:3]).max(), np.abs(start[3:]).max()
    for t in np.linspace(0.0, until, samples + 1)[1:]:
        assert simulation.advance_to(float(t))
        off, now = np.abs(momenta(arm, simulation) - start), sum(simulation.observe()[1])
        found.append((off[:3].max() / sizes[0], off[3:].max() / sizes[1], abs(now / had - 1.0)))
    assert simulation.work.counts[STEPS] >= 0.99 * until / h
    return np.array(found)
