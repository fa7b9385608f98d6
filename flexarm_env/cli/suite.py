"""`flexarm bench suite` and `flexarm bench page`: policies judged on the suite's tasks, a page of results."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import suite
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.progress import show
from flexarm_env.files import to_folder, write_text
from flexarm_env.suite import best
from flexarm_env.suite.data import Task
from flexarm_env.suite.page import page
from flexarm_env.suite.policies import PLACE
from flexarm_env.suite.results import Results, chosen_tasks, folder_of, frozen, judged, listed, summary
from flexarm_env.suite.score import EPISODES, FIRST, references
from flexarm_env.training.arguments import Parser

COMMANDS = {
    "suite": "Judge policies on the suite's tasks; works without a checkout",
    "page": "One page of all results files of a folder; works without a checkout",
}

MOST = 100_000
"""Episodes that a policy is judged on at most."""

SUITE = f"""\
Judge policies on the suite's tasks, each on the {EPISODES} episodes of seeds {FIRST} and on, and write what came of it
to FOLDER/NAME-RUN.json: versions, digests of the tasks, seeds, seconds, and of each episode return, success and cost.
What stands there already, of the same policy on the same task, is kept, and said to be: an interrupted command goes on.
Functions of your own are judged anew each time, others with --again. Of more than {EPISODES} episodes, all from seed
{FIRST} on, a result is of the first {EPISODES}, and the others tell methods apart (the page's differences).

A policy is a controller (pd, zv, zvd, lqr, lqg, mpc, time_optimal), a run folder or policy.npz, the name of a policy
that comes with the package, an .onnx file, or MODULE:NAME of your own: a function of observations (n, entries) to
actions (n, joints), or of one to one, or an object with `reset` and `act`, or its class; `reset` is called with the
first observations. The word {PLACE} in it stands for the task's id, where each task has a policy of its own.

  flexarm bench suite --list            with --json: id, for --task, and env_id, for gymnasium.make
  flexarm bench suite --policy pd,lqg --out runs/suite
  flexarm bench suite --policy 'runs/{PLACE}-0' --name ppo --run 0 --out runs/suite
  flexarm bench suite --policy mine:act --task slew-measured-v2
  flexarm bench suite --best slew-measured-v2      play the record, the best of all that was played there
"""

PAGE = """\
Make one page, in Markdown, of all results files in a folder: interquartile means of the scores with intervals, and a
table of each task.

  flexarm bench page runs/suite --out runs/suite.md
"""

CODES = """\
exit code: 0 done, 1 some task could not be judged (said on standard error), 2 wrong input, 130 interrupted
"""


def run(name: str, words: Sequence[str]) -> int:
    """Run `flexarm bench NAME`; the exit code."""
    return _suite(words) if name == "suite" else _page(words)


def _suite(words: Sequence[str]) -> int:
    parser = Parser(prog="flexarm bench suite", description=SUITE, epilog=CODES)
    parser.add_argument("--policy", default="pd", metavar="WHO[,WHO...]", help="what is judged (pd)")
    parser.add_argument("--task", metavar="ID[,ID...]", help="tasks; default: all")
    parser.add_argument("--out", default="runs/suite", metavar="FOLDER", help="of results files (runs/suite)")
    parser.add_argument("--name", metavar="NAME", help="of the method; default: after the policy")
    parser.add_argument("--run", type=int, metavar="K", help="of several runs; default: the policy's seed, or 0")
    parser.add_argument("--episodes", type=int, default=EPISODES, metavar="N", help="fewer: a look; more: see above")
    parser.add_argument("--again", action="store_true", help="judge anew what was judged before")
    parser.add_argument("--best", metavar="ID[,ID...]", help="play the records of these tasks, and judge nothing")
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
        raise check.InvalidValue("--name", args.name, "must be given for one policy alone")
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
    """Play records; 1 where one does not give the values that it holds."""
    found = {}
    for task in wanted:
        kept = best.record(task)
        env = suite.make_vec(task.id, kept.actions.shape[1])
        values, successes = best.played(task, env, best.Actions(kept.actions))
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
        equal = f"{one['same']} of {one['episodes']} episodes as recorded, {one['equal']} to the bit"
        print(f"{name}: record of {one['date']}: {what}; {equal}")
    return DONE if all(one["same"] == one["episodes"] for one in found.values()) else FAILED


def _summary(results: Results, notes: Mapping[str, str], wanted: Sequence[Task], folder: Path) -> dict[str, Any]:
    """What is printed of a policy."""
    own = [task for task in wanted if task.id in results.tasks]
    found = {task.id: summary(task, results.tasks[task.id]) | {"note": notes.get(task.id, "")} for task in own}
    return {"policy": results.name, "run": results.run, "file": str(folder / results.file), "tasks": found}


def _print(found: dict[str, Any]) -> None:
    print(f"{found['policy']}, run {found['run']}: {found['file']}")
    for name, values in found["tasks"].items():
        score = "no score" if values["score"] is None else f"score {values['score']:.3f}"
        cost = f", cost {values['cost']:.4g}" if values["cost"] else ""
        note = f" ({values['note']})" if values["note"] else ""
        print(f"{name}: J {values['value']:.2f}, {score}, success {values['success_rate']:.0%}{cost}{note}")


def _list(as_json: bool) -> int:
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
        print(f"{entry['id']:{width}}  {entry['title']}; {entry['budget']:,} control periods of training")
    print(f'A task is made by gymnasium.make("{suite.task(str(entries[0]["id"])).env_id}"), and so on.')
    return DONE


def _page(words: Sequence[str]) -> int:
    parser = Parser(prog="flexarm bench page", description=PAGE)
    parser.add_argument("folder", metavar="FOLDER", help="of results files")
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
