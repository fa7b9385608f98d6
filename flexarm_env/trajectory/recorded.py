"""Recorded simulations: poses, energies and torques over time, and output as CSV, NPZ or a player page."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import validation as check
from ..files import from_json, read_npz, unit_of, write_npz, write_text
from ..physics.assembly import assemble
from ..physics.gauges import Spot, curvatures
from ..physics.layout import FACTORISATIONS, HALVINGS, ITERATIONS, STEPS
from ..physics.model import STATUS
from ..physics.reading import reading_of
from ..scene import Scene, computed, in_plane
from ..sensors import MEASURES, Sensors, StrainGauge, from_table
from ..settings import Settings
from ..validation import Array

if TYPE_CHECKING:
    from ..view import Clip, Player, SpaceClip

MOST_STEPS, MOST_SAMPLES = 10**9, 10**6
"""Largest number of steps (half an hour for the fastest arm) and of recorded instants (some GB) of a run."""


@dataclass(repr=False)
class Trajectory:
    """Recorded simulation of an arm with N links at n instants, in SI units.

    A kink is an instant at which an input is discontinuous. The values recorded at a kink are the values just before
    the kink.

    Arrays of points, rotations and deflections have shapes and components for the plane or for space (x, y, z).

    Attributes:
        scene, settings: the scene and the solver settings of the run. t (n,): recorded instants, s.
        start, tip (n, 3): x, y (m) and angle (rad) of the root of link 0 and of the tip of the last link; in space
            their positions, m.
        tip_velocity (n, 3): time derivatives of `tip`, m/s and rad/s; in space (n, 6): velocity, m/s, and angular
            velocity, rad/s, in inertial axes.
        tip_rotation (n, 4), in space: quaternion (w, x, y, z), w >= 0, of the tip's axes, whose x axis points along the
            link. hinges (n, N-1, 2), in space (n, N-1, 3): positions of joints 1 to N-1, m.
        joint_angles, joint_rates (n, N): angles, rad, and rates, rad/s, of the joints: joint 0 relative to the x axis
            or the floating base, joint k relative to the tip of link k-1; in space about the joints' axes.
        motor_angles, motor_rates (n, N): angles, rad, and rates, rad/s, of the motors, divided by the gear ratio and
            relative to the previous link. With a rigid gear the motor's angle and rate equal the joint's angle and
            rate.
        joint_torque (n, N): applied torque, or torque that enforces a prescribed angle, N m.
        tip_deflection (n, N): displacement of each link's tip, relative to the unstressed link, normal to the tangent
            at the link's root, divided by the link's length; in space (n, N, 2): along the y and z axes at the link's
            root, 0 for rigid links.
        twist (n, N), in space: rotation of each link's tip about the x axis of the link's root, relative to the root,
            rad.
        kinetic, strain_energy, gravity (n,): kinetic, strain and gravitational energy, J.
        dissipated, work (n,): energy dissipated since the start, and work of the drives since the start, J.
        unresolved_damping (n,), in space: energy dissipated by the damping forces since the start, minus `dissipated`,
            J. `unresolved_damping` arises because strain rates within steps differ from the rates at the ends of steps
            by a term of second order in the step. `unresolved_damping` is large only in stiff links with damping.
        shapes (n, points, 2), in space (n, points, 3): points along the arm's center line from root to tip, m.
        q, v (n, rows): the solver's coordinates and their time derivatives; names (rows,): names of the coordinates. In
            space v contains the angular velocity of a rotation in the section's own axes, rad/s. If the motion was
            computed in a plane (`scene.plane.in_plane`), q and v are the coordinates and rates of the planar run.
        status: "ok", "inaccurate", or the name of the failure that ended the run. message: a sentence about the status.
        steps, iterations, factorizations, halvings: numbers of time steps, Newton iterations, factored matrices and
            halved steps. cpu_seconds: CPU time of the run's thread, s, without compilation.
        notes: tip errors that the formulation causes, divided by the arm's length, by the name of the cause.
        error_estimate: estimated error of the tip's position, divided by the arm's length (`flexarm_env.accuracy`); nan
            if the run ended early or the error was not estimated. error_parts: the parts of the estimate, by name.
        deflection_bound: value of `tip_deflection` at which a run ends; infinite unless each link is reduced to modes.
        step_levels: with the setting step_tolerance, the number of halvings of dt in each interval. Intervals end at
            samples and kinks.
        step_error: with step_tolerance, the largest estimated tip error of an interval, divided by the arm's length; 0
            without this setting.
        gross_work: sum of the magnitudes of the drives' positive and negative work, J.
        link_angles (n, N, 2), in the plane: angles of the tangents at each link's root and tip, rad. link_rotations (n,
            N, 2, 4), in space: quaternions (w, x, y, z) of the axes at each link's root and tip.
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
    strain_energy: Array
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
    step_error: float = 0.0
    motor_angles: Array = field(default_factory=lambda: np.zeros((0, 0)))
    motor_rates: Array = field(default_factory=lambda: np.zeros((0, 0)))
    link_angles: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    tip_rotation: Array = field(default_factory=lambda: np.zeros((0, 0)))
    twist: Array = field(default_factory=lambda: np.zeros((0, 0)))
    link_rotations: Array = field(default_factory=lambda: np.zeros((0, 0, 2, 4)))
    unresolved_damping: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Set the attribute `unresolved_damping` to zero at all instants if it was not given."""
        if not np.size(self.unresolved_damping):
            self.unresolved_damping = np.zeros(np.size(self.t))

    def __repr__(self) -> str:
        end = f" to {self.t[-1]:g} s" if len(self.t) else ""
        how = f"{self.settings.formulation}, dt = {self.settings.dt:.4g} s"
        return f"<Trajectory of {self.scene.name}: {self.status}, {len(self.t)} instants{end}; {how}>"

    @property
    def arrays(self) -> dict[str, check.Shape]:
        """Names and shapes of the arrays that the run has, in the plane or in space."""
        return arrays_of(self.scene)

    @property
    def base_angle(self) -> Array:
        """Attitude (n,) of the floating base relative to its attitude at the start, rad.

        Raises ValueError if the arm has no floating base.
        """
        if "base" not in self.names:
            raise check.InvalidValue("scene.arm.base", self.scene.arm.base, "must be a Base, and scene.root free")
        return self.q[:, self.names.index("base")]

    @property
    def finished(self) -> bool:
        """True if the run reached its end time; the status is then "ok" or "inaccurate"."""
        return self.status in ("ok", "inaccurate")

    @property
    def energy(self) -> Array:
        """Sum of kinetic, strain and gravitational energy, (n,), J."""
        return self.kinetic + self.strain_energy + self.gravity

    @property
    def balance(self) -> Array:
        """Energy error (n,), J: change of `energy` since the start + `dissipated` + `unresolved_damping` - `work`.

        The energy error is 0 for an exact solution.
        """
        energy = self.energy
        brought = self.work - self.dissipated  # a velocity that jumps at the start brings some before the first sample
        error = np.asarray(energy - energy[0] - (brought - brought[0]))
        return np.asarray(error + self.unresolved_damping - self.unresolved_damping[0])

    @property
    def turned_over(self) -> float:
        """Reference energy for the error `balance`, J: gross work + initial energy + energy exchanged with gravity."""
        return self.gross_work + float(self.kinetic[0] + self.strain_energy[0] + np.ptp(self.gravity))

    def strain(self, link: int, place: float, distance: float | None = None) -> Array:
        """Return a link's bending strain (n,) at `place`: curvature times distance from the neutral axis.

        Args:
            link: index of the link, from 0. place: position along the link, from 0 (root) to 1 (tip).
            distance: distance from the neutral axis, m. None means sqrt(3 J / m): half the thickness of a rectangular
                section with the link's mass per length m and rotary inertia per length J.
        """
        gauge = StrainGauge(link=link, place=place, unit="strain", distance=distance)
        Sensors(strain_gauges=(gauge,)).check_for(self.scene.arm.links)
        return self._bending((gauge,))[:, 0]

    def _bending(self, gauges: Sequence[StrainGauge]) -> Array:
        """Return the readings (n, gauges) of ideal gauges."""
        units = [gauge.per_curvature_of(self.scene.arm.links[gauge.link]) for gauge in gauges]
        return np.asarray(self._curvature([gauge.spot for gauge in gauges]) * np.array(units))

    def _curvature(self, places: Sequence[Spot]) -> Array:
        """Return the curvatures (n, places), 1/m; for a motion in a plane in space, those of its planar scene."""
        flat = in_plane(self.scene)
        if flat is None:
            return curvatures(self.scene, self.settings, self.names, places, self.q)
        found = curvatures(flat.scene, self.settings, self.names, [spot[:2] for spot in places], self.q)
        shares = [(*flat.frames[spot[0]][1, 1:], 0.0)[MEASURES.index((*spot, "xy")[2])] for spot in places]
        return np.asarray(found * np.array(shares))

    # --- to be looked at ---------------------------------------------------------------------------
    def clip(self, label: str | None = None) -> Clip | SpaceClip:
        """Return the run as a clip for the player.

        label: name of the run in the player; the default is the scene's name. Raises ValueError if the run has no
        samples or has inconsistent arrays.
        """
        self.check_arrays()
        if not len(self.t):
            raise check.InvalidValue("t", self.t, "must hold one instant at least to be shown")
        from ..view.sources import clips_of

        return clips_of(self.scene.axes).run(self, label, self._curvature)

    def view(self, *others: Trajectory, labels: Sequence[str] | None = None) -> Player:
        """Return a `Player` that shows this run and `others` together.

        Write the player to a web page by `.save("arm.html")`, or display it in a notebook. labels: names of the runs,
        this run first; the default is the names of the scenes.
        """
        from ..view import Player

        return Player.of((self, *others), labels)

    def _repr_html_(self) -> str:
        return self.view()._repr_html_()

    def measured(self, sensors: Sensors | Mapping[str, Any] | None = None, seed: int = 0) -> dict[str, Array]:
        """Return the readings of sensors at the recorded instants, computed as in the environments.

        Args:
            sensors: a `flexarm_env.sensors.Sensors`, or a dict with its fields. None: the arm's own sensors, or ideal
                sensors if the arm has no sensors.
            seed: seed of the sensors' noise, gains and biases.
        Returns:
            Arrays (n,) by name of the reading, for example `hub_angle` (rad), `hub_rate` (rad/s), `tip_acceleration_x`
            (m/s^2), `camera_x` (m) and `strain_gauge_1` (1/m, or strain).
        Raises:
            ValueError: there are fewer than two samples, the samples are not evenly spaced, or arrays are inconsistent.
        """
        self.check_arrays()
        arm = self.scene.arm
        own = arm.sensors if sensors is None else sensors
        own = Sensors.ideal(arm.links) if own is None else own
        own = own if isinstance(own, Sensors) else from_table(check.table_of("sensors", own))
        with check.under("sensors"):
            own.check_for(arm.links, self.scene.axes, touches=False)
        steps = np.diff(self.t)
        if not len(steps) or np.ptp(steps) > 1e-6 * steps[0]:
            what = (
                f"must be at even distances to be measured, so `sample` a part of duration = {self.scene.duration:g} s"
            )
            raise ValueError(f"t: {len(self.t)} samples {what}")
        return self._read(own, float(self.t[-1] - self.t[0]) / len(steps), seed)

    def _read(self, sensors: Sensors, period: float, seed: int) -> dict[str, Array]:
        """Return the readings of sensors at the samples, by name; period: s between samples; seed: seed of noise."""
        from ..runtime.laws import law_of, memory_of, room_of
        from ..runtime.readings import read_rows

        arm, axes = self.scene.arm, self.scene.axes
        readings = sensors.readings(arm, axes)
        if not readings:
            return {}
        joints = range(arm.n_links if sensors.encoders else 0)
        at_motor = [sensors.encoder(k).side == "motor" for k in joints]
        inputs = [np.where(at_motor, self.motor_angles, self.joint_angles)] if joints else []
        seen = reading_of(self.scene).tip_inputs(self.tip, self.tip_velocity, self.tip_rotation)
        inputs += [x for name, known in seen.items() if getattr(sensors, name) is not None for x in known]
        inputs += [self._bending(sensors.strain_gauges)] if sensors.strain_gauges else []
        channels = [place for name, place in readings.items() if not name.endswith("_rate")]  # made of the angle
        laws = np.array([law_of(law, 1.0, period, f"sensors.{place}") for place, law in channels])
        room, out = room_of(laws), np.empty((len(self.t), len(readings)))
        gravity = np.array((*(self.scene.gravity or ()), 0.0, 0.0, 0.0)[:3])
        shaken = None if sensors.accelerometer is None else (0,) * len(axes)
        stream = np.array(np.random.SeedSequence(seed).generate_state(1, np.uint64))
        read_rows(
            laws.ravel(), room, memory_of(len(laws), room), stream, period, gravity, len(joints), shaken,
            np.ascontiguousarray(np.hstack(inputs)), out,
        )  # fmt: skip
        return dict(zip(readings, out.T.copy(), strict=True))

    def columns(self) -> dict[str, Array]:
        """Return the columns that `to_csv` writes, as arrays (n,) by name."""
        table, axes = {"t": self.t, "energy": self.energy}, reading_of(self.scene).place
        for name, place in (("start", self.start), ("tip", self.tip)):
            table |= {f"{name}_{axis}": place[:, i] for i, axis in enumerate(axes)}
        count, measures = self.hinges.shape[1:]
        for k in range(count):
            mark = "" if (count, measures) == (1, 2) else str(k + 1)
            table |= {f"hinge{mark}_{axis}": self.hinges[:, k, i] for i, axis in enumerate(axes[:measures])}
        table |= {f"tip_q{axis}": column for axis, column in zip("wxyz", self.tip_rotation.T, strict=False)}
        for k, twist in enumerate(self.twist.T):
            table |= {f"joint{k}": self.joint_angles[:, k], f"twist{k}": twist}
            table |= {f"deflection{k}_{axis}": self.tip_deflection[:, k, i] for i, axis in enumerate("yz")}
        for k in range(self.scene.arm.n_links):
            if self.scene.arm.joint(k).elastic:
                table[f"motor{k}"], table[f"motor{k}_rate"] = self.motor_angles[:, k], self.motor_rates[:, k]
        return table

    def to_csv(self, path: str | os.PathLike[str], units: bool = False) -> None:
        """Write `columns` as a CSV file with all digits, in s, J, m, rad and rad/s.

        units: True to add units to the header, as in "t (s)"; this package reads files with and without units. Raises
        OSError if writing fails; the file is then unchanged.
        """
        table = self.columns()
        text = [",".join(f"{name} ({unit_of(name)})" if units and unit_of(name) else name for name in table)]
        text += [",".join(repr(float(x)) for x in row) for row in zip(*table.values(), strict=True)]
        write_text(Path(path), "\n".join(text) + "\n")

    # --- files --------------------------------------------------------------------------------------
    def check_arrays(self) -> None:
        """Raise ValueError if arrays are inconsistent or not finite, or if times do not increase."""
        links = self.scene.arm.n_links
        sizes = {"links": links, "joints - 1": links - 1, "rows": len(self.names), "n": np.size(self.t)}
        check.arrays(vars(self), {name: ("finite", shape) for name, shape in self.arrays.items()}, sizes)
        if (np.diff(self.t) <= 0.0).any():
            at = int(np.argmax(np.diff(self.t) <= 0.0)) + 1
            raise check.InvalidValue(f"t[{at}]", self.t[at], "must be later than the instant before")

    def to_npz(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file with all arrays, the status, the settings and the scene's TOML text.

        Raises OSError if writing fails; the file is then unchanged.
        """
        known: dict[str, Any] = {name: getattr(self, name) for name in (*self.arrays, "error_estimate", "status")}
        known |= {"scene": self.scene.to_toml(), "names": np.array(self.names)}
        known |= {"formulation": self.settings.formulation, "options": json.dumps(self.settings.options())}
        known |= {"about": json.dumps({name: getattr(self, name) for name in ABOUT}, default=dict)}
        write_npz(Path(path), known)

    @classmethod
    def from_npz(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a run from a file that `to_npz` wrote.

        Raises ValueError if the file is damaged, is of another kind, or was written by version 0.1.
        """
        known = read_npz(path, "trajectory")
        with check.in_file(path):
            for name in SINGLE:
                check.needed("", known, name, _NO_TRAJECTORY)
            single = {name: array.tolist() for name, array in check.arrays(known, SINGLE, {}).items()}
            about = check.table_of("about", from_json(single.pop("about"), "about"))
            own = {name: read(f"about.{name}", check.needed("about", about, name, "")) for name, read in ABOUT.items()}
            with check.under("scene"):
                scene = Scene.from_toml(single.pop("scene") + "\n")
            known.setdefault("unresolved_damping", np.zeros(0))  # files of early runs lack it
            arrays = {name: check.needed("", known, name, _NO_TRAJECTORY) for name in arrays_of(scene)}
            options = check.table_of("options", from_json(single.pop("options"), "options"))
            settings = Settings.make(single.pop("formulation"), **options)
            names = tuple(single.pop("names"))
            if settings.dt is None or names != assemble(computed(scene), settings).names:
                raise check.InvalidValue("names", names, "must be the rows of the scene's state under its options")
            run = cls(scene, settings, **arrays, names=names, **single, **own)
            run.check_arrays()
        return run


_NO_TRAJECTORY = "this is no trajectory, or one of a version before 0.2"


Reader = Callable[[str, Any], Any]


def _share(path: str, value: object) -> float:
    """Validate a number that may be infinite or nan."""
    return value if isinstance(value, float) else check.number(path, value)


def _shares(path: str, value: object) -> dict[str, float]:
    return {name: _share(f"{path}.{name}", share) for name, share in check.table_of(path, value).items()}


def _levels(path: str, value: object) -> tuple[int, ...]:
    return tuple(_count(f"{path}[{k}]", level) for k, level in enumerate(check.sequence(path, value, "whole numbers")))


_count: Reader = partial(check.integer, minimum=0)

_PLANE: dict[str, check.Shape] = {
    "t": ("n",), "start": ("n", 3), "tip": ("n", 3), "tip_velocity": ("n", 3), "hinges": ("n", "joints - 1", 2),
    **dict.fromkeys(("joint_angles", "joint_rates", "motor_angles", "motor_rates", "joint_torque"), ("n", "links")),
    "tip_deflection": ("n", "links"), "link_angles": ("n", "links", 2), "shapes": ("n", "points", 2),
    **dict.fromkeys(("kinetic", "strain_energy", "gravity", "dissipated", "work"), ("n",)),
    "q": ("n", "rows"), "v": ("n", "rows"),
}  # fmt: skip
_SPACE: dict[str, check.Shape] = {name: shape for name, shape in _PLANE.items() if name != "link_angles"} | {
    "tip_velocity": ("n", 6), "hinges": ("n", "joints - 1", 3), "tip_deflection": ("n", "links", 2),
    "shapes": ("n", "points", 3), "tip_rotation": ("n", 4), "twist": ("n", "links"),
    "link_rotations": ("n", "links", 2, 4), "unresolved_damping": ("n",),
}  # fmt: skip


def arrays_of(scene: Scene) -> dict[str, check.Shape]:
    """Return names and shapes of the arrays of a scene's trajectory; all numbers of the arrays are finite."""
    return _SPACE if scene.spatial else _PLANE


SINGLE: dict[str, tuple[str, check.Shape]] = {
    "names": ("text", ("rows",)), "error_estimate": ("number", ()),
    **dict.fromkeys(("status", "scene", "formulation", "options", "about"), ("text", ())),
}  # fmt: skip
"""Arrays that `to_npz` also writes."""

ABOUT: dict[str, Reader] = {
    "message": check.text, "steps": _count, "iterations": _count, "factorizations": _count, "halvings": _count,
    "cpu_seconds": partial(check.number, minimum=0.0), "notes": _shares, "error_parts": _shares,
    "deflection_bound": _share, "gross_work": check.number, "step_levels": _levels,
    "step_error": _share,
}  # fmt: skip
"""Fields of a trajectory that `to_npz` writes as JSON, each with the function that reads it."""


def check_work(end: float, interval: float, dt: float | None) -> None:
    """Raise ValueError if a run of `end` s would have no samples, or too many steps or samples."""
    if end < 1e-9:
        raise check.InvalidValue("duration", end, "must be at least 1e-9 s: times 1e-12 s apart count as equal")
    if dt is not None and not end / dt <= MOST_STEPS:
        what = f"must be at least {end / MOST_STEPS:.2g} s: a run of {end:g} s may take {MOST_STEPS:.0e} steps"
        raise check.InvalidValue("dt", dt, what)
    if not end / interval <= MOST_SAMPLES:
        what = f"must be at least {end / MOST_SAMPLES:.2g} s: a run of {end:g} s may have {MOST_SAMPLES:.0e} samples"
        raise check.InvalidValue("sample", interval, what)


def recorded(simulation: Any, fields: Mapping[str, Array], shapes: Array, cpu_seconds: float) -> Trajectory:
    """Create the trajectory from the arrays of `Simulation.record`, without copying them."""
    energies, torque = fields["energies"], fields["torque"]
    scene, system, counts = simulation.scene, simulation.system, simulation.work.counts
    for i, motion in enumerate(scene.motions):
        if motion.joint is not None:
            torque[:, motion.joint] = fields["reaction"][:, i]
    common: dict[str, Any] = {
        "scene": scene, "settings": simulation.settings, "t": fields["time"], "joint_torque": torque,
        **dict(zip(("kinetic", "strain_energy", "gravity"), energies.T, strict=True)),
        **{name: fields[name] for name in ("dissipated", "work", "q", "v")},
        "names": system.names, "status": STATUS[simulation.status], "message": simulation.message,
        "steps": int(counts[STEPS]), "iterations": int(counts[ITERATIONS]),
        "factorizations": int(counts[FACTORISATIONS]), "halvings": int(counts[HALVINGS]), "cpu_seconds": cpu_seconds,
        "notes": system.notes, "gross_work": simulation.gross, "step_levels": tuple(simulation.levels),
        "step_error": simulation.step_error,
    }  # fmt: skip
    found = reading_of(scene).record(scene.arm, simulation.settings, system, fields, shapes)
    return Trajectory(**common, **found)
