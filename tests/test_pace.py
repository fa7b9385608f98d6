"""How many threads step a batch: chosen by the clock, never to its loss; quotas of containers; the end of threads."""

from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED, Pace, processors
from flexarm_env.compiler.pace import WORK, quota
from tests.processes import python


def seconds(pace: Pace, step: Callable[[int], float], steps: int) -> float:
    """How long so many steps take, in all, at the pace that is chosen; step: how long one takes on so many threads."""
    total = 0.0
    for _ in range(steps):
        took = step(pace.threads)
        total += took
        pace.took(took)
    return total


CASES: dict[str, Callable[[int], float]] = {
    "small steps": lambda n: 20e-6 if n == 1 else 300e-6,
    "256 arms where waking costs more than it saves": lambda n: 75e-6 if n == 1 else 256e-6,
    "another process on the second processor": lambda n: 75e-6 if n == 1 else 56e-6,
    "a quota that throttles": lambda n: 75e-6 if n == 1 else 0.1,
    "two processors": lambda n: 1e-3 / min(n, 2) + 1e-5 * n,
    "many": lambda n: 5e-3 / n + 1e-5 * n,
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("most", [2, 3, 16])
def test_the_default_never_loses_to_one_thread(name: str, most: int) -> None:
    step = CASES[name]
    pace, steps = Pace(most), 200_000
    seconds(pace, step, 100)  # the first trials
    taken = seconds(pace, step, steps) / steps
    assert taken <= 1.025 * step(1)
    best = min(step(n) for n in range(1, most + 1))
    if name == "many" or (name, most) == ("two processors", 2):
        assert pace.threads > 1 and taken <= 1.6 * best  # each thread has to be worth three quarters of a processor


def test_the_choice_follows_the_machine() -> None:
    """A second process comes, and goes again."""
    pace, free = Pace(2), lambda n: 1e-3 / n
    seconds(pace, free, 3000)
    assert pace.threads == 2
    shared = lambda n: 1e-3 if n == 1 else 1.2e-3  # noqa: E731
    taken = seconds(pace, shared, 20_000)
    assert taken < 1.05 * 20_000 * 1e-3
    seconds(pace, free, 60_000)
    assert pace.threads == 2
    assert Pace(2).threads == 1 and WORK > 0.0  # no thread before a step has shown that it is long enough


@pytest.mark.parametrize(
    ("groups", "files", "wanted"),
    [
        ("0::/a/b\n", {"a/b/cpu.max": "150000 100000\n", "cpu.max": "max 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/cpu.max": "50000 100000\n", "a/b/cpu.max": "max 100000\n"}, 0.5),
        ("0::/\n", {"cpu.max": "400000 100000\n"}, 4.0),
        ("4:cpu,cpuacct:/d\n1:name=systemd:/\n", {"cpu,cpuacct/d/cpu.cfs_quota_us": "250000\n",
                                                   "cpu,cpuacct/d/cpu.cfs_period_us": "100000\n"}, 2.5),
        ("4:cpu:/d\n", {"cpu/d/cpu.cfs_quota_us": "-1\n", "cpu/d/cpu.cfs_period_us": "100000\n"}, float("inf")),
        ("0::/gone\n", {"cpu.max": "nonsense"}, float("inf")),
        ("nonsense", {}, float("inf")),
    ],
)  # fmt: skip
def test_quotas_of_containers_are_read(groups: str, files: dict[str, str], wanted: float, tmp_path: Path) -> None:
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(groups)
    for name, text in files.items():
        path = tmp_path / "sys/fs/cgroup" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert quota(tmp_path) == wanted
    assert quota(tmp_path / "nowhere") == float("inf") and processors() >= 1


@pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")
def test_bits_do_not_depend_on_the_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of threads changes from step to step here."""
    monkeypatch.setattr("flexarm_env.compiler.pace.processors", lambda: 3)
    alone, paced = (gym.make_vec("FlexibleArm-v0", num_envs=64, threads=n) for n in (1, None))
    team = paced.unwrapped.batch._team
    assert team.most == 3
    rng, used = np.random.default_rng(0), set[int]()
    for env in (alone, paced):
        env.reset(seed=0)
    for k in range(60):
        team.pace.threads, team.pace._wait = 1 + k % 3, 1e9
        used.add(team.pace.threads)
        actions = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        (seen, reward, *_), (wanted, due, *_) = paced.step(actions), alone.step(actions)
        assert np.array_equal(seen, wanted) and np.array_equal(reward, due)
    assert used == {1, 2, 3}
    for env in (alone, paced):
        env.close()


LEFT = """
import gymnasium as gym
import numpy as np
import flexarm_env
from flexarm_env.compiler import crew
crew.ROUNDS = 10**9  # threads that look for work in compiled code, and do not come back by themselves
for _ in range(2):
    env = gym.make_vec("FlexibleArm-v0", num_envs=64, threads=3)
    env.reset(seed=0)
    env.step(np.zeros((64, 1), np.float32))
import atexit, threading
for thread in threading.enumerate():  # as the interpreter does before it calls the exit functions
    if not thread.daemon and thread is not threading.main_thread():
        thread.join()
atexit._run_exitfuncs()
print([t.name for t in threading.enumerate()])
"""


@pytest.mark.slow
@pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")
def test_no_thread_is_in_compiled_code_when_the_interpreter_ends() -> None:
    """It freed their machine code and arrays below them: a segmentation fault at exit, now and then."""
    assert python("-c", LEFT).stdout == "['MainThread']\n"
