"""Assembly of a chain of elasticas: scene and settings -> Model, names and rows; theory (5.2) and (5.3).

The coordinates of N links with n nodes each are Nn tangent angles, then x, y of the root or of the center of mass.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.compiler import size
from flexarm_env.parameters import Payload, Section
from flexarm_env.physics.elastica.chain import DATA, Chain, Line, chain
from flexarm_env.physics.elastica.layout import BENDS, ECCENTRIC, LOAD
from flexarm_env.physics.elastica.slenderness import Notes
from flexarm_env.physics.layout import OF_LOAD
from flexarm_env.physics.linalg import product, solve
from flexarm_env.physics.materials import BENDING, bending
from flexarm_env.physics.model import BEAM, Elastica, System, damped
from flexarm_env.physics.protocol import NewtonPolicy
from flexarm_env.scene import InnerLoad, PointLoad, Scene
from flexarm_env.settings import Settings

Array = NDArray[np.float64]

HONOURS = {**BEAM, Section: (*BEAM[Section], *BENDING)}
"""Fields of an arm's dataclasses that the elastica models; `assembly` rejects an arm that sets other fields."""

UNROLLED = 12
"""Largest number of nodes of a chain whose kernels are compiled for its sizes."""

HEAVIER = 1.0 / 60.0
"""Coefficient 1/60 of the added inertia. It increases a mode's inertia by the fraction (omega h)^4 / 60 (theory, 5.3;
`phase_correction`)."""

NO_PART = 1e-9
"""Largest error of the correction C in a rigid rotation, as a fraction of the link's inertia. If the error is larger, C
is computed from differences of angles."""


def bends(parts: Chain) -> Array:
    """Pack `layout.BENDS`: EI, dkappa/dphi and law constants at all quadrature points, for a nonlinear law of M."""
    EI, slopes, own = [], [], []
    for k, line in enumerate(parts.lines):
        s, weights = line.quadrature()
        sections, slope = line.link.along(s), np.zeros((s.size, parts.w.size))
        # kappa = slope . phi, by the nodes of this link alone
        slope[:, k * parts.n : (k + 1) * parts.n] = line.slope(s)
        EI.append(sections.EI * weights)
        slopes.append(slope)
        own.append(np.array([getattr(sections, name) for name in BENDING]).reshape(-1, s.size).T)
    values = {"EI": np.concatenate(EI), "slope": np.concatenate(slopes), "own": np.concatenate(own)}
    return BENDS.pack({"points": len(values["EI"]), "nodes": parts.w.size}, **values)


def phase_correction(
    parts: Chain, payload: float, arm: NDArray[Any], rest: Array | None, h: float, settings: Settings
) -> Array:
    """Compute C = M - M* of theory (5.3), (N, n, n) kg m^2: a correction of the rotary inertia for steps of h (s).

    C is subtracted from the rotary inertia. The integrator lengthens a period by the fraction kappa (omega h)^2. In
    modes that the step resolves, the inertia M - 2 kappa h^2 K compensates this error. The correction makes all other
    modes heavier. Otherwise kinks and centrifugal forces of a swinging arm would excite noise of growing energy in
    these modes. No mode keeps an omega h much above sqrt(120 kappa), which is 3.2 for trapezoidal steps. With the mass
    matrix M of one link, including the masses at its tip,

        C = M - (M + h^4 / 60 K M^-1 K) (M + 2 kappa h^2 K)^-1 M

    The correction C does not affect rigid motion, momentum or statics. In very stiff links rounding would disturb rigid
    motion, momentum and statics. C is then computed from differences of angles, K = D^T k D, with F = D M^-1 D^T:

        C = D^T ((a + b / a) (k^-1 + a F)^-1 - b / a k) D,   a = 2 kappa h^2, b = h^4 / 60

    payload: mass of the payload, kg.
    arm (Nn,): weights from `payload_arm`, m.
    rest: stress-free node angles (Nn,), rad, or None if links are straight.
    """
    n, C = parts.n, np.zeros_like(parts.R)
    lengthening, share = 2.0 * settings.period_error * h * h, HEAVIER * h**4
    for k in range(len(parts.lines)):
        # M_ij = P_ij cos(phi_i - phi_j) + R_ij of link k, at the angles phi without stress
        own = slice(k * n, (k + 1) * n)
        P, to = parts.P[own, own], arm[own]
        if rest is not None:
            P, to = P * np.cos(rest[own][:, None] - rest[own]), to * np.exp(1j * rest[own])
        M = P + parts.R[k] + payload * np.outer(to.conj(), to).real
        K = parts.K_EI[k]
        # C = (2 kappa h^2 K - h^4/60 K M^-1 K) (M + 2 kappa h^2 K)^-1 M
        heavier = share * product(K, solve(M, K))
        C[k] = product(lengthening * K - heavier, solve(M + lengthening * K, M))
        # rigid motion: C 1 = 0 up to rounding
        if not abs(C[k].sum(axis=0)).max() <= NO_PART * M.sum():
            D, ratio = np.eye(n)[1:] - np.eye(n)[0], share / lengthening
            F, one = product(D, solve(M, D.T)), np.eye(n - 1)
            slow = solve(solve(K[1:, 1:], one) + lengthening * F, one)
            C[k] = product(product(D.T, (lengthening + ratio) * slow - ratio * K[1:, 1:]), D)
    return np.asarray(0.5 * (C + C.transpose(0, 2, 1)))


def physical(model: Elastica) -> Elastica:
    """Return the model with the links' physical inertia (C added back to R), for frequencies and linear equations."""
    data = model.data.copy()
    parts = DATA.unpack(data, 0, links=size(model.links), nodes=size(model.nodes), points=0)
    parts["R"] += parts["C"]
    parts["C"][:] = 0.0
    return model._replace(data=data)


def _end(chain_: Chain, load: PointLoad) -> dict[str, Array]:
    """Return the fields `arm` (m) and `angle` of `layout.LOAD` for a point load on a link."""
    line = chain_.lines[load.link]
    s = line.length * load.place if isinstance(load, InnerLoad) else _ends(line)[load.end == "tip"]
    return {"arm": chain_.arms_to(load.link, np.array([s]))[0], "angle": chain_.angle_at(load.link, s)}


def tag(n: int, compiled_in: bool) -> int | tuple[int, ...]:
    """Return n in the form of a Model's size field: a tuple of n zeros (a compile-time constant), or the number n."""
    return (0,) * n if compiled_in else n


def build(scene: Scene, settings: Settings, points: int = 12) -> System:
    """Assemble model, parameters and initial state of a scene with ``settings.nodes`` tangent angles a link.

    A small chain that only inputs drive, as in an environment, gets a kernel compiled for its sizes and features, such
    as payload and damping. All other chains share one kernel with every feature, in which fixed coordinates represent a
    pinned root. The notes of the System contain "stretch_and_shear", the estimated error of neglecting stretch and
    shear (`slenderness.py`). ``points``: number of intervals into which the drawn centerline of a link is divided.
    """
    assert settings.nodes is not None
    arm, n = scene.arm, settings.nodes
    parts = chain(arm, n)
    count, m = arm.n_links, arm.n_links * n
    own = m <= UNROLLED and scene.undriven
    movable = [scene.root == "free" or scene.motion_of(name) is not None for name in ("root_x", "root_y")]
    # rows of q: phi_i of all nodes, then x, y (inertial axes) of a root that is not fixed
    has_root = any(movable) or not own
    rows = m + (2 if has_root else 0)
    fixed = [joint * n for joint in scene.rigid_joints]
    fixed += [m + i for i in range(2) if has_root and not movable[i]]
    # weights w_i: a point at root + sum_i w_i (cos phi_i, sin phi_i), for loads, link tips and points drawn
    sizes = {"links": count, "nodes": n}
    ends = [LOAD.pack(sizes, **_end(parts, load)) for load in scene.loads if isinstance(load, PointLoad)]
    tips = np.concatenate([line.tip_angle for line in parts.lines])
    stations = np.concatenate([parts.arms_to(k, _stations(line, points, k)) for k, line in enumerate(parts.lines)])
    # M - M* (5.3), which belongs to one time step: none where settings.dt is None
    correction, carried, rest = np.zeros_like(parts.R), payload_arm(parts, arm.payload), parts.rest
    if settings.dt is not None:
        correction = phase_correction(parts, arm.payload.mass, carried, rest, settings.dt, settings)
    # free flight: the last rows are the center of mass, c = root + sum beta_j e_j, because it moves without the angles
    beta = np.zeros(m)
    if scene.root == "free":
        beta = (parts.b + arm.payload.mass * carried) / (parts.mass + arm.payload.mass)
    data = DATA.pack(
        {**sizes, "points": len(stations)},
        P=parts.P, R=parts.R - correction, K_EI=parts.K_EI, b=parts.b, w=parts.w, tips=tips, beta=beta.real,
        mass=parts.mass, root=scene.position, gravity=scene.gravity or (0.0, 0.0), C=correction, points=stations,
    )  # fmt: skip
    # tags: the shared kernel contains every term, a small chain's own kernel only the terms of its arm
    damping = damped(arm)
    if damping is None and not own:
        damping = (0,)
    model = Elastica(
        n=tag(rows, own),
        n_factor=tag(rows * rows, own),
        n_inputs=tag(count + OF_LOAD.end * len(ends), own),
        fixed=np.array(fixed, dtype=np.int64),
        algebraic=None,
        weight=np.concatenate([np.ones(m), np.full(rows - m, 1.0 / arm.total_length)]),
        newton=NewtonPolicy(acceleration_share=1.0, first_error=10.0, resolved=(0,)),
        links=tag(count, own),
        nodes=tag(n, own),
        scratch=(0,) * (m if own else 48 * -(-m // 48)),
        root=(0,) if has_root else None,
        gravity=None if own and scene.gravity is None else (0,),
        payload=None if own and not arm.payload.mass else (0,),
        payload_turns=None if own and not arm.payload.inertia else (0,),
        damping=damping,
        data=data,
        loads=None if own and not ends else np.concatenate([np.zeros(0), *ends]),
        eccentric=_eccentric(arm.payload, carried, beta),
        rest=rest,
        points=None if bending is None else tag(sum(len(line.quadrature()[0]) for line in parts.lines), own),
        bends=None if bending is None else bends(parts),
    )
    # phi without stress; the last rows are root + sum beta_j e_j, in free flight the center of mass (inertial axes)
    names, coordinates = _names(count, n, has_root, "centre" if scene.root == "free" else "root")
    angles = np.repeat(scene.angles, n) if rest is None else np.repeat(scene.angles, n) + rest
    centre = scene.position + product([np.cos(angles), np.sin(angles)], beta.real)
    if arm.payload.eccentric:
        centre = centre + product([-np.sin(angles), np.cos(angles)], beta.imag)
    q0 = np.concatenate([angles, centre if has_root else ()]).astype(np.float64)
    for k in range(1, count):
        q0[k * n] = scene.initial_value(f"joint{k}")
    vectors = ((m, m + 1),) if has_root else ()
    absolute = tuple(row for row in range(m) if row == 0 or row % n)  # joints behind the first are relative
    return System.of(arm, model, q0, coordinates, names, vectors, absolute, Notes(scene, n))


def payload_arm(parts: Chain, payload: Payload) -> NDArray[Any]:
    """Return weights w (Nn,), m: sum_j w_j e_j leads from root to payload. Complex for a center off the tip."""
    if not payload.eccentric:
        return parts.w
    to = parts.w.astype(np.complex128)
    to[-parts.n :] += payload.lever * parts.lines[-1].tip_angle
    return to


def _eccentric(payload: Payload, arm: NDArray[Any], beta: NDArray[Any]) -> Array | None:
    """Pack `layout.ECCENTRIC` from complex weights (m) of the payload and of the center of mass; None at the tip."""
    if not payload.eccentric:
        return None
    return ECCENTRIC.pack({"nodes": arm.size}, along=arm.real, across=arm.imag, beta=beta.imag)


def _ends(line: Line) -> tuple[float, float]:
    """Return the positions s (m from the beam's root) of a link's two joints; rigid ends lie between joint and beam."""
    return 0.0 - line.link.root_offset, line.length + line.link.tip_offset


def _stations(line: Line, points: int, link: int) -> Array:
    """Return positions s (m) for drawing a link: the ends of equal intervals.

    The joint between two links is a station of the first link.
    """
    s: Array = np.linspace(*_ends(line), points + 1)
    return s if link == 0 else s[1:]


def _names(count: int, n: int, has_root: bool, point: str) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return the names of all rows, and a dict with the rows of joint angles and of the point ("root" or "centre")."""
    names = [f"phi{k}_{i}" for k in range(count) for i in range(n)]
    coordinates = {f"joint{k}": k * n for k in range(count)}
    for k in range(count):
        names[k * n] = f"joint{k}"
    if has_root:
        coordinates |= {f"{point}_x": count * n, f"{point}_y": count * n + 1}
        names += [f"{point}_x", f"{point}_y"]
    return tuple(names), coordinates
