"""From an environment to a folder with a shared object, a header, an example, a CMake file and a pkg-config file."""

import platform
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import validation as check
from ..compiler import UNCOMPILED
from ..compiler.image import Image
from ..compiler.program import is_processor, linkable
from ..derivatives import Periods
from ..files import write_whole
from ..physics.model import Jointed
from ..runtime import adjoint, episode, starts
from ..tasks.program import Models, complete
from .source import Source

CPU = "x86-64-v2"
"""What is built for unless another processor is named: every x86-64 since about 2009."""

CHANGING = (
    "block", "action", "queue", "observation", "table", "reward", "terminated", "truncated", "stream", "request",
)  # fmt: skip
"""Arrays of a `tasks.program.Program` that stepping and starting write to."""

LAWS = ("model.data", *(f"models.{word}.data" for word in Models._fields))
"""And those that hold the numbers of joints, which may be set."""


@dataclass(frozen=True)
class Built:
    """What was written. files: names in the folder; objects: those that hold programs; library: the shared object's, or
    None, and then why not. source: the texts."""

    folder: Path
    name: str
    files: tuple[str, ...]
    objects: tuple[str, ...]
    source: Source
    library: str | None
    why: str = ""


def write(env: Any, folder: Path, name: str, cpu: str | None = None, derivatives: bool = True) -> Built:
    """The arm of an environment with its task as a library in C.

    Its bits are those of the environment: the same arm, random streams and task; actions are float64, energies kept.
    There is no time limit: whoever steps it ends.

    Args:
        env: single, of this package; without a prescribed motion. folder: is made where it is not there. name: a C
            identifier, in front of all that the library defines. cpu: by LLVM's name, "native" for this machine;
            default `CPU`. derivatives: jvp and vjp of a period, where the arm has them.
    Raises:
        ValueError: another environment; a machine that is not Linux on x86-64; nothing is compiled here.
    """
    system = f"{platform.system()} {platform.machine()}"
    if system != "Linux x86_64":
        raise ValueError(f"libraries are built on Linux x86-64, where they have been tried; this is {system}")
    if UNCOMPILED:
        raise ValueError("FLEXARM_COMPILER=python: a library is made of compiled programs, and nothing is compiled")
    plain = getattr(env, "unwrapped", env)
    batch, plan = getattr(plain, "batch", None), getattr(plain, "plan", None)
    if batch is None or plan is None or batch.n != 1:
        raise ValueError(f"env = {env}: must be a single environment of flexarm_env")
    if plan.motion is not None:
        raise check.InvalidValue(
            "motion", plan.motion, "must be left out: a library's arm is moved by its motors alone"
        )
    check_name(name)
    target = None if cpu == "native" else CPU if cpu is None else cpu
    if target not in (None, CPU) and not is_processor(target):
        raise check.InvalidValue("cpu", cpu, "must be native, or x86-64-v3, znver4, ... as LLVM calls them")
    folder.mkdir(parents=True, exist_ok=True)  # what cannot be written is told before anything is compiled
    program = complete(batch.program)._replace(action=np.zeros(batch.action.size), books=(0,))
    worlds = [Image.of(program, (*CHANGING, *(LAWS if isinstance(program.model, Jointed) else ())))]
    made = [(f"{name}_step_program", episode.step), (f"{name}_start_program", starts.start_episodes)]
    periods, absent = _periods(batch) if derivatives else (None, "left out")
    images = [worlds[0], worlds[0]]
    if periods is not None:
        given = periods._program
        own = [key for key, value in zip(given._fields, given, strict=True) if isinstance(value, np.ndarray)]
        worlds.append(Image.of(given, [key for key in own if key not in ("places", "twice", "chosen")]))
        made.append((f"{name}_jacobian_program", periods._derivative))
        if periods.backwards:
            made.append((f"{name}_adjoint_program", adjoint.adjoint))
        images += [worlds[1]] * (len(made) - 2)
    objects = {
        f"{symbol}.o": linkable(kernel, image.layout, symbol, target)
        for (symbol, kernel), image in zip(made, images, strict=True)
    }
    source = Source(env, name, worlds, periods, absent, [symbol for symbol, _ in made], target or "this machine")
    files = {**objects, **{key: text.encode() for key, text in source.files().items()}}
    for key, content in files.items():
        write_whole(folder / key, content)
    library, why = linked(folder, f"lib{name}.so", [f"{name}.c", *objects])
    return Built(folder, name, (*files, *([library] if library else [])), tuple(objects), source, library, why)


def check_name(name: str) -> None:
    """ValueError for what C has for no name."""
    if not re.fullmatch(r"[A-Za-z_]\w{0,59}", name, flags=re.ASCII):
        raise check.InvalidValue("name", name, "must be a C identifier: letters, digits, _, at most 60")


def _periods(batch: Any) -> tuple[Periods | None, str]:
    """The derivatives of the batch's one arm, or why there are none."""
    try:
        periods = Periods(batch, whole=True)
    except (ValueError, NotImplementedError) as error:
        return None, " ".join(str(error).split())
    if periods._memory.frames:
        periods.close()
        return None, "an observation here shows what was before"
    return periods, ""


def told(stderr: str) -> str:
    """The first error of a compiler, or the last thing it said."""
    lines = stderr.strip().splitlines() or ["no word"]
    return next((line for line in lines if "error" in line.lower()), lines[-1])[:500]


def linked(folder: Path, library: str, parts: Sequence[str]) -> tuple[str | None, str]:
    """A shared object of files of C and objects, made by the machine's C compiler; None and why."""
    compiler = next((word for word in ("cc", "gcc", "clang") if shutil.which(word)), None)
    if compiler is None:
        return None, f"no C compiler is there; where one is: cmake -S {folder} -B build && cmake --build build"
    command = [
        compiler, "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Wextra",
        f"-Wl,-soname,{library}", "-o", library, *parts, "-lm",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(done.returncode, f"{compiler} ends with {told(done.stderr)}", str(folder / library))
    return library, ""
