"""Static equilibrium of scenes that start at rest under their loads, by pseudo-transient continuation.

Each step of the time integration begins with zero velocity. Each step solves M c (q - q_0) + f(q) = 0 for the
coordinates q, with the mass matrix M, the static forces f and the coordinates q_0 before the step. The factor c
decreases as the step becomes longer. The first steps are short and reduce the energy. The last steps are long, and each
is a Newton step for the equation f = 0.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from .compiler import SINGLE, uncompiled
from .physics.model import OK, OUT_OF_RANGE
from .physics.protocol import local_difference
from .physics.reading import Reading, reading_of
from .scene import JointTorque, Load, Motion, PointLoad, Scene
from .scene.drives import FORCES
from .settings import Settings
from .time_functions import TimeFunction, constant
from .validation import Array

AT_REST = 1e-12
"""The arm is at rest if its coordinates change by less than this in a long step (rad, or fraction of the arm's length).
"""

LONG = 1e4
"""Length of a long step of the continuation, s."""

MOST = 300
"""Largest number of steps of the continuation."""


class NoEquilibrium(RuntimeError):
    """Raised if no equilibrium was found; its message describes the attempts."""


def resting(scene: Scene) -> Scene:
    """Return the scene with all loads and motions constant at their values for t = 0.

    If the scene has start="held", the joints (with elastic gears, the motors) are fixed, and torques on the fixed
    joints are removed.
    """
    names = [motion.coordinate for motion in scene.motions]
    held = []
    if scene.start == "held":
        for k in range(scene.arm.n_links):
            pair = {f"joint{k}", f"motor{k}"} & set(names)
            if k not in scene.rigid_joints and not pair and not (k == 0 and scene.root == "free"):
                held.append(f"{'motor' if scene.arm.joint(k).elastic else 'joint'}{k}")
    joints = {int(name[5:]) for name in [*names, *held] if not name.startswith("root")}
    contacts = tuple(contact.held() for contact in scene.contacts)
    moved = replace(scene, motions=(), loads=(), start="unloaded", contacts=contacts)
    motions = tuple(Motion(name, constant(moved.initial_value(name))) for name in (*names, *held))
    acting = [load for load in scene.loads if not (isinstance(load, JointTorque) and load.joint in joints)]
    return replace(moved, motions=motions, loads=tuple(_at_start(load) for load in acting))


def _at_start(load: Load) -> Load:
    """Return the load with constant functions of time, at their values for t = 0."""

    def value(f: TimeFunction) -> TimeFunction:
        return constant(float(f(0.0)))

    if isinstance(load, JointTorque):
        return JointTorque(load.joint, value(load.function))
    acting = {name: getattr(load, name) for name in FORCES}
    return PointLoad(load.link, load.end, **{name: value(f) for name, f in acting.items() if f is not None})


def resting_settings(settings: Settings, reading: Reading) -> Settings:
    """Return the settings for `relax`: a constant step, and no correction of the period error (`Reading.resting`)."""
    plain: dict[str, Any] = {"step_tolerance": None, **reading.resting(settings)}
    if settings.period_correction:
        plain["period_correction"] = False
    return settings.replace(**plain)


def relax(simulation: Any) -> Array:
    """Advance a `Simulation` of a `resting` scene to its equilibrium and return the coordinates there (m, rad).

    Raises NoEquilibrium if no step length leads to rest.
    """
    work, weight = simulation.work, simulation.model.weight
    rates, algebraic = (work.v, work.a, work.b), simulation.model.algebraic
    h, before, change = simulation.dt, np.empty_like(work.q), np.empty_like(work.q)
    # multipliers do not count as moves
    rows = np.ones(len(work.q), bool)
    if algebraic is not None:
        rows[algebraic] = False
    for rate in rates:
        rate[:] = 0.0
    last = float(OK)
    for _ in range(MOST):
        before[:] = work.q
        simulation.dt = h
        simulation.t = 0.0
        good = simulation.advance_to(h)
        uncompiled(local_difference)(SINGLE, simulation.model, before, work.q, change)
        # largest change of a coordinate in rad or arm lengths; infinite where the step failed
        move = float(np.abs(change * weight)[rows].max(initial=0.0)) if good else np.inf
        # failed or too far (nan included): go back and take a quarter of the step
        if not move < 0.5:
            work.q[:] = before
            last, work.flag[0] = float(work.flag[0]), 0.0
            h *= 0.25
            if h < 1e-9 * simulation.settings.dt:
                break
        else:
            # at rest after a long step; otherwise longer steps, the faster the smaller the move
            if move < AT_REST and h >= LONG:
                return np.array(work.q)
            h = min(h * (4.0 if move < 0.1 else 1.5), LONG)
        for rate in rates:
            rate[:] = 0.0
    raise NoEquilibrium(f"no equilibrium was found for the start of the scene: {_reason(simulation, last)}")


def _reason(simulation: Any, last: float) -> str:
    """Return the reason why no equilibrium was found. last: status of the last failed step."""
    if last == OUT_OF_RANGE:
        return f"{out_of_range(simulation.model)}; start=\"unloaded\" lets it begin without stress"
    scene, frames = simulation.scene, simulation.settings.formulation == "floating_frame"
    why = "its loads may be too large"
    if frames and simulation.settings.frame == "root":
        why += ' for frame="root" (frame="chord" bears more)'
    instead = 'start="unloaded" lets it begin without stress'
    moved = {motion.coordinate[5:] for motion in scene.motions}
    if not moved.issuperset(str(k) for k in range(scene.arm.n_links) if k not in scene.rigid_joints):
        why += ", or turn it on and on"
        instead = f'start="held" holds its joints, {instead}'
    return f"{why}{reading_of(scene).buckling(simulation.settings)}; {instead}"


def out_of_range(model: Any, share: str = "") -> str:
    """Return the error message for an arm whose deflection at rest exceeds the range of its formulation.

    share: text with the smallest fraction of the loads at which the arm exceeds the range, or "".
    """
    bound = float(getattr(model, "bound", 0.0))
    why = "beyond the valid range of the reduction to modes" if bound else "larger than a floating body can have"
    instead = "take more segments (no modes), or formulation='geometrically_exact'"
    return f"the arm would deflect {why} at rest{share}; {instead}"


def rested(system: Any, scene: Scene, settings: Settings, kind: Any) -> Any:
    """Return the scene's System with initial coordinates at equilibrium, or unchanged for start="unloaded".

    kind: the class Simulation. Coordinates that the scene of `resting` lacks, such as Lagrange multipliers, start at 0.
    """
    if scene.start == "unloaded":
        return system
    still = kind(resting(scene), resting_settings(settings, reading_of(scene)))
    found = dict(zip(still.system.names, relax(still).tolist(), strict=True))
    return replace(system, q0=np.array([found.get(name, 0.0) for name in system.names]))
