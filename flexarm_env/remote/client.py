"""Client of a remote arm: the connection (`Wire`), a Gymnasium environment, and a function that runs a policy."""

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
    EXPIRED,
    HELD,
    LAST,
    NO_COOKIE,
    OVER,
    RESET,
    SET_POINTS,
    VERSION,
    Kind,
    Packet,
    Refusal,
    bound,
    checked,
    datagrams,
    pack,
    unpack,
    version_of,
)

PATIENCE = 3.0
"""Time (s) that the client waits for the answer to a HELLO, or for the first reading."""
WATCHDOG = "watchdog expired"
REASONS = ("no_reading", "stopped", "held", WATCHDOG)
"""Reasons for the end of an episode. "no_reading": no reading arrived in time. "stopped": the arm has stopped. "held":
a limit holds the arm. WATCHDOG: the server's watchdog holds the arm, because commands were late.
"""
TRIES = 3
LONGEST, LEAST = 3600.0, 1e-8
"""LONGEST: longest control period that a client accepts, s. LEAST: smallest accepted scale of a reading, so that every
reading divided by its scale is a finite float32.
"""


class Wire:
    """UDP connection to the server of an arm; `remote.packet` defines the packets.

    Args:
        host, port: address of the server. key: shared secret for signatures, or None for unsigned packets. timeout:
            longest wait for a reading, s; None for ten control periods.
    Attributes:
        period: control period, s. limits (N,): torque limits, N m. scales (M,): numbers by which the environment
            divides the sensor readings. watchdog: number of periods without a command after which the server holds the
            arm. lost: number of READING packets that never arrived. angles, rates, torques (N,): joint angles (rad),
            joint rates (rad/s) and torques (N m) in the last READING packet. seen (M,): sensor readings, SI units, in
            the last READING packet. flags, status, time: flags, status and time (s) in the last READING packet.
    Raises:
        ConnectionError: the server does not answer, or it serves another client.
        OSError: the host does not exist. ValueError: an argument is invalid, or a torque is not finite.
    """

    def __init__(self, host: str, port: int, key: bytes | None = None, timeout: float | None = None) -> None:
        """Connect to an arm's server by HELLO and challenge.

        key: shared secret of at least 16 bytes, or None for unsigned packets. timeout: longest wait for a reading, s;
            None for ten periods.

        Raises:
            ConnectionError: no server answers. ValueError: the key, the port or the timeout is invalid.
        """
        self.key, self.sequence, self._last = checked(key), 0, 0
        self.connection, self.lost = secrets.randbits(64), 0
        if timeout is not None:
            check.number("timeout", timeout, "s", above=0.0, maximum=LONGEST)
        # a connected socket accepts datagrams from this server alone
        with datagrams(host, port, 1) as self.socket:
            self.socket.connect((host, port))
            self._meet(f"{host}:{port}")
        # until the first reading arrives, the arm counts as held
        n, period = len(self.limits), self.period
        self.timeout = 10.0 * period if timeout is None else timeout
        self.angles = self.rates = self.torques = np.zeros(n)
        self.seen, self.flags, self.status, self.time = np.zeros(len(self.scales)), HELD, 0.0, 0.0

    def _meet(self, where: str) -> None:
        """Connect to the server `where`, and store period, watchdog, limits and scales from its WELCOME.

        Raises:
            ConnectionError: the numbers of the WELCOME are inconsistent.
        """
        welcome = self._hello(where)
        period, joints, entries, watchdog = welcome[:4]
        self.period = period
        self.watchdog, n = int(watchdog), int(joints)
        self.limits, self.scales = np.array(welcome[4 : 4 + n]), np.array(welcome[4 + n :])
        # the counts are floats of a foreign sender: compare them with the lengths before use
        sizes = 0 < n == joints == len(self.limits) and len(self.scales) == entries and 0.0 < period <= LONGEST
        if not sizes or watchdog < 1.0 or not (self.limits > 0.0).all() or not (self.scales >= LEAST).all():
            raise ConnectionError(f"{where}: an invalid WELCOME packet")

    def _hello(self, where: str) -> tuple[float, ...]:
        """Send HELLO, send back the cookie of the CHALLENGE, and return the numbers of the WELCOME.

        Packets are repeated every 0.1 s for `PATIENCE` seconds, since datagrams may be lost.
        """
        ends, cookie, tries = time.monotonic() + PATIENCE, NO_COOKIE, 0
        while time.monotonic() < ends:
            self._put(Packet(Kind.HELLO, self.connection, 0, 0.0, cookie))
            found = self._take(min(ends, time.monotonic() + 0.1), Kind.WELCOME, Kind.CHALLENGE, Kind.OTHER_VERSION)
            if found is None:
                tries += 1
                # the cookie may have expired: request a new one
                cookie = cookie if tries % 5 else NO_COOKIE
            elif found.kind is Kind.OTHER_VERSION:
                what = f"speaks version {found.sequence} of the packets, and this is version {VERSION}"
                raise ConnectionError(f"{where}: {what}: install the same version of flexarm_env at both ends")
            elif found.kind is Kind.CHALLENGE:
                if found.connection == self.connection and len(found.numbers) == 2:
                    cookie = found.numbers[0], found.numbers[1]
            # WELCOME: the server's random connection number replaces the client's own
            elif len(found.numbers) >= 4:
                self.connection, self._last = found.connection, found.sequence
                return found.numbers
        what = "no server, another key, a server with another client, or an earlier version of flexarm_env"
        raise ConnectionError(f"{where}: no answer within {PATIENCE:g} s: {what}")

    def _put(self, packet: Packet) -> None:
        """Send a packet. Raises ConnectionError if the operating system rejects the packet, except for a HELLO, which
        is repeated.
        """
        try:
            self.socket.send(pack(packet, self.key))
        except OSError as error:
            if packet.kind is not Kind.HELLO:
                raise ConnectionError(f"nothing can be sent: {error.strerror}") from None

    def _take(self, until: float, *kinds: Kind, wait: bool = True) -> Packet | None:
        """Return the next packet of the given kinds that arrives before `until` (monotonic clock, s), or None.

        All other packets are dropped, as are readings of another connection or out of order. wait: if False, only
        packets that have already arrived are considered. A packet of another protocol version is returned as kind
        OTHER_VERSION, with that version in place of the sequence number.
        """
        while (left := until - time.monotonic()) > 0.0:
            # a wait is rounded up to whole ms, hence 0 for none
            self.socket.settimeout(left if wait else 0.0)
            try:
                content = self.socket.recv(2048)
            except OSError:
                # timed out, or the port is closed
                if not wait:
                    return None
                time.sleep(min(0.01, max(0.0, until - time.monotonic())))
                continue
            found = unpack(content, self.key)
            if found is Refusal.VERSION:
                found = Packet(Kind.OTHER_VERSION, 0, version_of(content)[0])
            elif isinstance(found, Packet) and found.kind is Kind.OTHER_VERSION:
                # carries no information in this version
                continue
            if isinstance(found, Refusal) or found.kind not in kinds:
                continue
            # a reading of another connection, or not newer than the last one
            if found.kind is Kind.READING and (found.connection != self.connection or found.sequence <= self._last):
                continue
            return found
        return None

    def numbers(self, name: str, value: Any) -> Array:
        """Convert `value` to an array (N,) with one finite number per joint.

        Raises ValueError if the conversion is impossible; the error message begins with `name`.
        """
        try:
            found = np.asarray(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            found = np.array(np.nan)
        if found.shape != self.limits.shape or not np.isfinite(found).all():
            raise check.InvalidValue(name, value, f"must be {len(self.limits)} finite number(s)")
        return found

    def command(self, torques: Any, flags: int = 0) -> None:
        """Send a command packet with torques or joint angles.

        Args:
            torques (N,): joint torques, N m, which are clipped to the limits; with the flag `SET_POINTS` joint angles,
                rad. flags: sum of the flags `ARM`, `SET_POINTS` and `RESET` of `remote.packet`.
        Raises:
            ConnectionError: all sequence numbers are used, or the operating system cannot send the packet.
        """
        wanted = self.numbers("torques", torques)
        check.integer("flags", flags, minimum=0, maximum=255)
        if self.sequence >= LAST - 1:
            raise ConnectionError(f"{LAST} packets have been sent, all that a connection has: make another")
        self.sequence += 1
        asked = wanted if flags & SET_POINTS else np.clip(wanted, -self.limits, self.limits)
        self._put(Packet(Kind.COMMAND, self.connection, self.sequence, time.time(), tuple(asked.tolist()), flags))

    def read(self) -> bool:
        """Wait for a reading, and store the newest reading in the attributes; return whether a reading arrived.

        Raises:
            ConnectionError: the size of a READING packet differs from the size in the WELCOME packet.
        """
        # wait for one reading, then empty the queue without waiting; gaps in the numbers count as lost
        until, n, newest = time.monotonic() + self.timeout, len(self.limits), None
        while (found := self._take(until, Kind.READING, wait=newest is None)) is not None:
            newest = found
            self.lost += newest.sequence - self._last - 1
            self._last = newest.sequence
        if newest is None:
            return False
        if len(newest.numbers) != 2 + 3 * n + len(self.scales):
            raise ConnectionError("a READING packet of unexpected size")
        # numbers[0] is the last accepted command; status; then angles, rates, torques (N each) and the sensors (M)
        self.status, values, self.flags = newest.numbers[1], np.array(newest.numbers[2:]), newest.flags
        self.angles, self.rates, self.torques = values[:n], values[n : 2 * n], values[2 * n : 3 * n]
        self.seen, self.time = values[3 * n :], newest.time
        return True

    def close(self) -> None:
        """Tell the server that the connection ends (packet BYE) and close the socket; the server then holds the arm."""
        self.sequence += 1
        try:
            self._put(Packet(Kind.BYE, self.connection, self.sequence))
        except ConnectionError:
            pass
        self.socket.close()


class RemoteArmEnv(gym.Env[Array32, Array32]):
    """Environment of a remote arm, real or simulated: `gymnasium.make("RemoteArm-v0", host=..., port=...)`.

    Action (N,): joint torques divided by their limits, within +-1. Observation (M,): sensor readings divided by their
    scales, as in the environment that the server runs. The remote arm has no task: rewards are 0. `step` sends the
    torques and waits for the next reading. An episode is truncated if no reading arrives, or if the server holds the
    arm because a limit was exceeded or commands were missing. An episode is terminated if the arm reports a failure.
    `info["reason"]` is then one of `REASONS`. `reset` ends the hold of the arm and requests a new start of the episode.
    A simulated arm starts again from an initial state; a real arm may ignore the request.

    Args:
        host, port: address of `flexarm serve`, or of any other server with the same packets. key: shared secret, or
            None for unsigned packets.
    """

    metadata = {"render_modes": []}  # noqa: RUF012
    render_mode = None

    def __init__(self, host: str = "127.0.0.1", port: int = 7070, key: bytes | None = None) -> None:
        """Connect to the server; action and observation spaces follow from its answer."""
        self._address = host, port, key
        self.wire = Wire(host, port, key)
        joints, entries = len(self.wire.limits), len(self.wire.scales)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (joints,), np.float32)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (entries,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """End the hold of the arm, request a new start of the episode, and return the first observation and info.

        The argument `options` must be None or empty.
        """
        super().reset(seed=seed)
        if options:
            raise check.InvalidValue("options", options, "must be left out: a remote arm has none")
        return self.arm(RESET)

    def arm(self, flags: int = 0) -> tuple[Array32, dict[str, Any]]:
        """End the hold of the arm with zero torques; return the first observation and info.

        flags: flags of the command; `RESET` requests a new start of the arm.

        If the server has closed this connection after a long silence, the client connects again.

        Raises:
            ConnectionError: the arm is still held after `PATIENCE` seconds.
        """
        ends, silent = time.monotonic() + PATIENCE, 0
        while time.monotonic() < ends:
            self.wire.command(np.zeros(len(self.wire.limits)), ARM | flags)
            if not self.wire.read():
                silent += 1
                # two timeouts without a reading: the server has dropped this peer
                if silent == 2:
                    self._connect_again()
            elif not self.wire.flags & HELD:
                return self._observation(), self._info("")
        raise ConnectionError(f"the arm cannot be armed within {PATIENCE:g} s")

    def _connect_again(self) -> None:
        """Connect again to the same address. Raises ConnectionError if another arm is served there."""
        before = self.wire
        before.close()
        self.wire = Wire(*self._address)
        self.wire.lost = before.lost
        if self.wire.limits.shape != before.limits.shape or self.wire.scales.shape != before.scales.shape:
            raise ConnectionError(f"{self._address[0]}:{self._address[1]}: another arm is served there now")

    def step(self, action: Any) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Send the torques `action` (N,) times the torque limits, and wait for the next reading.

        Returns observation, reward (0), terminated, truncated and info.
        """
        self.wire.command(np.clip(self.wire.numbers("action", action), -1.0, 1.0) * self.wire.limits)
        came = self.wire.read()
        # reason in order of precedence: no reading, stopped, watchdog expired, held by a limit
        over = bool(self.wire.flags & OVER)
        held = bool(self.wire.flags & HELD) and not over
        why = WATCHDOG if self.wire.flags & EXPIRED else "held"
        reason = "no_reading" if not came else "stopped" if over else why if held else ""
        return self._observation(), 0.0, over, held or not came, self._info(reason)

    def _observation(self) -> Array32:
        """Return the last reading of the sensors divided by their scales, (M,) float32."""
        found: Array32 = (self.wire.seen / self.wire.scales).astype(np.float32)
        return found

    def _info(self, reason: str) -> dict[str, Any]:
        """Return the info dict: reason, angles (rad), rates (rad/s), torques (N m), time (s), lost (readings)."""
        wire = self.wire
        return {
            "reason": reason, "angles": wire.angles.copy(), "rates": wire.rates.copy(), "torques": wire.torques.copy(),
            "time": wire.time, "lost": wire.lost,
        }  # fmt: skip

    def close(self) -> None:
        """Close the connection; the server then holds the arm."""
        self.wire.close()


class Played:
    """Policy that applies one row of torques from a CSV file per control period, and zero torque after the last row.

    Args:
        path: CSV file with evenly spaced times, s, in column t and torques, N m, in the columns torque0, torque1 and so
            on. period: control period of the arm, s. limits (N,): torque limits of the arm, N m.
    Attributes:
        seconds: duration of the file, s.
    Raises:
        ValueError: the columns are wrong, the time between two rows differs from `period`, or a torque exceeds the
            limits.
    """

    def __init__(self, path: str | os.PathLike[str], period: float, limits: Array) -> None:
        """Read torques (N m) from a CSV file with columns t, torque0, ...

        period: the arm's control period, s, which must be the spacing of t. limits (N,): largest torques, N m.
        """
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
        """Return to the first row of the file at the start of an episode."""
        self._next = 0

    def act(self, observation: Any) -> Array:
        """Return the next row divided by the torque limits, (N,); after the last row, zeros."""
        row = self.torques[self._next] if self._next < len(self.torques) else np.zeros(len(self.limits))
        self._next += 1
        found: Array = row / self.limits
        return found


def run_policy(
    policy: Any, env: RemoteArmEnv, seconds: float, most_angle: float = math.inf, most_rate: float = math.inf
) -> dict[str, Any]:
    """Control a remote arm by a policy for `seconds`, and return a summary.

    The first action may take longer than the server's watchdog waits, for example because the policy designs a
    controller. The server then holds the arm; this function ends the hold and calls the policy again, at most `TRIES`
    times. The server holds the arm again when the environment is closed.

    Args:
        policy: object with `reset(observation)` and `act(observation)`, or a function of observations.
        most_angle, most_rate: limits of every joint's angle, rad, and rate, rad/s; a joint beyond a limit ends the run.
    Returns:
        Dict with the number of steps, the duration in seconds, the number of lost readings ("lost"), and the reason for
        the end ("ended"): "time", "angle", "rate" or one of `REASONS`.
    """
    for name, value in (("seconds", seconds), ("most_angle", most_angle), ("most_rate", most_rate)):
        bound(name, value)
    observation, info = env.reset()
    act = getattr(policy, "act", policy)
    # first action: slow policies expire the watchdog, so arm again and repeat
    for _ in range(TRIES):
        began = time.monotonic()
        getattr(policy, "reset", lambda seen: None)(observation)
        action = act(observation)
        if time.monotonic() - began <= env.wire.watchdog * env.wire.period:
            break
        observation, info = env.arm()
    start, steps, reason = info["time"], 0, ""
    while True:
        observation, _, _, _, info = env.step(action)
        steps, reason = steps + 1, info["reason"]
        if np.abs(info["angles"]).max() > most_angle:
            reason = reason or "angle"
        if np.abs(info["rates"]).max() > most_rate:
            reason = reason or "rate"
        # the arm's clock may stop: count periods as well
        if reason or max(info["time"] - start, steps * env.wire.period) >= seconds:
            break
        action = act(observation)
    return {"steps": steps, "seconds": info["time"] - start, "lost": info["lost"], "ended": reason or "time"}
