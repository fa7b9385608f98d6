"""Advance one arm of a scene and record its state at sample instants; Python calls the entry points here."""

from __future__ import annotations

import math

from ..compiler import inlined, kernel, size
from ..layout import Field, Layout
from ..physics.integrator.start import restart_within
from ..physics.integrator.step import advance_within
from ..physics.integrator.work import unpack
from ..physics.layout import BEYOND, DISSIPATED, POSES, WORK_DONE
from ..physics.model import DIVERGED, NOT_FINITE, OK
from ..physics.protocol import centerline, energy, link_poses

SAMPLE = Layout(
    "Sample", "rows, links, motions",
    Field("time", (), "s", "t"),
    Field("poses", ("links", POSES.length), "m, rad", "pose of each link (`physics.layout.POSES`), inertial axes"),
    Field("energies", (3,), "J", "kinetic, strain and gravitational energy"),
    Field("work", (), "J", "work of inputs and prescribed motions since the start"),
    Field("dissipated", (), "J", "energy dissipated by damping since the start"),
    Field("beyond", (), "J", "work of damping forces by strain rates that the steps do not resolve"),
    Field("torque", ("links",), "N m", "joint torques"),
    Field("reaction", ("motions",), "N m or N", "force or torque that enforces each prescribed coordinate"),
    Field("q", ("rows",), "", "coordinates, m and rad; rows of Lagrange multipliers: N, N m"),
    Field("v", ("rows",), "", "velocities, m/s and rad/s"),
    Field("a", ("rows",), "", "accelerations, m/s^2 and rad/s^2"),
)  # fmt: skip
"""Data of one arm at a sample instant: a row of the table that `sample_rows` writes."""

STRETCH = Layout(
    "Stretch", "",
    Field("time", (), "s", "instant reached"),
    Field("longest", (), "s", "length of the longest allowed step"),
    Field("gross", (), "J", "gross work of the drives: sum of the absolute values of their work"),
    Field("start_energy", (), "J", "energy at the last sample that was reached without a step"),
    Field("gain", (), "", "largest allowed ratio of the energy to the energy that is accounted for"),
    Field("begun", (), "s", "start of the interrupted interval between two instants"),
    Field("done", (), "", "number of completed steps of this interval; 0: no interval is interrupted"),
    Field("starts", (), "", "how the next interval starts: GOES_ON, AT_KINK or ANEW"),
    Field("points", (), "", "number of centerline points that were written"),
)  # fmt: skip
"""State of a run of one arm between two calls of `sample_rows`."""

GOES_ON, AT_KINK, ANEW = 0.0, 1.0, 2.0
"""Ways to start an interval. GOES_ON: from the unchanged state. AT_KINK: from consistent velocities and accelerations
after a kink. ANEW: from consistent values computed without earlier accelerations (`start.restart`).
"""

NEAR = 1e-12
"""Two instants that differ by at most NEAR times the present time (NEAR times 1 s if that is larger) count as the same
instant.
"""

sample_at = kernel(SAMPLE.offsets)
_AT = STRETCH.places


@kernel
def observe_arm(lane, model, par, q, v, poses, energies, points):
    """Write link poses, energies (J) and centerline points of one arm; return the number of points (SINGLE lane only).

    # in        q, v (n,) coordinates (m, rad) and velocities;  par, the arm's own parameters
    # out       poses, one `POSES` per link (inertial axes);  energies (3,): kinetic, strain, gravitational
    #           points (P, 2 or 3): m, inertial axes; none are written where P = 0
    """
    link_poses(lane, model, par, q, v, poses)
    energies[0], energies[1], energies[2] = energy(lane, model, par, q, v)
    if points.shape[0] == 0:
        return 0
    return centerline(lane, model, q, points)


@kernel
def has_gained_energy(kinetic, strain, gravity, start, gross, dissipated, gain):
    """Return whether the energy exceeds `gain` times |start| + gross + |dissipated| + |gravity| (all J).

    kinetic, strain, gravity: present energies; their sum is the energy that is compared. start: energy at the start.
    gross: sum of the absolute values of the drives' work. dissipated: dissipated energy. All energies are in J;
    energies below 1e-9 J are ignored.
    """
    total = abs(kinetic + strain + gravity)
    known = abs(start) + gross + abs(dissipated) + abs(gravity)
    return not total <= gain * (known + 1e-300) and total > 1e-9


@inlined
def advance_evenly(lane, arm, drive, p, w, stretch, stop, chunk, most, scheme, books):
    """Advance an arm to the instant `stop` (s) in equal steps of at most stretch.longest (s).

    Returns how many of `most` steps remain, or -1 if the arm failed (w.flag) or `most` steps were not enough. After -1
    the interval is interrupted: stretch.begun and stretch.done store its start and the number of completed steps, and
    the next call continues with steps of the same length. arm: model of the arm; p: the arm's own parameters; drive:
    loads and motions as functions of time, or None. stretch: a `STRETCH`, in and out. scheme: coefficients and Newton
    tolerance of the integrator. chunk: number of steps after which the absolute value of their work is added to the
    gross work. books: not None if energies are kept, or None.
    """
    start, done = stretch[_AT.time], int(stretch[_AT.done])
    if done > 0:
        start = stretch[_AT.begun]
    # h <= longest: ceil of the quotient; 1e-9 keeps round-off from adding a step
    if start < stop - NEAR * max(1.0, stop):
        n_steps = max(1, math.ceil((stop - start) / stretch[_AT.longest] * (1.0 - 1e-9)))
        h = (stop - start) / n_steps
        while done < n_steps:
            # `most` steps are done: the caller may interrupt here, and the next call continues at `begun`
            if most <= 0:
                stretch[_AT.begun], stretch[_AT.done] = start, done
                return -1
            before = w.books[WORK_DONE * len(lane)]
            steps = min(chunk, n_steps - done)
            most -= steps
            # gross work: sum of |W| by chunks, because W of a vibration cancels over a whole run
            stretch[_AT.time] = advance_within(lane, arm, drive, p, w, start + done * h, h, steps, scheme, books)
            stretch[_AT.gross] += abs(w.books[WORK_DONE * len(lane)] - before)
            if w.flag[0] != OK:
                return -1
            # a comparison with NaN is false, so that no bound catches it: q itself is checked
            for k in range(size(arm.n)):
                if not math.isfinite(w.q[k * len(lane)]):
                    w.flag[0] = NOT_FINITE
                    return -1
            done += steps
        stretch[_AT.time], stretch[_AT.done] = stop, 0.0
    return max(most, 0)


@kernel
def _write(lane, model, par, w, t, links, row):
    """Write a `SAMPLE` of the present state into `row`; return (kinetic, strain, gravitational) energy, J.

    t: time of the sample, s. w: the integrator's `Work` of one arm. links: number of links.
    """
    at = sample_at(0, size(model.n), links, w.reaction.shape[0])
    row[at.time] = t
    link_poses(lane, model, par, w.q, w.v, row[at.poses : at.energies])
    energies = energy(lane, model, par, w.q, w.v)
    row[at.energies], row[at.energies + 1], row[at.energies + 2] = energies
    row[at.work], row[at.dissipated], row[at.beyond] = w.books[WORK_DONE], w.books[DISSIPATED], w.books[BEYOND]
    for k in range(links):
        row[at.torque + k] = w.u[k]
    for k in range(w.reaction.shape[0]):
        row[at.reaction + k] = w.reaction[k]
    for k in range(size(model.n)):
        row[at.q + k], row[at.v + k], row[at.a + k] = w.q[k], w.v[k], w.a[k]
    return energies


@kernel
def start_consistently(lane, model, drive, par, w, stretch):
    """Make velocities and accelerations consistent just after the present time, unless stretch.starts is GOES_ON.

    Loads or prescribed velocities may jump at the present time (`physics.integrator.start.restart`). The work of the
    impulses is added to w.books, and the absolute value of this work to stretch.gross. stretch: a `STRETCH`, whose
    field `starts` becomes GOES_ON. drive: loads and motions as functions of time. w: state, in and out.
    """
    if stretch[_AT.starts] != GOES_ON:
        before, fresh = w.books[WORK_DONE * len(lane)], stretch[_AT.starts] == ANEW
        restart_within(lane, model, drive, par, w, stretch[_AT.time], stretch[_AT.longest], fresh)
        stretch[_AT.gross] += abs(w.books[WORK_DONE * len(lane)] - before)
        stretch[_AT.starts] = GOES_ON


@kernel
def next_stop(kinks, k, time, instant):
    """Return (stop, k, kinked) of a stretch from `time` towards `instant` (s): end, next kink, whether at a kink.

    kinks (K,): instants of the kinks, s, ascending. k: number of kinks known to be over; the returned k is the index of
    the next kink. Kinks at the present time are over. kinked: whether the stretch ends at a kink. A kink within
    round-off of `instant` takes its place.
    """
    while k < kinks.shape[0] and kinks[k] <= time + NEAR * max(1.0, kinks[k]):
        k += 1
    if k < kinks.shape[0] and kinks[k] <= instant + NEAR * max(1.0, instant):
        return kinks[k], k, True
    return instant, k, False


@kernel
def sample_rows(
    lane, model, drive, par, flat, n_motions, links, stretch, instants, kinks, chunk, most, scheme, books, table, points
):
    """Advance one arm through sample instants and write a `SAMPLE` row and centerline points at each.

    Returns the number of rows that were written. Steps between two instants are equal and at most stretch.longest.
    Fewer rows than instants are written if the arm has failed (w.flag; the row of a diverged arm is written), or after
    `most` steps. A call with the remaining instants continues an interrupted run with steps of the same length. A
    solver step ends at each kink. A sample at a kink is the state before the kink, and the next interval starts with
    AT_KINK. Without kinks every interval starts with the value GOES_ON.

    # model     model;  drive: loads and motions as functions of time, or None;  par;  links: number of links
    #           scheme: coefficients and Newton tolerance of the integrator
    # in        instants (s, ascending);  kinks (s, ascending), where loads or motions may jump, or None;  chunk: steps
    #           between sums of the gross work;  books: (0,) if energies are recorded, or None
    # in, out   flat: memory of the integrator's `Work` with n_motions prescribed coordinates;  stretch: a `STRETCH`
    # out       table (instants, SAMPLE), or None for no samples; `lane` may then have tangents
    #           points (instants, P, 2 or 3): centerline, m, inertial axes;  P = 0 for no points
    """
    w = unpack(lane, model, flat, n_motions)
    i, k = 0, 0
    while True:
        if kinks is not None:
            start_consistently(lane, model, drive, par, w, stretch)
        if i == instants.shape[0]:
            return i
        # next stop: t_i, or a kink before it
        stop, wanted, kinked = instants[i], True, False
        if kinks is not None:
            stop, k, kinked = next_stop(kinks, k, stretch[_AT.time], instants[i])
            wanted = instants[i] <= stop + NEAR * max(1.0, instants[i])
        # number of steps to the stop; 0 if the run is already there
        moving = stretch[_AT.time] < stop or stretch[_AT.done] > 0.0
        most = advance_evenly(lane, model, drive, par, w, stretch, stop, chunk, most, scheme, books)
        if most < 0:
            return i
        # at a sample E must not exceed what W and V account for
        if wanted:
            i += 1
            if table is not None:
                kinetic, strain, gravity = _write(lane, model, par, w, stretch[_AT.time], links, table[i - 1])
                if points.shape[1] > 0:
                    stretch[_AT.points] = centerline(lane, model, w.q, points[i - 1])
                if not moving:
                    stretch[_AT.start_energy] = kinetic + strain + gravity
                start, gross, gain = stretch[_AT.start_energy], stretch[_AT.gross], stretch[_AT.gain]
                if moving and has_gained_energy(kinetic, strain, gravity, start, gross, w.books[DISSIPATED], gain):
                    w.flag[0] = DIVERGED
                    return i
        # a kink was reached: v and a jump there before the next interval
        if kinked and i < instants.shape[0]:
            stretch[_AT.starts] = AT_KINK
