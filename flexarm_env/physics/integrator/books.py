"""An arm's books: the work of inputs and motions, and what damping takes, by the steps' own mean forces."""

from __future__ import annotations

from ...compiler import kernel, load, size, store
from ..joints.friction import book_friction, note_friction
from ..layout import DISSIPATED, OF_MOTION, WORK_DONE
from ..protocol import damping_over, difference, ports, ports_after
from .work import copy_rows, state_of


@kernel
def open_books(lane, model, drive, par, w):
    """Remember ports and forces at the start of a smooth stretch."""
    copy_rows(lane, size(model.n_inputs), w.u, w.u0)
    ports(lane, model, par, w.q, w.y0)
    note_friction(lane, model, par, state_of(w), w.u, w.r, w.S)
    if drive is not None:
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        copy_rows(lane, drive.known.shape[0], w.reaction, w.reaction0)


@kernel
def keep_books(lane, model, drive, par, w, h):
    """Add the work of a step of h and what damping took: mean force times displacement, what Newmark itself does.

    At the middle of a step that turns a stiff section by a large angle there are strain rates that it has at neither
    end; hence the forces of damping are taken times the displacement, and not the mean of the powers. r is free once
    the step has succeeded.
    """
    ports_after(lane, model, par, w.q0, w.y0, w.q, w.y)
    work = load(lane, w.books, WORK_DONE)
    for i in range(size(model.n_inputs)):
        force = (load(lane, w.u0, i) + load(lane, w.u, i)) * 0.5
        work = work + force * (load(lane, w.y, i) - load(lane, w.y0, i))
        store(w.u0, i, load(lane, w.u, i))
        store(w.y0, i, load(lane, w.y, i))
    if drive is not None:
        for i in range(drive.known.shape[0]):
            k = OF_MOTION.end * i + OF_MOTION.value
            force = (load(lane, w.reaction0, i) + load(lane, w.reaction, i)) * 0.5
            work = work + force * (load(lane, w.psi, k) - load(lane, w.psi0, k))
        copy_rows(lane, OF_MOTION.end * drive.known.shape[0], w.psi, w.psi0)
        copy_rows(lane, drive.known.shape[0], w.reaction, w.reaction0)
    store(w.books, WORK_DONE, work)
    difference(lane, model, w.q0, w.q, w.r)
    for k in range(size(model.n)):
        store(w.r, k, load(lane, w.r, k) * (1.0 / h))
    taken = damping_over(lane, model, par, w.q0, w.v0, w.q0, w.q, w.r, h)
    taken = taken + damping_over(lane, model, par, w.q, w.v, w.q0, w.q, w.r, h)
    store(w.books, DISSIPATED, load(lane, w.books, DISSIPATED) + taken * (0.5 * h))
    book_friction(lane, model, par, state_of(w), w.u, w.r, w.S, w.q0, w.books)
