"""How stiff an arm may be beside what moves it for double precision to carry it (docs: theory, section 6).

An arm's forces are differences: of coordinates of the size of 1 (rad, lengths over L), which have 16 digits, times a
stiffness S (N m). With T, the torque that moves the arm, and sigma = S / T,

    rounding leaves forces of        eps sigma T          eps = 1.1e-16
    Newton's iteration leaves them of    tolerance sigma T    where a change of strains is of second order

so that the first must stay small, and the second is made so where the tolerance would not do. Damping has the stiffness
2 tau_d S / h by the increments of a step of h, and the matrix M + gamma h C + beta h^2 K the condition sigma (1 + 2
tau_d / h) times the turn of a step: no more where a step resolves the motion.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .. import validation as check
from ..parameters import Arm
from ..rigid import inertia_beyond, rigid_inertia
from ..scene import JointTorque, PointLoad, Scene
from ..scene.drives import FORCES
from ..sections import Link
from ..settings import Settings
from .elastica.chain import chain

MOST = 1e14
"""Largest sigma: eps times it is a hundredth of the torques; what was found at it is in docs/results/stability.md."""

SHARE = 100.0
"""Forces that Newton's iteration may leave where its tolerance is used up, over the torques: it hardly ever is. Beyond
that (metal arms are not) the tolerance is `LEFT` over sigma."""

TURNED = 10.0
"""rad: angles of the elastica are absolute, and it carries an arm that has turned so far."""

LEFT, FINEST = 1e-2, 1e-13
"""The second: a tolerance that increments still reach after a dozen turns of a joint."""

STILL = 1e-12
"""rad: an arm that turns by less stands still."""

ALIKE: Mapping[str, float] = {}
"""Factors on no stiffness."""

FASTEST = 2000
"""Instants at which a scene's motions and loads are looked at."""


class Stiffness(NamedTuple):
    """One of an arm's stiffnesses: key path, value and unit, and what it is as a torque, S, with damping, N m."""

    path: str
    value: float
    unit: str
    torque: float


def _sections(link: Link, space: bool) -> dict[str, float]:
    """Largest EI, EA, C of a link; in space GJ, EI_y, C_y, too."""
    s = np.linspace(0.0, link.length, 65) if link.uniform is None else np.zeros(1)
    properties = link.along(s)
    found = {name: float(getattr(properties, name).max()) for name in ("EI", "EA", "C")}
    if space:
        found |= {name: float(values.max()) for name, values in link.across(s).items() if name != "J_y"}
    return found


def stiffnesses(
    arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE, damping: float = 1.0, space: bool = False
) -> list[Stiffness]:
    """All that the formulation's forces have; factors: on EI, in space on EI_y and GJ; damping: on tau_d; space: of a
    scene in space."""
    found, bending = [], factors.get("EI", 1.0)
    assert settings.dt is not None
    slow = 1.0 + 2.0 * arm.damping[0] * damping / settings.dt
    for k, link in enumerate(arm.links):
        if link.rigid:
            continue
        has, at = _sections(link, space), f"links[{k}].section"
        bend = has["EI"] * bending / link.length
        if settings.formulation == "elastica" and not space:
            assert settings.nodes is not None
            bend = bending * TURNED * float(abs(chain(arm, settings.nodes).K[k]).sum())
        elif settings.modes is not None:
            bend *= (settings.modes * (settings.segments or 1)) ** 2
        found.append(Stiffness(f"{at}.EI", has["EI"], "N m^2", bend * slow))
        if settings.formulation != "elastica" and (settings.modes is None or space):
            found += [Stiffness(f"{at}.{name}", has[name], "N", has[name] * link.length * slow) for name in ("EA", "C")]
        if space:
            if settings.formulation != "elastica":
                found.append(Stiffness(f"{at}.C_y", has["C_y"], "N", has["C_y"] * link.length * slow))
            for name in ("EI_y", "GJ"):
                bend = has[name] * factors.get(name, 1.0) / link.length
                found.append(Stiffness(f"{at}.{name}", has[name], "N m^2", bend * slow))
        spring = arm.joint(k).stiffness
        if math.isfinite(spring):
            found.append(Stiffness(f"joints[{k}].stiffness", spring, "N m/rad", spring))
    return found


def largest(drawn: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Largest factors on EI, in space on EI_y and GJ, of ranges (low, high) by name (`batch.Starts`)."""
    EI, EI_y, GJ = (drawn.get(name, (1.0, 1.0))[1] for name in ("EI", "EI_y", "GJ"))
    return {"EI": EI, "EI_y": EI * EI_y, "GJ": GJ}


def ratio(
    arm: Arm, settings: Settings, torque: float, factors: Mapping[str, float] = ALIKE, damping: float = 1.0,
    space: bool = False,
) -> float:
    """Sigma of an arm that a torque (N m) moves; factors, damping, space: see `stiffnesses`.

    Raises:
        ValueError: it is above `MOST`; names the stiffness.
    """
    found = stiffnesses(arm, settings, factors, damping, space)
    if not found:
        return 0.0
    worst = max(found, key=lambda one: one.torque)
    sigma = worst.torque / torque
    if not sigma <= MOST:
        path, value, unit = worst.path, worst.value, worst.unit
        own = max(stiffnesses(arm, settings, space=space), key=lambda one: one.torque)
        name = path.rpartition(".")[2]
        name = "EI" if factors.get(name) == factors.get("EI") else name  # that is on EI_y too
        if factors.get(name, 1.0) != 1.0 and own.torque / torque <= MOST:
            path, value, unit = f"randomization.{name}[1]", factors[name], "times the arm's"
        raise check.InvalidValue(path, value, refusal(value * MOST / sigma, unit, settings, torque))
    return sigma


def refusal(most: float, unit: str, settings: Settings, torque: float) -> str:
    """What is allowed, and why."""
    way = "modes" if settings.modes is not None else settings.formulation
    return (
        f"must be at most {f'{most:.3g} {unit}'.strip()} under {way} with dt = {settings.dt:.3g} s and an arm that "
        f"{torque:.3g} N m move: double precision has 16 digits, which leave forces this stiff an error like "
        "what moves the arm; take less, a thousandth of it is as good as rigid"
        + (", or formulation='floating_frame'" if settings.formulation == "elastica" else "")
    )


def tolerance(given: float, sigma: float, turn: float = math.inf) -> float:
    """Of Newton's increments, at most as given; turn: what the torques turn a joint by in a step, rad, of whose square
    Newton's first increment leaves ten times."""
    return given if min(given, 10.0 * turn**2) * sigma <= SHARE else min(given, max(FINEST, LEFT / sigma))


def farthest(arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE) -> float:
    """Largest angle (rad) of a start that full torques still move the arm rightly from."""
    if settings.formulation != "elastica" or arm.torque_limits is None:
        return math.inf
    return TURNED * MOST / ratio(arm, settings, min(arm.torque_limits), factors)


def check_parameters(
    arm: Arm, settings: Settings, factors: Mapping[str, float], damping: float, spring: float, path: str
) -> None:
    """An arm that is given with factors (see `stiffnesses`), a tau_d (s) and a gear's stiffness (N m/rad), as in
    `ratio`.

    Raises:
        ValueError: it is too stiff; names `path`.
    """
    torque, h = min(arm.torque_limits or (math.inf,)), settings.dt
    assert h is not None
    if spring > MOST * torque:
        raise check.InvalidValue(f"{path}.stiffness", spring, refusal(MOST * torque, "N m/rad", settings, torque))
    worst = max(stiffnesses(arm, settings, factors, 0.0, arm.spatial), key=lambda one: one.torque)
    bent, name = worst.torque / (MOST * torque), worst.path.rpartition(".")[2]
    name = name if name in factors else "EI"
    slow = 1.0 + 2.0 * min(damping, arm.damping[0]) / h
    if bent * slow > 1.0:
        most = factors[name] / (bent * slow)
        raise check.InvalidValue(f"{path}.{name}_factor", factors[name], refusal(most, "", settings, torque))
    if bent * (1.0 + 2.0 * damping / h) > 1.0:
        most = 0.5 * h * (1.0 / bent - 1.0)
        raise check.InvalidValue(f"{path}.tau_d", damping, refusal(most, "s", settings, torque))


def of_torques(arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE, damping: float = 1.0) -> float:
    """Tolerance for an arm under its full torques, with factors up to these; refuses as `ratio`."""
    torques, h = arm.torque_limits or (math.inf,), settings.dt
    assert h is not None
    turn = max(torque * h**2 / inertia_beyond(arm, k) for k, torque in enumerate(torques))
    return tolerance(settings.tolerance, ratio(arm, settings, min(torques), factors, damping, arm.spatial), turn)


def of_scene(scene: Scene, settings: Settings) -> float:
    """Tolerance for a scene; refuses as `ratio`."""
    return tolerance(settings.tolerance, ratio(scene.arm, settings, moving(scene), space=scene.spatial))


def moving(scene: Scene) -> float:
    """The torque (N m) that moves a scene's arm: the largest of its loads, its weight, and what its motions ask for.

    Infinite where nothing turns it by `STILL` in the scene's time.
    """
    arm, reach = scene.arm, scene.arm.total_length
    inertia = float(rigid_inertia(arm, np.zeros((1, arm.n_links - 1)))[0, 0, 0])
    mass = arm.payload.mass + sum(link.mass for link in arm.links)
    t = np.union1d(np.linspace(0.0, scene.duration, FASTEST), [k for k in scene.kinks if k <= scene.duration])
    found = [inertia * rate**2 for rate in scene.rates]
    if scene.gravity is not None:
        found.append(mass * math.hypot(*scene.gravity) * reach)
    for load in scene.loads:
        if isinstance(load, JointTorque):
            found.append(float(abs(load.function(t)).max()))
        elif isinstance(load, PointLoad):
            forces = [(getattr(load, name), 1.0 if name.startswith("torque") else reach) for name in FORCES]
            found += [arm_ * float(abs(f(t)).max()) for f, arm_ in forces if f is not None]
    for motion in scene.motions:
        rate, acceleration = (abs(motion.function(t, order)).max() for order in (1, 2))
        weight = inertia if motion.joint is not None else mass
        size = 1.0 if motion.joint is not None else reach
        found.append(float(weight * (acceleration * size + rate**2)))
    largest = max(found, default=0.0)
    return largest if largest * scene.duration**2 > STILL * inertia else math.inf
