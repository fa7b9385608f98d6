"""Every feature of an arm or a scene, alone and in pairs, on a bent arm: what the formulations make of it.

A cell is a scene with one or two features under one formulation. It is held against the exact beam on a fine mesh with
short steps, which shares neither coordinates nor strain measures with the floating frame and the elastica. Arms are
bent by a fifth of their length and more (links reduced to modes as a whole: by a tenth at most).

``python -m tests.feature_matrix`` prints all cells, the worst last.
"""

import dataclasses
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from flexarm_env.linear import modes
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scene import JointTorque, Load, Motion, PointLoad, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant, cycloid, pulse, sine, spin_up
from flexarm_env.trajectory import Trajectory
from tests.scene_tools import tips_apart

DURATION, SAMPLE = 1.0, 0.01
REFERENCE = {"elements": 24, "order": 2, "dt": 2.5e-4, "rho_inf": 0.9}
"""Options of the exact beam that the others are held against, elements in all links together."""


STRIP = Section(2.0, 2e6, 7e5, 0.3, 1e-7)


@dataclass
class Draft:
    """A scene in the making; `scale` is what drives it times that of the scenes that bend by a fifth."""

    scale: float
    links: int = 1
    tau_d: float = 2e-3
    payload: Payload = field(default_factory=lambda: Payload(0.1, 1e-5))
    elbow: Elbow = field(default_factory=lambda: Elbow(0.05, 1e-5, 1e-5))
    root: str = "pinned"
    angles: tuple[float, ...] = ()
    rigid: tuple[int, ...] = ()
    gravity: float = 0.0
    joint: Joint = field(default_factory=Joint)
    drive: bool = True  # by the joints' torques
    link: Callable[[float], Link] = field(default=lambda length: Link(length, STRIP))  # of a length
    motions: list[Motion] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    shared: bool = False  # what `NOT_JOINED` has, by next to nothing where it is not asked for; joints stay ideal

    def scene(self) -> Scene:
        """The scene. One link of 1 m, or two of 0.6 and 0.4 m, of a strip that a fly could bend."""
        lengths = (1.0,) if self.links == 1 else (0.6, 0.4)
        links, payload, joint = [self.link(length) for length in lengths], self.payload, self.joint
        if self.shared:
            links = alike(links)
            payload = dataclasses.replace(payload, offset=payload.offset if any(payload.offset) else (0.0, 1e-12))
            if joint != Joint():
                joint = dataclasses.replace(joint, friction_coulomb=joint.friction_coulomb or 1e-12)
        arm = Arm(
            "cell", tuple(links), hub_inertia=0.02, elbows=(self.elbow,) * (self.links - 1), payload=payload,
            tau_d=self.tau_d, joints=(joint,) * len(links),
        )  # fmt: skip
        held = {motion.joint for motion in self.motions}
        # with a kink at a sample, so that cells share one form
        nothing = PointLoad(self.links - 1, "tip", force_y=pulse(1e-300, DURATION - SAMPLE))
        loads = [*self.loads, nothing]
        if self.drive and self.root == "pinned":
            torques = (3.4, 1.6) if self.links == 2 else (2.6,)
            loads += [
                JointTorque(k, sine(torque * self.scale, 2.0 * math.pi))
                for k, torque in enumerate(torques)
                if k not in held and k not in self.rigid
            ]
        return Scene(
            "cell", arm, duration=DURATION, dt=1e-3, sample=SAMPLE, root=self.root, angles=self.angles,
            rigid_joints=self.rigid, motions=tuple(self.motions), loads=tuple(loads),
            gravity=(0.0, -9.81 * self.gravity * self.scale),
        )  # fmt: skip


def alike(links: list[Link]) -> list[Link]:
    """The links with a rigid end and a curvature of next to nothing where they have none."""
    return [
        dataclasses.replace(link, root_offset=link.root_offset or 1e-12, curvature=link.curvature or 1e-12)
        for link in links
    ]


def _two(d: Draft) -> None:
    d.links = 2
    d.angles = d.angles or (0.0, 0.0)


def _elbow_masses(d: Draft) -> None:
    _two(d)
    d.elbow = Elbow(0.2, 2e-3, 1e-3)


def _spin(d: Draft) -> None:
    d.motions.append(Motion("joint0", spin_up(5.5 * d.scale, 0.9)))
    d.loads.append(PointLoad(d.links - 1, "tip", force_y=sine(0.8 * d.scale, 3.0 * math.pi)))


def _prescribed_elbow(d: Draft) -> None:
    _two(d)
    d.motions.append(Motion("joint1", cycloid(1.9 * d.scale, 0.5)))


def _rigid_elbow(d: Draft) -> None:
    _two(d)
    d.angles, d.rigid = (0.0, 0.7), (1,)


def _tip_load(d: Draft) -> None:
    load = sine(0.6 * d.scale, 5.0), sine(1.5 * d.scale, 2.0 * math.pi), sine(0.05 * d.scale, 4.0)
    d.loads.append(PointLoad(d.links - 1, "tip", *load))


def _free_flight(d: Draft) -> None:
    d.root = "free"
    load = sine(4.0 * d.scale, 3.0), sine(9.0 * d.scale, 2.0 * math.pi), sine(-3.0 * d.scale, 2.0 * math.pi)
    d.loads.append(PointLoad(0, "root", *load))


def _stepped(d: Draft) -> None:
    """A strip that goes on thinner from three fifths of its length, and thinner still towards its tip."""
    thin = Section(1.4, 1.6e6, 5.6e5, 0.25, 8e-8)
    end = Section(0.9, 1.3e6, 4.5e5, 0.2, 6e-8)
    d.link = lambda length: Link(length, [(0.0, STRIP), (0.6 * length, STRIP), (0.6 * length, thin), (length, end)])


def _own_damping(d: Draft) -> None:
    """Links damped unlike; of two the second one hardly."""
    made, taus = d.link, iter((8e-3, 5e-4))
    d.link = lambda length: dataclasses.replace(made(length), tau_d=next(taus))


def _rigid_ends(d: Draft) -> None:
    """A clamp of some mass at each end of each link, the hub's radius among them."""
    made = d.link
    masses = {"root_mass": 0.04, "root_inertia": 2e-5, "tip_mass": 0.03, "tip_inertia": 1e-5}
    d.link = lambda length: dataclasses.replace(
        made(0.85 * length), root_offset=0.1 * length, tip_offset=0.05 * length, **masses
    )


def sets(**values: Any) -> Callable[[Any], None]:
    """Fields of a draft."""
    return lambda d: vars(d).update(values)


def changed(change: Callable[[float, Link], Link]) -> Callable[[Any], None]:
    """What a draft's links are made into, by their length and as they were."""

    def feature(d: Any) -> None:
        made = d.link
        d.link = lambda length: change(length, made(length))

    return feature


curved = changed(lambda length, link: dataclasses.replace(link, curvature=((0.0, 1.6), (length, 0.4))))
"""Links that are bent without stress, by a radian together."""


def _moves(*motions: Callable[[Draft], Motion]) -> Callable[[Draft], None]:
    return lambda d: d.motions.extend([motion(d) for motion in motions])


FEATURES: dict[str, Callable[[Draft], None]] = {
    "hub torque": sets(),
    "light damping": sets(tau_d=2e-4),
    "heavy damping": sets(tau_d=0.05),  # the first mode has a ratio of about 0.2, the second is overdamped
    "gravity": sets(gravity=1.0),
    "payload inertia": sets(payload=Payload(0.1, 4e-3)),
    "eccentric payload": sets(payload=Payload(0.1, 2e-4, (0.05, 0.08))),
    "elbow masses": _elbow_masses,
    "spin": _spin,
    "shaken base": _moves(
        lambda d: Motion("root_x", cycloid(0.15 * d.scale, 0.3)),
        lambda d: Motion("root_y", cycloid(0.4 * d.scale, 0.25)),
    ),
    "jolted base": _moves(lambda d: Motion("root_y", sine(0.08 * d.scale, 17.0))),
    "prescribed elbow": _prescribed_elbow,
    "rigid elbow": _rigid_elbow,
    "held hub": _moves(lambda d: Motion("joint0", constant(d.angles[0] if d.angles else 0.0))),
    "tip load": _tip_load,
    "root load": lambda d: d.loads.append(PointLoad(0, "root", torque=sine(0.8 * d.scale, 4.0 * math.pi))),
    "free flight": _free_flight,
    "tapered": changed(  # half as thick at its tip as at its root
        lambda length, _: Link.tapered(length, (0.02, 0.015), (6.5e-3, 3.25e-3), E=7e9, rho=2700.0, G=2.6e9)
    ),
    "stepped": _stepped,
    "own damping": _own_damping,
    "rigid ends": _rigid_ends,
    "curved": curved,
    "elastic gears": sets(joint=Joint(stiffness=25.0, damping=0.03, motor_inertia=1e-4, gear_ratio=10.0)),
    "friction": lambda d: sets(
        joint=Joint(motor_inertia=1e-4, gear_ratio=10.0, friction_viscous=0.05, friction_coulomb=0.2 * d.scale)
    )(d),
}
"""A feature is a change of the draft. Those that make two links come before those that prescribe or load them."""

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "exact": ("geometrically_exact", {"elements": 8, "dt": 5e-4}),
    "elastica": ("elastica", {"nodes": 8}),
    "segments": ("floating_frame", {"segments": 8}),
    "modes in segments": ("floating_frame", {"segments": 5, "modes": 2}),
    "modes": ("floating_frame", {"modes": 3}),
    "clamped segments": ("floating_frame", {"segments": 12, "frame": "root"}),  # 8: 0.3 % where a bent link flies
    "joined segments": ("floating_frame", {"segments": 8, "multipliers": True}),
    "clamped modes": ("floating_frame", {"modes": 3, "frame": "root"}),
    "exact, fine": ("geometrically_exact", {"elements": 12}),
    "paper": ("floating_frame", {"segments": 8, "coupling": "paper"}),
    "linear": ("floating_frame", {"segments": 8, "coupling": "linear"}),
}
TIP = {
    "exact": 3e-4, "elastica": 3e-4, "segments": 1.5e-3, "modes in segments": 3e-3, "modes": 3e-3,
    "clamped segments": 1.5e-3, "joined segments": 1.5e-3, "clamped modes": 3e-3,
}  # fmt: skip
"""Largest distance of the tip from the reference's over the arm's length, for the formulations that are held to it."""
TORQUE, DISSIPATED, BALANCE, RATIO = 0.02, 0.03, 0.02, 0.1
"""Largest relative errors: of the torques that enforce motions, of what is dissipated, of the energy's balance as a
share of what was turned over, and of the first mode's damping ratio about a bent posture."""
GAUGE = {
    "exact": 0.02, "elastica": 0.02, "segments": 0.03, "modes in segments": 0.05, "modes": 0.08,
    "clamped segments": 0.03, "joined segments": 0.03, "clamped modes": 0.08,
}  # fmt: skip
"""Largest difference of what strain gauges at a quarter of each link read, over the most that any of them reads."""
FRONTS = ("jolted base",)
"""A jump of the root's velocity sends waves that no mesh has an end to; what light damping takes of those, and what any
takes from a few modes, is the mesh's own: dissipation is then held for heavy damping of full models alone."""
LARGE, SMALL = 0.6, 0.12
"""What drives the scenes, so that arms are bent by a fifth of L and more; those of links reduced to modes."""

SINGLE = [(name,) for name in FEATURES if name != "held hub"]
PAIRS = [
    ("heavy damping", "gravity"), ("heavy damping", "payload inertia"), ("elbow masses", "heavy damping"),
    ("heavy damping", "spin"), ("heavy damping", "shaken base"), ("heavy damping", "jolted base"),
    ("heavy damping", "prescribed elbow"), ("rigid elbow", "heavy damping"), ("heavy damping", "tip load"),
    ("heavy damping", "root load"), ("heavy damping", "free flight"), ("light damping", "jolted base"),
    ("light damping", "spin"), ("light damping", "tip load"), ("gravity", "payload inertia"),
    ("gravity", "elbow masses"), ("gravity", "shaken base"), ("gravity", "prescribed elbow"),
    ("gravity", "rigid elbow"), ("gravity", "tip load"), ("gravity", "held hub"),
    ("elbow masses", "prescribed elbow"), ("elbow masses", "shaken base"), ("elbow masses", "tip load"),
    ("elbow masses", "free flight"), ("rigid elbow", "free flight"), ("rigid elbow", "spin"),
    ("payload inertia", "spin"), ("payload inertia", "shaken base"), ("held hub", "tip load"),
    ("tapered", "elbow masses"), ("stepped", "elbow masses"), ("stepped", "free flight"),
    ("elbow masses", "own damping"), ("prescribed elbow", "own damping"), ("rigid ends", "elbow masses"),
    ("tapered", "rigid ends", "prescribed elbow"), ("rigid ends", "free flight"), ("rigid ends", "tip load"),
    ("rigid ends", "gravity", "payload inertia"), ("rigid ends", "rigid elbow"), ("rigid ends", "shaken base"),
    ("rigid ends", "elbow masses", "elastic gears"), ("elbow masses", "elastic gears"),
    ("elbow masses", "friction"), ("curved", "gravity"), ("curved", "elbow masses", "elastic gears"),
    ("curved", "free flight"), ("eccentric payload", "gravity"), ("eccentric payload", "free flight"),
    ("rigid ends", "eccentric payload", "elbow masses", "elastic gears"), ("elastic gears", "gravity"),
    ("elastic gears", "tip load"), ("elastic gears", "held hub", "tip load"),
]  # fmt: skip
CORE = [
    ("heavy damping",), ("heavy damping", "gravity"), ("elbow masses", "heavy damping"),
    ("heavy damping", "spin"), ("heavy damping", "jolted base"), ("gravity", "prescribed elbow"),
    ("rigid elbow", "free flight"), ("payload inertia", "shaken base"),
]  # fmt: skip
"""Features of the cells that every run of the tests looks at, under each formulation as it is by default."""
VARYING = ("tapered", "rigid ends", "prescribed elbow")
"""The same under one formulation: what an arm is made of has kernels of its own, which take long to compile."""
JOINED = ("joined segments",)
NOT_JOINED = {"elastic gears", "friction", "rigid ends", "eccentric payload", "curved"}
"""Frames joined by multipliers take none of these. Cells with one of them share a compiled form: `Draft.shared`."""
WHOLE = ("modes", "clamped modes")
"""Links reduced as a whole."""


def name_of(features: tuple[str, ...]) -> str:
    """A cell's name."""
    return " + ".join(features)


def scene_of(features: tuple[str, ...], scale: float = 1.0) -> Scene:
    """The scene with these features."""
    draft = Draft(scale, shared=bool(NOT_JOINED & {*features}))
    for name in features:
        FEATURES[name](draft)
    return draft.scene()


@cache
def reference(features: tuple[str, ...], scale: float) -> Trajectory:
    """The converged exact beam."""
    scene = scene_of(features, scale)
    options = REFERENCE | {"elements": REFERENCE["elements"] // scene.arm.n_links}
    return simulate(scene, "geometrically_exact", estimate_error=False, **options)


def measure(features: tuple[str, ...], method: str) -> dict[str, float]:
    """How far a cell is off: tip (of L), torque, dissipated, balance, gauges (relative), and how far it is bent.

    nan where the run did not come to its end; torque 0 where no motion is prescribed.
    """
    scale = SMALL if method in WHOLE else LARGE
    other = reference(features, scale)
    formulation, options = METHODS[method]
    run = simulate(other.scene, formulation, estimate_error=False, **options)
    bent = float(np.abs(other.tip_deflection).max())
    if not (run.finished and other.finished):
        return {"bent": bent} | dict.fromkeys(("tip", "torque", "dissipated", "balance", "gauge"), math.nan)
    joints = [motion.joint for motion in other.scene.motions if motion.joint is not None]
    torque = 0.0
    if joints:
        torques = other.joint_torque[:, joints]
        torque = float(np.abs(run.joint_torque[:, joints] - torques).max() / np.abs(torques).max())
    return {
        "bent": bent,
        "tip": tips_apart(run, other),
        "torque": torque,
        "dissipated": abs(float(run.dissipated[-1] / other.dissipated[-1]) - 1.0),
        "balance": float(np.abs(run.balance).max()) / run.turned_over,
        "gauge": _gauges(run, other),
    }


def _gauges(run: Trajectory, other: Trajectory) -> float:
    """How far strain gauges at a quarter of each link are off, over the most that any of them reads."""
    read, wanted = (np.array([one.strain(k, 0.25) for k in range(other.scene.arm.n_links)]) for one in (run, other))
    return float(np.abs(read - wanted).max() / np.abs(wanted).max())


POSTURES: dict[str, dict[str, Any]] = {
    "sagging": {"gravity": 1.0, "loads": []},
    "loaded": {"loads": [PointLoad(0, "tip", constant(0.4), constant(1.6))]},
    "two links": {"links": 2, "angles": (0.3, 0.3), "gravity": 1.0},
}
"""What bends an arm whose joints are held, for its damping ratios."""


@cache
def ratio(posture: str, tau_d: float, method: str) -> float:
    """Damping ratio of the first mode about a bent posture, joints held."""
    scene = Draft(SMALL if method.startswith("modes") else LARGE, tau_d=tau_d, drive=False, **POSTURES[posture]).scene()
    formulation, options = METHODS[method]
    return float(modes(scene, 1, formulation, clamped=tuple(range(scene.arm.n_links)), **options).damping[0])


if __name__ == "__main__":
    chosen = sys.argv[1:]
    rows = []
    for features in SINGLE + PAIRS:
        for method in chosen or METHODS:
            row = measure(features, method)
            worst = max(row["tip"] / TIP.get(method, 1.0), row["torque"] / TORQUE, row["dissipated"] / DISSIPATED)
            rows.append((max(worst, row["balance"] / BALANCE), features, method, row))
            numbers = "  ".join(f"{name} {value:.2g}" for name, value in row.items())
            print(f"{name_of(features):36s} {method:18s} {numbers}", flush=True)
    print("\nworst, as shares of what is allowed")
    for share, features, method, _ in sorted((row for row in rows if row[2] in TIP), key=lambda row: row[0])[-8:]:
        print(f"{share:.2f}  {name_of(features)}, {method}")
