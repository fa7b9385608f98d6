"""The suite's tasks as data: one TOML file each in `flexarm_env/data/suite`, read and checked."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from .. import validation as check

NAMESPACE = "flexarm"
"""Of the tasks' ids in Gymnasium's registry."""

_KEYS = ("number", "title", "environment", "budget", "hard", "digest", "keywords")
_MAY = ("price",)


@dataclass(frozen=True)
class Task:
    """A task of the suite: an environment with keywords that stay as they are; another version has another id.

    Attributes:
        id: name and version, "slew-measured-v2". number: its place in the suite. title: in a few words.
        environment: the id of the environment that it is made of. keywords: of that environment.
        budget: control periods that a method may be trained for. hard: what is hard about it.
        price: of an episode's cost (info["episode_cost"] at its end): scores are made of return less price times cost.
        digest: of the resolved arm and keywords (`flexarm_env.suite.digest`), as the file records it.
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

    @property
    def name(self) -> str:
        """Without its version: "slew-measured"."""
        return self.id.rpartition("-v")[0]

    @property
    def version(self) -> int:
        """A task that changes gets the next."""
        return int(self.id.rpartition("-v")[2])

    @property
    def env_id(self) -> str:
        """What `gymnasium.make` and `make_vec` take: "flexarm_env:flexarm/slew-measured-v2"."""
        return f"flexarm_env:{self.registered}"

    @property
    def registered(self) -> str:
        """The id in Gymnasium's registry, once the package is imported: "flexarm/slew-measured-v2"."""
        return f"{NAMESPACE}/{self.id}"


def read(text: str, task_id: str) -> Task:
    """A task from the text of its file. ValueError names the task, the key and what is allowed."""
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
        )


@cache
def tasks(*, earlier: bool = False) -> tuple[Task, ...]:
    """All tasks, in order, each in its latest version; earlier: and in those before it."""
    folder = resources.files("flexarm_env") / "data" / "suite"
    files = [entry for entry in folder.iterdir() if entry.name.endswith(".toml")]
    found = [read(entry.read_text("utf-8"), entry.name[:-5]) for entry in files]
    found.sort(key=lambda task: (task.number, task.version))
    latest = {task.name: task for task in found}
    return tuple(task for task in found if earlier or latest[task.name] is task)


def task(task_id: str) -> Task:
    """A task by its id, with or without "flexarm_env:" and "flexarm/" before it. ValueError for one there is not."""
    name = task_id.removeprefix("flexarm_env:").removeprefix(f"{NAMESPACE}/") if isinstance(task_id, str) else task_id
    known = {one.id: one for one in tasks(earlier=True)}
    return known[check.choice("task", name, tuple(known))]
