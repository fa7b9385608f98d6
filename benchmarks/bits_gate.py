"""Compare a small part of `benchmarks.bits` with the record in the repository, to the last bit.

python -m benchmarks.bits_gate [--only WORDS ...]  compares; exit code 1 if a number has changed (`make bits`)
python -m benchmarks.bits_gate --write             computes the record again (`make bits-record`)

A commit that changes bits on purpose also changes the record, benchmarks/bits_record.json. Compiled kernels compute the
same bits on every processor. The C library, LAPACK and NumPy choose their loops by the processor, which changes the
last bits of models and of random starts and targets. The record therefore names the machine and the libraries'
versions. On any other machine the script computes the results of the previous commit (with uncommitted changes: the
last commit) and compares with these results; cases whose record has changed since that commit are omitted. Without such
a commit (no git, a shallow clone) nothing is compared, and the exit code is 0.
"""

import argparse
import hashlib
import io
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path
from typing import Any

from benchmarks.bits import cases, computed, digest
from flexarm_env.training import blas
from flexarm_env.validation import installed

ROOT = Path(__file__).resolve().parents[1]
RECORD = Path(__file__).with_name("bits_record.json")

Hashes = dict[str, dict[str, str]]
"""Hashes of results: case -> part of the case -> hash of the part's numbers."""

GATE = (
    # scenes in the plane
    "scene elbow, segments", "scene elbow, exact", "scene elbow, elastica", "scene elbow, paper", "scene elbow, modes",
    "scene thrown, elastica", "scene thrown, modes in segments", "scene torque, multipliers",
    "scene torque, root frames", "scene torque, exact, fitted", "scene gears, rubbing, two, exact",
    "scene gears, rubbing, two, segments", "scene play, elastica", "scene bent, two, exact",
    # environments and batches in the plane
    "FlexibleArm-v0, default, 1", "FlexibleArm-v0, default, 11", "FlexibleArm-v0, exact, 1",
    "FlexibleArm-v0, floating, 11", "TwoLinkFlexArm-v0, exact, 11", "TwoLinkFlexArm-v0, floating, 1",
    "FlexibleArm-v0, all, 5", "FlexibleArm-v0, events, 5", "suite, float-reach-v1", "guided, elastica",
    # derivatives in the plane
    "derivatives, one link", "derivatives, exact", "derivatives, floating", "derivatives, gears, two", "run, exact",
    # scenes in space
    "space, scene elbow + fast rotor, exact", "space, scene elbow + fast rotor, segments",
    "space, scene elbow + fast rotor, modes", "space, scene elbow + fast rotor, elastica",
    "space, scene free flight, exact", "space, scene free flight, segments", "space, scene free flight, modes",
    "space, scene free flight, elastica", "space, scene dry friction, exact", "space, scene pillar, elastica",
    "space, rigid, pinned, exact", "space, rigid, free, segments",
    # environments, batches and derivatives in space
    "space, env, exact, 1", "space, env, segments, 1", "space, env, modes, 1", "space, env, exact, 11",
    "space, env, segments, 11", "space, env, modes, 11", "space, env, gears, rubbing, play, exact, 5",
    "space, derivatives, exact", "space, derivatives, segments", "space, derivatives, modes", "space, run, exact",
    "space, guided, exact", "space, env, gears, rubbing, play, segments, 5", "space, env, all, exact, 5",
    "space, derivatives, gears, exact",
)  # fmt: skip
"""Compared cases: scenes, environments, batches and derivatives of each formulation, in the plane and in space."""


def machine() -> dict[str, str]:
    """Return processor, C library and versions, on which the last bits of LAPACK and NumPy results depend."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    vectors = ("sse", "ssse", "avx", "fma", "f16c", "amx")
    flags = " ".join(sorted(flag for flag in told.get("flags", "").split() if flag.startswith(vectors)))
    chosen = [os.environ.get(name, "") for name in ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "GLIBC_TUNABLES")]
    words = [told.get(key, "") for key in ("vendor_id", "cpu family", "model", "model name")]
    return {
        "processor": " ".join(words) if told else platform.processor() or platform.machine(),
        "vectors": hashlib.sha256(" ".join([flags, *chosen]).encode()).hexdigest()[:16],
        "C library": " ".join(platform.libc_ver()) or platform.platform(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: installed(name) or "" for name in ("numpy", "scipy", "llvmlite", "gymnasium")},
    }


def hashes(names: list[str]) -> Hashes:
    """Compute cases and return the hashes of their results."""
    import scipy.linalg  # noqa: F401  (brings a BLAS of its own, whose threads are set as well)

    blas.set_threads(1)
    known, found = cases(), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of coarse meshes
        for name in names:
            found[name] = {part: digest(numbers)[:16] for part, numbers in computed(known[name]).items()}
    return found


def write(file: Path, found: Hashes) -> None:
    """Write a record with one line per case, so that a commit's diff shows the changed cases."""
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(parts)}" for name, parts in found.items())
    text = f'{{\n"computed with": {json.dumps(machine())},\n"cases": {{\n{rows}\n}}\n}}\n'
    file.write_text(text, encoding="utf-8")


def read(file: Path) -> dict[str, Any]:
    """Read a record; a missing file gives an empty record."""
    found: dict[str, Any] = {"computed with": {}, "cases": {}}
    return found | (json.loads(file.read_text("utf-8")) if file.exists() else {})


def git(*words: str) -> bytes | None:
    """Return the output of a git command, or None if the command fails or git is not installed."""
    try:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None


def commit_before() -> Hashes | str:
    """Return the hashes that the previous commit's code gives on this machine, or a text with the reason why not.

    Cases whose record has changed since that commit are omitted.
    """
    changes = git("status", "--porcelain", "--untracked-files=no")
    commit = "HEAD^" if changes == b"" else "HEAD"
    packed = None if changes is None else git("archive", "--format=zip", commit)
    if packed is None:
        return "there is no commit before it here"
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            archive.extractall(folder)
        before = Path(folder, RECORD.relative_to(ROOT))
        if not before.exists():
            return f"{commit} has no record"
        old, new, out = read(before)["cases"], read(RECORD)["cases"], Path(folder, "bits.json")
        same = [name for name, parts in new.items() if old.get(name) == parts]
        if same:
            command = [sys.executable, "-m", "benchmarks.bits_gate", "--write", str(out), "--names", *same]
            done = subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": folder}, check=False)
            if done.returncode or not out.exists():
                return f"{commit} cannot be computed"
        found = read(out)["cases"]
        return {name: found[name] for name in same}


def difference(known: dict[str, str], found: dict[str, str]) -> str:
    """Return the names of the parts that differ, separated by commas; "" if all parts are equal."""
    return ", ".join(part for part in known | found if known.get(part) != found.get(part))


def main(arguments: list[str] | None = None) -> int:
    """Compare the cases with the record, or write the record; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, nargs="?", const=RECORD, help="compute and write the record")
    parser.add_argument("--only", nargs="+", default=[""], help="only cases whose names contain one of the words")
    parser.add_argument("--names", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    names = options.names or [name for name in GATE if any(word in name for word in options.only)]
    start = time.perf_counter()
    if options.write:
        write(options.write, hashes(names))
        return 0
    record, own, source = read(RECORD), machine(), "the record"
    known: Hashes | str = record["cases"]
    if record["computed with"] != own:
        differing = difference(record["computed with"], own)
        print(f"the record is of another machine ({differing}): the commit before is computed here", flush=True)
        known, source = commit_before(), "the commit before"
    if isinstance(known, str):
        print(f"nothing is compared: {known}")
        return 0
    names = [name for name in names if name in known or source == "the record"]
    found, wrong = hashes(names), 0
    for name, parts in found.items():
        changed = difference(known.get(name, {}), parts)
        wrong += bool(changed)
        if changed:
            print(f"{name}: {changed}")
    print(f"{len(found) - wrong} of {len(found)} cases equal {source} bit for bit, {time.perf_counter() - start:.0f} s")
    if wrong:
        print("if they are to change: `make bits-record`, and commit benchmarks/bits_record.json with the change")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
