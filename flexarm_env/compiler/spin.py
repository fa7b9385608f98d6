"""Threads that share work without Python: no lock, no interpreter, unless one side has gone to sleep.

Waking a thread takes the system longer than a small batch's step, and a thread that comes back to the interpreter must
wait for its lock. So a worker stays in compiled code and looks for its next task for a while, the caller likewise for
the end of it. Who has looked in vain says so on the board and goes back to Python, to sleep at a lock; the other side
then reads it there, and has the lock opened. Each begins at its own part of a task and takes half of what is left of
it; who is done takes from the ends of the others' parts, so that nobody waits for a thread that the system has not let
run. All of it by compare and swap: of two sides one gets it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .arrays import pointer
from .decorator import kernel

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

FAILED, CALL, WAIT = -1, -2, -3
"""What `lead` returns below zero: a task raised an error; workers noted as CALLED are to be woken, then go on at RUN;
sleep until the task is done, then go on at LOOK."""

GIVE, RUN, LOOK = range(3)
"""Where `lead` begins."""

TASKS = 2**20
"""Numbers of tasks: 1 ... TASKS, then from 1 again."""

_BITS = 21
_MASK = 2**_BITS - 1


@intrinsic  # type: ignore[untyped-decorator]
def _fresh(typingctx: Any, board: Any, k: Any) -> Any:
    """board[k], read from memory each time, and what was written before it."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
        return builder.load_atomic(place, "seq_cst", 8)

    return types.int64(board, types.intp), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _publish(typingctx: Any, board: Any, k: Any, value: Any) -> Any:
    """board[k] = value, for another thread to see after all that was written before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
        builder.store_atomic(args[2], place, "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(board, types.intp, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _swapped(typingctx: Any, board: Any, k: Any, old: Any, new: Any) -> Any:
    """Whether board[k] was `old`; it then is `new`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
        return builder.extract_value(builder.cmpxchg(place, args[2], args[3], "seq_cst", "seq_cst"), 1)

    return types.boolean(board, types.intp, types.int64, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _added(typingctx: Any, board: Any, k: Any, value: Any) -> Any:
    """board[k] + value, which board[k] then is."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
        return builder.add(builder.atomic_rmw("add", place, args[2], "seq_cst"), args[2])

    return types.int64(board, types.intp, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def _called(typingctx: Any, function: Any, address: Any, first: Any, last: Any) -> Any:
    """What the compiled function of three whole numbers at `function` returns; FAILED where it raises."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word, status = ir.IntType(64), ir.IntType(32)
        error = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(status, [word.as_pointer(), error.as_pointer(), word, word, word])
        result, raised = builder.alloca(word), builder.alloca(error)
        code = builder.call(builder.inttoptr(args[0], kind.as_pointer()), [result, raised, *args[1:]])
        fine = builder.icmp_signed("==", code, status(0))
        return builder.select(fine, builder.load(result), word(FAILED))

    return types.int64(types.int64, types.int64, types.int64, types.int64), codegen


@kernel
def _share(boards, me, task):  # type: ignore[no-untyped-def]
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
def serve(boards, k, rounds):  # type: ignore[no-untyped-def]
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
def lead(boards, task, function, address, groups, rounds, stage):  # type: ignore[no-untyped-def]
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
