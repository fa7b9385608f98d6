"""Server of a remote arm: protocol and control loop (`Session`), executed in real time over UDP (`Server`)."""

import csv
import hashlib
import hmac
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
    EXPIRED,
    HELD,
    LAST,
    LIMITED,
    MOST_NUMBERS,
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

Address = tuple[str, int]
LOOPBACK = ("127.0.0.1", "localhost", "::1")
TIMED_OUT = 5.0
"""Status of an arm whose episode has reached its time limit. All other statuses are status codes of the solver."""
COOKIE_LIFE = 10.0
"""Minimum lifetime of a cookie, s. The maximum lifetime is twice as long."""
BACKLOG = 10_000
"""Maximum number of waiting packets that the server reads after a pause."""
SILENCE = 10.0
"""Time (s) without a command after which a client is dropped, if the watchdog does not wait longer."""


@dataclass(frozen=True)
class Limits:
    """Limits of commands and motion that the server enforces; inf means no limit.

    angle (rad), rate (rad/s): limits of every joint; the server holds the arm if a joint exceeds a limit. slew: largest
    change of a torque per period, divided by its limit. watchdog: number of periods without a command until the arm is
    held.
    """

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
    """Protocol and control loop of an arm's server, without socket and clock.

    Args:
        env: single environment whose actions are torques. limits: limits on commands and motion. key: shared secret or
            None. hold: torques of a held arm: "zero", or "angles" for PD control to the joint angles at the start of
            the hold. seed: seed of the environment's resets.
    Attributes:
        row: time (s) and readings at the start of the last control period, and the torques of this period. counts:
            numbers of packets by name of a `Refusal` or "accepted", "challenged", "busy" (second client), "missing".
        held: True if the arm is held until a command with the flag `ARM` arrives. reason: why the arm is held. peer:
            address of the client. status: 0.0 or a failure code. period: number of control periods so far. notice:
            message about a client of another protocol version.
    """

    env: Any
    limits: Limits = field(default_factory=Limits)
    key: bytes | None = field(default=None, repr=False)
    hold: str = "zero"
    seed: int | None = None

    def __post_init__(self) -> None:
        """Validate the fields, design the PD controller that holds the arm, and compile the code of a period."""
        plan = getattr(getattr(self.env, "unwrapped", None), "plan", None)
        if plan is None or plan.action_mode != "torque" or plan.arm.base is not None:
            what = "must be a single environment of this package, action_mode 'torque', its root fixed"
            raise ValueError(f"env = {self.env}: {what}")
        check.instance("limits", self.limits, Limits)
        checked(self.key)
        if self.seed is not None:
            check.integer("seed", self.seed, minimum=0)
        if self.hold not in ("zero", "angles"):
            raise check.InvalidValue("hold", self.hold, "must be 'zero' or 'angles'")
        # scales (M,): of each entry of the observation, all instants of the history
        self.setup, self.plain = Setup.of(self.env), self.env.unwrapped
        self.torque_limits = np.array(plan.arm.torque_limits)
        self.scales = np.tile(np.array(self.setup.scales), self.setup.history)
        pd = controller("pd", self.env)
        assert isinstance(pd, PD | SpatialPD)
        self._pd = pd
        self.counts: Counter[str] = Counter()
        # last: sequence number of the peer's last accepted packet; sent: of the session's own
        self.connection, self.last, self.sent, self.period, self._hello = 0, 0, 0, 0, 0
        self.peer: Any = None
        self._secret, self._connections = secrets.token_bytes(32), 0
        self._cookie: tuple[float, ...] = NO_COOKIE
        self.patience = max(self.limits.watchdog, math.ceil(SILENCE / self.plain.dt))
        self.silent, self.held, self.expired, self.reason, self.notice = 0, True, False, "not armed", ""
        self._asked: Packet | None = None
        self.torque = np.zeros(len(self.torque_limits))
        if 2 + 3 * len(self.torque) + len(self.scales) > MOST_NUMBERS:
            raise ValueError(f"observation of {len(self.scales)} numbers: a packet holds {MOST_NUMBERS}")
        self._reset()
        self.plain.step(np.zeros(len(self.torque), np.float32))  # compiled before time counts
        self._reset()

    def _reset(self) -> None:
        """Reset the environment, torque and status, and store the initial joint angles (rad) as the angles to hold."""
        self.observation, _ = self.env.reset(seed=self.seed)
        self.status, self.torque = 0.0, np.zeros(len(self.torque_limits))
        (self._angles, self._slow), self.row = self.plain.batch.joints(0), tuple[float, ...]()

    # --- packets ------------------------------------------------------------------------------------
    def receive(self, content: bytes, address: Any) -> bytes | None:
        """Process one packet from `address`; return the bytes of an immediate answer, or None.

        A COMMAND is stored and applied in the next period. Rejected packets are counted in `counts`.
        """
        found = unpack(content, self.key)
        if isinstance(found, Refusal):
            self.counts[found.name] += 1
            return self._other_version(content, address) if found is Refusal.VERSION else None
        if found.kind is Kind.HELLO:
            return self._welcome(found, address)
        # accept packets of the served connection and address only, in order, and of the right size
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
                # ARM and RESET of an earlier command in the same period stay set
                self._asked = found._replace(flags=found.flags | before)
        return None

    def _welcome(self, hello: Packet, address: Any) -> bytes | None:
        """Answer a HELLO: first by a CHALLENGE with a cookie for its address; if the cookie returns, by a WELCOME.

        A HELLO repeated before the first command is answered again; a later replay is ignored.
        """
        # another peer is served and still sends commands: refuse
        again = (address, hello.connection, 0) == (self.peer, self._hello, self.last)
        if not again and self.peer is not None and self.silent <= self.limits.watchdog:
            self.counts["busy"] += 1
            return None
        if len(hello.numbers) != len(NO_COOKIE):
            self.counts[Refusal.NUMBERS.name] += 1
            return None
        # no larger than the HELLO: the address may be forged
        if hello.numbers == NO_COOKIE:
            self.counts["challenged"] += 1
            return self._packed(Kind.CHALLENGE, 0, self._cookie_for(address, hello.connection), 0, hello.connection)
        if not again or hello.numbers != self._cookie:
            # accept a cookie of this or the previous span of `COOKIE_LIFE`
            if hello.numbers not in [self._cookie_for(address, hello.connection, back) for back in (0, 1)]:
                self.counts[Refusal.COOKIE.name] += 1
                return None
            self.connection, self.peer, self._hello = secrets.randbits(64), address, hello.connection
            self.last, self.sent, self.silent, self._asked, self._cookie = 0, 1, 0, None, hello.numbers
            self._connections += 1
            self._stop("not armed")
        self.counts["accepted"] += 1
        about = (self.plain.dt, len(self.torque), len(self.scales), self.limits.watchdog)
        numbers = (*map(float, about), *self.torque_limits.tolist(), *self.scales.tolist())
        return self._packed(Kind.WELCOME, 1, numbers, 0)

    def _cookie_for(self, address: Any, hello: int, back: int = 0) -> tuple[float, float]:
        """Return the cookie of an address and HELLO number: 64 bits of an HMAC, as two whole numbers below 2^32.

        The HMAC covers address, HELLO, time span (`back` spans ago) and the count of connections, so that each
        cookie opens one connection. The HMAC's key is a secret of this session. A sender without cookie is not stored.
        """
        span = int(self.period * self.plain.dt / COOKIE_LIFE) - back
        text = repr((address, hello, span, self._connections)).encode()
        made = hmac.new(self._secret, text, hashlib.sha256).digest()
        return float(int.from_bytes(made[:4], "little")), float(int.from_bytes(made[4:8], "little"))

    def _other_version(self, content: bytes, address: Any) -> bytes | None:
        """Answer a HELLO of another protocol version by a header of this version; return None for any other packet."""
        version, kind = version_of(content)
        if kind != Kind.HELLO:
            return None
        if not self.notice:
            self.notice = (
                f"{address[0]}:{address[1]} speaks version {version} of the packets, and this server version "
                f"{VERSION}: install the same version of flexarm_env at both ends"
            )
        return self._packed(Kind.OTHER_VERSION, 0, (), 0, 0)

    def _packed(
        self, kind: Kind, sequence: int, numbers: tuple[float, ...], flags: int, connection: int | None = None
    ) -> bytes:
        """Return the bytes of a packet of this session, with the arm's time. connection: None for the peer's number."""
        number = self.connection if connection is None else connection
        return pack(Packet(kind, number, sequence, self.period * self.plain.dt, numbers, flags), self.key)

    # --- periods ------------------------------------------------------------------------------------
    def _stop(self, reason: str, expired: bool = False) -> None:
        """Hold the arm: store the reason and, if it was not held yet, the present joint angles (rad)."""
        if not self.held:
            self._angles = self.plain.batch.joints(0)[0]
        self.held, self.reason, self.expired = True, reason, expired

    def _silence(self) -> None:
        """Hold the arm after the watchdog's periods without a command, and drop the peer after `patience` periods."""
        if self.silent > self.limits.watchdog and not self.held:
            self._stop(f"no command for {self.limits.watchdog} periods", expired=True)
        if self.peer is not None and self.silent > self.patience:
            self.peer = None
            self._stop(f"the peer has been silent for {self.patience} periods", expired=True)

    def skip(self, periods: int) -> None:
        """Count control periods that passed without a step of the arm.

        If more periods passed than the watchdog allows, hold the arm and drop a command that arrived in the meantime,
        because the command was computed for a past instant.
        """
        self.silent += periods
        if periods > self.limits.watchdog:
            self._asked = None
        self._silence()

    def advance(self) -> bytes | None:
        """Advance one control period: choose and limit torques, step the environment; return a READING or None."""
        asked, self._asked = self._asked, None
        self.silent = 0 if asked is not None else self.silent + 1
        if asked is not None:
            if asked.flags & RESET:
                self._reset()
            if asked.flags & ARM and self.status == 0.0:
                self.held, self.reason, self.expired = False, "", False
        else:
            self._silence()
        # low-pass filter of the joint rates for the PD controller
        angles, rates = self.plain.batch.joints(0)
        self._slow += self._pd.passed * (rates - self._slow)
        if not self.held and (np.abs(angles).max() > self.limits.angle or np.abs(rates).max() > self.limits.rate):
            self._stop("a joint is beyond its limits of angle or rate")
        # wanted torque (N m): hold, PD toward set points, the commanded one, or the last one without a command
        wanted = self.torque
        if self.held:
            still = self.hold == "angles"
            wanted = self._pd.towards(self._angles, angles, self._slow) if still else np.zeros_like(angles)
        elif asked is not None and asked.flags & SET_POINTS:
            wanted = self._pd.towards(np.array(asked.numbers), angles, self._slow)
        elif asked is not None:
            wanted = np.array(asked.numbers)
        # torque limits and slew rate; a hold at zero torque bypasses the slew rate
        near = self.limits.slew * self.torque_limits
        low = np.maximum(-self.torque_limits, self.torque - near)
        high = np.minimum(self.torque_limits, self.torque + near)
        at_once = self.held and self.hold == "zero"
        torque = np.zeros_like(self.torque) if at_once else np.clip(wanted, low, high)
        limited = not self.held and bool((torque != wanted).any())
        self.torque = torque
        self.row = (self.period * self.plain.dt, *self.readings())
        # step the environment; actions are torques divided by their limits
        if self.status == 0.0:
            action = (torque / self.torque_limits).astype(np.float32)
            self.observation, _, ended, cut, _ = self.plain.step(action)
            self.status = float(self.plain.batch.table[self.plain.batch.info_at.reason, 0]) or TIMED_OUT * cut
            if ended or cut:
                self._stop("the arm has stopped")
        self.period += 1
        # a connection ends when its sequence numbers are used up
        if self.sent >= LAST and self.peer is not None:
            self.peer = None
            self._stop("the connection's numbers are used up")
        if self.peer is None:
            return None
        flags = HELD * self.held | LIMITED * limited | OVER * (self.status != 0.0) | EXPIRED * self.expired
        self.sent += 1
        return self._packed(Kind.READING, self.sent, (float(self.last), self.status, *self.readings()), flags)

    def readings(self) -> tuple[float, ...]:
        """Return joint angles (rad), rates (rad/s), torques (N m) and sensor readings in SI units, 3 N + M numbers."""
        angles, rates = self.plain.batch.joints(0)
        seen = self.observation * self.scales
        return tuple(np.concatenate([angles, rates, self.torque, seen]).tolist())

    def columns(self) -> list[str]:
        """Return the names of the CSV log's columns: t, angles, rates, torques and the observation's entries."""
        joints = range(len(self.torque))
        names = [f"{word}{k}" for word in ("angle", "rate", "torque") for k in joints]
        past = [f"{name}_{j}" if self.setup.history > 1 else name
                for j in range(self.setup.history) for name in self.setup.names]  # fmt: skip
        return ["t", *names, *past]


@dataclass
class Server:
    """Real-time UDP server of a session.

    Args:
        session: the session to run. host, port: address of the socket; port 0 selects any free port. A host other than
            loopback requires a key or insecure=True. log: CSV file (a row per period) or None. tell: function that
            receives `Session.notice`.
    Attributes:
        times: scheduled start, actual start and end of each of the last 100,000 periods, s of the monotonic clock.
        missed: number of periods that the server skipped because the computer was not ready in time.
    """

    session: Session
    host: str = "127.0.0.1"
    port: int = 0
    log: Path | None = None
    insecure: bool = False
    tell: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        """Bind the socket; a host other than this machine requires a key, or insecure=True."""
        if self.host not in LOOPBACK and self.session.key is None and not self.insecure:
            raise check.InvalidValue("host", self.host, "must be this machine, unless a key or insecure is given")
        with datagrams(self.host, self.port, 0) as self.socket:
            self.socket.bind((self.host, self.port))
        self.socket.setblocking(False)
        self.address: Address = self.socket.getsockname()[:2]
        self.times: deque[tuple[float, float, float]] = deque(maxlen=100_000)
        self.missed = 0

    def serve(self, seconds: float = math.inf, stopped: Callable[[], bool] = lambda: False) -> None:
        """Step the arm in real time and answer packets for `seconds`, or until `stopped()` returns True.

        Raises:
            ValueError: the server is closed. OSError: the log or the socket fails.
        """
        period = self.session.plain.dt
        bound("seconds", seconds)
        if self.socket.fileno() < 0:
            raise ValueError(f"{self.host}:{self.address[1]}: is closed; make another server")
        # line-buffered: each row is written when its period ends, so that a killed server loses no earlier row
        opened = nullcontext() if self.log is None else self.log.open("w", 1, newline="", encoding="utf-8")
        try:
            with opened as file:
                self._serve(None if file is None else csv.writer(file, lineterminator="\n"), period, seconds, stopped)
        except OSError as error:
            raise OSError(error.errno, error.strerror, error.filename or str(self.log or self.host)) from None

    def _serve(self, writer: Any, period: float, seconds: float, stopped: Callable[[], bool]) -> None:
        """Run the periods: listen until each is due, advance the session, send the reading and write the log row."""
        session = self.session
        if writer is not None:
            writer.writerow(session.columns())
        start, k = time.monotonic(), 0
        while not stopped() and k * period < seconds:
            k += 1
            self._listen(start + k * period)
            began = time.monotonic()
            # skip the periods that passed before this one could begin
            k += self._skipped(int((began - start) / period) - k)
            due = start + k * period
            reading = session.advance()
            if reading is not None:
                self._send(reading, session.peer)
            if writer is not None:
                writer.writerow([f"{session.row[0]:.9g}", *map(repr, session.row[1:])])
            # skip the periods that passed during this one
            over = time.monotonic()
            self.times.append((due, began, over))
            k += self._skipped(int((over - start) / period) - k - 1)
            if session.notice and self.tell is not None:
                tell, self.tell = self.tell, None
                tell(session.notice)

    def _skipped(self, periods: int) -> int:
        """Skip `periods` periods that have passed and return their number, or 0 if negative.

        After a pause longer than the watchdog's, the packets that have arrived are read first and then discarded.
        """
        if periods <= 0:
            return 0
        if periods > self.session.limits.watchdog:
            for _ in range(BACKLOG):
                if not self._receive():
                    break
        self.missed += periods
        self.session.skip(periods)
        return periods

    def _listen(self, until: float) -> None:
        """Receive packets until the instant `until` (monotonic clock, s); at least poll once."""
        while True:
            left = until - time.monotonic()
            ready, _, _ = select.select([self.socket], [], [], max(left, 0.0))
            if not ready:
                return
            if self._receive() and left <= 0.0:
                return

    def _receive(self) -> bool:
        """Read one waiting packet and answer it; return whether there was one."""
        try:
            content, address = self.socket.recvfrom(2048)
        except OSError:
            return False
        answer = self.session.receive(content, address)
        if answer is not None:
            self._send(answer, address)
        return True

    def _send(self, content: bytes, address: Any) -> None:
        """Send a datagram; count it as "unsent" if the system refuses it."""
        try:
            self.socket.sendto(content, address)
        except OSError:
            # lost datagrams are the business of the watchdogs
            self.session.counts["unsent"] += 1

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
