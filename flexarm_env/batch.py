"""Batches of arms that one compiled call advances by a control period. A single environment has a batch of one arm.

All arms of a batch have the same model and task. Each arm has its own payload, stiffness, damping and torque constant.
Arms are stored in groups, one arm per SIMD lane, and the groups are distributed among threads. The results of an arm
depend neither on its group nor on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import physics  # noqa: F401  (registers the formulations)
from .compiler import SINGLE, WIDEST, Beside, Placed, entry, native, uncompiled
from .compiler.crew import CROWDED, OneAtATime, one_at_a_time
from .compiler.pace import Team, default_threads
from .compiler.sheets import Sheet
from .parameters import Arm
from .physics import assembly, precision
from .physics.contact.build import with_paths
from .physics.gauges import Spot, curvature_rows
from .physics.integrator.work import unpack, work_size
from .physics.joints.build import with_own_laws
from .physics.layout import COUNTS
from .physics.model import System
from .physics.obstacles import KeepOut, packed
from .physics.reading import Reading, reading_of
from .runtime import episode as environment
from .runtime import starts
from .runtime.energy_balance import inertia_per_rate
from .runtime.guided import Guided
from .runtime.keep_out import with_room
from .runtime.laws import LAW_SIZE, law_of, room_of
from .runtime.layout import aligned, layout_of, record_sizes
from .runtime.sampling import STRETCH
from .runtime.starts import guided_period
from .runtime.told import View, info_places, touches_of
from .scene import Contact, standing_scene
from .settings import Settings
from .simulation import fitted_systems
from .tasks.attainable import Attainable, attainable, draw_attainable, first_unattainable
from .tasks.contact_info import CONTACT, CONTACT_POINT, contact_length
from .tasks.land import Land, LandChain
from .tasks.own_terms import TERM_ARGUMENTS, with_terms
from .tasks.press import Press, PressChain, SpacePress
from .tasks.program import (
    ACTION_NOT_FINITE,
    CLIP,
    FRESH,
    FURTHER,
    GOAL,
    GUIDED,
    INFO,
    MODE,
    OVER,
    PERIODS,
    PERIODS_ALLOWED,
    REASONS,
    RECORD,
    REQUEST,
    RETRY,
    RUNNING,
    STATUS_WORDS,
    SUCCESS,
    TARGET,
    Actuator,
    Amplifier,
    Controller,
    Cost,
    Extras,
    Instruments,
    Models,
    PayloadChange,
    Program,
    Pushes,
    Reference,
    Selection,
    Sensors,
)
from .tasks.reach import Chain, Reach
from .tasks.slew import Slew
from .tasks.space import SpaceReach
from .tasks.starts import ALWAYS, FACTOR_NAMES, Starts
from .tasks.task import Task
from .validation import Array

LANES_FROM = 3  # smallest batch that is stored in lanes of eight arms; smaller batches advance arms one by one
ALONE_AFTER = 1  # steps after which a single arm's program is compiled, for arms whose Newton iteration fails


def gauge_table(
    arm: Arm, settings: Settings, gravity: tuple[float, ...] | None, places: Sequence[Spot],
    contacts: tuple[Contact, ...] = (),
) -> Array:  # fmt: skip
    """Return rows (G, n), one per strain gauge: curvature (1/m) = row q. places: (link, 0 at root to 1 at tip)."""
    assert settings.dt is not None
    scene = standing_scene(arm, settings.dt, gravity, contacts=contacts)
    return curvature_rows(scene, settings, assembly.assemble(scene, settings), places)


class Batch:
    """n arms with a task.

    Args:
        arm: the arm. settings: solver settings with dt. gravity: acceleration of gravity, m/s^2. n: number of arms.
        task: constants of the task, a `tasks.task.Task`. starts: ranges from which starts of episodes are drawn.
        period: control period, s, a multiple of settings.dt. account: True to record energies, work and dissipation.
        threads: largest number of threads; None selects the fastest number by timing (`compiler.pace`).
        extras: controllers, motors, sensors, moving targets. contacts: the arms' contacts.
        left: tip error due to mesh and step, divided by the arm's length; inf if unknown. starting: True to compile the
            starts of episodes.
    Attributes:
        action (n, A) float32: actions of all arms, which the caller writes before `step`.
        observation (n, O) float32, reward (n,), terminated, truncated (n,): results of the last step or start.
        table: entries of info. Each entry has one or more rows; each arm has one column, and spare columns follow.
        sheet: the `Sheet` that owns the memory of `table` and stores the views of `table` that callers get.
        info_at: row in `table` at which each entry of `INFO` starts. request: values for the next start, in the layout
            `REQUEST`; NaN: drawn at random. address: memory address of `program`, an argument of compiled functions.
    """

    def __init__(
        self, arm: Arm, settings: Settings, n: int, task: Task, starts: Starts, *,
        period: float, gravity: tuple[float, ...] | None = None, account: bool = False, threads: int | None = 1,
        extras: Extras | None = None, left: float = math.inf, contacts: tuple[Contact, ...] = (), starting: bool = True,
    ) -> None:  # fmt: skip
        """Assemble the arm, choose lanes and threads, and compile or load the programs."""
        assert settings.dt is not None
        self.arm, self.settings, self.n, self.task, self.starts = arm, settings, n, task, starts
        self.period, self.gravity, self.account, self.extras = period, gravity, account, extras or Extras()
        self.left, self.contacts, self.starting = left, contacts, starting
        drawn = starts.drawn
        self.tolerance = precision.of_torques(arm, settings, precision.largest(drawn), drawn["damping"][1])
        pushed = self.extras.pushes is not None
        scene = standing_scene(arm, settings.dt, gravity, (), pushed, contacts)
        self.systems = [with_paths(scene, system) for system in fitted_systems(scene, settings)]
        self.systems = [with_own_laws(system, starts.hub) for system in self.systems] if starts.laws else self.systems
        self.system: System = self.systems[-1]
        self.lane = SINGLE if n < LANES_FROM or settings.multipliers else WIDEST
        self.groups = -(-n // len(self.lane))
        self.paced = threads is None
        self.threads = max(1, min(default_threads(n) if threads is None else threads, self.groups))
        self.pose = self.reading.pose_table(arm, settings, gravity)
        if self.pose is not None:
            # rows of moving obstacles, which the start of an episode sets
            self.pose = np.pad(self.pose, ((0, len(self.system.q0) - len(self.pose)), (0, 0)))
        self._build()

    def _build(self) -> None:
        """Allocate the memory of all arms and compile or load the programs."""
        lanes, model, task, settings = len(self.lane), self.system.model, self.task, self.settings
        assert settings.dt is not None
        gauges = 0 if self.extras.sensors is None else len(self.extras.sensors.gauges) // len(self.system.q0)
        ahead = 0 if self.extras.reference is None else len(self.extras.reference.scales)
        read = 0 if self.extras.instruments is None else self.extras.instruments.entries
        self.entries = len(task.entries) + ahead + read + gauges
        fitted = settings.step_tolerance is not None
        # layout of one lane group; _work: numbers per arm of the integrator, without its counters
        self.layout = layout_of(lanes, self.reading, model, task, self.entries, self.extras, fitted)
        self._work = int(uncompiled(work_size)(1, model, 0)) - COUNTS.places.end  # these are apart
        count, links = self.n, self.arm.n_links
        self.info_at = info_places(task)
        self.block = aligned(self.groups, self.layout.row)
        self.action = np.zeros((count, links), np.float32)
        chosen = self.extras.selection
        width = self.entries if chosen is None else len(chosen.chosen) * chosen.frames
        self.observation = np.zeros((count, width), np.float32)
        size = (self.layout.saved - self.layout.info) // lanes
        self._sheets = [Sheet(np.zeros((size, self.groups * lanes))) for _ in range(2)]
        self.sheet, self.table = self._sheets[0], self._sheets[0].array
        self.queue = np.zeros(count, np.int64)
        self.reward = np.zeros(count)
        self.terminated, self.truncated = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        self.stream = np.zeros(count, np.uint64)
        self.request = np.full(REQUEST.offsets(0, links, links * (task.given == "goals")).end, np.nan)
        # the program: a record of all arrays and constants that compiled code reads
        n_steps = round(self.period / settings.dt)
        room = np.zeros((assembly.room_for_points(settings, links), len(self.arm.axes)))
        shapes = with_room(self.extras.keep_out, model, self.system.q0, room, self.groups, self.arm.total_length)
        self.program = Program(
            lane=self.lane, model=model, scheme=assembly.scheme_of(settings, self.tolerance), task=task,
            models=Models(*(system.model for system in self.systems)) if fitted else None,
            allowed=(settings.step_tolerance or 0.0) * self.arm.total_length,
            ranges=self.starts.ranges(self.pose, self.system.par), layout=self.layout,
            **(vars(self.extras) | {"keep_out": shapes}), guide=None,
            entries=self.entries, books=(0,) if self.account else None, watched=self._inertia(), estimate=self.estimate,
            period=self.period, h=self.period / n_steps, n_steps=n_steps, n=count,
            block=self.block.reshape(-1), action=self.action.reshape(-1), queue=self.queue,
            observation=self.observation.reshape(-1), table=self.table.reshape(-1), reward=self.reward,
            terminated=self.terminated.view(np.uint8), truncated=self.truncated.view(np.uint8),
            stream=self.stream, request=self.request,
        )  # fmt: skip
        self._placed = Placed(self.program)
        self.address = self._placed.address
        self.compiled_step = entry(environment.step, self._placed, 0, 0)
        self._start = entry(starts.start_episodes, self._placed, 0, 0) if self.starting else None
        self._team = Team(self.groups, None if self.paced else self.threads)
        self._native = native(environment.step, self._placed, 0, 0) if self._team.most > 1 else 0
        self._alone, self.repeats = self._beside(), 0  # repeats: periods of arms that were repeated alone
        # default parameters, in the spare lanes as well; every episode is over until its start
        for i in range(self.groups * lanes):
            self._par(i)[...] = self.system.par
        for i in range(count):
            self.record(i)[MODE] = OVER

    def _inertia(self) -> float:
        """Return 2 T of the arm turning rigidly at 1 rad/s, divided by the number of its absolute angles, kg m^2.

        The energy balance of an elastica estimates the kinetic energy T with this inertia and so avoids most
        evaluations of the energy (`runtime.energy_balance`). The result is 0 for other formulations, which have no
        such estimate. It is inf without absolute angles, as in space: every period then evaluates the energy.
        """
        model, q, v = self.system.model, self.system.q0, np.zeros(len(self.system.q0))
        if model.newton.resolved is None:
            return 0.0
        if not len(self.system.absolute):
            return math.inf
        v[list(self.system.absolute)] = 1.0
        return float(uncompiled(inertia_per_rate)(SINGLE, model, self.system.par, q.copy(), v))

    @property
    def estimate(self) -> float:
        """Estimated error of the tip, divided by the arm's length, due to mesh, step, and the elastica's neglect of
        stretch and shear; inf if unknown. The error due to neglected stretch and shear is a linear estimate, which is
        too small in fast whip-like motions (docs/theory.md, section 5). (inf, because nan would differ from itself in
        checks of determinism.)
        """
        return self.left + self.system.notes.get("stretch_and_shear", 0.0)

    @property
    def reading(self) -> Reading:
        """Functions that read the poses and points of the arms."""
        return reading_of(self.arm)

    # --- one arm's entries -----------------------------------------------------------------------
    def _mine(self, first: int, last: int, i: int) -> Array:
        """Return arm i's entries from `first` to `last` - 1 of the block, as a view."""
        # a block row is a lane group: entry k of all its lanes is contiguous
        lanes = len(self.lane)
        return self.block[i // lanes, first:last].reshape(-1, lanes)[:, i % lanes]

    def _par(self, i: int) -> Array:
        return self._mine(self.layout.par, self.layout.poses, i)

    def record(self, i: int) -> Array:
        """Return a view of arm i's record (`tasks.program.RECORD`)."""
        return self._mine(self.layout.record, self.layout.action, i)

    def poses(self, i: int) -> Array:
        """Return a copy of the poses (N, 12) of arm i's links after the last period or start (for `View`)."""
        end = self.layout.record - len(self.task.base) * len(self.lane)
        return self._mine(self.layout.poses, end, i).reshape(self.arm.n_links, -1).copy()

    def joints(self, i: int) -> tuple[Array, Array]:
        """Return arm i's joint angles (N,), rad, and rates, rad/s; on a floating base the hub's values are absolute."""
        return self.reading.joints(self.poses(i))

    # --- motion ----------------------------------------------------------------------------------
    def parameters(self, i: int) -> Array:
        """Return a copy of arm i's own parameters (`physics.model.OWN`)."""
        return self._par(i).copy()

    def motion(self, i: int) -> tuple[Array, Array, Array]:
        """Return copies of arm i's coordinates q and rates v (rows,) and of its joint torques (N,), N m."""
        return tuple(rows[i].copy() for rows in self.motions()[:3])

    def motions(self) -> tuple[Array, Array, Array, Array]:
        """Return copies of all arms' coordinates and rates (n, rows), joint torques (n, N), N m, and parameters."""
        work = uncompiled(unpack)(self.lane, self.system.model, np.arange(self.layout.par, dtype=np.float64), 0)
        rows, lanes = len(self.system.q0), len(self.lane)

        def mine(start: float, count: int) -> Array:
            part = self.block[:, int(start) : int(start) + count * lanes].reshape(self.groups, count, lanes)
            return part.transpose(0, 2, 1).reshape(-1, count)[: self.n].copy()

        par = mine(self.layout.par, len(self.system.par))
        torques = work.u[0]
        if self.extras.actuator is not None:  # the motors' present torque; u is that of the last step
            at = RECORD.offsets(0, *record_sizes(self.task, self.entries, self.extras)).torque
            torques = self.layout.record + at * lanes
        return mine(work.q[0], rows), mine(work.v[0], rows), mine(torques, self.arm.n_links), par

    def set_starts(self, starts: Starts) -> None:
        """Set the ranges of initial states of later episodes; running episodes continue. The call compiles another
        program if the new ranges require one.
        """
        anew = (starts.attainable is None) != (self.starts.attainable is None)
        self.starts, self._alone = starts, self._beside()
        if anew:
            self._team.close()
            self.__setstate__(self.__getstate__())
            return
        ranges = starts.ranges(self.pose, self.system.par)
        for name in ("start", "target", "straight"):
            getattr(self.program.ranges, name)[...] = getattr(ranges, name)

    def ask(self, angles: Array, target: Array, vibration: Array) -> None:
        """Request that the next episode starts with joint angles (N,), rad, target (2,), and vibration (1,) or (3,).
        NaN stands for a random number. In space the target is given by joint angles (N,) at which the arm reaches it.
        """
        asked = {"angles": angles, "target": np.full(2, np.nan), "goals": np.zeros(0)}
        asked |= {"vibration": np.resize(vibration, 3), self.task.given: target}
        self.request[:] = REQUEST.pack({"joints": self.arm.n_links, "goals": len(asked["goals"])}, **asked)

    def start(self, arms: Sequence[int], keys: Sequence[int], *, limit: int, mode: int = RUNNING) -> None:
        """Start episodes of `arms` with at most `limit` periods. keys: 64 random bits per arm, the generator's seed."""
        lanes, at = len(self.lane), self.layout.record + PERIODS_ALLOWED * len(self.lane)
        self.queue[: len(arms)] = chosen = np.asarray(arms, np.int64)
        self.stream[chosen] = np.asarray(keys, np.uint64)
        self.block[chosen // lanes, at + chosen % lanes] = limit
        self._start = self._start or entry(starts.start_episodes, self._placed, 0, 0)
        self._start(self.address, mode, len(arms))

    def sections(self, i: int) -> Array:
        """Return views of poses, record, action, observation and info of arm i; for an arm with prescribed motions,
        views of its own memory (`envs.motion.Guide`).
        """
        return self._mine(self.layout.poses, self.layout.saved, i)

    def step(self) -> int:
        """Advance all arms by a control period; return the number of arms that ended or have prescribed motions."""
        # several threads share the groups; lanes whose Newton iteration failed are repeated
        if self._native:
            count = self._team.run(self.compiled_step, self._native, self.address, self.groups)
        else:
            count = self.compiled_step(self.address, 0, self.groups)
        if count and len(self.lane) > 1:
            self._repeat_alone()
        self._alone.count(self._one)
        return int(count)

    def renew(self, keep: bool = True) -> None:
        """Create a new table of info for later steps, so that the caller's views of the present table do not change.
        keep: True to copy the present entries; if False, the next step must write all entries.
        """
        sheets = self._sheets
        if not sheets[1].is_free():
            sheets[1] = Sheet(np.empty_like(self.table))
        sheets.reverse()
        old, self.sheet, self.table = self.table, sheets[0], sheets[0].array
        if keep:
            self.table[...] = old
        self._placed.replace("table", self.table, sheets[0].address)
        self.address = self._placed.address

    def _repeat_alone(self) -> None:
        """Repeat, one by one and with halved steps, the period of arms whose Newton iteration failed in their group."""
        for i in np.flatnonzero(self.table[self.info_at.reason, : self.n] == RETRY).tolist():
            alone, self.repeats = self.alone(), self.repeats + 1
            alone.set_state(0, self.get_state(i))
            alone.action[0] = self.action[i]
            alone.compiled_step(alone.address, 0, 1)
            self.set_state(i, alone.get_state(0))

    def alone(self) -> Batch:
        """Return a batch of a single arm that has the same data as this batch."""
        return self._alone.get(self._one)

    def _beside(self) -> Beside[Batch]:
        """Return the batch of one arm; it is compiled while this batch steps."""
        return Beside(ALONE_AFTER if len(self.lane) > 1 else 0)

    def _one(self) -> Batch:
        """Create a batch of one arm, otherwise equal; it continues episodes of this batch and starts none."""
        names = ("arm", "settings", "task", "starts", "period", "gravity", "account", "extras", "left", "contacts")
        return Batch(n=1, starting=False, **{k: getattr(self, k) for k in names})

    def get_state(self, i: int) -> dict[str, Any]:
        """Return a copy of arm i's complete state."""
        return {
            "block": np.concatenate(self._parts(i)),
            "stream": int(self.stream[i]),
            "observation": self.observation[i].copy(),
            "reward": float(self.reward[i]),
            "terminated": bool(self.terminated[i]),
            "truncated": bool(self.truncated[i]),
        }

    def set_state(self, i: int, state: dict[str, Any]) -> None:
        """Set arm i to a state that `get_state` of an equal batch returned."""
        work, rest = self._parts(i)
        work[...], rest[...] = state["block"][: self._work], state["block"][self._work :]
        self.stream[i] = state["stream"]
        self.observation[i] = state["observation"]
        self.reward[i] = state["reward"]
        self.terminated[i], self.truncated[i] = state["terminated"], state["truncated"]
        self.table[:, i] = self._mine(self.layout.info, self.layout.saved, i)

    @property
    def counts(self) -> Array:
        """Newton iterations, factorizations, halvings and steps of each group since its creation, (groups, 4)."""
        return self.block[:, self._work * len(self.lane) :][:, :4].copy()

    @property
    def started(self) -> bool:
        """True if every arm has started an episode."""
        at = self.layout.record + PERIODS_ALLOWED * len(self.lane)
        return bool((self.block[:, at : at + len(self.lane)].ravel()[: self.n] > 0.0).all())

    def _parts(self, i: int) -> tuple[Array, Array]:
        """Return all numbers of arm i in the block as views: the integrator's memory and all other sections."""
        return self._mine(0, self._work * len(self.lane), i), self._mine(self.layout.par, self.layout.end, i)

    def view(self, i: int) -> View:
        """Return arm i at the present instant, for rendering: shape, poses, target, torques (N m) and time (s)."""
        links, q = self.arm.n_links, self.motions()[0][i]
        record, targets, at = self.record(i), len(self.task.targets), self.info_at
        info = self._mine(self.layout.info, self.layout.saved, i)
        return View(
            points=self.reading.points(self.arm, self.settings, self.system.model, q),
            poses=self.poses(i),
            time=float(record[PERIODS]) * self.period,
            target=record[TARGET : TARGET + targets].copy(),
            torques=info[at.torque : at.torque + links].copy(),
            deflection=info[at.deflection : at.twist].copy(),
            q=q,
            touches=touches_of(
                self.reading, self.system.model, self._mine(0, self.layout.par, i).copy(), self.poses(i)
            ),
        )

    def close(self) -> None:
        """Stop the worker threads."""
        self._team.close()

    def __getstate__(self) -> dict[str, Any]:
        skipped = (
            "program", "_placed", "address", "compiled_step", "_start", "info_at", "_team", "_alone",
            "_native", "_sheets", "sheet")  # fmt: skip
        return {k: v for k, v in vars(self).items() if k not in skipped}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._build()
        for name in ("block", "action", "observation", "table", "reward", "terminated", "truncated", "stream"):
            getattr(self, name)[...] = state[name]


__all__ = [
    "ACTION_NOT_FINITE", "ALWAYS", "Actuator", "Amplifier", "Attainable", "Batch", "CLIP", "CONTACT", "CONTACT_POINT",
    "CROWDED", "Chain", "Controller", "Cost", "Extras", "FACTOR_NAMES", "FRESH", "FURTHER", "GOAL", "GUIDED", "INFO",
    "Instruments", "KeepOut", "LAW_SIZE", "Land", "LandChain", "MODE", "OVER", "OneAtATime", "PERIODS",
    "PERIODS_ALLOWED", "PayloadChange", "Press", "PressChain", "Pushes", "REASONS", "RUNNING", "Reach", "Reference",
    "STATUS_WORDS", "SUCCESS", "Selection", "Sensors", "Sheet", "Slew", "SpacePress", "SpaceReach", "Starts", "TARGET",
    "STRETCH", "TERM_ARGUMENTS", "Task", "View", "aligned", "attainable", "gauge_table", "Guided", "guided_period",
    "contact_length", "info_places", "law_of", "layout_of", "one_at_a_time", "packed", "room_of", "curvature_rows",
    "standing_scene", "with_terms", "draw_attainable", "first_unattainable",
]  # fmt: skip
