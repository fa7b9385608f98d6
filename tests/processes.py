"""Fresh interpreters, for what a test's own one cannot show."""

import os
import subprocess
import sys
from pathlib import Path

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
