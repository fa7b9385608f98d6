"""What every results file says of the machine it was made on, and files written whole or not at all."""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.running import cores

PACKAGES = ("flexarm-env", "numpy", "numba", "gymnasium")


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def describe_machine(*packages: str) -> dict[str, str]:
    """Date, processor, cores, Python and the versions of the packages that matter (and of those named)."""
    facts = {
        "date": date.today().isoformat(),
        "processor": _processor(),
        "cores": str(cores()),
        "python": platform.python_version(),
    }
    for name in (*PACKAGES, *packages):
        try:
            facts[name] = version(name)
        except PackageNotFoundError:
            facts[name] = "not installed"
    return facts


def cpu_seconds() -> float:
    """Processor time that this process and those that it has waited for have used up to now, s."""
    return sum(os.times()[:4])


def write_text(path: Path, text: str) -> None:
    """Write a file completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_results(
    name: str, folder: Path, found: dict[str, Any], page: Callable[[dict[str, Any], dict[str, str]], str]
) -> int:
    """Write NAME.json and NAME.md (`page` of what was found and of the machine), and print what holds of
    found["verdicts"]; the exit code is 1 where something does not."""
    for what, holds in found["verdicts"].items():
        print(f"{'ok ' if holds else 'NO '} {what}")
    machine = describe_machine()
    write_text(folder / f"{name}.json", json.dumps({"machine": machine, **found}, indent=1) + "\n")
    write_text(folder / f"{name}.md", page(found, machine))
    return 0 if all(found["verdicts"].values()) else 1


def folders(description: str | None, arguments: list[str] | None, docs: Path) -> argparse.Namespace:
    """Where a benchmark is told to leave its results (`out`) and figures (`figures`); below docs/ where it is not."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=docs / "results", help="folder of the results")
    parser.add_argument("--figures", type=Path, default=docs / "figures", help="folder of the figures")
    return parser.parse_args(arguments)
