"""A Ray of the tests' own, started once."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from typing import Any

import pytest

from tests.processes import ROOT

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))


@pytest.fixture(scope="session", autouse=True)
def ray_folder() -> Iterator[str]:
    """Where Ray keeps its sockets: a short path, since the length of a socket's is limited."""
    folder = tempfile.mkdtemp(prefix="fr", dir="/tmp")
    os.environ["RAY_TMPDIR"] = folder
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def cluster(ray_folder: str) -> Iterator[Any]:
    """Ray with room for two runners and something beside them, whatever the machine has."""
    import ray

    ray.init(
        num_cpus=4, include_dashboard=False, object_store_memory=100_000_000, log_to_driver=False,
        logging_level="ERROR", _temp_dir=ray_folder,
    )  # fmt: skip
    yield ray
    ray.shutdown()
