"""A scene in motion: one arm, advanced exactly from kink to kink, and its recorded Trajectory."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import kernels  # noqa: F401  (registers the formulations)
from .kernels.lanes import SINGLE
from .kernels.newmark import advance
from .kernels.restart import restart
from .kernels.rollout import observe_arm
from .kernels.work import Work, unpack, work_size
from .mechanics import assembly
from .model import DIVERGED, MESSAGE, NOT_FINITE, OK, scheme
from .scene import Scene
from .settings import Settings
from .trajectory import Recorder, Trajectory

Array = NDArray[np.float64]

_NO_POINTS = np.zeros((0, 2))

ENERGY_LIMIT = 1e3
"""Energy beyond this many times (initial energy + gross work) means that the solution has diverged."""


def _python(function: Any) -> Any:
    return getattr(function, "py_func", function)


class Simulation:
    """One arm of a scene: assembled, started consistently, advanced step by step.

    Args:
        scene: what moves. settings: formulation and options; its dt must be given.
    Attributes:
        t: time reached, s. status: a code of `flexarm_env.model`. work: views of the state (`kernels.newmark.Work`).
    """

    def __init__(self, scene: Scene, settings: Settings) -> None:
        assert settings.dt is not None
        self.scene, self.settings, self.dt = scene, settings, settings.dt
        self.system = assembly.assemble(scene, settings)
        self.drive = assembly.drive(scene, self.system)
        self.n_motions = len(scene.motions)
        self.scheme = scheme(
            settings.rho_inf,
            settings.newmark,
            settings.tolerance,
            settings.max_iterations,
            settings.max_halvings,
            settings.newton == "modified",
        )
        self.model, self.par = self.system.model, self.system.par.copy()
        self._flat = np.zeros(int(_python(work_size)(1, self.model, self.n_motions)))
        self.work: Work = _python(unpack)(SINGLE, self.model, self._flat, self.n_motions)
        self._kinks = scene.kinks
        self._poses = np.zeros(12 * scene.arm.n_links)
        self._energies = np.zeros(3)
        self.reset()

    def reset(self) -> None:
        """Back to t = 0, consistent at 0+."""
        self._flat[:] = 0.0
        self.work.q[:], self.work.v[:] = self.system.q0, self.system.v0
        self.t = 0.0
        self._restart()

    @property
    def status(self) -> int:
        """Status code, see `flexarm_env.model.STATUS`."""
        return int(self.work.flag[0])

    @property
    def message(self) -> str:
        """The status in a sentence."""
        bound = float(getattr(self.model, "bound", 0.0))
        return MESSAGE[self.status].format(t=self.t, h=self.dt, halvings=self.scheme.max_halvings, bound=bound)

    def set_torques(self, torques: Array) -> None:
        """Joint torques (N m, one a joint) that hold from now on: a kink, so accelerations are solved afresh."""
        self.work.u[: len(torques)] = torques
        self._restart()

    def advance_to(self, t_end: float, books: bool = True) -> bool:
        """Advance to t_end in equal steps of at most dt, landing on every kink; False where the arm has failed.

        books: keep account of work and dissipation (their place is `work.books`).
        """
        while self.t < t_end - 1e-12 * max(1.0, t_end):
            stop = min([k for k in self._kinks if k > self.t + 1e-12 * max(1.0, k)] + [t_end])
            stop = min(stop, t_end)
            n_steps = max(1, math.ceil((stop - self.t) / self.dt * (1.0 - 1e-9)))
            h = (stop - self.t) / n_steps
            self.t = advance(
                SINGLE, self.model, self.drive, self.par, self._flat, self.n_motions,
                self.t, h, n_steps, self.scheme, books,
            )  # fmt: skip
            if self.status != OK:
                return False
            if not math.isfinite(self.work.q[-1]) or not np.isfinite(self.work.q).all():
                self.work.flag[0] = NOT_FINITE
                return False
            self.t = stop
            if stop in self._kinks and stop < t_end - 1e-12 * max(1.0, t_end):
                self._restart()
        return True

    def compile(self) -> float:
        """Compile what `advance_to` needs (or load it from the cache) without moving; CPU seconds it took."""
        clock = time.process_time()
        advance(
            SINGLE, self.model, self.drive, self.par, self._flat, self.n_motions,
            self.t, self.dt, 0, self.scheme, True,
        )  # fmt: skip
        return time.process_time() - clock

    def _restart(self) -> None:
        restart(SINGLE, self.model, self.drive, self.par, self._flat, self.n_motions, self.t, self.dt)

    def restart_at_kink(self) -> None:
        """Solve for the state at t+ where the time reached is a kink."""
        if any(abs(k - self.t) <= 1e-12 * max(1.0, k) for k in self._kinks):
            self._restart()

    def observe(self) -> tuple[Array, Array]:
        """Link poses (n_links, 12) and energies (kinetic, strain, gravity) in J; copies."""
        self._observe(_NO_POINTS)
        return self._poses.reshape(-1, 12).copy(), self._energies.copy()

    def _observe(self, points: Array) -> int:
        w = self.work
        return int(observe_arm(SINGLE, self.model, self.par, w.q, w.v, self._poses, self._energies, points))

    def joint_torques(self) -> Array:
        """Torque of each joint, N m (n_links,): applied, or the one that enforces its prescribed angle."""
        torques = self.work.u[: self.scene.arm.n_links].copy()
        for i, motion in enumerate(self.scene.motions):
            if motion.joint is not None:
                torques[motion.joint] = self.work.reaction[i]
        return torques

    def shape_points(self) -> Array:
        """Positions along the chain, root to tip, (n_points, 2) m."""
        points = np.full((2 + 8 * 64 * self.scene.arm.n_links, 2), np.nan)
        return points[: self._observe(points)].copy()


def simulate(
    scene: Scene,
    formulation: str | None = None,
    *,
    duration: float | None = None,
    sample: float | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Trajectory:
    """Run a scene and record it.

    Args:
        scene: a `Scene` (see `flexarm_env.scenes.named`).
        formulation: "floating_frame", "geometrically_exact" or "elastica"; None takes the scene's.
        duration, sample: s; None takes the scene's. progress: called with the share done, 0 to 1.
        options: flat keywords of the formulation (`flexarm_env.settings.Settings`), e.g. segments=8, dt=0.01.
    Returns:
        The Trajectory, with `status` other than "ok" and a sentence in `message` where the run ended early.
    Raises:
        ValueError: an option the formulation lacks, or a value that is not allowed.
    """
    settings = scene.settings(formulation, **options)
    end = scene.duration if duration is None else _positive("duration", duration)
    interval = scene.sample if sample is None else _positive("sample", sample)
    assert interval is not None
    if end > scene.duration:
        scene = dataclasses.replace(scene, duration=end)  # its kinks up to there count
    simulation = Simulation(scene, settings)
    recorder = Recorder(scene, settings)
    recorder.add(simulation)
    start_energy = float(simulation.observe()[1].sum())
    gross = abs(float(simulation.work.books[0]))
    counts = max(1, math.ceil(end / interval * (1.0 - 1e-9)))
    simulation.compile()
    clock = time.process_time()
    for k in range(1, counts + 1):
        before = float(simulation.work.books[0])
        good = simulation.advance_to(min(k * interval, end))
        if not good:
            break
        recorder.add(simulation)
        gross += abs(float(simulation.work.books[0]) - before)
        total = abs(recorder.last_energy)
        if total > ENERGY_LIMIT * (abs(start_energy) + gross + 1e-300) and total > 1e-9:
            simulation.work.flag[0] = DIVERGED
            break
        simulation.restart_at_kink()
        if progress is not None:
            progress(k / counts)
    return recorder.finish(simulation, time.process_time() - clock)


def _positive(name: str, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
        raise ValueError(f"{name} = {value!r}: must be a positive number (s)")
    return float(value)


__all__ = ["Simulation", "simulate", "Trajectory"]
