"""Start Ray on this machine or join a cluster; a lock lets one process of a node compile while the others wait."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MISSING = (
    "Ray cannot be imported here ({error}): make setup-ray sets up .venv-ray with it, "
    'or pip install -c constraints-ray.txt "flexarm_env[ray]"'
)
MEMORY = 500_000_000
"""Size of Ray's object store, bytes, if Ray is started on this machine; rollouts are small."""


def need_ray() -> Any:
    """Import and return the module `ray`. Raises ValueError with instructions if Ray or RLlib is missing."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        import ray.rllib
    except ImportError as error:
        raise ValueError(MISSING.format(error=error)) from error
    return ray


def connect(address: str | None, processes: int, verbose: bool = False) -> Any:
    """Start Ray on this machine, or join the cluster at `address`; return the module `ray`.

    Raises ValueError if there is no cluster at the address, or if the cluster has fewer processors than `processes`.
    """
    import logging

    ray = need_ray()
    if not ray.is_initialized():
        own = address is None and not os.environ.get("RAY_ADDRESS")
        level = logging.INFO if verbose else logging.ERROR
        options: dict[str, Any] = {"log_to_driver": verbose, "logging_level": level}
        if own:
            options |= {"include_dashboard": False, "object_store_memory": MEMORY}
        try:
            ray.init(address=address, **options)
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise ValueError(
                f"--address {address}: no Ray cluster there ({reason}); it is begun by ray start --head; where it "
                "requires a token, set RAY_AUTH_MODE=token and the head's token here, too"
            ) from error
        for name in ("ray", "ray.rllib", "ray.tune"):
            logging.getLogger(name).setLevel(level)
    there = int(ray.cluster_resources().get("CPU", 0))
    if processes > there:
        raise ValueError(
            f"runners and learners: {processes} processes with a processor each are asked for, Ray has {there} here"
        )
    return ray


@contextlib.contextmanager
def one_at_a_time(name: str = "compile", folder: Path | None = None) -> Iterator[None]:
    """Hold a lock that all processes of a user on a node share; the system releases the lock when its holder ends.

    The lock surrounds the first use of an environment: the first process compiles and writes the cache, then the others
    load the compiled code. On systems without such locks (Windows) no process waits.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    user = os.getuid()
    path = (folder or Path(tempfile.gettempdir())) / f"flexarm-{user}-{name}.lock"
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
