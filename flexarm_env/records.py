"""Declare the fields of frozen dataclasses with type, unit, bounds and a description.

    @described
    @dataclass(frozen=True)
    class Base:
        \"\"\"Rigid body that carries a freely floating arm.\"\"\"

        mass: float = number("mass of the base", "kg", minimum=0.0)

        def __post_init__(self) -> None:
            validate(self)

The declarations determine validation (`validate`), reading from TOML (`made`), the arguments in the class's docstring
(`described`), rows of tables in the documentation (`rows`), command-line flags with help texts (`add_flags`) and a JSON
schema (`schema`). Rules that relate several fields are code in `__post_init__`.
"""

import argparse
import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

from flexarm_env import validation as check

T = TypeVar("T")
Schema = dict[str, Any]

RULE = "rule"
"""Key under which a dataclass field's metadata contain the field's `Rule`."""


@dataclass(frozen=True)
class Rule:
    """Rule for the values of a dataclass field, with the field's description.

    Attributes:
        text: description, without unit and bounds. unit: SI unit, or "" for a number without unit. check: function of
            key path and value that returns the value to store, or raises `InvalidValue`. json: JSON schema of the
            value. optional: True if the value None is permitted.
    """

    text: str
    unit: str
    check: Callable[[str, Any], Any]
    json: Mapping[str, Any]
    optional: bool = False

    def __call__(self, path: str, value: Any) -> Any:
        """Validate a value and return the value to store."""
        return None if value is None and self.optional else self.check(path, value)

    @property
    def allowed(self) -> str:
        """Phrase that states the permitted values in error messages: "must be a positive number (kg)"."""
        try:
            self.check("", object())
        except check.InvalidValue as error:
            return error.allowed
        return "must be given"


def number(
    text: str, unit: str = "", default: Any = MISSING, *, optional: bool = False,
    minimum: float | None = None, above: float | None = None, maximum: float | None = None,
) -> Any:  # fmt: skip
    """Declare a field with a finite number. The bounds are arguments of `validation.number`."""
    bounds: dict[str, Any] = {"minimum": minimum, "above": above, "maximum": maximum}
    words = {"minimum": "minimum", "above": "exclusiveMinimum", "maximum": "maximum"}
    json = {"type": "number"} | {words[key]: bound for key, bound in bounds.items() if bound is not None}
    return value(partial(check.number, unit=unit, **bounds), json, text, unit, default, optional=optional)


def integer(
    text: str, default: Any = MISSING, *, minimum: int, maximum: int | None = None, optional: bool = False
) -> Any:  # fmt: skip
    """Declare a field with a whole number. The bounds are arguments of `validation.integer`."""
    json = {"type": "integer", "minimum": minimum} | ({} if maximum is None else {"maximum": maximum})
    rule = partial(check.integer, minimum=minimum, maximum=maximum)
    return value(rule, json, text, "", default, optional=optional)


def choice(words: Sequence[str], text: str, default: Any = MISSING, *, optional: bool = False) -> Any:
    """Declare a field whose value is one of `words`."""
    return value(partial(check.choice, allowed=words), {"enum": list(words)}, text, "", default, optional=optional)


def switch(text: str, default: Any = MISSING, *, optional: bool = False) -> Any:
    """Declare a field that is True or False."""
    return value(check.flag, {"type": "boolean"}, text, "", default, optional=optional)


def words(text: str, default: Any = MISSING, *, empty: bool = True) -> Any:
    """Declare a field with a text. empty: True if the empty text is permitted."""
    json = {"type": "string"} if empty else {"type": "string", "minLength": 1}
    return value(partial(check.text, empty=empty), json, text, "", default)


def value(
    rule: Callable[[str, Any], Any], json: Mapping[str, Any], text: str, unit: str = "", default: Any = MISSING,
    *, optional: bool = False,
) -> Any:  # fmt: skip
    """Declare a field with a value that is neither a number nor a word.

    rule: function that validates the value. json: JSON schema of the value. text: one sentence of documentation.
    """
    return dataclasses.field(default=default, metadata={RULE: Rule(text, unit, rule, json, optional)})


def rules(kind: Any) -> dict[str, Rule]:
    """Return a dict of the rules of a class's fields by name, without fields that have no rule."""
    return {one.name: one.metadata[RULE] for one in dataclasses.fields(kind) if RULE in one.metadata}


def validate(record: Any, prefix: str = "") -> None:
    """Validate all fields that have a rule, in order, and store the converted values. prefix: key path of the record.

    Raises:
        InvalidValue: the message names the field's key path, the value and the rule.
    """
    for name, rule in rules(record).items():
        check.store(record, **{name: rule(check.joined(prefix, name), getattr(record, name))})


def made(path: str, kind: type[T], table: object, *, prefix: str | None = None) -> T:
    """Create an object of class `kind` from a table of a TOML file. path, prefix: as in `validation.made`.

    Raises:
        ValueError: a value is invalid, or a key is missing or unknown; the message names the key path and the rule.
    """
    known = rules(kind)
    required = {name: known[name].allowed for name in _required(kind) if name in known}
    return check.made(path, kind, table, prefix=prefix, **required)


def _required(kind: Any) -> list[str]:
    """Return the names of a class's fields without default."""
    own = [one for one in dataclasses.fields(kind) if one.init]
    return [one.name for one in own if one.default is MISSING and one.default_factory is MISSING]


# ------------------------------------------------------------------ documentation
def described(kind: type[T]) -> type[T]:
    """Append the declared fields, with description, unit and bounds, to the arguments in the docstring of a class.

    A description in the docstring replaces the description in the field's declaration.
    """
    text = inspect.cleandoc(kind.__doc__ or "")
    lines = [] if "\nArgs:\n" in text else ["", "Args:"]
    for name, rule in rules(kind).items():
        if f"\n    {name}: " in text:
            continue
        words = ", ".join([*filter(None, [rule.unit]), *_bounds(rule)])
        lines.append(f"    {name}: {rule.text}{f' ({words})' if words else ''}.")
    kind.__doc__ = "\n".join([text, *lines]) + "\n"
    return kind


def _bounds(rule: Rule) -> list[str]:
    """Return the bounds of a field in words."""
    low, above, high = (rule.json.get(key) for key in ("minimum", "exclusiveMinimum", "maximum"))
    found = ["positive"] if above == 0.0 else [] if above is None else [f"above {above:g}"]
    found += [] if low is None else ["zero or positive"] if low == 0.0 else [f"at least {low:g}"]
    found += [] if high is None else [f"at most {high:g}"]
    found += [", ".join(f'"{word}"' for word in rule.json["enum"])] if "enum" in rule.json else []
    return [*found, "optional"] if rule.optional else found


def rows(kind: Any) -> list[tuple[str, str, str, str]]:
    """Return a row for each field with a rule: name, default, unit and bounds, description."""
    found, required = [], _required(kind)
    defaults = {one.name: one.default for one in dataclasses.fields(kind)}
    for name, rule in rules(kind).items():
        default = defaults[name]
        shown = "required" if name in required else "" if default in (None, MISSING) else f"`{default!r}`"
        found.append((f"`{name}`", shown, ", ".join([*filter(None, [rule.unit]), *_bounds(rule)]), rule.text))
    return found


# ------------------------------------------------------------------ command line
PARSED = {"integer": (int, "N"), "number": (float, "X"), "boolean": (bool, ""), "string": (str, "TEXT")}
"""Type of a flag's value and its placeholder, by the type in the JSON schema."""


class Flag(NamedTuple):
    """A command-line flag for a field of a record."""

    name: str  # of the field
    kind: type  # int, float, bool or str
    metavar: str  # placeholder of the value
    help: str


def flags(kind: Any) -> list[Flag]:
    """Return a flag for each field whose value is a number, a text, one of several words, or a boolean."""
    found = []
    for name, rule in rules(kind).items():
        parsed, metavar = (str, "NAME") if "enum" in rule.json else PARSED.get(rule.json.get("type", ""), (None, ""))
        if parsed is not None:
            limits = [word for word in _bounds(rule) if word != "optional"]
            inside = ", ".join([*filter(None, [rule.unit]), *limits])
            found.append(Flag(name, parsed, metavar, f"{rule.text}{f' ({inside})' if inside else ''}"))
    return found


def add_flags(parser: Any, kind: Any) -> None:
    """Add the `flags` of a record to an argparse parser or group; a flag that is not given is None.

    Values are validated when the record is created.
    """
    for name, parsed, metavar, text in flags(kind):
        flag, text = f"--{name.replace('_', '-')}", text.replace("%", "%%")
        if parsed is bool:
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            parser.add_argument(flag, type=parsed, metavar=metavar, help=text)


# ------------------------------------------------------------------ JSON schema
def schema(kind: Any, **more: Any) -> Schema:
    """Return the JSON schema of a table with a class's fields.

    more: JSON schemas by field name. A schema in `more` applies to a field without a rule, or replaces the schema of
    the field's rule.
    """
    known = {name: _described(rule) for name, rule in rules(kind).items()} | more
    fields = [one for one in dataclasses.fields(kind) if one.init]
    properties = {one.name: known.get(one.name) or _by_type(str(one.type)) for one in fields}
    return {
        "type": "object", "properties": properties, "required": _required(kind), "additionalProperties": False,
        "description": inspect.cleandoc(kind.__doc__ or "").partition("\n")[0],
    }  # fmt: skip


def _described(rule: Rule) -> Schema:
    """Return the schema of a field, with unit and sentence as description."""
    return {**rule.json, "description": f"{rule.text}{f' ({rule.unit})' if rule.unit else ''}"}


def _by_type(words: str) -> Schema:
    """Return the schema of a field without rule from its annotation; {} permits any value."""
    simple = {"float": "number", "int": "integer", "str": "string", "bool": "boolean"}
    name = words.removeprefix("<class '").removesuffix("'>").removesuffix(" | None")
    return {"type": simple[name]} if name in simple else {}


def by_key(cases: Mapping[str, Schema], otherwise: Schema) -> Schema:
    """Return the schema of a table whose form depends on its keys.

    The first key of `cases` that the table has selects a schema. With the returned schema a validator reports the error
    within the table, instead of reporting only that no schema matches.
    """
    found = otherwise
    for key, one in reversed(list(cases.items())):
        found = {"if": {"type": "object", "required": [key]}, "then": one, "else": found}
    return found
