"""Convert functions of time to tables and back, with `kind` and parameters as in TOML files."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flexarm_env import time_functions
from flexarm_env import validation as check
from flexarm_env.time_functions import TimeFunction

KINDS: dict[str, Callable[..., TimeFunction]] = {
    name: getattr(time_functions, name)
    for name in (
        "constant", "pulse", "ramp", "cycloid", "spin_up", "sine", "steps", "linear_table", "spline_table",
        "hermite_table", "table",
    )
}  # fmt: skip
KINDS["pieces"] = lambda pieces: TimeFunction(pieces)
"""Values of ``kind`` in a TOML file; "csv" (with file and the arguments of `from_csv`) is an additional value."""
_CSV = ("interpolation", "column", "time", "rate", "acceleration", "scale")


def function_from_table(entry: Mapping[str, Any], directory: Path) -> TimeFunction:
    """Create a function of time from a TOML table with the key ``kind`` and the parameters of this kind.

    Paths of CSV files are relative to ``directory``.
    """
    kind = check.needed("", entry, "kind", "must be one of " + ", ".join(f'"{k}"' for k in (*KINDS, "csv")))
    check.choice("kind", kind, (*KINDS, "csv"))
    given = {key: value for key, value in entry.items() if key != "kind"}
    # a file: relative to the scene's directory
    if kind == "csv":
        check.known_keys("", given, ("file", *_CSV), 'parameter of kind "csv"')
        name = check.text("file", check.needed("", given, "file", "must be the name of a CSV file"))
        path = directory / name
        if not path.is_file():
            raise check.InvalidValue("file", name, f"must be a CSV file; there is none at {path}")
        return time_functions.from_csv(path, **{key: given[key] for key in _CSV if key in given})
    # other kinds: parameters are the arguments of the function of that name
    signature = inspect.signature(KINDS[kind]).parameters
    check.known_keys("", given, signature, f'parameter of kind "{kind}"')
    for name, parameter in signature.items():
        if parameter.default is parameter.empty:
            check.needed("", given, name, f'kind "{kind}" takes {", ".join(signature)}')
    return KINDS[kind](**given)


def function_table(function: TimeFunction) -> dict[str, Any]:
    """Return a TOML table from which :func:`function_from_table` creates an equal function."""
    return {"kind": function.kind, **dict(function.parameters)}
