"""Command-line parsers that are built from dataclasses: each field becomes a flag.

The help text of a flag is the description, unit and bounds of a declared field (`flexarm_env.records`). For other
fields the help text is the entry under "Args" in the class's docstring.
"""

import argparse
import dataclasses
import difflib
import json
import re
import sys
import typing
from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

from flexarm_env.records import flags

T = TypeVar("T")


class Parser(argparse.ArgumentParser):
    """ArgumentParser that prints each error as one sentence and keeps the description's line breaks in its help."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **options)

    def unknown(self, words: Sequence[str]) -> NoReturn:
        """Exit with an error for unrecognized words, suggesting the closest flag."""
        flags = [flag for action in self._actions for flag in action.option_strings]
        near = difflib.get_close_matches(words[0], flags, n=1, cutoff=0.7) if words[0].startswith("-") else []
        self.error(f"unrecognized arguments: {' '.join(words)}" + (f", did you mean {near[0]}?" if near else ""))

    def error(self, message: str) -> NoReturn:
        """Exit with code 2 and a sentence that refers to --help."""
        sys.stderr.write(f"{self.prog}: {message} (see {self.prog} --help)\n")
        sys.exit(2)


def parse(kind: type[T], program: str, description: str | None, words: Sequence[str] | None = None) -> T:
    """Parse the command line into an instance of the dataclass `kind`.

    Fields of type bool become switches: --name, or --no-name if the default is True. The user writes a dict as JSON,
    and repeats the flag of a tuple for each item (--name A --name B).
    """
    parser = Parser(prog=program, description=description, epilog="exit code: 0 done, 2 wrong input, 130 interrupted")
    texts, types = _texts(kind), typing.get_type_hints(kind)
    texts |= {flag.name: flag.help for flag in flags(kind)}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        options: dict[str, Any] = {"dest": field.name, "help": texts.get(field.name, "").replace("%", "%%")}
        flag = "--" + field.name.replace("_", "-")
        default = None if field.default is dataclasses.MISSING else field.default
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            options["required"] = True
        elif field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if default is not None and default is not False and default not in ("", {}, ()):
            options["help"] += " (on)" if default is True else f" ({default})"
        # the field's type without None selects the kind of flag
        wanted = [t for t in (typing.get_args(types[field.name]) or (types[field.name],)) if t is not type(None)]
        if types[field.name] is bool:
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=default, **options)
        elif typing.get_origin(types[field.name]) is tuple:
            parser.add_argument(flag, action="append", metavar="KEY=VALUE", default=list(default or ()), **options)
        elif typing.get_origin(types[field.name]) is dict:
            parser.add_argument(flag, type=_table, default=default, metavar="JSON", **options)
        else:
            parser.add_argument(flag, type=_number if wanted[0] is int else wanted[0], default=default, **options)
    found, more = parser.parse_known_args(words)
    if more:
        parser.unknown(more)
    return kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in vars(found).items()})


def _number(text: str) -> int:
    """Parse an integer; forms such as 1e6 are accepted."""
    value = float(text)
    if not value.is_integer():
        raise ValueError
    return int(value)


def _table(text: str) -> dict[str, Any]:
    """Parse a JSON object from the command line."""
    try:
        value = json.loads(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON such as '{{\"key\": 1}}'") from error
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"{text!r} is not a JSON object such as '{{\"key\": 1}}'")
    return value


def _texts(kind: type[Any]) -> dict[str, str]:
    """Read each field's help from the entries `name: text` in the Args sections of the class and its bases."""
    names, texts = [field.name for field in dataclasses.fields(kind)], {}
    for base in reversed(kind.__mro__):
        body = (base.__doc__ or "").partition("Args:")[2]
        marks = [m for m in re.finditer(r"^\s*(\w+):\s", body, re.MULTILINE) if m.group(1) in names]
        ends = [m.start() for m in marks[1:]] + [len(body)]
        for mark, end in zip(marks, ends, strict=False):  # a class without any says nothing
            texts[mark.group(1)] = " ".join(body[mark.end() : end].split()).rstrip(".")
    return texts
