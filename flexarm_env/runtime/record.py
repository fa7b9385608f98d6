"""Entry points from Python that look at one arm, or move it and look at it at many instants."""

from __future__ import annotations

import math

from ..compiler.arrays import bare
from ..compiler.decorator import kernel
from ..compiler.dispatch import size
from ..physics.integrator.step import advance_bare
from ..physics.integrator.work import unpack
from ..physics.model import DIVERGED, NOT_FINITE, OK
from ..physics.protocol import energy, link_poses, shape

TIME, STEP, GROSS, START_ENERGY, LIMIT, FROM, DONE, SPAN = range(8)
"""Entries of `span`: time reached, s; largest step, s; gross work of the drives, J; energy at the start, J; how many
times what there was, came and went the energy may become; where the stretch began, s, that has come as far as so many
steps (0: none is under way); how many entries there are."""


def row_size(n: int, links: int, n_motions: int) -> int:
    """Numbers that `record` writes for an instant: time, poses, energies, books, torques, reactions, q, v."""
    return 1 + 12 * links + 3 + 2 + links + n_motions + 2 * n


@kernel
def observe_arm(lane, model, par, q, v, poses, energies, points):
    """Link poses (12 numbers a link), (kinetic, strain, gravity) energy and points along the chain; SINGLE only.

    Returns how many points were written; none where `points` is empty.
    """
    m, p, x, y = bare(model), bare(par), bare(q), bare(v)  # the types that the step has compiled much of this for
    link_poses(lane, m, p, x, y, bare(poses))
    energies[0], energies[1], energies[2] = energy(lane, m, p, x, y)
    if points.shape[0] == 0:
        return 0
    return shape(m, x, points)


@kernel
def record(lane, model, drive, par, flat, n_motions, links, span, instants, chunk, most, scheme, table, points):
    """Advance through a smooth stretch, stopping at instants; a row of `table` (m, row_size) and points (m, P, 2) each.

    Steps are equal between instants and at most span[STEP]; books are kept. `chunk`: steps after which the work done
    is looked at. Returns how many rows were written; fewer than m where the arm has failed (its flag says why; a row
    of a diverged arm is written), or after `most` chunks: called again with the instants that are left, it goes on with
    the same steps. SINGLE only.
    """
    arm, p, x = bare(model), bare(par), bare(flat)
    w = unpack(lane, model, x, n_motions)
    n = size(model.n)
    for i in range(instants.shape[0]):
        start, stop, done = span[TIME], instants[i], int(span[DONE])
        if done > 0:
            start = span[FROM]
        if start < stop - 1e-12 * max(1.0, stop):
            n_steps = max(1, math.ceil((stop - start) / span[STEP] * (1.0 - 1e-9)))
            h = (stop - start) / n_steps
            while done < n_steps:
                if most == 0:
                    span[FROM], span[DONE] = start, done
                    return i
                most -= 1
                before = w.books[0]
                steps = min(chunk, n_steps - done)
                span[TIME] = advance_bare(lane, arm, drive, p, w, start + done * h, h, steps, scheme, (0,))
                span[GROSS] += abs(w.books[0] - before)
                if w.flag[0] != OK:
                    return i
                for k in range(n):
                    if not math.isfinite(w.q[k]):
                        w.flag[0] = NOT_FINITE
                        return i
                done += steps
            span[TIME], span[DONE] = stop, 0.0
        row = bare(table[i])
        row[0] = span[TIME]
        link_poses(lane, arm, p, w.q, w.v, row[1 : 1 + 12 * links])
        at = 1 + 12 * links
        row[at], row[at + 1], row[at + 2] = energy(lane, arm, p, w.q, w.v)
        total = abs(row[at] + row[at + 1] + row[at + 2])
        known = abs(span[START_ENERGY]) + span[GROSS] + abs(w.books[1]) + abs(row[at + 2])
        row[at + 3], row[at + 4] = w.books[0], w.books[1]
        at += 5
        for k in range(links):
            row[at + k] = w.u[k]
        at += links
        for k in range(n_motions):
            row[at + k] = w.reaction[k]
        at += n_motions
        for k in range(n):
            row[at + k], row[at + n + k] = w.q[k], w.v[k]
        shape(arm, w.q, points[i])
        if start < stop and not total <= span[LIMIT] * (known + 1e-300):
            if total > 1e-9:
                w.flag[0] = DIVERGED
                return i + 1
    return instants.shape[0]
