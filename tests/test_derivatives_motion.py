"""Derivatives of arms that follow prescribed motions, against differences of the environment itself."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from flexarm_env import time_functions
from flexarm_env.derivatives import Arms
from flexarm_env.validation import Array
from tests.differences import central
from tests.refusals import refuses

ONE, TWO = "FlexibleArm-v0", "TwoLinkFlexArm-v0"
FLOATING, EXACT = {"formulation": "floating_frame"}, {"formulation": "geometrically_exact"}
MODES, MULTIPLIERS = {"modes": 2, "segments": 1, **FLOATING}, {"multipliers": True, "segments": 1, **FLOATING}

SMOOTH = time_functions.from_array([[0.0, 0.1], [0.05, 0.12], [0.13, 0.2], [5.0, 0.6]])
BENT = time_functions.from_array([[0.0, 0.0, 0.0], [0.085, 0.03, 0.6], [0.15, 0.06, 0.2], [5.0, 0.6, 0.0]])
BROKEN = time_functions.from_array([[0.0, 0.0], [0.085, 0.05], [0.1 + 0.06, 0.02], [5.0, 0.6]], "linear")
SHORT = time_functions.cycloid(0.2, 0.15)
"""Without kinks; accelerations jump; rates jump, within a period and at the end of one; over before the run is."""
HUBS = [SMOOTH, BROKEN, SHORT]
JOINTS = [{"joint0": BROKEN}, {"joint1": SMOOTH}, {"joint0": BENT}]
"""Of three arms; of two links one joint each, the other being under torque."""


def case(name: str, env_id: str, tolerance: float = 1e-12, **keywords: Any) -> Any:
    return pytest.param(env_id, {"tolerance": tolerance, **keywords}, id=name)


CASES = [
    case("one link", ONE),
    case("two links", TWO),
    case("floating frame", ONE, **FLOATING),
    case("floating frame, two links", TWO, **FLOATING),
    case("modes, two links", TWO, **MODES),
    case("exact beam", ONE, 1e-15, **EXACT),
    case("exact beam, two links", TWO, 1e-15, **EXACT),
    case("multipliers, two links", TWO, elements=1, **MULTIPLIERS),
]


def made(env_id: str, **keywords: Any) -> Arms:
    """Three arms under their motions."""
    unbounded = {"joint_limits": None} if env_id == TWO else {}  # where episodes end, rewards pay for it
    arms = Arms(env_id, 3, **unbounded, **keywords)
    hinged = [JOINTS[0], JOINTS[2], JOINTS[0]] if "multipliers" in keywords else JOINTS
    arms.reset(seed=0, options={"motion": HUBS if env_id == ONE else hinged})
    return arms


def put(arms: Arms, state: Array) -> None:
    """The environment's arms where states say."""
    for i, guide in arms.environment.guides.items():
        for k, name in enumerate(arms.names[: arms.moving]):
            if name[1] == "[":
                getattr(guide.simulation.work, name[0])[int(name[2:-1])] = state[i, k]


def gone(arms: Arms, start: Any, state: Array, actions: Array) -> Array:
    """Coordinates and rates, what is to be seen and rewards (T, n, X + O + 1) of the environment's own periods (float64
    actions).

    start: its states, of which what moves is replaced by that of `state`.
    """
    env, names = arms.environment, arms.names[: arms.moving]
    env.set_state(start)
    put(arms, state)
    batch, out = env.batch, []
    batch.action = np.zeros((arms.n, arms.action_size))
    for action in actions:
        batch.action[:] = action
        rows = np.zeros((arms.n, arms.moving))
        for i, guide in env.guides.items():
            guide.step(batch, i)
            work = guide.simulation.work
            rows[i] = [getattr(work, x[0])[int(x[2:-1])] if x[:2] in ("q[", "v[") else 0.0 for x in names]
        seen = [batch._mine(batch.layout.seen, batch.layout.info, i) for i in range(arms.n)]
        out.append(np.hstack([rows, seen, batch.reward[:, None]]))
    return np.array(out)


def free(arms: Arms) -> NDArray[np.bool_]:
    """Coordinates and rates that no motion prescribes, and that are not multipliers (n, X)."""
    found = np.zeros((arms.n, arms.moving), np.bool_)
    for i, guide in arms.environment.guides.items():
        forces = guide.simulation.model.algebraic
        known = {*guide.simulation.drive.known.tolist(), *([] if forces is None else forces.tolist())}
        found[i] = [x[:2] in ("q[", "v[") and int(x[2:-1]) not in known for x in arms.names[: arms.moving]]
    return found


def way_in(arms: Arms, rng: np.random.Generator, state: Array, action: Array) -> Array:
    """A change of the state, of each number by as much as changes what comes of it by about 1."""
    found, change = arms.jacobians(state, action), np.zeros_like(state)
    out = np.concatenate([found.state[:, : arms.moving], found.observation, found.reward[:, None]], axis=1)
    size = (abs(found.moved[:, :, : arms.moving]) / np.maximum(1e-2, abs(out))[:, :, None]).max(axis=1)
    change[:, : arms.moving] = free(arms) * rng.standard_normal(size.shape) / np.maximum(1e-3, size)
    return change


def errors(arms: Arms, found: Array, wanted: Array) -> list[float]:
    """Each arm's error of what moves, is to be seen and is paid over its sensitivity, the largest; nothing may change
    where nothing should."""
    worst, ends = [], (arms.moving, arms.moving + arms.observation_size)
    for one, other in zip(*(np.split(part, ends, axis=2) for part in (found, wanted)), strict=True):
        error, size = (np.sqrt((part**2).sum((0, 2))) for part in (one - other, other))
        worst.append(float((error / np.where(size > 0.0, size, 1.0)).max()))
    return worst


def compared(arms: Arms, periods: int, e: float, counts: tuple[int, ...]) -> list[list[float]]:
    """Errors over so many periods, from the fourth on, by the state and by the actions, against sixth-order differences
    of steps e. What changed at the start has gone through three periods: what is left of it the steps resolve."""
    rng, before, env = np.random.default_rng(1), 3, arms.environment
    start, there = env.get_state(), arms.states()
    actions, way = rng.uniform(-0.4, 0.4, (2, before + periods, arms.n, arms.action_size))
    run, mask = arms.rollout(there, actions), free(arms)
    change = run.jvp(way_in(arms, rng, there, actions[0]), way).states[before]
    gone(arms, start, there, actions[:before])
    start, there, found = env.get_state(), run.states[before], []
    own = arms.rollout(there, actions[before:])
    same = gone(arms, start, there, actions[before:])
    assert np.array_equal(same[:, :, : arms.moving][:, mask], own.states[1:, :, : arms.moving][:, mask])
    assert np.array_equal(same[:, :, -1], own.rewards)
    looked = np.hstack([mask, np.ones((arms.n, arms.observation_size + 1))])
    for dx, du in ((change, 0.0 * way[before:]), (0.0 * change, way[before:])):
        out = own.jvp(dx, du)
        mine = np.dstack([out.states[1:, :, : arms.moving], out.observations, out.rewards]) * looked
        their = looked * central(
            lambda s, dx=dx, du=du: gone(arms, start, there + s * dx, actions[before:] + s * du), e
        )
        found += [errors(arms, mine[:count], their[:count]) for count in counts]
    rewards = rng.standard_normal(own.rewards.shape)
    back, out = own.vjp(rewards=rewards), own.jvp(change, way[before:])
    forth = float((rewards * out.rewards).sum())
    sums = [back.state * change, back.actions * way[before:]]
    assert abs(sum(float(x.sum()) for x in sums) - forth) <= 1e-10 * sum(float(abs(x).sum()) for x in sums)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_periods_under_a_motion(env_id: str, keywords: dict[str, Any]) -> None:
    """What the environment gives, bit for bit, and its derivative: to 1e-6 over one period and ten; by a hub that is
    driven, and of it, nothing. Without motions arms are again what they were.

    Where rates jump, those of an exact beam's stretch, which no step resolves, are found to 5e-6.
    """
    arms = made(env_id, **keywords)
    state, rng = arms.states(), np.random.default_rng(0)
    hub = [arms.names.index(f"{x}[0]") for x in "qvab"] if env_id == ONE and "formulation" not in keywords else []
    for _ in range(7):
        action = rng.uniform(-1.0, 1.0, (arms.n, arms.action_size)).astype(np.float32)
        found = arms.jacobians(state, action)
        assert not found.moved[:, hub].any() and not found.moved[:, :, hub].any() and (not hub or not found.B.any())
        state, seen, reward = arms.step(state, action)
        for one, other in zip(found[:3], (state, seen, reward), strict=True):
            assert np.array_equal(one, other)
        observation, paid, *_ = arms.environment.step(action)
        assert np.array_equal(state, arms.states()) and np.array_equal(reward, paid)
        assert np.array_equal(seen.astype(np.float32), observation)
    assert not arms.failed.any()
    arms = made(env_id, **keywords)
    for moved, seen, paid in compared(arms, 10, 1e-2, (1, 10)):
        assert max(seen, paid) < 1e-6
        assert moved < (5e-6 if keywords.get("formulation") == "geometrically_exact" else 1e-6)
    if hub:
        arms.reset(seed=0)
        assert "a[1]" not in arms.names
    arms.close()


@pytest.mark.slow
def test_the_default_tolerance_is_that_of_the_environment() -> None:
    """Newton's tolerance of an arm under motions differs from that of its batch, whose torques are larger."""
    arms = made(ONE, **FLOATING)
    state, rest = arms.states(), np.zeros((3, 1), np.float32)
    for _ in range(6):
        state = arms.step(state, rest)[0]
        arms.environment.step(rest)
        assert np.array_equal(state, arms.states())
    arms.close()


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_two_hundred_periods_under_a_motion(env_id: str, keywords: dict[str, Any]) -> None:
    """To 1e-4 of the sensitivity."""
    arms = made(env_id, **keywords)
    for found in compared(arms, 200, 1e-3, (200,)):
        assert max(found) < 1e-4
    arms.close()


@pytest.mark.slow
def test_motions_in_tensors() -> None:
    """A gradient through two periods is that of `vjp`."""
    torch = pytest.importorskip("torch")
    from flexarm_env.torch import DifferentiableArms

    same = DifferentiableArms(ONE, 3, tolerance=1e-12, task="replay", motion=BENT)
    start = same.reset(seed=0).requires_grad_()
    rest = torch.zeros((3, 1), dtype=torch.float64)
    state, seen, _ = same.step(start, rest)
    state, seen, _ = same.step(state, rest)
    seen.sum().backward()
    run = same.arms.rollout(start.detach().numpy(), np.zeros((2, 3, 1)))
    weights = np.stack([np.zeros_like(run.observations[0]), np.ones_like(run.observations[1])])
    assert np.array_equal(start.grad.numpy(), run.vjp(observations=weights).state)


@pytest.mark.slow
def test_torques_that_stay_as_they_are() -> None:
    """No start anew is made then; but by any other torque one would be, as differences find."""
    arms = made(TWO, tolerance=1e-12)
    start, state, still = arms.environment.get_state(), arms.states(), np.zeros((1, 3, 2))
    found, way = arms.jacobians(state, still[0]), np.ones((1, 3, 2))
    wanted = central(lambda s: gone(arms, start, state, s * way)[0], 1e-3, 2)
    mine = (found.moved[:, :, arms.moving :] @ way[0][:, :, None])[:, :, 0]
    for part in (wanted, mine):
        part[:, : arms.moving] *= free(arms)
    for rows in (slice(arms.moving), slice(arms.moving, -1)):
        assert np.linalg.norm((mine - wanted)[:, rows]) < 1e-6 * np.linalg.norm(wanted[:, rows])
    arms.close()


@pytest.mark.slow
def test_arms_with_and_without_motions_together() -> None:
    """An arm without one moves as in the batch, to the last bit, and has the derivative that it has there."""
    arms, plain = Arms(ONE, 3, tolerance=1e-12), Arms(ONE, 3, tolerance=1e-12)
    state = arms.reset(seed=0, options={"motion": [BENT, None, BROKEN]})
    other, rng = plain.reset(seed=0), np.random.default_rng(0)
    places = [arms.names.index(x) for x in plain.names[: plain.moving]]
    outputs = [*places, *range(arms.moving, arms.moving + arms.observation_size + 1)]
    for _ in range(6):
        action = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        found, wanted = arms.jacobians(state, action), plain.jacobians(other, action)
        columns = [*places, arms.moving]
        mine = found.moved[1][np.ix_(outputs, columns)]
        assert np.allclose(mine, wanted.moved[1], rtol=1e-9, atol=1e-9 * abs(wanted.moved[1]).max())
        state, other = arms.step(state, action)[0], plain.step(other, action)[0]
        arms.environment.step(action)
        assert np.array_equal(state, arms.states()) and np.array_equal(state[1, places], other[1, : plain.moving])
    assert arms.rollout(state, np.zeros((2, 3, 1))).vjp(rewards=np.ones((2, 3))).state.shape == state.shape
    arms.close()
    plain.close()


@pytest.mark.slow  # it makes, and compiles, another environment
def test_fitted_steps_are_refused_by_name() -> None:
    arms = Arms(ONE, 3, step_tolerance=1e-4)
    refuses("step_tolerance", lambda: arms.reset(options={"motion": BENT}))
    refuses("step_tolerance", lambda: Arms(ONE, 3, step_tolerance=1e-4, task="replay"))
    arms.close()
