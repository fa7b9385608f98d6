"""Fresh interpreters, for what a test's own one cannot show, and arms that are served beside a test."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def python(
    *words: str | Path, code: int = 0, cwd: Path = ROOT, timeout: float = 900.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What `python words` prints, with this checkout first on the path; it must end with `code`."""
    done = subprocess.run(
        [sys.executable, *words], cwd=cwd, env=os.environ | {"PYTHONPATH": _path(), **environment},
        capture_output=True, text=True, check=False, timeout=timeout,
    )  # fmt: skip
    assert done.returncode == code, (done.stdout + done.stderr)[-8000:]
    return done


def _path() -> str:
    return os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


def uncompiled_tests(file: str, mark: str = "not slow") -> None:
    """Run a file of tests on plain Python numbers, where all sizes and features come at no compile time."""
    path = Path(__file__).parent / file
    done = python("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", mark, path, FLEXARM_COMPILER="python")
    assert "skipped" not in done.stdout


@contextmanager
def served(server: Any) -> Iterator[tuple[str, int]]:
    """The address of an arm that answers packets meanwhile, on a thread of its own."""
    over = threading.Event()
    thread = threading.Thread(target=server.serve, kwargs={"stopped": over.is_set})
    thread.start()
    try:
        yield server.address
    finally:
        over.set()
        thread.join()
        server.close()
