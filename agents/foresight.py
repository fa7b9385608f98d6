"""The best known on a task: an episode's torques by the gradient of its own return, the episode known beforehand.

No policy knows so much: starts, payloads and targets are those of the very episode, nothing has to be measured, and the
torques follow from time alone. What is found is a local optimum, reached from the actions of controllers that see the
whole state; it is played in the task itself, sensors and all, where it must give the return that was found.
`python -m agents.suite --only foresight`.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents import payoff
from flexarm_env import suite
from flexarm_env.files import write_npz
from flexarm_env.suite.best import Actions
from flexarm_env.suite.judge import checked
from flexarm_env.suite.policies import Chosen, choose, fingerprint
from flexarm_env.suite.score import EPISODES, FIRST
from flexarm_env.training.runs import read_json, write_json
from flexarm_env.validation import Array

SENSED = ("observation", "history", "sensors")
"""Keywords that say what is seen, which torques found beforehand do not depend on."""
CONTROLLERS = ("pd", "zv", "zvd", "lqr", "lqg", "mpc", "time_optimal")
"""Where the search begins: in each episode with the actions of the best of them; in space without mpc, a decision of
which takes 10 ms and more."""
PATIENCE, ENOUGH = 30, 1e-4
"""A search ends where so many steps have brought no more than this share of the mean return."""
MEMORY = 12
"""Moves that a search remembers."""
GROWTH, STAGE, STRESS = 40, 40, 5.0
"""Of searches that grow: by how many periods, steps of each, and the weight of an episode's end; see `growing`."""
LARGE = 1e4
"""Beyond any return: an episode that ends early lies below."""
ALIKE = 1e-6
"""Share by which an episode may pay otherwise in the task than in the search."""


def played(env: Any, policy: Any, price: float = 0.0) -> tuple[Array, Array]:
    """Actions (T, n, N) and J (n,) of a policy on the episodes, in a vector environment of them."""
    limit, n = int(env.unwrapped.plan.limit), int(env.num_envs)
    actions = np.zeros((limit, *env.action_space.shape), np.float32)
    returns, costs, alive = np.zeros(n), np.zeros(n), np.ones(n, bool)
    observation, _ = env.reset(seed=FIRST)
    policy.reset(observation)
    for k in range(limit):
        actions[k] = checked(policy.act(observation), env.action_space.shape)
        observation, reward, terminated, truncated, info = env.step(actions[k])
        returns += np.where(alive, reward, 0.0)
        costs += np.where(alive, info.get("cost", 0.0), 0.0)
        alive &= ~(terminated | truncated)
    return actions, returns - price * costs


def beginnings(task: suite.Task, trained: Sequence[Path] = ()) -> tuple[Array, Array]:
    """Return actions and J of each episode's best controller, and of its best trained policy.

    Controllers see the whole state; policies (run folders) see what the task shows, or the whole state.
    """
    named = [word for word in CONTROLLERS if word != "mpc" or task.environment != payoff.SPACE]
    whole = gym.make_vec(task.environment, EPISODES, vectorization_mode="vector_entry_point", **seen_whole(task))
    shown = suite.make_vec(task.id, EPISODES) if trained and set(SENSED) & set(task.keywords) else whole
    words = [*((word, whole) for word in named), *((str(path), shown) for path in trained)]
    tried = []
    for word, env in [*words, *((str(path), whole) for path in trained if whole is not shown)]:
        with suppress(ValueError):  # of what is not made for the task, or for what is seen
            tried.append(played(env, choose(word, task).make(env), task.price))
    for env in (whole, shown):
        env.close()
    if not tried:
        raise ValueError(f"{task.id}: no controller to begin with")
    return best_of(*zip(*tried, strict=True))


def best_of(ways: Sequence[Array], values: Sequence[Array]) -> tuple[Array, Array]:
    """Of each episode the best of actions (T, n, N) with values (n,), the first of equal ones, and its value."""
    first = np.argmax(values, axis=0)
    return np.stack(ways)[first, :, np.arange(EPISODES)].transpose(1, 0, 2), np.max(values, axis=0)


def seen_whole(task: suite.Task) -> dict[str, Any]:
    """Keywords of the task's environment without its sensors."""
    return {key: value for key, value in task.arguments.items() if key not in SENSED}


def search(
    task: suite.Task,
    trained: Sequence[Path] = (),
    *,
    steps: int = 500,
    kept: Path | None = None,
    start: tuple[Array, Array] | None = None,
    lifting: bool = False,
    stages: Sequence[Array] = (),
    only: Sequence[int] = range(EPISODES),
    steadied: bool = False,
    grid: float = 0.0,
) -> tuple[Array, Array]:
    """Actions (T, n, N) of the episodes and their returns (n,).

    trained: run folders to begin with, beside controllers. steps: see `climb`. In space, or if `steadied`, an arm is
    steadied by that of `trained` which sees all there is and does it best. kept: a file in which actions are kept on
    the way, and from which a search that was broken off goes on. start: actions and their returns to begin with, in
    place of all that. lifting: see `payoff.Fine`. stages: weights (T,) of the periods' rewards in searches before, of
    `STAGE` steps each, whose last actions the search begins with, better or not (see `growing`). only: of which
    episodes, the n of them. grid: actions are handed on in parts of it, where it is not 0.
    ValueError where the task's environment has no derivatives, or does not give these returns.
    """
    from flexarm_env.derivatives import Arms

    if start is None:
        start = beginnings(task, trained) if kept is None or not kept.is_file() else read(kept)
    best, reached = np.take(start[0], only, 1), np.take(start[1], only)
    arms = Arms(task.environment, len(only), **seen_whole(task))
    seeds = [FIRST + int(k) for k in only]
    first, shape = arms.reset(seed=seeds), best.shape
    fine = payoff.Fine(task, arms.environment.plan, arms.names, lifting)

    moved: Any = payoff.InTask(arms, seeds) if "pushes" in task.keywords else arms
    steady = None

    def value(x: Array, weight: Array | None = None) -> tuple[Array, Array, Array]:
        wanted = x.reshape(arms.n, shape[0], shape[2]).transpose(1, 0, 2)
        total, slopes, played = payoff.returned(moved, first, wanted, fine, steady, weight, grid)
        return total, np.nan_to_num(slopes.transpose(1, 0, 2).reshape(arms.n, -1)), played

    pulled = steadied or task.environment == payoff.SPACE
    policies = payoff.steadiers(task, arms.environment, trained) if pulled else []
    if policies:
        steady = payoff.steadiest(moved, first, payoff.exact(best), policies)
    x = payoff.exact(best.transpose(1, 0, 2).reshape(arms.n, -1))
    found = value(x)
    if not grid and not fine.shapes and np.nanmax(np.abs(found[0] - reached) / (1.0 + np.abs(reached))) > ALIKE:
        raise ValueError(f"{task.id}: the search's episodes are not the task's: {found[0][:3]} for {reached[:3]}")
    found = np.where(np.isnan(found[0]), reached, found[0]), *found[1:]
    for weight in stages:
        x, *_ = climb(partial(value, weight=weight), x, value(x, weight), STAGE)
        found = value(x)
    best, reached = climb(value, x, found, steps, kept)[1:]
    arms.close()
    return best, reached


def climb(
    value: Callable[[Array], tuple[Array, Array, Array]],
    x: Array,
    found: tuple[Array, Array, Array],
    steps: int,
    kept: Path | None = None,
) -> tuple[Array, Array, Array]:
    """Ascend from actions x (n, T N) of n episodes; return x, played actions and returns at the end.

    value: function that returns returns (n,), slopes (n, T N) and played actions (T, n, N).
    """
    reached, slope, best = found
    reached = np.where(np.isnan(reached), -LARGE, reached)
    moves: list[tuple[Array, Array]] = []
    length = np.ones(len(x))
    course = [float(reached.mean())]
    for _ in range(steps):
        if len(course) > PATIENCE and course[-1] - course[-PATIENCE] < ENOUGH * (1.0 + abs(course[-1])):
            break
        free = ~(((x >= 1.0) & (slope > 0.0)) | ((x <= -1.0) & (slope < 0.0)))
        way = _newton(np.where(free, slope, 0.0), moves) * free
        tried = payoff.exact(np.clip(x + length[:, None] * way, -1.0, 1.0))
        total, there, played = value(tried)
        better = total > reached
        best = np.where(better[None, :, None], played, best)
        took = better[:, None]
        moves = [*moves[1 - MEMORY :], (np.where(took, tried - x, 0.0), np.where(took, slope - there, 0.0))]
        x, slope, reached = np.where(took, tried, x), np.where(took, there, slope), np.fmax(reached, total)
        length = np.where(better, np.minimum(1.0, 2.0 * length), 0.5 * length)
        stuck = length < 1e-7
        for one, other in moves:  # forget what led nowhere
            one[stuck], other[stuck] = 0.0, 0.0
        length[stuck] = 1.0
        course.append(float(reached.mean()))
        if kept is not None and len(course) % PATIENCE == 0:
            keep(kept, best, reached)
    return x, best, reached


def growing(periods: int, end: int) -> list[Array]:
    """Return weights (T,) of successive searches over growing parts of an episode.

    The first search counts `2 GROWTH` periods, each later one `GROWTH` more; the last counts all, the `end` last ones,
    in which success is judged, `STRESS`-fold. Later periods so cannot spoil an episode's beginning.
    """
    shares = [np.arange(periods) < count for count in range(2 * GROWTH, periods + GROWTH, GROWTH)]
    return [*(np.where(share, 1.0, 0.0) for share in shares), np.where(np.arange(periods) < periods - end, 1.0, STRESS)]


def beside(task: suite.Task, home: Path) -> list[Path]:
    """Return the run folders of policies: the task's own, then, in space, those of tasks with other sensors."""
    tasks = [task.id, *(one.id for one in suite.tasks() if one.environment == task.environment == payoff.SPACE)]
    return [path.parent for name in dict.fromkeys(tasks) for path in sorted(home.glob(f"*/{name}/policy.npz"))]


def keep(path: Path, actions: Array, returns: Array) -> None:
    """Write actions (T, n, N) and returns (n,)."""
    write_npz(path, {"actions": actions.astype(np.float32), "returns": returns})


def read(path: Path) -> tuple[Array, Array]:
    """Read what `keep` wrote: actions (T, n, N) and returns (n,)."""
    with np.load(path) as data:
        return data["actions"].astype(float), data["returns"].astype(float)


def _newton(slope: Array, moves: Sequence[tuple[Array, Array]]) -> Array:
    """Uphill (n, d) by the moves (n, d) made and what the slope fell by, the oldest first."""
    way, shares = slope.copy(), []
    for move, fall in reversed(moves):
        along = np.sum(move * fall, axis=1)
        inverse = np.where(along > 1e-12 * np.sum(fall**2, axis=1), 1.0 / np.where(along > 0.0, along, 1.0), 0.0)
        share = inverse * np.sum(move * way, axis=1)
        way -= share[:, None] * fall
        shares.append((inverse, share))
    size = np.full(len(slope), np.nan)
    for move, fall in moves:
        along, square = np.sum(move * fall, axis=1), np.sum(fall**2, axis=1)
        good = along > 1e-12 * square
        size = np.where(good & (square > 0.0), along / np.where(square > 0.0, square, 1.0), size)
    first = 0.01 / np.maximum(np.abs(slope).max(axis=1), 1e-12)
    way *= np.where(np.isfinite(size), size, first)[:, None]
    for (move, fall), (inverse, share) in zip(moves, reversed(shares), strict=True):
        way += (share - inverse * np.sum(fall * way, axis=1))[:, None] * move
    return way


def found(task: suite.Task, folder: Path) -> Path:
    """The folder with the actions of a task's episodes: searched for, or there already; policies beside it help."""
    path = folder / "actions.npz"
    if not path.is_file():
        wall, cpu = time.perf_counter(), time.process_time()
        trained = beside(task, folder.parents[1])
        actions, returns = search(task, trained, kept=folder / "search.npz")
        if "keep_out" in task.keywords:
            lifted = search(task, trained, start=search(task, trained, start=(actions, returns), lifting=True))[0]
            actions, returns = better(task, actions, lifted)
        spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        write_json(folder / "run.json", {"algorithm": "foresight", "steps": 0, **spent})
        keep(path, actions, returns)
    return folder


def better(task: suite.Task, *ways: Array) -> tuple[Array, Array]:
    """Of each episode the best of actions (T, n, N), as the task has it, and the returns."""
    env = suite.make_vec(task.id, EPISODES)
    values = [played(env, Actions(way), task.price)[1] for way in ways]
    env.close()
    return best_of(ways, values)


def chosen(folder: Path) -> Chosen:
    """What was found, as a policy of the task's episodes; ValueError where it is played on others."""
    path = folder / "actions.npz"
    record = read_json(folder / "run.json")
    actions, _ = read(path)

    def make(env: Any) -> Actions:
        if (int(env.num_envs), env.single_action_space.shape[0]) != actions.shape[1:]:
            raise ValueError(f"{path}: actions of {actions.shape[1]} episodes, which are judged together or not at all")
        return Actions(actions)

    return Chosen("actions", folder.name, fingerprint(path.read_bytes()), make, 0, record)
