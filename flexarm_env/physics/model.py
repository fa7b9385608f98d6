"""Data records shared by the assembly of a model and by its kernels: Models, Scheme, Drive, System, status codes.

A Model is a NamedTuple of arrays and numbers, never written after assembly; each formulation has its own
(`FloatingFrame`, `ExactBeam`, `Elastica`). `physics/protocol.py` specifies the fields from n to newton that all Models
have. The state is q, v, a (accelerations) and b (the integrator's auxiliary acceleration), float64, one entry per row
of the system. A field that is None, or a tag (0,), selects terms of a kernel at compile time."""

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
    "the deflection at t = {t:.6g} s is beyond the valid range of the reduction to modes ({bound:.0%} of the length of "
    "a link or segment, less where its root has hardly any inertia); take more segments beside modes, the full model "
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
    """Return the model in the form whose kernels contain the terms of all parameters in `par`, even if they are 0.

    A batch or a derivative may then set payload mass, payload inertia and tau_d, although the arm itself has none."""
    if isinstance(model, Jointed):
        return model._replace(arm=complete(model.arm))
    if isinstance(model, FloatingFrame | FloatingChain):
        return model._replace(mesh=complete(model.mesh))
    # None leaves a term out, a tag (0,) includes it: one compiled kernel then serves all arms
    absent = [name for name in ("payload", "payload_turns", "damping", "damped") if getattr(model, name, 0) is None]
    return model._replace(**dict.fromkeys(absent, (0,)))


def levers(arm: Arm) -> NDArray[np.float64]:
    """Return the rigid ends of an arm's links as a flat array: one `layout.LEVER` for each link's root and tip."""
    found = []
    for k, link in enumerate(arm.links):
        far = arm.elbow(k + 1).mass if k + 1 < arm.n_links else 0.0
        found += [LEVER.pack({}, length=link.root_offset, mass=link.root_mass, inertia=link.root_inertia, far=0.0)]
        found += [LEVER.pack({}, length=link.tip_offset, mass=link.tip_mass, inertia=link.tip_inertia, far=far)]
    return np.concatenate(found)


class Scheme(NamedTuple):
    """Coefficients of the generalized-alpha or Newmark method, equation (6.1), and limits of the Newton iteration."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    tolerance: float  # largest error after a Newton increment, weighted by the Model's `weight` (rad, lengths over L)
    max_iterations: int
    max_halvings: int  # limit of repeated halvings: a failed step h is repeated down to h / 2^max_halvings
    modified: int | None  # 1: modified Newton, one matrix per step; None: the Model's `newton` decides


def scheme(
    rho_inf: float | None,
    newmark: tuple[float, float] | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 20,
    max_halvings: int = 8,
    modified: bool = False,
) -> Scheme:
    """Return the `Scheme` for a spectral radius rho_inf at infinite frequency, or for Newmark's method.

    The coefficients are those of Arnold & Bruels 2007. newmark: (beta, gamma) of equation [66], used instead of
    rho_inf.
    modified: True for a modified Newton iteration, with one matrix per step."""
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

    pieces: float64 (n_pieces * 8,), t0, c0..c3, A, w, p of each piece; value = sum c_k s^k + A sin(w s + p), s = t - t0
    (s)
    first: int64 (n_functions + 1,), index of the piece at which function f begins
    entries: int64 (n_terms,), entry of u to which a term is added. Terms of the same entry are adjacent. The caller
    sets entries without a term (actions).
    terms: int64 (n_terms,), index of the function of each term
    known: int64 (n_motions,), row of the prescribed coordinate, or -1 - j if multiplier j prescribes it
    motions: int64 (n_motions,), index of the function of each prescribed coordinate"""

    pieces: np.ndarray
    first: np.ndarray
    entries: np.ndarray
    terms: np.ndarray
    known: np.ndarray
    motions: np.ndarray


class Mesh(NamedTuple):
    """Sizes that all bodies of a chain of floating frames share, and tags that select terms of their kernels.

    If a field is the tag (0,), the kernels contain the term. If the field is None, they omit the term."""

    n: int | tuple[int, ...]  # number of elastic coordinates of a body; if a tuple of zeros, kernels are unrolled
    scratch: tuple[int, ...]  # zeros: length of a stack array for `VECTORS` (floating/layout.py)
    window: tuple[int, ...]  # one zero per coordinate of an element: largest window
    elements: tuple[int, ...]  # one zero per finite element of a body: their number
    strains: tuple[int, ...]  # zeros: length of a stack array for one `STRAIN` per element
    modal: tuple[int, ...] | None  # tag: bodies are reduced to modes, with foreshortening (theory, section 4)
    chord: tuple[int, ...] | None  # tag: frame="chord", through both ends; the root rotation rho is not zero
    full: tuple[int, ...] | None  # tag: coupling="von_karman", eq. (1.2)
    damped: tuple[int, ...] | None  # (0,): tau_d > 0, eq. (1.3); (0, 0): each body has its own share of tau_d
    drag: tuple[int, ...] | None  # tag: mass_damping, damping proportional to mass
    curved: tuple[int, ...] | None  # tag: links are curved in their stress-free state


class FloatingFrame(NamedTuple):
    """Bodies of a `FloatingChain`, each with its own frame, joined by multipliers (3.4). Kernels compute a single arm.

    `protocol` explains the fields from n to newton; `data`, `gravity` and `loads` are those of `FloatingChain`.
    table: int64 (bodies, 5), one row of `physics.floating.layout.ROW` per body"""

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: np.ndarray
    weight: np.ndarray
    newton: NewtonPolicy
    half: int  # half width of the band of the Newton matrix
    mesh: Mesh
    links: int
    segments: int  # number of bodies of a link
    block: int  # number of entries of a body in `data`
    bound: float  # largest tip deflection of a body reduced to modes, divided by its length
    rigid: None
    eccentric: None
    table: np.ndarray
    data: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None


class FloatingChain(NamedTuple):
    """N links of floating frames without multipliers; each link has the same number of bodies (theory, section 3).

    Rows: x, y of the root; angle of the root section; elastic coordinates of each body from root to tip; angle of each
    elbow relative to the preceding tip section. `protocol` explains the fields from n to newton.

    data: float64, one `physics.floating.constants.BODY` per body
    gravity: float64 (2,), m/s^2 along inertial x and y, or None
    loads: int64, one `physics.floating.layout.LOADED` per point load, or None
    jointed: (0,) in a `Jointed` arm, otherwise None
    eccentric: float64 (2,), distance (m) from the tip to the payload's center along and across the tip's tangent, or
    None
    inside: (0,) if a point load acts between two bodies of a link, otherwise None"""

    n: int
    n_factor: int
    n_inputs: int
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
    mesh: Mesh
    links: int
    segments: int  # number of bodies of a link
    block: int  # number of entries of a body in `data`
    bound: float  # largest tip deflection of a body reduced to modes, divided by its length
    rigid: np.ndarray | None  # `LEVER` of each link's root and tip if links have rigid ends, otherwise None
    table: None
    data: np.ndarray
    gravity: np.ndarray | None
    loads: np.ndarray | None
    jointed: tuple[int, ...] | None
    eccentric: np.ndarray | None
    inside: tuple[int, ...] | None = None


class ExactBeam(NamedTuple):
    """N links, each with the same number of geometrically exact elements (5.1). Neighboring elements share a vertex.

    `protocol` explains the fields from n to newton. If a field is None, the kernels omit its terms.

    order: tuple of p zeros for the polynomial order p, a compile-time constant
    varying: (0,) if sections vary along links, otherwise None
    sections: float64, `physics.exact.layout.SECTION` for each link, or `VARYING` for each element
    rest: float64 (order,) for each element, stress-free (right - left, interior ...) of psi in rad, or None
    rigid: float64, `physics.exact.layout.LEVERS` if links have rigid ends, otherwise None
    elbows: float64, one `physics.exact.layout.ELBOW` for each link but the first
    hub_inertia: moment of inertia (kg m^2) of the hub, which rotates with the root section
    damped: None without damping, (0,) if all links have the same tau_d, otherwise each link's share (see `damped`)
    gravity: float64 (2,), m/s^2, or None
    loads: int64, one `physics.exact.layout.ROWS_OF_LOAD` per point load, or None
    jointed: (0,) in a `Jointed` arm, otherwise None
    eccentric: float64 (2,), distance (m) from the tip to the payload's center along and across the tip's tangent, or
    None"""

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
    """Chain of N links without stretch and shear (5.2). A link has k nodes, the chain m = N k tangent angles. SI units.

    Rows: angles of the nodes from root to tip. The first row of each link is the joint's angle, relative to the
    preceding link. If the root can move, x and y follow: of the root if its motion is prescribed, of the center of mass
    in free flight. `protocol` explains the fields from n to newton. Sizes are numbers, or tuples of as many zeros if
    the kernel is compiled for that size. One array contains all constants, because each array argument of a kernel
    costs time at compilation and at each call.

    data: float64, constants of the chain (`physics.elastica.chain.DATA`)
    loads: float64, one `physics.elastica.layout.LOAD` per point load, or None
    eccentric: float64, `physics.elastica.layout.ECCENTRIC` if the payload's center is not at the tip, otherwise None
    rest: float64 (N k,), stress-free angles (rad) of nodes relative to their link's root; None for straight links
    bends: float64, `physics.elastica.layout.BENDS` if the law of M is not EI kappa, otherwise None"""

    n: int | tuple[int, ...]
    n_factor: int | tuple[int, ...]
    n_inputs: int | tuple[int, ...]
    fixed: np.ndarray
    algebraic: None
    weight: np.ndarray
    newton: NewtonPolicy
    links: int | tuple[int, ...]  # number of links N
    nodes: int | tuple[int, ...]  # number of nodes k of a link
    scratch: tuple[int, ...]  # at least N k zeros: length of a stack array
    root: tuple[int, ...] | None  # tag: the root's position is among the rows
    gravity: tuple[int, ...] | None  # tag: there is gravity
    payload: tuple[int, ...] | None  # tag: there is a payload; if None, the payload mass in `par` is not read
    payload_turns: tuple[int, ...] | None  # tag: the payload has rotary inertia
    damping: tuple[int, ...] | np.ndarray | None  # None: no damping; (0,): equal tau_d in all links; else shares
    data: np.ndarray
    loads: np.ndarray | None
    eccentric: np.ndarray | None
    rest: np.ndarray | None
    points: int | tuple[int, ...] | None  # number of rows of `bends`
    bends: np.ndarray | None


class Floating(NamedTuple):
    """A base that carries an arm and floats freely in the plane; the base's mass acts at the arm's root. SI units.

    row: row of the base's attitude (rad) from the inertial x axis, 0 at the start
    inertia: moment of inertia (kg m^2) of the base about its center of mass
    mass: mass (kg) of base and arm together, without the payload
    angles: int64, rows of angles from the inertial x axis, including the attitude
    vectors: int64, pairs of rows of x and y (inertial axes) of vectors that rotate with the arm
    places: int64, pairs of rows of x and y (m) of positions
    room: one zero per row of the system, the length of a stack array"""

    row: int
    inertia: float
    mass: float
    angles: np.ndarray
    vectors: np.ndarray
    places: np.ndarray
    room: tuple[int, ...]


class Gears(NamedTuple):
    """Rotors, elastic gears and viscous friction of an arm's joints, whose laws the `Jointed` Model contains. SI units.

    play: (0,) if a gear has backlash, otherwise None
    spin: 1 / gear ratio of each joint of an arm in space with rotors, otherwise None
    rotors: int64, offset in S of each joint's `physics.layout.ROTOR`; used with `spin`"""

    play: tuple[int, ...] | None
    spin: np.ndarray | None
    rotors: np.ndarray | None


class Jointed(NamedTuple):
    """An arm of any formulation without multipliers, with contributions such as gears in its joints. SI units.

    Rows: rows of the arm; angle of each motor with an elastic gear (divided by the gear ratio, relative to the
    preceding link); attitude of a floating base. `protocol` explains the fields from n to newton.

    arm: Model of the arm with ideal joints. bound: largest tip deflection of a link, divided by its length
    table: int64, `physics.joints.layout.PLACE` of each joint that is not ideal. data: float64, `LAW` of each of these
    joints
    own: if each arm has its own laws in `par` (not in `data`), one zero per entry of `par` before the laws; otherwise
    None
    hub: (0,) if the laws add an inertia at the first joint, otherwise None
    contributions: records of the contributions (`physics.contributions`), such as `Gears` and `Floating`
    points: one zero per input of the arm if a contribution acts on a point of the arm, otherwise None
    derived: (0,) if the compiler derives `vjp_residual` of the whole Model, otherwise None"""

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
    """Return whether a gear of the model has backlash (`Gears.play`). The result is False if all joints are ideal."""
    return any(isinstance(part, Gears) and part.play is not None for part in getattr(model, "contributions", ()))


Honours = dict[type, tuple[str, ...]]
"""Type of a formulation's `HONOURS`: for each class that describes an arm, the fields that the formulation models."""

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
"""Fields that every formulation models, those of joints through `physics.joints`. The elastica uses EA and C only to
estimate the error of neglecting stretch and shear."""


def fixed_rows(scene: Scene, coordinates: Mapping[str, int]) -> NDArray[np.int64]:
    """Return a Model's `fixed` rows: angles of rigid joints, and the position of a pinned root that cannot move."""
    fixed = [coordinates[f"joint{k}"] for k in scene.rigid_joints]
    if scene.root == "pinned":
        fixed += [coordinates[name] for name in ("root_x", "root_y") if scene.motion_of(name) is None]
    return np.array(fixed, np.int64)


@dataclass(frozen=True)
class System:
    """An assembled scene: its Model, the arm's parameters, the start state, and the rows of named coordinates.

    par (4,), in space (6,): parameters of the arm (see PAYLOAD_MASS).
    q0, v0 (n,): state at t = 0 (m, rad; m/s, rad/s).
    coordinates: rows of "joint0" ..., "root_x", "root_y"; a negative entry -1 - j means that multiplier j prescribes
    the coordinate.
    names (n,): names of the coordinates.
    vectors (k, 2): rows of x and y of vectors in inertial axes that rotate with the arm.
    absolute (k,): rows of angles from the inertial x axis. All other rows stay the same if the whole arm rotates.
    notes: error estimates of the formulation by name, as fractions of the arm's length."""

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
