"""Worker threads that share the groups of a batch in compiled code, by atomic operations and without Python's GIL.

Waking a thread takes longer than a step of a small batch, and a thread that returns to the interpreter waits for the
GIL. For some time after a task, a worker therefore stays in compiled code and polls its board for the next task. The
caller polls its own board for the end of the task. A thread that has found no task for some time marks itself ASLEEP on
its board, returns to Python and blocks on a lock. Another thread that needs a sleeping thread marks it as CALLED, and
Python then releases its lock. Work is distributed by stealing: idle threads take work from busy threads. Each thread
begins with its own part of a task's groups and takes half of the groups that are left at a time. A thread without work
takes groups from the ends of other threads' parts, so that no thread waits for a thread that the system does not
schedule. Parts are taken by compare-and-swap: if two threads try, one succeeds. Threads are created at first use, and
again after a fork.
"""

import atexit
import functools
import os
import threading
import weakref
from collections.abc import Callable
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
"""Number of int64 entries of one board. Each worker thread has a board, and the last board is the calling thread's."""

TASK, PART = 8, 16
"""Offsets on a board. TASK: number of the task to help with (OVER: end the thread). PART: the owner's groups that no
thread has taken yet, packed as task number, next group and end of the groups (21 bits for each group number).
"""
DONE, STATE = 24, 40
"""Offsets on a worker's board. DONE: number of the last task that the worker has helped with. STATE: AWAKE, ASLEEP or
CALLED.
"""
FUNCTION, ADDRESS, GROUPS, FINISHED, SUM, RAISED = 0, 1, 2, 48, 49, 50
"""Offsets on the calling thread's board. FUNCTION: address of the compiled function. ADDRESS: argument of the function.
GROUPS: number of groups of the task. FINISHED: number of groups done. SUM: sum of the values that the function
returned. RAISED: 1 if a call has returned a negative number.
"""
OVER = -1
AWAKE, ASLEEP, CALLED = range(3)

SLEEP, WAKE, END = range(3)
"""Results of `serve`. SLEEP: block, since no task was published. WAKE: wake the caller, since the task is done. END:
end the thread.
"""

CALL, WAIT = -2, -3
"""Results of `lead`. FAILED: a call of the task's function returned a negative number. CALL: wake the workers marked
CALLED, then call `lead` again with stage RUN. WAIT: block until the task is done, then call `lead` again with stage
LOOK.
"""

GIVE, RUN, LOOK = range(3)
"""Stages of `lead`. GIVE: publish the task. RUN: compute the caller's own part of the groups. LOOK: wait until all
groups are computed.
"""

TASKS = 2**20
"""Task numbers run from 1 to TASKS, then from 1 again."""

_BITS = 21
_MASK = 2**_BITS - 1


def _fresh(board: Any, k: int) -> int:
    """Load board[k] atomically, sequentially consistent: all earlier writes of other threads are visible."""
    return int(board[k])


def _publish(board: Any, k: int, value: int) -> None:
    """Store board[k] = value atomically, visible to other threads after all earlier writes."""
    board[k] = value


def _swapped(board: Any, k: int, old: int, new: int) -> bool:
    """Compare and swap: set board[k] to `new` if it equals `old`; return True if it did."""
    raise NotImplementedError("threads share work in compiled code alone")


def _added(board: Any, k: int, value: int) -> int:
    """Add `value` to element k of the integer array `board` atomically; return the element's new value."""
    board[k] += value
    return int(board[k])


def _called(function: int, address: int, first: int, last: int) -> int:
    """Call the compiled function at an address with three integers (see `entry.native`); return its result."""
    raise NotImplementedError("threads share work in compiled code alone")


def _at(e: Any, board: Any, k: Any) -> Any:
    """Return the address of element k of the integer array `board`."""
    return e.b.gep(board.data, [whole(e.b, k)], inbounds=True)


def _on_address(e: Any, function: Any, *words: Any) -> Integer:
    """Emit the call of `_called`: an indirect call of int64(int64, int64, int64)."""
    kind = ir.FunctionType(WORD, [WORD] * 3)
    place = e.b.inttoptr(whole(e.b, function), kind.as_pointer())
    return Integer(e.b.call(place, [whole(e.b, word) for word in words]))


def _exchange(e: Any, board: Any, k: Any, old: Any, new: Any) -> Truth:
    """Emit the compare and swap of `_swapped`, sequentially consistent."""
    found = e.b.cmpxchg(_at(e, board, k), whole(e.b, old), whole(e.b, new), "seq_cst", "seq_cst")
    return Truth(e.b.extract_value(found, 1))


def _sum(e: Any, board: Any, k: Any, value: Any) -> Integer:
    """Emit the atomic addition of `_added`."""
    more = whole(e.b, value)
    return Integer(e.b.add(e.b.atomic_rmw("add", _at(e, board, k), more, "seq_cst"), more))


def _write(e: Any, board: Any, k: Any, value: Any) -> None:
    """Emit the atomic store of `_publish`."""
    e.b.store_atomic(whole(e.b, value), _at(e, board, k), "seq_cst", 8)


# emitters of the atomic operations, as words of the kernel language
WORDS.update({
    _fresh: lambda e, board, k: Integer(e.b.load_atomic(_at(e, board, k), "seq_cst", 8)),
    _publish: _write,
    _swapped: _exchange,
    _added: _sum,
    _called: _on_address,
})  # fmt: skip


@kernel
def _share(boards, me, task):
    """Run the task's function on the thread's own part of the groups, then steal from other threads' parts.

    boards: int64 array of shared memory, with BOARD numbers for each worker thread, then BOARD numbers for the calling
        thread. Entry PART of a board is the number of groups that its thread has left.
    me: index of this thread's board. task: number of the task. The caller's board contains the address of the task's
        function and the function's argument.
    Returns True if this thread finished the last of the task's groups.
    """
    members, last_one = boards.shape[0] // BOARD, False
    head = (members - 1) * BOARD
    for j in range(members):
        at = (me + j) % members * BOARD + PART
        while True:
            # unpack task number, next group and end of the part of member me + j
            word = _fresh(boards, at)
            first, last = (word >> _BITS) & _MASK, word & _MASK
            if word >> 2 * _BITS != task or first >= last:
                break
            # half of the rest: from the front of one's own part, from the end of another's
            count = (last - first + 1) // 2
            begin = first if j == 0 else last - count
            if _swapped(boards, at, word, word + (count << _BITS) if j == 0 else word - count):
                result = _called(boards[head + FUNCTION], boards[head + ADDRESS], begin, begin + count)
                # a negative result is an error
                if result < 0:
                    _publish(boards, head + RAISED, 1)
                _added(boards, head + SUM, result)
                # exactly one thread sees the count reach the number of groups
                last_one = _added(boards, head + FINISHED, count) == boards[head + GROUPS]
    return last_one


@kernel
def serve(boards, k, rounds):
    """Help with tasks as worker k; return SLEEP after `rounds` polls without a task, WAKE or END.

    boards: int64 array of shared memory, with BOARD numbers for each worker thread, then BOARD numbers for the calling
    thread.
    SLEEP: the worker is marked asleep and has to block.
    WAKE: this worker finished a task whose calling thread blocks on its lock.
    END: the threads have to stop, because the task OVER was published.
    """
    at, head = k * BOARD, boards.shape[0] - BOARD
    while True:
        seen, looks = boards[at + DONE], 0
        task = _fresh(boards, at + TASK)
        while task == seen:
            looks += 1
            if looks >= rounds:
                # mark as asleep, then look once more: a task published meanwhile must not be missed
                _publish(boards, at + STATE, ASLEEP)
                if _fresh(boards, at + TASK) == seen or not _swapped(boards, at + STATE, ASLEEP, AWAKE):
                    return SLEEP
            task = _fresh(boards, at + TASK)
        if task == OVER:
            return END
        # help; the worker that finishes the last group wakes a sleeping caller
        last_one = _share(boards, k, task)
        boards[at + DONE] = task
        if last_one:
            if _swapped(boards, head + STATE, ASLEEP, CALLED):
                return WAKE


@kernel
def lead(boards, task, function, address, groups, rounds, stage):
    """Call function(address, first, last) for all groups, in parts shared with the workers; return the sum of results.

    boards: int64 array of shared memory, with BOARD numbers for each worker thread, then BOARD numbers for the calling
    thread.
    task: number of the task.
    function: address of the machine code.
    address: argument of the function.
    groups: number of groups of arms.
    rounds: number of polls before the caller blocks.
    stage: GIVE (publish the task and compute the caller's own part), RUN (compute the own part) or LOOK (only wait for
    the end). The result CALL or WAIT (negative) means that Python has to wake workers or to block, and then to call
    `lead` again. The result FAILED means that a call of the function returned a negative number.
    """
    workers = boards.shape[0] // BOARD - 1
    head = workers * BOARD
    if stage == GIVE:
        # publish the task: function, argument, equal parts of the groups
        boards[head + FUNCTION], boards[head + ADDRESS], boards[head + GROUPS] = function, address, groups
        boards[head + SUM], boards[head + RAISED], asleep = 0, 0, 0
        _publish(boards, head + FINISHED, 0)
        for k in range(workers + 1):
            first, last = groups * k // (workers + 1), groups * (k + 1) // (workers + 1)
            _publish(boards, k * BOARD + PART, (task << 2 * _BITS) + (first << _BITS) + last)
        # announce it to each worker; those asleep have to be woken by Python
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
"""Number of polls before a thread blocks. They take 0.25 ms, longer than Python needs between two steps."""


class _Worker:
    """A worker thread with the index k of its board. done: function that releases the lock of the calling thread."""

    def __init__(self, boards: NDArray[np.int64], k: int, done: Callable[[], None]) -> None:
        """Make the lock on which the worker blocks, in the locked state, and start the thread."""
        self._board, self._rounds, self._call_back = boards[k * BOARD : (k + 1) * BOARD], ROUNDS, done
        self._go = threading.Lock()
        self._go.acquire()
        _workers.add(self)
        self.thread = threading.Thread(target=self._work, args=(boards, k), name="flexarm", daemon=True)
        self.thread.start()

    def _work(self, boards: NDArray[np.int64], k: int) -> None:
        """Function of the thread: work on tasks; between tasks wake the calling thread or block."""
        while (why := serve(boards, k, self._rounds)) != END:
            if why == WAKE:
                self._call_back()
            else:
                self._go.acquire()
                self._board[STATE] = AWAKE

    def wake(self) -> None:
        """Release the worker's lock if another thread has called the worker while it slept or was about to sleep."""
        if self._board[STATE] == CALLED and self._go.locked():
            self._go.release()

    def stop(self) -> None:
        """End the thread after its present task."""
        self._board[TASK] = OVER
        if self._go.locked():
            self._go.release()


# all workers of the process, for `_end_all`
_workers: weakref.WeakSet[_Worker] = weakref.WeakSet()


@atexit.register
def _end_all(seconds: float = 2.0) -> None:
    """Stop all threads before the interpreter ends, which frees machine code and arrays that they use.

    seconds: longest time, s, to wait for each thread. A forked child has only copies of its parent's threads.
    """
    running = [worker for worker in tuple(_workers) if worker.thread.is_alive()]
    for worker in running:
        worker.stop()
    for worker in running:
        if worker.thread is not threading.current_thread():
            worker.thread.join(seconds)


class Crew:
    """Runs a compiled function(address, first, last) on the calling thread and on `size` worker threads.

    Only one thread may use a crew at a time.
    """

    def __init__(self, size: int) -> None:
        """Allocate the boards; threads are started by the first `run`."""
        self.size = size
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy, self._task = False, 0
        self._boards, self._done = np.zeros((size + 1) * BOARD, np.int64), threading.Lock()

    def run(self, function: int, address: int, groups: int) -> int:
        """Call function(address, first, last) for all groups, in parts; return the sum of the calls' results.

        function: address of the function's machine code. address: first argument of the function. groups: number of
            groups of arms.
        """
        # a forked child has the objects, but not the threads
        if self._process != os.getpid():
            self._workers, self._process, self._busy = [], os.getpid(), False
        # an earlier run was interrupted, and so was its cleanup
        if self._busy:
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
        except BaseException:
            # interrupted, for example by Ctrl-C: no thread may go on writing into the caller's arrays
            self._end()
            raise
        self._busy = False
        if result == FAILED:
            raise RuntimeError("A compiled step raised an error")
        return int(result)

    def _begin(self) -> None:
        """Start the threads with new boards and a new lock for the caller: old threads may hold the old ones."""
        self._boards, self._done = np.zeros_like(self._boards), threading.Lock()
        # compile or load `serve` here, not in a thread: with task OVER it returns at once
        self._boards[TASK] = OVER
        serve(self._boards, 0, 1)
        self._boards[TASK] = 0
        self._done.acquire()
        self._workers = [_Worker(self._boards, k, self._done.release) for k in range(self.size)]

    def _end(self) -> None:
        """Stop the threads and wait until they have ended."""
        for worker in self._workers:
            worker.stop()
        for worker in self._workers:
            worker.thread.join()
        self._workers, self._busy = [], False

    def close(self, process: Callable[[], int] = os.getpid) -> None:
        """Stop the worker threads.

        process: function that returns the process id. The default is bound at import, because the module `os` may no
        longer exist when the interpreter exits.
        """
        # an object whose __init__ failed has no _process
        if getattr(self, "_process", None) == process():
            for worker in self._workers:
                worker.stop()
        self._workers = []

    def __del__(self) -> None:
        self.close()


CROWDED = (
    "another thread is at work in this environment: one environment serves one thread at a time; make one for each "
    "thread, or take turns with a threading.Lock around step and reset"
)


class OneAtATime:
    """Context manager that admits one thread at a time; a second thread gets a RuntimeError instead of waiting.

    A lock would let two threads step the same environment in turn, which is an error in the calling program.
    """

    def __init__(self) -> None:
        self._inside: dict[str, int] = {}

    def __enter__(self) -> None:
        """Admit the thread, or raise RuntimeError if another thread is inside."""
        me = threading.get_ident()
        # setdefault is atomic, so of two threads one is admitted
        if self._inside.setdefault("thread", me) != me:
            raise RuntimeError(CROWDED)

    def __exit__(self, *_: object) -> None:
        self._inside.clear()


def one_at_a_time(method: F) -> F:
    """Decorate a method: a second thread that calls it at the same time gets a RuntimeError (`OneAtATime`)."""

    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        with self._door:
            return method(self, *args, **kwargs)

    return guarded  # type: ignore[return-value]
