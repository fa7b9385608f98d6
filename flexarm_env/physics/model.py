"""The contract between the mechanics that assemble a model and the kernels that move it.

A Model is a NamedTuple of arrays and numbers, never written after assembly; each formulation has its own
(`FloatingFrame`, `ExactBeam`, `Elastica`). The state is q, v, a (accelerations) and b (the integrator's auxiliary
acceleration), float64, one entry a row of the system. `physics/protocol.py` says what a Model must hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..parameters import Arm, Base, Elbow, Joint, Link, Motor, Payload, Section, Taper
from ..scene import Scene
from ..sections import ENDS
from .layout import LEVER

OK, NEWTON_FAILED, DIVERGED, OUT_OF_RANGE, NOT_FINITE, TIMED_OUT = range(6)
STATUS = ("ok", "newton_failed", "diverged", "out_of_range", "not_finite", "timed_out")
"""Status words of an arm, in the order of their codes."""

MESSAGE = (
    "finished",
    "Newton's iteration did not converge at t = {t:.6g} s although the step {h:.3g} s was halved {halvings} times; "
    "take a smaller dt or a smaller rho_inf, or look for a load that is too large",
    "the solution diverged at t = {t:.6g} s: a floating body's tip deflects by more than its length, or energy "
    "appeared from nowhere; take more segments, coupling='von_karman', a smaller dt, or a smaller rho_inf (1 keeps for "
    "ever what a jump of a velocity leaves in vibrations that the steps do not resolve)",
    "the deflection at t = {t:.6g} s is beyond the range of the reduction to modes ({bound:.0%} of the length of a "
    "link or segment, less where its root has hardly any inertia); take more segments beside modes, the full model "
    "(segments, elements) or formulation='geometrically_exact'",
    "a value that is not finite appeared at t = {t:.6g} s",
    "the time allowed for the run was used up at t = {t:.6g} s",
)
"""Sentences of the status codes."""

PAYLOAD_MASS, PAYLOAD_INERTIA, STIFFNESS_FACTOR, TAU_D, EI_Y_FACTOR, GJ_FACTOR = range(6)
"""Entries of an arm's own parameters `par` (kg; kg m^2, in space a factor on the payload's tensor; factor on EI; s;
in space alone factors on EI_y and GJ): what may differ between arms of a batch; behind them, where a `Jointed` model
says so, the laws of its joints."""
OWN = ("payload_mass", "payload_inertia", "EI_factor", "tau_d")
OWN_IN_SPACE = (*OWN, "EI_y_factor", "GJ_factor")
"""Their names."""
STIFFNESSES = {"EI": STIFFNESS_FACTOR, "EI_y": EI_Y_FACTOR, "GJ": GJ_FACTOR}
"""Those of sections that have one, the last two in space."""


def damped(arm: Arm) -> tuple[int, ...] | NDArray[np.float64] | None:
    """A Model's field `damped`: None without tau_d, (0,) where the links have it alike, otherwise each link's share."""
    largest, shares = arm.damping
    return None if largest == 0.0 else (0,) if shares is None else np.array(shares)


def complete(model: Any) -> Any:
    """The model with the terms of all of an arm's own parameters, of those too that are 0 in it."""
    if isinstance(model, Jointed):
        return model._replace(arm=complete(model.arm))
    if isinstance(model, FloatingFrame | FloatingChain):
        return model._replace(mesh=complete(model.mesh))
    absent = [name for name in ("payload", "payload_turns", "damping", "damped") if getattr(model, name, 0) is None]
    return model._replace(**dict.fromkeys(absent, (0,)))


def levers(arm: Arm) -> NDArray[np.float64]:
    """A `layout.LEVER` for each link's root and tip."""
    found = []
    for k, link in enumerate(arm.links):
        far = arm.elbow(k + 1).mass if k + 1 < arm.n_links else 0.0
        found += [LEVER.pack({}, length=link.root_offset, mass=link.root_mass, inertia=link.root_inertia, far=0.0)]
        found += [LEVER.pack({}, length=link.tip_offset, mass=link.tip_mass, inertia=link.tip_inertia, far=far)]
    return np.concatenate(found)


class Scheme(NamedTuple):
    """Generalized-alpha or Newmark: its coefficients, and the limits of its Newton iteration (theory, section 6)."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    tolerance: float  # of a Newton increment, weighted by the Model's `weight`
    max_iterations: int
    max_halvings: int
    modified: int | None  # 1: modified Newton


def scheme(
    rho_inf: float | None,
    newmark: tuple[float, float] | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 20,
    max_halvings: int = 8,
    modified: bool = False,
) -> Scheme:
    """Coefficients from the spectral radius rho_inf (Arnold & Bruels 2007), or Newmark's (beta, gamma), eq. [66]."""
    if newmark is not None:
        alpha_m = alpha_f = 0.0
        beta, gamma = newmark
    else:
        assert rho_inf is not None
        alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        gamma = 0.5 + alpha_f - alpha_m
        beta = 0.25 * (gamma + 0.5) ** 2
    limits = (float(tolerance), int(max_iterations), int(max_halvings))
    return Scheme(float(alpha_m), float(alpha_f), float(beta), float(gamma), *limits, 1 if modified else None)


class Drive(NamedTuple):
    """Time functions of a scene. Row f of `first` says where function f's pieces begin.

    pieces      float64 (n_pieces * 8,): t0, c0..c3, A, w, p; value = sum c_k s^k + A sin(w s + p), s = t - t0
    first       int64 (n_functions + 1,)
    entries     int64 (n_terms,): entry of u that a term adds to; terms of one entry follow each other; an entry with no
                term is set from outside (an action)
    terms       int64 (n_terms,): function that a term adds
    known       int64 (n_motions,): the prescribed coordinate, or -1 - j where multiplier j prescribes it
    motions     int64 (n_motions,): function of each prescribed coordinate
    """

    pieces: np.ndarray
    first: np.ndarray
    entries: np.ndarray
    terms: np.ndarray
    known: np.ndarray
    motions: np.ndarray


class Mesh(NamedTuple):
    """The elastic coordinates that every body of a chain with floating frames has, and what there is of them.

    Tags: (0,) where something is there, None where it is not and is compiled out.
    """

    n: int | tuple[int, ...]  # elastic coordinates of a body; a tuple of n zeros: kernels are written out for n
    scratch: tuple[int, ...]  # zeros, room on the stack for `VECTORS` (floating/layout.py)
    window: tuple[int, ...]  # as many zeros as an element has coordinates at most
    elements: tuple[int, ...]  # as many zeros as a body has finite elements
    strains: tuple[int, ...]  # room for a `STRAIN` each
    modal: tuple[int, ...] | None  # reduced to modes, with foreshortening
    chord: tuple[int, ...] | None  # the frame goes through both ends: rho is not zero
    full: tuple[int, ...] | None  # coupling="von_karman"
    damped: tuple[int, ...] | None  # (0,): tau_d > 0, (0, 0): a body's own share of it
    drag: tuple[int, ...] | None  # damping that goes with mass
    curved: tuple[int, ...] | None  # bent without stress


class FloatingFrame(NamedTuple):
    """The bodies of a `FloatingChain`, each with a frame of its own, joined by multipliers; one arm at a time.

    table  int64 (bodies, 5), a row a body: `physics.floating.layout.ROW`
    data, gravity, loads  as `FloatingChain` has them
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: np.ndarray
    weight: np.ndarray
    predictor: float
    correction: None
    half: int  # half width of the band
    mesh: Mesh
    links: int
    segments: int  # bodies of a link
    block: int  # numbers of a body in `data`
    bound: float  # largest tip deflection of a reduced body over its length
    rigid: None
    eccentric: None
    table: np.ndarray
    data: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None


class FloatingChain(NamedTuple):
    """N links of equal numbers of bodies with floating frames, without multipliers (theory, section 3).

    Rows: x, y of the root and the angle of its section, the elastic coordinates of each body from root to tip, and the
    angles at the elbows, each relative to the tip section before it.

    data      float64: a block a body, `physics.floating.layout.BODY`
    gravity   float64 (2,) m/s^2 or None: absent features are compiled out
    loads     int64: for each point load `physics.floating.layout.LOADED`, or None
    jointed   (0,) in a `Jointed` arm, otherwise None
    eccentric float64 (2,): from the tip to the payload's centre, m, along the tip's tangent and across it, or None
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: float | tuple[float, float]
    correction: None
    mesh: Mesh
    links: int
    segments: int  # bodies of a link
    block: int  # numbers of a body in `data`
    bound: float  # largest tip deflection of a reduced body over its length
    rigid: np.ndarray | None  # of each link's root and tip a `LEVER`, where links have rigid ends
    table: None
    data: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None
    jointed: tuple[int, ...] | None
    eccentric: np.ndarray | None


class ExactBeam(NamedTuple):
    """N links of equal numbers of geometrically exact elements, a link's vertices shared with its neighbours.

    order     tuple of p zeros: polynomial order, a compile-time constant
    varying   (0,) where sections vary along links, otherwise None
    sections  float64: for each link `physics.exact.layout.SECTION`, or for each element `VARYING`
    rest      float64 (order,) for each element: its (right - left, interior ...) in psi without stress, or None
    rigid     float64: `physics.exact.layout.LEVERS` where links have rigid ends, otherwise None
    elbows    float64: for each link but the first `physics.exact.layout.ELBOW`
    damped    see `damped`
    gravity   float64 (2,) m/s^2, or None
    loads     int64: for each point load `physics.exact.layout.ROWS_OF_LOAD`, or None
    jointed   (0,) in a `Jointed` arm, otherwise None
    eccentric float64 (2,): from the tip to the payload's centre, m, along the tip's tangent and across it, or None

    What is None is compiled out.
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: float | None
    correction: float | None
    order: tuple[int, ...]
    links: int
    elements: int
    varying: tuple[int, ...] | None
    sections: np.ndarray
    rest: np.ndarray | None
    elbows: np.ndarray
    rigid: np.ndarray | None
    hub_inertia: float
    damped: tuple[int, ...] | np.ndarray | None
    gravity: np.ndarray | None
    loads: np.ndarray | None
    jointed: tuple[int, ...] | None
    eccentric: np.ndarray | None


class Elastica(NamedTuple):
    """A chain of N links with k nodes each: m = N k tangent angles, numbered from root to tip. SI.

    Rows: angles of the nodes (the first of each link the joint's, relative), then x, y where the root can move: the
    root's where it is prescribed, the centre of mass's in free flight.
    Sizes are numbers, or tuples of zeros of that length where the kernel is compiled for that size. One array holds
    all constants, because each array passed to a kernel costs time to compile and to call:

    data   float64: `physics.elastica.layout.DATA`
    loads  float64: for each point load `physics.elastica.layout.LOAD`, or None
    eccentric  float64: `physics.elastica.layout.ECCENTRIC` where the payload's centre is not at the tip, otherwise None
    rest   float64 (N k,): angles of the nodes without stress from that of their link's root, or None: straight links
    bends  float64: `physics.elastica.layout.BENDS` where the law of M is not EI kappa, otherwise None
    """

    n: int | tuple[int, ...]
    n_factor: int | tuple[int, ...]
    n_inputs: int | tuple[int, ...]
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: tuple[float, float]
    correction: None
    links: int | tuple[int, ...]  # N
    nodes: int | tuple[int, ...]  # k
    scratch: tuple[int, ...]  # at least N k zeros: room on the stack
    root: tuple[int, ...] | None  # a tag where the root's position is among the rows
    gravity: tuple[int, ...] | None  # a tag where there is gravity
    payload: tuple[int, ...] | None  # a tag where there is a payload; without it its mass in `par` is not read
    payload_turns: tuple[int, ...] | None  # likewise for its rotary inertia
    damping: tuple[int, ...] | np.ndarray | None  # see `damped`
    data: np.ndarray
    loads: np.ndarray | None
    eccentric: np.ndarray | None
    rest: np.ndarray | None
    points: int | tuple[int, ...] | None  # rows of `bends`
    bends: np.ndarray | None


class Floating(NamedTuple):
    """A base that carries an arm and floats freely; its mass is the arm's, at the root. SI.

    row      its attitude's: from the inertial x axis, 0 at the start
    inertia  kg m^2; mass  kg: of all but the payload
    angles   int64: rows of angles from the inertial x axis, this among them
    vectors  int64: pairs of rows of x and y in inertial axes; places  those of them that are places
    room     as many zeros as there are rows
    """

    row: int
    inertia: float
    mass: float
    angles: np.ndarray
    vectors: np.ndarray
    places: np.ndarray
    room: tuple[int, ...]


class Jointed(NamedTuple):
    """An arm of any formulation without multipliers (`arm`), and what turns its joints (`physics.joints`). SI.

    Rows: the arm's, then the angle of each motor behind an elastic gear, over its ratio, relative to the link before,
    then the attitude of a base that floats.

    table  int64: for each joint that is not ideal `physics.joints.layout.PLACE`; data  float64: `LAW` each
    friction  (0,) where a joint has Coulomb friction, otherwise None
    play   (0,) where a gear has backlash, otherwise None
    spin   in space, where there are rotors, of each of these joints one over its gear's ratio; otherwise None
    own    where the laws are each arm's own and not those of `data`: zeros, as many as `par` has before them; or None
    hub    (0,) where these have a hub behind the gear of the first of the joints, otherwise None
    base   what the first joint turns the arm against, where that floats; otherwise None
    """

    n: int | tuple[int, ...]
    n_factor: int | tuple[int, ...]
    n_inputs: int | tuple[int, ...]
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    predictor: float | tuple[float, float] | None
    correction: float | None
    bound: float
    arm: Any
    table: np.ndarray
    data: np.ndarray
    friction: tuple[int, ...] | None
    play: tuple[int, ...] | None
    spin: np.ndarray | None
    own: tuple[int, ...] | None
    hub: tuple[int, ...] | None = None
    base: Floating | None = None


Honours = dict[type, tuple[str, ...]]
"""Of what an arm is made of, the classes and the fields that a formulation takes into account (its `HONOURS`)."""

BEAM: Honours = {
    Arm: ("links", "hub_inertia", "elbows", "payload", "tau_d", "joints", "base"),
    Link: ("length", "section", "tau_d", *ENDS, "curvature"),
    Section: ("EI", "EA", "C", "m", "J"),
    Taper: ("widths", "thicknesses", "E", "rho", "G", "kappa"),
    Elbow: ("mass", "inertia_left", "inertia_right"),
    Joint: (
        "stiffness", "damping", "motor_inertia", "gear_ratio", "friction_viscous", "friction_coulomb", "friction_side",
        "backlash", "motor",
    ),
    Motor: ("torque_constant", "resistance", "back_emf", "current_limit", "voltage_limit"),
    Payload: ("mass", "inertia", "offset"),
    Base: ("mass", "inertia"),
}  # fmt: skip
"""What every formulation honours, those of joints by way of `physics.joints`. (The elastica honours EA and C in that it
tells what leaving them out costs.)"""


def fixed_rows(scene: Scene, coordinates: Mapping[str, int]) -> NDArray[np.int64]:
    """A Model's `fixed` where the root's place is in its rows: rigid joints, a pinned root that no motion moves."""
    fixed = [coordinates[f"joint{k}"] for k in scene.rigid_joints]
    if scene.root == "pinned":
        fixed += [coordinates[name] for name in ("root_x", "root_y") if scene.motion_of(name) is None]
    return np.array(fixed, np.int64)


@dataclass(frozen=True)
class System:
    """An assembled scene: its Model, the arm's own parameters, the start, and where coordinates stand.

    par  (4,), in space (6,): see PAYLOAD_MASS and so on. q0, v0 (n,): state at t = 0. coordinates: row of "joint0" ...,
    "root_x", "root_y" (a negative entry -1 - j: prescribed by multiplier j). names (n,): of the rows.
    vectors (k, 2): rows of x and y in inertial axes of what turns with the arm; absolute (k,): rows of angles from the
    inertial x axis; nothing else turns with it.
    notes: figures that a formulation reports about its own limits, as fractions of the arm's length.
    """

    model: Any
    par: NDArray[np.float64]
    q0: NDArray[np.float64]
    v0: NDArray[np.float64]
    coordinates: dict[str, int]
    names: tuple[str, ...]
    vectors: tuple[tuple[int, int], ...]
    absolute: tuple[int, ...]
    notes: Mapping[str, float]

    @classmethod
    def of(
        cls, arm: Arm, model: Any, q0: NDArray[np.float64], coordinates: dict[str, int], names: Sequence[str],
        vectors: Sequence[tuple[int, int]], absolute: Sequence[int], notes: Mapping[str, float] | None = None,
    ) -> System:  # fmt: skip
        """That of an arm which starts without motion."""
        par = np.array([arm.payload.mass, arm.payload.inertia, 1.0, arm.damping[0]])
        still = np.zeros(len(q0))
        return cls(model, par, q0, still, coordinates, tuple(names), tuple(vectors), tuple(absolute), notes or {})
