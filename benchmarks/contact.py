"""Compare contacts with known answers and other programs; measure steps, cost, hard cases: docs/results/contact.md.

    python -m benchmarks.contact [--only PART ...] [--exudyn PYTHON] [--page] [--out FOLDER]

The script takes about ten CPU minutes and needs MuJoCo (extra `mujoco`). `--exudyn` names an interpreter that has
Exudyn and computes Exudyn's answer; without `--exudyn` the recorded answer is used.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import exudyn_contact as peer
from benchmarks import pages
from benchmarks.contact_cases import DECADES, FORMULATIONS, KINDS, OUTCOMES, STRIP, sweep
from benchmarks.machine import table
from benchmarks.pages import Found
from flexarm_env import Arm, Contact, Link, Motion, Payload, PointLoad, Scene, Section, Simulation, arms, simulate
from flexarm_env.shapes import HalfSpace
from flexarm_env.time_functions import constant, cycloid
from tests.contact_tools import duration, iterations_of_a_step, reading
from tests.physics import test_contact as answers
from tests.physics import test_contact_formulations as formulations
from tests.physics.test_contact_free import ROD, G, L, M, sliding_rod

Array = NDArray[np.float64]
FLOOR = HalfSpace((0.0, 0.0), (0.0, 1.0))
MASS, SPEED, DAMPING = 0.5, 0.8, 0.4
"""Point mass (kg) that hits a floor, its speed (m/s) and the floor's damping (s/m)."""


def row(what: str, reference: str, value: float, exact: float, allowed: float, scale: float = 0.0) -> Found:
    """Return a comparison as a row; the error is relative to the exact value, or to `scale` if `scale` is not 0."""
    error = abs(value - exact) / (scale or abs(exact))
    return {"what": what, "reference": reference, "value": value, "exact": exact, "error": error, "allowed": allowed}


# --- known answers ---------------------------------------------------------------------------------------
def spring() -> Iterator[Found]:
    """Compare a point mass on a linear spring with half a period: impulse and final height."""
    mass, k, speed, start = 0.5, 2000.0, 0.05, 0.001
    scene = Scene(
        "spring", answers.bar(mass), duration=0.12, dt=2.5e-4, rates=(-speed,), angles=(start,),
        contacts=(Contact(FLOOR, k, exponent=1.0),),
    )  # fmt: skip
    found = reading(answers.moved(scene))
    yield row("mass on a linear spring: impulse, N s", "2 m v", float(found["impulse"]), 2.0 * mass * speed, 1e-3)
    height = speed * (0.12 - start / speed - math.pi * math.sqrt(mass / k))
    yield row(
        "the same mass: height at the end, m",
        "half an oscillation, then free flight",
        -float(found["penetration"]),
        height,
        1e-3,
    )


def restitutions() -> Iterator[Found]:
    """Compare coefficients of restitution with a scalar equation, for several impact speeds."""
    for speed in (0.05, 0.2, 0.8, 2.0):
        start = 0.02 * speed
        scene = Scene(
            "hit", answers.bar(MASS), duration=0.12, dt=5e-5, rates=(-speed,), angles=(start,),
            contacts=(Contact(FLOOR, 1e5, damping=DAMPING),),
        )  # fmt: skip
        value = float(answers.moved(scene).work.v[0]) / speed
        exact = answers.restitution(speed, 1e5, DAMPING, MASS, start)
        yield row(f"coefficient of restitution at {speed:g} m/s", "scalar equation", value, exact, 1e-4)


def pressed() -> Iterator[Found]:
    """Compare a strip that is turned against a floor and comes to rest with the static elastica."""
    EI, angle, k = 2.0, -0.5, 1e4
    contact = Contact(HalfSpace((0.0, -0.3), (0.0, 1.0)), k, damping=1.0)
    force, _, y = answers.pressed_strip(EI, angle, -0.3, k)
    arm = dataclasses.replace(STRIP, payload=Payload(), tau_d=0.05)
    turn = Motion("joint0", cycloid(angle + 0.29, 1.0, -0.29))
    scene = Scene("turned", arm, duration=6.0, dt=2e-3, angles=(-0.29,), motions=(turn,), contacts=(contact,))
    found = reading(answers.moved(scene, "geometrically_exact", elements=8, rho_inf=0.5))
    yield row("strip pressed on a floor: force, N", "static elastica, by shooting", float(found["normal"]), force, 1e-4)
    yield row(
        "the same strip: height of the tip, m", "static elastica", -0.3 - float(found["penetration"]), y, 1e-5, 1.0
    )


def cone() -> Iterator[Found]:
    """Compare a pressed tip below and above the friction cone: speed of creep, acceleration."""
    mass, mu, k, creep, down = 0.5, 0.5, 1e5, 1e-4, 10.0
    link = Link(1.0, Section(EI=1e4, EA=1e7, C=1e7, m=1e-4))
    floor = HalfSpace((0.0, (down / k) ** (2.0 / 3.0)), (0.0, 1.0))
    for push in (4.9, 5.1):
        scene = Scene(
            "pushed", Arm("two", (link, link), payload=Payload(mass=mass)), duration=0.2, dt=5e-4,
            angles=(math.pi / 3.0, -math.pi / 3.0), loads=(PointLoad(1, "tip", constant(push), constant(-down)),),
            contacts=(Contact(floor, k, damping=2.0, friction=mu, creep=creep),),
        )  # fmt: skip
        run = Simulation(scene, scene.settings("elastica", rho_inf=1.0))
        speeds = [float(reading(run)["sliding"]) for t in (0.1, 0.2) if run.advance_to(t)]
        if push < mu * down:
            exact = creep / math.sqrt((mu * down / push) ** 2 - 1.0)
            yield row(
                "tip pulled by 98 % of the friction limit: creep velocity, m/s",
                "regularized friction law",
                speeds[1],
                exact,
                5e-3,
            )
        else:
            value, exact = (speeds[1] - speeds[0]) / 0.1, (push - mu * down) / mass
            yield row(
                "tip pulled by 102 % of the friction limit: acceleration, m/s²", "Newton's law", value, exact, 1e-3
            )


def sticking() -> list[Found]:
    """What the scale of creep costs: a tip that friction holds at 40 % of the cone from a jump of the load on."""
    mass, mu, k, push, down, dt = 0.5, 0.5, 1e5, 2.0, 10.0, 5e-4
    link = Link(1.0, Section(EI=1e4, EA=1e7, C=1e7, m=1e-4))
    floor, found = HalfSpace((0.0, (down / k) ** (2.0 / 3.0)), (0.0, 1.0)), []
    for creep, rho in itertools.product((1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9), (1.0, 0.8)):
        scene = Scene(
            "held", Arm("two", (link, link), payload=Payload(mass=mass)), duration=0.2, dt=dt,
            angles=(math.pi / 3.0, -math.pi / 3.0), loads=(PointLoad(1, "tip", constant(push), constant(-down)),),
            contacts=(Contact(floor, k, damping=2.0, friction=mu, creep=creep),),
        )  # fmt: skip
        run = Simulation(scene, scene.settings("elastica", rho_inf=rho))
        start, forces = run.shape_points()[-1, 0], []
        for i in range(400):
            run.advance_to((i + 1) * dt)
            forces.append(float(reading(run)["tangential"]))
        found.append({
            "creep": creep, "rho_inf": rho, "moved": float(run.shape_points()[-1, 0] - start),
            "expected": 0.2 * creep / math.sqrt((mu * down / push) ** 2 - 1.0),
            "iterations": iterations_of_a_step(run), "ripple": float(np.ptp(forces[-4:]) / push),
        })  # fmt: skip
    return found


def bounces() -> Iterator[Found]:
    """Check the energy balance over a hundred impacts without loss."""
    drop = 0.02
    scene = Scene(
        "bouncing", answers.bar(MASS), duration=14.8, dt=1.25e-4, sample=0.01, angles=(drop,), gravity=(0.0, -9.81),
        contacts=(Contact(FLOOR, 1e6),),
    )  # fmt: skip
    run = simulate(scene, "elastica", rho_inf=1.0, estimate_error=False)
    exchanged = MASS * 9.81 * drop * 100
    yield row(
        "largest energy error in 100 impacts without loss, J",
        "energy balance",
        float(abs(run.balance).max()),
        0.0,
        1e-4,
        exchanged,
    )


def falling(mu: float = 0.2, theta: float = 0.6, t: Array | None = None) -> Any:
    """Return the run of a stiff rod that falls while the rod's tip slides on a floor. mu: coefficient of friction."""
    force, _ = sliding_rod(theta, mu, np.array([0.0, 0.25]))
    scene = Scene(
        "rod", ROD, duration=0.25, dt=2.5e-4, sample=0.01, root="free", gravity=(0.0, -G), angles=(math.pi + theta,),
        position=(L * math.cos(theta), L * math.sin(theta) - (force / 1e7) ** (2.0 / 3.0)),
        contacts=(Contact(FLOOR, 1e7, damping=20.0, friction=mu, creep=1e-5),),
    )  # fmt: skip
    return simulate(scene, "elastica", rho_inf=1.0, estimate_error=False)


def rods() -> Iterator[Found]:
    """Compare a free rod that falls and slides with a rigid rod, without and with friction."""
    for theta, mu in ((1.0, 0.0), (0.6, 0.2)):
        run = falling(mu, theta)
        _, (angle, center) = sliding_rod(theta, mu, run.t)
        found = run.link_angles[:, 0, 0] - math.pi
        swing = theta - angle[-1]
        what = f"rod that falls and slides, friction {mu:g}: angle, rad"
        yield row(what, "rigid rod", float(found[-1]), float(angle[-1]), 4e-4, swing)
        if mu:
            middle = 0.5 * (run.tip[-1, 0] + run.shapes[-1, 0, 0] - L * math.cos(theta))
            yield row(
                "the same rod: displacement of its center, m", "rigid rod", float(middle), float(center[-1]), 1e-2
            )


def known() -> list[Found]:
    """Return the comparisons with all known answers."""
    makers = (spring, restitutions, pressed, cone, bounces, rods)
    return [one for make in makers for one in make()]


# --- other programs --------------------------------------------------------------------------------------
def mujoco_rod(theta: float, mu: float, times: Array, dt: float = 2e-5) -> Array:
    """Return angle (rad) and displacement of the center (m) of the falling rod in MuJoCo, (times, 2).

    solref contains stiffness and damping per effective mass; the friction is an elliptic cone with soft constraints.
    """
    import mujoco

    contact = f'solref="-1e7 -6e3" solimp="0.9999 0.9999 0.001" friction="{mu} 0 0" condim="3"'
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{dt}" cone="elliptic" impratio="100" iterations="200" tolerance="1e-14" gravity="0 0 {-G}"/>
      <worldbody><geom type="plane" size="3 3 .1" {contact}/><body pos="0 0 {0.5 * L * math.sin(theta) + 1e-4}">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="{M}" diaginertia="1 {M * L * L / 12} 1"/>
      <geom type="sphere" size="1e-4" pos="{-0.5 * L} 0 0" {contact}/></body></worldbody></mujoco>""")
    data, found = mujoco.MjData(model), []
    data.qpos[2] = -theta
    for t in times:
        while data.time < t - 1e-9:
            mujoco.mj_step(model, data)
        found.append((-data.qpos[2], data.qpos[0]))
    return np.array(found)


def exudyn_tips(options: argparse.Namespace) -> Any:
    """Return Exudyn's tips of the strip that falls on a floor: computed with --exudyn, otherwise the recorded tips."""
    if options.exudyn:
        script = str(Path(peer.__file__))
        run = subprocess.run([options.exudyn, script], check=True, capture_output=True, text=True)
        return json.loads(run.stdout)
    return pages.kept(options.out, "contact").get("exudyn_tips")


def others(tips: Any) -> list[Found]:
    """Compare the falling rod with MuJoCo, and the falling strip with Exudyn's tips."""
    theta, mu = 0.6, 0.2
    run = falling(mu, theta)
    angle, center = mujoco_rod(theta, mu, run.t).T
    found, swing = run.link_angles[:, 0, 0] - math.pi, theta - angle[-1]
    middle = 0.5 * (run.tip[:, 0] + run.shapes[:, 0, 0] - L * math.cos(theta))
    rows = [
        {"what": "rod that falls and slides: angle, as a fraction of its rotation", "peer": "MuJoCo",
         "apart": float(abs(found - angle).max() / swing), "allowed": 5e-4},
        {"what": "the same rod: displacement of its center, m", "peer": "MuJoCo",
         "apart": float(abs(middle - center).max()), "allowed": 2e-4},
        {"what": "the same rod, MuJoCo compared with a rigid rod: angle, as a fraction of its rotation",
         "peer": "MuJoCo",
         "apart": float(abs(angle - sliding_rod(theta, mu, run.t)[1][0]).max() / swing), "allowed": 5e-4},
    ]  # fmt: skip
    if tips is None:
        return rows
    arm = Arm("strip", (Link(peer.LENGTH, Section(EI=peer.EI, EA=peer.EA, C=1e8, m=peer.MASS)),), tau_d=peer.TAU)
    floor = HalfSpace((0.0, peer.FLOOR), (0.0, 1.0))
    scene = Scene(
        "falls", arm, duration=peer.DURATION, dt=1e-4, sample=peer.SAMPLE, gravity=(0.0, -peer.G),
        motions=(Motion("joint0", constant(0.0)),), contacts=(Contact(floor, peer.STIFFNESS, damping=peer.DAMPING),),
    )  # fmt: skip
    for formulation, mesh in (("elastica", {"nodes": 9}), ("geometrically_exact", {"elements": 10})):
        run = simulate(scene, formulation, rho_inf=0.9, estimate_error=False, **mesh)
        apart = float(abs(run.tip[:, :2] - np.array(tips[-1])).max())
        what = f"strip that falls on a floor, {formulation}: tip, m"
        rows.append({"what": what, "peer": "Exudyn", "apart": apart, "allowed": 3e-5})
    return rows


def agreement() -> list[Found]:
    """Compare the falling strip in all formulations with the elastica of the finest mesh."""
    exact, found = formulations.tips(False, "elastica", formulations.REFERENCE), []
    for space, formulation, mesh, coarse in formulations.MESHES:
        errors = [formulations.apart(space, formulation, one, exact) for one in (coarse, mesh)]
        allowed = errors[0] / 2**formulations.ORDER + formulations.ROUND_OFF
        cells = {"formulation": formulation, "space": space, "mesh": mesh, "coarse": errors[0], "apart": errors[1]}
        found.append({**cells, "allowed": allowed})
        print(found[-1], flush=True)
    return found


# --- steps -----------------------------------------------------------------------------------------------
COUNTS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Tested numbers of steps in an impact."""
PLACES = (0.0, 0.25, 0.5, 0.75)
"""Tested beginnings of the impact, as fractions of a step."""


def mass_needs(k: float) -> Found:
    """Count the steps in a point mass's impact for errors of 1 % of restitution and of peak force. k: N/m^1.5."""
    contact = Contact(FLOOR, k, damping=DAMPING, speed=SPEED)
    lasts = duration(contact, MASS)
    exact, fine = [], []
    errors: dict[int, tuple[float, float]] = {}
    for count in (1024, *COUNTS):
        dt = lasts / count
        worst = [0.0, 0.0]
        for i, place in enumerate(PLACES):
            start = SPEED * dt * (1.0 + place)
            scene = Scene(
                "hit", answers.bar(MASS), duration=4.0 * lasts + 2.0 * dt, dt=dt, rates=(-SPEED,), angles=(start,),
                contacts=(contact,),
            )  # fmt: skip
            run = Simulation(scene, scene.settings("elastica", rho_inf=1.0))
            if not run.advance_to(scene.duration):
                worst = [math.inf, math.inf]
                break
            found = float(run.work.v[0]) / SPEED, float(reading(run)["peak"])
            if count == 1024:
                exact.append(answers.restitution(SPEED, k, DAMPING, MASS, start))
                fine.append(found[1])
            worst[0] = max(worst[0], abs(found[0] / exact[i] - 1.0))
            worst[1] = max(worst[1], abs(found[1] / fine[i] - 1.0))
        errors[count] = worst[0], worst[1]
    need = [next((c for c in COUNTS if max(errors[d][i] for d in COUNTS if d >= c) <= 0.01), None) for i in (0, 1)]
    return {
        "k": k, "lasts": lasts, "restitution": need[0], "peak": need[1], "at_8": errors[8],
        "dt": None if need[0] is None else lasts / need[0],
    }  # fmt: skip


def strip_needs(k: float) -> Found:
    """Find the longest step (s) for an error of 1 % of a strip's first impulse, and the longest permitted step."""
    contact, rate = Contact(FLOOR, k, damping=DAMPING, speed=SPEED), SPEED
    # the step at which `simulate` refuses: where an impact on the effective mass of that step lasts 8 steps
    permitted, dt = None, 4e-3
    found: list[tuple[float, float]] = []
    lasts = 2.0 * duration(contact, 0.17)
    start, end = 2e-3, 2e-3 / rate + 2.5 * lasts + 2e-4
    while dt > lasts / 400.0 or len(found) < 3:
        scene = Scene("strip", STRIP, duration=end, dt=dt, rates=(-rate,), angles=(start,), contacts=(contact,))
        settings = scene.settings("elastica", rho_inf=0.9, nodes=9)
        if permitted is None:
            try:
                simulate(scene, "elastica", duration=dt, rho_inf=0.9, nodes=9, estimate_error=False)
                permitted = dt
            except ValueError:
                pass
        run = Simulation(scene, settings)
        good = run.advance_to(end)
        found.append((dt, float(reading(run)["impulse"]) if good else math.nan))
        dt *= 0.5
    exact = found[-1][1]
    # the longest step from which on all shorter ones are within 1 %
    bad = [dt for dt, value in found[:-2] if not abs(value / exact - 1.0) <= 0.01]
    good = [dt for dt, _ in found[:-2] if dt < min(bad, default=math.inf)]
    return {"k": k, "permitted": permitted, "needed": max(good, default=None), "impulse": exact}


def steps() -> Found:
    """Measure the steps that contacts need, for each stiffness of `DECADES`."""
    found: Found = {"mass": [], "strip": []}
    for k in DECADES:
        found["mass"].append(mass_needs(k))
        print(found["mass"][-1], flush=True)
    for k in DECADES[:-1]:
        found["strip"].append(strip_needs(k))
        print(found["strip"][-1], flush=True)
    return found


# --- cost ------------------------------------------------------------------------------------------------
def seconds(scene: Scene, formulation: str) -> float:
    """Return the CPU time of a step, s, the smallest of several runs."""
    run = Simulation(scene, scene.settings(formulation))
    run.advance_to(scene.dt)
    least = math.inf
    for _ in range(9):
        run.reset()
        before = time.thread_time()
        assert run.advance_to(scene.duration), run.message
        least = min(least, time.thread_time() - before)
    return least / round(scene.duration / scene.dt)


def cost() -> list[Found]:
    """Measure the CPU time of a step, µs, without contacts, with untouched and with touching contacts."""
    found = []
    for name, normal in (("strip", (0.0, 1.0)), ("three_dof", (0.0, 0.0, 1.0))):
        arm, space = arms.named(name), len(normal) == 3
        angles = (0.2, 1.5, 0.3) if space else (0.0,)
        # the tips are at (0.97, 0.20, 0.072) and (1, 0)
        places = (("untouched", -1.0), ("touching", 0.071 if space else -1e-6))
        for formulation in FORMULATIONS:
            cells: Found = {"arm": name, "formulation": formulation}
            for what, height in (("none", None), *places):
                at = [h * height for h in normal] if height is not None else []
                contact = Contact(HalfSpace(at, normal), 1e4, damping=5.0, friction=0.3) if at else ()
                gravity = (0.0, 0.0, -9.81) if space else (0.0, -9.81)
                scene = Scene(
                    "cost", arm, duration=0.1, dt=5e-4, angles=angles, contacts=contact, gravity=gravity,
                    motions=tuple(Motion(f"joint{k}", constant(a)) for k, a in enumerate(angles)),
                )  # fmt: skip
                cells[what] = 1e6 * seconds(scene, formulation)
            print(cells, flush=True)
            found.append(cells)
    return found


# --- the page --------------------------------------------------------------------------------------------
def measure(options: argparse.Namespace) -> Found:
    """Measure all parts, or the parts that --only names, and evaluate the verdicts."""
    tips = exudyn_tips(options)
    makers: dict[str, Callable[[], Any]] = {
        "sticking": sticking, "known": known, "others": lambda: others(tips), "agreement": agreement,
        "steps": steps, "cost": cost, "sweep": sweep,
    }  # fmt: skip
    found = pages.parts(options, "contact", makers)
    found["exudyn_tips"] = tips
    found["verdicts"] = {
        "all known answers within their tolerances": all(one["error"] <= one["allowed"] for one in found["known"]),
        "other programs within the stated distances": all(one["apart"] <= one["allowed"] for one in found["others"]),
        "all formulations agree": all(one["apart"] <= one["allowed"] for one in found["agreement"]),
        "no hard case is silently wrong": all(one["outcome"] != "silently wrong" for one in found["sweep"]),
    }
    return found


def _step(value: float | None) -> str:
    """Format a step in ms."""
    return "none" if value is None else f"{1e3 * value:.3g}"


def blocks(found: Found) -> pages.Blocks:
    """Format the tables of the page."""
    answers_of = [
        (one["what"], one["reference"], f"{one['value']:.6g}", f"{one['exact']:.6g}", f"{one['error']:.1e}",
         f"{one['allowed']:.0e}") for one in found["known"]
    ]  # fmt: skip
    apart = [(one["what"], one["peer"], f"{one['apart']:.1e}", f"{one['allowed']:.0e}") for one in found["others"]]
    agreeing = [
        (one["formulation"], "space" if one["space"] else "plane",
         ", ".join(f"{count} {name}" for name, count in one["mesh"].items()),
         f"{1e6 * one['coarse']:.2g}", f"{1e6 * one['apart']:.2g}", f"{1e6 * one['allowed']:.2g}")
        for one in found["agreement"]
    ]  # fmt: skip
    masses = [
        (f"{one['k']:.0e}", f"{1e3 * one['lasts']:.3g}", one["restitution"], one["peak"],
         f"{100 * one['at_8'][0]:.2g} %, {100 * one['at_8'][1]:.2g} %", _step(one["dt"]))
        for one in found["steps"]["mass"]
    ]  # fmt: skip
    strips = [
        (f"{one['k']:.0e}", _step(one["permitted"]), _step(one["needed"]), f"{one['impulse']:.4g}")
        for one in found["steps"]["strip"]
    ]
    times = []
    for one in found["cost"]:
        cells = (f"{one[word]:.2f} ({one[word] / one['none']:.2f})" for word in ("untouched", "touching"))
        times.append((one["arm"], one["formulation"], f"{one['none']:.2f}", *cells))
    hard_cases = []
    for kind in KINDS:
        own = [one["outcome"] for one in found["sweep"] if one["kind"] == kind]
        hard_cases.append((kind, len(own), *(own.count(word) for word in OUTCOMES)))
    held = [
        (f"{one['creep']:.0e}", one["rho_inf"], f"{1e6 * one['moved']:.3g}", f"{1e6 * one['expected']:.3g}",
         f"{one['iterations']:.2f}", f"{100 * one['ripple']:.1g} %") for one in found["sticking"]
    ]  # fmt: skip
    return {
        "sticking": table(
            "creep, m/s | ρ∞ | displacement of the tip, µm | displacement by the friction law, µm | "
            "Newton iterations per step | ripple of the friction force",
            held,
        ),
        "known": table("scene | reference | computed | exact | error | allowed", answers_of),
        "others": table("scene | program | largest difference | allowed", apart),
        "agreement": table(
            "formulation | computed in | mesh | half the mesh: difference, µm | difference, µm | allowed, µm", agreeing
        ),
        "mass": table(
            "stiffness k, N/m^1.5 | duration of the impact, ms | steps for 1 % error of restitution | "
            "steps for 1 % error of the peak force | both errors with 8 steps | "
            "time step for 1 % error of restitution, ms",
            masses,
        ),
        "strip": table(
            "stiffness k, N/m^1.5 | longest permitted time step, ms | "
            "longest time step for 1 % error of the impulse, ms | impulse, N s",
            strips,
        ),
        "cost": table(
            "arm | formulation | no contacts, µs per step | no point touches, µs per step (ratio) | "
            "points touch, µs per step (ratio)",
            times,
        ),
        "sweep": table(f"scene | cases | {' | '.join(OUTCOMES)}", hard_cases),
    }


if __name__ == "__main__":
    more: dict[str, Any] = {
        "only": {
            "nargs": "*",
            "choices": ("sticking", "known", "others", "agreement", "steps", "cost", "sweep"),
            "help": "measure only these parts",
        },
        "exudyn": {"help": "Python interpreter that has Exudyn"},
    }
    sys.exit(pages.run("contact", __doc__, measure, blocks, packages=("mujoco",), more=more))
