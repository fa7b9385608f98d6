"""A scene: an arm, its initial configuration, prescribed motions, loads, and duration.

Angles are measured counterclockwise from the inertial x axis, in rad; all quantities are in SI units. A scene is
immutable, hashable and validated at creation: a ``ValueError`` names the key path, the value and the rule.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from flexarm_env import validation as check
from flexarm_env.bodies import Axes, axes_of
from flexarm_env.parameters import Arm
from flexarm_env.records import choice, number, switch, validate, words
from flexarm_env.scene import toml
from flexarm_env.scene.contacts import Contact, contacts_of
from flexarm_env.scene.drives import ROOT, JointTorque, Load, Motion, PointLoad
from flexarm_env.scene.mesh import default_mesh
from flexarm_env.settings import Settings, default_options, expand_preset, merged
from flexarm_env.time_functions import TimeFunction, constant

_SAME_TIME = 1e-9
"""Instants of different functions count as one if their difference is smaller (in s, or relative to the duration)."""


_REQUIRED: Any = dataclasses.field()
"""Field without a default. (Type checkers then accept it behind a field whose default is not visible.)"""


@dataclass(frozen=True)
class Scene:
    """Arm with initial state, prescribed motions, loads, contacts and duration of a simulation.

    Args:
        name: name of the scene, a short word.
        arm: the arm, N links.
        duration: duration of the simulation, s. dt: default time step, s. sample: default sampling interval, s (None:
            ``dt``).
        root: "pinned": the root's position is fixed or prescribed, and the hub's angle is free unless prescribed.
            "free": the arm, including a floating base, moves freely.
        position: position of the root at t = 0, m: (x, y), in space (x, y, z).
        angles: absolute angles of the links at t = 0, N numbers (rad), or () if all links point along +x. The angle of
            a curved link is the angle of its tangent at the root. If the links turn out of the plane (`Arm.spatial`),
            `angles` are joint angles.
        velocity: velocity of the root before t = 0, m/s: (x, y), in space (x, y, z). rates: absolute angular rates of
            the links before t = 0, N numbers (rad/s), or () for rest; in space joint rates. Before t = 0 each link
            moves as a rigid body. If a prescribed motion begins with a different rate, the joint's rate jumps at t = 0.
        start: "unloaded": the arm starts without stress. "held": the arm starts at rest under gravity and the loads at
            t = 0, with its joints (with elastic gears, its motors) held at `angles`. At t = 0 the joints without
            prescribed motions are released. "equilibrium": the arm starts at rest under gravity and the loads at t = 0,
            with free joints.
        rigid_joints: indices k >= 1 of joints that cannot turn; link k keeps its initial angle to link k-1.
        motions: prescribed coordinates; each must start at the value given by ``position`` and ``angles``.
        loads: joint torques and point loads.
        contacts: obstacles that points of the arm can touch, with the force laws (`Contact`).
        gravity: gravitational acceleration (gx, gy), in space (gx, gy, gz), m/s^2, or None.
        space: True to compute the scene in space even if it could be computed in the plane. A scene is always in space
            if its arm, its gravity, its initial position or velocity, a load, or a motion of the root has a component
            out of the x-y plane. If the motion of a scene in space stays in a plane, `simulate` computes the
            scene in that plane (`scene.plane.in_plane`).
        solver: default formulation and solver options of the scene, as pairs (name, value) or a dict.
        description, source, note: texts on content, origin and assumptions.
    """

    name: str = words("a short word", empty=False)
    arm: Arm = _REQUIRED
    _: KW_ONLY
    duration: float = number("length of the run", "s", above=0.0)
    dt: float = number("default time step", "s", above=0.0)
    sample: float | None = number(
        "default sampling interval; left out: the step", "s", None, above=0.0, optional=True
    )
    root: str = choice(("pinned", "free"), "whether the root is on its joint, or the arm is a free body", "pinned")
    position: tuple[float, ...] = (0.0, 0.0)
    angles: tuple[float, ...] = ()
    velocity: tuple[float, ...] = (0.0, 0.0)
    rates: tuple[float, ...] = ()
    rigid_joints: tuple[int, ...] = ()
    motions: tuple[Motion, ...] = ()
    loads: tuple[Load, ...] = ()
    gravity: tuple[float, ...] | None = None
    solver: tuple[tuple[str, Any], ...] = ()
    description: str = words("what the scene shows", "")
    source: str = words("origin of the parameters", "")
    note: str = words("assumptions", "")
    start: str = choice(
        ("unloaded", "held", "equilibrium"), "start without stress, or at rest with held or with free joints",
        "unloaded",
    )  # fmt: skip
    space: bool = switch("use the spatial solver, even if the arm stays in a plane", False)
    contacts: tuple[Contact, ...] = ()

    def __post_init__(self) -> None:
        """Validate each field, then combinations of fields; an `InvalidValue` names the invalid field."""
        n = check.instance("arm", self.arm, Arm).n_links
        validate(self)
        values: dict[str, Any] = {
            "position": _vector("position", self.position, "m"),
            "angles": self._one_a_link("angles", "rad", n),
            "velocity": _vector("velocity", self.velocity, "m/s"),
            "rates": self._one_a_link("rates", "rad/s", n),
            "gravity": None if self.gravity is None else _vector("gravity", self.gravity, "m/s^2"),
            "rigid_joints": self._checked_rigid_joints(n),
            "motions": check.sequence("motions", self.motions, "Motion"),
            "loads": check.sequence("loads", self.loads, "JointTorque or PointLoad"),
            "solver": _solver(self.solver),
            "contacts": contacts_of("contacts", self.contacts, self.arm),
        }
        check.store(self, sample=self.dt if self.sample is None else self.sample)
        for name in ("dt", "sample"):
            if getattr(self, name) > self.duration:
                what = f"must not exceed the duration, {self.duration:g} s"
                raise check.InvalidValue(name, getattr(self, name), what)
        # the checks of combinations below read the validated fields
        check.store(self, **values)
        self._check_rates()
        self._check_motions()
        self._check_joints()
        self._check_loads()
        self._check_contacts()
        # in space position, velocity and gravity have three components
        vectors, count = {name: getattr(self, name) for name in ("position", "velocity", "gravity")}, len(self.axes)
        longer = {name: (*v, 0.0) for name, v in vectors.items() if v is not None and len(v) < count}
        check.store(self, **longer)
        self._join_instants()

    def _one_a_link(self, name: str, unit: str, n: int) -> tuple[float, ...]:
        """Validate a field with one number per link; () stands for zeros."""
        what = f"{n} numbers ({unit})"
        given = check.sequence(name, getattr(self, name), what)
        return check.numbers(name, given, what, n, unit) if given else (0.0,) * n

    def _check_rates(self) -> None:
        """Check the initial rates: zero for a start at rest or a fixed root, and equal across rigid joints."""
        if self.start != "unloaded":
            if self.root == "free":
                raise check.InvalidValue("start", self.start, 'must be "unloaded" where the root is free')
            for name in ("velocity", "rates"):
                if any(getattr(self, name)):
                    what = f'must be 0 where start = "{self.start}": the arm rests'
                    raise check.InvalidValue(name, getattr(self, name), what)
        # a rigid joint: equal absolute rates in the plane, zero joint rate in space
        for k in self.rigid_joints:
            if self.arm.relative(self.rates, k):
                own, still = self.rates[k], self.rates[k] - self.arm.relative(self.rates, k)
                what = f"that of the link before, {self.rates[k - 1]!r}" if still == self.rates[k - 1] else "0"
                raise check.InvalidValue(f"rates[{k}]", own, f"must be {what}: joint {k} is rigid")
        if self.root != "free" and any(self.velocity):
            for name, rate in zip(ROOT, self.velocity, strict=False):
                if rate and self.motion_of(name) is None:
                    what = f"must be 0 in the direction of {name}, which is held; give root='free', or a Motion"
                    raise check.InvalidValue("velocity", self.velocity, what)

    def _checked_rigid_joints(self, n: int) -> tuple[int, ...]:
        """Validate the indices of rigid joints and return them sorted."""
        joints = check.sequence("rigid_joints", self.rigid_joints, "joint indices")
        for i, joint in enumerate(joints):
            check.integer(f"rigid_joints[{i}]", joint, minimum=1, maximum=max(n - 1, 0))
            if joint in joints[:i]:
                raise check.InvalidValue(f"rigid_joints[{i}]", joint, "must not be given twice")
        return tuple(sorted(int(joint) for joint in joints))

    def _check_motions(self) -> None:
        """Check that each motion prescribes an existing, free coordinate once and starts at its initial value."""
        for i, motion in enumerate(self.motions):
            name = check.instance(f"motions[{i}]", motion, Motion).coordinate
            path, joint = f"motions[{i}].coordinate", motion.joint
            if name in [other.coordinate for other in self.motions[:i]]:
                raise check.InvalidValue(path, name, "must not have two motions")
            if self.root == "free" and not joint:
                raise check.InvalidValue(path, name, "must not be prescribed where the root is free")
            if joint is not None and joint >= self.arm.n_links:
                last = self.arm.n_links - 1
                raise check.InvalidValue(path, name, f'must be a joint of the arm, "joint0" to "joint{last}"')
            if motion.on_motor and joint is not None and not self.arm.joint(joint).elastic:
                what = f'must be "joint{joint}": the gear there does not give, and the motor has no angle of its own'
                raise check.InvalidValue(path, name, what)
            if joint in self.rigid_joints:
                raise check.InvalidValue(path, name, f"must be a joint that can turn; rigid: {self.rigid_joints}")
            # no jump at t = 0
            initial = self.initial_value(name)
            if abs(motion.function.start - initial) > 1e-9 * max(1.0, abs(initial)):
                what = f"must be {initial!r}, the value of {name} that position and angles give at t = 0"
                raise check.InvalidValue(f"motions[{i}].function(0)", motion.function.start, what)

    def _check_joints(self) -> None:
        """Reject motors, gears and friction at joints that cannot turn: rigid joints, and the root of a free arm."""
        for k, joint in enumerate(self.arm.joints):
            path = f"arm.joints[{k}]"
            if joint.moves and (k in self.rigid_joints or (k == 0 and self.root == "free")):
                where = "where the joint is rigid" if k else "where the root is free"
                raise check.InvalidValue(path, joint, f"must be an ideal Joint() {where}")

    def _check_loads(self) -> None:
        """Check that each load acts on an existing link or on a joint that can turn."""
        n, prescribed = self.arm.n_links, [motion.joint for motion in self.motions]
        for i, load in enumerate(self.loads):
            if isinstance(load, JointTorque):
                path, joint = f"loads[{i}].joint", load.joint
                if joint >= n:
                    raise check.InvalidValue(path, joint, f"must be a joint of the arm, 0 to {n - 1}")
                if joint in prescribed:
                    raise check.InvalidValue(path, joint, "must be a joint without a prescribed motion")
                if joint in self.rigid_joints:
                    raise check.InvalidValue(path, joint, "must be a joint that can turn, not a rigid one")
                if joint == 0 and self.root == "free" and self.arm.base is None:
                    what = 'must not be 0 where the root is free; give the torque to link 0, end "root", or arm.base'
                    raise check.InvalidValue(path, joint, what)
            elif isinstance(load, PointLoad):
                if load.link >= n:
                    raise check.InvalidValue(f"loads[{i}].link", load.link, f"must be a link of the arm, 0 to {n - 1}")
            else:
                raise check.InvalidValue(f"loads[{i}]", load, "must be a JointTorque or a PointLoad")

    def _check_contacts(self) -> None:
        """Check that obstacles have two dimensions in the plane and three in space, and move along these axes."""
        contacts_of("contacts", self.contacts, self.arm, len(self.axes))

    def _join_instants(self) -> None:
        """Give instants of different functions that differ by round-off one value; this avoids tiny steps."""
        starts = [function.pieces[1:, 0] for function in self._functions()]
        # sorted without np.unique, whose first call imports numpy.ma
        times = np.array(sorted({t for start in starts for t in start.tolist()}))
        # map each later instant to the first one of its cluster
        joined: dict[float, float] = {}
        for k in np.flatnonzero(np.diff(times) <= _SAME_TIME * max(1.0, self.duration)):
            earlier, later = float(times[k]), float(times[k + 1])
            joined[later] = joined.get(earlier, earlier)
        if not joined or not self._can_join(joined):
            return

        def moved(item: Any) -> Any:
            functions = {f.name: getattr(item, f.name) for f in dataclasses.fields(item)}
            changed = {k: f.with_times(joined) for k, f in functions.items() if isinstance(f, TimeFunction)}
            return dataclasses.replace(item, **changed)

        items = {name: tuple(map(moved, getattr(self, name))) for name in ("motions", "loads", "contacts")}
        check.store(self, **items)

    def _can_join(self, joined: dict[float, float]) -> bool:
        """Return False if joined instants give two pieces of a function one start (table finer than round-off)."""
        starts = [[joined.get(t, t) for t in f.pieces[:, 0].tolist()] for f in self._functions()]
        return all(len(set(own)) == len(own) for own in starts)

    def _functions(self) -> Iterator[TimeFunction]:
        """Yield the functions of time of all motions, loads and obstacles."""
        yield from (motion.function for motion in self.motions)
        yield from (function for load in self.loads for function in load.functions)
        yield from (function for contact in self.contacts for _, function in contact.displacements)

    def initial_value(self, coordinate: str) -> float:
        """Return a coordinate's value at t = 0: "joint0", "motor0", ... in rad, "root_x", ... in m.

        The initial angle of a motor equals the joint's angle.
        """
        if coordinate in ROOT:
            return (*self.position, 0.0)[ROOT.index(coordinate)]
        # names end in the index: "joint0", "motor0"
        joint = int(coordinate[5:])
        return self.arm.relative(self.angles, joint, self.arm.links[max(joint - 1, 0)].turn)

    @property
    def spatial(self) -> bool:
        """True if the scene is in space, False if it is in the x-y plane."""
        vectors = (self.position, self.velocity, self.gravity or ())
        # out of the plane: a load, a third component, or a motion along z
        loads = any(isinstance(load, PointLoad) and load.spatial for load in self.loads)
        away = any(any(v[2:]) for v in vectors) or self.motion_of("root_z") is not None
        touched = any(contact.spatial for contact in self.contacts)
        return self.space or self.arm.spatial or loads or away or touched

    @property
    def axes(self) -> Axes:
        """Axes along which the scene's arm moves: "xy" in the plane, "xyz" in space."""
        return axes_of(self.spatial)

    @property
    def floats(self) -> bool:
        """True if the arm is mounted on a freely floating base."""
        return self.root == "free" and self.arm.base is not None

    @property
    def undriven(self) -> bool:
        """True if the scene has no prescribed motions of the arm and no loads except zero forces."""
        return not self.motions and all(isinstance(load, PointLoad) and load.silent for load in self.loads)

    def motion_of(self, coordinate: str) -> TimeFunction | None:
        """Return the function of time that prescribes a coordinate, or None if the coordinate is free."""
        return next((motion.function for motion in self.motions if motion.coordinate == coordinate), None)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Increasing instants, s, within the duration at which a time step must end ("kinks").

        At a kink the rate or acceleration of a motion or of an obstacle's displacement jumps, or the value or slope of
        a load jumps.
        """
        # motions count with two derivatives (acceleration), loads with one
        times = {t for motion in self.motions for t in motion.function.kinks}
        times |= {t for contact in self.contacts for _, function in contact.displacements for t in function.kinks}
        times |= {t for load in self.loads for function in load.functions for t in function.load_kinks}
        return tuple(sorted(t for t in times if 0.0 < t < self.duration * (1.0 - 1e-12)))

    def settings(self, formulation: str | None = None, **options: Any) -> Settings:
        """Return solver settings for this scene.

        ``options`` override the scene's ``solver``, which overrides the defaults. If `formulation` differs from the
        scene's formulation (default "floating_frame", in space "geometrically_exact"), the settings in ``solver`` are
        ignored. The default mesh is finer for arms whose sections jump or kink (`scene.mesh`).
        """
        own = dict(self.solver)
        preferred = own.pop("formulation", self.axes.formulation)
        formulation, options = expand_preset(formulation or preferred, options)
        # the scene's options belong to its own formulation
        if formulation != preferred:
            own = {}
        chosen = merged(own, options)
        mesh = default_mesh(self.arm, formulation, chosen, self.axes)
        return Settings.make(formulation, **{**mesh, **chosen}).with_dt(self.dt)

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return the JSON schema (draft 2020-12) of scene files, with which editors can complete and check files."""
        return toml.schema(cls)

    @classmethod
    def from_toml(cls, source: str | os.PathLike[str], parameter_set: str | None = None) -> Scene:
        """Read the scene from a TOML file or text (docs/scenes.md).

        Args:
            source: path of a file, or TOML text. parameter_set: name of a parameter set in the file, or None.
        Raises:
            ValueError: the content is invalid; the message names the file, the key path, the value and the rule.
            OSError: the file does not exist.
        """
        return toml.read(cls, source, parameter_set)

    def to_toml(self) -> str:
        """Return TOML text from which :meth:`from_toml` creates an equal scene."""
        return toml.text_of(self)


def _vector(path: str, values: object, unit: str) -> tuple[Any, ...]:
    """Validate two or three numbers; a third number that is 0 is dropped."""
    count = 3 if isinstance(values, list | tuple | np.ndarray) and len(values) == 3 else 2
    found = check.numbers(path, values, f"{count} numbers ({unit})", count, unit)
    return found if any(found[2:]) else found[:2]


def _solver(value: Any) -> tuple[tuple[str, Any], ...]:
    """Validate solver options; return pairs: the formulation, then the options in the formulation's order."""
    if not isinstance(value, Mapping):
        pairs = check.sequence("solver", value, "pairs (name, value)")
        pairs = tuple(check.sequence(f"solver[{i}]", pair, "a name and a value", 2) for i, pair in enumerate(pairs))
        value = {check.text(f"solver[{i}][0]", name): entry for i, (name, entry) in enumerate(pairs)}
    given = dict(value)
    if "dt" in given:
        raise check.InvalidValue("solver.dt", given["dt"], "must be given as the scene's own dt")
    if not value:
        return ()
    with check.under("solver"):
        formulation, given = expand_preset(given.pop("formulation", "floating_frame"), given)
        settings = Settings.make(formulation, **given)
    # fixed order, so that equal options are equal tuples
    ordered = [(name, getattr(settings, name)) for name in default_options(formulation) if given.get(name) is not None]
    return (("formulation", formulation), *ordered)


def standing_scene(
    arm: Arm, dt: float, gravity: tuple[float, ...] | None, angles: Sequence[float] = (), pushed: bool = False,
    contacts: tuple[Contact, ...] = (),
) -> Scene:  # fmt: skip
    """Return a scene of the arm without motions, with a pinned root or, if the arm has a base, a free root.

    Args:
        dt: solver step, s. gravity: acceleration of gravity, m/s^2, or None. angles: initial angles of the links, rad
            (in space joint angles). pushed: True to add a force at the tip, initially zero, which a caller can change
            during the simulation. contacts: obstacles that the arm can touch.
    """
    root = "pinned" if arm.base is None else "free"
    loads = (PointLoad(arm.n_links - 1, "tip", force_x=constant(0.0)),) if pushed else ()
    given: dict[str, Any] = {
        "gravity": gravity, "angles": tuple(angles), "loads": loads, "root": root, "contacts": contacts,
    }  # fmt: skip
    # the duration is arbitrary: environments advance the arm themselves
    return Scene("environment", arm, duration=max(1.0, dt), dt=dt, **given)
