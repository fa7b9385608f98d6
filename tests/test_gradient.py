"""Learning by gradients: the gradient itself, a run like any other, resumed bit for bit."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from flexarm_env.control.around import Inside
from flexarm_env.sb3 import make_sb3_vec
from flexarm_env.training import config, policies
from flexarm_env.training import train as train_ppo
from flexarm_env.training.gradient import Gradient
from flexarm_env.training.runs import read_run
from tests.agents_tools import ENV, RUN_FILES, file_of
from tests.test_agents import arguments, curve, interrupted

SHORT = {
    "n_envs": 8, "n_timesteps": 2048, "policy": "MlpPolicy", "n_steps": 16, "batch_size": 64, "n_epochs": 1,
    "gamma": 0.98, "learning_rate": "lin_4e-3", "policy_kwargs": "dict(net_arch=[16, 16], log_std_init=-1.5)",
}  # fmt: skip


def given(folder: Path, **changes) -> train_ppo.Arguments:
    changes.setdefault("config", file_of(folder, SHORT))
    return arguments(folder, algo="gradient", **changes)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("gradient")
    train_ppo.train(given(folder))
    return folder / "run"


def test_a_run_folder_is_that_of_the_others(run: Path):
    assert {p.name for p in run.iterdir()} == RUN_FILES
    assert read_run(run)["algorithm"] == "gradient" and read_run(run)["finished"]
    assert config.load(run / "config.yml", "gradient", ENV).text == SHORT
    assert policies.choose(str(run), ENV).name == "run"


def test_a_resumed_run_ends_as_one_that_was_never_stopped(tmp_path: Path, run: Path):
    interrupted(given(tmp_path), 1024)
    train_ppo.train(train_ppo.Arguments(algo="gradient", out=tmp_path / "run", resume=True, progress=False))
    assert curve(tmp_path / "run") == curve(run)
    with np.load(tmp_path / "run" / "policy.npz") as one, np.load(run / "policy.npz") as other:
        assert all(np.array_equal(one[name], other[name]) for name in one.files if name != "meta")


def test_what_it_cannot_do_is_told(tmp_path: Path):
    (tmp_path / "other").mkdir()
    path = file_of(tmp_path / "other", SHORT | {"normalize": True})
    with pytest.raises(ValueError, match="normalize: unknown key of gradient; allowed: "):
        train_ppo.train(given(tmp_path, config=path))


PD = Inside("pd", 0.6, {"bandwidth": [0.03], "ratio": [0.84]})
"""Weak enough not to saturate, where the method's derivative differs from the true one on purpose."""


def model(around: Inside | None = None, **changes) -> Gradient:
    measured = {} if around is None else {"observation": "measured"}
    env = make_sb3_vec(ENV, 8, seed=0, duration=1.5, around=around, **measured)
    more = {"n_steps": 12, "batch_size": 32, "seed": 3, "policy_kwargs": {"net_arch": [8, 8], "log_std_init": -1.5}}
    return Gradient("MlpPolicy", env, **more | changes)


@pytest.mark.parametrize("around", [None, PD], ids=["alone", "around-pd"])
def test_the_actor_s_gradient_is_that_of_what_the_window_is_worth(around: Inside | None):
    """Against central differences of the window's discounted rewards and the critic's word at its end, with the same
    noise. Found: 2e-4, which is float32's."""
    one = model(around)
    began, network = (one.state.copy(), one.ages.copy()), one.actor.parameters
    wide = np.float64

    def worth() -> float:
        one.state, one.ages, one.rng = began[0].copy(), began[1].copy(), np.random.default_rng(7)
        window = one._act()
        paid = (window.rewards * one.gamma ** np.arange(one.n_steps)[:, None]).sum()
        beyond = one.critic.forward(window.after[-1])[0].sum(dtype=wide)
        return float(paid + one.gamma**one.n_steps * beyond) / one.n_envs

    values = network.values.copy()
    one.ep_info_buffer = []
    worth()
    one.state, one.ages, one.rng = began[0].copy(), began[1].copy(), np.random.default_rng(7)
    window = one._act()
    one._improve(window, 0.0)
    assert max(np.abs(total).max() for total in window.total) < 1.0
    assert np.array_equal(network.values, values)
    found = -network.gradient.astype(wide)
    for seed in range(3):
        way = np.random.default_rng(seed).standard_normal(len(values)).astype(np.float32)
        e = np.float32(1e-3)
        out = []
        for side in (1.0, -1.0):
            network.values[:] = values + side * e * way
            out.append(worth())
        network.values[:] = values
        wanted = (out[0] - out[1]) / (2.0 * float(e))
        assert abs(wanted - found @ way) < 2e-3 * np.linalg.norm(found) * np.linalg.norm(way) / np.sqrt(len(way)) * 3.0


def test_networks_stand_in_the_policy_s_own_memory():
    import torch

    one = model()
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6)).astype(np.float32)
    before = one.policy.predict(seen, deterministic=True)[0]
    assert np.allclose(before, np.clip(one.actor.forward(seen)[0], -1.0, 1.0), atol=1e-6)
    one.actor.parameters.values += np.float32(0.1)
    after = one.policy.predict(seen, deterministic=True)[0]
    assert np.allclose(after, np.clip(one.actor.forward(seen)[0], -1.0, 1.0), atol=1e-6)
    assert not np.allclose(before, after)
    with torch.no_grad():
        value = one.policy.predict_values(torch.from_numpy(seen)).numpy()
    assert np.allclose(value, one.critic.forward(seen)[0], atol=1e-5)


def test_joints_near_their_limits_cost():
    """Up to limit_cost at the limit, and on; slopes against differences."""
    one = Gradient.__new__(Gradient)  # without arms, which would be compiled
    one.n_envs, one.limit_margin, one.limit_cost, one.margins = 8, 0.5, 2.0, [(0, 1, -2.8, 2.8)]
    angles = np.array([0.0, 2.2, 2.4, 2.8, 3.0, -2.4, -2.8, 1.0])

    def cost(angles):
        return one._near_limits(np.stack([np.sin(angles), np.cos(angles)], axis=1))

    found, slopes = cost(angles)
    assert np.allclose(found, 2.0 * np.array([0.0, 0.0, 0.04, 1.0, 1.96, 0.04, 1.0, 0.0]))
    wanted = (cost(angles + 1e-6)[0] - cost(angles - 1e-6)[0]) / 2e-6
    along = slopes[:, 0] * np.cos(angles) - slopes[:, 1] * np.sin(angles)
    assert np.allclose(along, -wanted, atol=1e-5)


def test_limits_beyond_half_a_turn():
    """Angles are seen by their sine and cosine: 3.5 rad was taken for -2.8."""
    from types import SimpleNamespace

    def cost(angle: float) -> tuple[float, float]:
        own = SimpleNamespace(n_envs=1, margins=[(0, 1, -0.5, 4.0)], limit_margin=0.3, limit_cost=1.0)
        found, slopes = Gradient._near_limits(own, np.array([[np.sin(angle), np.cos(angle)]]))
        return float(found[0]), -float(slopes[0] @ [np.cos(angle), -np.sin(angle)])

    assert [cost(angle)[0] for angle in (-0.1, 1.0, 3.5)] == [0.0, 0.0, 0.0]
    for angle in (-0.4, 3.9, 4.1, 4.5):  # of the last no slope is left
        assert cost(angle)[1] == pytest.approx((cost(angle + 1e-6)[0] - cost(angle - 1e-6)[0]) / 2e-6, abs=1e-6)
    assert cost(3.9)[0] == pytest.approx(4.0 / 9.0)
