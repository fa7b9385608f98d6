"""`flexarm replay` and `flexarm simulate`: simulate a scene, print a report, compare with a reference, and plot."""

import argparse
import dataclasses
import time
from collections.abc import Mapping
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env import scenes
from flexarm_env import validation as check
from flexarm_env.accuracy import INACCURATE
from flexarm_env.cli.codes import DONE, FAILED, NOT_ACCURATE
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.comparison import tip_error
from flexarm_env.files import to_file, to_folder
from flexarm_env.records import flags
from flexarm_env.scene import Scene
from flexarm_env.settings import Settings
from flexarm_env.trajectory import check_work

TABLES, FIGURES, FILMS = (".csv", ".npz"), (".png", ".pdf", ".svg"), (".mp4", ".gif", ".webm", ".mkv", ".mov")
NEEDED = {"plot": ("matplotlib", "plot"), "video": ("pygame", "render")}
"""For each kind of output, the module that produces the output, and the extra that installs this module."""

Columns = Mapping[str, NDArray[np.float64]]


def run(args: argparse.Namespace) -> int:
    """Simulate the scene and print the report.

    Returns exit code 1 if the simulation ended early, and 3 with --strict if it is inaccurate.
    """
    scene = scenes.resolve(args.scene)
    given = {flag.name: getattr(args, flag.name) for flag in flags(Settings)}
    settings = scene.settings(**{name: value for name, value in given.items() if value is not None})
    reference, origin = _reference(args)
    outputs = {"out": (args.out, TABLES), "plot": (args.plot, FIGURES), "video": (args.video, FILMS)}
    paths = {name: writable(name, path, endings) for name, (path, endings) in outputs.items() if path is not None}
    if args.plots is not None:
        _needs("plots", "matplotlib", "plot")
        to_folder("--plots", args.plots)
    for name in ("duration", "sample"):
        if getattr(args, name) is not None:
            check.number(name, getattr(args, name), "s", above=0.0)
    interval = args.sample or scene.sample
    assert interval is not None
    check_work(args.duration or scene.duration, interval, settings.dt)
    least = 1e-3 * interval  # a picture in 1000 s
    speed = check.number("--speed", 1.0 if args.speed is None else args.speed, minimum=least)
    if args.speed is not None and args.video is None:
        raise check.InvalidValue("--speed", args.speed, "requires --video")
    if args.through_env and args.time_limit is not None:
        raise check.InvalidValue("--time-limit", args.time_limit, "must not be combined with --through-env")

    trajectory, compiling = _trajectory(scene, settings, args)
    values = report(trajectory, compiling)
    if args.dt is not None and args.dt > (used := trajectory.settings.dt) * (1.0 + 1e-9):
        why = f"steps end at every sample ({interval:g} s) and at every corner of motions and loads"
        values["dt_note"] = f"dt = {used:g} s instead of {args.dt:g} s: {why}"
    if reference is not None:
        values["reference"] = origin
        values |= _errors(trajectory, reference)
    drawn = reference if reference is not None and {"tip_x", "tip_y"} <= set(reference) else None
    if "out" in paths:
        if paths["out"].suffix.lower() == ".csv":
            trajectory.to_csv(paths["out"], args.units)
        else:
            trajectory.to_npz(paths["out"])
        values["out"] = str(paths["out"])
    if "plot" in paths:
        from flexarm_env.plotting import plot_trajectory

        values["plot"] = str(plot_trajectory(trajectory, paths["plot"], reference=drawn))
    if args.plots is not None:
        from flexarm_env.plotting import plot_all

        values["plots"] = [str(path) for path in plot_all(trajectory, args.plots, reference=drawn)]
    if "video" in paths:
        values["video"] = str(_film(trajectory, paths["video"], speed))
    show(values, args.json)
    if not trajectory.finished:
        return FAILED
    return NOT_ACCURATE if args.strict and trajectory.status == INACCURATE else DONE


def report(trajectory: Any, compile_seconds: float) -> dict[str, Any]:
    """Return the report's entries by name; energies in J, times in s."""
    simulated = float(trajectory.t[-1])
    residual, turned = float(np.abs(trajectory.balance).max()), float(np.max(trajectory.turned_over))
    values: dict[str, Any] = {
        "scene": trajectory.scene.name,
        "formulation": trajectory.settings.formulation,
        "options": trajectory.settings.options(),
        **{name: getattr(trajectory, name) for name in ("status", "message")},
        "simulated_seconds": simulated,
        "steps": trajectory.steps,
        "newton_iterations": trajectory.iterations,
        **{name: getattr(trajectory, name) for name in ("factorizations", "halvings")},
        "cpu_seconds_per_simulated_second": trajectory.cpu_seconds / simulated if simulated > 0.0 else float("nan"),
        "compile_seconds": compile_seconds,
        "max_energy_balance_residual_J": residual,
        "energy_balance_residual_share": residual / turned if turned > 0.0 else float("nan"),
        "error_estimate": trajectory.error_estimate,
        "error_parts": dict(trajectory.error_parts),
    }
    if np.isfinite(trajectory.deflection_bound):
        values["deflection_bound"] = trajectory.deflection_bound
    values |= {f"note_{name}": float(value) for name, value in trajectory.notes.items()}
    return values


def _film(trajectory: Any, path: Path, speed: float) -> Path:
    """Write a film of the run with 25 pictures a second, or fewer if fewer were recorded."""
    from flexarm_env.envs.video import pictures, write_film

    interval = float(np.diff(trajectory.t).mean()) if trajectory.t.size > 1 else 1.0
    fps = min(25.0, speed / interval)
    return write_film(path, pictures(trajectory, fps, speed), fps)


def _errors(trajectory: Any, reference: Columns) -> dict[str, Any]:
    """Return the entries max_tip_error and rms_tip_error; nan with a reason if no instants can be compared."""
    try:
        return dict(tip_error(trajectory.t, trajectory.tip, reference, trajectory.start).found())
    except ValueError:
        if trajectory.finished:
            raise
        return {"max_tip_error": float("nan"), "rms_tip_error": float("nan"), "instants": 0}


def _trajectory(scene: Scene, settings: Settings, args: argparse.Namespace) -> tuple[Any, float]:
    """Return the run, and the time, s, of the preceding compilation or loading."""
    run = _through_env if args.through_env else _directly
    start = time.perf_counter()
    first = max(1e-9, min(scene.dt, settings.dt or scene.dt, args.duration or scene.duration))
    run(scene, settings, argparse.Namespace(**vars(args) | {"duration": first, "sample": first}), None)
    compiling = time.perf_counter() - start
    with closing(ProgressBar(scene.name)) as bar:
        return run(scene, settings, args, bar), compiling


def _directly(scene: Scene, settings: Settings, args: argparse.Namespace, bar: ProgressBar | None) -> Any:
    """Simulate the scene with the command's options."""
    from flexarm_env.simulation import simulate

    names = ("duration", "sample", "error_limit", "time_limit")
    options: dict[str, Any] = {name: getattr(args, name) for name in names}
    return simulate(scene, settings.formulation, progress=bar, **options, **settings.options())


def _through_env(scene: Scene, settings: Settings, args: argparse.Namespace, bar: ProgressBar | None) -> Any:
    """Simulate the scene through an environment, at its control periods."""
    from flexarm_env.envs.replay import through_env

    period = args.sample or scene.sample
    if args.duration is not None:
        dt, shortest = min(scene.dt, args.duration), min(period or args.duration, args.duration)
        scene = dataclasses.replace(scene, duration=args.duration, dt=dt, sample=shortest)
    return through_env(scene, settings, period, args.error_limit)


def _reference(args: argparse.Namespace) -> tuple[Columns | None, str]:
    """Return the reference's columns and their source, which is the given file or the named scene's own reference."""
    given = getattr(args, "reference", None)
    if given is not None:
        return scenes.read_reference(given), given
    if args.command != "replay" or args.scene not in scenes.reference_names():
        return None, ""
    own = scenes.reference(args.scene)
    return own.columns, f"{own.scene} ({own.method}; tip accurate to {own.tip_tolerance:g} m)"


def _needs(name: str, module: str, extra: str) -> None:
    """Raise ImportError with a sentence if a module is missing."""
    if find_spec(module) is None:
        raise ImportError(check.lacking(f"--{name}", {"pygame": "pygame-ce"}.get(module, module), extra))


def writable(name: str, path: str, endings: tuple[str, ...]) -> Path:
    """Validate the path of an output file before a long simulation, create its folder, and return the path."""
    if name in NEEDED and Path(path).suffix.lower() in endings:
        _needs(name, *NEEDED[name])
    return to_file(f"--{name}", path, endings)
