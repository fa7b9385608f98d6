"""Create clips of trajectories and of replayed episodes."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .. import scenes
from ..geometry.outlines import outline_of
from ..geometry.ribbons import cuts_of, thinned
from ..parameters import Arm
from ..physics.layout import POSE
from ..scene import PointLoad, Scene
from ..sensors import surface
from ..settings import Settings
from ..validation import Array
from . import space
from .clip import Chart, Clip, Pull, magnified, rigid_angles
from .contact import contact_charts, contact_pulls, obstacles_of
from .space import SpaceClip

MOST_POINTS = 21
"""Largest number of points per link."""


# ------------------------------------------------------------- trajectories
def of_trajectory(run: Any, label: str | None, curvature: Any) -> Clip:
    """Return the clip of a `Trajectory` in the plane.

    curvature: function that returns the curvatures (n, G), 1/m, at G points. Each point is a pair of link index and
    position along the link, 0 to 1.
    """
    scene: Scene = run.scene
    arm = scene.arm
    kept, cuts = thinned(cuts_of(run.shapes, run.hinges), MOST_POINTS)
    points = run.shapes[:, kept]
    base = run.base_angle if arm.base is not None and scene.root == "free" else None
    charts = [*_reference_error(run), *_attitude(base)]
    charts += _common(arm, run.tip_deflection, run.joint_torque, _energies(run), _moving)
    charts += _sensors(run)
    curved = curvature(_places(arm, points[0], cuts))
    return Clip(
        label=scene.name if label is None else label,
        note=_note(run.settings, _ended(run)),
        t=run.t, points=points, cuts=cuts, angles=run.link_angles,
        rigid=rigid_angles(run.joint_angles, turns_of(arm)), rest=rest_of(arm, points[0], cuts),
        curvature=curved, surface=_surface(arm, curved),
        pulls=[*_torques(arm, cuts, run.joint_torque), *_loads(scene, cuts, run.t)],
        charts=[c for c in charts if c.series], pinned=scene.root == "pinned", payload=arm.payload.mass > 0.0,
        base=base, walls=[outline_of(x.obstacle, np.zeros(2), 3.0 * arm.total_length) for x in scene.contacts],
    )  # fmt: skip


def of_trajectory_in_space(run: Any, label: str | None, curvature: Any) -> SpaceClip:
    """Return the clip of a run in space; the clip does not show curvatures."""
    charts = [c for c in _forces(run.scene.arm, run.joint_torque, _energies(run), _moving) if c.series]
    return space.of_run(run, label, _note(run.settings, _ended(run)), charts)



def _ended(run: Any) -> str:
    return "" if run.finished else f"{run.status} after {run.t[-1]:g} s"


def _energies(run: Any) -> dict[str, Array]:
    energies = {"kinetic": run.kinetic, "strain": run.strain_energy, "gravity": run.gravity}
    return energies | {"dissipated": run.dissipated, "work": run.work}


def mesh_of(settings: Settings) -> list[str]:
    """Return texts that describe the mesh, such as "8 segments"."""
    keys = ("segments", "elements", "coupling", "modes", "order", "nodes")
    return [f"{key} {getattr(settings, key)}" for key in keys if getattr(settings, key) is not None]


def _note(settings: Settings, ended: str) -> str:
    words = [settings.formulation.replace("_", " "), *mesh_of(settings), f"dt {settings.dt:.4g} s"]
    return ", ".join([*words, ended] if ended else words)


def _common(arm: Arm, bend: Array, torque: Array, energies: Mapping[str, Array], shown: Any) -> list[Chart]:
    """Return the charts of deflections, torques and energies. shown: function that selects the torques to show."""
    links = [f"link {k + 1}" for k in range(arm.n_links)] if arm.n_links > 1 else ["tip"]
    deflection = Chart("tip deflection / length", dict(zip(links, bend.T, strict=True)))
    return [deflection, *_forces(arm, torque, energies, shown)]


def _forces(arm: Arm, torque: Array, energies: Mapping[str, Array], shown: Any) -> list[Chart]:
    torques = Chart("joint torque (N m)", shown(dict(zip(_joints(arm), torque.T, strict=True))))
    return [torques, Chart("energy (J)", _moving(energies))]


def _joints(arm: Arm) -> list[str]:
    return [name.replace("_", " ") for name in arm.joint_names]


def shapes_of(run: Any, frames: Any, factor: float) -> Array:
    """Return the arm's points (n, points, 2), m, at the samples `frames` of a trajectory, with enlarged deflections.

    factor: factor on the deflections.
    """
    shapes: Array = run.shapes[frames]
    if factor == 1.0:
        return shapes
    arm, cuts = run.scene.arm, cuts_of(run.shapes, run.hinges)
    rest, rigid = rest_of(arm, run.shapes[0], cuts), rigid_angles(run.joint_angles[frames], turns_of(arm))
    rows = zip(shapes, run.link_angles[frames], rigid, strict=True)
    return np.array([magnified(points, cuts, angles, r, rest, factor) for points, angles, r in rows])


def turns_of(arm: Arm) -> Array:
    """Return the angles (N,), rad, between the tangents at root and tip of each stress-free link."""
    return np.array([link.turn for link in arm.links])


def rest_of(arm: Arm, points: Array, cuts: Sequence[int]) -> Array:
    """Return the points (P, 2), m, of the stress-free links that correspond to points of the arm; see `Clip.rest`."""
    places = [arm.links[k].place(s) for k, s in _along(arm, points, cuts)]
    return np.column_stack([np.real(places), np.imag(places)])


def _moving(series: Mapping[str, Array]) -> dict[str, Array]:
    """Return the series that have nonzero values."""
    return {name: values for name, values in series.items() if np.any(np.nan_to_num(values) != 0.0)}


def _surface(arm: Arm, curvature: Array) -> float | None:
    """Return half the thickness (m) of the rectangle with the sections' m and J (`sensors.surface`), or None.

    The result is None in three cases: J = 0; the thickness varies along the arm; or the surface would strain by 0.1 or
    more at the largest curvature (1/m), so that such m and J belong to no real section.
    """
    sections = [link.along(share * link.length) for link in arm.links for share in (0.0, 0.5, 1.0)]
    if any(float(s.J) <= 0.0 for s in sections):
        return None
    found = [surface(float(s.m), float(s.J)) for s in sections]
    alike = max(found) - min(found) <= 1e-6 * found[0]
    return found[0] if alike and found[0] * np.abs(curvature).max() < 0.1 else None


def _along(arm: Arm, points: Array, cuts: Sequence[int]) -> list[tuple[int, float]]:
    """Return each point's link (at a joint, the link that ends there) and its arc length from the link's root, m."""
    places: list[tuple[int, float]] = []
    for k, (a, b) in enumerate(pairwise(cuts)):
        link, steps = arm.links[k], np.hypot(*np.diff(points[a : b + 1], axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(steps)]) * link.span / max(float(steps.sum()), 1e-300)
        places += [(k, float(s)) for s in (along - link.root_offset)[1 if k else 0 :]]
    return places


def _places(arm: Arm, points: Array, cuts: Sequence[int]) -> list[tuple[int, float]]:
    """Return each point's link, and its place from 0 to 1 along the link's flexible part."""
    return [(k, float(np.clip(s / arm.links[k].length, 0.0, 1.0))) for k, s in _along(arm, points, cuts)]


def _torques(arm: Arm, cuts: Sequence[int], torque: Array) -> list[Pull]:
    limits = arm.torque_limits or (None,) * arm.n_links
    names = [f"{name} torque" for name in _joints(arm)]
    rows = zip(names, cuts, torque.T, limits, strict=False)
    return [Pull(*row) for row in rows if np.any(row[2] != 0.0)]


def _loads(scene: Scene, cuts: Sequence[int], t: Array) -> list[Pull]:
    """Return a scene's point loads at times t (n,), s: forces (n, 2), N, and torques (n,), N m."""
    pulls = []
    for load in scene.loads:
        if isinstance(load, PointLoad):
            point, where = cuts[load.link + (load.end == "tip")], f"at the {load.end} of link {load.link + 1}"
            x, y = (np.zeros(len(t)) if f is None else np.asarray(f(t)) for f in (load.force_x, load.force_y))
            if load.force_x is not None or load.force_y is not None:
                pulls.append(Pull(f"force {where}", point, np.column_stack([x, y])))
            if load.torque is not None:
                pulls.append(Pull(f"torque {where}", point, np.asarray(load.torque(t))))
    return pulls


def _reference_error(run: Any) -> list[Chart]:
    """Return a chart of the tip's distance from the reference trajectory of a scene that has one."""
    name = run.scene.name
    if name not in scenes.reference_names() or run.scene != scenes.named(name):
        return []
    table = scenes.reference(name).columns
    inside = run.t <= table["t"][-1] * (1.0 + 1e-9)
    known = [np.interp(run.t, table["t"], table[key]) for key in ("tip_x", "tip_y")]
    on_samples = np.min(np.abs(run.t[:, None] - table["t"]), axis=1) < 1e-9
    apart = np.hypot(run.tip[:, 0] - known[0], run.tip[:, 1] - known[1])
    return [Chart("tip error: from the reference (m)", {"tip": _bridged(np.where(inside & on_samples, apart, np.nan))})]


def _bridged(values: Array) -> Array:
    """Interpolate gaps in the values linearly; gaps at the ends remain."""
    good = np.flatnonzero(np.isfinite(values))
    if not len(good):
        return values
    inner = np.interp(np.arange(len(values)), good, values[good])
    inner[: good[0]], inner[good[-1] + 1 :] = np.nan, np.nan
    return inner


UNITS = {"angle": "rad", "rate": "rad/s", "acceleration": "m/s²", "camera": "m", "strain_gauge": "1/m"}


def _sensors(run: Any) -> list[Chart]:
    """Return charts of the arm's sensor readings, one per unit; for an arm without sensors, of ideal sensors."""
    try:
        read: dict[str, Array] = run.measured()
    except ValueError:  # samples at uneven distances: no sensor reads them
        return []
    sensors = run.scene.arm.sensors
    ideal = " (ideal)" if sensors is None else ""
    gauges = {gauge.unit for gauge in sensors.strain_gauges} if sensors is not None else set()
    units = UNITS if gauges <= {"curvature"} else UNITS | {"strain_gauge": ", ".join(sorted(gauges))}
    groups: dict[str, dict[str, Array]] = {}
    for name, values in read.items():
        kind = next(key for key in UNITS if key in name)
        groups.setdefault(kind, {})[name.replace("_", " ")] = values
    titles = {key: key.replace("_", " ") for key in UNITS} | {"angle": "joint angle", "rate": "joint rate"}
    return [Chart(f"measured{ideal}: {titles[kind]} ({units[kind]})", series) for kind, series in groups.items()]


# ----------------------------------------------------------------- episodes
def of_episode(
    plan: Any, views: Sequence[Any], rows: Mapping[str, Array], rewards: Array, label: str, rate: Any
) -> Clip | SpaceClip:
    """Return the clip of an episode.

    Args:
        plan: the environment's plan (`envs`), which defines its observation and arm. views: `batch.View` of each
            instant. rows: arrays of observations and infos by name.
        rewards: rewards of the episode's steps. label: name of the clip. rate: function that returns a matrix (G,
            rows). The matrix times the coordinates gives the curvatures, 1/m, at G points.
    """
    arm: Arm = plan.arm
    energies = {k.removeprefix("energy_"): x for k, x in rows.items() if k.startswith("energy_") or k == "work"}
    terms = {k.removeprefix("reward_"): x for k, x in rows.items() if k.startswith("reward_")}
    total = np.concatenate([[math.nan], rewards])
    seen = {k.removeprefix("seen_").replace("_", " "): x for k, x in rows.items() if k.startswith("seen_")}
    others = [Chart("reward a step", {"sum": total} | _moving(terms)), Chart("observation, in its scales", seen)]
    others = [*contact_charts(rows), *others]
    torque = np.array([view.torques for view in views])
    return clips_of(arm.axes).episode(plan, views, label, rate, torque, energies, others)


def _episode_in_space(
    plan: Any, views: Sequence[Any], label: str, rate: Any, torque: Array, energies: dict[str, Array],
    others: Sequence[Chart],
) -> SpaceClip:  # fmt: skip
    charts = [c for c in (*_forces(plan.arm, torque, energies, dict), *others) if c.series]
    return space.of_episode(plan, views, label, _note(plan.settings, ""), charts)


def _episode_in_plane(
    plan: Any, views: Sequence[Any], label: str, rate: Any, torque: Array, energies: dict[str, Array],
    others: Sequence[Chart],
) -> Clip:  # fmt: skip
    """Return the clip of a planar arm's episode. torque (n, N): N m. others: charts shown last."""
    arm: Arm = plan.arm
    t = np.array([view.time for view in views])
    shapes = np.array([view.points for view in views])
    poses = np.array([view.poses for view in views])
    angles = poses[..., [POSE.angle, POSE.tip_angle]]
    joints = poses[..., POSE.angle].copy()
    joints[:, 1:] -= poses[:, :-1, POSE.tip_angle]
    kept, cuts = thinned(cuts_of(shapes, poses[:, 1:, [POSE.x, POSE.y]]), MOST_POINTS)
    target = np.array([plan.kind.target.place(arm, view.target) for view in views])
    polar = plan.kind.target.numbers == 1
    bend = np.array([view.deflection for view in views])
    table = rate(_places(arm, shapes[0][kept], cuts))
    states = np.array([view.q for view in views])
    base, curvature = None if arm.base is None else states[:, -1], states @ table.T
    charts = [_miss(poses[:, -1], target, np.array([view.target for view in views]), polar), *_attitude(base)]
    charts += [*_common(arm, bend, torque, energies, dict), *others]
    return Clip(
        label=label, note=_note(plan.settings, ""), t=t, points=shapes[:, kept], cuts=cuts, angles=angles,
        rigid=rigid_angles(joints, turns_of(arm)), rest=rest_of(arm, shapes[0][kept], cuts), curvature=curvature,
        surface=_surface(arm, curvature), target=target, polar=polar,
        pulls=[*_torques(arm, cuts, torque), *contact_pulls(plan, views, cuts[1:], shapes[0][kept])],
        charts=[c for c in charts if c.series], payload=arm.payload.mass > 0.0,
        walls=[outline_of(x, np.zeros(2), 3.0 * arm.total_length) for x in obstacles_of(plan)], base=base,
    )  # fmt: skip


class Clips(NamedTuple):
    """Two functions, which return the clip of a run and the clip of an episode."""

    run: Callable[[Any, str | None, Any], Clip | SpaceClip]
    episode: Callable[..., Clip | SpaceClip]


def clips_of(axes: str) -> Clips:
    """Return the functions that make clips of arms that move along the given axes (`Arm.axes`)."""
    plane, in_space = Clips(of_trajectory, _episode_in_plane), Clips(of_trajectory_in_space, _episode_in_space)
    return {"xy": plane, "xyz": in_space}[axes]


def _attitude(base: Array | None) -> list[Chart]:
    return [] if base is None else [Chart("base: attitude (rad)", {"base": base})]


def _miss(tip: Array, target: Array, angle: Array, polar: bool) -> Chart:
    """Return a chart of the tip's distance from the target, m, or of the difference of their polar angles, rad."""
    if not polar:
        apart = np.hypot(tip[:, POSE.tip_x] - target[:, 0], tip[:, POSE.tip_y] - target[:, 1])
        return Chart("tip error: distance from the target (m)", {"tip": apart})
    now = np.arctan2(tip[:, POSE.tip_y], tip[:, POSE.tip_x])
    off = np.mod(angle[:, 0] - now + math.pi, 2.0 * math.pi) - math.pi
    return Chart("tip error: target less angle of the tip (rad)", {"tip": off})
