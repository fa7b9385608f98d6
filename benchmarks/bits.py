"""Hash the solver's results before and after a change that should not alter them, and compare the hashes.

python -m benchmarks.bits FILE [--only WORDS ...]            computes the cases that FILE (JSON) lacks, and adds them
python -m benchmarks.bits FILE --compare [--only WORDS ...]  computes the cases again; exit code 1 if a result differs

The numbers of a case form parts (coordinates, energies, observations, ...). Each part has a hash, and its numbers are
stored beside FILE (FILE.npz), so that the size of a difference is known. All parts must be equal to the last bit. A
part named d_... is a derivative or follows from one: with --within 1e-12 its numbers may differ by 1e-12 of the part's
largest number. Each case's result is written as soon as it is computed, so that an interrupted run can be continued.
--only: cases whose names contain one of the words. --most N: at most N cases, since a process keeps all compiled code.
--list: print the names alone. The cases are in `benchmarks.bits_cases` (plane) and `benchmarks.bits_space` (space). The
repository records the results of a few cases: `benchmarks.bits_gate`.
"""

import argparse
import hashlib
import json
import sys
import time
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import bits_cases, bits_space

Numbers = NDArray[np.float64]


def cases() -> dict[str, Any]:
    """Return all cases, in the plane and in space, by name."""
    return bits_cases.cases() | bits_space.cases()


def flat(value: Any) -> Numbers:
    """Return the numbers of a value in one row; every NaN has the same bits.

    The value is an array, a list, or a mapping (in the order of its keys). A text or None becomes its checksum.
    """
    if isinstance(value, Mapping):
        value = [value[key] for key in sorted(value)]
    if value is None or isinstance(value, str):
        return np.array([float(zlib.crc32(repr(value).encode()))])
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object):
        return np.concatenate([np.zeros(0), *(flat(one) for one in value)])
    numbers = np.array(value, np.float64).ravel()
    numbers[np.isnan(numbers)] = np.nan
    return numbers


def digest(numbers: Numbers) -> str:
    """Return 32 hexadecimal digits of the SHA-256 of the numbers' bits."""
    return hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()[:32]


def computed(case: Any) -> dict[str, Numbers]:
    """Compute a case and return its parts by name; an exception's message becomes the name of an empty part."""
    try:
        return {part: flat(value) for part, value in case().items()}
    except Exception as error:
        return {f"{type(error).__name__}: {error}"[:200]: np.zeros(0)}


def keep(file: Path, kept: dict[str, Any], name: str, parts: dict[str, Numbers], seconds: float) -> None:
    """Add the results of a case to FILE.npz, then their hashes to FILE."""
    with zipfile.ZipFile(file.with_suffix(".npz"), "a", zipfile.ZIP_DEFLATED) as beside:
        for part, numbers in parts.items():
            with beside.open(f"{name}|{part}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, numbers)
    kept[name] = {"cpu_s": round(seconds, 2), "parts": {part: digest(numbers) for part, numbers in parts.items()}}
    part = file.with_suffix(".part")
    part.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    part.replace(file)


def off(known: Numbers, found: Numbers) -> float:
    """Return the largest difference over the largest number; infinite if NaNs or infinities differ."""
    fine = np.isfinite(known)
    if known[~fine].tobytes() != found[~fine].tobytes() or not np.isfinite(found[fine]).all():
        return np.inf
    largest = np.abs(known[fine]).max(initial=0.0)
    gap = np.abs(known[fine] - found[fine]).max(initial=0.0)
    return float(gap / largest) if largest > 0.0 else np.inf


def differences(
    name: str, known: Mapping[str, str], parts: dict[str, Numbers], beside: Any, within: float
) -> list[str]:
    """Return a sentence for each part of a case that differs from its recorded hash.

    A sentence begins with "~" if the part is a derivative (d_...) that differs by at most `within` of its largest
    number.
    """
    told = [f"part {part!r} is missing" for part in known if part not in parts]
    for part, numbers in parts.items():
        if part not in known:
            told.append(f"part {part!r} is new")
        elif known[part] != digest(numbers):
            old = beside[f"{name}|{part}"]
            if old.shape != numbers.shape:
                told.append(f"{part}: {numbers.size} numbers, {old.size} before")
                continue
            gap, count = off(old, numbers), int((old.view(np.int64) != numbers.view(np.int64)).sum())
            mark = "~" if part.startswith("d_") and gap <= within else ""
            told.append(f"{mark}{part}: off by {gap:.2g} of the largest number ({count} of {old.size} differ)")
    return told


def main(arguments: list[str] | None = None) -> int:
    """Record the cases, or compare them with the record; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--only", nargs="+", default=[""], help="only cases whose names contain one of the words")
    parser.add_argument("--most", type=int, default=10**6, help="largest number of cases to compute")
    parser.add_argument("--within", type=float, default=0.0, help="largest difference of derivatives (relative)")
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args(arguments)
    kept: dict[str, Any] = json.loads(options.file.read_text("utf-8")) if options.file.exists() else {}
    chosen = {name: case for name, case in cases().items() if any(word in name for word in options.only)}
    if options.list:
        print("\n".join(f"{'kept' if name in kept else 'new '}  {name}" for name in chosen))
        return 0
    if not options.compare:
        wanted = [name for name in chosen if name not in kept]
        for name in wanted[: options.most]:
            start = time.process_time()
            parts = computed(chosen[name])
            keep(options.file, kept, name, parts, time.process_time() - start)
            count = sum(numbers.size for numbers in parts.values())
            print(f"{kept[name]['cpu_s']:6.1f} s  {name}  {count}", flush=True)
        left = max(0, len(wanted) - options.most)
        print(f"{len(kept)} cases recorded" + (f", {left} left" if left else ""))
        return 0
    beside, equal, close, count = np.load(options.file.with_suffix(".npz")), 0, 0, 0
    for name, case in list(chosen.items())[: options.most]:
        told = ["new"]
        if name in kept:
            told = differences(name, kept[name]["parts"], computed(case), beside, options.within)
        worse = [sentence for sentence in told if not sentence.startswith("~")]
        equal, close, count = equal + (not told), close + (bool(told) and not worse), count + 1
        for sentence in told:
            print(f"{name}: {sentence}", flush=True)
    also = f", {close} but for derivatives within {options.within:g}" if options.within else ""
    print(f"{equal} of {count} cases are equal to the last bit{also}")
    return 0 if equal + close == count else 1


if __name__ == "__main__":
    sys.exit(main())
