"""Measure the cost of each feature for arms that have it and for arms that lack it: docs/results/cost_model.md.

    python -m benchmarks.ablation [--rounds 7] [--page] [--out FOLDER]

For arms that have the feature, the script times a control period of 64 arms on one thread, and of a single environment,
alternately with and without the feature. For arms that lack it, the cost should be zero, because features are
compile-time tags. The step of an arm without these features is compiled twice: from the present kernels, and from a
copy without the lines for the features. Callgrind counts the instructions of both copies.
"""

import argparse
import ast
import dataclasses
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium as gym

import flexarm_env
from benchmarks import pages
from benchmarks.machine import table
from benchmarks.running import periods
from flexarm_env import arms, scenes, simulate
from flexarm_env.parameters import Payload

STRIP = arms.resolve("strip")
BARE = dataclasses.replace(STRIP, tau_d=0.0, payload=Payload())
NOISE = {"noise": {"hub_rate": 1e-2, "tip_deflection": 1e-4}, "delay": 0.02}

FEATURES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gravity": ({"gravity": (0.0, -9.81)}, {}),
    "damping": ({}, {"arm": dataclasses.replace(STRIP, tau_d=0.0)}),
    "payload": ({"arm": dataclasses.replace(BARE, payload=STRIP.payload)}, {"arm": BARE}),
    "diagnostics (info_level full)": ({"info_level": "full"}, {}),
    "randomisation": ({"randomization": {"payload": (0.5, 2.0), "EI": (0.7, 1.3)}}, {}),
    "sensors (noise, delay)": ({"sensors": NOISE}, {}),
    "strain gauge": ({"sensors": {"strain_gauges": [0.0]}}, {}),
    "actuator (lag, friction)": ({"actuator": {"lag": 0.01, "viscous": 0.01, "coulomb": 0.02}}, {}),
    "residual_pd": ({"action_mode": "residual_pd"}, {}),
    "initial vibration": ({"initial_vibration": 0.05}, {}),
    "cost (deflection, strain)": ({"cost": {"deflection": 0.05, "strain": 1e-3}}, {}),
    "pushes at the tip": ({"pushes": {"wait": (0.5, 1.0), "force": (0.2, 0.5), "lasting": 0.1}}, {}),
    "payload that changes": ({"payload_change": {"time": (1.0, 2.0), "factor": (0.5, 2.0)}}, {}),
    "render_mode, not rendered": ({"render_mode": "rgb_array"}, {}),
    "adaptive steps (step_tolerance 0.1 %)": ({"step_tolerance": 1e-3}, {}),
    "second link (TwoLinkFlexArm-v0)": ({"id": "TwoLinkFlexArm-v0"}, {}),
}
"""Keywords of FlexibleArm-v0 (or of the environment `id`) with each feature, and without it."""

COMPILED = ("physics", "runtime", "tasks")
"""Subpackages from whose copy the branches for absent features are removed."""

CUT = (
    "gravity", "damping", "damped", "payload", "payload_turns", "controller", "actuator", "sensors", "reference",
    "books", "root", "loads", "drive", "algebraic", "change", "pushes", "line", "once", "turns",
)  # fmt: skip
"""Names whose comparison with None guards the code of a feature."""

PERIODS = """
import dataclasses, sys
import gymnasium, flexarm_env
from flexarm_env import arms
from flexarm_env.parameters import Payload
arm = dataclasses.replace(arms.resolve("strip"), tau_d=0.0, payload=Payload())
env = gymnasium.make_vec("FlexibleArm-v0", num_envs=8, threads=1, arm=arm, duration=1e4)
env.reset(seed=0)
batch = env.unwrapped.batch
batch.action[:] = 0.3
for _ in range(int(sys.argv[1])):
    batch.compiled_step(batch.address, 0, 1)
print(flexarm_env.__file__)
"""
"""Program that runs a given number of control periods of eight bare arms in lanes."""
FEW, MANY = 1_000, 101_000


def _made(keywords: dict[str, Any], n: int) -> Any:
    """Make one environment, or a vector of n environments."""
    keywords = {"id": "FlexibleArm-v0", **keywords}
    return gym.make(**keywords) if n == 1 else gym.make_vec(num_envs=n, threads=1, **keywords)


def present(rounds: int) -> list[dict[str, Any]]:
    """Measure µs per arm and control period with and without each feature, alternately: the minimum over the rounds."""
    rows = []
    for name, (wanted, without) in FEATURES.items():
        row: dict[str, Any] = {"feature": name}
        for n, label in ((1, "single"), (64, "vector")):
            envs = {"with": _made(wanted, n), "without": _made(without, n)}
            times = [
                {key: periods(env, 190, time.perf_counter) for key, env in envs.items()} for _ in range(rounds + 1)
            ]
            row[label] = {key: 1e6 * min(each[key] for each in times[1:]) / (190 * n) for key in envs}
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def scenes_present() -> list[dict[str, Any]]:
    """Measure the CPU time, ms, of a scene with floating frames for each coupling, with and without multipliers."""
    joined = {"segments": 5, "elements": 1, "multipliers": True}
    ways: dict[str, dict[str, Any]] = {
        f"coupling {coupling} (5 segments, joints by multipliers)": {"coupling": coupling, **joined}
        for coupling in ("linear", "paper", "von_karman")
    }
    ways |= {
        "5 segments without multipliers": {"segments": 5},
        "one frame of 5 elements": {"segments": 1, "elements": 5},
    }
    scene, rows = scenes.named("robot_arm_motion"), []
    for feature, options in ways.items():
        cost = min(simulate(scene, estimate_error=False, **options).cpu_seconds for _ in range(5))
        rows.append({"feature": feature, "ms": 1e3 * cost})
    return rows


class _Cut(ast.NodeTransformer):
    """Replace `x.gravity is not None` and similar comparisons by False, and `is None` by True."""

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        name = getattr(node.left, "attr", getattr(node.left, "id", None))
        alone = len(node.ops) == 1 and isinstance(node.comparators[0], ast.Constant)
        if alone and node.comparators[0].value is None and name in CUT:
            return ast.Constant(isinstance(node.ops[0], ast.Is))
        return node


class _Prune(ast.NodeTransformer):
    """Remove branches whose condition is a constant."""

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse or ast.Pass()
        return node


def _instructions(folder: Path) -> float:
    """Count the machine instructions per control period of eight arms with callgrind, which lacks AVX-512."""
    environment = os.environ | {"PYTHONPATH": str(folder), "FLEXARM_CACHE_DIR": str(folder / "cache")}
    environment["PYTHONHASHSEED"] = "0"

    def told(*prefix: str, count: int) -> subprocess.CompletedProcess[str]:
        command = [*prefix, sys.executable, "-c", PERIODS, str(count)]
        return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=True)

    where = told("valgrind", "--tool=none", count=1).stdout.strip()  # compiles, for the processor that valgrind shows
    assert Path(where).is_relative_to(folder), where
    executed = []
    for count in (FEW, MANY):
        heard = told("valgrind", "--tool=callgrind", f"--callgrind-out-file={os.devnull}", count=count).stderr
        executed.append(int(heard.split("Collected :")[1].split()[0]))
    return (executed[1] - executed[0]) / (MANY - FEW)


def absent() -> dict[str, float]:
    """Count the instructions per period of bare arms, from the full source and from a copy without the features."""
    if not shutil.which("valgrind"):
        print("valgrind is not installed: what absent features cost is left out")
        return {}
    package = Path(flexarm_env.__file__).parent
    counts = {}
    with tempfile.TemporaryDirectory() as name:
        for kind in ("whole", "cut"):
            folder = Path(name).resolve() / kind
            shutil.copytree(package, folder / "flexarm_env", ignore=shutil.ignore_patterns("__pycache__"))
            if kind == "cut":
                for path in (path for room in COMPILED for path in (folder / "flexarm_env" / room).rglob("*.py")):
                    tree = _Prune().visit(_Cut().visit(ast.parse(path.read_text(encoding="utf-8"))))
                    path.write_text(ast.unparse(ast.fix_missing_locations(tree)), encoding="utf-8")
            counts[kind] = _instructions(folder)
    return counts


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows = []
    for row in found["present"]:
        pairs = [(row[label]["without"], row[label]["with"]) for label in ("single", "vector")]
        cells = ((f"{a:.2f}", f"{b:.2f}", f"{100 * (b / a - 1):+.0f} %") for a, b in pairs)
        rows.append([row["feature"], *itertools.chain(*cells)])
    replays = [(row["feature"], f"{row['ms']:.1f}") for row in found["scenes"]]
    lines = {
        "present": table(
            "feature | single arm, µs: without | with | increase | 64 arms, µs: without | with | increase", rows
        ),
        "scenes": table("replay of robot_arm_motion, floating frame | CPU, ms", replays),
    }
    if found["absent"]:
        whole, cut = found["absent"]["whole"], found["absent"]["cut"]
        less = f"{cut:,.0f} without the code of the absent features ({100 * (whole / cut - 1):+.2f} %)"
        lines["absent"] = [f"A control period takes {whole:,.0f} instructions, and {less}."]
    return lines


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure all tables of the page."""
    return {"scenes": scenes_present(), "present": present(options.rounds), "absent": absent()}


if __name__ == "__main__":
    sys.exit(pages.run("ablation", __doc__, measure, blocks, page="results/cost_model", rounds=7))
