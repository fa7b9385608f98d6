"""Check that the suite's rewards agree with its criteria of success: returns and successes of all methods, compared.

    python -m benchmarks.suite_agreement [--results docs/results/suite]

The script considers all pairs of runs on the same episode of a task of which one succeeded and the other did not. The
script counts how often the successful run has the higher return (minus the task's price times cost). A pair with equal
returns counts against the agreement. Each task in its latest version must have at least 30 pairs, of which at least 95
% agree.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.machine import DOCS, table
from benchmarks.pages import write_page
from flexarm_env import suite
from flexarm_env.suite.results import Results, folder_of, of_task, values

LEAST, PAIRS = 0.95, 30


def agreement(task: suite.Task, found: Sequence[Results]) -> tuple[int, int]:
    """Count pairs of a successful and a failed run on the same episode, and those in which success has the higher
    value."""
    entries = [entry for _, entry in of_task(task, found)]
    pairs = right = 0
    found_values = np.array([values(task, entry) for entry in entries])
    successes = np.array([e["successes"] for e in entries], bool)
    for value, success in zip(found_values.T, successes.T, strict=True):
        pairs += int(success.sum() * (~success).sum())
        right += int((value[success][:, None] > value[~success]).sum())
    return pairs, right


def rows(found: Sequence[Results]) -> list[tuple[str, int, str, str]]:
    """Return one row per task: id, number of pairs, share that agrees, and whether this is sufficient."""
    lines = []
    for task in suite.tasks(earlier=True):
        pairs, right = agreement(task, found)
        share = right / pairs if pairs else 0.0
        enough = "yes" if share >= LEAST and pairs >= PAIRS else "**no**"
        latest = task in suite.tasks()
        lines.append((f"`{task.id}`", pairs, f"{share:.1%}" if pairs else "", enough if latest else "superseded"))
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; write it into its page if the results are the project's. The exit code is 1 if a task fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=DOCS / "results" / "suite", help="folder of results files")
    options = parser.parse_args(arguments)
    found = rows(folder_of(options.results, earlier=True))
    for name, pairs, share, enough in found:
        print(f"{name.strip('`'):20} {pairs:6} pairs {share:>7}  {enough.strip('*')}")
    if options.results == DOCS / "results" / "suite":
        lines = table("task | pairs | successful run has the higher return | at least 95 % of at least 30 pairs", found)
        write_page(DOCS / "results", "suite_agreement", {"pairs": lines})
    return int(any(enough == "**no**" for *_, enough in found))


if __name__ == "__main__":
    raise SystemExit(main())
