"""The other end: a wire to an arm that answers packets, an environment of it, and policies that drive it."""

import math
import os
import secrets
import time
from typing import Any

import gymnasium as gym
import numpy as np

from .. import validation as check
from ..files import csv_lines, listed, numbers
from ..validation import Array, Array32
from .packet import (
    ARM,
    HELD,
    LAST,
    OVER,
    RESET,
    SET_POINTS,
    Kind,
    Packet,
    Refusal,
    bound,
    checked,
    datagrams,
    pack,
    unpack,
)

PATIENCE = 3.0
"""s that an answer to a HELLO, or the first reading, is waited for."""
LONGEST, LEAST = 3600.0, 1e-8
"""s: the longest period that is believed; the least scale, by which every reading is a float32."""


class Wire:
    """A connection to an arm that answers the packets of `remote.packet`.

    Args:
        host, port: of the arm. key: shared with it. timeout: s that a reading is waited for; default: ten periods.
    Attributes:
        period: s. limits (N,): N m. scales (M,): of the readings. watchdog: periods. angles, rates, torques (N,),
            seen (M,), flags, status, time: of the last reading.
    Raises:
        ConnectionError: nobody answers, or somebody else is being served.
        OSError: there is no such host. ValueError: an argument that is none; a torque that is not finite.
    """

    def __init__(self, host: str, port: int, key: bytes | None = None, timeout: float | None = None) -> None:
        self.key, self.sequence, self._last = checked(key), 0, 0
        self.connection, self.lost = secrets.randbits(64), 0
        if timeout is not None:
            check.number("timeout", timeout, "s", above=0.0, maximum=LONGEST)
        with datagrams(host, port, 1) as self.socket:
            self.socket.connect((host, port))
            self._meet(f"{host}:{port}")
        n, period = len(self.limits), self.period
        self.timeout = 10.0 * period if timeout is None else timeout
        self.angles = self.rates = self.torques = np.zeros(n)
        self.seen, self.flags, self.status, self.time = np.zeros(len(self.scales)), HELD, 0.0, 0.0

    def _meet(self, where: str) -> None:
        welcome = self._hello(where)
        period, joints, entries, watchdog = welcome[:4]
        self.period = period
        self.watchdog, n = int(watchdog), int(joints)
        self.limits, self.scales = np.array(welcome[4 : 4 + n]), np.array(welcome[4 + n :])
        sizes = 0 < n == joints == len(self.limits) and len(self.scales) == entries and 0.0 < period <= LONGEST
        if not sizes or watchdog < 1.0 or not (self.limits > 0.0).all() or not (self.scales >= LEAST).all():
            raise ConnectionError(f"{where}: a welcome that does not say what its arm has")

    def _hello(self, where: str) -> tuple[float, ...]:
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends:
            self._put(Packet(Kind.HELLO, self.connection, 0))
            found = self._take(min(ends, time.monotonic() + 0.1), Kind.WELCOME)
            if found is not None and len(found.numbers) >= 4:
                self.connection, self._last = found.connection, found.sequence
                return found.numbers
        raise ConnectionError(f"{where}: no answer within {PATIENCE:g} s: nobody there, another key, or another's arm")

    def _put(self, packet: Packet) -> None:
        try:
            self.socket.send(pack(packet, self.key))
        except OSError as error:
            if packet.kind is not Kind.HELLO:
                raise ConnectionError(f"nothing can be sent: {error.strerror}") from None

    def _take(self, until: float, kind: Kind, wait: bool = True) -> Packet | None:
        """The next packet of a kind that comes before a time, or has come; others are left out."""
        while (left := until - time.monotonic()) > 0.0:
            self.socket.settimeout(left if wait else 0.0)  # the system waits for whole ms: none where none is meant
            try:
                found = unpack(self.socket.recv(2048), self.key)
            except OSError:  # nothing came, or nobody listens
                if not wait:
                    return None
                time.sleep(min(0.01, max(0.0, until - time.monotonic())))
                continue
            if isinstance(found, Refusal) or found.kind is not kind:
                continue
            if kind is Kind.READING and (found.connection != self.connection or found.sequence <= self._last):
                continue
            return found
        return None

    def numbers(self, name: str, given: Any) -> Array:
        """One for each joint. ValueError for what is none."""
        try:
            found = np.asarray(given, np.float64)
        except (TypeError, ValueError, OverflowError):
            found = np.array(np.nan)
        if found.shape != self.limits.shape or not np.isfinite(found).all():
            raise check.InvalidValue(name, given, f"must be {len(self.limits)} finite number(s)")
        return found

    def command(self, torques: Any, flags: int = 0) -> None:
        """Ask for torques (N,), N m, clipped to the limits; with `SET_POINTS` for angles, rad."""
        wanted = self.numbers("torques", torques)
        check.integer("flags", flags, minimum=0, maximum=255)
        if self.sequence >= LAST - 1:
            raise ConnectionError(f"{LAST} packets have been sent, all that a connection has: make another")
        self.sequence += 1
        asked = wanted if flags & SET_POINTS else np.clip(wanted, -self.limits, self.limits)
        self._put(Packet(Kind.COMMAND, self.connection, self.sequence, time.time(), tuple(asked.tolist()), flags))

    def read(self) -> bool:
        """Wait for the next reading, the newest of those that have come; whether there is one."""
        until, n, newest = time.monotonic() + self.timeout, len(self.limits), None
        while (found := self._take(until, Kind.READING, newest is None)) is not None:
            newest = found
            self.lost += newest.sequence - self._last - 1
            self._last = newest.sequence
        if newest is None:
            return False
        if len(newest.numbers) != 2 + 3 * n + len(self.scales):
            raise ConnectionError("a reading of another size than was said")
        self.status, values, self.flags = newest.numbers[1], np.array(newest.numbers[2:]), newest.flags
        self.angles, self.rates, self.torques = values[:n], values[n : 2 * n], values[2 * n : 3 * n]
        self.seen, self.time = values[3 * n :], newest.time
        return True

    def close(self) -> None:
        """Say goodbye, which holds the arm."""
        self.sequence += 1
        try:
            self._put(Packet(Kind.BYE, self.connection, self.sequence))
        except ConnectionError:
            pass
        self.socket.close()


class RemoteArmEnv(gym.Env[Array32, Array32]):
    """`gymnasium.make("RemoteArm-v0", host=..., port=...)`: the arm, real or simulated, that answers there.

    Action (N,): torques over their limits, within +-1. Observation (M,): what its sensors read over their scales, as
    the environment that it was made from has it. The arm does not know a task: rewards are 0. A step asks, and waits
    for the next reading. An episode is truncated where none comes, or the arm is held (by its watchdog or a limit),
    and ends where it has stopped; `info["reason"]` says it. A reset arms it, and asks for a new start, which a
    simulated arm makes and a real one may not.

    Args:
        host, port: of `flexarm serve`, or whatever speaks its packets. key: shared with it.
    """

    metadata = {"render_modes": []}  # noqa: RUF012
    render_mode = None

    def __init__(self, host: str = "127.0.0.1", port: int = 7070, key: bytes | None = None) -> None:
        self.wire = Wire(host, port, key)
        joints, entries = len(self.wire.limits), len(self.wire.scales)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (joints,), np.float32)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (entries,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Arm it, ask for a new start, and wait for the first reading."""
        super().reset(seed=seed)
        if options:
            raise check.InvalidValue("options", options, "must be left out: a remote arm has none")
        return self.arm(RESET)

    def arm(self, flags: int = 0) -> tuple[Array32, dict[str, Any]]:
        """Arm it where it is (or with `RESET`), and wait for the first reading."""
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends:
            self.wire.command(np.zeros(len(self.wire.limits)), ARM | flags)
            if self.wire.read() and not self.wire.flags & HELD:
                return self._observation(), self._info("")
        raise ConnectionError(f"the arm cannot be armed within {PATIENCE:g} s")

    def step(self, action: Any) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Ask for torques and wait for what comes of them."""
        self.wire.command(np.clip(self.wire.numbers("action", action), -1.0, 1.0) * self.wire.limits)
        came = self.wire.read()
        over = bool(self.wire.flags & OVER)
        held = bool(self.wire.flags & HELD) and not over
        reason = "no_reading" if not came else "stopped" if over else "held" if held else ""
        return self._observation(), 0.0, over, held or not came, self._info(reason)

    def _observation(self) -> Array32:
        found: Array32 = (self.wire.seen / self.wire.scales).astype(np.float32)
        return found

    def _info(self, reason: str) -> dict[str, Any]:
        wire = self.wire
        return {
            "reason": reason, "angles": wire.angles.copy(), "rates": wire.rates.copy(), "torques": wire.torques.copy(),
            "time": wire.time, "lost": wire.lost,
        }  # fmt: skip

    def close(self) -> None:
        """Let the arm go."""
        self.wire.close()


class Played:
    """Torques from a file as a policy: a row a period, then none.

    Args:
        path: CSV with the columns t (s, evenly spaced) and torque0, ... (N m). period: s, and limits (N,): N m, of the
            arm that is to be driven.
    Raises:
        ValueError: a file of other columns, of another period, or with a torque beyond the limits.
    """

    def __init__(self, path: str | os.PathLike[str], period: float, limits: Array) -> None:
        header, lines = csv_lines(path)
        names = ["t", *(f"torque{k}" for k in range(len(limits)))]
        if set(header) != set(names):
            raise check.InvalidValue(os.fspath(path), listed(header), f"must have the columns {', '.join(names)}")
        with check.under(f"{os.fspath(path)}: rows"):
            t, *torques = (numbers(header.index(name), name, lines, len(header)) for name in names)
        self.torques, self.limits = np.stack(torques, axis=1), limits
        if len(t) < 2 or not np.allclose(np.diff(t), period, rtol=0.0, atol=1e-6 * period + 1e-9):
            raise check.InvalidValue(f"{os.fspath(path)}: t", t[:3], f"must be evenly spaced by the arm's {period:g} s")
        if not (np.abs(self.torques) <= limits).all():
            raise check.InvalidValue(os.fspath(path), self.torques, f"must be finite torques within {limits} N m")
        self.seconds = len(t) * period

    def reset(self, observation: Any) -> None:
        """Begin anew."""
        self._next = 0

    def act(self, observation: Any) -> Array:
        """The next row, over the limits."""
        row = self.torques[self._next] if self._next < len(self.torques) else np.zeros(len(self.limits))
        self._next += 1
        found: Array = row / self.limits
        return found


def run_policy(
    policy: Any, env: RemoteArmEnv, seconds: float, most_angle: float = math.inf, most_rate: float = math.inf
) -> dict[str, Any]:
    """Drive an arm by a policy (`reset(observation)`, `act(observation)`, or a function of observations) for so long;
    what came of it.

    A policy that thinks for longer than the watchdog bears before its first action finds the arm held, and arms it.

    most_angle: rad, most_rate: rad/s; where a joint is beyond it, it ends there, and closing the environment holds the
    arm.
    """
    for name, value in (("seconds", seconds), ("most_angle", most_angle), ("most_rate", most_rate)):
        bound(name, value)
    observation, info = env.reset()
    began = time.monotonic()
    act = getattr(policy, "act", policy)
    getattr(policy, "reset", lambda seen: None)(observation)
    if time.monotonic() - began > env.wire.watchdog * env.wire.period:
        observation, info = env.arm()
    start, steps, reason = info["time"], 0, ""
    while max(info["time"] - start, steps * env.wire.period) < seconds and not reason:  # an arm's clock may stand still
        observation, _, _, _, info = env.step(act(observation))
        steps, reason = steps + 1, info["reason"]
        if np.abs(info["angles"]).max() > most_angle:
            reason = reason or "angle"
        if np.abs(info["rates"]).max() > most_rate:
            reason = reason or "rate"
    return {"steps": steps, "seconds": info["time"] - start, "lost": info["lost"], "ended": reason or "time"}
