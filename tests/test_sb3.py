"""A Gymnasium VectorEnv as a Stable-Baselines3 VecEnv: what every algorithm and wrapper of theirs relies on."""

from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize, VecVideoRecorder

from flexarm_env.sb3 import GymnasiumVecEnv, make_sb3_vec
from tests.processes import python
from tests.refusals import refuses

LAST = 5


class Counting(VectorEnv[Any, Any, Any]):
    """Counts steps: environment i ends after LAST + i of them, even ones terminated, odd ones truncated."""

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": ["rgb_array"]}

    def __init__(self, num_envs: int = 3, render_mode: str | None = None, max_episode_steps: int = 0) -> None:
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space = gym.spaces.Box(-100.0, 100.0, (2,), np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.count = np.zeros(num_envs, dtype=np.int64)
        self.start = np.zeros(num_envs)
        self.gain = np.ones(num_envs)
        self.title = "counting"
        self.calls: list[Any] = []

    def _observe(self) -> Any:
        return np.column_stack([self.count, self.start]).astype(np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        options = dict(options or {})
        mask = options.pop("reset_mask", np.ones(self.num_envs, dtype=bool))
        self.calls.append((seed, options, mask.tolist()))
        first = 0 if seed is None else seed
        self.count[mask] = 0
        self.start = np.where(mask, first + np.arange(self.num_envs) + options.get("shift", 0.0), self.start)
        return self._observe(), {"start": self.start.copy(), "_start": mask}

    def step(self, actions: Any) -> Any:
        assert actions.shape == (self.num_envs, 1)
        self.count += 1
        done = self.count >= LAST + np.arange(self.num_envs)
        even = np.arange(self.num_envs) % 2 == 0
        rewards = self.gain * actions[:, 0].astype(np.float64)
        info: dict[str, Any] = {"count": self.count.copy(), "pose": np.column_stack([self.count, self.start])}
        if done.any():
            info["final_obs"], info["_final_obs"] = self._observe(), done
            info["final_info"] = {"count": self.count.copy(), "is_success": even, "_count": done, "_is_success": done}
            info["_final_info"] = done
            self.count[done] = 0
            info["count"][done] = 0
        return self._observe(), rewards, done & even, done & ~even, info

    def render(self) -> Any:
        return tuple(np.full((4, 6, 3), i, dtype=np.uint8) for i in range(self.num_envs))

    def double(self, x: float) -> float:
        return 2.0 * x

    def get_state(self, indices: Any = None) -> list[int]:
        return [int(self.count[i]) for i in (range(self.num_envs) if indices is None else indices)]


class NextStep(Counting):
    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.NEXT_STEP}


@pytest.fixture
def counting() -> GymnasiumVecEnv:
    return GymnasiumVecEnv(Counting())


def actions_of(env: Any, value: float = 0.5) -> Any:
    return np.full((env.num_envs, 1), value, dtype=np.float32)


def pendulums(n: int, **wrapped: Any) -> SyncVectorEnv:
    def make() -> Any:
        env: Any = gym.make("Pendulum-v1", max_episode_steps=20)
        return Monitor(env) if wrapped.get("monitor") else env

    return SyncVectorEnv([make for _ in range(n)], autoreset_mode=AutoresetMode.SAME_STEP)


# -------------------------------------------------------------------- episodes
def test_the_end_of_an_episode_is_told_as_sb3_wants_it(counting: GymnasiumVecEnv) -> None:
    first = counting.reset()
    assert first.shape == (3, 2) and first.dtype == np.float32
    assert [info["start"] for info in counting.reset_infos] == [0.0, 1.0, 2.0]
    for k in range(1, LAST):
        observations, rewards, dones, infos = counting.step(actions_of(counting))
        assert infos == [{}, {}, {}] and not dones.any()
        np.testing.assert_array_equal(observations[:, 0], k)
    assert rewards.dtype == np.float32 and rewards.tolist() == [0.5] * 3

    observations, _, dones, infos = counting.step(actions_of(counting))
    assert dones.tolist() == [True, False, False]
    assert observations[:, 0].tolist() == [0.0, LAST, LAST]
    assert infos[0]["terminal_observation"].tolist() == [LAST, 0.0]
    assert infos[0]["TimeLimit.truncated"] is False and infos[0]["is_success"] is True and infos[0]["count"] == LAST
    assert counting.reset_infos[0]["count"] == 0 and infos[1:] == [{}, {}]

    _, _, dones, infos = counting.step(actions_of(counting))
    assert dones.tolist() == [False, True, False]
    assert infos[1]["TimeLimit.truncated"] is True and infos[1]["is_success"] is False


def test_entries_of_info_on_demand() -> None:
    env = GymnasiumVecEnv(Counting(), info_keys=["pose"])
    env.reset()
    _, _, _, infos = env.step(actions_of(env))
    assert [info["pose"].tolist() for info in infos] == [[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]


def test_arguments_that_are_none_are_named() -> None:
    refuses(r"info_keys = 'pose': must be a sequence", lambda: GymnasiumVecEnv(Counting(), info_keys="pose"))
    env = GymnasiumVecEnv(Counting(), info_keys=["nope"])
    env.reset()
    refuses("info_keys = 'nope': must be one of", lambda: env.step(actions_of(env)))
    for given in ({"seed": -1}, {"seed": "x"}, {"normalize": [1]}):
        refuses(next(iter(given)), partial(make_sb3_vec, "FlexibleArm-v0", 2, **given))


def test_another_autoreset_mode_is_refused() -> None:
    refuses(r"must be AutoresetMode\.SAME_STEP", lambda: GymnasiumVecEnv(NextStep()))
    refuses("must be 'sync' or 'async' for CartPole-v1", lambda: make_sb3_vec("CartPole-v1", 2))
    refuses("n_envs = 0: must be a whole number", lambda: make_sb3_vec("Pendulum-v1", 0))


OURS: dict[str, Any] = {"duration": 0.3, "randomization": {"payload": (0.8, 1.2)}}


@pytest.mark.parametrize(
    ("env_id", "length", "more", "made"),
    [
        ("Pendulum-v1", 20, {"max_episode_steps": 20}, {"vectorization_mode": "sync"}),
        ("FlexibleArm-v0", 15, OURS, {"info_keys": ["tip_position"]}),
        ("TwoLinkFlexArm-v0", 15, OURS, {"info_keys": ["tip_position"]}),
    ],
)
def test_equals_dummy_vec_env_bit_for_bit(env_id: str, length: int, more: dict[str, Any], made: dict[str, Any]) -> None:
    ours = make_sb3_vec(env_id, 3, seed=7, monitor=False, **made, **more)
    theirs = DummyVecEnv([lambda: gym.make(env_id, **more)] * 3)
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    theirs.seed(7)
    rng, high = np.random.default_rng(0), ours.action_space.high
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    for k in range(1, 2 * length + 6):
        actions = rng.uniform(-high, high, (3, *high.shape)).astype(np.float32)
        a, b = ours.step(actions), theirs.step(actions)
        for mine, other in zip(a[:3], b[:3], strict=True):
            assert mine.dtype == other.dtype
            np.testing.assert_array_equal(mine, other)
        assert a[2].all() == a[2].any() == (k % length == 0)
        for mine, other in zip(a[3], b[3], strict=True):
            assert mine.keys() == (other.keys() if k % length == 0 else set(made.get("info_keys", ())))
            for key in mine:
                assert type(mine[key]) is type(other[key]), key
                np.testing.assert_array_equal(mine[key], other[key], err_msg=key)
    assert [sorted(info) for info in ours.reset_infos] == [sorted(info) for info in theirs.reset_infos]


def test_dict_observations() -> None:
    class Twofold(Counting):
        def __init__(self) -> None:
            super().__init__(2)
            single = self.single_observation_space
            self.single_observation_space = gym.spaces.Dict(a=single, b=single)
            self.observation_space = batch_space(self.single_observation_space, 2)

        def _observe(self) -> Any:
            return {"a": super()._observe(), "b": -super()._observe()}

    env = GymnasiumVecEnv(Twofold())
    env.reset()
    for _ in range(LAST):
        observations, _, _, infos = env.step(actions_of(env))
    assert observations["b"].shape == (2, 2)
    assert infos[0]["terminal_observation"]["b"].tolist() == [-LAST, 0.0]


# ----------------------------------------------------------- seeds and options
def test_seeds_are_used_once(counting: GymnasiumVecEnv) -> None:
    assert counting.seed(10) == [10, 11, 12]
    counting.reset()
    counting.reset()
    counting._seeds = [5, 1, 9]
    native: Any = counting.env
    native.reset = lambda seed, options: (native.calls.append((seed, options)), ({}, {}))[1]
    counting.reset()
    assert [call[0] for call in native.calls] == [10, None, [5, 1, 9]]


def test_options_are_passed_to_those_they_are_for(counting: GymnasiumVecEnv) -> None:
    counting.set_options({"shift": 100.0})
    assert counting.reset()[:, 1].tolist() == [100.0, 101.0, 102.0]
    assert counting.reset()[:, 1].tolist() == [0.0, 1.0, 2.0]
    counting.set_options([{"shift": 50.0}, {}, {"shift": 50.0}])
    counting.seed(3)
    assert counting.reset()[:, 1].tolist() == [53.0, 4.0, 55.0]
    assert [info["start"] for info in counting.reset_infos] == [53.0, 4.0, 55.0]
    counting.set_options([{"shift": np.ones(2)[0]}, {"shift": np.float64(2.0)}, {}])
    assert counting.reset()[:, 1].tolist() == [1.0, 3.0, 2.0]


# ------------------------------------------------------ attributes and methods
def test_attributes_of_a_native_vector_environment(counting: GymnasiumVecEnv) -> None:
    assert counting.get_attr("title", [0, 2]) == ["counting"] * 2
    assert counting.get_attr("gain") == [1.0, 1.0, 1.0]
    assert counting.get_attr("action_space", 1) == [counting.action_space]
    assert counting.has_attr("title") and not counting.has_attr("nonesuch")
    counting.set_attr("gain", 3.0, indices=[1])
    counting.reset()
    assert counting.step(actions_of(counting))[1].tolist() == [0.5, 1.5, 0.5]
    counting.set_attr("title", "other")
    assert counting.get_attr("title", 0) == ["other"]
    with pytest.raises(ValueError, match="must be all 3 environments, which share one 'title'"):
        counting.set_attr("title", "mine", indices=0)


def test_methods_of_a_native_vector_environment(counting: GymnasiumVecEnv) -> None:
    counting.reset()
    counting.step(actions_of(counting))
    assert counting.env_method("double", 4.0) == [8.0] * 3
    assert counting.env_method("get_state", indices=[2, 0]) == [1, 1]
    refuses(r"indices = \[1\]: must be all 3 environments", lambda: counting.env_method("double", 4.0, indices=1))
    refuses("nonesuch", lambda: counting.env_method("nonesuch", indices=1), AttributeError)
    ((observation, info),) = counting.env_method("reset", indices=[1], seed=20, options={"shift": 1.0})
    assert observation.tolist() == [0.0, 22.0] and info == {"start": 22.0}
    assert counting.env_method("get_state") == [1, 0, 1]
    assert counting.env_is_wrapped(Monitor) == [False] * 3
    assert counting.env_is_wrapped(Monitor, indices=[1]) == [False]


def test_attributes_that_a_native_vector_knows_of_its_environments_alone() -> None:
    for mode in ("vector_entry_point", "sync"):
        assert make_sb3_vec("FlexibleArm-v0", 3, vectorization_mode=mode).get_attr("dt") == [0.02] * 3


def test_attributes_of_single_environments() -> None:
    env = GymnasiumVecEnv(pendulums(3, monitor=True))
    assert env.env_is_wrapped(Monitor) == [True] * 3
    assert not any(env.env_is_wrapped(gym.wrappers.ClipAction))
    assert env.get_attr("g") == [10.0] * 3
    env.set_attr("g", 5.0, indices=[0, 2])
    assert env.get_attr("g") == [5.0, 10.0, 5.0]
    env.reset()
    assert env.env_method("get_episode_rewards", indices=[1]) == [[]]


# ---------------------------------------------------------------------- images
def test_images(tmp_path: Path) -> None:
    env = GymnasiumVecEnv(Counting(4, render_mode="rgb_array"))
    env.reset()
    assert env.render_mode == "rgb_array"
    assert [image[0, 0, 0] for image in env.get_images() if image is not None] == [0, 1, 2, 3]
    tiled = env.render()
    assert tiled is not None and tiled.shape == (8, 12, 3)
    assert [frame[0, 0, 0] for frame in env.env_method("render", indices=[3, 1])] == [3, 1]
    with pytest.warns(UserWarning, match="pictures need 'rgb_array'"):
        assert GymnasiumVecEnv(Counting(2)).get_images() == [None, None]


def test_video_recorder(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    native = Counting(2, render_mode="rgb_array")
    env = VecVideoRecorder(
        GymnasiumVecEnv(native), str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=3
    )
    env.reset()
    for _ in range(5):
        env.step(actions_of(env))
    env.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]


# ------------------------------------------------------- wrappers, algorithms
def test_wrappers_in_order(tmp_path: Path) -> None:
    env = make_sb3_vec(
        "Pendulum-v1", 2, seed=1, monitor=str(tmp_path / "log"), normalize={"norm_reward": False, "clip_obs": 5.0},
        vectorization_mode="sync", max_episode_steps=10,
    )  # fmt: skip
    assert isinstance(env, VecNormalize) and isinstance(env.venv, VecMonitor)
    assert isinstance(env.unwrapped, GymnasiumVecEnv)
    assert not env.norm_reward and env.clip_obs == 5.0
    env.reset()
    for _ in range(10):
        observations, _, dones, infos = env.step(np.zeros((2, 1), dtype=np.float32))
    assert dones.all() and [info["episode"]["l"] for info in infos] == [10, 10]
    np.testing.assert_allclose(
        infos[0]["terminal_observation"], env.normalize_obs(env.unnormalize_obs(infos[0]["terminal_observation"]))
    )
    assert (np.abs(observations) <= 5.0).all()
    env.close()
    assert (tmp_path / "log.monitor.csv").read_text().count("\n") == 4

    bare = make_sb3_vec("Pendulum-v1", 2, monitor=False, vectorization_mode="sync")
    assert isinstance(bare, GymnasiumVecEnv)


def test_the_same_seed_gives_the_same_run() -> None:
    runs = []
    for seed in (3, 3, 4):
        env = make_sb3_vec("Pendulum-v1", 4, vectorization_mode="sync", max_episode_steps=20)
        model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=seed, device="cpu")
        model.learn(128)
        runs.append(np.concatenate([p.detach().numpy().ravel() for p in model.policy.parameters()]))
    assert np.array_equal(runs[0], runs[1]) and not np.array_equal(runs[0], runs[2])


@pytest.mark.slow
def test_ppo_sac_and_evaluation() -> None:
    env = make_sb3_vec("Pendulum-v1", 4, seed=0, normalize=True, vectorization_mode="sync", max_episode_steps=20)
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=1, device="cpu").learn(256)
    assert len(model.ep_info_buffer or ()) == 12
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=6, return_episode_rewards=True)
    assert lengths == [20] * 6 and len(returns) == 6

    critic = SAC("MlpPolicy", env, learning_starts=40, batch_size=16, buffer_size=500, device="cpu").learn(120)
    replay: Any = critic.replay_buffer
    assert replay.timeouts.sum() == 4 * (120 // 80)  # every episode's end is a time limit, and known as one


# -------------------------------------------------------------- our own arms
@pytest.mark.parametrize("algorithm", [PPO, pytest.param(SAC, marks=pytest.mark.slow)])
def test_learning_on_our_arms(algorithm: Any) -> None:
    env = make_sb3_vec("FlexibleArm-v0", 4, seed=0, normalize=True, duration=0.3, render_mode="rgb_array")
    more: dict[str, Any] = {"n_steps": 32, "n_epochs": 1} if algorithm is PPO else {"learning_starts": 50}
    model = algorithm("MlpPolicy", env, batch_size=16, device="cpu", seed=5, **more).learn(256)
    assert len(model.ep_info_buffer or ()) == len(model.ep_success_buffer or ()) == 16
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=5, return_episode_rewards=True)
    assert lengths == [15] * 5 and np.isfinite(returns).all()
    assert env.env_is_wrapped(Monitor) == [False] * 4
    picture = env.render()
    assert picture is not None and picture.shape == (1280, 1280, 3)
    env.close()


# --------------------------------------------------------------------- imports
def test_a_missing_library_is_named() -> None:
    code = "import sys; sys.modules['stable_baselines3'] = None; import flexarm_env.sb3"
    told = python("-c", code, code=1).stderr
    assert "flexarm_env.sb3 needs stable-baselines3: pip install stable-baselines3 (or install flexarm_env with" in told


def test_wrappers_of_each_environment() -> None:
    """Single environments that are wrapped, here the first by another action than the second."""
    import itertools

    from gymnasium.wrappers import RescaleObservation, TransformReward

    count = itertools.count(1)

    def scaled(one: Any) -> Any:
        factor = next(count)
        return TransformReward(one, lambda reward: factor * reward)

    env = make_sb3_vec("FlexibleArm-v0", 2, seed=0, wrappers=[scaled])
    plain = make_sb3_vec("FlexibleArm-v0", 2, seed=0)
    assert np.array_equal(env.reset(), plain.reset())
    action = np.full((2, 1), 0.5, np.float32)
    seen, rewards, _, _ = env.step(action)
    same, usual, _, _ = plain.step(action)
    assert np.array_equal(seen, same) and rewards == pytest.approx(usual * [1.0, 2.0])
    assert env.env_is_wrapped(TransformReward) == [True, True] and env.env_is_wrapped(RescaleObservation) == [False] * 2
