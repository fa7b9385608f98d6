"""Measure environment steps per second, single and vector, alternately with those of other packages, in one run."""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from threading import Thread
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.choose_default import WEAK
from benchmarks.cost_model import arithmetic_numbers, chain
from flexarm_env.envs.options import DEFAULT_FORMULATION, DEFAULT_OPTIONS, OF_MODES

IDS = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")

Made = tuple[Callable[[int], int], Callable[[], None]]


@dataclass
class Case:
    """A case whose rate of environment steps is measured.

    make: function that makes the environment and returns (advance, close). advance(k) runs k control periods in all its
    environments and returns the number of environment steps, without autoreset steps. rates: environment steps per
    second, one per round.
    """

    name: str
    make: Callable[[], Made]
    facts: dict[str, Any] = field(default_factory=dict)
    rates: list[float] = field(default_factory=list)
    first_seconds: float = 0.0

    def row(self) -> dict[str, Any]:
        """Return the results of the case: best and median rate over the rounds."""
        return {
            "case": self.name,
            **self.facts,
            "steps_per_second": max(self.rates),
            "steps_per_second_median": float(np.median(self.rates)),
            "rounds": len(self.rates),
            "first_seconds": self.first_seconds,
        }


def _facts(env_id: str, **more: Any) -> dict[str, Any]:
    return {"id": env_id, "n_envs": 1, "threads": 1, "api": "single", **more}


def _ready(env: Any, count: int, share: float = 1.0) -> list[Any]:
    """Reset an environment and return `count` random actions."""
    env.action_space.seed(0)
    env.reset(seed=0)
    return [np.float32(share) * env.action_space.sample() for _ in range(count)]


def single(name: str, env_id: str, **keywords: Any) -> Case:
    """Return the case of a single environment from `gymnasium.make`, wrappers included, under random actions."""

    def make() -> Made:
        env = gym.make(env_id, **keywords)
        actions = _ready(env, 256)

        def advance(count: int) -> int:
            step, reset = env.step, env.reset
            for k in range(count):
                _, _, terminated, truncated, _ = step(actions[k % 256])
                if terminated or truncated:
                    reset()
            return count

        return advance, env.close

    return Case(name, make, _facts(env_id, options=keywords))


def vector(name: str, env_id: str, n_envs: int, threads: int, share: float = 1.0, **keywords: Any) -> Case:
    """Return the case of a native vector environment with NEXT_STEP autoreset; autoreset steps are not counted.

    share: largest random action, as a share of the torque limits.
    """

    def make() -> Made:
        env = gym.make_vec(env_id, num_envs=n_envs, threads=threads, **keywords)
        actions, ended = _ready(env, 16, share), np.zeros(n_envs, np.bool_)

        def advance(count: int) -> int:
            nonlocal ended
            made = 0
            for k in range(count):
                _, _, terminated, truncated, _ = env.step(actions[k % 16])
                made += n_envs - int(np.count_nonzero(ended))
                ended = terminated | truncated
            return made

        return advance, env.close

    return Case(name, make, _facts(env_id, n_envs=n_envs, threads=threads, api="vector", options=keywords))


def envpool_reacher() -> Case | None:
    """Return the case of EnvPool's Reacher-v4, one environment stepped synchronously; None if EnvPool is not
    installed."""
    if not find_spec("envpool"):
        return None

    def make() -> Made:
        import envpool

        env = envpool.make_gymnasium("Reacher-v4", num_envs=1, num_threads=1)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (256, 1, 2))
        env.reset()

        def advance(count: int) -> int:
            for k in range(count):
                env.step(actions[k % 256])
            return count

        return advance, env.close

    return Case("EnvPool Reacher-v4", make, _facts("Reacher-v4"))


def exudyn_arm(elements: int = 5, n_steps: int = 4) -> Case | None:
    """Return the case of the strip in Exudyn: a control period of 20 ms has n_steps steps.

    None if Exudyn is not installed.
    """
    if not find_spec("exudyn"):
        return None

    def make() -> Made:
        from benchmarks.exudyn_peer import stepper

        return stepper(elements, n_steps), lambda: None

    return Case(f"Exudyn, {elements} elements, {n_steps} steps per period", make, _facts("Exudyn strip"))


def arithmetic(threads: int) -> Case:
    """Return a case of register arithmetic in eight lanes, which bounds the gain by several threads."""

    def make() -> Made:
        numbers = [arithmetic_numbers() for _ in range(threads)]

        def advance(count: int) -> int:
            def work(own: np.ndarray) -> None:
                for _ in range(count):
                    chain(own, 10_000)

            others = [Thread(target=work, args=(own,)) for own in numbers[1:]]
            for other in others:
                other.start()
            work(numbers[0])
            for other in others:
                other.join()
            return count * threads

        return advance, lambda: None

    return Case(f"arithmetic, {threads} thread(s)", make, {"threads": threads, "api": "registers"})


def own_cases(sizes: tuple[int, ...], threads: tuple[int, ...], formulations: tuple[str, ...]) -> list[Case]:
    """Return the cases of each environment and formulation with default settings, single and vector."""
    cases = []
    for env_id, formulation in itertools.product(IDS, formulations):
        options: dict[str, Any] = {} if formulation == DEFAULT_FORMULATION else {"formulation": formulation}
        own = [single(f"{env_id} {formulation}", env_id, **options)]
        for n, count in itertools.product(sizes, threads):
            if count == 1 or n >= 8 * count:
                own.append(vector(f"{env_id} {formulation} x {n}, {count} thread(s)", env_id, n, count, **options))
        for case in own:
            case.facts |= {"formulation": formulation, "settings": DEFAULT_OPTIONS[formulation]}
        cases += own
    return cases


def reduced_cases(modes: int, n_envs: int) -> list[Case]:
    """Return the cases of each environment with links reduced to `modes` modes, and torques within the modes'
    valid range."""
    cases = []
    for env_id, threads in itertools.product(IDS, (1, 2)):
        label = f"floating_frame, {modes} modes per link"
        name = f"{env_id} {label} x {n_envs}, {threads} thread(s)"
        case = vector(name, env_id, n_envs, threads, WEAK, formulation="floating_frame", modes=modes)
        case.facts |= {"formulation": label, "settings": {"modes": modes, **OF_MODES}}
        cases.append(case)
    return cases


def measure(cases: list[Case], rounds: int, seconds: float, tell: Callable[[str], None]) -> None:
    """Measure all cases in turn, `rounds` times, each time for about `seconds`."""
    for number in range(rounds):
        for case in cases:
            clock = time.perf_counter()
            advance, close = case.make()
            advance(1)
            if number == 0:
                case.first_seconds = time.perf_counter() - clock
            count, spent = 1, 0.0
            while spent < 0.02:  # how many periods fill the time
                count *= 4
                clock = time.perf_counter()
                advance(count)
                spent = time.perf_counter() - clock
            count = max(1, int(count * seconds / spent))
            clock = time.perf_counter()
            made = advance(count)
            case.rates.append(made / (time.perf_counter() - clock))
            close()
            tell(f"round {number + 1} of {rounds}: {case.name}: {case.rates[-1]:,.0f} steps/s")
