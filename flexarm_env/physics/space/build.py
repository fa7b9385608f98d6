"""Build the Model of a scene in space: the chain's constants, and its coordinates and rates at the start."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import bodies, curves, rotations
from ... import validation as check
from ...bodies import Body, RigidLink, combined_body
from ...compiler import uncompiled
from ...parameters import Arm, Elbow, Joint, Link, Motor, Payload, Section, Taper
from ...rigid import axis_of, mount_of
from ...scene import InnerLoad, PointLoad, Scene
from ...sections import ACROSS, ENDS
from ...settings import Settings, default_options
from ..model import BEAM, Honours, System
from ..protocol import NewtonPolicy
from . import segments
from .chain import SpatialBeam
from .element import BOW
from .layout import AXES, BODY, ELEMENT, INNER, JOINT, LOAD, PLACE, B, E, F, H, hinge_at
from .segments import FRAME, LEAST_ROTARY, WEIGHT, Natural, W, points_for

Array = NDArray[np.float64]

HONOURS: Honours = {
    Arm: ("links", "hub_inertia", "hub_axis", "hub_mount", "elbows", "payload", "tau_d", "joints"),
    Link: ("length", "section", "tau_d", *ENDS, "curvature"),
    RigidLink: ("length", "mass", "centre", "inertia", "section", "tau_d", *ENDS, "curvature"),
    Section: ("EI", "EA", "C", "m", "J", *ACROSS),
    Taper: ("widths", "thicknesses", "E", "rho", "G", "kappa"),
    Elbow: ("mass", "inertia_left", "inertia_right", "axis", "mount"),
    Payload: ("mass", "inertia", "offset"),
    **{kind: BEAM[kind] for kind in (Joint, Motor)},
}
"""Parameters that chains in space take into account, listed by the class that has them (`model.Honours`)."""

# e_x, along the link, in section axes
X = np.array([1.0, 0.0, 0.0])

# strains kappa_x, kappa_y, kappa_z, section axes
AXES_OF_STRAINS = ("twist", "bend_y", "bend_z")


def packed(one: Body, there: bool = False) -> Array:
    """Pack a `Body` as a `BODY` record. Mark the record as existing if `there`, or if the body has mass or inertia."""
    there = there or one.mass > 0.0 or bool(np.any(one.inertia))
    return BODY.pack({}, mass=one.mass, there=there, centre=one.centre, inertia=one.inertia)


def count_elements(link: Link, settings: Settings) -> int:
    """Return the number of a link's elements, or of its segments if it has floating frames; 0 for a rigid link."""
    return 0 if link.rigid else (settings.elements or 1) * (settings.segments or 1)


def tip_lever(link: Link) -> Array:
    """Return the lever (m, section axes) from the link's last section to the next joint: along its rigid part."""
    return X * (link.length if link.rigid else link.tip_offset)


def tip_end(link: Link) -> Body:
    """Return a link's rigid end as a `Body` on the link's last section; its mass is at the middle of the rigid end."""
    return Body(link.tip_mass, 0.5 * tip_lever(link), bodies.tensor(link.tip_inertia))


def near_body(arm: Arm, k: int) -> Body:
    """Return the `Body` on the last section of link k - 1: its rigid end and the elbow's part fixed to that link."""
    before, elbow = arm.links[k - 1], arm.elbow(k)
    return combined_body([tip_end(before), Body(elbow.mass, tip_lever(before), bodies.tensor(elbow.inertia_left))])


def far_body(arm: Arm, k: int) -> Body:
    """Return the `Body` fixed to the root of link k: inertia of hub or elbow, plus the rigid link or its rigid root."""
    link = arm.links[k]
    own = arm.hub_inertia if k == 0 else arm.elbow(k).inertia_right
    parts = [Body(0.0, np.zeros(3), bodies.tensor(own))]
    if isinstance(link, RigidLink):
        parts.append(Body(link.mass, np.array(link.centre), bodies.tensor(link.inertia)))
    else:
        parts.append(Body(link.root_mass, -0.5 * link.root_offset * X, bodies.tensor(link.root_inertia)))
    return combined_body(parts)


def flags(found: Iterable[Any]) -> NDArray[np.int64] | None:
    """Return an int64 array with 1 for each true item, or None if none is true."""
    flagged = np.array([int(one) for one in found], np.int64)
    return flagged if flagged.any() else None


def levers(arm: Arm, k: int) -> tuple[Array, Array]:
    """Return two levers (m) at joint k: from link k - 1 to the joint, and from the joint to link k.

    The first lever leads from the last section of link k - 1 to the joint, in that section's axes. The second lever
    leads from the joint to the first section of link k, in the axes of the root of link k.
    """
    return np.zeros(3) if k == 0 else tip_lever(arm.links[k - 1]), arm.links[k].root_offset * X


def _joint(arm: Arm, k: int) -> Array:
    """Pack the `JOINT` record of joint k: axis, mount, levers, and the bodies on both sides."""
    mount = mount_of(arm, k)
    before, beyond = levers(arm, k)
    near = combined_body([]) if k == 0 else near_body(arm, k)
    return JOINT.pack(
        {}, axis=axis_of(arm, k), mount=mount, quaternion=rotations.quaternions(mount), before=before, beyond=beyond,
        near=packed(near), far=packed(far_body(arm, k)),
    )  # fmt: skip


GAUSS = np.polynomial.legendre.leggauss(4)
"""Nodes and weights of the Gauss rule over which an element's stiffnesses are averaged."""


def _elements(link: Link, n: int, damping: float) -> list[Array]:
    """Pack the n `ELEMENT` records of a link: harmonic means of the stiffnesses, masses by Simpson's rule.

    damping: the link's share of the arm's largest Kelvin-Voigt time constant.
    """
    if n == 0:
        return []
    ends = link.mesh(n, "elements")
    lengths, turns, chords = np.diff(ends), turns_of(link, ends), chords_of(link, ends)
    x, share = GAUSS[0], 0.5 * GAUSS[1]
    inner = ends[:-1, None] + 0.5 * lengths[:, None] * (1.0 + x)
    plane, across = link.along(inner), link.across(inner)
    every = {**{name: getattr(plane, name) for name in ("EI", "EA", "C")}, **across}
    # harmonic means; tilt a = int x/EI / int 1/EI over l; second: int (x/l - a)^2 / EI
    series = {name: 1.0 / ((1.0 / values) @ share) for name, values in every.items() if name != "J_y"}
    tilt = {name: series[name] * ((1.0 / every[name]) @ (0.5 * x * share)) for name in ("EI_y", "EI")}
    second = {name: (0.5 * x - tilt[name][:, None]) ** 2 / every[name] @ share for name in tilt}
    # Simpson's rule: 1/6, 4/6, 1/6 of the mass per length at both ends and the middle
    thirds = [link.along(ends[:-1]).m, 4.0 * link.along(0.5 * (ends[1:] + ends[:-1])).m, link.along(ends[1:], True).m]
    masses = np.array(thirds).T * lengths[:, None] / 6.0
    J, J_y = plane.J @ share, across["J_y"] @ share
    rows = []
    for e, length in enumerate(lengths.tolist()):
        # J about x, y, z (section axes), at least LEAST_ROTARY m l^2: ends of elements rotate by J alone
        rotary = np.maximum([J[e] + J_y[e], J_y[e], J[e]], LEAST_ROTARY * masses[e].sum() * length)
        tilts = np.array([tilt["EI_y"][e], tilt["EI"][e]])
        rows.append(
            ELEMENT.pack(
                {}, length=length, mass=masses[e], inertia=0.5 * length * rotary, EA=series["EA"][e],
                shear=[1.0 / series[name][e] for name in ("C", "C_y")],
                bow=[length**2 * second[name][e] for name in ("EI", "EI_y")],
                EI=[series["GJ"][e], series["EI_y"][e], series["EI"][e]], rest=[0.0, 0.0, turns[e]],
                chord=chords[e] + [0.0, tilts[1] * turns[e], 0.0], tilt=tilts, damping=damping,
            )
        )  # fmt: skip
    return rows


def chords_of(link: Link, ends: Array) -> Array:
    """Return (elements, 3): each element's stress-free chord vector minus that of a circular arc, over the length."""
    found = np.zeros((len(ends) - 1, 3))
    if link.curved:
        angles = curves.angle(link.curvature, ends)
        middle = 0.5 * (angles[1:] + angles[:-1])
        # chord - e_x + bow as a complex number x + i y, axes of the mean tangent
        chord = np.diff(curves.place(link.curvature, ends)) / np.diff(ends) * np.exp(-1j * middle)
        found[:, 0], found[:, 1] = chord.real - 1.0 + BOW * np.diff(angles) ** 2, chord.imag
    return found


def turns_of(link: Link, ends: Array) -> Array:
    """Return the angles (rad) by which the elements between `ends` (m) are bent without stress."""
    return np.diff(curves.angle(link.curvature, ends))


def polynomials(settings: Settings) -> int:
    """Return the number of polynomials that represent each strain of a link of the elastica: `settings.nodes` - 1."""
    assert settings.nodes is not None
    return settings.nodes - 1


def count_rows(link: Link | RigidLink, settings: Settings) -> int:
    """Return the number of a link's coordinates, without the angle of the joint at its root."""
    if settings.formulation == "elastica":
        return 0 if link.rigid else 3 * polynomials(settings)
    return AXES * max(1, count_elements(link, settings))


def names_of(arm: Arm, settings: Settings) -> tuple[str, ...]:
    """Return the names of all coordinates of the arm: base, joints, vertices or strains, and inner modes.

    Vertices are numbered E = 1, 2, ... along each link.
    """
    places, inner = ("x", "y", "z", "rx", "ry", "rz"), range(1, inner_modes(settings) + 1)
    own = AXES_OF_STRAINS if settings.formulation == "elastica" else places
    found = [f"root_{name}" for name in places]
    for k, link in enumerate(arm.links):
        found.append(f"joint{k}")
        found += [f"link{k}.{name}{e + 1}" for e in range(count_rows(link, settings) // len(own)) for name in own]
    for k, link in enumerate(arm.links):
        modes = [f"mode{i}{axis}" for i in inner for axis in "xyz"]
        found += [f"link{k}.{name}_{e + 1}" for e in range(count_elements(link, settings)) for name in modes]
    return tuple(found)


def inner_modes(settings: Settings) -> int:
    """Return the number of inner modes of a segment about each axis: `settings.modes` minus the two static shapes."""
    return (settings.modes or 2) - 2


def _natural(link: Link, n: int, settings: Settings) -> list[Natural]:
    """Return the stress-free shape (`Natural`) of each element or segment of a link; zeros for a rigid link."""
    if n == 0:
        return [Natural(0.0, 0.0, 0.0)]
    if settings.formulation == "floating_frame":
        return [natural for _, natural in segments.frames(link, n, settings.modes)]
    ends = link.mesh(n, "elements")
    found = []
    for length, turn, own in zip(np.diff(ends), turns_of(link, ends), chords_of(link, ends), strict=True):
        # stress-free chord over length, in the axes of the middle; aside: its angle
        chord = complex(1.0 - BOW * turn**2 + own[0], own[1])
        aside = math.atan2(chord.imag, chord.real)
        found.append(Natural(0.5 * turn + aside, length * abs(chord), 0.5 * turn - aside))
    return found


def _start(scene: Scene, settings: Settings) -> tuple[Array, Array]:
    """Return q and v at t = 0: links are free of stress, with the scene's joint angles and initial rates."""
    arm = scene.arm
    # r, A, v, w of the current section: r, v, w in inertial axes, A from section to inertial axes
    r, A = np.array(scene.position), np.eye(3)
    rate, spin = np.array(scene.velocity), np.zeros(3)
    # a free base turns with link 0: joint 0 is fixed, and w = rate * axis
    if scene.root == "free":
        spin = scene.rates[0] * (mount_of(arm, 0) @ axis_of(arm, 0))
    q, v = [*r, 0.0, 0.0, 0.0], [*rate, *spin]
    # theta' = w_k - w_(k-1): planar scenes give the links' absolute rates
    before_rate = 0.0
    inner: list[float] = []
    for k, link in enumerate(arm.links):
        near, far = levers(arm, k)
        joint = scene.initial_value(f"joint{k}")
        own = scene.rates[k] if arm.spatial else scene.rates[k] - before_rate
        if k == 0 and scene.root == "free":
            own = 0.0
        before_rate = scene.rates[k]
        # eq. (9.1) without accelerations: lever t before the joint, E = mount exp(axis theta), lever o behind it
        arm_of = A @ near
        A = A @ mount_of(arm, k) @ rotations.matrices(joint * axis_of(arm, k))
        r, rate = r + arm_of, rate + np.cross(spin, arm_of)
        spin = spin + own * A @ axis_of(arm, k)
        arm_of = A @ far
        r, rate = r + arm_of, rate + np.cross(spin, arm_of)
        q.append(joint)
        v.append(own)
        if settings.formulation == "elastica":
            q += [0.0] * count_rows(link, settings)
            v += [0.0] * count_rows(link, settings)
            continue
        # turn by psi/2 to the chord, move by its length along e_x, turn by psi/2 to the right section
        for natural in _natural(link, count_elements(link, settings), settings):
            A = A @ rotations.matrices([0.0, 0.0, natural.near])
            step = A @ (natural.length * X)
            A = A @ rotations.matrices([0.0, 0.0, natural.far])
            inner += natural.inner
            r, rate = r + step, rate + np.cross(spin, step)
            q += [*r, *rotations.vectors(A)]
            v += [*rate, *A.T @ spin]
    return np.array([*q, *inner]), np.array([*v, *np.zeros(len(inner))])


def _check_inertia(arm: Arm) -> None:
    """Raise `InvalidValue` if a rigid last link, with its payload, has no inertia: its motion would be undetermined."""
    k = arm.n_links - 1
    far, own, payload = far_body(arm, k), arm.links[k], arm.payload
    beyond = payload.mass + float(np.trace(bodies.tensor(payload.inertia)))
    if own.rigid and far.mass + float(np.trace(far.inertia)) + beyond == 0.0:
        what = "must be positive (kg), or the payload must have a mass: nothing there has any inertia"
        raise check.InvalidValue(f"links[{k}].mass", 0.0, what)


def _beams(sections: list[Array], frames: list[Array], inner: int) -> float:
    """Return the total mass (kg) of all elements or segments, given their packed records."""
    count, weight = points_for(inner), WEIGHT.offsets(0, inner).end
    points = [FRAME.offsets(0, inner, count).points + weight * p + W.mass for p in range(count)]
    if frames:
        return float(sum(row[points].sum() for row in frames))
    return float(sum(row[E.mass : E.mass + 3].sum() for row in sections))


def _loads(scene: Scene, settings: Settings) -> list[Array]:
    """Pack a `LOAD` for each point load of the scene."""
    found = []
    for load in scene.loads:
        if isinstance(load, PointLoad):
            at_tip, link = load.end == "tip", scene.arm.links[load.link]
            section, lever = float(at_tip), tip_lever(link) if at_tip else -link.root_offset * X
            if isinstance(load, InnerLoad):
                # vertex e is at the end of element e
                section, lever = 1.0 + load.elements_before(count_elements(link, settings)), 0.0 * X
            found.append(LOAD.pack({}, link=load.link, section=section, lever=lever))
    return found


def check_scene(scene: Scene, settings: Settings) -> None:
    """Raise `InvalidValue` for settings and parameters that no chain in space supports."""
    if settings.period_correction:
        raise check.InvalidValue("period_correction", True, "must be False in space")
    if settings.step_tolerance is not None:
        raise check.InvalidValue("step_tolerance", settings.step_tolerance, "must not be given in space")
    arm = scene.arm
    if arm.total_length == 0.0:
        raise check.InvalidValue("links[0].length", 0.0, "must be positive (m): the arm has no length at all")
    _check_inertia(arm)
    for k, link in enumerate(arm.links):
        if not link.rigid:
            with check.under(f"links[{k}]"):
                link.across(np.zeros(1))


def system(
    scene: Scene, settings: Settings, kind: Any, beams: float, rooms: list[int], notes: dict[str, float], **own: Any
) -> System:
    """Assemble the `System` of a scene: Model, parameters, initial state, names of coordinates.

    kind: class of the Model.
    beams: total mass of the flexible links, kg.
    rooms: for each link, and for the data behind all links, the number of entries of S.
    notes: error estimates by name.
    own: further fields of the Model, which depend on the kind of links.
    """
    arm, loads, names = scene.arm, _loads(scene, settings), names_of(scene.arm, settings)
    row, first, places, weight = AXES, B.end + H.end * arm.n_links, [], np.ones(len(names))
    # row, number of elements and offset in S of each link; weight: 1/L for places, 1 for angles, 0 for rows of rigid
    # links, which never move
    weight[:3] = 1.0 / arm.total_length
    for link, room in zip(arm.links, rooms, strict=False):
        places.append(PLACE.pack({}, row=row, elements=count_elements(link, settings), factor=first))
        end = row + 1 + count_rows(link, settings)
        if settings.formulation != "elastica":
            for i in range(row + 1, end, AXES):
                weight[i : i + 3] = 1.0 / arm.total_length
            if link.rigid:
                weight[row + 1 : end] = 0.0
        row, first = end, first + room
    places.append(PLACE.pack({}, row=row, elements=0, factor=first))
    # fixed: rigid joints; of a free root joint 0, because the base rotates, otherwise the base unless prescribed
    fixed = [names.index(f"joint{k}") for k in scene.rigid_joints]
    if scene.root == "free":
        fixed.append(names.index("joint0"))
    else:
        fixed += [i for i in range(AXES) if scene.motion_of(names[i]) is None]
    offset = np.array((*arm.payload.offset, 0.0)[:3])
    near = [near_body(arm, k).mass for k in range(1, arm.n_links)] + [tip_end(arm.links[-1]).mass]
    mass = float(beams + sum(near) + sum(far_body(arm, k).mass for k in range(arm.n_links)))
    model = kind(
        n=len(names),
        n_factor=first + rooms[-1],
        n_inputs=arm.n_links + 6 * len(loads),
        fixed=np.array(sorted(fixed), np.int64),
        algebraic=None,
        weight=weight,
        links=arm.n_links,
        places=np.concatenate(places).astype(np.int64),
        joints=np.concatenate([_joint(arm, k) for k in range(arm.n_links)]),
        end=packed(tip_end(arm.links[-1])),
        payload=packed(Body(0.0, tip_lever(arm.links[-1]) + offset, bodies.tensor(arm.payload.inertia)), True),
        mounts=flags(np.any(mount_of(arm, k) != np.eye(3)) for k in range(arm.n_links)),
        levers=flags(np.any(levers(arm, k)) for k in range(arm.n_links)),
        gravity=None if scene.gravity is None else np.array(scene.gravity),
        loads=np.concatenate(loads) if loads else None,
        damped=(0,) if arm.damping[0] > 0.0 else None,
        rotors=_rotors(arm),
        free=mass if scene.root == "free" else None,
        inside=(0,) if any(isinstance(load, InnerLoad) for load in scene.loads) else None,
        **own,
    )
    # par: m_p (kg), factors of payload inertia and EI, tau_d (s), factors of EI_y and GJ
    par = np.array([arm.payload.mass, 1.0, 1.0, arm.damping[0], 1.0, 1.0])
    coordinates = {name: i for i, name in enumerate(names) if name.startswith(("root_", "joint"))}
    return System(model, par, *_start(scene, settings), coordinates, names, (), (), notes)


def _rotors(arm: Arm) -> NDArray[np.int64] | None:
    """Return the offset in S of each joint's rotor record (`physics.layout.ROTOR`); None if no joint has a rotor.

    The offset of a joint without a rotor is negative.
    """
    places = [uncompiled(hinge_at)(k) + H.rotor for k in range(arm.n_links)]
    at = np.array([place if arm.joint(k).rotor > 0.0 else -place for k, place in enumerate(places)], np.int64)
    return at if any(at > 0) else None


MAX_INCREMENT = 0.05
"""Largest increment of a Newton iteration: rad for rotations, fractions of the arm's length for positions. In whipping
arms the iteration starts far from the solution. Larger increments would leave the range in which the tangent is
valid."""

TANGENT_ERROR = 1e-2
"""Largest accepted relative error of Newton's matrix. The error measured at up to 35 rad/s in steps of 2.5 ms is a
third of this value. For exact beams the first Newton increment reduces the error to its square. The matrix of a
floating frame neglects this fraction of the inertia terms, and in short steps only the inertia terms matter."""


def build(scene: Scene, settings: Settings) -> System:
    """Build the `System` of a scene with exact beams or floating frames; each element or segment has two vertices."""
    floating = settings.formulation == "floating_frame"
    if floating:
        segments.refuse(settings)
    elif settings.order != default_options("geometrically_exact")["order"]:
        raise check.InvalidValue("order", settings.order, "must not be given in space, where elements are of one kind")
    arm, (_, shares) = scene.arm, scene.arm.damping
    counts = [count_elements(link, settings) for link in arm.links]
    sections: list[Array] = []
    frames: list[Array] = []
    for k, (link, n) in enumerate(zip(arm.links, counts, strict=True)):
        sections += _elements(link, n, 1.0 if shares is None else shares[k])
        frames += [packed for packed, _ in segments.frames(link, n, settings.modes)] if floating else []
    # S: a `FACTOR` per element (one for a rigid link), then the inner modes' `INNER` records, whose size depends on n
    inner = inner_modes(settings)
    rooms = [F.end * max(1, n) for n in counts] + [INNER.offsets(0, inner).end * sum(counts)]
    return system(
        scene, settings, SpatialBeam, _beams(sections, frames, inner), rooms, {},
        newton=NewtonPolicy(
            first_error=10.0, predicts=(0,), max_increment=MAX_INCREMENT,
            tangent_error=(TANGENT_ERROR if floating else 0.0, TANGENT_ERROR),
            # i = 2, j = 3: the second matrix belongs to a state near the step's end and serves two more iterations
            reuse=((0,) * 2, (0,) * 3), rotations=(0,),
            # ends of elements rotate by their sections' rotary inertia alone
            light_joints=(0,),
        ),
        sections=np.concatenate([np.zeros(0), *sections]),
        frames=np.concatenate([np.zeros(0), *frames]) if floating else None,
        inner=(0,) * inner or None,
        uneven=None if floating or all(link.rigid or link.uniform is not None for link in arm.links) else (0,),
    )  # fmt: skip
