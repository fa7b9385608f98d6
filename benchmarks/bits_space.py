"""Cases of `benchmarks.bits` in space: each formulation alone, and with each feature of arms in space.

Scenes contain every feature of `tests.feature_matrix_space` and some pairs of features, under every formulation, and
arms of rigid links. Environments are single, vector, and with two threads. Derivatives are tangents, cotangents and
Jacobians of rollouts, linear models, and runs. Controllers are included.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks import bits_cases as plane
from benchmarks.bits_cases import FLOATING, FORMULATIONS, SPATIAL, Case, Parts
from flexarm_env import arms, control
from flexarm_env.bodies import RigidLink
from flexarm_env.derivatives.runs import Run
from flexarm_env.linear import linearize, modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Joint, Motor, Payload
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant, cycloid, sine
from tests.feature_matrix_space import PAIRS, SHEARED, SINGLE, scene_of

METHODS = ("exact", "segments", "modes", "elastica")
FURTHER = ("exact, modified Newton", "exact, Newmark", "modes in segments", "elastica, damped steps")
"""Formulations that only a few scenes use."""

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "exact": {}, "segments": FLOATING, "modes": {"modes": 2, **FLOATING},
    "modes in segments": {"modes": 2, "segments": 2, **FLOATING},
}  # fmt: skip
"""Keywords of each formulation of the environments; the features of `FEATURED` use the first three."""


def jointed(**changes: Any) -> Arm:
    """Return the arm `three_dof_loaded` with an elastic gear, a rotor and viscous friction in all three joints."""
    own: dict[str, Any] = {"stiffness": 2000.0, "damping": 2.0, "motor_inertia": 1e-5, "gear_ratio": 50.0}
    joint = Joint(**own | {"friction_viscous": 0.01} | changes)
    return dataclasses.replace(arms.named("three_dof_loaded"), joints=(joint,) * 3)


RIGID_GEARS = {"stiffness": float("inf"), "damping": 0.0}
LOADED = {"arm": "three_dof_loaded"}
RANDOM = {
    "payload": (0.5, 2.0), "EI": (0.7, 1.3), "GJ": (0.8, 1.2), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1),
}  # fmt: skip
MOTORS: dict[str, Any] = {"actuator": {"lag": 0.002, "delay": 0.005}}
EVENTS: dict[str, Any] = {
    "pushes": {"wait": (0.02, 0.1), "force": (0.5, 2.0), "lasting": 0.1},
    "payload_change": {"time": (0.05, 0.2), "factor": (0.5, 2.0)},
    **LOADED,
}
SENSORS: dict[str, Any] = {
    "encoders": {"low_pass": {"frequency": 25.0, "order": 2}, "delay": 0.01}, "gyroscope": {"bias": 0.01},
    "accelerometer": {"bias": 0.1, "low_pass": {"frequency": 20.0}}, "camera": {"period": 0.03},
}  # fmt: skip
GAUGES = [{"link": k, "measures": what} for k in (1, 2) for what in ("xy", "xz", "torsion")]
RICH: dict[str, Any] = {
    "task": "track", "info_level": "full", "action_mode": "residual_pd", "history": 2, "randomization": RANDOM,
    "initial_vibration": 0.02, "sensors": {"noise": 0.01, "delay": 0.01}, **MOTORS, **LOADED,
}  # fmt: skip
FEATURED: dict[str, dict[str, Any]] = {
    "loaded, random": {"randomization": RANDOM, "info_level": "full", **LOADED},
    "gears": {"arm": jointed(), "info_level": "full"},
    "gears, rubbing, play": {"arm": jointed(friction_coulomb=0.2, backlash=0.01)},
    "rotors, rubbing": {"arm": jointed(**RIGID_GEARS, friction_coulomb=0.2)},
    "events": {**EVENTS, "cost": {"deflection": 0.05}},
    "all": RICH,
}
"""Keywords of features that are computed under each formulation, single and as a vector."""
FEATURED_EXACT: dict[str, dict[str, Any]] = {
    "measured": {"observation": "measured", "sensors": {**SENSORS, "strain_gauges": GAUGES}, "history": 3},
    "strain": {"cost": {"deflection": 0.05, "strain": 5e-4}, **EVENTS},
    "tapered": {"arm": "turret_boom"},
    "satellite": {"arm": "satellite_arm", "gravity": (0.0, 0.0, 0.0)},
    "voltage": {
        "arm": jointed(motor=Motor(torque_constant=0.05, resistance=0.5, voltage_limit=24.0)),
        "action_mode": "voltage",
    },
    "same step": {"autoreset_mode": "SameStep", "max_episode_steps": 12},
    "short": {"max_episode_steps": 12},
}
"""Keywords of features that are computed with the exact beam only."""

DIFFERENTIATED: dict[str, dict[str, Any]] = {
    "alone": {},
    "parameters": {"parameters": True, "randomization": {"payload": (0.5, 1.5), "GJ": (0.8, 1.2)}, **LOADED},
    "gears": {"arm": jointed(), "parameters": True},
    "rotors, rubbing": {"arm": jointed(**RIGID_GEARS, friction_coulomb=0.2)},
    "events": EVENTS,
}
"""Keywords of environments whose rollouts are differentiated, under each formulation."""
DIFFERENTIATED_EXACT: dict[str, dict[str, Any]] = {
    "gears, rubbing": {"arm": jointed(friction_coulomb=0.2)},
    "pd, motors": {"action_mode": "residual_pd", "residual_share": 0.3, **MOTORS},
    "targets, sensors": {"task": "track", "observation": "measured", "sensors": SENSORS, "history": 2},
}

PAIRED = (
    ("elbow", "free flight"), ("elbow", "shaken base"), ("prescribed elbow", "gravity"), ("pillar", "free flight"),
    ("elbow", "fast rotor"), ("fast rotor", "pillar"), ("driven motor", "dry friction"), ("curved", "rest start"),
)  # fmt: skip
assert set(PAIRED) <= set(PAIRS)
ALSO = ("tip_rotation",)
"""Attributes of a trajectory in space that are compared besides `bits_cases.SAMPLED`."""


def cell(features: tuple[str, ...], method: str) -> Parts:
    """Simulate a scene of `tests.feature_matrix_space` with a step of 2 ms, and return its results."""
    return plane.simulated(scene_of(features), method, ALSO, dt=2e-3)


def rigid(root: str, method: str) -> Parts:
    """Simulate an arm of two rigid links with hinge axes that are not parallel. root: pinned or free."""
    links = (
        RigidLink(0.4, 1.0, (0.2, 0.01, 0.0), ((8e-3, 0.0, 0.0), (0.0, 2e-2, 0.0), (0.0, 0.0, 1.5e-2))),
        RigidLink(0.3, 0.5, (0.1, 0.0, 0.02), ((3e-3, 0.0, 0.0), (0.0, 8e-3, 0.0), (0.0, 0.0, 6e-3))),
    )
    arm = Arm("rigid", links, elbows=(Elbow(axis=(0.6, 0.0, 0.8)),), payload=Payload(0.1, 2e-4, (0.0, 0.03, 0.02)))
    loads = (JointTorque(1, sine(0.3, 6.0)), PointLoad(1, "tip", force_z=sine(0.5, 5.0)))
    scene = Scene("rigid", arm, duration=0.3, dt=0.005, sample=0.02, root=root, loads=loads, angles=(0.2, 0.5),
                  rates=(1.0, -2.0), gravity=(0.0, 0.0, -9.81))  # fmt: skip
    return plane.simulated(scene, method, ALSO)


def slew(**changes: Any) -> Scene:
    """Return a scene: the arm `three_dof_loaded` under gravity, a torque at its first joint and a load at its tip."""
    own: dict[str, Any] = {
        "duration": 0.2, "dt": 0.0025, "sample": 0.02, "gravity": (0.0, 0.0, -9.81), "angles": (0.0, 0.6, 0.8),
        "loads": (JointTorque(0, sine(4.0, 6.0)), PointLoad(2, "tip", force_y=sine(0.5, 6.0))),
    }  # fmt: skip
    return Scene("slew", arms.named("three_dof_loaded"), **own | changes)


def linear(method: str) -> Parts:
    """Return the linear model, modes and equilibrium of an arm at rest; modes and equilibrium have held joints."""
    formulation, options = FORMULATIONS[method]
    rest = slew(loads=())
    matrices = linearize(slew(loads=(), angles=(0.0, 0.0, 0.0)), formulation, discrete=0.01, **options)
    found = modes(rest, 3, formulation, clamped=True, **options)
    held = static_equilibrium(rest, formulation, hold_joints=True, **options)
    parts = {f"d_matrix {k}": matrix for k, matrix in enumerate(matrices)}
    return parts | {"d_frequencies": found.frequencies, "d_damping": found.damping, "d_shape": held.shape_points()}


def run(method: str) -> Parts:
    """Run a scene, and compute the derivatives of its states by the payload's mass."""
    formulation, options = FORMULATIONS[method]
    e = 1e-4

    def made(payload: float) -> Simulation:
        scene = slew()
        own = dataclasses.replace(scene, arm=dataclasses.replace(scene.arm, payload=Payload(payload)))
        return Simulation(own, own.settings(formulation, **options))

    found = Run.of(made(0.2), 0.02)
    by_mass = found.slopes([(made(0.2 + e), e, 0.5 / e), (made(0.2 - e), -e, -0.5 / e)])
    return {name: getattr(found, name) for name in ("start", "t", "q", "v", "a")} | {"d_by_mass": by_mass}


def cases() -> dict[str, Case]:
    """Return all cases in space, by name."""
    found: dict[str, Case] = {}

    def add(name: str, function: Callable[..., Parts], *arguments: Any, **keywords: Any) -> None:
        found[f"space, {name}"] = partial(function, *arguments, **keywords)

    def differentiate(word: str, keywords: dict[str, Any], **more: Any) -> None:
        keywords = {"tolerance": 1e-10, **keywords}
        add(f"derivatives, {word}", plane.derivatives, SPATIAL, keywords, **{"n": 5, "periods": 4, **more})

    for word, keywords in ENVIRONMENTS.items():
        for n in (1, 11):
            add(f"env, {word}, {n}", plane.environment, SPATIAL, keywords, n)
        differentiate(word, keywords)
    add("crew", plane.environment, SPATIAL, {}, 33, threads=2, periods=20)
    for features in (*SINGLE, *PAIRED):
        for method in METHODS:
            if not (method == "elastica" and SHEARED & {*features}):
                add(f"scene {' + '.join(features)}, {method}", cell, features, method)
    for features in (("torques and tip load",), ("elbow",), ("free flight",)):
        for method in FURTHER:
            add(f"scene {' + '.join(features)}, {method}", cell, features, method)
    for method in METHODS:
        for root in ("pinned", "free"):
            add(f"rigid, {root}, {method}", rigid, root, method)
        add(f"slew, {method}", plane.simulated, slew(), method, ALSO)
        motions = (Motion("joint1", constant(0.6)), Motion("joint2", cycloid(0.5, 0.15, 0.8)))
        guided = slew(motions=motions, angles=(0.0, 0.6, 0.8))
        add(f"slew, joints held and led, {method}", plane.simulated, guided, method, ALSO)
        add(f"linear, {method}", linear, method)
        add(f"run, {method}", run, method)
    for word, own in list(ENVIRONMENTS.items())[:3]:
        for feature, keywords in FEATURED.items():
            for n in (1, 5):
                add(f"env, {feature}, {word}, {n}", plane.environment, SPATIAL, keywords | own, n, periods=25)
        add(f"guided, {word}", plane.guided, SPATIAL, own)
        add(f"linear models, {word}", plane.many, SPATIAL, own, 0.01)
        for feature, keywords in DIFFERENTIATED.items():
            if keywords:
                differentiate(f"{feature}, {word}", keywords | own)
        differentiate(f"guided, {word}", own | {"joint_limits": None}, n=3, motion=plane.MOTIONS[SPATIAL])
    for feature, keywords in FEATURED_EXACT.items():
        for n in (1, 5):
            if n > 1 or "autoreset_mode" not in keywords:
                add(f"env, {feature}, exact, {n}", plane.environment, SPATIAL, keywords, n, periods=25)
    for feature, keywords in DIFFERENTIATED_EXACT.items():
        differentiate(f"{feature}, exact", keywords)
    for name in ("pd", "zv", "lqr"):
        add(f"controller {name}", plane.steered, name, SPATIAL)
    measured = {"observation": "measured", "sensors": {"strain_gauges": GAUGES}}
    add("controller lqg", plane.steered, "lqg", SPATIAL, **measured)
    assert {"pd", "zv", "lqr", "lqg"} <= set(control.NAMES)
    return found
