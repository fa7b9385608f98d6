"""`flexarm bench`: run a benchmark of a checkout (a clone of the repository).

`flexarm bench suite` and `flexarm bench page` do not need a checkout. The folder `benchmarks/` is searched in the
current folder and its parents, then beside the package. The script receives all arguments after its name, and the
command returns the script's exit code.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from flexarm_env.cli.codes import BAD_INPUT, DONE


def run(args: argparse.Namespace) -> int:
    """Run a benchmark script and return its exit code; 2 without a checkout or for an unknown script."""
    from flexarm_env.cli import suite

    home = checkout()
    name, words = (args.words[0], args.words[1:]) if args.words else ("", [])
    if name in suite.COMMANDS:
        return suite.run(name, words)
    known = {} if home is None else dict(benchmarks(home))
    if name in ("", "--json"):
        _list(suite.COMMANDS | known, as_json=name == "--json")
        return DONE
    if home is None:
        sys.stderr.write(
            "flexarm bench: needs benchmarks/ of a checkout, which was not found in "
            f"{Path.cwd()}, its parents or beside the package\n"
        )
        return BAD_INPUT
    script = name.replace("-", "_")  # as one may spell it on a command line
    if script not in known:
        sys.stderr.write(f"flexarm bench: no benchmark {name!r}; available: {', '.join((*suite.COMMANDS, *known))}\n")
        return BAD_INPUT
    return _module(home, f"benchmarks.{script}", words)


def checkout() -> Path | None:
    """Return the folder that contains benchmarks/ and flexarm_env: the current one, a parent, or the package's own."""
    here = Path.cwd()
    for place in (here, *here.parents, Path(__file__).resolve().parents[2]):
        if (place / "flexarm_env").is_dir() and any((place / "benchmarks").glob("*.py")):
            return place
    return None


def benchmarks(home: Path) -> Iterator[tuple[str, str]]:
    """Yield the name of each benchmark and the first sentence of its description."""
    for path in sorted((home / "benchmarks").glob("*.py")):
        text = path.read_text("utf-8")
        if "__main__" in text:
            yield path.stem, (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def _list(known: dict[str, str], as_json: bool) -> None:
    """Print name and first line of each benchmark, as text or JSON."""
    if as_json:
        print(json.dumps({"benchmarks": [{"name": k, "what": v} for k, v in known.items()]}, indent=2))
        return
    width = max(map(len, known), default=0)
    for name, what in known.items():
        print(f"{name:{width}}  {what}")


def _module(home: Path, module: str, words: Sequence[str]) -> int:
    """Run `python -m module words` in the current folder, with the checkout first on the path."""
    path = os.pathsep.join([str(home), *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.Popen([sys.executable, "-m", module, *words], env=os.environ | {"PYTHONPATH": path})
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:  # the script has been told as well, and ends in its own way
            continue
