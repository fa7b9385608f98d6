"""Waiting for another thread without going to sleep: waking one takes the system longer than a small batch's step."""

from __future__ import annotations

from typing import Any

from numba import config, types
from numba.extending import intrinsic

from .bare import pointer
from .jit import kernel


@intrinsic  # type: ignore[untyped-decorator]
def _fresh(typingctx: Any, board: Any, k: Any) -> Any:
    """board[k], read from memory each time."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(pointer(context, builder, signature.args[0], args[0]), [args[1]], inbounds=True)
        return builder.load_atomic(place, "acquire", 8)

    return types.int64(board, types.intp), codegen


def _py_fresh(board: Any, k: int) -> int:
    return int(board[k])


fresh = _py_fresh if config.DISABLE_JIT else _fresh


@kernel
def await_change(board, k, seen, rounds, mark, value, delay):  # type: ignore[no-untyped-def]
    """Set board[mark] = value (none where mark is negative), then look at board[k] (int64) up to `rounds` times, until
    it is no longer `seen`, and `delay` times more; whether it changed.

    All of it without the interpreter's lock: the mark tells the other side that the lock is free, the delay leaves it
    the time to let go of the lock, since a thread that finds it taken is put to sleep.
    """
    if mark >= 0:
        board[mark] = value
    for _ in range(rounds):
        if fresh(board, k) != seen:
            for _ in range(delay):
                fresh(board, k)
            return True
    return False
