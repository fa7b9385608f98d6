"""Optimize the torques of known episodes by gradient ascent on their returns, for the best known values of the suite.

The search knows more than any policy: the start, payload and target of each episode. The search measures nothing, and
the torques depend only on time. Each result is a local optimum. The search starts from the actions of controllers that
observe the whole state. The optimized torques are then played in the task itself, with its sensors, where they must
give the return that the search computed.

    python -m agents.suite --only foresight
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
from flexarm_env.episodes import Actions, History, measures, play
from flexarm_env.files import write_npz
from flexarm_env.suite.judge import Checked
from flexarm_env.suite.policies import Chosen, choose, fingerprint
from flexarm_env.suite.score import EPISODES, FIRST
from flexarm_env.training.runs import read_json, write_json
from flexarm_env.validation import Array

SENSED = ("observation", "history", "sensors")
"""Environment keywords of the observation. These keywords do not affect the motion under given torques."""
CONTROLLERS = ("pd", "zv", "zvd", "lqr", "lqg", "mpc", "time_optimal")
"""Controllers whose actions start the search; each episode starts from the actions of its best controller. In space mpc
is omitted, because each decision of mpc takes at least 10 ms."""
PATIENCE, ENOUGH = 30, 1e-4
"""A search ends after PATIENCE steps that together increase the mean return by at most the share ENOUGH."""
MEMORY = 12
"""Number of steps stored for the quasi-Newton direction."""
GROWTH, STAGE, STRESS = 40, 40, 5.0
"""Searches over growing parts of an episode: periods added per search, steps per search, and weight of the episode's
last periods; see `growing`."""
LARGE = 1e4
"""Magnitude larger than any return: an episode that ends early has the value -LARGE in a search."""
ALIKE = 1e-6
"""Largest relative difference between an episode's return in the task and in the search."""


def played(env: Any, policy: Any, price: float = 0.0) -> tuple[Array, Array]:
    """Play a policy in a vector environment's episodes; return its actions (T, n, N) and J (n,)."""
    history = History("cost", limit=int(env.unwrapped.plan.limit), actions=True)
    play(env, Checked(policy, env.action_space.shape), range(FIRST, FIRST + int(env.num_envs)), [history])
    # zeros after an episode's end
    return np.nan_to_num(history.actions), measures.returns(history) - price * measures.cost(history)


def beginnings(task: suite.Task, trained: Sequence[Path] = ()) -> tuple[Array, Array]:
    """Return the best actions (T, n, N) of each episode among controllers and trained policies, and their J (n,).

    Controllers observe the whole state. Policies (run folders) have the task's observation or the whole state.
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
        raise ValueError(f"{task.id}: no controller starts the search")
    return best_of(*zip(*tried, strict=True))


def best_of(ways: Sequence[Array], values: Sequence[Array]) -> tuple[Array, Array]:
    """Return, for each episode, the actions (T, n, N) with the largest of the `values` (n,), and the largest value.

    Of several equal values the first one counts.
    """
    first = np.argmax(values, axis=0)
    return np.stack(ways)[first, :, np.arange(EPISODES)].transpose(1, 0, 2), np.max(values, axis=0)


def seen_whole(task: suite.Task) -> dict[str, Any]:
    """Return the keywords of the task's environment without those of its sensors."""
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
    """Search the best actions (T, n, N) of the episodes; return the actions and their returns (n,).

    Args:
        trained: run folders of policies whose actions start the search too. steps: largest number of search steps.
        steadied: stabilize each arm by the best stabilizing policy of `trained` that observes the whole state; arms in
            space are always stabilized.
        kept: file of intermediate actions, from which an interrupted search continues.
        start: actions and their returns; the search starts from these actions alone.
        lifting: see `payoff.Fine`.
        stages: weights (T,) of the periods' rewards in preceding searches of `STAGE` steps each. The main search starts
            from the last actions of the preceding searches, even if these actions are worse (see `growing`).
        only: indices (n,) of the searched episodes. grid: actions are rounded to multiples of 1 / grid; 0: not rounded.
    Raises:
        ValueError: the task's environment has no derivatives, or gives other returns.
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
    """Increase the returns of n episodes by quasi-Newton steps from actions x (n, T N).

    Return x, the played actions (T, n, N) and the returns (n,) at the end.

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

    The first search counts the rewards of the first `2 GROWTH` periods; each later search counts `GROWTH` more periods.
    The last search counts all rewards; the last `end` periods, in which success is evaluated, have the weight
    `STRESS`. Later periods therefore cannot spoil an episode's beginning.
    """
    shares = [np.arange(periods) < count for count in range(2 * GROWTH, periods + GROWTH, GROWTH)]
    return [*(np.where(share, 1.0, 0.0) for share in shares), np.where(np.arange(periods) < periods - end, 1.0, STRESS)]


def beside(task: suite.Task, home: Path) -> list[Path]:
    """Return the run folders of the task's policies, and in space also of policies for tasks with other sensors."""
    tasks = [task.id, *(one.id for one in suite.tasks() if one.environment == task.environment == payoff.SPACE)]
    return [path.parent for name in dict.fromkeys(tasks) for path in sorted(home.glob(f"*/{name}/policy.npz"))]


def keep(path: Path, actions: Array, returns: Array) -> None:
    """Write actions (T, n, N) and their returns (n,) to a file."""
    write_npz(path, {"actions": actions.astype(np.float32), "returns": returns})


def read(path: Path) -> tuple[Array, Array]:
    """Read actions (T, n, N) and their returns (n,) from a file that `keep` wrote."""
    with np.load(path) as data:
        return data["actions"].astype(float), data["returns"].astype(float)


def _newton(slope: Array, moves: Sequence[tuple[Array, Array]]) -> Array:
    """Compute the quasi-Newton (L-BFGS) ascent direction (n, d).

    slope (n, d): gradient. moves: earlier steps (n, d), each with the decrease of the gradient in it, the oldest first.
    """
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
    """Return the folder with a task's optimized actions; search them first if the folder lacks them.

    The policies in the neighboring run folders also start the search.
    """
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
    """Return, for each episode, the actions with the largest return in the task, and these returns.

    ways: several sets of actions (T, n, N).
    """
    env = suite.make_vec(task.id, EPISODES)
    values = [played(env, Actions(way), task.price)[1] for way in ways]
    env.close()
    return best_of(ways, values)


def chosen(folder: Path) -> Chosen:
    """Return the optimized actions as a policy for the task's episodes.

    The policy's `make` raises ValueError if the environment has another number of episodes or joints.
    """
    path = folder / "actions.npz"
    record = read_json(folder / "run.json")
    actions, _ = read(path)

    def make(env: Any) -> Actions:
        if (int(env.num_envs), env.single_action_space.shape[0]) != actions.shape[1:]:
            raise ValueError(f"{path}: actions of {actions.shape[1]} episodes; all of them must be evaluated together")
        return Actions(actions)

    return Chosen("actions", folder.name, fingerprint(path.read_bytes()), make, 0, record)
