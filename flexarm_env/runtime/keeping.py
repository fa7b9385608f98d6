"""What is kept of arms, to be gone back to: a `tasks.program.SAVED`, with of the record what there is room for."""

from __future__ import annotations

from ..compiler import apart, kernel


@kernel
def _parts(w, record, saved):
    """What is kept, in the order of `SAVED`."""
    length = 4 * w.q.shape[0] + w.books.shape[0] + w.u.shape[0] + w.psi.shape[0] + w.reaction.shape[0]
    return w.q, w.v, w.a, w.b, w.books, w.u, w.psi, w.reaction, record[: saved.shape[0] - length]


@kernel
def write_parts(parts, kept):
    """Rows of numbers into `kept`, one behind the other."""
    first = 0
    for part in parts:
        for k in range(part.shape[0]):
            kept[first + k] = part[k]
        first += part.shape[0]


@kernel
def read_parts(parts, kept):
    """`write_parts`, undone."""
    first = 0
    for part in parts:
        for k in range(part.shape[0]):
            part[k] = kept[first + k]
        first += part.shape[0]


@kernel
def keep(w, record, saved):
    """All lanes into `saved`."""
    write_parts(_parts(w, record, saved), saved)


@kernel
def keep_lane(lanes, i, w, record, saved):
    """Lane i into `saved`."""
    _copy_lane(lanes, i, _parts(w, record, saved), saved, False)


@kernel
def put_back(lanes, i, w, saved, record):
    """Lane i as it was kept."""
    _copy_lane(lanes, i, _parts(w, record, saved), saved, True)


@kernel
def _copy_lane(lanes, i, parts, saved, back):
    first = i
    for part in parts:
        if back:
            _copy(saved[first:], part[i:], part.shape[0], lanes)
        else:
            _copy(part[i:], saved[first:], part.shape[0], lanes)
        first += part.shape[0]


@apart
def _copy(source, target, count, step):
    """Of so many numbers every `step`-th; apart: it is seldom done, and LLVM makes much of a loop for each array."""
    for k in range(0, count, step):
        target[k] = source[k]
