"""Settings and fixtures that all tests share."""

import contextlib
import os
import random
import secrets
import sys
import time
from collections.abc import Iterator
from typing import Any

# No window, no sound, no display: set before anything imports pygame or matplotlib.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# Small matrices, and a process for each core: threads of the linear algebra would wait for each other most of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

_BEGUN = time.monotonic()


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """What Hypothesis draws: on a developer's machine the same in every run, in CI by a new seed, which is printed.

    Processes that share a run (xdist) have the first one's seed. The first call of a compiled function takes seconds,
    so no deadline.
    """
    if os.environ.get("CI") and config.option.hypothesis_seed is None:
        config.option.hypothesis_seed = getattr(config, "workerinput", {}).get("seed", secrets.randbits(32))
    settings.register_profile(
        "flexarm", deadline=None, derandomize=config.option.hypothesis_seed is None, database=None, print_blob=True,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )  # fmt: skip
    settings.load_profile("flexarm")


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a process that shares the run its seed."""
    node.workerinput["seed"] = node.config.option.hypothesis_seed


def pytest_addoption(parser: pytest.Parser) -> None:
    """How long a run may take, on a machine of unknown speed."""
    parser.addoption(
        "--within", type=float, metavar="SECONDS",
        help="files in an order that is drawn; tests that have not begun by then are left out, and counted",
    )  # fmt: skip


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Which files are left out, where time is short, is not the same in every run."""
    if config.option.within is not None:
        draw = random.Random(str(config.option.hypothesis_seed))
        ranks = {file: draw.random() for file in sorted({str(item.path) for item in items})}
        items.sort(key=lambda item: ranks[str(item.path)])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave a test out that comes too late."""
    within = item.config.option.within
    if within is not None and time.monotonic() - _BEGUN > within:
        pytest.skip(f"left out: {within:g} s are over (--within)")


def pytest_report_header(config: pytest.Config) -> str | None:
    """How to draw again what this run draws."""
    seed = config.option.hypothesis_seed
    return None if seed is None else f"hypothesis draws by --hypothesis-seed={seed}"


@pytest.fixture(scope="session", autouse=True)
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A program that several processes of a run (xdist) need is compiled by one of them, and read by the others."""
    if not os.environ.get("PYTEST_XDIST_WORKER") or sys.platform == "win32":
        yield
        return
    import fcntl

    from flexarm_env.compiler import objects

    folder, compiling = tmp_path_factory.getbasetemp().parent, contextlib.ExitStack()
    load, save = objects.load, objects.save

    def patient(key: Any) -> Any:
        compiling.close()  # what was refused is never saved
        found = load(key)
        if found is None:
            lock, until = compiling.enter_context((folder / f"{key.name}.lock").open("w")), time.monotonic() + 60.0
            while time.monotonic() < until:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                time.sleep(0.02)
            found = load(key)
        return found

    def saved(*items: Any) -> None:
        save(*items)
        compiling.close()

    objects.load, objects.save = patient, saved
    yield
    objects.load, objects.save = load, save


@pytest.fixture(scope="session")
def published() -> list[Any]:
    """All results of methods on the suite, as their files have them."""
    from benchmarks.machine import DOCS
    from flexarm_env.suite import results

    return results.folder_of(DOCS / "results" / "suite", earlier=True)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts alike in every test."""
    return np.random.default_rng(20240611)
