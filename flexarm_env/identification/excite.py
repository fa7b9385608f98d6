"""Design torques for identification experiments that excite the arm's modes and keep a real arm within given bounds.

The design begins with a motion of the rigid arm. The joint accelerations of this motion are multisines with random
phases (Schroeder 1970; Ljung 1999, section 13.3); each joint has its own frequencies. The motion begins and ends at
rest, at the same joint angles. The inverse dynamics of the rigid arm give the torques for the motion. Simulations then
apply these torques to the flexible arm and to several arms with perturbed parameters. The torques are reduced until the
joint rotations and deflections of every simulated arm are within the bounds.
"""

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.files import write_text
from flexarm_env.linear import modes as modes_of
from flexarm_env.parameters import Arm
from flexarm_env.rigid import coriolis, rigid_inertia
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.sections import Section, Taper
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import linear_table
from flexarm_env.validation import Array

LINES = 12
"""Number of frequencies per joint."""
SLOWEST = 3.0
"""Number of periods of the lowest frequency in the whole excitation."""
BEYOND = 1.4
"""Highest frequency, divided by that of the highest mode to be excited."""
FASTEST = 0.2
"""Upper limit of all frequencies, divided by the sampling rate."""
TAPER = 0.1
"""Duration of the fade-in, and of the fade-out, divided by the whole duration."""
TRIES = 8


@dataclass(frozen=True)
class Excitation:
    """Excitation torques and the simulated motion that they cause.

    Attributes:
        t (n,): instants, s, evenly spaced. torques (n, N): joint torques, N m, each constant until the next instant.
        band: lowest and highest excited frequency, rad/s. modes (M,): natural frequencies of the arm with free joints
            that lie in the band, rad/s.
        angle: largest joint rotation from the initial angle, rad, of the arm and of the arms with perturbed parameters.
            deflection: largest tip deflection of a link in any of these arms, divided by the link's length.
    """

    t: Array
    torques: Array
    band: tuple[float, float]
    modes: Array
    angle: float
    deflection: float

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file atomically with the columns t, torque0, .... Raises OSError if writing fails."""
        names = ["t", *(f"torque{k}" for k in range(self.torques.shape[1]))]
        rows = (",".join(f"{x:.12g}" for x in row) for row in np.column_stack([self.t, self.torques]).tolist())
        write_text(Path(path), "\n".join([",".join(names), *rows]) + "\n")


def excite(
    arm: str | os.PathLike[str] | Arm, *, seconds: float = 20.0, rate: float = 100.0, modes: int = 2,
    most_angle: float = 0.5, most_torque: float | None = None, most_deflection: float = 0.15, drawn: int = 8,
    spread: float = 2.0, seed: int = 0, **options: Any,
) -> Excitation:  # fmt: skip
    """Design torques that excite an arm's modes within bounds; `flexarm run FILE.csv --to HOST:PORT` applies the
    torques.

    Args:
        arm: approximate model of the arm: an `Arm`, a name or a TOML file. The arm starts straight, at rest, without
            gravity.
        seconds: duration of the signal, s. rate: frequency at which torques change, Hz. modes: number of flexible modes
            to excite; no frequency exceeds a fifth of `rate`. most_angle: largest joint rotation to either side, rad.
            most_torque: largest joint torque, N m; default: half of each joint's limit. most_deflection: largest tip
            deflection of a link, divided by the link's length.
        drawn: number of arms with perturbed parameters, which must also satisfy the bounds. spread: largest factor by
            which EI, tip masses, hub inertia and damping of these arms are multiplied or divided. seed: seed of phases
            and perturbed arms. options: solver options, as in `simulate`.
    Raises:
        ValueError: a value is invalid, or the arm has no torque limits and most_torque is not given.
    """
    given = arms.resolve(arm)
    given.axes.check_planar("arm", given.name, "must move in the x-y plane, for which excitations are made")
    seconds = check.number("seconds", seconds, "s", above=0.0, maximum=600.0)
    rate = check.number("rate", rate, "Hz", above=0.0, maximum=10_000.0)
    angle = check.number("most_angle", most_angle, "rad", above=0.0, maximum=float(np.pi))
    bending = check.number("most_deflection", most_deflection, above=0.0)
    count, draws = check.integer("modes", modes, minimum=1), check.integer("drawn", drawn, minimum=0)
    factor = check.number("spread", spread, minimum=1.0)
    if most_torque is not None:
        most = np.full(given.n_links, check.number("most_torque", most_torque, "N m", above=0.0))
    elif given.torque_limits is not None:
        most = 0.5 * np.array(given.torque_limits)
    else:
        raise check.InvalidValue("most_torque", most_torque, "must be given: the arm has no torque limits")
    rng = np.random.default_rng(check.integer("seed", seed, minimum=0))
    scene = Scene("excited", given, duration=seconds, dt=0.25 / rate)
    options = {"formulation": "elastica", "nodes": 5, "estimate_error": False, **options}
    # frequency band: from SLOWEST periods in the record to beyond the last mode, limited by the rate
    found = modes_of(scene, given.n_links + count, options["formulation"], nodes=5).frequencies[given.n_links :]
    low, fastest = 2.0 * np.pi * SLOWEST / seconds, 2.0 * np.pi * FASTEST * rate
    within = found[found < fastest]
    high = min(BEYOND * within[-1], fastest) if len(within) else fastest
    if high < 2.0 * low:
        what = f"must be above {4.0 * np.pi * SLOWEST / high:.3g} s, or the rate higher: no frequencies lie in between"
        raise check.InvalidValue("seconds", seconds, what)
    t = np.arange(round(seconds * rate) + 1) / rate
    motion = _motion(t, given.n_links, low, high, rng)
    lot = [given, *(_drawn(given, factor, rng) for _ in range(draws))]
    torques = _torques(given, motion, min(1.0, angle))
    torques *= min(1.0, float((most / np.abs(torques).max(axis=0)).min()))
    for _ in range(TRIES):
        turned, bent = np.array([_reach(one, scene, t, torques, options) for one in lot]).max(axis=0)
        if turned <= angle and bent <= bending:
            return Excitation(t, torques, (low, high), within, float(turned), float(bent))
        torques = torques * 0.95 * min(1.0, angle / turned, bending / bent)
    what = f"must be more for {given.name}: none of the tried torques stays within it and most_deflection"
    raise check.InvalidValue("most_angle", most_angle, what)


def _motion(t: Array, joints: int, low: float, high: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Generate angles, rates, accelerations (n, joints) of a rigid arm, at rest at both ends, largest angle 1.

    t (n,): instants, s. low, high: lower and upper end of the frequency band, rad/s. Angles are sums of sin(w t +
        phase) / w^2, multiplied by a smooth window.
    """
    length = t[-1]
    wanted = np.geomspace(low, high, LINES * joints) * length / (2.0 * np.pi)
    numbers = np.maximum.accumulate(np.round(wanted)) + 0.0
    # whole periods in the record, all different
    for k in range(1, len(numbers)):
        numbers[k] = max(numbers[k], numbers[k - 1] + 1.0)
    w = 2.0 * np.pi * numbers / length
    # window: 10 e^3 - 15 e^4 + 6 e^5 at both ends, with its first and second derivative
    edge = np.clip(np.minimum(t, length - t) / (TAPER * length), 0.0, 1.0)
    speed = np.where(t < 0.5 * length, 1.0, -1.0) * (edge < 1.0) / (TAPER * length)
    window = edge**3 * (10.0 - 15.0 * edge + 6.0 * edge**2)
    slope = speed * 30.0 * edge**2 * (1.0 - edge) ** 2
    bend = speed**2 * 60.0 * edge * (1.0 - edge) * (1.0 - 2.0 * edge)
    q, v, a = (np.zeros((len(t), joints)) for _ in range(3))
    for k, line in enumerate(w):
        # product rule: each line goes to one joint in turn
        phase = line * t + rng.uniform(0.0, 2.0 * np.pi)
        s, c = np.sin(phase) / line**2, np.cos(phase) / line
        joint = k % joints
        q[:, joint] += window * s
        v[:, joint] += slope * s + window * c
        a[:, joint] += bend * s + 2.0 * slope * c - window * np.sin(phase)
    size = np.abs(q).max()
    return q / size, v / size, a / size


def _torques(arm: Arm, motion: tuple[Array, Array, Array], angle: float) -> Array:
    """Return the inverse dynamics of the rigid arm (n, N), N m, for a motion scaled to a largest angle `angle`, rad."""
    q, v, a = (angle * x for x in motion)
    torques: Array = np.einsum("njk,nk->nj", rigid_inertia(arm, q), a) + coriolis(arm, q, v)
    return torques


def _drawn(arm: Arm, spread: float, rng: np.random.Generator) -> Arm:
    """Draw a perturbed arm: stiffness, payload, hub inertia and damping each times a random factor 1/spread ...
    spread.
    """
    stiff, heavy, hub, damping = spread ** rng.uniform(-1.0, 1.0, 4)
    payload = dataclasses.replace(arm.payload, mass=heavy * arm.payload.mass, inertia=heavy * arm.payload.inertia)
    links = tuple(dataclasses.replace(link, section=_stiffer(link.section, stiff)) for link in arm.links)
    return dataclasses.replace(
        arm, links=links, payload=payload, hub_inertia=hub * arm.hub_inertia, tau_d=damping * arm.tau_d
    )


def _stiffer(section: Any, factor: float) -> Any:
    """Scale the bending stiffness of a section, a taper, or a list of (place, section)."""
    if isinstance(section, Section):
        return dataclasses.replace(section, EI=factor * section.EI)
    if isinstance(section, Taper):
        return dataclasses.replace(section, E=factor * section.E, G=factor * section.G)
    return tuple((place, _stiffer(one, factor)) for place, one in section)


def _reach(arm: Arm, scene: Scene, t: Array, torques: Array, options: dict[str, Any]) -> tuple[float, float]:
    """Simulate an arm under the torques (n, N); return largest joint rotation, rad, and tip deflection over length.

    Both results are inf if the simulation fails.
    """
    loads = tuple(JointTorque(k, linear_table(t, torques[:, k])) for k in range(arm.n_links))
    run = simulate(dataclasses.replace(scene, arm=arm, loads=loads), sample=float(t[1]), **options)
    if not run.finished:
        return np.inf, np.inf
    return float(np.abs(run.joint_angles).max()), float(np.abs(run.tip_deflection).max())
