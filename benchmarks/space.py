"""Compare arms in space with known solutions, time their steps, and compare `three_dof` with a model of pitch alone.

python -m benchmarks.space [--out FOLDER] [--page] [--only PARTS ...]; figures to docs/figures.
"""

import argparse
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import flexarm_env as fx
from benchmarks import pages
from benchmarks.cost_model import in_lanes
from benchmarks.machine import DOCS, table
from flexarm_env import arms, scenes
from flexarm_env.envs.video import pictures, write_film
from flexarm_env.linear import campbell, modes
from flexarm_env.plotting import plot_campbell, plot_trajectory
from flexarm_env.simulation import Simulation
from flexarm_env.time_functions import constant, cycloid
from tests import space_answers as answers
from tests.oracle_space import SpatialOracle

Found = dict[str, Any]


def known_answers() -> list[list[Any]]:
    """Return table rows (case, known answer, computed answer, elements) of arms in space."""
    rows: list[list[Any]] = []
    for GJ, known in answers.BENT_45.items():
        coarse, fine = (answers.bend_of_45_degrees(GJ, elements=n) for n in (16, 32))
        for what, found, n in (("", fine, "32"), (", extrapolated", (4.0 * fine - coarse) / 3.0, "16, 32")):
            case = f"45° bend, GJ = {GJ:.5g}: tip's displacement{what}"
            rows.append([case, *(" ".join(f"{x:.4f}" for x in v) for v in (known, found)), n])
    closed = answers.off_a_circle(0.5 * math.pi, elements=6)
    rows.append(["pure moment 2π EI/L: tip's distance from the root", "0", f"{closed:.0e}", 6])
    for n in (4, 8, 16):
        apart = answers.off_a_helix(1e9, elements=n)
        rows.append(["helix under an end moment of 7 N m, EI = GJ = 2, L = 1: tip error, m", "0", f"{apart:.1e}", n])
    load = answers.buckling(3.95, 4.05, elements=16)
    rows.append(["lateral-torsional buckling, P L²/√(EI_w GJ)", f"{answers.BUCKLES}", f"{load:.4f}", 16])
    found = modes(answers.STRIP, 8, elements=12, clamped=True).frequencies / (2.0 * math.pi)
    for name, hertz in answers.STRIP_HZ.items():
        near = found[np.abs(found / hertz - 1.0).argmin()]
        rows.append([f"strip 0.5 × 0.05 × 0.002 m, {name}, Hz", f"{hertz:.5g}", f"{near:.6g}", 12])
    for spin in answers.FLAPS:
        pair = modes(answers.blade(), 2, elements=12, clamped=True, spin=spin).frequencies
        case = f"rotating cantilever, Ω = {spin:g}: lag, flap"
        rows.append([case, *(" ".join(f"{x:.5f}" for x in v) for v in (answers.lag_and_flap(spin), pair)), 12])
    return [*rows, *whirl(), *free_spin(), *free_arm(), *drawn_planes()]


def whirl() -> list[list[Any]]:
    """Return table rows: whirl of an overhung disc on a massless shaft, next to its torsion, and whirl of a shaft."""
    rows, spins, spin = list[list[Any]](), (15.0, 40.0), 0.2
    for turning, seen in zip(spins, campbell(answers.rotor(), spins, 5, elements=1).at_rest, strict=True):
        pair = (" ".join(f"{x:.4f}" for x in v) for v in (answers.whirl_of_the_rotor(turning), np.sort(seen)))
        rows.append([f"overhung disc spun at {turning:g} rad/s: whirl and torsion seen from rest, rad/s", *pair, 1])
    found = modes(answers.SHAFT, 2, elements=12, clamped=True, spin=spin).frequencies
    apart = abs(float(np.abs(found[1] - found[0])) - 2.0 * spin)  # the observer turns
    case = f"uniform shaft spun at {spin:g}: difference of its whirl frequencies (known to first order)"
    return [*rows, [case, f"{answers.split_of_whirls(spin):.5f}", f"{apart:.5f}", 12]]


def free_spin() -> list[list[Any]]:
    """Return table rows: free spin of a rigid body about its middle axis, compared with Euler's equations over a
    flip."""
    rows, off = [], []
    for h in (1e-3, 5e-4):
        scene, known = answers.tumbling(h)
        run = fx.simulate(scene, estimate_error=False, rho_inf=1.0)
        found = run.v[:, 3:6]
        off.append(float(np.abs(found - known).max()))
    least = int(known[:, 1].argmin())
    pair = (" ".join(f"{x:.4f}" for x in v[least]) for v in (known, found))
    rows.append([f"free spin about the middle axis, flipped at {run.t[least]:g} s, rad/s", *pair, "rigid"])
    two, order = " ".join(f"{x:.1e}" for x in off), f"{math.log2(off[0] / off[1]):.2f}"
    rows.append(["free spin: largest error in 6 s, rad/s, with steps of 1 and 0.5 ms", "0", two, "rigid"])
    rows.append(["its order in the step", "2", order, "rigid"])
    return rows


def frame() -> list[list[Any]]:
    """Return table rows of the right-angle frame: displacement of the tip, and of the corner along z.

    The known answer is a rod whose strains are polynomials with 8 coefficients; the rows give its distance from a rod
    with 6 coefficients and ten times the tolerance in time. Step and element length are halved together, and the
    results are extrapolated to second order.
    """
    scene, times, found = scenes.named("right_angle_frame"), np.array([2.0, 4.0, 8.0]), []
    rods = [SpatialOracle(scene, n, n + 4).run(times, rtol) for n, rtol in ((8, 1e-7), (6, 1e-6))]
    known, other = (np.column_stack([rod["tip"] - [10.0, 10.0, 0.0], rod["bent"][:, 0, 2]]) for rod in rods)
    for n, h in ((10, 0.01), (20, 0.005), (40, 0.0025)):
        one = dataclasses.replace(scene, dt=h, duration=8.0)
        run = fx.simulate(one, elements=n, estimate_error=False, rho_inf=1.0)
        at = [int(np.abs(run.t - t).argmin()) for t in times]
        found.append(np.column_stack([run.tip[at] - [10.0, 10.0, 0.0], run.hinges[at, 0, 2]]))
    rows = []
    for what, values, n in (("", found[0], "10"), (", extrapolated", (4.0 * found[2] - found[1]) / 3.0, "20, 40")):
        for t, one, less, own in zip(times, known, other, values, strict=True):
            pair = (" ".join(f"{x:.4f}" for x in v) for v in (one, own))
            told = f"right-angle frame at {t:g} s: tip's displacement, corner's z{what}"
            rows.append([f"{told} (known to {np.abs(one - less).max():.0e})", *pair, n])
    return rows


def free_arm() -> list[list[Any]]:
    """Return table rows of an undamped free arm after a push: the drift of momenta and energy over 100,000 steps.

    Further rows give the order at which the ripple decreases with the step. Momenta are derivatives of the kinetic
    energy by rigid motions.
    """
    same = {"elements": 2, "tolerance": 1e-11}
    long = answers.drift(2e-3, 200.0, 200, **same)
    halves = long[:100].max(axis=0), long[100:].max(axis=0)
    names, rows = ("linear momentum", "angular momentum", "energy"), []
    for i, name in enumerate(names):
        two = " ".join(f"{half[i]:.1e}" for half in halves)
        rows.append(
            [
                f"free arm over 100,000 steps of 2 ms: {name} error divided by its magnitude, in the first and "
                "second half",
                "0",
                two,
                2,
            ]
        )
    ripple = [answers.drift(h, 4.0, 100, **same).max(axis=0) for h in (4e-3, 2e-3, 1e-3)]
    for i in (1, 2):
        orders = " ".join(f"{math.log2(ripple[k][i] / ripple[k + 1][i]):.2f}" for k in range(2))
        sizes = ", ".join(f"{one[i]:.1e}" for one in ripple)
        rows.append([f"free arm: ripple of {names[i]} in 4 s, {sizes} at 4, 2, 1 ms: order", "2", orders, 2])
    return rows


def drawn_planes() -> list[list[Any]]:
    """Return table rows: a planar two-link arm, mounted in ten random planes in space, compared with the planar
    kernels.

    The arm has a payload beside its line, under gravity and a torque. The planar reference has 20 cubic elements; the
    tolerance is 1e-12.
    """
    s = answers.section(5.0, 2.0, 9.0)
    links, rows = (fx.Link(0.6, s), fx.Link(0.5, s)), []
    rest_of: dict[str, Any] = {"elbows": (fx.Elbow(0.2, 1e-3, 1e-3),), "payload": fx.Payload(0.3, 1e-3, (0.05, 0.02))}
    common: dict[str, Any] = {"duration": 0.4, "dt": 2e-3, "sample": 0.05, "loads": (fx.JointTorque(1, constant(0.7)),)}
    options: dict[str, Any] = {"estimate_error": False, "tolerance": 1e-12}
    flat = fx.Scene("flat", fx.Arm("a", links, **rest_of), gravity=(0.0, -9.81), angles=(0.3, 0.8), **common)
    fine = fx.simulate(flat, "geometrically_exact", elements=20, order=3, **options).tip[:, :2]
    own = np.pad(fine, ((0, 0), (0, 1)))
    for n in (4, 8, 16):
        found = []
        for turn in Rotation.random(10, random_state=0):
            arm = fx.Arm("a", links, hub_mount=turn.as_matrix().tolist(), **rest_of)
            gravity = tuple(turn.apply([0.0, -9.81, 0.0]).tolist())
            tilted = fx.Scene("turned", arm, gravity=gravity, angles=(0.3, 0.5), space=True, **common)
            found.append(turn.inv().apply(fx.simulate(tilted, elements=n, **options).tip))
        plane = fx.simulate(flat, "geometrically_exact", elements=n, **options).tip[:, :2]
        off, spread = (float(np.abs(np.array(found) - one).max()) / 1.1 for one in (own, found[0]))
        case = "two links in ten random planes: tip error, of L (planar solver with as many elements: "
        rows.append([f"{case}{np.abs(plane - fine).max() / 1.1:.1e})", "0", f"{off:.1e}", n])
        rows.append(
            [
                "two links in ten random planes: largest distance between the ten rotated-back tips, of L",
                "0",
                f"{spread:.1e}",
                n,
            ]
        )
    return rows


def beside_the_plane() -> list[list[Any]]:
    """Return table rows: scene, elements, tip errors in space and in the plane (over L), and ratios of CPU times.

    The ratios are those of a run of one arm, and of steps of eight arms in lanes.
    """
    slender = fx.Arm("arm", (fx.Link(1.0, answers.section(10.0, 5.0, stiff=1e7)),), payload=fx.Payload(0.2))
    motion = fx.Motion("joint0", cycloid(3.0, 0.5))
    turn = fx.Scene("turn", slender, duration=1.0, dt=1e-3, sample=0.05, motions=(motion,))
    names = ("robot_arm_motion_smooth", "two_link_motion", "two_link_free_flight", "spin_up")
    rows = []
    for scene in (turn, *map(_with_torsion, names)):
        options: dict[str, Any] = {"estimate_error": False}
        fine = fx.simulate(scene, "geometrically_exact", elements=20, order=3, **options).tip[:, :2]
        for n in (4, 8, 16):
            both = scene, dataclasses.replace(scene, space=True)
            pairs = [[fx.simulate(one, "geometrically_exact", elements=n, **options) for one in both] for _ in range(7)]
            runs = [min(of, key=lambda run: run.cpu_seconds) for of in zip(*pairs, strict=True)]
            plane, space = (float(np.abs(run.tip[:, :2] - fine).max()) / scene.arm.total_length for run in runs)
            meshes = [one.settings("geometrically_exact", elements=n) for one in both]
            times = [run.cpu_seconds for run in runs], in_lanes(list(map(Simulation, both, meshes)))
            ratios = (f"{of[1] / of[0]:.1f}" for of in times)
            rows.append([scene.name, n, f"{space:.1e}", f"{plane:.1e}", *ratios])
    return rows


def _with_sections(scene: fx.Scene, changes: Callable[[fx.Section], Found], **more: Any) -> fx.Scene:
    """Return a scene whose flexible sections have the changed values that `changes` returns."""

    def changed(link: Any) -> Any:
        if link.rigid:
            return link
        return dataclasses.replace(link, section=dataclasses.replace(link.section, **changes(link.section)))

    arm = dataclasses.replace(scene.arm, links=tuple(map(changed, scene.arm.links)))
    return dataclasses.replace(scene, arm=arm, **more)


def _with_torsion(name: str) -> fx.Scene:
    """Return a named planar scene with sections that can also bend and twist out of the plane."""
    return _with_sections(scenes.named(name), lambda s: {"EI_y": s.EI, "C_y": s.C, "J_y": s.J, "GJ": s.EI}, solver=())


def omission() -> Found:
    """Simulate `three_dof_slew` completely, without torsion, without lateral bending, and with pitch bending alone."""
    scene, found = scenes.named("three_dof_slew"), {}
    yaws, paths = {}, {}
    for name, factors in {
        "all": {}, "torsion 1e4 times as stiff": {"GJ": 1e4}, "lateral bending 1e4 times as stiff": {"EI_y": 1e4},
        "pitch bending alone": {"GJ": 1e4, "EI_y": 1e4},
    }.items():  # fmt: skip
        own = _with_sections(scene, lambda s, by=factors: {k: getattr(s, k) * f for k, f in by.items()})
        run = fx.simulate(own, elements=8, dt=2e-4, sample=2e-3, estimate_error=False)
        yaw = run.joint_angles[:, 0]
        out = np.abs(np.cos(yaw) * run.tip[:, 1] - np.sin(yaw) * run.tip[:, 0])
        after = run.t >= 0.2
        yaws[name], paths[name] = yaw, run.tip
        found[name] = {
            "yaw": float(np.abs(yaw).max()), "out": float(out.max()), "at": float(run.t[out.argmax()]),
            "after": float(out[after].max()), "twist": float(np.degrees(np.abs(run.twist).max())),
            "tips": float(np.linalg.norm(run.tip - paths["all"], axis=1).max()),
            "yaws": float(np.abs(yaw - yaws["all"]).max()),
        }  # fmt: skip
    bent = fx.Scene("t", arms.named("three_dof"), duration=1.0, dt=1e-3, angles=(0.0, math.pi / 2, -math.pi / 2))
    found["modes"] = (modes(bent, 5, elements=12, clamped=(0, 1, 2)).frequencies / (2.0 * math.pi)).tolist()
    return found


def floating() -> list[list[Any]]:
    """Return table rows of floating frames: segments, tip distance from the exact beam, largest bend and twist, CPU
    times.

    The CPU times are ratios: over the exact beam with as many elements, and over planar frames in a planar scene.
    """
    scene, rows = scenes.named("three_dof_slew"), []
    exact = fx.simulate(scene, elements=48, estimate_error=False)
    flat = _with_torsion("two_link_motion")

    def least(one: fx.Scene, formulation: str, **mesh: int) -> Any:
        runs = [fx.simulate(one, formulation, estimate_error=False, **mesh) for _ in range(3)]
        return min(runs, key=lambda run: run.cpu_seconds)

    for n in (2, 4, 8, 16):
        run, beam = least(scene, "floating_frame", segments=n), least(scene, "geometrically_exact", elements=n)
        pair = [least(s, "floating_frame", segments=n) for s in (flat, dataclasses.replace(flat, space=True))]
        off = float(np.abs(run.tip - exact.tip).max()) / scene.arm.total_length
        bent, twist = float(np.abs(run.tip_deflection).max()), float(np.degrees(np.abs(run.twist).max()))
        times = run.cpu_seconds / beam.cpu_seconds, pair[1].cpu_seconds / pair[0].cpu_seconds
        rows.append([n, f"{off:.1e}", f"{bent:.0%}", f"{twist:.1f}", *(f"{t:.1f}" for t in times)])
    return rows


def draw() -> None:
    """Draw the figures of the page."""
    figures = DOCS / "figures"
    for name in ("three_dof_slew", "right_angle_frame"):
        plot_trajectory(fx.simulate(scenes.named(name), estimate_error=False), figures / f"{name}.png")
    spins = np.linspace(0.0, 40.0, 81).tolist()
    whirls = campbell(answers.rotor(), spins, 5, elements=1)
    plot_campbell(whirls, figures / "campbell.png", "Overhung disc on a light shaft")
    film = fx.simulate(scenes.named("three_dof_slew"), estimate_error=False, sample=0.01)
    write_film(figures / "three_dof_slew.gif", pictures(film, 25.0, 0.25, (480, 480)), 25.0)


PARTS: dict[str, Any] = {
    "known": known_answers, "frame": frame, "plane": beside_the_plane, "omission": omission, "floating": floating,
}  # fmt: skip


def measure(options: argparse.Namespace) -> Found:
    """Measure the parts of the page that --only names; without --only all of them, with the figures."""
    if not options.only:
        draw()
    return pages.parts(options, "space", PARTS)


def blocks(found: Found) -> pages.Blocks:
    """Format the tables of the page."""
    cases = {k: v for k, v in found["omission"].items() if k != "modes"}
    heads = (
        "model | largest yaw, rad | tip out of the arm's plane, m | at time, s | out of the plane after the torque, "
        "m | largest twist, ° | "
        "tip distance from the first row, m | yaw difference from the first row, rad"
    )
    rows = [[name, *(f"{v[k]:.3f}" for k in ("yaw", "out", "at", "after")), f"{v['twist']:.1f}",
             *(f"{v[k]:.3f}" for k in ("tips", "yaws"))] for name, v in cases.items()]  # fmt: skip
    return {
        "KNOWN": table("case | known value | computed value | elements per link", [*found["known"], *found["frame"]]),
        "PLANE": table(
            "scene | elements per link | error in space | error in the plane | time of a run / time in the plane | "
            "the same ratio for eight arms in lanes",
            found["plane"],
        ),
        "FLOATING": table(
            "segments per link | distance from the exact beam's tip | largest deflection | largest twist, ° | "
            "time / time of the exact beam | time / time of planar frames",
            found["floating"],
        ),
        "OMISSION": table(heads, rows),
        "MODES": [
            "With the joints held, the first five natural frequencies are "
            + ", ".join(f"{x:.2f}" for x in found["omission"]["modes"])
            + " Hz."
        ],
    }


if __name__ == "__main__":
    only = {"nargs": "+", "choices": PARTS, "help": "measure only these parts of the page"}
    pages.run("space", __doc__, measure, blocks, more={"only": only})
