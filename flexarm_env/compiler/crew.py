"""A crew of threads for one compiled function; made on first use, anew after a fork."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from sys import getrefcount
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import spin

F = TypeVar("F", bound=Callable[..., Any])

ROUNDS = 1_000_000
"""Looks at the other side before going to sleep: a quarter of a millisecond, more than Python needs between steps."""


class _Worker:
    """One thread, at board k. A bare lock is what it sleeps at."""

    def __init__(self, boards: NDArray[np.int64], k: int, done: Callable[[], None]) -> None:
        self._board, self._rounds, self._call_back = boards[k * spin.BOARD : (k + 1) * spin.BOARD], ROUNDS, done
        self._go = threading.Lock()
        self._go.acquire()
        self._thread = threading.Thread(target=self._work, args=(boards, k), name="flexarm", daemon=True)
        self._thread.start()

    def _work(self, boards: NDArray[np.int64], k: int) -> None:
        while (why := spin.serve(boards, k, self._rounds)) != spin.END:
            if why == spin.WAKE:
                self._call_back()
            else:
                self._go.acquire()
                self._board[spin.STATE] = spin.AWAKE

    def wake(self) -> None:
        """Open the lock at which the worker sleeps, or is about to, if it has been called."""
        if self._board[spin.STATE] == spin.CALLED and self._go.locked():
            self._go.release()

    def stop(self) -> None:
        """Tell the thread to end after the task it is at."""
        self._board[spin.TASK] = spin.OVER
        if self._go.locked():
            self._go.release()

    def join(self) -> None:
        self._thread.join()


class Crew:
    """Runs a compiled function of (address, first, last) on the calling thread and `size` others.

    Only one thread may use a crew at a time. function: where its machine code begins, see `compiler.entry.native`.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy, self._task = False, 0
        self._boards, self._done = np.zeros((size + 1) * spin.BOARD, np.int64), threading.Lock()

    def run(self, function: int, address: int, groups: int) -> int:
        """Sum of function(address, first, last) over parts of range(groups)."""
        if self._process != os.getpid():  # a forked child has the objects, but not the threads
            self._workers, self._process, self._busy = [], os.getpid(), False
        if self._busy:  # a run was interrupted, and so was its tidying up
            self._end()
        if not self._workers:
            self._begin()
        self._busy, self._task = True, self._task % spin.TASKS + 1
        given = self._boards, self._task, function, address, groups, ROUNDS
        try:
            result = spin.lead(*given, spin.GIVE)
            while result < spin.FAILED:
                if result == spin.CALL:
                    for worker in self._workers:
                        worker.wake()
                    result = spin.lead(*given, spin.RUN)
                else:
                    self._done.acquire()
                    self._boards[spin.STATE - spin.BOARD] = spin.AWAKE
                    result = spin.lead(*given, spin.LOOK)
        except BaseException:  # Ctrl-C, say: no thread may go on writing into the caller's arrays
            self._end()
            raise
        self._busy = False
        if result == spin.FAILED:
            raise RuntimeError("A compiled step raised an error")
        return int(result)

    def _begin(self) -> None:
        """Threads, new boards and a lock that the caller sleeps at; threads of before may still hold the old ones."""
        self._boards, self._done = np.zeros_like(self._boards), threading.Lock()
        self._boards[spin.TASK] = spin.OVER
        spin.serve(self._boards, 0, 1)  # compiled (or loaded) here and not in a thread
        self._boards[spin.TASK] = 0
        self._done.acquire()
        self._workers = [_Worker(self._boards, k, self._done.release) for k in range(self.size)]

    def _end(self) -> None:
        """End the threads and wait until they have."""
        for worker in self._workers:
            worker.stop()
        for worker in self._workers:
            worker.join()
        self._workers, self._busy = [], False

    def close(self, process: Callable[[], int] = os.getpid) -> None:
        """End the threads. (The function is bound early: at the interpreter's end the module may be gone.)"""
        if self._process == process():
            for worker in self._workers:
                worker.stop()
        self._workers = []

    def __del__(self) -> None:
        self.close()


class OneAtATime:
    """A door (`with door:`) for one thread at a time: who comes while another is inside gets a RuntimeError.

    An exception and no lock: two threads that take turns would each see half of the other's steps.
    """

    def __init__(self) -> None:
        self._inside: dict[str, int] = {}

    def __enter__(self) -> None:
        me = threading.get_ident()
        if self._inside.setdefault("thread", me) != me:  # one operation, so that of two threads one gets in
            raise RuntimeError(
                "another thread is at work in this environment: one environment serves one thread at a time; make one "
                "for each thread, or take turns with a threading.Lock around step and reset"
            )

    def __exit__(self, *_: object) -> None:
        self._inside.clear()


def one_at_a_time(method: F) -> F:
    """The method of an object with a door `_door`, gone through by one thread at a time."""

    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        with self._door:
            return method(self, *args, **kwargs)

    return guarded  # type: ignore[return-value]


def holders(things: list[Any], k: int) -> int:
    """How many references there are to things[k], this function's own included."""
    return getrefcount(things[k])
