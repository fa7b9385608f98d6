"""Episodes with prescribed motion: the values of `reset(options={"motion": ...})`, and the arms that follow a motion.

An arm with a prescribed motion runs outside the batch in its own `Simulation`, which ends a step at every kink.
`simulate` uses the same code, so both give the same numbers.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import scenes, time_functions
from .. import validation as check
from ..accuracy import in_steps
from ..batch import CLIP, FLOOR, View, is_unbalanced
from ..compiler import SINGLE, uncompiled
from ..geometry.poses import joint_angles, link_deflection
from ..physics.equations import read_gauges, read_poses
from ..physics.gauges import Spot, curvature_rows, over
from ..physics.layout import BEYOND, DISSIPATED, SPACE_POSE, WORK_DONE
from ..physics.model import DIVERGED
from ..physics.space.reading import read
from ..scene import Motion, Scene
from ..settings import Settings, steps_in
from ..simulation import Simulation
from ..time_functions import TimeFunction
from ..trajectory import placed
from ..validation import Array

WHAT = "must be a named motion, a table (n, 2 to 4), a .csv or .toml file, a TimeFunction or a Scene"


@dataclass(frozen=True)
class Prescribed:
    """Joint motions of an episode. functions: (joint, function of time) pairs. end: end of the motion, s.

    scene: the scene that is replayed unchanged, if one was given.
    """

    functions: tuple[tuple[int, TimeFunction], ...]
    end: float
    scene: Scene | None = None


def prescribed(value: Any, n_links: int, interpolation: str | None = None, path: str = "options.motion") -> Prescribed:
    """Return the joint motions of one arm from a user's value; every ValueError names the key `path`."""
    if isinstance(value, Prescribed):
        return value
    if isinstance(value, Scene):
        return Prescribed(_joints(path, value, n_links), value.duration, value)
    if _is_scene(value):
        scene = _scene(path, value)
        joints = _joints(path, scene, n_links)
        if not joints:
            raise check.InvalidValue(path, scene.name, "must be a scene that prescribes a joint's angle")
        return Prescribed(joints, scene.duration)
    if isinstance(value, Mapping) and "t" not in value:
        entries = {_joint(path, key, n_links): entry for key, entry in value.items()}
    elif isinstance(value, list | tuple) and not is_table(value):
        if len(value) != n_links:
            raise check.InvalidValue(path, value, f"must hold one entry a joint, {n_links} (None: not prescribed)")
        entries = dict(enumerate(value))
    else:
        return _by_joint({0: value}, (path,), interpolation)
    if all(entry is None for entry in entries.values()):
        raise check.InvalidValue(path, value, "must prescribe at least one joint")
    return _by_joint(entries, tuple(f"{path}.joint{k}" for k in range(n_links)), interpolation)


def _joint(path: str, key: Any, n_links: int) -> int:
    names = [f"joint{k}" for k in range(n_links)]
    if key not in names:
        raise check.UnknownKey(check.joined(path, str(key)), names, "joint")
    return names.index(key)


def _by_joint(entries: dict[int, Any], paths: tuple[str, ...], interpolation: str | None) -> Prescribed:
    """Return the function of time of each joint; a scene contributes the motion of its hub."""
    functions, end = dict[int, TimeFunction](), 0.0
    for joint, entry in entries.items():
        if entry is None:
            continue
        if _is_scene(entry):
            scene = _scene(paths[joint], entry)
            functions[joint] = dict(_joints(paths[joint], scene, 1))[0]
            end = max(end, scene.duration)
        else:
            functions[joint] = function_of(paths[joint], entry, interpolation)
            end = max(end, functions[joint].end)
    return Prescribed(tuple(sorted(functions.items())), end)


def _is_scene(value: Any) -> bool:
    """Return whether a value is the name or the TOML file of a scene."""
    return isinstance(value, str | os.PathLike) and not os.fspath(value).endswith(".csv")


def is_table(value: Any) -> bool:
    """Return whether a value is a table, that is rows of numbers, and not a list with one entry per joint."""
    return all(isinstance(row, list | tuple) and all(isinstance(x, int | float) for x in row) for row in value)


def _scene(path: str, name: Any) -> Scene:
    """Return the named scene; an error names the keyword `path` and lists the scenes that have motions."""
    try:
        return scenes.resolve(name)
    except check.InvalidValue as error:
        raise check.InvalidValue(path, name, error.allowed) from None
    except check.UnknownKey:
        known = [n for n in scenes.names(parameter_sets=True) if scenes.named(n).motions]
        raise check.UnknownKey(f"{path} = {name!r}", known, "motion (and no .csv or .toml file)") from None


def _joints(path: str, scene: Scene, n_links: int) -> tuple[tuple[int, TimeFunction], ...]:
    """Return the joint motions of a scene."""
    if scene.root == "free":
        raise check.InvalidValue(path, scene.name, "must be a scene of an arm that is pinned, not of a free body")
    found = []
    for motion in scene.motions:
        if motion.joint is None:
            raise check.InvalidValue(path, scene.name, "must not move the root of the arm")
        if motion.joint >= n_links:
            what = f"must not move joint {motion.joint}: there are {n_links} joint(s)"
            raise check.InvalidValue(path, scene.name, what)
        found.append((motion.joint, motion.function))
    return tuple(found)


def function_of(path: str, entry: Any, interpolation: str | None = None) -> TimeFunction:
    """Return a function of time from a table, a file or a TimeFunction; errors name the key `path`."""
    with check.under(path):
        return _function(entry, interpolation)


def _function(entry: Any, interpolation: str | None) -> TimeFunction:
    """Make a TimeFunction without jumps from a TimeFunction, a table, an array (n, 2) of t (s), value, or a .csv."""
    if isinstance(entry, TimeFunction):
        entry.check_no_jump()
        return entry
    if isinstance(entry, str | os.PathLike):
        if not Path(entry).is_file():
            raise check.InvalidValue("", os.fspath(entry), "must be a .csv file that exists")
        return time_functions.from_csv(entry, interpolation)
    if isinstance(entry, Mapping):
        check.known_keys("", entry, time_functions.COLUMNS)
        for name in ("t", "psi"):
            check.needed("", entry, name, "must be a list of numbers")
        return time_functions.table(**entry, interpolation=interpolation)
    try:
        rows = np.asarray(entry)
    except ValueError:
        rows = np.array(None)
    if rows.dtype.kind not in "fiu" or rows.ndim != 2:
        raise check.InvalidValue("", entry, WHAT)
    return time_functions.from_array(rows, interpolation)


FARTHEST = 1e6
ANGLE = {"minimum": -FARTHEST, "maximum": FARTHEST}
"""Range of start angles and targets, rad; larger angles lose the digits that distinguish small differences."""


class Guide:
    """An arm that follows a prescribed motion and is simulated outside of the batch.

    Args:
        scene: arm, motions and loads. settings: solver settings, with dt given. period: control period, s. limits:
            torque limits, N m.
        gauges: link and place of each strain gauge. gauge_scales: scale of each gauge, 1/m.
    Attributes:
        limit: number of control periods until the motion ends. moved: whether the last period was completed. free (N,):
            joints that neither a motion nor a load of the scene drives.
    """

    def __init__(
        self, scene: Scene, settings: Settings, period: float, limits: Array,
        gauges: tuple[Spot, ...] = (), gauge_scales: tuple[float, ...] = (),
    ) -> None:  # fmt: skip
        """Assemble the scene's simulation and start it.

        period: control period, s; the settings' steps are adjusted to divide it. limits (N,): limits, N m, to which the
        displayed torques are clipped. gauges, gauge_scales: places of the strain gauges and their scales, 1/m.
        """
        self.scene, self.period, self.limits = scene, period, limits
        self.settings = in_steps(scene, settings, scene.duration, period)
        self.simulation = Simulation(scene, self.settings)
        rows = curvature_rows(scene, settings, self.simulation.system, gauges)
        self.gauges = over(rows, np.array(gauge_scales), scene.spatial)
        loaded = {getattr(load, "joint", None) for load in scene.loads}
        joints = range(scene.arm.n_links)
        self.free = np.array([scene.motion_of(f"joint{k}") is None and k not in loaded for k in joints])
        self.limit = steps_in(scene.duration, period)
        self.steps, self.moved = 0, True
        self._start()

    def _start(self) -> None:
        self.simulation.reset()
        self.start_energy = float(self.simulation.observe()[1].sum())

    def set_parameters(self, parameters: Array) -> None:
        """Set this arm's payload, stiffness and damping (see `physics.model.PAYLOAD_MASS`) before the first step."""
        if not np.array_equal(parameters, self.simulation.par):
            self.simulation.par[:] = parameters
            self._start()

    def advance(self, torques: Array) -> int:
        """Advance one control period with torques (N,), N m, on the free joints; return the status code.

        For derivatives, `runtime.guided.follow_motions` computes the same period.
        """
        simulation = self.simulation
        if self.steps:
            simulation.restart_at_kink()
        if self.free.any() and not self.scene.loads and not np.array_equal(simulation.work.u[: len(torques)], torques):
            simulation.set_torques(torques, fresh=False)
        self.steps += 1
        self.moved = simulation.advance_to(min(self.steps * self.period, self.scene.duration))
        if self.moved and (simulation.gained(self.start_energy) or self._is_unbalanced()):
            simulation.work.flag[0] = DIVERGED
        return simulation.status

    def _is_unbalanced(self) -> bool:
        """Return whether the energy exceeds initial energy plus work (`runtime.energy_balance` has the rule)."""
        kinetic, strain, gravity = self.simulation.observe()[1].tolist()
        accounted = self.start_energy + float(self.simulation.work.books[WORK_DONE])
        exchanged = abs(self.start_energy) + self.simulation.gross
        floor = FLOOR * float(self.limits.sum())
        return bool(uncompiled(is_unbalanced)(SINGLE, kinetic + strain, gravity, accounted, exchanged, floor))

    def report(self) -> dict[str, Array]:
        """Return the arm's poses, joint torques, motor angles, energies and gauges, as in `Batch.take_report`.

        If gears are rigid, the motor angles equal the joint angles.
        """
        simulation, work = self.simulation, self.simulation.work
        poses, energies = simulation.observe()
        if self.scene.spatial:
            poses, bent = np.zeros((self.scene.arm.n_links, SPACE_POSE.end)), np.empty((1, len(self.gauges)))
            read_poses(simulation.system.model, simulation.par, work.q, work.v, poses.reshape(-1))
            read_gauges(simulation.system.model, work.q[None], self.gauges, bent)
            places = self._read()
        else:
            places = placed(simulation.system.coordinates, poses[None], work.q[None], work.v[None])
            bent = self.gauges @ work.q
        return {
            "poses": poses, "torque": simulation.joint_torques(), "motors": places["motor_angles"][0],
            "energies": np.array([*energies, work.books[DISSIPATED] + work.books[BEYOND], work.books[WORK_DONE]]),
            "gauges": np.clip(bent.ravel(), -CLIP, CLIP),
        }  # fmt: skip

    def _read(self) -> dict[str, Any]:
        """Return the quantities of the state from which observations of an arm in space are computed."""
        work = self.simulation.work
        return read(self.scene.arm, self.settings, work.q[None], work.v[None])

    def starts(self) -> Array:
        """Return the joint angles (N,), rad, at the motion's start."""
        if self.scene.spatial:
            return np.array(self.scene.angles)
        return joint_angles(self.simulation.observe()[0])[0]

    def view(self, target: Array) -> View:
        """Return the arm's present shape as a `View`, with a target."""
        simulation, poses = self.simulation, self.report()["poses"]
        if self.scene.spatial:
            seen = self._read()
            points, deflection = seen["shapes"][0], seen["tip_deflection"][0].T.ravel()
        else:
            points = simulation.shape_points()
            deflection = link_deflection(poses) / np.array([link.span for link in self.scene.arm.links])
        return View(
            points=points, poses=poses, time=simulation.t, target=target,
            torques=simulation.joint_torques(), deflection=deflection, q=simulation.work.q.copy(),
        )  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        kept = {k: v for k, v in vars(self).items() if k != "simulation"}
        own = self.simulation
        numbers = own._flat.copy(), own.par.copy(), own.t, own.gross, own._level, own.levels.copy(), own._restarted
        return kept | {"memory": numbers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Assemble the simulation again, because it is not pickled, and copy the pickled state into it."""
        flat, par, t, gross, level, levels, restarted = state["memory"]
        vars(self).update({k: v for k, v in state.items() if k != "memory"})
        self.simulation = Simulation(self.scene, self.settings)
        self.simulation._flat[:], self.simulation.par[:] = flat, par
        self.simulation.t, self.simulation.gross = t, gross
        self.simulation._level, self.simulation.levels, self.simulation._restarted = level, levels.copy(), restarted


def guide(plan: Any, motion: Prescribed, starts: Array) -> Guide:
    """Return the guide that simulates an environment's arm under a prescribed motion.

    plan: the environment's `options.Plan`. starts (N,): initial angles of the free joints, rad; NaN: 0.
    """
    arm, scene = plan.arm, motion.scene
    if scene is None:
        scene = _moved(plan, motion, starts)
    elif scene.arm.n_links != arm.n_links or replace(scene.arm, torque_limits=arm.torque_limits) != arm:
        raise check.InvalidValue("options.motion", scene.name, "must be a scene of this environment's own arm")
    limits = np.array(arm.torque_limits)
    return Guide(scene, plan.settings, plan.period, limits, plan.gauges, plan.gauge_scales)


def _moved(plan: Any, motion: Prescribed, starts: Array) -> Scene:
    """Return the scene of the environment's arm with motions of its joints."""
    functions = dict(motion.functions)
    for k, function in functions.items():
        check.number(f"options.motion: joint{k} at t = 0", function.start, "rad", **ANGLE)
    joints = [functions[k].start if k in functions else (0.0 if math.isnan(a) else a) for k, a in enumerate(starts)]
    end = motion.end if motion.end > 0.0 else plan.duration
    return Scene(
        "motion", plan.arm, duration=end, dt=min(plan.settings.dt, end), sample=min(plan.period, end),
        gravity=plan.gravity, angles=tuple(joints if plan.arm.spatial else np.cumsum(joints).tolist()),
        motions=tuple(Motion(f"joint{k}", f) for k, f in functions.items()),
    )  # fmt: skip
