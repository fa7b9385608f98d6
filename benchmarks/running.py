"""Many cases, one after the other or on several cores: progress on a terminal, results kept so that a run can go on."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Progress:
    """A line on a terminal that says how far things are; elsewhere a line a minute."""

    def __init__(self, label: str, total: int) -> None:
        self.label, self.total, self.done = label, total, 0
        self.start = self.last = time.monotonic()

    def step(self) -> None:
        """One more is done."""
        self.done += 1
        now, terminal = time.monotonic(), sys.stderr.isatty()
        if now - self.last < (0.2 if terminal else 60.0) and self.done < self.total:
            return
        self.last = now
        left = (now - self.start) / self.done * (self.total - self.done)
        text = f"{self.label}: {self.done} of {self.total}, {now - self.start:.0f} s, {left:.0f} s left"
        sys.stderr.write(f"\r{text}  " if terminal else f"{text}\n")
        if terminal and self.done == self.total:
            sys.stderr.write("\n")
        sys.stderr.flush()


def key_of(case: Row) -> str:
    """A case as one line of text."""
    return json.dumps(case, sort_keys=True)


def kept(path: Path) -> dict[str, Row]:
    """Results of an earlier run by their case's key; a line cut short is left out."""
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
    """Rows {"case": ..., **measure(case)} in the order of the cases; those in `store` are not run again.

    Kernels that the parent has compiled are inherited by the workers, which are forked.
    """
    if fresh:
        store.unlink(missing_ok=True)
    store.parent.mkdir(parents=True, exist_ok=True)
    rows = kept(store)
    left = [case for case in cases if key_of(case) not in rows]
    progress = Progress(label, max(1, len(left)))

    def note(row: Row) -> None:
        rows[key_of(row["case"])] = row
        with store.open("a") as file:
            file.write(json.dumps(row) + "\n")
        progress.step()

    if workers > 1 and hasattr(os, "fork") and left:
        with multiprocessing.get_context("fork").Pool(workers) as pool:
            for row in pool.imap_unordered(_Measure(measure), left, chunksize=4):
                note(row)
    else:
        for case in left:
            note({"case": case, **measure(case)})
    return [rows[key_of(case)] for case in cases]


class _Measure:
    """`measure` with its case put into the row."""

    def __init__(self, measure: Callable[[Row], Row]) -> None:
        self.measure = measure

    def __call__(self, case: Row) -> Row:
        return {"case": case, **self.measure(case)}
