"""An arm's System and what turns its joints: the System of both."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.physics.joints.layout import GEAR, LAW, LAWS, PLACE, PLACES
from flexarm_env.physics.model import Floating, Jointed, System
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings


def jointed(
    scene: Scene, settings: Settings, system: System, places: Sequence[tuple[int, int]] | None = None
) -> System:
    """The system with what turns the arm's joints; itself where they are ideal. places: see `places_of`, of an
    arm on a base that floats.

    Raises:
        ValueError: frames joined by multipliers, or a motor without inertia that nothing prescribes.
    """
    arm = scene.arm
    if not arm.jointed and places is None:
        return system
    joints = [k for k in range(arm.n_links) if arm.joint(k).moves]
    if settings.multipliers:
        what = "must be False for an arm whose joints are not ideal; floating frames in a chain take them"
        raise check.InvalidValue("multipliers", True, what)
    inner, first = system.model, len(system.q0)
    elastic = [k for k in joints if arm.joint(k).elastic]
    motors = {k: first + i for i, k in enumerate(elastic)}
    _check_rotors(scene, elastic)
    absolute = (*system.absolute, *(motors[k] for k in elastic if k == 0))
    count = len(motors)
    base = None if places is None else _floating(scene, system, first + count, places)
    count += base is not None
    rows = [system.coordinates[f"joint{k}"] for k in joints]
    laws = [_law(scene, k, row, motors.get(k, -1)) for k, row in zip(joints, rows, strict=True)]
    friction = any(joint.friction_coulomb > 0.0 for joint in arm.joints)
    play = any(joint.backlash > 0.0 for joint in arm.joints)
    turning = getattr(inner, "rotors", None) is not None
    more = GEAR.end + (first + count + len(joints) + 1 if friction else 0)
    model = Jointed(
        n=_longer(inner.n, count),
        n_factor=_longer(inner.n_factor, more * len(joints) + (base is not None)),
        n_inputs=inner.n_inputs,
        fixed=inner.fixed,
        algebraic=None,
        weight=np.concatenate([inner.weight, np.ones(count)]),
        predictor=_cautious(inner.predictor) if play else inner.predictor,
        correction=inner.correction,
        bound=float(getattr(inner, "bound", 0.0)),
        arm=inner,
        table=np.array([place for place, _ in laws], np.int64).ravel(),
        data=np.concatenate([np.zeros(0), *(law for _, law in laws)]),
        friction=(0,) if friction else None,
        play=(0,) if play else None,
        spin=np.array([1.0 / arm.joint(k).gear_ratio for k in joints]) if turning else None,
        own=None,
        base=base,
    )
    wound = [scene.initial_value(f"motor{k}") for k in elastic]
    names, still = tuple(f"motor{k}" for k in elastic), [0.0] * (base is not None)
    if base is not None:
        names, absolute = (*names, BASE), (*absolute, base.row)
    return dataclasses.replace(
        system,
        model=model,
        q0=np.concatenate([system.q0, wound, still]),
        v0=np.concatenate([system.v0, [system.v0[system.coordinates[f"joint{k}"]] for k in elastic], still]),
        coordinates={**system.coordinates, **{name: first + i for i, name in enumerate(names)}},
        names=(*system.names, *names),
        absolute=absolute,
    )


BASE = "base"
"""Name of the row of a base's attitude."""


def check_floating(scene: Scene, settings: Settings) -> None:
    """ValueError, with its key path, for what an arm on a base that floats cannot have."""
    link = scene.arm.links[0]
    if link.root_offset:
        what = "must be 0 on a base that floats, whose mass is at the hub"
        raise check.InvalidValue("links[0].root_offset", link.root_offset, what)
    if settings.multipliers:
        raise check.InvalidValue("multipliers", True, "must be False on a base that floats")
    if scene.arm.mass_damping:
        what = "must be 0 on a base that floats; tau_d damps under every formulation"
        raise check.InvalidValue("mass_damping", scene.arm.mass_damping, what)


def carrying(scene: Scene) -> Scene:
    """The scene with the base's mass at the root of link 0."""
    arm = scene.arm
    assert arm.base is not None
    first = dataclasses.replace(arm.links[0], root_mass=arm.links[0].root_mass + arm.base.mass)
    return dataclasses.replace(scene, arm=dataclasses.replace(arm, links=(first, *arm.links[1:])))


def places_of(system: System, moved: System) -> list[tuple[int, int]]:
    """Those of a System's pairs of rows that are places: all that a System of the same, moved elsewhere, has moved."""
    return [pair for pair in system.vectors if moved.q0[pair[0]] != system.q0[pair[0]]]


def _floating(scene: Scene, system: System, row: int, places: Sequence[tuple[int, int]]) -> Floating:
    """What a `Jointed` model knows of the base, whose attitude is at `row`."""
    arm = scene.arm
    assert arm.base is not None
    return Floating(
        row=row, inertia=arm.base.inertia, mass=arm.mass - arm.payload.mass + arm.base.mass,
        angles=np.array([*system.absolute, row], np.int64), vectors=np.array(system.vectors, np.int64).ravel(),
        places=np.array(places, np.int64).ravel(), room=(0,) * (row + 1),
    )  # fmt: skip


NOTHING = 1e-12
"""Of a hub: what stands for it where each arm has its own."""


def with_own_laws(system: System, hub: float) -> System:
    """A system whose arms have joints' laws of their own, behind their other parameters; hub: that is drawn, kg m^2."""
    model = system.model._replace(own=(0,) * len(system.par))
    if hub > 0.0 and model.table[PLACE.motor] >= 0:
        model = model._replace(data=model.data.copy(), hub=(0,))
        model.data[LAWS.hub] = NOTHING * hub
    return dataclasses.replace(system, model=model, par=np.concatenate([system.par, model.data]))


def _check_rotors(scene: Scene, elastic: list[int]) -> None:
    """Behind an elastic gear there must be something that moves, or something that moves it."""
    for k in elastic:
        joint = scene.arm.joint(k)
        if joint.rotor == 0.0 and scene.motion_of(f"motor{k}") is None:
            what = f'must be positive (kg m^2) behind an elastic gear, unless a motion prescribes "motor{k}"'
            raise check.InvalidValue(f"arm.joints[{k}].motor_inertia", joint.motor_inertia, what)


def _law(scene: Scene, k: int, row: int, motor: int) -> tuple[list[int], NDArray[np.float64]]:
    """The `PLACE` and the `LAW` of joint k, whose angle is at `row`, its motor's at `motor`."""
    joint = scene.arm.joint(k)
    on_motor = motor >= 0 and joint.friction_side == "motor"
    known = scene.motion_of(f"{'motor' if on_motor else 'joint'}{k}") is not None
    place = [k, row, motor, motor if on_motor else row, int(known)]
    assert len(place) == PLACES
    return place, LAW.pack(
        {}, stiffness=joint.stiffness if motor >= 0 else 0.0, damping=joint.damping, rotor=joint.rotor,
        viscous=joint.friction_viscous, coulomb=joint.friction_coulomb, play=0.5 * joint.backlash, hub=0.0,
    )  # fmt: skip


def _cautious(predictor: float | tuple[float, float] | None) -> float:
    """A Model's `predictor` that trusts no first increment: it may end on another flank than it began on."""
    return predictor[0] if isinstance(predictor, tuple) else 0.0 if predictor is None else predictor


def _longer(size: int | tuple[int, ...], more: int) -> int | tuple[int, ...]:
    """A size, or the tag of one, that is larger by so many."""
    return size + more if isinstance(size, int) else size + (0,) * more
