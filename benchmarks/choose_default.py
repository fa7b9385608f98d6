"""Choose the default formulation and step of the environments: docs/results/default_settings.{md,json}.

python -m benchmarks.choose_default [--env ID] [--episodes 200] [--page] [--out FOLDER]

Every candidate runs the same episodes as the converged exact beam. In `episodes` episodes the torque changes randomly
in each control period. In further `episodes` episodes the torque is bang-bang: full torque of either sign, switched
after random times of 0.1 to 0.6 s. Two links are compared over the first 2 s only, since their longer motions are
chaotic. The error of an episode is the largest distance between the candidate's tip and the exact one, over L. A
candidate is acceptable if this error is at most 0.5 % in 99 % of the episodes of each kind; the aim is 0.1 %. The
default, one for both environments, is the cheapest candidate (sum of both costs in a vector environment) that reaches
the aim in both. If no candidate reaches the aim, the default is the cheapest acceptable candidate. The exit code is 1
if the package's defaults are not acceptable. The script takes a few minutes of CPU time.
"""

import argparse
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from flexarm_env.envs.options import plan
from flexarm_env.validation import Array

IDS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")
HORIZON = {"FlexibleArm-v0": 4.0, "TwoLinkFlexArm-v0": 2.0}
LIMIT, AIM, SHARE = 0.5, 0.1, 99.0
"""Limit and aim of the error, % of L, and the percentile of the episodes' errors that is compared with them."""
WEAK = 0.25
"""Share of the torque limits for links reduced to modes, which are valid for small bending only."""

EXACT: dict[str, Any] = {
    "formulation": "geometrically_exact", "elements": 6, "order": 3, "dt": 2.5e-4, "tolerance": 1e-10,
}  # fmt: skip
COARSER: dict[str, dict[str, Any]] = {"step": EXACT | {"dt": 5e-4}, "mesh": EXACT | {"elements": 4}}
"""Settings that check whether EXACT is converged: twice the step, and a coarser mesh."""

PERCENTILES = (50.0, 95.0, SHARE, 100.0)
KINDS = ("random", "bang_bang")
Row = dict[str, Any]
"""Result of a candidate: options, errors in % of L, and CPU µs per arm and control period."""


def label(options: dict[str, Any]) -> str:
    """Format settings as one line."""
    words = {
        "formulation": "{}", "dt": "dt {:.4g} ms", "multipliers": "multipliers", "frame": "frame {}",
        "period_correction": "period corrected",
    }  # fmt: skip
    told = {**options, "dt": 1e3 * options["dt"]}
    parts = [words.get(name, name + " {:g}").format(value) for name, value in told.items()]
    return ", ".join([*parts, f"{WEAK:g} of the torque"] if reduced(options) else parts)


def spread(errors: Array) -> dict[str, float | None]:
    """Return percentiles of the episodes' errors by name; None if the percentile is not finite (a failed episode)."""
    values = {f"{share:g}": percentile(errors, share) for share in PERCENTILES}
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def worst(row: Row) -> float:
    """Return the larger of the errors under random and bang-bang torques, each at the percentile `SHARE`, % of L."""
    return max(np.inf if row[kind][f"{SHARE:g}"] is None else row[kind][f"{SHARE:g}"] for kind in KINDS)


def percentile(errors: Array, share: float = SHARE) -> float:
    """Return the error that `share` % of the episodes do not exceed: an episode's error, without interpolation."""
    return float(np.percentile(errors, share, method="higher"))


def candidates() -> list[dict[str, Any]]:
    """Return the settings to compare; the package's defaults are among them."""
    rows: list[dict[str, Any]] = []
    for nodes in (4, 5, 6):
        for steps in (8, 5, 4, 3, 2):
            rows.append({"formulation": "elastica", "nodes": nodes, "dt": 0.02 / steps, "tolerance": 1e-6})
    for nodes, tolerance in ((4, 1e-5), (5, 1e-7), (5, 1e-5)):
        for steps in (5, 4, 3, 2):
            rows.append({"formulation": "elastica", "nodes": nodes, "dt": 0.02 / steps, "tolerance": tolerance})
    for order, meshes in ((2, (3, 4, 5)), (3, (3, 4))):
        for elements in meshes:
            mesh = {"formulation": "geometrically_exact", "elements": elements, "order": order}
            rows += [mesh | {"dt": 0.02 / steps, "tolerance": 1e-6} for steps in (8, 4)]
            mesh |= {"period_correction": True}
            rows += [mesh | {"dt": 0.02 / steps, "tolerance": 1e-6} for steps in (8, 4, 3, 2)]
    whole = [{"modes": modes, "dt": 0.02 / steps} for modes in (2, 3) for steps in (8, 4, 2)]
    whole += [{"modes": 2, "frame": "root", "dt": 0.005}]
    cut = [{"segments": segments, "dt": 0.02 / steps} for segments in (2, 3, 4) for steps in (10, 8, 6, 4)]
    cut += [{"segments": segments, "frame": "root", "dt": 0.0025} for segments in (3, 5, 8)]
    cut += [{"segments": 5, "frame": "root", "multipliers": True, "dt": 0.0025}]
    pieces = [{"segments": segments, "modes": 2, "dt": 0.0025} for segments in (3, 5)]
    rows += [{"formulation": "floating_frame", **mesh, "tolerance": 1e-6} for mesh in (*whole, *pieces, *cut)]
    return [*rows, {"formulation": "paper", "segments": 5, "dt": 0.0025, "tolerance": 1e-6}]


def reduced(options: dict[str, Any]) -> bool:
    """Return whether each link is one body reduced to modes; its torques are reduced to the share `WEAK`."""
    return "modes" in options and "segments" not in options


def actions_of(env_id: str, episodes: int, joints: int) -> Array:
    """Return actions (periods, 2 episodes, joints): first episodes with random torques, then with bang-bang torques."""
    rng = np.random.default_rng(20240611)
    periods = round(HORIZON[env_id] / 0.02)
    random = rng.uniform(-1.0, 1.0, (periods, episodes, joints))
    bang = np.zeros((periods, episodes, joints))
    for e in range(episodes):
        for j in range(joints):
            at, sign = 0, rng.choice([-1.0, 1.0])
            while at < periods:
                dwell = int(rng.integers(5, 31))
                bang[at : at + dwell, e, j] = sign
                at, sign = at + dwell, -sign
    return np.concatenate([random, bang], axis=1)


def tips(env_id: str, actions: Array, options: dict[str, Any]) -> tuple[Array, int]:
    """Run the episodes; return tip positions (periods, episodes, 2), m, and the number of failed episodes.

    Positions after an episode's failure are NaN.
    """
    periods, count, _ = actions.shape
    env = gym.make_vec(env_id, num_envs=count, autoreset_mode="NextStep", joint_limits=None, duration=100.0, **options)
    env.reset(seed=0)
    places = np.full((periods, count, 2), np.nan)
    alive = np.ones(count, bool)
    for k in range(periods):
        _, _, terminated, _, infos = env.step(actions[k].astype(np.float32))
        alive &= ~terminated
        places[k, alive] = infos["tip_position"][alive]
    env.close()
    return places, int((~alive).sum())


class Stopwatch:
    """CPU time of a control period with given settings: in a vector of arms on one thread, and in one environment.

    The vector has 512 arms. For the paper's formulation and for multipliers, which are not computed in lanes, the
    vector environment has 32 arms.
    """

    def __init__(self, env_id: str, options: dict[str, Any], alone: bool) -> None:
        one_by_one = options.get("multipliers") or options["formulation"] == "paper"
        self.arms = 32 if one_by_one else 512
        more = {"joint_limits": None, "duration": 1e6, **options}
        self.vector = gym.make_vec(env_id, num_envs=self.arms, threads=1, **more)
        self.single = gym.make(env_id, **more).unwrapped if alone else None
        rng = np.random.default_rng(0)
        self.many = list(rng.uniform(-1.0, 1.0, (60, *self.vector.action_space.shape)).astype(np.float32))
        self.few = list(rng.uniform(-1.0, 1.0, (600, self.vector.action_space.shape[1])).astype(np.float32))

    def read(self) -> tuple[float, float]:
        """Return CPU µs per arm and control period in the vector, and per `step` of the single environment."""
        one = self._mean(self.vector, self.many) / self.arms
        return one, float("nan") if self.single is None else self._mean(self.single, self.few)

    @staticmethod
    def _mean(env: Any, moves: list[Any]) -> float:
        env.reset(seed=0)
        start = time.process_time()
        for move in moves:
            env.step(move)
        return (time.process_time() - start) / len(moves) * 1e6


def take_times(env_id: str, rows: list[Row], rounds: int = 7) -> None:
    """Store the costs in `rows`: for each candidate the minimum over several rounds through all candidates."""
    watches = [Stopwatch(env_id, row["options"], row["options"]["formulation"] == "elastica") for row in rows]
    readings = np.array([[watch.read() for watch in watches] for _ in range(rounds)])
    for row, (vector, single) in zip(rows, readings.min(axis=0).tolist(), strict=True):
        row |= {"microseconds_vector": vector, "microseconds_single": single}


def measure(env_id: str, episodes: int) -> Row:
    """Measure all candidates in an environment, and the difference of the reference from coarser runs, % of L."""
    joints = 1 if env_id == IDS[0] else 2
    own = gym.make(env_id).unwrapped.plan
    actions = actions_of(env_id, episodes, joints)
    exact, _ = tips(env_id, actions, EXACT)

    def errors(places: Array, truth: Array) -> Array:
        distance = np.hypot(*np.moveaxis(places - truth, 2, 0)) / own.arm.total_length * 100.0
        return np.asarray(np.where(np.isnan(distance).any(axis=0), np.inf, distance.max(axis=0)))

    weak, _ = tips(env_id, WEAK * actions, EXACT)
    coarser = {word: percentile(errors(tips(env_id, actions, options)[0], exact)) for word, options in COARSER.items()}
    print(f"{env_id}: the reference differs from coarser ones by {coarser} % of L", flush=True)
    found: list[Row] = []
    for options in candidates():
        share, truth = (WEAK, weak) if reduced(options) else (1.0, exact)
        places, failed = tips(env_id, share * actions, options)
        error = errors(places, truth)
        default = plan(own.kind, **options).settings == own.settings
        halves = {"random": spread(error[:episodes]), "bang_bang": spread(error[episodes:])}
        found.append({"options": options, "failed": failed, "default": default, **halves})
        print(f"  {label(options):60s} {worst(found[-1]):9.4f} %{' (default)' * default}", flush=True)
    if not any(row["default"] for row in found):
        raise SystemExit(f"add the defaults of {env_id} to the candidates: {own.settings}")
    take_times(env_id, found)
    return {"episodes": episodes, "reference_spread": coarser, "candidates": found}


def table_of(env_id: str, found: Row) -> list[str]:
    """Return an environment's table in Markdown, cheapest candidate first."""
    kind = gym.make(env_id).unwrapped.plan.kind
    rows = []
    for row in sorted(found["candidates"], key=lambda row: row["microseconds_vector"]):
        options, single = row["options"], row["microseconds_single"]
        errors = ("-" if row[name][f"{SHARE:g}"] is None else f"{row[name][f'{SHARE:g}']:.3f} %" for name in KINDS)
        mark = f"{AIM:g} %" if worst(row) <= AIM else f"{LIMIT:g} %" if worst(row) <= LIMIT else "–"
        asked = {name: options[name] for name in ("formulation", "modes") if name in options}
        name = f"**{label(options)}** (default)" if row["default"] else label(options)
        if not row["default"] and plan(kind, **options).settings == plan(kind, **asked).settings:
            name += " (default of the formulation)"
        alone = "" if np.isnan(single) else f"{single:.2f}"
        rows.append((name, *errors, row["failed"], f"{row['microseconds_vector']:.3f}", alone, mark))
    coarser, heads = found["reference_spread"], f"settings | random {SHARE:g} % | bang-bang {SHARE:g} % | failed"
    return [
        f"The table is computed from {found['episodes']} episodes of {HORIZON[env_id]:g} s for each kind of torque "
        "(random and bang-bang). The reference is "
        f"{label(EXACT)}. "
        f"In {SHARE:g} % of the episodes, doubling the reference's time step changes the tip's position by at most "
        f"{coarser['step']:.4f} % of L. A mesh of "
        f"{COARSER['mesh']['elements']} elements changes the position by at most {coarser['mesh']:.4f} % of L.", "",
        *table(f"{heads} | µs, vector | µs, single | error within", rows),
    ]  # fmt: skip


def cheapest(environments: dict[str, Row]) -> list[str]:
    """Format the cheapest candidates within limit and aim, for each environment and for both."""
    cells = []
    for limit in (LIMIT, AIM):
        every = []
        for env_id, found in environments.items():
            rows = [row for row in found["candidates"] if worst(row) <= limit and not reduced(row["options"])]
            good = {label(row["options"]): row["microseconds_vector"] for row in rows}
            best = min(good, key=good.__getitem__, default="none")
            cells.append((f"{limit:g} %", env_id, best, f"{good.get(best, np.nan):.3f}"))
            every.append(good)
        shared = set.intersection(*(set(good) for good in every))
        best = min(shared, key=lambda label: sum(good[label] for good in every), default="none")
        cells.append((f"{limit:g} %", "both", best, ""))
    return table("error within | environment | cheapest setting | µs, vector", cells)


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    environments = found["environments"]
    return {**{env_id: table_of(env_id, own) for env_id, own in environments.items()}, "best": cheapest(environments)}


def measured(options: argparse.Namespace) -> pages.Found:
    """Measure the requested environments."""
    found = {env_id: measure(env_id, options.episodes) for env_id in options.env or IDS}
    enough = {
        f"{env_id}: the default is good enough": all(worst(r) <= LIMIT for r in own["candidates"] if r["default"])
        for env_id, own in found.items()
    }
    return {"environments": found, "verdicts": enough}


if __name__ == "__main__":
    flags = {"env": {"choices": IDS, "action": "append", "help": "only this environment"}}
    sys.exit(pages.run("default_settings", __doc__, measured, blocks, more=flags, episodes=200))
