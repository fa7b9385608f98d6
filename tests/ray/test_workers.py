"""Processes that Ray starts: registration, threads, the lock around compilation."""

import itertools
import multiprocessing
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.rllib.cluster import connect, one_at_a_time


def test_a_worker_that_never_imported_the_package_makes_the_environments(cluster: Any) -> None:
    @cluster.remote(num_cpus=1, max_calls=1)
    def make(env_id: str) -> tuple[bool, tuple[int, ...], float]:
        import sys

        import gymnasium as gym
        import numpy as np

        before = "flexarm_env" in sys.modules
        env = gym.make_vec(f"flexarm_env:{env_id}", num_envs=3, vectorization_mode="vector_entry_point")
        env.reset(seed=0)
        observation, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
        return before, observation.shape, float(observation.sum())

    for env_id, entries in (("FlexibleArm-v0", 6), ("TwoLinkFlexArm-v0", 14)):
        before, shape, total = cluster.get(make.remote(env_id))
        assert not before
        assert shape == (3, entries)
        assert np.isfinite(total)


def test_a_cluster_with_too_few_processors_is_told_in_a_sentence(cluster: Any) -> None:
    with pytest.raises(ValueError, match="5 processes with a processor each are asked for, Ray has 4 here"):
        connect(None, 5)


def hold(folder: Path, times: Any) -> None:
    with one_at_a_time("test", folder):
        begin = time.monotonic()
        time.sleep(0.3)
        times.put((begin, time.monotonic()))


def test_the_lock_lets_one_process_in_at_a_time(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    times = context.Queue()
    workers = [context.Process(target=hold, args=(tmp_path, times)) for _ in range(3)]
    for worker in workers:
        worker.start()
    spans = sorted(times.get(timeout=60) for _ in workers)
    for worker in workers:
        worker.join()
    assert all(earlier[1] <= later[0] for earlier, later in itertools.pairwise(spans))


def killed_while_holding(folder: Path, held: Any) -> None:
    with one_at_a_time("test", folder):
        held.set()
        time.sleep(600.0)


def test_the_lock_of_a_process_that_dies_is_free(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    held = context.Event()
    worker = context.Process(target=killed_while_holding, args=(tmp_path, held))
    worker.start()
    assert held.wait(60)
    worker.kill()
    worker.join()
    with one_at_a_time("test", tmp_path):
        pass
