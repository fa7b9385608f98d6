"""Extract the serial chain of hinges from a compiled MuJoCo model; reject or list features that an arm cannot have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexarm_env import bodies
from flexarm_env import validation as check
from flexarm_env.validation import Array

HINGE, JOINT = 3, 0
"""MuJoCo's numbers of a hinge (mjtJoint), and of an actuator's transmission to a joint (mjtTrn)."""
BODY, JOINT_OBJECT, SITE = 1, 3, 6
"""MuJoCo's numbers of objects in an equality constraint (mjtObj)."""
KINDS = ("free", "ball", "slide", "hinge")


@dataclass(frozen=True)
class Part:
    """Rigid link of a chain and the joint at its root, in the ground's axes, with all joint angles 0.

    names: names of the link's bodies. joint: name of the joint. anchor (3,): point on the joint's axis, m. axis (3,):
    direction of the joint. mass: mass, kg. centre (3,): center of mass, m. inertia (3, 3): inertia tensor about the
    center of mass, kg m^2. limits: lower and upper joint angle, rad, or None. torque: torque limit, N m, or None.
    """

    names: tuple[str, ...]
    joint: str
    anchor: Array
    axis: Array
    mass: float
    centre: Array
    inertia: Array
    limits: tuple[float, float] | None
    torque: float | None
    armature: float
    damping: float
    friction: float


@dataclass(frozen=True)
class Serial:
    """A chain: its links from root to tip, the tip's position (3,), m, and the name of the body or site at the tip."""

    parts: tuple[Part, ...]
    tip: Array
    tip_name: str
    gravity: Array
    left_out: tuple[str, ...]


def serial(model: Any, root: str | None, tip: str | None) -> Serial:
    """Find the chain of a compiled model that begins in the body `root`.

    root: name of a body; None for the only chain with joints. tip: name of the body or site at the tip, or None.
    Raises:
        ValueError: the model has branches, loops, joints other than hinges, or springs at joints; the message names
            the element.
    """
    import mujoco

    gravity = np.array(check.numbers("option.gravity", model.opt.gravity.tolist(), "3 numbers", 3, "m/s^2"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    reader = _Reader(model, data)
    groups = reader.groups(reader.first(root))
    inside = {body for group in groups for body in group}
    reader.check_loops(inside)
    parts: list[Part] = []
    for group in groups:
        parts += reader.parts(group)
    place, name = reader.tip(groups[-1], tip, parts[-1])
    return Serial(tuple(parts), place, name, gravity, tuple(reader.left_out(inside)))


class _Reader:
    """Reader of a compiled model in its initial posture."""

    def __init__(self, model: Any, data: Any) -> None:
        self.model, self.data = model, data
        self.children: list[list[int]] = [[] for _ in range(model.nbody)]
        for body in range(1, model.nbody):
            self.children[int(model.body_parentid[body])].append(body)

    def name(self, body: int) -> str:
        """Return a body's name, or its number."""
        return self.model.body(body).name or f"body {body}"

    def moves(self, body: int) -> bool:
        """Return whether the body, or a body that it carries, has joints."""
        return bool(self.model.body_jntnum[body]) or any(self.moves(child) for child in self.children[body])

    def first(self, root: str | None) -> int:
        """Return the body in which the chain begins."""
        if root is not None:
            known = [self.name(body) for body in range(1, self.model.nbody)]
            if root not in known:
                raise check.UnknownKey(root, known, "body")
            body = 1 + known.index(root)
            if not self.moves(body):
                raise check.InvalidValue("root", root, "must be a body with joints, or before one")
            return body
        moving = [child for child in self.children[0] if self.moves(child)]
        if len(moving) != 1:
            names = ", ".join(self.name(body) for body in moving) or "none"
            what = f"must be one of the mechanisms of the file ({names})" if moving else "must have a joint"
            raise check.InvalidValue("root", root, what)
        return moving[0]

    def groups(self, first: int) -> list[list[int]]:
        """Return the bodies of each link, the body with the joint first; bodies fixed to the ground are omitted."""
        found: list[list[int]] = []
        body: int | None = first
        while body is not None:
            group, ahead = [body], list(self.children[body])
            behind = []
            while ahead:
                child = ahead.pop(0)
                if self.model.body_jntnum[child]:
                    behind.append(child)
                else:
                    group.append(child)
                    ahead += self.children[child]
            if len(behind) > 1:
                names = ", ".join(self.name(child) for child in behind)
                what = f"must carry one moving body: an arm is a serial chain without branches; it carries {names}"
                raise check.InvalidValue(f"body {self.name(body)}", len(behind), what)
            if self.model.body_jntnum[body]:
                found.append(group)
            body = behind[0] if behind else None
        return found

    def check_loops(self, inside: set[int]) -> None:
        """Reject tendons, and equality constraints on the chain's bodies, because such elements close loops or couple
        joints.
        """
        model = self.model
        of_body = {BODY: lambda i: i, JOINT_OBJECT: lambda i: int(model.jnt_bodyid[i]),
                   SITE: lambda i: int(model.site_bodyid[i])}  # fmt: skip
        for k in range(model.neq):
            ends = [int(i) for i in (model.eq_obj1id[k], model.eq_obj2id[k]) if i >= 0]
            place = of_body.get(int(model.eq_objtype[k]))
            if place is not None and not any(place(i) in inside for i in ends):
                continue
            name = model.eq(k).name or f"equality {k}"
            raise check.InvalidValue(name, "equality", "must not be there: an arm is a serial chain without loops")
        for k in range(model.ntendon):
            name = model.tendon(k).name or f"tendon {k}"
            raise check.InvalidValue(name, "tendon", "must not be there: joints of an arm have motors of their own")

    def parts(self, group: list[int]) -> list[Part]:
        """Return one link for each hinge of a group of fixed bodies; all links but the last are massless."""
        model, data, body = self.model, self.data, group[0]
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        found: list[Part] = []
        for j in joints:
            name = model.joint(j).name or f"joint {j}"
            kind = int(model.jnt_type[j])
            if kind != HINGE:
                what = "must be a hinge: an arm's joints turn about axes"
                raise check.InvalidValue(f"joint {name}", KINDS[kind], what)
            dof = int(model.jnt_dofadr[j])
            stiffness = [float(model.jnt_stiffness[j]), *np.ravel(model.jnt_stiffnesspoly[j]).tolist()]
            if any(stiffness):
                what = "must be 0: an arm's joints have no springs (N m/rad)"
                raise check.InvalidValue(f"joint {name}.stiffness", next(filter(None, stiffness)), what)
            if np.any(model.dof_dampingpoly[dof]):
                what = "must be one number (N m s/rad): an arm's joint friction is linear, with Coulomb friction"
                raise check.InvalidValue(f"joint {name}.damping", np.array(model.dof_dampingpoly[dof]), what)
            _check_span(f"joint {name}.range", model.jnt_range[j])
            _check_span(f"joint {name}.actuatorfrcrange", model.jnt_actfrcrange[j])
            zero = float(model.qpos0[model.jnt_qposadr[j]])
            low, high = (float(x) - zero for x in model.jnt_range[j])
            mass, centre, inertia = self.total(group if j == joints[-1] else [])
            found.append(Part(
                tuple(self.name(b) for b in group) if j == joints[-1] else (f"{self.name(body)}:{name}",), name,
                np.array(data.xanchor[j]), np.array(data.xaxis[j]), mass, centre, inertia,
                (low, high) if model.jnt_limited[j] else None, self.torque(j), float(model.dof_armature[dof]),
                float(model.dof_damping[dof]), float(model.dof_frictionloss[dof]),
            ))  # fmt: skip
        return found

    def total(self, group: list[int]) -> tuple[float, Array, Array]:
        """Return mass, center of mass, and inertia about the center, of bodies that are fixed to each other."""
        model, data = self.model, self.data
        masses = [float(model.body_mass[b]) for b in group]
        total = sum(masses)
        places = [np.array(data.xipos[b]) for b in group]
        if total == 0.0:
            return 0.0, np.array(data.xpos[group[0]]) if group else np.zeros(3), np.zeros((3, 3))
        centre = sum((m * p for m, p in zip(masses, places, strict=True)), np.zeros(3)) / total
        inertia = np.zeros((3, 3))
        for b, m, p in zip(group, masses, places, strict=True):
            R = data.ximat[b].reshape(3, 3)
            inertia += bodies.about(R @ np.diag(model.body_inertia[b]) @ R.T, m, p - centre)
        return total, centre, inertia

    def torque(self, j: int) -> float | None:
        """Return the torque limit of a joint, N m: the smaller of the joint's and the motor's limit; None: no limit."""
        model, limits = self.model, []
        name = model.joint(j).name or f"joint {j}"
        if model.jnt_actfrclimited[j]:
            limits.append(_least(f"joint {name}.actuatorfrcrange", model.jnt_actfrcrange[j]))
        motors = [a for a in range(model.nu) if model.actuator_trntype[a] == JOINT and model.actuator_trnid[a, 0] == j]
        if len(motors) > 1:
            raise check.InvalidValue(f"joint {name}", f"{len(motors)} actuators", "must have one motor at most")
        for a in motors:
            gear, motor = abs(float(model.actuator_gear[a, 0])), f"actuator {model.actuator(a).name or a}"
            _check_span(f"{motor}.forcerange", model.actuator_forcerange[a])
            _check_span(f"{motor}.ctrlrange", model.actuator_ctrlrange[a])
            if not gear > 0.0:
                raise check.InvalidValue(f"{motor}.gear", gear, "must be a number other than 0")
            if model.actuator_forcelimited[a]:
                limits.append(gear * _least(f"{motor}.forcerange", model.actuator_forcerange[a]))
            laws = (model.actuator_biastype[a], model.actuator_gaintype[a], model.actuator_dyntype[a])
            if not any(laws) and model.actuator_ctrllimited[a]:
                gain = abs(float(model.actuator_gainprm[a, 0]))
                limits.append(gear * gain * _least(f"{motor}.ctrlrange", model.actuator_ctrlrange[a]))
        return min(limits) if limits and min(limits) > 0.0 else None

    def tip(self, group: list[int], wanted: str | None, last: Part) -> tuple[Array, str]:
        """Return the tip's position, m, and its name."""
        model, data = self.model, self.data
        places = {self.name(b): np.array(data.xpos[b]) for b in group}
        for site in range(model.nsite):
            if int(model.site_bodyid[site]) in group and model.site(site).name:
                places[model.site(site).name] = np.array(data.site_xpos[site])
        if wanted is not None:
            if wanted not in places:
                raise check.UnknownKey(wanted, places, "body or site of the last link")
            return places[wanted], wanted
        far = max(places, key=lambda name: float(np.linalg.norm(places[name] - last.anchor)))
        if np.linalg.norm(places[far] - last.anchor) > 1e-9:
            return places[far], far
        return last.centre, ""

    def left_out(self, inside: set[int]) -> list[str]:
        """Return the names of the file's features that an arm does not have."""
        model, found = self.model, []
        if any(int(model.geom_bodyid[g]) in inside and (model.geom_contype[g] or model.geom_conaffinity[g])
               for g in range(model.ngeom)):  # fmt: skip
            found.append("contacts")
        outside = [self.name(b) for b in range(1, model.nbody) if b not in inside and model.body_mass[b] > 0.0]
        if outside:
            found.append(f"bodies {', '.join(outside)}")
        if model.opt.density or model.opt.viscosity or np.any(model.opt.wind):
            found.append("forces of a fluid")
        if np.any(model.body_gravcomp[list(inside)]):
            found.append("gravity compensation")
        for a in range(model.nu):
            if model.actuator_biastype[a] or model.actuator_dyntype[a] or model.actuator_damping[a]:
                name = model.actuator(a).name or f"actuator {a}"
                found.append(f"law of {name} (its torque limit is kept)")
        return found


def _check_span(path: str, span: Array) -> None:
    """Raise ValueError for a range whose ends do not increase, which MuJoCo would ignore; two zeros mean no range."""
    if np.any(span) and not span[0] < span[1]:
        raise check.InvalidValue(path, tuple(span.tolist()), "must increase")


def _least(path: str, span: Array) -> float:
    """Return the smaller absolute value of a range's two ends. Raises ValueError unless the range contains 0 in its
    interior.
    """
    low, high = map(float, span)
    if not low < 0.0 < high:
        raise check.InvalidValue(path, (low, high), "must reach from below 0 to above: an arm's motors turn both ways")
    return min(-low, high)
