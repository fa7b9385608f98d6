"""`flexarm doctor`: print versions, processors and the folder of compiled programs, and run a self-test."""

import argparse
import os
import platform
import sys
import time
import warnings
from typing import Any

from flexarm_env import __version__
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.compile import cache_report, environments
from flexarm_env.cli.progress import ProgressBar, show

NEEDED = ("numpy", "scipy", "llvmlite", "gymnasium")
OPTIONAL = ("matplotlib", "pygame-ce", "moviepy", "stable-baselines3", "torch", "minari")

VARIABLES = ("FLEXARM_COMPILER", "FLEXARM_CACHE_DIR", "OMP_NUM_THREADS")
"""Environment variables that are printed if they are set."""

SELF_TEST = "robot_arm_motion"
SELF_TEST_SETTINGS: dict[str, Any] = {"formulation": "geometrically_exact", "elements": 5, "dt": 0.005}
"""Settings of the formulation that compiles fastest."""
SELF_TEST_ERROR = 0.015
"""Largest accepted tip error (m) against the reference in the self-test; measured: 0.0129."""


def run(args: argparse.Namespace) -> int:
    """Print versions, processors and the state of the cache; return exit code 1 if the self-test fails."""
    values: dict[str, Any] = {"flexarm_env": __version__, "python": platform.python_version()}
    values |= {name: check.installed(name) for name in NEEDED}
    values |= {name: check.installed(name) or "not installed" for name in OPTIONAL}
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    values |= {"platform": platform.platform(), "processors": processors, "executable": sys.executable}
    values |= {name: os.environ[name] for name in VARIABLES if name in os.environ}
    missing = [name for name in NEEDED if check.installed(name) is None]
    if missing:
        values |= {"self_test": f"not run: {', '.join(missing)} missing"}
        show(values, args.json)
        return FAILED
    from flexarm_env.compiler import MODE

    values |= {"compiler": MODE}
    tested, good = _self_test()
    show(values | tested, args.json)
    return DONE if good else FAILED


def _self_test() -> tuple[dict[str, Any], bool]:
    """Replay a scene against its reference, and step each environment."""
    from flexarm_env import scenes, simulation
    from flexarm_env.comparison import tip_error

    start = time.perf_counter()
    scene, options = scenes.named(SELF_TEST), {**SELF_TEST_SETTINGS, "estimate_error": False}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        simulation.simulate(scene, duration=scene.dt, sample=scene.dt, **options)
        uses, bar = list(environments(None)), ProgressBar("self-test")
        for k, (_, use) in enumerate(uses):
            use()
            bar((k + 1) / len(uses))
        bar.close()
    ready = time.perf_counter() - start
    trajectory = simulation.simulate(scene, **options)
    error = tip_error(trajectory.t, trajectory.tip, scenes.reference(SELF_TEST).columns).max_tip_error
    good = trajectory.status == "ok" and error < SELF_TEST_ERROR
    values = cache_report([str(warning.message) for warning in said]) | {
        "ready_seconds": ready,
        "self_test": f"{'passed' if good else 'FAILED'}: {SELF_TEST}, status {trajectory.status}",
        "self_test_max_tip_error": error,
        "self_test_cpu_seconds": trajectory.cpu_seconds,
    }
    return values, good
