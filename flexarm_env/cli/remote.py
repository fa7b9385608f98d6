"""`flexarm serve` and `flexarm run`: an arm that answers packets in real time, and a policy that drives one."""

import argparse
import contextlib
import math
import os
import signal
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.export import environment
from flexarm_env.cli.play import KEYBOARD, choose, keywords
from flexarm_env.cli.progress import show
from flexarm_env.control import Setup
from flexarm_env.files import to_file
from flexarm_env.remote import Limits, Played, RemoteArmEnv, Server, Session, run_policy
from flexarm_env.remote.packet import SHORTEST
from flexarm_env.suite.policies import function_named

LONGEST = 4096
"""Bytes of a key."""


def run(args: argparse.Namespace) -> int:
    """Serve, or drive."""
    return _serve(args) if args.command == "serve" else _drive(args)


def key_of(path: str | None) -> bytes | None:
    """A shared key from a file that is nobody else's."""
    if path is None:
        return None
    file = Path(path)
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise check.InvalidValue("--key", path, f"must be a file of {SHORTEST} bytes or more")
    if os.name == "posix" and mode & 0o007:
        raise check.InvalidValue("--key", path, f"must be no file that everybody can read or write: chmod 600 {path}")
    with file.open("rb") as opened:
        key = opened.read(LONGEST + 1).strip()
    if not SHORTEST <= len(key) <= LONGEST:
        raise check.InvalidValue("--key", path, f"must hold from {SHORTEST} to {LONGEST} bytes")
    return key


@contextlib.contextmanager
def _until_terminated() -> Iterator[None]:
    """SIGTERM ends it as Ctrl-C does, with the log whole; in the main thread, where alone signals arrive."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _serve(args: argparse.Namespace) -> int:
    """Serve an arm until it is stopped, and say what came of it."""
    rate = check.number("--rate", args.rate, "Hz", minimum=1.0, maximum=10_000.0)
    own = keywords(args.env_kwargs)
    if "control_dt" in own:
        raise check.InvalidValue("--env-kwargs control_dt", own["control_dt"], "must be left out: it is 1 / --rate")
    given = {"control_dt": 1.0 / rate, "duration": 1e6} | own
    angle, rate_limit, slew = (
        math.inf if value is None else check.number(f"--most-{word}", value, above=0.0)
        for word, value in (("angle", args.most_angle), ("rate", args.most_rate), ("change", args.most_change))
    )
    limits = Limits(angle, rate_limit, slew, args.watchdog)
    seconds = math.inf if args.seconds is None else check.number("--seconds", args.seconds, "s", above=0.0)
    session = Session(environment(args.what, given), limits, key_of(args.key), args.hold, args.seed)
    log = None if args.log is None else to_file("--log", args.log)
    server = Server(session, args.host, args.port, log, args.insecure)
    host, port = server.address
    if not args.json:
        print(f"serving {args.what} at {host}:{port}, {rate:g} Hz; Ctrl-C ends it. No safety system.", flush=True)
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
    """Drive the arm and say what came of it."""
    host, _, port = args.to.rpartition(":")
    if not host or not (port.isascii() and port.isdecimal() and 0 < int(port[:6]) < 65536 and len(port) < 6):
        raise check.InvalidValue("--to", args.to, "must be HOST:PORT, a port from 1 to 65535")
    most = [
        math.inf if value is None else check.number(f"--most-{word}", value, unit, above=0.0)
        for word, value, unit in (("angle", args.most_angle, "rad"), ("rate", args.most_rate, "rad/s"))
    ]
    seconds = None if args.seconds is None else check.number("--seconds", args.seconds, "s", above=0.0)
    name, policy_for = _policy(args)
    with contextlib.closing(RemoteArmEnv(host, int(port), key_of(args.key))) as env:
        policy = policy_for(env)
        values = run_policy(policy, env, seconds or float(getattr(policy, "seconds", 10.0)), *most)
    show({"to": args.to, "policy": name} | values, args.json)
    return DONE


def _policy(args: argparse.Namespace) -> tuple[str, Callable[[RemoteArmEnv], Any]]:
    """What it is called, and how to make it for an arm at the other end of the wire."""
    if ":" in args.policy and not Path(args.policy).exists():
        own = function_named(args.policy, "POLICY")
        return args.policy, lambda env: own
    if Path(args.policy).suffix.lower() == ".csv":
        return args.policy, lambda env: Played(args.policy, env.wire.period, env.wire.limits)
    player = choose(args.policy)
    env_id = args.env or player.env_id
    if player.name == KEYBOARD or not env_id:
        raise check.InvalidValue("POLICY", args.policy, "must be a policy, or a controller with --env for its model")

    def made(env: RemoteArmEnv) -> Any:
        kwargs = {**player.env_kwargs, **keywords(args.env_kwargs), "control_dt": env.wire.period}
        with contextlib.closing(gym.make(env_id, **kwargs)) as model:
            setup = Setup.of(model)
            scales = np.tile(np.array(setup.scales), setup.history)
            if scales.shape != env.wire.scales.shape or not np.allclose(scales, env.wire.scales):
                what = f"must be of an environment that observes what the arm at {args.to} reads, and as often"
                raise check.InvalidValue("POLICY", args.policy, what)
            return player.make(model)

    return player.name, made
