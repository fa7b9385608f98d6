"""Records and layouts of contact: points of the arm, obstacles with their laws, and the entries of a point in S."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...layout import Field, Layout

LAW = Layout(
    "ContactLaw", "",
    Field("stiffness", (), "N/m^n", "k of the normal force k d^n (1 + 3/2 alpha dd/dt); d: penetration"),
    Field("halves", (), "", "2 n, twice the exponent n: 2, 3, 4, 5 or 6"),
    Field("damping", (), "s/m", "alpha, damping coefficient of the normal force"),
    Field("friction", (), "", "mu, coefficient of friction"),
    Field("creep", (), "m/s", "v_s, sliding speed at which friction reaches 0.71 mu times the normal force"),
)  # fmt: skip
LAWS = LAW.places

READING = Layout(
    "ContactReading", "",
    Field("normal", (), "N", "sum of the normal forces of all obstacles on the point"),
    Field("tangential", (), "N", "magnitude of the sum of the friction forces of all obstacles"),
    Field("penetration", (), "m", "largest penetration; if negative, a bound of minus the least distance"),
    Field("sliding", (), "m/s", "sliding speed on the obstacle that is penetrated most or is nearest"),
    Field("force", (3,), "N", "force of all obstacles on the arm, inertial axes"),
    Field("impulse", (), "N s", "time integral of the normal force since `reset_impulses`"),
    Field("friction", (), "N s", "time integral of the friction force's magnitude since `reset_impulses`"),
    Field("peak", (), "N", "largest normal force at the end of a step since `reset_impulses`"),
)  # fmt: skip
"""`READING`: readings of a point, stored at the end of each step."""
READ = READING.places

HERE = Layout(
    "ContactPoint", "axes, n",
    Field("reading", (READING.length,), "", "readings of the point, a `READING`"),
    Field("gap", (), "m", "distance between point and nearest obstacle, negative if they touch"),
    Field("bound", (), "N", "largest mu F_n over all obstacles; `solve_friction` solves for this friction"),
    Field("creep", (), "m/s", "v_s of the obstacle with the largest mu F_n"),
    Field("normal", (3,), "", "unit normal of this obstacle"),
    Field("slip", (3,), "m/s", "sliding velocity w on this obstacle"),
    Field("active", (), "", "1: the matrix has a block of this point"),
    Field("rate", (), "1/s", "c_v of the matrix if it does not contain this friction; otherwise 0"),
    Field("K", ("axes", "axes"), "N/m", "minus the derivative of the force by the point's displacement, times weights"),
    Field("C", ("axes", "axes"), "N/m", "matrix (1 + K B^T W)^-1 K"),
    Field("work", ("axes", "axes"), "", "scratch"),
    Field("B", ("axes", "n"), "", "columns: generalized forces on the arm of a unit force on the point"),
    Field("W", ("axes", "n"), "", "columns of S^-1 B, for the point's block"),
    Field("V", ("axes", "n"), "", "columns of S^-1 B, S with the blocks of all points"),
    Field("D", ("axes", "axes"), "m/N", "B^T V"),
)  # fmt: skip
"""`HERE`: entries of a point in the matrix array S. axes: number of components of the force on the point. n: number of
rows of the Model."""


REFERENCE = Layout(
    "ClearanceReference", "n",
    Field("bounded", (), "", "1: the gaps of the points are a lower bound of their distances"),
    Field("clearance", (), "m", "least distance of a point from an obstacle at q, minus round-off; 0: no reference"),
    Field("q", ("n",), "m, rad", "reference coordinates"),
)  # fmt: skip
"""`REFERENCE`: entries after those of the points in S, from which `clearance` computes bounds of distances."""

ACCOUNT = Layout(
    "ObstacleAccount", "m",
    Field("time", (), "s", "time since the start of the episode, at the end of the last step"),
    Field("work", (), "J", "work of the moving obstacles on the arm since `reset_impulses`"),
    Field("force", ("m",), "N", "force along each moving axis that the obstacle exerts on the arm"),
    Field("place", ("m",), "m", "displacement of the obstacle along each moving axis, at the end of the last step"),
)  # fmt: skip
"""`ACCOUNT`: entries behind `REFERENCE` in S if obstacles move. m: number of axes along which obstacles move."""


class Paths(NamedTuple):
    """Displacements of obstacles as functions of time, for the arms of an environment, each with its own time.

    at: offset of the `ACCOUNT` in S. axes: one zero for each row. rows: int64, row of q of each displacement.
    pieces, first: the functions of time, as in `model.Drive`
    """

    at: int
    axes: tuple[int, ...]
    rows: np.ndarray
    pieces: np.ndarray
    first: np.ndarray


class Touching(NamedTuple):
    """Points of an arm that may touch obstacles: a contribution. Sizes are tuples of zeros (compile-time constants).

    input: index in the arm's inputs of the first point's entries; each point has `entries`: force (N), moment (N m)
    at: offset in S of the first point's `HERE`
    points: one zero for each point of the arm that may touch obstacles
    entries: one zero for each entry of a point in the inputs: 3 in the plane, 6 in space
    space: one zero per axis of the obstacles: 2 in the plane, 3 in space
    axes: one zero per component of the force that is used: as `space`; with friction on a sphere also the moment
    room: one zero for each row (coordinate) of the Model
    poses: one zero per number that `kinematics.motions` writes for the arm
    links: int64 (points,), index of each point's link
    radii: float64 (points,), radius of the sphere about each point, m
    meets: float64 (points * obstacles,), 1 if the point may touch the obstacle, otherwise 0
    shapes: float64, one `physics.obstacles.OBSTACLE` per obstacle. laws: one `LAW` per obstacle
    moving: int64 (obstacles * 3,), row of each obstacle's displacement along x, y, z, or -1; None if no obstacle moves
    masses: float64 (points,), effective mass of each point in a step, kg (`build.effective_masses`)
    levers: float64 (n,), m or m/m, largest displacement of a point if a coordinate changes by 1. None: it is not known,
        and distances are computed in each Newton iteration
    extent: largest coordinate (m) of an obstacle or point from which distances are computed
    inside: (0,) if a point is along a link and not at its tip, otherwise None
    """

    input: int
    at: int
    points: tuple[int, ...]
    entries: tuple[int, ...]
    space: tuple[int, ...]
    axes: tuple[int, ...]
    room: tuple[int, ...]
    poses: tuple[int, ...]
    links: np.ndarray
    radii: np.ndarray
    meets: np.ndarray
    shapes: np.ndarray
    laws: np.ndarray
    masses: np.ndarray
    moving: np.ndarray | None = None
    levers: np.ndarray | None = None
    extent: float = 0.0
    inside: tuple[int, ...] | None = None


class Watch(NamedTuple):
    """Locations of the gaps of a model with contacts in S, for the integrator (`NewtonPolicy.contact`)."""

    points: tuple[int, ...]  # one zero per point that may touch
    at: int  # offset in S of the first point's `HERE`
    gap: int  # offset of the gap (m) within a `HERE`
    stride: int  # number of entries from one `HERE` to the next
    reach: float  # m: largest motion of a point for a weighted increment of 1 in every row
    free: tuple[int, ...] | None = None  # a tag if no support holds the arm, otherwise None
    paths: Paths | None = None  # moving obstacles of an environment; None in scenes, whose `Drive` moves them
