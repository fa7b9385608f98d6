"""Threads that hand over work without Python: no lock, no interpreter, unless one side has gone to sleep.

Waking a thread takes the system longer than a small batch's step, and a thread that comes back to the interpreter must
wait for its lock. So a worker stays in compiled code and looks for its next task for a while, the caller likewise for
the outcome. Who has looked in vain says so on the board and goes back to Python, to sleep at a lock; the other side
then reads it there, and has the lock opened. Notes are left by compare and swap: of two sides one takes it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .bare import pointer
from .jit import kernel

BOARD = 64
"""int64 numbers of a worker's board."""

TASKS, FUNCTION, ADDRESS, FIRST, LAST = 8, 9, 10, 11, 12
"""What the caller writes, on cache lines of its own: tasks given (OVER: the worker is to end), and the last one."""
OVER = -1
DONE, RESULT = 24, 25
"""What the worker writes: tasks done, what the last one returned."""
WORKER, CALLER = 40, 56
"""Notes on each side's sleep, see below."""
AWAKE, ASLEEP, CALLED = range(3)

SLEEP, WAKE, END = range(3)
"""Why `serve` returns: no task came; the caller sleeps and the task is done; the worker is to end."""

FAILED, CALL, WAIT = -1, -2, -3
"""What `lead` returns below zero: a task raised an error; workers noted as CALLED are to be woken, then go on at RUN;
wait for worker k (WAIT - k), then go on at GATHER."""

GIVE, RUN, GATHER = range(3)
"""Where `lead` begins."""


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
def serve(boards, k, rounds):  # type: ignore[no-untyped-def]
    """Do worker k's tasks as they come, until none has for `rounds` looks, or something is left to do in Python."""
    at = k * BOARD
    while True:
        seen, looks = boards[at + DONE], 0
        while _fresh(boards, at + TASKS) == seen:
            looks += 1
            if looks >= rounds:
                _publish(boards, at + WORKER, ASLEEP)
                if _fresh(boards, at + TASKS) == seen or not _swapped(boards, at + WORKER, ASLEEP, AWAKE):
                    return SLEEP
        if _fresh(boards, at + TASKS) == OVER:
            return END
        task = at + FUNCTION
        boards[at + RESULT] = _called(boards[task], boards[task + 1], boards[task + 2], boards[task + 3])
        _publish(boards, at + DONE, seen + 1)
        if _swapped(boards, at + CALLER, ASLEEP, CALLED):
            return WAKE


@kernel
def lead(boards, function, address, groups, rounds, stage):  # type: ignore[no-untyped-def]
    """function(address, first, last) over `groups`, a part by each worker and the first by the caller: the sum.

    Below zero: something is to be done in Python first (see above). boards: BOARD numbers a worker, and as many more.
    """
    workers = boards.shape[0] // BOARD - 1
    if stage == GIVE:
        asleep = 0
        for k in range(workers):
            at = k * BOARD
            boards[at + FUNCTION], boards[at + ADDRESS] = function, address
            boards[at + FIRST] = groups * (k + 1) // (workers + 1)
            boards[at + LAST] = groups * (k + 2) // (workers + 1)
            _publish(boards, at + TASKS, boards[at + TASKS] + 1)
            if _swapped(boards, at + WORKER, ASLEEP, CALLED):
                asleep += 1
        if asleep > 0:
            return CALL
    own = workers * BOARD + RESULT
    if stage != GATHER:
        boards[own] = _called(function, address, 0, groups // (workers + 1))
    for k in range(workers):
        at, looks = k * BOARD, 0
        given = boards[at + TASKS]
        while _fresh(boards, at + DONE) != given:
            looks += 1
            if looks >= rounds:
                _publish(boards, at + CALLER, ASLEEP)
                if _fresh(boards, at + DONE) != given or not _swapped(boards, at + CALLER, ASLEEP, AWAKE):
                    return WAIT - k
    total = 0
    for k in range(workers + 1):
        result = boards[k * BOARD + RESULT]
        if result < 0:
            return FAILED
        total += result
    return total
