"""Copy the best policy of each suite task from run folders to agents/policies, with a model card.

    python -m agents.ship --home runs/suite

For each task the script compares the run folders HOME/METHOD-SEED/TASK that contain a policy.npz. A run counts only if
docs/results/suite/METHOD-SEED.json contains the evaluation of exactly this policy (equal fingerprints). The policy with
the highest score is copied to agents/policies/TASK, together with the run's config.yml, unless the present policy has a
higher score. README.md is the model card. Policies of tasks without a run folder do not change.
"""

import sys
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.suite import RESULTS, ROOT
from flexarm_env import suite
from flexarm_env.suite import results
from flexarm_env.suite.policies import choose
from flexarm_env.suite.score import score
from flexarm_env.training.runs import command, write_text

POLICIES = ROOT / "agents" / "policies"
"""Folder of the policies, one folder for each task."""


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.ship`.

    Args:
        home: folder of the runs. results: folder of the results files. out: folder of the policies.
    """

    home: Path = Path("runs/suite")
    results: Path = RESULTS
    out: Path = POLICIES


@dataclass(frozen=True)
class Judged:
    """Evaluated policy of a run folder.

    Attributes:
        task: the task. found: results of the run. entry: the run's results on the task. folder: the run folder.
    """

    task: suite.Task
    found: results.Results
    entry: Mapping[str, Any]
    folder: Path

    @property
    def score(self) -> float:
        """Score of the policy in the 100 public episodes."""
        return score(self.task, results.value(self.task, self.entry)) or 0.0


def evaluated(task: suite.Task, folders: Mapping[str, Path], known: list[results.Results]) -> list[Judged]:
    """Return the evaluated policies of a task, the highest score first. folders: run folders by METHOD-SEED."""
    found = []
    for one, entry in results.of_task(task, known):
        folder = folders.get(f"{one.name}-{one.run}")
        if folder is None or not (folder / "policy.npz").is_file():
            continue
        if choose(str(folder), task).fingerprint == entry["policy"]["fingerprint"]:
            found.append(Judged(task, one, entry, folder))
    return sorted(found, key=lambda one: -one.score)


def success(entry: Mapping[str, Any]) -> str:
    """Format the rate of success of an entry."""
    flags = entry["successes"]
    return f"{sum(flags) / len(flags):.0%}"


def card(best: Judged, config: str) -> str:
    """Write the model card of a policy. config: text of the run's config.yml."""
    task, entry, training = best.task, best.entry, best.entry["training"]
    rows = [("public episodes", entry)] + [("second hundred", other) for other in [entry.get("second")] if other]
    table = [
        f"| {name} | {success(part)} | {results.value(task, part):.1f} | {np.mean(part['pd']):.1f} |"
        for name, part in rows
    ]
    lines = [
        f"# Policy for `{task.id}`",
        "",
        f"{task.title}. {task.hard.strip()}",
        "",
        f"The policy is run {best.found.run} of the method `{best.found.name}` in the "
        "[results on the suite](../../../docs/results/suite.md). Training used "
        f"{training['steps']:,.0f} control periods and {training['cpu_s']:.0f} s of CPU. `config.yml` contains all "
        "hyperparameters, and this command repeats the training:",
        "",
        "```sh",
        f"flexarm train --env {task.registered} --algo {training['algorithm']} --seed {best.found.run} \\",
        f"  --config agents/policies/{task.id}/config.yml --n-timesteps {task.budget} \\",
        f"  --best-by return --evaluate-every {max(32_768, round(task.budget / 20))}",
        "```",
        "",
        "| episodes | success | J | J of PD control |",
        "|---|---|---|---|",
        *table,
        "",
        f"J is the mean return minus the priced cost. The score in the public episodes is {best.score:.2f}, where 0 "
        "is PD control and 1 the best known torques.",
        "",
    ]
    if "\naround:" in config or config.startswith("around:"):
        lines += [
            "The policy contains PD control, and the network corrects the torques of PD control. Call `reset` with the "
            "first observation of each episode.",
            "",
        ]
    lines += [
        "## Use",
        "",
        "```python",
        "import gymnasium as gym",
        "from flexarm_env import control",
        "",
        f'env = gym.make("{task.registered}")',
        f'policy = control.load_policy("agents/policies/{task.id}/policy.npz", env)',
        "observation, info = env.reset(seed=0)",
        "policy.reset(observation)",
        "action = policy.act(observation)",
        "```",
        "",
        "## Limits",
        "",
        "The policy is deterministic and needs only NumPy. It was trained and evaluated in simulation only, on the "
        "arm, sensors and ranges of this task.",
    ]
    return "\n".join(wrapped(line) for line in lines) + "\n"


def wrapped(line: str) -> str:
    """Wrap a paragraph, which begins with a capital letter, at 120 characters; return all other lines unchanged."""
    return textwrap.fill(line, 120, break_on_hyphens=False, break_long_words=False) if line[:1].isupper() else line


def present(task: suite.Task, folder: Path, known: list[results.Results]) -> float:
    """Return the score of the policy in a folder; minus infinity without a policy or its evaluation."""
    if not (folder / "policy.npz").is_file():
        return -float("inf")
    mark = choose(str(folder), task).fingerprint
    scores = [
        score(task, results.value(task, entry)) or 0.0
        for _, entry in results.of_task(task, known) if entry["policy"]["fingerprint"] == mark
    ]  # fmt: skip
    return max(scores, default=-float("inf"))


def work(arguments: Arguments) -> None:
    """Copy the policies and write their model cards; print a line for each task."""
    known = results.folder_of(arguments.results, earlier=True)
    for task in suite.tasks():
        folders = {path.parent.name: path for path in arguments.home.glob(f"*/{task.id}")}
        found, out = evaluated(task, folders, known), arguments.out / task.id
        if not found:
            continue
        best = found[0]
        if best.score <= present(task, out, known):
            print(f"{task.id}: the present policy is kept")
            continue
        out.mkdir(parents=True, exist_ok=True)
        (out / "policy.npz").write_bytes((best.folder / "policy.npz").read_bytes())
        config = (best.folder / "config.yml").read_text("utf-8")
        write_text(out / "config.yml", config)
        write_text(out / "README.md", card(best, config))
        print(f"{task.id}: {best.found.name}-{best.found.run}, score {best.score:.2f}")


main = partial(command, Arguments, "python -m agents.ship", __doc__, work)

if __name__ == "__main__":
    sys.exit(main())
