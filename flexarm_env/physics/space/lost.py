"""What damping takes in a step, by what strains change by from its start to its end.

The places of a step that turns an element by d, straight from one to the other, stretch it by d^2/8 at the middle:
rates of strain that it has at neither end, times forces of EA. Strains of both ends know nothing of that.
"""

from __future__ import annotations

from ...compiler import kernel, splat
from ..protocol import damping_work
from .chain import place_at, section_at
from .element import middle, rates, scale
from .layout import AXES, count_of, joint_row
from .output import root_of
from .rotations import dot, minus


@kernel
def damping_over(lane, model, par, q, v, start, end, x, h):
    """See `protocol`."""
    total = splat(lane, 0.0)
    if model.damped is None:
        return total
    if model.frames is not None:
        return damping_work(lane, model, par, q, v, x)
    tip, old, new, element = place_at(lane, q, v, 0), place_at(lane, start, v, 0), place_at(lane, end, v, 0), 0
    for k in range(model.links):
        i = joint_row(model, k) + 1
        tip, old = root_of(lane, model, q, v, k, tip), root_of(lane, model, start, v, k, old)
        new = root_of(lane, model, end, v, k, new)
        for _ in range(count_of(model, k)):
            section, right = section_at(lane, model, par, element), place_at(lane, q, v, i)
            right_old, right_new = place_at(lane, start, v, i), place_at(lane, end, v, i)
            stretch, bend = rates(section, tip, right)
            before, after = middle(section, old, right_old)[0], middle(section, new, right_new)[0]
            power = dot(scale(stretch, section.stretch), minus(after[0], before[0])) * section.length
            power = power + dot(scale(bend, section.bend), minus(after[1], before[1])) / section.length
            total = total + power * section.tau
            tip, old, new = right, right_old, right_new
            i += AXES
            element += 1
    return total * (1.0 / h)
