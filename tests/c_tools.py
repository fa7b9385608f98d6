"""What the tests of written C share."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from flexarm_env.compiler import UNCOMPILED

COMPILER = str(shutil.which("cc"))
STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic")

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
needs_c = pytest.mark.skipif(shutil.which("cc") is None or UNCOMPILED, reason="no C compiler, or nothing is compiled")


def shared(folder: Path, source: str, *flags: str) -> ctypes.CDLL:
    """A source, compiled without a warning and loaded."""
    (folder / "it.c").write_text(source)
    words = [COMPILER, *STRICT, *flags, "-shared", "-fPIC", "it.c", "-o", "it.so", "-lm"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "it.so"))


def run_c(folder: Path, name: str, *flags: str) -> str:
    """What a program in C prints."""
    subprocess.run([COMPILER, f"{name}.c", "-o", name, *flags, "-lm"], cwd=folder, check=True)
    return subprocess.run([f"./{name}"], cwd=folder, check=True, capture_output=True, text=True).stdout
