"""Episodes with prescribed joint motions, from `reset(options={"motion": ...})`.

The equations of an arm with prescribed motions differ from those of the other arms of its batch. An arm with prescribed
motions therefore has its own compiled program (`runtime.guided`).
"""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import compiler, scenes, time_functions
from .. import validation as check
from ..accuracy import in_steps
from ..batch import FURTHER, STRETCH, Batch, Guided, View, aligned, guided_period, layout_of
from ..compiler import SINGLE, Placed, uncompiled
from ..physics.gauges import Spot, curvature_rows
from ..physics.integrator.work import unpack
from ..physics.model import OK
from ..physics.reading import reading_of
from ..scene import Motion, Scene
from ..settings import Settings, steps_in
from ..simulation import Simulation
from ..time_functions import TimeFunction
from ..validation import Array

WHAT = "must be a named motion, a table (n, 2 to 4), a .csv or .toml file, a TimeFunction or a Scene"


@dataclass(frozen=True)
class Prescribed:
    """Prescribed joint motions of an episode.

    functions: pairs (joint, function of time). end: end of the motion, s. scene: the user's scene, or None.
    """

    functions: tuple[tuple[int, TimeFunction], ...]
    end: float
    scene: Scene | None = None


def prescribed(value: Any, n_links: int, interpolation: str | None = None, path: str = "options.motion") -> Prescribed:
    """Convert the user's value of the reset option "motion" to `Prescribed`; a ValueError names the key `path`."""
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
    """Return whether a value is a table of numbers (True) or a list with one entry per joint (False)."""
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
    """Return the motions that a scene prescribes for joints."""
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
    """Convert a table, the path of a file or a TimeFunction to a TimeFunction; errors name the key `path`."""
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
    """One arm of a batch; the arm follows prescribed motions and has its own compiled program.

    Args:
        scene: arm, motions and loads. settings: solver settings, with dt given. period: control period, s.
        gauges: link and place of each strain gauge. gauge_scales: scale of each gauge, 1/m.
    Attributes:
        limit: number of control periods until the motion ends. moved: True if the last period was completed. free (N,):
            True for joints that neither a motion nor a load of the scene drives. simulation: `Simulation` of the arm,
            with the state of the compiled program. block: the arm's memory in the program (`tasks.program.Block`).
    """

    _home: Any = None

    def __init__(
        self, scene: Scene, settings: Settings, period: float,
        gauges: tuple[Spot, ...] = (), gauge_scales: tuple[float, ...] = (),
    ) -> None:  # fmt: skip
        """Assemble the simulation of the scene and start it.

        period: control period, s; the settings' steps are adjusted to divide it. gauges, gauge_scales: places of the
        strain gauges and their scales, 1/m.
        """
        self.scene, self.period = scene, period
        self.settings = in_steps(scene, settings, scene.duration, period)
        self.simulation = Simulation(scene, self.settings, starts=False)
        rows = curvature_rows(scene, settings, self.simulation.system, gauges)
        self.gauges = reading_of(scene).scale_rows(rows, np.array(gauge_scales))
        loaded = {getattr(load, "joint", None) for load in scene.loads}
        joints = range(scene.arm.n_links)
        self.free = np.array([scene.motion_of(f"joint{k}") is None and k not in loaded for k in joints])
        self.limit = steps_in(scene.duration, period)
        self.moved = True

    def bind(self, batch: Batch, i: int) -> Any:
        """Return the arm's `tasks.program.Program`, which writes its results into the memory of arm i of the batch."""
        if self._home is not batch.reward:
            self._place(batch, i)
        return self._placed.value

    def _place(self, batch: Batch, i: int) -> None:
        """Make the program: the batch's program with this arm's model and motions, and with its own memory."""
        simulation, given, one = self.simulation, batch.program, slice(i, i + 1)
        model, fitted = simulation.model, given.models is not None
        models = (system.model for system in simulation._systems)
        motions, reading = simulation.n_motions, batch.reading
        layout = layout_of(1, reading, model, batch.task, batch.entries, batch.extras, fitted, motions)
        self.block, self.action = aligned(1, layout.row)[0], np.zeros(len(self.free))
        flat, par = self.block[: len(simulation._flat)], self.block[layout.par : layout.poses]
        flat[:], par[:] = simulation._flat, simulation.par
        simulation._flat, simulation.par = flat, par
        simulation.work = uncompiled(unpack)(SINGLE, model, flat, simulation.n_motions)
        self.block[layout.poses : layout.saved] = batch.sections(i)
        sensors = given.sensors
        if sensors is not None:
            sensors = sensors._replace(gauges=np.ascontiguousarray(self.gauges, np.float64).ravel())
        program = given._replace(
            lane=SINGLE, model=model, models=type(given.models)(*models) if fitted else None, scheme=simulation.scheme,
            sensors=sensors, guide=self._motions(), layout=layout, watched=math.inf, n=1, block=self.block,
            action=self.action, observation=batch.observation[i], table=np.zeros(layout.saved - layout.info),
            reward=batch.reward[one], terminated=batch.terminated[one].view(np.uint8),
            truncated=batch.truncated[one].view(np.uint8), stream=batch.stream[one],
        )  # fmt: skip
        self._home, self._placed = batch.reward, Placed(program)
        self._call = compiler.entry(guided_period, self._placed, 0)

    def _motions(self) -> Guided:
        """Return the prescribed motions that the arm's program contains."""
        own, kinks = self.simulation, np.array(self.scene.kinks, np.float64)
        stretch, levels = np.zeros(STRETCH.places.end), np.zeros(0)
        stretch[STRETCH.places.gross] = own.gross
        if self.settings.step_tolerance is not None:
            levels = np.zeros(2 + self.limit + len(kinks))
            levels[: 1 + len(own.levels)] = len(own.levels), *own.levels
        return Guided(
            drive=own.drive, motions=own.n_motions, kinks=kinks, duration=float(self.scene.duration),
            joints=np.array([m.joint for m in self.scene.motions], np.int64), longest=float(own.dt), chunk=own._chunk,
            free=self.free.astype(np.float64), takes=float(self.free.any() and not self.scene.loads),
            stretch=stretch, levels=levels,
        )  # fmt: skip

    def start(self, batch: Batch, i: int) -> None:
        """Start the motion with the parameters of arm i, whose episode has begun in the batch, and observe the arm."""
        self.bind(batch, i)
        self.simulation.par[:] = batch.parameters(i)
        self._run(batch, i, True)

    def step(self, batch: Batch, i: int) -> None:
        """Advance arm i of the batch by one control period; the action in the batch applies to free joints."""
        self.bind(batch, i)
        self.action[:] = batch.action[i]
        self._run(batch, i, False)
        self.moved = self.simulation.status == OK

    def _run(self, batch: Batch, i: int, begins: bool) -> None:
        """Start or advance the arm with the record of arm i of the batch, and copy the results to the batch."""
        program, shared, at = self._placed.value, batch.sections(i), STRETCH.places
        simulation, guide, layout = self.simulation, program.guide, program.layout
        own = self.block[layout.poses : layout.saved]
        own[:] = shared
        self._call(self._placed.address, int(begins))
        shared[:] = own
        batch.table[:, i] = self.block[layout.info : layout.saved]
        simulation.t, simulation.gross = float(guide.stretch[at.time]), float(guide.stretch[at.gross])
        if len(guide.levels):
            simulation.levels = guide.levels[1 : 1 + int(guide.levels[0])].astype(int).tolist()
            simulation.step_error = float(batch.table[batch.info_at.further + FURTHER.step_error, i])

    def starts(self) -> Array:
        """Return the joint angles (N,), rad, at the start of the motion."""
        return reading_of(self.scene).start_angles(self.scene, self.simulation.observe()[0])

    def view(self, view: View) -> View:
        """Return the batch's `view` with this arm's own points, deflections and torques."""
        simulation, q = self.simulation, self.simulation.work.q
        deflection = reading_of(self.scene).bends(self.scene.arm, self.settings, view.poses, q)
        return replace(
            view, points=simulation.shape_points(), time=simulation.t, torques=simulation.joint_torques(),
            deflection=deflection, q=q.copy(),
        )  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        skipped = ("simulation", "block", "action", "_home", "_placed", "_call")
        own = self.simulation
        numbers = own._flat.copy(), own.par.copy(), own.t, own.gross, own.levels.copy()
        return {k: v for k, v in vars(self).items() if k not in skipped} | {"memory": numbers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Assemble the simulation again, because it is not pickled, and copy the pickled state into it."""
        flat, par, t, gross, levels = state["memory"]
        vars(self).update({k: v for k, v in state.items() if k != "memory"})
        own = self.simulation = Simulation(self.scene, self.settings, starts=False)
        own._flat[:], own.par[:], own.t, own.gross, own.levels = flat, par, t, gross, levels.copy()


def guide(plan: Any, motion: Prescribed, starts: Array) -> Guide:
    """Create the `Guide` that simulates an environment's arm under a prescribed motion.

    plan: the environment's `options.Plan`. starts (N,): initial angles of the free joints, rad; NaN means 0.
    """
    arm, scene = plan.arm, motion.scene
    if scene is None:
        scene = _moved(plan, motion, starts)
    elif scene.arm.n_links != arm.n_links or replace(scene.arm, torque_limits=arm.torque_limits) != arm:
        raise check.InvalidValue("options.motion", scene.name, "must be a scene of this environment's own arm")
    return Guide(scene, plan.settings, plan.period, plan.gauges, plan.gauge_scales)


def _moved(plan: Any, motion: Prescribed, starts: Array) -> Scene:
    """Return a scene with the environment's arm and motions of its joints."""
    functions = dict(motion.functions)
    for k, function in functions.items():
        check.number(f"options.motion: joint{k} at t = 0", function.start, "rad", **ANGLE)
    joints = [functions[k].start if k in functions else (0.0 if math.isnan(a) else a) for k, a in enumerate(starts)]
    end = motion.end if motion.end > 0.0 else plan.duration
    return Scene(
        "motion", plan.arm, duration=end, dt=min(plan.settings.dt, end), sample=min(plan.period, end),
        gravity=plan.gravity, angles=plan.arm.stated(joints),
        motions=tuple(Motion(f"joint{k}", f) for k, f in functions.items()),
    )  # fmt: skip
