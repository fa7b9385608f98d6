"""Test the 95 % intervals and unidentifiable parameters of `flexarm identify`: docs/results/identification.md.

python -m benchmarks.identification [--cases N] [--page] [--out FOLDER]     an interrupted run can be continued

Each case draws a strip (EI, payload and tau_d within 8 % of the nominal values), a smooth hub motion of nine sines, and
1 % of white noise on a filtered strain gauge with an offset. Three parameters are fitted, starting from the nominal
strip. A second fit adds the mass per length. With a prescribed hub angle, only the ratios of this mass to stiffness and
payload are identifiable.

A case with torques has the log of another solver. A strip, every second one with a gear, has EI, payload, tau_d and hub
inertia between 0.62 and 1.62 times the nominal values. The log's arm is an exact beam, simulated with a thirtieth of
the sampling interval as step, and driven by nine sines of torque. An encoder of 4096 counts and a noisy gauge are read
at 100 or 200 Hz. The fit starts from the nominal arm, with the default step and mesh.

A case in space draws a boom on a rotating pillar, with yaw and shoulder joints, under gravity. The fitted parameters
are the boom's bending stiffnesses in both planes, its torsional stiffness, the payload, tau_d and the shoulder's gear.
The log contains three gauges and the motors' angles.
"""

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.machine import describe_machine, table, told, write_text
from flexarm_env import Arm, Elbow, Joint, JointTorque, Link, Payload, RigidLink, Scene, Section, arms, simulate
from flexarm_env.identification.channels import deviations
from flexarm_env.identification.config import read_config
from flexarm_env.identification.discretization import refined, resolve
from flexarm_env.identification.fit import Problem, Solver
from flexarm_env.identification.log import Run
from flexarm_env.identification.model import Experiment
from flexarm_env.identification.uncertainty import uncertainty
from flexarm_env.time_functions import linear_table

CASES = 100
CONFIG = """
skip = 0.3
starts = 2
[inputs]
joint0 = "hub"
[outputs]
strain_gauge_1 = "strain"
[sensors]
strain_gauges = [{ gain = 0.3, low_pass = { frequency = 20.0, order = 2 } }]
[solver]
nodes = 4
dt = 0.005
[parameters]
"links[0].section.EI" = { name = "EI", low = 1.0, high = 30.0 }
"payload.mass" = { name = "payload", low = 0.01, high = 1.0 }
"tau_d" = { name = "tau_d", low = 1e-5, high = 0.05 }
"links[0].section.m" = { name = "m", low = 0.05, high = 1.0 }
"""
SPACE = """
skip = 0.3
starts = 2
gravity = [0.0, 0.0, -9.81]
[inputs]
joint0 = "yaw"
motor1 = "shoulder"
[outputs]
strain_gauge_1 = "up"
strain_gauge_2 = "across"
strain_gauge_3 = "twist"
[sensors]
strain_gauges = [
    { link = 1, place = 0.1, low_pass = { frequency = 30.0, order = 2 } }, { link = 1, place = 0.1, measures = "xz" },
    { link = 1, place = 0.3, measures = "torsion" },
]
[solver]
elements = 2
dt = 0.005
[parameters]
"links[1].section.EI" = { name = "EI", low = 5.0, high = 500.0 }
"links[1].section.EI_y" = { name = "EI_y", low = 5.0, high = 500.0 }
"links[1].section.GJ" = { name = "GJ", low = 1.0, high = 100.0 }
"payload.mass" = { name = "payload", low = 0.01, high = 1.0 }
"tau_d" = { name = "tau_d", low = 1e-5, high = 0.05 }
"joints[1].stiffness" = { name = "gear", low = 40.0, high = 4000.0 }
"""
BOOM = Arm(
    "boom",
    (
        RigidLink(0.3, mass=2.0, centre=(0.15, 0.0, 0.0), inertia=0.02),
        Link(0.8, Section.rectangle(width=8e-3, thickness=5e-3, E=70e9, rho=2700.0, G=26e9)),
    ),
    elbows=(Elbow(mount=((1.0, 0.0, 0.0), -np.pi / 2)),),
    payload=Payload(0.15, 1e-4, (0.0, 0.03, 0.02)),
    tau_d=2e-3,
    joints=(Joint(), Joint(stiffness=400.0, damping=0.2)),
    hub_axis=(1.0, 0.0, 0.0),
    hub_mount=((0.0, 1.0, 0.0), -np.pi / 2),
)
BY_TORQUES = """
starts = 2
skip = 0.1
[inputs]
torque0 = "torque"
[outputs]
hub_angle = { column = "hub", offset = 0.0 }
strain_gauge_1 = "strain"
[sensors]
encoders = [{}]
strain_gauges = [{ low_pass = { frequency = 30.0, order = 2 } }]
[parameters]
"links[0].section.EI" = { name = "EI", low = 1.0, high = 60.0 }
"payload.mass" = { name = "payload", low = 0.01, high = 3.0 }
"tau_d" = { name = "tau_d", low = 1e-5, high = 0.05 }
"hub_inertia" = { name = "hub", low = 0.005, high = 0.5 }
"""
OF_HUB = ("EI", "payload", "tau_d", "hub")
TOLD, RATIOS = ("EI", "payload", "tau_d"), ("EI", "payload", "m")
IN_SPACE = ("EI", "EI_y", "GJ", "payload", "tau_d", "gear")


def turns(rng: np.random.Generator, t: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Return a smooth random motion of a joint, rad, that starts from rest."""
    waves = zip(rng.normal(0, 1, 9), rough + rng.uniform(-2, 2, 9), rng.uniform(0, 6, 9), strict=True)
    return np.asarray(np.minimum(t, 1.0) ** 3 * sum(a * np.sin(w * t + p) / w for a, w, p in waves))


def drawn(
    seed: int, arm: Arm, text: str, names: Sequence[str], joints: Sequence[str], seconds: float, rough: np.ndarray
) -> tuple[Problem, np.ndarray]:
    """Simulate a log of an arm with random parameters; return the fitting problem and the true parameter values.

    names: names of the random parameters.
    """
    rng, t = np.random.default_rng(seed), np.arange(round(100 * seconds) + 1) / 100
    config = read_config(text, arm)
    motions = {joint: turns(rng, t, rough) for joint in joints}
    experiment = Experiment(arm, config, config.chosen(tuple(names)))
    truth = experiment.start * rng.uniform(0.92, 1.08, len(names))
    silent = Run("case", t, motions, {channel.name: t for channel in config.outputs}, t >= config.skip)
    fine = Problem(experiment, [])
    for kind in () if config.axes == "xyz" else ("step", "step", "step", "mesh"):
        fine = refined(fine, kind)
    read = fine.experiment.predict(truth, silent)
    noisy = {name: y + 0.01 * y.std() * rng.normal(size=len(t)) + rng.normal() for name, y in read.items()}
    return Problem(experiment, [dataclasses.replace(silent, outputs=noisy)]), truth


def by_torques(seed: int) -> tuple[Problem, np.ndarray]:
    """Simulate a log of a torque-driven exact beam with random parameters; return the fitting problem and the true
    values."""
    rng = np.random.default_rng(seed)
    usual = arms.named("strip_geared" if seed % 2 else "strip")
    factors = 2.0 ** rng.uniform(-0.7, 0.7, len(OF_HUB))
    config = read_config(BY_TORQUES, usual)
    experiment = Experiment(usual, config, config.chosen(OF_HUB), ["case"])
    truth = experiment.start * np.append(factors, 1.0)
    rate = float(rng.choice([100.0, 200.0]))
    t = np.arange(round(3.0 * rate) + 1) / rate
    waves = (0.25 * np.sin(w * t + rng.uniform(0.0, 6.0)) for w in np.geomspace(2.0, 50.0, 9))
    torque = sum(waves) * np.minimum(t, 1.0)
    arm = experiment.arm_of(truth)
    loads = (JointTorque(0, linear_table(t, torque)),)
    scene = Scene("log", arm, duration=float(t[-1]), dt=1.0 / (30.0 * rate), loads=loads)
    options = {"elements": 5, "order": 3, "rho_inf": 0.9, "estimate_error": False}
    read = simulate(scene, "geometrically_exact", sample=1.0 / rate, **options).measured(arm.sensors)
    count, strain = 2.0 * np.pi / 4096.0, read["strain_gauge_1"]
    outputs = {
        "hub_angle": np.round(read["hub_angle"] / count) * count,
        "strain_gauge_1": strain + 0.01 * strain.std() * rng.normal(size=len(t)) + 2e-5,
    }
    return Problem(experiment, [Run("case", t, {"torque0": torque}, outputs, t >= config.skip)]), truth


def case_by_torques(seed: int) -> dict[str, Any]:
    """Fit a log with torques; return whether each 95 % interval contains the true value, and the suspected channels."""
    problem, truth = by_torques(seed)
    row = found_of(problem, truth)[1]
    return {"seed": seed, **row}


def found_of(problem: Problem, truth: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Solve a fitting problem; return the fitted values, and whether each 95 % interval contains the true value."""
    solver = Solver(problem)
    resolved = resolve(solver, solver.run())
    problem, worth = resolved.problem, resolved.uncertainty
    values = problem.values(resolved.fit.z)
    names = [p.name for p in problem.experiment.parameters]
    told = [one.sentence for one in deviations(problem, resolved.fit.z) if one.contradicts]
    return values, {
        "holds": dict(zip(names, (np.abs(values - truth) < worth.half).tolist(), strict=True)),
        "width": dict(zip(names, (worth.half / values).tolist(), strict=True)),
        "error": dict(zip(names, (values / truth - 1.0).tolist(), strict=True)),
        "untold": list(worth.unidentifiable), "suspect": told,
        "refinements": problem.experiment.refinements,
    }  # fmt: skip


def case(seed: int) -> dict[str, Any]:
    """Fit a log with a prescribed hub angle; return the fit's results and the parameters that it reports as
    unidentifiable."""
    arm = arms.named("strip")
    problem, truth = drawn(seed, arm, CONFIG, TOLD, ["joint0"], 4.0, np.linspace(4, 65, 9))
    values, row = found_of(problem, truth)
    wide = dataclasses.replace(problem.experiment.config, starts=1, evaluations=8)
    usual = problem.experiment.arm_of(values)
    both = Problem(Experiment(usual, wide, wide.chosen((*TOLD, "m"))), problem.runs)
    named = uncertainty(both, Solver(both).run().z).unidentifiable
    return {"seed": seed, **row, "named": list(named)}


def case_in_space(seed: int) -> dict[str, Any]:
    """Fit a log of the boom in space; return whether each 95 % interval contains the true value."""
    problem, truth = drawn(seed, BOOM, SPACE, IN_SPACE, ["joint0", "motor1"], 2.0, np.linspace(3, 40, 9))
    return {"seed": seed, **found_of(problem, truth)[1]}


def table_of(rows: list[dict[str, Any]], names: Sequence[str]) -> list[str]:
    """Format a table: for each parameter, the number of cases whose interval contains the true value."""
    summary = []
    for name in names:
        held = sum(row["holds"][name] for row in rows)
        width = float(np.median([row["width"][name] for row in rows]))
        error = float(np.sqrt(np.mean([row["error"][name] ** 2 for row in rows])))
        cells = (f"{100 * width:.2g} %", f"{100 * error:.2g} %", f"{width / (1.96 * error):.2f}")
        summary.append((f"`{name}`", f"{held} of {len(rows)}", *cells))
    heads = (
        "parameter | true value within the 95 % interval | median half width of the interval | root-mean-square error"
    )
    return table(f"{heads} | half width / (1.96 × error)", summary, True)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows, space, torques = found["cases"], found["space"], found["torques"]
    suspect = sum(bool(row["suspect"]) for row in torques)
    right = sum(set(row["named"]) == set(RATIOS) for row in rows)
    rash, missed = (sum(bool(row["untold"]) for row in of) for of in (rows, space))
    return {
        "intervals": table_of(rows, TOLD),
        "untold": [f"The report names exactly these three parameters in {right} of {len(rows)} cases. "
                   f"The number of cases in which the report names a parameter that the log determines is {rash}."],
        "torques": [
            *table_of(torques, OF_HUB), "",
            f"In {suspect} of {len(torques)} cases the report suspected an error of a log column or of the clock. "
            "The fit halved the time step "
            f"{np.mean([row['refinements']['step'] for row in torques]):.1f} times on average.",
        ],
        "space": [
            *table_of(space, IN_SPACE), "",
            f"The report named a parameter as undetermined in {missed} of {len(space)} cases.", "",
            told(found["space_machine"]),
        ],
    }  # fmt: skip


def measure(options: argparse.Namespace) -> pages.Found:
    """Run all cases that an interrupted run has not computed."""
    found = {"cases": [], "space": [], "torques": [], **pages.begun(options.out, "identification")}
    clock = time.perf_counter()
    for key, one in (("cases", case), ("space", case_in_space), ("torques", case_by_torques)):
        if options.only and key not in options.only:
            continue
        for seed in sorted({*range(options.cases)} - {row["seed"] for row in found[key]}):
            found[key].append(one(seed))
            write_text(options.out / "identification.json", json.dumps(found, indent=1) + "\n")
            print(f"{key}, seed {seed} of {options.cases}, {time.perf_counter() - clock:.0f} s", flush=True)
    return {key: found[key] for key in ("cases", "space", "torques")} | {"space_machine": describe_machine("scipy")}


if __name__ == "__main__":
    flags = {"only": {"choices": ("cases", "space", "torques"), "action": "append", "help": "only these cases"}}
    sys.exit(pages.run("identification", __doc__, measure, blocks, packages=("scipy",), more=flags, cases=CASES))
