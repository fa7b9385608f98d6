"""Validation scenes of the package (``flexarm_env/data/scenes``), scenes in TOML files, and reference solutions."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import validation as check
from flexarm_env.files import csv_lines, numbers, read_toml, without_units
from flexarm_env.scene import Scene, toml

ORDER = (
    "robot_arm_motion",
    "robot_arm_motion_smooth",
    "robot_arm_torque",
    "flying_rod",
    "flying_rod_soft",
    "two_link_motion",
    "two_link_free_flight",
    "spin_up",
)
SPATIAL = ("bend_45", "right_angle_frame", "three_dof_slew", "flying_frame")
"""Names of the scenes in space."""


def _text(name: str) -> str:
    return (resources.files("flexarm_env") / "data" / "scenes" / f"{name}.toml").read_text("utf-8")


@cache
def names(parameter_sets: bool = False, space: bool = False) -> tuple[str, ...]:
    """Return the names of the package's scenes.

    parameter_sets: True to include scenes with a parameter set, NAME@SET. space: True to include scenes in space.
    """
    chosen = (*ORDER, *SPATIAL) if space else ORDER
    if not parameter_sets:
        return chosen
    return tuple(n for name in chosen for n in (name, *(f"{name}@{s}" for s in toml.parameter_sets(_text(name)))))


@cache
def named(name: str) -> Scene:
    """Return the package's scene NAME, or NAME@SET for a parameter set; raise ValueError for an unknown name."""
    known = names(parameter_sets=True, space=True)
    if name not in known:
        raise check.UnknownKey(str(name), known, "scene")
    base, _, parameter_set = name.partition("@")
    return Scene.from_toml(_text(base), parameter_set or None)


def resolve(scene: Scene | str | os.PathLike[str]) -> Scene:
    """Return the scene that a :class:`Scene`, a name or the path of a TOML file denotes.

    Names and paths may end in a parameter set: NAME@SET, FILE.toml@SET. Raises ValueError if a text is neither a name
    nor the path of a file, or if the file is invalid.
    """
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, str | os.PathLike):
        raise check.InvalidValue("scene", scene, "must be a name, a TOML file or a Scene")
    text = os.fspath(scene)
    if text in names(parameter_sets=True, space=True):
        return named(text)
    path, _, parameter_set = text.rpartition(".toml@")
    file = Path(path + ".toml" if path else text)
    if file.suffix != ".toml":
        raise check.UnknownKey(text, names(parameter_sets=True, space=True), "scene (and no .toml file)")
    if not file.is_file():
        raise check.InvalidValue("scene", text, "must be a name or a .toml file that exists")
    return Scene.from_toml(file, parameter_set if path else None)


COLUMNS = ("t", "energy", "start_x", "start_y", "start_angle", "tip_x", "tip_y", "tip_angle")
"""First columns of a trajectory's CSV file, with the units s, J, m, m, rad, m, m, rad."""

COMPARED = (("tip_x", "tip_y"), ("tip_angle",), ("start_angle",))
"""Groups of columns that a comparison reads: the columns of a group are needed together, and one group is enough."""


@dataclass(frozen=True)
class Reference:
    """Reference solution of a scene: its origin, columns, and tolerances for a comparison.

    tip_tolerance: permitted distance from the reference tip, m. angle_tolerance: permitted error of an angle, rad.
    columns: a float64 array (n,) for each name in :data:`COLUMNS`. A comparison omits the column `energy`.
    """

    scene: str
    source: str
    method: str
    note: str
    tip_tolerance: float
    angle_tolerance: float
    columns: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]] = field(compare=False, repr=False)


def reference_names() -> tuple[str, ...]:
    """Return the names of the scenes for which the package contains a reference solution."""
    return tuple(name for name in ORDER if name in _references())


@cache
def reference(name: str) -> Reference:
    """Return the reference solution of a named scene; raise ValueError if the scene has none."""
    if name not in reference_names():
        raise check.UnknownKey(str(name), reference_names(), "scene with a reference")
    entry = _references()[name]
    with resources.as_file(resources.files("flexarm_env") / "data" / "references" / entry["file"]) as path:
        columns = read_trajectory(path)
    for column in columns.values():
        column.flags.writeable = False
    tolerance = entry["tolerance"]
    texts = {key: entry[key] for key in ("scene", "source", "method", "note")}
    return Reference(**texts, tip_tolerance=tolerance["tip"], angle_tolerance=tolerance["angle"], columns=columns)


def spot_values(name: str) -> dict[str, Any]:
    """Return tip positions of a named scene at single instants, computed by another program.

    The keys are t (s), tip_x and tip_y (m), source, and tolerance. Raises ValueError if the package contains no tip
    positions of the scene.
    """
    entries = {entry["scene"]: entry for entry in _references()["spot_values"]}
    if name not in entries:
        raise check.UnknownKey(str(name), entries, "scene with spot values")
    return dict(entries[name])


def read_trajectory(path: str | os.PathLike[str]) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Read a CSV file that `Trajectory.to_csv` wrote; return the columns by name.

    The first columns must be :data:`COLUMNS`. Raises ValueError for other columns or an invalid cell, with a message
    that names file and row, and FileNotFoundError for a missing file.
    """
    header, lines = csv_lines(path)
    header = without_units(header)
    with check.in_file(path):
        if header[: len(COLUMNS)] != COLUMNS:
            raise check.InvalidValue("columns", header, f"must begin with {','.join(COLUMNS)}")
        return _columns(header, lines)


def read_reference(path: str | os.PathLike[str]) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Read a reference solution from a CSV file: the column t, and those columns of :data:`COMPARED` that exist.

    The columns may be in any order, and other columns are ignored. Raises the same errors as :func:`read_trajectory`.
    """
    header, lines = csv_lines(path)
    header = without_units(header)
    with check.in_file(path):
        if "t" not in header or len(set(header)) < len(header) or not any(set(g) <= set(header) for g in COMPARED):
            groups = " or ".join(" and ".join(group) for group in COMPARED)
            raise check.InvalidValue("columns", header, f"must be names, each once: t, and {groups}")
        return _columns(header, lines)


def _columns(header: tuple[str, ...], lines: list[list[str]]) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Return the numbers of a file's lines by column; the times must increase."""
    if not lines:
        raise check.InvalidValue("rows", 0, "must be at least one")
    found = {name: numbers(k, name, lines, len(header)) for k, name in enumerate(header)}
    later = found["t"] > np.append(-np.inf, found["t"][:-1])
    good = np.isfinite(list(found.values())).all(axis=0) & later
    for i in np.flatnonzero(~good)[:1].tolist():
        what = f"must hold finite numbers and a time later than the row before, in row {i}"
        raise check.InvalidValue(f"[{i}]", ",".join(lines[i]), what)
    return found


@cache
def _references() -> dict[str, Any]:
    text = (resources.files("flexarm_env") / "data" / "references" / "references.toml").read_text("utf-8")
    return read_toml(text)[0]
