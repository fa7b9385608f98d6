"""What arms in space have not is refused by its name: every line of the page that lists it, tried."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

import flexarm_env as fx
from flexarm_env import arms, linear
from flexarm_env.cli import main
from flexarm_env.control import make as controller
from flexarm_env.scenes import named
from tests.refusals import refusal

PAGE = Path(__file__).parents[1] / "docs" / "environments" / "spatial_limits.md"
SPACE = "SpatialFlexArm-v0"
SLEW = named("three_dof_slew")
STRIP: Any = arms.named("three_dof").links[1].section  # type: ignore[union-attr]
LIST = PAGE.read_text("utf-8").partition("## Not available in space\n")[2].partition("\n## ")[0]
LISTED = re.findall(r"^\|[^|\n]*\| `([^`\n]*\))` \| `([^`\n]*)` \|$", LIST, re.MULTILINE)


def make(**keywords: Any) -> Any:
    return gym.make(SPACE, **keywords)


def control(name: str) -> Any:
    return controller(name, make())


def changed(**fields: Any) -> fx.Arm:
    arm = arms.named("three_dof")
    if hasattr(arm, next(iter(fields))):
        return dataclasses.replace(arm, **fields)
    strip: Any = arm.links[1]
    return dataclasses.replace(arm, links=(arm.links[0], dataclasses.replace(strip, **fields), arm.links[2]))


def run(formulation: str = "geometrically_exact", arm: fx.Arm = SLEW.arm, **options: Any) -> Any:
    scene = dataclasses.replace(SLEW, arm=arm)
    return fx.simulate(scene, formulation, duration=0.01, sample=0.01, estimate_error=False, **options)


def linearized(**keywords: Any) -> Any:
    return linear.linearize(SLEW, **keywords)


def test_the_list_is_read() -> None:
    heads, dashes = LIST.count("| call | error message begins with |"), LIST.count("\n|---|")
    assert heads == dashes == 2 and len(LISTED) == LIST.count("\n|") - heads - dashes > 20


@pytest.mark.parametrize(("call", "sentence"), LISTED, ids=[call for call, _ in LISTED])
def test_refused(call: str, sentence: str, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    def flexarm(*words: str) -> None:
        assert main([*words, *(("--env", SPACE) if words[0] == "export" else ())]) == 2
        raise ValueError(capsys.readouterr().err.partition(": ")[2])

    monkeypatch.chdir(tmp_path)
    known = {"make": make, "control": control, "changed": changed, "run": run, "linear": linearized, "flexarm": flexarm}
    known |= {"Section": fx.Section, "STRIP": STRIP, "THIN": dataclasses.replace(STRIP, EI=2.0)}
    assert refusal(lambda: eval(call, known)).startswith(sentence)
    assert not list(tmp_path.iterdir())
