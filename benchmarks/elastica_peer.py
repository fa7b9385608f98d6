"""Compare with PyElastica: the one-link validation scenes on its Cosserat rods in a plane (extra: bench).

PyElastica's rod has positions at nodes and directors at elements. PyElastica's step is explicit position Verlet and is
limited by the fastest wave. Stiffness, mass and rotary inertia equal those of the package. PyElastica's stiffnesses
change with stretch, while the package's do not; the difference is of the order of the stretch. Forces on the root act
on its first node, and torques on its first element. Directors are in the middle of elements. Where the root's angle is
prescribed, the rod therefore begins half an element before the root, so that the middle of its first element is at the
root. Two-link systems are omitted, because PyElastica joins links by penalty springs.
"""

import math
import time
from typing import Any

import numpy as np

from flexarm_env.parameters import Section
from flexarm_env.scene import Scene
from flexarm_env.scenes import named

SCENES = (
    "robot_arm_motion_smooth", "robot_arm_motion", "robot_arm_torque", "flying_rod", "flying_rod_soft", "spin_up",
)  # fmt: skip


def longest_step(section: Section, dx: float) -> float:
    """Return the largest stable step, s: 2 / omega for the highest frequency omega of a chain of elements of length dx.

    Stretch: 2 sqrt(EA/m) / dx. Shear with rotation: omega^2 is at most 4 (C/m + EI/J) / dx^2 + C/J.
    """
    stretch = 4.0 * section.EA / section.m / dx**2
    shear = 4.0 * (section.C / section.m + section.EI / section.J) / dx**2 + section.C / section.J
    return 2.0 / math.sqrt(max(stretch, shear))


def element(scene: Scene, elements: int) -> float:
    """Return the length of an element, m; a rod with a prescribed root angle begins half an element before the root."""
    return scene.arm.links[0].length / (elements - (0.5 if scene.motion_of("joint0") else 0.0))


def steps_of(name: str, elements: int, share: float) -> int:
    """Return the number of steps of a run whose step is the given share of the longest stable step."""
    scene = named(name)
    dt = share * longest_step(scene.arm.links[0].section, element(scene, elements))
    return math.ceil(scene.sample / dt) * round(scene.duration / scene.sample)


def _rod(scene: Scene, elements: int) -> Any:
    """Make a PyElastica rod with the link's section; the first director is the normal of the plane."""
    import elastica

    link, angle = scene.arm.links[0], scene.angles[0]
    section, dx = link.section, element(scene, elements)
    along = np.array([math.cos(angle), math.sin(angle), 0.0])
    before = 0.5 * dx if scene.motion_of("joint0") else 0.0
    rod = elastica.CosseratRod.straight_rod(
        elements,
        start=np.array([*scene.position, 0.0]) - before * along,
        direction=along,
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=elements * dx, base_radius=math.sqrt(1.0 / math.pi), density=section.m,
        youngs_modulus=section.EA, shear_modulus=section.C,
    )  # fmt: skip
    for k in range(3):
        rod.shear_matrix[k, k] = section.EA if k == 2 else section.C
        rod.bend_matrix[k, k] = section.EI
        rod.mass_second_moment_of_inertia[k, k] = section.J * dx
        rod.inv_mass_second_moment_of_inertia[k, k] = 1.0 / (section.J * dx)
    return rod


def _simulator(scene: Scene, rod: Any, before: float) -> Any:
    """Return a simulator of the rod with the scene's support, motion and loads.

    before: distance, m, of the first node before the root if the root's angle is prescribed.
    """
    import elastica

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing):
        """What the scene needs."""

    motion = scene.motion_of("joint0")
    start = np.array([*scene.position, 0.0])

    class Root(elastica.ConstraintBase):
        """The first node pinned; or it and the first element turned about the root by the motion."""

        def constrain_values(self, system: Any, time: float) -> None:
            system.position_collection[:, 0] = start
            if motion is not None:
                c, s = math.cos(motion(float(time))), math.sin(motion(float(time)))
                system.position_collection[:2, 0] -= (before * c, before * s)
                system.director_collection[:, :, 0] = ((0.0, 0.0, 1.0), (s, -c, 0.0), (c, s, 0.0))

        def constrain_rates(self, system: Any, time: float) -> None:
            system.velocity_collection[:, 0] = 0.0
            if motion is not None:
                angle, rate = motion(float(time)), motion(float(time), 1)
                system.velocity_collection[:2, 0] = (before * rate * math.sin(angle), -before * rate * math.cos(angle))
                system.omega_collection[:, 0] = (rate, 0.0, 0.0)

    loads: list[tuple[int, Any]] = []
    for load in scene.loads:
        if hasattr(load, "joint"):
            loads.append((2, load.function))
        else:
            parts = (load.force_x, load.force_y, load.torque)
            loads += [(k, function) for k, function in enumerate(parts) if function is not None]

    class Loads(elastica.NoForces):
        """Forces on the first node, torque on the first element."""

        def apply_forces(self, system: Any, time: float = 0.0) -> None:
            for k, function in loads:
                if k < 2:
                    system.external_forces[k, 0] += function(float(time))

        def apply_torques(self, system: Any, time: float = 0.0) -> None:
            for k, function in loads:
                if k == 2:  # about the first director
                    system.external_torques[0, 0] += function(float(time))

    simulator = Simulator()
    simulator.append(rod)
    if scene.root == "pinned":
        simulator.constrain(rod).using(Root, constrained_position_idx=(0,), constrained_director_idx=(0,))
    if loads:
        simulator.add_forcing_to(rod).using(Loads)
    simulator.finalize()
    return simulator


def run(name: str, elements: int, share: float = 0.5, time_limit: float = 60.0) -> dict[str, Any]:
    """Run one scene; return tip positions at the sampling instants, m, CPU seconds, and whether the run finished.

    share: step over the longest stable step. time_limit: longest wall time, s, without compilation.
    """
    import elastica

    scene = named(name)
    rod = _rod(scene, elements)
    simulator, stepper = _simulator(scene, rod, 0.5 * element(scene, elements)), elastica.PositionVerlet()
    count = round(scene.duration / scene.sample)
    n = steps_of(name, elements, share) // count
    dt = scene.sample / n
    _compile(scene)
    tips, deadline = [rod.position_collection[:2, -1].copy()], time.monotonic() + time_limit
    clock = time.process_time()
    for k in range(count):
        for i in range(n):
            stepper.step(simulator, k * scene.sample + i * dt, dt)
        tips.append(rod.position_collection[:2, -1].copy())
        if not np.isfinite(tips[-1]).all() or time.monotonic() > deadline:
            break
    cpu = time.process_time() - clock
    tip = np.array(tips)
    finished = len(tips) == count + 1 and bool(np.isfinite(tip).all())
    status = "ok" if finished else "timed_out" if np.isfinite(tip).all() else "diverged"
    times = np.arange(len(tips)) * scene.sample
    return {"finished": finished, "status": status, "cpu_seconds": cpu, "dt": dt, "t": times, "tip": tip}


_compiled: set[bool] = set()


def _compile(scene: Scene) -> None:
    """Compile PyElastica's functions by one step of a discarded rod."""
    import elastica

    if not _compiled:
        rod = _rod(scene, 10)
        elastica.PositionVerlet().step(_simulator(scene, rod, 0.0), 0.0, 1e-9)
        _compiled.add(True)
