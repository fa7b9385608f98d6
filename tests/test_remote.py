"""Arms served in real time: packets and their enemies, the watchdog, limits, a circle over loopback."""

import hmac
import json
import math
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.doors import KEY, met, packets
from flexarm_env.cli import main
from flexarm_env.cli.remote import key_of
from flexarm_env.control import make as controller
from flexarm_env.control.lqg import LQG
from flexarm_env.physics.layout import SPACE_POSE
from flexarm_env.remote import (
    MOST_NUMBERS,
    Kind,
    Limits,
    Packet,
    Refusal,
    RemoteArmEnv,
    Server,
    Session,
    Wire,
    client,
    pack,
)
from flexarm_env.remote.client import run_policy
from flexarm_env.remote.packet import (
    ARM,
    EXPIRED,
    HEAD,
    HELD,
    LIMITED,
    NO_COOKIE,
    OVER,
    RESET,
    SET_POINTS,
    unpack,
)
from flexarm_env.remote.server import COOKIE_LIFE, SILENCE
from tests.cli_tools import refused
from tests.processes import ROOT, served
from tests.refusals import refuses

PEER = ("127.0.0.1", 1)


def made(**arguments: Any) -> Session:
    env = gym.make("FlexibleArm-v0", control_dt=0.01, duration=1000.0, disable_env_checker=True)
    return Session(env, seed=0, **arguments)


def joined(session: Session, address: Any = PEER) -> int:
    """The connection that a peer is given."""
    found = met(session, address)
    assert found.numbers[:4] == (0.01, 1.0, 6.0, session.limits.watchdog) and found.numbers[4] == 2.0
    return found.connection


def command(session: Session, connection: int, sequence: int, torque: float, flags: int = 0) -> None:
    packet = Packet(Kind.COMMAND, connection, sequence, 0.0, (torque,), flags)
    session.receive(pack(packet, session.key), PEER)


def reading(session: Session) -> Packet:
    content = session.advance()
    assert content is not None
    found = unpack(content, session.key)
    assert isinstance(found, Packet) and found.kind is Kind.READING
    return found


@pytest.mark.parametrize("key", [None, KEY])
def test_a_packet_there_and_back(key: bytes | None) -> None:
    packet = Packet(Kind.COMMAND, 2**64 - 1, 2**32 - 1, 1.5, (0.25, -1e30), ARM | SET_POINTS)
    content = pack(packet, key)
    assert unpack(content, key) == packet and len(content) == HEAD.size + 16 + (32 if key else 0)
    assert content[:8] == b"FXRM\x02\x00\x03\x03"
    assert unpack(content, b"another") in (Refusal.FORGED, Refusal.SIZE)
    assert unpack(pack(packet._replace(numbers=(math.nan,)), key), key) is Refusal.NUMBERS
    assert unpack(pack(packet._replace(numbers=(1e31,)), key), key) is Refusal.NUMBERS
    assert unpack(pack(packet._replace(time=math.inf), key), key) is Refusal.NUMBERS
    assert unpack(pack(packet._replace(numbers=(0.0,) * (MOST_NUMBERS + 1)), key), key) is Refusal.SIZE
    assert unpack(b"") is Refusal.SIZE and unpack(b"x" * HEAD.size) is Refusal.FOREIGN


def test_the_arm_moves_as_its_environment() -> None:
    session, rng = made(), np.random.default_rng(0)
    connection, env = joined(session), gym.make("FlexibleArm-v0", control_dt=0.01, duration=1000.0)
    env.reset(seed=0)
    for k in range(50):
        torque = float(rng.uniform(-1.0, 1.0))
        command(session, connection, k + 1, torque, ARM if k == 0 else 0)
        found = reading(session)
        seen = env.step(np.array([torque / 2.0], np.float32))[0]
        assert found.flags == 0 and found.numbers[:2] == (float(k + 1), 0.0) and found.numbers[4] == torque
        assert np.array_equal(np.float32(found.numbers[5:] / session.scales), seen)
        poses = env.unwrapped.batch.view(0).poses
        assert found.numbers[2:4] == (poses[0, 2], poses[0, 5])
    env.close()


@pytest.mark.parametrize("hold", ["zero", "angles"])
def test_the_watchdog_holds_until_it_is_armed_again(hold: str) -> None:
    session = made(limits=Limits(watchdog=3), hold=hold)
    connection = joined(session)
    command(session, connection, 1, 1.0)
    assert reading(session).flags & HELD and session.torque[0] == 0.0  # never armed
    command(session, connection, 2, 1.0, ARM)
    assert reading(session).numbers[4] == 1.0
    for k in range(6):
        found = reading(session)
        assert bool(found.flags & HELD) == bool(found.flags & EXPIRED) == (k >= 3)
        assert (found.numbers[4] == 1.0) == (k < 3)
    command(session, connection, 3, 1.0)  # late: not without ARM
    assert reading(session).flags & HELD and session.reason == "no command for 3 periods"
    for _ in range(200):
        found = reading(session)
    assert (abs(found.numbers[3]) < 0.05) == (hold == "angles")
    command(session, connection, 4, 0.5, ARM)
    assert not reading(session).flags & HELD and session.torque[0] == 0.5


def test_limits() -> None:
    session = made(limits=Limits(slew=0.1, rate=1.0))
    connection = joined(session)
    command(session, connection, 1, 1.9, ARM)
    found = reading(session)
    assert found.flags & LIMITED and found.numbers[4] == pytest.approx(0.2)
    for k in range(200):
        command(session, connection, k + 2, 1.9)
        if (flags := reading(session).flags) & HELD:
            assert not flags & EXPIRED
            break
    assert session.reason.startswith("a joint is beyond") and session.torque[0] == 0.0
    command(session, connection, 500, 100.0, ARM | RESET)
    assert session.counts["missing"] == 500 - (k + 2) - 1
    found = reading(session)
    assert not found.flags & HELD and abs(found.numbers[3]) < 1.0
    angle = session.readings()[0]
    for k in range(400):
        command(session, connection, 501 + k, angle + 0.3, SET_POINTS)
        found = reading(session)
    assert abs(found.numbers[2] - angle - 0.3) < 0.02
    for arguments in ({"angle": 0.0}, {"rate": math.nan}, {"slew": -1.0}, {"watchdog": 0}):
        with pytest.raises(ValueError, match=next(iter(arguments))):
            Limits(**arguments)
    refuses("hold = 'up'", lambda: made(hold="up"))
    refuses("action_mode 'torque'", lambda: Session(gym.make("FlexibleArm-v0", action_mode="residual_pd")))


def in_space(**arguments: Any) -> Session:
    env = gym.make("SpatialFlexArm-v0", control_dt=0.01, duration=1000.0, disable_env_checker=True)
    return Session(env, seed=0, **arguments)


def test_an_arm_in_space_is_served_and_held() -> None:
    """Its joints' own angles and rates; held, and turned to set points, against its weight."""
    session, rng = in_space(limits=Limits(watchdog=3), hold="angles"), np.random.default_rng(0)
    welcome = met(session, PEER)
    assert welcome.numbers[1:3] == (3.0, 27.0) and welcome.numbers[4] == 20.0

    def ask(numbers: Any, flags: int = 0) -> Packet:
        told = Packet(Kind.COMMAND, welcome.connection, session.last + 1, 0.0, tuple(numbers), flags)
        session.receive(pack(told), PEER)
        return reading(session)

    same = gym.make("SpatialFlexArm-v0", control_dt=0.01, duration=1000.0)
    same.reset(seed=0)
    for k in range(20):
        torques = 0.05 * rng.uniform(-1.0, 1.0, 3) * session.torque_limits
        found = ask(torques, ARM if k == 0 else 0)
        seen = same.step((torques / session.torque_limits).astype(np.float32))[0]
        poses = same.unwrapped.batch.view(0).poses
        assert found.numbers[2:8] == (*poses[:, SPACE_POSE.angle], *poses[:, SPACE_POSE.rate])
        assert found.numbers[8:11] == tuple(torques)
        assert np.array_equal(np.float32(found.numbers[11:] / session.scales), seen)
    for _ in range(200):
        found = reading(session)
    assert found.flags & HELD and session.reason == "no command for 3 periods"
    assert np.abs(np.array(found.numbers[2:5]) - session._angles).max() < 0.06
    assert np.abs(np.array(found.numbers[5:8])).max() < 0.1
    wanted = np.array(found.numbers[2:5]) + (0.3, -0.2, 0.25)
    for k in range(300):
        found = ask(wanted, SET_POINTS | (ARM if k == 0 else 0))
    assert found.flags == 0 and np.abs(np.array(found.numbers[2:5]) - wanted).max() < 0.06
    same.close()


def test_one_peer_at_a_time() -> None:
    session = made(limits=Limits(watchdog=2))
    first = joined(session)
    assert session.receive(pack(Packet(Kind.HELLO, 6, 0)), ("127.0.0.1", 2)) is None and session.counts["busy"] == 1
    session.receive(pack(Packet(Kind.COMMAND, first, 1, 0.0, (1.0,), ARM)), ("127.0.0.1", 2))
    assert session.counts["STRANGER"] == 1 and session.held
    for _ in range(3):
        session.advance()
    assert joined(session, ("127.0.0.1", 2)) != first  # the first has been silent for too long
    command(session, first, 7, 1.0)
    assert session.counts["STRANGER"] == 2


def test_a_hello_said_twice_and_one_replayed() -> None:
    """Late answers do not make two connections of one; and what is replayed takes nobody's arm away."""
    session = made(key=KEY)
    connection = joined(session)
    again = unpack(session.receive(hello(session, session._cookie), PEER) or b"", KEY)
    assert isinstance(again, Packet) and (again.kind, again.connection) == (Kind.WELCOME, connection)
    command(session, connection, 1, 1.0, ARM)
    assert reading(session).sequence == 2 and session.torque[0] == 1.0
    assert session.receive(hello(session), PEER) is None and session.counts["busy"] == 1
    command(session, connection, 2, 0.5)
    assert reading(session).numbers[4] == 0.5


def hello(session: Session, cookie: tuple[float, ...] = NO_COOKIE, number: int = 5) -> bytes:
    return pack(Packet(Kind.HELLO, number, 0, 0.0, cookie), session.key)


def challenged(session: Session, address: Any, number: int = 5) -> tuple[float, ...]:
    """The cookie that an address is given."""
    found = unpack(session.receive(hello(session, number=number), address) or b"", session.key)
    assert isinstance(found, Packet) and found.kind is Kind.CHALLENGE and found.connection == number
    return found.numbers


@pytest.mark.parametrize("key", [None, KEY])
def test_who_only_says_hello_is_sent_no_more_than_it_has_sent(key: bytes | None) -> None:
    """One HELLO of 32 bytes, from an address that never answers, was sent 120,000 bytes in 10 s, and no end."""
    session = made(key=key)
    victims = [("10.0.0.1", port) for port in range(1, 40)]
    for victim in victims:
        for content in (hello(session), hello(session, (1.0, 2.0)), hello(session, (7.0,) * 20), hello(session, ())):
            assert len(session.receive(content, victim) or b"") <= len(content)
    assert session.peer is None and session.advance() is None
    assert session.counts[Refusal.COOKIE.name] == 39 and session.counts["challenged"] == 39


@pytest.mark.parametrize("key", [None, KEY])
def test_a_recorded_hello_opens_nothing_from_another_port_or_later(key: bytes | None) -> None:
    session, other = made(key=key), ("127.0.0.1", 2)
    cookie = challenged(session, PEER)
    first, second = hello(session), hello(session, cookie)
    assert session.receive(second, other) is None and session.peer is None
    assert len(session.receive(first, other) or b"") == len(first)  # a challenge, which who replays cannot answer
    connection = joined(session)
    session.receive(pack(Packet(Kind.BYE, connection, 1), key), PEER)
    for address in (PEER, other):  # of a connection that was: the count of connections is in a cookie
        assert session.receive(second, address) is None and session.peer is None
    cookie = challenged(session, PEER)
    session.period += round(2.0 * COOKIE_LIFE / 0.01)
    assert session.receive(hello(session, cookie), PEER) is None and session.peer is None
    assert session.counts[Refusal.COOKIE.name] == 4
    session.receive(hello(session, challenged(session, PEER)), PEER)
    assert session.peer == PEER


def test_a_silent_peer_is_dropped() -> None:
    """It was sent readings for ever."""
    session = made()
    joined(session)
    sent = 0
    while session.advance() is not None:
        sent += 1
        assert sent < 2000
    assert sent == round(SILENCE / 0.01) and session.peer is None and session.held
    assert session.reason == "the peer has been silent for 1000 periods"
    joined(session)
    assert made(limits=Limits(watchdog=5000)).patience == 5000  # who may be silent for longer is not dropped before


@pytest.mark.parametrize("key", [None, KEY])
def test_a_peer_of_another_version_is_told_so(key: bytes | None) -> None:
    """By a head alone: no more than its HELLO has. The server says it too, since an earlier peer does not know it."""
    session = made(key=key)
    old = HEAD.pack(b"FXRM", 1, Kind.HELLO, 0, 5, 0, 0, 0.0)
    old = old if key is None else old + hmac.new(key, old, "sha256").digest()
    answer = session.receive(old, PEER)
    assert answer is not None and len(answer) == len(old) and session.peer is None
    found = unpack(answer, key)
    assert isinstance(found, Packet) and found.kind is Kind.OTHER_VERSION
    assert session.notice.startswith("127.0.0.1:1 speaks version 1 of the packets, and this server version 2: install")
    later = answer.replace(b"FXRM\x02", b"FXRM\x03")
    assert session.receive(later, PEER) is None  # two servers do not answer each other
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as arm:
        arm.bind(("127.0.0.1", 0))
        arm.settimeout(5.0)
        wire: Any = object.__new__(Wire)
        vars(wire).update(key=None, connection=9, socket=socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        wire.socket.connect(arm.getsockname())
        arm.sendto(HEAD.pack(b"FXRM", 2, Kind.OTHER_VERSION, 0, 0, 7, 0, 0.0), wire.socket.getsockname())  # a lie
        arm.sendto(HEAD.pack(b"FXRM", 3, Kind.OTHER_VERSION, 0, 0, 0, 0, 0.0), wire.socket.getsockname())
        refuses("speaks version 3 of the packets, and this is version 2", lambda: wire._hello("x"), ConnectionError)
        wire.socket.close()


def test_a_server_that_was_stopped_holds_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its peer went on meanwhile, and the commands that had come kept the arm going."""
    session = made(limits=Limits(watchdog=20))
    connection = joined(session)
    command(session, connection, 1, 1.0, ARM)
    server, waiting = Server(session), [2]
    monkeypatch.setattr("flexarm_env.remote.server.time", clock := SimpleNamespace(now=0.0))
    clock.monotonic = lambda: clock.now

    def sleep(*sockets: Any) -> tuple[list[int], list[int], list[int]]:
        clock.now += sockets[-1] + (2.005 if session.period == 10 else 0.0)
        return [], [], []

    def receive() -> bool:  # what the system kept while the server stood still
        found = session.period == 10 and waiting[0] < 200
        if found:
            command(session, connection, waiting[0], 1.0, ARM)
            waiting[0] += 1
        return found

    monkeypatch.setattr("flexarm_env.remote.server.select", SimpleNamespace(select=sleep))
    monkeypatch.setattr(server, "_receive", receive)
    server.serve(0.105 + 2.0)
    server.close()
    assert server.missed == 200 and session.last == 199
    assert session.held and session.expired and session.torque[0] == 0.0
    assert session.reason == "no command for 20 periods"


class Slow:
    """A clock that only sleeping and stepping move; the third period takes five."""

    def __init__(self, session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.steps, self.advance = 0.0, list[float](), session.advance
        monkeypatch.setattr(session, "advance", self.step)
        monkeypatch.setattr("flexarm_env.remote.server.time", SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr("flexarm_env.remote.server.select", SimpleNamespace(select=self.sleep))

    def sleep(self, *sockets: Any) -> tuple[list[int], list[int], list[int]]:
        self.now += sockets[-1] * 1.0001
        return [], [], []

    def step(self) -> bytes | None:
        self.steps.append(self.now)
        self.now += 0.0523 if len(self.steps) == 3 else 0.001
        return self.advance()


def test_periods_are_due_by_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """None drifts; those that are over before they could begin are left out, and the watchdog counts them."""
    session = made(limits=Limits(watchdog=4))
    connection = joined(session)
    command(session, connection, 1, 1.0, ARM)
    clock, server = Slow(session, monkeypatch), Server(session)
    server.serve(1.0)
    server.close()
    began = np.array(clock.steps)
    assert server.missed == 4 and len(began) == 96
    assert np.allclose(began, 0.01 * np.r_[1:4, 8.23, 9:101], atol=1e-5)
    assert session.reason == "no command for 4 periods"
    assert np.array(server.times)[:3, 0].tolist() == [0.01, 0.02, 0.03]


@pytest.mark.slow
@pytest.mark.parametrize("key", [None, KEY])
def test_enemies(key: bytes | None) -> None:
    """100,000 of all kinds (`benchmarks.doors`): each accepted, dropped for a reason that is counted, or missing."""
    found = packets(100_000, key)
    sent, counts = found["sent"], found["counts"]
    assert sum(counts.values()) == sum(sent.values())
    assert counts["missing"] == sent["lost"] and counts["accepted"] == sent["sound"]
    never = {Refusal.FOREIGN} if key else {Refusal.FORGED}  # what is foreign has no signature either
    never |= {Refusal.COOKIE}  # while a peer is served, all others are told nothing
    assert counts["busy"] == sent["HELLO of another peer"] and counts["challenged"] == 1
    assert min(counts[word.name] for word in set(Refusal) - never) > 500


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    one = Server(made(key=KEY, limits=Limits(watchdog=200)), log=tmp_path / "log.csv")
    with served(one):
        yield one


def test_over_loopback(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host, port = server.address
    env = gym.make("RemoteArm-v0", host=host, port=port, key=KEY)
    plain: Any = env.unwrapped
    assert isinstance(plain, RemoteArmEnv) and plain.wire.limits.tolist() == [2.0]
    simulated = gym.make("FlexibleArm-v0", control_dt=0.01)
    told = run_policy(controller("pd", simulated), plain, 0.5)
    assert told["ended"] == "time" and told["steps"] >= 5
    refuses("must be 1 finite", lambda: plain.step([math.nan]))
    monkeypatch.setattr(client, "PATIENCE", 0.3)
    for key in (b"another key of 16 bytes", None):
        with pytest.raises(ConnectionError, match="no answer within"):
            Wire(host, port, key)
    monkeypatch.undo()
    plain.reset()
    time.sleep(3.0)  # the watchdog's two seconds, and more
    assert server.session.held
    while plain.wire.read() and not plain.wire.flags & HELD:
        pass
    _, reward, ended, truncated, info = plain.step(np.zeros(1, np.float32))
    assert (reward, ended, truncated, info["reason"]) == (0.0, False, True, "watchdog expired")
    env.close()
    simulated.close()
    text = (tmp_path / "log.csv").read_text()  # while it is served: no row waits in a buffer
    rows = text.splitlines()
    assert rows[0].startswith("t,angle0,rate0,torque0,hub_sin,hub_cos") and text.endswith("\n")
    assert server.session.period - 20 <= len(rows) - 1 <= server.session.period and len(rows) > 100


class Slowly:
    """A policy that thinks, before its first action, for longer than the watchdog bears."""

    def reset(self, observation: Any) -> None:
        time.sleep(0.4)

    def act(self, observation: Any) -> Any:
        return np.zeros(3, np.float32)


def test_a_peer_that_was_dropped_connects_again(server: Server) -> None:
    """A policy may take longer for its first action than a peer may be silent."""
    env = RemoteArmEnv(*server.address, KEY)
    server.session.patience = 3
    first = env.wire.connection
    while server.session.peer is not None:
        time.sleep(0.01)
    server.session.patience = 1000
    env.arm()
    assert env.wire.connection != first and not server.session.held
    env.close()


@pytest.mark.slow
def test_an_arm_in_space_over_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Driven by PD, whose goals take some tenths of a second to find, and by whoever thinks as long."""
    model = gym.make("SpatialFlexArm-v0", control_dt=0.01)
    with served(Server(in_space(limits=Limits(watchdog=20), hold="angles"))) as (host, port):
        env: Any = gym.make("RemoteArm-v0", host=host, port=port).unwrapped
        for policy in (controller("pd", model), Slowly()):
            told = run_policy(policy, env, 0.5)
            assert told["ended"] == "time" and told["steps"] >= 5
        assert run_policy(Slowly(), env, 5.0, most_rate=1e-3)["ended"] == "rate"
        assert run_policy(Slowly(), env, 5.0, most_angle=1e-9)["ended"] == "angle"
        env.close()


class Stream:
    """A socket that has two readings, and for whoever waits longer always one more."""

    def __init__(self) -> None:
        self.count, self.wait = 1, 0.0

    def settimeout(self, wait: float) -> None:
        self.wait = wait

    def recv(self, size: int) -> bytes:
        self.count += 1
        if (self.count > 3 and self.wait == 0.0) or self.count > 100:
            raise BlockingIOError
        return pack(Packet(Kind.READING, 9, self.count, 0.01 * self.count, (0.0,) * 6))


def test_of_two_commands_in_a_period_the_second_acts_and_the_first_has_armed() -> None:
    session = made()
    connection = joined(session)
    command(session, connection, 1, 0.5, ARM)
    command(session, connection, 2, 1.0)
    assert not reading(session).flags & HELD and session.torque[0] == 1.0
    command(session, connection, 3, 0.5, ARM)
    session.receive(pack(Packet(Kind.BYE, connection, 4)), PEER)
    assert session.advance() is None and session.held and session.torque[0] == 0.0


def test_a_reading_is_not_waited_for_behind_another() -> None:
    """The peer of an arm at 1000 Hz was always shown one more while it looked whether there was one."""
    wire: Any = object.__new__(Wire)
    vars(wire).update(socket=Stream(), key=None, connection=9, timeout=1.0, lost=0, _last=1)
    wire.limits, wire.scales = np.ones(1), np.ones(1)
    assert wire.read() and wire.time == 0.03 and wire.lost == 0


def test_an_arm_is_served_beyond_its_episode() -> None:
    """The server ended with a traceback where the episode did, and the arm with it."""
    session = Session(gym.make("FlexibleArm-v0", control_dt=0.01, duration=0.1), seed=0)
    answer = met(session, PEER)
    for k in range(20):
        command(session, answer.connection, k + 1, 1.0, ARM if k == 0 else 0)
        found = reading(session)
    assert found.flags == HELD | OVER and found.numbers[1] > 0.0 and session.reason == "the arm has stopped"
    command(session, answer.connection, 21, 1.0, ARM | RESET)
    assert reading(session).flags == 0


class Still:
    """An arm whose clock stands still."""

    def __init__(self) -> None:
        self.wire, self.steps = SimpleNamespace(watchdog=10**6, period=0.01), 0
        self.info = {"time": 0.0, "reason": "", "lost": 0, "angles": np.zeros(1), "rates": np.zeros(1)}

    def reset(self) -> Any:
        return np.zeros(1), self.info

    def step(self, action: Any) -> Any:
        self.steps += 1
        assert self.steps < 100
        return np.zeros(1), 0.0, False, False, self.info


def test_a_policy_runs_for_so_long_whatever_the_arms_clock_says() -> None:
    env: Any = Still()
    assert run_policy(lambda seen: np.zeros(1), env, 0.5) == {"steps": 50, "seconds": 0.0, "lost": 0, "ended": "time"}
    bounds: tuple[dict[str, Any], ...] = ({"most_angle": math.nan}, {"most_rate": "x"}, {"most_angle": -1.0})
    for wrong in bounds:  # no comparison with NaN is true: that was no bound
        refuses(f"{next(iter(wrong))} = ", partial(run_policy, lambda seen: np.zeros(1), env, 1.0, **wrong))
    refuses("seconds = nan", lambda: run_policy(lambda seen: np.zeros(1), env, math.nan))
    server = Server(made())
    refuses("seconds = nan", lambda: server.serve(math.nan))
    server.close()
    wire: Any = object.__new__(Wire)
    vars(wire).update(limits=np.ones(1), sequence=0)
    refuses("flags = 256", lambda: wire.command([0.0], 256))


LIES: tuple[tuple[tuple[float, ...], tuple[float, ...], str], ...] = (
    ((0.01, 1, 1, 5, 1.0, 0.0), (), "an invalid WELCOME packet"),
    ((0.0, 1, 1, 5, 1.0, 1.0), (), "an invalid WELCOME packet"),
    ((1e29, 1, 1, 5, 1.0, 1.0), (), "an invalid WELCOME packet"),
    ((0.01, 0, 1, 5, 1.0), (), "an invalid WELCOME packet"),
    ((0.01, -1, 1, 5, 1.0, 1.0), (), "an invalid WELCOME packet"),
    ((0.01, 1.5, 1, 5, 1.0, 1.0), (), "an invalid WELCOME packet"),
    ((0.01, 1, 1, 0, 1.0, 1.0), (), "an invalid WELCOME packet"),
    ((0.01, 1, 1, 5, 1.0, 1.0), (0.0,), "a READING packet of unexpected size"),
    ((0.01, 1, 1, 5, 1.0, 1e-8), (0.0, 0.0, 0.0, 0.0, 0.0, 1e30), ""),
)


@pytest.mark.parametrize(("welcome", "reading", "sentence"), LIES)
def test_an_arm_that_lies(welcome: tuple[float, ...], reading: tuple[float, ...], sentence: str) -> None:
    """What an arm says of itself is believed within bounds; its readings are float32 whatever they are."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as arm:
        arm.bind(("127.0.0.1", 0))
        arm.settimeout(5.0)

        def answer(count: int) -> None:
            for k in range(count):
                content, address = arm.recvfrom(2048)
                number = HEAD.unpack_from(content)[4]
                hello = unpack(content) == Packet(Kind.HELLO, number, 0, 0.0, NO_COOKIE)
                told = (
                    Packet(Kind.WELCOME, 9, 1, 0.0, welcome) if hello else Packet(Kind.READING, 9, k + 1, 0.0, reading)
                )
                arm.sendto(pack(told), address)

        answering = threading.Thread(target=answer, args=(2 if reading else 1,))
        answering.start()
        if sentence:
            refuses(sentence, lambda: RemoteArmEnv(*arm.getsockname()).reset(), ConnectionError)
        else:
            env = RemoteArmEnv(*arm.getsockname())
            assert np.isfinite(env.reset()[0]).all()
            env.wire.sequence = 2**32 - 2
            refuses("make another", lambda: env.step([0.0]), ConnectionError)
            env.close()
        answering.join()


def test_a_connection_ends_with_its_numbers() -> None:
    """After 2^32 packets, fifty days at a kilohertz, the arm is held and its peer has to begin anew."""
    session = made(limits=Limits(watchdog=10**6))
    connection = joined(session)
    command(session, connection, 2**32 - 1, 1.0, ARM)
    session.sent = 2**32 - 2
    assert reading(session).sequence == 2**32 - 1 and session.torque[0] == 1.0
    session.advance()
    assert session.advance() is None and session.held and session.torque[0] == 0.0
    assert joined(session) != connection


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Wire("127.0.0.1", 70000), "port = 70000: must be a whole number, from 1 to 65535"),
        (lambda: Wire("127.0.0.1", 0), "port = 0"),
        (lambda: Wire("127.0.0.1", "7070"), "port = '7070'"),  # type: ignore[arg-type]
        (lambda: Wire(None, 7070), "host = None: must be a text"),  # type: ignore[arg-type]
        (lambda: Wire("a\0", 7070), "host = 'a.x00': must be a host's name"),
        (lambda: Wire("no such host", 7070), "no such host:7070"),
        (lambda: Wire("127.0.0.1", 9, timeout=math.nan), "timeout = nan"),
        (lambda: Wire("127.0.0.1", 9, key=b"short"), "key = 'bytes of 5': must be at least 16 bytes"),
        (lambda: made(key="a text of 16 letters"), "key = 'str of 20'"),
        (lambda: made(limits=None), "limits = None: must be a Limits"),
        (lambda: Session(gym.make("FlexibleArm-v0"), seed=-1), "seed = -1"),
        (lambda: Server(made(), port=-1), "port = -1: must be a whole number, from 0 to 65535"),
        (lambda: Server(made(), host="8.8.8.8", insecure=True), "8.8.8.8:0"),
        (lambda: Limits(angle="x"), "angle = 'x'"),  # type: ignore[arg-type]
        (lambda: Limits(watchdog=10**30), "watchdog = 1000"),
    ],
)
def test_what_is_given_is_refused_in_a_sentence(make: Any, sentence: str) -> None:
    refuses(sentence, make, (ValueError, OSError))


def test_a_session_does_not_show_its_key() -> None:
    session = made(key=KEY)
    server = Server(session)
    server.close()
    assert "both ends" not in repr(session) + repr(server)
    refuses("is closed; make another server", lambda: server.serve(0.1))


def test_beyond_loopback_wants_a_key() -> None:
    session = made()
    refuses("must be this machine, unless a key", lambda: Server(session, host="0.0.0.0"))
    Server(session, host="0.0.0.0", insecure=True).close()


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Served in a thread, driven by a controller; what is wrong is refused in a sentence."""
    log, found = tmp_path / "run.csv", list[int]()
    words = ["serve", "FlexibleArm-v0", "--rate", "100", "--port", "0", "--seconds", "0.3", "--log", str(log), "--json"]
    serving = threading.Thread(target=lambda: found.append(main(words)))
    serving.start()
    serving.join()
    told = json.loads(capsys.readouterr().out)
    assert found == [0] and told["packets"] == {} and told["periods"] >= 1
    rows = np.genfromtxt(log, delimiter=",", names=True)
    assert rows["t"][0] == 0.0 and rows["t"][1] == 0.01 and not rows["torque0"].any()
    assert main(["serve", "FlexibleArm-v0", "--port", "0", "--seconds", "0.1", "--log", "/dev/full"]) == 2
    assert capsys.readouterr().err == "flexarm serve: /dev/full: No space left on device\n"
    short, open_, good = (tmp_path / word for word in ("short", "open", "good"))
    for file, mode in ((short, 0o600), (open_, 0o644), (good, 0o600)):
        file.write_bytes(b"sixteen" if file is short else b"sixteen bytes or more")
        file.chmod(mode)
    assert key_of(str(good)) == good.read_bytes()
    for words, sentence in (
        *(
            (["serve", "FlexibleArm-v0", "--key", str(path)], told)
            for path, told in (
                (short, "must contain 16 to 4096 bytes"),
                (open_, f"chmod 600 {open_}"),
                (tmp_path, "must be a regular file"),
                ("/dev/zero", "must be a regular file"),
                ("", "must be a regular file"),
            )
        ),
        *(
            (["serve", "FlexibleArm-v0", *flags.split()], flags.split()[0][2:])
            for flags in (
                "--port 65536",
                "--port -1",
                "--seconds nan",
                "--seconds 0",
                "--most-rate nan",
                "--watchdog 0",
            )
        ),
        (["run", "pd", "--to", "127.0.0.1:65536"], "a port from 1 to 65535"),
        (["run", "pd", "--env", "FlexibleArm-v0", "--to", "no.such.host.invalid:7070"], "no.such.host.invalid:7070: "),
        (["serve", "nobody"], "nobody"),
        *((["serve", "FlexibleArm-v0", "--rate", rate], "--rate") for rate in ("0", "nan", "1e9", "-5")),
        (["serve", "FlexibleArm-v0", "--env-kwargs", '{"control_dt": 1e-7}'], "control_dt = 1e-07: must not be given"),
        (["serve", "FlexibleArm-v0", "--key", "a\0b"], "null"),
        (["serve", "FlexibleArm-v0", "--host", "0.0.0.0", "--port", "0"], "must be this machine, unless a key"),
        (["serve", "FlexibleArm-v0", "--key", str(log.with_suffix(".none"))], "run.none"),
        (["run", "pd", "--to", "nowhere"], "must be HOST:PORT"),
        (["run", "no_such:thing", "--to", "127.0.0.1:9"], "POLICY no_such:thing: cannot be imported"),
        (["run", "pd", "--to", "127.0.0.1:9"], "together with --env"),
        (["run", "pd", "--env", "FlexibleArm-v0", "--to", "127.0.0.1:9"], "no answer within"),
    ):
        assert sentence in refused(capsys, *words)


def test_a_function_in_python_drives(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`flexarm run module:name`, of a module in the current folder."""
    (tmp_path / "driving.py").write_text("def act(observation):\n    return 0.2 + 0.0 * observation[:1]\n")
    key = tmp_path / "key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (host, port), start = server.address, server.session.readings()[0]
    to = ["--to", f"{host}:{port}", "--seconds", "0.2", "--key", str(key)]
    assert main(["run", "driving:act", *to]) == 0
    assert server.session.counts["accepted"] > 10 and server.session.readings()[0] > start + 1e-3  # it turns


def test_a_controller_is_designed_before_the_arm_is_connected_to(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`flexarm run lqg` at 200 Hz ended after one step, its arm held while LQG was designed, with exit code 0."""
    events, acts = list[str](), LQG.act
    outcome = {"steps": 1, "seconds": 0.005, "lost": 0, "ended": "watchdog expired"}
    monkeypatch.setattr(LQG, "act", lambda self, seen: (events.append("act"), acts(self, seen))[1])
    connected = RemoteArmEnv.__init__
    monkeypatch.setattr(RemoteArmEnv, "__init__", lambda *words: (events.append("connect"), connected(*words))[1])
    monkeypatch.setattr("flexarm_env.cli.remote.run_policy", lambda *words: outcome)
    arm = gym.make("FlexibleArm-v0", control_dt=0.01, observation="measured", disable_env_checker=True)
    with served(Server(Session(arm, seed=0))) as (host, port):
        words = ["run", "lqg", "--env", "FlexibleArm-v0", "--env-kwargs", '{"observation": "measured"}']
        words += ["--to", f"{host}:{port}", "--seconds", "0.1"]
        assert main(words) == 4 and "ended: watchdog expired" in capsys.readouterr().out
        assert events == ["act", "connect"]
        outcome["ended"] = "time"
        assert main(words) == 0


@pytest.mark.slow
def test_a_served_arm_that_is_terminated_leaves_its_log_whole(tmp_path: Path) -> None:
    """Also where Ctrl-C is ignored, as by what a shell starts behind it."""
    log = tmp_path / "run.csv"
    words = ["serve", "FlexibleArm-v0", "--rate", "200", "--port", "0", "--log", str(log)]
    command = [sys.executable, "-m", "flexarm_env", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as server:
        assert server.stdout is not None and "serving" in server.stdout.readline()
        time.sleep(0.5)
        server.terminate()
        assert "periods: " in server.communicate()[0]
    assert server.returncode == 0
    lines = log.read_text().splitlines()
    assert len(lines) > 2 and {line.count(",") for line in lines} == {lines[0].count(",")}
