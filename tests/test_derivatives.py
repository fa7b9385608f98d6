"""Jacobians and cotangents of a control period: against differences of the period itself, and against one another."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from flexarm_env import arms as arms_by_name
from flexarm_env.derivatives import Arms

Array = NDArray[np.float64]


def case(name: str, env_id: str, tolerance: float = 1e-12, slow: bool = True, **keywords: Any) -> Any:
    marks = [pytest.mark.slow] if slow else []
    return pytest.param(env_id, {"tolerance": tolerance, **keywords}, id=name, marks=marks)


def geared() -> Any:
    """An arm behind a gear without Coulomb friction, whose kinks differences would step over."""
    arm = arms_by_name.named("strip_geared")
    return dataclasses.replace(arm, joints=(dataclasses.replace(arm.joints[0], friction_coulomb=0.0),))


ONE, TWO = "FlexibleArm-v0", "TwoLinkFlexArm-v0"
CASES = [
    case("one link", ONE, slow=False),
    case("two links", TWO),
    case("three links", "MultiLinkFlexArm-v0"),
    case("controllers", TWO, action_mode="residual_pd", residual_share=0.3),
    case("motors", TWO, actuator={"lag": 0.01, "delay": 0.02}),
    case("parameters", ONE, parameters=True, gravity=(0.0, -9.81), randomization={"payload": (0.5, 1.5)}),
    case("floating frame", ONE, formulation="floating_frame"),
    case("floating frame, modes", ONE, formulation="floating_frame", modes=2, segments=1),
    case("exact beam", ONE, 1e-14, formulation="geometrically_exact"),
    case("exact beam, period corrected", ONE, 1e-14, formulation="geometrically_exact", period_correction=True),
    case("gears", ONE, arm=geared()),
]


def moving(arms: Arms, seed: int = 0, periods: int = 3) -> tuple[Array, Array]:
    """A state on the way, and an action."""
    rng, shape = np.random.default_rng(seed), (arms.n, arms.action_size)
    state = arms.reset(seed=seed)
    for _ in range(periods):
        state = arms.step(state, rng.uniform(-0.7, 0.7, shape))[0]
    return state, rng.uniform(-0.7, 0.7, shape)


def after(arms: Arms, state: Array, action: Array) -> Array:
    """What moves a period later, the observation and the reward."""
    out = arms.step(state, action)
    return np.concatenate([out[0][:, : arms.moving], out[1], out[2][:, None]], axis=1)


def differences(arms: Arms, state: Array, action: Array, found: Array) -> Array:
    """(n, X + O + 1, X + A) by sixth-order differences; `found` says how far each number may be moved."""
    there, columns = np.maximum(1e-2, np.abs(after(arms, state, action)).max(axis=0)), []
    both = np.concatenate([state, action], axis=1)
    for j, k in enumerate([*range(arms.moving), *range(arms.state_size, both.shape[1])]):
        e = 1e-3 / max(1e-3, (np.abs(found[:, :, j]).max(axis=0) / there).max())
        if arms.environment.plan.settings.formulation == "geometrically_exact":
            e = min(300.0 * e, 1e-3)  # accelerations are as fine as the solver's tolerance makes them

        def moved(way: float, k: int = k) -> Array:
            x = both.copy()
            x[:, k] += way
            return after(arms, x[:, : arms.state_size], x[:, arms.state_size :])

        pairs = [moved(m * e) - moved(-m * e) for m in (1, 2, 3)]
        columns.append((45.0 * pairs[0] - 9.0 * pairs[1] + pairs[2]) / (60.0 * e))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_a_period_against_differences_and_backwards(env_id: str, keywords: dict[str, Any]) -> None:
    """Relative error below 1e-6 for each arm; the values are those of a step, bit for bit; cotangents are pulled back
    to what the Jacobians give."""
    arms = Arms(env_id, 9, **keywords)
    state, action = moving(arms)
    found = arms.jacobians(state, action)
    for one, other in zip(found[:3], arms.step(state, action), strict=True):
        assert np.array_equal(one, other)
    wanted = differences(arms, state, action, found.moved)
    error = np.linalg.norm(found.moved - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert error.max() < 1e-6

    rng = np.random.default_rng(1)
    bars = [rng.normal(size=values.shape) for values in found[:3]]
    wanted_bars = found.pull(*bars)
    for one, other in zip(arms.pull(state, action, *bars), wanted_bars, strict=True):
        assert abs(one - other).max() < 1e-10 * abs(other).max()
    arms.close()


def test_states_are_those_of_the_environment() -> None:
    """Rows of the vector environment, through its own steps (actions float32): the same numbers."""
    arms = Arms(ONE, 5)
    state = arms.reset(seed=3)
    rng = np.random.default_rng(0)
    seen = arms.observe(state)
    assert np.array_equal(seen.astype(np.float32), arms.environment.batch.observation)
    for _ in range(3):
        action = rng.uniform(-1.0, 1.0, (5, 1)).astype(np.float32)
        state, seen, reward = arms.step(state, action)
        told = arms.environment.step(action)
        assert np.array_equal(seen.astype(np.float32), told[0])
        assert np.array_equal(reward, told[1])
        assert np.array_equal(state[:, : arms.moving], arms.states()[:, : arms.moving])
    arms.close()


@pytest.mark.slow
def test_whole_matrices_say_what_push_and_pull_do() -> None:
    """A, B, C, D, r_x and r_u of whole states; what does not move passes through; by the action beyond +-1 zeros."""
    arms = Arms(TWO, 3)
    state, action = moving(arms)
    action[0] = 1.5
    found = arms.jacobians(state, action)
    rng = np.random.default_rng(2)
    dx, du = rng.normal(size=state.shape), rng.normal(size=action.shape)
    dx[:, arms.moving :] = 0.0
    pushed = found.push(dx, du)
    assert np.allclose(pushed[0], np.einsum("nij,nj->ni", found.A, dx) + np.einsum("nij,nj->ni", found.B, du))
    assert np.allclose(pushed[1], np.einsum("nij,nj->ni", found.C, dx) + np.einsum("nij,nj->ni", found.D, du))
    assert np.allclose(pushed[2], (found.r_x * dx).sum(1) + (found.r_u * du).sum(1))
    assert not found.B[0].any() and found.B[1].any()
    seen, slopes = arms.sights(state)
    assert np.array_equal(seen, arms.observe(state)) and slopes[:, :, : arms.moving].any()
    arms.close()


@pytest.mark.slow  # each makes, and compiles, another environment
@pytest.mark.parametrize(
    ("name", "keywords"),
    [
        ("sensors", {"sensors": {"noise": 0.01}}),
        ("history", {"history": 2}),
        ("task", {"task": "track"}),
        ("multipliers", {"formulation": "floating_frame", "multipliers": True}),
        ("step_tolerance", {"step_tolerance": 1e-4}),
    ],
)
def test_what_has_no_derivatives_is_refused(name: str, keywords: dict[str, Any]) -> None:
    """By name."""
    with pytest.raises(ValueError, match=name):
        Arms(ONE, 2, **keywords)


@pytest.mark.slow
def test_friction_over_periods() -> None:
    """A sliding joint's friction, noted where torques jump, is at its bound: a kink for states that the motion does not
    come to. Along a motion, by an action three periods before, there is none."""
    arms = Arms(ONE, 9, tolerance=1e-12, arm="strip_geared")
    state, action = moving(arms)

    def run(first: Array) -> tuple[Array, list[Array]]:
        states = [state]
        for u in (first, action, action):
            states.append(arms.step(states[-1], u)[0])
        return states[-1], states

    _, states = run(action)
    tangent = np.zeros_like(state)
    for k in range(3):
        du = np.ones_like(action) if k == 0 else np.zeros_like(action)
        tangent = arms.jacobians(states[k], action).push(tangent, du)[0]
    e = 1e-5
    pairs = [run(action + m * e)[0] - run(action - m * e)[0] for m in (1, 2, 3)]
    wanted = (45.0 * pairs[0] - 9.0 * pairs[1] + pairs[2]) / (60.0 * e)
    error = np.linalg.norm(tangent - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    assert error.max() < 1e-6
    arms.close()
