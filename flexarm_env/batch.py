"""Many arms of one kind, advanced together by one compiled call per control period; a single arm is a batch of one.

The arms share a Model and a task; payload, stiffness, damping and torque constant are each arm's own. Arms stand in
lane groups; groups are divided among threads. What an arm does depends on nothing but itself: the same bits in any
batch, on any number of threads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import physics  # noqa: F401  (registers the formulations)
from .compiler import SINGLE, WIDEST, Crew, OneAtATime, Placed, entry, holders, native, one_at_a_time, uncompiled
from .parameters import Arm
from .physics import assembly, precision
from .physics.gauges import Spot, curvature_rows
from .physics.integrator.work import unpack, work_size
from .physics.joints.build import with_own_laws
from .physics.layout import COUNTS, POSE, SPACE_POSE
from .physics.model import OK, System
from .physics.obstacles import KeepOut, packed
from .physics.space.reading import read
from .runtime import episode as environment
from .runtime import starts
from .runtime.keep_out import with_room
from .runtime.laws import LAW_SIZE, law_of, room_of
from .runtime.layout import aligned, layout_of, readings_size, record_sizes
from .runtime.sampling import observe_arm
from .scene import standing_scene
from .settings import Settings
from .simulation import fitted_systems
from .tasks.program import (
    ACTION_NOT_FINITE,
    CHANNEL,
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
from .trajectory import joint_angles
from .validation import Array

LANES_FROM = 3
"""Batches of at least this many arms stand in lanes of eight; the others are advanced one by one."""

UNSEEN = holders([np.zeros(1)], 0)
"""Holders of an array that only its list knows."""


def info_places(task: Task) -> Any:
    """Where each field of a task's `INFO` begins."""
    return INFO.offsets(0, len(task.links), len(task.targets), len(task.terms), len(task.further))


@dataclass(frozen=True)
class View:
    """One arm at an instant: points (n, 2) root to tip, m; poses (N, 12) as `physics.protocol.link_poses`; time, s;
    target, m or rad; torques (N,), N m; deflection (N,), over L; q, the coordinates of the state. In space points
    (n, 3), poses (N, 23) as `task_poses`, deflection (2 N,): along y, then along z."""

    points: Array
    poses: Array
    time: float
    target: Array
    torques: Array
    deflection: Array
    q: Array


def gauge_table(
    arm: Arm, settings: Settings, gravity: tuple[float, ...] | None, places: Sequence[Spot]
) -> Array:
    """(G, n): `curvature_rows` of a link at a place (0 root, 1 tip), for the arm of a batch."""
    assert settings.dt is not None
    scene = standing_scene(arm, settings.dt, gravity)
    return curvature_rows(scene, settings, assembly.assemble(scene, settings), places)


class Batch:
    """n arms with a task, in lane groups.

    Args:
        arm, settings (with dt), gravity: what moves. n: how many.
        task: a record of a task. starts: what fresh starts are drawn from.
        period: control period, s, a whole number of settings.dt. books: keep energies. threads: at most so many.
        extras: controllers, motors, sensors, moving targets.
    Attributes:
        action (n, A) float32: to be filled before `step`. observation (n, O) float32, reward (n,), terminated,
        truncated (n,): of the last step or start. table: entries of info, a row each, a column an arm (and some to
        spare). info_at: where each of `INFO` is in it. request: a `REQUEST`, NaN: to be drawn. address: what
        the compiled functions take.
    """

    def __init__(
        self, arm: Arm, settings: Settings, n: int, task: Task, starts: Starts, *,
        period: float, gravity: tuple[float, ...] | None = None, books: bool = False, threads: int = 1,
        extras: Extras | None = None,
    ) -> None:  # fmt: skip
        assert settings.dt is not None
        self.arm, self.settings, self.n, self.task, self.starts = arm, settings, n, task, starts
        self.period, self.gravity, self.books, self.extras = period, gravity, books, extras or Extras()
        drawn = starts.drawn
        self.tolerance = precision.of_torques(arm, settings, precision.largest(drawn), drawn["damping"][1])
        pushed = self.extras.pushes is not None
        self.systems = fitted_systems(standing_scene(arm, settings.dt, gravity, pushed=pushed), settings)
        self.systems = [with_own_laws(system, starts.hub) for system in self.systems] if starts.laws else self.systems
        self.system: System = self.systems[-1]
        self.lane = SINGLE if n < LANES_FROM or settings.multipliers else WIDEST
        self.groups = -(-n // len(self.lane))
        self.threads = max(1, min(threads, self.groups))
        self.pose = None if arm.spatial else assembly.pose_table(arm, settings, gravity)
        self._build()

    def _build(self) -> None:
        lanes, model, task, settings = len(self.lane), self.system.model, self.task, self.settings
        assert settings.dt is not None
        gauges = 0 if self.extras.sensors is None else len(self.extras.sensors.gauges) // len(self.system.q0)
        ahead = 0 if self.extras.reference is None else len(self.extras.reference.scales)
        read = 0 if self.extras.instruments is None else self.extras.instruments.entries
        self.entries = len(task.entries) + ahead + read + gauges
        fitted = settings.step_tolerance is not None
        self.layout = layout_of(lanes, model, task, self.entries, self.extras, fitted)
        self._work = int(uncompiled(work_size)(1, model, 0)) - COUNTS.places.end  # these are apart
        count, links = self.n, self.arm.n_links
        self.info_at = info_places(task)
        self.block = aligned(self.groups, self.layout.row)
        self.action = np.zeros((count, links), np.float32)
        chosen = self.extras.selection
        width = self.entries if chosen is None else len(chosen.chosen) * chosen.frames
        self.observation = np.zeros((count, width), np.float32)
        size = (self.layout.saved - self.layout.info) // lanes
        self._tables = [np.zeros((size, self.groups * lanes)) for _ in range(2)]
        self.table = self._tables[0]
        self.queue = np.zeros(count, np.int64)
        self.reward = np.zeros(count)
        self.terminated, self.truncated = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        self.stream = np.zeros(count, np.uint64)
        self.request = np.full(REQUEST.offsets(0, links, links * self.arm.spatial).end, np.nan)
        n_steps = round(self.period / settings.dt)
        room = np.zeros((assembly.room_for_points(settings, links), 3 if self.arm.spatial else 2))
        shapes = with_room(self.extras.keep_out, model, self.system.q0, room, self.groups, self.arm.total_length)
        self.program = Program(
            lane=self.lane, model=model, scheme=assembly.scheme_of(settings, self.tolerance), task=task,
            models=Models(*(system.model for system in self.systems)) if fitted else None,
            allowed=(settings.step_tolerance or 0.0) * self.arm.total_length,
            ranges=self.starts.ranges(self.pose, self.system.par), layout=self.layout,
            **(vars(self.extras) | {"keep_out": shapes}),
            entries=self.entries, books=(0,) if self.books else None, estimate=self.estimate,
            period=self.period, h=self.period / n_steps, n_steps=n_steps, n=count,
            block=self.block.reshape(-1), action=self.action.reshape(-1), queue=self.queue,
            observation=self.observation.reshape(-1), table=self.table.reshape(-1), reward=self.reward,
            terminated=self.terminated.view(np.uint8), truncated=self.truncated.view(np.uint8),
            stream=self.stream, request=self.request,
        )  # fmt: skip
        self._placed = Placed(self.program)
        self.address = self._placed.address
        self.compiled_step = entry(environment.step, self._placed, 0, 0)
        self._start = entry(starts.start_episodes, self._placed, 0, 0)
        self._finish_guided: Any = None
        self._native = native(environment.step, self._placed, 0, 0) if self.threads > 1 else 0
        self._crew = Crew(self.threads - 1)
        self._alone: Batch | None = None
        for i in range(self.groups * lanes):
            self._par(i)[...] = self.system.par
        for i in range(count):
            self.record(i)[MODE] = OVER

    @property
    def estimate(self) -> float:
        """What leaving out stretch and shear costs the elastica, over the arm's length, by a linear estimate that
        links that whip round are beyond (docs: theory, section 5); infinite for others: not known. (Not nan, which no
        checker of an environment's determinism takes to be equal to itself.)"""
        return self.system.notes.get("stretch_and_shear", float("inf"))

    # --- one arm's entries -----------------------------------------------------------------------
    def _mine(self, first: int, last: int, i: int) -> Array:
        """Entries [first, last) of the block that are arm i's, a view."""
        lanes = len(self.lane)
        return self.block[i // lanes, first:last].reshape(-1, lanes)[:, i % lanes]

    def _par(self, i: int) -> Array:
        return self._mine(self.layout.par, self.layout.poses, i)

    def record(self, i: int) -> Array:
        """Arm i's record (see `tasks.program.RECORD`), a view."""
        return self._mine(self.layout.record, self.layout.action, i)

    def poses(self, i: int) -> Array:
        """Poses (N, 12) of arm i's links as its last period, or its start, left them (see `View`), a copy."""
        end = self.layout.record - len(self.task.base) * len(self.lane)
        return self._mine(self.layout.poses, end, i).reshape(self.arm.n_links, -1).copy()

    def joints(self, i: int) -> tuple[Array, Array]:
        """Angles (N,), rad, and rates (N,), rad/s, of arm i's joints; of a floating base the hub's from the x axis."""
        poses = self.poses(i)
        return (poses[:, SPACE_POSE.angle], poses[:, SPACE_POSE.rate]) if self.arm.spatial else joint_angles(poses)

    # --- motion ----------------------------------------------------------------------------------
    def parameters(self, i: int) -> Array:
        """What is arm i's own (see `physics.model.PAYLOAD_MASS`), a copy."""
        return self._par(i).copy()

    def motion(self, i: int) -> tuple[Array, Array, Array]:
        """State q, v (n,) and joint torques (N,) of arm i, copies."""
        return tuple(rows[i].copy() for rows in self.motions()[:3])

    def motions(self) -> tuple[Array, Array, Array, Array]:
        """Of all arms: coordinates and rates (n, rows), joint torques (n, N), parameters as `parameters`, copies."""
        work = uncompiled(unpack)(self.lane, self.system.model, np.arange(self.layout.par, dtype=np.float64), 0)
        rows, lanes = len(self.system.q0), len(self.lane)

        def mine(start: float, count: int) -> Array:
            part = self.block[:, int(start) : int(start) + count * lanes].reshape(self.groups, count, lanes)
            return part.transpose(0, 2, 1).reshape(-1, count)[: self.n].copy()

        par = mine(self.layout.par, len(self.system.par))
        torques = work.u[0]
        if self.extras.actuator is not None:  # what motors have come to; u is what they did in the last step
            at = RECORD.offsets(0, *record_sizes(self.task, self.entries, self.extras)).torque
            torques = self.layout.record + at * lanes
        return mine(work.q[0], rows), mine(work.v[0], rows), mine(torques, self.arm.n_links), par

    def ask(self, angles: Array, target: Array, vibration: Array) -> None:
        """What the next start is to be like: joint angles (N,), target (2,), vibration (1,) or (3,); NaN: drawn.

        In space the target is given by joint angles (N,) that reach it.
        """
        asked = {"angles": angles, "target": target, "vibration": np.resize(vibration, 3), "goals": np.zeros(0)}
        if self.arm.spatial:
            asked |= {"target": np.full(2, np.nan), "goals": target}
        self.request[:] = REQUEST.pack({"joints": self.arm.n_links, "goals": len(asked["goals"])}, **asked)

    def start(self, arms: Sequence[int], keys: Sequence[int], *, limit: int, mode: int = RUNNING) -> None:
        """Start episodes; keys: 64 random bits for each arm that its draws and noise follow from."""
        lanes, at = len(self.lane), self.layout.record + PERIODS_ALLOWED * len(self.lane)
        for k, i in enumerate(arms):
            self.queue[k], self.stream[i], self.block[i // lanes, at + i % lanes] = i, keys[k], limit
        self._start(self.address, mode, len(arms))

    def take_report(self, i: int, code: int, action: Array, report: Mapping[str, Array]) -> None:
        """The outcome of a period of arm i, which is guided: moved elsewhere.

        code: status, or -1 for the start of its episode. action (N,). report: poses (N, 12), torque (N,), N m, energies
        (5,), J (`tasks.program.ENERGIES`), gauges (G,), scaled, motors (N,): their angles over the ratio, rad.
        """
        at, layout, instruments = self.info_at, self.layout, self.extras.instruments
        info, record = self._mine(layout.info, layout.saved, i), self.record(i)
        if code <= OK:
            self._mine(layout.poses, layout.record, i)[:] = report["poses"].ravel()
            self._mine(layout.action, layout.seen, i)[:] = action
            self._mine(layout.seen, layout.info, i)[self.entries - len(report["gauges"]) :] = report["gauges"]
            if instruments is not None and instruments.motors is not None:
                channel = CHANNEL.offsets(len(record) - readings_size(instruments), instruments.room)
                record[channel.motor :: channel.end - channel.gain][: self.arm.n_links] = report["motors"]
        if self._finish_guided is None:
            self._finish_guided = entry(starts.finish_guided, self._placed, 0, 0)
        self._finish_guided(self.address, i, code)
        if code <= OK:
            info[at.torque : at.torque + self.arm.n_links] = report["torque"]
            info[at.in_range], info[at.error] = 1.0, self.estimate
            info[at.energies : at.reward] = report["energies"]
        self.table[:, i] = info

    def step(self) -> int:
        """One control period of all arms with `action`; returns how many want attention (ended, or guided)."""
        if self.threads == 1 or not self._native:
            count = self.compiled_step(self.address, 0, self.groups)
        else:
            count = self._crew.run(self._native, self.address, self.groups)
        if count and len(self.lane) > 1:
            self._repeat_alone()
        return int(count)

    def renew(self, keep: bool = True) -> None:
        """Write what comes into another table, which is no longer looked at; the present one stays as it is.

        keep: begin with a copy of the present one; without, all of it is to be written, which a step does.
        """
        if holders(self._tables, 1) > UNSEEN:
            self._tables[1] = np.empty_like(self.table)
        self._tables.reverse()
        old, self.table = self.table, self._tables[0]
        if keep:
            self.table[...] = old
        self._placed.replace("table", self.table)
        self.address = self._placed.address

    def _repeat_alone(self) -> None:
        """Arms whose Newton iteration failed in their lane go through the period again, where steps are halved."""
        for i in np.flatnonzero(self.table[self.info_at.reason, : self.n] == RETRY).tolist():
            alone = self.alone()
            alone.set_state(0, self.get_state(i))
            alone.action[0] = self.action[i]
            alone.compiled_step(alone.address, 0, 1)
            self.set_state(i, alone.get_state(0))

    def alone(self) -> Batch:
        """A batch of one like this one."""
        if self._alone is None:
            self._alone = Batch(
                self.arm, self.settings, 1, self.task, self.starts,
                period=self.period, gravity=self.gravity, books=self.books, extras=self.extras,
            )  # fmt: skip
        return self._alone

    def get_state(self, i: int) -> dict[str, Any]:
        """Everything about arm i, copied."""
        return {
            "block": np.concatenate(self._parts(i)),
            "stream": int(self.stream[i]),
            "observation": self.observation[i].copy(),
            "reward": float(self.reward[i]),
            "terminated": bool(self.terminated[i]),
            "truncated": bool(self.truncated[i]),
        }

    def set_state(self, i: int, state: dict[str, Any]) -> None:
        """Make arm i what `get_state` of a like batch returned."""
        work, rest = self._parts(i)
        work[...], rest[...] = state["block"][: self._work], state["block"][self._work :]
        self.stream[i] = state["stream"]
        self.observation[i] = state["observation"]
        self.reward[i] = state["reward"]
        self.terminated[i], self.truncated[i] = state["terminated"], state["truncated"]
        self.table[:, i] = self._mine(self.layout.info, self.layout.saved, i)

    @property
    def counts(self) -> Array:
        """(groups, 4): Newton iterations, factorisations, halvings and steps of each lane group up to now."""
        return self.block[:, self._work * len(self.lane) :][:, :4].copy()

    @property
    def started(self) -> bool:
        """Whether every arm has been started."""
        at = self.layout.record + PERIODS_ALLOWED * len(self.lane)
        return bool((self.block[:, at : at + len(self.lane)].ravel()[: self.n] > 0.0).all())

    def _parts(self, i: int) -> tuple[Array, Array]:
        """All that the block holds of arm i, views: the integrator's work, and the other sections."""
        return self._mine(0, self._work * len(self.lane), i), self._mine(self.layout.par, self.layout.end, i)

    def view(self, i: int) -> View:
        """Where arm i is."""
        links, (q, v) = self.arm.n_links, (rows[i] for rows in self.motions()[:2])
        if self.arm.spatial:
            points = read(self.arm, self.settings, q[None], v[None])["shapes"][0]
            poses, size = self._mine(self.layout.poses, self.layout.record, i).copy(), SPACE_POSE.end
        else:
            poses, size = np.zeros(POSE.end * links), POSE.end
            points = np.full((assembly.room_for_points(self.settings, links), 2), np.nan)
            count = observe_arm(SINGLE, self.system.model, self._par(i).copy(), q, v, poses, np.zeros(3), points)
            points = points[:count]
        record, targets, at = self.record(i), len(self.task.targets), self.info_at
        info = self._mine(self.layout.info, self.layout.saved, i)
        return View(
            points=points.copy(),
            poses=poses.reshape(-1, size),
            time=float(record[PERIODS]) * self.period,
            target=record[TARGET : TARGET + targets].copy(),
            torques=info[at.torque : at.torque + links].copy(),
            deflection=info[at.deflection : at.twist].copy(),
            q=q,
        )

    def close(self) -> None:
        """Let the threads go."""
        self._crew.close()

    def __getstate__(self) -> dict[str, Any]:
        skipped = (
            "program", "_placed", "address", "compiled_step", "_start", "_finish_guided", "info_at", "_crew", "_alone",
            "_native",
        )  # fmt: skip
        return {k: v for k, v in vars(self).items() if k not in skipped}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._build()
        for name in ("block", "action", "observation", "table", "reward", "terminated", "truncated", "stream"):
            getattr(self, name)[...] = state[name]


__all__ = [
    "ACTION_NOT_FINITE", "ALWAYS", "Actuator", "Amplifier", "Batch", "CLIP", "Chain", "Controller", "Cost", "Extras",
    "FACTOR_NAMES", "FRESH", "FURTHER", "GOAL", "GUIDED", "INFO", "Instruments", "KeepOut", "LAW_SIZE", "MODE", "OVER",
    "OneAtATime", "PERIODS", "PERIODS_ALLOWED", "PayloadChange", "Pushes", "REASONS", "RUNNING", "Reach", "Reference",
    "STATUS_WORDS", "SUCCESS", "Selection", "Sensors", "Slew", "SpaceReach", "Starts", "TARGET", "Task", "View",
    "gauge_table", "info_places", "law_of", "one_at_a_time", "packed", "room_of", "curvature_rows", "standing_scene",
]  # fmt: skip
