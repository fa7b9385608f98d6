"""Which formulation and step the environments use where nothing is said: docs/results/default_settings.{md,json}.

python -m benchmarks.choose_default [--env ID] [--episodes 200] [--out FOLDER]

Every candidate runs the same episodes as the converged exact beam: `episodes` under a random policy (a new torque in
each control period) and as many under random bang-bang torque (full torque of either sign, switched after 0.1 to 0.6 s
at random); two links over the first 2 s only, since longer runs of theirs are chaotic. The error of an episode is the
largest distance of the tip from the exact one's, over L. A candidate is good enough where that stays within 0.5 % for
99 % of the episodes of either kind, and 0.1 % is aimed at. The default, one for both environments, is the cheapest
candidate (sum of both costs in a vector) that reaches the aim in both, or else the cheapest that is good enough. The
exit code is 1 where the package's defaults are not good enough. A few minutes of CPU time, and as many again for
compilation the first time.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import flexarm_env
from benchmarks.machine import command, describe_machine, publish, table, told
from flexarm_env.envs.options import plan

Array = NDArray[np.float64]

IDS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")
HORIZON = {"FlexibleArm-v0": 4.0, "TwoLinkFlexArm-v0": 2.0}
LIMIT, AIM, SHARE = 0.5, 0.1, 99.0
WEAK = 0.25
"""Share of the torque under which links that are reduced to modes stay within their range."""
"""Errors in % of L, and the percentile of the episodes that they are asked of."""

EXACT: dict[str, Any] = {
    "formulation": "geometrically_exact", "elements": 6, "order": 3, "dt": 2.5e-4, "tolerance": 1e-10,
}  # fmt: skip
COARSER: dict[str, dict[str, Any]] = {"step": EXACT | {"dt": 5e-4}, "mesh": EXACT | {"elements": 4}}
"""Checks that EXACT is converged: twice the step, a coarser mesh."""

PERCENTILES = (50.0, 95.0, SHARE, 100.0)


@dataclass
class Candidate:
    """Settings and what was measured of them; errors (episodes,) in % of L, infinite where an episode failed."""

    options: dict[str, Any]
    random: Array = field(default_factory=lambda: np.zeros(1))
    bang_bang: Array = field(default_factory=lambda: np.zeros(1))
    vector: float = float("nan")  # CPU microseconds of one arm and control period, in a batch on one thread
    single: float = float("nan")  # the same of `step` of a single environment
    failed: int = 0
    default: bool = False
    of_formulation: bool = False  # the default where its formulation, or modes, is asked for

    @property
    def worst(self) -> float:
        """The larger of both kinds' percentiles."""
        return max(percentile(self.random), percentile(self.bang_bang))

    @property
    def label(self) -> str:
        """The options in a line."""
        parts = [str(self.options["formulation"])] if "formulation" in self.options else []
        for name, value in self.options.items():
            if name == "dt":
                parts.append(f"dt {value * 1e3:.4g} ms")
            elif name == "multipliers":
                parts.append(name)
            elif name == "frame":
                parts.append(f"frame {value}")
            elif name == "period_correction":
                parts.append("period corrected")
            elif name != "formulation":
                parts.append(f"{name} {value:g}")
        if reduced(self.options):
            parts.append(f"{WEAK:g} of the torque")
        return ", ".join(parts)

    def table(self) -> dict[str, Any]:
        """What goes into the JSON file."""

        def spread(errors: Array) -> dict[str, float | None]:
            values = {f"{share:g}": percentile(errors, share) for share in PERCENTILES}
            return {name: value if np.isfinite(value) else None for name, value in values.items()}

        return {
            "options": self.options, "microseconds_vector": self.vector, "microseconds_single": self.single,
            "failed": self.failed, "default": self.default,
            "random": spread(self.random), "bang_bang": spread(self.bang_bang),
        }  # fmt: skip


def percentile(errors: Array, share: float = SHARE) -> float:
    """The error that `share` % of the episodes do not exceed (one of them, not interpolated)."""
    return float(np.percentile(errors, share, method="higher"))


def candidates() -> list[dict[str, Any]]:
    """Settings to be tried, besides the package's own defaults."""
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
    return rows


def reduced(options: dict[str, Any]) -> bool:
    """Whether links are reduced to modes as a whole: asked within their range, `WEAK` of the torque."""
    return "modes" in options and "segments" not in options


def actions_of(env_id: str, episodes: int, joints: int) -> Array:
    """(periods, 2 episodes, joints): random torques, then random bang-bang."""
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
    """Tip positions (periods, episodes, 2), NaN from where an episode failed; and how many did."""
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
    """CPU time of a control period with some settings: in a vector of 512 arms on one thread, and alone."""

    def __init__(self, env_id: str, options: dict[str, Any], alone: bool) -> None:
        self.arms = 32 if options.get("multipliers") else 512  # the former go one by one
        more = {"joint_limits": None, "duration": 1e6, **options}
        self.vector = gym.make_vec(env_id, num_envs=self.arms, threads=1, **more)
        self.single = gym.make(env_id, **more).unwrapped if alone else None
        rng = np.random.default_rng(0)
        self.many = list(rng.uniform(-1.0, 1.0, (60, *self.vector.action_space.shape)).astype(np.float32))
        self.few = list(rng.uniform(-1.0, 1.0, (600, self.vector.action_space.shape[1])).astype(np.float32))

    def read(self) -> tuple[float, float]:
        """Microseconds of one arm and control period in the vector, and of one `step` of the single environment."""
        one = self._mean(self.vector, self.many) / self.arms
        return one, float("nan") if self.single is None else self._mean(self.single, self.few)

    @staticmethod
    def _mean(env: Any, moves: list[Any]) -> float:
        env.reset(seed=0)
        start = time.process_time()
        for move in moves:
            env.step(move)
        return (time.process_time() - start) / len(moves) * 1e6


def take_times(env_id: str, rows: list[Candidate], rounds: int = 7) -> None:
    """Fill in the costs: the least of some rounds through all candidates, so that a busy machine treats all alike."""
    watches = [Stopwatch(env_id, row.options, row.options["formulation"] == "elastica") for row in rows]
    readings = np.array([[watch.read() for watch in watches] for _ in range(rounds)])
    for row, (vector, single) in zip(rows, readings.min(axis=0), strict=True):
        row.vector, row.single = float(vector), float(single)


def measure(env_id: str, episodes: int) -> tuple[list[Candidate], dict[str, float]]:
    """All candidates of an environment, its defaults among them; how far the reference is from coarser ones, % of L."""
    joints = 1 if env_id == IDS[0] else 2
    own = gym.make(env_id).unwrapped.plan
    actions = actions_of(env_id, episodes, joints)
    exact, _ = tips(env_id, actions, EXACT)

    def errors(places: Array, truth: Array) -> Array:
        distance = np.hypot(*np.moveaxis(places - truth, 2, 0)) / own.arm.total_length * 100.0
        return np.asarray(np.where(np.isnan(distance).any(axis=0), np.inf, distance.max(axis=0)))

    weak, _ = tips(env_id, WEAK * actions, EXACT)
    spread = {word: percentile(errors(tips(env_id, actions, options)[0], exact)) for word, options in COARSER.items()}
    print(f"{env_id}: the reference differs from coarser ones by {spread} % of L", flush=True)
    found = []
    for options in candidates():
        share, truth = (WEAK, weak) if reduced(options) else (1.0, exact)
        places, failed = tips(env_id, share * actions, options)
        error = errors(places, truth)
        settings = plan(own.kind, **options).settings
        own_too = settings == own.settings
        formulation = {name: options[name] for name in ("formulation", "modes") if name in options}
        of_formulation = settings == plan(own.kind, **formulation).settings
        found.append(Candidate(options, error[:episodes], error[episodes:], failed=failed, default=own_too))
        found[-1].of_formulation = of_formulation
        print(f"  {found[-1].label:60s} {found[-1].worst:9.4f} %{' (default)' * own_too}", flush=True)
    if not any(row.default for row in found):
        raise SystemExit(f"add the defaults of {env_id} to the candidates: {own.settings}")
    take_times(env_id, found)
    return found, spread


def table_of(env_id: str, rows: list[Candidate], spread: dict[str, float], episodes: int) -> str:
    """One environment's Markdown table, cheapest first."""
    lines = [
        f"## {env_id}", "",
        f"{episodes} episodes of {HORIZON[env_id]:g} s of each kind. Reference: {Candidate(EXACT).label}; twice its "
        f"step moves the tip by {spread['step']:.4f} % of L, a mesh of {COARSER['mesh']['elements']} elements by "
        f"{spread['mesh']:.4f} % ({SHARE:g} % of the episodes).", "",
        *table(f"settings | random {SHARE:g} % | bang-bang {SHARE:g} % | failed | us, vector | us, single "
               "| good enough"),
    ]  # fmt: skip
    for row in sorted(rows, key=lambda r: r.vector):
        parts = [f"{percentile(e):.3f} %" if np.isfinite(percentile(e)) else "-" for e in (row.random, row.bang_bang)]
        mark = "aim" if row.worst <= AIM else "yes" if row.worst <= LIMIT else "no"
        name = f"**{row.label}** (default)" if row.default else row.label
        name += " (default of the formulation)" if row.of_formulation and not row.default else ""
        alone = "" if np.isnan(row.single) else f"{row.single:.2f}"
        lines.append(f"| {name} | {parts[0]} | {parts[1]} | {row.failed} | {row.vector:.3f} | {alone} | {mark} |")
    return "\n".join([*lines, ""])


def verdict(found: dict[str, list[Candidate]]) -> list[str]:
    """Which candidates are the cheapest within the limit and within the aim: of each environment, and of all."""
    lines = []
    for limit in (LIMIT, AIM):
        every = []
        for env_id, rows in found.items():
            good = {row.label: row.vector for row in rows if row.worst <= limit and not reduced(row.options)}
            best = min(good, key=good.__getitem__, default="none")
            lines.append(f"- {env_id}, within {limit:g} %: {best} ({good.get(best, np.nan):.3f} us)")
            every.append(good)
        shared = set.intersection(*(set(good) for good in every))
        best = min(shared, key=lambda label: sum(good[label] for good in every), default="none")
        lines.append(f"- all of them, within {limit:g} %: {best}")
    return ["## The cheapest", "", *lines, ""]


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the table, return 0 where the defaults are good enough."""
    parser = command(__doc__, episodes=200)
    parser.add_argument("--env", choices=IDS, action="append", help="only this environment")
    options = parser.parse_args(arguments)
    machine = describe_machine()
    text = [
        "# Default formulation and step", "",
        "Why the environments' defaults are what they are. "
        "Made by `python -m benchmarks.choose_default`; see its docstring for the rule. Errors are the largest tip "
        "distance from the converged exact beam in an episode, in % of L: the value that 99 % of the episodes do not "
        "exceed. Costs are CPU microseconds of one arm and control period (20 ms): in a vector of 512 arms on one "
        "thread, and of a single environment's `step`.", "", told(machine), "",
    ]  # fmt: skip
    data: dict[str, Any] = {"machine": machine, "version": flexarm_env.__version__, "environments": {}}
    found: dict[str, list[Candidate]] = {}
    for env_id in options.env or IDS:
        rows, spread = measure(env_id, options.episodes)
        found[env_id] = rows
        text.append(table_of(env_id, rows, spread, options.episodes))
        data["environments"][env_id] = {"reference_spread": spread, "candidates": [row.table() for row in rows]}
    publish("default_settings", options.out, data, "\n".join([*text, *verdict(found)]))
    return 0 if all(row.worst <= LIMIT for rows in found.values() for row in rows if row.default) else 1


if __name__ == "__main__":
    sys.exit(main())
