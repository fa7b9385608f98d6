"""One way to name a policy: every word means the same policy in every command, and files run no code."""

import argparse
import io
import itertools
import json
import pickle
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control, suite
from flexarm_env.cli import main, play, remote, view
from flexarm_env.suite import policies as judged
from tests.refusals import refuses

ENV = "FlexibleArm-v0"
TASK = next(task for task in suite.tasks() if task.id == "slew-limited-v2")

FUNCTIONS = """
import numpy as np

def row(seen):
    assert seen.ndim == 1
    return [0.5 * seen[0]]

def rows(seen):
    return 0.5 * seen[:, :1]

class Remembers:
    def reset(self, seen):
        self.last = 0.0 * seen[..., :1]

    def act(self, seen):
        self.last = 0.5 * self.last + 0.5 * seen[..., :1]
        return self.last
"""


@pytest.fixture(scope="module")
def envs() -> Iterator[tuple[Any, Any]]:
    """The task as one environment and as four."""
    with closing(gym.make(TASK.env_id)) as env, closing(suite.make_vec(TASK.id, 4)) as many:
        yield env, many


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, envs: tuple[Any, Any]) -> Path:
    """One network in every kind of file."""
    home = tmp_path_factory.mktemp("files")
    setup = control.Setup.of(envs[0])
    rng = np.random.default_rng(1)
    sizes = (setup.size, 8, setup.n_joints)
    layers = [(rng.normal(size=(a, b)), rng.normal(size=b)) for a, b in itertools.pairwise(sizes)]
    weights = [(w.astype(np.float32), b.astype(np.float32)) for w, b in layers]
    meta = {
        "format": 1, "env_id": TASK.registered, "env_kwargs": {}, "layout": setup.layout, "layers": 2,
        "activation": "tanh", "squash": False,
    }  # fmt: skip
    run = home / "run"
    run.mkdir()
    arrays = {f"{'wb'[k]}{i}": array for i, pair in enumerate(weights) for k, array in enumerate(pair)}
    np.savez(run / "policy.npz", meta=np.array(json.dumps(meta)), **arrays)
    shutil.copyfile(run / "policy.npz", home / "mine.npz")
    (home / "acts.py").write_text(FUNCTIONS)
    return home


def made(word: str, envs: tuple[Any, Any]) -> list[Any]:
    """The policy of a word in each command, for one environment or for several."""
    from flexarm_env.training.policies import choose

    env, many = envs
    wire = SimpleNamespace(period=env.unwrapped.dt, scales=np.array(control.Setup.of(env).scales), limits=(1.0,))
    args = argparse.Namespace(policy=word, env=TASK.env_id, env_kwargs=None, to="")
    assert view._kind(word) == "player"
    return [
        play.choose(word).make(env), view._who(word, 0).make(env), choose(word, TASK.registered).make(many),
        judged.choose(word, TASK).make(many), remote._policy(args)[1](wire),
        control.load_policy(word, env), control.load_policy(word, many),
    ]  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*control_dt changes the task")
@pytest.mark.parametrize(
    "word",
    ["pd", "pd@gains.toml", "mine.npz", "run", "acts:row", "acts:rows", "acts:Remembers", "model.zip", "mine.onnx"],
)
def test_a_word_is_the_same_policy_in_every_command(
    word: str, files: Path, envs: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    Path("gains.toml").write_text("[pd]\nbandwidth = [0.1]\nratio = [1.0]\n")
    if word == "mine.onnx":
        pytest.importorskip("onnxruntime")
        assert main(["export", "mine.npz", "--to", "onnx", "--out", word]) == 0
    if word == "model.zip":
        Path(word).write_bytes(archive_of(control.load_policy("mine.npz").weights))
    seen, _ = envs[1].reset(seed=0)
    found = []
    for policy in made(word, envs):
        given = seen if len(found) in (2, 3, 6) else seen[0]
        policy.reset(given)
        actions = [policy.act(given) for _ in range(2)]
        assert np.shape(actions[0]) == (*given.shape[:-1], 1)
        found.append([np.ravel(action)[0] for action in actions])
    for one in found[1:]:
        np.testing.assert_allclose(one, found[0], rtol=0, atol=1e-6)
    assert abs(found[0][0]) > 1e-3


def test_a_word_that_names_nothing_lists_what_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    refuses(r"policy = 'nobody': must be a run folder, .* or one of pd, zv", lambda: control.load_policy("nobody"))
    refuses("is a controller, which needs its environment", lambda: control.load_policy("lqr"))
    refuses("policy nowhere:act: cannot be imported", lambda: control.load_policy("nowhere:act"))


# ------------------------------------------------------------------ models of Stable-Baselines3
def archive_of(weights: list[Any]) -> bytes:
    """A model.zip as Stable-Baselines3 writes it, without PyTorch: the names and pickles that such files hold."""
    names = ["mlp_extractor.policy_net.0", "action_net"]
    inner, parts, numbers = io.BytesIO(), [], []
    for name, (w, b) in zip(names, weights, strict=True):
        for word, array in (("weight", np.ascontiguousarray(w.T)), ("bias", b)):
            parts.append((f"{name}.{word}", array, len(numbers)))
            numbers.append(array.tobytes())
    body = b"\x80\x02ccollections\nOrderedDict\n)R("
    for name, array, k in parts:
        key, shape = str(k), "".join(f"K{chr(n)}" for n in array.shape)
        stride = "".join(f"K{chr(int(np.prod(array.shape[i + 1 :])))}" for i in range(array.ndim))
        word = lambda text: b"X" + len(text).to_bytes(4, "little") + text.encode()  # noqa: E731
        body += word(name) + b"ctorch._utils\n_rebuild_tensor_v2\n((" + word("storage") + b"ctorch\nFloatStorage\n"
        body += word(key) + word("cpu") + b"M" + array.size.to_bytes(2, "little") + b"tQK\x00(" + shape.encode("latin1")
        body += b"t(" + stride.encode("latin1") + b"t\x89ccollections\nOrderedDict\n)RtR"
    body += b"u."
    with zipfile.ZipFile(inner, "w") as file:
        file.writestr("archive/data.pkl", body)
        for k, content in enumerate(numbers):
            file.writestr(f"archive/data/{k}", content)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("data", json.dumps({"policy_kwargs": {}}))
        file.writestr("policy.pth", inner.getvalue())
    return out.getvalue()


class Bomb:
    """A pickle that would write a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, Any]:
        return Path.write_text, (self.path, "run")


def test_a_model_runs_no_code(tmp_path: Path, files: Path) -> None:
    mark = tmp_path / "mark"
    (tmp_path / "model.zip").write_bytes(archive_of(control.load_policy(files / "run").weights))
    for content in (Bomb(mark), {"norm_obs": Bomb(mark)}, SimpleNamespace(norm_obs=True, obs_rms=Bomb(mark))):
        (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(content))
        refuses("no statistics of VecNormalize that can be read", lambda: control.load_policy(tmp_path))
    (tmp_path / "vecnormalize.pkl").unlink()
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w") as file, io.BytesIO() as inner:
        with zipfile.ZipFile(inner, "w") as archive:
            archive.writestr("archive/data.pkl", pickle.dumps({"action_net.weight": Bomb(mark)}))
        file.writestr("data", "{}")
        file.writestr("policy.pth", inner.getvalue())
    refuses("its network is none of PPO", lambda: control.load_policy(tmp_path / "bomb.zip"))
    assert control.load_policy(tmp_path).size == 6 and not mark.exists()


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["PPO", "A2C", "SAC", "TD3", "TQC", "RecurrentPPO"])
def test_models_act_as_stable_baselines3_does(algorithm: str, tmp_path: Path) -> None:
    """Memory and normalised observations included."""
    stable = pytest.importorskip("stable_baselines3")
    contrib = pytest.importorskip("sb3_contrib")
    from stable_baselines3.common.vec_env import VecNormalize
    from torch import nn

    from flexarm_env.sb3 import make_sb3_vec

    env = VecNormalize(make_sb3_vec(ENV, n_envs=8, seed=0))
    env.reset()
    rng = np.random.default_rng(3)
    for _ in range(20):
        env.step(rng.uniform(-1.0, 1.0, (8, 1)).astype(np.float32))
    kind = getattr(stable, algorithm, None) or getattr(contrib, algorithm)
    more = {"policy_kwargs": {"activation_fn": nn.ReLU, "net_arch": [8, 8]}} if algorithm == "PPO" else {}
    model = kind("MlpLstmPolicy" if algorithm == "RecurrentPPO" else "MlpPolicy", env, seed=1, **more)
    model.save(tmp_path / "model.zip")
    env.save(str(tmp_path / "vecnormalize.pkl"))
    policy = control.load_policy(tmp_path)
    state, first = None, np.ones(8, bool)
    for k in range(5):
        seen = rng.normal(size=(8, 6)).astype(np.float32)
        theirs, state = model.predict(env.normalize_obs(seen), state, first, deterministic=True)
        if k == 0:
            policy.reset(seen)
        assert np.abs(policy.act(seen) - theirs).max() < 1e-5
        first = np.zeros(8, bool)
