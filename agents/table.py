"""Evaluate the policies of agents/trained and the classical controllers on the same episodes: docs/results/control.md.

    python -m agents.table                       # half an hour on two cores
    python -m agents.table --policies mpc        # only this row; all other rows are kept

The script writes docs/results/control.{md,json} and the figures docs/figures/control_*.png. `agents.families` trains
the policies. The best known settling times are read from docs/results/optimal.json (`agents.best_known`).
"""

import csv
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents import families
from agents.best_known import EXACT, joined
from agents.demo import say
from agents.families import RECORDED, ROOT, TRAINED, Family
from benchmarks.machine import table, told
from benchmarks.pages import write_page
from flexarm_env import control
from flexarm_env.episodes import Timed, play
from flexarm_env.training import episodes as fixed
from flexarm_env.training.evaluate import Arguments as Judged
from flexarm_env.training.evaluate import evaluate
from flexarm_env.training.figures import learning_curve, tip_errors
from flexarm_env.training.runs import command, read_json, read_run, versions, write_json
from flexarm_env.training.statistics import markdown

FEWER_EPISODES = 100
"""Number of episodes where one episode takes long to compute, or where many policies are evaluated."""

TIMED = 5
"""Number of episodes in which decisions are timed."""

NO_MARGIN = ROOT / "agents" / "no_margin"
"""Folder of gains found by `agents.tune --margin 0`."""

ROBUST = ROOT / "agents" / "robust"
"""Folder of gains found by `agents.tune --randomized`."""

SHIFTS: dict[str, dict[str, Any]] = {
    "payload doubled": {"payload": [2.0, 2.0]},
    "stiffness x 0.7": {"EI": [0.7, 0.7]},
    "stiffness halved": {"EI": [0.5, 0.5]},
    "damping x 0.25": {"damping": [0.25, 0.25]},
}
"""Single changes of the arm with respect to training."""

MEASURED: dict[str, Any] = {"observation": "measured"}
SETTINGS: dict[str, dict[str, tuple[dict[str, Any], str | None]]] = {
    "flexible_arm": {
        "strip, full": ({}, "flexible_arm"),
        "strip, measured": (MEASURED, "flexible_arm_measured"),
        "strip_geared, full": ({"arm": "strip_geared"}, None),
        "strip_geared, measured": ({"arm": "strip_geared"} | MEASURED, "flexible_arm_geared"),
    },
    "two_link": {
        "de_luca_siciliano, full": ({}, "two_link"),
        "de_luca_siciliano, measured": (MEASURED, None),
        "two_link_geared, full": ({"arm": "two_link_geared"}, None),
        "two_link_geared, measured": ({"arm": "two_link_geared"} | MEASURED, "two_link_geared"),
    },
}
"""Settings by family: arms with and without gears and friction, with full and measured observation.

Each setting has the environment's keywords and the family of policies that were trained with these keywords.
"""

DRAWN = "drawn arms"
"""Label of controllers that were tuned on randomly drawn arms."""

Row = dict[str, Any]
Rows = dict[str, Row]


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.table`.

    Args:
        trained: folder of the runs.
        results: folder of the page and its JSON.
        figures: folder of the figures.
        episodes: number of episodes of a table, for a preview; default each family's own number.
        only: flexible_arm, two_link or measured; the rest of the page is kept unchanged.
        policies: names of the rows to be evaluated, separated by commas; the other rows are kept unchanged.
    """

    trained: Path = TRAINED
    results: Path = ROOT / "docs" / "results"
    figures: Path = ROOT / "docs" / "figures"
    episodes: int | None = None
    only: str | None = None
    policies: str | None = None


class Judge:
    """Evaluate policies by their names on the page; rows of policies that are not requested are kept."""

    def __init__(self, arguments: Arguments) -> None:
        self.arguments = arguments
        self._known: dict[str, tuple[Row, Any, dict[str, float]]] = {}
        self.asked = None if arguments.policies is None else arguments.policies.split(",")

    def anew(self, kept: Rows, family: Family, words: Mapping[str, str], most: int = 1000, **how: Any) -> Rows:
        """Return the summaries of the given policies.

        Policies named in `--policies` (without this flag, all) are evaluated; all others keep their rows in `kept`.
        """
        wanted = {name: word for name, word in words.items() if self.asked is None or name in self.asked}
        rows = kept | self.rows(family, wanted, most, **how)[0]
        return {name: rows[name] for name in words if name in rows}

    def rows(
        self, family: Family, words: Mapping[str, str], most: int = 1000, **how: Any
    ) -> tuple[Rows, Any, dict[str, float]]:
        """Evaluate policies; return their summaries, their episodes by name, and the time bounds.

        words: policies, name -> word for `flexarm evaluate --policy`. most: largest number of episodes.
        """
        count = min(self.arguments.episodes or family.test, most)
        rows: Rows = {}
        results: dict[str, Any] = {}
        bounds: dict[str, float] = {}
        for name, word in words.items():
            given = RECORDED | dict(how.get("env_kwargs", {}))
            asked = Judged(policy=word, env=family.env, episodes=count, **{**how, "env_kwargs": given})
            if str(asked) not in self._known:
                found, played, limits = evaluate(asked)
                ((row,), (one,)) = found.values(), played.values()
                self._known[str(asked)] = row, one, limits
                say(f"  {name}: success {row['success_rate']:.0%}, {row['settling_time_median']:.2f} s")
            rows[name], results[name], limits = self._known[str(asked)]
            bounds = bounds or limits
        return rows, results, bounds

    def best(self, family: Family) -> str:
        """Return the path of a family's best policy."""
        return os.path.relpath(family.best(self.arguments.trained))

    def words(self, family: Family, *others: Family) -> dict[str, str]:
        """Return the families' best policies and the controllers: name -> word for `flexarm evaluate --policy`."""
        policies = {f"PPO ({one.name})": self.best(one) for one in (family, *others)}
        return policies | {name: name for name in family.controllers}


def tuned(family: Family, folder: Path, *names: str, label: str) -> dict[str, str]:
    """Return controllers with the gains of a folder: name and label -> word for `flexarm evaluate --policy`."""
    file = os.path.relpath(folder / f"{family.task}.toml")
    return {f"{name}{label}": f"{name}@{file}" for name in names}


def curve_of(folder: Path) -> list[dict[str, float]]:
    """Read the learning curve of a run folder."""
    with (folder / "learning_curve.csv").open(encoding="utf-8") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def seeds(judge: Judge, family: Family) -> list[Row]:
    """Return, for each seed, data of the training and the result on the test episodes."""
    rows = []
    for folder in family.runs(judge.arguments.trained):
        record = read_run(folder)
        found, _, _ = judge.rows(family, {folder.name: os.path.relpath(folder)})
        rows.append({key: record[key] for key in ("seed", "steps", "wall_s", "cpu_s", "solved")} | found[folder.name])
    return rows


def seeds_table(rows: list[Row]) -> list[str]:
    """Format the result of `seeds` as a Markdown table."""
    cells = []
    for row in rows:
        solved = row["solved"]
        when = "never" if solved is None else f"{solved['wall_s']:.0f} ({solved['cpu_s']:.0f})"
        times = f"{row['wall_s']:.0f} ({row['cpu_s']:.0f})", when
        worth = f"{row['success_rate']:.1%}", f"{row['settling_time_median']:.2f}"
        cells.append((row["seed"], f"{row['steps']:.0f}", *times, *worth))
    heads = (
        "seed | steps | training time, s wall (CPU) | solved after, s wall (CPU) | success | median settling time, s"
    )
    return table(heads, cells, True)


def short_table(head: str, columns: Mapping[str, Rows]) -> list[str]:
    """Return a table of success and median settling time of policies (rows) in several settings (columns)."""

    def cell(row: Row | None) -> str:
        return "" if row is None else f"{row['success_rate']:.1%}, {row['settling_time_median']:.2f} s"

    names = dict.fromkeys(name for found in columns.values() for name in found)
    rows = [(name, *(cell(found.get(name)) for found in columns.values())) for name in names]
    return table(" | ".join([head, *columns]), rows, True)


def nominal(judge: Judge, family: Family, content: dict[str, Any]) -> None:
    """Evaluate one environment with nominal arms: return the rows of its tables and write its figures."""
    say(family.env)
    own = content[family.name]
    torque = families.named("two_link_torque")
    others = [torque] if family.name == "two_link" and torque.runs(judge.arguments.trained) else []
    words = judge.words(family, *others) | tuned(family, NO_MARGIN, "pd", "zv", label=", no margin")
    if judge.asked is not None:
        own["nominal"] = judge.anew(own["nominal"], family, words)
    else:
        own["nominal"], results, own["bounds"] = judge.rows(family, words)
        own["seeds"] = {one.name: seeds(judge, one) for one in (family, *others)}
        figures = judge.arguments.figures
        shown = {k: v for k, v in results.items() if "no margin" not in k}
        title = f"{family.env}, one episode under each controller"
        tip_errors(shown, 0, figures / f"control_{family.name}.png", title)
        curves = [curve_of(folder) for folder in family.runs(judge.arguments.trained)]
        title = f"{family.env}, {len(curves)} seeds"
        learning_curve(curves, figures / f"control_{family.name}_learning.png", title)


def decisions(judge: Judge, family: Family, content: dict[str, Any]) -> None:
    """Measure the CPU time of the controllers' decisions for one arm, ms: median, 99th percentile, maximum."""
    own = content[family.name].setdefault("decisions", {})
    for name in family.controllers:
        if judge.asked is not None and name not in judge.asked:
            continue
        env = fixed.make_episodes(family.env, 1, **RECORDED)
        controller = Timed(control.make(name, env), time.thread_time)
        play(env, controller, range(fixed.TEST, fixed.TEST + TIMED))
        env.close()
        times = 1e3 * np.array(controller.seconds)
        own[name] = dict(zip(("median", "p99", "most"), np.percentile(times, (50, 99, 100)).tolist(), strict=True))


def robustness(judge: Judge, family: Family, robust: Family, content: dict[str, Any]) -> None:
    """Evaluate policies on randomized arms, on the exact model, and under single changes of the arm."""
    say(f"{family.env}: other arms, other models")
    own, words, most = content[family.name], judge.words(family, robust), FEWER_EPISODES
    every = words | tuned(family, ROBUST, "pd", "zv", "zvd", "lqr", label=f" ({DRAWN})")
    own["ordinary"] = judge.anew(own.get("ordinary", own.get("nominal", {})), family, every)
    own["randomised"] = judge.anew(own.get("randomised", {}), family, every, randomized=True)
    if judge.asked is not None:
        save(judge.arguments, content)
    exact = {name: words[name] for name in list(words)[:1]}
    say("  exact model")
    before = own.get("models", {})
    own["models"] = {
        name: judge.anew(before.get(name, {}), family, exact, most, **how)
        for name, how in {
            "default model": {},
            "exact model": {"formulation": "geometrically_exact", "env_kwargs": EXACT},
        }.items()
    }
    fewer = {name: word for name, word in words.items() if name not in ("zv", "zvd", "time_optimal")}
    shifted = own.setdefault("shifted", {})
    for what, factors in SHIFTS.items():
        say(f"  {what}")
        how = {"env_kwargs": {"randomization": factors}}
        shifted[what] = judge.anew(shifted.get(what, {}), family, fewer, most, **how)
        if judge.asked is not None:
            save(judge.arguments, content)


def section(family: Family, own: Mapping[str, Any], best: Mapping[str, Any] | None) -> list[str]:
    """Format the section of one environment."""
    bounds = dict(own["bounds"])
    both = {"nominal arm": own.get("ordinary", own["nominal"]), "randomized arms": own["randomised"]}
    if best is not None:
        bounds["best known"] = float(np.median(best["settling"]))
    lines = [markdown(own["nominal"], bounds), ""]
    if best is not None:
        lines += distance(own["nominal"], best)
    if own.get("decisions"):
        times = [
            (name, *(f"{row[k]:.2f}" for k in ("median", "p99", "most"))) for name, row in own["decisions"].items()
        ]
        lines += [
            f"The table has the CPU time of one decision of each controller, for one arm on one thread, over "
            f"{TIMED} episodes:",
            "",
        ]
        lines += [*table("controller | median (ms) | 99th percentile (ms) | maximum (ms)", times, True), ""]
    for name, found in own["seeds"].items():
        lines += [f"Results of the training seeds of `{name}`:", "", *seeds_table(found), ""]
    return lines + [
        f"![tip error](../figures/control_{family.name}.png)", "",
        f"![learning curves](../figures/control_{family.name}_learning.png)", "",
        f"### {family.env}: randomized payload (x 0.5 to 2) and stiffness (x 0.7 to 1.3)", "",
        f"Controllers named `{DRAWN}` are tuned on randomized arms, and policies named `_robust` are trained on "
        "randomized arms. All other controllers and policies know only the nominal arm.", "",
        *short_table("success, median settling", both), "",
        f"In the first {FEWER_EPISODES} episodes the same policies were also evaluated on an arm that the converged "
        "exact beam simulates (4 cubic elements per link, steps of 1 ms):", "",
        *short_table("policy", own["models"]), "",
        "The same policies were evaluated on arms that differ from the nominal arm in one parameter:", "",
        *short_table("policy", own["shifted"]),
    ]  # fmt: skip


def distance(rows: Rows, best: Mapping[str, Any]) -> list[str]:
    """Return the ratios of the policies' settling times to those of the best known plans."""
    median, mean = float(np.median(best["settling"])), float(np.mean(best["settling"]))
    ratios = [
        (name, f"{row['settling_time_median'] / median:.2f}", f"{row['settling_time_mean'] / mean:.2f}")
        for name, row in rows.items()
    ]
    known = (
        "The table has the settling time of each policy, divided by that of the best known plans "
        f"([](optimal.md): median {median:.2f} s, mean {mean:.3f} s):"
    )
    return [known, "", *table("policy | ratio of medians | ratio of means", ratios, True), ""]


def best_known(results: Path, family: Family) -> dict[str, Any] | None:
    """Return the results of agents.best_known for a family's test episodes; None if some episodes are missing."""
    path = results / "optimal.json"
    lots = read_json(path)["lots"].get(family.task, {}) if path.exists() else {}
    found = joined(list(lots.values())) if lots else None
    return found if found is not None and len(found["settling"]) == family.test else None


def measured(judge: Judge, content: dict[str, Any]) -> None:
    """Evaluate controllers and trained policies on arms with gears, friction and measured observations."""
    before, found = content.get("measured", {}), {}
    for name, settings in SETTINGS.items():
        family, columns = families.named(name), {}
        for title, (given, trained) in settings.items():
            say(f"{family.env}: {title}")
            names = ("pd", "zv", "zvd", "lqg" if "observation" in given else "lqr")
            kept, rows = before.get(name, {}).get(title, {}), {}
            if trained is not None:
                words = {"PPO, trained there": judge.best(families.named(trained))}
                rows = judge.anew(kept, family, words, FEWER_EPISODES)
                rows = {one: {**row, "trained": trained} for one, row in rows.items()}
            words = {one: one for one in names}
            columns[title] = rows | judge.anew(kept, family, words, FEWER_EPISODES, env_kwargs=given)
        found[name] = columns
    content["measured"] = found


def blocks(content: Mapping[str, Any], best: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the blocks of each section of the page. best: results of `best_known`, by family."""
    lines = {"machine": [told(content["machine"])]}
    for name in (name for name in PARTS if name in content):
        if name == "measured":
            parts = [short_table(families.named(one).env, columns) for one, columns in content[name].items()]
            lines[name] = [line for part in parts for line in (*part, "")][:-1]
        else:
            lines[name] = section(families.named(name), content[name], best.get(name))
    return lines


PARTS = ("flexible_arm", "two_link", "measured")


def save(arguments: Arguments, content: dict[str, Any]) -> None:
    """Write the page and its numbers."""
    best = {name: best_known(arguments.results, families.named(name)) for name in ("flexible_arm", "two_link")}
    write_json(arguments.results / "control.json", content)
    write_page(arguments.results, "control", blocks(content, best))


def judge_all(arguments: Arguments) -> None:
    """Evaluate the requested families; write the page and its numbers."""
    path, only = arguments.results / "control.json", arguments.only
    if only is not None and only not in PARTS:
        raise ValueError(f"--only {only}: must be one of {', '.join(PARTS)}")
    if arguments.policies is not None and not path.exists():
        raise ValueError(f"--policies: {path} is not there; judge all of them first")
    part = only is not None or arguments.policies is not None
    content: dict[str, Any] = read_json(path) if part and path.exists() else {}
    content = {k: v for k, v in content.items() if k in PARTS}
    content["machine"] = {"date": date.today().isoformat(), "cores": str(os.cpu_count()), **versions()}
    judge = Judge(arguments)
    for name in PARTS if only is None else [only]:
        if name == "measured":
            measured(judge, content)
            continue
        family = families.named(name)
        content.setdefault(name, {})
        nominal(judge, family, content)
        decisions(judge, family, content)
        robustness(judge, family, families.named(f"{name}_robust"), content)
        save(arguments, content)
    save(arguments, content)


main = partial(command, Arguments, "python -m agents.table", __doc__, judge_all)

if __name__ == "__main__":
    sys.exit(main())
