"""Compare with MuJoCo, accuracy against run time: docs/results/work_precision.md, docs/results/mujoco_peer.json.

    python -m benchmarks.mujoco_peer [--episodes 20] [--times] [--page] [--out FOLDER] [--figures FOLDER]

`strip` and `de_luca_siciliano` run the episodes of `benchmarks.choose_default` from the starts of the environments. The
torques are held over control periods of 20 ms; half of the episodes have random torques, half bang-bang torques. The
reference is the converged exact beam. `three_dof` runs a quarter of its torques for 0.5 s in space. MuJoCo's chains are
stepped in C (`mujoco.rollout`). The package's arms are Gymnasium environments, Python included. The error of an episode
is the largest distance of the tip from the reference, in % of the arm's length; the worst episode counts. Times are CPU
microseconds per arm and control period, the smallest of several rounds, all of one run; times with two threads are wall
times. The script takes about ten CPU minutes and needs the extra `mujoco`.
"""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.choose_default import EXACT, IDS, Stopwatch, actions_of, tips
from benchmarks.machine import DOCS, cpu_seconds, table
from benchmarks.mujoco_chains import Case, MujocoArm, Rollouts, chain, explicit_step, judged, model_of, rod_of
from flexarm_env import arms
from flexarm_env.control import load_policy
from flexarm_env.envs.options import DEFAULT_OPTIONS
from flexarm_env.exchange import chain_modes
from flexarm_env.exchange.report import arm_modes
from flexarm_env.plotting import COLORS, FAINT, styled_figure
from flexarm_env.scene import JointTorque, Scene
from flexarm_env.simulation import simulate
from flexarm_env.time_functions import steps as stairs
from flexarm_env.validation import Array

Row = dict[str, Any]

KINDS = ("random", "bang_bang")
PERIOD = 0.02
MESHES: tuple[tuple[str, str, tuple[int, ...], bool], ...] = (
    ("between pieces", "between", (4, 8), False),
    ("middles of pieces", "middle", (4, 8), False),
    ("middles, fitted", "middle", (2, 4, 8, 16), True),
    ("Gauss points", "gauss", (2, 3, 4, 6), False),
)
"""Meshes of MuJoCo's chains: label, placement, numbers of springs per link, and whether the first frequency is
fitted."""
STEPS = {
    "RK4": (20.0, 10.0, 20.0 / 3.0, 5.0, 2.5, 1.0, 0.5, 0.25, 0.125, 0.0625),
    "implicitfast": (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.125),
    "discrete": (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.125),
    "Euler": (5.0, 1.0, 0.25),
    "implicit": (5.0, 1.0, 0.25),
}
"""Steps, ms, by integrator; shorter steps are tried until both errors change by less than the share SETTLED."""
SETTLED = 0.02
OTHERS = ("Euler", "implicit")
"""Integrators that run on two chains only; without constraints Euler equals implicitfast for these chains."""
LONGEST = 1500.0
"""Largest CPU time per control period, µs; slower settings are omitted."""
TARGETS = (5.0, 2.0, 1.0, 0.5, 0.2)
"""Errors, % of L, for which the tables list the quickest settings."""
OURS = {
    "elastica": {"formulation": "elastica", **DEFAULT_OPTIONS["elastica"]},
    "exact beam": {"formulation": "geometrically_exact", **DEFAULT_OPTIONS["geometrically_exact"]},
    "floating frame": {"formulation": "floating_frame", **DEFAULT_OPTIONS["floating_frame"]},
}
SECOND = {"formulation": "floating_frame", "segments": 6, "dt": 5e-4, "tolerance": 1e-10}
"""Settings of a second reference, which checks the first with another formulation."""
EXTRAPOLATED = (6, 12)
"""Numbers of springs per link of the two chains that are extrapolated in 1 / N^2."""
RODS: tuple[Case, ...] = tuple(
    {"label": "elastic rod", "rod": True, "springs": springs, "integrator": "discrete", "step": step}
    for springs, step in ((4, 0.002), (4, 0.001), (8, 0.001))
)
"""Runs with MuJoCo's discrete elastic rod, for one link."""
SPACE = {"arm": "three_dof", "share": 0.25, "duration": 0.5, "period": 0.01, "angles": (0.2, 0.5, 0.8)}
SPACE_AXES = {"z": "pitch alone", "xz": "pitch and torsion", "xyz": "pitch, torsion, lateral"}
"""Hinges of a spring, with the deformations that they allow."""
SPACE_STEPS = {
    "RK4": (5.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.05), "implicitfast": (2.0, 0.5, 0.1, 0.05),
    "discrete": (5.0, 2.0, 1.0, 0.5, 0.1),
}  # fmt: skip
SPACE_OURS = {"elements": 2, "dt": 0.0025, "rho_inf": 0.7, "tolerance": 1e-5}


def rollouts_of(arm: Any, case: Case, torques: Array, starts: Array) -> Rollouts:
    """Return the rollouts of a case in the plane."""
    if case.get("rod"):
        model, tip = rod_of(arm, case["springs"], case["step"])
        return Rollouts(model, torques, starts, PERIOD, tip)
    return Rollouts(model_of(arm, case), torques, starts, PERIOD)


def arm_of(env_id: str) -> Any:
    """Return the arm of an environment."""
    return gym.make(env_id, joint_limits=None).unwrapped.plan.arm


def starts_of(env_id: str, count: int) -> Array:
    """Return the initial joint angles (count, joints), rad, of the episodes of `choose_default.tips`."""
    env = gym.make_vec(env_id, num_envs=count, autoreset_mode="NextStep", joint_limits=None, duration=100.0, **EXACT)
    env.reset(seed=0)
    found = np.array([env.unwrapped.batch.joints(i)[0] for i in range(count)])
    env.close()
    return found


def largest(places: Array, truth: Array, length: float) -> Array:
    """Return the largest tip distance of each episode, % of L; inf if a position is not finite."""
    distance = np.linalg.norm(places - truth, axis=2) * 100.0 / length
    return np.asarray(np.where(np.isfinite(distance).all(axis=0), distance.max(axis=0), np.inf))


def worst(errors: Array) -> dict[str, float]:
    """Return the largest error of the episodes with each kind of torque, % of L."""
    half = len(errors) // 2
    return {"random": float(errors[:half].max()), "bang_bang": float(errors[half:].max())}


def cases() -> list[list[Case]]:
    """Return all settings of MuJoCo in the plane: a list of steps for each chain and integrator."""
    found: list[list[Case]] = []
    for label, placement, counts, fitted in MESHES:
        for springs, (integrator, steps) in itertools.product(counts, STEPS.items()):
            if integrator in OTHERS and (label, springs) not in (("Gauss points", 3), ("middles, fitted", 4)):
                continue
            mesh = {"label": label, "springs": springs, "placement": placement, "fitted": fitted}
            found.append([{**mesh, "integrator": integrator, "step": step / 1e3} for step in steps])
    return found


def measure_steps(arm: Any, tried: list[Case], torques: Array, starts: Array, truth: Array) -> list[Row]:
    """Measure a chain and integrator with shorter and shorter steps, until the errors no longer change."""
    found: list[Row] = []
    for case in tried:
        row = measure_chain(arm, case, torques, starts, truth)
        if row is None and found:
            break
        if row is not None:
            settled = bool(found) and all(abs(row[kind] / found[-1][kind] - 1.0) < SETTLED for kind in KINDS)
            found.append(row)
            print(f"  {described(row)}: {row['random']:.3g} %, {row['bang_bang']:.3g} %, {row['cpu']:.4g} us")
            if settled:
                break
    return found


def measure_chain(arm: Any, case: Case, torques: Array, starts: Array, truth: Array) -> Row | None:
    """Measure the errors and the CPU time of a setting; return None if it is unstable or too slow."""
    count, length, probe = torques.shape[1], arm.total_length, 5
    rollouts = rollouts_of(arm, case, torques[:probe], starts)
    first, _, _ = rollouts.run(1)
    # the least of three: the first one starts a thread
    cpu = min(rollouts.run(1)[1] for _ in range(3))
    if not np.isfinite(first).all() or 1e6 * cpu / probe > LONGEST:
        return None
    rollouts = rollouts_of(arm, case, torques, starts)
    first, _, _ = rollouts.run(1)
    if not largest(first[:, :, :2], truth[:, :1], length)[0] < 100.0:
        return None
    places, cpu, _ = rollouts.run(count)
    errors = worst(largest(places[:, :, :2], truth, length))
    if not max(errors.values()) < 100.0:
        return None
    return {**case, **errors, "cpu": 1e6 * cpu / (count * len(torques))}


def front(rows: Sequence[Row], kinds: Sequence[str] = KINDS, key: str = "cpu") -> list[Row]:
    """Return the rows, quickest first, whose error is at least 3 % smaller than that of any quicker row.

    The error of a row is the larger one of its kinds of torque.
    """
    found: list[Row] = []
    for row in sorted(rows, key=lambda r: float(r[key])):
        if not found or error_of(row, kinds) < 0.97 * error_of(found[-1], kinds):
            found.append(row)
    return found


def error_of(row: Row, kinds: Sequence[str] = KINDS) -> float:
    """Return the largest error of the given kinds of torque, % of L."""
    return max(row[kind] for kind in kinds)


def take_times(env_id: str, arm: Any, rows: list[Row], torques: Array, starts: Array, rounds: int) -> None:
    """Measure MuJoCo's rows and store the times `alone`, `gym`, `batch` and `threads`, the minima over the rounds."""
    watches = []
    limits = np.array(arm.torque_limits)
    rng = np.random.default_rng(0)
    for row in rows:
        model = model_of(arm, row)
        env = gym.wrappers.TimeLimit(gym.wrappers.OrderEnforcing(
            MujocoArm(model, arm.n_links, PERIOD, limits)), 10**9)  # fmt: skip
        moves = list(rng.uniform(-1.0, 1.0, (60, arm.n_links)).astype(np.float32))
        watches.append((Rollouts(model, torques, starts, PERIOD), env, moves))
    for _, (row, (rollouts, env, moves)) in itertools.product(range(rounds), zip(rows, watches, strict=True)):
        arms_at_once, periods = (256, 4) if row["cpu"] < 500.0 else (32, 4)
        _, cpu, _ = rollouts.run(1, periods=60)
        read = {"alone": cpu / 60.0}
        _, cpu, _ = rollouts.run(arms_at_once, periods=periods)
        read["batch"] = cpu / (arms_at_once * periods)
        _, _, wall = rollouts.run(arms_at_once, threads=2, periods=periods)
        read["threads"] = wall / (arms_at_once * periods)
        env.reset(seed=0)
        begun = time.process_time()
        for move in moves:
            env.step(move)
        read["gym"] = (time.process_time() - begun) / len(moves)
        for key, value in read.items():
            row[key] = min(row.get(key, np.inf), 1e6 * value)


def measure_plane(env_id: str, episodes: int, rounds: int) -> Row:
    """Run MuJoCo's settings and the package's defaults on the same episodes of an environment."""
    arm = arm_of(env_id)
    actions = actions_of(env_id, episodes, arm.n_links)
    truth, _ = tips(env_id, actions, EXACT)
    second, _ = tips(env_id, actions, SECOND)
    apart = worst(largest(second, truth, arm.total_length))
    # actions are float32 in the environment
    torques = actions.astype(np.float32).astype(np.float64) * np.array(arm.torque_limits)
    starts = starts_of(env_id, actions.shape[1])
    print(f"{env_id}: the two references differ by {apart} % of L", flush=True)
    extrapolated = measure_extrapolated(arm, torques, starts, truth, episodes)
    print(f"{env_id}: MuJoCo's chain, extrapolated, is off the reference by {extrapolated} % of L", flush=True)
    rows = [row for tried in cases() for row in measure_steps(arm, tried, torques, starts, truth)]
    if arm.n_links == 1:
        rows += [row for case in RODS if (row := measure_chain(arm, case, torques, starts, truth)) is not None]
    kept: list[Row] = []
    hinges = [row for row in rows if not row.get("rod")]
    for row in (*front(hinges), *front(hinges, ("random",)), *front(hinges, ("bang_bang",))):
        if row not in kept:
            kept.append(row)
    take_times(env_id, arm, kept, torques, starts, rounds)
    ours = []
    for (name, options), times in zip(OURS.items(), own_times(env_id, rounds), strict=True):
        places, _ = tips(env_id, actions, options)
        ours.append({"label": name, **times, **worst(largest(places, truth, arm.total_length))})
    return {
        "arm": arm.name, "episodes": episodes, "reference_apart": apart, "extrapolated": extrapolated, "rows": rows,
        "timed": kept, "ours": ours, "frequencies": frequencies(arm),
    }  # fmt: skip


def own_times(env_id: str, rounds: int) -> list[Row]:
    """Return the times `gym`, `batch` and `threads`, µs, of each entry of `OURS`."""
    watches = [Stopwatch(env_id, options, True) for options in OURS.values()]
    reads = np.array([[watch.read() for watch in watches] for _ in range(rounds)]).min(axis=0)
    return [
        {"gym": single, "batch": vector, "threads": on_two_threads(env_id, options)}
        for options, (vector, single) in zip(OURS.values(), reads.tolist(), strict=True)
    ]


def timed_again(found: pages.Found, rounds: int) -> pages.Found:
    """Measure the times of the plane's rows again, in one run; the stored errors stay."""
    for env_id in IDS:
        arm, rows = arm_of(env_id), found[env_id]["timed"]
        actions = actions_of(env_id, found[env_id]["episodes"], arm.n_links)
        torques = actions.astype(np.float32).astype(np.float64) * np.array(arm.torque_limits)
        for row in rows:
            for key in ("alone", "gym", "batch", "threads"):
                row.pop(key, None)
        take_times(env_id, arm, rows, torques, starts_of(env_id, actions.shape[1]), rounds)
        for row, times in zip(found[env_id]["ours"], own_times(env_id, rounds), strict=True):
            row.update(times)
    return found


def on_two_threads(env_id: str, options: dict[str, Any]) -> float:
    """Return the wall time, µs, per arm and control period of 512 arms on two threads (minimum of five rounds)."""
    env = gym.make_vec(env_id, num_envs=512, threads=2, joint_limits=None, duration=1e6, **options)
    moves = np.random.default_rng(0).uniform(-1.0, 1.0, (20, *env.action_space.shape)).astype(np.float32)
    least = np.inf
    for _ in range(5):
        env.reset(seed=0)
        begun = time.perf_counter()
        for move in moves:
            env.step(move)
        least = min(least, (time.perf_counter() - begun) / (512 * len(moves)))
    env.close()
    return 1e6 * least


def measure_extrapolated(arm: Any, torques: Array, starts: Array, truth: Array, episodes: int) -> dict[str, float]:
    """Return the largest distance, % of L, of MuJoCo's chain, extrapolated in 1 / N^2, from the reference in four
    episodes."""
    chosen = [*range(2), *range(episodes, episodes + 2)]
    tips_of = []
    for springs in EXTRAPOLATED:
        case = {"springs": springs, "placement": "middle", "fitted": False, "integrator": "RK4"}
        step = PERIOD / np.ceil(PERIOD / min(0.6 * explicit_step(chain(arm, case)), 1e-3))
        rollouts = Rollouts(model_of(arm, {**case, "step": step}), torques[:, chosen], starts[chosen], PERIOD)
        tips_of.append(rollouts.run(len(chosen))[0][:, :, :2])
    coarse, fine = tips_of
    ratio = (EXTRAPOLATED[1] / EXTRAPOLATED[0]) ** 2
    return worst(largest(fine + (fine - coarse) / (ratio - 1.0), truth[:, chosen], arm.total_length))


def measure_policy(count: int = 20) -> Row:
    """Evaluate the packaged policy of `FlexibleArm-v0` in MuJoCo and in the environment, on the same episodes."""
    env = gym.make(IDS[0])
    policy = load_policy("flexible_arm", env)
    found = []
    for label, springs, placement, integrator, step in (
        ("4 springs at Gauss points, RK4 1 ms", 4, "gauss", "RK4", 1e-3),
        ("4 pieces, springs between them, implicitfast 2 ms", 4, "between", "implicitfast", 2e-3),
    ):
        case = {"springs": springs, "placement": placement, "fitted": False, "integrator": integrator, "step": step}
        model = model_of(env.unwrapped.plan.arm, case)
        runs = [judged(policy, env, model, seed) for seed in range(count)]
        found.append({
            "label": label, "success": sum(run[0] for run in runs), "success_here": int(sum(run[2] for run in runs)),
            "apart": 100.0 * max(run[1] for run in runs), "count": count,
        })  # fmt: skip
    return {"runs": found}


def frequencies(arm: Any) -> list[Row]:
    """Return the lowest clamped frequencies, Hz, of an arm and of its chains."""
    own = arm_modes(arm)[0]
    found = [{"label": "the arm", "frequencies": own.tolist()}]
    for label, placement, springs, fitted in (
        ("4 between pieces", "between", 4, False), ("4 middles", "middle", 4, False),
        ("4 middles, fitted", "middle", 4, True), ("3 Gauss points", "gauss", 3, False),
        ("4 Gauss points", "gauss", 4, False),
    ):  # fmt: skip
        made = chain(arm, {"springs": springs, "placement": placement, "fitted": fitted})
        found.append({"label": label, "frequencies": chain_modes(made)[0][:3].tolist()})
    return found


# -------------------------------------------------------------------- in space
def space_scenes(count: int) -> list[Scene]:
    """Return scenes of `three_dof` under random and bang-bang torques of a quarter of the limits."""
    arm = arms.named(SPACE["arm"])
    assert arm.torque_limits is not None
    rng = np.random.default_rng(7)
    periods = round(SPACE["duration"] / SPACE["period"])
    t = np.arange(periods) * SPACE["period"]
    found = []
    for e in range(2 * count):
        loads = []
        for k, limit in enumerate(arm.torque_limits):
            values = rng.uniform(-1.0, 1.0, periods)
            if e >= count:
                values = np.repeat(np.sign(values[::10]), 10)[:periods]
            loads.append(JointTorque(k, stairs(t, SPACE["share"] * limit * values)))
        found.append(Scene("space", arm, duration=SPACE["duration"], dt=0.0025, sample=SPACE["period"],
                           angles=SPACE["angles"], gravity=(0.0, 0.0, -9.81), loads=tuple(loads)))  # fmt: skip
    return found


def space_cases() -> list[Case]:
    """Return the settings of MuJoCo in space: hinges of a spring, number of springs, integrator and step."""
    found = []
    for axes, springs in itertools.product(("z", "xz", "xyz"), (2, 3, 4)):
        label = f"Gauss points, {SPACE_AXES[axes]}"
        mesh = {"label": label, "axes": axes, "springs": springs, "placement": "gauss", "fitted": False}
        for integrator, steps in SPACE_STEPS.items():
            found += [{**mesh, "integrator": integrator, "step": step / 1e3} for step in steps]
    return found


def measure_space(count: int, rounds: int) -> Row:
    """Run MuJoCo's settings and the package's default on the same scenes of `three_dof`."""
    scenes = space_scenes(count)
    arm, period = scenes[0].arm, SPACE["period"]

    def run(formulation: str, **options: Any) -> Array:
        places = [simulate(scene, formulation, estimate_error=False, **options).tip[1:] for scene in scenes]
        return np.array(places).transpose(1, 0, 2)

    truth = run("elastica", nodes=8, dt=2.5e-4)
    apart = worst(largest(run("geometrically_exact", elements=16, dt=2.5e-4), truth, arm.total_length))
    print(f"three_dof: the two references differ by {apart} % of L", flush=True)
    torques = np.array([[load.function(np.arange(truth.shape[0]) * period + 1e-9) for load in scene.loads]
                        for scene in scenes]).transpose(2, 0, 1)  # fmt: skip
    starts = np.tile(SPACE["angles"], (len(scenes), 1))
    rows = []
    for case in space_cases():
        rollouts = Rollouts(model_of(arm, case, (0.0, 0.0, -9.81)), torques, starts, period)
        first, cpu, _ = rollouts.run(1)
        if not largest(first, truth[:, :1], arm.total_length)[0] < 100.0 or 1e6 * cpu / len(torques) > LONGEST:
            continue
        reads = [rollouts.run(len(scenes)) for _ in range(2)]
        errors = worst(largest(reads[0][0], truth, arm.total_length))
        batch = min(read[1] for read in reads) / (len(scenes) * len(torques))
        alone = min(rollouts.run(1)[1] for _ in range(rounds)) / len(torques)
        # an unstable run that stays finite is off by more than half of the length, even under random torques
        if errors["random"] < 50.0 and errors["bang_bang"] < 100.0:
            rows.append({**case, **errors, "cpu": 1e6 * batch, "batch": 1e6 * batch, "alone": 1e6 * alone})
    places = run("geometrically_exact", **SPACE_OURS)
    more = {"arm": "three_dof", "joint_limits": None, "duration": 1e6}
    vector = gym.make_vec("SpatialFlexArm-v0", num_envs=256, threads=1, **more)
    single = gym.make("SpatialFlexArm-v0", **more)
    rng = np.random.default_rng(0)
    reads = {"batch": np.inf, "gym": np.inf}
    for _ in range(rounds):
        for key, env, many in (("batch", vector, 256), ("gym", single.unwrapped, 1)):
            env.reset(seed=0)
            moves = list(SPACE["share"] * rng.uniform(-1.0, 1.0, (30, *env.action_space.shape)).astype(np.float32))
            begun = time.process_time()
            for move in moves:
                env.step(move)
            reads[key] = min(reads[key], 1e6 * (time.process_time() - begun) / (len(moves) * many))
    ours = [{"label": "exact beam, default", **reads, **worst(largest(places, truth, arm.total_length))}]
    return {"episodes": count, "reference_apart": apart, "rows": rows, "timed": front(rows), "ours": ours}


# -------------------------------------------------------------------- results
def described(row: Row) -> str:
    """Return a row's settings in words."""
    if "springs" not in row:
        return f"**{row['label']}**"
    return f"{row['springs']}, {row['label']}, {row['integrator']} {1e3 * row['step']:.3g} ms"


def short(value: float) -> str:
    """Format a number with three digits, or without decimals from 100 on."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _cells(row: Row) -> tuple[str, ...]:
    times = (short(row[key]) if key in row else "–" for key in ("alone", "gym", "batch", "threads"))
    return described(row), *(f"{row[kind]:.2g}" for kind in KINDS), *times


def front_table(found: Row) -> list[str]:
    """Format a table of MuJoCo's Pareto front and the package's defaults."""
    heads = (
        "settings | error: random torques, % | bang-bang, % | one arm in C, µs | in Gymnasium, µs | batch on one "
        "thread, µs | on two threads, µs"
    )
    lead = front(found["timed"])
    both = [row for row in found["timed"] if row in lead or row in front(found["timed"], ("random",))]
    return table(heads, [_cells(row) for row in (*both, *found["ours"])])


def quickest(rows: Sequence[Row], kinds: Sequence[str], target: float, key: str) -> Row | None:
    """Return the quickest row whose error is at most `target`, % of L, or None."""
    good = [row for row in rows if key in row and error_of(row, kinds) <= target]
    return min(good, key=lambda row: float(row[key])) if good else None


def ratio_table(found: Row) -> list[str]:
    """Format a table: MuJoCo's shortest time over the package's at the same error, both from one run."""
    lines = []
    for kinds, target in itertools.product((("random",), KINDS), TARGETS):
        cells = []
        for theirs, ours in (("alone", "gym"), ("gym", "gym"), ("batch", "batch"), ("threads", "threads")):
            a, b = quickest(found["timed"], kinds, target, theirs), quickest(found["ours"], kinds, target, ours)
            cells.append("–" if a is None or b is None else short(a[theirs] / b[ours]))
        lines.append(("random" if len(kinds) == 1 else "both", f"{target:g} %", *cells))
    return table(
        "torques | allowed error | MuJoCo in C / package in Gymnasium | both in Gymnasium | batch on one "
        "thread | batch on two threads",
        lines,
    )


def check_table(found: pages.Found) -> list[str]:
    """Format a table: differences of the second reference and of MuJoCo's extrapolated chain from the reference."""
    lines = []
    for env_id in IDS:
        own = found[env_id]
        pairs = itertools.product(("reference_apart", "extrapolated"), KINDS)
        lines.append((env_id, *(f"{own[key][kind]:.2g}" for key, kind in pairs)))
    heads = "environment | floating frame: random, % | bang-bang, % | MuJoCo extrapolated: random, % | bang-bang, %"
    return table(heads, lines)


def frequency_table(found: pages.Found) -> list[str]:
    """Format a table of the lowest frequencies of arms and chains."""
    lines = [(found[env_id]["arm"], row["label"], *(f"{f:.4g}" for f in row["frequencies"]))
             for env_id in IDS for row in found[env_id]["frequencies"]]  # fmt: skip
    return table("arm | model | first frequency, Hz | second, Hz | third, Hz", lines)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    tried = " and ".join(f"{len(found[env_id]['rows'])} stable settings on `{env_id}`" for env_id in IDS)
    runs = f"MuJoCo was measured with {tried}, which took {found['cpu_seconds']:.0f} s of CPU time."
    made: dict[str, list[str]] = {"runs": [runs], "checks": check_table(found)}
    for env_id in IDS:
        made |= {env_id: front_table(found[env_id]), f"{env_id} ratios": ratio_table(found[env_id])}
    made["policy"] = table(
        "chain | successes in MuJoCo | in FlexibleArm-v0 | largest distance of the tips, % of L",
        [(row["label"], f"{row['success']} of {row['count']}", f"{row['success_here']} of {row['count']}",
          f"{row['apart']:.2g}") for row in found["policy"]["runs"]],
    )  # fmt: skip
    rods = [row for row in found[IDS[0]]["rows"] if row.get("rod")]
    made["rods"] = table("springs, integrator, step | error: random torques, % | bang-bang, % | batch on one thread, "
        "µs", [
        (described(row), *(f"{row[kind]:.2g}" for kind in KINDS), f"{row['cpu']:.3g}") for row in rods
    ])  # fmt: skip
    made |= {"frequencies": frequency_table(found), "three_dof": front_table(found["three_dof"])}
    return {**made, "finding": [finding(found)]}


def finding(found: pages.Found) -> str:
    """Describe the result in words: the time ratios at an error of 2 %, and where MuJoCo is as fast."""
    own = found[IDS[0]]
    words = []
    pairs = (
        ("alone", "gym", "one arm, MuJoCo in C, the package in Gymnasium"),
        ("gym", "gym", "one arm, both in Gymnasium"), ("batch", "batch", "one arm of a batch in both programs"),
    )  # fmt: skip
    for theirs, ours, what in pairs:
        a, b = quickest(own["timed"], KINDS, 2.0, theirs), quickest(own["ours"], KINDS, 2.0, ours)
        if a is not None and b is not None:
            words.append(f"{short(a[theirs] / b[ours])} times as long ({what})")
    coarse = quickest(own["timed"], ("random",), 1.0, "alone")
    best = min((error_of(row) for row in own["rows"]), default=np.nan)
    if words:
        text = ("On `FlexibleArm-v0` the package's fastest default is faster than MuJoCo's fastest chain whose error "
                "is at most 2 % of L under random and under bang-bang torques. MuJoCo's chain takes "
                f"{', '.join(words)}.")  # fmt: skip
    else:
        text = (f"On `FlexibleArm-v0` no setting of MuJoCo within {LONGEST:g} µs a period reaches 2 % under both kinds "
                "of torque.")  # fmt: skip
    text += f" The smallest error of MuJoCo's chains under both kinds of torque is {best:.2g} %."
    if coarse is not None:
        gyms = ", ".join(f"{row['gym']:.3g} µs ({row['label']}, error {row['random']:.2g} %)" for row in own["ours"])
        text += (f" At a coarse accuracy MuJoCo is fast: under random torques alone, one arm in C takes "
                 f"{coarse['alone']:.3g} µs with an error of {coarse['random']:.2g} %. The package's Gymnasium "
                 f"environments take {gyms}.")  # fmt: skip
    return text


def figure(found: pages.Found, path: Path) -> None:
    """Plot the error over the CPU time of one arm, and of one arm in a batch."""
    columns = (("alone", "gym", "one arm: MuJoCo in C, ours in Gymnasium"), ("batch", "batch", "a batch on one thread"))
    with styled_figure(path, 10.0, 1.2 + 3.1 * len(IDS)) as fig:
        axes = fig.subplots(len(IDS), 2, sharex=True, sharey=True, squeeze=False)
        for (i, env_id), (j, (theirs, ours, title)) in itertools.product(enumerate(IDS), enumerate(columns)):
            axis = axes[i, j]
            for kinds, style in ((("random",), "--"), (("bang_bang",), "-")):
                lead = front(found[env_id]["timed"], kinds, theirs)
                axis.plot([row[theirs] for row in lead], [error_of(row, kinds) for row in lead], style, color=COLORS[0],
                          marker="o", ms=4, mfc="white" if style == "--" else COLORS[0],
                          label=f"MuJoCo's best settings, {kinds[0].replace('_', '-')} torques")  # fmt: skip
                for k, row in enumerate(found[env_id]["ours"]):
                    axis.plot(row[ours], row[kinds[0]], ls="", marker="*", ms=12, color=COLORS[k + 1],
                              mfc="white" if style == "--" else COLORS[k + 1],
                              label=f"{row['label']}, default" if style == "-" else None)  # fmt: skip
            axis.set(xscale="log", yscale="log", title=f"{env_id}\n{title}")
            axis.grid(True, color=FAINT, alpha=0.25)
            if i == len(IDS) - 1:
                axis.set_xlabel("CPU, µs per arm and control period")
            if j == 0:
                axis.set_ylabel("worst tip error, % of L")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)


def measured(options: argparse.Namespace) -> pages.Found:
    """Run all measurements, or only the times, and plot them."""
    begun = cpu_seconds()
    if options.times:
        stored = json.loads((DOCS / "results" / "mujoco_peer.json").read_text("utf-8"))
        stored.pop("machine")
        found = timed_again(stored, options.rounds)
        figure(found, options.figures / "mujoco_peer.png")
        return found
    found = {env_id: measure_plane(env_id, options.episodes, options.rounds) for env_id in IDS}
    found["three_dof"] = measure_space(max(2, options.episodes // 3), options.rounds)
    found["policy"] = measure_policy()
    found["cpu_seconds"] = cpu_seconds() - begun
    figure(found, options.figures / "mujoco_peer.png")
    return found


MORE: dict[str, dict[str, Any]] = {
    "times": {"action": "store_true", "help": "measure only the times in the plane again; the stored errors stay"},
}

if __name__ == "__main__":
    sys.exit(pages.run("mujoco_peer", __doc__, measured, blocks, page="results/work_precision", packages=("mujoco",),
                       indent=None, episodes=20, rounds=3, more=MORE))  # fmt: skip
