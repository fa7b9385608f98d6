"""`flexarm doctor`: versions, processors, the folder of compiled code, and a self-test."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

from flexarm_env import __version__
from flexarm_env.cli.parser import DONE, FAILED
from flexarm_env.cli.progress import Announced, ProgressBar, show

NEEDED = ("numpy", "scipy", "numba", "llvmlite", "gymnasium")
OPTIONAL = ("matplotlib", "pygame-ce", "moviepy", "stable-baselines3", "torch", "minari")

SELF_TEST = "robot_arm_motion"
SELF_TEST_SETTINGS: dict[str, Any] = {"formulation": "geometrically_exact", "elements": 5, "dt": 0.005}
"""Of the formulation that compiles quickest."""
SELF_TEST_ERROR = 0.015
"""Largest tip error (m) that it may have against its reference; measured: 0.0129."""


def run(args: argparse.Namespace) -> int:
    """Print what there is and whether it works; 1 where the self-test fails."""
    values: dict[str, Any] = {"flexarm_env": __version__, "python": platform.python_version()}
    values |= {name: _version(name) for name in NEEDED}
    values |= {name: _version(name) or "not installed" for name in OPTIONAL}
    values |= {"platform": platform.platform(), "processors": _processors(), "executable": sys.executable}
    values |= {name: os.environ[name] for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS") if name in os.environ}
    missing = [name for name in NEEDED if _version(name) is None]
    if missing:
        values |= {"self_test": f"not run: {', '.join(missing)} missing"}
        show(values, args.json)
        return FAILED
    tested, good = _self_test()
    show(values | tested, args.json)
    return DONE if good else FAILED


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _processors() -> int:
    """How many this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def _self_test() -> tuple[dict[str, Any], bool]:
    """Replay a scene against its reference."""
    from flexarm_env import scenes, simulation
    from flexarm_env.comparison import tip_error

    bar = ProgressBar("self-test")
    start = time.perf_counter()
    scene, options = scenes.named(SELF_TEST), {**SELF_TEST_SETTINGS, "estimate_error": False}
    with Announced(bar, "compiling, which happens once ..."):
        simulation.simulate(scene, duration=scene.dt, sample=scene.dt, **options)
    ready = time.perf_counter() - start
    trajectory = simulation.simulate(scene, **options)
    error = tip_error(trajectory.t, trajectory.tip, scenes.reference(SELF_TEST).columns).max_tip_error
    good = trajectory.status == "ok" and error < SELF_TEST_ERROR
    folder = _cache_folder(vars(simulation)["advance"])
    values = {
        "cache_folder": "none (compilation is switched off)" if folder is None else str(folder),
        "cache_writable": folder is not None and folder.is_dir() and os.access(folder, os.W_OK),
        "ready_seconds": ready,
        "self_test": f"{'passed' if good else 'FAILED'}: {SELF_TEST}, status {trajectory.status}",
        "self_test_max_tip_error": error,
        "self_test_cpu_seconds": trajectory.cpu_seconds,
    }
    return values, good


def _cache_folder(function: Any) -> Path | None:
    """Where a compiled function is kept on disk."""
    path = getattr(getattr(function, "stats", None), "cache_path", None)
    return None if path is None else Path(path)
