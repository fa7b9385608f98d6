"""Results files: each JSON file contains the results of one run of a method on one or more tasks."""

import json
import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import read_json, write_text
from . import data, digest, make_vec, policies, second
from .data import Task, tasks
from .frozen import Possible, instants, possible
from .judge import judge
from .policies import PLACE, Chosen, choose, default_name
from .score import EPISODES, FIRST, score

FORMAT = 1
PACKAGES = (
    "flexarm_env", "numpy", "scipy", "llvmlite", "gymnasium", "stable_baselines3", "sb3_contrib", "torch",
    "onnxruntime", "ray",
)  # fmt: skip

_NUMBERS = ("returns", "successes", "costs", "lengths")
LOT = 1000
"""Number of further episodes evaluated per batch."""


@dataclass
class Results:
    """Content of a results file.

    Attributes:
        name: name of the method. run: training seed of the run, if the method has several runs.
        tasks: for each task id, a dict of results. "returns", "successes", "costs", "lengths", "settled" have one
            number per episode (older files lack "settled"). "digest", "first_seed", "episodes" identify the episodes.
            "wall_s", "cpu_s" and "decision_us" are computing times, as in `judge.Judged`. "policy" has the keys kind,
            source and fingerprint; "training" has algorithm, steps, wall_s and cpu_s, or is null. "pd" has the values
            of PD control in the episodes of "returns". "second" has the results of the second 100 episodes
            (`flexarm_env.suite.second`) with their "first_seed" and "pd", or is null. "further" has the values of
            episodes beyond the first 100, or is null. "versions" and "date" record programs and date.
        refused: reasons why the method could not be evaluated, by task id.
    """

    name: str
    run: int = 0
    tasks: dict[str, dict[str, Any]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """Name of the results file in a folder."""
        return f"{self.name}-{self.run}.json"

    def write(self, folder: Path) -> Path:
        """Write the file atomically; return its path."""
        path = folder / self.file
        text = json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n"
        # one line per list of numbers
        lists = re.sub(r'\[[^][{}"]*\]', lambda found: " ".join(found[0].split()), text)
        write_text(path, lists)
        return path

    def known(self, task: Task, chosen: Chosen, episodes: int) -> int:
        """Return the number of episodes of a task for which this file has results of a policy.

        The number is 0 if the stored results belong to another policy, another version of the task, or other episodes.
        The number of episodes is also 0 for policies that are Python functions, because the name of a function does not
        determine the function's behavior.
        """
        entry = self.tasks.get(task.id)
        if entry is None or chosen.kind == "function" or entry["policy"]["fingerprint"] != chosen.fingerprint:
            return 0
        asked = (task.digest, FIRST, min(episodes, EPISODES))
        return length(entry) if (entry["digest"], entry["first_seed"], entry["episodes"]) == asked else 0

    def other_than(self, word: str, chosen: Chosen) -> str:
        """Return the name of a policy other than `word` that has results in this file; "" if there is none."""
        for task, entry in self.tasks.items():
            source = entry["policy"].get("source", "")
            if os.path.normpath(source) != os.path.normpath(word.replace(PLACE, task)) and (
                entry["policy"]["fingerprint"] != chosen.fingerprint
            ):
                return str(source)
        return ""


def judged(
    word: str,
    wanted: Sequence[Task],
    folder: Path,
    *,
    name: str | None = None,
    run: int | None = None,
    episodes: int = EPISODES,
    again: bool = False,
    choose: Callable[[str, Task], Chosen] = choose,
) -> tuple[Results, list[str], dict[str, str]]:
    """Evaluate a policy on tasks and update its results file after each task.

    Stored results of the policy are kept unless `again` is True. Results on fewer than the protocol's 100 episodes are
    returned, but do not replace stored results on all 100 episodes.

    Args:
        word: name of the policy. wanted: the tasks. folder: folder of the results file. choose: function that finds the
            policy, see `suite.policies.choose`. name, run: name and run of the results. None means the policy's own
            name and run. Without `name`, a results file of another policy is rejected. episodes: number of episodes,
            counted from the protocol's first episode. A new evaluation of 100 or more episodes has at least as many
            episodes as the stored results. Beyond the first 100 episodes only the values are stored.
    Returns:
        The results on the evaluated tasks; messages about the tasks that failed; and, by task id, a note about each
        task whose stored results were kept.
    """
    known: Results | None = None
    found = Results(name or default_name(word))
    trouble: list[str] = []
    notes: dict[str, str] = {}
    for task in wanted:
        kind, whole = "", False
        try:
            chosen = choose(word, task)
            kind = chosen.kind
            if known is None:
                known = begun(folder, found.name, chosen.run if run is None else run)
                found.run = known.run
                if name is None and (other := known.other_than(word, chosen)):
                    what = f"{folder / known.file} has results of {other}; give one of them another --name"
                    return found, [f"--policy {word}: {what} (or --name {found.name}, if it is the same method)"], {}
            # results on file: complete ones are kept, incomplete ones are extended
            old = known.tasks.get(task.id)
            whole = episodes < EPISODES and old is not None and of_the_protocol(task, old)
            done = 0 if again else known.known(task, chosen, episodes)
            if old is not None and done >= episodes:
                found.tasks[task.id] = old
                notes[task.id] = f"kept from {old.get('date', 'before')}; --again repeats it"
                continue
            if old is not None and done:
                more = further(task, chosen, done, episodes)
                found.tasks[task.id] = old | {"further": [*(old.get("further") or ()), *more]}
            else:
                count = episodes if old is None or episodes < EPISODES else max(episodes, length(old))
                found.tasks[task.id] = _entry(task, chosen, count)
            # never replace a full result by a partial one
            if whole:
                notes[task.id] = f"a look; {folder / known.file} keeps its result on {EPISODES} episodes"
                continue
            known.refused.pop(task.id, None)
            known.tasks[task.id] = found.tasks[task.id]
            known.write(folder)
        except ValueError as error:
            # a task that cannot be evaluated is recorded with the reason
            sentence = " ".join(str(error).split())
            who = "" if sentence.startswith("--policy") else f"--policy {word.replace(PLACE, task.id)}: "
            trouble.append(f"{task.id}: {who}{sentence}")
            if known is not None and kind == "controller" and not whole:
                known.tasks.pop(task.id, None)
                known.refused[task.id] = sentence
                known.write(folder)
    return found, trouble, notes


def _entry(task: Task, chosen: Chosen, episodes: int) -> dict[str, Any]:
    """Evaluate a policy on a task's episodes and return the entry of a results file."""
    more: dict[str, Any] = {}
    with closing(make_vec(task.id, min(episodes, EPISODES))) as env:
        found = judge(env, chosen.make(env), FIRST)
        # second hundred of episodes, with the policy's own seeds
        if len(found.returns) == EPISODES and chosen.canonical is not None:
            first = second.first_seed(task, chosen.canonical())
            other = asdict(judge(env, chosen.make(env), first))
            numbers = {key: other[key] for key in (*_NUMBERS, "settled")}
            more = {"first_seed": first, **numbers, "pd": _pd(task, env, first)}
        pd = _pd(task, env, FIRST) if more else None
    return {
        "digest": task.digest, "first_seed": FIRST, "episodes": len(found.returns), **asdict(found),
        "pd": pd, "second": more or None, "further": further(task, chosen, EPISODES, episodes) or None,
        "policy": {"kind": chosen.kind, "source": chosen.source, "fingerprint": chosen.fingerprint},
        "training": None if chosen.training is None else dict(chosen.training),
        "versions": versions(), "date": date.today().isoformat(),
    }  # fmt: skip


def further(task: Task, chosen: Chosen, begin: int, end: int) -> list[float]:
    """Evaluate the episodes with seeds FIRST + begin to FIRST + end - 1; return their values, rounded to 0.001."""
    found: list[float] = []
    for first in range(begin, end, LOT):
        with closing(make_vec(task.id, min(LOT, end - first))) as env:
            lot = judge(env, chosen.make(env), FIRST + first)
        found += np.round(values(task, asdict(lot)), 3).tolist()
    return found


def _pd(task: Task, env: Any, first: int) -> list[float] | None:
    """Return values of PD control on the episodes from a first seed on; None if PD does not apply to the task."""
    try:
        found = judge(env, policies.controller("pd", env), first)
    except ValueError:
        return None
    return list(values(task, asdict(found)).tolist())


def summary(task: Task, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Compute means over the episodes of a task's entry in a results file.

    "value" is the mean return minus the task's price times the mean cost. "score" is None if the task has no reference
    values.
    """
    mean = value(task, entry)
    return {
        "value": mean,
        "return": float(np.mean(entry["returns"])),
        "score": score(task, mean) if of_the_protocol(task, entry) else None,
        "success_rate": float(np.mean(entry["successes"])),
        "settling_s": settling(task, entry),
        "cost": float(np.mean(entry["costs"])),
        "decision_us": entry["decision_us"],
    }


def value(task: Task, entry: Mapping[str, Any]) -> float:
    """Return J: the mean, over an entry's episodes, of return minus the task's price times cost."""
    return float(np.mean(entry["returns"]) - task.price * np.mean(entry["costs"]))


def values(task: Task, entry: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return, for each episode (n,), the return minus the task's price times cost."""
    return np.array(entry["returns"], float) - task.price * np.array(entry["costs"], float)


def length(entry: Mapping[str, Any]) -> int:
    """Return the number of an entry's episodes whose seeds are consecutive and begin with the protocol's first seed."""
    return int(entry["episodes"]) + len(entry.get("further") or ())


def all_values(task: Task, entry: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the values J of all episodes of an entry, including the episodes beyond the first 100."""
    return np.concatenate([values(task, entry), np.array(entry.get("further") or (), float)])


def settling(task: Task, entry: Mapping[str, Any]) -> float | None:
    """Return the mean time, s, after which an episode stays within the success bounds until its end.

    The time is computed by `episodes.measures.success_period`. For a failed episode the time is the full duration. The
    result is None if the entry lacks the key "settled".
    """
    if "settled" not in entry:
        return None
    # success is reported after `hold` periods within the bounds
    (period, hold), most = instants(task.id), possible(task.id).periods
    return period * float(np.mean([max(k - hold, 0) if k else most for k in entry["settled"]]))


def of_the_protocol(task: Task, entry: Mapping[str, Any]) -> bool:
    """Return whether an entry belongs to the task's current version and contains the protocol's 100 episodes."""
    return (entry["digest"], entry["first_seed"], entry["episodes"]) == (task.digest, FIRST, EPISODES)


def of_task(task: Task, found: Iterable[Results]) -> Iterator[tuple[Results, dict[str, Any]]]:
    """Yield pairs (results, entry) for all results in `found` with an entry of the task on the protocol's episodes."""
    for one in found:
        entry = one.tasks.get(task.id)
        if entry is not None and of_the_protocol(task, entry):
            yield one, entry


def frozen(task: Task) -> Task:
    """Return the task if its computed digest equals the digest in its file; raise ValueError otherwise."""
    found = digest(task)
    if found != task.digest:
        raise check.InvalidValue(f"{task.id}.digest", found, f"must be {task.digest}: the task has changed")
    return task


# ------------------------------------------------------------------ reading
def read(path: Path, *, earlier: bool = False) -> Results:
    """Read a results file of the suite. A ValueError names the file, the key, its value and the rule.

    Args:
        earlier: accept entries of earlier versions of a task. With earlier=False, an entry whose digest differs from
            the task's digest is rejected.
    """
    content = read_json(path)
    with check.in_file(path):
        table = check.table_of("results", content)
        for key in ("format", "name", "run", "tasks"):
            check.needed("", table, key, "every results file says it")
        if table["format"] != FORMAT:
            raise check.InvalidValue("format", table["format"], f"must be {FORMAT}, which this version reads")
        entries = check.table_of("tasks", table["tasks"])
        known = {task.id: task for task in tasks(earlier=True)}
        for name, entry in entries.items():
            _check_entry(f"tasks.{name}", entry, known.get(name), earlier)
        refused = check.table_of("refused", table.get("refused", {}))
        for name, why in refused.items():
            check.text(f"refused.{name}", why)
        return Results(named(table["name"]), check.integer("run", table["run"], minimum=0), entries, refused)


def _check_entry(path: str, entry: Any, task: Task | None, earlier: bool) -> None:
    """Reject an entry that cannot result from the task. task: None if the suite does not have the task."""
    table = check.table_of(path, entry)
    for key in ("digest", "first_seed", "episodes", *_NUMBERS, "wall_s", "cpu_s", "decision_us", "policy", "training"):
        check.needed(path, table, key, "every task's entry says it")
    found = check.text(f"{path}.digest", table["digest"])
    if task is not None and found != task.digest:
        if not earlier:
            raise check.InvalidValue(f"{path}.digest", found, f"must be {task.digest}, which {task.id} has")
        task = None
    check.integer(f"{path}.first_seed", table["first_seed"], minimum=0)
    count = check.integer(f"{path}.episodes", table["episodes"], minimum=1)
    # bounds of what an episode of the task can yield
    can = Possible(int(check.LARGEST), -check.LARGEST, check.LARGEST) if task is None else possible(task.id)
    _check_numbers(path, table, count, can)
    # seeds of the second hundred begin at 2^32
    if table.get("second") is not None:
        other = check.table_of(f"{path}.second", table["second"])
        for key in ("first_seed", *_NUMBERS, "settled", "pd"):
            check.needed(f"{path}.second", other, key, "every second hundred says it")
        most = 2 * second.BEGIN - 1
        check.integer(f"{path}.second.first_seed", other["first_seed"], minimum=second.BEGIN, maximum=most)
        _check_numbers(f"{path}.second", other, count, can)
    if table.get("further") is not None:
        check.numbers(f"{path}.further", table["further"], "numbers", maximum=can.most)
    for key in ("wall_s", "cpu_s", "decision_us"):
        check.number(f"{path}.{key}", table[key], minimum=0.0)
    policy = check.table_of(f"{path}.policy", table["policy"])
    check.text(f"{path}.policy.fingerprint", policy.get("fingerprint"))
    check.text(f"{path}.policy.source", policy.get("source", ""))
    for name, version in check.table_of(f"{path}.versions", table.get("versions", {})).items():
        check.text(f"{path}.versions.{name}", version)
    if table["training"] is not None:
        training = check.table_of(f"{path}.training", table["training"])
        for key in ("steps", "wall_s", "cpu_s"):
            check.number(f"{path}.training.{key}", training.get(key), minimum=0.0)


def _check_numbers(path: str, table: Mapping[str, Any], count: int, can: Possible) -> None:
    """Check that each episode has one plausible number of each kind, within the bounds `can` of an episode."""
    numbers = {key: check.sequence(f"{path}.{key}", table[key], "numbers", count) for key in _NUMBERS}
    for k in range(count):
        if numbers["successes"][k] not in (0, 1):
            raise check.InvalidValue(f"{path}.successes[{k}]", numbers["successes"][k], "must be true or false")
        check.number(f"{path}.returns[{k}]", numbers["returns"][k], minimum=can.least, maximum=can.most)
        check.number(f"{path}.costs[{k}]", numbers["costs"][k], minimum=0.0, maximum=check.LARGEST)
        check.integer(f"{path}.lengths[{k}]", numbers["lengths"][k], minimum=1, maximum=can.periods)
    if "settled" in table:
        for k, last in enumerate(check.sequence(f"{path}.settled", table["settled"], "numbers", count)):
            check.integer(f"{path}.settled[{k}]", last, minimum=0, maximum=numbers["lengths"][k])
            if bool(last) != bool(numbers["successes"][k]):
                raise check.InvalidValue(f"{path}.settled[{k}]", last, "must be 0 for failed episodes only")
    if table.get("pd") is not None:
        check.numbers(f"{path}.pd", table["pd"], "numbers", count, maximum=can.most)


def begun(folder: Path, name: str, run: int) -> Results:
    """Read the results of a method's run in a folder, or create empty `Results` if there is no file."""
    fresh = Results(named(name), check.integer("--run", run, minimum=0))
    path = folder / fresh.file
    return read(path, earlier=True) if path.exists() else fresh


def folder_of(folder: Path, *, earlier: bool = False) -> list[Results]:
    """Read all results files in a folder. Raises ValueError if a file is damaged, or the folder has no results file."""
    files = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not files:
        raise ValueError(f"{folder}: no results files (*.json) there; flexarm bench suite --out {folder} writes them")
    return [read(path, earlier=earlier) for path in files]


def named(name: Any) -> str:
    """Validate a method's name, which is also a file name."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][\w.@+-]*", name):
        raise check.InvalidValue("name", name, "must be letters, digits and any of _ . @ + -")
    return name


def versions() -> dict[str, str]:
    """Return the versions of Python and the relevant packages, and the machine."""
    found = {"python": platform.python_version(), "machine": f"{platform.system()} {platform.machine()}"}
    for name in PACKAGES:
        if (version := check.installed(name)) is not None:
            found[name] = version
    return found


def chosen_tasks(words: str | None) -> tuple[Task, ...]:
    """Return the tasks with the given ids (separated by commas), without duplicates; None means all tasks."""
    if words is None:
        return tasks()
    return tuple({one.id: one for one in map(data.task, listed("--task", words))}.values())


def listed(flag: str, words: str) -> list[str]:
    """Split a text into words separated by commas; raise ValueError if the text contains only commas and spaces."""
    found = [word.strip() for word in words.split(",") if word.strip()]
    if not found:
        raise check.InvalidValue(flag, words, "must name at least one, or several with commas between them")
    return found
