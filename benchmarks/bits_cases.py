"""Cases of `benchmarks.bits` in the plane, computed through the package's public names alone.

The cases cover environments of every kind, single and vector, with resets and with two threads; motions that arms
follow; the suite's tasks; controllers; derivatives of control periods, linear models and runs; and every packaged
scene. Further scenes contain every kind of load, motion, joint and link, under every formulation and its options.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from flexarm_env import arms, control, scenes, suite
from flexarm_env.derivatives import Arms
from flexarm_env.derivatives.runs import Run
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import CHAIN, REACH
from flexarm_env.linear import linearize, modes, static_equilibrium
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scene import JointTorque, Motion, PointLoad, Scene
from flexarm_env.simulation import Simulation, simulate
from flexarm_env.time_functions import cycloid, from_array, pulse, ramp, sine, steps

Parts = dict[str, Any]
Case = Callable[[], Parts]

MAIN = ("segments", "modes", "exact", "elastica")
FORMULATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "segments": ("floating_frame", {"segments": 3}),
    "elements": ("floating_frame", {"segments": 1, "elements": 3}),
    "paper": ("floating_frame", {"segments": 2, "elements": 2, "coupling": "paper"}),
    "modes": ("floating_frame", {"modes": 2}),
    "modes in segments": ("floating_frame", {"modes": 2, "segments": 2}),
    "exact": ("geometrically_exact", {"elements": 4}),
    "exact, order 3": ("geometrically_exact", {"elements": 2, "order": 3}),
    "exact, corrected": ("geometrically_exact", {"elements": 4, "period_correction": True}),
    "exact, modified Newton": ("geometrically_exact", {"elements": 4, "newton": "modified"}),
    "elastica": ("elastica", {"nodes": 5}),
    "elastica, fitted": ("elastica", {"nodes": 4, "step_tolerance": 1e-4}),
    "elastica, damped steps": ("elastica", {"nodes": 4, "rho_inf": 0.6}),
    "multipliers": ("floating_frame", {"segments": 2, "multipliers": True}),
    "multipliers, modes": ("floating_frame", {"modes": 2, "segments": 2, "multipliers": True}),
    "root frames": ("floating_frame", {"segments": 2, "frame": "root"}),
    "root frames, modes": ("floating_frame", {"modes": 2, "frame": "root"}),
    "linear": ("floating_frame", {"segments": 2, "elements": 2, "coupling": "linear"}),
    "segments, fitted": ("floating_frame", {"segments": 2, "step_tolerance": 1e-4}),
    "exact, fitted": ("geometrically_exact", {"elements": 3, "step_tolerance": 1e-4}),
    "exact, Newmark": ("geometrically_exact", {"elements": 3, "newmark": (0.3025, 0.6)}),
}
FURTHER = tuple(FORMULATIONS)[12:]
"""Formulations that only three of the scenes use."""

ONE, TWO, MULTI, SPATIAL = "FlexibleArm-v0", "TwoLinkFlexArm-v0", "MultiLinkFlexArm-v0", "SpatialFlexArm-v0"
FLOATING, EXACT = {"formulation": "floating_frame"}, {"formulation": "geometrically_exact"}
RANDOM = {"payload": (0.5, 2.0), "EI": (0.7, 1.3), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1)}
MOTORS: dict[str, Any] = {"actuator": {"lag": 0.01, "delay": 0.02}}
EVENTS: dict[str, Any] = {
    "pushes": {"wait": (0.02, 0.1), "force": (0.1, 0.3), "lasting": 0.1},
    "payload_change": {"time": (0.1, 0.3), "factor": (0.5, 2.0)},
    "cost": {"deflection": 0.05, "strain": 5e-4},
}
SENSORS: dict[str, Any] = {
    "strain_gauges": [{"place": 0.1, "gain": (0.9, 1.1), "delay": 0.02}],
    "encoders": {"low_pass": {"frequency": 15.0, "order": 2}, "delay": 0.03},
    "accelerometer": {"bias": 0.1, "low_pass": {"frequency": 10.0}},
    "camera": {"period": 0.06},
}
NOISE = {"strain_gauges": [{"place": 0.1, "noise": 0.01}], "encoders": {"counts": 4096, "noise": 1e-4}}
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "default": {},
    "exact": EXACT,
    "floating": FLOATING,
    "floating, modes": {"formulation": "floating_frame", "modes": 2, "segments": 3, "dt": 0.002},
    "random": {"randomization": RANDOM, "initial_vibration": 0.02, "info_level": "full", "gravity": (0.0, -9.81)},
    "motors": {"actuator": {"lag": 0.01, "delay": 0.02, "viscous": 0.01, "coulomb": 0.02}},
    "sensors": {"sensors": {"noise": 0.01, "delay": 0.02}, "action_mode": "residual_pd"},
    "fitted": {"step_tolerance": 1e-4, "dt": 0.02},
    "track": {"task": "track", "info_level": "full"},
    "short": {"duration": 0.3, "max_episode_steps": 12},
    "exact, corrected": {"formulation": "geometrically_exact", "period_correction": True, "randomization": RANDOM},
}
"""Keywords of environments with one and with two links: single, vector, and with two threads."""


def geared(links: int, **joint: Any) -> Arm:
    """Return a packaged arm with gears and one or two links. joint: further fields of every joint."""
    arm = arms.named("strip_geared" if links == 1 else "two_link_geared")
    return dataclasses.replace(arm, joints=[dataclasses.replace(own, **joint) for own in arm.joints])


def rubbing(name: str) -> Arm:
    """Return a packaged arm whose joints have viscous and Coulomb friction."""
    arm = arms.named(name)
    joint = Joint(motor_inertia=1e-4, gear_ratio=10.0, friction_viscous=0.05, friction_coulomb=0.05)
    return dataclasses.replace(arm, joints=(joint,) * arm.n_links)


RICH: dict[str, Any] = {
    "gravity": (0.0, -1.0), "task": "track", "info_level": "full", "action_mode": "residual_pd", "history": 2,
    "randomization": RANDOM, "initial_vibration": 0.02, "actuator": {"lag": 0.01, "delay": 0.08 / 3},
}  # fmt: skip
LATER = {"actuator": {"lag": 0.01, "delay": 0.04}}
FEATURED: dict[str, tuple[str, dict[str, Any]]] = {
    "gears, rubbing": (ONE, {"arm": geared(1)}),
    "gears, rubbing, two": (TWO, {"arm": geared(2)}),
    "gears, play": (ONE, {"arm": geared(1, backlash=0.05)}),
    "gears, exact": (ONE, {"arm": geared(1, friction_coulomb=0.0), **EXACT}),
    "gears, rubbing, floating, two": (TWO, {"arm": geared(2), **FLOATING}),
    "rubbing, two": (TWO, {"arm": rubbing("de_luca_siciliano")}),
    "rubbing, exact": (ONE, {"arm": rubbing("strip"), **EXACT}),
    "rubbing, floating": (ONE, {"arm": rubbing("strip"), **FLOATING}),
    "voltage": (ONE, {"arm": geared(1), "action_mode": "voltage"}),
    "events": (ONE, EVENTS),
    "events, two": (TWO, EVENTS),
    "events, exact": (ONE, {**EVENTS, **EXACT}),
    "events, floating": (ONE, {**EVENTS, **FLOATING}),
    "measured": (ONE, {"observation": "measured", "sensors": SENSORS, "history": 3}),
    "measured, noise, two": (TWO, {"observation": "measured", "sensors": NOISE}),
    "all": (ONE, {**RICH, "sensors": {"noise": 0.01, "delay": 0.04, "strain_gauges": [0.0, 0.5]}}),
    "all, two, exact": (TWO, {**RICH, **EXACT, **LATER, "sensors": {"strain_gauges": [(0, 0.0), (1, 0.5)]}}),
    "all, one, floating": (ONE, {**RICH, **FLOATING, **LATER, "sensors": {"strain_gauges": [0.0, 0.5]}}),
    "fitted, exact": (ONE, {"step_tolerance": 1e-4, "dt": 0.02, **EXACT}),
    "fitted, floating": (ONE, {"step_tolerance": 1e-4, "dt": 0.02, **FLOATING}),
    "multipliers": (ONE, {"multipliers": True, **FLOATING}),
    "multipliers, two": (TWO, {"multipliers": True, "segments": 1, "elements": 1, **FLOATING}),
    "root frames, two": (TWO, {"frame": "root", "modes": 2, "segments": 1, **FLOATING}),
    "three links": (MULTI, {}),
    "three links, pd, motors": (MULTI, {"action_mode": "residual_pd", **MOTORS}),
    "same step": (ONE, {"autoreset_mode": "SameStep", "max_episode_steps": 12}),
}
"""Further environments by name (id, keywords), each computed single and as a vector."""

SMOOTH = from_array([[0.0, 0.1], [0.05, 0.12], [0.13, 0.2], [5.0, 0.6]])
BENT = from_array([[0.0, 0.0, 0.0], [0.085, 0.03, 0.6], [0.15, 0.06, 0.2], [5.0, 0.6, 0.0]])
BROKEN = from_array([[0.0, 0.0], [0.085, 0.05], [0.16, 0.02], [5.0, 0.6]], "linear")
HUBS = [SMOOTH, BROKEN, cycloid(0.2, 0.15)]
JOINTS: list[Any] = [{"joint0": BROKEN}, {"joint1": SMOOTH}, {"joint0": BENT}]
MOTIONS: dict[str, list[Any]] = {
    ONE: HUBS, TWO: JOINTS, SPATIAL: [{"joint0": BROKEN}, {"joint1": SMOOTH, "joint2": SMOOTH}, {"joint2": BENT}],
}  # fmt: skip
GUIDED: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": (ONE, {}),
    "elastica, two": (TWO, {}),
    "floating": (ONE, FLOATING),
    "exact, two": (TWO, EXACT),
    "modes": (ONE, {"modes": 2, "segments": 1, **FLOATING}),
    "multipliers": (ONE, {"multipliers": True, "segments": 1, **FLOATING}),
}
"""Environments in which three arms follow the prescribed motions `MOTIONS`."""

DIFFERENTIATED: dict[str, tuple[str, dict[str, Any]]] = {
    "one link": (ONE, {}),
    "two links": (TWO, {}),
    "floating": (ONE, FLOATING),
    "exact": (ONE, EXACT),
    "parameters": (ONE, {"parameters": True, "gravity": (0.0, -9.81), "randomization": {"payload": (0.5, 1.5)}}),
    "pd, motors": (TWO, {"action_mode": "residual_pd", "residual_share": 0.3, **MOTORS}),
    "gears": (ONE, {"arm": geared(1, friction_coulomb=0.0), "parameters": True}),
    "gears, two": (TWO, {"arm": geared(2, friction_coulomb=0.0)}),
    "gears, rubbing": (ONE, {"arm": geared(1)}),
    "rubbing, two": (TWO, {"arm": rubbing("de_luca_siciliano")}),
    "floating, modes, two": (TWO, {"modes": 2, "segments": 1, **FLOATING}),
    "gears, rubbing, floating, two": (TWO, {"arm": geared(2), **FLOATING}),
    "exact, motors, two": (TWO, {**MOTORS, **EXACT}),
    "exact, corrected": (ONE, {"period_correction": True, **EXACT}),
    "gears, exact": (ONE, {"arm": geared(1, friction_coulomb=0.0), **EXACT}),
    "three links": (MULTI, {}),
    "targets, sensors": (TWO, {"task": "track", "observation": "measured", "sensors": SENSORS, "history": 2}),
    "fitted": (ONE, {"step_tolerance": 1e-5}),
    "fitted, floating, two": (TWO, {"step_tolerance": 1e-5, **FLOATING}),
    "events": (ONE, {key: EVENTS[key] for key in ("pushes", "payload_change")}),
    "root frames, modes": (ONE, {"frame": "root", "modes": 2, "segments": 1, "parameters": True, **FLOATING}),
    "multipliers": (ONE, {"multipliers": True, "parameters": True, "gravity": (0.0, -9.81), **FLOATING}),
}
CONTROLLERS = (*((name, ONE) for name in control.NAMES if name != "lqg"), ("lqr", TWO), ("mpc", TWO))

STRIP = Section(2.0, 2e5, 7e4, 0.3, 1e-6)


def driven() -> dict[str, Scene]:
    """Return scenes of one and two links with every kind of load and motion, including jumps."""
    one = Arm("one", (Link(1.0, STRIP),), hub_inertia=0.02, payload=Payload(0.1, 1e-4), tau_d=2e-3)
    two = Arm(
        "two", (Link(0.6, STRIP), Link(0.4, STRIP)), hub_inertia=0.02, elbows=(Elbow(0.1, 1e-3, 2e-3),),
        payload=Payload(0.1, 1e-4), tau_d=2e-3,
    )  # fmt: skip
    wave = sine(0.5, 6.0)
    shake = Motion("root_y", sine(0.03, 15.0)), Motion("root_x", cycloid(0.1, 0.3))
    tip, thrown = PointLoad(0, "tip", wave, wave, wave), PointLoad(0, "root", wave, pulse(5.0, 0.1), wave)
    kicked = {"motions": (Motion("joint1", cycloid(1.0, 0.3)),), "loads": (JointTorque(0, pulse(1.0, 0.13)),)}
    drives: dict[str, tuple[Arm, dict[str, Any]]] = {
        "torque": (one, {"loads": (JointTorque(0, steps([0.0, 0.2], [1.0, -1.0])),), "gravity": (0.0, -9.81)}),
        "shaken": (one, {"motions": shake}),
        "held": (one, {"motions": (Motion("joint0", ramp(0.5, 0.21)),), "loads": (tip,)}),
        "elbow": (two, kicked),
        "rigid": (two, {"angles": (0.0, 0.6), "rigid_joints": (1,), "loads": (JointTorque(0, wave),)}),
        "thrown": (two, {"root": "free", "loads": (thrown,)}),
    }
    return {name: _scene(name, arm, own) for name, (arm, own) in drives.items()}


def built() -> dict[str, Scene]:
    """Return scenes of arms with every kind of joint and link."""
    ends = {"root_offset": 0.05, "root_mass": 0.04, "root_inertia": 2e-5, "tip_offset": 0.03, "tip_mass": 0.03}
    thin = Section(1.4, 1.6e5, 5.6e4, 0.25, 8e-7)
    uneven = Link(0.9, [(0.0, STRIP), (0.5, STRIP), (0.5, thin), (0.9, thin)], **ends)  # type: ignore[arg-type]
    bent = Link(1.0, STRIP, curvature=((0.0, 1.6), (1.0, 0.4)), tau_d=8e-3)
    far = Payload(0.1, 2e-4, (0.05, 0.08))
    wave, jump = sine(1.0, 6.0), steps([0.0, 0.2], [1.0, -1.0])
    both = {"loads": (JointTorque(0, jump), JointTorque(1, wave)), "gravity": (0.0, -2.0)}
    alone: dict[str, Any] = {"loads": (JointTorque(0, jump),)}
    rows: dict[str, tuple[Arm, dict[str, Any]]] = {
        "gears": (geared(1, friction_coulomb=0.0), alone),
        "gears, rubbing, two": (geared(2), both),
        "play": (geared(1, backlash=0.05), alone),
        "rubbing": (rubbing("strip"), alone),
        "rubbing, two": (rubbing("de_luca_siciliano"), both),
        "motor held": (geared(1, friction_coulomb=0.0), {"motions": (Motion("motor0", cycloid(0.5, 0.3)),)}),
        "uneven": (Arm("uneven", (uneven,), hub_inertia=0.02, payload=far, tau_d=2e-3), alone),
        "bent, two": (Arm("bent", (bent, bent), elbows=(Elbow(0.05, 1e-4, 1e-4),), payload=far, tau_d=2e-3), both),
        "three": (arms.named("three_strips"), both),
    }
    return {name: _scene(name, arm, own) for name, (arm, own) in rows.items()}


def _scene(name: str, arm: Arm, own: dict[str, Any]) -> Scene:
    return Scene(name, arm, duration=0.5, dt=0.004, sample=0.02, **own)


SAMPLED = (
    "t", "q", "v", "tip", "tip_velocity", "joint_angles", "motor_angles", "motor_rates", "energy", "work", "dissipated",
    "gross_work", "joint_torque", "tip_deflection", "shapes", "status", "steps", "iterations", "factorizations",
    "halvings", "step_levels",
)  # fmt: skip
"""Attributes of a trajectory that are compared."""


def simulated(scene: Scene, method: str, also: tuple[str, ...] = (), **more: Any) -> Parts:
    """Simulate a scene and return its results. also: attributes that are compared besides `SAMPLED`."""
    formulation, options = FORMULATIONS[method]
    run = simulate(scene, formulation, estimate_error=False, **options, **more)
    return {name: getattr(run, name) for name in (*SAMPLED, *also)}


def shipped(name: str, method: str, **more: Any) -> Parts:
    """Simulate at most 2 s of a packaged scene and return its results."""
    scene = scenes.named(name)
    return simulated(scene, method, duration=min(2.0, scene.duration), sample=0.1, **more)


def _noted(found: dict[str, list[Any]], seen: Any, info: dict[str, Any]) -> None:
    for name, value in {"observation": seen, **info}.items():
        found.setdefault(name, []).append(value)


def episode(env: Any, periods: int = 40, **options: Any) -> Parts:
    """Run an episode with random actions; return observations, rewards, end flags and all info entries.

    A single environment is reset when its episode ends.
    """
    rng, found = np.random.default_rng(7), {"reward": [], "ended": []}
    _noted(found, *env.reset(seed=3, options=options or None))
    for _ in range(periods):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(action)
        _noted(found, seen, info)
        found["reward"].append(reward)
        found["ended"].append([terminated, truncated])
        if not hasattr(env, "num_envs") and (terminated or truncated):
            _noted(found, *env.reset(options=options or None))
    env.close()
    return found


def _recorded(env_id: str, keywords: dict[str, Any]) -> dict[str, Any]:
    """Return keywords of an environment with the starts of rules 1, from which the cases are recorded."""
    if env_id not in (TWO, MULTI) or keywords.keys() & {"starts", "rules"} or keywords.get("task") in ("press", "land"):
        return keywords
    made = plan(REACH if env_id == TWO else CHAIN, **keywords)
    wide = made.kind.starts(made.arm, 1)
    return {**keywords, "starts": {"angles": wide.start, "straight": wide.straight}}


def environment(env_id: str, keywords: dict[str, Any], n: int, threads: int = 1, periods: int = 40) -> Parts:
    """Run an episode in a vector of n arms, or in a single environment (n = 1)."""
    keywords = _recorded(env_id, keywords)
    if n == 1:
        return episode(gym.make(env_id, **keywords), periods)
    return episode(gym.make_vec(env_id, num_envs=n, threads=threads, **keywords), periods)


def guided(env_id: str, keywords: dict[str, Any]) -> Parts:
    """Run three arms that follow prescribed motions in a vector, and the first arm in a single environment."""
    motions, keywords = MOTIONS[env_id], _recorded(env_id, keywords)
    shared = "multipliers" in keywords
    many = gym.make_vec(env_id, num_envs=3, threads=1, **keywords)
    parts = episode(many, 20, motion=motions[0] if shared else motions)
    alone = episode(gym.make(env_id, **keywords), 20, motion=motions[0])
    return parts | {f"single, {name}": value for name, value in alone.items()}


def derivatives(env_id: str, keywords: dict[str, Any], n: int = 9, periods: int = 6, **options: Any) -> Parts:
    """Compute a rollout, its directional derivatives and gradients, and the Jacobians of one period."""
    own, rng = Arms(env_id, n, threads=1, **_recorded(env_id, keywords)), np.random.default_rng(5)
    state = own.reset(seed=2, options=options or None)
    run = own.rollout(state, rng.uniform(-0.7, 0.7, (periods, n, own.action_size)))
    by_state = np.zeros_like(state)
    by_state[:, : own.moving] = 1e-2 * rng.standard_normal((n, own.moving))
    ahead = run.jvp(by_state, rng.standard_normal(run.actions.shape))
    bars = (rng.standard_normal(shape) for shape in (run.observations.shape, run.rewards.shape))
    back = run.vjp(None, *bars)
    period = own.jacobians(run.states[3], run.actions[3])
    seen = own.observe(run.states[4])
    own.close()
    values = {"states": run.states, "observations": run.observations, "rewards": run.rewards, "observed": seen}
    values |= {"failed": run.failed, "past": run.past, "state": period.state, "observation": period.observation}
    slopes = {name: getattr(period, name) for name in ("A", "B", "C", "D", "r_x", "r_u")}
    slopes |= {"jvp states": ahead.states, "jvp observations": ahead.observations, "jvp rewards": ahead.rewards}
    slopes |= {"vjp state": back.state, "vjp actions": back.actions}
    return values | {f"d_{name}": value for name, value in slopes.items()}


def steered(name: str, env_id: str, **keywords: Any) -> Parts:
    """Run 25 control periods of four arms under a controller; return actions and observations."""
    env: Any = gym.make_vec(env_id, num_envs=4, threads=1, **_recorded(env_id, keywords))
    seen, _ = env.reset(seed=5)
    controller = control.make(name, env)
    controller.reset(seen)
    found: dict[str, list[Any]] = {"d_actions": [], "d_observations": [seen]}
    for _ in range(25):
        found["d_actions"].append(controller.act(seen))
        seen = env.step(found["d_actions"][-1])[0]
        found["d_observations"].append(seen)
    env.close()
    return dict(found)


def _model(model: Any) -> Parts:
    return {f"d_{name}": getattr(model, name) for name in ("A", "B", "C", "D", "rate")} | {"y": model.y}


def many(env_id: str, keywords: dict[str, Any], discrete: float | None) -> Parts:
    """Return the linear models of five moving arms of a vector environment."""
    env: Any = gym.make_vec(env_id, num_envs=5, threads=1, **_recorded(env_id, keywords))
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.full(env.action_space.shape, 0.4, np.float32))
    parts = _model(env.unwrapped.linearize(discrete=discrete))
    env.close()
    return parts


def linear(method: str) -> Parts:
    """Return the linear model and modes of an arm at rest, and the equilibrium of a hanging arm."""
    formulation, options = FORMULATIONS[method]
    rest = Scene("rest", arms.named("strip"), duration=1.0, dt=0.0025, gravity=(0.0, -9.81))
    found = modes(rest, 3, formulation, clamped=True, **options)
    matrices = linearize(rest, formulation, discrete=0.02, **options)
    hanging = static_equilibrium(dataclasses.replace(rest, angles=(-1.2,)), formulation, hold_joints=True, **options)
    parts = {f"d_matrix {k}": matrix for k, matrix in enumerate(matrices)}
    return parts | {"d_frequencies": found.frequencies, "d_damping": found.damping, "d_shape": hanging.shape_points()}


def run(method: str) -> Parts:
    """Run a scene, and compute the derivatives of its states by the payload's mass."""
    formulation, options = FORMULATIONS[method]
    load = PointLoad(0, "tip", force_y=sine(0.5, 6.0))
    scene = Scene("run", arms.named("strip"), duration=0.5, dt=0.005, sample=0.02, loads=(load,), gravity=(0.0, -9.81))
    e = 1e-4

    def made(payload: float) -> Simulation:
        own = dataclasses.replace(scene, arm=dataclasses.replace(scene.arm, payload=Payload(payload)))
        return Simulation(own, own.settings(formulation, **options))

    found = Run.of(made(0.2), 0.02)
    by_mass = found.slopes([(made(0.2 + e), e, 0.5 / e), (made(0.2 - e), -e, -0.5 / e)])
    return {name: getattr(found, name) for name in ("start", "t", "q", "v", "a")} | {"d_by_mass": by_mass}


def task(task_id: str) -> Parts:
    """Run 12 control periods of a task of the suite."""
    return episode(suite.make_vec(task_id, 3, threads=1), 12)


def cases() -> dict[str, Case]:
    """Return all cases in the plane and the packaged scenes, by name; the most important ones come first."""
    found: dict[str, Case] = {}
    both = [(env_id, word, keywords) for word, keywords in ENVIRONMENTS.items() for env_id in (ONE, TWO)]

    def add(name: str, function: Callable[..., Parts], *arguments: Any, **keywords: Any) -> None:
        found[name] = partial(function, *arguments, **keywords)

    for env_id, word, keywords in both[:8]:
        for n in (1, 11):
            add(f"{env_id}, {word}, {n}", environment, env_id, keywords, n)
    add("crew", environment, ONE, {}, 300, threads=2)
    for word, (env_id, keywords) in list(DIFFERENTIATED.items())[:6]:
        add(f"derivatives, {word}", derivatives, env_id, {"tolerance": 1e-10, **keywords})
    for name, scene in driven().items():
        for method in ("segments", "exact", "elastica"):
            add(f"scene {name}, {method}", simulated, scene, method)
    for word, (env_id, keywords) in GUIDED.items():
        add(f"guided, {word}", guided, env_id, keywords)
    for word, (env_id, keywords) in FEATURED.items():
        add(f"{env_id}, {word}, 5", environment, env_id, keywords, 5)
    for env_id, word, keywords in both:
        for n, threads in ((1, 1), (11, 1), (33, 2)):
            if n < 33 or "floating" not in word:
                add(f"{env_id}, {word}, {n}", environment, env_id, keywords, n, threads)
    for word, (env_id, keywords) in DIFFERENTIATED.items():
        add(f"derivatives, {word}", derivatives, env_id, {"tolerance": 1e-10, **keywords})
    for word, (env_id, keywords) in GUIDED.items():
        if "multipliers" not in keywords:
            motions = MOTIONS[env_id]
            more = {} if env_id == ONE else {"joint_limits": None}
            add(f"derivatives, guided, {word}", derivatives, env_id, keywords | more, 3, motion=motions)
    for env_id, word, discrete in ((ONE, {}, 0.02), (TWO, {}, 0.02), (ONE, {}, None), (ONE, EXACT, 0.02)):
        add(f"linear models, {env_id}, {[*word.values()]}, {discrete}", many, env_id, word, discrete)
    for method in MAIN:
        add(f"linear, {method}", linear, method)
    for name, env_id in CONTROLLERS:
        add(f"controller {name}, {env_id}", steered, name, env_id)
    add("controller lqg, measured", steered, "lqg", ONE, observation="measured")
    for one in suite.tasks(earlier=True):
        add(f"suite, {one.id}", task, one.id)
    for name in scenes.names():
        for method in ("segments", "exact", "elastica"):
            add(f"scene {name}, {method}", shipped, name, method, dt=0.05)
        add(f"scene {name}, own steps", shipped, name, "elastica")
    for name, scene in built().items():
        for method in MAIN:
            add(f"scene {name}, {method}", simulated, scene, method)
    for method in ("segments", "exact", "elastica"):
        add(f"run, {method}", run, method)
    for word, (env_id, keywords) in FEATURED.items():
        if "autoreset_mode" not in keywords:
            add(f"{env_id}, {word}, 1", environment, env_id, keywords, 1)
    for name, scene in driven().items():
        for method in FORMULATIONS:
            if method not in FURTHER or name in ("torque", "elbow", "thrown"):
                add(f"scene {name}, {method}", simulated, scene, method)
    for name in scenes.names(parameter_sets=True):
        if "@" in name:
            add(f"scene {name}, elastica", shipped, name, "elastica", dt=0.05)
    return found
