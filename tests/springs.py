"""Contributions at points for tests: springs between places of an arm and fixed points, present while a test runs.

An arm has them if its `source` is not empty, a field that no equation of motion reads.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from flexarm_env.compiler import Lanes, kernel, stack
from flexarm_env.parameters import Arm
from flexarm_env.physics import contributions
from flexarm_env.physics.joints.points import BLOCK, KINDS, AtPoint, Point, point_displacement, store_block


class Spring(NamedTuple):
    """A spring without rest length between a point of the arm and a fixed point."""

    point: Point
    stiffness: float  # k, N/m
    anchor: tuple[float, float, float]  # m, inertial axes


@kernel
def spring_force(lane, part, model, par, state, S, inputs: Lanes):  # type: ignore[no-untyped-def]
    """Add the force k (anchor - y) on the point at y."""
    y = stack(lane, model.points)
    point_displacement(lane, part.point, model, par, state.q, y)
    for i in range(len(part.point.axes)):
        k = part.point.input + i
        inputs[k] += (part.anchor[i] - y[k]) * part.stiffness


@kernel
def spring_block(lane, part, model, par, state, u, weights, r, S):  # type: ignore[no-untyped-def]
    """Store the stiffness for the matrix."""
    if weights.with_matrix:
        store_block(lane, part.point, model, par, state, u, part.stiffness * weights.stiffness, S)


@kernel
def spring_energy(lane, part, model, par, q, v, sums):  # type: ignore[no-untyped-def]
    """Add k |y - anchor|^2 / 2 to the strain energy."""
    y, square = stack(lane, model.points), 0.0
    point_displacement(lane, part.point, model, par, q, y)
    for i in range(len(part.point.axes)):
        away = y[part.point.input + i] - part.anchor[i]
        square = square + away * away
    return sums[0], sums[1] + square * (0.5 * part.stiffness), sums[2]


contributions.register(Spring, point_forces=spring_force, assemble=spring_block, energy=spring_energy, **BLOCK)


@contextmanager
def springs(*given: tuple[tuple[int, str], float, tuple[float, float, float]]) -> Iterator[None]:
    """Springs of arms with a `source`: for each the (link, end) it pulls at, k in N/m, its fixed point in m."""

    def kind(place: tuple[int, str], stiffness: float, anchor: tuple[float, float, float]) -> AtPoint:
        def make(arm: Arm, point: Point) -> Any:
            return Spring(point, stiffness, anchor)

        return AtPoint(("source",), lambda arm: place, make)

    before = len(KINDS)
    KINDS.extend(kind(*one) for one in given)
    try:
        yield
    finally:
        del KINDS[before:]
