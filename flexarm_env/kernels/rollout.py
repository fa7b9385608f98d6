"""Entry points from Python: one arm (SINGLE) or a lane group, from its flat state to its flat state."""

from __future__ import annotations

from .jit import kernel
from .newmark import advance, reactions, restart, unpack
from .protocol import energy, link_poses, shape


@kernel
def start_arm(lane, model, drive, par, flat, n_motions, t, h):  # type: ignore[no-untyped-def]
    """Consistent velocities, accelerations and multipliers at t+ (see `newmark.restart`)."""
    restart(lane, model, drive, par, unpack(lane, model, flat, n_motions), t, h)


@kernel
def advance_arm(lane, model, drive, par, flat, n_motions, t, h, n_steps, scheme, books):  # type: ignore[no-untyped-def]
    """n_steps steps of size h from t; returns the time reached. The status is in the flat array's flag."""
    w = unpack(lane, model, flat, n_motions)
    reached = advance(lane, model, drive, par, w, t, h, n_steps, scheme, books)
    if drive is not None:
        reactions(lane, model, drive, par, w)
    return reached


@kernel
def observe_arm(lane, model, par, flat, n_motions, poses, energies):  # type: ignore[no-untyped-def]
    """Link poses (12 numbers a link) and (kinetic, strain, gravity) energy of one arm; SINGLE only."""
    w = unpack(lane, model, flat, n_motions)
    link_poses(lane, model, par, w.q, w.v, poses)
    energies[0], energies[1], energies[2] = energy(lane, model, par, w.q, w.v)


@kernel
def shape_of(model, q, points):  # type: ignore[no-untyped-def]
    """Positions along the chain; returns how many were written."""
    return shape(model, q, points)
