"""What the tests of the environments share: the ids, exact comparison, an episode."""

import math
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np

import flexarm_env  # noqa: F401  (registers the ids)

MULTI = "MultiLinkFlexArm-v0"
IDS = ONE, TWO = ("FlexibleArm-v0", "TwoLinkFlexArm-v0")

RANDOM = {"payload": (0.5, 2.0), "EI": (0.7, 1.3), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1)}

RICH: dict[str, dict[str, Any]] = {
    "FlexibleArm-v0": {
        "gravity": (0.0, 0.0), "actuator": {"lag": 1e-300}, "sensors": {"strain_gauges": [0.0, 0.5]},
        "task": "track", "info_level": "full",
    },
    "TwoLinkFlexArm-v0": {
        "gravity": (0.0, 0.0), "actuator": {"lag": 1e-300}, "sensors": {"strain_gauges": [(0, 0.0), (1, 0.5)]},
        "task": "track", "info_level": "full", "action_mode": "residual_pd",
    },
    MULTI: {
        "gravity": (0.0, 0.0), "actuator": {"lag": 1e-300}, "sensors": {"strain_gauges": [(0, 0.0), (2, 0.5)]},
        "task": "track", "info_level": "full", "action_mode": "residual_pd",
    },
}  # fmt: skip
"""Everything that is compiled out where it is absent, next to ideal: one compiled form for many tests."""


LIVELY: dict[str, Any] = {
    "randomization": RANDOM, "sensors": {"noise": 0.01, "delay": 0.04}, "initial_vibration": 0.02,
    "actuator": {"lag": 0.01, "delay": 0.08 / 3},
}  # fmt: skip
"""For `rich`: none of it ideal. Friction has kernels of its own."""


def rich(env_id: str, **changes: Any) -> dict[str, Any]:
    """Keywords of an environment with everything; a mapping in `changes` is merged into that of RICH."""
    keywords = dict(RICH[env_id])
    for name, value in changes.items():
        merge = isinstance(value, dict) and isinstance(keywords.get(name), dict)
        keywords[name] = keywords[name] | value if merge else value
    return keywords


STANDARD = {
    "is_success", "tip_position", "tip_deflection", "target", "hub_torque", "joint_torque", "in_range",
    "deflection_bound", "error_estimate", "solver_status", "termination_reason",
}  # fmt: skip
ENERGIES = {"energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated", "work"}


def assert_same(a: Any, b: Any, path: str = "") -> None:
    """Equal to the last bit, with equal types; inside dicts, tuples and arrays of objects too."""
    assert type(a) is type(b), f"{path}: {type(a)} and {type(b)}"
    if isinstance(a, dict):
        assert set(a) == set(b), f"{path}: {set(a) ^ set(b)}"
        for key in a:
            assert_same(a[key], b[key], f"{path}.{key}")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), path
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{path}[{k}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape, f"{path}: {a.dtype}{a.shape} and {b.dtype}{b.shape}"
        if a.dtype == object:
            assert_same(list(a), list(b), path)
        else:
            assert np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes(), f"{path}: {a} and {b}"
    else:
        assert a == b, f"{path}: {a} and {b}"


def turned(angle: float, vector: Any) -> np.ndarray:
    """Components of a vector (2,) in the frame at an angle."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]])


def episode(env: gym.Env[Any, Any], seed: int, steps: int, **options: Any) -> list[Any]:
    """Everything that reset and `steps` steps under random actions return."""
    rng = np.random.default_rng(seed)
    outcomes: list[Any] = [env.reset(seed=seed, options=options or None)]
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        outcomes.append(env.step(action))
        if outcomes[-1][2] or outcomes[-1][3]:
            break
    return outcomes


def steered(env: Any, controller: Any, **reset: Any) -> Iterator[Any]:
    """What each step of an episode under a controller or a policy returns."""
    observation, _ = env.reset(**reset)
    controller.reset(observation)
    for _ in range(env.unwrapped.plan.limit):
        action = controller.act(observation)
        assert action.dtype == np.float32
        assert np.abs(action).max() <= 1.0
        outcome = env.step(action)
        observation = outcome[0]
        yield outcome


def successes(env: Any, controller: Any, seed: int) -> float:
    """Share of a vector's arms that a controller has where they belong at the end of an episode."""
    *_, (*_, info) = steered(env, controller, seed=seed)
    return float(info["is_success"].mean())


def pair(env_id: str, n: int, mode: str = "NextStep", threads: int = 1, **kwargs: Any) -> tuple[Any, Any]:
    """The environment as n single ones in a SyncVectorEnv, and as a native vector."""
    sync = gym.make_vec(env_id, num_envs=n, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **kwargs)
    native = gym.make_vec(env_id, num_envs=n, autoreset_mode=mode, threads=threads, **kwargs)
    return sync, native


def assert_pair_same(
    pair_: tuple[Any, Any], steps: int, seed: int = 3, scale: float = 1.3, passed: int | None = None
) -> int:
    """Both give the same bits over resets and steps; returns how many episodes ended.

    passed: an arm whose state the single environment passes to the vector half way.
    """
    sync, native = pair_
    assert_same(sync.reset(seed=seed), native.reset(seed=seed), "reset")
    rng, ended = np.random.default_rng(seed), 0
    disabled = native.metadata["autoreset_mode"] is gym.vector.AutoresetMode.DISABLED
    for k in range(steps):
        actions = rng.uniform(-scale, scale, native.action_space.shape).astype(np.float32)
        if passed is not None and k == steps // 2:
            native.unwrapped.set_state([sync.envs[passed].unwrapped.get_state()], [passed])
        one, other = sync.step(actions), native.step(actions)
        assert_same(one, other, f"step {k}")
        over = one[2] | one[3]
        ended += int(over.sum())
        if disabled and over.any():
            assert_same(
                sync.reset(options={"reset_mask": over}), native.reset(options={"reset_mask": over}), f"reset {k}"
            )
    return ended


def assert_goes_back(env: Any, *, scale: float = 1.0, copied: Any = None, other: Any = None) -> None:
    """From a state that is set again an environment goes on as it did, and so do a copy of it and another one."""
    state, rng = env.unwrapped.get_state(), np.random.default_rng(1)
    actions = [rng.uniform(-scale, scale, env.action_space.shape).astype(np.float32) for _ in range(8)]
    first = [env.step(action) for action in actions]
    env.unwrapped.set_state(state)
    if other is not None:
        other.reset(seed=2)
        other.unwrapped.set_state(state)
    for one in (one for one in (env, copied, other) if one is not None):
        assert_same(first, [one.step(action) for action in actions])
