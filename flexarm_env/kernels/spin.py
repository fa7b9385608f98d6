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
def await_change(board, k, seen, rounds):  # type: ignore[no-untyped-def]
    """Look at board[k] (int64) up to `rounds` times, until it is no longer `seen`; whether it changed."""
    for _ in range(rounds):
        if fresh(board, k) != seen:
            return True
    return False
