"""Stability of arms in space under stress: a part of `benchmarks.stability`, with the same classification.

    python -m benchmarks.stability_space [--limit N] [--workers N] [--fresh] [--page] [--out FOLDER]

Arms have length 1 m, mass 1 kg and EI = 1 N m^2, their own EI_y and torsional stiffness, and oblique axes. Times are
multiples of the first period T1 of the clamped arm. The converged solution is that of the exact beam on two meshes with
two steps, which agree within 0.3 % of L. An arm whose stiffness factor exceeds `STIFF` is compared with the solution of
an arm with the factor `STIFF`, which is practically rigid. An error of 1 rad of the tip's axes counts as much as a tip
error of a fifth of L.
"""

import argparse
import dataclasses
import functools
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks import pages, stability
from benchmarks.running import STORE, cores, run_all
from benchmarks.stability_cases import TORQUE_LIMIT, Case, grid, period, switched
from flexarm_env.parameters import Arm, Elbow, Joint, Link, Payload, Section
from flexarm_env.scene import JointTorque, Load, Motion, PointLoad, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import TimeFunction, constant, cycloid, linear_table, pulse, ramp, sine, spin_up

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "exact": ("geometrically_exact", {"elements": 6}),
    "floating frame": ("floating_frame", {"segments": 5}),
    "modes in segments": ("floating_frame", {"segments": 3, "modes": 2}),
    "elastica": ("elastica", {"nodes": 6}),
}
DRAWN = ("exact", "floating frame", "modes in segments")
"""Formulations from which each case of the family `random` draws; each of these cases also runs with the elastica."""
DEFAULTS: Case = {
    "drive": "push", "amplitude": 1.0, "dwell": 0.25, "slender": 1e6, "flat": 4.0, "torsion": 0.6, "payload": 0.5,
    "zeta": 0.0, "links": 1, "h": 0.01, "rho": None, "horizon": 2.0, "seed": 0, "gravity": 0.0, "friction": 0.0,
    "gear": math.inf, "backlash": 0.0, "start": "unloaded", "stiff": 1.0, "which": "all", "options": {},
}  # fmt: skip
STIFF = 1e4
"""Largest stiffness factor of a reference; stiffer arms are compared with an arm of this factor."""
ALWAYS = ("stiff", "twist", "damping")
EVERY = 3
WHICH = {"all": ("EI", "EI_y", "GJ", "EA", "C", "C_y"), "bending": ("EI", "EI_y"), "torsion": ("GJ",),
         "stretch": ("EA", "C", "C_y")}  # fmt: skip


def arm_of(case: Case) -> Arm:
    """Return the arm of a case: equal links with a uniform section, oblique axes, and a payload beside its tip."""
    n, slender, flat = case["links"], case["slender"], case["flat"]
    own = {"EI": 1.0, "EI_y": flat, "GJ": case["torsion"], "EA": slender, "C": slender / 3.0, "C_y": slender / 3.0}
    own |= {name: own[name] * case["stiff"] for name in WHICH[case["which"]]}
    section = Section(m=1.0, J=1.0 / slender, J_y=flat / slender, **own)
    mass = case["payload"]
    joint = Joint(
        stiffness=case["gear"], damping=0.0 if case["gear"] == math.inf else 0.01, motor_inertia=0.02,
        friction_viscous=1e-3, friction_coulomb=case["friction"] * TORQUE_LIMIT, backlash=case["backlash"],
    )  # fmt: skip
    return Arm(
        "case", (Link(1.0 / n, section),) * n, hub_inertia=0.1, hub_axis=(0.0, 0.6, 0.8),
        elbows=(Elbow(0.1, 1e-3, 1e-3, (0.0, 1.0, 0.0)),) * (n - 1),
        payload=Payload(mass, 0.01 * mass, (0.0, 0.05, 0.03)),
        tau_d=case["zeta"] * period(case) / math.pi, joints=(joint,) * n if case["friction"] else (),
    )  # fmt: skip


def scene_of(case: Case) -> tuple[Scene, str, dict[str, Any]]:
    """Return the scene, formulation and options of a case.

    Every scene has gravity and a load at the tip, possibly zero, so that fewer kernels are compiled.
    """
    formulation, options = METHODS[case["method"]]
    T, a, arm, drive = period(case), case["amplitude"], arm_of(case), case["drive"]
    end, limit, omega, n = case["horizon"] * T, TORQUE_LIMIT * a, 2.0 * math.pi / T, arm.n_links
    tip: dict[str, TimeFunction] = {"torque_x": constant(0.0), "force_y": constant(0.0), "force_z": constant(0.0)}
    torques: list[TimeFunction] = [constant(0.0)] * n
    motions: tuple[Motion, ...] = ()
    loads: tuple[Load, ...] = ()
    root = "pinned"
    if drive == "push":
        torques = [pulse(limit / 2**k, 0.25 * T) for k in range(n)]
        tip = {"torque_x": sine(0.3 * limit, 1.7 * omega), "force_y": sine(0.2 * limit, omega),
               "force_z": sine(0.3 * limit, 0.8 * omega)}  # fmt: skip
    elif drive == "swing":
        torques = [sine(limit / 2**k, (1.0 + 0.3 * k) * omega) for k in range(n)]
    elif drive == "bang":
        torques = [switched(case, k, end) for k in range(n)]
    elif drive == "twist":  # to so many rad at rest
        motions = (Motion("joint0", constant(0.0)),)
        tip["torque_x"] = linear_table([0.0, T], [0.0, a * case["torsion"]])
        tip["force_z"] = constant(0.02)
    elif drive == "ramp":
        motions = (Motion("joint0", ramp(0.5 * a * omega * T, 0.5 * T)),)
    elif drive == "cycloid":
        motions = (Motion("joint0", cycloid(a, T)),)
    elif drive == "spin":
        motions = (Motion("joint0", spin_up(a * omega, 1.5 * T)),)
    elif drive == "root":
        motions = (Motion("root_x", sine(0.1 * a, 1.3 * omega)), Motion("root_z", cycloid(0.2 * a, 0.7 * T)))
    elif drive == "thrown":
        root, torques = "free", []
        push = {"force_x": limit, "force_z": 0.5 * limit, "torque": -limit, "torque_x": 0.3 * limit}
        loads = (PointLoad(0, "root", **{name: pulse(size, 0.3 * T) for name, size in push.items()}),)
    elif drive != "gravity":
        raise ValueError(f"drive = {drive!r}: not known")
    held = {motion.joint for motion in motions}
    loads += tuple(JointTorque(k, f) for k, f in enumerate(torques) if k not in held)
    h, g = min(case["h"] * T, end), case["gravity"]
    scene = Scene(
        "case", arm, duration=end, dt=h, sample=end / max(1, min(60, round(end / h))), root=root, motions=motions,
        loads=(*loads, PointLoad(n - 1, "tip", **tip)), gravity=(0.0, -0.3 * g, -g), start=case["start"], space=True,
        angles=(0.0, *(0.3,) * (n - 1)),
    )  # fmt: skip
    options = {**options, **case["options"], "dt": h}
    if case["rho"] is not None:
        options["rho_inf"] = case["rho"]
    return scene, formulation, options


def reference_of(case: Case, fine: bool) -> tuple[Scene, dict[str, Any]]:
    """Return the scene of a case with the settings of its converged solution. fine False: settings of a coarser
    check."""
    scene = dataclasses.replace(scene_of({**case, "stiff": min(case["stiff"], STIFF)})[0], name="reference")
    h = min(period(case) / 500.0, 0.5 * scene.dt)
    if case["drive"] == "spin":
        h = min(h, period(case) / 200.0 / max(1.0, case["amplitude"]))
    elements = math.ceil((24 if fine else 16) / case["links"])
    return scene, {"elements": elements, "rho_inf": 0.9, "dt": h if fine else 1.5 * h}


# ------------------------------------------------------------------- families
def cases() -> list[Case]:
    """Return all different cases; mark those whose tip is compared with a converged solution.

    All cases of the families ALWAYS are marked, and every third case of the others.
    """
    found: dict[str, Case] = {}
    for family, rows in FAMILIES.items():
        for i, row in enumerate(rows()):
            if "horizon" not in row:  # at most some thousand steps
                row["horizon"] = min(2.0, max(0.5, 1500.0 * row.get("h", DEFAULTS["h"])))
            case = {"family": family, **DEFAULTS, **row}
            found.setdefault(repr(sorted(case.items())), {**case, "check": family in ALWAYS or i % EVERY == 0})
    return list(found.values())


def _step() -> Iterator[Case]:
    yield from grid(h=np.geomspace(1e-3, 0.5, 8).tolist(), rho=[0.0, 0.6, 0.9, 1.0], drive=["push", "ramp", "thrown"],
                    method=METHODS, amplitude=[0.5])  # fmt: skip


def _slender() -> Iterator[Case]:
    yield from grid(slender=np.geomspace(1e1, 1e10, 7).tolist(), flat=[1.0, 30.0, 1e3], torsion=[0.03, 1.0, 30.0],
                    method=METHODS, amplitude=[0.5])  # fmt: skip


def _stiff() -> Iterator[Case]:
    yield from grid(stiff=[10.0**k for k in range(15)], which=WHICH, method=METHODS, slender=[1e3], drive=["swing"],
                    horizon=[1.0])  # fmt: skip


def _spin() -> Iterator[Case]:
    yield from grid(amplitude=[0.1, 0.3, 0.6, 1.2, 2.0, 3.0, 5.0, 12.0], h=[1e-3, 3e-3, 0.01, 0.03], drive=["spin"],
                    slender=[1e3, 1e6], method=METHODS)  # fmt: skip
    yield from grid(amplitude=[1.0, 5.0, 20.0, 100.0], h=[3e-3, 0.01, 0.03], drive=["thrown"], method=METHODS)


def _twist() -> Iterator[Case]:
    yield from grid(amplitude=[0.5, 1.6, 3.0, 6.0, 12.0], torsion=[0.1, 1.0, 10.0], h=[3e-3, 0.02, 0.1],
                    flat=[1.0, 10.0], drive=["twist"], zeta=[1e-3], method=METHODS)  # fmt: skip


def _bang() -> Iterator[Case]:
    yield from grid(amplitude=[0.1, 0.5, 2.0, 10.0, 100.0], dwell=[0.02, 0.1, 0.7], h=[2e-3, 0.01, 0.05], links=[2],
                    drive=["bang"], horizon=[1.5], method=METHODS)  # fmt: skip


def _damping() -> Iterator[Case]:
    yield from grid(zeta=[1e-3, 0.05, 0.5, 5.0], h=[3e-3, 0.03, 0.2], rho=[None, 1.0, 0.3], drive=["push", "ramp"],
                    method=METHODS)  # fmt: skip


def _friction() -> Iterator[Case]:
    gears = [{"gear": math.inf}, {"gear": 10.0}, {"gear": 1e3}, {"gear": 100.0, "backlash": 0.02}]
    for row in grid(given=gears, friction=[0.1, 0.5, 1.5], h=[3e-3, 0.03], drive=["swing", "bang"], links=[1, 2],
                    amplitude=[2.0], method=METHODS):  # fmt: skip
        yield {**row.pop("given"), **row}


def _gravity() -> Iterator[Case]:
    yield from grid(gravity=[0.1, 1.0, 10.0], h=[2e-3, 0.01, 0.05], links=[1, 2], start=["unloaded", "held"],
                    drive=["gravity", "root"], horizon=[1.0], method=METHODS)  # fmt: skip


def _random() -> Iterator[Case]:
    rng = np.random.default_rng(20261126)
    for k in range(450):
        row = {
            "method": str(rng.choice(DRAWN)),
            "drive": str(rng.choice(["push", "swing", "bang", "ramp", "cycloid", "spin", "twist", "root", "thrown"])),
            "amplitude": float(10 ** rng.uniform(-1.5, 1.0)),
            "dwell": float(10 ** rng.uniform(-1.5, 0.0)),
            "slender": float(10 ** rng.uniform(1.0, 9.0)),
            "flat": float(10 ** rng.uniform(0.0, 3.0)),
            "torsion": float(10 ** rng.uniform(-1.5, 1.5)),
            "payload": float(10 ** rng.uniform(-3.0, 1.5)),
            "zeta": float(rng.choice([0.0, 10 ** rng.uniform(-3.0, 0.5)])),
            "links": int(rng.choice([1, 1, 2, 3])),
            "h": float(10 ** rng.uniform(-2.5, -0.5)),
            "rho": None if rng.random() < 0.5 else float(rng.uniform(0.0, 1.0)),
            "gravity": float(rng.choice([0.0, 10 ** rng.uniform(-1.0, 1.0)])),
            "seed": k,
            "horizon": float(rng.uniform(0.5, 2.0)),
        }
        yield row
        yield {**row, "method": "elastica"}


FAMILIES: dict[str, Callable[[], Iterator[Case]]] = {
    "step": _step, "slenderness": _slender, "stiff": _stiff, "spin": _spin, "twist": _twist, "bang-bang": _bang,
    "damping": _damping, "friction": _friction, "gravity": _gravity, "random": _random,
}  # fmt: skip


# -------------------------------------------------------------------- report
def warm_up() -> None:
    """Compile every kernel once in this process, so that forked workers inherit the code."""
    seen = set()
    for case in cases():
        joints = bool(case["friction"]), case["gear"] == math.inf, bool(case["backlash"])
        key = (case["method"], bool(case["zeta"]), joints, case["drive"] == "thrown")
        if key not in seen:
            seen.add(key)
            scene, formulation, options = scene_of(case)
            simulate(scene, formulation, duration=scene.dt, sample=scene.dt, estimate_error=False, **options)


measure = functools.partial(stability.measure, scene_of=scene_of, reference_of=reference_of)


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all cases and count their outcomes."""
    warm_up()
    chosen = cases()
    if options.limit:
        chosen = chosen[:: max(1, len(chosen) // options.limit)]
    rows = run_all("space", chosen, measure, STORE / "stability_space.jsonl", options.workers, options.fresh)
    for row in rows:
        row["outcome"] = stability.outcome(row)
    names = [name for name in ("family", "method", *DEFAULTS) if name != "options"]
    stability.write_rows(options.out / "stability_space.csv", rows, ("tip_error", "turn_error"), names)
    counts = Counter(row["outcome"] for row in rows)
    verdicts = {f"no run in space is {word}": counts[word] == 0 for word in ("silently wrong", "broken")}
    return {**stability.report(rows, [], []), "verdicts": verdicts}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    return {"cases": stability.table_of_cases(found)}


if __name__ == "__main__":
    sys.exit(pages.run("stability_space", __doc__, measured, blocks, page="results/stability",
                       more=stability.FLAGS, workers=cores()))  # fmt: skip
