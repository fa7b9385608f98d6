"""Environments under stress: episodes of randomly drawn arms, with the settings that an environment chooses.

    python -m benchmarks.stability_envs [--arms N] [--seed S] [--only KIND ...] [--workers N] [--fresh] [--page]
        [--out FOLDER]

Arms, their features and their torque limits are random. Each arm runs eight episodes of 100 control periods, with
actions that are uniform or from {-1, 1} and are held for 1 or 8 periods. The tip is compared with two reference runs,
exact beams with small steps (`FINE`). An episode is evaluated if both reference runs reach the end of the episode and
agree within 0.5 % of the arm's length throughout. An error counts as reported in four cases: `make` warned or rejected
the arm, info was out of range, the episode ended with a reason, or `info["error_estimate"]` is at least the error.
"""

import argparse
import math
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

import flexarm_env
from benchmarks import pages
from benchmarks.machine import table
from benchmarks.running import STORE, cores, run_all
from flexarm_env import Arm, Joint, Link, Motor, Payload, Section, arms
from flexarm_env.parameters import Elbow, RigidLink, Taper

IDS = {
    "one": "FlexibleArm-v0",
    "two": "TwoLinkFlexArm-v0",
    "three": "MultiLinkFlexArm-v0",
    "space": "SpatialFlexArm-v0",
}
LINKS = {"one": 1, "two": 2, "three": 3, "space": 2}
FORMULATIONS = ("elastica", "geometrically_exact", "floating_frame")
FEATURES = ("plain", "gear", "play", "friction", "motor", "stepped", "tapered", "loop")
PERIODS, LANES = 100, 8
SPREAD, LARGE, SMALL = 0.005, 0.05, 0.01
FINE = ({"elements": 8, "steps": 64}, {"elements": 12, "steps": 128})
FINE_IN_SPACE = ({"elements": 4, "steps": 32}, {"elements": 6, "steps": 64})
"""Meshes and steps of the two reference runs in space: elements per link, and steps per control period."""
MATERIALS = ((70e9, 2700.0, 26e9), (205e9, 7850.0, 79e9), (2.5e9, 1200.0, 0.9e9))
"""Young's modulus E (Pa), density rho (kg/m^3) and shear modulus G (Pa) of aluminium, steel and plastic."""
Draw = np.random.Generator
Case = dict[str, Any]


def decades(draw: Draw, low: float, high: float) -> float:
    """Return a random number whose logarithm is uniform."""
    return float(np.exp(draw.uniform(math.log(low), math.log(high))))


def strip(draw: Draw, length: float, feature: str) -> Link:
    """Return a random strip of one of the materials: uniform, stepped or tapered."""
    E, rho, G = MATERIALS[draw.integers(3)]
    thickness = decades(draw, 0.0015, 0.008) * length
    width = max(decades(draw, 0.02, 0.1) * length, 2.0 * thickness)
    made = partial(Section.rectangle, width=width, E=E, rho=rho, G=G, kappa=0.85)
    share = float(draw.uniform(0.4, 0.9))
    if feature == "tapered":
        return Link(length, Taper((width, width), (thickness, share * thickness), E, rho, G, 0.85))
    if feature == "stepped":
        thick, thin, at = made(thickness=thickness), made(thickness=share * thickness), float(draw.uniform(0.2, 0.8))
        return Link(length, ((0.0, thick), (at * length, thick), (at * length, thin), (length, thin)))
    return Link(length, made(thickness=thickness))


def joint(draw: Draw, feature: str, inertia: float, torque: float) -> Joint:
    """Return a random joint with a gear, backlash, friction or a motor.

    inertia: inertia, kg m^2, of all bodies beyond the joint. torque: torque limit, N m.
    """
    if feature in ("gear", "play", "loop"):
        play = decades(draw, 1e-3, 0.1) if feature == "play" else 0.0
        stiffness = torque / decades(draw, 1e-3, 0.3)
        rotor = inertia * decades(draw, 1e-3, 1.0)
        damping = 2.0 * decades(draw, 0.003, 0.1) * math.sqrt(stiffness * rotor)
        return Joint(stiffness=stiffness, damping=damping, motor_inertia=rotor, backlash=play)
    if feature == "friction":
        return Joint(
            friction_coulomb=torque * decades(draw, 0.01, 0.95), friction_viscous=torque * decades(draw, 1e-4, 0.1)
        )
    if feature == "motor":
        ratio = decades(draw, 1.0, 100.0)
        current = torque / ratio / 0.05
        motor = Motor(
            torque_constant=0.05, resistance=decades(draw, 0.3, 3.0) / current, voltage_limit=3.0, current_limit=current
        )
        return Joint(motor_inertia=inertia * decades(draw, 1e-4, 1.0) / ratio**2, gear_ratio=ratio, motor=motor)
    return Joint()


def drawn(kind: str, seed: int) -> tuple[Arm, str]:
    """Return a random arm of a kind, and the name of its feature."""
    draw, count = np.random.default_rng([seed, LINKS[kind], kind == "space"]), LINKS[kind]
    feature = "plain" if kind == "space" or draw.random() < 0.4 else str(draw.choice(FEATURES[1:]))
    links = tuple(strip(draw, decades(draw, 0.2, 2.0), feature) for _ in range(count))
    mass, length = sum(link.mass for link in links), sum(link.length for link in links)
    payload = float(draw.uniform(0.0, 3.0)) * mass
    whole = (mass / 3.0 + payload) * length**2
    softest = [float(link.along(np.linspace(0.0, link.length, 9)).EI.min()) for link in links]
    torques = [decades(draw, 0.02, 1.2) * EI / link.length for EI, link in zip(softest, links, strict=True)]
    torques.sort(reverse=True)
    first = links[0]
    slow = 3.516 * math.sqrt(softest[0] / first.mass / first.length**3 / (1.0 + 4.0 * payload / mass))
    tau_d = float(draw.choice([0.0, 0.002, 0.01, 0.02])) * 2.0 / slow
    hub = decades(draw, 0.01, 1.0) * whole
    elbows = tuple(
        Elbow(mass=float(draw.uniform()) * mass, inertia_left=decades(draw, 1e-3, 0.1) * first.mass * first.length**2,
              inertia_right=decades(draw, 1e-3, 0.1) * first.mass * first.length**2) for _ in range(count - 1)
    )  # fmt: skip
    if kind == "space":
        base = arms.named("three_dof")
        pillar = RigidLink(0.2 * length, mass, (0.1 * length, 0.0, 0.0), hub)
        limits = (2.0 * torques[0], *torques)
        return replace(base, links=(pillar, *links), elbows=(base.elbows[0], *elbows), tau_d=tau_d,
                       payload=Payload(payload), torque_limits=limits, source=""), feature  # fmt: skip
    inertias = [whole + hub, *([0.3 * whole] * (count - 1))]
    joints = tuple(joint(draw, feature, I, tau) for I, tau in zip(inertias, torques, strict=True))
    plain = feature in ("plain", "stepped", "tapered")
    return Arm("drawn", links, hub_inertia=hub, elbows=elbows, payload=Payload(payload), tau_d=tau_d,
               torque_limits=tuple(torques), joints=() if plain else joints), feature  # fmt: skip


def actions(seed: int, count: int) -> Any:
    """Return actions (PERIODS, LANES, count): uniform or from {-1, 1}, held for 1 or 8 periods."""
    draw, found = np.random.default_rng([seed, 1]), np.zeros((PERIODS, LANES, count), np.float32)
    for i in range(LANES):
        held = (1, 8)[i % 2]
        one = draw.uniform(-1.0, 1.0, (PERIODS // held + 1, count))
        found[:, i] = np.repeat(np.sign(one) if i // 2 % 2 else one, held, axis=0)[:PERIODS]
    return found


def run(kind: str, arm: Arm, given: Any, mode: str, **options: Any) -> dict[str, Any]:
    """Run eight episodes of an arm; return tips, ends, warnings, steps per period and the error estimate.

    Tip positions (PERIODS, LANES, 2 or 3), m, are NaN from an episode's end on.
    """
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        env = gym.make_vec(
            IDS[kind], num_envs=LANES, arm=arm, threads=1, info_level="numbers", action_mode=mode,
            vectorization_mode="vector_entry_point", autoreset_mode="Disabled", duration=1e3, **options,
        )  # fmt: skip
    start = [0.0] * arm.n_links
    target = {"target": 0.5} if kind == "one" else {}
    env.reset(seed=1, options={"start": start if arm.n_links > 1 else 0.0, **target})
    tips, ended, inside = [], np.zeros(LANES, bool), np.ones(LANES, bool)
    for one in given:
        _, _, terminated, _, info = env.step(one)
        ended |= terminated
        inside &= np.asarray(info["in_range"], bool) | ended
        tips.append(np.where(ended[:, None], np.nan, info["tip_position"]))
        if ended.all():
            break
        if terminated.any():
            env.reset(options={"reset_mask": terminated})
    settings = env.unwrapped.plan.settings
    steps = round(env.unwrapped.plan.period / settings.dt)
    env.close()
    tips += [np.full_like(tips[0], np.nan)] * (PERIODS - len(tips))
    warned = [str(one.message) for one in said if "Resolution" in one.category.__name__]
    return {"tips": np.array(tips), "ended": ended, "inside": inside, "warned": warned, "steps": steps,
            "estimate": float(np.max(info["error_estimate"]))}  # fmt: skip


def apart(one: Any, two: Any, length: float) -> Any:
    """Return the largest tip distance of each episode over the arm's length; NaN if an episode has ended early."""
    return np.max(np.linalg.norm(one - two, axis=2), axis=0) / length


def measure(case: Case) -> dict[str, Any]:
    """Run one arm under all formulations; return the errors of its episodes, and which errors were reported."""
    kind, begun = case["kind"], time.process_time()
    arm, feature = drawn(kind, case["seed"])
    mode = {"motor": "voltage", "loop": "residual_pd"}.get(feature, "torque")
    given, period = actions(case["seed"], arm.n_links), 0.01 if kind == "space" else 0.02
    row: dict[str, Any] = {"feature": feature}
    try:
        fine = [
            run(kind, arm, given, mode, formulation="geometrically_exact", elements=one["elements"],
                dt=period / one["steps"], tolerance=1e-9)
            for one in (FINE_IN_SPACE if kind == "space" else FINE)
        ]  # fmt: skip
    except ValueError as error:
        return row | {"refused": str(error)}
    spread = apart(fine[0]["tips"], fine[1]["tips"], arm.total_length)
    judged = spread <= SPREAD
    row |= {"judged": int(judged.sum()), "runs": {}}
    for formulation in FORMULATIONS[kind == "space" :]:
        try:
            one = run(kind, arm, given, mode, formulation=formulation)
        except ValueError as error:
            row["runs"][formulation] = {"refused": str(error)}
            continue
        error = apart(one["tips"], fine[1]["tips"], arm.total_length)[judged]
        told = one["ended"] | ~one["inside"] | bool(one["warned"])
        row["runs"][formulation] = {
            "errors": [None if math.isnan(x) else float(f"{x:.3g}") for x in error],
            "told": told[judged].tolist(), "ended": int(one["ended"][judged].sum()),
            **{name: one[name] for name in ("steps", "warned", "estimate")},
        }  # fmt: skip
    return row | {"cpu": round(time.process_time() - begun, 2)}


def cases(arms_: int, seed: int, only: Sequence[str] | None) -> list[Case]:
    """Return the cases: `arms_` arms with one link, 3/7 as many with two, and 1/40 each with three and in space."""
    counts = {"one": arms_, "two": arms_ * 3 // 7, "three": arms_ // 40, "space": arms_ // 40}
    return [
        {"kind": kind, "seed": seed + i} for kind, n in counts.items() if not only or kind in only for i in range(n)
    ]


def tally(rows: Sequence[dict[str, Any]]) -> list[Any]:
    """Count the evaluated episodes of `rows` and their large and unreported errors.

    Returns:
        Number of evaluated episodes; number that ended early; percentages with an error above 5 % and above 1 %;
        percentages with such an error that was not reported; numbers of arms with a warning and of rejected arms;
        median and 95 % percentile of the steps per control period.
    """
    found = [one for row in rows for one in row]
    known = [one for one in found if "errors" in one]
    errors = np.array([math.nan if x is None else x for one in known for x in one["errors"]])
    quiet = np.array([
        not told and not (x is not None and x <= one["estimate"])
        for one in known for x, told in zip(one["errors"], one["told"], strict=True)
    ], bool)  # fmt: skip
    steps = [one["steps"] for one in known] or [0]
    share = [100.0 * float((errors > most).mean()) if errors.size else 0.0 for most in (LARGE, SMALL)]
    unsaid = [100.0 * float((quiet & (errors > most)).mean()) if errors.size else 0.0 for most in (LARGE, SMALL)]
    return [errors.size, sum(one["ended"] for one in known), *share, *unsaid, sum(bool(one["warned"]) for one in known),
            len(found) - len(known), float(np.median(steps)), float(np.percentile(steps, 95))]  # fmt: skip


HEAD = (
    "environment, formulation | judged episodes | episodes that ended early | error > 5 %, % of judged episodes | "
    "error > 1 % | unreported error > 5 % | unreported error > 1 % | arms with a warning | rejected arms | "
    "steps per period, median | 95th percentile"
)


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all cases and count their errors."""
    todo = cases(options.arms, options.seed, options.only)
    flexarm_env.Settings.make("elastica")
    rows = run_all("environments", todo, measure, STORE / "stability_envs.jsonl", options.workers, options.fresh)
    counts: dict[str, list[Any]] = {}
    for kind in IDS:
        for formulation in FORMULATIONS:
            own = [list(row["runs"].values()) and [row["runs"][formulation]] for row in rows
                   if row["case"]["kind"] == kind and formulation in row.get("runs", {})]  # fmt: skip
            if own:
                counts[f"{IDS[kind]}, {formulation}" if kind != "three" else f"three links, {formulation}"] = tally(own)
    for feature in FEATURES:
        own = [list(row["runs"].values()) for row in rows if row["feature"] == feature and "runs" in row]
        if own:
            counts[f"feature: {feature}"] = tally(own)
    every = tally([list(row["runs"].values()) for row in rows if "runs" in row])
    verdicts = {
        "error above 5 % unreported in at most 0.1 % of the judged episodes": every[4] <= 0.1,
        "error above 1 % unreported in at most 1 %": every[5] <= 1.0,
    }
    return {"arms": len(rows), "episodes": LANES * len(rows), "seed": options.seed, "counts": counts, "all": every,
            "verdicts": verdicts}  # fmt: skip


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    rows = [[key, *map(pages.short, counts)] for key, counts in {**found["counts"], "all": found["all"]}.items()]
    return {"counts": [f"The {found['arms']} arms were drawn from seed {found['seed']}; each ran eight episodes "
                       "under each formulation.", "",
                       *table(HEAD, rows)]}  # fmt: skip


MORE: dict[str, dict[str, Any]] = {
    "fresh": {"action": "store_true", "help": "delete the intermediate results of an earlier run"},
    "only": {"nargs": "+", "choices": tuple(IDS), "help": "only these kinds of arms"},
}

if __name__ == "__main__":
    sys.exit(pages.run("stability_envs", __doc__, measured, blocks, more=MORE, workers=cores(), arms=170, seed=9000))
