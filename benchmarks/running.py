"""Run many cases, one after the other or on several cores, with progress and with results that allow continuation."""

import contextlib
import functools
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]

STORE = Path(__file__).parents[1] / "runs" / "benchmarks"
"""Folder of intermediate results."""


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def key_of(case: Row) -> str:
    """Return a case as one line of JSON."""
    return json.dumps(case, sort_keys=True)


def kept(path: Path) -> dict[str, Row]:
    """Return the results of an earlier run by the key of their case; truncated lines are ignored."""
    rows = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[key_of(row["case"])] = row
    return rows


def run_all(
    label: str, cases: Sequence[Row], measure: Callable[[Row], Row], store: Path, workers: int = 1, fresh: bool = False
) -> list[Row]:
    """Run the cases; return rows {"case": ..., **measure(case)} in their order. Cases in `store` are not run again.

    The worker processes are forked and therefore inherit the kernels that the parent process has compiled.
    """
    from tqdm import tqdm

    if fresh:
        store.unlink(missing_ok=True)
    store.parent.mkdir(parents=True, exist_ok=True)
    rows = kept(store)
    left = [case for case in cases if key_of(case) not in rows]
    each = functools.partial(_measured, measure)
    with contextlib.ExitStack() as stack:
        found: Iterator[Row] = map(each, left)
        if workers > 1 and hasattr(os, "fork") and left:
            pool = stack.enter_context(multiprocessing.get_context("fork").Pool(workers))
            found = pool.imap_unordered(each, left, chunksize=4)
        pause = 0.2 if sys.stderr.isatty() else 60.0
        for row in tqdm(found, label, len(left), mininterval=pause, maxinterval=2.0 * pause):
            rows[key_of(row["case"])] = row
            with store.open("a") as file:
                file.write(json.dumps(row) + "\n")
    return [rows[key_of(case)] for case in cases]


def periods(env: Any, count: int, clock: Callable[[], float], keep_on: bool = False) -> float:
    """Return the time, s, that `count` control periods of an environment take under prepared random actions.

    clock: function that returns the time, s. keep_on: reset a single environment when its episode ends; the time of
    resets is included.
    """
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]
    env.reset(seed=0)
    begun = clock()
    for k in range(count):
        _, _, terminated, truncated, _ = env.step(actions[k % 64])
        if keep_on and (terminated or truncated):
            env.reset()
    return clock() - begun


def _measured(measure: Callable[[Row], Row], case: Row) -> Row:
    """Return the row of `measure` with its case."""
    return {"case": case, **measure(case)}
