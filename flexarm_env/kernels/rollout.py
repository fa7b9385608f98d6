"""Entry point from Python that looks at one arm; those that move it are `newmark.advance` and `restart.restart`."""

from __future__ import annotations

from .bare import bare
from .jit import kernel
from .protocol import energy, link_poses, shape


@kernel
def observe_arm(lane, model, par, q, v, poses, energies, points):  # type: ignore[no-untyped-def]
    """Link poses (12 numbers a link), (kinetic, strain, gravity) energy and points along the chain; SINGLE only.

    Returns how many points were written; none where `points` is empty.
    """
    m, p, x, y = bare(model), bare(par), bare(q), bare(v)  # the types that the step has compiled much of this for
    link_poses(lane, m, p, x, y, bare(poses))
    energies[0], energies[1], energies[2] = energy(lane, m, p, x, y)
    if points.shape[0] == 0:
        return 0
    return shape(m, x, points)
