"""Every feature of an arm or a scene in space, alone and in pairs, on arms that are bent by a fifth of their length and
twisted by ten degrees and more, against an oracle of another derivation (`oracle_space.py`).

``python -m tests.feature_matrix_space [METHOD ...] [page]`` prints all cells, the worst last, and writes the page;
``python -m tests.feature_matrix_space make [WORD]`` computes the oracle's side (of cells with this word in their names)
anew, which takes minutes, into ``feature_matrix_space.npz``.
"""

import dataclasses
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import Pool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import pages
from benchmarks.machine import DOCS, table
from flexarm_env.batch import Batch, Extras, Starts
from flexarm_env.bodies import RigidLink
from flexarm_env.envs.space import SPACE
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.physics.space.reading import read
from flexarm_env.scene import JointTorque, Load, Motion, PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.simulation import simulate
from flexarm_env.tasks.program import PayloadChange
from flexarm_env.time_functions import constant, cycloid, sine, spin_up, steps
from tests.feature_matrix import alike, changed, curved, name_of, sets
from tests.oracle_space import Array, SpatialOracle

DURATION, SAMPLE = 0.8, 0.04
STORED = Path(__file__).with_suffix(".npz")
STRIP = Section(2.0, 2e6, 7e5, 0.3, 1e-4, 4.0, 7e5, 2e-4, 1.0)
FAST = 2.0 * math.pi
TORQUES = (2.0, 0.8, 0.5)
CHANGE, FACTOR = 10 * SAMPLE, 2.5
"""When the payload changes, s, and by what factor."""


def tensor(*own: float) -> Any:
    """One with these principal values, its axes turned about (1, 2, 2)."""
    turn = Rotation.from_rotvec([0.2, 0.4, 0.4]).as_matrix()
    return tuple(map(tuple, turn @ np.diag(own) @ turn.T))


@dataclass
class Draft:
    """A scene in the making."""

    links: int = 1
    tau_d: float = 2e-3
    payload: Payload = field(default_factory=lambda: Payload(0.1, 2e-4))
    hub: dict[str, Any] = field(default_factory=dict)
    elbow: Elbow = field(default_factory=lambda: Elbow(0.05, 2e-4, 2e-4, (0.0, 1.0, 0.0)))
    root: str = "pinned"
    pillar: bool = False
    rigid: tuple[int, ...] = ()
    start: str = "unloaded"
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # always there, so that cells share one compiled form
    rates: tuple[float, ...] = ()
    push: float = 1.0
    link: Callable[[float], Link] = field(default=lambda length: Link(length, STRIP))
    motions: list[Motion] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    joint: dict[str, Any] = field(default_factory=dict)
    held: bool = False  # as in an environment: torques are held over control periods of SAMPLE, nothing else pushes
    shared: bool = False  # links have rigid ends and a curvature of next to nothing, where they have no others

    def scene(self) -> Scene:
        """The scene: one link of 1 m, or two of 0.6 and 0.4 m, perhaps behind a pillar."""
        links = [self.link(length) for length in ((1.0,) if self.links == 1 else (0.6, 0.4))]
        if self.shared:
            links = alike(links)
        elbows = [self.elbow] * (self.links - 1)
        if self.pillar:
            links.insert(0, RigidLink(0.15, 0.5, (0.08, 0.01, 0.02), tensor(2e-3, 3e-3, 4e-3)))
            elbows.insert(0, Elbow(axis=(0.0, 1.0, 0.0), mount=((1.0, 0.0, 0.0), 0.4)))
        n = len(links)
        arm = Arm(
            "cell",
            tuple(links),
            hub_inertia=0.02,
            elbows=tuple(elbows),
            payload=self.payload,
            tau_d=self.tau_d,
            joints=tuple(Joint(**JOINT | self.joint) for _ in range(n)) if self.joint else (),
            **self.hub,
        )
        p = self.push
        tip = {
            "force_y": (1.2 * p, 5.0),
            "force_z": (1.6 * p, 4.0),
            "torque_x": (0.35 * p, 6.0),
            "torque": (0.1 * p, 3.0),
        }
        loads = [*self.loads]
        if not self.held:
            loads.append(PointLoad(n - 1, "tip", **{name: sine(*of) for name, of in tip.items()}))
        held = {motion.joint for motion in self.motions} | set(self.rigid)
        if self.root == "pinned":
            torques = [steps(times()[:-1], x) if self.held else None for x in (shares() * TORQUES).T]
            loads += [JointTorque(k, torques[k] or sine(TORQUES[k], FAST)) for k in range(n) if k not in held]
        angles = (0.2, 0.5, -0.4)[:n]
        return Scene(
            "cell", arm, duration=DURATION, dt=5e-4, sample=SAMPLE, root=self.root, angles=angles, rates=self.rates,
            rigid_joints=self.rigid, motions=tuple(self.motions), loads=tuple(loads), gravity=self.gravity,
            start=self.start, space=True,
        )  # fmt: skip


def shares() -> Array:
    """Of TORQUES in each control period, (periods, joints), as actions are."""
    wave = np.sin(FAST * times()[:-1, None] + [0.3, 1.0, 2.0])
    return wave.astype(np.float32).astype(np.float64)


def _elbow(d: Draft) -> None:
    d.links = 2
    d.elbow = Elbow(
        0.2, tensor(1e-3, 2e-3, 2.5e-3), tensor(2e-3, 1e-3, 1.5e-3), (0.6, 0.0, 0.8), ((0.0, 1.0, 1.0), 0.5)
    )


def _prescribed_elbow(d: Draft) -> None:
    d.links = 2
    k = 1 + d.pillar
    d.motions.append(Motion(f"joint{k}", cycloid(1.5, 0.5, 0.5 if k == 1 else -0.4)))


def _shaken(d: Draft) -> None:
    for name, size, time in (("root_x", 0.1, 0.3), ("root_y", 0.2, 0.4), ("root_z", -0.25, 0.35)):
        d.motions.append(Motion(name, cycloid(size, time)))


def _root_load(d: Draft) -> None:
    d.links = 2
    of = {"force_x": (1.0, 4.0), "force_z": (-3.0, 5.0), "torque_x": (0.3, 7.0), "torque_y": (0.5, 6.0)}
    d.loads.append(PointLoad(d.links - 1, "root", **{name: sine(*pair) for name, pair in of.items()}))


def _free(d: Draft) -> None:
    d.root = "free"
    of = {"force_y": (6.0, FAST), "force_z": (-8.0, 5.0), "torque_x": (-0.4, 6.0), "torque": (-2.0, 5.0)}
    d.loads.append(PointLoad(0, "root", **{name: sine(*pair) for name, pair in of.items()}))


def _resting(start: str) -> Callable[[Draft], None]:
    """Starts at rest, bent and twisted: joints at their angles, or where they come to rest."""

    def feature(d: Draft) -> None:
        d.start, d.gravity = start, (1.0, -4.0, -8.0)
        names = {"force_y": 0.8, "force_z": -0.6, "torque_x": 0.4}
        d.loads.append(PointLoad(d.links - 1 + d.pillar, "tip", **{name: constant(x) for name, x in names.items()}))

    return feature


def _own_damping(d: Draft) -> None:
    d.links = 2
    made, taus = d.link, iter((6e-3, 5e-4))
    d.link = lambda length: dataclasses.replace(made(length), tau_d=next(taus))


def _driven_motor(d: Draft) -> None:
    d.joint |= {"damping": 0.02}
    d.motions.append(Motion("motor0", cycloid(1.8, 0.6, 0.2)))


JOINT = {"stiffness": 40.0, "damping": 1e-3, "motor_inertia": 2e-4, "gear_ratio": 10.0, "backlash": 1e-12,
         "friction_viscous": 1e-12, "friction_coulomb": 1e-12}  # fmt: skip
"""What joints have where one of their features is asked for: they share one compiled form."""
ENDS = {"root_mass": 0.05, "root_inertia": 1e-4, "tip_mass": 0.04, "tip_inertia": 2e-4}


def _control(d: Draft) -> None:
    _elbow(d)
    d.held, d.gravity, d.payload = True, (1.0, -4.0, -8.0), Payload(0.1, tensor(3e-4, 5e-4, 7e-4), (0.05, 0.06, -0.08))


FEATURES: dict[str, Callable[[Draft], None]] = {
    "control periods": _control,
    "torques and tip load": sets(),
    "light damping": sets(tau_d=2e-4),
    "heavy damping": sets(tau_d=0.02),
    "oblique hub": sets(hub={"hub_axis": (1.0, 2.0, 2.0), "hub_mount": ((0.3, 0.2, 0.5), 0.6)}),
    "gravity": sets(gravity=(1.0, -4.0, -8.0)),
    "payload": sets(payload=Payload(0.1, tensor(3e-4, 5e-4, 7e-4), (0.05, 0.06, -0.08))),
    "elbow": _elbow,
    "prescribed hub": lambda d: d.motions.append(Motion("joint0", spin_up(5.0, 0.7, 0.2))),
    "prescribed elbow": _prescribed_elbow,
    "rigid elbow": sets(links=2, rigid=(1,)),
    "shaken base": _shaken,
    "root load": _root_load,
    "free flight": _free,
    "turning start": lambda d: vars(d).update(rates=(3.0, -2.0)[: d.links]),
    "pillar": sets(pillar=True),
    "rigid ends": changed(
        lambda length, link: dataclasses.replace(
            link, length=0.85 * length, root_offset=0.1 * length, tip_offset=0.05 * length, **ENDS
        )
    ),
    "curved": curved,
    "tapered": changed(
        lambda length, link: Link.tapered(length, (0.024, 0.016), (0.02, 0.012), E=2e8, rho=800.0, G=1e8)
    ),
    "own damping": _own_damping,
    "soft": changed(lambda length, link: Link(length, dataclasses.replace(STRIP, EA=400.0, C=150.0, C_y=200.0))),
    "held start": _resting("held"),
    "rest start": _resting("equilibrium"),
    "elastic gear": lambda d: d.joint.update(stiffness=12.0, damping=0.02),
    "fast rotor": lambda d: d.joint.update(motor_inertia=5e-4, gear_ratio=20.0),
    "viscous friction": lambda d: d.joint.update(friction_viscous=0.15),
    "dry friction": lambda d: d.joint.update(friction_coulomb=0.25),
    "friction of the link": lambda d: d.joint.update(
        friction_coulomb=0.15, friction_viscous=0.05, friction_side="link"
    ),
    "backlash": lambda d: d.joint.update(backlash=0.06, damping=0.02),
    "driven motor": _driven_motor,
    "gripped": sets(),
    "let go": sets(),
}
"""In the order in which they are applied."""
JOINTED = {*list(FEATURES)[list(FEATURES).index("elastic gear") : -2]}
"""Those of joints."""
SHARED = {*JOINTED, "control periods", "pillar", "rigid ends", "curved", "tapered"}
"""Cells with one of these share a compiled form (`Draft.shared`); the others are those of straight links alone."""

SINGLE = [(name,) for name in FEATURES if name not in ("control periods", "gripped", "let go")]
PAIRS = [
    ("elbow", "gravity"), ("elbow", "payload"), ("elbow", "oblique hub"), ("elbow", "heavy damping"),
    ("elbow", "prescribed hub"), ("elbow", "shaken base"), ("elbow", "root load"), ("elbow", "free flight"),
    ("elbow", "turning start"), ("elbow", "pillar"), ("elbow", "rigid ends"), ("elbow", "curved"),
    ("elbow", "soft"), ("prescribed elbow", "gravity"), ("prescribed elbow", "free flight"),
    ("rigid elbow", "payload"), ("rigid elbow", "free flight"),
    ("pillar", "gravity"), ("pillar", "payload"), ("pillar", "free flight"), ("rigid ends", "payload"),
    ("rigid ends", "free flight"), ("curved", "gravity"), ("curved", "free flight"), ("payload", "prescribed hub"),
    ("payload", "free flight"), ("payload", "shaken base"), ("soft", "free flight"),
    ("light damping", "prescribed hub"),
    ("heavy damping", "free flight"), ("gravity", "shaken base"), ("tapered", "gravity"),
    ("elbow", "held start"), ("elbow", "rest start"), ("prescribed elbow", "held start"),
    ("elbow", "fast rotor"), ("elastic gear", "shaken base"), ("elastic gear", "payload"),
    ("elastic gear", "rigid ends"), ("fast rotor", "pillar"), ("viscous friction", "fast rotor"),
    ("dry friction", "curved"), ("backlash", "gravity"), ("driven motor", "payload"), ("driven motor", "dry friction"),
    ("rigid ends", "held start"), ("curved", "held start"), ("curved", "rest start"), ("payload", "rest start"),
]  # fmt: skip
PERIODS = [
    ("control periods",),
    *(("control periods", name) for name in (
        "heavy damping", "oblique hub", "pillar", "rigid ends", "tapered", "own damping", "soft", "elastic gear",
        "fast rotor", "viscous friction", "dry friction", "friction of the link", "backlash", "gripped", "let go",
    )),
    ("control periods", "pillar", "gripped"),
    ("control periods", "backlash", "gripped"),
]  # fmt: skip
"""Of batches: held torques, gravity, two links and a payload beside the tip in all, which may change."""
SHEARED = {"soft", "tapered"}
"""Features with stretch and shear that count, which the elastica has not."""
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "exact": ("geometrically_exact", {"elements": 32, "rho_inf": 0.9}),
    "floating": ("floating_frame", {"segments": 8}),
    "modes": ("floating_frame", {"segments": 6, "modes": 3}),
    "elastica": ("elastica", {"nodes": 6}),
}
"""Formulations with the meshes that are held to it."""
TIP = {"exact": 5e-4, "floating": 5e-3, "modes": 7e-3, "elastica": 5e-4}
"""Largest distance of the tip from the oracle's, over the arm's length."""
TURN = {"exact": 0.01, "floating": 0.02, "modes": 0.035, "elastica": 0.01}
"""Largest rotation of the tip's axes from the oracle's, rad."""
TORQUE, DISSIPATED, BALANCE = 0.02, 0.03, 0.02
"""Relative: of what enforces motions, what is dissipated, the energy's balance."""
OWN = 5e-5
"""Largest distance of the oracle's tip from that of one with a polynomial less, over the arm's length."""


def scene_of(features: tuple[str, ...]) -> Scene:
    """The scene with these features."""
    draft = Draft(shared=bool(SHARED & {*features}))
    for name in FEATURES:
        if name in features:
            FEATURES[name](draft)
    return draft.scene()


def times() -> Array:
    """The instants that are compared."""
    return np.linspace(0.0, DURATION, round(DURATION / SAMPLE) + 1)


def computed(features: tuple[str, ...], n: int = 6, at: Array | None = None) -> dict[str, Array]:
    """The oracle's run; at: instants, s, instead of those that are compared."""
    points = 16 if "curved" in features else 10  # of ten a curve in free flight is 6e-5 of its length off
    oracle = SpatialOracle(scene_of(features), n, points, soft=bool(SHEARED & {*features}))
    return oracle.run(times() if at is None else at, changed=_change(features))


def _change(features: tuple[str, ...]) -> tuple[float, float] | None:
    """When the payload changes and by what factor; what is gripped was at rest."""
    return (CHANGE, FACTOR if "gripped" in features else 1.0 / FACTOR) if {"gripped", "let go"} & {*features} else None


def row_of(features: tuple[str, ...], found: dict[str, Array], own: float) -> dict[str, Array]:
    """What is kept of a run of the oracle: where the tip is, rotation vectors of its axes, torques; and in `numbers`
    what is dissipated, how far a link is bent (of its length, from where it is without stress) and twisted (degrees),
    how far the tip is from that of an oracle with a polynomial less (m)."""
    spans = [link.span for link in scene_of(features).arm.links]
    bent = np.linalg.norm((found["bent"] - found["natural"])[..., 1:], axis=-1) / spans
    torque = np.zeros((len(found["tip"]), 3))
    torque[:, : found["torque"].shape[1]] = found["torque"]
    numbers = [found["dissipated"][-1], bent.max(), np.degrees(np.abs(found["twist"]).max()), own]
    turn = Rotation.from_matrix(found["axes"]).as_rotvec()
    return {"tip": found["tip"], "turn": turn, "torque": torque, "numbers": np.array(numbers)}


def _made(features: tuple[str, ...]) -> dict[str, Array]:
    fine, coarse = computed(features), computed(features, 5)
    return row_of(features, fine, float(np.linalg.norm(fine["tip"] - coarse["tip"], axis=1).max()))


def keep(rows: dict[str, dict[str, Array]]) -> None:
    """Write all cells."""
    np.savez_compressed(
        STORED, names=np.array(list(rows)),
        **{key: np.array([row[key] for row in rows.values()], np.float64 if key == "tip" else np.float32)
           for key in ("tip", "turn", "torque", "numbers")},
    )  # fmt: skip


def make(word: str = "") -> None:
    """Compute the cells with this word in their names, and keep them with the others."""
    kept = _kept() if STORED.exists() else {}
    cells = [cell for cell in SINGLE + PAIRS + PERIODS if word in name_of(cell)]
    with Pool(2) as pool:
        for cell, found in zip(cells, pool.imap(_made, cells), strict=True):
            print(f"{name_of(cell)}: {found['numbers'][3]:.1e}", flush=True)
            kept[name_of(cell)] = found
            keep(kept)


@cache
def _kept() -> dict[str, dict[str, Array]]:
    found = dict(np.load(STORED))
    return {str(name): {k: v[i] for k, v in found.items() if k != "names"} for i, name in enumerate(found["names"])}


def reference(features: tuple[str, ...]) -> dict[str, Array]:
    """What is kept of the oracle's run."""
    return _kept()[name_of(features)]


def in_batch(features: tuple[str, ...], method: str, n: int = 9, dt: float = 5e-4) -> SimpleNamespace:
    """The first of n arms, which have 0.9 of its actions each after the one before, over control periods of SAMPLE; in
    fields of a trajectory, and all its states."""
    scene, (formulation, options) = scene_of(features), METHODS[method]
    count, change = scene.arm.n_links, _change(features) or (2.0 * DURATION, 1.0)  # or none, in the same compiled form
    arm = dataclasses.replace(scene.arm, torque_limits=TORQUES[:count])
    settings = Settings.make(formulation, dt=dt, **options)
    task = SPACE.build(arm, np.zeros(len(SPACE.rewards)), SAMPLE, {})
    starts = Starts(start=[(x, x) for x in scene.angles], target=[(0.0, 0.0)] * count)
    when = round(change[0] / SAMPLE)
    extras = Extras(payload_change=PayloadChange(np.array([when, when]), np.array([change[1]] * 2), (0,)))
    batch = Batch(arm, settings, n, task, starts, period=SAMPLE, gravity=scene.gravity, account=True, extras=extras)
    batch.start(range(n), range(n), limit=len(times()))
    rows = [(*batch.motion(0)[:2], batch.table[:, 0].copy())]
    for share in shares()[:, :count]:
        batch.action[:] = share * 0.9 ** np.arange(n)[:, None]
        batch.step()
        rows.append((*batch.motion(0)[:2], batch.table[:, 0].copy()))
    q, v, table = (np.array(x) for x in zip(*rows, strict=True))
    seen, first = read(arm, settings, q, v), batch.info_at.energies
    kinetic, strain, gravity, dissipated, work = table[:, first : first + 5].T
    energy = kinetic + strain + gravity
    return SimpleNamespace(
        finished=not table[:, batch.info_at.reason].any(), tip=seen["tip"], tip_rotation=seen["tip_rotation"],
        dissipated=dissipated, balance=energy - energy[0] + dissipated - work,
        turned_over=np.abs(np.diff(work)).sum(), states=np.hstack([q, v, table]),
    )  # fmt: skip


def measure(features: tuple[str, ...], method: str) -> dict[str, float]:
    """How far a cell is off: tip (of L), turn (rad), torque, dissipated, balance; bent, twist: see `row_of`.

    nan where the run did not come to its end; torque 0 where no motion is prescribed.
    """
    other, scene = reference(features), scene_of(features)
    formulation, options = METHODS[method]
    in_periods = "control periods" in features
    run: Any
    run = in_batch(features, method) if in_periods else simulate(scene, formulation, estimate_error=False, **options)
    dissipated, bent, twist, _ = map(float, other["numbers"])
    row = {"bent": bent, "twist": twist}
    if not run.finished:
        return row | dict.fromkeys(("tip", "turn", "torque", "dissipated", "balance"), math.nan)
    joints = [motion.joint for motion in scene.motions if motion.joint is not None]
    torque = 0.0
    if joints:
        wanted = other["torque"][:, joints]
        torque = float(np.abs(run.joint_torque[:, joints] - wanted).max() / np.abs(wanted).max())
    quaternions = np.roll(run.tip_rotation, -1, axis=1)
    apart = Rotation.from_quat(quaternions).inv() * Rotation.from_rotvec(other["turn"])
    return row | {
        "tip": float(np.linalg.norm(run.tip - other["tip"], axis=1).max()) / scene.arm.total_length,
        "turn": float(apart.magnitude().max()),
        "torque": torque,
        "dissipated": abs(float(run.dissipated[-1]) / dissipated - 1.0),
        "balance": float(np.abs(run.balance).max()) / run.turned_over,
    }


def beside(features: tuple[str, ...], method: str) -> dict[str, float]:
    """Of a batch: how many of its numbers are not those of the arm alone, to the last bit; how far tips are apart with
    steps of half the size, over the arm's length."""
    many, alone = in_batch(features, method), in_batch(features, method, 1)
    halved = in_batch(features, method, 1, 2.5e-4)
    apart = np.linalg.norm(many.tip - halved.tip, axis=1).max() / scene_of(features).arm.total_length
    return {"differ": float((many.states != alone.states).sum()), "halved": float(apart)}


def _print(methods: list[str], paged: bool) -> None:
    rows = []
    for features in SINGLE + PAIRS + PERIODS:
        for method in methods or METHODS:
            if method == "elastica" and SHEARED & {*features}:
                continue
            row = measure(features, method)
            row |= beside(features, method) if features in PERIODS else {}
            rows.append((row["tip"] / TIP[method], features, method, row))
            numbers = "  ".join(f"{name} {value:.2g}" for name, value in row.items())
            print(f"{name_of(features):32s} {method:8s} {numbers}", flush=True)
    worst = []
    for method in methods or METHODS:
        worst += sorted((row for row in rows if row[2] == method), key=lambda row: row[0])[-5:][::-1]
    print("\nworst tips, as shares of what is allowed")
    for share, features, method, _ in worst:
        print(f"{share:.2f}  {name_of(features)}, {method}")
    if paged:
        heads = (
            "cell | formulation | deflection | twist, ° | tip error, of L | error of the axes, rad | torque | "
            "dissipated energy | energy balance"
        )
        cells = [
            [name_of(features), method, f"{row['bent']:.2f}", f"{row['twist']:.0f}",
             *(f"{row[key]:.1e}" for key in ("tip", "turn", "torque", "dissipated", "balance"))]
            for _, features, method, row in rows
        ]  # fmt: skip
        in_periods = [
            [name_of(features[1:]) or "nothing else", method, f"{row['halved']:.1e}", f"{row['differ']:.0f}"]
            for _, features, method, row in rows if features in PERIODS
        ]  # fmt: skip
        first = [[name_of(features), method, f"{share:.2f}"] for share, features, method, _ in worst]
        blocks = {
            "CELLS": table(heads, cells), "WORST": table("cell | formulation | tip error / limit", first),
            "PERIODS": table("cell | formulation | change if steps are halved, of L | differing numbers", in_periods),
        }  # fmt: skip
        pages.write_page(DOCS / "results", "space_matrix", blocks)


if __name__ == "__main__":
    if sys.argv[1:2] == ["make"]:
        make(*sys.argv[2:])
    else:
        _print([word for word in sys.argv[1:] if word != "page"], "page" in sys.argv)
