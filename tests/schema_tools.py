"""Faults of a value by a JSON schema: of the validator `jsonschema` if it is installed, otherwise of a small one."""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

TYPES: dict[str, Any] = {
    "object": dict, "array": (list, tuple), "string": str, "number": (int, float), "integer": int, "boolean": bool,
}  # fmt: skip


def faults(value: Any, schema: dict[str, Any]) -> list[tuple[str, str]]:
    """Key path and message of every fault."""
    if find_spec("jsonschema"):
        import jsonschema

        jsonschema.Draft202012Validator.check_schema(schema)
        found = jsonschema.Draft202012Validator(schema).iter_errors(value)
        return [(".".join(map(str, one.absolute_path)), one.message) for one in found]
    return list(own_faults(value, schema))


def own_faults(value: Any, schema: dict[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """The keywords that the schemas of this package use, with the messages of `jsonschema`."""
    known = {"type", "properties", "required", "additionalProperties", "items", "minItems", "maxItems", "minLength",
             "minimum", "maximum", "exclusiveMinimum", "enum", "if", "then", "else", "description", "title",
             "$schema"}  # fmt: skip
    assert set(schema) <= known, set(schema) - known
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(is_of(value, kind) for kind in kinds):
        yield path, f"{value!r} is not of type {', '.join(map(repr, kinds))}"
    if "enum" in schema and value not in schema["enum"]:
        yield path, f"{value!r} is not one of {schema['enum']!r}"
    if is_of(value, "number"):
        if "exclusiveMinimum" in schema and not value > schema["exclusiveMinimum"]:
            yield path, f"{value!r} is less than or equal to the minimum of {schema['exclusiveMinimum']!r}"
        if "minimum" in schema and value < schema["minimum"]:
            yield path, f"{value!r} is less than the minimum of {schema['minimum']!r}"
        if "maximum" in schema and value > schema["maximum"]:
            yield path, f"{value!r} is greater than the maximum of {schema['maximum']!r}"
    if isinstance(value, str) and len(value) < schema.get("minLength", 0):
        yield path, f"{value!r} should be non-empty"
    if isinstance(value, list | tuple):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            yield path, f"{value!r} has the wrong length"
        for k, one in enumerate(value if "items" in schema else ()):
            yield from own_faults(one, schema["items"], f"{path}.{k}".lstrip("."))
    if isinstance(value, dict):
        for key in schema.get("required", ()):
            if key not in value:
                yield path, f"{key!r} is a required property"
        properties = schema.get("properties", {})
        for key, one in value.items():
            if key in properties:
                yield from own_faults(one, properties[key], f"{path}.{key}".lstrip("."))
            elif schema.get("additionalProperties") is False:
                yield path, f"Additional properties are not allowed ({key!r} was unexpected)"
    if "if" in schema:
        fits = not list(own_faults(value, schema["if"], path))
        yield from own_faults(value, schema.get("then" if fits else "else", {}), path)


def is_of(value: Any, kind: str) -> bool:
    """Whether a value is of a JSON type; a bool is no number."""
    return isinstance(value, TYPES[kind]) and (kind == "boolean" or not isinstance(value, bool))
