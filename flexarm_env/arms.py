"""Read arms: the named arms of the package (``flexarm_env/data/arms``), and arms in TOML files."""

import dataclasses
import math
import os
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import records, sensors
from flexarm_env import validation as check
from flexarm_env.files import read_toml
from flexarm_env.parameters import Arm, Base, Elbow, Joint, Link, Motor, Payload, Points, RigidLink, Section, Taper
from flexarm_env.records import made
from flexarm_env.sections import ACROSS, ENDS

_SECTION = tuple(name for name in check.names_of(Section) if name not in ACROSS)
_OPTIONAL = {"kappa", *(name for name in check.names_of(Section) if hasattr(Section, name))}
_RECTANGLE = ("width", "thickness", "E", "rho", "G", "kappa")
_TUBE = ("diameter", "wall", "E", "rho", "G", "kappa")
_CIRCLE = ("diameter", "E", "rho", "G", "kappa")
_RIGID = ("length", "mass", "centre", "inertia")
_OF_LINK = ("tau_d", "curvature", *ENDS)
_TAPER = ("widths", "thicknesses", "E", "rho", "G", "kappa")

_SIDES = dict.fromkeys(
    ("width", "thickness", "diameter", "wall", "widths", "thicknesses"), (0.0, 1.0, "m", "mm", 1e-3)
)
_UNLIKELY: dict[str, tuple[float, float, str, str, float]] = {
    **_SIDES, "E": (3e5, math.inf, "Pa", "GPa", 1e9), "G": (1e5, math.inf, "Pa", "GPa", 1e9),
    "rho": (25.0, math.inf, "kg/m^3", "g/cm^3", 1e3),
}  # fmt: skip
"""Usual range of a section's numbers, their unit, another unit in use, and the latter in units of the former."""

_BESIDE = ("randomization", "identification")
"""Tables that a file written by `flexarm identify` contains in addition to [arm]."""


def names() -> tuple[str, ...]:
    """Return the names of the arms that the package contains."""
    folder = resources.files("flexarm_env") / "data" / "arms"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def named(name: str) -> Arm:
    """Return the package's arm with this name; raise ValueError if the name is unknown."""
    check.choice("arm", name, names())
    return from_toml((resources.files("flexarm_env") / "data" / "arms" / f"{name}.toml").read_text("utf-8"))


def resolve(arm: Arm | str | os.PathLike[str], directory: str | os.PathLike[str] = ".") -> Arm:
    """Return the arm that an :class:`Arm`, a name, or the path of a TOML file denotes.

    Relative paths are relative to ``directory``. Raises ValueError if a text is neither a name nor the path of a file,
    or if the file is invalid.
    """
    if isinstance(arm, Arm):
        return arm
    if not isinstance(arm, str | os.PathLike):
        raise check.InvalidValue("arm", arm, "must be a name, a TOML file or an Arm")
    if isinstance(arm, str) and arm in names():
        return named(arm)
    path = Path(directory) / arm
    if path.suffix != ".toml" or not path.is_file():
        known = ", ".join(f'"{n}"' for n in names())
        raise check.InvalidValue("arm", os.fspath(arm), f"must be one of {known}, or a .toml file that exists")
    return from_toml(path)


def from_toml(source: str | os.PathLike[str]) -> Arm:
    """Read an arm from a TOML file or text; the keys are the fields of :class:`Arm`.

    The keys are at the top level or in a table ``[arm]``. Raises ValueError for invalid content, with a message that
    names the file, the key path, the value and the rule, and OSError if the file does not exist.
    """
    table, path = read_toml(source)
    with check.in_file(path):
        if "arm" in table and set(table) <= {"arm", *_BESIDE}:
            with check.under("arm"):
                return from_table(check.table_of("", table["arm"]), default_name=path.stem if path else None)
        return from_table(table, default_name=path.stem if path else None)


def to_toml(arm: Arm) -> str:
    """Return an arm as TOML text, from which :func:`from_toml` creates an equal arm."""
    import tomli_w

    return tomli_w.dumps(to_table(arm))


def from_table(table: Mapping[str, Any], default_name: str | None = None) -> Arm:
    """Create an arm from a table of a TOML file.

    default_name: name of the arm if the table has no name. Raises ValueError for invalid content, with a message that
    names the key path, the value and the rule.
    """
    check.known_keys("", table, check.names_of(Arm))
    values = dict(table)
    if default_name is not None:
        values.setdefault("name", default_name)
    check.needed("", values, "name", "must be a text")
    check.needed("", values, "links", "must be a sequence of tables with length and section")
    for key, read in (("links", _link), ("elbows", _elbow), ("joints", _joint)):
        entries = check.sequence(key, values.get(key, ()), "tables")
        values[key] = tuple(read(f"{key}[{i}]", value=entry) for i, entry in enumerate(entries))
    if "payload" in values:
        values["payload"] = made("payload", Payload, values["payload"], prefix="")
    if "base" in values:
        values["base"] = base_of(values["base"])
    if "sensors" in values:
        values["sensors"] = sensors.from_table(check.table_of("sensors", values["sensors"]))
    return Arm(**values)


def section_of(path: str, value: object) -> Section:
    """Create a section from the value of a link's key `section` in a TOML file.

    Raises ValueError for invalid content; the message names the key path, the value and the rule.
    """
    return _section(path, check.table_of(path, value), path)


def base_of(value: object) -> Base:
    """Create the floating base from its table in an arm's TOML file.

    Raises ValueError for invalid content; the message names the key path, the value and the rule.
    """
    return made("base", Base, value)


def _link(path: str, value: object) -> Link:
    """Read a link from its TOML table.

    A rigid link has a mass; all other links have a section, points of a section, or a taper.
    """
    table = check.table_of(path, value)
    if "section" not in table and any(key in table for key in _RIGID[1:]):
        check.known_keys(path, table, _RIGID)
        check.needed(path, table, "length", "must be a number (m)")
        with check.under(path):
            return RigidLink(**table)
    check.known_keys(path, table, ("length", "section", *_OF_LINK))
    own = {key: table[key] for key in _OF_LINK if key in table}
    length = check.needed(path, table, "length", "must be a positive number (m)")
    given = check.needed(path, table, "section", _SECTIONS)
    if isinstance(given, list | tuple):
        points = [_point(f"{path}.section[{i}]", entry) for i, entry in enumerate(given)]
        with check.under(path):
            return Link(length, tuple(points), **own)
    section = check.table_of(f"{path}.section", given)
    if "widths" in section or "thicknesses" in section:
        check.known_keys(f"{path}.section", section, _TAPER)
        for key in _TAPER[:-1]:
            check.needed(f"{path}.section", section, key, _SECTIONS)
        with check.under(path):
            tapered = Link.tapered(length, **section, **own)
        _warn_of_units(f"{path}.section", section)
        return tapered
    made = _section(path, section)
    with check.under(path):
        return Link(length, made, **own)


_SECTIONS = (
    f"must be a table of {', '.join(_SECTION)}, or of a rectangle's {', '.join(_RECTANGLE)}; or of a tapered "
    f"rectangle's {', '.join(_TAPER)}; or a sequence of tables of s (m) and a section's keys"
)


def _point(path: str, entry: object) -> tuple[Any, Section]:
    """Read one point, position and section, of a section that varies along the link."""
    table = check.table_of(path, entry)
    s = check.needed(path, table, "s", "must be a number (m from the link's root)")
    section = _section(path, {key: value for key, value in table.items() if key != "s"}, path)
    return s, section


def _section(path: str, section: dict[str, Any], inside: str | None = None) -> Section:
    """Read the section of a table. inside: key path of the section, if it is not `path`.section."""
    own = inside or f"{path}.section"
    what = f"must be a table of {', '.join(_SECTION)}, or of a rectangle's {', '.join(_RECTANGLE)}"
    keys: tuple[str, ...] = (*_SECTION, *ACROSS)
    make: Callable[..., Section] = Section
    if "wall" in section:
        keys, make, what = _TUBE, Section.tube, f"a tube needs {', '.join(_TUBE[:-1])}"
    elif "diameter" in section:
        keys, make, what = _CIRCLE, Section.circle, f"a circle needs {', '.join(_CIRCLE[:-1])}"
    elif section and all(key in _RECTANGLE for key in section):
        keys, make = _RECTANGLE, Section.rectangle
    check.known_keys(own, section, (*keys, *_RECTANGLE) if make is Section else keys)
    for key in keys:
        if key not in _OPTIONAL:
            check.needed(own, section, key, what)
    check.known_keys(own, section, keys)
    with check.under(path):
        made = make(**section)
    _warn_of_units(own, section)
    return made


def _warn_of_units(path: str, section: Mapping[str, Any]) -> None:
    """Warn about numbers of a section that are probably in another unit (`_UNLIKELY`). path: the section's key path."""
    for key, number in ((key, x) for key, x in section.items() if key in _UNLIKELY for x in np.ravel(x)):
        low, high, unit, other, factor = _UNLIKELY[key]
        if not low <= number <= high:
            # E = 210e3 is of steel in MPa, E = 210 in GPa
            if other == "GPa" and number >= 1e3:
                other, factor = "MPa", 1e6
            what = f"in {other} it would be {number * factor:g} {unit}"
            warnings.warn(f"{path}.{key} = {number:g}: read as {unit}; {what}", UserWarning, stacklevel=2)


def _joint(path: str, value: object) -> Joint:
    """Read a joint from its table, which contains the table of its motor."""
    table = check.table_of(path, value)
    if "motor" in table:
        check.known_keys(path, table, check.names_of(Joint))
        with check.under(path):
            table["motor"] = made("motor", Motor, table["motor"], prefix="")
    return made(path, Joint, table)


def _elbow(path: str, value: object) -> Elbow:
    """Read an elbow from its TOML table."""
    return made(path, Elbow, value)


# ------------------------------------------------------------------ JSON schema
def schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of arm files, with which editors can complete and check these files."""
    motor = records.schema(Motor)
    arm = records.schema(
        Arm,
        name={"type": "string", "minLength": 1, "description": "name of the arm"},
        links={"type": "array", "items": _LINK_SCHEMA, "minItems": 1, "description": "links, root to tip"},
        elbows={"type": "array", "items": records.schema(Elbow), "description": "elbows, one less than the links"},
        joints={"type": "array", "items": records.schema(Joint, motor=motor), "description": "drives, one per link"},
        payload=records.schema(Payload), base=records.schema(Base), sensors=_sensors_schema(),
        source={"type": "string", "description": "origin of the numbers"},
        torque_limits={
            "type": "array", "items": {"type": "number", "exclusiveMinimum": 0.0},
            "description": "largest torque of each joint (N m)",
        },
        joint_limits={
            "type": "array", "items": {"type": "array", "items": {"type": "number"}, "maxItems": 2},
            "description": "range (low, high) of each joint (rad); []: no limit",
        },
    )  # fmt: skip
    # a file may lack the name, which is then the file's, or contain the arm in a table [arm]
    alone = {**arm, "required": ["links"]}
    beside = {"type": "object", "properties": {"arm": arm, **{key: {"type": "object"} for key in _BESIDE}}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "arm of flexarm_env",
        **records.by_key({"arm": {**beside, "required": ["arm"], "additionalProperties": False}}, alone),
    }  # fmt: skip


def _sensors_schema() -> dict[str, Any]:
    """Return the schema of the table of sensors; a file may use short forms of encoders and places of strain gauges."""

    def one(kind: Any) -> dict[str, Any]:
        return records.schema(kind, low_pass=records.schema(sensors.LowPass))

    def table_or(kind: Any, other: dict[str, Any]) -> dict[str, Any]:
        return {"if": {"type": "object"}, "then": one(kind), "else": other}

    gauges = {"type": "array", "items": table_or(sensors.StrainGauge, {"type": ["number", "array"]})}
    encoders = table_or(sensors.Encoder, {"type": "array", "items": one(sensors.Encoder)})
    single = {name: one(kind) for name, kind in sensors.SINGLES.items()}
    return records.schema(sensors.Sensors, encoders=encoders, strain_gauges=gauges, **single)


def _material(**sides: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a homogeneous section given by the dimensions `sides`."""
    positive = {"type": "number", "exclusiveMinimum": 0.0}
    own = {
        "E": {**positive, "description": "Young's modulus (Pa)"},
        "rho": {**positive, "description": "density (kg/m^3)"},
        "G": {**positive, "description": "shear modulus (Pa)"},
    }  # fmt: skip
    kappa = {**positive, "maximum": 1.0, "description": "shear coefficient"}
    known = {**sides, **own, "kappa": kappa}
    return {
        "type": "object", "properties": known, "required": [*sides, *own], "additionalProperties": False,
    }  # fmt: skip


def _side(text: str) -> dict[str, Any]:
    return {"type": "number", "exclusiveMinimum": 0.0, "description": f"{text} (m)"}


def _sides(text: str) -> dict[str, Any]:
    return {"type": "array", "items": _side(text), "minItems": 2, "maxItems": 2, "description": f"{text} (m)"}


def _section_schema(**more: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a section's table; its keys determine its kind. more: further required keys."""
    plain = records.schema(Section)
    kinds = {
        "wall": _material(diameter=_side("outer diameter"), wall=_side("thickness of the wall"), **more),
        "diameter": _material(diameter=_side("diameter"), **more),
        "width": _material(width=_side("across the plane"), thickness=_side("in the plane"), **more),
    }
    own = {"properties": {**plain["properties"], **more}, "required": [*plain["required"], *more]}
    return records.by_key(kinds, {**plain, **own})


_TAPERED = _material(widths=_sides("width at root and tip"), thicknesses=_sides("thickness at root and tip"))
_PLACE = {"type": "number", "minimum": 0.0, "description": "distance from the link's root (m)"}
_LINK_SCHEMA = records.by_key(
    {"section": records.schema(Link, section={
        "if": {"type": "array"}, "then": {"type": "array", "items": _section_schema(s=_PLACE), "minItems": 2},
        "else": records.by_key({"widths": _TAPERED, "thicknesses": _TAPERED}, _section_schema()),
    })},
    records.by_key(dict.fromkeys(_RIGID[1:], records.schema(RigidLink)), records.schema(Link)),
)  # fmt: skip


def _link_table(link: Link, space: bool) -> dict[str, Any]:
    """Return a link as a TOML table without fields that have their default values."""
    if isinstance(link, RigidLink):
        return {key: getattr(link, key) for key in _RIGID}
    plain = Link(link.length, link.section)
    own = {key: getattr(link, key) for key in _OF_LINK if getattr(link, key) != getattr(plain, key)}
    return {"length": link.length, "section": _section_table(link.section, space), **own}


def _section_table(section: Section | Taper | Points, space: bool) -> Any:
    """Return a section as a table from which `_link` makes an equal section."""
    if isinstance(section, tuple):
        return [{"s": s, **_section_table(at, space)} for s, at in section]
    if isinstance(section, Taper):
        return {key: getattr(section, key) for key in _TAPER}
    across = {key: getattr(section, key) for key in ACROSS if space and getattr(section, key) is not None}
    return {key: getattr(section, key) for key in _SECTION} | across


def to_table(arm: Arm, space: bool = True) -> dict[str, Any]:
    """Return an arm as a TOML table without fields that have their default values."""
    table: dict[str, Any] = {"name": arm.name}
    if arm.source:
        table["source"] = arm.source
    own = check.changed(arm)
    table |= {key: own[key] for key in records.rules(Arm) if key in own}
    if arm.torque_limits is not None:
        table["torque_limits"] = arm.torque_limits
    if arm.joint_limits is not None:
        table["joint_limits"] = tuple(() if limits is None else limits for limits in arm.joint_limits)
    if arm.payload != Payload():
        table["payload"] = dataclasses.asdict(arm.payload)
        if not any(arm.payload.offset):
            del table["payload"]["offset"]
        if not arm.payload.radius:
            del table["payload"]["radius"]
    if arm.base is not None:
        table["base"] = vars(arm.base)
    table["links"] = [_link_table(link, space) for link in arm.links]
    if arm.elbows:
        table["elbows"] = [_elbow_table(elbow) for elbow in arm.elbows]
    if arm.sensors is not None:
        table["sensors"] = sensors.to_table(arm.sensors)
    if arm.joints:
        table["joints"] = [_joint_table(joint) for joint in arm.joints]
    return table


def _elbow_table(elbow: Elbow) -> dict[str, Any]:
    own = {key: value for key, value in check.changed(elbow).items() if key in ("axis", "mount", "radius")}
    return {key: getattr(elbow, key) for key in ("mass", "inertia_left", "inertia_right")} | own


def _joint_table(joint: Joint) -> dict[str, Any]:
    """Return the fields of a joint that differ from their defaults, and the given fields of its motor."""
    table = check.changed(joint)
    if joint.motor is not None:
        table["motor"] = {key: value for key, value in vars(joint.motor).items() if value is not None}
    return table
