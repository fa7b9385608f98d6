"""An arm that is stepped at a rate and answers packets: the server's session, without a socket, and its loop with one.

It is no safety system.
"""

import csv
import math
import secrets
import select
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .. import validation as check
from ..control import make as controller
from ..control.base import Setup
from ..control.pd import PD, SpatialPD
from .packet import (
    ARM,
    HELD,
    LAST,
    LIMITED,
    MOST_NUMBERS,
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

Address = tuple[str, int]
LOOPBACK = ("127.0.0.1", "localhost", "::1")
TIMED_OUT = 5.0
"""Status of an arm whose episode is at its end in time, as the solver's words are numbered."""


@dataclass(frozen=True)
class Limits:
    """What no command gets past. angle (rad) and rate (rad/s): of every joint; beyond, the arm is held. slew: largest
    change of a torque in a period, as a share of its limit. watchdog: periods without a command until it is held."""

    angle: float = math.inf
    rate: float = math.inf
    slew: float = math.inf
    watchdog: int = 5

    def __post_init__(self) -> None:
        for name in ("angle", "rate", "slew"):
            bound(name, getattr(self, name))
        check.integer("watchdog", self.watchdog, minimum=1, maximum=LAST)


@dataclass
class Session:
    """What a served arm makes of packets and of periods; no socket and no clock.

    Args:
        env: single, of this package, with torques for actions. key: shared with the peer; None: nothing is signed.
        hold: what the watchdog does, "zero" torque or "angles" held by PD.
    Attributes:
        row: of the last period: time and readings as it began, and the torques that acted in it. counts: of packets,
            by `Refusal`, "accepted", "busy" and "missing" (gaps in the peer's sequence numbers).
        held: whether the watchdog, or a limit, holds the arm, until a command with `ARM`. reason: why.
    """

    env: Any
    limits: Limits = field(default_factory=Limits)
    key: bytes | None = field(default=None, repr=False)
    hold: str = "zero"
    seed: int | None = None

    def __post_init__(self) -> None:
        plan = getattr(getattr(self.env, "unwrapped", None), "plan", None)
        if plan is None or plan.action_mode != "torque" or plan.arm.base is not None:
            what = "must be a single environment of this package, action_mode 'torque', its root held"
            raise ValueError(f"env = {self.env}: {what}")
        check.instance("limits", self.limits, Limits)
        checked(self.key)
        if self.seed is not None:
            check.integer("seed", self.seed, minimum=0)
        if self.hold not in ("zero", "angles"):
            raise check.InvalidValue("hold", self.hold, "must be 'zero' or 'angles'")
        self.setup, self.plain = Setup.of(self.env), self.env.unwrapped
        self.torque_limits = np.array(plan.arm.torque_limits)
        self.scales = np.tile(np.array(self.setup.scales), self.setup.history)
        pd = controller("pd", self.env)
        assert isinstance(pd, PD | SpatialPD)
        self._pd = pd
        self.counts: Counter[str] = Counter()
        self.connection, self.last, self.sent, self.period, self._hello = 0, 0, 0, 0, 0
        self.peer: Any = None
        self.silent, self.held, self.reason = 0, True, "not armed"
        self._asked: Packet | None = None
        self.torque = np.zeros(len(self.torque_limits))
        if 2 + 3 * len(self.torque) + len(self.scales) > MOST_NUMBERS:
            raise ValueError(f"observation of {len(self.scales)} numbers: a packet holds {MOST_NUMBERS}")
        self._reset()
        self.plain.step(np.zeros(len(self.torque), np.float32))  # compiled before time counts
        self._reset()

    def _reset(self) -> None:
        self.observation, _ = self.env.reset(seed=self.seed)
        self.status, self.torque = 0.0, np.zeros(len(self.torque_limits))
        (self._angles, self._slow), self.row = self.plain.batch.joints(0), tuple[float, ...]()

    # --- packets ------------------------------------------------------------------------------------
    def receive(self, content: bytes, address: Any) -> bytes | None:
        """Take a packet; what is to be answered at once, or None."""
        found = unpack(content, self.key)
        if isinstance(found, Refusal):
            self.counts[found.name] += 1
            return None
        if found.kind is Kind.HELLO:
            return self._welcome(found.connection, address)
        if self.peer is None or found.connection != self.connection or address != self.peer:
            self.counts[Refusal.STRANGER.name] += 1
        elif found.sequence <= self.last:
            self.counts[Refusal.OLD.name] += 1
        elif found.kind is Kind.COMMAND and len(found.numbers) != len(self.torque):
            self.counts[Refusal.NUMBERS.name] += 1
        elif found.kind not in (Kind.COMMAND, Kind.BYE):
            self.counts[Refusal.FOREIGN.name] += 1
        else:
            self.counts["missing"] += found.sequence - self.last - 1
            self.counts["accepted"] += 1
            self.last, self.silent = found.sequence, 0
            if found.kind is Kind.BYE:
                self.peer = self._asked = None
                self._stop("the peer has gone")
            else:
                before = 0 if self._asked is None else self._asked.flags & (ARM | RESET)
                self._asked = found._replace(flags=found.flags | before)  # two in a period: what the first began holds
        return None

    def _welcome(self, hello: int, address: Any) -> bytes | None:
        """Said again before the first command, it is answered again; replayed later it disturbs nobody."""
        if (address, hello, 0) != (self.peer, self._hello, self.last):
            if self.peer is not None and self.silent <= self.limits.watchdog:
                self.counts["busy"] += 1
                return None
            self.connection, self.peer, self._hello = secrets.randbits(64), address, hello
            self.last, self.sent, self.silent, self._asked = 0, 1, 0, None
            self._stop("not armed")
        self.counts["accepted"] += 1
        about = (self.plain.dt, len(self.torque), len(self.scales), self.limits.watchdog)
        numbers = (*map(float, about), *self.torque_limits.tolist(), *self.scales.tolist())
        return self._packed(Kind.WELCOME, 1, numbers, 0)

    def _packed(self, kind: Kind, sequence: int, numbers: tuple[float, ...], flags: int) -> bytes:
        told = Packet(kind, self.connection, sequence, self.period * self.plain.dt, numbers, flags)
        return pack(told, self.key)

    # --- periods ------------------------------------------------------------------------------------
    def _stop(self, reason: str) -> None:
        if not self.held:
            self._angles = self.plain.batch.joints(0)[0]
        self.held, self.reason = True, reason

    def advance(self) -> bytes | None:
        """One control period; the reading for the peer, or None where there is none."""
        asked, self._asked = self._asked, None
        self.silent = 0 if asked is not None else self.silent + 1
        if asked is not None:
            if asked.flags & RESET:
                self._reset()
            if asked.flags & ARM and self.status == 0.0:
                self.held, self.reason = False, ""
        elif self.silent > self.limits.watchdog and not self.held:
            self._stop(f"no command for {self.limits.watchdog} periods")
        angles, rates = self.plain.batch.joints(0)
        self._slow += self._pd.passed * (rates - self._slow)
        if not self.held and (np.abs(angles).max() > self.limits.angle or np.abs(rates).max() > self.limits.rate):
            self._stop("a joint is beyond its limits of angle or rate")
        wanted = self.torque
        if self.held:
            still = self.hold == "angles"
            wanted = self._pd.towards(self._angles, angles, self._slow) if still else np.zeros_like(angles)
        elif asked is not None and asked.flags & SET_POINTS:
            wanted = self._pd.towards(np.array(asked.numbers), angles, self._slow)
        elif asked is not None:
            wanted = np.array(asked.numbers)
        near = self.limits.slew * self.torque_limits
        low = np.maximum(-self.torque_limits, self.torque - near)
        high = np.minimum(self.torque_limits, self.torque + near)
        at_once = self.held and self.hold == "zero"
        torque = np.zeros_like(self.torque) if at_once else np.clip(wanted, low, high)
        limited = not self.held and bool((torque != wanted).any())
        self.torque = torque
        self.row = (self.period * self.plain.dt, *self.readings())
        if self.status == 0.0:
            action = (torque / self.torque_limits).astype(np.float32)
            self.observation, _, ended, cut, _ = self.plain.step(action)
            self.status = float(self.plain.batch.table[self.plain.batch.info_at.reason, 0]) or TIMED_OUT * cut
            if ended or cut:
                self._stop("the arm has stopped")
        self.period += 1
        if self.sent >= LAST and self.peer is not None:
            self.peer = None
            self._stop("the connection's numbers are used up")
        if self.peer is None:
            return None
        flags = HELD * self.held | LIMITED * limited | OVER * (self.status != 0.0)
        self.sent += 1
        return self._packed(Kind.READING, self.sent, (float(self.last), self.status, *self.readings()), flags)

    def readings(self) -> tuple[float, ...]:
        """Joint angles, rates, torques, and what the sensors read, in SI units."""
        angles, rates = self.plain.batch.joints(0)
        seen = self.observation * self.scales
        return tuple(np.concatenate([angles, rates, self.torque, seen]).tolist())

    def columns(self) -> list[str]:
        """Names of time and readings, as a log's head."""
        joints = range(len(self.torque))
        names = [f"{word}{k}" for word in ("angle", "rate", "torque") for k in joints]
        past = [f"{name}_{j}" if self.setup.history > 1 else name
                for j in range(self.setup.history) for name in self.setup.names]  # fmt: skip
        return ["t", *names, *past]


@dataclass
class Server:
    """A session behind a UDP socket, in real time.

    Args:
        session: the arm. host, port: where it listens, 0 for any port; beyond loopback there has to be a key, or
            `insecure`. log: CSV file, a row a period.
    Attributes:
        times: of the last 100,000 periods: when each was due, began and was over, s of the monotonic clock.
        missed: periods that were over before they could begin: they are left out, and the later ones keep time.
    """

    session: Session
    host: str = "127.0.0.1"
    port: int = 0
    log: Path | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if self.host not in LOOPBACK and self.session.key is None and not self.insecure:
            raise check.InvalidValue("host", self.host, "must be this machine, or be given a key (or said insecure)")
        with datagrams(self.host, self.port, 0) as self.socket:
            self.socket.bind((self.host, self.port))
        self.socket.setblocking(False)
        self.address: Address = self.socket.getsockname()[:2]
        self.times: deque[tuple[float, float, float]] = deque(maxlen=100_000)
        self.missed = 0

    def serve(self, seconds: float = math.inf, stopped: Callable[[], bool] = lambda: False) -> None:
        """Step the arm at its rate and answer, for so long."""
        period = self.session.plain.dt
        bound("seconds", seconds)
        if self.socket.fileno() < 0:
            raise ValueError(f"{self.host}:{self.address[1]}: is closed; make another server")
        opened = nullcontext() if self.log is None else self.log.open("w", newline="", encoding="utf-8")
        try:
            with opened as file:
                self._serve(None if file is None else csv.writer(file, lineterminator="\n"), period, seconds, stopped)
        except OSError as error:
            raise OSError(error.errno, error.strerror, error.filename or str(self.log or self.host)) from None

    def _serve(self, writer: Any, period: float, seconds: float, stopped: Callable[[], bool]) -> None:
        session = self.session
        if writer is not None:
            writer.writerow(session.columns())
        start, k = time.monotonic(), 0
        while not stopped() and k * period < seconds:
            k += 1
            due = start + k * period
            self._listen(due)
            began = time.monotonic()
            reading = session.advance()
            if reading is not None:
                self._send(reading, session.peer)
            if writer is not None:
                writer.writerow([f"{session.row[0]:.9g}", *map(repr, session.row[1:])])
            over = time.monotonic()
            self.times.append((due, began, over))
            missed = max(0, int((over - start) / period) - k - 1)
            k, self.missed, session.silent = k + missed, self.missed + missed, session.silent + missed

    def _listen(self, until: float) -> None:
        while True:
            left = until - time.monotonic()
            ready, _, _ = select.select([self.socket], [], [], max(left, 0.0))
            if not ready:
                return
            try:
                content, address = self.socket.recvfrom(2048)
            except OSError:
                continue
            answer = self.session.receive(content, address)
            if answer is not None:
                self._send(answer, address)
            if left <= 0.0:
                return

    def _send(self, content: bytes, address: Any) -> None:
        try:
            self.socket.sendto(content, address)
        except OSError:  # the peer's watchdog is there for what is lost
            self.session.counts["unsent"] += 1

    def close(self) -> None:
        """Let the socket go."""
        self.socket.close()
