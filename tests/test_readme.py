"""README.md: its code runs as printed, its links lead somewhere."""

import re
import shlex
from pathlib import Path

import pytest

from flexarm_env.cli.parser import TRAINING, build_parser, main
from flexarm_env.scenes import names
from tests.processes import ROOT, python
from tests.test_docs import script_of

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_code_runs_as_printed(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    script = script_of(TEXT)
    assert script.count("import") >= 8
    lines = python("-c", script, cwd=tmp_path).stdout.splitlines()
    assert lines[1].startswith("ok 0.07"), "a smooth slew that bends the strip by 7 %"
    assert float(lines[2].split()[-1]) < 1.0, "a closed loop that is stable"


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


def test_links_and_pictures_are_there() -> None:
    targets = [link for link in re.findall(r"\]\(([^)#]+)", TEXT) if "://" not in link]
    assert len(targets) > 6
    assert [link for link in targets if not (ROOT / link).exists()] == []
    assert (ROOT / "docs" / "figures" / "policy_beside_pd.gif").stat().st_size < 1_500_000
