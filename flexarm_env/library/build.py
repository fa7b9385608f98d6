"""Build a C library from an environment: a folder with shared object, header, example, CMake and pkg-config files."""

import platform
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
from ..compiler.program import linkable
from ..compiler.target import is_processor
from ..control.export import check_name
from ..derivatives import Periods
from ..files import write_whole
from ..physics.model import Jointed
from ..runtime import adjoint, episode, starts
from ..tasks.program import Models, complete
from .source import Source

CPU = "x86-64-v2"
"""LLVM's name of the default target processor, which includes every x86-64 processor since about 2009."""

CHANGING = (
    "block", "action", "queue", "observation", "table", "reward", "terminated", "truncated", "stream", "request",
)  # fmt: skip
"""Names of the arrays of a `tasks.program.Program` that steps and resets write to. All other arrays are constant data.
"""

TAKEN = ("example", "m", "c")
"""Names that a library cannot have: the name of its example program, and the names of the C libraries that it uses."""

LAWS = ("model.data", *(f"models.{word}.data" for word in Models._fields))
"""Names of the arrays of the joints' parameters, which a user of the library may set."""


@dataclass(frozen=True)
class Built:
    """Files that `write` has written.

    folder: the library's folder. name: prefix of all C names. files: names of the files in the folder. objects: names
    of the object files with the arm's machine code. source: the generated C source. library: name of the shared object,
    or None if it could not be linked. why: the reason why `library` is None.
    """

    folder: Path
    name: str
    files: tuple[str, ...]
    objects: tuple[str, ...]
    source: Source
    library: str | None
    why: str = ""


def write(env: Any, folder: Path, name: str, cpu: str | None = None, derivatives: bool = True) -> Built:
    """Write an environment's arm and task as a C library into a folder.

    The library returns bitwise the same results as the environment with the same arm, seed and task. Actions are
    float64, and the energy balance is computed. The library has no time limit: the calling program ends an episode.

    Args:
        env: single environment of this package, without a prescribed motion. folder: output folder, created if missing.
        name: C identifier, prefix of all names that the library defines. cpu: LLVM's name of the processor, "native"
            for this machine, or None for `CPU`. derivatives: True to include the derivatives (jvp and vjp) of a control
            period, if the arm has derivatives.
    Raises:
        ValueError: the environment is not supported, the machine is not Linux on x86-64, or compilation is disabled.
    """
    system = f"{platform.system()} {platform.machine()}"
    if system != "Linux x86_64":
        raise ValueError(f"libraries can only be built on Linux x86-64; this is {system}")
    if UNCOMPILED:
        raise ValueError("FLEXARM_COMPILER=python: a library needs compiled programs, but compilation is switched off")
    plain = getattr(env, "unwrapped", env)
    batch, plan = getattr(plain, "batch", None), getattr(plain, "plan", None)
    # validate environment, name and processor before anything is compiled
    if batch is None or plan is None or batch.n != 1:
        raise ValueError(f"env = {env}: must be a single environment of flexarm_env")
    if plan.motion is not None:
        raise check.InvalidValue(
            "motion", plan.motion, "must be left out: a library's arm is moved by its motors alone"
        )
    if check_name(name) in TAKEN:
        raise check.InvalidValue("name", name, f"must not be {', '.join(TAKEN)}, which are other files or libraries")
    target = None if cpu == "native" else CPU if cpu is None else cpu
    if target not in (None, CPU) and not is_processor(target):
        raise check.InvalidValue("cpu", cpu, "must be native, or x86-64-v3, znver4, ... as LLVM calls them")
    # fail before compiling if the folder cannot be written
    folder.mkdir(parents=True, exist_ok=True)
    # world 0: data of stepping and starting, with float64 actions and the energy balance
    program = complete(batch.program)._replace(action=np.zeros(batch.action.size), books=(0,))
    worlds = [Image.of(program, (*CHANGING, *(LAWS if isinstance(program.model, Jointed) else ())))]
    made = [(f"{name}_step_program", episode.step), (f"{name}_start_program", starts.start_episodes)]
    periods, absent = _periods(batch) if derivatives else (None, "left out")
    images = [worlds[0], worlds[0]]
    # world 1: data of the derivatives, whose arrays are written to, except places, twice and chosen
    if periods is not None:
        given = periods._program
        own = [key for key, value in zip(given._fields, given, strict=True) if isinstance(value, np.ndarray)]
        worlds.append(Image.of(given, [key for key in own if key not in ("places", "twice", "chosen")]))
        made.append((f"{name}_jacobian_program", periods._derivative))
        if periods.backwards:
            made.append((f"{name}_adjoint_program", adjoint.adjoint))
        images += [worlds[1]] * (len(made) - 2)
    # compile each program to an object file, with the memory layout of its world
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


def _periods(batch: Any) -> tuple[Periods | None, str]:
    """Return the derivatives of the batch's arm and "", or None and the reason why the arm has no derivatives."""
    try:
        periods = Periods(batch, whole=True)
    except (ValueError, NotImplementedError) as error:
        return None, " ".join(str(error).split())
    # stacked observations depend on earlier periods, which a derivative of one period lacks
    if periods._memory.frames:
        periods.close()
        return None, "an observation here shows what was before"
    return periods, ""


def first_error(stderr: str) -> str:
    """Return a compiler's first error line, or the last line if there is no error; at most 500 characters."""
    lines = stderr.strip().splitlines() or ["no word"]
    return next((line for line in lines if "error" in line.lower()), lines[-1])[:500]


def linked(folder: Path, library: str, parts: Sequence[str]) -> tuple[str | None, str]:
    """Compile and link C files and objects into a shared object; return (name, "") or (None, reason).

    folder: folder of the files. library: name of the shared object. parts: names of the C files and object files.

    Raises:
        OSError: the C compiler reports an error.
    """
    compiler = next((word for word in ("cc", "gcc", "clang") if shutil.which(word)), None)
    if compiler is None:
        return None, f"no C compiler is there; where one is: cmake -S {folder} -B build && cmake --build build"
    # -ffp-contract=off: no fused multiply-add, so that bits equal Python's
    command = [
        compiler, "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Wextra",
        f"-Wl,-soname,{library}", "-o", library, *parts, "-lm",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(done.returncode, f"{compiler} ends with {first_error(done.stderr)}", str(folder / library))
    return library, ""
