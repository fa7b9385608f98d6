"""Arms of any stiffness under given torques, in environments and as scenes: right, reported, or silently wrong.

The strip turns for a second under half of its torque limit. In one series EI, EA and C are multiplied by
10^0 ... 10^14, in another EI alone, and in a third EA and C alone. With a large EI the arm is practically rigid and
turns by T t^2 / 2 I. With EA and C alone multiplied, the arm moves as the strip does. A run is wrong if the tip's angle
is off by more than 1 %, or if a kinetic energy is negative. A part of `benchmarks.stability`.
"""

import dataclasses
import itertools
import math
from collections import Counter
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.machine import table
from flexarm_env import arms
from flexarm_env.parameters import Arm
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import constant

FACTORS = [10.0**k for k in range(15)]
WHICH = {"EI, EA, C": (1, 1), "EI": (1, 0), "EA, C": (0, 1)}
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": ("elastica", {}),
    "exact": ("geometrically_exact", {}),
    "exact, long steps": ("geometrically_exact", {"dt": 0.02}),
    "floating frame": ("floating_frame", {}),
    "clamped frames": ("floating_frame", {"frame": "root"}),
    "joined frames": ("floating_frame", {"multipliers": True}),
    "modes in segments": ("floating_frame", {"modes": 2, "segments": 3}),
}
OUTCOMES = ("ok", "inaccurate", "refused", "failed", "silently wrong")
OFF = 0.01
SOFT = 1.4497
"""Tip angle, rad, that the strip reaches with its own stiffness."""


def arm_of(which: str, factor: float) -> Arm:
    """Return the strip with some of its stiffnesses multiplied by a factor."""
    strip = arms.named("strip")
    section = strip.links[0].uniform
    assert section is not None
    bend, along = (factor**power for power in WHICH[which])
    own = dataclasses.replace(section, EI=section.EI * bend, EA=section.EA * along, C=section.C * along)
    return dataclasses.replace(strip, links=(dataclasses.replace(strip.links[0], section=own),))


def wanted(which: str, factor: float) -> float:
    """Return the expected tip angle, rad: the strip's own angle if EI is unchanged, otherwise that of a rigid arm."""
    strip = arms.named("strip")
    inertia = strip.hub_inertia + strip.links[0].mass / 3.0 + strip.payload.mass + strip.links[0].rotary
    return SOFT if which == "EA, C" or factor == 1.0 else 0.5 / inertia


def outcome(status: str, angle: float, kinetic: float, right: float) -> str:
    """Classify a run: return one of OUTCOMES."""
    if status == "ok":
        return "ok" if abs(angle - right) <= OFF * right and kinetic >= 0.0 else "silently wrong"
    return "inaccurate" if status == "inaccurate" else "failed"


def in_environment(arm: Arm, formulation: str, options: dict[str, Any]) -> tuple[str, Any, float]:
    """Run FlexibleArm-v0 for 1 s; return its status, the tip position, m, and the smallest kinetic energy, J."""
    env = gym.make("FlexibleArm-v0", arm=arm, formulation=formulation, info_level="full", **options)
    env.reset(seed=0, options={"start": 0.0})
    least = math.inf
    for _ in range(50):
        *_, over, _, info = env.step(np.array([0.5], np.float32))
        least = min(least, info["energy_kinetic"])
        if over:
            break
    return info["solver_status"], info["tip_position"], least


def as_scene(arm: Arm, formulation: str, options: dict[str, Any]) -> tuple[str, Any, float]:
    """Run the same motion with `simulate`; return its status, the tip position, m, and the smallest kinetic energy,
    J."""
    load = JointTorque(0, constant(1.0))
    scene = Scene("stiff", arm, duration=1.0, dt=0.005, sample=0.05, loads=(load,))
    run = simulate(scene, formulation, time_limit=60.0, **options)
    return run.status, run.tip[-1, :2], float(run.kinetic.min())


WHERE = {"environment": in_environment, "scene": as_scene}


def cases() -> list[dict[str, Any]]:
    """Return all cases: environment or scene, method, multiplied stiffnesses and factor; the elastica varies EI
    only."""
    return [
        {"where": where, "method": method, "which": which, "factor": factor}
        for where, method, which, factor in itertools.product(WHERE, METHODS, WHICH, FACTORS)
        if (method, which) != ("elastica", "EA, C")
    ]


def measure(case: dict[str, Any]) -> dict[str, Any]:
    """Run a case and return its outcome."""
    which, factor = case["which"], case["factor"]
    try:
        status, (x, y), least = WHERE[case["where"]](arm_of(which, factor), *METHODS[case["method"]])
    except ValueError:
        return {"outcome": "refused"}
    return {"outcome": outcome(status, math.atan2(y, x), least, wanted(which, factor))}


def tallied(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Count the outcomes of each series over its factors, and find the largest factor with outcome "ok"."""
    lines: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        lines.setdefault(tuple(row["case"][key] for key in ("where", "method", "which")), []).append(row)
    return [
        {"line": key, "outcomes": dict(Counter(row["outcome"] for row in mine)),
         "right_up_to": max((row["case"]["factor"] for row in mine if row["outcome"] == "ok"), default=0.0)}
        for key, mine in lines.items()
    ]  # fmt: skip


def table_of(lines: list[dict[str, Any]]) -> list[str]:
    """Format the table of stiff arms."""
    cells = [
        (*line["line"], *(line["outcomes"].get(name, 0) for name in OUTCOMES), f"{line['right_up_to']:.0e}")
        for line in lines
    ]
    return table(" | ".join(["run in", "method", "scaled stiffness", *OUTCOMES, "correct up to the factor"]), cells)
