"""Playing from the command line, and the commands that hand on to a checkout's scripts."""

import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import suite
from flexarm_env.cli import checkout, main, play
from flexarm_env.control.catalogue import Following
from flexarm_env.recording import EpisodeRecorder, frames, load_episodes, replay, save_episodes, to_minari
from flexarm_env.suite.policies import choose
from tests.cli_tools import answer, refused
from tests.processes import ROOT, python

SHORT = ["play", "--policy", "pd", "--env-kwargs", '{"duration": 0.2}']
HEADLESS = [*SHORT, "--headless"]


# -------------------------------------------------------------------- play
def test_a_controller_plays(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*HEADLESS, "--episodes", "2", "--seed", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["env: FlexibleArm-v0", "policy: pd"]
    assert [line.split(",")[0] for line in lines[2:]] == ["episode: seed 5", "episode: seed 6"]
    assert lines[2].endswith("0.20 s, ended by time")


def test_pd_plays_what_it_is_judged_on() -> None:
    """Targets that move too, in `play` and `view` as in `bench suite`."""
    for words in (("flexarm/catch-v1",), ("flexarm/track-fast-v2",), ("FlexibleArm-v0", "track")):
        with closing(gym.make(words[0], **({"task": words[1]} if words[1:] else {}))) as env:
            player = play.choose("pd").make(env)
            assert type(player) is type(choose("pd", suite.tasks()[0]).make(env)) is Following
            seen = env.observation_space.sample() * 0.0
            player.reset(seen)
            assert player.act(seen).shape == env.action_space.shape
            with pytest.raises(ValueError, match="controllers steer to a target"):
                play.choose("lqr").make(env)


def test_a_film_and_a_recording(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    film, kept = tmp_path / "pd.gif", tmp_path / "pd.npz"
    values = answer(capsys, *SHORT, "--video", str(film), "--record", str(kept))
    assert (values["video"], values["record"]) == (str(film), str(kept))
    assert film.read_bytes().startswith(b"GIF89a")
    (episode,) = load_episodes(kept)
    assert len(episode) == 10
    assert sum(episode.rewards) == values["episodes"][0]["return"]
    assert replay(episode).equals(episode)


def test_a_policy_brings_its_environment(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexarm_env.control import NamedPolicy

    meta = {"env_id": "TwoLinkFlexArm-v0", "env_kwargs": {"control_dt": 0.04, "duration": 1.0}}
    found = NamedPolicy("made", meta["env_id"], meta["env_kwargs"], lambda env: None)
    monkeypatch.setattr(play, "find_policy", lambda word, flag: found)
    player = play.choose(str(tmp_path))
    assert (player.env_id, player.env_kwargs) == ("TwoLinkFlexArm-v0", {"control_dt": 0.04})
    assert "must be TwoLinkFlexArm-v0" in refused(capsys, "play", "FlexibleArm-v0", "--policy", str(tmp_path))


HELPER = """
import pathlib
import gymnasium
pathlib.Path(__file__).with_name("imported").touch()
from flexarm_env.envs.flexible_arm import FlexibleArmEnv
if "Helped-v0" not in gymnasium.registry:
    gymnasium.register("Helped-v0", entry_point=FlexibleArmEnv)
"""


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A module that leaves a trace when it is imported, as one beside a policy file may be."""
    (tmp_path / "helper_of_a_file.py").write_text(HELPER)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("helper_of_a_file", None)
    gym.registry.pop("Helped-v0", None)


def packaged(path: Path, **changes: Any) -> Path:
    """A policy that comes with the package, its meta changed."""
    from flexarm_env.control import policy

    with np.load(Path(policy.__file__).parents[1] / "data" / "policies" / "flexible_arm" / "policy.npz") as data:
        arrays = dict(data)
    arrays["meta"] = np.array(json.dumps(json.loads(str(arrays["meta"])) | changes))
    np.savez(path, **arrays)
    return path


def test_a_policy_file_does_not_choose_what_is_imported(foreign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, asked = packaged(foreign / "p.npz", env_id="helper_of_a_file:Helped-v0"), "helper_of_a_file:Helped-v0"
    sentence = refused(capsys, "play", "--headless", "--policy", str(file))
    assert f"p.env_id = '{asked}': must be FlexibleArm-v0 or TwoLinkFlexArm-v0" in sentence
    assert not (foreign / "imported").exists()
    words = ["play", asked, "--headless", "--policy", str(file), "--env-kwargs", '{"duration": 0.1}']
    assert main(words) == 0  # named by the caller
    assert (foreign / "imported").exists()


def test_what_a_policy_file_may_not_ask_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for env_id in ("CartPole-v1", "FlexibleArm", 3):
        file = packaged(tmp_path / "p.npz", env_id=env_id)
        assert "env_id = " in refused(capsys, "play", "--headless", "--policy", str(file))
    for name in ("id", "render_mode", "vectorization_mode"):
        file = packaged(tmp_path / "p.npz", env_kwargs={name: "x"})
        assert f"p.env_kwargs.{name}: unknown argument" in refused(capsys, "play", "--headless", "--policy", str(file))


def test_a_recording_does_not_choose_what_is_imported(foreign: Path, tmp_path: Path) -> None:
    with closing(EpisodeRecorder(gym.make("FlexibleArm-v0", duration=0.1))) as env:
        env.reset(seed=0)
        for _ in range(5):
            env.step(np.zeros(1, np.float32))
    episode = dataclasses.replace(env.episodes[0], env_id="helper_of_a_file:Helped-v0")
    (back,) = load_episodes(save_episodes(tmp_path / "e.npz", [episode]))
    for again in (replay, lambda e: next(frames(e)), lambda e: to_minari([e], "flexarm/none-v0")):
        with pytest.raises(ValueError, match=r"episode\.env_id = 'helper_of_a_file:Helped-v0': must be FlexibleArm-v0"):
            again(back)
    assert not (foreign / "imported").exists()
    assert replay(back, env_id="helper_of_a_file:Helped-v0").equals(back)


def test_the_keyboard_needs_a_window(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "there is no window" in refused(capsys, "play")
    assert "with --video" in refused(capsys, "play", "--video", str(tmp_path / "a.gif"))
    assert "or --headless" in refused(capsys, "play", "--headless")


def test_keys_are_torques() -> None:
    held: set[str] = set()
    keyboard = play.Keyboard(2, held.__contains__)
    nothing = np.zeros(3, np.float32)
    assert keyboard.act(nothing).tolist() == [0.0, 0.0]
    held |= {"left", "down"}
    assert keyboard.act(nothing).tolist() == [1.0, -1.0]
    held |= {"right", "left shift"}
    np.testing.assert_allclose(keyboard.act(nothing), [0.0, -play.GENTLE])
    assert play.Keyboard(1, held.__contains__).act(nothing).shape == (1,)


def test_the_keyboard_in_a_window(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "a screen")  # the dummy has a surface, but nobody sees it
    codes = {pygame.K_LEFT}

    class Held:
        """What pygame.key.get_pressed gives."""

        def __getitem__(self, code: int) -> bool:
            return code in codes

    monkeypatch.setattr(pygame.key, "get_pressed", Held)
    words = "play", "--env-kwargs", '{"duration": 0.2}'
    (outcome,) = answer(capsys, *words)["episodes"]
    assert outcome["seconds"] == pytest.approx(0.2)
    codes.add(pygame.K_ESCAPE)
    assert answer(capsys, *words)["episodes"] == []


def test_wrong_words_of_play(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "--policy = 'nobody': must be a run folder" in refused(capsys, "play", "--policy", "nobody")
    assert "unknown environment; allowed: FlexibleArm-v0" in refused(capsys, "play", "Arm-v0", "--policy", "pd")
    assert "--episodes = 0" in refused(capsys, *SHORT, "--episodes", "0")
    assert "must be JSON" in refused(capsys, "play", "--policy", "pd", "--env-kwargs", "{duration: 2}")
    assert "--record = 'a.txt': must end in .npz" in refused(capsys, *SHORT, "--record", "a.txt")
    assert "must end with one of" in refused(capsys, *SHORT, "--video", str(tmp_path / "a.txt"))
    for name in ("armm", "id", "render_mode"):
        text = refused(capsys, "play", "--policy", "pd", "--env-kwargs", f'{{"{name}": 1}}')
        assert f"--env-kwargs.{name}: unknown argument" in text
    assert "unknown environment; allowed" in refused(capsys, "play", "no id!", "--policy", "pd")
    assert 'for task="reach"' in refused(capsys, "play", "TwoLinkFlexArm-v0", "--policy", "time_optimal", "--headless")


# ---------------------------------------------------------------- checkout
def ran(monkeypatch: pytest.MonkeyPatch, *words: str) -> list[str]:
    """The command that `flexarm words` starts."""
    started: list[list[str]] = []

    class Process:
        """Ends with 7."""

        def __init__(self, command: list[str], env: dict[str, str]) -> None:
            assert env["PYTHONPATH"].split(":")[0] == str(ROOT)
            started.append(command)

        def wait(self) -> int:
            return 7

    monkeypatch.setattr(subprocess, "Popen", Process)
    assert main(list(words)) == 7
    return started[0][1:]


def test_scripts_are_given_all_flags(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ran(monkeypatch, "bench", "throughput", "--out", "x") == ["-m", "benchmarks.throughput", "--out", "x"]
    assert ran(monkeypatch, "bench", "work-precision", "--full") == ["-m", "benchmarks.work_precision", "--full"]


@pytest.mark.slow
def test_a_script_runs_from_any_folder(tmp_path: Path) -> None:
    assert "--scene" in python("-m", "flexarm_env", "bench", "converged", "-h", cwd=tmp_path).stdout


def test_help_of_a_program_shows_its_flags(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    text = capsys.readouterr().out
    assert "usage: flexarm train " in text
    assert "  --n-timesteps " in text
    assert "total number of" in text


def test_helps_say_which_files_run_code(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("play", "train", "evaluate"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert "executes no code" in text or "pickles" in text, command


def test_benchmarks_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("throughput ") for line in lines)
    assert not any(line.startswith("machine") for line in lines)
    assert {"name", "what"} == set(answer(capsys, "bench")["benchmarks"][0])
    sentence = refused(capsys, "bench", "none")
    assert "no benchmark 'none'; available: " in sentence and " throughput," in sentence


def test_without_a_checkout_a_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(checkout, "__file__", str(tmp_path / "site-packages" / "flexarm_env" / "cli" / "checkout.py"))
    assert "needs benchmarks/ of a checkout" in refused(capsys, "bench", "throughput")
    assert main(["bench"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["suite", "page"]
