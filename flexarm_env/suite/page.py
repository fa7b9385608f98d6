"""Pages of all results files in a folder: an overview, and a table for each task."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files import table
from . import best
from .data import Task, tasks
from .lines import Line, lines_of, middle, two
from .overview import overview
from .results import Results, all_values, length, of_the_protocol, settling, values
from .score import EPISODES, FIRST, interquartile_mean, reference
from .second import LEVEL, chance, holm

WIDTH = 0.05
"""Desired half width of the 95 % interval of a score difference."""

HOW = f"""## How to read the tables

- **J** is the mean return over the {EPISODES} episodes of seeds {FIRST} to {FIRST + EPISODES - 1}, which no
  training uses. In tasks with costs, the mean cost times its weight (the price) is subtracted.
- **Score** is (J - J_PD) / (J_best - J_PD): 0 for PD control, 1 for the best known torques.
- **Blank cells** mean that the method does not apply to the task or was not evaluated on it.
- The last three rows of the table of scores describe the policies on a task. ***Range of scores*** is the highest minus
  the lowest score. ***Largest half width*** refers to the 95 % intervals of the score differences between all pairs of
  policies with the full budget: it is half the width of the widest interval.
- **Score gap to the best policy** is the mean difference between the best policy's score and the method's score in the
  same episodes. Half the width of the difference's 95 % interval follows after ±. If more than {EPISODES} episodes
  were evaluated, the number of episodes stands after the half width. Brackets give the number of episodes that would
  reduce the half width to {WIDTH}.
- **Settling time** is the mean time after which the tip stays within the bounds of success to the end of the episode. A
  failed episode counts as its whole length.
- **Second hundred** are 100 episodes whose seeds are computed from the policy itself (`flexarm_env.suite.second`). The
  columns give success rate, settling time, and J minus the J of PD. Brackets give J minus the J of PD in the 100 public
  episodes (the public hundred). The mark † denotes a difference between both hundreds that is larger than chance
  explains (permutation test, p < {LEVEL} after Holm, over all runs of these pages). *public only* marks functions,
  models with a memory and `foresight`, which are evaluated only on the public hundred and may have memorized these
  episodes.
- **Italic methods** were trained with less than the task's budget.
- **`foresight`** is no policy. An optimizer that knows the complete episode in advance improves the torques of each
  episode by the gradient of the episode's return. The search starts from the torques of the best trained policy or of
  the best controller that observes the whole state. The results are local optima. In the task that balances an arm
  upright, the gradients are too large to be useful, so the result equals the initial torques."""


MISSING = "Some methods cannot be evaluated on some tasks, and some results files contain results of other tasks."


def pages(found: Sequence[Results], stem: str = "suite", figure: str = "") -> dict[str, str]:
    """Format the pages of suite results in Markdown.

    Args:
        stem: file name of the first page without its ending. figure: path of the figure of scores
            (`flexarm_env.plotting.scores`), relative to the pages; "": no figure.
    Returns:
        The texts of the pages by file name. STEM.md is the overview, and STEM-tasks.md contains the details.
        STEM-earlier.md (results on previous versions of tasks) and STEM-missing.md (methods that could not be
        evaluated) are omitted if the pages are empty.
    """
    every = [task for task in tasks(earlier=True) if any(task.id in one.tasks for one in found)]
    known = [task for task in every if task in tasks()]
    rows = {task.id: lines_of(task, found) for task in every}
    # significant differences between the two hundreds, over all entries of the pages
    learnt = set(_learnt([(task, entry) for task in every for line in rows[task.id] for entry in line.entries]))
    details = ["# Results on each task of the suite", ""]
    details += [f"This page has all results by task; [the overview]({stem}.md) has the findings.", ""]
    details += ["## Scores", "", *_scores(known, rows), "", HOW]
    before = ["# Results on superseded tasks", ""]
    before += [f"This page has the results on superseded versions of tasks; {stem}-tasks.md explains the columns."]
    for task in every:
        text = details if task in known else before
        text += ["", f"## {task.number}. {task.title} (`{task.id}`)", "", *_table(task, rows[task.id], learnt)]
    texts = {f"{stem}-tasks.md": details}
    if len(known) < len(every):
        texts[f"{stem}-earlier.md"] = before
    if missing := list(_left_out(found)):
        texts[f"{stem}-missing.md"] = ["# What was not evaluated on the suite", "", MISSING, *missing]
    texts = {f"{stem}.md": [*overview(known, rows, list(texts), figure), *_provenance(found)], **texts}
    return {name: "\n".join(text).rstrip() + "\n" for name, text in texts.items()}


def _scores(known: Sequence[Task], lines: dict[str, list[Line]]) -> list[str]:
    """Format the table of scores: a row per method with its interquartile mean and its mean score on each task."""
    scores: dict[str, dict[str, list[float]]] = {}
    for task in known:
        for line in lines[task.id]:
            if line.mean("score") is not None:
                scores.setdefault(line.method, {})[task.id] = [one["score"] for one in line.summaries]
    rows: list[tuple[str, ...]] = []
    for name in sorted(scores, key=lambda name: (-len(scores[name]), -interquartile_mean(scores[name]))):
        own = scores[name]
        means = (two(float(np.mean(own[task.id]))) if task.id in own else "" for task in known)
        counts = sorted({len(runs) for runs in own.values()})
        runs = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}-{counts[-1]}"
        rows.append((name, runs, middle(own, len(known)), *means))
    # spread among policies alone, without actions optimized beforehand
    found = [
        [score for line in lines[task.id] if line.policy and (score := line.mean("score")) is not None]
        for task in known
    ]
    rows.append(("*range of scores*", "", "", *(f"{max(own) - min(own):.2f}" if own else "" for own in found)))
    left = (f"{max(0.0, 1.0 - max(own)):.2f}" if own else "" for own in found)
    rows.append(("*1 - highest score*", "", "", *left))
    rows.append(("*largest half width*", "", "", *(f"{widest(task, lines[task.id]):.3f}" for task in known)))
    return table(" | ".join(["method", "runs", "IQM", *(f"{task.number}" for task in known)]), rows, numbers=True)


def _learnt(judged: Sequence[tuple[Task, dict[str, Any]]]) -> Iterator[int]:
    """Yield the `id` of entries whose value minus PD's differs significantly between the two hundreds of episodes."""
    both = [(task, entry) for task, entry in judged if entry.get("second") and entry["second"]["pd"] is not None]
    lots = [(less_pd(task, entry), less_pd(task, entry["second"])) for task, entry in both]
    for (_, entry), p in zip(both, holm([chance(*lot) for lot in lots]), strict=True):
        if p < LEVEL:
            yield id(entry)


def less_pd(task: Task, numbers: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the values J (n,) of n episodes minus the values of PD control in these n episodes."""
    gain: NDArray[np.float64] = values(task, numbers) - np.array(numbers["pd"], float)
    return gain


def _second(task: Task, line: Line, learnt: set[int]) -> tuple[str, str, str]:
    """Format success, settling, and value minus PD's on the second hundred; the last also for the public hundred."""
    others = [entry["second"] for entry in line.entries if entry.get("second")]
    if len(others) < len(line.entries):
        return "public only" if any("second" in entry for entry in line.entries) else "", "", ""
    rate = np.mean([np.mean(one["successes"]) for one in others])
    time = float(np.mean([settling(task, one) for one in others]))
    if others[0]["pd"] is None:
        return f"{rate:.0%}", two(time), ""
    # value minus PD's on the public and on the second hundred
    gain, there = (np.mean([less_pd(task, one) for one in lot]) for lot in (line.entries, others))
    mark = " †" if any(id(entry) in learnt for entry in line.entries) else ""
    return f"{rate:.0%}", two(time), f"{there:.1f} ({gain:.1f}){mark}"


def gap(task: Task, line: Line, first: Line) -> tuple[float, float, int] | None:
    """Return the score of the method `first` minus the score of the method `line`.

    The difference is computed in each episode. Returns the mean difference, the half width of its 95 % interval, and
    the number of common episodes; None if the task has no reference values.
    """
    known = reference(task)
    if known is None:
        return None
    count = min(length(entry) for one in (first, line) for entry in one.entries)
    ahead, own = (np.mean([all_values(task, e)[:count] for e in one.entries], axis=0) for one in (first, line))
    # paired difference of scores per episode
    less = (ahead - own) / (known.best - known.pd)
    return float(less.mean()), 1.96 * float(less.std(ddof=1)) / count**0.5, count


def widest(task: Task, lines: Sequence[Line]) -> float:
    """Compute the 95 % interval of `gap` for each pair of policies; return the largest half width.

    Policies that were trained with less than the task's budget are excluded.
    """
    own = [line for line in lines if line.policy and not line.short(task)]
    gaps = [gap(task, line, other) for k, line in enumerate(own) for other in own[:k]]
    return max((found[1] for found in gaps if found is not None), default=0.0)


def _behind(task: Task, line: Line, first: Line | None) -> str:
    """Format a method's score difference to the best policy `first`, and the number of episodes needed for `WIDTH`."""
    found = None if first is None or line is first else gap(task, line, first)
    if found is None:
        return ""
    less, half, count = found
    more = f", {count}" if count > EPISODES else ""
    return f"{two(less)} ± {half:.2f}{more}" + (f" ({count * (half / WIDTH) ** 2:.0f})" if half > WIDTH else "")


def _record(task: Task, lines: Sequence[Line]) -> str:
    """Format the record of a task and the methods that beat it."""
    kept = best.record(task)
    bar = kept.values + best.rounding(task.id)
    above = {line.method: max(int((values(task, e) > bar).sum()) for e in line.entries) for line in lines}
    beaten = ", ".join(f"{name} in {count} episodes" for name, count in above.items() if count)
    more = f" Better than these actions: **{beaten}**; docs/tutorials/suite.md says how to submit it." if beaten else ""
    shown = f"`flexarm bench suite --best {task.id}` replays these actions"
    return f"The best stored actions ({kept.date}) reach J = {kept.values.mean():.1f} ({shown}).{more}"


def _table(task: Task, lines: Sequence[Line], learnt: set[int]) -> Iterator[str]:
    """Yield the lines of a task's section: its difficulty, reference values, record and table of methods."""
    known = reference(task)
    yield from (" ".join(task.hard.split()), "")
    if known is not None:
        own = f"PD control reaches J_PD = {known.pd:.1f}. "
        yield from (f"{own}The best result of a method is J_best = {known.best:.1f} (`{known.by}`).", "")
    if task.id in best.known():
        yield from (_record(task, lines), "")
    first = next((line for line in lines if line.policy), None)
    rows = []
    for line in lines:
        values = [one["value"] for one in line.summaries]
        score, time, steps = line.mean("score"), line.mean("settling_s"), line.trained("steps")
        rows.append((
            f"*{line.method}*" if line.short(task) else line.method, len(values), f"{np.mean(values):.1f}",
            f"{min(values):.1f}, {max(values):.1f}" if len(values) > 1 else "", "" if score is None else two(score),
            _behind(task, line, first), f"{line.mean('success_rate'):.0%}", "" if time is None else two(time),
            *_second(task, line, learnt), f"{line.mean('cost'):.2f}",
            *((f"{steps / task.budget:.0%}", f"{line.trained('cpu_s'):.0f}") if steps else ("", "")),
            f"{line.mean('decision_us'):.1f}",
        ))  # fmt: skip
    yield from table(
        "method | runs | J | J of the worst and the best run | score | score gap to the best policy | success | "
        "settling time, s | second hundred: success | settling time, s | J - J_PD | cost | "
        "training, share of the budget | training, CPU s | CPU per decision, µs",
        rows, numbers=True,
    )  # fmt: skip


def _provenance(found: Sequence[Results]) -> Iterator[str]:
    """Yield the lines on computing time, machines and versions."""
    entries = [entry for one in found for entry in one.tasks.values()]
    versions = sorted(
        {f"{name} {v}" for e in entries for name, v in e.get("versions", {}).items() if name != "machine"}
    )
    machines = sorted({e["versions"]["machine"] for e in entries if "machine" in e.get("versions", {})})
    judging = sum(entry["cpu_s"] for entry in entries) / 3600.0
    training = sum((entry["training"] or {}).get("cpu_s", 0.0) for entry in entries) / 3600.0
    yield (
        f"The {len(found)} results files took {training:.2f} CPU hours of training and "
        f"{judging:.2f} CPU hours of evaluation."
    )
    yield " · ".join(machines + versions)


def _left_out(found: Sequence[Results]) -> Iterator[str]:
    """Yield the lines on entries of other tasks or episodes, and on methods that could not be evaluated."""
    known = {task.id: task for task in tasks(earlier=True)}
    other = [
        f"{one.file}: {name}"
        for one in found
        for name, entry in one.tasks.items()
        if name not in known or not of_the_protocol(known[name], entry)
    ]
    if other:
        why = "These entries of files have other episodes than the protocol requires, or belong to changed tasks:"
        yield from ("", "## Results of other tasks", "", why, "")
        yield from (f"- {text}" for text in other)
    # tasks of each method and reason; the entries of an observation are on the task's own page
    refused: dict[tuple[str, str], set[str]] = {}
    for one in found:
        for name, why in one.refused.items():
            refused.setdefault((one.name, why.partition(", which is not among")[0]), set()).add(name)
    if refused:
        reason = "The list has the error message for each method that cannot be evaluated on a task:"
        yield from ("", "## Not evaluated", "", reason, "")
        for (method, why), names in sorted(refused.items()):
            yield f"- {method} on {', '.join(f'`{name}`' for name in sorted(names))}: {why}"
