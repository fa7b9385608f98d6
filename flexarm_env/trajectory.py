"""What a run leaves behind: times, poses, energies, torques, work counts; CSV and NPZ."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import validation as check
from .physics.layout import (
    DISSIPATED,
    FACTORISATIONS,
    HALVINGS,
    ITERATIONS,
    POSE,
    ROOT,
    STEPS,
    TIP,
    TIP_RATES,
    WORK_DONE,
)
from .physics.model import STATUS
from .scene import Scene
from .settings import Settings

Array = NDArray[np.float64]

COLUMNS = ("t", "energy", "start_x", "start_y", "start_angle", "tip_x", "tip_y", "tip_angle")


MOST_STEPS, MOST_SAMPLES = 10**9, 10**6
"""Steps of a run (half an hour of the quickest), and its recorded instants (some GB)."""


def link_deflection(poses: Array) -> Array:
    """Tip deflection of each link over its root's tangent, m: the component of tip - root normal to it.

    poses (..., n_links, 12), see `physics.layout`; result (..., n_links).
    """
    dx, dy = poses[..., POSE.tip_x] - poses[..., POSE.x], poses[..., POSE.tip_y] - poses[..., POSE.y]
    angle = poses[..., POSE.angle]
    return np.asarray(np.cos(angle) * dy - np.sin(angle) * dx)


def joint_angles(poses: Array) -> tuple[Array, Array]:
    """Angles and rates of the joints, rad and rad/s: joint 0 from the x axis, joint k from the tip of link k - 1.

    poses (..., n_links, 12), see `physics.layout`; results (..., n_links).
    """
    angles, rates = poses[..., POSE.angle].copy(), poses[..., POSE.rate].copy()
    angles[..., 1:] -= poses[..., :-1, POSE.tip_angle]
    rates[..., 1:] -= poses[..., :-1, POSE.tip_rate]
    return angles, rates


@dataclass
class Trajectory:
    """A recorded run of n instants and N links, SI units. At a kink the values just before it are recorded.

    Attributes:
        scene, settings: what was run. t (n,): s.
        start, tip (n, 3): x, y (m) and angle (rad) of the root of link 0 and of the tip of the last link.
        tip_velocity (n, 3): m/s and rad/s. hinges (n, N-1, 2): positions of joints 1 to N-1, m.
        joint_angles, joint_rates (n, N): rad, rad/s; joint 0 from the x axis, joint k from the tip of link k-1.
        joint_torque (n, N): N m, as applied, or as needed where the joint's angle is prescribed.
        tip_deflection (n, N): each link's tip normal to its tangent at its root, over the link's length.
        kinetic, strain, gravity (n,): energies, J. dissipated, work (n,): J, since the start; work is the drives'.
        shapes (n, points, 2): points along the chain from root to tip, m.
        q, v (n, rows): the state and its rate; names (rows,) says what each row is.
        status: "ok", "inaccurate", or what ended the run early; message: the same in a sentence.
        steps, iterations, factorizations, halvings: counts of time steps, Newton iterations, matrices factored and
            steps halved. cpu_seconds: of the run, compilation left out.
        notes: what the formulation says of its own limits, fractions of the arm's length.
        error_estimate: how far the tip may be off, a fraction of the arm's length (`flexarm_env.accuracy`; nan where
            the run ended early or nothing was run to judge it by); error_parts: what it is made of, by name.
        deflection_bound: tip_deflection beyond which the formulation stops; infinite but for whole links reduced to
            modes.
        step_levels: with a step_tolerance, how often dt was halved in each stretch between samples and kinks.
        gross_work: J, the work of the drives, what they gave and what they took both counted as positive.
    """

    scene: Scene
    settings: Settings
    t: Array
    start: Array
    tip: Array
    tip_velocity: Array
    hinges: Array
    joint_angles: Array
    joint_rates: Array
    joint_torque: Array
    tip_deflection: Array
    kinetic: Array
    strain: Array
    gravity: Array
    dissipated: Array
    work: Array
    shapes: Array
    q: Array
    v: Array
    names: tuple[str, ...]
    status: str
    message: str
    steps: int
    iterations: int
    factorizations: int
    halvings: int
    cpu_seconds: float
    notes: Mapping[str, float] = field(default_factory=dict)
    error_estimate: float = float("nan")
    error_parts: Mapping[str, float] = field(default_factory=dict)
    deflection_bound: float = float("inf")
    gross_work: float = 0.0
    step_levels: tuple[int, ...] = ()

    @property
    def finished(self) -> bool:
        """The run came to its end, accurate or not."""
        return self.status in ("ok", "inaccurate")

    @property
    def energy(self) -> Array:
        """Kinetic + strain + gravity energy, J (n,)."""
        return self.kinetic + self.strain + self.gravity

    @property
    def balance(self) -> Array:
        """Energy that appeared from nowhere, J (n,): change of energy + dissipated - work; 0 for an exact solution."""
        energy = self.energy
        brought = self.work - self.dissipated  # a velocity that jumps at the start brings some before the first sample
        return np.asarray(energy - energy[0] - (brought - brought[0]))

    @property
    def turned_over(self) -> float:
        """Gross work, energy at the start and what gravity exchanged, J: what the balance is to be compared with."""
        return self.gross_work + float(self.kinetic[0] + self.strain[0] + np.ptp(self.gravity))

    def columns(self) -> dict[str, Array]:
        """The table that `to_csv` writes."""
        table = dict(zip(COLUMNS, (self.t, self.energy, *self.start.T, *self.tip.T), strict=True))
        for k in range(self.hinges.shape[1]):
            mark = "" if self.hinges.shape[1] == 1 else str(k + 1)
            table[f"hinge{mark}_x"], table[f"hinge{mark}_y"] = self.hinges[:, k].T
        return table

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write t, energy, start, tip and hinges with all their digits, whole or not at all. Raises OSError."""
        table = self.columns()
        text = [",".join(table)]
        text += [",".join(repr(float(x)) for x in row) for row in zip(*table.values(), strict=True)]
        write_whole(Path(path), ("\n".join(text) + "\n").encode())

    def to_npz(self, path: str | os.PathLike[str]) -> None:
        """Write every array, status, settings and the scene's TOML as text, whole or not at all. Raises OSError."""
        arrays: dict[str, Any] = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        arrays |= {"error_estimate": self.error_estimate}
        arrays |= {"status": self.status, "scene": self.scene.to_toml(), "names": np.array(self.names)}
        arrays |= {"formulation": self.settings.formulation, "options": repr(self.settings.options())}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_whole(Path(path), buffer.getvalue())


def write_whole(path: Path, content: bytes) -> None:
    """Write `content` to `path`, completely or not at all; its folder is made. OSError where that cannot be done."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # of this process alone
    try:
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
    finally:
        part.unlink(missing_ok=True)


def check_work(end: float, interval: float, dt: float | None) -> None:
    """ValueError for a run of `end` s that no machine comes to the end of, or that no memory holds."""
    if dt is not None and not end / dt <= MOST_STEPS:
        what = f"must be at least {end / MOST_STEPS:.2g} s: a run of {end:g} s may take {MOST_STEPS:.0e} steps"
        raise check.InvalidValue("dt", dt, what)
    if not end / interval <= MOST_SAMPLES:
        what = f"must be at least {end / MOST_SAMPLES:.2g} s: a run of {end:g} s may have {MOST_SAMPLES:.0e} samples"
        raise check.InvalidValue("sample", interval, what)


class Recorder:
    """Collects samples of a running Simulation."""

    def __init__(self, scene: Scene, settings: Settings) -> None:
        self.scene, self.settings = scene, settings
        names = ("time", "poses", "energies", "work", "dissipated", "torque", "shapes", "q", "v")
        self.rows: dict[str, list[Any]] = {name: [] for name in names}

    def add(self, simulation: Any) -> None:
        """Record the present state."""
        poses, energies = simulation.observe()
        rows = self.rows
        rows["time"].append(simulation.t)
        rows["poses"].append(poses)
        rows["energies"].append(energies)
        rows["work"].append(simulation.work.books[WORK_DONE])
        rows["dissipated"].append(simulation.work.books[DISSIPATED])
        rows["torque"].append(simulation.joint_torques())
        rows["shapes"].append(simulation.shape_points())
        rows["q"].append(simulation.work.q.copy())
        rows["v"].append(simulation.work.v.copy())

    def extend(self, fields: Mapping[str, Array], shapes: Array) -> None:
        """Record samples: their fields by name (`runtime.sampling.SAMPLE`), an instant a row; shapes (m, P, 2)."""
        torque = fields["torque"].copy()
        for i, motion in enumerate(self.scene.motions):
            if motion.joint is not None:
                torque[:, motion.joint] = fields["reaction"][:, i]
        known = dict(fields) | {"torque": torque, "shapes": shapes}
        for name, rows in self.rows.items():
            rows.extend(known[name])

    def finish(self, simulation: Any, cpu_seconds: float) -> Trajectory:
        """The Trajectory of what was recorded."""
        data = {name: np.array(rows) for name, rows in self.rows.items()}
        poses = data["poses"]
        angles, rates = joint_angles(poses)
        lengths = np.array([link.span for link in self.scene.arm.links])
        counts = simulation.work.counts
        return Trajectory(
            scene=self.scene,
            settings=self.settings,
            t=data["time"],
            start=poses[:, 0, ROOT].copy(),
            tip=poses[:, -1, TIP].copy(),
            tip_velocity=poses[:, -1, TIP_RATES].copy(),
            hinges=poses[:, 1:, POSE.x : POSE.angle].copy(),
            joint_angles=angles,
            joint_rates=rates,
            joint_torque=data["torque"],
            tip_deflection=link_deflection(poses) / lengths,
            kinetic=data["energies"][:, 0],
            strain=data["energies"][:, 1],
            gravity=data["energies"][:, 2],
            dissipated=data["dissipated"],
            work=data["work"],
            shapes=data["shapes"],
            q=data["q"],
            v=data["v"],
            names=simulation.system.names,
            status=STATUS[simulation.status],
            message=simulation.message,
            steps=int(counts[STEPS]),
            iterations=int(counts[ITERATIONS]),
            factorizations=int(counts[FACTORISATIONS]),
            halvings=int(counts[HALVINGS]),
            cpu_seconds=cpu_seconds,
            notes=simulation.system.notes,
            gross_work=simulation.gross,
            step_levels=tuple(simulation.levels),
            deflection_bound=simulation.settings.deflection_bound,
        )
