"""An arm's System and what turns its joints: the System of both."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.parameters import Arm
from flexarm_env.physics.joints.layout import GEAR, GEARS, LAW, PLACES
from flexarm_env.physics.model import Jointed, System
from flexarm_env.rigid import inertia_beyond
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings

LEAST = 1e-3
"""Of the inertia of the rigid arm beyond a joint, what friction there is taken to hold at least; beside the rotor's."""

NEAR = 0.02
"""Of that inertia, what a change of the joint's rate is taken to meet at once at least."""

PASSES = 3
"""How often accelerations are solved for where friction acts on a joint's own angle."""

HOLD = 1e10
"""A joint at rest by friction is held as if it had this many times that inertia."""


def jointed(scene: Scene, settings: Settings, system: System) -> System:
    """The system with what turns the arm's joints; itself where they are ideal.

    Raises:
        ValueError: frames joined by multipliers, or a motor without inertia that nothing prescribes.
    """
    arm = scene.arm
    if not arm.jointed:
        return system
    joints = [k for k in range(arm.n_links) if arm.joint(k).moves]
    if settings.multipliers:
        what = "must be False for an arm whose joints are not ideal; floating frames in a chain take them"
        raise check.InvalidValue("multipliers", True, what)
    inner, first = system.model, len(system.q0)
    elastic = [k for k in joints if arm.joint(k).elastic]
    motors = {k: first + i for i, k in enumerate(elastic)}
    _check_rotors(scene, elastic)
    count = len(motors)
    rows = [system.coordinates[f"joint{k}"] for k in joints]
    laws = [_law(scene, k, row, motors.get(k, -1)) for k, row in zip(joints, rows, strict=True)]
    more = GEARS.end + GEAR.end * len(joints)
    assert settings.dt is not None
    model = Jointed(
        n=_longer(inner.n, count),
        n_factor=_longer(inner.n_factor, more),
        n_inputs=inner.n_inputs,
        fixed=inner.fixed,
        algebraic=None,
        weight=np.concatenate([inner.weight, np.ones(count)]),
        predictor=inner.predictor,
        correction=inner.correction,
        bound=float(getattr(inner, "bound", 0.0)),
        arm=inner,
        table=np.array([place for place, _ in laws], np.int64).ravel(),
        data=np.concatenate([law for _, law in laws]),
        rough=_rough(arm),
        play=(0,) if any(joint.backlash > 0.0 for joint in arm.joints) else None,
        step=settings.dt,
    )
    wound = [scene.initial_value(f"motor{k}") for k in elastic]
    return dataclasses.replace(
        system,
        model=model,
        q0=np.concatenate([system.q0, wound]),
        v0=np.concatenate([system.v0, np.zeros(count)]),
        coordinates={**system.coordinates, **{f"motor{k}": row for k, row in motors.items()}},
        names=(*system.names, *(f"motor{k}" for k in elastic)),
    )


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
    place = [k, row, motor, int(on_motor), int(known)]
    assert len(place) == PLACES
    whole, rotor = inertia_beyond(scene.arm, k), 0.0 if motor >= 0 else joint.rotor
    own = scene.arm.elbow(k).inertia_right if k > 0 else scene.arm.hub_inertia
    least = LEAST * whole + rotor
    return place, LAW.pack(
        {}, stiffness=joint.stiffness if motor >= 0 else 0.0, damping=joint.damping, rotor=joint.rotor,
        viscous=joint.friction_viscous, coulomb=joint.friction_coulomb,
        near=max(own, NEAR * whole) + rotor, least=least,
        hold=HOLD * whole / least, play=0.5 * joint.backlash,
    )  # fmt: skip


def _longer(size: int | tuple[int, ...], more: int) -> int | tuple[int, ...]:
    """A size, or the tag of one, that is larger by so many."""
    return size + more if isinstance(size, int) else size + (0,) * more


def _rough(arm: Arm) -> tuple[int, ...] | None:
    """The tag of Coulomb friction, as long as accelerations are solved for: on a motor's side its row alone says what
    sticks."""
    sides = [joint.elastic and joint.friction_side == "motor" for joint in arm.joints if joint.friction_coulomb > 0.0]
    if not sides:
        return None
    return (0,) if all(sides) else (0,) * PASSES
