"""Hard cases of contact for `benchmarks.contact`: stiffness over eight decades, jamming, crushing, huge torques.

Each case runs with a step of 1 ms, or the longest permitted step, and is compared with a quarter of the step.
"""

import dataclasses
import itertools
from typing import Any

import numpy as np

from benchmarks.pages import Found
from flexarm_env import Arm, Contact, Link, Motion, Payload, Scene, Section, simulate
from flexarm_env.scene import JointTorque
from flexarm_env.shapes import HalfSpace
from flexarm_env.time_functions import constant, ramp, sine

FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")
STRIP = Arm("strip", (Link(1.0, Section(EI=2.0, EA=1e8, C=1e8, m=0.2)),), payload=Payload(mass=0.1), tau_d=2e-3)
DECADES = [10.0**k for k in range(2, 11)]
WRONG = 0.05
"""Error of the tip over the arm's length above which a result without a report is silently wrong."""
LEAST_DT = 2e-5


def hard(kind: str, k: float, dt: float) -> Scene:
    """Return the scene of a hard case. kind: one of `KINDS`. k: stiffness of the contacts, N/m^1.5. dt: step, s."""
    more: Found = {"gravity": (0.0, -9.81)}
    law: Found = {"damping": 0.3, "friction": 0.3}
    arm = dataclasses.replace(STRIP, payload=Payload(mass=0.1, radius=0.02))

    def wall(height: float, up: bool = True, **changes: Any) -> Contact:
        normal = (0.0, 1.0 if up else -1.0)
        return Contact(HalfSpace((0.0, height), normal), k, **{**law, **changes})

    if kind == "drop":
        walls = [wall(-0.1)]
    elif kind == "grazing":
        # the tip swings back at -0.0501 m when its root is held
        walls, more["motions"] = [wall(-0.2722)], (Motion("joint0", constant(0.0)),)
    elif kind == "jammed":
        walls, more["loads"] = [wall(-0.015), wall(0.015, up=False)], (JointTorque(0, sine(1.0, 40.0)),)
    elif kind == "begins inside":
        walls = [wall(0.0)]
    elif kind == "crushed":
        moving = wall(0.05, up=False, displacement_y=ramp(-0.2, 0.1))
        walls = [wall(-0.05), moving]
    elif kind == "huge torque":
        walls, more["loads"] = [wall(-0.05)], (JointTorque(0, constant(-20.0)),)
    else:
        walls = [wall(-0.1, friction=1.0, creep=1e-7)]
    return Scene(kind, arm, duration=0.15, dt=dt, sample=0.005, contacts=tuple(walls), **more)


KINDS = ("drop", "grazing", "jammed", "begins inside", "crushed", "huge torque", "sticky")
OUTCOMES = ("right", "reported", "failed with a reason", "refused", "not judged", "silently wrong")


def outcome(kind: str, k: float, formulation: str) -> Found:
    """Run a hard case with 1 ms or the longest permitted step; classify the case by a run with shorter steps."""
    dt, refused = 1e-3, False
    while True:
        try:
            run = simulate(hard(kind, k, dt), formulation, time_limit=60.0)
            break
        except ValueError as error:
            refused, dt = True, 0.5 * dt
            if dt < LEAST_DT:
                return {"kind": kind, "k": k, "formulation": formulation, "outcome": "refused", "why": str(error)}
    found: Found = {"kind": kind, "k": k, "formulation": formulation, "dt": dt, "refused_at_1ms": refused}
    if run.status not in ("ok", "inaccurate"):
        return {**found, "outcome": "failed with a reason", "why": run.message}
    scene = hard(kind, k, 0.25 * dt)
    judge = simulate(scene, formulation, estimate_error=False, time_limit=60.0)
    rows = min(len(judge.tip), len(run.tip))
    apart = float(np.abs(run.tip[:rows, :2] - judge.tip[:rows, :2]).max())
    finite = bool(np.isfinite(run.tip).all())
    right = finite and apart <= WRONG
    word = "reported" if run.status == "inaccurate" else "right" if right else "silently wrong"
    if word == "right" and not judge.finished:
        word = "not judged"
    return {**found, "outcome": word, "apart": apart, "estimate": run.error_estimate}


def sweep() -> list[Found]:
    """Run and classify all hard cases."""
    found = []
    for kind, formulation, k in itertools.product(KINDS, FORMULATIONS, DECADES):
        found.append(outcome(kind, k, formulation))
        print(found[-1], flush=True)
    return found
