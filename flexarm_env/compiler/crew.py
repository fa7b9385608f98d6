"""A crew of threads for one compiled function; made on first use, anew after a fork.

The threads share work without Python: no lock, no interpreter, unless one side has gone to sleep.

Waking a thread takes the system longer than a small batch's step, and a thread that comes back to the interpreter must
wait for its lock. So a worker stays in compiled code and looks for its next task for a while, the caller likewise for
the end of it. Who has looked in vain says so on the board and goes back to Python, to sleep at a lock; the other side
then reads it there, and has the lock opened. Each begins at its own part of a task and takes half of what is left of
it; who is done takes from the ends of the others' parts, so that nobody waits for a thread that the system has not let
run. All of it by compare and swap: of two sides one gets it.
"""

import functools
import os
import threading
from collections.abc import Callable
from sys import getrefcount
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from .arithmetic import whole
from .decorator import kernel
from .entry import FAILED
from .kinds import WORD, Integer, Truth
from .words import WORDS

BOARD = 64
"""int64 numbers of a board: one for each worker, and the last for the caller."""

TASK, PART = 8, 16
"""Number of the task that a worker is to help with (OVER: to end); what is left of its part: task, next group, end."""
DONE, STATE = 24, 40
"""Number of the task that a worker has helped with; whether the board's owner sleeps, see below."""
FUNCTION, ADDRESS, GROUPS, FINISHED, SUM, RAISED = 0, 1, 2, 48, 49, 50
"""On the caller's board: the task; groups done, the sum of what it returned, whether it has raised an error."""
OVER = -1
AWAKE, ASLEEP, CALLED = range(3)

SLEEP, WAKE, END = range(3)
"""Why `serve` returns: no task came; the caller sleeps and the task is done; the worker is to end."""

CALL, WAIT = -2, -3
"""What `lead` returns below FAILED (a task raised an error): workers noted as CALLED are to be woken, then go on at
RUN; sleep until the task is done, then go on at LOOK."""

GIVE, RUN, LOOK = range(3)
"""Where `lead` begins."""

TASKS = 2**20
"""Numbers of tasks: 1 ... TASKS, then from 1 again."""

_BITS = 21
_MASK = 2**_BITS - 1


def _fresh(board: Any, k: int) -> int:
    """board[k], read from memory each time, and what was written before it."""
    return int(board[k])


def _publish(board: Any, k: int, value: int) -> None:
    """board[k] = value, for another thread to see after all that was written before."""
    board[k] = value


def _swapped(board: Any, k: int, old: int, new: int) -> bool:
    """Whether board[k] was `old`; it then is `new`."""
    raise NotImplementedError("threads share work in compiled code alone")


def _added(board: Any, k: int, value: int) -> int:
    """board[k] + value, which board[k] then is."""
    board[k] += value
    return int(board[k])


def _called(function: int, address: int, first: int, last: int) -> int:
    """What the compiled function of three whole numbers at `function` (see `entry.native`) returns."""
    raise NotImplementedError("threads share work in compiled code alone")


def _at(e: Any, board: Any, k: Any) -> Any:
    return e.b.gep(board.data, [whole(e.b, k)], inbounds=True)


def _on_address(e: Any, function: Any, *words: Any) -> Integer:
    kind = ir.FunctionType(WORD, [WORD] * 3)
    place = e.b.inttoptr(whole(e.b, function), kind.as_pointer())
    return Integer(e.b.call(place, [whole(e.b, word) for word in words]))


def _exchange(e: Any, board: Any, k: Any, old: Any, new: Any) -> Truth:
    found = e.b.cmpxchg(_at(e, board, k), whole(e.b, old), whole(e.b, new), "seq_cst", "seq_cst")
    return Truth(e.b.extract_value(found, 1))


def _sum(e: Any, board: Any, k: Any, value: Any) -> Integer:
    more = whole(e.b, value)
    return Integer(e.b.add(e.b.atomic_rmw("add", _at(e, board, k), more, "seq_cst"), more))


def _write(e: Any, board: Any, k: Any, value: Any) -> None:
    e.b.store_atomic(whole(e.b, value), _at(e, board, k), "seq_cst", 8)


WORDS.update({
    _fresh: lambda e, board, k: Integer(e.b.load_atomic(_at(e, board, k), "seq_cst", 8)),
    _publish: _write,
    _swapped: _exchange,
    _added: _sum,
    _called: _on_address,
})  # fmt: skip


@kernel
def _share(boards, me, task):
    """Do one's own part of a task, then what is left of the others'; whether the task's last group was among it."""
    members, last_one = boards.shape[0] // BOARD, False
    head = (members - 1) * BOARD
    for j in range(members):
        at = (me + j) % members * BOARD + PART
        while True:
            word = _fresh(boards, at)
            first, last = (word >> _BITS) & _MASK, word & _MASK
            if word >> 2 * _BITS != task or first >= last:
                break
            count = (last - first + 1) // 2
            begin = first if j == 0 else last - count
            if _swapped(boards, at, word, word + (count << _BITS) if j == 0 else word - count):
                result = _called(boards[head + FUNCTION], boards[head + ADDRESS], begin, begin + count)
                if result < 0:
                    _publish(boards, head + RAISED, 1)
                _added(boards, head + SUM, result)
                last_one = _added(boards, head + FINISHED, count) == boards[head + GROUPS]
    return last_one


@kernel
def serve(boards, k, rounds):
    """Help with tasks as they come, as worker k, until none has for `rounds` looks or Python has something to do."""
    at, head = k * BOARD, boards.shape[0] - BOARD
    while True:
        seen, looks = boards[at + DONE], 0
        task = _fresh(boards, at + TASK)
        while task == seen:
            looks += 1
            if looks >= rounds:
                _publish(boards, at + STATE, ASLEEP)
                if _fresh(boards, at + TASK) == seen or not _swapped(boards, at + STATE, ASLEEP, AWAKE):
                    return SLEEP
            task = _fresh(boards, at + TASK)
        if task == OVER:
            return END
        last_one = _share(boards, k, task)
        boards[at + DONE] = task
        if last_one:
            if _swapped(boards, head + STATE, ASLEEP, CALLED):
                return WAKE


@kernel
def lead(boards, task, function, address, groups, rounds, stage):
    """Sum of function(address, first, last) over parts of range(groups), with the workers' help; task: its number.

    Below zero: something is to be done in Python first (see above). boards: BOARD numbers a worker, and as many more.
    """
    workers = boards.shape[0] // BOARD - 1
    head = workers * BOARD
    if stage == GIVE:
        boards[head + FUNCTION], boards[head + ADDRESS], boards[head + GROUPS] = function, address, groups
        boards[head + SUM], boards[head + RAISED], asleep = 0, 0, 0
        _publish(boards, head + FINISHED, 0)
        for k in range(workers + 1):
            first, last = groups * k // (workers + 1), groups * (k + 1) // (workers + 1)
            _publish(boards, k * BOARD + PART, (task << 2 * _BITS) + (first << _BITS) + last)
        for k in range(workers):
            _publish(boards, k * BOARD + TASK, task)
            if _swapped(boards, k * BOARD + STATE, ASLEEP, CALLED):
                asleep += 1
        if asleep > 0:
            return CALL
    if stage != LOOK:
        _share(boards, workers, task)
    looks = 0
    while _fresh(boards, head + FINISHED) != groups:
        looks += 1
        if looks >= rounds:
            _publish(boards, head + STATE, ASLEEP)
            if _fresh(boards, head + FINISHED) != groups or not _swapped(boards, head + STATE, ASLEEP, AWAKE):
                return WAIT
    return FAILED if boards[head + RAISED] else boards[head + SUM]


F = TypeVar("F", bound=Callable[..., Any])

ROUNDS = 1_000_000
"""Looks at the other side before going to sleep: a quarter of a millisecond, more than Python needs between steps."""


class _Worker:
    """One thread, at board k. A bare lock is what it sleeps at."""

    def __init__(self, boards: NDArray[np.int64], k: int, done: Callable[[], None]) -> None:
        self._board, self._rounds, self._call_back = boards[k * BOARD : (k + 1) * BOARD], ROUNDS, done
        self._go = threading.Lock()
        self._go.acquire()
        self.thread = threading.Thread(target=self._work, args=(boards, k), name="flexarm", daemon=True)
        self.thread.start()

    def _work(self, boards: NDArray[np.int64], k: int) -> None:
        while (why := serve(boards, k, self._rounds)) != END:
            if why == WAKE:
                self._call_back()
            else:
                self._go.acquire()
                self._board[STATE] = AWAKE

    def wake(self) -> None:
        """Open the lock at which the worker sleeps, or is about to, if it has been called."""
        if self._board[STATE] == CALLED and self._go.locked():
            self._go.release()

    def stop(self) -> None:
        """Tell the thread to end after the task it is at."""
        self._board[TASK] = OVER
        if self._go.locked():
            self._go.release()


class Crew:
    """Runs a compiled function of (address, first, last) on the calling thread and `size` others.

    Only one thread may use a crew at a time. function: where its machine code begins, see `compiler.entry.native`.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy, self._task = False, 0
        self._boards, self._done = np.zeros((size + 1) * BOARD, np.int64), threading.Lock()

    def run(self, function: int, address: int, groups: int) -> int:
        """Sum of function(address, first, last) over parts of range(groups)."""
        if self._process != os.getpid():  # a forked child has the objects, but not the threads
            self._workers, self._process, self._busy = [], os.getpid(), False
        if self._busy:  # a run was interrupted, and so was its tidying up
            self._end()
        if not self._workers:
            self._begin()
        self._busy, self._task = True, self._task % TASKS + 1
        given = self._boards, self._task, function, int(address), groups, ROUNDS
        try:
            result = lead(*given, GIVE)
            while result < FAILED:
                if result == CALL:
                    for worker in self._workers:
                        worker.wake()
                    result = lead(*given, RUN)
                else:
                    self._done.acquire()
                    self._boards[STATE - BOARD] = AWAKE
                    result = lead(*given, LOOK)
        except BaseException:  # Ctrl-C, say: no thread may go on writing into the caller's arrays
            self._end()
            raise
        self._busy = False
        if result == FAILED:
            raise RuntimeError("A compiled step raised an error")
        return int(result)

    def _begin(self) -> None:
        """Threads, new boards and a lock that the caller sleeps at; threads of before may still hold the old ones."""
        self._boards, self._done = np.zeros_like(self._boards), threading.Lock()
        self._boards[TASK] = OVER
        serve(self._boards, 0, 1)  # compiled (or loaded) here and not in a thread
        self._boards[TASK] = 0
        self._done.acquire()
        self._workers = [_Worker(self._boards, k, self._done.release) for k in range(self.size)]

    def _end(self) -> None:
        """End the threads and wait until they have."""
        for worker in self._workers:
            worker.stop()
        for worker in self._workers:
            worker.thread.join()
        self._workers, self._busy = [], False

    def close(self, process: Callable[[], int] = os.getpid) -> None:
        """End the threads. (The function is bound early: at the interpreter's end the module may be gone.)"""
        if getattr(self, "_process", None) == process():  # it has none where it was never made
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
