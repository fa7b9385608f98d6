"""Write the overview of the suite's results: the finding, a table with a row for each task, and data for the figure."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..files import table
from .data import Task, tasks
from .lines import Line, lines_of, middle, two
from .results import Results
from .score import interquartile_mean

COLUMNS = 4
"""Largest number of methods that learn with a column of their own."""

NAMES = {
    "ppo": "PPO", "ppo_press": "PPO around force control", "gradient": "gradient method",
    "sac": "SAC", "tqc": "TQC", "recurrent_ppo": "recurrent PPO",
}  # fmt: skip
"""Names of the methods of the package's own results; other methods are shown by the names of their files."""

AROUND = ("reach-measured-v1", "slew-handling-v2", "space-wall-v1", "space-measured-v1", "float-reach-v1")
"""Tasks on which the policies of PPO in the package's own results contain PD control (`configs/ppo/suite.yml`)."""

HOW = """The **score** is 0 for PD control and 1 for the best known torques, which are optimized for each episode with
the complete episode known in advance. Brackets contain the rate of success in 100 episodes that no training uses. The
score and the rate are means over the runs of a method with different seeds. **Bold** marks the highest score of a task.
*Italic* scores come from less training than the task's budget. The column *best controller* has the best method that
does not learn. **IQM** is the interquartile mean, the mean of the middle half of all scores of a method, with a 95 %
interval (bootstrap over runs) and the number of tasks."""

MARK = "°"
HOW_MARKED = f"""{MARK} marks PPO policies that contain PD control: the network corrects the torques of PD control. On
these tasks PPO without PD control has a lower score."""


def overview(
    known: Sequence[Task], rows: Mapping[str, Sequence[Line]], others: Sequence[str], figure: str
) -> list[str]:
    """Return the lines of the overview page.

    known: the tasks with results. rows: the methods on each task. others: file names of the detailed pages. figure:
    path of the figure, or "".
    """
    text = ["# Results on the suite", "", finding(known, rows), ""]
    if figure:
        text += [f"![Scores of PPO, SAC, the gradient method and the best controller on each task]({figure})", ""]
    lines = scores(known, rows)
    marked = ["", HOW_MARKED] if any(MARK in line for line in lines) else []
    text += [*lines, "", HOW, *marked, "", "## Details", ""]
    what = {
        "tasks": "all methods on each task: returns, settling times, differences and their intervals, computing times",
        "earlier": "results on superseded versions of tasks",
        "missing": "methods that cannot be evaluated on a task, with the reason",
    }
    text += [f"- [{what[name[:-3].rpartition('-')[2]]}]({name})" for name in others]
    text += [
        "",
        "Each file of results contains one run of a method. `flexarm bench suite --policy ... --name METHOD --out "
        "FOLDER` adds a file to a folder, and `flexarm bench page FOLDER --out PAGE` writes these pages.",
        "",
    ]
    return text


def finding(known: Sequence[Task], rows: Mapping[str, Sequence[Line]]) -> str:
    """Format the result: number of tasks on which trained policies are best, range of best scores, hardest task."""
    first = [line for task in known if (line := _best(task, rows[task.id])) is not None]
    scores = [_score(line) for line in first]
    if not scores or not np.all(np.isfinite(scores)):
        return "Scores of methods on the suite's tasks."
    learnt, hard = sum(line.learnt for line in first), known[int(np.argmin(scores))]
    return (
        f"Trained policies have the highest score on {learnt} of {len(scores)} tasks, controllers on "
        f"{len(scores) - learnt}. The highest score of a task is {min(scores):.2f} (`{hard.id}`) to "
        f"{max(scores):.2f}, where 0 is PD control and 1 the best known torques."
    )


def scores(known: Sequence[Task], rows: Mapping[str, Sequence[Line]]) -> list[str]:
    """Format the table of scores: each task's `lesson`, and scores of the best controller and of learning methods."""
    chosen = learners(known, rows)
    own: dict[str, dict[str, list[float]]] = {name: {} for name in ["", *chosen]}
    cells = []
    for task in known:
        lines = {line.method: line for line in rows[task.id]}
        picked = {"": controller(rows[task.id]), **{name: lines.get(name) for name in chosen}}
        best = max(
            (_score(line) for line in picked.values() if line is not None and not line.short(task)), default=-np.inf
        )
        row = [str(task.number), f"`{task.id}`", task.lesson]
        for name, line in picked.items():
            if line is None or line.mean("score") is None:
                row.append("")
                continue
            own[name][task.id] = [one["score"] for one in line.summaries]
            row.append(_cell(task, line, best, named=not name))
        cells.append(row)
    last = ["", "IQM", ""]
    for runs in own.values():
        last.append(f"{middle(runs, len(runs))} ({len(runs)} tasks)" if runs else "")
    heads = ["#", "task", "what it shows", "best controller", *(NAMES.get(name, name) for name in chosen)]
    return table(" | ".join(heads), [*cells, last])


def _cell(task: Task, line: Line, best: float, named: bool) -> str:
    """Format a method's score and success; named: with the method's name."""
    score = two(_score(line))
    score = f"*{score}*" if line.short(task) else f"**{score}**" if _score(line) == best else score
    score += MARK * (line.method == "ppo" and task.id in AROUND)
    return f"{line.method} {score}" * named + score * (not named) + f" ({line.mean('success_rate'):.0%})"


def _score(line: Line | None) -> float:
    """Return the mean score of a method's runs; minus infinity without a score."""
    mean = None if line is None else line.mean("score")
    return -np.inf if mean is None else mean


def _best(task: Task, lines: Sequence[Line]) -> Line | None:
    """Return the policy with the highest value that was trained with the whole budget."""
    return next((line for line in lines if line.policy and not line.short(task)), None)


def controller(lines: Sequence[Line]) -> Line | None:
    """Return the policy with the highest value among the policies that need no training."""
    return next((line for line in lines if line.policy and not line.learnt), None)


def learners(known: Sequence[Task], rows: Mapping[str, Sequence[Line]]) -> list[str]:
    """Return at most `COLUMNS` trained methods: the methods with results on the most tasks, in order of the scores."""
    found: dict[str, dict[str, list[float]]] = {}
    for task in known:
        for line in rows[task.id]:
            if line.learnt and line.mean("score") is not None:
                found.setdefault(line.method, {})[task.id] = [one["score"] for one in line.summaries]
    most = sorted(found, key=lambda name: -len(found[name]))[:COLUMNS]
    return sorted(most, key=lambda name: -interquartile_mean(found[name]))


def figure_data(found: Sequence[Results]) -> tuple[list[str], dict[str, list[float | None]]]:
    """Return the labels of the tasks with results, and each method's scores on these tasks, for a figure.

    The methods are the best controller and the trained methods that have a column in the table of scores.
    """
    known = [task for task in tasks() if any(task.id in one.tasks for one in found)]
    rows = {task.id: lines_of(task, found) for task in known}
    scores = {"best controller": [_known(controller(rows[task.id])) for task in known]}
    for name in learners(known, rows):
        lines = ({line.method: line for line in rows[task.id]}.get(name) for task in known)
        scores[NAMES.get(name, name)] = [_known(line) for line in lines]
    return [f"{task.id}  {task.number}" for task in known], scores


def _known(line: Line | None) -> float | None:
    """Return the mean score of a method's runs; None if there is no score."""
    return None if line is None else line.mean("score")
