"""Recorded episodes: kept whole, written and read back, replayed to the last bit, given to Minari."""

import dataclasses
import sys
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env import arms
from flexarm_env.envs.video import write_film
from flexarm_env.recording import Episode, EpisodeRecorder, frames, load_episodes, replay, save_episodes, to_minari
from flexarm_env.scenes import named
from tests.refusals import refuses

ENV = "FlexibleArm-v0"
RANDOM = {"payload": (0.5, 2.0), "EI": (0.7, 1.3)}


def recorded(steps: tuple[int, ...] = (10, 10, 4), **kwargs: Any) -> tuple[list[Episode], list[Any]]:
    """Episodes under random actions, the first of them seeded, and what the environment returned."""
    env = EpisodeRecorder(gym.make(ENV, **{"duration": 0.2, "randomization": RANDOM} | kwargs))
    rng, outcomes = np.random.default_rng(4), []
    for k, count in enumerate(steps):
        outcomes.append(env.reset(seed=3 if k == 0 else None))
        for _ in range(count):
            outcomes.append(env.step(rng.uniform(-1.0, 1.0, 1).astype(np.float32)))
    env.close()
    return env.episodes, outcomes


@pytest.fixture(scope="module")
def three() -> tuple[list[Episode], list[Any]]:
    return recorded()


def test_everything_is_kept(three: tuple[list[Episode], list[Any]]) -> None:
    episodes, outcomes = three
    assert [len(e) for e in episodes] == [10, 10, 4]
    assert [e.complete for e in episodes] == [True, True, False]
    assert [(e.seed, e.generator is None) for e in episodes] == [(3, True), (None, False), (None, False)]
    first = outcomes[:11]
    np.testing.assert_array_equal(episodes[0].observations, [row[0] for row in first])
    np.testing.assert_array_equal(episodes[0].rewards, [row[1] for row in first[1:]])
    np.testing.assert_array_equal(episodes[0].infos["tip_position"], [row[-1]["tip_position"] for row in first])
    assert episodes[0].infos["termination_reason"].tolist() == [""] * 11


def test_files_are_read_back(three: tuple[list[Episode], list[Any]], tmp_path: Path) -> None:
    path = save_episodes(tmp_path / "new" / "episodes.npz", three[0])
    assert [p.name for p in path.parent.iterdir()] == ["episodes.npz"]
    back = load_episodes(path)
    for mine, theirs in zip(back, three[0], strict=True):
        assert mine.equals(theirs)
        assert (mine.env_kwargs, mine.seed, mine.generator) == (theirs.env_kwargs, theirs.seed, theirs.generator)
        for name, values in theirs.infos.items():
            np.testing.assert_array_equal(mine.infos[name], values)
    assert not back[0].equals(back[1])


def test_episodes_are_replayed_to_the_last_bit(three: tuple[list[Episode], list[Any]], tmp_path: Path) -> None:
    for episode in load_episodes(save_episodes(tmp_path / "episodes.npz", three[0])):
        assert replay(episode).equals(episode)


def test_options_arms_and_limits_come_back(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    file.write_text(arms.to_toml(arms.named("strip")))
    env = EpisodeRecorder(gym.make(ENV, arm=str(file), max_episode_steps=5))
    t = np.linspace(0.0, 0.2, 9)
    for options in ({"start": 0.3, "target": np.array([0.5])}, {"motion": {"t": t, "psi": 0.1 * t**2}}):
        env.reset(seed=1, options=options)
        for _ in range(5):
            env.step(np.full(1, 0.5, np.float32))
    env.close()
    file.unlink()
    episodes = load_episodes(save_episodes(tmp_path / "episodes.npz", env.episodes))
    assert [len(e) for e in episodes] == [5, 5]
    assert [bool(e.truncations[-1]) for e in episodes] == [True, True]
    for episode in episodes:
        assert replay(episode).equals(episode)


@pytest.mark.slow
def test_a_scene_as_motion(tmp_path: Path) -> None:
    scene = named("robot_arm_motion")
    limits = {"arm": "paper", "duration": 0.2, "control_dt": 0.05, "dt": 0.05}
    env = EpisodeRecorder(gym.make(ENV, formulation="floating_frame", segments=5, **limits))
    env.reset(options={"motion": scene})
    env.step(np.zeros(1, np.float32))
    env.close()
    (episode,) = load_episodes(save_episodes(tmp_path / "e.npz", env.episodes))
    assert not episode.complete
    assert replay(episode).equals(episode)


def test_pictures_of_an_episode(three: tuple[list[Episode], list[Any]], tmp_path: Path) -> None:
    pytest.importorskip("pygame")
    every = list(frames(three[0][2]))
    assert len(every) == 5
    assert every[0].shape[2] == 3
    assert write_film(tmp_path / "e.gif", every, 50.0).read_bytes().startswith(b"GIF89a")


def test_what_cannot_be_recorded_is_said(three: tuple[list[Episode], list[Any]], tmp_path: Path) -> None:
    refuses("must be a single environment", lambda: EpisodeRecorder(gym.make("CartPole-v1")))
    with pytest.raises(ValueError, match="record below RescaleObservation"):
        box = (np.full(6, -1.0, np.float32), np.full(6, 1.0, np.float32))
        EpisodeRecorder(gym.wrappers.RescaleObservation(gym.make(ENV), *box))
    env = EpisodeRecorder(gym.make(ENV))
    with pytest.raises(ValueError, match=r"options\.motion = (.|\n)* to be recorded"):
        env.reset(options={"motion": flexarm_env.named("robot_arm_motion").motions[0].function})
    refuses("at least one", lambda: save_episodes(tmp_path / "none.npz", []))
    with pytest.raises(FileNotFoundError):
        load_episodes(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK\3\4 torn")
    refuses(r"bad\.npz: damaged", lambda: load_episodes(tmp_path / "bad.npz"))
    np.savez(tmp_path / "other.npz", a=1)
    refuses("no episodes of this package", lambda: load_episodes(tmp_path / "other.npz"))


def test_actions_and_seeds_of_any_kind_are_replayed(tmp_path: Path) -> None:
    """As the environment took them: 1e300 is a whole torque there, and infinite as float32."""
    env = EpisodeRecorder(gym.make(ENV, max_episode_steps=2))
    for action in ([1e300], np.array([np.nan])):
        env.reset(seed=np.int64(3))  # type: ignore[arg-type]
        env.step(action)  # type: ignore[arg-type]
    env.reset()
    env.step([0.0])  # type: ignore[arg-type]
    env.step([0.0])  # type: ignore[arg-type]
    refuses("has ended", lambda: env.step(np.zeros(1, np.float32)), gym.error.ResetNeeded)
    env.close()
    for episode in load_episodes(save_episodes(tmp_path / "e.npz", env.episodes)):
        assert replay(episode).equals(episode)
    cut = dataclasses.replace(env.episodes[-1], max_episode_steps=1)
    refuses("actions = '2 of them': must be 1: played again, it ends there", lambda: replay(cut))
    none = dataclasses.replace(cut, actions=cut.actions[:0], rewards=cut.rewards[:0])
    refuses(r"episodes\[0\] = .*: must have at least one step", lambda: replay(none))


def test_what_cannot_be_read_is_not_written(three: tuple[list[Episode], list[Any]], tmp_path: Path) -> None:
    one, changed = three[0][0], dataclasses.replace
    empty = changed(
        one, **{name: getattr(one, name)[:0] for name in ("actions", "rewards", "terminations", "truncations")}
    )
    full = recorded((2,), info_level="full")[0][0]
    cases: list[tuple[Any, str]] = [
        (one, "episodes = <Episode of .*>: must be a sequence of Episodes"),
        (["x"], r"episodes\[0\] = 'x': must be an Episode"),
        ([one, empty], r"episodes\[1\] = .*: must have at least one step"),
        ([one, full], r"shape of episodes\[1\]\.energy_dissipated = \(\): must be as in episodes\[0\]"),
        ([full, one], r"shape of episodes\[1\]\.energy_dissipated = None: must be as in episodes\[0\]"),
        ([changed(one, observations=one.observations * np.nan)], r"observations\[0, 0\] = nan"),
        ([changed(one, rewards=one.rewards[:2])], "shape of observations"),
        ([changed(one, env_kwargs={"arm": object()})], r"episodes\[0\]\.env_kwargs\.arm = <object"),
    ]
    for episodes, sentence in cases:
        refuses(sentence, partial(save_episodes, tmp_path / "e.npz", episodes))
    assert not list(tmp_path.iterdir())
    file = tmp_path / "named.toml"
    file.write_text(arms.to_toml(arms.named("strip")))  # a recording holds an arm's text, and names no file
    for value, sentence in ((5, "arm.toml = 5: must be a text"), (str(file), "arm.toml: not a TOML file")):
        refuses(sentence, partial(replay, changed(one, env_kwargs={"arm": {"arm.toml": value}})))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_minari(three: tuple[list[Episode], list[Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "jax", None)  # not in the extra, which has to do without
    made = to_minari(three[0], "flexarm/slew/random-v0", algorithm_name="random", author="me")
    assert (made.total_episodes, made.total_steps) == (3, 24)
    back = minari.load_dataset("flexarm/slew/random-v0")
    for episode, own in zip(back.iterate_episodes(), three[0], strict=True):
        np.testing.assert_array_equal(episode.observations, own.observations)
        np.testing.assert_array_equal(episode.actions, own.actions)
        np.testing.assert_array_equal(episode.rewards, own.rewards)
        np.testing.assert_array_equal(episode.infos["tip_position"], own.infos["tip_position"])
        assert bool(episode.truncations[-1])
    env = back.recover_environment()
    assert env.observation_space == made.observation_space
    env.close()
    with pytest.raises(ValueError, match="other keywords"):
        to_minari([three[0][0], recorded((2,), duration=0.1)[0][0]], "flexarm/slew/mixed-v0")
    with pytest.raises(ValueError, match="other keywords"):
        to_minari([three[0][0], recorded((2,), max_episode_steps=2)[0][0]], "flexarm/slew/mixed-v0")
    before = sorted(tmp_path.rglob("*"))
    for name in ("../outside-v0", "/outside-v0", "a/../../outside-v0", "slew", "slew-v1.5", "", None):
        refuses("dataset_id = ", partial(to_minari, three[0], name))
    assert sorted(tmp_path.rglob("*")) == before and not list(tmp_path.parent.glob("outside*"))
