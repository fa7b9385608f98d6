"""`flexarm bench suite` and `flexarm bench page`: evaluate policies on the suite's tasks, and write a page of
results."""

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
from flexarm_env.suite.page import page
from flexarm_env.suite.policies import PLACE
from flexarm_env.suite.results import Results, chosen_tasks, folder_of, frozen, judged, listed, summary
from flexarm_env.suite.score import EPISODES, FIRST, references
from flexarm_env.training.arguments import Parser

COMMANDS = {
    "suite": "Evaluate policies on the suite's tasks; works without a checkout",
    "page": "Summarize all results files of a folder on one page; works without a checkout",
}

MOST = 100_000
"""Largest number of episodes in a policy's evaluation."""

SUITE = f"""\
Evaluate policies on the suite's tasks, each on the {EPISODES} episodes with seeds from {FIRST}, and write
FOLDER/NAME-RUN.json: versions, digests of the tasks, seeds, run times, and return, success and cost of each episode.
Results of the same policy and task that are already in FOLDER are kept, and the output says so; an interrupted command
thus resumes. Functions of your own are evaluated every time, other policies with --again. With more than {EPISODES}
episodes, all with seeds from {FIRST}, the result uses the first {EPISODES}; the others refine the differences between
methods on the page.

A policy is a controller (pd, zv, zvd, lqr, lqg, mpc, time_optimal; at a wall hybrid_force, impedance, lqr_force,
mpc_force), a run folder or policy.npz, a policy of the package, an .onnx file, or your own MODULE:NAME: a function of
observations (n, entries) to actions (n, joints) or of one observation to one action, or an object with `reset` and
`act`, or its class. `reset` receives the first observations. If each task has its own policy, write {PLACE} in the
name for the task's id.

  flexarm bench suite --list            with --json: id, for --task, and env_id, for gymnasium.make
  flexarm bench suite --policy pd,lqg --out runs/suite
  flexarm bench suite --policy 'runs/{PLACE}-0' --name ppo --run 0 --out runs/suite
  flexarm bench suite --policy mine:act --task slew-measured-v2
  flexarm bench suite --best slew-measured-v2      play the best known result of the task
"""

PAGE = """\
Summarize all results files of a folder on one Markdown page: interquartile means of the scores with confidence
intervals, and a table for each task.

  flexarm bench page runs/suite --out runs/suite.md
"""

CODES = """\
exit code: 0 done, 1 some task could not be evaluated (see standard error), 2 wrong input, 130 interrupted
"""


def run(name: str, words: Sequence[str]) -> int:
    """Run `flexarm bench NAME`; returns the exit code."""
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
    parser.add_argument("--out", metavar="FILE.md", help="the page; default: standard output")
    args = parser.parse_args(words)
    if args.out is not None and Path(args.out).suffix.lower() != ".md":
        raise check.InvalidValue("--out", args.out, "must end in .md")
    text = page(folder_of(Path(args.folder)))
    if args.out is None:
        print(text, end="")
        return DONE
    write_text(Path(args.out), text)
    print(f"page: {args.out}")
    return DONE
