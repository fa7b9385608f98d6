"""Measure the cost of links in space with strains as coordinates, compared with floating frames and the exact beam.

python -m benchmarks.space_elastica [--out FOLDER] [--page]; a table of docs/results/space.md.
"""

import argparse
import dataclasses
import math
import sys
from typing import Any

import numpy as np

import flexarm_env as fx
from benchmarks import pages
from benchmarks.machine import table
from flexarm_env import scenes
from flexarm_env.time_functions import cycloid

MESHES: dict[str, tuple[dict[str, int], ...]] = {
    "elastica": tuple({"nodes": n} for n in (3, 4, 5, 6, 7)),
    "floating_frame": tuple({"segments": n} for n in (1, 2, 4, 8, 16)),
    "geometrically_exact": tuple({"elements": n} for n in (2, 4, 8, 16, 32)),
}
STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
TARGETS = (3e-3, 1e-3, 3e-4)
"""Error limits, over the arm's length."""
REFERENCE = {"elements": 48}


def arc() -> fx.Scene:
    """Return the scene of a strip, curved by 45 degrees without stress, whose root is driven about a transverse
    axis."""
    strip = fx.Section.rectangle(0.03, 0.002, 200e9, 7870.0, 200e9 / 2.6)
    arm = fx.Arm("arc", (fx.Link(0.6, strip, curvature=math.pi / 4 / 0.6),), hub_axis=(0.0, 1.0, 0.0), tau_d=1e-3)
    return fx.Scene("shaken arc", arm, duration=0.5, dt=1e-3, motions=(fx.Motion("joint0", cycloid(1.5, 0.25)),))


def cases() -> tuple[fx.Scene, ...]:
    """Return three scenes: strongly bent links, a link curved without stress, and links that hardly bend."""
    slew, frame = scenes.named("three_dof_slew"), scenes.named("flying_frame")
    return dataclasses.replace(slew, duration=0.6), arc(), dataclasses.replace(frame, duration=min(1.0, frame.duration))


def measure(_: argparse.Namespace) -> pages.Found:
    """Find the cheapest run within each error limit, for each scene and formulation: CPU time, mesh and step."""
    rows = []
    for scene in cases():
        scene = dataclasses.replace(scene, sample=scene.duration / 25)
        fine = [_tip(scene, "geometrically_exact", dt, REFERENCE).tip[:, :3] for dt in (2.5e-4, 1.25e-4)]
        exact, length = (4.0 * fine[1] - fine[0]) / 3.0, scene.arm.total_length
        runs: dict[str, list[Any]] = {name: [] for name in MESHES}
        for dt in STEPS:
            for k in range(len(MESHES["elastica"])):
                for name, meshes in MESHES.items():  # in turns
                    tried = [_tip(scene, name, dt, meshes[k]) for _ in range(3)]
                    off = float(np.abs(tried[0].tip[:, :3] - exact).max()) / length if tried[0].finished else math.inf
                    runs[name].append([off, min(run.cpu_seconds for run in tried), *meshes[k].values(), 1e3 * dt])
        for target in TARGETS:
            best = {name: min((r for r in found if r[0] <= target), key=lambda r: r[1], default=None)
                    for name, found in runs.items()}  # fmt: skip
            rows.append({"scene": scene.name, "target": target, "best": best})
    return {"rows": rows}


def _tip(scene: fx.Scene, formulation: str, dt: float, mesh: dict[str, int]) -> Any:
    return fx.simulate(dataclasses.replace(scene, dt=dt), formulation, estimate_error=False, **mesh)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the table of the page."""
    rows = []
    for row in found["rows"]:
        best = row["best"]
        told = ["-" if one is None else f"{one[2]}, {one[3]:g} ms: {1e3 * one[1]:.1f}" for one in best.values()]
        ours = best["elastica"]
        ratios = [
            "-" if ours is None or best[name] is None else f"{best[name][1] / ours[1]:.1f}" for name in list(MESHES)[1:]
        ]
        rows.append([row["scene"], f"{row['target']:.0e}", *told, *ratios])
    head = (
        "scene | allowed error | elastica: nodes, step: CPU ms | floating frames: segments, step: CPU ms | "
        "exact beam: elements, step: CPU ms | time of frames / elastica | time of exact beam / elastica"
    )
    return {"rows": table(head, rows)}


if __name__ == "__main__":
    sys.exit(pages.run("space_elastica", __doc__, measure, blocks, page="results/space"))
