"""Read and write scenes as TOML, with parameter sets (named groups of changed keys); every error names the key path."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from flexarm_env import arms, records
from flexarm_env import validation as check
from flexarm_env.files import read_toml
from flexarm_env.parameters import Arm
from flexarm_env.scene.contacts import contact_of
from flexarm_env.scene.drives import COORDINATES, FORCES, JointTorque, Load, Motion, PointLoad
from flexarm_env.scene.functions import KINDS, function_from_table, function_table
from flexarm_env.settings import FORMULATIONS, PRESETS, Settings
from flexarm_env.time_functions import TimeFunction

T = TypeVar("T")

_OPTIONAL_TEXT = ("description", "source", "note")


def read(kind: Callable[..., T], source: str | os.PathLike[str], parameter_set: str | None = None) -> T:
    """Read a scene from a TOML file or text.

    A parameter set ``S`` replaces values of keys; the scene is then named ``NAME@S``. kind: the class ``Scene``, whose
    fields are the keys of the file. The other arguments and the errors are those of :meth:`Scene.from_toml`.
    """
    table, path = read_toml(source)
    with check.in_file(path):
        return _read(kind, table, path, parameter_set)


def _read(kind: Callable[..., T], table: dict[str, Any], path: Path | None, parameter_set: str | None) -> T:
    """Create the scene of a table and of each of its parameter sets, which validates them; return the chosen one."""
    directory = path.parent if path else Path()
    # the file's name is the default name
    if path:
        table.setdefault("name", path.stem)
    sets = check.table_of("parameter_sets", table.pop("parameter_sets", {}))
    scene = _scene(kind, table, directory)
    variants: dict[str, T] = {}
    for name, changes in sets.items():
        prefix = f"parameter_sets.{name}"
        changed = check.table_of(prefix, changes)
        check.known_keys(prefix, changed, [key for key in check.names_of(kind) if key != "name"])
        with check.under(prefix):
            variants[name] = _scene(kind, {**table, **changed, "name": f"{table['name']}@{name}"}, directory)
    if parameter_set is None:
        return scene
    if parameter_set not in variants:
        known = ", ".join(variants) or "none"
        raise check.InvalidValue("parameter_set", parameter_set, f"must be one that {table['name']} has: {known}")
    return variants[parameter_set]


def parameter_sets(source: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the parameter sets in a TOML file or text."""
    table, _ = read_toml(source)
    return tuple(check.table_of("parameter_sets", table.get("parameter_sets", {})))


def _scene(kind: Callable[..., T], table: Mapping[str, Any], directory: Path) -> T:
    """Create a scene from a table: arm, motions, loads, vectors, solver options; files are in `directory`."""
    if "links" in table and "arm" not in table:
        raise check.UnknownKey("links", check.names_of(kind), hint="this is an arm, and a scene has one: arm = FILE")
    check.known_keys("", table, (*check.names_of(kind), "parameter_sets"))
    values = dict(table)
    name = check.text("name", check.needed("", values, "name", "must be a text"), empty=False)
    check.needed("", values, "duration", "must be a positive number (s)")
    check.needed("", values, "dt", "must be a positive number (s)")
    values["arm"] = _arm(check.needed("", values, "arm", "must be a name, a .toml file or a table"), name, directory)
    for key, read_one in (("motions", _motion), ("loads", _load)):
        entries = enumerate(check.sequence(key, values.get(key, ()), f"tables, [[{key}]]"))
        tables = {f"{key}[{i}]": check.table_of(f"{key}[{i}]", entry) for i, entry in entries}
        values[key] = tuple(read_one(path, entry, directory) for path, entry in tables.items())
    rows = enumerate(check.sequence("contacts", values.get("contacts", ()), "tables, [[contacts]]"))
    values["contacts"] = tuple(contact_of(f"contacts[{i}]", row, directory=directory) for i, row in rows)
    for key in ("position", "angles", "velocity", "rates", "gravity", "rigid_joints"):
        if key in values:
            values[key] = check.sequence(key, values[key], "numbers")
    solver = check.table_of("solver", values.pop("solver", {}))
    return kind(**values, solver=tuple(solver.items()))


def _arm(value: object, name: str, directory: Path) -> Arm:
    """Return an arm that is given by a name, a file or a table."""
    if isinstance(value, Mapping):
        with check.under("arm"):
            return arms.from_table(value, default_name=name)
    return arms.resolve(check.text("arm", value), directory)


def _motion(path: str, entry: dict[str, Any], directory: Path) -> Motion:
    """Return the motion of a table with a coordinate and a function of time."""
    with check.under(path):
        check.needed("", entry, "coordinate", f"must be {COORDINATES}")
        return Motion(entry.pop("coordinate"), function_from_table(entry, directory))


def _load(path: str, entry: dict[str, Any], directory: Path) -> Load:
    """Return the joint torque or point load of a table."""
    with check.under(path):
        # a key "joint" marks a joint torque, "link" a point load
        if "joint" in entry:
            return JointTorque(entry.pop("joint"), function_from_table(entry, directory))
        if "link" not in entry:
            raise check.MissingKey("joint", "a load has joint and kind, or link, end and force_x, force_y or torque")
        check.known_keys("", entry, ("link", "end", *FORCES))
        end = check.needed("", entry, "end", 'must be "root" or "tip"')
        forces = {}
        for key in (key for key in FORCES if key in entry):
            function = check.table_of(key, entry[key])
            with check.under(key):
                forces[key] = function_from_table(function, directory)
        return PointLoad(entry["link"], end, **forces)


def text_of(scene: Any) -> str:
    """Return a scene as TOML text; keys with default values are omitted."""
    import tomli_w

    table: dict[str, Any] = {"name": scene.name}
    table |= {key: getattr(scene, key) for key in _OPTIONAL_TEXT if getattr(scene, key)}
    table |= {key: getattr(scene, key) for key in ("duration", "dt", "sample", "root", "position", "angles")}
    table |= {key: getattr(scene, key) for key in ("velocity", "rates") if any(getattr(scene, key))}
    if scene.start != "unloaded":
        table["start"] = scene.start
    table |= {key: getattr(scene, key) for key in ("space", "rigid_joints") if getattr(scene, key)}
    if scene.gravity is not None:
        table["gravity"] = scene.gravity
    if scene.solver:
        table["solver"] = dict(scene.solver)
    # tables of tables last, as TOML requires
    table["motions"] = [
        {"coordinate": motion.coordinate, **function_table(motion.function)} for motion in scene.motions
    ]
    table["loads"] = [_load_table(load) for load in scene.loads]
    table["contacts"] = [contact.to_table() for contact in scene.contacts]
    table["arm"] = arms.to_table(scene.arm)
    return tomli_w.dumps({key: value for key, value in table.items() if value != []})


def _load_table(load: Load) -> dict[str, Any]:
    """Return the TOML table of a load."""
    if isinstance(load, JointTorque):
        return {"joint": load.joint, **function_table(load.function)}
    forces = {key: getattr(load, key) for key in FORCES}
    given = {key: function_table(f) for key, f in forces.items() if isinstance(f, TimeFunction)}
    return {"link": load.link, "end": load.end, **given}


def schema(kind: Any) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) with which editors complete and check scene files.

    kind: the class `Scene`, whose fields are the keys of the file. The schema does not contain rules that relate
    several keys, nor the parameters of functions of time; these rules and parameters are validated when a file is read.
    """
    function = {
        "type": "object", "required": ["kind"],
        "properties": {"kind": {"enum": [*KINDS, "csv"], "description": "kind of a function of time"}},
    }  # fmt: skip
    coordinate = {"type": "string", "minLength": 1, "description": COORDINATES}
    motion = {**function, "properties": {**function["properties"], "coordinate": coordinate}}  # type: ignore[dict-item]
    count, ends = {"type": "integer", "minimum": 0}, {"enum": ["root", "tip"], "description": "end of the link"}
    at_joint = {**function, "properties": {**function["properties"], "joint": count}}  # type: ignore[dict-item]
    at_point = {
        "type": "object", "required": ["link", "end"], "additionalProperties": False,
        "properties": {"link": count, "end": ends, **dict.fromkeys(FORCES, function)},
    }  # fmt: skip
    arm = {key: value for key, value in arms.schema().items() if key != "$schema"}
    numbers = {"type": "array", "items": {"type": "number"}}
    scene = records.schema(
        kind,
        arm={"if": {"type": "object"}, "then": arm, "else": {"type": "string", "description": "name or file"}},
        motions={"type": "array", "items": {**motion, "required": ["coordinate", "kind"]}},
        loads={"type": "array", "items": records.by_key({"joint": at_joint}, at_point)},
        contacts={"type": "array", "items": {"type": "object", "required": ["obstacle", "stiffness"]}},
        solver={**records.schema(Settings, formulation={"enum": [*FORMULATIONS, *PRESETS]}), "required": []},
        rigid_joints={"type": "array", "items": count},
        **dict.fromkeys(("position", "angles", "velocity", "rates", "gravity"), numbers),
    )
    scene["properties"]["parameter_sets"] = {"type": "object", "description": "tables of keys to replace, by name"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "scene of flexarm_env",
        **scene, "required": ["arm", "duration", "dt"],
    }  # fmt: skip
