"""Shapes: distances that are known, slopes by differences, kernels beside NumPy, drawings on the surface."""

import math
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import uncompiled
from flexarm_env.geometry.outlines import faces_of, outline_of
from flexarm_env.physics.obstacles import distance, packed
from flexarm_env.shapes import Box, Cylinder, HalfSpace, Shape, Sphere, shape_of
from tests.refusals import refuses, says

TURN = ((1.0, 2.0, -1.0), 0.7)
PLANE: list[Shape] = [HalfSpace((0.5, 0.2), (-3.0, 4.0)), Sphere((0.3, -0.1), 0.4), Box((0.2, 0.1), (0.6, 0.2), 0.5)]
SPACE: list[Shape] = [
    HalfSpace((0.5, 0.2, 0.1), (1.0, -2.0, 2.0)), Sphere((0.3, -0.1, 0.2), 0.4),
    Box((0.2, 0.1, -0.1), (0.6, 0.2, 0.4), TURN), Box((0.0, 0.0, 0.0), (0.3, 0.4, 0.5)),
    Cylinder((0.1, 0.0, -0.2), (0.4, 0.3, 0.3), 0.25),
]  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "point", "distance"),
    [
        (HalfSpace((0.0, 1.0), (0.0, -2.0)), (5.0, 0.25), 0.75),
        (HalfSpace((0.0, 0.0, 0.5), (0.0, 0.0, 1.0)), (1.0, 2.0, 0.2), -0.3),
        (Sphere((1.0, 1.0), 0.5), (1.0, 3.0), 1.5),
        (Sphere((1.0, 1.0, 1.0), 0.5), (1.0, 1.0, 1.0), -0.5),
        (Box((0.0, 0.0), (2.0, 4.0)), (4.0, 6.0), 5.0),  # from a corner
        (Box((0.0, 0.0), (2.0, 4.0)), (0.8, 0.0), -0.2),
        (Box((0.0, 0.0), (2.0, 2.0), math.pi / 4), (2.0, 0.0), 2.0 - math.sqrt(2.0)),
        (Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)), (3.0, 3.0, 2.0), 3.0),
        (Cylinder((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 0.5), (2.0, 0.0, 0.0), 1.5),
        (Cylinder((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 0.5), (3.5, 0.0, 5.0), 5.0),  # from its rim
        (Cylinder((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 0.5), (0.0, 0.1, 0.9), -0.1),
    ],
)
def test_known_distances(shape: Shape, point: tuple[float, ...], distance: float) -> None:
    assert float(shape.distance(point)) == pytest.approx(distance, abs=1e-14)


@pytest.mark.parametrize("shape", PLANE + SPACE)
def test_slopes_are_those_of_distances_and_lead_to_the_surface(shape: Shape) -> None:
    rng, eps, d = np.random.default_rng(3), 1e-6, shape.dimension
    points = rng.uniform(-1.0, 1.0, (400, d))
    distance, slope = shape.look(points)
    assert np.linalg.norm(slope, axis=-1) == pytest.approx(np.ones(400))
    steps = eps * np.eye(d)
    measured = np.stack([(shape.distance(points + s) - shape.distance(points - s)) / (2 * eps) for s in steps], axis=-1)
    assert (np.abs(measured - slope).max(axis=-1) < 1e-7).mean() > 0.99  # but where the nearest point jumps
    np.testing.assert_allclose(shape.distance(points - distance[:, None] * slope), 0.0, atol=1e-12)


@pytest.mark.parametrize("shapes", [PLANE, SPACE])
def test_kernels_measure_as_numpy_does(shapes: list[Shape]) -> None:
    table, rng = packed(shapes), np.random.default_rng(4)
    for k, shape in enumerate(shapes):
        for point in rng.uniform(-1.0, 1.0, (60, 3)):
            if shape.dimension == 2:
                point[2] = 0.0
            found = uncompiled(distance)(table, k, *point)
            assert found == pytest.approx(float(shape.distance(point[: shape.dimension])), abs=1e-14)


def test_drawings_lie_on_the_surface_and_look_outwards() -> None:
    for shape in PLANE:
        corners = outline_of(shape, np.zeros(2), 2.0)
        assert np.abs(shape.distance(corners)).min() < 1e-12 and (shape.distance(corners) < 1e-12).all()
    for shape in SPACE:
        for face in faces_of(shape, np.zeros(3), 1.0):
            assert np.abs(shape.distance(face)).max() < 1e-12
            sides = np.roll(face, -1, axis=0) - face
            outwards = np.cross(sides, np.roll(sides, -1, axis=0)).sum(axis=0)
            way = -1.0 if isinstance(shape, HalfSpace) else 1.0  # a wall is seen from behind
            assert way * (outwards @ shape.gradient(face.mean(axis=0))) > 0.0


@pytest.mark.parametrize("shape", PLANE + SPACE)
def test_tables_say_the_same(shape: Shape) -> None:
    assert shape_of("keep_out", shape.to_dict(), shape.dimension) == shape
    assert shape_of("keep_out", shape, shape.dimension) is shape


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"shape": "ball"}, "x.shape = 'ball': must be one of"),
        ({"center": (0, 0), "radius": 1}, "x.shape: missing"),
        ({"shape": "sphere", "center": (0, 0)}, "x.radius: missing"),
        ({"shape": "sphere", "center": (0, 0), "radius": 0}, "x.radius = 0"),
        ({"shape": "sphere", "center": (0, 0), "radius": 1, "colour": "red"}, "x.colour"),
        ({"shape": "sphere", "center": (0, 0, 0), "radius": 1}, "must be in the plane"),
        ({"shape": "half_space", "point": (0, 0), "normal": (0, 0)}, "x.normal = (0, 0): must be a direction"),
        ({"shape": "half_space", "point": (0, 0), "normal": (0, 0, 1)}, "must have 2 numbers"),
        ({"shape": "box", "center": (0, 0), "sides": (1, -1)}, "x.sides[1] = -1"),
        ({"shape": "cylinder", "start": (0, 0, 0), "end": (0, 0, 0), "radius": 1}, "must be another point than start"),
        (7, "x = 7"),
    ],
)
def test_wrong_shapes_are_named(value: Any, words: str) -> None:
    says(words, lambda: shape_of("x", value, 2))


def test_points_have_as_many_numbers_as_the_shape() -> None:
    refuses("must have 2 numbers along its last axis", lambda: PLANE[0].distance(np.zeros(3)))
