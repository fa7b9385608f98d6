"""Entry points from Python that look at one arm, or move it and look at it at many instants."""

from __future__ import annotations

import math

from ..compiler import inlined, kernel, size
from ..layout import Field, Layout
from ..physics.integrator.start import restart_within
from ..physics.integrator.step import advance_within
from ..physics.integrator.work import unpack
from ..physics.layout import DISSIPATED, POSES, WORK_DONE
from ..physics.model import DIVERGED, NOT_FINITE, OK
from ..physics.protocol import energy, link_poses, shape

SAMPLE = Layout(
    "Sample", "rows, links, motions",
    Field("time", (), "s", ""),
    Field("poses", ("links", POSES.length), "m, rad", "of the links"),
    Field("energies", (3,), "J", "kinetic, strain, gravity"),
    Field("work", (), "J", "of the drives"),
    Field("dissipated", (), "J", "by damping"),
    Field("torque", ("links",), "N m", "on the joints"),
    Field("reaction", ("motions",), "N m or N", "that holds each prescribed coordinate"),
    Field("q", ("rows",), "", "state"),
    Field("v", ("rows",), "", "its rate"),
    Field("a", ("rows",), "", "its second rate"),
)  # fmt: skip
"""What is recorded of an instant."""

STRETCH = Layout(
    "Stretch", "",
    Field("time", (), "s", "reached"),
    Field("longest", (), "s", "longest step"),
    Field("gross", (), "J", "gross work of the drives"),
    Field("start_energy", (), "J", "where it began: of the last sample to which it did not move"),
    Field("gain", (), "", "how many times what can account for it the energy may become"),
    Field("begun", (), "s", "where the way to the next instant began, where it is under way"),
    Field("done", (), "", "steps of that way that are done; 0: none is under way"),
    Field("starts", (), "", "how it begins: GOES_ON, AT_KINK or ANEW"),
    Field("points", (), "", "how many there are along the chain"),
)  # fmt: skip
"""What a run carries from one call of `sample_rows` to the next."""

GOES_ON, AT_KINK, ANEW = 0.0, 1.0, 2.0
"""As it is; with a consistent start, as at a kink within a run or a fresh one (`physics.integrator.start.restart`)."""

NEAR = 1e-12
"""Share of the time (of 1 s where it is less) within which two instants are one."""

sample_at = kernel(SAMPLE.offsets)
_AT = STRETCH.places


@kernel
def observe_arm(lane, model, par, q, v, poses, energies, points):
    """Link poses (`POSES`), (kinetic, strain, gravity) energy and points along the chain; SINGLE only.

    Returns how many points were written; none where `points` is empty.
    """
    link_poses(lane, model, par, q, v, poses)
    energies[0], energies[1], energies[2] = energy(lane, model, par, q, v)
    if points.shape[0] == 0:
        return 0
    return shape(model, q, points)


@kernel
def gained(kinetic, strain, gravity, start, gross, dissipated, gain):
    """Whether there is `gain` times the energy that start (J), gross work (J), dissipation and gravity account for."""
    total = abs(kinetic + strain + gravity)
    known = abs(start) + gross + abs(dissipated) + abs(gravity)
    return not total <= gain * (known + 1e-300) and total > 1e-9


@inlined
def _go(lane, arm, drive, p, w, stretch, stop, chunk, most, scheme, books):
    """Equal steps of at most stretch.longest to `stop`; returns how many of `most` steps are left, -1 where the arm has
    failed or there were too few: what is done is then noted in `stretch`."""
    start, done = stretch[_AT.time], int(stretch[_AT.done])
    if done > 0:
        start = stretch[_AT.begun]
    if start < stop - NEAR * max(1.0, stop):
        n_steps = max(1, math.ceil((stop - start) / stretch[_AT.longest] * (1.0 - 1e-9)))
        h = (stop - start) / n_steps
        while done < n_steps:
            if most <= 0:
                stretch[_AT.begun], stretch[_AT.done] = start, done
                return -1
            before = w.books[WORK_DONE * len(lane)]
            steps = min(chunk, n_steps - done)
            most -= steps
            stretch[_AT.time] = advance_within(lane, arm, drive, p, w, start + done * h, h, steps, scheme, books)
            stretch[_AT.gross] += abs(w.books[WORK_DONE * len(lane)] - before)
            if w.flag[0] != OK:
                return -1
            for k in range(size(arm.n)):
                if not math.isfinite(w.q[k * len(lane)]):
                    w.flag[0] = NOT_FINITE
                    return -1
            done += steps
        stretch[_AT.time], stretch[_AT.done] = stop, 0.0
    return max(most, 0)


@kernel
def _write(lane, model, par, w, t, links, row):
    """A `SAMPLE` of the present state; its energies."""
    at = sample_at(0, size(model.n), links, w.reaction.shape[0])
    row[at.time] = t
    link_poses(lane, model, par, w.q, w.v, row[at.poses : at.energies])
    energies = energy(lane, model, par, w.q, w.v)
    row[at.energies], row[at.energies + 1], row[at.energies + 2] = energies
    row[at.work], row[at.dissipated] = w.books[WORK_DONE], w.books[DISSIPATED]
    for k in range(links):
        row[at.torque + k] = w.u[k]
    for k in range(w.reaction.shape[0]):
        row[at.reaction + k] = w.reaction[k]
    for k in range(size(model.n)):
        row[at.q + k], row[at.v + k], row[at.a + k] = w.q[k], w.v[k], w.a[k]
    return energies


@kernel
def start_consistently(lane, model, drive, par, w, stretch):
    """A consistent start at t+ where the stretch asks for one, its impulses in the books."""
    if stretch[_AT.starts] != GOES_ON:
        before, fresh = w.books[WORK_DONE * len(lane)], stretch[_AT.starts] == ANEW
        restart_within(lane, model, drive, par, w, stretch[_AT.time], stretch[_AT.longest], fresh)
        stretch[_AT.gross] += abs(w.books[WORK_DONE * len(lane)] - before)
        stretch[_AT.starts] = GOES_ON


@kernel
def sample_rows(
    lane, model, drive, par, flat, n_motions, links, stretch, instants, kinks, chunk, most, scheme, books, table, points
):
    """Advance, stopping at instants; a row of `table` (a `SAMPLE`) and points (P, 2) each.

    Steps are equal between instants and at most stretch.longest. `kinks`: instants, in order, where loads or motions
    may jump: a step ends there, what is sampled there is the state before, and if it goes on from there it begins
    AT_KINK; None: there are none, and what begins here GOES_ON. `chunk`: steps after which the work done is looked at.
    books: a tag, (0,), where books are kept, or None. Returns how many rows were written; fewer than there are instants
    where the arm has failed (its flag says why; a row of a diverged arm is written), or after `most` steps: called
    again with the instants that are left, it goes on with the same steps. No points where P = 0. table None: nothing is
    written, and the lane may be a dual one of one arm; otherwise SINGLE only.
    """
    w = unpack(lane, model, flat, n_motions)
    i, k = 0, 0
    while True:
        if kinks is not None:
            start_consistently(lane, model, drive, par, w, stretch)
        if i == instants.shape[0]:
            return i
        stop, wanted, kinked = instants[i], True, False
        if kinks is not None:
            while k < kinks.shape[0] and kinks[k] <= stretch[_AT.time] + NEAR * max(1.0, kinks[k]):
                k += 1
            kinked = k < kinks.shape[0] and kinks[k] <= stop + NEAR * max(1.0, stop)
            if kinked:
                wanted = stop <= kinks[k] + NEAR * max(1.0, stop)
                stop = kinks[k]
        moving = stretch[_AT.time] < stop or stretch[_AT.done] > 0.0
        most = _go(lane, model, drive, par, w, stretch, stop, chunk, most, scheme, books)
        if most < 0:
            return i
        if wanted:
            i += 1
            if table is not None:
                kinetic, strain, gravity = _write(lane, model, par, w, stretch[_AT.time], links, table[i - 1])
                if points.shape[1] > 0:
                    stretch[_AT.points] = shape(model, w.q, points[i - 1])
                if not moving:
                    stretch[_AT.start_energy] = kinetic + strain + gravity
                start, gross, gain = stretch[_AT.start_energy], stretch[_AT.gross], stretch[_AT.gain]
                if moving and gained(kinetic, strain, gravity, start, gross, w.books[DISSIPATED], gain):
                    w.flag[0] = DIVERGED
                    return i
        if kinked and i < instants.shape[0]:
            stretch[_AT.starts] = AT_KINK
