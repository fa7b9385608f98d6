"""Derivatives through many control periods: against differences, tangent against adjoint, in NumPy and in PyTorch."""

import numpy as np
import pytest

from flexarm_env.derivatives import Arms, Jacobians, Outcome, Rollout, rollout
from flexarm_env.validation import Array
from tests.differences import central
from tests.refusals import refuses


@pytest.fixture(scope="module")
def arms() -> Arms:
    return Arms("FlexibleArm-v0", 9, tolerance=1e-12)


def gone(arms: Arms, periods: int, seed: int = 0) -> Rollout:
    """Under torques that wander, within the limits."""
    rng = np.random.default_rng(seed)
    pushes = rng.uniform(-0.4, 0.4, (periods, arms.n, arms.action_size))
    return arms.rollout(arms.reset(seed=seed), 0.6 * np.sin(0.2 * np.arange(periods))[:, None, None] + pushes)


def ways(run: Rollout, seed: int = 1) -> tuple[Array, Array]:
    """Changes of the start (of what moves) and of the actions."""
    rng, moving = np.random.default_rng(seed), run.arms.moving
    state = np.zeros_like(run.states[0])
    state[:, :moving] = 0.1 * rng.standard_normal((run.arms.n, moving))
    return state, 0.1 * rng.standard_normal(run.actions.shape)


def outcome(run: Rollout | Outcome) -> Array:
    """States after the periods, observations and rewards (T, n, S + O + 1)."""
    return np.concatenate([run.states[1:], run.observations, run.rewards[:, :, None]], axis=2)


def differences(run: Rollout, state: Array, actions: Array, e: float) -> Array:
    """The outcome's change along the ways, by steps e."""
    return central(lambda s: outcome(run.arms.rollout(run.states[0] + s * state, run.actions + s * actions)), e)


@pytest.mark.parametrize(("periods", "most", "e"), [(10, 1e-6, 2e-4), (200, 1e-4, 5e-6)])
def test_a_rollout_against_differences(arms: Arms, periods: int, most: float, e: float) -> None:
    """Found: 7e-10 over 10 periods, 2e-7 over 200; each arm's error over the size of its own sensitivity. Over many
    periods larger steps come upon the reward's kinks."""
    run = gone(arms, periods)
    found, wanted = outcome(run.jvp(*ways(run))), differences(run, *ways(run), e)
    ends = run.arms.state_size, run.arms.state_size + run.arms.observation_size
    for one, other in zip(*(np.split(part, ends, axis=2) for part in (found, wanted)), strict=True):
        error = np.sqrt(((one - other) ** 2).sum((0, 2)) / (other**2).sum((0, 2)))
        assert error.max() < most


def test_a_rollout_is_its_periods(arms: Arms) -> None:
    run = gone(arms, 5)
    state = run.states[0]
    for k in range(5):
        state, observation, reward = arms.step(state, run.actions[k])
        for one, other in ((state, run.states[k + 1]), (observation, run.observations[k]), (reward, run.rewards[k])):
            assert np.array_equal(one, other)
    assert not run.failed.any() and not run.past.any()


def test_tangent_and_adjoint_agree(arms: Arms) -> None:
    """<w, J v> = <J^T w, v>, to round-off."""
    run, rng = gone(arms, 50), np.random.default_rng(2)
    state, actions = ways(run)
    out = run.jvp(state, actions)
    weights = [rng.standard_normal(part.shape) for part in out]
    back = run.vjp(*weights)
    one = sum(float((w * part).sum()) for w, part in zip(weights, out, strict=True))
    other = float((back.state * state).sum() + (back.actions * actions).sum())
    size = sum(np.linalg.norm(w) * np.linalg.norm(part) for w, part in zip(weights, out, strict=True))
    assert abs(one - other) <= 1e-12 * size


def test_what_an_arm_s_solver_left_is_asked_of_nobody_else(arms: Arms) -> None:
    """An arm without a state fails; its rows are NaN, the others' gradients those that they were; asked of nothing, it
    gives zeros."""
    run = gone(arms, 3)
    start = run.states[0].copy()
    start[4, 0] = np.nan
    other = arms.rollout(start, run.actions)
    assert other.failed[:, 4].all() and np.isnan(other.rewards[:, 4]).all()
    weights = np.ones_like(run.rewards)
    weights[:, 4] = 0.0
    one, two = run.vjp(rewards=weights), other.vjp(rewards=weights)
    assert np.array_equal(one.actions, two.actions) and np.array_equal(one.state, two.state)
    assert not two.actions[:, 4].any()


def test_wrong_shapes_are_told(arms: Arms) -> None:
    run = gone(arms, 3)
    refuses("actions = .*: must be numbers", lambda: arms.rollout(run.states[0], 1j * run.actions))
    refuses(r"actions.shape = \(9, 1\): must be \(T, 9, 1\)", lambda: arms.rollout(run.states[0], run.actions[0]))
    for value in (np.nan, np.inf):
        actions = run.actions.copy()
        actions[2, 1, 0] = value
        with pytest.raises(ValueError, match=rf"actions\[2, 1, 0\] = {value}: must be finite"):
            arms.rollout(run.states[0], actions)
        arms.step(run.states[2], actions[2])
        assert arms.failed.tolist() == [k == 1 for k in range(arms.n)]  # as in the environment
    refuses(r"rewards.shape = \(3, 1\): must be \(3, 9\)", lambda: run.vjp(rewards=np.zeros((3, 1))))


@pytest.mark.slow
def test_parameters_over_a_rollout() -> None:
    """Payload, EI factor, damping and torque constant of each arm against differences. Found: 3e-10."""
    many = Arms(
        "FlexibleArm-v0", 9, tolerance=1e-12, parameters=True, randomization={"payload": (0.5, 2.0), "EI": (0.7, 1.3)}
    )
    run, rng = gone(many, 30), np.random.default_rng(3)
    weights, first = rng.standard_normal(run.rewards.shape), many.names.index("payload_mass")
    way = np.zeros_like(run.states[0])
    way[:, first : many.moving] = run.states[0][:, first : many.moving] * rng.standard_normal((9, many.moving - first))
    found = (run.vjp(rewards=weights).state * way).sum(axis=1)
    wanted = (weights * differences(run, way, np.zeros_like(run.actions), 1e-4)[:, :, -1]).sum(axis=0)
    assert abs(found - wanted).max() < 1e-7 * np.linalg.norm(wanted)


# ------------------------------------------------------------------ PyTorch
@pytest.mark.slow
def test_gradcheck(arms: Arms) -> None:
    torch = pytest.importorskip("torch")
    from flexarm_env.torch import DifferentiableArms

    two = DifferentiableArms("FlexibleArm-v0", 2, tolerance=1e-12)
    state = two.reset(seed=3)
    for _ in range(3):
        state, _, _ = two.step(state, torch.full((2, 1), 0.5))
    moving = state[:, : two.arms.moving].clone().requires_grad_()
    given = state[:, two.arms.moving :].clone()
    action = torch.tensor([[0.3], [-0.6]], dtype=torch.float64, requires_grad=True)

    def through(moving, action):
        after, seen, reward = two.step(torch.cat([moving, given], dim=1), action)
        after, _, _ = two.step(after, -0.5 * action)
        return after[:, : two.arms.moving], seen, reward, two.observe(after)

    assert torch.autograd.gradcheck(through, (moving, action), eps=1e-5, atol=1e-6, rtol=1e-5)


def test_tensors_give_what_arrays_give(arms: Arms) -> None:
    """A policy's gradient is that of `vjp`; float32 actions have float32 gradients."""
    torch = pytest.importorskip("torch")
    from flexarm_env.torch import DifferentiableArms

    same = DifferentiableArms("FlexibleArm-v0", 9, tolerance=1e-12)
    assert same.action_space.shape == (1,) and same.observation_space.shape == (6,)
    start = same.reset(seed=5)
    assert start.dtype == torch.float64 and start.shape == (9, same.arms.state_size)
    actions = torch.linspace(-0.9, 0.9, 4 * 9).reshape(4, 9, 1).requires_grad_()
    assert actions.dtype == torch.float32
    state, total = start, torch.zeros(())
    for action in actions:
        state, _, reward = same.step(state, action)
        total = total + reward.sum()
    total.backward()
    run = arms.rollout(start.numpy(), actions.detach().numpy())
    assert actions.grad.dtype == torch.float32
    assert abs(actions.grad.numpy() - run.vjp(rewards=np.ones((4, 9))).actions).max() < 1e-6
    assert total.item() == pytest.approx(run.rewards.sum(), abs=1e-12)
    hurt = torch.zeros(9, 1, dtype=torch.float64)
    hurt[4] = torch.nan
    _, _, reward = same.step(state.detach(), hurt.requires_grad_())
    torch.where(same.failed, torch.zeros(9, dtype=torch.float64), reward).sum().backward()
    assert same.failed.tolist() == [k == 4 for k in range(9)]  # going back must not forget it


def test_tensors_and_arrays_share_memory(arms: Arms, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is given in float64 goes in, and what comes out comes back, without a copy."""
    torch = pytest.importorskip("torch")
    from flexarm_env.torch import DifferentiableArms

    same, calls = DifferentiableArms("FlexibleArm-v0", 9, tolerance=1e-12), []

    def noted(function):
        def call(*arguments):
            calls.append((arguments, function(*arguments)))
            return calls[-1][1]

        return call

    for name in ("reset", "observe", "step"):
        monkeypatch.setattr(same.arms, name, noted(getattr(same.arms, name)))
    state, action = same.reset(5), torch.zeros((9, 1), dtype=torch.float64)
    told = [state], [same.observe(state)], same.step(state, action)
    given = [], [state], [state, action]
    for (arguments, results), tensors, own in zip(calls, told, given, strict=True):
        for array, tensor in zip(results if isinstance(results, tuple) else [results], tensors, strict=True):
            assert np.shares_memory(array, tensor.numpy())
        for array, tensor in zip(arguments, own, strict=False):
            assert np.shares_memory(array, tensor.numpy())


def test_other_devices_are_told(arms: Arms) -> None:
    torch = pytest.importorskip("torch")
    from flexarm_env.torch import DifferentiableArms

    one = DifferentiableArms("FlexibleArm-v0", 9, tolerance=1e-12)
    with pytest.raises(ValueError, match=r"state.device = 'meta': must be cpu"):
        one.step(torch.zeros((9, one.arms.state_size), device="meta"), torch.zeros(9, 1))
    for wrong in (one.reset().numpy(), [0.0], torch.zeros((9, one.arms.state_size), dtype=torch.complex128)):
        with pytest.raises(ValueError, match="must be a tensor of real numbers"):
            one.observe(wrong)


def test_other_packages_are_told() -> None:
    for id in ("CartPole-v1", "Pendulum-v1"):
        with pytest.raises(ValueError, match=f"id = '{id}': must be of an environment of this package"):
            Arms(id, 2)
    refuses("id = None: must be a text", lambda: Arms(None, 2))  # type: ignore[arg-type]


class Linear:
    """n copies of x+ = A x + B u, which observe x+ and are paid -x+ x+ / 2: `derivatives.Differentiable`."""

    def __init__(self, A: Array, B: Array, n: int) -> None:
        self.A, self.B, self.n = A, B, n
        self.state_size = self.observation_size = self.moving = len(A)
        self.action_size = B.shape[1]
        self.failed, self.past = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        after = state @ self.A.T + action @ self.B.T
        return after, after, -0.5 * (after**2).sum(1)

    def jacobians(self, state: Array, action: Array) -> Jacobians:
        after = self.step(state, action)[0]
        both = np.repeat(np.hstack([self.A, self.B])[None], self.n, 0)
        return Jacobians(*self.step(state, action), np.concatenate([both, both, -after[:, None] @ both], axis=1))

    def vjp(self, state: Array, action: Array, *bars: Array) -> tuple[Array, Array]:
        return self.jacobians(state, action).vjp(*bars)

    def observe(self, state: Array) -> Array:
        return state

    def observe_jacobian(self, state: Array) -> tuple[Array, Array]:
        return state, np.repeat(np.eye(self.state_size)[None], self.n, 0)


def test_a_rollout_takes_any_object_with_the_methods() -> None:
    """Of a linear system: powers of A in both directions, in closed form."""
    rng, n, periods = np.random.default_rng(3), 4, 6
    A, B = rng.normal(size=(3, 3)) / 3.0, rng.normal(size=(3, 2))
    run = rollout(Linear(A, B, n), rng.normal(size=(n, 3)), rng.normal(size=(periods, n, 2)))
    way = rng.normal(size=(periods, n, 2))
    last = sum(way[k] @ B.T @ np.linalg.matrix_power(A, periods - 1 - k).T for k in range(periods))
    assert abs(run.jvp(actions=way).states[-1] - last).max() < 1e-13
    weight = np.zeros((periods + 1, n, 3))
    weight[-1] = rng.normal(size=(n, 3))
    back = run.vjp(states=weight)
    assert abs(back.state - weight[-1] @ np.linalg.matrix_power(A, periods)).max() < 1e-13
    assert abs(back.actions[0] - weight[-1] @ np.linalg.matrix_power(A, periods - 1) @ B).max() < 1e-13
    # the reward of period 1 alone: -x_1 (A dx_0)
    paid = np.zeros((periods, n))
    paid[0] = 1.0
    assert abs(run.vjp(rewards=paid).state + run.states[1] @ A).max() < 1e-13
