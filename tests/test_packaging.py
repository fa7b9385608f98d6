"""What the wheel and the source distribution hold."""

import json
import os
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.processes import ROOT
from tests.release import build, faults_of, trained

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A wheel and a source distribution, built from this checkout."""
    return build(tmp_path_factory.mktemp("dist"))


@pytest.mark.slow
def test_wheel_holds_every_file_of_the_package(dist: tuple[Path, Path]) -> None:
    """And the configs of the checkout, under the package's data."""
    with zipfile.ZipFile(dist[0]) as archive:
        names = set(archive.namelist())
        for path in (ROOT / "configs").glob("*/*.yml"):
            assert archive.read(f"flexarm_env/data/{path.relative_to(ROOT).as_posix()}") == path.read_bytes()
    here = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "flexarm_env").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "flexarm_env/py.typed" in here
    assert here <= names, f"left out: {sorted(here - names)}"


def test_sdist_holds_what_is_needed_to_build_and_test(dist: tuple[Path, Path]) -> None:
    with tarfile.open(dist[1]) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    for needed in ("pyproject.toml", "LICENSE", "README.md", "Makefile", "constraints.txt", "constraints-ray.txt",
                   "tests/conftest.py"):  # fmt: skip
        assert needed in names
    assert not [name for name in names if name.startswith((".venv", "runs/")) or "__pycache__" in name]


def test_nothing_is_missing_from_what_is_released(dist: tuple[Path, Path]) -> None:
    assert faults_of(*dist) == []


@pytest.mark.parametrize("file", ["constraints.txt", "constraints-ray.txt"])
def test_constraints_pin_what_the_extras_ask_for(file: str) -> None:
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert not [line for line in pins if "==" not in line or "+" in line]
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in pins}
    extras = dict(PROJECT["optional-dependencies"])
    ray = [extras.pop("ray"), ["pytest", "hypothesis"]]
    chosen = ray if "ray" in file else extras.values()
    asked = [*PROJECT["dependencies"], *(name for extra in chosen for name in extra)]
    names = {Requirement(name).name.lower().replace("_", "-") for name in asked}
    assert names <= pinned, f"without a pin: {sorted(names - pinned)}"


# ------------------------------------------------------- the wheel alone
def needed(requirements: list[str]) -> dict[str, metadata.Distribution]:
    """The distributions that these ask for, and what those ask for, without extras; from the running environment."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [Requirement(line) for line in requirements]
    while waiting:
        wanted = waiting.pop()
        if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
            continue
        distribution = metadata.distribution(wanted.name)
        if distribution.name not in found:
            found[distribution.name] = distribution
            waiting += [Requirement(line) for line in distribution.requires or []]
    return found


@pytest.fixture(scope="module")
def clean(dist: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that holds the wheel, and of other packages only what the wheel asks for."""
    return holding(dist[0], tmp_path_factory.mktemp("clean"), PROJECT["dependencies"])


def holding(wheel: Path, home: Path, requirements: list[str]) -> Path:
    """The interpreter of an environment with the wheel and these; other packages' files are those of this one."""
    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    site = home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    for distribution in needed(requirements).values():
        for name in {path.parts[0] for path in distribution.files or []} - {"..", "__pycache__"}:
            if not (site / name).exists():
                (site / name).symlink_to(str(distribution.locate_file(name)))
    return python


def alone(python: Path, folder: Path, *words: str, code: int = 0) -> str:
    """What a command prints, run in an empty folder without the repository in sight."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "FLEXARM_", "NUMBA_"))}
    done = subprocess.run(
        [python, "-W", "error::ImportWarning", *words], cwd=folder, env=environment, capture_output=True, text=True,
        check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout if code == 0 else done.stderr


@pytest.mark.slow
def test_the_wheel_alone_works(clean: Path, tmp_path: Path) -> None:
    """Both environments, a scene against its reference, a controller and every policy that comes with the package; all
    without Numba, by which earlier releases were compiled."""
    lines = """
import importlib.util, json, sys
import gymnasium as gym, flexarm_env
assert importlib.util.find_spec("numba") is None and importlib.util.find_spec("llvmlite") is not None
from flexarm_env import arms, control, scenes
lengths = []
for name in ("FlexibleArm-v0", "TwoLinkFlexArm-v0"):
    env = gym.make(name)
    env.reset(seed=0)
    lengths.append(len(env.step(env.action_space.sample())[0]))
policies = []
for name in control.policy_names():
    policy = control.load_policy(name)
    env = gym.make(policy.meta["env_id"], **policy.meta["env_kwargs"])
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        observation = env.step(policy.act(observation))[0]
    policies.append(policy.meta["env_id"])
known = {"arms": arms.names(), "scenes": scenes.names(True), "references": scenes.reference_names()}
heavy = [m for m in ("torch", "stable_baselines3", "matplotlib", "pygame", "agents", "benchmarks") if m in sys.modules]
print(json.dumps({"file": flexarm_env.__file__, "lengths": lengths, "heavy": heavy, "policies": policies, **known}))
"""
    told = json.loads(alone(clean, tmp_path, "-c", lines))
    assert Path(told["file"]).is_relative_to(clean.parents[1])
    assert told["lengths"] == [6, 14]
    assert told["heavy"] == []
    assert "strip" in told["arms"] and "flying_rod@as_printed" in told["scenes"] and "flying_rod" in told["references"]
    assert set(told["policies"]) <= {"FlexibleArm-v0", "TwoLinkFlexArm-v0"}

    def flexarm(*words: str, code: int = 0) -> str:
        return alone(clean, tmp_path, "-m", "flexarm_env", *words, code=code)

    assert "max_tip_error: 0.015" in flexarm("replay", "robot_arm_motion", "--out", "run.csv")
    assert (tmp_path / "run.csv").stat().st_size > 10_000
    assert "passed" in flexarm("doctor")
    missing = 'torch stable-baselines3 pyyaml tqdm (or install flexarm_env with the extra "train")'
    assert missing in flexarm("train", code=2)
    assert "| pd | 100%" in flexarm("evaluate", "--policy", "pd,flexible_arm", "--episodes", "3")
    listed = json.loads(flexarm("bench", "suite", "--list", "--json"))["tasks"]
    words = ("bench", "suite", "--policy", "zv", "--task", listed[0]["id"], "--episodes", "3", "--out", "suite")
    assert "success" in flexarm(*words) and (tmp_path / "suite" / "zv-0.json").exists()
    assert "# Results" in flexarm("bench", "page", "suite")
    flexarm("export", "two_link", "--to", "c", "--out", "two_link.c")
    sentence = flexarm("replay", "robot_arm_motion", "--plot", "a.png", code=2)
    assert 'pip install matplotlib (or install flexarm_env with the extra "plot"' in sentence
    assert "success, return" in flexarm("play", "--policy", "lqr", "--headless")
    sentence = flexarm("play", "--policy", "pd", code=2)
    assert 'pip install pygame-ce (or install flexarm_env with the extra "render"' in sentence


@pytest.mark.slow
def test_the_wheel_with_its_extra_trains_exports_and_serves(dist: tuple[Path, Path], tmp_path: Path) -> None:
    """From an empty folder, without a checkout in sight."""
    pytest.importorskip("stable_baselines3")
    extra = PROJECT["optional-dependencies"]["train"]
    python = holding(dist[0], tmp_path / "env", [*PROJECT["dependencies"], *extra])
    (tmp_path / "empty").mkdir()
    trained(python, tmp_path / "empty")


def test_extras_are_documented() -> None:
    page = (ROOT / "docs" / "getting-started.md").read_text(encoding="utf-8")
    assert [name for name in PROJECT["optional-dependencies"] if f"| `{name}` |" not in page] == []
