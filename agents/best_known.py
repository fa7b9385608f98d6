"""Find the quickest known settling in the evaluation episodes by optimizing the torques of each episode.

    python -m agents.best_known                          # both environments: a quarter of an hour of one core
    python -m agents.best_known --only slew --episodes 10

For every episode the script searches the fewest control periods after which the tip stays in its band to the end of the
episode (`flexarm_env.control.optimal.least_settling`). The search has several initial guesses. The first is the first
plan of the receding-horizon controller. For two links there are two first plans, with the elbow bent to either side at
the goal. The last guess is the motion under the quickest of the policies and controllers. If no plan is quicker, the
motion of the last guess is the result. A plan consists of torques alone. The torques are applied without feedback in
the environment, where the settling time is measured, and then on the converged exact beam. A quicker motion may exist.

The episodes are planned in lots of several episodes. A lot that docs/results/optimal.json contains is not planned
again, so that an interrupted run can be continued. The script writes docs/results/optimal.{json,md}; `python -m
agents.table` compares the policies with these results.
"""

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents import families
from agents.families import RECORDED, ROOT
from benchmarks.machine import table, told
from benchmarks.pages import write_page
from flexarm_env import control
from flexarm_env.control import optimal
from flexarm_env.control.dynamics import Dynamics, dynamics
from flexarm_env.control.mpc import MPC, MPCGains, regulator
from flexarm_env.episodes import Actions, measures
from flexarm_env.training import episodes as fixed
from flexarm_env.training.policies import choose
from flexarm_env.training.runs import command, read_json, versions, write_json
from flexarm_env.validation import Array

EXACT: dict[str, Any] = {"elements": 4, "order": 3, "dt": 0.001, "tolerance": 1e-8}
"""Solver options of the converged exact beam, whose own error is a hundredth of the band of a settled tip."""

AFTER = MPCGains(10.0, 10.0, 10.0, 10.0)
"""Weights of a plan's cost after the tip has reached its band, and of the regulator that holds the arm afterwards."""

GUESSED = {"slew": MPCGains(50.0, 50.0, 50.0, 50.0), "reach": MPCGains(50.0, 20.0, 20.0, 20.0)}
"""Gains of the receding-horizon controller that makes the first guesses; they are high, since the arm is nominal."""

POLICY = "quickest policy"
"""Name of the initial guess that consists of the quickest policies' actions."""

WANTED = 1.15
"""Settling time required of a policy, over the shortest one known."""

NEAR = 1.3
"""Limit for further guesses: arrival time over the shortest settling time found so far; later guesses are skipped."""


@dataclass(frozen=True)
class Case:
    """Environment, its number of episodes, and the number of episodes that are planned together (`lot`).

    tail: control periods of a plan after settling. families: families of trained policies; the best policy of each is
    evaluated too.
    """

    env: str
    episodes: int
    lot: int
    tail: int
    families: tuple[str, ...]


CASES = {
    "slew": Case("FlexibleArm-v0", 100, 50, 30, ("flexible_arm",)),
    "reach": Case("TwoLinkFlexArm-v0", 200, 40, 25, ("two_link", "two_link_torque")),
}


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.best_known`.

    Args:
        only: slew or reach; default both.
        episodes: number of episodes of each environment, for a preview whose results are not written; default all.
        results: folder of the page and its JSON.
    """

    only: str | None = None
    episodes: int | None = None
    results: Path = ROOT / "docs" / "results"


class Watched:
    """Policy wrapper that records the joint torques (n, N), N m, which the wrapped policy's actions cause."""

    def __init__(self, policy: Any, env: Any, torques: list[Array]) -> None:
        self.policy, self.batch, self.torques = policy, env.unwrapped.batch, torques

    def note(self) -> None:
        """Record the torques of the last period."""
        batch = self.batch
        self.torques.append(np.array([batch.view(i).torques for i in range(batch.n)]))

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Reset the policy."""
        self.policy.reset(observation)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Record the last torques and return the policy's action."""
        self.note()
        action: NDArray[np.float32] = self.policy.act(observation)
        return action


class OtherWay(MPC):
    """Receding-horizon controller whose goal has the elbow bent to the other side."""

    def _goal(self, signals: Any) -> Array:
        """Return the goal angles (n, 2), rad, with the elbow bent to the other side."""
        goal = super()._goal(signals)
        first, second = (link.span for link in self.setup.arm.links)
        bent = goal[:, 1]
        turn = 2.0 * np.arctan2(second * np.sin(bent), first + second * np.cos(bent))
        return np.stack([goal[:, 0] + turn, -bent], axis=1)


@dataclass(frozen=True)
class Lot:
    """Episodes that are planned together: initial states x (n, S), targets of the tips, and widths of their bands."""

    plant: Dynamics
    x: Array
    target: Array
    band: Array

    def off(self, x: Array, arms: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the tip's distance from its target, over the band's width, and the derivative by the state.

        See `optimal.least_settling`.
        """
        tip, slope = self.plant.tip(x)
        target, band = self.target[arms], self.band[arms, None]
        if self.target.ndim == 1:
            angle = np.arctan2(tip[..., 1], tip[..., 0]) - target
            off = (angle + np.pi) % (2.0 * np.pi) - np.pi
            across = np.stack([-tip[..., 1], tip[..., 0]], axis=-1) / (tip**2).sum(-1)[..., None]
            side = np.sign(off)[..., None] * across
        else:
            way = tip - target
            off = np.sqrt((way**2).sum(-1) + 1e-18)
            side = way / off[..., None]
        return np.abs(off)[..., None] / band, np.einsum("...i,...is->...s", side, slope)[..., None, :] / band[..., None]


def lot_of(env: Any, first: int) -> Lot:
    """Return the episodes of an environment, one per arm, from the seed `first` on."""
    setup, batch = control.Setup.of(env), env.unwrapped.batch
    plant = dynamics(setup.arm, setup.control_dt)
    _, info = env.reset(seed=first)
    x = np.array([np.concatenate(batch.motion(i)[:2]) for i in range(env.num_envs)])
    target = np.array(info["target"])
    if setup.task == "slew":
        way = np.abs(target - x[:, 0])
        return Lot(plant, x, target, measures.settling_band(setup, way))
    return Lot(plant, x, target, measures.settling_band(setup, np.zeros(len(x))))


class Guess(NamedTuple):
    """Initial guess: actions (T, n, N), joint angles at the goal (n, N), control periods until the arrival (n,)."""

    actions: Array
    goal: Array
    periods: NDArray[np.int64]


def guesses(env: Any, first: int) -> dict[str, Guess]:
    """Return initial guesses by name: the first plans of the receding-horizon controller."""
    setup = control.Setup.of(env)
    made = {"elbow as chosen": MPC(setup, GUESSED[setup.task])}
    if setup.task == "reach":
        made["other elbow"] = OtherWay(setup, GUESSED[setup.task])
    observation, _ = env.reset(seed=first)
    found = {}
    for name, controller in made.items():
        controller.reset(observation)
        actions = np.repeat(controller.plan.controls, controller.gains.block, axis=0)
        found[name] = Guess(actions, controller.goal.copy(), controller.arrival.astype(np.int64))
    return found


class Judged(NamedTuple):
    """Results of trained policies and controllers.

    settling, returns: settling time, s, and return of each episode, by the policy's name. actions (T, n, N): torques of
    each episode's quickest policy, divided by their limits. ends (n, S): states at the end under these torques.
    """

    settling: dict[str, list[float]]
    returns: dict[str, list[float]]
    actions: Array
    ends: Array


def policies(case: Case, first: int, count: int) -> Judged:
    """Evaluate the trained policies and the controllers of a case on `count` episodes from the seed `first` on."""
    named = families.named(case.families[0])
    made = {
        f"PPO ({name})": choose(str(families.named(name).best(families.TRAINED)), case.env) for name in case.families
    }
    made |= {name: choose(name, case.env) for name in named.controllers}
    settling: dict[str, list[float]] = {}
    returns: dict[str, list[float]] = {}
    for name, chosen in made.items():
        env = fixed.make_episodes(case.env, count, **{**chosen.env_kwargs, **RECORDED})
        torques: list[Array] = []
        policy = Watched(chosen.make(env), env, torques)
        outcome = fixed.run(env, policy, first)
        policy.note()
        own = np.array(torques[1:]) / np.array(control.Setup.of(env).torque_limits)
        end = np.concatenate(env.unwrapped.batch.motions()[:2], axis=1)
        env.close()
        if not settling:
            actions, ends, best = own, end, outcome.settling.copy()
        better = outcome.settling < best
        actions[:, better], ends[better], best[better] = own[:, better], end[better], outcome.settling[better]
        settling[name], returns[name] = outcome.settling.tolist(), outcome.returns.tolist()
    return Judged(settling, returns, actions, ends)


def followed(lot: Lot, known: Judged, ways: list[Array]) -> Guess:
    """Return the actions of each episode's quickest policy as an initial guess.

    ways: several joint angles (n, N), rad, that reach the target; the guess has those nearest to the policy's final
    angles.
    """
    angles = known.ends[:, lot.plant.joints]
    turned = np.array([goal + 2.0 * np.pi * np.round((angles - goal) / (2.0 * np.pi)) for goal in ways])
    nearest = np.argmin(np.abs(turned - angles).max(axis=2), axis=0)
    best = np.min(list(known.settling.values()), axis=0)
    goal = turned[nearest, np.arange(len(angles))]
    return Guess(known.actions, goal, np.round(best / lot.plant.period).astype(np.int64))


def planned(lot: Lot, case: Case, guess: Guess, limit: int) -> Array:
    """Return actions (limit, n, N) of complete episodes: optimized, or the guess's if the optimization fails."""
    plant, goal = lot.plant, guess.goal
    if plant.n_inputs == 1:
        goal = lot.target[:, None]
    home, arm, period = plant.rest(goal), plant.arm, plant.period
    stage = plant.stage_weight(AFTER)
    after = [regulator(arm, period, AFTER, tuple(angles[1:].tolist())) for angles in goal]
    motion = optimal.least_settling(
        plant, lot.x, home, lot.off, (stage, np.stack([r.P for r in after])), guess=guess.actions,
        periods=guess.periods, tail=case.tail, most=limit // 2,
    )  # fmt: skip
    gains, x, out = np.stack([r.K for r in after]), lot.x, np.zeros((limit, len(goal), plant.n_inputs))
    own = np.zeros(out.shape)
    own[: len(guess.actions)] = guess.actions
    own[: len(motion.controls), motion.found] = motion.controls[:, motion.found]
    until = np.where(motion.found, motion.ends, len(guess.actions))
    for k in range(limit):
        regulated = np.clip(-np.einsum("nas,ns->na", gains, x - home), -1.0, 1.0)
        out[k] = np.where((k < until)[:, None], own[k], regulated)
        x = plant.advance(x, out[k])
    return out


def solve_lot(case: Case, first: int, count: int) -> dict[str, Any]:
    """Plan a lot and return its record.

    The record contains the settling times, s, of each initial guess, and the results of each episode's best actions in
    the environment and on the exact beam.
    """
    began = time.process_time()
    env = fixed.make_episodes(case.env, count, **RECORDED)
    limit = int(env.unwrapped.plan.limit)
    lot = lot_of(env, first)
    starts: dict[str, list[float | None]] = {}
    best, actions = np.full(count, np.inf), np.zeros((limit, count, lot.plant.n_inputs))
    begun = guesses(env, first)
    known = policies(case, first, count)
    begun[POLICY] = followed(lot, known, [guess.goal for guess in begun.values()])
    for name, guess in begun.items():
        near = np.flatnonzero(guess.periods * lot.plant.period < NEAR * best)
        starts[name] = [None] * count
        if near.size:
            part = Lot(lot.plant, lot.x[near], lot.target[near], lot.band[near])
            plan = actions.copy()
            own = Guess(guess.actions[:, near], guess.goal[near], guess.periods[near])
            plan[:, near] = planned(part, case, own, limit)
            settling = fixed.run(env, Actions(plan), first).settling
            if name == POLICY:
                as_it_was = fixed.run(env, Actions(guess.actions), first).settling
                better = np.isin(np.arange(count), near) & (as_it_was < settling)
                plan[:, better], settling = guess.actions[:, better], np.where(better, as_it_was, settling)
            for i in near.tolist():
                starts[name][i] = float(settling[i])
                if settling[i] < best[i]:
                    best[i], actions[:, i] = settling[i], plan[:, i]
    env.close()
    outcomes = {}
    for name, keywords in {"environment": {}, "exact": {"formulation": "geometrically_exact", **EXACT}}.items():
        env = fixed.make_episodes(case.env, count, **keywords, **RECORDED)
        outcomes[name] = fixed.run(env, Actions(actions), first)
        env.close()
    result = outcomes["environment"]
    return {
        "first": first, "count": count, "cpu_s": time.process_time() - began, "starts": starts,
        "settling": result.settling.tolist(), "exact": outcomes["exact"].settling.tolist(),
        "policies": known.settling, "policies_returns": known.returns, "returns": result.returns.tolist(),
        "success": result.success.tolist(), "exact_success": outcomes["exact"].success.tolist(),
        "effort": result.effort.tolist(),
    }  # fmt: skip


def joined(lots: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Join the results of all lots."""
    keys = ("settling", "exact", "success", "exact_success", "effort", "returns")
    out: dict[str, Any] = {key: np.array([v for lot in lots for v in lot[key]]) for key in keys}
    names = dict.fromkeys(name for lot in lots for name in lot["starts"])
    starts = {name: [lot["starts"].get(name, [None] * lot["count"]) for lot in lots] for name in names}
    out["starts"] = {name: np.array([v for part in found for v in part], np.float64) for name, found in starts.items()}
    for key in ("policies", "policies_returns"):
        out[key] = {name: np.array([v for lot in lots for v in lot[key][name]]) for name in lots[0][key]}
    out["cpu_s"] = sum(float(lot["cpu_s"]) for lot in lots)
    return out


def blocks(content: Mapping[str, Any]) -> dict[str, list[str]]:
    """Format the tables of docs/results/optimal.md."""
    rows, spread, apart = [], [], []
    for name, case in CASES.items():
        lots = list(content["lots"].get(name, {}).values())
        if not lots:
            continue
        found = joined(lots)
        best, exact = found["settling"], found["exact"]
        rows.append((
            case.env, f"{len(best)} of {case.episodes}", f"{np.median(best):.2f}", f"{best.mean():.3f}",
            f"{np.median(exact):.2f}", f"{exact.mean():.3f}", f"{found['exact_success'].mean():.1%}",
            f"{np.median(found['effort']):.2f}", f"{found['returns'].mean():.1f}", f"{found['cpu_s']:.0f}",
        ))  # fmt: skip
        for start, values in found["starts"].items():
            tried = ~np.isnan(values)
            behind = values[tried] - best[tried]
            times = f"{np.median(values[tried]):.2f}", f"{behind.mean():.3f}", f"{behind.max():.2f}"
            spread.append((case.env, start, tried.sum(), *times, (behind < 1e-9).sum()))
        for policy, values in found["policies"].items():
            ratio = values / best
            apart.append((
                case.env, policy, f"{values.mean():.3f}", f"{values.mean() / best.mean():.2f}",
                f"{np.median(ratio):.2f}", f"{np.quantile(ratio, 0.9):.2f}", f"{(ratio <= WANTED + 1e-9).mean():.0%}",
                f"{found['policies_returns'][policy].mean():.1f}",
            ))  # fmt: skip
    heads = (
        "environment | episodes | settling time, median (s) | mean (s) | on the exact beam: settling time, median "
        "(s) | "
        "mean (s) | success | median effort (s) | mean return | planning, CPU (s)",
        "environment | policy | mean settling time (s) | ratio of the means | median ratio | 90th percentile of the "
        f"ratio | episodes with a ratio up to {WANTED} | mean return",
        "environment | initial guess | optimized episodes | median settling time (s) | mean excess over the best plan "
        "(s) | largest excess (s) | episodes with the best plan",
    )
    machine = {"machine": [told(content["machine"])]}
    return machine | {
        "best": table(heads[0], rows, True), "policies": table(heads[1], apart, True),
        "guesses": [line.replace("---|---:", "---|---", 1) for line in table(heads[2], spread, True)],
    }  # fmt: skip


def find_all(arguments: Arguments) -> None:
    """Plan all missing lots, and write the page and its numbers."""
    path = arguments.results / "optimal.json"
    if arguments.only is not None and arguments.only not in CASES:
        raise ValueError(f"--only {arguments.only}: must be one of {', '.join(CASES)}")
    content = read_json(path) if path.exists() else {"lots": {}}
    content["machine"] = {"date": date.today().isoformat(), **versions()}
    for name in CASES if arguments.only is None else [arguments.only]:
        case = CASES[name]
        if arguments.episodes is not None:
            lot = solve_lot(case, fixed.TEST, arguments.episodes)
            found = blocks({**content, "lots": {name: {"0": lot}}})
            print("\n\n".join("\n".join(lines) for lines in found.values()))
            continue
        lots = content["lots"].setdefault(name, {})
        for first in range(0, case.episodes, case.lot):
            if str(first) not in lots:
                lots[str(first)] = solve_lot(case, fixed.TEST + first, case.lot)
                print(f"{case.env}: {first + case.lot} of {case.episodes} episodes", flush=True)
                write_json(path, content)
                write_page(arguments.results, "optimal", blocks(content))


main = partial(command, Arguments, "python -m agents.best_known", __doc__, find_all)

if __name__ == "__main__":
    sys.exit(main())
