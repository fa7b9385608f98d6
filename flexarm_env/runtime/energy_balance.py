"""The balance of energy of an episode: only work raises an arm's energy (docs: theory, section 6).

Let E_0 be the energy at the start of the episode, W the work of torques and pushes since then, and X the exchanged
energy: |E_0| plus the absolute values of each period's work. The kernel treats an arm as diverged if

    E > E_0 + W + SHARE (X + |gravity's energy|) + FLOOR (sum of torque limits).

Damping, friction and numerical dissipation only lower E. The arm's record stores E_0 + W in the field `accounted` and X
in the field `exchanged`.
"""

from __future__ import annotations

from ..compiler import Lanes, absolute, kernel, max_over_lanes, noinline, select_lt, size
from ..physics.arithmetic import store_where
from ..physics.contact.moving import obstacle_work
from ..physics.integrator.work import Work, copy_rows
from ..physics.layout import WORK_DONE
from ..physics.model import DIVERGED
from ..physics.protocol import energy, input_displacements
from ..tasks.program import ACCOUNTED, CHANGE, EXCHANGED, PERIODS
from .events import change_payloads

SHARE = 0.5
"""Tolerated energy that no work explains, as a fraction of the exchanged energy. Correct runs stay below 0.02, and
steps of the elastica are accepted up to 0.05 (`physics.integrator.balance`). A run that exceeds SHARE is wrong.
"""

FLOOR = 1e-3
"""Negligible unexplained energy, J per N m of the torque limits: the work of the limits in a turn by 1 mrad."""


@noinline
def _energies(lane, model, par, q, v):
    """Return (kinetic + strain energy, gravitational energy), J, at coordinates q (m, rad) with rates v."""
    kinetic, strain, gravity = energy(lane, model, par, q, v)
    return kinetic + strain, gravity


@kernel
def is_unbalanced(lane, held, gravity, accounted, exchanged, floor):
    """Return 1.0 in lanes whose energy exceeds the accounted energy, or is not finite; otherwise 0.0.

        held + gravity > accounted + SHARE (exchanged + |gravity|) + floor        (all J)

    held: kinetic plus strain energy. gravity: gravitational energy. accounted: energy at the start of the episode plus
    all work since then. exchanged: absolute value of that energy plus the absolute values of each period's work. floor:
    negligible energy.
    """
    allowed = accounted + (exchanged + absolute(gravity)) * SHARE + floor
    return select_lt(held + gravity, allowed, 0.0, 1.0)


@kernel
def _is_sound(lane, w: Work):
    """Return 1.0 in lanes whose arm moves in this period and has not failed (w.flag is OK), otherwise 0.0."""
    return select_lt(w.flag[0], 0.5, 1.0, 0.0)


@kernel
def open_account(lane, p, par, record: Lanes, w):
    """Store the energy of arms that start an episode; apply due payload changes and count their energy as work.

    record.accounted (J) is the energy at the start of the episode plus all work since then, record.exchanged (J) the
    sum of the absolute values. In an arm's first period both fields are set from the arm's present energy. The energy
    change by a gripped or dropped payload is added to both fields.
    # in        par, the arms' own parameters;  w.q, w.v;  w.flag, status codes;  record.periods
    # in, out   record.accounted, record.exchanged;  w and par, if an arm's payload changes
    """
    first = select_lt(record[PERIODS], 0.5, 1.0, 0.0)
    # first period: E_0, and X_0 = T + U + |V_g|, to which the periods' work adds
    if max_over_lanes(first) > 0.5:
        held, gravity = _energies(lane, p.model, par, w.q, w.v)
        store_where(lane, first, record, ACCOUNTED, held + gravity, record[ACCOUNTED])
        store_where(lane, first, record, EXCHANGED, held + absolute(gravity), record[EXCHANGED])
    if p.payload_change is not None:
        # a payload change changes E without work: its gain (J) counts as W, otherwise the balance would end the episode
        if _changes(lane, record, w):
            before, height = _energies(lane, p.model, par, w.q, w.v)
            change_payloads(lane, p, par, record, w)
            held, gravity = _energies(lane, p.model, par, w.q, w.v)
            gain = held - before + (gravity - height)
            record[ACCOUNTED] += gain
            record[EXCHANGED] += absolute(gain)


@kernel
def _changes(lane, record, w):
    """Return whether a payload change is due in this period in any lane whose arm moves (w.flag is OK).

    record.change: control period at whose start the payload changes; record.periods: control periods done.
    """
    for i in range(len(lane)):
        if w.flag[i] < 0.5 and record[CHANGE * len(lane) + i] == record[PERIODS * len(lane) + i]:
            return True
    return False


@kernel
def add_work(lane, record: Lanes, live, work, gross):
    """Add work (J) to record.accounted and gross work (J) to record.exchanged, for running arms (live > 1/2).

    accounted: energy at the start of the episode plus work since then. exchanged: absolute value of the start energy
    plus the absolute values of each period's work.
    """
    accounted, exchanged = record[ACCOUNTED], record[EXCHANGED]
    store_where(lane, live, record, ACCOUNTED, accounted + work, accounted)
    store_where(lane, live, record, EXCHANGED, exchanged + gross, exchanged)


@kernel
def open_step(lane, p, model, par, w, start):
    """Store the motors' angles (rad) at the start of a step in `start`, if the energy balance is checked (p.watched).

    # in        w.q, coordinates (m, rad)
    # out       start (joints, lanes): joint angles, or a geared motor's angle divided by its gear ratio
    # scratch   w.y
    """
    if p.watched is not None:
        input_displacements(lane, model, par, w.q, w.y)
        copy_rows(lane, size(p.task.links), w.y, start)


@kernel
def close_step(lane, p, model, par, record, w: Work, start: Lanes):
    """Add the motors' work (J) in a step to the record: sum of torque w.u (N m) times change of motor angle (rad).

    start (joints, lanes): motor angles (rad) at the start of the step, from `open_step`. w.y is scratch memory. The
    work is added to record.accounted, its absolute value to record.exchanged. The kernel does nothing if the energy
    balance is not checked (p.watched).
    """
    if p.watched is not None:
        # W += u (y - y_0), J: y are joint angles, or a geared motor's angle (rad), at the step's end
        input_displacements(lane, model, par, w.q, w.y)
        work = 0.0
        for k in range(size(p.task.links)):
            work = work + w.u[k] * (w.y[k] - start[k])
        add_work(lane, record, _is_sound(lane, w), work, absolute(work))


@kernel
def _may_be_unbalanced(lane, p, w: Work, allowed):
    """Return whether the balance of energy needs evaluation: False if an estimate of the kinetic energy is small.

    allowed: energy that is accounted for, J. The estimate is p.watched |v|^2 / 2, where p.watched (kg m^2) is the
    straight arm's inertia per rate (`inertia_per_rate`); it is one to three times the kinetic energy (measured). The
    energy is evaluated if the estimate is at least 2 allowed, and therefore always if the kinetic energy is at least 2
    allowed. Formulations other than the elastica have no estimate, so the result is True. (A period of the elastica
    costs no more than twelve evaluations of its energy.)
    """
    # the elastica alone has an estimate of T, from sum v^2 of its angles; all others evaluate E
    if p.model.newton.resolved is None:
        return True
    square = 0.0
    for k in range(size(p.model.n)):
        rate = w.v[k]
        square = square + rate * rate
    return not max_over_lanes(square * (0.25 * p.watched) - allowed) < 0.0


@kernel
def close_account(lane, p, par, record: Lanes, saved: Lanes, w: Work):
    """Add the work of the period's constant inputs to the record; flag arms with unexplained energy DIVERGED.

    The work of an input is the input times its displacement. With ideal motors the inputs are torques (N m) and pushes
    (N). With other motors (p.actuator) the inputs are only pushes, because `close_step` has added the motors' work step
    by step. The work of prescribed motions is added by `guided.move`.
    # in        saved, coordinates at the start of the period;  par, the arms' own parameters;  w.q, w.v, w.u
    # scratch   w.y, w.y0
    # out       record.accounted, start energy plus work (J);  record.exchanged, sum of absolute values (J);  w.flag
    """
    model, live = p.model, _is_sound(lane, w)
    start, first = saved[: size(model.n)], 0 if p.actuator is None else size(p.task.links)
    # W of the period: sum of u (y - y_0), J; under prescribed motions the steps have added it
    if p.guide is None and first < size(model.n_inputs):
        input_displacements(lane, model, par, start, w.y0)
        input_displacements(lane, model, par, w.q, w.y, (start, w.y0))
        work = 0.0
        for i in range(first, size(model.n_inputs)):
            work = work + w.u[i] * (w.y[i] - w.y0[i])
        add_work(lane, record, live, work, absolute(work))
    _add_obstacle_work(lane, p, record, live, w)
    # allowed energy without V_g: E itself is evaluated only where it may be larger, because that costs a sweep
    floor = 0.0
    for k in range(size(p.task.links)):
        floor = floor + p.task.torque_limits[k]
    floor, exchanged = floor * FLOOR, record[EXCHANGED]
    allowed = record[ACCOUNTED] + exchanged * SHARE + floor
    if _may_be_unbalanced(lane, p, w, allowed):
        held, gravity = _energies(lane, model, par, w.q, w.v)
        lost = is_unbalanced(lane, held, gravity, record[ACCOUNTED], exchanged, floor)
        lost = select_lt(0.5, live, lost, 0.0)
        w.flag[0] = select_lt(0.5, lost, float(DIVERGED), w.flag[0])


@kernel
def _add_obstacle_work(lane, p, record, live, w):
    """Add the work (J) of moving obstacles in the period to the record and to the energy account w.books."""
    contact = p.model.newton.contact
    if contact is not None:
        if contact.paths is not None:
            work = obstacle_work(lane, p.model, w.S)
            add_work(lane, record, live, work, absolute(work))
            if p.books is not None:
                _add_to_books(lane, live, work, w)


@kernel
def _add_to_books(lane, live, work, w: Work):
    """Add work (J) to the energy account w.books of running arms (live > 1/2)."""
    w.books[WORK_DONE] = w.books[WORK_DONE] + select_lt(0.5, live, work, 0.0)


@kernel
def inertia_per_rate(lane, model, par, q, v: Lanes):
    """Return the inertia (kg m^2) of the arm turning as a whole at q, divided by the number of rates that are 1 in v.

    q: coordinates (m, rad). v: rates of a rigid rotation at 1 rad/s, each 0 or 1. The result is 2 T / sum v, where T is
    the kinetic energy for the rates v. The energy balance estimates kinetic energies with this inertia.
    """
    turning = 0.0
    for k in range(size(model.n)):
        turning += v[k]
    return 2.0 * energy(lane, model, par, q, v)[0] / turning
