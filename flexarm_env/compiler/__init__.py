"""Compiler of kernels: decorators, built-in functions of kernels, and threads for compiled code (docs: compiler)."""

from .beside import Beside
from .crew import CROWDED, Crew, OneAtATime, one_at_a_time
from .decorator import MODE, UNCOMPILED, entry_point, inlined, kernel, noinline, superword, uncompiled
from .dispatch import Family, returns_none
from .entry import Placed, entry, native
from .lane_arrays import Lanes
from .lanes import (
    EIGHT,
    SINGLE,
    WIDEST,
    absolute,
    dereference,
    dual,
    lane_count,
    load,
    load_lane,
    max_over_lanes,
    maximum,
    round_even,
    select_lt,
    sincos,
    size,
    splat,
    square_root,
    stack,
    store,
    store_lane,
    tangents_only,
    with_slope,
    without_tangents,
)
from .pace import Pace, Team, default_threads, processors
from .reverse import vjp_of
from .sheets import Sheet
from .trace import traced, unrolled
from .waiting import compiling

__all__ = [
    "kernel", "inlined", "noinline", "entry_point", "superword", "uncompiled",
    "SINGLE", "EIGHT", "WIDEST", "dual", "lane_count", "without_tangents", "tangents_only", "with_slope",
    "Lanes", "load", "store", "splat", "load_lane", "store_lane",
    "select_lt", "absolute", "maximum", "square_root", "round_even", "max_over_lanes", "sincos",
    "stack", "unrolled", "traced", "vjp_of",
    "Family", "returns_none", "size",
    "Placed", "entry", "dereference", "native",
    "Beside", "Crew", "OneAtATime", "one_at_a_time", "CROWDED", "Sheet",
    "Pace", "Team", "default_threads", "processors",
    "MODE", "UNCOMPILED", "compiling",
]  # fmt: skip
