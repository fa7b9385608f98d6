"""States gone back to, copies, pickles; other processes and threads."""

import copy
import multiprocessing
import pickle
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from tests.env_tools import IDS, LIVELY, RANDOM, assert_same, rich
from tests.processes import python
from tests.refusals import refuses


def actions(n: int, shape: tuple[int, ...], seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(-1, 1, shape).astype(np.float32) for _ in range(n)]


def steps(env: Any, moves: list[np.ndarray]) -> list[Any]:
    """Outcomes, with a reset where an episode ends."""
    outcomes = []
    for move in moves:
        outcomes.append(env.step(move))
        if isinstance(env.unwrapped, gym.Env) and (outcomes[-1][2] or outcomes[-1][3]):
            outcomes.append(env.reset())
    return outcomes


@pytest.mark.parametrize(
    ("env_id", "everything"),
    [*((env_id, False) for env_id in IDS), (IDS[0], True), pytest.param(IDS[1], True, marks=pytest.mark.slow)],
)
def test_a_restored_episode_continues_bit_for_bit(env_id: str, everything: bool) -> None:
    kwargs = rich(env_id, **LIVELY) if everything else {}
    env = gym.make(env_id, duration=0.5, **kwargs).unwrapped
    env.reset(seed=0)
    moves = actions(40, env.action_space.shape)
    steps(env, moves[:10])
    state = pickle.loads(pickle.dumps(env.get_state()))
    first = steps(env, moves)
    env.reset(seed=5)
    for _ in range(2):
        env.set_state(state)
        assert_same(first, steps(env, moves))
    twin = gym.make(env_id, duration=0.5, **kwargs).unwrapped
    twin.set_state(state)
    assert_same(first, steps(twin, moves))


def test_a_motion_episode_is_restored_too() -> None:
    env = gym.make("FlexibleArm-v0").unwrapped
    env.reset(seed=0, options={"motion": [[0.0, 0.0], [0.3, 0.5], [0.6, 0.1]], "interpolation": "linear"})
    moves = actions(15, (1,))
    steps(env, moves[:5])
    state = env.get_state()
    first = steps(env, moves)
    env.reset(seed=1)
    env.set_state(pickle.loads(pickle.dumps(state)))
    assert_same(first, steps(env, moves))


@pytest.mark.slow
def test_some_arms_of_a_vector_are_restored_with_all_that_they_remember() -> None:
    """Sensors' and motors' memories, streams, a motion half way; the other arms go on."""
    lively = LIVELY | {"duration": 0.5}
    env = gym.make_vec(IDS[0], num_envs=9, autoreset_mode="SameStep", **rich(IDS[0], **lively))
    motion = [[0.0, 0.0], [0.3, 0.5], [0.6, 0.1]]
    env.reset(seed=0, options={"motion": [motion if i == 4 else None for i in range(9)]})
    moves = actions(40, (9, 1))
    steps(env, moves[:8])
    chosen = [0, 4, 7]
    states = pickle.loads(pickle.dumps(env.get_state(chosen)))
    first = steps(env, moves)
    env.reset(seed=5)
    steps(env, moves[:3])
    env.set_state(states, chosen)
    again = steps(env, moves)
    for a, b in zip(first, again, strict=True):
        for x, y in zip(a[:4], b[:4], strict=True):
            assert_same(x[chosen], y[chosen])
        for key in ("tip_position", "hub_torque", "energy_dissipated", "target"):
            assert_same(a[4][key][chosen], b[4][key][chosen])


def test_the_state_of_an_arm_that_has_ended_begins_anew_where_ends_do() -> None:
    """In a vector of SameStep, where no arm is left ended; its step is then the reset's, as it is of NextStep."""
    single, still = gym.make("FlexibleArm-v0", duration=0.1).unwrapped, np.zeros((3, 1), np.float32)
    single.reset(seed=1)
    assert [single.step(still[0])[3] for _ in range(5)][-1]
    for mode in ("SameStep", "NextStep"):
        vector = gym.make_vec("FlexibleArm-v0", num_envs=3, autoreset_mode=mode, duration=0.1)
        vector.reset(seed=5)
        vector.set_state([single.get_state()], [1])
        found = steps(vector, [still] * 2)
        assert [rewards[1] == 0.0 for _, rewards, *_ in found] == [True, False]
        assert not any((terminated | truncated).any() for _, _, terminated, truncated, _ in found)


def test_states_pass_between_single_and_vector_environments() -> None:
    single = gym.make("TwoLinkFlexArm-v0").unwrapped
    vector = gym.make_vec("TwoLinkFlexArm-v0", num_envs=5)
    vector.reset(seed=0)
    moves = actions(20, (5, 2))
    steps(vector, moves)
    states = vector.get_state([1, 3])
    single.reset(seed=9)
    single.set_state(states[1])
    for move in moves[:5]:
        assert_same(vector.step(move)[0][3], single.step(move[3])[0])
    vector.set_state(states, [0, 4])
    vector.set_state(states, [1, 3])
    outcome = vector.step(np.broadcast_to(moves[0][:1], (5, 2)).copy())
    assert_same(outcome[0][0], outcome[0][1])
    assert_same(outcome[0][3], outcome[0][4])
    refuses("states", lambda: vector.set_state(states, [0]))
    refuses("indices", lambda: vector.get_state([7]))


def test_a_state_of_another_kind_is_refused() -> None:
    one, other = gym.make("FlexibleArm-v0").unwrapped, gym.make("TwoLinkFlexArm-v0").unwrapped
    one.reset(seed=0)
    other.reset(seed=0)
    before = one.get_state()
    wrongs: list[Any] = [other.get_state(), {"arm": 1}, None, before | {"arm": {}}, before | {"arm": {"block": 1}}]
    wrongs += [before | {"generator": 5}, before | {"guide": 5}, before | {"more": 5}, before | {"seed": "x"}]
    for wrong in wrongs:
        with pytest.raises(ValueError, match="state"):
            one.set_state(wrong)
    assert_same(before["arm"], one.get_state()["arm"])


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("block", np.nan, r"state\.arm\.block\[\d+\] = nan: must be one of 0, 1, 2, 3"),
        ("block", "x", r"state\.arm\.block = \['x'.*: must be numbers"),
        ("block", 1j, r"state\.arm\.block = .*: must be numbers"),
        ("observation", None, r"state\.arm\.observation = .*: must be numbers"),
        ("observation", np.inf, r"state\.arm\.observation\[0\] = inf: must be a finite number"),
        ("stream", -1, r"state\.arm\.stream = -1: must be a whole number"),
        ("stream", 2**80, r"state\.arm\.stream = 1208925819614629174706176: must be"),
        ("truncated", "no", r"state\.arm\.truncated = .*: must be True or False"),
    ],
)
def test_a_damaged_state_is_named_and_changes_nothing(name: str, wrong: Any, words: str) -> None:
    env: Any = gym.make("FlexibleArm-v0").unwrapped
    env.reset(seed=0)
    before = env.get_state()
    shape = np.shape(before["arm"][name])
    damaged = before | {"arm": before["arm"] | {name: np.full(shape, wrong) if shape else wrong}}
    refuses(words, lambda: env.set_state(damaged))
    assert_same(before["arm"], env.get_state()["arm"])


def test_what_sensors_remember_is_finite() -> None:
    """An observation was shown that was NaN, or infinite."""
    env: Any = gym.make("FlexibleArm-v0", **rich("FlexibleArm-v0", **LIVELY)).unwrapped
    env.reset(seed=0)
    before, layout = env.get_state(), env.batch.layout
    last = len(before["arm"]["block"]) - (layout.end - layout.action) - 1  # of the record: a sensor's
    for value in (np.nan, np.inf, 1e300):
        block = before["arm"]["block"].copy()
        block[last] = value
        damaged = before | {"arm": before["arm"] | {"block": block}}
        refuses(rf"state\.arm\.block\[{last}\] = .*: must be a finite number", partial(env.set_state, damaged))
    assert_same(before["arm"], env.get_state()["arm"])


def pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled], ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("env_id", IDS)
def test_copies_go_on_alike_and_apart(env_id: str, copied: Callable[[Any], Any]) -> None:
    for env in (gym.make(env_id, duration=0.3, randomization=RANDOM), gym.make_vec(env_id, num_envs=5, duration=0.3)):
        env.reset(seed=0)
        shape = env.action_space.shape
        steps(env, actions(5, shape))
        twin = copied(env)
        moves = actions(25, shape, seed=1)
        assert_same(steps(twin, moves), steps(env, moves))


def test_linear_model_at_the_present_state() -> None:
    """One control period of the linear model against the environment, for a small torque about a bent, moving state."""
    env = gym.make("FlexibleArm-v0", tolerance=1e-11).unwrapped
    env.reset(seed=0)
    for move in actions(20, (1,)):
        env.step(move)
    env.step(np.array([0.1], np.float32))
    model = env.linearize(discrete=env.dt)
    state = env.get_state()
    ends = []
    for torque in (0.1, 0.1 + 1e-3):
        env.set_state(state)
        env.step(np.array([torque], np.float32))
        ends.append(env.batch.motion(0))
    change = (ends[1][0] - ends[0][0]) / (np.float32(0.1 + 1e-3) - np.float32(0.1)) / 2.0
    np.testing.assert_allclose(model.B[: len(change), 0], change, rtol=2e-3, atol=1e-6)
    assert env.linearize().A.shape == (2 * len(change), 2 * len(change))
    lagging = gym.make("FlexibleArm-v0", actuator={"lag": 0.01}).unwrapped
    lagging.reset(seed=0)
    assert lagging.step(np.ones(1, np.float32))[-1]["joint_torque"] == lagging.batch.motion(0)[2]


# ---------------------------------------------------------------------------------------- processes and threads
def rollout(env: Any, n: int = 12) -> list[Any]:
    return [env.reset(seed=3), *steps(env, actions(n, env.action_space.shape))]


@pytest.mark.slow
@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_async_vector_environments(context: str) -> None:
    """The fork comes after the parent has stepped, its threads started."""
    parent = gym.make_vec("FlexibleArm-v0", num_envs=16, threads=2)
    rollout(parent)
    env = gym.make_vec(
        "flexarm_env:FlexibleArm-v0", num_envs=2, vectorization_mode="async", vector_kwargs={"context": context}
    )
    native = gym.make_vec("FlexibleArm-v0", num_envs=2)
    try:
        one, other = rollout(env), rollout(native)
        for a, b in zip(one, other, strict=True):
            assert_same(a[0], b[0])
    finally:
        env.close()
    rollout(parent)


def _in_child(queue: Any, env: Any) -> None:
    queue.put([np.asarray(o[0]) for o in rollout(env)])


def test_a_forked_child_steps_the_parent_s_environment_on_its_own_threads() -> None:
    env = gym.make_vec("FlexibleArm-v0", num_envs=64, threads=2)
    mine = [o[0] for o in rollout(env)]
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(queue, env))
    child.start()
    theirs = queue.get(timeout=120)
    child.join(timeout=60)
    assert child.exitcode == 0
    assert_same(mine, theirs)
    assert_same(mine, [o[0] for o in rollout(env)])


def test_one_single_environment_is_one_thread_s() -> None:
    """Four threads that stepped one were not rejected, and each saw parts of the others' steps."""
    env: Any = gym.make("FlexibleArm-v0", duration=1e6).unwrapped
    env.reset(seed=0)
    action, sentences, inside = np.zeros(1, np.float32), list[str](), threading.Barrier(2)
    step = env._step

    def slow(*words: int) -> Any:
        inside.wait(60)
        inside.wait(60)
        return step(*words)

    env._step = slow
    other = threading.Thread(target=env.step, args=(action,))
    other.start()
    inside.wait(60)
    for use in (lambda: env.step(action), env.reset, env.get_state, lambda: env.set_state({})):
        with pytest.raises(RuntimeError, match="another thread is at work in this environment: one environment serves"):
            use()
    inside.wait(60)
    other.join(60)
    env._step = step
    env.step(action)

    def broken(*words: int) -> Any:
        raise KeyboardInterrupt

    env._step = broken
    with pytest.raises(KeyboardInterrupt):
        env.step(action)
    env._step = step
    env.step(action)  # what was interrupted goes on
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)
    env.step(action)

    def work() -> None:
        try:
            for _ in range(20_000):
                env.step(action)
        except RuntimeError as error:
            sentences.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert all("another thread is at work" in one for one in sentences)
    env.step(action)


def test_two_threads_step_different_environments() -> None:
    envs = [gym.make_vec("FlexibleArm-v0", num_envs=64, threads=2) for _ in range(2)]
    alone = [o[0] for o in rollout(envs[0], 60)]
    results: list[Any] = [None, None]

    def work(k: int) -> None:
        results[k] = [o[0] for o in rollout(envs[k], 60)]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
        assert not thread.is_alive()
    for result in results:
        assert_same(alone, result)


def _make_one() -> Any:
    return gym.make("flexarm_env:FlexibleArm-v0")


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_subprocess_environments_of_stable_baselines(method: str) -> None:
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    env = vec_env.SubprocVecEnv([_make_one, _make_one], start_method=method)
    single = gym.make("FlexibleArm-v0")
    try:
        env.seed(3)
        first = env.reset()
        assert_same(single.reset(seed=3)[0], first[0])
        moves = actions(5, (2, 1))
        for move in moves:
            observation = env.step(move)[0]
            assert_same(single.step(move[0])[0], observation[0])
    finally:
        env.close()


def test_closing_ends_the_threads() -> None:
    others = set(threading.enumerate())
    env = gym.make_vec("FlexibleArm-v0", num_envs=64, threads=2)
    assert not set(threading.enumerate()) - others, "no thread before the first step"
    rollout(env)
    (own,) = (thread for thread in set(threading.enumerate()) - others if thread.name != "flexarm-compile")
    env.close()
    own.join(timeout=60.0)
    assert not own.is_alive()


@pytest.mark.parametrize("rounds", [1, 300])
def test_threads_that_fall_asleep_are_woken(rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each side sleeps at nearly every turn: no task is lost, none is done twice."""
    monkeypatch.setattr("flexarm_env.compiler.crew.ROUNDS", rounds)
    alone, env = (gym.make_vec("FlexibleArm-v0", num_envs=64, threads=n) for n in (1, 3))
    for a, b in zip(rollout(alone, 400), rollout(env, 400), strict=True):
        assert_same(a[0], b[0])
    env.close()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
@pytest.mark.parametrize("rounds", [1, 100_000])
def test_an_interrupted_step_leaves_nothing_behind(rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C at any moment: no thread still writes, and later steps wait for their own results."""
    monkeypatch.setattr("flexarm_env.compiler.crew.ROUNDS", rounds)
    env = gym.make_vec("FlexibleArm-v0", num_envs=64, threads=2)
    expected = [o[0] for o in rollout(env)]
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for delay in np.linspace(1e-4, 3e-3, 30):
            with pytest.raises(KeyboardInterrupt):
                signal.setitimer(signal.ITIMER_REAL, delay)
                while True:
                    env.step(np.zeros((64, 1), np.float32))
            state = env.batch.block.copy()
            time.sleep(1e-3)
            assert_same(state, env.batch.block)
            assert_same(expected, [o[0] for o in rollout(env)])
    finally:
        signal.signal(signal.SIGALRM, before)


def test_the_interpreter_ends_without_a_word() -> None:
    code = "import logging\nlogging.getLogger('flexarm_env').setLevel('ERROR')  # it may have to compile\n"
    code += "import gymnasium as gym, flexarm_env\nenv = gym.make_vec('FlexibleArm-v0', num_envs=64, threads=2)\n"
    code += "env.reset(seed=0)\nenv.step(env.action_space.sample())\nimport sys\nsys.modules['keep'] = env\n"
    done = python("-c", code)
    assert done.stdout + done.stderr == ""
