"""Measure how punctually a served arm keeps its control periods: docs/results/real_time.md.

python -m benchmarks.real_time [--periods N] [--page] [--out FOLDER]

One process serves the arm, and another drives it by PD over loopback, each on its own core. The script takes about half
an hour.
"""

import argparse
import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from benchmarks.pages import Found
from flexarm_env import control
from flexarm_env.remote import Kind, Limits, Packet, RemoteArmEnv, Server, Session, pack, unpack
from flexarm_env.remote.packet import ARM

RATES = (100, 500, 1000)
BESIDE: dict[str, tuple[bool, bool, tuple[int, ...]]] = {
    "nothing": (False, False, RATES),
    "a busy process on each core": (True, False, RATES),
    "the same, served and driven with `chrt -f 10`": (True, True, (1000,)),
}
"""Load beside the served arm: whether the cores are busy, whether server and peer have real-time priority, and rates,
Hz."""
SHARES = (50.0, 99.0, 99.9, 100.0)
FIRST = 10
"""Priority under the first-in-first-out scheduler."""
ARMS: dict[str, tuple[str, dict[str, Any]]] = {
    f"{count}, {word}": (env_id, {"formulation": formulation})
    for count, env_id in (("one link", "FlexibleArm-v0"), ("two links", "TwoLinkFlexArm-v0"))
    for word, formulation in (("elastica", "elastica"), ("exact beam", "geometrically_exact"),
                              ("floating frame", "floating_frame"))
} | {"three joints in space, exact beam": ("SpatialFlexArm-v0", {})}  # fmt: skip
MEASURED = 3000
"""Number of periods for the measurement of the arm's own CPU time."""


def arm_of(env_id: str, rate: float, **kwargs: Any) -> Any:
    """Make the environment of an arm as `flexarm serve` does."""
    return gym.make(env_id, control_dt=1.0 / rate, duration=1e6, disable_env_checker=True, **kwargs)


def alone_on(core: int, first: bool) -> None:
    """Bind this process to one core. first: with first-in-first-out real-time priority."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[core]})
    if first:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIRST))


def may_go_first() -> bool:
    """Return whether this user may run processes with real-time priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIRST))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except (AttributeError, PermissionError):
        return False
    return True


def serve(rate: float, first: bool, wire: Connection) -> None:
    """Serve an arm in its own process until terminated; send its address first and its measured times at the end."""
    session = Session(arm_of("FlexibleArm-v0", rate), Limits(watchdog=int(rate)), seed=0)
    server = Server(session)
    alone_on(0, first)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    wire.send(server.address)
    before = time.process_time()
    with contextlib.suppress(KeyboardInterrupt):
        server.serve()
    spent = time.process_time() - before
    wire.send((np.array(server.times), session.period, spent))
    server.close()


@contextlib.contextmanager
def busy(wanted: bool) -> Iterator[None]:
    """Keep each core busy with an endless process while the context lasts."""
    cores = sorted(os.sched_getaffinity(0))[:2] if wanted else []
    beside = [subprocess.Popen([sys.executable, "-c", f"import os\nos.sched_setaffinity(0, {{{c}}})\nwhile True: pass"])
              for c in cores]  # fmt: skip
    try:
        yield
    finally:
        for one in beside:
            one.send_signal(signal.SIGKILL)
            one.wait()


def drive(rate: float, periods: int, first: bool, address: tuple[str, int], wire: Connection) -> None:
    """Drive the served arm by PD in the peer's process; send the arrival times of the readings."""
    alone_on(1, first)
    env = RemoteArmEnv(*address)
    policy = control.make("pd", arm_of("FlexibleArm-v0", rate))
    observation, _ = env.reset()
    policy.reset(observation)
    had, of = np.empty(periods), np.empty(periods)
    before = time.process_time()
    for k in range(periods):
        observation, *_, info = env.step(policy.act(observation))
        had[k], of[k] = time.monotonic(), info["time"]
    wire.send((had, of, info["lost"], time.process_time() - before))
    env.close()


def kept(rate: int, periods: int, first: bool) -> Found:
    """Measure how punctual a server and its peer are; return delays in ms and lost packets."""
    context = multiprocessing.get_context("spawn")
    (here, there), (mine, theirs) = context.Pipe(), context.Pipe()
    arm = context.Process(target=serve, args=(rate, first, there))
    arm.start()
    peer = context.Process(target=drive, args=(rate, periods, first, here.recv(), theirs))
    peer.start()
    had, of, lost, peer_spent = mine.recv()
    arm.terminate()
    times, stepped, spent = here.recv()
    for process in (arm, peer):
        process.join()
    due, begun, _ = times.T
    place = np.rint(of * rate).astype(int) - 1 - (stepped - len(times))  # a reading's period among those kept
    known, driven = place >= 0, (due > had[0]) & (due < had[-1])
    missed = int(np.rint(np.diff(due[driven]) * rate).sum()) - driven.sum() + 1
    late, latency, off = (begun - due)[driven], had[known] - due[place[known]], np.abs(np.diff(had) - 1.0 / rate)
    told = {"late": late, "latency": latency, "off": off}
    return {
        "rate": rate, "periods": periods, "took": float(had[-1] - had[0]), "missed": int(missed), "lost": int(lost),
        **{key: np.percentile(1e3 * value, SHARES).tolist() for key, value in told.items()},
        "server_us": 1e6 * spent / stepped, "peer_us": 1e6 * peer_spent / periods,
    }  # fmt: skip


def share(env_id: str, rate: int, kwargs: Found) -> list[list[float]]:
    """Return median and largest time, µs, of a control period: of the arm's step, and of serving it with its
    packets."""
    env = arm_of(env_id, rate, **kwargs)
    plain, limits, spent = env.unwrapped, np.array(env.unwrapped.plan.arm.torque_limits), np.empty((MEASURED, 2))
    session = Session(arm_of(env_id, rate, **kwargs), seed=0)
    welcome = unpack(session.receive(pack(Packet(Kind.HELLO, 1, 0)), 1) or b"")
    plain.reset(seed=0)
    for k in range(MEASURED):
        share = np.full(len(limits), 0.3 * np.sin(6.0 * k / rate), np.float32)
        at = time.perf_counter()
        _, _, ended, *_ = plain.step(share)
        spent[k, 1] = time.perf_counter()
        if ended:
            plain.reset(seed=k)
        assert isinstance(welcome, Packet)
        wanted = tuple((limits * share).tolist())
        command = pack(Packet(Kind.COMMAND, welcome.connection, k + 1, 0.0, wanted, ARM))
        between = time.perf_counter()
        session.receive(command, 1)
        session.advance()
        spent[k] = spent[k, 1] - at, time.perf_counter() - between
    return (1e6 * np.percentile(spent, (50.0, 100.0), axis=0)).T.tolist()  # type: ignore[no-any-return]


def measure(options: argparse.Namespace) -> Found:
    """Measure the punctuality of served arms, and the CPU time of each arm."""
    found: Found = {"load": os.getloadavg()[0], "kept": [], "arms": []}
    for name, (env_id, kwargs) in ARMS.items():
        found["arms"].append({"arm": name, "us": [share(env_id, rate, kwargs) for rate in RATES]})
        print(found["arms"][-1], flush=True)
    for beside, (load, first, rates) in BESIDE.items():
        for rate in rates:
            if first and not may_go_first():
                one: Found = {"rate": rate, "refused": True}
            else:
                with busy(load):
                    one = kept(rate, options.periods, first)
            found["kept"].append({"beside": beside} | one)
            print(found["kept"][-1], flush=True)
    found["load_after"] = os.getloadavg()[0]
    return found


def blocks(found: Found) -> pages.Blocks:
    """Format the tables of the page."""
    rows = []
    for one in found["kept"]:
        if "refused" in one:
            rows.append((one["beside"], one["rate"], "not permitted here", *[""] * 7))
            continue
        told = (" / ".join(f"{x:.3g}" for x in one[key]) for key in ("late", "latency", "off"))
        rows.append((
            one["beside"], one["rate"], f"{one['periods']:,}", f"{one['took']:.1f}", *told, one["missed"], one["lost"],
            f"{one['server_us']:.0f}, {one['peer_us']:.0f}",
        ))  # fmt: skip
    arms = []
    for one in found["arms"]:
        for what, of in zip(("arm", "served"), zip(*one["us"], strict=True), strict=True):
            cells = (f"{us:.3g} ({worst:.3g}): {us * r / 1e4:.2g} %" for r, (us, worst) in zip(RATES, of, strict=True))
            arms.append((one["arm"], what, *cells))
    heads = (
        "other load | rate, Hz | periods | duration, s | start delay, ms | latency, ms | interval error, ms | "
        "missed | lost | CPU per period, µs"
    )
    quiet = found["load"] < 0.5
    load = f"The load average was {found['load']:.1f} before the first run, {found['load_after']:.1f} after the last."
    return {
        "kept": table(heads, rows),
        "arms": table(f"arm | measured time | {' | '.join(f'{r} Hz' for r in RATES)}", arms),
        "load": [load + ("" if quiet else " **The machine was not quiet**: other work was on the same cores.")],
    }


if __name__ == "__main__":
    sys.exit(pages.run("real_time", __doc__, measure, blocks, periods=100_000))
