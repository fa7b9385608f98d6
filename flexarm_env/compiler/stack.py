"""Room on the stack: small float64 arrays of a kernel's own, without allocation.

`stack(lane, sizes)` gives a flat bare array (`bare.py`) of `len(sizes)` lanes, not initialised, that lives as long as
the call. Where the compiler can follow every index into it, it becomes registers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from .arrays import BareType, struct


@intrinsic  # type: ignore[untyped-decorator]
def _stack(typingctx: Any, lane: Any, sizes: Any) -> Any:
    """A bare float64 array for `len(sizes)` values per lane of the tag `lane`; both are tuples of zeros."""
    length = len(lane) * len(sizes)
    kind = BareType(types.float64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            room = builder.alloca(ir.ArrayType(ir.DoubleType(), length))
            room.align = 64
        array = struct(context, builder, kind)
        array.data = builder.bitcast(room, ir.DoubleType().as_pointer())
        array.size = ir.Constant(ir.IntType(64), length)
        return array._getvalue()

    return kind(lane, sizes), codegen


def _py_stack(lane: tuple[int, ...], sizes: tuple[int, ...]) -> np.ndarray:
    return np.full(len(lane) * len(sizes), np.nan)


stack = _py_stack if config.DISABLE_JIT else _stack
