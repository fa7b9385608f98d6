"""`flexarm bench suite` and `flexarm bench page`: evaluate policies on the suite's tasks, and write a page of
results.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import suite
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.progress import show
from flexarm_env.episodes import Actions
from flexarm_env.files import to_folder, write_text
from flexarm_env.suite import best
from flexarm_env.suite.data import Task
from flexarm_env.suite.overview import figure_data
from flexarm_env.suite.page import pages
from flexarm_env.suite.policies import PLACE
from flexarm_env.suite.results import Results, chosen_tasks, folder_of, frozen, judged, listed, summary
from flexarm_env.suite.score import EPISODES, FIRST, references
from flexarm_env.training.arguments import Parser

COMMANDS = {
    "suite": "Evaluate policies on the suite's tasks; works without a checkout",
    "page": "Summarize all results files of a folder on Markdown pages; works without a checkout",
}

MOST = 100_000
"""Largest number of episodes in a policy's evaluation."""

SUITE = f"""\
Evaluate policies on the suite's tasks, on the {EPISODES} episodes with the seeds {FIRST}, {FIRST + 1}, ..., and write
FOLDER/NAME-RUN.json with versions, digests of the tasks, seeds, run times, and return, success and cost of each
episode. If FOLDER already contains results of the same policy on a task, the command keeps them and says so;
an interrupted command can thus be resumed. --again evaluates the policy again. Python functions are always evaluated
again. With more than {EPISODES} --episodes, the score uses the first {EPISODES}; the other episodes only make the
differences between methods on the page more precise.

A policy is a controller (pd, zv, zvd, lqr, lqg, mpc, time_optimal; for tasks at a wall hybrid_force, impedance,
lqr_force, mpc_force), a run folder or policy.npz, a policy of the package, an .onnx file, or MODULE:NAME. MODULE:NAME
is a Python function from observations (n, entries) to actions (n, joints), a function from one observation to one
action, or an object or class with the methods `reset`, which receives the first observations, and `act`. If each task
has its own policy, write {PLACE} in the name in place of the task's id.

  flexarm bench suite --list            with --json: id, for --task, and env_id, for gymnasium.make
  flexarm bench suite --policy pd,lqg --out runs/suite
  flexarm bench suite --policy 'runs/{PLACE}-0' --name ppo --run 0 --out runs/suite
  flexarm bench suite --policy mine:act --task slew-measured-v2
  flexarm bench suite --best slew-measured-v2      play the best known result of the task
"""

PAGE = """\
Summarize all results files of a folder on Markdown pages. FILE.md has a table of scores with a row for each task.
FILE-tasks.md has a table of all methods for each task. FILE-earlier.md has the results on previous versions of tasks,
and FILE-missing.md the methods that cannot be evaluated. Without --out the pages are printed.

  flexarm bench page runs/suite --out runs/suite.md
  flexarm bench page runs/suite --out runs/suite.md --figure runs/suite.png      a figure of the scores (".[plot]")
"""

CODES = """\
exit code: 0 done, 1 some task could not be evaluated (see standard error), 2 wrong input, 130 interrupted
"""


def run(name: str, words: Sequence[str]) -> int:
    """Run `flexarm bench suite` or `flexarm bench page`; return the exit code."""
    return _suite(words) if name == "suite" else _page(words)


def _suite(words: Sequence[str]) -> int:
    """Run `flexarm bench suite`: evaluate policies on tasks, list tasks, or play records; return the exit code."""
    parser = Parser(prog="flexarm bench suite", description=SUITE, epilog=CODES)
    parser.add_argument("--policy", default="pd", metavar="POLICY[,POLICY...]", help="policies to evaluate (pd)")
    parser.add_argument("--task", metavar="ID[,ID...]", help="tasks; default: all")
    parser.add_argument("--out", default="runs/suite", metavar="FOLDER", help="folder of results files (runs/suite)")
    parser.add_argument("--name", metavar="NAME", help="name of the method; default: from the policy")
    parser.add_argument("--run", type=int, metavar="K", help="number of the run; default: the policy's seed, or 0")
    parser.add_argument("--episodes", type=int, default=EPISODES, metavar="N", help="number (100); fewer: a preview")
    parser.add_argument("--again", action="store_true", help="repeat evaluations that are already in FOLDER")
    parser.add_argument("--best", metavar="ID[,ID...]", help="only play the best known results of these tasks")
    parser.add_argument("--list", action="store_true", help="list the tasks")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    args = parser.parse_args(words)
    if args.list:
        return _list(args.json)
    if args.best is not None:
        return _best([frozen(task) for task in chosen_tasks(args.best)], args.json)
    count = check.integer("--episodes", args.episodes, minimum=1, maximum=MOST)
    wanted = [frozen(task) for task in chosen_tasks(args.task)]
    policies = listed("--policy", args.policy)
    if args.name is not None and len(policies) != 1:
        raise check.InvalidValue("--name", args.name, "requires a single policy")
    to_folder("--out", args.out)
    done, trouble = [], []
    for word in policies:
        results, refused, notes = judged(
            word, wanted, Path(args.out), name=args.name, run=args.run, episodes=count, again=args.again
        )
        trouble += refused
        if not results.tasks:
            continue
        done.append(_summary(results, notes, wanted, Path(args.out)))
        if not args.json:
            _print(done[-1])
    if args.json and done:
        show({"results": done}, True)
    if not done:
        raise ValueError(trouble[0] if len(trouble) == 1 else "; ".join(trouble))
    for sentence in trouble:
        sys.stderr.write(f"flexarm bench suite: {sentence}\n")
    return FAILED if trouble else DONE


def _best(wanted: Sequence[Task], as_json: bool) -> int:
    """Play records; return 1 if a record does not reproduce its stored values."""
    found = {}
    for task in wanted:
        kept = best.record(task)
        env = suite.make_vec(task.id, kept.actions.shape[1])
        values, successes = best.played(task, env, Actions(kept.actions))
        env.close()
        found[task.id] = {
            "date": kept.date, "value": float(values.mean()), "success_rate": float(successes.mean()),
            "episodes": len(values), "equal": int((values == kept.values).sum()),
            "same": int((np.abs(values - kept.values) <= best.rounding(task.id)).sum()),
        }  # fmt: skip
    if as_json:
        show({"records": found}, True)
    for name, one in () if as_json else found.items():
        what = f"J {one['value']:.2f}, success {one['success_rate']:.0%}"
        equal = f"{one['same']} of {one['episodes']} episodes reproduced, {one['equal']} to the last bit"
        print(f"{name}: record of {one['date']}: {what}; {equal}")
    return DONE if all(one["same"] == one["episodes"] for one in found.values()) else FAILED


def _summary(results: Results, notes: Mapping[str, str], wanted: Sequence[Task], folder: Path) -> dict[str, Any]:
    """Return the values of a policy that the command prints."""
    own = [task for task in wanted if task.id in results.tasks]
    found = {task.id: summary(task, results.tasks[task.id]) | {"note": notes.get(task.id, "")} for task in own}
    return {"policy": results.name, "run": results.run, "file": str(folder / results.file), "tasks": found}


def _print(found: dict[str, Any]) -> None:
    """Print a policy's results, a line for each task."""
    print(f"{found['policy']}, run {found['run']}: {found['file']}")
    for name, values in found["tasks"].items():
        score = "no score" if values["score"] is None else f"score {values['score']:.3f}"
        cost = f", cost {values['cost']:.4g}" if values["cost"] else ""
        note = f" ({values['note']})" if values["note"] else ""
        print(f"{name}: J {values['value']:.2f}, {score}, success {values['success_rate']:.0%}{cost}{note}")


def _list(as_json: bool) -> int:
    """Print the tasks with their budgets and, as JSON, their reference scores."""
    known = references()
    entries = [
        {
            "id": task.id, "env_id": task.env_id, "title": task.title, "environment": task.environment,
            "budget": task.budget,
            "price": task.price, "digest": task.digest,
            "pd": known[task.id].pd if task.id in known else None,
            "best": known[task.id].best if task.id in known else None,
        }
        for task in suite.tasks()
    ]  # fmt: skip
    if as_json:
        show({"tasks": entries}, True)
        return DONE
    width = max(len(str(entry["id"])) for entry in entries)
    for entry in entries:
        print(f"{entry['id']:{width}}  {entry['title']}; training budget {entry['budget']:,} control periods")
    print(f'Create a task by its id: gymnasium.make("{suite.task(str(entries[0]["id"])).env_id}")')
    return DONE


def _page(words: Sequence[str]) -> int:
    """Run `flexarm bench page`: write the page of a folder of results; returns the exit code."""
    parser = Parser(prog="flexarm bench page", description=PAGE)
    parser.add_argument("folder", metavar="FOLDER", help="folder of results files")
    parser.add_argument("--out", metavar="FILE.md", help="the first page; default: standard output")
    parser.add_argument("--figure", metavar="FILE.png", help="a figure of the scores, which the first page shows")
    args = parser.parse_args(words)
    if args.out is not None and Path(args.out).suffix.lower() != ".md":
        raise check.InvalidValue("--out", args.out, "must end in .md")
    found, beside = folder_of(Path(args.folder)), ""
    if args.figure is not None:
        from flexarm_env.plotting.scores import plot_scores

        plot_scores(*figure_data(found), args.figure)
        beside = os.path.relpath(args.figure, Path(args.out or ".").parent)
    texts = pages(found, "suite" if args.out is None else Path(args.out).stem, beside)
    if args.out is None:
        print("\n".join(texts.values()), end="")
        return DONE
    for name, text in texts.items():
        write_text(Path(args.out).parent / name, text)
        print(f"page: {Path(args.out).parent / name}")
    return DONE
