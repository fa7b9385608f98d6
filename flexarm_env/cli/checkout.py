"""`flexarm train`, `evaluate` and `bench`: what a checkout brings beside the package, run with the flags given.

`flexarm bench suite` and `page` are the package's own.

`agents/` and `benchmarks/` are looked for in the current folder and those above it, then beside the package. All words
behind the command go to the script, and its exit code comes back.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from flexarm_env.cli.codes import BAD_INPUT, DONE

SCRIPTS = {"train": "agents.train_ppo", "evaluate": "agents.evaluate", "bench": ""}
"""Commands that run what a checkout brings, and their scripts."""


def run(args: argparse.Namespace) -> int:
    """Run the script; the exit code is its own. 2 with a sentence where there is no checkout, or no such script."""
    folder = "benchmarks" if args.command == "bench" else "agents"
    home = checkout(folder)
    if args.command == "bench":
        from flexarm_env.cli import suite

        name, words = (args.words[0], args.words[1:]) if args.words else ("", [])
        if name in suite.COMMANDS:
            return suite.run(name, words)
        if name in ("", "--json"):
            _list(suite.COMMANDS | ({} if home is None else dict(benchmarks(home))), as_json=name == "--json")
            return DONE
    if home is None:
        sys.stderr.write(
            f"flexarm {args.command}: needs {folder}/ of a checkout, and there is none in {Path.cwd()}, above it or "
            "beside the package\n"
        )
        return BAD_INPUT
    if args.command != "bench":
        return _module(home, SCRIPTS[args.command], args.words)
    known = dict(benchmarks(home))
    script = name.replace("-", "_")  # as one may spell it on a command line
    if script not in known:
        sys.stderr.write(f"flexarm bench: no benchmark {name!r}; there are {', '.join((*suite.COMMANDS, *known))}\n")
        return BAD_INPUT
    return _module(home, f"benchmarks.{script}", words)


def checkout(folder: str) -> Path | None:
    """The folder that holds `folder` with Python files beside a flexarm_env: here, above, or the package's own."""
    here = Path.cwd()
    for place in (here, *here.parents, Path(__file__).resolve().parents[2]):
        if (place / "flexarm_env").is_dir() and any((place / folder).glob("*.py")):
            return place
    return None


def benchmarks(home: Path) -> Iterator[tuple[str, str]]:
    """Name and first sentence of each benchmark that can be run."""
    for path in sorted((home / "benchmarks").glob("*.py")):
        text = path.read_text("utf-8")
        if "__main__" in text:
            yield path.stem, (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def flags(script: str) -> str:
    """Flags of a script of agents/, from the docstrings of its `Arguments` and what that extends; "" where there is no
    checkout."""
    home = checkout("agents")
    path = None if home is None else home.joinpath(*script.split(".")).with_suffix(".py")
    if path is None or not path.is_file():
        return ""
    classes = _classes(path) | _classes(path.parent / "runs.py")
    given = classes.get("Arguments")
    bases = [] if given is None else [base.id for base in given.bases if isinstance(base, ast.Name)]
    found: dict[str, str] = {}
    for name in (*bases, "Arguments"):
        text = (ast.get_docstring(classes[name]) or "") if name in classes else ""
        found |= re.findall(r"^\s+(\w+): (.*(?:\n {8,}.*)*)", text.partition("Args:")[2], re.MULTILINE)
    entries = list(found.items())
    if not entries:
        return ""
    names = {name: "--" + name.replace("_", "-") for name, _ in entries}
    width = max(len(name) for name in names.values())
    lines = [f"  {names[name]:{width}}  {' '.join(words.split()).rstrip('.')}" for name, words in entries]
    return "\n".join(["flags:", *lines, ""])


def _classes(path: Path) -> dict[str, ast.ClassDef]:
    """Of a Python file, by name."""
    if not path.is_file():
        return {}
    return {node.name: node for node in ast.parse(path.read_text("utf-8")).body if isinstance(node, ast.ClassDef)}


def _list(known: dict[str, str], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"benchmarks": [{"name": k, "what": v} for k, v in known.items()]}, indent=2))
        return
    width = max(map(len, known), default=0)
    for name, what in known.items():
        print(f"{name:{width}}  {what}")


def _module(home: Path, module: str, words: Sequence[str]) -> int:
    """`python -m module words`, in the current folder, with the checkout first on the path."""
    path = os.pathsep.join([str(home), *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.Popen([sys.executable, "-m", module, *words], env=os.environ | {"PYTHONPATH": path})
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:  # the script has been told as well, and ends in its own way
            continue
