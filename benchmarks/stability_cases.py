"""Cases of the stability sweep: functions from numbers to a scene and settings.

Every arm has length 1 m, mass 1 kg and EI = 1 N m^2 in total. Times are therefore multiples of the first period T1 of
the clamped arm with its payload, torques are multiples of the strip's limit in units of EI / L (0.286), and stiffness
is given by EA L^2 / EI.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.scene import JointTorque, Load, Motion, PointLoad, Scene
from flexarm_env.settings import MOST_IN_SEGMENT
from flexarm_env.time_functions import TimeFunction, constant, cycloid, linear_table, pulse, ramp, sine, spin_up
from flexarm_env.time_functions import steps as stairs

Case = dict[str, Any]

TORQUE_LIMIT = 0.286
"""Torque limit of the strip, in units of EI / L."""

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "floating frame": ("floating_frame", {"segments": 5}),
    "modes": ("floating_frame", {"modes": 3}),
    "exact": ("geometrically_exact", {"elements": 5, "order": 2}),
    "elastica": ("elastica", {"nodes": 6}),
    "clamped frames": ("floating_frame", {"segments": 5, "frame": "root"}),
    "joined frames": ("floating_frame", {"segments": 5, "frame": "root", "multipliers": True}),
    "modes in segments": ("floating_frame", {"modes": 2, "segments": 3}),
    "clamped modes": ("floating_frame", {"modes": 3, "frame": "root"}),
    "one frame": ("floating_frame", {"segments": 1, "elements": 5, "frame": "root"}),
    "one frame, paper": ("floating_frame", {"segments": 1, "elements": 5, "frame": "root", "coupling": "paper"}),
    "one frame, linear": ("floating_frame", {"segments": 1, "elements": 5, "frame": "root", "coupling": "linear"}),
}
MAIN = ("floating frame", "modes", "exact", "elastica")
FORMS = ("clamped frames", "joined frames", "modes in segments", "clamped modes")
"""Variants of the floating frame besides those in MAIN."""

DEFAULTS: Case = {
    "drive": "pulse", "amplitude": 1.0, "dwell": 0.25, "slender": 1e6, "payload": 0.5, "zeta": 0.0, "mass_damping": 0.0,
    "links": 1, "hub": 0.1, "h": 0.01, "rho": None, "horizon": 3.0, "seed": 0, "gravity": 0.0, "options": {},
}  # fmt: skip


def period(case: Case) -> float:
    """Return the first period, s, of the clamped arm with its payload, by Rayleigh's quotient."""
    flexibility = 1.0 / 3.0 + 3.0 / case["slender"]
    return 2.0 * math.pi * math.sqrt(flexibility * (case["payload"] + 33.0 / 140.0))


def arm_of(case: Case) -> Arm:
    """Return the arm of a case: equal links with a uniform section."""
    n, slender = case["links"], case["slender"]
    section = Section(EI=1.0, EA=slender, C=slender / 3.0, m=1.0, J=1.0 / slender)
    tau = case["zeta"] * period(case) / math.pi
    elbows = tuple(Elbow(0.1, 0.001, 0.001) for _ in range(n - 1))
    return Arm(
        "case", (Link(1.0 / n, section),) * n, hub_inertia=case["hub"], elbows=elbows,
        payload=Payload(case["payload"], 0.01 * case["payload"]), tau_d=tau, mass_damping=case["mass_damping"],
    )  # fmt: skip


def switched(case: Case, joint: int, end: float) -> TimeFunction:
    """Return a torque of random sign that may change after each dwell time (a fraction of T1)."""
    rng = np.random.default_rng([case["seed"], joint])
    dwell = case["dwell"] * period(case)
    count = min(4000, max(1, math.ceil(end / dwell)))
    return stairs(np.arange(count) * dwell, case["amplitude"] * TORQUE_LIMIT * rng.choice([-1.0, 1.0], count))


def _jumps(case: Case, end: float) -> TimeFunction:
    """Return a piecewise linear hub motion with irregular kinks, some of which nearly coincide."""
    rng = np.random.default_rng(case["seed"])
    gaps = rng.exponential(case["dwell"] * period(case), 40)
    gaps[5::7] *= 1e-5
    t = np.concatenate([[0.0], np.cumsum(gaps + 1e-7)])
    t = t[t < end] if (t < end).sum() > 1 else t[:2]
    jumps = rng.normal(0.0, 0.1 * case["amplitude"], t.size - 1) * (np.diff(t) > 1e-3)
    return linear_table(t, np.cumsum([0.0, *jumps]))


def scene_of(case: Case) -> tuple[Scene, str, dict[str, Any]]:
    """Return the scene, formulation and options of a case."""
    formulation, options = METHODS[case["method"]]
    T, end, a = period(case), case["horizon"] * period(case), case["amplitude"]
    limit, omega = TORQUE_LIMIT * a, 2.0 * math.pi / period(case)
    arm, drive = arm_of(case), case["drive"]
    motions: tuple[Motion, ...] = ()
    loads: tuple[Load, ...] = ()
    root = "pinned"
    if drive == "pulse":
        loads = tuple(JointTorque(k, pulse(limit / 2**k, 0.25 * T)) for k in range(arm.n_links))
    elif drive == "bang":
        loads = tuple(JointTorque(k, switched(case, k, end)) for k in range(arm.n_links))
    elif drive == "ramp":
        motions = (Motion("joint0", ramp(0.5 * a * omega * T, 0.5 * T)),)
    elif drive == "cycloid":
        motions = (Motion("joint0", cycloid(a, T)),)
    elif drive == "spin":
        motions = (Motion("joint0", spin_up(a * omega, 2.0 * T)),)
    elif drive == "jumps":
        motions = (Motion("joint0", _jumps(case, end)),)
    elif drive == "root":
        motions = (Motion("root_x", sine(0.1 * a, 1.3 * omega)), Motion("root_y", ramp(0.2 * a, 0.7 * T)))
    elif drive == "elbow":
        motions = (Motion("joint1", ramp(0.5 * a, 0.5 * T)),)
        loads = (JointTorque(0, pulse(0.5 * limit, 0.4 * T)),)
    elif drive == "thrown":
        root = "free"
        loads = (PointLoad(0, "root", pulse(limit, 0.3 * T), None, pulse(-limit, 0.3 * T)),)
    elif drive == "gravity":  # the torque of nothing: no kernel of its own
        loads = (JointTorque(0, constant(0.0)),)
    else:
        raise ValueError(f"drive = {drive!r}: not known")
    gravity = (0.0, -case["gravity"]) if case["gravity"] else None
    h = case["h"] * T
    scene = Scene(
        "case", arm, duration=end, dt=min(h, end), sample=end / max(1, min(60, round(end / h))), root=root,
        motions=motions, loads=loads, gravity=gravity,
    )  # fmt: skip
    options = {**options, **case["options"], "dt": min(h, end)}
    if case["rho"] is not None:
        options["rho_inf"] = case["rho"]
    return scene, formulation, options


def reference_of(case: Case, fine: bool) -> tuple[Scene, dict[str, Any]]:
    """Return the scene of a case with the settings of its converged solution. fine False: settings of a coarser
    check."""
    scene = dataclasses.replace(scene_of(case)[0], name="reference")
    per_link = max(4 if fine else 2, math.ceil((12 if fine else 6) / case["links"]))
    h = min(period(case) / 800.0, 0.25 * scene.dt)
    if case["drive"] == "spin":
        h = min(h, period(case) / 200.0 / max(1.0, case["amplitude"]))
    return scene, {"elements": per_link, "order": 3, "rho_inf": 0.8, "dt": h if fine else 2.0 * h}


# ------------------------------------------------------------------- families
def cases(full: bool = False) -> list[Case]:
    """Return all different cases. full: about three times as many."""
    found: dict[str, Case] = {}
    for family, rows in FAMILIES.items():
        for row in rows(3 if full else 1):
            if "horizon" not in row:  # at most some thousand steps
                row["horizon"] = min(3.0, max(0.5, 3000.0 * row.get("h", DEFAULTS["h"])))
            case = {"family": family, **DEFAULTS, **row}
            found[repr(sorted(case.items()))] = case
    return list(found.values())


def grid(**axes: Any) -> Iterator[Case]:
    """Yield every combination of the axes' values as a dictionary."""
    for values in itertools.product(*axes.values()):
        yield dict(zip(axes, values, strict=True))


def _step(more: int) -> Iterator[Case]:
    h = np.geomspace(1e-4, 0.5, 10 * more).tolist()
    yield from grid(
        method=MAIN, h=h, rho=[0.0, 0.3, 0.6, 0.8, 0.9, 1.0], drive=["pulse", "ramp", "thrown"], amplitude=[0.3]
    )
    yield from grid(method=FORMS, h=h, rho=[0.0, 0.9, 1.0], drive=["pulse", "ramp"], amplitude=[0.3])


def _stiffness(more: int) -> Iterator[Case]:
    yield from grid(
        method=MAIN, slender=np.geomspace(1e1, 1e9, 8 * more + 1).tolist(),
        payload=np.geomspace(1e-4, 1e4, 9).tolist(), drive=["pulse", "ramp"], amplitude=[0.3],
    )  # fmt: skip
    yield from grid(
        method=FORMS, slender=np.geomspace(1e1, 1e9, 4 * more + 1).tolist(),
        payload=np.geomspace(1e-4, 1e4, 5).tolist(), drive=["pulse"], amplitude=[0.3],
    )  # fmt: skip


def _spin(more: int) -> Iterator[Case]:
    methods = (*MAIN, "one frame", "one frame, paper", "one frame, linear")
    rates = [0.1, 0.3, 0.6, 0.9, 1.2, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0]
    yield from grid(method=FORMS, amplitude=rates, h=np.geomspace(5e-4, 0.05, 3 * more).tolist(), drive=["spin"])
    yield from grid(method=methods, amplitude=rates, h=np.geomspace(5e-4, 0.05, 4 * more).tolist(), drive=["spin"],
                     slender=[1e3, 1e6])  # fmt: skip


def _bang(more: int) -> Iterator[Case]:
    yield from grid(
        method=(*MAIN, "one frame"), amplitude=np.geomspace(0.1, 100.0, 10).tolist(), dwell=[0.01, 0.1, 0.7],
        h=[0.002, 0.007, 0.03], drive=["bang"], seed=list(range(2 * more)),
    )  # fmt: skip
    yield from grid(method=FORMS, amplitude=np.geomspace(0.1, 100.0, 7).tolist(), dwell=[0.01, 0.7],
                     h=[0.002, 0.03], drive=["bang"], seed=list(range(more)))  # fmt: skip


def _damping(more: int) -> Iterator[Case]:
    zeta = [0.0, 1e-3, 0.01, 0.1, 0.5, 1.0, 2.0, 5.0]
    yield from grid(method=FORMS, zeta=zeta, h=np.geomspace(1e-3, 0.3, 4 * more).tolist(), drive=["pulse"],
                     amplitude=[0.5])  # fmt: skip
    yield from grid(method=MAIN, zeta=zeta, h=np.geomspace(1e-3, 0.3, 6 * more).tolist(), drive=["pulse", "ramp"],
                     amplitude=[0.5])  # fmt: skip
    yield from grid(method=["one frame", "clamped modes"], mass_damping=[0.01, 1.0, 30.0], h=[0.003, 0.03, 0.2],
                     drive=["pulse", "ramp"], amplitude=[0.5])  # fmt: skip


def _bent(more: int) -> Iterator[Case]:
    """Yield damped arms that their weight or full torques bend by at least a fifth of their length."""
    methods = (*MAIN, *FORMS, "one frame")
    zeta = [1e-3, 0.01, 0.05, 0.2, 1.0]
    yield from grid(method=methods, zeta=zeta, gravity=[0.7, 2.0], links=[1, 2], h=[0.002, 0.01],
                     drive=["gravity", "pulse"], amplitude=[0.5], horizon=[1.5])  # fmt: skip
    yield from grid(method=methods, zeta=zeta, drive=["bang"], dwell=[0.7], amplitude=[1.0, 2.5], h=[0.002, 0.01],
                     seed=list(range(more)))  # fmt: skip
    yield from grid(method=methods, zeta=zeta, drive=["root", "spin"], amplitude=[1.0], h=[0.002, 0.01])


def _sizes(more: int) -> Iterator[Case]:
    counts = [1, 2, 3, 5, 8, 16, 32, 64]
    kinds: list[tuple[str, list[Case]]] = [
        ("floating frame", [{"segments": s, "elements": e} for s in counts for e in (1, 2, 4)]),
        ("floating frame", [{"segments": 1, "elements": e} for e in counts if e <= MOST_IN_SEGMENT]),
        ("joined frames", [{"segments": s, "elements": e} for s in counts[:6] for e in (1, 2)]),
        ("modes", [{"modes": k} for k in range(1, 9)] + [{"modes": 2, "segments": s} for s in (2, 5, 16)]),
        ("exact", [{"elements": e, "order": p} for e in counts for p in (1, 2, 3)]),
        ("elastica", [{"nodes": k} for k in range(3, 13)]),
    ]
    for method, options in kinds:
        for given, amplitude, h in itertools.product(options, (0.3, 3.0), (0.01, 0.003)):
            bodies = given.get("segments", 1) * given.get("elements", 1)
            if bodies <= 64 or not method.endswith("frame"):
                yield {"method": method, "options": given, "amplitude": amplitude, "h": h, "horizon": 1.0}
    yield from (
        {**row, "horizon": 1.0, "hub": 0.02}
        for row in grid(method=MAIN, links=list(range(1, 9)), drive=["pulse", "ramp", "thrown"], amplitude=[0.3, 2.0],
                         h=[0.01, 0.002])
    )  # fmt: skip


def _kinks(more: int) -> Iterator[Case]:
    yield from grid(method=MAIN, drive=["jumps"], dwell=[0.003, 0.03, 0.3], h=[0.003, 0.02, 0.1], amplitude=[0.2, 2.0],
                     rho=[None, 1.0], seed=list(range(2 * more)))  # fmt: skip
    yield from grid(method=MAIN, drive=["root"], h=[0.002, 0.01, 0.05], amplitude=[0.2, 1.0, 5.0], rho=[None, 1.0])
    yield from grid(method=MAIN, drive=["elbow"], links=[2, 3], h=[0.002, 0.01, 0.05], amplitude=[0.2, 1.0, 5.0],
                     rho=[None, 1.0], horizon=[1.5])  # fmt: skip


def _gravity(more: int) -> Iterator[Case]:
    yield from grid(method=(*MAIN, *FORMS), drive=["gravity"], gravity=[0.1, 1.0, 10.0], h=[0.001, 0.01, 0.05],
                     links=[1, 2], rho=[None, 1.0], zeta=[1e-6, 0.05], horizon=[1.5])  # fmt: skip


def _fitted(more: int) -> Iterator[Case]:
    given = [{"step_tolerance": 10.0**-k} for k in ((3, 5) if more == 1 else (2, 3, 4, 5))]
    yield from grid(method=MAIN, drive=["pulse", "ramp", "bang", "jumps", "thrown"], h=[0.02, 0.1, 0.4],
                     amplitude=[0.3, 5.0], options=given, horizon=[1.5])  # fmt: skip


def _corrected(more: int) -> Iterator[Case]:
    """Yield cases of the exact beam with period correction and varied step, stiffness, drive and damping."""
    given: list[Case] = [{"period_correction": True}]
    yield from grid(method=["exact"], drive=["pulse", "ramp", "bang", "jumps"], options=given,
                     h=np.geomspace(1e-3, 0.5, 5 * more).tolist(), amplitude=[0.3, 2.0, 10.0],
                     rho=[None, 1.0, 0.0])  # fmt: skip
    yield from grid(method=["exact"], drive=["pulse", "thrown"], options=given, slender=[1e2, 1e4, 1e8],
                     h=[0.003, 0.03], links=[1, 2], horizon=[1.5])  # fmt: skip
    yield from grid(method=["exact"], drive=["pulse", "ramp"], options=given, zeta=[0.01, 0.5, 5.0],
                     h=[0.003, 0.03, 0.2], amplitude=[0.5], rho=[None, 1.0])  # fmt: skip
    yield from grid(method=["exact"], drive=["spin"], options=given, amplitude=[0.3, 1.2, 5.0], slender=[1e3, 1e6],
                     h=[0.002, 0.02], rho=[None, 0.9, 1.0])  # fmt: skip


def _random(more: int) -> Iterator[Case]:
    rng = np.random.default_rng(20261121)
    drives = ["pulse", "bang", "ramp", "cycloid", "spin", "jumps", "root", "thrown", "gravity"]
    for k in range(1600 * more):
        drive = str(rng.choice(drives))
        row = {
            "method": str(rng.choice(MAIN if k < 1200 * more else FORMS)),
            "drive": drive,
            "amplitude": float(10 ** rng.uniform(-1.5, 1.3)),
            "dwell": float(10 ** rng.uniform(-2.0, 0.0)),
            "slender": float(10 ** rng.uniform(1.0, 9.0)),
            "payload": float(10 ** rng.uniform(-4.0, 2.0)),
            "zeta": float(rng.choice([0.0, 10 ** rng.uniform(-3.0, 0.5)])),
            "links": int(rng.choice([1, 1, 1, 2, 3])),
            "hub": float(10 ** rng.uniform(-3.0, 1.0)),
            "h": float(10 ** rng.uniform(-3.0, -0.5)),
            "rho": None if rng.random() < 0.5 else float(rng.uniform(0.0, 1.0)),
            "gravity": float(rng.choice([0.0, 10 ** rng.uniform(-1.0, 1.0)])),
            "seed": k,
            "horizon": float(rng.uniform(0.5, 5.0)),
        }
        if drive == "thrown":  # fewer kinds of kernels
            row["zeta"] = row["gravity"] = 0.0
        elif row["gravity"]:
            row["zeta"] = max(row["zeta"], 1e-6)
        yield row


FAMILIES: dict[str, Callable[[int], Iterator[Case]]] = {
    "step": _step, "stiffness": _stiffness, "spin": _spin, "bang-bang": _bang, "damping": _damping,
    "damped and bent": _bent, "sizes": _sizes,
    "kinks": _kinks, "gravity": _gravity, "adaptive steps": _fitted, "period corrected": _corrected, "random": _random,
}  # fmt: skip
