"""The named validation scenes (``flexarm_env/data/scenes``) and scenes from TOML files of the user's own."""

from __future__ import annotations

import os
from functools import cache
from importlib import resources
from pathlib import Path

from flexarm_env import validation as check
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


def _text(name: str) -> str:
    return (resources.files("flexarm_env") / "data" / "scenes" / f"{name}.toml").read_text("utf-8")


@cache
def names(parameter_sets: bool = False) -> tuple[str, ...]:
    """Names of the scenes that come with the package; with ``parameter_sets`` also those of form NAME@SET."""
    if not parameter_sets:
        return ORDER
    return tuple(n for name in ORDER for n in (name, *(f"{name}@{s}" for s in toml.parameter_sets(_text(name)))))


@cache
def named(name: str) -> Scene:
    """A named scene, or a parameter set of it as ``NAME@as_printed``. Raises ValueError for a name there is not."""
    known = names(parameter_sets=True)
    if name not in known:
        raise check.UnknownKey(str(name), known, "scene")
    base, _, parameter_set = name.partition("@")
    return toml.read_scene(_text(base), parameter_set or None)


def resolve(scene: Scene | str | os.PathLike[str]) -> Scene:
    """A scene from a :class:`Scene`, a name (NAME or NAME@SET), or a TOML file (FILE.toml or FILE.toml@SET).

    Raises ValueError for a text that is neither, and for what is wrong in the file.
    """
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, str | os.PathLike):
        raise check.InvalidValue("scene", scene, "must be a name, a TOML file or a Scene")
    text = os.fspath(scene)
    if text in names(parameter_sets=True):
        return named(text)
    path, _, parameter_set = text.rpartition(".toml@")
    file = Path(path + ".toml" if path else text)
    if file.suffix != ".toml":
        raise check.UnknownKey(text, names(parameter_sets=True), "scene (and no .toml file)")
    if not file.is_file():
        raise check.InvalidValue("scene", text, "must be a name or a .toml file that exists")
    return Scene.from_toml(file, parameter_set if path else None)
