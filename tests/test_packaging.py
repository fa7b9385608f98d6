"""What the wheel and the source distribution hold."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a wheel and a source distribution, built from this checkout."""
    out = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--sdist", "--outdir", str(out), str(ROOT)],
        check=True,
        capture_output=True,
        timeout=300,
    )
    return out


def test_wheel_holds_the_package_alone(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    assert wheel.name == f"flexarm_env-{PROJECT['version']}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        entry_points = archive.read(f"flexarm_env-{PROJECT['version']}.dist-info/entry_points.txt").decode()
    assert {name.split("/")[0] for name in names} == {
        "flexarm_env",
        f"flexarm_env-{PROJECT['version']}.dist-info",
    }
    assert "flexarm = flexarm_env.cli:main" in entry_points
    assert not [name for name in names if "__pycache__" in name or name.endswith((".nbi", ".nbc"))]


def test_wheel_holds_every_file_of_the_package(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    here = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "flexarm_env").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "flexarm_env/py.typed" in here
    assert here <= names, f"left out: {sorted(here - names)}"


def test_sdist_holds_what_is_needed_to_build_and_test(dist: Path) -> None:
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    for needed in ("pyproject.toml", "LICENSE", "README.md", "Makefile", "constraints.txt", "tests/conftest.py"):
        assert needed in names
    assert not [name for name in names if name.startswith((".venv", "runs/")) or "__pycache__" in name]


def test_versions_agree() -> None:
    source = (ROOT / "flexarm_env" / "__init__.py").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f'__version__ = "{PROJECT["version"]}"' in source
    assert f"## {PROJECT['version']}" in changes


def test_constraints_pin_what_the_extras_ask_for() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert not [line for line in pins if "==" not in line or "+" in line]
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in pins}
    asked = [*PROJECT["dependencies"], *(name for extra in PROJECT["optional-dependencies"].values() for name in extra)]
    names = {name.split(";")[0].split(">")[0].strip().lower().replace("_", "-") for name in asked}
    assert names <= pinned, f"without a pin: {sorted(names - pinned)}"
