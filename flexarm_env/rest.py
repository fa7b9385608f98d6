"""Scenes that start at rest under their loads: the equilibrium, by pseudo-transient continuation.

Each step of the integrator begins without velocity, M c (q - q_before) + f(q) = 0, where c falls as the step grows:
first short steps downhill, at last long ones, which are Newton's iteration for f = 0.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from .compiler import SINGLE, uncompiled
from .physics.protocol import difference
from .scene import JointTorque, Load, Motion, PointLoad, Scene
from .scene.drives import FORCES
from .settings import Settings
from .time_functions import TimeFunction, constant
from .validation import Array

AT_REST = 1e-12
"""Move of a long step, rad or lengths of the arm, below which the arm rests."""

LONG = 1e4
"""Length of a long step, s."""

MOST = 300
"""Steps tried."""


class NoEquilibrium(RuntimeError):
    """No equilibrium was found; the message says what was tried."""


def resting(scene: Scene) -> Scene:
    """The scene as it is before t = 0: its loads as they are at 0, its motions where they begin; joints held where
    start="held", behind an elastic gear its motor."""
    names = [motion.coordinate for motion in scene.motions]
    held = []
    if scene.start == "held":
        for k in range(scene.arm.n_links):
            pair = {f"joint{k}", f"motor{k}"} & set(names)
            if k not in scene.rigid_joints and not pair and not (k == 0 and scene.root == "free"):
                held.append(f"{'motor' if scene.arm.joint(k).elastic else 'joint'}{k}")
    joints = {int(name[5:]) for name in [*names, *held] if not name.startswith("root")}
    moved = replace(scene, motions=(), loads=(), start="unloaded")
    motions = tuple(Motion(name, constant(moved.initial_value(name))) for name in (*names, *held))
    acting = [load for load in scene.loads if not (isinstance(load, JointTorque) and load.joint in joints)]
    return replace(moved, motions=motions, loads=tuple(_at_start(load) for load in acting))


def _at_start(load: Load) -> Load:
    """The load as it is at t = 0."""

    def value(f: TimeFunction) -> TimeFunction:
        return constant(float(f(0.0)))

    if isinstance(load, JointTorque):
        return JointTorque(load.joint, value(load.function))
    acting = {name: getattr(load, name) for name in FORCES}
    return PointLoad(load.link, load.end, **{name: value(f) for name, f in acting.items() if f is not None})


def resting_settings(settings: Settings, space: bool) -> Settings:
    """The settings with steps of one size and an uncorrected period. An elastica in space has such inertia, of its
    stiffness, as steps of a second give it: all its strains then go to rest alike."""
    plain: dict[str, Any] = {"step_tolerance": None}
    if space and settings.formulation == "elastica":
        plain["dt"] = 1.0
    if settings.period_correction:
        plain["period_correction"] = False
    return settings.replace(**plain)


def relax(simulation: Any) -> Array:
    """Coordinates of rest of a `Simulation` of a `resting` scene, which is advanced to it.

    Raises NoEquilibrium where steps do not come to an end.
    """
    work, weight = simulation.work, simulation.model.weight
    rates, algebraic = (work.v, work.a, work.b), simulation.model.algebraic
    h, before, change = simulation.dt, np.empty_like(work.q), np.empty_like(work.q)
    rows = np.ones(len(work.q), bool)
    if algebraic is not None:
        rows[algebraic] = False
    for rate in rates:
        rate[:] = 0.0
    for _ in range(MOST):
        before[:] = work.q
        simulation.dt = h
        simulation.t = 0.0
        good = simulation.advance_to(h)
        uncompiled(difference)(SINGLE, simulation.model, before, work.q, change)
        move = float(np.abs(change * weight)[rows].max(initial=0.0)) if good else np.inf
        if not move < 0.5:  # it failed, or went too far
            work.q[:] = before
            work.flag[0] = 0.0
            h *= 0.25
            if h < 1e-9 * simulation.settings.dt:
                break
        else:
            if move < AT_REST and h >= LONG:
                return np.array(work.q)
            h = min(h * (4.0 if move < 0.1 else 1.5), LONG)
        for rate in rates:
            rate[:] = 0.0
    raise NoEquilibrium(
        "no rest was found for the scene to start from: its loads may be too large, turn it on and on, or be just "
        "below what it buckles under, where floating frames in space find none (geometrically_exact does); "
        'start="held" holds its joints, start="unloaded" lets it begin without stress'
    )


def rested(system: Any, scene: Scene, settings: Settings, kind: Any) -> Any:
    """The scene's System with the coordinates that the scene starts at. kind: the class Simulation.

    A row that the resting scene has not, a multiplier, begins at 0.
    """
    if scene.start == "unloaded":
        return system
    still = kind(resting(scene), resting_settings(settings, scene.spatial))
    found = dict(zip(still.system.names, relax(still).tolist(), strict=True))
    return replace(system, q0=np.array([found.get(name, 0.0) for name in system.names]))
