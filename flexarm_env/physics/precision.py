"""Largest stiffness of an arm for double precision, relative to the torque that moves the arm (theory, section 6).

The forces in an arm are differences of coordinates of size 1 (rad, lengths over L), which have 16 digits, times a
stiffness S (N m). With the torque T (N m) that moves the arm and the ratio sigma = S / T,

    rounding leaves forces of            eps sigma T          eps = 1.1e-16
    Newton's iteration leaves forces of  tolerance sigma T    where strains depend nonlinearly on coordinates

The rounding forces must stay small, which limits sigma. A smaller tolerance keeps Newton's forces small if necessary.
Damping adds the stiffness 2 tau_d S / h for increments in a step h. The condition number of the matrix M + gamma h C +
beta h^2 K is sigma (1 + 2 tau_d / h) times the rotation (rad) in a step. If steps resolve the motion, the condition
number is at most sigma.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .. import validation as check
from ..parameters import Arm
from ..rigid import inertia_beyond
from ..scene import JointTorque, PointLoad, Scene
from ..scene.drives import FORCES
from ..sections import Link
from ..settings import Settings
from .elastica.chain import chain

MOST = 1e14
"""Largest stiffness ratio sigma: rounding then leaves forces of a hundredth of the torques. Measurements:
docs/results/stability.md."""

SHARE = 100.0
"""Largest forces, divided by the torques, that Newton's iteration may leave if its error equals the tolerance (a rare
case). If the forces would be larger, which does not occur for metal arms, the tolerance is `LEFT` divided by sigma."""

TURNED = 10.0
"""Largest angle (rad) by which an elastica may rotate. The angles of an elastica are absolute and lose digits as they
increase."""

LEFT, FINEST = 1e-2, 1e-13
"""LEFT is the remaining force under the smaller tolerance, divided by the torques. FINEST is the smallest tolerance;
Newton increments still reach it after a dozen turns of a joint."""

STILL = 1e-12
"""Smallest rotation (rad) within a scene's time. An arm that rotates by a smaller angle counts as standing still."""

ALIKE: Mapping[str, float] = {}
"""Factors on the stiffnesses of an unmodified arm, all equal to 1."""

FASTEST = 2000
"""Number of instants at which a scene's motions and loads are sampled for their maxima."""


class Stiffness(NamedTuple):
    """A stiffness of an arm: key path, value, unit, and `torque`, the stiffness as a torque S (N m) with damping."""

    path: str
    value: float
    unit: str
    torque: float


def _sections(link: Link, space: bool) -> dict[str, float]:
    """Return the largest EI (N m^2), EA and C (N) along a link. In space, add GJ, EI_y (N m^2) and C_y (N)."""
    s = np.linspace(0.0, link.length, 65) if link.uniform is None else np.zeros(1)
    properties = link.along(s)
    found = {name: float(getattr(properties, name).max()) for name in ("EI", "EA", "C")}
    if space:
        found |= {name: float(values.max()) for name, values in link.across(s).items() if name != "J_y"}
    return found


def stiffnesses(
    arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE, damping: float = 1.0, space: bool = False
) -> list[Stiffness]:
    """Return one `Stiffness` for every stiffness in the forces of the formulation that the settings name.

    factors: factors on EI, in space also on EI_y and GJ.
    damping: factor on tau_d.
    space: whether the scene is in space.
    """
    found, bending = [], factors.get("EI", 1.0)
    assert settings.dt is not None
    # damping resists an increment of a step like a stiffness 2 tau_d S / h
    slow = 1.0 + 2.0 * arm.damping[0] * damping / settings.dt
    for k, link in enumerate(arm.links):
        if link.rigid:
            continue
        has, at = _sections(link, space), f"links[{k}].section"
        # bending, S in N m: EI / L; elastica: 10 sum |K_ij|; n modes in each of k segments: (n k)^2 EI / L
        bend = has["EI"] * bending / link.length
        if settings.formulation == "elastica" and not space:
            assert settings.nodes is not None
            bend = bending * TURNED * float(abs(chain(arm, settings.nodes).K_EI[k]).sum())
        elif settings.modes is not None:
            bend *= (settings.modes * (settings.segments or 1)) ** 2
        found.append(Stiffness(f"{at}.EI", has["EI"], "N m^2", bend * slow))
        # stretch and shear: EA L, C L; absent in the elastica and, in the plane, with modes
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
    """Return the largest factors on EI, EI_y and GJ within their ranges. The factor on EI also multiplies EI_y.

    drawn: range (low, high) of each factor by name (`batch.Starts`).
    """
    EI, EI_y, GJ = (drawn.get(name, (1.0, 1.0))[1] for name in ("EI", "EI_y", "GJ"))
    return {"EI": EI, "EI_y": EI * EI_y, "GJ": GJ}


def ratio(
    arm: Arm,
    settings: Settings,
    torque: float,
    factors: Mapping[str, float] = ALIKE,
    damping: float = 1.0,
    space: bool = False,
) -> float:
    """Return sigma = S / T of an arm that a torque T (N m) moves, with its largest stiffness S; 0 if it has none.

    factors, damping, space: as in `stiffnesses`.

    Raises:
        ValueError: sigma is above `MOST`. The message names the stiffness, or the randomized factor that makes it too
        large.
    """
    found = stiffnesses(arm, settings, factors, damping, space)
    if not found:
        return 0.0
    worst = max(found, key=lambda one: one.torque)
    sigma = worst.torque / torque
    if not sigma <= MOST:
        path, value, unit = worst.path, worst.value, worst.unit
        # blame the factor if sigma of the arm without factors is allowed, otherwise the arm
        own = max(stiffnesses(arm, settings, space=space), key=lambda one: one.torque)
        name = path.rpartition(".")[2]
        # EI_factor scales EI_y as well, which may be the stiffer axis
        name = "EI" if factors.get(name) == factors.get("EI") else name
        if factors.get(name, 1.0) != 1.0 and own.torque / torque <= MOST:
            path, value, unit = f"randomization.{name}[1]", factors[name], "times the arm's"
        raise check.InvalidValue(path, value, refusal(value * MOST / sigma, unit, settings, torque))
    return sigma


def refusal(most: float, unit: str, settings: Settings, torque: float) -> str:
    """Return an error message that names the largest allowed value `most` (in `unit`) and the reason for the limit."""
    way = "modes" if settings.modes is not None else settings.formulation
    return (
        f"must be at most {f'{most:.3g} {unit}'.strip()} under {way} with dt = {settings.dt:.3g} s and an arm that "
        f"{torque:.3g} N m move: double precision has 16 digits, which leave forces this stiff an error like "
        "what moves the arm; take less, a thousandth of it is as good as rigid"
        + (", or formulation='floating_frame'" if settings.formulation == "elastica" else "")
    )


def tolerance(given: float, sigma: float, turn: float = math.inf) -> float:
    """Return the Newton tolerance (largest weighted increment) for an arm of stiffness ratio sigma, at most `given`.

    turn: angle (rad) by which the torques rotate a joint in one step. The error after the first Newton increment is ten
    times turn^2.
    """
    return given if min(given, 10.0 * turn**2) * sigma <= SHARE else min(given, max(FINEST, LEFT / sigma))


def farthest(arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE) -> float:
    """Return the largest joint angle (rad) of a start from which motion under full torques is accurate enough."""
    if settings.formulation != "elastica" or arm.torque_limits is None:
        return math.inf
    return TURNED * MOST / ratio(arm, settings, min(arm.torque_limits), factors)


def check_parameters(
    arm: Arm, settings: Settings, factors: Mapping[str, float], damping: float, spring: float, path: str
) -> None:
    """Check the stiffness ratio of an arm with other parameters; `factors` as in `stiffnesses`.

    damping: tau_d of the arm, s. spring: stiffness of its gears, N m/rad.

    Raises:
        ValueError: the arm's stiffness ratio is above `MOST`. The message names `path` and the parameter to change.
    """
    torque, h = min(arm.torque_limits or (math.inf,)), settings.dt
    assert h is not None
    if spring > MOST * torque:
        raise check.InvalidValue(f"{path}.stiffness", spring, refusal(MOST * torque, "N m/rad", settings, torque))
    # sigma at tau_d = 0, over the largest allowed one: above 1 the stiffness factor alone is to blame
    worst = max(stiffnesses(arm, settings, factors, 0.0, arm.spatial), key=lambda one: one.torque)
    bent, name = worst.torque / (MOST * torque), worst.path.rpartition(".")[2]
    name = name if name in factors else "EI"
    # too stiff with the smaller of both dampings: the stiffness factor is to blame, otherwise tau_d
    slow = 1.0 + 2.0 * min(damping, arm.damping[0]) / h
    if bent * slow > 1.0:
        most = factors[name] / (bent * slow)
        raise check.InvalidValue(f"{path}.{name}_factor", factors[name], refusal(most, "", settings, torque))
    if bent * (1.0 + 2.0 * damping / h) > 1.0:
        most = 0.5 * h * (1.0 / bent - 1.0)
        raise check.InvalidValue(f"{path}.tau_d", damping, refusal(most, "s", settings, torque))


def of_torques(arm: Arm, settings: Settings, factors: Mapping[str, float] = ALIKE, damping: float = 1.0) -> float:
    """Return the Newton tolerance of an arm under full torques, with stiffness `factors`; raises as `ratio`."""
    torques, h = arm.torque_limits or (math.inf,), settings.dt
    assert h is not None
    # angle that the torque turns each joint in a step, tau h^2 / I of the straight arm beyond it
    turn = max(torque * h**2 / inertia_beyond(arm, k) for k, torque in enumerate(torques))
    return tolerance(settings.tolerance, ratio(arm, settings, min(torques), factors, damping, arm.spatial), turn)


def of_scene(scene: Scene, settings: Settings) -> float:
    """Return the Newton tolerance of a scene, with the torque T = `moving(scene)`; raise ValueError as `ratio`."""
    return tolerance(settings.tolerance, ratio(scene.arm, settings, moving(scene), space=scene.spatial))


def moving(scene: Scene) -> float:
    """Return the torque (N m) that moves a scene's arm: the largest of loads, weight and inertia torques of motions.

    The result is infinite if no torque rotates the arm by `STILL` within the scene's time.
    """
    arm, reach = scene.arm, scene.arm.total_length
    inertia = inertia_beyond(arm, 0)
    mass = arm.payload.mass + sum(link.mass for link in arm.links)
    t = np.union1d(np.linspace(0.0, scene.duration, FASTEST), [k for k in scene.kinks if k <= scene.duration])
    # T (N m): I w^2 of the spin at the start; m g L; loads, with forces at the arm's reach; prescribed motions
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
