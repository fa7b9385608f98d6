"""The packet: one layout in both directions, little-endian, at most 1,200 bytes.

    offset  type     what
    0       4 bytes  "FXRM"
    4       uint16   version, 1
    6       uint8    kind, a `Kind`
    7       uint8    flags, `ARM`, ...
    8       uint64   connection: a random number that the server draws for a peer; in a HELLO the peer's own
    16      uint32   sequence number, from 1, of the sender's packets in this connection
    20      uint32   how many numbers follow
    24      float64  time of the sender, s
    32      float64  the numbers
    ...     32 bytes HMAC-SHA256 of all before, where a key is shared

Numbers of a COMMAND: torques, N m, or with `SET_POINTS` joint angles, rad. Of a READING: sequence number of the last
command that was taken, status (0: ok), then joint angles (rad), their rates (rad/s), torques as applied (N m), and what
the sensors read, in SI units. Of a WELCOME: period (s), joints, readings, periods of the watchdog, then torque limits
(N m) and the scale of each reading. A HELLO and a BYE have none.
"""

import hashlib
import hmac
import math
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum, IntEnum
from typing import NamedTuple

from .. import validation as check

MAGIC, VERSION = b"FXRM", 1
HEAD, DIGEST = struct.Struct("<4sHBBQIId"), hashlib.sha256().digest_size
MOST_NUMBERS = (1200 - HEAD.size - DIGEST) // 8
LAST = 2**32 - 1
"""The largest sequence number, of which a connection ends."""
SHORTEST = 16
"""Bytes of a key."""

ARM, SET_POINTS, RESET = 1, 2, 4
"""Flags of a command: end the watchdog's hold; numbers are angles; start anew, where the arm can."""
HELD, LIMITED, OVER = 1, 2, 4
"""Flags of a reading: the watchdog holds the arm; a limit has changed what was asked for; the arm has stopped."""


class Kind(IntEnum):
    """What a packet is for."""

    HELLO = 1
    WELCOME = 2
    COMMAND = 3
    READING = 4
    BYE = 5


KINDS = frozenset(Kind)


class Refusal(Enum):
    """Why a packet is dropped."""

    SIZE = "its size is not that of a packet"
    FOREIGN = "it is not of this protocol, or of another version or kind"
    FORGED = "its HMAC is not that of the shared key"
    NUMBERS = f"a number is not finite or beyond {check.LARGEST:g}, or there are too few or too many"
    STRANGER = "it is of another connection or peer"
    OLD = "its sequence number has been seen, or is older than one that has"


class Packet(NamedTuple):
    """A packet; see the module."""

    kind: Kind
    connection: int
    sequence: int
    time: float = 0.0
    numbers: tuple[float, ...] = ()
    flags: int = 0


def pack(packet: Packet, key: bytes | None = None) -> bytes:
    """The bytes of a packet, signed where there is a key."""
    count = len(packet.numbers)
    head = HEAD.pack(MAGIC, VERSION, packet.kind, packet.flags, packet.connection, packet.sequence, count, packet.time)
    body = head + struct.pack(f"<{count}d", *packet.numbers)
    return body if key is None else body + hmac.new(key, body, hashlib.sha256).digest()


def unpack(content: bytes, key: bytes | None = None) -> Packet | Refusal:
    """The packet that bytes are, or why they are none. Never raises, whatever they are."""
    tail = 0 if key is None else DIGEST
    size = len(content) - HEAD.size - tail
    if size < 0 or size % 8 or size // 8 > MOST_NUMBERS:
        return Refusal.SIZE
    body = content[: len(content) - tail]
    if key is not None and not hmac.compare_digest(hmac.new(key, body, hashlib.sha256).digest(), content[-tail:]):
        return Refusal.FORGED
    magic, version, kind, flags, connection, sequence, count, time = HEAD.unpack_from(body)
    if magic != MAGIC or version != VERSION or kind not in KINDS:
        return Refusal.FOREIGN
    if count != size // 8:
        return Refusal.SIZE
    numbers = struct.unpack_from(f"<{count}d", body, HEAD.size)
    if not all(abs(number) <= check.LARGEST for number in (time, *numbers)):
        return Refusal.NUMBERS
    return Packet(Kind(kind), connection, sequence, time, numbers, flags)


def checked(key: bytes | None) -> bytes | None:
    """A shared key. ValueError for what is none, or is soon guessed."""
    if key is not None and (not isinstance(key, bytes) or len(key) < SHORTEST):
        of = f"{type(key).__name__} of {len(key)}" if isinstance(key, bytes | str) else type(key).__name__
        raise check.InvalidValue("key", of, f"must be at least {SHORTEST} bytes")
    return key


def bound(name: str, value: float) -> float:
    """A positive number, or infinity for no bound. ValueError for what is neither."""
    return value if isinstance(value, float) and value == math.inf else check.number(name, value, above=0.0)


@contextmanager
def datagrams(host: str, port: int, least: int) -> Iterator[socket.socket]:
    """A UDP socket for an address, closed where what is done with it fails.

    Raises:
        ValueError: a host or port that is none. OSError: the system refuses the address; names it.
    """
    check.text("host", host, empty=False)
    check.integer("port", port, minimum=least, maximum=65535)
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        yield made
    except BaseException as error:
        made.close()
        if isinstance(error, OSError) and error.filename is None and not isinstance(error, ConnectionError):
            raise OSError(error.errno, error.strerror, f"{host}:{port}") from None
        if isinstance(error, UnicodeError | TypeError):
            raise check.InvalidValue("host", host, "must be a host's name or its IPv4 address") from None
        raise
