"""docs/ray.md: its config trains, its commands are ones that there are."""

import re
import shlex
from typing import Any

from agents import sweep, train_rllib
from flexarm_env.training.arguments import parse
from tests.processes import ROOT

TEXT = (ROOT / "docs" / "ray.md").read_text("utf-8")
PROGRAMS = {"agents.train_rllib": train_rllib.Arguments, "agents.sweep": sweep.Arguments}


def test_the_config_trains(cluster: Any) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    names: dict[str, Any] = {}
    exec(block, names)
    config = names["config"]().env_runners(num_env_runners=1, num_envs_per_env_runner=4)
    algorithm = config.training(train_batch_size_per_learner=64, minibatch_size=64, num_epochs=1).build_algo()
    result = algorithm.train()
    algorithm.stop()
    assert result["env_runners"]["num_env_steps_sampled_lifetime"] >= 64


def test_commands_are_ones_that_there_are() -> None:
    commands = re.findall(r"^    \.venv-ray/bin/python -m (\S+) (.*)$", TEXT, re.MULTILINE)
    assert len(commands) >= 6
    for program, words in commands:
        parse(PROGRAMS[program], program, "", shlex.split(words))
