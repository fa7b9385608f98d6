"""Layout of the UDP packets: the same in both directions, little-endian, at most 1,200 bytes.

    offset  type     content
    0       4 bytes  "FXRM"
    4       uint16   version, 2
    6       uint8    kind, a `Kind`
    7       uint8    flags, `ARM`, ...
    8       uint64   connection: a random number that the server draws; in a HELLO a number that the client draws
    16      uint32   sequence number of the sender's packets in this connection, from 1
    20      uint32   count of the numbers that follow
    24      float64  sender's time, s
    32      float64  the numbers
    ...     32 bytes HMAC-SHA256 of all preceding bytes, if server and client share a key

Numbers of each kind:

    COMMAND      torques, N m; with the flag `SET_POINTS` joint angles, rad
    READING      sequence number of the last accepted command, status (0: ok), joint angles (rad), joint rates (rad/s),
                 applied torques (N m), then the sensors' readings in SI units
    WELCOME      period (s), number of joints, number of readings, watchdog (periods), torque limits (N m), scale of
                 each reading
    HELLO        cookie from a CHALLENGE, two integers below 2^32; 0 and 0 for a client without a cookie
    CHALLENGE    cookie
    BYE, OTHER_VERSION   none

The server answers the first HELLO of a client with a CHALLENGE of the same size. The server sends larger packets only
to an address that has returned the cookie. A sender with a forged source address does not receive the cookie and
therefore cannot direct large packets at another machine. If a HELLO has another version, the server answers with
OTHER_VERSION, whose header contains the server's version.
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

MAGIC, VERSION = b"FXRM", 2
HEAD, DIGEST = struct.Struct("<4sHBBQIId"), hashlib.sha256().digest_size
MOST_NUMBERS = (1200 - HEAD.size - DIGEST) // 8
LAST = 2**32 - 1
"""Largest sequence number. The connection ends with the packet that has this number."""
SHORTEST = 16
"""Minimum length of a key in bytes."""

ARM, SET_POINTS, RESET = 1, 2, 4
"""Flags of a COMMAND. ARM: end the hold. SET_POINTS: the numbers are joint angles. RESET: start anew, if the arm can do
this.
"""
HELD, LIMITED, OVER, EXPIRED = 1, 2, 4, 8
"""Flags of a READING. HELD: the arm is held. LIMITED: a limit has changed the commanded torque. OVER: the arm has
stopped. EXPIRED: the watchdog has expired, so that the arm is held.
"""
NO_COOKIE = (0.0, 0.0)
"""The two numbers of a HELLO whose sender has not received a cookie."""


class Kind(IntEnum):
    """Purpose of a packet."""

    HELLO = 1
    WELCOME = 2
    COMMAND = 3
    READING = 4
    BYE = 5
    CHALLENGE = 6
    OTHER_VERSION = 7


KINDS = frozenset(Kind)


class Refusal(Enum):
    """Reason for which a packet is ignored; each value is a text for messages to the user."""

    SIZE = "its size is not that of a packet"
    FOREIGN = "it is not of this protocol, or of another kind"
    VERSION = f"it is of another version of this protocol than {VERSION}"
    FORGED = "its HMAC is not that of the shared key"
    NUMBERS = f"a number is not finite or beyond {check.LARGEST:g}, or there are too few or too many"
    STRANGER = "it is of another connection or peer"
    COOKIE = "its cookie is not the one that its address was given, or has expired"
    OLD = "its sequence number has been seen, or is older than one that has"


class Packet(NamedTuple):
    """Content of one packet; the description of the module `remote.packet` defines the layout.

    kind: purpose of the packet, a `Kind`. connection: 64-bit number of the connection. sequence: number of the packet,
    from 1. time: sender's clock, s. numbers: content of the packet, defined by its kind. flags: sum of the flags of a
    COMMAND (`ARM`, `SET_POINTS`, `RESET`) or of a READING (`HELD`, `LIMITED`, `OVER`, `EXPIRED`).
    """

    kind: Kind
    connection: int
    sequence: int
    time: float = 0.0
    numbers: tuple[float, ...] = ()
    flags: int = 0


def pack(packet: Packet, key: bytes | None = None) -> bytes:
    """Return the bytes of a packet, signed with HMAC-SHA256 if a key is given."""
    count = len(packet.numbers)
    head = HEAD.pack(MAGIC, VERSION, packet.kind, packet.flags, packet.connection, packet.sequence, count, packet.time)
    body = head + struct.pack(f"<{count}d", *packet.numbers)
    return body if key is None else body + hmac.new(key, body, hashlib.sha256).digest()


def unpack(content: bytes, key: bytes | None = None) -> Packet | Refusal:
    """Decode bytes to a `Packet`, or return the `Refusal` with the reason; never raise an exception."""
    tail = 0 if key is None else DIGEST
    size = len(content) - HEAD.size - tail
    if size < 0 or size % 8 or size // 8 > MOST_NUMBERS:
        return Refusal.SIZE
    # size and signature come first: nothing in an unsigned packet is interpreted
    body = content[: len(content) - tail]
    if key is not None and not hmac.compare_digest(hmac.new(key, body, hashlib.sha256).digest(), content[-tail:]):
        return Refusal.FORGED
    magic, version, kind, flags, connection, sequence, count, time = HEAD.unpack_from(body)
    if magic != MAGIC or (version == VERSION and kind not in KINDS):
        return Refusal.FOREIGN
    if version != VERSION:
        return Refusal.VERSION
    # the count in the head must match the length
    if count != size // 8:
        return Refusal.SIZE
    numbers = struct.unpack_from(f"<{count}d", body, HEAD.size)
    # nan and infinities fail this comparison too
    if not all(abs(number) <= check.LARGEST for number in (time, *numbers)):
        return Refusal.NUMBERS
    return Packet(Kind(kind), connection, sequence, time, numbers, flags)


def version_of(content: bytes) -> tuple[int, int]:
    """Return version and kind of a packet that `unpack` rejected because of its version."""
    _, version, kind, *_ = HEAD.unpack_from(content)
    return version, kind


def checked(key: bytes | None) -> bytes | None:
    """Validate a shared key and return it; None means that packets are not signed.

    Raises:
        ValueError: the key is not a bytes object, or it is shorter than `SHORTEST` bytes and therefore easy to guess.
    """
    if key is not None and (not isinstance(key, bytes) or len(key) < SHORTEST):
        of = f"{type(key).__name__} of {len(key)}" if isinstance(key, bytes | str) else type(key).__name__
        raise check.InvalidValue("key", of, f"must be at least {SHORTEST} bytes")
    return key


def bound(name: str, value: float) -> float:
    """Validate a limit: a positive number, or infinity for no limit. Raises ValueError for an invalid limit."""
    return value if isinstance(value, float) and value == math.inf else check.number(name, value, above=0.0)


@contextmanager
def datagrams(host: str, port: int, least: int) -> Iterator[socket.socket]:
    """Yield a UDP socket for an address to a `with` block; the socket is closed if the block raises an exception.

    Args:
        host: host name or IPv4 address. port: port number from `least` to 65535.
    Raises:
        ValueError: the host or the port is invalid. OSError: the system rejects the address, which the message names.
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
