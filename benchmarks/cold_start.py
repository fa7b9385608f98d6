"""Measure processor time, memory and disk space from `python` to the first step, for every kind of arm.

    python -m benchmarks.cold_start [--repeats 3] [--only WORD]     writes the lines of docs/results/throughput.md

--only: cases whose names contain the word; the others keep their numbers.

Each case runs in a fresh process: first with an empty folder of compiled code, then with the compiled code that the
first process stored in the folder. The smallest of the repeated times counts. Processor time includes all threads and
child processes, from the start of the interpreter to the end of the first step (or derivative). The package is a copy
with bytecode, as an installer makes it, so that no compiled code beside it is found. The table also shows the time of a
fixed piece of plain Python in the same minutes, because a shared machine is slower at times. "A further kind" is the
memory, MB, that each additional kind of arm needs in a process that has already used one kind.
"""

import argparse
import compileall
import importlib.util
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

Work = Callable[[], Any]
"""Function that repeats the work of a case after its first run."""

ONE, TWO = "FlexibleArm-v0", "TwoLinkFlexArm-v0"
FLOATING, EXACT = {"formulation": "floating_frame"}, {"formulation": "geometrically_exact"}
MODES: dict[str, Any] = {"modes": 2, "segments": 1, **FLOATING}
RICH: dict[str, Any] = {
    "gravity": (0.0, 0.0), "task": "track", "info_level": "full", "action_mode": "residual_pd",
    "actuator": {"lag": 0.01, "delay": 0.04}, "initial_vibration": 0.02,
    "sensors": {"noise": 0.01, "delay": 0.04, "strain_gauges": [0.0, 0.5]},
    "randomization": {"payload": (0.5, 2.0), "EI": (0.7, 1.3), "damping": (0.5, 2.0), "torque_constant": (0.9, 1.1)},
}  # fmt: skip
"""Keywords that switch on all features together."""
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    ONE: (ONE, {}), TWO: (TWO, {}), "exact beam": (ONE, EXACT), "floating frame": (ONE, FLOATING),
    "floating frame, modes": (ONE, MODES), "gears and friction": (ONE, {"arm": "strip_geared"}),
    "all features": (ONE, RICH), "all features, exact beam": (ONE, RICH | EXACT),
    "all features, floating frame": (ONE, RICH | FLOATING), "in space": ("SpatialFlexArm-v0", {}),
}  # fmt: skip
SMOOTH = [name for name in KINDS if "features" not in name and "modes" not in name]
"""Kinds of arms whose derivatives are computed."""


def environment(n: int, env_id: str, keywords: dict[str, Any]) -> Work:
    """Take the first step of a single environment (n = 1) or of a vector; return a function that steps again."""
    import gymnasium as gym

    import flexarm_env  # noqa: F401  (registers the environments)

    env: Any = gym.make(env_id, **keywords) if n == 1 else gym.make_vec(env_id, num_envs=n, **keywords)
    env.reset(seed=0)
    env.action_space.seed(0)
    action = env.action_space.sample()
    env.step(action)
    return lambda: env.unwrapped.step(action)


def scene(name: str, formulation: str) -> Work:
    """Simulate the first 0.1 s of a scene; return a function that simulates them again."""
    from flexarm_env import scenes, simulate

    def work() -> Any:
        return simulate(scenes.named(name), formulation, duration=0.1, estimate_error=False)

    work()
    return work


def derivatives(back: bool, env_id: str, keywords: dict[str, Any]) -> Work:
    """Compute the Jacobians of a period, or (back) the gradient of its rewards; return a function that repeats this."""
    import numpy as np

    from flexarm_env.derivatives import Arms

    arms = Arms(env_id, 64, threads=1, **keywords)
    state, actions = arms.reset(seed=0), np.zeros((1, 64, arms.action_size))
    if back:
        run = arms.rollout(state, actions)
        work: Work = lambda: run.vjp(rewards=np.ones((1, 64)))  # noqa: E731
    else:
        work = lambda: arms.jacobians(state, actions[0])  # noqa: E731
    work()
    return work


def further() -> Iterator[Work]:
    """Yield functions that make further kinds of arms in one process."""
    for name, n in ((ONE, 1), (ONE, 64), (TWO, 1), ("exact beam", 64), ("floating frame", 64)):
        yield partial(environment, n, *KINDS[name])


FURTHER = "a further kind"
CASES: dict[str, Callable[[], Work]] = {
    f"{name}, {how}": partial(environment, n, *kind)
    for name, kind in KINDS.items()
    for how, n in (("single", 1), ("vector 64", 64))
}
for how, back in (("Jacobians", False), ("cotangents", True)):
    CASES |= {f"{how}, {name}": partial(derivatives, back, *KINDS[name]) for name in SMOOTH}
for formulation in ("elastica", "geometrically_exact", "floating_frame"):
    CASES[f"scene, {formulation}"] = partial(scene, "robot_arm_motion", formulation)
CASES["scene, two links, elastica"] = partial(scene, "two_link_motion", "elastica")


def _status(key: str) -> float:
    """Return VmHWM (peak memory) or VmRSS (present memory) of this process, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{key}:"))


def driver(name: str) -> dict[str, Any]:
    """Run a case in its own process; return processor time, s, and peak memory, MB.

    For the case "a further kind" return the additional memory, MB, of a process per additional kind of arm.
    """
    if name != FURTHER:
        CASES[name]()
        return {"cpu_s": sum(os.times()[:4]), "peak_mb": _status("VmHWM")}
    sizes = []
    for make in further():
        make()
        sizes.append(_status("VmRSS"))
    return {"grows_mb": [after - before for before, after in itertools.pairwise(sizes)]}


def _copied(room: Path) -> None:
    """Copy the package with its bytecode to a folder, as an installer would."""
    found = importlib.util.find_spec("flexarm_env")
    assert found is not None and found.origin is not None
    shutil.copytree(Path(found.origin).parent, room / "flexarm_env", ignore=shutil.ignore_patterns("__pycache__"))
    compileall.compile_dir(room / "flexarm_env", quiet=1)


def yardstick() -> float:
    """Return the processor time of a fixed piece of Python, s: the minimum of three runs."""
    times = []
    for _ in range(3):
        start = time.process_time()
        sum(k * k % 7 for k in range(2_000_000))
        times.append(time.process_time() - start)
    return min(times)


def measured(name: str, room: Path, repeats: int) -> dict[str, Any]:
    """Measure the first and the second start of a case, with an empty and with a filled cache."""
    cache = room / "cache"
    environment = os.environ | {"PYTHONPATH": str(room), "FLEXARM_CACHE_DIR": str(cache)}

    def started() -> dict[str, Any]:
        command = [sys.executable, "-P", str(Path(__file__)), "--run", name]
        done = subprocess.run(command, env=environment, cwd=room, check=True, stdout=subprocess.PIPE, text=True)
        told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return told

    first, second, size, pace = [], [], 0.0, [yardstick()]
    for _ in range(repeats):
        shutil.rmtree(cache, ignore_errors=True)
        cache.mkdir()
        first.append(started())
        pace.append(yardstick())
        size = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file()) / 2**20
        second += [started() for _ in range(3)] if name != FURTHER else [first[-1]]
    if name == FURTHER:
        return first[0]
    return {
        "cold_cpu_s": min(one["cpu_s"] for one in first), "peak_mb": min(one["peak_mb"] for one in first),
        "disk_mb": size, "warm_cpu_s": min(one["cpu_s"] for one in second),
        "warm_peak_mb": min(one["peak_mb"] for one in second), "yardstick_s": min(pace),
    }  # fmt: skip


COLUMNS = {
    "cold_cpu_s": "first start, CPU s", "peak_mb": "peak memory, MB",
    "disk_mb": "compiled code on disk, MB",
    "warm_cpu_s": "second start, CPU s", "warm_peak_mb": "peak memory of the second start, MB",
    "yardstick_s": "comparison program, s",
}  # fmt: skip


def blocks(found: dict[str, Any]) -> dict[str, list[str]]:
    """Format the table of the page."""
    from benchmarks.machine import table

    cases = found["cases"]
    rows = [[name, *(f"{row[key]:.2f}" for key in COLUMNS)] for name, row in cases.items() if name != FURTHER]
    *grows, last = (f"{one:.1f}" for one in cases[FURTHER]["grows_mb"])
    return {
        "table": table(f"environment or function | {' | '.join(COLUMNS.values())}", rows, numbers=True),
        "further": [
            "Further environments in the same process, each with another formulation or number of links, add "
            f"{', '.join(grows)} and {last} MB of memory."
        ],
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the requested cases one after the other."""
    kept = options.out / "cold_start.json"
    found = json.loads(kept.read_text("utf-8"))["cases"] if options.only else {}
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder).resolve()
        _copied(room)
        for name in [name for name in (*CASES, FURTHER) if options.only in name]:
            found[name] = measured(name, room, options.repeats)
            print(name, found[name], file=sys.stderr, flush=True)
    return {"cases": {name: found[name] for name in (*CASES, FURTHER)}}


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write the lines of the page; return the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["--run"]:
        print(json.dumps(driver(words[1])))
        return 0
    from benchmarks import pages  # not in a case's own process

    return pages.run("cold_start", __doc__, measure, blocks, arguments, page="results/throughput", repeats=3,
                     more={"only": {"default": ""}})  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
