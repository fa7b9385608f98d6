"""Reward terms of the user's own, as kernels by a keyword (`reward_terms`)."""

import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env.compiler import kernel, load, maximum
from flexarm_env.derivatives import Arms
from flexarm_env.envs.options import plan
from flexarm_env.envs.task import REACH, SLEW
from flexarm_env.physics.layout import POSE
from flexarm_env.tasks.program import TARGET
from tests.processes import python
from tests.refusals import says

assert flexarm_env


@kernel
def spin(lane, task, poses, action, record):  # type: ignore[no-untyped-def]
    """-(hub rate over its top rate)^2."""
    rate = load(lane, poses, POSE.rate) / task.rates[0]
    return -rate * rate


@kernel
def pull(lane, task, poses, action, record):  # type: ignore[no-untyped-def]
    """The first action times the first number of the target."""
    return load(lane, action, 0) * load(lane, record, TARGET)


@kernel
def wrong(lane, task, poses):  # type: ignore[no-untyped-def]
    return maximum(0.0, 1.0)


def parts(info: dict[str, Any]) -> dict[str, Any]:
    return {name.removeprefix("reward_"): value for name, value in info.items() if name.startswith("reward_")}


@pytest.mark.parametrize(
    ("env_id", "more"),
    [
        ("FlexibleArm-v0", {}),
        pytest.param(
            "TwoLinkFlexArm-v0", {"cost": {"deflection": 0.01}, "reward": {"cost": 0.3, "change": 0.1, "spin": 0.5}},
            marks=pytest.mark.slow,
        ),
        pytest.param("MultiLinkFlexArm-v0", {"reward": {"change": 0.1, "spin": 0.5}}, marks=pytest.mark.slow),
        pytest.param("FlexibleArm-v0", {"base": {"mass": 5.0, "inertia": 1.0}}, marks=pytest.mark.slow),
        pytest.param("SpatialFlexArm-v0", {"reward": {"spin": 0.5}}, marks=pytest.mark.slow),
    ],
)
def test_terms_are_paid_beside_the_task_s(env_id: str, more: dict[str, Any]) -> None:
    """Single and vector alike, named in info, weighted by `reward`; all other terms are what they are without."""
    if env_id.startswith("Spatial"):
        terms: dict[str, Any] = {"spin": pull}
    else:
        terms = {"spin": spin, "pull": pull}
    own = {name: value for name, value in more.items() if name != "reward"}
    usual = {name: value for name, value in more.get("reward", {}).items() if name != "spin"}
    plain: Any = gym.make(env_id, **own, reward=usual)
    env: Any = gym.make(env_id, reward_terms=terms, **more)
    many: Any = gym.make_vec(
        env_id, num_envs=9, vectorization_mode="vector_entry_point", reward_terms=terms, **more
    )
    seen = [one.reset(seed=4)[0] for one in (plain, env)]
    assert (seen[0] == seen[1]).all() and (many.reset(seed=4)[0][0] == seen[1]).all()
    n = env.action_space.shape[0]
    for k in range(20):
        action = np.linspace(0.9, -0.5, n, dtype=np.float32) * np.float32(np.cos(k))
        _, _, *_, bare = plain.step(action)
        observation, reward, *_, info = env.step(action)
        _, rewards, *_, infos = many.step(np.tile(action, (9, 1)))
        found = parts(info)
        assert reward == pytest.approx(sum(found.values()), abs=1e-12) and rewards[0] == reward
        assert all(found[name] == value for name, value in parts(bare).items())
        assert all(infos[f"reward_{name}"][0] == value for name, value in found.items())
        weight = more.get("reward", {}).get("spin", 1.0)
        asked = action[0] * np.ravel(info["target"])[0]
        if "pull" in found:
            assert found["pull"] == pytest.approx(asked, rel=1e-6)
            rate = observation[list(env.unwrapped.plan.names).index("hub_rate")]
            if "base" not in more:
                assert found["spin"] == pytest.approx(-weight * rate**2, rel=1e-5, abs=1e-12)
        else:
            assert found["spin"] == pytest.approx(weight * asked, rel=1e-6)
    assert list(parts(info))[-1] == "failure"


def test_weights_and_failure() -> None:
    """The usual weight is 1, in proportion to the control period; failure costs what such terms can take, 1 each."""
    made = plan(SLEW, reward_terms={"spin": spin}, control_dt=0.01)
    assert dict(zip(made.kind.rewards, made.record.weights, strict=True))["spin"] == 0.5
    assert made.record.weights[-1] == pytest.approx(400 * (0.5 + 0.005 + 0.01) + 50.0)
    assert type(made.record) is type(plan(SLEW, reward_terms={"swing": spin}).record)  # one program for one kernel


def test_derivatives_know_them() -> None:
    """By differences of the same rewards, forwards and backwards."""
    arms = Arms("FlexibleArm-v0", 3, reward_terms={"spin": spin, "pull": pull}, reward={"accuracy": 0.0, "settle": 0.0})
    state, rng = arms.reset(seed=0), np.random.default_rng(0)
    actions, way = rng.uniform(-0.5, 0.5, (6, 3, 1)), rng.uniform(-1.0, 1.0, (6, 3, 1))
    slope = arms.rollout(state, actions).vjp(rewards=np.ones((6, 3))).actions
    ahead, behind = (arms.rollout(state, actions + h * way).rewards.sum() for h in (1e-5, -1e-5))
    assert (slope * way).sum() == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def test_what_is_refused() -> None:
    says("reward_terms = 3: must be a table", lambda: plan(SLEW, reward_terms=3))
    says("reward_terms = 'effort': must be a name of its own", lambda: plan(SLEW, reward_terms={"effort": spin}))
    says("reward_terms = 'a b': must be a name of its own", lambda: plan(SLEW, reward_terms={"a b": spin}))
    wanted = "must be a kernel (flexarm_env.compiler.kernel) of (lane, task, poses, action, record)"
    says(wanted, lambda: plan(SLEW, reward_terms={"spin": wrong}))
    says(wanted, lambda: plan(REACH, reward_terms={"spin": abs}))
    unknown = {"spin": "nowhere:spin"}
    says("reward_terms.spin nowhere:spin: cannot be imported", lambda: plan(SLEW, reward_terms=unknown))
    says("reward.spin: ", lambda: plan(SLEW, reward={"spin": 1.0}))


def test_by_name_and_pickled() -> None:
    """ "module:name" for files of keywords; an environment that is pickled goes on alike."""
    name = f"{__name__}:spin"
    env: Any = gym.make("FlexibleArm-v0", reward_terms={"spin": name})
    env.reset(seed=0)
    again = pickle.loads(pickle.dumps(env))
    for _ in range(5):
        one, other = (copy.step(np.ones(1, np.float32)) for copy in (env, again))
        assert one[1] == other[1] and one[4]["reward_spin"] == other[4]["reward_spin"] < 0.0


_SCRIPT = """
import sys
import gymnasium as gym, numpy as np
import flexarm_env
sys.path.insert(0, sys.argv[1])
import own_term
env = gym.make("FlexibleArm-v0", reward_terms={"own": own_term.own})
env.reset(seed=0)
print(env.step(np.ones(1, np.float32))[4]["reward_own"])
"""


@pytest.mark.slow
def test_a_term_that_has_changed_is_compiled_anew(tmp_path: Path) -> None:
    """In another folder, and after an edit; what has not changed is loaded."""
    source = '''from flexarm_env.compiler import kernel, load
FACTOR = {factor}
@kernel
def own(lane, task, poses, action, record):
    return load(lane, action, 0) * FACTOR
'''
    for folder in "ab":
        (tmp_path / folder).mkdir()

    def out(folder: str, factor: float | None = None) -> tuple[str, str]:
        if factor is not None:
            (tmp_path / folder / "own_term.py").write_text(source.format(factor=factor))
        done = python("-c", _SCRIPT, str(tmp_path / folder), FLEXARM_CACHE_DIR=str(tmp_path / "cache"))
        return done.stdout.strip(), done.stderr

    assert out("a", 2.0)[0] == "2.0" and out("b", 50.0)[0] == "50.0" and out("a", 3.0)[0] == "3.0"
    printed, said = out("b")
    assert printed == "50.0" and "compiling" not in said
