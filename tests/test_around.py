"""Policies with a controller inside: trained, saved, loaded, judged and exported as one."""

import ctypes
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import flexarm_env  # noqa: F401
from flexarm_env import control
from flexarm_env.around import AroundController, AroundControllerVector
from flexarm_env.cli import main
from flexarm_env.control.around import Inside, linear_law
from flexarm_env.control.catalogue import Following, controller
from flexarm_env.control.export import Entries, onnx_bytes
from flexarm_env.control.export_around import around_c_source, onnx_law
from flexarm_env.control.policy import FORMAT_AROUND, AroundPolicy, load_npz, policy_from
from flexarm_env.suite.second import of_arrays
from tests.c_tools import needs_compiler, shared
from tests.refusals import refuses

CLOSE = 1e-6
REACH: dict[str, Any] = {
    "observation": "measured", "history": 2, "duration": 1.0,
    "sensors": {"encoders": {"counts": 4096}, "strain_gauges": [{"link": 0, "noise": 0.01, "bias": 0.02}]},
}  # fmt: skip
SPACE: dict[str, Any] = {"observation": "measured", "duration": 0.3}


def vector(env_id: str = "TwoLinkFlexArm-v0", n: int = 4, mode: AutoresetMode | None = None, **kwargs: Any) -> Any:
    more = {} if mode is None else {"autoreset_mode": mode}
    return gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **kwargs, **more)


def drawn(env: Any, share: float = 0.7, word: str = "pd", scale: float = 1.5, **more: Any) -> AroundPolicy:
    """A policy around a controller, with a random network: large enough to saturate at times."""
    setup, rng = control.Setup.of(env), np.random.default_rng(3)
    widths = (setup.size, 12, setup.n_joints)
    arrays: dict[str, Any] = {}
    for k in range(2):
        arrays[f"w{k}"] = (scale * rng.normal(size=widths[k : k + 2]) / np.sqrt(widths[k])).astype(np.float32)
        arrays[f"b{k}"] = (0.2 * rng.normal(size=widths[k + 1])).astype(np.float32)
    kwargs = more.pop("kwargs", REACH)
    meta = {
        "format": FORMAT_AROUND, "env_id": more.pop("env_id", "TwoLinkFlexArm-v0"), "env_kwargs": kwargs,
        "layout": setup.layout, "scales": dict(zip(setup.names, setup.scales, strict=True)),
        "torque_limits": list(setup.torque_limits), "layers": 2, "activation": "tanh", "squash": False,
        "around": Inside.of(word, env, share).table(), **more,
    }  # fmt: skip
    found = policy_from(meta, arrays)
    assert isinstance(found, AroundPolicy)
    return found


def saved(policy: AroundPolicy, path: Path) -> Path:
    arrays = {f"{kind}{k}": a for k, pair in enumerate(policy.weights) for kind, a in zip("wb", pair, strict=True)}
    np.savez(path, meta=np.array(json.dumps(policy.meta)), **arrays)
    return path


# ------------------------------------------------------------------ the policy
def test_actions_are_the_controller_s_plus_a_share_of_the_network_s(tmp_path: Path) -> None:
    """Against PD and network by themselves, saturated once; both occur: sums within the limits and beyond."""
    env = vector(**REACH)
    path = saved(drawn(env), tmp_path / "policy.npz")
    policy, pd = control.load_policy(path, env), control.make("pd", env)
    observation, _ = env.reset(seed=1)
    policy.reset(observation)
    pd.reset(observation)
    beyond = within = 0
    for _ in range(40):
        signals = pd.read(observation)
        torque = pd.kp * signals.to_go - pd.kd * signals.rates
        raw = torque / pd.limits + 0.7 * policy.network(observation).astype(float)
        actions = policy.act(observation)
        assert actions == pytest.approx(np.clip(raw, -1.0, 1.0), abs=1e-6)
        beyond, within = beyond + int((np.abs(raw) > 1.0).sum()), within + int((np.abs(raw) < 1.0).sum())
        observation, *_ = env.step(actions)
    assert beyond and within
    env.close()


def test_a_file_without_its_environment_is_refused(tmp_path: Path) -> None:
    env = vector(**REACH)
    path = saved(drawn(env), tmp_path / "policy.npz")
    refuses("has the controller pd inside, which needs", lambda: control.load_policy(path))
    unbound = load_npz(path)
    with pytest.raises(RuntimeError, match="which needs its environment"):
        unbound.act(env.reset(seed=0)[0])
    # another controller is another policy for the suite
    assert of_arrays(drawn(env, 0.7)) != of_arrays(drawn(env, 0.3))
    env.close()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": 1}, "meta.format = 1: must be 1, or 2 with an entry around"),
        ({"around": {"controller": "pd"}}, "meta.around.share: missing; must be given"),
        ({"around": {"controller": "pid", "share": 0.5, "gains": {}}}, "meta.around.controller = .pid.: must be"),
        ({"around": {"controller": "pd", "share": 0.0, "gains": {}}}, "meta.around.share = 0.0: must be "),
        ({"around": {"controller": "pd", "share": 0.5, "gain": {}}}, "meta.around.gain: unknown key"),
    ],
)
def test_damaged_files_are_told(change: dict[str, Any], sentence: str) -> None:
    env = vector(**REACH)
    refuses(sentence, lambda: drawn(env, **change))
    env.close()


# ------------------------------------------------------------------ exports
@needs_compiler
def test_c_acts_as_python_does(tmp_path: Path) -> None:
    """Over two episodes, from observations and from SI values."""
    env = gym.make("TwoLinkFlexArm-v0", **REACH)
    policy = drawn(env).bound(env)
    assert isinstance(policy, AroundPolicy)
    entries = Entries.of(policy)
    assert entries is not None
    library = shared(tmp_path, around_c_source(policy, entries, "it"), "-std=c99", "-O2")
    memory, scales = ctypes.create_string_buffer(4096), np.array(control.Setup.of(env).scales)
    for episode, decide in enumerate((library.it_decide, library.it_act)):
        decide.restype = None
        observation, _ = env.reset(seed=episode)
        policy.reset(observation)
        library.it_reset(memory)
        for k in range(40):
            wanted, found = policy.act(observation), np.ones(2, np.float32)
            seen = np.ascontiguousarray(observation, np.float32)
            if episode:
                seen = np.ascontiguousarray((observation[-len(scales) :].astype(np.float64) * scales), np.float32)
            if k == 3:
                broken = np.full_like(seen, np.nan)
                decide(memory, broken.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
                assert not found.any()
            decide(memory, seen.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
            assert np.abs(found - wanted).max() <= CLOSE
            observation, *_ = env.step(wanted)
    env.close()


def test_onnx_acts_as_python_does(tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    env = vector(n=16, **REACH)
    policy = drawn(env).bound(env)
    assert isinstance(policy, AroundPolicy)
    session = runtime.InferenceSession(onnx_bytes(policy, (0.7, onnx_law(policy))))
    observation, _ = env.reset(seed=0)
    policy.reset(observation)
    for _ in range(30):
        wanted = policy.act(observation)
        (found,) = session.run(None, {"observation": observation})
        assert np.abs(found - wanted).max() <= CLOSE
        observation, *_ = env.step(wanted)
    refuses("law = None: must be given for a policy with a controller inside", lambda: onnx_bytes(policy))
    env.close()


@needs_compiler
def test_the_command_exports_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("onnx")
    env = vector(**REACH)
    path = saved(drawn(env), tmp_path / "policy.npz")
    for kind in ("c", "onnx"):
        assert main(["export", str(path), "--to", kind, "--out", str(tmp_path / f"it.{kind}")]) == 0
    assert "it_inside_decide" in (tmp_path / "it.c").read_text()
    capsys.readouterr()
    # PD with ideal readings remembers its goal, which ONNX cannot
    ideal = vector(duration=1.0)
    path = saved(drawn(ideal, kwargs={"duration": 1.0}), tmp_path / "ideal.npz")
    assert main(["export", str(path), "--to", "onnx", "--out", str(tmp_path / "no.onnx")]) == 2
    assert 'must be pd of an arm in the plane with observation="measured"' in capsys.readouterr().err
    assert main(["export", str(path), "--to", "c", "--out", str(tmp_path / "ideal.c")]) == 0
    env.close()
    ideal.close()


# ------------------------------------------------------------------ wrappers
def test_a_single_environment_around_any_controller() -> None:
    """Zero actions leave the controller alone; LQG included, whose estimate sees the sum of the torques."""
    kwargs = {"observation": "measured", "duration": 0.5, "sensors": {"strain_gauges": [{"noise": 0.003}]}}
    for name in ("pd", "lqg"):
        env, plain = (gym.make("FlexibleArm-v0", **kwargs) for _ in range(2))
        around, own = AroundController(env, name, 0.5), control.make(name, plain)
        seen, _ = around.reset(seed=2)
        other, _ = plain.reset(seed=2)
        own.reset(other)
        for _ in range(20):
            seen, *_ = around.step(np.zeros(1, np.float32))
            other, *_ = plain.step(own.act(other))
            assert np.array_equal(seen, other)
        around.close()
        plain.close()


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("env_id", ["TwoLinkFlexArm-v0", "SpatialFlexArm-v0"])
def test_many_environments_begin_episodes_one_by_one(env_id: str, mode: AutoresetMode) -> None:
    """Every episode acts as the controller begun at its own first observation, though the others go on."""
    space = env_id.startswith("Spatial")
    kwargs = SPACE if space else {"duration": 1.0}  # planar: PD remembers its goal
    env = AroundControllerVector(vector(env_id, 2, mode, **kwargs), "pd", 0.5)
    limit = int(env.unwrapped.plan.limit)
    single = [controller("pd", env.env) for _ in range(2)]
    sent: list[np.ndarray] = []
    step = env.env.step
    env.env.step = lambda actions: (sent.append(actions), step(actions))[1]  # type: ignore[method-assign]
    seen, _ = env.reset(seed=5)
    # the second environment begins anew in the middle, so that the two are out of step
    fresh, half = np.array([True, True]), limit // 2
    for k in range(limit + half + 2):
        if k == half and mode == AutoresetMode.DISABLED:
            fresh = np.array([False, True])
            seen, _ = env.reset(options={"reset_mask": fresh})
        for i in np.flatnonzero(fresh):
            single[i].reset(seen[i : i + 1])
        beside = np.random.default_rng(k).uniform(-1.0, 1.0, env.action_space.shape)
        wanted = [own.act(seen[i : i + 1], 0.5 * beside[i : i + 1])[0] for i, own in enumerate(single)]
        before = seen
        seen, _, terminated, truncated, _ = env.step(beside.astype(np.float32))
        assert np.allclose(sent[-1], wanted, atol=2e-6), (k, before)
        ended = terminated | truncated
        fresh = np.zeros(2, bool)
        if mode == AutoresetMode.SAME_STEP:
            fresh = ended
        elif mode == AutoresetMode.NEXT_STEP and ended.any():
            # the next step begins the episode, whatever the action
            seen, *_ = env.step(beside.astype(np.float32))
            for i in np.flatnonzero(~ended):
                single[i].act(before[i : i + 1])
            fresh = ended
        elif mode == AutoresetMode.DISABLED and ended.any():
            seen, _ = env.reset(options={"reset_mask": ended})
            fresh = ended
    env.close()


def test_what_cannot_be_inside_is_a_sentence() -> None:
    env = vector(**REACH)
    refuses("around = .pid.: must be one of", lambda: AroundControllerVector(env, "pid"))
    refuses("share = -1.0: must be ", lambda: AroundControllerVector(env, "pd", -1.0))
    refuses(
        "around = .lqg.: must be pd or a controller of the contact force: the memory",
        lambda: AroundControllerVector(env, "lqg"),
    )
    residual = vector(action_mode="residual_pd")
    refuses("action_mode = .residual_pd.: must be", lambda: AroundControllerVector(residual, "pd"))
    one = AroundController(gym.make("FlexibleArm-v0"))
    with pytest.raises(RuntimeError, match="call reset first"):
        one.step(np.zeros(1))
    moving = vector("FlexibleArm-v0", task="track", duration=1.0)
    assert isinstance(AroundControllerVector(moving, "pd").controller, Following)
    refuses("around = .Following.: must be pd of an arm", lambda: linear_law(controller("pd", moving)))
    for each in (env, residual, moving, one):
        each.close()
