"""Simulate a scene: the function `simulate`, and the class `Simulation` that advances an arm step by step."""

import dataclasses
import math
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from typing import Any

import numpy as np

from . import accuracy, physics
from . import validation as check
from .compiler import SINGLE, compiling, uncompiled
from .physics import assembly, precision
from .physics.integrator.start import restart
from .physics.integrator.work import Work, unpack, work_size
from .physics.layout import DISSIPATED, POSE, TIP, WORK_DONE
from .physics.model import MESSAGE, OK, STATUS, STIFFNESSES, TIMED_OUT, Drive, System
from .physics.reading import reading_of
from .rest import NoEquilibrium, rested
from .runtime.fitted import APART, FITS, close_fit, end_run, open_fit, start_run
from .runtime.keeping import save_lanes
from .runtime.layout import fit_rooms
from .runtime.sampling import ANEW, AT_KINK, GOES_ON, NEAR, SAMPLE, STRETCH, has_gained_energy, observe_arm, sample_rows
from .scene import Scene, at_points, computed, resolving_step
from .settings import Settings, steps_in
from .trajectory import Trajectory, check_work, recorded
from .trajectory.space import placed
from .validation import Array

Start = tuple[float, float, bool]
"""Start of an interval: time (s), gross work (J) and True if the integrator is initialised anew at this time."""

_NO_POINTS = np.zeros((0, 2))
_NOTHING = np.zeros(0), np.zeros((0, 1)), np.zeros((0, 1, 2))
"""Instants, table and points of an empty set of samples."""
_AT = STRETCH.places
CHUNK = 500
"""Number of steps between two checks of the work done by the drives."""
CHUNKS = 4
"""Number of chunks of CHUNK steps until compiled code returns. The time limit and Ctrl-C are checked then."""
CHEAP = 250
"""Largest number of unknowns for which CHUNKS times CHUNK steps take less than a second."""
ENERGY_LIMIT = 1e3
"""A run has diverged if its energy exceeds this multiple of the energy accounted for (`Simulation.gained`)."""


def fitted_systems(scene: Scene, settings: Settings) -> list[System]:
    """Assemble the scene's `System` for the step dt or, with a step_tolerance, for each of the steps dt to dt/32."""
    assert settings.dt is not None
    steps = [settings.dt * 0.5**k for k in range(1 if settings.step_tolerance is None else FITS)]
    with check.solvable(scene.arm.name):
        return [assembly.assemble(scene, settings.replace(dt=h)) for h in steps]


class Simulation:
    """Simulation of the arm of a scene, which starts at t = 0 and is advanced step by step.

    Args:
        scene: simulated scene. settings: settings with a dt. moves: False if the simulation is only linearized.
    Attributes:
        t: present time, s. status: status code of `flexarm_env.physics.model`. work: views of the state (`Work`).
        gross: sum of the magnitudes of positive and negative work of motions and loads, J.
        levels: with a step_tolerance, number of halvings of dt in each past interval. step_error: as in `Trajectory`.
        follow: numbers of halvings of dt in each interval, used in place of the step_tolerance; or None.
        deadline: `time.perf_counter()` at which `advance_to` stops with status "timed_out", or None for no limit.
    """

    def __init__(self, scene: Scene, settings: Settings, moves: bool = True, starts: bool = True) -> None:
        """Assemble the scene for steps of settings.dt, s, and start it at t = 0. starts: argument of `reset`."""
        assert settings.dt is not None
        self.scene, self.settings, self.dt = (scene := at_points(scene)), settings, settings.dt
        self._systems = fitted_systems(scene, settings)
        self.follow: Sequence[int] = ()
        self.system = rested(self._systems[-1], scene, settings, Simulation)
        self.n_motions = len((drive := assembly.drive(scene, self.system)).known)
        self.drive, self.scheme = drive, assembly.scheme_of(settings, precision.of_scene(scene, settings))
        self.model, self.par = self.system.model, self.system.par.copy()
        # _flat holds the whole state; work gives views of it
        self._flat = np.zeros(int(uncompiled(work_size)(1, self.model, self.n_motions)))
        self.work: Work = uncompiled(unpack)(SINGLE, self.model, self._flat, self.n_motions)
        self.deadline: float | None = None
        self._chunk = max(1, int(CHUNK * min(1.0, CHEAP / len(self.system.q0)) ** 3))
        self._kinks = np.array(scene.kinks, dtype=np.float64)
        self._whole = reading_of(scene).restarts_sampling(bool(self._kinks.size), moves)
        self._points: int | None = None
        self._sizes = {"rows": len(self.work.q), "links": scene.arm.n_links, "motions": self.n_motions}
        self._sample = SAMPLE.offsets(0, *self._sizes.values()).end
        self._poses, self._energies = np.zeros(POSE.end * scene.arm.n_links), np.zeros(3)
        self.reset(starts)

    def reset(self, starts: bool = True) -> None:
        """Return to t = 0. starts: True to compute accelerations just after t = 0; else the caller computes them."""
        self._flat[:] = 0.0
        self.work.q[:], self.work.v[:] = self.system.q0, self.system.v0
        self.t = self.gross = self.step_error = 0.0
        self.levels, self._level = list[int](), 1
        self._restarted: tuple[Array, Array, float] | None = None
        if starts:
            self._restart(fresh=False)  # at rest before 0: loads and motions that begin there do so as at any kink

    @property
    def status(self) -> int:
        """Status code of the run; `flexarm_env.physics.model.STATUS` names the codes."""
        return int(self.work.flag[0])

    @property
    def message(self) -> str:
        """Sentence that describes the status of the run."""
        bound = float(getattr(self.model, "bound", 0.0))
        return MESSAGE[self.status].format(t=self.t, h=self.dt, halvings=self.scheme.max_halvings, bound=bound)

    def set_torques(self, torques: Array, fresh: bool = True) -> None:
        """Set the joint torques, N m. fresh: False keeps the integrator's filtered accelerations (used at kinks)."""
        self.work.u0[:] = self.work.u
        self.work.u[: len(torques)] = torques
        self._restart(fresh)

    def advance_to(self, t_end: float, account: bool = True) -> bool:
        """Advance to t_end, s, in steps of at most dt that end at every kink; return False if the solver has failed.
        account: True to compute work and dissipation and to store them in `work.books`."""
        if self.t < t_end - NEAR * max(1.0, t_end):
            self._go(self._stretch(), np.array([t_end]), np.empty((1, self._sample)), np.empty((1, 0, 2)), account)
        return self.status == OK

    def _fit(self, period: float, run: Callable[[], Array]) -> None:
        """Advance a stretch of `period` (s) in steps halved as the step_tolerance requires (`runtime.fitted`). run:
        function that advances the stretch and returns the links' poses at its end (after a failure: undefined)."""
        links, w, start = self.scene.arm.n_links, self.work, self._start()
        level, nothing = np.array([float(self._level)]), np.zeros(0)
        # prescribed number of halvings, or compare runs of dt, dt/2, ... until they agree
        if len(self.levels) < len(self.follow):
            level[0] = k = self.follow[len(self.levels)]
            self._halved(k, start, run)
        else:
            saved, scratch = fit_rooms(len(w.q), len(w.u), self.n_motions, links)
            allowed = (self.settings.step_tolerance or 0.0) * self.scene.arm.total_length
            save_lanes(w, nothing, saved)
            open_fit(SINGLE, links, level, nothing, saved, scratch, w)
            for k in range(FITS):
                if start_run(SINGLE, k, saved, scratch, nothing, w):
                    poses = self._halved(k, start, run)
                    if self.status == TIMED_OUT:
                        break
                    if not end_run(SINGLE, k, links, allowed, period, poses, nothing, saved, scratch, level, w):
                        break
            if self.status != TIMED_OUT:
                close_fit(SINGLE, links, nothing, saved, scratch, w)
                self.step_error = max(self.step_error, float(scratch[APART]) / self.scene.arm.total_length)
        self.levels.append(k)
        self._level = int(level[0])
        self.model, self.dt = self.system.model, float(self.settings.dt or 0.0)

    def _start(self) -> Start:
        """Return the start of a stretch before the fresh restart; each step size repeats this restart."""
        if self._restarted is None or not np.array_equal(self._flat, self._restarted[1]):
            return self.t, self.gross, False
        self._flat[:], _, gross = self._restarted
        return self.t, gross, True

    def _halved(self, k: int, start: Start, run: Callable[[], Array]) -> Array:
        """Run a stretch from its start with dt halved k times; return the poses that `run` returns."""
        self.t, self.gross, fresh = start
        self.model, self.dt = self._systems[k].model, float(self.settings.dt or 0.0) * 0.5**k
        if fresh:
            self._restart()
        return run()

    def _stops(self, instant: float) -> list[float]:
        """Return the kinks (s) up to an instant, then the instant itself unless it is a kink."""
        near = NEAR * max(1.0, instant)
        ahead = self._kinks[bisect_right(self._kinks, self.t) : bisect_right(self._kinks, instant + near)].tolist()
        stops = [k for k in ahead if k > self.t + NEAR * max(1.0, k)]
        return stops if stops and stops[-1] >= instant - near else [*stops, instant]

    def record(
        self, end: float, interval: float, progress: Callable[[float], None] | None = None
    ) -> tuple[dict[str, Array], Array]:
        """Advance to `end`, s, and record m samples: at the start and after each `interval`, s; stop if the solver
        fails. At a kink the state just before the kink is recorded. progress: function that is called with the
        completed fraction. Returns a dict of arrays with one row per sample (`runtime.sampling.SAMPLE`), and the
        positions of P points on the center line, (m, P, 2) or (m, P, 3), m."""
        count = steps_in(end, interval)
        instants = np.arange(count + 1.0) * interval
        instants[0], instants[-1] = self.t, min(count * interval, end)
        return self._samples(self._stretch(ENERGY_LIMIT), instants, progress)

    def sample(self) -> tuple[dict[str, Array], Array]:
        """Return the arrays and positions that `record` returns, with one sample (m = 1): the present state."""
        return self._samples(self._stretch(), np.array([self.t]), None)

    def _samples(
        self, stretch: Array, instants: Array, progress: Callable[[float], None] | None
    ) -> tuple[dict[str, Array], Array]:
        """Return fields and points of the samples at instants (s), up to the instant that the arm reaches."""
        m, split, points = len(instants), len(instants) * self._sample, self._count()
        # one allocation for rows of numbers and chain points
        room = np.empty(split + m * points * 2)
        table, shapes = room[:split].reshape(m, self._sample), room[split:].reshape(m, points, 2)
        made = self._go(stretch, instants, table, shapes, True, progress)
        return SAMPLE.unpack(table[:made], **self._sizes), shapes[:made]

    def _stretch(self, gain: float = math.inf, starts: float = GOES_ON) -> Array:
        """Return a `STRETCH` record for a run that begins now. gain, starts: two fields of this record."""
        stretch = np.zeros(_AT.end)
        stretch[_AT.time], stretch[_AT.longest], stretch[_AT.gross] = self.t, self.dt, self.gross
        stretch[_AT.gain], stretch[_AT.starts] = gain, starts
        return stretch

    def _go(
        self, stretch: Array, instants: Array, table: Array, shapes: Array, account: bool,
        progress: Callable[[float], None] | None = None,
    ) -> int:  # fmt: skip
        """Advance to each instant (s) via all kinks and fill one row of `table` and `shapes` per instant. Return the
        number of filled rows, which is smaller after a failure."""
        # constant dt: compiled code fills all rows; fitted steps: stretch by stretch
        if self.settings.step_tolerance is None:
            return self._rows(stretch, instants, table, shapes, account, progress)
        # one stretch per kink; at each the state is made consistent before the next stretch
        moved = False
        for i, instant in enumerate(instants.tolist()):
            for stop in self._stops(instant):
                if moved:
                    self.restart_at_kink()
                moved = stop > self.t
                made = self._fitted(stretch, stop, table[i : i + 1], shapes[i : i + 1], account)
                if self.status != OK:
                    return i + made
            if progress is not None:
                progress((i + 1) / len(instants))
        return len(instants)

    def _fitted(self, stretch: Array, stop: float, table: Array, shapes: Array, account: bool) -> int:
        """Advance a stretch without kinks in fitted steps and fill the row at its end; return 1, or 0 on failure."""
        row, made = SAMPLE.unpack(table[0], **self._sizes), 0

        def run() -> Array:
            nonlocal made
            stretch[_AT.time], stretch[_AT.longest], stretch[_AT.gross] = self.t, self.dt, self.gross
            made = self._rows(stretch, np.array([stop]), table, shapes, account)
            return row["poses"].reshape(-1)

        if stop > self.t:
            self._fit(stop - self.t, run)
        else:
            run()
        if made:
            self._observe(_NO_POINTS)  # energies of the model that all step sizes share
            row["energies"][:] = self._energies
        return made

    def _rows(
        self, stretch: Array, instants: Array, table: Array, shapes: Array, account: bool,
        progress: Callable[[float], None] | None = None,
    ) -> int:  # fmt: skip
        """Call `runtime.sampling.sample_rows` until all rows are filled or the arm fails; return their number."""
        made = 0
        while True:
            made += self._call(stretch, instants[made:], table[made:], shapes[made:], account)
            if progress is not None:
                progress(made / len(instants))
            if self.status == OK and self.deadline is not None and time.perf_counter() > self.deadline:
                self.work.flag[0] = TIMED_OUT
            if self.status != OK or made == len(instants):
                break
        stretch[_AT.done] = 0.0
        return made

    def _call(self, stretch: Array, instants: Array, table: Array, shapes: Array, account: bool = True) -> int:
        """Call `runtime.sampling.sample_rows` once; return the number of rows that it has filled."""
        made = sample_rows(
            SINGLE, self.model, self.drive, self.par, self._flat, self.n_motions, self.scene.arm.n_links, stretch,
            instants, self._kinks if self._whole else None, self._chunk, CHUNKS * self._chunk, self.scheme,
            (0,) if account else None, table, shapes,
        )  # fmt: skip
        self.t, self.gross = float(stretch[_AT.time]), float(stretch[_AT.gross])
        return int(made)

    def compile(self) -> None:
        """Compile the programs that `record` uses, or load them from the cache, without moving the arm."""
        with compiling(f"scene {self.scene.name}"):
            self._count()
        if self.settings.step_tolerance is not None:
            flat, numbers, restarted = self._flat.copy(), (self.gross, self._level, self.step_error), self._restarted
            self._fit(1.0, lambda: self._poses)
            self.levels.pop()
            self._flat[:], (self.gross, self._level, self.step_error), self._restarted = flat, numbers, restarted

    def _restart(self, fresh: bool = True) -> None:
        """Make the state consistent at t+: at a fresh start, or at a kink, at which the integrator keeps its filter."""
        kept, gross = self._flat.copy(), self.gross
        self._make_consistent(fresh)
        self._restarted = (kept, self._flat.copy(), gross) if fresh else None

    def make_consistent(self, model: Any, drive: Drive, flat: Array) -> None:
        """Compute the rates and accelerations just after the present time, and write them into the memory `flat`."""
        other = copy(self)
        other.model, other.drive, other._flat = model, drive, flat
        other._make_consistent(fresh=True)

    def _make_consistent(self, fresh: bool) -> None:
        """Call `restart`: within `sample_rows`, which in space saves a second compilation, or directly."""
        if self._whole:
            self._call(self._stretch(starts=ANEW if fresh else AT_KINK), *_NOTHING)
        else:
            books, before = self.work.books, float(self.work.books[WORK_DONE])
            restart(SINGLE, self.model, self.drive, self.par, self._flat, self.n_motions, self.t, self.dt, fresh)
            self.gross += abs(float(books[WORK_DONE]) - before)

    def restart_at_kink(self) -> None:
        """If the present time is a kink, compute velocities and accelerations just after the kink."""
        near = bisect_right(self._kinks, self.t)
        if any(abs(k - self.t) <= NEAR * max(1.0, k) for k in self._kinks[max(0, near - 1) : near + 1]):
            self._restart(fresh=False)

    def observe(self) -> tuple[Array, Array]:
        """Return link poses (n_links, 12), which are 0 in space, and energies (kinetic, strain, gravity), J."""
        self._observe(_NO_POINTS)
        return self._poses.reshape(-1, POSE.end).copy(), self._energies.copy()

    def _observe(self, points: Array) -> None:
        observe_arm(SINGLE, self.model, self.par, self.work.q, self.work.v, self._poses, self._energies, points)

    def gained(self, start: float) -> bool:
        """Return whether energy > ENERGY_LIMIT * (initial energy + gross work + losses + gravity energy), J."""
        lost = float(self.work.books[DISSIPATED])
        return bool(uncompiled(has_gained_energy)(*self.observe()[1].tolist(), start, self.gross, lost, ENERGY_LIMIT))

    def joint_torques(self) -> Array:
        """Return joint torques (n_links,), N m: applied torques, or torques that enforce prescribed angles."""
        torques: Array = self.work.u[: self.scene.arm.n_links].copy()
        # prescribed joints: the reaction replaces the applied torque
        for i, motion in enumerate(self.scene.motions):
            if motion.joint is not None:
                torques[motion.joint] = self.work.reaction[i]
        return torques

    def _count(self) -> int:
        """Return the number of points along the arm."""
        if self._points is None:
            stretch, room = self._stretch(), assembly.room_for_points(self.settings, self.scene.arm.n_links)
            self._call(stretch, np.array([self.t]), np.empty((1, self._sample)), np.empty((1, room, 2)))
            self._points = int(stretch[_AT.points])
        return self._points

    def shape_points(self) -> Array:
        """Return points on the arm's center line from root to tip, (n_points, 2), in space (n_points, 3), m."""
        return reading_of(self.scene).points(self.scene.arm, self.settings, self.model, self.work.q)


def simulate(
    scene: Scene,
    formulation: str | None = None,
    *,
    duration: float | None = None,
    sample: float | None = None,
    progress: Callable[[float], None] | None = None,
    error_limit: float = 0.05,
    time_limit: float | None = None,
    estimate_error: bool = True,
    **options: Any,
) -> Trajectory:
    """Simulate a scene and return its trajectory.

    Args:
        scene: a `Scene` (see `flexarm_env.scenes.named`).
        formulation: "floating_frame", "geometrically_exact", "elastica" or "paper"; None for the scene's formulation.
        duration, sample: duration and sampling interval, s; None: the scene's values. progress: function that is called
            with the completed fraction of the run.
        error_limit: largest `error_estimate`, divided by the arm's length, for which the status is "ok".
        time_limit: largest wall-clock time, s, without compilation; a longer run ends with the status "timed_out". The
            time limit applies separately to the run and to each additional run of the error estimate (usually two).
        estimate_error: True to estimate the error by additional runs. With estimate_error=False, `error_estimate` is
            nan, and `error_parts` contains only energy and notes.
        options: options of the formulation (`flexarm_env.settings.Settings`), such as segments=8 or dt=0.01. Steps are
            shorter than dt if a motion or load requires shorter steps: for a sine, at most a sixteenth of the period.
    Returns:
        The Trajectory. The status is "ok"; "inaccurate" if the estimated error exceeds error_limit or step_tolerance is
            not met; or the name of the failure that ended the run early. `message` describes the status.
    Raises:
        ValueError: an unknown option, an invalid value, or more than MOST_STEPS steps or MOST_SAMPLES samples.
    """
    if not isinstance(scene, Scene):
        raise check.InvalidValue("scene", scene, "must be a Scene, such as flexarm_env.named(NAME) gives")
    settings = scene.settings(formulation, **options)
    end = scene.duration if duration is None else check.number("duration", duration, "s", above=0.0)
    interval = scene.sample if sample is None else check.number("sample", sample, "s", above=0.0)
    assert interval is not None
    limit = check.number("error_limit", error_limit, "a fraction of the arm's length", above=0.0)
    allowed = None if time_limit is None else check.number("time_limit", time_limit, "s", above=0.0)
    check_work(end, interval, settings.dt)
    if end > scene.duration:
        scene = dataclasses.replace(scene, duration=end)  # its kinks up to there count
    # in its plane if there is one; the step resolves the fastest motion or load and divides samples and kinks
    there = computed(scene)
    settings = dataclasses.replace(settings, dt=resolving_step(there, settings, end))
    simulation = Simulation(there, accuracy.in_steps(there, settings, end, interval))
    physics.contact.build.check_steps(simulation.scene, simulation.settings, simulation.system, start=True)
    simulation.compile()
    clock = time.thread_time()
    simulation.deadline = None if allowed is None else time.perf_counter() + allowed
    samples = simulation.record(end, interval, progress)
    run = recorded(simulation, *samples, time.thread_time() - clock)
    return placed(judge(run, interval, limit, allowed, estimate_error), scene)


def judge(trajectory: Trajectory, interval: float, error_limit: float = 0.05, time_limit: float | None = None,
          companions: bool = True) -> Trajectory:  # fmt: skip
    """Return the trajectory with its estimated error. The status becomes "inaccurate" if the error exceeds error_limit;
    a failed run keeps its status. interval: sampling interval, s. companions: True to compute the additional runs that
    the estimate needs."""
    if trajectory.status != STATUS[OK]:
        return trajectory
    scene, settings, t, levels = trajectory.scene, trajectory.settings, trajectory.t, trajectory.step_levels
    parts, why = {"energy": accuracy.energy_part(trajectory.balance, trajectory.turned_over), **trajectory.notes}, ""
    # runs of other steps and meshes; then the elastica's neglect of stretch and shear
    if companions:
        companion = partial(_probe, end=float(t[-1]), allowed=time_limit)
        tips = reading_of(scene).compared_tips(scene.arm, settings, trajectory.q, lambda: trajectory.tip)
        mine = accuracy.Probe(t, tips, True)
        found, why = accuracy.estimate(scene, settings, mine, float(t[-1]), interval, companion, levels)
        parts |= found | accuracy.followed(scene, settings, mine, interval, companion, levels, trajectory.notes)
    total = accuracy.total(parts)
    changes: dict[str, Any] = {"error_estimate": total if companions else math.nan, "error_parts": parts}
    if (message := accuracy.missed(settings, trajectory.step_error)) or not total <= error_limit:
        message = message or accuracy.Estimate(total, parts, why).message(error_limit)
        changes |= {"status": accuracy.INACCURATE, "message": message}
    return dataclasses.replace(trajectory, **changes)


def _probe(scene: Scene, settings: Settings, interval: float, levels: Sequence[int] = (), stiffness: float = 1.0, *,
           end: float, allowed: float | None) -> accuracy.Probe:  # fmt: skip
    """Make a companion run; return its tips. stiffness: factor on EI; end: s; allowed: wall-clock time, s, or None."""
    try:
        simulation = Simulation(scene, accuracy.in_steps(scene, settings, end, interval))
    except NoEquilibrium:  # on its mesh or in its steps; the run itself began at rest
        return accuracy.Probe(np.zeros(0), _NO_POINTS, False)
    simulation.follow = levels
    simulation.par[[STIFFNESSES[name] for name in reading_of(scene).stiffnesses if name != "GJ"]] *= stiffness
    simulation.compile()
    simulation.deadline = None if allowed is None else time.perf_counter() + allowed
    fields, _ = simulation.record(end, interval)
    tips = reading_of(scene).compared_tips(scene.arm, settings, fields["q"], lambda: fields["poses"][:, -1, TIP])
    return accuracy.Probe(fields["time"], tips, simulation.status == OK)


__all__ = ["Simulation", "Trajectory", "simulate"]
