"""Common functions of the benchmarks: parse the command line, describe the machine, measure processor time."""

import argparse
import os
import platform
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import flexarm_env
from benchmarks.running import cores
from flexarm_env.files import table as table
from flexarm_env.files import write_text as write_text
from flexarm_env.validation import installed

DOCS = Path(__file__).resolve().parents[1] / "docs"
PACKAGES = ("numpy", "llvmlite", "gymnasium")


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def describe_machine(*packages: str) -> dict[str, str]:
    """Return date, processor, number of cores, Python version, and the versions of the main and the named packages."""
    facts = {
        "date": date.today().isoformat(),
        "processor": _processor(),
        "cores": str(cores()),
        "python": platform.python_version(),
        "flexarm_env": flexarm_env.__version__,  # of this tree; an editable install may still say another
    }
    return facts | {name: installed(name) or "not installed" for name in (*PACKAGES, *packages)}


def cpu_seconds() -> float:
    """Return the processor time, s, that this process and its finished child processes have used."""
    return sum(os.times()[:4])


def told(machine: Mapping[str, Any]) -> str:
    """Format the description of a machine as one line."""
    return " · ".join(f"{key}: {fact}" for key, fact in machine.items())


def command(description: str | None, **numbers: int) -> argparse.ArgumentParser:
    """Return a parser with the flags --out and --figures, and an integer flag for each of `numbers` (name=default)."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--out", type=Path, default=DOCS / "results", help="folder of the results")
    parser.add_argument("--figures", type=Path, default=DOCS / "figures", help="folder of the figures")
    return parser
