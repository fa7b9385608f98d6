"""README.md: its code runs as printed, its tables are what the results say, its links lead somewhere."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import readme_tables
from flexarm_env.cli.parser import SCRIPTS, build_parser
from flexarm_env.scenes import names
from tests.test_docs import script_of

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_code_runs_as_printed(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    script = script_of(TEXT)
    assert script.count("import") >= 8
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[1].startswith("ok 0.07"), "a smooth slew that bends the strip by 7 %"
    assert float(lines[2].split()[-1]) < 1.0, "a closed loop that is stable"


def test_commands_are_ones_that_there_are() -> None:
    commands = re.findall(r"^    flexarm (.*)$", TEXT, re.MULTILINE)
    assert len(commands) >= 6
    for command in commands:
        words = shlex.split(command)
        if words[0] not in SCRIPTS:
            assert build_parser().parse_args(words).command == words[0]
        assert all((ROOT / word).is_file() for word in words if word.startswith("configs/"))


def test_scenes_come_with_the_package() -> None:
    """Who has the wheel alone has no configs/."""
    scenes = re.findall(r"^    flexarm (?:simulate|replay) (\S+)", TEXT, re.MULTILINE)
    assert scenes and set(scenes) <= set(names())


def test_the_two_commands_come_first() -> None:
    lines = [line for line in TEXT.splitlines() if line.strip()]
    assert lines[1:3] == ["    make demo", "    make test"]


def test_tables_are_up_to_date() -> None:
    assert len(readme_tables.MARKED.findall(TEXT)) == 3
    assert readme_tables.filled(TEXT, readme_tables.results()) == TEXT, "run python -m benchmarks.readme_tables"


def test_tables_say_where_results_are_missing() -> None:
    text = readme_tables.filled(TEXT, {})
    assert text.count("Not measured yet") == 3
    policies = {"pd": {"success_rate": 0.9, "settling_time_median": 1.0, "residual_vibration_median": 0.01,
                       "overshoot_median": 2.0}}  # fmt: skip
    content = {"env": "FlexibleArm-v0", "episodes": 100, "policies": policies, "bounds": {"rigid": 0.7}}
    assert "| pd | 90% | 1.00 | 0.01 | 2.0 |" in readme_tables.filled(TEXT, {"control_slew": content})


def test_the_table_of_speed() -> None:
    def row(case: str, api: str, n_envs: int, threads: int, rate: float, **more: str) -> dict[str, object]:
        return {"case": case, "api": api, "n_envs": n_envs, "threads": threads, "steps_per_second": rate, **more}

    own = {"id": "FlexibleArm-v0", "formulation": "elastica"}
    rates = [
        row("Pendulum-v1", "single", 1, 1, 5e4),
        row("a", "single", 1, 1, 4e4, **own),
        row("b", "vector", 16, 1, 9e4, **own),
        row("c", "vector", 1024, 1, 4.0e5, **own),
        row("d", "vector", 1024, 2, 7.1e5, **own),
    ]
    text = readme_tables.speed({"throughput": {"rates": rates, "machine": {"date": "2000-01-01", "cores": "2"}}})
    assert "| `FlexibleArm-v0`, elastica | 40,000 | 400,000 | 710,000 |" in text
    assert "| *Pendulum-v1* | 50,000 |  |  |" in text
    raced = readme_tables.speed({"exudyn": {"races": {"rod": [{"ratio": 5.2}, {"ratio": 23.9}], "none": []}}})
    assert "at equal error: 5 to 24 times on `rod`." in raced
    assert "1024, 2 threads" in text and "2000-01-01, 2 cores" in text


def test_links_and_pictures_are_there() -> None:
    targets = [link for link in re.findall(r"\]\(([^)#]+)", TEXT) if "://" not in link]
    assert len(targets) > 6
    assert [link for link in targets if not (ROOT / link).exists()] == []
    assert (ROOT / "docs" / "figures" / "policy_beside_pd.gif").stat().st_size < 1_500_000
