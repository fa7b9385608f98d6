"""`flexarm serve` and `flexarm run`: simulate an arm in real time for UDP clients, and control an arm by a policy."""

import argparse
import contextlib
import math
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE, ENDED_EARLY
from flexarm_env.cli.export import environment
from flexarm_env.cli.play import KEYBOARD, choose, keywords
from flexarm_env.cli.progress import show
from flexarm_env.control import Setup
from flexarm_env.files import to_file
from flexarm_env.remote import Limits, Played, RemoteArmEnv, Server, Session, Wire, run_policy
from flexarm_env.remote.packet import SHORTEST

LONGEST = 4096
"""Largest size of a key file, bytes."""


def run(args: argparse.Namespace) -> int:
    """Run `flexarm serve` or `flexarm run`; return the exit code."""
    return _serve(args) if args.command == "serve" else _drive(args)


def key_of(path: str | None) -> bytes | None:
    """Read a shared key from a file that only the file's owner can read."""
    if path is None:
        return None
    file = Path(path)
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise check.InvalidValue("--key", path, f"must be a regular file with at least {SHORTEST} bytes")
    if os.name == "posix" and mode & 0o007:
        raise check.InvalidValue("--key", path, f"must not be readable or writable by everybody; run chmod 600 {path}")
    with file.open("rb") as opened:
        key = opened.read(LONGEST + 1).strip()
    if not SHORTEST <= len(key) <= LONGEST:
        raise check.InvalidValue("--key", path, f"must contain {SHORTEST} to {LONGEST} bytes")
    return key


@contextlib.contextmanager
def _until_terminated() -> Iterator[None]:
    """End the block on SIGTERM as on Ctrl-C, with a complete log. Only the main thread receives signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell(text: str) -> None:
    print(f"flexarm serve: {text}", file=sys.stderr, flush=True)


def _serve(args: argparse.Namespace) -> int:
    """Serve an arm until it is stopped, and print a summary."""
    rate = check.number("--rate", args.rate, "Hz", minimum=1.0, maximum=10_000.0)
    own = keywords(args.env_kwargs)
    if "control_dt" in own:
        raise check.InvalidValue("--env-kwargs control_dt", own["control_dt"], "must not be given: it is 1 / --rate")
    given = {"control_dt": 1.0 / rate, "duration": 1e6} | own
    angle, rate_limit, slew = (
        math.inf if value is None else check.number(f"--most-{word}", value, above=0.0)
        for word, value in (("angle", args.most_angle), ("rate", args.most_rate), ("change", args.most_change))
    )
    limits = Limits(angle, rate_limit, slew, args.watchdog)
    seconds = math.inf if args.seconds is None else check.number("--seconds", args.seconds, "s", above=0.0)
    session = Session(environment(args.what, given), limits, key_of(args.key), args.hold, args.seed)
    log = None if args.log is None else to_file("--log", args.log)
    server = Server(session, args.host, args.port, log, args.insecure, _tell)
    host, port = server.address
    if not args.json:
        print(f"serving {args.what} at {host}:{port}, {rate:g} Hz; Ctrl-C stops it. No safety system.", flush=True)
    try:
        with _until_terminated():
            server.serve(seconds)
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
    late, busy = 1e3 * np.diff(server.times or [(0.0, 0.0, 0.0)]).T
    values: dict[str, Any] = {"at": f"{host}:{port}", "periods": session.period, "missed": server.missed}
    values["packets"] = dict(session.counts)
    values |= {f"late_ms_{q:g}": float(np.percentile(late, q)) for q in (50, 99, 99.9, 100)}
    show(values | {"busy_ms_50": float(np.median(busy))} | ({"log": str(log)} if log else {}), args.json)
    return DONE


def _drive(args: argparse.Namespace) -> int:
    """Drive the arm by a policy and print a summary."""
    host, _, port = args.to.rpartition(":")
    if not host or not (port.isascii() and port.isdecimal() and 0 < int(port[:6]) < 65536 and len(port) < 6):
        raise check.InvalidValue("--to", args.to, "must be HOST:PORT with a port from 1 to 65535")
    most = [
        math.inf if value is None else check.number(f"--most-{word}", value, unit, above=0.0)
        for word, value, unit in (("angle", args.most_angle, "rad"), ("rate", args.most_rate, "rad/s"))
    ]
    seconds = None if args.seconds is None else check.number("--seconds", args.seconds, "s", above=0.0)
    name, policy_for = _policy(args)
    key = key_of(args.key)
    with contextlib.closing(Wire(host, int(port), key)) as wire:
        pass  # says what arm it is, and lets it go
    policy = policy_for(wire)  # a controller is designed here, while no watchdog waits for it
    with contextlib.closing(RemoteArmEnv(host, int(port), key)) as env:
        now = env.wire
        if now.period != wire.period or not all(
            np.array_equal(a, b) for a, b in ((now.limits, wire.limits), (now.scales, wire.scales))
        ):
            raise ConnectionError(f"{args.to}: the served arm has changed while the policy was prepared; try again")
        values = run_policy(policy, env, seconds or float(getattr(policy, "seconds", 10.0)), *most)
    show({"to": args.to, "policy": name} | values, args.json)
    return DONE if values["ended"] == "time" else ENDED_EARLY


def _policy(args: argparse.Namespace) -> tuple[str, Callable[[Wire], Any]]:
    """Return the policy's name, and a function that makes it for a connected arm."""
    if Path(args.policy).suffix.lower() == ".csv":
        return args.policy, lambda wire: Played(args.policy, wire.period, wire.limits)
    player = choose(args.policy, "POLICY")
    if player.kind == "function" or (player.policy is not None and not player.env_id and not args.env):
        return player.name, lambda wire: player.policy  # which says nothing of what it observes
    env_id = args.env or player.env_id
    if player.name == KEYBOARD or not env_id:
        raise check.InvalidValue("POLICY", args.policy, "must be a policy, or a controller together with --env")

    def made(wire: Wire) -> Any:
        """Make the policy for the connected arm, and call it once, so that everything is compiled."""
        kwargs = {**player.env_kwargs, **keywords(args.env_kwargs), "control_dt": wire.period}
        with contextlib.closing(gym.make(env_id, **kwargs)) as model:
            setup = Setup.of(model)
            scales = np.tile(np.array(setup.scales), setup.history)
            if scales.shape != wire.scales.shape or not np.allclose(scales, wire.scales):
                what = f"must have the observations and the control period of the arm at {args.to}"
                raise check.InvalidValue("POLICY", args.policy, what)
            policy = player.make(model)
            observation, _ = model.reset(seed=0)
            policy.reset(observation)
            policy.act(observation)  # what is imported, compiled and designed at the first action is there afterwards
            return policy

    return player.name, made
