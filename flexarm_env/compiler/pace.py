"""Choose the number of threads for the steps of a batch by timing, up to the number of available processors.

The speedup by a second thread depends on the arms, on the processor, on other processes and on the caller's work
between steps. The durations of a few steps with one and with several threads are therefore measured from time to time.
Results are bitwise the same for any number of threads.
"""

import math
import os
import time
from collections.abc import Callable
from pathlib import Path

from .crew import Crew

ARMS_PER_THREAD = 128
"""Number of arms per thread in derivatives. Derivatives use a second thread from twice this number of arms on."""
SAMPLES = 5
"""Number of steps of a timing trial, whose result is the median duration of a step."""
WORK = 30e-6
"""Least duration of a thread's part of a step, s. Waking a thread takes about as long."""
WORTH = 0.75
"""Least parallel efficiency (speedup divided by the number of threads) for the use of several threads. A lower
efficiency means that other processes need the processors, or that waking a thread takes longer than the thread's part
of a step.
"""
RARELY, SELDOM = 50.0, 800.0
"""Least and largest time between timing trials, as multiples of the duration of a trial."""


def processors() -> int:
    """Return the number of processors that this process may use by its CPU affinity and its control groups' quota."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, int(min(usable, quota())))


def default_threads(n: int) -> int:
    """Return the number of threads for derivatives of n arms: one per ARMS_PER_THREAD, at most `processors`."""
    return max(1, min(processors(), n // ARMS_PER_THREAD))


def quota(root: Path = Path("/")) -> float:
    """Return the number of processors that the process's control groups (version 1 or 2) allow; infinite without limit.

    root: the root folder of the file system; tests set another folder.
    """
    found = math.inf
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        # not Linux
        return found
    for line in lines:
        controllers, _, path = line.partition(":")[2].partition(":")
        if controllers and "cpu" not in controllers.split(","):
            continue
        # mount points of version 2 (no controllers), then of version 1
        for name in ("", "unified") if not controllers else ("cpu", controllers, "cpu,cpuacct"):
            base = root / "sys/fs/cgroup" / name
            place = base / path.lstrip("/")
            # from the group up to its root: a group's limit holds for the groups in it
            while True:
                found = min(found, _limit(place))
                if place == base or base not in place.parents:
                    break
                place = place.parent
    return found


def _limit(group: Path) -> float:
    """Return the CPU quota of one control group in processors, quota / period; infinite without a limit."""
    # version 2: one file with both numbers; version 1: two files
    for files in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        try:
            limit, period, *_ = " ".join((group / file).read_text() for file in files).split()
            if limit not in ("max", "-1") and float(period) > 0.0:
                return float(limit) / float(period)
        except (OSError, ValueError):
            continue
    return math.inf


class Pace:
    """Chooses the number of threads for the next step (`threads`) from the durations of earlier steps.

    Args:
        most: largest number of threads.
    """

    def __init__(self, most: int) -> None:
        """Begin with a trial step on one thread."""
        self.most, self.threads = most, 1
        self._chosen, self._alone = 1, math.inf
        self._times: list[float] = []
        self._spent, self._wait, self._pause = 0.0, -1.0, RARELY

    def took(self, seconds: float) -> None:
        """Record the duration (s) of a step that ran with `threads` threads, and choose the number for the next step.

        A trial measures the duration of SAMPLES steps with one thread. From the median duration the trial estimates a
        number of threads and times steps with this number, then with half of this number, and so on, until the speedup
        per thread is at least WORTH.
        """
        # between trials: count down, then begin with one thread
        if self._wait > 0.0:
            self._wait -= seconds
            if self._wait <= 0.0:
                self.threads, self._spent = 1, 0.0
                self._times.clear()
            return
        self._times.append(seconds)
        # the first time is discarded: it includes waking threads, or compiling
        if len(self._times) <= SAMPLES:
            return
        # duration of the trial, with the discarded step estimated by the mean
        self._spent += sum(self._times[1:]) * (1.0 + 1.0 / SAMPLES)
        median = sorted(self._times[1:])[SAMPLES // 2]
        self._times.clear()
        # one thread is the reference; every thread needs WORK seconds of it
        if self.threads == 1:
            self._alone = median
            wanted = min(self.most, int(median / WORK))
        elif median * WORTH * self.threads <= self._alone:
            self._choose(self.threads)
            return
        else:
            wanted = self.threads // 2
        if wanted > 1:
            self.threads = wanted
        else:
            self._choose(1)

    def _choose(self, threads: int) -> None:
        """Use the chosen number of threads until the next trial.

        The pause until the next trial doubles, up to SELDOM, each time that a trial confirms the number of threads. The
        pause returns to RARELY when the number changes.
        """
        self._pause = min(2.0 * self._pause, SELDOM) if threads == self._chosen else RARELY
        self.threads = self._chosen = threads
        self._wait = self._pause * self._spent


class Team:
    """Runs the steps of a batch on its threads.

    Args:
        groups: number of groups of arms, the units of work. threads: largest number of threads, or None to let a `Pace`
            choose the number.
    Attributes:
        most: largest number of threads.
    """

    def __init__(self, groups: int, threads: int | None) -> None:
        """Set the number of threads; they are started by the first step that needs them."""
        self.most = max(1, min(processors() if threads is None else threads, groups))
        self.pace = Pace(self.most) if threads is None else None
        self._crew = Crew(self.most - 1)

    def run(self, step: Callable[..., int], function: int, address: int, groups: int) -> int:
        """Step all groups by calls of step(address, first, last) on the threads; return the sum of the calls' results.

        step: compiled function that advances groups first ... last - 1.
        function: address of the machine code of `step`, which the threads call.
        address: address of the program data.
        groups: number of groups.
        """
        if self.pace is None:
            return self._crew.run(function, address, groups)
        threads, began = self.pace.threads, time.perf_counter()
        if threads == 1:
            count = step(address, 0, groups)
        else:
            # the calling thread works too
            if self._crew.size != threads - 1:
                self._crew.close()
                self._crew = Crew(threads - 1)
            count = self._crew.run(function, address, groups)
        self.pace.took(time.perf_counter() - began)
        return count

    def close(self) -> None:
        """Stop the worker threads."""
        self._crew.close()
