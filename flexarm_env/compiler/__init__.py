"""A compiler of kernels: what the physics says of it is a dozen words (docs: compiler)."""

from .crew import Crew, OneAtATime, holders, one_at_a_time
from .decorator import MODE, UNCOMPILED, apart, hot, inlined, kernel, superword, uncompiled
from .dispatch import Family, nothing
from .entry import Placed, entry, native
from .lanes import (
    EIGHT,
    SINGLE,
    WIDEST,
    absolute,
    alone,
    arms,
    change,
    dual,
    follow,
    largest,
    load,
    maximum,
    pick,
    place,
    round_even,
    select_lt,
    sincos,
    size,
    splat,
    square_root,
    stack,
    store,
    with_slope,
)
from .reverse import vjp_of
from .trace import traced, unrolled

__all__ = [
    "kernel", "inlined", "apart", "hot", "superword", "uncompiled",
    "SINGLE", "EIGHT", "WIDEST", "dual", "arms", "alone", "change", "with_slope",
    "load", "store", "splat", "pick", "place",
    "select_lt", "absolute", "maximum", "square_root", "round_even", "largest", "sincos",
    "stack", "unrolled", "traced", "vjp_of",
    "Family", "nothing", "size",
    "Placed", "entry", "follow", "native",
    "Crew", "OneAtATime", "one_at_a_time", "holders",
    "MODE", "UNCOMPILED",
]  # fmt: skip
