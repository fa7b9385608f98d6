"""Data records shared by the assembly of a model and by its kernels: Models, Scheme, Drive, System, status codes.

A Model is a NamedTuple of arrays and numbers, never written after assembly; each formulation has its own
(`FloatingFrame`, `ExactBeam`, `Elastica`). `physics/protocol.py` specifies the fields from n to newton that all Models
have. The state is q, v, a (accelerations) and b (the integrator's auxiliary acceleration), float64, one entry per row
of the system. A field that is None, or a tag (0,), selects terms of a kernel at compile time.
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
from .protocol import NewtonPolicy

OK, NEWTON_FAILED, DIVERGED, OUT_OF_RANGE, NOT_FINITE, TIMED_OUT = range(6)
STATUS = ("ok", "newton_failed", "diverged", "out_of_range", "not_finite", "timed_out")
"""Status codes of an arm (int), and STATUS, the name of each code in the same order."""

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
"""Message of each status code, in the order of the codes."""

PAYLOAD_MASS, PAYLOAD_INERTIA, STIFFNESS_FACTOR, TAU_D, EI_Y_FACTOR, GJ_FACTOR = range(6)
"""Entries of `par`, the parameters in which arms of a batch may differ: payload mass (kg), payload inertia (kg m^2; in
space a factor on the payload's tensor), factor on EI, tau_d (s); in space also factors on EI_y and GJ. The joints' laws
follow if a `Jointed` model has `own`."""
OWN = ("payload_mass", "payload_inertia", "EI_factor", "tau_d")
OWN_IN_SPACE = (*OWN, "EI_y_factor", "GJ_factor")
"""Names of the entries of `par`: OWN in the plane, OWN_IN_SPACE in space."""
STIFFNESSES = {"EI": STIFFNESS_FACTOR, "EI_y": EI_Y_FACTOR, "GJ": GJ_FACTOR}
"""Index in `par` of the factor on each stiffness of all sections; EI_y and GJ have factors in space only."""


def damped(arm: Arm) -> tuple[int, ...] | NDArray[np.float64] | None:
    """Return a Model's field `damped`: None without damping, (0,) for equal tau_d in all links, else their shares."""
    largest, shares = arm.damping
    return None if largest == 0.0 else (0,) if shares is None else np.array(shares)


def complete(model: Any) -> Any:
    """Return the model in the form that compiles the terms of all parameters in `par`, even of parameters that are 0.

    A batch or a derivative may then set payload mass, payload inertia and tau_d, although the arm itself has none.
    """
    if isinstance(model, Jointed):
        return model._replace(arm=complete(model.arm))
    if isinstance(model, FloatingFrame | FloatingChain):
        return model._replace(mesh=complete(model.mesh))
    # None leaves a term out, a tag (0,) includes it: one compiled kernel then serves all arms
    absent = [name for name in ("payload", "payload_turns", "damping", "damped") if getattr(model, name, 0) is None]
    return model._replace(**dict.fromkeys(absent, (0,)))


def levers(arm: Arm) -> NDArray[np.float64]:
    """Return the rigid ends of an arm's links, flat: a `layout.LEVER` (m, kg, kg m^2) for each link's root and tip."""
    found = []
    for k, link in enumerate(arm.links):
        far = arm.elbow(k + 1).mass if k + 1 < arm.n_links else 0.0
        found += [LEVER.pack({}, length=link.root_offset, mass=link.root_mass, inertia=link.root_inertia, far=0.0)]
        found += [LEVER.pack({}, length=link.tip_offset, mass=link.tip_mass, inertia=link.tip_inertia, far=far)]
    return np.concatenate(found)


class Scheme(NamedTuple):
    """Generalized-alpha or Newmark: coefficients of eq. (6.1) and limits of the Newton iteration; theory, section 6."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    tolerance: float  # of the error after a Newton increment, weighted by the Model's `weight` (rad, lengths over L)
    max_iterations: int
    max_halvings: int  # a failed step of h is tried down to h / 2^max_halvings
    modified: int | None  # 1: modified Newton, one matrix per step; None: as the Model reuses matrices


def scheme(
    rho_inf: float | None,
    newmark: tuple[float, float] | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 20,
    max_halvings: int = 8,
    modified: bool = False,
) -> Scheme:
    """Return the `Scheme` for a spectral radius rho_inf at infinite frequency, or of Newmark's method.

    The coefficients are those of Arnold & Bruels 2007. newmark: (beta, gamma) of eq. [66], which replaces rho_inf.
    modified: True for a modified Newton iteration, with one matrix per step.
    """
    if newmark is not None:
        alpha_m = alpha_f = 0.0
        beta, gamma = newmark
    else:
        assert rho_inf is not None
        # eq. (6.1): second order, and dissipative at high frequencies for rho_inf < 1
        alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        gamma = 0.5 + alpha_f - alpha_m
        beta = 0.25 * (gamma + 0.5) ** 2
    limits = (float(tolerance), int(max_iterations), int(max_halvings))
    return Scheme(float(alpha_m), float(alpha_f), float(beta), float(gamma), *limits, 1 if modified else None)


class Drive(NamedTuple):
    """Loads and prescribed motions of a scene as functions of time, for kernels.

    pieces      float64 (n_pieces * 8,): t0, c0..c3, A, w, p; value = sum c_k s^k + A sin(w s + p), s = t - t0 (s)
    first       int64 (n_functions + 1,): piece at which function f begins
    entries     int64 (n_terms,): entry of u to which a term is added; terms of one entry are adjacent; the caller sets
                entries without a term (actions)
    terms       int64 (n_terms,): function of each term
    known       int64 (n_motions,): row of the prescribed coordinate, or -1 - j where multiplier j prescribes it
    motions     int64 (n_motions,): function of each prescribed coordinate
    """

    pieces: np.ndarray
    first: np.ndarray
    entries: np.ndarray
    terms: np.ndarray
    known: np.ndarray
    motions: np.ndarray


class Mesh(NamedTuple):
    """Elastic coordinates of every body in a chain of floating frames, and the terms that their kernels contain.

    A field that is the tag (0,) includes a term, a field that is None omits the term.
    """

    n: int | tuple[int, ...]  # elastic coordinates of a body; a tuple of n zeros: kernels are unrolled for n
    scratch: tuple[int, ...]  # zeros: size of a stack array for `VECTORS` (floating/layout.py)
    window: tuple[int, ...]  # one zero per coordinate of an element, at most
    elements: tuple[int, ...]  # one zero per finite element of a body
    strains: tuple[int, ...]  # zeros: size of a stack array for one `STRAIN` per element
    modal: tuple[int, ...] | None  # reduced to modes, with foreshortening (theory, section 4)
    chord: tuple[int, ...] | None  # frame="chord": through both ends, rho (root rotation) is not zero
    full: tuple[int, ...] | None  # coupling="von_karman", eq. (1.2)
    damped: tuple[int, ...] | None  # (0,): tau_d > 0, eq. (1.3); (0, 0): each body has its own share of it
    drag: tuple[int, ...] | None  # mass_damping, proportional to mass
    curved: tuple[int, ...] | None  # links with curvature in their stress-free state


class FloatingFrame(NamedTuple):
    """Bodies of a `FloatingChain`, each with its own frame and joined by multipliers (3.4); one arm at a time.

    The fields from n to newton are explained in `protocol`; data, gravity and loads are those of `FloatingChain`.
    table  int64 (bodies, 5), one row per body: `physics.floating.layout.ROW`
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: np.ndarray
    weight: np.ndarray
    newton: NewtonPolicy
    half: int  # half width of the matrix's band
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
    """N links with the same number of bodies each, with floating frames, without multipliers (theory, section 3).

    Rows: x, y of the root and the angle of the root section, the elastic coordinates of each body from root to tip, and
    the angle of each elbow relative to the tip section before. The fields from n to newton are explained in `protocol`.

    data      float64: one `physics.floating.layout.BODY` per body
    gravity   float64 (2,) m/s^2 along inertial x, y, or None
    loads     int64: for each point load `physics.floating.layout.LOADED`, or None
    jointed   (0,) in a `Jointed` arm, otherwise None
    eccentric float64 (2,): from the tip to the payload's center, m, along the tip's tangent and across it, or None
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
    mesh: Mesh
    links: int
    segments: int  # bodies of a link
    block: int  # numbers of a body in `data`
    bound: float  # largest tip deflection of a reduced body over its length
    rigid: np.ndarray | None  # `LEVER` of each link's root and tip, where links have rigid ends
    table: None
    data: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None
    jointed: tuple[int, ...] | None
    eccentric: np.ndarray | None


class ExactBeam(NamedTuple):
    """N links with the same number of geometrically exact elements each (5.1). Neighboring elements share a vertex.

    The fields from n to newton are explained in `protocol`. A field that is None omits its terms from the kernels.

    order     tuple of p zeros: polynomial order, a compile-time constant
    varying   (0,) where sections vary along links, otherwise None
    sections  float64: for each link `physics.exact.layout.SECTION`, or for each element `VARYING`
    rest      float64 (order,) for each element: stress-free (right - left, interior ...) of psi, rad, or None
    rigid     float64: `physics.exact.layout.LEVERS` where links have rigid ends, otherwise None
    elbows    float64: for each link but the first `physics.exact.layout.ELBOW`
    hub_inertia  kg m^2, of the hub, which rotates with the root section
    damped    None without damping, (0,) if all links have the same tau_d, or each link's share (`damped`)
    gravity   float64 (2,) m/s^2, or None
    loads     int64: for each point load `physics.exact.layout.ROWS_OF_LOAD`, or None
    jointed   (0,) in a `Jointed` arm, otherwise None
    eccentric float64 (2,): from the tip to the payload's center, m, along the tip's tangent and across it, or None
    """

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
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
    """Chain of N links without stretch and shear (5.2), k nodes each: m = N k tangent angles from root to tip. SI.

    Rows: angles of the nodes (the first row of each link is the joint's angle, relative to the link before). If the
    root can move, x, y follow: of the root if it is prescribed, of the center of mass in free flight. The fields from n
    to newton are explained in `protocol`. Sizes are numbers, or tuples of as many zeros where the kernel is compiled
    for that size. One array holds all constants, because each array passed to a kernel costs time to compile and to
    call:

    data       float64: `physics.elastica.layout.DATA`
    loads      float64: for each point load `physics.elastica.layout.LOAD`, or None
    eccentric  float64: `physics.elastica.layout.ECCENTRIC` where the payload's center is not at the tip, else None
    rest       float64 (N k,): stress-free angles (rad) of nodes relative to their link's root; None for straight links
    bends      float64: `physics.elastica.layout.BENDS` where the law of M is not EI kappa, otherwise None
    """

    n: int | tuple[int, ...]
    n_factor: int | tuple[int, ...]
    n_inputs: int | tuple[int, ...]
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
    links: int | tuple[int, ...]  # N
    nodes: int | tuple[int, ...]  # k
    scratch: tuple[int, ...]  # at least N k zeros: size of a stack array
    root: tuple[int, ...] | None  # a tag where the root's position is among the rows
    gravity: tuple[int, ...] | None  # a tag where there is gravity
    payload: tuple[int, ...] | None  # a tag where there is a payload; without it its mass in `par` is not read
    payload_turns: tuple[int, ...] | None  # a tag where the payload has rotary inertia
    damping: tuple[int, ...] | np.ndarray | None  # None: no tau_d; (0,): all links alike; or each link's share
    data: np.ndarray
    loads: np.ndarray | None
    eccentric: np.ndarray | None
    rest: np.ndarray | None
    points: int | tuple[int, ...] | None  # rows of `bends`
    bends: np.ndarray | None


class Floating(NamedTuple):
    """A base that carries an arm and floats freely in the plane; its mass acts at the arm's root. SI.

    row      row of the base's attitude (rad), from the inertial x axis, 0 at the start
    inertia  kg m^2, of the base
    mass     kg: base and arm together, without the payload
    angles   int64: rows of angles from the inertial x axis, the attitude among them
    vectors  int64: pairs of rows of x and y in inertial axes, which turn with the arm
    places   int64: pairs of rows of x and y of positions (m)
    room     one zero per row of the system: size of a stack array
    """

    row: int
    inertia: float
    mass: float
    angles: np.ndarray
    vectors: np.ndarray
    places: np.ndarray
    room: tuple[int, ...]


class Gears(NamedTuple):
    """Rotors, elastic gears and viscous friction of an arm's joints; the `Jointed` Model holds their laws. SI units.

    play   (0,) where a gear has backlash, otherwise None
    spin   1 / gear ratio of each joint of an arm in space with rotors; otherwise None
    rotors int64: with `spin`, offset in S of each joint's `physics.layout.ROTOR`
    """

    play: tuple[int, ...] | None
    spin: np.ndarray | None
    rotors: np.ndarray | None


class Jointed(NamedTuple):
    """An arm of any formulation without multipliers (`arm`) with contributions, such as gears in its joints. SI.

    Rows: those of the arm, then the angle of each motor with an elastic gear (divided by the gear ratio, relative to
    the link before), then the attitude of a floating base. The fields from n to newton are explained in `protocol`.

    arm    the Model of the arm with ideal joints; bound: largest tip deflection of a link, divided by its length
    table  int64: `physics.joints.layout.PLACE` of each joint that is not ideal; data  float64: `LAW` of each
    own    if each arm has its own laws, in `par` and not in `data`: one zero per entry of `par` before the laws
    hub    (0,) if the laws add an inertia at the first joint, otherwise None
    contributions  records of the contributions (`physics.contributions`), such as `Gears` and `Floating`
    points     one zero per input of the arm, if a contribution acts on a point of the arm; otherwise None
    derived    (0,) where the compiler derives `vjp_residual` of the whole, otherwise None
    """

    n: int | tuple[int, ...]
    n_factor: int | tuple[int, ...]
    n_inputs: int | tuple[int, ...]
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
    bound: float
    arm: Any
    table: np.ndarray
    data: np.ndarray
    own: tuple[int, ...] | None
    hub: tuple[int, ...] | None = None
    contributions: tuple[Any, ...] = ()
    points: tuple[int, ...] | None = None
    derived: tuple[int, ...] | None = None


def has_play(model: Any) -> bool:
    """Return whether a gear of the model has backlash (`Gears.play`); False for an arm with ideal joints."""
    return any(isinstance(part, Gears) and part.play is not None for part in getattr(model, "contributions", ()))


Honours = dict[type, tuple[str, ...]]
"""Type of a formulation's `HONOURS`: for each class of an arm's description, the fields that the formulation models."""

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
"""Fields that every formulation takes into account, those of joints through `physics.joints`. (The elastica uses EA and
C to estimate the error of neglecting stretch and shear.)"""


def fixed_rows(scene: Scene, coordinates: Mapping[str, int]) -> NDArray[np.int64]:
    """Return a Model's `fixed` rows: angles of rigid joints, and the position of a pinned root without prescribed
    motion."""
    fixed = [coordinates[f"joint{k}"] for k in scene.rigid_joints]
    if scene.root == "pinned":
        fixed += [coordinates[name] for name in ("root_x", "root_y") if scene.motion_of(name) is None]
    return np.array(fixed, np.int64)


@dataclass(frozen=True)
class System:
    """An assembled scene: its Model, the arm's parameters, the start state, and the rows of named coordinates.

    par (4,), in space (6,): see PAYLOAD_MASS. q0, v0 (n,): state at t = 0 (m, rad; m/s, rad/s). coordinates: row of
    "joint0" ..., "root_x", "root_y"; a negative entry -1 - j: prescribed by multiplier j. names (n,): names of the
    rows. vectors (k, 2): rows of x and y of vectors in inertial axes that turn with the arm; absolute (k,): rows of
    angles from the inertial x axis; all other rows stay the same if the whole arm rotates. notes: error estimates that
    a formulation reports about itself, as fractions of the arm's length.
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
        """Return the System of an arm that starts at rest, v0 = 0, with `par` from its description."""
        par = np.array([arm.payload.mass, arm.payload.inertia, 1.0, arm.damping[0]])
        still = np.zeros(len(q0))
        return cls(model, par, q0, still, coordinates, tuple(names), tuple(vectors), tuple(absolute), notes or {})
