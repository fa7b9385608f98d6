"""What is to be released: built, looked at, installed alone, used from an empty folder.

`make release-check` runs `python -m tests.release`: it builds wheel and source distribution, checks what is in them
(one package, licence, citation, metadata, one version everywhere, at most 3 MB), installs the wheel alone under the
newest requirements of every Python from 3.11 on that the machine has and under the oldest of 3.11 (as
`tests.versions`), and the source distribution under the newest. In each of these environments, from an empty folder,
the command line checks itself and makes two players: a scene, a packaged policy beside PD. The browser of `make
test-browser` opens them, and pictures are left in runs/release/; without a browser that is said, and all else is
checked. Compilation left out, all that takes a minute at most (of processor time: other work on the
machine does not count). The wheel with its extra "train" is installed once more, by the Python that runs this: there a
policy is trained for a moment, judged, exported to C, and drives an arm that is served. The exit code is 1 where
something fails; the table at the end says what was tried, and `python -m tests.release --page` keeps it as
docs/results/releases.md.
"""

import platform
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from datetime import date
from email import message_from_string
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from packaging.requirements import Requirement

from benchmarks.machine import cpu_seconds, table, write_text
from tests.browser.chrome import NAMES, browser, program
from tests.versions import NEEDED, ROOT, ages, bounds, made, plain, pythons

FOLDER = ROOT / ".venv-versions" / "release"
CACHE = {"FLEXARM_CACHE_DIR": str(FOLDER / "cache")}
PICTURES = ROOT / "runs" / "release"
MOST_BYTES = 4_000_000
"""Largest size of the wheel. Torques of tasks at a wall take 0.8 MB of it: they cannot be rounded."""
SECONDS = 60.0
"""Of processor time, for installing, making both players and their pictures, once compiled."""
PAGE = ROOT / "docs" / "results" / "releases.md"
HEAD = """# Tested releases

The wheel and the source distribution install and work with the oldest and the newest supported releases of their
requirements. Each distribution was installed alone into an empty virtual environment. From an empty folder, `flexarm
doctor` ran its checks, and `flexarm view two_link_motion` and `flexarm view two_link pd` made players, which headless
Chromium (if installed) displayed. Times are processor times without compilation. `python -m tests.release --page`
writes this page (`make release-check` checks without writing the page)."""
REST = "Untested, for lack of such machines: macOS, Windows, ARM; other browsers, touch screens and screen readers."
WITH_TRAIN = (
    "with only the package and its extra `train` installed: policies were trained briefly by PPO and by gradients, and "
    "evaluated; controller gains were tuned; a policy was exported to C; an arm was exported as a C library and as a "
    "mock-up unit; the policy drove an arm that `flexarm serve` simulated"
)
UNSEEN = f"not opened, since none of the browsers {', '.join(NAMES)} is installed; FLEXARM_BROWSER can name another one"
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
        commands = archive.read(f"{info}/entry_points.txt").decode()
    with tarfile.open(sdist) as archive:
        source = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    texts = {name: (ROOT / name).read_text("utf-8") for name in ("CITATION.cff", "CHANGELOG.md")}
    inside = (ROOT / "flexarm_env" / "__init__.py").read_text("utf-8")
    wanted = {
        f"only flexarm_env and its metadata in the wheel, not {sorted({name.split('/')[0] for name in names})}":
            {name.split("/")[0] for name in names} == {"flexarm_env", info},
        f"at most {MOST_BYTES} bytes, not {wheel.stat().st_size}": wheel.stat().st_size <= MOST_BYTES,
        "the licence in the wheel": f"{info}/licenses/LICENSE" in names,
        "nothing compiled in the wheel": not [n for n in names if n.endswith((".pyc", ".so", ".o"))],
        "the player in the wheel, three.js with its licence":
            {f"flexarm_env/view/{name}" for name in ("player.js", "player.html", "three.min.js", "three.LICENSE.txt")}
            <= set(names),
        "the command flexarm in the wheel": "flexarm = flexarm_env.cli:main" in commands,
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
    folder = FOLDER / f"{python}-{age}-{'wheel' if '.whl' in file.suffix else 'sdist'}"
    pinned = [f"{name}=={low}" for name, (low, _) in bounds().items()] if age == "oldest" else []
    held = ["-c", ROOT / "constraints.txt"] if age == "train" else []  # so that PyTorch is the one that is tested with
    return made(python, folder, *held, file, *pinned)


TRAINED = (
    "train --env FlexibleArm-v0 --n-timesteps 8192 --eval-episodes 4 --no-progress --no-tensorboard --out run",
    "train --algo gradient --config default --n-timesteps 2048 --eval-episodes 4 --no-progress --out g",
    "evaluate --policy run,pd --episodes 4 --out judged",
    "tune --env FlexibleArm-v0 --controllers pd --samples 2 --refinements 2 --episodes 4",
    "export run --to c --out policy.c",
    "export FlexibleArm-v0 --to library --out strip",
    "export FlexibleArm-v0 --to fmu --out strip.fmu",
)
"""What the wheel with the extra "train" is asked to do, each a command of `flexarm`."""


def flexarm(python: Path, folder: Path, *words: str) -> None:
    """A command in a folder, which must end well."""
    command = [python, "-m", "flexarm_env", *words]
    done = subprocess.run(command, cwd=folder, env=plain() | CACHE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"flexarm {' '.join(words)}: {(done.stdout + done.stderr)[-2000:]}")


def trained(python: Path, folder: Path) -> None:
    """Train, judge, tune and export in an empty folder, then serve an arm and let the policy drive it."""
    for words in TRAINED:
        flexarm(python, folder, *words.split())
    written = ("run/policy.npz", "g/policy.npz", "judged/table.md", "policy.c", "runs/gains/slew.toml")
    written += ("strip/libstrip.so", "strip.fmu")
    missing = [name for name in written if not (folder / name).is_file()]
    if missing:
        raise RuntimeError(f"not written: {', '.join(missing)}")
    serve = [python, "-m", "flexarm_env", "serve", "FlexibleArm-v0", "--rate", "50", "--port", "0", "--seconds", "120"]
    with subprocess.Popen(serve, cwd=folder, env=plain() | CACHE, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().split(" at ")[1].split(",")[0]
            flexarm(python, folder, "run", "run", "--to", address, "--seconds", "1")
        finally:
            server.terminate()


def _clocks() -> NDArray[np.float64]:
    """s by the clock, and of processor time of what has ended."""
    return np.array([time.monotonic(), cpu_seconds()])


def versions(python: Path) -> list[str]:
    """Of Python and of the packages that tests.versions names."""
    lines = "import platform, sys; from importlib.metadata import version; print(platform.python_version()); "
    lines += f"print(*map(version, {NEEDED}), sep='\\n')"
    done = subprocess.run([python, "-c", lines], check=True, capture_output=True, text=True, env=plain())
    return done.stdout.split()


def used(python: Path, folder: Path) -> None:
    """Let the package check itself and make both players."""
    flexarm(python, folder, "doctor")
    for name, runs in VIEWS.items():
        flexarm(python, folder, "view", *runs, "--out", f"{name}.html")


def photographed(folder: Path) -> None:
    """Open both players in a browser, and keep a picture of each."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile, browser(Path(profile) / "profile") as page:
        for name in VIEWS:
            page.open(folder / f"{name}.html")
            page.set("#time", 60)
            page.picture(PICTURES / f"{name}.png")
        if page.faults:
            raise RuntimeError(f"the browser complained: {page.faults}")


def tried(python: str, age: str, file: Path) -> tuple[object, ...]:
    """A row of the table: install, compile once, then from an empty folder to the pictures."""
    marks = [_clocks()]
    inside = installed(python, age, file)
    marks.append(_clocks())
    with tempfile.TemporaryDirectory() as empty:
        used(inside, Path(empty))
    with tempfile.TemporaryDirectory() as empty:
        marks.append(_clocks())
        used(inside, Path(empty))
        marks.append(_clocks())
        if program() is not None:
            photographed(Path(empty))
        marks.append(_clocks())
    install, _, made, shot = (after - before for before, after in pairwise(marks))
    clock, work = install + made + shot
    if work > SECONDS:
        raise RuntimeError(f"{work:.0f} s of processor time from the wheel to the pictures, not {SECONDS:g}")
    parts = (f"{part[1]:.0f} s" for part in (install, made, shot))
    kind = "wheel" if file.suffix == ".whl" else "source"
    return *versions(inside), kind, *parts, f"{work:.0f} s, {clock:.0f} s"


def main(arguments: list[str]) -> int:
    """All of it; 1 where something fails."""
    rows: list[tuple[object, ...]] = []
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        wheel, sdist = build(Path(temporary))
        sizes = f"{wheel.name}: {wheel.stat().st_size / 1e3:.0f} kB; {sdist.name}: {sdist.stat().st_size / 1e3:.0f} kB"
        print(sizes)
        faults = faults_of(wheel, sdist)
        for fault in faults:
            print(f"missing: {fault}")
        for python in pythons():
            for age, file in (*((age, wheel) for age in ages(python)), ("newest", sdist)):
                try:
                    rows.append(tried(python, age, file))
                    print(*rows[-1], flush=True)
                except (subprocess.CalledProcessError, RuntimeError, OSError) as error:
                    failed += 1
                    print(f"{python}, {age}, {file.name}: FAILED: {error}", flush=True)
        try:
            own = f"python{sys.version_info.major}.{sys.version_info.minor}"
            inside = installed(own, "train", Path(f"{wheel}[train]"))
            with tempfile.TemporaryDirectory() as empty:
                trained(inside, Path(empty))
            print(f"{own}, {WITH_TRAIN}", flush=True)
        except (subprocess.CalledProcessError, RuntimeError, OSError) as error:
            failed += 1
            print(f"the extra train: FAILED: {error}", flush=True)
    columns = (
        f"python | {' | '.join(NEEDED)} | installed from | install | two players | pictures | total CPU time, wall time"
    )
    where = f"{platform.system()}, {platform.machine()}, {date.today()}"
    good, seen = bool(rows) and not faults and not failed, program() is not None
    lines = [*table(columns, rows), "", f"{sizes}. {where}.", ""]
    lines += [f"Python {platform.python_version()}, {WITH_TRAIN}.", ""]
    lines += [REST if seen else f"The players were {UNSEEN}. {REST}"]
    print("", *lines, sep="\n")
    outcome = "All of this holds" if good else "Not all of this holds"
    print(f"\n{outcome}." if seen else f"\n{outcome}; the players were {UNSEEN}.")
    if good and "--page" in arguments:
        write_text(PAGE, "\n".join([HEAD, "", *lines, ""]))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
