"""Count the machine instructions of compiled programs with callgrind.

    python -m benchmarks.instructions FILE [--only WORDS ...]             counts, and adds the results to FILE (JSON)
    python -m benchmarks.instructions FILE --compare OTHER [--only ...]   prints FILE's counts over those of OTHER

Each program of `PROGRAMS` runs in its own process under valgrind. Nothing is counted while the program starts, compiles
and takes its first steps. Then the program repeats its work ten times, and the instructions of the repetitions are
counted. Instructions in memory that was not read from a file are those of the compiled code; the rest, mostly Python's
interpreter, is listed separately. Counts are of one run: the same code gives the same number, to a few in a million.

The repository contains the counts of some programs, benchmarks/instructions_record.json. A commit that changes these
counts on purpose counts the programs again.

Valgrind presents a Haswell processor, without AVX-512, to the programs. Code for that processor is compiled in advance,
outside of valgrind, in a temporary folder (or in the folder of --cache).
"""

import argparse
import ctypes
import json
import mmap
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.cold_start import CASES, FLOATING, MODES, Work, derivatives, environment, scene

SPATIAL = "SpatialFlexArm-v0"
IN_SPACE: dict[str, dict[str, Any]] = {
    "floating frame": FLOATING, "modes": MODES, "loaded": {"arm": "three_dof_loaded", "info_level": "full"},
}  # fmt: skip
"""Kinds of arms in space that are counted in addition to those of `cold_start`."""
PROGRAMS: dict[str, Callable[[], Work]] = dict(CASES)
"""Counted programs: the cases of `benchmarks.cold_start`, and the same work with all formulations in space."""
for _word, _keywords in IN_SPACE.items():
    for _n, _how in ((1, "single"), (64, "vector 64")):
        PROGRAMS[f"in space, {_word}, {_how}"] = partial(environment, _n, SPATIAL, _keywords)
    for _back, _how in ((False, "Jacobians"), (True, "cotangents")):
        PROGRAMS[f"{_how}, in space, {_word}"] = partial(derivatives, _back, SPATIAL, _keywords)
for _formulation in ("elastica", "geometrically_exact", "floating_frame"):
    PROGRAMS[f"scene in space, {_formulation}"] = partial(scene, "three_dof_slew", _formulation)

TIMES = 10
"""Number of repetitions of the counted work."""

REQUEST = bytes.fromhex("4889f8 31d2 48c1c703 48c1c70d 48c1c73d 48c1c733 4887db 4889d0 c3")
"""x86-64 machine code of a function f(request*) that valgrind recognizes as a client request (valgrind.h).

Without valgrind the code has no effect.
"""
DUMP, ZERO, START, STOP = (0x43540000 + k for k in (0, 1, 4, 5))
"""Numbers of callgrind's client requests (callgrind.h)."""


def asker() -> Callable[[int], None]:
    """Return a function that sends a request to callgrind."""
    room = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    room.write(REQUEST)
    code = ctypes.c_char.from_buffer(room)  # as long as this is there, so is the room
    function = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)(ctypes.addressof(code))

    def ask(request: int) -> None:
        assert code is not None
        function(ctypes.cast((ctypes.c_uint64 * 6)(request), ctypes.c_void_p))

    return ask


def of_files() -> list[tuple[int, int]]:
    """Return the address ranges of this process whose machine code was read from files: Python, libraries."""
    ranges = []
    for line in Path("/proc/self/maps").read_text("utf-8").splitlines():
        addresses, access, _, _, node = line.split()[:5]
        if "x" in access and node != "0":
            begin, end = addresses.split("-")
            ranges.append((int(begin, 16), int(end, 16)))
    return ranges


def driver(name: str) -> None:
    """Run a program in the process that callgrind observes; print `of_files`."""
    ask, work = asker(), PROGRAMS[name]()
    work()
    # the program that a batch compiles in the background is not counted
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()
    ask(START)
    ask(ZERO)
    for _ in range(TIMES):
        work()
    ask(DUMP)
    ask(STOP)
    print(json.dumps(of_files()))


def counts(text: str, files: list[tuple[int, int]]) -> dict[str, int]:
    """Return the instruction counts of a callgrind dump: "compiled" (code not read from a file), "all".

    files: `of_files` of the program. Callgrind attributes the jump tables of libraries (.plt) to no file either, and
    names functions without a symbol by their address.
    """
    objects: dict[str, str] = {}
    functions: dict[str, str] = {}
    memory = total = 0
    unknown = ours = called = False
    for line in text.splitlines():
        # ob=, fn=: object and function of the lines that follow; cob=, cfn=: those of a callee
        found = re.match(r"(c?)(ob|fn)=(\(\d+\))\s*(.*)", line)
        if found:
            of_callee, key, number, name = found.groups()
            names = objects if key == "ob" else functions
            name = names.setdefault(number, name) if name else names[number]
            if key == "ob" and not of_callee:
                unknown = name == "???"
            elif not of_callee:
                ours = unknown and not any(begin <= int(name.split("'")[0], 16) < end for begin, end in files)
        elif line.startswith("calls="):
            called = True  # the next line is what the call came to, counted where it was executed
        elif re.match(r"[+\-*\d]", line):
            cost = 0 if called else int((line.split() + ["0"])[1])
            called = False
            total += cost
            memory += cost if ours else 0
    return {"compiled": memory, "all": total}


def measured(name: str, cache: Path) -> dict[str, int]:
    """Count the instructions of a program."""
    environment = os.environ | {"FLEXARM_CPU": "haswell", "FLEXARM_CACHE_DIR": str(cache)}
    environment |= {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.instructions", "-", "--run", name]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        watched = ["valgrind", "--tool=callgrind", "--instr-atstart=no", f"--callgrind-out-file={out}", *command]
        done = subprocess.run(watched, env=environment, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{name}: {done.stderr[-2000:]}")
        files = json.loads(done.stdout.splitlines()[-1])
        return counts(out.with_name("out.1").read_text(encoding="utf-8", errors="replace"), files)


def main(arguments: list[str] | None = None) -> int:
    """Count the programs or compare two files of counts; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="+", default=[""], help="only cases whose names contain one of the words")
    parser.add_argument("--cache", type=Path, help="folder of compiled code; default: a temporary folder")
    parser.add_argument("--compare", type=Path, help="file of earlier counts")
    parser.add_argument("--run", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.run:
        driver(given.run)
        return 0
    chosen = [name for name in PROGRAMS if any(word in name for word in given.only)]
    found: dict[str, Any] = json.loads(given.file.read_text("utf-8")) if given.file.exists() else {}
    if given.compare:
        before = json.loads(given.compare.read_text("utf-8"))
        print("| program | compiled, before | now | ratio | all, ratio |\n|---|---:|---:|---:|---:|")
        for name in (name for name in chosen if name in found and name in before):
            old, new = before[name], found[name]
            ratios = [new[key] / old[key] for key in ("compiled", "all")]
            print(f"| {name} | {old['compiled']:,} | {new['compiled']:,} | {ratios[0]:.4f} | {ratios[1]:.4f} |")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen:
            found[name] = measured(name, given.cache or Path(folder))
            given.file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
            print(f"{name}: {found[name]['compiled']:,} of {found[name]['all']:,}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
