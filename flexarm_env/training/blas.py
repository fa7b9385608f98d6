"""Number of threads of the BLAS libraries loaded by NumPy and SciPy."""

import ctypes
import os
from pathlib import Path

KINDS = (*(f"{front}openblas_{{}}_num_threads{back}" for front in ("", "scipy_") for back in ("", "64_")),)
"""C functions that read and set the number of threads, in the various builds of OpenBLAS (the Fortran functions have
pointers as arguments)."""
VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def set_threads(count: int) -> None:
    """Set the number of threads that OpenBLAS uses for matrix products.

    The number applies to every loaded copy of OpenBLAS and, through environment variables, to BLAS libraries that are
    loaded later. For the matrices of small networks one thread is faster than several.
    """
    os.environ.update(dict.fromkeys(VARIABLES, str(count)))
    for library, kind in _libraries():
        getattr(library, kind.format("set"))(ctypes.c_int(count))


def threads() -> list[int]:
    """Return the number of threads of each loaded copy of OpenBLAS."""
    return [int(getattr(library, kind.format("get"))()) for library, kind in _libraries()]


def _libraries() -> list[tuple[ctypes.CDLL, str]]:
    """Return the OpenBLAS libraries of this process, each with its naming scheme of functions; on Linux only."""
    try:
        lines = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return []
    rows = [line.split(maxsplit=5) for line in lines]
    paths = sorted({row[5] for row in rows if len(row) == 6 and "openblas" in Path(row[5]).name})
    found = [ctypes.CDLL(path) for path in paths]
    return [(one, kind) for one in found for kind in KINDS if hasattr(one, kind.format("set"))]
