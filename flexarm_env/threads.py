"""A crew of threads for compiled functions that let go of the interpreter; made on first use, anew after a fork."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from .kernels.spin import await_change

ROUNDS = 100_000
"""Looks at the other side before going to sleep, about a nanosecond each: a short while, since waking up takes long."""

DELAY = 2_000
"""Looks that the other side is left to let go of the interpreter's lock."""

GO, DONE = range(2)
"""Entries of a worker's board: tasks given, tasks done."""


class _Worker:
    """One thread that runs a function when told to. Two bare locks hand over in either direction.

    Before it waits for a lock, each side looks for a while at a count that the other raises before the lock's release.
    """

    def __init__(self) -> None:
        self._board = np.zeros(16, np.int64)  # two counts, on a cache line of their own
        await_change(self._board, GO, 1, 1, -1, 0, 0)  # compiled (or loaded) here and not in the thread
        self._go, self._done = threading.Lock(), threading.Lock()
        self._go.acquire()
        self._done.acquire()
        self._task: tuple[Callable[..., Any], tuple[Any, ...]] | None = None
        self._result: Any = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="flexarm", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        board, count = self._board, 0
        while True:
            await_change(board, GO, count, ROUNDS, DONE, count, DELAY)
            self._go.acquire()
            count += 1
            if self._task is None:
                return
            function, arguments = self._task
            try:
                self._result, self._error = function(*arguments), None
            except BaseException as error:
                self._error = error
            self._done.release()

    def start(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self._task = (function, arguments)
        self._board[GO] += 1
        self._go.release()

    def wait(self) -> None:
        await_change(self._board, DONE, self._board[GO] - 1, ROUNDS, -1, 0, 0)
        self._done.acquire()

    def result(self) -> Any:
        self.wait()
        if self._error is not None:
            raise self._error
        return self._result

    def stop(self) -> None:
        self._task = None
        self._go.release()


class Crew:
    """Runs calls on the calling thread and `size` others. Only one thread may use a crew at a time."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers: list[_Worker] = []
        self._process = os.getpid()

    def run(self, function: Callable[..., Any], calls: list[tuple[Any, ...]]) -> list[Any]:
        """Results of function(*call) for each call, the first on the calling thread; at most size + 1 calls."""
        if self._process != os.getpid():  # a forked child has the objects, but not the threads
            self._workers, self._process = [], os.getpid()
        while len(self._workers) < len(calls) - 1:
            self._workers.append(_Worker())
        busy = self._workers[: len(calls) - 1]
        for worker, call in zip(busy, calls[1:], strict=True):
            worker.start(function, call)
        try:
            results = [function(*calls[0])]
            while busy:
                results.append(busy[0].result())
                busy = busy[1:]
        finally:  # Ctrl-C, say: what the threads still hand over is not to be taken for a later result
            for worker in busy:
                worker.wait()
        return results

    def close(self, process: Callable[[], int] = os.getpid) -> None:
        """End the threads. (The function is bound early: at the interpreter's end the module may be gone.)"""
        if self._process == process():
            for worker in self._workers:
                worker.stop()
        self._workers = []

    def __del__(self) -> None:
        self.close()


def chunks(groups: int, parts: int) -> list[tuple[int, int]]:
    """Groups divided into `parts` runs of nearly equal length."""
    edges = [groups * k // parts for k in range(parts + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]
