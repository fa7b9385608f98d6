"""Entry points from Python that look at an arm; those that move it are `newmark.advance` and `newmark.restart`."""

from __future__ import annotations

from .jit import kernel
from .newmark import unpack
from .protocol import energy, link_poses, shape


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
