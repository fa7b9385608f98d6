"""One page of all results files of a folder: scores over tasks, and each task's table."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files import table
from . import best
from .data import Task, tasks
from .results import Results, all_values, length, of_task, of_the_protocol, settling, summary, values
from .score import EPISODES, FIRST, interquartile_mean, interval, reference
from .second import LEVEL, chance, holm

WIDTH = 0.05
"""Half the width that a difference's 95 % interval should have at most, of a score."""

HEAD = f"""# Results on the suite

Mean returns over the {EPISODES} episodes of seeds {FIRST} to {FIRST + EPISODES - 1}, which no training uses. A score is
(J - J_PD) / (J_best - J_PD), J the mean return (less the task's price times cost, where it has one): 0 for PD control,
1 for the best known. `foresight` is no policy: each episode's torques, found by the gradient of its own return with
the episode known beforehand, from the best that controllers seeing the whole state and trained policies do there. These
are local optima; of an arm that balances upright, whose gradients grow beyond use, they are what was begun with.
Interquartile means (IQM) are over all scores of a method, the mean of the middle half; their brackets hold 95 %
percentile intervals by a bootstrap over runs, stratified by tasks (none where a method has one run); a method that was
not judged on all tasks has none. A method that is missing on a task is not made for it, or was not judged there.
Settled is the mean time until the bounds of success were kept to the end, a failure with a whole episode's length.
Behind the best policy: by how much of a score a method's value is less, paired over the episodes of both, with half the
width of its 95 % interval; then the number of episodes, where there are more than {EPISODES}, and in brackets how
many would bring it to {WIDTH}, where it is above. Below the scores stands the widest of all pairs of methods, without
what is found beforehand and what is below its budget. A second hundred of
episodes has seeds that follow from the policy itself (`flexarm_env.suite.second`): success, settling and the value less
PD's there, beside that on the public ones; † where both differ beyond chance (permutation test, p < {LEVEL} after Holm,
over all runs of this page). What is a function, a model with a memory or found beforehand has the public hundred alone,
and may know it. A method below its budget of training is in italics.

Each file of the folder is a run of a method; another's result is one file more, written by
`flexarm bench suite --policy ... --name METHOD --out FOLDER`. This page: `flexarm bench page FOLDER --out PAGE`."""


@dataclass(frozen=True)
class Line:
    """A method on a task: of each run its summary, and its entry in the results file."""

    method: str
    summaries: list[dict[str, Any]]
    entries: list[dict[str, Any]]

    def mean(self, key: str) -> float | None:
        """Over the runs; None where one has none."""
        values = [one[key] for one in self.summaries]
        return None if any(value is None for value in values) else float(np.mean(values))

    @property
    def policy(self) -> bool:
        """Whether it plays any episode: actions that were found beforehand do not."""
        return all(entry["policy"].get("kind") != "actions" for entry in self.entries)

    def trained(self, key: str) -> float:
        """What training took, of a run."""
        return float(np.mean([(entry["training"] or {}).get(key, 0.0) for entry in self.entries]))

    def short(self, task: Task) -> bool:
        """Whether it was trained, for less than the task's budget."""
        return 0.0 < self.trained("steps") < 0.99 * task.budget


def page(found: Sequence[Results]) -> str:
    """The page, in Markdown."""
    every = [task for task in tasks(earlier=True) if any(task.id in one.tasks for one in found)]
    known = [task for task in every if task in tasks()]
    rows = {task.id: lines_of(task, found) for task in every}
    learnt = set(_learnt([(task, entry) for task in every for line in rows[task.id] for entry in line.entries]))
    text = [HEAD, "", *_made(found), "", "## Scores", "", *_scores(known, rows)]
    for task in sorted(every, key=lambda task: task not in known):
        note = "" if task in known else ", superseded"
        text += ["", f"## {task.number}. {task.title} (`{task.id}`{note})", "", *_table(task, rows[task.id], learnt)]
    text += list(_left_out(found))
    return "\n".join(text).rstrip() + "\n"


def lines_of(task: Task, found: Sequence[Results]) -> list[Line]:
    """Methods on a task, the best first."""
    runs: dict[str, list[dict[str, Any]]] = {}
    for one, entry in of_task(task, found):
        runs.setdefault(one.name, []).append(entry)
    rows = [Line(name, [summary(task, entry) for entry in entries], entries) for name, entries in runs.items()]
    return sorted(rows, key=lambda line: -float(np.mean([one["value"] for one in line.summaries])))


def _scores(known: Sequence[Task], lines: dict[str, list[Line]]) -> list[str]:
    """A row a method: its interquartile mean, and its mean score on each task."""
    scores: dict[str, dict[str, list[float]]] = {}
    for task in known:
        for line in lines[task.id]:
            if line.mean("score") is not None:
                scores.setdefault(line.method, {})[task.id] = [one["score"] for one in line.summaries]
    rows: list[tuple[str, ...]] = []
    for name in sorted(scores, key=lambda name: (-len(scores[name]), -interquartile_mean(scores[name]))):
        own = scores[name]
        means = (_two(float(np.mean(own[task.id]))) if task.id in own else "" for task in known)
        counts = sorted({len(runs) for runs in own.values()})
        runs = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}-{counts[-1]}"
        rows.append((name, runs, _middle(own, len(known)), *means))
    found = [  # of the methods that make policies: actions that were found beforehand are none
        [score for line in lines[task.id] if line.policy and (score := line.mean("score")) is not None]
        for task in known
    ]
    rows.append(("*best less worst*", "", "", *(f"{max(own) - min(own):.2f}" if own else "" for own in found)))
    left = (f"{max(0.0, 1.0 - max(own)):.2f}" if own else "" for own in found)
    rows.append(("*left to the best known*", "", "", *left))
    rows.append(("*widest ±*", "", "", *(f"{widest(task, lines[task.id]):.3f}" for task in known)))
    return table(" | ".join(["method", "runs", "IQM", *(f"{task.number}" for task in known)]), rows, numbers=True)


def _middle(own: dict[str, list[float]], count: int) -> str:
    """The interquartile mean, with its interval; "" where it is of a part of the tasks."""
    if len(own) < count:
        return ""
    limits = interval(own)
    return _two(interquartile_mean(own)) + ("" if limits is None else f" [{limits[0]:.2f}, {limits[1]:.2f}]")


def _two(score: float) -> str:
    """Two digits; no zero below zero."""
    return f"{round(score, 2) + 0.0:.2f}"


def _learnt(judged: Sequence[tuple[Task, dict[str, Any]]]) -> Iterator[int]:
    """The entries, by `id`, whose values less PD's differ beyond chance from one hundred to the other."""
    both = [(task, entry) for task, entry in judged if entry.get("second") and entry["second"]["pd"] is not None]
    lots = [(less_pd(task, entry), less_pd(task, entry["second"])) for task, entry in both]
    for (_, entry), p in zip(both, holm([chance(*lot) for lot in lots]), strict=True):
        if p < LEVEL:
            yield id(entry)


def less_pd(task: Task, numbers: Mapping[str, Any]) -> NDArray[np.float64]:
    """The values of a hundred less those of PD control."""
    gain: NDArray[np.float64] = values(task, numbers) - np.array(numbers["pd"], float)
    return gain


def _second(task: Task, line: Line, learnt: set[int]) -> tuple[str, str, str]:
    """Of the second hundred success, settling and the value less PD's, beside that on the public one."""
    others = [entry["second"] for entry in line.entries if entry.get("second")]
    if len(others) < len(line.entries):
        return "public alone" if any("second" in entry for entry in line.entries) else "", "", ""
    rate = np.mean([np.mean(one["successes"]) for one in others])
    time = float(np.mean([settling(task, one) for one in others]))
    if others[0]["pd"] is None:
        return f"{rate:.0%}", _two(time), ""
    gain, there = (np.mean([less_pd(task, one) for one in lot]) for lot in (line.entries, others))
    mark = " †" if any(id(entry) in learnt for entry in line.entries) else ""
    return f"{rate:.0%}", _two(time), f"{there:.1f} ({gain:.1f}){mark}"


def gap(task: Task, line: Line, first: Line) -> tuple[float, float, int] | None:
    """How far a method's score is behind another's on the episodes that both have, half the width of the 95 %
    interval, and how many they are; None where the task has no scores."""
    known = reference(task)
    if known is None:
        return None
    count = min(length(entry) for one in (first, line) for entry in one.entries)
    ahead, own = (np.mean([all_values(task, e)[:count] for e in one.entries], axis=0) for one in (first, line))
    less = (ahead - own) / (known.best - known.pd)
    return float(less.mean()), 1.96 * float(less.std(ddof=1)) / count**0.5, count


def widest(task: Task, lines: Sequence[Line]) -> float:
    """The largest half of a width, of all pairs of methods that make policies and had the task's budget."""
    own = [line for line in lines if line.policy and not line.short(task)]
    gaps = [gap(task, line, other) for k, line in enumerate(own) for other in own[:k]]
    return max((found[1] for found in gaps if found is not None), default=0.0)


def _behind(task: Task, line: Line, first: Line | None) -> str:
    """How far a method's score is behind that of the best policy, `first`."""
    found = None if first is None or line is first else gap(task, line, first)
    if found is None:
        return ""
    less, half, count = found
    more = f", {count}" if count > EPISODES else ""
    return f"{_two(less)} ± {half:.2f}{more}" + (f" ({count * (half / WIDTH) ** 2:.0f})" if half > WIDTH else "")


def _record(task: Task, lines: Sequence[Line]) -> str:
    """The record, and who beats it."""
    kept = best.record(task)
    bar = kept.values + best.rounding(task.id)
    above = {line.method: max(int((values(task, e) > bar).sum()) for e in line.entries) for line in lines}
    beaten = ", ".join(f"{name} in {count} episodes" for name, count in above.items() if count)
    more = f" Above it: **{beaten}**; how to hand that in: docs/tutorials/suite.md." if beaten else ""
    return f"The record, of {kept.date}: J = {kept.values.mean():.1f} (`flexarm bench suite --best {task.id}`).{more}"


def _table(task: Task, lines: Sequence[Line], learnt: set[int]) -> Iterator[str]:
    known = reference(task)
    yield from (" ".join(task.hard.split()), "")
    if known is not None:
        yield from (f"J_PD = {known.pd:.1f}; J_best = {known.best:.1f}, by {known.by}.", "")
    if task.id in best.known():
        yield from (_record(task, lines), "")
    first = next((line for line in lines if line.policy), None)
    rows = []
    for line in lines:
        values = [one["value"] for one in line.summaries]
        score, time, steps = line.mean("score"), line.mean("settling_s"), line.trained("steps")
        rows.append((
            f"*{line.method}*" if line.short(task) else line.method, len(values), f"{np.mean(values):.1f}",
            f"{min(values):.1f}, {max(values):.1f}" if len(values) > 1 else "", "" if score is None else _two(score),
            _behind(task, line, first), f"{line.mean('success_rate'):.0%}", "" if time is None else _two(time),
            *_second(task, line, learnt), f"{line.mean('cost'):.2f}",
            *((f"{steps / task.budget:.0%}", f"{line.trained('cpu_s'):.0f}") if steps else ("", "")),
            f"{line.mean('decision_us'):.1f}",
        ))  # fmt: skip
    yield from table(
        "method | runs | J | worst, best run | score | behind the best policy | success | settled, s | "
        "second hundred: success | settled, s | J - J_PD | cost | training, share of the budget | CPU s | decision, µs",
        rows, numbers=True,
    )  # fmt: skip


def _made(found: Sequence[Results]) -> Iterator[str]:
    """With what, and how much computing stands behind it."""
    entries = [entry for one in found for entry in one.tasks.values()]
    versions = sorted(
        {f"{name} {v}" for e in entries for name, v in e.get("versions", {}).items() if name != "machine"}
    )
    machines = sorted({e["versions"]["machine"] for e in entries if "machine" in e.get("versions", {})})
    judging = sum(entry["cpu_s"] for entry in entries) / 3600.0
    training = sum((entry["training"] or {}).get("cpu_s", 0.0) for entry in entries) / 3600.0
    yield f"{len(found)} files; CPU hours: {training:.2f} of training, {judging:.2f} of judging."
    yield " · ".join(machines + versions)


def _left_out(found: Sequence[Results]) -> Iterator[str]:
    """Of entries that are of another task, or on other episodes; and refusals."""
    known = {task.id: task for task in tasks(earlier=True)}
    other = [
        f"{one.file}: {name}"
        for one in found
        for name, entry in one.tasks.items()
        if name not in known or not of_the_protocol(known[name], entry)
    ]
    if other:
        yield from ("", "## Left out", "", "Of other episodes than the protocol's, or of tasks that have changed:", "")
        yield from (f"- {text}" for text in other)
    refused = {(one.name, name, why) for one in found for name, why in one.refused.items()}
    if refused:
        yield from ("", "## Not judged", "")
        yield from (f"- {method} on `{name}`: {why}" for method, name, why in sorted(refused))
