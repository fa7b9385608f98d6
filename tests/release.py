"""What is to be released: built, looked at, installed alone, used from an empty folder.

`make release-check` runs `python -m tests.release`: it builds wheel and source distribution, checks what is in them
(one package, licence, citation, metadata, one version everywhere, at most 3 MB), installs the wheel alone under the
oldest and newest requirements of every Python from 3.11 on that the machine has (as `tests.versions`), and the source
distribution under the newest. In each of these environments, from an empty folder, the command line checks itself and
makes two players: a scene, a packaged policy beside PD. Where there is a browser they are opened, and pictures of
them are left in runs/release/. The exit code is 1 where something fails; the table at the end says what was tried.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from email import message_from_string
from pathlib import Path

from packaging.requirements import Requirement

from tests.versions import ROOT, bounds, pythons

FOLDER = ROOT / ".venv-versions" / "release"
PICTURES = ROOT / "runs" / "release"
MOST_BYTES = 3_000_000
SECONDS = 60.0
"""For installing the wheel and making both players, once compiled."""
VIEWS = {"scene": ("two_link_motion",), "policy": ("two_link", "pd")}


def build(folder: Path) -> tuple[Path, Path]:
    """Wheel and source distribution."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def faults_of(wheel: Path, sdist: Path) -> list[str]:
    """What is wrong with the files, in words."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    version = project["version"]
    with zipfile.ZipFile(wheel) as archive:
        names, info = archive.namelist(), f"flexarm_env-{version}.dist-info"
        metadata = message_from_string(archive.read(f"{info}/METADATA").decode())
    with tarfile.open(sdist) as archive:
        source = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    texts = {name: (ROOT / name).read_text("utf-8") for name in ("CITATION.cff", "CHANGELOG.md")}
    inside = (ROOT / "flexarm_env" / "__init__.py").read_text("utf-8")
    wanted = {
        f"only flexarm_env and its metadata in the wheel, not {sorted({name.split('/')[0] for name in names})}":
            {name.split("/")[0] for name in names} == {"flexarm_env", info},
        f"at most {MOST_BYTES} bytes, not {wheel.stat().st_size}": wheel.stat().st_size <= MOST_BYTES,
        "the licence in the wheel": f"{info}/licenses/LICENSE" in names,
        "nothing compiled in the wheel": not [n for n in names if n.endswith((".pyc", ".so", ".nbi", ".nbc"))],
        "the player in the wheel": "flexarm_env/view/player.js" in names and "flexarm_env/view/player.html" in names,
        "licence, citation, changes in the source": {"LICENSE", "CITATION.cff", "CHANGELOG.md"} <= source,
        f"version {version} in flexarm_env/__init__.py": f'__version__ = "{version}"' in inside,
        f"version {version} in CITATION.cff": f"\nversion: {version}\n" in texts["CITATION.cff"],
        f"a section {version} in CHANGELOG.md": f"\n## {version}" in texts["CHANGELOG.md"],
        f"version {version} in the metadata": metadata["Version"] == version,
        "a licence expression in the metadata": metadata["License-Expression"] == project["license"],
        "the Python versions in the metadata": metadata["Requires-Python"] == project["requires-python"],
        "the readme in the metadata": "flexarm_env" in str(metadata.get_payload()),
        "every requirement in the metadata":
            {str(Requirement(t)) for t in project["dependencies"]}
            == {str(r) for r in map(Requirement, metadata.get_all("Requires-Dist", [])) if r.marker is None},
    }  # fmt: skip
    return [what for what, holds in wanted.items() if not holds]


def installed(python: str, age: str, file: Path) -> Path:
    """The interpreter of a fresh environment that holds the file and what it asks for."""
    folder = FOLDER / f"{python}-{age}-{'wheel' if file.suffix == '.whl' else 'sdist'}"
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", folder], check=True)
    inside = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    pinned = [f"{name}=={low}" for name, (low, _) in bounds().items()] if age == "oldest" else []
    pip = [inside, "-m", "pip", "install", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, str(file), *pinned], check=True)
    return inside


def used(python: Path, folder: Path) -> str:
    """Use the package in an empty folder, twice: the second time all is compiled. What came of it."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    own["NUMBA_CACHE_DIR"] = str(FOLDER / "cache")

    def flexarm(*words: str) -> None:
        command = [python, "-m", "flexarm_env", *words]
        done = subprocess.run(command, cwd=folder, env=own, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"flexarm {' '.join(words)}: {(done.stdout + done.stderr)[-2000:]}")

    flexarm("doctor")
    for name, words in VIEWS.items():
        flexarm("view", *words, "--out", f"{name}.html")
    start = time.monotonic()
    for name, words in VIEWS.items():
        flexarm("view", *words, "--out", f"{name}.html")
    return f"{time.monotonic() - start:.0f} s for both players"


def photographed(folder: Path) -> str:
    """Open both players in a browser, and keep a picture of each."""
    from tests.browser.chrome import browser, program

    if program() is None:
        return "no browser here"
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile, browser(Path(profile) / "profile") as page:
        for name in VIEWS:
            page.open(folder / f"{name}.html")
            page.run("document.querySelector('#time').value = 60")
            page.run("document.querySelector('#time').dispatchEvent(new Event('input'))")
            page.settle()
            page.picture(PICTURES / f"{name}.png")
        if page.faults:
            raise RuntimeError(f"the browser complained: {page.faults}")
    return f"pictures in {PICTURES.relative_to(ROOT)}"


def main() -> int:
    """All of it; 1 where something fails."""
    rows, good = [], True
    with tempfile.TemporaryDirectory() as temporary:
        wheel, sdist = build(Path(temporary))
        print(f"{wheel.name}: {wheel.stat().st_size / 1e3:.0f} kB; {sdist.name}: {sdist.stat().st_size / 1e3:.0f} kB")
        faults = faults_of(wheel, sdist)
        for fault in faults:
            print(f"missing: {fault}")
        for python in pythons():
            for age, file in (("oldest", wheel), ("newest", wheel), ("newest", sdist)):
                try:
                    start = time.monotonic()
                    inside = installed(python, age, file)
                    took = f"installed in {time.monotonic() - start:.0f} s"
                    with tempfile.TemporaryDirectory() as empty:
                        outcome = f"{took}, {used(inside, Path(empty))}, {photographed(Path(empty))}"
                except (subprocess.CalledProcessError, RuntimeError) as error:
                    outcome, good = f"FAILED: {error}", False
                rows.append(f"| {python} | {age} | {'wheel' if file == wheel else 'source'} | {outcome} |")
                print(rows[-1], flush=True)
    print("", "| Python | requirements | from | outcome |", "|---|---|---|---|", *rows, sep="\n")
    print(f"\n{sys.platform} alone; other systems and processors were not tried.")
    return 0 if good and rows and not faults else 1


if __name__ == "__main__":
    sys.exit(main())
