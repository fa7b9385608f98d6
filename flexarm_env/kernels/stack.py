"""Room on the stack: small float64 arrays of a kernel's own, without allocation.

`stack(lane, sizes)` gives a flat array of `len(sizes)` lanes, not initialised, that lives as long as the call. Where the
compiler can follow every index into it, it becomes registers.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def stack(typingctx: Any, lane: Any, sizes: Any) -> Any:
    """A float64 array for `len(sizes)` values per lane of the tag `lane`; both are tuples of zeros."""
    length = len(lane) * len(sizes)
    kind = types.Array(types.float64, 1, "C")

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            room = builder.alloca(ir.ArrayType(ir.DoubleType(), length))
            room.align = 64
        array = context.make_array(kind)(context, builder)
        index = ir.IntType(64)
        size = ir.Constant(index, length)
        array.data = builder.bitcast(room, ir.DoubleType().as_pointer())
        array.meminfo = ir.Constant(array.meminfo.type, None)
        array.parent = ir.Constant(array.parent.type, None)
        array.nitems = size
        array.itemsize = ir.Constant(index, 8)
        array.shape = ir.Constant(ir.ArrayType(index, 1), [size])
        array.strides = ir.Constant(ir.ArrayType(index, 1), [ir.Constant(index, 8)])
        return array._getvalue()

    return kind(lane, sizes), codegen
