"""Assembly of joints: add rotors, gears and friction to the System of an arm with ideal joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.compiler import size
from flexarm_env.parameters import Arm
from flexarm_env.physics.contact.build import loads_of, obstacle_rows, touching
from flexarm_env.physics.joints.layout import GEAR, LAW, LAWS, PLACE, PLACES
from flexarm_env.physics.joints.points import KINDS, AtPoint, Point, numbers_in_matrix
from flexarm_env.physics.model import Floating, Gears, Honours, Jointed, System
from flexarm_env.physics.protocol import NewtonPolicy
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.time_functions import constant


def with_joints(
    scene: Scene, settings: Settings, system: System, places: Sequence[tuple[int, int]] | None = None
) -> System:
    """Return the System with the arm's contributions added: gears, floating base, forces at points, and contacts.

    If there are no contributions, the function returns `system` itself.

    places: for an arm on a floating base, the pairs of rows that are positions (`places_of`); otherwise None.

    Raises:
        ValueError: the frames are joined by multipliers, or a motor has no inertia and no prescribed motion.
    """
    arm = scene.arm
    kinds, geared = points_of(arm), arm.jointed or places is not None
    if not geared and not kinds and not scene.contacts:
        return system
    joints = [k for k in range(arm.n_links) if arm.joint(k).moves and geared]
    if settings.multipliers:
        what = "must be False for an arm whose joints are not ideal; floating frames in a chain take them"
        raise check.InvalidValue("multipliers", True, what)
    # rows behind the arm's: psi of each motor on an elastic gear, then the attitude psi_b of the base
    inner, first = system.model, len(system.q0)
    elastic = [k for k in joints if arm.joint(k).elastic]
    motors = {k: first + i for i, k in enumerate(elastic)}
    _check_rotors(scene, elastic)
    absolute = (*system.absolute, *(motors[k] for k in elastic if k == 0))
    count = len(motors)
    base = None if places is None else _floating(scene, system, first + count, places)
    count += base is not None
    obstacles = obstacle_rows(scene)
    count += len(obstacles)
    # k, d, J r^2 and friction of the joints, from the arm's Joint records (after the ratio)
    rows = [system.coordinates[f"joint{k}"] for k in joints]
    laws = [_law(scene, k, row, motors.get(k, -1)) for k, row in zip(joints, rows, strict=True)]
    friction = any(joint.friction_coulomb > 0.0 for joint in arm.joints)
    play = any(joint.backlash > 0.0 for joint in arm.joints)
    rotors = getattr(inner, "rotors", None)
    # numbers per joint in S: a `GEAR`; with friction a column S^-1 e_i and a row of (6.6)
    more = GEAR.end + (first + count + len(joints) + 1 if friction else 0)
    parts: list[Any] = []
    if geared:
        spin = None if rotors is None else np.array([1.0 / arm.joint(k).gear_ratio for k in joints])
        parts.append(Gears((0,) if play else None, spin, None if rotors is None else np.abs(rotors[joints])))
    if base is not None:
        parts.append(base)
    # B u: each contribution at a point has the last point loads of u, because the forces follow the user's own loads
    axes, n, room = (3 if scene.spatial else 2), first + count, more * len(joints)
    loads = len(kinds) + len(loads_of(scene))
    entries = size(inner.n_inputs) - loads * (6 if scene.spatial else 3)
    for i, kind in enumerate(kinds):
        entry = entries + i * (6 if scene.spatial else 3)
        point = Point(entry, size(inner.n_factor) + room, (0,) * axes, (0,) * n)
        parts.append(kind.make(arm, point))
        room += numbers_in_matrix(n, axes)
    watch = None
    if scene.contacts:
        entry = entries + len(kinds) * (6 if scene.spatial else 3)
        part, watch, numbers = touching(scene, inner, entry, size(inner.n_factor) + room, n)
        parts.append(part)
        room += numbers
    model = Jointed(
        n=_enlarged_size(inner.n, count),
        n_factor=_enlarged_size(inner.n_factor, room + (base is not None)),
        n_inputs=inner.n_inputs,
        fixed=inner.fixed,
        algebraic=None,
        weight=np.concatenate([inner.weight, np.ones(count - len(obstacles)), np.zeros(len(obstacles))]),
        newton=(_without_trust(inner.newton) if play else inner.newton)._replace(
            friction=(0,) if friction else None, contact=watch
        ),
        bound=float(getattr(inner, "bound", 0.0)),
        arm=inner,
        table=np.array([place for place, _ in laws], np.int64).ravel(),
        data=np.concatenate([np.zeros(0), *(law for _, law in laws)]),
        own=None,
        contributions=tuple(parts),
        points=(0,) * size(inner.n_inputs) if loads else None,
        derived=(0,) if loads or rotors is not None else None,
    )
    # psi of motors as the scene gives them, at their joints' rates; psi_b' = 0: the base is at rest
    wound = [scene.initial_value(f"motor{k}") for k in elastic]
    names, still = tuple(f"motor{k}" for k in elastic), [0.0] * (base is not None)
    if base is not None:
        names, absolute = (*names, BASE), (*absolute, base.row)
    names, places_0 = (*names, *obstacles), [float(f(0.0)) for f in obstacles.values()]
    rates_0 = [float(f(0.0, 1)) for f in obstacles.values()]
    return dataclasses.replace(
        system,
        model=model,
        q0=np.concatenate([system.q0, wound, still, places_0]),
        v0=np.concatenate([system.v0, [system.v0[system.coordinates[f"joint{k}"]] for k in elastic], still, rates_0]),
        coordinates={**system.coordinates, **{name: first + i for i, name in enumerate(names)}},
        names=(*system.names, *names),
        absolute=absolute,
    )


BASE = "base"
"""Name of the row for the attitude of a floating base."""


def points_of(arm: Arm) -> list[AtPoint]:
    """Return the kinds of point forces (`AtPoint`), such as a spring, that the arm has."""
    defaults = {field.name: field.default for field in dataclasses.fields(arm)}
    return [kind for kind in KINDS if any(getattr(arm, name) != defaults[name] for name in kind.fields)]


def with_points(scene: Scene) -> Scene:
    """Return the scene with one additional point load of zero force for each point force and each point that may touch.

    The added loads follow the scene's own loads.
    """
    loads = [PointLoad(*kind.place(scene.arm), constant(0.0)) for kind in points_of(scene.arm)]
    loads += loads_of(scene)
    return dataclasses.replace(scene, loads=(*scene.loads, *loads)) if loads else scene


def with_contributions(honours: Honours) -> Honours:
    """Return a formulation's `HONOURS`, to which the arm's fields that describe point forces are added."""
    return {**honours, Arm: (*honours[Arm], *(name for kind in KINDS for name in kind.fields))}


def check_floating(scene: Scene, settings: Settings) -> None:
    """Raise ValueError, with the key path, for a property that an arm on a floating base cannot have."""
    link = scene.arm.links[0]
    if link.root_offset:
        what = "must be 0 on a base that floats, whose mass is at the hub"
        raise check.InvalidValue("links[0].root_offset", link.root_offset, what)
    if settings.multipliers:
        raise check.InvalidValue("multipliers", True, "must be False on a base that floats")
    if scene.arm.mass_damping:
        what = "must be 0 on a base that floats; tau_d damps under every formulation"
        raise check.InvalidValue("mass_damping", scene.arm.mass_damping, what)


def with_base_mass(scene: Scene) -> Scene:
    """Return the scene with the floating base's mass (kg) added at the root of link 0."""
    arm = scene.arm
    assert arm.base is not None
    first = dataclasses.replace(arm.links[0], root_mass=arm.links[0].root_mass + arm.base.mass)
    return dataclasses.replace(scene, arm=dataclasses.replace(arm, links=(first, *arm.links[1:])))


def places_of(system: System, moved: System) -> list[tuple[int, int]]:
    """Return the System's pairs of rows (x, y) that are positions.

    A pair is a position if its value differs in `moved`, the System of the same scene at a different position.
    """
    return [pair for pair in system.vectors if moved.q0[pair[0]] != system.q0[pair[0]]]


def _floating(scene: Scene, system: System, row: int, places: Sequence[tuple[int, int]]) -> Floating:
    """Return the `Floating` record of the scene's base. row: row of the attitude. places: pairs of position rows."""
    arm = scene.arm
    assert arm.base is not None
    return Floating(
        row=row, inertia=arm.base.inertia, mass=arm.mass - arm.payload.mass + arm.base.mass,
        angles=np.array([*system.absolute, row], np.int64), vectors=np.array(system.vectors, np.int64).ravel(),
        places=np.array(places, np.int64).ravel(), room=(0,) * (row + 1),
    )  # fmt: skip


NOTHING = 1e-12
"""Fraction of the hub inertia in a model whose arms have their own hub inertia. It is not 0, so that the hub's term is
compiled."""


def with_own_laws(system: System, hub: float) -> System:
    """Return the System whose joint laws are the last entries of `par`, so that each arm may have laws of its own.

    hub: inertia at the hub, kg m^2, if it is randomized for each arm; otherwise 0.
    """
    model = system.model._replace(own=(0,) * len(system.par))
    if hub > 0.0 and model.table[PLACE.motor] >= 0:
        # the hub inertia is before the gear and not in its rotor J r^2: a field of its own, a placeholder until drawn
        model = model._replace(data=model.data.copy(), hub=(0,))
        model.data[LAWS.hub] = NOTHING * hub
    return dataclasses.replace(system, model=model, par=np.concatenate([system.par, model.data]))


def _check_rotors(scene: Scene, elastic: list[int]) -> None:
    """Raise ValueError for an elastic gear whose motor has no inertia and no prescribed motion."""
    for k in elastic:
        joint = scene.arm.joint(k)
        if joint.rotor == 0.0 and scene.motion_of(f"motor{k}") is None:
            what = f'must be positive (kg m^2) behind an elastic gear, unless a motion prescribes "motor{k}"'
            raise check.InvalidValue(f"arm.joints[{k}].motor_inertia", joint.motor_inertia, what)


def _law(scene: Scene, k: int, row: int, motor: int) -> tuple[list[int], NDArray[np.float64]]:
    """Return the `PLACE` and the `LAW` of joint k. row: row of its angle. motor: row of its motor's angle, or -1."""
    joint = scene.arm.joint(k)
    on_motor = motor >= 0 and joint.friction_side == "motor"
    known = scene.motion_of(f"{'motor' if on_motor else 'joint'}{k}") is not None
    place = [k, row, motor, motor if on_motor else row, int(known)]
    assert len(place) == PLACES
    return place, LAW.pack(
        {}, stiffness=joint.stiffness if motor >= 0 else 0.0, damping=joint.damping, rotor=joint.rotor,
        viscous=joint.friction_viscous, coulomb=joint.friction_coulomb, play=0.5 * joint.backlash, hub=0.0,
    )  # fmt: skip


def _without_trust(policy: NewtonPolicy) -> NewtonPolicy:
    """Return a Newton policy, for gears with backlash, that trusts neither a first increment nor a prediction.

    An increment may cross from one flank of the gap to the other flank. The error of such an increment is not
    quadratic.
    """
    return policy._replace(first_error=None, resolved=None, predicts=None)


def _enlarged_size(size: int | tuple[int, ...], more: int) -> int | tuple[int, ...]:
    """Return a Model's size (an int or a tuple of zeros) increased by `more`."""
    return size + more if isinstance(size, int) else size + (0,) * more
