"""Save and restore the state of arms for periods that are repeated: a `tasks.program.SAVED` record in lanes.

`saved` contains q, v, a, b, books (energy account), u (inputs), psi (prescribed motions), reactions, and the first
numbers of the record, as many as `saved` has room for.
"""

from __future__ import annotations

from ..compiler import kernel, noinline


@kernel
def _parts(w, record, saved):
    """Return the views of a group's memory that are saved, in the order of the record `SAVED`.

    w: the integrator's `Work`: q, v, a, b (coordinates, rates, accelerations, auxiliary ones), books (energy account),
    inputs u, prescribed motions psi and their reactions. record: the arm's record; its first numbers are saved, as many
    as fit into `saved`.
    """
    # the rest of `saved` is the part of the record that a period may change
    length = 4 * w.q.shape[0] + w.books.shape[0] + w.u.shape[0] + w.psi.shape[0] + w.reaction.shape[0]
    return w.q, w.v, w.a, w.b, w.books, w.u, w.psi, w.reaction, record[: saved.shape[0] - length]


@kernel
def write_parts(parts, kept):
    """Copy the numbers of all arrays in `parts` into the array `kept`, in order."""
    first = 0
    for part in parts:
        for k in range(part.shape[0]):
            kept[first + k] = part[k]
        first += part.shape[0]


@kernel
def read_parts(parts, kept):
    """Copy `kept` back into the arrays `parts`, in the order of `write_parts`."""
    first = 0
    for part in parts:
        for k in range(part.shape[0]):
            part[k] = kept[first + k]
        first += part.shape[0]


@kernel
def save_lanes(w, record, saved):
    """Save the state, inputs, energy account and record of all lanes in `saved`.

    # in        w: q, v, a, b, books, u, psi, reaction;  record, as much as `saved` has room for
    # out       saved, a `SAVED` in lanes
    """
    write_parts(_parts(w, record, saved), saved)


@kernel
def save_lane(lanes, i, w, record, saved):
    """Save the state, inputs, energy account and record of lane i of `lanes` lanes in `saved`.

    # in        w: q, v, a, b, books, u, psi, reaction;  record, as much as `saved` has room for
    # out       saved, a `SAVED` in lanes; other lanes are unchanged
    """
    _copy_lane(lanes, i, _parts(w, record, saved), saved, False)


@kernel
def restore_lane(lanes, i, w, saved, record):
    """Restore the state, inputs, energy account and record of lane i of `lanes` lanes from `saved`.

    # in        saved, a `SAVED` in lanes
    # out       w: q, v, a, b, books, u, psi, reaction;  record, as much as was saved; other lanes are unchanged
    """
    _copy_lane(lanes, i, _parts(w, record, saved), saved, True)


@kernel
def _copy_lane(lanes, i, parts, saved, back):
    """Copy lane i of the arrays `parts` to `saved`, one array after the other; if `back` is True, copy it from `saved`.

    In all arrays, number k of the arm in lane i has the index k lanes + i.
    """
    first = i
    for part in parts:
        if back:
            _copy(saved[first:], part[i:], part.shape[0], lanes)
        else:
            _copy(part[i:], saved[first:], part.shape[0], lanes)
        first += part.shape[0]


@noinline
def _copy(source, target, count, step):
    """Copy every `step`-th number of `source` to the same indices of `target`, up to index `count`.

    The kernel is not inlined, because it is seldom called and LLVM would generate much code for a loop per array.
    """
    for k in range(0, count, step):
        target[k] = source[k]
