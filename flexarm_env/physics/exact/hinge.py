"""A hinge in the factors of a chain: free, or with what a jointed arm adds to its row."""

from __future__ import annotations

from ...compiler import kernel, load, splat, store
from .layout import OF_HINGE


@kernel
def turn_free(lane, jointed, S, h, tail):
    """Eliminate psi behind the hinge at h; what remains at the vertex."""
    xx, xy, xt, yy, yt, tt = tail
    zero = splat(lane, 0.0)
    if jointed is None:
        inverse = 1.0 / tt
        zx, zy = xt * inverse, yt * inverse
        store(S, h + OF_HINGE.x, zx)
        store(S, h + OF_HINGE.y, zy)
        store(S, h + OF_HINGE.inverse, inverse)
        return xx - zx * xt, xy - zx * yt, zero, yy - zy * yt, zero, zero
    own = load(lane, S, h + OF_HINGE.own)
    inverse = 1.0 / (tt + own)
    zx, zy, zt = xt * inverse, yt * inverse, own * inverse
    store(S, h + OF_HINGE.x, zx)
    store(S, h + OF_HINGE.y, zy)
    store(S, h + OF_HINGE.inverse, inverse)
    store(S, h + OF_HINGE.own, zt)
    return xx - zx * xt, xy - zx * yt, xt * zt, yy - zy * yt, yt * zt, tt * zt


@kernel
def passed_on(lane, jointed, S, h, moment, behind):
    """The moment on psi before the hinge, with its part of the one behind."""
    if jointed is None:
        return moment
    return moment + load(lane, S, h + OF_HINGE.own) * behind


@kernel
def turned_behind(lane, jointed, S, h, psi, before):
    """psi behind the hinge, with the part that psi before it carries along."""
    if jointed is None:
        return psi
    return psi + load(lane, S, h + OF_HINGE.own) * before
