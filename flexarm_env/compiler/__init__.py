"""A compiler of kernels: what the physics says of it is a dozen words (docs: compiler)."""

from .arrays import bare, stack
from .crew import Crew, OneAtATime, holders, one_at_a_time
from .decorator import apart, inlined, kernel, uncompiled
from .dispatch import NONE, NUMBER, TUPLE, Family, by_kind, size
from .entry import Placed, entry, follow, native
from .lanes import (
    EIGHT,
    SINGLE,
    WIDEST,
    absolute,
    alone,
    arms,
    change,
    dual,
    largest,
    load,
    maximum,
    pick,
    place,
    round_even,
    select_lt,
    sincos,
    splat,
    square_root,
    store,
    with_slope,
)
from .private import MODE, WHY, selfcheck
from .reverse import pulled
from .trace import aligned_frame, traced, unrolled

__all__ = [
    "kernel", "inlined", "apart", "uncompiled",
    "SINGLE", "EIGHT", "WIDEST", "dual", "arms", "alone", "change", "with_slope",
    "load", "store", "splat", "pick", "place",
    "select_lt", "absolute", "maximum", "square_root", "round_even", "largest", "sincos",
    "bare", "stack", "unrolled", "traced", "pulled", "aligned_frame",
    "Family", "by_kind", "size", "NONE", "NUMBER", "TUPLE",
    "Placed", "entry", "follow", "native",
    "Crew", "OneAtATime", "one_at_a_time", "holders",
    "MODE", "WHY", "selfcheck",
]  # fmt: skip
