"""The native vector environments: the single one, bit for bit, in any number, on any threads, across autoresets."""

import copy
import itertools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.env_tools import IDS, LIVELY, MULTI, RANDOM, assert_pair_same, assert_same, pair, rich
from tests.processes import python
from tests.refusals import refuses

MODES = ("NextStep", "SameStep", "Disabled")


@pytest.mark.parametrize(("env_id", "mode", "n"), [
    *itertools.product(IDS, MODES, (1, 7)), pytest.param(MULTI, "NextStep", 7, marks=pytest.mark.slow),
])  # fmt: skip
def test_vector_is_the_single_environment(env_id: str, mode: str, n: int) -> None:
    ended = assert_pair_same(pair(env_id, n, mode, duration=0.4, randomization=RANDOM), 50)
    assert ended >= 2 * n


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", MODES[:2])
def test_arms_in_lanes_on_one_and_two_threads(env_id: str, mode: str) -> None:
    """Three groups, the last not full, against single arms; and many groups on one thread and on two."""
    short: dict[str, Any] = {"max_episode_steps": 11, "randomization": RANDOM}
    assert assert_pair_same(pair(env_id, 20, mode, 2, **short), 25) >= 40
    many = tuple(gym.make_vec(env_id, num_envs=64, autoreset_mode=mode, threads=k, **short) for k in (1, 2))
    assert many[1].batch.threads == 2
    assert assert_pair_same(many, 25) >= 128


def test_a_reset_does_not_grow_with_the_square_of_the_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """After all of 16,000 had ended `reset` took 3 s; under `reset_mask` each arm had a compiled call of its own."""
    env: Any = gym.make_vec(IDS[0], num_envs=40, autoreset_mode="Disabled", max_episode_steps=1, threads=1)
    env.reset(seed=0)
    calls, start = list[int](), env.batch._start
    monkeypatch.setattr(env.batch, "_start", lambda *words: (calls.append(words[-1]), start(*words))[1])
    mask = np.arange(40) % 2 == 0
    for options in ({"reset_mask": mask}, {"reset_mask": mask, "start": [0.1], "target": 0.5}):
        env.step(np.zeros((40, 1), np.float32))
        assert len(env._ended) == 40
        env.reset(options=options)
        assert env._ended == np.flatnonzero(~mask).tolist()
        env.reset(options={"reset_mask": ~mask})
        assert not env._ended
    assert calls == [20] * 4
    same = [gym.make(IDS[0]) for _ in range(2)]
    for k, one in enumerate(same):
        one.reset(seed=7 + k, options={"start": [0.1], "target": 0.5})
    pair_of = gym.make_vec(IDS[0], num_envs=2)
    pair_of.reset(seed=7, options={"start": [0.1], "target": 0.5, "reset_mask": np.array([True, True])})
    for _ in range(5):
        action = np.full(1, 0.3, np.float32)
        rows = np.array([one.step(action)[0] for one in same])
        assert np.array_equal(pair_of.step(np.full((2, 1), 0.3, np.float32))[0], rows)


def test_views_are_made_once_and_what_is_kept_does_not_change() -> None:
    """Making a dozen views took half of a step of `make_vec(num_envs=1)`, which was a third as quick as one alone."""
    env: Any = gym.make_vec(IDS[0], num_envs=3)
    _, infos = env.reset(seed=0)
    made, kept = list[int](), list[tuple[Any, Any]]()

    def take(k: int) -> None:
        nonlocal infos
        _, _, _, _, infos = env.step(np.full((3, 1), 0.1 * k, np.float32))

    for k in range(6):
        take(k)
        made.append(id(infos["tip_position"]))
    assert len(set(made[2:])) == 2  # of two tables by turns
    for k in range(12):  # of each step something else: all of it, a view, a part of one, a part with another base
        take(k)
        values = infos["tip_position"]
        one = (infos, values, values[1:], values.T.reshape(2, 3)[0])[k % 4]
        kept.append((one, copy.deepcopy(one)))
        del values, one
    for one, wanted in kept:
        if isinstance(one, dict):
            assert all(np.array_equal(one[key], wanted[key]) for key in wanted)
        else:
            assert np.array_equal(one, wanted)


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "coulomb"), [(IDS[0], 0.0), *((k, 0.01) for k in (*IDS, MULTI))])
def test_with_everything_it_is_the_same_too(env_id: str, coulomb: float) -> None:
    actuator = LIVELY["actuator"] | {"coulomb": coulomb}
    lively = rich(env_id, **LIVELY | {"actuator": actuator}, gravity=(0.0, -9.81), duration=0.3, rules=1)
    assert assert_pair_same(pair(env_id, 9, "SameStep", **lively), 35) >= 18


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    "kwargs",
    [
        pytest.param({"formulation": "floating_frame", "segments": 2}, id="segments"),
        pytest.param({"formulation": "geometrically_exact"}, id="exact"),
        pytest.param({"formulation": "floating_frame", "modes": 2}, id="modes"),
        pytest.param({"formulation": "floating_frame", "frame": "root", "modes": 2}, id="clamped"),
        pytest.param({"action_mode": "residual_pd"}, id="residual"),
    ],
)
@pytest.mark.parametrize(("n", "threads"), [(7, 2), (1, 1), (64, 2)])
def test_every_formulation_is_the_same_too(env_id: str, kwargs: dict[str, Any], n: int, threads: int) -> None:
    both = pair(env_id, n, "NextStep", threads, duration=0.3, randomization=RANDOM, **kwargs)
    assert assert_pair_same(both, 35) >= n


def test_arms_end_at_different_times_and_the_bits_stay() -> None:
    """Elbows that run into their limit end episodes one by one."""
    both = pair("TwoLinkFlexArm-v0", 11, "NextStep")
    sync, native = both
    assert_same(sync.reset(seed=0), native.reset(seed=0))
    actions = np.stack([np.linspace(-1, 1, 11), np.linspace(1, -1, 11)], axis=1).astype(np.float32)
    lengths = set()
    for k in range(250):
        one, other = sync.step(actions), native.step(actions)
        assert_same(one, other, f"step {k}")
        if one[2].any():
            lengths.add(k)
    assert len(lengths) > 5


TWO_THREADS = """
import threading
import gymnasium as gym, numpy as np
import flexarm_env.batch

env = gym.make_vec("FlexibleArm-v0", num_envs=256, threads=2, duration=1e3)
env.reset(seed=0)
env.step(np.zeros((256, 1), np.float32))
begin, told, steps = threading.Barrier(2), [], [0, 0]

def work(k):
    begin.wait()
    for _ in range(600):
        try:
            env.step(np.zeros((256, 1), np.float32))
            steps[k] += 1
        except RuntimeError as error:
            told.append(str(error))

both = [threading.Thread(target=work, args=(k,)) for k in range(2)]
for thread in both:
    thread.start()
for thread in both:
    thread.join()
assert told and all("one thread at a time" in text for text in told), set(told)
assert sum(steps) + len(told) == 1200
env.step(np.zeros((256, 1), np.float32))
assert int(env.unwrapped.batch.record(0)[flexarm_env.batch.PERIODS]) == sum(steps) + 2
env.close()
print("done")
"""


def test_two_python_threads_in_one_environment_are_told() -> None:
    """They used to wait for each other for ever: the crew of threads inside serves one caller."""
    assert python("-c", TWO_THREADS, timeout=120).stdout == "done\n"


def test_seeds() -> None:
    one = gym.make_vec("FlexibleArm-v0", num_envs=4)
    first = one.reset(seed=7)[0]
    assert_same(first, one.reset(seed=7)[0])
    assert_same(first[1:], one.reset(seed=[8, 9, 10, 11])[0][:3])
    assert not np.array_equal(first, one.reset(seed=8)[0])
    assert not np.array_equal(one.reset()[0], one.reset()[0])
    assert one.np_random_seed == (8, 9, 10, 11)
    single = gym.make("FlexibleArm-v0")
    for i in range(4):
        assert_same(single.reset(seed=7 + i)[0], first[i])
    refuses("seed", lambda: one.reset(seed=[1, 2]))


def test_spaces_and_metadata() -> None:
    env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=3)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.observation_space.shape == (3, 14)
    assert env.action_space.shape == (3, 2)
    assert env.observation_space.contains(env.reset(seed=0)[0])
    assert env.spec is not None and env.spec.id == "TwoLinkFlexArm-v0"
    for mode in AutoresetMode:
        made = gym.make_vec("FlexibleArm-v0", num_envs=2, autoreset_mode=mode)
        assert made.metadata["autoreset_mode"] is mode


def test_next_step_ignores_the_action_after_the_end() -> None:
    env = gym.make_vec("FlexibleArm-v0", num_envs=2, max_episode_steps=3)
    env.reset(seed=0)
    for _ in range(3):
        *_, truncated, _ = env.step(np.ones((2, 1), np.float32))
    assert truncated.all()
    observation, reward, terminated, truncated, infos = env.step(np.full((2, 1), math.nan, np.float32))
    assert not terminated.any() and not truncated.any()
    assert np.all(reward == 0.0)
    assert np.all(observation[:, 2] == 0.0)
    assert np.all(infos["hub_torque"] == 0.0)


def test_disabled_resets_by_mask() -> None:
    env = gym.make_vec("FlexibleArm-v0", num_envs=4, max_episode_steps=3, autoreset_mode="Disabled")
    env.reset(seed=0)
    for _ in range(3):
        before = env.step(np.ones((4, 1), np.float32))[0]
    refuses("reset_mask", lambda: env.step(np.ones((4, 1), np.float32)), gym.error.ResetNeeded)
    mask = np.array([True, False, True, False])
    observation, infos = env.reset(seed=[5, None, 6, None], options={"reset_mask": mask})
    assert_same(observation[1], before[1])
    assert_same(infos["_target"], mask)
    single = gym.make("FlexibleArm-v0")
    assert_same(single.reset(seed=6)[0], observation[2])
    env.reset(options={"reset_mask": ~mask})
    env.step(np.ones((4, 1), np.float32))
    for wrong in (np.zeros(4, bool), np.ones(3, bool), [True] * 4, np.ones(4)):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": wrong})


@pytest.mark.parametrize("trouble", [math.nan, math.inf, -math.inf, "state"])
def test_an_arm_that_fails_leaves_its_neighbours_bits(trouble: Any) -> None:
    """By an action that is not finite, or by a state that is not."""
    one, other = (gym.make_vec("TwoLinkFlexArm-v0", num_envs=9) for _ in range(2))
    one.reset(seed=0)
    other.reset(seed=0)
    rng, keep = np.random.default_rng(0), np.arange(9) != 4
    for k in range(12):
        actions = rng.uniform(-1, 1, (9, 2)).astype(np.float32)
        spoiled = actions.copy()
        if k == 5 and trouble == "state":
            state = other.get_state([4])[0]
            state["arm"]["block"][len(other.batch.system.q0)] = math.nan  # the hub's rate
            other.set_state([state], [4])
        elif k == 5:
            spoiled[4, 1] = trouble
        good, result = one.step(actions), other.step(spoiled)
        for a, b in zip(good[:4], result[:4], strict=True):
            assert_same(a[keep], b[keep])
        if k == 5:
            assert result[2].tolist() == (~keep).tolist()
            reason = result[4]["termination_reason"][4]
            assert reason in (("newton_failed", "not_finite") if trouble == "state" else ("action_not_finite",))
            assert np.isfinite(result[0]).all() and np.isfinite(result[1]).all()


def test_steps_are_halved_in_a_lane_as_they_are_alone() -> None:
    """With few iterations allowed, Newton fails for some arms now and then: they are repeated alone."""
    kwargs = {"max_iterations": 2, "tolerance": 1e-10, "dt": 0.02, "duration": 2.0}
    both = pair("FlexibleArm-v0", 16, "NextStep", **kwargs)
    assert_pair_same(both, 60)
    assert both[1].batch.repeats, "no arm was repeated alone: the case tests nothing"


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_outcomes_stay_as_they_were(mode: AutoresetMode) -> None:
    """Numbers of info live in tables that go round: a table that somebody still looks at is left alone. The rest of an
    outcome is fresh in every step."""
    env = gym.make_vec("FlexibleArm-v0", num_envs=16, duration=0.1, autoreset_mode=mode, threads=2)
    held = []

    def hold(outcome: Any, *names: str) -> None:
        held.extend((x, x.copy()) for x in (*outcome[:-1], *(outcome[-1][name] for name in names)))

    hold(env.reset(seed=0), "tip_position", "target")
    for k in range(40):
        outcome = env.step(np.full((16, 1), 0.9 * (-1.0) ** k, np.float32))
        _, _, terminated, truncated, _ = outcome
        hold(outcome, *(("tip_position", "reward_effort") if k % 3 else ("is_success", "joint_torque")))
        if k % 5 == 4:
            states = env.unwrapped.get_state()
            env.unwrapped.set_state(states[::-1])
        if mode is AutoresetMode.DISABLED and (terminated | truncated).any():
            hold(env.reset(options={"reset_mask": terminated | truncated}), "target")
    for now, then in held:
        assert_same(now, then)


def test_render_gives_a_picture_of_each_arm() -> None:
    pytest.importorskip("pygame")
    env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=2, render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert isinstance(frames, tuple) and len(frames) == 2
    assert all(f.dtype == np.uint8 and f.ndim == 3 and f.shape[2] == 3 for f in frames)
    env.close()


def test_many_arms_in_one_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """With SDL's dummy driver in place of a display."""
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "a display")
    env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=5, render_mode="human", control_dt=0.001)
    env.reset(seed=0)
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert shown.shape == (3 * 320, 2 * 320, 3)
    tiles = [shown[320 * (i % 3) : 320 * (i % 3) + 320, 320 * (i // 3) : 320 * (i // 3) + 320] for i in range(6)]
    assert all(not np.array_equal(tiles[0], tile) for tile in tiles[1:])
    assert np.ptp(tiles[5]) < 10, "five arms: nothing in the last place"
    env.step(np.ones((5, 2), np.float32))
    assert not np.array_equal(shown, pygame.surfarray.array3d(pygame.display.get_surface()))
    env.close()
    assert not pygame.display.get_init()


def test_what_single_environments_have_is_there_for_each_arm() -> None:
    env = gym.make_vec("FlexibleArm-v0", num_envs=3)
    env.reset(seed=0)
    states = env.call("get_state")
    env.step(np.ones((3, 1), np.float32))
    env.call("set_state", [states[2]], indices=[1])
    assert_same(env.get_state([1])[0]["arm"], states[2]["arm"])
    env.call("set_state", states[0])
    assert all(np.array_equal(s["arm"]["block"], states[0]["arm"]["block"]) for s in env.get_state())
    assert [model.A.shape for model in env.call("linearize", indices=[0, 2])] == [(8, 8)] * 2
    assert env.call("dt") == (0.02,) * 3
    assert env.call("action_space", indices=[1])[0].shape == (1,)
    refuses("name", lambda: env.call("step"))
    with pytest.raises(AttributeError):
        env.call("nonesuch")


def test_nothing_is_stepped_before_a_reset() -> None:
    env = gym.make_vec("FlexibleArm-v0", num_envs=3)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((3, 1), np.float32))
    env.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((3, 1), np.float32))
    env.reset(seed=0, options={"reset_mask": np.array([False, True, False])})
    env.step(np.zeros((3, 1), np.float32))


def test_lanes_do_not_cross_cache_lines() -> None:
    for n in (3, 64, 1024):
        block = gym.make_vec("FlexibleArm-v0", num_envs=n).unwrapped.batch.block
        assert block.ctypes.data % 64 == 0 and block.strides[0] % 64 == 0


@pytest.mark.slow
@pytest.mark.parametrize("discrete", [0.02, None])
def test_all_arms_are_linearised_at_once(discrete: float | None) -> None:
    """As one by one, to round-off where steps are solved to it: of elasticas compiled, of others stacked. What a step
    leaves unsolved counts as well in an arm's own model, and not in those of all."""
    env = gym.make_vec(
        "TwoLinkFlexArm-v0", num_envs=9, vectorization_mode="vector_entry_point", tolerance=1e-12,
        randomization={"payload": (0.5, 1.5), "EI": (0.8, 1.2)},
    ).unwrapped  # fmt: skip
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(3):
        env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
    models = env.linearize(discrete=discrete)
    for i in (0, 8):
        model = env.linearize(i, discrete)
        for name in ("A", "B", "C", "D", "x", "u", "y", "rate"):
            wanted = getattr(model, name)
            assert np.abs(getattr(models, name)[i] - wanted).max() <= 1e-10 * max(1.0, np.abs(wanted).max()), name
        for name in ("states", "inputs", "outputs", "dt"):
            assert getattr(models, name) == getattr(model, name)
    env.close()
