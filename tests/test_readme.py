"""README.md: its code runs as printed, its links lead somewhere."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from flexarm_env.cli.parser import TRAINING, build_parser, main
from flexarm_env.scenes import names
from tests.processes import ROOT, python
from tests.test_docs import script_of

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_it_fits_on_two_screens() -> None:
    assert len(TEXT.splitlines()) <= 120


@pytest.mark.slow
def test_code_runs_as_printed(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    script = script_of(TEXT)
    assert script.count("import") >= 5
    lines = python("-c", script, cwd=tmp_path).stdout.splitlines()
    assert lines[0] == "True", "the packaged policy succeeds"


def test_the_first_block_runs(tmp_path: Path) -> None:
    """Without extras."""
    assert python("-c", script_of(TEXT).partition("import torch")[0], cwd=tmp_path).stdout == "True\n"


CLAIMS = re.findall(r"^- \*\*.*?(?=^- |^$)", TEXT, re.MULTILINE | re.DOTALL)
CLAIMS += re.findall(r"^\| .*docs/results/.*\|$", TEXT, re.MULTILINE)
"""What is special, and the table of measured facts."""


@pytest.mark.parametrize("claim", CLAIMS)
def test_numbers_are_on_the_generated_page_that_is_linked(claim: str) -> None:
    """Rounded, to 2 %, whether or not a comma separates the thousands."""
    pages = re.findall(r"\]\((docs/results/\w+\.md)\)", claim)
    prose = re.sub(r"`[^`]*`|\]\([^)]*\)|(?<=\d),(?=\d{3})", "", claim)
    said = re.findall(r"(?<![\w.-])\d+(?:\.\d+)?", prose)
    text = " ".join((ROOT / page).read_text("utf-8").replace(",", "") for page in pages)
    known = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]
    assert not said or known
    assert [number for number in said if not any(abs(float(number) - one) <= 0.02 * one for one in known)] == []


def test_training_by_hand_takes_one_thread() -> None:
    """PyTorch's threads make small networks several times slower."""
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        blocks = re.findall(r"```python\n(.*?)```", path.read_text("utf-8"), re.DOTALL)
        for block in blocks:
            if ".learn(" in block or "loss.backward()" in block:
                assert "torch.set_num_threads(1)" in block, path
                assert ".learn(" not in block or "progress_bar=True" in block, path


def test_the_default_is_more_accurate_and_faster_than_the_papers_solver() -> None:
    """As README says, for random and for bang-bang torques of both planar environments, by the page's tables."""
    said = 'more accurate than the paper\'s solver (`formulation="paper"`) and several hundred times faster'
    assert said in " ".join(TEXT.split())
    page = (ROOT / "docs/results/default_settings.md").read_text("utf-8")
    row = r"^\| \**(elastica|paper),.*\(default.*\| ([\d.]+) % \| ([\d.]+) % \| 0 \| ([\d.]+) \|"
    rows = re.findall(row, page, re.MULTILINE)
    found = [[float(x) for x in row[1:]] for row in rows]
    assert [row[0] for row in rows] == ["elastica", "paper"] * 2
    for default, paper in (found[:2], found[2:]):
        assert default[0] < paper[0] and default[1] < paper[1] and 300.0 * default[2] < paper[2]


def test_commands_are_ones_that_there_are() -> None:
    commands = re.findall(r"^    flexarm (.*)$", TEXT, re.MULTILINE)
    assert len(commands) >= 6
    for command in commands:
        words = shlex.split(command)
        if words[0] not in (*TRAINING, "bench"):
            assert build_parser().parse_args(words).command == words[0]
        assert all((ROOT / word).is_file() for word in words if word.startswith("configs/"))


def test_scenes_come_with_the_package() -> None:
    """Who has the wheel alone has no configs/."""
    scenes = re.findall(r"^    flexarm (?:simulate|replay) (\S+)", TEXT, re.MULTILINE)
    assert scenes and set(scenes) <= set(names())


def test_the_run_that_is_shown_serves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was a scene under a formulation that is 7 % off there, which ended "inaccurate"."""
    monkeypatch.chdir(tmp_path)
    for command in re.findall(r"^    flexarm (simulate .*)$", TEXT, re.MULTILINE):
        words = shlex.split(command)
        assert "--strict" in words and main(words) == 0


SHORT = {
    "play": ["--headless"], "train": ["--n-timesteps", "8192", "--no-tensorboard", "--eval-episodes", "4"],
    "evaluate": ["--episodes", "4"],
}  # fmt: skip
"""What makes commands of the README short."""


@pytest.mark.slow
def test_compile_covers_the_commands(tmp_path: Path) -> None:
    """A copy of the package, nothing compiled: after `flexarm compile` none of the commands compiles."""
    pytest.importorskip("stable_baselines3")
    home = tmp_path / "home"
    shutil.copytree(ROOT / "flexarm_env", home / "flexarm_env", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "configs", home / "configs")
    objects = home / "flexarm_env" / "__pycache__" / "objects"

    def run(*words: str) -> None:
        env = {key: value for key, value in os.environ.items() if key != "FLEXARM_CACHE_DIR"}
        env |= {"PYTHONPATH": str(home)}
        command = [sys.executable, "-m", "flexarm_env", *words]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-3000:]

    run("compile")
    before = sorted(path.name for path in objects.iterdir())
    for command in re.findall(r"^    flexarm (.*)$", TEXT, re.MULTILINE):
        words = shlex.split(command)
        run(*words, *SHORT.get(words[0], []))
        assert sorted(path.name for path in objects.iterdir()) == before, command


def test_links_and_pictures_are_there() -> None:
    targets = [link for link in re.findall(r"\]\(([^)#]+)", TEXT) if "://" not in link]
    assert len(targets) > 6
    assert [link for link in targets if not (ROOT / link).exists()] == []
    assert (ROOT / "docs" / "figures" / "policy_beside_pd.gif").stat().st_size < 1_500_000
