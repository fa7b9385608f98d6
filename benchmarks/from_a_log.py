"""Learn a policy for an arm that is known only from its log: docs/results/identification.md.

python -m benchmarks.from_a_log [--steps N] [--episodes N] [--page] [--out FOLDER] [--runs FOLDER]

The page explains the steps.
"""

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import pages
from benchmarks.circle import flexarm, strip_with
from benchmarks.machine import table
from flexarm_env import Encoder, JointTorque, LowPass, Scene, Sensors, StrainGauge, arms, simulate
from flexarm_env.files import write_text
from flexarm_env.identification import identify
from flexarm_env.time_functions import linear_table

ENV, DURATION = "FlexibleArm-v0", 4.0
CONFIG = Path(__file__).resolve().parents[1] / "configs/identify/strip.toml"


def true_arm() -> Any:
    """Return the true arm: the strip with factors 0.6 on EI, 1.6 on payload, 1.3 on hub inertia and 1.5 on damping."""
    return dataclasses.replace(strip_with(EI=0.6, hub=1.3, payload=1.6, damping=1.5), name="true")


def write_log(arm: Any, path: Path) -> None:
    """Write a log of 10 s under known torques: an encoder of 4096 counts, and a strain gauge with a low-pass filter.

    The filter has 30 Hz; the gauge has 1 % of white noise.
    """
    rng, t = np.random.default_rng(3), np.arange(1001) / 100
    torque = sum(0.25 * np.sin(w * t + rng.uniform(0, 6)) for w in np.geomspace(2.0, 60.0, 9)) * np.minimum(t, 1.0)
    gauge = StrainGauge(unit="strain", low_pass=LowPass(30.0, 2))
    own = Sensors((Encoder(counts=4096),), (gauge,))
    loads = (JointTorque(0, linear_table(t, torque)),)
    run = simulate(Scene("log", arm, duration=10.0, dt=0.0025, loads=loads), "elastica", sample=0.01)
    strain = run.measured(own)["strain_gauge_1"]
    strain = 1e6 * (strain + 0.01 * strain.std() * rng.normal(size=len(t)) + 2e-5)
    columns = np.array([t, torque, np.degrees(run.measured(own)["hub_angle"]), strain]).T
    text = "\n".join(["t,torque,hub,strain", *(",".join(f"{x:.8g}" for x in row) for row in columns)])
    write_text(path, text + "\n")


def measure(options: argparse.Namespace) -> pages.Found:
    """Write a log, fit the arm, train three policies, and evaluate them on the true arm."""
    folder, arm = options.runs, true_arm()
    write_text(folder / "true.toml", arms.to_toml(arm))
    write_log(arm, folder / "log.csv")
    found = identify("strip", CONFIG, [folder / "log.csv"], out=folder / "fit")
    print(json.dumps(found.lines(), indent=1), flush=True)
    kwargs: dict[str, dict[str, Any]] = {
        "fitted": {"arm": str(folder / "fit/arm.toml"), "randomization": found.ranges},
        "true": {"arm": str(folder / "true.toml")},
        "unfitted": {"arm": "strip"},
    }
    # policies are judged in whole episodes, not in the short ones that they were trained in
    judged = json.dumps({"arm": str(folder / "true.toml"), "duration": DURATION})
    rows = []
    for name, own in kwargs.items():
        given = json.dumps({"duration": 2.0, **own})
        flexarm("train", "--env", ENV, "--seed", "0", "--n-timesteps", str(options.steps), "--env-kwargs", given,
                "--no-tensorboard", "--out", str(folder / name))  # fmt: skip
        told_of = flexarm("evaluate", "--env", ENV, "--policy", str(folder / name), "--episodes", str(options.episodes),
                          "--env-kwargs", judged, "--json")  # fmt: skip
        rows.append({"policy": name, "judged": json.loads(told_of)})
        print(name, told_of, flush=True)
    fitted = zip(found.parameters, found.start, found.values, found.uncertainty.half, strict=True)
    parameters = [(p.name, float(a), float(x), float(half)) for p, a, x, half in fitted]
    return {"lines": found.lines(), "parameters": parameters, "ranges": found.ranges, "policies": rows}


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    arm = true_arm()
    truth = {"EI": arm.links[0].section.EI, "payload": arm.payload.mass, "tau_d": arm.tau_d, "hub": arm.hub_inertia}
    fitted = [
        (name, f"{a:.4g}", f"{x:.4g} ± {half:.2g}", f"{truth[name]:.4g}") for name, a, x, half in found["parameters"]
    ]
    judged = []
    for one in found["policies"]:
        row, success = one["judged"], f"{100 * one['judged']['success_rate']:.0f} %"
        vibration = f"{row['residual_vibration_median']:.2g}"
        judged.append((one["policy"], success, f"{row['settling_time_median']:.3g}", vibration))
    ranges = {name: tuple(bounds) for name, bounds in found["ranges"].items()}
    heads = "training arm | success on the true arm | settling time, s | residual vibration, mm"
    return {
        "fit": table("parameter | before the fit | fitted | true", fitted),
        "ranges": [f"The fit gives these ranges of factors for the option `randomization`: {ranges}."],
        "policies": table(heads, judged),
    }


if __name__ == "__main__":
    flags = {"runs": {"type": Path, "default": Path("runs/from_a_log"), "help": "folder of logs and policies"}}
    sys.exit(pages.run("from_a_log", __doc__, measure, blocks, page="results/identification",
                       packages=("stable-baselines3", "torch"), more=flags, steps=800_000, episodes=100))  # fmt: skip
