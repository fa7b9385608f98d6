"""The suite's tasks as data: read and validate the TOML files, one per task, in `flexarm_env/data/suite`."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from .. import validation as check

NAMESPACE = "flexarm"
"""Namespace of the tasks' ids in Gymnasium's registry."""

_KEYS = ("number", "title", "environment", "budget", "hard", "digest", "keywords")
_MAY = ("price", "rules", "lesson")


@dataclass(frozen=True)
class Task:
    """Task of the suite: an environment with fixed keywords. A changed task has a new version and another id.

    Attributes:
        id: name and version, "slew-measured-v2". number: position in the suite. title: short title.
        environment: id of the underlying environment. keywords: keywords of that environment.
        budget: number of control periods that training may use. hard: text that names the difficulty of the task.
            lesson: one sentence on the result of the task; "" for previous versions.
        price: price per unit of an episode's cost (info["episode_cost"] at its end); scores use return minus price
            times cost.
        rules: version of the rules for rewards and random targets (keyword `rules` of the environment).
        digest: digest of the resolved arm and keywords (`flexarm_env.suite.digest`), as recorded in the file.
    """

    id: str
    number: int
    title: str
    environment: str
    budget: int
    hard: str
    digest: str
    keywords: Mapping[str, Any]
    price: float = 0.0
    rules: int = 1
    lesson: str = ""

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of the environment: `keywords` and the task's rules."""
        return {**self.keywords, "rules": self.rules}

    @property
    def name(self) -> str:
        """Name of the task without the version: "slew-measured"."""
        return self.id.rpartition("-v")[0]

    @property
    def version(self) -> int:
        """Version number, which increases when a task changes."""
        return int(self.id.rpartition("-v")[2])

    @property
    def env_id(self) -> str:
        """Id of the task for `gymnasium.make` and `make_vec`: "flexarm_env:flexarm/slew-measured-v2"."""
        return f"flexarm_env:{self.registered}"

    @property
    def registered(self) -> str:
        """Id in Gymnasium's registry after the package is imported: "flexarm/slew-measured-v2"."""
        return f"{NAMESPACE}/{self.id}"


def read(text: str, task_id: str) -> Task:
    """Parse a task from the text of its file. The message of a ValueError names task, key and rule."""
    with check.in_file(f"{task_id}.toml"):
        table = tomllib.loads(text)
        check.known_keys("", table, (*_KEYS, *_MAY))
        for key in _KEYS:
            check.needed("", table, key, "must be given")
        return Task(
            id=task_id,
            number=check.integer("number", table["number"], minimum=1),
            title=check.text("title", table["title"], empty=False),
            environment=check.text("environment", table["environment"], empty=False),
            budget=check.integer("budget", table["budget"], minimum=1),
            hard=check.text("hard", table["hard"], empty=False),
            digest=check.text("digest", table["digest"]),
            keywords=check.table_of("keywords", table["keywords"]),
            price=check.number("price", table.get("price", 0.0), minimum=0.0),
            rules=check.integer("rules", table.get("rules", 1), minimum=1),
            lesson=check.text("lesson", table.get("lesson", "")),
        )


@cache
def tasks(*, earlier: bool = False) -> tuple[Task, ...]:
    """Return all tasks in order, each in its latest version.

    earlier: True to include the previous versions of the tasks.
    """
    folder = resources.files("flexarm_env") / "data" / "suite"
    files = [entry for entry in folder.iterdir() if entry.name.endswith(".toml")]
    found = [read(entry.read_text("utf-8"), entry.name[:-5]) for entry in files]
    found.sort(key=lambda task: (task.number, task.version))
    latest = {task.name: task for task in found}
    return tuple(task for task in found if earlier or latest[task.name] is task)


def task(task_id: str) -> Task:
    """Return a task by its id, with or without "flexarm_env:" and "flexarm/" before it.

    Raises ValueError if the id is unknown.
    """
    name = task_id.removeprefix("flexarm_env:").removeprefix(f"{NAMESPACE}/") if isinstance(task_id, str) else task_id
    known = {one.id: one for one in tasks(earlier=True)}
    return known[check.choice("task", name, tuple(known))]
