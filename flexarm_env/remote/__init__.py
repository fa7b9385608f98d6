"""Remote operation over UDP: a server that runs an arm in real time, and a client environment for policies.

The server does not make a real arm safe. A real arm needs its own safety hardware, such as an emergency stop.
"""

from .client import Played, RemoteArmEnv, Wire, run_policy
from .packet import MOST_NUMBERS, Kind, Packet, Refusal, pack, unpack
from .server import Limits, Server, Session

__all__ = [
    "MOST_NUMBERS", "Kind", "Limits", "Packet", "Played", "Refusal", "RemoteArmEnv", "Server", "Session", "Wire",
    "pack", "run_policy", "unpack",
]  # fmt: skip
